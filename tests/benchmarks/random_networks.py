"""Random networks: how many are solved, what that takes, and whether what is called solved is an equilibrium, and stable.

python tests/benchmarks/random_networks.py --networks 1000 --energy 30

Gaps, balances and joints are judged from what rods and bodies say of each other; the first ``--energy`` also by chains of rigid
segments that are brought to rest by Newton's method on their energy from beside the solution (``tests/network_energy.py``), in 6
and 12 segments each, extrapolated, or where these disagree in 12 and 24. What is not solved is looked for by descent of that
energy, from straight rods on: a minimum is a reference, and something to mend. ``--minutes`` ends it earlier. With ``--all``
networks are drawn of all that a ``Network`` may say, ``tests/random_graphs.py``, and judged by ``tests/graph_energy.py``.
"""

import argparse
import sys
import time
import warnings
from collections import Counter
from itertools import product
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parent.parent))

import random_graphs
import random_networks
from network_energy import NEUTRAL

import multirod as mr

RIGHT = 1e-5  # of lengths and forces: some ten times what the default integrator promises
SEGMENTS = 6
COARSE = 4  # segments by which what is not solved is looked for
ASIDE = (0.02, 0.005, 0.0)  # rad and lengths by which all is moved first; the later ones where the first leads elsewhere
FAR = 0.02  # of the mean length, which is elsewhere


def by_energy(lot, drawn, solution, seed):
    """Distance of the bodies from where the energy has them over the mean length, before and after extrapolation, and the index
    there; None where Newton's method fails."""
    # few segments may have other equilibria, or none there
    for segments, aside in product((SEGMENTS, 2 * SEGMENTS), ASIDE):
        found = _by_energy(lot, drawn, solution, seed, segments, aside)
        if found is not None and found[1] <= FAR and agrees(solution.stability, *found[2:]):
            break
    return found


def agrees(stability, index, least):
    """Whether it is that of an equilibrium with so many unstable modes, the next mode of which is so far from neutral. Of rods
    that turn about themselves at no cost the energy has a neutral mode and ``STABLE`` leaves it aside; others are a ``FOLD``."""
    if stability == mr.Stability.FOLD:
        return least < NEUTRAL
    return (stability == mr.Stability.STABLE) == (index == 0) or stability == mr.Stability.UNKNOWN


def _by_energy(lot, drawn, solution, seed, segments, aside):
    rods, state = lot.state_of(drawn, solution, segments, aside, seed)
    coarse = rods.settled(state)
    if coarse is None:
        return None
    length = np.mean([rod.length for rod in drawn.robot.rods])
    own = np.array([solution.body_position(name) for name in drawn.bodies])
    one = rods.positions(coarse[0])
    # from where the coarse one is; where that leads nowhere, or elsewhere, as it has kinks, from the solution again
    for begin in (lambda: rods.refined(coarse[0]), lambda: lot.state_of(drawn, solution, 2 * segments, aside, seed)):
        finer, state = begin()
        fine = finer.settled(state)
        if fine is not None and np.abs(finer.positions(fine[0]) - one).max() <= FAR * length:
            break
    if fine is None:
        return None
    two = finer.positions(fine[0])
    return np.abs(two - own).max() / length, np.abs((4 * two - one) / 3 - own).max() / length, fine[1], fine[2]


def reference(drawn):
    """Whether the energy has a minimum that descent finds, and what is known of why not."""
    rods = drawn.rods(COARSE)
    found = rods.descended(rods.straight(drawn.places)) is not None
    astray = "" if found or not hasattr(rods, "astray") else rods.astray()
    return found, f"no minimum is found{': something ' if astray else ''}{astray}"


def main() -> None:
    """Solve, judge, and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--networks", type=int, default=200)
    parser.add_argument("--first", type=int, default=0, help="number of the first")
    parser.add_argument("--energy", type=int, default=20, help="of these, judged by their energy")
    parser.add_argument("--load", type=float, default=1.0, help="loads, of EI/L^2")
    parser.add_argument("--minutes", type=float, default=1e9)
    parser.add_argument("--all", action="store_true", help="of all that a network may say")
    options = parser.parse_args()
    lot = random_graphs if options.all else random_networks
    warnings.simplefilter("ignore", mr.PlausibilityWarning)
    statuses, verdicts, spent, wrong, apart, unstable = Counter(), Counter(), [], [], [], []
    missed = []
    begin = time.monotonic()
    for seed in range(options.first, options.first + options.networks):
        if time.monotonic() - begin > 60 * options.minutes:
            break
        drawn = lot.draw(seed, load=options.load)
        start = time.process_time()
        solution = mr.solve(drawn.robot, drawn.inputs)
        spent.append(time.process_time() - start)
        statuses[solution.status.name] += 1
        if solution.status.failed:
            there, none = reference(drawn) if drawn.potential else (False, "loads without a potential")
            missed += [seed] if there else []
            why = "with a minimum" if there else none
            print(f"{seed}: {solution.status.name}, {len(drawn.names)} rods, {spent[-1]:.1f} s, {why}", flush=True)
            continue
        verdicts[solution.stability.name] += 1
        off = lot.violation(drawn, solution)
        if not off < RIGHT:
            wrong.append(seed)
            print(f"{seed}: {solution.status.name}, off by {off:.1e}", flush=True)
        if solution.stability == mr.Stability.UNSTABLE:
            unstable.append(seed)
        if seed < options.first + options.energy:
            found = by_energy(lot, drawn, solution, seed)
            if found is None:
                print(f"{seed}: its energy has no equilibrium nearby", flush=True)
                continue
            apart.append(found[:2])
            if not agrees(solution.stability, *found[2:]):
                print(f"{seed}: {solution.stability.name}, its energy has {found[2]} unstable modes", flush=True)
            if found[1] > FAR:
                print(f"{seed}: {found[0]:.1e} apart, {found[1]:.1e} extrapolated", flush=True)
    done, solved = sum(statuses.values()), sum(verdicts.values())
    print(f"{done} networks, {solved} solved, {len(wrong)} wrongly: {wrong}; {len(unstable)} given though unstable")
    print(f"not solved, though their energy has a minimum: {len(missed)}: {missed}")
    print("status:   ", ", ".join(f"{name} {count}" for name, count in statuses.most_common()))
    print("stability:", ", ".join(f"{name} {count}" for name, count in verdicts.most_common()))
    print("processor time [ms]: median {:.0f}, 90 % {:.0f}, most {:.0f}".format(*1e3 * np.quantile(spent, [0.5, 0.9, 1.0])))
    if apart:
        before, after = np.array(apart).T
        quantiles = (np.median(before), before.max(), np.median(after), after.max())
        print(
            f"{len(apart)} by energy, over the length: {2 * SEGMENTS} segments {{:.1e}} (most {{:.1e}}), extrapolated {{:.1e}} "
            "(most {:.1e})".format(*quantiles)
        )


if __name__ == "__main__":
    main()
