"""Networks drawn by lot, with their loads, and the same in the numbers of ``network_energy``."""

from dataclasses import dataclass

import numpy as np
from network_energy import Rods, exp, log, turned

import multirod as mr

EI, GJ, MASS = 60e9 * np.pi * 2e-3**4 / 64, 23e9 * np.pi * 2e-3**4 / 32, 6450 * np.pi * 1e-6
KINDS = ("clamped", "clamped", "revolute", "universal", "spherical")
AXES = {"clamped": np.zeros((0, 3)), "revolute": np.eye(3)[:1], "universal": np.eye(3)[:2], "spherical": np.eye(3)}


@dataclass(frozen=True)
class Drawn:
    """A network and its inputs, the same in the numbers of ``network_energy``, and where its bodies are, about."""

    robot: mr.Network
    inputs: mr.Inputs
    names: tuple[str, ...]
    numbers: dict
    places: np.ndarray

    @property
    def bodies(self):
        """Names of those that move."""
        return tuple(body.name for body in self.robot.bodies)

    @property
    def potential(self):
        """Whether the loads have one."""
        return not any(body["moment"].any() for body in self.numbers["bodies"])

    def rods(self, segments):
        """The numbers as ``network_energy`` takes them."""
        return Rods(segments=segments, **self.numbers)


def _frame(z, rng):
    """A frame whose z is nearly this, rolled a little."""
    x = np.cross([0.3, 1.0, 0.2], z)
    x /= np.linalg.norm(x)
    return np.stack([x, np.cross(z, x), z], axis=1) @ exp(rng.normal(0, 0.15, 3))


def draw(seed, most_rods=12, most_bodies=4, load=1.0):
    """A network, with closed loops, all joints and loads; one in which something is free to move is drawn again."""
    rng = np.random.default_rng(seed)
    while True:
        try:
            return _draw(rng, most_rods, most_bodies, load)
        except ValueError as error:
            if "free to move" not in str(error):
                raise


def _draw(rng, most_rods, most_bodies, load):
    count = int(rng.integers(1, most_bodies + 1))
    joined = [(int(rng.integers(-1, k)) if k else -1, k) for k in range(count)]
    for _ in range(int(rng.integers(0, most_rods - count + 1))):
        k = int(rng.integers(0, count))
        joined.append((int(rng.integers(-1, k)) if k else -1, k))
    level = np.zeros(count)
    for near, far in joined[:count]:
        level[far] = 1 + (level[near] if near >= 0 else 0)
    places = np.stack([rng.normal(0, 0.06, count), rng.normal(0, 0.06, count), 0.2 * level], axis=1)
    gravity = np.array([0, 0, -9.81]) if rng.random() < 0.5 else np.zeros(3)
    bodies = [{"mass": float(rng.choice([0.0, 0.02])), "mass_centre": rng.normal(0, 0.01, 3)} for _ in range(count)]
    for own in bodies:
        own["mass_centre"] = own["mass_centre"] * (own["mass"] > 0)  # where nothing weighs there is none
    nodes = [
        mr.Body(f"b{k}", pose=_pose(np.eye(3), places[k]) if rng.random() < 0.7 else None, **own) for k, own in enumerate(bodies)
    ]
    rods, joints, numbers, rotation = {}, [], [], {}
    loose = [k for k in range(count) if rng.random() < 0.15]
    for number, (near, far) in enumerate([*joined, *((k, None) for k in loose)]):
        name, ends = f"r{number}", []
        if far is not None and near >= 0 and rng.random() < 0.3:
            near, far = far, near
        spots = [rng.normal(0, 0.04, 3) * [1, 1, 0.2] for _ in (0, 1)]
        start = spots[0] + (places[near] if near >= 0 else 0)
        stop = start + [0, 0, 0.15] if far is None else spots[1] + (places[far] if far >= 0 else 0)
        chord = stop - start
        length = float(np.linalg.norm(chord) * rng.uniform(1.0, 1.1))
        bent = rng.normal(0, 2.0, 3) * [1, 1, 0.0] if rng.random() < 0.5 else np.zeros(3)
        bodies_of = (near, far)
        for end, spot in zip(("base", "tip"), spots, strict=True):
            to = bodies_of[end == "tip"]
            if to is None:
                ends.append(None)
                continue
            kind = str(rng.choice(KINDS))
            axes = AXES[kind]
            sprung = kind != "clamped" and rng.random() < 0.3
            stiffness = 0.2 * EI / length if sprung else 0.0
            rest = 0.2 if sprung and kind != "spherical" else 0.0
            frame = _frame(chord / np.linalg.norm(chord), rng)
            ends.append(
                {
                    "body": to,
                    "position": spot,
                    "frame": frame,
                    "count": len(axes),
                    "axes": axes,
                    "springs": np.full(len(axes), stiffness),
                    "rest": np.full(len(axes), rest),
                }
            )
            options = {"axis": axes[0] if kind == "revolute" else axes} if kind in ("revolute", "universal") else {}
            holder = mr.ground if to < 0 else nodes[to]
            joints.append(
                mr.Joint(name, end, to=holder, pose=_pose(frame, spot), kind=kind, stiffness=stiffness, rest=rest, **options)
            )
        rods[name] = mr.Rod(
            length=length, bending_stiffness=EI, torsional_stiffness=GJ, precurvature=tuple(bent), linear_density=MASS
        )
        rotation[name] = float(rng.normal(0, 0.5)) if rng.random() < 0.5 else 0.0
        numbers.append(
            {
                "length": length,
                "stiffness": np.array([EI, EI, GJ]),
                "curvature": bent,
                "rotation": rotation[name],
                "weight": MASS * gravity,
                "ends": tuple(ends),
            }
        )
    robot = mr.Network(rods=rods, bodies=nodes, joints=joints)
    mean = np.mean([own["length"] for own in numbers])
    unit = EI / mean**2
    force = {body.name: rng.normal(0, load * unit, 3) for body in nodes}
    moment = {body.name: rng.normal(0, 0.3 * load * unit * mean, 3) for body in nodes} if rng.random() < 0.2 else {}
    tips = {number: rng.normal(0, 0.5 * load * unit, 3) for number, own in enumerate(numbers) if own["ends"][1] is None}
    force |= {f"r{number}": value for number, value in tips.items()}
    inputs = robot.inputs(force=force, rotation=rotation, gravity=gravity, **({"moment": moment} if moment else {}))
    loads = [
        {
            "force": force[body.name],
            "moment": moment.get(body.name, np.zeros(3)),
            "weight": own["mass"] * gravity,
            "centre": own["mass_centre"],
        }
        for body, own in zip(nodes, bodies, strict=True)
    ]
    return Drawn(robot, inputs, tuple(rods), {"rods": numbers, "bodies": loads, "tips": tips}, places)


def _pose(R, p):
    result = np.eye(4)
    result[:3, :3], result[:3, 3] = R, p
    return result


def _angles(end, E):
    """Those of a joint that turns as nearly by ``E`` as it can."""
    axes = end["axes"]
    if end["count"] == 0:
        return np.zeros(0)
    if end["count"] == 3:
        return log(E)
    if end["count"] == 1:
        return np.array([axes[0] @ log(E)])
    third = np.cross(axes[0], axes[1])
    first, second = E @ axes[1], E.T @ axes[0]
    return np.array([np.arctan2(third @ first, axes[1] @ first), np.arctan2(third @ second, axes[0] @ second)])


def _wound(end, E, R, moment, sense):
    """The same with the turns that its springs have been wound by: those whose torque is that of the ``moment`` in the world."""
    angles = _angles(end, E)
    if not end["springs"].any():
        return angles
    torque = (R @ turned(end["count"], end["axes"], angles)[1]).T @ moment
    due = end["rest"] - sense * torque / end["springs"]
    if end["count"] == 3:  # the same turn about the same axis, whole turns further
        axis = angles / np.linalg.norm(angles)
        return angles + 2 * np.pi * np.round(axis @ (due - angles) / (2 * np.pi)) * axis
    return angles + 2 * np.pi * np.round((due - angles) / (2 * np.pi))


def state_of(drawn, solution, segments, aside=0.0, seed=0):
    """Where ``network_energy`` begins: the middles of segments as a solution has them, all turned ``aside`` by lot [rad]."""
    rng = np.random.default_rng(seed)
    rods = drawn.rods(segments)
    frames = [np.array(solution.body_rotation(body.name)) for body in drawn.robot.bodies]
    positions = [np.array(solution.body_position(body.name)) for body in drawn.robot.bodies]
    rotations, angles = [], []
    for name, own in zip(drawn.names, drawn.numbers["rods"], strict=True):
        shape = solution.rod(name, nodes=2 * segments + 1)
        R, moment = shape.rotation, (shape.rotation @ shape.moment[..., None])[..., 0]
        rotations.append(np.array(R[1::2]))
        found = []
        turns = R[0] @ exp(np.array([0, 0, -own["rotation"]])), R[-1]
        for end, turn, pull, sense in zip(own["ends"], turns, moment[[0, -1]], (-1, 1), strict=True):
            if end is None:
                found.append(np.zeros(0))
                continue
            holder = frames[end["body"]] if end["body"] >= 0 else np.eye(3)
            found.append(_wound(end, (holder @ end["frame"]).T @ turn, turn, pull, sense))
        angles.append(found)
    state = rotations, angles, positions, frames, [None if at is None else np.zeros(3) for at in rods.force_at]
    z = np.zeros(rods.size)
    z[: rods.free] = aside * rods.scales()[0][: rods.free] * rng.standard_normal(rods.free)
    state = rods.moved(state, z)
    # the forces that leave least of the gradient
    g, H = rods.system(state)
    forces = np.linalg.lstsq(H[: rods.free, rods.free :], -g[: rods.free], rcond=None)[0]
    z[:] = 0.0
    z[rods.free :] = forces
    return rods, rods.moved(state, z)


def violation(drawn, solution):
    """By how much what rods, bodies and joints say of each other disagrees: gaps over the length, forces and moments over
    ``EI/L^2`` and ``EI/L``; from poses, and from forces and moments at the ends of rods alone."""
    own = drawn.numbers["rods"]
    length = np.mean([rod["length"] for rod in own])
    frames = [solution.body_rotation(body.name) for body in drawn.robot.bodies]
    positions = [solution.body_position(body.name) for body in drawn.robot.bodies]
    force = [-(body["force"] + body["weight"]) for body in drawn.numbers["bodies"]]
    moment = [
        -(body["moment"] + np.cross(R @ body["centre"], body["weight"]))
        for body, R in zip(drawn.numbers["bodies"], frames, strict=True)
    ]
    worst = 0.0
    for k, (name, rod) in enumerate(zip(drawn.names, own, strict=True)):
        shape = solution.rod(name, nodes=2)
        pulls = (shape.rotation @ shape.force[..., None])[..., 0] * length**2 / EI
        turns = (shape.rotation @ shape.moment[..., None])[..., 0] * length / EI
        worst = max(worst, np.abs(pulls[0] - pulls[1] - rod["length"] * rod["weight"] * length**2 / EI).max())
        rolled = shape.rotation[0] @ exp(np.array([0, 0, -rod["rotation"]]))
        for end, p, R, pull, turn, sense in zip(
            rod["ends"], shape.position, (rolled, shape.rotation[1]), pulls, turns, (-1, 1), strict=True
        ):
            if end is None:
                given = drawn.numbers["tips"][k] * length**2 / EI
                worst = max(worst, np.abs(pull - given).max(), np.abs(turn).max())
                continue
            b = end["body"]
            holder, place = (frames[b], positions[b]) if b >= 0 else (np.eye(3), np.zeros(3))
            frame, arm = holder @ end["frame"], holder @ end["position"]
            angles = _wound(end, frame.T @ R, R, turn * EI / length, sense)
            E, G = turned(end["count"], end["axes"], angles)
            torque = (R @ G).T @ turn + sense * end["springs"] * (angles - end["rest"]) * length / EI
            worst = max(
                worst, np.abs(p - place - arm).max() / length, np.abs(frame @ E - R).max(), np.abs(torque).max(initial=0.0)
            )
            if b >= 0:
                force[b] = force[b] + sense * pull * EI / length**2
                moment[b] = moment[b] + sense * (turn * EI / length + np.cross(arm, pull * EI / length**2))
    balances = [np.abs(np.array(force)) * length**2 / EI, np.abs(np.array(moment)) * length / EI]
    return float(max(worst, *(own.max() for own in balances)))
