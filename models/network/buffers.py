"""What the kernels of a network read and write, made for a problem. Numbers in parentheses are those of ``docs/networks.md``."""

from typing import TYPE_CHECKING

import numpy as np
import warp as wp
from numpy.typing import ArrayLike

from multirod.kernels.warp_types import Array, Struct
from multirod.models.network.elements import records
from multirod.models.network.elements.elements import POSE
from multirod.models.network.elements.groups import ALONG, ON_RODS
from multirod.models.network.joining.sliding import push_units
from multirod.models.network.places import FIXED, FOLLOWING, LOADED, PER_ROD
from multirod.models.network.poses import ground_of
from multirod.problem.buffers import BUFFERS

if TYPE_CHECKING:
    from multirod.models.network.problem import NetworkProblem


def networks_of(problem: "NetworkProblem") -> Struct:
    """Its ``records.Networks``."""
    graph, entries, layout, device, count = problem.graph, problem.entries, problem.layout, problem.device, problem.instance_count
    rods, bodies, d = problem.rod_count, problem.body_count, problem.direction_count
    own: Struct = records.Networks()
    own.rod_count, own.body_count, own.unknown_count, own.direction_count = rods, bodies, problem.unknown_count, d
    own.first_pose, own.own, own.size, own.holes = problem.first_pose, layout.own, layout.size, int(layout.holes)
    own.width = layout.size + d + layout.holes
    own.height = layout.size + records.MORE + max(map(len, graph.drives)) + max(rod.rod_count for rod in graph.rods) - 1
    own.given_bodies = given = len(graph.bodies)
    own.effector = problem.end_effector + 1 if problem.effector_rod is None else 0
    own.effector_rod = -1 if problem.effector_rod is None else problem.effector_rod
    frame = problem.effector_frame
    own.effector_position, own.effector_rotation = wp.vec3d(*frame[:3, 3]), wp.mat33d(*frame[:3, :3].reshape(-1))
    problem.share(own.problem, [name for name in BUFFERS if name != "gamma"])
    own.numbers = problem._field("gamma", (entries.count,))
    own.rotation_at, own.translation_at = (problem.input_slice(name).start for name in PER_ROD)
    own.force_at, own.moment_at = (problem.input_slice(name).start for name in LOADED)
    own.follower_force_at, own.follower_moment_at = (problem.input_slice(name).start for name in FOLLOWING)
    own.along_at = problem.input_slice(ALONG[0]).start
    own.fixed_at, own.fixed_count = problem.input_slice(FIXED[0]).start if graph.fixed else 0, len(graph.fixed)
    own.rod_at, own.rods_given = problem.input_slice(next(iter(ON_RODS))).start, len(graph.whole)

    def array(values: ArrayLike, dtype: type = wp.float64) -> Array:
        kind = np.int32 if dtype is wp.int32 else np.float64
        return wp.array(np.ascontiguousarray(values, dtype=kind), dtype=dtype, device=device)

    def zeros(*shape: int, dtype: type = wp.float64) -> Array:
        return wp.zeros(shape, dtype=dtype, device=device)

    tables = [end.table for end in graph.ends]
    own.holder = array([end.frame for end in graph.ends], wp.int32)
    own.frame = array([end.stand for end in graph.ends], wp.int32)
    own.moved = array(np.full(max(d, 1), -1), wp.int32)
    own.attachment_position = array(np.stack([at[0] for at in problem.attachments], axis=1), wp.vec3d)
    own.attachment_rotation = array(np.stack([at[1] for at in problem.attachments], axis=1), wp.mat33d)
    own.count = array([table.count for table in tables], wp.int32)
    own.inner, own.outer = (array([getattr(table, name) for table in tables], wp.mat33d) for name in ("inner", "outer"))
    own.spring, own.rest = (array([getattr(table, name) for table in tables], wp.vec3d) for name in ("stiffness", "rest"))
    own.slide = array([table.slide for table in tables], wp.mat33d)
    first = problem.driven_place.start
    own.driven = array([np.where(at < 0, -1, first + at) for at in graph.driven_at], wp.int32)
    first = problem.pushed_place.start
    own.pushed = array([np.where(at < 0, -1, first + at) for at in graph.pushed_at], wp.int32)
    own.unit = array([table.unit for table in tables], wp.vec3d)
    own.variable = array(entries.variables, wp.int32)
    places = np.full(rods, -1)
    places[graph.free] = given + np.arange(len(graph.free))
    own.load_place = array(places, wp.int32)
    own.frame_count, own.first_frame, poses = len(graph.framed), given + len(graph.free), graph.frame_poses
    own.frame_body = array(graph.framed, wp.int32)
    own.frame_position, own.frame_rotation = array(poses[:, :3, 3], wp.vec3d), array(poses[:, :3, :3], wp.mat33d)
    own.length, own.stiffness = array(problem.length), array(problem.stiffness)
    slides = graph.slides
    own.owner, own.pieces = array(graph.first_tube[slides.owner], wp.int32), array(slides.pieces, wp.int32)
    own.whole = array(slides.owner, wp.int32)
    own.share, own.shared = array(slides.share), array(slides.shared, wp.int32)
    sections = [arrays.repeated(problem.batch_shape) for arrays in graph.arrays]
    own.hole_spring, own.hole_rest = (array(values) for values in slides.springs)
    own.below, own.push_unit = array(slides.below), array(push_units(problem))
    own.softness = array(np.stack([a.material[:, 0, 0, 3:9] for a in sections], axis=1))
    own.at_rest = array(np.stack([a.precurvature[:, 0, 0, :3] for a in sections], axis=1), wp.vec3d)
    own.reference_position, own.reference_rotation = (
        array(values, dtype) for values, dtype in zip(problem.reference, (wp.vec3d, wp.mat33d), strict=True)
    )
    own.mass, own.mass_centre = array(graph.mass), array(graph.mass_centre, wp.vec3d)
    own.ground_rotation = array(ground_of(problem)[1], wp.mat33d)
    own.fixed_position, own.fixed_rotation = array(problem.fixed[0], wp.vec3d), array(problem.fixed[1], wp.mat33d)
    own.pulled_out = wp.zeros(count, dtype=wp.int32, device=device)
    own.opening, own.soft = zeros(count, problem.unknown_count), zeros(count)
    own.shift, own.loading = zeros(count, rods, dtype=wp.vec3d), zeros(count, dtype=wp.int32)
    frames = bodies + 1 + len(graph.fixed)
    still = np.broadcast_to(np.eye(3), (count, frames, 3, 3))
    own.body_position, own.body_rotation = zeros(count, frames, dtype=wp.vec3d), array(still, wp.mat33d)
    own.body_turns = zeros(count, frames, dtype=wp.mat33d)
    own.load, own.load_turns = zeros(count, POSE * bodies), zeros(count, bodies, POSE, 3)
    own.load_directions = zeros(count, POSE * bodies, d)
    own.value = zeros(count, rods, layout.size + records.MORE_VALUES)
    own.element = zeros(count, rods, own.height, own.width)
    own.tip_position, own.tip_rotation = zeros(count, rods, dtype=wp.vec3d), zeros(count, rods, dtype=wp.mat33d)
    own.rod_fault, own.rod_steps = zeros(count, rods, dtype=wp.int32), zeros(count, rods, dtype=wp.int32)
    rows, numbers = entries.rows, entries.numbers
    own.row_start = array(rows.starts, wp.int32)
    own.row_rod, own.row_row = (array(values, wp.int32) for values in np.divmod(rows.order, layout.size))
    own.number_place, own.number_start = array(numbers.places, wp.int32), array(numbers.starts, wp.int32)
    of_rod, within = np.divmod(numbers.order, layout.size**2)
    row, column = np.divmod(within, layout.size)
    own.number_at = array((of_rod * own.height + row) * own.width + column, wp.int32)
    own.turn_place = array(entries.turns, wp.int32)
    return own
