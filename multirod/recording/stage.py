"""What is fixed when a recording begins: what is recorded, where it stands in the file, and to what scale it is drawn."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Self

import numpy as np
from numpy.typing import NDArray

from multirod.assembly import Assembly
from multirod.inputs import InputSpec
from multirod.recording.bodies import DrawnBody, around, drawn_bodies
from multirod.recording.coloring import Coloring
from multirod.recording.figure import (
    PALETTE,
    PLATFORM_COLOR,
    DrawnLine,
    DrawnRod,
    bases,
    beside_lines,
    drawn_lines,
    drawn_rods,
    kind,
)
from multirod.recording.framing import ARROW, Extent, Frame, halved, radian_force, round_down, round_up
from multirod.recording.loads import DrawnLoad, acting, arrow_ends, drawn_loads, largest
from multirod.recording.profiles import Profile, profiles
from multirod.results.history import History
from multirod.results.remarks import Remarks
from multirod.validation import FloatArray

TIP_AXES = 0.1  # length of the tip's axes over what is in view
_LABELLED = 4  # instances that have room for labels
_NAMED = 12  # names that can be told apart in the scene
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
        functions: Names of inputs given as functions of arclength.
        reference: What it is called; empty where there is none.
        kind: What the robot's parts are called.
        rods: How each rod is drawn.
        thinner: Whether that is thinner than they are, so that their lines are seen.
        reference_rods: How each rod of the reference is drawn, which may be another robot.
        lines: How each line of the rods is drawn.
        strongest: Tension at which a line's colour is full [N].
        blocks: Parts of the residual, where there are several.
        profiles: What is drawn along the arclength.
        coloring: What colours the instances; None where their numbers do.
        bases: Poses by entity path.
        bodies: The platform, or the bodies of a network.
        centre: Middle of what is in view [m], shape (3,).
        eye: Where it is seen from [m], shape (3,).
        size: Of what is in view [m].
        grid: Spacing of the grid [m].
        force_scale: Length of force arrows [m/N].
        moment_scale: Length of those of moments [m/(N m)].
        remarks: What a task says of the first sample; None where there is none.
    """

    assembly: Assembly
    count: int
    batched: bool
    live: bool
    measured: bool
    given: tuple[InputSpec, ...]
    functions: tuple[str, ...]
    reference: str
    kind: str
    rods: tuple[DrawnRod, ...]
    thinner: bool
    reference_rods: tuple[DrawnRod, ...]
    lines: tuple[DrawnLine, ...]
    strongest: float
    blocks: tuple[DrawnBlock, ...]
    profiles: tuple[Profile, ...]
    coloring: Coloring | None
    bases: dict[str, FloatArray]
    bodies: tuple[DrawnBody, ...]
    centre: FloatArray
    eye: FloatArray
    size: float
    grid: float
    force_scale: float
    moment_scale: float
    remarks: Remarks | None = None

    @classmethod
    def of(
        cls,
        block: History,
        reference: History | None,
        *,
        node_count: int,
        instances: int,
        force_scale: float | None,
        live: bool,
        reference_name: str = "",
        coloring: Coloring | None = None,
        remarks: Sequence[Remarks] = (),
    ) -> Self:
        """The stage for ``block``, the first samples; see ``save`` and ``Recorder`` for the rest."""
        assembly = block.assembly
        shapes = [block.rod(index, nodes=node_count) for index in range(assembly.rod_count)]
        base_poses = bases(assembly)
        origins = np.array(list(base_poses.values()))
        reach = _largest([shape.arclength for shape in shapes]) or max(float(np.max(rod.length)) for rod in assembly.rods)
        count = min(instances, math.prod(block.batch_shape[1:]))
        held = drawn_bodies(assembly, block.batch_shape[1:], count)
        extent = Extent(origins[:, :3, 3])
        for shape in shapes:
            extent.add(shape.position)
        extent.add(targets(remarks))
        extent.add(around(held, block))
        size = max(extent.size, 0.2 * reach)
        extent.add(frame_ends(block, TIP_AXES * size))
        if live:
            frame, size = Frame.of_reach(origins, extent.points, reach, bool(held)), max(size, 1.5 * reach)
            scale = round_down(ARROW * reach / radian_force(assembly.rods, reach))
            moment_scale = round_down(ARROW / radian_force(assembly.rods, reach))
        else:
            loads = acting(block, [vars(shape) for shape in shapes])
            scale, moment_scale = (final_scale(largest(loads, kind), size) for kind in ("force", "moment"))
            extent.add(arrow_ends(loads, {"force": scale if force_scale is None else force_scale, "moment": moment_scale}))
            frame = Frame(extent.points)
        whole = drawn_rods(assembly, block)
        part = beside_lines(assembly.rods, whole)
        rods = _visible([replace(rod, radius=part * rod.radius) for rod in whole], size)
        reference_rods = () if reference is None else _visible(drawn_rods(reference.assembly), size)
        return cls(
            assembly=assembly,
            count=count,
            batched=len(block.batch_shape) > 1,
            live=live,
            measured=bool(np.isfinite(block.step_time).any()),
            given=given(block),
            functions=tuple(block.inputs.profiles),
            reference="" if reference is None else reference_name or "reference",
            kind=kind(assembly),
            rods=rods,
            thinner=part < 1,
            reference_rods=reference_rods,
            lines=tuple(drawn_lines(assembly, rods)),
            strongest=_strongest(block, live),
            blocks=tuple(_blocks(block, rods)),
            profiles=profiles(assembly.rods, compared=0 < len(reference_rods) == len(rods)),
            coloring=coloring,
            bases={"/world" + _entity(path): pose for path, pose in base_poses.items()},
            bodies=tuple(held),
            centre=frame.centre,
            eye=frame.eye,
            size=size,
            grid=round_down(0.2 * size),
            force_scale=scale if force_scale is None else force_scale,
            moment_scale=moment_scale,
            remarks=remarks[0] if remarks else None,
        )

    def seen_from(self, frame: Frame) -> Self:
        """The stage in another frame."""
        return replace(self, centre=frame.centre, eye=frame.eye)

    @property
    def by_component(self) -> bool:
        """One rod: its curvature by component. Several: the magnitude of each one's bending, or the plot is a tangle."""
        return len(self.rods) == 1 and not self.batched

    def rod_color(self, k: int, rod: int) -> int:
        """Of a rod of instance ``k``: instances of one rod are told apart by colour."""
        return PALETTE[k % len(PALETTE)] if len(self.rods) == 1 else self.rods[rod].color

    @property
    def labelled(self) -> bool:
        """Whether there is room for names, and for what arrows are worth."""
        return self.count <= _LABELLED

    @property
    def scales(self) -> dict[str, float]:
        """Length of arrows, by kind [m/N], [m/(N m)]."""
        return {"force": self.force_scale, "moment": self.moment_scale}

    @property
    def loads(self) -> list[DrawnLoad]:
        """Those that are drawn, as far as is known."""
        names = {spec.name for spec in self.given} | set(self.functions)
        return [own for own in drawn_loads(self.assembly) if not names.isdisjoint(own.inputs)]

    @property
    def split(self) -> str:
        """What the residual is split by."""
        return "by part" if self.lines else f"by {self.kind}"

    def label(self, k: int, rod: int) -> str:
        """The name of a rod in the scene, empty where it says nothing or there are too many."""
        if self.batched:
            return f"instance {k}" if rod == 0 and self.labelled else ""
        alone = len(self.rods) == 1 and not self.assembly.rods[0].name
        return "" if alone or len(self.rods) > _NAMED else self.rods[rod].name

    def world(self, path: str, k: int) -> str:
        """Entity of instance ``k`` in the scene."""
        return f"/world/instance_{k}/{path}" if self.batched else f"/world/{path}"

    def scalar(self, path: str, k: int) -> str:
        """Entity of a quantity of instance ``k``."""
        return f"{path}/instance_{k}" if self.batched else path

    def rod(self, group: str, k: int, rod: int) -> str:
        """Entity of a rod in the scene, below ``group``."""
        rods = self.reference_rods if group.startswith("reference") else self.rods
        return self.world(group, k) + _entity(rods[rod].path)

    def load(self, k: int, load: DrawnLoad) -> str:
        """Entity of a load's arrow in the scene."""
        return self.world("loads", k) + _entity(load.path)

    def body(self, k: int, body: DrawnBody) -> str:
        """Entity of a body in the scene."""
        return self.world(_entity(body.path).lstrip("/"), k)

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

    def profile(self, name: str, k: int, rod: int) -> str:
        """Entity of what is drawn along a rod."""
        return self.scalar(f"/{name}", k) + _entity(self.rods[rod].path)


def given(block: History) -> tuple[InputSpec, ...]:
    """The inputs given as numbers: first what varies as far as is known, and among it the loads."""
    numbers = set(block.inputs.arrays)
    specs = [spec for spec in block.assembly.input_specs if spec.name in numbers]
    loads = {name for own in drawn_loads(block.assembly) for name in own.inputs}
    return tuple(sorted(specs, key=lambda spec: (not _varies(block, spec.name), spec.name not in loads)))


def frame_ends(block: History, length: float) -> FloatArray:
    """Where the axes of the tip's frame end [m], shape (count, 3)."""
    axes = block.tip_rotation.reshape(-1, 3, 3).swapaxes(1, 2)
    return np.asarray(block.tip_position.reshape(-1, 1, 3) + length * axes).reshape(-1, 3)


def targets(remarks: Sequence[Remarks]) -> FloatArray:
    """Where end effectors are to be [m], shape (count, 3)."""
    return np.reshape([said.target for said in remarks if said.target is not None], (-1, 3))


def final_scale(largest: float, size: float) -> float:
    """Of arrows, where all loads are known: a quarter of the size for the largest [m/N]."""
    return round_down(0.25 * size / largest) if largest > 0 else 1.0


def live_scale(scale: float, largest: float, stage: Stage) -> float:
    """Of arrows, where larger loads may come [m/N]: no arrow is longer than a part of the robot's size."""
    return halved(scale, largest, ARROW * stage.size / 1.5)


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
    called = {f"tube {k + 1}": rod.name for k, rod in enumerate(rods)}
    found: list[DrawnBlock] = []
    for part in blocks:
        color = PLATFORM_COLOR if part.rod is None else rods[part.rod].color
        taken = {drawn.color for drawn in found}
        if color in taken:  # a line's, beside its rod's
            color = next((other for other in PALETTE[::-1] if other not in taken), color)
        found.append(DrawnBlock(called.get(part.name, part.name), color, part.residuals))
    return found


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
