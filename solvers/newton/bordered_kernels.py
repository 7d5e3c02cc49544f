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

f64 = wp.float64


@wp.struct
class Arrow:
    """Shape of a bordered matrix, and room to eliminate it."""

    count: int  # blocks, the border aside
    start: wp.array[int]  # (count + 2,): first row and column of each block, of the border, and the size of all
    pivots: wp.array4d[wp.float64]  # (instance, block, row, width): rows that pivots were chosen from, for substitution
    front: wp.array3d[wp.float64]  # (instance, block and border, width): what is being eliminated


def front_width(block: int, border: int, sides: int) -> int:
    """Columns of a front: a block's, the border's, T, and the right-hand sides."""
    return block + 2 * border + sides


@cache
def make_bordered(block: int, border: int, sides: int):
    """``solve(matrix, sides, t, arrow)`` for blocks of at most ``block`` rows: right-hand sides (n, sides) become solutions."""
    WIDTH = front_width(block, border, sides)
    T_AT = block + border
    SIDE_AT = block + 2 * border
    Rest = wp.types.matrix(shape=(border, sides), dtype=f64)

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
                for j in range(k, wp.static(WIDTH)):
                    swap = F[t, c, j]
                    F[t, c, j] = F[t, p, j]
                    F[t, p, j] = swap
            if wp.abs(F[t, c, k]) <= f64(1.0e-15) * size:
                F[t, c, k] = f64(0.0) / f64(0.0)
            for i in range(c + 1, rows):
                if F[t, i, k] != f64(0.0):
                    m = F[t, i, k] / F[t, c, k]
                    for j in range(k + 1, wp.static(WIDTH)):
                        F[t, i, j] = F[t, i, j] - m * F[t, c, j]

    @wp.func(inline=False)
    def solve(matrix: wp.array3d[wp.float64], values: wp.array3d[wp.float64], t: int, arrow: Arrow):
        last = arrow.start[arrow.count]
        size = f64(0.0)
        F = arrow.front
        for i in range(wp.static(block + border)):
            for j in range(wp.static(WIDTH)):
                F[t, i, j] = f64(0.0)
        for i in range(wp.static(border)):
            F[t, i, wp.static(T_AT) + i] = f64(1.0)
            for j in range(wp.static(border)):
                F[t, i, wp.static(block) + j] = matrix[t, last + i, last + j]
                size = wp.max(size, wp.abs(matrix[t, last + i, last + j]))
            for j in range(wp.static(sides)):
                F[t, i, wp.static(SIDE_AT) + j] = values[t, last + i, j]
        for b in range(arrow.count):
            # the border's rows, now those of T and the border alone, go below the block's
            first = arrow.start[b]
            m = arrow.start[b + 1] - first
            for i in range(wp.static(border)):
                r = wp.static(border) - 1 - i
                for j in range(wp.static(block), wp.static(WIDTH)):
                    F[t, m + r, j] = F[t, r, j]
            for i in range(m):
                for j in range(m):
                    F[t, i, j] = matrix[t, first + i, first + j]
                    size = wp.max(size, wp.abs(F[t, i, j]))
                for j in range(wp.static(border)):
                    F[t, i, wp.static(block) + j] = matrix[t, first + i, last + j]
                    F[t, i, wp.static(T_AT) + j] = f64(0.0)
                for j in range(wp.static(sides)):
                    F[t, i, wp.static(SIDE_AT) + j] = values[t, first + i, j]
            for i in range(wp.static(border)):
                for j in range(m):
                    total = f64(0.0)
                    for k in range(wp.static(border)):
                        total += F[t, m + i, wp.static(T_AT) + k] * matrix[t, last + k, first + j]
                    F[t, m + i, j] = total
            eliminate(F, t, 0, m, m + wp.static(border), size)
            for i in range(m):
                for j in range(wp.static(WIDTH)):
                    arrow.pivots[t, b, i, j] = F[t, i, j]
            for i in range(wp.static(border)):
                for j in range(wp.static(block), wp.static(WIDTH)):
                    F[t, i, j] = F[t, m + i, j]
        eliminate(F, t, wp.static(block), wp.static(border), wp.static(border), size)
        for i in range(wp.static(border)):
            r = wp.static(border) - 1 - i
            for j in range(wp.static(sides)):
                total = F[t, r, wp.static(SIDE_AT) + j]
                for k in range(r + 1, wp.static(border)):
                    total -= F[t, r, wp.static(block) + k] * values[t, last + k, j]
                values[t, last + r, j] = total / F[t, r, wp.static(block) + r]
        rest = Rest()  # what the blocks already solved contribute to the border's rows
        for i in range(arrow.count):
            b = arrow.count - 1 - i
            first = arrow.start[b]
            m = arrow.start[b + 1] - first
            for c in range(m):
                r = m - 1 - c
                for j in range(wp.static(sides)):
                    total = arrow.pivots[t, b, r, wp.static(SIDE_AT) + j]
                    for k in range(r + 1, m):
                        total -= arrow.pivots[t, b, r, k] * values[t, first + k, j]
                    for k in range(wp.static(border)):
                        total -= arrow.pivots[t, b, r, wp.static(block) + k] * values[t, last + k, j]
                        total -= arrow.pivots[t, b, r, wp.static(T_AT) + k] * rest[k, j]
                    values[t, first + r, j] = total / arrow.pivots[t, b, r, r]
            for k in range(wp.static(border)):
                for j in range(wp.static(sides)):
                    total = f64(0.0)
                    for c in range(m):
                        total += matrix[t, last + k, first + c] * values[t, first + c, j]
                    rest[k, j] = rest[k, j] + total

    @wp.func(inline=False)
    def multiply(
        matrix: wp.array3d[wp.float64], values: wp.array3d[wp.float64], t: int, row: int, side: int, arrow: Arrow
    ) -> f64:
        """One number of the product of the matrix with solutions."""
        last = arrow.start[arrow.count]
        total = f64(0.0)
        if row >= last:
            for k in range(arrow.start[arrow.count + 1]):
                total += matrix[t, row, k] * values[t, k, side]
            return total
        b = int(0)
        while arrow.start[b + 1] <= row:
            b += 1
        for k in range(arrow.start[b], arrow.start[b + 1]):
            total += matrix[t, row, k] * values[t, k, side]
        for k in range(wp.static(border)):
            total += matrix[t, row, last + k] * values[t, last + k, side]
        return total

    return SimpleNamespace(solve=solve, multiply=multiply)
