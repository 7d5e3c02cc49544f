"""Which inputs tasks choose, and which of their numbers: ``docs/tasks.md``."""

from collections.abc import Iterable, Mapping, Sequence
from itertools import accumulate
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from multirod.assembly import Assembly
from multirod.by_name import parts_of
from multirod.inputs import Inputs
from multirod.naming import meant, unknown_names
from multirod.validation import FloatArray, frozen, refuse

AT_BASES = ("rotation", "translation")  # what motors do to the rods that are ``Assembly.driven``


class Freed(tuple[str, ...]):
    """Names of inputs that a task chooses; of some of them, by ``parts``, only what belongs to the rods, lines,
    bodies or joints named.

    Attributes:
        parts: Of these inputs the names of what is chosen.
        numbers: Of these inputs which of their numbers are.
    """

    parts: Mapping[str, tuple[str, ...]]
    numbers: Mapping[str, tuple[int, ...]]

    def __new__(cls, names: Iterable[str], parts: Mapping[str, tuple[str, ...]], numbers: Mapping[str, tuple[int, ...]]) -> Self:
        """As a tuple is made."""
        result = super().__new__(cls, names)
        result.parts, result.numbers = dict(parts), dict(numbers)
        return result

    def __reduce__(self) -> tuple[Any, ...]:
        return type(self), (tuple(self), self.parts, self.numbers)

    def __eq__(self, other: object) -> bool:
        return super().__eq__(other) and isinstance(other, Freed) and self.numbers == other.numbers

    def __ne__(self, other: object) -> bool:
        return not self == other

    def __hash__(self) -> int:
        return hash((tuple(self), *self.numbers.items()))


def freed(field: str, robot: Assembly, free: object) -> tuple[str, ...]:
    """Checked names of inputs to be freed.

    Raises:
        TypeError: If one is not an input of the robot, or they are no names.
        ValueError: If there is none, or one twice, or it is a measurement.
    """
    names = (free,) if isinstance(free, str) else free
    if not isinstance(names, (list, tuple)) or not all(isinstance(name, str) for name in names):
        raise TypeError(f"{field} must be names of inputs, such as ('rotation', 'translation')")
    specs = {spec.name: spec for spec in robot.input_specs}
    own = [name for name in names if name not in specs and name in robot.parameters]
    if own:
        inputs = [name for name in names if name in specs]
        together = f", unknown={inputs[0] if len(inputs) == 1 else tuple(inputs)!r}" if inputs and field == "unknown" else ""
        raise TypeError(
            f"{field} takes inputs of the robot, and {own[0]!r} is a number of its rods: "
            f"mr.calibrate(parameters={own[0] if len(own) == 1 else own!r}{together}) finds that from measurements"
            + (", and the others with it" if together else " under known loads")
        )
    unknown_names(field, names, specs)
    if not names or len(set(names)) < len(names):
        refuse(field, tuple(names), "must name one input or several, each once")
    for name in names:
        if specs[name].measured:
            refuse(field, tuple(names), f"{name} is a measurement: it cannot be chosen")
        if specs[name].on and not np.any(robot.borne(specs[name])):
            refuse(field, tuple(names), f"{name} does nothing: no rod has a {specs[name].on}, on which it acts")
    return tuple(names)


def chosen(field: str, robot: Assembly, free: object) -> tuple[str, ...]:
    """The same of what a task chooses: also by name, ``{"translation": ["rod 0"]}``, where inputs are taken so; of rods at whose
    bases motors are, where the robot says which have some, those alone unless others are named.

    Raises:
        TypeError: As ``freed``.
        ValueError: Likewise, or if what is named is not there.
    """
    if isinstance(free, Freed):
        free = {name: free.parts.get(name) for name in free}
    given = {name: None for name in freed(field, robot, free)} if not isinstance(free, Mapping) else dict(free)
    names = freed(field, robot, tuple(given))
    by_name, parts = robot.numbers_by_name, {}
    for name in names:
        own = given[name]
        if own is not None:
            parts[name] = _named(f"{field}[{name!r}]", own, by_name.get(name, {}))
        elif name in AT_BASES and robot.driven is not None:
            parts[name] = robot.driven
    if not parts:
        return names
    numbers = {}
    for name, called in parts.items():
        places = parts_of(robot, name)
        numbers[name] = tuple(k for part, own in places.items() if part in called for k in range(own.start, own.stop))
    return Freed(names, parts, numbers)


def refuse_freed(where: str, names: Sequence[str], changes: Mapping[str, object], why: str) -> None:
    """Refuse changes of what a task chooses itself; what it leaves of an input may change by name.

    Raises:
        TypeError: If they are.
    """
    for name, value in changes.items():
        if name not in names:
            continue
        if not isinstance(names, Freed) or name not in names.parts:
            raise TypeError(f"{where} takes no {name!r}: it is {why}")
        own = names.parts[name]
        if not isinstance(value, Mapping) or any(part in own or not isinstance(part, str) for part in value):
            said = ", ".join(f"{name}[{part!r}]" for part in own)
            raise TypeError(f"{where} takes of {name!r} what is not {why}, by name, and not {said}")


def named(field: str, given: str, known: Iterable[str], allowed: Iterable[str] | None = None) -> None:
    """Refuse a name that is none of ``known``, or of ``allowed``."""
    known, allowed = tuple(known), tuple(known if allowed is None else allowed)
    if not known:
        refuse(field, given, "must not be by name: the robot takes this input by no names (of rods or lines, where each has one)")
    if given not in allowed:
        hint = meant(given, allowed) if isinstance(given, str) else ""
        refuse(field, given, f"must be one of {', '.join(map(repr, allowed))}{hint}")


def _named(field: str, given: object, known: Mapping[str, int]) -> tuple[str, ...]:
    """Checked names of what an input is chosen of."""
    names = (given,) if isinstance(given, str) else given
    if not isinstance(names, (list, tuple)) or not names or len(set(map(str, names))) < len(names):
        refuse(field, given, "must be names, each once")
    for name in names:
        named(field, name, known)
    return tuple(names)


def columns(names: Sequence[str], sizes: Sequence[int]) -> NDArray[np.intp]:
    """Which of all numbers of these inputs, of so many each, one input after another, are chosen, shape (k,)."""
    numbers, starts = getattr(names, "numbers", {}), np.cumsum([0, *sizes])[:-1]
    own = [numbers.get(name, range(size)) for name, size in zip(names, sizes, strict=True)]
    chosen = [start + np.array(part, dtype=np.intp) for part, start in zip(own, starts, strict=True)]
    return np.concatenate(chosen) if chosen else np.zeros(0, dtype=np.intp)


def every_label(names: Sequence[str], sizes: Sequence[int]) -> list[str]:
    """What each number of these inputs is called in messages."""
    return [f"{name}[{j}]" if size > 1 else name for name, size in zip(names, sizes, strict=True) for j in range(size)]


def labels_of(robot: Assembly, names: Sequence[str], sizes: Sequence[int]) -> list[str]:
    """The same of a robot's: by the names of rods, lines, bodies or joints where inputs are taken so."""
    result = []
    for name, size in zip(names, sizes, strict=True):
        places = parts_of(robot, name) if size > 1 else {}
        parts = {f"{name}[{part!r}]": own.stop - own.start for part, own in places.items()} or {name: size}
        result += every_label(tuple(parts), tuple(parts.values()))
    return result


def whole(names: Sequence[str]) -> tuple[str, ...]:
    """Those of which all numbers are chosen, so that nothing of what was given is left."""
    numbers = getattr(names, "numbers", {})
    return tuple(name for name in names if name not in numbers)


def values_of(inputs: Inputs, names: Sequence[str]) -> FloatArray:
    """What is chosen of inputs, shape (..., k), one input after another."""
    alone = not inputs.batch_shape and inputs.has(names)
    every = [inputs.array(name) if alone else getattr(inputs, name) for name in names]
    numbers = np.concatenate(every, axis=-1)
    return numbers[..., columns(names, [own.shape[-1] for own in every])] if getattr(names, "numbers", None) else numbers


def places_of(inputs: Inputs, names: Sequence[str]) -> dict[str, slice]:
    """Where the components of each input stand among what is chosen of all, one input after another."""
    numbers = getattr(names, "numbers", {})
    sizes = [len(numbers[name]) if name in numbers else getattr(inputs, name).shape[-1] for name in names]
    return {name: slice(end - size, end) for name, end, size in zip(names, accumulate(sizes), sizes, strict=True)}


def with_values(inputs: Inputs, names: Sequence[str], values: FloatArray) -> Inputs:
    """The inputs with other values of some, (..., k), one input after another."""
    places, numbers = places_of(inputs, names), getattr(names, "numbers", {})
    new = {}
    for name, place in places.items():
        new[name] = np.array(values[..., place])
        if name in numbers:
            new[name] = _replaced(inputs, name, numbers[name], new[name])
    return inputs.with_arrays(inputs.arrays | new)


def _replaced(inputs: Inputs, name: str, numbers: Sequence[int], values: FloatArray) -> FloatArray:
    """An input with other values (..., k) of some of its numbers."""
    before = getattr(inputs, name)
    result = np.array(np.broadcast_to(before, (*np.broadcast_shapes(before.shape[:-1], values.shape[:-1]), before.shape[-1])))
    result[..., list(numbers)] = values
    return result


def masked(inputs: Inputs, names: Sequence[str], failed: NDArray[np.bool_]) -> Inputs:
    """The inputs, some of them NaN where a task ``failed`` (...), which found none."""
    if not failed.any():
        return inputs
    numbers, values = getattr(names, "numbers", {}), {}
    for name in names:
        every = getattr(inputs, name)
        lost = np.isin(np.arange(every.shape[-1]), numbers.get(name, range(every.shape[-1])))
        values[name] = np.where(failed[..., None] & lost, np.nan, every)
    return inputs.with_arrays(inputs.arrays | {name: frozen(own) for name, own in values.items()})
