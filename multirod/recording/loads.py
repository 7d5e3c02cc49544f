"""Forces and moments as arrows: of the end effector, or of the bodies, free tips and joints of a network."""

from dataclasses import dataclass
from typing import Literal

import numpy as np

from multirod.assembly import Assembly
from multirod.inputs import Inputs, InputSpec
from multirod.models.assemblies.network import Network
from multirod.models.backbone.kernels.tips import longest
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
    """

    name: str
    path: tuple[str, ...]
    color: int
    shade: str
    kind: Literal["force", "moment"] = "force"
    place: int = 0
    follows: bool = False
    coordinate: int = -1

    @property
    def unit(self) -> str:
        """Of the arrow's length."""
        return "N" if self.kind == "force" else "N m"


FORCE, FOLLOWER, MOMENT = (0xFFD43B, "yellow"), (0xFF922B, "orange"), (0xB197FC, "violet")
TIP_LOADS = (
    DrawnLoad("tip_force", ("tip_force",), *FORCE),
    DrawnLoad("follower_force", ("follower_force",), *FOLLOWER, follows=True),
)


def drawn_loads(assembly: Assembly) -> tuple[DrawnLoad, ...]:
    """All that there may be of an assembly."""
    if not isinstance(assembly, Network):
        return TIP_LOADS
    on_places = [
        DrawnLoad(spec.name, (spec.name, name), *_shade(spec), spec.load, k, spec.follows)
        for spec in assembly.input_specs
        if spec.acts == "tip" and spec.load is not None
        for k, name in enumerate(assembly.load_places)
    ]
    return (*on_places, *pushes(assembly))


def pushes(robot: Network) -> list[DrawnLoad]:
    """What may act along the coordinates of a network's joints, in their order."""
    pushing = [spec for spec in robot.input_specs if spec.acts == "joints" and spec.load is not None]
    own = [(spec, k, name) for spec in pushing for k, name in enumerate(robot.coordinate_names[spec.name])]
    return [
        DrawnLoad(spec.name, (spec.name, name), *_shade(spec), spec.load or "force", k, coordinate=i)
        for i, (spec, k, name) in enumerate(own)
    ]


def _shade(spec: InputSpec) -> tuple[int, str]:
    if spec.load == "moment":
        return MOMENT
    return FOLLOWER if spec.follows else FORCE


def largest(block: History, kind: str) -> float:
    """The largest of a kind that is drawn [N] or [N m]."""
    loads = [own for own in drawn_loads(block.assembly) if own.kind == kind]
    return max((float(np.linalg.norm(given(block.inputs, own), axis=-1).max()) for own in loads), default=0.0)


def acting(block: History) -> dict[DrawnLoad, tuple[FloatArray, FloatArray]]:
    """Where each load that was given acts, and the load, both in the world, axes (sample, instance, 3)."""
    shape = (len(block.time), -1, 3)
    found = {}
    point = None
    for own in drawn_loads(block.assembly):
        if own.name not in block.inputs.given:
            continue
        vector = given(block.inputs, own)
        if own.coordinate >= 0:
            origin, axis = (values[..., own.coordinate, :] for values in block._pushed_axes)
            found[own] = origin.reshape(shape), (vector * axis).reshape(shape)
            continue
        vector = _vectors(block, vector)
        if isinstance(block.assembly, Network):
            origin, frame = place_of(block, block.assembly, own.place, nodes=2)
            if own.follows:
                vector = np.einsum("...ij,...j->...i", frame, vector)
        else:
            if point is None:
                by_arm = _turned(block, block.inputs.force_point) if "force_point" in block.inputs.given else 0.0
                point = block.tip_position + by_arm
            origin = point
            if own.follows:
                vector = _turned(block, vector)
        found[own] = origin.reshape(shape), vector.reshape(shape)
    return found


def arrow_ends(block: History, scales: dict[str, float]) -> FloatArray:
    """Where the arrows of all samples begin and end [m], shape (count, 3)."""
    found = [
        values.reshape(-1, 3)
        for own, (origin, vector) in acting(block).items()
        for values in (origin, origin + scales[own.kind] * vector)
    ]
    return np.concatenate(found) if found else block.tip_position.reshape(-1, 3)


def given(inputs: Inputs, load: DrawnLoad) -> FloatArray:
    """A load, zero where it was not given, shape (..., 3); along a coordinate (..., 1)."""
    size = 3 if load.coordinate < 0 else 1
    if load.name not in inputs.given:
        return np.zeros(size)
    return np.asarray(getattr(inputs, load.name)[..., size * load.place : size * (load.place + 1)])


def _vectors(block: History, value: FloatArray) -> FloatArray:
    return np.broadcast_to(value, (*block.batch_shape, 3))


def _turned(block: History, value: FloatArray) -> FloatArray:
    return np.asarray(np.einsum("...ij,...j->...i", block.tip_rotation, _vectors(block, value)))


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
    shapes = [solution.rod(k, nodes=nodes) for k in robot.tubes_of(name)]
    end = longest(np.stack([shape.arclength[..., -1] for shape in shapes], axis=-1))
    position = np.stack([shape.position[..., -1, :] for shape in shapes], axis=-2)
    rotation = np.stack([shape.rotation[..., -1, :, :] for shape in shapes], axis=-3)
    return (
        np.take_along_axis(position, end[..., None, None], axis=-2)[..., 0, :],
        np.take_along_axis(rotation, end[..., None, None, None], axis=-3)[..., 0, :, :],
    )
