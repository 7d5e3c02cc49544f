"""Linear algebra of estimates: the step to the most probable numbers, their covariance, and what of them is seen.

Numbers in parentheses are those of ``docs/estimation.md``.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from math import prod

import numpy as np
from numpy.typing import NDArray

from multirod.batch import IntArray
from multirod.validation import FloatArray

SETTLED = 1e-2  # standard deviations: a last step that is less adds 1e-4 to the error's variance
UNSEEN = 1e-10  # of the largest singular value, each number in its unit: what is less is not determined at all
BISECTIONS = 30  # of the damping
MILDEST = 1e-12  # damping that is looked at first, over the largest there may be
CONSISTENT = 0.999  # part of sound measurements whose misfit is no more than is looked for
SHARE = 1e-6  # of a direction that is not determined, from which on a number that takes part in it is not


@dataclass(frozen=True)
class Posterior:
    """Normal distributions to first order, one an instance.

    Attributes:
        step: (5) From the numbers at hand to the mean, shape (b, k).
        covariance: (6), shape (b, k, k); of a number that is not determined infinite, and NaN beside that.
        length: (7) Of the step, in standard deviations, shape (b,).
    """

    step: FloatArray
    covariance: FloatArray
    length: FloatArray


def roots(covariance: FloatArray) -> FloatArray:
    """(4) ``Lambda`` (b, k, k) with ``Lambda^T Lambda`` the inverse of covariances; no rows of what is infinite."""
    flat = np.isinf(np.diagonal(covariance, axis1=1, axis2=2))
    finite = np.where(flat[:, :, None] | flat[:, None, :], np.eye(flat.shape[1]), covariance)
    inverse = np.linalg.inv(np.linalg.cholesky(finite))
    return np.asarray(np.where(flat[:, :, None], 0.0, inverse))


def block_diagonal(blocks: Sequence[FloatArray]) -> FloatArray:
    """(b, k, k) of blocks of each."""
    size = sum(block.shape[-1] for block in blocks)
    result = np.zeros((len(blocks[0]), size, size))
    first = 0
    for block in blocks:
        last = first + block.shape[-1]
        result[:, first:last, first:last] = block
        first = last
    return result


def deviations(covariance: FloatArray) -> FloatArray:
    """Standard deviations of covariances (b, k, k), shape (b, k)."""
    return np.asarray(np.sqrt(np.diagonal(covariance, axis1=1, axis2=2)))


def units(J: FloatArray, covariance: FloatArray) -> FloatArray:
    """What each number is counted in, (b, k): its prior's deviation, without one what the rows tell it to."""
    sigma = deviations(covariance)
    size = np.sqrt((J**2).sum(axis=1))
    told = 1 / np.where(size > 0, size, 1.0)
    return np.asarray(np.where(np.isinf(sigma), told, sigma))


def posterior(J: FloatArray, r: FloatArray, root: FloatArray, away: FloatArray, unit: FloatArray) -> Posterior:
    """(5) to (7) of whitened rows: the least of ``|r + J d|^2 + |root (away + d)|^2``, by a singular value decomposition.

    Args:
        J: Shape (b, m, k).
        r: Shape (b, m).
        root: ``Lambda`` of the prior, shape (b, k, k).
        away: ``p - p0``, shape (b, k); anything where nothing is known.
        unit: What each number is counted in, shape (b, k).
    """
    stacked = np.concatenate([J, root], axis=1) * unit[:, None, :]
    sides = np.concatenate([r, (root @ away[..., None])[..., 0]], axis=1)
    left, size, right = np.linalg.svd(stacked, full_matrices=False)
    seen = size > UNSEEN * size[:, :1]
    inverse = np.where(seen, 1 / np.where(seen, size, 1.0), 0.0)
    along = -(np.swapaxes(left, 1, 2) @ sides[..., None])[..., 0] * seen
    scaled = np.swapaxes(right, 1, 2) * inverse[:, None, :]
    covariance = scaled @ np.swapaxes(scaled, 1, 2) * unit[:, :, None] * unit[:, None, :]
    if not seen.all():
        lost = ((right**2) * ~seen[..., None]).sum(axis=1) > SHARE
        covariance = np.where(lost[:, :, None] | lost[:, None, :], np.nan, covariance)
        across = np.arange(lost.shape[1])
        covariance[:, across, across] = np.where(lost, np.inf, covariance[:, across, across])
    return Posterior((scaled @ along[..., None])[..., 0] * unit, covariance, np.sqrt((along**2).sum(axis=1)))


def damping(J: FloatArray, r: FloatArray, root: FloatArray, away: FloatArray, unit: FloatArray, part: FloatArray) -> FloatArray:
    """(16) ``mu`` (b,) by which the step of ``posterior`` is so many times as long as without, ``part`` (b,), below 1."""
    left, size, _ = np.linalg.svd(np.concatenate([J, root], axis=1) * unit[:, None, :], full_matrices=False)
    sides = np.concatenate([r, (root @ away[..., None])[..., 0]], axis=1)
    along = (np.swapaxes(left, 1, 2) @ sides[..., None])[..., 0]
    size = np.where(size > UNSEEN * size[:, :1], size, np.inf)

    def length(mu: FloatArray) -> FloatArray:
        return np.asarray(np.linalg.norm(along / (size + mu[:, None] / size), axis=1))

    # by so much damping no component is more than that part of itself
    low, high = np.zeros(len(part)), size.max(axis=1, where=np.isfinite(size), initial=0.0) ** 2 / part
    wanted = part * length(low)
    for _ in range(BISECTIONS):
        middle = np.where(low > 0, np.sqrt(low * high), MILDEST * high)
        long = length(middle) > wanted
        low, high = np.where(long, middle, low), np.where(long, high, middle)
    return np.asarray(high)


def largest_square(degrees: IntArray, part: float) -> FloatArray:
    """(15), (18) What the squares of so many normal numbers of variance 1 are at most, by ``part`` of them; of none, anything."""
    from scipy.special import gammaincinv

    with np.errstate(invalid="ignore"):
        return np.where(degrees > 0, 2 * gammaincinv(0.5 * np.maximum(degrees, 1), part), np.inf)


def consistent(square: FloatArray | float, degrees: IntArray | int) -> NDArray[np.bool_]:
    """(18) Whether no more is left than sound measurements leave."""
    return np.asarray(square <= largest_square(np.asarray(degrees), CONSISTENT))


def kept(covariance: FloatArray, prior: FloatArray) -> FloatArray:
    """(8) What part of its prior's variance each number has kept, shape (..., k): 1 where nothing was told of it."""
    after, before = np.diagonal(covariance, axis1=-2, axis2=-1), np.diagonal(prior, axis1=-2, axis2=-1)
    with np.errstate(invalid="ignore"):
        return np.asarray(np.where(np.isinf(before), np.where(np.isinf(after), 1.0, 0.0), np.minimum(after / before, 1.0)))


def principal(covariance: FloatArray, prior: FloatArray) -> tuple[FloatArray, FloatArray]:
    """(9) Directions (..., k, k), unit columns, and what part of the prior's variance is kept along each, (..., k), most first.

    NaN where a covariance is not finite.
    """
    k = covariance.shape[-1]
    count = prod(covariance.shape[:-2])
    flat_after, flat_before = (np.broadcast_to(own, covariance.shape).reshape(count, k, k) for own in (covariance, prior))
    axes, parts = np.full((len(flat_after), k, k), np.nan), np.full((len(flat_after), k), np.nan)
    sound = np.isfinite(flat_after).all(axis=(1, 2)) & np.isfinite(flat_before).all(axis=(1, 2))
    root = np.linalg.cholesky(flat_before[sound])
    inverse = np.linalg.inv(root)
    values, vectors = np.linalg.eigh(inverse @ flat_after[sound] @ np.swapaxes(inverse, 1, 2))
    turned = (root @ vectors)[..., ::-1]
    axes[sound] = turned / np.linalg.norm(turned, axis=1, keepdims=True)
    parts[sound] = np.clip(values[:, ::-1], 0.0, 1.0)
    return axes.reshape(covariance.shape), parts.reshape(covariance.shape[:-1])
