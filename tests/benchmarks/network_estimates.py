"""Forces on the bodies of networks, from one pose of the end effector: how many of some draws are found.

python tests/benchmarks/network_estimates.py [--draws N] [--max-iterations N]
"""

import argparse
from collections import Counter

import numpy as np

import multirod as mr

SOLVER = mr.Shooting(integrator=mr.RK4(50))
RODS = {"diameter": 2e-3, "young_modulus": 60e9, "shear_modulus": 23e9}


def chain():
    """Two rods in a row, two bodies of 50 g, in oblique gravity: it sways."""
    half = mr.Rod.wire(length=0.2, **RODS)
    middle, end = mr.Body("middle", mass=0.05), mr.Body("end", mass=0.05)
    joints = [
        mr.Joint("first", "base", to=mr.ground),
        mr.Joint("first", "tip", to=middle),
        mr.Joint("second", "base", to=middle),
        mr.Joint("second", "tip", to=end),
    ]
    robot = mr.Network(rods={"first": half, "second": half}, bodies=[middle, end], joints=joints)
    return robot, {"rotation": {"second": 0.5}, "gravity": (1.0, 0, -9.81)}


def mast():
    """Three legs on a plate, and a rod that stands on it with a body."""
    wire, plate, top = mr.Rod.wire(length=0.3, **RODS), mr.Body("plate"), mr.Body("top")
    joints = [mr.Joint("mast", "base", to=plate), mr.Joint("mast", "tip", to=top)]
    for k, angle in enumerate(np.radians([0, 120, 240])):
        around = np.array([np.cos(angle), np.sin(angle), 0])
        poses = np.tile(np.eye(4), (2, 1, 1))
        poses[:, :3, 3] = 0.08 * around, 0.06 * around
        joints.append(mr.Joint(f"leg {k}", "base", to=mr.ground, pose=poses[0]))
        joints.append(mr.Joint(f"leg {k}", "tip", to=plate, pose=poses[1], kind="spherical"))
    robot = mr.Network(rods={f"leg {k}": wire for k in range(3)} | {"mast": wire}, bodies=[plate, top], joints=joints)
    return robot, {"translation": {"leg 0": 0.01, "leg 2": 0.005}}


def draw(robot, known, size, draws):
    """Forces [N], shape (draws, 2, 3), and the solutions that they lead to."""
    force = size * np.random.default_rng(0).standard_normal((draws, 2, 3))
    return force, mr.solve(robot, robot.inputs(force=force, **known), solver=SOLVER).raise_if_failed()


def estimated(robot, known, seen, sigma, prior, most):
    """Estimates of the forces by the poses alone."""
    tip = mr.Pose(position=seen.tip_position, rotation=seen.tip_rotation, sigma=sigma)
    unknown = {"force": mr.Prior(0, sigma=prior)}
    return mr.estimate(robot, robot.inputs(**known), unknown=unknown, measured=tip, solver=SOLVER, max_iterations=most)


CASES = (
    (chain, 0.1, (5e-4, 5e-3), 0.25),
    (chain, 0.1, (1e-4, 1e-3), 0.25),
    (chain, 0.1, (1e-5, 1e-4), 0.25),
    (chain, 0.25, (5e-4, 5e-3), 0.25),
    (mast, 0.1, (1e-4, 1e-3), 0.5),
    (mast, 0.3, (1e-4, 1e-3), 0.5),
    (mast, 0.3, (1e-5, 1e-4), 0.5),
)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--draws", type=int, default=100)
    parser.add_argument("--max-iterations", type=int, default=30)
    options = parser.parse_args()
    for make, size, sigma, prior in CASES:
        robot, known = make()
        _, seen = draw(robot, known, size, options.draws)
        found = estimated(robot, known, seen, sigma, prior, options.max_iterations)
        good = found.integrations[found.status == mr.Status.CONVERGED]
        statuses = dict(Counter(status.name for status in found.status))
        print(f"{make.__name__}, {size} N, pose to {sigma}: {statuses}; integrations {good.mean():.1f}, at most {good.max()}")


if __name__ == "__main__":
    main()
