"""Several backbones that hold one platform: the boundary problem, its buffers and launches."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import ArrayLike, NDArray

from multirod.batch import IntArray
from multirod.capabilities import LineTest, Loading, ResultTest
from multirod.inputs import Inputs
from multirod.integrators import Integrator
from multirod.kernels.shared import Shared
from multirod.kernels.warp_types import Array, Struct
from multirod.launch import Launch, record
from multirod.models.backbone.derivatives.designs import COMPONENTS, turned_loads
from multirod.models.backbone.derivatives.ends import part_ends
from multirod.models.backbone.kernels.layout.members import drive_slices
from multirod.models.backbone.starts import twisted
from multirod.models.platform import platform_kernels as kernels
from multirod.models.platform.capabilities import PlatformLines, PlatformParts, PlatformShapes
from multirod.models.platform.derivatives.along import LegSensing, columns_along
from multirod.models.platform.derivatives.columns import InputColumns, input_columns
from multirod.models.platform.derivatives.designs import (
    PARAMETERS,
    Places,
    design_rows,
    unknown_rates,
)
from multirod.models.platform.geometry import Geometry
from multirod.models.platform.inputs import PLATFORM_INPUTS, input_places
from multirod.models.platform.legs import LegGroup
from multirod.models.platform.stability.clamps import PlatformClamps
from multirod.models.platform.stability.conjugates import PlatformConjugates
from multirod.models.platform.stability.stability import InverseTest, PlatformStability
from multirod.models.platform.starting.guess import (
    COMPLIANCES,
    SHORT,
    Attachments,
    BeamEquilibrium,
    Legs,
    beam_reach,
    fitted_platform,
    rotation_vectors,
)
from multirod.models.platform.starting.starts import PlatformJoints, PlatformStarts
from multirod.problem import Block, BoundaryProblem
from multirod.rotations import matrices
from multirod.validation import FloatArray

POSE = kernels.POSE


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

    def _make_robots(self) -> Struct:
        geometry, device, count = self.geometry, self.device, self.instance_count
        legs = len(geometry.legs)
        robots: Struct = kernels.Robots()
        robots.leg_count = legs
        robots.rod_count = len(geometry.rods)
        robots.unknown_count = self.unknown_count
        robots.direction_count = self.direction_count
        robots.leg_direction_count = self.leg_direction_count
        robots.inverse = int(self.inverse)
        self.share(robots.problem)

        def batched(values: FloatArray, tail: tuple[int, ...]) -> FloatArray:
            """Rows for all instances, or one where none varies."""
            shape = self.batch_shape if geometry.batch_shape else ()
            return np.broadcast_to(values, (*shape, *tail)).reshape(-1, *tail)

        def array(values: ArrayLike, dtype: type = wp.float64) -> Array:
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

        def recorded(kernel: wp.Kernel, dim: int, *arguments: object) -> Launch:
            return record(lambda: kernel, dim, arguments, self.device)

        launches: list[Any] = []
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
        start = self.input_slice("translation").start
        own = [slice(start + first, start + end) for first, end in pairwise(self.geometry.first_rod.tolist())]
        return part_ends(self, names, zip(self.geometry.arrays, own, strict=True))

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
