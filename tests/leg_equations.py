"""Rods that hold one platform, by the equations of ``rod_equations``: joints, balance, and the equilibrium nearby."""

import numpy as np
from rod_equations import RodEquations
from scipy.spatial.transform import Rotation

PERTURBATION = 1e-4
# of differences of fourth order: rounding and what is left of shorter or simpler ones mislead Newton's method on stiff legs
MOVES = PERTURBATION * np.array([1.0, -1.0, 2.0, -2.0])
PARTS = np.array([8.0, -8.0, -1.0, 1.0]) / (12 * PERTURBATION)
NEARBY = 0.01  # lengths, and radians, that the platform may move


class LegEquations:
    """Legs (section lists) from ``base`` to ``platform`` poses (leg, 4, 4), a dead force and moment at the platform's origin.

    ``joints`` name the kind of each leg's joint, all clamped by default; ``axes`` are those of revolute ones, in the attachment's
    frame.
    """

    def __init__(self, rods, loads, joints=None, axes=None):
        self.joints = ["clamped"] * len(rods) if joints is None else joints
        self.axes = np.tile([0.0, 0.0, 1.0], (len(rods), 1)) if axes is None else axes
        self.legs = [RodEquations(sections, {}) for sections in rods]
        self.base, self.platform = loads["base"], loads["platform"]
        self.force, self.moment = loads["tip_force"], loads["tip_moment"]
        self.length = np.mean([leg.length for leg in self.legs])
        self.units = [np.repeat([leg.K[0, 0] / leg.length**2, leg.K[0, 0] / leg.length], 3) for leg in self.legs]

    def tips(self, wrenches):
        """Tip states (leg, case, 18) from base forces and moments (leg, case, 6) in the world."""
        result = []
        for leg, pose, values in zip(self.legs, self.base, wrenches, strict=True):
            count = len(values)
            start = np.concatenate([pose[:3, 3], pose[:3, :3].ravel()])
            y = np.hstack([np.tile(start, (count, 1)), values])
            result.append(leg.carry(np.zeros(count), np.full(count, leg.length), y, rtol=1e-12))
        return np.array(result)

    def gaps(self, tips, p, R):
        """What joints and platform lack, dimensionless: six a leg, then force and moment."""
        lacks, force, moment = [], -self.force, -self.moment
        for tip, A, joint, axis, leg in zip(tips, self.platform, self.joints, self.axes, self.units, strict=True):
            arm, frame, tip_frame = R @ A[:3, 3], R @ A[:3, :3], tip[3:12].reshape(3, 3)
            lacks.append((tip[:3] - p - arm) / self.length)
            if joint == "clamped":
                lacks.append(Rotation.from_matrix(frame.T @ tip_frame).as_rotvec())
            elif joint == "spherical":
                lacks.append(tip[15:] / leg[3:])
            else:  # the axis is one of both bodies, and no moment acts about it
                across = np.linalg.svd(axis[None])[2][1:]
                lacks.append(np.append(across @ (frame.T @ tip_frame @ axis), axis @ (tip_frame.T @ tip[15:]) / leg[3]))
            force = force + tip[12:15]
            moment = moment + tip[15:] + np.cross(arm, tip[12:15])
        unit = sum(self.units)
        return np.concatenate([*lacks, force / unit[:3], moment / unit[3:]])

    def solve(self, wrenches, p, R):
        """Newton's method from base wrenches (leg, 6) and the platform's pose: its pose, and the first gaps; None if it fails."""
        wrenches, first = np.array(wrenches), None
        legs, unit = len(self.legs), np.array(self.units)
        for _ in range(8):
            steps = unit[:, None] * np.concatenate([move * np.eye(6) for move in MOVES])
            cases = np.concatenate([wrenches[:, None], wrenches[:, None] + steps], axis=1)
            tips = self.tips(cases)
            gap = self.gaps(tips[:, 0], p, R)
            first = gap if first is None else first
            J = np.zeros((len(gap), len(gap)))
            for side, (move, part) in enumerate(zip(MOVES, PARTS, strict=True)):
                for k in range(legs):
                    for j in range(6):
                        varied = tips[:, 0].copy()
                        varied[k] = tips[k, 1 + 6 * side + j]
                        J[:, 6 * k + j] += part * self.gaps(varied, p, R)
                for j in range(3):
                    e = move * np.eye(3)[j]
                    J[:, 6 * legs + j] += part * self.gaps(tips[:, 0], p + e * self.length, R)
                    J[:, 6 * legs + 3 + j] += part * self.gaps(tips[:, 0], p, Rotation.from_rotvec(e).as_matrix() @ R)
            step = -np.linalg.solve(J, gap)
            if not np.abs(step[-6:]).max() < NEARBY:
                return None
            wrenches = wrenches + step[: 6 * legs].reshape(legs, 6) * unit
            p = p + step[-6:-3] * self.length
            R = Rotation.from_rotvec(step[-3:]).as_matrix() @ R
            if np.abs(step[-6:]).max() < 1e-7:  # gaps are what rounding makes of them at the far end of strongly loaded legs
                return p, R, first
        return None
