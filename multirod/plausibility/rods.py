"""Of rods: what they are made of, and what they carry."""

import math
import warnings
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from multirod.plausibility.limits import (
    ASIDE,
    COILED,
    DENSITY,
    HARDLY,
    LENGTH,
    LENGTHENING,
    MAGNETISED,
    POISSON,
    RUBBING,
    SHEAR,
    SLENDER,
    SOFT,
    SPECIFIC,
    STRETCHED,
    TWISTING,
    WIDE,
    WINDING,
    YOUNG,
    largest,
)
from multirod.plausibility.warning import say
from multirod.profile import Profile
from multirod.validation import FloatArray, at_first

if TYPE_CHECKING:
    from multirod.models.backbone.members.lines import Line
    from multirod.rod import Rod


class Material(NamedTuple):
    """What a rod was made of.

    Attributes:
        young: Young's modulus [Pa].
        shear: Shear modulus [Pa].
        density: [kg/m^3].
        shear_given: Whether the shear modulus was, and is not made of Poisson's ratio.
        sides: Width and thickness of a strip [m].
    """

    young: FloatArray
    shear: FloatArray
    density: float
    shear_given: bool = True
    sides: "tuple[float | FloatArray, float | FloatArray] | None" = None

    @property
    def of_strip(self) -> "dict[str, float | FloatArray]":
        """Sizes of a strip, by their names; none of what is round."""
        return {} if self.sides is None else dict(zip(("width", "thickness"), self.sides, strict=True))


NEAR = 10  # times the length, up to where a load may be meant for a longer rod
BEYOND = np.append(
    np.linspace(1, NEAR, 91), np.linspace(NEAR, 1000, 199)[1:]
)  # where functions that are zero on it are looked at


def of_rod(rod: "Rod", material: Material | None) -> None:
    """Warn of what a rod is made of: of what was given first, of what follows from that only where all that is plausible."""
    length = float(np.max(rod.length))
    odd = LENGTH.check("Rod.length", rod.length)
    if material is not None:
        odd |= _of_material(material)
    sizes = {"outer_diameter": rod.outer_diameter} | ({} if material is None else material.of_strip)
    odd = odd or any(size is not None and _of_size(rod, name, size) for name, size in sizes.items())
    if not odd:
        _of_stiffness(rod, material)
    for section in rod.sections:
        if isinstance(section.precurvature, Profile):
            of_nothing("Rod.precurvature", section.precurvature)
    _of_precurvature(rod, length)
    _of_mass(rod, material)
    _of_lines(rod, length)
    if material is not None:
        _of_chambers(rod, float(np.max(material.young)))


def second_moment(rod: "Rod") -> FloatArray:
    """Second moment of area of its cross-section [m^4], (...); zero where it has none or a wall of none."""
    outer, inner = _squares(rod)
    return np.asarray(np.pi / 64 * (outer * outer - inner * inner))


def _squares(rod: "Rod") -> list[FloatArray]:
    """Of its outer and inner diameter [m^2], (...); zero of one that is not given."""
    return [np.asarray(np.square(0.0 if size is None else size)) for size in (rod.outer_diameter, rod.inner_diameter)]


def of_nothing(field: str, profile: Profile) -> None:
    """Warn of a function that is zero up to ten times the length of a rod, but not farther: of arclengths in mm, most likely.

    What is not zero sooner may be meant for a longer rod, or for one that is pushed out.
    """
    if profile.coefficients.any():
        return
    end = float(profile.ends[-1])
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of where nobody asked
            for s in (end * BEYOND).tolist():
                value = np.asarray(profile.function(s), dtype=np.float64)
                if np.isfinite(value).all() and value.any():
                    break
            else:
                return
    except Exception:  # noqa: BLE001  (it need not be defined there)
        return
    if s <= NEAR * end:
        return
    say(f"{field}(s) is zero all along, from s = 0 to {end:.6g} m, but not at s = {s:.6g}; is it a function of s in mm?")


def _of_material(material: Material) -> bool:
    E, G, density, shear_given, _ = material
    ratio = float(np.min(G))
    if 0.0 < ratio <= 0.5 and np.all(ratio == G):
        say(f"Rod.shear_modulus = {ratio:g} Pa is nothing; if it is Poisson's ratio, give poisson_ratio={ratio:g} instead")
        return True
    odd = YOUNG.check("Rod.young_modulus", E) | (shear_given and SHEAR.check("Rod.shear_modulus", G))
    if odd:
        return True
    poisson = E / (2 * G) - 1
    if (poisson < POISSON.low).any() or (poisson > POISSON.high).any():
        least, most = float(poisson.min()), float(poisson.max())
        low = least < POISSON.low
        why = (
            "G is at most about E/2; are young_modulus and shear_modulus exchanged?"
            if low
            else "is G too small, or E too large? Fibres that all lie along a rod make it so, and then it is right"
        )
        values = f"Rod.young_modulus = {float(np.max(E)):.6g} Pa and shear_modulus = {float(np.max(G)):.6g} Pa"
        say(f"{values} mean a Poisson ratio of {least if low else most:.3g}: {why}")
        return True
    if DENSITY.check("Rod.density", density):
        return True
    if density and SPECIFIC.odd(E / density) is not None:
        other = f"; if it is in g/cm^3, give {1e3 * density:.6g}" if float(np.max(E)) / density > SPECIFIC.high else ""
        units = "E is in Pa, density in kg/m^3"
        say(f"Rod.density = {density:.6g} kg/m^3 with young_modulus = {float(np.max(E)):.6g} Pa is no material: {units}{other}")
        return True
    return False


def _of_size(rod: "Rod", name: str, size: "float | FloatArray") -> bool:
    with np.errstate(over="ignore"):
        slender = rod.length / size
    odd = SLENDER.odd(slender)
    if odd is None:
        return False
    outer, length = at_first(slender == odd, size, rod.length)
    what = (
        f"is {'wider' if name == 'width' else 'thicker'} than the rod is long"
        if outer > length
        else "is a hundred thousandth of the length and less"
    )
    found = f"; if it is in mm, give {1e-3 * outer:.6g}" if SLENDER.odd(1e3 * length / outer) is None and outer > length else ""
    say(f"Rod.{name} = {outer:.6g} m {what}, {length:.6g} m{found}")
    return True


def _of_stiffness(rod: "Rod", material: Material | None) -> None:
    easily = np.min if material is not None and material.of_strip else np.max  # a wide one bends the other way
    EI = np.array([float(np.max(easily(section.bending_stiffness, axis=-1))) for section in rod.sections])
    outer = rod.outer_diameter
    if material is None:
        if outer is not None and (I := second_moment(rod)).all():
            moduli = [section.bending_stiffness.max(axis=-1) / I for section in rod.sections]
            every = np.concatenate([np.ravel(modulus) for modulus in moduli])
            found = YOUNG.odd(every)
            if found is not None:
                what = YOUNG.above if found > YOUNG.high else YOUNG.below
                there = next(modulus == found for modulus in moduli if (modulus == found).any())
                second, thick = at_first(there, I, outer)
                mm = f"; if EI is in N mm^2, give {1e-6 * found * second:.6g}" if YOUNG.odd(1e-6 * every) is None else ""
                of = f"Rod.bending_stiffness = {found * second:.6g} N m^2 at outer_diameter = {thick:.6g} m"
                say(f"{of} means a Young's modulus of {found:.3g} Pa, which {what}{mm}")
                return
        if _twists_too_little(rod):
            return
    square = float(np.max(rod.length)) ** 2
    force = EI / square
    odd = SOFT.odd(force)
    if odd is not None:
        what = f"is bent by a force of about EI/L^2 = {odd:.3g} N"
        if material is None:
            own = odd * square
            mm = f"if EI is in N mm^2, give {1e-6 * own:.6g}" if SOFT.odd(1e-6 * force) is None else "it is in N m^2"
            say(f"Rod.bending_stiffness = {own:.6g} N m^2 at length = {_length(rod)} {what}; {mm}")
        else:
            sizes = material.of_strip or {"outer_diameter": 0.0 if outer is None else outer}
            made = ", ".join(f"{name} = {largest(size):.6g} m" for name, size in sizes.items())
            made = f"young_modulus = {largest(material.young):.6g} Pa, {made}, length = {_length(rod)}"
            say(f"Rod of {made} {what}; are {'sides' if material.of_strip else 'diameters'} and length in m, moduli in Pa?")
        return
    _of_stretch(rod)


def _length(rod: "Rod") -> str:
    return f"{float(np.max(rod.length)):.6g} m"


def _twists_too_little(rod: "Rod") -> bool:
    for section in rod.sections:
        GJ, EI = section.torsional_stiffness, section.bending_stiffness.sum(axis=-1)
        wrong = np.isfinite(GJ) & (GJ > TWISTING * EI)
        if wrong.any():
            twisting, bending = (float(np.broadcast_to(value, wrong.shape)[wrong][0]) for value in (GJ, EI))
            say(
                f"Rod.torsional_stiffness = {twisting:.6g} N m^2 is too much beside bending_stiffness = {bending / 2:.6g} N m^2: "
                "of one material GJ is at most about EI; are they exchanged, or in different units?"
            )
            return True
    return False


def _of_stretch(rod: "Rod") -> None:
    if rod.outer_diameter is None:
        return
    outer = np.asarray(rod.outer_diameter)
    for section in rod.sections:
        EI = section.bending_stiffness.max(axis=-1)
        for name, stiff in (("axial_stiffness", section.axial_stiffness), ("shear_stiffness", section.shear_stiffness.T[0].T)):
            implied = 4 * np.sqrt(EI / stiff)  # zero of one that is infinite
            wrong = (implied > 0) & ((implied < outer / WIDE) | (implied > outer * WIDE))
            if wrong.any():
                bends, pulls, width, thick = at_first(wrong, EI, stiff, implied, outer)
                say(
                    f"Rod.{name} = {pulls:.6g} N beside bending_stiffness = {bends:.6g} N m^2 means a "
                    f"diameter of about {width:.2g} m, not {thick:.6g} m: it is a modulus times an area, in N"
                )
                return


def _curvatures(rod: "Rod") -> Iterator[tuple[FloatArray, float]]:
    """Precurvature (..., 3) of each section at some places, and its length."""
    for section in rod.sections:
        size = float(np.max(section.length))
        law = section.precurvature
        yield np.array([law(s) for s in np.linspace(0, size, 9)]) if isinstance(law, Profile) else np.asarray(law), size


def _of_precurvature(rod: "Rod", length: float) -> None:
    bent = [(float(np.linalg.norm(u[..., :2], axis=-1).max()), size) for u, size in _curvatures(rod)]
    most, total = max(u for u, _ in bent), sum(u * size for u, size in bent)
    radius = None if rod.outer_diameter is None else float(np.min(rod.outer_diameter)) / 2
    if radius is not None and most * radius > 1:
        say(
            f"Rod.precurvature of {most:.6g} 1/m is a radius of {1 / most:.3g} m, less than the rod's own, {radius:.3g} m"
            + (f"; if it is a radius in mm, give {1e3 / most:.6g}" if 1e3 / most * radius < 1 else "; it is a curvature in 1/m")
        )
    elif total > 2 * math.pi * WINDING:
        degrees = f"; if it is in degrees per m, give {math.radians(most):.6g}"
        say(f"Rod.precurvature of {most:.6g} 1/m winds the rod up {total / (2 * math.pi):.3g} times{degrees}")
    elif HARDLY[0] < total < HARDLY[1] and length <= LENGTH.high:
        say(
            f"Rod.precurvature of {most:.6g} 1/m bends {length:.6g} m by {math.degrees(total):.2g} degrees; if it is a radius in "
            f"m, give {1 / most:.6g}, if it is in 1/mm, {1e3 * most:.6g}"
        )
    elif not total and not rod.carried and not rod.is_magnetised:
        twist = max(float(np.abs(u[..., 2]).max()) for u, _ in _curvatures(rod))
        round_ = all(np.all(s.bending_stiffness[..., 0] == s.bending_stiffness[..., 1]) for s in rod.sections)
        if twist and round_:
            say(
                f"Rod.precurvature = (0, 0, {twist:.6g}) 1/m twists a round rod and leaves it straight: it is (about x, about y, "
                "twist), so give the curvature first or second"
            )


def _of_mass(rod: "Rod", material: Material | None) -> None:
    if material is not None:
        return
    if rod.outer_diameter is not None:
        outer, inner = _squares(rod)
        areas = np.pi / 4 * (outer - inner)
        for section in rod.sections:
            densities = section.linear_density / areas if areas.all() else np.zeros(())
            odd = DENSITY.odd(densities)
            if odd is not None:
                (mass,) = at_first(densities == odd, densities * areas)
                grams = f"; if it is in g/m, give {1e-3 * mass:.6g}" if DENSITY.odd(1e-3 * odd) is None else ""
                what = DENSITY.above if odd > DENSITY.high else DENSITY.below
                say(f"Rod.linear_density = {mass:.6g} kg/m means a density of {odd:.3g} kg/m^3, which {what}{grams}")
                return
            area = float(areas.max())
            if largest(section.magnetisation) > MAGNETISED * area:
                most = largest(section.magnetisation)
                say(
                    f"Rod.magnetisation = {most:.6g} A m is {most / area:.3g} A/m, more than any magnet; it is the magnetic "
                    f"moment per length: if it is in A/m, give it to Rod.tube, Rod.wire or Rod.strip, or {most * area:.6g}"
                )
                return


def of_tube_magnetisation(magnetisation: FloatArray) -> None:
    """Warn of a magnetisation per volume."""
    most = largest(magnetisation)
    if most > MAGNETISED:
        say(f"Rod.magnetisation = {most:.6g} A/m is more than any magnet has, some 1e6 A/m")
    elif 0 < most < 10:
        remanence = most / (4e-7 * math.pi)
        say(f"Rod.magnetisation = {most:.6g} A/m is next to nothing; if it is a remanence in T, give {remanence:.3g} A/m")


def _of_lines(rod: "Rod", length: float) -> None:
    if rod.discs is not None and rod.discs >= length:
        likely = [f"if it is in mm, give {1e-3 * rod.discs:.6g}"] if 1e-3 * rod.discs < length else []
        if rod.discs > 1 and rod.discs == round(rod.discs):
            likely.append(f"if it is how many there are, their spacing, {length / rod.discs:.6g}")
        found = "; " + ", ".join(likely) if likely else ""
        say(f"Rod.discs = {rod.discs:.6g} m is a spacing beyond the rod's length, {length:.6g} m{found}")
    for line in rod.lines:
        field = type(line).__name__.removeprefix("Rubbing").removeprefix("Displaced").removeprefix("Section")
        there = np.linspace(line.start, min(line._last, length), 9)
        route: Any = line.offset if line.offset is not None else [line._offset_and_slope(s)[0] for s in there]
        aside = largest(route)
        if aside > ASIDE * length:
            found = f"; if it is in mm, give {1e-3 * aside:.6g}" if 1e-3 * aside < ASIDE * length else ""
            say(f"{field}.offset = {aside:.6g} m is beside a rod of {length:.6g} m, further than half its length{found}")
        turns = _turns(line)
        if turns > COILED:
            found = f"if its angle is in degrees, np.radians makes it {math.radians(turns):.3g}"
            say(f"{field}.route winds around the rod {turns:.3g} times; {found}")
        area = getattr(line, "area", None)
        if area is not None and math.sqrt(float(np.max(area))) > length:
            found = f"; if it is in mm^2, give {1e-6 * float(np.max(area)):.6g}"
            say(f"{field}.area = {float(np.max(area)):.6g} m^2 is wider than the rod is long, {length:.6g} m{found}")
        rest, rubs = getattr(line, "rest_length", None), largest(getattr(line, "friction", 0.0))
        if rest is not None and np.ndim(rod.length) == 0:
            natural = float(np.max(line.length_at_rest(rod.sections)))
            if abs(rest - natural) > STRETCHED * natural:
                found = f"; if it is in mm, give {1e-3 * rest:.6g}" if abs(1e-3 * rest / natural - 1) < STRETCHED else ""
                say(f"{field}.rest_length = {rest:.6g} m: in the rod at rest the line is {natural:.6g} m long{found}")
        if rubs > RUBBING:
            say(f"{field}.friction = {rubs:.6g} is a coefficient, seldom above 0.5; if it is in percent, give {rubs / 100:.6g}")


def _of_chambers(rod: "Rod", young: float) -> None:
    stretches = any(np.isfinite(section.axial_stiffness).any() for section in rod.sections)
    if (
        young < LENGTHENING
        and not stretches
        and any(line.drive is not None and line.drive[0] == "pressure" for line in rod.lines)
    ):
        say(
            f"Rod.young_modulus = {young:.6g} Pa with a Chamber and without axial stiffness: pressure bends such a rod and "
            "does not lengthen it, as it does soft ones; give extensible=True"
        )


def _turns(line: "Line") -> float:
    """How often a route winds around the centreline of its rod."""
    if line._resolved is None:
        return 0.0
    powers = np.linspace(-1, 1, 9)[:, None] ** np.arange(line._resolved.coefficients.shape[1])
    x, y = (powers @ line._resolved.coefficients).reshape(-1, 2).T
    away = np.hypot(x, y) > 0
    return float(np.ptp(np.unwrap(np.arctan2(y, x)[away]))) / (2 * math.pi) if away.any() else 0.0
