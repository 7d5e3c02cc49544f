"""Three tubes of a surgical robot against a published program, and what their straight part behind the plate does.

Tubes and positions are those of github SIRGLab/CTR_Python_Model (Example.py), the program beside M. Khadem, L. Da Cruz,
C. Bergeles, IROS 2018, 4920-4926; the tubes are turned by 0, 1 and 2 rad, so that they twist. That program has the angles at the
plate, and here they are those of the drives behind it: which drives hold the tubes so is solved for.
"""

import argparse
from collections.abc import Sequence

import numpy as np
from scipy.optimize import root

import multirod as mr

DRIVES = np.array([-0.2758, -0.1875, -0.0755])  # where the tubes begin [m]
ANGLES = np.array([0.0, 1.0, 2.0])
PUBLISHED = (0.05761913, -0.03062378, 0.124909)  # what that program finds, its equations solved to 1e-12 [m]


def tube(name: str, length: float, curved: float, inner: float, outer: float, E: float, G: float, curvature: float) -> mr.Rod:
    I = np.pi / 64 * (outer**4 - inner**4)
    at_rest = [(length - curved, (0, 0, 0)), (curved, (curvature, 0, 0))]
    return mr.Rod(
        name=name,
        length=length,
        bending_stiffness=E * I,
        torsional_stiffness=G * 2 * I,  # the printed moduli of the outer tube mean a Poisson ratio of -0.2
        precurvature=at_rest,
        outer_diameter=outer,
        inner_diameter=inner,
    )


ROBOT = mr.ConcentricTubes(
    [
        tube("inner", 0.431, 0.103, 0.7e-3, 1.1e-3, 64.3e9, 25.0e9, 21.3),
        tube("middle", 0.332, 0.113, 1.4e-3, 1.8e-3, 52.5e9, 21.4e9, 13.108),
        tube("outer", 0.174, 0.134, 2.0e-3, 2.2e-3, 47.1e9, 29.7e9, 3.5),
    ]
)


def driven(angles: np.ndarray) -> mr.Solution:
    return mr.solve(ROBOT, ROBOT.inputs(rotation=angles, translation=DRIVES)).raise_if_failed()


def angles_at_plate(angles: np.ndarray) -> np.ndarray:
    solution = driven(angles)
    twist = np.array([solution.rod(k).curvature[0, 2] for k in range(3)])  # as far as the plate it is the same all along
    return angles - DRIVES * twist


def main(arguments: Sequence[str] | None = None) -> tuple[float, float]:
    """Distance of the tip from the published one, and what it is if the drives have those angles [mm]."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", help="picture to write")
    options = parser.parse_args(arguments)
    held = driven(root(lambda angles: angles_at_plate(angles) - ANGLES, ANGLES, tol=1e-10).x)
    behind = driven(ANGLES)
    gaps = [1e3 * float(np.linalg.norm(s.tip_position - PUBLISHED)) for s in (held, behind)]
    print(f"held at the plate, the tip is at {np.round(1e3 * held.tip_position, 2)} mm, {gaps[0]:.2f} mm from the published one,")
    print(f"whose lengths are cut to 0.01 mm; driven from behind, it is {gaps[1]:.0f} mm away: the tubes twist on their way")
    if options.out:
        held.plot().figure.savefig(options.out, dpi=80, bbox_inches="tight", metadata={"Software": None})
    return gaps[0], gaps[1]


if __name__ == "__main__":
    main()
