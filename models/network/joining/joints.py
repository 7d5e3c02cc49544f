"""Joints between the ends of rods and bodies: what they leave free, and the turns and torques of that.

Numbers in parentheses are those of ``docs/networks.md``.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from multirod.frames import pose as checked_pose
from multirod.models.network.joining.bodies import BY_RODS, Body, Ground, name_of
from multirod.naming import names_checked
from multirod.read_only import ReadOnly, changed
from multirod.rotations import vectors, with_changes
from multirod.types import Numbers, Poses
from multirod.validation import FloatArray, array, choice, directions, frozen, nonnegative_float, positive_float, refuse

MOST = 3  # coordinates of a joint
ALONG = "along"  # the end that is none: a hole
# coordinates of each: angles, then how far it slides
KINDS = {"clamped": 0, "revolute": 1, "universal": 2, "spherical": 3, "prismatic": 1, "cylindrical": 2}
SLIDING = ("prismatic", "cylindrical")  # whose last coordinate is how far the end slides along the axis
HOLES = {"prismatic": "clamped", "cylindrical": "revolute", "spherical": "spherical"}  # how each lets a rod turn
ONE, TWO = "one of shape (3,)", "two that are perpendicular, shape (2, 3)"
AXES = {"revolute": ONE, "universal": TWO, "prismatic": ONE, "cylindrical": ONE}  # that must be given
PERPENDICULAR = 1e-8  # that the axes of a universal joint may be off a right angle
FITTING = 8  # steps in which the coordinates of a joint are found that fit a rotation best


class Joint(ReadOnly):
    """One end of a rod, and what holds it there; or a hole through which the rod slides without friction.

    Args:
        rod: Name of the rod.
        end: ``"base"``, ``"tip"`` or ``"along"``: through a hole.
        to: The body that holds it, or ``mr.ground``.
        pose: Where on it: the pose that the end takes where the joint is not turned, in the frame of the body, shape (..., 4, 4);
            the identity by default. Or the name of one of the body's ``frames``.
        kind: ``"clamped"``; ``"revolute"``, free to turn about ``axis``; ``"universal"``, about the first of two axes, that stays
            with the body, and the second, that goes with the rod; ``"spherical"``, free to turn; ``"prismatic"``, whose end
            slides along ``axis`` and does not turn; ``"cylindrical"``, that turns about it too. Of a hole ``"prismatic"``, a
            long one along z of its ``pose``, in which the rod does not turn; ``"cylindrical"``, in which it turns about itself;
            and ``"spherical"``, a ring.
        axis: In the frame of ``pose``, shape (3,); of a universal joint two that are perpendicular, shape (2, 3). What is not
            clamped or spherical must have it: none is more natural than another.
        stiffness: Of a spring in the joint, about each of its axes [N m/rad], or along it where it slides [N/m]: of a spherical
            joint one number, of a cylindrical one two, about and along its axis. Of a hole along the rod [N/m], between the hole
            and the rod. None by default.
        rest: Angle about each axis [rad], or how far along it [m], at which that spring is without torque or force; only with a
            ``stiffness``. Of a spherical joint it is where ``pose`` says. Of a hole the arclength from the base [m] of the place
            to which the spring is fixed, by default ``at``; ``translation`` moves that place with the rod.
        driven: Whether its coordinates are inputs: angles ``angle``, ``robot.inputs(angle={"arm base": 0.3})``, of the base of
            the rod ``"arm"``, and how far it slides ``slide``. What drives it holds it there. Then it has no spring. One that
            is not driven may be pushed, by ``joint_torque`` and ``slide_force``, but a ball.
        at: Of a hole, about where along the rod it is, from the base [m]: there the search begins. Holes stand in this order.

    Attributes:
        frame: Name of the body's frame where it is, None where a ``pose`` was given.

    Raises:
        ValueError: If a name is no name, a pose is none, an axis is missing or zero, or there is a ``rest`` without a spring.
        TypeError: If ``to`` is neither a ``Body`` nor ``mr.ground``.
    """

    instead = "make another Joint(...), and a network of it"

    @names_checked
    def __init__(
        self,
        rod: str,
        end: Literal["base", "tip", "along"],
        *,
        to: Body | Ground,
        pose: Poses | str | None = None,
        kind: Literal["clamped", "revolute", "universal", "spherical", "prismatic", "cylindrical"] = "clamped",
        axis: Numbers | None = None,
        stiffness: Numbers = 0.0,
        rest: Numbers | None = None,
        driven: bool = False,
        at: float | None = None,
    ) -> None:
        if isinstance(rod, (Body, Ground)):
            refuse("Joint.rod", rod, f"must be the name of a rod: {BY_RODS}")
        self.rod = name_of("Joint.rod", rod)
        self.end = choice("Joint.end", end, ("base", "tip", ALONG))
        if not isinstance(to, (Body, Ground)):
            raise TypeError(f"Joint.to = {to!r} is not allowed: must be a Body or mr.ground, not {type(to).__name__}")
        self.to = to
        self.frame = pose if isinstance(pose, str) else None
        self.pose = to.frame(pose) if isinstance(pose, str) else checked_pose("Joint.pose", pose)
        self.kind = choice("Joint.kind", kind, HOLES if self.end == ALONG else KINDS)
        self.at = None if at is None else positive_float("Joint.at", at)
        if not isinstance(driven, (bool, np.bool_)):
            raise TypeError(f"Joint.driven = {driven!r} is not allowed: must be True or False")
        self.driven = bool(driven)
        if self.end == ALONG:
            self._be_hole(axis, stiffness, rest)
            return
        if at is not None:
            refuse("Joint.at", at, f"must not be given: the joint is at the {self.end}")
        self.axes = _axes(self.kind, axis)
        self.stiffness = _each("Joint.stiffness", stiffness, self.kind)
        if (self.stiffness < 0).any():
            refuse("Joint.stiffness", stiffness, "must be >= 0")
        rest = 0.0 if rest is None else rest
        if self.kind == "spherical" and (self.stiffness != self.stiffness[0]).any():
            refuse("Joint.stiffness", stiffness, "must be one number: a spherical joint is as stiff about all axes")
        self.rest = _each("Joint.rest", rest, self.kind)
        if self.kind == "spherical" and self.rest.any():
            refuse("Joint.rest", rest, "must be 0 of a spherical joint: turn its pose instead")
        if self.driven:
            self._be_driven(stiffness, rest)
        if self.rest.any() and not self.stiffness.any():
            refuse("Joint.rest", rest, "must not be given without a stiffness: where there is no spring it does nothing")

    def _be_driven(self, stiffness: object, rest: object) -> None:
        if not self.count:
            refuse("Joint.driven", True, "must not be given: a clamped joint has no angle")
        if self.stiffness.any():
            refuse("Joint.stiffness", stiffness, "must be 0: the joint is driven, and held at its angle")
        if self.rest.any():
            refuse("Joint.rest", rest, "must be 0: the joint is driven, and its angle is an input")

    def _be_hole(self, axis: object, stiffness: object, rest: object) -> None:
        if self.driven:
            refuse("Joint.driven", True, "must not be given: in a hole a rod turns as it likes, or not at all")
        if self.at is None:
            refuse("Joint.at", None, "must say about where along the rod the hole is")
        if axis is not None:
            refuse("Joint.axis", axis, "must not be given: of a hole, z of its pose is where the rod goes")
        turns = HOLES[self.kind]
        self.axes = _axes(turns, (0.0, 0.0, 1.0) if turns in AXES else None)
        if array("Joint.stiffness", stiffness).ndim:
            refuse("Joint.stiffness", stiffness, "must be one number of a hole: that of a spring along the rod")
        self.stiffness = np.asarray(frozen(np.array([nonnegative_float("Joint.stiffness", stiffness)])))
        if rest is not None and not self.stiffness.any():
            refuse("Joint.rest", rest, "must not be given without a stiffness: where there is no spring it does nothing")
        self.rest = np.asarray(frozen(np.array([self.at if rest is None else positive_float("Joint.rest", rest)])))

    @property
    def count(self) -> int:
        """Its coordinates."""
        return KINDS[HOLES[self.kind] if self.end == ALONG else self.kind]

    @property
    def angles(self) -> int:
        """How many of these are angles; one more is how far it slides."""
        return self.count - (self.end != ALONG and self.kind in SLIDING)

    def around(self, end: Literal["base", "tip"]) -> "Joint":
        """Of a hole: what it is to the end of the piece of the rod on one side of it."""
        kind = HOLES[self.kind]
        none = np.zeros(KINDS[kind])  # what it turns about has no spring
        return changed(self, end=end, kind=kind, stiffness=none, rest=none)

    def __repr__(self) -> str:
        kind = "" if self.kind == "clamped" else f", {self.kind}{', driven' * self.driven}"
        return f"Joint({self.rod!r}, {self.end!r}, to={self.to.name!r}{kind})"


def _axes(kind: str, value: object) -> FloatArray:
    """Axes of length 1, shape (count, 3)."""
    if kind not in AXES:
        if value is not None:
            refuse("Joint.axis", value, f"must not be given: a {kind} joint has none")
        return np.eye(3)[: KINDS[kind]]
    if value is None:
        refuse("Joint.axis", value, f"must be given for a {kind} joint: {AXES[kind]}, in the frame of its pose")
    given = array("Joint.axis", value, (3,))
    count = 2 if AXES[kind] == TWO else 1
    if given.shape != ((3,) if count == 1 else (count, 3)):
        refuse("Joint.axis", value, f"must have shape {'(3,)' if count == 1 else f'({count}, 3)'} for a {kind} joint")
    axes = directions("Joint.axis", value, given.reshape(-1, 3))
    if count == 2 and abs(float(axes[0] @ axes[1])) > PERPENDICULAR:
        refuse("Joint.axis", value, "must be two axes that are perpendicular")
    return axes


def _each(field: str, value: object, kind: str) -> FloatArray:
    """One number for each coordinate of a joint."""
    given = array(field, value)
    count = KINDS[kind]
    if given.ndim and given.shape != (count,):
        refuse(field, value, f"must be a number, or one for each of the {count} axes of a {kind} joint")
    if not count and given.any():
        refuse(field, value, "must be 0: a clamped joint has no axis")
    if kind == "cylindrical" and not given.ndim and given.any():
        refuse(field, value, "must be two numbers of a cylindrical joint: about its axis, and along it")
    return np.asarray(frozen(np.broadcast_to(given, (count,))))


@dataclass(frozen=True)
class Turns:
    """(2), (3) Joints at some coordinates; axes (instance, joint, ...), in the frames of the poses where they are.

    Attributes:
        rotation: Of the end in the frame of its pose, shape (..., 3, 3).
        turns: Rotation vectors by the coordinates, as columns, shape (..., 3, 3).
        axes: About which torques vanish, or balance springs, as columns, shape (..., 3, 3).
        second: The axes that turn with the first, as columns, zero elsewhere, shape (..., 3, 3).
        first: Rotation vectors by which the first turn those, shape (..., 3, 3).
        slides: (36) How the end moves by the coordinates, as columns [m], shape (joint, 3, 3).
        moved: (36) How far the end is from its pose [m], shape (..., 3).
    """

    rotation: FloatArray
    turns: FloatArray
    axes: FloatArray
    second: FloatArray
    first: FloatArray
    slides: FloatArray
    moved: FloatArray


class JointTable:
    """Several joints in numbers; the first axis is the joint.

    Args:
        joints: None of an end that nothing holds.
        lengths: (36) Of their rods, in which coordinates are told by which they slide [m].

    Attributes:
        count: Coordinates of each, shape (joint,).
        inner: (2) ``A_1``: rotation vector of the first turn by the coordinates, shape (joint, 3, 3).
        outer: (2) ``A_2``, of the second.
        slide: (36) ``T``, how the end moves by the coordinates [m], shape (joint, 3, 3).
        stiffness: Of springs by the coordinates [N m], zero where there is none, shape (joint, 3).
        rest: Coordinates, shape (joint, 3).
        unit: What they are told in, of those by which it slides a length [m], shape (joint, 3).
        driven: Whether its coordinates are inputs, shape (joint,).
        free: Coordinates of each that are unknowns, shape (joint,).
    """

    def __init__(self, joints: "list[Joint | None]", lengths: Sequence[float]) -> None:
        size = len(joints)
        self._still: Turns | None = None  # of joints that are all clamped, at once for as many instances as were asked for last
        self.count: NDArray[np.intp] = np.array([0 if joint is None else joint.count for joint in joints], dtype=np.intp)
        self.driven: NDArray[np.bool_] = np.array([joint is not None and joint.driven for joint in joints], dtype=bool)
        self.free: NDArray[np.intp] = np.where(self.driven, 0, self.count)
        self.inner, self.outer, self.slide = np.zeros((3, size, 3, 3))
        self.stiffness, self.rest, self.unit = np.zeros((size, MOST)), np.zeros((size, MOST)), np.ones((size, MOST))
        for k, (joint, length) in enumerate(zip(joints, lengths, strict=True)):
            if joint is None or not joint.count:
                continue
            own = slice(0, joint.count)
            unit = np.ones(joint.count)  # [m] of coordinates by which it slides
            if joint.kind in SLIDING:
                unit[-1] = 1.0 if joint.driven else length
                self.slide[k, :, joint.count - 1] = unit[-1] * joint.axes[0]
            self.inner[k, :, : joint.angles] = joint.axes.T[:, : joint.angles]
            if joint.kind == "universal":
                self.inner[k, :, 1], self.outer[k, :, 1] = 0.0, joint.axes[1]
            self.stiffness[k, own], self.rest[k, own] = joint.stiffness * unit**2, joint.rest / unit
            self.unit[k, own] = unit

    @property
    def slides(self) -> NDArray[np.bool_]:
        """Which coordinates are told by how far the end slides, shape (joint, 3)."""
        return np.asarray(self.slide.any(axis=1))

    def moved(self, angles: FloatArray) -> FloatArray:
        """(36) How far ends have slid in the frames of their poses [m], at coordinates (instance, joint, 3)."""
        return np.asarray(np.einsum("jik,bjk->bji", self.slide, angles))

    def at(self, angles: FloatArray) -> Turns:
        """(2), (3), (36) At coordinates (instance, joint, 3)."""
        if not self.count.any():
            shape = angles.shape[:-1]
            if self._still is None or self._still.rotation.shape[:-2] != shape:
                still, none = np.broadcast_to(np.eye(3), (*shape, 3, 3)), np.broadcast_to(0.0, (*shape, 3, 3))
                self._still = Turns(still, none, none, none, none, self.slide, none[..., 0])
            return self._still

        moved = self.moved(angles)
        axes = np.stack([self.inner, self.outer])
        rotations, by_vectors = with_changes(np.einsum("ejik,bjk->ebji", axes, angles))
        (first, second), (by_first, by_second) = rotations, by_vectors @ axes[:, None]
        carried = first @ self.outer
        turns = by_first + first @ by_second
        return Turns(first @ second, turns, self.inner + carried, carried, by_first, self.slide, moved)

    def fitted(self, rotation: FloatArray, moved: FloatArray) -> FloatArray:
        """Coordinates at which the joints turn by rotations (instance, joint, 3, 3) as nearly as they can, and slide as nearly by
        ``moved`` (instance, joint, 3) [m], from rest.

        A ball with a spring stays at rest: a torque that stays the same about fixed axes has no potential.
        """
        angles = np.array(np.broadcast_to(self.rest, (*rotation.shape[:-2], MOST)))
        if not self.count.any():
            return angles
        turned = ~((self.count == MOST) & self.stiffness.any(axis=1))
        for _ in range(FITTING):
            turns = self.at(angles)
            off = rotation @ np.swapaxes(turns.rotation, -1, -2)
            error = vectors(off.reshape(-1, 3, 3)).reshape(*rotation.shape[:-2], 3)
            angles += turned[:, None] * np.einsum("bjki,bji->bjk", np.linalg.pinv(turns.turns), error)
        return np.where(self.slides, np.einsum("jki,bji->bjk", np.linalg.pinv(self.slide), moved), angles)
