"""Speed against accuracy, measured: settings of a grid on one motion, against a reference that is checked."""

import csv
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from math import inf
from os import PathLike
from time import monotonic
from typing import Any

import numpy as np

from multirod.assembly import Assembly
from multirod.inputs import Inputs
from multirod.models.integrators import RK4, RK23, RK45, Integrator
from multirod.progress import Watch
from multirod.simulation import simulate, solve
from multirod.solution import History
from multirod.solver import Solver
from multirod.solvers.observer import Observer
from multirod.solvers.shooting import PREDICTORS, Shooting
from multirod.validation import Described, FloatArray, choice, positive_float, refuse

ERRORS = ("position", "rotation", "shape")
TIMES = ("median", "slow")
REFERENCE = Shooting(tolerance=1e-11, integrator=RK45(1e-12, 1e-14))
CHECK = Shooting(tolerance=1e-11, integrator=RK4(2000))
AGREEMENT = 1e-9  # of the length, that two references must agree within
CHECKED_SAMPLES = 20
SHAPE_NODES = 21
TRIAL = 20  # samples that say how long all will take
FEWEST_SAMPLES = 50
MARGIN = 0.8  # of the time that a promised rate leaves, for samples on another day


@dataclass(frozen=True)
class Measured:
    """One setting, and what it came to on a motion.

    Attributes:
        name: In tables and plots.
        solver: Ready to use.
        position: Largest distance of the tip from the reference [m].
        rotation: Largest angle between the end effector's frame and the reference's [rad].
        shape: Largest distance of a node of any rod from the reference's [m].
        residual: Largest residual that the setting reports [1/m].
        median: Time of a sample [s].
        slow: Time that 95 of 100 samples stay within [s].
        integrations: Of each rod, mean a sample.
        samples: Samples run: all, or as many as the budget allowed.
        failed: Samples without a result, the errors are then infinite.
    """

    name: str
    solver: Solver
    position: float
    rotation: float
    shape: float
    residual: float
    median: float
    slow: float
    integrations: float
    samples: int
    failed: int


class Tradeoff:
    """What every setting came to.

    Attributes:
        rows: One a setting, in the order of the grid.
        skipped: Names of settings that the budget left no time for.
        reference_gap: How far two references, by other integrators, are apart in the tip's position, relative to the length.
    """

    def __init__(self, rows: Sequence[Measured], skipped: Sequence[str], reference_gap: float) -> None:
        self.rows = tuple(rows)
        self.skipped = tuple(skipped)
        self.reference_gap = reference_gap

    @property
    def checked(self) -> bool:
        """Whether the reference is right: two independent ones agree to 1e-9 of the length."""
        return bool(self.reference_gap <= AGREEMENT)

    def pareto(self, *, error: str = "position", time: str = "median") -> list[Measured]:
        """The settings of which none other is both faster and more accurate, fastest first.

        Args:
            error: ``"position"``, ``"rotation"`` or ``"shape"``.
            time: ``"median"`` or ``"slow"``.
        """
        choice("error", error, ERRORS)
        choice("time", time, TIMES)
        best, result = inf, []
        for row in sorted(self.rows, key=lambda row: (getattr(row, time), getattr(row, error))):
            if getattr(row, error) < best:
                best = getattr(row, error)
                result.append(row)
        return result

    def best(self, *, error: float | None = None, time: float | None = None) -> Measured:
        """The fastest setting whose tip is within ``error`` [m], or the most accurate whose samples are within ``time`` [s].

        Samples count by their median for an error, and by what 95 of 100 stay within for a time.

        Raises:
            TypeError: If not exactly one of both is given.
            ValueError: If no setting is; the message says what there is.
        """
        if (error is None) == (time is None):
            raise TypeError("best() takes error or time")
        if error is not None:
            limit = positive_float("error", error)
            fitting = [row for row in self.rows if row.position <= limit]
            if not fitting:
                refuse("error", error, f"the most accurate setting is off by {min(row.position for row in self.rows):.2g} m")
            return min(fitting, key=lambda row: row.median)
        limit = positive_float("time", time)
        fitting = [row for row in self.rows if row.slow <= limit and np.isfinite(row.position)]
        if not fitting:
            refuse("time", time, f"the fastest setting takes {min(row.slow for row in self.rows):.2g} s")
        return min(fitting, key=lambda row: row.position)

    def to_csv(self, path: str | PathLike[str]) -> None:
        """Write all rows, one line each, SI units."""
        names = [name for name in Measured.__dataclass_fields__ if name != "solver"]
        with open(path, "w", newline="", encoding="utf-8") as file:
            writer = csv.writer(file)
            writer.writerow([*names, "solver"])
            writer.writerows([*(getattr(row, name) for name in names), repr(row.solver)] for row in self.rows)

    def plot(self, path: str | PathLike[str], *, error: str = "position", time: str = "median") -> None:
        """Write a plot of work against precision, log-log, as the path's ending says (png, svg); needs ``multirod[plot]``."""
        import matplotlib.pyplot as plt  # type: ignore[import-not-found, unused-ignore]

        figure, axes = plt.subplots(figsize=(8, 5))
        families: dict[str, list[Measured]] = {}
        for row in self.rows:
            families.setdefault(row.name.split(", ")[0], []).append(row)
        for family, rows in families.items():
            axes.loglog([getattr(r, time) for r in rows], [max(getattr(r, error), 1e-16) for r in rows], ".", label=family)
        front = self.pareto(error=error, time=time)
        axes.loglog([getattr(r, time) for r in front], [getattr(r, error) for r in front], "k-", lw=0.8, label="not beaten")
        axes.set(xlabel=f"time of a sample, {time} [s]", ylabel=f"{error} error [{'rad' if error == 'rotation' else 'm'}]")
        axes.grid(True, which="major", alpha=0.3)
        axes.legend(fontsize="small")
        figure.savefig(path, dpi=150, bbox_inches="tight")
        plt.close(figure)

    def __str__(self) -> str:
        front = {id(row) for row in self.pareto()}
        lines = [f"{'setting':44}{'tip [m]':>10}{'shape [m]':>11}{'median [µs]':>13}{'95 % [µs]':>11}{'integr.':>9}{'failed':>8}"]
        for row in sorted(self.rows, key=lambda row: row.median):
            lines.append(
                f"{'* ' if id(row) in front else '  '}{row.name:42}{row.position:10.1e}{row.shape:11.1e}{1e6 * row.median:13.0f}"
                f"{1e6 * row.slow:11.0f}{row.integrations:9.2f}{row.failed:8}"
            )
        lines.append("* no other setting is both faster and more accurate")
        if self.skipped:
            lines.append("no time was left for " + "; ".join(self.skipped))
        word = "agree within" if self.checked else "DO NOT AGREE, errors below this mean nothing:"
        lines.append(f"two references by other integrators {word} {self.reference_gap:.1e} of the length")
        return "\n".join(lines)


def grid(integrators: Sequence[Integrator] | None = None) -> dict[str, Solver]:
    """The settings that are tried by default: solvers, in the forms that differ in speed or accuracy, by integrators.

    Args:
        integrators: ``RK4`` at 10 to 200 steps, ``RK23`` and ``RK45`` at three tolerances each by default.
    """
    if integrators is None:
        adaptive = [RK23(), RK23(1e-5, 1e-8), RK45(1e-4, 1e-7), RK45(1e-6, 1e-9), RK45()]
        integrators = [*(RK4(steps) for steps in (10, 20, 50, 100, 200)), *adaptive]
    result: dict[str, Solver] = {}
    for integrator in integrators:
        for predictor in PREDICTORS:
            result[f"Newton, {predictor} predictor, {integrator}"] = Shooting(predictor=predictor, integrator=integrator)
        forms: dict[str, dict[str, Any]] = {
            "observer": {},
            "observer fed forward": {"feed_forward": True},
            "observer fed forward and corrected": {"feed_forward": True, "correct_output": True},
            "observer in Newton's scaling": {"scaling": "newton", "feed_forward": True},
        }
        for name, form in forms.items():
            result[f"{name}, {integrator}"] = Observer(integrator=integrator, **form)
    return result


def tradeoff(
    robot: Assembly,
    inputs: Inputs,
    *,
    time: Any,
    solvers: Mapping[str, Solver] | None = None,
    settle: float = 0.3,
    budget: float = 60.0,
    progress: bool | Callable[[int], Any] = True,
) -> Tradeoff:
    """Run every setting on a motion and measure its errors and its time.

    The reference is Newton's method to 1e-11 with ``RK45(1e-12, 1e-14)``; at some of the samples it is compared with one of
    ``RK4(2000)``. What compiles a kernel is not part of a time.

    Args:
        robot: The assembly, without leading axes.
        inputs: Made by ``robot.inputs(...)``, with time as the first axis.
        time: Of the samples [s], shape (sample_count,).
        solvers: Settings by name; ``grid()`` by default. A name up to its first comma is the family in plots.
        settle: Errors count from here on [s]: an observer starts off the solution.
        budget: Time that all of it may take [s], the reference and compilation aside: settings that would take longer than their
            share run on fewer samples, and those for which nothing is left are skipped.
        progress: Whether to show a bar, or a function that is called with the number of settings done.

    Raises:
        TypeError, ValueError: If an argument is not what it must be.
    """
    settings = grid() if solvers is None else dict(solvers)
    if not settings:
        refuse("solvers", settings, "there must be one")
    limit = positive_float("budget", budget)
    reference = simulate(robot, inputs, time=time, solver=REFERENCE, progress=False)
    if len(reference.batch_shape) != 1:
        refuse("inputs", Described(f"leading axes {reference.batch_shape}"), "there must be one, time")
    time = reference.time
    settled = time >= settle
    if not settled.any():
        refuse("settle", settle, f"must be before the last sample, {time[-1]:g} s")
    gap = _gap(robot, inputs, reference)
    nodes = [reference.rod(k, nodes=SHAPE_NODES).position for k in range(robot.rod_count)]
    rows, skipped, spent = [], [], 0.0
    with Watch("settings", len(settings), progress) as watch:
        for done, (name, solver) in enumerate(settings.items()):
            share = (limit - spent) / (len(settings) - done)
            simulate(robot, inputs[:2], time=time[:2], solver=solver, progress=False)  # compiles
            begin = monotonic()
            trial = simulate(robot, inputs[:TRIAL], time=time[:TRIAL], solver=solver, progress=False)
            each = (monotonic() - begin) / len(trial.time)
            first = int(np.argmax(settled))
            count = len(time) if each * len(time) <= share else int(max(share / each, first + FEWEST_SAMPLES))
            if share <= 0:
                skipped.append(name)
            else:
                count = min(count, len(time))
                history = simulate(robot, inputs[:count], time=time[:count], solver=solver, progress=False)
                rows.append(_measured(name, solver, history, reference, settled[:count], nodes))
            spent += monotonic() - begin
            watch.advance()
    return Tradeoff(rows, skipped, gap)


def tune(
    robot: Assembly,
    inputs: Inputs,
    *,
    time: Any,
    error: float | None = None,
    rate: float | None = None,
    **options: Any,
) -> Measured:
    """The fastest setting within an error, or the most accurate within a rate, with what was measured of it.

    Args:
        robot: The assembly.
        inputs: With time as the first axis.
        time: Of the samples [s].
        error: Largest distance of the tip from the reference [m].
        rate: Samples a second that 95 of 100 samples must keep up with, with a fifth of the time to spare.
        options: For ``tradeoff``.

    Raises:
        TypeError: If not exactly one of both is given.
        ValueError: If no setting does it, or the reference could not be checked.
    """
    if (error is None) == (rate is None):
        raise TypeError("tune() takes error or rate")
    measured = tradeoff(robot, inputs, time=time, **options)
    if not measured.checked:
        raise ValueError(
            f"the reference could not be checked: two of them are {measured.reference_gap:.1e} of the length apart, not {AGREEMENT:g}"
        )
    return measured.best(error=error) if rate is None else measured.best(time=MARGIN / positive_float("rate", rate))


def _gap(robot: Assembly, inputs: Inputs, reference: History) -> float:
    """Largest distance of the reference's tip from that of another integrator, over the length; infinite where either fails."""
    chosen = np.unique(np.linspace(0, len(reference.time) - 1, CHECKED_SAMPLES).astype(int))
    other = solve(robot, inputs[chosen], solver=CHECK, guess=reference.unknowns[chosen], progress=False)
    length = max(float(np.max(rod.length)) for rod in robot.rods)
    gap = np.linalg.norm(other.tip_position - reference.tip_position[chosen], axis=-1) / length
    return float(gap.max()) if np.isfinite(gap).all() else inf


def _measured(
    name: str, solver: Solver, history: History, reference: History, settled: Any, nodes: Sequence[FloatArray]
) -> Measured:
    count = len(history.time)
    failed = np.asarray(~np.isfinite(history.tip_position).all(axis=-1))

    def largest(values: FloatArray) -> float:
        return float(np.max(values[settled])) if not failed[settled].any() else inf

    turned = np.swapaxes(reference.tip_rotation[:count], -1, -2) @ history.tip_rotation
    sine = np.linalg.norm(turned - np.swapaxes(turned, -1, -2), axis=(-2, -1)) / np.sqrt(8)
    angle = np.arctan2(sine, (np.trace(turned, axis1=-2, axis2=-1) - 1) / 2)
    shape = np.zeros(count)
    for k, there in enumerate(nodes):
        here = history.rod(k, nodes=SHAPE_NODES).position
        shape = np.maximum(shape, np.linalg.norm(here - there[:count], axis=-1).max(axis=-1))
    took = history.step_time[2:] if count > 2 else history.step_time  # the first start from nothing
    return Measured(
        name=name,
        solver=solver,
        position=largest(np.linalg.norm(history.tip_position - reference.tip_position[:count], axis=-1)),
        rotation=largest(angle),
        shape=largest(shape),
        residual=largest(np.asarray(history.residual)),
        median=float(np.median(took)),
        slow=float(np.percentile(took, 95)),
        integrations=float(np.mean(history.integrations[2:] if count > 2 else history.integrations)),
        samples=count,
        failed=int(failed.sum()),
    )
