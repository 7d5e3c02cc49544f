"""A fluidic segment of silicone, with weight and a load, against the least energy over polynomials.

Three chambers in a cylinder, two of them filled: they bend and lengthen it. The numbers are this example's own; those of others
are in fluidic_segment.py. The checks are: in free space, the arc that chambers bend a rod to, in closed form; with weight and a
force, another method, which knows no differential equation.
"""

import argparse
from collections.abc import Sequence

import numpy as np
from numpy.polynomial.legendre import leggauss, legvander
from scipy.optimize import root

import multirod as mr

LENGTH, RADIUS, OFFSET, AREA = 0.1, 0.011, 0.0065, 5e-5  # of segment and chambers [m], [m^2]
E, G, DENSITY = 0.6e6, 0.2e6, 1080.0  # a casting silicone, which keeps its volume
X = OFFSET * np.array([1, -0.5, -0.5])  # of the chambers, in the plane in which it bends
SECTION = np.pi * RADIUS**2 - 3 * AREA
EI = E * (np.pi / 4 * RADIUS**4 - 3 * (AREA**2 / (4 * np.pi) + AREA * OFFSET**2 / 2))  # less the holes
EA, GA, WEIGHT = E * SECTION, G * SECTION, 9.81 * DENSITY * SECTION
PRESSURE = np.array([0.0, 6e4, 6e4])  # [Pa]
FORCE = np.array([0.05, 0.0, -0.1])  # on the tip, sideways and down [N]


def segment() -> mr.SingleRod:
    """It stands on its base."""
    angles = 2 * np.pi / 3 * np.arange(3)
    offsets = OFFSET * np.column_stack([np.cos(angles), np.sin(angles)])
    chambers = [mr.Chamber(offset=offset, area=AREA, name=f"chamber {k + 1}") for k, offset in enumerate(offsets)]
    section = mr.Section(
        length=LENGTH,
        bending_stiffness=EI,
        torsional_stiffness=2 * G / E * EI,
        shear_stiffness=GA,
        axial_stiffness=EA,
        linear_density=DENSITY * SECTION,
    )
    return mr.SingleRod(mr.Rod(sections=[section], outer_diameter=2 * RADIUS, lines=chambers))


def arc() -> np.ndarray:
    """Tip in free space: all along it, the chambers' moment over EI is the curvature, their force over EA the strain."""
    curvature, strain = -(PRESSURE * AREA) @ X / EI, PRESSURE.sum() * AREA / EA
    angle, length = curvature * LENGTH, (1 + strain) * LENGTH
    return length / angle * np.array([1 - np.cos(angle), 0.0, np.sin(angle)])


def least_energy(degree: int = 10) -> np.ndarray:
    """Tip under weight and force: curvature, strain and shear are polynomials of arclength, of the least potential energy."""
    at, weights = leggauss(3 * degree)
    s, weights, slopes = LENGTH / 2 * (1 + at), LENGTH / 2 * weights, legvander(at, degree)
    # integrals of Legendre's polynomials from the base, which have no weight at it
    more = legvander(at, degree + 1)
    angles = np.column_stack([at + 1, *((more[:, k + 1] - more[:, k - 1]) / (2 * k + 1) for k in range(1, degree + 1))])
    carried = FORCE + WEIGHT * (LENGTH - s)[:, None] * np.array([0.0, 0.0, -1.0])  # by each place, of what is beyond it

    def shape(x: np.ndarray) -> tuple[np.ndarray, ...]:
        curvature, strain, shear = (slopes @ part for part in x.reshape(3, -1))
        angle = LENGTH / 2 * angles @ x[: degree + 1]
        sin, cos, stretch = np.sin(angle), np.cos(angle), 1 + strain
        slope = np.stack([stretch * sin + shear * cos, 0 * sin, stretch * cos - shear * sin], axis=-1)
        return curvature, strain, shear, slope

    def energy(x: np.ndarray) -> complex:
        curvature, strain, shear, slope = shape(x)
        elastic = (EI * curvature**2 + EA * strain**2 + GA * shear**2) / 2
        chambers = np.sqrt(shear[:, None] ** 2 + (1 + strain[:, None] - curvature[:, None] * X) ** 2)  # length per length
        return weights @ (elastic - AREA * chambers @ PRESSURE - (carried * slope).sum(axis=-1))

    def gradient(x: np.ndarray) -> np.ndarray:
        step = 1e-30j  # exact: nothing is subtracted
        return np.array([energy(x + step * row).imag / 1e-30 for row in np.eye(len(x))]) * scale

    scale = 1 / np.repeat([EI, EA, GA], degree + 1)
    found = root(gradient, np.zeros(len(scale)), tol=1e-12)
    return weights @ shape(found.x)[3]


def main(arguments: Sequence[str] | None = None) -> tuple[float, float]:
    """Distance of the tip from that of the arc, and from that of the least energy [m]."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", help="picture to write")
    options = parser.parse_args(arguments)
    robot, gaps = segment(), []
    loads = {"tip_force": FORCE, "gravity": (0, 0, -9.81)}
    for name, more, expected in (("in free space", {}, arc()), ("with weight and a force", loads, least_energy())):
        solution = mr.solve(robot, robot.inputs(pressure=PRESSURE, **more)).raise_if_failed()
        gaps.append(float(np.linalg.norm(solution.tip_position - expected)))
        length = 1e3 * solution.line_length.mean()
        bent = np.degrees(np.arccos(solution.tip_rotation[2, 2]))
        tip = np.round(1e3 * solution.tip_position, 3)
        print(f"{name}: tip {tip} mm, bent by {bent:.1f} degrees, {length:.1f} mm long; {gaps[-1]:.0e} m from the check")
    if options.out:
        solution.plot().figure.savefig(options.out, dpi=80, bbox_inches="tight", metadata={"Software": None})
    return gaps[0], gaps[1]


if __name__ == "__main__":
    main()
