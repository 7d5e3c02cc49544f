"""What goes down in energy without end: joints that turn on and on, and what slides away.

Numbers in parentheses are those of ``docs/branches.md``.
"""

import numpy as np
from numpy.typing import NDArray

from multirod.batch import IntArray
from multirod.problem import BoundaryProblem
from multirod.status import NOT_RUN, Status
from multirod.validation import FloatArray

DESCENT_STEPS = 150
AROUND = 25  # steps of a descent after which it is asked whether all comes to be as there, joints a turn further
WHOLE = 0.75  # of a turn, beyond which one may be whole
PASSES = 0.1  # of a step, by which it may pass where it was


class Rounds:
    """(26), (28) Which of many come by where they were, but that joints are whole turns further: they turn on and on; or slide
    away.

    Args:
        periods: By how much unknowns change in a turn, or minus how far they may slide, shape (k, m), of the first of them; as
            ``BoundaryProblem.periods``.
        unknowns: Where they begin [1/m], shape (k, n).

    Attributes:
        times: By how many times as many steps as others these may take.
    """

    def __init__(self, periods: FloatArray, unknowns: FloatArray) -> None:
        count, n = unknowns.shape
        every = np.full((count, n), np.inf)
        every[:, : periods.shape[1]] = periods
        self._told, self._slides = every != 0, every < 0
        self._periods = np.where(every > 0, every, np.inf)
        self._far = np.where(self._slides, -every, np.inf)
        self._first = self._before = np.array(unknowns)
        self._last = self._first
        self.times = 2 if (np.isfinite(self._periods) | self._slides).any() else 1

    def ends(self, problem: BoundaryProblem, sample: int) -> IntArray:
        """Which do at this sample: ``LOOSE``, or ``NOT_RUN`` of those that do not, shape (k,)."""
        unknowns = problem.read("unknowns")
        if sample in (AROUND, DESCENT_STEPS):
            self.since(unknowns)
        with np.errstate(invalid="ignore"):
            passed = self.passes(np.arange(len(unknowns)), self._last, unknowns)
        self._last = unknowns
        return np.where(passed, int(Status.LOOSE), NOT_RUN)

    def since(self, unknowns: FloatArray) -> None:
        """Ask of where they are now, from here on."""
        self._before = np.array(unknowns)

    def turning(self, unknowns: FloatArray) -> NDArray[np.bool_]:
        """Whose joints have turned or slid by half of that, shape (k,)."""
        every = np.arange(len(unknowns))
        return self._turned(every, unknowns, 0.5 * WHOLE) | self._slid(every, unknowns, 0.5)

    def passes(self, some: IntArray, last: FloatArray, unknowns: FloatArray) -> NDArray[np.bool_]:
        """Whether steps of some, from ``last``, shapes (m, n), pass where they were, or slide away, shape (m,)."""
        result = np.zeros(len(some), dtype=bool)
        if self.times == 1:
            return result
        for row in np.flatnonzero(self._turned(some, unknowns, WHOLE)).tolist():
            k = some[row]
            step, apart = (self._but_for_turns(k, unknowns[row] - own) for own in (last[row], self._before[k]))
            share = np.clip(apart @ step / max(float(step @ step), 1e-300), 0, 1)
            result[row] = np.linalg.norm(apart - share * step) <= PASSES * np.linalg.norm(step)
        for row in np.flatnonzero(~result & self._slid(some, unknowns, 1.0)).tolist():
            k = some[row]
            step = np.where(self._told[k], unknowns[row] - last[row], 0.0)
            result[row] = np.linalg.norm(step[~self._slides[k]]) <= PASSES * np.linalg.norm(step)
        return result

    def _slid(self, some: IntArray, unknowns: FloatArray, share: float) -> NDArray[np.bool_]:
        return np.asarray((np.abs(unknowns - self._first[some]) > share * self._far[some]).any(axis=1))

    def _turned(self, some: IntArray, unknowns: FloatArray, share: float) -> NDArray[np.bool_]:
        return np.asarray((np.abs(unknowns - self._before[some]) > share * self._periods[some]).any(axis=1))

    def _but_for_turns(self, k: int, apart: FloatArray) -> FloatArray:
        """A difference of unknowns without whole turns, and without what others tell."""
        period = np.where(np.isfinite(self._periods[k]), self._periods[k], 0.0)
        turns = np.round(apart / np.where(period > 0, period, 1.0)) * period
        return np.where(self._told[k], apart - turns, 0.0)
