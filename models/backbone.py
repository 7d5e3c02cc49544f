"""One backbone: its inputs, and its boundary problem, the buffers and launches of its kernels."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, ClassVar

import numpy as np
import warp as wp

from multirod.assembly import Assembly, pose
from multirod.inputs import Inputs, InputSpec
from multirod.models import backbone_kernels as kernels
from multirod.models.features import Features
from multirod.models.integrators import Integrator
from multirod.problem import Block, BoundaryProblem, Shape
from multirod.profile import DEGREE, interpolate
from multirod.rod import Rod, RodArrays, lower
from multirod.validation import Described, FloatArray, refuse

STEP_LIMIT = 100_000
_FEATURE_INPUTS = {
    "force": ("tip_force", "follower_force", "distributed_force", "gravity"),
    "tip_moment": ("tip_moment",),
    "distributed_force": ("distributed_force", "gravity"),
    "distributed_moment": ("distributed_moment",),
    "follower_force": ("follower_force",),
    "follower_moment": ("follower_moment",),
    "measured": ("tip_curvature",),
}


class BackboneProblem(BoundaryProblem):
    """One backbone of n >= 1 concentric rods, clamped at its base, loaded along its length and at its free tip.

    Unknowns are the curvature at the base of a single rod (``docs/model.md``, equation 10), then, where a follower force
    acts, the base force in curvature units.
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
    ) -> None:
        rod_batch = np.broadcast_shapes(*(rod.batch_shape for rod in rods))
        batch_shape = np.broadcast_shapes(inputs.batch_shape, rod_batch, base.shape[:-2])
        self.rods = tuple(rods)
        self.base = base
        self.integrator = integrator
        self.enabled = frozenset(enabled)
        self.transmission = transmission
        self.arrays = lower(rods, batch_shape if rod_batch else ())
        self.features = self._features(inputs, pose, pose_sensitivities, direction_count)
        n = self.features.unknown_count
        super().__init__(
            unknown_count=n,
            batch_shape=batch_shape,
            input_count=kernels.input_size(len(rods)),
            blocks=_blocks(len(rods), n, self.features.follower_force),
            direction_count=direction_count,
            pose_sensitivities=pose_sensitivities,
            device=device,
        )
        self._table = self._make_table(inputs)
        self.write("inputs", self.pack(inputs))
        self._launch = self._record(self.features, self._make_call(0))

    # ---- what is compiled in ----

    def _features(self, inputs: Inputs, pose: bool, pose_sensitivities: bool, direction_count: int) -> Features:
        active = {name for name in inputs.given if inputs.is_active(name)} | self.enabled
        needs = {feature: any(name in active for name in names) for feature, names in _FEATURE_INPUTS.items()}
        needs["force"] |= "distributed_force" in inputs.profiles
        return Features(
            rod_count=len(self.rods),
            precurvature_degree=self.arrays.degree,
            profile_degree=DEGREE if inputs.profiles else -1,
            shear=self.arrays.shear,
            transmission=self.transmission,
            anisotropic=self.arrays.anisotropic and len(self.rods) > 1,
            pose=pose,
            pose_sensitivities=pose_sensitivities,
            directions=direction_count,
            **needs,
        )

    # ---- arrays ----

    def _array(self, value: Any, dtype: Any = wp.float64) -> Any:
        return wp.array(np.ascontiguousarray(value, dtype=np.float64), dtype=dtype, device=self.device)

    def _make_table(self, inputs: Inputs) -> Any:
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
        ends, coefficients = _merge_profiles(inputs)
        table.profile_end = self._array(ends)
        table.profile = self._array(coefficients)
        return table

    def _make_call(self, node_count: int) -> Any:
        call: Any = kernels.Call()
        shared = ("active", "unknowns", "inputs", "load_factor", "directions", "fault", "step_count", "residual", "gamma")
        for name in (*shared, "residual_directions", "position", "rotation", "pose_columns"):
            setattr(call, name, getattr(self, name))
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
        return call

    def _record(self, features: Features, call: Any) -> Any:
        kernel = kernels.make_kernel(features, self.integrator.tableau)
        return wp.launch(kernel, dim=self.instance_count, inputs=[self._table, call], device=self.device, record_cmd=True)

    # ---- the interface ----

    def takes(self, name: str) -> bool:  # noqa: D102
        needed = [feature for feature, names in _FEATURE_INPUTS.items() if name in names]
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

    def integrate(self) -> None:  # noqa: D102
        self._launch.launch()

    def guess(self) -> FloatArray:  # noqa: D102
        result = np.zeros((self.instance_count, self.unknown_count))
        if len(self.rods) == 1:
            result[:, :3] = self.arrays.precurvature[:, 0, 0, :3]
        return result

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
        if self.features.measured:
            gap = inputs[:, self.input_slice("tip_curvature")] - table.precurvature[:, 0, -1, :3]
            total += np.linalg.norm(gap, axis=1) * length
        profile = self._table.profile.numpy()
        if profile.size:
            size = np.abs(profile.reshape(len(profile), 6, -1)).sum(-1).max(0)
            total += (size[:3].max() * length**3 + size[3:].max() * length**2) / stiffness
        return total

    def shapes(self, node_count: int) -> tuple[tuple[Shape, ...], FloatArray]:  # noqa: D102
        features = replace(self.features, nodes=True, pose=True, sensitivities=False, pose_sensitivities=False, directions=0)
        call = self._make_call(node_count)
        # outputs of its own: the residual and Gamma of the solve stay as they are
        for name in ("residual", "position", "rotation"):
            buffer = getattr(self, name)
            setattr(call, name, wp.zeros(buffer.shape, dtype=buffer.dtype, device=self.device))
        self._record(features, call).launch()
        shape = Shape(
            arclength=call.node_arclength.numpy(),
            position=call.node_position.numpy(),
            rotation=call.node_rotation.numpy(),
            curvature=call.node_curvature.numpy(),
            moment=call.node_moment.numpy(),
            force=call.node_force.numpy(),
        )
        return (shape,), call.energy.numpy()


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
        if inputs.is_active("gravity") and not any(np.any(s.linear_density) for rod in self.rods for s in rod.sections):
            refuse("gravity", inputs.gravity.tolist(), "must be zero: no rod has a linear_density (or, for Rod.tube, a density)")

    def problem(self, inputs: Inputs, **options: Any) -> BackboneProblem:  # noqa: D102
        return BackboneProblem(self.rods, self.base, inputs, transmission=self.transmission, **options)


def _blocks(rod_count: int, unknown_count: int, follower_force: bool) -> list[Block]:
    """One block a rod, the outermost first: the innermost carries the bending, and with it what couples the others.

    An unknown base force, which all rods share, is the last.
    """
    if rod_count == 1:
        return [Block("rod 1", slice(0, unknown_count), slice(0, unknown_count))]
    force = unknown_count - 3 if follower_force else unknown_count
    inner = force - (rod_count - 1)
    places = {f"tube {k + 1}": slice(inner + k - 1, inner + k) for k in range(rod_count - 1, 0, -1)}
    places["tube 1"] = slice(0, inner)
    if follower_force:
        places["base force"] = slice(force, unknown_count)
    return [Block(name, place, place) for name, place in places.items()]


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
