"""A multi-backbone robot with real discs, beside the continuous model of its push rods: how many discs make them the same?"""

import argparse
from collections.abc import Sequence

import matplotlib.pyplot as plt
import numpy as np

import multirod as mr

LENGTH, RADIUS = 0.1, 0.004  # m
ANGLES = np.radians([0, 120, 240])
OFFSETS = RADIUS * np.stack([np.cos(ANGLES), np.sin(ANGLES)], axis=1)
NITINOL = {"young_modulus": 60e9, "shear_modulus": 23e9}  # Pa
INNER, OUTER = 1e-3, 0.8e-3  # diameters [m]
BENDING = NITINOL["young_modulus"] * np.pi / 64 * OUTER**4
TWISTING = NITINOL["shear_modulus"] * np.pi / 32 * OUTER**4
AXIAL = 1e3 * NITINOL["young_modulus"] * np.pi / 4 * OUTER**2  # the continuous model counts stretch along another line: none here


def with_discs(count: int) -> mr.Network:
    inner = mr.Rod.wire(length=LENGTH, diameter=INNER, **NITINOL)
    outer = mr.Rod(length=LENGTH, bending_stiffness=BENDING, torsional_stiffness=TWISTING, axial_stiffness=AXIAL)
    return mr.multibackbone(inner, [outer] * 3, offsets=OFFSETS, discs=count)


def continuous() -> mr.SingleRod:
    lines = [mr.PushRod(offset=tuple(at), bending_stiffness=BENDING, axial_stiffness=AXIAL) for at in OFFSETS]
    return mr.SingleRod(mr.Rod.wire(length=LENGTH, diameter=INNER, lines=lines, **NITINOL))


def main(arguments: Sequence[str] | None = None) -> list[float]:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", default="multibackbone_discs.png")
    options = parser.parse_args(arguments)
    pushed, force = 0.0032 * np.cos(ANGLES), (0.3, 0.0, -0.2)
    solver = mr.Shooting(tolerance=1e-9, integrator=mr.RK4(40))
    model = continuous()
    limit = mr.solve(model, model.inputs(displacement=-pushed, tip_force=force), solver=solver).raise_if_failed()
    print(f"continuous: the tip at {1e3 * limit.tip_position[0]:.3f}, {1e3 * limit.tip_position[2]:.3f} mm")
    errors: list[float] = []
    for count in (5, 10, 20):
        robot = with_discs(count)
        given = {f"rod {k}": push for k, push in enumerate(pushed)}
        inputs = robot.inputs(translation=given, force={f"disc {count}": force})
        solution = mr.solve(robot, inputs, solver=solver).raise_if_failed()
        errors.append(float(np.linalg.norm(solution.tip_position - limit.tip_position)))
        order = f", order {np.log2(errors[-2] / errors[-1]):.2f}" if len(errors) > 1 else ""
        print(f"{count:2} discs: {1e6 * errors[-1]:7.3f} um off, {solution.stability.name}{order}")
        if count == 10:
            axes = solution.plot()
            axes.get_legend().remove()
            axes.figure.savefig(options.out, dpi=80, bbox_inches="tight", metadata={"Software": None})
            plt.close(axes.figure)
            print(f"drawn to {options.out}")
    return errors


if __name__ == "__main__":
    main()
