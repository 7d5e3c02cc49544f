"""A rod as an element of a network: its variables and rows, what stands at its ends, and what the kernels say of it.

Numbers in parentheses are those of ``docs/networks.md``. Arrays have the axes (instance, rod, ...). An element has the variables
of ``Layout`` and as many rows; its matrix is that of the rows by the variables. ``element_kernels.py`` forms it.
"""

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from multirod.models.network.elements import records
from multirod.models.network.joining.joints import MOST, Turns
from multirod.validation import FloatArray

if TYPE_CHECKING:
    from multirod.models.network.problem import NetworkProblem

OWN = 6  # unknowns of a rod at least: moment and force at its base
POSE = records.POSE  # of a body
TURNING = records.TURNING  # directions in which the base of a rod may turn
# rows of an element: gap and mismatch of the tip, or what is free there; what else is the rod's own; torques of the joints; the
# balances of both bodies; what slides through the holes at tip and base
GAP_AT, TURN_AT = slice(0, 3), slice(3, 6)
STIFFEST = 1e4  # EI/L: beyond any margin


@dataclass(frozen=True)
class Layout:
    """Variables of an element: the rod's own, angles of the joints at base and tip, poses of the bodies there, holes.

    Attributes:
        own: Unknowns of the rod that has most.
        holes: Whether rods slide through any.
    """

    own: int = OWN
    holes: bool = False

    @property
    def own_at(self) -> slice:
        """The rod's own."""
        return slice(0, self.own)

    @property
    def angles_at(self) -> tuple[slice, slice]:
        """Angles of the joints at base and tip, and the torques there."""
        first = self.own
        return slice(first, first + MOST), slice(first + MOST, first + 2 * MOST)

    @property
    def poses_at(self) -> tuple[slice, slice]:
        """Poses of the bodies at base and tip, and their balances."""
        first = self.own + 2 * MOST
        return slice(first, first + POSE), slice(first + POSE, first + 2 * POSE)

    @property
    def holes_at(self) -> slice:
        """The holes at tip and base, and what slides through them."""
        return slice(self.size - 2 * self.holes, self.size)

    @property
    def size(self) -> int:
        """All of them."""
        return self.own + 2 * MOST + 2 * POSE + 2 * self.holes


@dataclass(frozen=True)
class Frames:
    """(4), (34) Poses of the ground and the bodies, those that are fixed after those that move, axes (instance, frame, ...).

    Attributes:
        position: [m], shape (..., 3).
        rotation: Shape (..., 3, 3).
        turns: Rotation vectors by the three unknowns of rotation, or inputs, in the world, as columns, shape (..., 3, 3).
        axes: Along which the balance of each body that moves is told, as columns, shape (instance, body, 3, 3).
    """

    position: FloatArray
    rotation: FloatArray
    turns: FloatArray
    axes: FloatArray

    @property
    def moving(self) -> slice:
        """The bodies that move."""
        return slice(1, 1 + self.axes.shape[1])


class Holding:
    """(1) One end of all rods at some poses of the bodies and angles of the joints.

    Attributes:
        joints: (2) The joints there.
        frame: Of the pose on the body, in the world, shape (..., 3, 3).
        origin: Of that pose [m], shape (..., 3).
        position: Of the end, which may have slid from there [m], shape (..., 3).
        rotation: Of the end, shape (..., 3, 3).
    """

    def __init__(
        self, frames: Frames, holder: NDArray[np.intp], attachment: tuple[FloatArray, FloatArray], joints: Turns
    ) -> None:
        arm, frame = attachment
        R = frames.rotation[:, holder]
        self.joints = joints
        self.frame = R @ frame
        self.origin = frames.position[:, holder] + _times(R, arm)
        self.position = self.origin + _times(self.frame, joints.moved)
        self.rotation = self.frame @ joints.rotation


class Elements:
    """What the last integration says of all rods; to be read at once.

    Args:
        problem: Of which all instances were integrated.

    Attributes:
        columns: (5) to (11), (22) Of the rows, by the variables, then along directions, then, where there are holes, by the
            length of the piece, shape (instance, rod, size, k).
        tip_turn: (5) How the tips turn, told in the axes of the bases, by the same, shape (instance, rod, 3, k).
        tip_force: Likewise how the force on them changes in the world.
        tension: (22) What slides at tips and bases [N], by the same, shape (instance, rod, 2, k); only where there are holes.
        angles: How tubes, from the second on, turn against the frame of their rod at their ends, by the same, shape (instance,
            rod, tube, k).
        carried: What acts along each rod in all [N], in the world, shape (instance, rod, 3).
        tip_position: In the world [m], shape (instance, rod, 3).
    """

    def __init__(self, problem: "NetworkProblem") -> None:
        size, element, value = problem.layout.size, problem.networks.element.numpy(), problem.networks.value.numpy()
        more = element[:, :, size:]
        self.columns: FloatArray = element[:, :, :size]
        self.tip_turn: FloatArray = more[:, :, records.TIP_TURN_AT : records.TIP_TURN_AT + 3]
        self.tip_force: FloatArray = more[:, :, records.TIP_FORCE_AT : records.TIP_FORCE_AT + 3]
        self.tension: FloatArray = more[:, :, records.TENSION_AT : records.TENSION_AT + 2]
        self.angles: FloatArray = more[:, :, problem.groups[0].angles_at - size :]
        self.carried: FloatArray = value[:, :, size + records.CARRIED_AT :][:, :, :3]
        self.tip_position: FloatArray = problem.networks.tip_position.numpy()


def torque_units(problem: "NetworkProblem", end: int) -> FloatArray:
    """(9) What torques about the axes of joints at bases (0) or tips (1) are told in [N m^2], shape (instance, rod, 3)."""
    L, EI = (scale[:, : problem.rod_count, None] for scale in (problem.length, problem.stiffness))
    return np.asarray(EI + L * problem.graph.ends[end].table.stiffness)


def counted(units: FloatArray, stiffness: FloatArray) -> FloatArray:
    """What counts as one in a coordinate whose spring, if any, is told in ``units`` [N m^2], on a rod of some ``stiffness``: less
    of one that hardly gives way, or the rounding of what it stores would hide all other modes."""
    return np.asarray(1 / np.sqrt(np.maximum((units / stiffness - 1) / STIFFEST, 1)))


def _times(matrices: FloatArray, vectors: FloatArray) -> FloatArray:
    return np.asarray((matrices @ vectors[..., None])[..., 0])
