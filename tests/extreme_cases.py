"""Robots at one extreme each, with a tip that is known otherwise: what the table of docs/extremes.md is made of."""

import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from leg_equations import LegEquations
from meant import meant
from random_scenes import draw
from reference_branch import ReferenceBranch
from test_cases import robot_and_inputs
from test_concentric_tubes import assembly
from test_multiple_shooting import elastica

import multirod as mr

DATA = Path(__file__).parent / "data"
LENGTH, EI = 0.5, 0.02


@dataclass(frozen=True)
class Case:
    """A robot under its inputs and where its tip is.

    Attributes:
        name: What is extreme.
        robot: Of the package.
        inputs: Of the package.
        tip: Position of the end effector [m].
        length: That errors are counted in [m].
        source: Where the tip is from.
    """

    name: str
    robot: mr.Assembly
    inputs: mr.Inputs
    tip: np.ndarray
    length: float
    source: str


def pose(rotation=None, position=(0, 0, 0)):
    result = np.eye(4)
    result[:3, :3] = np.eye(3) if rotation is None else rotation
    result[:3, 3] = position
    return result


@meant()
def stored(name, identity):
    """A stored reference case."""
    case = json.loads((DATA / f"{identity}.json").read_text(encoding="utf-8"))
    tip = np.array(case["expected"]["tip_position"]["value"])
    if case["model"] == "single_rod":
        robot, inputs = robot_and_inputs(case, pose)
        return Case(name, robot, inputs, tip, case["inputs"]["rods"][0]["length"], "stored")
    robot, inputs = assembly(case["inputs"], pose)
    return Case(name, robot, inputs, tip, max(tube["length"] for tube in case["inputs"]["tubes"]), "stored")


@meant()
def straight_rod(name, tip, source, ratio=2.0, **loads):
    """A straight rod that is ``ratio`` times stiffer about x than about y."""
    robot = mr.SingleRod(mr.Rod(length=LENGTH, bending_stiffness=(ratio * EI, EI), torsional_stiffness=0.65 * EI))
    return Case(name, robot, robot.inputs(**loads), np.asarray(tip), LENGTH, source)


def planar(load, angle):
    """A force at ``angle`` to the base."""
    if load > 1e5:  # the layer at the base alone: the modulus is 1 to exp(-2000)
        along, across = 1 - 2 / np.sqrt(load) * (1 - np.cos(angle / 2)), 2 / np.sqrt(load) * np.sin(angle / 2)
    else:
        along, across = elastica(load, angle)
    direction, normal = np.array([np.sin(angle), 0, np.cos(angle)]), np.array([-np.cos(angle), 0, np.sin(angle)])
    tip = LENGTH * (along * direction + across * normal)
    force = load * EI / LENGTH**2 * direction
    return straight_rod(f"{load:g} EI/L^2 at {angle:.2g} rad", tip, "elliptic integrals", tip_force=force)


def tension(load):
    force = (0, 0, load * EI / LENGTH**2)
    return straight_rod(f"{load:g} EI/L^2 of pure tension", (0, 0, LENGTH), "straight", tip_force=force)


def rolled_up(turns, ratio, axis):
    moment = (0, 2 * np.pi * turns * EI / LENGTH, 0)
    return straight_rod(f"rolled up {turns} times by a moment{axis}", (0, 0, 0), "closed", ratio, tip_moment=moment)


@meant()
def by_branch(name, sections, loads, intervals, first_step):
    """A rod whose branch is followed by ``ReferenceBranch``."""
    robot = mr.SingleRod(mr.Rod(sections=[mr.Section(**s) for s in sections]))
    states, reached = ReferenceBranch(sections, loads, intervals).follow(first_step)
    tip = np.full(3, np.nan) if states is None else states[-1, :3]
    source = "small steps" if reached == 1 else f"lost at {reached:.2g}"
    return Case(name, robot, robot.inputs(**loads), tip, sum(s["length"] for s in sections), source)


def stiffness_ratio(across, twist, load=3.0):
    section = {"length": LENGTH, "bending_stiffness": (EI, across * EI), "torsional_stiffness": twist * EI}
    section["precurvature"] = (1.0, 0.5, 0.3)
    force = load * min(EI, across * EI) / LENGTH**2 * np.array([0.6, 0.5, -0.62])
    name = (f"EI_y/EI_x = {across:g}" if across != 1 else f"GJ/EI = {twist:g}") + f", {load:g} EI/L^2"
    return by_branch(name, [section], {"tip_force": force}, 600, 0.02)


def short_section(length):
    sections = []
    for part, jump in ((0.2, 1.0), (length, 1e3), (0.3 - length, 0.5)):
        sections.append({"length": part, "bending_stiffness": jump * EI, "torsional_stiffness": 0.7 * jump * EI})
        sections[-1]["precurvature"] = (2.0, jump, 0.0)
    return by_branch(f"a section of {length:g} m", sections, {"tip_force": np.array([0.3, 0.2, -0.1])}, 400, 0.05)


def size(length):
    """The same rod, three times bent, of another size."""
    section = {"length": length, "bending_stiffness": (EI, 2 * EI), "torsional_stiffness": 0.7 * EI}
    section["precurvature"] = tuple(np.array([1, 0.5, 2]) / length)
    force = 30 * EI / length**2 * np.array([0.9, 0.3, -0.2])
    return by_branch(f"a rod of {length:g} m", [section], {"tip_force": force}, 300, 0.01)


def legs(seed):
    """Three legs drawn by lot, their tip by Newton's method on equations of their own."""
    scene = draw("three legs", seed)
    stiffness = [rod[0]["bending_stiffness"][0] for rod in scene.rods]
    solution = mr.solve(scene.robot, scene.inputs).raise_if_failed()
    own = LegEquations(scene.rods, scene.loads)
    found = own.solve(own.starts(solution), solution.tip_position, solution.tip_rotation)
    assert found is not None
    name = f"legs of stiffness 1 to {max(stiffness) / min(stiffness):.0e}"
    return Case(name, scene.robot, scene.inputs, found[0], own.length, "Newton from the same base")


CASES: tuple[Callable[[], Case], ...] = (
    lambda: stored("slenderness 1e4, with shear", "14d_slender_1e4_cosserat"),
    lambda: stiffness_ratio(1e6, 1.0),
    lambda: stiffness_ratio(1e-6, 1.0),
    lambda: stiffness_ratio(1.0, 1e6),
    lambda: stiffness_ratio(1.0, 1e-2),
    lambda: stored("GJ/EI = 1e-4", "14c_torsion_ratio_0.0001"),
    lambda: stiffness_ratio(1.0, 1e-6, load=1e-3),
    *(lambda load=load: planar(load, np.pi / 2) for load in (50.0, 400.0, 1e4, 1e6)),
    *(lambda load=load: planar(load, 2.8) for load in (50.0, 400.0, 1e4, 1e6)),
    *(lambda load=load: tension(load) for load in (50.0, 400.0, 1e4, 1e6)),
    lambda: stored("a force in space of 1e4 EI/L^2", "14b_big_force_3d_a10000"),
    lambda: stored("a spring of 32 loops", "14e_many_loops_0"),
    lambda: stored("the same, stretched", "14e_many_loops_2"),
    lambda: rolled_up(10, 1.0, ""),
    lambda: rolled_up(10, 2.0, " about the axis of middle stiffness"),
    lambda: short_section(1e-12),
    *(lambda length=length: size(length) for length in (1e-6, 1e-4, 1e3)),
    lambda: stored("tubes that end 1e-10 m apart", "14f_ctr_tiny_gap"),
    lambda: stored("tubes 1e-4 rad before their snap", "14i_ctr_near_fold_0.0001"),
    lambda: stored("tubes 1e-6 rad before their snap", "14i_ctr_near_fold_1e-06"),
    *(lambda seed=seed: legs(seed) for seed in (1075, 1082)),
)


def solvers():
    """What the table compares, by name."""
    return {
        "`Shooting()`": mr.Shooting(),
        "`Shooting(fallback=False)`": mr.Shooting(fallback=False),
        "`MultipleShooting()`": mr.MultipleShooting(),
        "`ScipyShooting()`": mr.ScipyShooting(exact_gradient=True, max_iterations=50),
        "`Observer()`, slow ramp": mr.Observer(ramp=2000, max_iterations=4000, R=1e4, Q=1e4),
        "`Shooting()` in float32": mr.Shooting(integrator=mr.RK45(precision="float32")),
        "the same, `fallback=False`": mr.Shooting(integrator=mr.RK45(precision="float32"), fallback=False),
    }
