"""Three legs of two concentric tubes each hold one platform: each leg is driven by four motors that stay at the base.

The tubes are the inner and middle one of github SIRGLab/CTR_Python_Model (Example.py); no program or publication was found that
joins such tubes to a platform and prints numbers. So the platform is this example's own, and the checks are: with straight tubes,
how stiff the platform is, in closed form; with curved ones, where it is by the change of its potential energy with the load.
"""

import argparse
from collections.abc import Sequence

import numpy as np

import multirod as mr

OUTER, INNER = np.array([1.1e-3, 1.8e-3]), np.array([0.7e-3, 1.4e-3])  # diameters of the inner and the outer tube [m]
LENGTH, CURVED, CURVATURE = (0.431, 0.332), (0.103, 0.113), (21.3, 13.108)  # [m], [m], [1/m]
E, G = (64.3e9, 52.5e9), (25.0e9, 21.4e9)
DRIVES = np.array([-0.281, -0.232])  # where the tubes begin: they leave the plate by 150 and 100 mm
BASE, PLATFORM = 0.05, 0.02  # radii of the circles on which the legs stand and end [m]
LOAD = (0.0, 0.0, -0.3)  # on the platform [N]


def leg(curved: float) -> mr.ConcentricTubes:
    """Two tubes, curved by so much of what they are, towards x of the base."""
    tubes = []
    for k, name in enumerate(("inner", "outer")):
        straight = LENGTH[k] - CURVED[k]
        tubes.append(
            mr.Rod.tube(
                name=name,
                length=LENGTH[k],
                outer_diameter=OUTER[k],
                inner_diameter=INNER[k],
                young_modulus=E[k],
                shear_modulus=G[k],
                precurvature=[(straight, (0, 0, 0)), (CURVED[k], (0, curved * CURVATURE[k], 0))],
            )
        )
    return mr.ConcentricTubes(tubes)


def around(radius: float) -> np.ndarray:
    """Poses on a circle, their x axes outward."""
    poses = np.tile(np.eye(4), (3, 1, 1))
    for pose, angle in zip(poses, 2 * np.pi / 3 * np.arange(3), strict=True):
        pose[:2, 0], pose[:2, 1] = (np.cos(angle), np.sin(angle)), (-np.sin(angle), np.cos(angle))
        pose[:3, 3] = radius * pose[:3, 0]
    return poses


def robot(curved: float, platform: float) -> mr.ParallelRods:
    return mr.ParallelRods(legs=[leg(curved)] * 3, base=around(BASE), platform=around(platform))


def straight_compliance() -> float:
    """How far a unit force sideways moves the platform of straight legs [m/N]: each is clamped below and guided above.

    With the moments a_k = integral of s^k/EI from the tip down, one leg moves by a_2 - a_1^2/a_0.
    """
    EI = np.array(E) * np.pi / 64 * (OUTER**4 - INNER**4)
    ends = np.array([0.0, LENGTH[0] + DRIVES[0] - LENGTH[1] - DRIVES[1], LENGTH[0] + DRIVES[0]])
    a0, a1, a2 = (((ends[1:] ** k - ends[:-1] ** k) / k) @ (1 / np.cumsum(EI)) for k in (1, 2, 3))
    return float(a2 - a1**2 / a0) / 3


def by_energy(curved: mr.ParallelRods, step: float = 1e-3, **drives: np.ndarray) -> np.ndarray:
    """Where the platform is by what its potential changes by, for each unit of force (Castigliano): no position is asked."""
    more = np.array(LOAD) + step * np.concatenate([np.eye(3), -np.eye(3)])
    potential = mr.solve(curved, curved.inputs(tip_force=more, **drives)).raise_if_failed().potential
    return -(potential[:3] - potential[3:]) / (2 * step)


def main(arguments: Sequence[str] | None = None) -> tuple[float, float]:
    """Relative distance of the compliance from the closed form, and of the platform from where its energy has it [m]."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", help="picture to write")
    options = parser.parse_args(arguments)
    drives = np.tile(DRIVES, 3)
    straight = robot(0.0, BASE)
    compliance = mr.solve(straight, straight.inputs(translation=drives)).raise_if_failed().jacobian("tip_force")[0, 0]
    first = compliance / straight_compliance() - 1
    print(f"straight tubes: 1 N moves the platform by {1e3 * compliance:.4f} mm, {abs(first):.0e} of it from the closed form")
    curved = robot(1.0, PLATFORM)
    turned = {"rotation": np.array([0.9, 0.3, 0, 0, 0, 0]), "translation": drives}  # the first leg's tubes
    whole = mr.solve(curved, curved.inputs(tip_force=LOAD, **turned)).raise_if_failed()
    gap = float(np.linalg.norm(by_energy(curved, **turned) - whole.tip_position))
    tilt = np.degrees(np.arccos(whole.tip_rotation[2, 2]))
    print(f"curved tubes: the platform is at {np.round(1e3 * whole.tip_position, 2)} mm, tilted by {tilt:.1f} degrees,")
    print(f"{whole.stability.name}; {gap:.0e} m from where its energy has it")
    if options.out:
        whole.plot().figure.savefig(options.out, dpi=80, bbox_inches="tight", metadata={"Software": None})
    return abs(first), gap


if __name__ == "__main__":
    main()
