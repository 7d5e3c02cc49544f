"""Estimates that explain little, or came to no end, are looked for elsewhere. Numbers in parentheses: ``docs/estimation.md``."""

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from multirod.status import Status, failures
from multirod.tasks.estimating.inference import consistent
from multirod.validation import FloatArray

if TYPE_CHECKING:
    from multirod.tasks.estimating.iteration import Part

APART = 1e-3  # of the curvatures that arise, by which two equilibria are two
AXES = 3  # along which priors are gone through, to both sides
SURE = 2  # beginnings that lead to the same end, after which it is believed
INSIDE = 0.999  # of the way to a limit
ENDS = ("x", "p", "square", "covariance")


class Elsewhere:
    """(24), (25) Goes on, from other equilibria, with those instances of a part that explain little or have no result: steps may
    have led along another branch than the one that the robot is on. The most probable end stays.

    Args:
        part: Whose steps have come to their ends.
    """

    def __init__(self, part: "Part") -> None:
        self._part = part
        self._left = np.zeros(part.count, dtype=bool)  # whether the problem was integrated elsewhere than at the end that stays
        self._same = np.zeros(part.count, dtype=np.intp)  # how often it was found again

    def run(self) -> None:
        """Begin where the robot comes to rest under what was found, (24), then about the priors' means, (25), as long as there is
        reason to."""
        part = self._part
        rows = np.flatnonzero(self._doubtful() & np.isfinite(part.square))
        self._seek(rows, part.p[rows], APART)
        rows = np.flatnonzero(self._doubtful())
        if len(rows):
            ways = self._ways(rows)
            for turn in range(2 * ways.shape[2]):
                going = self._doubtful()[rows] & (self._same[rows] < SURE) & ways[:, :, turn // 2].any(axis=1)
                own, away = rows[going], (1.0, -1.0)[turn % 2] * ways[going, :, turn // 2]
                self._seek(own, part.bounds.before(part.mean[own], away, INSIDE))
        left = self._left & (part.outcome.status == Status.CONVERGED)
        if left.any():
            part.task.evaluate(part.x, part.p, left)
            part.outcome.integrations[left] += 1

    def _doubtful(self) -> NDArray[np.bool_]:
        """Which have no result, or one that is not likely, (18), shape (b,)."""
        part = self._part
        status = part.outcome.status
        unlikely = (status == Status.CONVERGED) & ~consistent(part.square, part.degrees)
        return np.asarray(unlikely | (failures(status) & (status != Status.UNOBSERVABLE)))

    def _seek(self, rows: NDArray[np.intp], p: FloatArray, apart: float = 0.0) -> None:
        """Seek an end from where the robot comes to rest at inputs ``p`` (len(rows), k), if that is ``apart`` from the end
        before; the more probable one stays."""
        part = self._part
        before = {name: np.array(getattr(part, name)) for name in ENDS}
        status = part.outcome.status
        was, found = status.copy(), status == Status.CONVERGED
        put = part.put_at_rest(rows, p, apart)
        if not put.any():
            return
        part.begin_again(put)
        part.judge(put)
        now = put & (status == Status.CONVERGED)
        with np.errstate(invalid="ignore"):
            scale = part.task.problem.curvature_scale()
            self._same += now & found & (np.abs(part.x - before["x"]).max(axis=1, initial=0.0) < APART * scale)
        kept = put & ~(now & (~found | (part.square < before["square"])))
        for name, values in before.items():
            getattr(part, name)[kept] = values[kept]
        status[kept] = was[kept]
        self._left[put] = kept[put]

    def _ways(self, rows: NDArray[np.intp]) -> FloatArray:
        """(25) From the priors' means, along which what is expected of the shape spreads most; shape (len(rows), k, axes)."""
        part = self._part
        chosen = np.zeros(part.count, dtype=bool)
        chosen[rows] = True
        x, p = np.nan_to_num(part.first), part.mean
        found = part.task.evaluate(x, p, chosen)
        part.outcome.integrations[rows] += 1
        self._left[rows] = True
        by = np.nan_to_num(found.eliminated[1])
        flat = np.isinf(np.diagonal(part.prior[rows], axis1=1, axis2=2))
        fixed = flat[:, :, None] | flat[:, None, :]
        root = np.where(fixed, 0.0, np.linalg.cholesky(np.where(fixed, np.eye(flat.shape[1]), part.prior[rows])))
        axes = np.swapaxes(np.linalg.svd(by @ root, full_matrices=True)[2], 1, 2)[:, :, :AXES]
        far = np.sqrt((~flat).sum(axis=1))
        return np.asarray(far[:, None, None] * (root @ axes))
