"""Round cross-sections: what follows from diameters and moduli."""

import math

import numpy as np

from multirod.validation import (
    LARGEST,
    SMALLEST,
    FloatArray,
    number,
    positive_array,
    positive_float,
    refuse,
)

LARGEST_DIAMETER = 1e12  # m, whose fourth power no modulus makes too large


def shear_modulus_of(E: FloatArray, shear_modulus: object, poisson_ratio: object) -> FloatArray:
    """``G`` [Pa], given or by Poisson's ratio."""
    if poisson_ratio is None:
        if shear_modulus is None:
            refuse("Rod.shear_modulus", None, "must be a number, or give poisson_ratio")
        return positive_array("Rod.shear_modulus", shear_modulus)
    if shear_modulus is not None:
        raise TypeError("Rod.tube and Rod.wire take shear_modulus or poisson_ratio, not both")
    ratio = number("Rod.poisson_ratio", poisson_ratio)
    if not -1 < ratio <= 0.5:
        refuse(
            "Rod.poisson_ratio",
            poisson_ratio,
            "must be > -1 and <= 0.5: no other is of a material that is alike in all directions",
        )
    return np.asarray(E / (2 * (1 + ratio)))


def within(values: FloatArray) -> bool:
    """Whether stiffnesses are such as a rod may have."""
    return bool(((values >= SMALLEST) & (values <= LARGEST)).all())


def stretching(E: FloatArray, G: FloatArray, A: FloatArray | float, hollow: FloatArray | float) -> tuple[FloatArray, FloatArray]:
    """(5a) ``EA`` and ``GA`` [N] of a round section of area ``A`` whose inner diameter is ``hollow`` times the outer."""
    with np.errstate(over="ignore", under="ignore", invalid="ignore"):
        q, m2 = E / (2 * G), hollow**2  # 1 + nu
        k = 6 * q * (1 + m2) ** 2 / ((1 + 6 * q) * (1 + m2) ** 2 + (8 + 12 * q) * m2)
        return np.asarray(E * A), np.asarray(k * G * A)


def diameters(outer: float | None, inner: float | None) -> tuple[float | None, float | None]:
    """Checked diameters [m]."""
    if outer is not None:
        outer = positive_float("Rod.outer_diameter", outer)
        if outer > LARGEST_DIAMETER:
            refuse("Rod.outer_diameter", outer, f"must be finite and > 0, and at most {LARGEST_DIAMETER:g} m")
    if inner is not None:
        value = number("Rod.inner_diameter", inner)
        limit = math.inf if outer is None else outer
        if not (math.isfinite(value) and 0 <= value < limit):
            refuse("Rod.inner_diameter", inner, "must be finite, >= 0 and smaller than outer_diameter")
        if outer is None and value != 0:
            refuse("Rod.inner_diameter", inner, "must not be given without outer_diameter")
        inner = value
    return outer, inner
