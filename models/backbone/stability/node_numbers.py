"""How many nodes a pass has that tells of stability."""

from functools import cache
from math import ceil
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from multirod.validation import FloatArray

if TYPE_CHECKING:
    from multirod.models.backbone.problem import BackboneProblem

FEWEST_NODES = 9
APART = 4  # segments, by which numbers of few nodes differ: what poses close by call for is mostly the same then


@cache
def _divisors(steps: int) -> NDArray[np.int_]:
    return np.array([part for part in range(1, steps + 1) if steps % part == 0])


def nodes_for(problem: "BackboneProblem", segments: FloatArray) -> NDArray[np.int_]:
    """Numbers of nodes for more than so many segments, evenly spaced: where some number of equal steps ends, if that can be;
    else one more than a power of two, as well for several rods, which end steps themselves, where these are fewer."""
    fewest = np.maximum(segments + 1e-6, FEWEST_NODES - 1)
    result = 2 ** np.ceil(np.log2(fewest)).astype(int)
    steps = problem.integrator.steps
    if steps is not None:
        parts = _divisors(steps)
        place = np.searchsorted(parts, fewest)
        equal = np.where(place < len(parts), parts[np.minimum(place, len(parts) - 1)], result)
        result = equal if len(problem.rods) == 1 else np.minimum(equal, result)
    return np.asarray(1 + result)


def number_for(problem: "BackboneProblem", segments: float, *, few: bool) -> int:
    """The same of one number of segments; or ``few``, where it does not matter how they are spaced."""
    result = int(nodes_for(problem, np.array(segments)))
    return min(result, 1 + APART * ceil((segments + 1e-6) / APART)) if few else result
