"""How what rods hold is drawn: the platform of parallel robots, the bodies of a network."""

from dataclasses import dataclass

import numpy as np

from multirod.assembly import Assembly
from multirod.models.assemblies.inverse_parallel_rods import InverseParallelRods
from multirod.models.assemblies.network import Network
from multirod.models.assemblies.parallel_rods import ParallelRods
from multirod.models.network.joining.bodies import Body
from multirod.recording.figure import Plate, drawn_rods, plate_through, solid_through
from multirod.results.solution import Solution
from multirod.validation import FloatArray

_LEAST = 0.03  # radius of what holds a single rod, over the length of the longest
_ASIDE = np.array([1.0, 0.75, 0.0])
_FLAT = 1e-3  # how far attachments may be off a plane, over their distances, for a plate


@dataclass(frozen=True)
class DrawnBody:
    """How a body is drawn.

    Attributes:
        name: Of a body of a network; empty for a platform.
        path: Parts of its entity path.
        solids: In its own frame, one an instance.
    """

    name: str
    path: tuple[str, ...]
    solids: tuple[Plate, ...]

    @property
    def reach(self) -> float:
        """How far from its origin it is, along an axis [m]."""
        return float(np.abs(self.solids[0].vertices).max()) if self.solids else 0.0

    def corner(self, k: int) -> FloatArray:
        """Where its name is not in the way of arrows, in its own frame [m], shape (3,): at its rim, to the right."""
        vertices = self.solids[k].vertices
        return np.asarray(vertices[np.argmax(vertices @ _ASIDE)])


def drawn_bodies(assembly: Assembly, batch_shape: tuple[int, ...], count: int) -> list[DrawnBody]:
    """The platform or the bodies of the first ``count`` instances; none where the assembly has none."""
    if isinstance(assembly, Network):
        return [_body(assembly, body, batch_shape, count) for body in assembly.bodies]
    if not isinstance(assembly, (ParallelRods, InverseParallelRods)):
        return []
    attachments = assembly.geometry.platform
    every = np.broadcast_to(attachments, (*batch_shape, *attachments.shape[-3:])).reshape(-1, *attachments.shape[-3:])
    least = 2 * max(rod.radius for rod in drawn_rods(assembly))
    return [DrawnBody("", ("platform",), tuple(plate_through(poses, least) for poses in every[:count]))]


def _body(robot: Network, body: Body, batch_shape: tuple[int, ...], count: int) -> DrawnBody:
    held = [joint.pose for joint in robot.joints if joint.to is body]
    least = least_around(robot, len(held))
    every = [np.broadcast_to(pose, (*batch_shape, 4, 4)).reshape(-1, 4, 4)[:count] for pose in held]
    poses = np.stack(every, axis=1)
    same = all(pose.ndim == 2 for pose in held) and len(poses) > 0
    solids = (body_through(poses[0], least),) * len(poses) if same else tuple(body_through(own, least) for own in poses)
    return DrawnBody(body.name, ("bodies", body.name), solids)


def least_around(robot: Network, held: int) -> float:
    """How much of a body is around each of the ``held`` places where it holds rods, at least [m]."""
    least = 2 * max(rod.radius for rod in drawn_rods(robot))
    return least if held > 1 else max(least, _LEAST * max(float(np.max(rod.length)) for rod in robot.rods))


def body_through(attachments: FloatArray, least: float) -> Plate:
    """A plate through attachments (rod_count, 4, 4) that are in a plane, and whose rods are across it; else a solid."""
    centre = attachments[:, :3, 3] - attachments[:, :3, 3].mean(axis=0)
    spread = np.linalg.svd(centre, compute_uv=False) if len(centre) > 2 else np.zeros(3)
    flat = len(spread) < 3 or spread[2] <= _FLAT * max(spread[0], 1e-300)
    across = np.abs(attachments[0, :3, 2] @ attachments[:, :3, 2].T).min() > 0.5
    in_line = np.abs(centre @ attachments[0, :3, 2]).max() > 0.5 * np.linalg.norm(centre, axis=1).max()
    return plate_through(attachments, least) if flat and across and not in_line else solid_through(attachments, least)


def poses_of(body: DrawnBody, solution: Solution) -> tuple[FloatArray, FloatArray]:
    """Position (..., 3) and rotation (..., 3, 3) of a body in the world."""
    if body.name:
        return solution.body_position(body.name), solution.body_rotation(body.name)
    return solution.tip_position, solution.tip_rotation


def around(bodies: list[DrawnBody] | tuple[DrawnBody, ...], solution: Solution) -> FloatArray:
    """Points about end effector and bodies as far as these reach [m], shape (count, 3)."""
    points = [solution.tip_position.reshape(-1, 3)]
    for body in bodies:
        sides = body.reach * np.array([[-1.0], [1.0], [0.0]])
        points.append((poses_of(body, solution)[0].reshape(-1, 1, 3) + sides).reshape(-1, 3))
    return np.concatenate(points)
