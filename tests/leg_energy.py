"""The potential energy of legs on segments that hold a platform, and its second variation: an independent witness of stability.

Unknown are the rotations and stretches of the legs' nodes and the platform's pose, held together by the joints. Nothing of the
package is used; derivatives of the elastic energy and of joints are differences. Lengths are over the mean leg's, energies over
``EI/L``.
"""

from dataclasses import dataclass

import numpy as np
from relaxation import cross_matrix, rotation, vector_of

STEP = 1e-3  # of second differences [rad]
NEWTON_STEPS = 12
BOTH = ((1, 1), (1, -1), (-1, 1), (-1, -1))


@dataclass
class Leg:
    """One rod of constant section from ``base`` to ``attachment``, both (4, 4): frames (node, 3, 3) and stretches of its nodes.

    ``axial`` is None of what does not stretch.
    """

    length: float
    stiffness: np.ndarray
    axial: float | None
    rest: np.ndarray
    base: np.ndarray
    attachment: np.ndarray
    joint: str
    axis: np.ndarray
    frames: np.ndarray
    stretch: np.ndarray

    def __post_init__(self) -> None:
        self.count = len(self.frames) - 1
        self.h = self.length / self.count
        self.weight = np.full(self.count + 1, self.h)
        self.weight[[0, -1]] *= 0.5
        self.across = np.eye(3) if self.joint == "clamped" else np.linalg.svd(self.axis[None])[2][1:]

    @property
    def size(self) -> int:
        return 3 * self.count + (0 if self.axial is None else self.count + 1)

    def tip(self) -> np.ndarray:
        return self.base[:3, 3] + (self.weight * (1 + self.stretch)) @ self.frames[..., 2]

    def bent(self, turns: np.ndarray) -> np.ndarray:
        """Energies of all segments, their nodes turned by (segment, 6)."""
        start, end = rotation(turns[:, :3]) @ self.frames[:-1], rotation(turns[:, 3:]) @ self.frames[1:]
        strain = vector_of(np.swapaxes(start, 1, 2) @ end) / self.h - self.rest
        return 0.5 * self.h * (strain**2 * self.stiffness).sum(axis=1)

    def gap(self, platform: np.ndarray, turns: np.ndarray) -> np.ndarray:
        """What the joint lacks, platform and tip turned by (6,)."""
        if self.joint == "spherical":
            return np.zeros(0)
        frame = rotation(turns[:3]) @ platform @ self.attachment[:3, :3]
        M = frame.T @ rotation(turns[3:]) @ self.frames[-1]
        if self.joint == "clamped":
            return 0.5 * np.array([M[2, 1] - M[1, 2], M[0, 2] - M[2, 0], M[1, 0] - M[0, 1]])
        return self.across @ M @ self.axis


def differences(function, shape):
    """Value, gradient (..., 6) and second derivative (..., 6, 6) at 0 of a function of ``shape + (6,)`` numbers."""
    units = STEP * np.eye(6)

    def at(move):
        return function(np.broadcast_to(move, (*shape, 6)))

    value = at(np.zeros(6))
    sides = [(at(unit), at(-unit), at(2 * unit), at(-2 * unit)) for unit in units]
    gradient = np.stack([(8 * (a - b) - (c - d)) / (12 * STEP) for a, b, c, d in sides], -1)
    second = np.zeros((*np.shape(value), 6, 6))
    for i in range(6):
        a, b, c, d = sides[i]
        second[..., i, i] = (16 * (a + b) - (c + d) - 30 * value) / (12 * STEP**2)
        for j in range(i):
            mixed = sum(s * t * at(s * units[i] + t * units[j]) for s, t in BOTH) / (4 * STEP**2)
            second[..., i, j] = second[..., j, i] = mixed
    return value, gradient, second


def turned_twice(force: np.ndarray, arm: np.ndarray) -> np.ndarray:
    """Second derivative of the work of a force on an arm by how it is turned, both (..., 3)."""
    outer = force[..., :, None] * arm[..., None, :]
    return 0.5 * (outer + np.swapaxes(outer, -1, -2)) - (force * arm).sum(-1)[..., None, None] * np.eye(3)


class LegEnergy:
    """Legs on a platform at ``position``, ``turn`` (3, 3), under a dead ``force`` at its origin."""

    def __init__(self, legs: list[Leg], position: np.ndarray, turn: np.ndarray, force: np.ndarray) -> None:
        self.legs, self.position, self.turn, self.force = legs, position, turn, force
        self.first = np.cumsum([0] + [leg.size for leg in legs])
        self.pull: np.ndarray | None = None  # of all constraints

    def system(self):
        """Gradient of the energy (n,), constraints (m,), their derivatives (m, n), and the Hessian for the forces ``pull``."""
        n = self.first[-1] + 6
        gradient, H, rows, gaps = np.zeros(n), np.zeros((n, n)), [], []
        gradient[-6:-3] = -self.force
        parts = []
        for leg, first in zip(self.legs, self.first, strict=False):
            N = leg.count
            _, slope, second = differences(leg.bent, (N,))
            for k in range(N):
                ids = np.concatenate([first + 3 * (k - 1) + np.arange(3), first + 3 * k + np.arange(3)])
                kept = slice(3 if k == 0 else 0, 6)
                gradient[ids[kept]] += slope[k, kept]
                H[np.ix_(ids[kept], ids[kept])] += second[k, kept, kept]
            arm = self.turn @ leg.attachment[:3, 3]
            J = np.zeros((3, n))
            weight = leg.weight * (1 + leg.stretch)
            J[:, first : first + 3 * N] = -np.concatenate(weight[1:, None, None] * cross_matrix(leg.frames[1:, :, 2]), axis=1)
            own = first + 3 * N + np.arange(N + 1)
            if leg.axial is not None:
                J[:, own] = (leg.weight[:, None] * leg.frames[..., 2]).T
                gradient[own] = leg.axial * leg.weight * leg.stretch
                H[own, own] = leg.axial * leg.weight
            J[:, -6:-3], J[:, -3:] = -np.eye(3), cross_matrix(arm)
            joint = np.zeros((0, n))
            gap = leg.gap(self.turn, np.zeros(6))
            if len(gap):
                _, by, _ = differences(lambda t, leg=leg: leg.gap(self.turn, t), ())
                joint = np.zeros((len(gap), n))
                joint[:, -3:], joint[:, first + 3 * (N - 1) : first + 3 * N] = by[:, :3], by[:, 3:]
            parts.append((leg, first, own, weight, arm))
            rows += [J, joint]
            gaps += [leg.tip() - self.position - arm, gap]
        C = np.concatenate(rows)
        if self.pull is None:
            self.pull = np.linalg.lstsq(C.T, gradient, rcond=None)[0]
        at = 0
        for leg, first, own, weight, arm in parts:
            N, held = leg.count, len(leg.gap(self.turn, np.zeros(6)))
            pull, twist = self.pull[at : at + 3], self.pull[at + 3 : at + 3 + held]
            at += 3 + held
            bends = turned_twice(np.broadcast_to(pull, (N, 3)), leg.frames[1:, :, 2]) * weight[1:, None, None]
            for k in range(N):
                ids = first + 3 * k + np.arange(3)
                H[np.ix_(ids, ids)] -= bends[k]
                if leg.axial is not None:
                    mixed = leg.weight[k + 1] * np.cross(leg.frames[k + 1, :, 2], pull)
                    H[ids, own[k + 1]] -= mixed
                    H[own[k + 1], ids] -= mixed
            H[-3:, -3:] += turned_twice(pull, arm)
            if held:
                ids = np.concatenate([n + np.arange(-3, 0), first + 3 * (N - 1) + np.arange(3)])
                twisted = differences(lambda t, leg=leg, w=twist: np.asarray(w @ leg.gap(self.turn, t)), ())[2]
                H[np.ix_(ids, ids)] -= twisted
        return gradient, np.concatenate(gaps), C, H

    def settle(self) -> float:
        """Newton's method; what is left of its last step."""
        size = np.inf
        for _ in range(NEWTON_STEPS):
            gradient, gap, C, H = self.system()
            m = len(gap)
            A = np.block([[H, -C.T], [-C, np.zeros((m, m))]])
            step = np.linalg.lstsq(A, -np.concatenate([gradient - C.T @ self.pull, -gap]), rcond=1e-13)[0]
            move, pull = step[:-m], step[-m:]
            size = np.abs(move).max()
            share = min(1.0, 0.3 / size)
            self.pull = self.pull + share * pull
            for leg, first in zip(self.legs, self.first, strict=False):
                turns = share * move[first : first + 3 * leg.count].reshape(-1, 3)
                leg.frames[1:] = rotation(turns) @ leg.frames[1:]
                if leg.axial is not None:
                    leg.stretch = leg.stretch + share * move[first + 3 * leg.count : first + leg.size]
            self.position = self.position + share * move[-6:-3]
            self.turn = rotation(share * move[-3:]) @ self.turn
            if size < 1e-7:
                break
        return float(size)

    def lowest(self) -> float:
        """Lowest eigenvalue of the second variation among what the joints allow."""
        _, _, C, H = self.system()
        _, s, v = np.linalg.svd(C)
        Z = v[int((s > 1e-9 * s[0]).sum()) :].T
        return float(np.linalg.eigvalsh(Z.T @ H @ Z)[0])
