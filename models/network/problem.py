"""Rods and bodies in a graph: the boundary problem.

Numbers in parentheses are those of ``docs/networks.md``. Each rod is integrated in the frame of its base by the backbone kernels;
what its ends say of the bodies is an element (``elements.py``), and residual and ``Gamma`` are the sums of the elements. They are
put together by NumPy; ``entries.py`` says where they stand, and how ``Gamma`` is eliminated along the graph.
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
from multirod.capabilities import Loading
from multirod.inputs import Inputs
from multirod.integrators import Integrator
from multirod.models.network.capabilities import NetworkJoints, NetworkParts, NetworkShapes, NetworkStarts
from multirod.models.network.clamps import NetworkClamps
from multirod.models.network.conjugates import NetworkConjugates
from multirod.models.network.elements import (
    ANGLES_AT,
    GAP_AT,
    OWN,
    OWN_AT,
    POSE,
    POSES_AT,
    SIZE,
    Equations,
    Frames,
    Holding,
    Integrated,
)
from multirod.models.network.entries import Sums
from multirod.models.network.graph import GROUND, Graph
from multirod.models.network.groups import ALONG, RodGroup, builds, put
from multirod.models.network.placing import placed
from multirod.models.network.sliding import Sliding
from multirod.models.network.stability import NetworkStability
from multirod.problem import Block, BoundaryProblem
from multirod.rotations import cross, cross_matrix, left_jacobian, matrices, vectors
from multirod.status import Fault, Status
from multirod.validation import FloatArray

SOFT = 0.01  # L^3/EI by which rods give way along themselves while the network is put together
GAP_LOAD = 12.0  # EI/L^3: what a rod resists with where its tip is moved across


@dataclass(frozen=True)
class Apart:
    """The network taken apart, at certain inputs.

    Attributes:
        inputs: Those that are no loads on bodies, (instance_count, k).
        unknowns: [1/m], shape (instance_count, n).
        residual: There, without loads [1/m], shape (instance_count, n).
        gamma: The numbers of ``Gamma`` there that are kept, shape (instance_count, k).
    """

    inputs: FloatArray
    unknowns: FloatArray
    residual: FloatArray
    gamma: FloatArray


class State:
    """Bodies and ends of rods of some instances at their unknowns and inputs; axes (instance, rod, ...).

    Attributes:
        angles: Of the joints at bases, then at tips [rad], shape (instance, rod, 3).
        rates: How those that are driven change along directions, shape (instance, rod, 3, direction_count).
        rotation, translation: Of the pieces of rods, shape (instance, rod).
        rotation_directions, translation_directions: How they change, shape (instance, direction, rod).
        short: Where a piece has no length: a rod is pulled out of a hole, shape (instance,).
    """

    def __init__(self, problem: "NetworkProblem", rows: IntArray) -> None:
        own = problem
        self.rows = rows
        self.x = own.read("unknowns")[rows]
        self.inputs = own.read("inputs")[rows]
        self.directions = own.directions.numpy()[rows][:, : own.direction_count]
        self.load_factor = own.load_factor.numpy()[rows]
        self.level = own.level()[rows]
        self.frames = own.frames(self.x[:, own.first_pose :].reshape(len(rows), -1, POSE), rows)
        length = own.length[rows, : own.rod_count]
        padded = np.concatenate([self.x, np.zeros((len(rows), 1))], axis=1)
        self.own = padded[:, own.places[:, OWN_AT]]
        slides = own.graph.slides
        self.rotation, self.rotation_directions = (
            np.where(slides.first, self.take(own, "rotation", along)[..., slides.owner], 0.0) for along in (False, True)
        )
        self.translation = self.take(own, "translation")
        self.translation_directions = self.take(own, "translation", True)
        self.short = np.zeros(len(rows), dtype=bool)
        if own.sliding:
            given, ways = self.translation, self.translation_directions
            self.translation = own.sliding.translations(self.x[:, own.first_hole : own.first_pose], given, rows)
            self.translation_directions = slides.share * ways[..., slides.owner]
            short = self.translation <= -length
            self.translation[short] = 0.0
            self.short = np.asarray(short.any(axis=1))
        self.angles = [length[..., None] * padded[:, own.places[:, at]] for at in ANGLES_AT]
        self.rates: list[FloatArray] = []
        if own.graph.driven:  # (24)
            driven = own.graph.driven_angles(self.take(own, "angle"))
            self.angles = [free + given for free, given in zip(self.angles, driven, strict=True)]
            self.rates = [np.moveaxis(way, 1, -1) for way in own.graph.driven_angles(self.take(own, "angle", True))]
        self.ends = [
            Holding(
                self.frames,
                end.frame,
                (own.attachments[k][0][rows], own.attachments[k][1][rows]),
                end.table.at(self.angles[k]),
                length,
            )
            for k, end in enumerate(own.graph.ends)
        ]

    def take(self, problem: "NetworkProblem", name: str, directions: bool = False) -> FloatArray:
        """An input, shape (instance, size), or its share in the directions, (instance, direction_count, size)."""
        source = self.directions if directions else self.inputs
        return np.asarray(source[..., problem.input_slice(name)])


class NetworkProblem(BoundaryProblem):
    """Rods joined to bodies and the ground.

    Unknowns are, rod by rod, moment and force at its base, then the angles of the joints at its base and its tip; then where
    rods are in holes; then the pose of each body. Residuals in the same order: what joins the tip, or is free there, torques of
    joints, what slides, balances of bodies. Of a rod that slides through holes, each piece is a rod.

    Args:
        graph: The network.
        end_effector: Number of the body, or, after the bodies, of the rod among those whose tips nothing holds.
        inputs: The inputs.
        integrator, device, pose_sensitivities, direction_count, enabled: As for ``Assembly.problem``.
        pieces: Of each rod; of more than one, there are clamps between them, whose moments are the directions.
    """

    guess_integrations = 1

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
        enabled: Sequence[str] = (),
        pieces: int = 1,
    ) -> None:
        self.graph, self.end_effector, self.pieces = graph, end_effector, pieces
        self.rod_count, self.body_count = len(graph.rods), len(graph.bodies)
        if pieces > 1:
            direction_count = 3 * (pieces - 1) * self.rod_count
        self.entries = entries = graph.entries
        self.places, self.first_hole, self.first_pose, n = entries.variables, entries.first_hole, entries.first_pose, entries.size
        self._slices = input_places(len(graph.whole), len(graph.load_places), sum(graph.driven.values()))
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
            "enabled": [name for name in ALONG if name in enabled or inputs.is_active(name)],
        }
        count, shape = self.instance_count, self.batch_shape
        self.groups = [RodGroup(graph, members, shape, direction_count, options, pieces) for members in builds(graph)]
        self.rounding = self.groups[0].backbones.rounding
        size = self.rod_count + self.body_count
        scales = [np.broadcast_to(scale.reshape(*graph.batch_shape, size), (*shape, size)) for scale in graph.scales()]
        self.length, self.stiffness = (scale.reshape(count, size) for scale in scales)
        self.sliding: Sliding | None = None
        if graph.slides.count:
            scales = [scale[:, : self.rod_count] for scale in (self.length, self.stiffness)]
            self.sliding = Sliding(graph, scales[0], scales[1], shape)
        self.attachments = graph.attachments(count, shape)
        self.reference = graph.reference(self.length[:, : self.rod_count], shape)
        self.opening = np.zeros((count, n))
        self.pulled_out = np.zeros(count, dtype=bool)
        self.opened_at = np.zeros((count, n))
        self.soft = np.zeros(count)
        self.loading = np.full(count, int(Loading.RISING))
        self._found: Apart | None = None
        self.seen: tuple[State, Equations] | None = None  # the last that were put together, with the columns of poses
        self.write("inputs", self.pack(inputs))

    # ---- what is offered ----

    @property
    def shapes(self) -> NetworkShapes:  # noqa: D102
        return NetworkShapes(self)

    @property
    def stability(self) -> NetworkStability:  # noqa: D102
        return NetworkStability(self)

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
    def conjugates(self) -> NetworkConjugates | None:  # noqa: D102
        return NetworkConjugates(self) if self.pose_sensitivities else None

    @cached_property
    def clamps(self) -> NetworkClamps | None:  # noqa: D102
        return NetworkClamps(self) if self.pieces > 1 else None

    # ---- the interface ----

    def input_slice(self, name: str) -> slice:  # noqa: D102
        return self._slices[name]

    def takes(self, name: str) -> bool:  # noqa: D102
        return name not in ALONG or all(group.backbones.takes(name) for group in self.groups)

    def focus(self, instances: IntArray | None = None) -> None:  # noqa: D102
        super().focus(instances)
        for group in self.groups:
            group.focus(None if instances is None else np.asarray(instances))

    def renew(self, inputs: Inputs) -> bool:  # noqa: D102
        self._clear()
        self.__dict__.pop("conjugates", None)
        for group in self.groups:
            group.backbones._clear()
        self.opening[:], self.opened_at[:], self.soft[:] = 0.0, 0.0, 0.0
        self.loading[:] = int(Loading.RISING)
        self._found, self.inputs_given = None, inputs
        self.write("inputs", self.pack(inputs))
        return True

    def level(self) -> FloatArray:
        """What multiplies the loads of each instance, shape (instance_count,)."""
        factor = self.load_factor.numpy()
        return np.where(self.loading == int(Loading.NONE), 0.0, np.where(self.loading == int(Loading.FULL), 1.0, factor))

    def _integrate(self) -> None:
        listed = self.order.numpy()[: self.listed]
        active = self.active.numpy()[listed] != 0
        for group in self.groups:
            group.leave_out(listed[~active])
        rows = listed[active]
        if not len(rows):
            return
        with np.errstate(all="ignore"):  # what is not finite is said by its fault
            state = self.hand_over(rows)
            for group in self.groups:
                group.backbones.stop = self.stop
                group.backbones.integrate()
            self._assemble(state)

    def hand_over(self, rows: IntArray) -> State:
        """Unknowns and inputs of the instances ``rows``, (k,), to their rods, without an integration."""
        state = State(self, rows)
        taken = {name: (state.take(self, name), state.take(self, name, True)) for name in ALONG}
        per_rod = [
            np.stack([state.rotation, state.translation], axis=-1),
            np.stack([state.rotation_directions, state.translation_directions], axis=-1),
        ]
        along = [np.stack([taken[name][k] for name in ALONG], axis=-2) for k in (0, 1)]
        to_base = np.swapaxes(state.ends[0].rotation, -1, -2)
        for group in self.groups:
            group.hand_over(
                rows,
                state.own,
                per_rod[0],
                along[0],
                np.swapaxes(per_rod[1], 1, 2),
                along[1],
                state.level,
                to_base,
            )
        return state

    def integrated(self, state: State) -> Integrated:
        """What the last integration says of all rods."""
        rates = np.swapaxes(state.rotation_directions, 1, 2)
        parts = [group.read(state.rows, state.rotation, rates) for group in self.groups]
        if len(parts) == 1:
            return parts[0]
        order = np.argsort(np.concatenate([group.members for group in self.groups]))
        return Integrated(*(np.concatenate(values, axis=1)[:, order] for values in zip(*map(_fields, parts), strict=True)))

    def _assemble(self, state: State) -> FloatArray:
        """(5) to (12) Residual, ``Gamma``, columns and pose of the instances of a state, their rods integrated; the numbers of
        ``Gamma`` that are kept, (k, count)."""
        rows, equations = state.rows, self.equations(state)
        if self.pose_sensitivities:
            self.seen = state, equations
        residual, gamma, directions = self.summed(state, equations)
        left = 1.0 - state.load_factor[:, None]
        self._soften(gamma, residual, state, left)
        residual -= left * self.opening[rows]
        residual[state.short] = np.nan
        self.pulled_out[rows] |= state.short
        position, rotation, columns = self._end_effector(state, equations)
        self._keep(rows, residual, gamma, directions, position, rotation, columns)
        return gamma

    def summed(self, state: State, equations: Equations) -> tuple[FloatArray, FloatArray, FloatArray]:
        """(5) to (11) Residual, the numbers of ``Gamma`` that are kept, and the derivative of the residual along directions, of
        the network put together."""
        count, d, sums = len(state.rows), self.direction_count, self.entries
        residual = sums.residual(equations.residual.reshape(count, -1))
        matrix, along = equations.columns[..., :SIZE], equations.columns[..., SIZE : SIZE + d]
        gamma = sums.gamma(np.ascontiguousarray(matrix).reshape(count, -1))
        directions = np.moveaxis(sums.residual(np.moveaxis(along.reshape(count, self.rod_count * SIZE, d), 1, 2)), 1, 2)
        self._add_loads(state, residual, gamma, directions)
        if self.sliding:
            self.sliding.add(equations, rows=state.rows, residual=residual, gamma=gamma, directions=directions)
        return residual, gamma, directions

    def of_loads(self, state: State) -> FloatArray:
        """(11) What dead loads on bodies add to their balances by how they turn, shape (instance, body, 6, 3)."""
        count = len(state.rows)
        residual, directions = np.zeros((count, self.unknown_count)), np.zeros((count, self.unknown_count, self.direction_count))
        gamma = np.zeros((count, self.entries.count))
        self._add_loads(state, residual, gamma, directions)
        return gamma[:, self.entries.turns]

    def integrated_state(self) -> State:
        """All instances at their unknowns, their rods integrated; nothing that solvers read is changed."""
        state = self.hand_over(np.arange(self.instance_count))
        for group in self.groups:
            group.backbones.integrate()
        return state

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

    def equations(self, state: State) -> Equations:
        """(5) to (11) The elements."""
        rods, rows, graph = self.integrated(state), state.rows, self.graph
        tables, holders = [end.table for end in graph.ends], [end.frame for end in graph.ends]
        length, stiffness = (scale[rows, : self.rod_count] for scale in (self.length, self.stiffness))
        equations = Equations(rods, state.ends, tables, state.angles, length, stiffness, graph.slides.shared)
        equations.join()
        if len(graph.free):
            level, loads = state.level[:, None, None], []
            for names in (LOADED, FOLLOWING):
                acting = [self._on_places(state, name)[:, self.body_count :] for name in names]
                changing = [self._on_places(state, name, True)[:, self.body_count :] for name in names]
                loads += [level * np.concatenate(acting, axis=-1), np.concatenate(changing, axis=-2)]
            equations.leave(graph.free, *loads)
        equations.turn()
        if self.body_count:
            equations.balance(state.frames, holders)
        equations.drive(state.rates)
        return equations

    def _on_places(self, state: State, name: str, directions: bool = False) -> FloatArray:
        """What acts on bodies and tips, shape (instance, place, 3), or (instance, place, 3, direction_count)."""
        values = state.take(self, name, directions)
        values = values.reshape(*values.shape[:-1], len(self.graph.load_places), 3)
        return np.moveaxis(values, 1, -1) if directions else values

    def _add_loads(self, state: State, residual: FloatArray, gamma: FloatArray, directions: FloatArray) -> None:
        """(11) What acts on the bodies."""
        if not self.body_count:
            return
        frames, count, bodies = state.frames, len(state.rows), slice(1, None)
        mass = self.graph.mass[:, None]
        level = state.level[:, None, None]
        force, moment = (level * self._on_places(state, name)[:, : self.body_count] for name in LOADED)
        weight = level * mass * state.take(self, "gravity")[:, None]
        centre = np.einsum("bkij,kj->bki", frames.rotation[:, bodies], self.graph.mass_centre)
        inward = np.swapaxes(frames.axes[:, bodies], -1, -2)
        pull, twist = frames.pull[:, bodies, :, None], frames.twist[:, bodies, :, None]

        def told(push: FloatArray, turn: FloatArray) -> FloatArray:
            """Columns of force and moment as rows of the balances."""
            both = np.concatenate([pull * (inward @ push), twist * (inward @ turn)], axis=-2)
            return np.asarray(both)

        own = slice(self.first_pose, None)
        residual[:, own] -= told((force + weight)[..., None], (moment + cross(centre, weight))[..., None]).reshape(count, -1)
        turn = frames.rotation[:, bodies]
        pushes, twists = (turn @ (level * self._on_places(state, name)[:, : self.body_count])[..., None] for name in FOLLOWING)
        residual[:, own] -= told(pushes, twists).reshape(count, -1)  # (28)
        by_turn = cross_matrix(weight) @ cross_matrix(centre) - cross_matrix(twists[..., 0])
        columns = told(-cross_matrix(pushes[..., 0]) @ frames.turns[:, bodies], by_turn @ frames.turns[:, bodies])
        gamma[:, self.entries.turns] -= columns
        by_load = [self._on_places(state, name, True)[:, : self.body_count] for name in (*LOADED, *FOLLOWING)]
        by_force, by_moment = by_load[0] + turn @ by_load[2], by_load[1] + turn @ by_load[3]
        heave = mass[:, None] * np.swapaxes(state.take(self, "gravity", True), 1, 2)[:, None]
        by_all = told(by_force + heave, by_moment + cross_matrix(centre) @ heave)
        directions[:, own] -= by_all.reshape(count, POSE * self.body_count, -1)

    def _soften(self, gamma: FloatArray, residual: FloatArray, state: State, left: FloatArray) -> None:
        """(12) Rods whose tips are held give way along themselves while the network is put together."""
        soft = SOFT * left * self.soft[state.rows, None]
        if not soft.any():
            return
        held = self.graph.ends[1].held
        row, unknown = (self.places[held, at] for at in (GAP_AT.stop - 1, OWN - 1))
        gamma[:, self.entries.yielding] += soft
        residual[:, row] += soft * (state.x[:, unknown] - self.opened_at[state.rows][:, unknown])

    def _end_effector(self, state: State, equations: Equations) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Its position, rotation, and their columns by unknowns, then along directions."""
        frames, k, d = state.frames, self.end_effector, self.direction_count
        columns = np.zeros((len(state.rows), 6, self.unknown_count + d))
        if k < self.body_count:
            at = self.first_pose + POSE * k
            columns[:, :3, at : at + 3], columns[:, 3:, at + 3 : at + 6] = frames.moves[:, k + 1], frames.turns[:, k + 1]
            return frames.position[:, k + 1], frames.rotation[:, k + 1], columns
        rod = self.graph.free[k - self.body_count]
        position, by_all = equations.tips()
        places = self.places[rod]
        columns[..., : self.unknown_count] = Sums(places, self.unknown_count)(by_all[:, rod, :, :SIZE])
        columns[..., self.unknown_count :] = by_all[:, rod, :, SIZE : SIZE + d]
        if self.sliding:
            columns[..., : self.unknown_count] += self.sliding.by_unknowns(by_all[:, rod], rod, state.rows)
        return position[:, rod], equations.tip_rotation[:, rod], columns

    def reasons(self, status: NDArray[np.int32]) -> NDArray[np.int32]:
        """As said; where a rod was pulled out of a hole on the way, since this was asked last, that was no number."""
        known, pulled_out = super().reasons(status), self.pulled_out.copy()
        self.pulled_out[:] = False
        return np.where(pulled_out & (known == Status.NONFINITE), Status.OUT_OF_HOLE, known).astype(np.int32)

    def _keep(
        self,
        rows: IntArray,
        residual: FloatArray,
        gamma: FloatArray,
        directions: FloatArray,
        position: FloatArray,
        rotation: FloatArray,
        columns: FloatArray,
    ) -> None:
        """Results to where solvers read them."""
        fault, steps = np.zeros(len(rows), dtype=np.int32), np.zeros(len(rows), dtype=np.int32)
        for group in self.groups:
            worst, taken = group.faults(rows)
            fault, steps = np.maximum(fault, worst), steps + taken
        finite = np.isfinite(residual).all(axis=1) & np.isfinite(gamma).all(axis=1)
        fault[(fault == 0) & ~finite] = int(Fault.NONFINITE)
        numbers = gamma if self.elimination is not None else self.entries.dense(gamma)
        if self.elimination is not None and "gamma" in vars(self):  # asked for whole
            put(self.gamma, rows, self.entries.dense(gamma))
        values = {"residual": residual, "gamma": numbers, "position": position, "rotation": rotation}
        for name, found in values.items():
            self.put(name, rows, found.reshape(len(rows), -1))
        put(self.fault, rows, fault)
        put(self.step_count, rows, steps)
        if self.direction_count:
            put(self.residual_directions, rows, directions)
        if self.pose_sensitivities:
            put(self.pose_columns, rows, columns)

    # ---- bodies ----

    def frames(self, x: FloatArray, rows: IntArray) -> Frames:
        """(4) The ground and the bodies at unknown poses ``x`` (k, body, 6) of the instances ``rows``, (k,)."""
        count, bodies = len(rows), self.body_count
        L, EI = (scale[rows, self.rod_count :, None] for scale in (self.length, self.stiffness))
        reference_position, reference = (values[rows] for values in self.reference)
        a = (L * x[..., 3:]).reshape(-1, 3)
        position, rotation = np.zeros((count, bodies + 1, 3)), np.zeros((count, bodies + 1, 3, 3))
        moves, turns, axes = np.zeros_like(rotation), np.zeros_like(rotation), np.zeros_like(rotation)
        pull, twist = np.zeros((count, bodies + 1, 1)), np.zeros((count, bodies + 1, 1))
        rotation[:, GROUND] = np.eye(3)
        moves[:, 1:] = L[..., None] ** 2 * reference
        position[:, 1:] = reference_position + np.einsum("bkij,bkj->bki", moves[:, 1:], x[..., :3])
        rotation[:, 1:] = reference @ matrices(a).reshape(count, bodies, 3, 3)
        turns[:, 1:] = L[..., None] * (reference @ left_jacobian(a).reshape(count, bodies, 3, 3))
        axes[:, 1:] = reference
        pull[:, 1:], twist[:, 1:] = L / EI, 1 / EI
        return Frames(position, rotation, moves, turns, axes, pull, twist)

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
        x = self.read("unknowns")[:, self.first_pose :].reshape(self.instance_count, -1, POSE)
        frames = self.frames(x, np.arange(self.instance_count))
        return frames.position[:, 1:], frames.rotation[:, 1:]

    # ---- where the search begins ----

    def guess(self) -> FloatArray:
        """Rods at rest, and bodies where they fit them best (``docs/networks.md``, 13).

        What the residual is there is remembered and closes as ``load_factor`` goes from 0 to 1, (12).
        """
        apart = self.apart()
        self.open_at(apart.unknowns, apart.residual)
        return np.array(apart.unknowns)

    def open_at(self, unknowns: FloatArray, residual: FloatArray) -> None:
        """Make ``unknowns`` an equilibrium where ``load_factor`` is 0, by the residual there."""
        self.opening[:], self.opened_at[:], self.soft[:] = residual, unknowns, 1.0

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
                    x[:, self.places[group.members][:, OWN_AT]] = own
                for at, end in zip(ANGLES_AT, self.graph.ends, strict=True):
                    self._set_angles(x, at, np.broadcast_to(end.table.rest, (self.instance_count, *end.table.rest.shape)))
                self.write("unknowns", x)
                self.soft[:], self.opened_at[:] = 1.0, x
                self.integrate()
                self._place(x)
                self.write("unknowns", x)
                self.opened_at[:] = x
                gamma = self._assemble(self.state())
                self._found = Apart(inputs, x, self.read("residual"), gamma)
        return self._found

    def state(self) -> State:
        """Of all instances."""
        return State(self, np.arange(self.instance_count))

    def _set_angles(self, x: FloatArray, at: slice, angles: FloatArray) -> None:
        """Angles (instance_count, rod, 3) as unknowns."""
        places = self.places[:, at]
        rods, which = np.nonzero(places >= 0)
        x[:, places[rods, which]] = angles[:, rods, which] / self.length[:, rods]

    def _place(self, x: FloatArray) -> None:
        """(13) Bodies by the rods as they were integrated, and the angles of joints at tips by both."""
        rods = self.integrated(self.state())
        driven = self.read("inputs")[:, self.input_slice("angle")] if self.graph.driven else None
        placing = self.graph.placing(self.instance_count, self.batch_shape, driven)
        position, rotation = placed(placing, rods.position, rods.rotation)
        x[:, self.first_pose :] = self.pose_unknowns(position[:, 1:], rotation[:, 1:])
        self.write("unknowns", x)
        base, tip = self.state().ends
        turned = np.swapaxes(tip.frame, -1, -2) @ base.rotation @ rods.rotation
        self._set_angles(x, ANGLES_AT[1], self.graph.ends[1].table.fitted(turned))

    @contextmanager
    def unloaded(self) -> Iterator[None]:
        """Within it, all instances may be evaluated without loads; everything is as it was afterwards."""
        kept = (self.fault, self.step_count, self.residual_directions, self.pose_columns)
        values = [np.array(array.numpy()) for array in kept]
        records = self.snapshot()
        own = [np.array(values) for values in (self.opening, self.opened_at, self.soft, self.loading)]
        self.opening[:], self.soft[:], self.loading[:] = 0.0, 0.0, int(Loading.NONE)
        try:
            with self.everyone(), self.at_load(0.0):
                yield
        finally:
            self.restore(records)
            for array, before in zip(kept, values, strict=True):
                array.assign(before)
            self.opening[:], self.opened_at[:], self.soft[:], self.loading[:] = own

    def curvature_scale(self) -> FloatArray:  # noqa: D102
        own = [group.backbones.curvature_scale().reshape(self.instance_count, -1) for group in self.groups]
        return np.asarray(np.concatenate(own, axis=1).max(axis=1))

    def load_scale(self) -> FloatArray:
        """What acts on rods, bodies and tips, and how far tips are from where they are to be: a turn is a moment in ``EI/L``."""
        with self.everyone():
            self.hand_over(np.arange(self.instance_count))
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
            gap = self.apart().residual[:, self.places[held, OWN_AT]] * L[:, : self.rod_count][:, held, None]
            total += (GAP_LOAD * np.linalg.norm(gap[..., :3], axis=2) + np.linalg.norm(gap[..., 3:], axis=2)).max(axis=1)
        return np.asarray(total)


def _fields(rods: Integrated) -> tuple[FloatArray, ...]:
    return tuple(vars(rods).values())


PER_ROD = ("rotation", "translation")
LOADED = ("force", "moment")  # of bodies and tips
FOLLOWING = ("follower_force", "follower_moment")  # of the same, in their frames


def input_places(rod_count: int, load_places: int, angles: int) -> dict[str, slice]:
    """Where each input stands in a row; those before ``LOADED`` are no loads."""
    sizes = {name: rod_count for name in PER_ROD} | ({"angle": angles} if angles else {})
    sizes |= {name: 3 * load_places for name in (*LOADED, *FOLLOWING)} | {name: 3 for name in ALONG}
    ends = np.cumsum([0, *sizes.values()]).tolist()
    return {name: slice(ends[k], ends[k + 1]) for k, name in enumerate(sizes)}


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
        own = places[k][: POSES_AT[0].start].copy()
        if slides.shared[k]:
            own[ANGLES_AT[0]] = -1
        if slides.upper[k] >= 0:
            turns += [place for place in own[ANGLES_AT[1]].tolist() if place >= 0]
            own[ANGLES_AT[1]] = -1
        own = own[own >= 0]
        force, gap = int(places[k, OWN - 1]), int(places[k, GAP_AT.stop - 1])
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
