"""A rod of a network that is pulled hard, a tenth across, in one segment and in several: what each of these takes.

OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 python tests/benchmarks/pulled_segments.py
"""

from time import process_time

import numpy as np

import multirod as mr

LENGTH, EI, GJ = 0.3, 0.02, 0.015
PULLS = (1e2, 3e2, 1e3, 3e3)  # EI/L^2
SEGMENTS = (1, 2, 4, 8, 16)
ASIDE = 0.1  # of the pull, across


def pulled(segments: int) -> mr.Network:
    """A straight rod that is clamped at its base, pulled at a body at its tip."""
    rod, body = mr.Rod(length=LENGTH, bending_stiffness=EI, torsional_stiffness=GJ), mr.Body("body")
    joints = [mr.Joint("rod", "base", to=mr.ground), mr.Joint("rod", "tip", to=body)]
    return mr.Network(rods={"rod": rod}, bodies=[body], joints=joints, segments={"rod": segments})


def main() -> None:
    """Print the table."""
    print("| pull [EI/L^2] | segments | status | integrations | ms | tip off that of most segments, over the length |")
    print("|---|---|---|---|---|---|")
    for pull in PULLS:
        rows = []
        for segments in SEGMENTS:
            robot, size = pulled(segments), pull * EI / LENGTH**2
            inputs = robot.inputs(force={"body": (ASIDE * size, 0, size)})
            robot.compile(inputs, progress=False)
            begin = process_time()
            solution = mr.solve(robot, inputs, progress=False)
            rows.append((segments, solution, 1e3 * (process_time() - begin)))
        last = rows[-1][1].tip_position
        for segments, solution, took in rows:
            off = np.linalg.norm(solution.tip_position - last) / LENGTH
            print(
                f"| {pull:g} | {segments} | {solution.status.name} | {solution.integrations} | {took:.0f} | {off:.1e} |",
                flush=True,
            )


if __name__ == "__main__":
    main()
