"""The energy of a network with all joints, holes, lines and tubes by itself: rods as chains of rigid segments, for comparison.

Nothing of the package's integration, joints or elements is used. A rod is cut where it goes through holes and where what it is
made of changes, each piece into ``M`` segments of length ``h``. Segments that are turned against each other by ``phi`` store the
energy of the strains ``phi/h`` over ``h``; half of a segment stands at each end of a piece. How long the pieces beside a hole are
is a variable as any other: nothing is said of the force at which a rod slides. What is where by forces has these as multipliers,
and so has a line of given length its tension. The error is of the second order in ``h``. Equilibria are found by Newton's method
on the Lagrangian, minima by descent.
"""

from itertools import pairwise

import numpy as np
from network_energy import AXIS, STEP, damped_newton, exp, hat, log, right_inverse


def of(M, v):
    """Matrices by vectors."""
    return (M @ v[..., None])[..., 0]


def roll(angle):
    """Turns about z (...)."""
    return exp(np.asarray(angle)[..., None] * AXIS)


def turned(end, angles):
    """Rotation of a joint by its angles (..., count), and how it is turned about its own axes by them (..., 3, count)."""
    axes, count = end["axes"], len(end["axes"])
    shape = angles.shape[:-1]
    if count == 0:
        return np.broadcast_to(np.eye(3), (*shape, 3, 3)), np.zeros((*shape, 3, 0))
    if count == 3:
        return exp(angles), np.linalg.inv(right_inverse(angles))
    first = exp(axes[0] * angles[..., :1])
    if count == 1:
        return first, np.broadcast_to(axes[0][:, None], (*shape, 3, 1))
    second = exp(axes[1] * angles[..., 1:])
    return first @ second, np.stack([of(np.swapaxes(second, -1, -2), axes[0]), np.broadcast_to(axes[1], (*shape, 3))], axis=-1)


def spring(A, B, h, a, b, T, made):
    """Energy between frames at a distance ``h`` whose tubes are turned by ``a``, ``b`` (..., tubes - 1), with lines that are
    pulled by ``T``; and its gradients, by turns of both about their own axes, by ``h``, ``a``, ``b`` and ``T``."""
    phi = log(np.swapaxes(A, -1, -2) @ B)
    k, first = phi / h[..., None], np.zeros((*h.shape, 1))
    angle = np.concatenate([first, 0.5 * (a + b)], -1)
    rate = np.concatenate([first, (b - a) / h[..., None]], -1)
    c, s = np.cos(angle), np.sin(angle)
    x, y, z = np.moveaxis(made["curvature"], -1, 0)
    EIx, EIy, GJ = np.moveaxis(made["stiffness"], -1, 0)
    bx, by, bz = k[..., :1] - c * x + s * y, k[..., 1:2] - s * x - c * y, k[..., 2:] + rate - z
    mx, my, mz = EIx * bx, EIy * by, GJ * bz
    moment = np.stack([m.sum(-1) for m in (mx, my, mz)], -1)
    energy = 0.5 * (mx * bx + my * by + mz * bz).sum(-1)
    by_h = energy - (moment * k).sum(-1) - (mz * rate).sum(-1)
    energy = h * energy
    by_angle = h[..., None] * (mx * (s * x + c * y) - my * (c * x - s * y))
    offsets, T = made["offset"], T * made["runs"]  # (..., lines, 3), (..., lines)
    along = h[..., None, None] * AXIS + np.cross(phi[..., None, :], offsets)
    lengths = np.linalg.norm(along, axis=-1)
    t = along / lengths[..., None]
    moment = moment + (T[..., None] * np.cross(offsets, t)).sum(-2)
    by_h = by_h + (T * t[..., 2]).sum(-1)
    energy = energy + (T * lengths).sum(-1)
    J = right_inverse(phi)
    # a turn of A about its axes is one of phi's left: its inverse Jacobian is the transpose
    turns = [-of(J, moment), of(np.swapaxes(J, -1, -2), moment)]
    tubes = [0.5 * by_angle[..., 1:] - mz[..., 1:], 0.5 * by_angle[..., 1:] + mz[..., 1:]]
    return energy, np.concatenate([*turns, by_h[..., None], *tubes, lengths * made["runs"]], -1)


def differences(gradient, size, *, slopes=True):
    """Gradients at zero (..., size) and their derivatives (..., size, size), or zero; ``gradient`` takes (points, size)."""
    if not slopes:
        value = gradient(np.zeros((1, size)))[0]
        return value, np.zeros((*value.shape, size))
    points = STEP * np.concatenate([np.zeros((1, size)), np.eye(size), -np.eye(size)])
    values = gradient(points)
    slope = (values[1 : 1 + size] - values[1 + size :]) / (2 * STEP)
    slope = np.moveaxis(slope, 0, -1)
    return values[0], 0.5 * (slope + np.swapaxes(slope, -1, -2))


class Graph:
    """A network in numbers, as ``random_graphs`` draws it.

    Args:
        rods: Of each: ``base``, ``tip`` (None where it is free), ``holes``; ``spans`` of one material each: ``length``,
            ``stiffness`` and ``curvature`` (tubes, 3), ``force`` per length (3,), ``shear`` (3,) or None, ``magnet``, magnetic
            moment per length in a ``field``, both (3,), ``moment`` per length (3,) where there are no holes, ``without_lines``
            where these have ended; ``medium``, its stiffness (3,) or None, and ``loads`` of its own, names of laws and their
            numbers, of rods whose bases stand still; ``angles`` (tubes,) of bases, ``behind`` (tubes,):
            what they are turned with behind the plate [N m/rad], infinite where they begin there; ``lines``: ``offset`` (2,),
            and ``tension``, or ``length`` and ``compliance``, and if it ``pushes``; ``pull`` (3,) on a free tip.
            A joint is at ``position``, ``frame`` of ``body`` (-1 the ground), turns about ``axes`` (count, 3) and slides along
            ``slide`` (3,) or does not, None; of its coordinates, ``springs``, ``rest`` and ``push`` (count,). A hole also is
            ``at`` about where, with a ``spring`` that is fixed to ``rest``.
        bodies: Of each: ``loads``, forces and where they act in its frame; ``moment``; ``follower``, force and moment.
        segments: Of each piece.
    """

    def __init__(self, rods, bodies, segments):
        self.rods, self.bodies, self.M = rods, bodies, segments
        self.tubes = max(len(rod["angles"]) for rod in rods)
        self.lines = max(len(rod["lines"]) for rod in rods)
        self.turns, self.values = 0, []  # values that are no turns: what counts as one
        self.length = np.mean([sum(span["length"] for span in rod["spans"]) for rod in rods])
        self.unit = np.mean([rod["spans"][0]["stiffness"][:, 0].sum() for rod in rods]) / self.length
        self.body_turn = [self._turn() for _ in bodies]
        self.parts = [_Part(self, rod) for rod in rods]
        self.body_at = [self._new(3, self.length) for _ in bodies]
        self.free = 3 * self.turns + len(self.values)
        self.forces = []
        for part in self.parts:
            part.forces = [self._new(3, self.unit / self.length) for run in part.runs if run[2] is not None]
            part.tensions = [self._new(1, self.unit / 0.01)[0] if "length" in line else -1 for line in part.rod["lines"]]
        self.size = 3 * self.turns + len(self.values)
        self.scale = np.concatenate([np.ones(3 * self.turns), self.values])
        self._stack()

    def _turn(self):
        self.turns += 1
        return self.turns - 1

    def _new(self, count, unit):
        at = len(self.values) + np.arange(count)
        self.values += [unit] * count
        return at

    def at(self, values):
        """Where values that are no turns stand among all variables."""
        return 3 * self.turns + np.asarray(values, dtype=int)

    def place_of_turn(self, turn):
        return 3 * turn + np.arange(3)

    def _stack(self):
        """All springs between two turns that are variables, at once."""
        every = [link for part in self.parts for link in part.links]
        self.A, self.B = (np.array([link[k] for link in every], dtype=int) for k in (0, 1))
        self.made = {
            name: np.stack([np.broadcast_to(link[2][name], (rows, 3)) for link in every])
            for name, rows in (("stiffness", self.tubes), ("curvature", self.tubes), ("offset", self.lines))
        }
        self.made["runs"] = np.array([link[2]["runs"] for link in every]).reshape(len(every), self.lines)
        self.share = np.array([link[3] for link in every])
        self.piece = [link[4] for link in every]
        self.tube_at = np.array([link[5] for link in every], dtype=int).reshape(len(every), 2 * (self.tubes - 1))
        self.of_part = [part for part in self.parts for _ in part.links]
        self.kinks = np.array([link[6] for link in every], dtype=float).reshape(len(every), 2 * (self.tubes - 1))

    def length_of(self, piece, y):
        """Of a piece, whose ends are numbers or variables."""
        low, high = ((y[at] if kind else at) for kind, at in piece)
        return high - low

    @staticmethod
    def by_length(piece):
        """Variables by which a piece is longer, with signs."""
        return [(at, sign) for (kind, at), sign in zip(piece, (-1.0, 1.0), strict=True) if kind]

    def moved(self, state, z):
        """A state displaced by ``z`` (size,): all that turns about its own axes."""
        R, y = state
        n = 3 * self.turns
        return R @ exp(z[:n].reshape(-1, 3)), y + z[n:]

    def positions(self, state):
        """Of bodies (bodies, 3)."""
        return np.array([state[1][at] for at in self.body_at]).reshape(-1, 3)

    def tensions(self, part, y):
        """Of all lines of a rod."""
        result = np.zeros(self.lines)
        for k, (line, at) in enumerate(zip(part.rod["lines"], part.tensions, strict=True)):
            result[k] = y[at] if at >= 0 else line.get("tension", 0.0)
        return result

    def tube_values(self, y):
        known = np.where(self.tube_at >= 0, y[np.maximum(self.tube_at, 0)], self.kinks)
        return known[:, : self.tubes - 1], known[:, self.tubes - 1 :]

    def system(self, state, *, energy=False, slopes=True):
        """Gradient of the Lagrangian, gaps last (size,), and its derivative (size, size), of rods not where ``slopes`` are not
        asked for; or its value alone, without moments."""
        R, y = state
        g, H = np.zeros(self.size), np.zeros((self.size, self.size))
        h = self.share * np.array([self.length_of(piece, y) for piece in self.piece])
        T = np.array([self.tensions(part, y) for part in self.of_part]).reshape(len(h), self.lines)
        a, b = self.tube_values(y)
        n, m = self.tubes - 1, self.lines

        def gradient(z):
            z = z[:, None]
            turn, other = R[self.A] @ exp(z[..., :3]), R[self.B] @ exp(z[..., 3:6])
            shape = (len(z), len(h))
            made = {name: np.broadcast_to(value, (len(z), *value.shape)) for name, value in self.made.items()}
            values = (a + z[..., 7 : 7 + n], b + z[..., 7 + n : 7 + 2 * n], T + z[..., 7 + 2 * n :])
            return spring(turn, other, np.broadcast_to(h + z[..., 6], shape), *values, made)

        size = 7 + 2 * n + m
        total = 0.0
        if energy:
            total += gradient(np.zeros((1, size)))[0].sum()
        else:
            local, slope = differences(lambda z: gradient(z)[1], size, slopes=slopes)
            for i, part in enumerate(self.of_part):
                self._add(g, H, local[i], slope[i], self._places(i, part))
        for part in self.parts:
            total += part.ends_of(state, g, H, energy, slopes)
            total += part.pulls_of(state, g, H, energy) + part.medium_of(state, g, H)
        for k, body in enumerate(self.bodies):
            turn, p = R[self.body_turn[k]], y[self.body_at[k]]
            place, at = self.at(self.body_at[k]), self.place_of_turn(self.body_turn[k])
            for force, lever in body["loads"]:
                total -= force @ (p + turn @ lever)
                g[place] -= force
                linear(g, H, at, turn, -force, lever)
            g[at] -= turn.T @ body["moment"]
            H[np.ix_(at, at)] -= hat(turn.T @ body["moment"])
            force, moment = body["follower"]
            g[place] -= turn @ force
            H[np.ix_(place, at)] += turn @ hat(force)
            g[at] -= moment
        return total if energy else (g, H)

    def _places(self, i, part):
        """Of each number of a local gradient, which variables it belongs to, with factors."""
        result = [[(j, 1.0)] for turn in (self.A[i], self.B[i]) for j in self.place_of_turn(turn)]
        result.append([(self.at(at), sign * self.share[i]) for at, sign in self.by_length(self.piece[i])])
        result += [[(self.at(at), 1.0)] if at >= 0 else [] for at in self.tube_at[i]]
        lines = [[(self.at(at), 1.0)] if at >= 0 else [] for at in part.tensions]
        return result + lines + [[] for _ in range(self.lines - len(lines))]

    @staticmethod
    def _add(g, H, local, slope, places):
        rows = [(k, at, factor) for k, own in enumerate(places) for at, factor in own]
        which, at, factor = (np.array(v) for v in zip(*rows, strict=True))
        np.add.at(g, at, factor * local[which])
        np.add.at(H, np.ix_(at, at), factor[:, None] * slope[np.ix_(which, which)] * factor)

    def settled(self, state, steps=80, tolerance=1e-9):
        """An equilibrium near a state, as ``damped_newton`` says."""
        return damped_newton(self, state, self.scale, self.unit, steps, tolerance)

    def is_possible(self, state):
        """Whether all pieces have a length."""
        return all(self.length_of(piece, state[1]) > 0.01 * self.length for piece in self.piece)

    def descended(self, state, rounds=8, steps=60):
        """A stable equilibrium by descent: of the energy with gaps that are stiff springs, the stiffer the longer, whose forces
        become the multipliers, and lines that do not push; None if there is none."""
        free, at, n = slice(0, self.free), slice(self.free, self.size), len(self.values) - (self.size - self.free)
        scale, unit, held = self.scale[free], self.unit, self.scale[at]
        gives, pulls = np.zeros(len(held)), np.zeros(len(held), dtype=bool)
        for part in self.parts:
            for line, place in zip(part.rod["lines"], part.tensions, strict=True):
                if place >= 0:
                    gives[place - n], pulls[place - n] = line["compliance"], not line.get("pushes")
        multipliers, stiff = np.array(state[1][n:]), 100.0 * held**2 / unit

        def pulled(state, multipliers, stiff):
            """With the forces of stiff springs, their energy among it, what is left of gaps, and how stiff they are."""
            y = state[1].copy()
            y[n:] = 0.0
            gaps = self.gaps((state[0], y))
            force = multipliers + stiff * gaps
            force[pulls] = np.maximum(force[pulls], 0.0)
            own = force / (1 + gives * stiff)
            stored = 0.5 * (force**2 - multipliers**2) / (stiff * (1 + gives * stiff))
            y[n:] = own
            state = (state[0], y)
            value = self.system(state, energy=True) - own @ gaps + 0.5 * np.sum(gives * own**2) + np.sum(stored)
            loose = pulls & (own <= 0)
            return state, value, np.where(loose, 0.0, gaps - gives * own), np.where(loose, 0.0, stiff / (1 + gives * stiff))

        for _ in range(rounds):
            state, value, gaps, own = pulled(state, multipliers, stiff)
            for _ in range(steps):
                g, H = self.system(state)
                J = H[at, free]
                form = scale[:, None] * (H[free, free] + J.T @ (own[:, None] * J)) * scale / unit
                values, modes = np.linalg.eigh(0.5 * (form + form.T))
                slope = modes.T @ (scale * g[free]) / unit
                if np.linalg.norm(slope) < 1e-7:
                    break
                step = scale * (modes @ (-slope / np.maximum(np.abs(values), 1e-4)))
                damping = min(1.0, 0.3 / np.abs(step / scale).max())
                while damping > 1e-6:
                    z = np.zeros(self.size)
                    z[free] = damping * step
                    trial = self.moved(state, z)
                    if self.is_possible(trial):
                        trial, less, *rest = pulled(trial, multipliers, stiff)
                        if less < value - 1e-4 * damping * abs(slope @ (modes.T @ (step / scale))) * unit:
                            break
                    damping *= 0.5
                else:
                    break
                state, value, (gaps, own) = trial, less, rest
            multipliers = np.where(pulls, state[1][n:] * (1 + gives * stiff), state[1][n:])
            if np.abs(gaps * held).max(initial=0.0) < 1e-3 * unit:
                break
            stiff = 3 * stiff
        self.ended = state
        graph, state = self._without_loose(state)
        found = graph.settled(state)
        return found if found is not None and found[1] == 0 else None

    def astray(self):
        """What goes on and on where descent ended; empty if that is not known."""
        y, found = self.ended[1], []
        for part in self.parts:
            pieces = {link[4] for link in part.links if part.rod["holes"]}
            found += ["is pulled out of a hole"] if any(self.length_of(piece, y) < 0.05 * self.length for piece in pieces) else []
            for end, at in zip((part.rod["base"], part.rod["tip"]), part.coordinates, strict=False):
                count = 0 if end is None else len(end["axes"])
                found += ["turns on and on"] if np.abs(y[at[:count]]).max(initial=0.0) > 2 * np.pi else []
                found += ["slides away"] if np.abs(y[at[count:]]).max(initial=0.0) > self.length else []
        return ", ".join(sorted(set(found)))

    def _without_loose(self, state):
        """The same where lines that hang loose have no tension."""
        lines = [
            [
                {"offset": line["offset"], "tension": 0.0} if at >= 0 and not line.get("pushes") and state[1][at] <= 0 else line
                for line, at in zip(part.rod["lines"], part.tensions, strict=True)
            ]
            for part in self.parts
        ]
        rods = [rod | {"lines": own} for rod, own in zip(self.rods, lines, strict=True)]
        graph = Graph(rods, self.bodies, self.M)
        y = np.zeros(len(graph.values))
        n, first = len(self.values) - (self.size - self.free), len(graph.values) - (graph.size - graph.free)
        y[:first] = state[1][:n]
        for own, part in zip(graph.parts, self.parts, strict=True):
            for at, there in zip([*own.forces, own.tensions], [*part.forces, part.tensions], strict=True):
                mine, its = np.asarray(at, dtype=int), np.asarray(there, dtype=int)
                y[mine[mine >= 0]] = state[1][its[mine >= 0]]
        return graph, (state[0], y)

    def gaps(self, state):
        """What the multipliers close."""
        return self.system(state, slopes=False)[0][self.free :]

    def refined(self, state):
        """The same network in twice as many segments, and a state of it."""
        finer = Graph(self.rods, self.bodies, 2 * self.M)
        R, y = np.zeros((finer.turns, 3, 3)), np.zeros(len(finer.values))
        R[finer.body_turn] = state[0][self.body_turn]
        for own, part in zip(finer.parts, self.parts, strict=True):
            for mine, its in zip(own.nodes, part.twice(), strict=True):
                R[mine[0]] = state[0][its[0]]
                for at, there in ((mine[1], its[1]), (mine[2], its[2])):
                    y[at] = state[1][there]
            for name in ("coordinates", "holes", "bases", "forces"):
                for at, there in zip(getattr(own, name), getattr(part, name), strict=True):
                    y[at] = state[1][there]
            for at, there in zip(own.tensions, part.tensions, strict=True):
                if at >= 0:
                    y[at] = state[1][there]
        for at, there in zip(finer.body_at, self.body_at, strict=True):
            y[at] = state[1][there]
        return finer, (R, y)

    def straight(self, positions):
        """Rods straight on their bases, bodies at ``positions``, joints not turned."""
        R, y = np.broadcast_to(np.eye(3), (self.turns, 3, 3)).copy(), np.zeros(len(self.values))
        for at, p in zip(self.body_at, positions, strict=True):
            y[at] = p
        for part in self.parts:
            rod = part.rod
            for turn, stretch, tubes in part.nodes:
                R[turn] = rod["base"]["frame"] @ roll(rod["angles"][0])
                y[stretch] = AXIS[: len(stretch)]
                y[tubes] = (np.array(rod["angles"][1:]) - rod["angles"][0])[: len(tubes)]
            for at, hole in zip(part.holes, rod["holes"], strict=True):
                y[at] = hole["at"]
            y[part.bases] = rod["angles"][: len(part.bases)]
        return R, y


def linear(g, H, at, R, a, c):
    """Add ``a . R c`` by a turn of ``R`` about its own axes."""
    b = R.T @ a
    g[at] += np.cross(c, b)
    H[np.ix_(at, at)] += 0.5 * (np.outer(b, c) + np.outer(c, b)) - (b @ c) * np.eye(3)


class _Part:
    """One rod: its segments, what is between them, and what holds it.

    Attributes:
        nodes: Number of the turn, variables of the strains of shear and stretch, and of the turns of tubes against the first.
        runs: Between places that hold it: segments as (node, piece, share, force), base and tip joint.
        links: Springs between two nodes.
        ends: Springs between a joint and a node.
    """

    def __init__(self, graph, rod):
        self.graph, self.rod = graph, rod
        M, count = graph.M, len(rod["angles"])
        self.nodes, self.runs, self.links, self.ends = [], [], [], []
        self.coordinates = [
            np.zeros(0, int) if end is None else self._coordinates(end) for end in (rod["base"], rod["tip"], *rod["holes"])
        ]
        self.holes = [graph._new(1, graph.length)[0] for _ in rod["holes"]]
        self.bases = graph._new(count, 1.0) if np.isfinite(rod["behind"]).any() else np.zeros(0, int)
        self.offset = np.zeros((graph.lines, 3))
        for k, line in enumerate(rod["lines"]):
            self.offset[k, :2] = line["offset"]
        total = sum(span["length"] for span in rod["spans"])
        if rod["holes"]:
            marks = [(False, 0.0), *((True, at) for at in self.holes), (False, total)]
            pieces = [((low, high), rod["spans"][0]) for low, high in pairwise(marks)]
        else:
            ends = np.cumsum([0.0, *(span["length"] for span in rod["spans"])])
            pieces = [(((False, ends[k]), (False, ends[k + 1])), span) for k, span in enumerate(rod["spans"])]
        run, before = [], ("base", 0, rod["base"])
        for k, (piece, span) in enumerate(pieces):
            here = self._made(span)
            own = [self._node(len(span["stiffness"]), span["shear"] is not None) for _ in range(M)]
            self._link(before, own[0], here, 0.5 / M, piece)
            for one, other in pairwise(own):
                self._link(one, other, here, 1 / M, piece)
            run += [(node, piece, 1 / M, span) for node in own]
            last = k == len(pieces) - 1
            if rod["holes"] and not last:
                hole = rod["holes"][k]
                ring = len(hole["axes"]) == 3
                after = self._node(1, False) if ring else ("hole", 2 + k, hole)
                self._link(own[-1], after, here, 0.5 / M, piece)
                self.runs.append((run, rod["base"] if k == 0 else rod["holes"][k - 1], hole, (0 if k == 0 else 1 + k, 2 + k)))
                run = []
            elif not last:
                after = self._node(len(span["stiffness"]), False)
                self._link(own[-1], after, here, 0.5 / M, piece)
            elif rod["tip"] is not None:
                self._link(own[-1], ("tip", 1, rod["tip"]), here, 0.5 / M, piece)
            else:
                after = self._node(len(span["stiffness"]), False) if rod["lines"] or len(span["stiffness"]) > 1 else None
                if after is not None:
                    self._link(own[-1], after, here, 0.5 / M, piece)
            before = after if not last else None
        start = rod["holes"][-1] if rod["holes"] else rod["base"]
        self.runs.append((run, start, rod["tip"], (1 + len(rod["holes"]) if rod["holes"] else 0, 1)))

    def _coordinates(self, end):
        """A ring for a hole has a turn of its own."""
        if "at" in end and len(end["axes"]) == 3:
            return np.zeros(0, int)
        angles = self.graph._new(len(end["axes"]), 1.0)
        return angles if end["slide"] is None else np.concatenate([angles, self.graph._new(1, self.graph.length)])

    def _node(self, tubes, shears):
        graph = self.graph
        node = (graph._turn(), graph._new(3 if shears else 0, 1.0), graph._new(tubes - 1, 1.0))
        self.nodes.append(node)
        return node

    def _made(self, span):
        graph, n = self.graph, len(span["stiffness"])
        made = {"offset": self.offset, "runs": np.full(graph.lines, 0.0 if span.get("without_lines") else 1.0)}
        for name in ("stiffness", "curvature"):
            made[name] = np.zeros((graph.tubes, 3))
            made[name][:n] = span[name]
        return made

    def _link(self, one, other, made, share, piece):
        if isinstance(one[0], str) or isinstance(other[0], str):
            self.ends.append((one, other, made, share, piece))
            return
        n = self.graph.tubes - 1
        tubes, kinks = -np.ones((2, n), int), np.zeros((2, n))
        held = int((made["stiffness"][1:, 0] > 0).sum())
        for k, node in enumerate((one, other)):
            tubes[k, :held] = node[2][:held]
        self.links.append((one[0], other[0], made, share, piece, tubes.ravel(), kinks.ravel()))

    def twice(self):
        """Nodes in the order of those of twice as many segments."""
        M, result, at = self.graph.M, [], 0
        pieces = len(self.rod["holes"]) + 1 if self.rod["holes"] else len(self.rod["spans"])
        for _ in range(pieces):
            result += [node for node in self.nodes[at : at + M] for _ in (0, 1)]
            at += M
            # what is between pieces
            between = at < len(self.nodes) and self._is_between(at)
            if between:
                result.append(self.nodes[at])
                at += 1
        return result

    def _is_between(self, at):
        per, pieces = self.graph.M, len(self.rod["holes"]) + 1 if self.rod["holes"] else len(self.rod["spans"])
        rest = len(self.nodes) - pieces * per
        if not rest:
            return False
        if self.rod["holes"]:
            rings = [len(hole["axes"]) == 3 for hole in self.rod["holes"]]
            ends, place = [], 0
            for ring in rings:
                place += per
                if ring:
                    ends.append(place)
                    place += 1
            return at in ends or at == len(self.nodes) - 1
        return True

    def holder(self, state, end):
        """Position and rotation of what holds a joint."""
        b = end["body"]
        if b < 0:
            return np.zeros(3), np.eye(3)
        return state[1][self.graph.body_at[b]], state[0][self.graph.body_turn[b]]

    def _end_of(self, link, state, g, H, energy, slopes):
        """Half a segment at a joint; its energy where that is asked for."""
        (one, other, made, share, piece), graph, (R, y) = link, self.graph, state
        n, m = graph.tubes - 1, graph.lines
        joint, node, at_base = (one, other, True) if isinstance(one[0], str) else (other, one, False)
        name, which, end = joint
        at = self.coordinates[which]
        count = len(end["axes"]) if len(at) else 0
        _, holder = self.holder(state, end)
        bases = self.bases if name == "base" else np.zeros(0, int)
        alpha = y[bases] if len(bases) else np.asarray(self.rod["angles"], float)
        held = int((made["stiffness"][1:, 0] > 0).sum())
        h, T = share * graph.length_of(piece, y), graph.tensions(self, y)
        angles = y[at[:count]]
        inner = np.zeros(n)
        inner[:held] = y[node[2][:held]]
        # segment, holder, angles, h, tubes of the node, bases, tensions
        sizes = [3, 3, count, 1, held, len(bases), m]
        cuts = np.cumsum(sizes)[:-1]

        def gradient(z, *, value=False):
            seg, hold, ang, dh, tubes, base, tension = np.split(z, cuts, axis=-1)
            E, G = turned(end, angles + ang)
            before = end["frame"] @ E
            frame = holder @ exp(hold) @ before
            segment = R[node[0]] @ exp(seg)
            mine = np.broadcast_to(inner, (len(z), n)).copy()
            mine[:, :held] += tubes
            full = np.broadcast_to(np.eye(3), frame.shape)
            theirs = np.zeros((len(z), n))
            turn = alpha + base if len(bases) else np.broadcast_to(alpha, (len(z), len(alpha)))
            if name == "base":
                full = roll(turn[:, 0])
                frame = frame @ full
                theirs[:, :held] = (turn[:, 1:] - turn[:, :1])[:, :held]
            own = {key: np.broadcast_to(v, (len(z), *v.shape)) for key, v in made.items()}
            if at_base:
                e, s = spring(frame, segment, h + dh[:, 0], theirs, mine, T + tension, own)
                by_frame, by_seg, by_theirs, by_mine = s[:, :3], s[:, 3:6], s[:, 7 : 7 + n], s[:, 7 + n : 7 + 2 * n]
            else:
                theirs = mine if name != "base" else theirs  # where tubes end together nothing twists them there
                e, s = spring(segment, frame, h + dh[:, 0], mine, theirs, T + tension, own)
                by_seg, by_frame, by_mine, by_theirs = s[:, :3], s[:, 3:6], s[:, 7 : 7 + n], s[:, 7 + n : 7 + 2 * n]
                by_mine, by_theirs = by_mine + by_theirs, 0 * by_theirs
            if value:
                return e
            turned_by = of(full, by_frame)
            by_base = np.zeros((len(z), len(bases)))
            if len(bases):
                by_base[:, 0] = by_frame[:, 2] - by_theirs[:, :held].sum(-1)
                by_base[:, 1 : 1 + held] = by_theirs[:, :held]
            by_angles = of(np.swapaxes(G, -1, -2), turned_by)
            return np.concatenate(
                [by_seg, of(before, turned_by), by_angles, s[:, 6:7], by_mine[:, :held], by_base, s[:, 7 + 2 * n :]], -1
            )

        size = sum(sizes)
        if energy:
            return float(gradient(np.zeros((1, size)), value=True)[0])
        local, slope = differences(gradient, size, slopes=slopes)
        places = [[(j, 1.0)] for j in graph.place_of_turn(node[0])]
        b = end["body"]
        places += [[(j, 1.0)] for j in graph.place_of_turn(graph.body_turn[b])] if b >= 0 else [[], [], []]
        places += [[(graph.at(j), 1.0)] for j in at[:count]]
        places.append([(graph.at(j), sign * share) for j, sign in graph.by_length(piece)])
        places += [[(graph.at(j), 1.0)] for j in [*node[2][:held], *bases]]
        places += [[(graph.at(j), 1.0)] if j >= 0 else [] for j in self.tensions]
        places += [[] for _ in range(m - len(self.tensions))]
        graph._add(g, H, local, slope, places)
        return 0.0

    def ends_of(self, state, g, H, energy, slopes):
        """Half segments at joints, and their springs."""
        graph, y = self.graph, state[1]
        total = sum(self._end_of(link, state, g, H, energy, slopes) for link in self.ends)
        for end, at in zip((self.rod["base"], self.rod["tip"], *self.rod["holes"]), self.coordinates, strict=True):
            if end is None or not len(at):
                continue
            off = y[at] - end["rest"]
            total += float(0.5 * np.sum(end["springs"] * off**2) - end["push"] @ y[at])
            g[graph.at(at)] += end["springs"] * off - end["push"]
            H[graph.at(at), graph.at(at)] += end["springs"]
        for hole, at in zip(self.rod["holes"], self.holes, strict=True):
            off = y[at] - hole["spot"]
            total += 0.5 * hole["spring"] * off**2
            g[graph.at(at)] += hole["spring"] * off
            H[graph.at(at), graph.at(at)] += hole["spring"]
        for k, at in enumerate(self.bases):
            stiffness = self.rod["behind"][k]
            off = y[at] - self.rod["angles"][k]
            total += 0.5 * stiffness * off**2
            g[graph.at(at)] += stiffness * off
            H[graph.at(at), graph.at(at)] += stiffness
        for line, at in zip(self.rod["lines"], self.tensions, strict=True):
            if at >= 0:
                total -= y[at] * line["length"] + 0.5 * line["compliance"] * y[at] ** 2
                g[graph.at(at)] -= line["length"] + line["compliance"] * y[at]
                H[graph.at(at), graph.at(at)] -= line["compliance"]
        return total

    def _place(self, state, end, which):
        """Where a joint is, and by which variables, with derivatives (3, ...)."""
        graph = self.graph
        p, R = self.holder(state, end)
        arm, way = np.array(end["position"], float), None
        if end["slide"] is not None:
            way = end["frame"] @ end["slide"]
            arm = arm + way * state[1][self.coordinates[which][-1]]
        at, by = [], []
        b = end["body"]
        if b >= 0:
            at += [*graph.at(graph.body_at[b]), *graph.place_of_turn(graph.body_turn[b])]
            by += [np.eye(3), -R @ hat(arm)]
        if way is not None:
            at.append(graph.at(self.coordinates[which][-1]))
            by.append((R @ way)[:, None])
        return p + R @ arm, np.array(at, int), np.concatenate(by, axis=1) if by else np.zeros((3, 0)), arm, way, R

    def pulls_of(self, state, g, H, energy):
        """Forces on places and along the rod, and the gaps that they close."""
        graph, (R, y), total = self.graph, state, 0.0
        for number, (segments, start, stop, which) in enumerate(self.runs):
            held = stop is not None
            own = self.forces[number] if held else None
            n = y[own] if held else -np.asarray(self.rod["pull"])
            h = np.array([share * graph.length_of(piece, y) for _, piece, share, _ in segments])
            f = np.array([span["force"] for *_, span in segments])
            weight = h[:, None] * f
            c = weight[::-1].cumsum(axis=0)[::-1] - 0.5 * weight
            F = weight.sum(axis=0)
            v = np.array([y[node[1]] if len(node[1]) else AXIS for node, *_ in segments])
            turns = R[[node[0] for node, *_ in segments]]
            points = of(turns, v)
            gap = (h[:, None] * points).sum(axis=0)
            piece, share, span = segments[0][1], segments[0][2], segments[0][3]
            lengths = [(graph.at(at), sign * share) for at, sign in graph.by_length(piece)]  # of a hole: one piece alone
            by_h = 0.0
            for i, (node, *_) in enumerate(segments):
                at, a = graph.place_of_turn(node[0]), n - c[i]
                total += h[i] * points[i] @ a
                linear(g, H, at, turns[i], h[i] * a, v[i])
                if held:
                    _both(H, at, graph.at(own), (h[i] * turns[i] @ -hat(v[i])).T)
                at_v = graph.at(node[1])
                for l, factor in lengths:
                    _both(H, at, [l], factor * np.cross(v[i], turns[i].T @ (n - 2 * c[i]))[:, None])
                if len(at_v):
                    S = segments[i][3]["shear"]
                    off = v[i] - AXIS
                    total += 0.5 * h[i] * np.sum(S * off**2)
                    g[at_v] += h[i] * (S * off + turns[i].T @ a)
                    H[at_v, at_v] += h[i] * S
                    _both(H, at, at_v, -h[i] * hat(turns[i].T @ a))
                    if held:
                        _both(H, at_v, graph.at(own), h[i] * turns[i].T)
                    for l, factor in lengths:
                        _both(H, at_v, [l], factor * (S * off + turns[i].T @ (n - 2 * c[i]))[:, None])
                    by_h += 0.5 * np.sum(S * off**2)
            by_h += float(np.sum(points * (n - 2 * c)))
            for i, (node, _, _, span) in enumerate(segments):
                turning = h[i] * turns[i].T @ span.get("moment", np.zeros(3))  # of rods without holes
                at, m, B = graph.place_of_turn(node[0]), span["magnet"], span["field"]
                g[at] -= turning
                H[np.ix_(at, at)] -= hat(turning)
                total -= h[i] * B @ turns[i] @ m
                linear(g, H, at, turns[i], -h[i] * B, m)
                by_h -= B @ turns[i] @ m
                for l, factor in lengths:
                    _both(H, at, [l], -factor * np.cross(m, turns[i].T @ B)[:, None])
            for end, number_of, pull, sense in ((start, which[0], n - F, 1.0), (stop, which[1], n, -1.0)):
                if end is None:
                    continue
                p, at, by, arm, way, turn = self._place(state, end, number_of)
                total += sense * pull @ p
                gap = gap + sense * p
                b = end["body"]
                if b >= 0:
                    place, about = graph.at(graph.body_at[b]), graph.place_of_turn(graph.body_turn[b])
                    g[place] += sense * pull
                    linear(g, H, about, turn, sense * pull, arm)
                if way is not None:
                    slide = graph.at(self.coordinates[number_of][-1])
                    g[slide] += sense * pull @ turn @ way
                    if b >= 0:
                        _both(H, about, [slide], sense * np.cross(way, turn.T @ pull)[:, None])
                if held and len(at):
                    _both(H, at, graph.at(own), sense * by.T)
                if sense > 0:
                    by_h -= len(segments) * span["force"] @ p
                    for l, factor in lengths:
                        if len(at):
                            _both(H, at, [l], -factor * len(segments) * (by.T @ span["force"])[:, None])
            if held:
                g[graph.at(own)] += gap
            for l, factor in lengths:
                g[l] += factor * by_h
                if held:
                    _both(H, graph.at(own), [l], factor * points.sum(axis=0)[:, None])
                for other, its in lengths:
                    H[l, other] -= factor * its * 2 * np.sum(points * c) / h[0]
        return total

    def medium_of(self, state, g, H):
        """Of a rod whose base stands still, its segments are held by springs to the line straight out of that, at their middles,
        where loads of its own act too; the energy of these."""
        if self.rod["medium"] is None and not self.rod["loads"]:
            return 0.0
        graph, (R, y), ((segments, *_),) = self.graph, state, self.runs
        h = np.array([share * graph.length_of(piece, y) for _, piece, share, _ in segments])
        frame = self.rod["base"]["frame"]
        K = np.zeros((3, 3)) if self.rod["medium"] is None else frame @ np.diag(self.rod["medium"]) @ frame.T
        turns = R[[node[0] for node, *_ in segments]]
        v = np.array([y[node[1]] if len(node[1]) else AXIS for node, *_ in segments])
        steps = h[:, None] * of(turns, v)
        middle = h.cumsum() - 0.5 * h
        off = steps.cumsum(axis=0) - 0.5 * steps - middle[:, None] * frame[:, 2]
        # what acts per length, how it changes with the place and with the turn, and the energy per length
        pull, curve, by_turn = off @ K, np.broadcast_to(K, (len(off), 3, 3)), np.zeros((len(off), 3, 3))
        energy = 0.5 * np.sum(pull * off, axis=1)
        for law, *numbers in self.rod["loads"]:
            more = LAWS[law](off, turns, frame, *numbers)
            pull, curve, by_turn, energy = pull + more[0], curve + more[1], by_turn + more[2], energy + more[3]
            for i, (node, *_) in enumerate(segments if len(more) > 4 else ()):
                linear(g, H, graph.place_of_turn(node[0]), turns[i], h[i] * more[4], more[5])
        pull = h[:, None] * pull
        # a segment carries those beyond it whole, and itself by half
        carried = pull[::-1].cumsum(axis=0)[::-1] - 0.5 * pull
        places, ways = [], []
        for i, (node, *_) in enumerate(segments):
            at, at_v = graph.place_of_turn(node[0]), graph.at(node[1])
            linear(g, H, at, turns[i], h[i] * carried[i], v[i])
            places.append(at)
            ways.append(-h[i] * turns[i] @ hat(v[i]))
            if len(at_v):
                g[at_v] += h[i] * turns[i].T @ carried[i]
                _both(H, at, at_v, -h[i] * hat(turns[i].T @ carried[i]))
                places.append(at_v)
                ways.append(h[i] * turns[i])
        at, each = np.concatenate(places), np.concatenate(ways, axis=1)  # (3, variables)
        own = np.repeat(np.arange(len(segments)), 3 * len(places) // len(segments))
        share = (own < np.arange(len(segments))[:, None]) + 0.5 * (own == np.arange(len(segments))[:, None])
        moved = share[:, None] * each  # of each middle
        H[np.ix_(at, at)] += np.einsum("kai,kab,kbj->ij", h[:, None, None] * moved, curve, moved)
        for i, (node, *_) in enumerate(segments):
            H[np.ix_(at, graph.place_of_turn(node[0]))] += h[i] * moved[i].T @ by_turn[i]
        return float(h @ energy)

    def work_of(self, state, z):
        """Of what drags the rod and has no energy, along a displacement ``z``: less what its energy would be the slope of."""
        drags = [numbers for law, *numbers in self.rod["loads"] if law == "drag"]
        if not drags:
            return 0.0
        before = self.rod["loads"], self.rod["medium"]
        self.rod |= {"loads": [("drag", *drags[0])], "medium": None}
        g, H = np.zeros(self.graph.size), np.zeros((self.graph.size, self.graph.size))
        self.medium_of(state, g, H)
        self.rod |= {"loads": before[0], "medium": before[1]}
        return float(g @ z)


def well(off, turns, frame, k, c):
    """Of springs ``k r + c r^3``, what acts against them, its changes with the place and the turn, and their energy."""
    square = np.sum(off**2, axis=1)
    stiff = k + c * square
    curve = stiff[:, None, None] * np.eye(3) + 2 * c * off[:, :, None] * off[:, None, :]
    return stiff[:, None] * off, curve, np.zeros_like(curve), 0.5 * k * square + 0.25 * c * square**2


def drag(off, turns, frame, along, across, flow=(1.0, 0.5, -0.2)):
    """The same of a fluid that flows by, without an energy."""
    w, t = frame @ np.array(flow), turns[:, :, 2]
    dt = -turns @ hat(AXIS)
    push = (along - across) * (t @ w)[:, None] * t + across * w
    by_turn = (along - across) * (t[:, :, None] * (w @ dt)[:, None, :] + (t @ w)[:, None, None] * dt)
    return -push, np.zeros_like(dt), -by_turn, np.zeros(len(t))


def springs(off, turns, frame, k, rest, keel):
    """The same of springs that are ``rest`` from the line without force, and of a keel: with what turns it, and where on it."""
    size = np.sqrt(np.sum(off**2, axis=1) + rest**2)
    stiff = k * (1 - rest / size)
    curve = stiff[:, None, None] * np.eye(3) + (k * rest / size**3)[:, None, None] * off[:, :, None] * off[:, None, :]
    energy = k * (0.5 * np.sum(off**2, axis=1) - rest * size) - keel * turns[:, :, 0] @ frame[:, 1]
    return stiff[:, None] * off, curve, np.zeros_like(curve), energy, -keel * frame[:, 1], np.array([1.0, 0, 0])


LAWS = {"well": well, "drag": drag, "springs": springs}


def _both(H, rows, columns, value):
    H[np.ix_(rows, columns)] += value
    H[np.ix_(columns, rows)] += value.T
