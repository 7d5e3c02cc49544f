"""Measurements as rows: what is measured of each instance, and what of it is missing."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from multirod.batch import IntArray
from multirod.tasks.formulation import Evaluation
from multirod.tasks.rows import Pose, PoseRows
from multirod.validation import Described, FloatArray, array, refuse

Sensor = Pose
TURNED = 1e-4  # what a measured R R^T may be off the identity: sensors round


class Measured:
    """The rows of all sensors for some instances; those of a number that is NaN count for nothing.

    Attributes:
        rows: Of each sensor.
        known: Which rows there are, shape (b, m).
    """

    def __init__(self, sensors: Sequence[Sensor], batch_shape: tuple[int, ...], instances: IntArray | None) -> None:
        pairs = [_filled(sensor.rows(1.0, batch_shape, instances)) for sensor in sensors]
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


def _filled(own: PoseRows) -> tuple[PoseRows, NDArray[np.bool_]]:
    """The rows of a pose, NaN replaced, and which of them were no NaN; of angles all or none."""
    known: list[NDArray[np.bool_]] = []
    position, rotation, axis = own.position, own.rotation, own.axis
    if position is not None:
        known.append(np.isfinite(position))
        position = np.where(known[-1], position, 0.0)
    for value, tail, width in ((rotation, (1, 2), 3), (axis, (1,), 2)):
        if value is not None:
            whole = np.asarray(np.isfinite(value).all(axis=tail))
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


class Live(Measured):
    """The rows of sensors whose measurements come one sample after another, in the place of those they were made with."""

    def __init__(self, sensors: Sequence[Sensor], batch_shape: tuple[int, ...]) -> None:
        super().__init__(sensors, batch_shape, None)
        self.sensors = tuple(sensors)
        self._batch_shape, self._count = batch_shape, len(self.known)

    def put(self, values: object) -> None:
        """Take what each sensor says now; None, or NaN, where it dropped out.

        Raises:
            TypeError: If there are no numbers.
            ValueError: If there are not as many as sensors, or one measures something else.
        """
        if not isinstance(values, (list, tuple)) or len(values) != len(self.sensors):
            refuse("measured", values, f"must be a list of {len(self.sensors)}, what each sensor says, None where it dropped out")
        found = [self._one(k, sensor, value) for k, (sensor, value) in enumerate(zip(self.sensors, values, strict=True))]
        for k, (rows, known) in enumerate(found):
            if rows is not None:
                self.rows[k] = rows
            self.known[:, self.ends[k] - self.sensors[k].count : self.ends[k]] = known

    def _one(self, k: int, sensor: Sensor, value: Any) -> tuple[PoseRows | None, Any]:
        """Rows of what a sensor says, and which there are."""
        if value is None:
            return None, False
        names = [name for name in ("position", "rotation", "axis") if getattr(sensor, name) is not None]
        parts = (value,) if len(names) == 1 else value
        if not isinstance(parts, (list, tuple)) or len(parts) != len(names):
            refuse(f"measured[{k}]", value, f"must be ({', '.join(names)})")
        told: dict[str, FloatArray | None] = dict.fromkeys(("position", "rotation", "axis"))
        for name, part in zip(names, parts, strict=True):
            told[name] = self._numbers(f"measured[{k}], {name}", part, (3, 3) if name == "rotation" else (3,))
        axis, rotation = told["axis"], told["rotation"]
        if axis is not None:
            told["axis"] = axis / np.linalg.norm(axis, axis=1, keepdims=True)
        if rotation is not None:
            off = np.abs(rotation @ np.swapaxes(rotation, 1, 2) - np.eye(3)).max()
            if off > TURNED:
                refuse(f"measured[{k}], rotation", part, f"must be a rotation: R R^T is off the identity by {off:.2g}")
        assert sensor.sigma is not None
        return _filled(PoseRows(told["position"], told["rotation"], told["axis"], 1 / sensor.sigma))

    def _numbers(self, field: str, value: Any, tail: tuple[int, ...]) -> FloatArray:
        """(b, *tail), which may be NaN."""
        numbers = value if type(value) is np.ndarray and value.dtype == np.float64 else array(field, value, finite=False)
        try:
            return np.broadcast_to(numbers, (*self._batch_shape, *tail)).reshape(self._count, *tail)
        except ValueError:
            refuse(field, Described(f"array of shape {numbers.shape}"), f"must broadcast to {(*self._batch_shape, *tail)}")
