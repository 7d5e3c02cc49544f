"""``tradeoff`` and ``tune``."""

from collections.abc import Callable, Mapping
from contextlib import ExitStack
from functools import partial
from os import PathLike
from typing import Any

from multirod.assembly import Assembly
from multirod.inputs import Inputs
from multirod.naming import names_checked
from multirod.running.progress import Watch
from multirod.solver import Solver
from multirod.studies.tradeoffs.measurement import Measurement
from multirod.studies.tradeoffs.promise import kept
from multirod.studies.tradeoffs.table import Measured, Rows, Tradeoff
from multirod.types import Numbers
from multirod.validation import positive_float


@names_checked
def tradeoff(
    robot: Assembly,
    inputs: Inputs,
    *,
    time: Numbers,
    solvers: Mapping[str, Solver] | None = None,
    models: Mapping[str, tuple[Assembly, Inputs]] | None = None,
    settle: float = 0.3,
    budget: float = 60.0,
    csv: str | PathLike[str] | None = None,
    progress: bool | Callable[[int], object] = True,
) -> Tradeoff:
    """Run every setting on a motion and measure its errors and its time.

    The reference is Newton's method to 1e-11 with ``RK45(1e-12, 1e-14)`` on the full model; at some of the samples it is
    compared with one of ``RK4(2000)``. What compiles a kernel is no part of a sample's time, but of the budget.

    Args:
        robot: The assembly, without leading axes.
        inputs: Made by ``robot.inputs(...)``, with time as the first axis.
        time: Of the samples [s], shape (sample_count,).
        solvers: Settings by name; by default ``multirod.studies.tradeoffs.grid(robot, inputs)`` and what else is registered. A
            name up to its first comma is the family in plots.
        models: Robots and inputs of the same motion with some terms left out, by name, such as ``{"without gravity": (robot2,
            inputs2)}``. Every solver is run on each of them too; errors are against the full model.
        settle: Errors count from here on [s]: an observer starts off the solution.
        budget: Time that all of it should take [s]: settings that would take longer than their share run on
            fewer samples, and those for which nothing is left are skipped. It is over after twice as long, a kernel aside that is
            being compiled then, and those of the reference (``docs/tradeoff.md``).
        csv: File (``.csv``) that every row is written to as it comes, so that a run that is stopped leaves what it measured.
        progress: Whether to show a bar, or a function that is called with the number of settings done.

    Raises:
        TypeError, ValueError: If an argument is not what it must be, or the reference alone takes longer than the budget.
    """
    options: dict[str, Any] = {"solvers": solvers, "models": models, "settle": settle, "budget": budget}
    return _measure(csv, progress, partial(Measurement, robot, inputs, time=time, **options)).table


@names_checked
def tune(
    robot: Assembly,
    inputs: Inputs,
    *,
    time: Numbers,
    error: float | None = None,
    rate: float | None = None,
    solvers: Mapping[str, Solver] | None = None,
    models: Mapping[str, tuple[Assembly, Inputs]] | None = None,
    settle: float = 0.3,
    budget: float = 60.0,
    csv: str | PathLike[str] | None = None,
    progress: bool | Callable[[int], object] = True,
) -> Measured:
    """The fastest setting within an error, or the most accurate within a rate, with what was measured of it.

    What ``tradeoff`` finds best is run again on the whole motion, and taken if it keeps the promise there; else the next is.

    Args:
        robot: The assembly.
        inputs: With time as the first axis.
        time: Of the samples [s].
        error: Largest distance of the tip from the reference [m].
        rate: Samples a second that 95 of 100 samples must keep up with, with half of the time to spare.
        solvers: As for ``tradeoff``.
        models: As for ``tradeoff``.
        settle: As for ``tradeoff``.
        budget: As for ``tradeoff``.
        csv: As for ``tradeoff``.
        progress: As for ``tradeoff``.

    Raises:
        TypeError: If not exactly one of both is given.
        ValueError: If no setting does it, the reference could not be checked, or the budget was over before.
    """
    if (error is None) == (rate is None):
        raise TypeError("tune() takes error= [m], to find the fastest within it, or rate= [1/s], the most accurate: one of both")
    for name, value in (("error", error), ("rate", rate)):
        if value is not None:
            positive_float(name, value)
    options: dict[str, Any] = {"solvers": solvers, "models": models, "settle": settle, "budget": budget}
    make = partial(Measurement, robot, inputs, time=time, **options)
    return kept(_measure(csv, progress, make), error=error, rate=rate)


def _measure(
    csv: str | PathLike[str] | None, progress: bool | Callable[[int], object], make: Callable[[], Measurement]
) -> Measurement:
    with ExitStack() as stack:
        # its first line is there before anything is measured
        rows = None if csv is None else stack.enter_context(Rows(csv))
        measurement = make()
        watch = stack.enter_context(Watch("settings", len(measurement.settings), progress, shares=2))
        for _, row in measurement.run():
            if rows is not None and row is not None:
                rows.write(row)
            watch.advance()
    return measurement
