"""Several backbones that hold one platform: the boundary problem, its buffers and launches."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from copy import copy
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from multirod.batch import IntArray, take
from multirod.inputs import Inputs, InputSpec
from multirod.integrators import Integrator
from multirod.launch import record
from multirod.models.backbone.problem import BACKBONE_INPUTS, BackboneAssembly, BackboneProblem, spread
from multirod.models.backbone.second_variation import CondensedForm
from multirod.models.platform import platform_kernels as kernels
from multirod.models.platform.guess import (
    Attachments,
    Legs,
    beam_equilibrium,
    beam_reach,
    beam_unknowns,
    fitted_platform,
    nearest_rotation,
    rotation_vectors,
)
from multirod.models.platform.stability import HeldLeg, PlatformLoads, platform_modes
from multirod.problem import Block, BoundaryProblem, Loading, Shape
from multirod.rod import RodArrays, stack
from multirod.rotations import matrices
from multirod.stability import Modes, Stability
from multirod.status import Status
from multirod.validation import FloatArray, frozen

POSE = kernels.POSE
PER_ROD = ("rotation", "translation")
LEG_INPUTS = tuple(
    spec for spec in BACKBONE_INPUTS if spec.per_rod or spec.name in kernels.LEG_VECTORS
)  # what acts on a leg itself


# In L^3/EI, added to the tips of beams in all directions: one that is straight and inextensible gives way along itself by
# bending, once it has bent, and how much depends on how far it has to.
COMPLIANCES = (1e-4, 1e-3, 1e-2, 1e-1)
REACH = (0.6, 0.6)  # of starts from the unloaded pose: in lengths, and radians
CROWDING = 1.5  # most equilibria are not far


class Geometry:
    """Legs, joints and platform of a robot, in numbers.

    Attributes:
        legs: Each leg as a robot of its own.
        arrays: Their rods as kernels read them.
        base: Pose of each leg's base in the world, shape (..., leg_count, 4, 4).
        platform: Pose of each leg's attachment in the platform's frame, shape (..., leg_count, 4, 4).
        joints: Kind of each joint, shape (leg_count,).
        axes: Axis of each joint in the attachment's frame, unit length, shape (leg_count, 3).
        mass: Of the platform [kg].
        mass_centre: In the platform's frame [m], shape (3,).
        batch_shape: Leading axes of all of it.
    """

    def __init__(
        self,
        legs: Sequence[BackboneAssembly],
        base: FloatArray,
        platform: FloatArray,
        joints: Sequence[int],
        axes: FloatArray,
        mass: float,
        mass_centre: FloatArray,
    ) -> None:
        self.legs = tuple(legs)
        self.arrays: tuple[RodArrays, ...] = tuple(leg.arrays for leg in legs)
        self.base = base
        self.platform = platform
        self.joints = frozen(np.array(joints, dtype=np.int32))
        self.axes = axes
        self.mass = mass
        self.mass_centre = mass_centre
        shapes = [arrays.batch_shape for arrays in self.arrays]
        self.batch_shape = np.broadcast_shapes(*shapes, base.shape[:-3], platform.shape[:-3])
        self.rods = tuple(rod for leg in self.legs for rod in leg.rods)
        self.first_rod: NDArray[np.intp] = frozen(np.cumsum([0] + [leg.rod_count for leg in self.legs]))
        self.first_unknown: NDArray[np.intp] = frozen(np.cumsum([0] + [leg.rod_count + 5 for leg in self.legs]))

    def reference(self) -> tuple[FloatArray, FloatArray]:
        """Position [m] and rotation where the unknown pose is zero, shapes (..., 3), (..., 3, 3): the same whatever the inputs."""
        turned = (self.base[..., :3, :3] @ np.swapaxes(self.platform[..., :3, :3], -1, -2)).sum(axis=-3)
        return self.base[..., :3, 3].mean(axis=-2), nearest_rotation(turned)

    def take(self, batch_shape: tuple[int, ...], instances: IntArray) -> "Geometry":
        """The geometry of some instances of a batch to whose leading axes this broadcasts, along one axis.

        ``instances`` are their numbers in the flattened batch.
        """
        if not self.batch_shape:
            return self
        result = copy(self)
        result.arrays = tuple(arrays.take(batch_shape, instances) for arrays in self.arrays)
        result.base = take(self.base, batch_shape, instances, tail=3) if self.base.ndim > 3 else self.base
        result.platform = take(self.platform, batch_shape, instances, tail=3) if self.platform.ndim > 3 else self.platform
        result.batch_shape = np.shape(instances)
        return result

    def scales(self) -> tuple[FloatArray, FloatArray]:
        """Length and bending stiffness of each leg, then of the platform, shapes (batch or 1, leg_count + 1)."""
        arrays = [arrays.repeated(self.batch_shape) for arrays in self.arrays]
        length = np.stack([a.end[:, :, -1].max(axis=1) for a in arrays], axis=1)
        stiffness = np.stack([a.material[:, :, 0, :2].max(axis=2).sum(axis=1) for a in arrays], axis=1)
        length = np.concatenate([length, length.mean(axis=1, keepdims=True)], axis=1)
        return length, np.concatenate([stiffness, stiffness.sum(axis=1, keepdims=True)], axis=1)


@dataclass(frozen=True)
class Closed:
    """The unloaded robot at certain inputs.

    Attributes:
        inputs: Packed, shape (instance_count, input_count).
        unknowns: [1/m], shape (instance_count, n).
        residual: What is left of it there [1/m], shape (instance_count, n).
        singular_value: Smallest of ``Gamma`` there, 1 at most, shape (instance_count,).
    """

    inputs: FloatArray
    unknowns: FloatArray
    residual: FloatArray
    singular_value: FloatArray


def crowded(numbers: IntArray) -> FloatArray:
    """Displacements, in lengths, and rotation vectors by number, that lie the closer the nearer they are to none; shape (k, 6)."""
    points = spread(numbers, POSE)
    return np.asarray(np.sign(points) * np.abs(points) ** CROWDING * np.repeat(REACH, 3))


class LegGroup:
    """Legs of one build, integrated in one launch."""

    def __init__(self, problem: "ParallelProblem", members: Sequence[int], inputs: Inputs, options: dict[str, Any]) -> None:
        geometry = problem.geometry
        self.members = tuple(members)
        legs = [geometry.legs[k] for k in members]
        shape = problem.batch_shape
        arrays = stack([geometry.arrays[k].repeated(shape) for k in members], shape)
        base = np.broadcast_to(geometry.base[..., list(members), :, :], (*shape, len(legs), 4, 4))
        count = len(members)
        given: dict[str, Any] = {name: inputs.profiles[name] for name in kernels.LEG_VECTORS if name in inputs.profiles}
        for name in kernels.LEG_VECTORS:
            if name in inputs.given and name not in given:
                given[name] = np.broadcast_to(getattr(inputs, name)[..., None, :], (*inputs.batch_shape, count, 3))
        reach = max((p.ends[-1] for p in inputs.profiles.values()), default=0.0)
        self.backbones = BackboneProblem(
            legs[0].rods,
            base,
            Inputs(LEG_INPUTS, legs[0].rod_count, given, reach),
            transmission=legs[0].transmission,
            pose_sensitivities=True,
            held=True,
            arrays=arrays,
            **options,
        )
        self._write_constants(problem, base)

    def _write_constants(self, problem: "ParallelProblem", base: FloatArray) -> None:
        device, geometry, own = problem.device, problem.geometry, self.backbones
        legs: Any = kernels.Legs()
        legs.count = len(self.members)
        legs.rods = len(own.rods)
        legs.unknown_count = own.unknown_count
        legs.vectors = own.input_slice(kernels.LEG_VECTORS[0]).start
        for name, values in (
            ("leg", self.members),
            ("first_rod", geometry.first_rod[list(self.members)]),
            ("first_unknown", geometry.first_unknown[list(self.members)]),
        ):
            setattr(legs, name, wp.array(np.asarray(values, dtype=np.int32), dtype=wp.int32, device=device))
        own.share(legs)
        legs.wrench, legs.wrench_columns = own.tip_wrench, own.wrench_columns
        legs.to_base = wp.array(np.swapaxes(base[..., :3, :3], -1, -2).reshape(-1, 3, 3), dtype=wp.mat33d, device=device)
        self.table = legs


class ParallelProblem(BoundaryProblem):
    """Legs whose tips are joined to one platform.

    Unknowns are those of each leg (``docs/model.md``, equation 10, then its base force), then the pose of the platform
    (``docs/parallel.md``, equations 1 and 2); residuals those of each leg's joint and torques, then the platform's
    equilibrium. ``Gamma`` is an arrow: legs meet only at the platform. In the inverse problem the pose is an input, and the
    translation of each leg is unknown in its place.
    """

    guess_integrations = 1 + len(COMPLIANCES)

    def __init__(
        self,
        geometry: Geometry,
        inputs: Inputs,
        *,
        integrator: Integrator,
        device: str = "cpu",
        inverse: bool = False,
        limits: FloatArray | None = None,
        pose_sensitivities: bool = False,
        direction_count: int = 0,
        leg_direction_count: int | None = None,
        enabled: Sequence[str] = (),
    ) -> None:
        self.leg_direction_count = direction_count if leg_direction_count is None else leg_direction_count
        self.geometry = geometry
        self.inverse = inverse
        self._limits = np.array([-np.inf, np.inf])[:, None] if limits is None else limits
        self._places = input_places(len(geometry.rods), inverse)
        first = [int(k) for k in geometry.first_unknown]
        # what each leg's unknowns are: its own, in the order of the arrow
        self._own = [slice(a, b) for a, b in pairwise(first)]
        self._platform = slice(first[-1], first[-1] + POSE)
        super().__init__(
            unknown_count=int(first[-1]) + POSE,
            batch_shape=np.broadcast_shapes(inputs.batch_shape, geometry.batch_shape),
            input_count=max(place.stop for place in self._places.values()) + 1,
            blocks=_blocks(geometry),
            direction_count=direction_count,
            pose_sensitivities=pose_sensitivities,
            device=device,
        )
        self.arrow = (*first, self.unknown_count)
        self.integrator = integrator
        self._inputs = inputs
        self._options: dict[str, Any] = {
            "device": device,
            "inverse": inverse,
            "pose_sensitivities": pose_sensitivities,
            "direction_count": direction_count,
            "enabled": tuple(enabled),
        }
        options = {
            "integrator": integrator,
            "device": device,
            "direction_count": self.leg_direction_count + int(inverse),
            "enabled": [name for name in kernels.LEG_VECTORS if name in enabled or inputs.is_active(name)],
        }
        builds: dict[tuple[Any, ...], list[int]] = {}
        for k, leg in enumerate(geometry.legs):
            builds.setdefault((leg.rod_count, leg.transmission, leg.arrays.members), []).append(k)
        self.groups = [LegGroup(self, members, inputs, options) for members in builds.values()]
        self.rounding = self.groups[0].backbones.rounding
        self.measured = inputs.measured
        self._found: Closed | None = None
        self._robots = self._make_robots()
        self._launches = self._record()
        self.write("inputs", self.pack(inputs))

    def _make_robots(self) -> Any:
        geometry, device, count = self.geometry, self.device, self.instance_count
        legs = len(geometry.legs)
        robots: Any = kernels.Robots()
        robots.leg_count = legs
        robots.rod_count = len(geometry.rods)
        robots.unknown_count = self.unknown_count
        robots.direction_count = self.direction_count
        robots.leg_direction_count = self.leg_direction_count
        robots.inverse = int(self.inverse)
        self.share(robots)

        def batched(values: FloatArray, tail: tuple[int, ...]) -> FloatArray:
            """Rows for all instances, or one where none varies."""
            shape = self.batch_shape if geometry.batch_shape else ()
            return np.broadcast_to(values, (*shape, *tail)).reshape(-1, *tail)

        def array(values: Any, dtype: Any = wp.float64) -> Any:
            kind = np.int32 if dtype is wp.int32 else np.float64
            return wp.array(np.ascontiguousarray(values, dtype=kind), dtype=dtype, device=device)

        platform = batched(geometry.platform, (legs, 4, 4))
        robots.stride = int(bool(geometry.batch_shape))
        position, rotation = geometry.reference()
        self._reference = batched(position, (3,)), batched(rotation, (3, 3))
        robots.reference_position = array(self._reference[0], wp.vec3d)
        robots.reference_rotation = array(self._reference[1], wp.mat33d)
        robots.attachment_position = array(platform[:, :, :3, 3], wp.vec3d)
        robots.attachment_rotation = array(platform[:, :, :3, :3], wp.mat33d)
        robots.joint = array(geometry.joints, wp.int32)
        robots.axis = array(geometry.axes, wp.vec3d)
        length, stiffness = geometry.scales()
        self._length = batched(length.reshape(*geometry.batch_shape, legs + 1), (legs + 1,))
        self._stiffness = batched(stiffness.reshape(*geometry.batch_shape, legs + 1), (legs + 1,))
        robots.length, robots.stiffness = array(self._length), array(self._stiffness)
        robots.mass = geometry.mass
        robots.mass_centre = wp.vec3d(*geometry.mass_centre)
        robots.pose = self._places["platform_position"].start if self.inverse else 0
        robots.loads = self._places[kernels.PLATFORM_VECTORS[0]].start
        robots.spread = self._places[kernels.LEG_VECTORS[0]].start
        robots.opening = wp.zeros((count, self.unknown_count), dtype=wp.float64, device=device)
        robots.loading = wp.zeros(count, dtype=wp.int32, device=device)
        size = kernels.DIRECTIONS_AT + 6 * self.leg_direction_count
        robots.law = wp.zeros((count * legs, size), dtype=wp.float64, device=device)
        robots.leg_fault = wp.zeros(count * legs, dtype=wp.int32, device=device)
        robots.leg_step_count = wp.zeros(count * legs, dtype=wp.int32, device=device)
        return robots

    def _record(self) -> list[Any]:
        """Launches of one evaluation, in order."""

        def recorded(kernel: Any, dim: int, *arguments: Any) -> Any:
            return record(lambda: kernel, dim, arguments, self.device)

        launches = []
        for group in self.groups:
            dim = group.backbones.instance_count
            launches.append(recorded(kernels.spread, dim, self._robots, group.table))
            launches.append(group.backbones.launch)
            launches.append(recorded(kernels.attach, dim, self._robots, group.table))
        launches.append(recorded(kernels.balance, self.instance_count, self._robots))
        return launches

    # ---- the interface ----

    def focus(self, instances: IntArray | None = None) -> None:  # noqa: D102
        super().focus(instances)
        launches = iter(self._launches)
        for group in self.groups:
            count = len(group.members)
            rows = None if instances is None else (np.asarray(instances)[:, None] * count + np.arange(count)).reshape(-1)
            group.backbones.focus(rows)
            for _ in range(3):
                next(launches).set_dim(group.backbones.listed)
        next(launches).set_dim(self.listed)

    def _integrate(self) -> None:
        for group in self.groups:
            group.backbones.stop = self.stop
        for launch in self._launches:
            launch.launch()

    def part(self, instances: IntArray, *, double: bool = False) -> "ParallelProblem":  # noqa: D102
        integrator = self.integrator.in_double() if double else self.integrator
        geometry, inputs = self.geometry.take(self.batch_shape, instances), self._inputs.take(self.batch_shape, instances)
        result = ParallelProblem(geometry, inputs, integrator=integrator, **self._options)
        result.stop = self.stop
        for name in ("inputs", "unknowns"):
            result.write(name, self.read(name)[instances])
        return result

    def takes(self, name: str) -> bool:  # noqa: D102
        if name in kernels.LEG_VECTORS:
            return all(group.backbones.takes(name) for group in self.groups)
        return True

    def pack(self, inputs: Inputs) -> FloatArray:  # noqa: D102
        packed = super().pack(inputs)
        packed[:, -1] = 1.0  # scale of the load profiles
        return packed

    def input_slice(self, name: str) -> slice:  # noqa: D102
        return self._places[name]

    def guess(self) -> FloatArray:
        """The unloaded robot, its legs taken for beams that bend little (``docs/parallel.md``, equation 11).

        What its residual is there is remembered and closes as ``load_factor`` goes from 0 to 1, (9).
        """
        closed = self._closed()
        self._robots.opening.assign(closed.residual)
        return np.array(closed.unknowns)

    @property
    def natural_singular_value(self) -> FloatArray:
        """That at ``guess``: legs that are long and thin answer a force along themselves by bending alone."""
        return self._closed().singular_value

    def _closed(self) -> "Closed":
        """The unloaded robot at the present inputs; found once for all who ask."""
        inputs = self.read("inputs")
        if self._found is None or not np.array_equal(self._found.inputs, inputs):
            with self._unloaded():
                x, legs, at = self._unloaded_legs()
                candidates = [self._bent(x, legs.softened(compliance), at) for compliance in COMPLIANCES]
                x, residual, gamma = self._best(candidates)
            sound = np.isfinite(gamma).all(axis=(1, 2))
            least = np.ones(self.instance_count)
            least[sound] = np.minimum(1.0, np.linalg.svd(gamma[sound], compute_uv=False)[:, -1])
            self._found = Closed(inputs, x, residual, least)
        return self._found

    @property
    def comes_apart(self) -> bool:  # noqa: D102
        return True

    def apart(self, numbers: IntArray | None = None) -> FloatArray:
        """Legs that nothing holds, and a platform as near to their tips as it can be, or around there (``docs/parallel.md``).

        The mismatch of each joint is remembered and closes as ``load_factor`` goes from 0 to 1, (9).
        """
        with self._unloaded():
            x, legs, at = self._unloaded_legs()
        if not self.inverse:
            position, rotation = fitted_platform(legs, at)
            if numbers is not None:
                aside = self._around(numbers)
                position = position + np.broadcast_to(self._length[:, -1:], (self.instance_count, 1)) * aside[:, :3]
                rotation = matrices(aside[:, 3:]) @ rotation
            x[:, self._platform] = self._pose_unknowns(position, rotation)
        self.active.fill_(1)
        self.open_joints(x)
        return x

    def open_joints(self, unknowns: FloatArray) -> None:  # noqa: D102
        self._robots.opening.zero_()
        self.load_factor.zero_()
        self._robots.opening.assign(self.evaluate(unknowns)[0])

    def close_joints(self, loading: Loading) -> None:  # noqa: D102
        self._robots.loading.fill_(int(loading))

    def shut_joints(self) -> None:  # noqa: D102
        self._robots.opening.zero_()

    def unloaded_inputs(self) -> FloatArray | None:  # noqa: D102
        if self._inputs.profiles:
            return None
        rows = self.read("inputs")
        for name in (*kernels.PLATFORM_VECTORS[:4], *kernels.LEG_VECTORS):
            rows[:, self._places[name]] = 0.0
        return rows

    @staticmethod
    def _around(numbers: IntArray) -> FloatArray:
        """Those of ``crowded``, but none for the first; shape (k, 6)."""
        return np.where(numbers[:, None] == 0, 0.0, crowded(numbers))

    @contextmanager
    def _unloaded(self) -> Iterator[None]:
        """Within it, all instances may be evaluated without loads; everything is as it was afterwards."""
        records, listed = self.snapshot(), self.order.numpy()[: self.listed].copy()
        outputs = (self.fault, self.step_count, self.residual_directions, self.pose_columns)
        kept = (self.active, self.load_factor, self._robots.opening, self._robots.loading, *outputs)
        values = [np.array(array.numpy()) for array in kept]
        everything = len(listed) == self.instance_count
        if not everything:
            self.focus()
        self._robots.opening.zero_()
        self._robots.loading.fill_(int(Loading.RISING))
        self.active.fill_(1)
        self.load_factor.zero_()
        try:
            yield
        finally:
            self.restore(records)
            for array, before in zip(kept, values, strict=True):
                array.assign(before)
            if not everything:
                self.focus(listed)

    def _unloaded_legs(self) -> tuple[FloatArray, Legs, Attachments]:
        """Unknowns of legs that nothing holds, and what they say of how the legs bend; the problem is unloaded."""
        x = np.zeros((self.instance_count, self.unknown_count))
        for group in self.groups:
            unloaded = group.backbones.guess().reshape(self.instance_count, len(group.members), -1)
            for place, leg in enumerate(group.members):
                x[:, self._own[leg]] = unloaded[:, place]
        self.write("unknowns", x)
        self.integrate()
        return x, self._legs(), self._attachments()

    def _best(self, candidates: Sequence[FloatArray]) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Of several unknowns, for each instance those from which Newton's first step is shortest; residual and Gamma there."""
        n, shortest = self.unknown_count, np.full(self.instance_count, np.inf)
        x, residual, best = np.array(candidates[0]), np.zeros((self.instance_count, n)), np.zeros((self.instance_count, n, n))
        for candidate in candidates:
            found, gamma = self.evaluate(candidate)
            regular = np.isfinite(found).all(axis=1) & (np.linalg.slogdet(np.nan_to_num(gamma))[0] != 0)
            length = np.full(self.instance_count, 1e300)  # a singular start is better than none
            length[regular] = np.linalg.norm(np.linalg.solve(gamma[regular], found[regular][..., None])[..., 0], axis=1)
            better = length < shortest
            x[better], residual[better], best[better] = candidate[better], found[better], gamma[better]
            shortest[better] = length[better]
        return x, residual, best

    def _bent(self, unloaded: FloatArray, legs: Legs, at: Attachments) -> FloatArray:
        """Unknowns of the unloaded legs, and what closes their joints if they are beams."""
        x = np.array(unloaded)
        if self.inverse:
            pose = self.read("inputs")[:, self._places["platform_position"].start :][:, :POSE]
            reach, added = beam_reach(legs, at, pose[:, :3], matrices(pose[:, 3:]))
            x[:, self._platform] = reach / legs.length**2
        else:
            position, rotation, added = beam_equilibrium(legs, at, *fitted_platform(legs, at))
            x[:, self._platform] = self._pose_unknowns(position, rotation)
        for own, values in zip(self._own, added, strict=True):
            x[:, own] += values
        return x

    def _pose_unknowns(self, position: FloatArray, rotation: FloatArray) -> FloatArray:
        """The platform's unknowns (instance_count, 6) at a pose: (1), (2) solved for them."""
        length = np.broadcast_to(self._length[:, -1:], (self.instance_count, 1))
        turn = rotation_vectors(rotation @ np.swapaxes(self._reference[1], 1, 2))
        move = position - self._reference[0]
        return np.concatenate([move / length**2, turn / length], axis=1)

    def _legs(self) -> Legs:
        """What the last integration says of the legs."""
        count, legs = self.instance_count, len(self.geometry.legs)
        position, rotation = np.zeros((count, legs, 3)), np.zeros((count, legs, 3, 3))
        flexibility = np.zeros((count, legs, 6, 6))
        by_wrench: list[FloatArray] = [np.zeros(0)] * legs
        for group in self.groups:
            own, members = group.backbones, list(group.members)
            m, shape = own.unknown_count, (count, len(members))
            torques = own.read("gamma").reshape(*shape, m, m)[:, :, POSE:]
            loads = np.concatenate([own.wrench_columns.numpy().reshape(*shape, POSE, -1)[..., :m], torques], axis=2)
            unknowns = np.linalg.solve(loads, np.broadcast_to(np.eye(m, POSE), (*shape, m, POSE)))
            flexibility[:, members] = own.pose_columns.numpy().reshape(*shape, POSE, -1)[..., :m] @ unknowns
            position[:, members] = own.read("position").reshape(*shape, 3)
            rotation[:, members] = own.read("rotation").reshape(*shape, 3, 3)
            for place, leg in enumerate(members):
                by_wrench[leg] = unknowns[:, place]
        length, stiffness = (np.broadcast_to(scale[:, :legs], (count, legs)) for scale in (self._length, self._stiffness))
        return Legs(position, rotation, flexibility, by_wrench, length, stiffness)

    def _attachments(self) -> Attachments:
        count, legs = self.instance_count, len(self.geometry.legs)
        arm = np.broadcast_to(self._robots.attachment_position.numpy(), (count, legs, 3))
        frame = np.broadcast_to(self._robots.attachment_rotation.numpy(), (count, legs, 3, 3))
        return Attachments(arm, frame, self.geometry.joints, self.geometry.axes)

    def curvature_scale(self) -> FloatArray:  # noqa: D102
        own = [group.backbones.curvature_scale().reshape(self.instance_count, -1) for group in self.groups]
        return np.asarray(np.concatenate(own, axis=1).max(axis=1))

    def load_scale(self) -> FloatArray:  # noqa: D102
        inputs = self.read("inputs")
        length = np.broadcast_to(self._length[:, -1], self.instance_count)
        stiffness = np.broadcast_to(self._stiffness[:, -1], self.instance_count)
        force = sum(np.linalg.norm(inputs[:, self._places[name]], axis=1) for name in ("tip_force", "follower_force"))
        moment = sum(np.linalg.norm(inputs[:, self._places[name]], axis=1) for name in ("tip_moment", "follower_moment"))
        weight = self.geometry.mass * np.linalg.norm(inputs[:, self._places["gravity"]], axis=1)
        total = (np.asarray(force) + weight) * length**2 / stiffness + np.asarray(moment) * length / stiffness
        for group in self.groups:
            own = group.backbones.load_scale().reshape(self.instance_count, -1)
            total += own.max(axis=1)
        return np.asarray(total)

    def shapes(self, node_count: int) -> tuple[tuple[Shape, ...], FloatArray]:  # noqa: D102
        self._spread()
        count = self.instance_count
        found: list[Shape | None] = [None] * len(self.geometry.rods)
        energy = np.zeros(count)
        for group in self.groups:
            shapes, own = group.backbones.shapes(node_count)
            energy += own.reshape(count, -1).sum(axis=1)
            for i, shape in enumerate(shapes):
                for place, leg in enumerate(group.members):
                    values = {name: v.reshape(count, -1, *v.shape[1:])[:, place] for name, v in vars(shape).items()}
                    found[self.geometry.first_rod[leg] + i] = Shape(**values)
        return tuple(shape for shape in found if shape is not None), energy

    def input_columns(self, name: str) -> tuple[FloatArray, FloatArray]:
        """What ``BoundaryProblem.input_columns`` says; what acts on one leg alone shares its column with the same of all other legs."""
        geometry, place = self.geometry, self._places[name]
        if name not in PER_ROD:
            return super().input_columns(name)
        first, legs, rods = geometry.first_rod, len(geometry.legs), len(geometry.rods)
        directions = np.zeros(self.directions.shape)
        for leg in range(legs):
            for k in range(first[leg + 1] - first[leg]):
                directions[:, k, place.start + first[leg] + k] = 1.0
        self.directions.assign(directions)
        self.integrate()
        count = self.instance_count
        columns = self.residual_directions.numpy()
        law = self._robots.law.numpy().reshape(count, legs, -1)[:, :, kernels.DIRECTIONS_AT :].reshape(count, legs, -1, 2, 3)
        # (8) of one leg's pull and twist on the platform
        scale = np.stack([self._length[:, -1], np.ones(len(self._length))], axis=1) / self._stiffness[:, -1:]
        slopes = np.zeros((count, self.unknown_count, rods))
        for leg, own in enumerate(self._own):
            for k in range(first[leg + 1] - first[leg]):
                slopes[:, own, first[leg] + k] = columns[:, own, k]
                slopes[:, self._platform, first[leg] + k] = (scale[:, :, None] * law[:, leg, k]).reshape(count, POSE)
        return slopes, np.zeros((count, POSE, rods))

    # ---- stability ----

    def modes(self) -> Modes:  # noqa: D102
        self._spread()
        rotation = self._pose()[1]
        count, legs = self.instance_count, len(self.geometry.legs)
        at = self._attachments()
        arms = np.einsum("bij,blj->bli", rotation, at.arm)
        axes = np.einsum("bij,bljk,lk->bli", rotation, at.frame, at.axes)
        held: list[HeldLeg | None] = [None] * legs
        for group in self.groups:
            form, _ = group.backbones.condensed_form()
            wrench = group.backbones.tip_wrench.numpy().reshape(count, -1, 6)
            for place, leg in enumerate(group.members):
                own = CondensedForm(*(v.reshape(count, -1, *v.shape[1:])[:, place] for v in vars(form).values()))
                force, moment = wrench[:, place, :3], wrench[:, place, 3:]
                held[leg] = HeldLeg(own, force, moment, arms[:, leg], int(at.joints[leg]), axes[:, leg])
        length, stiffness = self._scale()
        return platform_modes(
            [leg for leg in held if leg is not None], self._loads(rotation), length, stiffness, self.has_potential
        )

    @property
    def has_potential(self) -> NDArray[np.bool_]:
        """Whether the loads derive from one, shape (instance_count,)."""
        inputs = self.read("inputs")
        without = ("tip_moment", "follower_force", "follower_moment")
        result = ~np.column_stack([inputs[:, self._places[name]] for name in without]).any(axis=1)
        for group in self.groups:
            result &= group.backbones.has_potential.reshape(self.instance_count, -1).all(axis=1)
        return np.asarray(result)

    def potential(self) -> FloatArray:
        """Elastic energy less the work of dead forces [J]: on the legs from their bases, on the platform from where its pose is zero."""
        self._spread()
        position, rotation = self._pose()
        total = np.zeros(self.instance_count)
        for group in self.groups:
            for part in group.backbones.stored_and_lost():
                total += part.reshape(self.instance_count, -1).sum(axis=1)
        origin, start = self._reference
        for (force, arm), local in zip(
            self._loads(rotation).forces, self._loads(np.broadcast_to(start, rotation.shape)).forces, strict=True
        ):
            total -= (force * (position + arm - origin - local[1])).sum(axis=1)
        return np.where(self.has_potential, total, np.nan)

    @property
    def multistable(self) -> bool:  # noqa: D102
        return not self.inverse

    @property
    def guess_is_stable(self) -> bool:  # noqa: D102
        return self.inverse  # where every result is tested, whatever it began at

    @property
    def results_are_tested(self) -> bool:
        """Of the inverse problem: with the platform held, no mode of ``Gamma`` vanishes where the robot loses stability."""
        return self.inverse

    def refusals(self, settled: NDArray[np.bool_]) -> NDArray[np.int32]:  # noqa: D102
        result = super().refusals(settled)
        if not self.inverse:
            return result
        if settled.any():
            result[settled & (self.modes().stability == Stability.UNSTABLE)] = Status.UNSTABLE
        length = self._length[:, :-1]
        translation = self.read("inputs")[:, self._places["translation"]] + length**2 * self.read("unknowns")[:, self._platform]
        low, high = self._limits
        outside = (translation < low) | (translation > high) | (length + translation <= 0)
        result[outside.any(axis=1)] = Status.OUT_OF_LIMITS
        return result

    @property
    def signs_add_up(self) -> bool:  # noqa: D102
        return False

    def starts(self, count: int, first: int = 0) -> FloatArray:
        """Poses of the platform around that of the unloaded robot, its legs taken for beams that reach there."""
        if self.inverse:
            return super().starts(count, first)
        middle = self._closed().unknowns
        with self._unloaded():
            x, legs, at = self._unloaded_legs()
        legs = legs.softened(COMPLIANCES[-1])
        points = crowded(np.arange(first, first + count))
        length = np.broadcast_to(self._length[:, -1:], (self.instance_count, 1))
        result = np.empty((count, *x.shape))
        for k, point in enumerate(points):
            result[k] = x
            pose = middle[:, self._platform] + point / np.concatenate([length] * 6, axis=1)
            result[k][:, self._platform] = pose
            position, rotation = self._pose_of(pose)
            for own, values in zip(self._own, beam_unknowns(legs, at, position, rotation), strict=True):
                result[k][:, own] += values
        return result

    def _scale(self) -> tuple[FloatArray, FloatArray]:
        """Mean length [m] and bending stiffness [N m^2] of the legs, shape (instance_count,)."""
        length, stiffness = (np.broadcast_to(v[:, -1], self.instance_count) for v in (self._length, self._stiffness))
        return length, stiffness / len(self.geometry.legs)

    def _spread(self) -> None:
        """Unknowns and inputs to the legs, without an integration."""
        for group in self.groups:
            record(lambda: kernels.spread, group.backbones.instance_count, [self._robots, group.table], self.device).launch()

    def _pose(self) -> tuple[FloatArray, FloatArray]:
        """(1), (2) Position (instance_count, 3) and rotation (instance_count, 3, 3) of the platform."""
        if self.inverse:
            pose = self.read("inputs")[:, self._places["platform_position"].start :][:, :POSE]
            return pose[:, :3], matrices(pose[:, 3:])
        return self._pose_of(self.read("unknowns")[:, self._platform])

    def _pose_of(self, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        """(1), (2) by the platform's unknowns."""
        length = np.broadcast_to(self._length[:, -1:], (self.instance_count, 1))
        turned = matrices(length * x[:, 3:]) @ self._reference[1]
        return self._reference[0] + length**2 * x[:, :3], turned

    def _loads(self, rotation: FloatArray) -> PlatformLoads:
        inputs = self.read("inputs")
        force, follower, moment, point = (
            inputs[:, self._places[name]] for name in ("tip_force", "follower_force", "follower_moment", "force_point")
        )
        weight = self.geometry.mass * inputs[:, self._places["gravity"]]
        follower, moment, point = (np.einsum("bij,bj->bi", rotation, v) for v in (follower, moment, point))
        return PlatformLoads([(force, point), (weight, rotation @ self.geometry.mass_centre)], follower, moment)


def _blocks(geometry: Geometry) -> list[Block]:
    """One block a leg, then the platform's.

    A straight inextensible leg does not answer a force along itself: that force and the gap along the base belong to the
    platform, and what is left of each leg is regular by itself.
    """
    first = geometry.first_unknown
    blocks, along, gaps = [], [], []
    for k, (start, end) in enumerate(pairwise(first)):
        own = np.arange(start, end)
        blocks.append(Block(f"leg {k + 1}", own[:-1], np.delete(own, 2), int(geometry.first_rod[k + 1]) - 1))
        along.append(end - 1)
        gaps.append(start + 2)
    pose = np.arange(first[-1], first[-1] + POSE)
    return [*blocks, Block("platform", np.concatenate([along, pose]), np.concatenate([gaps, pose]))]


def input_places(rod_count: int, inverse: bool) -> dict[str, slice]:
    """Where each input stands in a row; one number more, the scale of load profiles, comes last."""
    places = {"rotation": slice(0, rod_count), "translation": slice(rod_count, 2 * rod_count)}
    vectors = (*(kernels.POSE_VECTORS if inverse else ()), *kernels.PLATFORM_VECTORS, *kernels.LEG_VECTORS)
    for k, name in enumerate(vectors):
        places[name] = slice(2 * rod_count + 3 * k, 2 * rod_count + 3 * k + 3)
    return places


PLATFORM_INPUTS = (
    InputSpec(name="tip_force", unit="N", description="dead force on the platform at force_point, world frame"),
    InputSpec(name="tip_moment", unit="N m", description="dead moment on the platform, world frame"),
    InputSpec(name="follower_force", unit="N", description="force on the platform at force_point, fixed in its frame"),
    InputSpec(name="follower_moment", unit="N m", description="moment on the platform, fixed in its frame"),
    InputSpec(name="force_point", unit="m", description="where forces act on the platform, platform frame"),
)
