"""Samples of an estimator in which lines turn slack or taut. Numbers in parentheses: ``docs/estimation.md``."""

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from multirod.batch import IntArray
from multirod.status import Status
from multirod.tasks.estimating.kinked import ASIDE
from multirod.validation import FloatArray

if TYPE_CHECKING:
    from multirod.tasks.estimating.filtering import FilterTrack

PASSES = 4  # updates of a sample, beside the first


class Crossing:
    """(27) Makes the update of a sample again with the lines on the sides of their kinks that it leads them to.

    Args:
        track: After the integration of a sample, before its update.
    """

    def __init__(self, track: "FilterTrack") -> None:
        self._track, self._problem = track, track.problem
        self._x = np.array(self._problem.read("unknowns"))
        self._before = {name: own.values.copy() for name, own in track.known.state.items()}

    def run(self, once: NDArray[np.int32]) -> NDArray[np.int32]:
        """After the update; how many integrations each instance took in all, (b,), ``once`` where it took no other."""
        known, K, spent = self._track.known, self._problem.kinks, once
        begun = self._x[:, K] > 0
        sides, crossed, doubtful = begun, np.zeros_like(begun), np.zeros_like(begun)
        for _ in range(PASSES):
            there = (known.status == Status.TRACKING) & (self._before["begun"] != 0)
            led = ((self._problem.read("unknowns")[:, K] > 0) != sides) & ~doubtful & there[:, None]
            wanted = np.where(led, ~sides & ~crossed, sides)  # neither side leads to itself: the less sure one is taken, slack
            doubtful, crossed = doubtful | (led & crossed), crossed | led
            rows = np.flatnonzero((wanted != sides).any(axis=1))
            if not len(rows):
                break
            sides = wanted
            scale = self._problem.curvature_scale()[:, None]
            x = self._x.copy()
            x[:, K] = np.where(sides == begun, x[:, K], np.where(sides, 1.0, -1.0) * ASIDE * scale)
            self._again(rows, x)
            spent = spent.copy()
            spent[rows] += 1
        return spent

    def _again(self, rows: IntArray, x: FloatArray) -> None:
        """The update of some instances from what they began with, but for unknowns (b, n)."""
        track, known, chosen = self._track, self._track.known, np.zeros(len(x), dtype=bool)
        chosen[rows] = True
        for name, own in known.state.items():
            own.values[rows] = self._before[name][rows]
        others = {name: own.values[~chosen].copy() for name, own in known.state.items()}
        known.begun[~chosen] = 0  # they stay as they are
        track.task.write(np.where(chosen[:, None], x, self._problem.read("unknowns")), known.mean)
        with self._problem.only(chosen):
            track.task.integrate()
        track.update()
        for name, own in known.state.items():
            own.values[~chosen] = others[name]
            own.send()
