"""Problems that stand for instances of others: they are solved where these are not, and lead there."""

from abc import ABC, abstractmethod
from typing import TYPE_CHECKING

from multirod.batch import IntArray
from multirod.validation import FloatArray

if TYPE_CHECKING:
    from multirod.problem import BoundaryProblem


class StandIn(ABC):
    """One instance of a problem as another ``problem``, near whose equilibria its own are."""

    problem: "BoundaryProblem"

    @abstractmethod
    def unknowns(self) -> FloatArray:
        """Where ``problem`` is now, as the unknowns of the one that it stands for, shape (n,)."""


class StandIns(ABC):
    """Makes these, for an assembly."""

    @abstractmethod
    def of(self, instances: IntArray) -> "StandIns":
        """The same for a part of the problem, some of its instances, shape (k,)."""

    @abstractmethod
    def made(self, problem: "BoundaryProblem", instance: int, unknowns: FloatArray) -> StandIn | None:
        """For an instance of ``problem``, by what unknowns (n,) it came to say; None where there is none, or none would help."""
