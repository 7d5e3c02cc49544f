# mypy: ignore-errors
"""Unknowns eliminated from the columns of an integration, compiled. Numbers in parentheses: ``docs/derivatives.md``."""

import warp as wp

from multirod.kernels.linear_algebra_kernels import add_row, copy_row, eliminate
from multirod.kernels.own_module import own_module

f64 = wp.float64


@own_module(max_unroll=1)
def eliminate_unknowns(
    gamma: wp.array3d[wp.float64],
    slopes: wp.array3d[wp.float64],
    columns: wp.array3d[wp.float64],
    system: wp.array3d[wp.float64],
    sides: wp.array3d[wp.float64],
    left: wp.array3d[wp.float64],
    reach: wp.array[wp.float64],
):
    """(D1) and (D1d).

    Args:
        gamma: Shape (instance, n, n).
        slopes: Of the residual by numbers, (instance, n, k).
        columns: Of the pose by unknowns, then by these numbers, (instance, 6, n + k).
        system, sides: Room for the first two, and for one side more.
        left: The pose's, once the unknowns follow, (instance, 6, k).
        reach: (D1d), (instance,).
    """
    t = wp.tid()
    n = gamma.shape[1]
    count = left.shape[2]
    for i in range(n):
        copy_row(system, gamma, t, i, 0, i, 0, n)
        copy_row(sides, slopes, t, i, 0, i, 0, count)
        sides[t, i, count] = f64(1.0) + f64(0.5) * wp.cos(f64(1 + i))
    eliminate(system, sides, t)
    for i in range(6):
        copy_row(left, columns, t, i, 0, i, n, count)
        for j in range(n):
            add_row(left, sides, t, i, 0, j, 0, count, -columns[t, i, j])
    size = f64(0.0)
    most = f64(0.0)
    for i in range(n):
        most = most + wp.abs(sides[t, i, count])
        for j in range(n):
            size = wp.max(size, wp.abs(gamma[t, i, j]))
    reach[t] = size * most
