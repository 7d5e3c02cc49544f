"""The linear equations of multiple shooting: a banded matrix, almost block diagonal, of one instance.

Numbers in parentheses are those of ``docs/solvers.md``.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from multirod.assembly import Assembly
from multirod.problem import BoundaryProblem
from multirod.segments import Breakpoints, Cuts, Propagation, Segments
from multirod.validation import FloatArray


class System:
    """The Jacobian (2) of all segments of one instance: unknowns at the base, then the variation at every further breakpoint.

    Factored by Gaussian elimination with partial pivoting in the band, which is stable where the boundary conditions are
    separated and the problem itself is well conditioned (Ascher, Mattheij, Russell, section 7.2).
    """

    def __init__(self, found: Propagation, places: NDArray[np.intp]) -> None:
        self.n, self.d = n, d = len(places), found.transition.shape[1]
        self.segments = len(found.transition)
        self.size = n + d * (self.segments - 1)
        # at the base only the unknowns vary
        self.first = found.transition[0][:, places] if self.segments > 1 else np.zeros((0, n))
        self.blocks = found.transition[1:-1, :, :d]
        tip = found.residual_columns[0]
        self.last = tip[:, :d] if self.segments > 1 else tip[:, places]
        self._factored: tuple[Any, ...] | None = None

    @property
    def below(self) -> int:
        """Diagonals of the band below the main one."""
        return 2 * self.d - 1 - self.n if self.segments > 1 else self.n - 1

    @property
    def above(self) -> int:
        """Diagonals above it."""
        return self.n + self.d - 1 if self.segments > 1 else self.n - 1

    def _entries(self) -> list[tuple[NDArray[np.intp], NDArray[np.intp], FloatArray]]:
        """All that is not zero: rows, columns and values, which broadcast to one shape."""
        n, d, count = self.n, self.d, self.segments
        i, j = np.arange(d)[:, None], np.arange(d)
        if count == 1:
            return [(np.arange(n)[:, None], np.arange(n), self.last)]
        k = d * np.arange(count - 2)[:, None, None]
        inner = np.arange(d * (count - 1))
        return [
            (i, np.arange(n), self.first),
            (d + k + i, n + k + j, self.blocks),
            (inner, n + inner, np.array(-1.0)),
            (d * (count - 1) + np.arange(n)[:, None], n + d * (count - 2) + j, self.last),
        ]

    def banded(self) -> FloatArray:
        """The matrix as LAPACK keeps bands, with room for the fill."""
        low, up = self.below, self.above
        result = np.zeros((2 * low + up + 1, self.size), order="F")
        for rows, columns, values in self._entries():
            result[low + up + rows - columns, columns] = values
        return result

    def dense(self) -> FloatArray:
        """The whole matrix."""
        result = np.zeros((self.size, self.size))
        for rows, columns, values in self._entries():
            result[rows, columns] = values
        return result

    @property
    def singular(self) -> bool:
        """Whether elimination meets a pivot that is zero, or numbers that are not finite."""
        return bool(self._factors()[2] != 0 or not np.isfinite(self._factors()[0]).all())

    def _factors(self) -> tuple[Any, ...]:
        if self._factored is None:
            from scipy.linalg import lapack

            self._factored = lapack.dgbtrf(self.banded(), self.below, self.above)
        return self._factored

    def solve(self, right: FloatArray) -> FloatArray:
        """``J^-1`` times one or several columns (size, ...)."""
        from scipy.linalg import lapack

        lu, pivots, _ = self._factors()
        shaped = right.reshape(self.size, -1)
        return np.asarray(lapack.dgbtrs(lu, self.below, self.above, shaped, pivots)[0]).reshape(right.shape)


def pose_jacobian(segments: Segments, instance: int, points: Breakpoints) -> FloatArray:
    """Derivative of the end effector's pose by the problem's directions, at equilibrium, shape (6, direction_count); NaN at a
    fold."""
    cuts = Cuts.of_points({instance: points})
    found = segments.propagate(cuts, np.ones(1))
    d, places = segments.variation_size, segments.unknown_places
    system = System(found, places)
    slopes = np.concatenate([*found.transition[:-1, :, d:], found.residual_columns[0, :, d:]])
    if system.singular:
        return np.full((6, slopes.shape[1]), np.nan)
    rates = system.solve(-slopes)
    variations = np.zeros((len(found.transition), d, slopes.shape[1]))
    variations[0, places] = rates[: system.n]
    variations[1:] = rates[system.n :].reshape(-1, d, slopes.shape[1])
    return segments.tip_pose_columns(cuts, found, variations)


def pose_jacobians(problem: BoundaryProblem, assembly: Assembly, names: Sequence[str] | None) -> dict[int, FloatArray]:
    """The same of each instance that is known by its states, by its number; NaN where these do not tell it: of what has no
    ``names`` or one of a parameter, and of a graph, which has no segments to say how what acts on it acts on single rods."""
    if not problem.breakpoints:  # as mostly: segments take longer to make than a small integration
        return {}
    told = names is not None and not any(name in assembly.parameters for name in names)
    segments = problem.segments if told else None
    points = problem.breakpoints.items()
    return {k: np.array(np.nan) if segments is None else pose_jacobian(segments, k, own) for k, own in points}
