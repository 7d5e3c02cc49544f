"""Linear algebra inside kernels against LAPACK: arrow-shaped systems, also where blocks are singular by themselves, and
symmetric matrices, also where eigenvalues are equal or nearly so."""

import numpy as np
import pytest
import warp as wp

from multirod.kernels.linear_algebra_kernels import eliminate
from multirod.kernels.own_module import own_module
from multirod.kernels.small_systems_kernels import SMALL, small_quotient, small_radius, small_step
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


@own_module()
def of_small_systems(
    A: wp.array3d[wp.float64],
    B: wp.array3d[wp.float64],
    e: wp.array2d[wp.float64],
    step: wp.array3d[wp.float64],
    quotient: wp.array3d[wp.float64],
    bounds: wp.array2d[wp.float64],
    room: wp.array3d[wp.float64],
    sides: wp.array3d[wp.float64],
):
    t = wp.tid()
    bounds[t, 0] = small_step(A, e, step, t)
    small_quotient(A, B, quotient, t)
    bounds[t, 1] = small_radius(quotient, t, wp.float64(2.0), wp.float64(0.0), wp.float64(1.0))
    bounds[t, 2] = small_radius(quotient, t, wp.float64(2.0), wp.float64(0.0), wp.float64(64.0))
    for i in range(A.shape[1]):
        for j in range(A.shape[1]):
            room[t, i, j] = B[t, j, i]
            sides[t, i, j] = A[t, j, i]
    eliminate(room, sides, t)


@pytest.mark.parametrize("n", [1, 3, 5, SMALL])
def test_small_systems_are_those_of_any_size(n):
    """By LAPACK, and to the last bit by the elimination of systems of any size; a singular one has no solution."""
    rng = np.random.default_rng(n)
    A, B, e = rng.standard_normal((20, n, n)), rng.standard_normal((20, n, n)), rng.standard_normal((20, n))
    A[-1], B[-1] = 0.0, 0.0
    given = [wp.array(own, dtype=wp.float64, device="cpu") for own in (A, B, e)]
    shapes = [(20, n, 1), (20, n, n), (20, 3), (20, n, n), (20, n, n)]
    step, quotient, bounds, room, sides = (wp.zeros(shape, dtype=wp.float64, device="cpu") for shape in shapes)
    wp.launch(of_small_systems, dim=20, inputs=[*given, step, quotient, bounds, room, sides], device="cpu")
    np.testing.assert_array_equal(quotient.numpy(), sides.numpy())
    assert not np.isfinite(bounds.numpy()[-1, :2]).any()
    found, length, frobenius, radius = step.numpy()[:-1, :, 0], *bounds.numpy()[:-1].T
    close = 1e-13 * np.linalg.cond(A[:-1])[:, None]  # rounding, by the condition
    expected = np.linalg.solve(A[:-1], -e[:-1, :, None])[..., 0]
    assert (np.abs(found - expected) <= close * np.linalg.norm(expected, axis=1)[:, None]).all()
    np.testing.assert_allclose(length, np.linalg.norm(found, axis=1), rtol=1e-14)
    E = np.transpose(quotient.numpy()[:-1], (0, 2, 1)) - 2 * np.eye(n)
    ratio = A[:-1] @ np.linalg.inv(B[:-1]) - 2 * np.eye(n)
    size = np.linalg.norm(ratio, axis=(1, 2))
    assert (np.abs(E - ratio).max(axis=(1, 2)) <= 1e-13 * np.linalg.cond(B[:-1]) * size).all()
    np.testing.assert_allclose(frobenius, np.linalg.norm(E, axis=(1, 2)), rtol=1e-13)
    largest = np.abs(np.linalg.eigvals(E)).max(axis=1)
    # the 64th power's norm is more than the radius's power by less than n times the condition of the eigenvectors, below 1e6 here
    assert ((largest <= radius * (1 + 1e-9)) & (radius <= 1.3 * largest)).all()


def test_a_gpu_can_run_what_is_written_in_its_compilers_words(tmp_path):
    """Compiled to PTX, which takes no GPU: functions of its own language may call what the processor's compiler alone has."""
    wp.compile_aot_module(of_small_systems.module, device=None, arch=80, module_dir=str(tmp_path), use_ptx=True)
    assert [file.suffix for file in tmp_path.iterdir()].count(".ptx") == 1
