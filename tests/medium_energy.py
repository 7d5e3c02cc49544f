"""The total potential energy of a rod in an elastic medium on segments of constant strain: an independent witness of stability.

Unknown are the curvatures of every segment; nothing of the package is used.
"""

import numpy as np
from scipy.spatial.transform import Rotation


class MediumEnergy:
    """Of a straight or bent rod clamped at its base, under a force on its tip.

    Args:
        length: [m].
        stiffness: About x, y and z [N m^2].
        u_star: Its curvature at rest [1/m].
        k: Of the medium along the axes of the base [N/m^2].
        force: On the tip [N].
        count: Segments.
    """

    def __init__(self, length, stiffness, u_star, k, force, count: int) -> None:
        self.h, self.count, self.size = length / count, count, 3 * count
        self.stiffness, self.u_star, self.k, self.force = (np.asarray(x, float) for x in (stiffness, u_star, k, force))

    turned = 0.0  # about its axis, at its base [rad]
    ends: int | None = None  # segments around which the medium is, if not all

    def elastic(self, u: np.ndarray) -> np.ndarray:
        """Energy [J] of unknowns (batch, size)."""
        u = u.reshape(len(u), self.count, 3)
        return (self.stiffness * (u - self.u_star) ** 2).sum((1, 2)) * self.h / 2

    def __call__(self, u: np.ndarray) -> np.ndarray:
        """Energy [J] of unknowns (batch, size), of which curvatures come first."""
        energy, h = self.elastic(u), self.h
        u = u[:, : 3 * self.count].reshape(len(u), self.count, 3)
        R, p = Rotation.from_rotvec(np.tile([0.0, 0, self.turned], (len(u), 1))), np.zeros((len(u), 3))
        for j in range(self.count):
            # two halves of a segment: Simpson's rule for what the medium stores
            apart = [p - [0, 0, j * h]]
            for half in (0.5, 1.0):
                middle = R * Rotation.from_rotvec(u[:, j] * h * half / 2)
                bend = np.linalg.norm(u[:, j, :2], axis=1) * h * half / 2
                there = p + (half * h * np.sinc(bend / np.pi))[:, None] * middle.as_matrix()[:, :, 2]
                apart.append(there - [0, 0, (j + half) * h])
            p, R = there, R * Rotation.from_rotvec(u[:, j] * h)
            stored = [(self.k * way**2).sum(1) / 2 for way in apart]
            if self.ends is None or j < self.ends:
                energy = energy + h / 6 * (stored[0] + 4 * stored[1] + stored[2])
        return energy - p @ self.force

    def derivatives(self, u: np.ndarray, step: float) -> tuple[np.ndarray, np.ndarray]:
        """Gradient and Hessian by central differences."""
        i, j = np.triu_indices(self.size)
        e = np.eye(self.size) * step
        values = [self(u + a * e[i] + b * e[j]) for a, b in ((1, 1), (1, -1), (-1, 1), (-1, -1))]
        H = np.zeros((self.size, self.size))
        H[i, j] = (values[0] - values[1] - values[2] + values[3]) / (4 * step**2)
        return (self(u + e) - self(u - e)) / (2 * step), H + np.triu(H, 1).T

    def stationary(self, u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The stationary point near ``u``, by Newton's method, and the eigenvalues of the Hessian there, ascending."""
        u = np.array(u, float).ravel()
        for _ in range(6):
            g, H = self.derivatives(u, 2e-2 / (self.h * self.count))
            move = -np.linalg.solve(H, g)
            u += move
            if np.abs(move).max() < 1e-6 / (self.h * self.count):
                break
        return u, np.linalg.eigvalsh(H)


class TubesInMedium(MediumEnergy):
    """The same of concentric tubes with round sections, the longest one first, whose curvatures come first: then the change of
    each other one's angle from it over each of its segments, over the segment's length.

    Args:
        length: [m].
        tubes: Of each, bending and torsional stiffness [N m^2], curvature at rest on each of its segments (reach, 3) [1/m].
        turned: At their bases [rad].
        k: Of the medium around all of them [N/m^2].
        force: On the tip [N].
        count: Segments.
    """

    def __init__(self, length, tubes, turned, k, force, count: int) -> None:
        super().__init__(length, 0.0, 0.0, k, force, count)
        self.tubes, self.angles, self.turned = tubes, np.asarray(turned) - turned[0], turned[0]
        self.first = 3 * count + np.cumsum([0, *(len(rest) for _, _, rest in tubes[1:])])
        self.size = int(self.first[-1])

    def elastic(self, u: np.ndarray) -> np.ndarray:
        """As said."""
        frame, energy = u[:, : 3 * self.count].reshape(len(u), self.count, 3), 0.0
        for j, (EI, GJ, rest) in enumerate(self.tubes):
            there = frame[:, : len(rest)].copy()
            if j > 0:
                rate = u[:, self.first[j - 1] : self.first[j]]
                angle = self.angles[j] + self.h * (np.cumsum(rate, axis=1) - rate / 2)  # in the middle
                c, s = np.cos(angle), np.sin(angle)
                x, y = there[..., 0].copy(), there[..., 1].copy()
                there[..., 0], there[..., 1], there[..., 2] = c * x + s * y, c * y - s * x, there[..., 2] + rate
            energy = energy + (np.array([EI, EI, GJ]) * (there - rest) ** 2).sum((1, 2)) * self.h / 2
        return energy

    def of(self, solution, order) -> np.ndarray:
        """Unknowns of a solution of the package whose rods stand here in this order."""
        frame = solution.rod(order[0], nodes=2 * self.count + 1)
        parts = [np.array(frame.curvature)[1::2].ravel()]
        for own, (_, _, rest) in zip(order[1:], self.tubes[1:], strict=True):
            there, n = solution.rod(own, nodes=2 * len(rest) + 1), 2 * len(rest) + 1
            parts.append((np.array(there.curvature)[1::2] - np.array(frame.curvature)[1:n:2])[:, 2])
        return np.concatenate(parts)
