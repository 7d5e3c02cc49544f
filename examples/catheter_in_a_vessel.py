"""A magnetic catheter in a bent vessel, and the force on its tip, read off the curvature that a fibre in it measures.

The vessel is an elastic medium around the catheter's first part. A medium, `foundation=`, holds each piece of a rod to its place
on the straight line out of the base, with k per length. A bent vessel, whose axis is c(s), is that and a load per length that is
as known as the vessel: k (p - c) = k (p - s z) - k (c - s z). The numbers are this example's own. The check is that what the
vessel and the force do together is what the base is held with.
"""

import argparse
from collections.abc import Sequence

import numpy as np

import multirod as mr

DIAMETER, E, POISSON = 2e-3, 5e6, 0.49  # of silicone [m], [Pa]
IN_VESSEL, FREE, MAGNET = 0.05, 0.03, 0.01  # parts of the catheter, from its base [m]
MAGNETISATION = 1e5  # of the last of them, along it [A/m]
BEND = 0.08  # radius of the vessel's axis [m]
STIFFNESS = 2e4  # of the vessel, about the Young's modulus of what is around it [N/m^2]
FIELD = (0.0, 0.01, 0.0)  # [T]
FORCE = (-0.004, 0.002, 0.0)  # of the tip on a wall: what is to be found [N]
GRATINGS, NOISE = 0.005 + 0.01 * np.arange(9), 0.2  # where along the fibre [m], what each is off [1/m]


def part(length: float, **more: object) -> mr.Section:
    """A piece of catheter, by its material: `Rod.wire` knows the stiffnesses of a round one."""
    return mr.Rod.wire(length=length, diameter=DIAMETER, young_modulus=E, poisson_ratio=POISSON, **more).sections[0]


def axis(s: float) -> np.ndarray:
    """Of the vessel, which begins along z and bends to x."""
    return BEND * np.array([1 - np.cos(s / BEND), 0.0, np.sin(s / BEND)])


def vessel(s: float) -> np.ndarray:
    """The load per length that bends the medium's line to the axis [N/m]; there is no vessel farther on."""
    return STIFFNESS * (axis(s) - np.array([0.0, 0.0, s])) if s <= IN_VESSEL else np.zeros(3)


def main(arguments: Sequence[str] | None = None) -> tuple[mr.Estimate, float]:
    """The estimate, and by how much the balance of forces at the base is off [N]."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--plot", help="picture to write")
    options = parser.parse_args(arguments)
    sections = [part(IN_VESSEL, foundation=STIFFNESS), part(FREE), part(MAGNET, magnetisation=(0, 0, MAGNETISATION))]
    robot = mr.SingleRod(mr.Rod(sections=sections, outer_diameter=DIAMETER))
    known = robot.inputs(magnetic_field=FIELD, distributed_force=vessel)
    loads = robot.inputs(magnetic_field=FIELD, distributed_force=vessel, tip_force=FORCE)
    solution = mr.solve(robot, loads).raise_if_failed()

    inside = np.linspace(0, IN_VESSEL, 401)
    path = solution.along(inside)
    off = path - np.array([axis(s) for s in inside])
    print(f"the vessel gives way by {1e3 * np.linalg.norm(off, axis=1).max():.2f} mm at most; tip {solution.tip_position} m")
    pressed = -STIFFNESS * off  # by the vessel on the catheter [N/m]
    total = np.trapezoid(pressed, inside, axis=0) + np.array(FORCE)
    balance = float(np.linalg.norm(solution.wrench(0, "base").force - total))
    print(f"forces of the vessel and of the wall are what the base is held with, to {balance:.0e} N")

    bent = solution.along(GRATINGS, of="curvature")[:, :2] + NOISE * np.random.default_rng(0).normal(size=(len(GRATINGS), 2))
    sensor = mr.Curvature(at=GRATINGS, value=bent, sigma=NOISE)
    found = mr.estimate(robot, known, unknown={"tip_force": mr.Prior(0, sigma=0.01)}, measured=sensor).raise_if_failed()
    value, sigma = found.value("tip_force"), found.sigma("tip_force")
    print(f"the wall presses by {1e3 * np.array(FORCE)} mN; estimate {1e3 * value} +- {1e3 * sigma} mN")
    if options.plot:
        from matplotlib import pyplot as plt

        axes = solution.plot()
        line = np.array([axis(s) for s in inside])
        axes.plot(*line.T, "k--", label="axis of the vessel")
        axes.legend()
        axes.figure.savefig(options.plot, dpi=80, bbox_inches="tight", metadata={"Software": None})
        plt.close(axes.figure)
    return found, balance


if __name__ == "__main__":
    np.set_printoptions(precision=4, suppress=True)
    main()
