"""Curvatures measured along a rod, such as by gratings in a fibre. Numbers in parentheses: ``docs/estimation.md``."""

from typing import ClassVar

import numpy as np

from multirod import plausibility
from multirod.naming import names_checked
from multirod.tasks.deviations import deviation
from multirod.types import Numbers
from multirod.validation import Described, FloatArray, array, measurement, refuse


class Curvature:
    """Curvatures along a rod, measured: of bending, in the frame of that rod, or of bending and torsion.

    Args:
        at: Arclengths from the base [m], one or several, rising, shape (count,), as ``solution.rod(k).arclength``: of a tube
            that is pushed back, from the plate.
        value: ``u_x, u_y``, or these and ``u_z`` [1/m], shape (..., count, 2 or 3), without ``count`` at one place.
        sigma: Standard deviation [1/m]: one number, or of each component.
        rod: Index or name of the rod; not needed where a robot is one rod, or tubes in each other, whose first it is.

    Raises:
        ValueError: If places do not rise, values are not as many, or ``sigma`` is not > 0.
    """

    quantity: ClassVar = "curvature"
    first: ClassVar = 0  # of its components among those of the quantity
    says: ClassVar = "value"

    @names_checked
    def __init__(self, *, at: Numbers, value: Numbers, sigma: Numbers, rod: int | str | None = None) -> None:
        self.at = np.atleast_1d(array("Curvature.at", at))
        if self.at.ndim != 1 or not self.at.size or (np.diff(self.at) <= 0).any() or self.at[0] < 0:
            refuse("Curvature.at", at, "must be one arclength >= 0 or several, rising")
        self.rod = rod
        self._single = array("Curvature.at", at).ndim == 0
        given = measurement("Curvature.value", value)
        self.components = given.shape[-1] if given.ndim else 0
        if self.components not in (2, 3):
            refuse("Curvature.value", Described(f"array of shape {given.shape}"), "must be (..., 2), or (..., 3) with torsion")
        self.value = self.shaped("Curvature.value", given)
        plausibility.of_measured_curvature(self.value, float(self.at[-1]))
        self.batch_shape = self.value.shape[:-2]
        self.sigma = deviation("Curvature.sigma", sigma, self.components)

    @property
    def count(self) -> int:
        """Rows."""
        return len(self.at) * self.components

    @property
    def places(self) -> FloatArray:
        """Where it is along its rod [m], shape (count,)."""
        return self.at

    def joined(self, field: str, value: object) -> object:
        """What it says at a sample, (..., count, components), to be checked; or one NaN for all. As ``value`` is given, of one
        arclength without ``count``."""
        if not self._single or isinstance(value, float):
            return value
        rows = array(field, value, (self.components,), finite=False)
        return rows if rows.shape[-2:-1] == (1,) else rows[..., None, :]

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
