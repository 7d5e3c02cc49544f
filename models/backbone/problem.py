"""One backbone: its inputs, and its boundary problem, the buffers and launches of its kernels."""

from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from copy import copy
from dataclasses import replace
from functools import cached_property
from typing import Any, ClassVar, Self

import numpy as np
import warp as wp
from numpy.typing import NDArray

from multirod.assembly import Assembly, pose
from multirod.batch import IntArray, take
from multirod.inputs import Inputs, InputSpec
from multirod.integrators import AdaptiveIntegrator, Integrator
from multirod.launch import LONGEST
from multirod.models.backbone.influence import Influence, influences
from multirod.models.backbone.kernels.layout import arguments as kernels
from multirod.models.backbone.kernels.layout.features import Features
from multirod.models.backbone.mode_bounds import bound_modes
from multirod.models.backbone.passes import LanePass
from multirod.models.backbone.second_variation import (
    MOST_NODES,
    CondensedForm,
    NodeColumns,
    certain_determinant,
    condensed_form,
    segments_needed,
)
from multirod.models.backbone.segments import BackboneSegments
from multirod.problem import Block, BoundaryProblem, Shape
from multirod.profile import DEGREE, interpolate
from multirod.rod import Rod, RodArrays, lower
from multirod.segments import Segments, taken
from multirod.stability import Modes
from multirod.validation import Described, FloatArray, refuse

STEP_LIMIT = 100_000
FINEST = 1e-12  # relative tolerance of an integration to which rounding leaves its order
POSES_APART = 64  # instances from which leaving poses out saves more than two kernels cost
FEWEST_NODES = 9
MOST_NODES_AT_FIRST = 33
RIGID = 1e6  # torsional over bending stiffness, of a rod rigid in torsion, where its modes are counted
_PARTS = 64  # of the length, over which starts are bounded
_CROWDING = 1.5  # most equilibria are far inside the bounds
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
    needs["force"] |= held or "distributed_force" in profiles
    return Features(
        rod_count=rod_count,
        precurvature_degree=arrays.degree,
        profile_degree=DEGREE if profiles else -1,
        shear=arrays.shear,
        members=arrays.members,
        transmission=transmission,
        anisotropic=arrays.anisotropic and rod_count > 1,
        torsion=rod_count > 1 and (held or arrays.torsion),
        held=held,
        **needs,
    )


class BackboneProblem(BoundaryProblem):
    """One backbone of n >= 1 concentric rods, clamped at its base, loaded along its length and at its free tip.

    Unknowns are, in curvature units (``docs/model.md``, equation 10): for a single rod the curvature at its base; for several
    the bending moment there, if any load acts, and their torques; then, where a follower force acts, the base force.
    With ``held`` the tip is not free: the base force is unknown too, the pose and wrench of the tip are written out with their
    columns, and of the residual only the torques of the rods that end before it. ``arrays`` are those of ``rods``, or of several
    backbones of the same build along the last batch axis.
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
        enabled: Sequence[str] = (),
        held: bool = False,
        arrays: RodArrays | None = None,
    ) -> None:
        arrays = lower(rods) if arrays is None else arrays
        batch_shape = np.broadcast_shapes(inputs.batch_shape, arrays.batch_shape, base.shape[:-2])
        self.rods = tuple(rods)
        self.base = base
        self.integrator = integrator
        self.enabled = frozenset(enabled)
        self._inputs = inputs
        self._options: dict[str, Any] = {
            "integrator": integrator,
            "device": device,
            "transmission": transmission,
            "pose": pose,
            "pose_sensitivities": pose_sensitivities,
            "direction_count": direction_count,
            "held": held,
        }
        self.transmission = transmission
        self.held = held
        self.arrays = arrays.take(batch_shape)
        self.features = self._features(inputs, pose, pose_sensitivities, direction_count)
        n = self.features.unknown_count
        super().__init__(
            unknown_count=n,
            batch_shape=batch_shape,
            input_count=kernels.input_size(len(rods)),
            blocks=_blocks(self.features),
            direction_count=direction_count,
            pose_sensitivities=pose_sensitivities,
            device=device,
        )
        if held:
            columns = n + direction_count
            self.tip_wrench: Any = wp.zeros((self.instance_count, 6), dtype=wp.float64, device=device)
            self.wrench_columns: Any = wp.zeros((self.instance_count, 6, columns), dtype=wp.float64, device=device)
        self.rounding = float(np.finfo(integrator.precision).eps)
        self.measured = inputs.measured
        self._table = self._make_table(inputs)
        self.write("inputs", self.pack(inputs))
        self.moment_unit = self._moment_unit()
        self.moment_axes = self._moment_axes()
        self.turn_stiffness = self._stiffness_over_length()
        self._call = self._make_call(0)
        self.launch = self._record(self.features, self._call)

    # ---- what is compiled in ----

    def _features(self, inputs: Inputs, pose: bool, pose_sensitivities: bool, direction_count: int) -> Features:
        active = (*inputs.active, *self.enabled)
        options: dict[str, Any] = {"rod_count": len(self.rods), "transmission": self.transmission, "held": self.held}
        needed = scene_features(self.arrays, active, inputs.profiles, **options)
        return replace(needed, pose=pose, pose_sensitivities=pose_sensitivities, directions=direction_count > 0)

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
            table.profile_end, table.profile = self._table.profile_end, self._table.profile
            return table
        ends, coefficients = _merge_profiles(inputs)
        table.profile_end = self._array(ends)
        table.profile = self._array(coefficients)
        return table

    def _make_call(self, node_count: int) -> Any:
        call: Any = kernels.Call()
        self.share(call)
        if self.held:
            call.tip_wrench, call.wrench_columns = self.tip_wrench, self.wrench_columns
        call.direction_stride = 1
        call.steps = float(self.integrator.steps or 0)
        call.step_multiple = 1.0 if node_count else float(step_multiple(self.integrator.steps or 1))
        call.rtol = self.integrator.rtol
        call.atol = self.integrator.atol
        call.step_limit = STEP_LIMIT
        call.node_count = node_count
        if node_count:
            shape = (self.instance_count, node_count)
            call.node_arclength = wp.zeros(shape, dtype=wp.float64, device=self.device)
            for name in ("position", "curvature", "moment", "force"):
                setattr(call, f"node_{name}", wp.zeros(shape, dtype=wp.vec3d, device=self.device))
            call.node_rotation = wp.zeros(shape, dtype=wp.mat33d, device=self.device)
            call.energy = wp.zeros(self.instance_count, dtype=wp.float64, device=self.device)
            call.work = wp.zeros(self.instance_count, dtype=wp.float64, device=self.device)
        return call

    def _record(self, features: Features, call: Any, table: Any = None, *, columns: tuple[int, int] | None = None) -> LanePass:
        """A launch; ``columns`` by unknowns and by directions, all by default."""
        # what looks at a solution, or judges it, is double precision whatever the solve's own integrations are
        precision = "float64" if features.nodes else self.integrator.precision
        return LanePass(
            features,
            self.integrator,
            precision,
            table or self._table,
            call,
            (features.unknown_count, self.direction_count) if columns is None else columns,
            self.device,
            longest=max(1, LONGEST // len(self.rods)),
            heed=self.heed_stop,
        )

    # ---- the interface ----

    def part(self, instances: IntArray, *, double: bool = False) -> "BackboneProblem":  # noqa: D102
        return self._part(instances, self.integrator.in_double() if double else self.integrator)

    def finer(self, instances: IntArray) -> "BackboneProblem | None":  # noqa: D102
        coarse = self.integrator.in_double()
        if not isinstance(coarse, AdaptiveIntegrator) or not coarse.adaptive or coarse.rtol <= FINEST:
            return None
        return self._part(instances, replace(coarse, rtol=FINEST, atol=min(coarse.atol, 0.01 * FINEST)))

    def _part(self, instances: IntArray, integrator: Integrator) -> "BackboneProblem":
        shape = self.batch_shape
        base = take(self.base, shape, instances, tail=2) if self.base.ndim > 2 else self.base
        arrays = self.arrays.take(shape, instances)
        inputs = self._inputs.take(shape, instances)
        options = {**self._options, "integrator": integrator}
        result = BackboneProblem(self.rods, base, inputs, enabled=tuple(self.enabled), arrays=arrays, **options)
        result.stop = self.stop
        for name in ("inputs", "unknowns"):
            result.write(name, self.read(name)[instances])
        result.breakpoints = taken(self.breakpoints, instances)
        return result

    def takes(self, name: str) -> bool:  # noqa: D102
        needed = [feature for feature, names in FEATURE_INPUTS.items() if name in names]
        return all(getattr(self.features, feature) for feature in needed)

    def pack(self, inputs: Inputs) -> FloatArray:  # noqa: D102
        packed = super().pack(inputs)
        packed[:, -1] = 1.0  # scale of the load profiles
        return packed

    def input_slice(self, name: str) -> slice:  # noqa: D102
        n = len(self.rods)
        if name in ("rotation", "translation"):
            start = 0 if name == "rotation" else n
            return slice(start, start + n)
        start = 2 * n + 3 * kernels.INPUT_VECTORS.index(name)
        return slice(start, start + 3)

    def _integrate(self) -> None:
        self.launch.launch()

    def focus(self, instances: IntArray | None = None) -> None:  # noqa: D102
        super().focus(instances)
        self.launch.set_dim(self.listed)

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
        self.launch = self._record(replace(f, pose=False), self._call)
        try:
            yield
        finally:
            self.launch = whole
        active = self.active.numpy().copy()
        self.active.fill_(1)
        self._record(replace(f, directions=False), self._call, columns=(0, 0)).launch()
        self.active.assign(active)

    def guess(self) -> FloatArray:  # noqa: D102
        result = np.zeros((self.instance_count, self.unknown_count))
        if len(self.rods) == 1:
            result[:, :3] = self.arrays.precurvature[:, 0, 0, :3]
        return result

    def adopt(self, unknowns: FloatArray) -> FloatArray:  # noqa: D102
        torques = self.features.torque_count
        given, own = unknowns.shape[1] - torques, self.unknown_count - torques
        if given == own or given not in ((0, 3, 6) if torques else (3, 6)):
            return super().adopt(unknowns)
        if given == 0:
            unknowns = self._with_moment(unknowns)
        if own == 0:
            return unknowns[:, 3 : 3 + torques]
        if own == 3:
            return unknowns[:, : 3 + torques]
        return unknowns if given == 6 else np.concatenate([unknowns, self._dead_base_force(unknowns)], axis=1)

    def _with_moment(self, torques: FloatArray) -> FloatArray:
        """Unknowns of rods that carry a moment, from those of unloaded ones: none, and rod 1 has what the others leave, (8b)."""
        first = self.arrays.material[:, :, 0]
        unit = np.minimum(first[..., 2], first[..., :2].max(axis=-1))
        inner = -(torques * unit[:, 1:]).sum(axis=1, keepdims=True) / unit[:, :1]
        return np.concatenate([np.zeros((len(torques), 2)), inner, torques], axis=1)

    def _dead_base_force(self, unknowns: FloatArray) -> FloatArray:
        """The base force in curvature units, equation (13), without the follower force, at ``unknowns`` without it."""
        call = self._node_pass(2, unknowns=unknowns, follower_force=False)
        scale = self._table.length_scale.numpy() / self.arrays.material[:, 0, 0, :2].max(axis=-1)
        return np.asarray(call.node_force.numpy()[:, 0] * scale[:, None])

    def curvature_scale(self) -> FloatArray:  # noqa: D102
        bent = np.abs(self.arrays.precurvature).reshape(*self.arrays.precurvature.shape[:3], -1, 3).sum(axis=(3, 4))
        return self._each(np.maximum(1 / self.arrays.end[:, 0, -1], bent.max(axis=(1, 2))))

    def load_scale(self) -> FloatArray:  # noqa: D102
        inputs = self.read("inputs")
        table = self.arrays
        stiffness = table.material[:, 0, :, :3].min(axis=(1, 2))
        length = table.end[:, 0, -1] + inputs[:, self.input_slice("translation")][:, 0]
        weight = table.material[:, 0, :, 9].max(axis=1)
        power = {"tip_force": 2, "follower_force": 2, "tip_moment": 1, "follower_moment": 1}
        power |= {"distributed_force": 3, "distributed_moment": 2, "gravity": 3}
        total = np.zeros(self.instance_count)
        for name, exponent in power.items():
            size = np.linalg.norm(inputs[:, self.input_slice(name)], axis=1) * length**exponent / stiffness
            total += size * weight if name == "gravity" else size
        total += self._magnetic_load() * length**2 / stiffness
        if self.features.measured:
            gap = inputs[:, self.input_slice("tip_curvature")] - table.precurvature[:, 0, -1, :3]
            total += np.linalg.norm(gap, axis=1) * length
        profile = self._table.profile.numpy()
        if profile.size:
            size = np.abs(profile.reshape(len(profile), 6, -1)).sum(-1).max(0)
            total += (size[:3].max() * length**3 + size[3:].max() * length**2) / stiffness
        return total

    def _magnetic_load(self) -> FloatArray:
        """Bound of the moment per length of a magnetic field on all rods [N], shape (instance_count,)."""
        if not self.features.magnetised:
            return np.zeros(self.instance_count)
        strongest = np.linalg.norm(self.arrays.material[..., 10:13], axis=-1).max(axis=2).sum(axis=1)
        field = np.linalg.norm(self.read("inputs")[:, self.input_slice("magnetic_field")], axis=1)
        return np.asarray(self._each(strongest) * field)

    def turning(self, before: FloatArray | None = None) -> FloatArray:  # noqa: D102
        angles = self.read("inputs")[:, self.input_slice("rotation")]
        if before is not None:
            return np.asarray(np.ptp(angles - before[:, self.input_slice("rotation")], axis=1))
        size = np.diff(self.arrays.end, axis=2, prepend=0.0)
        own = np.abs(self.arrays.precurvature.reshape(*size.shape, -1, 3)[..., 2]).sum(axis=-1)
        twist = (own * size).sum(axis=2).max(axis=1) if len(self.rods) > 1 and not self.held else 0.0
        return np.asarray(np.ptp(angles, axis=1) + twist)

    def mode_bounds(self) -> FloatArray:  # noqa: D102
        if len(self.rods) == 1 or self.held or not self.features.torsion:
            return super().mode_bounds()
        inputs = self.read("inputs")
        EI, kappa = self._by_section()
        start = inputs[:, self.input_slice("translation")]
        end, compliance = self._each(self.arrays.end), self._each(self.arrays.material[..., 5])
        bounds = bound_modes(start, end, compliance, EI, kappa, self._dead_load())
        bounds[:, 0] += np.where(self.has_potential, 0.0, 0.5 * self.load_scale())
        bounds[~self.has_potential, 1] = np.inf
        if (
            self.features.anisotropic or self.features.magnetised
        ):  # they resist being turned against their neighbours even where all are straight
            bounds = np.maximum(bounds, (1.0, np.inf))
        return np.asarray(bounds)

    def _dead_load(self) -> FloatArray:
        """Bound of the dead forces' part of the internal force [N], shape (instance_count,)."""
        inputs = self.read("inputs")
        length = self._ends().max(axis=1)
        sizes = {name: np.linalg.norm(inputs[:, self.input_slice(name)], axis=1) for name in kernels.INPUT_VECTORS}
        weight = self._each(self.arrays.material[..., 9].max(axis=2).sum(axis=1))
        total = sizes["tip_force"] + (sizes["distributed_force"] + weight * sizes["gravity"]) * length
        profile = self._table.profile.numpy()
        if self.features.profile_degree >= 0:
            total = total + np.abs(profile.reshape(len(profile), 6, -1)).sum(-1).max(0)[:3].sum() * length * np.abs(inputs[:, -1])
        return np.asarray(total)

    def shapes(self, node_count: int) -> tuple[tuple[Shape, ...], FloatArray]:  # noqa: D102
        fields = ("arclength", "position", "rotation", "curvature", "moment", "force")
        calls = [self._node_pass(node_count, rod=rod) for rod in range(len(self.rods))]
        shapes = [{name: getattr(call, f"node_{name}").numpy() for name in fields} for call in calls]
        energy = np.array(calls[0].energy.numpy())
        if self.breakpoints:
            others, stored, _ = self._cut.shapes(self.breakpoints, node_count)
            for k in self.breakpoints:
                energy[k] = stored[k]
                for shape, other in zip(shapes, others, strict=True):
                    for name in fields:
                        shape[name][k] = getattr(other, name)[k]
        return tuple(Shape(**shape) for shape in shapes), energy

    def segments(self) -> Segments | None:  # noqa: D102
        return self._cut if len(self.rods) == 1 and not self.held else None

    @cached_property
    def _cut(self) -> BackboneSegments:
        return BackboneSegments(self)

    # ---- stability and multiplicity ----

    @property
    def multistable(self) -> bool:  # noqa: D102
        return len(self.rods) > 1

    @property
    def has_potential(self) -> NDArray[np.bool_]:  # noqa: D102
        # a moment has none, dead or not, nor what follows the tip
        inputs = self.read("inputs")
        without = ("tip_moment", "distributed_moment", "follower_force", "follower_moment")
        acting = np.column_stack([inputs[:, self.input_slice(name)] for name in without]).any(axis=1)
        profiles = (
            self._table.profile.numpy().reshape(-1, 6, DEGREE + 1) if self.features.profile_degree >= 0 else np.zeros((1, 6, 1))
        )
        acting |= bool(profiles[:, 3:].any()) & (inputs[:, -1] != 0)
        return np.asarray(~acting & (not self.features.measured))

    def potential(self) -> FloatArray:  # noqa: D102
        call = self._node_pass(2)
        stored, work = np.array(call.energy.numpy()), np.array(call.work.numpy())
        if self.breakpoints:
            _, energy, done = self._cut.shapes(self.breakpoints, 2)
            for k in self.breakpoints:
                stored[k], work[k] = energy[k], done[k]
        return np.where(self.has_potential, stored - work, np.nan)

    def stored_and_lost(self) -> tuple[FloatArray, FloatArray]:
        """Elastic energy, and the potential energy of what acts along a held rod but not at its tip [J], shape (instance_count,)."""
        call = self._node_pass(2)
        base = np.broadcast_to(self._table.base_position.numpy(), (self.instance_count, 3))
        tip = (self.tip_wrench.numpy()[:, :3] * (call.position.numpy() - base)).sum(axis=1)
        return np.asarray(call.energy.numpy()), np.asarray(tip - call.work.numpy())

    def starts(self, count: int, first: int = 0) -> FloatArray:  # noqa: D102
        n = len(self.rods)
        moment, torque, unit = self._start_sizes()
        points = spread(np.arange(first, first + count), n + 2)[:, None]
        points = np.sign(points) * np.abs(points) ** _CROWDING
        torques = self.features.torque_count
        result = np.zeros((count, self.instance_count, 3 + torques + (3 if self.features.base_force_unknown else 0)))
        result[..., :2] = points[..., :2] * moment[:, None] * unit[:, :2]
        if not torques:
            result[..., 2] = points[..., 2] * moment * unit[:, 2]
            return result + self.guess()
        tau = points[..., 2:] * torque
        # all torques together balance the load
        tau[..., -1] = points[..., -1] * moment - tau[..., :-1].sum(axis=-1)
        result[..., 2 : 2 + n] = tau * unit[:, 2:]
        return result if self.features.moment else result[..., 3:]

    def _start_sizes(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """What bounds the equilibria: moment of the loads at the base [N m], (instance_count,), torques there that the tubes'
        precurvatures give each other [N m], (instance_count, n), and the unknowns of a unit moment or torque.
        """
        table = self.arrays
        start = self.read("inputs")[:, self.input_slice("translation")]
        length = (table.end[:, :, -1] + start).max(axis=1)
        first = self._each(table.material[:, :, 0, :3])
        bending = first[..., :2].max(axis=2)
        moment = self.load_scale() * self._each(table.material[:, 0, :, :3].min(axis=(1, 2))) / length
        torque = np.zeros((self.instance_count, len(self.rods)))
        for part in (np.arange(_PARTS) + 0.5) / _PARTS:
            stiffness, bend = self._bending_at((part * length)[:, None] - start)
            others = bend.sum(axis=1, keepdims=True) - bend
            torque += bend * others / stiffness.sum(axis=1, keepdims=True) * (length / _PARTS)[:, None]
        shared = np.broadcast_to(bending.sum(axis=1)[:, None], (self.instance_count, 2))
        return moment, torque, 1 / np.concatenate([shared, np.minimum(first[..., 2], bending)], axis=1)

    def _bending_at(self, s: FloatArray) -> tuple[FloatArray, FloatArray]:
        """``EI`` [N m^2] and a bound of ``EI |u*_xy|`` [N m] of each rod at arclengths of its own, shape (instance_count, n)."""
        end = self._each(self.arrays.end)
        section = (s[..., None] >= end).sum(axis=2)[..., None]
        present = section[..., 0] < end.shape[2]
        section = np.minimum(section, end.shape[2] - 1)
        EI, kappa = self._by_section()
        values = (np.take_along_axis(value, section, axis=2)[..., 0] * present for value in (EI, EI * kappa))
        return next(values), next(values)

    def _by_section(self) -> tuple[FloatArray, FloatArray]:
        """Larger ``EI`` [N m^2] and a bound of ``|u*_xy|`` [1/m] of each section, shape (instance_count, n, section)."""
        coefficients = self.arrays.precurvature.reshape(*self.arrays.precurvature.shape[:3], -1, 3)
        kappa = np.linalg.norm(coefficients[..., :2], axis=-1).sum(axis=-1)
        return self._each(self.arrays.material[..., :2].max(axis=-1)), self._each(kappa)

    def modes(self) -> Modes:  # noqa: D102
        form, determinant = self.condensed_form()
        modes = form.modes(self._stiffness_over_length())
        potential = self.has_potential
        judged = potential & all(kind.convex for kind in self.features.members)
        modes.known[~judged] = False
        modes.values[~judged] = np.nan
        # det Gamma is positive where nothing acts
        modes.diverging[:] = ~potential & (determinant < 0) & (not self.features.measured)
        return modes

    def condensed_form(self) -> tuple[CondensedForm, FloatArray]:
        """The second variation at ``unknowns``, condensed to the tip, and ``det Gamma`` (instance_count,), NaN of breakpoints and
        where rounding hides its sign.

        One integration over as many nodes as the loads call for; where the moments found call for more, another one.
        """
        unit, n = self._stiffness_over_length(), len(self.rods)
        size = n + 2 + (3 if self.held else 0)
        count = self.instance_count
        form = CondensedForm(np.full((count, size, size), np.nan), np.zeros(count, dtype=np.int32), np.zeros(count, dtype=bool))
        determinant = np.full(count, np.nan)
        if n > 1 and not np.isfinite(self.arrays.material[..., 2]).all():
            return form, determinant  # a torque of each that nothing determines
        # each instance has its own number of nodes, whatever stands beside it in the batch
        nodes = _nodes(np.minimum(np.nan_to_num(self._segments_expected()), MOST_NODES_AT_FIRST - 2))
        open_ = np.ones(count, dtype=bool)
        if self.breakpoints:
            cut = list(self.breakpoints)
            form.put(cut, self._cut.condensed_form(self.breakpoints))
            open_[cut] = False
        while open_.any():
            node_count = int(nodes[open_].min())
            chosen = open_ & (nodes == node_count)
            call = self._node_pass(node_count, chosen, columns=True)
            needed = self._segments_of(call)
            done = chosen & (needed < node_count)
            if done.any():
                found = condensed_form(self._node_columns(call, done), unit[done])
                form.put(done, found)
                determinant[done] = certain_determinant(call.gamma.numpy()[done])
            more = chosen & ~done & (needed < MOST_NODES - 1)
            nodes[more] = _nodes(needed[more])
            open_ &= ~chosen | more
        return form, determinant

    def _node_columns(self, call: Any, chosen: NDArray[np.bool_]) -> NodeColumns:
        """What a pass over nodes says of variations of the instances ``chosen``."""
        rows = len(self.rods) + 2
        ends = self._ends()[chosen]
        arclength, configuration = call.column_arclength.numpy()[chosen], call.node_columns.numpy()[chosen, :, :rows]
        momenta = call.tip_columns.numpy()[chosen, :rows]
        if not self.held:
            # base forces that follow a load are no variations that keep the forces
            return NodeColumns(arclength, configuration[..., :rows], momenta[..., :rows], ends)
        by_unknowns = self.wrench_columns.numpy()[chosen, :, : self.unknown_count]
        momenta = np.concatenate([by_unknowns[:, 3:], momenta[:, 3:]], axis=1)
        return NodeColumns(arclength, configuration, momenta, ends, by_unknowns[:, :3], call.pose_columns.numpy()[chosen, :3])

    def _ends(self) -> FloatArray:
        """Arclength at which each rod ends [m], shape (instance_count, n)."""
        return np.asarray(self.arrays.end[:, :, -1] + self.read("inputs")[:, self.input_slice("translation")])

    def _moment_unit(self) -> FloatArray | None:
        """(11), (12)."""
        if len(self.rods) > 1 or self.held or self.features.follower_force:
            return None
        unit = np.array(self.arrays.material[:, 0, -1, :3])
        if not self.features.measured:
            unit[:, 2] = np.minimum(unit[:, 2], unit[:, :2].max(axis=1))
        return np.broadcast_to(unit, (self.instance_count, 3)) if np.isfinite(unit).all() else None

    def _moment_axes(self) -> FloatArray | None:
        """(11b): those of the base."""
        if not self.features.fixed_moment or self.features.measured:
            return None
        return np.broadcast_to(self._table.base_rotation.numpy(), (self.instance_count, 3, 3))

    def _stiffness_over_length(self) -> FloatArray:
        """What stiffnesses of the tip are counted in [N m], shape (instance_count,): the least of the rods', over the length."""
        return np.asarray(self._least_stiffness() / self._ends().max(axis=1))

    def _least_stiffness(self) -> FloatArray:
        return self._each(self.arrays.material[..., :3].min(axis=(1, 2, 3)))

    def _segments_expected(self) -> FloatArray:
        """(7) by what the moments cannot exceed."""
        length, scale = self._ends().max(axis=1), self.load_scale()
        if self.held:
            x = np.abs(self.read("unknowns") - self.guess())
            stiffest = self._each(self.arrays.material[..., :2].max(axis=(1, 2, 3))) / self._least_stiffness()
            scale = scale + stiffest * length * (np.linalg.norm(x[:, :-3], axis=1) + np.linalg.norm(x[:, -3:], axis=1))
        unit = self._least_stiffness() / length
        return self._segments(scale * unit, scale * unit / length, scale / length)

    def _segments_of(self, call: Any) -> FloatArray:
        """(7) by the moments, forces and curvatures of a pass over nodes."""
        largest = (np.linalg.norm(getattr(call, f"node_{name}").numpy(), axis=2) for name in ("moment", "force", "curvature"))
        return self._segments(*(values.max(axis=1) for values in largest))

    def _segments(self, moment: FloatArray, force: FloatArray, curvature: FloatArray) -> FloatArray:
        """(7) from bounds [N m], [N], [1/m], shape (instance_count,)."""
        coupling, potential = moment, force + self._magnetic_load()
        if len(self.rods) > 1:
            EI, kappa = self._by_section()
            bend = EI * kappa
            coupling = moment + bend.max(axis=2).sum(axis=1)
            potential = potential + (bend * (kappa + curvature[:, None, None])).max(axis=2).sum(axis=1)
        return segments_needed(self._ends().max(axis=1), self._least_stiffness(), coupling, potential)

    def _each(self, values: FloatArray) -> FloatArray:
        """Values of the rods' batch, one an instance."""
        return np.broadcast_to(values, (self.instance_count, *values.shape[1:]))

    def _node_pass(
        self,
        node_count: int,
        chosen: NDArray[np.bool_] | None = None,
        *,
        columns: bool = False,
        rod: int | None = None,
        unknowns: FloatArray | None = None,
        **changes: Any,
    ) -> Any:
        """The arrays of a pass over nodes of one rod, or of all together, by outputs of its own: those of the solve stay.

        Columns are those of the model with all its unknowns. ``unknowns`` are those of the solve by default.
        """
        options = {
            "nodes": True,
            "pose": True,
            "node_columns": columns,
            "pose_sensitivities": columns and self.held,
            "directions": False,
        }
        features = replace(self.features, **options | changes)
        call = self._make_call(node_count)
        if columns and not self.features.moment:
            unknowns = self._with_moment(self.read("unknowns"))
        if unknowns is not None:
            call.unknowns = self._array(unknowns)
        call.node_rod = len(self.rods) if rod is None else rod
        count, m = self.instance_count, features.unknown_count
        call.residual = wp.zeros((count, m), dtype=wp.float64, device=self.device)
        call.position = wp.zeros(count, dtype=wp.vec3d, device=self.device)
        call.rotation = wp.zeros(count, dtype=wp.mat33d, device=self.device)
        if chosen is not None:
            call.active = wp.array(chosen.astype(np.int32), device=self.device)
        if columns:
            nodes = node_count - 1 + self.arrays.end[0].size + self._table.profile_end.size
            call.column_arclength = wp.full((count, nodes), np.nan, dtype=wp.float64, device=self.device)
            call.node_columns = wp.zeros((count, nodes, m, m), dtype=wp.float64, device=self.device)
            call.tip_columns = wp.zeros((count, m, m), dtype=wp.float64, device=self.device)
            call.gamma = wp.zeros((count, m, m), dtype=wp.float64, device=self.device)
            call.pose_columns = wp.zeros((count, 6, m), dtype=wp.float64, device=self.device)
        table = self._twisting_table() if columns else None
        self._record(features, call, table, columns=(m if columns else 0, 0)).launch()
        return call

    def _twisting_table(self) -> Any:
        """The rods, one that is rigid in torsion only ``RIGID`` times stiffer than in bending: columns need to twist it."""
        material = self.arrays.material
        rigid = np.isinf(material[..., 2])
        if not rigid.any():
            return self._table
        material = np.array(material)
        material[..., 5][rigid] = 1 / (RIGID * material[..., :2].max(axis=-1)[rigid])
        table = self._make_table(None)
        table.material = self._array(material)
        return table


BY_MATERIAL = ("gravity", "magnetic_field")  # inputs that act on a property which rods may lack

BACKBONE_INPUTS = (
    InputSpec(name="rotation", unit="rad", per_rod=True, description="angle of each rod's base about its axis"),
    InputSpec(name="translation", unit="m", per_rod=True, description="how far each rod is pushed out of the base"),
    InputSpec(name="tip_force", unit="N", description="dead force on the tip, world frame"),
    InputSpec(name="tip_moment", unit="N m", description="dead moment on the tip, world frame"),
    InputSpec(name="follower_force", unit="N", dead_twin="tip_force", description="force on the tip, fixed in the tip frame"),
    InputSpec(name="follower_moment", unit="N m", description="moment on the tip, fixed in the tip frame"),
    InputSpec(name="distributed_force", unit="N/m", function=True, description="dead force per length, world frame"),
    InputSpec(name="distributed_moment", unit="N", function=True, description="dead moment per length, world frame"),
    InputSpec(name="gravity", unit="m/s^2", description="acceleration, world frame; acts on linear_density"),
    InputSpec(name="magnetic_field", unit="T", description="uniform magnetic field, world frame; acts on magnetisation"),
)


class BackboneAssembly(Assembly):
    """An assembly that is one backbone, clamped at its base and free at its tip.

    Args:
        rods: Innermost first.
        base: Pose of the base in the world, shape (..., 4, 4); None is the identity.

    Raises:
        ValueError: If ``base`` is not a pose, or its leading axes do not broadcast with the rods'.
    """

    transmission: ClassVar[bool] = False  # whether the rods twist behind the base plate

    def __init__(self, rods: tuple[Rod, ...], base: Any) -> None:
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
        return np.broadcast_shapes(super().batch_shape, self.base.shape[:-2])

    @property
    def input_specs(self) -> tuple[InputSpec, ...]:  # noqa: D102
        return BACKBONE_INPUTS

    def check(self, inputs: Inputs) -> None:  # noqa: D102
        if inputs.is_active("gravity") and not any(rod.has_mass for rod in self.rods):
            refuse("gravity", inputs.gravity.tolist(), "must be zero: no rod has a linear_density (or, for Rod.tube, a density)")
        if inputs.is_active("magnetic_field") and not any(rod.is_magnetised for rod in self.rods):
            refuse("magnetic_field", inputs.magnetic_field.tolist(), "must be zero: no rod has a magnetisation")

    @cached_property
    def arrays(self) -> RodArrays:
        """The rods as kernels read them."""
        return lower(self.rods)

    def with_rods(self, rods: Sequence[Rod]) -> Self:  # noqa: D102
        result = copy(self)
        result.rods = tuple(rods)
        result.__dict__.pop("arrays", None)
        return result

    def features(self, inputs: Inputs, *, enabled: Iterable[str] = ()) -> tuple[Features, ...]:  # noqa: D102
        active = (*inputs.active, *enabled)
        options: dict[str, Any] = {"rod_count": self.rod_count, "transmission": self.transmission}
        return (scene_features(self.arrays, active, inputs.profiles, **options),)

    def influences(self, inputs: Inputs) -> Mapping[str, Influence]:  # noqa: D102
        if self.arrays.members:
            return {}  # how much stiffer they make the rod is not bounded
        whole = np.broadcast_shapes(inputs.batch_shape, self.batch_shape)
        return influences(self.arrays, inputs, whole, transmission=self.transmission)

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


def spread(numbers: NDArray[np.int_], dimensions: int) -> FloatArray:
    """Points of a sequence that fills the cube from -1 to 1 evenly, number 0 in its centre, shape (len(numbers), dimensions).

    Roberts' additive recurrence: steps by powers of the generalised golden ratio.
    """
    ratio = 2.0
    for _ in range(40):
        ratio = (1 + ratio) ** (1 / (dimensions + 1))
    steps = ratio ** -np.arange(1.0, dimensions + 1)
    return np.asarray(2 * ((0.5 + np.outer(numbers, steps)) % 1) - 1)


def _blocks(features: Features) -> list[Block]:
    """One block a rod with a torque of its own, the outermost first; what is left is the innermost's, and couples the others.

    An unknown base force, which all rods share, is the last.
    """
    torques, count = features.torque_count, features.unknown_count
    force = count - 3 if features.base_force_unknown and torques else count
    inner = force - torques
    places: list[tuple[str, slice, int | None]]
    places = [(f"tube {k + 1}", slice(inner + k - 1, inner + k), k) for k in range(torques, 0, -1)]
    if inner:
        places.append(("tube 1" if torques else "rod 1", slice(0, inner), 0))
    if force < count:
        places.append(("base force", slice(force, count), None))
    return [Block(name, place, place, rod) for name, place, rod in places]


def _nodes(segments: FloatArray) -> NDArray[np.int_]:
    """Numbers of nodes for more than so many segments: one more than a power of two."""
    return np.asarray(1 + 2 ** np.ceil(np.log2(np.maximum(segments + 1e-6, FEWEST_NODES - 1))).astype(int))


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
