"""What every setting came to, and which to take."""

import csv
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from math import inf
from os import PathLike
from types import TracebackType
from typing import TYPE_CHECKING, Self

import numpy as np

from multirod.solver import Solver
from multirod.studies.tradeoffs.reference import AGREEMENT, Reference
from multirod.studies.tradeoffs.settings import code
from multirod.validation import FloatArray, choice, file_path, positive_float, refuse

if TYPE_CHECKING:
    from matplotlib.axes import Axes

ERRORS = ("position", "rotation", "shape")
TIMES = ("median", "slow")


@dataclass(frozen=True)
class Measured:
    """One setting, and what it came to on a motion.

    Attributes:
        name: In tables and plots.
        solver: Ready to use.
        position: Largest distance of the tip from the reference [m]; of all nodes, where inputs say where that is.
        rotation: Largest angle between the end effector's frame and the reference's [rad].
        shape: Largest distance of a node of any rod, of 21, from the reference's [m]; at fewer steps than nodes these take a step
            each (``docs/tradeoff.md``).
        residual: Largest residual that the setting reports [1/m].
        median: Time of a sample [s].
        slow: Time that 95 of 100 samples stay within [s].
        integrations: Of each rod, mean a sample.
        samples: Samples run: all, or as many as the budget allowed.
        failed: Samples without a result, the errors are then infinite.
        model: Name of the model that it was run on; empty for the full one.
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
    model: str = ""

    @property
    def family(self) -> str:
        """What it has in common with others: its solver without integrator, and its model."""
        solver = self.name.split(",")[0]
        return f"{solver}, {self.model}" if self.model else solver


NUMBERS = tuple(field.name for field in fields(Measured) if field.name != "solver")


class Rows:
    """A file of comma-separated values to which every row is written, and flushed, as it comes: what is stopped leaves it."""

    def __init__(self, path: str | PathLike[str]) -> None:
        self._file = file_path("csv", path, ".csv").open("w", newline="", encoding="utf-8")  # closed by ``with Rows(...)``
        self._writer = csv.writer(self._file)
        self._writer.writerow([*NUMBERS, "solver"])
        self._file.flush()

    def write(self, row: Measured) -> None:
        """Append a row; the last column is the solver as Python code."""
        self._writer.writerow([*(getattr(row, name) for name in NUMBERS), code(row.solver)])
        self._file.flush()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self._file.close()


class Tradeoff:
    """What every setting came to.

    Attributes:
        rows: One a setting, in the order of the grid.
        skipped: Why there is no row of a setting, by its name: it cannot take the robot, or the budget left no time.
        reference: What errors are measured against.
        tips: Positions of the tip [m] in the samples run, shape (sample_count, 3), by name.
        settle: Errors count from here on [s].
    """

    def __init__(
        self,
        rows: Sequence[Measured],
        skipped: Mapping[str, str],
        reference: Reference,
        tips: Mapping[str, FloatArray],
        settle: float,
    ) -> None:
        self.rows = tuple(rows)
        self.skipped = dict(skipped)
        self.reference = reference
        self.tips = dict(tips)
        self.settle = settle

    @property
    def reference_gap(self) -> float:
        """How far two references, by other integrators, are apart: position over length, or angle; infinite where one failed."""
        return self.reference.gap

    @property
    def checked(self) -> bool:
        """Whether the reference is right: two independent ones agree to 1e-9."""
        return self.reference.checked

    def pareto(self, *, error: str = "position", time: str = "median") -> list[Measured]:
        """The settings of which none other is both faster and more accurate, fastest first.

        Settings for which the budget left time for a shorter part of the motion only are left out: the largest error of less is
        no better.

        Args:
            error: ``"position"``, ``"rotation"`` or ``"shape"``.
            time: ``"median"`` or ``"slow"``.
        """
        choice("error", error, ERRORS)
        choice("time", time, TIMES)
        best, result = inf, []
        longest = max((row.samples for row in self.rows), default=0)
        compared = [row for row in self.rows if row.samples == longest]
        for row in sorted(compared, key=lambda row: (getattr(row, time), getattr(row, error))):
            if getattr(row, error) < best:
                best = getattr(row, error)
                result.append(row)
        return result

    def fitting(self, *, error: float | None = None, time: float | None = None) -> list[Measured]:
        """All settings that ``best`` chooses from, the best first.

        Raises:
            TypeError: If not exactly one of both is given.
            ValueError: If no setting is; the message says what there is.
        """
        if (error is None) == (time is None):
            raise TypeError("best() takes error or time")
        good = [row for row in self.rows if np.isfinite(row.position)]
        field = "error" if time is None else "time"
        longest = max((row.samples for row in good), default=0)
        if not good:
            why = "no setting has a result in every sample" if self.rows else "the budget left no time to measure any setting"
            refuse(field, error if time is None else time, why)
        if time is None:
            limit = positive_float("error", error)
            least = min(good, key=lambda row: row.position)
            if least.position > limit:
                refuse("error", error, f"the most accurate setting, {least.name}, is off by {least.position:.2g} m")
            return sorted((row for row in good if row.position <= limit), key=lambda row: (row.samples < longest, row.median))
        limit = positive_float("time", time)
        fastest = min(good, key=lambda row: row.slow)
        if fastest.slow > limit:
            refuse("time", time, f"the fastest setting, {fastest.name}, takes {fastest.slow:.2g} s")
        return sorted((row for row in good if row.slow <= limit), key=lambda row: (row.samples < longest, row.position))

    def best(self, *, error: float | None = None, time: float | None = None) -> Measured:
        """The fastest setting whose tip is within ``error`` [m], or the most accurate whose samples are within ``time`` [s].

        Samples count by their median for an error, and by what 95 of 100 stay within for a time. A setting that ran on a shorter
        part of the motion than others is taken only where none of these will do.

        Raises:
            TypeError: If not exactly one of both is given.
            ValueError: If no setting is; the message says what there is.
        """
        return self.fitting(error=error, time=time)[0]

    def to_csv(self, path: str | PathLike[str]) -> None:
        """Write all rows, one line each, SI units.

        Raises:
            ValueError: If ``path`` does not end in ``.csv``, or its folder does not exist.
        """
        with Rows(path) as rows:
            for row in self.rows:
                rows.write(row)

    def plot(
        self,
        path: str | PathLike[str] | None = None,
        *,
        error: str = "position",
        time: str = "median",
        title: str = "",
        ax: "Axes | None" = None,
    ) -> "Axes":
        """Plot work against precision, log-log.

        Args:
            path: File to write, as its ending says (png, svg); none by default.
            error: ``"position"``, ``"rotation"`` or ``"shape"``.
            time: ``"median"`` or ``"slow"``.
            title: Of the plot.
            ax: Axes to draw on; by default those of a new figure.

        Returns:
            The axes.

        Raises:
            ImportError: If matplotlib is not there: ``pip install "multirod[plot]"``.
            ValueError: If there is nothing to plot, or the ending is none that matplotlib knows.
        """
        from multirod.studies.tradeoffs.plot import plot

        choice("error", error, ERRORS)
        choice("time", time, TIMES)
        return plot(self, path, error=error, time=time, title=title, ax=ax)

    def save(self, path: str | PathLike[str], *, name: str | None = None) -> None:
        """Write a recording for the Rerun viewer: work against precision, the motion, and errors of the best settings over time.

        Args:
            path: File to write (``.rrd``); an existing one is replaced.
            name: What the viewer calls the recording; by default the file's name.

        Raises:
            ValueError: If there is nothing to show, or the path is no file in a folder that exists.
        """
        from multirod.recording.work_precision import save_tradeoff

        save_tradeoff(path, self, name=name)

    def _repr_html_(self) -> str:
        from multirod.results import html

        return html.tradeoff(self)

    def __str__(self) -> str:
        front = {row.name for row in self.pareto()}
        width = max([42, *(len(row.name) for row in self.rows)])
        lines = [
            (
                f"{'setting':{width + 2}}{'tip [m]':>10}{'shape [m]':>11}"
                f"{'median [us]':>13}{'95 % [us]':>11}{'integr.':>9}{'failed':>8}"
            )
        ]
        for row in sorted(self.rows, key=lambda row: row.median):
            lines.append(
                f"{'* ' if row.name in front else '  '}{row.name:{width}}{row.position:10.1e}{row.shape:11.1e}"
                f"{1e6 * row.median:13.0f}{1e6 * row.slow:11.0f}{row.integrations:9.2f}{row.failed:8}"
            )
        return "\n".join([*lines, "* no other setting is both faster and more accurate", *self.notes()])

    def notes(self) -> list[str]:
        """What a reader of the rows must know: what there is no row of, what was cut short, what errors are against."""
        reasons: dict[str, list[str]] = {}
        for name, reason in self.skipped.items():
            reasons.setdefault(reason, []).append(name)
        lines = []
        for reason, names in reasons.items():
            shown = "; ".join(names[:3]) + (f"; and {len(names) - 3} more" if len(names) > 3 else "")
            lines.append(f"not measured: {shown}: {reason}")
        total = len(self.reference.history.time)
        short = [row.samples for row in self.rows if row.samples < total]
        if short:
            some = f"the first {min(short)}" + (f" to {max(short)}" if max(short) > min(short) else "")
            lines.append(f"{len(short)} of {len(self.rows)} settings ran on {some} of {total} samples only")
        unknown = int((~self.reference.known).sum())
        if unknown:
            lines.append(f"the reference FAILED in {unknown} of {total} samples: errors are of the others and not checked")
        elif self.checked:
            lines.append(f"two references by other integrators agree within {self.reference_gap:.1e} of the length")
        else:
            lines.append(
                f"two references by other integrators DO NOT AGREE within {AGREEMENT:g} of the length but are "
                f"{self.reference_gap:.1e} apart: errors below that mean nothing"
            )
        return lines
