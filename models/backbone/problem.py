"""One backbone: its inputs, and its boundary problem, the buffers and launches of its kernels."""

from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from copy import copy
from dataclasses import replace
from functools import cached_property
from typing import Any, ClassVar, Self

import numpy as np
import warp as wp
from numpy.typing import NDArray

from multirod.assembly import Assembly, pose
from multirod.batch import IntArray, broadcast_shapes, take
from multirod.capabilities import LineTest, Parts
from multirod.inputs import Inputs, InputSpec, InputSpecs
from multirod.integrators import AdaptiveIntegrator, Integrator
from multirod.launch import LONGEST, expect
from multirod.models.backbone.derivatives.along import AlongPass
from multirod.models.backbone.derivatives.designs import (
    COMPONENTS,
    DEAD,
    PARAMETERS,
    POSE,
    Designs,
    carried,
    parameter_size,
    refuse_unknown,
    turned_loads,
)
from multirod.models.backbone.ends import move_ends, ways_back
from multirod.models.backbone.influence.bound import Influence, influences
from multirod.models.backbone.inputs import BACKBONE_INPUTS, DRIVES, LOADS
from multirod.models.backbone.kernels.layout import arguments as kernels
from multirod.models.backbone.kernels.layout.arguments import DesignOffsets
from multirod.models.backbone.kernels.layout.features import Features
from multirod.models.backbone.kernels.layout.layout import unknowns_of
from multirod.models.backbone.members.driven import DrivenLines
from multirod.models.backbone.members.member import drive_places, drive_slices, drives, kinds
from multirod.models.backbone.node_pass import NodePass, held_to_solve
from multirod.models.backbone.passes import LanePass
from multirod.models.backbone.segments import TOTALS, BackboneSegments
from multirod.models.backbone.shapes import BackboneShapes
from multirod.models.backbone.stability.clamps import BackboneClamps, ClampedBackbones
from multirod.models.backbone.stability.conjugates import BackboneConjugates
from multirod.models.backbone.stability.form_kernels import make_form
from multirod.models.backbone.stability.stability import BackboneStability
from multirod.models.backbone.starts import BackboneStarts
from multirod.models.backbone.units import unit_stiffness
from multirod.problem import FEW, Block, BoundaryProblem
from multirod.profile import DEGREE, Profile, interpolate
from multirod.reuse import reusable
from multirod.rod import Rod, RodArrays, lower
from multirod.segments import taken
from multirod.types import Numbers
from multirod.validation import Described, FloatArray, refuse

STEP_LIMIT = 65_536
FINEST = 1e-12  # relative tolerance of an integration to which rounding leaves its order
POSES_APART = 64  # instances from which leaving poses out saves more than two kernels cost
NODES_KEPT = 1024  # of all instances, of a pass over nodes that is kept for the next
RIGID = 1e6  # torsional over bending stiffness, of a rod rigid in torsion, where its modes are counted
FEATURE_INPUTS = {
    "force": ("tip_force", "follower_force", "distributed_force", "gravity"),
    "tip_moment": ("tip_moment",),
    "distributed_force": ("distributed_force", "gravity"),
    "distributed_moment": ("distributed_moment",),
    "follower_force": ("follower_force",),
    "follower_moment": ("follower_moment",),
    "magnetised": ("magnetic_field",),
    "measured": ("tip_curvature",),
}


def scene_features(
    arrays: RodArrays,
    active: Iterable[str],
    profiles: Collection[str],
    *,
    rod_count: int,
    transmission: bool,
    held: bool = False,
) -> Features:
    """The terms that rods ask for, and inputs by the names of those that act and of those that are functions of arclength."""
    acting = set(active)
    needs = {feature: not acting.isdisjoint(names) for feature, names in FEATURE_INPUTS.items()}
    needs["force"] |= held or arrays.foundation or "distributed_force" in profiles
    return Features(
        rod_count=rod_count,
        eccentric=arrays.eccentric,
        precurvature_degree=arrays.degree,
        profile_degree=DEGREE if profiles else -1,
        shear=arrays.shear,
        members=arrays.members,
        member_rods=arrays.member_rods,
        member_degree=arrays.member_degree,
        discs=arrays.discs,
        foundation=arrays.foundation,
        transmission=transmission,
        anisotropic=arrays.anisotropic and rod_count > 1,
        torsion=arrays.eccentric or (rod_count > 1 and (held or arrays.torsion)),
        held=held,
        **needs,
    )


def _telling(features: Features) -> Features:
    """The terms of the kernel that tells of solutions: states at nodes, the tip, how long lines are, and their derivatives."""
    columns: dict[str, Any] = {"pose_sensitivities": True, "directions": True}
    return replace(features, nodes=True, pose=True, lengths=bool(drives(features.members)), **columns)


def _judging(features: Features) -> Features:
    """The same with columns at nodes, which tell stability."""
    return replace(_telling(features), node_columns=True)


def _teller(features: Features, integrator: Integrator) -> Features | None:
    """The terms of the kernel that tells of what one of these terms has solved: that which judges it too, where it may be.

    A kernel must have the same unknowns. At equal steps it must carry the force in the same way too: what they leave of a shape
    would else not be what they leave of the solution.
    """
    for terms in (_judging(features), _telling(features)):
        alike = integrator.adaptive or terms.force_is_state == features.force_is_state
        if alike and terms.unknown_count == features.unknown_count:
            return terms
    return None


class BackboneProblem(BoundaryProblem):
    """One backbone of n >= 1 concentric rods, clamped at its base, loaded along its length and at its free tip.

    Unknowns are, in curvature units (``docs/model.md``, equation 10): for a single rod the curvature at its base; for several
    the bending moment there, if any load acts, and their torques; then, where a follower force acts, the base force.
    With ``held`` the tip is not free: the base force is unknown too, the pose and wrench of the tip are written out with their
    columns, and of the residual only the torques of the rods that end before it. ``arrays`` are those of ``rods``, or of several
    backbones of the same build along the last batch axis. Of several ``pieces``, the rod is clamped between them by moments that
    stand among the directions, of each instance from the number ``first_moment`` on, one for all or (instance_count,); the
    ``load_directions`` before them change what acts along the rod.
    """

    def __init__(
        self,
        rods: Sequence[Rod],
        base: FloatArray,
        inputs: Inputs,
        *,
        integrator: Integrator,
        device: str = "cpu",
        transmission: bool = False,
        pose: bool = True,
        pose_sensitivities: bool = False,
        direction_count: int = 0,
        lengths: bool = False,
        design: bool = False,
        enabled: Sequence[str] = (),
        held: bool = False,
        arrays: RodArrays | None = None,
        pieces: int = 1,
        first_moment: IntArray | int = 0,
        load_directions: int = 0,
    ) -> None:
        arrays = lower(rods) if arrays is None else arrays
        batch_shape = np.broadcast_shapes(inputs.batch_shape, arrays.batch_shape, base.shape[:-2])
        self.rods = tuple(rods)
        self.base = base
        self.integrator = integrator
        self.enabled = frozenset(enabled)
        self.inputs_given = inputs
        self.options: dict[str, Any] = {
            "integrator": integrator,
            "device": device,
            "transmission": transmission,
            "pose": pose,
            "pose_sensitivities": pose_sensitivities,
            "direction_count": direction_count,
            "lengths": lengths,
            "design": design,
            "held": held,
        }
        self.transmission = transmission
        self.held = held
        self.arrays = arrays.take(batch_shape)
        self.features = self._features(inputs, pose, pose_sensitivities, direction_count)
        self.slots = unknowns_of(self.features)
        self.drives = drives(self.features.members)
        self.drive_count = len(self.drives)
        self.first_drive = 2 * len(rods) + 3 * len(kernels.INPUT_VECTORS)  # of a row of inputs
        self._slices: dict[str, slice] = {}  # what was asked for: a search asks again and again
        self._taken: dict[str, bool] = {}
        self._form_expected = False
        self.renewals = 0  # how often it has served again
        n = self.slots.size
        super().__init__(
            unknown_count=n,
            batch_shape=batch_shape,
            input_count=kernels.input_size(len(rods), self.drive_count),
            blocks=_blocks(self.features),
            direction_count=direction_count,
            pose_sensitivities=pose_sensitivities,
            device=device,
        )
        if design:
            width = self.input_count + self.arrays.end[0].size * DesignOffsets(self.arrays.degree + 1).SIZE
            self.directions = wp.zeros((self.instance_count, max(direction_count, 1), width), dtype=wp.float64, device=device)
        columns = n + direction_count
        # of lines: what ``lengths`` asks for
        self.line_length: Any = wp.zeros((self.instance_count, self.drive_count), dtype=wp.float64, device=device)
        shape = (self.instance_count, self.drive_count, columns if self.features.lengths or self.features.condition_count else 0)
        self.line_length_columns: Any = wp.zeros(shape, dtype=wp.float64, device=device)
        # of several rods, below the pose's, how each turns against the frame, and beside them by how much it is turned
        self.angle_columns: Any = self.pose_columns
        if pose_sensitivities and self.features.turning_count:
            shape = (self.instance_count, 6 + self.features.turning_count, columns + 1)
            self.angle_columns = wp.zeros(shape, dtype=wp.float64, device=device)
            self.pose_columns = self.angle_columns[:, :6, :columns]
        if held:
            self.tip_wrench: Any = wp.zeros((self.instance_count, 6), dtype=wp.float64, device=device)
            self.wrench_columns: Any = wp.zeros((self.instance_count, 6, columns), dtype=wp.float64, device=device)
        self.rounding = float(np.finfo(integrator.precision).eps)
        self.measured = inputs.measured
        self.table = self._make_table(inputs)
        self.write("inputs", self.pack(inputs))
        self.judged_often = self._judged_by_solves  # whether the second variation is condensed by a kernel of its own
        if self.held and self.judged_often:  # what is found is judged, always: it is compiled while the others are
            expect(make_form, device)
        self._passes: dict[Any, NodePass] = {}
        self._found: dict[str, tuple[bytes, NDArray[Any]]] = {}  # by name, for what and what
        self._designs: dict[str, Designs] = {}
        self._followed: tuple[str, ...] = ()  # what directions by inputs and unknowns are by
        self._call = self._make_call(0)
        self.launch: LanePass | ClampedBackbones
        if pieces > 1:
            first = np.broadcast_to(first_moment, self.instance_count)
            self.launch = ClampedBackbones(self, pieces, first, load_directions)
        else:
            self.launch = self._record(self.features, self._call)

    # ---- what is compiled in ----

    def _features(self, inputs: Inputs, pose: bool, pose_sensitivities: bool, direction_count: int) -> Features:
        active = (*inputs.active, *self.enabled)
        options: dict[str, Any] = {"rod_count": len(self.rods), "transmission": self.transmission, "held": self.held}
        needed = replace(scene_features(self.arrays, active, inputs.profiles, **options), design=self.options["design"])
        columns: dict[str, Any] = {"pose_sensitivities": pose_sensitivities, "directions": direction_count > 0}
        features = replace(needed, pose=pose, lengths=self.options["lengths"] and bool(drives(needed.members)), **columns)
        asked = pose_sensitivities and direction_count > 0 and not needed.design and self.integrator.precision == "float64"
        # who asks for a derivative of the pose soon asks for the shape or the stability: one kernel says all
        return (_teller(features, self.integrator) if asked else None) or features

    # ---- arrays ----

    def _array(self, value: Any, dtype: Any = wp.float64) -> Any:
        return wp.array(np.ascontiguousarray(value, dtype=np.float64), dtype=dtype, device=self.device)

    def _make_table(self, inputs: Inputs | None) -> Any:
        table: Any = kernels.RodTable()
        arrays: RodArrays = self.arrays
        table.stride = 1 if arrays.batch_shape else 0
        table.end = self._array(arrays.end)
        table.material = self._array(arrays.material)
        table.precurvature = self._array(arrays.precurvature)
        table.length_scale = self._array(arrays.end[:, 0, -1])
        base = self.base if self.base.ndim == 2 else np.broadcast_to(self.base, (*self.batch_shape, 4, 4))
        base = base.reshape(-1, 4, 4)
        table.base_stride = 1 if self.base.ndim > 2 else 0
        table.base_position = self._array(base[:, :3, 3], wp.vec3d)
        table.base_rotation = self._array(base[:, :3, :3], wp.mat33d)
        if inputs is None:
            table.profile_end, table.profile = self.table.profile_end, self.table.profile
            return table
        ends, coefficients = _merge_profiles(inputs)
        table.profile_end = self._array(ends)
        table.profile = self._array(coefficients)
        return table

    def _make_call(self, node_count: int) -> Any:
        call: Any = kernels.Call()
        self.share(call)
        call.line_length, call.line_length_columns = self.line_length, self.line_length_columns
        call.pose_columns = self.angle_columns
        if self.held:
            call.tip_wrench, call.wrench_columns = self.tip_wrench, self.wrench_columns
        call.direction_stride = 1
        call.steps = float(self.integrator.steps or 0)
        # nodes between base and tip ask for stretches of as few steps as one
        call.step_multiple = 1.0 if node_count > 2 else float(step_multiple(self.integrator.steps or 1))
        call.rtol = self.integrator.rtol
        call.atol = self.integrator.atol
        call.step_limit = STEP_LIMIT
        call.node_count = node_count
        if node_count:
            shape = (self.instance_count, node_count)
            call.node_arclength = wp.zeros(shape, dtype=wp.float64, device=self.device)
            for name in ("position", "curvature", "moment", "force", *(TOTALS if self.features.members else ())):
                setattr(call, f"node_{name}", wp.zeros(shape, dtype=wp.vec3d, device=self.device))
            call.node_rotation = wp.zeros(shape, dtype=wp.mat33d, device=self.device)
            call.line_length = wp.zeros((self.instance_count, self.drive_count), dtype=wp.float64, device=self.device)
            rubbed = self.drive_count * self.features.friction
            call.node_left = wp.zeros((*shape, rubbed), dtype=wp.float64, device=self.device)
            call.energy = wp.zeros(self.instance_count, dtype=wp.float64, device=self.device)
            call.work = wp.zeros(self.instance_count, dtype=wp.float64, device=self.device)
        return call

    def _record(self, features: Features, call: Any, table: Any = None, *, columns: tuple[int, int] | None = None) -> LanePass:
        """A launch; ``columns`` by unknowns and by directions, all by default."""
        # what looks at a solution, or judges it, is double precision whatever the solve's own integrations are
        precision = "float64" if features.nodes or features.design else self.integrator.precision
        return LanePass(
            features,
            self.integrator,
            precision,
            table or self.table,
            call,
            (features.unknown_count, self.direction_count) if columns is None else columns,
            self.device,
            longest=max(1, LONGEST // len(self.rods)),
            heed=self.heed_stop,
        )

    # ---- what is offered ----

    @property
    def stability(self) -> BackboneStability:  # noqa: D102
        return BackboneStability(self)

    @property
    def shapes(self) -> BackboneShapes:  # noqa: D102
        return BackboneShapes(self)

    @property
    def lines(self) -> DrivenLines:  # noqa: D102
        return DrivenLines(self)

    @property
    def result_test(self) -> LineTest | None:  # noqa: D102
        return LineTest(self.lines) if self.features.discs and self.features.condition_count else None

    @property
    def starts(self) -> BackboneStarts:  # noqa: D102
        return BackboneStarts(self)

    @property
    def parts(self) -> "BackboneParts":  # noqa: D102
        return BackboneParts(self)

    @property
    def segments(self) -> BackboneSegments | None:  # noqa: D102
        return None if len(self.rods) > 1 or self.held or self.features.foundation else self.cut

    @property
    def segments_refused(self) -> str:  # noqa: D102
        if len(self.rods) > 1 or self.held:
            return super().segments_refused
        return "Rod.foundation is not 0, must be 0: a segment does not know how far its base has moved; Shooting takes it"

    @cached_property
    def cut(self) -> BackboneSegments:
        """The segments of a single rod, for those who know that it is one."""
        return BackboneSegments(self)

    @property
    def may_be_clamped(self) -> bool:
        """Whether places along it can be clamped: not along several rods, in a medium, or by lines of given length."""
        terms = self.features
        return len(self.rods) == 1 and not (terms.foundation or terms.condition_count or terms.friction)

    @cached_property
    def clamps(self) -> BackboneClamps | None:  # noqa: D102
        return BackboneClamps(self, self.launch) if isinstance(self.launch, ClampedBackbones) else None

    @cached_property
    def conjugates(self) -> BackboneConjugates | None:  # noqa: D102
        return None if self.held or not self.pose_sensitivities else BackboneConjugates(self)

    @property
    def kinks(self) -> NDArray[np.intp]:  # noqa: D102
        if not self.features.condition_count:
            return super().kinks
        slack = [kind.slackens for kind in self.features.members if kind.conditioned]
        return np.asarray(np.arange(self.unknown_count)[self.slots.places["drives"]][np.array(slack, dtype=bool)])

    @property
    def kink_inputs(self) -> NDArray[np.intp]:  # noqa: D102
        if not self.features.condition_count:
            return super().kink_inputs
        laws = self.features.members
        slack = [kind.conditioned and kind.slackens for kind in laws if kind.drive is not None]
        places = self.first_drive + np.array(drive_places(laws), dtype=np.intp)
        return np.asarray(places[np.array(slack, dtype=bool)])

    # ---- the interface ----

    def renew(self, inputs: Inputs) -> bool:  # noqa: D102
        if inputs.profiles or self.inputs_given.profiles:
            return False
        self._clear()
        self.inputs_given = inputs
        self.write("inputs", self.pack(inputs))
        self.renewals += 1
        return True

    def expect_judging(self) -> None:  # noqa: D102
        if self._may_condense:
            self.judged_often = True
            if not self._form_expected:
                self._form_expected = True
                expect(make_form, self.device)

    @property
    def _may_condense(self) -> bool:
        """Whether a kernel may condense the second variation: without conditions on lines."""
        return not self.features.condition_count

    @property
    def _judged_by_solves(self) -> bool:
        """Whether solves look at stability so often that a kernel pays which all such rods share: on the processor, of what is
        multistable, as rods are whose tips are held."""
        return self._may_condense and (self.held or self.features.turning_count > 0) and self._host is not None

    def _clear(self) -> None:
        super()._clear()
        self.judged_often = self._judged_by_solves
        self._followed = ()
        for name in ("cut", "conjugates"):
            self.__dict__.pop(name, None)

    def _zeros(self) -> list[Any]:
        lines = (self.line_length, self.line_length_columns) if self.drive_count else ()
        return [*super()._zeros(), *lines, *((self.tip_wrench, self.wrench_columns) if self.held else ())]

    def takes(self, name: str) -> bool:  # noqa: D102
        if name not in self._taken:
            needed = [feature for feature, names in FEATURE_INPUTS.items() if name in names]
            self._taken[name] = all(getattr(self.features, feature) for feature in needed)
        return self._taken[name]

    def pack(self, inputs: Inputs) -> FloatArray:  # noqa: D102
        packed = super().pack(inputs)
        packed[:, -1] = 1.0  # scale of the load profiles
        return packed

    def input_slice(self, name: str) -> slice:  # noqa: D102
        found = self._slices.get(name)
        if found is None:
            found = self._slices[name] = self._slice_of(name)
        return found

    def _slice_of(self, name: str) -> slice:
        n = len(self.rods)
        if name in ("rotation", "translation"):
            start = 0 if name == "rotation" else n
            return slice(start, start + n)
        if name in DRIVES:
            return drive_slices(self.drives, self.first_drive).get(name, slice(self.first_drive, self.first_drive))
        start = 2 * n + 3 * kernels.INPUT_VECTORS.index(name)
        return slice(start, start + 3)

    def aim(self, *names: str) -> None:
        """As said; what depends on inputs and unknowns is found at each integration."""
        self._followed = names if "base" in names or (self.transmission and any(name in COMPONENTS for name in names)) else ()
        if not self._followed:
            super().aim(*names)

    def part_ends(self, names: Sequence[str]) -> FloatArray:  # noqa: D102
        if not move_ends(names):
            return super().part_ends(names)
        inputs, own = self.read("inputs"), self.input_slice("translation")
        back = ways_back(self.arrays, inputs[:, own])
        if back.any():
            inputs[:, own] -= back
            self.write("inputs", inputs)
        return np.asarray(2 * back[:, -1])

    def _integrate(self) -> None:
        if self._followed:
            super().aim(*self._followed)
        self.launch.launch()

    @property
    def launches(self) -> tuple[Any, ...] | None:  # noqa: D102
        return self.launch.recorded if isinstance(self.launch, LanePass) and not self._followed else None

    def _pass_over(self, instances: IntArray | None) -> None:
        super()._pass_over(instances)
        self.launch.set_dim(self.listed)

    def integrate_alike(self) -> bool:  # noqa: D102
        if self._host is None or self.instance_count <= FEW or self.arrays.batch_shape or self.base.ndim > 2 or self._followed:
            return False
        loads = np.concatenate([np.arange(own.start, own.stop) for _, own in self._loads])
        inputs = np.delete(self.read("inputs"), loads, axis=1)
        unknowns, active = self.read("unknowns"), self.buffer("active")
        if not active.all() or self.buffer("load_factor").any() or any((own != own[0]).any() for own in (inputs, unknowns)):
            return False
        with self.only(np.arange(self.instance_count) == 0):
            self.integrate()
        for name in ("residual", "gamma"):
            self.write(name, self.read(name)[0])
        for array in (self.fault, self.step_count):
            array.fill_(int(array.numpy()[0]))
        return True

    @contextmanager
    def without_poses(self) -> Iterator[None]:
        """As said, for many single rods at fixed steps, whose kernels round alike with and without the pose.

        What finds the poses in the end carries no columns and costs half an integration, which is not counted.
        """
        f, alike = self.features, len(self.rods) == 1 and self.integrator.steps is not None
        if not alike or not f.pose or f.pose_sensitivities or self.instance_count < POSES_APART:
            yield
            return
        whole = self.launch
        self.launch = self.tool("without poses", lambda: self._record(replace(f, pose=False), self._call))
        self.launch.set_dim(self.listed)
        try:
            yield
        finally:
            self.launch = whole
        with self.everyone():
            self.tool("poses", lambda: self._record(replace(f, directions=False), self._call, columns=(0, 0))).launch()

    def guess(self) -> FloatArray:  # noqa: D102
        result = np.zeros((self.instance_count, self.unknown_count))
        if not self.features.turning_count:
            result[:, self.slots.places["moment"]] = self.arrays.precurvature[:, 0, 0, :3]
        return result

    def adopt(self, unknowns: FloatArray) -> FloatArray:  # noqa: D102
        if unknowns.shape[1] == self.unknown_count:
            return super().adopt(unknowns)
        kinds = [(True, False), (True, True)] + [(False, False)] * (self.features.torque_count > 0)
        others = {unknowns_of(self.features, moment=moment, force=force).size: (moment, force) for moment, force in kinds}
        if unknowns.shape[1] not in others:
            return super().adopt(unknowns)
        moment, force = others[unknowns.shape[1]]
        unknowns = unknowns if moment else self.with_moment(unknowns)
        parts = unknowns_of(self.features, moment=True, force=force).split(unknowns)
        if self.features.base_force_unknown and not force:
            parts["force"] = self._dead_base_force(unknowns)
        return np.asarray(self.slots.joined(parts))

    def with_moment(self, torques: FloatArray) -> FloatArray:
        """Unknowns of rods that carry a moment, from those of unloaded ones: none, and rod 1 has what the others leave, (8b)."""
        if self.features.eccentric:
            return np.concatenate([np.zeros((len(torques), 3)), torques], axis=1)
        unit = unit_stiffness(self.arrays.material[:, :, 0])[..., 2]
        inner = -(torques * unit[:, 1:]).sum(axis=1, keepdims=True) / unit[:, :1]
        return np.concatenate([np.zeros((len(torques), 2)), inner, torques], axis=1)

    def _dead_base_force(self, unknowns: FloatArray) -> FloatArray:
        """The base force in curvature units, equation (13), without the follower force, at ``unknowns`` without it."""
        call = self.node_pass(2, unknowns=unknowns, follower_force=False)
        scale = self.table.length_scale.numpy() / self.arrays.material[:, 0, 0, :2].max(axis=-1)
        force = call.read("node_total_force" if self.features.members else "node_force")
        return np.asarray(force[:, 0] * scale[:, None])

    def base_torques(self) -> FloatArray:
        """(10) What twists each rod behind the plate [N m], shape (instance_count, n)."""
        x, features = self.read("unknowns"), self.features
        unit = self.each(unit_stiffness(self.arrays.material[:, :, 0])[..., 2])
        if not features.turning_count:
            return np.asarray((x[:, 2:3] - self.each(self.arrays.precurvature[:, 0, 0, 2:3])) * unit)
        result = np.zeros((self.instance_count, features.rod_count))
        own = slice(features.rod_count - features.torque_count, None)
        if features.torque_count:
            result[:, own] = x[:, self.slots.places["torques"]] * unit[:, own]
            if features.moment and not features.eccentric:
                result[:, 0] = x[:, 2] * unit[:, 0]
            elif not features.eccentric:
                result[:, 0] = -result.sum(axis=1)
        return result

    def directions_by(self, name: str) -> FloatArray:
        """As said, or along each number of a parameter."""
        if name in COMPONENTS:
            return self.designs(name).rows()
        return turned_loads(self, DEAD) if name == "base" else super().directions_by(name)

    def aimed(self, *names: str) -> tuple[FloatArray, FloatArray]:
        """As said; by parameters too, the unknowns fixed."""
        slopes, moved = super().aimed(*names)
        rates, n = self.unknown_rates(names), self.unknown_count
        if rates is not None:  # (D9)
            slopes -= self.read("gamma").reshape(-1, n, n) @ rates
            moved -= self.pose_columns.numpy()[:, :, :n] @ rates
        for own in self._columns_of(names, "base"):
            moved[:, :, own] += carried(self.read("position") - self.base_position())
        return slopes, moved

    def _columns_of(self, names: Sequence[str], wanted: str) -> Iterator[slice]:
        """Where the columns by one of the names stand."""
        if wanted not in names:
            return
        first = 0
        for name in names:
            size = self._size(name)
            if name == wanted:
                yield slice(first, first + size)
            first += size

    def _size(self, name: str) -> int:
        """How many columns are by a name."""
        if name in COMPONENTS:
            return self.designs(name).count
        if name == "base":
            return POSE
        place = self.input_slice(name)
        return int(place.stop - place.start)

    def designs(self, name: str) -> Designs:
        """How the rods change with a parameter: the same as long as there is the problem."""
        if name not in self._designs:
            self._designs[name] = Designs(self, name)
        return self._designs[name]

    def unknown_rates(self, names: Sequence[str]) -> FloatArray | None:
        """(D9) How the unknowns must change with each number for what is at the base to stay, (instance_count, n, k); None where
        they need not."""
        if self.eliminates or not any(name in COMPONENTS for name in names):
            return None
        size = (self.instance_count, self.unknown_count)
        rates = [
            self.designs(name).unknown_rates() if name in COMPONENTS else np.zeros((*size, self._size(name))) for name in names
        ]
        return np.concatenate(rates, axis=2)

    def along(self, names: Sequence[str], rod: int, places: FloatArray) -> dict[str, FloatArray]:
        """Derivatives of ``along.QUANTITIES`` at ``places`` (instance_count, count), rising arclengths of a rod, by the unknowns,
        then, these fixed, by each number that the problem is aimed at, each (instance_count, count, 3, n + k)."""
        found, lever = self.along_itself(rod, places)
        rates, n = self.unknown_rates(names), self.unknown_count
        if rates is not None:
            for values in found.values():
                values[..., n:] -= values[..., :n] @ rates[:, None]
        for own in self._columns_of(names, "base"):
            rigid = carried(lever.reshape(-1, 3)).reshape(*lever.shape[:2], 2, 3, -1)
            for k, name in enumerate(("position", "rotation")):
                found[name][..., n + own.start : n + own.stop] += rigid[:, :, k]
        return found

    def along_itself(self, rod: int, places: FloatArray) -> tuple[dict[str, FloatArray], FloatArray]:
        """``AlongPass.at`` of the last integration's unknowns, inputs and directions."""
        self._refuse_side_by_side()
        made: AlongPass
        if self.instance_count > FEW:  # it has columns at all places
            made = AlongPass(self, places.shape[1])
        else:
            made = self.tool(("along", places.shape[1]), lambda: AlongPass(self, places.shape[1]))
        return made.at(places, rod)

    def _refuse_side_by_side(self) -> None:
        if self.features.eccentric:
            raise NotImplementedError("derivatives along rods side by side are not known: their frames are not the line's")

    def sensing(self, places: FloatArray) -> AlongPass:  # noqa: D102
        self._refuse_side_by_side()
        made = AlongPass(self, len(places), shared=True)
        made.place(np.broadcast_to(places, (self.instance_count, len(places))))
        return made

    def sensed(self, made: AlongPass, names: Sequence[str], rod: int) -> tuple[FloatArray, FloatArray]:  # noqa: D102
        curvature, columns = made.curvature(rod)
        rates, n = self.unknown_rates(names), self.unknown_count
        if rates is not None:
            columns[..., n:] -= columns[..., :n] @ rates[:, None]
        return curvature, columns

    def base_position(self) -> FloatArray:
        """Of the base in the world [m], shape (instance_count, 3)."""
        position = self.base[..., :3, 3]
        return np.broadcast_to(position, (*self.batch_shape, 3)).reshape(-1, 3) if position.ndim > 1 else position[None]

    def curvature_scale(self) -> FloatArray:  # noqa: D102
        return self._curvature_scale

    @cached_property
    def _curvature_scale(self) -> FloatArray:
        bent = np.abs(self.arrays.precurvature).reshape(*self.arrays.precurvature.shape[:3], -1, 3).sum(axis=(3, 4))
        return self.each(np.maximum(1 / self.arrays.end[:, 0, -1], bent.max(axis=(1, 2))))

    def load_scale(self) -> FloatArray:  # noqa: D102
        inputs = self.read("inputs")
        return np.asarray(self.found_for("load_scale", inputs, lambda: self._load_scale(inputs)))

    def found_for(self, name: str, given: FloatArray, find: Callable[[], NDArray[Any]]) -> Any:
        """A copy of what ``find`` finds, which follows from ``given`` alone: several ask for the same in one solve, and in the
        next."""
        kept, key = self._found.get(name), given.tobytes()
        if kept is None or kept[0] != key:
            kept = self._found[name] = key, find()
        return kept[1].copy()

    def _load_scale(self, inputs: FloatArray) -> FloatArray:
        table = self.arrays
        stiffness = table.material[:, 0, :, :3].min(axis=(1, 2))
        length = table.end[:, 0, -1] + inputs[:, self.input_slice("translation")][:, 0]
        weight = table.material[:, 0, :, 9].max(axis=1)
        total = np.zeros(self.instance_count)
        for spec in self.acting(inputs):
            x, y, z = inputs[:, self.input_slice(spec.name)].T
            size = self.magnetic_load() if spec.name == "magnetic_field" else np.sqrt(x * x + y * y + z * z)
            size = size * length**spec.power / stiffness
            total += size * weight if spec.name == "gravity" else size
        if self.features.foundation:
            total += self._medium_load()
        if self.drive_count:
            total += self.lines.load() * length / stiffness
        if self.features.measured:
            gap = inputs[:, self.input_slice("tip_curvature")] - table.precurvature[:, 0, -1, :3]
            total += np.linalg.norm(gap, axis=1) * length
        if self.features.profile_degree >= 0:
            profile = self.table.profile.numpy()
            size = np.abs(profile.reshape(len(profile), 6, -1)).sum(-1).max(0)
            total += (size[:3].max() * length**3 + size[3:].max() * length**2) / stiffness
        return total

    def acting(self, inputs: FloatArray) -> list[InputSpec]:
        """The loads that are not zero in all instances of ``inputs`` (instance_count, input_count)."""
        acting: list[bool] = np.any(inputs, axis=0).tolist()
        return [spec for spec, own in self._loads if any(acting[own])]

    @cached_property
    def _loads(self) -> list[tuple[InputSpec, slice]]:
        """The loads, and where they stand in a row of inputs."""
        return [(spec, self.input_slice(spec.name)) for spec in LOADS]

    def _medium_load(self) -> FloatArray:
        """How much a medium bends rods that are not straight, ``k L^4/EI`` times their bend, shape (instance_count,)."""
        table = self.arrays
        length = table.end[:, 0, -1]
        stiffness = table.material[..., 13:16].max(axis=(1, 2, 3)) * length**4 / table.material[:, 0, :, :3].min(axis=(1, 2))
        _, kappa = self.by_section()
        return np.asarray(self.each(stiffness) * np.minimum(kappa.max(axis=(1, 2)) * self.each(length), 1.0))

    def magnetic_load(self) -> FloatArray:
        """Bound of the moment per length of a magnetic field on all rods [N], shape (instance_count,)."""
        if not self.features.magnetised:
            return np.zeros(self.instance_count)
        strongest = np.linalg.norm(self.arrays.material[..., 10:13], axis=-1).max(axis=2).sum(axis=1)
        field = np.linalg.norm(self.read("inputs")[:, self.input_slice("magnetic_field")], axis=1)
        return np.asarray(self.each(strongest) * field)

    @property
    def has_potential(self) -> bool:
        """Whether all but vectors of the inputs derives from one: load profiles, and the laws of the tip and of lines."""
        moments = self.features.profile_degree >= 0 and bool(self.table.profile.numpy().reshape(-1, 6, DEGREE + 1)[:, 3:].any())
        return not (moments or self.features.measured or self.features.friction)

    @property
    def turned(self) -> slice:  # noqa: D102
        return self.input_slice("rotation")

    def turning(self, before: FloatArray | None = None) -> FloatArray:  # noqa: D102
        angles = self.read("inputs")[:, self.turned]
        if before is not None:
            return np.asarray(np.ptp(angles - before[:, self.turned], axis=1))
        return np.asarray(angles.max(axis=1) - angles.min(axis=1) + self._twist)

    @cached_property
    def _twist(self) -> FloatArray | float:
        """By which precurvature turns rods against each other [rad]."""
        if len(self.rods) == 1 or self.held:
            return 0.0
        size = np.diff(self.arrays.end, axis=2, prepend=0.0)
        own = np.abs(self.arrays.precurvature.reshape(*size.shape, -1, 3)[..., 2]).sum(axis=-1)
        return np.asarray((own * size).sum(axis=2).max(axis=1))

    def ends(self) -> FloatArray:
        """Arclength at which each rod ends [m], shape (instance_count, n)."""
        inputs = self.input_view()
        if inputs is None:
            inputs = self.read("inputs")
        return np.asarray(self.arrays.end[:, :, -1] + inputs[:, self.input_slice("translation")])

    def furthest_end(self) -> FloatArray:
        """Arclength at which the last rod ends [m], shape (instance_count,)."""
        return np.asarray(self.ends().max(axis=1))

    def stiffness_over_length(self) -> FloatArray:
        """What stiffnesses of the tip are counted in [N m], shape (instance_count,): the least of the rods', over the length."""
        return np.asarray(self.least_stiffness() / self.furthest_end())

    def least_stiffness(self) -> FloatArray:
        """The least of all that a rod resists bending or twisting with [N m^2], shape (instance_count,)."""
        return self._least_stiffness

    @cached_property
    def rigid_in_torsion(self) -> bool:
        """Whether a rod is, anywhere."""
        return not bool(np.isfinite(self.arrays.material[..., 2]).all())

    @cached_property
    def _least_stiffness(self) -> FloatArray:
        return self.each(self.arrays.material[..., :3].min(axis=(1, 2, 3)))

    def by_section(self) -> tuple[FloatArray, FloatArray]:
        """Larger ``EI`` [N m^2] and a bound of ``|u*_xy|`` [1/m] of each section, shape (instance_count, n, section)."""
        return self._by_section

    @cached_property
    def _by_section(self) -> tuple[FloatArray, FloatArray]:
        coefficients = self.arrays.precurvature.reshape(*self.arrays.precurvature.shape[:3], -1, 3)
        kappa = np.linalg.norm(coefficients[..., :2], axis=-1).sum(axis=-1)
        return self.each(self.arrays.material[..., :2].max(axis=-1)), self.each(kappa)

    def bend_by_section(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """``EI |u*_xy|`` [N m] of each section, (instance_count, n, section), the most of each rod together, (instance_count,),
        and ``|u*_xy|`` as ``by_section`` has it."""
        return self._bend_by_section

    @cached_property
    def _bend_by_section(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        EI, kappa = self._by_section
        bend = EI * kappa
        return bend, bend.max(axis=2).sum(axis=1), kappa

    def each(self, values: FloatArray) -> FloatArray:
        """Values of the rods' batch, one an instance."""
        return np.broadcast_to(values, (self.instance_count, *values.shape[1:]))

    def node_pass(
        self,
        node_count: int,
        chosen: NDArray[np.bool_] | None = None,
        *,
        columns: bool = False,
        rod: int | None = None,
        unknowns: FloatArray | None = None,
        **changes: Any,
    ) -> NodePass:
        """A pass over nodes of one rod, or of all together, by outputs of its own, until the next: those of the solve stay.

        Columns are those of the model with all its unknowns. ``unknowns`` are those of the solve by default: then it ends where
        the solve does, or its outputs are NaN (``held_to_solve``).
        """
        mine = unknowns is None
        if columns and mine and not self.features.moment:
            unknowns = self.with_moment(self.read("unknowns"))
        made = self._pass(node_count, chosen, columns, rod, unknowns, changes)
        as_solve = node_count == 2 and not columns
        if not mine or as_solve or changes or isinstance(self.launch, ClampedBackbones):
            return made
        ran = self._listed() if chosen is None else np.array(chosen)
        for k in self.breakpoints:
            ran[k] = False

        def again(others: FloatArray, some: NDArray[np.bool_], by_columns: bool) -> NodePass:
            return self._pass(node_count, some, by_columns, rod, others, changes)

        return held_to_solve(self, made, again, ran)

    def bare_pass(self, node_count: int, chosen: NDArray[np.bool_]) -> NodePass:
        """A pass without columns at the unknowns of the solve, wherever it ends; of two nodes, by its very steps, if equal."""
        return self._pass(node_count, chosen, False, None, None, {})

    def _listed(self) -> NDArray[np.bool_]:
        """Which instances launches evaluate, shape (instance_count,)."""
        result = np.zeros(self.instance_count, dtype=bool)
        result[self.order.numpy()[: self.listed]] = True
        return np.asarray(result & (self.active.numpy() != 0))

    def end_pass(self, chosen: NDArray[np.bool_]) -> NodePass:
        """Residual and tip of some instances by the very steps that the solve chooses, without columns; its outputs stay."""
        made = self._end_pass
        made.write("active", chosen)
        made.launch.launch()
        return made

    @cached_property
    def _end_pass(self) -> NodePass:
        call, count = self._make_call(0), self.instance_count
        self._own_ends(call, self.unknown_count)
        call.active, call.fault, call.step_count = (wp.zeros(count, dtype=wp.int32, device=self.device) for _ in range(3))
        call.line_length = wp.zeros((count, self.drive_count), dtype=wp.float64, device=self.device)
        if self.held:
            call.tip_wrench = wp.zeros((count, 6), dtype=wp.float64, device=self.device)
        launch = self._record(replace(self.features, pose=True), call, columns=(0, 0))
        return NodePass(call, launch, False, False, self._host is not None)

    def _own_ends(self, call: Any, unknown_count: int) -> None:
        """Outputs at the tip, but for columns."""
        call.residual = wp.zeros((self.instance_count, unknown_count), dtype=wp.float64, device=self.device)
        call.position = wp.zeros(self.instance_count, dtype=wp.vec3d, device=self.device)
        call.rotation = wp.zeros(self.instance_count, dtype=wp.mat33d, device=self.device)

    def _pass(
        self,
        node_count: int,
        chosen: NDArray[np.bool_] | None,
        columns: bool,
        rod: int | None,
        unknowns: FloatArray | None,
        changes: dict[str, Any],
    ) -> NodePass:
        """A pass over nodes, wherever it ends."""
        key = (node_count, columns, rod, chosen is None, unknowns is None, *changes.items())
        made = self._passes.get(key)
        if made is None:
            made = self._make_node_pass(node_count, chosen is not None, columns, rod, unknowns, changes)
            if self._host is not None and self.instance_count * node_count <= NODES_KEPT:
                while len(self._passes) > len(self.rods) + 3:
                    del self._passes[next(iter(self._passes))]
                self._passes[key] = made
        else:
            made.clear()
        if chosen is not None:
            made.write("active", chosen)
        if unknowns is not None:
            made.write("unknowns", unknowns)
        made.launch.launch()
        return made

    def nodes_of_all(self, node_count: int) -> NodePass:
        """A pass by columns over nodes of all rods together and all instances, not launched yet."""
        return self._make_node_pass(node_count, False, True, None, None, {})

    def _make_node_pass(
        self, node_count: int, chosen: bool, columns: bool, rod: int | None, unknowns: FloatArray | None, changes: dict[str, Any]
    ) -> NodePass:
        features = replace(self.features, nodes=False, node_columns=False, design=False, **changes)
        without = replace(_telling(features), pose_sensitivities=False, directions=False)
        if columns and self.judged_often:
            expect(make_form, self.device)
        features = _judging(features) if columns else _teller(features, self.integrator) or without
        call = self._make_call(node_count)
        if unknowns is not None:
            call.unknowns = self._array(unknowns)
        call.node_rod = len(self.rods) if rod is None else rod
        count, m = self.instance_count, features.unknown_count
        self._own_ends(call, m)
        if chosen:
            call.active = wp.zeros(count, dtype=wp.int32, device=self.device)
        if columns:
            nodes = node_count - 1 + self.arrays.end[0].size + self.table.profile_end.size
            call.column_arclength = wp.full((count, nodes), np.nan, dtype=wp.float64, device=self.device)
            call.node_columns = wp.zeros((count, nodes, m, m), dtype=wp.float64, device=self.device)
            call.tip_columns = wp.zeros((count, m, m), dtype=wp.float64, device=self.device)
            call.gamma = wp.zeros((count, m, m), dtype=wp.float64, device=self.device)
            call.pose_columns = wp.zeros((count, 6, m), dtype=wp.float64, device=self.device)
            call.line_length_columns = wp.zeros((count, self.drive_count, m), dtype=wp.float64, device=self.device)
        table = self._twisting_table() if columns else None
        launch = self._record(features, call, table, columns=(m if columns else 0, 0))
        return NodePass(call, launch, columns, bool(features.members), self._host is not None)

    def _twisting_table(self) -> Any:
        """The rods, one that is rigid in torsion only ``RIGID`` times stiffer than in bending: columns need to twist it, (8s)."""
        material = self.arrays.material
        rigid = np.isinf(material[..., 2])
        if not rigid.any() and not self.features.eccentric:
            return self.table
        material = np.array(material)
        if self.features.eccentric:
            stiffest = material[..., :2].max(axis=(1, 2, 3), keepdims=True)
            material[..., kernels.MATERIAL_SIZE + 2] = 1 / (RIGID * stiffest[..., 0])
        material[..., 5][rigid] = 1 / (RIGID * material[..., :2].max(axis=-1)[rigid])
        table = self._make_table(None)
        table.material = self._array(material)
        return table


class BackboneParts(Parts):
    """Of a ``BackboneProblem``: finer by step control alone, which fixed steps and the finest tolerances have no use for."""

    def __init__(self, problem: BackboneProblem) -> None:
        self.problem = problem

    def of(self, instances: IntArray, *, double: bool = False, poses: bool = False) -> BackboneProblem:  # noqa: D102
        integrator = self.problem.integrator.in_double() if double else self.problem.integrator
        return self._part(instances, integrator, poses)

    @property
    def may_be_clamped(self) -> bool:  # noqa: D102
        return self.problem.may_be_clamped

    def clamped(self, instances: IntArray, pieces: int) -> BackboneProblem:  # noqa: D102
        return self._part(instances, self._finest() or self.problem.integrator.in_double(), True, pieces)

    def finer(self, instances: IntArray, *, poses: bool = False) -> BackboneProblem | None:  # noqa: D102
        integrator = self._finest()
        return None if integrator is None else self._part(instances, integrator, poses)

    def _finest(self) -> Integrator | None:
        coarse = self.problem.integrator.in_double()
        if not isinstance(coarse, AdaptiveIntegrator) or not coarse.adaptive or coarse.rtol <= FINEST:
            return None
        return replace(coarse, rtol=FINEST, atol=min(coarse.atol, 0.01 * FINEST))

    def _part(self, instances: IntArray, integrator: Integrator, poses: bool, pieces: int = 1) -> BackboneProblem:
        whole = self.problem
        shape = whole.batch_shape
        base = take(whole.base, shape, instances, tail=2) if whole.base.ndim > 2 else whole.base
        arrays, inputs = whole.arrays.take(shape, instances), whole.inputs_given.take(shape, instances)
        options = {**whole.options, "integrator": integrator}
        if poses:  # with a direction too, it is the kernel that tells stability
            options |= {"pose_sensitivities": True, "direction_count": 1 if pieces == 1 else 3 * (pieces - 1), "pieces": pieces}
        result = BackboneProblem(whole.rods, base, inputs, enabled=tuple(whole.enabled), arrays=arrays, **options)
        result.stop = whole.stop
        result.judged_often = whole.judged_often
        # the tip as the solve found it is what a pass over nodes is held to
        for name in ("inputs", "unknowns", "position", "rotation"):
            result.write(name, whole.read(name)[instances])
        result.breakpoints = taken(whole.breakpoints, instances)
        return result


class BackboneAssembly(Assembly):
    """An assembly that is one backbone, clamped at its base and free at its tip.

    Args:
        rods: Innermost first.
        base: Pose of the base in the world, shape (..., 4, 4); None is the identity.

    Raises:
        ValueError: If ``base`` is not a pose, or its leading axes do not broadcast with the rods'.
    """

    length_columns: ClassVar[bool] = True
    transmission: ClassVar[bool] = False  # whether the rods twist behind the base plate

    def __init__(self, rods: tuple[Rod, ...], base: Numbers | None) -> None:
        field = f"{type(self).__name__}.base"
        self.rods = rods
        self.base = pose(field, base)
        own = super().batch_shape
        try:
            np.broadcast_shapes(own, self.base.shape[:-2])
        except ValueError:
            refuse(field, Described(f"leading axes {self.base.shape[:-2]}"), f"must broadcast with the rods' {own}")

    @property
    def batch_shape(self) -> tuple[int, ...]:
        """Leading axes of the rods' parameters and of the base."""
        return broadcast_shapes(super().batch_shape, self.base.shape[:-2])

    @property
    def input_specs(self) -> tuple[InputSpec, ...]:  # noqa: D102
        return InputSpecs(BACKBONE_INPUTS)

    def check(self, inputs: Inputs) -> None:  # noqa: D102
        if inputs.is_active("gravity") and not any(rod.has_mass for rod in self.rods):
            refuse("gravity", inputs.gravity.tolist(), "must be zero: no rod has a linear_density (or, for Rod.tube, a density)")
        if inputs.is_active("magnetic_field") and not any(rod.is_magnetised for rod in self.rods):
            refuse("magnetic_field", inputs.magnetic_field.tolist(), "must be zero: no rod has a magnetisation")
        check_drives(inputs, self.rods)
        if inputs.is_active("translation"):
            check_reach(inputs, self.rods, straight=self.transmission)

    @property
    def has_conditions(self) -> bool:
        """Whether a line is driven by its length."""
        return any(kind.conditioned for rod in self.rods for kind in kinds(rod.carried))

    def input_directions(self, *names: str) -> dict[str, Any]:
        """Directions for the derivatives by some inputs; of rods with lines, of their lengths too."""
        varies = self.arrays.member_degree or self.arrays.degree
        if "translation" in names and varies and any(kind.rubs for kind in self.arrays.members):
            raise NotImplementedError(
                "the derivatives by translation of a rod whose line has friction are not known where a route or the precurvature "
                "is a function of arclength"
            )
        refuse_unknown(names, self.rods)
        design = {"design": True} if any(name in COMPONENTS for name in names) else {}
        return {**super().input_directions(*names), **({"lengths": True} if drives(self.arrays.members) else {}), **design}

    @property
    def parameters(self) -> tuple[str, ...]:  # noqa: D102
        return PARAMETERS

    def column_count(self, name: str) -> int:  # noqa: D102
        return parameter_size(name, self.rods) if name in PARAMETERS else super().column_count(name)

    def ends_meet(self, inputs: Inputs) -> bool:  # noqa: D102
        return bool(ways_back(self.arrays, inputs.translation.reshape(-1, self.rod_count)).any())

    @cached_property
    def arrays(self) -> RodArrays:
        """The rods as kernels read them."""
        return lower(self.rods)

    def bent_at_base(self, unknowns: FloatArray) -> FloatArray | None:  # noqa: D102
        rest = self.rods[0].sections[0].precurvature
        rest = rest(0.0) if isinstance(rest, Profile) else rest
        if self.rod_count > 1 or self.transmission or self.rods[0].carried or rest.ndim > 1:
            return None
        return np.asarray(unknowns[:, :2] - rest[:2])

    def with_rods(self, rods: Sequence[Rod]) -> Self:  # noqa: D102
        result = copy(self)
        result.rods = tuple(rods)
        for name in ("arrays", "longest", "stiffest", "_specs"):
            result.__dict__.pop(name, None)
        return result

    def features(self, inputs: Inputs, *, enabled: Iterable[str] = ()) -> tuple[Features, ...]:  # noqa: D102
        active = (*inputs.active, *enabled)
        options: dict[str, Any] = {"rod_count": self.rod_count, "transmission": self.transmission}
        return (scene_features(self.arrays, active, inputs.profiles, **options),)

    def influences(self, inputs: Inputs) -> Mapping[str, Influence]:  # noqa: D102
        if self.arrays.members or self.arrays.foundation or self.arrays.eccentric:
            return {}  # what they hold the rod back by is not bounded
        whole = np.broadcast_shapes(inputs.batch_shape, self.batch_shape)
        return influences(self.arrays, inputs, whole, transmission=self.transmission)

    @reusable
    def problem(  # noqa: D102
        self, inputs: Inputs, *, instances: IntArray | None = None, **options: Any
    ) -> BackboneProblem:
        arrays, base = self.arrays, self.base
        if instances is not None:
            whole = np.broadcast_shapes(inputs.batch_shape, self.batch_shape)
            inputs = inputs.take(whole, instances)
            arrays = arrays.take(whole, instances)
            base = take(base, whole, instances, tail=2) if base.ndim > 2 else base
        return BackboneProblem(self.rods, base, inputs, transmission=self.transmission, arrays=arrays, **options)


def check_drives(inputs: Inputs, rods: Sequence[Rod]) -> None:
    """Refuse what lines cannot be driven by, by a ``ValueError``."""
    if "tension" not in inputs.given:
        return
    if np.min(inputs.tension, initial=0.0) < 0:
        refuse("tension", inputs.tension.tolist(), "must be >= 0: a tendon cannot push")
    first = 0
    for rod in rods:
        count = drives(kinds(rod.lines)).count("tension")
        own = inputs.tension[..., first : first + count]
        if rod.discs is not None and count:
            softest = min(float(np.min(section.bending_stiffness)) for section in rod.sections)
            if np.max(own.sum(axis=-1), initial=0.0) * rod.discs**2 >= np.pi**2 * softest:
                refuse(
                    "tension",
                    own.tolist(),
                    f"must be < {np.pi**2 * softest / rod.discs**2:.3g} N together: between discs the rod buckles",
                )
        first += count


def check_reach(inputs: Inputs, rods: Sequence[Rod], *, straight: bool = False) -> None:
    """Refuse translations by which it is not told what lines do, by a ``ValueError``; rods may be ``straight`` behind a plate."""
    for k, rod in enumerate(rods):
        own = inputs.translation[..., k]
        for line in rod.lines:
            reach = line.reach_straight if straight else line.reach
            if np.min(own, initial=0.0) < -reach:
                refuse(
                    "translation",
                    inputs.translation.tolist(),
                    f"must be >= {0.0 - reach:g} m: beyond, the length at rest of line {line.name!r} varies",
                )


def surely_driven(name: str, values: Sequence[float], rods: Sequence[Rod]) -> bool:
    """Whether lines of these rods can surely be driven by these values of one of ``DRIVES``."""
    return name != "tension" or (min(values) >= 0 and all(rod.discs is None for rod in rods))


def _blocks(features: Features) -> list[Block]:
    """One block a rod with a torque of its own, the outermost first; what is left is the innermost's, and couples the others.

    What is left of rods side by side is that of the line they share. A line that is driven by its displacement has its own,
    before its rod's. An unknown base force, which all rods share, is the last.
    """
    slots = unknowns_of(features)
    moment, force, first = slots.places["moment"], slots.places["force"], slots.places["torques"].start
    places: list[tuple[str, slice, int | None]]
    driven = np.arange(slots.size)[slots.places["drives"]]
    carried_by = features.member_rods or (0,) * len(features.members)
    carriers = [rod for rod, kind in zip(carried_by, features.members, strict=True) if kind.conditioned]
    lines = [Block(f"line {k + 1}", row[None], row[None], rod) for k, (row, rod) in enumerate(zip(driven, carriers, strict=True))]
    if lines and features.rod_count == 1:
        own_rows = np.delete(np.arange(slots.size), driven)
        return [*lines, Block("rod 1", own_rows, own_rows, 0)]
    if not features.torque_count:  # one rod, or several that are one
        places = [("rod 1", slice(0, slots.size), 0)] if not lines else [("tube 1", moment, 0), ("base force", force, None)]
    else:
        own = features.rod_count - features.torque_count  # that have no torque of their own
        places = [
            (f"tube {k + 1}", slice(first + k - own, first + k - own + 1), k) for k in range(features.rod_count - 1, own - 1, -1)
        ]
        places += [("tube 1" if own else "line", moment, 0 if own else None)] if features.moment else []
        places += [("base force", force, None)] if features.base_force_unknown else []
    return lines + [Block(name, place, place, rod) for name, place, rod in places if place.stop > place.start]


def step_multiple(steps: int) -> int:
    """Power of two of which the steps of each stretch are a multiple, so that doubling ``steps`` doubles every share.

    Without it, the rounding of the shares spoils the order that halving the step shows. A share is still told from
    another to one part in 8 or better.
    """
    multiple = 1
    while steps % 2 == 0 and steps >= 16:
        steps //= 2
        multiple *= 2
    return multiple


def _merge_profiles(inputs: Inputs) -> tuple[FloatArray, FloatArray]:
    """Load profiles on common pieces: ends (piece,), coefficients (piece, 6 (DEGREE + 1))."""
    if not inputs.profiles:
        return np.zeros(1), np.zeros((1, 6))
    ends = np.unique(np.concatenate([p.ends for p in inputs.profiles.values()]))
    result = np.zeros((len(ends), 6, DEGREE + 1))
    for row, name in ((0, "distributed_force"), (3, "distributed_moment")):
        profile = inputs.profile(name)
        if profile is None:
            continue
        start = 0.0
        for piece, end in enumerate(ends):
            result[piece, row : row + 3] = interpolate(profile, start, end).T
            start = end
    return ends, result.reshape(len(ends), -1)
