"""What a rod carries, checked when it is made: members, loads, lines."""

from typing import TYPE_CHECKING

import numpy as np

from multirod.validation import refuse

if TYPE_CHECKING:
    from multirod.models.backbone.kernels.loads.load import Load
    from multirod.models.backbone.members.lines import Line
    from multirod.models.backbone.members.member import Member
    from multirod.rod.rod import Rod


def members_of(given: object) -> "tuple[Member, ...]":
    """Checked members."""
    from multirod.models.backbone.members.member import Member

    if not isinstance(given, (list, tuple)) or not all(isinstance(member, Member) for member in given):
        refuse("Rod.members", given, "must be a list of Member")
    return tuple(given)


def loads_of(given: object) -> "tuple[Load, ...]":
    """Checked loads, one of each kind."""
    if isinstance(given, (list, tuple)) and not given:
        return ()
    from multirod.models.backbone.kernels.loads.load import Load

    if not isinstance(given, (list, tuple)) or not all(isinstance(load, Load) for load in given):
        refuse("Rod.loads", given, "must be a list of Load")
    kinds = [type(load).__name__ for load in given]
    if len(set(kinds)) < len(kinds):
        refuse("Rod.loads", kinds, "must be one of each kind")
    return tuple(given)


def lines_of(given: object, rod: "Rod") -> "tuple[Line, ...]":
    """Checked lines, on the sections of the rod."""
    if isinstance(given, (list, tuple)) and not given:
        return ()
    from multirod.models.backbone.members.line_kinds import refuse_beside_friction, refuse_redundant
    from multirod.models.backbone.members.lines import Line

    if not isinstance(given, (list, tuple)) or not all(isinstance(line, Line) for line in given):
        refuse("Rod.lines", given, "must be a list of lines, such as Tendon")
    names = [line.name for line in given if line.name]
    for name in names:
        if names.count(name) > 1:
            refuse("Rod.lines", names, f"must have names of their own, and {name!r} is there twice")
    refuse_redundant(given, any(np.isfinite(section.axial_stiffness).any() for section in rod.sections))
    refuse_beside_friction(given, rod.members)
    return tuple(line.on(rod.sections, rod.discs or 0.0) for line in given)
