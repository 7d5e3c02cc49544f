"""A platform on six steel rods under a load that moves across it.

Geometry and material are those of github JohnDTill/ContinuumRobotExamples, 01_Statics/02_CSG_Inverse_Kinematics, a robot of the
class of C. B. Black, J. Till, D. C. Rucker, IEEE T-RO 34(1), 29-47, 2018.
"""

import argparse
from collections.abc import Sequence

import numpy as np

import multirod as mr

LENGTHS = [0.397, 0.397, 0.400, 0.422, 0.422, 0.400]
BASE_ANGLES = [-10, 10, 110, 130, 230, 250]  # on circles of one radius [deg]
PLATFORM_ANGLES = [-50, 50, 70, 170, 190, 290]


def circle(degrees: list[int], radius: float = 0.087) -> np.ndarray:
    poses = np.tile(np.eye(4), (len(degrees), 1, 1))
    poses[:, 0, 3] = radius * np.cos(np.radians(degrees))
    poses[:, 1, 3] = radius * np.sin(np.radians(degrees))
    return poses


def main(arguments: Sequence[str] | None = None) -> float:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", default="hexapod_load.rrd")
    parser.add_argument("--samples", type=int, default=500)
    options = parser.parse_args(arguments)
    legs = [mr.Rod.tube(length=l, outer_diameter=2e-3, young_modulus=200e9, shear_modulus=80e9) for l in LENGTHS]
    robot = mr.ParallelRods(legs=legs, base=circle(BASE_ANGLES), platform=circle(PLATFORM_ANGLES))
    t = np.linspace(0, 10, options.samples)
    phase = 2 * np.pi * t / t[-1]
    point = 0.07 * np.stack([np.sin(phase), np.sin(2 * phase), 0 * t], axis=-1)  # a figure of eight
    inputs = robot.inputs(tip_force=(0, 0, -8.0), force_point=point)
    history = mr.simulate(robot, inputs, time=t)
    history.raise_if_failed()
    history.save(options.out)
    tilt = np.degrees(np.arccos(history.tip_rotation[:, 2, 2]))
    legs_at_base = [history.rod(k) for k in range(6)]
    carried = sum(np.einsum("tij,tj->ti", leg.rotation[:, 0], leg.force[:, 0]) for leg in legs_at_base)
    imbalance = np.abs(carried - inputs.tip_force).max()
    print(
        f"the platform tilts by up to {tilt.max():.2f} deg, "
        f"its middle moves by {1e3 * np.ptp(history.tip_position, axis=0).max():.1f} mm"
    )
    print(f"forces at the six bases add up to the load within {imbalance:.1e} N")
    print(f"a sample takes {1e6 * np.median(history.step_time):.0f} µs in the median; recorded to {options.out}")
    return float(imbalance)


if __name__ == "__main__":
    main()
