"""Parallel rods: time of a step along a motion, integrations cold and warm, and how both grow with the legs.

python tests/benchmarks/parallel_rods.py [--rounds N]
"""

import argparse
from collections.abc import Callable
from time import perf_counter

import numpy as np

import multirod as mr

STEPS = 50
SAMPLES = 200


def robot(legs: int) -> mr.ParallelRods:
    """Straight legs on a circle that lean 40 degrees of it to one side and the other in turn, as in a Stewart platform."""
    leg = mr.Rod(length=0.4, bending_stiffness=0.157, torsional_stiffness=0.126)
    base, platform = np.tile(np.eye(4), (legs, 1, 1)), np.tile(np.eye(4), (legs, 1, 1))
    lean = np.radians(40) * (-1.0) ** np.arange(legs)
    for poses, twist in ((base, 0.0), (platform, lean)):
        angle = twist + 2 * np.pi * np.arange(legs) / legs
        poses[:, :2, 3] = 0.087 * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    return mr.ParallelRods(legs=[leg] * legs, base=base, platform=platform)


def motion(legs: int) -> tuple[np.ndarray, np.ndarray]:
    """Translations (sample, leg) and forces (sample, 3) over one second at 200 Hz."""
    t = 0.005 * np.arange(SAMPLES)
    phase = 2 * np.pi * (t[:, None] + np.arange(legs) / legs)
    force = np.stack([np.sin(np.pi * t), np.cos(np.pi * t), -np.ones_like(t)], axis=1)
    return 0.01 * np.sin(phase), force


def tracker_step(legs: int, solver: mr.Solver) -> Callable[[], tuple[float, float, int]]:
    """Microseconds of ``Tracker.step``, the mean and the largest number of integrations of a leg after two samples."""
    parallel, (translation, force) = robot(legs), motion(legs)

    def measure() -> tuple[float, float, int]:
        start = parallel.inputs(translation=translation[0], tip_force=force[0])
        tracker = mr.Tracker(parallel, solver=solver, dt=0.005, inputs=start)
        times, counts = [], []
        for k in range(SAMPLES):
            begin = perf_counter()
            solution = tracker.step(translation=translation[k], tip_force=force[k])
            times.append(perf_counter() - begin)
            counts.append(int(solution.integrations))
            solution.raise_if_failed()
        return 1e6 * float(np.median(times[2:])), float(np.mean(counts[2:])), max(counts[2:])

    return measure


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rounds", type=int, default=7)
    options = parser.parse_args()
    integrator = mr.RK4(STEPS)
    solvers: dict[str, mr.Solver] = {
        "Newton to 1e-9": mr.Shooting(integrator=integrator),
        "Newton to 1e-9, linear predictor": mr.Shooting(integrator=integrator, predictor="linear"),
    }
    legs = (3, 6, 12)
    runs = {(count, name): tracker_step(count, solver) for count in legs for name, solver in solvers.items()}
    results: dict[tuple[int, str], list[tuple[float, float, int]]] = {key: [] for key in runs}
    for run in runs.values():
        run()
    for _ in range(options.rounds):
        for key, run in runs.items():
            results[key].append(run())
    print(f"Tracker.step along a motion, RK4({STEPS}), one thread\n")
    print("| legs | solver | µs | spread | µs a leg | integrations a leg, mean | most |\n|---|---|---|---|---|---|---|")
    for (count, name), values in results.items():
        time = [value[0] for value in values]
        print(
            f"| {count} | {name} | {np.median(time):.0f} | {min(time):.0f} to {max(time):.0f} | {np.median(time) / count:.0f} "
            f"| {values[0][1]:.2f} | {values[0][2]} |"
        )
    print("\n| legs | integrations of all legs from the unloaded guess |\n|---|---|")
    for count in legs:
        parallel = robot(count)
        solution = mr.solve(parallel, parallel.inputs(tip_force=(0, 1.0, -1.0))).raise_if_failed()
        print(f"| {count} | {count * int(solution.integrations)} |")


if __name__ == "__main__":
    main()
