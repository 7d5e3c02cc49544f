"""A control loop: the observer follows commands sample by sample, and every sample is recorded as it comes."""

import argparse
from collections.abc import Sequence
from math import cos, pi, sin
from time import perf_counter

import numpy as np

import multirod as mr


def main(arguments: Sequence[str] | None = None) -> float:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", default="control_loop.rrd")
    parser.add_argument("--time", type=float, default=5.0, help="duration [s]")
    options = parser.parse_args(arguments)
    wire = mr.Rod.tube(
        length=0.4,
        outer_diameter=3e-3,
        inner_diameter=2e-3,
        young_modulus=70e9,
        shear_modulus=27e9,
        precurvature=[(0.3, (0, 0, 0)), (0.1, (14, 5, 0))],
        name="wire",
    )
    robot = mr.SingleRod(wire)
    dt = 0.005
    start = robot.inputs(tip_force=(0, 0.5, 0))
    tracker = mr.Tracker(robot, solver=mr.Observer(feed_forward=True, integrator=mr.RK4(50)), dt=dt, inputs=start)
    times = []
    with mr.Recorder(options.out) as recorder:
        for k in range(round(options.time / dt)):
            angle = 2 * pi * k * dt / 10
            begin = perf_counter()
            solution = tracker.step(rotation=angle, tip_force=(0.5 * sin(angle), 0.5 * cos(angle), 0.0))
            times.append(perf_counter() - begin)
            recorder.log(k * dt, solution)
    residual = float(solution.residual)
    print(
        f"{len(times)} samples, median {1e6 * np.median(times):.0f} µs, last residual {residual:.1e} 1/m; "
        f"recorded to {options.out}"
    )
    return residual


if __name__ == "__main__":
    main()
