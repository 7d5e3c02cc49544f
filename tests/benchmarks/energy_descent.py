"""Energy descent beside Newton's method, as trackers: time and error on motions of tubes, legs and a rod with driven lines.

And from a platform without loads to all of them at once: ``--robots`` of those that ``random_legs.py`` draws.

    OMP_NUM_THREADS=1 python tests/benchmarks/energy_descent.py --robots 60
"""

import argparse
import sys
from collections import Counter
from pathlib import Path

import numpy as np

import multirod as mr

sys.path.insert(0, str(Path(__file__).parents[1]))

from random_legs import draw

RATE, SECONDS = 200, 2.0
INTEGRATOR = mr.RK4(50)
SKIPPED = 20  # samples at the start


def ring(degrees, radius):
    """Poses on a circle."""
    poses = np.tile(np.eye(4), (len(degrees), 1, 1))
    poses[:, 0, 3], poses[:, 1, 3] = radius * np.cos(np.radians(degrees)), radius * np.sin(np.radians(degrees))
    return poses


def tube(length, curvature, stiffness):
    """A tube of round section."""
    return mr.Rod(length=length, bending_stiffness=stiffness, torsional_stiffness=0.75 * stiffness, precurvature=curvature)


def tubes(t):
    """Three loaded tubes, turned against each other."""
    robot = mr.ConcentricTubes([tube(0.4, (9, 0, 0), 0.01), tube(0.3, (6, 1, 0), 0.03), tube(0.2, (4, 2, 0), 0.06)])
    turn = np.stack([np.sin(3 * t), 0.5 * np.cos(2 * t), 0 * t], axis=1)
    return robot, {"rotation": turn, "tip_force": 0.1 * np.stack([np.sin(5 * t), np.cos(5 * t), 0 * t], axis=1)}


def legs(t, joints="clamped"):
    """A hexapod of thin steel legs, pushed in and out under a moving load."""
    rod = mr.Rod.tube(length=0.4, outer_diameter=2e-3, young_modulus=200e9, shear_modulus=80e9)
    base, platform = ring([-10, 10, 110, 130, 230, 250], 0.087), ring([-50, 50, 70, 170, 190, 290], 0.087)
    robot = mr.ParallelRods(legs=[rod] * 6, base=base, platform=platform, joints=joints)
    force = np.stack([2 * np.sin(6 * t), 2 * np.cos(6 * t), -3 * np.sin(3 * t)], axis=1)
    return robot, {"tip_force": force, "translation": 0.01 * np.sin(6 * t)[:, None] * np.array([1, -1, 1, -1, 0, 0])}


def lines(t):
    """A rod that three lines drive by their lengths."""
    own = [mr.PushRod((0.008 * np.cos(a), 0.008 * np.sin(a)), axial_stiffness=2e3) for a in 2 * np.pi * np.arange(3) / 3]
    robot = mr.SingleRod(mr.Rod(length=0.3, bending_stiffness=0.03, torsional_stiffness=0.02, lines=own))
    pulled = 0.003 * np.stack([np.sin(5 * t), np.sin(5 * t + 2), np.sin(5 * t + 4)], axis=1)
    return robot, {"displacement": pulled, "tip_force": np.stack([0.3 * np.sin(7 * t), 0.2 * np.cos(3 * t), 0.1 * t], axis=1)}


MOTIONS = {
    "three tubes": tubes,
    "six legs, clamped": legs,
    "six legs, spherical": lambda t: legs(t, "spherical"),
    "three driven lines": lines,
}


def track(robot, given, time, solver):
    """Positions of the end effector, integrations a sample and the time of each [us]: one tracker, one sample at a time."""
    first = robot.inputs(**{name: values[0] for name, values in given.items()})
    start = mr.solve(robot, first, solver=mr.Shooting(integrator=INTEGRATOR))
    history = mr.simulate(robot, robot.inputs(**given), time=time, solver=solver, guess=start)
    return history.tip_position[SKIPPED:], history.integrations[SKIPPED:].mean(), np.median(history.step_time[SKIPPED:]) * 1e6


def motions():
    """The first table."""
    time = np.arange(0, SECONDS, 1 / RATE)
    print(
        "| motion | integrations a sample: descent, Newton | a sample [us]: descent, Newton | error, mean [m]: descent, Newton |"
    )
    print("|---|---|---|---|")
    for name, motion in MOTIONS.items():
        robot, given = motion(time)
        exact, _, _ = track(robot, given, time, mr.Shooting(integrator=mr.RK4(400), tolerance=1e-11))
        found = [track(robot, given, time, solver(integrator=INTEGRATOR)) for solver in (mr.EnergyDescent, mr.Shooting)]
        error = [np.linalg.norm(position - exact, axis=1).mean() for position, _, _ in found]
        count, cost = ([one[k] for one in found] for k in (1, 2))
        print(
            f"| {name} | {count[0]:.2f}, {count[1]:.2f} | {cost[0]:.0f}, {cost[1]:.0f} | {error[0]:.1e}, {error[1]:.1e} |",
            flush=True,
        )


def at_once(robots):
    """How platforms without loads come to rest when all loads come at once."""
    count: Counter[str] = Counter()
    taken = []
    for number in range(robots):
        drawn = draw(number)
        if not drawn.load:
            continue
        resting = {name: drawn.loads[name] for name in ("rotation", "translation")}
        start = mr.solve(drawn.robot, drawn.robot.inputs(**resting))
        if start.status.failed:
            continue
        found = mr.solve(drawn.robot, drawn.inputs, solver=mr.EnergyDescent(), guess=start)
        count[f"{found.status.name} {found.stability.name}"] += 1
        if not found.failed:
            taken.append(int(found.integrations))
    print(dict(count), f"integrations: median {np.median(taken):.0f}, most {max(taken)}")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--robots", type=int, default=0)
    arguments = parser.parse_args()
    motions()
    if arguments.robots:
        at_once(arguments.robots)
