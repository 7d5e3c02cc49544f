"""A sample of a motion, and a cold solve: six legs as parallel rods and as a network, and two such robots on top of each other.

Processor time; the robots take turns, and the least of some turns is printed.

OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 python tests/benchmarks/network_motion.py
"""

import time

import numpy as np

import multirod as mr

SAMPLES, RATE, TURNS = 200, 2000, 5
GRAVITY = (0, 0, -9.81)


def circle(radius, shift):
    """Six poses in pairs on a circle."""
    poses = np.tile(np.eye(4), (6, 1, 1))
    angles = np.pi / 3 * np.arange(6) + shift * np.array([1, -1] * 3)
    poses[:, :2, 3] = radius * np.stack([np.cos(angles), np.sin(angles)], axis=1)
    return poses


def hexapod(length, mass):
    """Six clamped legs."""
    leg = mr.Rod.wire(length=length, diameter=2e-3, young_modulus=60e9, shear_modulus=23e9, density=6450)
    return mr.ParallelRods(legs=[leg] * 6, base=circle(0.08, 0.2), platform=circle(0.06, 0.3), platform_mass=mass)


def given(robot, t):
    """Inputs at a time: legs are pushed and pulled by 5 mm at half a hertz."""
    legs = np.arange(len(robot.rods))
    load = {"force": {robot.load_places[-1]: (0.2, 0.1, 0)}} if isinstance(robot, mr.Network) else {"tip_force": (0.2, 0.1, 0)}
    return {"translation": 0.005 * (np.sin(np.pi * t + legs) - np.sin(legs)), "gravity": GRAVITY, **load}


def followed(robot):
    """Processor time of a sample [ms], and integrations of it."""
    tracker = mr.Tracker(robot)
    tracker.step(**given(robot, 0.0))
    motion = [given(robot, (k + 1) / RATE)["translation"] for k in range(SAMPLES)]
    start, integrations = time.process_time(), 0
    for translation in motion:
        integrations += tracker.step(translation=translation).integrations
    return 1e3 * (time.process_time() - start) / SAMPLES, integrations / SAMPLES


def solved(robot):
    """Processor time of a cold solve [ms], and its integrations."""
    inputs = robot.inputs(**given(robot, 0.0))
    start = time.process_time()
    solution = mr.solve(robot, inputs).raise_if_failed()
    return 1e3 * (time.process_time() - start), solution.integrations


def main() -> None:
    """Measure, and print."""
    one = hexapod(0.3, 0.05)
    robots = {
        "six legs, ParallelRods": one,
        "six legs, Network": mr.stacked(one),
        "twelve legs, Network": mr.stacked(one, hexapod(0.25, 0.03)),
    }
    print("robot                     sample [ms]  integrations   cold [ms]  integrations")
    found: dict[str, list[tuple[float, ...]]] = {name: [] for name in robots}
    for turn in range(TURNS + 1):
        for name, robot in robots.items():
            measured = (*followed(robot), *solved(robot))
            if turn:  # the first compiles
                found[name].append(measured)
    for name, rows in found.items():
        print("{:25s} {:11.2f} {:13.2f} {:11.1f} {:13.0f}".format(name, *np.min(rows, axis=0)))


if __name__ == "__main__":
    main()
