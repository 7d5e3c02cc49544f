"""Rows of what is measured along rods and of lines, told by an ``AlongTask``. Numbers in parentheses: ``docs/estimation.md``."""

from dataclasses import dataclass, replace
from typing import Self, TypeAlias

import numpy as np
from numpy.typing import NDArray

from multirod.batch import Instances, IntArray, take
from multirod.tasks.formulation import Evaluation
from multirod.tasks.measuring.along import Along, AlongEvaluation, Places
from multirod.tasks.measuring.curvature import Curvature
from multirod.tasks.measuring.force_torque import ForceTorque
from multirod.tasks.measuring.tension import Tension
from multirod.validation import FloatArray

AlongSensor: TypeAlias = Curvature | ForceTorque | Tension


@dataclass(frozen=True)
class AlongRows:
    """The rows of a sensor along a rod, one entry an instance.

    Attributes:
        value: Shape (b, count, components).
        weight: One over the deviations, shape (components,), or (count, components).
        told: What of, and which rod.
        places: Which of all sensors' places, or of all lines, are its own, indices (count,), or a slice where they follow.
        first: Of its components among those of what is told.
    """

    value: FloatArray
    weight: FloatArray
    told: tuple[str, int]
    places: NDArray[np.intp] | slice
    first: int

    @property
    def count(self) -> int:
        """Rows."""
        return int(self.value.shape[1] * self.value.shape[2])

    def take(self, instances: Instances) -> Self:
        """Those of some instances."""
        return replace(self, value=self.value[instances])

    def at(self, found: Evaluation) -> tuple[FloatArray, FloatArray, FloatArray]:
        """As ``Rows`` say; of what an ``AlongTask`` says."""
        assert isinstance(found, AlongEvaluation)
        n = found.residual.shape[1]
        rows: FloatArray = np.empty((len(self.value), self.count, 1 + found.sensed[self.told][1].shape[-1]))
        self.put(found, rows)
        return rows[..., 0], rows[..., 1 : 1 + n], rows[..., 1 + n :]

    def put(self, found: Along | AlongEvaluation, rows: FloatArray) -> None:
        """(14), (22), (23) ``W (h - y)`` and its derivatives by unknowns and by what is freed beside each other into ``rows``,
        (b, m, 1 + n + k)."""
        own = rows.reshape(*self.value.shape, rows.shape[-1])
        part = slice(self.first, self.first + self.value.shape[2])
        value, columns = found.sensed[self.told]
        np.multiply(self.weight, value[:, self.places, part] - self.value, out=own[..., 0])
        np.multiply(self.weight[..., None], columns[:, self.places, part], out=own[..., 1:])


def along_rows(
    sensor: AlongSensor, places: Places, batch_shape: tuple[int, ...], instances: IntArray | None
) -> tuple[AlongRows, NDArray[np.bool_]]:
    """The rows of a sensor, NaN replaced, and which of them were no NaN."""
    return filled(sensor, places, np.asarray(take(sensor.value, batch_shape, instances, tail=2)))


def filled(sensor: AlongSensor, places: Places, value: FloatArray) -> tuple[AlongRows, NDArray[np.bool_]]:
    """The same of other values, (b, count, components)."""
    known, (rod, own) = np.isfinite(value), places.of(sensor)
    rows = AlongRows(np.where(known, value, 0.0), 1 / sensor.sigma, (sensor.quantity, rod), own, sensor.first)
    return rows, known.reshape(len(value), -1)
