"""A clamped rod under a force across its tip, by PyElastica and by this package: how long until the tip is within an error.

PyElastica (``pip install pyelastica``) integrates in time; equilibrium is where its rod comes to rest. So it is given what suits
that: a soft rod, whose time steps may be long; damping that is critical for the slowest vibration; and half an element more
behind the base, since what it clamps is the middle of the first element (without that its error is of first order, 6e-3 at 100
elements). It simulates dynamics, contact and much else that this package does not: what is compared is only what both can do.
The error is against elliptic integrals of a rod that neither shears nor stretches; PyElastica's does a little, by less than 1e-4
of the length here.

python tests/benchmarks/compare_pyelastica.py [--elements 20 50 100] [--error 1e-3]
"""

import argparse
import contextlib
import io
from importlib.metadata import version
from time import perf_counter

import elastica
import numpy as np
from scipy.optimize import brentq
from scipy.special import ellipeinc, ellipk, ellipkinc

import multirod as mr

LENGTH, RADIUS, DENSITY, E, NU = 1.0, 0.01, 1000.0, 1e6, 0.5
EI = E * np.pi * RADIUS**4 / 4
GJ = E / (2 * (1 + NU)) * np.pi * RADIUS**4 / 2
FORCE = 3 * EI / LENGTH**2
SLOWEST = 1.8751**2 * np.sqrt(EI / (DENSITY * np.pi * RADIUS**2 * LENGTH**4))  # circular frequency of a cantilever [1/s]
PART = 0.25  # of simulated time between looks at the tip [s]
LONGEST = 30.0  # [s], simulated


def elliptic_tip() -> tuple[float, float]:
    """Tip across and along the rod: ``t'' = -k^2 cos t`` from ``t(0) = 0`` to ``t'(L) = 0``."""
    k = np.sqrt(FORCE / EI)

    def start(p: float) -> float:
        return float(np.arcsin(1 / (np.sqrt(2) * p)))

    p = brentq(lambda p: ellipk(p * p) - ellipkinc(start(p), p * p) - k * LENGTH, np.sqrt(0.5) + 1e-12, 1 - 1e-12)
    across = LENGTH - 2 / k * (ellipeinc(np.pi / 2, p * p) - ellipeinc(start(p), p * p))
    return float(across), float(2 * p / k * np.cos(start(p)))


class Simulator(elastica.BaseSystemCollection, elastica.Constraints, elastica.Forcing, elastica.Damping):
    """What PyElastica asks for: a collection of rods with what acts on them."""


def relax(element_count: int, error: float, tip: tuple[float, float]) -> tuple[float, float, float]:
    """Until the tip stays within ``error``: time on the clock [s], simulated time [s], error at rest."""
    element = LENGTH / (element_count - 0.5)
    dt = 0.01 * element  # as in its examples
    damping = 2 * SLOWEST
    rod = elastica.CosseratRod.straight_rod(
        element_count,
        np.array([0.0, 0.0, -element / 2]),
        np.array([0.0, 0.0, 1.0]),
        np.array([1.0, 0.0, 0.0]),
        LENGTH + element / 2,
        RADIUS,
        DENSITY,
        youngs_modulus=E,
        shear_modulus=E / (2 * (1 + NU)),
    )
    simulator = Simulator()
    simulator.append(rod)
    simulator.constrain(rod).using(elastica.OneEndFixedBC, constrained_position_idx=(0,), constrained_director_idx=(0,))
    simulator.add_forcing_to(rod).using(elastica.EndpointForces, np.zeros(3), np.array([FORCE, 0.0, 0.0]), ramp_up_time=1e-2)
    simulator.dampen(rod).using(elastica.AnalyticalLinearDamper, uniform_damping_constant=damping, time_step=dt)
    simulator.finalize()
    stepper = elastica.PositionVerlet()
    steps = round(PART / dt)
    time, spent, within = 0.0, 0.0, None
    for _ in range(round(LONGEST / PART)):
        begin = perf_counter()
        with contextlib.redirect_stdout(io.StringIO()):
            time = elastica.integrate(stepper, simulator, PART, steps, restart_time=time, progress_bar=False)
        spent += perf_counter() - begin
        across, along = rod.position_collection[0, -1], rod.position_collection[2, -1]
        off = float(np.hypot(along - tip[1], across - tip[0])) / LENGTH
        if off > error:
            within = None
        elif within is None:
            within = spent, time
    return (*(within or (np.nan, np.nan)), off)


def solve(integrator: mr.Integrator, tip: tuple[float, float]) -> tuple[float, float]:
    """Median time of a solve from nothing [s], and its error."""
    robot = mr.SingleRod(mr.Rod(length=LENGTH, bending_stiffness=EI, torsional_stiffness=GJ))
    inputs = robot.inputs(tip_force=(FORCE, 0, 0))
    times = []
    for _ in range(51):
        begin = perf_counter()
        solution = mr.solve(robot, inputs, solver=mr.Shooting(integrator=integrator)).raise_if_failed()
        times.append(perf_counter() - begin)
    return float(np.median(times)), float(np.hypot(*(solution.tip_position[[0, 2]] - tip))) / LENGTH


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--elements", type=int, nargs="+", default=[20, 50, 100])
    parser.add_argument("--error", type=float, default=1e-3, help="of the tip, over the length")
    options = parser.parse_args()
    tip = elliptic_tip()
    relax(options.elements[0], options.error, tip)  # compiles
    print(f"F L^2/EI = 3; PyElastica {version('pyelastica')}, multirod {mr.__version__}; error of the tip, over the length")
    print(f"| what | until within {options.error:g} | simulated [s] | error at the end |\n|---|---|---|---|")
    for count in options.elements:
        spent, time, off = relax(count, options.error, tip)
        print(f"| PyElastica, {count} elements | {spent:.2f} s | {time:.1f} | {off:.1e} |")
    for integrator in (mr.RK4(10), mr.RK4(50), mr.RK45()):
        spent, off = solve(integrator, tip)
        name = repr(integrator).partition(", precision")[0].replace(", steps=None", "")
        print(f"| mr.solve, {name}) | {1e3 * spent:.2f} ms | | {off:.1e} |")


if __name__ == "__main__":
    main()
