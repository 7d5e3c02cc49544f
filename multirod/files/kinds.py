"""What a file may hold: objects of this package, each as a table of the arguments that make it.

A table is a dictionary of ``kind``, the name of the class or of another constructor, and of arguments: numbers, arrays, strings,
tables, lists of tables. Nothing in it is code, and only what is named here is ever made.
"""

import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields
from inspect import Parameter, signature
from typing import Any, cast

import numpy as np
from numpy.typing import ArrayLike

from multirod.integrators import RK4, RK23, RK45
from multirod.models.assemblies.concentric_tubes import ConcentricTubes
from multirod.models.assemblies.eccentric_tubes import EccentricTubes
from multirod.models.assemblies.held_rod import HeldRod
from multirod.models.assemblies.network import Network
from multirod.models.assemblies.parallel_rods import InverseParallelRods, ParallelRods
from multirod.models.assemblies.single_rod import SingleRod
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
from multirod.models.joint_kernels import JOINTS
from multirod.models.network.joining.bodies import Body, ground
from multirod.models.network.joining.joints import Joint
from multirod.profile import Profile
from multirod.rod import Rod, Section
from multirod.validation import Described, FloatArray, choice, refuse

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
EQUAL = ("bending_stiffness", "shear_stiffness", "foundation")  # one number for all their axes will do
OF_A_KIND = ("Joint",)  # that has an argument of this name: its table needs no class, which goes without saying
NO_IDENTITY = {"HeldRod": "end", "Body": "pose"}  # poses that are none by default, where others are the identity


@dataclass(frozen=True)
class Part:
    """An argument that is an object itself, or a list of some.

    Attributes:
        kinds: What it may be.
        many: Whether it is a list.
        named: Whether its table has to say its kind; otherwise the first of these is meant.
    """

    kinds: tuple[str, ...]
    many: bool = True
    named: bool = False


PARTS: dict[str, dict[str, Part]] = {
    "Rod": {"sections": Part(("Section",)), "lines": Part(LINES, named=True)},
    "SingleRod": {"rod": Part(("Rod",), many=False)},
    "ConcentricTubes": {"tubes": Part(("Rod",))},
    "EccentricTubes": {"tubes": Part(("Rod",))},
    "ParallelRods": {"legs": Part(("Rod", "ConcentricTubes"))},
    "InverseParallelRods": {"robot": Part(("ParallelRods",), many=False)},
    "HeldRod": {"rod": Part(("Rod",), many=False)},
    "Network": {"rods": Part(("Rod",)), "bodies": Part(("Body",)), "joints": Part(("Joint",))},
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


def _joint_axes(robot: ParallelRods) -> FloatArray:
    axes = robot.geometry.axes
    return axes[0] if (axes == axes[0]).all() else axes


def _axis(joint: Joint) -> FloatArray | None:
    return {"revolute": joint.axes[0:1].reshape(-1), "universal": joint.axes}.get(joint.kind)


def _each(values: FloatArray) -> FloatArray | float:
    """One number where it is the same about all axes of a joint."""
    return values if (values != values[:1]).any() else float(values[:1].sum())


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
    "HeldRod": {"rod": lambda robot: robot.rods[0]},
    "Network": {"end_effector": lambda robot: robot.end_effector},
    "Joint": {
        "to": lambda joint: joint.to.name,
        "axis": _axis,
        "stiffness": lambda joint: _each(joint.stiffness),
        "rest": lambda joint: _each(joint.rest),
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


# ---- from objects to tables ----


def described(thing: object, where: str, *, functions: bool) -> dict[str, Any]:
    """The table of an object, called ``where`` in errors; arguments that are the default are left out.

    Args:
        thing: The object.
        where: Its name.
        functions: Whether a function of arclength may be in it, as the polynomials that it was resolved into.

    Raises:
        ValueError: If it is, or has, something that no file holds; the message names it.
    """
    kind = KINDS.get(type(thing))
    if kind is None:
        refuse(
            where,
            thing,
            f"a file holds only what multirod itself makes ({', '.join(CLASSES)}), and no {type(thing).__name__}: that has to be "
            "made by its own code, and results can be saved as .csv, .nc and meshes",
        )
    parts = PARTS.get(kind, {})
    arguments = _arguments(kind, thing, where)
    if isinstance(thing, Rod) and (as_tube := _as_tube(thing)) is not None:
        kind, arguments = "Rod.tube", as_tube
    result: dict[str, Any] = {"kind": kind}
    for name, (value, default) in arguments.items():
        field = f"{where}.{name}"
        if name in parts:
            single = [value] if not parts[name].many else value
            tables = [
                _unnamed(described(item, f"{field}[{k}]" if parts[name].many else field, functions=functions), parts[name])
                for k, item in enumerate(single)
            ]
            if tables:
                result[name] = tables if parts[name].many else tables[0]
        elif name in ("members", "loads") and value:
            refuse(field, list(value), f"a file holds only the lines of multirod itself, and no {name} of other classes")
        else:
            plain = _plain(field, name, value, functions)
            if not _is(plain, default) or NO_IDENTITY.get(kind) == name and value is not None:
                result[name] = plain
    return result


def _unnamed(table: dict[str, Any], part: Part) -> dict[str, Any]:
    """Without the kind, where it goes without saying."""
    if part.named or table["kind"] != part.kinds[0]:
        return table
    return {name: value for name, value in table.items() if name != "kind"}


def _arguments(kind: str, thing: object, where: str) -> dict[str, tuple[Any, Any]]:
    """Values and defaults of what makes an object; of a rod of one section, that section's among its own."""
    readers, own = READERS.get(kind, {}), parameters(CLASSES[kind])
    if isinstance(thing, Rod):
        single = len(thing.sections) == 1
        others = ("members", "lines", "loads", "discs", "outer_diameter", "inner_diameter")
        found: dict[str, tuple[Any, Any]] = {"name": (thing.name, "")}
        if single:
            (section,) = thing.sections
            if type(section) is not Section:
                refuse(f"{where}.sections", section, "a file holds only sections that are multirod's Section")
            defaults = parameters(Section)
            found |= {item.name: (getattr(section, item.name), defaults[item.name]) for item in fields(Section)}
        else:
            found["sections"] = (thing.sections, None)
        return found | {name: (getattr(thing, name), own[name]) for name in others}
    return {name: (readers[name](thing) if name in readers else getattr(thing, name), default) for name, default in own.items()}


def _as_tube(rod: Rod) -> dict[str, tuple[Any, Any]] | None:
    """Values and defaults of what makes a rod by its cross-section and material, if just that makes the same bits."""
    material, sections = rod._material, rod.sections
    curves = [section.precurvature for section in sections if not isinstance(section.precurvature, Profile)]
    if material is None or len(curves) < len(sections) or rod.length.ndim:
        return None
    pieces = [[float(section.length), curve.tolist()] for section, curve in zip(sections, curves, strict=True)]
    values: dict[str, Any] = {
        "length": float(rod.length),
        "outer_diameter": rod.outer_diameter,
        "inner_diameter": rod.inner_diameter,
        "young_modulus": material.young,
        "shear_modulus": material.shear,
        "extensible": any(np.isfinite(section.axial_stiffness).any() for section in sections),
        "density": material.density,
        "precurvature": curves[0] if len(sections) == 1 else pieces,
        "discs": rod.discs,
        "name": rod.name,
        "lines": rod.lines,
    }
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            twin = Rod.tube(**values)
        except (TypeError, ValueError):
            return None
    same = len(twin.sections) == len(sections) and all(
        np.array_equal(getattr(own, item.name), getattr(other, item.name))
        for own, other in zip(sections, twin.sections, strict=True)
        for item in fields(Section)
    )
    if not same or rod.members or rod.loads:
        return None
    known = parameters(Rod.tube)
    return {name: (value, known[name]) for name, value in values.items()}


def _plain(field: str, name: str, value: object, functions: bool) -> object:
    """A value as a file holds it: an array, a number, a string, a list of strings, the table of a function; None is none."""
    if isinstance(value, Profile):
        if not functions:
            refuse(
                field,
                Described("a function of arclength"),
                "text holds only numbers: save it as .npz, which keeps the polynomials that it was resolved into, or give it as "
                "numbers (precurvature by sections, a line by its offset)",
            )
        return {"kind": "Profile", "ends": value.ends, "coefficients": value.coefficients}
    if isinstance(value, np.ndarray):
        if name in EQUAL and value.ndim == 1 and (value == value[0]).all():
            return float(value[0])
        return float(value) if value.ndim == 0 else value
    return value


def _is(value: object, default: object) -> bool:
    """Whether a value is the default; a batch of it is not."""
    if default is Parameter.empty:
        return False
    if default is None:
        return value is None or (isinstance(value, np.ndarray) and np.array_equal(value, np.eye(4)))
    if isinstance(default, (int, float, tuple)) and not isinstance(value, (str, dict)):
        return bool(np.array_equal(cast(ArrayLike, value), default))
    return bool(value == default)


# ---- from tables to objects ----


def made(table: object, part: Part, where: str) -> Any:  # noqa: ANN401  (of any of ``CLASSES``)
    """The object of a table.

    Args:
        table: As ``described`` makes it, or as someone wrote it.
        part: What it may be.
        where: The file, then the place in it.

    Raises:
        ValueError: If the table has what is unknown, out of range or of a wrong type, or lacks something; the message names file,
            place, value and what is allowed.
    """
    if not isinstance(table, dict):
        refuse(where, table, "must be a table")
    options = constructors(part.kinds)
    kind, given = part.kinds[0], dict(table)
    if kind not in OF_A_KIND:
        kind = choice(at(where, "kind"), given.pop("kind", None if part.named else kind), options)
    make, parts = options[kind], PARTS.get(kind.partition(".")[0], {})
    known = parameters(make)
    for name, value in given.items():
        if name not in known:
            refuse(at(where, name), value, f"there is no such key: {kind} takes {', '.join(known)}")
    for name, default in known.items():
        if default is Parameter.empty and name not in given:
            raise ValueError(f"{at(where, name)} is not there: {kind} needs {name}")
    arguments = {name: _argument(value, parts.get(name), at(where, name)) for name, value in given.items()}
    arguments |= {name: _meant_as_pair(arguments[name]) for name in EQUAL if name in arguments}
    if make is Joint:
        return arguments  # until there are bodies
    try:
        return _network(arguments) if make is Network else make(**arguments)
    except (TypeError, ValueError) as error:
        raise ValueError(f"{where}{'' if where.endswith(': ') else ': '}{error}") from error


def _network(given: dict[str, Any]) -> Network:
    """A network from its rods, which have their names, its bodies, and the arguments of its joints."""
    rods: dict[str, Rod] = {}
    for k, rod in enumerate(given["rods"]):
        if not rod.name or rod.name in rods:
            refuse(f"rods[{k}].name", rod.name, "each rod of a Network needs a name of its own")
        rods[rod.name] = rod
    bodies = {body.name: body for body in given.get("bodies", ())}
    holders = {ground.name: ground, **bodies}
    joints = []
    for k, arguments in enumerate(given["joints"]):
        to = holders[choice(f"joints[{k}].to", arguments["to"], holders)]
        try:
            joints.append(Joint(**{**arguments, "to": to}))
        except (TypeError, ValueError) as error:
            raise ValueError(f"joints[{k}]: {error}") from error
    return Network(**{**given, "rods": rods, "bodies": list(given.get("bodies", ())), "joints": joints})


def at(where: str, name: str) -> str:
    """The place of a key in a table that is ``where``: in a file by its name and ``": "``, or further inside."""
    return where + name if where.endswith(": ") else f"{where}.{name}"


def _argument(value: object, part: Part | None, where: str) -> object:
    if part is None:
        return profile(value, where) if isinstance(value, dict) else value
    if not part.many:
        return made(value, part, where)
    if not isinstance(value, list):
        refuse(where, value, f"must be a list of tables, [[{where.rpartition(': ')[2]}]]")
    return [made(item, part, f"{where}[{k}]") for k, item in enumerate(value)]


def _meant_as_pair(value: object) -> object:
    """Two numbers as a tuple: in a file they are no batch."""
    given = value.tolist() if isinstance(value, np.ndarray) else value
    plain = isinstance(given, list) and len(given) == 2 and not any(isinstance(item, list) for item in given)
    return tuple(given) if isinstance(given, list) and plain else value


def profile(value: object, where: str) -> Profile:
    """A function of arclength from its table."""
    if not (isinstance(value, dict) and value.get("kind") == "Profile" and set(value) == {"kind", "ends", "coefficients"}):
        refuse(where, value, "must be numbers")
    ends, coefficients = (np.array(value[name], dtype=np.float64) for name in ("ends", "coefficients"))
    sound = ends.ndim == 1 and coefficients.ndim == 3 and len(ends) == len(coefficients) > 0
    if not (sound and np.isfinite(ends).all() and np.isfinite(coefficients).all() and (np.diff(ends, prepend=0.0) > 0).all()):
        refuse(where, Described("a function of arclength"), "its polynomials must be finite, on pieces that follow each other")
    return Profile.resolved(ends, coefficients)
