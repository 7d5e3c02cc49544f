"""Several backbones that hold one platform: the boundary problem, its buffers and launches."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from copy import copy
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from multirod.batch import IntArray, take
from multirod.capabilities import LineTest, Loading, ResultTest, Shapes
from multirod.inputs import Inputs, InputSpec
from multirod.integrators import Integrator
from multirod.kernels.shared import Shared
from multirod.launch import record
from multirod.models.backbone.assembly import BackboneAssembly
from multirod.models.backbone.derivatives.designs import COMPONENTS, turned_loads
from multirod.models.backbone.derivatives.ends import move_ends, ways_back
from multirod.models.backbone.equal_steps import PartsAtEqualSteps
from multirod.models.backbone.inputs import BACKBONE_INPUTS, DRIVES
from multirod.models.backbone.kernels.layout.members import drive_slices
from multirod.models.backbone.kernels.layout.members import drives as drive_names
from multirod.models.backbone.members.driven import LinesOfGroups
from multirod.models.backbone.problem import BackboneProblem
from multirod.models.backbone.starts import twisted
from multirod.models.platform import platform_kernels as kernels
from multirod.models.platform.along import LegSensing, columns_along
from multirod.models.platform.clamps import PlatformClamps
from multirod.models.platform.conjugates import PlatformConjugates
from multirod.models.platform.designs import (
    PARAMETERS,
    PLACES,
    Places,
    design_rows,
    most_sections,
    unknown_rates,
)
from multirod.models.platform.guess import (
    COMPLIANCES,
    SHORT,
    Attachments,
    BeamEquilibrium,
    Legs,
    beam_reach,
    fitted_platform,
    nearest_rotation,
    rotation_vectors,
)
from multirod.models.platform.stability import InverseTest, PlatformStability
from multirod.models.platform.starting import PlatformJoints, PlatformStarts
from multirod.problem import Block, BoundaryProblem, Shape
from multirod.rod import RodArrays, stack
from multirod.rotations import matrices
from multirod.validation import FloatArray, frozen

POSE = kernels.POSE
PER_ROD = ("rotation", "translation")
LEG_INPUTS = tuple(spec for spec in BACKBONE_INPUTS if spec.acts in ("base", "along"))  # what acts on a leg itself


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
        # what drives the lines of each leg, by the names of inputs
        self.drives = [drive_names(leg.arrays.members) for leg in self.legs]
        self.first_unknown: NDArray[np.intp] = frozen(
            np.cumsum([0] + [leg.rod_count + 5 + sum(kind.conditioned for kind in leg.arrays.members) for leg in self.legs])
        )

    def first_drive(self, name: str) -> NDArray[np.intp]:
        """The first of the lines of each leg among those of all that are driven by an input, and their number, (leg + 1,)."""
        return np.cumsum([0, *(own.count(name) for own in self.drives)])

    def reference(self) -> tuple[FloatArray, FloatArray]:
        """Position [m] and rotation where the unknown pose is zero, shapes (..., 3), (..., 3, 3): the same whatever the
        inputs."""
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
        inputs: Packed, what is no load, shape (instance_count, k).
        unknowns: [1/m], shape (instance_count, n).
        residual: What is left of it there [1/m], shape (instance_count, n).
        singular_value: Smallest of ``Gamma`` there, 1 at most, shape (instance_count,).
        tried: How many guesses were looked at, shape (instance_count,).
    """

    inputs: FloatArray
    unknowns: FloatArray
    residual: FloatArray
    singular_value: FloatArray
    tried: NDArray[np.int_]


@dataclass(frozen=True)
class InputColumns:
    """Where the columns by an input stand among the directions of a problem.

    Attributes:
        name: Of the input.
        start: Its first direction.
        size: How many it takes.
        shares: First of its numbers, and how many, of each leg; of all together where these share it.
        shared: Whether legs share it: if not, legs share its directions.
        on_legs: Whether it acts on legs.
    """

    name: str
    start: int
    size: int
    shares: tuple[tuple[int, int], ...]
    shared: bool
    on_legs: bool

    @property
    def numbers(self) -> int:
        """Of an instance."""
        return sum(self.shares[-1])

    @property
    def own(self) -> slice:
        """Its directions."""
        return slice(self.start, self.start + self.size)

    @property
    def is_parameter(self) -> bool:
        """Whether it is no input."""
        return self.name in PARAMETERS


def input_columns(geometry: Geometry, names: Sequence[str]) -> list[InputColumns]:
    """Where the columns of each input stand, in the order named: those that touch legs before the others."""
    found: dict[int, InputColumns] = {}
    start = 0
    for touching in (True, False):
        for k, name in enumerate(names):
            on_legs = name in (*PER_ROD, *DRIVES, *kernels.LEG_VECTORS, *COMPONENTS, "base")
            if on_legs is not touching:
                continue
            ends = _ends(geometry, name)
            shares = ((0, 3),) if ends is None else tuple((a, b - a) for a, b in pairwise(ends.tolist()))
            size = 0 if name == "platform" else max(count for _, count in shares)
            found[k] = InputColumns(name, start, size, shares, ends is None, on_legs)
            start += size
    return [found[k] for k in range(len(names))]


def _ends(geometry: Geometry, name: str) -> NDArray[np.intp] | None:
    """First of the numbers of each leg, and their end, (leg + 1,); None of what legs share."""
    if name in PER_ROD:
        return geometry.first_rod
    if name in DRIVES:
        return geometry.first_drive(name)
    if name in COMPONENTS:
        return np.asarray(geometry.first_rod * most_sections(geometry) * COMPONENTS[name])
    return np.arange(len(geometry.legs) + 1) * POSE if name in PLACES else None


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
            pieces=problem.pieces,
            first_moment=np.tile(3 * (problem.pieces - 1) * np.array(members), problem.instance_count),
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
        legs.drives = own.first_drive
        legs.drive = wp.array(problem.places_of_drives(self.members), dtype=wp.int32, device=device)
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

    def renew(self, vectors: FloatArray) -> None:
        """As new, with what acts along the legs, shape (instance_count, 9)."""
        own = self.backbones
        own._clear()
        rows = np.zeros((own.instance_count, own.input_count))
        rows[:, self.table.vectors : self.table.vectors + vectors.shape[1]] = np.repeat(vectors, len(self.members), axis=0)
        rows[:, -1] = 1.0
        own.write("inputs", rows)


class ParallelProblem(BoundaryProblem):
    """Legs whose tips are joined to one platform.

    Unknowns are those of each leg (``docs/model.md``, equation 10, then its base force), then the pose of the platform
    (``docs/parallel.md``, equations 1 and 2); residuals those of each leg's joint and torques, then the platform's
    equilibrium. ``Gamma`` is an arrow: legs meet only at the platform. In the inverse problem the pose is an input, and the
    translation of each leg is unknown in its place.
    """

    columns_in_place = False

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
        lengths: bool = False,
        design: bool = False,
        enabled: Sequence[str] = (),
        pieces: int = 1,
    ) -> None:
        if pieces > 1:
            direction_count = 3 * (pieces - 1) * len(geometry.legs)
        self.pieces = pieces
        self.leg_direction_count = direction_count if leg_direction_count is None else leg_direction_count
        self.geometry = geometry
        self.inverse = inverse
        self.limits = np.array([-np.inf, np.inf])[:, None] if limits is None else limits
        self._places = input_places(len(geometry.rods), inverse, [name for own in geometry.drives for name in own])
        first = [int(k) for k in geometry.first_unknown]
        # what each leg's unknowns are: its own, in the order of the arrow
        self.own = [slice(a, b) for a, b in pairwise(first)]
        self.platform = slice(first[-1], first[-1] + POSE)
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
        self.inputs_given = inputs
        self.options: dict[str, Any] = {
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
            "lengths": lengths,
            "design": design,
            "enabled": [name for name in kernels.LEG_VECTORS if name in enabled or inputs.is_active(name)],
        }
        builds: dict[tuple[Any, ...], list[int]] = {}
        for k, leg in enumerate(geometry.legs):
            builds.setdefault((leg.rod_count, leg.transmission, leg.arrays.members, leg.arrays.member_rods), []).append(k)
        self.groups = [LegGroup(self, members, inputs, options) for members in builds.values()]
        self.rounding = self.groups[0].backbones.rounding
        self.measured = inputs.measured
        self._found: Closed | None = None
        self._followed: tuple[str, ...] = ()  # what directions by inputs and unknowns are by
        self.robots = self._make_robots()
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
        self.reference = batched(position, (3,)), batched(rotation, (3, 3))
        robots.reference_position = array(self.reference[0], wp.vec3d)
        robots.reference_rotation = array(self.reference[1], wp.mat33d)
        robots.attachment_position = array(platform[:, :, :3, 3], wp.vec3d)
        robots.attachment_rotation = array(platform[:, :, :3, :3], wp.mat33d)
        robots.joint = array(geometry.joints, wp.int32)
        robots.axis = array(geometry.axes, wp.vec3d)
        length, stiffness = geometry.scales()
        self.length = batched(length.reshape(*geometry.batch_shape, legs + 1), (legs + 1,))
        self.stiffness = batched(stiffness.reshape(*geometry.batch_shape, legs + 1), (legs + 1,))
        robots.length, robots.stiffness = array(self.length), array(self.stiffness)
        robots.mass = geometry.mass
        robots.mass_centre = wp.vec3d(*geometry.mass_centre)
        robots.pose = self._places["platform_position"].start if self.inverse else 0
        robots.loads = self._places[kernels.PLATFORM_VECTORS[0]].start
        robots.leg_vectors = self._places[kernels.LEG_VECTORS[0]].start
        robots.opening = wp.zeros((count, self.unknown_count), dtype=wp.float64, device=device)
        robots.soft = wp.zeros(count, dtype=wp.float64, device=device)
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
            launches.append(recorded(kernels.hand_over, dim, self.robots, group.table))
            launches.append(group.backbones.launch)
            launches.append(recorded(kernels.attach, dim, self.robots, group.table))
        launches.append(recorded(kernels.balance, self.instance_count, self.robots))
        return launches

    # ---- what is offered ----

    @property
    def stability(self) -> PlatformStability:  # noqa: D102
        return PlatformStability(self)

    @property
    def lines(self) -> "PlatformLines":  # noqa: D102
        return PlatformLines(self)

    @property
    def shapes(self) -> "PlatformShapes":  # noqa: D102
        return PlatformShapes(self)

    @property
    def parts(self) -> "PlatformParts":  # noqa: D102
        return PlatformParts(self)

    @cached_property
    def conjugates(self) -> PlatformConjugates | None:
        """None of the inverse problem: its platform does not give way to what acts on it."""
        return None if self.inverse or not self.pose_sensitivities else PlatformConjugates(self)

    @cached_property
    def clamps(self) -> PlatformClamps | None:  # noqa: D102
        return PlatformClamps(self) if self.pieces > 1 else None

    @property
    def joints(self) -> PlatformJoints:  # noqa: D102
        return PlatformJoints(self)

    @property
    def starts(self) -> PlatformStarts | None:
        """None of the inverse problem: its platform is where it is to be."""
        return None if self.inverse else PlatformStarts(self)

    @property
    def result_test(self) -> ResultTest | None:  # noqa: D102
        if self.inverse:
            return InverseTest(self)
        between_discs = any(group.backbones.features.discs and group.backbones.features.condition_count for group in self.groups)
        return LineTest(self.lines) if between_discs else None

    @property
    def kinks(self) -> NDArray[np.intp]:  # noqa: D102
        own = [self.own[leg].start + group.backbones.kinks for group in self.groups for leg in group.members]
        return np.sort(np.concatenate(own))

    # ---- the interface ----

    def _pass_over(self, instances: IntArray | None) -> None:
        super()._pass_over(instances)
        launches = iter(self._launches)
        for group in self.groups:
            count = len(group.members)
            rows = None if instances is None else (np.asarray(instances)[:, None] * count + np.arange(count)).reshape(-1)
            group.backbones._pass_over(rows)
            for _ in range(3):
                next(launches).set_dim(group.backbones.listed)
        next(launches).set_dim(self.listed)

    @property
    def launches(self) -> tuple[Any, ...] | None:  # noqa: D102
        return None if self._followed else self._bare

    @cached_property
    def _bare(self) -> tuple[Any, ...] | None:
        """Launches one after another, where those of the legs are one each."""
        legs = [group.backbones.launches for group in self.groups]
        result: list[Any] = []
        for k, own in enumerate(legs):
            if own is None:
                return None
            result += [self._launches[3 * k], *own, self._launches[3 * k + 2]]
        return (*result, self._launches[-1])

    def _integrate(self) -> None:
        self.integrate_by([group.backbones.launch for group in self.groups])

    def integrate_by(self, legs: Sequence[Any]) -> None:
        """An integration in which these launches integrate the legs of each build."""
        if self._followed:
            for launch in self._launches[:-1:3]:
                launch.launch()
            self._aim(self._followed)
        for group in self.groups:
            group.backbones.stop = self.stop
        launches = list(self._launches)
        launches[1:-1:3] = legs
        for launch in launches:
            launch.launch()

    def renew(self, inputs: Inputs) -> bool:  # noqa: D102
        if inputs.profiles or self.inputs_given.profiles:
            return False
        self._clear()
        self.__dict__.pop("conjugates", None)
        self.inputs_given = inputs
        rows = self.pack(inputs)
        self.write("inputs", rows)
        for group in self.groups:
            group.renew(rows[:, self._places[kernels.LEG_VECTORS[0]].start : self._places[kernels.LEG_VECTORS[-1]].stop])
        return True

    def _zeros(self) -> list[Any]:
        own = self.robots
        return [*super()._zeros(), own.opening, own.soft, own.loading, own.law, own.leg_fault, own.leg_step_count]

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
        closed = self.closed()
        self._set_aside["opening"].write(closed.residual)
        self._set_aside["soft"].write(0.0)
        return np.array(closed.unknowns)

    @property
    def guess_integrations(self) -> NDArray[np.int_] | int:  # noqa: D102
        return 1 + (len(COMPLIANCES) if self._found is None else self._found.tried)

    @property
    def held_forces(self) -> IntArray:  # noqa: D102
        return np.concatenate([np.arange(own.stop - 3, own.stop) for own in self.own])

    @property
    def natural_singular_value(self) -> FloatArray:
        """That at ``guess``: legs that are long and thin answer a force along themselves by bending alone."""
        return self.closed().singular_value

    def closed(self) -> "Closed":
        """The unloaded robot at the present inputs; found once for all who ask."""
        inputs = self.read("inputs")[:, : self.robots.loads]
        if self._found is None or not np.array_equal(self._found.inputs, inputs):
            with self.unloaded():
                x, legs, at = self.unloaded_legs()
                candidates = self._bent(x, legs, at)
                x, residual, gamma, tried = self._best(candidates)
            sound = np.isfinite(gamma).all(axis=(1, 2))
            least = np.ones(self.instance_count)
            least[sound] = np.minimum(1.0, np.linalg.svd(gamma[sound], compute_uv=False)[:, -1])
            self._found = Closed(inputs, x, residual, least, tried)
        return self._found

    @contextmanager
    def unloaded(self) -> Iterator[None]:
        """Within it, all instances may be evaluated without loads; everything is as it was afterwards."""
        records = self.snapshot()
        aside = self._set_aside
        for shared in aside.values():
            shared.fetch()
        values = {name: shared.values.copy() for name, shared in aside.items()}
        aside["active"].write(1)
        aside["loading"].write(int(Loading.RISING))
        for name in ("load_factor", "opening", "soft"):
            aside[name].write(0.0)
        try:
            with self.focused():
                yield
        finally:
            self.restore(records)
            for name, before in values.items():
                aside[name].write(before)

    @cached_property
    def _set_aside(self) -> dict[str, Shared]:
        """What is another within ``unloaded``: which are active, at which load, how far open, how loaded; then what launches
        write."""
        arrays = {name: getattr(self.robots, name) for name in ("opening", "soft", "loading")}
        names = ("active", "load_factor", "fault", "step_count", "residual_directions", "pose_columns")
        return {name: Shared.of(array) for name, array in (arrays | {name: getattr(self, name) for name in names}).items()}

    def twisted(self, x: FloatArray, numbers: IntArray) -> FloatArray:
        """Unknowns with the tubes of legs turned against each other, as ``models.backbone.starts.twisted`` has it."""
        every = np.arange(self.unknown_count)
        members = [(group.backbones, list(group.members)) for group in self.groups]
        return twisted(members, x, numbers, lambda leg: every[self.own[leg]])

    def unloaded_legs(self) -> tuple[FloatArray, Legs, Attachments]:
        """Unknowns of legs that nothing holds, and what they say of how the legs bend; the problem is unloaded."""
        x = np.zeros((self.instance_count, self.unknown_count))
        for group in self.groups:
            unloaded = group.backbones.guess().reshape(self.instance_count, len(group.members), -1)
            for place, leg in enumerate(group.members):
                x[:, self.own[leg]] = unloaded[:, place]
        self.write("unknowns", x)
        self.integrate()
        return x, self._legs(), self.attachments()

    def _best(self, candidates: Sequence[FloatArray]) -> tuple[FloatArray, FloatArray, FloatArray, NDArray[np.int_]]:
        """Of several unknowns, for each instance those from which Newton's first step is shortest; residual and Gamma there, and
        how many it looked at: none after one from which it is short."""
        count, n = self.instance_count, self.unknown_count
        shortest, tried, open_ = np.full(count, np.inf), np.zeros(count, dtype=int), np.ones(count, dtype=bool)
        x, residual, best = np.array(candidates[0]), np.zeros((count, n)), np.zeros((count, n, n))
        for candidate in candidates:
            with self.only(open_):
                found, gamma = self.evaluate(candidate)
            regular = open_ & np.isfinite(found).all(axis=1) & (np.linalg.slogdet(np.nan_to_num(gamma))[0] != 0)
            length = np.full(count, 1e300)  # a singular start is better than none
            length[regular] = np.linalg.norm(np.linalg.solve(gamma[regular], found[regular][..., None])[..., 0], axis=1)
            better = open_ & (length < shortest)
            x[better], residual[better], best[better] = candidate[better], found[better], gamma[better]
            shortest[better] = length[better]
            tried += open_
            open_ &= length > SHORT * np.linalg.norm(candidate, axis=1)
            if not open_.any():
                break
        return x, residual, best, tried

    def _bent(self, unloaded: FloatArray, legs: Legs, at: Attachments) -> Sequence[FloatArray]:
        """Unknowns of the unloaded legs, and what closes their joints if they are beams, for each of ``COMPLIANCES``."""
        ways = len(COMPLIANCES)
        x = np.concatenate([unloaded] * ways)
        start = None if self.inverse else fitted_platform(legs, at)
        legs, at = legs.softened(COMPLIANCES), at.repeated(ways)
        if start is None:
            pose = np.concatenate([self.read("inputs")[:, self._places["platform_position"].start :][:, :POSE]] * ways)
            reach, added = beam_reach(legs, at, pose[:, :3], matrices(pose[:, 3:]))
            x[:, self.platform] = reach / legs.length**2
        else:
            shape = (ways * self.instance_count, len(self.geometry.legs))
            beams = self.tool(("BeamEquilibrium", *shape), lambda: BeamEquilibrium(*shape))
            position, rotation, added = beams.found(legs, at, *(np.concatenate([value] * ways) for value in start))
            x[:, self.platform] = self.pose_unknowns(position, rotation)
        for own, values in zip(self.own, added, strict=True):
            x[:, own] += values
        return np.split(x, ways)

    def pose_unknowns(self, position: FloatArray, rotation: FloatArray) -> FloatArray:
        """The platform's unknowns (k, 6) at poses, all instances once or several times: (1), (2) solved for them."""
        length, origin, start = (
            v if len(v) == 1 else np.concatenate([v] * (len(position) // len(v))) for v in (self.length[:, -1:], *self.reference)
        )
        turn = rotation_vectors(rotation @ np.swapaxes(start, 1, 2))
        return np.concatenate([(position - origin) / length**2, turn / length], axis=1)

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
        length, stiffness = (np.broadcast_to(scale[:, :legs], (count, legs)) for scale in (self.length, self.stiffness))
        return Legs(position, rotation, flexibility, by_wrench, length, stiffness)

    def attachments(self) -> Attachments:
        """Where each leg is joined to the platform, and how."""
        count, legs = self.instance_count, len(self.geometry.legs)
        arm = np.broadcast_to(self.robots.attachment_position.numpy(), (count, legs, 3))
        frame = np.broadcast_to(self.robots.attachment_rotation.numpy(), (count, legs, 3, 3))
        return Attachments(arm, frame, self.geometry.joints, self.geometry.axes)

    def curvature_scale(self) -> FloatArray:  # noqa: D102
        own = [group.backbones.curvature_scale().reshape(self.instance_count, -1) for group in self.groups]
        return np.asarray(np.concatenate(own, axis=1).max(axis=1))

    def load_level(self) -> FloatArray:
        """What multiplies all loads, shape (instance_count,)."""
        loading = self._set_aside["loading"].fetched()
        return np.where(loading == Loading.NONE, 0.0, np.where(loading == Loading.FULL, 1.0, self.buffer("load_factor")))

    def load_scale(self) -> FloatArray:  # noqa: D102
        inputs = self.read("inputs")
        length = np.broadcast_to(self.length[:, -1], self.instance_count)
        stiffness = np.broadcast_to(self.stiffness[:, -1], self.instance_count)
        weight = self.geometry.mass * np.linalg.norm(inputs[:, self._places["gravity"]], axis=1)
        total = weight * length**2 / stiffness
        for spec in PLATFORM_INPUTS:
            if spec.load is not None:
                total += np.linalg.norm(inputs[:, self._places[spec.name]], axis=1) * length**spec.power / stiffness
        for group in self.groups:
            own = group.backbones.load_scale().reshape(self.instance_count, -1)
            total += own.max(axis=1)
        return np.asarray(total)

    def places_of_drives(self, legs: Sequence[int]) -> NDArray[np.int32]:
        """Where in a row of inputs that of each line of these legs stands, (leg, line), in the order of a leg's own row."""
        rows = []
        for leg in legs:
            row: list[int] = []
            for name, own in drive_slices(self.geometry.drives[leg]).items():
                first = self._places[name].start + int(self.geometry.first_drive(name)[leg])
                row += range(first, first + own.stop - own.start)
            rows.append(row)
        return np.array(rows, dtype=np.int32).reshape(len(rows), -1)

    def part_ends(self, names: Sequence[str]) -> FloatArray:  # noqa: D102
        furthest = super().part_ends(names)
        if not move_ends(names):
            return furthest
        inputs, start = self.read("inputs"), self.input_slice("translation").start
        for arrays, (first, end) in zip(self.geometry.arrays, pairwise(self.geometry.first_rod.tolist()), strict=True):
            own = slice(start + first, start + end)
            back = ways_back(arrays, inputs[:, own])
            inputs[:, own] -= back
            furthest = np.maximum(furthest, 2 * back[:, -1])
        if furthest.any():
            self.write("inputs", inputs)
        return furthest

    def aim(self, *names: str) -> None:
        """As said; what acts on one leg alone shares its column with the same of all other legs, and columns that touch legs
        come first. What depends on inputs and unknowns is found at each integration."""
        self._followed = names if "base" in names or any(name in COMPONENTS for name in names) else ()
        if not self._followed:
            self._aim(names)

    def _aim(self, names: Sequence[str]) -> None:
        directions = np.zeros(self.directions.shape)
        every = input_columns(self.geometry, names)
        for columns in every:
            if columns.name == "base":
                directions[:, columns.own] = turned_loads(self, kernels.LEG_VECTORS)
            elif columns.name not in PARAMETERS:
                start = self._places[columns.name].start
                for first, count in columns.shares:
                    for k in range(count):
                        directions[:, columns.start + k, start + first + k] = 1.0
        for group in self.groups:
            self._aim_legs(group, [columns for columns in every if columns.name in COMPONENTS], directions)
        self.directions.assign(directions)

    def _aim_legs(self, group: LegGroup, every: Sequence[InputColumns], directions: FloatArray) -> None:
        """Along the legs' own numbers: in ``directions`` how they turn behind their plates, the rest to the legs themselves."""
        own = group.backbones
        width = own.directions.shape[2] - own.input_count
        if not width:
            return
        rows = np.zeros((self.instance_count, len(group.members), *own.directions.shape[1:]))
        turned = own.input_slice("rotation")
        for columns in every:
            found = design_rows(self, group, columns.name)
            there = slice(columns.start, columns.start + found.shape[2])
            rows[:, :, there, own.input_count :] = found[..., own.input_count :]
            for place, leg in enumerate(group.members):
                first = int(self.geometry.first_rod[leg])
                directions[:, there, first : first + len(own.rods)] = found[:, place, :, turned]
        own.directions.assign(rows.reshape(own.directions.shape))

    def aimed(self, *names: str) -> tuple[FloatArray, FloatArray]:
        """As said; by parameters too, the unknowns fixed."""
        found, given = super().aimed(*names)
        every = input_columns(self.geometry, names)
        slopes = np.concatenate([self._slopes(columns, found) for columns in every], axis=2)
        moved = np.concatenate(
            [given[:, :, columns.own] if columns.shared else np.zeros((len(given), POSE, columns.numbers)) for columns in every],
            axis=2,
        )
        if not self.eliminates and any(name in PARAMETERS for name in names):
            rates, n = unknown_rates(self, every), self.unknown_count
            slopes -= self.read("gamma").reshape(-1, n, n) @ rates
            moved -= self.pose_columns.numpy()[:, :, :n] @ rates
        return slopes, moved

    def _slopes(self, columns: "InputColumns", found: FloatArray) -> FloatArray:
        """Derivatives of the residual by each number of an input, shape (instance_count, n, numbers)."""
        if columns.shared:
            return found[:, :, columns.own]
        if columns.name == "platform":
            return Places(self).slopes("platform")
        count, legs = self.instance_count, len(self.geometry.legs)
        law = self.robots.law.numpy().reshape(count, legs, -1)[:, :, kernels.DIRECTIONS_AT :].reshape(count, legs, -1, 2, 3)
        # (8) of one leg's pull and twist on the platform
        scale = np.stack([self.length[:, -1], np.ones(len(self.length))], axis=1) / self.stiffness[:, -1:]
        slopes = np.zeros((count, self.unknown_count, columns.numbers))
        for leg, ((first, size), own) in enumerate(zip(columns.shares, self.own, strict=True)):
            for k in range(size):
                slopes[:, own, first + k] = found[:, own, columns.start + k]
                slopes[:, self.platform, first + k] = (scale[:, :, None] * law[:, leg, columns.start + k]).reshape(count, POSE)
        return slopes + Places(self).slopes("base") if columns.name == "base" else slopes

    def along(self, names: Sequence[str], rod: int, places: FloatArray) -> dict[str, FloatArray]:  # noqa: D102
        return columns_along(self, input_columns(self.geometry, names), rod, places)

    def sensing(self, places: FloatArray) -> LegSensing:  # noqa: D102
        return LegSensing(self, places)

    def sensed(self, made: LegSensing, names: Sequence[str], rod: int) -> tuple[FloatArray, FloatArray]:  # noqa: D102
        return made.curvature(input_columns(self.geometry, names), rod)

    def to_legs(self) -> None:
        """Unknowns and inputs to the legs, without an integration."""
        with self.focused():
            for launch in self._launches[:-1:3]:
                launch.launch()

    def pose(self) -> tuple[FloatArray, FloatArray]:
        """(1), (2) Position (instance_count, 3) and rotation (instance_count, 3, 3) of the platform."""
        if self.inverse:
            pose = self.read("inputs")[:, self._places["platform_position"].start :][:, :POSE]
            return pose[:, :3], matrices(pose[:, 3:])
        return self.pose_of(self.read("unknowns")[:, self.platform])

    def pose_of(self, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        """(1), (2) by the platform's unknowns."""
        length = np.broadcast_to(self.length[:, -1:], (self.instance_count, 1))
        turned = matrices(length * x[:, 3:]) @ self.reference[1]
        return self.reference[0] + length**2 * x[:, :3], turned


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


def input_places(rod_count: int, inverse: bool, drives: Sequence[str] = ()) -> dict[str, slice]:
    """Where each input stands in a row; one number more, the scale of load profiles, comes last."""
    places = {"rotation": slice(0, rod_count), "translation": slice(rod_count, 2 * rod_count)}
    vectors = (*(kernels.POSE_VECTORS if inverse else ()), *kernels.PLATFORM_VECTORS, *kernels.LEG_VECTORS)
    for k, name in enumerate(vectors):
        places[name] = slice(2 * rod_count + 3 * k, 2 * rod_count + 3 * k + 3)
    return places | drive_slices(drives, 2 * rod_count + 3 * len(vectors))


class PlatformParts(PartsAtEqualSteps[ParallelProblem]):
    """Of a ``ParallelProblem``."""

    def __init__(self, problem: ParallelProblem) -> None:
        super().__init__(problem, problem.integrator, [group.backbones for group in problem.groups])

    @property
    def may_be_clamped(self) -> bool:  # noqa: D102
        return not self.problem.inverse and all(group.backbones.may_be_clamped for group in self.problem.groups)

    def _part(self, instances: IntArray, integrator: Integrator, *, poses: bool, pieces: int = 1) -> ParallelProblem:
        geometry, inputs = (
            self.problem.geometry.take(self.problem.batch_shape, instances),
            self.problem.inputs_given.take(self.problem.batch_shape, instances),
        )
        options = {**self.problem.options, **({"pose_sensitivities": True} if poses else {})}
        result = ParallelProblem(geometry, inputs, integrator=integrator, pieces=pieces, **options)
        result.stop = self.problem.stop
        for name in ("inputs", "unknowns"):
            result.write(name, self.problem.read(name)[instances])
        for name in ("opening", "soft", "loading"):
            getattr(result.robots, name).assign(getattr(self.problem.robots, name).numpy()[instances])
        return result


class PlatformShapes(Shapes):
    """Of a ``ParallelProblem``: those of its legs."""

    def __init__(self, problem: ParallelProblem) -> None:
        self.problem = problem

    def at_nodes(self, node_count: int) -> tuple[tuple[Shape, ...], FloatArray]:  # noqa: D102
        self.problem.to_legs()
        count = self.problem.instance_count
        found: list[Shape | None] = [None] * len(self.problem.geometry.rods)
        energy = np.zeros(count)
        for group in self.problem.groups:
            shapes, own = group.backbones.shapes.at_nodes(node_count)
            energy += own.reshape(count, -1).sum(axis=1)
            for i, shape in enumerate(shapes):
                for place, leg in enumerate(group.members):
                    values = {name: v.reshape(count, -1, *v.shape[1:])[:, place] for name, v in vars(shape).items()}
                    found[self.problem.geometry.first_rod[leg] + i] = Shape(**values)
        return tuple(shape for shape in found if shape is not None), energy


class PlatformLines(LinesOfGroups[ParallelProblem]):
    """Of a ``ParallelProblem``: those of its legs."""

    def __init__(self, problem: ParallelProblem) -> None:
        super().__init__(problem, problem.geometry.drives)

    def hand_over(self) -> None:  # noqa: D102
        self.problem.to_legs()

    def length_columns(self, *names: str) -> FloatArray:
        """As said; of lines of legs, which touch neither the platform nor other legs."""
        problem = self.problem
        geometry, n = problem.geometry, problem.unknown_count
        every = input_columns(geometry, names)
        starts = np.cumsum([n, *(columns.numbers for columns in every)])
        result = np.zeros((problem.instance_count, int(self.first[-1]), int(starts[-1])))
        for group in problem.groups:
            if not group.backbones.drive_count:
                continue
            m, found = group.backbones.unknown_count, group.backbones.lines.length_columns()
            found = found.reshape(problem.instance_count, len(group.members), *found.shape[1:])
            for place, leg in enumerate(group.members):
                lines = slice(self.first[leg], self.first[leg + 1])
                result[:, lines, problem.own[leg]] = found[:, place, :, :m]
                if problem.inverse:  # by the translation that is unknown
                    result[:, lines, problem.platform.start + leg] = found[:, place, :, m + problem.leg_direction_count]
                for columns, start in zip(every, starts.tolist(), strict=False):
                    if columns.on_legs:
                        begin, count = columns.shares[0 if columns.shared else leg]
                        own = found[:, place, :, m + columns.start :][..., :count]
                        result[:, lines, start + begin : start + begin + count] = own
        return result


_ON_PLATFORM = {
    "tip_force": "dead force on the platform at force_point, world frame",
    "tip_moment": "dead moment on the platform, world frame",
    "follower_force": "force on the platform at force_point, fixed in its frame",
    "follower_moment": "moment on the platform, fixed in its frame",
}
PLATFORM_INPUTS = (
    *(
        replace(spec, description=_ON_PLATFORM[spec.name], dead_twin="")  # legs have the unknowns that a twin would save
        for spec in BACKBONE_INPUTS
        if spec.name in _ON_PLATFORM
    ),
    InputSpec(name="force_point", unit="m", acts="tip", description="where forces act on the platform, platform frame"),
)
