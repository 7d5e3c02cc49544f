"""What kernels read of a held rod."""

from typing import TYPE_CHECKING

import numpy as np
import warp as wp
from numpy.typing import ArrayLike

from multirod.kernels.warp_types import Array, Struct
from multirod.models.backbone.units import unit_stiffness
from multirod.models.held.costless import in_balls, least_bending_stiffness, least_loads
from multirod.models.held.holders import POSE_INPUTS, TIP_LOADS
from multirod.models.held.kernels.arguments import ALONG, Held

if TYPE_CHECKING:
    from multirod.models.held.problem import HeldProblem


def make_table(problem: "HeldProblem", pieces: int) -> Struct:
    """The argument of the kernels, on the buffers of a problem whose rod is in so many pieces."""
    holders, rod, count, device = problem.holders, problem.rod, problem.instance_count, problem.device
    held: Struct = Held()
    problem.share(held.problem)
    rod.share(held.rod)
    held.wrench.values, held.wrench.columns = rod.tip_wrench, rod.wrench_columns
    held.unknown_count, held.rod_unknowns, held.turns = problem.unknown_count, rod.unknown_count, problem.turns
    held.direction_count = problem.direction_count
    held.rod_inputs = rod.input_count - 1
    held.along = rod.input_slice(ALONG[0]).start
    held.tip_loads = rod.input_slice(TIP_LOADS[0]).start
    held.pose, held.translation = (problem.input_slice(name).start for name in (POSE_INPUTS[0], "translation"))

    def array(values: ArrayLike, dtype: type) -> Array:
        kind = np.int32 if dtype is wp.int32 else np.float64
        return wp.array(np.ascontiguousarray(values, dtype=kind), dtype=dtype, device=device)

    held.base_frame = array(problem.base_frame, wp.mat33d)
    held.end_position, held.end_frame = array(problem.end_position, wp.vec3d), array(problem.end_frame, wp.mat33d)
    held.rest_position, held.rest_turn = array(problem.end_position, wp.vec3d), wp.zeros(count, dtype=wp.vec3d, device=device)
    held.swing = wp.zeros(count, dtype=wp.vec3d, device=device)
    held.length, held.stiffness = array(problem.length, wp.float64), array(problem.stiffness, wp.float64)
    held.soft = array(least_bending_stiffness(problem), wp.float64)
    held.moment_unit = array(1 / unit_stiffness(rod.each(rod.arrays.material[:, 0, 0])), wp.vec3d)
    held.base_curvature = array(rod.each(rod.arrays.precurvature[:, 0, 0, :3]), wp.vec3d)
    held.joint, held.axis = holders.joint, wp.vec3d(*holders.axis)
    held.slides, held.guide = int(holders.slide is not None), wp.mat33d(*holders.guide.ravel())
    held.base_axes = array(holders.base_axes.reshape(-1, 3), wp.vec3d)
    held.opening = wp.zeros((count, problem.unknown_count), dtype=wp.float64, device=device)
    held.direct = wp.zeros(count, dtype=wp.int32, device=device)
    held.alike = array(problem.alike, wp.int32)
    held.neutral = wp.zeros(count, dtype=wp.int32, device=device)
    held.clamped = int(pieces > 1)
    held.balls = array(in_balls(problem), wp.int32)
    held.least = array(least_loads(problem), wp.float64)
    held.leading = wp.zeros(count, dtype=wp.float64, device=device)
    held.drawn = wp.zeros(count, dtype=wp.vec3d, device=device)
    held.beside = wp.zeros(count, dtype=wp.int32, device=device)
    held.ways = wp.zeros((count, 2), dtype=wp.vec3d, device=device)
    held.held_at = wp.zeros((count, 2), dtype=wp.float64, device=device)
    held.base_position, held.base_rotation = rod.table.base_position, rod.table.base_rotation
    return held
