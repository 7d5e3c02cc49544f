"""Steps of estimates that stay within what the robot can do. Numbers in parentheses: ``docs/tasks.md``."""

import numpy as np
from numpy.typing import NDArray

from multirod.tasks.estimating.inference import Posterior
from multirod.tasks.limits import LimitRows
from multirod.tasks.programme import within_limits
from multirod.validation import FloatArray

SOFTNESS = 1e-14  # of the largest number squared: bounds a step along what nothing is told of, and slows none that is told of
AT_LIMIT = 1e-8  # in units (9), what still is at a limit
LIMIT_ROUNDING = 1e-12  # likewise, what of a number is rounding where it is at its limit


class Bounds:
    """(10) What a robot cannot do, of unknown inputs.

    Args:
        rows: Its limits.
        unit: (9), shape (k,).
    """

    def __init__(self, rows: LimitRows, unit: FloatArray) -> None:
        self.rows = rows
        together = (rows.matrix != 0).sum(axis=1) > 1  # what is of one number is kept without rounding
        self._low, self._high = (
            np.where(together, inset, own) for inset, own in zip(rows.inset(unit), (rows.low, rows.high), strict=True)
        )
        self._near, self.unit = AT_LIMIT * (np.abs(rows.matrix) @ unit), unit

    def at_limit(self, values: FloatArray) -> NDArray[np.bool_]:
        """Which numbers ``p`` (..., k) take part in a limit that they are at, or beyond, shape (..., k); none where they are
        NaN."""
        at = values @ self.rows.matrix.T
        with np.errstate(invalid="ignore"):
            near = (at - self.rows.low <= self._near) | (self.rows.high - at <= self._near)
        return np.asarray((near[..., :, None] & (self.rows.matrix != 0)).any(axis=-2))

    def kept(self, values: FloatArray, before: FloatArray) -> FloatArray:
        """``p`` (b, k), what is at a limit of a number by itself without rounding; ``before`` (b, k) is where it came from."""
        result = np.array(values)
        for row, low, high in zip(self.rows.matrix, self.rows.low, self.rows.high, strict=True):
            own = np.flatnonzero(row)
            if len(own) == 1:
                k = own[0]
                at, rounded = result[:, k], LIMIT_ROUNDING * self.unit[k]
                for end in (low, high):
                    at = np.where(np.abs(at - end) <= rounded, end, at)
                result[:, k] = np.clip(at, np.minimum(low, before[:, k]), np.maximum(high, before[:, k]))
        return result

    def step(
        self, planned: Posterior, p: FloatArray, told: tuple[FloatArray, FloatArray, FloatArray, FloatArray, FloatArray]
    ) -> tuple[FloatArray, FloatArray]:
        """(7) The step of least squares within the limits, and its length in standard deviations, shapes (b, k) and (b,).

        Args:
            planned: The step without limits, which is taken where it is within them.
            p: Where it begins, shape (b, k); what is beyond a limit there may stay, and not go farther.
            told: Arguments of ``posterior``.
        """
        outside = self.leading_out(planned.step, p)
        if not len(outside):
            return planned.step, planned.length
        step, length = planned.step.copy(), planned.length.copy()
        low, high = self._room(p[outside])
        J, r, root, away, unit = told
        # powers of two do not round: instances that share them share a launch, and each is as it is alone
        powers = np.round(np.log2(unit[outside]))
        shared, which = np.unique(powers, axis=0, return_inverse=True)
        for group, power in enumerate(shared):
            mine = which.reshape(-1) == group
            own = outside[mine]
            stacked = np.concatenate([J[own], root[own]], axis=1)
            sides = np.concatenate([r[own], (root[own] @ away[own, :, None])[..., 0]], axis=1)
            step[own], length[own] = self._kept(step[own], stacked, sides, low[mine], high[mine], 2.0**power)
        return step, length

    def leading_out(self, step: FloatArray, p: FloatArray) -> NDArray[np.intp]:
        """Which instances' steps (b, k) from ``p`` (b, k) lead beyond a limit, or farther beyond one."""
        if not len(self.rows.low):
            return np.zeros(0, dtype=np.intp)
        (low, high), moved = self._room(p), step @ self.rows.matrix.T
        return np.flatnonzero(~((moved >= low) & (moved <= high)).all(axis=1))

    def before(self, p: FloatArray, step: FloatArray, part: float) -> FloatArray:
        """Where steps (b, k) lead from ``p`` (b, k), or this ``part`` of the way to a limit that they would go beyond."""
        (low, high), moved = self._room(p), step @ self.rows.matrix.T
        beyond = (moved < low) | (moved > high)
        room = np.where(moved < 0, low, high) / np.where(beyond, moved, 1.0)
        return np.asarray(p + np.where(beyond, part * room, 1.0).min(axis=1, initial=1.0)[:, None] * step)

    def _room(self, p: FloatArray) -> tuple[FloatArray, FloatArray]:
        """What is left to go of each row, at ``p`` (b, k), down and up, shapes (b, c)."""
        at = p @ self.rows.matrix.T
        return np.minimum(self._low - at, 0.0), np.maximum(self._high - at, 0.0)

    def _kept(
        self, free: FloatArray, stacked: FloatArray, sides: FloatArray, low: FloatArray, high: FloatArray, unit: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """(8) For rows ``stacked d + sides`` that an orthogonal matrix makes as few as there are numbers."""
        turned, R = np.linalg.qr(stacked * unit)
        change = within_limits(
            self.rows.matrix * unit,
            J=R,
            r=(np.swapaxes(turned, 1, 2) @ sides[..., None])[..., 0],
            softness=SOFTNESS * np.abs(R).max(axis=(1, 2)) ** 2,
            low=low,
            high=high,
            change=free / unit,
        )
        return change * unit, np.linalg.norm((R @ change[..., None])[..., 0], axis=1)
