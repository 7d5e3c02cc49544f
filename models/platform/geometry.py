"""Legs, joints and platform of a parallel robot, in numbers."""

from collections.abc import Sequence
from copy import copy

import numpy as np
from numpy.typing import NDArray

from multirod.batch import IntArray, take
from multirod.models.backbone.assembly import BackboneAssembly
from multirod.models.backbone.kernels.layout.members import drives as drive_names
from multirod.models.platform.starting.guess import nearest_rotation
from multirod.rod import RodArrays
from multirod.validation import FloatArray, frozen


class Geometry:
    """Legs, joints and platform of a robot, in numbers.

    Attributes:
        legs: Each leg as a robot of its own.
        arrays: Their rods as kernels read them.
        base: Pose of each leg's base in the world, shape (..., leg_count, 4, 4).
        platform: Pose of each leg's attachment in the platform's frame, shape (..., leg_count, 4, 4).
        joints: Kind of each joint, shape (leg_count,).
        axes: Axis of each joint in the attachment's frame, unit length, shape (leg_count, 3).
        mass: Of the platform [kg].
        mass_centre: In the platform's frame [m], shape (3,).
        batch_shape: Leading axes of all of it.
    """

    def __init__(
        self,
        legs: Sequence[BackboneAssembly],
        base: FloatArray,
        platform: FloatArray,
        joints: Sequence[int],
        axes: FloatArray,
        mass: float,
        mass_centre: FloatArray,
    ) -> None:
        self.legs = tuple(legs)
        self.arrays: tuple[RodArrays, ...] = tuple(leg.arrays for leg in legs)
        self.base = base
        self.platform = platform
        self.joints = frozen(np.array(joints, dtype=np.int32))
        self.axes = axes
        self.mass = mass
        self.mass_centre = mass_centre
        shapes = [arrays.batch_shape for arrays in self.arrays]
        self.batch_shape = np.broadcast_shapes(*shapes, base.shape[:-3], platform.shape[:-3])
        self.rods = tuple(rod for leg in self.legs for rod in leg.rods)
        self.first_rod: NDArray[np.intp] = frozen(np.cumsum([0] + [leg.rod_count for leg in self.legs]))
        # what drives the lines of each leg, by the names of inputs
        self.drives = [drive_names(leg.arrays.members) for leg in self.legs]
        self.first_unknown: NDArray[np.intp] = frozen(
            np.cumsum([0] + [leg.rod_count + 5 + sum(kind.conditioned for kind in leg.arrays.members) for leg in self.legs])
        )

    def first_drive(self, name: str) -> NDArray[np.intp]:
        """The first of the lines of each leg among those of all that are driven by an input, and their number, (leg + 1,)."""
        return np.cumsum([0, *(own.count(name) for own in self.drives)])

    def reference(self) -> tuple[FloatArray, FloatArray]:
        """Position [m] and rotation where the unknown pose is zero, shapes (..., 3), (..., 3, 3): the same whatever the
        inputs."""
        turned = (self.base[..., :3, :3] @ np.swapaxes(self.platform[..., :3, :3], -1, -2)).sum(axis=-3)
        return self.base[..., :3, 3].mean(axis=-2), nearest_rotation(turned)

    def take(self, batch_shape: tuple[int, ...], instances: IntArray) -> "Geometry":
        """The geometry of some instances of a batch to whose leading axes this broadcasts, along one axis.

        ``instances`` are their numbers in the flattened batch.
        """
        if not self.batch_shape:
            return self
        result = copy(self)
        result.arrays = tuple(arrays.take(batch_shape, instances) for arrays in self.arrays)
        result.base = take(self.base, batch_shape, instances, tail=3) if self.base.ndim > 3 else self.base
        result.platform = take(self.platform, batch_shape, instances, tail=3) if self.platform.ndim > 3 else self.platform
        result.batch_shape = np.shape(instances)
        return result

    def eased(self, ratio: float) -> "Geometry":
        """(36) of ``docs/held.md``: the same, its legs at most so many times as stiff in torsion as in bending."""
        result = copy(self)
        result.arrays = tuple(arrays.eased(ratio) for arrays in self.arrays)
        return result

    def scales(self) -> tuple[FloatArray, FloatArray]:
        """Length and bending stiffness of each leg, then of the platform, shapes (batch or 1, leg_count + 1)."""
        arrays = [arrays.repeated(self.batch_shape) for arrays in self.arrays]
        length = np.stack([a.end[:, :, -1].max(axis=1) for a in arrays], axis=1)
        stiffness = np.stack([a.material[:, :, 0, :2].max(axis=2).sum(axis=1) for a in arrays], axis=1)
        length = np.concatenate([length, length.mean(axis=1, keepdims=True)], axis=1)
        return length, np.concatenate([stiffness, stiffness.sum(axis=1, keepdims=True)], axis=1)
