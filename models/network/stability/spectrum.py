"""Eigenvalues of a large symmetric form next to zero, and how many are below them, without a dense array.

Numbers in parentheses are those of ``docs/networks.md``.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from multirod.models.backbone.stability.condensing.second_variation import Eigenvalues, neutral_sizes, symmetric_eigenvalues
from multirod.validation import FloatArray

if TYPE_CHECKING:
    from scipy.sparse import csr_matrix

SPARSE = 150  # rows from which that pays
NEAREST = 8  # eigenvalues
SOFTEST = 1e-3  # by which constraints give way, at most
SAFE = 0.25  # of the eigenvalue next to zero, by which they may


def nearest_to_zero(
    form: "csr_matrix[np.float64]", constraints: Sequence[NDArray[np.intp]], firm: NDArray[np.bool_], count: int
) -> tuple[Eigenvalues, int] | None:
    """(18) Of the symmetric part of a sparse matrix: its ``count`` eigenvalues next to zero, and how many eigenvalues are lower
    than these; None where rounding hides it.

    Args:
        form: A matrix of SciPy's.
        constraints: Rows that are multipliers of constraints, of each rod.
        firm: As of ``symmetric_eigenvalues``, shape (n,).
        count: How many.

    Returns:
        Eigenvalues of one instance, shape (count,), and a number.
    """
    from scipy.sparse.linalg import ArpackError, LinearOperator, eigsh, splu

    symmetric: Any = (form + form.T) / 2
    rest: Any = (form - form.T) / 2
    try:
        factors = splu(symmetric.tocsc())
        inverse = LinearOperator(form.shape, matvec=factors.solve, dtype=np.float64)
        start = np.random.default_rng(0).standard_normal(form.shape[0])
        values, vectors = eigsh(symmetric, k=count, sigma=0.0, OPinv=inverse, v0=start)
    except (RuntimeError, ArpackError):
        return _whole(form, firm, count)
    order = np.argsort(values)
    values, vectors = values[order], vectors[:, order]
    softness = min(SOFTEST, SAFE * float(np.abs(values).min()))
    negative = _negative(symmetric.tocsr(), constraints, softness)
    if negative is None:
        return _whole(form, firm, count)
    told = Eigenvalues(values, np.linalg.norm(rest @ vectors, axis=0), neutral_sizes(vectors, firm))
    return told, negative - int((values < 0).sum())


def _negative(form: "csr_matrix[np.float64]", constraints: Sequence[NDArray[np.intp]], softness: float) -> int | None:
    """Negative eigenvalues, if nothing is unstable: constraints give way so little that none changes its sign, and are then
    eliminated, which leaves a matrix that is positive definite where its pivots are; None where it is not."""
    from scipy.sparse import block_diag, csr_matrix
    from scipy.sparse.linalg import splu

    at = np.concatenate([np.zeros(0, dtype=np.intp), *constraints])
    others = np.setdiff1d(np.arange(form.shape[0]), at)
    blocks = [form[own][:, own].toarray() - softness * np.eye(len(own)) for own in constraints]
    with np.errstate(all="ignore"):
        if not all(np.isfinite(own).all() and (np.linalg.eigvalsh(own) < 0).all() for own in blocks):
            return None
    coupling = form[at][:, others]
    inverse = block_diag([np.linalg.inv(own) for own in blocks], format="csr") if blocks else csr_matrix((0, 0))
    left = (form[others][:, others] - coupling.T @ inverse @ coupling).tocsc()
    try:
        factors = splu(left, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True})
    except RuntimeError:  # a pivot is zero
        return None
    symmetric = np.array_equal(factors.perm_r, factors.perm_c)
    return len(at) if symmetric and (factors.U.diagonal() > 0).all() else None


def _whole(form: "csr_matrix[np.float64]", firm: NDArray[np.bool_], count: int) -> tuple[Eigenvalues, int] | None:
    told = symmetric_eigenvalues(form.toarray()[None], np.ones(1, dtype=bool), firm[None])
    if not np.isfinite(told.values).all():
        return None
    first = int(np.clip(np.argsort(np.abs(told.values[0]))[:count].min(), 0, told.values.shape[1] - count))
    return Eigenvalues(*(own[0, first : first + count] for own in vars(told).values())), first


@dataclass(frozen=True)
class Scales:
    """Matrices that are diagonal but for blocks of three rows, of each instance.

    Attributes:
        diagonal: Shape (instance, n).
        places: Rows of the blocks, shape (k, 3).
        blocks: In the place of what is on the diagonal there, shape (instance, k, 3, 3).
    """

    diagonal: FloatArray
    places: NDArray[np.intp]
    blocks: FloatArray

    def before(self, matrices: FloatArray) -> FloatArray:
        """Their products with ``matrices`` (instance, n, m)."""
        result = self.diagonal[..., None] * matrices
        result[:, self.places] = self.blocks @ matrices[:, self.places]
        return result

    def after(self, matrices: FloatArray) -> FloatArray:
        """The products of ``matrices`` (instance, m, n) with them."""
        turned = Scales(self.diagonal, self.places, self.blocks.swapaxes(-1, -2))
        return turned.before(matrices.swapaxes(-1, -2)).swapaxes(-1, -2)

    def sparse(self, instance: int) -> "csr_matrix[np.float64]":
        """One of them."""
        from scipy.sparse import csr_matrix

        diagonal, places = self.diagonal[instance], self.places
        alone = np.ones(len(diagonal), dtype=bool)
        alone[places.reshape(-1)] = False
        at = np.flatnonzero(alone)
        rows, columns = np.broadcast_arrays(places[:, :, None], places[:, None])
        values = np.concatenate([diagonal[at], self.blocks[instance].reshape(-1)])
        both = np.concatenate([at, rows.reshape(-1)]), np.concatenate([at, columns.reshape(-1)])
        return csr_matrix((values, both), shape=(len(diagonal), len(diagonal)))
