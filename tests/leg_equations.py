"""Rods that hold one platform, by the equations of ``rod_equations``: joints, balance, and the equilibrium nearby."""

import numpy as np
from rod_equations import RodEquations
from scipy.spatial.transform import Rotation

PERTURBATION = 1e-4
# of differences of fourth order: rounding and what is left of shorter or simpler ones mislead Newton's method on stiff legs
MOVES = PERTURBATION * np.array([1.0, -1.0, 2.0, -2.0])
PARTS = np.array([8.0, -8.0, -1.0, 1.0]) / (12 * PERTURBATION)
NEARBY = 0.01  # lengths, and radians, that the platform may move
GROWTH = 2.0  # exponent by which what is wrong where a piece of a leg begins may have grown at its end
ROUNDS = 8


class LegEquations:
    """Legs (section lists) from ``base`` to ``platform`` poses (leg, 4, 4), a dead force and moment at the platform's origin.

    ``joints`` name the kind of each leg's joint, all clamped by default; ``axes`` are those of revolute ones, in the attachment's
    frame. Legs are integrated in pieces, which are unknown where they begin: from the base of a leg that is pulled with some
    hundred ``EI/L^2`` an integration amplifies so much that no differences tell what its tip does.
    """

    def __init__(self, rods, loads, joints=None, axes=None):
        self.joints = ["clamped"] * len(rods) if joints is None else joints
        self.axes = np.tile([0.0, 0.0, 1.0], (len(rods), 1)) if axes is None else axes
        self.legs = [RodEquations(sections, {}) for sections in rods]
        self.base, self.platform = loads["base"], loads["platform"]
        self.force, self.moment = loads["tip_force"], loads["tip_moment"]
        self.length = np.mean([leg.length for leg in self.legs])
        self.units = [np.repeat([leg.K[0, 0] / leg.length**2, leg.K[0, 0] / leg.length], 3) for leg in self.legs]

    def starts(self, solution):
        """States where the pieces of the legs begin, (leg, piece, 18), of a solution."""
        whole = [leg.states(solution.rod(k, nodes=3)) for k, leg in enumerate(self.legs)]
        pulls = [leg.length * np.sqrt(np.linalg.norm(y[0, 12:15]) / leg.K.min()) for leg, y in zip(self.legs, whole, strict=True)]
        count = int(np.ceil(max(pulls) / GROWTH)) + 1
        states = np.array([leg.states(solution.rod(k, nodes=count + 1))[:-1] for k, leg in enumerate(self.legs)])
        states[:, 0, :3] = self.base[:, :3, 3]
        states[:, 0, 3:12] = self.base[:, :3, :3].reshape(-1, 9)
        return states

    def ends(self, starts):
        """States (leg, piece, case, 18) where pieces end that begin at ``starts``, likewise."""
        result = np.empty_like(starts)
        pieces, cases = starts.shape[1:3]
        for own, leg, y in zip(result, self.legs, starts, strict=True):
            edges = np.repeat(np.linspace(0, leg.length, pieces + 1), cases)
            own[:] = leg.carry(edges[:-cases], edges[cases:], y.reshape(-1, 18), rtol=1e-12).reshape(y.shape)
        return result

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

    def breaks(self, ends, starts, unit):
        """What is missing where pieces of one leg meet, (..., 12), dimensionless."""
        frames = (values[..., 3:12].reshape(-1, 3, 3) for values in np.broadcast_arrays(ends, starts))
        end, start = frames
        turn = Rotation.from_matrix(np.swapaxes(start, 1, 2) @ end).as_rotvec()
        apart = ends - starts
        return np.concatenate([apart[..., :3] / self.length, turn.reshape(*apart.shape[:-1], 3), apart[..., 12:] / unit], axis=-1)

    def varied(self, states, moves, unit):
        """States (..., 18) changed by ``moves`` (..., 12): position, turn in the world, force and moment, dimensionless."""
        R = Rotation.from_rotvec(moves[..., 3:6].reshape(-1, 3)).as_matrix().reshape(*moves.shape[:-1], 3, 3)
        frame = states[..., 3:12].reshape(*states.shape[:-1], 3, 3)
        result = np.broadcast_to(states, (*moves.shape[:-1], 18)).copy()
        result[..., :3] += self.length * moves[..., :3]
        result[..., 3:12] = (R @ frame).reshape(*moves.shape[:-1], 9)
        result[..., 12:] += moves[..., 6:] * unit
        return result

    def system(self, starts, p, R):
        """What all that is joined lacks, (n,), and its derivative by how pieces begin, but for poses of bases, and by the
        platform."""
        legs, pieces = starts.shape[:2]
        moves = np.concatenate([np.zeros((1, 12)), *(move * np.eye(12) for move in MOVES)])
        units = np.array(self.units)[:, None, None]
        cases = self.varied(starts[:, :, None], np.broadcast_to(moves, (legs, pieces, *moves.shape)), units)
        ends = self.ends(cases)

        def by_moves(values):
            return np.tensordot(PARTS, values.reshape(4, 12, -1), axes=1).T

        inner = 12 * (pieces - 1)
        size = legs * (6 + inner) + 6
        J, lacks = np.zeros((size, size + 6 * legs)), np.zeros(size)  # with the poses of bases, which are left out in the end
        gaps = self.gaps(ends[:, -1, 0], p, R)
        for k in range(legs):
            first, row = 12 * pieces * k, (6 + inner) * k
            for j in range(pieces - 1):
                rows, column = slice(row + 12 * j, row + 12 * (j + 1)), first + 12 * j
                end, begin = ends[k, j], cases[k, j + 1]
                lacks[rows] = self.breaks(end[0], begin[0], self.units[k])
                J[rows, column : column + 12] = by_moves(self.breaks(end[1:], begin[0], self.units[k]))
                J[rows, column + 12 : column + 24] = by_moves(self.breaks(end[0], begin[1:], self.units[k]))
            tips = ends[:, -1, 0].copy()
            found = []
            for tip in ends[k, -1, 1:]:
                tips[k] = tip
                found.append(self.gaps(tips, p, R))
            by_tip = by_moves(np.array(found))
            own = slice(row + inner, row + inner + 6)
            last = slice(first + 12 * (pieces - 1), first + 12 * pieces)
            lacks[own], J[own, last], J[-6:, last] = gaps[6 * k : 6 * k + 6], by_tip[6 * k : 6 * k + 6], by_tip[-6:]
        lacks[-6:] = gaps[-6:]
        tips, found = ends[:, -1, 0], []
        for move in moves[1:, :6][moves[1:, :6].any(axis=1)]:
            found.append(self.gaps(tips, p + self.length * move[:3], Rotation.from_rotvec(move[3:]).as_matrix() @ R))
        by_platform = np.tensordot(PARTS, np.array(found).reshape(4, 6, -1), axes=1).T
        for k in range(legs):
            row = (6 + inner) * k + inner
            J[row : row + 6, -6:] = by_platform[6 * k : 6 * k + 6]
        J[-6:, -6:] = by_platform[-6:]
        poses = (12 * pieces * np.arange(legs)[:, None] + np.arange(6)).ravel()
        return lacks, np.delete(J, poses, axis=1)

    def solve(self, starts, p, R):
        """Newton's method from where pieces begin (leg, piece, 18) and the platform's pose: its pose, and what was missing at
        first; None if it fails."""
        starts, first = np.array(starts), None
        legs, pieces = starts.shape[:2]
        units = np.array(self.units)[:, None]
        for _ in range(ROUNDS):
            lacks, J = self.system(starts, p, R)
            first = lacks if first is None else first
            step = -np.linalg.solve(J, lacks)
            if not np.abs(step[-6:]).max() < NEARBY:
                return None
            moves = np.zeros((legs, 12 * pieces))
            moves[:, 6:] = step[:-6].reshape(legs, -1)
            starts = self.varied(starts, moves.reshape(legs, pieces, 12), units)
            p = p + step[-6:-3] * self.length
            R = Rotation.from_rotvec(step[-3:]).as_matrix() @ R
            if np.abs(step[-6:]).max() < 1e-7:  # gaps are what rounding makes of them at the far end of strongly loaded legs
                return p, R, first
        return None
