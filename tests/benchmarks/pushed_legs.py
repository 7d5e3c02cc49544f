"""Random parallel robots, pushed and loaded: how many end in a stable equilibrium, by an energy that is not the package's.

    OMP_NUM_THREADS=1 python tests/benchmarks/pushed_legs.py [--robots 60] [--first 0] [--seed 11] [--legs 12] [--load 5]

Robots are those of ``tests/random_legs.py`` whose legs are single rods and whose loads have a potential: 2 to 12 legs in joints
of all kinds, each pushed by up to a tenth of its length. What is found is put on segments (``tests/leg_energy.py``): it must come
to rest there within a fiftieth of the length, and every variation that the joints allow must cost energy.
"""

import argparse
import sys
from collections import Counter
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

sys.path.insert(0, str(Path(__file__).parent.parent))

from leg_energy import Leg, LegEnergy
from random_legs import draw

import multirod as mr

SAME = 0.02  # of the length


def energy_of(drawn, solution, count):
    """The robot on segments, at what was found."""
    length = np.mean([leg[0][0]["length"] for leg in drawn.sections])
    EI = np.mean([leg[0][0]["bending_stiffness"][0] for leg in drawn.sections])
    legs = []
    for k, (rod,) in enumerate(drawn.sections):
        (section,) = rod
        found, base, end = solution.rod(k, nodes=count + 1), drawn.base[k].copy(), drawn.platform[k].copy()
        base[:3, :3] = base[:3, :3] @ Rotation.from_rotvec([0, 0, drawn.loads["rotation"][k]]).as_matrix()
        base[:3, 3], end[:3, 3] = base[:3, 3] / length, end[:3, 3] / length
        axial = section.get("axial_stiffness")
        frames = np.array(found.rotation)
        stretch = np.zeros(count + 1) if axial is None else found.force[:, 2] / axial
        bend = np.array([*section["bending_stiffness"], section["torsional_stiffness"]]) / EI
        legs.append(
            Leg(
                (section["length"] + drawn.loads["translation"][k]) / length,
                bend,
                None if axial is None else axial * length**2 / EI,
                np.array(section["precurvature"]) * length,
                base,
                end,
                drawn.joints[k],
                drawn.axes[k],
                frames,
                stretch,
            )
        )
    force = np.asarray(drawn.loads.get("tip_force", np.zeros(3))) * length**2 / EI
    return LegEnergy(legs, np.array(solution.tip_position) / length, np.array(solution.tip_rotation), force)


def main() -> None:
    """Solve, judge, and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    for name, default in (("robots", 60), ("first", 0), ("seed", 11), ("legs", 12), ("segments", 24)):
        parser.add_argument(f"--{name}", type=int, default=default)
    parser.add_argument("--load", type=float, default=5.0)
    options = parser.parse_args()
    ends, stable, number, drawn_count = Counter(), 0, options.first, 0
    while drawn_count < options.robots:
        drawn = draw(number, options.seed, options.legs, options.load)
        number += 1
        if "tip_moment" in drawn.loads or any(len(leg) > 1 for leg in drawn.sections):
            continue
        drawn_count += 1
        solution = mr.solve(drawn.robot, drawn.inputs)
        status = mr.Status(int(solution.status))
        ends[status.name] += 1
        note = ""
        if not status.failed:
            witness = energy_of(drawn, solution, options.segments)
            before = witness.position
            left = witness.settle()
            moved, lowest = float(np.abs(witness.position - before).max()), witness.lowest()
            good = left < 1e-5 and moved < SAME and lowest > 0
            stable += good
            note = f"{'stable' if good else 'NOT'}: left {left:.0e}, moved {moved:.1e}, lowest {lowest:.1e}"
        print(
            number - 1,
            f"{len(drawn.joints)} legs, load {drawn.load:.2g}",
            status.name,
            int(solution.integrations),
            note,
            flush=True,
        )
    print(", ".join(f"{count} {name}" for name, count in sorted(ends.items())))
    print(f"stable by their energy: {stable} of {options.robots}")


if __name__ == "__main__":
    main()
