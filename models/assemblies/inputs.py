"""The inputs of each robot, by name, for type checkers and editors; ``InputSpec`` says what they mean to the package.

``robot.inputs(**values)`` and ``tracker.step(**changes)`` take them. All are optional and zero by default; any may have leading
axes ``...``, which broadcast. ``docs/extending.md`` says what an assembly of one's own needs for the same: nothing, or a class
like these.
"""

from collections.abc import Callable, Mapping
from inspect import Parameter, Signature, cleandoc
from re import sub
from typing import Any, Literal, TypeAlias, TypedDict, TypeVar, cast, dataclass_transform

from multirod.assembly import Assembly
from multirod.inputs import InputSpec
from multirod.naming import INPUTS_NAMED, hinted
from multirod.types import AlongRod, Numbers

ByName: TypeAlias = Numbers | Mapping[str, Numbers]


@dataclass_transform(kw_only_default=True)
class Fields(TypedDict, total=False):
    """For editors by Jedi: it knows no ``Unpack``, but that a class derived from such a one takes its fields by name."""


class RobotInputs(Fields, total=False):
    """What every robot of this package takes."""

    rotation: ByName
    """Angle of each rod's base about its axis [rad], shape (..., rod_count), or by name; one number is the same for all."""
    translation: ByName
    """How far each rod is pushed out of its base [m], shape (..., rod_count), or by name. Of tubes behind a plate <= 0."""
    tip_force: Numbers
    """Dead force on the tip, or the platform, world frame [N], shape (..., 3)."""
    tip_moment: Numbers
    """Dead moment on the tip, or the platform, world frame [N m], shape (..., 3)."""
    follower_force: Numbers
    """Force on the tip, or the platform, fixed in its frame [N], shape (..., 3)."""
    follower_moment: Numbers
    """Moment on the tip, or the platform, fixed in its frame [N m], shape (..., 3)."""
    distributed_force: AlongRod
    """Dead force per length, world frame [N/m], shape (..., 3), or a function of the arclength."""
    distributed_moment: AlongRod
    """Dead moment per length, world frame [N], shape (..., 3), or a function of the arclength."""


class EccentricTubesInputs(RobotInputs, total=False):
    """Inputs of ``EccentricTubes``."""


class ConcentricTubesInputs(RobotInputs, total=False):
    """Inputs of ``ConcentricTubes``."""

    gravity: Numbers
    """Acceleration, world frame [m/s^2], shape (..., 3); acts on ``linear_density``, which must be given."""
    magnetic_field: Numbers
    """Uniform magnetic field, world frame [T], shape (..., 3); acts on ``magnetisation``, which must be given."""
    tension: ByName
    """Where rods have such lines: tension of each line that is driven by it [N], >= 0, shape (..., line_count), in the order of
    the rods' lines, or by name; one number pulls all of them alike."""
    pressure: ByName
    """Pressure in each chamber [Pa], shape (..., chamber_count), in their order, or by name; one number is that of all."""
    displacement: ByName
    """How far each line that is driven by it is pulled out of the base [m], shape (..., line_count), in their order, or by
    name; one number is that of all of them."""


class SingleRodInputs(ConcentricTubesInputs, total=False):
    """Inputs of ``SingleRod``."""

    tip_curvature: Numbers | None
    """Measured curvature at the tip, tip frame [1/m], shape (..., 3), in place of the boundary condition there."""


class ParallelRodsInputs(ConcentricTubesInputs, total=False):
    """Inputs of ``ParallelRods``."""

    force_point: Numbers
    """Where forces act on the platform, platform frame [m], shape (..., 3)."""


class InverseParallelRodsInputs(ParallelRodsInputs, total=False):
    """Inputs of ``InverseParallelRods``."""

    platform_position: Numbers
    """Of the platform's origin, world frame [m], shape (..., 3)."""
    platform_rotation: Numbers
    """Rotation vector of the platform, world frame [rad], shape (..., 3)."""


class HeldRodInputs(Fields, total=False):
    """Inputs of ``HeldRod``."""

    rotation: ByName
    """Angle of the rod's base about its axis [rad], shape (..., rod_count), or by name."""
    translation: ByName
    """How far the rod is pushed out of its base [m], shape (..., rod_count), or by name."""
    end_position: Numbers
    """How far what holds the end is moved, world frame [m], shape (..., 3)."""
    end_rotation: Numbers
    """Rotation vector by which what holds the end is turned, world frame [rad], shape (..., 3)."""
    tip_force: Numbers
    """Dead force on the end, world frame [N], shape (..., 3); its holder takes it but along the slide."""
    tip_moment: Numbers
    """Dead moment on the end, world frame [N m], shape (..., 3); its holder takes it but where the joint turns."""
    distributed_force: AlongRod
    """Dead force per length, world frame [N/m], shape (..., 3), or a function of the arclength."""
    distributed_moment: AlongRod
    """Dead moment per length, world frame [N], shape (..., 3), or a function of the arclength."""
    gravity: Numbers
    """Acceleration, world frame [m/s^2], shape (..., 3); acts on ``linear_density``, which must be given."""
    magnetic_field: Numbers
    """Uniform magnetic field, world frame [T], shape (..., 3); acts on ``magnetisation``, which must be given."""
    tension: ByName
    """Tension of each line that is driven by it [N], >= 0, shape (..., line_count), or by name."""
    pressure: ByName
    """Pressure in each chamber [Pa], shape (..., chamber_count), or by name."""
    displacement: ByName
    """How far each line that is driven by it is pulled out of the base [m], shape (..., line_count), or by name."""


class NetworkInputs(Fields, total=False):
    """Inputs of ``Network``."""

    rotation: ByName
    """Angle of the base of rods about their axes [rad]: by name, or shape (..., rod_count)."""
    translation: ByName
    """How far rods are pushed out of their bases [m]: by name, or shape (..., rod_count)."""
    angle: ByName
    """Where joints are driven: their angles [rad], by name, or shape (..., coordinate_count), in the order of
    ``driven_joints``."""
    slide: ByName
    """Where joints are driven: how far ends slide along their axes [m], by name, or shape (..., coordinate_count), likewise."""
    joint_torque: ByName
    """Torques about axes of revolute, universal and cylindrical joints that are not driven [N m]: by the names of joints, ``"arm
    base"``, or shape (..., coordinate_count)."""
    slide_force: ByName
    """Forces along axes of prismatic and cylindrical joints that are not driven [N]: likewise."""
    fixed_position: ByName
    """How far fixed bodies are moved from their poses, world frame [m]: by name, or shape (..., body_count, 3)."""
    fixed_rotation: ByName
    """Rotation vectors by which fixed bodies are turned from their poses, world frame [rad]: likewise."""
    force: ByName
    """Dead force on bodies, at their origins, and on tips that nothing holds, world frame [N]: by name, or shape (...,
    place_count, 3)."""
    moment: ByName
    """Dead moment on the same, world frame [N m]: by name, or shape (..., place_count, 3)."""
    follower_force: ByName
    """Force on the same, fixed in their frames [N]: by name, or shape (..., place_count, 3)."""
    follower_moment: ByName
    """Moment on the same, fixed in their frames [N m]: by name, or shape (..., place_count, 3)."""
    rod_force: ByName
    """Dead force per length of single rods, beside ``distributed_force``, world frame [N/m]: by their names, or shape (..., count
    of rods as given, 3)."""
    rod_moment: ByName
    """Dead moment per length of single rods, beside ``distributed_moment``, world frame [N]: likewise."""
    distributed_force: Numbers
    """Dead force per length of all rods, world frame [N/m], shape (..., 3)."""
    distributed_moment: Numbers
    """Dead moment per length of all rods, world frame [N], shape (..., 3)."""
    gravity: Numbers
    """Acceleration, world frame [m/s^2], shape (..., 3); acts on ``linear_density`` of rods and mass of bodies."""
    magnetic_field: Numbers
    """Uniform magnetic field, world frame [T], shape (..., 3); acts on ``magnetisation``, which must be given."""
    tension: ByName
    """Tension of each line that is driven by it [N], >= 0: by the names of rods, or shape (..., line_count)."""
    pressure: ByName
    """Pressure in each chamber [Pa]: by the names of rods, or shape (..., chamber_count)."""
    displacement: ByName
    """How far each line that is driven by it is pulled out of the base [m]: by the names of rods, or shape (..., line_count)."""


class KnownInputs(InverseParallelRodsInputs, total=False):
    """Those of all robots: which of them a tracker's robot takes, editors that read no types do not know."""

    angle: ByName
    """As for ``Network``."""
    slide: ByName
    """As for ``Network``."""
    joint_torque: ByName
    """As for ``Network``."""
    slide_force: ByName
    """As for ``Network``."""
    fixed_position: ByName
    """As for ``Network``."""
    fixed_rotation: ByName
    """As for ``Network``."""
    force: ByName
    """As for ``Network``."""
    moment: ByName
    """As for ``Network``."""
    rod_force: ByName
    """As for ``Network``."""
    rod_moment: ByName
    """As for ``Network``."""
    end_position: Numbers
    """As for ``HeldRod``."""
    end_rotation: Numbers
    """As for ``HeldRod``."""

    tip_curvature: Numbers | None
    """As for ``SingleRod``."""


# the names alone, for ``Solution.jacobian``
EccentricTubesInput: TypeAlias = Literal[
    "rotation",
    "translation",
    "tip_force",
    "tip_moment",
    "follower_force",
    "follower_moment",
    "distributed_force",
    "distributed_moment",
]
ConcentricTubesInput: TypeAlias = Literal[EccentricTubesInput, "gravity", "magnetic_field", "tension", "pressure", "displacement"]
SingleRodInput: TypeAlias = Literal[ConcentricTubesInput, "tip_curvature"]
ParallelRodsInput: TypeAlias = Literal[ConcentricTubesInput, "force_point"]
HeldRodInput: TypeAlias = Literal[
    "rotation",
    "translation",
    "end_position",
    "end_rotation",
    "tip_force",
    "tip_moment",
    "distributed_force",
    "distributed_moment",
    "gravity",
    "magnetic_field",
    "tension",
    "pressure",
    "displacement",
]
NetworkInput: TypeAlias = Literal[
    "rotation",
    "translation",
    "angle",
    "slide",
    "joint_torque",
    "slide_force",
    "fixed_position",
    "fixed_rotation",
    "force",
    "moment",
    "follower_force",
    "follower_moment",
    "rod_force",
    "rod_moment",
    "distributed_force",
    "distributed_moment",
    "gravity",
    "magnetic_field",
    "tension",
    "pressure",
    "displacement",
]
InverseParallelRodsInput: TypeAlias = Literal[ParallelRodsInput, "platform_position", "platform_rotation"]

Method = TypeVar("Method", bound=Callable[..., Any])


def listed(*specs: InputSpec) -> Callable[[Method], Method]:
    """Have ``help`` and notebooks, which see no types, show the inputs of a robot's ``inputs(**values)`` one by one; where it
    says nothing of itself, what ``Assembly.inputs`` says stands."""

    def show(method: Method) -> Method:
        lines = "\n".join(f"    {spec.name}: {_described(spec)}" for spec in specs)
        method.__doc__ = sub(r"    \*\*values: .*", lines, cleandoc(method.__doc__ or Assembly.inputs.__doc__ or ""), count=1)
        values = [Parameter(spec.name, Parameter.KEYWORD_ONLY, default=_default(spec)) for spec in specs]
        named: Any = hinted(INPUTS_NAMED)(method)
        named.__signature__ = Signature([Parameter("self", Parameter.POSITIONAL_OR_KEYWORD), *values], return_annotation="Inputs")
        return cast(Method, named)

    return show


def _described(spec: InputSpec) -> str:
    count = "rod_count" if spec.per_rod else "line_count" if spec.acts == "lines" else "3"
    function = ", or a function of the arclength" if spec.function else ""
    named = ", or by name" if spec.per_rod or spec.acts == "lines" else ""
    return f"{spec.description[0].upper()}{spec.description[1:]} [{spec.unit}], shape (..., {count}){named}{function}."


def _default(spec: InputSpec) -> object:
    if spec.required:
        return Parameter.empty
    if spec.optional:
        return None
    return 0 if spec.per_rod or spec.acts == "lines" else (0, 0, 0)
