# mypy: ignore-errors
"""One evaluation of a search and the step from it, one instance a thread. Numbers in parentheses: ``docs/tasks.md``."""

import warp as wp

from multirod.kernels.linear_algebra_kernels import eliminate
from multirod.tasks.condensed_kernels import (
    Condensed,
    axis_rows,
    condense,
    place_errors,
    position_count,
    position_rows,
    rotation_rows,
    sighted_rows,
)
from multirod.tasks.programme_kernels import Programme, along_limit, keep_limits, place_rows, place_sides

f64 = wp.float64
SOFTNESS = 1e-12  # of the largest number of J, squared: what moves the tip by less than a millionth of that is damped
RADIUS = 1.0  # longest step of a freed input, in units (9)
BEND = 5.0  # most that a step changes an unknown, in its scale of curvatures
GROWTH = 10.0  # of what is left, from which a step is taken back
LENGTHENED = 2.0  # times the part of a step that was kept, the next one's
LEAST_PART = 0.02  # of a step, that is taken of such
FEW_STEPS = 10  # towards one goal, after which steps along limits that lead farther off swing about where they are to rest

# where the numbers of a search stand in ``settings``: what makes rows numbers [m], tolerance [1/m], least part of the way, the
# first part, whether instances go on that asked, whether shapes have limits, whether steps are pulled, weights of rows, whether
# there are coarse integrations
LENGTH, TOLERANCE, LEAST, PART, RESUMED, SHAPED, PULLED, POSITION_WEIGHT, ANGLE_WEIGHT, ROUGH, SETTINGS = range(11)


@wp.struct
class Drive:
    """What a search reads and writes; the first axis is the instance."""

    task: Condensed
    step: Programme
    kind: wp.vec3i  # whether a target has a position (2: across a direction, 3: along it), a rotation, an axis
    settings: wp.array[wp.float64]
    # constants
    unit: wp.array[wp.float64]  # (9), (k,)
    limits: wp.array2d[wp.float64]  # (10) G, (c, k); those of ``step`` are in units
    low: wp.array[wp.float64]  # (10), (c,)
    high: wp.array[wp.float64]
    inset_low: wp.array[wp.float64]  # the same, by so much within them that rounding leads beyond none
    inset_high: wp.array[wp.float64]
    near: wp.array[wp.float64]  # how near is at a limit, (c,)
    centre: wp.array[wp.float64]  # (k,)
    curvature: wp.array[wp.float64]  # scale of the unknowns
    residual_tolerance: wp.array[wp.float64]
    # the target
    position: wp.array[wp.vec3d]
    rotation: wp.array[wp.mat33d]
    axis: wp.array[wp.vec3d]
    direction: wp.array[wp.vec3d]
    # places
    start_x: wp.array2d[wp.float64]
    start_p: wp.array2d[wp.float64]
    last_x: wp.array2d[wp.float64]
    last_p: wp.array2d[wp.float64]
    base_x: wp.array2d[wp.float64]
    base_p: wp.array2d[wp.float64]
    here_x: wp.array2d[wp.float64]
    here_p: wp.array2d[wp.float64]
    fold_x: wp.array2d[wp.float64]
    fold_p: wp.array2d[wp.float64]
    # of a drive
    phase: wp.array[int]
    asked: wp.array[int]
    verdict: wp.array[int]  # what the host said to that
    count: wp.array[int]  # (2,): instances that are under way, and that asked
    active: wp.array[int]  # of the problem
    rough: wp.array[int]  # whether the next integration is a coarse one
    roughly: wp.array[int]  # whether that of the start was
    status: wp.array[int]
    integrations: wp.array[int]
    allowed: wp.array[int]
    iterations: wp.array[int]
    begun: wp.array[int]
    fresh: wp.array[int]  # whether the next evaluation is the first of a part
    steps: wp.array[int]  # towards this goal
    settling: wp.array[int]
    limited: wp.array[int]  # whether many steps were taken, and limits held one of the last
    blocked: wp.array[int]  # whether a limit of the shape lies ahead
    folded: wp.array[int]  # whether the target was found past a fold, at ``fold``
    done: wp.array[wp.float64]  # part of the way
    part: wp.array[wp.float64]  # the next
    goal: wp.array[wp.float64]  # its end
    damping: wp.array[wp.float64]  # part of the last step
    # at ``last``
    errors: wp.array2d[wp.float64]  # of the target's rows
    first_errors: wp.array2d[wp.float64]
    base_errors: wp.array2d[wp.float64]
    r: wp.array2d[wp.float64]
    J: wp.array3d[wp.float64]  # in units (9)
    towards: wp.array2d[wp.float64]  # (2) a
    by: wp.array3d[wp.float64]  # (2) B, in units (9)
    residual: wp.array[wp.float64]
    sign: wp.array[wp.float64]  # of det Gamma
    first_sign: wp.array[wp.float64]
    merit: wp.array[wp.float64]
    first_merit: wp.array[wp.float64]
    change: wp.array2d[wp.float64]  # the step from there, in units (9)
    # room
    found: wp.array2d[wp.float64]  # errors of the last evaluation


@wp.func
def put(to: wp.array2d[wp.float64], values: wp.array2d[wp.float64], t: int):
    for i in range(to.shape[1]):
        to[t, i] = values[t, i]


@wp.func
def put_place(
    x: wp.array2d[wp.float64],
    p: wp.array2d[wp.float64],
    from_x: wp.array2d[wp.float64],
    from_p: wp.array2d[wp.float64],
    t: int,
):
    put(x, from_x, t)
    put(p, from_p, t)


@wp.func
def left(s: wp.ref[Drive], values: wp.array2d[wp.float64], t: int) -> f64:
    """(13) Rows as they are short of the present goal: the length of them."""
    total = f64(0.0)
    for i in range(values.shape[1]):
        own = values[t, i] - (f64(1.0) - s.goal[t]) * s.first_errors[t, i]
        total += own * own
    return wp.sqrt(total)


@wp.func
def bent(s: wp.ref[Drive], t: int, values: wp.array3d[wp.float64]) -> f64:
    """How far ``a``, in the first column of what (2) leaves, bends the rods, in their scale of curvatures."""
    most = f64(0.0)
    for i in range(values.shape[1]):
        most = wp.max(most, wp.abs(values[t, i, 0]))
    return most / s.curvature[t]


@wp.func(inline=False)
def evaluate(s: wp.ref[Drive], t: int):
    """(3) Rows of the target, and its errors."""
    condense(s.task, t)
    row = position_count(s.kind[0])
    place = s.settings[wp.static(POSITION_WEIGHT)]
    if s.kind[0] == 1:
        position_rows(s.task, s.step.r, s.step.J, t, 0, s.position[t], place)
    if s.kind[0] > 1:
        sighted_rows(s.task, s.step.r, s.step.J, t, 0, s.position[t], s.kind[0], s.direction[t], place)
    if s.kind[1] != 0:
        rotation_rows(s.task, s.step.r, s.step.J, t, row, s.rotation[t], s.settings[wp.static(ANGLE_WEIGHT)])
    if s.kind[2] != 0:
        axis_rows(s.task, s.step.r, s.step.J, t, row, s.axis[t], s.settings[wp.static(ANGLE_WEIGHT)])
    weight = wp.vec2d(place, s.settings[wp.static(ANGLE_WEIGHT)])
    place_errors(s.task, s.found, t, s.kind, s.position[t], s.rotation[t], s.axis[t], s.direction[t], weight)


@wp.func
def at_limit(s: wp.ref[Drive], t: int) -> bool:
    for i in range(s.low.shape[0]):
        at = along_limit(s.limits, i, s.last_p, t)
        if at - s.low[i] <= s.near[i] or s.high[i] - at <= s.near[i]:
            return True
    return False


@wp.func(inline=False)
def accept(s: wp.ref[Drive], t: int) -> bool:
    """Take over what an integration said, where it is sound and no farther from the goal than a step may lead; whether."""
    if s.task.fault[t] != 0:
        return False
    evaluate(s, t)
    m = s.J.shape[1]
    k = s.J.shape[2]
    length = s.settings[wp.static(LENGTH)]
    bends = bent(s, t, s.task.shift)
    merit = wp.max(length * left(s, s.step.r, t), bends)
    total = merit + bends
    for i in range(m):
        for j in range(k):
            total += wp.abs(s.step.J[t, i, j])
    most = f64(wp.static(GROWTH)) * s.merit[t] + length * s.settings[wp.static(TOLERANCE)]
    if not wp.isfinite(total) or not (s.fresh[t] != 0 or merit <= most):
        return False
    put_place(s.last_x, s.last_p, s.here_x, s.here_p, t)
    if s.fresh[t] == 0:
        s.iterations[t] = s.iterations[t] + 1
    if s.fresh[t] != 0 or s.steps[t] <= wp.static(FEW_STEPS):
        s.limited[t] = 0
    elif s.goal[t] == f64(1.0) and at_limit(s, t):
        s.limited[t] = 1
    if s.limited[t] == 0:
        s.damping[t] = wp.min(f64(1.0), f64(wp.static(LENGTHENED)) * s.damping[t])
    elif merit > s.merit[t]:
        s.damping[t] = wp.max(f64(0.5) * s.damping[t], f64(wp.static(LEAST_PART)))
    s.fresh[t] = 0
    put(s.errors, s.found, t)
    put(s.r, s.step.r, t)
    for i in range(m):
        for j in range(k):
            s.J[t, i, j] = s.step.J[t, i, j] * s.unit[j]
    s.residual[t] = f64(0.0)
    for i in range(s.towards.shape[1]):
        s.residual[t] = wp.max(s.residual[t], wp.abs(s.task.residual[t, i]))
        s.towards[t, i] = s.task.shift[t, i, 0]
        for j in range(k):
            s.by[t, i, j] = s.task.shift[t, i, 1 + j] * s.unit[j]
    s.sign[t] = s.task.sign[t]
    s.merit[t] = merit
    if s.begun[t] == 0:
        s.begun[t] = 1
        s.roughly[t] = s.rough[t]
        put(s.first_errors, s.found, t)
        put(s.base_errors, s.found, t)
        s.first_sign[t] = s.sign[t]
    return True


@wp.func(inline=False)
def solve_step(s: wp.ref[Drive], t: int):
    """(7) The step from ``last`` into ``change``, no longer than ``RADIUS`` and ``BEND``."""
    m = s.J.shape[1]
    k = s.J.shape[2]
    pulled = s.settings[wp.static(PULLED)] != f64(0.0)
    largest = f64(1.0e-150)
    for i in range(m):
        s.step.r[t, i] = s.r[t, i] - (f64(1.0) - s.goal[t]) * s.first_errors[t, i]
        for j in range(k):
            s.step.J[t, i, j] = s.J[t, i, j]
            largest = wp.max(largest, wp.abs(s.J[t, i, j]))
    s.step.softness[t] = f64(wp.static(SOFTNESS)) * largest * largest
    for j in range(k):
        s.step.pull[t, j] = f64(0.0)
        if pulled:  # steps of least size converge as Newton's do, pulled ones by a rate
            s.step.pull[t, j] = (s.centre[j] - s.last_p[t, j]) / s.unit[j]
    for i in range(s.low.shape[0]):
        at = f64(0.0)
        for j in range(k):
            at += s.limits[i, j] * s.last_p[t, j]
        s.step.low[t, i] = wp.min(s.inset_low[i] - at, f64(0.0))
        s.step.high[t, i] = wp.max(s.inset_high[i] - at, f64(0.0))
    place_rows(s.step, s.step.system, t)
    place_sides(s.step, s.step.sides, t)
    eliminate(s.step.system, s.step.sides, t)
    for j in range(k):
        s.step.change[t, j] = s.step.sides[t, j, 0]
    keep_limits(s.step, t)
    size = f64(1.0)
    for j in range(k):
        size = wp.max(size, wp.abs(s.step.change[t, j]) / f64(wp.static(RADIUS)))
    for i in range(s.by.shape[1]):
        total = f64(0.0)
        for j in range(k):
            total += s.by[t, i, j] * s.step.change[t, j]
        size = wp.max(size, wp.abs(total) / (f64(wp.static(BEND)) * s.curvature[t]))
    for j in range(k):
        s.change[t, j] = s.step.change[t, j] / size


@wp.func
def step_size(s: wp.ref[Drive], t: int) -> f64:
    most = f64(0.0)
    for j in range(s.change.shape[1]):
        most = wp.max(most, wp.abs(s.change[t, j]))
    return most
