"""What holds a rod at both ends, in numbers, and the inputs that it takes."""

from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, TypedDict

import numpy as np

from multirod.batch import IntArray, take
from multirod.inputs import InputSpec
from multirod.models.backbone.assembly import BackboneAssembly
from multirod.models.backbone.inputs import BACKBONE_INPUTS
from multirod.models.joint_kernels import REVOLUTE, SPHERICAL
from multirod.rod import RodArrays
from multirod.validation import FloatArray

if TYPE_CHECKING:
    from multirod.models.held.problem import HeldProblem

ROD_INPUTS = tuple(spec for spec in BACKBONE_INPUTS if spec.acts in ("base", "along"))  # what acts on the rod itself
TIP_LOADS = ("tip_force", "tip_moment")
POSE_INPUTS = ("end_position", "end_rotation")
POSE_SIZE = 3 * len(POSE_INPUTS)
_DESCRIPTIONS = {
    "tip_force": "dead force on the end, world frame; what holds the end takes it but along its slide",
    "tip_moment": "dead moment on the end, world frame; what holds the end takes it but where its joint turns",
}
TIP_SPECS = tuple(replace(spec, description=_DESCRIPTIONS[spec.name]) for spec in BACKBONE_INPUTS if spec.name in _DESCRIPTIONS)
END_INPUTS = (
    InputSpec(name="end_position", unit="m", acts="tip", description="how far what holds the end is moved, world frame"),
    InputSpec(
        name="end_rotation",
        unit="rad",
        acts="tip",
        description="rotation vector by which what holds the end is turned, world frame",
    ),
)


class HeldOptions(TypedDict, total=False):
    """How a ``HeldProblem`` is made, beside its holders, inputs and integrator."""

    device: str
    pose_sensitivities: bool
    direction_count: int
    lengths: bool
    design: Sequence[str]
    enabled: Sequence[str]


@dataclass(frozen=True)
class Holders:
    """What holds a rod at both ends, in numbers.

    Attributes:
        rod: The rod as a robot of its own, which has the base.
        end: Pose of the end's holder in the world where its inputs are zero, shape (..., 4, 4).
        joint: Kind of joint at the end.
        axis: Of a revolute one, in its holder's frame, unit length.
        slide: Direction in which the end slides, in its holder's frame, unit length; None if it does not.
        base_joint: Kind of joint at the base.
        base_axis: Of a revolute one, in the frame of the base, unit length.
        arrays: The rod as kernels read it.
        base: Pose of the base's holder in the world, shape (..., 4, 4).
    """

    rod: BackboneAssembly
    end: FloatArray
    joint: int
    axis: FloatArray
    slide: FloatArray | None
    base_joint: int
    base_axis: FloatArray
    arrays: RodArrays
    base: FloatArray

    @property
    def batch_shape(self) -> tuple[int, ...]:
        """Leading axes of all of it."""
        return np.broadcast_shapes(self.arrays.batch_shape, self.base.shape[:-2], self.end.shape[:-2])

    def take(self, batch_shape: tuple[int, ...], instances: IntArray) -> "Holders":
        """Those of some instances of a batch to whose leading axes this broadcasts, along one axis."""
        result = copy(self)
        taken = {
            "arrays": self.arrays.take(batch_shape, instances),
            **{
                name: take(value, batch_shape, instances, tail=2) if value.ndim > 2 else value
                for name, value in (("base", self.base), ("end", self.end))
            },
        }
        for name, value in taken.items():
            object.__setattr__(result, name, value)
        return result

    @property
    def guide(self) -> FloatArray:
        """Two directions across the one in which the end slides, then that one, in its holder's frame, as columns."""
        if self.slide is None:
            return np.eye(3)
        return np.concatenate([_across(self.slide), self.slide[:, None]], axis=1)

    @property
    def held_directions(self) -> FloatArray:
        """Directions in which the end does not slide, in its holder's frame, as columns."""
        return self.guide if self.slide is None else self.guide[:, :2]

    @property
    def base_axes(self) -> FloatArray:
        """About which the base turns, in its frame, one a row."""
        if self.base_joint == SPHERICAL:
            return np.eye(3)
        return self.base_axis[None] if self.base_joint == REVOLUTE else np.zeros((0, 3))

    @property
    def held_rotations(self) -> FloatArray:
        """About which the end does not turn, in its holder's frame, as columns."""
        if self.joint == SPHERICAL:
            return np.zeros((3, 0))
        return _across(self.axis) if self.joint == REVOLUTE else np.eye(3)


def load_scale(problem: "HeldProblem") -> FloatArray:
    """What acts on the rod, and how far its end is moved: a turn is a moment in ``EI/L``."""
    inputs, table, rod = problem.read("inputs"), problem.table, problem.rod
    own = np.delete(inputs, range(table.pose, table.pose + POSE_SIZE), axis=1)
    own[:, table.tip_loads : table.along] = 0.0
    rod.write("inputs", own)
    stiffness = rod.each(rod.arrays.material[:, 0, :, :3].min(axis=(1, 2)))
    total = rod.load_scale() + problem.turning_angle()
    moved = np.linalg.norm(problem.goal()[0] - table.rest_position.numpy(), axis=1)
    total += 12 * moved / problem.length
    for name, power in zip(TIP_LOADS, (2, 1), strict=True):
        total += np.linalg.norm(inputs[:, problem.input_slice(name)], axis=1) * problem.length**power / stiffness
    return np.asarray(total)


def _across(axis: FloatArray) -> FloatArray:
    """Two directions across one, as columns, that make a right-handed frame with it."""
    first = np.cross(axis, np.eye(3)[np.argmin(np.abs(axis))])
    first /= np.linalg.norm(first)
    return np.stack([first, np.cross(axis, first)], axis=1)
