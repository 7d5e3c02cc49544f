"""Measurements of poses in their standard deviations. Numbers in parentheses: ``docs/estimation.md``."""

import numpy as np
from numpy.typing import NDArray

from multirod import plausibility
from multirod.tasks.deviations import deviations
from multirod.validation import Described, FloatArray, array, refuse

Kind = tuple[int, int, int]  # whether there is a position (2: across a direction, 3: along it), a rotation, an axis
POSITION_ROWS = (0, 3, 2, 1)  # of each of these
SYMMETRIC = 1e-9  # what a covariance may be off its transpose, of its largest entry


def row_count(kind: Kind) -> int:
    """Rows of a pose of a kind."""
    return POSITION_ROWS[kind[0]] + 3 * kind[1] + 2 * kind[2]


def of_what_is_there(whitening: FloatArray, there: NDArray[np.bool_]) -> FloatArray:
    """(19) Whitening of the numbers (b, m) that are there alone, zeros in the place of the others,
    shape (b, m, m); as it is where all are there, or it mixes none."""
    if there.all() or not np.tril(whitening, -1).any():
        return whitening
    root = np.linalg.inv(whitening)
    patterns, which = np.unique(there, axis=0, return_inverse=True)
    result = np.zeros((len(patterns), *whitening.shape))
    for own, known in zip(result, patterns, strict=True):
        if known.all():  # as alone, to the last bit
            own[:] = whitening
            continue
        rows = np.flatnonzero(known)
        own[np.ix_(rows, rows)] = _inverse_root(root[rows] @ root[rows].T)
    return np.asarray(result[which.reshape(-1)])


def _inverse_root(covariance: FloatArray) -> FloatArray:
    """(17) That of the Cholesky factor; rounding leaves a little above its diagonal, which would mix rows."""
    return np.tril(np.linalg.inv(np.linalg.cholesky(covariance)))


def whitening(kind: Kind, sigma: object, covariance: object) -> FloatArray | None:
    """Rows of a measurement in standard deviations: the lower triangular matrix (m, m) that makes them so; None of a target."""
    if covariance is not None:
        return _root(kind, sigma, covariance)
    if sigma is None:
        return None
    result = _sigma(kind, sigma)
    plausibility.of_pose_sigma(result, POSITION_ROWS[kind[0]])
    return np.diag(1 / result)


def _sigma(kind: Kind, value: object) -> FloatArray:
    """Standard deviations of each row, (m,)."""
    parts = [("the position [m]", POSITION_ROWS[kind[0]], kind[0] == 1)] if kind[0] else []
    parts += [("the angles [rad]", 3 if kind[1] else 2, bool(kind[1]))] if kind[1] or kind[2] else []
    return deviations("Pose.sigma", value, parts)


def _root(kind: Kind, sigma: object, covariance: object) -> FloatArray:
    """Of a covariance."""
    if sigma is not None:
        refuse("Pose.sigma", sigma, "must not be given beside covariance, which says it")
    if kind[0] > 1 or kind[2]:
        raise ValueError("Pose.covariance must not be given of an axis, or of a position across or along a direction: give sigma")
    size = row_count(kind)
    result = array("Pose.covariance", covariance, (size, size))
    if result.ndim > 2:
        refuse("Pose.covariance", Described(f"array of shape {result.shape}"), f"must be ({size}, {size})")
    if np.abs(result - result.T).max() > SYMMETRIC * np.abs(result).max() or (np.linalg.eigvalsh(result) <= 0).any():
        raise ValueError("Pose.covariance must be symmetric and positive definite")
    plausibility.of_pose_sigma(np.sqrt(np.diagonal(result)), POSITION_ROWS[kind[0]])
    return _inverse_root(result)
