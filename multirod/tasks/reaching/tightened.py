"""Targets of lines that were slack where a search began: by their tensions. Numbers in parentheses: ``docs/tasks.md``."""

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import lsq_linear

from multirod.batch import IntArray
from multirod.tasks.formulation import Evaluation
from multirod.tasks.reaching.drive_kernels import BEND
from multirod.tasks.reaching.goals import Place
from multirod.tasks.reaching.search import REACHED, Search
from multirod.tasks.rows import PoseRows
from multirod.validation import FloatArray

STEPS = 30
TAUT = 1e-9  # of the scale of curvatures: the least tension of a line that is held by its length, so that it counts as that
HAIR = 1e-6  # in units (9), by which lines that pull at nothing are let out, so that they are slack and not at their kinks
SOFTNESS = 1e-6  # of the largest number of J, squared: steps that move the tip by less are damped
NEAR, REST = 1e-3, 1e-9  # of the scale of curvatures: steps from which on lines that hardly pull are let loose, and at its end
SLIGHT = 1e-2  # of the largest tension: what hardly pulls


class Tightening:
    """(19) Brings the tip to its target by the tensions of lines whose lengths are given, and finds these lengths.

    Args:
        search: That did not reach some targets.
    """

    def __init__(self, search: Search) -> None:
        self._search, self._task, problem = search, search.task, search.task.problem
        self.kinks, freed = problem.kinks, self._task.places.tolist()
        wanted = problem.kink_inputs.tolist()
        self.offered = 0 < len(self.kinks) == len(wanted) and set(wanted) <= set(freed)
        self._drives = np.array([freed.index(place) for place in wanted]) if self.offered else np.zeros(0, dtype=np.intp)

    def rows(self, chosen: NDArray[np.bool_]) -> IntArray:
        """Those of the chosen instances (b,) that have not reached their targets, and began with a slack line."""
        slack = (self._search.origin_unknowns[:, self.kinks] <= 0).any(axis=1)
        return np.flatnonzero(chosen & (self._search.status != REACHED) & slack)

    def of(self, row: int) -> Place | None:
        """Where the target of an instance is met, or most nearly, axes (1, ...); None if nowhere within limits."""
        search, K, q = self._search, self.kinks, self._drives
        chosen = np.zeros(len(search.status), dtype=bool)
        chosen[row] = True
        scale, goal = float(self._task.problem.curvature_scale()[row]), search.goals.rows.take(slice(row, row + 1))
        every = Place(search.origin_unknowns.copy(), search.origin.copy())
        x, p = every.x[row], every.p[row]
        loose = np.zeros(len(K), dtype=bool)  # lines that are to pull at nothing
        for _ in range(STEPS):
            x[K] = np.where(loose, TAUT * scale, np.maximum(x[K], TAUT * scale))
            found = self._task.evaluate(every.x, every.p, chosen)
            search.integrations[row] += 1
            step = None if found.failed.any() else self._step(found, goal, x[K], scale, loose)
            if step is None:
                return None
            change, lengths = step
            p[q] += lengths
            largest = np.abs(change).max()
            if largest < NEAR * scale:
                slight = (x[K] < SLIGHT * x[K].max()) & ~loose
                if largest < REST * scale and not slight.any():
                    break
                loose |= slight
            x += change / max(1.0, largest / (BEND * scale))
        p[q] = np.where(loose, p[q] - HAIR * search.goals.unit[q], p[q])
        x[K] = np.where(loose, -TAUT * scale, x[K])
        if (search.goals.limits.outside(p[None], search.goals.unit) > 0).any():
            return None
        return Place(x[None].copy(), p[None].copy())

    def _step(
        self, found: Evaluation, goal: PoseRows, z: FloatArray, scale: float, loose: NDArray[np.bool_]
    ) -> tuple[FloatArray, FloatArray] | None:
        """Change of the unknowns (n,), and of what is asked of the lines for their conditions to hold here, (line,)."""
        K, by_drives = self.kinks, found.slopes[0][:, self._drives]
        conditions = np.abs(by_drives).argmax(axis=0)
        others, rest = np.delete(np.arange(len(by_drives)), conditions), np.delete(np.arange(len(by_drives)), K)
        lengths = -found.residual[0, conditions] / by_drives[conditions, range(len(K))]
        own = found.gamma[0][np.ix_(others, rest)]
        sides = np.column_stack([found.residual[0, others], found.gamma[0][np.ix_(others, K)]])
        try:
            solved = -np.linalg.solve(own, sides)
        except np.linalg.LinAlgError:
            return None
        errors, by, _ = goal.at(found)
        r = errors[0] + by[0][:, rest] @ solved[:, 0]
        J = (by[0][:, K] + by[0][:, rest] @ solved[:, 1:]) * scale
        soft = np.sqrt(SOFTNESS) * np.abs(J).max()
        if not (np.isfinite(J).all() and np.isfinite(r).all() and soft > 0):
            return None
        matrix, side = np.concatenate([J, soft * np.eye(len(K))]), np.concatenate([-r, np.zeros(len(K))])
        d = scale * lsq_linear(matrix, side, bounds=(-z / scale - 1e-15, np.where(loose, 1e-15, np.inf))).x
        change = np.empty(len(by_drives))
        change[K], change[rest] = d, solved[:, 0] + solved[:, 1:] @ d
        return change, lengths


def tightened(search: Search, chosen: NDArray[np.bool_]) -> None:
    """Seek what the chosen instances (b,) have not reached from where the tensions of their lines lead, of those that began with
    a slack one: its length does nothing as long as it stays slack."""
    way = Tightening(search)
    if not way.offered or search.goals.of_shape is not None:  # the way there is not looked at
        return
    rows = way.rows(chosen)
    found = {row: place for row in rows.tolist() if (place := way.of(row)) is not None}
    if not found:
        return
    begun = np.array(list(found))
    search.begin(
        begun, Place(*(np.concatenate(own) for own in zip(*((place.x, place.p) for place in found.values()), strict=True)))
    )
    again = np.zeros(len(chosen), dtype=bool)
    again[begun] = True
    search.tried(again)
