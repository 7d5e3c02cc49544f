"""Down in energy by the turns of tips, of many at once; where one number tells all, to the next equilibrium in its order.

Numbers in parentheses are those of ``docs/branches.md``.
"""

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from multirod.batch import IntArray
from multirod.integrators import RK45
from multirod.problem import BoundaryProblem
from multirod.solvers.energy_descent import EnergyDescent, EnergyDescentTrack
from multirod.solvers.following.descent import RADIUS, SOFT, Point, Slope
from multirod.solvers.following.serving.many import Server
from multirod.solvers.following.serving.requests import EDGES, Answer, Descend, Run, Settle
from multirod.solvers.following.valley import FIRST, LONGEST, by_turns, down_valley, in_valley
from multirod.status import NOT_RUN, Status
from multirod.validation import FloatArray

if TYPE_CHECKING:
    from multirod.solvers.following.walk import Walk

DESCENT_STEPS = 150
SHORTEST = 1e-3  # turn of the tip by a step, that is not halved again [rad]
STEP = 0.01  # of the unknown that is left: less than a tenth of the way to the next equilibrium
FARTHEST = 4.0  # of that, on which one lies, as what tubes can turn each other by is bounded
FINEST = 1e-3  # of a step, in which a residual that comes so near to zero that it may touch is looked at again
TOUCHES = 0.1  # of what the residual is at both ends of a step, to which it comes within: it may be zero there
HALVINGS = 100
CLAMPED_STEPS = 400  # of a descent by the turns of clamps
GOING, LEAST_GONE = 50, 2.5  # of so many in a row, what the parts that they keep are to add up to: what lands makes 12
RADIUS_CLAMPED = 0.5  # largest turn of them in a mode by one step [rad]
LEAST_RADIUS = 0.005  # the same where steps are short [rad]
SHORTEST_CLAMPED = 1e-4  # part of a step
MISSED = 0.2  # part of a step, by which it may have been wrong
AIMED = 0.7  # of the error that is allowed, at which the next step is aimed
OFF = 0.02  # turn by which it may have been wrong however short it was [rad]
ALONG_VALLEY = 20  # steps along a valley, after which it is followed
HARDLY = 1e-3  # of K/L: a mode that is softer is let go on the way, and comes down its valley at the end
AROUND = 25  # steps of a descent after which it is asked whether all comes to be as there, joints a turn further
AGAIN = 125  # steps with clamps, after which it is asked of where it is then
WHOLE = 0.75  # of a turn, beyond which one may be whole
TOO_LONG = (Status.NONFINITE, Status.STEP_LIMIT, Status.LINE_LIMIT)  # as which steps of damped dynamics end that may have been so
FINER = (0.05,)  # radii of the shorter ones that are tried then [rad]
PASSES = 0.1  # of a step, by which it may pass where it was


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
    edge, rounds = np.full(count, NOT_RUN), _Rounds(np.array([one.point.periods for one in all_]), unknowns)
    for k in range(DESCENT_STEPS * rounds.times):
        if k == DESCENT_STEPS:
            on &= rounds.turning(unknowns)
        if k in (AROUND, DESCENT_STEPS):
            rounds.since(unknowns)
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
        why = server.reasons(places[nowhere])
        edge[nowhere] = np.where(np.isin(why, EDGES), why, NOT_RUN)
        for i in shorter[on[shorter]].tolist():
            step[i] = slopes[i].step(float(radius[i]))
        with np.errstate(invalid="ignore"):
            rests = good & ~over & (points.size <= tolerance[now]) & (found.values[:, 0] >= -SOFT)
        for i in np.flatnonzero(rests).tolist():
            there[now[i]] = points[i]
        on[now[rests]] = False
        rows = np.flatnonzero(good & ~over & ~rests)
        some = now[rows]
        around = rounds.passes(some, unknowns[some], points.unknowns[rows])
        edge[some[around]], on[some[around]] = Status.LOOSE, False
        unknowns[some] = points.unknowns[rows]
        radius[some] = np.minimum(RADIUS, 1.5 * radius[some])
        step[some] = found.steps(rows, radius[some])
        for i, row in zip(some.tolist(), rows.tolist(), strict=True):
            slopes[i] = found[row]
    return {
        place: Answer(there[i], int(integrations[i]), int(integrations[i]), bool(spent[i]), edge=Status(int(edge[i])))
        for i, place in enumerate(places.tolist())
    }


def in_steps(walk: "Walk", point: Point, slope: Slope, first: FloatArray) -> Run:
    """Down in energy by the turns of clamps, in steps that (9) says are short enough, as ends that are held bend the way."""
    radius, share, along, gone = RADIUS, 1.0, 0, np.inf
    rounds = _Rounds(point.periods[None], point.unknowns[None])
    turn = slope.modes.T @ first if first.any() else slope.turn(RADIUS)
    for k in range(CLAMPED_STEPS):
        if k % AGAIN == AROUND:
            rounds.since(point.unknowns[None])
        if k % GOING == 0:  # (17)
            if gone < LEAST_GONE:
                return None
            gone = 0.0
        step = share * (slope.back + slope.change(slope.modes @ turn))
        trial = yield from walk.at(point.unknowns + step, point.level)
        walk.iterations += 1
        found, longest = walk.slope_or_none(trial), share * float(np.abs(turn).max())
        off = np.inf if found is None or found.facing != slope.facing else slope.missed(share * turn, found)
        allowed = max(MISSED * longest, OFF * max(1.0, slope.drive))
        kicked = k > 0 and bool(first.any())
        rises = kicked and found is not None and slope.rises(turn, found)
        along += in_valley(slope, turn)
        if along > ALONG_VALLEY and not walk.valley:
            walk.valley = True  # it bends, which (4) knows nothing of
            floor = by_turns(walk.at, point.level, slope.facing)
            landed = yield from down_valley(floor, point.unknowns, FIRST, LONGEST, walk.within)
            if landed is not None:
                walk.hardly = int(abs(landed.slope.values[0]) < HARDLY)
                return landed
        shorter = np.sqrt(AIMED * allowed / max(off, 1e-300))  # by which it would be off as much as it is aimed to be
        if not off <= allowed or rises:
            share *= 0.5 if rises else min(max(shorter, 0.25), 0.7)
            if share < SHORTEST_CLAMPED:
                return None
            continue
        assert found is not None  # or it would be infinitely far off
        if rounds.passes(np.zeros(1, dtype=np.intp), point.unknowns[None], trial.unknowns[None])[0]:
            walk.edge = Status.LOOSE
            return None
        point, slope, gone = trial, found, gone + share
        if point.size <= walk.within and slope.values[0] >= -SOFT:
            return point
        # what leads back to where ends are held may be long, and is no turn: it shortens steps, the radius by so much alone
        radius = min(RADIUS_CLAMPED, max(LEAST_RADIUS, share * radius) * min(shorter, 2.0))
        share, turn = 1.0, slope.turn(radius)
    return None


def settle(
    part: BoundaryProblem, asked: dict[int, Settle], periods: FloatArray, taken: IntArray, steps: IntArray, *, raised: bool
) -> dict[int, tuple[FloatArray | None, int, Status]]:
    """(11) Where damped dynamics rest, or None, how many integrations that took, and why there is nothing, as ``Answer.edge``.

    Where a long step leads to no state, they go on in shorter ones from where they began.

    Args:
        part: The problem; its instances are where they are asked of.
        asked: By instance.
        periods: As of ``BoundaryProblem``, shape (instance_count, m).
        taken: Steps along all rods of each, (instance_count,): added to.
        steps: That each may take, (instance_count,).
        raised: Whether loads are raised on the way, not inputs.
    """
    method, count = EnergyDescent(integrator=RK45(), feed_forward=False), part.instance_count
    if method.unsupported(part):
        return {k: (None, 0, Status.NOT_RUN) for k in asked}
    guess, level, on, left = part.read("unknowns"), np.ones(count), np.zeros(count, dtype=bool), 0
    for k, request in asked.items():
        guess[k], level[k], on[k], left = request.unknowns, request.level, True, request.most
    result: dict[int, tuple[FloatArray | None, int, Status]] = {k: (None, 0, Status.NOT_RUN) for k in asked}
    for radius in (method.radius, *FINER):
        if not on.any() or left <= 0:
            break
        part.reasons(np.zeros(count, dtype=np.int32))  # what was so before is not why
        track, rounds = EnergyDescentTrack(replace(method, radius=radius), part, corrected=False), _Rounds(periods, guess)
        outcome = track.settle(
            tolerance=None,
            max_iterations=left,
            ramp=1,
            guess=guess,
            level=level if raised else 1.0,
            chosen=on,
            most_steps=steps,
            ends=partial(rounds.ends, part),
        )
        taken += track.integrator_steps
        steps = steps - track.integrator_steps
        found, why = part.read("unknowns"), part.reasons(outcome.status)
        for k in np.flatnonzero(on).tolist():
            edge = Status(int(why[k])) if why[k] in (*EDGES, Status.LINE_LIMIT) else Status.NOT_RUN
            rests = not Status(int(outcome.status[k])).failed
            result[k] = found[k] if rests else None, result[k][1] + int(outcome.integrations[k]), edge
        left -= int(outcome.integrations[on].max())
        on &= np.isin(outcome.status, TOO_LONG)
    return result


class _Rounds:
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
