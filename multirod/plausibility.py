"""Numbers that are allowed and hardly meant: in other units, exchanged, of another quantity; ``docs/mistakes.md``."""

import math
import sys
import warnings
from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from multirod.batch import broadcast_shapes
from multirod.profile import Profile
from multirod.validation import FloatArray

if TYPE_CHECKING:
    from multirod.assembly import Assembly
    from multirod.inputs import Inputs
    from multirod.rod import Rod


class PlausibilityWarning(UserWarning):
    """Of a number that is allowed and hardly meant, such as a length in mm.

    It names the field, its value, what that means and what was probably meant. It is given once, where the thing is made.
    ``warnings.simplefilter("ignore", mr.PlausibilityWarning)`` is for who means it, ``"error"`` for who never does.
    """


@dataclass(frozen=True)
class Limit:
    """The values of a quantity about which nothing is said.

    Attributes:
        low: The least.
        high: The greatest.
        unit: SI unit.
        below: What less than ``low`` is.
        above: What more than ``high`` is.
        others: Units that it may have been given in, and what they are in ``unit``.
    """

    low: float
    high: float
    unit: str
    below: str
    above: str
    others: tuple[tuple[str, float], ...] = ()

    def odd(self, values: object) -> float | None:
        """The value that is furthest outside, if one is; zero and infinity are not."""
        sizes = np.abs(np.asarray(values, dtype=np.float64)).ravel()
        sizes = sizes[(sizes > 0) & (sizes < math.inf)]
        if not sizes.size:
            return None
        least, greatest = float(sizes.min()), float(sizes.max())
        return greatest if greatest > self.high else least if least < self.low else None

    def check(self, field: str, values: object) -> bool:
        """Warn if a value is outside; returns whether one is."""
        odd = self.odd(values)
        if odd is None:
            return False
        say(f"{field} = {_with_unit(odd, self.unit)} {self.above if odd > self.high else self.below}; {self.meant(odd)}")
        return True

    def meant(self, value: float) -> str:
        """What a value may have been, in other units."""
        likely = [(name, value * factor) for name, factor in self.others if self.low <= value * factor <= self.high]
        if not likely:
            return f"its unit is {self.unit}" if self.unit else "check what it is made of"
        return "if it is " + ", ".join(f"in {name}, give {found:.6g}" for name, found in likely)


_OF_LENGTH = (("mm", 1e-3), ("cm", 1e-2), ("inches", 0.0254))
_OF_MODULUS = (("GPa", 1e9), ("MPa or N/mm^2", 1e6))

LENGTH = Limit(1e-4, 10.0, "m", "is less than 0.1 mm", "is more than 10 m", _OF_LENGTH)
YOUNG = Limit(1e5, 2e12, "Pa", "is softer than soft rubber, 1e5 Pa", "is stiffer than any material, 2e12 Pa", _OF_MODULUS)
SHEAR = Limit(3e4, 1e12, "Pa", "is softer than soft rubber, 3e4 Pa", "is stiffer than any material, 1e12 Pa", _OF_MODULUS)
POISSON = Limit(-0.1, 0.5 + 1e-9, "", "", "")  # that of rubber, and its rounding
DENSITY = Limit(
    10.0,
    3e4,
    "kg/m^3",
    "is lighter than foam, 10 kg/m^3",
    "is heavier than osmium, 3e4 kg/m^3",
    (("g/cm^3", 1e3), ("g/m^3", 1e-3)),
)
SPECIFIC = Limit(50.0, 1e9, "m^2/s^2", "", "")  # E over density: some 1e2 of silicone, 2.5e7 of metals, 3.5e8 of diamond
SLENDER = Limit(1.0, 1e5, "", "", "")  # length over outer diameter
SOFT = Limit(1e-8, 1e4, "N", "", "")  # EI/L^2, about the force that bends a rod
WINDING = 40.0  # turns that a precurvature bends a rod by, or a moment
HARDLY = (1e-3, 0.05)  # rad that a precurvature bends a whole rod by: more than noise, less than is seen
TWISTING = 0.64  # GJ over EI_x + EI_y: 0.63 of published tubes; of one material 0.5/(1 + its Poisson ratio)
WIDE = 10.0  # times the outer diameter, that is implied by EI over EA
MAGNETISED = 3e6  # A/m: no magnet has more than some 2e6
ASIDE = 0.5  # of the length, that a line or tube lies beside its rod
STRETCHED = 0.2  # of the length of a line at rest, that it is too short or too long
RUBBING = 2.0  # coefficient of friction
LOAD = 2e4  # EI/L^2
GRAVITY = 100.0  # m/s^2
FIELD = 10.0  # T
PRESSURE = Limit(1e3, 1e8, "Pa", "is less than 0.01 bar", "is more than 1000 bar", (("kPa", 1e3), ("bar", 1e5), ("MPa", 1e6)))
PUSHED = 5.0  # times its length, that a rod is pushed out of its base
DEGREES = (10.0, 8 * math.pi)  # rad: beyond the first multiples of 5, beyond the second anything
PLATFORM_MASS = 20.0  # kg
REACH = 2.0  # times the longest leg, that legs are apart or forces act beside the platform
DT = 1.0  # s
DEVIATION = (
    0.1,
    100.0,
)  # m: no sensor of positions is off by more than the first; beyond the second nothing is measured on purpose
FEW = 50  # numbers
STRAIN = 0.08  # beyond which superelastic alloys yield too
RUBBER_STRAIN, RUBBER = 0.5, 1e8  # the same of what is softer than so many Pa


class Material(NamedTuple):
    """What a rod was made of.

    Attributes:
        young: Young's modulus [Pa].
        shear: Shear modulus [Pa].
        density: [kg/m^3].
        shear_given: Whether the shear modulus was, and is not made of Poisson's ratio.
    """

    young: FloatArray
    shear: FloatArray
    density: float
    shear_given: bool = True


def say(message: str) -> None:
    """Warn of something, where the package was called."""
    frame, level = sys._getframe(1), 2
    while frame.f_back is not None and frame.f_globals.get("__name__", "").partition(".")[0] == "multirod":
        frame, level = frame.f_back, level + 1
    warnings.warn(message, PlausibilityWarning, stacklevel=level)


def _with_unit(value: float, unit: str) -> str:
    return f"{value:.6g} {unit}".strip()


def _largest(values: object) -> float:
    values = np.asarray(values)
    if values.size < FEW:  # NumPy takes several times as long
        return max(map(abs, values.ravel().tolist()), default=0.0)
    return float(np.max(np.abs(values)))


# ---- rods ----


def of_rod(rod: "Rod", material: Material | None) -> None:
    """Warn of what a rod is made of: of what was given first, of what follows from that only where all that is plausible."""
    length = float(np.max(rod.length))
    odd = LENGTH.check("Rod.length", rod.length)
    if material is not None:
        odd |= _of_material(material)
    odd = odd or _of_diameter(rod, length)
    if not odd:
        _of_stiffness(rod, material)
    _of_precurvature(rod, length)
    _of_mass(rod, material)
    _of_lines(rod, length)


def _of_material(material: Material) -> bool:
    E, G, density, shear_given = material
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
            "G is at most about E/2; are young_modulus and shear_modulus exchanged?" if low else "is G too small, or E too large?"
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


def _of_diameter(rod: "Rod", length: float) -> bool:
    outer = rod.outer_diameter
    if outer is None or SLENDER.odd(length / outer) is None:
        return False
    what = "is thicker than the rod is long" if outer > length else "is a hundred thousandth of the length and less"
    found = f"; if it is in mm, give {1e-3 * outer:.6g}" if SLENDER.odd(1e3 * length / outer) is None and outer > length else ""
    say(f"Rod.outer_diameter = {outer:.6g} m {what}, {length:.6g} m{found}")
    return True


def _of_stiffness(rod: "Rod", material: Material | None) -> None:
    EI = np.array([float(np.max(section.bending_stiffness)) for section in rod.sections])
    outer = rod.outer_diameter
    if material is None:
        if outer is not None:
            I = math.pi / 64 * (outer**4 - (rod.inner_diameter or 0.0) ** 4)
            found = YOUNG.odd(EI / I) if I > 0 else None
            if found is not None:
                what = YOUNG.above if found > YOUNG.high else YOUNG.below
                own = found * I
                mm = f"; if EI is in N mm^2, give {1e-6 * own:.6g}" if YOUNG.odd(1e-6 * EI / I) is None else ""
                of = f"Rod.bending_stiffness = {own:.6g} N m^2 at outer_diameter = {outer:.6g} m"
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
            made = f"young_modulus = {_largest(material.young):.6g} Pa, outer_diameter = {outer:.6g} m, length = {_length(rod)}"
            say(f"Rod of {made} {what}; are diameters and length in m, moduli in Pa?")
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
    outer = rod.outer_diameter
    for section in rod.sections if outer is not None else ():
        assert outer is not None
        EI = section.bending_stiffness.max(axis=-1)
        for name, stiffness in (("axial_stiffness", section.axial_stiffness), ("shear_stiffness", section.shear_stiffness)):
            finite = np.asarray(stiffness)[np.isfinite(stiffness)]
            implied = 4 * math.sqrt(float(EI.max()) / float(finite.max())) if finite.size else outer
            if not outer / WIDE <= implied <= outer * WIDE:
                say(
                    f"Rod.{name} = {float(finite.max()):.6g} N beside bending_stiffness = {float(EI.max()):.6g} N m^2 means a "
                    f"diameter of about {implied:.2g} m, not {outer:.6g} m: it is a modulus times an area, in N"
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
    radius = None if rod.outer_diameter is None else rod.outer_diameter / 2
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
        area = math.pi / 4 * (rod.outer_diameter**2 - (rod.inner_diameter or 0.0) ** 2)
        for section in rod.sections:
            odd = DENSITY.odd(section.linear_density / area) if area > 0 else None
            if odd is not None:
                grams = f"; if it is in g/m, give {1e-3 * odd * area:.6g}" if DENSITY.odd(1e-3 * odd) is None else ""
                what = DENSITY.above if odd > DENSITY.high else DENSITY.below
                say(f"Rod.linear_density = {odd * area:.6g} kg/m means a density of {odd:.3g} kg/m^3, which {what}{grams}")
                return
            if _largest(section.magnetisation) > MAGNETISED * area:
                most = _largest(section.magnetisation)
                say(
                    f"Rod.magnetisation = {most:.6g} A m is {most / area:.3g} A/m, more than any magnet; it is the magnetic "
                    f"moment per length: if it is in A/m, give it to Rod.tube or Rod.wire, or {most * area:.6g}"
                )
                return


def of_tube_magnetisation(magnetisation: FloatArray) -> None:
    """Warn of a magnetisation per volume."""
    most = _largest(magnetisation)
    if most > MAGNETISED:
        say(f"Rod.magnetisation = {most:.6g} A/m is more than any magnet has, some 1e6 A/m")
    elif 0 < most < 10:
        remanence = most / (4e-7 * math.pi)
        say(f"Rod.magnetisation = {most:.6g} A/m is next to nothing; if it is a remanence in T, give {remanence:.3g} A/m")


def _of_lines(rod: "Rod", length: float) -> None:
    if rod.discs is not None and rod.discs >= length:
        found = f"; if it is in mm, give {1e-3 * rod.discs:.6g}" if 1e-3 * rod.discs < length else ""
        say(f"Rod.discs = {rod.discs:.6g} m is a spacing beyond the rod's length, {length:.6g} m{found}")
    for line in rod.lines:
        field = type(line).__name__.removeprefix("Rubbing").removeprefix("Displaced").removeprefix("Section")
        there = np.linspace(line.start, min(line._last, length), 9)
        route: Any = line.offset if line.offset is not None else [line._offset_and_slope(s)[0] for s in there]
        aside = _largest(route)
        if aside > ASIDE * length:
            found = f"; if it is in mm, give {1e-3 * aside:.6g}" if 1e-3 * aside < ASIDE * length else ""
            say(f"{field}.offset = {aside:.6g} m is beside a rod of {length:.6g} m, further than half its length{found}")
        area = getattr(line, "area", None)
        if area is not None and math.sqrt(float(np.max(area))) > length:
            found = f"; if it is in mm^2, give {1e-6 * float(np.max(area)):.6g}"
            say(f"{field}.area = {float(np.max(area)):.6g} m^2 is wider than the rod is long, {length:.6g} m{found}")
        rest, rubs = getattr(line, "rest_length", None), _largest(getattr(line, "friction", 0.0))
        if rest is not None and np.ndim(rod.length) == 0:
            natural = float(np.max(line.length_at_rest(rod.sections)))
            if abs(rest - natural) > STRETCHED * natural:
                found = f"; if it is in mm, give {1e-3 * rest:.6g}" if abs(1e-3 * rest / natural - 1) < STRETCHED else ""
                say(f"{field}.rest_length = {rest:.6g} m: in the rod at rest the line is {natural:.6g} m long{found}")
        if rubs > RUBBING:
            say(f"{field}.friction = {rubs:.6g} is a coefficient, seldom above 0.5; if it is in percent, give {rubs / 100:.6g}")


# ---- robots ----


def of_pose(field: str, poses: FloatArray) -> None:
    """Warn of poses that are far away."""
    LENGTH.check(f"{field} position", np.maximum(np.abs(poses[..., :3, 3]), LENGTH.low))


def of_place(field: str, position: FloatArray | None) -> None:
    """Warn of a place, of a target or measured, that is far away; what is missing of it is NaN."""
    if position is not None and not np.abs(position).max(initial=0.0) <= LENGTH.high:
        LENGTH.check(field, np.maximum(np.abs(position), LENGTH.low))


def of_limits(field: str, name: str, values: FloatArray) -> None:
    """Warn of limits of what tubes are moved and turned by, in other units; infinite ones are none."""
    finite = values[np.isfinite(values)]
    if name == "translation":
        of_place(field, finite)
    elif name == "rotation" and finite.size and np.any(finite):
        _of_angles(field, finite, _largest(finite))


def of_pose_sigma(sigma: FloatArray, position: bool) -> None:
    """Warn of a standard deviation (2,) of positions that is no measurement's, where there are any."""
    if position and DEVIATION[0] < sigma[0] < DEVIATION[1]:
        say(f"Pose.sigma = {sigma[0]:.6g} m of a position says next to nothing of it; if it is in mm, give {1e-3 * sigma[0]:.6g}")


def of_legs(base: FloatArray, platform: FloatArray, mass: float, rods: "tuple[Rod, ...]") -> None:
    """Warn of legs that are further apart than they are long, and of a heavy platform."""
    longest = max(float(np.max(rod.length)) for rod in rods)
    for name, poses in (("base", base), ("platform", platform)):
        size = _largest(np.linalg.norm(poses[..., :3, 3] - poses[..., :1, :3, 3], axis=-1))
        if REACH * longest < size <= LENGTH.high:
            say(
                f"ParallelRods.{name}: legs of at most {longest:.6g} m are {size:.6g} m apart; positions are in m, those of "
                "platform in the platform's frame"
            )
    if mass > PLATFORM_MASS:
        say(f"ParallelRods.platform_mass = {mass:.6g} kg is heavy for slender legs; if it is in g, give {1e-3 * mass:.6g}")


def of_body(name: str, mass: float) -> None:
    """Warn of a heavy body."""
    if mass > PLATFORM_MASS:
        say(f"Body.mass = {mass:.6g} kg of {name!r} is heavy for slender rods; if it is in g, give {1e-3 * mass:.6g}")


def of_offsets(offsets: FloatArray, rods: "tuple[Rod, ...]") -> None:
    """Warn of tubes that are far from the line that they run along."""
    aside, length = _largest(offsets), max(float(np.max(rod.length)) for rod in rods)
    if aside > ASIDE * length:
        say(
            f"EccentricTubes.offsets of {aside:.6g} m are more than half of the length, {length:.6g} m; if they are in mm, give "
            f"{1e-3 * aside:.6g}"
        )


def of_dt(field: str, dt: float, loop: str = "an observer") -> None:
    """Warn of a time step that is no step of a control loop."""
    if dt > DT:
        milli = f"if it is in ms, give {1e-3 * dt:.6g}"
        say(f"{field} = {dt:.6g} s between samples is slow for {loop}; {milli}, if a rate in Hz, {1 / dt:.6g}")


# ---- inputs ----


def of_inputs(robot: "Assembly", inputs: "Inputs") -> None:
    """Warn of actuation and loads, and of pairs that may have been meant as a batch."""
    _of_pairs(robot, inputs)
    for name in inputs.given:
        spec = inputs.spec(name)
        values = _values(inputs, name)
        most = _largest(values)
        if not most:
            continue
        if name in ("rotation", "platform_rotation", "angle"):
            _of_angles(name, values, most)
        elif name == "gravity":
            _of_gravity(values, most, robot)
        elif name == "magnetic_field" and most > FIELD:
            say(f"magnetic_field = {most:.6g} T is more than any scanner's; if it is in mT, give {1e-3 * most:.6g}")
        elif name == "pressure":
            PRESSURE.check(name, most)
        elif spec.unit == "m":
            _of_place(name, most, robot)
        elif spec.power and name not in ("gravity", "magnetic_field"):
            _of_load(name, spec.load == "moment", most, spec.power, robot)


def _of_pairs(robot: "Assembly", inputs: "Inputs") -> None:
    batch_shape = broadcast_shapes(robot.batch_shape, inputs.batch_shape)
    if batch_shape[-1:] != (2,):
        return
    for rod in robot.rods:
        for section in rod.sections:
            for name in section.flat_pairs:
                first, second = (f"{value:.6g}" for value in getattr(section, name).tolist())
                say(
                    f"Rod.{name} = [{first}, {second}] is the pair about x and about y of each rod, beside a batch of "
                    f"{batch_shape}; if it is one for each instance, give [[{first}], [{second}]], shape (2, 1); if it is "
                    f"the pair, a tuple, ({first}, {second})"
                )
                return


def _values(inputs: "Inputs", name: str) -> FloatArray:
    profile = inputs.profile(name)
    if profile is None:
        return inputs.array(name)
    return np.array([profile(s) for s in np.linspace(0, profile.ends[-1], 9)])


def _of_angles(name: str, values: FloatArray, most: float) -> None:
    whole, any_ = DEGREES
    if most > any_ or (most >= whole and not np.any(values % 5)):
        say(f"{name} = {most:.6g} rad is {most / (2 * math.pi):.3g} turns; if it is in degrees, give {math.radians(most):.6g}")


def _of_gravity(values: FloatArray, most: float, robot: "Assembly") -> None:
    size = float(np.linalg.norm(values, axis=-1).max())
    if size > GRAVITY:
        say(
            f"gravity = {size:.6g} m/s^2 is {size / 9.81:.3g} times that of the earth; if it is in mm/s^2, give {1e-3 * size:.6g}"
        )
    elif size == 1.0 and any(rod.outer_diameter is not None for rod in robot.rods):  # others may be without units
        say("gravity = 1 m/s^2 is a tenth of that of the earth; if it is in g, or a direction, give 9.81 along it")


def _of_place(name: str, most: float, robot: "Assembly") -> None:
    length = robot.longest
    limit = PUSHED * length if name == "translation" else REACH * length
    if most > limit:
        found = f"; if it is in mm, give {1e-3 * most:.6g}" if 1e-3 * most <= limit else ""
        say(f"{name} = {most:.6g} m is far for a rod of {length:.6g} m{found}")


def _of_load(name: str, moment: bool, most: float, power: int, robot: "Assembly") -> None:
    if any(rod.members for rod in robot.rods):  # which may be what carries it
        return
    length, EI = robot.longest, robot.stiffest
    with np.errstate(over="ignore"):
        size = most * np.float64(length) ** power / EI
    if moment and size > 2 * math.pi * WINDING:
        turns = f"winds a rod of EI = {EI:.3g} N m^2 and {length:.6g} m up {size / (2 * math.pi):.3g} times"
        say(f"{name} = {most:.6g} {turns}; is it in N mm, or the stiffness not in N m^2?")
    elif not moment and size > LOAD:
        what = f"is {size:.3g} EI/L^2 of a rod of EI = {EI:.3g} N m^2 and {length:.6g} m, of which some 10 bend it double"
        say(f"{name} = {most:.6g} {what}; forces are in N, stiffnesses in N m^2, moduli in Pa")


# ---- solutions ----


def of_bases(robot: "Assembly", unknowns: FloatArray, left_out: NDArray[np.bool_]) -> bool:
    """Warn of strain at the base of a single rod, which its unknowns tell; returns whether there is too much."""
    rod = robot.rods[0]
    if rod.outer_diameter is None:
        return False
    change = robot.bent_at_base(unknowns)
    if change is None:
        return False
    change[left_out] = 0.0
    return of_strain(rod, rod.name or "the rod", rod.outer_diameter / 2 * float(np.linalg.norm(change, axis=-1).max(initial=0.0)))


def of_strains(robot: "Assembly", strain: FloatArray) -> bool:
    """Warn of the strain (count, rod_count) of rods, NaN where it does not matter; returns whether there is too much."""
    largest = np.where(np.isfinite(strain), strain, 0.0).max(axis=0, initial=0.0)
    names = [rod.name or (f"rod {k}" if robot.rod_count > 1 else "the rod") for k, rod in enumerate(robot.rods)]
    return any(of_strain(rod, name, float(most)) for rod, name, most in zip(robot.rods, names, largest, strict=True))


def of_strain(rod: "Rod", name: str, strain: float) -> bool:
    """Warn of a strain that the material of a rod hardly bears."""
    outer = rod.outer_diameter
    if outer is None or not strain > STRAIN:
        return False
    EI = max(float(np.max(section.bending_stiffness)) for section in rod.sections)
    soft = RUBBER * math.pi / 64 * (outer**4 - (rod.inner_diameter or 0.0) ** 4) > EI
    limit = RUBBER_STRAIN if soft else STRAIN
    if strain <= limit:
        return False
    say(
        f"solution: the outer fibre of {name} is strained by {100 * strain:.3g} %, more than {100 * limit:.0f} %: it would "
        "break, or not come back; check forces [N], stiffnesses [N m^2], lengths and diameters [m]"
    )
    return True
