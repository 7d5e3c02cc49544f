"""Instances as problems of another kind, whose rods are in pieces along which errors grow less."""

from abc import ABC, abstractmethod
from typing import TYPE_CHECKING

from multirod.batch import IntArray
from multirod.validation import FloatArray

if TYPE_CHECKING:
    from multirod.problem import BoundaryProblem


class InPieces(ABC):
    """One instance of a problem as another ``problem``, whose rods are in pieces."""

    problem: "BoundaryProblem"

    @abstractmethod
    def unknowns(self) -> FloatArray:
        """Where ``problem`` is now, as the unknowns of the one that it stands for, shape (n,)."""


class CutUp(ABC):
    """Makes these, for an assembly."""

    @abstractmethod
    def of(self, instances: IntArray) -> "CutUp":
        """The same for a part of the problem, some of its instances, shape (k,)."""

    @abstractmethod
    def cut(self, problem: "BoundaryProblem", instance: int, unknowns: FloatArray) -> InPieces | None:
        """An instance of ``problem``, cut where it is pulled at some ``unknowns`` (n,); None where nothing is to be cut, or may
        be."""
