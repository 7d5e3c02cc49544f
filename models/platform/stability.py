"""The second variation of the energy of a parallel robot: the condensed forms of its legs, joined by the platform.

Numbers in parentheses are those of ``docs/stability.md``.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from multirod.models.backbone.second_variation import CondensedForm, certain_determinant, symmetric_eigenvalues
from multirod.models.platform.platform_kernels import POSE, REVOLUTE, SPHERICAL
from multirod.rotations import cross, cross_matrix
from multirod.stability import Modes
from multirod.validation import FloatArray


@dataclass(frozen=True)
class HeldLeg:
    """A leg of a batch of robots, at its tip.

    Attributes:
        form: Condensed to the rotation of the tip, free angles, and the force on it.
        force: On the tip in the world [N], shape (batch, 3).
        moment: On the tip in the world [N m], shape (batch, 3).
        arm: From the platform's origin to the joint, in the world [m], shape (batch, 3).
        joint: Its kind.
        axis: Of a revolute joint, in the world, shape (batch, 3).
    """

    form: CondensedForm
    force: FloatArray
    moment: FloatArray
    arm: FloatArray
    joint: int
    axis: FloatArray


@dataclass(frozen=True)
class PlatformLoads:
    """What acts on a platform, in the world.

    Attributes:
        forces: Dead forces and where they act from the platform's origin, pairs of shape (batch, 3) [N], [m].
        follower_force: [N], shape (batch, 3); it acts where the first of ``forces`` does.
        follower_moment: [N m], shape (batch, 3).
    """

    forces: Sequence[tuple[FloatArray, FloatArray]]
    follower_force: FloatArray
    follower_moment: FloatArray


def platform_modes(
    legs: Sequence[HeldLeg], loads: PlatformLoads, length: FloatArray, stiffness: FloatArray, potential: NDArray[np.bool_]
) -> Modes:
    """(11) Modes of whole robots, counted in ``stiffness / length`` (batch,) [N m^2], [m]."""
    form, unit = _whole_form(legs, loads, length, stiffness)
    form *= unit[:, :, None] * unit[:, None, :] * (length / stiffness)[:, None, None]
    # each leg's position is held to the platform by three constraints
    hidden = np.sum([leg.form.conjugate for leg in legs], axis=0) - 3 * len(legs)
    known = np.all([leg.form.known for leg in legs], axis=0) & np.isfinite(form).all(axis=(1, 2))
    values, uncertainty = symmetric_eigenvalues(form, known & potential)
    # without a potential the form is not symmetric; its determinant still has the sign of the number of modes that grow
    diverging = known & ~potential
    if diverging.any():
        sign = np.sign(certain_determinant(form[diverging]))
        diverging[diverging] = sign * (-1.0) ** hidden[diverging] < 0
    return Modes(values, hidden.astype(np.int32), uncertainty, known & potential, diverging)


def _whole_form(
    legs: Sequence[HeldLeg], loads: PlatformLoads, length: FloatArray, stiffness: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """(9), (10) The form by what is free of each leg, then the pose of the platform, and the unit of each, (batch, count)."""
    count = len(length)
    own = [leg.form.matrix.shape[1] - (0 if leg.joint == SPHERICAL else 2 if leg.joint == REVOLUTE else 3) for leg in legs]
    size = sum(own) + POSE
    form, unit = np.zeros((count, size, size)), np.ones((count, size))
    position, rotation = slice(size - 6, size - 3), slice(size - 3, size)
    unit[:, position] = length[:, None]
    at = 0
    for leg, free in zip(legs, own, strict=True):
        variables = slice(at, at + free)
        force = slice(at + free - 3, at + free)
        unit[:, force] = (stiffness / length**2)[:, None]
        # the rotation of the tip, the free angles, and the force, by the variables of the robot
        r = leg.form.matrix.shape[1]
        tip = np.zeros((count, r, size))
        tip[:, range(3, r), range(at + free - (r - 3), at + free)] = 1.0
        if leg.joint == SPHERICAL:
            tip[:, range(3), range(at, at + 3)] = 1.0
        else:
            tip[:, range(3), range(size - 3, size)] = 1.0
        if leg.joint == REVOLUTE:
            tip[:, :3, at] = leg.axis
            form[:, at, rotation] += cross(leg.axis, leg.moment)  # the axis turns with the platform
        form += tip.swapaxes(1, 2) @ leg.form.matrix @ tip
        identity, arm = np.eye(3), cross_matrix(leg.arm)
        form[:, force, position] += identity
        form[:, position, force] += identity
        form[:, rotation, force] += arm
        form[:, force, rotation] -= arm
        form[:, rotation, rotation] += cross_matrix(leg.force) @ arm
        at = variables.stop
    for pull, arm in loads.forces:
        form[:, rotation, rotation] -= cross_matrix(pull) @ cross_matrix(arm)
    form[:, position, rotation] += cross_matrix(loads.follower_force)
    turned = loads.follower_moment + cross(loads.forces[0][1], loads.follower_force)
    form[:, rotation, rotation] += cross_matrix(turned)
    return form, unit
