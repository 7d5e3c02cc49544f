"""Rods on nodes that creep through a viscous medium to where they come to rest: an independent witness of what snaps lead to.

A rod without mass, clamped at its base, whose places are held back in proportion to their velocity. Nothing of the package is
used: unknown are the rotations of the nodes, tangents are averaged over segments.
"""

import numpy as np


def cross_matrix(a: np.ndarray) -> np.ndarray:
    """[a]x of vectors (..., 3)."""
    result = np.zeros((*a.shape, 3))
    result[..., 0, 1], result[..., 0, 2], result[..., 1, 2] = -a[..., 2], a[..., 1], -a[..., 0]
    return result - np.swapaxes(result, -1, -2)


def rotation(vector: np.ndarray) -> np.ndarray:
    """Rotation matrices of vectors (..., 3)."""
    angle = np.linalg.norm(vector, axis=-1)[..., None, None]
    K = cross_matrix(vector)
    return np.eye(3) + np.sinc(angle / np.pi) * K + 0.5 * np.sinc(angle / (2 * np.pi)) ** 2 * K @ K


def vector_of(R: np.ndarray) -> np.ndarray:
    """Vectors of rotation matrices (..., 3, 3), of less than half a turn."""
    axis = np.stack([R[..., 2, 1] - R[..., 1, 2], R[..., 0, 2] - R[..., 2, 0], R[..., 1, 0] - R[..., 0, 1]], -1) / 2
    sine, cosine = np.linalg.norm(axis, axis=-1), (np.trace(R, axis1=-2, axis2=-1) - 1) / 2
    angle = np.arctan2(sine, cosine)
    return axis / np.sinc(angle / np.pi)[..., None]


class CreepingRods:
    """A batch of rods, on ``count`` segments each, under forces on their tips; unloaded at first.

    Args:
        length: Shape (batch,).
        stiffness: ``EI_x, EI_y, GJ``, shape (batch, 3).
        precurvature: Constant, shape (batch, 3).
        count: Segments.
    """

    def __init__(self, length, stiffness, precurvature, count: int = 40) -> None:
        self.h, self.count = length / count, count
        self.K, self.rest = stiffness[:, None], precurvature[:, None]
        step = rotation(self.h[:, None] * precurvature)
        frames = [np.broadcast_to(np.eye(3), step.shape)]
        for _ in range(count):
            frames.append(frames[-1] @ step)
        self.R = np.stack(frames, 1)
        self.weight = np.full(count + 1, 1.0)
        self.weight[[0, -1]] = 0.5
        self.dt = np.full(len(length), 1e-3)

    @property
    def tip(self) -> np.ndarray:
        """Positions of the tips, (batch, 3)."""
        return self.h[:, None] * np.einsum("k,bki->bi", self.weight, self.R[..., 2])

    def energy(self, R: np.ndarray, force: np.ndarray) -> np.ndarray:
        """Potential energy, (batch,)."""
        strain = vector_of(np.swapaxes(R[:, :-1], -1, -2) @ R[:, 1:]) / self.h[:, None, None] - self.rest
        tip = self.h[:, None] * np.einsum("k,bki->bi", self.weight, R[..., 2])
        return self.h * (strain**2 * self.K).sum((1, 2)) / 2 - (tip * force).sum(1)

    def _forces(self, force: np.ndarray):
        """Gradient by the nodes' rotations (batch, count, 3), elastic stiffness and drag, (batch, 3 count, 3 count)."""
        batch, n, h = len(self.h), self.count, self.h[:, None, None]
        theta = vector_of(np.swapaxes(self.R[:, :-1], -1, -2) @ self.R[:, 1:])
        angle, X = np.linalg.norm(theta, axis=-1)[..., None, None], cross_matrix(theta)
        half = np.maximum(angle, 1e-6) / 2
        inverse = np.eye(3) + X / 2 + (1 - half / np.tan(half)) / (2 * half) ** 2 * X @ X  # d(theta) by what turns the end
        B = inverse @ np.swapaxes(self.R[:, 1:], -1, -2)
        moment = np.einsum("bkji,bkj->bki", B, self.K * (theta / h - self.rest))
        t, w = self.R[:, 1:, :, 2], h * self.weight[1:, None]
        gradient = moment - w * np.cross(t, force[:, None])
        gradient[:, :-1] -= moment[:, 1:]
        block = np.einsum("bkji,bkj,bkjl->bkil", B, np.broadcast_to(self.K, theta.shape), B) / h[..., None]
        H = np.zeros((batch, n, 3, n, 3))
        places = np.arange(n)
        H[:, places, :, places] += np.moveaxis(block, 1, 0)
        H[:, places[:-1], :, places[:-1]] += np.moveaxis(block[:, 1:], 1, 0)
        H[:, places[:-1], :, places[1:]] -= np.moveaxis(block[:, 1:], 1, 0)
        H[:, places[1:], :, places[:-1]] -= np.moveaxis(block[:, 1:], 1, 0)
        moves = -w[..., None] * cross_matrix(t)  # of all places beyond a node by its rotation
        beyond = n - np.maximum(places[:, None], places[None])
        drag = np.einsum("bkji,kl,bljm->bkilm", moves, beyond * 1.0, moves) * h[..., None, None]
        size = 3 * n
        return gradient, H.reshape(batch, size, size), drag.reshape(batch, size, size)

    def settle(self, force: np.ndarray, tolerance: float = 1e-5, most: int = 2000, reach: float = 0.02) -> np.ndarray:
        """Creep until the moments that are left are less than this part of ``EI/L``; which did, (batch,).

        No place moves by more than ``reach`` of the length in a step, and the energy falls in each.
        """
        length = self.h * self.count
        unit = self.K[:, 0, 0] / length
        done = np.zeros(len(self.h), dtype=bool)
        for _ in range(most):
            gradient, H, drag = self._forces(force)
            done = np.abs(gradient).max((1, 2)) < tolerance * unit
            if done.all():
                break
            scale = unit / length**3  # of the drag: its unit of time is of no importance
            damping = drag * scale[:, None, None] + 1e-6 * unit[:, None, None] * np.eye(H.shape[-1])
            turn = -np.linalg.solve(damping / self.dt[:, None, None] + H, gradient.reshape(len(H), -1, 1))
            turn = turn.reshape(gradient.shape)
            R = np.array(self.R)
            R[:, 1:] = rotation(turn) @ R[:, 1:]
            places = np.cumsum(self.weight[:, None] * (R - self.R)[..., 2], 1)
            moved = self.h * np.linalg.norm(places, axis=-1).max(1) / length
            good = ~done & (moved < reach) & (self.energy(R, force) <= self.energy(self.R, force) + 1e-12 * unit)
            self.R[good] = R[good]
            self.dt = np.where(done, self.dt, np.where(good, 1.5, 0.3) * self.dt)
        return done


class CreepingArch:
    """A rod in a plane on ``count`` links, clamped at both ends along x, ``span`` apart, under a force per length along y.

    Unknown are the angles of the links; links are held back in proportion to how fast they turn.
    """

    def __init__(self, length: float, bending: float, span: float, count: int = 60) -> None:
        self.h, self.bending, self.span = length / count, bending, span
        s = (np.arange(count) + 0.5) / count
        self.angle = 1e-3 * np.sin(2 * np.pi * s)
        self.pull = np.zeros(2)

    @property
    def middle(self) -> float:
        """How far its middle is aside."""
        return float(self.h * np.sin(self.angle[: len(self.angle) // 2]).sum())

    def settle(self, load: float, steps: int = 3000) -> bool:
        """Creep until nothing moves; whether it came to rest."""
        n, h = len(self.angle), self.h
        K = 2 * np.eye(n) - np.eye(n, k=1) - np.eye(n, k=-1)
        K[0, 0] = K[-1, -1] = 3.0  # half a link to each clamp
        K *= self.bending / h
        beyond = h * load * h * (n - np.arange(n) - 0.5)  # what acts on the nodes beyond a link turns it
        dt = 1e-2 / self.bending
        for _ in range(steps):
            c, s = np.cos(self.angle), np.sin(self.angle)
            gap = np.array([h * c.sum() - self.span, h * s.sum()])
            J = h * np.stack([-s, c])
            g = K @ self.angle - beyond * c
            H = K + np.diag(beyond * s - h * (c * self.pull[0] + s * self.pull[1]))
            A = np.block([[H + h * np.eye(n) / dt, J.T], [J, np.zeros((2, 2))]])
            move = np.linalg.solve(A, -np.concatenate([g, gap]))
            turn, pull = move[:n], move[n:]
            size = np.abs(turn).max()
            if size > 0.05:
                dt *= 0.5
                if dt > 1e-9:
                    continue
            self.angle, self.pull = self.angle + turn, pull
            if size < 1e-9 and dt > 1e2 / self.bending:
                return True
            dt = min(1.5 * dt, 1e6 / self.bending)
        return False
