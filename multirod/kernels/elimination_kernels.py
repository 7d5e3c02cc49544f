# mypy: ignore-errors
"""Unknowns eliminated from the columns of an integration, compiled. Numbers in parentheses: ``docs/derivatives.md``."""

import warp as wp

from multirod.kernels.linear_algebra_kernels import eliminate
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
):
    """(D1)

    Args:
        gamma: Shape (instance, n, n).
        slopes: Of the residual by numbers, (instance, n, k).
        columns: Of the pose by unknowns, then by these numbers, (instance, 6, n + k).
        system, sides: Room for the first two.
        left: The pose's, once the unknowns follow, (instance, 6, k).
    """
    t = wp.tid()
    n = gamma.shape[1]
    for i in range(n):
        for j in range(n):
            system[t, i, j] = gamma[t, i, j]
        for j in range(left.shape[2]):
            sides[t, i, j] = slopes[t, i, j]
    eliminate(system, sides, t)
    for i in range(6):
        for j in range(left.shape[2]):
            left[t, i, j] = columns[t, i, n + j]
        for l in range(n):
            for j in range(left.shape[2]):
                left[t, i, j] -= columns[t, i, l] * sides[t, l, j]
