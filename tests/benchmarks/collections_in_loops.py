"""What Python's collections of garbage do to the samples of a loop that keeps its commands: as they are, frozen, and off.

OMP_NUM_THREADS=1 python tests/benchmarks/collections_in_loops.py [--samples N]
"""

import argparse
import gc
from collections.abc import Callable
from time import thread_time

import numpy as np
from reach import STEPS, figure_of_eight, six_legs

import multirod as mr

FIRST = 20  # samples of a loop whose memory the system has yet to give


def frozen() -> None:
    """What there is needs no look any more."""
    gc.collect()
    gc.freeze()


WAYS: dict[str, Callable[[], object]] = {"as they are": gc.collect, "gc.freeze()": frozen, "gc.disable()": gc.disable}


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--samples", type=int, default=1500)
    parser.add_argument("--rounds", type=int, default=3)
    options = parser.parse_args()
    robot, at = six_legs()
    path, spent = figure_of_eight(at.tip_position, 1000), {name: np.zeros(0) for name in WAYS}
    for _ in range(options.rounds):
        for name, begin in WAYS.items():
            loop = mr.Controller(robot, dt=1e-3, free="translation", guess=at, integrator=STEPS)
            begin()
            kept, times = [], []
            for k in range(options.samples):
                start = thread_time()
                command = loop.step(position=path[k % 1000], rotation=at.tip_rotation)
                times.append(thread_time() - start)
                kept.append(command)
            gc.unfreeze()
            gc.enable()
            spent[name] = np.append(spent[name], times[FIRST:])
    for name, begin in {"all that was made": gc.unfreeze, "after gc.freeze()": frozen}.items():
        begin()
        start = thread_time()
        gc.collect()
        print(f"A collection that looks at everything, {name}: {1e3 * (thread_time() - start):.1f} ms")
    print("| six legs, Controller.step, collections | median, us | 99.9 %, medians | longest, medians |\n|---|---|---|---|")
    for name, own in spent.items():
        half = np.median(own)
        print(f"| {name} | {1e6 * half:.0f} | {np.quantile(own, 0.999) / half:.1f} | {own.max() / half:.1f} |")


if __name__ == "__main__":
    main()
