"""Segments of a backbone of one rod: its states and their variations, and what is left of these at the tip."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
import warp as wp

from multirod.batch import IntArray
from multirod.kernels.warp_types import Struct
from multirod.models.backbone.kernels.layout.features import Features
from multirod.models.backbone.kernels.layout.layout import breakpoint_state, of_whole, residuals_of, unknowns_of
from multirod.models.backbone.passes.buffers import NODE_FIELDS, TOTALS
from multirod.models.backbone.segments.growth import amplified
from multirod.models.backbone.segments.room import NodeRooms, Room
from multirod.models.backbone.segments.working import added_up, by_work, held_form, work
from multirod.models.backbone.stability.condensing.by_places import form_by_places
from multirod.models.backbone.stability.condensing.by_segments import form_by_segments
from multirod.models.backbone.stability.condensing.second_variation import MOST_NODES, CondensedForm, segments_needed
from multirod.models.backbone.stability.condensing.tensions import without_tensions
from multirod.models.backbone.units import unit_stiffness
from multirod.problem import BoundaryProblem, Shape
from multirod.rotations import from_quaternions, matrices, of_quaternions, quaternion_product, to_quaternions
from multirod.segments import Breakpoints, Cuts, Propagation, Segments
from multirod.stability import Modes
from multirod.status import BoolArray
from multirod.validation import FloatArray

if TYPE_CHECKING:
    from multirod.models.backbone.problem import BackboneProblem

CONJUGATE = np.array([-1.0, -1.0, -1.0, 1.0])  # of a quaternion
LOOKED_AT = 33  # nodes at which moments and forces are bounded


class BackboneSegments(Segments):
    """Segments of the rod of a ``BackboneProblem``; a state is its moment [N m], frame (quaternion, scalar last) and position,
    then how long lines that are driven by their length are up to there, what friction has left of tensions and, where loads'
    forces depend on the configuration, the force [N] along the axes of the base.

    Every segment of every instance is one thread of a launch. The problem's own buffers stay as they are.
    """

    own_arguments: tuple[str, ...] = ("load_factor", "unknowns", "residual")  # of launches, in place of the problem's
    given_at_base = False  # whether states are, which else follow from the unknowns
    fewest_for_modes = 1

    def __init__(self, problem: "BackboneProblem") -> None:
        self.problem = problem
        self.table: Struct = problem.table
        self.features = replace(
            problem.features, segment=True, pose=True, pose_sensitivities=True, nodes=False, node_columns=False, lengths=False
        )
        self._state, self._varied = breakpoint_state(self.features), unknowns_of(self.features)
        d = self.variation_size = self._varied.size
        self.unknown_places = of_whole(self._varied)
        self._rows = residuals_of(self._varied)
        count, m = problem.instance_count, self._rows.size
        self.device = device = problem.device
        self.call: Struct = problem.buffers.call()
        own = self.call.problem
        own.load_factor = wp.ones(count, dtype=wp.float64, device=device)
        own.unknowns = wp.zeros((count, d), dtype=wp.float64, device=device)
        own.residual = wp.zeros((count, m), dtype=wp.float64, device=device)
        own.gamma = wp.zeros((count, m, d), dtype=wp.float64, device=device)
        own.residual_directions = wp.zeros((count, m, max(problem.direction_count, 1)), dtype=wp.float64, device=device)
        seen = ("load_factor", "unknowns", "residual", "gamma", "residual_directions")
        self._views = {name: getattr(own, name).numpy() for name in seen} if problem.on_host else {}
        if problem.held:
            self.call.wrench.values = wp.zeros((count, 6), dtype=wp.float64, device=device)
            shape = (count, 6, d + max(problem.direction_count, 1))
            self.call.wrench.columns = wp.zeros(shape, dtype=wp.float64, device=device)
        self._stiffness = np.broadcast_to(unit_stiffness(problem.arrays.material[:, 0, 0]), (count, 3))
        self._precurvature = np.broadcast_to(problem.arrays.precurvature[:, 0, 0, :3], (count, 3))
        self._scale = np.broadcast_to(problem.arrays.end[:, 0, -1], (count,))
        # (5) lengths and grips per variation
        levers = [np.broadcast_to(lever, (count,)) for lever in problem.lines.levers()]
        grips = [np.ones(count)] * self.features.grip_count
        self._units = np.stack([*levers, *grips, np.ones(count)], axis=1)[:, :-1] * self._scale[:, None]
        # what adds up along the rod, and how it varies
        added = [slot for slot in self._state.named.values() if slot.name in ("lengths", "grips") and slot.seed is not None]
        self._sums = np.concatenate([np.arange(self._state.size)[self._state.places[slot.name]] for slot in added])
        self._added = np.concatenate([np.arange(d)[self._varied.places[str(slot.seed)]] for slot in added])
        # (12) of docs/stability.md: what works on what, first what follows, then what is given
        names = ("moment", "lengths", "rotation", "drives")
        # (5d) of docs/solvers.md: force and position vary along the axes of the rod at its base
        self._force_unit = np.broadcast_to(problem.arrays.material[:, 0, 0, :2].max(axis=1) / self._scale, (count,))
        self._conjugates = np.concatenate([np.arange(d)[self._varied.places[name]] for name in names])
        self._rooms: dict[tuple[int, int], Room] = {}
        self._node_rooms = NodeRooms(self)

    @property
    def direction_count(self) -> int:  # noqa: D102
        return self.problem.direction_count

    # ---- states ----

    def length(self, instances: IntArray) -> FloatArray:  # noqa: D102
        translation = self.problem.read("inputs")[instances, self.problem.input_slice("translation")]
        return np.asarray(self._scale[instances] + translation[:, 0])

    def base_state(self, instances: IntArray, unknowns: FloatArray) -> FloatArray:  # noqa: D102
        angle = self.problem.read("inputs")[instances, self.problem.input_slice("rotation")][:, 0]
        state, frame = np.zeros((len(instances), self._state.size)), self._state["frame"]
        state[:, :3] = self._stiffness[instances] * (unknowns[:, :3] - self._precurvature[instances])
        state[:, frame + 2], state[:, frame + 3] = np.sin(angle / 2), np.cos(angle / 2)
        state[:, self._state.places["grips"]] = 1.0
        if self.features.world_force_is_state:
            force = unknowns[:, -3:] * self._force_unit[instances, None]  # (13)
            state[:, self._state.places["world_force"]] = np.einsum("kij,kj->ki", self._axes(instances), force)
        return state

    def difference(self, instances: IntArray, states: FloatArray, others: FloatArray) -> FloatArray:  # noqa: D102
        result = np.zeros((len(states), self.variation_size))
        result[:, :3] = (states[:, :3] - others[:, :3]) / self._stiffness[instances]
        frames = self._quaternions(np.concatenate([others, states]))
        turn = quaternion_product(frames[: len(others)] * CONJUGATE, frames[len(others) :])
        result[:, self._varied.places["rotation"]] = of_quaternions(turn) / self._scale[instances, None]
        result[:, self._added] = (states[:, self._sums] - others[:, self._sums]) / self._units[instances]
        for slot, variation, unit in self._along_base(instances):
            apart = states[:, slot] - others[:, slot]
            result[:, variation] = np.einsum("kji,kj->ki", self._axes(instances), apart) / unit[:, None]
        return result

    def moved(self, instances: IntArray, states: FloatArray, variations: FloatArray) -> FloatArray:  # noqa: D102
        result = states.copy()
        result[:, :3] += self._stiffness[instances] * variations[:, :3]
        turn = to_quaternions(self._scale[instances, None] * variations[:, self._varied.places["rotation"]])
        result[:, self._state.places["frame"]] = quaternion_product(self._quaternions(states), turn)
        result[:, self._sums] += self._units[instances] * variations[:, self._added]
        for slot, variation, unit in self._along_base(instances):
            result[:, slot] += np.einsum("kij,kj->ki", self._axes(instances), unit[:, None] * variations[:, variation])
        return result

    def _along_base(self, instances: IntArray) -> list[tuple[slice, slice, FloatArray]]:
        """(5d) Where force and position stand in a state and in a variation, and what is one of these, (count,); none where they
        do not vary."""
        state, varied, names = self._state.places, self._varied.places, []
        if self.features.world_force_is_state:
            names.append((state["world_force"], varied["force"], self._force_unit[instances]))
        if self.features.loads_by_place:
            names.append((state["position"], varied["place"], self._scale[instances] ** 2))
        return names

    def _axes(self, instances: IntArray) -> FloatArray:
        """Frames of the rod at its base in those of the base, shape (count, 3, 3)."""
        angle = self.problem.read("inputs")[instances, self.problem.input_slice("rotation")]
        return np.asarray(matrices(angle * [0.0, 0.0, 1.0]))

    def growth(self, cuts: Cuts, found: Propagation) -> FloatArray:  # noqa: D102
        return amplified(found.transition[:, :6, :6], self._stiffness[cuts.instances[cuts.owner]])

    def _quaternions(self, states: FloatArray) -> FloatArray:
        """Frames of states as unit quaternions (count, 4)."""
        q = states[:, self._state.places["frame"]]
        with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
            size = np.sqrt((q**2).sum(axis=1, keepdims=True))
            sound = (size > 0) & (size < np.inf)
            # no turn where an integration failed
            return np.asarray(q / size if sound.all() else np.where(sound, q / size, (0.0, 0.0, 0.0, 1.0)))

    def _matrices(self, states: FloatArray) -> FloatArray:
        """Frames of states as rotation matrices (count, 3, 3)."""
        return from_quaternions(self._quaternions(states))

    # ---- launches ----

    def _seen(self, name: str) -> FloatArray:
        """An array of the launches' own: on the CPU itself, as NumPy sees it, else a copy."""
        view = self._views.get(name)
        return np.asarray(getattr(self.call.problem, name).numpy()) if view is None else view

    def _load(self, cuts: Cuts, level: FloatArray, call: Struct) -> dict[str, Any]:
        """Set the levels and unknowns of instances; what a launch over all segments is told of each of these."""
        own = call.problem
        levels, unknowns = self._seen("load_factor"), self._seen("unknowns")
        levels[cuts.instances] = level
        unknowns[cuts.instances[:, None], self.unknown_places] = cuts.unknowns
        if not self._views:  # else they are the arrays themselves
            own.load_factor.assign(levels)
            own.unknowns.assign(unknowns)
        owner = cuts.owner
        at_tip = cuts.end >= self.length(cuts.instances)[owner]
        names = ("instance", "start", "end", "at_tip", "state", "steps")
        values = (cuts.instances[owner], cuts.start, cuts.end, at_tip, cuts.states, cuts.steps)
        return dict(zip(names, values, strict=True))

    def propagate(self, cuts: Cuts, level: FloatArray) -> Propagation:  # noqa: D102
        return self._propagate(cuts, level, self.table)

    def lead(self, cuts: Cuts, level: FloatArray) -> Propagation:  # noqa: D102
        return self._propagate(cuts, level, self.table, 0)

    def _launched(self, cuts: Cuts, level: FloatArray, table: Struct, columns: int | None = None) -> dict[str, Any]:
        """What a launch over all segments finds, with so many columns by their states, all by default."""
        self.problem.heed_stop()
        count = len(cuts.start)
        return self._room(count, table, columns).run(count, self._load(cuts, level, self.call))

    def _propagate(self, cuts: Cuts, level: FloatArray, table: Struct, columns_by_state: int | None = None) -> Propagation:
        d = self.variation_size
        found = self._launched(cuts, level, table, columns_by_state)
        end, values = found["end_state"], found["columns"]
        position = self._state.places["position"]
        mine = cuts.instances
        slopes = self._seen("residual_directions")[mine, :, : self.direction_count]
        return Propagation(
            end=end,
            transition=values[:, :d],
            residual=self._seen("residual")[mine],
            residual_columns=np.concatenate([self._seen("gamma")[mine], slopes], axis=2)[:, :, : values.shape[2]],
            displacement=end[:, position] - cuts.states[:, position],
            displacement_columns=values[:, d:],
            fault=np.maximum.reduceat(found["fault"], cuts.first[:-1]),
        )

    def _room(self, count: int, table: Struct, columns: int | None) -> Room:
        """Room for so many segments and more, kept for the next launch over about as many."""
        key = capacity, columns = 1 << max(count - 1, 3).bit_length(), self._varied.size if columns is None else columns
        room = self._rooms.get(key)
        if room is None or room.table is not table:
            room = self.make_room(self.features, self.call, table, capacity, columns)
            if table is self.table:
                self._rooms[key] = room
        return room

    def make_room(self, features: Features, call: Struct, table: Struct, capacity: int, columns: int) -> Room:
        """Room for so many segments, with columns by so many numbers of their states."""
        return Room(self.problem, features, call, table, capacity, columns, self.direction_count, self.given_at_base)

    # ---- results ----

    def _base(self, instances: IntArray) -> tuple[FloatArray, FloatArray]:
        table = self.table
        rows = instances * table.base_stride
        return table.base_rotation.numpy()[rows], table.base_position.numpy()[rows]

    def tip_pose(self, cuts: Cuts, found: Propagation) -> tuple[FloatArray, FloatArray]:  # noqa: D102
        R, p = self._base(cuts.instances)
        moved = np.add.reduceat(found.displacement, cuts.first[:-1])
        turned = self._matrices(found.end[cuts.first[1:] - 1])
        return p + (R @ moved[:, :, None])[..., 0], R @ turned

    def tip_pose_columns(self, cuts: Cuts, found: Propagation, variations: FloatArray) -> FloatArray:  # noqa: D102
        d = self.variation_size
        R = self._base(cuts.instances)[0][0]
        moved = found.displacement_columns[:, :, :d] @ variations + found.displacement_columns[:, :, d:]
        if self.features.loads_by_place:  # those of where segments end
            moved = moved[-1:]
        turned = found.transition[-1, 3:6, :d] @ variations[-1] + found.transition[-1, 3:6, d:]
        tip = R @ self._matrices(found.end[-1:])[0]
        return np.concatenate([R @ moved.sum(axis=0), self._scale[cuts.instances[0]] * tip @ turned])

    def shapes(self, points: dict[int, Breakpoints], node_count: int) -> tuple[tuple[Shape, ...], FloatArray, FloatArray]:  # noqa: D102
        return self._at_nodes(points, node_count)[:3]

    def along_lines(self, points: dict[int, Breakpoints], node_count: int) -> tuple[FloatArray, FloatArray]:
        """How long the lines of these instances are [m], shape (instance_count, drive_count), and what friction leaves of their
        tensions at nodes, shape (instance_count, node_count, drive_count or 0); NaN of others."""
        return self._at_nodes(points, node_count)[3:]

    def _at_nodes(
        self, points: dict[int, Breakpoints], node_count: int
    ) -> tuple[tuple[Shape, ...], FloatArray, FloatArray, FloatArray, FloatArray]:
        problem = self.problem
        cuts = Cuts.of_points(points)
        full = self.level(cuts.instances)
        found = self.propagate(cuts, full)
        states = cuts.states.copy()
        if not self.features.loads_by_place:
            states[:, self._state.places["position"]] = added_up(found.displacement, cuts) - found.displacement
        states[:, self._state.places["lengths"]] = 0.0  # those of segments are asked for
        placed = replace(cuts, states=states, steps=0 * cuts.steps)
        options: dict[str, Any] = {
            "nodes": True,
            "pose_sensitivities": False,
            "directions": False,
            "lengths": problem.drive_count > 0,
        }
        features = replace(self.features, **options)
        problem.heed_stop()
        count = len(placed.start)
        room = self._node_rooms.of(features, node_count, count)
        led = room.run(count, self._load(placed, full, room.call))
        others = np.setdiff1d(np.arange(problem.instance_count), list(points))
        names = (*NODE_FIELDS, *(TOTALS if features.members else ()))
        values = {name: np.array(getattr(room.call, f"node_{name}").numpy()) for name in names}
        lengths = np.full((problem.instance_count, problem.drive_count), np.nan)
        energy, work = np.full((2, problem.instance_count), np.nan)
        first = cuts.first[:-1]
        energy[cuts.instances] = np.add.reduceat(led["energy"], first)
        work[cuts.instances] = np.add.reduceat(led["work"], first)
        lengths[cuts.instances] = np.add.reduceat(led["line_length"], first)
        for value in values.values():
            value[others] = np.nan
        left = np.array(room.call.node_left.numpy())
        left[others] = np.nan
        return (Shape(**values),), energy, work, lengths, left

    # ---- stability ----

    def modes(self, points: dict[int, Breakpoints]) -> Modes:  # noqa: D102
        instances, problem = list(points), self.problem
        with self._known_by(points):
            modes = self.condensed_form(points).modes(problem.sizes.stiffness_over_length()[instances])
            known = modes.known & problem.stability.judged[instances]
            modes.put(~known, Modes.unknown(len(instances), modes.values.shape[1]))
            modes.diverging[:] = (problem.stability.has_potential & problem.lines.gives_way())[instances]
        return modes

    @property
    def asked(self) -> BoundaryProblem:
        """The problem whose equilibria are known by breakpoints."""
        return self.problem

    @contextmanager
    def _known_by(self, points: dict[int, Breakpoints]) -> Iterator[None]:
        """The problem at these equilibria, where others read what it is at."""
        problem, before, unknowns = self.asked, self.asked.breakpoints, self.asked.read("unknowns")
        at = unknowns.copy()
        at[list(points)] = [own.unknowns for own in points.values()]
        problem.breakpoints = points
        problem.write("unknowns", at)
        try:
            yield
        finally:
            problem.breakpoints = before
            problem.write("unknowns", unknowns)

    def condensed_form(self, points: dict[int, Breakpoints]) -> CondensedForm:
        """(12) The second variation of these instances, in their order; what is clamped at the base is all there is behind it."""
        count = len(points)
        problem = self.problem
        form = CondensedForm.unknown(count, 6 if problem.held else 3)
        if not count:
            return form
        cuts, few = self._cut_for_modes(points)
        if not few.any():
            return form
        if problem.held:
            form.put(np.flatnonzero(few), held_form(self, cuts))
            return form
        found = self._propagate(cuts, self.level(cuts.instances), problem.buffers.twisting_table())
        base = self._base(cuts.instances)[0][cuts.owner]
        frames, ends = (base @ self._matrices(states) for states in (cuts.states, found.end))
        unit = self._stiffness[cuts.instances] / self._scale[cuts.instances, None]
        if problem.features.loads_by_place:
            own = form_by_places(by_work(self, found.transition, cuts), ends, cuts.first, work(self, cuts))
            form.put(np.flatnonzero(few), own)
            return form
        own, W = form_by_segments(
            found.transition[:, self._conjugates[:, None], self._conjugates], frames, ends, cuts.first, unit
        )
        if problem.features.condition_count:
            own = self._tensions_eliminated(own, W, cuts, found)
        form.put(np.flatnonzero(few), own)
        return form

    def level(self, instances: IntArray) -> FloatArray:
        """Load factor at which results are looked at, shape (count,)."""
        return np.asarray(self.problem.buffer("load_factor")[instances])

    def _cut_for_modes(self, points: dict[int, Breakpoints]) -> tuple[Cuts, BoolArray]:
        """Segments of these instances so short that none holds a conjugate point, (7) of ``docs/stability.md``, and which have so
        few, (len(points),): those that the segments are of."""
        cuts = Cuts.of_points(points)
        everyone = cuts.instances
        shape = self.shapes(points, LOOKED_AT)[0][0]
        moment, force = (np.linalg.norm(v[everyone], axis=2).max(axis=1) for v in (shape.total_moment, shape.total_force))
        moment = np.maximum(moment, np.maximum.reduceat(np.linalg.norm(cuts.states[:, :3], axis=1), cuts.first[:-1]))
        length = self.length(everyone)
        potential = force + self.problem.sizes.moment_per_length()[everyone]
        needed = segments_needed(length, self.problem.lines.least_stiffness()[everyone], moment, potential)
        needed = np.maximum(np.maximum(needed, self.fewest_for_modes), self.problem.sizes.segments()[everyone])
        few = needed < MOST_NODES - 1
        if not few.any():
            return cuts, few
        cuts = cuts.chosen(few)
        length, needed = length[few], needed[few]
        while (long := (cuts.end - cuts.start) * needed[cuts.owner] > length[cuts.owner]).any():
            half = cuts.halves(long)
            cuts = cuts.halved(long, half, self.propagate(half, self.level(half.instances)).end)
        return cuts, few

    def _tensions_eliminated(self, form: CondensedForm, W: FloatArray, cuts: Cuts, found: Propagation) -> CondensedForm:
        """(18) of ``docs/stability.md``, by how moment and lengths follow from rotation and tensions at the tip, ``W``."""
        drives, last = self._varied.places["drives"], cuts.first[1:] - 1
        conditions = self.problem.rows.places["conditions"]
        # beside what lengths change by: what lines give way, which is none of them by another's tension
        stretch = found.residual_columns[:, conditions, drives] + found.transition[last, self._varied.places["lengths"], drives]
        taut = self.problem.lines.taut()[cuts.instances]
        own, size = W[:, 3:, 3:] - stretch, np.ones(len(last))
        return without_tensions(form, W[:, :3, 3:], W[:, 3:, :3], own, size, taut)
