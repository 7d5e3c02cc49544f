"""Two fluidic segments with the numbers of others: one that was computed, and one that was measured.

The first is of John Till's dissertation, "On the Statics, Dynamics, and Stability of Continuum Robots", University of Tennessee,
2019, section 3.4.4: a rod with one chamber, and air in it. It prints the volume of the chamber and the mean strain once all is
still. It also prints a modulus of 20 MPa, which is a thousand times too much: air at 0.8 bar would stretch such a rod by 0.01 %.
With 20 kPa both numbers are met.

The second is an arm of silicone that hangs down, of the STIFF-FLOP kind: S.M.H. Sadati et al., "TMTDyn: A Matlab package for
modeling and control of hybrid rigid-continuum robots", International Journal of Robotics Research, 2020, with what was measured
in github smhadisadati/TMTDyn: exp2_EBR.m has the parameters, exp/NoLoad.mat the pressures and the poses of the tip, of which the
means just before each pressure is let off are below, reduced as sample_exp_data.m does. It bends more than in proportion to the
pressure: by 19 degrees at 36 kPa, by 76 at 107. With a linear law and chambers that never widen the model cannot.
"""

import argparse
import warnings
from collections.abc import Sequence

import numpy as np
from scipy.optimize import brentq

import multirod as mr

# of Till's rod [m], [Pa]; the rod's line is where its section, less the hole, has its centroid
TILL_LENGTH, TILL_RADIUS, TILL_HOLE, TILL_OFFSET, TILL_E = 0.1, 0.015, 2.5e-3, 0.01, 20e3
GAS = 2e-4 * 8.314 * 293.15  # moles, gas constant, temperature [J]
ATMOSPHERE = 101325.0
VOLUME, STRAIN = 2.65e-6, 0.12  # published [m^3]

# of the arm [m], [Pa], [kg/m^3], [kg]
LENGTH, BORE, RADIUS = 0.044, 4.5e-3, 12.5e-3
HOLE, REACH, HALF_GAP = 2.5e-3, 8.5e-3, np.arccos(1 - (3e-3 / 8.5e-3) ** 2 / 2)  # six holes, in pairs [rad]
E, DENSITY = 120e3, 1.4 * 1300
SENSOR_LENGTH, SENSOR_MASS = 0.0145, 0.01347  # of the force sensor at the tip, whose end is measured
FITTED = 95e3  # the modulus that suits the measured tips best in this model, to 5 kPa
MEASURED = np.array(
    [  # pressure in each pair [kPa], tip [mm], z is down, and by how much it is bent [degrees]
        (36.2, 0, 0, 0.1, -9.6, 59.6, 19.1),
        (0, 0, 36.3, 8.0, 4.3, 58.7, 18.2),
        (0, 27.1, 0, -5.2, 3.1, 59.1, 12.9),
        (73.6, 0, 0, 0.6, -24.2, 56.6, 47.5),
        (0, 0, 73.0, 19.1, 10.3, 55.1, 44.3),
        (0, 68.7, 0, -17.5, 10.0, 57.0, 40.4),
        (107.2, 0, 0, -0.7, -35.6, 49.6, 76.2),
        (0, 0, 110.9, 29.4, 16.7, 45.8, 76.5),
        (0, 109.5, 0, -28.3, 17.9, 49.1, 72.9),
    ]
)
PRESSURE, TIP, BENT = 1e3 * MEASURED[:, :3], 1e-3 * MEASURED[:, 3:6], MEASURED[:, 6]


def rod_with_air() -> mr.SingleRod:
    hole = np.pi * TILL_HOLE**2
    section = np.pi * TILL_RADIUS**2 - hole
    aside = hole * TILL_OFFSET / section  # of the centroid
    across = np.pi / 4 * (TILL_RADIUS**4 - TILL_HOLE**4)
    second = (across - hole * TILL_OFFSET**2 - section * aside**2, across)
    rod = mr.Section(
        length=TILL_LENGTH,
        bending_stiffness=TILL_E * np.array(second),
        torsional_stiffness=TILL_E / 3 * sum(second),
        shear_stiffness=TILL_E / 3 * section,
        axial_stiffness=TILL_E * section,
    )
    chamber = mr.Chamber(offset=(0, TILL_OFFSET + aside), area=hole)
    return mr.SingleRod(mr.Rod(sections=[rod], outer_diameter=2 * TILL_RADIUS, lines=[chamber]))


def with_air() -> tuple[float, float]:
    """Volume of the chamber [m^3] and mean strain of the rod, where the air in it has the pressure that bends the rod."""
    robot, hole = rod_with_air(), np.pi * TILL_HOLE**2

    def volume(pressure: float) -> float:
        solution = mr.solve(robot, robot.inputs(pressure=[pressure])).raise_if_failed()
        return hole * float(solution.line_length[0])

    pressure = brentq(lambda p: (p + ATMOSPHERE) * volume(p) - GAS, 1e3, 2e5, rtol=1e-9)
    return volume(pressure), pressure * hole / float(robot.rods[0].sections[0].axial_stiffness)


def arm(modulus: float = E) -> mr.SingleRod:
    """A pair of holes has one pressure: it acts as one chamber of both areas, halfway between them."""
    hole = np.pi * HOLE**2
    section = np.pi * (RADIUS**2 - BORE**2) - 6 * hole
    second = np.pi / 4 * (RADIUS**4 - BORE**4 - 6 * HOLE**4) - 3 * hole * REACH**2
    silicone = mr.Section(
        length=LENGTH,
        bending_stiffness=modulus * second,
        torsional_stiffness=2 * modulus / 3 * second,
        shear_stiffness=modulus / 3 * section,
        axial_stiffness=modulus * section,
        linear_density=DENSITY * section,
    )
    sensor = mr.Section(  # as good as rigid
        length=SENSOR_LENGTH,
        bending_stiffness=5.0,
        torsional_stiffness=5.0,
        shear_stiffness=1e5,
        axial_stiffness=1e5,
        linear_density=SENSOR_MASS / SENSOR_LENGTH,
    )
    angles = np.radians([90, -30, 210])
    offsets = REACH * np.cos(HALF_GAP) * np.column_stack([np.cos(angles), np.sin(angles)])
    chambers = [mr.Chamber(offset=offset, area=2 * hole, end=LENGTH) for offset in offsets]
    return mr.SingleRod(mr.Rod(sections=[silicone, sensor], outer_diameter=2 * RADIUS, lines=chambers))


def measured(modulus: float) -> tuple[mr.Solution, np.ndarray, np.ndarray]:
    """Solution, distances of tips from those measured [m], and angles by which the arm is bent [degrees]."""
    robot = arm(modulus)
    solution = mr.solve(robot, robot.inputs(pressure=PRESSURE, gravity=(0, 0, 9.81))).raise_if_failed()
    bent = np.degrees(np.arccos(solution.tip_rotation[:, 2, 2]))
    return solution, np.linalg.norm(solution.tip_position - TIP, axis=-1), bent


def main(arguments: Sequence[str] | None = None) -> tuple[float, float, float, float]:
    """Volume [m^3], mean strain, and mean distance from the measured tips with the published modulus and a fitted one [m]."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", help="picture to write")
    options = parser.parse_args(arguments)
    warnings.filterwarnings("ignore", category=mr.PlausibilityWarning)  # they are as soft as that, and bend that far
    volume, strain = with_air()
    print(f"air: volume {1e6 * volume:.3f} cm^3, published 2.65; mean strain {strain:.4f}, published 0.12")
    gaps, highest = [], PRESSURE.max(axis=1) / 1e3
    for modulus in (E, FITTED):
        solution, distance, bent = measured(modulus)
        gaps.append(float(distance.mean()))
        print(f"arm, {modulus / 1e3:.0f} kPa: tips {1e3 * gaps[-1]:.1f} mm from those measured, on average")
        for pressure, gap, angle, found in zip(highest, distance, bent, BENT, strict=True):
            print(f"  {pressure:5.1f} kPa: {1e3 * gap:4.1f} mm; bent by {angle:.1f} degrees, measured {found:.1f}")
    if options.out:
        ax = solution.plot(colour_by=highest, colour_label="pressure in one pair of chambers [kPa]")
        ax.scatter(*TIP.T, color="black", depthshade=False, label="measured")
        for found, tip in zip(solution.tip_position, TIP, strict=True):
            ax.plot(*np.transpose([found, tip]), color="grey", linewidth=0.8)
        ax.legend()
        ax.invert_zaxis()
        ax.figure.savefig(options.out, dpi=80, bbox_inches="tight", metadata={"Software": None})
    return volume, strain, gaps[0], gaps[1]


if __name__ == "__main__":
    main()
