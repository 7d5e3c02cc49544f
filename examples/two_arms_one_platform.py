"""Two arms of two concentric tubes each hold one platform: pushing both lifts it, pushing one tilts it."""

import argparse
from collections.abc import Sequence

import numpy as np

import multirod as mr


def arm(bend: float) -> mr.ConcentricTubes:
    nitinol = {"young_modulus": 60e9, "shear_modulus": 23e9, "density": 6450.0}
    curve = [(0.2, (0, 0, 0)), (0.15, (0, bend, 0))]
    inner = mr.Rod.tube(length=0.35, outer_diameter=1.4e-3, inner_diameter=1e-3, precurvature=curve, name="inner", **nitinol)
    outer = mr.Rod.tube(length=0.22, outer_diameter=2.4e-3, inner_diameter=1.6e-3, name="outer", **nitinol)
    return mr.ConcentricTubes([inner, outer])


def poses(distance: float) -> np.ndarray:
    both = np.tile(np.eye(4), (2, 1, 1))
    both[:, 0, 3] = -distance, distance
    return both


def main(arguments: Sequence[str] | None = None) -> float:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", default="two_arms_one_platform.rrd")
    parser.add_argument("--samples", type=int, default=500)
    options = parser.parse_args(arguments)
    robot = mr.ParallelRods(legs=[arm(4.0), arm(-4.0)], base=poses(0.07), platform=poses(0.03), platform_mass=0.02)
    t = np.linspace(0, 10, options.samples)
    phase = 2 * np.pi * t / t[-1]
    both, one = 0.02 * np.sin(phase), 0.015 * np.sin(2 * phase)
    inner = np.stack([both + one, both - one], axis=-1) - 0.12  # where the tubes start, behind the plates
    translation = np.stack([inner[:, 0], 0.5 * inner[:, 0], inner[:, 1], 0.5 * inner[:, 1]], axis=-1)
    turn = 0.6 * np.sin(phase)
    rotation = np.stack([turn, 0 * turn, turn, 0 * turn], axis=-1)  # inner and outer tube of each arm
    inputs = robot.inputs(rotation=rotation, translation=translation, gravity=(0, 0, -9.81))
    exact = mr.simulate(robot, inputs, time=t).raise_if_failed()
    # the smallest singular value of Gamma is about 0.002 here, and the observer's slowest rate sqrt(R Q) times that
    observer = mr.Observer(R=1e6, feed_forward=True, fold_threshold=1e-4)
    history = mr.simulate(robot, inputs, time=t, solver=observer, guess=exact.unknowns[0])
    history.save(options.out, reference=exact)
    lag = 1e3 * np.linalg.norm(history.tip_position - exact.tip_position, axis=-1)
    tilt = np.degrees(np.arccos(exact.tip_rotation[:, 2, 2]))
    height = 1e3 * exact.tip_position[:, 2]
    print(f"the platform is {height.min():.0f} to {height.max():.0f} mm high and tilts by up to {tilt.max():.0f} deg")
    print(f"the observer is {np.median(lag):.2g} mm off in the median, {lag.max():.2g} mm at most, when the motion begins")
    print(
        f"a sample takes {1e6 * np.median(history.step_time):.0f} µs, "
        f"by Newton's method {1e6 * np.median(exact.step_time):.0f} µs"
    )
    print(f"recorded to {options.out}")
    return float(np.median(lag))


if __name__ == "__main__":
    main()
