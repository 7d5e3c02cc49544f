"""Held rods whose ends are drawn by lot: how many does the natural path reach, how many the search for other equilibria?

    python tests/benchmarks/held_ends.py --ends 12 --seed 1

takes so many ends for each of straight rods of equal and of unequal stiffness and bent ones, with ends that are clamped, turn
about an axis, and turn freely, moved by up to 0.3 of the length and turned by up to 1 rad, and tells by what status each was
solved, with how many integrations.
"""

import argparse
from collections import Counter

import numpy as np

import multirod as mr

LENGTH, EI = 0.5, 0.02
RODS = {
    "round": {"bending_stiffness": EI},
    "strip 1.5": {"bending_stiffness": (1.5 * EI, EI)},
    "strip 25": {"bending_stiffness": (25 * EI, EI)},
    "bent": {"bending_stiffness": EI, "precurvature": (2.0, 1.0, 0.5)},
}
JOINTS = {"clamped": {}, "revolute": {"joint": "revolute", "joint_axis": (0, 1, 0)}, "spherical": {"joint": "spherical"}}
REACH = 0.97  # of the length: how far from the base an end may be


def ends(count: int, seed: int) -> np.ndarray:
    """Poses (count, 4, 4): off the end of the straight rod by up to 0.3 of its length, and turned by up to 1 rad."""
    from scipy.spatial.transform import Rotation

    random = np.random.default_rng(seed)
    poses = np.tile(np.eye(4), (count, 1, 1))
    for pose in poses:
        while True:
            place = np.array([0, 0, LENGTH]) + 0.3 * LENGTH * random.uniform(-1, 1, 3)
            if np.linalg.norm(place) < REACH * LENGTH:
                break
        pose[:3, 3] = place
        axis = random.normal(size=3)
        pose[:3, :3] = Rotation.from_rotvec(random.uniform(0, 1) * axis / np.linalg.norm(axis)).as_matrix()
    return poses


def main() -> None:
    """Solve and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--ends", type=int, default=12)
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args()
    total: Counter[str] = Counter()
    unstable, on_path = 0, []
    for name, rod in RODS.items():
        for joint, held in JOINTS.items():
            own = mr.Rod(length=LENGTH, torsional_stiffness=0.75 * EI, **rod)
            found = mr.solve(mr.HeldRod(own, end=ends(options.ends, options.seed), **held))
            names = [mr.Status(k).name for k in found.status]
            solved = ~np.isnan(found.tip_position).any(axis=1)
            unstable += int((solved & (found.stability != mr.Stability.STABLE)).sum())
            reached = np.isin(found.status, [mr.Status.CONVERGED, mr.Status.BIFURCATED, mr.Status.SNAPPED])
            on_path += found.integrations[reached].tolist()
            total.update(names)
            print(f"{name:10} {joint:10} {dict(Counter(names))}, integrations {found.integrations.mean():.0f}", flush=True)
    print(f"of {sum(total.values())}: {dict(total)}; not stable {unstable}; integrations along the path {np.mean(on_path):.0f}")


if __name__ == "__main__":
    main()
