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

    def __call__(self, u: np.ndarray) -> np.ndarray:
        """Energy [J] of curvatures (batch, size)."""
        u, h = u.reshape(len(u), self.count, 3), self.h
        energy = (self.stiffness * (u - self.u_star) ** 2).sum((1, 2)) * h / 2
        R, p = Rotation.from_quat(np.tile([0.0, 0, 0, 1], (len(u), 1))), np.zeros((len(u), 3))
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
