"""Speed against accuracy on the built-in scenes: tables, plots, and promises measured again in fresh processes.

python tests/benchmarks/tradeoff.py [SCENE ...] [--budget S] [--images FOLDER] [--tables FOLDER] [--fresh N] [--rate HZ]

Each scene is measured once; what ``mr.tune(rate=1000)`` and ``mr.tune(error=1e-5)`` choose from that is written as Python, and
run by a fresh interpreter, which computes its own reference.
"""

import argparse
import json
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

import multirod as mr
from multirod.studies.scenes import SCENES
from multirod.studies.tradeoffs import Measurement
from multirod.studies.tradeoffs.promise import MARGIN, kept
from multirod.studies.tradeoffs.settings import code

IMAGES = Path(__file__).parents[2] / "docs" / "images"
BUDGETS = {"paper": 60.0, "three-tubes": 90.0, "six-legs": 200.0}
ERROR = 1e-5
LIMITS = (1e-3, 1e-4, 1e-5, 1e-6, 1e-7, 1e-8, 1e-9)


def table(name: str, budget: float, images: Path, tables: Path | None) -> Measurement:
    """Measure a scene, print what no other setting beats, and the best of each family; write plot and rows."""
    motion = SCENES[name]()
    models = mr.explain(motion.robot, motion.inputs).models()
    measurement = Measurement(motion.robot, motion.inputs, time=motion.time, budget=budget, models=models)
    for _ in measurement.run():
        pass
    found = measurement.table
    found.plot(images / f"tradeoff_{name}.svg", title=name)
    if tables is not None:
        found.to_csv(tables / f"tradeoff_{name}.csv")
    print(f"\n## {name}: {len(found.rows)} of {len(measurement.settings)} settings, {len(motion.time)} samples\n")
    for title, rows in (("not beaten", found.pareto()), ("most accurate of each family", most_accurate(found))):
        print(f"| {title} | tip [m] | frame [rad] | shape [m] | median [µs] | 95 % [µs] | integrations | samples |")
        print("|---|---|---|---|---|---|---|---|")
        for row in rows:
            print(
                f"| {row.name} | {row.position:.1e} | {row.rotation:.1e} | {row.shape:.1e} | {1e6 * row.median:.0f} "
                f"| {1e6 * row.slow:.0f} | {row.integrations:.2f} | {row.samples} |"
            )
        print()
    print_within(found.rows)
    print(*found.notes(), sep="\n", flush=True)
    return measurement


def print_within(rows: Sequence[mr.Measured]) -> None:
    """For each error, the fastest of each kind of solver, at the tip and along the rods."""
    longest = max(row.samples for row in rows)
    kinds = {"observer": mr.Observer, "energy descent": mr.EnergyDescent, "Newton": mr.Shooting}
    kinds = {name: kind for name, kind in kinds.items() if any(isinstance(row.solver, kind) for row in rows)}
    print("| within [m] | " + " | ".join(f"{kind}, {error} | µs" for error in ("tip", "shape") for kind in kinds) + " |")
    print("|---|" + 2 * len(kinds) * "---|---|")
    for limit in LIMITS:
        cells = []
        for error in ("position", "shape"):
            for name, kind in kinds.items():
                fit = [r for r in rows if isinstance(r.solver, kind) and r.samples == longest and getattr(r, error) <= limit]
                best = min(fit, key=lambda row: row.median, default=None)
                cells += ["none", ""] if best is None else [best.name.removeprefix(name).lstrip(", "), f"{1e6 * best.median:.0f}"]
        print(f"| {limit:.0e} | " + " | ".join(cells) + " |")
    print()


def most_accurate(found: mr.Tradeoff) -> list[mr.Measured]:
    """One row a family, where one has a result."""
    families: dict[str, mr.Measured] = {}
    for row in found.rows:
        if row.family not in families or row.position < families[row.family].position:
            families[row.family] = row
    return list(families.values())


def promise(name: str, measurement: Measurement, fresh: int, rates: list[float]) -> None:
    """Print what is promised of a scene, and what fresh processes measure."""
    for goal in [*({"rate": rate} for rate in rates), {"error": ERROR}]:
        ((what, value),) = goal.items()
        try:
            row = kept(measurement, **goal)
        except ValueError as error:
            print(f"| {name} | {what} {value:g} | {error} | | | |", flush=True)
            continue
        solver = code(row.solver)
        runs = []
        for _ in range(fresh):
            command = [sys.executable, __file__, "--measure", name, solver]
            done = subprocess.run(command, capture_output=True, text=True, check=True)
            runs.append(json.loads(done.stdout.splitlines()[-1]))
        promised = f"{value:g} m" if what == "error" else f"{1e6 / value:.0f} µs"
        limit = value if what == "error" else 1 / value
        measured = [run["position"] if what == "error" else run["slow"] for run in runs]
        shown = ", ".join(f"{m:.1e} m" if what == "error" else f"{1e6 * m:.0f}" for m in measured)
        told = f"{row.position:.1e} m" if what == "error" else f"{1e6 * row.slow:.0f} µs"
        kept_count = sum(m <= limit for m in measured)
        print(f"| {name} | {promised} | `{solver}` | {told} | {shown} | {kept_count} of {len(runs)} |", flush=True)


def measure(name: str, solver: str) -> None:
    """Run a scene with a solver, given as Python, and print what it came to as JSON."""
    motion = SCENES[name]()
    only = {"only": eval(solver, {name: getattr(mr, name) for name in mr.__all__})}
    measurement = Measurement(motion.robot, motion.inputs, time=motion.time, solvers=only)
    measurement.repeat("only")  # compiles
    row = measurement.repeat("only")
    assert measurement.reference.checked
    print(json.dumps({"position": row.position, "slow": row.slow, "median": row.median, "failed": row.failed}))


def main() -> None:
    """Print the tables and write the plots."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scenes", nargs="*", choices=[[], *SCENES], metavar="SCENE", help=f"all by default: {', '.join(SCENES)}")
    parser.add_argument("--budget", type=float, metavar="S", help=f"of each scene; by default {BUDGETS}")
    parser.add_argument("--images", type=Path, default=IMAGES, metavar="FOLDER", help="where the plots go")
    parser.add_argument("--tables", type=Path, metavar="FOLDER", help="where all rows go, as comma-separated values")
    parser.add_argument("--fresh", type=int, default=3, metavar="N", help="fresh processes for each promise")
    parser.add_argument("--rate", type=float, action="append", metavar="HZ", help="to promise; repeatable, 1000 by default")
    parser.add_argument("--measure", nargs=2, metavar=("SCENE", "SOLVER"), help="only run this solver, and print JSON")
    options = parser.parse_args()
    if options.measure:
        measure(*options.measure)
        return
    names = options.scenes or list(SCENES)
    measured = {name: table(name, options.budget or BUDGETS[name], options.images, options.tables) for name in names}
    print(f"\n## Promises: tuned with {1 - MARGIN:.0%} of the time to spare, measured again in {options.fresh} fresh processes\n")
    print("| scene | promised | setting | when tuned | in fresh processes | kept |\n|---|---|---|---|---|---|")
    for name, measurement in measured.items():
        promise(name, measurement, options.fresh, options.rate or [1000.0])


if __name__ == "__main__":
    main()
