# mypy: ignore-errors
"""Linear algebra of systems of 8 unknowns at most, one system a thread: a row is a vector of the processor's.

Each number is found by the same operations in the same order as by ``linear_algebra_kernels``, whatever the processor; sums of
squares alone are added up in another one. Rows of the arrays are contiguous.
"""

import warp as wp

SMALL = 8  # unknowns
# CUDA has neither vectors of that type nor these functions
ROWS = f"""
#ifdef __CUDA_ARCH__
    struct V {{
        double c[{SMALL}];
        V() {{}}
        explicit V(double x) {{ for (int i = 0; i < {SMALL}; ++i) c[i] = x; }}
        double& operator[](int i) {{ return c[i]; }}
        V& operator+=(const V& o) {{ for (int i = 0; i < {SMALL}; ++i) c[i] += o.c[i]; return *this; }}
        V& operator-=(const V& o) {{ for (int i = 0; i < {SMALL}; ++i) c[i] -= o.c[i]; return *this; }}
        V operator*(const V& o) const {{ V r; for (int i = 0; i < {SMALL}; ++i) r.c[i] = c[i] * o.c[i]; return r; }}
        V operator*(double x) const {{ V r; for (int i = 0; i < {SMALL}; ++i) r.c[i] = c[i] * x; return r; }}
        V operator/(double x) const {{ V r; for (int i = 0; i < {SMALL}; ++i) r.c[i] = c[i] / x; return r; }}
    }};
    const auto magnitude = [](double x) {{ return ::fabs(x); }};
    const double none = ::nan("");
#else
    typedef double V __attribute__((ext_vector_type({SMALL})));
    const auto magnitude = [](double x) {{ return __builtin_fabs(x); }};
    const double none = __builtin_nan("");
#endif
    V a[{SMALL}];
"""
# LU with partial pivoting of n rows a[i]; what is done to them is done to the right-hand sides, of type Side, b[i]
ELIMINATE = """
    double size = 0.0;
    for (int i = 0; i < n; ++i)
        for (int j = 0; j < n; ++j) size = magnitude(a[i][j]) > size ? magnitude(a[i][j]) : size;
    for (int k = 0; k < n; ++k) {
        int p = k;
        for (int i = k + 1; i < n; ++i)
            if (magnitude(a[i][k]) > magnitude(a[p][k])) p = i;
        if (p != k) {
            V row = a[k]; a[k] = a[p]; a[p] = row;
            Side side = b[k]; b[k] = b[p]; b[p] = side;
        }
        if (magnitude(a[k][k]) <= 1.0e-15 * size) a[k][k] = none;
        for (int i = k + 1; i < n; ++i) {
            const double m = a[i][k] / a[k][k];
            if (m != 0.0) {
                a[i] -= a[k] * m;
                b[i] -= b[k] * m;
            }
        }
    }
    for (int i = n - 1; i >= 0; --i) {
        for (int k = i + 1; k < n; ++k) b[i] -= b[k] * a[i][k];
        b[i] = b[i] / a[i][i];
    }
"""


@wp.func_native(
    "const int n = matrix.shape[1];"
    + ROWS
    + f"""
    typedef double Side;
    Side b[{SMALL}];
    for (int i = 0; i < n; ++i) {{
        const double* row = &wp::index(matrix, t, i, 0);
        a[i] = V(0.0);
        for (int j = 0; j < n; ++j) a[i][j] = row[j];
        b[i] = -wp::index(residual, t, i);
    }}
    """
    + ELIMINATE
    + """
    double total = 0.0;
    for (int i = 0; i < n; ++i) {
        wp::index(step, t, i, 0) = b[i];
        total += b[i] * b[i];
    }
    return wp::sqrt(total);
    """
)
def small_step(
    matrix: wp.array3d[wp.float64], residual: wp.array2d[wp.float64], step: wp.array3d[wp.float64], t: int
) -> wp.float64:
    """Length of Newton's step, left in ``step`` (instance, n, 1); not finite if the matrix is singular."""


@wp.func_native(
    "const int n = matrix.shape[1];"
    + ROWS
    + f"""
    typedef V Side;
    Side b[{SMALL}];
    for (int i = 0; i < n; ++i) a[i] = b[i] = V(0.0);
    for (int j = 0; j < n; ++j) {{
        const double* row = &wp::index(divisor, t, j, 0);
        const double* other = &wp::index(matrix, t, j, 0);
        for (int i = 0; i < n; ++i) {{
            a[i][j] = row[i];
            b[i][j] = other[i];
        }}
    }}
    """
    + ELIMINATE
    + """
    for (int i = 0; i < n; ++i) {
        double* row = &wp::index(quotient, t, i, 0);
        for (int j = 0; j < n; ++j) row[j] = b[i][j];
    }
    """
)
def small_quotient(matrix: wp.array3d[wp.float64], divisor: wp.array3d[wp.float64], quotient: wp.array3d[wp.float64], t: int):
    """``matrix divisor^-1``, transposed."""


@wp.func_native(
    "const int n = matrix.shape[1];"
    + ROWS
    + f"""
    V squares = V(0.0);
    for (int i = 0; i < n; ++i) {{
        const double* row = &wp::index(matrix, t, i, 0);
        a[i] = V(0.0);
        for (int j = 0; j < n; ++j) a[i][j] = row[j];
        a[i][i] -= centre;
        squares += a[i] * a[i];
    }}
    double total = 0.0, power = 1.0;
    for (int j = 0; j < n; ++j) total += squares[j];
    double bound = wp::sqrt(total);
    while (bound > enough && power < most) {{
        V b[{SMALL}];
        squares = V(0.0);
        for (int i = 0; i < n; ++i) {{
            b[i] = V(0.0);
            for (int k = 0; k < n; ++k) b[i] += a[k] * a[i][k];
            squares += b[i] * b[i];
        }}
        for (int i = 0; i < n; ++i) a[i] = b[i];
        total = 0.0;
        for (int j = 0; j < n; ++j) total += squares[j];
        power *= 2.0;
        bound = wp::min(bound, wp::pow(total, 0.5 / power));
    }}
    return bound;
    """
)
def small_radius(matrix: wp.array3d[wp.float64], t: int, centre: wp.float64, enough: wp.float64, most: wp.float64) -> wp.float64:
    """Bound on the distance of the eigenvalues from ``centre``, by the Frobenius norm of E = matrix - centre I and its powers, up
    to ``most`` or until it is ``enough``."""
