"""The wire of the observer's paper, and its published figures beside those found here.

B. Thamo, K. Dhaliwal, M. Khadem, "Rapid Solution of Cosserat Rod Equations via a Nonlinear Partial Observer", ICRA 2021. Its text
has 0.4 m in use at the start, its program 0.2 m: both are run, for 10 s at 200 Hz, by the paper's own law.
"""

import argparse
from collections.abc import Sequence

import numpy as np

import multirod as mr
from multirod.studies.experiment import motion

PUBLISHED = {"boundary error": 0.0241, "tip error": 0.13}  # means, in 1/m and mm
OBSERVER = mr.Observer(R=120, Q=30, update="euler", integrator=mr.RK4(50))
SETTLED = 60  # samples, 0.3 s


def main(arguments: Sequence[str] | None = None) -> dict[float, tuple[float, float]]:
    """Mean boundary error [1/m] and mean tip error [mm], by length in use at the start."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", help="picture to write")
    options = parser.parse_args(arguments)
    found = {}
    print(f"{'published':12} boundary error {PUBLISHED['boundary error']} 1/m, tip error {PUBLISHED['tip error']} mm")
    for length in (0.4, 0.2):
        run = motion(length=length)
        history = mr.simulate(run.robot, run.inputs, time=run.time, solver=OBSERVER)
        exact = mr.simulate(run.robot, run.inputs, time=run.time, solver=mr.Shooting(integrator=mr.RK4(50))).raise_if_failed()
        error = 1e3 * np.linalg.norm(history.tip_position - exact.tip_position, axis=1)
        boundary = np.linalg.norm(history.boundary_residual, axis=1)
        found[length] = float(boundary[SETTLED:].mean()), float(error[SETTLED:].mean())
        print(f"from {length} m   boundary error {found[length][0]:.4f} 1/m, tip error {found[length][1]:.2f} mm")
        if options.out and length == 0.4:
            axes = history.plot(instances=6, loads=False)
            axes.figure.savefig(options.out, dpi=80, bbox_inches="tight", metadata={"Software": None})
    return found


if __name__ == "__main__":
    main()
