"""Robots and loads at the extremes of what can be asked, drawn by lot: the same seed draws the same scene."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from meant import meant

import multirod as mr


@dataclass(frozen=True)
class Scene:
    """A robot, its inputs, and the numbers that it was made of.

    Attributes:
        kind: Scenes of one kind share their kernels.
        robot: Of the package.
        inputs: Of the package.
        rods: Sections of each rod, dictionaries of ``mr.Section``'s arguments.
        loads: What acts, named as the inputs, and what else places the rods.
        load: Largest load in units of the softest bending stiffness and the length.
    """

    kind: str
    robot: mr.Assembly
    inputs: mr.Inputs
    rods: list[list[dict[str, Any]]]
    loads: dict[str, Any]
    load: float


def log_uniform(rng, low, high):
    """A number whose logarithm is uniform."""
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))


def direction(rng):
    """A unit vector, none preferred."""
    v = rng.normal(size=3)
    return v / np.linalg.norm(v)


def rod_sections(rng, length, *, shear, largest_load):
    """One to five sections: jumps, turns, stiffness ratios to 1e6 either way, some sections of 1e-12 m."""
    count = int(rng.integers(1, 6)) if rng.random() < 0.4 else 1
    parts = rng.dirichlet(np.ones(count)) * length
    if count > 1 and rng.random() < 0.3:
        parts[rng.integers(count)] = 1e-12
    EI = log_uniform(rng, 1e-9, 1e6)
    extreme = rng.random() < 0.35
    across = log_uniform(rng, 1e-6, 1e6) if extreme and rng.random() < 0.5 else log_uniform(rng, 0.3, 3)
    twist = log_uniform(rng, 1e-6, 1e6) if extreme else log_uniform(rng, 0.3, 1)
    turns = log_uniform(rng, 1e-3, 30) if rng.random() < 0.3 else log_uniform(rng, 1e-3, 0.5)
    slenderness = max(log_uniform(rng, 10, 1e4), np.sqrt(2 * largest_load))
    sections = []
    for part in parts:
        jump = log_uniform(rng, 0.2, 5) if count > 1 else 1.0
        bending = EI * jump * np.array([1.0, across])
        section = {
            "length": float(part),
            "bending_stiffness": tuple(bending),
            "torsional_stiffness": float(EI * jump * twist),
            "precurvature": tuple(2 * np.pi * turns / length * direction(rng)),
            "linear_density": float(rng.uniform(0.2, 1)),
        }
        if shear:
            EA = bending.max() * slenderness**2 / length**2
            section |= {"shear_stiffness": EA / 2.6, "axial_stiffness": EA}
        sections.append(section)
    return sections


SINGLE = {
    "force": (("tip_force",), False),
    "all dead": (("tip_force", "tip_moment", "distributed_moment", "gravity"), True),
    "force and shear": (("tip_force",), True),
    "moment": (("tip_moment",), False),
    "follower": (("follower_force", "follower_moment"), False),
    "weight": (("tip_force", "distributed_force", "gravity"), False),
}
POWER = {"tip_force": 2, "follower_force": 2, "tip_moment": 1, "follower_moment": 1}
POWER |= {"distributed_force": 3, "distributed_moment": 2, "gravity": 3}


def single_rod(kind, rng):
    """One rod, from a micrometre to a kilometre long, under loads of up to 1e4, some 1e6, EI/L^2."""
    names, shear = SINGLE[kind]
    length = log_uniform(rng, 1e-6, 1e3) if rng.random() < 0.2 else log_uniform(rng, 1e-2, 1)
    largest = log_uniform(rng, 1e4, 1e6) if rng.random() < 0.05 else log_uniform(rng, 1e-2, 1e4)
    sections = rod_sections(rng, length, shear=shear, largest_load=largest)
    EI = min(min(s["bending_stiffness"]) for s in sections)
    weight = max(s["linear_density"] for s in sections)
    loads = {}
    for k, name in enumerate(rng.permutation(names)):
        share = largest if k == 0 else largest * rng.random()
        if "moment" in name:  # a moment winds a rod up by one turn for each 2 pi EI/L
            share = min(share, log_uniform(rng, 0.1, 60))
        loads[str(name)] = share * EI / length ** POWER[name] / (weight if name == "gravity" else 1.0) * direction(rng)
    robot = mr.SingleRod(mr.Rod(sections=[mr.Section(**s) for s in sections]))
    return Scene(kind, robot, robot.inputs(**loads), [sections], loads, largest)


TUBES = {"two tubes": (2, True), "two tubes, no load": (2, False), "three tubes": (3, True), "four tubes, no load": (4, False)}


def concentric_tubes(kind, rng):
    """Tubes precurved by up to three turns, many nearly opposite, some that end 1e-10 m apart."""
    count, loaded = TUBES[kind]
    length = log_uniform(rng, 1e-3, 10)
    EI = log_uniform(rng, 1e-6, 1e2) * np.cumprod([1.0, *(log_uniform(rng, 0.5, 10) for _ in range(count - 1))])
    beta = -np.sort(rng.uniform(0, 0.3, count))[::-1] * length
    if rng.random() < 0.2:
        beta = beta * 1e-9  # hardly any room to twist behind the plate
    reach = np.sort(rng.uniform(0.1, 1, count))[::-1] * length
    if rng.random() < 0.2:
        reach[-1] = reach[-2] - log_uniform(rng, 1e-12, 1e-6) * length
    rods = []
    for k in range(count):
        bend = log_uniform(rng, 0.1, 20) / length
        precurvature = (bend, rng.uniform(-0.3, 0.3) * bend, rng.uniform(-1, 1) * bend * (rng.random() < 0.3))
        stiffness = {"bending_stiffness": float(EI[k]), "torsional_stiffness": float(EI[k] * log_uniform(rng, 0.2, 2))}
        whole = reach[k] - beta[k]
        straight = whole * rng.uniform(0.05, 0.9)
        rods.append(
            [
                {"length": float(straight), "precurvature": (0.0, 0.0, 0.0)} | stiffness,
                {"length": float(whole - straight), "precurvature": precurvature} | stiffness,
            ]
        )
    alpha = rng.uniform(-np.pi, np.pi, count)
    if rng.random() < 0.3:
        alpha[1] = alpha[0] + np.pi - log_uniform(rng, 1e-8, 0.3)
    load = log_uniform(rng, 1e-3, 30) if loaded else 0.0
    force = load * EI[0] / length**2 * direction(rng)
    robot = mr.ConcentricTubes([mr.Rod(sections=[mr.Section(**s) for s in sections]) for sections in rods])
    inputs = {"rotation": alpha, "translation": beta} | ({"tip_force": force} if loaded else {})
    return Scene(kind, robot, robot.inputs(**inputs), rods, {"tip_force": force, "rotation": alpha, "translation": beta}, load)


LEGS = {"two legs": 2, "three legs": 3, "six legs": 6, "eight legs": 8}


def parallel_rods(kind, rng):
    """Legs on a platform, from soft to stiff by up to 1e6 to 1, under a wrench."""
    count = LEGS[kind]
    length = log_uniform(rng, 1e-2, 10)
    EI = log_uniform(rng, 1e-6, 1e2)
    spread = log_uniform(rng, 1, 1e6) if rng.random() < 0.4 else 3.0
    rods = []
    for _ in range(count):
        bending = EI * log_uniform(rng, 1, spread) * np.array([1.0, log_uniform(rng, 0.5, 2)])
        EA = bending.max() * log_uniform(rng, 20, 1e3) ** 2 / length**2
        section = {
            "length": float(length * rng.uniform(0.8, 1.2)),
            "bending_stiffness": tuple(bending),
            "torsional_stiffness": float(bending.mean() * log_uniform(rng, 0.3, 1)),
            "precurvature": tuple(rng.uniform(-1, 1, 3) * log_uniform(rng, 1e-2, 2) / length),
            "shear_stiffness": EA / 2.6,
            "axial_stiffness": EA,
        }
        rods.append([section])
    poses = []
    for radius, tilt in ((rng.uniform(0.1, 0.5), 0.2), (rng.uniform(0.05, 0.5), 0.2)):
        pose = np.tile(np.eye(4), (count, 1, 1))
        for k in range(count):
            angle = 2 * np.pi * k / count + rng.uniform(-0.3, 0.3)
            pose[k, :3, :3] = _turn(2, angle) @ _turn(1, rng.uniform(-tilt, tilt))
            pose[k, :3, 3] = radius * length * np.array([np.cos(angle), np.sin(angle), 0])
        poses.append(pose)
    load = log_uniform(rng, 1e-2, 100)
    stiff = sum(rod[0]["bending_stiffness"][0] for rod in rods)
    loads = {
        "tip_force": load * stiff / length**2 * direction(rng),
        "tip_moment": (rng.random() < 0.5) * min(load, 2.0) * rng.random() * stiff / length * direction(rng),
    }
    robot = mr.ParallelRods(
        legs=[mr.Rod(sections=[mr.Section(**s) for s in sections]) for sections in rods], base=poses[0], platform=poses[1]
    )
    return Scene(kind, robot, robot.inputs(**loads), rods, loads | {"base": poses[0], "platform": poses[1]}, load)


def _turn(axis, angle):
    c, s = np.cos(angle), np.sin(angle)
    R = np.eye(3)
    i, j = ((1, 2), (2, 0), (0, 1))[axis]
    R[i, i], R[i, j], R[j, i], R[j, j] = c, -s, s, c
    return R


KINDS = dict.fromkeys(SINGLE, single_rod) | dict.fromkeys(TUBES, concentric_tubes) | dict.fromkeys(LEGS, parallel_rods)


@meant()
def draw(kind, seed):
    """The scene of a kind and a seed."""
    return KINDS[kind](kind, np.random.default_rng([seed, list(KINDS).index(kind)]))
