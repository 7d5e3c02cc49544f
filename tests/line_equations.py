"""Rods with lines in plain NumPy, many at once: an independent witness of equilibria and of their stability.

Nothing of the package is used. Strains are those of least energy, by Newton's method; the equations of a rod are integrated in
the world's axes by equal steps. Stability is told by an energy of segments of constant strain, by differences.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

E3 = np.array([0.0, 0.0, 1.0])


def cross_matrix(a: np.ndarray) -> np.ndarray:
    """The matrix (..., 3, 3) by which ``a`` is crossed with another vector."""
    x, y, z = np.moveaxis(a, -1, 0)
    o = np.zeros_like(x)
    return np.stack([np.stack([o, -z, y], -1), np.stack([z, o, -x], -1), np.stack([-y, x, o], -1)], -2)


@dataclass(frozen=True)
class Section:
    """A piece of a rod: stiffnesses ``K`` of bending and torsion, ``S`` of shear and extension or None, its shape at rest."""

    length: float
    K: np.ndarray
    S: np.ndarray | None = None
    u_star: np.ndarray | None = None


@dataclass(frozen=True)
class LineModel:
    """A line.

    ``route(s)`` is its offset and that's derivative, each (..., 2). Its energy is its tension times its length, or with ``area``
    less than that of the chords between discs, or for a chamber the volume of a hole in the section.
    """

    route: Callable[[float], tuple[np.ndarray, np.ndarray]]
    start: float = 0.0
    end: float = np.inf
    discs: float = 0.0
    hole: bool = False  # a chamber whose area in the section is fixed
    bending: float = 0.0  # its own stiffness

    def length_and_slopes(self, s: float, q: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """What its tension works on, per length of rod, at strains (count, 6), with its gradient and Hessian by them."""
        rho, slope = (np.concatenate([np.broadcast_to(v, (len(q), 2)), np.zeros((len(q), 1))], axis=1) for v in self.route(s))
        J = np.concatenate([-cross_matrix(rho), np.broadcast_to(np.eye(3), (len(q), 3, 3))], axis=2)
        a = q[:, 3:] + np.cross(q[:, :3], rho) + slope
        if self.hole:
            return a[:, 2], J[:, 2], np.zeros((len(q), 6, 6))
        size = np.linalg.norm(a, axis=1)
        t = a / size[:, None]
        gradient = np.einsum("nij,ni->nj", J, t)
        P = (np.eye(3) - t[:, :, None] * t[:, None, :]) / size[:, None, None]
        hessian = np.einsum("nij,nik,nkl->njl", J, P, J)
        if self.discs:
            k = self.discs**2 / 24
            part = 1 - k * (q[:, 0] ** 2 + q[:, 1] ** 2)
            by = np.zeros_like(q)
            by[:, :2] = -2 * k * q[:, :2]
            twice = np.zeros((6, 6))
            twice[[0, 1], [0, 1]] = -2 * k
            mixed = gradient[:, :, None] * by[:, None, :]
            hessian = part[:, None, None] * hessian + mixed + np.swapaxes(mixed, 1, 2) + size[:, None, None] * twice
            gradient = part[:, None] * gradient + size[:, None] * by
            size = part * size
        return size, gradient, hessian

    def own_energy(self, s: float, q: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Of an arc beside an arc, per length of rod, with gradient and Hessian."""
        x, y = np.moveaxis(np.broadcast_to(self.route(s)[0], (len(q), 2)), -1, 0)
        m = q[:, 5] + q[:, 0] * y - q[:, 1] * x
        by_m = np.stack([y, -x, 0 * x, 0 * x, 0 * x, 0 * x + 1], axis=1)
        half = (q[:, 0] ** 2 + q[:, 1] ** 2) / 2
        by_half = np.concatenate([q[:, :2], np.zeros((len(q), 4))], axis=1)
        twice = np.diag([1.0, 1, 0, 0, 0, 0])
        mixed = by_half[:, :, None] * by_m[:, None, :]
        mixed = mixed + np.swapaxes(mixed, 1, 2)
        at = (slice(None), None, None)
        hessian = twice / m[at] - mixed / m[at] ** 2 + 2 * half[at] * by_m[:, :, None] * by_m[:, None, :] / m[at] ** 3
        gradient = by_half / m[:, None] - (half / m**2)[:, None] * by_m
        return self.bending * half / m, self.bending * gradient, self.bending * hessian


@dataclass(frozen=True)
class Found:
    """What an integration finds: pose of the tip, moment there in the world, lengths of lines, elastic energy."""

    position: np.ndarray
    rotation: np.ndarray
    moment: np.ndarray
    length: np.ndarray
    energy: np.ndarray


class LineEquations:
    """One rod, clamped at the origin along z, with lines; weight per length ``w`` in the world, (count, 3) or 0."""

    def __init__(self, sections: list[Section], lines: list[LineModel]) -> None:
        self.sections, self.lines = sections, lines
        ends = np.cumsum([section.length for section in sections])
        self.length = float(ends[-1])
        cuts = {0.0, *ends.tolist()} | {min(c, self.length) for line in lines for c in (line.start, line.end)}
        self.nodes = sorted(cuts)
        self.of = [sections[int(np.searchsorted(ends, (a + b) / 2))] for a, b in zip(self.nodes, self.nodes[1:], strict=False)]

    def energy(self, section: Section, s: float, q: np.ndarray, T: np.ndarray):
        """Per length, of rod and lines at strains (count, 6); gradient, Hessian; the elastic part; what each tension works on."""
        u_star = np.zeros(3) if section.u_star is None else section.u_star
        S = np.zeros(3) if section.S is None else section.S
        rest = q - np.concatenate([u_star, E3])
        stiffness = np.concatenate([section.K, S])
        gradient = rest * stiffness
        hessian = np.broadcast_to(np.diag(stiffness), (len(q), 6, 6)).copy()
        elastic, works = (rest * gradient).sum(axis=1) / 2, np.zeros(T.shape)
        total = elastic.copy()
        for k, line in enumerate(self.lines):
            if not line.start <= s < line.end:
                continue
            if line.bending:
                own, by, twice = line.own_energy(s, q)
                elastic, total, gradient, hessian = elastic + own, total + own, gradient + by, hessian + twice
            works[:, k], by, twice = line.length_and_slopes(s, q)
            total = total + T[:, k] * works[:, k]
            gradient = gradient + T[:, k, None] * by
            hessian = hessian + T[:, k, None, None] * twice
        return total, gradient, hessian, elastic, works

    def strains(self, section: Section, s: float, N: np.ndarray, M: np.ndarray, T: np.ndarray, q: np.ndarray) -> np.ndarray:
        """Those (count, 6) at which rod and lines together carry ``N`` and ``M``, near ``q``."""
        free = 6 if section.S is not None else 3
        if free == 3:
            q = np.concatenate([q[:, :3], np.broadcast_to(E3, (len(q), 3))], axis=1)
        for _ in range(30):
            _, gradient, hessian, _, _ = self.energy(section, s, q, T)
            gap = (gradient - np.concatenate([M, N], axis=1))[:, :free]
            step = np.linalg.solve(hessian[:, :free, :free], gap[..., None])[..., 0]
            q = q.copy()
            q[:, :free] -= step
            if np.abs(step).max() < 1e-13 * max(1.0, np.abs(q).max()):
                break
        return q

    def integrate(
        self, T: np.ndarray, force: np.ndarray, moment: np.ndarray, w: np.ndarray | float = 0.0, steps: int = 150
    ) -> Found:
        """From the moment at the base (count, 3); tensions (count, lines), dead force at the tip (count, 3)."""
        count = len(moment)
        w = np.broadcast_to(w, (count, 3))
        y = np.concatenate(
            [
                np.zeros((count, 3)),
                np.broadcast_to(np.eye(3).ravel(), (count, 9)),
                moment,
                np.zeros((count, len(self.lines) + 1)),
            ],
            axis=1,
        )
        q = np.zeros((count, 6))
        q[:, 5] = 1

        def rate(section: Section, s: float, y: np.ndarray, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
            R, m = y[:, 3:12].reshape(-1, 3, 3), y[:, 12:15]
            n = force + (self.length - s) * w
            M, N = np.einsum("nji,nj->ni", R, m), np.einsum("nji,nj->ni", R, n)
            q = self.strains(section, s, N, M, T, q)
            *_, elastic, works = self.energy(section, s, q, T)
            dp = np.einsum("nij,nj->ni", R, q[:, 3:])
            dR = R @ cross_matrix(q[:, :3])
            return np.concatenate([dp, dR.reshape(-1, 9), -np.cross(dp, n), works, elastic[:, None]], axis=1), q

        for section, a, b in zip(self.of, self.nodes, self.nodes[1:], strict=False):
            parts = max(2, round(steps * (b - a) / self.length))
            h = (b - a) / parts
            for k in range(parts):
                # of this stretch, at its ends too
                start, middle, end = np.clip(a + h * np.array([k, k + 0.5, k + 1]), a + 1e-9 * h, b - 1e-9 * h)
                k1, q = rate(section, start, y, q)
                k2, q = rate(section, middle, y + h / 2 * k1, q)
                k3, q = rate(section, middle, y + h / 2 * k2, q)
                k4, q = rate(section, end, y + h * k3, q)
                y = y + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
        return Found(y[:, :3], y[:, 3:12].reshape(-1, 3, 3), y[:, 12:15], y[:, 15:-1], y[:, -1])


class SegmentEnergy:
    """The potential energy of one such rod on segments of constant strain: an index that no column and no kernel has told."""

    def __init__(self, equations: LineEquations, count: int) -> None:
        self.equations = equations
        edges = [np.array([0.0])]
        self.section: list[Section] = []
        for section, a, b in zip(equations.of, equations.nodes, equations.nodes[1:], strict=False):
            own = max(1, round(count * (b - a) / equations.length))
            edges.append(np.linspace(a, b, own + 1)[1:])
            self.section += [section] * own
        self.edges = np.concatenate(edges)
        self.h, self.middle = np.diff(self.edges), (self.edges[1:] + self.edges[:-1]) / 2
        self.shears = equations.sections[0].S is not None
        self.per = 6 if self.shears else 3
        self.size = self.per * len(self.h)

    def parts(self, x: np.ndarray, force: np.ndarray, w: np.ndarray, T: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Energy of the rod, its loads and what ``T`` pulls (batch,), and length of each line, of strains (batch, size)."""
        count = len(x)
        own = x.reshape(count, len(self.h), self.per)
        R, p = np.broadcast_to(np.eye(3), (count, 3, 3)), np.zeros((count, 3))
        energy, lengths = np.zeros(count), np.zeros((count, len(self.equations.lines)))
        pulls = np.broadcast_to(T, (count, len(T)))
        for k, h in enumerate(self.h):
            strains = own[:, k] if self.shears else np.concatenate([own[:, k], np.broadcast_to(E3, (count, 3))], axis=1)
            total, _, _, _, works = self.equations.energy(self.section[k], self.middle[k], strains, pulls)
            energy, lengths = energy + h * total, lengths + h * works
            middle, _ = moved(strains, h / 2)
            energy = energy - h * np.einsum("nij,nj,i->n", R, middle, w) - h * p @ w
            move, turn = moved(strains, h)
            p = p + np.einsum("nij,nj->ni", R, move)
            R = R @ turn
        return energy - p @ force, lengths

    def index(
        self, x: np.ndarray, force: np.ndarray, w: np.ndarray, T: np.ndarray, held: np.ndarray, stiffness: np.ndarray
    ) -> tuple[int, float]:
        """Negative eigenvalues of the second variation near ``x``, and the one that is nearest to zero, over EI/L.

        Lines that are ``held`` are as long as they are; of what ``stiffness`` says where they stretch [N/m], with T there.
        """
        section = self.equations.sections[0]
        unit = 1 / np.sqrt(np.repeat(self.h, self.per) * self.equations.length)
        if self.shears:
            softer = np.tile(np.concatenate([np.ones(3), np.sqrt(section.K.max() / section.S)]), len(self.h))
            unit = unit * softer
        step, n = 2e-3, self.size
        e = np.eye(n) * unit[:, None] * step
        i, j = np.triu_indices(n)
        stretches = held & np.isfinite(stiffness)
        fixed = held & ~np.isfinite(stiffness)
        T = np.array(T)
        _, target = self.parts(x[None], force, w, T)
        for _ in range(4):
            (ahead, l_ahead), (behind, l_behind) = (self.parts(x + sign * e, force, w, T) for sign in (1, -1))
            g, A = (ahead - behind) / (2 * step), (l_ahead - l_behind).T / (2 * step)
            H = np.zeros((n, n))
            values = []
            for a, b in ((1, 1), (1, -1), (-1, 1), (-1, -1)):
                values.append(self.parts(x + a * e[i] + b * e[j], force, w, T)[0])
            H[i, j] = (values[0] - values[1] - values[2] + values[3]) / (4 * step**2)
            H = H + np.triu(H, 1).T
            B = A[stretches]
            H = H + B.T @ (stiffness[stretches, None] * B)
            C = A[fixed]
            _, now = self.parts(x[None], force, w, T)
            gap = (target - now)[0, fixed]
            size = len(C)
            system = np.block([[H, C.T], [C, np.zeros((size, size))]])
            found = np.linalg.lstsq(system, np.concatenate([-g, gap]), rcond=1e-14)[0]
            x = x + found[:n] * unit
            T[fixed] += found[n:]
            T[stretches] += stiffness[stretches] * (B @ found[:n])
            if np.abs(found[:n]).max() < 1e-5:
                break
        free = np.linalg.svd(C)[2][size:].T if size else np.eye(n)
        eigenvalues = np.linalg.eigvalsh(free.T @ H @ free) * self.equations.length / section.K[:2].min()
        return int((eigenvalues < 0).sum()), float(eigenvalues[np.argmin(np.abs(eigenvalues))])


def moved(strains: np.ndarray, h: float) -> tuple[np.ndarray, np.ndarray]:
    """How a frame moves (batch, 3) and turns (batch, 3, 3) along a segment of constant strains (batch, 6)."""
    turn = h * strains[:, :3]
    angle = np.linalg.norm(turn, axis=1)[:, None, None]
    small = angle < 1e-3
    safe = np.where(small, 1.0, angle)
    a = np.where(small, 1 - angle**2 / 6, np.sin(safe) / safe)
    b = np.where(small, 0.5 - angle**2 / 24, (1 - np.cos(safe)) / safe**2)
    c = np.where(small, 1 / 6 - angle**2 / 120, (safe - np.sin(safe)) / safe**3)
    W = cross_matrix(turn)
    WW = W @ W
    V = np.eye(3) + b * W + c * WW
    return h * np.einsum("nij,nj->ni", V, strains[:, 3:]), np.eye(3) + a * W + b * WW
