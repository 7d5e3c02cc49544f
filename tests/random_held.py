"""Cables and rods between two holders under loads along them, drawn by lot: the same number draws the same scene."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from meant import meant
from random_scenes import direction, log_uniform
from scipy.spatial.transform import Rotation

import multirod as mr

HELD = {
    "two balls": {"base_joint": "spherical", "joint": "spherical"},
    "ball, clamp": {"base_joint": "spherical", "joint": "clamped"},
    "clamp, ball": {"base_joint": "clamped", "joint": "spherical"},
}
RODS = ("round", "strip", "wide strip", "bent", "uneven")
ENDS = ("slack", "nearly straight", "taut", "slides")
LOADS = ("weight", "force", "both", "along")


@dataclass(frozen=True)
class Drawn:
    """A rod, what holds it, and the numbers that it was made of.

    Attributes:
        robot: Of the package.
        inputs: Of the package.
        held: Which of ``HELD``.
        rod: Which of ``RODS``.
        ends: Which of ``ENDS``.
        acts: Which of ``LOADS``.
        sections: Of the rod, dictionaries of ``mr.Section``'s arguments.
        base: Pose of what holds the base, shape (4, 4).
        end: Pose of what holds the end, where it is moved to, shape (4, 4).
        slide: Direction in which the end slides, in its frame, or None.
        force: On the rod, per length [N/m], with its weight where all of it weighs the same, shape (3,).
        tip_force: Along the slide, shape (3,).
        load: All that acts on it in units of its softest bending stiffness and its length.
    """

    robot: mr.HeldRod
    inputs: mr.Inputs
    held: str
    rod: str
    ends: str
    acts: str
    sections: list[dict[str, Any]]
    base: np.ndarray
    end: np.ndarray
    slide: np.ndarray | None
    force: np.ndarray
    tip_force: np.ndarray
    load: float


@meant()
def draw(number: int, seed: int = 0, held: str = "two balls", most_load: float = 100.0) -> Drawn:
    """A rod that is round or not, bent at rest or not, from slack to taut, under its weight, a force along it, or both."""
    rng = np.random.default_rng([seed, number, list(HELD).index(held)])
    kind, ends, acts = (names[k % len(names)] for names, k in ((RODS, number), (ENDS, number // 5), (LOADS, number // 20)))
    length, EI, weight = log_uniform(rng, 0.05, 1), log_uniform(rng, 1e-3, 1), log_uniform(rng, 0.01, 1)
    stretches = ends == "taut" or rng.random() < 0.3
    across = {"round": 1.0, "strip": rng.uniform(1.1, 3), "wide strip": 25.0, "bent": 1.0, "uneven": 1.0}[kind]
    twist = log_uniform(rng, 0.3, 1)
    bend = log_uniform(rng, 0.05, 2.5) / length if kind == "bent" else 0.0
    parts = length * (rng.dirichlet([3.0, 3.0]) if kind == "uneven" else np.ones(1))
    sections = []
    for part in parts:
        stiff = EI * (log_uniform(rng, 0.3, 3) if kind == "uneven" else 1.0)
        section: dict[str, Any] = {
            "length": float(part),
            "bending_stiffness": (across * stiff, stiff),
            "torsional_stiffness": twist * stiff,
            "linear_density": weight,
            "precurvature": tuple(bend * direction(rng) * [1, 1, 0.3]),
        }
        if stretches:
            section |= {"axial_stiffness": stiff * 1e4 / length**2, "shear_stiffness": stiff * 4e3 / length**2}
        sections.append(section)
    base, end = np.eye(4), np.eye(4)
    if rng.random() < 0.5:  # the line between the ends, about which the base is turned too
        base[:3, :3] = Rotation.from_rotvec(rng.uniform(0, np.pi) * direction(rng)).as_matrix()
    tilt = rng.uniform(0, 0.7) if rng.random() < 0.5 else 0.0
    line = Rotation.from_rotvec(tilt * direction(rng)).apply([0, 0, 1])
    apart = {"slack": rng.uniform(0.4, 0.97), "taut": 1 + log_uniform(rng, 1e-4, 3e-3)}.get(
        ends, 1 - log_uniform(rng, 1e-4, 1e-2)
    )
    end[:3, 3] = base[:3, :3] @ (apart * length * line)
    turn = Rotation.from_rotvec(rng.uniform(0, 0.5) * direction(rng)).as_matrix() if held == "ball, clamp" else np.eye(3)
    end[:3, :3] = base[:3, :3] @ turn
    load = log_uniform(rng, 0.1, most_load)
    way = base[:3, :3] @ line if acts == "along" else direction(rng)
    way = way if acts != "along" or rng.random() < 0.5 else -way
    share = {"weight": 0.0, "both": rng.uniform(0.2, 0.8)}.get(acts, 1.0)
    force = share * load * EI / length**3 * way
    gravity = (1 - share) * load * EI / length**3 / weight * (way if acts != "both" else direction(rng))
    slide, tip_force = None, np.zeros(3)
    if ends == "slides":
        slide = turn.T @ line
        thrust = (1.0 if rng.random() < 0.5 else -0.3) * log_uniform(rng, 0.1, most_load) * EI / length**2
        tip_force = thrust * (base[:3, :3] @ line)
    robot = mr.HeldRod(
        mr.Rod(sections=[mr.Section(**s) for s in sections]),
        base=base,
        end=end,
        slide=None if slide is None else tuple(slide),
        **HELD[held],
    )
    given = {"distributed_force": force, "gravity": gravity, "tip_force": tip_force}
    inputs = robot.inputs(**{name: tuple(value) for name, value in given.items() if value.any()})
    return Drawn(robot, inputs, held, kind, ends, acts, sections, base, end, slide, force + weight * gravity, tip_force, load)
