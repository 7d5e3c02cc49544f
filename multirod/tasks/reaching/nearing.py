"""What limits hold back, or no way led to, as near to its target as it comes. Numbers in parentheses: ``docs/tasks.md``."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from multirod.batch import IntArray
from multirod.status import Status
from multirod.tasks.formulation import Evaluation
from multirod.tasks.programme import within_limits
from multirod.tasks.reaching.goals import BoolArray, Place
from multirod.tasks.reaching.search import AT_LIMIT, REACHED, Search
from multirod.validation import FloatArray

STEPS = 30
SOFT, HARD = 1e-12, 1e2  # of the largest number of J, squared: least damping, and that from which on nothing comes nearer
FIRST, SOFTER, HARDER = 1e-3, 0.1, 4.0
WORTH = 1e-4  # of what is left, that a step is to take off
LOST = int(Status.UNREACHABLE), int(Status.SINGULAR_TASK)


@dataclass
class _Told:
    """Of equilibria, axes (row, ...): rows at them and their derivatives in units (9), and what steps lead to, (2).

    Attributes:
        r: Shape (c, m).
        J: Shape (c, m, k).
        towards: ``a``, shape (c, n).
        by: ``B`` in units (9), shape (c, n, k).
        sign: Of ``det Gamma``, shape (c,).
    """

    r: FloatArray
    J: FloatArray
    towards: FloatArray
    by: FloatArray
    sign: FloatArray

    def put(self, chosen: NDArray[np.intp], other: "_Told") -> None:
        """Take the rows of another for the ``chosen`` ones."""
        for name, values in vars(self).items():
            values[chosen] = getattr(other, name)


class Nearing:
    """(7) Steps that are damped until the rows fall, each from an equilibrium to another.

    Args:
        search: Whose steps did not come to rest at limits, or led nowhere.
    """

    def __init__(self, search: Search) -> None:
        self._search, self._goals = search, search.goals
        self._matrix = self._goals.limits.matrix * self._goals.unit
        self._ends = self._goals.limits.inset(self._goals.unit)

    def step(self, r: FloatArray, J: FloatArray, p: FloatArray, softness: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Steps ``d`` (c, k) from ``p`` (c, k) in units (9), and what part of ``r`` (c, m) they take off to first order, (c,)."""
        low, high = (end - p @ self._goals.limits.matrix.T for end in self._ends)
        soft = softness * np.abs(J).max(axis=(1, 2), initial=1e-150) ** 2
        across = J @ J.swapaxes(1, 2) + soft[:, None, None] * np.eye(J.shape[1])
        free = -(J.swapaxes(1, 2) @ np.linalg.solve(across, r[..., None]))[..., 0]
        row: dict[str, Any] = {"J": J, "r": r, "low": low, "high": high, "change": free}
        change = within_limits(self._matrix, softness=soft, **row)
        left = r + (J @ change[..., None])[..., 0]
        return change, 1.0 - np.linalg.norm(left, axis=1) / np.maximum(np.linalg.norm(r, axis=1), 1e-300)

    def of(self, rows: IntArray, *, stable: bool = False) -> tuple[BoolArray, BoolArray]:
        """Which of some instances came nearer from ``search.last``, to ``search.here``, at equilibria, or ``stable`` ones alone;
        and at which nothing comes nearer then, shapes (c,)."""
        search, unit = self._search, self._goals.unit
        at, nearer, rests = Place(search.last.x[rows], search.last.p[rows]), *np.zeros((2, len(rows)), dtype=bool)
        chosen = np.zeros(len(search.status), dtype=bool)
        chosen[rows] = True
        told = self.told(rows, search.task.evaluate(search.last.x, search.last.p, chosen))
        search.integrations[rows] += 1
        least = np.full(len(rows), SOFT)
        rests[:] = ~(self.step(told.r, told.J, at.p, least)[1] >= WORTH)
        on, softness = ~rests, np.full(len(rows), FIRST)
        for _ in range(STEPS):
            now = np.flatnonzero(on)
            if not len(now):
                break
            change, worth = self.step(told.r[now], told.J[now], at.p[now], softness[now])
            small = ~(worth >= WORTH)
            rests[now] = small & (softness[now] <= SOFT)
            on &= ~rests
            softness[now[small]] = np.maximum(SOFTER * softness[now[small]], SOFT)
            go, change, worth = now[~small], change[~small], worth[~small]
            if not len(go):
                continue
            own = rows[go]
            search.here.x[own] = at.x[go] + told.towards[go] + (told.by[go] @ change[..., None])[..., 0]
            search.here.p[own] = at.p[go] + unit * change
            kept = search.errors[own].copy()
            there = np.isin(own, search.settled(own))
            there &= np.linalg.norm(search.errors[own], axis=1) <= (1 - 0.1 * worth) * np.linalg.norm(kept, axis=1)
            found = self.told(own[there], search.task.last(own[there]))
            same = found.sign == told.sign[go[there]]
            if stable:
                search.last.put(own[there], search.here)
                same[same] = ~search.unstable(own[there][same])
            there[there] = same
            missed, came = go[~there], go[there]
            search.errors[own[~there]] = kept[~there]
            softness[missed] *= HARDER
            on[missed] = softness[missed] <= HARD
            softness[came] = np.maximum(SOFTER * softness[came], SOFT)
            told.put(came, _Told(**{name: values[same] for name, values in vars(found).items()}))
            at.x[came], at.p[came] = search.here.x[own[there]], search.here.p[own[there]]
            nearer[came] = True
        search.here.x[rows], search.here.p[rows] = at.x, at.p
        return nearer, rests

    def told(self, rows: IntArray, found: Evaluation) -> _Told:
        """Of some instances, whose errors are then known."""
        errors, *slopes = self._goals.rows.take(rows).at(found)
        self._search.errors[rows] = errors
        r, J = found.condensed(errors, *slopes)
        towards, by = found.eliminated
        return _Told(r, J * self._goals.unit, towards, by * self._goals.unit, np.linalg.slogdet(found.gamma)[0])


def neared(search: Search, begun: BoolArray) -> None:
    """Bring what is ``AT_LIMIT`` nearer to its target, where its steps had not come to rest and no limit hinders it, and what no
    way led to its target, of those that have ``begun``: from where it ended, then from where it began.

    What ends within the limits, and not at its target, is ``UNREACHABLE``; what is not stable there stays where it was. What the
    search left unstable, and not at its target, is brought as near as stable equilibria lead from where it began.
    """
    if search.goals.of_shape is not None:  # the way there is not looked at
        return
    lost = np.flatnonzero(np.isin(search.status, LOST) & begun)
    search.tell_errors(lost)
    _bring(search, np.union1d(np.flatnonzero(search.status == AT_LIMIT), lost), search.last.copy())
    away = np.isin(search.status[lost], LOST) & (search.last.p[lost] != search.origin[lost]).any(axis=1)
    _bring(search, lost[away], Place(search.origin_unknowns, search.origin))
    _back(search, np.flatnonzero((search.status == Status.UNSTABLE) & begun & ~search.met))


def _back(search: Search, rows: IntArray) -> None:
    """From where some instances began, if they are stable there, by what is stable alone."""
    before = search.last.copy()
    search.last.put(rows, Place(search.origin_unknowns, search.origin))
    sound = ~search.unstable(rows)
    search.last.put(rows[~sound], before)
    rows = rows[sound]
    if not len(rows):
        return
    _, rests = Nearing(search).of(rows, stable=True)
    search.last.put(rows, search.here)
    there = np.linalg.norm(search.errors[rows], axis=1) <= search.goals.tolerance
    held = search.goals.limits.near(search.last.p[rows], search.goals.unit).any(axis=1)
    search.status[rows] = np.where(there, REACHED, np.where(held & rests, AT_LIMIT, Status.UNREACHABLE))


def _bring(search: Search, rows: IntArray, start: Place) -> None:
    """Nearer than some instances are, in steps from ``start``."""
    if not len(rows):
        return
    goals, before, errors = search.goals, search.last.copy(), search.errors.copy()
    search.last.put(rows, start)
    nearer, rests = Nearing(search).of(rows)
    nearer &= np.linalg.norm(search.errors[rows], axis=1) < np.linalg.norm(errors[rows], axis=1)
    search.last.put(rows, before)
    search.last.put(rows[nearer], search.here)
    search.errors[rows[~nearer]] = errors[rows[~nearer]]
    there = np.linalg.norm(search.errors[rows], axis=1) <= goals.tolerance
    limited = search.status[rows] == AT_LIMIT
    asked = nearer | (there & ~limited)  # of a limit it was asked where the search ended
    sound = asked.copy()
    sound[asked] = ~search.unstable(rows[asked])
    search.last.put(rows[~sound], before)
    search.errors[rows[~sound]] = errors[rows[~sound]]
    moved = sound & nearer & ~there
    held = goals.limits.near(search.last.p[rows], goals.unit).any(axis=1)
    search.status[rows[sound & there]] = REACHED
    search.status[rows[moved & limited & ~held]] = Status.UNREACHABLE
    search.status[rows[moved & ~limited & held & rests]] = AT_LIMIT
