"""From where a robot is seen, and how long its arrows are."""

import math
from collections.abc import Sequence
from typing import Self

import numpy as np

from multirod.rod import Rod
from multirod.validation import FloatArray

ARROW = 0.3  # length of the longest arrow over the robot's reach, while larger loads may come
_VIEW = np.array([0.5, 0.43])  # half the width and height of what is seen over its distance, with room for frames and labels
_DIRECTIONS = 96
_ROOM = 1.15  # how far around a base is in view, over the robot's reach
_BACK = np.array([0.75, -1.0, 0.6]) / np.linalg.norm([0.75, -1.0, 0.6])  # towards the eye, obliquely from above
_RIGHT = np.array([1.0, 0.75, 0.0]) / 1.25
_SIDES = np.stack([_RIGHT, np.cross(_BACK, _RIGHT)], axis=-1)  # to the right and up


class Extent:
    """The outermost of points that come block by block: few are kept, which frame a view as all would.

    Attributes:
        points: Those, shape (count, 3).
    """

    def __init__(self, points: FloatArray) -> None:
        k = np.arange(_DIRECTIONS) + 0.5
        z, turn = 1 - 2 * k / _DIRECTIONS, k * math.pi * (3 - math.sqrt(5))
        ring = np.sqrt(1 - z * z)
        self._directions = np.stack([ring * np.cos(turn), ring * np.sin(turn), z])
        self.points: FloatArray = np.zeros((0, 3))
        self.add(points)

    def add(self, points: FloatArray) -> None:
        """Take in points (..., 3); those that are not finite are left out."""
        flat = points.reshape(-1, 3)
        every = np.concatenate([self.points, flat[np.isfinite(flat).all(axis=1)]])
        if len(every):
            self.points = every[np.unique((every @ self._directions).argmax(axis=0))]

    @property
    def size(self) -> float:
        """Diagonal of the box around all [m]."""
        return float(np.linalg.norm(np.ptp(self.points, axis=0))) if len(self.points) else 0.0


class Frame:
    """A place to look from.

    Args:
        points: That fill the view [m], shape (count, 3).

    Attributes:
        centre: Of what is seen [m], shape (3,).
        eye: Where it is seen from [m], shape (3,).
    """

    def __init__(self, points: FloatArray) -> None:
        self.centre: FloatArray = 0.5 * (points.min(axis=0) + points.max(axis=0))
        for _ in range(5):  # what is near looks larger: as much room above as below
            depth, aside = _projected(points - self.centre)
            distance = float((depth + (np.abs(aside) / _VIEW).max(axis=1)).max())
            apparent = aside / np.maximum(distance - depth, 1e-9 * distance + 1e-300)[:, None]
            middle = 0.5 * (apparent.min(axis=0) + apparent.max(axis=0))
            self.centre = self.centre + _SIDES @ (distance * middle)
        depth, aside = _projected(points - self.centre)
        distance = float((depth + (np.abs(aside) / _VIEW).max(axis=1)).max())
        self.eye: FloatArray = self.centre + distance * _BACK

    @classmethod
    def between(cls, centre: FloatArray, eye: FloatArray) -> Self:
        """A frame that is known."""
        frame = cls(centre[None])
        frame.eye = eye
        return frame

    @property
    def above(self) -> FloatArray:
        """A place above the middle of the view, with room for some words [m], shape (3,)."""
        return np.asarray(self.centre + 0.3 * float(np.linalg.norm(self.eye - self.centre)) * _SIDES[:, 1])

    def widened(self, points: FloatArray) -> "Frame":
        """A frame that shows what this one does, and points (count, 3) with some room beyond them."""
        middle = self.centre
        half = float(np.linalg.norm(self.eye - middle)) * 0.9 * float(_VIEW.min())
        corners = middle + half * np.concatenate([np.eye(3), -np.eye(3)])
        return Frame(np.concatenate([corners, middle + 1.2 * (points - middle)]))

    def shows(self, points: FloatArray) -> bool:
        """Whether all points (count, 3) are in view."""
        depth, aside = _projected(points - self.eye)
        return bool((np.abs(aside) <= -_VIEW * depth[:, None] * (1 + 1e-6)).all())

    @classmethod
    def of_reach(cls, bases: FloatArray, shapes: FloatArray, reach: float, held: bool) -> Self:
        """What a robot may reach.

        Args:
            bases: Poses (count, 4, 4).
            shapes: Points of the robot [m], shape (count, 3).
            reach: The length in use [m].
            held: Whether a platform holds the tips: they move little beside their length.
        """
        points = [shapes[np.isfinite(shapes).all(axis=1)], bases[:, :3, 3]]
        if held:
            room = 0.3 * reach
            points += [points[0] + room * side for side in (*np.eye(3), *-np.eye(3))]
        else:
            # half a ball along the base's axis, and some room behind it
            angle = np.linspace(0, 2 * np.pi, 16, endpoint=False)
            rings = [(math.cos(height), math.sin(height)) for height in (0.0, 0.5, 1.0, 0.5 * math.pi)]
            ball = [(w * np.cos(angle), w * np.sin(angle), np.full(16, h)) for w, h in [*rings, (0.5, -0.25)]]
            local = _ROOM * reach * np.concatenate([np.stack(ring, axis=-1) for ring in ball])
            points += [pose[:3, 3] + local @ pose[:3, :3].T for pose in bases]
        return cls(np.concatenate(points))


def radian_force(rods: Sequence[Rod], reach: float) -> float:
    """A force across the tip that turns it by about a radian [N], ``2 EI/L^2``, ``EI`` of all rods."""
    stiffness = sum(max(float(np.max(section.bending_stiffness)) for section in rod.sections) for rod in rods)
    return 2 * stiffness / reach**2


def halved(scale: float, largest: float, most: float) -> float:
    """The scale, halved until the arrow of the largest force is no longer than ``most``."""
    if largest * scale <= most * (1 + 1e-9):
        return scale
    return scale * 0.5 ** math.ceil(math.log2(largest * scale / most) - 1e-9)


def round_down(value: float) -> float:
    """The largest 1, 2 or 5 times a power of ten that is not above ``value``."""
    power = 10.0 ** math.floor(math.log10(value))
    return max(factor * power for factor in (1, 2, 5) if factor * power <= value * (1 + 1e-12))


def round_up(value: float) -> float:
    """The value rounded up to two digits."""
    power = 10.0 ** (math.floor(math.log10(value)) - 1)
    return math.ceil(value / power - 1e-9) * power


def _projected(points: FloatArray) -> tuple[FloatArray, FloatArray]:
    """How near to the eye points are, shape (count,), and how far to the right and up, shape (count, 2)."""
    return points @ _BACK, points @ _SIDES
