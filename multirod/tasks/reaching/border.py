"""On along limits of the shape, from equilibrium to equilibrium. Numbers in parentheses: ``docs/tasks.md``."""

from dataclasses import dataclass

import numpy as np

from multirod.status import Status
from multirod.tasks.controlling.shape_limits import ASKED_BELOW, FLAT, INSET, PROBE
from multirod.tasks.programme import within_limits
from multirod.tasks.reaching.goals import BoolArray, Place
from multirod.tasks.reaching.nearing import FIRST, HARD, HARDER, LOST, SOFT, SOFTER, WORTH, Nearing
from multirod.tasks.reaching.search import AT_LIMIT, REACHED, Search
from multirod.tasks.reaching.sliding import NEARER, PATIENCE
from multirod.validation import FloatArray

LONGEST = 1.0  # step, in units (9)
HOLDS = 1e-9  # of room, what a step leaves of it where a limit of the shape holds that


@dataclass(frozen=True)
class Ended:
    """How that ended.

    Attributes:
        nearer: Whether it came nearer.
        rests: Whether no step from there does, to first order, or the last ones hardly did.
        stopped: Whether none does that is within limits of the shape, however small.
        held: Which limits of the shape hold there, shape (count,).
        numbers: Which of the freed numbers change what these limit, shape (k,).
    """

    nearer: bool
    rests: bool
    stopped: bool
    held: BoolArray
    numbers: BoolArray


class Border:
    """(21) Damped steps from an equilibrium to another that is stable and within limits of the shape, of one instance.

    Args:
        search: That did not reach some targets.
        row: Of the instance.
    """

    def __init__(self, search: Search, row: int) -> None:
        self._search, self._row, self._rows = search, row, np.array([row])
        self._nearing, self._goals = Nearing(search), search.goals
        self._matrix, self._ends = self._goals.limits.matrix, self._goals.limits.inset(self._goals.unit)

    def _room(self) -> FloatArray:
        """What limits of the shape leave at ``last``, shape (count,)."""
        self._search.integrations[self._row] += 1
        return np.asarray(self._search.room(self._rows)[0])

    def _slopes(self, room: FloatArray, by: FloatArray) -> FloatArray:
        """(18c) How that varies along equilibria, in units (9), shape (count, k)."""
        last, row, unit = self._search.last, self._row, self._goals.unit
        x, p, found = last.x[row].copy(), last.p[row].copy(), []
        for j in range(len(unit)):
            last.x[row], last.p[row] = x + PROBE * by[:, j], p
            last.p[row, j] += PROBE * unit[j]
            found.append((self._room() - room) / PROBE)
        last.x[row], last.p[row] = x, p
        slopes = np.stack(found, axis=1)
        slopes[np.abs(slopes) < FLAT] = 0.0
        return slopes

    def of(self) -> Ended:
        """Go from ``last`` as near to the target as that leads, to ``last``."""
        search, row, rows, unit = self._search, self._row, self._rows, self._goals.unit
        last, chosen = search.last, np.zeros(len(search.status), dtype=bool)
        chosen[row] = True
        told = self._nearing.told(rows, search.task.evaluate(last.x, last.p, chosen))
        allowed = search.integrations[row] + self._goals.max_integrations
        search.integrations[row] += 1
        left = [float(np.linalg.norm(told.r))]
        room, softness, nearer, rests, stopped = self._room(), FIRST, False, False, False
        held, walls, asked = np.zeros(len(room), dtype=bool), np.zeros((len(room), len(unit))), False
        if not (room > 0).all() or search.unstable(rows)[0]:
            return Ended(False, False, True, held, np.zeros(len(unit), dtype=bool))
        while search.integrations[row] < allowed and not (rests or stopped):
            if not asked and (room < ASKED_BELOW).any():
                walls, asked = self._slopes(room, told.by[0]), True
            change, worth, held = self._step(told.r, told.J, last.p[row], softness, walls, room)
            if not worth >= WORTH:
                rests, softness = softness <= SOFT, max(SOFTER * softness, SOFT)
                continue
            before, errors = last.copy(), search.errors[row].copy()
            search.here.x[row] = last.x[row] + told.towards[0] + told.by[0] @ change
            search.here.p[row] = last.p[row] + unit * change
            there = len(search.settled(rows)) == 1
            there &= bool(np.linalg.norm(search.errors[row]) <= (1 - 0.1 * worth) * np.linalg.norm(errors))
            nearest = there
            if there:
                found = self._nearing.told(rows, search.task.last(rows))
                last.put(rows, search.here)
                now = self._room()
                there = bool(found.sign == told.sign) and bool((now > 0).all()) and not search.unstable(rows)[0]
            if there:
                told, room, nearer, asked, walls = found, now, True, False, np.zeros_like(walls)
                softness = max(SOFTER * softness, SOFT)
                left.append(float(np.linalg.norm(found.r)))
                rests = len(left) > PATIENCE and left[-1] > (1 - NEARER) * left[-1 - PATIENCE]
                continue
            last.put(rows, before)
            search.errors[row] = errors
            if nearest and not asked:  # it is beyond a limit that was not thought to be near
                walls, asked = self._slopes(room, told.by[0]), True
            else:
                softness *= HARDER
            stopped = softness > HARD
        held |= room < 2 * INSET  # it stands there, though the last step may have been another way
        return Ended(nearer, rests, stopped, held, (walls[held] != 0).any(axis=0))

    def _step(
        self, r: FloatArray, J: FloatArray, p: FloatArray, softness: float, walls: FloatArray, room: FloatArray
    ) -> tuple[FloatArray, float, BoolArray]:
        """(7) with (18) among its rows: a step (k,) in units (9), what part of ``r`` it takes off, and which walls hold it."""
        unit, count = self._goals.unit, len(room)
        low, high = (end - self._matrix @ p for end in self._ends)
        low, high = np.append(low, np.full(count, -np.inf)), np.append(high, np.maximum(room - INSET, 0.0))
        soft = softness * np.abs(J).max(initial=1e-150) ** 2
        across = J[0] @ J[0].T + soft * np.eye(J.shape[1])
        free = -J[0].T @ np.linalg.solve(across, r[0])
        matrix = np.concatenate([self._matrix * unit, -walls])
        change = within_limits(matrix, J=J, r=r, softness=np.array([soft]), low=low[None], high=high[None], change=free[None])[0]
        change *= min(1.0, LONGEST / max(float(np.abs(change).max()), 1e-300))
        left = r[0] + J[0] @ change
        held = (walls != 0).any(axis=1) & (high[-count:] + walls @ change <= HOLDS)
        return change, 1.0 - float(np.linalg.norm(left)) / max(float(np.linalg.norm(r)), 1e-300), held


def bordered(search: Search, begun: BoolArray) -> dict[int, Ended]:
    """Bring what limits of the shape hold back, or no way led to its target, nearer to that, of those that have ``begun``: from
    where it ended, and where that leads nowhere, from where it began. How those ended that came nearer, by instance."""
    found: dict[int, Ended] = {}
    if search.goals.of_shape is None:
        return found
    for row in np.flatnonzero(np.isin(search.status, (AT_LIMIT, *LOST)) & begun).tolist():
        rows, lost = np.array([row]), search.status[row] != AT_LIMIT
        search.tell_errors(rows if lost else rows[:0])
        before, errors = search.last.copy(), float(np.linalg.norm(search.errors[row]))
        kept = search.errors[row].copy()
        ended = Border(search, row).of()
        if ended.stopped and not ended.nearer:
            search.last.put(rows, Place(search.origin_unknowns, search.origin))
            ended = Border(search, row).of()
        if not (ended.nearer and np.linalg.norm(search.errors[row]) < errors):
            search.last.put(rows, before)
            search.errors[row] = kept
            continue
        found[row] = ended
        limited = ended.held.any() or search.goals.limits.near(search.last.p[rows], search.goals.unit).any()
        if np.linalg.norm(search.errors[row]) <= search.goals.tolerance:
            search.status[row] = REACHED
        elif not limited:
            search.status[row] = Status.UNREACHABLE
        else:
            search.status[row] = AT_LIMIT if ended.rests or ended.stopped or not lost else Status.UNREACHABLE
    return found
