"""Estimates that begin where lines are longer than the priors' means say. Numbers in parentheses: ``docs/estimation.md``."""

from math import prod
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from multirod.running.simulation import solve
from multirod.status import Status
from multirod.tasks.estimating.inference import deviations
from multirod.tasks.freed import values_of, with_values

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
            x, found = self._solved(rows, p)
            there = rows[found]
            part.x[there], part.p[there], put[there] = x[found], p[found], True
        return put

    def _solved(self, rows: NDArray[np.intp], p: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
        """Unknowns at the inputs ``p`` of some instances, and which were found."""
        part, scene = self._part, self._part.scene
        numbers = rows if part.instances is None else part.instances[rows]
        names = scene.unknown.names
        every = values_of(scene.inputs, names).reshape(prod(scene.batch_shape), -1)
        every[numbers] = p
        inputs = with_values(scene.inputs, names, every.reshape(*scene.batch_shape, -1))
        options: dict[str, Any] = {"solver": scene.solver, "device": scene.device, "threads": 1, "progress": False}
        found = solve(scene.robot, inputs, instances=numbers, **options)
        part.outcome.integrations[rows] += found.integrations
        return part.task.problem.adopt(np.nan_to_num(found.unknowns)), ~found.failed
