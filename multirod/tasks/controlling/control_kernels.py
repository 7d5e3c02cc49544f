# mypy: ignore-errors
"""One sample of a controller, after its integration. Numbers in parentheses: ``docs/tasks.md``."""

from functools import cache

import warp as wp

from multirod.kernels.failure_kernels import failure_of
from multirod.kernels.own_module import own_module
from multirod.models.rotation_kernels import rotation_from_vector, rotation_vector
from multirod.status import Status
from multirod.tasks.condensed_kernels import (
    across,
    axis_rows,
    condense,
    counted,
    position_count,
    position_rows,
    rotation_rows,
    sighted_rows,
    tilt,
)
from multirod.tasks.controlling.control_step_kernels import LEFT_OVER, Control, bounded, factor, holds, place_start
from multirod.tasks.rows import ON_TARGET
from multirod.tasks.watch_kernels import FAR, LOOK, NOTHING, stand, strayed

f64 = wp.float64

# where the numbers of a sample stand in ``told``
# SURPRISE is (16d); the last: p, the pose's columns by p, row by row, at_limit; then of each limit whether it holds
ERROR, SINGULAR, HELD, OFFSET, TARGET, ANGLE, SURPRISE, FREE = 0, 1, 2, 3, 6, 9, 10, 11


@wp.func
def measure(s: Control, t: int):
    """(15), (15b) The offset between robot and model, filtered."""
    for part in range(2):
        ago = s.since[t, part]
        if s.seen[t, part] == 0 and ago > 2 * s.gap[t, part]:
            s.drift[t, part] = wp.vec3d()
        s.offset[t, part] = s.offset[t, part] + s.drift[t, part]
        if s.seen[t, part] < 0:
            s.drift[t, part] = wp.vec3d()
        if s.seen[t, part] > 0 and s.has_tip[t] != 0:
            off = s.seen_position[t] - s.tip_position[t]
            if part == 1:
                off = rotation_vector(s.seen_rotation[t] * wp.transpose(s.tip_rotation[t]))
            surprise = off - s.offset[t, part]
            s.offset[t, part] = s.offset[t, part] + s.gain[0] * surprise
            s.drift[t, part] = s.drift[t, part] + s.gain[1] * surprise
            s.gap[t, part] = wp.max(wp.min(ago, 2 * s.gap[t, part]), 1)
            ago = 0
        if ago > 0 or s.seen[t, part] > 0:
            s.since[t, part] = ago + 1


@wp.func
def place_target(s: Control, t: int):
    """(3) Rows of the target of the model, whose robot is off it."""
    back = rotation_from_vector(-s.offset[t, 1])
    row = position_count(s.kind[0])
    if s.kind[0] == 1:
        position_rows(s.task, s.step.r, s.step.J, t, 0, s.position[t] - s.offset[t, 0], s.weight[0])
    if s.kind[0] > 1:
        goal = s.position[t] - s.offset[t, 0]
        sighted_rows(s.task, s.step.r, s.step.J, t, 0, goal, s.kind[0], s.direction[t], s.weight[0])
    if s.kind[1] != 0:
        rotation_rows(s.task, s.step.r, s.step.J, t, row, back * s.rotation[t], s.weight[1])
    if s.kind[2] != 0:
        axis_rows(s.task, s.step.r, s.step.J, t, row, back * s.axis[t], s.weight[1])


@wp.func(inline=False)
def look_back(s: Control, t: int):
    """(16d) How far the tip is from where the last sample foresaw it, as the target's rows count it; 0 where none did."""
    if s.foresaw[t] == 0:
        return
    off = s.task.position[t] - s.foreseen_position[t]
    turn = rotation_vector(s.task.rotation[t] * wp.transpose(s.foreseen_rotation[t]))
    for i in range(3):
        off[i] = off[i] + s.task.carried[t, i, 0]
        turn[i] = turn[i] + s.task.carried[t, 3 + i, 0]
    if s.kind[0] > 1:
        off = counted(s.kind[0], s.direction[t]) * off
    if s.kind[2] != 0:
        turn = turn - wp.dot(turn, s.axis[t]) * s.axis[t]
    total = f64(0.0)
    if s.kind[0] != 0:
        total += s.weight[0] * s.weight[0] * wp.length_sq(off)
    if s.kind[1] + s.kind[2] != 0:
        total += s.weight[1] * s.weight[1] * wp.length_sq(turn)
    s.told[t, wp.static(SURPRISE)] = wp.sqrt(total)


@wp.func
def foresee(s: Control, t: int, moved: bool):
    """(16d) Where the tip is to be at the next sample's place, to first order: ``change`` from the command if it ``moved``."""
    move = wp.vec3d()
    turn = wp.vec3d()
    if moved:
        for i in range(3):
            for j in range(s.unit.shape[0]):
                change = s.unit[j] * s.step.change[t, j]
                move[i] = move[i] + s.task.carried[t, i, 1 + j] * change
                turn[i] = turn[i] + s.task.carried[t, 3 + i, 1 + j] * change
    s.foreseen_position[t] = s.tip_position[t] + move
    s.foreseen_rotation[t] = rotation_from_vector(turn) * s.tip_rotation[t]
    s.foresaw[t] = 1


@wp.func
def judge(s: Control, t: int) -> int:
    """Whether there is an equilibrium to go on from that is not past a fold, where the sign of det Gamma changes."""
    total = f64(0.0)
    for i in range(s.step.r.shape[1]):
        total += s.step.r[t, i]
    if not wp.isfinite(total):
        return wp.static(int(Status.NONFINITE))
    if s.begun[t] == f64(0.0):
        s.begun[t] = s.task.sign[t]
    return wp.where(s.task.sign[t] == s.begun[t], wp.static(int(Status.TRACKING)), wp.static(int(Status.UNSTABLE)))


@wp.func
def expect(s: Control, t: int) -> bool:
    """(16) By how much the next sample's rows will be off, by the target's last change and what that changed by."""
    move = wp.vec3d()
    turn = wp.vec3d()
    known = s.last_kind[t] == s.kind
    if known:
        if s.kind[0] != 0:
            move = s.position[t] - s.last_position[t]
        if s.kind[1] != 0:
            turn = rotation_vector(s.rotation[t] * wp.transpose(s.last_rotation[t]))
        if s.kind[2] != 0:
            turn = wp.cross(s.last_axis[t], s.axis[t])
    s.last_kind[t] = s.kind
    s.last_position[t] = s.position[t]
    s.last_rotation[t] = s.rotation[t]
    s.last_axis[t] = s.axis[t]
    to = f64(2.0) * move - s.motion[t, 0]
    by = f64(2.0) * turn - s.motion[t, 1]
    s.motion[t, 0] = move
    s.motion[t, 1] = turn
    row = position_count(s.kind[0])
    aside = to
    if s.kind[0] > 1:
        aside = counted(s.kind[0], s.direction[t]) * to
    for i in range(row):
        s.ahead[t, i] = -s.weight[0] * aside[i]
    if s.kind[1] != 0:
        for i in range(3):
            s.ahead[t, row + i] = -s.weight[1] * by[i]
    if s.kind[2] != 0:
        # how a still tip would be tilted from an axis that turns
        turned = wp.transpose(rotation_from_vector(by)) * s.axis[t]
        tilted = across(s.axis[t]) * tilt(turned, s.axis[t])
        for i in range(2):
            s.ahead[t, row + i] = s.weight[1] * tilted[i]
    return known and wp.max(wp.length(to), wp.length(by)) > f64(0.0)


@wp.func
def keep_before(s: Control, t: int):
    """The sample before."""
    for i in range(s.task.unknowns.shape[1]):
        s.before_unknowns[t, i] = s.good_unknowns[t, i]
    for j in range(s.unit.shape[0]):
        s.before_values[t, j] = s.good_values[t, j]
    s.before_position[t] = s.tip_position[t]
    s.before_rotation[t] = s.tip_rotation[t]
    s.before_tip[t] = s.has_tip[t]


@wp.func(inline=False)
def move_tip(s: Control, t: int):
    """Where the tip goes, to first order."""
    move = wp.vec3d()
    turn = wp.vec3d()
    for i in range(3):
        move[i] = s.task.carried[t, i, 0]
        turn[i] = s.task.carried[t, 3 + i, 0]
        for j in range(s.unit.shape[0]):
            change = s.unit[j] * s.step.change[t, j]
            move[i] = move[i] + s.task.carried[t, i, 1 + j] * change
            turn[i] = turn[i] + s.task.carried[t, 3 + i, 1 + j] * change
    s.tip_position[t] = s.task.position[t] + move
    s.tip_rotation[t] = rotation_from_vector(turn) * s.task.rotation[t]
    s.has_tip[t] = 1
    s.task.position[t] = s.tip_position[t]
    s.task.rotation[t] = s.tip_rotation[t]


@wp.func(inline=False)
def tell(s: Control, t: int):
    """What the step leaves over, and what holds it."""
    m = s.step.J.shape[1]
    k = s.step.J.shape[2]
    short = f64(0.0)
    asked = f64(0.0)
    first = position_count(s.kind[0])
    off = f64(0.0)
    angle = f64(0.0)
    for i in range(m):
        left = s.rows[t, i]
        asked = wp.max(asked, wp.abs(left))
        for j in range(k):
            left += s.step.J[t, i, j] * s.step.change[t, j]
        short = wp.max(short, wp.abs(left))
        if i < first:
            off += left * left
        else:
            angle += left * left
    held = int(0)
    for i in range(s.low.shape[0]):
        if holds(s.step, i, t):
            held = 1
            s.told[t, wp.static(FREE) + 8 * k + i] = f64(1.0)
            for j in range(k):
                if s.step.limits[i, j] != f64(0.0):
                    s.told[t, wp.static(FREE) + 7 * k + j] = f64(1.0)
    near = f64(wp.static(ON_TARGET)) * s.weight[1]
    s.told[t, wp.static(ERROR)] = wp.where(first > 0, wp.sqrt(off) / s.weight[0], f64(wp.nan))
    s.told[t, wp.static(ANGLE)] = wp.where(m > first, wp.sqrt(angle) / s.weight[1], f64(wp.nan))
    if held == 0 and short > wp.max(near, f64(wp.static(LEFT_OVER)) * asked):
        s.told[t, wp.static(SINGULAR)] = f64(1.0)
    if held != 0 and short > near:
        s.told[t, wp.static(HELD)] = f64(1.0)
    for i in range(6):
        for j in range(k):
            s.told[t, wp.static(FREE) + (1 + i) * k + j] = s.task.carried[t, i, 1 + j]


@wp.func
def keep_record(s: Control, t: int):
    """A copy of the problem's, before it goes on to the next sample."""
    for i in range(s.records.shape[1]):
        s.record[t, i] = s.records[t, i]


@wp.func(inline=False)
def fail(s: Control, t: int):
    """The next sample starts from the last good one."""
    keep_record(s, t)
    k = s.unit.shape[0]
    s.told[t, wp.static(ERROR)] = f64(wp.nan)
    s.told[t, wp.static(ANGLE)] = f64(wp.nan)
    for i in range(6 * k):
        s.told[t, wp.static(FREE) + k + i] = f64(wp.nan)
    for i in range(s.task.unknowns.shape[1]):
        s.task.unknowns[t, i] = s.good_unknowns[t, i]
    for j in range(k):
        s.values[t, j] = s.good_values[t, j]
        s.task.inputs[t, s.task.places[j]] = s.values[t, j]
    s.foresaw[t] = 0
    s.last_kind[t] = wp.vec3i()
    s.motion[t, 0] = wp.vec3d()
    s.motion[t, 1] = wp.vec3d()


@cache
def make_control():
    """Kernel for one sample: from the integration at what was expected to its command, and to what is expected next."""

    @own_module(max_unroll=1)
    def control(s: Control):
        t = wp.tid()
        k = s.unit.shape[0]
        for i in range(s.told.shape[1]):
            s.told[t, i] = f64(0.0)
        for j in range(k):
            s.values[t, j] = s.task.inputs[t, s.task.places[j]]
        measure(s, t)
        for i in range(3):
            s.told[t, wp.static(OFFSET) + i] = s.offset[t, 0][i]
            s.told[t, wp.static(TARGET) + i] = s.position[t][i]
        s.doubt[t] = wp.static(NOTHING)
        status = int(wp.static(int(Status.TRACKING)))
        if s.task.fault[t] != 0:
            status = failure_of(s.task.fault[t])
        else:
            condense(s.task, t)
            place_target(s, t)
            look_back(s, t)
            status = judge(s, t)
        if status != wp.static(int(Status.TRACKING)):
            fail(s, t)
        else:
            moving = expect(s, t)
            if s.pulled != 0 and not moving:
                for i in range(s.ahead.shape[1]):
                    s.ahead[t, i] = f64(0.0)
            factor(s, t)
            bounded(s, t, 0)
            tell(s, t)
            if s.told[t, wp.static(HELD)] != f64(0.0):
                status = wp.static(int(Status.AT_LIMIT))
            if s.told[t, wp.static(SINGULAR)] != f64(0.0):
                status = wp.static(int(Status.OFF_TARGET))
            if s.watched.on != 0:
                stand(s.watched, s.task, t, s.unit)
            gone = place_start(s, t, True)
            if s.watched.on != 0:
                for j in range(k):
                    s.watched.command[t, j] = s.values[t, j] / s.unit[j]
            s.doubt[t] = strayed(s.watched, s.task, t, s.curvature, False)
            if gone > f64(wp.static(FAR)) and s.watched.on != 0:
                s.doubt[t] = wp.static(LOOK)
            keep_before(s, t)
            move_tip(s, t)
            keep_record(s, t)
            for i in range(s.task.unknowns.shape[1]):
                s.good_unknowns[t, i] = s.task.unknowns[t, i]
            for j in range(k):
                s.good_values[t, j] = s.values[t, j]
            ahead = moving or s.pulled != 0
            if ahead:
                for i in range(s.ahead.shape[1]):
                    s.step.r[t, i] = s.ahead[t, i]
                bounded(s, t, 1)
                place_start(s, t, False)
            foresee(s, t, ahead)
        for j in range(k):
            s.told[t, wp.static(FREE) + j] = s.good_values[t, j]
        s.status[t] = status

    return control
