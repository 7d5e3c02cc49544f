"""What is fixed when a recording begins: what is recorded, where it stands in the file, and to what scale it is drawn."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Self

import numpy as np
from numpy.typing import NDArray

from multirod.assembly import Assembly
from multirod.inputs import Inputs, InputSpec
from multirod.recording.figure import (
    PALETTE,
    PLATFORM_COLOR,
    DrawnLine,
    DrawnRod,
    Plate,
    bases,
    drawn_lines,
    drawn_rods,
    platforms,
)
from multirod.solution import History
from multirod.validation import FloatArray

LOADS = {"tip_force": 0xFFD43B, "follower_force": 0xFF922B}
_VIEW = 0.52  # half the width of what is seen over its distance, with room for frames and arrows
_THINNEST = 0.002  # radius over size of the robot at which a rod can be seen


@dataclass(frozen=True)
class DrawnBlock:
    """A part of the residual that is plotted as one series.

    Attributes:
        name: Of the leg, or of what couples the legs.
        color: ``0xRRGGBB``.
        residuals: Where it stands.
    """

    name: str
    color: int
    residuals: slice | NDArray[np.intp]


@dataclass(frozen=True, kw_only=True)
class Stage:
    """Made from the first samples of a recording; later ones are shown on it.

    Attributes:
        assembly: The robot.
        count: Instances that are recorded.
        batched: Whether there is a batch axis, and entities are named by instance.
        live: Whether samples are still to come that nothing is known of.
        measured: Whether the time of samples was measured.
        given: What is known of the inputs given as numbers: first what varies, and among it the loads.
        reference: Whether there is one.
        rods: How each rod is drawn.
        lines: How each line of the rods is drawn.
        strongest: Tension at which a line's colour is full [N].
        blocks: Parts of the residual, where there are several.
        bases: Poses by entity path.
        platforms: Of each instance; empty where there is none.
        centre: Middle of what is in view [m], shape (3,).
        eye: Where it is seen from [m], shape (3,).
        size: Of what is in view [m].
        grid: Spacing of the grid [m].
        force_scale: Length of force arrows [m/N].
    """

    assembly: Assembly
    count: int
    batched: bool
    live: bool
    measured: bool
    given: tuple[InputSpec, ...]
    reference: bool
    rods: tuple[DrawnRod, ...]
    lines: tuple[DrawnLine, ...]
    strongest: float
    blocks: tuple[DrawnBlock, ...]
    bases: dict[str, FloatArray]
    platforms: tuple[Plate, ...]
    centre: FloatArray
    eye: FloatArray
    size: float
    grid: float
    force_scale: float

    @classmethod
    def of(
        cls, block: History, reference: History | None, *, node_count: int, instances: int, force_scale: float | None, live: bool
    ) -> Self:
        """The stage for ``block``, the first samples; see ``save`` and ``Recorder`` for the rest."""
        assembly = block.assembly
        shapes = [block.rod(index, nodes=node_count) for index in range(assembly.rod_count)]
        base_poses = bases(assembly)
        origins = np.array([pose[:3, 3] for pose in base_poses.values()])
        reach = _largest([shape.arclength for shape in shapes]) or max(float(np.max(rod.length)) for rod in assembly.rods)
        points = [origins, *(shape.position.reshape(-1, 3) for shape in shapes)]
        count = min(instances, math.prod(block.batch_shape[1:]))
        plates = platforms(assembly, block.batch_shape[1:], count)
        if plates:
            around = np.abs(plates[0].vertices).max() * np.array([[-1.0], [1.0], [0.0]])
            points.append((block.tip_position.reshape(-1, 1, 3) + around).reshape(-1, 3))
        if live:
            room = (0.1 if plates else 0.35) * reach
            points += [origins - room, origins + room]
        everything = np.concatenate(points)
        everything = everything[np.isfinite(everything).all(axis=1)]
        low, high = everything.min(axis=0), everything.max(axis=0)
        size = max(float(np.linalg.norm(high - low)), 0.2 * reach)
        rods = _visible(drawn_rods(assembly), size)
        numbers = set(block.inputs.given) - set(block.inputs.profiles)
        given = [spec for spec in assembly.input_specs if spec.name in numbers]
        return cls(
            assembly=assembly,
            count=count,
            batched=len(block.batch_shape) > 1,
            live=live,
            measured=bool(np.isfinite(block.step_time).any()),
            given=tuple(sorted(given, key=lambda spec: (not _varies(block, spec.name), spec.name not in LOADS))),
            reference=reference is not None,
            rods=rods,
            lines=tuple(drawn_lines(assembly, rods)),
            strongest=_strongest(block, live),
            blocks=tuple(_blocks(block, rods)),
            bases={"/world" + _entity(path): pose for path, pose in base_poses.items()},
            platforms=tuple(plates),
            centre=0.5 * (low + high),
            eye=_eye(everything - 0.5 * (low + high)) + 0.5 * (low + high),
            size=size,
            grid=round_down(0.2 * size),
            force_scale=_force_scale(block, size, reach, live) if force_scale is None else force_scale,
        )

    @property
    def by_component(self) -> bool:
        """One rod: its curvature by component. Several: the magnitude of each one's bending, or the plot is a tangle."""
        return len(self.rods) == 1 and not self.batched

    def rod_color(self, k: int, rod: int) -> int:
        """Of a rod of instance ``k``: instances of one rod are told apart by colour."""
        return PALETTE[k % len(PALETTE)] if len(self.rods) == 1 else self.rods[rod].color

    def world(self, path: str, k: int) -> str:
        """Entity of instance ``k`` in the scene."""
        return f"/world/instance_{k}/{path}" if self.batched else f"/world/{path}"

    def scalar(self, path: str, k: int) -> str:
        """Entity of a quantity of instance ``k``."""
        return f"{path}/instance_{k}" if self.batched else path

    def rod(self, group: str, k: int, rod: int) -> str:
        """Entity of a rod in the scene, below ``group``."""
        return self.world(group, k) + _entity(self.rods[rod].path)

    def line(self, k: int, line: int) -> str:
        """Entity of a line in the scene."""
        return self.world("lines", k) + _entity(self.lines[line].path)

    def driven_by(self, name: str) -> list[DrawnLine]:
        """Lines that an input drives, in its order."""
        return [
            drawn
            for drawn, (_, line) in zip(self.lines, self.assembly.lines, strict=True)
            if line.drive is not None and line.drive[0] == name
        ]

    def curvature(self, k: int, rod: int) -> str:
        """Entity of a rod's curvature."""
        return self.scalar("/curvature", k) + _entity(self.rods[rod].path)


def load(inputs: Inputs, name: str) -> FloatArray:
    """A vector of the inputs, zero where it was not given or the assembly takes none."""
    return getattr(inputs, name) if name in inputs.given else np.zeros(3)


def round_down(value: float) -> float:
    """The largest 1, 2 or 5 times a power of ten that is not above ``value``."""
    power = 10.0 ** math.floor(math.log10(value))
    return max(factor * power for factor in (1, 2, 5) if factor * power <= value * (1 + 1e-12))


def round_up(value: float) -> float:
    """The value rounded up to two digits."""
    power = 10.0 ** (math.floor(math.log10(value)) - 1)
    return math.ceil(value / power - 1e-9) * power


def _entity(parts: tuple[str, ...]) -> str:
    """A path of names that may hold any character."""
    import rerun as rr

    return str(rr.new_entity_path(list(parts)))


def _largest(values: list[FloatArray]) -> float:
    return max((float(np.nanmax(value)) for value in values if np.isfinite(value).any()), default=0.0)


def _varies(block: History, name: str) -> bool:
    """Whether an input changes with time, as far as is known."""
    value = np.broadcast_to(getattr(block.inputs, name), (*block.batch_shape, getattr(block.inputs, name).shape[-1]))
    return bool((value != value[0]).any())


def _visible(rods: list[DrawnRod], size: float) -> tuple[DrawnRod, ...]:
    """All thicker by one factor, where the thickest would hardly be seen."""
    factor = max(1.0, _THINNEST * size / max(rod.radius for rod in rods))
    return tuple(replace(rod, radius=factor * rod.radius) for rod in rods)


def _blocks(block: History, rods: Sequence[DrawnRod]) -> list[DrawnBlock]:
    with block._problem() as problem:
        blocks = problem.blocks
    if len(blocks) == 1:
        return []
    return [
        DrawnBlock(part.name, PLATFORM_COLOR if part.rod is None else rods[part.rod].color, part.residuals) for part in blocks
    ]


def _eye(points: FloatArray) -> FloatArray:
    """From where points about the origin (count, 3) fill the view, seen obliquely."""
    back = np.array([0.75, -1.0, 0.6]) / np.linalg.norm([0.75, -1.0, 0.6])
    right = np.cross([0.0, 0.0, 1.0], back)
    right /= np.linalg.norm(right)
    aside = np.abs(points @ np.stack([right, np.cross(back, right)], axis=-1)).max(axis=1)
    distance = float((points @ back + aside / _VIEW).max())
    return np.asarray(distance * back)


def _strongest(block: History, live: bool) -> float:
    """The largest tension of the first samples; live, at least what bends a rod by about a radian."""
    if not block.assembly.lines:
        return 1.0
    largest = float(np.nanmax(np.abs(block.tension), initial=0.0)) if np.isfinite(block.tension).any() else 0.0
    if live or largest == 0:
        for rod in block.assembly.rods:
            stiffness = max(float(np.max(s.bending_stiffness)) for s in rod.sections)
            bends = [stiffness / float(np.max(line.lever(rod.sections)) * np.max(rod.length)) for line in rod.lines]
            largest = max([largest, *bends])
    return round_up(largest)


def _force_scale(block: History, size: float, reach: float, live: bool) -> float:
    """A quarter of the size for the largest force; live, where that is not known, half the length for ``EI/L^2``."""
    if live:
        stiffness = sum(max(float(np.max(s.bending_stiffness)) for s in rod.sections) for rod in block.assembly.rods)
        return round_down(0.5 * reach**3 / stiffness)
    largest = max(float(np.linalg.norm(load(block.inputs, name), axis=-1).max()) for name in LOADS)
    return round_down(0.25 * size / largest) if largest > 0 else 1.0
