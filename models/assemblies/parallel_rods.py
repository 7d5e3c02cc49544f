"""Parallel rods: several rods, or concentric tubes, that hold one platform."""

from collections.abc import Iterable, Mapping, Sequence
from copy import copy
from dataclasses import replace
from itertools import pairwise
from math import inf, prod
from typing import TYPE_CHECKING, Any, ClassVar, Literal, Self, TypeAlias, Unpack
from weakref import ref

import numpy as np
from numpy.typing import NDArray

from multirod import plausibility
from multirod.assembly import Assembly, Backbone
from multirod.batch import IntArray
from multirod.frames import pose
from multirod.inputs import Inputs, InputSpec, InputSpecs
from multirod.models.assemblies.concentric_tubes import ConcentricTubes
from multirod.models.assemblies.inputs import (
    ParallelRodsInput,
    ParallelRodsInputs,
    listed,
)
from multirod.models.assemblies.single_rod import SingleRod
from multirod.models.backbone.assembly import BackboneAssembly
from multirod.models.backbone.checks import check_drives, surely_driven
from multirod.models.backbone.derivatives.designs import design_options, refuse_unknown
from multirod.models.backbone.derivatives.ends import ways_back
from multirod.models.backbone.influence.bound import Influence, influences
from multirod.models.backbone.inputs import BY_MATERIAL, DRIVE_INPUTS, DRIVES, drive_specs
from multirod.models.backbone.kernels.layout.features import Features
from multirod.models.backbone.terms import scene_features
from multirod.models.joint_kernels import CLAMPED, JOINTS, REVOLUTE
from multirod.models.platform import platform_kernels as kernels
from multirod.models.platform.derivatives.columns import input_columns
from multirod.models.platform.derivatives.designs import PARAMETERS, parameter_size
from multirod.models.platform.geometry import Geometry
from multirod.models.platform.inputs import LEG_INPUTS, PLATFORM_INPUTS
from multirod.models.platform.problem import ParallelProblem
from multirod.models.platform.starting.in_pieces import LegsInPieces, pieces_needed
from multirod.naming import names_checked
from multirod.read_only import changed
from multirod.reuse import reusable
from multirod.rod import DENSITY, Rod
from multirod.stand_in import StandIns
from multirod.types import Numbers, Poses
from multirod.validation import Described, FloatArray, array, choice, directions, instance, nonnegative_float, refuse

if TYPE_CHECKING:
    from multirod.models.assemblies.inverse_parallel_rods import InverseParallelRods

OF_NETWORKS = ("universal", "prismatic", "cylindrical")  # joints that there are, but not here
OWN_AXIS = (0.0, 0.0, 1.0)  # of a leg: what its tip turns about where nothing else is said
PLATFORM_WEIGHT = 8 / 3  # a weight on the tip against the same distributed along the rod
PLATFORM_MOMENT = 3 / 2  # times its lever over the length: the moment of that weight about the tip against the weight
CLOSURE = ("shear", "torsion", "anisotropy", "precurvature_profile")  # what these do depends on how the legs hold each other


CUT = "platform"  # of a network, what the legs hold
ON_CUT = {"tip_force": "force", "tip_moment": "moment", "follower_force": "follower_force", "follower_moment": "follower_moment"}
INPUTS = (*LEG_INPUTS[:2], *PLATFORM_INPUTS, *LEG_INPUTS[2:])
Limits: TypeAlias = Sequence[Numbers] | NDArray[Any]  # a pair


class _CutLegs(StandIns):
    """Cuts the legs of a robot: as a network of one platform.

    Args:
        robot: Whose.
        batch_shape: Leading axes of it and of its inputs.
        numbers: Of the instances of a problem, in the flattened batch, shape (k,).
    """

    def __init__(self, robot: "ParallelRods", batch_shape: tuple[int, ...], numbers: IntArray) -> None:
        # a problem that is kept for its robot would keep that too
        self._robot, self._batch_shape, self._numbers = ref(robot), batch_shape, numbers

    def of(self, instances: IntArray) -> "_CutLegs":
        result = copy(self)
        result._numbers = self._numbers[instances]
        return result

    def made(self, problem: Any, instance: int, unknowns: FloatArray) -> LegsInPieces | None:  # noqa: ANN401  (``ParallelProblem``)
        whole, given = self._robot(), problem.inputs_given
        legs = () if whole is None else whole.geometry.legs
        simple = all(leg.rod_count == 1 and not (r.carried or r.loads or r.is_embedded) for leg in legs for r in leg.rods)
        if whole is None or given.profiles or given.is_active("force_point") or not simple:
            return None
        counts = pieces_needed(problem, instance, unknowns)
        if max(counts) == 1:
            return None
        from multirod.files.instances import of_instances
        from multirod.models.assemblies.stacked import stacked

        inputs = given.take(problem.batch_shape, np.array([instance]))
        values = {spec.name: getattr(inputs, spec.name)[0] for spec in LEG_INPUTS}
        values |= {name: {CUT: getattr(inputs, own)[0]} for own, name in ON_CUT.items()}
        own = self._numbers[instance : instance + 1].reshape(())
        robot = of_instances(whole, self._batch_shape, own) if whole.batch_shape else whole
        network = stacked(robot, names=[CUT], segments={f"{CUT} {k}": n for k, n in enumerate(counts) if n > 1})
        asked = network.make_inputs({name: value for name, value in values.items() if np.any(_numbers(value))})
        return LegsInPieces(problem, instance, network.problem(asked, integrator=problem.integrator, device=problem.device))


def _numbers(value: Any) -> FloatArray:  # noqa: ANN401
    return np.asarray(value[CUT] if isinstance(value, dict) else value)


class ParallelRods(Assembly):
    """Legs clamped at their bases that hold one platform, the end effector.

    ``tip_position`` and ``tip_rotation`` of a solution are the platform's frame in the world. Inputs per rod count the rods
    of all legs, leg by leg: ``rotation``, and ``translation``, for a ``Rod`` how far it is pushed out of its base (the length in
    use is ``length + translation``), for a tube of ``ConcentricTubes`` where it starts behind the plate.

    Args:
        legs: 2 to 12, each a ``Rod`` or a ``ConcentricTubes`` (whose own base is not used).
        base: Pose of each leg's base in the world, shape (..., leg_count, 4, 4), or a list of ``Pose``, one a leg.
        platform: Pose of each leg's attachment in the platform's frame, shape (..., leg_count, 4, 4): a clamped tip takes it.
        joints: At the platform: ``"clamped"``, ``"spherical"`` (no moment), or ``"revolute"`` (free to turn about its axis),
            for all legs or one for each.
        joint_axes: Axes of revolute joints in the frame of the attachment, shape (3,) or (leg_count, 3), of which those of other
            joints are not used; the leg's own by default. Only where a joint is revolute.
        platform_mass: [kg]; gravity acts on it at ``platform_centre``.
        platform_centre: Centre of mass in the platform's frame [m], shape (3,).

    Raises:
        ValueError: If a number is out of range, a pose is none, or shapes do not fit.
        TypeError: If a leg is neither a ``Rod`` nor a ``ConcentricTubes``.
    """

    length_columns: ClassVar[bool] = True

    @names_checked
    def __init__(
        self,
        *,
        legs: Sequence[Rod | ConcentricTubes],
        base: Poses,
        platform: Poses,
        joints: Literal["clamped", "spherical", "revolute"] | Sequence[str] = "clamped",
        joint_axes: Numbers | None = None,
        platform_mass: float = 0.0,
        platform_centre: Numbers = (0.0, 0.0, 0.0),
    ) -> None:
        if not isinstance(legs, (list, tuple)):
            raise TypeError("ParallelRods.legs must be a list of Rod or ConcentricTubes")
        for k, leg in enumerate(legs):
            instance(f"ParallelRods.legs[{k}]", leg, (Rod, ConcentricTubes), "a Rod or ConcentricTubes")
        count = len(legs)
        if not 2 <= count <= 12:
            refuse("ParallelRods.legs", Described(f"{count} legs"), "must be 2 to 12")
        mass = nonnegative_float("ParallelRods.platform_mass", platform_mass)
        codes = _joints(joints, count)
        robots: list[BackboneAssembly] = [SingleRod(leg) if isinstance(leg, Rod) else leg for leg in legs]
        self.legs = tuple(legs)
        self.geometry = Geometry(
            robots,
            _poses("ParallelRods.base", base, count),
            _poses("ParallelRods.platform", platform, count),
            codes,
            _axes(joint_axes, codes),
            mass,
            array("ParallelRods.platform_centre", platform_centre, (3,)),
        )
        self.rods, self.mass_carried = self.geometry.rods, mass
        plausibility.of_legs(self.geometry.base, self.geometry.platform, mass, self.rods)
        self._own_rods = [slice(a, b) for a, b in pairwise(self.geometry.first_rod.tolist())]

    @property
    def base(self) -> FloatArray:
        """Pose of each leg's base in the world, shape (..., leg_count, 4, 4)."""
        return self.geometry.base

    @property
    def platform(self) -> FloatArray:
        """Pose of each leg's attachment in the platform's frame, shape (..., leg_count, 4, 4)."""
        return self.geometry.platform

    @property
    def batch_shape(self) -> tuple[int, ...]:
        """Leading axes of the rods' parameters and of the poses."""
        return self.geometry.batch_shape

    if TYPE_CHECKING:
        _input_name: ParallelRodsInput

    @listed(*INPUTS, *DRIVE_INPUTS)
    def inputs(self, **values: Unpack[ParallelRodsInputs]) -> Inputs:  # type: ignore[override]  # noqa: D102  (as ``listed`` says)
        return super().inputs(**ParallelRodsInputs(**values))

    @property
    def input_specs(self) -> tuple[InputSpec, ...]:  # noqa: D102
        return InputSpecs((*INPUTS, *drive_specs(self.rods)))

    def check(self, inputs: Inputs) -> None:  # noqa: D102
        one = not inputs.batch_shape and self.surely_takes("translation", inputs.translation.tolist())
        for k, (leg, own) in enumerate(() if one else zip(self.geometry.legs, self._own_rods, strict=True)):
            values = {name: getattr(inputs, name)[..., own] for name in ("rotation", "translation")}
            try:
                leg.check(Inputs(leg.input_specs, leg.rod_count, values))
            except ValueError as error:
                raise ValueError(f"legs[{k}]: {error}") from None
        check_drives(inputs, self.rods)
        if inputs.is_active("gravity") and not (self.geometry.mass > 0 or any(rod.has_mass for rod in self.rods)):
            refuse("gravity", inputs.gravity.tolist(), "must be zero: no rod has a linear_density, and the platform no mass")
        if inputs.is_active("magnetic_field") and not any(rod.is_magnetised for rod in self.rods):
            refuse("magnetic_field", inputs.magnetic_field.tolist(), "must be zero: no rod has a magnetisation")

    @property
    def backbones(self) -> tuple[Backbone, ...]:  # noqa: D102
        return tuple(Backbone(own, tip=True) for own in self._own_rods)

    @property
    def parameters(self) -> tuple[str, ...]:  # noqa: D102
        return PARAMETERS

    def column_count(self, name: str) -> int:  # noqa: D102
        return parameter_size(name, self.geometry) if name in PARAMETERS else super().column_count(name)

    def input_directions(self, *names: str) -> dict[str, Any]:
        """Directions for the derivatives by some inputs: rods of different legs share one, and what acts on the platform touches
        no leg."""
        for leg in self.geometry.legs:
            refuse_unknown(names, leg.rods)
        found = input_columns(self.geometry, names)
        options: dict[str, Any] = {
            "direction_count": sum(columns.size for columns in found),
            "leg_direction_count": sum(columns.size for columns in found if columns.on_legs),
        }
        return options | design_options(names) | ({"lengths": True} if any(self.geometry.drives) else {})

    def ends_meet(self, inputs: Inputs) -> bool:  # noqa: D102
        translation = inputs.translation.reshape(-1, self.rod_count)
        legs = zip(self.geometry.arrays, self._own_rods, strict=True)
        return any(ways_back(arrays, translation[:, own], inputs).any() for arrays, own in legs)

    def surely_takes(self, name: str, values: Sequence[float]) -> bool:  # noqa: D102
        if name in DRIVES:
            return surely_driven(name, values, self.rods)
        if name != "translation":
            return name not in BY_MATERIAL
        return all(leg.surely_takes(name, values[own]) for leg, own in zip(self.geometry.legs, self._own_rods, strict=True))

    @reusable
    def problem(  # noqa: D102
        self,
        inputs: Inputs,
        *,
        instances: IntArray | None = None,
        **options: Any,  # noqa: ANN401  (of ``ParallelProblem``)
    ) -> ParallelProblem:
        geometry, whole = self.geometry, np.broadcast_shapes(inputs.batch_shape, self.batch_shape)
        if instances is not None:
            geometry, inputs = geometry.take(whole, instances), inputs.take(whole, instances)
        result = ParallelProblem(geometry, inputs, **options)
        result.stand_ins = _CutLegs(self, whole, np.arange(prod(whole)) if instances is None else instances)
        return result

    def with_rods(self, rods: Sequence[Rod]) -> Self:  # noqa: D102
        robots = [leg.with_rods(rods[own]) for leg, own in zip(self.geometry.legs, self._own_rods, strict=True)]
        g = self.geometry
        geometry = Geometry(robots, g.base, g.platform, g.joints.tolist(), g.axes, g.mass, g.mass_centre)
        legs = tuple(
            robot if isinstance(leg, ConcentricTubes) else robot.rods[0] for leg, robot in zip(self.legs, robots, strict=True)
        )
        return changed(self, geometry=geometry, legs=legs, rods=geometry.rods)

    def features(self, inputs: Inputs, *, enabled: Iterable[str] = ()) -> tuple[Features, ...]:  # noqa: D102
        active = [name for name in kernels.LEG_VECTORS if name in enabled or inputs.is_active(name)]
        found: dict[tuple[Any, ...], list[Features]] = {}
        for leg in self.geometry.legs:
            options: dict[str, Any] = {"rod_count": leg.rod_count, "transmission": leg.transmission, "held": True}
            own = scene_features(leg.arrays, active, inputs.profiles, **options)
            found.setdefault((leg.rod_count, leg.transmission, leg.arrays.build), []).append(own)
        return tuple(
            replace(
                same[0],
                precurvature_degree=max(f.precurvature_degree for f in same),
                shear=any(f.shear for f in same),
                member_degree=max(f.member_degree for f in same),
                anisotropic=any(f.anisotropic for f in same),
            )
            for same in found.values()
        )

    def influences(self, inputs: Inputs) -> Mapping[str, Influence]:
        """An estimate, not a bound (``docs/explain.md``): each leg a cantilever that carries its share of the platform's
        loads."""
        geometry, legs = self.geometry, len(self.legs)
        if (geometry.joints != CLAMPED).any() or any(rod.carried or rod.is_embedded or rod.loads for rod in self.rods):
            return {}
        found: dict[str, Influence] = {}
        for k, (leg, own) in enumerate(zip(geometry.legs, self._own_rods, strict=True)):
            values: dict[str, Any] = {name: inputs.profile(name) for name in inputs.profiles}
            values |= {name: getattr(inputs, name) for name in kernels.LEG_VECTORS if name not in values}
            values |= {name: getattr(inputs, name) / legs for name in kernels.PLATFORM_VECTORS[:4]}
            values |= {name: getattr(inputs, name)[..., own] for name in ("rotation", "translation")}
            reach = np.linalg.norm(geometry.platform[..., k, :3, 3], axis=-1).max(initial=0.0)
            arm, lever = (
                float(np.linalg.norm(place, axis=-1).max(initial=0.0)) + reach
                for place in (inputs.force_point, geometry.mass_centre)
            )
            force = (np.linalg.norm(values[name], axis=-1) for name in ("tip_force", "follower_force"))
            values["follower_moment"] = values["follower_moment"] + arm * sum(force)[..., None] * [1, 0, 0]
            arrays = leg.arrays
            length = arrays.end[:, :, -1].max(axis=1)
            material = np.array(arrays.material)
            weighed = PLATFORM_WEIGHT / length * (1 + PLATFORM_MOMENT * lever / length)
            material[..., 0, :, DENSITY] += (weighed * geometry.mass / legs)[:, None]
            longest = max((p.ends[-1] for p in inputs.profiles.values()), default=0.0)
            loads = Inputs(leg.input_specs, leg.rod_count, values, longest)
            whole = np.broadcast_shapes(inputs.batch_shape, arrays.batch_shape)
            alone = influences(replace(arrays, material=material), loads, whole, transmission=leg.transmission)
            farther = (1 + reach / float(length.min())) ** 3
            for name, value in alone.items():
                known = replace(value, error=inf if name in CLOSURE else value.error * farther, estimated=True)
                found[name] = known if name not in found else found[name].joined(known)
        return found

    def inverse(self, *, limits: Limits | None = None) -> "InverseParallelRods":
        """The same robot with the platform's pose given, and the legs' translations to be found.

        Args:
            limits: ``(low, high)``: least and greatest translation [m], each a number or one for each leg; ``inf`` is no limit.

        Raises:
            ValueError: If there are not six legs, each a single rod: then the pose does not determine the translations; or if
                ``limits`` are no such pair.
        """
        from multirod.models.assemblies.inverse_parallel_rods import InverseParallelRods  # which is made of these

        return InverseParallelRods(self, limits=limits)

    def __repr__(self) -> str:
        each = [repr(leg) for leg in self.legs]
        if len(set(each)) == 1:
            return f"ParallelRods(legs=[{each[0]}] * {len(each)})"
        return f"ParallelRods(legs=[{', '.join(each)}])"


def _poses(field: str, value: object, count: int) -> FloatArray:
    poses = pose(field, value)
    if poses.ndim < 3 or poses.shape[-3] != count:
        refuse(field, Described(f"array of shape {poses.shape}"), f"must have shape (..., {count}, 4, 4): one pose a leg")
    return poses


def _joints(value: str | Sequence[str], count: int) -> list[int]:
    names = [value] * count if isinstance(value, str) else value
    if not isinstance(names, (list, tuple)) or len(names) != count:
        refuse("ParallelRods.joints", value, f"must be one joint, or one for each of {count} legs")
    for name in names:
        if name in OF_NETWORKS:
            refuse("ParallelRods.joints", name, f"must be one of {', '.join(map(repr, JOINTS))}: mr.Network has the others")
        choice("ParallelRods.joints", name, JOINTS)
    return [JOINTS[name] for name in names]


def _axes(value: object, joints: list[int]) -> FloatArray:
    count = len(joints)
    if value is not None and REVOLUTE not in joints:
        refuse("ParallelRods.joint_axes", value, "must not be given: only a 'revolute' joint has an axis, and there is none")
    axes = array("ParallelRods.joint_axes", OWN_AXIS if value is None else value, (3,))
    if axes.shape not in ((3,), (count, 3)):
        refuse("ParallelRods.joint_axes", value, f"must have shape (3,) or ({count}, 3)")
    return directions("ParallelRods.joint_axes", value, np.broadcast_to(axes, (count, 3)))
