"""Samples as bytes, for the process that writes them: what they have in common is said once."""

import pickle
from collections.abc import Iterator
from dataclasses import dataclass, replace
from io import BytesIO
from typing import Any

import numpy as np
from numpy.typing import NDArray

from multirod.assembly import Assembly
from multirod.inputs import Inputs
from multirod.recording.background import Sample
from multirod.results.scene import Scene
from multirod.results.solution import Solution
from multirod.solver import Outcome

_PROTOCOL = pickle.HIGHEST_PROTOCOL
_ARRAYS = ("status", "iterations", "integrations", "residual", "rates", "reached")
_Flat = tuple[str, tuple[int, ...], bytes]


@dataclass(frozen=True)
class _Common:
    """What a solution shares with the one before it.

    Attributes:
        scene: Of it; inputs are unpacked by it where ``inputs`` is None.
        inputs: Without their numbers.
    """

    scene: Scene[Any]
    inputs: Inputs | None

    def holds_for(self, other: "_Common") -> bool:
        one, two = self.scene, other.scene
        if self.inputs is None or other.inputs is None:
            return False
        mine, others = self.inputs.profiles, other.inputs.profiles
        return (
            one.assembly is two.assembly
            and one.batch_shape == two.batch_shape
            and one.fields == two.fields
            and mine.keys() == others.keys()
            and all(mine[name] is others[name] for name in mine)
        )


class Packer:
    """Makes bytes of samples, in some microseconds where they have much in common.

    Args:
        instances: Of a batch that are recorded: no others are packed.
    """

    def __init__(self, instances: int) -> None:
        self._instances = instances
        self._robots: list[Assembly] = []
        self._last: dict[int, _Common] = {}

    def pack(self, sample: Sample) -> bytes:
        """A sample as bytes.

        Raises:
            Exception: If what it is of cannot be pickled.
        """
        solutions = [sample.solution] if sample.reference is None else [sample.solution, sample.reference]
        parts = [self._part(place, solution, sample.total) for place, solution in enumerate(solutions)]
        said = sample.solution._remarks
        return pickle.dumps((sample.step, sample.time, sample.step_time, sample.total, parts, said), _PROTOCOL)

    def _part(self, place: int, solution: Solution, total: int) -> tuple[Any, ...]:
        if total > self._instances and not solution.assembly.batch_shape:
            solution = solution[np.unravel_index(np.arange(self._instances), solution.batch_shape)]
        said = numbers = None
        own = solution._inputs is not None or solution._instances is not None  # not unpacked from records
        last = self._last.get(place)
        if own or last is None or last.scene is not solution._scene:
            said, numbers = self._set_out(place, solution, own)
        outcome = solution._outcome
        arrays = [None if (array := getattr(outcome, name)) is None else _flat(array) for name in _ARRAYS]
        return said, _flat(solution._records), arrays, outcome.breakpoints, numbers

    def _set_out(self, place: int, solution: Solution, own: bool) -> tuple[tuple[bytes, bytes] | None, dict[str, _Flat] | None]:
        """What is common, where it is not that of the sample before, and the numbers of inputs that are not in the records."""
        numbers = None
        common = _Common(solution._scene, None)
        if own:
            inputs = solution._applied
            common = _Common(replace(solution._scene, unpack=None), inputs.with_arrays({}))
            numbers = {name: _flat(array) for name, array in inputs.arrays.items()}
        last = self._last.get(place)
        if last is not None and last.holds_for(common):
            return None, numbers
        self._last[place] = common
        known = len(self._robots)
        into = BytesIO()
        _Numbering(into, self._robots).dump(common)
        return (pickle.dumps(self._robots[known:], _PROTOCOL), into.getvalue()), numbers


class _Numbering(pickle.Pickler):
    def __init__(self, into: BytesIO, robots: list[Assembly]) -> None:
        super().__init__(into, _PROTOCOL)
        self._robots = robots

    def persistent_id(self, value: object) -> int | None:
        if not isinstance(value, Assembly):
            return None
        for number, robot in enumerate(self._robots):
            if robot is value:
                return number
        self._robots.append(value)
        return len(self._robots) - 1


class _Numbered(pickle.Unpickler):
    def __init__(self, source: BytesIO, robots: list[Assembly]) -> None:
        super().__init__(source)
        self._robots = robots

    def persistent_load(self, number: int) -> Assembly:
        return self._robots[number]


class Unpacker:
    """Makes samples of what a ``Packer`` made, in its order."""

    def __init__(self) -> None:
        self._robots: list[Assembly] = []
        self._last: dict[int, _Common] = {}

    def samples(self, packed: bytes) -> Iterator[Sample]:
        """Samples, of their bytes one after another.

        Raises:
            Exception: If what they are of is not known in this process.
        """
        source = BytesIO(packed)
        while source.tell() < len(packed):
            step, time, step_time, total, parts, said = pickle.load(source)
            solutions = [self._solution(place, *part) for place, part in enumerate(parts)]
            solutions[0]._remarks = said
            yield Sample(step, time, solutions[0], step_time, solutions[1] if solutions[1:] else None, total)

    def _solution(
        self,
        place: int,
        said: tuple[bytes, bytes] | None,
        records: _Flat,
        arrays: list[_Flat | None],
        breakpoints: dict[int, Any],
        numbers: dict[str, _Flat] | None,
    ) -> Solution:
        if said is not None:
            self._robots += pickle.loads(said[0])
            self._last[place] = _Numbered(BytesIO(said[1]), self._robots).load()
        common = self._last[place]
        inputs = None
        if numbers is not None:
            assert common.inputs is not None
            inputs = common.inputs.with_arrays({name: _array(value) for name, value in numbers.items()})
        found: dict[str, Any] = {name: array and _array(array) for name, array in zip(_ARRAYS, arrays, strict=True)}
        return Solution(common.scene, _array(records), Outcome(**found, breakpoints=breakpoints), inputs)


def _flat(array: NDArray[Any]) -> _Flat:
    return array.dtype.char, array.shape, array.tobytes()


def _array(flat: _Flat) -> NDArray[Any]:
    kind, shape, content = flat
    return np.frombuffer(content, kind).reshape(shape)
