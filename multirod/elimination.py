"""Matrices that are mostly zeros, eliminated: what a problem offers of a large ``Gamma``."""

from typing import TYPE_CHECKING, Any, Literal, Protocol, cast

import numpy as np
from numpy.typing import NDArray

from multirod.validation import FloatArray

if TYPE_CHECKING:
    from scipy.sparse import csc_matrix

KEPT = 3  # matrices whose factors are kept: the present one, and those that it is compared with
LANCZOS = 150  # rows from which the least singular value is found by iteration
LANCZOS_TOLERANCE = 1e-4  # relative, of that value


class Factors(Protocol):
    """What solves with a matrix."""

    def solve(self, rhs: FloatArray, trans: Literal["N", "T", "H"] = "N") -> FloatArray:
        """The solutions for sides (n,) or (n, m), with the matrix or its transpose."""


class Elimination:
    """Elimination of matrices (n, n) of one pattern, each given by its numbers that may differ from zero, (k,).

    Columns are ordered so that few numbers come to differ from zero, and pivots are chosen among all rows of a column: of rods
    and bodies in a chain or a tree each rod is condensed to its ends and each body follows, in a time that grows with their
    number (``docs/networks.md``).

    Args:
        places: Of the numbers in the matrix, row by row, some of them perhaps more than once.
        size: ``n``.

    Attributes:
        places: The same in the order of the numbers, each once.
        rows: Of each number.
        columns: Likewise, rising.
    """

    def __init__(self, places: NDArray[np.intp], size: int) -> None:
        rows, columns = np.divmod(np.unique(places), size)
        order = np.lexsort((rows, columns))
        self.rows, self.columns, self.size = rows[order], columns[order], size
        self.places: NDArray[np.intp] = self.rows * size + self.columns
        self._by_place = np.argsort(self.places)
        self._starts = np.searchsorted(self.columns, np.arange(size + 1)).astype(np.int32)
        self._rows = self.rows.astype(np.int32)
        self._kept: list[tuple[FloatArray, Factors | None]] = []

    def __getstate__(self) -> dict[str, Any]:
        """Without the factors, which SciPy can neither copy nor pickle, and which are found again."""
        return self.__dict__ | {"_kept": []}

    @property
    def count(self) -> int:
        """Numbers that may differ from zero."""
        return len(self.places)

    def index(self, places: NDArray[np.intp]) -> NDArray[np.intp]:
        """Which of the numbers stand at places in the matrix, row by row; all are among ``places``."""
        found = np.searchsorted(self.places, places, sorter=self._by_place)
        return np.asarray(self._by_place[found])

    def matrix(self, numbers: FloatArray) -> "csc_matrix[np.float64]":
        """That of SciPy's in columns."""
        from scipy.sparse import csc_matrix

        return csc_matrix((numbers, self._rows, self._starts), shape=(self.size, self.size))

    def dense(self, numbers: FloatArray) -> FloatArray:
        """Matrices (..., n, n) of numbers (..., k)."""
        result = np.zeros((*numbers.shape[:-1], self.size * self.size))
        result[..., self.places] = numbers
        return result.reshape(*numbers.shape[:-1], self.size, self.size)

    def factors(self, numbers: FloatArray) -> "Factors | None":
        """What solves with the matrix: ``solve(sides)``, or ``solve(sides, "T")`` with its transpose; None if it is singular."""
        for known, kept in self._kept:
            if np.array_equal(known, numbers):
                return kept
        from scipy.sparse.linalg import splu

        try:
            factors = cast(Factors, splu(self.matrix(numbers))) if np.isfinite(numbers).all() else None
        except RuntimeError:  # a pivot is zero
            factors = None
        self._kept = [(np.array(numbers), factors), *self._kept[: KEPT - 1]]
        return factors

    def solved(self, numbers: FloatArray, sides: FloatArray) -> FloatArray:
        """The solutions for sides (n,) or (n, m); NaN where the matrix is singular."""
        factors = self.factors(numbers)
        return np.full(sides.shape, np.nan) if factors is None else np.asarray(factors.solve(sides))

    def least_singular_value(self, numbers: FloatArray) -> float:
        """Of the matrix; zero where it is singular."""
        if self.size < LANCZOS:
            return float(np.linalg.svd(self.dense(numbers), compute_uv=False)[-1])
        factors = self.factors(numbers)
        if factors is None:
            return 0.0
        from scipy.sparse.linalg import LinearOperator, eigsh

        square = LinearOperator((self.size, self.size), matvec=lambda x: factors.solve(factors.solve(x, "T")), dtype=np.float64)
        start = np.random.default_rng(0).standard_normal(self.size)
        largest = eigsh(square, k=1, which="LA", v0=start, tol=LANCZOS_TOLERANCE, return_eigenvectors=False)
        return float(1 / np.sqrt(largest[-1]))
