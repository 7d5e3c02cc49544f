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

from multirod.kernels.linear_algebra_kernels import add_row, copy_row, fill_row, subtract_row, swap_rows

f64 = wp.float64


@wp.struct
class Arrow:
    """Shape of a bordered matrix, and room to eliminate it."""

    count: int  # blocks, the border aside
    start: wp.array[int]  # (count + 2,): first row and column of each block, of the border, and the size of all
    pivots: wp.array4d[wp.float64]  # (instance, block, row, width): rows that pivots were chosen from, for substitution
    front: wp.array3d[wp.float64]  # (instance, block and border, width): what is being eliminated


@wp.func_native(
    "const double* a = &wp::index(matrix, t, i, at); double size = 0;"
    " for (int j = 0; j < count; j++) { double s = a[j] < 0 ? -a[j] : a[j]; size = s > size ? s : size; } return size;"
)
def largest(matrix: wp.array3d[wp.float64], t: int, i: int, at: int, count: int) -> wp.float64:
    """Largest magnitude of ``count`` numbers of a row."""


@wp.func_native("double* a = &wp::index(matrix, t, i, 0); for (int j = 0; j < count; j++) a[j] /= by;")
def divide_row(matrix: wp.array3d[wp.float64], t: int, i: int, count: int, by: wp.float64):
    """The first ``count`` numbers of a row."""


@wp.func_native(
    "double* a = &wp::index(pivots, t, block, i, 0); const double* b = &wp::index(front, t, i, 0);"
    " for (int j = 0; j < count; j++) a[j] = b[j];"
)
def keep_pivots(pivots: wp.array4d[wp.float64], front: wp.array3d[wp.float64], t: int, block: int, i: int, count: int):
    """A row that pivots were chosen from."""


def front_width(block: int, border: int, sides: int) -> int:
    """Columns of a front: a block's, the border's, T, and the right-hand sides."""
    return block + 2 * border + sides


@cache
def make_bordered(block: int, border: int, sides: int):
    """``solve(matrix, sides, t, arrow)`` for blocks of at most ``block`` rows: right-hand sides (n, sides) become solutions."""
    WIDTH = front_width(block, border, sides)
    T_AT = block + border
    SIDE_AT = block + 2 * border

    @wp.func(inline=False)
    def eliminate(F: wp.array3d[wp.float64], t: int, first: int, columns: int, rows: int, size: f64):
        """Pivots for ``columns`` columns from ``first`` on among ``rows`` rows, each the first of those left; NaN if singular."""
        for c in range(columns):
            k = first + c
            p = int(c)
            for i in range(c + 1, rows):
                if wp.abs(F[t, i, k]) > wp.abs(F[t, p, k]):
                    p = i
            if p != c:
                swap_rows(F, t, c, p, k, wp.static(WIDTH))
            if wp.abs(F[t, c, k]) <= f64(1.0e-15) * size:
                F[t, c, k] = f64(0.0) / f64(0.0)
            for i in range(c + 1, rows):
                if F[t, i, k] != f64(0.0):
                    subtract_row(F, t, i, c, k + 1, wp.static(WIDTH), F[t, i, k] / F[t, c, k])

    @wp.func(inline=False)
    def solve(matrix: wp.array3d[wp.float64], values: wp.array3d[wp.float64], t: int, arrow: Arrow):
        last = arrow.start[arrow.count]
        size = f64(0.0)
        F = arrow.front
        for i in range(wp.static(block + border)):
            fill_row(F, t, i, 0, wp.static(WIDTH), f64(0.0))
        for i in range(wp.static(border)):
            F[t, i, wp.static(T_AT) + i] = f64(1.0)
            copy_row(F, matrix, t, i, wp.static(block), last + i, last, wp.static(border))
            size = wp.max(size, largest(F, t, i, wp.static(block), wp.static(border)))
            copy_row(F, values, t, i, wp.static(SIDE_AT), last + i, 0, wp.static(sides))
        for b in range(arrow.count):
            # the border's rows, now those of T and the border alone, go below the block's
            first = arrow.start[b]
            m = arrow.start[b + 1] - first
            for i in range(wp.static(border)):
                r = wp.static(border) - 1 - i
                copy_row(F, F, t, m + r, wp.static(block), r, wp.static(block), wp.static(WIDTH - block))
            for i in range(m):
                copy_row(F, matrix, t, i, 0, first + i, first, m)
                size = wp.max(size, largest(F, t, i, 0, m))
                copy_row(F, matrix, t, i, wp.static(block), first + i, last, wp.static(border))
                fill_row(F, t, i, wp.static(T_AT), wp.static(border), f64(0.0))
                copy_row(F, values, t, i, wp.static(SIDE_AT), first + i, 0, wp.static(sides))
            for i in range(wp.static(border)):
                fill_row(F, t, m + i, 0, m, f64(0.0))
                for k in range(wp.static(border)):
                    add_row(F, matrix, t, m + i, 0, last + k, first, m, F[t, m + i, wp.static(T_AT) + k])
            eliminate(F, t, 0, m, m + wp.static(border), size)
            for i in range(m):
                keep_pivots(arrow.pivots, F, t, b, i, wp.static(WIDTH))
            for i in range(wp.static(border)):
                copy_row(F, F, t, i, wp.static(block), m + i, wp.static(block), wp.static(WIDTH - block))
        eliminate(F, t, wp.static(block), wp.static(border), wp.static(border), size)
        for i in range(wp.static(border)):
            r = wp.static(border) - 1 - i
            copy_row(values, F, t, last + r, 0, r, wp.static(SIDE_AT), wp.static(sides))
            for k in range(r + 1, wp.static(border)):
                subtract_row(values, t, last + r, last + k, 0, wp.static(sides), F[t, r, wp.static(block) + k])
            divide_row(values, t, last + r, wp.static(sides), F[t, r, wp.static(block) + r])
        # what the blocks already solved contribute to the border's rows, in the place of what was eliminated
        for k in range(wp.static(border)):
            fill_row(F, t, k, 0, wp.static(sides), f64(0.0))
        for i in range(arrow.count):
            b = arrow.count - 1 - i
            first = arrow.start[b]
            m = arrow.start[b + 1] - first
            for c in range(m):
                r = m - 1 - c
                for j in range(wp.static(sides)):
                    values[t, first + r, j] = arrow.pivots[t, b, r, wp.static(SIDE_AT) + j]
                for k in range(r + 1, m):
                    subtract_row(values, t, first + r, first + k, 0, wp.static(sides), arrow.pivots[t, b, r, k])
                for k in range(wp.static(border)):
                    pivot = arrow.pivots[t, b, r, wp.static(block) + k]
                    subtract_row(values, t, first + r, last + k, 0, wp.static(sides), pivot)
                    add_row(values, F, t, first + r, 0, k, 0, wp.static(sides), -arrow.pivots[t, b, r, wp.static(T_AT) + k])
                divide_row(values, t, first + r, wp.static(sides), arrow.pivots[t, b, r, r])
            for k in range(wp.static(border)):
                for c in range(m):
                    add_row(F, values, t, k, 0, first + c, 0, wp.static(sides), matrix[t, last + k, first + c])

    @wp.func(inline=False)
    def multiply(
        matrix: wp.array3d[wp.float64],
        values: wp.array3d[wp.float64],
        product: wp.array3d[wp.float64],
        t: int,
        row: int,
        arrow: Arrow,
    ):
        """Add a row of the product of the matrix with solutions to that row of ``product``."""
        last = arrow.start[arrow.count]
        first = int(0)
        stop = last
        if row < last:
            b = int(0)
            while arrow.start[b + 1] <= row:
                b += 1
            first = arrow.start[b]
            stop = arrow.start[b + 1]
        for k in range(first, stop):
            add_row(product, values, t, row, 0, k, 0, wp.static(sides), matrix[t, row, k])
        for k in range(last, last + wp.static(border)):
            add_row(product, values, t, row, 0, k, 0, wp.static(sides), matrix[t, row, k])

    return SimpleNamespace(solve=solve, multiply=multiply)
