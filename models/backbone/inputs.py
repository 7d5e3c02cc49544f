"""The inputs of a backbone, and what they mean."""

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

from multirod.inputs import InputSpec

if TYPE_CHECKING:
    from multirod.rod import Rod

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
        on="linear_density",
        potential=True,
        description="acceleration, world frame; acts on linear_density",
    ),
    InputSpec(
        name="magnetic_field",
        unit="T",
        acts="along",
        load="moment",
        on="magnetisation",
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
CALLED = {"force": "tip_force", "moment": "tip_moment"}  # what robots of several load places call these where there is one
NOT_TAKEN = ("rod_force", "rod_moment")  # beside what acts on all rods alike, of which a backbone has but one
DRIVE_INPUTS = (
    InputSpec(
        name="tension",
        unit="N",
        acts="lines",
        load="force",
        potential=True,
        description="of each line that is driven by it, in their order, >= 0",
    ),
    InputSpec(
        name="pressure",
        unit="Pa",
        acts="lines",
        load="force",
        on="area",
        potential=True,
        description="in each chamber, in their order",
    ),
    InputSpec(
        name="displacement",
        unit="m",
        acts="lines",
        description="how far each line that is driven by it is pulled out of the base, in their order",
    ),
)  # where there are such lines
DRIVES = tuple(spec.name for spec in DRIVE_INPUTS)


def drive_specs(rods: "Sequence[Rod]") -> tuple[InputSpec, ...]:
    """The inputs that drive lines of these rods, one number a line."""
    counts = {
        name: sum(line.drive is not None and line.drive[0] == name for rod in rods for line in rod.lines) for name in DRIVES
    }
    return tuple(replace(spec, count=counts[spec.name]) for spec in DRIVE_INPUTS if counts[spec.name])


LOADS = tuple(spec for spec in BACKBONE_INPUTS if spec.load is not None)
BY_MATERIAL = ("gravity", "magnetic_field")  # inputs that act on a property which rods may lack
