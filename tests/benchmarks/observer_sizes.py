"""What the law of the observer takes of one block, by LAPACK and by kernels: processor time of a sample, the least of many.

A kernel of a block's own size is compiled anew for each size, at its first call from an empty cache. One for all sizes would
diagonalise two symmetric matrices a sample in arrays: what that alone takes is the last column.

python tests/benchmarks/observer_sizes.py [--largest N] [--repeats N]
"""

import argparse
from collections.abc import Callable
from time import perf_counter, process_time
from typing import Any

import numpy as np
import warp as wp

import multirod as mr
from multirod.launch import record
from multirod.problem import Block
from multirod.solvers import observer as observer_module
from multirod.solvers.tracking.symmetric_kernels import ROOM, diagonalise

SIZES = (3, 5, 8, 12, 18, 24, 42, 72)  # a rod, three tubes, the largest in a kernel; six legs are 42, twelve rods on a body 78
DT = 0.005


class Frozen(mr.BoundaryProblem):
    """``eps = Gamma x``, one block."""

    def __init__(self, gamma: np.ndarray) -> None:
        n = len(gamma)
        whole = Block("all", slice(0, n), slice(0, n))
        super().__init__(unknown_count=n, batch_shape=(), input_count=n, blocks=[whole])
        self.write("gamma", gamma.reshape(1, -1))

    def guess(self) -> np.ndarray:
        return np.zeros((1, self.unknown_count))

    def input_slice(self, name: str) -> slice:
        return slice(0, self.unknown_count)

    def _integrate(self) -> None:
        """Nothing: the residual stays as it was written."""


@wp.kernel(module="unique", enable_backward=False)
def two_diagonalised(
    given: wp.array3d[wp.float64], matrix: wp.array3d[wp.float64], modes: wp.array3d[wp.float64], values: wp.array2d[wp.float64]
):
    for _k in range(2):
        for i in range(given.shape[1]):
            for j in range(given.shape[1]):
                matrix[0, i, j] = given[0, i, j]
        diagonalise(matrix, modes, values, 0)


def least(call: Callable[[], Any], repeats: int) -> float:
    """Processor time [µs]."""
    times = []
    for _ in range(repeats):
        begin = process_time()
        for _ in range(10):
            call()
        times.append(1e5 * (process_time() - begin))
    return min(times)


def updated(gamma: np.ndarray, largest: int) -> tuple[Callable[[], Any], float]:
    """What takes a sample, without the integration, by a kernel up to so many unknowns; and the first, wall time [s]."""
    observer_module.LARGEST_IN_KERNEL = largest
    problem = Frozen(gamma)
    problem.write("residual", np.ones((1, len(gamma))))
    begin = perf_counter()
    track = mr.Observer().track(problem, DT)
    track._update()
    return track._update, perf_counter() - begin


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--largest", type=int, default=12, help="of the kernels of a size of their own")
    parser.add_argument("--repeats", type=int, default=30)
    options = parser.parse_args()
    print("| unknowns | LAPACK [µs] | kernel of that size [µs] | its first call [s] | two diagonalised in arrays [µs] |")
    print("|---|---|---|---|---|")
    for n in SIZES:
        gamma = 2 * np.eye(n) + np.random.default_rng(n).normal(size=(n, n)) / np.sqrt(n)
        lapack = least(updated(gamma, 0)[0], options.repeats)
        own, first = (f"{value:.1f}" for value in (np.nan, np.nan))
        if n <= options.largest:
            update, begun = updated(gamma, n)
            own, first = f"{least(update, options.repeats):.1f}", f"{begun:.1f}"
        given: Any = wp.array((gamma @ gamma.T)[None], dtype=wp.float64, device="cpu")
        room = [wp.zeros_like(given), wp.zeros_like(given), wp.zeros((1, ROOM * n), dtype=wp.float64, device="cpu")]
        launch = record(lambda: two_diagonalised, 1, [given, *room], "cpu")
        launch.launch()
        print(f"| {n} | {lapack:.1f} | {own} | {first} | {least(launch.launch, options.repeats):.1f} |", flush=True)


if __name__ == "__main__":
    main()
