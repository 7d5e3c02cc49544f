"""Unit quaternions of rotation matrices."""

import numpy as np

from multirod.validation import FloatArray


def quaternions(rotation: FloatArray) -> FloatArray:
    """Scalar last, shape (..., 4), of rotation matrices (..., 3, 3); NaN where these are."""
    from scipy.spatial.transform import Rotation

    result = np.full((*rotation.shape[:-2], 4), np.nan)
    sound = np.isfinite(rotation).all(axis=(-2, -1))
    if sound.any():
        result[sound] = Rotation.from_matrix(rotation[sound]).as_quat()
    return result
