"""What the kernels of a platform read and write, made for a problem."""

from typing import TYPE_CHECKING

import numpy as np
import warp as wp
from numpy.typing import ArrayLike

from multirod.kernels.warp_types import Array, Struct
from multirod.models.platform import platform_kernels as kernels
from multirod.validation import FloatArray

if TYPE_CHECKING:
    from multirod.models.platform.problem import ParallelProblem


def batched(problem: "ParallelProblem", values: FloatArray, tail: tuple[int, ...]) -> FloatArray:
    """Rows for all instances, or one where none varies."""
    shape = problem.batch_shape if problem.geometry.batch_shape else ()
    return np.broadcast_to(values, (*shape, *tail)).reshape(-1, *tail)


def robots_of(problem: "ParallelProblem") -> Struct:
    """Its ``platform_kernels.Robots``."""
    geometry, device, count = problem.geometry, problem.device, problem.instance_count
    legs = len(geometry.legs)
    robots: Struct = kernels.Robots()
    robots.leg_count = legs
    robots.rod_count = len(geometry.rods)
    robots.unknown_count = problem.unknown_count
    robots.direction_count = problem.direction_count
    robots.leg_direction_count = problem.leg_direction_count
    robots.inverse = int(problem.inverse)
    problem.share(robots.problem)

    def array(values: ArrayLike, dtype: type = wp.float64) -> Array:
        kind = np.int32 if dtype is wp.int32 else np.float64
        return wp.array(np.ascontiguousarray(values, dtype=kind), dtype=dtype, device=device)

    platform = batched(problem, geometry.platform, (legs, 4, 4))
    robots.stride = int(bool(geometry.batch_shape))
    robots.reference_position = array(problem.reference[0], wp.vec3d)
    robots.reference_rotation = array(problem.reference[1], wp.mat33d)
    robots.attachment_position = array(platform[:, :, :3, 3], wp.vec3d)
    robots.attachment_rotation = array(platform[:, :, :3, :3], wp.mat33d)
    robots.joint = array(geometry.joints, wp.int32)
    robots.axis = array(geometry.axes, wp.vec3d)
    robots.length, robots.stiffness = array(problem.length), array(problem.stiffness)
    robots.mass = geometry.mass
    robots.mass_centre = wp.vec3d(*geometry.mass_centre)
    robots.pose = problem.input_slice("platform_position").start if problem.inverse else 0
    robots.loads = problem.input_slice(kernels.PLATFORM_VECTORS[0]).start
    robots.leg_vectors = problem.input_slice(kernels.LEG_VECTORS[0]).start
    robots.opening = wp.zeros((count, problem.unknown_count), dtype=wp.float64, device=device)
    robots.soft = wp.zeros(count, dtype=wp.float64, device=device)
    robots.loading = wp.zeros(count, dtype=wp.int32, device=device)
    size = kernels.DIRECTIONS_AT + 6 * problem.leg_direction_count
    robots.law = wp.zeros((count * legs, size), dtype=wp.float64, device=device)
    robots.leg_fault = wp.zeros(count * legs, dtype=wp.int32, device=device)
    robots.leg_step_count = wp.zeros(count * legs, dtype=wp.int32, device=device)
    return robots
