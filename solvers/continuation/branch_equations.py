"""What a branch of equilibria is told by: an integration from the base, or, in ``solvers/segments``, segments."""

from abc import ABC, abstractmethod

import numpy as np

from multirod.problem import BoundaryProblem
from multirod.stability import Modes, modes_of
from multirod.validation import FloatArray


class BranchEquations(ABC):
    """Equations of one instance whose inputs are ``start + factor * rate``, in ``size`` numbers [1/m] and the load factor.

    Args:
        problem: With one instance and one direction.
        start: Inputs where the load factor is 0, shape (input_count,).
        rate: Their change by the load factor, shape (input_count,).

    Attributes:
        size: How many equations and numbers there are.
        in_segments: Whether the unknowns alone need not lead to the tip.
    """

    size: int
    in_segments = False

    def __init__(self, problem: BoundaryProblem, start: FloatArray, rate: FloatArray) -> None:
        self.problem, self.start, self.rate = problem, start, rate
        problem.directions.assign(rate[None, None, :])

    def put(self, factor: float) -> None:
        """Have the problem at the inputs there."""
        self.problem.write("inputs", self.start + factor * self.rate)

    def spend(self) -> None:
        """Take an integration out of the problem's budget."""
        if self.problem.budget is not None:
            self.problem.budget.spend(1)

    @abstractmethod
    def numbers(self, unknowns: FloatArray) -> FloatArray:
        """Those of the equilibrium where the branch begins, whose unknowns are (n,); shape (size,)."""

    @abstractmethod
    def unknowns(self, numbers: FloatArray) -> FloatArray:
        """Unknowns of the problem, shape (n,)."""

    @abstractmethod
    def evaluate(self, numbers: FloatArray, factor: float) -> tuple[FloatArray | None, FloatArray]:
        """Residual [1/m], (size,), None where an integration failed; its derivative by numbers and factor, (size, size + 1)."""

    @abstractmethod
    def modes(self) -> Modes:
        """Those where it was evaluated last."""


class FromBase(BranchEquations):
    """Numbers are the unknowns, and the residual is that at the tip."""

    def __init__(self, problem: BoundaryProblem, start: FloatArray, rate: FloatArray) -> None:
        super().__init__(problem, start, rate)
        self.size = problem.unknown_count

    def numbers(self, unknowns: FloatArray) -> FloatArray:  # noqa: D102
        return unknowns

    def unknowns(self, numbers: FloatArray) -> FloatArray:  # noqa: D102
        return numbers

    def evaluate(self, numbers: FloatArray, factor: float) -> tuple[FloatArray | None, FloatArray]:  # noqa: D102
        self.put(factor)
        residual, gamma = self.problem.evaluate(numbers[None])
        if not np.isfinite(residual).all():
            return None, gamma
        slope = np.array(self.problem.residual_directions.numpy())[0]
        return residual[0], np.concatenate([gamma[0], slope], axis=1)

    def modes(self) -> Modes:  # noqa: D102
        self.spend()
        return modes_of(self.problem)
