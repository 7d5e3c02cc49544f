"""Several backbones that hold one platform: the boundary problem and its launches.

What a reader may look for stands elsewhere: the arrays of kernels in ``buffers``, where it begins without loads in
``starting.closing``, directions by inputs and parameters in ``derivatives.aim``.
"""

from collections.abc import Sequence
from functools import cached_property
from itertools import pairwise
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from multirod.batch import IntArray
from multirod.capabilities import LineTest, Loading, ResultTest
from multirod.inputs import Inputs
from multirod.integrators import Integrator
from multirod.launch import Launch, record
from multirod.models.backbone.derivatives.ends import part_ends
from multirod.models.backbone.kernels.layout.members import drive_slices
from multirod.models.backbone.starts import twisted
from multirod.models.platform import platform_kernels as kernels
from multirod.models.platform.buffers import batched, robots_of
from multirod.models.platform.capabilities import PlatformLines, PlatformParts, PlatformShapes
from multirod.models.platform.derivatives.aim import Aim
from multirod.models.platform.derivatives.along import LegSensing, columns_along
from multirod.models.platform.derivatives.columns import input_columns
from multirod.models.platform.geometry import Geometry
from multirod.models.platform.inputs import input_places
from multirod.models.platform.legs import LegGroup
from multirod.models.platform.loads import least_growth, load_scale, too_long
from multirod.models.platform.reach import PlatformReach
from multirod.models.platform.stability.clamps import PlatformClamps
from multirod.models.platform.stability.conjugates import PlatformConjugates
from multirod.models.platform.stability.stability import InverseTest, PlatformStability
from multirod.models.platform.starting.closing import Closing
from multirod.models.platform.starting.guess import Attachments, rotation_vectors
from multirod.models.platform.starting.released import ReleasedPlatforms
from multirod.models.platform.starting.starts import PlatformJoints, PlatformStarts
from multirod.problem import BegunAgain, Block, BoundaryProblem
from multirod.rotations import matrices
from multirod.status import Status
from multirod.validation import FloatArray

POSE = kernels.POSE


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
        design: Sequence[str] = (),
        enabled: Sequence[str] = (),
        pieces: Sequence[int] = (),
    ) -> None:
        self.pieces = np.array(pieces or [1] * len(geometry.legs))
        each = [2 + leg.rod_count for leg in geometry.legs]  # (15) of docs/branches.md
        self.first_moment = np.cumsum([0, *(each * (self.pieces - 1))])  # of each leg, and how many there are
        self.cut = bool(self.first_moment[-1])
        if self.cut:
            direction_count = int(self.first_moment[-1])
        self.leg_direction_count = direction_count if leg_direction_count is None else leg_direction_count
        self.geometry = geometry
        self.inverse = inverse
        self.limits = np.array([-np.inf, np.inf])[:, None] if limits is None else limits
        self._places = input_places(len(geometry.rods), inverse, [name for own in geometry.drives for name in own])
        first = [int(k) for k in geometry.first_unknown]
        # what each leg's unknowns are: its own, in the order of the arrow
        self.own = [slice(a, b) for a, b in pairwise(first)]
        self.platform = slice(first[-1], first[-1] + POSE)
        self.held_torques = np.concatenate([k + 2 + np.arange(geometry.legs[leg].rod_count) for leg, k in enumerate(first[:-1])])
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
            builds.setdefault((leg.rod_count, leg.transmission, leg.arrays.build, self.pieces[k]), []).append(k)
        self.groups = [LegGroup(self, members, inputs, options) for members in builds.values()]
        self.rounding = self.groups[0].backbones.rounding
        self.measured = inputs.measured
        position, rotation = geometry.reference()
        self.reference = batched(self, position, (3,)), batched(self, rotation, (3, 3))
        scales, size = geometry.scales(), (len(geometry.legs) + 1,)
        self.length, self.stiffness = (batched(self, own.reshape(*geometry.batch_shape, *size), size) for own in scales)
        self.closing, self._aim, self.reach = Closing(self), Aim(self), PlatformReach(self)
        self.robots = robots_of(self)
        self._launches = self._record()
        self.write("inputs", self.pack(inputs))

    def _record(self) -> list[Any]:
        """Launches of one evaluation, in order."""

        def recorded(kernel: wp.Kernel, dim: int, *arguments: object) -> Launch:
            return record(kernel, dim, arguments, self.device)

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
        return PlatformClamps(self) if self.cut else None

    @property
    def joints(self) -> PlatformJoints:  # noqa: D102
        return PlatformJoints(self)

    def begin_again(self, status: NDArray[np.int32], reached: FloatArray, tried: int) -> BegunAgain | None:
        """What is undetermined where it begins, with tips that give way: loads may bend it, which determines it."""
        some = (status == Status.UNDETERMINED) & (reached == 0) & (tried == 0)
        return (some, *self.joints.give_way(some)) if some.any() else None

    @property
    def starts(self) -> PlatformStarts | None:
        """None of the inverse problem: its platform is where it is to be."""
        return None if self.inverse else PlatformStarts(self)

    def released(self, instances: IntArray, numbers: IntArray | None = None) -> ReleasedPlatforms | None:  # noqa: D102
        return ReleasedPlatforms(self, instances, numbers) if self.inverse else None

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
        return None if self._aim.followed else self._bare

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
        if self._aim.followed:
            for launch in self._launches[:-1:3]:
                launch.launch()
            self._aim.write(self._aim.followed)
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
        return self.closing.begin()

    @property
    def guess_integrations(self) -> NDArray[np.int_] | int:  # noqa: D102
        return self.closing.integrations

    @property
    def held_forces(self) -> IntArray:  # noqa: D102
        return np.concatenate([np.arange(own.stop - 3, own.stop) for own in self.own])

    @property
    def natural_singular_value(self) -> FloatArray:
        """That at ``guess``: legs that are long and thin answer a force along themselves by bending alone."""
        return self.closing.closed().singular_value

    def twisted(self, x: FloatArray, numbers: IntArray) -> FloatArray:
        """Unknowns with the tubes of legs turned against each other, as ``models.backbone.starts.twisted`` has it."""
        members = [(group.backbones, list(group.members)) for group in self.groups]
        return twisted(members, x, numbers, lambda leg: np.arange(self.own[leg].start, self.own[leg].stop))

    def pose_unknowns(self, position: FloatArray, rotation: FloatArray) -> FloatArray:
        """The platform's unknowns (k, 6) at poses, all instances once or several times: (1), (2) solved for them."""
        length, origin, start = (
            v if len(v) == 1 else np.concatenate([v] * (len(position) // len(v))) for v in (self.length[:, -1:], *self.reference)
        )
        turn = rotation_vectors(rotation @ np.swapaxes(start, 1, 2))
        return np.concatenate([(position - origin) / length**2, turn / length], axis=1)

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
        loading = self.closing.aside["loading"].fetched()
        return np.where(loading == Loading.NONE, 0.0, np.where(loading == Loading.FULL, 1.0, self.buffer("load_factor")))

    def load_scale(self) -> FloatArray:  # noqa: D102
        return load_scale(self)

    def too_long(self, instance: int) -> str:  # noqa: D102
        return too_long(self, instance)

    def least_growth(self) -> FloatArray:  # noqa: D102
        return least_growth(self)

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
        return part_ends(self, names, zip(self.geometry.arrays, own, strict=True), self.inputs_given)

    def aim(self, *names: str) -> None:  # noqa: D102
        self._aim.point(names)

    def aimed(self, *names: str) -> tuple[FloatArray, FloatArray]:  # noqa: D102
        return self._aim.found(names, *super().aimed(*names))

    def along(self, names: Sequence[str], rod: int, places: FloatArray) -> dict[str, FloatArray]:  # noqa: D102
        return columns_along(self, input_columns(self.geometry, names), rod, places)

    def sensing(self, places: FloatArray) -> LegSensing:  # noqa: D102
        return LegSensing(self, places)

    def to_legs(self) -> None:
        """Unknowns and inputs of all instances to the legs, without an integration."""
        with self.everyone():
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
