"""Inputs that nobody knows, of each shape its own, beside what all shapes share. Numbers: ``docs/estimation.md``."""

from math import prod
from typing import Any

import numpy as np

from multirod.assembly import Assembly
from multirod.inputs import Inputs
from multirod.tasks.estimating.estimate import Estimate
from multirod.tasks.estimating.inference import block_diagonal
from multirod.tasks.freed import places_of, with_values
from multirod.tasks.limits import known_rows
from multirod.validation import Described, FloatArray, refuse

MOST = 2000  # numbers that are found together: (13) is solved as it stands


class Loads:
    """(13b) Numbers ``q`` of each shape, ``shared`` others before them.

    Args:
        robot: Whose inputs they are.
        inputs: Of all shapes, where it begins.
        names: Of those that nobody knows; none where all is known.
        shared: Numbers that all shapes share.

    Attributes:
        places: Where each is among those of a shape.
        count: Of one shape.
        mean: Where it begins, shape (b, k).
    """

    def __init__(self, robot: Assembly, inputs: Inputs, names: tuple[str, ...], shared: int) -> None:
        self.names, self.shared, shape = names, shared, inputs.batch_shape
        self.places = places_of(inputs, self.names)
        sizes = {name: place.stop - place.start for name, place in self.places.items()}
        self.count, self.shapes = sum(sizes.values()), prod(shape)
        own = [np.broadcast_to(getattr(inputs, name), (*shape, size)).reshape(-1, size) for name, size in sizes.items()]
        self.mean = np.concatenate([np.zeros((self.shapes, 0)), *own], axis=1)
        total = shared + self.mean.size
        if total > MOST:
            refuse("unknown", Described(f"{total} numbers with the parameters"), f"must be at most {MOST} together")
        if self.names and len(known_rows(robot, None, self.names)[0].low):
            refuse(
                "unknown",
                self.names,
                "must be inputs that the robot does not limit, which tensions and translations are: mr.estimate() finds these, "
                "with the fitted robot",
            )

    def begin(self) -> FloatArray:
        """All numbers before anything is known: shared ones 0, then those of each shape as they were given."""
        return np.concatenate([np.zeros(self.shared), self.mean.reshape(-1)])

    def at(self, inputs: Inputs, found: Estimate[Any]) -> Inputs:
        """The inputs with what was found of shapes, as they were where that failed."""
        values = np.concatenate([found.value(name) for name in self.names], axis=-1)
        means = self.mean.reshape(values.shape)
        return with_values(inputs, self.names, np.where(found.failed[..., None], means, values))

    def of(self, inputs: Inputs) -> FloatArray:
        """All numbers, shared ones 0, those of each shape as they are in inputs."""
        own = [np.reshape(getattr(inputs, name), (self.shapes, -1)) for name in self.names]
        return np.concatenate([np.zeros(self.shared), np.concatenate([np.zeros((self.shapes, 0)), *own], axis=1).reshape(-1)])

    def prior(self, shared: FloatArray) -> FloatArray:
        """Covariance of all numbers before anything is measured, ``shared`` (s, s) that of what is shared: of loads none."""
        nothing = np.diag(np.full(self.mean.size, np.inf))
        return np.asarray(block_diagonal([shared[None], nothing[None]])[0])

    def inputs(self, others: Inputs, numbers: FloatArray) -> Inputs:
        """The inputs of all shapes at all numbers."""
        if not self.names:
            return others
        values = numbers[self.shared :].reshape(*others.batch_shape, self.count)
        return with_values(others, self.names, values)

    def each(self, numbers: FloatArray) -> FloatArray:
        """Of each shape what is shared, then its own, shape (b, s + k)."""
        shared = np.broadcast_to(numbers[: self.shared], (self.shapes, self.shared))
        return np.concatenate([shared, numbers[self.shared :].reshape(self.shapes, self.count)], axis=1)

    def columns(self, shared: FloatArray) -> FloatArray:
        """How columns by parameters, then by these, vary with what is shared, then with these: ``shared`` (column, s)."""
        rows, own = shared.shape
        result = np.zeros((rows + self.count, own + self.count))
        result[:rows, :own] = shared
        result[rows:, own:] = np.eye(self.count)
        return result

    def wide(self, J: FloatArray) -> FloatArray:
        """Rows (b, m, s + k) of each shape by all numbers, shape (1, b m, s + b k)."""
        rows = J.shape[1]
        result = np.zeros((self.shapes, rows, self.shared + self.mean.size))
        result[:, :, : self.shared] = J[:, :, : self.shared]
        for i, first in enumerate(range(self.shared, result.shape[2], self.count) if self.count else ()):
            result[i, :, first : first + self.count] = J[i, :, self.shared :]
        return result.reshape(1, self.shapes * rows, -1)

    def blocks(self, covariance: FloatArray) -> FloatArray:
        """Covariances of the numbers of each shape, (b, k, k), out of that of all."""
        first = self.shared + self.count * np.arange(self.shapes)
        return np.array([covariance[i : i + self.count, i : i + self.count] for i in first.tolist()]).reshape(
            self.shapes, self.count, self.count
        )
