"""Parallel robots drawn by lot: the same number draws the same robot."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from leg_equations import LegEquations
from meant import meant
from random_scenes import direction, log_uniform
from scipy.spatial.transform import Rotation

import multirod as mr

JOINTS = ("clamped", "spherical", "revolute")


@dataclass(frozen=True)
class Drawn:
    """A robot, its inputs, and the numbers that it was made of.

    Attributes:
        robot: Of the package.
        inputs: Of the package.
        sections: Of each rod of each leg, (leg, rod), dictionaries of ``mr.Section``'s arguments.
        base: Poses of the legs' bases, shape (leg_count, 4, 4).
        platform: Poses of the attachments, shape (leg_count, 4, 4).
        joints: Of each leg.
        axes: Of each leg's joint, unit length, shape (leg_count, 3).
        loads: Inputs by name.
        load: Largest load in units of the legs' bending stiffness together and their length.
    """

    robot: mr.ParallelRods
    inputs: mr.Inputs
    sections: list[list[list[dict[str, Any]]]]
    base: np.ndarray
    platform: np.ndarray
    joints: list[str]
    axes: np.ndarray
    loads: dict[str, Any]
    load: float


@meant()
def draw(number: int, seed: int = 0, most_legs: int = 8, most_load: float = 10.0, curved: float = 0.0) -> Drawn:
    """Two legs to ``most_legs``, some of them two tubes, in joints of all kinds, attachments spread and tilted, half of them
    loaded, by ``most_load`` at most.

    Where ``curved`` is given, all have legs of two or three tubes, bent by so many radians at most and turned to all sides.
    """
    rng = np.random.default_rng([seed, number])
    count = int(rng.integers(2, most_legs + 1))
    length, EI = log_uniform(rng, 0.05, 1), log_uniform(rng, 1e-3, 1)
    with_tubes, with_joints = rng.random() < (1.0 if curved else 0.25), rng.random() < 0.7
    joints = [str(rng.choice(JOINTS)) if with_joints else "clamped" for _ in range(count)]
    joints[0] = "clamped"  # nothing turns freely
    elastic = count > 3 or rng.random() < 0.5  # more straight legs that are inextensible are statically indeterminate
    bend = log_uniform(rng, 0.05, 2.5) if rng.random() < 0.75 else 0.0
    sections, rotation, translation = [], [], []
    for k in range(count):
        if with_tubes and k % 2:
            rods, turned, pushed = _tubes(rng, length * rng.uniform(0.85, 1.15), EI, bend, curved)
        else:
            rods, turned, pushed = _rod(rng, length * rng.uniform(0.85, 1.15), EI, bend, elastic)
        sections.append(rods)
        rotation += turned
        translation += pushed
    base = _ring(rng, count, rng.uniform(0.05, 0.5) * length, 0.3)
    platform = _ring(rng, count, rng.uniform(0.03, 0.4) * length, 0.3)
    axes = np.array([direction(rng) for _ in range(count)])
    loads: dict[str, Any] = {"rotation": np.array(rotation), "translation": np.array(translation)}
    load = 0.0
    if rng.random() < 0.6:
        load = log_uniform(rng, 0.1, most_load)
        loads["tip_force"] = load * count * EI / length**2 * direction(rng)
        if rng.random() < 0.3:
            loads["tip_moment"] = min(load, 1.0) * rng.random() * count * EI / length * direction(rng)
    rods = [[mr.Rod(sections=[mr.Section(**s) for s in rod]) for rod in leg] for leg in sections]
    robot = mr.ParallelRods(
        legs=[mr.ConcentricTubes(leg) if len(leg) > 1 else leg[0] for leg in rods],
        base=base,
        platform=platform,
        joints=joints,
        joint_axes=axes if "revolute" in joints else None,
    )
    return Drawn(robot, robot.inputs(**loads), sections, base, platform, joints, axes, loads, load)


def _rod(rng, length, EI, bend, elastic):
    """One rod, precurved by up to ``bend`` radians."""
    bending = EI * log_uniform(rng, 0.5, 2) * np.array([1.0, log_uniform(rng, 0.7, 1.4)])
    section = {
        "length": float(length),
        "bending_stiffness": tuple(bending),
        "torsional_stiffness": float(bending.mean() * log_uniform(rng, 0.5, 1)),
        "precurvature": tuple(bend / length * rng.uniform(-1, 1, 3) * (1, 1, 0.3)),
    }
    if elastic:
        section["axial_stiffness"] = float(bending.max() * log_uniform(rng, 30, 300) ** 2 / length**2)
    pushed = float(rng.uniform(-0.1, 0.1) * length) if rng.random() < 0.5 else 0.0
    return [[section]], [float(rng.uniform(-0.5, 0.5))], [pushed]


def _tubes(rng, length, EI, bend, curved=0.0):
    """Two tubes, or three if ``curved``, straight behind and precurved in front, the outer ones the shorter."""
    rods, parts = [], [(0.5, 1.0), (1.0, rng.uniform(0.4, 0.8))]
    if curved:
        bend = log_uniform(rng, 0.1 * curved, curved)
        if rng.random() < 0.3:
            parts.append((2.0, parts[1][1] * rng.uniform(0.5, 0.9)))
    for part, reach in parts:
        stiffness = {"bending_stiffness": float(part * EI), "torsional_stiffness": float(0.77 * part * EI)}
        straight = reach * rng.uniform(0.3, 0.7)
        rods.append(
            [
                {"length": float(straight * length), "precurvature": (0.0, 0.0, 0.0)} | stiffness,
                {"length": float((reach - straight) * length), "precurvature": (float(bend / length), 0.0, 0.0)} | stiffness,
            ]
        )
    outer = -rng.uniform(0, 0.1) * length
    turned = rng.uniform(-1, 1, len(parts)) * (np.pi if curved else 1.0)
    return rods, list(turned), [float(outer - rng.uniform(0.02, 0.1) * length), float(outer), *(0.0 for _ in parts[2:])]


def _ring(rng, count, radius, tilt):
    """Poses (count, 4, 4) around a circle, out of line and out of plane, tilted."""
    poses = np.tile(np.eye(4), (count, 1, 1))
    for k in range(count):
        angle = 2 * np.pi * k / count + rng.uniform(-0.3, 0.3)
        poses[k, :3, :3] = Rotation.from_rotvec(rng.uniform(-tilt, tilt, 3)).as_matrix()
        poses[k, :3, 3] = radius * np.array([np.cos(angle), np.sin(angle), rng.uniform(-0.3, 0.3)])
    return poses


def violation(drawn, solution):
    """Largest violation of the equations of ``LegEquations`` at a solution, dimensionless; None where a leg is of several tubes.

    It is how far the platform stands from the nearest root of these equations: a joint that is open by the solver's tolerance at
    the far end of a stiff leg is no violation.
    """
    if any(len(leg) > 1 for leg in drawn.sections):
        return None
    rods, base = [], drawn.base.copy()
    for k, (rod,) in enumerate(drawn.sections):
        rods.append([section.copy() for section in rod])
        rods[k][0]["length"] += drawn.loads["translation"][k]
        base[k, :3, :3] = base[k, :3, :3] @ Rotation.from_rotvec([0, 0, drawn.loads["rotation"][k]]).as_matrix()
    loads = {"base": base, "platform": drawn.platform}
    loads |= {name: np.asarray(drawn.loads.get(name, np.zeros(3))) for name in ("tip_force", "tip_moment")}
    legs = LegEquations(rods, loads, drawn.joints, drawn.axes)
    found = legs.solve(legs.starts(solution), solution.tip_position, solution.tip_rotation)
    return np.inf if found is None else float(np.abs(found[0] - solution.tip_position).max() / legs.length)
