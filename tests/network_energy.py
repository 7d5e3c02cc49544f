"""The energy of a network by itself: rods as chains of rigid segments, written anew, for comparison.

Nothing of the package's integration, joints or elements is used. A rod of ``M`` segments of length ``h`` stores, between segments
that are turned against each other by ``phi``, the energy ``|phi/h - u*|^2_K h/2``; half of a segment stands between its first and
last and the frames of its joints. Tips are where bodies are by forces, the multipliers of their gaps. The error is of the second
order in ``h``: ``extrapolated`` takes it off. Equilibria are found by Newton's method on the Lagrangian.
"""

import numpy as np

AXIS = np.array([0.0, 0.0, 1.0])
STEP = 1e-5  # of differences of gradients: rounding over it is 1e-11
NEUTRAL = 1e-10  # eigenvalues, of the energy's unit, that cannot be told from nothing: what symmetry leaves free is some 1e-12


def hat(v):
    """Cross products by vectors (..., 3)."""
    x, y, z = np.moveaxis(v, -1, 0)
    o = np.zeros_like(x)
    return np.stack([np.stack([o, -z, y], -1), np.stack([z, o, -x], -1), np.stack([-y, x, o], -1)], -2)


def exp(v):
    """Rotations by rotation vectors (..., 3)."""
    angle = np.linalg.norm(v, axis=-1)[..., None, None]
    S = hat(v)
    return np.eye(3) + np.sinc(angle / np.pi) * S + 0.5 * np.sinc(angle / (2 * np.pi)) ** 2 * (S @ S)


def log(R):
    """Rotation vectors of rotations (..., 3, 3), by quaternions."""
    q = np.empty((*R.shape[:-2], 4))
    trace = np.trace(R, axis1=-2, axis2=-1)
    # the column of q q^T whose diagonal is largest
    Q = np.empty((*R.shape[:-2], 4, 4))
    Q[..., 0, 0] = 1 + trace
    axial = np.stack([R[..., 2, 1] - R[..., 1, 2], R[..., 0, 2] - R[..., 2, 0], R[..., 1, 0] - R[..., 0, 1]], -1)
    Q[..., 0, 1:], Q[..., 1:, 0] = axial, axial
    Q[..., 1:, 1:] = R + np.swapaxes(R, -1, -2) + (1 - trace)[..., None, None] * np.eye(3)
    best = np.argmax(np.diagonal(Q, axis1=-2, axis2=-1), axis=-1)
    q = np.take_along_axis(Q, best[..., None, None], axis=-1)[..., 0]
    q = q / np.linalg.norm(q, axis=-1, keepdims=True)
    q = np.where(q[..., :1] < 0, -q, q)
    size = np.linalg.norm(q[..., 1:], axis=-1, keepdims=True)
    return np.where(size > 1e-12, 2 * np.arctan2(size, q[..., :1]) / np.maximum(size, 1e-300), 2.0) * q[..., 1:]


def right_inverse(v):
    """How a rotation vector changes as its rotation is turned about its own axes, (..., 3, 3)."""
    a = np.linalg.norm(v, axis=-1)[..., None, None]
    small = a < 1e-3
    safe = np.where(small, 1.0, a)
    c = np.where(small, 1 / 12 + a**2 / 720, (1 - safe / 2 / np.tan(safe / 2)) / safe**2)
    S = hat(v)
    return np.eye(3) + 0.5 * S + c * (S @ S)


def turned(count, axes, angles):
    """Rotation of a joint, and how it is turned about its own axes by its angles, (3, count)."""
    if count == 0:
        return np.eye(3), np.zeros((3, 0))
    if count == 3:
        return exp(angles), np.linalg.inv(right_inverse(angles))
    second = exp(axes[1] * angles[1]) if count == 2 else np.eye(3)
    first = exp(axes[0] * angles[0])
    return first @ second, np.stack([second.T @ axes[0], *axes[1:count]], axis=1)


def damped_newton(model, state, scale, unit, steps, tolerance):
    """An equilibrium of a model near a state by Newton's method, damped; None if there is none. And its unstable modes, without
    neutral ones, and how far the next is. What counts as one in each variable is ``scale``, in the energy ``unit``."""
    g, H = model.system(state)
    for _ in range(steps):
        size = np.linalg.norm(g * scale)
        if size < tolerance * unit:
            values = np.linalg.eigvalsh(scale[:, None] * (H + H.T) / 2 * scale / unit)
            return state, int((values < -NEUTRAL).sum()) - (model.size - model.free), float(np.abs(values).min())
        try:
            step = -scale * np.linalg.solve(scale[:, None] * H * scale, scale * g)
        except np.linalg.LinAlgError:
            return None
        damping = min(1.0, 0.5 / max(np.abs(step / scale)[: model.free].max(), 1e-300))
        while True:
            trial = model.moved(state, damping * step)
            if model.is_possible(trial):
                g_new, H_new = model.system(trial)
                if np.linalg.norm(g_new * scale) < (1 - 1e-3 * damping) * size:
                    break
            damping *= 0.5
            if damping < 1e-4:
                return None
        state, g, H = trial, g_new, H_new
    return None


class Rods:
    """A network in numbers, as a benchmark draws it.

    Args:
        rods: Of each: ``length``, ``stiffness`` (3,), ``curvature`` (3,), ``rotation`` at its base, ``weight`` (3,) [N/m], and
            ``ends``: of base and tip body (-1 the ground, None free), position (3,), frame (3, 3), count of angles, axes (count,
            3), springs and rest angles (count,).
        bodies: Of each: ``force``, ``moment``, ``weight`` (3,) and ``centre`` (3,).
        tips: Forces on free tips by rod.
        segments: Of each rod.
    """

    def __init__(self, rods, bodies, tips, segments):
        self.rods, self.bodies, self.tips, self.M = rods, bodies, tips, segments
        self.at, size = [], 0
        for rod in rods:
            spots = [slice(size, size := size + 3 * segments)]
            for end in rod["ends"]:
                spots.append(slice(size, size := size + (0 if end is None else end["count"])))
            self.at.append(spots)
        self.body_at = [slice(size + 6 * k, size + 6 * k + 6) for k in range(len(bodies))]
        size += 6 * len(bodies)
        self.free = size
        self.force_at = []
        for rod in rods:
            self.force_at.append(None if rod["ends"][1] is None else slice(size, size := size + 3))
        self.size = size

    def moved(self, state, z):
        """A state displaced by ``z`` (size,): segments and bodies turned about their own axes."""
        rotations, angles, positions, frames, forces = state
        return (
            [R @ exp(z[at[0]].reshape(-1, 3)) for R, at in zip(rotations, self.at, strict=True)],
            [[a + z[s] for a, s in zip(own, at[1:], strict=True)] for own, at in zip(angles, self.at, strict=True)],
            [p + z[at][:3] for p, at in zip(positions, self.body_at, strict=True)],
            [R @ exp(z[at][3:]) for R, at in zip(frames, self.body_at, strict=True)],
            [None if at is None else n + z[at] for n, at in zip(forces, self.force_at, strict=True)],
        )

    def system(self, state):
        """Gradient of the Lagrangian, then gaps (size,), and their derivative (size, size)."""
        g, H = np.zeros(self.size), np.zeros((self.size, self.size))
        rotations, angles, _, frames, _ = state
        for k, rod in enumerate(self.rods):
            h = rod["length"] / self.M
            K, bent, R = np.asarray(rod["stiffness"]), np.asarray(rod["curvature"]), rotations[k]
            first = self.at[k][0].start
            if self.M > 1:
                local, slope = _pairs(R[:-1], R[1:], K, bent, h)
                for i in range(self.M - 1):
                    own = slice(first + 3 * i, first + 3 * i + 6)
                    g[own] += local[i]
                    H[own, own] += slope[i]
            for which, end in enumerate(rod["ends"]):
                if end is None:
                    continue
                segment = first + (0 if which == 0 else 3 * (self.M - 1))
                b = end["body"]
                holder = frames[b] if b >= 0 else np.eye(3)
                places = [segment + np.arange(3), np.arange(self.at[k][1 + which].start, self.at[k][1 + which].stop)]
                if b >= 0:
                    places.append(np.arange(self.body_at[b].start + 3, self.body_at[b].stop))
                at = np.concatenate(places)
                local, slope = _end(R[0 if which == 0 else -1], angles[k][which], holder, end, rod, which, K, bent, h)
                g[at] += local[: len(at)]
                H[np.ix_(at, at)] += slope[: len(at), : len(at)]
            self._pull(k, rod, h, state, g, H)
        for k, body in enumerate(self.bodies):
            at, R = self.body_at[k], frames[k]
            g[at.start : at.start + 3] -= body["force"] + body["weight"]
            turn = slice(at.start + 3, at.stop)
            _linear(g, H, turn, R, -body["weight"], body["centre"])
            g[turn] -= R.T @ body["moment"]
            H[turn, turn] -= hat(R.T @ body["moment"])
        return g, H

    def _pull(self, k, rod, h, state, g, H):
        """Forces on tips and along rods, and the gaps that they close."""
        rotations, _, positions, frames, forces = state
        M, R, first = self.M, rotations[k], self.at[k][0].start
        base, tip = rod["ends"]
        held = tip is not None
        n = forces[k] if held else -np.asarray(self.tips.get(k, np.zeros(3)))  # its sign: energy + n . (tip - goal)
        along = h * np.eye(3)
        share = h * (M - np.arange(M) - 0.5)
        lever = rod["ends"][0]["position"]
        for i in range(M):
            own = slice(first + 3 * i, first + 3 * i + 3)
            _linear(g, H, own, R[i], h * (n - share[i] * rod["weight"]), AXIS)
            if held:
                by = along @ R[i] @ -hat(AXIS)
                H[own, self.force_at[k]] += by.T
                H[self.force_at[k], own] += by
        gap = h * R[:, :, 2].sum(axis=0)
        total = n - rod["length"] * rod["weight"]
        for end, sense, pull, arm in ((base, 1.0, total, lever), (tip, -1.0, n, None if tip is None else tip["position"])):
            if end is None:
                continue
            b = end["body"]
            gap = gap + sense * (arm if b < 0 else positions[b] + frames[b] @ arm)
            if b < 0:
                continue
            at = self.body_at[b]
            place, turn = slice(at.start, at.start + 3), slice(at.start + 3, at.stop)
            g[place] += sense * pull
            _linear(g, H, turn, frames[b], sense * pull, arm)
            if held:
                by = sense * np.concatenate([np.eye(3), frames[b] @ -hat(arm)], axis=1)
                H[at, self.force_at[k]] += by.T
                H[self.force_at[k], at] += by
        if held:
            g[self.force_at[k]] += gap

    @staticmethod
    def positions(state):
        """Of bodies (bodies, 3)."""
        return np.array(state[2])

    def scales(self):
        """What counts as one in each variable: 1 of an angle, a length, a force."""
        length = np.mean([rod["length"] for rod in self.rods])
        stiffness = np.mean([rod["stiffness"][0] for rod in self.rods])
        scale = np.ones(self.size)
        for at in self.body_at:
            scale[at.start : at.start + 3] = length
        scale[self.free :] = stiffness / length**2
        return scale, stiffness / length

    def settled(self, state, steps=60, tolerance=1e-9):
        """An equilibrium near a state, as ``damped_newton`` says."""
        return damped_newton(self, state, *self.scales(), steps, tolerance)

    def is_possible(self, state):
        """All are."""
        return True

    def energy(self, state):
        """Of the Lagrangian [J]; moments have none and are left out."""
        rotations, angles, positions, frames, forces = state
        total = 0.0
        for k, rod in enumerate(self.rods):
            h, R, n = rod["length"] / self.M, rotations[k], forces[k]
            K, bent = np.asarray(rod["stiffness"]), np.asarray(rod["curvature"])
            total += _stored(R[:-1], R[1:], K, bent, h)
            tip = np.zeros(3)
            for which, end in enumerate(rod["ends"]):
                if end is None:
                    continue
                holder = frames[end["body"]] if end["body"] >= 0 else np.eye(3)
                frame = holder @ end["frame"] @ turned(end["count"], end["axes"], angles[k][which])[0]
                pair = (frame @ _roll(rod["rotation"]), R[0]) if which == 0 else (R[-1], frame)
                total += _stored(*pair, K, bent, h / 2)
                total += 0.5 * np.sum(end["springs"] * (angles[k][which] - end["rest"]) ** 2)
                place = holder @ end["position"] + (positions[end["body"]] if end["body"] >= 0 else 0.0)
                tip = tip + (place if which == 0 else -place)
            share = h * (self.M - np.arange(self.M) - 0.5)
            base = rod["ends"][0]
            start = base["position"] if base["body"] < 0 else positions[base["body"]] + frames[base["body"]] @ base["position"]
            total -= rod["weight"] @ (rod["length"] * start + h * share @ R[:, :, 2])
            tip = tip + h * R[:, :, 2].sum(axis=0)
            total += n @ tip if n is not None else -np.asarray(self.tips.get(k, np.zeros(3))) @ tip
        for body, p, R in zip(self.bodies, positions, frames, strict=True):
            total -= body["force"] @ p + body["weight"] @ (p + R @ body["centre"])
        return float(total)

    def descended(self, state, rounds=8, steps=60):
        """A stable equilibrium by descent from any state: of the energy with gaps that are stiff springs, the stiffer the longer,
        whose forces become the multipliers; None if there is none."""
        scale, unit = self.scales()
        free, at = slice(0, self.free), slice(self.free, self.size)
        length = scale[self.body_at[0].start] if self.body_at else 1.0
        stiff = 100.0 * unit / length**2
        scale = scale[free]
        held = [np.zeros(3) if n is None else n for n in state[4]]
        for _ in range(rounds):

            def pulled(state, held=held, stiff=stiff):
                """With the forces of the springs as multipliers, and the energy."""
                gaps = self._gaps(state)
                forces = [None if a is None else n + stiff * gap for a, n, gap in zip(self.force_at, held, gaps, strict=True)]
                state = (*state[:4], forces)
                stored = sum(0.5 * stiff * gap @ gap for a, gap in zip(self.force_at, gaps, strict=True) if a is not None)
                return state, self.energy(state) - stored

            state, value = pulled(state)
            for _ in range(steps):
                g, H = self.system(state)
                J = H[at, free]
                values, modes = np.linalg.eigh(scale[:, None] * (H[free, free] + stiff * J.T @ J) * scale / unit)
                slope = modes.T @ (scale * g[free]) / unit
                if np.linalg.norm(slope) < 1e-7:
                    break
                step = scale * (modes @ (-slope / np.maximum(np.abs(values), 1e-4)))
                damping = min(1.0, 0.3 / np.abs(step / scale).max())
                while damping > 1e-6:
                    z = np.zeros(self.size)
                    z[free] = damping * step
                    trial, less = pulled(self.moved(state, z))
                    if less < value - 1e-4 * damping * abs(slope @ (modes.T @ (step / scale))) * unit:
                        break
                    damping *= 0.5
                else:
                    break
                state, value = trial, less
            held = [np.zeros(3) if n is None else n for n in state[4]]
            worst = max(
                (np.abs(gap).max() for a, gap in zip(self.force_at, self._gaps(state), strict=True) if a is not None), default=0
            )
            if worst < 1e-3 * length:
                break
            stiff *= 3
        found = self.settled(state)
        return found if found is not None and found[1] == 0 else None

    def _gaps(self, state):
        """Of all rods, zero of those whose tips are free."""
        rotations, _, positions, frames, _ = state
        result = []
        for rod, R in zip(self.rods, rotations, strict=True):
            gap = rod["length"] / self.M * R[:, :, 2].sum(axis=0)
            for end, sense in zip(rod["ends"], (1.0, -1.0), strict=True):
                if end is None:
                    gap = np.zeros(3)
                elif end["body"] < 0:
                    gap = gap + sense * end["position"]
                else:
                    gap = gap + sense * (positions[end["body"]] + frames[end["body"]] @ end["position"])
            result.append(gap)
        return result

    def straight(self, positions):
        """Rods straight on their bases, bodies at ``positions``, joints not turned."""
        frames = [np.eye(3) for _ in self.bodies]
        rotations = []
        for rod in self.rods:
            first = rod["ends"][0]["frame"] @ _roll(rod["rotation"])
            rotations.append(np.repeat(first[None], self.M, axis=0))
        angles = [[np.zeros(0 if end is None else end["count"]) for end in rod["ends"]] for rod in self.rods]
        return (
            rotations,
            angles,
            [np.array(p) for p in positions],
            frames,
            [None if at is None else np.zeros(3) for at in self.force_at],
        )

    def refined(self, state):
        """The same network in twice as many segments, and a state of it."""
        finer = Rods(self.rods, self.bodies, self.tips, 2 * self.M)
        return finer, ([np.repeat(R, 2, axis=0) for R in state[0]], *state[1:])


def _roll(angle):
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])


def _stored(A, B, K, bent, h):
    """Energy between frames at a distance ``h``."""
    phi = log(np.swapaxes(A, -1, -2) @ B)
    return 0.5 * h * float(np.sum(K * (phi / h - bent) ** 2))


def _linear(g, H, at, R, a, c):
    """Add ``a . R c`` by a turn of ``R`` about its own axes."""
    b = R.T @ a
    g[at] += np.cross(c, b)
    H[at, at] += 0.5 * (np.outer(b, c) + np.outer(c, b)) - (b @ c) * np.eye(3)


def _spring(A, B, K, bent, h):
    """Gradients, by turns of both about their own axes, of the energy between frames at a distance ``h``."""
    phi = log(np.swapaxes(A, -1, -2) @ B)
    moment = K * (phi / h - bent)
    Jr = right_inverse(phi)
    # a turn of A about its axes is one of phi's left: its inverse Jacobian is the transpose
    return np.concatenate(
        [-np.einsum("...ij,...i->...j", np.swapaxes(Jr, -1, -2), moment), np.einsum("...ij,...i->...j", Jr, moment)], -1
    )


def _pairs(A, B, K, bent, h):
    slopes = []
    for i in range(6):
        turn = STEP * np.eye(6)[i]
        up = _spring(A @ exp(turn[:3]), B @ exp(turn[3:]), K, bent, h)
        down = _spring(A @ exp(-turn[:3]), B @ exp(-turn[3:]), K, bent, h)
        slopes.append((up - down) / (2 * STEP))
    slope = np.stack(slopes, axis=-1)
    return _spring(A, B, K, bent, h), 0.5 * (slope + np.swapaxes(slope, -1, -2))


def _end(R, angles, holder, end, rod, which, K, bent, h):
    """Half a segment between a joint and the segment beside it, and the spring of the joint: by the turn of the segment, the
    angles and the turn of the holder."""
    count = end["count"]

    def gradient(z):
        E, G = turned(count, end["axes"], angles + z[3 : 3 + count])
        frame = holder @ exp(z[3 + count :]) @ end["frame"] @ E
        segment = R @ exp(z[:3])
        if which == 0:
            roll = _roll(rod["rotation"])
            own = _spring(frame @ roll, segment, K, bent, h / 2)
            by_frame, by_segment = roll @ own[:3], own[3:]
        else:
            own = _spring(segment, frame, K, bent, h / 2)
            by_segment, by_frame = own[:3], own[3:]
        spring = np.asarray(end["springs"]) * (angles + z[3 : 3 + count] - np.asarray(end["rest"]))
        return np.concatenate([by_segment, G.T @ by_frame + spring, end["frame"] @ E @ by_frame])

    size = 6 + count
    slope = np.stack([(gradient(STEP * e) - gradient(-STEP * e)) / (2 * STEP) for e in np.eye(size)], axis=1)
    return gradient(np.zeros(size)), 0.5 * (slope + slope.T)
