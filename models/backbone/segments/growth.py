"""How much matrices amplify what they are given."""

import numpy as np

from multirod.validation import FloatArray


def largest_singular_value(blocks: FloatArray) -> FloatArray:
    """Of matrices (count, 3, 3), shape (count,): by the largest root of the characteristic polynomial of ``A^T A``.

    NaN where one has numbers that are not finite.
    """
    scale = np.abs(blocks).max(axis=(1, 2))
    sound = np.isfinite(scale)
    A = np.where(sound[:, None, None], blocks, np.nan) / np.where(sound & (scale > 0), scale, 1.0)[:, None, None]
    B = A.swapaxes(1, 2) @ A
    mean = np.trace(B, axis1=1, axis2=2) / 3
    B[:, range(3), range(3)] -= mean[:, None]
    spread = np.sqrt((B**2).sum(axis=(1, 2)) / 6)
    with np.errstate(divide="ignore", invalid="ignore"):
        cosine = np.nan_to_num(_determinant(B / spread[:, None, None]) / 2)
    return np.asarray(scale * np.sqrt(mean + 2 * spread * np.cos(np.arccos(np.clip(cosine, -1.0, 1.0)) / 3)))


def _determinant(B: FloatArray) -> FloatArray:
    """Of matrices (count, 3, 3)."""
    return np.asarray(np.einsum("ki,ki->k", B[:, 0], np.cross(B[:, 1], B[:, 2])))
