"""Cross-sections: what follows from their sizes and moduli. Numbers in parentheses: ``docs/model.md``."""

import math
from collections.abc import Callable, Mapping
from typing import NamedTuple, TypeAlias

import numpy as np

from multirod.plausibility import Material
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

ODD_FIFTHS = 192 / math.pi**5
ALL_ODD = 1.0045237627951396  # the sum of 1/n^5 over odd n: 31/32 of zeta(5)
LARGEST_DIAMETER = 1e12  # m, whose fourth power no modulus makes too large


def moduli_of(young_modulus: object, shear_modulus: object, poisson_ratio: object) -> tuple[FloatArray, FloatArray]:
    """``E`` and ``G`` [Pa]."""
    E = positive_array("Rod.young_modulus", young_modulus)
    return E, _shear_modulus_of(E, shear_modulus, poisson_ratio)


def _shear_modulus_of(E: FloatArray, shear_modulus: object, poisson_ratio: object) -> FloatArray:
    """``G`` [Pa], given or by Poisson's ratio."""
    if poisson_ratio is None:
        if shear_modulus is None:
            refuse("Rod.shear_modulus", None, "must be a number, or give poisson_ratio")
        return positive_array("Rod.shear_modulus", shear_modulus)
    if shear_modulus is not None:
        raise TypeError("Rod.tube, Rod.wire and Rod.strip take shear_modulus or poisson_ratio, not both")
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


class CrossSection(NamedTuple):
    """What follows from the shape of a section, in whose axes those of the moduli broadcast.

    Attributes:
        bending: Second moments of area [m^4], about both axes or about x and y, shape (..., 1 or 2).
        torsion: Torsion constant [m^4], shape (...).
        area: [m^2], shape (...).
        shear: Timoshenko's shear coefficient by ``q = 1 + nu``.
    """

    bending: FloatArray
    torsion: FloatArray
    area: FloatArray
    shear: Callable[[FloatArray], FloatArray]


def round_section(E: FloatArray, G: FloatArray, outer: Diameter, inner: Diameter) -> CrossSection:
    """That of a tube; (5a)."""
    d, hollow = (np.square(size) for size in (outer, inner))  # no powers: of arrays these may be rounded otherwise than alone
    I, A = np.asarray(np.pi / 64 * (d * d - hollow * hollow)), np.asarray(np.pi / 4 * (d - hollow))
    _refuse_apart(E, G, I, "diameters")
    if (wrong := ~(I > 0)).any():
        bad = first_of(wrong, np.broadcast_to(outer, I.shape), outer)
        refuse("Rod.outer_diameter", bad, "must be > inner_diameter by more than rounding, its fourth power no zero")

    def shear(q: FloatArray) -> FloatArray:
        m2 = (np.asarray(inner) / outer) ** 2
        return np.asarray(6 * q * (1 + m2) ** 2 / ((1 + 6 * q) * (1 + m2) ** 2 + (8 + 12 * q) * m2))

    return CrossSection(I[..., None], 2 * I, A, shear)


def rectangle(E: FloatArray, G: FloatArray, width: Diameter, thickness: Diameter) -> CrossSection:
    """(5b), (5c) That of a strip."""
    try:
        w, t = np.broadcast_arrays(width, thickness)
    except ValueError:
        shapes = f"{np.shape(width)} and {np.shape(thickness)}"
        raise ValueError(f"the batch axes of width and thickness, {shapes}, do not broadcast") from None
    A = np.asarray(w * t)
    I = np.stack([A * (t * t), A * (w * w)], axis=-1) / 12
    long, short = np.maximum(w, t), np.minimum(w, t)
    J = np.asarray(A * (short * short) * _slowed(long / short))
    _refuse_apart(E, G, J, "sides")
    if (wrong := ~((J > 0) & (I > 0).all(axis=-1))).any():
        sides = [("width", np.broadcast_to(w, J.shape)[wrong][0]), ("thickness", np.broadcast_to(t, J.shape)[wrong][0])]
        name, bad = min(sides, key=lambda side: float(side[1]))
        refuse(f"Rod.{name}", float(bad), "must not be so small that EI is zero")
    return CrossSection(I, J, A, lambda q: 10 * q / (1 + 11 * q))


def _slowed(ratio: FloatArray) -> FloatArray:
    """(5c) The torsion constant of rectangles over ``long short^3``, by long over short, one by one: so they are as alone."""
    found = [(1 - ODD_FIFTHS * (ALL_ODD - _flattened(own)) / own) / 3 for own in ratio.ravel().tolist()]
    return np.array(found, dtype=np.float64).reshape(ratio.shape)


def _flattened(ratio: float) -> float:
    """What the hyperbolic tangents of (5c) leave to 1."""
    return sum(2 * math.exp(-n * math.pi * ratio) / (n**5 * (1 + math.exp(-n * math.pi * ratio))) for n in range(1, 15, 2))


def _refuse_apart(E: FloatArray, G: FloatArray, I: FloatArray, sizes: str) -> None:
    """Refuse leading axes that do not broadcast."""
    try:
        np.broadcast_shapes(E.shape, G.shape, I.shape)
    except ValueError:
        shapes = f"{E.shape}, {G.shape} and {I.shape}"
        raise ValueError(f"the batch axes of young_modulus, shear_modulus and {sizes}, {shapes}, do not broadcast") from None


def stiffnesses(
    material: Material, section: Callable[[], CrossSection], extensible: bool, given: Mapping[str, object]
) -> tuple[dict[str, FloatArray], FloatArray]:
    """(5a) to (5c) Stiffnesses and mass of a rod, by their names, and its area [m^2]; ``given`` is for errors."""
    E, G, rho = material.young, material.shear, material.density
    with np.errstate(over="ignore", under="ignore", invalid="ignore"):
        own = section()
        EI, GJ, mass = E[..., None] * own.bending, G * own.torsion, rho * own.area
        EA, GA = np.asarray(E * own.area), np.asarray(own.shear(E / (2 * G)) * G * own.area)
    for name, result in (("young_modulus", EI), ("shear_modulus", GJ)):
        if not within(result):
            refuse(f"Rod.{name}", given[name], f"must make EI and GJ from {SMALLEST:g} to {LARGEST:g} N m^2")
    found = {"bending_stiffness": EI, "torsional_stiffness": GJ, "linear_density": np.asarray(mass)}
    if extensible:
        if not (within(EA) and within(GA)):
            refuse("Rod.young_modulus", given["young_modulus"], f"must make EA and GA from {SMALLEST:g} to {LARGEST:g} N")
        found |= {"axial_stiffness": EA, "shear_stiffness": GA[..., None]}
    if not (found["linear_density"] <= LARGEST).all():
        refuse("Rod.density", given["density"], f"must make the mass per length at most {LARGEST:g} kg/m")
    return found, own.area


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
