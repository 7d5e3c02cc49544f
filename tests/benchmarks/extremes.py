"""The package at the extremes: random scenes judged by equations of their own, and a table of extremes against solvers.

python tests/benchmarks/extremes.py                        the table of docs/extremes.md
python tests/benchmarks/extremes.py --scenes 2000 --seed 0 random scenes; --kinds, --references N for a part of them
"""

import argparse
import sys
from collections import Counter
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parent.parent))

from extreme_cases import CASES, Case, solvers
from observer_scenes import GAINS, MOTIONS, MOVING, TIMES, follow, measure
from random_scenes import KINDS, draw
from scene_check import SAME, Verdict, check

import multirod as mr

MOST_FOR_SCIPY = 500.0  # load in K/L^2, K the least stiffness: its load steps are no smaller beyond 100


def faults(verdict: Verdict) -> list[str]:
    """What is wrong with a verdict, in words."""
    found = {
        "wrong": verdict.wrong,
        "unstable, not flagged": verdict.unstable and not verdict.flagged,
        "another number of unstable modes": bool(verdict.missed),
        "another branch": verdict.reference is not None and verdict.reference > SAME,
        "not solved though the branch goes on": verdict.status.failed and verdict.ends == 1,
    }
    return [name for name, true in found.items() if true]


def random_scenes(options: argparse.Namespace) -> None:
    """Judge scenes, print what is wrong with any at once, and the table at the end, or where it is interrupted."""
    rows: dict[str, list[Verdict]] = {kind: [] for kind in options.kinds}
    try:
        for k in range(options.scenes // len(options.kinds)):
            for kind, verdicts in rows.items():
                seed = options.seed + k
                verdict = check(draw(kind, seed), reference=options.references > 0 and k % options.references == 0)
                if k:  # the first compiles
                    verdicts.append(verdict)
                if faults(verdict) or verdict.seconds > options.slow:
                    print(f"{kind}, seed {seed}: {', '.join(faults(verdict)) or 'slow'}: {verdict}", file=sys.stderr, flush=True)
    except KeyboardInterrupt:
        pass
    print_table(rows)


def print_table(rows: dict[str, list[Verdict]]) -> None:
    """Markdown, one row a kind."""
    print("\n| scenes | number | solved | failed | wrong | worst tip / L | worst gap | worst shape | unstable: flagged, not | "
          "compared: same branch, another, not solved | CPU s: median, 95 %, most |")  # fmt: skip
    print("|---|---|---|---|---|---|---|---|---|---|---|")
    for kind, verdicts in rows.items():
        if not verdicts:
            continue
        solved = [v for v in verdicts if not v.status.failed]
        failed = Counter(v.status.name for v in verdicts if v.status.failed)
        worst = [max((getattr(v, name) for v in solved), default=np.nan) for name in ("error", "gap", "shape")]
        unstable = [v.flagged for v in solved if v.unstable]
        followed = [v for v in verdicts if v.ends == 1]
        same = sum(v.reference is not None and v.reference <= SAME for v in followed)
        other = sum(v.reference is not None and v.reference > SAME for v in followed)
        seconds = np.percentile([v.seconds for v in verdicts], (50, 95, 100))
        print(
            f"| {kind} | {len(verdicts)} | {len(solved)} | {', '.join(f'{n} {name}' for name, n in failed.items())} "
            f"| {sum(v.wrong for v in solved)} | {worst[0]:.0e} | {worst[1]:.0e} | {worst[2]:.0e} "
            f"| {sum(unstable)}, {len(unstable) - sum(unstable)} | {same}, {other}, {len(followed) - same - other} "
            f"| {', '.join(f'{s:.2g}' for s in seconds)} |",
            flush=True,
        )


def cell(case: Case, solver: mr.Solver) -> str:
    """Distance of the tip over the length, or the status that says why there is none, or a dash where a solver refuses."""
    if isinstance(solver, mr.ScipyShooting):
        problem = case.robot.problem(case.inputs, integrator=solver.integrator)
        if problem.load_scale()[0] > MOST_FOR_SCIPY:
            return "not run"
    try:
        solution = mr.solve(case.robot, case.inputs, solver=solver, progress=False)
    except (TypeError, ValueError):
        return "-"
    if solution.status.failed:
        return f"`{solution.status}`"
    error = float(np.linalg.norm(solution.tip_position - case.tip) / case.length)
    return f"**{error:.0e}**" if error > SAME else f"{error:.0e}"


def extremes_against_solvers() -> None:
    """One row an extreme, one column a solver."""
    columns = solvers()
    print("| extreme | reference | " + " | ".join(columns) + " |")
    print("|---" * (len(columns) + 2) + "|")
    for make in CASES:
        case = make()
        cells = [cell(case, solver) for solver in columns.values()]
        print(f"| {case.name} | {case.source} | " + " | ".join(cells) + " |", flush=True)


def observers() -> None:
    """How far the observer is off when the motion stops, and how far 30 samples later."""
    print("\n| motion | `R` = `Q` | " + " | ".join(f"{dt:g} s" for dt in TIMES) + " |")
    print("|---" * (len(TIMES) + 2) + "|")
    for name in MOTIONS:
        for gain in (gain for gain in GAINS if gain[0] == gain[1]):
            cells = []
            for dt in TIMES:
                history = follow(name, gain, dt)
                error = np.linalg.norm(history.boundary_residual, axis=1)
                warned = "" if (history.status == mr.Status.TRACKING).all() else " (`NEAR_FOLD`)"
                cells.append(f"{error[MOVING]:.1g}, {error[-1]:.1g}{warned}")
            print(f"| {name} | {gain[0]:g} | " + " | ".join(cells) + " |", flush=True)


def noise() -> None:
    """How far noise on a measured tip curvature moves the tip."""
    amplitudes = (1e-6, 1e-4, 1e-2, 1.0)
    print("\n| `R` = `Q` | " + " | ".join(f"{amplitude:g} 1/m" for amplitude in amplitudes) + " |")
    print("|---" * (len(amplitudes) + 1) + "|")
    for gain in (1e-2, 1.0, 1e2):
        clean = measure(0.0, gain).tip_position
        moved = [np.linalg.norm(measure(amplitude, gain).tip_position - clean, axis=1).max() for amplitude in amplitudes]
        print(f"| {gain:g} | " + " | ".join(f"{value:.1e}" for value in moved) + " |", flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scenes", type=int, default=0, help="random scenes to judge, of all kinds together")
    parser.add_argument("--seed", type=int, default=0, help="the first of each kind")
    parser.add_argument("--kinds", nargs="+", choices=list(KINDS), default=list(KINDS), metavar="KIND", help=", ".join(KINDS))
    parser.add_argument("--references", type=int, default=4, help="follow the branch of every N-th anew; 0 for none")
    parser.add_argument("--slow", type=float, default=10.0, help="seconds from which a scene is named")
    options = parser.parse_args()
    if options.scenes:
        random_scenes(options)
        return
    extremes_against_solvers()
    observers()
    noise()


if __name__ == "__main__":
    main()
