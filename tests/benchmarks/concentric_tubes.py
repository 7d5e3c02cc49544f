"""Concentric tubes against a bare C loop of one rod, rounds interleaved: ratios, medians and spread.

python tests/benchmarks/concentric_tubes.py [--rounds N] [--batch N]
"""

import argparse
import tempfile
from collections.abc import Callable
from math import inf
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np
import warp as wp
from single_rod import c_loop

import multirod as mr
from multirod.models.backbone import BackboneProblem

STEPS = 50
INTEGRATOR = mr.RK4(STEPS)
DT = 0.005


def tubes(count: int = 3, *, torsion: float = 1.0) -> mr.ConcentricTubes:
    """The innermost tubes of a three-tube robot with published stiffness, less strongly curved; ``torsion`` scales GJ."""
    data = [(0.00387, 0.00301, 0.431, 0.103, 9.0), (0.01717, 0.01402, 0.332, 0.113, 6.0), (0.03977, 0.05022, 0.174, 0.134, 3.5)]
    rods = []
    for EI, GJ, length, curved, curvature in data[:count]:
        precurvature = [(length - curved, (0, 0, 0)), (curved, (curvature, 0, 0))]
        rods.append(mr.Rod(length=length, bending_stiffness=EI, torsional_stiffness=torsion * GJ, precurvature=precurvature))
    return mr.ConcentricTubes(rods)


def motion(t: float, count: int = 3) -> dict[str, Any]:
    """Inputs at time t: the innermost tube turns and slides."""
    rotation = [0.4 + 0.6 * np.sin(t), 0.8, -0.3][:count]
    translation = [-0.28 + 0.02 * np.sin(0.7 * t), -0.22, -0.1][:count]
    return {"rotation": rotation, "translation": translation}


def tracker_step(robot: mr.ConcentricTubes, solver: mr.Solver, **loads: Any) -> Callable[[], float]:
    """Microseconds of ``Tracker.step`` along the motion."""
    count = robot.rod_count
    tracker = mr.Tracker(robot, solver=solver, dt=DT, inputs=robot.inputs(**motion(0.0, count), **loads))
    time = [0.0]

    def measure() -> float:
        times = []
        for _ in range(300):
            time[0] += DT
            values = motion(time[0], count)
            begin = perf_counter()
            solution = tracker.step(**values)
            times.append(perf_counter() - begin)
            solution.raise_if_failed()
        return 1e6 * float(np.median(times))

    return measure


def scattered(robot: mr.ConcentricTubes, batch: int, **loads: Any) -> mr.Inputs:
    """Inputs of a batch of robots, the base angles and insertions of each its own."""
    random = np.random.default_rng(0)
    count = robot.rod_count
    values = motion(0.0, count)
    rotation = np.array(values["rotation"]) + random.uniform(-0.5, 0.5, (batch, count))
    translation = np.array(values["translation"]) + random.uniform(-0.02, 0.02, (batch, count))
    return robot.inputs(rotation=rotation, translation=translation, **loads)


def integration(robot: mr.ConcentricTubes, batch: int, **loads: Any) -> Callable[[], float]:
    """Microseconds of one integration with residual, Gamma and the tip's pose, in a batch on one thread."""
    inputs = scattered(robot, batch, **loads)
    problem = robot.problem(inputs, integrator=INTEGRATOR)
    problem.write("unknowns", problem.guess())

    def measure() -> float:
        times = []
        for _ in range(3):
            begin = perf_counter()
            problem.integrate()
            times.append(perf_counter() - begin)
        return 1e6 * min(times) / batch

    return measure


def cold_start(robot: mr.ConcentricTubes, batch: int, **loads: Any) -> Callable[[], float]:
    """Microseconds a robot of ``mr.solve`` without a guess."""
    inputs = scattered(robot, batch, **loads)

    def measure() -> float:
        begin = perf_counter()
        solution = mr.solve(robot, inputs, solver=mr.Shooting(integrator=INTEGRATOR))
        result = 1e6 * (perf_counter() - begin) / batch
        solution.raise_if_failed()
        return result

    return measure
