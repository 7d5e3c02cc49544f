"""Where functions of one variable change their sign, as far as their values and slopes at two ends tell.

Numbers in parentheses are those of ``docs/stability.md``.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from multirod.validation import FloatArray

STEEPEST = 16 * np.sqrt(3) / 9  # largest slope of 16 t^2 (1 - t)^2, what a smooth function differs from its cubic by


def cubic(values: FloatArray, slopes: FloatArray) -> FloatArray:
    """Coefficients (4, k) of the cubics on [0, 1] with ``values`` and ``slopes`` (2, k) at its ends, the constants first."""
    (a, b), (p, q) = values, slopes
    return np.array([a, p, 3 * (b - a) - 2 * p - q, 2 * (a - b) + p + q])


def at(coefficients: FloatArray, t: float) -> FloatArray:
    """Values of cubics, (k,)."""
    return np.asarray(t ** np.arange(4) @ coefficients)


def settled(values: FloatArray, slopes: FloatArray, error: FloatArray) -> NDArray[np.bool_]:
    """(17) Whether each function has a zero only where its signs at both ends differ, and then one; shape (k,).

    Args:
        values: At both ends, shape (2, k).
        slopes: There, times the distance of the ends, shape (2, k).
        error: By how much the functions may differ from their cubics in the middle, shape (k,).
    """
    result = np.zeros(values.shape[1], dtype=bool)
    for k, (a, b, c, d) in enumerate(cubic(values, slopes).T):
        if not np.isfinite([a, b, c, d, error[k]]).all():
            continue
        turns = _inside(np.roots([3 * d, 2 * c, b]))
        least = np.append(values[:, k], a + b * turns + c * turns**2 + d * turns**3)
        bends = _inside(np.roots([3 * d, c]))
        steep = np.append(slopes[:, k], b + 2 * c * bends + 3 * d * bends**2)
        away, monotone = (max(v.min(), -v.max()) for v in (least, steep))
        result[k] = away > error[k] or monotone > STEEPEST * error[k]
    return result


def crossings(values: FloatArray, slopes: FloatArray) -> FloatArray:
    """Where in (0, 1] the cubic with ``values`` and ``slopes`` (2,) at the ends of [0, 1] is zero, ascending."""
    roots = np.roots(cubic(values[:, None], slopes[:, None])[::-1, 0])
    return np.sort(_inside(roots, 1e-9))


def _inside(roots: NDArray[Any], margin: float = 0.0) -> FloatArray:
    """The real ones of ``roots`` in [0, 1]."""
    return np.asarray(roots.real[(np.abs(roots.imag) <= margin) & (roots.real >= 0) & (roots.real <= 1)])
