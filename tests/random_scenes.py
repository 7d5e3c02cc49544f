"""Robots and loads at the extremes of what can be asked, drawn by lot: the same seed draws the same scene."""

from dataclasses import dataclass
from typing import Any

import numpy as np

import multirod as mr


@dataclass(frozen=True)
class Scene:
    """A robot, its inputs, and the numbers that it was made of.

    Attributes:
        kind: Scenes of one kind share their kernels.
        robot: Of the package.
        inputs: Of the package.
        rods: Sections of each rod, dictionaries of ``mr.Section``'s arguments.
        loads: What acts, named as the inputs.
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


KINDS = dict.fromkeys(SINGLE, single_rod)


def draw(kind, seed):
    """The scene of a kind and a seed."""
    return KINDS[kind](kind, np.random.default_rng([seed, list(KINDS).index(kind)]))
