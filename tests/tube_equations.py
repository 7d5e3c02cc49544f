"""The equations of round concentric tubes in world components, shot by SciPy, and the second variation of their energy: nothing
of the package.

A tube is a list of sections as in ``rod_equations``, each equally stiff about both axes; ``alpha`` and ``beta`` are how far it is
turned and pushed out of the plate.
"""

from itertools import pairwise

import numpy as np
from rod_equations import hat, twice_turned
from scipy.integrate import solve_ivp

PERTURBATION = 1e-6


class TubeEquations:
    """World position, rotation of tube 1 and moment of all, ``y = (p, R, m, theta_i, tau_i)``, ``i >= 2``; a dead force on the
    tip."""

    def __init__(self, tubes, alpha, beta, force):
        self.count = len(tubes)
        self.alpha, self.beta, self.force = np.asarray(alpha, float), np.asarray(beta, float), np.asarray(force, float)
        self.sections = []
        for sections, shift in zip(tubes, beta, strict=True):
            ends = np.cumsum([s["length"] for s in sections]) + shift
            self.sections.append(list(zip(ends, sections, strict=True)))
        self.ends = np.array([own[-1][0] for own in self.sections])
        self.length = self.ends.max()
        inside = {end for own in self.sections for end, _ in own if 0 < end < self.length}
        self.breaks = [0.0, *sorted(inside), self.length]
        self.EI = self.at(0.0)[0].sum()
        twists = np.repeat([1.0, self.EI], self.count - 1)
        self.units = np.concatenate([np.full(3, self.length), np.ones(9), np.full(3, self.EI), twists])

    def at(self, s):
        """EI, GJ and precurvature of each tube in the stretch that goes on from ``s``; zero where it has ended."""
        EI, GJ, u_star = np.zeros(self.count), np.zeros(self.count), np.zeros((self.count, 3))
        for i, own in enumerate(self.sections):
            for end, section in own:
                if s < end:
                    EI[i], GJ[i] = section["bending_stiffness"], section["torsional_stiffness"]
                    u_star[i] = section["precurvature"]
                    break
        return EI, GJ, u_star

    def angles(self, torque):
        """Of each tube at the plate, twisted behind it by its torque."""
        result = self.alpha.copy()
        for i, own in enumerate(self.sections):
            start = self.beta[i]
            for end, section in own:
                stop = min(end, 0.0)
                if stop > start:
                    result[i] += (stop - start) * (section["precurvature"][2] + torque[i] / section["torsional_stiffness"])
                    start = stop
        return result

    def split(self, y):
        n = self.count
        theta, tau = np.zeros(n), np.zeros(n)
        R, m = y[3:12].reshape(3, 3), y[12:15]
        theta[1:], tau[1:] = y[15 : 14 + n], y[14 + n :]
        tau[0] = R[:, 2] @ m - tau[1:].sum()
        return R, m, theta, tau

    def curvature(self, y, properties):
        """``u`` of tube 1, the rates of all angles, and the precurvatures turned into its frame."""
        EI, GJ, u_star = properties
        R, m, theta, tau = self.split(y)
        c, s = np.cos(theta), np.sin(theta)
        own = np.stack([c * u_star[:, 0] - s * u_star[:, 1], s * u_star[:, 0] + c * u_star[:, 1]], axis=1)
        u = np.zeros(3)
        u[:2] = ((R.T @ m)[:2] + EI @ own) / EI.sum()
        if GJ[0]:
            u[2] = u_star[0, 2] + tau[0] / GJ[0]
        twist = np.divide(tau, GJ, out=np.zeros_like(tau), where=GJ > 0)
        rate = np.where(GJ > 0, u_star[:, 2] + twist - u[2], 0.0)
        rate[0] = 0.0
        return u, rate, own

    def rate(self, y, properties):
        EI = properties[0]
        u, turning, own = self.curvature(y, properties)
        R = y[3:12].reshape(3, 3)
        torque = EI * (u[0] * own[:, 1] - u[1] * own[:, 0])
        dm = -np.cross(R[:, 2], self.force)
        return np.concatenate([R[:, 2], (R @ hat(u)).ravel(), dm, turning[1:], torque[1:]])

    def start(self, moment, torque):
        """State at the plate from the moment in the world and the torques of tubes 2 to n."""
        all_torques = np.concatenate([[moment[2] - np.sum(torque)], torque])
        angle = self.angles(all_torques)
        c, s = np.cos(angle[0]), np.sin(angle[0])
        R = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1.0]])
        return np.concatenate([np.zeros(3), R.ravel(), moment, angle[1:] - angle[0], torque])

    def integrate(self, y, points=()):
        """Lacks at the tubes' ends, in EI/L, the tip, and the states at ``points``."""
        lacks, states = [], []
        points = np.asarray(points)
        for a, b in pairwise(self.breaks):
            properties = self.at(a)
            inside = points[(points >= a) & (points < b)]
            result = solve_ivp(
                lambda _, y, properties=properties: self.rate(y, properties),
                (a, b),
                y,
                method="DOP853",
                rtol=1e-12,
                atol=1e-13 * self.units,
                t_eval=np.concatenate([inside, [b]]),
            )
            states += list(result.y.T[:-1])
            y = result.y[:, -1]
            tau = self.split(y)[3]
            lacks += [tau[i] for i in range(1, self.count) if self.ends[i] == b]
        lacks += list(y[12:15])
        return np.array(lacks) * self.length / self.EI, y, np.array(states)

    def solve(self, moment, torque):
        """Newton's method from a moment and torques: the state at the plate, the tip, and how far it moved them; None if it
        fails."""
        x = np.concatenate([moment, torque])
        begin, unit = x.copy(), self.EI / self.length
        for _ in range(8):
            lacks, tip, _ = self.integrate(self.start(x[:3], x[3:]))
            if np.abs(lacks).max() < 1e-9:
                return self.start(x[:3], x[3:]), tip, np.abs(x - begin).max() / unit
            columns = []
            for k in range(len(x)):
                e = np.zeros(len(x))
                e[k] = PERTURBATION * unit
                columns.append((self.integrate(self.start(x[:3] + e[:3], x[3:] + e[3:]))[0] - lacks) / e[k])
            x = x - np.linalg.solve(np.transpose(columns), lacks)
        return None

    def index(self, y, elements=60):
        """Negative eigenvalues of the second variation at the solution that starts with ``y``, and the least |one| over the
        largest.

        Unknown are ``phi``, as in ``RodEquations.index``, and the changes of ``theta_i``; at the plate the angle of each tube.
        """
        n = self.count
        edges = [np.linspace(a, b, max(2, round(elements * (b - a) / self.length)) + 1) for a, b in pairwise(self.breaks)]
        s = np.concatenate([edges[0], *(e[1:] for e in edges[1:])])
        middle, h = (s[1:] + s[:-1]) / 2, np.diff(s)
        states = self.integrate(y, middle)[2]
        width = n + 2
        Q = np.zeros((width * len(s), width * len(s)))
        mean, slope = np.hstack([np.eye(width), np.eye(width)]) / 2, np.hstack([-np.eye(width), np.eye(width)])
        for k, (place, state) in enumerate(zip(middle, states, strict=True)):
            properties = self.at(place)
            EI, GJ, _ = properties
            R, m, _, _ = self.split(state)
            u, _, own = self.curvature(state, properties)
            # rows that make (phi, theta)(middle) and their rates from the numbers of both nodes
            phi, rates = mean[:3], slope / h[k]
            U = R.T @ rates[:3]
            local = np.zeros((2 * width, 2 * width))
            for i in range(n):
                angle = mean[1 + i + 1] if i else np.zeros(2 * width)
                angle_rate = rates[1 + i + 1] if i else np.zeros(2 * width)
                across = np.array([-own[i, 1], own[i, 0]])
                bend = U[:2] - np.outer(across, angle)
                local += EI[i] * bend.T @ bend + EI[i] * ((u[:2] - own[i]) @ own[i]) * np.outer(angle, angle)
                local += GJ[i] * np.outer(U[2] + angle_rate, U[2] + angle_rate)
                if GJ[i] == 0:  # ended: its angle, or the twist of a frame that no tube carries, stays
                    held = angle_rate if i else U[2]
                    local += EI.max() * np.outer(held, held)
            couple = phi.T @ hat(m) @ rates[:3]  # -m . (phi x phi')
            local += (couple + couple.T) / 2
            t, F = R[:, 2], self.force
            local += phi.T @ twice_turned(F, t) @ phi
            place = slice(width * k, width * (k + 2))
            Q[place, place] += h[k] * local
        # the numbers of node 0 from the angle of each tube
        base = np.zeros((width, n))
        base[2, 0] = 1.0
        base[3:, 0], base[3:, 1:] = -1.0, np.eye(n - 1)
        ones = np.ones(self.count)
        give = self.angles(ones) - self.angles(
            0 * ones
        )  # behind the plate; nothing where it is too short for a digit of the angle
        free = [i for i in range(n) if give[i] != 0]
        T = np.zeros((len(Q), len(free) + len(Q) - width))
        T[:width, : len(free)] = base[:, free]
        T[width:, len(free) :] = np.eye(len(Q) - width)
        Q = T.T @ Q @ T
        for at, i in enumerate(free):
            Q[at, at] += 1 / give[i]
        values = np.linalg.eigvalsh(Q)
        return int((values < 0).sum()), float(np.abs(values).min() / np.abs(values).max())


def base_of(solution, count):
    """Moment of all tubes at the plate in the world, and the torques of tubes 2 to n there, of a solution."""
    shapes = [solution.rod(k, nodes=3) for k in range(count)]
    moment = sum(shape.rotation[0] @ shape.moment[0] for shape in shapes)
    return moment, np.array([shape.moment[0, 2] for shape in shapes[1:]])
