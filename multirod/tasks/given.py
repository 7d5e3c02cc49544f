"""What a loop is given at each sample: checks that cost it little."""

from typing import Any, TypeGuard, cast

import numpy as np
from numpy.typing import NDArray

from multirod.rotations import ORTHOGONAL
from multirod.running.plain import plain_numbers

Plain = NDArray[np.float64] | tuple[float, float, float] | list[float]


def plain(value: Any, shape: tuple[int, ...] = (3,)) -> TypeGuard[Plain]:  # noqa: ANN401  (told by its type)
    """Whether these surely are numbers that may be, as an array of this shape, or three in a row."""
    if type(value) is np.ndarray:
        return value.dtype == np.float64 and value.shape == shape and plain_numbers(value.ravel().tolist())
    return type(value) in (tuple, list) and shape == (3,) and len(value) == 3 and plain_numbers(value)


def turned(rotation: Any, off: float = 0.5 * ORTHOGONAL) -> TypeGuard[NDArray[np.float64]]:  # noqa: ANN401  (told by its type)
    """Whether this surely is a rotation, as an array, whose ``R R^T`` is less than ``off`` from the identity."""
    if not plain(rotation, (3, 3)):
        return False
    rows = cast("NDArray[np.float64]", rotation).tolist()
    (a, b, c), (d, e, f), (g, h, i) = rows
    for k, (x, y, z) in enumerate(rows):
        for m, (u, v, w) in enumerate(rows[k:]):
            if not abs(x * u + y * v + z * w - (m == 0)) < off:
                return False
    return bool(a * (e * i - f * h) - b * (d * i - f * g) + c * (d * h - e * g) > 0)
