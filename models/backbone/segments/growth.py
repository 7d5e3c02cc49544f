"""How much matrices amplify what they are given."""

import numpy as np

from multirod.validation import FloatArray


def amplified(transitions: FloatArray, stiffness: FloatArray) -> FloatArray:
    """By how much transitions of curvature and rotation, (count, 6, 6), amplify at least, in whatever unit moments are, shape
    (count,); ``stiffness`` (count, 3) [N m^2] makes curvatures moments."""
    count = len(transitions)
    unit = np.ones((count, 6))
    unit[:, :3] = stiffness  # of moments about all axes one
    blocks = (transitions * (unit[:, :, None] / unit[:, None, :])).reshape(count, 2, 3, 2, 3).swapaxes(2, 3)
    norm = largest_singular_value(blocks.reshape(-1, 3, 3)).reshape(count, 2, 2)
    with np.errstate(over="ignore"):
        # rotation to moment and back may each be scaled at the cost of the other: their geometric mean is what is left
        return np.asarray(np.maximum(np.maximum(norm[:, 0, 0], norm[:, 1, 1]), np.sqrt(norm[:, 0, 1] * norm[:, 1, 0])))


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
