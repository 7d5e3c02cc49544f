"""Whether an equilibrium is stable."""

from enum import IntEnum
from typing import Any

import numpy as np
from numpy.typing import NDArray


class Stability(IntEnum):
    """Whether an equilibrium is a minimum of the total potential energy (``docs/stability.md``). Never renumbered.

    ``UNKNOWN``: the loads have no potential (a moment on the tip or along the rod, a load that follows the tip, a measured
    tip curvature), torsion is rigid, rounding hides the answer, or the assembly offers none. ``FOLD``: no mode is unstable
    that can be told from a neutral one, and one cannot be told from neutral.
    """

    UNKNOWN = 0
    STABLE = 1
    FOLD = 2
    UNSTABLE = 3

    def __str__(self) -> str:
        return self.name


def classify(index: NDArray[np.integer[Any]], neutral: NDArray[np.bool_]) -> NDArray[np.int32]:
    """Values of ``Stability`` from the number of unstable modes (-1: unknown) and whether a further mode is neutral."""
    result = np.where(neutral, int(Stability.FOLD), int(Stability.STABLE))
    result = np.where(index > 0, int(Stability.UNSTABLE), result)
    return np.where(index < 0, int(Stability.UNKNOWN), result).astype(np.int32)
