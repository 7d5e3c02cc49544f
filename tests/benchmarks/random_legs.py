"""Random parallel robots: how many are solved, what that takes, and whether those that are not have an equilibrium.

python tests/benchmarks/random_legs.py --robots 200 --seed 0

What is solved is judged by equations written in ``tests/``, where all legs are single rods: forces, moments, and joints. All is
put on segments (``tests/legs_on_segments.py``), where it must come to rest within a fiftieth of the length and, but under a
moment, every variation that the joints allow must cost energy. With ``--curved 8`` all robots have legs of tubes, that snap. With
``--search`` an equilibrium of what is not solved is searched for by ``mr.equilibria`` and by the path from legs that nothing
holds, in steps of a hundredth.
"""

import argparse
import sys
from collections import Counter
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parent.parent))

from legs_on_segments import on_segments
from random_legs import Drawn, draw, violation

import multirod as mr
from multirod.capabilities import Loading
from multirod.solvers.continuation.paths import Paths
from multirod.status import Status

RIGHT = 1e-6  # of the length and of the legs' stiffness: what the default integrator promises
FINE = 0.01
SAME = 0.02  # of the length
SEGMENTS = (24, 48, 96)  # more where fewer say no: what is wrong stays wrong


def by_small_steps(drawn: Drawn) -> bool:
    """Whether the path from legs that nothing holds, then loads, reaches a state that is not unstable in small steps."""
    problem = drawn.robot.problem(drawn.inputs, integrator=mr.RK45())
    paths = Paths(problem, mr.Shooting().newton(problem), 10000)
    everyone, step = np.ones(1, dtype=bool), np.full(1, FINE)
    problem.joints.close(Loading.NONE)
    if paths.raise_from(everyone, problem.joints.apart(), step).status[0] != Status.CONVERGED:
        return False
    problem.joints.close(Loading.RISING)
    problem.joints.shut()
    if paths.raise_from(everyone, problem.read("unknowns"), step).status[0] != Status.CONVERGED:
        return False
    return bool(problem.stability.modes().stability[0] != mr.Stability.UNSTABLE)


def by_search(drawn: Drawn) -> bool:
    """Whether many starts find an equilibrium that is not unstable."""
    try:
        return bool((mr.equilibria(drawn.robot, drawn.inputs, starts=256).stability != mr.Stability.UNSTABLE).any())
    except mr.SolveError:
        return False


def judged(drawn: Drawn, solution: mr.Solution) -> str:
    """What is wrong by the energy on segments, nothing if nothing."""
    for count in SEGMENTS:
        energy = on_segments(drawn, solution, count)
        place = energy.position
        left = energy.settle()
        moved, lowest = float(np.abs(energy.position - place).max()), energy.lowest()
        if left < 1e-5 and moved < SAME and (lowest > 0 or energy.moment.any()):
            return ""
    return f"on segments: left {left:.0e}, moved {moved:.1e}, lowest {lowest:.1e}"


def main() -> None:
    """Solve, judge, and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--robots", type=int, default=200)
    parser.add_argument("--first", type=int, default=0, help="number of the first")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--legs", type=int, default=12, help="most legs")
    parser.add_argument("--load", type=float, default=5.0, help="largest load, of EI/L^2 of all legs")
    parser.add_argument("--curved", type=float, default=0.0, help="legs of tubes in all, bent by so many radians at most")
    parser.add_argument("--search", action="store_true", help="search for equilibria of robots that are not solved")
    options = parser.parse_args()
    ends: dict[str, list[int]] = {}
    wrong, unstable, not_there, found, moments = [], [], [], [], Counter()
    for number in range(options.first, options.first + options.robots):
        drawn = draw(number, options.seed, options.legs, options.load, options.curved)
        solution = mr.solve(drawn.robot, drawn.inputs)
        name = Status(int(solution.status)).name
        ends.setdefault(name, []).append(int(solution.integrations))
        note = ""
        if not Status(int(solution.status)).failed:
            lacks = violation(drawn, solution)
            if lacks is not None and not lacks <= RIGHT:
                wrong.append(number)
                note = f"violates the equations by {lacks:.1e}"
            if said := judged(drawn, solution):
                not_there.append(number)
                note += said
            if solution.stability == mr.Stability.UNSTABLE:
                unstable.append(number)
        else:
            moments["moment" if "tip_moment" in drawn.loads else "none"] += 1
            if options.search:
                ways = [way.__name__ for way in (by_small_steps, by_search) if way(drawn)]
                if ways:
                    found.append(number)
                note = "found " + ", ".join(ways) if ways else "not found either"
        print(number, f"{len(drawn.joints)} legs", f"load {drawn.load:.2g}", name, int(solution.integrations), note, flush=True)
    print("\n| end | robots | integrations: median, 95 %, most |\n|---|---|---|")
    for name, counts in sorted(ends.items()):
        print(f"| `{name}` | {len(counts)} | {np.median(counts):.0f}, {np.percentile(counts, 95):.0f}, {max(counts)} |")
    print(f"violate the equations: {wrong}; unstable: {unstable}; no minimum on segments: {not_there}; "
          f"not solved, with a moment: {moments['moment']}, without: {moments['none']}"
          + (f"; not solved though there is an equilibrium: {found}" if options.search else ""))  # fmt: skip


if __name__ == "__main__":
    main()
