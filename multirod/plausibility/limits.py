"""The values of quantities about which nothing is said, in one table; ``docs/mistakes.md``."""

import math
from dataclasses import dataclass

import numpy as np

from multirod.plausibility.warning import say, with_unit


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
        say(f"{field} = {with_unit(odd, self.unit)} {self.above if odd > self.high else self.below}; {self.meant(odd)}")
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
COILED = 10.0  # turns of a line around its rod: a quarter of one in degrees is 14
LENGTHENING = 1e7  # Pa: what is softer is lengthened by pressure that is worth having
RUBBING = 2.0  # coefficient of friction
LOAD = 2e4  # EI/L^2
GRAVITY = 100.0  # m/s^2
FIELD = 10.0  # T
PRESSURE = Limit(1e3, 1e8, "Pa", "is less than 0.01 bar", "is more than 1000 bar", (("kPa", 1e3), ("bar", 1e5), ("MPa", 1e6)))
PUSHED = 5.0  # times its length, that a rod is pushed out of its base
MATRIX = 2e-5  # what R R^T of three rotation vectors may be off the identity, to be a rotation matrix
DEGREES = (10.0, 8 * math.pi)  # rad: beyond the first multiples of 5, beyond the second anything
PLATFORM_MASS = 20.0  # kg
REACH = 2.0  # times the longest leg, that legs are apart or forces act beside the platform
DT = 1.0  # s
DEVIATION = (
    0.1,
    100.0,
)  # m: no sensor of positions is off by more than the first; beyond the second nothing is measured on purpose
TURNED_BY = (0.35, 100.0)  # rad, likewise: 20 degrees
FLAT = (100.0, 1e5)  # EI/L^2 of a load that a prior allows: beyond the second who gives it means that nothing is known
FEW = 50  # numbers
STRAIN = 0.08  # beyond which superelastic alloys yield too
RUBBER_STRAIN, RUBBER = 0.5, 1e8  # the same of what is softer than so many Pa


def largest(values: object) -> float:
    """Of their sizes; zero of none."""
    values = np.asarray(values)
    if values.size < FEW:  # NumPy takes several times as long
        return max(map(abs, values.ravel().tolist()), default=0.0)
    return float(np.max(np.abs(values)))
