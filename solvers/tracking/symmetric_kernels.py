# mypy: ignore-errors
"""Symmetric matrices of any size inside a kernel, one a thread: the first axis is the instance."""

import warp as wp

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
    """Eigenvectors, as columns, and eigenvalues of a symmetric matrix, which is used up, by Jacobi's rotations."""
    n = matrix.shape[1]
    size = f64(0.0)
    for i in range(n):
        for j in range(n):
            modes[t, i, j] = f64(0.0)
            size = wp.max(size, wp.abs(matrix[t, i, j]))
        modes[t, i, i] = f64(1.0)
    sweep = int(0)
    off = size
    while sweep < 30 and off > f64(1.0e-17) * size:
        sweep += 1
        off = f64(0.0)
        for p in range(n):
            for q in range(p + 1, n):
                a = matrix[t, p, q]
                off = wp.max(off, wp.abs(a))
                if wp.abs(a) > f64(1.0e-18) * size:
                    h = (matrix[t, q, q] - matrix[t, p, p]) / (f64(2.0) * a)
                    r = f64(1.0) / (wp.abs(h) + wp.sqrt(h * h + f64(1.0)))
                    if h < f64(0.0):
                        r = -r
                    c = f64(1.0) / wp.sqrt(r * r + f64(1.0))
                    s = r * c
                    for k in range(n):
                        x = matrix[t, k, p]
                        y = matrix[t, k, q]
                        matrix[t, k, p] = c * x - s * y
                        matrix[t, k, q] = s * x + c * y
                    for k in range(n):
                        x = matrix[t, p, k]
                        y = matrix[t, q, k]
                        matrix[t, p, k] = c * x - s * y
                        matrix[t, q, k] = s * x + c * y
                    for k in range(n):
                        x = modes[t, k, p]
                        y = modes[t, k, q]
                        modes[t, k, p] = c * x - s * y
                        modes[t, k, q] = s * x + c * y
    for i in range(n):
        values[t, i] = matrix[t, i, i]
