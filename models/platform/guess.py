"""Where the search for the equilibrium of a parallel robot begins: its legs as beams that bend little.

Equation numbers are those of ``docs/parallel.md``.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from multirod.models.platform.platform_kernels import REVOLUTE, SPHERICAL
from multirod.rotations import matrices, vectors
from multirod.validation import FloatArray

# In L^3/EI, added to the tips of beams in all directions: one that is straight and inextensible gives way along itself by
# bending, once it has bent, and how much depends on how far it has to.
COMPLIANCES = (1e-4, 1e-3, 1e-2, 1e-1)
ITERATIONS = 8  # 4 are enough for the tip to move by less than 1 % of what the beams are off


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

    def softened(self, compliance: float) -> "Legs":
        """The same legs with a compliance in L^3/EI added to their tips, in all directions."""
        extra = (compliance * self.length**3 / self.stiffness)[..., None, None] * np.diag([1.0, 1, 1, 0, 0, 0])
        return replace(self, flexibility=self.flexibility + extra)


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


def fitted_platform(legs: Legs, at: Attachments) -> tuple[FloatArray, FloatArray]:
    """Position (instance, 3) and rotation (instance, 3, 3) that fit the tips best, in the sense of least squares."""
    centre, middle = legs.position.mean(axis=1), at.arm.mean(axis=1)
    spread = at.arm - middle[:, None]
    size = np.maximum((spread**2).sum(axis=(1, 2)), 1e-300)[:, None, None]
    fit = np.einsum("bli,blj->bij", legs.position - centre[:, None], spread) / size
    fit += np.einsum("l,blij,blkj->bik", at.joints != SPHERICAL, legs.rotation, at.frame) / len(at.joints)
    rotation = nearest_rotation(fit)
    return centre - np.einsum("bij,bj->bi", rotation, middle), rotation


def beam_equilibrium(
    legs: Legs, at: Attachments, position: FloatArray, rotation: FloatArray
) -> tuple[FloatArray, FloatArray, list[FloatArray]]:
    """(11) The unloaded platform, where the energy of the beams is least, from the pose given by Newton's method.

    Returns:
        Position and rotation of the platform, and for each leg what to add to its unloaded unknowns.
    """
    stiffness = _joint_stiffness(legs, at)
    size = legs.length.mean(axis=1)[:, None]
    for _ in range(ITERATIONS):
        beams = _Beams(legs, at, position, rotation)
        slope = beams.by_tip @ beams.tip_by_platform
        wrench = np.einsum("blij,blj->bli", stiffness, beams.strain)
        gradient = np.einsum("blji,blj->bi", slope, wrench)
        hessian = (np.swapaxes(slope, -1, -2) @ stiffness @ slope).sum(axis=1)
        step = -np.linalg.solve(hessian, gradient[..., None])[..., 0]
        step /= np.maximum(1.0, np.abs(step / np.concatenate([0.1 * size] * 3 + [0.3 * np.ones_like(size)] * 3, 1)).max(1))[
            :, None
        ]
        position = position + step[:, :3]
        rotation = matrices(step[:, 3:]) @ rotation
    return position, rotation, _unknowns(legs, _Beams(legs, at, position, rotation), stiffness)


def beam_reach(legs: Legs, at: Attachments, position: FloatArray, rotation: FloatArray) -> tuple[FloatArray, list[FloatArray]]:
    """(11) The inverse problem: the platform is where it is, and no leg is pushed along itself.

    Returns:
        How far each leg is to be pushed out [m], shape (instance, leg), and what to add to its unloaded unknowns.
    """
    beams = _Beams(legs, at, position, rotation)
    reach = np.einsum("bli,bli->bl", beams.strain[..., :3], beams.tangent)
    beams.strain[..., :3] -= reach[..., None] * beams.tangent
    return reach, _unknowns(legs, beams, _joint_stiffness(legs, at))


def beam_unknowns(legs: Legs, at: Attachments, position: FloatArray, rotation: FloatArray) -> list[FloatArray]:
    """(11) For each leg, what to add to its unloaded unknowns so that it reaches a platform at a given pose."""
    return _unknowns(legs, _Beams(legs, at, position, rotation), _joint_stiffness(legs, at))


class _Beams:
    """(11) Deflection of all beams at one pose of the platform."""

    def __init__(self, legs: Legs, at: Attachments, position: FloatArray, rotation: FloatArray) -> None:
        arm = np.einsum("bij,blj->bli", rotation, at.arm)
        self.tangent = t = legs.rotation[..., :, 2]
        self.deflection = d = position[:, None] + arm - legs.position
        turned = rotation[:, None] @ at.frame @ np.swapaxes(legs.rotation, -1, -2)
        turn = rotation_vectors(turned)
        slope = np.cross(turn, t)
        across = d - (d * t).sum(-1, keepdims=True) * t
        L = legs.length[..., None]
        # half the integral of the squared slope of the cubic with this end deflection and end slope
        shortening = (0.6 * across**2 / L - 0.1 * across * slope + L / 15 * slope**2).sum(-1, keepdims=True)
        self.strain = np.concatenate([d + shortening * t, turn], axis=-1)
        by_across = 1.2 * across / L - 0.1 * slope
        by_turn = np.cross(t, 2 * L / 15 * slope - 0.1 * across)
        self.by_tip = np.broadcast_to(np.eye(6), (*d.shape[:-1], 6, 6)).copy()
        self.by_tip[..., :3, :3] += t[..., :, None] * by_across[..., None, :]
        self.by_tip[..., :3, 3:] += t[..., :, None] * by_turn[..., None, :]
        self.tip_by_platform = np.broadcast_to(np.eye(6), self.by_tip.shape).copy()
        self.tip_by_platform[..., :3, 3:] = -cross_matrix(arm)


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
    by_tip = np.swapaxes(beams.by_tip, -1, -2)
    wrench = (by_tip @ (stiffness @ beams.strain[..., None]))[..., 0]
    lever = np.cross(beams.deflection, wrench[..., :3])
    # a beam's torque is the same all along, whatever the deflection
    wrench[..., 3:] += lever - (lever * beams.tangent).sum(-1, keepdims=True) * beams.tangent
    return [np.einsum("bij,bj->bi", by_wrench, wrench[:, k]) for k, by_wrench in enumerate(legs.unknowns_by_wrench)]


def cross_matrix(a: FloatArray) -> FloatArray:
    """``[a]x``, shape (..., 3, 3)."""
    return np.asarray(np.cross(np.eye(3), a[..., None, :]))


def nearest_rotation(matrices: FloatArray) -> FloatArray:
    """Rotations (..., 3, 3) nearest to matrices, by their singular vectors."""
    U, _, V = np.linalg.svd(matrices)
    U[..., :, 2] *= np.sign(np.linalg.det(U @ V))[..., None]
    return np.asarray(U @ V)


def rotation_vectors(rotations: FloatArray) -> FloatArray:
    """Rotation vectors (..., 3) of rotations (..., 3, 3)."""
    return np.asarray(vectors(rotations.reshape(-1, 3, 3)).reshape(rotations.shape[:-1]))
