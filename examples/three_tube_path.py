"""A robot of three concentric tubes, turned and pushed along a smooth actuation; its tip's path is drawn.

The tubes are those of the public models after M. Khadem, L. Da Cruz, C. Bergeles, IROS 2018, 4920-4926.
"""

import argparse
from collections.abc import Sequence

import numpy as np

import multirod as mr


def tube(name: str, length: float, curved: float, curvature: float, bending: float, torsion: float) -> mr.Rod:
    precurvature = [(length - curved, (0, 0, 0)), (curved, (curvature, 0, 0))]
    return mr.Rod(length=length, bending_stiffness=bending, torsional_stiffness=torsion, precurvature=precurvature, name=name)


TUBES = [
    tube("inner", 0.431, 0.103, 21.3, 3.868e-3, 3.011e-3),
    tube("middle", 0.332, 0.113, 13.108, 1.7168e-2, 1.4018e-2),
    tube("outer", 0.174, 0.134, 3.5, 3.9768e-2, 5.0224e-2),
]


def main(arguments: Sequence[str] | None = None) -> float:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", default="three_tube_path.rrd")
    parser.add_argument("--samples", type=int, default=1000)
    options = parser.parse_args(arguments)
    robot = mr.ConcentricTubes(TUBES)
    t = np.linspace(0, 10, options.samples)
    phase = 2 * np.pi * t / t[-1]
    rotation = np.stack([phase + 0.4 * np.sin(2 * phase), phase, phase - 0.5 * np.sin(phase)], axis=-1)
    out = 0.5 - 0.5 * np.cos(2 * phase)  # from 0 to 1 and back, twice
    translation = np.stack([-0.3358 + 0.05 * out, -0.2425 + 0.03 * out, -0.0945 + 0 * out], axis=-1)
    inputs = robot.inputs(rotation=rotation, translation=translation)
    exact = mr.simulate(robot, inputs, time=t)
    history = mr.simulate(robot, inputs, time=t, solver=mr.Observer(feed_forward=True))
    history.save(options.out, reference=exact)
    lag = 1e3 * np.linalg.norm(history.tip_position - exact.tip_position, axis=-1)
    path = 1e3 * np.linalg.norm(np.diff(exact.tip_position, axis=0), axis=-1).sum()
    print(f"tip path of {path:.0f} mm; the observer is {lag.max():.2g} mm off at most, {np.median(lag):.2g} mm in the median")
    print(
        f"a sample takes {1e6 * np.median(history.step_time):.0f} µs, "
        f"by Newton's method {1e6 * np.median(exact.step_time):.0f} µs"
    )
    print(f"recorded to {options.out}")
    return float(np.median(lag))


if __name__ == "__main__":
    main()
