# mypy: ignore-errors
"""Which of the rods of a backbone ends at its tip, where loads act: the innermost of those that reach furthest.

Where tubes end at one place, rounding of their lengths is not to decide which of them a load twists.
"""

import numpy as np
import warp as wp
from numpy.typing import NDArray

from multirod.batch import IntArray
from multirod.validation import FloatArray

f64 = wp.float64
SAME_END = 1e-12  # of its arclength: ends this close are at the same place


def as_far(end: FloatArray, other: FloatArray) -> NDArray[np.bool_]:
    """Whether rods that end at ``end`` [m] reach as far as others, shapes (...)."""
    return np.asarray(end >= other - SAME_END * np.abs(other))


def longest(ends: FloatArray) -> IntArray:
    """The rod that ends at the tip, of arclengths (..., rod) [m], shape (...)."""
    return np.asarray(as_far(ends, ends.max(axis=-1, keepdims=True)).argmax(axis=-1))


@wp.func
def end_of(end: wp.array3d[wp.float64], row: int, inputs: wp.array2d[wp.float64], t: int, i: int) -> f64:
    """Where rod i ends: ``translation`` follows ``rotation``, each a number a rod."""
    return end[row, i, end.shape[2] - 1] + inputs[t, end.shape[1] + i]


@wp.func
def is_as_far(end: f64, other: f64) -> bool:
    return end >= other - f64(wp.static(SAME_END)) * wp.abs(other)


@wp.func
def tip_of(end: wp.array3d[wp.float64], row: int, inputs: wp.array2d[wp.float64], t: int) -> f64:
    """Where the rods end that reach furthest."""
    tip = end_of(end, row, inputs, t, 0)
    for i in range(1, end.shape[1]):
        tip = wp.max(tip, end_of(end, row, inputs, t, i))
    return tip


@wp.func
def longest_of(end: wp.array3d[wp.float64], row: int, inputs: wp.array2d[wp.float64], t: int) -> int:
    """The rod that ends at the tip."""
    tip = tip_of(end, row, inputs, t)
    i = int(0)
    while i < end.shape[1] - 1 and not is_as_far(end_of(end, row, inputs, t, i), tip):
        i += int(1)
    return i


@wp.func
def reaches(end: wp.array3d[wp.float64], row: int, inputs: wp.array2d[wp.float64], t: int, i: int, other: int) -> bool:
    """Whether rod i reaches as far as another."""
    return is_as_far(end_of(end, row, inputs, t, i), end_of(end, row, inputs, t, other))
