"""Measurements as rows: what is measured of each instance, and what of it is missing."""

from collections.abc import Callable, Sequence
from copy import copy
from dataclasses import replace
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from multirod import plausibility
from multirod.batch import Instances, IntArray
from multirod.kernels.shared import Shared
from multirod.problem import BoundaryProblem
from multirod.rotations import TURNED, refuse_unturned
from multirod.tasks.formulation import Evaluation
from multirod.tasks.given import plain, turned
from multirod.tasks.measuring.along import AlongTask, Places
from multirod.tasks.measuring.along_rows import AlongRows, AlongSensor, along_rows, filled
from multirod.tasks.rows import SIGHTS, Pose, PoseRows
from multirod.tasks.whitening import of_what_is_there
from multirod.validation import LARGEST, SMALLEST_AXIS, Described, FloatArray, array, first_of, refuse

Sensor = Pose | AlongSensor
EYE = np.eye(3)
TOLD = ("position", "rotation", "axis")  # at each sample; across or along which direction a position counts stays
MOST_ROWS = 6  # of a pose
# what surely is a measurement of each, of a sensor that did not drop out
PLAINLY: dict[str, Callable[[Any], bool]] = {
    "position": plain,
    "rotation": lambda value: turned(value, TURNED),
    "axis": lambda value: False,
}


class Measured:
    """The rows of all sensors for some instances; those of a number that is NaN count for nothing.

    Attributes:
        rows: Of each sensor.
        known: Which rows there are, shape (b, m).
        missing: Whether a number of each sensor is missing, shape (b, sensor_count).
    """

    def __init__(
        self, sensors: Sequence[Sensor], places: Places, batch_shape: tuple[int, ...], instances: IntArray | None
    ) -> None:
        self.places = places
        pairs: list[tuple[PoseRows | AlongRows, NDArray[np.bool_]]] = [
            along_rows(sensor, places, batch_shape, instances)
            if isinstance(sensor, AlongSensor)
            else _filled(replace(sensor.rows(1.0, batch_shape, instances), place=places.one(sensor)))
            for sensor in sensors
        ]
        self.rows: list[PoseRows | AlongRows] = [rows for rows, _ in pairs]
        self.known: NDArray[np.bool_] = np.concatenate([known for _, known in pairs], axis=1)
        self.ends = np.cumsum([known.shape[1] for _, known in pairs])
        self.missing = self._missing()

    def position(self) -> FloatArray | None:
        """Where the first instance's end effector was seen [m], shape (3,), NaN where that is missing; None where no sensor sees
        all of it."""
        for rows, end in zip(self.rows, self.ends, strict=True):
            if isinstance(rows, PoseRows) and rows.position is not None and rows.kind[0] == 1 and rows.place is None:
                known = self.known[0, end - rows.count :][:3]
                return np.where(known, rows.position[0], np.nan)
        return None

    def _missing(self) -> NDArray[np.bool_]:
        return np.stack([~own.all(axis=1) for own in np.split(self.known, self.ends[:-1], axis=1)], axis=1)

    def dropped(self) -> tuple[str, ...]:
        """What the first instance is without, in words."""
        own = np.split(self.known[0], self.ends[:-1])
        return tuple(said for k, (rows, known) in enumerate(zip(self.rows, own, strict=True)) for said in _gone(k, rows, known))

    def take(self, instances: IntArray) -> "Measured":
        """Those of some instances."""
        result = copy(self)
        result.rows, result.known = [rows.take(instances) for rows in self.rows], self.known[instances]
        result.missing = self.missing[instances]
        return result

    def without(self, instances: NDArray[np.intp]) -> "Measured":
        """Those of others, of these no row."""
        result = copy(self)
        result.known = self.known.copy()
        result.known[instances] = False
        return result

    def task(self, problem: BoundaryProblem, free: Sequence[str]) -> AlongTask:
        """A task whose integrations tell what the rows need."""
        return AlongTask(problem, free, self.places)

    def at(self, found: Evaluation, chosen: Instances) -> tuple[FloatArray, FloatArray]:
        """(3) Whitened ``r`` (b, m) and ``J`` (b, m, k) of the chosen instances, that ``found`` is of."""
        return found.condensed(*self.told(found, chosen))

    def told(self, found: Evaluation, chosen: Instances) -> tuple[FloatArray, FloatArray, FloatArray]:
        """The same rows where the integration stood, (b, m), and their derivatives by unknowns and by what is free; zeros where a
        number is missing."""
        parts = [rows.take(chosen).at(found) for rows in self.rows]
        joined = parts[0] if len(parts) == 1 else [np.concatenate(part, axis=1) for part in zip(*parts, strict=True)]
        known = self.known[chosen]
        if not known.all():
            joined = [np.where(known.reshape(*known.shape, *[1] * (each.ndim - 2)), each, 0.0) for each in joined]
        return joined[0], joined[1], joined[2]


def _gone(k: int, rows: PoseRows | AlongRows, known: NDArray[np.bool_]) -> list[str]:
    """What sensor ``k`` does not say, of its rows (m,) that are known."""
    if known.all():
        return []
    if not known.any():
        return [f"sensor {k}"]
    if isinstance(rows, AlongRows):
        return [f"{np.count_nonzero(~known)} of {len(known)} numbers of sensor {k}"]
    count = rows.position_rows
    if count == 3 and known[:3].any():
        missing = [name for name, there in zip("xyz", known[:3], strict=True) if not there]
    else:
        missing = [] if known[:count].all() else ["position"]
    if not known[count:].all():
        missing.append("rotation" if rows.rotation is not None else "axis")
    return [f"{' and '.join(missing)} of sensor {k}"]


def checked(field: str, measured: object) -> tuple[Sensor, ...]:
    """Sensors, each with a standard deviation, of which something is measured.

    Raises:
        TypeError: If one is no sensor.
        ValueError: If one has no ``sigma``, or nothing is measured at all.
    """
    given = (measured,) if isinstance(measured, Sensor) else measured
    if not isinstance(given, (list, tuple)) or not given or not all(isinstance(item, Sensor) for item in given):
        says = "Pose(position=p, rotation=R, sigma=(5e-4, 5e-3)), Curvature, ForceTorque or Tension"
        raise TypeError(f"{field} must be measurements, such as {says}, or a list of these")
    for k, item in enumerate(given):
        if isinstance(item, Pose):
            if not item.measures:
                refuse(f"{field}[{k}].sigma", None, "must be given: Pose(..., sigma=), standard deviations of what is measured")
            plausibility.of_place(f"{field}[{k}].position", item.position)
    return tuple(given)


def refuse_nothing(field: str, known: NDArray[np.bool_]) -> None:
    """Refuse measurements all of whose numbers are NaN."""
    if not known.any():
        refuse(field, Described("NaN in all rows"), "something must be measured")


def _filled(own: PoseRows) -> tuple[PoseRows, NDArray[np.bool_]]:
    """The rows of a pose, NaN replaced, and which of them were no NaN; of angles, and of parts of a position, all or none."""
    known: list[NDArray[np.bool_]] = []
    position, rotation, axis = own.position, own.rotation, own.axis
    if position is not None:
        there = np.isfinite(position)
        known.append(there if own.kind[0] == 1 else np.repeat(there.all(axis=1, keepdims=True), own.position_rows, axis=1))
        position = np.where(there, position, 0.0)
    for value, tail, width in ((rotation, (1, 2), 3), (axis, (1,), 2)):
        if value is not None:
            whole = np.asarray(np.isfinite(value).all(axis=tail))
            known.append(np.repeat(whole.reshape(-1, 1), width, axis=1))
    if rotation is not None:
        rotation = np.where(known[-1][:, :1, None], rotation, np.eye(3))
    if axis is not None:
        axis = np.where(known[-1][:, :1], axis, (0.0, 0.0, 1.0))
    there = np.concatenate(known, axis=1)
    whitening = None if own.whitening is None else of_what_is_there(own.whitening, there)
    return replace(own, position=position, rotation=rotation, axis=axis, whitening=whitening), there


def batch_of(sensors: Sequence[Sensor]) -> tuple[int, ...]:
    """Leading axes of all sensors together."""
    shapes = [sensor.batch_shape for sensor in sensors]
    try:
        return np.broadcast_shapes(*shapes)
    except ValueError:
        refuse("measured", Described(f"leading axes {shapes}"), "must broadcast")


class Live(Measured):
    """The rows of sensors whose measurements come one sample after another, in the place of those they were made with.

    Attributes:
        rows: Of each sensor; those of poses are of what is in ``poses``.
        known: Which rows there are, shape (b, m).
        missing: Whether a number of each sensor is missing, shape (b, sensor_count).
        counted: Rows that there are, shape (b,).
        slices: Where those of each sensor stand.
        kinds: Whether each sensor has a position (2: across a direction, 3: along it), a rotation, an axis; none of a
            curvature.
        poses: What poses say, by these names, ``position``, ``axis`` and ``direction`` (b, sensor_count, 3), ``rotation``
            (b, sensor_count, 3, 3), as kernels read it.
        there: ``known``, as kernels read it.
        whitening: Of the rows of poses at this sample, as kernels read it, (b, sensor_count, 6, 6).
    """

    def __init__(self, sensors: Sequence[Sensor], places: Places, batch_shape: tuple[int, ...], device: str) -> None:
        super().__init__(sensors, places, batch_shape, None)
        self.sensors = tuple(sensors)
        self._batch_shape, self._count = batch_shape, len(self.known)
        self.slices = [slice(end - sensor.count, end) for sensor, end in zip(sensors, self.ends.tolist(), strict=True)]
        self._whole = np.zeros((self._count, len(sensors)), dtype=bool), np.full(self._count, self.known.shape[1])
        self.known[:] = True
        self.missing, self.counted = self._whole
        shape = self._count, len(sensors)
        types = {"position": wp.vec3d, "rotation": wp.mat33d, "axis": wp.vec3d, "direction": wp.vec3d}
        self.poses = {name: Shared(shape, dtype, device) for name, dtype in types.items()}
        for name, rest in (("rotation", EYE), ("axis", EYE[2]), ("direction", EYE[2])):
            self.poses[name].values[:] = rest
        self.there = Shared(self.known.shape, wp.int32, device)
        self.there.values[:] = 1
        self._whitening = [rows.whitening if isinstance(rows, PoseRows) else None for rows in self.rows]  # where all is there
        self.whitening = Shared((*shape, MOST_ROWS, MOST_ROWS), wp.float64, device)
        self.whitening.values[:] = np.eye(MOST_ROWS)
        for k in range(len(sensors)):
            self._whiten(k, self._whitening[k])
        self._thinned: set[int] = set()  # sensors of which numbers are missing, so that they are whitened otherwise
        self._names = [[name for name in TOLD if getattr(sensor, name, None) is not None] for sensor in sensors]
        self.kinds = [sensor.kind if isinstance(sensor, Pose) else (0, 0, 0) for sensor in sensors]
        for k, sensor in enumerate(sensors):
            if isinstance(sensor, Pose):
                given: Any = self.rows[k]
                own: dict[str, Any] = {}
                for name in sensor.given:
                    own[name] = self.poses["direction" if name in SIGHTS else name].values[:, k]
                    if name in SIGHTS:
                        own[name][:] = getattr(given, name)
                self.rows[k] = replace(given, **own)
            else:
                self.rows[k], _ = filled(sensor, places, np.zeros((self._count, *sensor.value.shape[-2:])))

    def dropped(self) -> tuple[str, ...]:
        """As of ``Measured``; at no cost where nothing dropped out."""
        return () if self.missing is self._whole[0] else super().dropped()

    def put(self, values: object) -> None:
        """Take what each sensor says now; None, or NaN, where it dropped out.

        Raises:
            TypeError: If there are no numbers.
            ValueError: If there are not as many as sensors, or one measures something else.
        """
        if not isinstance(values, (list, tuple)) or len(values) != len(self.sensors):
            refuse("measured", values, f"must be a list of {len(self.sensors)}, what each sensor says, None where it dropped out")
        found = [self._one(k, sensor, value) for k, (sensor, value) in enumerate(zip(self.sensors, values, strict=True))]
        for k in [k for k in self._thinned if found[k] is None]:
            self._whiten(k, self._whitening[k])
            self._thinned.remove(k)
        if all(known is None for known in found):
            if self.missing is not self._whole[0]:
                self.known[:], self.there.values[:] = True, 1
                self.missing, self.counted = self._whole
            return
        for own, known in zip(self.slices, found, strict=True):
            self.known[:, own] = True if known is None else known
        self.there.values[:] = self.known
        self.missing, self.counted = self._missing(), self.known.sum(axis=1)

    def _one(self, k: int, sensor: Sensor, value: object) -> NDArray[np.bool_] | None:
        """Take what a sensor says; which rows there are, None for all."""
        if value is None:
            return np.zeros(sensor.count, dtype=bool)
        if isinstance(value, Sensor):
            says = sensor.says if isinstance(sensor, AlongSensor) else ", ".join(self._names[k])
            where = "what the sensor is, and its sigma, were said once, by sensors="
            refuse(f"measured[{k}]", value, f"must be the numbers alone that it says now, its {says}: {where}")
        if isinstance(sensor, AlongSensor):
            field = f"measured[{k}]"
            numbers = self._numbers(field, sensor.joined(field, value), sensor.value.shape[-2:])
            rows = self.rows[k]
            if isinstance(rows, AlongRows) and np.isfinite(numbers).all():
                rows.value[:] = numbers
                return None
            self.rows[k], known = filled(sensor, self.places, numbers)
            return known
        names = self._names[k]
        parts = (value,) if len(names) == 1 else value
        if not isinstance(parts, (list, tuple)) or len(parts) != len(names):
            refuse(f"measured[{k}]", value, f"must be ({', '.join(names)})")
        if not self._batch_shape and all(PLAINLY[name](part) for name, part in zip(names, parts, strict=True)):
            for name, part in zip(names, parts, strict=True):
                self.poses[name].values[0, k] = part
            return None
        told: dict[str, FloatArray | None] = dict.fromkeys(TOLD)
        for name, part in zip(names, parts, strict=True):
            told[name] = self._numbers(f"measured[{k}], {name}", part, (3, 3) if name == "rotation" else (3,))
        axis, rotation = told["axis"], told["rotation"]
        if axis is not None:
            size = np.linalg.norm(axis, axis=1, keepdims=True)
            if (size <= SMALLEST_AXIS).any():
                refuse(f"measured[{k}], axis", parts[-1], "must not be zero")
            told["axis"] = axis / size
        if rotation is not None:
            refuse_unturned(f"measured[{k}], rotation", parts[-1], rotation, TURNED)
        own = replace(self._posed(k), whitening=self._whitening[k])
        rows, known = _filled(replace(own, position=told["position"], rotation=told["rotation"], axis=told["axis"]))
        for name in names:
            self.poses[name].values[:, k] = getattr(rows, name)
        if rows.whitening is not self._whitening[k]:
            self._whiten(k, rows.whitening)
            self._thinned.add(k)
        return None if known.all() else known

    def _whiten(self, k: int, whitening: FloatArray | None) -> None:
        """Whiten the rows of a sensor so from now on."""
        if whitening is not None:
            m = whitening.shape[-1]
            self.whitening.values[:, k, :m, :m] = whitening
            self.rows[k] = replace(self._posed(k), whitening=whitening)

    def _posed(self, k: int) -> PoseRows:
        rows = self.rows[k]
        assert isinstance(rows, PoseRows)
        return rows

    def _numbers(self, field: str, value: object, tail: tuple[int, ...]) -> FloatArray:
        """(b, *tail), which may be NaN; one NaN stands for all."""
        numbers = value if type(value) is np.ndarray and value.dtype == np.float64 else array(field, value, finite=False)
        if np.any(beyond := (np.abs(numbers) > LARGEST) & np.isfinite(numbers)):
            refuse(field, first_of(beyond, numbers, value), f"must be at most {LARGEST:g} in SI units")
        if numbers.shape == (*self._batch_shape, *tail):
            return np.array(numbers).reshape(self._count, *tail)
        if not (numbers.ndim == 0 and np.isnan(numbers)):
            numbers = array(field, value, tail, finite=False)
        try:
            return np.broadcast_to(numbers, (*self._batch_shape, *tail)).reshape(self._count, *tail)
        except ValueError:
            refuse(field, Described(f"array of shape {numbers.shape}"), f"must broadcast to {(*self._batch_shape, *tail)}")
