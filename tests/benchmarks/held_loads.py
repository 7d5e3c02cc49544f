"""Cables and rods between two holders, under loads along them, drawn by lot: how does each solve end?

    python tests/benchmarks/held_loads.py --scenes 80 --seed 0

takes so many scenes for each way of holding the ends (two balls; a ball and a clamp, and the other way round): rods that are
round or not, bent at rest or not, alike along themselves or not, from slack to taut or with an end that slides, under their
weight, a force per length, or both, across or along. With ``--judge 10``, ten of those between two balls are held against the
energy of segments as well (``tests/held_energy.py``): how far nodes are apart, and its lowest eigenvalues.
"""

import argparse
import sys
from collections import Counter
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from held_energy import HeldEnergy
from random_held import HELD, Drawn, draw

import multirod as mr


def judged(drawn: Drawn, found: mr.Solution) -> str:
    """How it differs from the nearest stationary point of the energy on segments, and the eigenvalues there."""
    energy = HeldEnergy.of(drawn, 24)
    nodes, places = energy.at_nodes(found)
    q, values = energy.stationary(nodes)
    apart = np.linalg.norm(energy.shape(q[None])[0] - places, axis=1).max() / energy.h.sum()
    return f"nodes apart {apart:.1e} of the length, eigenvalues {values[:3].round(4)}"


def main() -> None:
    """Solve and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--scenes", type=int, default=80)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--held", choices=list(HELD), nargs="*", default=list(HELD))
    parser.add_argument("--judge", type=int, default=0)
    parser.add_argument("--max-integrations", type=int, default=50_000)
    options = parser.parse_args()
    solver = mr.Shooting(max_integrations=options.max_integrations)
    for held in options.held:
        total: Counter[str] = Counter()
        counts = []
        for number in range(options.scenes):
            drawn = draw(number, options.seed, held)
            found = mr.solve(drawn.robot, drawn.inputs, solver=solver)
            total[f"{found.status.name} {found.stability.name}"] += 1
            counts.append(int(found.integrations))
            said = f"{held} {number}: {drawn.rod}, {drawn.ends}, {drawn.acts} {drawn.load:.2f} EI/L^3"
            if found.failed or found.status.event or found.stability is not mr.Stability.STABLE:
                print(f"{said}: {found.status.name} {found.stability.name}, {found.integrations} integrations", flush=True)
            if held == "two balls" and number < options.judge and not found.failed:
                print(f"{said}: {judged(drawn, found)}", flush=True)
        print(f"{held}: {dict(total)}, integrations {np.median(counts):.0f} in the median, {np.mean(counts):.0f} in the mean")


if __name__ == "__main__":
    main()
