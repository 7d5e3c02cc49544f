"""What no wider limits bring nearer, at rest where that is preferred. Numbers in parentheses: ``docs/tasks.md``."""

from typing import Any

import numpy as np

from multirod.status import Status
from multirod.tasks.programme import within_limits
from multirod.tasks.reaching.goals import Place
from multirod.tasks.reaching.search import AT_LIMIT, Search
from multirod.validation import FloatArray

WORTH = 0.01  # of what is left, that a unit (9) of what is free is to gain without limits, or these do not hold the tip back
AS_NEAR = 1.05  # times what is left at best, which is all but as near
MATTERS = 0.03  # of the largest singular value of J: directions in which the tip is moved
RADIUS, STEPS, AT_REST = 1.0, 40, 1e-3  # of steps, in units (9)
SOFT = 1e-8  # of the largest number of J, squared


def gained(r: FloatArray, J: FloatArray) -> float:
    """(20) What part of ``r`` (m,) a step takes off at most, no longer than a unit (9), to first order and without limits."""
    left, size, right = np.linalg.svd(J, full_matrices=False)
    along = left.T @ r

    def step(soft: float) -> FloatArray:
        return np.asarray(size * along / (size**2 + soft))

    low, high = 1e-24 * float(size[0]) ** 2 + 1e-300, float(size[0] * np.linalg.norm(along)) + 1e-300
    for _ in range(60):
        middle = np.sqrt(low * high)
        low, high = (middle, high) if np.linalg.norm(step(middle)) > RADIUS else (low, middle)
    return 1.0 - float(np.linalg.norm(r - J @ (right.T @ step(high))) / np.linalg.norm(r))


def _change(search: Search, r: FloatArray, J: FloatArray, p: FloatArray, pull: FloatArray) -> FloatArray:
    """(7) The step from ``p`` (k,) that is pulled, in units (9), and meets what matters of the rows, within limits."""
    goals = search.goals
    left, size, _ = np.linalg.svd(J, full_matrices=False)
    across = left[:, size > MATTERS * size[0]]
    J, r = across.T @ J, across.T @ r
    low, high = (end - goals.limits.matrix @ p for end in goals.limits.inset(goals.unit))
    soft = SOFT * float(np.abs(J).max()) ** 2
    free = np.linalg.solve(J.T @ J + soft * np.eye(len(p)), soft * pull - J.T @ r)
    row: dict[str, Any] = {"J": J[None], "r": r[None], "low": low[None], "high": high[None], "change": free[None]}
    change: FloatArray = within_limits(goals.limits.matrix * goals.unit, softness=soft, pull=pull[None], **row)[0]
    return change / max(1.0, float(np.abs(change).max()) / RADIUS)


def eased(search: Search) -> None:
    """Of what is ``AT_LIMIT``, tell ``UNREACHABLE`` that which no wider limits would bring nearer, and go on to where that is
    preferred which is all but as near: else it is at the limits, whatever these are, for a part in a thousand."""
    goals = search.goals
    if goals.of_shape is not None:
        return
    for row in np.flatnonzero(search.status == AT_LIMIT).tolist():
        one, rows = np.zeros(len(search.status), dtype=bool), np.array([row])
        one[row] = True
        before, errors = search.last.copy(), search.errors[row].copy()
        at, best = Place(search.last.x[row].copy(), search.last.p[row].copy()), float(np.linalg.norm(errors))
        goal, found = goals.rows.take(slice(row, row + 1)), search.task.evaluate(search.last.x, search.last.p, one)
        search.integrations[row] += 1
        kept = errors
        for count in range(STEPS):
            r, J = (own[0] for own in found.condensed(*goal.at(found)))
            J = J * goals.unit
            if not count:
                if not gained(r, J) < WORTH:
                    break
                search.status[row] = Status.UNREACHABLE
            centre = search.origin[row] if goals.centre is None else goals.centre
            change = _change(search, r, J, at.p, (centre - at.p) / goals.unit)
            if np.abs(change).max() < AT_REST:
                break
            a, B = (own[0] for own in found.eliminated)
            search.here.x[row], search.here.p[row] = at.x + a + B @ (goals.unit * change), at.p + goals.unit * change
            if not len(search.settled(rows)) or not np.linalg.norm(search.errors[row]) <= AS_NEAR * best:
                break
            at, kept = Place(search.here.x[row].copy(), search.here.p[row].copy()), search.errors[row].copy()
            found = search.task.last(rows)
        search.errors[row] = kept
        search.last.x[row], search.last.p[row] = at.x, at.p
        if search.status[row] != AT_LIMIT and search.unstable(rows).any():
            search.last.put(rows, before)
            search.errors[row] = errors
