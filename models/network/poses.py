"""Poses of the ground and of bodies. Numbers in parentheses are those of ``docs/networks.md``."""

from typing import TYPE_CHECKING

import numpy as np

from multirod.models.network.elements.elements import Frames
from multirod.rotations import vectors
from multirod.validation import FloatArray

if TYPE_CHECKING:
    from multirod.models.network.problem import NetworkProblem


SHORTEST = 1e-300  # that may be divided by


def ground_of(problem: "NetworkProblem") -> tuple[FloatArray, FloatArray]:
    """Position [m] and rotation of the ground in the world, shapes (instance_count, 3), (instance_count, 3, 3)."""
    base = np.broadcast_to(problem.graph.base, (*problem.batch_shape, 4, 4)).reshape(-1, 4, 4)
    return base[:, :3, 3], base[:, :3, :3]


def frames_of(problem: "NetworkProblem") -> Frames:
    """(4) The ground and the bodies at ``unknowns``."""
    with problem.everyone():
        problem._launch(problem._launches[:1])
    own = problem.networks
    position, rotation, turns = (np.array(array.numpy()) for array in (own.body_position, own.body_rotation, own.body_turns))
    return Frames(position, rotation, turns, problem.reference[1])


def body_poses(problem: "NetworkProblem") -> tuple[FloatArray, FloatArray]:
    """What ``NetworkProblem.body_poses`` returns: those as given, and not what is between segments."""
    frames, graph = frames_of(problem), problem.graph
    fixed = 1 + problem.body_count + np.arange(len(graph.fixed))
    given = np.concatenate([1 + np.arange(len(graph.bodies)), fixed])
    return frames.position[:, given], frames.rotation[:, given]


def pose_unknowns(problem: "NetworkProblem", position: FloatArray, rotation: FloatArray) -> FloatArray:
    """(4) The unknowns (instance_count, 6 body_count) at poses (instance_count, body, ...)."""
    L = problem.length[:, problem.rod_count :, None]
    reference_position, reference = problem.reference
    back = np.swapaxes(reference, -1, -2)
    move = np.einsum("bkij,bkj->bki", back, position - reference_position) / L**2
    turn = vectors((back @ rotation).reshape(-1, 3, 3)).reshape(position.shape) / L
    return np.asarray(np.concatenate([move, turn], axis=-1).reshape(problem.instance_count, -1))


def pushed_axes(problem: "NetworkProblem") -> tuple[FloatArray, FloatArray]:
    """(40) Of the coordinates along which torques and forces may act, in their order: where the ends of the rods are [m], and the
    axes about or along which they act on these, in the world, shapes (instance_count, k, 3)."""
    graph, state = problem.graph, problem.state()
    origin, axes = np.zeros((2, problem.instance_count, sum(graph.pushed.values()) + sum(graph.pushed_slides.values()), 3))
    for end, places in zip(state.ends, graph.pushed_at, strict=True):
        for rod, which in np.argwhere(places >= 0).tolist():
            slide = end.joints.slides[rod, :, which]  # one of these is none
            own = end.joints.axes[:, rod, :, which] + slide / max(float(np.linalg.norm(slide)), SHORTEST)
            origin[:, places[rod, which]] = end.position[:, rod]
            axes[:, places[rod, which]] = (end.frame[:, rod] @ own[..., None])[..., 0]
    return origin, axes


def fixed_poses(problem: "NetworkProblem") -> tuple[FloatArray, FloatArray]:
    """(34) Position (instance_count, body, 3) and rotation (instance_count, body, 3, 3) of the bodies that are fixed."""
    frames, first = frames_of(problem), 1 + problem.body_count
    return frames.position[:, first:], frames.rotation[:, first:]
