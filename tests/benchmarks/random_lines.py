"""Random robots with lines at default settings, each solution against equations written anew and its stability against an energy.

python tests/benchmarks/random_lines.py [--scenes N] [--judge N] [--seed N]
"""

import argparse
import sys
from collections import Counter
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))

import random_lines

import multirod as mr


def main() -> None:
    """Print a row for each build, and what came of those that were not solved."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--scenes", type=int, default=1000, help="of each build")
    parser.add_argument("--judge", type=int, default=40, help="of which stability is looked at too")
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args()
    print("| build | solved | wrong | largest gap | slack lines | judged | unstable called stable | stable called unstable |")
    print("|---|---|---|---|---|---|---|---|", flush=True)
    failed: Counter[str] = Counter()
    solved = wrong = count = 0
    for name, make in random_lines.kinds(options.scenes, options.seed).items():
        v = random_lines.check(make(), judge=options.judge)
        gap = max(v.gap[v.solved], default=0.0)
        print(
            f"| {name} | {v.solved.sum()} | {v.wrong} | {gap:.0e} | {v.slack.mean():.0%} | {v.judged} | {v.unflagged} "
            f"| {v.overcautious} |",
            flush=True,
        )
        failed.update(mr.Status(int(status)).name for status in v.status[~v.solved])
        solved, wrong, count = solved + v.solved.sum(), wrong + v.wrong, count + len(v.solved)
    print(f"\n{solved} of {count} solved, {wrong} wrong; not solved: {dict(failed) or 'none'}")


if __name__ == "__main__":
    main()
