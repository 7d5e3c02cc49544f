"""By what a step along a branch of equilibria is taken to have stayed on it (``docs/solvers.md``, Which equilibrium).

One set of numbers for all paths, and the test of the Jacobian: of many small ones, and of a rod in segments. The kernels of
``continuation_kernels`` ask the same of each instance.
"""

import numpy as np
from numpy.typing import NDArray

from multirod.segment_system import System
from multirod.validation import FloatArray

CONTRACTION = 0.3  # largest ratio of successive Newton steps
SMALLEST_RATIO = 0.25  # all eigenvalues of Gamma_new Gamma_old^-1 lie in the disc from this
LARGEST_RATIO = 4.0  # to this
RATIO_POWERS = 64.0  # powers by which that is told
SURPRISE = 0.5  # largest distance of an equilibrium from its extrapolation, relative to its distance from the last
MIN_STEP = 1e-7  # of the load
MODES = 8  # eigenvalues furthest from one that are looked at, of a rod in segments
DENSE = 120  # unknowns up to which all are


def same_branch(gamma: FloatArray, before: FloatArray) -> NDArray[np.bool_]:
    """Whether all eigenvalues of ``gamma before^-1``, both (k, n, n), lie in the disc that one branch's do; shape (k,).

    No mode of ``Gamma`` came near zero or changed sign in between.
    """
    n = gamma.shape[-1]
    regular = np.linalg.det(before) != 0
    start = np.where(regular[:, None, None], before, np.eye(n))
    centre, radius = 0.5 * (SMALLEST_RATIO + LARGEST_RATIO), 0.5 * (LARGEST_RATIO - SMALLEST_RATIO)
    power, bound = 1.0, np.full(len(gamma), np.inf)
    with np.errstate(all="ignore"):
        E = gamma @ np.linalg.inv(start) - centre * np.eye(n)
        while power <= RATIO_POWERS:
            bound = np.fmin(bound, np.linalg.norm(E, axis=(1, 2)) ** (1 / power))
            E, power = E @ E, 2 * power
    return np.asarray(regular & (bound < radius))


def same_branch_in_segments(before: System, after: System) -> bool:
    """The same of the Jacobians ``J`` of two equilibria on the same breakpoints.

    The eigenvalues of ``J_new J_old^-1`` do not depend on the units of states and residuals, nor on the frames they are told in,
    and their product is the ratio of the determinants of ``Gamma``. Those of the breakpoints are one: their real parts and
    magnitudes are bounded, not their distance from the centre of a disc.
    """
    if before.singular or after.singular:
        return False

    def change(x: FloatArray) -> FloatArray:
        return after.times(before.solve(x)) - x

    if before.size <= DENSE:
        shift = np.linalg.eigvals(np.linalg.solve(before.dense().T, after.dense().T) - np.eye(before.size))
        complete = True
    else:
        from scipy.sparse.linalg import ArpackError, ArpackNoConvergence, LinearOperator, eigs

        operator = LinearOperator((before.size, before.size), matvec=change, dtype=np.float64)
        try:
            start = np.ones(before.size)
            shift = eigs(operator, k=MODES, which="LM", v0=start, tol=1e-3, maxiter=200, return_eigenvectors=False)
        except (ArpackNoConvergence, ArpackError):
            return False
        complete = bool(np.abs(shift).min() < 1 - SMALLEST_RATIO)
    values = 1 + shift
    return complete and bool((values.real > SMALLEST_RATIO).all() and (np.abs(values) < LARGEST_RATIO).all())
