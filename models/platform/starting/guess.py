"""Where the search for the equilibrium of a parallel robot begins: its legs as beams that bend little.

Equation numbers are those of ``docs/parallel.md``.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
import warp as wp
from numpy.typing import NDArray

from multirod.kernels.shared import Shared
from multirod.launch import record
from multirod.models.backbone.problem import BackboneProblem
from multirod.models.joint_kernels import REVOLUTE, SPHERICAL
from multirod.models.platform.buffers import batched
from multirod.models.platform.starting.beam_kernels import (
    ARM_AT,
    BEAM_SIZE,
    FRAME_AT,
    LENGTH_AT,
    STIFFNESS_AT,
    TANGENT_AT,
    TIP_AT,
    settle_beams,
)
from multirod.rotations import cross, vectors
from multirod.validation import FloatArray

if TYPE_CHECKING:
    from multirod.models.platform.problem import ParallelProblem

# In L^3/EI, added to the tips of beams in all directions: one that is straight and inextensible gives way along itself by
# bending, once it has bent, and how much depends on how far it has to.
COMPLIANCES = (1e-4, 1e-3, 1e-2, 1e-1)
SHORT = 0.1  # of the unknowns of a guess: where Newton's step from there is no longer, no other is looked at
POSE_SIZE = 12  # numbers of a position and a rotation


@dataclass(frozen=True)
class Legs:
    """Legs without load, and how they answer one; axes (instance, leg, ...), vectors in the world.

    Attributes:
        position: Of the tips [m], shape (..., 3).
        rotation: Of the tips, shape (..., 3, 3).
        flexibility: Displacement and rotation of a tip by force and moment on it, shape (..., 6, 6).
        unknowns_by_wrench: For each leg, (instance, unknown, 6).
        length: [m], shape (...).
        stiffness: Bending stiffness [N m^2], shape (...).
    """

    position: FloatArray
    rotation: FloatArray
    flexibility: FloatArray
    unknowns_by_wrench: list[FloatArray]
    length: FloatArray
    stiffness: FloatArray

    def softened(self, compliances: Sequence[float]) -> "Legs":
        """The same legs with a compliance in L^3/EI added to their tips, in all directions, which twist by no less than it in
        L/EI: all instances for each of several."""
        many = self.repeated(len(compliances))
        added = np.repeat(np.array(compliances), len(self.length))[:, None]
        extra = (added * many.length**3 / many.stiffness)[..., None, None] * np.diag([1.0, 1, 1, 0, 0, 0])
        t = many.rotation[..., :, 2]
        twist = np.einsum("bli,blij,blj->bl", t, many.flexibility[..., 3:, 3:], t)
        rigid = np.maximum(added * many.length / many.stiffness - twist, 0.0)
        extra[..., 3:, 3:] = rigid[..., None, None] * t[..., :, None] * t[..., None, :]
        return replace(many, flexibility=many.flexibility + extra)

    def repeated(self, count: int) -> "Legs":
        """All instances, so many times."""
        if count == 1:
            return self
        by_wrench = [_repeated(values, count) for values in self.unknowns_by_wrench]
        values = {name: _repeated(v, count) for name, v in vars(self).items() if name != "unknowns_by_wrench"}
        return Legs(**values, unknowns_by_wrench=by_wrench)


@dataclass(frozen=True)
class Attachments:
    """Where the tips are to be joined to the platform.

    Attributes:
        arm: In the platform's frame [m], shape (instance, leg, 3).
        frame: Orientation in the platform's frame, shape (instance, leg, 3, 3).
        joints: Kinds, shape (leg,).
        axes: Of revolute joints, in the attachment's frame, shape (leg, 3).
    """

    arm: FloatArray
    frame: FloatArray
    joints: NDArray[np.int32]
    axes: FloatArray

    def repeated(self, count: int) -> "Attachments":
        """All instances, so many times."""
        return replace(self, arm=_repeated(self.arm, count), frame=_repeated(self.frame, count))


def tip_answers(own: BackboneProblem, shape: tuple[int, ...]) -> tuple[FloatArray, FloatArray]:
    """How rods that were integrated, (instance, leg), answer force and moment on their tips, while the torques of their tubes and
    what drives their lines stay: changes of the unknowns, shape (*shape, m, 6), and of the tips' poses, (*shape, 6, 6).
    """
    m = own.unknown_count
    torques = own.read("gamma").reshape(*shape, m, m)[:, :, 6:]
    loads = np.concatenate([own.wrench_columns.numpy().reshape(*shape, 6, -1)[..., :m], torques], axis=2)
    unknowns = np.linalg.solve(loads, np.broadcast_to(np.eye(m, 6), (*shape, m, 6)))
    return unknowns, own.pose_columns.numpy().reshape(*shape, 6, -1)[..., :m] @ unknowns


def _repeated(values: FloatArray, count: int) -> FloatArray:
    return np.concatenate([values] * count)


def fitted_platform(legs: Legs, at: Attachments) -> tuple[FloatArray, FloatArray]:
    """Position (instance, 3) and rotation (instance, 3, 3) that fit the tips best, in the sense of least squares."""
    return fitted_pose(legs.position, legs.rotation, at.arm, at.frame, at.joints != SPHERICAL)


def fitted_pose(
    positions: FloatArray, rotations: FloatArray, arm: FloatArray, frame: FloatArray, framed: NDArray[np.bool_]
) -> tuple[FloatArray, FloatArray]:
    """Position (instance, 3) and rotation (instance, 3, 3) of what has points ``arm`` and frames ``frame`` on it, (instance, k,
    ...), that bring these nearest to ``positions`` and ``rotations``; only some are to be ``framed``, (k,)."""
    centre, middle = positions.mean(axis=1), arm.mean(axis=1)
    arms = arm - middle[:, None]
    size = np.maximum((arms**2).sum(axis=(1, 2)), 1e-300)[:, None, None]
    fit = np.einsum("bli,blj->bij", positions - centre[:, None], arms) / size
    fit += np.einsum("l,blij,blkj->bik", framed, rotations, frame) / len(framed)
    rotation = nearest_rotation(fit)
    return centre - np.einsum("bij,bj->bi", rotation, middle), rotation


class BeamEquilibrium:
    """(11) The unloaded platform, where the energy of its beams is least.

    Args:
        count: Of instances.
        legs: Of each.
    """

    def __init__(self, count: int, legs: int) -> None:
        self._beams, self._poses = (Shared(shape, wp.float64, "cpu") for shape in ((count, legs, BEAM_SIZE), (count, POSE_SIZE)))
        self._launch = record(settle_beams, count, [self._beams.array, self._poses.array], "cpu")

    def found(
        self, legs: Legs, at: Attachments, position: FloatArray, rotation: FloatArray
    ) -> tuple[FloatArray, FloatArray, list[FloatArray]]:
        """From the pose given, by Newton's method.

        Returns:
            Position and rotation of the platform, and for each leg what to add to its unloaded unknowns.
        """
        stiffness, setting, rows, poses = _joint_stiffness(legs, at), _Setting(legs, at), self._beams.values, self._poses.values
        for first, values in (
            (TIP_AT, setting.tip),
            (TANGENT_AT, setting.tangent),
            (ARM_AT, setting.arm),
            (FRAME_AT, setting.frame.reshape(*rows.shape[:2], 9)),
            (LENGTH_AT, setting.length),
            (STIFFNESS_AT, stiffness.reshape(*rows.shape[:2], 36)),
        ):
            rows[..., first : first + values.shape[-1]] = values
        poses[:, :3], poses[:, 3:] = position, rotation.reshape(-1, 9)
        self._launch.launch()
        position, rotation = poses[:, :3].copy(), poses[:, 3:].reshape(-1, 3, 3).copy()
        return position, rotation, _unknowns(legs, _Beams(setting, position, rotation), stiffness)


def beam_reach(legs: Legs, at: Attachments, position: FloatArray, rotation: FloatArray) -> tuple[FloatArray, list[FloatArray]]:
    """(11) The inverse problem: the platform is where it is, and no leg is pushed along itself.

    Returns:
        How far each leg is to be pushed out [m], shape (instance, leg), and what to add to its unloaded unknowns.
    """
    beams = _Beams(_Setting(legs, at), position, rotation)
    reach = np.einsum("bli,bli->bl", beams.strain[..., :3], beams.tangent)
    beams.strain[..., :3] -= reach[..., None] * beams.tangent
    return reach, _unknowns(legs, beams, _joint_stiffness(legs, at))


def beam_unknowns(legs: Legs, at: Attachments, position: FloatArray, rotation: FloatArray) -> list[FloatArray]:
    """(11) For each leg, what to add to its unloaded unknowns so that it reaches a platform at a given pose."""
    return _unknowns(legs, _Beams(_Setting(legs, at), position, rotation), _joint_stiffness(legs, at))


class _Setting:
    """What beams are at whatever pose of the platform."""

    def __init__(self, legs: Legs, at: Attachments) -> None:
        self.tip, self.arm = legs.position, at.arm
        self.tangent = legs.rotation[..., :, 2]
        self.frame = at.frame @ np.swapaxes(legs.rotation, -1, -2)
        self.length = legs.length[..., None]


class _Beams:
    """(11) Deflection of all beams at one pose of the platform."""

    def __init__(self, at: _Setting, position: FloatArray, rotation: FloatArray) -> None:
        arm = (rotation[:, None] @ at.arm[..., None])[..., 0]
        self.tangent = t = at.tangent
        self.deflection = d = position[:, None] + arm - at.tip
        turn = rotation_vectors(rotation[:, None] @ at.frame)
        slope = cross(turn, t)
        across = d - (d * t).sum(-1, keepdims=True) * t
        L = at.length
        self.by_across = 1.2 / L * across - 0.1 * slope
        by_slope = (2 / 15) * L * slope - 0.1 * across
        self.by_turn = cross(t, by_slope)
        # half the integral of the squared slope of the cubic with this end deflection and end slope
        shortening = 0.5 * (across * self.by_across + slope * by_slope).sum(-1, keepdims=True)
        self.strain = np.concatenate([d + shortening * t, turn], axis=-1)

    def by_tip(self) -> FloatArray:
        """The strain by displacement and rotation of the tip, shape (..., 6, 6)."""
        result = np.zeros((*self.deflection.shape[:-1], 6, 6))
        result[..., range(6), range(6)] = 1.0
        t = self.tangent[..., :, None]
        result[..., :3, :3] += t * self.by_across[..., None, :]
        result[..., :3, 3:] = t * self.by_turn[..., None, :]
        return result


def _joint_stiffness(legs: Legs, at: Attachments) -> FloatArray:
    """Wrench on a tip by its displacement and rotation, none where its joint is free, shape (instance, leg, 6, 6)."""
    flexibility = legs.flexibility
    result = np.zeros_like(flexibility)
    for k, joint in enumerate(at.joints):
        held = np.broadcast_to(np.eye(6), flexibility[:, k].shape)
        if joint == SPHERICAL:
            held = held[:, :3]
        if joint == REVOLUTE:
            axis = np.einsum("bij,j->bi", legs.rotation[:, k], at.axes[k])
            across = np.linalg.svd(axis[:, None, :])[2][:, 1:]
            held = np.concatenate([held[:, :3], np.concatenate([np.zeros_like(across), across], axis=2)], axis=1)
        free = np.swapaxes(held, 1, 2)
        result[:, k] = free @ np.linalg.inv(held @ flexibility[:, k] @ free) @ held
    return result


def _unknowns(legs: Legs, beams: _Beams, stiffness: FloatArray) -> list[FloatArray]:
    """What to add to the unloaded unknowns of each leg, from the wrench on its deflected tip."""
    by_tip = np.swapaxes(beams.by_tip(), -1, -2)
    wrench = (by_tip @ (stiffness @ beams.strain[..., None]))[..., 0]
    lever = cross(beams.deflection, wrench[..., :3])
    # a beam's torque is the same all along, whatever the deflection
    wrench[..., 3:] += lever - (lever * beams.tangent).sum(-1, keepdims=True) * beams.tangent
    return [np.einsum("bij,bj->bi", by_wrench, wrench[:, k]) for k, by_wrench in enumerate(legs.unknowns_by_wrench)]


def nearest_rotation(matrices: FloatArray) -> FloatArray:
    """Rotations (..., 3, 3) nearest to matrices, by their singular vectors."""
    U, _, V = np.linalg.svd(matrices)
    U[..., :, 2] *= np.sign(np.linalg.det(U @ V))[..., None]
    return np.asarray(U @ V)


def rotation_vectors(rotations: FloatArray) -> FloatArray:
    """Rotation vectors (..., 3) of rotations (..., 3, 3)."""
    return np.asarray(vectors(rotations.reshape(-1, 3, 3)).reshape(rotations.shape[:-1]))


def straight_legs(problem: "ParallelProblem") -> FloatArray:
    """(10b) Of the inverse problem: unknowns by which each leg is as long as straight from base to attachment [1/m], shape
    (instance_count, leg)."""
    geometry, (position, rotation) = problem.geometry, problem.pose()
    legs, length = len(geometry.legs), problem.length[:, :-1]
    base, attached = (batched(problem, poses, (legs, 4, 4))[:, :, :3, 3] for poses in (geometry.base, geometry.platform))
    ends = position[:, None] + (rotation[:, None] @ attached[..., None])[..., 0]
    given = problem.read("inputs")[:, problem.input_slice("translation")]
    return np.asarray((np.linalg.norm(ends - base, axis=-1) - length - given) / length**2)
