"""Inverses of many small matrices, whether rounding leaves them their signs, and how many eigenvalues are negative."""

import numpy as np
from numpy.typing import NDArray

from multirod.models.backbone.stability.condensing.second_variation import WORST_CONDITION
from multirod.rotations import cross
from multirod.validation import FloatArray


def inverses(Y: FloatArray) -> tuple[FloatArray, NDArray[np.bool_]]:
    """Inverses, and whether rounding leaves them their signs."""
    with np.errstate(all="ignore"):
        if Y.shape[-1] == 3:  # several times faster than LAPACK
            inverse = by_cofactors(Y)
        else:
            inverse = np.empty_like(Y)
            try:
                inverse[:] = np.linalg.inv(Y)
            except np.linalg.LinAlgError:
                regular = np.linalg.det(np.nan_to_num(Y)) != 0
                inverse[:] = np.linalg.inv(np.where(regular[..., None, None], Y, np.eye(Y.shape[-1])))
                inverse[~regular] = np.nan
        return inverse, are_sound(Y, inverse)


def by_cofactors(Y: FloatArray) -> FloatArray:
    """Inverses of matrices (..., 3, 3)."""
    a, b, c = (Y[..., k] for k in range(3))
    # each row of the inverse's transpose is the product of the next two columns
    products = cross(np.stack([b, c, a], axis=-2), np.stack([c, a, b], axis=-2))
    return np.asarray(products / (a * products[..., 0, :]).sum(axis=-1)[..., None, None])


def are_sound(Y: FloatArray, inverse: FloatArray) -> NDArray[np.bool_]:
    """Whether rounding leaves inverses their signs."""
    size = np.einsum("...ij,...ij", Y, Y) * np.einsum("...ij,...ij", inverse, inverse)
    return np.asarray(size < WORST_CONDITION**2)


def row_condition(matrices: FloatArray) -> FloatArray:
    """Condition numbers (...) of matrices (..., n, n) whose rows, each in a unit of its own, are all made as large; infinite
    where they are not finite, or a row is zero."""
    size = np.abs(matrices).max(axis=-1, keepdims=True)
    fit: NDArray[np.bool_] = np.asarray((np.isfinite(size) & (size > 0)).all(axis=(-2, -1)))
    told = fit[..., None, None]
    found = np.linalg.cond(np.where(told, matrices / np.where(told, size, 1.0), np.eye(matrices.shape[-1])))
    return np.where(fit, found, np.inf)


def negative_count(ratio: FloatArray) -> NDArray[np.int_]:
    """How many eigenvalues of each matrix have a negative real part."""
    n = ratio.shape[-1]
    trace = np.einsum("...ii", ratio)
    with np.errstate(all="ignore"):
        # none has where the matrix is nearer to some positive multiple of the identity than that is to zero
        far = ~((trace > 0) & (trace**2 > (n - 1) * np.einsum("...ij,...ij", ratio, ratio)))
    far &= np.isfinite(ratio).all(axis=(-2, -1))
    result = np.zeros(ratio.shape[:-2], dtype=int)
    if far.any():
        result[far] = (np.linalg.eigvals(ratio[far]).real < 0).sum(axis=-1)
    return result
