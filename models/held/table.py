"""What kernels read of a held rod."""

from typing import TYPE_CHECKING

import numpy as np
import warp as wp
from numpy.typing import ArrayLike, NDArray

from multirod.batch import IntArray
from multirod.kernels.warp_types import Array, Struct
from multirod.models.backbone.units import unit_stiffness
from multirod.models.held.holders import POSE_INPUTS, TIP_LOADS
from multirod.models.held.kernels.arguments import ALONG, BALL_AND_CLAMP, IN_BALLS, ON_AXIS, ROUND_IN_BALLS, Held
from multirod.models.joint_kernels import CLAMPED, REVOLUTE, SPHERICAL
from multirod.rotations import cross

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
    held.pose = problem.input_slice(POSE_INPUTS[0]).start

    def array(values: ArrayLike, dtype: type) -> Array:
        kind = np.int32 if dtype is wp.int32 else np.float64
        return wp.array(np.ascontiguousarray(values, dtype=kind), dtype=dtype, device=device)

    held.base_frame = array(problem.base_frame, wp.mat33d)
    held.end_position, held.end_frame = array(problem.end_position, wp.vec3d), array(problem.end_frame, wp.mat33d)
    held.rest_position, held.rest_turn = array(problem.end_position, wp.vec3d), wp.zeros(count, dtype=wp.vec3d, device=device)
    held.length, held.stiffness = array(problem.length, wp.float64), array(problem.stiffness, wp.float64)
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
    held.balls = array(_balls(problem), wp.int32)
    held.base_position, held.base_rotation = rod.table.base_position, rod.table.base_rotation
    return held


def alike(problem: "HeldProblem") -> NDArray[np.bool_]:
    """(10) Whether nothing of the rod tells directions across its axis apart, shape (instance_count,)."""
    return _alike(problem) if not problem.turns else np.zeros(problem.instance_count, dtype=bool)


def _alike(problem: "HeldProblem") -> NDArray[np.bool_]:
    """The same whatever holds its base."""
    arrays, features = problem.rod.arrays, problem.rod.features
    material = arrays.material[:, 0]
    told = problem.holders.joint == REVOLUTE or features.members
    if told or features.distributed_force or features.distributed_moment or features.profile_degree >= 0:
        return np.zeros(problem.instance_count, dtype=bool)
    if problem.holders.slide is not None and abs(problem.holders.slide[2]) < 1 - ON_AXIS:
        return np.zeros(problem.instance_count, dtype=bool)
    same = (material[..., 0] == material[..., 1]).all(axis=1) & (material[..., 6] == material[..., 7]).all(axis=1)
    for load in features.loads:
        same = same & load.same_across(problem.rod.sizes)
    return np.asarray((problem.rod.each(same) == 1) & straight_at_rest(problem))


def _balls(problem: "HeldProblem") -> NDArray[np.intp]:
    """(24) Which turns of a rod with its base in a ball cost nothing where no load acts, shape (instance_count,)."""
    holders, features = problem.holders, problem.rod.features
    told = holders.base_joint != SPHERICAL or holders.joint == REVOLUTE or features.loads or features.profile_degree >= 0
    if told or holders.joint not in (SPHERICAL, CLAMPED):
        return np.zeros(problem.instance_count, dtype=np.intp)
    if holders.joint == SPHERICAL:
        return np.where(_alike(problem), ROUND_IN_BALLS, IN_BALLS)
    return np.where(_alike(problem), BALL_AND_CLAMP, 0)


def free_in_balls(problem: "HeldProblem") -> IntArray:
    """(24) Which turns of a rod with its base in a ball cost nothing, as ``kernels.arguments`` numbers them, 0 where none does,
    shape (instance_count,)."""
    kinds = problem.table.balls.numpy()
    if not kinds.any():
        return np.asarray(kinds)
    inputs = problem.read("inputs")
    moment, along = problem.input_slice("tip_moment"), slice(problem.table.along, problem.table.along + 3 * len(ALONG))
    acting = inputs[:, moment].any(axis=1) | inputs[:, along].any(axis=1)
    away, frame = problem.goal()
    away = away - problem.rod.table.base_position.numpy()
    axis = problem.base_frame[:, :, 2]
    off = [np.linalg.norm(cross(axis, own), axis=1) for own in (away / problem.length[:, None], frame[:, :, 2])]
    aside = (kinds == BALL_AND_CLAMP) & (np.max(off, axis=0) >= ON_AXIS)
    return np.asarray(np.where(acting | aside, 0, kinds))


def straight_at_rest(problem: "HeldProblem") -> NDArray[np.bool_]:
    """Whether no part of the rod is bent at rest, shape (instance_count,)."""
    curvature = problem.rod.arrays.precurvature
    bent = np.abs(curvature.reshape(*curvature.shape[:3], -1, 3)[..., :2]).max(axis=(1, 2, 3, 4))
    return np.asarray(problem.rod.each(bent) == 0)
