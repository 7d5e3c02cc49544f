"""What rods do where their branch of equilibria ends, against rods that creep through a viscous medium.

    OMP_NUM_THREADS=1 python tests/benchmarks/branches.py [--rods 1500] [--seed 0] [--segments 24] [--levels 30]

Random wires of random length, precurvature and torsional stiffness are pulled by forces of up to 40 EI/L^2 in random directions.
Those that snap are loaded again, slowly, as rods without mass on segments whose places are held back in proportion to their
velocity (``tests/relaxation.py``), which nothing of the package is used for. Printed is how many ended how, and how many of those
that snapped are where the creeping rod is, within a fiftieth of the length.
"""

import argparse
import sys
import warnings
from pathlib import Path
from time import perf_counter

import numpy as np

import multirod as mr

sys.path.insert(0, str(Path(__file__).parent.parent))
from relaxation import CreepingRods

EI, GJ = 0.2233, 0.0638
SAME = 0.02  # of the length


def scene(seed, count):
    """Random wires and forces: length (count,), torsional stiffness, precurvature (count, 3), force (count, 3)."""
    random = np.random.default_rng(seed)
    length = random.uniform(0.3, 0.9, count)
    precurvature = np.stack([random.uniform(5, 18, count), random.uniform(-8, 8, count), random.uniform(-6, 6, count)], -1)
    torsion = GJ * 10 ** random.uniform(-0.5, 0.6, count)
    way = random.normal(size=(count, 3))
    force = way / np.linalg.norm(way, axis=1)[:, None] * (random.uniform(1, 40, count) * EI / length**2)[:, None]
    return length, torsion, precurvature, force


def creep(length, torsion, precurvature, force, segments, levels):
    """Tips (k, 3) of creeping rods, their loads raised in steps; and which of them came to rest at every step."""
    stiffness = np.stack([np.full(len(length), EI), np.full(len(length), EI), torsion], -1)
    rods = CreepingRods(length, stiffness, precurvature, segments)
    sure = np.ones(len(length), dtype=bool)
    for level in np.linspace(0, 1, levels + 1)[1:]:
        sure &= rods.settle(level * force)
    return rods.tip, sure


def main():
    """Print one line for each outcome."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    for name, default in (("rods", 1500), ("seed", 0), ("segments", 24), ("levels", 30)):
        parser.add_argument(f"--{name}", type=int, default=default)
    options = parser.parse_args()
    warnings.simplefilter("ignore")
    length, torsion, precurvature, force = scene(options.seed, options.rods)
    robot = mr.SingleRod(mr.Rod(length=length, bending_stiffness=EI, torsional_stiffness=torsion, precurvature=precurvature))
    begin = perf_counter()
    found = mr.solve(robot, robot.inputs(tip_force=force), progress=False)
    took = perf_counter() - begin
    kinds, counts = np.unique(found.status, return_counts=True)
    said = ", ".join(f"{count} {mr.Status(kind)}" for kind, count in zip(kinds, counts, strict=True))
    print(f"{options.rods} rods in {took:.1f} s: {said}")
    events = np.flatnonzero([bool(own) for own in found.events])
    print(f"stable: {(found.stability[events] == mr.Stability.STABLE).sum()} of {len(events)} with events")
    chosen = np.flatnonzero(found.status == mr.Status.SNAPPED)
    if not len(chosen):
        return
    tip, sure = creep(length[chosen], torsion[chosen], precurvature[chosen], force[chosen], options.segments, options.levels)
    off = np.linalg.norm(tip - found.tip_position[chosen], axis=1) / length[chosen]
    same = off < SAME
    print(f"as the creeping rod, which came to rest in {sure.sum()} of {len(chosen)}: {same[sure].sum()} of {sure.sum()}")
    for k in np.flatnonzero(~same):
        print(f"  {chosen[k]}: {off[k]:.3f} of the length off{'' if sure[k] else ', not at rest'}; {found.events[chosen[k]]}")


if __name__ == "__main__":
    main()
