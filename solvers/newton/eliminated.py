"""Newton's steps, and how unlike two ``Gamma`` are, by a problem's ``elimination``: told before the kernels ask for them."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from multirod.elimination import Elimination
from multirod.problem import BoundaryProblem
from multirod.solvers.newton.newton_kernels import PROBES, TOLD, UNLIKE
from multirod.validation import FloatArray

BoolArray = NDArray[np.bool_]
Test = tuple[float, float, float]  # centre, what radius is enough, most powers


class Eliminated:
    """On the CPU, between an integration and the launch of the kernel that goes by it.

    Args:
        problem: Which offers ``elimination``.
        tolerance: Largest residual of each instance [1/m], shape (instance_count,).

    Attributes:
        gamma: The numbers of ``Gamma`` of each instance, shape (instance_count, 1, k).
        direction: Its Newton step, shape (instance_count, n, 1).
        told: Bounds on eigenvalues: of each test of the first, then of the second matrix that ``Gamma`` is compared with, shape
            (instance_count, TOLD).
    """

    def __init__(self, problem: BoundaryProblem, elimination: Elimination, tolerance: FloatArray) -> None:
        count, n = problem.instance_count, problem.unknown_count
        self._problem, self._elimination, self.tolerance = problem, elimination, tolerance
        self.gamma: Any = wp.zeros((count, 1, elimination.count), dtype=wp.float64, device=problem.device)
        self.direction: Any = wp.zeros((count, n, 1), dtype=wp.float64, device=problem.device)
        self.told: Any = wp.zeros((count, TOLD), dtype=wp.float64, device=problem.device)
        self._signs = np.random.default_rng(0).choice([-1.0, 1.0], size=(n, PROBES))

    def find(self, looked: BoolArray | None, others: Sequence[tuple[Any, BoolArray]], tests: Sequence[Test]) -> None:
        """After an integration: what the kernel will ask of the active instances.

        Args:
            looked: Of which the step is asked for whatever the residual is, shape (instance_count,); None for none.
            others: What ``Gamma`` is compared with where the residual is within the tolerance, or in ``looked`` the first:
                numbers (instance_count, 1, k), and of which instances there are any.
            tests: Of each comparison; one that is passed makes the next needless, one that is not the next matrix.
        """
        problem, elimination = self._problem, self._elimination
        rows = problem.order.numpy()[: problem.listed]
        rows = rows[problem.active.numpy()[rows] != 0]
        numbers, direction, told = self.gamma.numpy(), self.direction.numpy(), self.told.numpy()
        residual = problem.read("residual")
        numbers[rows, 0] = problem.numbers_of_gamma(rows)
        told[rows], direction[rows] = UNLIKE, np.nan
        for t in rows.tolist():
            if not np.isfinite(residual[t]).all():
                continue
            there = bool(np.abs(residual[t]).max() <= self.tolerance[t])
            halfway = looked is not None and bool(looked[t])
            if halfway or not there:
                direction[t, :, 0] = -elimination.solved(numbers[t, 0], residual[t])
            if not (there or halfway):
                continue
            for which, (other, known) in enumerate(others[:1] if halfway else others):
                if not known[t] or not self._compare(told[t, 2 * which :], numbers[t, 0], other[t, 0], tests):
                    break

    def _compare(self, told: FloatArray, numbers: FloatArray, other: FloatArray, tests: Sequence[Test]) -> bool:
        """Whether a test is passed; the bounds are left in ``told``."""
        for k, (centre, enough, most) in enumerate(tests):
            told[k] = self.radius(numbers, other, centre, enough, most)
            if told[k] < enough:
                return True
        return False

    def radius(self, numbers: FloatArray, other: FloatArray, centre: float, enough: float, most: float) -> float:
        """Bound on the distance from ``centre`` of the eigenvalues of ``Gamma other^-1``.

        It goes by estimates of the norms of powers: the mean of |E z|^2 over vectors z of random signs is the square of the
        Frobenius norm.
        """
        factors = self._elimination.factors(other)
        if factors is None or not np.isfinite(numbers).all():
            return UNLIKE
        matrix, z = self._elimination.matrix(numbers), self._signs
        bound, power = UNLIKE, 0
        while bound > enough and power < most:
            with np.errstate(over="ignore"):
                z = matrix @ factors.solve(z) - centre * z
                total = float(np.sum(z * z)) / PROBES
            power += 1
            if not np.isfinite(total):
                break
            bound = min(bound, total ** (0.5 / power))
        return bound
