"""Poses that are given: of bases, platforms, bodies, joints and ends."""

from abc import ABC, abstractmethod

import numpy as np

from multirod import plausibility
from multirod.rotations import refuse_unturned
from multirod.validation import Described, FloatArray, array, first_of, refuse


class Framed(ABC):
    """What is, or may be, a position and a rotation.

    Attributes:
        position: [m], shape (..., 3), if any.
        rotation: Shape (..., 3, 3), if any.
        batch_shape: Leading axes of both together.
    """

    position: FloatArray | None
    rotation: FloatArray | None
    batch_shape: tuple[int, ...]

    @property
    @abstractmethod
    def alone(self) -> bool:
        """Whether it says nothing else, such as how well it was measured."""


def pose(field: str, value: object) -> FloatArray:
    """A checked pose (..., 4, 4), of such a matrix, of a ``Pose`` or of a list of these; None is the identity."""
    if value is None:
        value = np.eye(4)
    elif isinstance(value, Framed):
        value = _matrix(field, value)
    elif isinstance(value, (list, tuple)) and any(isinstance(item, Framed) for item in value):
        each = [pose(f"{field}[{k}]", item) for k, item in enumerate(value)]
        if len({own.shape for own in each}) > 1:
            refuse(field, Described(f"poses of shapes {[own.shape for own in each]}"), "must be alike, each of shape (4, 4)")
        value = np.stack(each, axis=-3)
    result = array(field, value, (4, 4))
    if not result.size:
        refuse(field, Described(f"array of shape {result.shape}"), "there must be a pose")
    refuse_unturned(field, value, result, allowed="the upper left 3 x 3 block must be a rotation")
    if (wrong := (result[..., 3, :] != [0, 0, 0, 1]).any(axis=-1)).any():
        hint = ": it is transposed" if np.abs(result[..., :3, 3]).max() == 0 else ""
        refuse(field, first_of(wrong, result, value), f"the last row must be 0, 0, 0, 1{hint}")
    plausibility.of_pose(field, result)
    return result


def _matrix(field: str, framed: Framed) -> FloatArray:
    if framed.position is None or framed.rotation is None:
        refuse(field, framed, "must have a position and a rotation: where it is not turned, rotation=np.eye(3)")
    if not framed.alone:
        refuse(field, framed, "must be a position and a rotation alone, without sigma, covariance, at and across")
    result = np.broadcast_to(np.eye(4), (*framed.batch_shape, 4, 4)).copy()
    result[..., :3, :3], result[..., :3, 3] = framed.rotation, framed.position
    return result
