"""The pose's derivatives where an integration leaves all that they take; (D1) of ``docs/derivatives.md``."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import warp as wp

from multirod.kernels.elimination_kernels import eliminate_unknowns
from multirod.kernels.shared import Shared
from multirod.launch import record
from multirod.problem import BoundaryProblem
from multirod.validation import FloatArray

POSE = 6


class Eliminated:
    """What is left of the pose's columns by all directions of a problem once the unknowns follow."""

    def __init__(self, problem: BoundaryProblem) -> None:
        count, n, k, device = problem.instance_count, problem.unknown_count, problem.residual_directions.shape[2], problem.device
        room: list[Any] = [wp.zeros((count, n, size), dtype=wp.float64, device=device) for size in (n, k)]
        self._left = Shared((count, POSE, k), wp.float64, device)
        arguments = [problem.gamma, problem.residual_directions, problem.pose_columns, *room, self._left.array]
        self._launch = record(eliminate_unknowns, count, arguments, device)

    def find(self) -> FloatArray:
        """Of the last integration, shape (instance_count, 6, k); NaN where ``Gamma`` is singular to rounding."""
        self._launch.launch()
        return np.array(self._left.fetched())


def pose_derivative(problem: BoundaryProblem, names: Sequence[str]) -> FloatArray | None:
    """(D1) By inputs and parameters, shape (instance_count, 6, k), in one integration; None, and none is done, where more is to
    be looked at than what it leaves in place."""
    problem.eliminates, found = True, None
    if problem.leaves_columns(*names):
        left = problem.tool("eliminated", lambda: Eliminated(problem))  # compiled, the first time, at once with the integration
        problem.part_ends(names)
        problem.integrate_along(*names)
        found = left.find()
    problem.eliminates = False  # after an error it is not used again
    return found
