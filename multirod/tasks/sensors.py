"""Measurements as rows: what is measured of each instance, and what of it is missing."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from multirod.batch import IntArray
from multirod.tasks.formulation import Evaluation
from multirod.tasks.rows import Pose, PoseRows
from multirod.validation import Described, FloatArray, refuse

Sensor = Pose


class Measured:
    """The rows of all sensors for some instances; those of a number that is NaN count for nothing.

    Attributes:
        rows: Of each sensor.
        known: Which rows there are, shape (b, m).
    """

    def __init__(self, sensors: Sequence[Sensor], batch_shape: tuple[int, ...], instances: IntArray | None) -> None:
        pairs = [_rows(sensor, batch_shape, instances) for sensor in sensors]
        self.rows: list[PoseRows] = [rows for rows, _ in pairs]
        self.known: NDArray[np.bool_] = np.concatenate([known for _, known in pairs], axis=1)
        self.ends = np.cumsum([known.shape[1] for _, known in pairs])

    @property
    def missing(self) -> NDArray[np.bool_]:
        """Whether a number of each sensor is missing, shape (b, sensor_count)."""
        return np.stack([~own.all(axis=1) for own in np.split(self.known, self.ends[:-1], axis=1)], axis=1)

    def at(self, found: Evaluation, chosen: Any) -> tuple[FloatArray, FloatArray]:
        """(3) Whitened ``r`` (b, m) and ``J`` (b, m, k) of the chosen instances, that ``found`` is of."""
        parts = [rows.take(chosen).at(found) for rows in self.rows]
        errors, by_unknowns, by_free = (np.concatenate(part, axis=1) for part in zip(*parts, strict=True))
        r, J = found.condensed(errors, by_unknowns, by_free)
        known = self.known[chosen]
        return np.where(known, r, 0.0), np.where(known[..., None], J, 0.0)


def checked(field: str, measured: Any) -> tuple[Sensor, ...]:
    """Sensors, each with a standard deviation, of which something is measured.

    Raises:
        TypeError: If one is no sensor.
        ValueError: If one has no ``sigma``, or nothing is measured at all.
    """
    given = (measured,) if isinstance(measured, Sensor) else measured
    if not isinstance(given, (list, tuple)) or not given or not all(isinstance(item, Sensor) for item in given):
        raise TypeError(f"{field} must be measurements, such as [Pose(position=p, rotation=R, sigma=(5e-4, 5e-3))]")
    for k, item in enumerate(given):
        if item.sigma is None:
            name = type(item).__name__
            refuse(f"{field}[{k}].sigma", None, f"must be given: {name}(..., sigma=), standard deviations of what is measured")
    return tuple(given)


def refuse_nothing(field: str, known: NDArray[np.bool_]) -> None:
    """Refuse measurements all of whose numbers are NaN."""
    if not known.any():
        refuse(field, Described("NaN in all rows"), "something must be measured")


def _rows(sensor: Pose, batch_shape: tuple[int, ...], instances: IntArray | None) -> tuple[PoseRows, NDArray[np.bool_]]:
    """The rows of a pose, NaN replaced, and which of them were no NaN."""
    own = sensor.rows(1.0, batch_shape, instances)
    known: list[NDArray[np.bool_]] = []
    position, rotation, axis = own.position, own.rotation, own.axis
    if position is not None:
        known.append(np.isfinite(position))
        position = np.where(known[-1], position, 0.0)
    for value, tail, width in ((rotation, (1, 2), 3), (axis, (1,), 2)):
        if value is not None:  # of angles all or none
            whole: NDArray[np.bool_] = np.isfinite(value).all(axis=tail, keepdims=True)
            known.append(np.repeat(whole.reshape(-1, 1), width, axis=1))
    if rotation is not None:
        rotation = np.where(known[-1][:, :1, None], rotation, np.eye(3))
    if axis is not None:
        axis = np.where(known[-1][:, :1], axis, (0.0, 0.0, 1.0))
    return PoseRows(position, rotation, axis, own.weight), np.concatenate(known, axis=1)


def batch_of(sensors: Sequence[Sensor]) -> tuple[int, ...]:
    """Leading axes of all sensors together."""
    shapes = [sensor.batch_shape for sensor in sensors]
    try:
        return np.broadcast_shapes(*shapes)
    except ValueError:
        refuse("measured", Described(f"leading axes {shapes}"), "must broadcast")
