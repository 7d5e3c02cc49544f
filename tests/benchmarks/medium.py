"""Random strips in elastic media, pressed: unstable modes of all equilibria found, against an independent energy on segments.

    OMP_NUM_THREADS=1 python tests/benchmarks/medium.py [--seed 0] [--seconds 170]

Strips are bent at rest or straight, media 0.5 to 12 decay lengths long, unlike along three axes, loads up to three times what
bends a straight one. Each equilibrium is put on segments (``tests/medium_energy.py``), which may come to rest elsewhere.
"""

import argparse
import sys
import warnings
from collections import Counter
from pathlib import Path
from time import perf_counter

import numpy as np

sys.path.insert(0, str(Path(__file__).parent.parent))

from medium_energy import MediumEnergy

import multirod as mr

EI, LENGTH, SEGMENTS = 0.01, 0.2, 20
ELSEWHERE = 0.3  # of the largest curvature


def main() -> None:
    parser = argparse.ArgumentParser(description="Unstable modes in elastic media against an independent energy.")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--seconds", type=float, default=170)
    options = parser.parse_args()
    warnings.simplefilter("ignore")
    rng, start, counts, modes = np.random.default_rng(options.seed), perf_counter(), Counter(), Counter()
    while perf_counter() - start < options.seconds:
        k = 10 ** rng.uniform(1, 4.5) * np.array([1, rng.uniform(0.2, 2), rng.uniform(0, 1.5)])
        stiffness = np.array([EI, EI * rng.uniform(1.1, 2), EI * rng.uniform(0.4, 1.0)])
        u_star = rng.normal(size=3) * rng.choice([0, 3, 10])
        way = rng.normal(size=3)
        way[2] = -3 * abs(way[2])
        size = (2.47 * EI / LENGTH**2 + 1.5 * np.sqrt(k[0] * EI)) * rng.uniform(0.5, 3)
        force = size * way / np.linalg.norm(way)
        rod = mr.Rod(
            length=LENGTH,
            bending_stiffness=stiffness[:2],
            torsional_stiffness=stiffness[2],
            precurvature=u_star,
            foundation=k,
        )
        robot = mr.SingleRod(rod)
        counts["strips"] += 1
        try:
            found = mr.equilibria(robot, robot.inputs(tip_force=force), solver=mr.Shooting(max_integrations=3000))
        except mr.SolveError:
            counts["of which nothing was found"] += 1
            continue
        energy = MediumEnergy(LENGTH, stiffness, u_star, k, force, SEGMENTS)
        for index, own in zip(found.index, found.rod(0, nodes=2 * SEGMENTS + 1).curvature[:, 1::2], strict=True):
            there, values = energy.stationary(own)
            elsewhere = np.abs(there.reshape(SEGMENTS, 3) - own).max() > ELSEWHERE * np.abs(own).max()
            modes[int(index)] += 1
            verdict = "untold" if index < 0 else "alike" if index == (values < 0).sum() else "elsewhere" if elsewhere else "WRONG"
            counts[verdict] += 1
    print(f"seed {options.seed}: {dict(counts)}; by unstable modes {dict(sorted(modes.items()))}")


if __name__ == "__main__":
    main()
