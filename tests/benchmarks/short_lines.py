"""Displacements of lines that do not stretch, estimated from priors that no robot may have: how many are found, at what cost.

python tests/benchmarks/short_lines.py [--count N]
"""

import argparse

import numpy as np

import multirod as mr

SIZE = 2e-3  # standard deviation of the priors, and of their means around the truth [m]


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--count", type=int, default=60, help="of each kind")
    count, random = parser.parse_args().count, np.random.default_rng(4)
    print("| lines, force | found | less probable than the truth | integrations: median, most |\n|---|---|---|---|")
    for lines in (2, 3):
        angles = 2 * np.pi * np.arange(lines) / lines
        places = 0.008 * np.stack([np.cos(angles), np.sin(angles)], axis=1)
        tendons = [mr.Tendon(place, driven="displacement") for place in places]
        robot = mr.SingleRod(mr.Rod(length=0.2, bending_stiffness=0.01, torsional_stiffness=0.0077, lines=tendons))
        for force in ((0.02, 0.01, 0), (0, 0, 0)):
            turns = random.uniform(0, 2 * np.pi, (count, 1))
            pulled = 0.003 * random.random((count, 1)) * np.cos(angles - turns) - random.uniform(1e-4, 1e-3, (count, 1))
            there = mr.solve(robot, robot.inputs(displacement=pulled, tip_force=force)).raise_if_failed()
            means = pulled + SIZE * random.normal(size=(count, lines))
            prior, sensor = mr.Prior(means, sigma=SIZE), mr.Pose(position=there.tip_position, sigma=5e-4)
            found = mr.estimate(robot, robot.inputs(tip_force=force), unknown={"displacement": prior}, measured=sensor)
            worse = found.misfit > (((pulled - means) / SIZE) ** 2).sum(axis=1) + 1e-6
            spent = f"{np.median(found.integrations):.0f}, {found.integrations.max()}"
            print(f"| {lines}, {force} N | {(~found.failed).sum()} of {count} | {worse.sum()} | {spent} |", flush=True)


if __name__ == "__main__":
    main()
