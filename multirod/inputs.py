"""Actuation and loads of an assembly, checked and broadcast."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from os import PathLike
from re import sub
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Literal
from weakref import ref

import numpy as np

from multirod.batch import IntArray, along, broadcast_shapes, chosen, take
from multirod.naming import INPUTS_NAMED, hinted, unknown_names
from multirod.profile import Profile, fit
from multirod.read_only import ReadOnly
from multirod.types import Index
from multirod.validation import Described, FloatArray, array, first_of, refuse

if TYPE_CHECKING:
    from multirod.assembly import Assembly


@dataclass(frozen=True, kw_only=True)
class InputSpec:
    """One input that an assembly takes, and what it means: whatever treats inputs of one kind alike asks here, not for names.

    Attributes:
        name: How it is called.
        acts: Where: at the ``"base"``, at the ``"tip"`` or on what the tips hold, ``"along"`` the rods (per length, or per mass),
            on ``"lines"`` of the rods, along coordinates of ``"joints"``, or not at all, as a ``"sensor"`` reads it.
        load: ``"force"`` or ``"moment"``, which ``load_factor`` multiplies; None for what is no load.
        follows: Of a load: fixed in the frame of where it acts, rather than dead, fixed in the world.
        on: Of a load: what of rods' sections, or of lines, it is multiplied by, such as ``"linear_density"``; empty of forces and
            moments themselves.
        potential: Of a load: whether its work derives from a potential. That of a dead moment does not, nor of what follows the
            tip.
        per_rod: One number per rod, shape (..., rod_count); otherwise a vector, shape (..., 3).
        count: Instead, so many numbers, shape (..., count), such as one for each line.
        unit: SI unit.
        function: Whether it may be a function of arclength.
        optional: Whether leaving it out differs from zero.
        required: Whether it must be given, as zero is hardly meant.
        measured: A measurement: noise is part of it, and what comes next is not known. Its change is never extrapolated.
        dead_twin: For a load that follows the tip frame, the dead load that it equals to first order where it is zero.
        description: What it is, frame included.
    """

    name: str
    unit: str
    description: str
    per_rod: bool = False
    count: int | None = None
    function: bool = False
    optional: bool = False
    required: bool = False
    measured: bool = False
    dead_twin: str = ""
    acts: Literal["base", "tip", "along", "lines", "joints", "sensor"] = "base"
    load: Literal["force", "moment"] | None = None
    follows: bool = False
    on: str = ""
    potential: bool = False

    def size(self, rod_count: int) -> int:
        """Numbers of an instance: one a rod, ``count``, or the three of a vector."""
        return rod_count if self.per_rod else 3 if self.count is None else self.count

    @property
    def power(self) -> int:
        """Of a load: that of the length by which it compares with ``EI``, 2 for the ``F L^2/EI`` of a force on the tip; 0 of
        others."""
        return 0 if self.load is None else (2 if self.load == "force" else 1) + (self.acts == "along")


class InputSpecs(tuple[InputSpec, ...]):
    """The inputs of an assembly, which show themselves as a table."""

    @cached_property
    def by_name(self) -> Mapping[str, InputSpec]:
        """Each by its name."""
        return {spec.name: spec for spec in self}

    def rows(self) -> list[tuple[str, str, str, str]]:
        """Name, unit, shape and meaning of each; what may be a function of arclength has a star."""
        return [(spec.name + "*" * spec.function, spec.unit, _shape_of(spec), spec.description) for spec in self]

    def __repr__(self) -> str:
        rows = [("input", "unit", "shape", "what"), *self.rows()]
        widths = [max(len(row[k]) for row in rows) for k in range(3)]
        lines = ["  ".join([*(cell.ljust(width) for cell, width in zip(row, widths, strict=False)), row[3]]) for row in rows]
        return "\n".join(lines + ["* or a function of the arclength"] * any(spec.function for spec in self))

    def _repr_html_(self) -> str:
        from multirod.results import html

        return html.input_specs(self)


def _shape_of(spec: InputSpec) -> str:
    return "(..., rods)" if spec.per_rod else f"(..., {3 if spec.count is None else spec.count})"


class Inputs(ReadOnly):
    """Values of an assembly's inputs; made by ``Assembly.inputs(...)``, never changed afterwards.

    Each input is an attribute: ``inputs.tip_force`` has shape ``(*inputs.batch_shape, 3)``; what was not given is zero. They are
    copies of what was given, and read-only.
    """

    written = frozenset()
    instead = "make others by robot.inputs(...), as they are to be"
    _kept: frozenset[str] = frozenset()  # active in the batch that these were taken from
    _nonzero: frozenset[str] | None = None  # of the arrays, once that was asked for
    _active: tuple[str, ...] | None = None  # likewise
    _checked: "ref[Any] | None" = None  # the robot that takes them, as far as is known

    @hinted(f"a robot makes them: {INPUTS_NAMED}")
    def __init__(
        self,
        specs: Sequence[InputSpec],
        rod_count: int,
        values: Mapping[str, Any],
        length: float = 0.0,
        shortest: float = np.inf,
    ) -> None:
        """Check and broadcast ``values``; ``length`` is how far functions of arclength are resolved [m], of which the rod
        that has least of them has ``shortest``."""
        self._specs = specs.by_name if isinstance(specs, InputSpecs) else {spec.name: spec for spec in specs}
        self._rod_count = rod_count
        unknown_names("inputs()", values, self._specs)
        self._arrays: dict[str, FloatArray] = {}
        self._profiles: dict[str, Profile] = {}
        for name, value in values.items():
            spec = self._specs[name]
            if value is None and spec.optional:
                continue
            if isinstance(value, Mapping):
                each = "rod" if spec.per_rod else "of these lines" if spec.acts == "lines" else ""
                unnamed = f": they are taken by name where each {each} has a name of its own" if each else ""
                refuse(name, value, f"must be numbers in their order, shape (..., {spec.size(rod_count)}){unnamed}")
            if spec.function and callable(value):
                resolved = isinstance(value, Profile) and value.ends[-1] >= length
                self._profiles[name] = value if resolved else fit(name, value, length, shortest=shortest)
            elif callable(value):
                hint = "what changes with time is an array, time its first axis, for mr.simulate"
                if spec.acts == "along":
                    hint = "this robot takes no functions of arclength"
                refuse(name, Described(sub(" at 0x[0-9a-fA-F]+", "", repr(value))), f"must be numbers: {hint}")
            elif spec.per_rod or spec.count is not None:
                self._arrays[name] = one_each(name, value, spec.size(rod_count), " rods" if spec.per_rod else "")
            else:
                self._arrays[name] = array(name, value, (3,))
        self._given = tuple(name for name in self._specs if name in self._arrays or name in self._profiles)
        try:
            self._batch_shape: tuple[int, ...] = broadcast_shapes(*(a.shape[:-1] for a in self._arrays.values()))
        except ValueError:
            shapes = ", ".join(f"{name} {a.shape[:-1]}" for name, a in self._arrays.items())
            raise ValueError(f"the leading axes of the inputs do not broadcast: {shapes}") from None

    def __getstate__(self) -> dict[str, Any]:
        return {name: value for name, value in self.__dict__.items() if name != "_checked"}

    def refuse_missing(self) -> None:
        """Refuse NaN, which stands where a task found nothing: ``reached.inputs`` of what failed."""
        for name, values in self._arrays.items():
            lost = np.isnan(values)
            if lost.any():
                none = "a task that failed has found none; ask its status, or take inputs[~result.failed]"
                refuse(name, first_of(lost, values, values), f"must be finite: {none}")

    def checked_by(self, robot: "Assembly") -> None:
        """Note that a robot takes them."""
        self._checked = ref(robot)

    def was_checked_by(self, robot: "Assembly") -> bool:
        """Whether this very robot is known to take them."""
        return self._checked is not None and self._checked() is robot

    @property
    def batch_shape(self) -> tuple[int, ...]:
        """Leading axes of all inputs together."""
        return self._batch_shape

    @property
    def given(self) -> tuple[str, ...]:
        """Names of the inputs that were given."""
        return self._given

    def refuse_others(self, field: str, kind: str, specs: Sequence[InputSpec], rod_count: int) -> None:
        """Refuse inputs that were made by a robot with another number of rods, or of lines, than this ``kind`` of robot has."""
        said = "they were made by another robot"
        own_calls = "make them by its own inputs(...)"
        if self._rod_count != rod_count:
            has = _counted(self._rod_count, "rod")
            refuse(field, self, f"{said}, which has {has}: this {kind} has {rod_count}; {own_calls}")
        for spec in specs:
            size = spec.size(rod_count)
            given = self._specs.get(spec.name, spec).size(rod_count)
            if given != size:
                refuse(
                    field,
                    self,
                    f"{said}: its {spec.name} is {_counted(given, 'number')}, that of this {kind} {size}; {own_calls}",
                )

    def __getattr__(self, name: str) -> FloatArray:
        specs = self.__dict__.get("_specs", {})
        if name not in specs:
            raise AttributeError(f"inputs have no {name!r}: they have " + ", ".join(specs))
        if name in self._profiles:
            raise AttributeError(f"inputs.{name} is a function of arclength: see inputs.profile({name!r})")
        width = specs[name].size(self._rod_count)
        value = self._arrays.get(name)
        if value is None:
            value = np.zeros(width)
            value.flags.writeable = False
        whole = value.shape == (*self.batch_shape, width) and not value.flags.writeable
        return value if whole else np.broadcast_to(value, (*self.batch_shape, width))

    def profile(self, name: str) -> Profile | None:
        """The resolved function of arclength given for an input, if one was."""
        return self._profiles.get(name)

    def has(self, names: Sequence[str]) -> bool:
        """Whether inputs of these names were all given as numbers."""
        return self._arrays.keys() >= set(names)

    def array(self, name: str) -> FloatArray:
        """Values of an input as they were given, their leading axes not broadcast."""
        return self._arrays[name]

    @property
    def arrays(self) -> dict[str, FloatArray]:
        """All inputs that were given as numbers, as they were given; a new dictionary."""
        return {name: self._arrays[name] for name in self.given if name not in self._profiles}

    def spec(self, name: str) -> InputSpec:
        """What the input of this name means."""
        return self._specs[name]

    @property
    def specs(self) -> Mapping[str, InputSpec]:
        """What each input means, by name, given or not."""
        return MappingProxyType(self._specs)

    def save(self, path: str | PathLike[str]) -> None:
        """Write the inputs to a file, to be read by ``mr.load(path, robot=robot)`` (``docs/files.md``).

        Args:
            path: File to write, ``.toml`` (text, with units) or ``.npz``; an existing one is replaced.

        Raises:
            ValueError: If it has another ending; or, of text, if an input is a function of arclength.
        """
        from multirod.files.saving import save_inputs

        save_inputs(path, self)

    @property
    def profiles(self) -> Mapping[str, Profile]:
        """All inputs that were given as functions of arclength."""
        return MappingProxyType(self._profiles)

    def is_active(self, name: str) -> bool:
        """Whether an input was given and is not zero everywhere, or was not in the batch that these inputs were taken from."""
        if name in self._kept:
            return True
        if self._specs[name].optional:
            return name in self._arrays
        if self._nonzero is None:
            self._nonzero = frozenset(own for own, array in self._arrays.items() if array.any())
        return name in self._nonzero or name in self._profiles

    @property
    def measured(self) -> tuple[str, ...]:
        """Names of the inputs that are measurements, given or not."""
        return tuple(spec.name for spec in self._specs.values() if spec.measured)

    @property
    def active(self) -> tuple[str, ...]:
        """Names of the inputs that are not zero everywhere."""
        if self._active is None:
            self._active = tuple(name for name in self.given if self.is_active(name))
        return self._active

    def with_arrays(self, arrays: Mapping[str, FloatArray], batch_shape: tuple[int, ...] | None = None) -> "Inputs":
        """Inputs of the same assembly with other values, already checked; functions of arclength are kept.

        Leading axes are those of the values, where no others are given that these broadcast to.
        """
        result = object.__new__(Inputs)
        result._specs, result._rod_count, result._profiles = self._specs, self._rod_count, self._profiles
        result._arrays = dict(arrays)
        result._given = tuple(name for name in self._specs if name in arrays or name in self._profiles)
        own = broadcast_shapes(*(a.shape[:-1] for a in arrays.values())) if batch_shape is None else batch_shape
        result._batch_shape = own
        return result

    def broadcast_to(self, batch_shape: tuple[int, ...]) -> "Inputs":
        """The same, each with all of these leading axes."""
        arrays = {name: np.broadcast_to(value, (*batch_shape, value.shape[-1])) for name, value in self.arrays.items()}
        return self.with_arrays(arrays, batch_shape)

    def without(self, names: Sequence[str]) -> "Inputs":
        """The same, with some of the inputs zero; leading axes stay."""
        zero = {name: np.zeros_like(self._arrays[name]) for name in names if name in self._arrays}
        result = self.with_arrays(self._arrays | zero, self.batch_shape)
        result._profiles = {name: value for name, value in self._profiles.items() if name not in names}
        result._given = tuple(name for name in self.given if name in result._arrays or name in result._profiles)
        return result

    def __iter__(self) -> "Iterator[Inputs]":
        """Along the first of the leading axes.

        Raises:
            TypeError: If there is none.
        """
        return along(self)

    def __getitem__(self, index: Index) -> "Inputs":
        """The inputs of some instances: ``inputs[k]`` takes the k-th along the first batch axis.

        Raises:
            IndexError: If there are no such instances.
        """
        shape = chosen(self, np.broadcast_to(0.0, self.batch_shape), index).shape
        own: Any = index
        arrays = {name: np.broadcast_to(a, (*self.batch_shape, a.shape[-1]))[own] for name, a in self._arrays.items()}
        return self.with_arrays(arrays, shape)

    def take(self, batch_shape: tuple[int, ...], instances: IntArray) -> "Inputs":
        """The inputs of some instances, a batch of one axis, solved by the terms that the whole batch needs.

        Args:
            batch_shape: What the inputs' leading axes broadcast to.
            instances: Numbers in the flattened batch, shape (k,).
        """
        taken = {name: take(a, batch_shape or (1,), instances, tail=1) for name, a in self._arrays.items()}
        result = self.with_arrays(taken, (len(instances),))
        result._kept = frozenset(self.active)
        return result

    def _repr_html_(self) -> str:
        from multirod.results import html

        return html.inputs(self)

    def __repr__(self) -> str:
        if self.batch_shape:
            return f"Inputs({', '.join(self.given) or 'none'}; batch {self.batch_shape})"
        return f"Inputs({', '.join(map(self._said, self.given)) or 'none'})"

    def _said(self, name: str) -> str:
        if name in self.profiles:
            return f"{name} a function"
        values = ", ".join(f"{value:.5g}" for value in self.array(name).ravel())
        return f"{name} ({values}) {self.spec(name).unit}".rstrip()


def _counted(count: int, what: str) -> str:
    return f"{count} {what}{'s' * (count != 1)}"


def one_each(name: str, value: object, count: int, what: str = "") -> FloatArray:
    """An input per rod, or per line, as (..., count): one number is the same for all, and one rod needs no axis of its own.

    ``what`` these are, errors say.
    """
    result = array(name, value)
    if result.ndim == 0:
        return np.broadcast_to(result, (count,))
    if result.shape[-1] == count:
        return result
    if count == 1:
        return result[..., None]
    transposed = result.ndim > 1 and result.shape[-2] == count
    if count == 3 and result.size < 20 and not transposed:  # it is no vector
        refuse(name, value, f"must have shape (..., 3): one number for each of 3{what}, or one for all")
    return array(name, value, (count,))
