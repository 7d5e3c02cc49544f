"""Three surgical tubes draw their tip back along a line, and keep away from where they snap.

Tubes are those of github SIRGLab/CTR_Python_Model, the program beside M. Khadem, L. Da Cruz, C. Bergeles, IROS 2018, 4920-4926
(``surgical_tubes.py``). Six drives, three numbers of a position: of the ways to each point the shortest one leads towards a snap,
as the straight parts behind the plate grow and twist. The other one looks, at each point, for the most stability that is left.
"""

import argparse
from collections.abc import Sequence

import numpy as np
from surgical_tubes import DRIVES, ROBOT

import multirod as mr

SOLVER = mr.Shooting(integrator=mr.RK4(50))
FIRST, LAST = (0.027, -0.065, 0.120), (0.025, -0.006, 0.057)  # of the line [m]
AWAY = 0.6  # margin of stability that is kept; 0 is a snap


def followed(path: np.ndarray, prefer: str, margin: float | None) -> list[mr.Reached]:
    """The robot at each point of the path, each from the one before."""
    limits = mr.Limits(translation=(-0.4, 0), gap=1e-3, stability_margin=margin)
    found = mr.solve(ROBOT, ROBOT.inputs(rotation=(0, 0.3, 0.6), translation=DRIVES), solver=SOLVER)
    way = []
    for point in path:
        target = mr.Pose(position=point)
        free = ("rotation", "translation")
        found = mr.reach(ROBOT, target, free=free, limits=limits, prefer=prefer, guess=found, solver=SOLVER).raise_if_failed()
        way.append(found)
    return way


def main(arguments: Sequence[str] | None = None) -> tuple[float, float, float]:
    """Least margin of the shortest way, and of the one that keeps away; how far the tip of this is off the line [mm]."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", default="three_tubes_follow_path.rrd")
    parser.add_argument("--samples", type=int, default=40)
    options = parser.parse_args(arguments)
    path = np.linspace(FIRST, LAST, options.samples)
    shortest = followed(path, "smallest motion", None)
    kept = followed(path, "stability", AWAY)
    with mr.Recorder(options.out, description="reach, prefer='stability'", when_full="wait") as recorder:
        for k, (solution, other) in enumerate(zip(kept, shortest, strict=True)):
            recorder.log(0.1 * k, solution, reference=other)
    # by a solve of its own at the drives that were found
    drives = {name: [getattr(solution.inputs, name) for solution in kept] for name in ("rotation", "translation")}
    again = mr.solve(ROBOT, ROBOT.inputs(**drives), solver=SOLVER).raise_if_failed()
    off = 1e3 * float(np.linalg.norm(again.tip_position - path, axis=1).max())
    least, steady = (min(float(solution.stability_margin) for solution in way) for way in (shortest, kept))
    print(f"tip path of {1e3 * np.linalg.norm(path[-1] - path[0]):.0f} mm, followed within {off:.1e} mm")
    print(f"the shortest way comes to a margin of {least:.2f}, the other keeps {steady:.2f}; 0 is a snap")
    print(f"drives at its end, in mm: {np.round(1e3 * kept[-1].inputs.translation, 1)}, the shortest way's in grey")
    print(f"recorded to {options.out}")
    return least, steady, off


if __name__ == "__main__":
    main()
