"""Segments of a backbone of one rod: the launches of its segment kernels, and its states' variations."""

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
import warp as wp

from multirod.launch import record
from multirod.models.backbone.kernels.layout.features import Features
from multirod.models.backbone.kernels.layout.layout import unknowns_of
from multirod.models.backbone.kernels.segments import (
    BASE_FORCE_AT,
    POSITION_AT,
    ROTATION_AT,
    STATE_SIZE,
    SegmentCall,
    make_segment_kernel,
)
from multirod.models.backbone.passes import deal, threads, width
from multirod.models.backbone.second_variation import MOST_NODES, CondensedForm, form_by_segments, segments_needed
from multirod.models.backbone.units import unit_stiffness
from multirod.problem import Shape
from multirod.segments import Breakpoints, Propagation, Request, Segments
from multirod.stability import Modes
from multirod.validation import FloatArray

if TYPE_CHECKING:
    from scipy.spatial.transform import Rotation

    from multirod.models.backbone.problem import BackboneProblem

LOOKED_AT = 33  # nodes at which moments and forces are bounded
TOTALS = ("total_moment", "total_force")  # where members carry a part
NODE_FIELDS = ("arclength", "position", "rotation", "curvature", "moment", "force")


class BackboneSegments(Segments):
    """Segments of the rod of a ``BackboneProblem``; a state is its moment [N m], frame (quaternion, scalar last) and position.

    Every segment of every instance is one thread of a launch. The problem's own buffers stay as they are.
    """

    def __init__(self, problem: "BackboneProblem") -> None:
        self.problem = problem
        self.features = replace(
            problem.features, segment=True, pose=True, pose_sensitivities=True, nodes=False, node_columns=False, lengths=False
        )
        d = self.variation_size = self.features.unknown_count
        self.unknown_places = np.delete(np.arange(d), unknowns_of(self.features).places["rotation"])
        count, device = problem.instance_count, problem.device
        self._call = call = problem._make_call(0)
        call.load_factor = wp.ones(count, dtype=wp.float64, device=device)
        call.unknowns = wp.zeros((count, d), dtype=wp.float64, device=device)
        call.residual = wp.zeros((count, d), dtype=wp.float64, device=device)
        call.gamma = wp.zeros((count, d, d), dtype=wp.float64, device=device)
        call.residual_directions = wp.zeros((count, d, max(problem.direction_count, 1)), dtype=wp.float64, device=device)
        self._stiffness = np.broadcast_to(unit_stiffness(problem.arrays.material[:, 0, 0]), (count, 3))
        self._precurvature = np.broadcast_to(problem.arrays.precurvature[:, 0, 0, :3], (count, 3))
        self._scale = np.broadcast_to(problem.arrays.end[:, 0, -1], (count,))

    # ---- states ----

    def length(self, instance: int) -> float:  # noqa: D102
        translation = self.problem.read("inputs")[instance, self.problem.input_slice("translation")]
        return float(self._scale[instance] + translation[0])

    def base_state(self, instance: int, unknowns: FloatArray) -> FloatArray:  # noqa: D102
        angle = self.problem.read("inputs")[instance, self.problem.input_slice("rotation")][0]
        state = np.zeros(STATE_SIZE)
        state[:3] = self._stiffness[instance] * (unknowns[:3] - self._precurvature[instance])
        state[ROTATION_AT : ROTATION_AT + 4] = [0.0, 0.0, np.sin(angle / 2), np.cos(angle / 2)]
        return state

    def difference(self, instance: int, states: FloatArray, others: FloatArray) -> FloatArray:  # noqa: D102
        result = np.zeros((len(states), self.variation_size))
        result[:, :3] = (states[:, :3] - others[:, :3]) / self._stiffness[instance]
        turn = _rotation(others).inv() * _rotation(states)
        result[:, 3:6] = turn.as_rotvec() / self._scale[instance]
        return result

    def moved(self, instance: int, states: FloatArray, variations: FloatArray) -> FloatArray:  # noqa: D102
        from scipy.spatial.transform import Rotation

        result = states.copy()
        result[:, :3] += self._stiffness[instance] * variations[:, :3]
        turned = _rotation(states) * Rotation.from_rotvec(self._scale[instance] * variations[:, 3:6])
        result[:, ROTATION_AT : ROTATION_AT + 4] = turned.as_quat()
        return result

    def growth(self, found: Propagation) -> FloatArray:  # noqa: D102
        # rotation to moment and back may each be scaled at the cost of the other: their geometric mean is what is left
        T = found.transition
        norm = [[np.linalg.norm(T[:, i : i + 3, j : j + 3], ord=2, axis=(1, 2)) for j in (0, 3)] for i in (0, 3)]
        return np.asarray(np.maximum(np.maximum(norm[0][0], norm[1][1]), np.sqrt(norm[0][1] * norm[1][0])))

    # ---- launches ----

    def _load(self, requests: Sequence[Request], call: Any) -> tuple[Any, Any]:
        """Arguments of a launch over all segments, and where those of each request stand."""
        device = self.problem.device
        places = np.cumsum([0, *(len(r.start) for r in requests)])
        seg: Any = SegmentCall()
        instance = np.repeat([r.instance for r in requests], np.diff(places)).astype(np.int32)
        end = np.concatenate([r.end for r in requests])
        length = np.repeat([self.length(r.instance) for r in requests], np.diff(places))
        seg.instance = wp.array(instance, device=device)
        seg.start = wp.array(np.concatenate([r.start for r in requests]), dtype=wp.float64, device=device)
        seg.end = wp.array(end, dtype=wp.float64, device=device)
        seg.at_tip = wp.array((end >= length).astype(np.int32), device=device)
        seg.state = wp.array(np.concatenate([r.states for r in requests]), dtype=wp.float64, device=device)
        seg.steps = wp.array(np.concatenate([r.steps for r in requests]).astype(np.int32), device=device)
        seg.end_state = wp.zeros((len(end), STATE_SIZE), dtype=wp.float64, device=device)
        seg.fault = wp.zeros(len(end), dtype=wp.int32, device=device)
        level, unknowns = np.array(call.load_factor.numpy()), np.zeros(call.unknowns.shape)
        for r in requests:
            level[r.instance] = r.level
            unknowns[r.instance, self.unknown_places] = r.unknowns
        call.load_factor.assign(level)
        call.unknowns.assign(unknowns)
        return seg, places

    def _launch(self, features: Features, count: int, columns: int, table: Any, call: Any, seg: Any) -> None:
        """One pass over ``count`` segments with columns by their first states, ``columns`` of them, and by directions."""
        problem = self.problem
        problem.heed_stop()
        lanes = width("float64", problem.device)
        call.unknown_columns, call.direction_columns = columns, problem.direction_count if columns else 0
        memory = deal(call, features, problem.integrator, "float64", problem.device, count, lanes, shared=call.node_count == 0)

        def make() -> Any:
            return make_segment_kernel(features, problem.integrator.tableau, lanes)

        record(make, threads(call, count), [table, call, memory, seg], problem.device).launch()

    def propagate(self, requests: Sequence[Request]) -> list[Propagation]:  # noqa: D102
        return self._propagate(requests, self.problem.table)

    def _propagate(self, requests: Sequence[Request], table: Any) -> list[Propagation]:
        problem, call, d = self.problem, self._call, self.variation_size
        seg, places = self._load(requests, call)
        columns = d + problem.direction_count
        seg.columns = wp.zeros((int(places[-1]), 9, columns), dtype=wp.float64, device=problem.device)
        self._launch(self.features, int(places[-1]), d, table, call, seg)
        end, values, fault = seg.end_state.numpy(), seg.columns.numpy(), seg.fault.numpy()
        residual, gamma = call.residual.numpy(), call.gamma.numpy()
        slopes = call.residual_directions.numpy()[..., : problem.direction_count]
        rows = self.unknown_places
        result = []
        for k, r in enumerate(requests):
            mine = slice(places[k], places[k + 1])
            transition = np.zeros((len(r.start), d, columns))
            transition[:, :6] = values[mine, :6]
            # what the base force varies by is the same everywhere
            transition[:, BASE_FORCE_AT:d, BASE_FORCE_AT:d] = np.eye(d - BASE_FORCE_AT)
            tip = np.concatenate([gamma[r.instance, rows], slopes[r.instance, rows]], axis=1)
            result.append(
                Propagation(
                    end=np.array(end[mine]),
                    transition=transition,
                    residual=np.array(residual[r.instance, rows]),
                    residual_columns=tip,
                    displacement=end[mine, POSITION_AT:] - r.states[:, POSITION_AT:],
                    displacement_columns=np.array(values[mine, 6:]),
                    fault=int(fault[mine].max()),
                )
            )
        return result

    # ---- results ----

    def _base(self, instance: int) -> tuple[FloatArray, FloatArray]:
        table = self.problem.table
        row = instance * table.base_stride
        return table.base_rotation.numpy()[row], table.base_position.numpy()[row]

    def tip_pose(self, instance: int, found: Propagation) -> tuple[FloatArray, FloatArray]:  # noqa: D102
        R, p = self._base(instance)
        return p + R @ found.displacement.sum(axis=0), R @ _rotation(found.end[-1:]).as_matrix()[0]

    def tip_pose_columns(self, instance: int, found: Propagation, variations: FloatArray) -> FloatArray:  # noqa: D102
        d = self.variation_size
        R, _ = self._base(instance)
        moved = found.displacement_columns[:, :, :d] @ variations + found.displacement_columns[:, :, d:]
        turned = found.transition[-1, 3:6, :d] @ variations[-1] + found.transition[-1, 3:6, d:]
        tip = R @ _rotation(found.end[-1:]).as_matrix()[0]
        return np.concatenate([R @ moved.sum(axis=0), self._scale[instance] * tip @ turned])

    def shapes(self, points: dict[int, Breakpoints], node_count: int) -> tuple[tuple[Shape, ...], FloatArray, FloatArray]:  # noqa: D102
        return self._at_nodes(points, node_count)[:3]

    def line_length(self, points: dict[int, Breakpoints]) -> FloatArray:
        """How long the lines of these instances are [m], shape (instance_count, drive_count); NaN of others."""
        return self._at_nodes(points, 2)[3]

    def _at_nodes(
        self, points: dict[int, Breakpoints], node_count: int
    ) -> tuple[tuple[Shape, ...], FloatArray, FloatArray, FloatArray]:
        problem = self.problem
        requests = [Request.all_of(instance, point, 1.0) for instance, point in points.items()]
        placed = []
        for request, found in zip(requests, self.propagate(requests), strict=True):
            states = request.states.copy()
            states[:, POSITION_AT:] = np.cumsum(found.displacement, axis=0) - found.displacement
            placed.append(replace(request, states=states, steps=0 * request.steps))
        options: dict[str, Any] = {
            "nodes": True,
            "pose_sensitivities": False,
            "directions": False,
            "lengths": problem.drive_count > 0,
        }
        features = replace(self.features, **options)
        call = problem._make_call(node_count)
        call.node_rod = 0
        for name in ("load_factor", "unknowns", "residual"):
            setattr(call, name, getattr(self._call, name))
        seg, places = self._load(placed, call)
        seg.energy = wp.zeros(int(places[-1]), dtype=wp.float64, device=problem.device)
        seg.work = wp.zeros(int(places[-1]), dtype=wp.float64, device=problem.device)
        seg.line_length = wp.zeros((int(places[-1]), problem.drive_count), dtype=wp.float64, device=problem.device)
        self._launch(features, int(places[-1]), 0, problem.table, call, seg)
        others = np.setdiff1d(np.arange(problem.instance_count), list(points))
        names = (*NODE_FIELDS, *(TOTALS if features.members else ()))
        values = {name: np.array(getattr(call, f"node_{name}").numpy()) for name in names}
        lengths = np.full((problem.instance_count, problem.drive_count), np.nan)
        energy, work = np.full((2, problem.instance_count), np.nan)
        for k, instance in enumerate(points):
            energy[instance] = seg.energy.numpy()[places[k] : places[k + 1]].sum()
            work[instance] = seg.work.numpy()[places[k] : places[k + 1]].sum()
            lengths[instance] = seg.line_length.numpy()[places[k] : places[k + 1]].sum(axis=0)
        for value in values.values():
            value[others] = np.nan
        return (Shape(**values),), energy, work, lengths

    # ---- stability ----

    def modes(self, points: dict[int, Breakpoints]) -> Modes:  # noqa: D102
        instances = list(points)
        modes = self.condensed_form(points).modes(self.problem.stiffness_over_length()[instances])
        known = modes.known & self.problem.stability.has_potential[instances]
        modes.put(~known, Modes.unknown(len(instances), modes.values.shape[1]))
        return modes

    def condensed_form(self, points: dict[int, Breakpoints]) -> CondensedForm:
        """(12) The second variation of these instances, in their order; what is clamped at the base is all there is behind it."""
        found = [self._form(instance, own) for instance, own in points.items()]
        matrix, conjugate, known = zip(*found, strict=True) if found else ((), (), ())
        return CondensedForm(np.reshape(matrix, (-1, 3, 3)), np.array(conjugate, dtype=np.int32), np.array(known, dtype=bool))

    def _form(self, instance: int, points: Breakpoints) -> tuple[FloatArray, int, bool]:
        """Matrix, conjugate points and whether they are known; breakpoints are set as close as (7) asks."""
        problem = self.problem
        shape = self.shapes({instance: points}, LOOKED_AT)[0][0]
        length = self.length(instance)
        moment = max(
            np.linalg.norm(shape.total_moment[instance], axis=1).max(), np.linalg.norm(points.states[:, :3], axis=1).max()
        )
        force = np.linalg.norm(shape.total_force[instance], axis=1).max()
        stiffness = problem.least_stiffness()[instance]
        needed = segments_needed(*(np.array([value]) for value in (length, stiffness, moment, force)))[0]
        if not needed < MOST_NODES - 1:
            return np.full((3, 3), np.nan), 0, False
        while True:
            size = np.diff(points.arclength)
            long = size * needed > length
            if not long.any():
                break
            half = points.halves(instance, long, 1.0)
            points = points.halved(long, half, self.propagate([half])[0].end)
        found = self._propagate([Request.all_of(instance, points, 1.0)], problem._twisting_table())[0]
        frames = _rotation(np.concatenate([points.states, found.end[-1:]])).as_matrix()
        frames = self._base(instance)[0] @ frames
        return form_by_segments(found.transition[:, :6, :6], frames, self._stiffness[instance] / self._scale[instance])


def _rotation(states: FloatArray) -> "Rotation":
    from scipy.spatial.transform import Rotation

    return Rotation.from_quat(states[:, ROTATION_AT : ROTATION_AT + 4])
