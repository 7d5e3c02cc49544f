"""What is estimated, and what is known of it before. Numbers in parentheses: ``docs/estimation.md``."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Generic, TypeVar

import numpy as np

from multirod import plausibility
from multirod.assembly import Assembly
from multirod.batch import IntArray
from multirod.by_name import parts_of
from multirod.inputs import Inputs
from multirod.tasks.estimating.inference import block_diagonal
from multirod.tasks.estimating.priors import Prior, Walk
from multirod.tasks.freed import chosen, freed, with_values
from multirod.validation import Described, FloatArray, instance, refuse

Knowledge = TypeVar("Knowledge", Prior, Walk)
ARTICLES = {Prior: "a Prior", Walk: "a Walk"}
EXAMPLES = {
    Prior: "priors by name, such as {'tip_force': Prior(sigma=0.25)}, or names alone, of which nothing is known",
    Walk: "walks by name, such as {'tip_force': Walk(0.3)}",
}


@dataclass(frozen=True)
class Entry(Generic[Knowledge]):
    """An input that is estimated, or numbers of it.

    Attributes:
        said: What it is called, for people.
        name: Of the input.
        numbers: Which of its numbers.
        known: What is known of them.
    """

    said: str
    name: str
    numbers: tuple[int, ...]
    known: Knowledge

    @property
    def size(self) -> int:
        """How many numbers it has."""
        return len(self.numbers)


@dataclass(frozen=True)
class Unknown(Generic[Knowledge]):
    """All that is estimated, one entry after another.

    Attributes:
        names: Of the inputs, as tasks take what is free.
        entries: What is known of each, or of what it has by name.
    """

    names: tuple[str, ...]
    entries: tuple[Entry[Knowledge], ...]

    def variances(self: "Unknown[Prior]", batch_shape: tuple[int, ...], instances: IntArray | None) -> FloatArray:
        """Covariances (b, k, k) of some instances, infinite on the diagonal where nothing is known."""
        return block_diagonal([own.known.variances(own.said, own.size, batch_shape, instances) for own in self.entries])

    def flat(self: "Unknown[Prior]") -> dict[str, int]:
        """How many numbers of each entry have no prior, of those where any has none."""
        counts = {own.said: own.known.flat_count(own.said, own.size) for own in self.entries}
        return {said: count for said, count in counts.items() if count}

    def at_means(self: "Unknown[Prior]", robot: Assembly, inputs: Inputs, whole: tuple[int, ...]) -> Inputs:
        """The inputs at the priors' means, of all leading axes."""
        means = []
        for own in self.entries:
            like = getattr(inputs, own.name)[..., list(own.numbers)]
            means.append(own.known.means(own.said, like, whole, None).reshape(*whole, own.size))
        return robot.accept(with_values(inputs, self.names, np.concatenate(means, axis=-1)), "the priors' means")

    def rates(self: "Unknown[Walk]", batch_shape: tuple[int, ...]) -> FloatArray:
        """Variances per second, (b, k)."""
        return np.concatenate([own.known.rates(own.said, own.size, batch_shape) for own in self.entries], axis=1)

    def starts(self: "Unknown[Walk]") -> "Unknown[Prior]":
        """What is known of the first sample."""
        return Unknown(self.names, tuple(Entry(own.said, own.name, own.numbers, own.known.start) for own in self.entries))


def unknown_of(robot: Assembly, inputs: Inputs, unknown: object, kind: type[Knowledge]) -> Unknown[Knowledge]:
    """What is to be estimated: inputs by name, each with a ``kind``, or, where it is taken by name, with one for each of these;
    of rods at whose bases motors are, where the robot says which have some, those alone unless others are named. Of names alone
    nothing is known.

    Raises:
        TypeError: If an unknown is no input of the robot, or what is known of it not of that kind.
        ValueError: If what is named is not there, or what is known cannot be.
    """
    if kind is Prior and isinstance(unknown, (str, list, tuple)):
        unknown = dict.fromkeys(freed("unknown", robot, unknown), Prior())
    if not isinstance(unknown, Mapping):
        raise TypeError(f"unknown = {unknown!r} is not allowed: must be {EXAMPLES[kind]}")
    named = {name: own for name, own in unknown.items() if isinstance(own, Mapping)}
    names = chosen("unknown", robot, {name: tuple(named[name]) if name in named else None for name in unknown})
    numbers = getattr(names, "numbers", {})
    entries: list[Entry[Knowledge]] = []
    for name in names:
        if name in inputs.profiles:
            refuse(name, Described("a function of arclength"), "must be numbers, where it is to be estimated")
        if name in named:
            places = {part: place for part, place in parts_of(robot, name).items() if part in named[name]}
            for part, place in places.items():
                own = tuple(range(place.start, place.stop))
                entries.append(_entry(robot, inputs, f"{name}[{part!r}]", name, own, named[name][part], kind))
        else:
            every = range(getattr(inputs, name).shape[-1])
            entries.append(_entry(robot, inputs, name, name, tuple(numbers.get(name, every)), unknown[name], kind))
    return Unknown(names, tuple(entries))


def _entry(
    robot: Assembly,
    inputs: Inputs,
    said: str,
    name: str,
    numbers: tuple[int, ...],
    known: Any,  # noqa: ANN401  (checked here)
    kind: type[Knowledge],
) -> Entry[Knowledge]:
    """A checked one."""
    field = f"unknown[{name!r}]{said[len(name) :]}"
    instance(field, known, kind, ARTICLES[kind])
    spec = inputs.spec(name)
    if isinstance(known, Walk):
        plausibility.of_prior_sigma(f"Walk.sigma of {said}", known.sigma, spec, robot)
        if known.start.covariance is None and np.isinf(known.start.sigma).any():
            refuse(f"{field}.start", Described("a prior without sigma"), "must say how sure the first sample is")
    elif known.covariance is None:
        plausibility.of_prior_sigma(f"Prior.sigma of {said}", known.sigma, spec, robot)
    return Entry(said, name, numbers, known)
