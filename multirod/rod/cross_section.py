"""Round cross-sections: what follows from diameters and moduli."""

from typing import TypeAlias

import numpy as np

from multirod.validation import (
    LARGEST,
    SMALLEST,
    FloatArray,
    array,
    first_of,
    number,
    positive_array,
    refuse,
)

Diameter: TypeAlias = float | FloatArray  # [m], (...) where it has leading axes

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


def round_section(E: FloatArray, G: FloatArray, outer: Diameter, inner: Diameter) -> tuple[FloatArray, FloatArray]:
    """Second moment of area [m^4] and area [m^2] of a round section, in whose axes those of the moduli broadcast."""
    d, hollow = (np.square(size) for size in (outer, inner))  # no powers: of arrays these may be rounded otherwise than alone
    I, A = np.asarray(np.pi / 64 * (d * d - hollow * hollow)), np.asarray(np.pi / 4 * (d - hollow))
    try:
        np.broadcast_shapes(E.shape, G.shape, I.shape)
    except ValueError:
        shapes = f"{E.shape}, {G.shape} and {I.shape}"
        raise ValueError(f"the batch axes of young_modulus, shear_modulus and diameters, {shapes}, do not broadcast") from None
    if (wrong := ~(I > 0)).any():
        bad = first_of(wrong, np.broadcast_to(outer, I.shape), outer)
        refuse("Rod.outer_diameter", bad, "must be > inner_diameter by more than rounding, its fourth power no zero")
    return I, A


def stretching(E: FloatArray, G: FloatArray, A: FloatArray | float, hollow: FloatArray | float) -> tuple[FloatArray, FloatArray]:
    """(5a) ``EA`` and ``GA`` [N] of a round section of area ``A`` whose inner diameter is ``hollow`` times the outer."""
    with np.errstate(over="ignore", under="ignore", invalid="ignore"):
        q, m2 = E / (2 * G), hollow**2  # 1 + nu
        k = 6 * q * (1 + m2) ** 2 / ((1 + 6 * q) * (1 + m2) ** 2 + (8 + 12 * q) * m2)
        return np.asarray(E * A), np.asarray(k * G * A)


def diameter_of(field: str, value: object) -> Diameter:
    """A checked diameter [m], a number or with leading axes."""
    result = positive_array(field, value, smallest=0.0)
    if (wrong := result > LARGEST_DIAMETER).any():
        refuse(field, first_of(wrong, result, value), f"must be finite and > 0, and at most {LARGEST_DIAMETER:g} m")
    return _plain(result)


def diameters(outer: object, inner: object) -> tuple[Diameter | None, Diameter | None]:
    """Checked diameters [m] of one section."""
    thick = None if outer is None else diameter_of("Rod.outer_diameter", outer)
    if inner is None:
        return thick, None
    hollow = array("Rod.inner_diameter", inner, finite=False)
    if not hollow.size:
        refuse("Rod.inner_diameter", inner, "must have a value")
    limit = np.asarray(np.inf if thick is None else thick)
    try:
        wrong = ~((hollow >= 0) & (hollow < limit))
    except ValueError:
        allowed = f"its leading axes {hollow.shape} must broadcast with those of outer_diameter, {limit.shape}"
        refuse("Rod.inner_diameter", inner, allowed)
    if wrong.any():
        bad = first_of(wrong, np.broadcast_to(hollow, wrong.shape), inner)
        refuse("Rod.inner_diameter", bad, "must be finite, >= 0 and smaller than outer_diameter")
    if thick is None and hollow.any():
        refuse("Rod.inner_diameter", inner, "must not be given without outer_diameter")
    return thick, _plain(hollow)


def _plain(values: FloatArray) -> Diameter:
    return values if values.ndim else float(values)
