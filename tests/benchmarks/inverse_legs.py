"""Poses of robots drawn by lot, of six legs each: how many the inverse problem finds, all of which a stable robot stands in.

    OMP_NUM_THREADS=1 python tests/benchmarks/inverse_legs.py [--robots N]

Legs precurved and straight, tilted bases and attachments, joints of all kinds (``tests/random_legs.py``).
"""

import argparse
import sys
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parent.parent))

from random_legs import draw

import multirod as mr
from multirod.rotations import vectors

EACH = 6  # poses of a robot
MOST = 0.3  # part of a leg, that it is pushed by in the widest of them
SOLVER = mr.Shooting(integrator=mr.RK4(50))


def main() -> None:
    """Draw, solve and count."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--robots", type=int, default=19)
    options = parser.parse_args()
    random, number, robots = np.random.default_rng(3), -1, 0
    found, spent, poses = 0, [], 0
    while robots < options.robots:
        number += 1
        drawn = draw(number)
        if len(drawn.joints) != 6 or any(len(leg) > 1 for leg in drawn.sections):
            continue
        robot, loads = drawn.robot, {name: value for name, value in drawn.loads.items() if name != "translation"}
        length = np.array([rod.length for rod in robot.rods])
        widths = MOST * np.array([0.3, 0.6, 1, 0.3, 0.6, 1])[:, None]
        translation = length * widths * random.uniform(-1, 1, (EACH, 6))
        there = mr.solve(robot, robot.inputs(translation=translation, **loads), solver=SOLVER)
        stands = ~there.failed & (np.asarray(there.stability) == mr.Stability.STABLE)
        if not stands.any():
            continue
        robots += 1
        inverse = robot.inverse()
        pose = {"platform_position": there.tip_position[stands], "platform_rotation": vectors(there.tip_rotation[stands])}
        solution = mr.solve(inverse, inverse.inputs(**pose, **loads), solver=SOLVER)
        poses += int(stands.sum())
        found += int((~solution.failed).sum())
        spent += solution.integrations[~solution.failed].tolist()
    print(f"{found} of {poses} poses of {robots} robots; integrations {np.median(spent):.0f} in the median, {max(spent)} at most")


if __name__ == "__main__":
    main()
