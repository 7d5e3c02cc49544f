# mypy: ignore-errors
"""The step of all tasks: a small quadratic programme, one a thread. Numbers in parentheses: ``docs/tasks.md``."""

from functools import cache

import warp as wp

from multirod.kernels.linear_algebra_kernels import eliminate
from multirod.kernels.own_module import own_module

f64 = wp.float64
ROW_ROUNDING = 1e-12  # of the largest number of a row: what of a limit is rounding


@wp.struct
class Programme:
    """(7) with weights 1, and room to solve it; the first axis is the instance."""

    J: wp.array3d[wp.float64]  # (instance, m, k)
    r: wp.array2d[wp.float64]
    softness: wp.array[wp.float64]
    pull: wp.array2d[wp.float64]  # d_0, (instance, k)
    limits: wp.array2d[wp.float64]  # G, (c, k), of all instances
    low: wp.array2d[wp.float64]
    high: wp.array2d[wp.float64]
    change: wp.array2d[wp.float64]  # d
    held: wp.array2d[wp.int32]  # 1 at the upper limit, -1 at the lower
    # room
    system: wp.array3d[wp.float64]  # (instance, k + m, k + m)
    sides: wp.array3d[wp.float64]  # (instance, k + m, 2)
    bound_system: wp.array3d[wp.float64]  # (instance, k + m + c, k + m + c)
    bound_sides: wp.array3d[wp.float64]  # (instance, k + m + c, 1)


@wp.func
def place_rows(q: Programme, system: wp.array3d[wp.float64], t: int):
    """(8) Equations of the step and of the rows; the rest is zero."""
    m = q.J.shape[1]
    k = q.J.shape[2]
    root = wp.sqrt(q.softness[t])
    for i in range(system.shape[1]):
        for j in range(system.shape[1]):
            system[t, i, j] = f64(0.0)
    for j in range(k):
        system[t, j, j] = root
        for i in range(m):
            system[t, j, k + i] = q.J[t, i, j]
            system[t, k + i, j] = q.J[t, i, j]
    for i in range(m):
        system[t, k + i, k + i] = -root


@wp.func
def place_sides(q: Programme, sides: wp.array3d[wp.float64], t: int):
    """(8) Its right side: of the step and of the rows."""
    k = q.J.shape[2]
    root = wp.sqrt(q.softness[t])
    for j in range(k):
        sides[t, j, 0] = root * q.pull[t, j]
    for i in range(q.J.shape[1]):
        sides[t, k + i, 0] = -q.r[t, i]


@wp.func
def along_limit(limits: wp.array2d[wp.float64], i: int, values: wp.array2d[wp.float64], t: int) -> f64:
    total = f64(0.0)
    for j in range(limits.shape[1]):
        total += limits[i, j] * values[t, j]
    return total


@wp.func
def row_size(q: Programme, i: int) -> f64:
    """The largest number of a limit's row."""
    size = f64(0.0)
    for j in range(q.limits.shape[1]):
        size = wp.max(size, wp.abs(q.limits[i, j]))
    return size


@wp.func
def slack(q: Programme, i: int, t: int) -> f64:
    """What of a limit is rounding."""
    size = f64(0.0)
    if wp.isfinite(q.low[t, i]):
        size = wp.abs(q.low[t, i])
    if wp.isfinite(q.high[t, i]):
        size = wp.max(size, wp.abs(q.high[t, i]))
    return f64(wp.static(ROW_ROUNDING)) * (row_size(q, i) + size)


@wp.func(inline=False)
def keep_limits(q: Programme, t: int):
    """(8) Where ``change`` is beyond limits, the step that is within all: an active set, from ``d = 0`` on.

    Limits are added as they block and left as their multipliers turn; one that depends on those that hold does not block. Rows of
    limits are made as large as those of the task: what is in units of length or force beside what is in 1/m would be rounding.
    """
    m = q.J.shape[1]
    k = q.J.shape[2]
    c = q.limits.shape[0]
    outside = bool(False)
    for i in range(c):
        q.held[t, i] = 0
        moved = along_limit(q.limits, i, q.change, t)
        rounded = slack(q, i, t)
        if not (moved >= q.low[t, i] - rounded and moved <= q.high[t, i] + rounded):
            outside = True
    if not outside:
        return
    for j in range(k):
        q.change[t, j] = f64(0.0)
    scale = wp.sqrt(q.softness[t])
    for i in range(m):
        for j in range(k):
            scale = wp.max(scale, wp.abs(q.J[t, i, j]))
    for _pass in range(3 * c + 2):
        place_rows(q, q.bound_system, t)
        place_sides(q, q.bound_sides, t)
        for i in range(c):
            row = k + m + i
            q.bound_sides[t, row, 0] = f64(0.0)
            if q.held[t, i] == 0:
                q.bound_system[t, row, row] = scale
            else:
                by = scale / row_size(q, i)
                q.bound_sides[t, row, 0] = by * wp.where(q.held[t, i] > 0, q.high[t, i], q.low[t, i])
                for j in range(k):
                    q.bound_system[t, row, j] = by * q.limits[i, j]
                    q.bound_system[t, j, row] = by * q.limits[i, j]
        eliminate(q.bound_system, q.bound_sides, t)
        # as far as no other limit blocks
        part = f64(1.0)
        blocking = int(-1)
        side = int(0)
        total = f64(0.0)
        for j in range(k):
            total += q.bound_sides[t, j, 0]
        if not wp.isfinite(total):
            return
        for i in range(c):
            if q.held[t, i] == 0:
                at = along_limit(q.limits, i, q.change, t)
                rate = -at
                for j in range(k):
                    rate += q.limits[i, j] * q.bound_sides[t, j, 0]
                if wp.abs(rate) > f64(1.0e-3) * slack(q, i, t):
                    end = wp.where(rate > f64(0.0), q.high[t, i], q.low[t, i])
                    room = wp.max((end - at) / rate, f64(0.0))
                    if room < part:
                        part = room
                        blocking = i
                        side = wp.where(rate > f64(0.0), 1, -1)
        for j in range(k):
            q.change[t, j] = q.change[t, j] + part * (q.bound_sides[t, j, 0] - q.change[t, j])
        if blocking >= 0:
            q.held[t, blocking] = side
        else:
            # a full step: leave the limit whose multiplier has turned most
            worst = int(-1)
            turned = f64(0.0)
            largest = f64(0.0)
            for i in range(m):
                largest = wp.max(largest, wp.abs(q.bound_sides[t, k + i, 0]))
            for i in range(c):
                if q.held[t, i] != 0:
                    multiplier = q.bound_sides[t, k + m + i, 0]
                    largest = wp.max(largest, wp.abs(multiplier))
                    if -f64(q.held[t, i]) * multiplier > turned:
                        turned = -f64(q.held[t, i]) * multiplier
                        worst = i
            if turned <= f64(wp.static(ROW_ROUNDING)) * largest:  # of all multipliers, the task's rows' too
                return
            q.held[t, worst] = 0


@cache
def make_keeping():
    """Kernel that brings the steps of several programmes back within their limits, where they are beyond them."""

    @own_module(max_unroll=1)
    def keep(q: Programme):
        keep_limits(q, wp.tid())

    return keep
