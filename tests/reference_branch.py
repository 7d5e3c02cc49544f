"""The natural branch of one rod in small steps: states at many nodes, the equations of ``rod_equations`` between them by RK4.

Nothing of the package is used, and nothing is integrated further than one short interval.
"""

import numpy as np
from rod_equations import RodEquations
from scipy.linalg import lapack
from scipy.spatial.transform import Rotation

LOWER, UPPER = 11, 14  # of the band: nine equations between two nodes of nine numbers, after three at the base
STEP = 1e-6  # of differences
MOVE, SURPRISE = 0.4, 0.08  # radians that a frame may turn in a step, and of these past where the last two steps lead
SHORTEST = 1e-5  # step of the load


class ReferenceBranch:
    """Equilibria of one rod along its natural branch, in units of its length and softest bending stiffness."""

    def __init__(self, sections, loads, intervals):
        self.rod = RodEquations(sections, loads)
        self.force_unit = self.rod.K[:, :2].min() / self.rod.length**2
        self.moment_unit = self.force_unit * self.rod.length
        starts = np.concatenate([[0.0], self.rod.end[:-1]])
        edges = [
            np.linspace(a, b, max(1, int(np.ceil(intervals * (b - a) / self.rod.length))) + 1)
            for a, b in zip(starts, self.rod.end, strict=True)
        ]
        self.s = np.concatenate([edges[0], *(e[1:] for e in edges[1:])])
        self.k = np.concatenate([np.full(len(e) - 1, j) for j, e in enumerate(edges)])
        self.h = np.diff(self.s)
        self.loads = dict(self.rod.loads)
        self.f = self.rod.f

    def raise_loads(self, factor):
        self.rod.loads = {name: factor * value for name, value in self.loads.items()}
        self.rod.f = factor * self.f

    def flow(self, y):
        """Ends of all intervals from states (interval, case, 18) at their starts."""
        shape = y.shape
        k = np.repeat(self.k, shape[1])
        h = np.repeat(self.h, shape[1])[:, None]
        y = y.reshape(-1, 18)
        a = self.rod.rate(y, k)
        b = self.rod.rate(y + h / 2 * a, k)
        c = self.rod.rate(y + h / 2 * b, k)
        d = self.rod.rate(y + h * c, k)
        return (y + h / 6 * (a + 2 * b + 2 * c + d)).reshape(shape)

    def changed(self, y, delta):
        """States whose frame turns by ``delta[..., :3]`` (in the world), force and moment by the rest, in units."""
        y = y.copy()
        turn = Rotation.from_rotvec(delta[..., :3].reshape(-1, 3)).as_matrix().reshape(*delta.shape[:-1], 3, 3)
        y[..., 3:12] = (turn @ y[..., 3:12].reshape(*y.shape[:-1], 3, 3)).reshape(*y.shape[:-1], 9)
        y[..., 12:15] += delta[..., 3:6] * self.force_unit
        y[..., 15:] += delta[..., 6:] * self.moment_unit
        return y

    def difference(self, y, z):
        """The change that leads from ``z`` to ``y``, to first order in what they differ by (turned by the frame's skew part)."""
        R, Q = (a[..., 3:12].reshape(*a.shape[:-1], 3, 3) for a in (y, z))
        D = R @ np.swapaxes(Q, -1, -2)
        turn = np.stack([D[..., 2, 1] - D[..., 1, 2], D[..., 0, 2] - D[..., 2, 0], D[..., 1, 0] - D[..., 0, 1]], axis=-1) / 2
        force, moment = (y[..., 12:15] - z[..., 12:15]) / self.force_unit, (y[..., 15:] - z[..., 15:]) / self.moment_unit
        return np.concatenate([turn, force, moment], axis=-1)

    def tip(self, y):
        load, R = self.rod.load, y[..., 3:12].reshape(*y.shape[:-1], 3, 3)
        n = y[..., 12:15] - load("tip_force") - R @ load("follower_force")
        m = y[..., 15:] - load("tip_moment") - R @ load("follower_moment")
        return np.concatenate([n / self.force_unit, m / self.moment_unit], axis=-1)

    def residual(self, y):
        """Gaps (9 N + 9,): base, intervals, tip; and their derivative as a band."""
        count = len(self.h)
        variations = np.concatenate([np.zeros((1, 9)), STEP * np.eye(9), -STEP * np.eye(9)])
        varied = self.changed(np.repeat(y[:, None], 19, axis=1), np.broadcast_to(variations, (count + 1, 19, 9)))
        ends = self.difference(self.flow(varied[:-1]), np.repeat(y[1:, None], 19, axis=1))
        tips = self.tip(varied[-1])
        gap = np.concatenate([np.zeros(3), ends[:, 0].ravel(), tips[0]])
        band = np.zeros((2 * LOWER + UPPER + 1, 9 * count + 9))  # dgbtrf wants LOWER rows more
        middle = LOWER + UPPER
        band[middle, :3] = 1.0
        by_start = np.swapaxes(ends[:, 1:10] - ends[:, 10:], 1, 2) / (2 * STEP)
        by_tip = (tips[1:10] - tips[10:]).T / (2 * STEP)
        column = 9 * np.arange(count)
        for i in range(9):
            band[middle - 6, column + 9 + i] = -1.0  # exact where there is no gap
            for j in range(9):
                band[middle + 3 + i - j, column + j] = by_start[:, i, j]
        for i in range(6):
            for j in range(9):
                band[middle + 3 + i - j, 9 * count + j] = by_tip[i, j]
        return gap, band

    def newton(self, y):
        """The equilibrium near ``y``, and the sign of the Jacobian's determinant; None if five steps do not reach it."""
        before = np.inf
        for _ in range(6):
            gap, band = self.residual(y)
            lu, pivots, fault = lapack.dgbtrf(band, LOWER, UPPER)
            if fault:
                return None
            step = lapack.dgbtrs(lu, LOWER, UPPER, -gap, pivots)[0].reshape(-1, 9)
            turn = np.abs(step[:, :3]).max()
            if not turn < min(before, 0.5):
                return None
            y = self.changed(y, step)
            if turn < 1e-7:
                swaps = np.count_nonzero(pivots != np.arange(len(pivots)))
                return y, int(np.prod(np.sign(lu[LOWER + UPPER]))) * (-1) ** swaps
            before = 0.7 * turn
        return None

    def unloaded(self):
        """The stress-free rod."""
        y = np.zeros((len(self.s), 18))
        R = np.eye(3)
        y[0, 3:12] = R.ravel()
        for k in range(len(self.h)):
            R = R @ Rotation.from_rotvec(self.rod.u_star[self.k[k]] * self.h[k]).as_matrix()
            y[k + 1, 3:12] = R.ravel()
        return y

    def follow(self, first_step, most=400):
        """Shape (node, 18) at the full load, or None and the part of the load at which the branch is lost."""
        self.raise_loads(0.0)
        start = self.newton(self.unloaded())
        if start is None:
            return None, 0.0
        y, sign = start
        level, step, slope = 0.0, min(1.0, first_step), None
        for _ in range(most):
            goal = min(1.0, level + step)
            guess = y if slope is None else self.changed(y, (goal - level) * slope)
            self.raise_loads(goal)
            found = self.newton(guess)
            if found is not None and found[1] == sign:
                moved, off = self.difference(found[0], y), self.difference(found[0], guess)
                small = np.abs(moved[:, :3]).max() < MOVE
                if small and (slope is None or np.abs(off[:, :3]).max() < SURPRISE):
                    slope = moved / (goal - level)
                    y, level = found[0], goal
                    if level == 1.0:
                        return self.with_positions(y), 1.0
                    step *= 1.5
                    continue
            step /= 2
            if step < SHORTEST * max(level, first_step):
                break
        return None, level

    def near(self, shape):
        """The equilibrium at the full load that Newton's method finds from a shape, or None."""
        self.raise_loads(1.0)
        rod = self.rod
        y = rod.states(shape)
        k = np.clip(np.searchsorted(shape.arclength, self.s, side="right") - 1, 0, len(y) - 1)
        s = np.minimum(shape.arclength[k], self.s)
        start = rod.carry(s, self.s, y[k], rtol=1e-9)
        start[0, 3:12] = np.eye(3).ravel()
        found = self.newton(start)
        return None if found is None else self.with_positions(found[0])

    def with_positions(self, y):
        """The shape, its positions summed up."""
        y = y.copy()
        y[:, :3] = 0.0
        ends = self.flow(y[:-1, None])[:, 0, :3]
        y[1:, :3] = np.cumsum(ends, axis=0)
        return y
