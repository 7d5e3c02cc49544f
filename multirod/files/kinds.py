"""What a file may hold: objects of this package, each as a table of the arguments that make it.

A table is a dictionary of ``kind``, the name of the class or of another constructor, and of arguments: numbers, arrays, strings,
tables, lists of tables. Nothing in it is code, and only what is named here is ever made.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from inspect import signature
from typing import Any

import numpy as np

from multirod.integrators import RK4, RK23, RK45
from multirod.models.assemblies.concentric_tubes import ConcentricTubes
from multirod.models.assemblies.eccentric_tubes import EccentricTubes
from multirod.models.assemblies.held_rod import HeldRod
from multirod.models.assemblies.inverse_parallel_rods import InverseParallelRods
from multirod.models.assemblies.network import Network
from multirod.models.assemblies.parallel_rods import ParallelRods
from multirod.models.assemblies.single_rod import SingleRod
from multirod.models.backbone.assembly import BackboneAssembly
from multirod.models.backbone.members.line_kinds import (
    Chamber,
    DisplacedTendon,
    PushRod,
    RubbingDisplacedTendon,
    RubbingTendon,
    SectionChamber,
    Tendon,
)
from multirod.models.backbone.members.lines import Line
from multirod.models.joint_kernels import JOINTS, REVOLUTE
from multirod.models.network.joining.bodies import Body
from multirod.models.network.joining.joints import AXES, Joint
from multirod.rod import Rod, Section
from multirod.validation import FloatArray

CLASSES: dict[str, type] = {
    made.__name__: made
    for made in (
        *(SingleRod, ConcentricTubes, EccentricTubes, ParallelRods, InverseParallelRods, HeldRod, Network),
        *(Body, Joint, Rod, Section, Tendon, PushRod, Chamber, RK4, RK23, RK45),
    )
}
ROBOTS = ("SingleRod", "ConcentricTubes", "EccentricTubes", "ParallelRods", "InverseParallelRods", "HeldRod", "Network")
LINES = ("Tendon", "PushRod", "Chamber")
INTEGRATORS = ("RK4", "RK23", "RK45")
KINDS: dict[type, str] = {made: name for name, made in CLASSES.items()} | {
    DisplacedTendon: "Tendon",
    RubbingTendon: "Tendon",
    RubbingDisplacedTendon: "Tendon",
    SectionChamber: "Chamber",
}
UNITS = {
    "length": "m",
    "bending_stiffness": "N m^2",
    "torsional_stiffness": "N m^2",
    "shear_stiffness": "N",
    "axial_stiffness": "N",
    "precurvature": "1/m",
    "linear_density": "kg/m",
    "magnetisation": "A m",
    "foundation": "N/m^2",
    "discs": "m",
    "outer_diameter": "m",
    "inner_diameter": "m",
    "young_modulus": "Pa",
    "shear_modulus": "Pa",
    "density": "kg/m^3",
    "offset": "m",
    "offsets": "m",
    "start": "m",
    "end": "m",
    "rest_length": "m",
    "area": "m^2",
    "base": "pose: rotation, position in m",
    "platform": "poses: rotation, position in m",
    "platform_mass": "kg",
    "platform_centre": "m",
    "limits": "m",
    "mass": "kg",
    "mass_centre": "m",
    "pose": "pose: rotation, position in m",
    "stiffness": "N m/rad",
    "rest": "rad",
    "at": "m",
}
AXES_OF_ONE = {  # of arguments with leading axes: how many the value of one instance has
    **dict.fromkeys(
        ("length", "torsional_stiffness", "axial_stiffness", "linear_density", "outer_diameter", "inner_diameter"), 0
    ),
    **dict.fromkeys(("young_modulus", "shear_modulus", "friction", "area"), 0),
    **dict.fromkeys(("bending_stiffness", "shear_stiffness", "precurvature", "magnetisation", "foundation", "offset"), 1),
    **dict.fromkeys(("base", "end", "pose"), 2),
}
OWN_AXES = {("ParallelRods", "base"): 3, ("ParallelRods", "platform"): 3, ("PushRod", "bending_stiffness"): 0}  # where others
EQUAL = ("bending_stiffness", "shear_stiffness", "foundation")  # one number for all their axes will do
BY_NAME = (("Body", "frames"), ("Network", "segments"))  # arguments that are mappings of names to numbers
OF_A_KIND = ("Joint",)  # that has an argument of this name: its table needs no class, which goes without saying
NO_IDENTITY = {"HeldRod": "end", "Body": "pose"}  # poses that are none by default, where others are the identity


@dataclass(frozen=True)
class Part:
    """An argument that is an object itself, or a list of some.

    Attributes:
        kinds: What it may be.
        many: Whether it is a list.
        named: Whether its table has to say its kind; otherwise the first of these is meant.
        mapping: Whether it is a mapping of names, each a ``name`` in its table, beside the arguments.
    """

    kinds: tuple[str, ...]
    many: bool = True
    named: bool = False
    mapping: bool = False


PARTS: dict[str, dict[str, Part]] = {
    "Rod": {"sections": Part(("Section",)), "lines": Part(LINES, named=True)},
    "SingleRod": {"rod": Part(("Rod",), many=False)},
    "ConcentricTubes": {"tubes": Part(("Rod",))},
    "EccentricTubes": {"tubes": Part(("Rod",))},
    "ParallelRods": {"legs": Part(("Rod", "ConcentricTubes"))},
    "InverseParallelRods": {"robot": Part(("ParallelRods",), many=False)},
    "HeldRod": {"rod": Part(("Rod",), many=False)},
    "Network": {
        "rods": Part(("Rod", "ConcentricTubes"), mapping=True),
        "bodies": Part(("Body",)),
        "joints": Part(("Joint",)),
    },
}


def _route(line: Line) -> object:
    return line._resolved


def _stretch(line: Line) -> FloatArray | None:
    value = getattr(line, "axial_stiffness", None)
    return None if value is None or np.isinf(value).all() else value


def _joints(robot: ParallelRods) -> str | list[str]:
    names = {code: name for name, code in JOINTS.items()}
    joints = [names[code] for code in robot.geometry.joints.tolist()]
    return joints[0] if len(set(joints)) == 1 else joints


def _joint_axes(robot: ParallelRods) -> FloatArray | None:
    if REVOLUTE not in robot.geometry.joints:
        return None
    axes = robot.geometry.axes
    return axes[0] if (axes == axes[0]).all() else axes


def _axis(joint: Joint) -> FloatArray | None:
    if joint.end not in ("base", "tip") or joint.kind not in AXES:
        return None
    return joint.axes if joint.kind == "universal" else joint.axes[0]


def _each(joint: Joint, values: FloatArray) -> FloatArray | float:
    """One number where it is the same about all axes of a joint, none of which it slides along."""
    alike = (values == values[:1]).all() and (joint.kind != "cylindrical" or joint.end == "along" or not values.any())
    return float(values[:1].sum()) if alike else values


def _end_effector(robot: Network) -> str | list[str]:
    return robot.end_effector if isinstance(robot.end_effector, str) else list(robot.end_effector)


def _rods(robot: Network) -> dict[str, Rod | BackboneAssembly]:
    """As they were given."""
    given = zip(robot.graph.whole_names, robot.graph.whole, strict=True)
    return {name: rod.rods[0] if isinstance(rod, SingleRod) else rod for name, rod in given}


def _rest(joint: Joint) -> FloatArray | float | None:
    """None where it is the default."""
    return _each(joint, joint.rest) if joint.rest.any() and (joint.rest != joint.at).any() else None


# arguments that an object does not keep as an attribute of the same name
READERS: dict[str, dict[str, Callable[[Any], Any]]] = {
    "SingleRod": {"rod": lambda robot: robot.rods[0]},
    "ConcentricTubes": {"tubes": lambda robot: robot.rods},
    "EccentricTubes": {"tubes": lambda robot: robot.rods},
    "ParallelRods": {
        "base": lambda robot: robot.geometry.base,
        "platform": lambda robot: robot.geometry.platform,
        "joints": _joints,
        "joint_axes": _joint_axes,
        "platform_mass": lambda robot: robot.geometry.mass,
        "platform_centre": lambda robot: robot.geometry.mass_centre,
    },
    "HeldRod": {
        "rod": lambda robot: robot.rods[0],
        "joint_axis": lambda robot: robot.joint_axis if robot.joint == "revolute" else None,
        "base_joint_axis": lambda robot: robot.base_joint_axis if robot.base_joint == "revolute" else None,
    },
    "Network": {
        "rods": _rods,
        "end_effector": _end_effector,
        "driven": lambda robot: None if robot.driven is None else list(robot.driven),
        "segments": lambda robot: dict(robot.graph.segments) or None,
    },
    "Body": {"frames": lambda body: body.frames or None},
    "Joint": {
        "to": lambda joint: joint.to.name,
        "axis": _axis,
        "stiffness": lambda joint: _each(joint, joint.stiffness),
        "rest": _rest,
        "pose": lambda joint: joint.pose if joint.frame is None else joint.frame,
    },
    "InverseParallelRods": {"limits": lambda robot: robot.limits if np.isfinite(robot.limits).any() else None},
    "Tendon": {
        "route": _route,
        "driven": lambda line: line.drive[0],
        "axial_stiffness": _stretch,
        "rest_length": lambda line: getattr(line, "rest_length", None),
    },
    "PushRod": {
        "route": _route,
        "driven": lambda line: line.drive[0],
        "axial_stiffness": _stretch,
        "bending_stiffness": lambda line: line.bending_stiffness if np.any(line.bending_stiffness) else None,
    },
    "Chamber": {
        "route": _route,
        "area_fixed": lambda line: "section" if isinstance(line, SectionChamber) else "across",
    },
}


def constructors(kinds: Sequence[str]) -> dict[str, Callable[..., Any]]:
    """What makes objects of these kinds: the classes, and their other constructors, such as ``Rod.tube``."""
    found: dict[str, Callable[..., Any]] = {}
    for kind in kinds:
        made = CLASSES[kind]
        found[kind] = made
        others = (name for name, member in vars(made).items() if isinstance(member, classmethod) and not name.startswith("_"))
        found |= {f"{kind}.{name}": getattr(made, name) for name in others}
    return found


def parameters(make: Callable[..., Any]) -> dict[str, Any]:
    """Arguments of a constructor with their defaults; ``Parameter.empty`` of those that have none."""
    function: Any = vars(make)["__init__"] if isinstance(make, type) and "__init__" in vars(make) else make
    return {name: given.default for name, given in signature(function).parameters.items() if name != "self"}
