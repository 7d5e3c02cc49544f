"""What networks take: rods, and inputs, whose values by the names of rods, bodies and joints are put in order."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from multirod.inputs import Inputs, InputSpec, InputSpecs
from multirod.models.assemblies.concentric_tubes import ConcentricTubes
from multirod.models.assemblies.single_rod import SingleRod
from multirod.models.backbone.assembly import BackboneAssembly
from multirod.models.backbone.inputs import BACKBONE_INPUTS, DRIVES, drive_specs
from multirod.models.backbone.problem import BackboneProblem
from multirod.models.network.elements.groups import ON_RODS
from multirod.models.network.graph import Graph
from multirod.models.network.joining.bodies import place_of
from multirod.models.network.places import FIXED, FOLLOWING, LOADED, PER_ROD
from multirod.models.platform.inputs import LEG_INPUTS
from multirod.naming import meant
from multirod.read_only import changed
from multirod.rod import Rod
from multirod.validation import instance, refuse, sequence

INPUTS = tuple(replace(spec, function=False) for spec in LEG_INPUTS)
OF_ONE = {spec.name: spec for spec in BACKBONE_INPUTS}  # rod, by name
LOAD_INPUTS = (
    replace(
        OF_ONE["tip_force"],
        name="force",
        description="dead force on each body, at its origin, on each free tip and on each frame of a body, world frame",
    ),
    replace(OF_ONE["tip_moment"], name="moment", description="dead moment on the same, world frame"),
    replace(
        OF_ONE["follower_force"],
        dead_twin="",
        description="force on each body, at its origin, on each free tip and on each frame of a body, fixed in its frame",
    ),
    replace(OF_ONE["follower_moment"], description="moment on the same, fixed in its frame"),
)
ON_PLACES = (*LOADED, *FOLLOWING)
ROD_INPUTS = tuple(
    replace(
        OF_ONE[f"distributed_{load}"],
        name=f"rod_{load}",
        function=False,
        count=0,
        description=f"dead {load} per length of each rod, beside distributed_{load}, world frame",
    )
    for load in ("force", "moment")
)
FIXED_INPUTS = (
    InputSpec(
        name="fixed_position", unit="m", count=0, description="how far each fixed body is moved from its pose, world frame"
    ),
    InputSpec(
        name="fixed_rotation",
        unit="rad",
        count=0,
        description="rotation vector by which each fixed body is turned from its pose, world frame",
    ),
)
DRIVEN_INPUTS = (
    InputSpec(name="angle", unit="rad", count=0, description="angles of the joints that are driven, from their poses"),
    InputSpec(name="slide", unit="m", count=0, description="how far ends slide in the joints that are driven, from poses"),
)
COORDINATE_INPUTS = (
    *DRIVEN_INPUTS,
    InputSpec(
        name="joint_torque",
        unit="N m",
        acts="joints",
        load="moment",
        potential=True,
        count=0,
        description="torques about the axes of revolute, universal and cylindrical joints that are not driven",
    ),
    InputSpec(
        name="slide_force",
        unit="N",
        acts="joints",
        load="force",
        potential=True,
        count=0,
        description="forces along the axes of prismatic and cylindrical joints that are not driven",
    ),
)
NOT_THERE = {  # why each of these may not be given
    "angle": "no joint is driven, mr.Joint(..., driven=True)",
    "slide": "no joint that slides is driven, mr.Joint(..., driven=True)",
    "joint_torque": "no joint that is not driven turns about axes, which a ball does not either",
    "slide_force": "no joint that is not driven slides",
    **dict.fromkeys(FIXED, "no body is fixed, mr.Body(..., fixed=True)"),
}


def specs_of(
    rods: Sequence[Rod],
    given: int,
    coordinates: Mapping[str, Sequence[str]],
    load_places: Sequence[str],
    fixed_bodies: Sequence[str],
) -> InputSpecs:
    """Inputs of a network of so many rods as ``given``, of joints with these ``coordinates``."""
    by_joint = tuple(replace(spec, count=len(own)) for spec in COORDINATE_INPUTS if (own := coordinates[spec.name]))
    fixed = tuple(replace(spec, count=3 * len(fixed_bodies)) for spec in FIXED_INPUTS) if fixed_bodies else ()
    loads = tuple(replace(spec, count=3 * len(load_places)) for spec in LOAD_INPUTS)
    on_rods = tuple(replace(spec, count=3 * given) for spec in ROD_INPUTS)
    return InputSpecs((*INPUTS[:2], *by_joint, *fixed, *loads, *on_rods, *INPUTS[2:], *drive_specs(rods)))


def numbers_by_name(graph: Graph, load_places: Sequence[str], fixed_bodies: Sequence[str]) -> dict[str, dict[str, int]]:
    """Of each input that is taken by name, how many numbers each of those named has, in their order."""
    names = graph.whole_names
    per_rod = {name: robot.rod_count for name, robot in zip(names, graph.whole, strict=True)}
    sizes = dict.fromkeys(PER_ROD, per_rod) | dict.fromkeys(ON_PLACES, dict.fromkeys(load_places, 3))
    sizes |= dict.fromkeys(ON_RODS, dict.fromkeys(names, 3)) | dict.fromkeys(FIXED, dict.fromkeys(fixed_bodies, 3))
    # of rods in pieces none has lines
    for name in DRIVES:
        sizes[name] = {names[rod]: n for rod, own in zip(graph.slides.owner, graph.drives, strict=True) if (n := own.count(name))}
    return sizes | {name: dict(joints) for name, joints in graph.by_coordinate.items()}


def driven_rods(given: Sequence[str] | None, rods: Iterable[str]) -> tuple[str, ...] | None:
    """Checked names of the rods that are driven."""
    if given is None:
        return None
    names = tuple(rods)
    for name in sequence("Network.driven", given, str, "str"):
        if name not in names:
            refuse("Network.driven", name, f"must be names of rods, of {', '.join(map(repr, names))}{meant(name, names)}")
    return tuple(given)


def in_order(name: str, value: object, sizes: Mapping[str, int]) -> object:
    """An array of values (..., places, 3) as one (..., numbers of all), in the order of ``sizes``; of values by name, frames of
    bodies by the names that they have as places."""
    if isinstance(value, Mapping):
        return {_place(key): part for key, part in value.items()} if name in ON_PLACES else value
    several = name in (*ON_PLACES, *ON_RODS, *FIXED) and len(sizes) > 1
    if not several or not isinstance(value, (np.ndarray, list, tuple)):
        return value
    try:
        given = np.asarray(value)
    except Exception:  # noqa: BLE001  (ragged, or whatever someone's object raises: refused where it is read)
        return value
    if given.shape[-2:] == (len(sizes), 3):
        return given.reshape(*given.shape[:-2], -1)
    if given.shape[-1:] == (3,):
        first = next(iter(sizes))
        refuse(name, value, f"must say whose it is, such as {{{first!r}: ...}}, one of {', '.join(map(repr, sizes))}")
    return value


def _place(key: object) -> object:
    """A body's frame by the name that it has as a place, ``(body, frame)``; anything else as it is."""
    return place_of(*key) if isinstance(key, tuple) and len(key) == 2 else key


def refuse_around(graph: Graph) -> None:
    """Refuse rods in a medium or with loads of their own, which go with the frame of their base, where that may move."""
    for owner, embeddable in zip(graph.slides.owner.tolist(), graph.embeddable, strict=True):
        robot = graph.whole[owner]
        if any(rod.is_embedded or rod.loads for rod in robot.rods) and not embeddable:
            refuse(
                f"Network.rods[{graph.whole_names[owner]!r}]",
                robot,
                "must be clamped at its base to the ground or to a body that is fixed, and not be cut, at holes or into "
                "segments: a foundation and loads of its own go with its base",
            )


def robot_of(rod: Rod | ConcentricTubes, name: str) -> BackboneAssembly:
    """A rod as a robot of its own, by the name that it has in the network."""
    instance(f"Network.rods[{name!r}]", rod, (Rod, ConcentricTubes), "a Rod or ConcentricTubes")
    return renamed(SingleRod(rod) if isinstance(rod, Rod) else rod, name)


def renamed(robot: BackboneAssembly, name: str) -> BackboneAssembly:
    """The same with rods of that name; several are counted from 0."""
    if robot.rod_count == 1:
        return robot.with_rods([changed(robot.rods[0], name=name)])
    return robot.with_rods([changed(rod, name=f"{name} {k}") for k, rod in enumerate(robot.rods)])


def by_itself(rod: BackboneAssembly, inputs: Inputs, enabled: Iterable[str], **options: Any) -> BackboneProblem:  # noqa: ANN401
    """The problem of a rod that is a whole network, with an unknown force at its base, as it is in a graph; of what acts along
    it, that which acts on all rods."""
    own = inputs.with_arrays({name: value for name, value in inputs.arrays.items() if name not in ON_RODS}, inputs.batch_shape)
    named = [name for name in enabled if name not in ON_RODS]
    return rod.problem(own, enabled=(*named, "follower_force"), **options)
