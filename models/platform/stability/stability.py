"""The second variation of the energy of a parallel robot: the condensed forms of its legs, joined by the platform.

Numbers in parentheses are those of ``docs/stability.md``.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from multirod.capabilities import Loading, ResultTest
from multirod.models.backbone.inputs import LOADS
from multirod.models.backbone.stability.condensing.second_variation import certain_determinant, symmetric_eigenvalues
from multirod.models.joint_kernels import REVOLUTE, SPHERICAL
from multirod.models.platform.platform_kernels import POSE
from multirod.rotations import cross, cross_matrix
from multirod.stability import Modes, StabilityAnalysis
from multirod.status import Status
from multirod.validation import FloatArray

if TYPE_CHECKING:
    from multirod.models.platform.problem import ParallelProblem


@dataclass(frozen=True)
class HeldLegs:
    """The legs of a batch of robots, at their tips.

    Attributes:
        forms: Of each leg, condensed to the rotation of the tip, free angles, and the force on it, shapes (batch, r, r).
        conjugate: Negative eigenvalues of what was eliminated in each, shape (batch, leg).
        known: Whether rounding leaves all signs, shape (batch,).
        force: On the tips in the world [N], shape (batch, leg, 3).
        moment: On the tips in the world [N m], shape (batch, leg, 3).
        arm: From the platform's origin to the joints, in the world [m], shape (batch, leg, 3).
        joints: Their kinds.
        axis: Of revolute joints, in the world, shape (batch, leg, 3).
    """

    forms: Sequence[FloatArray]
    conjugate: NDArray[np.int_]
    known: NDArray[np.bool_]
    force: FloatArray
    moment: FloatArray
    arm: FloatArray
    joints: tuple[int, ...]
    axis: FloatArray


@dataclass(frozen=True)
class FormPlaces:
    """Where the variables of the legs stand in the form of a robot, those of the platform last.

    Attributes:
        size: Of the form.
        tips: Of each leg, those of its own form, the three of its tip's rotation first: the platform's but for a spherical joint.
        alpha: Of each leg, the angle about the axis of a revolute joint, -1 of others.
        forces: On the tips, shape (leg, 3).
    """

    size: int
    tips: tuple[NDArray[np.intp], ...]
    alpha: tuple[int, ...]
    forces: NDArray[np.intp]

    @classmethod
    @cache
    def of(cls, sizes: tuple[int, ...], joints: tuple[int, ...]) -> "FormPlaces":
        """Of legs whose forms have these sizes."""
        own = [r - (0 if joint == SPHERICAL else 2 if joint == REVOLUTE else 3) for r, joint in zip(sizes, joints, strict=True)]
        size, at = sum(own) + POSE, 0
        tips, alpha, forces = [], [], []
        for r, joint, free in zip(sizes, joints, own, strict=True):
            rotation = range(at, at + 3) if joint == SPHERICAL else range(size - 3, size)
            tips.append(np.array([*rotation, *range(at + free - (r - 3), at + free)]))
            alpha.append(at if joint == REVOLUTE else -1)
            at += free
            forces.append(range(at - 3, at))
        return cls(size, tuple(tips), tuple(alpha), np.array(forces))


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
    legs: HeldLegs, loads: PlatformLoads, length: FloatArray, stiffness: FloatArray, potential: NDArray[np.bool_]
) -> Modes:
    """(11) Modes of whole robots, counted in ``stiffness / length`` (batch,) [N m^2], [m]."""
    form, unit = _whole_form(legs, loads, length, stiffness)
    form *= unit[:, :, None] * unit[:, None, :] * (length / stiffness)[:, None, None]
    # each leg's position is held to the platform by three constraints
    hidden = legs.conjugate.sum(axis=1) - 3 * len(legs.forms)
    known = legs.known & np.isfinite(form).all(axis=(1, 2))
    told = symmetric_eigenvalues(form, known & potential, _firm(legs, form.shape[1]))
    # without a potential the form is not symmetric; its determinant still has the sign of the number of modes that grow
    diverging = known & ~potential
    if diverging.any():
        sign = np.sign(certain_determinant(form[diverging]))
        diverging[diverging] = sign * (-1.0) ** hidden[diverging] < 0
    return told.modes(hidden.astype(np.int32), known & potential, diverging)


def _places(legs: HeldLegs) -> FormPlaces:
    return FormPlaces.of(tuple(own.shape[1] for own in legs.forms), legs.joints)


def _firm(legs: HeldLegs, size: int) -> NDArray[np.bool_]:
    """(27) Which variables of robots are forces on legs that are stable by themselves, shape (batch, size)."""
    result = np.zeros((len(legs.conjugate), size), dtype=bool)
    result[:, _places(legs).forces] = (legs.conjugate == 0)[..., None]
    return result


def _whole_form(legs: HeldLegs, loads: PlatformLoads, length: FloatArray, stiffness: FloatArray) -> tuple[FloatArray, FloatArray]:
    """(9), (10) The form by what is free of each leg, then the pose of the platform, and the unit of each, (batch, count)."""
    count = len(length)
    places = _places(legs)
    size, forces = places.size, places.forces.reshape(-1)
    form, unit = np.zeros((count, size, size)), np.ones((count, size))
    position, rotation = slice(size - 6, size - 3), slice(size - 3, size)
    unit[:, position] = length[:, None]
    unit[:, forces] = (stiffness / length**2)[:, None]
    arms = cross_matrix(legs.arm)
    turned = cross_matrix(legs.force) @ arms
    for k, (own, at, alpha) in enumerate(zip(legs.forms, places.tips, places.alpha, strict=True)):
        form[:, at[:, None], at] += own
        if alpha >= 0:
            axis = legs.axis[:, k]
            by_angle = (own[:, :, :3] @ axis[:, :, None])[..., 0]
            form[:, at, alpha] += by_angle
            form[:, alpha, at] += (axis[:, None] @ own[:, :3])[:, 0]
            form[:, alpha, alpha] += (axis * by_angle[:, :3]).sum(axis=1)
            form[:, alpha, rotation] += cross(axis, legs.moment[:, k])  # the axis turns with the platform
        form[:, rotation, rotation] += turned[:, k]
    identity = np.tile(np.eye(3), (len(places.forces), 1))
    form[:, forces, position] += identity
    form[:, position, forces] += identity.T
    form[:, rotation, forces] += arms.swapaxes(1, 2).reshape(count, 3, -1)
    form[:, forces, rotation] -= arms.reshape(count, -1, 3)
    for pull, arm in loads.forces:
        form[:, rotation, rotation] -= cross_matrix(pull) @ cross_matrix(arm)
    form[:, position, rotation] += cross_matrix(loads.follower_force)
    form[:, rotation, rotation] += cross_matrix(loads.follower_moment + cross(loads.forces[0][1], loads.follower_force))
    return form, unit


class PlatformStability(StabilityAnalysis):
    """Of a ``ParallelProblem``: with several legs there are several equilibria, and the one that beams lead to may be
    unstable."""

    def __init__(self, problem: "ParallelProblem") -> None:
        self.problem = problem

    def expect(self) -> None:  # noqa: D102
        for group in self.problem.groups:
            group.backbones.stability.expect()

    def modes(self) -> Modes:  # noqa: D102
        self.problem.to_legs()
        rotation = self.problem.pose()[1]
        count, legs = self.problem.instance_count, len(self.problem.geometry.legs)
        at = self.problem.attachments()
        arms = np.einsum("bij,blj->bli", rotation, at.arm)
        axes = np.einsum("bij,bljk,lk->bli", rotation, at.frame, at.axes)
        forms: list[FloatArray] = [np.zeros(0)] * legs
        conjugate, known = np.zeros((count, legs), dtype=int), np.ones(count, dtype=bool)
        wrenches = np.zeros((count, legs, 6))
        for group in self.problem.groups:
            form, _ = group.backbones.stability.condensed_form()
            known &= (form.known & group.backbones.lines.stays_stiff()).reshape(count, -1).all(axis=1)
            conjugate[:, group.members] = form.conjugate.reshape(count, -1)
            wrenches[:, group.members] = group.backbones.tip_wrench.numpy().reshape(count, -1, 6)
            own = form.matrix.reshape(count, -1, *form.matrix.shape[1:])
            for place, leg in enumerate(group.members):
                forms[leg] = own[:, place]
        held = HeldLegs(forms, conjugate, known, wrenches[..., :3], wrenches[..., 3:], arms, tuple(at.joints.tolist()), axes)
        return platform_modes(held, self._loads(rotation), *self._scale(), self.has_potential)

    @property
    def has_potential(self) -> NDArray[np.bool_]:
        """Whether the loads that act derive from one, shape (instance_count,)."""
        inputs = self.problem.read("inputs")
        without = [spec.name for spec in LOADS if spec.acts == "tip" and not spec.potential]
        result = ~np.column_stack([inputs[:, self.problem.input_slice(name)] for name in without]).any(axis=1)
        result |= self.problem.closing.aside["loading"].fetched() == Loading.NONE
        for group in self.problem.groups:
            result &= group.backbones.stability.has_potential.reshape(self.problem.instance_count, -1).all(axis=1)
        return np.asarray(result)

    def potential(self) -> FloatArray:
        """Elastic energy less the work of dead forces [J]: on the legs from their bases, on the platform from where its pose is
        zero."""
        self.problem.to_legs()
        position, rotation = self.problem.pose()
        total = np.zeros(self.problem.instance_count)
        for group in self.problem.groups:
            for part in group.backbones.shapes.stored_and_lost():
                total += part.reshape(self.problem.instance_count, -1).sum(axis=1)
        origin, start = self.problem.reference
        for (force, arm), local in zip(
            self._loads(rotation).forces, self._loads(np.broadcast_to(start, rotation.shape)).forces, strict=True
        ):
            total -= (force * (position + arm - origin - local[1])).sum(axis=1)
        return np.where(self.has_potential, total, np.nan)

    @property
    def multistable(self) -> bool:  # noqa: D102
        return not self.problem.inverse

    @property
    def guess_is_stable(self) -> bool:  # noqa: D102
        return self.problem.inverse  # where every result is tested, whatever it began at

    def _scale(self) -> tuple[FloatArray, FloatArray]:
        """Mean length [m] and bending stiffness [N m^2] of the legs, shape (instance_count,)."""
        length, stiffness = (
            np.broadcast_to(v[:, -1], self.problem.instance_count) for v in (self.problem.length, self.problem.stiffness)
        )
        return length, stiffness / len(self.problem.geometry.legs)

    def _loads(self, rotation: FloatArray) -> PlatformLoads:
        inputs, level = self.problem.read("inputs"), self.problem.load_level()[:, None]
        force, follower, moment, point = (
            inputs[:, self.problem.input_slice(name)]
            for name in ("tip_force", "follower_force", "follower_moment", "force_point")
        )
        force, follower, moment = level * force, level * follower, level * moment
        weight = level * self.problem.geometry.mass * inputs[:, self.problem.input_slice("gravity")]
        follower, moment, point = (np.einsum("bij,bj->bi", rotation, v) for v in (follower, moment, point))
        return PlatformLoads([(force, point), (weight, rotation @ self.problem.geometry.mass_centre)], follower, moment)


class InverseTest(ResultTest):
    """Of the inverse problem: with the platform held, no mode of ``Gamma`` vanishes where the robot loses stability."""

    integrations = 1

    def __init__(self, problem: "ParallelProblem") -> None:
        self.problem = problem

    def refusals(self, settled: NDArray[np.bool_]) -> NDArray[np.int32]:  # noqa: D102
        result = np.zeros(self.problem.instance_count, dtype=np.int32)
        if settled.any():
            result[settled & (self.problem.stability.unstable())] = Status.UNSTABLE
        length = self.problem.length[:, :-1]
        translation = (
            self.problem.read("inputs")[:, self.problem.input_slice("translation")]
            + length**2 * self.problem.read("unknowns")[:, self.problem.platform]
        )
        low, high = self.problem.limits
        outside = (translation < low) | (translation > high) | (length + translation <= 0)
        result[outside.any(axis=1)] = Status.OUT_OF_LIMITS
        return result
