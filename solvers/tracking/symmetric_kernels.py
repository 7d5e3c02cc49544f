# mypy: ignore-errors
"""Symmetric matrices of any size inside a kernel, one a thread: the first axis is the instance.

Of more than ``FEW`` rows they are made tridiagonal by Householder's reflections. The least eigenvalue is then found by bisection:
of the pivots of ``T - x I`` as many are negative as eigenvalues are below ``x`` (Sturm), however near they are to each other. All
of them, with their modes, are found by the implicit QL iteration. Jacobi's rotations, by which few rows are diagonalised, take
longer. Eigenvalues are right to rounding times the largest one.
"""

import warp as wp

from multirod.kernels.linear_algebra_kernels import ONE_BY_ONE, jacobi

f64 = wp.float64
FEW = 8  # rows whose modes are found by rotations
ROOM = 3  # rows of numbers that ``values`` has for each row of a matrix


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


@wp.func_native(
    """
    const int n = matrix.shape[1];
    double* d = &wp::index(values, t, 0);
    double* e = d + n;
    double* p = e + n;
    for (int k = 0; k < n; ++k) {
        double* __restrict v = &wp::index(matrix, t, k, 0);
        d[k] = v[k];
        e[k] = k + 1 < n ? v[k + 1] : 0.0;
        if (k + 2 >= n) continue;
        double largest = 0.0, rest = 0.0, square = 0.0;
        for (int j = k + 1; j < n; ++j) largest = fabs(v[j]) > largest ? fabs(v[j]) : largest;
        for (int j = k + 2; j < n; ++j) rest += fabs(v[j]);
        v[k] = 0.0;  // of the reflection I - v v^T, which leaves all but the first number of the row zero
        if (rest == 0.0) {
            for (int j = k + 1; j < n; ++j) v[j] = 0.0;
            continue;
        }
        for (int j = k + 1; j < n; ++j) { v[j] /= largest; square += v[j] * v[j]; }
        const double size = v[k + 1] < 0.0 ? -sqrt(square) : sqrt(square);
        e[k] = -size * largest;
        v[k + 1] += size;
        const double unit = 1.0 / sqrt(size * v[k + 1]);
        for (int j = k + 1; j < n; ++j) { v[j] *= unit; p[j] = 0.0; }
        for (int i = k + 1; i < n; ++i) {
            const double* __restrict row = &wp::index(matrix, t, i, 0);
            const double m = v[i];
            ONE_BY_ONE
            for (int j = k + 1; j < n; ++j) p[j] += m * row[j];
        }
        double along = 0.0;
        for (int j = k + 1; j < n; ++j) along += v[j] * p[j];
        for (int j = k + 1; j < n; ++j) p[j] -= 0.5 * along * v[j];
        for (int i = k + 1; i < n; ++i) {
            double* __restrict row = &wp::index(matrix, t, i, 0);
            const double m = v[i], w = p[i];
            ONE_BY_ONE
            for (int j = k + 1; j < n; ++j) row[j] -= m * p[j] + w * v[j];
        }
    }
    """.replace("ONE_BY_ONE", ONE_BY_ONE)
)
def make_tridiagonal(matrix: wp.array3d[wp.float64], values: wp.array2d[wp.float64], t: int):
    """A symmetric matrix to its tridiagonal form: diagonal and what stands beside it come first in ``values``, vectors ``v`` of
    the reflections ``I - v v^T`` in the rows of the matrix."""


@wp.func_native(
    """
    const int n = values.shape[1] / ROOM;
    const double* d = &wp::index(values, t, 0);
    const double* e = d + n;
    double size = 0.0, total = 0.0, low = d[0], high = d[0];
    for (int i = 0; i < n; ++i) {
        const double beside = (i > 0 ? fabs(e[i - 1]) : 0.0) + (i + 1 < n ? fabs(e[i]) : 0.0);
        low = d[i] - beside < low ? d[i] - beside : low;
        high = d[i] < high ? d[i] : high;
        size = fabs(d[i]) + beside > size ? fabs(d[i]) + beside : size;
        total += fabs(d[i]) + beside;
    }
    if (total - total != 0.0) return total - total;
    const double tiny = 1e-16 * size;
    low -= tiny;
    high += tiny;
    while (high - low > tiny + 1e-16 * (fabs(low) + fabs(high))) {
        const double x = 0.5 * (low + high);
        if (x <= low || x >= high) break;
        bool below = false;
        double q = 1.0, square = 0.0;
        for (int i = 0; i < n && !below; ++i) {
            q = d[i] - x - square / q;
            below = q < 0.0;
            q = q == 0.0 ? 1e-300 + 1e-32 * size : q;
            square = e[i] * e[i];
        }
        if (below) high = x; else low = x;
    }
    return 0.5 * (low + high);
    """.replace("ROOM", str(ROOM))
)
def least_of_tridiagonal(values: wp.array2d[wp.float64], t: int) -> wp.float64:
    """The least eigenvalue of what ``make_tridiagonal`` left: below x where a pivot is negative. NaN of what is not finite."""


@wp.func_native(
    """
    const int n = matrix.shape[1];
    double* d = &wp::index(values, t, 0);
    double* e = d + n;
    double* p = e + n;
    for (int i = 0; i < n; ++i)
        for (int j = 0; j < n; ++j) wp::index(modes, t, i, j) = i == j ? 1.0 : 0.0;
    for (int k = n - 3; k >= 0; --k) {  // the product of the reflections, the last first
        const double* __restrict v = &wp::index(matrix, t, k, 0);
        for (int j = k + 1; j < n; ++j) p[j] = 0.0;
        for (int i = k + 1; i < n; ++i) {
            const double* __restrict row = &wp::index(modes, t, i, 0);
            const double m = v[i];
            ONE_BY_ONE
            for (int j = k + 1; j < n; ++j) p[j] += m * row[j];
        }
        for (int i = k + 1; i < n; ++i) {
            double* __restrict row = &wp::index(modes, t, i, 0);
            const double m = v[i];
            ONE_BY_ONE
            for (int j = k + 1; j < n; ++j) row[j] -= m * p[j];
        }
    }
    for (int i = 0; i < n; ++i)  // modes as rows, which rotations then turn
        for (int j = 0; j < i; ++j) {
            const double s = wp::index(modes, t, i, j);
            wp::index(modes, t, i, j) = wp::index(modes, t, j, i);
            wp::index(modes, t, j, i) = s;
        }
    for (int l = 0; l < n; ++l)
        for (int round = 0; round < 60; ++round) {
            int m = l;
            for (; m < n - 1; ++m)
                if (fabs(e[m]) <= 1.1e-16 * (fabs(d[m]) + fabs(d[m + 1]))) break;
            if (m == l) break;
            double g = (d[l + 1] - d[l]) / (2.0 * e[l]);
            double r = sqrt(g * g + 1.0);
            g = d[m] - d[l] + e[l] / (g + (g < 0.0 ? -r : r));
            double s = 1.0, c = 1.0, shift = 0.0;
            int i = m - 1;
            for (; i >= l; --i) {
                const double f = s * e[i], b = c * e[i];
                r = sqrt(f * f + g * g);
                e[i + 1] = r;
                if (r == 0.0) {
                    d[i + 1] -= shift;
                    e[m] = 0.0;
                    break;
                }
                s = f / r;
                c = g / r;
                g = d[i + 1] - shift;
                r = (d[i] - g) * s + 2.0 * c * b;
                shift = s * r;
                d[i + 1] = g + shift;
                g = c * r - b;
                double* __restrict x = &wp::index(modes, t, i, 0);
                double* __restrict y = &wp::index(modes, t, i + 1, 0);
                ONE_BY_ONE
                for (int k = 0; k < n; ++k) {
                    const double turned = y[k];
                    y[k] = s * x[k] + c * turned;
                    x[k] = c * x[k] - s * turned;
                }
            }
            if (r == 0.0 && i >= l) continue;
            d[l] -= shift;
            e[l] = g;
            e[m] = 0.0;
        }
    for (int i = 0; i < n; ++i) {  // as columns, the largest number of each positive
        const double* row = &wp::index(modes, t, i, 0);
        int most = 0;
        for (int j = 1; j < n; ++j) most = fabs(row[j]) > fabs(row[most]) ? j : most;
        p[i] = row[most] < 0.0 ? -1.0 : 1.0;
    }
    for (int i = 0; i < n; ++i)
        for (int j = 0; j <= i; ++j) {
            const double s = wp::index(modes, t, i, j);
            wp::index(modes, t, i, j) = p[j] * wp::index(modes, t, j, i);
            wp::index(modes, t, j, i) = p[i] * s;
        }
    """.replace("ONE_BY_ONE", ONE_BY_ONE)
)
def modes_of_tridiagonal(matrix: wp.array3d[wp.float64], modes: wp.array3d[wp.float64], values: wp.array2d[wp.float64], t: int):
    """Eigenvectors, as columns, and eigenvalues of a matrix that ``make_tridiagonal`` has been through."""


@wp.func(inline=False)
def diagonalise(matrix: wp.array3d[wp.float64], modes: wp.array3d[wp.float64], values: wp.array2d[wp.float64], t: int):
    """Eigenvectors, as columns, and eigenvalues of a symmetric matrix (n, n), which is used up: the first ``n`` of ``ROOM * n``
    numbers ``values``, in no order. Of more than ``FEW`` rows the largest number of each vector is positive."""
    n = matrix.shape[1]
    if n > wp.static(FEW):
        make_tridiagonal(matrix, values, t)
        modes_of_tridiagonal(matrix, modes, values, t)
        return
    jacobi(matrix, modes, t, n)
    for i in range(n):
        values[t, i] = matrix[t, i, i]


@wp.func(inline=False)
def least_eigenvalue(matrix: wp.array3d[wp.float64], values: wp.array2d[wp.float64], t: int) -> f64:
    """Of a symmetric matrix (n, n), which is used up, as are ``ROOM * n`` numbers ``values``."""
    make_tridiagonal(matrix, values, t)
    return least_of_tridiagonal(values, t)
