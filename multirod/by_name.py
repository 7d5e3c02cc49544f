"""Inputs that are given by the names of rods, bodies or joints: where their numbers stand, and what a change of some leaves."""

from collections.abc import Mapping
from itertools import accumulate
from typing import Any

from multirod.assembly import Assembly
from multirod.inputs import Inputs


def parts_of(robot: Assembly, name: str) -> dict[str, slice]:
    """Where among the numbers of an input those stand that are taken by name; none where it is not."""
    sizes = robot.numbers_by_name.get(name, {})
    return {part: slice(end - sizes[part], end) for part, end in zip(sizes, accumulate(sizes.values()), strict=True)}


def completed(robot: Assembly, present: Inputs, changes: Mapping[str, Any]) -> dict[str, Any]:
    """Changes of inputs, those by name with the present values of what they do not name."""
    result = dict(changes)
    for name, value in changes.items():
        if isinstance(value, Mapping):
            kept = {}
            for part, own in parts_of(robot, name).items():
                kept[part] = getattr(present, name)[..., own if own.stop - own.start > 1 else own.start]
            result[name] = kept | dict(value)
    return result
