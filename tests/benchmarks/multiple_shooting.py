"""Multiple shooting against shooting: integrations, segments, time and error of one rod under growing loads.

python tests/benchmarks/multiple_shooting.py
"""

import argparse
from time import perf_counter

import numpy as np

import multirod as mr

LENGTH, STIFFNESS = 0.5, 0.02
LOADS = (10.0, 100.0, 400.0, 1e3, 1e4, 1e5, 1e6)


def along_the_force(load: float) -> float:
    """Tip of the elastica along a large force that starts across it, over the length: ``2 E(1) - 2 E(pi/4, 1)`` layers are
    lost."""
    return 1 - (2 - np.sqrt(2)) / np.sqrt(load)


def main() -> None:
    argparse.ArgumentParser(description=__doc__).parse_args()
    robot = mr.SingleRod(mr.Rod(length=LENGTH, bending_stiffness=STIFFNESS, torsional_stiffness=0.013))
    mr.solve(robot, robot.inputs(tip_force=(1, 0, 0)), solver=mr.MultipleShooting())
    print("| `F L^2/EI` | `Shooting` alone | integrations | `MultipleShooting` | integrations | segments | ms | error / L |")
    print("|---|---|---|---|---|---|---|---|")
    for load in LOADS:
        inputs = robot.inputs(tip_force=(load * STIFFNESS / LENGTH**2, 0, 0))
        single = mr.solve(robot, inputs, solver=mr.Shooting(fallback=False))
        start = perf_counter()
        solution = mr.solve(robot, inputs, solver=mr.MultipleShooting())
        time = perf_counter() - start
        points = solution._outcome.breakpoints
        count = len(points[0].steps) if points else 1
        error = f"{abs(solution.tip_position[0] / LENGTH - along_the_force(load)):.0e}" if load >= 400 else ""
        print(
            f"| {load:g} | {single.status} | {single.integrations} | {solution.status} | {solution.integrations} | {count} "
            f"| {1e3 * time:.0f} | {error} |"
        )


if __name__ == "__main__":
    main()
