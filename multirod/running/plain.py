"""Inputs of a loop's sample that are plain numbers: written to where kernels read them, without the checks of others."""

from collections.abc import Mapping, Sequence
from typing import Any, cast

import numpy as np

from multirod.assembly import Assembly
from multirod.by_name import parts_of
from multirod.inputs import Inputs
from multirod.problem import BoundaryProblem
from multirod.validation import LARGEST, PLAIN

NOWHERE: tuple[Any, dict[str, slice]] = (None, {})
WHOLE = (np.dtype(np.float64), np.dtype(np.int64))  # whose numbers are plain


def plain_numbers(values: Sequence[Any]) -> bool:
    """Whether these surely are numbers that may be: none NaN, infinite or out of range, as ``validation.array`` has it."""
    for value in values:  # noqa: SIM110  (in half of the time of ``all``)
        if type(value) not in PLAIN or not -LARGEST < value < LARGEST:
            return False
    return True


def several(value: Any) -> Sequence[Any] | None:  # noqa: ANN401  (told by its type)
    """Its numbers, if these surely are several in a row."""
    kind = type(value)
    if kind is tuple or kind is list:
        return cast("Sequence[Any]", value)
    if kind is np.ndarray and value.ndim == 1:
        # those of single precision are left to the checks of others
        return cast("Sequence[Any]", value.tolist() if value.dtype in WHOLE else value)
    return None


def by_place(row: Any, places: Mapping[str, slice], given: dict[Any, Any]) -> list[Any] | None:  # noqa: ANN401  (a row)
    """Numbers of a row with others where they are given by name; None where these need to be checked."""
    whole: list[Any] = row.tolist()
    for part, value in given.items():
        place, numbers = places.get(part), several(value)
        size = 0 if place is None else place.stop - place.start
        if place is None or size != (1 if numbers is None else len(numbers)) or (size == 1) != (numbers is None):
            return None
        whole[place] = (value,) if numbers is None else numbers
    return whole


class PlainInputs:
    """Where the numbers of a problem's inputs stand, of those that may be written as they come; none of a batch.

    Args:
        robot: The assembly.
        problem: Its problem.
        inputs: Those it was made with.
        but: Names that may not be written; of a task that leaves parts of an input, these may, by name.
    """

    def __init__(self, robot: Assembly, problem: BoundaryProblem, inputs: Inputs, but: Sequence[str] = ()) -> None:
        self._robot = robot
        self._rows: dict[str, Any] = {}
        self._parts: dict[str, tuple[Any, dict[str, slice]]] = {}
        view = problem.input_view()
        if view is None or problem.batch_shape:
            return
        taken: Mapping[str, Sequence[str]] = getattr(but, "parts", {})
        for spec in robot.input_specs:
            name = spec.name
            if name in inputs.arrays and problem.takes(name) and not (spec.per_rod and inputs.profiles):
                row = view[0, problem.input_slice(name)]
                if name not in but:
                    self._rows[name] = row
                if name not in but or name in taken:
                    own = taken.get(name, ())
                    self._parts[name] = row, {part: place for part, place in parts_of(robot, name).items() if part not in own}

    def write(self, changes: Mapping[str, Any]) -> bool:
        """Write them all; False, and none is, where a change needs to be checked or compiled in."""
        staged = []
        for name, given in changes.items():
            value = given
            if type(given) is dict:
                row, places = self._parts.get(name, NOWHERE)
                value = None if row is None else by_place(row, places, given)
            else:
                row = self._rows.get(name)
            if row is None or value is None:
                return False
            numbers = several(value)
            numbers = (value,) if numbers is None else numbers
            if len(numbers) != len(row) or not plain_numbers(numbers) or not self._robot.surely_takes(name, numbers):
                return False
            staged.append((row, value))
        for row, value in staged:
            row[:] = value
        return True
