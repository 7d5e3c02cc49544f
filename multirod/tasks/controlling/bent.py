"""Where rods are bent most, and how that varies: of one instance, beside its integration. Numbers: ``docs/tasks.md``."""

from bisect import bisect_right
from dataclasses import dataclass
from math import inf, isnan
from typing import NamedTuple

import numpy as np

from multirod.capabilities import Bending
from multirod.tasks.formulation import Task
from multirod.validation import FloatArray

# of the stretch between two nodes, from the most bent place: where columns are asked for, beside where a rod or a section ends,
# as there they are those of a place that moves with it; and as near as leaves their slope
ASIDE, CLOSE = 1e-4, 0.05


@dataclass(frozen=True)
class Bend:
    """``|u_xy|`` where it is largest, and its derivatives.

    Attributes:
        most: [1/m].
        by_unknowns: Shape (n,).
        by_free: By what is freed, the unknowns fixed, shape (k,).
    """

    most: float
    by_unknowns: FloatArray
    by_free: FloatArray


class _Place(NamedTuple):
    """A place on a backbone, and two others, close to it on one side, which lead on to it.

    Attributes:
        bent: What ``|u_xy|`` is there so.
        low: Arclength of the first [m].
        high: Of the second.
        at: Of the place.
        jump: Which of those where curvature may jump it moves with; -1 if with none.
    """

    bent: float
    low: float
    high: float
    at: float
    jump: int


class Bent:
    """Finds the largest ``|u_xy|`` of any rod: at nodes, and as it goes on from these to where it may jump, from either side.

    Args:
        task: With one instance.
        bending: Of its problem.
    """

    def __init__(self, task: Task, bending: Bending) -> None:
        self._task, self._bending = task, bending
        problem = task.problem
        given, here = problem.read("inputs"), bending.jumps().copy()
        self._moved = np.zeros((*here.shape, task.count))  # how these places move with what is free
        for j, place in enumerate(task.places.tolist()):
            rows = given.copy()
            rows[:, place] += 1.0
            problem.write("inputs", rows)
            self._moved[..., j] = bending.jumps() - here
        problem.write("inputs", given)

    def integrate(self) -> Bend:
        """The problem, at what it holds; NaN where that failed."""
        jumps = self._bending.jumps()
        arclength, u = self._bending.survey()
        bent = np.sqrt((u * u).sum(axis=2))
        found = [_most(*own) for own in zip(arclength.tolist(), bent.tolist(), jumps.tolist(), strict=True)]
        row = max(range(len(found)), key=lambda k: found[k].bent)
        most, n, k = found[row], self._task.problem.unknown_count, self._task.count
        places = np.array([(own.low, own.high) for own in found])
        self._bending.integrate(places)
        u, columns = self._bending.at_places(self._task.free, row)
        columns = self._task.chosen(columns)
        if self._task.problem.buffer("fault").any() or not np.isfinite(bent).all():
            return Bend(np.nan, np.full(n, np.nan), np.full(k, np.nan))
        size, stretch = np.maximum(np.sqrt((u * u).sum(axis=1)), 1e-300), most.high - most.low
        part = (most.at - most.low) / stretch
        weights = np.array([1 - part, part])
        by = (weights / size) @ (u[:, :, None] * columns).sum(axis=1)
        moved = 0.0 if most.jump < 0 else (size[1] - size[0]) / stretch * self._moved[row, most.jump]
        return Bend(float(weights @ size), by[:n], by[n : n + k] + moved)


def _most(arclength: list[float], bent: list[float], jumps: list[float]) -> _Place:
    """Where one backbone is bent most: in Python's own numbers, as there are few places where it may jump."""
    last, node = len(bent) - 1, bent.index(max(bent))
    most, at, side, jump = bent[node], arclength[node], -1 if node == last else 1, -1
    order = sorted((place, j) for j, place in enumerate(jumps) if not isnan(place))
    room = arclength[1] - arclength[0]
    for rank, (place, j) in enumerate(order):
        before = bisect_right(arclength, place) - 1
        low = order[rank - 1][0] if rank else -inf
        high = order[rank + 1][0] if rank + 1 < len(order) else inf
        if before == last and node == last:
            jump = j  # the tip goes along with it
            if low < place:
                room = min(room, place - low)
        if not 0 <= before < last:
            continue
        if before >= 1 and arclength[before - 1] > low:  # both nodes on this side of the jump before it
            reached = bent[before] + (bent[before] - bent[before - 1]) * _part(arclength, before - 1, before, place)
            if reached > most:
                most, at, side, jump = reached, place, -1, j
        if before + 2 <= last and arclength[before + 2] < high:
            reached = bent[before + 1] + (bent[before + 1] - bent[before + 2]) * _part(arclength, before + 2, before + 1, place)
            if reached > most:
                most, at, side, jump = reached, place, 1, j
    low, high = sorted((at + side * ASIDE * room, at + side * CLOSE * room))
    return _Place(most, low, high, at, jump)


def _part(arclength: list[float], first: int, second: int, place: float) -> float:
    """How far a place is behind the second of two nodes, in stretches between these."""
    return (place - arclength[second]) / (arclength[second] - arclength[first])
