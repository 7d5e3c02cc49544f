"""Whether an equilibrium is stable, and by how much."""

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from multirod.batch import Instances, IntArray
from multirod.codes import Code, Codes
from multirod.validation import FloatArray

if TYPE_CHECKING:
    from multirod.problem import BoundaryProblem

NEUTRAL = 1e-6  # of stiffness over length: a mode no stiffer than this is neutral


class Stability(Code):
    """Whether an equilibrium is a minimum of the total potential energy (``docs/stability.md``). Never renumbered.

    ``UNKNOWN``: the loads have no potential (a moment on the tip or along the rod, a load that follows the tip, a measured
    tip curvature) and nothing shows that the state is unstable, several tubes are rigid in torsion, rounding hides the answer, or
    the assembly offers none. ``FOLD``: no mode is unstable that can be told from a neutral one, and one cannot be told from
    neutral. ``UNSTABLE`` also where loads have no potential and an odd number of modes grow without oscillating; the index is
    then -1.
    """

    UNKNOWN = 0
    STABLE = 1
    FOLD = 2
    UNSTABLE = 3


class Stabilities(Codes):
    """An array of the values of ``Stability``: ``stabilities[k].name``."""

    kind = Stability


@dataclass(frozen=True)
class Modes:
    """The second variation of the energy of each equilibrium, condensed to where rods meet or end.

    Its eigenvalues in ascending order are ``hidden`` ones that are negative however large, then ``values``; where ``hidden`` is
    negative, the lowest ``-hidden`` of ``values`` belong to constraints and are left out.

    Attributes:
        values: Eigenvalues of the condensed form over ``K/L``, ascending, infinite where there are fewer, shape (batch, count).
        hidden: Unstable modes that the condensed form does not show, less its constraints, shape (batch,).
        uncertainty: Of each value: how far the form is from being symmetric, as it is for exact columns, in the direction of its
            eigenvector, over ``K/L``, shape (batch, count).
        known: Whether the above can be said, shape (batch,).
        diverging: Whether loads without a potential drive an odd number of modes away, shape (batch,).
        neutral_below: The size below which each value is taken for a neutral mode's, over ``K/L``, shape (batch, count):
            ``NEUTRAL``, which is the default, or less where it belongs to a constraint that hardly gives way.
    """

    values: FloatArray
    hidden: NDArray[np.int32]
    uncertainty: FloatArray
    known: NDArray[np.bool_]
    diverging: NDArray[np.bool_]
    neutral_below: FloatArray = None  # type: ignore[assignment]  # an array from the start

    def __post_init__(self) -> None:
        if vars(self)["neutral_below"] is None:
            object.__setattr__(self, "neutral_below", np.full(self.values.shape, NEUTRAL))

    @classmethod
    def unknown(cls, batch: int, count: int = 1) -> "Modes":
        """Modes of which nothing is known yet."""
        return cls(
            np.full((batch, count), np.nan),
            np.zeros(batch, dtype=np.int32),
            np.full((batch, count), np.nan),
            np.zeros(batch, dtype=bool),
            np.zeros(batch, dtype=bool),
        )

    def put(self, chosen: NDArray[np.bool_], other: "Modes") -> None:
        """Take the instances ``chosen`` from ``other``."""
        for name, mine in vars(self).items():
            mine[chosen] = getattr(other, name)[chosen]

    def take(self, instances: Instances | list[int]) -> "Modes":
        """Those of some instances, by an index of the first axis."""
        return Modes(*(values[instances] for values in vars(self).values()))

    @property
    def _soft(self) -> NDArray[np.bool_]:
        """Which values cannot be told from zero."""
        with np.errstate(invalid="ignore"):
            return np.asarray(np.abs(self.values) <= self.neutral_below + self.uncertainty)

    @property
    def soft(self) -> NDArray[np.intp]:
        """How many modes cannot be told from neutral ones, shape (batch,)."""
        return np.asarray(self._soft.sum(axis=1))

    @property
    def neutral(self) -> NDArray[np.bool_]:
        """Whether a mode cannot be told from a neutral one, shape (batch,)."""
        return np.asarray(self.known & self._soft.any(axis=1))

    @property
    def index(self) -> NDArray[np.int32]:
        """Unstable modes that can be told from neutral ones, -1 where they are not known, shape (batch,)."""
        return self._index(self._soft)

    def _index(self, soft: NDArray[np.bool_]) -> NDArray[np.int32]:
        with np.errstate(invalid="ignore"):
            negative = ((self.values < 0) & ~soft).sum(axis=1)
        # a neutral mode among the lowest values takes the place of a constraint's
        return np.where(self.known, np.maximum(self.hidden + negative, 0), -1).astype(np.int32)

    def eigenvalue(self, k: int) -> FloatArray:
        """Eigenvalue ``k`` of the second variation, 0 the lowest, over ``K/L``, shape (batch,); ``-inf`` where it is hidden."""
        place = k - self.hidden
        last = self.values.shape[1] - 1
        value = np.take_along_axis(self.values, np.clip(place, 0, last)[:, None], 1)[:, 0]
        value = np.where(place < 0, -np.inf, np.where(place > last, np.inf, value))
        return np.where(self.known, value, np.nan)

    @property
    def stability(self) -> NDArray[np.int32]:
        """Values of ``Stability``, shape (batch,)."""
        soft = self._soft
        index = self._index(soft)
        result = np.where(self.known & soft.any(axis=1), int(Stability.FOLD), int(Stability.STABLE))
        result = np.where(index > 0, int(Stability.UNSTABLE), result)
        result = np.where(index < 0, int(Stability.UNKNOWN), result)
        return np.where(self.diverging, int(Stability.UNSTABLE), result).astype(np.int32)

    @property
    def left(self) -> NDArray[np.bool_]:
        """Whether a robot would leave the equilibrium, or that cannot be told from one which it would, shape (batch,)."""
        return np.asarray(np.isin(self.stability, (Stability.UNSTABLE, Stability.FOLD)))


class StabilityAnalysis(ABC):
    """What a boundary problem knows of the stability of its equilibria: those at its ``unknowns``, and how they lie.

    A problem that offers none is taken for one whose natural branch begins stable and has no other near it; its results have no
    ``stability`` and no ``potential``.
    """

    @abstractmethod
    def modes(self) -> Modes:
        """The second variation of the energy of the equilibria at ``unknowns``; it may take integrations."""

    def expect(self) -> None:  # noqa: B027  (some launch nothing)
        """Have what ``modes`` launches compiled in the background, as what is sure to be asked for."""

    @property
    @abstractmethod
    def has_potential(self) -> NDArray[np.bool_]:
        """Whether the loads derive from a potential, shape (instance_count,)."""

    @abstractmethod
    def potential(self) -> FloatArray:
        """Total potential energy at ``unknowns`` [J], shape (instance_count,): elastic energy less the work of dead forces.

        NaN where the loads have no potential.
        """

    @property
    def multistable(self) -> bool:
        """Whether there are several equilibria even unloaded, so that where the natural branch ends, another stable one is
        meant."""
        return False

    @property
    def guess_is_stable(self) -> bool:
        """Whether ``guess`` is a stable equilibrium of the unloaded assembly; where not, what it leads to is tested."""
        return True

    def mode_bounds(self) -> FloatArray | None:
        """Where the first is less than 1, the assembly has no unstable mode in any configuration; where the second is, no more
        than one. Shape (instance_count, 2); None for what the loads say of columns.
        """
        return None

    @property
    def may_jump(self) -> bool:
        """Whether paths begin at a stable equilibrium among several: a step may then end at another, and its ends not tell."""
        return self.multistable and self.guess_is_stable

    def surely_stable(self) -> bool:
        """Whether all that is at ``unknowns`` is stable beyond doubt, which ``modes`` would take longer to say; False, as by
        default, says nothing."""
        return False

    def lowest(self) -> FloatArray | None:
        """``eigenvalue(0)`` of the ``modes`` at ``unknowns``, near which the last integration was, shape (instance_count,), where
        it is told sooner; None, as by default, says nothing."""
        return None

    def unstable(self) -> NDArray[np.bool_]:
        """Whether what is at ``unknowns`` is known to be unstable, shape (instance_count,)."""
        return np.asarray(self.modes().stability == Stability.UNSTABLE)


def modes_of(problem: "BoundaryProblem", rows: IntArray | None = None) -> Modes:
    """Those at ``unknowns``, of all instances or of some; unknown where the problem has no stability to offer."""
    if rows is not None and len(rows) < problem.instance_count:
        return modes_of(problem).take(rows) if problem.parts is None else modes_of(problem.parts.of(rows))
    return Modes.unknown(problem.instance_count) if problem.stability is None else problem.stability.modes()
