"""Where bodies are if rods stand as they are by themselves: from the ground on, body by body.

Numbers in parentheses are those of ``docs/networks.md``.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from multirod.models.network.joining.joints import KINDS, JointTable
from multirod.models.platform.starting.guess import fitted_pose
from multirod.validation import FloatArray

POINTS = 3  # that tell how a body is turned


@dataclass(frozen=True)
class Placing:
    """What holds the rods; of bases, then of tips.

    Attributes:
        frames: What holds each end: 0 the ground, from 1 on the bodies, -1 nothing, shape (rod_count,).
        attachments: Positions (instance, rod, 3) and rotations (instance, rod, 3, 3) on that.
        tables: The joints.
        angles: At which they are, (instance or 1, rod, 3): those that are driven where they are, others at rest.
        given: Pose of each body in the world, (instance, 4, 4), where it is given.
        between: Which bodies are between the segments of a rod, shape (body_count,).
    """

    frames: list[NDArray[np.intp]]
    attachments: list[tuple[FloatArray, FloatArray]]
    tables: list[JointTable]
    angles: list[FloatArray]
    given: list[FloatArray | None]
    between: NDArray[np.bool_]


def placed(at: Placing, tip: FloatArray, turn: FloatArray) -> tuple[FloatArray, FloatArray]:
    """(13) Position and rotation of the ground, then of every body, that fit rods best whose tips are at ``tip`` (instance, rod,
    3) and turned by ``turn`` (instance, rod, 3, 3) in the frames of their bases, joints at rest, or where they are driven to.

    A body is placed by the rods that lead to it from what is placed already; (43) what is between their segments is placed first,
    so that a rod leads as far as if it were in one.
    """
    count, bodies = len(tip), len(at.given)
    position, rotation = np.zeros((count, bodies + 1, 3)), np.zeros((count, bodies + 1, 3, 3))
    rotation[:, 0] = np.eye(3)
    known = np.zeros(bodies + 1, dtype=bool)
    known[0] = True
    for body, pose in enumerate(at.given, 1):
        if pose is not None:
            position[:, body], rotation[:, body], known[body] = pose[:, :3, 3], pose[:, :3, :3], True
    while not known.all():
        ahead = {k: own for k in np.flatnonzero(~known).tolist() if (own := _leading(at, k, known))}
        if not ahead:  # what nothing leads to is refused before
            raise ValueError("a body is not joined to the ground")
        first = [k for k in ahead if at.between[k - 1]] or list(ahead)
        for k in first:
            position[:, k], rotation[:, k] = _fitted(at, ahead[k], position, rotation, tip, turn)
        known[first] = True
    return position, rotation


def _leading(at: Placing, body: int, known: NDArray[np.bool_]) -> list[tuple[int, int]]:
    """Which rods lead to a body from what is ``known``, and by which of their ends."""
    ends = [(end, rod) for end in (0, 1) for rod in np.flatnonzero(at.frames[end] == body).tolist()]
    return [(end, rod) for end, rod in ends if (other := at.frames[1 - end][rod]) >= 0 and known[other]]


def _fitted(
    at: Placing,
    reached: list[tuple[int, int]],
    position: FloatArray,
    rotation: FloatArray,
    tip: FloatArray,
    turn: FloatArray,
) -> tuple[FloatArray, FloatArray]:
    """Pose of a body that rods reach by some of their ends, ``(end, rod)``, from what is placed."""
    turns = [table.at(angles) for table, angles in zip(at.tables, at.angles, strict=True)]
    rest = [own.rotation for own in turns]
    attachments = [  # (36)
        (arm + (frame @ own.moved[..., None])[..., 0], frame) for (arm, frame), own in zip(at.attachments, turns, strict=True)
    ]
    places, frames = [], []
    for end, rod in reached:
        other = 1 - end
        holder = at.frames[other][rod]
        arm, frame = (values[:, rod] for values in attachments[other])
        here, there = (rest[k][:, rod] for k in (end, other))
        p = position[:, holder] + np.einsum("bij,bj->bi", rotation[:, holder], arm)
        R = rotation[:, holder] @ frame @ there
        if end == 1:  # from the base to the tip
            p, R = p + np.einsum("bij,bj->bi", R, tip[:, rod]), R @ turn[:, rod]
        else:
            R = R @ np.swapaxes(turn[:, rod], 1, 2)
            p = p - np.einsum("bij,bj->bi", R, tip[:, rod])
        places.append(p)
        frames.append(R @ np.swapaxes(here, 1, 2))
    arm, frame = (np.stack([attachments[end][k][:, rod] for end, rod in reached], axis=1) for k in (0, 1))
    few = len(reached) < POINTS
    framed = np.array([few or at.tables[end].free[rod] < KINDS["spherical"] for end, rod in reached])
    return fitted_pose(np.stack(places, axis=1), np.stack(frames, axis=1), arm, frame, framed)
