"""What comes next by the last samples of a motion."""

import numpy as np

from multirod.validation import FloatArray

FAR = 4.0  # spans of the last samples, beyond which the next is not foretold by them


def extrapolated(past: FloatArray, points: int) -> FloatArray:
    """What comes next by so many of the last samples (instance, 3, n), the latest first; shape (instance, n)."""
    if points > 2:
        return np.asarray(3 * (past[:, 0] - past[:, 1]) + past[:, 2])
    return past[:, 0] if points < 2 else np.asarray(2 * past[:, 0] - past[:, 1])


def shifted(past: FloatArray, found: FloatArray) -> FloatArray:
    """The last samples once another is found. Of what began, or stood still, both orders lead where the linear one does."""
    last, before = past[:, 0], past[:, 1]
    return np.stack([found, last, np.where(before == last, 2 * last - found, before)], axis=1)


def respaced(past: FloatArray, points: int, ratio: float) -> FloatArray:
    """(6b) of ``docs/solvers.md``: the last samples as they would be if taken ``ratio`` times as far apart, of the polynomial
    through so many of them; shape (instance, 3, n)."""
    last, before, first = np.moveaxis(past, 1, 0)
    bend = first - 2 * before + last if points > 2 else np.zeros_like(last)
    back = [last + r * (before - last) + r * (r - 1) / 2 * bend for r in (ratio, 2 * ratio)]
    return np.stack([last, *back], axis=1)
