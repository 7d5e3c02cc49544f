# mypy: ignore-errors
"""Residual and columns of held rods, the pose of their tips with them, of rods that are whole or known by their segments.

Numbers in parentheses are those of ``docs/held.md``. Before it stands ``base_kernels.hand_over``, then the rod's integration.
"""

import warp as wp

from multirod.kernels.own_module import own_module
from multirod.models.held.kernels.arguments import POSE, Ends, Held
from multirod.models.held.kernels.ball_kernels import spin_of, spin_rows, spin_rows_variation
from multirod.models.held.kernels.base_kernels import base_moment, to_unknowns, turn_axis
from multirod.models.held.kernels.end_kernels import tip_of, tip_rows, tip_rows_variation
from multirod.models.joint_kernels import column, vector, write_rows

f64 = wp.float64


@wp.func
def write_entry(held: Held, b: int, row: int, k: int, value: f64):
    """One number of Gamma, or, past its columns, of the residual's derivative by a direction; k as for a rod's columns."""
    if k < held.rod_unknowns:
        held.problem.gamma[b, row, k] = value
    elif k < held.rod_unknowns + held.direction_count:
        held.problem.residual_directions[b, row, k - held.rod_unknowns] = value
    else:
        held.problem.gamma[b, row, k - held.direction_count] = value


@own_module()
def hold(held: Held):
    """(5), (7), (8), (11): the residual with its columns, and the pose of the tip with them."""
    b = held.problem.order[wp.tid()]
    if held.problem.active[b] == 0:
        return
    zero = wp.vec3d(f64(0.0), f64(0.0), f64(0.0))
    open = f64(1.0) - held.problem.load_factor[b]
    m = held.rod_unknowns
    for i in range(wp.static(POSE)):
        to_unknowns(held, b, held.rod.pose_columns, held.rod.pose_columns, m, i)
        to_unknowns(held, b, held.wrench.columns, held.wrench.columns, m, i)
    for i in range(wp.static(POSE), m):
        to_unknowns(held, b, held.rod.gamma, held.rod.residual_directions, 0, i)
    bent = f64(1.0) / held.stiffness[b]
    force, moment = vector(held.wrench.values, b, 0), vector(held.wrench.values, b, 3)
    tip = tip_of(held, b, held.rod.position[b], held.rod.rotation[b], force, moment)
    gap, rows = tip_rows(held, b, tip)
    total = f64(0.0)
    for j in range(3):
        held.problem.residual[b, j] = gap[j] - open * held.opening[b, j]
        held.problem.residual[b, 3 + j] = rows[j] - open * held.opening[b, 3 + j]
        total += wp.abs(gap[j]) + wp.abs(rows[j])
    for i in range(wp.static(POSE), m):
        held.problem.residual[b, i] = held.rod.residual[b, i] - open * held.opening[b, i]
    spin = spin_of(held, b)
    spun = zero
    if spin.there:
        spun = spin_rows(held, b, spin)
    for j in range(held.turns):
        row = bent * base_moment(held, b) - spun
        held.problem.residual[b, m + j] = wp.dot(held.base_axes[j], row) - open * held.opening[b, m + j]

    for k in range(m + held.direction_count + held.turns):
        dp = column(held.rod.pose_columns, b, 0, k)
        tip_turn = column(held.rod.pose_columns, b, 3, k)
        dn = column(held.wrench.columns, b, 0, k)
        dm = column(held.wrench.columns, b, 3, k)
        d = int(-1)
        spun = zero
        if k >= m + held.direction_count:
            # (9) the rod turns with its base as one
            a = turn_axis(held, b, k - m - held.direction_count)
            if spin.there:
                spun = spin_rows_variation(held, b, spin, held.base_axes[k - m - held.direction_count])
            dp += wp.cross(a, held.rod.position[b] - held.base_position[b])
            tip_turn += a
            dn += wp.cross(a, force)
            dm += wp.cross(a, moment)
        elif k >= m:
            d = k - m
        if held.problem.pose_columns.shape[2] > 1:
            place = k
            if k >= m + held.direction_count:
                place = k - held.direction_count
            elif k >= m:
                place = k + held.turns
            write_rows(held.problem.pose_columns, b, 0, place, dp, tip_turn)
        db = zero
        if k < 3:
            db[k] = held.stiffness[b]
        shift, change = tip_rows_variation(held, b, tip, d, dp, tip_turn, dn, dm, db)
        for j in range(3):
            write_entry(held, b, j, k, shift[j])
            write_entry(held, b, 3 + j, k, change[j])
        for i in range(wp.static(POSE), m):
            if k < m:
                held.problem.gamma[b, i, k] = held.rod.gamma[b, i, k]
            else:
                write_entry(held, b, i, k, held.rod.residual_directions[b, i, k - m])
        for j in range(held.turns):
            write_entry(held, b, m + j, k, wp.dot(held.base_axes[j], bent * db - spun))
    held.problem.position[b] = held.rod.position[b]
    held.problem.rotation[b] = held.rod.rotation[b]
    fault = held.rod.fault[b]
    if fault == 0 and not wp.isfinite(total):
        fault = 1
    held.problem.fault[b] = fault
    held.problem.step_count[b] = held.rod.step_count[b]


@own_module()
def hold_ends(held: Held, ends: Ends):
    """(5), (7), (11) of rods that are known by their segments."""
    t = wp.tid()
    b = ends.instance[t]
    open = f64(1.0) - held.problem.load_factor[b]
    force, moment = vector(ends.wrench, t, 0), vector(ends.wrench, t, 3)
    tip = tip_of(held, b, ends.position[t], ends.rotation[t], force, moment)
    gap, rows = tip_rows(held, b, tip)
    for j in range(3):
        ends.residual[t, j] = gap[j] - open * held.opening[b, j]
        ends.residual[t, 3 + j] = rows[j] - open * held.opening[b, 3 + j]
    count = ends.columns.shape[2]
    for k in range(count):
        d = wp.max(k - (count - held.direction_count), -1)
        dp, tip_turn = column(ends.columns, t, 0, k), column(ends.columns, t, 3, k)
        dn, dm = column(ends.columns, t, 6, k), column(ends.columns, t, 9, k)
        shift, change = tip_rows_variation(held, b, tip, d, dp, tip_turn, dn, dm, column(ends.columns, t, 12, k))
        write_rows(ends.residual_columns, t, 0, k, shift, change)
