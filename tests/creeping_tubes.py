"""Unloaded concentric tubes on segments, that creep: nothing of the package is used.

Without loads they carry no moment together, so that the centreline follows from how they are turned: unknown are their angles at
nodes, from a frame that does not twist.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from relaxation import rotation
from scipy.linalg import cho_solve_banded, cholesky_banded

LONGEST = 0.05  # of a step of creeping [rad]


@dataclass
class Curved:
    """A tube that is straight for ``straight``, then bent by ``curvature`` about its x axis, and ends at ``reach``."""

    reach: float
    bending: float
    torsion: float
    straight: float
    curvature: float


class CreepingTubes:
    """Tubes on segments of the longest one.

    Args:
        tubes: All.
        count: Segments.

    Attributes:
        angle: Of each tube at the nodes [rad], shape (tube, count + 1).
    """

    def __init__(self, tubes: list[Curved], count: int = 160) -> None:
        self.tubes, self.count = tubes, count
        self.nodes = np.linspace(0, max(tube.reach for tube in tubes), count + 1)
        self.h = self.nodes[-1] / count
        middle = 0.5 * (self.nodes[1:] + self.nodes[:-1])
        self.on = np.array([middle < tube.reach for tube in tubes])
        self.bent = np.array([tube.bending * tube.curvature * (middle >= tube.straight) for tube in tubes]) * self.on
        self.stiff = np.maximum((self.on * [[tube.bending] for tube in tubes]).sum(axis=0), 1e-300)
        self.torsion = self.on * [[tube.torsion] for tube in tubes]
        self.angle = np.zeros((len(tubes), count + 1))

    def place(self, solution: Any) -> None:
        """Tubes as a solution of the package has them twisted, whose bases are where these have them."""
        for k, angle in enumerate(self.angle):
            rod = solution.rod(k, nodes=401)
            s, twist = np.array(rod.arclength), np.array(rod.curvature)[:, 2]
            twisted = np.append(0.0, np.cumsum(0.5 * (twist[1:] + twist[:-1]) * np.diff(s)))
            angle[:] = angle[0] + np.interp(self.nodes, s, twisted)

    def energy(self) -> float:
        """Elastic, but for what bends each tube to where it is bent at rest."""
        x, y, _, _ = self._pull()
        return float(
            0.5 * (self.torsion * np.diff(self.angle) ** 2).sum() / self.h - 0.5 * self.h * ((x * x + y * y) / self.stiff).sum()
        )

    def _pull(self) -> tuple[np.ndarray, ...]:
        """What bends all segments, about x and y, then each tube's part, (tube, segment)."""
        middle = 0.5 * (self.angle[:, 1:] + self.angle[:, :-1])
        x, y = self.bent * np.cos(middle), self.bent * np.sin(middle)
        return x.sum(axis=0), y.sum(axis=0), x, y

    def gradient(self) -> np.ndarray:
        """Of the energy by the angles."""
        x, y, own_x, own_y = self._pull()
        turned, twisted = -self.h * (y * own_x - x * own_y) / self.stiff, self.torsion * np.diff(self.angle) / self.h
        result = np.zeros_like(self.angle)
        result[:, 1:] += 0.5 * turned + twisted
        result[:, :-1] += 0.5 * turned - twisted
        return result

    def _factor(self, shift: float) -> tuple[np.ndarray, np.ndarray]:
        """The second derivative, ``shift`` added, as a lower band whose nodes follow each other; and which angles are free."""
        n, N = self.angle.shape[0], self.count
        x, y, own_x, own_y = self._pull()
        w = -self.h * (own_y[:, None] * own_y + own_x[:, None] * own_x) / self.stiff
        tubes = np.arange(n)
        w[tubes, tubes] += self.h * (x * own_x + y * own_y) / self.stiff
        w, torsion = 0.25 * np.moveaxis(w, 2, 0), np.zeros((N, n, n))
        torsion[:, tubes, tubes] = self.torsion.T / self.h
        free = np.zeros((N + 1, n), dtype=bool)
        free[1:] = self.on.T
        own, beside = np.zeros((N + 1, n, n)), (w - torsion) * free[1:, :, None] * free[:-1, None, :]
        own[1:] += w + torsion
        own[:-1] += w + torsion
        own *= free[:, :, None] * free[:, None, :]
        own[:, tubes, tubes] += np.where(free, shift, 1.0)
        band = np.zeros((2 * n, (N + 1) * n))
        for column in range(n):
            at = np.arange(N + 1) * n + column
            for row in range(n):
                if row >= column:
                    band[row - column, at] = own[:, row, column]
                band[n + row - column, at[:-1]] = beside[:, row, column]
        return band, free

    def _step(self, shift: float) -> np.ndarray:
        """Against the gradient; raises ``LinAlgError`` where the second derivative and ``shift`` are not positive."""
        band, free = self._factor(shift)
        factor = cholesky_banded(band, lower=True, check_finite=False)
        slope = np.where(free, self.gradient().T, 0.0).ravel()
        return -cho_solve_banded((factor, True), slope, check_finite=False).reshape(free.shape).T

    def creep(self, bases: np.ndarray, most: int = 4000) -> bool:
        """Turn the bases so, and go down in energy, held back in proportion to how fast angles change, until they rest; whether
        that is at a minimum."""
        self.angle[:, 0] = bases
        dt = 1e-4
        for _ in range(most):
            while True:
                try:
                    step = self._step(self.h / dt)
                    size = float(np.abs(step).max())
                except np.linalg.LinAlgError:
                    size = np.inf
                if size <= LONGEST or dt < 1e-14:
                    break
                dt *= 0.5
            if not size <= LONGEST:
                return False
            self.angle += step
            if size < 1e-9 and dt > 1e3:
                return True
            dt = min(1.3 * dt, 1e7)
        return False

    def settle(self, bases: np.ndarray) -> bool:
        """Newton's method among states where the second derivative is positive: whether it came to rest."""
        self.angle[:, 0] = bases
        for _ in range(30):
            try:
                step = self._step(0.0)
            except np.linalg.LinAlgError:
                return False
            size = float(np.abs(step).max())
            self.angle += min(1.0, 0.3 / max(size, 1e-300)) * step
            if size < 1e-9:
                return True
        return False

    def tip(self) -> np.ndarray:
        """Where the longest ends, from the base."""
        x, y, _, _ = self._pull()
        turns = np.stack([x, y, 0 * x], axis=1) / self.stiff[:, None] * self.h
        halves, wholes = rotation(0.5 * turns), rotation(turns)
        frame, place = np.eye(3), np.zeros(3)
        for half, whole in zip(halves, wholes, strict=True):
            place = place + self.h * (frame @ half)[:, 2]
            frame = frame @ whole
        return place
