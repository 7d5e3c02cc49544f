"""Robots of some instances of a batch: each number of the robot with the leading axes that are asked for, and no others."""

import warnings
from typing import Any, TypeVar, cast

import numpy as np
from numpy.typing import NDArray

from multirod.assembly import Assembly
from multirod.batch import take
from multirod.files.describing import described
from multirod.files.kinds import AXES_OF_ONE, KINDS, OWN_AXES, PARTS, ROBOTS, Part
from multirod.files.making import made

Robot = TypeVar("Robot", bound=Assembly)


def of_instances(robot: Robot, batch_shape: tuple[int, ...], numbers: NDArray[np.intp]) -> Robot:
    """The robot of some instances.

    Args:
        robot: A batch.
        batch_shape: Leading axes of the instances, to which its own broadcast.
        numbers: Of the instances, in the flattened batch, shape (...), which are the leading axes of what is returned.

    Raises:
        ValueError: If it is, or has, something of another package: of that it is not known what has leading axes.
    """
    table = _taken(described(robot, type(robot).__name__, functions=True), KINDS[type(robot)], batch_shape, numbers)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # it was warned of as the batch was made
        return cast(Robot, made(table, Part(ROBOTS, many=False, named=True), type(robot).__name__))


def _taken(table: dict[str, Any], kind: str, batch_shape: tuple[int, ...], numbers: NDArray[np.intp]) -> dict[str, Any]:
    """Of a table, and of those in it."""
    own = table.get("kind", kind) if kind != "Joint" else kind
    own = own.partition(".")[0]  # of whatever constructor
    parts, result = PARTS.get(own, {}), dict(table)

    def one(name: str, value: object) -> object:
        axes = OWN_AXES.get((own, name), AXES_OF_ONE.get(name))
        if not isinstance(value, np.ndarray) or axes is None or value.ndim <= axes:
            return value
        found = take(value, batch_shape, numbers.reshape(-1), tail=axes)
        return found.reshape((*numbers.shape, *found.shape[1:]))

    for name, value in table.items():
        if name in parts:
            first = parts[name].kinds[0]
            tables = [_taken(item, first, batch_shape, numbers) for item in (value if parts[name].many else [value])]
            result[name] = tables if parts[name].many else tables[0]
        elif name == "precurvature" and isinstance(value, list):  # by section
            result[name] = [[length, one(name, np.asarray(curve))] for length, curve in value]
        else:
            result[name] = one(name, value)
    return result
