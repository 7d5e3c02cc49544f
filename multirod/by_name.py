"""Inputs given by the names of rods, lines, bodies or joints: where their numbers stand, and what a change of some leaves."""

from collections.abc import Iterable, Mapping, Sequence
from itertools import accumulate
from typing import TYPE_CHECKING, Any

import numpy as np

from multirod.inputs import Inputs, InputSpec
from multirod.naming import meant
from multirod.rod import Rod
from multirod.validation import Described, FloatArray, array, known_as, refuse

if TYPE_CHECKING:
    from multirod.assembly import Assembly


def the_only_backbone(field: str, robot: "Assembly") -> int:
    """The first rod, which is meant where none is named and all rods are one, or tubes in each other."""
    try:
        apart = len(robot.backbones)
    except NotImplementedError:  # as tubes side by side, each bent in its own way
        apart = len(robot.rods)
    if apart > 1:
        names = known_as([own.name for own in robot.rods])
        raise ValueError(f"{field} is not given: of {apart} rods that stand apart it {names}")
    return 0


def each_named(rods: Sequence[Rod], specs: Iterable[InputSpec]) -> dict[str, dict[str, int]]:
    """How many numbers of inputs per rod, or of what drives lines, belong to each by its name: to lines where each that is
    driven so has a name of its own, or else to their rods where each of these has one."""
    names = [rod.name for rod in rods]
    names = names if _differ(names) else []
    result = {}
    for spec in specs:
        if spec.per_rod:
            result[spec.name] = dict.fromkeys(names, 1)
        elif spec.acts == "lines":
            lines, owners = driven_lines(rods, spec.name)
            by_rod = {name: owners.count(name) for name in names if name in owners}
            result[spec.name] = dict.fromkeys(lines, 1) or by_rod
    return result


def by_parts(robot: "Assembly", name: str, value: Mapping[Any, Any], present: Inputs | None = None) -> dict[Any, Any]:
    """Values by the names of lines, where each so driven has one of its own, as those of their rods, by whose names an input is
    taken. What is not named of a rod is as in ``present``, or zero."""
    places = parts_of(robot, name)
    numbers = {line: k for k, line in enumerate(driven_lines(robot.rods, name)[0])}
    if not numbers or set(numbers) & set(places) or not set(numbers) & set(value):
        return dict(value)
    given = {numbers[line]: array(f"{name}[{line!r}]", value[line]) for line in value if line in numbers}
    result = {key: own for key, own in value.items() if key not in numbers}
    for part, place in places.items():
        own = range(place.start, place.stop)
        if not set(own) & set(given):
            continue
        if part in result:
            refuse(name, part, f"must not be given beside a line of it, {min(set(numbers) & set(value))!r}")
        kept = np.zeros(len(own)) if present is None else getattr(present, name)[..., place]
        each = [given.get(k, kept[..., k - place.start]) for k in own]
        result[part] = np.stack(np.broadcast_arrays(*each), axis=-1) if len(own) > 1 else each[0]
    return result


def driven_lines(rods: Sequence[Rod], name: str) -> tuple[list[str], list[str]]:
    """Names of the lines that are driven by an input, none where these are not different names, and of their rods."""
    driven = [(line.name, rod.name) for rod in rods for line in rod.lines if line.drive and line.drive[0] == name]
    lines = [line for line, _ in driven]
    return lines if _differ(lines) else [], [rod for _, rod in driven]


def _differ(names: Sequence[str]) -> bool:
    return all(names) and len(set(names)) == len(names)


def arranged(robot: "Assembly", name: str, value: Mapping[Any, Any]) -> FloatArray:
    """Values by name as an array (..., numbers of all); zero what is not named.

    Raises:
        ValueError: If a name is none that the input is taken by, a value has not as many numbers as belong to it, or leading axes
            do not broadcast.
    """
    sizes = robot.numbers_by_name[name]
    parts: dict[str, FloatArray] = {part: np.zeros(size) for part, size in sizes.items()}
    for key, part in by_parts(robot, name, value).items():
        if key not in sizes:
            known = list(dict.fromkeys((*sizes, *driven_lines(robot.rods, name)[0])))
            hint = meant(key, known) if isinstance(key, str) else ""
            refuse(name, key, f"must be by name, one of {', '.join(map(repr, known))}{hint}")
        own = array(f"{name}[{key!r}]", part, (sizes[key],) if sizes[key] > 1 else ())
        parts[key] = own if sizes[key] > 1 else own[..., None]
    try:
        shape = np.broadcast_shapes(*(part.shape[:-1] for part in parts.values()))
    except ValueError:
        shapes = ", ".join(f"{key!r} {part.shape[:-1]}" for key, part in parts.items() if part.ndim > 1)
        refuse(name, Described(f"leading axes {shapes}"), "these must broadcast")
    return np.concatenate([np.broadcast_to(part, (*shape, part.shape[-1])) for part in parts.values()], axis=-1)


def parts_of(robot: "Assembly", name: str) -> dict[str, slice]:
    """Where among the numbers of an input those stand that are taken by name; none where it is not."""
    sizes = robot.numbers_by_name.get(name, {})
    return {part: slice(end - sizes[part], end) for part, end in zip(sizes, accumulate(sizes.values()), strict=True)}


def completed(robot: "Assembly", present: Inputs, changes: Mapping[str, Any]) -> dict[str, Any]:
    """Changes of inputs, those by name with the present values of what they do not name."""
    result = dict(changes)
    for name, value in changes.items():
        if isinstance(value, Mapping):
            kept = {}
            for part, own in parts_of(robot, name).items():
                kept[part] = getattr(present, name)[..., own if own.stop - own.start > 1 else own.start]
            result[name] = kept | by_parts(robot, name, value, present)
    return result
