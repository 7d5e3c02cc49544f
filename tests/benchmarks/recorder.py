"""What a recorder costs a control loop: the time of ``log``, and of the loop with and without it.

python tests/benchmarks/recorder.py [--samples 4000] [--rate 1000] [--rounds 3]

Each round runs the loop alone and recorded in turn; what is printed is the median of the rounds. Where others use the machine,
``chrt -f 10`` before the command keeps them out, and ``OPENBLAS_NUM_THREADS=1`` threads that wait for each other.
"""

import argparse
import gc
import tempfile
from collections.abc import Sequence
from pathlib import Path
from time import perf_counter, sleep

import numpy as np

import multirod as mr
from multirod.studies import experiment, scenes


def robots() -> dict[str, tuple[mr.Assembly, dict[str, object], str]]:
    """A robot, its inputs at the start, and the input that moves, by name."""
    wire = mr.SingleRod(experiment.wire())
    tubes, legs = scenes.three_tubes(), scenes.six_legs()
    return {
        "one rod": (wire, {"tip_force": (0.1, 0, 0), "rotation": 0.0}, "rotation"),
        "three tubes": (tubes.robot, {"translation": tubes.inputs.translation[0], "rotation": (0.0, 0, 0)}, "rotation"),
        "six legs": (legs.robot, {"tip_force": (0.1, 0, -5.0)}, "tip_force"),
    }


def loop(robot: mr.Assembly, start: dict[str, object], moved: str, samples: int, dt: float, path: Path | None) -> np.ndarray:
    """Times of ``log`` and of a whole sample, without its rest [s], shape (samples, 2)."""
    tracker = mr.Tracker(robot, solver=mr.Observer(integrator=mr.RK4(50)), dt=dt, inputs=robot.inputs(**start))
    tracker.step()
    first = np.array(start[moved], dtype=float)
    found = np.zeros((samples, 2))
    recorder = None if path is None else mr.Recorder(path)
    gc.disable()
    due = perf_counter()
    for k in range(samples):
        begin = perf_counter()
        solution = tracker.step(**{moved: first + 1e-4 * k})
        stepped = perf_counter()
        if recorder is not None:
            recorder.log(k * dt, solution, step_time=stepped - begin)
        end = perf_counter()
        found[k] = end - stepped, end - begin
        due += dt
        if due > end:
            sleep(due - end)
    gc.enable()
    if recorder is not None:
        begin = perf_counter()
        recorder.close()
        closing, size = perf_counter() - begin, path.stat().st_size / 1e6
        print(f"  closed after {closing:.2f} s, {recorder.left_out} samples left out, {size:.1f} MB", flush=True)
    return found


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--samples", type=int, default=4000)
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--rate", type=float, default=1000.0, help="[Hz]")
    options = parser.parse_args(arguments)
    with tempfile.TemporaryDirectory() as folder:
        for name, (robot, start, moved) in robots().items():
            print(f"{name}, {options.rate:g} Hz")
            loop(robot, start, moved, 50, 1e-3, Path(folder) / "warm.rrd")  # kernels are loaded
            kinds = {"alone": None, "recorded": Path(folder) / "run.rrd"}
            rounds: dict[str, list[np.ndarray]] = {title: [] for title in kinds}
            for _ in range(options.rounds):
                for title, path in kinds.items():
                    times = loop(robot, start, moved, options.samples, 1 / options.rate, path)
                    rounds[title].append(1e3 * np.quantile(times, [0.5, 0.999, 1.0], axis=0))
            for title, column, what in (("alone", 1, "sample"), ("recorded", 0, "log"), ("recorded", 1, "sample")):
                low, high, most = np.median(rounds[title], axis=0)[:, column]
                print(f"  {title:8} {what:6} median {low:7.3f}  99.9 % {high:7.3f}  largest {most:7.3f} ms")


if __name__ == "__main__":
    main()
