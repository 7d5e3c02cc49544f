"""Samples of an estimator in which lines turn slack or taut. Numbers in parentheses: ``docs/estimation.md``."""

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from multirod.status import Status
from multirod.tasks.estimating.kinked import ASIDE
from multirod.validation import FloatArray

if TYPE_CHECKING:
    from multirod.tasks.estimating.filtering import FilterTrack

PASSES = 4  # updates of a sample, beside the first


def crossed(track: "FilterTrack", begun: FloatArray, once: NDArray[np.int32]) -> NDArray[np.int32]:
    """(27) Make the update of a sample again with the lines on the sides of their kinks that it leads them to.

    Args:
        track: After that update.
        begun: Unknowns that it was made at (b, n).
        once: Integrations that it took, shape (b,).

    Returns:
        How many it took in all, shape (b,), ``once`` where it took no other.
    """
    known, problem, spent = track.known, track.problem, once
    K, first = problem.kinks, begun[:, problem.kinks] > 0
    sides, across, doubtful = first, np.zeros_like(first), np.zeros_like(first)
    going = known.begun != 0
    for _ in range(PASSES):
        there = (known.status == Status.TRACKING) & going
        led = ((problem.read("unknowns")[:, K] > 0) != sides) & ~doubtful & there[:, None]
        wanted = np.where(led, ~sides & ~across, sides)  # neither side leads to itself: the less sure one is taken, slack
        doubtful, across = doubtful | (led & across), across | led
        chosen = (wanted != sides).any(axis=1)
        if not chosen.any():
            break
        sides = wanted
        scale = problem.curvature_scale()[:, None]
        x = begun.copy()
        x[:, K] = np.where(sides == first, x[:, K], np.where(sides, 1.0, -1.0) * ASIDE * scale)
        x = np.where(chosen[:, None], x, problem.read("unknowns"))
        track.task.write(x, np.where(chosen[:, None], known.state["prior"].values, known.mean))
        track.again(np.flatnonzero(chosen))
        spent = spent.copy()
        spent[chosen] += 1
    return spent
