# mypy: ignore-errors
"""Linear systems of arrow shape inside a kernel: blocks on the diagonal that meet only in a border, one system a thread.

With rows and columns in the order of the blocks, the border last,

    [A_1          C_1]
    [     A_2     C_2]
    [          .   . ]
    [B_1  B_2  .   D ]

is eliminated block by block with partial pivoting. Rows that can be chosen for a pivot in a block's columns are the block's own
and those of the border: all others are zero there. So this is Gaussian elimination with partial pivoting of the whole matrix,
and a block that is singular by itself (the tip of a straight inextensible leg does not answer an axial force) is no exception.
What is left of the border's rows is kept as ``T``, by which they multiply the columns ``B`` of blocks still to come: the work
grows linearly with the blocks.
"""

from functools import cache
from types import SimpleNamespace

import warp as wp

from multirod.kernels.linear_algebra_kernels import ONE_BY_ONE, copy_row, fill_row

f64 = wp.float64
VECTOR = 8  # numbers that a row of a front is a multiple of: rows are worked on whole, without a rest


@wp.struct
class Arrow:
    """Shape of a bordered matrix, and room to eliminate it."""

    count: int  # blocks, the border aside
    start: wp.array[int]  # (count + 2,): first row and column of each block, of the border, and the size of all
    pivots: wp.array4d[wp.float64]  # (instance, block, row, width): rows that pivots were chosen from, for substitution
    front: wp.array3d[wp.float64]  # (instance, border, width): rows of the border, that are being eliminated


# Rows have the columns of a block, those of the border, T, and the right-hand sides. Warp's own loops find the place of each
# number anew, and add one at a time.


@wp.func_native(
    """
    const int width = front.shape[2], sides = values.shape[2];
    double* P = &wp::index(pivots, t, block, 0, 0);
    for (int i = 0; i < columns; ++i) {
        double* __restrict row = P + i * width;
        const double* __restrict own = &wp::index(matrix, t, first + i, 0);
        const double* __restrict side = &wp::index(values, t, first + i, 0);
        for (int j = 0; j < columns; ++j) row[j] = own[first + j];
        for (int j = 0; j < border; ++j) row[at + j] = own[last + j];
        for (int j = 0; j < border; ++j) row[at + border + j] = 0.0;
        for (int j = 0; j < sides; ++j) row[at + 2 * border + j] = side[j];
        for (int j = 0; j < columns; ++j) size = fabs(row[j]) > size ? fabs(row[j]) : size;
    }
    for (int i = 0; i < border; ++i) {
        double* __restrict row = &wp::index(front, t, i, 0);
        for (int j = 0; j < columns; ++j) row[j] = 0.0;
        for (int k = 0; k < border; ++k) {
            const double m = row[at + border + k];
            if (m == 0.0) continue;
            const double* __restrict own = &wp::index(matrix, t, last + k, first);
            for (int j = 0; j < columns; ++j) row[j] += m * own[j];
        }
    }
    return size;
    """
)
def assemble(
    matrix: wp.array3d[wp.float64],
    values: wp.array3d[wp.float64],
    pivots: wp.array4d[wp.float64],
    front: wp.array3d[wp.float64],
    t: int,
    block: int,
    first: int,
    columns: int,
    at: int,
    border: int,
    last: int,
    size: wp.float64,
) -> wp.float64:
    """The rows of a block, among the pivots, and what is left of the border's rows in its columns: ``T B``.

    Returns the largest magnitude of a number of the block, or ``size`` if that is larger. The border's columns begin ``at``.
    """


@wp.func_native(
    """
    const int width = front.shape[2];
    double* const F = &wp::index(front, t, 0, 0);
    double* const P = block < 0 ? F : &wp::index(pivots, t, block, 0, 0);
    const int apart = block < 0 ? 0 : columns;  // rows before those of the border
    for (int c = 0; c < columns; ++c) {
        const int k = first + c;
        double* __restrict own = P + c * width;
        double* best = own;
        for (int i = c + 1; i < rows; ++i) {
            double* row = (i < apart ? P : F - apart * width) + i * width;
            if (fabs(row[k]) > fabs(best[k])) best = row;
        }
        if (best != own)
            for (int j = k; j < width; ++j) { double s = own[j]; own[j] = best[j]; best[j] = s; }
        if (fabs(own[k]) <= 1e-15 * size) own[k] = NAN;
        const double pivot = own[k];
        const int begin = k - k % VECTOR;  // numbers at k and before it are not looked at again
        for (int i = c + 1; i < rows; ++i) {
            double* __restrict row = (i < apart ? P : F - apart * width) + i * width;
            if (row[k] == 0.0) continue;
            const double m = row[k] / pivot;
            ONE_BY_ONE
            for (int j = begin; j < width; ++j) row[j] -= m * own[j];
        }
    }
    """.replace("ONE_BY_ONE", ONE_BY_ONE).replace("VECTOR", str(VECTOR))
)
def eliminate(
    pivots: wp.array4d[wp.float64],
    front: wp.array3d[wp.float64],
    t: int,
    block: int,
    first: int,
    columns: int,
    rows: int,
    size: wp.float64,
):
    """Pivots for ``columns`` columns from ``first`` on among ``rows`` rows, those of a block and of the border, or of the border
    alone if ``block`` is negative, each the first of those left; NaN if singular."""


@wp.func_native(
    """
    double x[VECTOR];
    for (int r = border - 1; r >= 0; --r) {
        const double* __restrict pivot = &wp::index(front, t, r, at);
        for (int j = 0; j < sides; ++j) x[j] = pivot[2 * border + j];
        for (int k = r + 1; k < border; ++k) {
            const double* __restrict other = &wp::index(values, t, last + k, 0);
            for (int j = 0; j < sides; ++j) x[j] -= pivot[k] * other[j];
        }
        for (int j = 0; j < sides; ++j) wp::index(values, t, last + r, j) = x[j] / pivot[r];
    }
    """.replace("VECTOR", str(VECTOR))
)
def substitute_border(
    values: wp.array3d[wp.float64], front: wp.array3d[wp.float64], t: int, at: int, border: int, last: int, sides: int
):
    """The solutions of the border, whose columns begin ``at``."""


@wp.func_native(
    """
    double x[VECTOR];
    for (int r = columns - 1; r >= 0; --r) {
        const double* __restrict pivot = &wp::index(pivots, t, block, r, 0);
        for (int j = 0; j < sides; ++j) x[j] = pivot[at + 2 * border + j];
        for (int k = r + 1; k < columns; ++k) {
            const double* __restrict other = &wp::index(values, t, first + k, 0);
            for (int j = 0; j < sides; ++j) x[j] -= pivot[k] * other[j];
        }
        for (int k = 0; k < border; ++k) {
            const double* __restrict known = &wp::index(values, t, last + k, 0);
            const double* __restrict done = &wp::index(front, t, k, 0);
            for (int j = 0; j < sides; ++j) x[j] -= pivot[at + k] * known[j];
            for (int j = 0; j < sides; ++j) x[j] -= pivot[at + border + k] * done[j];
        }
        for (int j = 0; j < sides; ++j) wp::index(values, t, first + r, j) = x[j] / pivot[r];
    }
    for (int k = 0; k < border; ++k) {
        const double* __restrict own = &wp::index(matrix, t, last + k, first);
        double* __restrict done = &wp::index(front, t, k, 0);
        for (int j = 0; j < sides; ++j) x[j] = done[j];
        for (int c = 0; c < columns; ++c) {
            const double* __restrict solved = &wp::index(values, t, first + c, 0);
            for (int j = 0; j < sides; ++j) x[j] += own[c] * solved[j];
        }
        for (int j = 0; j < sides; ++j) done[j] = x[j];
    }
    """.replace("VECTOR", str(VECTOR))
)
def substitute(
    matrix: wp.array3d[wp.float64],
    values: wp.array3d[wp.float64],
    pivots: wp.array4d[wp.float64],
    front: wp.array3d[wp.float64],
    t: int,
    block: int,
    first: int,
    columns: int,
    at: int,
    border: int,
    last: int,
    sides: int,
):
    """The solutions of a block, from those of the border and of the blocks behind it.

    What these contribute to the border's rows stands in the first columns of ``front``, to which the block's own is added.
    """


@wp.func_native(
    """
    double x[VECTOR];
    const double* __restrict own = &wp::index(matrix, t, row, 0);
    double* __restrict total = &wp::index(product, t, row, 0);
    for (int j = 0; j < sides; ++j) x[j] = total[j];
    for (int k = first; k < stop; ++k) {
        const double* __restrict other = &wp::index(values, t, k, 0);
        for (int j = 0; j < sides; ++j) x[j] += own[k] * other[j];
    }
    for (int j = 0; j < sides; ++j) total[j] = x[j];
    """.replace("VECTOR", str(VECTOR))
)
def add_product(
    matrix: wp.array3d[wp.float64],
    values: wp.array3d[wp.float64],
    product: wp.array3d[wp.float64],
    t: int,
    row: int,
    first: int,
    stop: int,
    sides: int,
):
    """To a row of ``product`` that of the columns ``first`` to ``stop`` of the matrix with solutions."""


def front_width(block: int, border: int, sides: int) -> int:
    """Columns of a front: a block's, the border's, T, and the right-hand sides, and as many more as vectors take."""
    return -(-(block + 2 * border + sides) // VECTOR) * VECTOR


@cache
def make_bordered(block: int, border: int, sides: int):
    """``solve(matrix, sides, t, arrow)`` for blocks of at most ``block`` rows: right-hand sides (n, sides) become solutions.

    ``sides`` are ``VECTOR`` at most.
    """
    assert sides <= VECTOR
    T_AT = block + border
    SIDE_AT = block + 2 * border

    @wp.func(inline=False)
    def solve(matrix: wp.array3d[wp.float64], values: wp.array3d[wp.float64], t: int, arrow: Arrow):
        last = arrow.start[arrow.count]
        size = f64(0.0)
        F = arrow.front
        P = arrow.pivots
        for i in range(wp.static(border)):
            fill_row(F, t, i, 0, F.shape[2], f64(0.0))
            F[t, i, wp.static(T_AT) + i] = f64(1.0)
            copy_row(F, matrix, t, i, wp.static(block), last + i, last, wp.static(border))
            for j in range(wp.static(border)):
                size = wp.max(size, wp.abs(matrix[t, last + i, last + j]))
            copy_row(F, values, t, i, wp.static(SIDE_AT), last + i, 0, wp.static(sides))
        for b in range(arrow.count):
            first = arrow.start[b]
            m = arrow.start[b + 1] - first
            size = assemble(matrix, values, P, F, t, b, first, m, wp.static(block), wp.static(border), last, size)
            eliminate(P, F, t, b, 0, m, m + wp.static(border), size)
        eliminate(P, F, t, -1, wp.static(block), wp.static(border), wp.static(border), size)
        substitute_border(values, F, t, wp.static(block), wp.static(border), last, wp.static(sides))
        for k in range(wp.static(border)):
            fill_row(F, t, k, 0, wp.static(sides), f64(0.0))
        for i in range(arrow.count):
            b = arrow.count - 1 - i
            first = arrow.start[b]
            m = arrow.start[b + 1] - first
            substitute(matrix, values, P, F, t, b, first, m, wp.static(block), wp.static(border), last, wp.static(sides))

    @wp.func(inline=False)
    def multiply(
        matrix: wp.array3d[wp.float64],
        values: wp.array3d[wp.float64],
        product: wp.array3d[wp.float64],
        t: int,
        arrow: Arrow,
    ):
        """Add the product of the matrix with solutions to ``product``."""
        last = arrow.start[arrow.count]
        end = arrow.start[arrow.count + 1]
        for b in range(arrow.count):
            first = arrow.start[b]
            stop = arrow.start[b + 1]
            for i in range(first, stop):
                add_product(matrix, values, product, t, i, first, stop, wp.static(sides))
                add_product(matrix, values, product, t, i, last, end, wp.static(sides))
        for i in range(last, end):
            add_product(matrix, values, product, t, i, 0, end, wp.static(sides))

    return SimpleNamespace(solve=solve, multiply=multiply)
