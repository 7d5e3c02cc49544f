"""A rod of a network that is pulled hard: in one piece, and in pieces between bodies without mass.

Why networks need no multiple shooting: what is integrated over a short piece grows less, and ``Gamma`` is eliminated along the
graph as it would be between segments.

OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 python tests/benchmarks/pulled_pieces.py
"""

from time import process_time

import numpy as np

import multirod as mr

LENGTH, EI, GJ = 0.3, 0.02, 0.015
PULLS = (1e2, 3e2, 1e3, 3e3)  # EI/L^2
PIECES = (1, 2, 4, 8)
ASIDE = 0.1  # of the pull, across


def pulled(pieces: int) -> mr.Network:
    """A straight rod that is clamped at its base, pulled at a body at its tip."""
    rod = mr.Rod(length=LENGTH / pieces, bending_stiffness=EI, torsional_stiffness=GJ)
    bodies = [mr.Body(f"body {k}") for k in range(pieces)]
    joints = []
    for k, body in enumerate(bodies):
        joints.append(mr.Joint(f"piece {k}", "base", to=bodies[k - 1] if k else mr.ground))
        joints.append(mr.Joint(f"piece {k}", "tip", to=body))
    return mr.Network(rods={f"piece {k}": rod for k in range(pieces)}, bodies=bodies, joints=joints)


def main() -> None:
    """Print the table."""
    print("| pull [EI/L^2] | pieces | status | integrations of a piece | ms | tip off that of most pieces, over the length |")
    print("|---|---|---|---|---|---|")
    for pull in PULLS:
        rows = []
        for pieces in PIECES:
            robot, size = pulled(pieces), pull * EI / LENGTH**2
            inputs = robot.inputs(force={f"body {pieces - 1}": (ASIDE * size, 0, size)})
            robot.compile(inputs, progress=False)
            begin = process_time()
            solution = mr.solve(robot, inputs)
            rows.append((pieces, solution, 1e3 * (process_time() - begin)))
        last = rows[-1][1].tip_position
        for pieces, solution, took in rows:
            off = np.linalg.norm(solution.tip_position - last) / LENGTH
            print(
                f"| {pull:g} | {pieces} | {solution.status.name} | {solution.integrations} | {took:.0f} | {off:.1e} |", flush=True
            )


if __name__ == "__main__":
    main()
