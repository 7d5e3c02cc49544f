"""What instances ask for on their way, so that many share every launch."""

from collections.abc import Generator
from dataclasses import dataclass
from typing import Any

import numpy as np

from multirod.solvers.following.descent import Point, Slope
from multirod.status import Status
from multirod.validation import FloatArray

EDGES = (Status.OUT_OF_HOLE, Status.LOOSE)  # why there is nothing where something goes down in energy


@dataclass(frozen=True)
class Spot:
    """Where something is asked of.

    Attributes:
        unknowns: Shape (n,) [1/m].
        level: Part of the way.
    """

    unknowns: FloatArray
    level: float


class Judge(Spot):
    """A request to tell the stability."""


@dataclass(frozen=True)
class Judgement:
    """Its answer.

    Attributes:
        falls: Whether it is known that there are unstable modes; without a potential, an odd number that loads drive away.
        stands: Whether it is known that there are none.
        soft: Modes that cannot be told from neutral ones.
    """

    falls: bool
    stands: bool
    soft: int


class Weigh(Spot):
    """A request to tell the potential energy [J]."""


class At(Spot):
    """A request to integrate, with the moments of clamps behind the unknowns or without."""


@dataclass(frozen=True)
class Clamp(Spot):
    """A request to integrate with clamps that carry no moment yet, by one of ``Parts.clampings``; None is the answer where there
    can be none."""

    clamping: int = 0


@dataclass(frozen=True)
class Settle(Spot):
    """A request to let damped dynamics go from here until they rest, by so many integrations at most.

    The answer is the unknowns, None where they do not rest, how many it took, and why there is nothing, as ``Answer.edge``.
    """

    most: int


@dataclass(frozen=True)
class Correct(Spot):
    """A request for the equilibrium near here by Newton's method (``many.correct``).

    Attributes:
        neutral: Modes along which no step goes.
        tolerance: Largest residual [1/m].
        left: Integrations that it may take.
        any_contraction: Whether steps may become shorter slowly.
        aside: Whether what is missing along these modes may be left.
    """

    neutral: int
    tolerance: float
    left: int
    any_contraction: bool = False
    aside: bool = False


@dataclass(frozen=True)
class Trace:
    """A request to go along the branch through an equilibrium as far as it leads (``many.trace``).

    Attributes:
        start: The equilibrium.
        neutral: Modes that are neutral all along.
        tolerance: Largest residual [1/m].
        left: Integrations that it may take.
        first: The first step.
        safe: A step that is short enough wherever it starts.
        longest: No step is longer.
        most: Steps allowed.
        origin: The point of bifurcation from which it leaves another branch, if it does.
        aside: As ``Correct`` has it.
        loud: Norm of ``Gamma``, beyond which it goes no further.
    """

    start: Point
    neutral: int
    tolerance: float
    left: int
    first: float
    safe: float
    longest: float
    most: int
    origin: Point | None = None
    aside: bool = False
    loud: float = np.inf


@dataclass(frozen=True)
class Descend:
    """A request to go down in energy by the turns of the tip (``serving.downhill.descend``).

    Attributes:
        point: From where.
        slope: There.
        first: How the tip is turned at first, shape (m,); all zero where the slope tells.
        tolerance: Largest residual [1/m].
        left: Integrations that it may take.
    """

    point: Point
    slope: Slope
    first: FloatArray
    tolerance: float
    left: int


@dataclass(frozen=True)
class Answer:
    """What came of one of these three.

    Attributes:
        point: The last one on the way; None where there is none.
        integrations: That it took.
        iterations: That it took.
        spent: Whether it would have taken more than it may.
        contraction: Of Newton's method.
        edge: Of what goes down in energy, why nothing is where that leads, ``NOT_RUN`` where that is not why it ended.
    """

    point: Point | None
    integrations: int
    iterations: int
    spent: bool
    contraction: float = np.inf
    edge: Status = Status.NOT_RUN


Request = At | Clamp | Judge | Weigh | Settle | Correct | Trace | Descend
Run = Generator[Request, Any, Any]
