"""Concentric tubes against a bare C loop of one rod, rounds interleaved: ratios, medians and spread.

python tests/benchmarks/concentric_tubes.py [--rounds N] [--batch N]
"""

import argparse
import tempfile
from collections.abc import Callable
from math import inf
from pathlib import Path
from time import perf_counter, process_time
from typing import Any

import numpy as np
from single_rod import c_loop

import multirod as mr

STEPS = 50
INTEGRATOR = mr.RK4(STEPS)
DT = 0.005


def tubes(count: int = 3, *, torsion: float = 1.0) -> mr.ConcentricTubes:
    """The innermost tubes of three with the stiffness of stored case 09c, less strongly curved; ``torsion`` scales GJ."""
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


def scattered(robot: mr.ConcentricTubes | mr.SingleRod, batch: int, **loads: Any) -> mr.Inputs:
    """Inputs of a batch of robots, the base angles and insertions of each its own."""
    random = np.random.default_rng(0)
    count = robot.rod_count
    values = motion(0.0, count)
    rotation = np.array(values["rotation"]) + random.uniform(-0.5, 0.5, (batch, count))
    translation = np.array(values["translation"]) + random.uniform(-0.02, 0.02, (batch, count))
    return robot.inputs(**{"rotation": rotation, "translation": translation, **loads})


def integration(robot: mr.ConcentricTubes | mr.SingleRod, *, enabled: tuple[str, ...] = (), **loads: Any) -> Callable[[], float]:
    """Microseconds of one integration with residual, Gamma and the tip's pose; of launches short enough to find a quiet time."""
    batch = 20
    problem = robot.problem(scattered(robot, batch, **loads), integrator=INTEGRATOR, enabled=enabled)
    problem.write("unknowns", problem.guess())

    def measure() -> float:
        times = []
        for _ in range(200):
            begin = perf_counter()
            problem.integrate()
            times.append(perf_counter() - begin)
        return 1e6 * float(np.median(times)) / batch

    return measure


def cold_start(robot: mr.ConcentricTubes, batch: int, **loads: Any) -> Callable[[], float]:
    """Microseconds of processor time a robot of ``mr.solve`` without a guess, on one thread as the C loop is: two threads of one
    core slow each other down."""
    inputs = scattered(robot, batch, **loads)

    def measure() -> float:
        begin = process_time()
        solution = mr.solve(robot, inputs, solver=mr.Shooting(integrator=INTEGRATOR), threads=1)
        result = 1e6 * (process_time() - begin) / batch
        solution.raise_if_failed()
        return result

    return measure


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rounds", type=int, default=7)
    parser.add_argument("--batch", type=int, default=10_000)
    options = parser.parse_args()
    newton, observer = mr.Shooting(integrator=INTEGRATOR), mr.Observer(R=120, Q=30, integrator=INTEGRATOR)
    force = {"tip_force": (0.0, 0.2, 0.1)}
    robot, rigid, one = tubes(), tubes(torsion=inf), tubes(1)
    rod = mr.SingleRod(one.rods[0])
    every = ("tip_force", "tip_moment", "gravity")
    runs: dict[str, Callable[[], float]] = {
        "three loaded tubes, Tracker.step, Newton to 1e-9": tracker_step(robot, newton, **force),
        "three loaded tubes, Tracker.step, observer": tracker_step(robot, observer, **force),
        "three unloaded tubes, Tracker.step, Newton to 1e-9": tracker_step(robot, newton),
        f"batch of {options.batch}, three loaded tubes, cold start": cold_start(robot, options.batch, **force),
        f"batch of {options.batch}, three unloaded tubes, cold start": cold_start(robot, options.batch),
        "one integration, three tubes, tip force": integration(robot, **force),
        "one integration, three tubes, every load compiled in": integration(robot, enabled=every, **force),
        "one integration, three tubes, no load": integration(robot),
        "one integration, three tubes, no load but a tip force compiled in": integration(robot, enabled=("tip_force",)),
        "one integration, three tubes rigid in torsion, tip force": integration(rigid, **force),
        "one integration, one tube, tip force": integration(one, **force),
        "one integration, the same as a SingleRod": integration(rod, **force),
    }
    times: dict[str, list[float]] = {name: [] for name in runs}
    floors: list[float] = []
    with tempfile.TemporaryDirectory() as folder:
        floor = c_loop(Path(folder), repeats=200)  # short runs, of which one finds a quiet time
        for run in runs.values():
            run()
        for _ in range(options.rounds):
            for name, run in runs.items():
                times[name].append(run())
                if floor is not None:
                    floors.append(floor())
    if floors:
        print(f"bare C loop, one integration of one rod, RK4({STEPS}): {np.median(floors):.2f} µs, least {min(floors):.2f}")
    else:
        print("no C compiler found: times without ratios")
    print("\n| what | µs | least | bare C loops | least over least |\n|---|---|---|---|---|")
    for k, (name, values) in enumerate(times.items()):
        ratios = " | "
        if floors:
            ratios = f"{np.median(np.array(values) / floors[k :: len(runs)]):.1f} | {min(values) / min(floors):.1f}"
        print(f"| {name} | {np.median(values):.1f} | {min(values):.1f} | {ratios} |")


if __name__ == "__main__":
    main()
