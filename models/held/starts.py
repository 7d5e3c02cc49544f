"""Many starts for a held rod: base moments and forces that its equilibria can have."""

from typing import TYPE_CHECKING

import numpy as np

from multirod.capabilities import Starts
from multirod.models.backbone.starts import quasirandom
from multirod.validation import FloatArray

if TYPE_CHECKING:
    from multirod.models.held.problem import HeldProblem

BEND, THRUST = 2 * np.pi, 8 * np.pi**2  # most of a start: in 1/L, as of a rod that turns once, and in EI/L^2
CROWDING = 1.5  # most equilibria are far inside the bounds


class HeldStarts(Starts):
    """Of a ``HeldProblem``; its ends close a loop, so equilibria need not come in pairs."""

    def __init__(self, problem: "HeldProblem") -> None:
        self.problem = problem

    @property
    def signs_add_up(self) -> bool:  # noqa: D102
        return False

    def guesses(self, count: int, first: int = 0) -> FloatArray:
        """Base moments and forces around those of the rod at rest."""
        problem, n = self.problem, self.problem.rod.unknown_count
        points = quasirandom(np.arange(first, first + count), 6)[:, None]
        points = np.sign(points) * np.abs(points) ** CROWDING
        bend = np.maximum(BEND, problem.turning_angle())[:, None]
        result = np.zeros((count, problem.instance_count, problem.unknown_count))
        result[..., :3] = points[..., :3] * bend / problem.length[:, None]
        result[..., n - 3 : n] = points[..., 3:] * THRUST / problem.length[:, None]
        return result
