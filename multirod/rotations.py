"""Rotations and vectors in space, many at once."""

import numpy as np

from multirod.batch import IntArray
from multirod.validation import FloatArray, first_of, refuse

_SMALL = 1e-3  # angle below which quotients are series, right to rounding
# of the angle between a direction and another, told by their product
BACK = -0.5  # cosine below which it is not its quotient by the sine that is taken: at half a turn there is none
AIMLESS = 1e-12  # sine below which no direction is the shorter way back, and one is taken
SIDEWAYS = 1e-2  # least sine in derivatives by turns that do not lead back: others are not to be lost beside these
ORTHOGONAL = 1e-8  # what R R^T of a rotation may be off the identity
TURNED = 1e-4  # the same of one that is measured: sensors round
ALONG = 0.1  # of the most along an axis: what tells to what side something goes
DIGITS_CUT = 0.02  # by which R R^T is off the identity at most where digits of a rotation were cut
_NEXT, _LAST = np.array([1, 2, 0]), np.array([2, 0, 1])
_CROSSED = np.array([[6, 5, 1], [2, 6, 3], [4, 0, 6]])  # where in ``(a, -a, 0)`` the numbers of ``[a]x`` are


def leading_axis(sizes: FloatArray) -> IntArray:
    """(5) of ``docs/branches.md``: the first of x, y and z along which, of sizes (..., 3), there is enough to tell the side."""
    return np.asarray(np.argmax(sizes >= ALONG * sizes.max(axis=-1, keepdims=True), axis=-1))


def is_rotation(R: FloatArray, most: float = ORTHOGONAL) -> bool:
    """Whether all matrices (..., 3, 3) are rotations, to ``most`` that ``R R^T`` is off the identity: what rounding leaves."""
    off = np.abs(R).max() > 2 or np.abs(R @ np.swapaxes(R, -1, -2) - np.eye(3)).max() > most
    return not (off or (np.linalg.det(R) < 0).any())


def refuse_unturned(
    field: str, value: object, found: FloatArray, most: float = ORTHOGONAL, allowed: str = "must be a rotation"
) -> None:
    """Refuse rotations (..., 3, 3), or poses (..., 4, 4), read from ``value``, that are none; those with NaN are missing."""
    R = found[..., :3, :3]
    whole = np.where(np.isnan(R).any(axis=(-2, -1), keepdims=True), np.eye(3), R)
    if not whole.size or is_rotation(whole, most):
        return
    wrong = np.reshape([not is_rotation(own, most) for own in whole.reshape(-1, 3, 3)], R.shape[:-2])
    first = R[wrong][0]
    off = float(np.abs(first @ first.T - np.eye(3)).max())
    fault = f"R R^T is off the identity by {off:.2g}" + (": it is rounded, give all digits" if off < DIGITS_CUT else "")
    if off <= most:
        fault = "its determinant is -1, a mirror image: a left-handed frame, or axes in another order"
    refuse(field, first_of(wrong, found, value), f"{allowed}: {fault}")


def cross(a: FloatArray, b: FloatArray) -> FloatArray:
    """``a x b`` of vectors (..., 3), several times faster than NumPy's where they are few."""
    return np.asarray(a.take(_NEXT, -1) * b.take(_LAST, -1) - a.take(_LAST, -1) * b.take(_NEXT, -1))


def cross_matrix(a: FloatArray) -> FloatArray:
    """``[a]x``, shape (..., 3, 3)."""
    return np.asarray(np.concatenate([a, -a, np.zeros((*a.shape[:-1], 1))], axis=-1).take(_CROSSED, axis=-1))


def matrices(vectors: FloatArray) -> FloatArray:
    """Rotation matrices (..., 3, 3) of rotation vectors (..., 3)."""
    return _in_powers(cross_matrix(vectors), _of_rotations(vectors))[0]


def left_jacobian(vectors: FloatArray) -> FloatArray:
    """Rotation vectors, in the outer frame, of the changes of ``matrices(vectors)`` by those of the vectors, (..., 3, 3)."""
    return _in_powers(cross_matrix(vectors), _of_changes(vectors))[0]


def with_changes(vectors: FloatArray) -> tuple[FloatArray, FloatArray]:
    """``matrices`` and ``left_jacobian``, of few vectors in two thirds of the time."""
    R, changes = _in_powers(cross_matrix(vectors), _of_rotations(vectors), _of_changes(vectors))
    return R, changes


def _in_powers(K: FloatArray, *factors: tuple[FloatArray, FloatArray]) -> list[FloatArray]:
    """``I + a K + b K^2`` of several ``a``, ``b``."""
    one, square = np.eye(3), K @ K
    return [np.asarray(one + a[..., None, None] * K + b[..., None, None] * square) for a, b in factors]


def _of_rotations(vectors: FloatArray) -> tuple[FloatArray, FloatArray]:
    square = (vectors**2).sum(axis=-1)
    angle = np.sqrt(square)
    small = angle < _SMALL
    safe = np.where(small, 1.0, angle)
    first = np.where(small, 1 - square / 6 + square**2 / 120, np.sin(safe) / safe)
    return first, np.where(small, 0.5 - square / 24 + square**2 / 720, 2 * (np.sin(0.5 * safe) / safe) ** 2)


def _of_changes(vectors: FloatArray) -> tuple[FloatArray, FloatArray]:
    square = (vectors**2).sum(axis=-1)
    angle = np.sqrt(square)
    small = angle < 1e-2
    safe = np.where(small, 1.0, angle)
    first = np.where(small, 0.5 - square / 24 + square**2 / 720, 2 * (np.sin(0.5 * safe) / safe) ** 2)
    return first, np.where(small, 1 / 6 - square / 120 + square**2 / 5040, (safe - np.sin(safe)) / safe**3)


def from_quaternions(quaternions: FloatArray) -> FloatArray:
    """Rotation matrices (count, 3, 3) of unit quaternions (count, 4), the scalar last."""
    v, w = quaternions[:, :3], quaternions[:, 3:, None]
    K = cross_matrix(v)
    return np.asarray(np.eye(3) + 2 * (w * K + K @ K))


def quaternion_product(a: FloatArray, b: FloatArray) -> FloatArray:
    """Of quaternions (count, 4), the scalar last: first ``b``, then ``a``."""
    v, w = cross(a[:, :3], b[:, :3]), a[:, 3] * b[:, 3] - (a[:, :3] * b[:, :3]).sum(axis=1)
    return np.concatenate([v + a[:, 3:] * b[:, :3] + b[:, 3:] * a[:, :3], w[:, None]], axis=1)


def to_quaternions(vectors: FloatArray) -> FloatArray:
    """Unit quaternions (count, 4), the scalar last, of rotation vectors (count, 3)."""
    half = 0.5 * np.sqrt((vectors**2).sum(axis=1, keepdims=True))
    return np.concatenate([0.5 * np.sinc(half / np.pi) * vectors, np.cos(half)], axis=1)


def of_quaternions(quaternions: FloatArray) -> FloatArray:
    """Rotation vectors (count, 3) of quaternions (count, 4) of any length but zero, the scalar last."""
    q = np.where(quaternions[:, 3:] < 0, -quaternions, quaternions)
    sine = np.sqrt((q[:, :3] ** 2).sum(axis=1))
    none = sine == 0
    scale = np.where(none, 0.0, 2 * np.arctan2(sine, q[:, 3]) / np.where(none, 1.0, sine))
    return np.asarray(scale[:, None] * q[:, :3])


def inverse_left_jacobian(vectors: FloatArray) -> FloatArray:
    """Changes of rotation vectors (..., 3) by rotation vectors, in the outer frame, of what they turn, (..., 3, 3).

    In the inner frame it is that of ``-vectors``.
    """
    square = (vectors**2).sum(axis=-1)
    half = 0.5 * np.sqrt(square)
    small = half < 5e-3
    safe = np.where(small, 1.0, half)
    factor = np.where(small, 1 / 12 + square / 720, (1 - safe / np.tan(safe)) / np.where(small, 1.0, square))
    K = cross_matrix(vectors)
    return np.asarray(np.eye(3) - 0.5 * K + factor[..., None, None] * (K @ K))


def vectors(matrices: FloatArray) -> FloatArray:
    """Rotation vectors (count, 3) of rotation matrices (count, 3, 3)."""
    # by sine and cosine, where the angle is not near half a turn
    half = 0.5 * (matrices[..., _LAST, _NEXT] - matrices[..., _NEXT, _LAST])
    sine = np.sqrt((half**2).sum(axis=-1))
    cosine = 0.5 * (matrices[..., 0, 0] + matrices[..., 1, 1] + matrices[..., 2, 2] - 1)
    small = sine < 1e-9
    scale = np.where(small, 1.0, np.arctan2(sine, cosine) / np.where(small, 1.0, sine))
    result = scale[..., None] * half
    far = ~(cosine > -0.5)
    if far.any():
        result[far] = _by_quaternion(matrices[far])
    return result


def _by_quaternion(matrices: FloatArray) -> FloatArray:
    # a quaternion, vector first, by the largest of its numbers
    diagonal = np.diagonal(matrices, axis1=-2, axis2=-1)
    trace = diagonal.sum(axis=-1)
    Q = np.zeros((*trace.shape, 4, 4))
    Q[..., :3, :3] = matrices + np.swapaxes(matrices, -1, -2)
    odd = matrices[..., _LAST, _NEXT] - matrices[..., _NEXT, _LAST]
    Q[..., :3, 3] = Q[..., 3, :3] = odd
    for k in range(3):
        Q[..., k, k] += 1 - trace
    Q[..., 3, 3] = 1 + trace
    largest = np.argmax(np.concatenate([diagonal, trace[..., None]], axis=-1), axis=-1)
    q = np.take_along_axis(Q, largest[..., None, None], axis=-2)[..., 0, :]
    return of_quaternions(q)
