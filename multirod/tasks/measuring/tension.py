"""Tensions of lines, measured by load cells between motors and tendons. Numbers in parentheses: ``docs/estimation.md``."""

from collections.abc import Sequence
from typing import ClassVar

import numpy as np

from multirod.naming import hinted
from multirod.tasks.deviations import deviation
from multirod.types import Numbers
from multirod.validation import Described, FloatArray, index_of, known_as, listed, measurement, refuse, sequence

CALLED = "indices or names of lines, or one of them"


class Tension:
    """Tensions of lines, measured where these leave the base: what ``solution.tension`` says, negative where a line pushes.

    Of lines that are driven by ``displacement``, whose tension the robot and its loads make; of those driven by ``tension`` or
    ``pressure`` it is an input.

    Args:
        value: [N], shape (..., count), one of each line in the order named; one number of one line.
        sigma: Standard deviation [N]: one number, or of each line.
        line: Index or name of a line, in the order of the rods' lines, or several; all by default.

    Raises:
        TypeError: If ``line`` is no index and no name.
        ValueError: If values are not as many as lines, a line is named twice, or ``sigma`` is not > 0.
    """

    quantity: ClassVar = "tension"
    first: ClassVar = 0  # of its components among those of the quantity
    says: ClassVar = "value"

    @hinted("it is named, Tension(value=solution.tension, sigma=0.1)")
    def __init__(self, *, value: Numbers, sigma: Numbers, line: int | str | Sequence[int | str] | None = None) -> None:
        self._single = isinstance(line, (int, np.integer, str))
        self.lines = None if line is None else sequence("Tension.line", listed(line), (int, str), CALLED)
        self.value = self._column("Tension.value", value)
        if self.lines is not None and (len(self.lines) != self.count or len(set(self.lines)) < self.count):
            refuse("Tension.line", line, f"must be {self.count}, each once: value has as many")
        self.batch_shape = self.value.shape[:-2]
        self.sigma = deviation("Tension.sigma", sigma, self.count)[:, None]

    @property
    def count(self) -> int:
        """Rows."""
        return int(self.value.shape[-2])

    def joined(self, field: str, value: object) -> object:
        """What it says at a sample, (..., count, 1); or one NaN for all."""
        lost = isinstance(value, float) and np.isnan(value)
        return value if lost else self._column(field, value, self.count)

    def _column(self, field: str, value: object, count: int | None = None) -> FloatArray:
        """Checked values, (..., count, 1)."""
        result = measurement(field, value)
        result = result[..., None] if self._single else result
        if not result.ndim or (count is not None and result.shape[-1] != count):
            refuse(field, value, f"must have shape (..., {count or 'count'}), one number of each line")
        return result[..., None]

    def __repr__(self) -> str:
        which = "all lines" if self.lines is None else ", ".join(map(repr, self.lines))
        return f"Tension({which}; {self.count} rows, batch {self.batch_shape})"


def line_indices(sensor: Tension, names: Sequence[str]) -> list[int]:
    """Which lines of a robot, of these names, they are.

    Raises:
        ValueError: If there is no such line, or not as many as values.
    """
    if not names:
        refuse("Tension", Described("a sensor of lines"), "no rod has lines")
    if sensor.lines is None:
        if sensor.count != len(names):
            said = Described(f"array of shape {sensor.value.shape[:-1]}")
            refuse("Tension.value", said, f"must be (..., {len(names)}), one number of each line, or line= must say of which")
        return list(range(len(names)))
    return [_line_index(own, names) for own in sensor.lines]


def _line_index(line: int | str, names: Sequence[str]) -> int:
    index = index_of("Tension.line", line, names)
    if index is None:
        refuse("Tension.line", line, known_as(names))
    return index % len(names)
