"""Estimates whose steps came to no end go on at equilibria alone. Numbers in parentheses: ``docs/estimation.md``."""

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from multirod.status import Status
from multirod.tasks.estimating.inference import SETTLED, posterior, units
from multirod.tasks.estimating.kinked import DECREASE, ENDLESS, NEWTON
from multirod.tasks.formulation import Evaluation
from multirod.validation import FloatArray

if TYPE_CHECKING:
    from multirod.tasks.estimating.iteration import Part

SPENT = 10  # integrations for each step that is allowed
LONGEST = 4.0  # of the scale of curvatures, that unknowns may change by in a step
POOR, GOOD = 0.25, 0.75  # of what a step is to take off (1): below which the next is shorter, from where on it may be longer
SHORTER, LONGER = 0.25, 2.0
SHORTEST = 1e-6  # standard deviations, steps of which tell nothing
ROUNDING = 1e-9  # of (1), that rounding may add
TINY = 1e-300


def promised(along: FloatArray, length: FloatArray) -> FloatArray:
    """(21) What a part ``along`` of a step of this ``length`` is to take off (1)."""
    return along * (2 - along) * length**2


def falls(square: FloatArray, was: FloatArray, saved: FloatArray) -> NDArray[np.bool_]:
    """Whether (1) fell from what it ``was`` by enough of what was promised, ``saved``."""
    return np.asarray(square <= was - DECREASE * saved + ROUNDING * was)


def next_reach(reach: FloatArray, gone: FloatArray, came_off: FloatArray) -> FloatArray:
    """(21) How far the next step may go, after one of length ``gone`` of whose promise this part ``came_off``."""
    shorter, longer = SHORTER * gone, np.maximum(reach, LONGER * gone)
    return np.where(came_off >= GOOD, longer, np.where(came_off >= POOR, reach, shorter))


class Settling:
    """(21) Goes on with those instances of a part that came to no end, from one equilibrium to the next, each where (1) is less.

    Args:
        part: Whose problem has no kinks.
    """

    def __init__(self, part: "Part") -> None:
        self._part = part
        self._x, self._p, self._by = part.x.copy(), part.p.copy(), part.by.copy()  # the equilibria that they are at
        self._square = np.full(part.count, np.inf)
        self._next_x, self._next_p = part.x.copy(), part.p.copy()  # where the next one is looked for
        self._sought = np.zeros(part.count, dtype=np.intp)  # how many integrations for it
        self._step = np.zeros_like(part.p)
        self._reach = np.full(part.count, np.inf)  # standard deviations, that a step may be long
        self._length, self._whole, self._saved = np.zeros((3, part.count))
        self._elsewhere = part.based.copy()  # whether there is another place to begin

    def run(self, chosen: NDArray[np.bool_]) -> None:
        """Seek an end of what came to none of those chosen (b,)."""
        part = self._part
        going = chosen & np.isin(part.outcome.status, ENDLESS) & np.isfinite(part.square)
        allowed = part.outcome.integrations + SPENT * part.scene.max_iterations
        while (going := going & (part.outcome.integrations < allowed)).any():
            self._advance(going)

    def _advance(self, going: NDArray[np.bool_]) -> None:
        """One integration of each that is ``going`` (b,); which of these go on is left there."""
        part, rows = self._part, np.flatnonzero(going)
        found = part.task.evaluate(self._next_x, self._next_p, going)
        part.outcome.integrations[rows] += 1
        self._sought[rows] += 1
        towards = found.eliminated[0]
        with np.errstate(invalid="ignore"):
            gap = np.abs(found.residual).max(axis=1)
            there = gap <= part.tolerance[rows]
            near = (gap <= part.sharpest[rows]) & (np.abs(towards).max(axis=1) <= self._longest(rows))
        on = near & ~there & (self._sought[rows] < NEWTON)
        self._next_x[rows[on]] += towards[on]
        self._reach[rows[~there & ~on]] = SHORTER * self._length[rows[~there & ~on]]
        if there.any():
            self._judge(rows[there], found.take(there), going)
        decided = rows[~on & going[rows]]
        self._begin_again(decided[np.isinf(self._square[decided])], going)
        self._try(decided[np.isfinite(self._square[decided])], going)

    def _longest(self, rows: NDArray[np.intp]) -> NDArray[np.float64]:
        return np.asarray(LONGEST * self._part.task.problem.curvature_scale()[rows])

    def _judge(self, rows: NDArray[np.intp], found: Evaluation, going: NDArray[np.bool_]) -> None:
        """Go to the equilibria that were found, where (1) is less there, and plan the next step; or end."""
        part, was = self._part, self._square[rows]
        r, J = part.measured.at(found, rows)
        root, away = part.root[rows], self._next_p[rows] - part.mean[rows]
        square = (r**2).sum(axis=1) + ((root @ away[..., None])[..., 0] ** 2).sum(axis=1)
        with np.errstate(invalid="ignore"):
            came_off = (was - square) / np.maximum(self._saved[rows], SETTLED**2 * DECREASE)
            less = falls(square, was, self._saved[rows])
        less &= np.isfinite(J).all(axis=(1, 2))
        reach = next_reach(self._reach[rows], self._length[rows], came_off)
        self._reach[rows] = np.where(np.isfinite(was), reach, self._reach[rows])
        own, r, J, root, away = rows[less], r[less], J[less], root[less], away[less]
        self._x[own], self._p[own], self._square[own] = self._next_x[own], self._next_p[own], square[less]
        self._by[own] = found.take(less).eliminated[1]
        told = J, r, root, away, units(J, part.prior[own])
        planned = posterior(*told)
        self._step[own], self._whole[own] = part.bounds.step(planned, self._p[own], told)
        part.outcome.iterations[own] += 1
        part.x[own], part.p[own], part.square[own], part.covariance[own] = (
            self._x[own],
            self._p[own],
            self._square[own],
            planned.covariance,
        )
        ended = own[self._whole[own] <= SETTLED]
        part.outcome.status[ended] = Status.CONVERGED
        going[ended] = False

    def _begin_again(self, rows: NDArray[np.intp], going: NDArray[np.bool_]) -> None:
        """Where no equilibrium is near, from the last one before, if there was any."""
        part, other = self._part, rows[self._elsewhere[rows]]
        going[rows] = self._elsewhere[rows]
        self._next_x[other], self._next_p[other] = part.base["x"][other], part.base["p"][other]
        self._elsewhere[other], self._sought[other], self._reach[other] = False, 0, np.inf

    def _try(self, rows: NDArray[np.intp], going: NDArray[np.bool_]) -> None:
        """Look for the next equilibrium a part of the step ahead."""
        part, step = self._part, self._step[rows]
        moved = np.maximum(np.abs(self._by[rows] @ step[..., None]).max(axis=(1, 2)), TINY)
        along = np.minimum(1.0, np.minimum(self._reach[rows] / self._whole[rows], self._longest(rows) / moved))
        self._length[rows] = along * self._whole[rows]
        self._saved[rows] = promised(along, self._whole[rows])
        self._next_p[rows] = part.bounds.kept(self._p[rows] + along[:, None] * step, self._p[rows])
        change = (self._by[rows] @ (self._next_p[rows] - self._p[rows])[..., None])[..., 0]
        self._next_x[rows], self._sought[rows] = self._x[rows] + change, 0
        going[rows] = self._length[rows] >= SHORTEST
