"""Plots of work against precision."""

from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, cast

import numpy as np

from multirod.plotting.canvas import matplotlib
from multirod.validation import file_path, refuse

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from multirod.studies.tradeoffs.table import Measured, Tradeoff

AXES = {
    "position": "largest error of the tip [m]",
    "rotation": "largest angle of the end effector's frame [rad]",
    "shape": "largest error along the rods [m]",
    "median": "time of a sample, median [µs]",
    "slow": "time that 95 of 100 samples stay within [µs]",
}
MARKERS = {"Newton": "o", "observer": "s", "": "^"}  # by what a family's name begins with


def plot(table: "Tradeoff", path: str | PathLike[str] | None, *, error: str, time: str, title: str, ax: "Axes | None") -> "Axes":
    """See ``Tradeoff.plot``."""
    kinds = sorted(matplotlib("backends.backend_agg").FigureCanvasAgg.get_supported_filetypes())
    if path is not None:
        file_path("plot", path, *(f".{kind}" for kind in kinds))
    shown = [row for row in table.rows if np.isfinite(getattr(row, error))]
    if not shown:
        refuse("plot", table, "no setting has a result in every sample: there is nothing to plot")
    axes: Axes
    if ax is not None:
        axes = ax
    else:
        # a figure that is written is no business of pyplot's
        make = matplotlib("figure").Figure if path is not None else matplotlib().figure
        axes = make(figsize=(8, 5), layout="constrained").add_subplot()
    _draw(axes, table, shown, error=error, time=time, title=title)
    if ax is None:
        axes.figure.legend(fontsize="x-small", loc="outside right upper")
    else:
        axes.legend(fontsize="x-small")
    if path is not None:
        with matplotlib("").rc_context({"svg.fonttype": "none", "svg.hashsalt": "multirod"}):  # small, the same for the same rows
            cast("Figure", axes.figure).savefig(
                path, dpi=150, metadata={"Date": None} if Path(path).suffix.lower() == ".svg" else None
            )
    return axes


def _draw(axes: "Axes", table: "Tradeoff", shown: "list[Measured]", *, error: str, time: str, title: str) -> None:
    # what is exact to the last digit has no place on a logarithmic axis
    floor = min((value for row in shown if (value := getattr(row, error)) > 0), default=1e-16)

    def points(rows: "list[Measured]") -> tuple[list[float], list[float]]:
        return [1e6 * getattr(row, time) for row in rows], [max(getattr(row, error), floor) for row in rows]

    front = [row for row in table.pareto(error=error, time=time) if np.isfinite(getattr(row, error))]
    axes.step(*points(front), where="post", color="0.6", lw=1, label="not beaten in both", zorder=1)
    families: dict[str, list[Measured]] = {}
    for row in shown:
        families.setdefault(row.family, []).append(row)
    for k, (family, rows) in enumerate(families.items()):
        marker = next(marker for start, marker in MARKERS.items() if family.startswith(start))
        colour = f"C{k % 10}"
        axes.plot(*points(rows), marker, ms=5, color=colour, mfc=colour if k < 10 else "none", label=family)
    axes.set(xscale="log", yscale="log", xlabel=AXES[time], ylabel=AXES[error], title=title)
    gap = table.reference_gap * (1.0 if error == "rotation" else table.reference.length)
    low, high = axes.get_ylim()
    if low < gap < high:
        axes.axhspan(low, gap, color="0.9", zorder=0, label="below what the reference tells")
        axes.set_ylim(low, high)
    axes.grid(True, which="major", alpha=0.3)
