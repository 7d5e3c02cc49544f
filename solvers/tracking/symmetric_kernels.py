# mypy: ignore-errors
"""Symmetric matrices of any size inside a kernel, one a thread: the first axis is the instance."""

import warp as wp

from multirod.kernels.linear_algebra_kernels import jacobi

f64 = wp.float64


@wp.func(inline=False)
def is_definite(form: wp.array3d[wp.float64], room: wp.array3d[wp.float64], t: int, enough: f64) -> bool:
    """Whether all eigenvalues of the symmetric part are more than ``enough``: by Cholesky's factors, made in ``room``."""
    n = form.shape[1]
    found = bool(True)
    for j in range(n):
        if found:
            d = form[t, j, j] - enough
            for k in range(j):
                d -= room[t, j, k] * room[t, j, k]
            if d > f64(0.0):
                d = wp.sqrt(d)
                room[t, j, j] = d
                for i in range(j + 1, n):
                    total = f64(0.5) * (form[t, i, j] + form[t, j, i])
                    for k in range(j):
                        total -= room[t, i, k] * room[t, j, k]
                    room[t, i, j] = total / d
            else:
                found = False
    return found


@wp.func(inline=False)
def diagonalise(matrix: wp.array3d[wp.float64], modes: wp.array3d[wp.float64], values: wp.array2d[wp.float64], t: int):
    """Eigenvectors, as columns, and eigenvalues of a symmetric matrix, which is used up."""
    n = matrix.shape[1]
    jacobi(matrix, modes, t, n)
    for i in range(n):
        values[t, i] = matrix[t, i, i]
