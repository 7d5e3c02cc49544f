"""One rod against a bare C loop of the same integration, rounds interleaved: ratios, medians and spread.

python tests/benchmarks/single_rod.py [--rounds N] [--device DEVICE]
"""

import argparse
import shutil
import subprocess
import tempfile
from collections.abc import Callable
from pathlib import Path
from time import perf_counter

import numpy as np
import warp as wp

import multirod as mr
from multirod.models.backbone.problem import BackboneProblem
from multirod.studies.experiment import wire

STEPS = 50
BATCH = 10_000


def c_loop(folder: Path, repeats: int = 4000) -> Callable[[], float] | None:
    """Microseconds of one integration by the C loop, the best of five runs of ``repeats``; None without a C compiler."""
    compiler = shutil.which("cc") or shutil.which("gcc") or shutil.which("clang")
    if compiler is None:
        return None
    program = folder / "floor"
    source = Path(__file__).with_name("floor.c")
    subprocess.run([compiler, "-O3", "-march=native", "-ffast-math", str(source), "-o", str(program)], check=True)
    return lambda: float(
        subprocess.run([program, str(STEPS), str(repeats)], check=True, capture_output=True, text=True).stdout.split()[0]
    )


def tracker_step(solver: mr.Solver) -> Callable[[], float]:
    """Microseconds of ``Tracker.step``, inputs changed by name in each."""
    robot = mr.SingleRod(wire())
    tracker = mr.Tracker(robot, solver=solver, dt=0.005)
    angle = [0.0]

    def measure() -> float:
        times = []
        for _ in range(500):
            angle[0] += 0.005 * 0.2 * np.pi
            sine, cosine = float(np.sin(angle[0])), float(np.cos(angle[0]))
            begin = perf_counter()
            tracker.step(rotation=angle[0], translation=0.0, tip_force=(sine, cosine, sine))
            times.append(perf_counter() - begin)
        return 1e6 * float(np.median(times))

    return measure


def batch(device: str, *, pose: bool) -> Callable[[], float]:
    """Microseconds of one integration with residual and Gamma in a launch of a batch, on one thread."""
    robot = mr.SingleRod(wire())
    force = np.tile([1.0, 0.0, 0.5], (BATCH, 1)) + 1e-3 * np.random.default_rng(0).standard_normal((BATCH, 3))
    inputs = robot.inputs(tip_force=force)
    problem = BackboneProblem(robot.rods, robot.base, inputs, integrator=mr.RK4(STEPS), device=device, pose=pose)
    problem.write("unknowns", problem.guess())
    problem.integrate()

    def measure() -> float:
        times = []
        for _ in range(5):
            wp.synchronize_device(device)
            begin = perf_counter()
            problem.integrate()
            wp.synchronize_device(device)
            times.append(perf_counter() - begin)
        return 1e6 * min(times) / BATCH

    return measure


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rounds", type=int, default=9)
    parser.add_argument("--device", default="cpu", help="Warp device of the batches")
    options = parser.parse_args()
    integrator = mr.RK4(STEPS)
    runs: dict[str, Callable[[], float]] = {
        "Tracker.step, observer": tracker_step(mr.Observer(R=120, Q=30, integrator=integrator)),
        "Tracker.step, observer with feed-forward": tracker_step(
            mr.Observer(R=120, Q=30, feed_forward=True, integrator=integrator)
        ),
        "Tracker.step, Newton to 1e-9": tracker_step(mr.Shooting(integrator=integrator)),
        f"batch of {BATCH}, residual and Gamma": batch(options.device, pose=False),
        f"batch of {BATCH}, and the tip's pose": batch(options.device, pose=True),
    }
    with tempfile.TemporaryDirectory() as folder:
        floor = c_loop(Path(folder), repeats=200)  # short runs, of which one finds a quiet time
        floors: list[float] = []
        times: dict[str, list[float]] = {name: [] for name in runs}
        for run in runs.values():
            run()
        for _ in range(options.rounds):
            if floor is not None:
                floors.append(floor())
            for name, run in runs.items():
                times[name].append(run())
    if floors:
        print(f"bare C loop, one integration, RK4({STEPS}): {np.median(floors):.2f} µs")
    else:
        print("no C compiler found: times without ratios")
    print("\n| what | µs | spread | bare C loops |\n|---|---|---|---|")
    for name, values in times.items():
        ratio = f"{np.median(np.array(values) / floors):.2f}" if floors else ""
        print(f"| {name} | {np.median(values):.2f} | {min(values):.2f} to {max(values):.2f} | {ratio} |")


if __name__ == "__main__":
    main()
