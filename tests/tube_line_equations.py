"""Concentric tubes with lines from their energy alone, in plain NumPy: an independent witness of their equilibria.

Nothing of the package is used, and no derivative of the energy is written down: complex steps give them. The frame does not
twist; each tube has its own angle ``psi`` and torque ``tau`` against it. The energy per length is that of each tube, bent by the
curvature that all share as its own frame sees it and twisted by itself, and the tension of each of its lines times the line's
length.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np

TINY = 1e-40  # a complex step


@dataclass(frozen=True)
class TubeLine:
    """``route(s)`` is the offset (2,) and its derivative at arclength s from the tube's base.

    Its tension works on its length, that of the chords between ``discs``, or the volume of a ``hole`` in the section.
    """

    route: Callable[[float], tuple[np.ndarray, np.ndarray]]
    tension: float | Callable[[float], float]  # or a function of that arclength
    start: float = 0.0
    end: float = np.inf
    discs: float = 0.0
    hole: bool = False
    bending: float = 0.0  # its own stiffness


@dataclass(frozen=True)
class Tube:
    """Sections ``(length, EI_x, EI_y, GJ, u*)``; ``angle`` and ``translation`` of its base."""

    sections: list[tuple[float, float, float, float, np.ndarray]]
    angle: float
    translation: float
    lines: list[TubeLine] = field(default_factory=list)

    @property
    def length(self) -> float:
        return sum(section[0] for section in self.sections)

    def section_at(self, s: float) -> tuple[float, float, float, float, np.ndarray] | None:
        """At arclength s from the plate; None past the tube's end."""
        end = self.translation
        for section in self.sections:
            end += section[0]
            if s < end:
                return section
        return None

    def cuts(self) -> list[float]:
        ends = np.cumsum([section[0] for section in self.sections]).tolist()
        return [self.translation + c for c in (*ends, *(e for line in self.lines for e in (line.start, min(line.end, 1e9))))]


class TubeLineEquations:
    """Tubes behind a plate at the origin, and a dead force on the tip."""

    def __init__(self, tubes: list[Tube], force: np.ndarray) -> None:
        self.tubes, self.force = tubes, np.asarray(force, float)
        self.tip = max(tube.translation + tube.length for tube in tubes)
        self.cuts = sorted({0.0, self.tip, *(c for tube in tubes for c in tube.cuts() if 0 < c < self.tip)})
        self.count = sum(len(tube.lines) for tube in tubes)

    def energy(self, s: float, q: np.ndarray, psi: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Elastic energy per length, tensions times lengths, and each line's length per length, of a batch of
        ``q = (u_x, u_y, u_z of each)`` and angles."""
        elastic = pulled = 0 * q[:, 0]
        lengths = np.zeros((len(q), self.count), dtype=q.dtype)
        k = 0
        for i, tube in enumerate(self.tubes):
            section = tube.section_at(s)
            c, sn = np.cos(psi[:, i]), np.sin(psi[:, i])
            ux, uy, uz = c * q[:, 0] + sn * q[:, 1], c * q[:, 1] - sn * q[:, 0], q[:, 2 + i]
            if section is not None:
                _, EI_x, EI_y, GJ, u = section
                elastic = elastic + (EI_x * (ux - u[0]) ** 2 + EI_y * (uy - u[1]) ** 2 + GJ * (uz - u[2]) ** 2) / 2
            else:
                elastic = elastic + 1e-3 * uz**2 / 2  # of what is not there: no twist
            for line in tube.lines:
                material = s - tube.translation
                if section is not None and line.start <= material < line.end:
                    (x, y), (dx, dy) = line.route(material)
                    a = (dx - uz * y, dy + uz * x, 1 + ux * y - uy * x)
                    lengths[:, k] = a[2] if line.hole else np.sqrt(a[0] ** 2 + a[1] ** 2 + a[2] ** 2)
                    lengths[:, k] *= 1 - line.discs**2 / 24 * (ux**2 + uy**2)
                    elastic = elastic + line.bending * (ux**2 + uy**2) / (2 * a[2])
                    tension = line.tension(material) if callable(line.tension) else line.tension
                    pulled = pulled + tension * lengths[:, k]
                k += 1
        return elastic, pulled, lengths

    def gradient(self, s: float, q: np.ndarray, psi: np.ndarray) -> np.ndarray:
        """Of the energy by ``(q, psi)``."""
        n, m = len(psi), len(q)
        steps = 1j * TINY * np.eye(m + n)
        elastic, pulled, _ = self.energy(s, q + steps[:, :m], psi + steps[:, m:])
        return (elastic + pulled).imag / TINY

    def strains(self, s: float, load: np.ndarray, psi: np.ndarray, q: np.ndarray) -> np.ndarray:
        """Those at which tubes and lines carry ``load``, near q: Newton's method by differences of exact gradients."""
        m = len(q)
        for _ in range(20):
            gap = self.gradient(s, q, psi)[:m] - load
            h = 1e-5
            hessian = np.stack(
                [(self.gradient(s, q + h * e, psi) - self.gradient(s, q - h * e, psi))[:m] / (2 * h) for e in np.eye(m)]
            )
            step = np.linalg.solve(hessian, gap)
            q = q - step
            if np.abs(step).max() < 1e-12 * max(1.0, np.abs(q).max()):
                break
        return q

    def integrate(self, moment: np.ndarray, torque: np.ndarray, steps: int = 200):
        """From the moment of all (in the frame that does not twist) and the torque of each tube at the plate.

        Returns position and frame of the tip, its moment (2,), the torque of each tube at its own end, lengths, elastic energy.
        """
        n = len(self.tubes)
        psi, energy = np.zeros(n), 0.0
        for i, tube in enumerate(self.tubes):  # straight behind the plate, where lines do not twist it
            behind = -tube.translation
            for length, _, _, GJ, u in tube.sections:
                own = min(length, behind)
                psi[i] += own * (u[2] + torque[i] / GJ)
                energy += own * torque[i] ** 2 / (2 * GJ)
                behind -= own
            psi[i] += tube.angle
        y = np.concatenate([np.zeros(3), np.eye(3).ravel(), moment, psi, torque, np.zeros(self.count), [energy]])
        q = np.zeros(2 + n)

        def rate(s: float, y: np.ndarray) -> np.ndarray:
            nonlocal q
            R, M, psi, tau = y[3:12].reshape(3, 3), y[12:14], y[14 : 14 + n], y[14 + n : 14 + 2 * n]
            there = np.array([tube.section_at(s) is not None for tube in self.tubes])
            q = self.strains(s, np.concatenate([M, tau * there]), psi, q)
            by_angle = self.gradient(s, q, psi)[2 + n :]
            elastic, _, lengths = self.energy(s, q[None], psi[None])
            u = np.array([q[0], q[1], 0.0])
            N, total = R.T @ self.force, np.array([*M, (tau * there).sum()])
            dM = np.cross(total, u) + np.cross(N, [0, 0, 1])
            W = np.array([[0, 0, u[1]], [0, 0, -u[0]], [-u[1], u[0], 0]])
            rates = [R[:, 2], (R @ W).ravel(), dM[:2], q[2:] * there, by_angle * there, lengths[0], elastic]
            return np.concatenate(rates)

        for a, b in pairwise(self.cuts):
            parts = max(4, round(steps * (b - a) / self.tip))
            h = (b - a) / parts
            for k in range(parts):
                # of this stretch, at its ends too
                start, middle, end = np.clip(a + h * np.array([k, k + 0.5, k + 1]), a + 1e-9 * h, b - 1e-9 * h)
                k1 = rate(start, y)
                k2 = rate(middle, y + h / 2 * k1)
                k3 = rate(middle, y + h / 2 * k2)
                k4 = rate(end, y + h * k3)
                y = y + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
        return y[:3], y[3:12].reshape(3, 3), y[12:14], y[14 + n : 14 + 2 * n], y[14 + 2 * n : -1], y[-1]
