"""How long must six legs be for a pose of their platform? Against a published program.

The robot and the pose are those of github JohnDTill/ContinuumRobotExamples, 01_Statics/02_CSG_Inverse_Kinematics (John Till):
steel rods of 1 mm radius, heavy, that may turn about themselves, and a platform of 0.1 kg.
"""

import argparse
from collections.abc import Sequence

import numpy as np

import multirod as mr

STOCK = 0.45  # of each leg, of which what is needed goes through the base plate [m]
E, G, DENSITY, AREA, I = 200e9, 80e9, 8000.0, np.pi * 1e-6, np.pi / 4 * 1e-12
PUBLISHED = np.array([0.397337735933, 0.397337735942, 0.399720089243, 0.421636154428, 0.421636154431, 0.399720089239])  # [m]


def circle(degrees: list[int], radius: float = 0.087) -> np.ndarray:
    poses = np.tile(np.eye(4), (len(degrees), 1, 1))
    poses[:, 0, 3] = radius * np.cos(np.radians(degrees))
    poses[:, 1, 3] = radius * np.sin(np.radians(degrees))
    return poses


def robot() -> mr.ParallelRods:
    rod = mr.Section(
        length=STOCK,
        bending_stiffness=E * I,
        torsional_stiffness=2 * G * I,
        shear_stiffness=G * AREA,
        axial_stiffness=E * AREA,
        linear_density=DENSITY * AREA,
    )
    base, platform = circle([-10, 10, 110, 130, 230, 250]), circle([-50, 50, 70, 170, 190, 290])
    return mr.ParallelRods(
        legs=[mr.Rod(sections=[rod], outer_diameter=2e-3)] * 6,
        base=base,
        platform=platform,
        joints="revolute",  # about the leg's own axis
        platform_mass=0.1,
    )


def main(arguments: Sequence[str] | None = None) -> np.ndarray:
    """Lengths in use less those of the program [m]."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", help="picture to write")
    options = parser.parse_args(arguments)
    inverse = robot().inverse()
    pose = {"platform_position": (0, 0, 0.4), "platform_rotation": (0, np.radians(10), 0)}
    solution = mr.solve(inverse, inverse.inputs(**pose, gravity=(0, 0, -9.81))).raise_if_failed()
    lengths = STOCK + inverse.translations(solution)
    print("lengths", np.round(1e3 * lengths, 3), "mm")
    # the program asks R^T Q - R Q^T to vanish about two axes, which leaves the tips a little oblique where R is not Q
    print("less those of the program", np.round(1e6 * (lengths - PUBLISHED), 2), "um")
    if options.out:
        solution.plot().figure.savefig(options.out, dpi=80, bbox_inches="tight", metadata={"Software": None})
    return lengths - PUBLISHED


if __name__ == "__main__":
    main()
