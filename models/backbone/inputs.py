"""The inputs of a backbone, what they mean, and which of their values are refused."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from multirod.inputs import Inputs, InputSpec
from multirod.models.backbone.members.member import drives, kinds
from multirod.rod import Rod
from multirod.validation import refuse

BACKBONE_INPUTS = (
    InputSpec(name="rotation", unit="rad", per_rod=True, description="angle of each rod's base about its axis"),
    InputSpec(name="translation", unit="m", per_rod=True, description="how far each rod is pushed out of the base"),
    InputSpec(
        name="tip_force", unit="N", acts="tip", load="force", potential=True, description="dead force on the tip, world frame"
    ),
    InputSpec(name="tip_moment", unit="N m", acts="tip", load="moment", description="dead moment on the tip, world frame"),
    InputSpec(
        name="follower_force",
        unit="N",
        acts="tip",
        load="force",
        follows=True,
        dead_twin="tip_force",
        description="force on the tip, fixed in the tip frame",
    ),
    InputSpec(
        name="follower_moment",
        unit="N m",
        acts="tip",
        load="moment",
        follows=True,
        description="moment on the tip, fixed in the tip frame",
    ),
    InputSpec(
        name="distributed_force",
        unit="N/m",
        acts="along",
        load="force",
        potential=True,
        function=True,
        description="dead force per length, world frame",
    ),
    InputSpec(
        name="distributed_moment",
        unit="N",
        acts="along",
        load="moment",
        function=True,
        description="dead moment per length, world frame",
    ),
    InputSpec(
        name="gravity",
        unit="m/s^2",
        acts="along",
        load="force",
        potential=True,
        description="acceleration, world frame; acts on linear_density",
    ),
    InputSpec(
        name="magnetic_field",
        unit="T",
        acts="along",
        load="moment",
        potential=True,
        description="uniform magnetic field, world frame; acts on magnetisation",
    ),
)
TIP_CURVATURE = InputSpec(
    name="tip_curvature",
    unit="1/m",
    acts="sensor",
    optional=True,
    measured=True,
    description="measured curvature at the tip, tip frame",
)
_BEHIND = "where each tube starts: at the plate, 0, or behind it, negative"
TUBE_INPUTS = tuple(replace(spec, description=_BEHIND) if spec.name == "translation" else spec for spec in BACKBONE_INPUTS)
DRIVES: dict[str, dict[str, Any]] = {
    "tension": {
        "unit": "N",
        "load": "force",
        "potential": True,
        "description": "of each line that is driven by it, in their order, >= 0",
    },
    "pressure": {
        "unit": "Pa",
        "load": "force",
        "potential": True,
        "description": "in each chamber, in their order",
    },
    "displacement": {
        "unit": "m",
        "description": "how far each line that is driven by it is pulled out of the base, in their order",
    },
}  # inputs that drive lines, where there are such lines


DRIVE_INPUTS = tuple(InputSpec(name=name, acts="lines", **meaning) for name, meaning in DRIVES.items())


def drive_specs(rods: Sequence[Rod]) -> tuple[InputSpec, ...]:
    """The inputs that drive lines of these rods, one number a line."""
    counts = {
        name: sum(line.drive is not None and line.drive[0] == name for rod in rods for line in rod.lines) for name in DRIVES
    }
    return tuple(replace(spec, count=counts[spec.name]) for spec in DRIVE_INPUTS if counts[spec.name])


LOADS = tuple(spec for spec in BACKBONE_INPUTS if spec.load is not None)
BY_MATERIAL = ("gravity", "magnetic_field")  # inputs that act on a property which rods may lack


def check_drives(inputs: Inputs, rods: Sequence[Rod]) -> None:
    """Refuse what lines cannot be driven by, by a ``ValueError``."""
    if "tension" not in inputs.given:
        return
    if np.min(inputs.tension, initial=0.0) < 0:
        refuse("tension", inputs.tension.tolist(), "must be >= 0: a tendon cannot push")
    first = 0
    for rod in rods:
        count = drives(kinds(rod.lines)).count("tension")
        own = inputs.tension[..., first : first + count]
        if rod.discs is not None and count:
            softest = min(float(np.min(section.bending_stiffness)) for section in rod.sections)
            if np.max(own.sum(axis=-1), initial=0.0) * rod.discs**2 >= np.pi**2 * softest:
                refuse(
                    "tension",
                    own.tolist(),
                    f"must be < {np.pi**2 * softest / rod.discs**2:.3g} N together: between discs the rod buckles",
                )
        first += count


def check_reach(inputs: Inputs, rods: Sequence[Rod], *, straight: bool = False) -> None:
    """Refuse translations by which it is not told what lines do, by a ``ValueError``; rods may be ``straight`` behind a plate."""
    for k, rod in enumerate(rods):
        own = inputs.translation[..., k]
        for line in rod.lines:
            reach = line.reach_straight if straight else line.reach
            if np.min(own, initial=0.0) < -reach:
                refuse(
                    "translation",
                    inputs.translation.tolist(),
                    f"must be >= {0.0 - reach:g} m: beyond, the length at rest of line {line.name!r} varies",
                )


def surely_driven(name: str, values: Sequence[float], rods: Sequence[Rod]) -> bool:
    """Whether lines of these rods can surely be driven by these values of one of ``DRIVES``."""
    return name != "tension" or (min(values) >= 0 and all(rod.discs is None for rod in rods))
