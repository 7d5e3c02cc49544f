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
LONGEST = 0.05  # step of creeping [rad]
BOTH = ((1, 1), (1, -1), (-1, 1), (-1, -1))


@dataclass
class Leg:
    """One rod of constant section from ``base`` to ``attachment``, both (4, 4): frames (node, 3, 3) and stretches of its nodes.

    ``axial`` is None of what does not stretch. ``rest`` is one, or of each segment. ``moment`` is a dead one on a tip that turns
    about one axis alone, ``load`` what dead forces along it do work on, by where each node points, (node, 3).
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
        self.load, self.moment = np.zeros((self.count + 1, 3)), np.zeros(3)

    def carry(self, force: np.ndarray) -> None:
        """Dead forces per length on all segments, (segment, 3), half of each on either end."""
        half = 0.5 * np.broadcast_to(self.h, self.count)[:, None]
        own = np.append(half * force, np.zeros((1, 3)), axis=0) + np.append(np.zeros((1, 3)), half * force, axis=0)
        beyond = half * np.cumsum(own[:0:-1], axis=0)[::-1]  # a segment moves all nodes behind it
        self.load = np.append(beyond, np.zeros((1, 3)), axis=0) + np.append(np.zeros((1, 3)), beyond, axis=0)

    @property
    def size(self) -> int:
        return 3 * self.count + (0 if self.axial is None else self.count + 1)

    def tip(self) -> np.ndarray:
        return self.base[:3, 3] + (self.weight * (1 + self.stretch)) @ self.frames[..., 2]

    @property
    def variables(self) -> np.ndarray:
        """Which unknowns of the leg the energy of each segment is a function of, -1 of what is held, (segment, 6)."""
        start = 3 * np.arange(-1, self.count)[:, None] + np.arange(3)
        start[0] = -1
        return np.concatenate([start[:-1], start[1:]], axis=1)

    def curved(self, turns: np.ndarray) -> np.ndarray:
        """Curvature of all segments, their nodes turned by (..., segment, 6)."""
        start, end = rotation(turns[..., :3]) @ self.frames[:-1], rotation(turns[..., 3:6]) @ self.frames[1:]
        return vector_of(np.swapaxes(start, -1, -2) @ end) / np.reshape(self.h, (-1, 1))

    def bent(self, turns: np.ndarray) -> np.ndarray:
        """Energies of all segments, (..., segment)."""
        return 0.5 * self.h * ((self.curved(turns) - self.rest) ** 2 * self.stiffness).sum(axis=-1)

    def gap(self, platform: np.ndarray, turns: np.ndarray) -> np.ndarray:
        """What the joint lacks, platform and tip turned by (..., 6)."""
        if self.joint == "spherical":
            return np.zeros((*turns.shape[:-1], 0))
        frame = rotation(turns[..., :3]) @ platform @ self.attachment[:3, :3]
        M = np.swapaxes(frame, -1, -2) @ rotation(turns[..., 3:]) @ self.frames[-1]
        if self.joint == "clamped":
            return 0.5 * np.stack(
                [M[..., 2, 1] - M[..., 1, 2], M[..., 0, 2] - M[..., 2, 0], M[..., 1, 0] - M[..., 0, 1]], axis=-1
            )
        return (self.across @ M) @ self.axis

    def move(self, step: np.ndarray) -> None:
        """Change all unknowns."""
        self.frames[1:] = rotation(step[: 3 * self.count].reshape(-1, 3)) @ self.frames[1:]
        if self.axial is not None:
            self.stretch = self.stretch + step[3 * self.count : self.size]


def differences(function, shape, count=6):
    """Value, gradient (..., count) and second derivative (..., count, count) at 0 of a function of ``shape + (count,)`` numbers,
    which takes any axes before these."""
    units = STEP * np.eye(count)
    i, j = np.tril_indices(count, -1)
    moves = [np.zeros((1, count)), units, -units, 2 * units, -2 * units, *(s * units[i] + t * units[j] for s, t in BOTH)]
    moves = np.concatenate(moves)
    found = function(np.broadcast_to(moves.reshape(-1, *(1,) * len(shape), count), (len(moves), *shape, count)))
    value, a, b, c, d, *mixed = np.split(found, [1, *(1 + count * np.arange(1, 5)), *(1 + 4 * count + len(i) * np.arange(1, 4))])
    second = np.zeros((*value.shape[1:], count, count))
    places = np.arange(count)
    second[..., places, places] = np.moveaxis((16 * (a + b) - (c + d) - 30 * value) / (12 * STEP**2), 0, -1)
    across = sum(s * t * m for (s, t), m in zip(BOTH, mixed, strict=True)) / (4 * STEP**2)
    second[..., i, j] = second[..., j, i] = np.moveaxis(across, 0, -1)
    return value[0], np.moveaxis((8 * (a - b) - (c - d)) / (12 * STEP), 0, -1), second


def turned_twice(force: np.ndarray, arm: np.ndarray) -> np.ndarray:
    """Second derivative of the work of a force on an arm by how it is turned, both (..., 3)."""
    outer = force[..., :, None] * arm[..., None, :]
    return 0.5 * (outer + np.swapaxes(outer, -1, -2)) - (force * arm).sum(-1)[..., None, None] * np.eye(3)


class LegEnergy:
    """Legs on a platform at ``position``, ``turn`` (3, 3), under a dead ``force`` at its origin; or ``held`` there.

    ``moment`` is one that keeps its direction, which has no potential; ``slide`` a direction in which what is held is free.
    """

    def __init__(self, legs: list[Leg], position: np.ndarray, turn: np.ndarray, force: np.ndarray, held: bool = False) -> None:
        self.slide: np.ndarray | None = None
        self.legs, self.position, self.turn, self.force, self.held = legs, position, turn, force, held
        self.moment = np.zeros(3)
        self.first = np.cumsum([0] + [leg.size for leg in legs])
        self.pull: np.ndarray | None = None  # of all constraints

    def system(self):
        """Gradient of the energy (n,), constraints (m,), their derivatives (m, n), and the Hessian for the forces ``pull``."""
        n = self.first[-1] + 6
        gradient, H, rows, gaps = np.zeros(n), np.zeros((n, n)), [], []
        gradient[-6:-3], gradient[-3:] = -self.force, -self.moment
        H[-3:, -3:] = -0.5 * cross_matrix(self.moment)  # gradients are by turns of what has been turned
        parts = []
        for leg, first in zip(self.legs, self.first, strict=False):
            N = leg.count
            variables = leg.variables
            _, slope, second = differences(leg.bent, (N,), variables.shape[1])
            for k in range(N):
                kept = np.flatnonzero(variables[k] >= 0)
                ids = first + variables[k, kept]
                gradient[ids] += slope[k, kept]
                H[np.ix_(ids, ids)] += second[k][np.ix_(kept, kept)]
            points, stretched = leg.frames[..., 2], 1 + leg.stretch
            gradient[first : first + 3 * N] -= (stretched[1:, None] * np.cross(points[1:], leg.load[1:])).ravel()
            gradient[first + 3 * (N - 1) : first + 3 * N] -= leg.moment
            arm = self.turn @ leg.attachment[:3, 3]
            J = np.zeros((3, n))
            weight = leg.weight * (1 + leg.stretch)
            J[:, first : first + 3 * N] = -np.concatenate(weight[1:, None, None] * cross_matrix(leg.frames[1:, :, 2]), axis=1)
            own = first + 3 * N + np.arange(N + 1)
            if leg.axial is not None:
                J[:, own] = (leg.weight[:, None] * leg.frames[..., 2]).T
                gradient[own] = leg.axial * leg.weight * leg.stretch - (leg.load * points).sum(axis=1)
                H[own, own] = leg.axial * leg.weight
            J[:, -6:-3], J[:, -3:] = -np.eye(3), cross_matrix(arm)
            joint = np.zeros((0, n))
            gap = leg.gap(self.turn, np.zeros(6))
            if len(gap):
                _, by, _ = differences(lambda t, leg=leg: leg.gap(self.turn, t), ())
                joint = np.zeros((len(gap), n))
                joint[:, -3:], joint[:, first + 3 * (N - 1) : first + 3 * N] = by[:, :3], by[:, 3:]
            parts.append((leg, first, own, arm))
            rows += [J, joint]
            gaps += [leg.tip() - self.position - arm, gap]
        if self.held:
            fixed = np.eye(6) if self.slide is None else np.delete(np.eye(6), 2, axis=0)
            if self.slide is not None:
                fixed[:2, :3] = np.linalg.svd(self.slide[None])[2][1:]
            rows.append(np.pad(fixed, ((0, 0), (n - 6, 0))))
            gaps.append(np.zeros(len(fixed)))
        C = np.concatenate(rows)
        if self.pull is None:
            self.pull = np.linalg.lstsq(C.T, gradient, rcond=None)[0]
        at = 0
        for leg, first, own, arm in parts:
            N, held = leg.count, len(leg.gap(self.turn, np.zeros(6)))
            pull, twist = self.pull[at : at + 3], self.pull[at + 3 : at + 3 + held]
            at += 3 + held
            pulls = pull * leg.weight[:, None] + leg.load
            bends = turned_twice(pulls[1:], leg.frames[1:, :, 2]) * (1 + leg.stretch[1:, None, None])
            for k in range(N):
                ids = first + 3 * k + np.arange(3)
                H[np.ix_(ids, ids)] -= bends[k]
                if leg.axial is not None:
                    mixed = np.cross(leg.frames[k + 1, :, 2], pulls[k + 1])
                    H[ids, own[k + 1]] -= mixed
                    H[own[k + 1], ids] -= mixed
            H[-3:, -3:] += turned_twice(pull, arm)
            if held:
                ids = np.concatenate([n + np.arange(-3, 0), first + 3 * (N - 1) + np.arange(3)])
                twisted = differences(lambda t, leg=leg, w=twist: leg.gap(self.turn, t) @ w, ())[2]
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
            self._move(share * move)
            if size < 1e-7:
                break
        return float(size)

    def _move(self, step: np.ndarray) -> None:
        for leg, first in zip(self.legs, self.first, strict=False):
            leg.move(step[first : first + leg.size])
        self.position = self.position + step[-6:-3]
        self.turn = rotation(step[-3:]) @ self.turn

    def creep(self, most: int = 600) -> bool:
        """Down in energy, held back in proportion to how fast everything moves, in short steps, until nothing does; whether it
        came to rest at a minimum."""
        drag = np.full(self.first[-1] + 6, 1 / self.legs[0].count)
        drag[-6:] = 1.0
        dt = 1e-3
        for _ in range(most):
            gradient, gap, C, H = self.system()
            q, r = np.linalg.qr(C.T, mode="complete")
            m = len(gap)
            self.pull = np.linalg.solve(r[:m], q[:, :m].T @ gradient)
            back = q[:, :m] @ np.linalg.solve(r[:m].T, -gap)
            Z = q[:, m:]
            reduced, held = Z.T @ H @ Z, (Z.T * drag) @ Z
            slope = Z.T @ (gradient + H @ back)
            lowest = float(np.linalg.eigvalsh(reduced)[0])
            while True:
                if lowest < 0:
                    dt = min(dt, 0.5 * drag.min() / -lowest)
                move = back - Z @ np.linalg.solve(held / dt + reduced, slope)
                size = float(np.abs(move).max())
                if size <= LONGEST or dt < 1e-12:
                    break
                dt *= 0.5
            self._move(min(1.0, LONGEST / size) * move)
            if size < 1e-8 and lowest > 0 and dt > 1e3:
                return True
            dt = min(1.5 * dt, 1e6)
        return False

    def modes(self) -> np.ndarray:
        """Eigenvalues of the second variation among what the joints allow, the lowest first."""
        _, _, C, H = self.system()
        _, s, v = np.linalg.svd(C)
        Z = v[int((s > 1e-9 * s[0]).sum()) :].T
        form = Z.T @ H @ Z
        return np.sort(np.linalg.eigvals(form).real) if self.moment.any() else np.linalg.eigvalsh(form)

    def lowest(self) -> float:
        """The first of them."""
        return float(self.modes()[0])
