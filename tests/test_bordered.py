"""Elimination of arrow-shaped systems against LAPACK, also where blocks are singular by themselves."""

import numpy as np
import pytest
import warp as wp

from multirod.solvers.newton.bordered_kernels import Arrow, front_width, make_bordered

BORDER = 6


def arrow_matrix(sizes, rng, singular=False):
    n = sum(sizes) + BORDER
    A = np.zeros((n, n))
    first = 0
    for block, size in enumerate(sizes):
        own = slice(first, first + size)
        A[own, own] = rng.standard_normal((size, size))
        if singular and block < BORDER:  # the border can make up for as many
            A[own, first + size - 1] = 0  # nothing in the block's own rows answers its last unknown
        A[own, -BORDER:] = rng.standard_normal((size, BORDER))
        A[-BORDER:, own] = rng.standard_normal((BORDER, size))
        first += size
    A[-BORDER:, -BORDER:] = rng.standard_normal((BORDER, BORDER))
    return A


def solved(matrices, sides, sizes):
    """Solutions of many systems of one shape, shape (count, n, sides)."""
    block, count = max(sizes), len(matrices)
    functions = make_bordered(block, BORDER, sides.shape[2])
    solve, multiply = functions.solve, functions.multiply

    @wp.kernel(module="unique", enable_backward=False)
    def run(matrix: wp.array3d[wp.float64], values: wp.array3d[wp.float64], back: wp.array3d[wp.float64], arrow: Arrow):
        t = wp.tid()
        solve(matrix, values, t, arrow)
        multiply(matrix, values, back, t, arrow)

    arrow = Arrow()
    arrow.count = len(sizes)
    starts = np.cumsum([0, *sizes, BORDER]).astype(np.int32)
    arrow.start = wp.array(starts, dtype=wp.int32, device="cpu")
    width = front_width(block, BORDER, sides.shape[2])
    arrow.pivots = wp.zeros((count, len(sizes), block, width), dtype=wp.float64, device="cpu")
    arrow.front = wp.zeros((count, BORDER, width), dtype=wp.float64, device="cpu")
    matrix = wp.array(np.stack(matrices), dtype=wp.float64, device="cpu")
    values = wp.array(sides, dtype=wp.float64, device="cpu")
    back = wp.zeros_like(values)
    wp.launch(run, dim=count, inputs=[matrix, values, back, arrow], device="cpu")
    return values.numpy(), back.numpy()


@pytest.mark.parametrize("singular", [False, True])
@pytest.mark.parametrize("sizes", [(6, 6), (6, 7, 9, 6), (6,) * 12, (3,)])
def test_against_lapack(sizes, singular):
    rng = np.random.default_rng(len(sizes))
    matrices = [arrow_matrix(sizes, rng, singular) for _ in range(5)]
    sides = rng.standard_normal((5, len(matrices[0]), 2))
    found, back = solved(matrices, sides, sizes)
    for A, b, x, product in zip(matrices, sides, found, back, strict=True):
        expected = np.linalg.solve(A, b)
        # both are partial pivoting: rounding times the condition number
        np.testing.assert_allclose(x, expected, rtol=0, atol=1e-14 * np.linalg.cond(A) * np.abs(expected).max())
        np.testing.assert_allclose(product, b, rtol=0, atol=1e-12 * np.linalg.norm(A) * np.abs(expected).max())


def test_a_singular_system_has_no_solution():
    rng = np.random.default_rng(1)
    A = arrow_matrix((6, 6), rng)
    A[:, 3] = 0
    found, _ = solved([A], rng.standard_normal((1, len(A), 1)), (6, 6))
    assert np.isnan(found).any()
