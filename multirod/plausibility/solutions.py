"""Of solutions: strains that no material bears."""

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from multirod.plausibility.limits import RUBBER, RUBBER_STRAIN, STRAIN
from multirod.plausibility.rods import second_moment
from multirod.plausibility.warning import say
from multirod.validation import FloatArray

if TYPE_CHECKING:
    from multirod.assembly import Assembly
    from multirod.rod import Rod


def of_bases(robot: "Assembly", unknowns: FloatArray, left_out: NDArray[np.bool_], diameter: FloatArray) -> bool:
    """Warn of strain at the base of a single rod, which its unknowns tell; returns whether there is too much.

    Args:
        robot: Whose first rod it is.
        unknowns: (count, unknown_count).
        left_out: (count,).
        diameter: Of the rod, outer [m], () or (count,).
    """
    rod = robot.rods[0]
    change = robot.bent_at_base(unknowns)
    if change is None:
        return False
    change[left_out] = 0.0
    return of_strain(rod, rod.name or "the rod", float((diameter / 2 * np.linalg.norm(change, axis=-1)).max(initial=0.0)))


def of_strains(robot: "Assembly", strain: FloatArray) -> bool:
    """Warn of the strain (count, rod_count) of rods, NaN where it does not matter; returns whether there is too much."""
    largest = np.where(np.isfinite(strain), strain, 0.0).max(axis=0, initial=0.0)
    names = [rod.name or (f"rod {k}" if robot.rod_count > 1 else "the rod") for k, rod in enumerate(robot.rods)]
    return any(of_strain(rod, name, float(most)) for rod, name, most in zip(robot.rods, names, largest, strict=True))


def of_strain(rod: "Rod", name: str, strain: float) -> bool:
    """Warn of a strain that the material of a rod hardly bears."""
    if rod.outer_diameter is None or not strain > STRAIN:
        return False
    I = second_moment(rod)
    soft = all((section.bending_stiffness.max(axis=-1) < RUBBER * I).all() for section in rod.sections)
    limit = RUBBER_STRAIN if soft else STRAIN
    if strain <= limit:
        return False
    say(
        f"solution: the outer fibre of {name} is strained by {100 * strain:.3g} %, more than {100 * limit:.0f} %: it would "
        "break, or not come back; check forces [N], stiffnesses [N m^2], lengths and diameters [m]"
    )
    return True
