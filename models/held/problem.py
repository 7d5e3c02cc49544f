"""A rod that is held at both ends: the boundary problem, its buffers and launches."""

from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from multirod.batch import IntArray, take
from multirod.capabilities import Lines, LineTest, Shapes
from multirod.inputs import Inputs, InputSpec
from multirod.integrators import Integrator
from multirod.launch import record
from multirod.models.backbone.assembly import BackboneAssembly
from multirod.models.backbone.derivatives.designs import COMPONENTS
from multirod.models.backbone.equal_steps import PartsAtEqualSteps
from multirod.models.backbone.inputs import BACKBONE_INPUTS, DRIVES
from multirod.models.backbone.problem import BackboneProblem
from multirod.models.backbone.stability.clamps import ClampedBackbones
from multirod.models.backbone.units import unit_stiffness
from multirod.models.held import held_kernels as kernels
from multirod.models.held.along import HeldSensing, by_own_unknowns, columns_along
from multirod.models.held.clamps import HeldClamps
from multirod.models.held.segments import HeldSegments
from multirod.models.held.stability import HeldStability
from multirod.models.held.start import bent_rods
from multirod.models.held.starts import HeldStarts
from multirod.models.joint_kernels import REVOLUTE, SPHERICAL
from multirod.problem import Block, BoundaryProblem, Shape
from multirod.rod import RodArrays
from multirod.rotations import left_jacobian, matrices, vectors
from multirod.segments import Breakpoints, taken
from multirod.validation import FloatArray

ROD_INPUTS = tuple(spec for spec in BACKBONE_INPUTS if spec.acts in ("base", "along"))  # what acts on the rod itself
TIP_LOADS = ("tip_force", "tip_moment")
POSE_INPUTS = ("end_position", "end_rotation")
POSE_SIZE = 3 * len(POSE_INPUTS)
TURNS = {REVOLUTE: 1, SPHERICAL: 3}  # that a joint leaves free
TAUT = 1e-9  # of the length, by which rounding may have ends farther apart
INTEGRATIONS_AT_REST = 3
SETTLING = 4  # and more where a rod begins buckled
REGULAR = 1e-7  # smallest singular value of Gamma at rest, from which the path begins there


@dataclass(frozen=True)
class Holders:
    """What holds a rod at both ends, in numbers.

    Attributes:
        rod: The rod as a robot of its own, which has the base.
        end: Pose of the end's holder in the world where its inputs are zero, shape (..., 4, 4).
        joint: Kind of joint at the end.
        axis: Of a revolute one, in its holder's frame, unit length.
        slide: Direction in which the end slides, in its holder's frame, unit length; None if it does not.
        base_joint: Kind of joint at the base.
        base_axis: Of a revolute one, in the frame of the base, unit length.
        arrays: The rod as kernels read it.
        base: Pose of the base's holder in the world, shape (..., 4, 4).
    """

    rod: BackboneAssembly
    end: FloatArray
    joint: int
    axis: FloatArray
    slide: FloatArray | None
    base_joint: int
    base_axis: FloatArray
    arrays: RodArrays
    base: FloatArray

    @property
    def batch_shape(self) -> tuple[int, ...]:
        """Leading axes of all of it."""
        return np.broadcast_shapes(self.arrays.batch_shape, self.base.shape[:-2], self.end.shape[:-2])

    def take(self, batch_shape: tuple[int, ...], instances: IntArray) -> "Holders":
        """Those of some instances of a batch to whose leading axes this broadcasts, along one axis."""
        result = copy(self)
        taken = {
            "arrays": self.arrays.take(batch_shape, instances),
            **{
                name: take(value, batch_shape, instances, tail=2) if value.ndim > 2 else value
                for name, value in (("base", self.base), ("end", self.end))
            },
        }
        for name, value in taken.items():
            object.__setattr__(result, name, value)
        return result

    @property
    def guide(self) -> FloatArray:
        """Two directions across the one in which the end slides, then that one, in its holder's frame, as columns."""
        if self.slide is None:
            return np.eye(3)
        return np.concatenate([_across(self.slide), self.slide[:, None]], axis=1)

    @property
    def held_directions(self) -> FloatArray:
        """Directions in which the end does not slide, in its holder's frame, as columns."""
        return self.guide if self.slide is None else self.guide[:, :2]

    @property
    def base_axes(self) -> FloatArray:
        """About which the base turns, in its frame, one a row."""
        if self.base_joint == SPHERICAL:
            return np.eye(3)
        return self.base_axis[None] if self.base_joint == REVOLUTE else np.zeros((0, 3))

    @property
    def held_rotations(self) -> FloatArray:
        """About which the end does not turn, in its holder's frame, as columns."""
        if self.joint == SPHERICAL:
            return np.zeros((3, 0))
        return _across(self.axis) if self.joint == REVOLUTE else np.eye(3)


def _across(axis: FloatArray) -> FloatArray:
    """Two directions across one, as columns, that make a right-handed frame with it."""
    first = np.cross(axis, np.eye(3)[np.argmin(np.abs(axis))])
    first /= np.linalg.norm(first)
    return np.stack([first, np.cross(axis, first)], axis=1)


class HeldBackbone(BackboneProblem):
    """The rod of a ``HeldProblem``, whose segments begin and end where that says."""

    whole: "HeldProblem"

    @cached_property
    def cut(self) -> HeldSegments:
        """Its segments, with what holds the ends."""
        return HeldSegments(self.whole)


class HeldProblem(BoundaryProblem):
    """One rod whose ends are held (``docs/held.md``).

    Unknowns are moment and force at the base, in its frame, in ``EI`` and ``EI/L`` (6), between them the tensions of lines whose
    lengths are given, and last the angles of the base in a joint there; residuals those of the end (5), (7), of the rod's lines,
    and of the joint at the base (8).
    """

    guess_integrations: IntArray | int = INTEGRATIONS_AT_REST

    def __init__(
        self,
        holders: Holders,
        inputs: Inputs,
        *,
        integrator: Integrator,
        device: str = "cpu",
        pose_sensitivities: bool = False,
        direction_count: int = 0,
        lengths: bool = False,
        design: bool = False,
        enabled: Sequence[str] = (),
        pieces: int = 1,
    ) -> None:
        self.holders = holders
        if pieces > 1:
            direction_count = 3 * (pieces - 1)
        shape = np.broadcast_shapes(inputs.batch_shape, holders.batch_shape)
        self.turns = len(holders.base_axes)
        self.rod = self._make_rod(inputs, shape, integrator, device, direction_count, lengths, design, enabled, pieces)
        n = self.rod.unknown_count + self.turns
        super().__init__(
            unknown_count=n,
            batch_shape=shape,
            input_count=self.rod.input_count + POSE_SIZE,
            blocks=[Block("rod 1", slice(0, n), slice(0, n), 0)],
            direction_count=direction_count,
            pose_sensitivities=pose_sensitivities,
            device=device,
        )
        self.integrator = integrator
        self.inputs_given = inputs
        self.options: dict[str, Any] = {
            "device": device,
            "pose_sensitivities": pose_sensitivities,
            "direction_count": direction_count,
            "lengths": lengths,
            "enabled": tuple(enabled),
        }
        self.rounding = self.rod.rounding
        self._natural: FloatArray | None = None
        self.table = self._make_table(pieces)
        self._launches = self._record()
        self.write("inputs", self.pack(inputs))

    def _make_rod(
        self,
        inputs: Inputs,
        shape: tuple[int, ...],
        integrator: Integrator,
        device: str,
        direction_count: int,
        lengths: bool,
        design: bool,
        enabled: Sequence[str],
        pieces: int,
    ) -> HeldBackbone:
        """The rod as a backbone whose tip is held, as many as there are instances."""
        holders, rod = self.holders, self.holders.rod
        names = [spec.name for spec in ROD_INPUTS] + [name for name in DRIVES if name in inputs.specs]
        given: dict[str, Any] = {name: inputs.profiles[name] for name in names if name in inputs.profiles}
        given |= {name: inputs.array(name) for name in names if name in inputs.given and name not in given}
        reach = max((p.ends[-1] for p in inputs.profiles.values()), default=0.0)
        specs = tuple(spec for spec in rod.input_specs if spec.name in names)
        result = HeldBackbone(
            rod.rods,
            np.broadcast_to(holders.base, (*shape, 4, 4)),
            Inputs(specs, rod.rod_count, given, reach),
            integrator=integrator,
            device=device,
            pose_sensitivities=True,
            direction_count=direction_count + self.turns,
            lengths=lengths,
            design=design,
            enabled=[name for name in names if name in enabled or inputs.is_active(name)],
            held=True,
            arrays=holders.arrays,
            pieces=pieces,
        )
        result.whole = self
        return result

    def _make_table(self, pieces: int) -> Any:
        holders, rod, count, device = self.holders, self.rod, self.instance_count, self.device
        held: Any = kernels.Held()
        self.share(held)
        held.unknown_count, held.rod_unknowns, held.turns = self.unknown_count, rod.unknown_count, self.turns
        held.direction_count = self.direction_count
        held.rod_inputs = rod.input_count - 1
        held.along = rod.input_slice(kernels.ALONG[0]).start
        held.tip_loads = rod.input_slice(TIP_LOADS[0]).start
        held.pose = self.input_slice(POSE_INPUTS[0]).start

        def array(values: Any, dtype: Any) -> Any:
            kind = np.int32 if dtype is wp.int32 else np.float64
            return wp.array(np.ascontiguousarray(values, dtype=kind), dtype=dtype, device=device)

        def each(values: FloatArray, *tail: int) -> FloatArray:
            return np.array(np.broadcast_to(values, (*self.batch_shape, *tail)).reshape(count, *tail))

        base, end = each(holders.base, 4, 4), each(holders.end, 4, 4)
        self.base_frame, self.end_position, self.end_frame = base[:, :3, :3], end[:, :3, 3], end[:, :3, :3]
        held.base_frame = array(self.base_frame, wp.mat33d)
        held.end_position, held.end_frame = array(self.end_position, wp.vec3d), array(self.end_frame, wp.mat33d)
        held.rest_position, held.rest_turn = array(self.end_position, wp.vec3d), wp.zeros(count, dtype=wp.vec3d, device=device)
        first = rod.each(rod.arrays.material[:, 0, 0])
        self.length = np.array(rod.each(rod.arrays.end[:, 0, -1]))
        self.stiffness = np.array(first[:, :2].max(axis=1))
        held.length, held.stiffness = array(self.length, wp.float64), array(self.stiffness, wp.float64)
        held.moment_unit = array(1 / unit_stiffness(first), wp.vec3d)
        held.base_curvature = array(rod.each(rod.arrays.precurvature[:, 0, 0, :3]), wp.vec3d)
        held.joint, held.axis = holders.joint, wp.vec3d(*holders.axis)
        held.slides, held.guide = int(holders.slide is not None), wp.mat33d(*holders.guide.ravel())
        held.base_axes = array(holders.base_axes.reshape(-1, 3), wp.vec3d)
        held.opening = wp.zeros((count, self.unknown_count), dtype=wp.float64, device=device)
        held.direct = wp.zeros(count, dtype=wp.int32, device=device)
        self.alike = self._alike()
        held.alike = array(self.alike, wp.int32)
        held.neutral = wp.zeros(count, dtype=wp.int32, device=device)
        held.clamped = int(pieces > 1)
        for name in ("active", "load_factor", "directions", "fault", "step_count", "residual", "gamma", "residual_directions"):
            setattr(held, f"rod_{name}", getattr(rod, name))
        held.rod_unknowns_at, held.rod_inputs_at = rod.unknowns, rod.inputs
        held.rod_position, held.rod_rotation, held.rod_pose_columns = rod.position, rod.rotation, rod.pose_columns
        held.wrench, held.wrench_columns = rod.tip_wrench, rod.wrench_columns
        held.base_position, held.base_rotation = rod.table.base_position, rod.table.base_rotation
        return held

    def _alike(self) -> NDArray[np.bool_]:
        """(10) Whether nothing of the rod tells directions across its axis apart, shape (instance_count,)."""
        arrays, features = self.rod.arrays, self.rod.features
        material = arrays.material[:, 0]
        free = self.turns or self.holders.joint == REVOLUTE or features.members or features.loads
        if free or features.distributed_force or features.distributed_moment or features.profile_degree >= 0:
            return np.zeros(self.instance_count, dtype=bool)
        if self.holders.slide is not None and abs(self.holders.slide[2]) < 1 - kernels.ON_AXIS:
            return np.zeros(self.instance_count, dtype=bool)
        bent = arrays.precurvature.reshape(*arrays.precurvature.shape[:3], -1, 3)[..., :2].any(axis=(1, 2, 3, 4))
        alike = (material[..., 0] == material[..., 1]).all(axis=1) & (material[..., 6] == material[..., 7]).all(axis=1)
        return np.asarray(self.rod.each(alike & ~bent))

    def _record(self) -> list[Any]:
        """Launches of one evaluation, in order."""
        count = self.instance_count

        def recorded(kernel: Any) -> Any:
            return record(lambda: kernel, count, (self.table,), self.device)

        return [recorded(kernels.hand_over), self.rod.launch, recorded(kernels.hold)]

    # ---- what is offered ----

    @property
    def stability(self) -> HeldStability:  # noqa: D102
        return HeldStability(self)

    @property
    def shapes(self) -> "HeldShapes":  # noqa: D102
        return HeldShapes(self)

    @property
    def lines(self) -> "HeldLines":  # noqa: D102
        return HeldLines(self)

    @property
    def segments(self) -> HeldSegments:  # noqa: D102
        return self.rod.cut

    @property
    def breakpoints(self) -> dict[int, Breakpoints]:
        """As said; the rod's too."""
        return self.rod.breakpoints

    @breakpoints.setter
    def breakpoints(self, points: dict[int, Breakpoints]) -> None:
        self.rod.breakpoints = points

    @property
    def parts(self) -> "HeldParts":  # noqa: D102
        return HeldParts(self)

    @cached_property
    def clamps(self) -> HeldClamps | None:  # noqa: D102
        return HeldClamps(self, self.rod.launch) if isinstance(self.rod.launch, ClampedBackbones) else None

    @property
    def may_be_clamped(self) -> bool:
        """Whether places along the rod can be: not where its base turns and what acts along the rod does not turn with it."""
        terms = self.rod.features
        along = terms.distributed_force or terms.distributed_moment or terms.loads or terms.profile_degree >= 0
        return self.rod.may_be_clamped and not (self.turns and along)

    @property
    def starts(self) -> HeldStarts:  # noqa: D102
        return HeldStarts(self)

    @property
    def result_test(self) -> LineTest | None:  # noqa: D102
        return None if self.rod.result_test is None else LineTest(self.lines)

    @property
    def kinks(self) -> NDArray[np.intp]:  # noqa: D102
        return self.rod.kinks

    @property
    def kink_inputs(self) -> NDArray[np.intp]:  # noqa: D102
        return self.rod.kink_inputs

    # ---- the interface ----

    def _pass_over(self, instances: IntArray | None) -> None:
        super()._pass_over(instances)
        self.rod._pass_over(instances)
        for launch in self._launches[::2]:
            launch.set_dim(self.listed)

    @cached_property
    def launches(self) -> tuple[Any, ...] | None:  # noqa: D102
        own = self.rod.launches
        return None if own is None else (self._launches[0], *own, *self._launches[2:])

    def _integrate(self) -> None:
        self.rod.stop = self.stop
        for launch in self._launches:
            launch.launch()

    def to_rod(self) -> None:
        """Unknowns and inputs to the rod, without an integration."""
        with self.focused():
            self._launches[0].launch()

    def renew(self, inputs: Inputs) -> bool:  # noqa: D102
        if inputs.profiles or self.inputs_given.profiles:
            return False
        self._clear()
        self.rod._clear()
        self.inputs_given, self._natural = inputs, None
        self.write("inputs", self.pack(inputs))
        return True

    def _zeros(self) -> list[Any]:
        return [*super()._zeros(), self.table.opening, self.table.direct, self.table.neutral]

    def takes(self, name: str) -> bool:  # noqa: D102
        return name in (*POSE_INPUTS, *TIP_LOADS) or self.rod.takes(name)

    def pack(self, inputs: Inputs) -> FloatArray:  # noqa: D102
        packed = super().pack(inputs)
        packed[:, -1] = 1.0  # scale of the load profiles
        return packed

    def input_slice(self, name: str) -> slice:  # noqa: D102
        if name in POSE_INPUTS:
            start = self.rod.input_count - 1 + 3 * POSE_INPUTS.index(name)
            return slice(start, start + 3)
        return self.rod.input_slice(name)

    def aim(self, *names: str) -> None:
        """As said; along the rod's own numbers too, of which the rod alone knows."""
        super().aim(*names)
        rod = self.rod
        if rod.directions.shape[2] == rod.input_count:
            return
        rows, column = np.zeros(rod.directions.shape), 0
        for name in names:
            own = rod.derivatives.designs(name).rows() if name in COMPONENTS else self.directions_by(name)
            if name in COMPONENTS:
                rows[:, column : column + own.shape[1], rod.input_count :] = own[..., rod.input_count :]
            column += own.shape[1]
        rod.directions.assign(rows)

    def directions_by(self, name: str) -> FloatArray:
        """As said; none along a number of the rod."""
        if name in COMPONENTS:
            return np.zeros((1, self.rod.derivatives.designs(name).count, self.directions.shape[2]))
        return super().directions_by(name)

    def aimed(self, *names: str) -> tuple[FloatArray, FloatArray]:
        """As said; by the rod's numbers too, the unknowns fixed."""
        slopes, moved = super().aimed(*names)
        rates, n = self.unknown_rates(names), self.unknown_count
        if rates is not None:
            slopes -= self.read("gamma").reshape(-1, n, n) @ rates
            moved -= self.pose_columns.numpy()[:, :, :n] @ rates
        return slopes, moved

    def unknown_rates(self, names: Sequence[str]) -> FloatArray | None:
        """(D19) of ``docs/derivatives.md``: what leaves moment and force at the base as they are, (instance, n, k); None where
        nothing need be."""
        if self.eliminates or "bending_stiffness" not in names:
            return None
        parts, x, n = [], self.read("unknowns"), self.rod.unknown_count
        scaled = np.r_[0:3, n - 3 : n]
        for name in names:
            rates = np.zeros((self.instance_count, self.unknown_count, self.directions_by(name).shape[1]))
            if name == "bending_stiffness":
                relative = self.rod.derivatives.designs(name).largest() / self.stiffness[:, None]
                rates[:, scaled] = -x[:, scaled, None] * relative[:, None]
            parts.append(rates)
        return np.concatenate(parts, axis=2)

    def along(self, names: Sequence[str], rod: int, places: FloatArray) -> dict[str, FloatArray]:  # noqa: D102
        return columns_along(self, names, places)

    def sensing(self, places: FloatArray) -> HeldSensing:  # noqa: D102
        return HeldSensing(self, places, self._launches)

    def sensed(self, made: HeldSensing, names: Sequence[str], rod: int) -> tuple[FloatArray, FloatArray]:  # noqa: D102
        return made.curvature(names)

    def guess(self) -> FloatArray:
        """The rod at rest, its end where that is; where it is straight there and its end does not slide, a little bent.

        What is left of the residual is remembered and closes as ``load_factor`` goes from 0 to 1, (3).
        """
        x = np.zeros((self.instance_count, self.unknown_count))
        records, buckled = self.snapshot(), np.zeros(self.instance_count, dtype=bool)
        self.table.opening.zero_(), self.table.direct.zero_()
        with self.everyone(), self.at_load(0.0):
            self.evaluate(x)
            position, rotation = self.rod.read("position"), self.rod.read("rotation").reshape(-1, 3, 3)
            self.table.rest_position.assign(position)
            self.table.rest_turn.assign(vectors(self.end_frame @ np.swapaxes(rotation, 1, 2)))
            residual, gamma = self.evaluate(x)
            least = _least_singular_value(gamma)
            stuck = ~(least > REGULAR)
            if stuck.any():
                start = bent_rods(self, x)
                x = np.where(stuck[:, None], start.unknowns, x)
                self.table.direct.assign((stuck & start.direct).astype(np.int32))
                buckled = stuck & start.buckled
                self.table.rest_position.assign(np.where(buckled[:, None], start.end, position))
                residual, gamma = self.evaluate(x)
                if buckled.any():
                    x, residual, gamma = self._settled(x, residual, gamma, buckled)
                least = _least_singular_value(gamma)
        self.guess_integrations = INTEGRATIONS_AT_REST + SETTLING * buckled
        self.table.opening.assign(residual)
        self.restore(records)
        self._natural = np.minimum(1.0, least)
        return x

    def _settled(
        self, x: FloatArray, residual: FloatArray, gamma: FloatArray, chosen: NDArray[np.bool_]
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """The ``chosen`` after some steps of Newton's method, with residual and ``Gamma``; as they were where these lead away."""
        first, residuals, gammas = x, residual, gamma
        for _ in range(SETTLING):
            step = np.zeros_like(x)
            regular = chosen & (_least_singular_value(gamma) > 0)
            step[regular] = np.linalg.solve(gamma[regular], residual[regular, :, None])[..., 0]
            x = x - step
            residual, gamma = self.evaluate(x)
        with np.errstate(invalid="ignore"):
            away = ~(np.abs(residual).max(axis=1) < np.abs(residuals).max(axis=1)) | ~chosen
        x[away], residual[away], gamma[away] = first[away], residuals[away], gammas[away]
        return x, residual, gamma

    @property
    def natural_singular_value(self) -> FloatArray:
        """That at ``guess``."""
        if self._natural is None:
            self.guess()
        assert self._natural is not None
        return self._natural

    def turn_axes(self) -> FloatArray:
        """(8) Rotation vectors of the rod by each unknown of its base's joint, in the world, shape (instance_count, 3, turns)."""
        x = self.read("unknowns")[:, self.rod.unknown_count :]
        a = self.length[:, None] * x @ self.holders.base_axes
        J = left_jacobian(a)
        return np.asarray(self.length[:, None, None] * np.einsum("bij,bjk,lk->bil", self.base_frame, J, self.holders.base_axes))

    def base_moment(self) -> FloatArray:
        """Moment at the base, in the world [N m], shape (instance_count, 3)."""
        moment = self.read("unknowns")[:, :3] * self.stiffness[:, None]
        turned = np.broadcast_to(self.rod.table.base_rotation.numpy(), (len(moment), 3, 3))
        return np.asarray(np.einsum("bij,bj->bi", turned, moment))

    def base_moment_columns(self) -> FloatArray:
        """Its change by the unknowns of the rod as a backbone, shape (instance_count, 3, rod.unknown_count)."""
        result = np.zeros((self.instance_count, 3, self.rod.unknown_count))
        result[:, :, :3] = self._rod_at_base() / self.table.moment_unit.numpy()[:, None, :]
        return result

    def _rod_at_base(self) -> FloatArray:
        """Frame of the rod at its base, in the world."""
        turned = matrices(self.read("inputs")[:, :1] * [0.0, 0.0, 1.0])
        return np.asarray(np.broadcast_to(self.rod.table.base_rotation.numpy(), turned.shape) @ turned)

    def goal(self) -> tuple[FloatArray, FloatArray]:
        """(1), (2) Position (instance_count, 3) and rotation (instance_count, 3, 3) of the end's holder."""
        inputs = self.read("inputs")
        position, turn = (inputs[:, self.input_slice(name)] for name in POSE_INPUTS)
        return self.end_position + position, matrices(turn) @ self.end_frame

    @property
    def held_forces(self) -> NDArray[np.intp]:  # noqa: D102
        return np.arange(self.rod.unknown_count - 3, self.rod.unknown_count)

    def goal_is_neutral(self) -> NDArray[np.bool_]:
        """(10) As the last evaluation found it, shape (instance_count,)."""
        return np.asarray(self.table.neutral.numpy() != 0)

    def turning_angle(self) -> FloatArray:
        """How far the ends are turned against each other on the way from rest, at most [rad], shape (instance_count,)."""
        inputs = self.read("inputs")
        turn = np.linalg.norm(inputs[:, self.input_slice("end_rotation")], axis=1)
        turn += np.linalg.norm(self.table.rest_turn.numpy(), axis=1)
        return np.asarray(turn + np.abs(inputs[:, 0]))

    def length_in_use(self) -> FloatArray:
        """Of the rod, from its base on, by which ``translation`` it is pushed out [m], shape (instance_count,)."""
        return np.asarray(self.length + self.read("inputs")[:, self.input_slice("translation")][:, 0])

    def out_of_reach(self) -> NDArray[np.bool_]:
        """(17) As said: of a rod that neither stretches nor shears, whose length is all that its line can have."""
        features = self.rod.features
        if features.shear:
            return np.zeros(self.instance_count, dtype=bool)
        position, frame = self.goal()
        away = position - np.broadcast_to(self.rod.table.base_position.numpy(), position.shape)
        if self.holders.slide is not None:
            along = frame @ self.holders.slide
            away = away - (away * along).sum(axis=1)[:, None] * along
        return np.asarray(np.linalg.norm(away, axis=1) > (1 + TAUT) * self.length_in_use())

    def curvature_scale(self) -> FloatArray:  # noqa: D102
        return np.maximum(self.rod.curvature_scale(), self.turning_angle() / self.length)

    def load_scale(self) -> FloatArray:
        """What acts on the rod, and how far its end is moved: a turn is a moment in ``EI/L``."""
        inputs = self.read("inputs")
        own = np.delete(inputs, range(self.table.pose, self.table.pose + POSE_SIZE), axis=1)
        own[:, self.table.tip_loads : self.table.along] = 0.0
        self.rod.write("inputs", own)
        stiffness = self.rod.each(self.rod.arrays.material[:, 0, :, :3].min(axis=(1, 2)))
        total = self.rod.load_scale() + self.turning_angle()
        moved = np.linalg.norm(self.goal()[0] - self.table.rest_position.numpy(), axis=1)
        total += 12 * moved / self.length
        for name, power in zip(TIP_LOADS, (2, 1), strict=True):
            total += np.linalg.norm(inputs[:, self.input_slice(name)], axis=1) * self.length**power / stiffness
        return np.asarray(total)


def _least_singular_value(gamma: FloatArray) -> FloatArray:
    """Of matrices (batch, n, n); NaN where they are not finite."""
    least = np.full(len(gamma), np.nan)
    sound = np.isfinite(gamma).all(axis=(1, 2))
    least[sound] = np.linalg.svd(gamma[sound], compute_uv=False)[:, -1]
    return least


class HeldParts(PartsAtEqualSteps[HeldProblem]):
    """Of a ``HeldProblem``."""

    def __init__(self, problem: HeldProblem) -> None:
        super().__init__(problem, problem.integrator, [problem.rod])

    @property
    def may_be_clamped(self) -> bool:  # noqa: D102
        return self.problem.may_be_clamped

    def _part(self, instances: IntArray, integrator: Integrator, *, poses: bool, pieces: int = 1) -> HeldProblem:
        whole = self.problem
        holders = whole.holders.take(whole.batch_shape, instances)
        options = {**whole.options, **({"pose_sensitivities": True} if poses else {})}
        inputs = whole.inputs_given.take(whole.batch_shape, instances)
        result = HeldProblem(holders, inputs, integrator=integrator, pieces=pieces, **options)
        result.stop = whole.stop
        for name in ("inputs", "unknowns"):
            result.write(name, whole.read(name)[instances])
        for name in ("rest_position", "rest_turn", "opening", "direct"):
            getattr(result.table, name).assign(getattr(whole.table, name).numpy()[instances])
        result.breakpoints = taken(whole.breakpoints, instances)
        return result


class HeldShapes(Shapes):
    """Of a ``HeldProblem``."""

    def __init__(self, problem: HeldProblem) -> None:
        self.problem = problem

    def at_nodes(self, node_count: int) -> tuple[tuple[Shape, ...], FloatArray]:  # noqa: D102
        self.problem.to_rod()
        return self.problem.rod.shapes.at_nodes(node_count)


class HeldLines(Lines):
    """Of a ``HeldProblem``."""

    def __init__(self, problem: HeldProblem) -> None:
        self.problem = problem

    def _of_rod(self) -> Lines:
        self.problem.to_rod()
        return self.problem.rod.lines

    def length(self) -> FloatArray:  # noqa: D102
        return self._of_rod().length()

    def tension(self) -> FloatArray:  # noqa: D102
        return self._of_rod().tension()

    def slack(self) -> NDArray[np.bool_]:  # noqa: D102
        return self._of_rod().slack()

    def beyond(self) -> NDArray[np.bool_]:  # noqa: D102
        return self._of_rod().beyond()

    def left(self, node_count: int) -> FloatArray:  # noqa: D102
        return self._of_rod().left(node_count)

    def length_columns(self, *names: str) -> FloatArray:
        """As said."""
        return by_own_unknowns(self.problem, self._of_rod().length_columns(*names))


_DESCRIPTIONS = {
    "tip_force": "dead force on the end, world frame; what holds the end takes it but along its slide",
    "tip_moment": "dead moment on the end, world frame; what holds the end takes it but where its joint turns",
}
TIP_SPECS = tuple(replace(spec, description=_DESCRIPTIONS[spec.name]) for spec in BACKBONE_INPUTS if spec.name in _DESCRIPTIONS)
END_INPUTS = (
    InputSpec(name="end_position", unit="m", acts="tip", description="how far what holds the end is moved, world frame"),
    InputSpec(
        name="end_rotation",
        unit="rad",
        acts="tip",
        description="rotation vector by which what holds the end is turned, world frame",
    ),
)
