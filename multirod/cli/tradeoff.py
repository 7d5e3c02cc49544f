"""``multirod tradeoff``: speed against accuracy on a scene, and the setting that keeps a promise."""

import argparse
from collections.abc import Sequence
from contextlib import ExitStack
from importlib.util import find_spec

from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from multirod.cli.terminal import duration, file_of, nonnegative, positive, progress_bar
from multirod.studies.scenes import SCENES, Motion, load
from multirod.studies.terms import explain
from multirod.studies.tradeoffs import Measured, Measurement, Rows, Tradeoff
from multirod.studies.tradeoffs.promise import kept
from multirod.studies.tradeoffs.settings import code

STOPPED = 130  # as a shell has it, by Ctrl-C
ENOUGH = 1e-3  # of the longest rod's length: an error of the tip that models and their parameters seldom are better than
_DESCRIPTION = f"""\
Run solvers, integrators and their options on a scene, measure each against a reference that is checked, and show those that no
other beats in both speed and accuracy.

SCENE is {", ".join(SCENES)}, or module:function of your own: a function without arguments that returns a robot, its inputs and
times. Modules are looked for in the working directory too.

Ctrl-C ends the measurement early: what there is is shown and written.
Exit status: 0; 1 if a promise cannot be kept or nothing was measured; 2 for a wrong argument; 130 after Ctrl-C."""


def add_parser(commands: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    """Add the command to the parser."""
    parser = commands.add_parser(
        "tradeoff",
        help="speed against accuracy on a robot and motion of your own",
        description=_DESCRIPTION,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("scene", metavar="SCENE", help=f"{', '.join(SCENES)}, or module:function")
    parser.add_argument(
        "--budget",
        type=duration,
        default=60.0,
        metavar="TIME",
        help="90, 60s, 2min; over after twice as long at most, kernels that are being compiled aside (default: 60s)",
    )
    parser.add_argument(
        "--settle", type=nonnegative, default=0.3, metavar="S", help="errors count from here on [s] (default: 0.3)"
    )
    goal = parser.add_mutually_exclusive_group()
    goal.add_argument(
        "--error",
        type=positive,
        metavar="M",
        help="also find the fastest setting within this error of the tip [m], and run it again; without this and --rate, the "
        f"fastest within {100 * ENOUGH:g} %% of the length is named",
    )
    goal.add_argument("--rate", type=positive, metavar="HZ", help="also find the most accurate at so many samples a second")
    parser.add_argument("--models", action="store_true", help="also try the robot without each term that can be left out")
    parser.add_argument("--all", action="store_true", help="show every setting, not only those that no other beats")
    parser.add_argument("--csv", type=file_of(".csv"), metavar="FILE.csv", help="write every setting, as it is measured")
    parser.add_argument(
        "--plot", type=file_of(".png", ".svg"), action="append", default=[], metavar="FILE", help="write a plot; repeatable"
    )
    parser.add_argument("--out", type=file_of(".rrd"), metavar="FILE.rrd", help="write a recording for the Rerun viewer")
    parser.set_defaults(run=run)


def run(options: argparse.Namespace, console: Console) -> int:
    """Measure a scene; returns the exit status."""
    if options.plot and find_spec("matplotlib") is None:
        console.print('[red]--plot needs matplotlib: pip install "multirod\\[plot]"[/red]')
        return 2
    with ExitStack() as stack:
        try:
            motion = load(options.scene)
            # its first line is there before anything is measured
            rows = stack.enter_context(Rows(options.csv)) if options.csv else None
            with console.status("reference"):
                models = explain(motion.robot, motion.inputs).models() if options.models else {}
                measurement = Measurement(
                    motion.robot, motion.inputs, time=motion.time, settle=options.settle, budget=options.budget, models=models
                )
        except (TypeError, ValueError) as error:
            console.print(f"[red]{escape(str(error))}[/red]")
            return 2
        if options.models and not models:
            console.print("No term of this scene can be left out.", style="dim")
        stopped = _measure(measurement, rows, console)
    table = measurement.table
    if not table.rows:
        why = "" if stopped else ": a first run may spend it all on compiling, which is kept: run it again, or raise --budget"
        console.print(f"[yellow]nothing was measured{why}[/yellow]")
        _print_notes(table, console)
        return STOPPED if stopped else 1
    _print_rows(table, options.scene, motion, console, every=options.all)
    _print_notes(table, console)
    if stopped:
        console.print(f"[yellow]stopped after {len(table.rows)} of {len(measurement.settings)} settings[/yellow]")
    open_ = options.error is options.rate  # neither is given
    if open_:
        _print_enough(table, motion, console)
    promised = stopped or open_ or _print_promise(measurement, options, console)
    _write(table, options, console)
    return STOPPED if stopped else int(not promised)


def _measure(measurement: Measurement, rows: Rows | None, console: Console) -> bool:
    """Measure all settings; returns whether Ctrl-C ended it."""
    with progress_bar(console) as progress:
        task = progress.add_task("trying", total=2 * len(measurement.settings))
        try:
            for name, row in measurement.run():
                if rows is not None and row is not None:
                    rows.write(row)
                progress.update(task, description=name, advance=1)
        except KeyboardInterrupt:
            return True
    return False


def _print_rows(table: Tradeoff, scene: str, motion: Motion, console: Console, *, every: bool) -> None:
    front = table.pareto()
    shown: Sequence[Measured] = sorted(table.rows, key=lambda row: row.median) if every else front
    rate = f" at {1 / (motion.time[1] - motion.time[0]):.4g} Hz" if len(motion.time) > 1 else ""
    title = f"{escape(scene)}: {len(motion.time)} samples{rate}"
    grid = Table(title=title, title_justify="left", box=SIMPLE_HEAD, padding=(0, 1, 0, 0), pad_edge=False)
    grid.add_column("setting", overflow="fold")
    wide = console.width >= 100
    headers = ["tip\n\\[m]", "shape\n\\[m]", "median\n\\[µs]", "95 %\n\\[µs]", "integr.\na sample"]
    if wide:
        headers[1:1] = ["frame\n\\[rad]"]
        headers += ["samples"]
    for header in headers:
        grid.add_column(header, justify="right", no_wrap=True)
    best, longest = set(map(id, front)), max(row.samples for row in table.rows)
    for row in shown:
        cells = [
            _short(row.position),
            _short(row.shape),
            f"{1e6 * row.median:.0f}",
            f"{1e6 * row.slow:.0f}",
            f"{row.integrations:.2f}",
        ]
        if wide:
            cells[1:1] = [_short(row.rotation)]
            cells += [str(row.samples)]
        less = f" ({row.samples} samples)" if row.samples < longest else ""
        style = "bold" if every and id(row) in best else ""
        grid.add_row(escape(row.name) + less + (f" ({row.failed} failed)" if row.failed else ""), *cells, style=style)
    console.print(grid)
    beaten = len(table.rows) - len(front)
    if every:
        console.print("Bold: no other setting is both faster and more accurate at the tip.", style="dim")
    else:
        console.print(
            f"No other setting is both faster and more accurate at the tip; {beaten} more were measured and are beaten (--all).",
            style="dim",
        )


def _print_notes(table: Tradeoff, console: Console) -> None:
    for note in table.notes():
        console.print(
            escape(note[0].upper() + note[1:] + "."), style="dim" if table.checked or "reference" not in note else "yellow"
        )


def _print_enough(table: Tradeoff, motion: Motion, console: Console) -> None:
    """Name what will do for most, as no error was asked for."""
    error = ENOUGH * motion.robot.longest
    within = f"within {100 * ENOUGH:g} % of the length, {error:.2g} m"
    try:
        row = table.best(error=error)
    except ValueError:
        console.print(f"\n[yellow]No setting is {within}.[/yellow]")
        return
    console.print(f"\n[bold]{escape(row.name)}[/bold] is the fastest {within}; --error or --rate ask for another:")
    console.print(f"  solver = {escape(code(row.solver, prefix='mr.'))}", soft_wrap=True)


def _print_promise(measurement: Measurement, options: argparse.Namespace, console: Console) -> bool:
    """Find what keeps the promise and say so; returns whether there is something."""
    try:
        with console.status("running the best again"):
            row = kept(measurement, error=options.error, rate=options.rate)
    except ValueError as error:
        console.print(f"\n[yellow]{escape(str(error))}[/yellow]")
        return False
    goal = f"stays within {options.error:g} m" if options.error else f"keeps up with {options.rate:g} samples a second"
    console.print(f"\n[bold]{escape(row.name)}[/bold] {goal}. Run again on all {row.samples} samples:")
    console.print(f"  tip within {_short(row.position)} m, frame {_short(row.rotation)} rad, shape {_short(row.shape)} m")
    console.print(f"  {1e6 * row.slow:.0f} µs in 95 of 100 samples, median {1e6 * row.median:.0f} µs")
    console.print(f"  solver = {escape(code(row.solver, prefix='mr.'))}", soft_wrap=True)
    return True


def _write(table: Tradeoff, options: argparse.Namespace, console: Console) -> None:
    written = [options.csv] if options.csv else []
    try:
        for path in options.plot:
            table.plot(path, title=options.scene)
            written.append(path)
        if options.out:
            table.save(options.out, name=f"tradeoff {options.scene}")
            written.append(options.out)
    except ValueError as error:
        console.print(f"[yellow]{escape(str(error))}[/yellow]")
    if written:
        console.print("\nWritten: " + ", ".join(str(path) for path in written))
    if options.out in written:
        console.print(f"Open the recording with: rerun {options.out}")


def _short(value: float) -> str:
    return f"{value:.1e}".replace("e-0", "e-")
