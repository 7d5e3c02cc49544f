"""Segments of a rod that is held at both ends: positions are states too, and what holds the ends says where they begin and end.

Numbers in parentheses are those of ``docs/held.md``.
"""

from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from multirod.batch import IntArray
from multirod.kernels.warp_types import Struct
from multirod.models.backbone.problem import BackboneProblem
from multirod.models.backbone.segments.segments import BackboneSegments
from multirod.models.backbone.segments.working import by_work, work
from multirod.models.backbone.stability.condensing.by_places import compliance_by_places
from multirod.models.backbone.stability.condensing.by_segments import HeldUnits, compliance_by_segments
from multirod.models.backbone.stability.condensing.second_variation import CondensedForm
from multirod.models.held.along import Beginning
from multirod.models.held.costless import AXIS, holding
from multirod.models.held.kernels.arguments import Ends, Held
from multirod.models.held.kernels.holding_kernels import hold_ends
from multirod.problem import BoundaryProblem
from multirod.rotations import cross, cross_matrix, left_jacobian, matrices, quaternion_product, to_quaternions
from multirod.segments import Breakpoints, Cuts, Propagation
from multirod.stability import Modes
from multirod.validation import FloatArray

if TYPE_CHECKING:
    from multirod.models.held.problem import HeldProblem


class HeldSegments(BackboneSegments):
    """Segments of the rod of a ``HeldProblem``. States are those of a backbone's, told in the frame of the base's holder.

    A variation is that of a backbone's segments, with the force at the base in the holder's frame; then the position over the
    square of the length and, where a residual at the end needs it, the moment at the base as the unknowns have it.
    """

    own_arguments = (*BackboneSegments.own_arguments, "inputs", "directions")
    given_at_base = True
    end_held = True
    fewest_for_modes = 2  # before whose last the tip's own rotation is eliminated

    def __init__(self, held: "HeldProblem") -> None:
        rod = held.rod
        super().__init__(rod)
        self.held = held
        count, device, call = held.instance_count, held.device, self.call
        self.table = rod.buffers.table()  # whose base is as its holder: what turns in a joint there are states
        own_size = self._varied.size  # of variations as the kernel has them
        self._placed = self.features.loads_by_place  # whether positions are among these
        self._position = self._varied.places["place"] if self._placed else slice(own_size, own_size + 3)
        carries = held.turns > 0 or bool(held.alike.any())
        first = own_size + 3 * (not self._placed)
        self._base_moment = slice(first, first + 3 * carries)
        self.variation_size = self._base_moment.stop
        self._moment, self._rotation, self._force = (self._varied.places[name] for name in ("moment", "rotation", "force"))
        drives = self._varied.places["drives"]
        self._drives = drives
        every = np.arange(own_size)
        self.unknown_places = np.concatenate(
            [every[self._moment], every[drives], every[self._force], every[self._rotation][: held.turns]]
        )
        columns = own_size + max(held.direction_count, 1)
        call.problem.inputs = wp.zeros((count, rod.input_count), dtype=wp.float64, device=device)
        shape = (count, max(held.direction_count, 1), rod.input_count)
        call.problem.directions = wp.zeros(shape, dtype=wp.float64, device=device)
        call.wrench.values = wp.zeros((count, 6), dtype=wp.float64, device=device)
        call.wrench.columns = wp.zeros((count, 6, columns), dtype=wp.float64, device=device)
        table: Struct = Held()
        for name in held.table._cls.vars:
            setattr(table, name, getattr(held.table, name))
        table.problem.load_factor, table.problem.unknowns = (
            call.problem.load_factor,
            wp.zeros((count, held.unknown_count), dtype=wp.float64, device=device),
        )
        self._held = table

    @property
    def direction_count(self) -> int:  # noqa: D102
        return self.held.direction_count

    # ---- states ----

    def length(self, instances: IntArray) -> FloatArray:  # noqa: D102
        return np.asarray(self._scale[instances] + self.held.read("inputs")[instances, 1])

    def base_state(self, instances: IntArray, unknowns: FloatArray) -> FloatArray:  # noqa: D102
        return self._beginning(instances, unknowns, np.ones(len(instances))).states

    def _beginning(self, instances: IntArray, unknowns: FloatArray, level: FloatArray) -> Beginning:
        """(18) Where rods begin at these unknowns (count, n) and levels of the load, (count,)."""
        held, count = self.held, len(instances)
        m, turns = held.rod.unknown_count, held.turns
        angle = level * held.read("inputs")[instances, 0]
        spin = matrices(-angle[:, None] * AXIS)
        scale, stiffness = self._scale[instances], held.stiffness[instances]
        axes = held.holders.base_axes
        a = held.length[instances, None] * (unknowns[:, m:] @ axes)
        turned = matrices(a)
        moment = (spin @ (stiffness[:, None] * unknowns[:, :3])[:, :, None])[..., 0]
        states, frame = np.zeros((count, self._state.size)), self._state.places["frame"]
        states[:, :3] = moment
        states[:, frame] = quaternion_product(to_quaternions(a), to_quaternions(angle[:, None] * AXIS))
        states[:, self._state.places["grips"]] = 1.0
        x_force = unknowns[:, m - 3 : m]
        force = (turned @ x_force[:, :, None])[..., 0]
        if self.features.world_force_is_state:
            states[:, self._state.places["world_force"]] = force * self._force_unit[instances, None]
        by = np.zeros((count, self.variation_size, held.unknown_count))
        unit = stiffness[:, None] / self._stiffness[instances]
        by[:, self._moment, :3] = unit[:, :, None] * spin
        by[:, self._drives, 3 : m - 3] = np.eye(m - 6)
        by[:, self._force, m - 3 : m] = turned
        if turns:
            # (8)
            inner = held.length[instances, None, None] * left_jacobian(-a) @ axes.T
            by[:, self._rotation, m:] = spin @ inner / scale[:, None, None]
            by[:, self._force, m:] = -cross_matrix(force) @ (turned @ inner)
        if self._base_moment.stop > self._base_moment.start:
            by[:, self._base_moment, :3] = np.eye(3)
            if (held_back := holding(held, instances, unknowns, level)) is not None:
                by[:, self._base_moment, m:] = -held_back[1] @ axes.T
        along = np.zeros((count, self.variation_size, held.direction_count))
        if held.direction_count:
            rate = level[:, None] * held.directions.numpy()[instances, : held.direction_count, 0]
            along[:, self._rotation] = AXIS[:, None] * rate[:, None] / scale[:, None, None]
            change = cross(moment, np.broadcast_to(AXIS, moment.shape)) / self._stiffness[instances]
            along[:, self._moment] = change[:, :, None] * rate[:, None]
        return Beginning(states, force, by, along)

    def difference(self, instances: IntArray, states: FloatArray, others: FloatArray) -> FloatArray:  # noqa: D102
        result = super().difference(instances, states, others)
        if self._placed:
            return result
        place = self._state.places["position"]
        result[:, self._position] = (states[:, place] - others[:, place]) / self._scale[instances, None] ** 2
        return result

    def moved(self, instances: IntArray, states: FloatArray, variations: FloatArray) -> FloatArray:  # noqa: D102
        result = super().moved(instances, states, variations)
        if self._placed:
            return result
        result[:, self._state.places["position"]] += variations[:, self._position] * self._scale[instances, None] ** 2
        return result

    def _axes(self, instances: IntArray) -> FloatArray:
        """Those of the base's holder."""
        return np.asarray(np.broadcast_to(np.eye(3), (len(instances), 3, 3)))

    # ---- launches ----

    def _load(self, cuts: Cuts, level: FloatArray, call: Struct) -> dict[str, NDArray[Any]]:
        held, chosen = self.held, cuts.instances
        begin = self._beginning(chosen, cuts.unknowns, level)
        m, along, last = held.rod.unknown_count, held.table.along, held.table.rod_inputs
        given = held.read("inputs")
        arrays = {name: getattr(call.problem, name).numpy() for name in ("load_factor", "unknowns", "inputs", "directions")}
        arrays["load_factor"][chosen] = level
        arrays["unknowns"][chosen, self._drives] = cuts.unknowns[:, 3 : m - 3]
        arrays["unknowns"][chosen, self._force] = begin.force
        for values, rows in ((arrays["inputs"], given), (arrays["directions"], held.directions.numpy())):
            mine = rows[chosen]
            values[chosen, ..., 1] = mine[..., 1]
            values[chosen, ..., along:last] = mine[..., along:last]
            values[chosen, ..., last] = mine[..., -1]
        whole = self._held.problem.unknowns.numpy()
        whole[chosen] = cuts.unknowns
        if not wp.get_device(self.device).is_cpu:
            for name, values in arrays.items():
                getattr(call.problem, name).assign(values)
            self._held.problem.unknowns.assign(whole)
        owner, states = cuts.owner, cuts.states.copy()
        at_base = np.flatnonzero(cuts.start == 0)
        states[at_base] = begin.states[owner[at_base]]
        at_tip = cuts.end >= self.length(chosen)[owner]
        names = ("instance", "start", "end", "at_tip", "state", "steps")
        return dict(zip(names, (chosen[owner], cuts.start, cuts.end, at_tip, states, cuts.steps), strict=True))

    def _transitions(self, cuts: Cuts, found: dict[str, NDArray[Any]]) -> FloatArray:
        """By the states where segments begin, then along directions, shape (segment_count, d, d + direction_count)."""
        own_size, d = self._varied.size, self.variation_size
        values, square = found["columns"], self._scale[cuts.instances[cuts.owner], None, None] ** 2
        result = np.zeros((len(values), d, d + self.direction_count))
        parts = [(slice(0, own_size), values[:, :own_size])]
        if not self._placed:
            parts.append((self._position, values[:, own_size:] / square))
        for rows, part in parts:
            result[:, rows, :own_size] = part[:, :, :own_size]
            result[:, rows, d:] = part[:, :, own_size:]
        kept = np.arange(own_size, d)
        result[:, kept, kept] = 1.0
        return result

    def lead(self, cuts: Cuts, level: FloatArray) -> Propagation:  # noqa: D102
        return self.propagate(cuts, level)

    def _propagate(self, cuts: Cuts, level: FloatArray, table: Struct, columns_by_state: int | None = None) -> Propagation:
        found = self._launched(cuts, level, table)
        begin = self._beginning(cuts.instances, cuts.unknowns, level)
        transition = self._transitions(cuts, found)
        at_tip = self._at_tip(cuts, found["end_state"], transition)
        alone = np.flatnonzero((cuts.counts == 1) & (cuts.start[cuts.first[:-1]] == 0))
        base = cuts.start == 0
        rows = np.flatnonzero(base)
        transition[rows] = begin.chosen(cuts.owner[rows]).follow(transition[rows], self.unknown_places)
        residual, columns = self._residual(cuts, found["end_state"], at_tip, level)
        columns[alone] = begin.chosen(alone).follow(columns[alone], self.unknown_places)
        position = self._state.places["position"]
        end = found["end_state"]
        start = np.where(base[:, None], 0.0, cuts.states[:, position])
        square = self._scale[cuts.instances[cuts.owner], None, None] ** 2
        return Propagation(
            end=end,
            transition=transition,
            residual=residual,
            residual_columns=columns,
            displacement=end[:, position] - start,
            displacement_columns=square * transition[:, self._position],
            fault=np.maximum.reduceat(found["fault"], cuts.first[:-1]),
        )

    def _at_tip(self, cuts: Cuts, end: FloatArray, transition: FloatArray) -> FloatArray:
        """How position, rotation, force and moment of the tip, in the world, and the moment at the base vary with the state where
        the last segment begins, then along directions, shape (count, 15, d + direction_count)."""
        d, own_size, K = self.variation_size, self._varied.size, self.direction_count
        chosen, last = cuts.instances, cuts.first[1:] - 1
        scale = self._scale[chosen, None, None]
        base, tip = self._base(chosen)[0], self._matrices(end[last])
        result = np.zeros((len(chosen), 15, d + K))
        result[:, :3] = scale**2 * base @ transition[last][:, self._position]
        result[:, 3:6] = scale * (base @ tip) @ transition[last][:, self._rotation]
        wrench = self.call.wrench.columns.numpy()[chosen]
        result[:, 6:12, :own_size] = wrench[:, :, :own_size]
        result[:, 6:12, d:] = wrench[:, :, own_size : own_size + K]
        if self._base_moment.stop > self._base_moment.start:
            result[:, 12:, self._base_moment] = self.held.stiffness[chosen, None, None] * np.eye(3)
        return result

    def _residual(self, cuts: Cuts, end: FloatArray, at_tip: FloatArray, level: FloatArray) -> tuple[FloatArray, FloatArray]:
        """(5), (7), (8), (11) and their columns as ``Propagation`` has them, but by the state of the base where there is one
        segment."""
        held, call, chosen, d, K = self.held, self.call, cuts.instances, self.variation_size, self.direction_count
        count, m, own_size = len(chosen), held.rod.unknown_count, self._varied.size
        residual, columns = np.zeros((count, held.unknown_count)), np.zeros((count, held.unknown_count, d + K))
        last = cuts.first[1:] - 1
        R, p = self._base(chosen)
        position = p + np.einsum("bij,bj->bi", R, end[last][:, self._state.places["position"]])
        ends: Struct = Ends()
        wrench = call.wrench.values.numpy()[chosen]
        given = {"position": (position, wp.vec3d), "rotation": (R @ self._matrices(end[last]), wp.mat33d)}
        given |= {"wrench": (wrench, wp.float64), "columns": (at_tip, wp.float64), "instance": (chosen, wp.int32)}
        for name, (values, kind) in given.items():
            numbers = np.int32 if kind is wp.int32 else np.float64
            setattr(ends, name, wp.array(np.ascontiguousarray(values, dtype=numbers), dtype=kind, device=self.device))
        ends.residual = wp.zeros((count, 6), dtype=wp.float64, device=self.device)
        ends.residual_columns = wp.zeros((count, 6, d + K), dtype=wp.float64, device=self.device)
        wp.launch(hold_ends, dim=count, inputs=[self._held, ends], device=self.device)
        residual[:, :6], columns[:, :6] = ends.residual.numpy(), ends.residual_columns.numpy()
        opening = (1 - level)[:, None] * held.table.opening.numpy()[chosen]
        if m > 6:
            rows = self._rows.places["conditions"]
            residual[:, 6:m] = call.problem.residual.numpy()[chosen, rows] - opening[:, 6:m]
            columns[:, 6:m, :own_size] = call.problem.gamma.numpy()[chosen, rows]
            columns[:, 6:m, d:] = call.problem.residual_directions.numpy()[chosen, rows, :K]
        if held.turns:
            axes = held.holders.base_axes
            held_back = holding(held, chosen, cuts.unknowns, level)
            moment = cuts.unknowns[:, :3] - (0.0 if held_back is None else held_back[0])
            residual[:, m:] = moment @ axes.T - opening[:, m:]
            columns[:, m:, self._base_moment] = axes
        return residual, columns

    # ---- results ----

    def level(self, instances: IntArray) -> FloatArray:  # noqa: D102
        return np.asarray(self.held.buffer("load_factor")[instances])

    def tip_pose(self, cuts: Cuts, found: Propagation) -> tuple[FloatArray, FloatArray]:  # noqa: D102
        R, p = self._base(cuts.instances)
        end = found.end[cuts.first[1:] - 1]
        return p + (R @ end[:, self._state.places["position"], None])[..., 0], R @ self._matrices(end)

    def tip_pose_columns(self, cuts: Cuts, found: Propagation, variations: FloatArray) -> FloatArray:  # noqa: D102
        d, scale = self.variation_size, self._scale[cuts.instances[0]]
        R = self._base(cuts.instances)[0][0]
        change = found.transition[-1, :, :d] @ variations[-1] + found.transition[-1, :, d:]
        tip = R @ self._matrices(found.end[-1:])[0]
        return np.concatenate([scale**2 * R @ change[self._position], scale * tip @ change[self._rotation]])

    # ---- stability ----

    def modes(self, points: dict[int, Breakpoints]) -> Modes:  # noqa: D102
        with self._known_by(points):
            return self.held.stability.modes().take(list(points))

    @property
    def asked(self) -> BoundaryProblem:
        """The held one, of whose unknowns the rod's are a part."""
        return self.held

    def wrench(self, points: dict[int, Breakpoints]) -> FloatArray:
        """Force and moment on the tips of these instances, in the world, shape (len(points), 6)."""
        cuts = Cuts.of_points(points)
        self.propagate(cuts, self.level(cuts.instances))
        return np.array(self.call.wrench.values.numpy()[cuts.instances])

    def condensed_form(self, points: dict[int, Breakpoints]) -> CondensedForm:
        """(12), (14) As a function of the angles of the base's joint, then the moment and the force on the tip."""
        turns = self.held.turns
        form = CondensedForm.unknown(len(points), turns + 6)
        if not points or self.problem.features.condition_count:
            return form
        cuts, few = self._cut_for_modes(points)
        if not few.any():
            return form
        table = self.problem.buffers.twisting_table(self.table)  # the problem's own is turned in the base's joint
        found = self._launched(cuts, self.level(cuts.instances), table)
        chosen = cuts.instances
        transition, first = self._transitions(cuts, found), cuts.first
        if self._placed:
            working = by_work(self, transition, cuts)
            R, tip = self._base(chosen)[0], found["end_state"][first[1:] - 1]
            ends = R[cuts.owner] @ self._matrices(found["end_state"])
            own = compliance_by_places(working, ends, first, work(self, cuts), self._scale[chosen], R, tip[:, :3])
            form.put(np.flatnonzero(few), own)
            return form
        names = (self._moment, self._position), (self._rotation, self._force)
        every = np.arange(self.variation_size)
        order = np.concatenate([np.concatenate([every[place] for place in half]) for half in names])
        h = 6 + turns
        own_places = np.r_[0:6, h : h + 6]
        T = np.zeros((len(transition), 2 * h, 2 * h))
        T[np.ix_(np.arange(len(T)), own_places, own_places)] = transition[:, order[:, None], order]
        if turns:
            free = np.r_[6:h, h + 6 : 2 * h]
            T[:, free, free] = 1.0
            self._free_base(T, cuts)
        R = self._base(chosen)[0]
        frames, ends = (R[cuts.owner] @ self._matrices(states) for states in (cuts.states, found["end_state"]))
        scale, stiffness = self._scale[chosen], self.held.stiffness[chosen]
        moment = self.call.wrench.values.numpy()[chosen, 3:]
        units = HeldUnits(self._stiffness[chosen], scale, stiffness, R)
        form.put(np.flatnonzero(few), compliance_by_segments(T, frames, ends, first, units, moment))
        return form

    def _free_base(self, T: FloatArray, cuts: Cuts) -> None:
        """(14) Where segments begin at the base, put in how they vary with its angles, and its moment about them."""
        held, chosen = self.held, cuts.instances
        m, h = held.rod.unknown_count, 6 + held.turns
        rows = cuts.first[:-1]
        spin = matrices(-self.level(chosen)[:, None] * held.read("inputs")[chosen, :1] * AXIS)
        axes = held.holders.base_axes
        a = held.length[chosen, None] * (cuts.unknowns[:, m:] @ axes)
        axes_of_base = left_jacobian(-a) @ axes.T
        turned = spin @ axes_of_base
        T[rows, :, h + 6 :] += T[rows, :, h : h + 3] @ turned / self._scale[chosen, None, None]
        T[rows, 6:h, :3] = turned.swapaxes(1, 2) * self._stiffness[chosen, None]


class HeldBackbone(BackboneProblem):
    """The rod of a ``HeldProblem``, whose segments begin and end where that says."""

    whole: "HeldProblem"

    @cached_property
    def cut(self) -> HeldSegments:
        """Its segments, with what holds the ends."""
        return HeldSegments(self.whole)
