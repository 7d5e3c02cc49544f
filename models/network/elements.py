"""A rod as an element of a network: what its two ends say of the bodies that hold them, linearised.

Numbers in parentheses are those of ``docs/networks.md``. All rods are worked on at once; arrays have the axes (instance, rod,
...). An element has the 24 variables of ``VARIABLES`` and as many rows of ``ROWS``; its matrix is that of the rows by the
variables. What is condensed away are its first ``INNER``.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from multirod.models.network.joints import MOST, JointTable, Turns
from multirod.rotations import cross, cross_matrix, inverse_left_jacobian, vectors
from multirod.validation import FloatArray

OWN = 6  # unknowns of a rod: moment and force at its base
POSE = 6  # of a body
TURNING = 3  # directions in which the base of a rod may turn
INNER = OWN + 2 * MOST
SIZE = INNER + 2 * POSE
# variables: the rod's own, angles of the joints at base and tip, poses of the bodies there
OWN_AT = slice(0, OWN)
ANGLES_AT = (slice(OWN, OWN + MOST), slice(OWN + MOST, INNER))
POSES_AT = (slice(INNER, INNER + POSE), slice(INNER + POSE, SIZE))
# rows: gap and mismatch of the tip, or what is free there; torques of the joints; the balances of both bodies
GAP_AT, TURN_AT = slice(0, 3), slice(3, 6)
TORQUES_AT, BALANCES_AT = ANGLES_AT, POSES_AT


@dataclass(frozen=True)
class Frames:
    """(4) Poses of the ground and the bodies, axes (instance, frame, ...), and how unknowns move them.

    Attributes:
        position: [m], shape (..., 3).
        rotation: Shape (..., 3, 3).
        moves: By the three unknowns of position, as columns, shape (..., 3, 3).
        turns: Rotation vectors by the three unknowns of rotation, in the world, as columns, shape (..., 3, 3).
        axes: Along which the balance of each is told, as columns, shape (..., 3, 3).
        pull: What forces are multiplied by, (..., 1).
        twist: What moments are multiplied by, (..., 1).
    """

    position: FloatArray
    rotation: FloatArray
    moves: FloatArray
    turns: FloatArray
    axes: FloatArray
    pull: FloatArray
    twist: FloatArray


@dataclass(frozen=True)
class Integrated:
    """Rods in the frames of their bases, as integrated.

    Columns are by their own unknowns, then by turns of the base, then along directions.

    Attributes:
        position, rotation: Of the tip, shapes (..., 3), (..., 3, 3).
        force, moment: On the tip.
        base_force, base_moment: In the rod at its base.
        pose_columns: Of tip position, then rotation vector, shape (..., 6, k).
        wrench_columns: Of force, then moment on the tip, shape (..., 6, k).
        base_columns: Of force, then moment at the base, shape (..., 6, k).
    """

    position: FloatArray
    rotation: FloatArray
    force: FloatArray
    moment: FloatArray
    base_force: FloatArray
    base_moment: FloatArray
    pose_columns: FloatArray
    wrench_columns: FloatArray
    base_columns: FloatArray


class Holding:
    """One end of all rods at some poses of the bodies and angles of the joints.

    Attributes:
        joints: (2) The joints there.
        arm: From the body to the end, in the world, shape (..., 3).
        frame: Of the pose on the body, in the world, shape (..., 3, 3).
        position: Of the end [m], shape (..., 3).
        rotation: Of the end, shape (..., 3, 3).
        moves: How it moves by the pose of the body, shape (..., 3, 6).
        body_turns: How it turns by that, in the world, shape (..., 3, 6).
        angle_turns: How it turns by the unknown angles, in the world, shape (..., 3, 3).
    """

    def __init__(
        self,
        frames: Frames,
        holder: NDArray[np.intp],
        attachment: tuple[FloatArray, FloatArray],
        joints: Turns,
        length: FloatArray,
    ) -> None:
        arm, frame = attachment
        R = frames.rotation[:, holder]
        self.joints = joints
        self.arm = _times(R, arm)
        self.frame = R @ frame
        self.position = frames.position[:, holder] + self.arm
        self.rotation = self.frame @ joints.rotation
        turns = frames.turns[:, holder]
        self.moves = np.concatenate([frames.moves[:, holder], -cross_matrix(self.arm) @ turns], axis=-1)
        self.body_turns = np.concatenate([np.zeros_like(turns), turns], axis=-1)
        self.angle_turns = length[..., None, None] * (self.frame @ joints.turns)


class Equations:
    """(5) to (11) The elements of all rods.

    Args:
        rods: As integrated.
        ends: What holds their bases, then their tips.
        tables: The joints there.
        angles: Their coordinates [rad], (instance, rod, 3).
        length: Scale of each rod [m], (instance, rod).
        stiffness: Likewise [N m^2].
        shared: Whether the joint at a base is that at the tip of the rod below, (rod,): then the torques there are added up.
    """

    def __init__(
        self,
        rods: Integrated,
        ends: Sequence[Holding],
        tables: Sequence[JointTable],
        angles: Sequence[FloatArray],
        length: FloatArray,
        stiffness: FloatArray,
        shared: NDArray[np.bool_],
    ) -> None:
        self.shared = shared[:, None]
        self.rates: list[FloatArray] = []
        self.rods, self.ends, self.tables, self.angles = rods, ends, tables, angles
        self.length, self.stiffness = length[..., None], stiffness[..., None]
        base = ends[0]
        self.frame = base.rotation
        self.back = np.swapaxes(base.rotation, -1, -2)
        self.count, self.size = base.rotation.shape[:2]
        self.direction_count = rods.pose_columns.shape[-1] - OWN - TURNING
        # (5) turns of the base, in its frame, by the angles of its joint and the pose of its body
        self.by_angles, self.by_pose = self.back @ base.angle_turns, self.back @ base.body_turns
        self.residual = np.zeros((self.count, self.size, SIZE))
        self.columns = np.zeros((self.count, self.size, SIZE, SIZE + self.direction_count))
        self.tip_rotation = self.frame @ rods.rotation
        self.force, self.moment = _times(self.frame, rods.force), _times(self.frame, rods.moment)
        self.tip_turn = self._carried(None, rods.pose_columns[..., 3:, :])
        self.by_force = self.frame @ self._carried(rods.force, rods.wrench_columns[..., :3, :])
        self.by_moment = self.frame @ self._carried(rods.moment, rods.wrench_columns[..., 3:, :])

    def spread(self, columns: FloatArray) -> FloatArray:
        """(5) Columns of a rod as integrated, as columns by the variables of the element, then along directions."""
        result = np.zeros((*columns.shape[:-1], SIZE + self.direction_count))
        by_turn = columns[..., OWN : OWN + TURNING]
        result[..., OWN_AT] = columns[..., :OWN]
        result[..., ANGLES_AT[0]] = by_turn @ self.by_angles
        result[..., POSES_AT[0]] = by_turn @ self.by_pose
        result[..., SIZE:] = columns[..., OWN + TURNING :]
        return result

    def drive(self, rates: Sequence[FloatArray]) -> None:
        """(24) What is driven, once all rows are there: how the angles at bases, then at tips change along directions [rad],
        (instance, rod, 3, k)."""
        scaled = [own / self.length[..., None] for own in rates]
        if any(own.any() for own in scaled):
            self.rates = scaled
            self.columns = self.driven(self.columns)

    def driven(self, columns: FloatArray) -> FloatArray:
        """(24) Columns (instance, rod, ..., SIZE + k) with those along directions by the angles that are driven."""
        if not self.rates:
            return columns
        result = np.array(columns)
        for at, rates in zip(ANGLES_AT, self.rates, strict=True):
            result[..., SIZE : SIZE + rates.shape[-1]] += columns[..., at] @ rates
        return result

    def _carried(self, vector: FloatArray | None, columns: FloatArray) -> FloatArray:
        """(5) The same of a vector that turns with the base, or of a rotation where there is none, in the frame of the base."""
        turned = np.array(columns)
        turned[..., OWN : OWN + TURNING] += np.eye(3) if vector is None else -cross_matrix(vector)
        return self.spread(turned)

    def join(self) -> None:
        """(7), (8) The gap between tip and body, in the frame of the base, and their mismatch."""
        rods, (base, tip), L = self.rods, self.ends, self.length
        apart = _times(self.back, base.position - tip.position)
        gap = self.spread(rods.pose_columns[..., :3, :])
        gap[..., ANGLES_AT[0]] += cross_matrix(apart) @ self.by_angles
        gap[..., POSES_AT[0]] += cross_matrix(apart) @ self.by_pose + self.back @ base.moves
        gap[..., POSES_AT[1]] -= self.back @ tip.moves
        self.residual[..., GAP_AT] = (apart + rods.position) / L**2
        self.columns[..., GAP_AT, :] = gap / L[..., None] ** 2
        log = vectors((np.swapaxes(tip.rotation, -1, -2) @ self.tip_rotation).reshape(-1, 3, 3))
        log = log.reshape(self.count, self.size, 3)
        turn = self.tip_turn.copy()
        turn[..., ANGLES_AT[1]] -= self.back @ tip.angle_turns
        turn[..., POSES_AT[1]] -= self.back @ tip.body_turns
        self.residual[..., TURN_AT] = log / L
        inward = np.swapaxes(rods.rotation, -1, -2)
        self.columns[..., TURN_AT, :] = inverse_left_jacobian(-log) @ (inward @ turn) / L[..., None]

    def leave(
        self,
        free: NDArray[np.intp],
        loads: FloatArray,
        load_directions: FloatArray,
        following: FloatArray,
        following_directions: FloatArray,
    ) -> None:
        """(10) Of some rods, in their place: force, then moment on a tip that nothing holds.

        Args:
            free: Their numbers.
            loads: What acts there, in the world, shape (instance, k, 6).
            load_directions: How it changes along directions, shape (instance, k, 6, direction_count).
            following: (28) What acts there in the frame of the tip, as ``loads``.
            following_directions: How it changes, as ``load_directions``.
        """
        own = (self.rods.force, self.rods.moment)
        tip = self.rods.rotation[:, free]
        turned = self.spread(self.rods.pose_columns[..., 3:, :])[:, free]
        for k, (rows, unit) in enumerate(((GAP_AT, self.length / self.stiffness), (TURN_AT, 1 / self.stiffness))):
            part = slice(3 * k, 3 * k + 3)
            back = self.back[:, free]
            given = _times(back, loads[..., part])
            change = self.spread(self.rods.wrench_columns[..., part, :])[:, free]
            change[..., ANGLES_AT[0]] -= cross_matrix(given) @ self.by_angles[:, free]
            change[..., POSES_AT[0]] -= cross_matrix(given) @ self.by_pose[:, free]
            follows = _times(tip, following[..., part])
            change += cross_matrix(follows) @ turned
            by_directions = back @ load_directions[..., part, :] + tip @ following_directions[..., part, :]
            change[..., SIZE : SIZE + by_directions.shape[-1]] -= by_directions
            unit = np.broadcast_to(unit, (self.count, self.size, 1))[:, free]
            self.residual[:, free, rows] = unit * (own[k][:, free] - given - follows)
            self.columns[:, free, rows] = unit[..., None] * change

    def turn(self) -> None:
        """(9) Torques of the joints against their springs."""
        rods, (base, tip) = self.rods, self.ends
        if not any(table.count.any() for table in self.tables):
            return
        moment = _times(base.joints.rotation, rods.base_moment)
        by_all = base.joints.rotation @ self.spread(rods.base_columns[..., 3:, :])
        by_all[..., ANGLES_AT[0]] -= self.length[..., None] * (cross_matrix(moment) @ base.joints.turns)
        self._torques(0, moment, by_all, -1.0)
        inward = np.swapaxes(tip.frame, -1, -2)
        by_all = inward @ self.by_moment
        by_all[..., POSES_AT[1]] += inward @ cross_matrix(self.moment) @ tip.body_turns
        self._torques(1, _times(inward, self.moment), by_all, 1.0)

    def _torques(self, end: int, moment: FloatArray, by_all: FloatArray, sense: float) -> None:
        """(9) Of one end, by the moment there in the frame of its pose; ``sense`` is that of what a spring adds."""
        joints, table, rows = self.ends[end].joints, self.tables[end], TORQUES_AT[end]
        EI = self.stiffness
        spring = sense * table.stiffness
        torque = joints.torques(moment) + spring * (self.angles[end] - table.rest)
        columns = np.swapaxes(joints.axes, -1, -2) @ by_all
        by_angles = joints.torques_by_angles(moment) + spring[:, :, None] * np.eye(3)
        columns[..., ANGLES_AT[end]] += self.length[..., None] * by_angles
        if end == 0 and self.shared.any():  # (19) what the rod above turns the hole with is the other way
            torque, columns = np.where(self.shared, -torque, torque), np.where(self.shared[..., None], -columns, columns)
        self.residual[..., rows] = torque / EI
        self.columns[..., rows, :] = columns / EI[..., None]

    def balance(self, frames: Frames, holders: Sequence[NDArray[np.intp]]) -> None:
        """(11) What the rods pull and turn the bodies at their tips with, and push those at their bases."""
        rods, frame = self.rods, self.frame
        base_force, base_moment = _times(frame, rods.base_force), _times(frame, rods.base_moment)
        by_base_force = frame @ self._carried(rods.base_force, rods.base_columns[..., :3, :])
        by_base_moment = frame @ self._carried(rods.base_moment, rods.base_columns[..., 3:, :])
        wrenches = (
            (-base_force, -base_moment, -by_base_force, -by_base_moment),
            (self.force, self.moment, self.by_force, self.by_moment),
        )
        for end, (force, moment, by_force, by_moment) in enumerate(wrenches):
            holding, holder, at = self.ends[end], holders[end], BALANCES_AT[end]
            lever = cross_matrix(holding.arm)
            by_moment = by_moment + lever @ by_force
            by_moment[..., POSES_AT[end]] += cross_matrix(force) @ lever @ holding.body_turns
            inward = np.swapaxes(frames.axes, -1, -2)[:, holder]
            pull, twist = frames.pull[:, holder], frames.twist[:, holder]
            both = (pull * _times(inward, force), twist * _times(inward, moment + cross(holding.arm, force)))
            self.residual[..., at] = np.concatenate(both, axis=-1)
            by_both = (pull[..., None] * (inward @ by_force), twist[..., None] * (inward @ by_moment))
            self.columns[..., at, :] = np.concatenate(by_both, axis=-2)

    def tip_in_base(self) -> tuple[FloatArray, FloatArray]:
        """How the tips turn and how the force on them changes in the world, told in the axes of the bases, by the variables,
        then along directions, shapes (instance, rod, 3, SIZE + direction_count)."""
        force = self._carried(self.rods.force, self.rods.wrench_columns[..., :3, :])
        return self.tip_turn, force

    def tips(self) -> tuple[FloatArray, FloatArray]:
        """(6) Where the tips are in the world, and position and rotation vector by the variables, then along directions, shape
        (instance, rod, 6, SIZE + direction_count)."""
        base, rods = self.ends[0], self.rods
        move = self.frame @ self._carried(rods.position, rods.pose_columns[..., :3, :])
        move[..., POSES_AT[0]] += base.moves
        columns = np.concatenate([move, self.frame @ self.tip_turn], axis=-2)
        return base.position + _times(self.frame, rods.position), self.driven(columns)


def _times(matrices: FloatArray, vectors: FloatArray) -> FloatArray:
    return np.asarray((matrices @ vectors[..., None])[..., 0])
