"""Estimation: forces from poses and curvatures against the Cramer-Rao bound, and what a sample costs.

python tests/benchmarks/estimate.py [--rounds N] [--trials N]
python tests/benchmarks/estimate.py --straight [--trials N]: forces on a straight wire of nitinol, by a coarse pose

Measurements and the bound come from ``measured_rods``, an integration of its own, by differences. What samples take is told
against a bare C loop of one integration, which takes turns with them.
"""

import argparse
import sys
import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path
from time import perf_counter

import numpy as np
from single_rod import c_loop

import multirod as mr

sys.path.insert(0, str(Path(__file__).parents[1]))
from measured_rods import STEPS, MeasuredRod, turned_by

POSITION, ANGLE, BENT = 1e-4, np.radians(0.1), 0.05  # what sensors are off [m], [rad], [1/m]
COARSE, CHI_SQUARE = (5e-4, 5e-3), 7.815  # what a coarse pose is off [m], [rad]; 95 % of squares in three dimensions are less
SIGMA, WALK, DT, SAMPLES = 0.25, 0.3, 1e-3, 400
WIRE = {"length": 0.4, "bending_stiffness": 0.223349, "torsional_stiffness": 0.063814, "precurvature": (14, 5, 0)}
STRAIGHT = {"length": 0.2, "bending_stiffness": 0.00611, "torsional_stiffness": 0.00468, "precurvature": (0, 0, 0)}
NODES = tuple(range(5, STEPS, 5))  # of the gratings
MARKS = (3, 6, 9)  # of ten places, which have markers
FIXED = mr.RK4(50)


def straight(trials: int) -> None:
    """Forces as large as bend a straight wire far: what a covariance at the estimate leaves out."""
    robot = mr.SingleRod(mr.Rod(**STRAIGHT))
    print("| prior [N] | squares per dimension | outside of 95 % | largest square | not consistent |")
    print("|---|---|---|---|---|")
    for sigma in (0.02, 0.1, 0.3):
        random = np.random.default_rng(11)
        force = sigma * random.normal(size=(trials, 3))
        true = mr.solve(robot, robot.inputs(tip_force=force))  # beyond where it buckles: by the package itself
        p = true.tip_position + COARSE[0] * random.normal(size=(trials, 3))
        R = turned_by(COARSE[1] * random.normal(size=(trials, 3))) @ true.tip_rotation
        pose = mr.Pose(position=p, rotation=R, sigma=COARSE)
        found = mr.estimate(robot, unknown={"tip_force": mr.Prior(0, sigma=sigma)}, measured=pose).raise_if_failed()
        error = found.value("tip_force") - force
        squares = np.einsum("bi,bij,bj->b", error, np.linalg.inv(found.covariance("tip_force")), error)
        outside, off = (squares > CHI_SQUARE).mean(), (~found.consistent).mean()
        print(f"| {sigma} | {squares.mean() / 3:.2f} | {outside:.1%} | {squares.max():.0f} | {off:.1%} |")


def quality(trials: int) -> None:
    """Integrations, errors over the bound, and squares of errors over what the covariance says, static."""
    rod, robot = MeasuredRod(**WIRE), mr.SingleRod(mr.Rod(**WIRE))
    random = np.random.default_rng(16)
    force = SIGMA * random.normal(size=(trials, 3))
    p, R, u, _ = rod.seen(force, NODES)
    p = p + POSITION * random.normal(size=p.shape)
    R = turned_by(ANGLE * random.normal(size=(trials, 3))) @ R
    u = u + BENT * random.normal(size=u.shape)
    at = np.array(NODES) * WIRE["length"] / STEPS
    gratings = mr.Curvature(at=at, value=u[..., :2], sigma=BENT)
    pose = mr.Pose(position=p, rotation=R, sigma=(POSITION, ANGLE))
    kinds = {
        "a pose": (pose, {"position": POSITION, "angle": ANGLE}),
        f"{len(NODES)} curvatures": (gratings, {"at": NODES, "curvature": BENT, "components": 2}),
    }
    print("| force from | integrations | error over the bound | squares per dimension | error over the force |")
    print("|---|---|---|---|---|")
    for name, (sensor, told) in kinds.items():
        found = mr.estimate(robot, unknown={"tip_force": mr.Prior(0, sigma=SIGMA)}, measured=sensor).raise_if_failed()
        error, covariance = found.value("tip_force") - force, found.covariance("tip_force")
        squares = np.einsum("bi,bij,bj->", error, np.linalg.inv(covariance), error) / (3 * trials)
        bound = np.linalg.inv(rod.information(force, **told) + np.eye(3) / SIGMA**2)
        over = np.sqrt((error**2).sum() / np.trace(bound, axis1=1, axis2=2).sum())
        relative = np.sqrt((error**2).sum() / (force**2).sum())
        print(f"| {name} | at most {found.integrations.max()} | {over:.3f} | {squares:.3f} | {relative:.1%} |")


def motion() -> tuple[np.ndarray, np.ndarray, mr.Solution]:
    """Angles of the base, forces, and where the tip goes."""
    robot = mr.SingleRod(mr.Rod(**WIRE))
    angle = 0.5 * np.sin(2 * np.pi * DT * np.arange(SAMPLES))
    steps = WALK * np.sqrt(DT) * np.random.default_rng(1).normal(size=(SAMPLES, 3))
    force = (0.2, -0.1, 0.3) + np.cumsum(steps, axis=0)
    return angle, force, mr.solve(robot, robot.inputs(rotation=angle, tip_force=force), solver=mr.Shooting(integrator=FIXED))


def estimator_step(sensors: Sequence[mr.Pose | mr.Curvature], said: Callable[[int], list[object]]) -> Callable[[], float]:
    """Microseconds of ``Estimator.step``."""
    angle, _, _ = motion()
    meter = mr.Estimator(
        mr.SingleRod(mr.Rod(**WIRE)), dt=DT, unknown={"tip_force": mr.Walk(WALK)}, sensors=sensors, integrator=FIXED
    )

    def measure() -> float:
        times = []
        for k in range(SAMPLES):
            own = said(k)
            begin = perf_counter()
            sample = meter.step(own, rotation=angle[k])
            times.append(perf_counter() - begin)
        assert sample.integrations == 1
        return 1e6 * float(np.median(times))

    return measure


def tracker_step() -> float:
    """Microseconds of ``Tracker.step`` by Newton's method."""
    angle, force, _ = motion()
    robot = mr.SingleRod(mr.Rod(**WIRE))
    tracker = mr.Tracker(robot, solver=mr.Shooting(integrator=FIXED), dt=DT, inputs=robot.inputs(tip_force=force[0]))
    times = []
    for k in range(SAMPLES):
        begin = perf_counter()
        tracker.step(rotation=angle[k], tip_force=force[k])
        times.append(perf_counter() - begin)
    return 1e6 * float(np.median(times))


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rounds", type=int, default=7)
    parser.add_argument("--trials", type=int, default=500)
    parser.add_argument("--straight", action="store_true")
    options = parser.parse_args()
    if options.straight:
        straight(options.trials)
        return
    quality(options.trials)
    _, _, seen = motion()
    position, rotation, shape = np.array(seen.tip_position), np.array(seen.tip_rotation), seen.rod(0, nodes=12)
    at, bent = shape.arclength[0, 1:-1], np.array(shape.curvature[:, 1:-1, :2])
    marks = np.array(shape.position[:, 1:-1])
    pose = mr.Pose(position=position[0], rotation=rotation[0], sigma=(POSITION, ANGLE))
    marked = [mr.Pose(position=marks[0, j], at=at[j], sigma=POSITION) for j in MARKS]
    runs: dict[str, Callable[[], float]] = {
        "Tracker.step, Newton to 1e-9": tracker_step,
        "Estimator.step, a pose": estimator_step([pose], lambda k: [(position[k], rotation[k])]),
        "Estimator.step, 10 curvatures": estimator_step([mr.Curvature(at=at, value=bent[0], sigma=BENT)], lambda k: [bent[k]]),
        "Estimator.step, 3 markers": estimator_step(marked, lambda k: [marks[k, j] for j in MARKS]),
    }
    times: dict[str, list[float]] = {name: [] for name in runs}
    floors: list[float] = []
    for run in runs.values():
        run()
    with tempfile.TemporaryDirectory() as folder:
        floor = c_loop(Path(folder), repeats=200)
        for _ in range(options.rounds):
            floors.append(np.nan if floor is None else floor())
            for name, run in runs.items():
                times[name].append(run())
    print(f"\nbare C loop, one integration, RK4(50): {np.median(floors):.2f} µs")
    print("\n| what | µs | spread | bare C loops | over Tracker.step |\n|---|---|---|---|---|")
    first = np.array(times["Tracker.step, Newton to 1e-9"])
    for name, values in times.items():
        loops, ratio = (np.median(np.array(values) / own) for own in (floors, first))
        print(f"| {name} | {np.median(values):.0f} | {min(values):.0f} to {max(values):.0f} | {loops:.1f} | {ratio:.2f} |")


if __name__ == "__main__":
    main()
