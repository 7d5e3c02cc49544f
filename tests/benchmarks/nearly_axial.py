"""Rods pressed beyond buckling, by loads whose sideways parts nearly cancel: what ``solve`` says of them, and whether they are
stable. Such rods turn about their axis at almost no cost.

python tests/benchmarks/nearly_axial.py [--rods N]
"""

import argparse
from collections import Counter
from collections.abc import Sequence

import numpy as np

import multirod as mr

EI, LENGTH, LEVER = 6e-4, 0.12, 2e-3  # N m^2, m, m
CRITICAL = np.pi**2 * EI / (4 * LENGTH**2)  # N, of the rod as a column


def main(arguments: Sequence[str] | None = None) -> None:
    """Print how many ended how."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rods", type=int, default=3000)
    count, random = parser.parse_args(arguments).rods, np.random.default_rng(0)
    thrust = random.uniform(1.1, 6, count) * CRITICAL
    side = random.uniform(0, 0.1, count) * thrust
    force = np.stack([side, 0 * side, -thrust], axis=1)
    numbers = {"length": LENGTH, "bending_stiffness": EI, "torsional_stiffness": EI / 1.3}
    against = np.stack([-random.uniform(0, 3, count) * side / LENGTH, 0 * side, 0 * side], axis=1)
    scenes = {
        "against a tendon": ([mr.Tendon((-LEVER, 0))], {"tension": random.uniform(0, 1, count)}),
        "against a distributed force": ([], {"distributed_force": against}),
    }
    for name, (lines, given) in scenes.items():
        robot = mr.SingleRod(mr.Rod(lines=lines, **numbers))
        found = mr.solve(robot, robot.inputs(tip_force=force, **given))
        ended = Counter(zip(found.status.tolist(), found.stability.tolist(), strict=True))
        said = (f"{n} {mr.Status(status).name} {mr.Stability(stability).name}" for (status, stability), n in ended.most_common())
        print(f"{name}: {', '.join(said)}; {found.integrations.mean():.1f} integrations in the mean")


if __name__ == "__main__":
    main()
