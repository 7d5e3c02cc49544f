# mypy: ignore-errors
"""What the residuals of one backbone do work on, after an integration. Numbers are those of ``docs/energy_descent.md``."""

import warp as wp

from multirod.kernels.own_module import own_module
from multirod.models.backbone.kernels.tips import longest_of, reaches
from multirod.models.rotation_kernels import rotation_from_vector

f64 = wp.float64
POSE = 6


@wp.struct
class Pairs:
    """Residuals of a backbone and their displacements; the first axis is the instance."""

    # of the problem
    active: wp.array[int]
    inputs: wp.array2d[wp.float64]
    rotation: wp.array[wp.mat33d]
    columns_at: wp.array3d[wp.float64]  # pose of the tip, then how each rod turns against the frame; by unknowns and directions
    end: wp.array3d[wp.float64]
    stride: int
    base_axes: wp.array[wp.mat33d]  # (instance or 1)
    base_stride: int
    # of the scene; -1 where there is none
    rods: int
    first: int  # the first rod that turns against the frame
    moment: int
    torques: int
    torque_count: int
    force: int
    fixed: int  # whether the moment stands along axes of the base, or in the frame of the tip
    bending: wp.array2d[wp.float64]  # (instance or 1, rod): EI at its end; of several rods
    torsion: wp.array2d[wp.float64]  # (instance or 1, rod)
    # outputs, a row for each pair in the order of the residual
    unit: wp.array2d[wp.float64]
    columns: wp.array3d[wp.float64]


@wp.func
def angle_of(columns: wp.array3d[wp.float64], t: int, first: int, i: int, k: int) -> f64:
    """How rod i turns against the frame."""
    if i < first:
        return f64(0.0)
    return columns[t, POSE + i - first, k]


@own_module()
def find_displacements(pairs: Pairs):
    """(7) to (9)"""
    t = wp.tid()
    if pairs.active[t] == 0:
        return
    row = t * pairs.stride
    rods = pairs.rods
    longest = longest_of(pairs.end, row, pairs.inputs, t)
    concentric = pairs.first == 1
    shared = concentric and pairs.torque_count > 0
    to_axes = wp.transpose(pairs.rotation[t])
    if concentric and longest > 0:  # the frame is that of rod 1
        theta = pairs.columns_at[t, POSE + longest - pairs.first, pairs.columns_at.shape[2] - 1]
        to_axes = rotation_from_vector(wp.vec3d(f64(0.0), f64(0.0), theta)) * to_axes
    to_frame = to_axes
    if pairs.fixed != 0:
        base_turn = rotation_from_vector(wp.vec3d(f64(0.0), f64(0.0), wp.where(concentric, pairs.inputs[t, 0], f64(0.0))))
        to_axes = wp.transpose(pairs.base_axes[t * pairs.base_stride] * base_turn)
    if rods > 1 and pairs.moment >= 0:
        pairs.unit[t, pairs.moment] = pairs.bending[row, 0]
        pairs.unit[t, pairs.moment + 1] = pairs.bending[row, 0]
        pairs.unit[t, pairs.moment + 2] = pairs.torsion[row, wp.where(pairs.fixed != 0, longest, 0)]
    if shared and pairs.fixed != 0 and longest > 0:
        pairs.unit[t, pairs.moment + 2] = pairs.torsion[row, 0]
    for i in range(pairs.torque_count):
        pairs.unit[t, pairs.torques + i] = pairs.torsion[row, i + pairs.first]

    for k in range(pairs.columns.shape[2]):
        turn_w = wp.vec3d(pairs.columns_at[t, 3, k], pairs.columns_at[t, 4, k], pairs.columns_at[t, 5, k])
        turn = to_axes * turn_w
        of_longest = f64(0.0)
        if concentric:
            of_longest = angle_of(pairs.columns_at, t, pairs.first, longest, k)
        if pairs.fixed == 0:  # (8) that of the frame, the torque of rod 1 at its end being what others leave of the moment
            turn[2] = turn[2] - of_longest
        if pairs.moment >= 0:
            for j in range(3):
                pairs.columns[t, pairs.moment + j, k] = turn[j]
        for i in range(pairs.torque_count):
            rod = i + pairs.first
            angle = angle_of(pairs.columns_at, t, pairs.first, rod, k)
            if concentric and pairs.moment >= 0 and reaches(pairs.end, row, pairs.inputs, t, rod, 0):
                if pairs.fixed == 0:
                    angle += turn[2]
                else:  # (9) against the rod that ends at the tip
                    angle -= of_longest
            pairs.columns[t, pairs.torques + i, k] = angle
        if shared and pairs.fixed != 0 and longest > 0:  # the moment's last row is that of this rod, rod 1 has its own
            pairs.columns[t, pairs.moment + 2, k] = -of_longest
            pairs.columns[t, pairs.torques + longest - pairs.first, k] = turn[2]
        if pairs.force >= 0:
            move = to_frame * wp.vec3d(pairs.columns_at[t, 0, k], pairs.columns_at[t, 1, k], pairs.columns_at[t, 2, k])
            for j in range(3):
                pairs.columns[t, pairs.force + j, k] = move[j]
