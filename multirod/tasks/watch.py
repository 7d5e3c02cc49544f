"""Whether samples of a controller or an estimator are stable: looked at where a mode may have been lost since the last look."""

from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from multirod.batch import IntArray
from multirod.kernels.shared import Shared
from multirod.stability import Stability, modes_of
from multirod.tasks.formulation import Task
from multirod.tasks.watch_kernels import SURE, UNTOLD, Watched
from multirod.validation import FloatArray

MOST_OFF = 0.95  # (17b) left side of (17) that growth is told by: beyond, ``Gamma`` may as well have grown
BALANCING = 6  # passes of scales, after which they stay as they are to some per cent


class Watch:
    """Keeps ``Gamma`` of the last sample of each instance that is known to be stable ((17) of ``docs/tasks.md``).

    Args:
        task: Whose samples are watched.
        unit: (9), shape (k,).

    Attributes:
        state: The argument of kernels.
    """

    def __init__(self, task: Task, unit: FloatArray) -> None:
        self._task, self._unit, self._problem = task, unit, task.problem
        problem = task.problem
        problem.expect_judging()
        count, n = problem.instance_count, problem.unknown_count
        self.state: Any = Watched()
        self.state.on = int(problem.stability is not None)
        sizes = {"anchor": (n, n), "inverse": (n, n), "scale": (n,), "room": (1, n), "path": (5,)}
        sizes |= dict.fromkeys(("anchored", "place"), (n + task.count,))
        self._shared = {name: Shared((count, *size), wp.float64, problem.device) for name, size in sizes.items()}
        for name, each in self._shared.items():
            setattr(self.state, name, each.array)
        self._shared["inverse"].write(np.nan)
        self._scaled = np.zeros(count, dtype=bool)

    def gamma(self) -> FloatArray:
        """Of the last integration, shape (b, n, n)."""
        n = self._problem.unknown_count
        return np.asarray(self._problem.read("gamma").reshape(-1, n, n))

    def near(self, rows: IntArray, gamma: FloatArray) -> NDArray[np.bool_]:
        """(17) Which of some instances cannot have lost a mode at ``gamma`` (k, n, n), shape (k,)."""
        anchor, inverse, scale = (self._shared[name].values[rows] for name in ("anchor", "inverse", "scale"))
        path = self._shared["path"]
        path.fetch()
        with np.errstate(invalid="ignore", over="ignore"):
            off = inverse.swapaxes(1, 2) @ (gamma - anchor) * scale[:, None]
            path.values[rows, 2] = np.sqrt((off * off).sum(axis=(1, 2)))
        path.values[rows, 1] = path.values[rows, 0]
        path.send()
        self._stand(rows)
        return np.asarray(path.values[rows, 2] < SURE)

    def begin(self, rows: IntArray, gamma: FloatArray) -> None:
        """Some instances stand at a place that is stable, as far as can be said, with ``gamma`` (k, n, n)."""
        path = self._shared["path"]
        path.fetch()
        path.values[rows] = 0.0
        path.values[rows, 3] = UNTOLD
        path.send()
        self._stand(rows)
        self.keep(rows, gamma)

    def _stand(self, rows: IntArray) -> None:
        """Some instances are where the problem is."""
        place = self._shared["place"]
        place.fetch()
        unknowns = self._problem.read("unknowns") / self._problem.curvature_scale()[:, None]
        place.values[rows] = np.concatenate([unknowns, self._task.values() / self._unit], axis=1)[rows]
        place.send()

    def keep(self, rows: IntArray, gamma: FloatArray) -> None:
        """Some instances are stable at ``gamma`` (k, n, n), that of the last comparison, as far as can be said; one that is
        singular is no place to go by."""
        anchor, inverse, scale, path = (self._shared[name] for name in ("anchor", "inverse", "scale", "path"))
        anchored, place = self._shared["anchored"], self._shared["place"]
        path.fetch()
        place.fetch()
        anchored.values[rows] = place.values[rows]
        gone, compared, off, growth, _ = path.values[rows].T
        # (17b): nearer to where it is singular, the same change is more of what is left
        left = 1 - np.fmin(off, MOST_OFF)
        path.values[rows] = 0.0
        path.values[rows, 0], path.values[rows, 3] = np.fmax(gone - compared, 0.0), growth / left
        for row, own in zip(rows.tolist(), gamma, strict=True):
            anchor.values[row], inverse.values[row] = own, np.nan
            if not np.isfinite(own).all():
                continue
            try:
                back = np.linalg.inv(own)
            except np.linalg.LinAlgError:
                continue
            if not self._scaled[row]:
                scale.values[row], self._scaled[row] = _balance(np.abs(back) @ np.abs(own)), True
            inverse.values[row] = back.T / scale.values[row]
        for each in (anchor, inverse, scale, path, anchored):
            each.send()

    def compare(self) -> None:
        """The next sample, however short its way: something else has changed."""
        path = self._shared["path"]
        path.fetch()
        path.values[:, 1] = -np.inf
        path.send()

    def back(self) -> None:
        """The last sample is taken back: the next starts from the command before it."""
        path = self._shared["path"]
        path.fetch()
        path.values[:, 0], path.values[:, 1] = path.values[:, 4], -np.inf
        path.send()

    def unstable(self, rows: IntArray) -> NDArray[np.bool_]:
        """Which of some instances are not stable at the problem's unknowns, as far as that can be said, shape (k,)."""
        problem = self._problem
        if problem.stability is None:
            return np.zeros(len(rows), dtype=bool)
        whole = len(rows) == problem.instance_count
        if whole and problem.stability.surely_stable():
            return np.zeros(len(rows), dtype=bool)
        part = None if whole else problem.parts
        modes = modes_of(problem) if part is None else modes_of(part.of(rows))
        stability = modes.stability if whole or part is not None else modes.take(rows).stability
        return np.asarray(np.isin(stability, (Stability.UNSTABLE, Stability.FOLD)))


def _balance(matrix: FloatArray) -> FloatArray:
    """Scales ``S``, shape (n,), by which rows and columns of ``S^-1 A S`` are of like size."""
    scale = np.ones(len(matrix))
    for _ in range(BALANCING):
        scaled = matrix * scale / scale[:, None]
        scale *= np.sqrt(np.linalg.norm(scaled, axis=1) / np.linalg.norm(scaled, axis=0))
    return scale
