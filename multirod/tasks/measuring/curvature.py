"""Curvatures measured along a rod, such as by gratings in a fibre. Numbers in parentheses: ``docs/estimation.md``."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from multirod.assembly import Assembly
from multirod.batch import Instances, IntArray, take
from multirod.inputs import Inputs
from multirod.problem import BoundaryProblem
from multirod.results.derivatives import places_on
from multirod.tasks.formulation import Evaluation, Task
from multirod.types import Numbers
from multirod.validation import Described, FloatArray, array, refuse


@dataclass(frozen=True)
class AlongEvaluation(Evaluation):
    """What one integration says along the rods too, at the places of all sensors together.

    Attributes:
        curvature: ``u`` in the frame of each rod that has a sensor [1/m], shape (b, rod, place, 3).
        curvature_columns: By the unknowns, then by what is freed, shape (b, rod, place, 3, n + k).
    """

    curvature: FloatArray
    curvature_columns: FloatArray


class Curvature:
    """Curvatures along a rod, measured: of bending, in the frame of that rod, or of bending and torsion.

    Args:
        at: Arclengths from the base [m], one or several, rising, shape (count,), as ``solution.rod(k).arclength``: of a tube
            that is pushed back, from the plate.
        value: ``u_x, u_y``, or these and ``u_z`` [1/m], shape (..., count, 2 or 3), without ``count`` at one place.
        sigma: Standard deviation [1/m]: one number, or of each component.
        rod: Index or name of the rod.

    Raises:
        ValueError: If places do not rise, values are not as many, or ``sigma`` is not > 0.
    """

    def __init__(self, *, at: Numbers, value: Numbers, sigma: Numbers, rod: int | str = 0) -> None:
        self.at = np.atleast_1d(array("Curvature.at", at))
        if self.at.ndim != 1 or not self.at.size or (np.diff(self.at) <= 0).any() or self.at[0] <= 0:
            refuse("Curvature.at", at, "must be one arclength > 0 or several, rising")
        self.rod = rod
        self._single = array("Curvature.at", at).ndim == 0
        given = array("Curvature.value", value, finite=False)
        if np.isinf(given).any():
            refuse("Curvature.value", value, "must be finite, or NaN where there is no measurement")
        self.components = given.shape[-1] if given.ndim else 0
        if self.components not in (2, 3):
            refuse("Curvature.value", Described(f"array of shape {given.shape}"), "must be (..., 2), or (..., 3) with torsion")
        self.value = self.shaped("Curvature.value", given)
        self.batch_shape = self.value.shape[:-2]
        spread = array("Curvature.sigma", sigma, finite=False)
        if not ((spread > 0) & np.isfinite(spread)).all():
            refuse("Curvature.sigma", sigma, "must be finite and > 0")
        try:
            self.sigma = np.broadcast_to(spread, (self.components,))
        except ValueError:
            refuse("Curvature.sigma", sigma, f"must be one number, or {self.components}")

    @property
    def count(self) -> int:
        """Rows."""
        return len(self.at) * self.components

    def shaped(self, field: str, value: FloatArray) -> FloatArray:
        """Values (..., count, components)."""
        result = value[..., None, :] if self._single else value
        tail = (len(self.at), self.components)
        if result.shape[-2:] != tail:
            wanted = f"(..., {self.components})" if self._single else f"(..., {tail[0]}, {tail[1]})"
            refuse(field, Described(f"array of shape {value.shape}"), f"must be {wanted}")
        return result

    def __repr__(self) -> str:
        return f"Curvature({len(self.at)} places, {self.components} components; batch {self.batch_shape})"


@dataclass(frozen=True)
class CurvatureRows:
    """The rows of a ``Curvature``, one entry an instance.

    Attributes:
        value: Shape (b, count, components).
        weight: One over the deviations, shape (components,).
        rod: Its place among the rods that have sensors.
        places: Which of all sensors' places are its own, indices (count,), or a slice where they follow each other.
    """

    value: FloatArray
    weight: FloatArray
    rod: int
    places: NDArray[np.intp] | slice

    @property
    def count(self) -> int:
        """Rows."""
        return int(self.value.shape[1] * self.value.shape[2])

    def take(self, instances: Instances) -> Self:
        """Those of some instances."""
        return type(self)(self.value[instances], self.weight, self.rod, self.places)

    def at(self, found: Evaluation) -> tuple[FloatArray, FloatArray, FloatArray]:
        """As ``Rows`` say; of what an ``AlongTask`` says."""
        assert isinstance(found, AlongEvaluation)
        count, n = found.residual.shape
        told: FloatArray = np.empty((count, *self.value.shape[1:], 1 + found.curvature_columns.shape[-1]))
        self.put(found.curvature, found.curvature_columns, told)
        told = told.reshape(count, self.count, told.shape[-1])
        return told[..., 0], told[..., 1 : 1 + n], told[..., 1 + n :]

    def put(self, curvature: FloatArray, columns: FloatArray, told: FloatArray) -> None:
        """(14) ``W (h - y)`` and its derivatives by unknowns and by what is freed, of those of all places, beside each other into
        ``told``, (b, count, components, 1 + n + k)."""
        part = slice(self.value.shape[2])
        np.multiply(self.weight, curvature[:, self.rod, self.places, part] - self.value, out=told[..., 0])
        np.multiply(self.weight[:, None], columns[:, self.rod, self.places, part], out=told[..., 1:])


class Places:
    """Where all sensors along the rods of a robot are: every place once, and the rods that have one.

    Args:
        robot: The robot.
        inputs: By which rods are pushed along.
        sensors: All, of which some are ``Curvature``.

    Raises:
        ValueError: If there is no such rod, or a place is not on it.
    """

    def __init__(self, robot: Assembly, inputs: Inputs, sensors: Sequence[Any]) -> None:
        own = [sensor for sensor in sensors if isinstance(sensor, Curvature)]
        index = {id(sensor): rod_index(robot, sensor.rod) for sensor in own}
        self.rods = tuple(sorted(set(index.values())))
        every = {id(sensor): places_on(robot, inputs.translation, sensor.at, index[id(sensor)]) for sensor in own}
        self.at: FloatArray = np.unique(np.concatenate([np.zeros(0), *every.values()]))
        self._found = {key: (self.rods.index(index[key]), _followed(np.searchsorted(self.at, at))) for key, at in every.items()}

    def rows(
        self, sensor: Curvature, batch_shape: tuple[int, ...], instances: IntArray | None
    ) -> tuple[CurvatureRows, NDArray[np.bool_]]:
        """The rows of a sensor, NaN replaced, and which of them were no NaN."""
        return self.filled(sensor, np.asarray(take(sensor.value, batch_shape, instances, tail=2)))

    def filled(self, sensor: Curvature, value: FloatArray) -> tuple[CurvatureRows, NDArray[np.bool_]]:
        """The same of other values, (b, count, components)."""
        known = np.isfinite(value)
        rod, places = self._found[id(sensor)]
        rows = CurvatureRows(np.where(known, value, 0.0), 1 / sensor.sigma, rod, places)
        return rows, known.reshape(len(value), -1)


def rod_index(robot: Assembly, rod: int | str) -> int:
    """Number of a rod, from the first."""
    names = [own.name for own in robot.rods]
    index = names.index(rod) if isinstance(rod, str) and rod in names else rod
    if isinstance(index, bool) or not isinstance(index, (int, np.integer)) or not 0 <= index < len(names):
        refuse("Curvature.rod", rod, f"must be an index below {len(names)} or one of the names {[n for n in names if n]}")
    return int(index)


def _followed(places: NDArray[np.intp]) -> NDArray[np.intp] | slice:
    """Rising indices as a slice, which is read sooner, where they follow each other."""
    first, last = int(places[0]), int(places[-1])
    return slice(first, last + 1) if last - first + 1 == len(places) else places


class AlongTask(Task):
    """A task whose integrations tell the curvature at some places too, and its columns, where there are any."""

    def __init__(self, problem: BoundaryProblem, free: Sequence[str], places: Places) -> None:
        super().__init__(problem, free)
        self._sense(places)

    def _sense(self, places: Places) -> None:
        self._places = places
        self._pass = self.problem.sensing(places.at) if places.rods else None

    def integrate(self) -> None:
        """As said; of all places too."""
        if self._pass is None:
            self.problem.integrate()
            return
        self.problem.heed_stop()
        self._pass.launch()

    def last(self, instances: NDArray[np.intp] | slice = slice(None)) -> Evaluation:
        """What the last integration said of some instances."""
        found = super().last(instances)
        if self._pass is None:
            return found
        values, columns = (np.array(part[instances]) for part in self.sensed())
        if found.failed.any():
            values[found.failed], columns[found.failed] = np.nan, np.nan
        return AlongEvaluation(**vars(found), curvature=values, curvature_columns=columns)

    def sensed(self) -> tuple[FloatArray, FloatArray]:
        """What the last integration said of the places, as of an ``AlongEvaluation``; to be read at once."""
        told = [self.problem.sensed(self._pass, self.free, rod) for rod in self._places.rods]
        values, columns = (_stacked(part) for part in zip(*told, strict=True))
        return values, columns


def _stacked(parts: Sequence[FloatArray]) -> FloatArray:
    """``np.stack(parts, axis=1)``, without a copy where there is one."""
    return parts[0][:, None] if len(parts) == 1 else np.stack(parts, axis=1)
