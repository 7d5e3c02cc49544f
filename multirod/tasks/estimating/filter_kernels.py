# mypy: ignore-errors
"""One sample of an estimator, after its integration. Numbers in parentheses: ``docs/estimation.md``."""

from functools import cache

import warp as wp

from multirod.kernels.failure_kernels import failure_of
from multirod.kernels.linear_algebra_kernels import eliminate
from multirod.kernels.own_module import own_module
from multirod.status import Status
from multirod.tasks.condensed_kernels import (
    Condensed,
    axis_rows,
    condense,
    position_count,
    position_rows,
    rotation_rows,
    sighted_rows,
)
from multirod.tasks.watch_kernels import FAR, LOOK, NOTHING, Watched, stand, strayed

f64 = wp.float64


@wp.struct
class Filter:
    """What an estimator reads and writes; the first axis is the instance."""

    task: Condensed
    # sensors
    kind: wp.array[wp.vec3i]  # of each, whether it is a pose with a position, a rotation, an axis; else its rows are ``told``
    marker: wp.array[int]  # of each pose along a rod its number, -1 of others
    row: wp.array[int]  # the first of each
    whitening: wp.array4d[wp.float64]  # of rows of poses, lower triangular, (instance, sensor, 6, 6)
    # what they say
    position: wp.array2d[wp.vec3d]  # (instance, sensor)
    rotation: wp.array2d[wp.mat33d]
    axis: wp.array2d[wp.vec3d]
    direction: wp.array2d[wp.vec3d]
    marks: Condensed  # of markers, where they are, their frames, and what is carried; the first axis is (instance, marker)
    columns: wp.array3d[wp.float64]  # of these poses by x and by p, (instance times marker, 6, n + k)
    told: wp.array3d[wp.float64]  # rows, each its error, then its derivatives by x and by p, (instance, m, 1 + n + k)
    known: wp.array2d[int]  # which rows there are, (instance, m)
    gated: int
    most: wp.array[wp.float64]  # (15) what the squares of 0, 1, ... rows are at most
    rejected: wp.array2d[int]  # (instance, sensor)
    # kept from sample to sample
    begun: wp.array[int]  # whether it goes on from the last sample
    again: wp.array[int]  # whether this sample is updated once more, from what it began with; -1 leaves it as it is
    prior: wp.array2d[wp.float64]  # what it began with: the mean, and P^-, (10)
    grown: wp.array3d[wp.float64]
    sign: wp.array[wp.float64]  # of det Gamma where it began
    walked: wp.array3d[wp.float64]  # Q dt, (instance, k, k)
    mean: wp.array2d[wp.float64]
    covariance: wp.array3d[wp.float64]
    free: wp.array3d[wp.float64]  # the covariance had nothing been measured
    square: wp.array[wp.float64]  # of what was measured and not expected
    status: wp.array[int]
    moved: wp.array[wp.float64]  # (28), and its left side
    bent: wp.array[wp.float64]
    # whether it is stable
    watched: Watched
    curvature: wp.array[wp.float64]  # scale of unknowns [1/m], (instance)
    unit: wp.array[wp.float64]  # (9) of docs/tasks.md, (k)
    doubt: wp.array[int]  # what has to be done about the sample, as ``watch_kernels`` says
    # room
    r: wp.array2d[wp.float64]  # (3), (instance, m)
    J: wp.array3d[wp.float64]
    marker_r: wp.array2d[wp.float64]  # the same of each marker, (instance times marker, 6)
    marker_J: wp.array3d[wp.float64]
    normal: wp.array3d[wp.float64]  # J^T r and J^T J beside each other, (instance, k, 1 + k)
    system: wp.array3d[wp.float64]  # (instance, k, k)
    sides: wp.array3d[wp.float64]  # the step and the covariance, (instance, k, 1 + k)
    offset: wp.array2d[wp.float64]  # p_i - p_0 of (28), (instance, k)
    unknowns: wp.array2d[wp.float64]  # those of the next sample


@wp.func(inline=False)
def told_row(s: Filter, t: int, row: int):
    """(3) A row that is no pose's."""
    n = s.task.gamma.shape[1]
    k = s.walked.shape[1]
    for j in range(1 + k):
        total = s.told[t, row, 0]
        if j > 0:
            total = s.told[t, row, n + j]
        for l in range(n):
            total += s.told[t, row, 1 + l] * s.task.shift[t, l, j]
        if j == 0:
            s.r[t, row] = total
        else:
            s.J[t, row, j - 1] = total


@wp.func
def end_of(s: Filter, i: int) -> int:
    """Of the rows of a sensor."""
    end = s.r.shape[1]
    if i + 1 < s.row.shape[0]:
        end = s.row[i + 1]
    return end


@wp.func
def leave_out(s: Filter, t: int, row: int):
    s.r[t, row] = f64(0.0)
    for j in range(s.J.shape[2]):
        s.J[t, row, j] = f64(0.0)


@wp.func(inline=False)
def whiten(s: Filter, t: int, i: int):
    """The rows of a sensor in its standard deviations."""
    first = s.row[i]
    m = end_of(s, i) - first
    for at in range(m):
        row = m - 1 - at  # those before it are not multiplied yet
        total = f64(0.0)
        for l in range(row + 1):
            total += s.whitening[t, i, row, l] * s.r[t, first + l]
        s.r[t, first + row] = total
        for j in range(s.J.shape[2]):
            total = f64(0.0)
            for l in range(row + 1):
                total += s.whitening[t, i, row, l] * s.J[t, first + l, j]
            s.J[t, first + row, j] = total


@wp.func(inline=False)
def pose_rows(
    task: Condensed, r: wp.array2d[wp.float64], J: wp.array3d[wp.float64], t: int, row: int, s: Filter, own: int, i: int
):
    """(3) Of a sensor ``i`` of instance ``own``, which sees the pose ``t`` of ``task``."""
    kind = s.kind[i]
    angles = row + position_count(kind[0])
    if kind[0] == 1:
        position_rows(task, r, J, t, row, s.position[own, i], f64(1.0))
    if kind[0] > 1:
        sighted_rows(task, r, J, t, row, s.position[own, i], kind[0], s.direction[own, i], f64(1.0))
    if kind[1] != 0:
        rotation_rows(task, r, J, t, angles, s.rotation[own, i], f64(1.0))
    if kind[2] != 0:
        axis_rows(task, r, J, t, angles, s.axis[own, i], f64(1.0))


@wp.func(inline=False)
def marker_rows(s: Filter, t: int, i: int):
    """(2), (3) Of a pose along a rod."""
    n = s.task.gamma.shape[1]
    k = s.walked.shape[1]
    q = t * (s.columns.shape[0] // s.r.shape[0]) + s.marker[i]
    for row in range(6):
        for j in range(1 + k):
            total = f64(0.0)
            if j > 0:
                total = s.columns[q, row, n + j - 1]
            for l in range(n):
                total += s.columns[q, row, l] * s.task.shift[t, l, j]
            s.marks.carried[q, row, j] = total
    pose_rows(s.marks, s.marker_r, s.marker_J, q, 0, s, t, i)
    first = s.row[i]
    for row in range(end_of(s, i) - first):
        s.r[t, first + row] = s.marker_r[q, row]
        for j in range(k):
            s.J[t, first + row, j] = s.marker_J[q, row, j]


@wp.func(inline=False)
def place_rows(s: Filter, t: int):
    """(3) Of all sensors; zeros in the place of those that are missing."""
    for i in range(s.kind.shape[0]):
        kind = s.kind[i]
        if kind[0] + kind[1] + kind[2] == 0:
            for row in range(s.row[i], end_of(s, i)):
                told_row(s, t, row)
        else:
            if s.marker[i] < 0:
                pose_rows(s.task, s.r, s.J, t, s.row[i], s, t, i)
            else:
                marker_rows(s, t, i)
            whiten(s, t, i)
    for row in range(s.r.shape[1]):
        if s.known[t, row] == 0:
            leave_out(s, t, row)
        if s.again[t] > 0:  # (28)
            for j in range(s.J.shape[2]):
                s.r[t, row] = s.r[t, row] - s.J[t, row, j] * s.offset[t, j]


@wp.func(inline=False)
def step_by(s: Filter, t: int, first: int, end: int) -> f64:
    """(11) By some rows: the step and the covariance into ``sides``; returns ``r^T (r + J dp)``, the left side of (15)."""
    k = s.walked.shape[1]
    for i in range(k):
        for j in range(1 + k):
            total = f64(0.0)
            for row in range(first, end):
                if j == 0:
                    total += s.J[t, row, i] * s.r[t, row]
                else:
                    total += s.J[t, row, i] * s.J[t, row, j - 1]
            s.normal[t, i, j] = total
    for i in range(k):
        for j in range(1 + k):
            total = f64(0.0)
            for l in range(k):
                total += s.covariance[t, i, l] * s.normal[t, l, j]
            if j == 0:
                s.sides[t, i, 0] = -total
            else:
                s.system[t, i, j - 1] = total
        s.system[t, i, i] = s.system[t, i, i] + f64(1.0)
        for j in range(k):
            s.sides[t, i, 1 + j] = s.covariance[t, i, j]
    eliminate(s.system, s.sides, t)
    square = f64(0.0)
    for row in range(first, end):
        left = s.r[t, row]
        for j in range(k):
            left += s.J[t, row, j] * s.sides[t, j, 0]
        square += s.r[t, row] * left
    return square


@wp.func(inline=False)
def gate(s: Filter, t: int):
    """(15) Zeros in the place of outliers."""
    for i in range(s.kind.shape[0]):
        first = s.row[i]
        end = end_of(s, i)
        there = int(0)
        for row in range(first, end):
            there += s.known[t, row]
        if step_by(s, t, first, end) > s.most[there]:
            s.rejected[t, i] = 1
            for row in range(first, end):
                leave_out(s, t, row)


@wp.func(inline=False)
def update(s: Filter, t: int):
    """(11), (12): the step and the covariance into ``sides``, the unknowns that go along."""
    s.square[t] = step_by(s, t, 0, s.r.shape[1])
    for i in range(s.unknowns.shape[1]):
        x = s.task.unknowns[t, i] + s.task.shift[t, i, 0]
        for j in range(s.walked.shape[1]):
            x += s.task.shift[t, i, 1 + j] * (s.sides[t, j, 0] - s.offset[t, j])
        s.unknowns[t, i] = x


@wp.func(inline=False)
def judge(s: Filter, t: int) -> int:
    """Past a fold the sign of ``det Gamma`` is no more that of the start."""
    if s.task.fault[t] != 0:
        return failure_of(s.task.fault[t])
    total = f64(0.0)
    for i in range(s.unknowns.shape[1]):
        total += s.task.shift[t, i, 0]
    if not wp.isfinite(total):
        return wp.static(int(Status.SINGULAR_JACOBIAN))
    if s.task.sign[t] != s.sign[t]:
        return wp.static(int(Status.UNSTABLE))
    for i in range(s.unknowns.shape[1]):
        total += s.unknowns[t, i]
    return wp.where(wp.isfinite(total), wp.static(int(Status.TRACKING)), wp.static(int(Status.NONFINITE)))


@wp.func
def look(s: Filter, t: int) -> int:
    """Whether the sample may have lost its stability, which the sign does not say of two modes at once."""
    far = f64(0.0)
    for i in range(s.unknowns.shape[1]):
        far = wp.max(far, wp.abs(s.unknowns[t, i] - s.task.unknowns[t, i]) / s.curvature[t])
    for j in range(s.unit.shape[0]):
        far = wp.max(far, wp.abs(s.sides[t, j, 0] - s.offset[t, j]) / s.unit[j])
    if s.watched.on != 0:
        stand(s.watched, s.task, t, s.unit)
        for j in range(s.unit.shape[0]):
            s.watched.command[t, j] = (s.mean[t, j] + s.sides[t, j, 0]) / s.unit[j]
    # inputs that are not estimated change too: each is compared
    found = strayed(s.watched, s.task, t, s.curvature[t], True)
    return wp.where(far > f64(wp.static(FAR)) and s.watched.on != 0, wp.static(LOOK), found)


@wp.func(inline=False)
def bend(s: Filter, t: int):
    """(28) How far the sample led from where its rows were, in standard deviations, and by how much they may be others there."""
    square = f64(0.0)
    for row in range(s.r.shape[1]):
        total = f64(0.0)
        for j in range(s.J.shape[2]):
            total += s.J[t, row, j] * (s.sides[t, j, 0] - s.offset[t, j])
        square += total * total
    far = f64(0.0)
    for i in range(s.unknowns.shape[1]):
        far = wp.max(far, wp.abs(s.unknowns[t, i] - s.task.unknowns[t, i]) / s.curvature[t])
    for i in range(3, 6):
        turned = s.task.carried[t, i, 0]
        for j in range(s.J.shape[2]):
            turned += s.task.carried[t, i, 1 + j] * (s.sides[t, j, 0] - s.offset[t, j])
        far = wp.max(far, wp.abs(turned))
    s.moved[t] = wp.sqrt(square)
    s.bent[t] = s.moved[t] * far


@cache
def make_filter():
    """Kernel for one sample: from the integration at what is expected to the estimate, and to the next integration's place."""

    @own_module(max_unroll=1)
    def advance(s: Filter):
        t = wp.tid()
        k = s.walked.shape[1]
        if s.again[t] < 0:
            return
        for i in range(k):
            for j in range(k):
                if s.again[t] == 0:
                    s.free[t, i, j] = s.free[t, i, j] + s.walked[t, i, j]
                    s.grown[t, i, j] = s.covariance[t, i, j] + s.walked[t, i, j]
                s.covariance[t, i, j] = s.grown[t, i, j]
            s.offset[t, i] = f64(0.0)
            if s.again[t] == 0:
                s.prior[t, i] = s.mean[t, i]
            else:
                s.mean[t, i] = s.prior[t, i]
                s.offset[t, i] = s.task.inputs[t, s.task.places[i]] - s.prior[t, i]
        s.bent[t] = f64(0.0)
        for i in range(s.rejected.shape[1]):
            s.rejected[t, i] = 0
        s.doubt[t] = wp.static(NOTHING)
        if s.begun[t] == 0:
            return
        if s.task.fault[t] == 0:
            condense(s.task, t)
            place_rows(s, t)
            if s.gated != 0:
                gate(s, t)
            update(s, t)
        status = judge(s, t)
        s.status[t] = status
        if status != wp.static(int(Status.TRACKING)):
            s.begun[t] = 0
            s.square[t] = f64(wp.nan)
            return
        s.doubt[t] = look(s, t)
        bend(s, t)
        for i in range(s.unknowns.shape[1]):
            s.task.unknowns[t, i] = s.unknowns[t, i]
        for i in range(k):
            s.mean[t, i] = s.mean[t, i] + s.sides[t, i, 0]
            s.task.inputs[t, s.task.places[i]] = s.mean[t, i]
            for j in range(k):
                s.covariance[t, i, j] = f64(0.5) * (s.sides[t, i, 1 + j] + s.sides[t, j, 1 + i])

    return advance
