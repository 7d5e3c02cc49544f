"""What limits hold back, as near to its target as they let it come. Numbers in parentheses: ``docs/tasks.md``."""

from typing import Any

import numpy as np

from multirod.status import Status
from multirod.tasks.programme import within_limits
from multirod.tasks.reaching.goals import Place
from multirod.tasks.reaching.search import AT_LIMIT, REACHED, Search
from multirod.validation import FloatArray

STEPS = 30
SOFT, HARD = 1e-12, 1e2  # of the largest number of J, squared: least damping, and that from which on nothing comes nearer
FIRST, SOFTER, HARDER = 1e-3, 0.1, 4.0
WORTH = 1e-4  # of what is left, that a step is to take off


class Nearing:
    """(7) Steps that are damped until the rows fall, each from an equilibrium to another.

    Args:
        search: Whose steps did not come to rest at limits.
    """

    def __init__(self, search: Search) -> None:
        self._search, self._goals = search, search.goals
        self._matrix = self._goals.limits.matrix * self._goals.unit
        self._ends = self._goals.limits.inset(self._goals.unit)

    def step(self, r: FloatArray, J: FloatArray, p: FloatArray, softness: float) -> tuple[FloatArray, float]:
        """The step ``d`` (k,) from ``p`` (k,) in units (9), and what part of ``r`` (m,) it takes off to first order."""
        low, high = (end - self._goals.limits.matrix @ p for end in self._ends)
        soft = softness * float(np.abs(J).max(initial=1e-150)) ** 2
        free = -J.T @ np.linalg.solve(J @ J.T + soft * np.eye(len(r)), r)
        row: dict[str, Any] = {"J": J[None], "r": r[None], "low": low[None], "high": high[None], "change": free[None]}
        change = within_limits(self._matrix, softness=soft, **row)[0]
        return change, 1.0 - float(np.linalg.norm(r + J @ change) / np.linalg.norm(r))

    def of(self, row: int) -> bool:
        """Whether an instance came nearer: it is there then, at an equilibrium."""
        search, goal = self._search, self._goals.rows.take(slice(row, row + 1))
        one = np.zeros(len(search.status), dtype=bool)
        one[row] = True
        at, nearer, softness = Place(search.last.x[row].copy(), search.last.p[row].copy()), False, FIRST
        found = search.task.evaluate(search.last.x, search.last.p, one)
        sign = np.linalg.slogdet(found.gamma[0])[0]
        search.integrations[row] += 1
        for count in range(STEPS):
            errors, by_unknowns, by_free = goal.at(found)
            r, J = (own[0] for own in found.condensed(errors, by_unknowns, by_free))
            J = J * self._goals.unit
            if not count and self.step(r, J, at.p, SOFT)[1] < WORTH:
                return False
            change, worth = self.step(r, J, at.p, softness)
            if not worth >= WORTH:
                if softness <= SOFT:
                    break
                softness = max(SOFTER * softness, SOFT)
                continue
            a, B = (own[0] for own in found.eliminated)
            search.here.x[row], search.here.p[row] = at.x + a + B @ (self._goals.unit * change), at.p + self._goals.unit * change
            kept = search.errors[row].copy()
            there = len(search.settled(np.array([row]))) > 0
            if there:
                next_one = search.task.last(np.array([row]))
                there = np.linalg.slogdet(next_one.gamma[0])[0] == sign
                there = there and np.linalg.norm(search.errors[row]) <= (1 - 0.1 * worth) * np.linalg.norm(kept)
            if not there:
                search.errors[row] = kept
                softness *= HARDER
                if softness > HARD:
                    break
                continue
            found, nearer, softness = next_one, True, max(SOFTER * softness, SOFT)
            at = Place(search.here.x[row].copy(), search.here.p[row].copy())
        search.here.x[row], search.here.p[row] = at.x, at.p
        return nearer


def neared(search: Search) -> None:
    """Bring what is ``AT_LIMIT`` nearer to its target, where its steps had not come to rest and no limit hinders it.

    What ends within the limits, and not at its target, is ``UNREACHABLE``; what is not stable there stays where it was.
    """
    if search.goals.of_shape is not None:  # the way there is not looked at
        return
    way = Nearing(search)
    for row in np.flatnonzero(search.status == AT_LIMIT).tolist():
        before, errors, rows = search.last.copy(), search.errors[row].copy(), np.array([row])
        if not way.of(row):
            search.errors[row] = errors
            continue
        search.last.put(rows, search.here)
        if search.unstable(rows).any():
            search.last.put(rows, before)
            search.errors[row] = errors
        elif np.linalg.norm(search.errors[row]) <= search.goals.tolerance:
            search.status[row] = REACHED
        elif not search.goals.limits.near(search.last.p[rows], search.goals.unit).any():
            search.status[row] = Status.UNREACHABLE
