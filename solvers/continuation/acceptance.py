"""By what a step along a branch of equilibria is taken to have stayed on it (``docs/solvers.md``, Which equilibrium).

One set of numbers for all paths, and the test of many small Jacobians. The kernels of ``continuation_kernels`` ask the same
of each instance, and ``solvers/segments`` of rods in segments.
"""

import numpy as np
from numpy.typing import NDArray

from multirod.validation import FloatArray

CONTRACTION = 0.3  # largest ratio of successive Newton steps
SMALLEST_RATIO = 0.25  # all eigenvalues of Gamma_new Gamma_old^-1 lie in the disc from this
LARGEST_RATIO = 4.0  # to this
RATIO_POWERS = 64.0  # powers by which that is told
RATIO_CENTRE, RATIO_RADIUS = 0.5 * (SMALLEST_RATIO + LARGEST_RATIO), 0.5 * (LARGEST_RATIO - SMALLEST_RATIO)
# centre, radius and powers of the discs that one of is enough: about 1, told at once, and the whole
RATIO_TESTS = ((1.0, 1.0 - SMALLEST_RATIO, 1.0), (RATIO_CENTRE, RATIO_RADIUS, RATIO_POWERS))
SURPRISE = 0.5  # largest distance of an equilibrium from its extrapolation, relative to its distance from the last
MIN_STEP = 1e-7  # of the load


def same_branch(gamma: FloatArray, before: FloatArray) -> NDArray[np.bool_]:
    """Whether all eigenvalues of ``gamma before^-1``, both (k, n, n), lie in the disc that one branch's do; shape (k,).

    No mode of ``Gamma`` came near zero or changed sign in between.
    """
    n = gamma.shape[-1]
    regular = np.linalg.det(before) != 0
    start = np.where(regular[:, None, None], before, np.eye(n))
    power, bound = 1.0, np.full(len(gamma), np.inf)
    with np.errstate(all="ignore"):
        E = gamma @ np.linalg.inv(start) - RATIO_CENTRE * np.eye(n)
        while power <= RATIO_POWERS:
            bound = np.fmin(bound, np.sqrt((E * E).sum(axis=(1, 2))) ** (1 / power))
            if (bound < RATIO_RADIUS).all():
                break
            E, power = E @ E, 2 * power
    return np.asarray(regular & (bound < RATIO_RADIUS))


def signs(gamma: FloatArray) -> FloatArray:
    """Signs of ``det Gamma`` (k, n, n): the parity of unstable modes; 0 where it is singular or not finite, shape (k,)."""
    return np.asarray(np.linalg.slogdet(np.nan_to_num(gamma))[0])
