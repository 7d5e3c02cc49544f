"""The equations of one rod in world components, integrated by SciPy, and the second variation of its energy: nothing of the
package.

A rod is a list of sections, each a dictionary of ``mr.Section``'s arguments with all stiffnesses given; loads are named as the
inputs.
"""

import numpy as np
from scipy.integrate import solve_ivp
from scipy.linalg import eigvals_banded

E3 = np.array([0.0, 0.0, 1.0])
NOTHING = np.zeros(3)


def hat(a):
    """Matrices (..., 3, 3) of the vector product."""
    result = np.zeros((*a.shape[:-1], 3, 3))
    result[..., 0, 1], result[..., 0, 2], result[..., 1, 2] = -a[..., 2], a[..., 1], -a[..., 0]
    return result - np.swapaxes(result, -1, -2)


def turned(R, a):
    """Rotated vectors."""
    return np.einsum("...ij,...j->...i", R, a)


def turned_back(R, a):
    """Vectors in rotated components."""
    return np.einsum("...ji,...j->...i", R, a)


def twice_turned(a, b):
    """Matrices (..., 3, 3) of the form ``-a . (phi x (phi x b))`` in ``phi``."""
    outer = np.einsum("...i,...j->...ij", a, b)
    return np.einsum("...i,...i->...", a, b)[..., None, None] * np.eye(3) - (outer + np.swapaxes(outer, -1, -2)) / 2


class RodEquations:
    """World position, rotation, force and moment along a rod: ``y = (p, R, n, m)``, as rows of 18 numbers.

    p' = R (e3 + S^-1 R^T n),  R' = R [u]x,  u = u* + K^-1 R^T m,  n' = -f,  m' = -p' x n - l
    """

    def __init__(self, sections, loads):
        self.given = sections, loads
        self.end = np.cumsum([s["length"] for s in sections])
        self.length = self.end[-1]
        self.K = np.array([[*np.broadcast_to(s["bending_stiffness"], 2), s["torsional_stiffness"]] for s in sections], float)
        inf = np.inf
        self.compliance = 1 / np.array(
            [[*np.broadcast_to(s.get("shear_stiffness", inf), 2), s.get("axial_stiffness", inf)] for s in sections], float
        )
        self.u_star = np.array([s.get("precurvature", NOTHING) for s in sections], float)
        self.weight = np.array([s.get("linear_density", 0.0) for s in sections], float)
        self.loads = {name: np.asarray(value, float) for name, value in loads.items()}
        self.f = self.load("distributed_force") + self.weight[:, None] * self.load("gravity")

    def load(self, name):
        """A load, zero where none is given."""
        return self.loads.get(name, NOTHING)

    def section(self, s):
        """Number of the section that goes on from arclength ``s``."""
        return np.minimum(np.searchsorted(self.end, s, side="right"), len(self.end) - 1)

    def rate(self, y, k):
        """Derivative of states (row, 18) in the sections ``k``."""
        R, n, m = y[:, 3:12].reshape(-1, 3, 3), y[:, 12:15], y[:, 15:]
        u = self.u_star[k] + turned_back(R, m) / self.K[k]
        dp = turned(R, E3 + turned_back(R, n) * self.compliance[k])
        dm = -np.cross(dp, n) - self.load("distributed_moment")
        return np.concatenate([dp, (R @ hat(u)).reshape(-1, 9), -self.f[k], dm], axis=1)

    def states(self, shape):
        """Rows ``y`` of the nodes of a ``Shape``."""
        R = shape.rotation
        return np.concatenate([shape.position, R.reshape(-1, 9), turned(R, shape.force), turned(R, shape.moment)], axis=1)

    def carry(self, start, stop, y, rtol=1e-11):
        """States at ``stop`` (row,) from those ``y`` at ``start`` (row,): all rows at once, from section end to section end."""
        unit = self.units(y)
        s, y = np.array(start, float), y / unit
        while np.any(s < stop):
            k = self.section(s)
            to = np.minimum(stop, np.where(k == len(self.end) - 1, np.inf, self.end[k]))
            h = (to - s)[:, None]

            def rate(_, flat, k=k, h=h):
                return (h * self.rate(flat.reshape(-1, 18) * unit, k) / unit).ravel()

            y = solve_ivp(rate, (0, 1), y.ravel(), method="DOP853", rtol=rtol, atol=rtol / 100).y[:, -1].reshape(-1, 18)
            s = to
        return y * unit

    def units(self, y):
        """What each number of a state is measured in: the length, 1, the largest force and moment, or what bends the rod."""
        soft = self.K.min()
        force = max(soft / self.length**2, np.linalg.norm(y[:, 12:15], axis=1).max())
        moment = max(soft / self.length, np.linalg.norm(y[:, 15:], axis=1).max())
        return np.concatenate([np.full(3, self.length), np.ones(9), np.full(3, force), np.full(3, moment)])

    def node_count(self, shape):
        """Nodes between which an error grows by less than ten, and a frame turns by a radian or so."""
        y = self.states(shape)
        soft = self.K.min(axis=0)
        n, m = (np.linalg.norm(y[:, k : k + 3], axis=1).max() for k in (12, 15))
        turn = np.abs(shape.curvature).max() + np.abs(self.u_star).max()
        return int(np.clip(self.length * (np.sqrt(n / soft.min()) + m / soft.min() + turn), 8, 4000)) + 1

    def gap(self, shape):
        """Largest gap between a node integrated to the next and that node, in ``units``, and of the arclength."""
        y, s = self.states(shape), shape.arclength
        gap = np.abs((self.carry(s[:-1], s[1:], y[:-1]) - y[1:]) / self.units(y)).max()
        return float(max(gap, abs(s[-1] / self.length - 1), abs(s[0] / self.length)))

    def tip(self, shape):
        """What the conditions at the tip lack of being met, in ``units``."""
        y = self.states(shape)
        unit = self.units(y)
        R, n, m = y[-1, 3:12].reshape(3, 3), y[-1, 12:15], y[-1, 15:]
        n_lacks = n - self.load("tip_force") - R @ self.load("follower_force")
        m_lacks = m - self.load("tip_moment") - R @ self.load("follower_moment")
        return float(max(np.abs(n_lacks / unit[12:15]).max(), np.abs(m_lacks / unit[15:]).max()))

    def index(self, shape):
        """Negative eigenvalues of the second variation under dead forces, and the one nearest zero over the largest.

        With ``R -> exp([phi]x) R``, ``u`` changes by ``R^T (phi' - phi x phi' / 2)``, and (1) of docs/stability.md to second
        order by

            (R^T phi')^T K (R^T phi') - m . (phi x phi') - n . (phi x (phi x t)) - (shear and extension)

        over 2. ``phi`` is linear between every other node of ``shape``, those between are the middles of the elements.
        """
        s, R = shape.arclength, shape.rotation[1::2]
        h = s[2::2] - s[:-2:2]
        k = self.section(s[1::2])
        n, m = turned(R, shape.force[1::2]), turned(R, shape.moment[1::2])
        count = len(h)
        C = np.einsum("eij,ej,ekj->eik", R, self.K[k], R)
        couple = hat(m)  # m . (phi x phi') = phi' . (m x phi)
        t = R[:, :, 2]
        S = np.einsum("eij,ej,ekj->eik", R, self.compliance[k], R)
        V = twice_turned(n, t) + twice_turned(n, turned(S, n)) - np.swapaxes(hat(n), 1, 2) @ S @ hat(n)
        # phi = (a + b) / 2, phi' = (b - a) / h
        off = -(couple + np.swapaxes(couple, 1, 2)) / 2
        mixed = -(couple - np.swapaxes(couple, 1, 2)) / 2
        scale = h[:, None, None]
        aa = C / scale + V * scale / 4 - off / 2
        bb = C / scale + V * scale / 4 + off / 2
        ba = -C / scale + V * scale / 4 + mixed / 2
        # the base is held: node 0 is left out
        size = 3 * count
        band = np.zeros((6, size))
        block = bb.copy()
        block[:-1] += aa[1:]
        for i in range(3):
            for j in range(i + 1):
                band[i - j, j::3] += block[:, i, j]
        for i in range(3):
            for j in range(3):
                band[3 + i - j, j : size - 3 : 3] += ba[1:, i, j]
        values = eigvals_banded(band, lower=True)
        return int((values < 0).sum()), float(np.abs(values).min() / np.abs(values).max())
