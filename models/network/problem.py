"""Rods and bodies in a graph: the boundary problem.

Numbers in parentheses are those of ``docs/networks.md``. Each rod is integrated in the frame of its base by the backbone kernels;
what its ends say of the bodies is an element (``elements.py``), and residual and ``Gamma`` are the sums of the elements. They are
put together by ``network_kernels.py``; ``entries.py`` says where they stand, and how ``Gamma`` is eliminated along the graph.
"""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from multirod.batch import IntArray
from multirod.capabilities import LineTest, Loading, ResultTest
from multirod.inputs import Inputs
from multirod.integrators import Integrator
from multirod.launch import record
from multirod.models.backbone.members.member import drive_slices
from multirod.models.backbone.passes.lane_pass import width
from multirod.models.backbone.starts import twisted
from multirod.models.joint_kernels import AT_REST
from multirod.models.network import network_kernels as kernels
from multirod.models.network.along import NetworkSensing, columns_along
from multirod.models.network.capabilities import NetworkJoints, NetworkLines, NetworkParts, NetworkShapes, NetworkStarts
from multirod.models.network.elements import records
from multirod.models.network.elements.element_kernels import form
from multirod.models.network.elements.elements import GAP_AT, POSE, Frames, Holding
from multirod.models.network.elements.groups import ALONG, ON_RODS, RodGroup, along, builds
from multirod.models.network.graph import Graph
from multirod.models.network.joining.placing import placed
from multirod.models.network.stability.clamps import NetworkClamps
from multirod.models.network.stability.conjugates import NetworkConjugates
from multirod.models.network.stability.form_rows import FormRows
from multirod.models.network.stability.stability import NetworkStability
from multirod.problem import ALONE, NOTHING, Block, BoundaryProblem
from multirod.rotations import vectors
from multirod.status import Status
from multirod.validation import FloatArray

CLOSED = 1e-4  # of a length, that a gap is closed to
GAP_LOAD = 12.0  # EI/L^3: what a rod resists with where its tip is moved across


@dataclass(frozen=True)
class Apart:
    """The network taken apart, at certain inputs.

    Attributes:
        inputs: Those that are no loads on bodies, (instance_count, k).
        unknowns: [1/m], shape (instance_count, n).
        residual: There, without loads [1/m], shape (instance_count, n).
        gamma: The numbers of ``Gamma`` there that are kept, shape (instance_count, k).
        turned: From the frames of the bases to those of what holds the tips, shape (instance_count, rod, 3, 3).
    """

    inputs: FloatArray
    unknowns: FloatArray
    residual: FloatArray
    gamma: FloatArray
    turned: FloatArray


class State:
    """Bodies and ends of rods of all instances at their unknowns and inputs, for what is asked once; axes (instance, rod, ...).

    Attributes:
        angles: Of the joints at bases, then at tips [rad], shape (instance, rod, 3).
    """

    def __init__(self, problem: "NetworkProblem") -> None:
        own = problem
        x = own.read("unknowns")
        self.inputs = own.read("inputs")
        self.level = own.level()
        self.frames = own.frames()
        length = own.length[:, : own.rod_count]
        padded = np.concatenate([x, np.zeros((len(x), 1))], axis=1)
        self.angles = [length[..., None] * padded[:, own.places[:, at]] for at in own.layout.angles_at]
        if own.graph.driven:  # (24)
            driven = own.graph.driven_angles(self.take(own, "angle"))
            self.angles = [free + given for free, given in zip(self.angles, driven, strict=True)]
        left = (1 - own.load_factor.numpy())[:, None, None]
        arms = own.attachments[0][0], own.attachments[1][0] + left * own.shift  # (29)
        self.ends = [
            Holding(self.frames, end.frame, (arms[k], own.attachments[k][1]), end.table.at(self.angles[k]))
            for k, end in enumerate(own.graph.ends)
        ]

    def take(self, problem: "NetworkProblem", name: str) -> FloatArray:
        """An input, shape (instance, size)."""
        return np.asarray(self.inputs[..., problem.input_slice(name)])


class NetworkProblem(BoundaryProblem):
    """Rods joined to bodies and the ground.

    Unknowns are, rod by rod, moment and force at its base, then the angles of the joints at its base and its tip; then where
    rods are in holes; then the pose of each body. Residuals in the same order: what joins the tip, or is free there, torques of
    joints, what slides, balances of bodies. Of a rod that slides through holes, each piece is a rod.

    Args:
        graph: The network.
        end_effector: Number of the body, or, after the bodies, of the rod among those whose tips nothing holds.
        inputs: The inputs.
        integrator, device, pose_sensitivities, direction_count, lengths, enabled: As for ``Assembly.problem``.
        pieces: Of each rod; of more than one, there are clamps between them, whose moments are the directions.
    """

    guess_integrations: int = 1

    def __init__(
        self,
        graph: Graph,
        end_effector: int,
        inputs: Inputs,
        *,
        integrator: Integrator,
        device: str = "cpu",
        pose_sensitivities: bool = False,
        direction_count: int = 0,
        lengths: bool = False,
        enabled: Sequence[str] = (),
        pieces: int = 1,
    ) -> None:
        self.graph, self.end_effector, self.pieces = graph, end_effector, pieces
        self.rod_count, self.body_count = len(graph.rods), len(graph.bodies)
        if pieces > 1:
            direction_count = 3 * (pieces - 1) * self.rod_count
        self.entries = entries = graph.entries
        self.places, self.first_hole, self.first_pose, n = entries.variables, entries.first_hole, entries.first_pose, entries.size
        self._slices = input_places(
            int(graph.first_tube[-1]),
            len(graph.load_places),
            len(graph.whole),
            sum(graph.driven.values()),
            [name for own in graph.drives for name in own],
        )
        super().__init__(
            unknown_count=n,
            batch_shape=np.broadcast_shapes(inputs.batch_shape, graph.batch_shape),
            input_count=max(place.stop for place in self._slices.values()),
            blocks=_blocks(graph, self.places, self.first_hole, n),
            direction_count=direction_count,
            pose_sensitivities=pose_sensitivities,
            device=device,
            elimination=entries.elimination if wp.get_device(device).is_cpu else None,
        )
        self.arrow = entries.arrow
        self.integrator = integrator
        self.inputs_given = inputs
        self.options: dict[str, Any] = {
            "device": device,
            "pose_sensitivities": pose_sensitivities,
            "direction_count": direction_count,
            "enabled": tuple(enabled),
        }
        options = {
            "integrator": integrator,
            "device": device,
            "lengths": lengths,
            "enabled": along(inputs, enabled),
        }
        count, shape = self.instance_count, self.batch_shape
        self.layout = graph.layout
        drives = self._slices[ALONG[-1]].stop
        together = builds(graph, bool(options["enabled"]), width(integrator.precision, device))
        self.groups = [RodGroup(graph, members, shape, direction_count, drives, options, pieces) for members in together]
        self.rounding = self.groups[0].backbones.rounding
        size = self.rod_count + self.body_count
        scales = [np.broadcast_to(scale.reshape(*graph.batch_shape, size), (*shape, size)) for scale in graph.scales()]
        self.length, self.stiffness = (scale.reshape(count, size) for scale in scales)
        self.attachments = graph.attachments(count, shape)
        self.reference = graph.reference(self.length[:, : self.rod_count], shape)
        self.networks = self._make_networks()
        # of the path from the network taken apart, as NumPy sees what the kernels read
        own = self.networks
        self.opening, self.soft, self.shift, self.loading = (
            array.numpy() for array in (own.opening, own.soft, own.shift, own.loading)
        )
        self.loading[:] = int(Loading.RISING)
        self._launches = self._record()
        self._found: Apart | None = None
        self.write("inputs", self.pack(inputs))

    def _make_networks(self) -> Any:
        graph, entries, layout, device, count = self.graph, self.entries, self.layout, self.device, self.instance_count
        rods, bodies, d = self.rod_count, self.body_count, self.direction_count
        own: Any = records.Networks()
        own.rod_count, own.body_count, own.unknown_count, own.direction_count = rods, bodies, self.unknown_count, d
        own.first_pose, own.own, own.size, own.holes = self.first_pose, layout.own, layout.size, int(layout.holes)
        own.width = layout.size + d + layout.holes
        own.height = layout.size + records.MORE + max(map(len, graph.drives)) + max(rod.rod_count for rod in graph.rods) - 1
        own.effector = self.end_effector + 1 if self.end_effector < bodies else 0
        own.effector_rod = -1 if own.effector else int(graph.free[self.end_effector - bodies]) if len(graph.free) else -1
        names = ("order", "active", "load_factor", "unknowns", "inputs", "directions", "fault", "step_count", "residual")
        self.share(own, (*names, "residual_directions", "position", "rotation", "pose_columns"))
        own.numbers = self._field("gamma", (entries.count,))
        own.rotation_at, own.translation_at = (self._slices[name].start for name in PER_ROD)
        own.force_at, own.moment_at = (self._slices[name].start for name in LOADED)
        own.follower_force_at, own.follower_moment_at = (self._slices[name].start for name in FOLLOWING)
        own.along_at = self._slices[ALONG[0]].start
        own.rod_at, own.rods_given = self._slices[next(iter(ON_RODS))].start, len(graph.whole)

        def array(values: Any, dtype: Any = wp.float64) -> Any:
            kind = np.int32 if dtype is wp.int32 else np.float64
            return wp.array(np.ascontiguousarray(values, dtype=kind), dtype=dtype, device=device)

        def zeros(*shape: int, dtype: Any = wp.float64) -> Any:
            return wp.zeros(shape, dtype=dtype, device=device)

        tables = [end.table for end in graph.ends]
        own.holder = array([end.frame for end in graph.ends], wp.int32)
        own.attachment_position = array(np.stack([at[0] for at in self.attachments], axis=1), wp.vec3d)
        own.attachment_rotation = array(np.stack([at[1] for at in self.attachments], axis=1), wp.mat33d)
        own.count = array([table.count for table in tables], wp.int32)
        own.inner, own.outer = (array([getattr(table, name) for table in tables], wp.mat33d) for name in ("inner", "outer"))
        own.spring, own.rest = (array([getattr(table, name) for table in tables], wp.vec3d) for name in ("stiffness", "rest"))
        first = self._slices["angle"].start if graph.driven else 0
        own.driven = array([np.where(at < 0, -1, first + at) for at in graph.driven_at], wp.int32)
        own.variable = array(entries.variables, wp.int32)
        places = np.full(rods, -1)
        places[graph.free] = bodies + np.arange(len(graph.free))
        own.load_place = array(places, wp.int32)
        own.length, own.stiffness = array(self.length), array(self.stiffness)
        slides = graph.slides
        own.owner, own.pieces = array(graph.first_tube[slides.owner], wp.int32), array(slides.pieces, wp.int32)
        own.whole = array(slides.owner, wp.int32)
        own.share, own.shared = array(slides.share), array(slides.shared, wp.int32)
        sections = [arrays.repeated(self.batch_shape) for arrays in graph.arrays]
        own.softness = array(np.stack([a.material[:, 0, 0, 3:9] for a in sections], axis=1))
        own.at_rest = array(np.stack([a.precurvature[:, 0, 0, :3] for a in sections], axis=1), wp.vec3d)
        own.reference_position, own.reference_rotation = (
            array(values, dtype) for values, dtype in zip(self.reference, (wp.vec3d, wp.mat33d), strict=True)
        )
        own.mass, own.mass_centre = array(graph.mass), array(graph.mass_centre, wp.vec3d)
        own.pulled_out = wp.zeros(count, dtype=wp.int32, device=device)
        own.opening, own.soft = zeros(count, self.unknown_count), zeros(count)
        own.shift, own.loading = zeros(count, rods, dtype=wp.vec3d), zeros(count, dtype=wp.int32)
        still = np.broadcast_to(np.eye(3), (count, bodies + 1, 3, 3))
        own.body_position, own.body_rotation = zeros(count, bodies + 1, dtype=wp.vec3d), array(still, wp.mat33d)
        own.body_turns = zeros(count, bodies + 1, dtype=wp.mat33d)
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
        own.number_rod = array(of_rod, wp.int32)
        own.number_row, own.number_column = (array(values, wp.int32) for values in np.divmod(within, layout.size))
        own.turn_place = array(entries.turns, wp.int32)
        return own

    def _record(self) -> list[Any]:
        """Launches of one evaluation, in order: the first, three of each build, and the last."""

        def recorded(kernel: Any, dim: int, *arguments: Any) -> Any:
            return record(lambda: kernel, dim, arguments, self.device)

        launches = [recorded(kernels.stand, self.instance_count, self.networks)]
        for group in self.groups:
            dim = group.backbones.instance_count
            launches.append(recorded(kernels.hand_over, dim, self.networks, group.table))
            launches.append(group.backbones.launch)
            launches.append(recorded(form, dim, self.networks, group.table))
        launches.append(recorded(kernels.add_up, self.instance_count, self.networks))
        return launches

    # ---- what is offered ----

    @property
    def shapes(self) -> NetworkShapes:  # noqa: D102
        return NetworkShapes(self)

    @property
    def stability(self) -> NetworkStability:  # noqa: D102
        return NetworkStability(self)

    @property
    def lines(self) -> NetworkLines:  # noqa: D102
        return NetworkLines(self)

    @property
    def result_test(self) -> ResultTest | None:  # noqa: D102
        between_discs = any(group.backbones.features.discs and group.backbones.features.condition_count for group in self.groups)
        return LineTest(self.lines) if between_discs else None

    @property
    def held_forces(self) -> NDArray[np.intp]:  # noqa: D102
        return self._forces(np.flatnonzero(self.graph.ends[1].held))

    def undetermined(self) -> NDArray[np.bool_]:
        """(32) Told where gaps are closed: taken apart, rods may be straight that are not together."""
        held = self.graph.ends[1].held
        gaps = self.read("residual")[:, self.places[held, GAP_AT].reshape(-1)] * np.repeat(
            self.length[:, : self.rod_count][:, held], 3, axis=1
        )
        return np.asarray(super().undetermined() & (np.abs(gaps).max(axis=1, initial=0.0) < CLOSED))

    def loose(self) -> list[str]:
        """(33) Told by the network taken apart and unloaded, whose rods give way along themselves."""
        names, gamma = [""] * self.instance_count, self.apart().gamma
        rods = np.concatenate([self.places[k, :own] for k, own in enumerate(self.graph.own.tolist())])
        for k in np.flatnonzero(np.isfinite(gamma).all(axis=1)).tolist() if self.body_count else ():
            _, sizes, ways = np.linalg.svd(self.entries.dense(gamma[k]))
            neutral = ways[sizes < NOTHING * sizes[0]]
            if len(neutral) and np.abs(neutral[:, rods]).max() < ALONE:
                moves = neutral[:, self.first_pose :].reshape(len(neutral), self.body_count, POSE).copy()
                moves[..., :3] *= self.length[k, None, self.rod_count :, None]
                names[k] = self.graph.bodies[int(np.linalg.norm(moves, axis=(0, 2)).argmax())].name
        return names

    def _forces(self, rods: NDArray[np.intp]) -> NDArray[np.intp]:
        """Unknowns that are forces at the bases of some rods."""
        return np.asarray(self.places[rods[:, None], self.graph.along[rods, None] + np.arange(-2, 1)].reshape(-1))

    @property
    def kinks(self) -> NDArray[np.intp]:  # noqa: D102
        own = [self.places[rod, group.backbones.kinks] for group in self.groups for rod in group.members.tolist()]
        return np.sort(np.concatenate(own))

    @property
    def segments_refused(self) -> str:  # noqa: D102
        return "it is a network, whose rods are not cut into segments yet: take Shooting, Observer or EnergyDescent"

    @property
    def parts(self) -> NetworkParts:  # noqa: D102
        return NetworkParts(self)

    @property
    def starts(self) -> NetworkStarts:  # noqa: D102
        return NetworkStarts(self)

    @property
    def joints(self) -> NetworkJoints:  # noqa: D102
        return NetworkJoints(self)

    @cached_property
    def form_rows(self) -> FormRows:
        """Where what is free stands in the second variation."""
        return FormRows(self)

    @cached_property
    def conjugates(self) -> NetworkConjugates | None:  # noqa: D102
        return NetworkConjugates(self) if self.pose_sensitivities else None

    @cached_property
    def clamps(self) -> NetworkClamps | None:  # noqa: D102
        return NetworkClamps(self) if self.pieces > 1 else None

    # ---- the interface ----

    def input_slice(self, name: str) -> slice:  # noqa: D102
        return self._slices[name]

    def takes(self, name: str) -> bool:  # noqa: D102
        name = ON_RODS.get(name, name)
        return name not in ALONG or all(group.backbones.takes(name) for group in self.groups)

    def _pass_over(self, instances: IntArray | None) -> None:
        super()._pass_over(instances)
        first, *of_groups, last = self._launches
        for k, group in enumerate(self.groups):
            group.pass_over(None if instances is None else np.asarray(instances))
            for launch in of_groups[3 * k : 3 * k + 3 : 2]:
                launch.set_dim(group.backbones.listed)
        for launch in (first, last):
            launch.set_dim(self.listed)

    def renew(self, inputs: Inputs) -> bool:  # noqa: D102
        self._clear()
        self.__dict__.pop("conjugates", None)
        for group in self.groups:
            group.backbones._clear()
        self.opening[:], self.soft[:], self.shift[:] = 0.0, 0.0, 0.0
        self.loading[:] = int(Loading.RISING)
        self._found, self.inputs_given = None, inputs
        self.write("inputs", self.pack(inputs))
        return True

    def level(self) -> FloatArray:
        """What multiplies the loads of each instance, shape (instance_count,)."""
        factor = self.load_factor.numpy()
        return np.where(self.loading == int(Loading.NONE), 0.0, np.where(self.loading == int(Loading.FULL), 1.0, factor))

    @cached_property
    def launches(self) -> tuple[Any, ...] | None:
        """Where the rods of each build are one launch, and ``Gamma`` is not eliminated along the graph, which is SciPy's."""
        if self._host is None or self.elimination is not None:
            return None
        result: list[Any] = []
        for k, group in enumerate(self.groups):
            own = group.backbones.launches
            if own is None:
                return None
            result += [self._launches[3 * k + 1], *own, self._launches[3 * k + 3]]
        return (self._launches[0], *result, self._launches[-1])

    def _integrate(self) -> None:
        self.integrate_by(self._launches)

    def integrate_by(self, launches: Sequence[Any]) -> None:
        """Integrate by some of the launches, or by what stands in the place of them, in order."""
        for group in self.groups:
            group.backbones.stop = self.stop
        self._launch(launches)

    def _launch(self, launches: Sequence[Any]) -> None:
        """Some of the launches, in order."""
        if self._host is None:
            own = self.networks
            for name in ("opening", "soft", "shift", "loading"):
                getattr(own, name).assign(getattr(self, name))
        for launch in launches:
            launch.launch()
        if launches[-1] is self._launches[-1] and self.elimination is not None and "gamma" in vars(self):  # asked for whole
            numbers = self.numbers_of_gamma(np.arange(self.instance_count))
            self.gamma.assign(self.entries.dense(numbers))

    def hand_over(self) -> None:
        """Unknowns and inputs of all instances to their rods, without an integration."""
        with self.everyone():
            self._launch([self._launches[0], *self._launches[1:-1:3]])

    def integrate_rods(self) -> None:
        """Integrate the rods of all instances at their unknowns; nothing that solvers read is changed."""
        with self.everyone():
            self.integrate_by(self._launches[:-1])

    def _assemble(self) -> None:
        """(5) to (12) Residual, ``Gamma``, columns and pose of all instances, their rods integrated."""
        self._launch([self._launches[0], *self._launches[3:-1:3], self._launches[-1]])

    def reference_state(self) -> State:
        """All instances where the poses of bodies are zero."""
        kept = self.read("unknowns")
        at_zero = kept.copy()
        at_zero[:, self.first_pose :] = 0.0
        self.write("unknowns", at_zero)
        state = self.state()
        self.write("unknowns", kept)
        return state

    def forces(self, state: State) -> tuple[FloatArray, FloatArray]:
        """Dead forces on bodies and tips, and weights of bodies, shapes (instance, place, 3), (instance, body, 3)."""
        level = state.level[:, None, None]
        weight = level * self.graph.mass[:, None] * state.take(self, "gravity")[:, None]
        return level * self._on_places(state, LOADED[0]), weight

    def _on_places(self, state: State, name: str) -> FloatArray:
        """What acts on bodies and tips, shape (instance, place, 3)."""
        values = state.take(self, name)
        return values.reshape(*values.shape[:-1], len(self.graph.load_places), 3)

    def reasons(self, status: NDArray[np.int32]) -> NDArray[np.int32]:
        """As said; where a rod was pulled out of a hole on the way, since this was asked last, that was no number."""
        known, pulled_out = super().reasons(status), np.array(self.networks.pulled_out.numpy(), dtype=bool)
        self.networks.pulled_out.zero_()
        return np.where(pulled_out & (known == Status.NONFINITE), Status.OUT_OF_HOLE, known).astype(np.int32)

    def along(self, names: Sequence[str], rod: int, places: FloatArray) -> dict[str, FloatArray]:  # noqa: D102
        return columns_along(self, names, rod, places)

    def sensing(self, places: FloatArray) -> NetworkSensing:  # noqa: D102
        return NetworkSensing(self, places, self._launches)

    def sensed(self, made: NetworkSensing, names: Sequence[str], rod: int) -> tuple[FloatArray, FloatArray]:  # noqa: D102
        return made.curvature(names, rod)

    # ---- bodies ----

    def frames(self) -> Frames:
        """(4) The ground and the bodies at ``unknowns``."""
        with self.everyone():
            self._launch(self._launches[:1])
        own = self.networks
        position, rotation, turns = (np.array(array.numpy()) for array in (own.body_position, own.body_rotation, own.body_turns))
        return Frames(position, rotation, turns, self.reference[1])

    def pose_unknowns(self, position: FloatArray, rotation: FloatArray) -> FloatArray:
        """(4) The unknowns (instance_count, 6 body_count) at poses (instance_count, body, ...)."""
        L = self.length[:, self.rod_count :, None]
        reference_position, reference = self.reference
        back = np.swapaxes(reference, -1, -2)
        move = np.einsum("bkij,bkj->bki", back, position - reference_position) / L**2
        turn = vectors((back @ rotation).reshape(-1, 3, 3)).reshape(position.shape) / L
        return np.asarray(np.concatenate([move, turn], axis=-1).reshape(self.instance_count, -1))

    def body_poses(self) -> tuple[FloatArray, FloatArray]:
        """Position (instance_count, body, 3) and rotation (instance_count, body, 3, 3) at ``unknowns``."""
        frames = self.frames()
        return frames.position[:, 1:], frames.rotation[:, 1:]

    # ---- where the search begins ----

    def guess(self) -> FloatArray:
        """Rods at rest, and bodies where they fit them best (``docs/networks.md``, 13).

        What the residual is there is remembered and closes as ``load_factor`` goes from 0 to 1, (12).
        """
        apart = self.apart()
        held = np.flatnonzero(self.graph.ends[1].held)
        gaps, residual = self.places[held, GAP_AT], np.array(apart.residual)
        # (29) in the frames of what holds the tips
        gap = self.length[:, held, None] ** 2 * residual[:, gaps]
        self.shift[:, held] = (apart.turned[:, held] @ gap[..., None])[..., 0]
        residual[:, gaps] = 0.0
        self.open_at(apart.unknowns, residual)
        return np.array(apart.unknowns)

    def open_at(self, unknowns: FloatArray, residual: FloatArray) -> None:
        """Make ``unknowns`` an equilibrium where ``load_factor`` is 0, by the residual there.

        Ends of rods give way on the way only where no rod carries a force yet.
        """
        forces = unknowns[:, self._forces(np.arange(self.rod_count))]
        self.opening[:], self.soft[:] = residual, (np.abs(forces).max(axis=1) < AT_REST * self.curvature_scale())

    @property
    def natural_singular_value(self) -> FloatArray:
        """That at ``guess``, 1 at most."""
        gamma, least, own = self.apart().gamma, np.ones(self.instance_count), self.entries
        for k in np.flatnonzero(np.isfinite(gamma).all(axis=1)).tolist():
            if own.elimination is not None:
                least[k] = own.elimination.least_singular_value(gamma[k])
            else:
                least[k] = np.linalg.svd(own.dense(gamma[k]), compute_uv=False)[-1]
        return np.minimum(least, 1.0)

    def apart(self) -> Apart:
        """The network taken apart at the present inputs; found once for all who ask."""
        inputs = self.read("inputs")[:, : self.input_slice(LOADED[0]).start]
        if self._found is None or not np.array_equal(self._found.inputs, inputs):
            with self.unloaded(), np.errstate(all="ignore"):
                x = np.zeros((self.instance_count, self.unknown_count))
                for group in self.groups:
                    own = group.backbones.guess().reshape(self.instance_count, len(group.members), -1)
                    x[:, self.places[group.members][:, : own.shape[2]]] = own
                for at, end in zip(self.layout.angles_at, self.graph.ends, strict=True):
                    self._set_angles(x, at, np.broadcast_to(end.table.rest, (self.instance_count, *end.table.rest.shape)))
                self.write("unknowns", x)
                self.soft[:] = 1.0
                self.integrate()
                self._place(x)
                self.write("unknowns", x)
                self._assemble()
                gamma, (base, tip) = np.array(self.numbers()), self.state().ends
                turned = self.attachments[1][1] @ np.swapaxes(tip.frame, -1, -2) @ base.rotation
                self._found = Apart(inputs, x, self.read("residual"), gamma, turned)
        return self._found

    def state(self) -> State:
        """Of all instances."""
        return State(self)

    def numbers(self) -> FloatArray:
        """What is kept of ``Gamma``, shape (instance_count, k)."""
        return self.read("gamma") if self.elimination is None else self.numbers_of_gamma(np.arange(self.instance_count))

    def newton_step(self, numbers: FloatArray, residual: FloatArray) -> FloatArray:
        """Newton's step [1/m] by the ``numbers`` that are kept of ``Gamma``, (instance_count, k), shape (instance_count, n); NaN
        where ``Gamma`` is singular."""
        result = np.full(residual.shape, np.nan)
        for k in np.flatnonzero(np.isfinite(residual).all(axis=1) & np.isfinite(numbers).all(axis=1)).tolist():
            if self.elimination is not None:
                result[k] = -self.elimination.solved(numbers[k], residual[k])
                continue
            try:
                result[k] = -np.linalg.solve(self.entries.dense(numbers[k]), residual[k])
            except np.linalg.LinAlgError:
                continue
        return result

    def twisted(self, x: FloatArray, numbers: IntArray) -> FloatArray:
        """Unknowns with the tubes of rods turned against each other, as ``models.backbone.starts.twisted`` has it; where nothing
        holds their tip they are bent too."""
        members = [(group.backbones, group.members.tolist()) for group in self.groups]
        return twisted(members, x, numbers, lambda rod: self.places[rod], self.graph.free.tolist())

    def _set_angles(self, x: FloatArray, at: slice, angles: FloatArray) -> None:
        """Angles (instance_count, rod, 3) as unknowns."""
        places = self.places[:, at]
        rods, which = np.nonzero(places >= 0)
        x[:, places[rods, which]] = angles[:, rods, which] / self.length[:, rods]

    def _place(self, x: FloatArray) -> None:
        """(13) Bodies by the rods as they were integrated, and the angles of joints at tips by both."""
        shape = (self.instance_count, self.rod_count)
        tip, turn = np.zeros((*shape, 3)), np.zeros((*shape, 3, 3))
        for group in self.groups:
            tip[:, group.members], turn[:, group.members] = group.tips()
        driven = self.read("inputs")[:, self.input_slice("angle")] if self.graph.driven else None
        placing = self.graph.placing(self.instance_count, self.batch_shape, driven)
        position, rotation = placed(placing, tip, turn)
        x[:, self.first_pose :] = self.pose_unknowns(position[:, 1:], rotation[:, 1:])
        self.write("unknowns", x)
        base, end = self.state().ends
        turned = np.swapaxes(end.frame, -1, -2) @ base.rotation @ turn
        self._set_angles(x, self.layout.angles_at[1], self.graph.ends[1].table.fitted(turned))

    @contextmanager
    def unloaded(self) -> Iterator[None]:
        """Within it, all instances may be evaluated without loads; everything is as it was afterwards."""
        kept = (self.fault, self.step_count, self.residual_directions, self.pose_columns)
        values = [np.array(array.numpy()) for array in kept]
        records = self.snapshot()
        own = [np.array(values) for values in (self.opening, self.soft, self.loading, self.shift)]
        self.opening[:], self.soft[:], self.loading[:], self.shift[:] = 0.0, 0.0, int(Loading.NONE), 0.0
        try:
            with self.everyone(), self.at_load(0.0):
                yield
        finally:
            self.restore(records)
            for array, before in zip(kept, values, strict=True):
                array.assign(before)
            self.opening[:], self.soft[:], self.loading[:], self.shift[:] = own

    def curvature_scale(self) -> FloatArray:  # noqa: D102
        own = [group.backbones.curvature_scale().reshape(self.instance_count, -1) for group in self.groups]
        return np.asarray(np.concatenate(own, axis=1).max(axis=1))

    def load_scale(self) -> FloatArray:
        """What acts on rods, bodies and tips, and how far tips are from where they are to be: a turn is a moment in ``EI/L``."""
        self.hand_over()
        own = [group.backbones.load_scale().reshape(self.instance_count, -1).max(axis=1) for group in self.groups]
        total = np.sum(own, axis=0)
        inputs, L, EI = self.read("inputs"), self.length, self.stiffness
        rods = [*range(self.rod_count, self.rod_count + self.body_count), *self.graph.free]  # scales of what loads act on
        for name, power in zip((*LOADED, *FOLLOWING), (2, 1, 2, 1), strict=True):
            size = np.linalg.norm(inputs[:, self.input_slice(name)].reshape(self.instance_count, -1, 3), axis=2)
            total += (size * L[:, rods] ** power / EI[:, rods]).sum(axis=1)
        gravity = np.linalg.norm(inputs[:, self.input_slice("gravity")], axis=1)
        bodies = slice(self.rod_count, None)
        total += gravity * (self.graph.mass * L[:, bodies] ** 2 / EI[:, bodies]).sum(axis=1)
        held = self.graph.ends[1].held
        if held.any():
            gap = self.apart().residual[:, self.places[held, :6]] * L[:, : self.rod_count][:, held, None]
            total += (GAP_LOAD * np.linalg.norm(gap[..., :3], axis=2) + np.linalg.norm(gap[..., 3:], axis=2)).max(axis=1)
        return np.asarray(total)


PER_ROD = ("rotation", "translation")
LOADED = ("force", "moment")  # of bodies and tips
FOLLOWING = ("follower_force", "follower_moment")  # of the same, in their frames


def input_places(rod_count: int, load_places: int, rods_given: int, angles: int, drives: Sequence[str] = ()) -> dict[str, slice]:
    """Where each input stands in a row; those before ``LOADED`` are no loads, and what drives lines, ``drives``, is last."""
    sizes = {name: rod_count for name in PER_ROD} | ({"angle": angles} if angles else {})
    sizes |= {name: 3 * load_places for name in (*LOADED, *FOLLOWING)}
    sizes |= dict.fromkeys(ON_RODS, 3 * rods_given) | dict.fromkeys(ALONG, 3)
    ends = np.cumsum([0, *sizes.values()]).tolist()
    return {name: slice(ends[k], ends[k + 1]) for k, name in enumerate(sizes)} | drive_slices(drives, ends[-1])


def _blocks(graph: Graph, places: NDArray[np.intp], first: int, n: int) -> list[Block]:
    """One block a rod, then one of all bodies and of the holes through which rods slide.

    A straight inextensible rod does not answer a force along itself: where its tip is held, that force and the gap along the base
    stand with the bodies, and what is left of each rod is regular by itself.
    """
    blocks: list[Block] = []
    forces: list[int] = []
    gaps: list[int] = []
    held, slides = graph.ends[1].held, graph.slides
    turns: list[int] = []  # of holes: they belong to two pieces
    for k, name in enumerate(graph.names):
        own = places[k][: graph.layout.poses_at[0].start].copy()
        if slides.shared[k]:
            own[graph.layout.angles_at[0]] = -1
        if slides.upper[k] >= 0:
            turns += [place for place in own[graph.layout.angles_at[1]].tolist() if place >= 0]
            own[graph.layout.angles_at[1]] = -1
        own = own[own >= 0]
        force, gap = int(places[k, graph.along[k]]), int(places[k, GAP_AT.stop - 1])
        rod = int(slides.owner[k])
        if held[k] and first < n:
            blocks.append(Block(name, own[own != force], own[own != gap], rod))
            forces, gaps = [*forces, force], [*gaps, gap]
        else:
            blocks.append(Block(name, own, own, rod))
    if first < n:
        rest = [*turns, *range(first, n)]
        unknowns, residuals = (np.array([*along, *rest], dtype=np.intp) for along in (forces, gaps))
        blocks.append(Block("bodies", unknowns, residuals))
    return blocks
