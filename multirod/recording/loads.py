"""Forces and moments as arrows: of the end effector, or of the bodies, free tips and joints of a network; weights, and what else
acts along rods, as one force each."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import groupby
from os.path import commonprefix
from typing import Literal

import numpy as np

from multirod.assembly import Assembly
from multirod.inputs import Inputs, InputSpec
from multirod.models.assemblies.inverse_parallel_rods import InverseParallelRods
from multirod.models.assemblies.network import Network
from multirod.models.assemblies.parallel_rods import ParallelRods
from multirod.models.backbone.kernels.tips import longest
from multirod.recording.figure import drawn_rods
from multirod.results.history import History
from multirod.results.solution import Solution
from multirod.validation import FloatArray


@dataclass(frozen=True)
class DrawnLoad:
    """How a load is drawn.

    Attributes:
        name: Of the input.
        path: Parts of its entity path, below ``loads``.
        color: ``0xRRGGBB``.
        shade: The colour in words.
        kind: Arrows of a kind have one scale.
        place: Which of a network's ``load_places`` it acts on, or which of the coordinates that the input has.
        follows: Whether it is fixed in the frame of where it acts.
        coordinate: Of what acts along a coordinate of a joint, which of all coordinates that is; -1 of others.
        rods: Of what acts along rods, which these are: concentric ones share their force.
        mass: Of a body's weight, the mass [kg].
        mass_centre: Where that is, in the body's frame [m].
        given_by: The inputs that it comes from, where these are not ``name``.
    """

    name: str
    path: tuple[str, ...]
    color: int
    shade: str
    kind: Literal["force", "moment"] = "force"
    place: int = 0
    follows: bool = False
    coordinate: int = -1
    rods: tuple[int, ...] = ()
    mass: float = 0.0
    mass_centre: tuple[float, float, float] = (0.0, 0.0, 0.0)
    given_by: tuple[str, ...] = ()

    @property
    def inputs(self) -> tuple[str, ...]:
        """Those that it is drawn for."""
        return self.given_by or (self.name,)

    @property
    def unit(self) -> str:
        """Of the arrow's length."""
        return "N" if self.kind == "force" else "N m"


FORCE, FOLLOWER, MOMENT, SPREAD = (0xFFD43B, "yellow"), (0xFF922B, "orange"), (0xB197FC, "violet"), (0xD9A066, "brown")
TIP_LOADS = (
    DrawnLoad("tip_force", ("tip_force",), *FORCE),
    DrawnLoad("follower_force", ("follower_force",), *FOLLOWER, follows=True),
    DrawnLoad("tip_moment", ("tip_moment",), *MOMENT, "moment"),
    DrawnLoad("follower_moment", ("follower_moment",), *MOMENT, "moment", follows=True),
)
NOTHING = 1e-9  # of the force in a rod: what acts along it is not told from rounding


def drawn_loads(assembly: Assembly) -> tuple[DrawnLoad, ...]:
    """All that there may be of an assembly."""
    if not isinstance(assembly, Network):
        return (*TIP_LOADS, *spread(assembly))
    on_places = [
        DrawnLoad(spec.name, (spec.name, name), *_shade(spec), spec.load, k, spec.follows)
        for spec in assembly.input_specs
        if spec.acts == "tip" and spec.load is not None
        for k, name in enumerate(assembly.load_places)
    ]
    return (*on_places, *pushes(assembly), *spread(assembly))


def pushes(robot: Network) -> list[DrawnLoad]:
    """What may act along the coordinates of a network's joints, in their order."""
    pushing = [spec for spec in robot.input_specs if spec.acts == "joints" and spec.load is not None]
    own = [(spec, k, name) for spec in pushing for k, name in enumerate(robot.coordinate_names[spec.name])]
    return [
        DrawnLoad(spec.name, (spec.name, name), *_shade(spec), spec.load or "force", k, coordinate=i)
        for i, (spec, k, name) in enumerate(own)
    ]


def spread(assembly: Assembly) -> list[DrawnLoad]:
    """What acts along the rods of each backbone, together, and the weights of what they carry."""
    specs = [spec for spec in assembly.input_specs if spec.acts == "along" and spec.load == "force"]
    rods = drawn_rods(assembly)

    def acting_on(some: Sequence[int]) -> tuple[str, ...]:
        heavy = any(assembly.rods[k].has_mass for k in some)
        return tuple(spec.name for spec in specs if heavy or spec.on != "linear_density")

    if isinstance(assembly, Network):
        own = [(name, tuple(assembly.tubes_of(name))) for name in assembly.graph.whole_names]
    else:
        legs = [tuple(some) for _, some in groupby(range(len(rods)), lambda k: rods[k].leg)]
        own = [("/".join(commonprefix([rods[k].path for k in some])), some) for some in legs]
    paths = [("along",)] if len(own) == 1 else [("along", name) for name, _ in own]
    along = [
        DrawnLoad("along", path, *SPREAD, rods=some, given_by=acting_on(some)) for path, (_, some) in zip(paths, own, strict=True)
    ]
    return [*along, *_weights(assembly)]


def _weights(assembly: Assembly) -> list[DrawnLoad]:
    bodies: list[tuple[str, float, FloatArray]] = []
    if isinstance(assembly, Network):
        bodies = [(body.name, body.mass, body.mass_centre) for body in assembly.bodies]
    elif isinstance(assembly, (ParallelRods, InverseParallelRods)):
        bodies = [("platform", assembly.geometry.mass, assembly.geometry.mass_centre)]
    return [
        DrawnLoad(
            "weight", ("weight", name), *SPREAD, place=k, mass=mass, mass_centre=tuple(centre.tolist()), given_by=("gravity",)
        )
        for k, (name, mass, centre) in enumerate(bodies)
        if mass > 0
    ]


def _shade(spec: InputSpec) -> tuple[int, str]:
    if spec.load == "moment":
        return MOMENT
    return FOLLOWER if spec.follows else FORCE


Acting = Mapping[DrawnLoad, tuple[FloatArray, FloatArray]]


def largest(loads: Acting, kind: str) -> float:
    """The largest of a kind that is drawn [N] or [N m]."""
    sizes = [np.linalg.norm(vector, axis=-1) for own, (_, vector) in loads.items() if own.kind == kind]
    return max((float(np.nanmax(size, initial=0.0)) for size in sizes), default=0.0)


def acting(block: History, shapes: Sequence[Mapping[str, FloatArray]]) -> Acting:
    """Where each load that was given acts, and the load, both in the world, axes (sample, instance, 3).

    Args:
        block: The samples.
        shapes: Those of all rods, by field, the axes of nodes behind those of the samples.
    """
    shape = (len(block.time), -1, 3)
    found = {}
    for own in drawn_loads(block.assembly):
        if not any(name in block.inputs.given for name in own.inputs):
            continue
        if own.rods:
            found[own] = along_rods(own, shapes, shape)
            continue
        if own.coordinate >= 0:
            origin, axis = (values[..., own.coordinate, :] for values in block._pushed_axes)
            found[own] = origin.reshape(shape), (given(block.inputs, own) * axis).reshape(shape)
            continue
        origin, frame = _where(block, own)
        if own.mass:
            origin = origin + np.einsum("...ij,j->...i", frame, own.mass_centre)
        elif own.kind == "force" and "force_point" in block.inputs.given:
            origin = origin + np.einsum("...ij,...j->...i", frame, _vectors(block, block.inputs.force_point))
        vector = _vectors(block, own.mass * block.inputs.gravity if own.mass else given(block.inputs, own))
        if own.follows:
            vector = np.einsum("...ij,...j->...i", frame, vector)
        found[own] = origin.reshape(shape), vector.reshape(shape)
    return found


def _where(block: History, load: DrawnLoad) -> tuple[FloatArray, FloatArray]:
    if isinstance(block.assembly, Network):
        return place_of(block, block.assembly, load.place, nodes=2)
    return block.tip_position, block.tip_rotation


def along_rods(
    load: DrawnLoad, shapes: Sequence[Mapping[str, FloatArray]], axes: tuple[int, ...]
) -> tuple[FloatArray, FloatArray]:
    """By how much the force in rods that share it changes from base to tip: what acts on them in between, and its middle.

    They are as long as the longest of them, and beyond it there is nothing.
    """
    position, rotation, force = furthest([shapes[k] for k in load.rods], "position", "rotation", "total_force")
    force = np.einsum("...ij,...j->...i", rotation, force)
    acts = force[..., :-1, :] - force[..., 1:, :]
    size = np.linalg.norm(acts, axis=-1, keepdims=True)
    with np.errstate(invalid="ignore"):
        total = size.sum(axis=-2, keepdims=True)
        is_one = total > NOTHING * np.linalg.norm(force, axis=-1).max(axis=-1)[..., None, None]
        share = np.where(is_one, size, 1.0) / np.where(is_one, total, size.shape[-2])
    middle = (share * (position[..., :-1, :] + position[..., 1:, :]) / 2).sum(axis=-2)
    return middle.reshape(axes), np.where(is_one, acts, 0.0).sum(axis=-2).reshape(axes)


def arrow_ends(loads: Acting, scales: Mapping[str, float]) -> FloatArray:
    """Where the arrows of all samples begin and end [m], shape (count, 3)."""
    found = [
        values.reshape(-1, 3)
        for own, (origin, vector) in loads.items()
        for values in (origin, origin + scales[own.kind] * vector)
    ]
    return np.concatenate([np.zeros((0, 3)), *found])


def given(inputs: Inputs, load: DrawnLoad) -> FloatArray:
    """A load, zero where it was not given, shape (..., 3); along a coordinate (..., 1)."""
    size = 3 if load.coordinate < 0 else 1
    if load.name not in inputs.given:
        return np.zeros(size)
    return np.asarray(getattr(inputs, load.name)[..., size * load.place : size * (load.place + 1)])


def _vectors(block: History, value: FloatArray) -> FloatArray:
    return np.broadcast_to(value, (*block.batch_shape, 3))


def place_of(solution: Solution, robot: Network, place: int, *, nodes: int | None = None) -> tuple[FloatArray, FloatArray]:
    """Origin [m] and frame, in the world, of one of a network's ``load_places``, shapes (..., 3), (..., 3, 3).

    Of tubes in each other, that of the tube that reaches furthest, where loads act.
    """
    name = robot.load_places[place]
    if name == robot.end_effector:
        return solution.tip_position, solution.tip_rotation
    graph = robot.graph
    if place < len(graph.bodies):
        return solution.body_position(name), solution.body_rotation(name)
    frame = place - len(graph.bodies) - len(graph.free)
    if frame >= 0:
        return solution.body_position(graph.frames[frame]), solution.body_rotation(graph.frames[frame])
    shapes = [vars(solution.rod(k, nodes=nodes)) for k in robot.tubes_of(name)]
    position, rotation = furthest(shapes, "position", "rotation")
    return position[..., -1, :], rotation[..., -1, :, :]


def furthest(shapes: Sequence[Mapping[str, FloatArray]], *names: str) -> list[FloatArray]:
    """Fields of that of some concentric rods which reaches furthest, as it has them."""
    ends = np.stack([shape["arclength"][..., -1] for shape in shapes], axis=-1)
    end, axis = longest(ends), ends.ndim - 1
    found = []
    for name in names:
        values = np.stack([shape[name] for shape in shapes], axis=axis)
        chosen = end.reshape(*end.shape, *(1,) * (values.ndim - end.ndim))
        found.append(np.take_along_axis(values, chosen, axis=axis).squeeze(axis))
    return found
