"""What only some boundary problems can do: each capability is an object that a problem offers, or None.

A solver asks ``problem.starts is not None`` and goes on without, or says in ``unsupported`` that it needs it. Others are in
``multirod.segments``, for multiple shooting, ``multirod.stability`` and ``multirod.out_of_reach``.
"""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
from numpy.typing import NDArray

from multirod.batch import IntArray
from multirod.status import Status
from multirod.validation import FloatArray

if TYPE_CHECKING:
    from multirod.problem import BoundaryProblem, Shape


class Bending(Protocol):
    """How bent the backbones of one instance are, all rods on one of which bend alike, and how that varies at two places."""

    def jumps(self) -> FloatArray:
        """Arclengths on each backbone where its curvature may jump [m], its tip among them, shape (backbone, count), NaN where
        another has more."""

    def survey(self) -> tuple[FloatArray, FloatArray]:
        """At the problem's unknowns: arclengths of nodes evenly from base to tip [m], shape (backbone, node), and ``u_xy`` there
        [1/m], (backbone, node, 2); to be read at once."""

    def integrate(self, places: FloatArray) -> None:
        """An integration of the problem, which looks at ``places`` (backbone, 2) too, rising arclengths > 0."""

    def at_places(self, names: Sequence[str], backbone: int) -> tuple[FloatArray, FloatArray]:
        """``u_xy`` at the two places on one, shape (2, 2), and its derivatives by the unknowns, then by each number that the
        problem is aimed at by ``names``, arclength and unknowns fixed, (2, 2, n + k)."""


class Shapes(ABC):
    """The rods between base and tip: what ``solution.rod(...)`` and ``solution.energy`` are read from."""

    @abstractmethod
    def at_nodes(self, node_count: int) -> "tuple[tuple[Shape, ...], FloatArray]":
        """Shape of each rod at the problem's ``unknowns``, and the elastic energy [J], shape (instance_count,)."""

    def jumps(self) -> tuple[FloatArray, ...]:
        """Arclengths of each rod where its curvature may jump between nodes [m], (instance_count, count); none by default."""
        return ()

    def bending(self, node_count: int) -> "Bending | None":
        """What tells how bent rods are at so many nodes, of one instance; None, as by default, where ``at_nodes`` is to."""
        return None


class Lines(ABC):
    """What lines along the rods do, in the order of the rods and their lines."""

    @abstractmethod
    def length(self) -> FloatArray:
        """How long each line is [m], shape (instance_count, line_count)."""

    @abstractmethod
    def tension(self) -> FloatArray:
        """What it pulls with [N], negative where it pushes, shape (instance_count, line_count)."""

    @abstractmethod
    def slack(self) -> NDArray[np.bool_]:
        """Whether it hangs loose, shape (instance_count, line_count)."""

    def left(self, node_count: int) -> FloatArray:
        """The part of its tension that friction leaves at nodes evenly spaced along its rod, shape (instance_count, line_count,
        node_count)."""
        return np.ones((*self.tension().shape, node_count))

    def beyond(self) -> NDArray[np.bool_]:
        """Whether it is so tight, with those beside it, that its law does not hold, shape (instance_count, line_count)."""
        return np.zeros(self.tension().shape, dtype=bool)

    def length_columns(self, *names: str) -> FloatArray:
        """Derivatives of the lengths after ``BoundaryProblem.input_columns(*names)``, by unknowns then each number of the inputs,
        shape (instance_count, line_count, n + size)."""
        raise NotImplementedError(f"{type(self).__name__} does not give the derivatives of lengths")

    def tension_columns(self, *names: str) -> FloatArray:
        """The same of ``tension()``, [N] per unit."""
        raise NotImplementedError(f"{type(self).__name__} does not give the derivatives of tensions")


class Starts(ABC):
    """Guesses that cover where equilibria may lie, for the search from many starts (``mr.equilibria``)."""

    @property
    @abstractmethod
    def signs_add_up(self) -> bool:
        """Whether the signs of ``det Gamma`` over all equilibria add up to that of the unloaded one (``docs/stability.md``)."""

    @abstractmethod
    def guesses(self, count: int, first: int = 0) -> FloatArray:
        """Those from number ``first`` on of an endless sequence that lies the closer the longer it is [1/m], shape (count,
        instance_count, n)."""


class Parts(ABC):
    """Problems of some of the instances: what takes long for a few takes no time for the others there.

    ``BoundaryProblem.keep`` brings back what came of one.
    """

    @abstractmethod
    def of(self, instances: IntArray, *, double: bool = False, poses: bool = False) -> "BoundaryProblem":
        """A problem of these instances, (k,), at their present inputs and unknowns; with ``double`` in double precision, with
        ``poses`` with the columns of the pose."""

    @property
    def may_be_finer(self) -> bool:
        """Whether ``finer`` is offered."""
        return type(self).finer is not Parts.finer

    def finer(self, instances: IntArray, *, poses: bool = False) -> "BoundaryProblem | None":
        """The same, its integration as exact as rounding lets it be; None where that is not offered, or it is so already."""
        return None

    def kinds(self, instances: IntArray) -> "list[IntArray]":
        """Instances, (k,), by how finely ``followed`` integrates them, which depends on those alone that it is asked for."""
        return [instances]

    def followed(self, instances: IntArray, times: int = 1) -> "BoundaryProblem":
        """The problem by which branches of instances of one kind are followed, (k,), with the columns of the pose; where that is
        at equal steps, at so many ``times`` as many."""
        return self.finer(instances, poses=True) or self.of(instances, double=True, poses=True)

    def steps_followed(self, instances: IntArray) -> int:
        """Equal steps from base to tip by which ``followed`` integrates; 0 where step control does, or that is not told."""
        return 0

    def eased(self, instance: int) -> "BoundaryProblem | None":
        """(36) of ``docs/held.md``: a problem of one, which twists more, its unknowns the same; None where it twists as it is."""
        return None

    @property
    def may_be_clamped(self) -> bool:
        """Whether ``clamped`` is offered wherever branches end; several rods on one line may be clamped in motions alone."""
        return False

    @property
    def loads_alone(self) -> "NDArray[np.bool_] | bool":
        """Of which instances nothing but loads is raised on the path from ``guess``, though these may have several equilibria
        without any, shape (instance_count,): where that ends is followed. None by default."""
        return False

    @property
    def all_clamped(self) -> bool:
        """Whether it clamps all rods so: those that it leaves out may have modes of their own."""
        return self.may_be_clamped

    @property
    def clampings(self) -> int:
        """In how many ways ``clamped`` can, each with more rods than the one before it; the first is the one that may be wherever
        branches end, if any may."""
        return int(self.may_be_clamped)

    def clamped(self, instances: IntArray, pieces: int, times: int = 1, clamping: int = 0) -> "BoundaryProblem":
        """A problem of these instances, (k,), with ``clamps`` that cut each rod that can be, by one of the ``clampings``, into so
        many pieces, as exact as it can be and with the columns of the pose, at as many steps as ``followed``."""
        raise NotImplementedError(f"{type(self).__name__} does not clamp rods")


class Loading(IntEnum):
    """How loads act while an assembly is put together, ``load_factor`` from 0 to 1: in proportion, not at all, or all of them."""

    RISING = 0
    NONE = 1
    FULL = 2


@dataclass(frozen=True)
class Together:
    """An assembly without loads, put together from rods at rest.

    Attributes:
        unknowns: [1/m], shape (instance_count, n).
        sound: Where it did so on one branch; the others are to be put together step by step, shape (instance_count,).
        near: Whether loads may rise as what is left of the residual closes; else that is to close first, shape (instance_count,).
        integrations: That it took, shape (instance_count,).
    """

    unknowns: FloatArray
    sound: NDArray[np.bool_]
    near: NDArray[np.bool_]
    integrations: NDArray[np.integer[Any]]


class Joints(ABC):
    """Joints that may be taken apart: another way to the natural branch, from legs that nothing holds."""

    @abstractmethod
    def apart(self, numbers: IntArray | None = None) -> FloatArray:
        """Unknowns [1/m] of the assembly taken apart, shape (instance_count, n), and the joints opened there.

        They are an equilibrium at a ``load_factor`` of 0; as it goes to 1 the assembly is put together.

        Args:
            numbers: Of an endless sequence of places to put it together at, 0 the best, shape (instance_count,); 0 by default.
        """

    @abstractmethod
    def open(self, unknowns: FloatArray) -> None:
        """Make ``unknowns`` (instance_count, n) an equilibrium at a ``load_factor`` of 0: the residual closes on the way to 1."""

    def together(self) -> Together | None:
        """The assembly put together at once, which a ``load_factor`` of 0 leaves where it is; None where that is ``guess``."""
        return None

    @abstractmethod
    def close(self, loading: Loading) -> None:
        """How loads act from now on while ``load_factor`` goes to 1."""

    @abstractmethod
    def shut(self, some: NDArray[np.bool_] | None = None) -> None:
        """Forget what the residual was, of ``some`` instances or all: they are together whatever ``load_factor`` is."""

    @abstractmethod
    def unloaded_inputs(self) -> FloatArray | None:
        """Rows of ``inputs`` without their loads, shape (instance_count, input_count); None where rows cannot say that."""


class Released(ABC):
    """Assemblies that inputs hold at places, let go, k instances in ``problem``: another way to begin, from where they rest."""

    problem: "BoundaryProblem"

    @abstractmethod
    def held(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Equilibria as those of what is held: inputs (k, input_count), unknowns (k, n), how far from the inputs given (k,)."""


class ResultTest(ABC):
    """Tests what any solver finds: where ``Gamma`` does not tell that stability is lost, or results have limits.

    ``integrations`` is how many it takes for what is settled.
    """

    integrations = 0

    @abstractmethod
    def refusals(self, settled: NDArray[np.bool_]) -> NDArray[np.int32]:
        """The ``Status`` by which what is at ``unknowns`` is no result, shape (instance_count,); ``NOT_RUN`` where it is one.

        What is ``settled`` is an equilibrium within the tolerance, the others are estimates or have failed.
        """


class LineTest(ResultTest):
    """Of a problem whose ``lines`` may be beyond what their law holds for."""

    def __init__(self, lines: Lines) -> None:
        self.lines = lines

    def refusals(self, settled: NDArray[np.bool_]) -> NDArray[np.int32]:  # noqa: D102
        return np.where(self.lines.beyond().any(axis=1), Status.LINE_LIMIT, Status.NOT_RUN).astype(np.int32)


@dataclass(frozen=True)
class Reduced:
    """The potential energy by the displacements of a problem's forces, to second order, where its constraints hold.

    ``m`` displacements in units of ``Conjugates.scale``; the change of the unknowns is ``towards + by @ step``.

    Attributes:
        gradient: [N m], shape (instance_count, m).
        form: Its derivative, symmetric at an equilibrium if loads have a potential [N m], shape (instance_count, m, m).
        by: Unknowns by displacements, the constraints kept, shape (instance_count, n, m).
        towards: Step of the unknowns on to the constraints [1/m], shape (instance_count, n).
    """

    gradient: FloatArray
    form: FloatArray
    by: FloatArray
    towards: FloatArray


class Conjugates(ABC):
    """Residuals that are generalised forces, and the displacements they do work on: what energy descent needs.

    With these displacements held, what is at ``unknowns`` is the equilibrium, and ``unit * residual`` the gradient of its
    potential energy by them (``docs/energy_descent.md``). The other residuals are constraints, which hold whatever the energy: a
    tip is where its platform is, a line as long as it is to be.

    Attributes:
        forces: Rows of the residual that are forces, shape (m,).
        unit: Force of one unit of each [N m^2, or N m for a force], shape (instance_count, m).
        columns: How its displacement changes by the unknowns, then along the directions [rad, or m], shape (instance_count, m,
            n + direction_count).
        scale: What counts as one in each: 1 of an angle [rad], the length of a position [m], shape (instance_count, m).
        stiffness: What counts as one in the stiffness of the displacements so scaled, ``K/L`` [N m], shape (instance_count,).
        give: Where what is rigid is made to give a little: row of the residual, unknown, and what is added to that of
            ``columns``, or of ``Gamma``, one number or shape (instance_count,).
        without: Numbers of a row of ``inputs`` whose loads have no potential where they are not zero.
        has_potential: Whether everything else has one.
    """

    forces: IntArray
    unit: Any
    columns: Any
    scale: Any
    stiffness: FloatArray
    give: "tuple[tuple[int, int, float | FloatArray], ...]" = ()
    without: "tuple[int, ...]" = ()
    has_potential: bool = True

    def natural(self) -> FloatArray:
        """The least stiffness of the displacements far from any fold, over ``stiffness``, 1 or less, shape (instance_count,): how
        near a fold is, is judged against it. It may integrate."""
        return np.ones_like(self.stiffness)

    @abstractmethod
    def update(self) -> None:
        """After an integration: ``unit`` and ``columns`` as they are there."""

    def reduced(self, problem: "BoundaryProblem") -> Reduced:
        """(2), (3), (10), (11) of ``docs/energy_descent.md`` after an integration of ``problem``, whose these are."""
        self.update()
        n, m, rows = problem.unknown_count, len(self.forces), np.asarray(self.forces)
        residual, gamma = problem.read("residual"), problem.read("gamma").reshape(-1, n, n)
        system, sides = np.array(gamma), np.zeros((*residual.shape, m + 1))
        system[:, rows] = self.columns.numpy()[:, :, :n]
        for row, unknown, by in self.give:
            system[:, row, unknown] += by
        sides[..., m] = -residual
        sides[:, rows, m] = 0.0
        sides[:, rows, range(m)] = self.scale.numpy()
        sides = np.asarray(np.linalg.solve(system, sides), dtype=np.float64)
        force = self.unit.numpy() * self.scale.numpy()
        followed = gamma[:, rows] @ sides
        gradient = force * (residual[:, rows] + followed[..., m])
        return Reduced(gradient, force[:, :, None] * followed[..., :m], sides[..., :m], sides[..., m])

    def seen_from(self, problem: "BoundaryProblem") -> "Conjugates | None":
        """The same pairs of a problem around this one, by the pose of its end effector; None where that does not tell them."""
        return None


class Clamps(ABC):
    """Clamps at places along rods, that hold how these are turned by moments, which are unknowns beside those of the problem.

    With these and its ends held a rod has no mode of its own that could vanish: how they turn tells all (``docs/branches.md``).

    Attributes:
        size: Moments of all clamps, which stand among the directions of the problem.
        first: The first of each clamp, shape (clamp,).
        unit: Moment of one unit of each [N m^2], shape (instance_count, size).
        blocks: Of each, the block of the problem's ``arrow`` that alone it meets, the last one aside, (size,); None if not known.
    """

    size: int
    unit: FloatArray
    blocks: IntArray | None = None

    @property
    def first(self) -> IntArray:
        """As said: three of each clamp, if not otherwise."""
        return np.arange(0, self.size, 3)

    @property
    @abstractmethod
    def pairs(self) -> Conjugates:
        """Which residuals are forces, and what they do work on."""

    @abstractmethod
    def put(self, moments: FloatArray) -> None:
        """Let the next integration add these to the internal moment, in the axes of the rod at each clamp [1/m], shape
        (instance_count, size)."""

    @abstractmethod
    def turned(self) -> FloatArray:
        """After an integration: how the clamps are turned, in their own axes, by the unknowns, then by the moments [rad m], shape
        (instance_count, size, n + size)."""

    @abstractmethod
    def moved(self) -> FloatArray:
        """How they move, in the world [m^2], shape (instance_count, clamp, 3, n + size)."""

    def give(self) -> FloatArray | None:
        """After an integration: how the residuals would change by the unknowns if what holds the end of each rod gave way to the
        force on it by ``L^3/EI`` times that, shape (instance_count, n, n); None where nothing holds it."""
        return None

    def costless(self) -> tuple[FloatArray, FloatArray] | None:
        """After an integration: how a turn of all of it that costs nothing turns what ``pairs`` does work on and the clamps, per
        radian, shape (instance_count, m), zero where there is none; and the unknowns turned so to where the problem without
        clamps wants them, shape (instance_count, n). None where nothing ever has such a turn."""
        return None

    @abstractmethod
    def frames(self) -> FloatArray:
        """Frames of the rods there, in the world, shape (instance_count, clamp, 3, 3)."""
