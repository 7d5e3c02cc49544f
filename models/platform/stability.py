"""The second variation of the energy of a parallel robot: the condensed forms of its legs, joined by the platform.

Numbers in parentheses are those of ``docs/stability.md``.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from multirod.capabilities import ResultTest
from multirod.models.backbone.inputs import LOADS
from multirod.models.backbone.stability.second_variation import CondensedForm, certain_determinant, symmetric_eigenvalues
from multirod.models.joint_kernels import REVOLUTE, SPHERICAL
from multirod.models.platform.platform_kernels import POSE
from multirod.rotations import cross, cross_matrix
from multirod.stability import Modes, StabilityAnalysis
from multirod.status import Status
from multirod.validation import FloatArray

if TYPE_CHECKING:
    from multirod.models.platform.problem import ParallelProblem


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


class PlatformStability(StabilityAnalysis):
    """Of a ``ParallelProblem``: with several legs there are several equilibria, and the one that beams lead to may be
    unstable."""

    def __init__(self, problem: "ParallelProblem") -> None:
        self.problem = problem

    def modes(self) -> Modes:  # noqa: D102
        self.problem.to_legs()
        rotation = self.problem.pose()[1]
        count, legs = self.problem.instance_count, len(self.problem.geometry.legs)
        at = self.problem.attachments()
        arms = np.einsum("bij,blj->bli", rotation, at.arm)
        axes = np.einsum("bij,bljk,lk->bli", rotation, at.frame, at.axes)
        held: list[HeldLeg | None] = [None] * legs
        for group in self.problem.groups:
            form, _ = group.backbones.stability.condensed_form()
            form.known[~group.backbones.lines.stays_stiff()] = False
            wrench = group.backbones.tip_wrench.numpy().reshape(count, -1, 6)
            for place, leg in enumerate(group.members):
                own = CondensedForm(*(v.reshape(count, -1, *v.shape[1:])[:, place] for v in vars(form).values()))
                force, moment = wrench[:, place, :3], wrench[:, place, 3:]
                held[leg] = HeldLeg(own, force, moment, arms[:, leg], int(at.joints[leg]), axes[:, leg])
        length, stiffness = self._scale()
        return platform_modes(
            [leg for leg in held if leg is not None], self._loads(rotation), length, stiffness, self.has_potential
        )

    @property
    def has_potential(self) -> NDArray[np.bool_]:
        """Whether the loads derive from one, shape (instance_count,)."""
        inputs = self.problem.read("inputs")
        without = [spec.name for spec in LOADS if spec.acts == "tip" and not spec.potential]
        result = ~np.column_stack([inputs[:, self.problem.input_slice(name)] for name in without]).any(axis=1)
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
