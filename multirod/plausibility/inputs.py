"""Of inputs: angles, pushes, loads."""

import math
from typing import TYPE_CHECKING

import numpy as np

from multirod.batch import broadcast_shapes
from multirod.plausibility.limits import DEGREES, FIELD, GRAVITY, LOAD, MATRIX, PRESSURE, PUSHED, REACH, WINDING, largest
from multirod.plausibility.rods import of_nothing
from multirod.plausibility.warning import say
from multirod.rotations import is_rotation
from multirod.validation import FloatArray

if TYPE_CHECKING:
    from multirod.assembly import Assembly
    from multirod.inputs import Inputs


def of_inputs(robot: "Assembly", inputs: "Inputs") -> None:
    """Warn of actuation and loads, and of pairs that may have been meant as a batch."""
    _of_pairs(robot, inputs)
    for name in inputs.given:
        spec = inputs.spec(name)
        values = _values(inputs, name)
        most = largest(values)
        if not most:
            if (profile := inputs.profile(name)) is not None:
                of_nothing(name, profile)
            continue
        if spec.unit == "rad" and not spec.per_rod:
            _of_matrix(name, values)
        if spec.unit == "rad":
            of_angles(name, values, most)
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


def of_angles(name: str, values: FloatArray, most: float) -> None:
    """Warn of angles that look like degrees; ``most`` is the largest."""
    whole, any_ = DEGREES
    if most > any_ or (most >= whole and not np.any(values % 5)):
        say(f"{name} = {most:.6g} rad is {most / (2 * math.pi):.3g} turns; if it is in degrees, give {math.radians(most):.6g}")


def _of_matrix(name: str, values: FloatArray) -> None:
    if values.shape != (3, 3) or not is_rotation(values, MATRIX):
        return
    say(
        f"{name}, shape (3, 3), is a rotation matrix, and taken for a batch of three rotation vectors; if it is one rotation, "
        "give its vector, scipy.spatial.transform.Rotation.from_matrix(R).as_rotvec()"
    )


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
    if most * length**power <= (2 * math.pi * WINDING if moment else LOAD) * EI:  # whatever else carries it
        return
    medium = max(float(np.max(section.foundation)) for rod in robot.rods for section in rod.sections)  # which carries loads too
    with np.errstate(over="ignore"):
        size = most * np.float64(length) ** power / (EI + medium * length**4)
    if moment and size > 2 * math.pi * WINDING:
        turns = f"winds a rod of EI = {EI:.3g} N m^2 and {length:.6g} m up {size / (2 * math.pi):.3g} times"
        say(f"{name} = {most:.6g} {turns}; is it in N mm, or the stiffness not in N m^2?")
    elif not moment and size > LOAD:
        what = f"is {size:.3g} EI/L^2 of a rod of EI = {EI:.3g} N m^2 and {length:.6g} m, of which some 10 bend it double"
        say(f"{name} = {most:.6g} {what}; forces are in N, stiffnesses in N m^2, moduli in Pa")
