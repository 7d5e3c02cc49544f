"""The potential energy of a rod between two balls on segments of constant strain: an independent witness of equilibrium and
stability.

Unknown are the rotation of the base and the strains of every segment; the place of the end is a constraint. Nothing of the
package is used.
"""

import numpy as np
from scipy.spatial.transform import Rotation


class HeldEnergy:
    """Of a rod under a force per length.

    Args:
        sections: Of the rod, dictionaries of ``mr.Section``'s arguments with constant precurvature.
        base: Where the base is, shape (3,).
        end: Where the end is, shape (3,).
        slide: Along which the end slides, in the world, shape (3,), or None.
        forces: Per length, of each section [N/m], shape (section, 3).
        tip_force: On the end [N], shape (3,).
        count: Segments.
    """

    def __init__(self, sections, base, end, slide, forces, tip_force, count: int) -> None:
        lengths = np.array([s["length"] for s in sections])
        parts = np.maximum(1, np.round(count * lengths / lengths.sum()).astype(int))
        owner = np.repeat(np.arange(len(sections)), parts)
        self.h, self.count = (lengths / parts)[owner], len(owner)
        self.rigid = "axial_stiffness" not in sections[0]
        self.K = np.array([[*s["bending_stiffness"], s["torsional_stiffness"]] for s in sections])[owner]
        self.u_star = np.array([s["precurvature"] for s in sections])[owner]
        if not self.rigid:
            stiff = [[s["shear_stiffness"]] * 2 + [s["axial_stiffness"]] for s in sections]
            self.S = np.array(stiff)[owner]
        self.base, self.end, self.forces, self.tip_force = base, end, np.asarray(forces)[owner], tip_force
        self.across = np.eye(3) if slide is None else np.linalg.svd(slide[None])[2][1:]
        self.per = 3 if self.rigid else 6
        self.size = 3 + self.per * self.count
        self.frame = np.eye(3)
        load = np.abs(forces).max() * lengths.sum() ** 3 / self.K.min()
        self.unit = self.K.min() / lengths.sum()  # of energies
        self.scale = np.full(self.size, 1.0)  # of unknowns: turns [rad]
        own = np.concatenate([np.ones(3), np.full(self.per - 3, 1e-2 * lengths.sum() / np.sqrt(1 + load))])
        self.scale[3:] = (own / np.repeat(self.h, self.per).reshape(-1, self.per)).ravel() / np.sqrt(self.count)

    @classmethod
    def of(cls, drawn, count: int) -> "HeldEnergy":
        """Of a scene of ``random_held``."""
        forces = [drawn.force for _ in drawn.sections]  # all weigh the same
        slide = None if drawn.slide is None else drawn.end[:3, :3] @ drawn.slide
        return cls(drawn.sections, drawn.base[:3, 3], drawn.end[:3, 3], slide, forces, drawn.tip_force, count)

    def at_nodes(self, found) -> tuple[np.ndarray, np.ndarray]:
        """Unknowns of a solution's rod, and the places of its nodes, (count + 1, 3)."""
        fine = found.rod(0, nodes=20 * self.count + 1)
        nodes = np.concatenate([[0.0], np.cumsum(self.h)])
        at = np.abs(fine.arclength[:, None] - nodes).argmin(axis=0)
        return self.begin(fine.rotation[at], fine.position[at]), fine.position[at]

    def begin(self, rotation, position) -> np.ndarray:
        """Unknowns of a rod whose nodes, ends of the segments, have this pose; the base's rotation is told against its own."""
        self.frame = rotation[0]
        q = np.zeros(self.size)
        own = q[3:].reshape(self.count, self.per)
        turn = Rotation.from_matrix(np.swapaxes(rotation[:-1], 1, 2) @ rotation[1:]).as_rotvec()
        own[:, :3] = turn / self.h[:, None]
        if not self.rigid:
            middle = Rotation.from_matrix(rotation[:-1]) * Rotation.from_rotvec(turn / 2)
            own[:, 3:] = middle.inv().apply(np.diff(position, axis=0)) / self.h[:, None] - [0, 0, 1]
        return q

    def shape(self, q: np.ndarray) -> np.ndarray:
        """Places of all nodes, (batch, count + 1, 3)."""
        own = q[:, 3:].reshape(len(q), self.count, self.per)
        R = Rotation.from_matrix(np.broadcast_to(self.frame, (len(q), 3, 3))) * Rotation.from_rotvec(q[:, :3])
        p = [np.broadcast_to(self.base, (len(q), 3))]
        for k, h in enumerate(self.h):
            half = Rotation.from_rotvec(own[:, k, :3] * h / 2)
            bend = np.linalg.norm(own[:, k, :2], axis=1) * h / 2
            v = np.zeros((len(q), 3)) if self.rigid else own[:, k, 3:].copy()
            v[:, 2] += 1
            p.append(p[-1] + h * np.sinc(bend / np.pi)[:, None] * (R * half).apply(v))
            R = R * half * half
        return np.stack(p, axis=1)

    def parts(self, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Energy [J] and what the end lacks [m], of unknowns (batch, size)."""
        own = q[:, 3:].reshape(len(q), self.count, self.per)
        p = self.shape(q)
        middle = 0.5 * (p[:, 1:] + p[:, :-1])
        energy = 0.5 * (self.h[:, None] * self.K * (own[..., :3] - self.u_star) ** 2).sum((1, 2))
        if not self.rigid:
            energy += 0.5 * (self.h[:, None] * self.S * own[..., 3:] ** 2).sum((1, 2))
        energy -= (self.h[:, None] * self.forces * (middle - self.base)).sum((1, 2)) + (p[:, -1] - self.end) @ self.tip_force
        return energy, (p[:, -1] - self.end) @ self.across.T

    def stationary(self, q: np.ndarray, steps: int = 6, step: float = 1e-3) -> tuple[np.ndarray, np.ndarray]:
        """The stationary point near q, and the eigenvalues of the Hessian of the Lagrangian along the constraints there, in
        ``EI/L`` per square of a turn."""
        n, q = self.size, np.array(q)
        i, j = np.triu_indices(n)
        e = np.eye(n) * self.scale[:, None] * step
        for _ in range(steps):
            (Ep, cp), (Em, cm) = self.parts(q + e), self.parts(q - e)
            g, A = (Ep - Em) / (2 * step), ((cp - cm) / (2 * step)).T
            multipliers = -np.linalg.lstsq(A.T, g, rcond=None)[0]
            values = []
            for a, b in ((1, 1), (1, -1), (-1, 1), (-1, -1)):
                E, c = self.parts(q + a * e[i] + b * e[j])
                values.append(E + c @ multipliers)
            H = np.zeros((n, n))
            H[i, j] = (values[0] - values[1] - values[2] + values[3]) / (4 * step**2)
            H = H + np.triu(H, 1).T
            c = self.parts(q[None])[1][0]
            KKT = np.block([[H, A.T], [A, np.zeros((len(A), len(A)))]])
            size = np.abs(H).max()
            KKT[:n, n:] *= size
            KKT[n:, :n] *= size
            move = np.linalg.lstsq(KKT, -np.concatenate([g + A.T @ multipliers, size * c]), rcond=1e-10)[0][:n]
            q = q + move * self.scale
            if np.abs(move).max() < 1e-6:
                break
        free = np.linalg.svd(A)[2][len(A) :].T
        return q, np.linalg.eigvalsh(free.T @ H @ free) / self.unit
