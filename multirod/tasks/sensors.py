"""Measurements as rows: what is measured of each instance, and what of it is missing."""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from multirod.batch import IntArray
from multirod.problem import BoundaryProblem
from multirod.tasks.curvature import AlongTask, Curvature, CurvatureRows, Places
from multirod.tasks.formulation import Evaluation, Task
from multirod.tasks.rows import Pose, PoseRows
from multirod.validation import Described, FloatArray, array, refuse

Sensor = Pose | Curvature
SMALL = 1e-4  # [rad]: an angle below which quotients are 1 and 1/12, to 1e-9
TURNED = 1e-4  # what a measured R R^T may be off the identity: sensors round


class Measured:
    """The rows of all sensors for some instances; those of a number that is NaN count for nothing.

    Attributes:
        rows: Of each sensor.
        known: Which rows there are, shape (b, m).
    """

    def __init__(
        self, sensors: Sequence[Sensor], places: Places, batch_shape: tuple[int, ...], instances: IntArray | None
    ) -> None:
        self.places = places
        pairs: list[tuple[PoseRows | CurvatureRows, NDArray[np.bool_]]] = [
            places.rows(sensor, batch_shape, instances)
            if isinstance(sensor, Curvature)
            else _filled(sensor.rows(1.0, batch_shape, instances))
            for sensor in sensors
        ]
        self.rows: list[PoseRows | CurvatureRows] = [rows for rows, _ in pairs]
        self.known: NDArray[np.bool_] = np.concatenate([known for _, known in pairs], axis=1)
        self.ends = np.cumsum([known.shape[1] for _, known in pairs])

    @property
    def missing(self) -> NDArray[np.bool_]:
        """Whether a number of each sensor is missing, shape (b, sensor_count)."""
        return np.stack([~own.all(axis=1) for own in np.split(self.known, self.ends[:-1], axis=1)], axis=1)

    def task(self, problem: BoundaryProblem, free: Sequence[str]) -> Task:
        """A task whose integrations tell what the rows need."""
        return AlongTask(problem, free, self.places)

    def at(self, found: Evaluation, chosen: Any) -> tuple[FloatArray, FloatArray]:
        """(3) Whitened ``r`` (b, m) and ``J`` (b, m, k) of the chosen instances, that ``found`` is of."""
        parts = [rows.take(chosen).at(found) for rows in self.rows]
        return self._whitened(found, parts, self.known[chosen])

    def _whitened(
        self, found: Evaluation, parts: Sequence[tuple[FloatArray, ...]], known: NDArray[np.bool_]
    ) -> tuple[FloatArray, FloatArray]:
        """``r`` and ``J`` of the rows of all sensors; zeros in the place of those that are missing."""
        joined = parts[0] if len(parts) == 1 else [np.concatenate(part, axis=1) for part in zip(*parts, strict=True)]
        r, J = found.condensed(joined[0], joined[1], joined[2])
        if known.all():
            return r, J
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


def _one_pose(rows: PoseRows, position: FloatArray, rotation: FloatArray) -> tuple[FloatArray, FloatArray]:
    """``PoseRows.errors`` of one instance, of a position, a rotation or both: a control loop has no time for arrays of one."""
    errors, maps = np.zeros((1, rows.count)), np.zeros((1, rows.count, 6))
    weight, angles = rows.weight.tolist()
    first = 0
    if rows.position is not None:
        errors[0, :3] = weight * (position - rows.position[0])
        maps[0, 0, 0] = maps[0, 1, 1] = maps[0, 2, 2] = weight
        first = 3
    if rows.rotation is not None:
        (a, b, c), (d, e, f), (g, h, i) = (rotation @ rows.rotation[0].T).tolist()
        x, y, z = 0.5 * (h - f), 0.5 * (c - g), 0.5 * (d - b)
        sine, cosine = math.sqrt(x * x + y * y + z * z), 0.5 * (a + e + i - 1)
        if cosine < 0:  # far off: as of many
            own, change = PoseRows(None, rows.rotation, None, rows.weight).errors(position[None], rotation[None])
            errors[:, first:], maps[:, first:] = own, change
            return errors, maps
        angle = math.atan2(sine, cosine)
        scale = angle / sine if sine > SMALL else 1.0
        x, y, z = scale * x, scale * y, scale * z
        square = angle * angle
        half = 0.5 * angle
        second = (1 - half / math.tan(half)) / square if angle > SMALL else 1 / 12
        m = 1 - second * square
        turn = (
            (m + second * x * x, second * x * y + 0.5 * z, second * x * z - 0.5 * y),
            (second * x * y - 0.5 * z, m + second * y * y, second * y * z + 0.5 * x),
            (second * x * z + 0.5 * y, second * y * z - 0.5 * x, m + second * z * z),
        )
        errors[0, first:] = angles * x, angles * y, angles * z
        maps[0, first:, 3:] = turn
        maps[0, first:, 3:] *= angles
    return errors, maps


class Live(Measured):
    """The rows of sensors whose measurements come one sample after another, in the place of those they were made with."""

    def __init__(self, sensors: Sequence[Sensor], places: Places, batch_shape: tuple[int, ...]) -> None:
        super().__init__(sensors, places, batch_shape, None)
        self.sensors = tuple(sensors)
        self._batch_shape, self._count = batch_shape, len(self.known)

    def now(self, found: Evaluation) -> tuple[FloatArray, FloatArray]:
        """``at`` of all instances; of one alone with fewer calls, rounded otherwise."""
        parts: list[tuple[FloatArray, ...]] = []
        for rows in self.rows:
            if self._count > 1 or not isinstance(rows, PoseRows) or rows.axis is not None:
                parts.append(rows.at(found))
                continue
            errors, maps = _one_pose(rows, found.position[0], found.rotation[0])
            parts.append((errors, maps @ found.pose_by_unknowns, maps @ found.pose_by_free))
        return self._whitened(found, parts, self.known)

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

    def _one(self, k: int, sensor: Sensor, value: Any) -> tuple[PoseRows | CurvatureRows | None, Any]:
        """Rows of what a sensor says, and which there are."""
        if value is None:
            return None, False
        if isinstance(sensor, Curvature):
            tail = (len(sensor.at), sensor.components)
            return self.places.filled(sensor, self._numbers(f"measured[{k}]", value, tail))
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
