"""Down a valley: where a robot is stiff in all modes but one, in which next to nothing holds it.

Numbers in parentheses are those of ``docs/branches.md``.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from multirod.solvers.following.descent import SOFT, Point, Slope, Unfit
from multirod.solvers.following.serving.requests import Run
from multirod.validation import FloatArray

FLOOR = 1e-2  # of K/L: a mode that is softer leads along it
WALLS = 0.1  # of K/L: all others are stiffer
ACROSS = 0.2  # of the turn along it, that a step turns across it, where it is in the valley
ON_THE_FLOOR = 0.1  # of the slope along it, that is left across it
AT_REST = 1e-12  # turn across it, that is none [rad]
FIRST = 0.05  # turn along it of the first step [rad]
LONGEST = 1.0  # of one step [rad]
SHORTEST = 1e-4  # of the first step
STEPS = 30
STEEPER = 4.0  # than where it began: that is no valley
CORRECTIONS = 5  # by which a step comes to the floor
LOOKS = 600  # along one
AT_FIRST, LEAST, MOST = 0.1, 0.005, 0.5  # radii of steps: the first, the least after one that led on, the largest [rad]
TOO_SHORT = 1e-4  # of a step [rad]
RESTING = 0.01  # turn by which a mode is from rest, if it is one of the floor [rad]
ON_IT = 1e-3  # the same after a step, and a tenth of that [rad]
SLOWLY = 0.8  # of the last correction, that the next may be
ASTRAY = 0.1, 2.0  # turn across it, and part of the step beside, beyond which a step has missed it [rad]
LONGER = (2.0, 1.4, 1.0, 0.5)  # the next step by how many looks one took

Floor = Callable[[FloatArray], Run]


@dataclass(frozen=True)
class _Place:
    """A place on the floor of a valley.

    Attributes:
        point: The point.
        tangent: The way down: how the unknowns change, per unit of ``turned``, shape (n,).
        turned: What tells how far a step goes, of norm 1, shape (m,).
        steep: Slope along it, not negative.
    """

    point: Point
    tangent: FloatArray
    turned: FloatArray
    steep: float


def in_valley(slope: Slope, turn: FloatArray) -> bool:
    """Whether a turn in each mode (m,) leads along a valley."""
    lowest, others = slope.values[0], slope.values[1:]
    if not len(others) or abs(lowest) > FLOOR or others[0] < WALLS:
        return False
    return bool(np.abs(turn[1:]).max() < ACROSS * abs(turn[0]))


def down_valley(floor: Floor, start: FloatArray, first: float, longest: float, tolerance: float) -> Run:
    """(13) The point at rest to which a valley leads; None where none was found.

    Args:
        floor: Leads from unknowns to the floor beside them.
        start: Unknowns in the valley [1/m], shape (n,).
        first: The first step.
        longest: Of one step.
        tolerance: Largest residual [1/m].
    """
    place = yield from floor(start)
    steepest = np.inf if place is None else max(FLOOR, STEEPER * place.steep)
    length, bend, before, gone = first, np.zeros_like(start), None, 0.0
    for _ in range(STEPS):
        if place is None or place.steep > steepest:
            return None
        if place.point.size <= tolerance:
            return place.point
        step = length
        if before is not None:
            facing = float(np.sign(before.turned @ place.turned))
            bend = (facing * place.tangent - before.tangent) / gone
            falls = before.steep - facing * place.steep
            if falls > 0:  # to where it is level, by what it fell less steeply on the last step
                step = min(length, gone * place.steep / falls)
        found, longer = None, 2.0
        while found is None:
            found = yield from floor(place.point.unknowns + step * place.tangent + 0.5 * step**2 * bend)
            if found is None:
                length = step = 0.5 * step
                longer = 1.0
                if step < SHORTEST * first:
                    return None
        before, place, gone = place, found, step
        length = min(longest, longer * length)
    return None


def by_turns(at: Callable[[FloatArray, float], Run], level: float, facing: float) -> Floor:
    """The floor by the energy, as a function of the turns of clamps and what is free at the ends: by Newton's method in all modes
    but the first."""

    def floor(unknowns: FloatArray) -> Run:
        last = ACROSS
        for _ in range(CORRECTIONS):
            point = yield from at(unknowns, level)
            try:
                slope = point.slope
            except Unfit:
                return None
            along, across = float(slope.along[0]), slope.along[1:]
            turn = -across / slope.values[1:]
            if slope.facing != facing or slope.values[1] < WALLS or np.abs(turn).max() > last:
                return None
            last = float(np.abs(turn).max())
            if np.abs(across).max() <= ON_THE_FLOOR * abs(along) or last < AT_REST:
                turned = -np.copysign(1.0, along) * slope.modes[:, 0]
                return _Place(point, slope.change(turned), turned, abs(along))
            unknowns = unknowns + slope.back + slope.change(slope.modes[:, 1:] @ turn)
        return None

    return floor


def along_floor(at: Callable[[FloatArray, float], Run], start: Point, slope: Slope, first: FloatArray, tolerance: float) -> Run:
    """(21) The point at rest to which steps lead on the floor of a valley that bends much; None where they lead nowhere.

    Args:
        at: Looks at unknowns and a level.
        start: Beside the floor.
        slope: There.
        first: How places are turned at first, shape (m,); all zero where the slope tells.
        tolerance: Largest residual [1/m].
    """
    point, kick, radius, looks = start, first, AT_FIRST, 0
    before: tuple[FloatArray, float] | None = None  # the last step: its tangent and length
    while looks < LOOKS and radius >= TOO_SHORT:
        soft = (slope.values <= WALLS) | (np.abs(slope.along) > RESTING * np.abs(slope.values))
        soft[0] = True
        own, across = slope.modes[:, soft], slope.modes[:, ~soft]
        turn = own @ (own.T @ kick if kick.any() else slope.turn(radius, soft))
        length = float(np.abs(own.T @ turn).max())
        _, back = _onto(slope, across, np.zeros_like(turn))
        far, move = _onto(slope, across, turn)
        tangent, bend = (move - back) / length, np.zeros_like(move)
        if before is not None and before[0] @ tangent > 0:
            bend = 0.5 * length**2 * (tangent - before[0]) / before[1]
        unknowns, found, size, tries = point.unknowns + move + bend, None, np.inf, 0
        missed = far > ASTRAY[0] + ASTRAY[1] * length
        while found is None and not missed and looks < LOOKS:
            looks, tries = looks + 1, tries + 1
            trial = yield from at(unknowns, start.level)
            try:
                there = trial.slope
            except Unfit:
                break
            if there.facing != slope.facing:
                break
            last = size
            size, back = _onto(there, across, np.zeros_like(turn))
            if size <= min(ON_THE_FLOOR * length, ON_IT) or trial.size <= tolerance:
                found = trial
            missed = (tries > 1 and size > SLOWLY * last) or size > ASTRAY[0] + ASTRAY[1] * length or tries >= CORRECTIONS
            unknowns = trial.unknowns + back
        if found is None:
            radius, kick = 0.5 * length, 0.5 * kick
            continue
        before = None if kick.any() else (tangent, length)
        point, slope, kick = found, found.slope, np.zeros_like(kick)
        if point.size <= tolerance and slope.values[0] >= -SOFT:
            return point
        radius = min(MOST, max(length, LEAST) * LONGER[min(tries, len(LONGER)) - 1])
    return None


def _onto(slope: Slope, across: FloatArray, turn: FloatArray) -> tuple[float, FloatArray]:
    """(21) How far a turn (m,) leads from the floor by the largest turn ``across`` it, (m, k), that leads back, and the change of
    the unknowns by both; infinitely far where nothing leads back."""
    try:
        lacking = across.T @ (slope.gradient / slope.stiffness + slope.by_turns @ turn)
        back = -np.linalg.solve(across.T @ slope.by_turns @ across, lacking)
    except np.linalg.LinAlgError:
        return np.inf, slope.back
    return float(np.abs(back).max(initial=0.0)), slope.back + slope.change(turn + across @ back)


def by_residuals(correct: Callable[[FloatArray], Run]) -> Floor:
    """The floor where all that is missing is along the last singular vector of ``Gamma``, to which ``correct`` leads: down is
    where that becomes less."""

    def floor(unknowns: FloatArray) -> Run:
        point = yield from correct(unknowns)
        if point is None:
            return None
        u, _, v = np.linalg.svd(point.gamma)
        steep = float(u[:, -1] @ point.residual)
        way = -v[-1] if steep > 0 else v[-1]
        return _Place(point, way, way, abs(steep))

    return floor
