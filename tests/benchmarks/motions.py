"""Random motions through folds: what is said of every sample, against energies on segments and robots that creep.

    OMP_NUM_THREADS=1 python tests/benchmarks/motions.py [--motions 20] [--seed 0] [--kinds rods,held] [--samples 41]

Motions of 10 s are those of ``tests/random_motions.py``, of each kind as many; even seeds are for tuning, odd ones are reported.
Each sample with a result is put on segments (``tests/leg_energy.py``): it must come to rest there, within a fiftieth of the
length, where every variation that is possible costs energy; a single rod or pair that does not, on four times the segments. The
motion is done again with four times the samples: where the two part without an event between, one of them has jumped. From the
sample before each snap a robot on segments creeps on, its inputs changed in steps, to the sample after it; where it has not left
by then, as segments move a fold a little, to the next one. Tubes that nothing loads creep on 640 segments of their own
(``tests/creeping_tubes.py``). A row is the sum so far.
"""

import argparse
import sys
import warnings
from collections import Counter
from itertools import pairwise
from pathlib import Path
from time import perf_counter

import numpy as np

sys.path.insert(0, str(Path(__file__).parent.parent))

from random_motions import DURATION, KINDS, SEGMENTS, draw

import multirod as mr

SAME = 0.02  # of the length
FINER, LEVELS, FINE_TUBES = 4, 8, 640
SOLVER = mr.Shooting(integrator=mr.RK4(50))


def judged(motion, solution, time, times=1):
    """What is wrong with a sample, by the energy on so many times as many segments; empty if nothing."""
    energy = motion.on_segments(solution, time, times)
    before = energy.position
    left = energy.settle()
    moved = float(np.abs(energy.position - before).max())
    if left > 1e-5 or moved > SAME:
        return f"no equilibrium on segments: moved {moved:.1e}, left {left:.0e}"
    lowest = energy.lowest()
    return "" if lowest > 0 else f"unstable on segments: lowest {lowest:.1e}"


def creeps_by(motion, solution, times):
    """Where a robot on segments is at all ``times``, over the length, from where a solution has it at the first of them; until it
    comes to no rest."""
    tubes = motion.unloaded_tubes(FINE_TUBES)
    energy = tubes or motion.on_segments(solution, times[0])
    if tubes:
        tubes.angle[:, 0] = motion.at(times[0])["rotation"]
        tubes.place(solution)
    for begin, end in pairwise(times):
        for now in np.linspace(begin, end, LEVELS + 1):
            if tubes:
                rests = tubes.creep(motion.at(now)["rotation"])
            else:
                motion.place(energy, now)
                rests = energy.creep()
            if not rests:
                return
        yield tubes.tip() / motion.length if tubes else energy.position


def run(motion, samples, seed_name, total):
    """Count what happens in one motion, and print what is wrong."""
    time = np.linspace(0, DURATION, samples)
    fine = np.linspace(0, DURATION, FINER * (samples - 1) + 1)
    history, finer = (
        mr.simulate(motion.robot, motion.robot.inputs(**motion.at(t)), time=t, solver=SOLVER, progress=False)
        for t in (time, fine)
    )
    total["motions"] += 1
    total["integrations"] += int(np.sum(history.integrations))
    agreed = True
    snaps = 0
    for k in range(samples):
        status = mr.Status(int(history.status[k]))
        total[status.name] += 1
        if status.failed:
            agreed = False
            continue
        sample = history[k]
        if not np.isfinite(sample.rod(0, nodes=SEGMENTS + 1).position).all():
            total["shapes lost"] += 1  # at other nodes it is another integration, which may not end near the solve
            continue
        wrong = judged(motion, sample, time[k])
        if wrong and len(motion.lengths) == 1:  # next to a fold, which segments move
            wrong = judged(motion, sample, time[k], FINER)
            total["on finer segments"] += not wrong
        if wrong:
            total["VIOLATIONS"] += 1
            print(f"  {seed_name} sample {k} {status.name}, {sample.stability.name}: {wrong}", flush=True)
        if not mr.Status(int(finer.status[FINER * k])).failed:
            off = float(np.linalg.norm(history.tip_position[k] - finer.tip_position[FINER * k])) / motion.length
            said = status.event or (finer.status[FINER * (k - 1) + 1 : FINER * k + 1] != mr.Status.CONVERGED).any()
            if off > SAME and agreed and not (k and said):
                total["JUMPS"] += 1
                print(f"  {seed_name} sample {k} {status.name}: {off:.2f} from where four times the samples lead", flush=True)
            elif off > SAME and agreed:
                total["parted at an event"] += 1
                print(f"  {seed_name} sample {k} {status.name}: parted by {off:.2f} at an event", flush=True)
            agreed = off <= SAME
        if status is mr.Status.SNAPPED and k and not mr.Status(int(history.status[k - 1])).failed:
            snaps += 1
            later = k + 1 < samples and history.status[k + 1] == mr.Status.CONVERGED
            places = creeps_by(motion, history[k - 1], time[k - 1 : k + 1 + later])
            off = [np.linalg.norm(goal - history.tip_position[k + j] / motion.length) for j, goal in enumerate(places)]
            total["snaps judged"] += len(off) > 0
            total["snaps as what creeps"] += len(off) > 0 and off[0] <= SAME
            total["a sample later"] += len(off) > 1 and off[0] > SAME and off[1] <= SAME
            if off and min(off) > SAME:
                print(f"  {seed_name} sample {k}: {min(off):.3f} from what creeps; {sample.events}", flush=True)
    total["with snaps"] += snaps > 0


def main():
    """Print a row for each kind after each of its motions."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    for name, default in (("motions", 20), ("first", 0), ("seed", 0), ("samples", 41)):
        parser.add_argument(f"--{name}", type=int, default=default)
    parser.add_argument("--kinds", default=",".join(KINDS))
    options = parser.parse_args()
    warnings.simplefilter("ignore")
    totals = {kind: Counter() for kind in options.kinds.split(",")}
    for number in range(options.first, options.first + options.motions):
        for kind, total in totals.items():
            begin = perf_counter()
            run(draw(kind, number, options.seed), options.samples, f"{kind} {number}", total)
            total["s"] += round(perf_counter() - begin)
            print(f"{kind}: {', '.join(f'{count} {name}' for name, count in total.items())}", flush=True)


if __name__ == "__main__":
    main()
