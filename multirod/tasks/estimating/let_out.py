"""Estimates that begin where lines are longer than the priors' means say. Numbers in parentheses: ``docs/estimation.md``."""

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from multirod.status import Status
from multirod.tasks.estimating.inference import deviations

if TYPE_CHECKING:
    from multirod.tasks.estimating.iteration import Part

BY = (1.0, 2.0, 4.0, 8.0)  # standard deviations of the priors, by which lines are longer, in turn
NOT_ENDED = (Status.LINES_TOO_SHORT, Status.BRANCH_END, Status.LINE_LIMIT, Status.STALLED, Status.MAX_ITERATIONS)


class LetOut:
    """(20c) Where instances that came to no end begin once more.

    Args:
        part: Of a batch, whose problem has kinks.
    """

    def __init__(self, part: "Part") -> None:
        self._part, lines = part, np.isin(part.task.places, part.task.problem.kink_inputs)
        self._by = lines * np.minimum(deviations(part.prior), part.bounds.unit)
        self._turn = np.full(part.count, 0 if lines.any() else len(BY))

    def next(self) -> NDArray[np.bool_]:
        """Which of all instances are put to another equilibrium than before, shape (b,)."""
        part, put = self._part, np.zeros(self._part.count, dtype=bool)
        lost = np.isin(part.outcome.status, NOT_ENDED)
        while (going := lost & ~put & (self._turn < len(BY))).any():
            rows = np.flatnonzero(going)
            p = part.mean[rows] - np.take(BY, self._turn[rows])[:, None] * self._by[rows]
            self._turn[rows] += 1
            put |= part.put_at_rest(rows, p)
        return put
