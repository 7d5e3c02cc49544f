# mypy: ignore-errors
"""The step of a controller's sample, and its arrays. Numbers in parentheses: ``docs/tasks.md``."""

import warp as wp

from multirod.kernels.linear_algebra_kernels import eliminate
from multirod.tasks.condensed_kernels import Condensed
from multirod.tasks.limits import NEAR
from multirod.tasks.programme_kernels import Programme, along_limit, keep_limits, place_rows, row_size
from multirod.tasks.watch_kernels import Watched

f64 = wp.float64
SOFTNESS = 1e-8  # of the largest number of J, squared: a ten thousandth of what moves the tip most is damped
SOFTER = 10.0  # times that, if a step is longer than it may be where the target is beyond reach, (16d)
TIMES = 6
LONGEST = 0.3  # step of a sample, in units (9)
PULL = 0.05  # of the way to what is preferred, in a sample
MOST_PULL = 0.03  # the most of it, in units (9)
STEEP = 5.0  # (17c) q, from which the pull fades, and at twice of which there is none
LEFT_OVER = 1e-3  # part of what is asked for that a step leaves over where nothing else holds it: the task is singular


@wp.struct
class Control:
    """What a controller reads and writes; the first axis is the instance."""

    task: Condensed
    step: Programme
    # constants
    unit: wp.array[wp.float64]  # (9), (k,)
    limits: wp.array2d[wp.float64]  # (10) G, (c, k); those of ``step`` are in units
    low: wp.array[wp.float64]  # (10), (c,)
    high: wp.array[wp.float64]
    weight: wp.vec2d  # of positions, of angles
    gain: wp.vec2d  # (15) of the offset, of its drift
    kind: wp.vec3i  # whether there is a position (2: across a direction, 3: along it), a rotation, an axis
    pulled: int  # whether what the target leaves free is pulled to ``centre``
    centre: wp.array[wp.float64]  # (k,)
    # what is asked for and measured
    position: wp.array[wp.vec3d]
    rotation: wp.array[wp.mat33d]
    axis: wp.array[wp.vec3d]
    direction: wp.array[wp.vec3d]
    seen_position: wp.array[wp.vec3d]
    seen_rotation: wp.array[wp.mat33d]
    seen: wp.array2d[int]  # of each: 0 not measured, 1 measured, -1 missing
    # kept from sample to sample
    offset: wp.array2d[wp.vec3d]  # (15) of position and rotation
    drift: wp.array2d[wp.vec3d]
    since: wp.array2d[int]  # samples since it was last measured, 0 before
    gap: wp.array2d[int]  # (15b) samples between two measurements
    tip_position: wp.array[wp.vec3d]  # of the model
    tip_rotation: wp.array[wp.mat33d]
    has_tip: wp.array[int]
    last_kind: wp.array[wp.vec3i]  # none before the first sample
    last_position: wp.array[wp.vec3d]
    last_rotation: wp.array[wp.mat33d]
    last_axis: wp.array[wp.vec3d]
    motion: wp.array2d[wp.vec3d]  # (16) D
    foreseen_position: wp.array[wp.vec3d]  # (16d) of the tip, at the place of this sample's integration
    foreseen_rotation: wp.array[wp.mat33d]
    foresaw: wp.array[int]  # whether that is known
    begun: wp.array[wp.float64]  # the sign of det Gamma at the start, 0 before
    good_unknowns: wp.array2d[wp.float64]
    good_values: wp.array2d[wp.float64]
    watched: Watched
    longest: wp.array[wp.float64]  # step of a sample, in units (9)
    nearby: wp.array[wp.float64]  # (16d) the same, that a softer one is taken for
    curvature: wp.float64  # scale of unknowns [1/m], whose steps are told by it, those of values in units (9)
    doubt: wp.array[int]  # what has to be done about the sample, as ``watch_kernels`` says
    # of the sample before, for one that turns out not to be stable
    before_unknowns: wp.array2d[wp.float64]
    before_values: wp.array2d[wp.float64]
    before_position: wp.array[wp.vec3d]
    before_rotation: wp.array[wp.mat33d]
    before_tip: wp.array[int]
    # of the problem, and its copy for the sample
    records: wp.array2d[wp.float64]
    record: wp.array2d[wp.float64]
    told: wp.array2d[wp.float64]
    status: wp.array[int]
    # room
    rows: wp.array2d[wp.float64]  # r, (instance, m)
    ahead: wp.array2d[wp.float64]  # by how much rows will be off in the next sample
    pull: wp.array2d[wp.float64]  # (16c), (instance, k)
    values: wp.array2d[wp.float64]  # p, (instance, k)


@wp.func(inline=False)
def leaves_over(s: Control, t: int) -> bool:
    """Whether the step does not meet all rows."""
    asked = f64(0.0)
    short = f64(0.0)
    for i in range(s.step.J.shape[1]):
        left = s.step.r[t, i]
        asked = wp.max(asked, wp.abs(left))
        for j in range(s.step.J.shape[2]):
            left += s.step.J[t, i, j] * s.step.sides[t, j, 0]
        short = wp.max(short, wp.abs(left))
    return short > f64(wp.static(LEFT_OVER)) * asked


@wp.func
def place_pull(s: Control, t: int):
    """(16c) Before what it would do to the target is taken from it."""
    for j in range(s.unit.shape[0]):
        toward = f64(wp.static(PULL)) * (s.centre[j] - s.values[t, j]) / s.unit[j]
        s.step.sides[t, j, 2] = wp.sqrt(s.step.softness[t]) * toward
    for i in range(s.step.J.shape[1]):
        s.step.sides[t, s.unit.shape[0] + i, 2] = f64(0.0)


@wp.func
def pull(s: Control, t: int):
    """(16c) Beside the way to the next sample's place: less of it beside a fold, to which it is not to lead."""
    most = f64(wp.static(MOST_PULL))
    steep = f64(0.0)
    for j in range(s.unit.shape[0]):
        most = wp.max(most, wp.abs(s.step.sides[t, j, 2]))
        steep = wp.max(steep, s.watched.growth[t, j, j])
    part = wp.clamp(f64(2.0) - wp.sqrt(steep) / f64(wp.static(STEEP)), f64(0.0), f64(1.0))
    for j in range(s.unit.shape[0]):
        s.pull[t, j] = s.step.sides[t, j, 2] * (part * f64(wp.static(MOST_PULL)) / most)
        s.step.sides[t, j, 1] = s.step.sides[t, j, 1] + s.pull[t, j]


@wp.func(inline=False)
def solve_rows(s: Control, t: int):
    """(8) Without limits, for this sample's rows, for the next one's, and for what is pulled."""
    m = s.step.J.shape[1]
    k = s.step.J.shape[2]
    place_rows(s.step, s.step.system, t)
    for j in range(k):
        for side in range(2):
            s.step.sides[t, j, side] = f64(0.0)
    for i in range(m):
        s.step.sides[t, k + i, 0] = -s.step.r[t, i]
        s.step.sides[t, k + i, 1] = -s.ahead[t, i]
    if s.pulled != 0:
        place_pull(s, t)
    eliminate(s.step.system, s.step.sides, t)


@wp.func(inline=False)
def factor(s: Control, t: int):
    """(8) The steps of this sample and of the next one where no limit holds, into columns of ``sides``."""
    m = s.step.J.shape[1]
    k = s.step.J.shape[2]
    largest = f64(1.0e-150)
    for i in range(m):
        s.rows[t, i] = s.step.r[t, i]
        for j in range(k):
            s.step.J[t, i, j] = s.step.J[t, i, j] * s.unit[j]
            largest = wp.max(largest, wp.abs(s.step.J[t, i, j]))
    s.step.softness[t] = f64(wp.static(SOFTNESS)) * largest * largest
    solve_rows(s, t)
    if leaves_over(s, t):
        # what no step meets would be asked for at each sample, and add up along directions that move the tip next to nothing
        for i in range(m):
            for side in range(2):
                met = f64(0.0)
                for j in range(k):
                    met += s.step.J[t, i, j] * s.step.sides[t, j, side]
                if side == 0:
                    s.step.r[t, i] = -met
                else:
                    s.ahead[t, i] = -met
        solve_rows(s, t)
    if s.pulled != 0:
        pull(s, t)


@wp.func(inline=False)
def within(s: Control, t: int, side: int) -> f64:
    """(8) The step of a column of ``sides`` within limits, into ``change``; how long it is."""
    longest = f64(0.0)
    for j in range(s.unit.shape[0]):
        s.step.change[t, j] = s.step.sides[t, j, side]
        if s.pulled != 0:
            s.step.pull[t, j] = f64(side) * s.pull[t, j]
    keep_limits(s.step, t)
    for j in range(s.unit.shape[0]):
        longest = wp.max(longest, wp.abs(s.step.change[t, j]))
    return longest


@wp.func(inline=False)
def bounded(s: Control, t: int, side: int):
    """(7) The step of a sample into ``change``, within limits, and no longer than it may be."""
    k = s.unit.shape[0]
    for i in range(s.low.shape[0]):
        at = f64(0.0)
        for j in range(k):
            at += s.limits[i, j] * s.values[t, j]
        s.step.low[t, i] = wp.min(s.low[i] - at, f64(0.0))
        s.step.high[t, i] = wp.max(s.high[i] - at, f64(0.0))
    longest = within(s, t, side)
    if side == 0 and s.nearby[t] < f64(wp.static(LONGEST)):
        for _time in range(wp.static(TIMES)):
            if longest > s.nearby[t]:
                s.step.softness[t] = f64(wp.static(SOFTER)) * s.step.softness[t]
                solve_rows(s, t)
                if s.pulled != 0:
                    pull(s, t)
                longest = within(s, t, side)
    if longest > s.longest[t]:
        for j in range(k):
            s.step.change[t, j] = s.step.change[t, j] * (s.longest[t] / longest)


@wp.func
def holds(q: Programme, i: int, t: int) -> bool:
    """Whether a limit that holds the step of (7) holds that which is taken too: a part of it may end before."""
    if q.held[t, i] == 0:
        return False
    end = wp.where(q.held[t, i] > 0, q.high[t, i], q.low[t, i])
    return wp.abs(end - along_limit(q.limits, i, q.change, t)) <= f64(wp.static(NEAR)) * row_size(q, i)


@wp.func
def place_start(s: Control, t: int, from_here: bool) -> f64:
    """(2) Unknowns and values of the problem after ``change``; from the integration's on, ``a`` belongs to it. How far that
    is, of unknowns in scales of curvature, of values in units (9)."""
    k = s.unit.shape[0]
    far = f64(0.0)
    for i in range(s.task.unknowns.shape[1]):
        x = s.task.unknowns[t, i]
        if from_here:
            x += s.task.shift[t, i, 0]
        for j in range(k):
            x += s.task.shift[t, i, 1 + j] * (s.unit[j] * s.step.change[t, j])
        far = wp.max(far, wp.abs(x - s.task.unknowns[t, i]) / s.curvature)
        s.task.unknowns[t, i] = x
    for j in range(k):
        far = wp.max(far, wp.abs(s.step.change[t, j]))
        s.values[t, j] = s.values[t, j] + s.unit[j] * s.step.change[t, j]
        s.task.inputs[t, s.task.places[j]] = s.values[t, j]
    return far
