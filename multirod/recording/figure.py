"""How a robot is drawn: a name, a place, a colour and a thickness for each rod, its bases and its platform."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from multirod.assembly import Assembly
from multirod.models.assemblies.inverse_parallel_rods import InverseParallelRods
from multirod.models.assemblies.network import Network
from multirod.models.assemblies.parallel_rods import ParallelRods
from multirod.models.backbone.assembly import BackboneAssembly
from multirod.models.backbone.members.line_kinds import Chamber
from multirod.models.backbone.members.lines import Line
from multirod.models.network.graph import ENDS
from multirod.models.network.joining.bodies import ground
from multirod.rod import Rod
from multirod.validation import FloatArray

if TYPE_CHECKING:
    from multirod.results.found import Found

# Picked to be told apart on the viewer's dark theme; one for each of the 12 legs that a robot may have.
COLORS = {
    "blue": 0x4FC3F7,
    "orange": 0xFFB74D,
    "green": 0x81C784,
    "pink": 0xF06292,
    "violet": 0xBA9CFF,
    "yellow": 0xFFF176,
    "teal": 0x4DB6AC,
    "coral": 0xFF8A65,
    "lime": 0xD4E157,
    "mauve": 0xE1A6D8,
    "brown": 0xA1887F,
    "grey": 0x90A4AE,
}
PALETTE = tuple(COLORS.values())
PLATFORM_COLOR = 0xC3CAD3
_THICKNESS = 0.004  # radius over length of a rod without diameter
_NESTING = 0.75  # radius of such a tube over that of the next around it
_PALEST = 0.5  # how much white is in the colour of a leg's innermost tube
_MARGIN = 0.25  # how far a platform reaches beyond its attachments, over their distance from its middle
_RIM = 1.25  # radius of a disc over the offset of the outermost line
_BESIDE = 0.7  # radius of a rod over how far its lines are from its middle, where these would be hidden in it
_LEAST = 0.1  # of its radius, that a rod is drawn with then
_PLACES = 33  # along a rod, at which its lines are looked at
_CORNERS = 12  # of the rounding about each attachment
_COPIES = 6  # of a corner among a plate's vertices: on two faces and, for each of two sides, twice on the rim


@dataclass(frozen=True)
class DrawnRod:
    """How one rod is drawn.

    Attributes:
        name: In legends and tables.
        path: Parts of its entity path, below ``rods``.
        color: ``0xRRGGBB``.
        radius: [m].
        shade: The colour in words.
        leg: Number of the leg, among tubes alone of their robot.
    """

    name: str
    path: tuple[str, ...]
    color: int
    radius: float
    shade: str
    leg: int


@dataclass(frozen=True)
class DrawnLine:
    """How a line of a rod is drawn.

    Attributes:
        name: In legends and tables.
        path: Parts of its entity path, below ``lines``.
        radius: Of a chamber [m]; zero of what is drawn as a strip.
    """

    name: str
    path: tuple[str, ...]
    radius: float


@dataclass(frozen=True)
class Plate:
    """A flat body with rounded corners, or a solid, as triangles.

    Attributes:
        vertices: [m], shape (vertex_count, 3).
        normals: Of the surface at each vertex, shape (vertex_count, 3).
        triangles: Indices of vertices, shape (triangle_count, 3).
        flat: Whether it is a plate, and no solid.
    """

    vertices: FloatArray
    normals: FloatArray
    triangles: NDArray[np.uint32]

    flat: bool = True

    @property
    def faces(self) -> list[FloatArray]:
        """Polygons that show it [m], shapes (corner_count, 3): of a flat one its outline."""
        return [self.vertices[: len(self.vertices) // _COPIES]] if self.flat else list(self.vertices[self.triangles])


def drawn_rods(assembly: Assembly, found: "Found | None" = None) -> list[DrawnRod]:
    """One for each rod, in the order of ``assembly.rods``; tubes of one leg share a hue and stand below the leg.

    Of a batch each is as thick as its thickest, of those instances that are ``found``.
    """
    if not isinstance(assembly, (ParallelRods, InverseParallelRods)):
        names = _names(assembly.rods)
        nested = isinstance(assembly, BackboneAssembly)
        radii = _radii(assembly.rods, found) if nested else [_radii([rod], found)[0] for rod in assembly.rods]
        return [
            DrawnRod(name, (name,), PALETTE[k % len(PALETTE)], radius, _shade(k), 0 if nested else k)
            for k, (name, radius) in enumerate(zip(names, radii, strict=True))
        ]
    drawn = []
    for k, (leg, own) in enumerate(zip(_leg_names(assembly), _legs(assembly), strict=True)):
        names = _names(own)
        for i, (name, radius) in enumerate(zip(names, _radii(own, found), strict=True)):
            path = (leg,) if len(own) == 1 else (leg, name)
            white = _PALEST * (len(own) - 1 - i) / max(len(own) - 1, 1)
            color = _mixed_with_white(PALETTE[k % len(PALETTE)], white)
            shade = f"{'pale ' if white else ''}{_shade(k)}"
            drawn.append(DrawnRod(" ".join(path), path, color, radius, shade, k))
    return drawn


def kind(assembly: Assembly) -> str:
    """What the parts of a robot are called."""
    if isinstance(assembly, (ParallelRods, InverseParallelRods)):
        return "leg"
    return "tube" if len(assembly.rods) > 1 and isinstance(assembly, BackboneAssembly) else "rod"


def bases(assembly: Assembly) -> dict[tuple[str, ...], FloatArray]:
    """Poses (4, 4) of the bases, by the parts of their entity paths; of a batch of bases, the first 16."""
    names: list[tuple[str, ...]] = [()]
    poses = np.asarray(getattr(assembly, "base", np.eye(4)))[..., None, :, :]
    if isinstance(assembly, (ParallelRods, InverseParallelRods)):
        names = [(leg,) for leg in _leg_names(assembly)]
        poses = assembly.geometry.base
    if isinstance(assembly, Network):
        standing = [joint for joint in assembly.joints if joint.to is ground and joint.end == "base"]
        names = [(joint.rod,) for joint in standing] or names
        own = [assembly.base @ joint.pose for joint in standing]
        poses = np.stack(np.broadcast_arrays(*own), axis=-3) if own else poses
    robots = poses.reshape(-1, *poses.shape[-3:])[:16]
    return {
        ("base" if len(robots) == 1 else f"base_{k}", *name): pose
        for k, robot in enumerate(robots)
        for name, pose in zip(names, robot, strict=True)
    }


def joined_to(robot: Network) -> list[tuple[str, str]]:
    """What the base and the tip of each rod are on, and how, in words; with the tip what the rod slides through."""
    at = {(joint.rod, joint.end): f"{joint.to.name}, {joint.kind}" for joint in robot.joints if joint.end in ENDS}
    found = []
    for rod in robot.rods:
        base, tip = (at.get((rod.name, end), "free") for end in ENDS)
        holes = [
            f"; through {joint.to.name}, {joint.kind}"
            for joint in robot.joints
            if joint.rod == rod.name and joint.end not in ENDS
        ]
        found.append((base, tip + "".join(holes)))
    return found


def bodies_in_words(robot: Network) -> str:
    """The bodies of a network, with their masses."""
    return ", ".join(f"{body.name} ({body.mass:g} kg)" if body.mass else body.name for body in robot.bodies)


def drawn_lines(assembly: Assembly, rods: Sequence[DrawnRod]) -> list[DrawnLine]:
    """The lines of all rods, in their order; a chamber is as thick as its area is large."""
    lines = []
    for k, (rod, line) in enumerate(assembly.lines):
        name = line.name or f"line {k + 1}"
        lines.append(DrawnLine(name, (*rods[rod].path, name), _line_radius(line)))
    return lines


def beside_lines(rods: Sequence[Rod], drawn: Sequence[DrawnRod]) -> float:
    """Part of their radii by which all rods are drawn, so that no line is hidden in its rod; batches of routes apart."""
    part = 1.0
    for rod, own in zip(rods, drawn, strict=True):
        places = np.linspace(0, float(np.max(rod.length)), _PLACES)[None]
        for line in rod.lines:
            if not line.batch_shape:
                nearest = np.nanmin(np.linalg.norm(line.offset_at(places, (), None), axis=-1), initial=math.inf)
                part = min(part, max(_BESIDE * (float(nearest) - _line_radius(line)) / own.radius, _LEAST))
    return part


def _line_radius(line: Line) -> float:
    return math.sqrt(float(np.max(line.area)) / math.pi) if isinstance(line, Chamber) else 0.0


def discs(rod: Rod) -> tuple[FloatArray, float]:
    """Where the discs of a rod are, arclengths [m], and their radius [m]: they reach beyond its lines."""
    length, spacing = float(np.max(rod.length)), rod.discs or 0.0
    count = int(length / spacing * (1 + 1e-9)) + 1 if spacing else 0
    places: FloatArray = np.asarray(spacing * np.arange(count), dtype=np.float64)
    offsets = [line.offset_at(places[None], (), None) for line in rod.lines if not line.batch_shape]
    reach = max((float(np.nanmax(np.linalg.norm(rho, axis=-1), initial=0.0)) for rho in offsets if rho.size), default=0.0)
    return places, _RIM * (reach or 2 * _THICKNESS * length)


def plate_through(attachments: FloatArray, least: float) -> Plate:
    """A plate through the attachments (leg_count, 4, 4), ``least`` or more around each [m].

    A disc about each attachment, square to its leg, gives points enough to fit a plane where attachments are on a line.
    """
    from scipy.spatial import ConvexHull

    points, margin = _around(attachments, least)
    middle = points.mean(axis=0)
    x, y, z = np.linalg.svd(points - middle)[2]
    x = np.cross(y, z)  # right-handed
    outline = points[ConvexHull((points - middle) @ np.stack([x, y], axis=-1)).vertices] - middle  # anticlockwise about z
    outline -= np.outer(outline @ z, z)
    count, half = len(outline), 0.15 * margin * z
    after = np.roll(outline, -1, axis=0)
    across = np.cross(after - outline, z)
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    # top, bottom, then the rim, whose corners have a normal for each side they belong to
    rim = np.stack([outline - half, after - half, after + half, outline + half], axis=1)
    vertices = np.concatenate([outline + half, outline - half, rim.reshape(-1, 3)]) + middle
    normals = np.concatenate([np.tile(z, (count, 1)), np.tile(-z, (count, 1)), np.repeat(across, 4, axis=0)])
    fan = np.stack([np.zeros(count - 2), np.arange(1, count - 1), np.arange(2, count)], axis=-1)
    sides = 2 * count + 4 * np.arange(count)[:, None, None] + np.array([[0, 1, 2], [0, 2, 3]])
    triangles = np.concatenate([fan, count + fan[:, ::-1], sides.reshape(-1, 3)]).astype(np.uint32)
    return Plate(vertices, normals, triangles)


def solid_through(attachments: FloatArray, least: float) -> Plate:
    """A solid with flat faces through attachments that are in no plane, or whose rods are along it, as for ``plate_through``."""
    from scipy.spatial import ConvexHull

    points, margin = _around(attachments, least)
    count = len(attachments)
    depth = 0.15 * margin * np.repeat(attachments[:, :3, 2], len(points) // count, axis=0)
    points = np.concatenate([points - depth, points + depth])
    hull = ConvexHull(points)
    corners = points[hull.simplices]
    normals = hull.equations[:, :3]
    turned = np.einsum("ti,ti->t", np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), normals) < 0
    corners[turned] = corners[turned][:, ::-1]
    triangles = np.arange(3 * len(corners)).reshape(-1, 3).astype(np.uint32)
    return Plate(corners.reshape(-1, 3), np.repeat(normals, 3, axis=0), triangles, flat=False)


def _around(attachments: FloatArray, least: float) -> tuple[FloatArray, float]:
    """Points on a disc about each attachment, square to its rod, shape (point_count, 3), and the radius of these discs."""
    centre = attachments[:, :3, 3]
    margin = max(_MARGIN * float(np.linalg.norm(centre - centre.mean(axis=0), axis=1).max()), least)
    angle = 2 * np.pi * np.arange(_CORNERS) / _CORNERS
    disc = margin * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    return (centre[:, None] + np.einsum("lij,cj->lci", attachments[:, :3, :2], disc)).reshape(-1, 3), margin


def _legs(robot: ParallelRods | InverseParallelRods) -> list[tuple[Rod, ...]]:
    return [robot.rods[first:last] for first, last in pairwise(robot.geometry.first_rod)]


def _leg_names(robot: ParallelRods | InverseParallelRods) -> list[str]:
    """The rod's name where a leg is one rod, otherwise its number, as in the names of residual blocks."""
    legs = _legs(robot)
    given = [leg[0].name if len(leg) == 1 else "" for leg in legs]
    return _unique(given, [f"leg_{k + 1}" for k in range(len(legs))])


def _names(rods: Sequence[Rod]) -> list[str]:
    return _unique([rod.name for rod in rods], [f"rod_{k}" for k in range(len(rods))])


def _unique(given: list[str], otherwise: list[str]) -> list[str]:
    """The names that were given, where no other is or may be the same."""
    taken = [*given, *otherwise]
    return [name if name and taken.count(name) == 1 else other for name, other in zip(given, otherwise, strict=True)]


def _radii(nested: Sequence[Rod], found: "Found | None") -> list[float]:
    """Radii to draw, innermost first: half the outer diameter, or what makes the nesting visible where none is given."""
    sizes = [None if rod.outer_diameter is None else np.asarray(rod.outer_diameter) for rod in nested]
    given = [
        None if size is None else 0.5 * float(np.max(size if found is None else found._parameter(size, 0), initial=0.0))
        for size in sizes
    ]
    known = [(k, radius) for k, radius in enumerate(given) if radius is not None]
    last, radius = known[-1] if known else (len(nested) - 1, _THICKNESS * max(float(np.max(rod.length)) for rod in nested))
    around = radius / _NESTING ** (len(nested) - last)
    result = []
    for own in reversed(given):
        around = _NESTING * around if own is None else own
        result.append(around)
    return result[::-1]


def _shade(k: int) -> str:
    return list(COLORS)[k % len(COLORS)]


def _mixed_with_white(color: int, part: float) -> int:
    return sum(round(value + part * (0xFF - value)) << shift for shift in (16, 8, 0) for value in ((color >> shift) & 0xFF,))
