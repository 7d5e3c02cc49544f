"""Tubes and platforms as closed surfaces."""

from math import prod
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from multirod.files.optional import optional
from multirod.files.whole import written
from multirod.recording.bodies import drawn_bodies, poses_of
from multirod.recording.figure import PLATFORM_COLOR, Plate, drawn_rods
from multirod.results.solution import Solution
from multirod.validation import Described, FloatArray, positive_int, refuse

ENDINGS = (".glb", ".obj", ".ply", ".stl")
MOST_INSTANCES = 100


def write(path: Path, solution: Solution, nodes: int | None = None, corners: int = 24) -> None:
    """The scene as a file of meshes [m]."""
    content = scene(solution, nodes, corners).export(file_type=path.suffix.lower()[1:])
    with written(path) as part:
        part.write_bytes(content.encode("utf-8") if isinstance(content, str) else content)


def scene(solution: Solution, nodes: int | None, corners: int) -> Any:  # noqa: ANN401  (trimesh need not be there)
    """See ``Solution.to_mesh``."""
    corners = positive_int("to_mesh.corners", corners, 3)
    count = prod(solution.batch_shape)
    sound = np.isfinite(solution.tip_position).all(axis=-1).reshape(-1)
    if not sound.any():
        refuse("to_mesh", solution, "there must be an instance with a result")
    if count > MOST_INSTANCES:
        refuse("to_mesh", Described(f"{count} instances"), f"at most {MOST_INSTANCES}: choose some, solution[index]")
    trimesh = optional("trimesh", "mesh", "meshes")
    result = trimesh.Scene()

    def add(name: str, k: int, vertices: FloatArray, triangles: NDArray[Any], color: int) -> None:
        """A body of its own name and colour; of a batch, below its instance."""
        mesh = trimesh.Trimesh(vertices, triangles, process=False)
        mesh.visual.face_colors = [color >> 16 & 0xFF, color >> 8 & 0xFF, color & 0xFF, 0xFF]
        full = f"instance_{k}/{name}" if solution.batch_shape else name
        result.add_geometry(mesh, node_name=full, geom_name=full)

    for index, (rod, drawn) in enumerate(zip(solution.assembly.rods, drawn_rods(solution.assembly), strict=True)):
        shape = solution.rod(index, nodes=nodes)
        position, rotation = (
            value.reshape(count, *value.shape[len(solution.batch_shape) :]) for value in (shape.position, shape.rotation)
        )
        outer = 2 * drawn.radius if rod.outer_diameter is None else rod.outer_diameter
        hollow = 0.0 if rod.inner_diameter is None else rod.inner_diameter
        each = [solution._parameter(np.asarray(size), 0) / 2 for size in (outer, hollow)]
        radii, inner = (np.broadcast_to(size, solution.batch_shape).reshape(-1) for size in each)
        for k in np.flatnonzero(sound):
            surface = tube(position[k], rotation[k, :, :, 2], float(radii[k]), float(inner[k]), corners)
            add(drawn.name, int(k), *surface, drawn.color)
    for body in drawn_bodies(solution.assembly, solution.batch_shape, count):
        position, rotation = poses_of(body, solution)
        origin, turn = position.reshape(-1, 3), rotation.reshape(-1, 3, 3)
        for k in np.flatnonzero(sound):
            vertices, triangles = _closed(body.solids[k])
            add("/".join(body.path), int(k), origin[k] + vertices @ turn[k].T, triangles, PLATFORM_COLOR)
    return result


def tube(
    centre: FloatArray, tangent: FloatArray, radius: float, inner: float, corners: int
) -> tuple[FloatArray, NDArray[np.intp]]:
    """A tube through nodes, hollow where ``inner`` is not zero, with flat ends: vertices, and triangles that face outward.

    Args:
        centre: Nodes [m], shape (node_count, 3).
        tangent: What the sections are square to, there, shape (node_count, 3).
        radius: Of the outer surface [m].
        inner: Of the inner one [m].
        corners: Of a section; they lie on the circles.
    """
    frames = _untwisted(tangent)
    angle = 2 * np.pi * np.arange(corners) / corners
    around = np.stack([np.cos(angle), np.sin(angle)], axis=-1) @ frames  # (node, corner, 3)
    outer = centre[:, None] + radius * around
    count, total = len(centre), len(centre) * corners
    k, after = np.arange(corners), (np.arange(corners) + 1) % corners
    ring = corners * np.arange(count - 1)[:, None]
    sides = _quads(ring + k, ring + after, ring + corners + after, ring + corners + k)
    last = total - corners
    if inner > 0:
        ends = [
            _quads(after, k, total + k, total + after),
            _quads(last + k, last + after, total + last + after, total + last + k),
        ]
        vertices = np.concatenate([outer.reshape(-1, 3), (centre[:, None] + inner * around).reshape(-1, 3)])
        return vertices, np.concatenate([sides, total + sides[:, ::-1], *ends])
    first_end = np.stack([after, k, np.full(corners, total)], axis=-1)
    last_end = np.stack([last + k, last + after, np.full(corners, total + 1)], axis=-1)
    vertices = np.concatenate([outer.reshape(-1, 3), centre[[0, -1]]])
    return vertices, np.concatenate([sides, first_end, last_end])


def _quads(a: NDArray[np.intp], b: NDArray[np.intp], c: NDArray[np.intp], d: NDArray[np.intp]) -> NDArray[np.intp]:
    """Two triangles for each four corners."""
    corners = np.stack(np.broadcast_arrays(a, b, c, d), axis=-1).reshape(-1, 4)
    return np.concatenate([corners[:, [0, 1, 2]], corners[:, [0, 2, 3]]])


def _untwisted(tangent: FloatArray) -> FloatArray:
    """Two axes square to each tangent that turn about it as little as they can from node to node, shape (node_count, 2, 3)."""
    x = np.eye(3)[np.argmin(np.abs(tangent[0]))]
    frames = np.empty((len(tangent), 2, 3))
    for k, z in enumerate(tangent):
        x = x - (x @ z) * z
        x = x / np.linalg.norm(x)
        frames[k] = x, np.cross(z, x)
    return frames


def _closed(plate: Plate) -> tuple[FloatArray, NDArray[np.intp]]:
    """A plate with one vertex where it has several, one a face."""
    vertices, which = np.unique(plate.vertices, axis=0, return_inverse=True)
    return vertices, which.reshape(-1)[plate.triangles]
