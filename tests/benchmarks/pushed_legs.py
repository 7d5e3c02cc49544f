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

sys.path.insert(0, str(Path(__file__).parent.parent))

from legs_on_segments import on_segments
from random_legs import draw

import multirod as mr

SAME = 0.02  # of the length


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
            witness = on_segments(drawn, solution, options.segments)
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
