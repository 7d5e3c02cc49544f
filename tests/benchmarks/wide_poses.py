"""Poses of six legs all over their workspace: how many have a stable equilibrium, and how many of them each way finds.

    OMP_NUM_THREADS=1 python tests/benchmarks/wide_poses.py [--poses N] [--starts N]

Most poses that are drawn so have none that anything finds: what counts is the share of those that something found.
"""

import argparse
from time import perf_counter
from typing import Any

import numpy as np
from reach import SOLVER, six_legs

import multirod as mr
from multirod.rotations import matrices

FORCE = (0.0, 0.0, -5.0)
MOST = 0.35  # translation of a leg of 0.4 m [m]


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--poses", type=int, default=80)
    parser.add_argument("--starts", type=int, default=64)
    options = parser.parse_args()
    robot, start = six_legs()
    random, count = np.random.default_rng(0), options.poses
    aside = random.uniform(-0.15, 0.15, (count, 1)), random.uniform(-0.15, 0.15, (count, 1))
    position = np.concatenate([*aside, random.uniform(0.2, 0.6, (count, 1))], axis=1)
    rotation = random.uniform(-0.4, 0.4, (count, 3))
    inverse, turns = robot.inverse(limits=(-MOST, MOST)), matrices(rotation)
    pose = {"platform_position": position, "platform_rotation": rotation}

    def solved() -> Any:
        solution = mr.solve(inverse, inverse.inputs(**pose, tip_force=FORCE), solver=SOLVER)
        spent = solution.integrations[~solution.failed]
        print(f"integrations of what inverse() finds: {np.median(spent):.0f} in the median, {spent.max()} at most")
        return ~solution.failed

    def reached(starts: int) -> Any:
        limits, target = mr.Limits(translation=(-MOST, MOST)), mr.Pose(position=position, rotation=turns)
        found = mr.reach(robot, target, free="translation", limits=limits, guess=start, solver=SOLVER, starts=starts)
        return np.asarray(found.status == mr.Status.REACHED)

    ways = {
        "inverse()": solved,
        "reach": lambda: reached(0),
        f"reach, starts={options.starts}": lambda: reached(options.starts),
    }
    found, times = {}, {}
    for name, way in ways.items():
        begin = perf_counter()
        found[name] = way()
        times[name] = perf_counter() - begin
    every = np.any(list(found.values()), axis=0)
    print(f"| {every.sum()} of {count} poses that something finds | found | s |\n|---|---|---|")
    for name, own in found.items():
        print(f"| {name} | {own.sum()} | {times[name]:.1f} |")


if __name__ == "__main__":
    main()
