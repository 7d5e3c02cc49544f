"""Rods as sensors see them: poses of the tip and curvatures along one rod under a dead force, their derivatives by differences,
and what these allow at best. Nothing of the package.
"""

import numpy as np
from rod_equations import RodEquations, turned_back
from scipy.spatial.transform import Rotation

STEPS = 50  # of Runge and Kutta's fourth order: 1e-6 m for the rod of these tests, a hundredth of what sensors are off


class MeasuredRod(RodEquations):
    """A rod of one section, clamped at the origin along z, that dead forces (row, 3) pull at its tip."""

    def __init__(self, length, bending_stiffness, torsional_stiffness, precurvature):
        section = {"length": length, "bending_stiffness": bending_stiffness, "torsional_stiffness": torsional_stiffness}
        super().__init__([section | {"precurvature": precurvature}], {})

    def along(self, moment, force, steps=STEPS):
        """States (node, row, 18) from moments at the base, in the world."""
        rows = len(force)
        y = np.concatenate([np.zeros((rows, 3)), np.tile(np.eye(3).ravel(), (rows, 1)), force, moment], axis=1)
        k, h, states = np.zeros(rows, dtype=int), self.length / steps, [y]
        for _ in range(steps):
            a = self.rate(y, k)
            b = self.rate(y + h / 2 * a, k)
            c = self.rate(y + h / 2 * b, k)
            d = self.rate(y + h * c, k)
            y = y + h / 6 * (a + 2 * b + 2 * c + d)
            states.append(y)
        return np.array(states)

    def equilibrium(self, force, moment=None):
        """Moments at the base (row, 3) that leave none at the tip: Newton's method, ``Gamma`` by differences."""
        force = np.asarray(force, float)
        if moment is None:  # raised in steps of a newton
            parts = int(np.ceil(np.abs(force).max()))
            moment = np.zeros(force.shape) if parts < 2 else self.equilibrium(force * (parts - 1) / parts)
        unit = 1e-6 * self.K.max() / self.length
        for _ in range(12):
            shifts = np.concatenate([np.zeros((1, 3)), unit * np.eye(3)])
            tried = (moment[None] + shifts[:, None]).reshape(-1, 3)
            ends = self.along(tried, np.tile(force, (4, 1)))[-1][:, 15:].reshape(4, -1, 3)
            if np.abs(ends[0]).max() < 1e-11 * self.K.max() / self.length:
                return moment
            columns = np.moveaxis(ends[1:] - ends[0], 0, -1) / unit
            moment = moment - np.linalg.solve(columns, ends[0][..., None])[..., 0]
        raise RuntimeError("no equilibrium")

    def seen(self, force, at=(), moment=None):
        """Tip position (row, 3), its rotation (row, 3, 3), and curvatures (row, place, 3) at the nodes numbered ``at``."""
        base = self.equilibrium(force, moment)
        states = self.along(base, np.asarray(force, float))
        R = states[..., 3:12].reshape(*states.shape[:2], 3, 3)
        curvature = self.u_star[0] + turned_back(R, states[..., 15:]) / self.K[0]
        turned = Rotation.from_matrix(R[-1]).as_matrix()  # steps leave it a rotation to 1e-7
        return states[-1, :, :3], turned, np.moveaxis(curvature[list(at)], 0, 1), base

    def information(self, force, *, position=None, angle=None, at=(), curvature=None, components=3):
        """Fisher's information (row, 3, 3) of what sensors with these standard deviations tell of the force."""
        base = self.equilibrium(force)
        rows, h = [], 1e-4
        for k in range(3):
            e = h * np.eye(3)[k]
            ends = [self.seen(force + sign * e, at, base)[:3] for sign in (1, -1)]
            parts = []
            if position:
                parts.append((ends[0][0] - ends[1][0]) / (2 * h * position))
            if angle:
                turn = Rotation.from_matrix(ends[0][1] @ np.swapaxes(ends[1][1], 1, 2)).as_rotvec()
                parts.append(turn / (2 * h * angle))
            if curvature:
                bent = (ends[0][2] - ends[1][2])[..., :components]
                parts.append((bent / (2 * h * curvature)).reshape(len(force), -1))
            rows.append(np.concatenate(parts, axis=1))
        J = np.stack(rows, axis=-1)
        return np.swapaxes(J, 1, 2) @ J


def turned_by(noise):
    """Rotations (row, 3, 3) of rotation vectors (row, 3)."""
    return Rotation.from_rotvec(noise).as_matrix()
