"""Down in energy by the turns of tips, of many at once; where one number tells all, to the next equilibrium in its order.

Numbers in parentheses are those of ``docs/branches.md``.
"""

from collections.abc import Callable

import numpy as np

from multirod.solvers.following.descent import RADIUS, SOFT, Point
from multirod.solvers.following.many import Server
from multirod.solvers.following.requests import Answer, Descend, Run
from multirod.status import NOT_RUN, Status
from multirod.validation import FloatArray

DESCENT_STEPS = 150
SHORTEST = 1e-3  # turn of the tip by a step, that is not halved again [rad]
STEP = 0.01  # of the unknown that is left: less than a tenth of the way to the next equilibrium
FARTHEST = 4.0  # of that, on which one lies, as what tubes can turn each other by is bounded
FINEST = 1e-3  # of a step, in which a residual that comes so near to zero that it may touch is looked at again
TOUCHES = 0.1  # of what the residual is at both ends of a step, to which it comes within: it may be zero there
HALVINGS = 100


def descend(server: Server, asked: dict[int, Descend]) -> dict[int, Answer]:
    """(4) Where going down in energy leads from each point, after turning the tip by ``first``; None where it leads nowhere."""
    places, all_ = np.array(list(asked)), list(asked.values())
    count = len(places)
    level, tolerance = np.array([one.point.level for one in all_]), np.array([one.tolerance for one in all_])
    left = np.array([one.left for one in all_])
    unknowns, facing = np.array([one.point.unknowns for one in all_]), np.array([one.slope.facing for one in all_])
    step = np.array([one.slope.change(one.first) if one.first.any() else one.slope.step(RADIUS) for one in all_])
    slopes = [one.slope for one in all_]
    radius, on = np.full(count, RADIUS), np.ones(count, dtype=bool)
    integrations, spent = np.zeros(count, dtype=np.int64), np.zeros(count, dtype=bool)
    there: list[Point | None] = [None] * count
    edge = np.full(count, NOT_RUN)
    for _ in range(DESCENT_STEPS):
        spent |= on & (integrations >= left)
        on &= ~spent
        now = np.flatnonzero(on)
        if not len(now):
            break
        _, _, over = server.evaluate(places[now], unknowns[now] + step[now], level[now])
        integrations[now] += 1
        spent[now] = over
        on[now[over]] = False
        points = server.points(places[now])
        found = points.slopes
        # beyond, the rod would snap though its tip were held: not in one long step
        good = found.fit & (found.facing == facing[now])
        shorter = now[~good & ~over]
        radius[shorter] *= 0.5
        ended = shorter[radius[shorter] < SHORTEST]
        on[ended] = False
        nowhere = ended[~np.isfinite(points.size[np.searchsorted(now, ended)])]
        edge[nowhere] = server.reasons(places[nowhere])
        for i in shorter[on[shorter]].tolist():
            step[i] = slopes[i].step(float(radius[i]))
        with np.errstate(invalid="ignore"):
            rests = good & ~over & (points.size <= tolerance[now]) & (found.values[:, 0] >= -SOFT)
        for i in np.flatnonzero(rests).tolist():
            there[now[i]] = points[i]
        on[now[rests]] = False
        rows = np.flatnonzero(good & ~over & ~rests)
        some = now[rows]
        unknowns[some] = points.unknowns[rows]
        radius[some] = np.minimum(RADIUS, 1.5 * radius[some])
        step[some] = found.steps(rows, radius[some])
        for i, row in zip(some.tolist(), rows.tolist(), strict=True):
            slopes[i] = found[row]
    return {
        place: Answer(there[i], int(integrations[i]), int(integrations[i]), bool(spent[i]), edge=Status(int(edge[i])))
        for i, place in enumerate(places.tolist())
    }


def next_rest(at: Callable[[FloatArray, float], Run], start: Point, sign: float, tolerance: float) -> Run:
    """(14) The next equilibrium in the order of the only unknown; None where none was found, or one may have been passed.

    Args:
        at: Integrates at unknowns (1,) and a level.
        start: Where to begin; the level is its.
        sign: Of the way in which the energy falls.
        tolerance: Largest residual [1/m].
    """
    whole = STEP * abs(float(start.unknowns[0]))
    last, gone, step = start, 0.0, whole
    while step > 0 and gone < FARTHEST * whole / STEP:
        found = yield from at(last.unknowns + sign * step, last.level)
        if not np.isfinite(found.size):
            return None
        if last.residual[0] * found.residual[0] <= 0:
            return (yield from _between(at, last, found, tolerance))
        if _may_touch(last, found, sign * step):
            step *= 0.5
            if step < FINEST * whole:
                return None
            continue
        last, gone, step = found, gone + step, min(whole, 2 * step)
    return None


def _may_touch(last: Point, found: Point, step: float) -> bool:
    """Whether the cubic through both comes near zero between them."""
    a, b = float(last.residual[0]), float(found.residual[0])
    slopes = step * float(last.gamma[0, 0]), step * float(found.gamma[0, 0])
    t = np.linspace(0, 1, 17)
    cubic = a * (1 + 2 * t) * (1 - t) ** 2 + b * t**2 * (3 - 2 * t) + slopes[0] * t * (1 - t) ** 2 - slopes[1] * t**2 * (1 - t)
    return bool((np.sign(a) * cubic).min() < (1 - TOUCHES) * min(abs(a), abs(b)) and slopes[0] * slopes[1] < 0 > a * slopes[0])


def _between(at: Callable[[FloatArray, float], Run], low: Point, high: Point, tolerance: float) -> Run:
    """The zero of the residual between two points, by Newton's method within halves."""
    here = low if low.size < high.size else high
    for _ in range(HALVINGS):
        if here.size <= tolerance:
            return here
        ends = sorted((float(low.unknowns[0]), float(high.unknowns[0])))
        slope = float(here.gamma[0, 0])
        guess = float(here.unknowns[0]) - float(here.residual[0]) / slope if slope else np.nan
        if not ends[0] < guess < ends[1]:
            guess = 0.5 * (ends[0] + ends[1])
        here = yield from at(np.array([guess]), low.level)
        if not np.isfinite(here.size):
            return None
        if here.residual[0] * low.residual[0] > 0:
            low = here
        else:
            high = here
    return None
