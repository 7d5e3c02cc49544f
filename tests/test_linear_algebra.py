"""Linear algebra inside kernels against LAPACK: arrow-shaped systems, also where blocks are singular by themselves, and
symmetric matrices, also where eigenvalues are equal or nearly so."""

import numpy as np
import pytest
import warp as wp

from multirod.kernels.own_module import own_module
from multirod.solvers.newton.bordered_kernels import Arrow, front_width, make_bordered
from multirod.solvers.tracking.symmetric_kernels import FEW, ROOM, diagonalise, least_eigenvalue

BORDER = 6
ROUNDING = np.finfo(float).eps


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
def test_arrows_against_lapack(sizes, singular):
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


@own_module()
def taken_apart(
    given: wp.array3d[wp.float64],
    matrix: wp.array3d[wp.float64],
    modes: wp.array3d[wp.float64],
    values: wp.array2d[wp.float64],
    least: wp.array[wp.float64],
):
    t = wp.tid()
    for i in range(given.shape[1]):
        for j in range(given.shape[1]):
            matrix[t, i, j] = given[t, i, j]
    least[t] = least_eigenvalue(matrix, values, t)
    for i in range(given.shape[1]):
        for j in range(given.shape[1]):
            matrix[t, i, j] = given[t, i, j]
    diagonalise(matrix, modes, values, t)


def spectrum(matrices):
    """Least eigenvalues (count,), eigenvalues (count, n) and modes (count, n, n)."""
    count, n, _ = matrices.shape
    given = wp.array(matrices, dtype=wp.float64, device="cpu")
    room = [wp.zeros_like(given), wp.zeros_like(given), wp.zeros((count, ROOM * n), dtype=wp.float64, device="cpu")]
    least = wp.zeros(count, dtype=wp.float64, device="cpu")
    wp.launch(taken_apart, dim=count, inputs=[given, *room, least], device="cpu")
    return least.numpy(), room[2].numpy()[:, :n], room[1].numpy()


def of_spectrum(values, rng):
    """A symmetric matrix with these eigenvalues."""
    Q, _ = np.linalg.qr(rng.standard_normal((len(values), len(values))))
    return 0.5 * ((Q * values) @ Q.T + ((Q * values) @ Q.T).T)


def spectra(n):
    """Kinds of spectra, and matrices that need no or few rotations."""
    rng = np.random.default_rng(n)
    spread = np.sort(rng.standard_normal(n))
    near = np.ones(n)
    near[: max(1, n // 2)] += 1e-14 * np.arange(max(1, n // 2))
    decades = np.logspace(-8, 4, n)
    negative = decades * np.where(np.arange(n) % 3, 1.0, -1.0)
    pair = spread.copy()
    pair[: min(2, n)] = -3.0
    yield from (of_spectrum(values, rng) for values in (spread, near, decades, negative, pair, -np.ones(n), np.zeros(n)))
    yield np.diag(spread)
    yield np.eye(n) + np.diag(np.full(n - 1, 0.5), 1) + np.diag(np.full(n - 1, 0.5), -1)  # tridiagonal already
    yield np.ones((n, n))  # of rank one
    yield np.kron(np.eye(-(-n // 2)), [[0, 1], [1, 0]])[:n, :n]  # a zero diagonal, equal in pairs
    yield 1e-100 * of_spectrum(spread, rng)
    yield 1e100 * of_spectrum(spread, rng)


@pytest.mark.parametrize("n", [1, 2, 3, FEW, FEW + 1, 21, 43])
def test_symmetric_matrices_against_lapack(n):
    matrices = np.array(list(spectra(n)))
    least, values, modes = spectrum(matrices)
    for k, A in enumerate(matrices):
        expected, size = np.linalg.eigvalsh(A), np.abs(A).sum(axis=1).max()
        near = 10 * n * ROUNDING * size  # backward stable: rounding of some n operations, relative to the norm
        assert abs(least[k] - expected[0]) <= near, k
        np.testing.assert_allclose(np.sort(values[k]), expected, rtol=0, atol=near)
        np.testing.assert_allclose(modes[k].T @ modes[k], np.eye(n), rtol=0, atol=10 * n * ROUNDING)
        np.testing.assert_allclose(A @ modes[k], modes[k] * values[k], rtol=0, atol=near)
        if n > FEW:
            assert (modes[k][np.abs(modes[k]).argmax(axis=0), range(n)] > 0).all()


def test_what_is_not_finite_has_no_least_eigenvalue():
    matrices = np.ones((2, 12, 12))
    matrices[0, 3, 4] = matrices[0, 4, 3] = np.nan
    matrices[1, 11, 11] = np.inf
    assert np.isnan(spectrum(matrices)[0]).all()
