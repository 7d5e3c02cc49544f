# mypy: ignore-errors
"""The tip of a backbone: residual (11) to (13) and its columns, or the wrench of a tip that something else holds (22).

``y`` is the state at the tip and ``v`` a column of it, in SI units; ``n_tip`` is the force at the tip and ``dn`` its column, in
the base frame. Functions return a number that is not finite if one of what they write is not. Numbers in parentheses are those of
``docs/model.md``.
"""

from types import SimpleNamespace

import warp as wp

from multirod.models.backbone.kernels.equations.tip_pose import make_tip_pose
from multirod.models.backbone.kernels.equations.tip_units import make_tip_units
from multirod.models.backbone.kernels.layout.arguments import Call, Instance, RodTable
from multirod.models.backbone.kernels.layout.layout import Layout
from multirod.models.backbone.kernels.layout.rows import InputOffsets
from multirod.models.backbone.kernels.numbers.scalars import (
    body_rotation,
    rotate,
    rotate_inverse,
    total_magnitude,
    turned_about_z,
)

f64 = wp.float64


def make_tip(layout: Layout, base: SimpleNamespace, grid: SimpleNamespace) -> SimpleNamespace:
    """Functions that write what the tip says."""
    n, features = layout.n, layout.features
    State, Column = base.State, base.Column
    TAU_AT = layout.state["torques"]  # a column's stand alike
    TUBES, MEASURED, FIXED, HELD = layout.TUBES, features.measured, layout.FIXED, features.held
    MOMENT, TORQUES, FIRST, CONCENTRIC = layout.MOMENT, layout.TORQUES, layout.FIRST, not layout.ECCENTRIC
    # the torque of rod 1 stands for the moment about the axis of the frame, or that of the rod that ends at the tip
    SHARED = layout.TORQUES > 0 and CONCENTRIC
    FIRST_LACK = 0 if FIXED or not CONCENTRIC else 1  # the first rod whose torque is a residual of its own
    MOMENT_ROW, FORCE_ROW, TORQUE_ROW = (layout.row(name) for name in ("moment", "force", "torques"))
    FREE_FORCE, FOLLOWER_MOMENT = features.base_force_unknown and not features.held, features.follower_moment
    at = InputOffsets(n)
    ROTATION, TIP_FORCE, TIP_MOMENT, TIP_CURVATURE = at.ROTATION, at.TIP_FORCE, at.TIP_MOMENT, at.TIP_CURVATURE
    FOLLOWER_FORCE_INPUT, FOLLOWER_MOMENT_INPUT = at.FOLLOWER_FORCE, at.FOLLOWER_MOMENT
    load_vector, direction_vector = grid.load_vector, grid.direction_vector
    found = make_tip_units(layout, base, grid)
    Ends, find_ends = found.Ends, found.find_ends
    pose = make_tip_pose(layout, base)
    moment_of, moment_column_of, frame, frame_column = pose.moment_of, pose.moment_column_of, pose.frame, pose.frame_column
    body_moment, body_moment_column = pose.body_moment, pose.body_moment_column
    tip_angle, tip_angle_column = pose.tip_angle, pose.tip_angle_column

    @wp.func
    def moment_unit(case: wp.ref[Instance], ends: wp.ref[Ends]) -> wp.vec3d:
        """(11) C: the last of rod 1, or where axes are fixed of the rod that ends at the tip."""
        return wp.vec3d(ends.bending[0], ends.bending[1], ends.twist[wp.where(wp.static(FIXED), case.longest, 0)])

    @wp.func
    def torque(ends: wp.ref[Ends], y: State, i: int) -> f64:
        """Torque of rod i at its own end.

        That of a rod that has ended is constant from there on, and so is what the others leave of M_z.
        """
        if i >= wp.static(FIRST):
            return y[wp.static(TAU_AT) + i - wp.static(FIRST)]
        M = body_moment(y)
        rest = M[2]
        last = int(wp.static(TORQUES + 1))
        for j in range(1, last):
            if ends.beside[j] > f64(0.5):
                rest -= y[wp.static(TAU_AT) + j - 1]
        return rest

    @wp.func
    def torque_column(ends: wp.ref[Ends], y: State, v: Column, i: int) -> f64:
        """Its variation."""
        if i >= wp.static(FIRST):
            return v[wp.static(TAU_AT) + i - wp.static(FIRST)]
        dM = body_moment_column(y, v)
        rest = dM[2]
        last = int(wp.static(TORQUES + 1))
        for j in range(1, last):
            if ends.beside[j] > f64(0.5):
                rest -= v[wp.static(TAU_AT) + j - 1]
        return rest

    # ---- what follows the tip, in the frame: it turns with the rod that ends there ----

    @wp.func
    def following(call: wp.ref[Call], case: wp.ref[Instance], y: State, at: int) -> wp.vec3d:
        """The input that stands there, along the axes of the frame."""
        return turned_about_z(tip_angle(case, y)) * load_vector(call, case.index, at)

    @wp.func
    def following_column(call: wp.ref[Call], case: wp.ref[Instance], y: State, v: Column, direction: int, at: int) -> wp.vec3d:
        """Its variation; ``direction`` is negative of an unknown."""
        load = following(call, case, y, at)
        change = tip_angle_column(case, v) * wp.vec3d(-load[1], load[0], f64(0.0))
        if direction >= 0:
            change += turned_about_z(tip_angle(case, y)) * direction_vector(call, case, direction, at)
        return change

    # ---- (11), (11b), (12): moments ----

    @wp.func
    def axes(call: wp.ref[Call], case: wp.ref[Instance]) -> wp.mat33d:
        """(11b) Axes of the residual, from those of the base: they turn with rod 1 at its base, as the frame does."""
        if wp.static(CONCENTRIC):
            return turned_about_z(call.problem.inputs[case.index, wp.static(ROTATION)])
        return wp.identity(3, dtype=f64)

    @wp.func
    def lacking(call: wp.ref[Call], case: wp.ref[Instance], y: State) -> wp.vec3d:
        """(11), (11b) The moment at the tip less what acts there, in the frame there or along the axes of the residual."""
        if wp.static(FIXED):
            m = moment_of(y) - case.tip_moment
            if wp.static(FOLLOWER_MOMENT):
                m -= rotate(frame(y), following(call, case, y, wp.static(FOLLOWER_MOMENT_INPUT)))
            return wp.transpose(axes(call, case)) * m
        M = moment_of(y)
        if wp.static(FOLLOWER_MOMENT):
            M -= following(call, case, y, wp.static(FOLLOWER_MOMENT_INPUT))
        return M

    @wp.func
    def lacking_column(call: wp.ref[Call], case: wp.ref[Instance], y: State, v: Column, direction: int) -> wp.vec3d:
        """(11), (11b) Its variation; ``direction`` is negative of an unknown."""
        dM = moment_column_of(v)
        if wp.static(FIXED):
            q = frame(y)
            if wp.static(FOLLOWER_MOMENT):
                dphi = body_rotation(q, frame_column(v))
                dM -= rotate(q, wp.cross(dphi, following(call, case, y, wp.static(FOLLOWER_MOMENT_INPUT))))
                dM -= rotate(q, following_column(call, case, y, v, direction, wp.static(FOLLOWER_MOMENT_INPUT)))
            if direction >= 0:
                dM -= case.to_base * direction_vector(call, case, direction, TIP_MOMENT)
            dM = wp.transpose(axes(call, case)) * dM
            if wp.static(not CONCENTRIC):
                return dM
            if direction >= 0:
                m = lacking(call, case, y)
                dM += call.problem.directions[case.direction, direction, wp.static(ROTATION)] * wp.vec3d(m[1], -m[0], f64(0.0))
            return dM
        if wp.static(FOLLOWER_MOMENT):
            dM -= following_column(call, case, y, v, direction, wp.static(FOLLOWER_MOMENT_INPUT))
        return dM

    @wp.func
    def moment_row(case: wp.ref[Instance], j: int) -> int:
        """Residual of component j of what lacks: the last stands for the torque of the rod that ends at the tip."""
        if wp.static(SHARED):
            if j == 2:
                return wp.static(TORQUE_ROW - FIRST) + case.longest
        return wp.static(MOMENT_ROW) + j

    @wp.func
    def follower_torque(call: wp.ref[Call], case: wp.ref[Instance], i: int) -> f64:
        """(11) What of the follower moment twists rod i: all of it the rod that ends at the tip, where the frame is a rod's."""
        if wp.static(FOLLOWER_MOMENT and CONCENTRIC):
            if i == case.longest:
                M = load_vector(call, case.index, FOLLOWER_MOMENT_INPUT)
                return M[2]
        return f64(0.0)

    @wp.func
    def follower_torque_rate(call: wp.ref[Call], case: wp.ref[Instance], i: int, direction: int) -> f64:
        """Its rate along a direction; ``direction`` is negative of an unknown."""
        if wp.static(FOLLOWER_MOMENT and CONCENTRIC):
            if direction >= 0 and i == case.longest:
                M = direction_vector(call, case, direction, FOLLOWER_MOMENT_INPUT)
                return M[2]
        return f64(0.0)

    @wp.func
    def measured_gap(call: wp.ref[Call], case: wp.ref[Instance], ends: wp.ref[Ends], y: State, u_star: wp.vec3d) -> wp.vec3d:
        """(12): u(L) less what was measured, which is raised with the loads: the unloaded rod is where continuation begins."""
        t = case.index
        j = wp.static(TIP_CURVATURE)
        measured = wp.vec3d(call.problem.inputs[t, j], call.problem.inputs[t, j + 1], call.problem.inputs[t, j + 2])
        return wp.cw_mul(ends.compliance, body_moment(y)) - call.problem.load_factor[t] * (measured - u_star)

    @wp.func
    def measured_gap_column(
        call: wp.ref[Call], case: wp.ref[Instance], ends: wp.ref[Ends], y: State, v: Column, direction: int
    ) -> wp.vec3d:
        gap = wp.cw_mul(ends.compliance, body_moment_column(y, v))
        if direction >= 0:
            gap -= direction_vector(call, case, direction, TIP_CURVATURE)
        return gap

    # ---- (13): the force ----

    @wp.func
    def force_gap(call: wp.ref[Call], case: wp.ref[Instance], ends: wp.ref[Ends], y: State, n_tip: wp.vec3d) -> wp.vec3d:
        """(13) What the internal force at the tip lacks."""
        N = rotate_inverse(frame(y), n_tip - case.tip_force)
        return ends.force * (N - following(call, case, y, wp.static(FOLLOWER_FORCE_INPUT)))

    @wp.func
    def force_gap_column(
        call: wp.ref[Call],
        case: wp.ref[Instance],
        ends: wp.ref[Ends],
        y: State,
        v: Column,
        n_tip: wp.vec3d,
        dn: wp.vec3d,
        direction: int,
    ) -> wp.vec3d:
        """(13), (16): its variation."""
        q = frame(y)
        change = dn
        if direction >= 0:
            change -= case.to_base * direction_vector(call, case, direction, TIP_FORCE)
        dphi = body_rotation(q, frame_column(v))
        dN = rotate_inverse(q, change) + wp.cross(rotate_inverse(q, n_tip - case.tip_force), dphi)
        dN -= following_column(call, case, y, v, direction, wp.static(FOLLOWER_FORCE_INPUT))
        return ends.force * dN

    # ---- what is written ----

    @wp.func
    def write_entry(call: wp.ref[Call], case: wp.ref[Instance], row: int, k: int, value: f64):
        """One number of Gamma, or of the residual's derivative by a direction."""
        if k < call.unknown_columns:
            call.problem.gamma[case.index, row, k] = value
        else:
            call.problem.residual_directions[case.index, row, k - call.unknown_columns] = value

    @wp.func
    def write_free(
        rods: wp.ref[RodTable],
        call: wp.ref[Call],
        case: wp.ref[Instance],
        ends: wp.ref[Ends],
        y: State,
        n_tip: wp.vec3d,
        u_star: wp.vec3d,
    ) -> f64:
        """(11) to (13): the residual of a free tip."""
        t = case.index
        total = f64(0.0)
        if wp.static(MEASURED):
            gap = measured_gap(call, case, ends, y, u_star)
            total += total_magnitude(gap)
            for j in range(3):
                call.problem.residual[t, wp.static(MOMENT_ROW) + j] = gap[j]
        if wp.static(MOMENT and not MEASURED):
            gap = lacking(call, case, y)
            unit = moment_unit(case, ends)
            if wp.static(FIXED):
                for j in range(3):
                    call.problem.residual[t, moment_row(case, j)] = unit[j] * gap[j]
            else:
                if wp.static(SHARED):
                    gap[2] = torque(ends, y, 0) - follower_torque(call, case, 0)
                for j in range(3):
                    call.problem.residual[t, wp.static(MOMENT_ROW) + j] = unit[j] * gap[j]
            total += total_magnitude(gap)
        for i in range(wp.static(FIRST_LACK), rods.end.shape[1]):
            if wp.static(TORQUES > 0 and not MEASURED):
                if wp.static(not FIXED or not CONCENTRIC) or i != case.longest:
                    lack = torque(ends, y, i)
                    if wp.static(not FIXED):
                        lack -= follower_torque(call, case, i)
                    call.problem.residual[t, wp.static(TORQUE_ROW - FIRST) + i] = ends.twist[i] * lack
                    total += wp.abs(lack)
        if wp.static(FREE_FORCE):
            pull = force_gap(call, case, ends, y, n_tip)
            total += total_magnitude(pull)
            for j in range(3):
                call.problem.residual[t, wp.static(FORCE_ROW) + j] = pull[j]
        return total

    @wp.func
    def write_free_column(
        rods: wp.ref[RodTable],
        call: wp.ref[Call],
        case: wp.ref[Instance],
        ends: wp.ref[Ends],
        y: State,
        v: Column,
        n_tip: wp.vec3d,
        dn: wp.vec3d,
        k: int,
    ) -> f64:
        """(11) to (13): column k of Gamma, or of the residual's derivatives by directions."""
        total = f64(0.0)
        direction = k - call.unknown_columns
        if wp.static(MEASURED):
            gap = measured_gap_column(call, case, ends, y, v, direction)
            total += total_magnitude(gap)
            for j in range(3):
                write_entry(call, case, wp.static(MOMENT_ROW) + j, k, gap[j])
        if wp.static(MOMENT and not MEASURED):
            gap = lacking_column(call, case, y, v, direction)
            unit = moment_unit(case, ends)
            if wp.static(FIXED):
                for j in range(3):
                    write_entry(call, case, moment_row(case, j), k, unit[j] * gap[j])
            else:
                if wp.static(SHARED):
                    gap[2] = torque_column(ends, y, v, 0) - follower_torque_rate(call, case, 0, direction)
                for j in range(3):
                    write_entry(call, case, wp.static(MOMENT_ROW) + j, k, unit[j] * gap[j])
            total += total_magnitude(gap)
        for i in range(wp.static(FIRST_LACK), rods.end.shape[1]):
            if wp.static(TORQUES > 0 and not MEASURED):
                if wp.static(not FIXED or not CONCENTRIC) or i != case.longest:
                    lack = torque_column(ends, y, v, i)
                    if wp.static(not FIXED):
                        lack -= follower_torque_rate(call, case, i, direction)
                    write_entry(call, case, wp.static(TORQUE_ROW - FIRST) + i, k, ends.twist[i] * lack)
                    total += wp.abs(lack)
        if wp.static(FREE_FORCE):
            pull = force_gap_column(call, case, ends, y, v, n_tip, dn, direction)
            total += total_magnitude(pull)
            for j in range(3):
                write_entry(call, case, wp.static(FORCE_ROW) + j, k, pull[j])
        return total

    @wp.func
    def free_row(case: wp.ref[Instance], i: int) -> int:
        """Residual of the torque of rod i, which is not the one that is held."""
        row = wp.static(TORQUE_ROW) + i
        if i > case.longest:
            row -= 1
        return row

    @wp.func(inline=False)
    def write_held(
        rods: wp.ref[RodTable],
        call: wp.ref[Call],
        case: wp.ref[Instance],
        ends: wp.ref[Ends],
        y: State,
        n_tip: wp.vec3d,
        u_star: wp.vec3d,
    ) -> f64:
        """(22): the wrench of a held tip, and the torques of the rods that end before it."""
        t = case.index
        m = moment_of(y)
        if wp.static(not FIXED):
            m = rotate(frame(y), m)
        force = case.base_rotation * n_tip
        moment = case.base_rotation * m
        for j in range(3):
            call.wrench.values[t, j] = force[j]
            call.wrench.values[t, 3 + j] = moment[j]
        for i in range(rods.end.shape[1]):
            if wp.static(TUBES):
                if i != case.longest:
                    call.problem.residual[t, free_row(case, i)] = ends.twist[i] * torque(ends, y, i)
        return total_magnitude(force) + total_magnitude(moment)

    @wp.func
    def write_held_column(
        rods: wp.ref[RodTable],
        call: wp.ref[Call],
        case: wp.ref[Instance],
        ends: wp.ref[Ends],
        y: State,
        v: Column,
        n_tip: wp.vec3d,
        dn: wp.vec3d,
        k: int,
    ) -> f64:
        """(22): its column k."""
        t = case.index
        q = frame(y)
        dm = moment_column_of(v)
        if wp.static(not FIXED):
            dm = rotate(q, dm + wp.cross(body_rotation(q, frame_column(v)), moment_of(y)))
        dm = case.base_rotation * dm
        force = case.base_rotation * dn
        for j in range(3):
            call.wrench.columns[t, j, k] = force[j]
            call.wrench.columns[t, 3 + j, k] = dm[j]
        for i in range(rods.end.shape[1]):
            if wp.static(TUBES):
                if i != case.longest:
                    value = ends.twist[i] * torque_column(ends, y, v, i)
                    write_entry(call, case, free_row(case, i), k, value)
        return total_magnitude(dm)

    write_tip, write_tip_column = (write_held, write_held_column) if HELD else (write_free, write_free_column)
    return SimpleNamespace(
        **(vars(pose) | {"find_ends": find_ends, "write_tip": write_tip, "write_tip_column": write_tip_column})
    )
