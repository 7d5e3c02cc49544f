# mypy: ignore-errors
"""What the state of a backbone and a column of it say at one place: frame, moment and position, and the pose of the tip.

``y`` is the state and ``v`` a column of it, in SI units, one lane at a time. Numbers in parentheses are those of
``docs/model.md``.
"""

from types import SimpleNamespace

import warp as wp

from multirod.models.backbone.kernels.layout.arguments import Call, Instance
from multirod.models.backbone.kernels.layout.layout import Layout
from multirod.models.backbone.kernels.numbers.scalars import (
    axes_rotation,
    body_rotation,
    rotate,
    rotate_inverse,
    rotation_matrix,
    turned_about_z,
)

f64 = wp.float64
POSE_ROWS = 6  # of the pose's columns, before those of the angles


def make_tip_pose(layout: Layout, base: SimpleNamespace) -> SimpleNamespace:
    """Functions that read a state at one place, and write the pose of the tip."""
    n, features, State, Column = layout.n, layout.features, base.State, base.Column
    s_, c_ = layout.state, layout.column
    M_AT = s_["moment"]  # a column's stands alike
    THETA_AT, Q_AT, P_AT, ENERGY_AT, WORK_AT = s_["angles"], s_["frame"], s_["position"], s_["energy"], s_["work"]
    DQ_AT, DP_AT, FRAME, COLUMN_FRAME = c_["frame"], c_["position"], layout.FRAME, layout.COLUMN_FRAME
    POSE, POSE_COLUMNS, TUBES, FIXED = layout.POSE, features.pose_sensitivities, layout.TUBES, layout.FIXED
    MOMENT, NODES, CONCENTRIC = layout.MOMENT, layout.NODES, not layout.ECCENTRIC

    @wp.func
    def frame(y: State) -> wp.vec4d:
        """q; where nothing depends on the frame, that of no rotation."""
        if wp.static(FRAME):
            return wp.vec4d(y[Q_AT], y[Q_AT + 1], y[Q_AT + 2], y[Q_AT + 3])
        return wp.vec4d(f64(0.0), f64(0.0), f64(0.0), f64(1.0))

    @wp.func
    def frame_column(v: Column) -> wp.vec4d:
        """dq"""
        if wp.static(COLUMN_FRAME):
            return wp.vec4d(v[DQ_AT], v[DQ_AT + 1], v[DQ_AT + 2], v[DQ_AT + 3])
        return wp.vec4d(f64(0.0), f64(0.0), f64(0.0), f64(0.0))

    @wp.func
    def moment_of(y: State) -> wp.vec3d:
        """The moment as the state carries it."""
        if wp.static(MOMENT):
            return wp.vec3d(y[M_AT], y[M_AT + 1], y[M_AT + 2])
        return wp.vec3d(f64(0.0), f64(0.0), f64(0.0))

    @wp.func
    def moment_column_of(v: Column) -> wp.vec3d:
        if wp.static(MOMENT):
            return wp.vec3d(v[M_AT], v[M_AT + 1], v[M_AT + 2])
        return wp.vec3d(f64(0.0), f64(0.0), f64(0.0))

    @wp.func
    def body_moment(y: State) -> wp.vec3d:
        """M"""
        if wp.static(FIXED):  # (4b)
            return rotate_inverse(frame(y), moment_of(y))
        return moment_of(y)

    @wp.func
    def body_moment_column(y: State, v: Column) -> wp.vec3d:
        """dM"""
        if wp.static(FIXED):  # (18b)
            q = frame(y)
            return rotate_inverse(q, moment_column_of(v) + wp.cross(moment_of(y), axes_rotation(q, frame_column(v))))
        return moment_column_of(v)

    @wp.func
    def tip_angle(case: wp.ref[Instance], y: State) -> f64:
        """Angle of the rod that ends at the tip, from rod 1; of rods side by side it is the frame that ends there."""
        angle = f64(0.0)
        count = int(wp.static(n if CONCENTRIC else 0))
        for i in range(1, count):
            if i == case.longest:
                angle = y[wp.static(THETA_AT) + i - 1]
        return angle

    @wp.func
    def tip_angle_column(case: wp.ref[Instance], v: Column) -> f64:
        """Its variation."""
        angle = f64(0.0)
        count = int(wp.static(n if CONCENTRIC else 0))
        for i in range(1, count):
            if i == case.longest:
                angle = v[wp.static(THETA_AT) + i - 1]
        return angle

    @wp.func
    def world_position(case: wp.ref[Instance], y: State) -> wp.vec3d:
        """p, in the world."""
        return case.base_position + case.base_rotation * wp.vec3d(y[P_AT], y[P_AT + 1], y[P_AT + 2])

    @wp.func
    def turn_column(case: wp.ref[Instance], q: wp.vec4d, dq: wp.vec4d, angle: f64) -> wp.vec3d:
        """Rotation vector in the world by which the rod that ends at the tip turns, whose ``angle`` varies by that."""
        return case.base_rotation * rotate(q, body_rotation(q, dq) + wp.vec3d(f64(0.0), f64(0.0), angle))

    @wp.func(inline=False)
    def write_pose(call: wp.ref[Call], case: wp.ref[Instance], y: State):
        """Pose of the tip in the world, and the energy."""
        t = case.index
        if wp.static(POSE):
            call.problem.position[t] = world_position(case, y)
            call.problem.rotation[t] = case.base_rotation * rotation_matrix(frame(y)) * turned_about_z(tip_angle(case, y))
        if wp.static(NODES):
            if call.node_count > 0:
                call.energy[t] = y[ENERGY_AT]
                call.work[t] = y[WORK_AT]

    @wp.func(inline=False)
    def write_pose_column(call: wp.ref[Call], case: wp.ref[Instance], y: State, v: Column, k: int):
        """Column k of the pose, in the world."""
        t = case.index
        if wp.static(POSE_COLUMNS):
            dp = case.base_rotation * wp.vec3d(v[DP_AT], v[DP_AT + 1], v[DP_AT + 2])
            turn = turn_column(case, frame(y), frame_column(v), tip_angle_column(case, v))
            for j in range(3):
                call.problem.pose_columns[t, j, k] = dp[j]
                call.problem.pose_columns[t, 3 + j, k] = turn[j]

    @wp.func(inline=False)
    def write_pose_and_angles(call: wp.ref[Call], case: wp.ref[Instance], y: State, v: Column, k: int):
        """The same, and where there is room below it how each rod turns against the frame; last, beside the columns, by how
        much it is turned.
        """
        write_pose_column(call, case, y, v, k)
        if call.problem.pose_columns.shape[1] > POSE_ROWS:
            last = call.problem.pose_columns.shape[2] - 1
            count = int(wp.static(features.turning_count))
            for i in range(count):
                call.problem.pose_columns[case.index, POSE_ROWS + i, k] = v[wp.static(THETA_AT) + i]
                call.problem.pose_columns[case.index, POSE_ROWS + i, last] = y[wp.static(THETA_AT) + i]

    return SimpleNamespace(
        frame=frame,
        frame_column=frame_column,
        moment_of=moment_of,
        moment_column_of=moment_column_of,
        body_moment=body_moment,
        body_moment_column=body_moment_column,
        tip_angle=tip_angle,
        tip_angle_column=tip_angle_column,
        world_position=world_position,
        turn_column=turn_column,
        write_pose=write_pose,
        write_pose_column=write_pose_and_angles if TUBES and POSE_COLUMNS else write_pose_column,
    )
