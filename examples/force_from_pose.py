"""Which force pulls at a surgical robot's tip? Read off one noisy pose, with how sure it is, and what cannot be seen.

Tubes are those of github SIRGLab/CTR_Python_Model, the program beside M. Khadem, L. Da Cruz, C. Bergeles, IROS 2018, 4920-4926
(``surgical_tubes.py``); the sensor is an electromagnetic tracker, 0.5 mm and 0.3 degree. In one direction the robot hardly gives
way: a force along it stays nearly as unknown as it was.
"""

import argparse
from collections.abc import Sequence

import numpy as np
from surgical_tubes import ANGLES, DRIVES, ROBOT

import multirod as mr

POSITION, ANGLE = 0.5e-3, np.radians(0.3)  # what the tracker is off [m], [rad]
EXPECTED = 0.1  # how large a force may be, before anything is measured [N]


def turned(vector: np.ndarray) -> np.ndarray:
    """Rotation matrix of a small rotation vector."""
    angle = np.linalg.norm(vector)
    x, y, z = vector / angle
    K = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + np.sin(angle) * K + (1 - np.cos(angle)) * K @ K


def tracker(force: np.ndarray, random: np.random.Generator) -> mr.Pose:
    """What the sensor says of the tip under a force."""
    tip = mr.solve(ROBOT, ROBOT.inputs(rotation=ANGLES, translation=DRIVES, tip_force=force)).raise_if_failed()
    position = tip.tip_position + POSITION * random.normal(size=3)
    return mr.Pose(position=position, rotation=turned(ANGLE * random.normal(size=3)) @ tip.tip_rotation, sigma=(POSITION, ANGLE))


def main(arguments: Sequence[str] | None = None) -> mr.Estimate:
    """The estimate."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--force", type=float, nargs=3, default=(0.05, -0.08, 0.03), help="that acts [N]")
    parser.add_argument("--seed", type=int, default=1, help="of the noise")
    options = parser.parse_args(arguments)
    force = np.array(options.force)
    found = mr.estimate(
        ROBOT,
        ROBOT.inputs(rotation=ANGLES, translation=DRIVES),
        unknown={"tip_force": mr.Prior(0, sigma=EXPECTED)},
        measured=tracker(force, np.random.default_rng(options.seed)),
    ).raise_if_failed()
    value, covariance = found.value("tip_force"), found.covariance("tip_force")
    print(f"force     {np.round(force, 3)} N")
    print(f"estimate  {np.round(value, 3)} N, by {found.integrations} integrations")
    print("covariance, mN^2:")
    print(np.round(1e6 * covariance).astype(int))
    axes, kept = found.directions("tip_force")
    tangent = found.solution.tip_rotation[:, 2]
    for k in range(3):
        about = np.degrees(np.arccos(min(1.0, abs(axes[:, k] @ tangent))))
        sigma = np.sqrt(axes[:, k] @ covariance @ axes[:, k])
        said = "unobservable" if kept[k] > 0.5 else "seen"
        part = f"{kept[k]:6.1%} of the prior's variance"
        print(f"{about:3.0f} degrees off the tip's axis: +- {1e3 * sigma:4.0f} mN, {part}, {said}")
    return found


if __name__ == "__main__":
    main()
