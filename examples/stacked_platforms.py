"""Two hexapods on top of each other: the legs of the upper one stand on the platform of the lower one, which gives way."""

import argparse
from collections.abc import Sequence

import matplotlib.pyplot as plt
import numpy as np

import multirod as mr

BASE_ANGLES = [-10, 10, 110, 130, 230, 250]  # on circles [deg]
PLATFORM_ANGLES = [-50, 50, 70, 170, 190, 290]
LOWER, UPPER = 0.087, 0.06  # radii [m]


def circle(degrees: list[int], radius: float) -> np.ndarray:
    poses = np.tile(np.eye(4), (len(degrees), 1, 1))
    poses[:, 0, 3] = radius * np.cos(np.radians(degrees))
    poses[:, 1, 3] = radius * np.sin(np.radians(degrees))
    return poses


def hexapod(length: float, radius: float, mass: float) -> mr.ParallelRods:
    leg = mr.Rod.tube(length=length, outer_diameter=2e-3, young_modulus=200e9, shear_modulus=80e9, density=7850.0)
    base, platform = circle(BASE_ANGLES, radius), circle(PLATFORM_ANGLES, radius)
    return mr.ParallelRods(legs=[leg] * 6, base=base, platform=platform, platform_mass=mass)


def balance(solution: mr.Solution, body: mr.Body, load: np.ndarray) -> float:
    """What the forces in all rods at a body and its load leave [N]."""
    left = np.array(load)
    for joint in solution.assembly.joints:
        if joint.to is body:
            shape, end, sense = solution.rod(joint.rod), *((0, 1) if joint.end == "base" else (-1, -1))
            left = left + sense * shape.rotation[end] @ shape.force[end]
    return float(np.abs(left).max())


def main(arguments: Sequence[str] | None = None) -> tuple[float, float]:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", default="stacked_platforms.png")
    options = parser.parse_args(arguments)
    robot = mr.stacked(hexapod(0.4, LOWER, mass=0.15), hexapod(0.25, UPPER, mass=0.05))
    lower, upper = robot.bodies
    push, gravity = np.array([2.0, 0.0, -3.0]), np.array([0.0, 0.0, -9.81])
    turned = {f"lower {k}": 0.02 * np.cos(np.radians(BASE_ANGLES[k])) for k in range(6)}  # pushed out: the lower hexapod tilts
    inputs = robot.inputs(force={"upper": push}, translation=turned, gravity=gravity)
    solution = mr.solve(robot, inputs).raise_if_failed()

    def tilt(name: str) -> float:
        return float(np.degrees(np.arccos(solution.body_rotation(name)[2, 2])))

    print(f"{robot}: {solution.integrations} integrations")
    for body in (lower, upper):
        x, _, z = 1e3 * solution.body_position(body.name)
        print(f"{body.name} platform is {z:.1f} mm high and {x:.1f} mm aside, and tilts by {tilt(body.name):.1f} deg")
    compliance = 1e3 * np.diag(solution.jacobian("force")[:3, 3:])
    print(f"a newton on the top moves it by {compliance[0]:.2f}, {compliance[1]:.2f}, {compliance[2]:.3f} mm along x, y, z")
    left = max(balance(solution, upper, push + upper.mass * gravity), balance(solution, lower, lower.mass * gravity))
    print(f"forces on both bodies balance within {left:.1e} N")
    assert left < 1e-6
    axes = solution.plot()
    axes.get_legend().remove()
    axes.figure.savefig(options.out, dpi=80, bbox_inches="tight", metadata={"Software": None})
    plt.close(axes.figure)
    print(f"drawn to {options.out}")
    return left, tilt("upper")


if __name__ == "__main__":
    main()
