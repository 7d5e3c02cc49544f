"""The paper's simulation study (Section IV): its rod, its motion, its solvers, and how they are compared."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import pi

import numpy as np

from multirod.integrators import RK45, Integrator
from multirod.models.assemblies.single_rod import SingleRod
from multirod.results.history import History
from multirod.rod import Rod
from multirod.running.simulation import simulate
from multirod.solver import Solver
from multirod.solvers.observer import Observer
from multirod.solvers.scipy_shooting import ScipyShooting
from multirod.solvers.shooting import Shooting
from multirod.studies.scenes import Motion

LENGTH = 0.4
TABLE_I = 3.1907e-12  # second moment of area [m^4]; J is twice that
SETTLING_TIME = 0.3
Progress = Callable[[int], None]


def wire(length: float = LENGTH, *, I: float = TABLE_I, outer_diameter: float = 3e-3) -> Rod:
    """The rod of Table I, a precurved Nitinol wire; its printed moduli mean a Poisson ratio of 2.5, kept as printed."""
    return Rod(
        length=length,
        bending_stiffness=70e9 * I,
        torsional_stiffness=10e9 * 2 * I,
        precurvature=(14, 5, 0),
        outer_diameter=outer_diameter,
        inner_diameter=outer_diameter * 2 / 3,
        name="wire",
    )


def motion(
    *,
    duration: float = 10.0,
    rate: float = 200.0,
    length: float = LENGTH,
    rod: Rod | None = None,
    angular_rate: float = 2 * pi / 10,
) -> Motion:
    """The paper's motion: turned at ``angular_rate`` [rad/s], pushed at 10 mm/s, a tip force of 1 N in x, y and z that turns too.

    Args:
        duration: [s].
        rate: Samples a second.
        length: In use at the start [m]; the text of the paper has 0.4 m, its published code 0.2 m.
        rod: That of Table I by default.
        angular_rate: [rad/s].
    """
    rod = wire() if rod is None else rod
    time = np.arange(round(duration * rate) + 1) / rate
    angle = angular_rate * time
    robot = SingleRod(rod)
    force = np.stack([np.sin(angle), np.cos(angle), np.sin(angle)], axis=-1)
    shift = length - float(rod.length) + 0.01 * time
    return Motion(robot, robot.inputs(rotation=angle, translation=shift, tip_force=force), time)


def solvers(integrator: Integrator) -> dict[str, Solver]:
    """The solvers of the study, by the name that the command line takes."""
    return {
        "observer": Observer(R=120, Q=30, update="euler", integrator=integrator),
        "observer-exact": Observer(R=120, Q=30, integrator=integrator),
        "observer-ff": Observer(R=120, Q=30, feed_forward=True, integrator=integrator),
        "interior-point": ScipyShooting(method="interior-point", integrator=integrator),
        "quasi-newton": ScipyShooting(method="quasi-newton", integrator=integrator),
        "nelder-mead": ScipyShooting(method="nelder-mead", integrator=integrator),
        "newton": Shooting(integrator=integrator),
    }


SLOW = ("interior-point", "quasi-newton", "nelder-mead")


@dataclass(frozen=True)
class Comparison:
    """One solver's errors and cost over a motion, in the shape of the paper's Table II; failed samples count apart.

    Attributes:
        samples: Samples run.
        failed: Of these, samples without a result.
        boundary_error: Mean and standard deviation of ``|eps|`` after ``SETTLING_TIME`` [1/m].
        tip_error: Mean and largest distance of the tip to the converged solution after it [m].
        step_time: 25th, 50th and 75th percentile [s].
        integrations: Mean a sample.
    """

    samples: int
    failed: int
    boundary_error: tuple[float, float]
    tip_error: tuple[float, float]
    step_time: tuple[float, float, float]
    integrations: float


def compare(history: History, reference: History) -> Comparison:
    """Compare a run with the converged solution of the same samples."""
    failed = ~np.isfinite(history.tip_position).all(axis=-1)
    settled = (history.time >= min(SETTLING_TIME, history.time[-1] / 2)) & ~failed
    boundary = np.linalg.norm(history.boundary_residual, axis=-1)[settled]
    tip = np.linalg.norm(history.tip_position - reference.tip_position[: len(history.time)], axis=-1)[settled]
    if not settled.any():
        boundary = tip = np.full(1, np.nan)
    low, median, high = np.percentile(history.step_time, [25, 50, 75])
    return Comparison(
        samples=len(history.time),
        failed=int(failed.sum()),
        boundary_error=(float(boundary.mean()), float(boundary.std())),
        tip_error=(float(np.nanmean(tip)), float(np.nanmax(tip))),
        step_time=(float(low), float(median), float(high)),
        integrations=float(np.mean(history.integrations)),
    )


def reference(study: Motion, progress: Progress | bool = True) -> History:
    """The converged solution: Newton to 1e-9 with an integration to 1e-11."""
    solver = Shooting(integrator=RK45(rtol=1e-11, atol=1e-13), predictor="quadratic")
    return simulate(study.robot, study.inputs, time=study.time, solver=solver, progress=progress)


def further_motions(count: int = 20, seed: int = 2021, duration: float = 2.0, rate: float = 200.0) -> Sequence[Motion]:
    """Motions like those of the paper's Table II: other dimensions, and rates between pi/50 and pi/5 Hz.

    The paper does not give its own: lengths from 0.2 to 0.4 m and outer diameters from 2.5 to 4 mm are drawn here, the
    ratio of the diameters and the precurvature kept, the force scaled with the stiffness so that no rod snaps.
    """
    generator = np.random.default_rng(seed)
    motions = []
    for _ in range(count):
        length, outer = generator.uniform(0.2, 0.4), generator.uniform(2.5e-3, 4e-3)
        frequency = generator.uniform(pi / 50, pi / 5)
        I = pi / 64 * (outer**4 - (outer * 2 / 3) ** 4)
        rod = wire(length, I=I, outer_diameter=outer)
        study = motion(duration=duration, rate=rate, length=length, rod=rod, angular_rate=2 * pi * frequency)
        scale = (I / TABLE_I) * (LENGTH / length) ** 2
        inputs = study.inputs.with_arrays(
            {
                "rotation": study.inputs.rotation,
                "translation": study.inputs.translation,
                "tip_force": study.inputs.tip_force * min(1.0, scale),
            }
        )
        motions.append(Motion(study.robot, inputs, study.time))
    return motions
