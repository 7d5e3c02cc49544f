"""Two bent wires hold one bar from both sides: pushed together they lift it, pushed in turn they tilt it, turned they swing it.

The robot is nobody's: put your own dimensions in. Arms of tubes on a platform are in ``two_arms_one_platform.py``.

python examples/two_arms_carry.py [--samples 121] [--out two_arms_carry.rrd] [--plot two_arms_carry.png]
"""

import argparse
from collections.abc import Sequence

import matplotlib.pyplot as plt
import numpy as np

import multirod as mr

APART, HALF = 0.2, 0.04  # from the middle to the feet of the arms, and to the ends of the bar [m]
LENGTH, BEND = 0.3, 4.0  # of each arm [m], [1/m]
MASS = 0.02  # of the bar [kg]
GRAVITY = np.array([0.0, 0.0, -9.81])


def at(x: float, tilt: float = 0.0) -> np.ndarray:
    """Frame on the axis of the bar, turned about y [rad]."""
    pose = np.eye(4)
    pose[:3, :3] = [[np.cos(tilt), 0, np.sin(tilt)], [0, 1, 0], [-np.sin(tilt), 0, np.cos(tilt)]]
    pose[0, 3] = x
    return pose


def carried() -> mr.Network:
    nitinol = {"diameter": 2e-3, "young_modulus": 60e9, "shear_modulus": 23e9, "density": 6450.0}
    bar = mr.Body("bar", mass=MASS)
    rods, joints = {}, []
    for name, side in (("left", -1.0), ("right", 1.0)):
        bend = -side * BEND
        rods[name] = mr.Rod.wire(length=LENGTH, precurvature=(0, bend, 0), **nitinol)
        joints.append(mr.Joint(name, "base", to=mr.ground, pose=at(side * APART)))
        joints.append(mr.Joint(name, "tip", to=bar, pose=at(side * HALF, bend * LENGTH)))  # as the arm ends at rest
    return mr.Network(rods=rods, bodies=[bar], joints=joints)


def grip(history: mr.History, name: str) -> np.ndarray:
    """Force with which the bar pulls an arm, in the world [N], shape (sample, 3)."""
    return -history.wrench(name, "tip").force


def main(arguments: Sequence[str] | None = None) -> tuple[float, float, float]:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--samples", type=int, default=121)
    parser.add_argument("--out", default="two_arms_carry.rrd")
    parser.add_argument("--plot", default="two_arms_carry.png")
    options = parser.parse_args(arguments)
    robot = carried()
    t = np.linspace(0, 6, options.samples)
    phase = 2 * np.pi * t / t[-1]
    lift, turn, swing = 0.03 * np.sin(phase), 0.03 * np.sin(2 * phase), 0.8 * np.sin(3 * phase)
    inputs = robot.inputs(
        translation={"left": lift + turn, "right": lift - turn},  # how far they are pushed out of their bases
        rotation={"left": swing, "right": swing},
        gravity=GRAVITY,
    )
    history = mr.simulate(robot, inputs, time=t, solver=mr.Shooting(integrator=mr.RK4(30))).raise_if_failed()
    history.save(options.out)
    left, right = grip(history, "left"), grip(history, "right")
    axis = history.tip_rotation[:, :, 0]
    tilt, heading = np.degrees(np.arcsin(-axis[:, 2])), np.degrees(np.arctan2(axis[:, 1], axis[:, 0]))
    height = 1e3 * history.tip_position[:, 2]
    squeeze = 0.5 * np.einsum("ti,ti->t", right - left, axis)
    unbalanced = float(np.abs(left + right - MASS * GRAVITY).max())
    print(f"the bar is {height.min():.0f} to {height.max():.0f} mm high, tilts by up to {np.abs(tilt).max():.0f} deg", end=" ")
    print(f"and swings by up to {np.abs(heading).max():.0f} deg")
    print(
        f"of its {1e3 * MASS * 9.81:.0f} mN the left arm bears {-1e3 * left[:, 2].max():.0f} to {-1e3 * left[:, 2].min():.0f} mN"
    )
    print(f"along itself they press it by up to {1e3 * squeeze.max():.0f} mN, and pull it by up to {-1e3 * squeeze.min():.0f} mN")
    print(f"their forces and its weight balance within {unbalanced:.1e} N")
    axes = history.plot()
    axes.figure.savefig(options.plot, dpi=80, bbox_inches="tight", metadata={"Software": None})
    plt.close(axes.figure)
    print(f"recorded to {options.out}, drawn to {options.plot}")
    return unbalanced, float(np.abs(tilt).max()), float(np.abs(heading).max())


if __name__ == "__main__":
    main()
