# mypy: ignore-errors
"""The arrays of a boundary problem, as kernels take them."""

import warp as wp


@wp.struct
class ProblemArrays:
    """``multirod.problem.Buffers``: what a solver sees of a problem, and of each problem within; the first axis is the instance.

    ``Buffers.share`` fills it. What stands here is declared nowhere else.
    """

    order: wp.array[int]  # instances that a launch passes over
    active: wp.array[int]  # instances with 0 are left untouched
    load_factor: wp.array[wp.float64]  # multiplies every load
    unknowns: wp.array2d[wp.float64]  # (instance, unknown) [1/m]
    inputs: wp.array2d[wp.float64]
    directions: wp.array3d[wp.float64]  # (instance or 1, direction, input)
    # outputs
    fault: wp.array[int]
    step_count: wp.array[int]
    residual: wp.array2d[wp.float64]  # (instance, unknown) [1/m]
    gamma: wp.array3d[wp.float64]  # (instance, unknown, unknown)
    residual_directions: wp.array3d[wp.float64]  # (instance, unknown, direction)
    position: wp.array[wp.vec3d]
    rotation: wp.array[wp.mat33d]
    pose_columns: wp.array3d[wp.float64]  # (instance, 6, unknown + direction), world frame
