"""Values of a backbone's inputs that are refused."""

from collections.abc import Sequence

import numpy as np

from multirod.inputs import Inputs
from multirod.models.backbone.kernels.layout.members import drives
from multirod.models.backbone.members.member import kinds
from multirod.rod import Rod
from multirod.validation import Described, refuse


def check_drives(inputs: Inputs, rods: Sequence[Rod]) -> None:
    """Refuse what lines cannot be driven by, by a ``ValueError``."""
    if "tension" not in inputs.given:
        return
    pushes = (inputs.tension < 0).any(axis=-1)
    if pushes.any():
        at = tuple(np.argwhere(pushes)[0].tolist())
        place = Described(f"{inputs.tension[at].tolist()} at {list(at)}") if at else inputs.tension.tolist()
        refuse("tension", place, "must be >= 0: a tendon cannot push")
    first = 0
    for rod in rods:
        count = drives(kinds(rod.lines)).count("tension")
        own = inputs.tension[..., first : first + count]
        if rod.discs is not None and count:
            softest = min(float(np.min(section.bending_stiffness)) for section in rod.sections)
            buckles = own.sum(axis=-1) * rod.discs**2 >= np.pi**2 * softest
            if buckles.any():
                refuse(
                    "tension",
                    own[buckles][0].tolist(),
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
