"""Down in energy by the turns of clamps; where one number tells all, to the next equilibrium in its order.

Numbers in parentheses are those of ``docs/branches.md``.
"""

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np

from multirod.solvers.following.descent import RADIUS, SOFT, Point, Slope
from multirod.solvers.following.serving.requests import Run
from multirod.solvers.following.serving.rounds import AROUND, Rounds
from multirod.solvers.following.valley import FIRST, LONGEST, by_turns, down_valley, in_valley
from multirod.status import Status
from multirod.validation import FloatArray

if TYPE_CHECKING:
    from multirod.solvers.following.walk import Walk

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
AGAIN = 125  # steps with clamps, after which it is asked of where it is then


def in_steps(walk: "Walk", point: Point, slope: Slope, first: FloatArray) -> Run:
    """Down in energy by the turns of clamps, in steps that (9) says are short enough, as ends that are held bend the way."""
    radius, share, along, gone = RADIUS, 1.0, 0, np.inf
    rounds = Rounds(point.periods[None], point.unknowns[None])
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
