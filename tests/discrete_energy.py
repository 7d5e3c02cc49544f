"""The total potential energy of concentric tubes on segments of constant strain: an independent witness of stability.

Unknown are the strains of every segment and how far each tube turns behind the plate; nothing of the package is used.
"""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.spatial.transform import Rotation


@dataclass(frozen=True)
class Tube:
    """One tube of round section: straight for ``straight``, then of curvature ``u_star``; ``behind`` the plate by its shift."""

    length: float
    straight: float
    EI: float
    GJ: float
    u_star: tuple[float, float, float]
    angle: float = 0.0
    behind: float = 0.0


class DiscreteEnergy:
    """Energy of tubes, the longest first, under a tip force, on segments that end where a tube ends or becomes curved."""

    def __init__(self, tubes: list[Tube], force: np.ndarray, segment_count: int) -> None:
        self.tubes, self.force = tubes, np.asarray(force, float)
        breaks = {0.0, *(t.length - t.behind for t in tubes), *(t.straight - t.behind for t in tubes)}
        nodes = sorted(s for s in breaks if s >= 0)
        edges = [np.array([0.0])]
        for a, b in pairwise(nodes):
            edges.append(np.linspace(a, b, max(2, round(segment_count * (b - a) / nodes[-1])) + 1)[1:])
        self.edges = np.concatenate(edges)
        self.h = np.diff(self.edges)
        self.middle = (self.edges[1:] + self.edges[:-1]) / 2
        # u of the first tube, then each other tube's rate of angle where it is, then the turns behind the plate
        self.places = [np.flatnonzero(self.middle < t.length - t.behind) for t in tubes[1:]]
        self.turning = [k for k, t in enumerate(tubes) if t.behind > 0 and len(tubes) > 1]
        self.size = 3 * len(self.h) + sum(len(p) for p in self.places) + len(self.turning)

    def __call__(self, q: np.ndarray) -> np.ndarray:
        """Energy [J] of configurations (batch, size)."""
        count, m = q.shape[0], len(self.h)
        u = q[:, : 3 * m].reshape(count, m, 3)
        turns = np.zeros((count, len(self.tubes)))
        turns[:, self.turning] = q[:, self.size - len(self.turning) :]
        energy = sum(t.GJ / (2 * t.behind) * turns[:, k] ** 2 for k, t in enumerate(self.tubes) if k in self.turning)
        energy = energy + np.zeros(count)
        base = [t.angle + turns[:, k] for k, t in enumerate(self.tubes)]
        at = 3 * m
        for k, tube in enumerate(self.tubes):
            rate = np.zeros((count, m))
            if k:
                places = self.places[k - 1]
                rate[:, places] = q[:, at : at + len(places)]
                at += len(places)
            theta = base[k][:, None] - base[0][:, None] + np.cumsum(rate * self.h, axis=1) - rate * self.h / 2
            here = self.middle < tube.length - tube.behind
            x, y, z = np.where(self.middle[:, None] > tube.straight - tube.behind, tube.u_star, 0.0).T
            bend = (u[..., 0] - np.cos(theta) * x + np.sin(theta) * y) ** 2
            bend += (u[..., 1] - np.sin(theta) * x - np.cos(theta) * y) ** 2
            energy += (here * self.h * (tube.EI * bend + tube.GJ * (u[..., 2] + rate - z) ** 2)).sum(axis=1) / 2
        return energy - self.tip(u, base[0]) @ self.force

    def tip(self, u: np.ndarray, angle: np.ndarray) -> np.ndarray:
        """Position of the tip, shape (batch, 3)."""
        R = Rotation.from_rotvec(np.stack([0 * angle, 0 * angle, angle], axis=1))
        p = np.zeros((len(angle), 3))
        for k, h in enumerate(self.h):
            half = R * Rotation.from_rotvec(u[:, k] * h / 2)
            # a segment's chord, to the fourth order: sinc of half its angle
            bend = np.linalg.norm(u[:, k, :2], axis=1) * h / 2
            p += (h * np.sinc(bend / np.pi))[:, None] * half.as_matrix()[:, :, 2]
            R = R * Rotation.from_rotvec(u[:, k] * h)
        return p

    def derivatives(self, q: np.ndarray, step: float = 2e-3) -> tuple[np.ndarray, np.ndarray]:
        """Gradient and Hessian by central differences, in steps of an energy that varies over 1 in ``q / scale``."""
        n = self.size
        i, j = np.triu_indices(n)
        unit = self.scale()
        e = np.eye(n) * unit[:, None] * step
        values = [self(q + a * e[i] + b * e[j]) for a, b in ((1, 1), (1, -1), (-1, 1), (-1, -1))]
        H = np.zeros((n, n))
        H[i, j] = (values[0] - values[1] - values[2] + values[3]) / (4 * step**2)
        H = H + np.triu(H, 1).T
        return (self(q + e) - self(q - e)) / (2 * step), H

    def scale(self) -> np.ndarray:
        """One turn's worth of each strain over its segment: the unknowns in which the Hessian is well scaled."""
        lengths = [np.repeat(self.h, 3), *(self.h[places] for places in self.places), np.ones(len(self.turning))]
        return 1 / np.sqrt(np.concatenate(lengths) * self.edges[-1])

    def stationary(self, q: np.ndarray) -> tuple[np.ndarray, int]:
        """The stationary point near q, by Newton's method, and how many eigenvalues of the Hessian are negative there."""
        q = np.array(q, float)
        for _ in range(6):
            g, H = self.derivatives(q)
            step = -np.linalg.solve(H, g) * self.scale()
            q += step
            if np.abs(step / self.scale()).max() < 1e-6:
                break
        return q, int((np.linalg.eigvalsh(H) < 0).sum())


class DiscretePlatform:
    """Energy of straight rods of round section, clamped at their bases, that hold a platform under a dead force at its origin.

    Unknown are the strains ``u`` of every segment of each rod, and the pose of the platform; joints are constraints between them.
    """

    def __init__(self, rods, base, platform, joints, force, segment_count: int) -> None:
        """``rods`` are tuples (length, EI, GJ, EA); ``joints`` "clamped" or "spherical"."""
        self.rods, self.base, self.platform, self.joints = rods, base, platform, joints
        self.force, self.m = np.asarray(force, float), segment_count
        self.per_rod = 4 * segment_count  # three curvatures, one stretch
        self.size = self.per_rod * len(rods) + 6

    def parts(self, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Energy [J] and what the joints leave open, of configurations (batch, size)."""
        count, m = len(q), self.m
        position, turn = q[:, -6:-3], Rotation.from_rotvec(q[:, -3:])
        energy, gaps = -position @ self.force, []
        for k, (length, EI, GJ, EA) in enumerate(self.rods):
            own = q[:, k * self.per_rod : (k + 1) * self.per_rod].reshape(count, m, 4)
            h = length / m
            energy = (
                energy
                + h / 2 * (EI * own[..., :2] ** 2).sum((1, 2))
                + h / 2 * (GJ * own[..., 2] ** 2 + EA * own[..., 3] ** 2).sum(1)
            )
            R = Rotation.from_matrix(np.broadcast_to(self.base[k, :3, :3], (count, 3, 3)))
            p = np.broadcast_to(self.base[k, :3, 3], (count, 3)).copy()
            for j in range(m):
                half = R * Rotation.from_rotvec(own[:, j, :3] * h / 2)
                bend = np.linalg.norm(own[:, j, :2], axis=1) * h / 2
                p += (h * (1 + own[:, j, 3]) * np.sinc(bend / np.pi))[:, None] * half.as_matrix()[:, :, 2]
                R = R * Rotation.from_rotvec(own[:, j, :3] * h)
            gaps.append(p - position - turn.apply(self.platform[k, :3, 3]))
            if self.joints[k] == "clamped":
                gaps.append(((turn * Rotation.from_matrix(self.platform[k, :3, :3])).inv() * R).as_rotvec())
        return energy, np.concatenate(gaps, axis=1)

    def index(self, q: np.ndarray, step: float = 1e-3) -> tuple[np.ndarray, int]:
        """The stationary point near q, and the negative eigenvalues of the Hessian of the Lagrangian across the constraints."""
        n = self.size
        unit = np.ones(n)
        unit[:-6] = np.tile(np.repeat([1.0], 4), self.m * len(self.rods))
        i, j = np.triu_indices(n)
        for _ in range(5):
            e = np.eye(n) * step
            (Ep, cp), (Em, cm) = self.parts(q + e), self.parts(q - e)
            g, A = (Ep - Em) / (2 * step), ((cp - cm) / (2 * step)).T
            multipliers = -np.linalg.lstsq(A.T, g, rcond=None)[0]
            values = [
                E + c @ multipliers
                for E, c in (self.parts(q + a * e[i] + b * e[j]) for a, b in ((1, 1), (1, -1), (-1, 1), (-1, -1)))
            ]
            H = np.zeros((n, n))
            H[i, j] = (values[0] - values[1] - values[2] + values[3]) / (4 * step**2)
            H = H + np.triu(H, 1).T
            c = self.parts(q[None])[1][0]
            KKT = np.block([[H, A.T], [A, np.zeros((len(A), len(A)))]])
            move = np.linalg.solve(KKT, -np.concatenate([g + A.T @ multipliers, c]))[:n]
            q = q + move
            if np.abs(move).max() < 1e-7:
                break
        free = np.linalg.svd(A)[2][len(A) :].T
        return q, int((np.linalg.eigvalsh(free.T @ H @ free) < 0).sum())
