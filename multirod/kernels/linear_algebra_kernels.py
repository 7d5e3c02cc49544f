# mypy: ignore-errors
"""Dense linear algebra of small systems inside a kernel, one system a thread."""

from functools import cache
from types import SimpleNamespace

import warp as wp

f64 = wp.float64
ONE_BY_ONE = '_Pragma("clang loop interleave_count(1)") '  # vectors, not several of them at once: rows are short
ROWS = "double* __restrict a = &wp::index(matrix, t, i, 0); double* __restrict b = &wp::index(matrix, t, k, 0); "


# of rows whose numbers stand side by side: Warp's own loops find the place of each anew, and add one at a time
@wp.func_native(ROWS + ONE_BY_ONE + "for (int j = first; j < last; j++) a[j] -= m * b[j];")
def subtract_row(matrix: wp.array3d[wp.float64], t: int, i: int, k: int, first: int, last: int, m: wp.float64):
    """``m`` times row k from row i, columns ``first`` to ``last``."""


@wp.func_native(ROWS + "for (int j = first; j < last; j++) { double s = a[j]; a[j] = b[j]; b[j] = s; }")
def swap_rows(matrix: wp.array3d[wp.float64], t: int, i: int, k: int, first: int, last: int):
    """Rows i and k, columns ``first`` to ``last``."""


OTHER_ROWS = "double* __restrict a = &wp::index(matrix, t, i, at); const double* __restrict b = &wp::index(other, t, k, start); "


@wp.func_native(OTHER_ROWS + ONE_BY_ONE + "for (int j = 0; j < count; j++) a[j] += m * b[j];")
def add_row(
    matrix: wp.array3d[wp.float64],
    other: wp.array3d[wp.float64],
    t: int,
    i: int,
    at: int,
    k: int,
    start: int,
    count: int,
    m: wp.float64,
):
    """To ``count`` numbers of row i, from column ``at`` on, ``m`` times those of row k of another, from ``start`` on."""


@wp.func_native(OTHER_ROWS + "for (int j = 0; j < count; j++) a[j] = b[j];")
def copy_row(
    matrix: wp.array3d[wp.float64], other: wp.array3d[wp.float64], t: int, i: int, at: int, k: int, start: int, count: int
):
    """The same, in their place."""


@wp.func_native("double* a = &wp::index(matrix, t, i, at); for (int j = 0; j < count; j++) a[j] = value;")
def fill_row(matrix: wp.array3d[wp.float64], t: int, i: int, at: int, count: int, value: wp.float64):
    """One value in the place of ``count`` numbers."""


@wp.func_native(
    """
    const int n = matrix.shape[1];
    double total = 0.0;
    for (int i = 0; i < n; ++i) {
        const double* __restrict own = &wp::index(matrix, t, i, 0);
        double* __restrict row = &wp::index(square, t, i, 0);
        for (int j = 0; j < n; ++j) row[j] = 0.0;
        for (int k = 0; k < n; ++k) {
            const double* __restrict other = &wp::index(matrix, t, k, 0);
            const double m = own[k];
            """
    + ONE_BY_ONE
    + """
            for (int j = 0; j < n; ++j) row[j] += m * other[j];
        }
        for (int j = 0; j < n; ++j) total += row[j] * row[j];
    }
    return total;
    """
)
def squared(matrix: wp.array3d[wp.float64], square: wp.array3d[wp.float64], t: int) -> wp.float64:
    """The matrix times itself, in ``square``; the sum of the squares of its numbers."""


@wp.func(inline=False)
def eliminate(matrix: wp.array3d[wp.float64], values: wp.array3d[wp.float64], t: int) -> f64:
    """Right-hand sides (instance, n, sides) become solutions, by LU with partial pivoting in the place of the matrix
    (instance, n, n); NaN if it is singular to rounding. Returns the sign of its determinant.
    """
    n = matrix.shape[1]
    sides = values.shape[2]
    size = f64(0.0)
    sign = f64(1.0)
    for i in range(n):
        for j in range(n):
            size = wp.max(size, wp.abs(matrix[t, i, j]))
    for k in range(n):
        p = int(k)
        for i in range(k + 1, n):
            if wp.abs(matrix[t, i, k]) > wp.abs(matrix[t, p, k]):
                p = i
        if p != k:
            sign = -sign
            swap_rows(matrix, t, k, p, k, n)
            swap_rows(values, t, k, p, 0, sides)
        if wp.abs(matrix[t, k, k]) <= f64(1.0e-15) * size:
            matrix[t, k, k] = f64(0.0) / f64(0.0)
        sign = sign * wp.sign(matrix[t, k, k])
        for i in range(k + 1, n):
            m = matrix[t, i, k] / matrix[t, k, k]
            if m != f64(0.0):
                subtract_row(matrix, t, i, k, k + 1, n, m)
                subtract_row(values, t, i, k, 0, sides, m)
    for r in range(n):
        i = n - 1 - r
        for k in range(i + 1, n):
            subtract_row(values, t, i, k, 0, sides, matrix[t, i, k])
        for j in range(sides):
            values[t, i, j] = values[t, i, j] / matrix[t, i, i]
    return sign


def make_jacobi(kind, entry, put):
    """The function that finds eigenvectors and eigenvalues of symmetric matrices (n, n) by Jacobi's rotations.

    Args:
        kind: Type of a matrix in kernels; ``t`` says which of several it is.
        entry, put: Functions that read, ``entry(A, t, i, j)``, and set, ``put(A, t, i, j, value)``, a number of it.
    """

    @wp.func
    def rotate(A: kind, t: int, p: int, q: int, n: int, c: f64, s: f64):
        """Columns p and q."""
        for k in range(n):
            x = entry(A, t, k, p)
            y = entry(A, t, k, q)
            put(A, t, k, p, c * x - s * y)
            put(A, t, k, q, s * x + c * y)

    @wp.func
    def diagonalise(A: kind, V: kind, t: int, n: int):
        """Eigenvectors become columns of V; eigenvalues stand on the diagonal of A, the rest of which is used up."""
        size = f64(0.0)
        for i in range(n):
            for j in range(n):
                put(V, t, i, j, f64(0.0))
                size = wp.max(size, wp.abs(entry(A, t, i, j)))
            put(V, t, i, i, f64(1.0))
        sweep = int(0)
        off = size
        while sweep < 30 and off > f64(1.0e-17) * size:
            sweep += 1
            off = f64(0.0)
            for p in range(n):
                for q in range(p + 1, n):
                    a = entry(A, t, p, q)
                    off = wp.max(off, wp.abs(a))
                    if wp.abs(a) > f64(1.0e-18) * size:
                        h = (entry(A, t, q, q) - entry(A, t, p, p)) / (f64(2.0) * a)
                        r = f64(1.0) / (wp.abs(h) + wp.sqrt(h * h + f64(1.0)))
                        if h < f64(0.0):
                            r = -r
                        c = f64(1.0) / wp.sqrt(r * r + f64(1.0))
                        s = r * c
                        rotate(A, t, p, q, n, c, s)
                        for k in range(n):
                            x = entry(A, t, p, k)
                            y = entry(A, t, q, k)
                            put(A, t, p, k, c * x - s * y)
                            put(A, t, q, k, s * x + c * y)
                        rotate(V, t, p, q, n, c, s)

    return diagonalise


@wp.func
def entry_of_array(matrix: wp.array3d[wp.float64], t: int, i: int, j: int) -> f64:
    return matrix[t, i, j]


@wp.func
def put_in_array(matrix: wp.array3d[wp.float64], t: int, i: int, j: int, value: f64):
    matrix[t, i, j] = value


jacobi = make_jacobi(wp.array3d[wp.float64], entry_of_array, put_in_array)


@cache
def make_linear_algebra(n: int):
    """Functions on n x n matrices: ``solve`` (LU), ``cholesky``, ``eigen`` (Jacobi), and the types they take."""
    Vector = wp.types.vector(length=n, dtype=f64)
    Matrix = wp.types.matrix(shape=(n, n), dtype=f64)
    Eigen = wp.types.matrix(shape=(n + 1, n), dtype=f64)

    # in their place: Warp's own would copy the matrix
    @wp.func_native("return A.data[i][j];")
    def entry(A: wp.ref[Matrix], t: int, i: int, j: int) -> f64: ...

    @wp.func_native("A.data[i][j] = value;")
    def put(A: wp.ref[Matrix], t: int, i: int, j: int, value: f64): ...

    diagonalise = make_jacobi(wp.ref[Matrix], entry, put)

    @wp.func
    def solve(A: Matrix, b: Vector) -> Vector:
        """``A^-1 b`` by LU with partial pivoting; NaN if A is singular to rounding."""
        x = b
        size = f64(0.0)
        for i in range(n):
            for j in range(n):
                size = wp.max(size, wp.abs(A[i, j]))
        for k in range(n):
            p = int(k)
            for i in range(n):
                if i > k and wp.abs(A[i, k]) > wp.abs(A[p, k]):
                    p = i
            if p != k:
                for j in range(n):
                    swap = A[k, j]
                    A[k, j] = A[p, j]
                    A[p, j] = swap
                move = x[k]
                x[k] = x[p]
                x[p] = move
            pivot = A[k, k]
            if wp.abs(pivot) <= f64(1.0e-15) * size:
                pivot = f64(0.0) / f64(0.0)
            for i in range(n):
                if i > k:
                    m = A[i, k] / pivot
                    for j in range(n):
                        if j > k:
                            A[i, j] = A[i, j] - m * A[k, j]
                    x[i] = x[i] - m * x[k]
        for r in range(n):
            i = n - 1 - r
            total = x[i]
            for j in range(n):
                if j > i:
                    total -= A[i, j] * x[j]
            pivot = A[i, i]
            if wp.abs(pivot) <= f64(1.0e-15) * size:
                pivot = f64(0.0) / f64(0.0)
            x[i] = total / pivot
        return x

    @wp.func
    def cholesky(A: Matrix) -> Matrix:
        """Lower factor of a symmetric positive definite matrix; NaN where it is not."""
        L = Matrix()
        for j in range(n):
            d = A[j, j]
            for k in range(n):
                if k < j:
                    d -= L[j, k] * L[j, k]
            d = wp.sqrt(d)
            L[j, j] = d
            for i in range(n):
                if i > j:
                    total = A[i, j]
                    for k in range(n):
                        if k < j:
                            total -= L[i, k] * L[j, k]
                    L[i, j] = total / d
        return L

    @wp.func
    def eigen(A: Matrix) -> Eigen:
        """Eigenvectors (columns of the first n rows) and eigenvalues (last row) of a symmetric matrix, by Jacobi rotations."""
        V = Matrix()
        diagonalise(A, V, 0, n)
        result = Eigen()
        for i in range(n):
            for j in range(n):
                result[i, j] = V[i, j]
            result[n, i] = A[i, i]
        return result

    return SimpleNamespace(Vector=Vector, Matrix=Matrix, Eigen=Eigen, solve=solve, cholesky=cholesky, eigen=eigen)
