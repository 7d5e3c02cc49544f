"""Inputs of a loop's sample that are plain numbers: written to where kernels read them, without the checks of others."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from multirod.assembly import Assembly
from multirod.inputs import Inputs
from multirod.problem import BoundaryProblem
from multirod.validation import LARGEST, PLAIN

WHOLE = (np.dtype(np.float64), np.dtype(np.int64))  # whose numbers are plain


def plain_numbers(values: Sequence[Any]) -> bool:
    """Whether these surely are numbers that may be: none NaN, infinite or out of range, as ``validation.array`` has it."""
    for value in values:  # noqa: SIM110  (in half of the time of ``all``)
        if type(value) not in PLAIN or not -LARGEST < value < LARGEST:
            return False
    return True


class PlainInputs:
    """Where the numbers of a problem's inputs stand, of those that may be written as they come; none of a batch.

    Args:
        robot: The assembly.
        problem: Its problem.
        inputs: Those it was made with.
        but: Names that may not be written.
    """

    def __init__(self, robot: Assembly, problem: BoundaryProblem, inputs: Inputs, but: Sequence[str] = ()) -> None:
        self._robot = robot
        self._rows: dict[str, Any] = {}
        view = problem.input_view()
        if view is None or problem.batch_shape:
            return
        given = {name for name in inputs.arrays if name not in but}
        for spec in robot.input_specs:
            if spec.name in given and problem.takes(spec.name) and not (spec.per_rod and inputs.profiles):
                self._rows[spec.name] = view[0, problem.input_slice(spec.name)]

    def write(self, changes: Mapping[str, Any]) -> bool:
        """Write them all; False, and none is, where a change needs to be checked or compiled in."""
        staged = []
        for name, value in changes.items():
            row = self._rows.get(name)
            if row is None:
                return False
            kind = type(value)
            numbers = value if kind is tuple or kind is list else (value,)
            if kind is np.ndarray and value.ndim == 1:
                # those of single precision are left to the checks of others
                numbers = value.tolist() if value.dtype in WHOLE else value
            if len(numbers) != len(row) or not plain_numbers(numbers) or not self._robot.surely_takes(name, numbers):
                return False
            staged.append((row, value))
        for row, value in staged:
            row[:] = value
        return True
