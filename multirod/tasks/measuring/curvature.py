"""Curvatures measured along a rod, such as by gratings in a fibre. Numbers in parentheses: ``docs/estimation.md``."""

from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray

from multirod import plausibility
from multirod.batch import Instances, IntArray, take
from multirod.naming import names_checked
from multirod.tasks.formulation import Evaluation
from multirod.tasks.measuring.along import Along, AlongEvaluation, Places
from multirod.types import Numbers
from multirod.validation import Described, FloatArray, array, refuse


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

    @names_checked
    def __init__(self, *, at: Numbers, value: Numbers, sigma: Numbers, rod: int | str = 0) -> None:
        self.at = np.atleast_1d(array("Curvature.at", at))
        if self.at.ndim != 1 or not self.at.size or (np.diff(self.at) <= 0).any() or self.at[0] < 0:
            refuse("Curvature.at", at, "must be one arclength >= 0 or several, rising")
        self.rod = rod
        self._single = array("Curvature.at", at).ndim == 0
        given = array("Curvature.value", value, finite=False)
        if np.isinf(given).any():
            refuse("Curvature.value", value, "must be finite, or NaN where there is no measurement")
        self.components = given.shape[-1] if given.ndim else 0
        if self.components not in (2, 3):
            refuse("Curvature.value", Described(f"array of shape {given.shape}"), "must be (..., 2), or (..., 3) with torsion")
        self.value = self.shaped("Curvature.value", given)
        plausibility.of_measured_curvature(self.value, float(self.at[-1]))
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

    @property
    def places(self) -> FloatArray:
        """Where it is along its rod [m], shape (count,)."""
        return self.at

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
        rod: Which rod.
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
        n = found.residual.shape[1]
        told: FloatArray = np.empty((len(self.value), self.count, 1 + found.curvatures[self.rod][1].shape[-1]))
        self.put(found, told)
        return told[..., 0], told[..., 1 : 1 + n], told[..., 1 + n :]

    def put(self, found: Along | AlongEvaluation, told: FloatArray) -> None:
        """(14) ``W (h - y)`` and its derivatives by unknowns and by what is freed beside each other into ``told``, (b, m,
        1 + n + k)."""
        own, part = told.reshape(*self.value.shape, told.shape[-1]), slice(self.value.shape[2])
        curvature, columns = found.curvatures[self.rod]
        np.multiply(self.weight, curvature[:, self.places, part] - self.value, out=own[..., 0])
        np.multiply(self.weight[:, None], columns[:, self.places, part], out=own[..., 1:])


def curvature_rows(
    sensor: Curvature, places: Places, batch_shape: tuple[int, ...], instances: IntArray | None
) -> tuple[CurvatureRows, NDArray[np.bool_]]:
    """The rows of a sensor, NaN replaced, and which of them were no NaN."""
    return filled(sensor, places, np.asarray(take(sensor.value, batch_shape, instances, tail=2)))


def filled(sensor: Curvature, places: Places, value: FloatArray) -> tuple[CurvatureRows, NDArray[np.bool_]]:
    """The same of other values, (b, count, components)."""
    known = np.isfinite(value)
    rows = CurvatureRows(np.where(known, value, 0.0), 1 / sensor.sigma, *places.of(sensor))
    return rows, known.reshape(len(value), -1)
