"""A recording of a ``Tradeoff``: work against precision, the motion, and how the errors of the best settings go over time.

=====================================  ==================================================================================
``/description``                       how to read it, and the settings that no other beats, as Markdown
``/work_precision/settings/FAMILY``    a point a setting: time of a sample against the largest error of the tip, log-log
``/work_precision/front``              the settings that no other beats in both, joined by a line
``/work_precision/shown/NAME``         some of them, large, in the colour that they have in all views
``/work_precision/...``                axes, decades, and the band below what the reference tells
``/world/...``                         the reference's motion, as in the recording of a history
``/world/settings/NAME``               tips of these, as long as they were run
``/error/tip_log10/NAME``              log10 of their distance from the reference's tip [m]
=====================================  ==================================================================================

The timelines are those of a history's recording. Points and what explains them do not change with time.
"""

import math
from os import PathLike
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from multirod.recording import columns
from multirod.recording.columns import rgba
from multirod.recording.figure import PALETTE
from multirod.recording.layout import scene_view
from multirod.recording.recorder import ENDING, _name
from multirod.recording.stage import Stage
from multirod.recording.streams import new_stream, whole_file
from multirod.recording.writer import Writer
from multirod.validation import FloatArray, file_path, refuse

if TYPE_CHECKING:
    from rerun import RecordingStream
    from rerun.blueprint import Blueprint

    from multirod.studies.tradeoffs.table import Measured, Tradeoff

SHOWN = 5  # settings on the front whose tips and errors are recorded: more cannot be told apart
_WIDTH, _HEIGHT = 3.0, 2.0  # of the plot, in its own units: 2D views keep the aspect ratio
_GREY, _PALE, _WHITE = 0x3A414A, 0x8A929C, 0xDEE2E6


def save_tradeoff(path: str | PathLike[str], table: "Tradeoff", *, name: str | None = None) -> None:
    """See ``Tradeoff.save``."""
    import rerun as rr

    file = file_path("save.path", path, ENDING)
    title = _name("save.name", name, file.stem)
    front = [row for row in table.pareto() if np.isfinite(row.position)]
    if not front:
        refuse("save", str(path), "no setting has a result in every sample: there is nothing to show")
    shown = _some(front)
    reference = table.reference.history
    steps = np.arange(len(reference.time))
    stream = new_stream()
    writer = Writer([stream], node_count=51, instances=1, force_scale=None, live=False)
    writer.prepare(reference, None, title, "", 1)
    plot = _Plot(table)
    with whole_file(stream, file, _blueprint(writer.stage, shown)):
        stream.send_recording_name(title)
        writer.write_static()
        stream.log(
            "/description", rr.TextDocument(_description(table, front, shown, title), media_type="text/markdown"), static=True
        )
        writer.write(reference, None, steps)
        plot.log(stream, front, shown)
        for k, row in enumerate(shown):
            _log_setting(stream, table, row, PALETTE[k], writer.stage.size)


def _some(front: "list[Measured]") -> "list[Measured]":
    """Settings from all along the front, the fastest and the most accurate among them."""
    return [front[k] for k in np.unique(np.linspace(0, len(front) - 1, min(SHOWN, len(front))).round().astype(int))]


def _log_setting(stream: "RecordingStream", table: "Tradeoff", row: "Measured", color: int, size: float) -> None:
    import rerun as rr

    whole, tips = table.reference.history, table.tips[row.name]
    index = columns.index(np.arange(len(tips)), whole.time[: len(tips)])
    place = _entity(row.name)
    stream.log(f"/world/settings/{place}", rr.Points3D.from_fields(colors=rgba(color), radii=0.006 * size), static=True)
    sound = np.isfinite(tips).all(axis=1)
    counts = sound.astype(int)
    if len(tips) < len(whole.time):  # the last tip would stay
        counts = np.append(counts, 0)
    rows = columns.index(np.arange(len(counts)), whole.time[: len(counts)])
    stream.send_columns(f"/world/settings/{place}", rows, rr.Points3D.columns(positions=tips[sound]).partition(counts))
    error = np.linalg.norm(tips - whole.tip_position[: len(tips)], axis=1)
    path = f"/error/tip_log10/{place}"
    stream.log(path, rr.SeriesLines(names=row.name, colors=rgba(color), widths=1.5), static=True)
    stream.send_columns(path, index, rr.Scalars.columns(scalars=columns.log10(error)))


def _entity(name: str) -> str:
    import rerun as rr

    return str(rr.new_entity_path([name])).lstrip("/")


class _Plot:
    """Where points stand: decades of both axes within the plot's frame."""

    def __init__(self, table: "Tradeoff") -> None:
        self.table = table
        self.rows = [row for row in table.rows if np.isfinite(row.position)]
        self.floor = min((row.position for row in self.rows if row.position > 0), default=1e-16)
        self.x = self._decades([1e6 * row.median for row in self.rows])
        self.y = self._decades([self.error(row) for row in self.rows])

    def error(self, row: "Measured") -> float:
        """To be drawn: what is exact to the last digit has no place on a logarithmic axis."""
        return max(row.position, self.floor)

    @staticmethod
    def _decades(values: list[float]) -> tuple[int, int]:
        low, high = math.floor(math.log10(min(values))), math.ceil(math.log10(max(values)))
        return low, max(high, low + 1)

    def place(self, time: ArrayLike, error: ArrayLike) -> FloatArray:
        """Of a time [µs] and an error [m] in the plot; 2D views point down."""
        x = (np.log10(time) - self.x[0]) / (self.x[1] - self.x[0])
        y = (np.log10(error) - self.y[0]) / (self.y[1] - self.y[0])
        return np.stack(np.broadcast_arrays(_WIDTH * x, _HEIGHT * (1 - y)), axis=-1)

    def log(self, stream: "RecordingStream", front: "list[Measured]", shown: "list[Measured]") -> None:
        import rerun as rr

        self._log_axes(stream)
        families: dict[str, list[Measured]] = {}
        for row in self.rows:
            families.setdefault(row.family, []).append(row)
        for k, (family, rows) in enumerate(families.items()):
            color = rgba(PALETTE[k % len(PALETTE)])
            where = self.place([1e6 * row.median for row in rows], [self.error(row) for row in rows])
            points = rr.Points2D(
                where,
                colors=np.full(len(rows), color, np.uint32),
                radii=rr.Radius.ui_points(4),
                labels=[_label(row) for row in rows],
                show_labels=False,
            )
            stream.log(f"/work_precision/settings/{_entity(family)}", points, static=True)
        line = self.place([1e6 * row.median for row in front], [self.error(row) for row in front])
        strip = rr.LineStrips2D([line], colors=rgba(_WHITE, 0x80), radii=rr.Radius.ui_points(0.75), draw_order=5)
        stream.log("/work_precision/front", strip, static=True)
        for k, row in enumerate(shown):
            where = self.place([1e6 * row.median], [self.error(row)])
            large = rr.Radius.ui_points(8)
            point = rr.Points2D(where, colors=[rgba(PALETTE[k])], radii=large, labels=[row.name], show_labels=True, draw_order=10)
            stream.log(f"/work_precision/shown/{_entity(row.name)}", point, static=True)

    def _log_axes(self, stream: "RecordingStream") -> None:
        import rerun as rr

        times, errors = (10.0 ** np.arange(low, high + 1) for low, high in (self.x, self.y))
        low, high = errors[0], errors[-1]
        lines = [self.place(np.array([t, t]), np.array([low, high])) for t in times]
        lines += [self.place(times[[0, -1]], np.array([e, e])) for e in errors]
        stream.log(
            "/work_precision/axes", rr.LineStrips2D(lines, colors=rgba(_GREY), radii=rr.Radius.ui_points(0.5)), static=True
        )
        below = self.place(times, np.full(len(times), low)) + (0, 0.04 * _HEIGHT)
        beside = self.place(np.full(len(errors), times[0]), errors) - (0.05 * _WIDTH, 0)
        ends = np.array([(0.5 * _WIDTH, 1.1 * _HEIGHT), (0.0, -0.06 * _HEIGHT)])
        words = [
            *(_time(t) for t in times),
            *(_length(e) for e in errors),
            "time of a sample, median",
            "largest error of the tip",
        ]
        stream.log(
            "/work_precision/axes/labels",
            rr.Points2D(
                np.concatenate([below, beside, ends]),
                labels=words,
                colors=np.full(len(words), rgba(_WHITE), np.uint32),
                radii=[0.0] * len(words),
                show_labels=True,
            ),
            static=True,
        )
        told = self.table.reference_gap * self.table.reference.length
        if low < told < high:
            corner, far = self.place(times[0], told), self.place(times[-1], low)
            box = rr.Boxes2D(
                mins=[corner], sizes=[far - corner], colors=rgba(_PALE), labels="below what the reference tells", show_labels=True
            )
            stream.log("/work_precision/told", box, static=True)


def _time(microseconds: float) -> str:
    return (
        f"{microseconds:g} µs"
        if microseconds < 1e3
        else f"{1e-3 * microseconds:g} ms"
        if microseconds < 1e6
        else f"{1e-6 * microseconds:g} s"
    )


def _length(metres: float) -> str:
    for unit, size in (("m", 1.0), ("mm", 1e-3), ("µm", 1e-6), ("nm", 1e-9)):
        if metres >= 0.999 * size:
            return f"{metres / size:.0f} {unit}"
    return f"{metres:.0e} m".replace("e-0", "e-")


def _label(row: "Measured") -> str:
    return (
        f"{row.name}: tip {row.position:.1e} m, shape {row.shape:.1e} m, median {1e6 * row.median:.0f} µs, "
        f"95 % {1e6 * row.slow:.0f} µs, {row.samples} samples"
    )


def _description(table: "Tradeoff", front: "list[Measured]", shown: "list[Measured]", title: str) -> str:
    families = list(dict.fromkeys(row.family for row in table.rows if np.isfinite(row.position)))
    colors = ", ".join(f"{family} {_COLOR_NAMES[k % len(PALETTE)]}" for k, family in enumerate(families))
    lines = [
        f"### {title}",
        "",
        f"**Robot** `{table.reference.history.assembly!r}`  ",
        (
            f"**Small points** a setting each, {len(table.rows)} in all, coloured by solver: {colors}. "
            "The line joins those that no other "
        ),
        "beats in both time and error; down and left is better. Hover over a point for its figures.  ",
        (
            f"**Large points** {len(shown)} of those on the line: the error of their tip over the motion "
            "is drawn below, and their tip in "
        ),
        f"the scene, in the colour of the point. The robot there is the reference. Errors count from {table.settle:g} s on.  ",
        "",
        "| on the line | tip [m] | frame [rad] | shape [m] | median [µs] | 95 % [µs] | samples |",
        "|---|---|---|---|---|---|---|",
    ]
    lines += [
        f"| {row.name} | {row.position:.1e} | {row.rotation:.1e} | {row.shape:.1e} | {1e6 * row.median:.0f} "
        f"| {1e6 * row.slow:.0f} | {row.samples} |"
        for row in front
    ]
    return "\n".join([*lines, "", *(f"{note[0].upper()}{note[1:]}.  " for note in table.notes())])


_COLOR_NAMES = ("blue", "orange", "green", "pink", "violet", "yellow", "teal", "coral", "lime", "mauve", "brown", "grey")


def _blueprint(stage: Stage, shown: "list[Measured]") -> "Blueprint":
    import rerun.blueprint as rrb

    w, h = _WIDTH, _HEIGHT
    bounds = rrb.VisualBounds2D(x_range=(-0.13 * w, 1.08 * w), y_range=(-0.12 * h, 1.15 * h))
    precision = rrb.Spatial2DView(origin="/work_precision", name="Work against precision", visual_bounds=bounds)
    scene = scene_view(stage, "Motion: the reference, and tips of settings")
    errors = rrb.TimeSeriesView(
        origin="/",
        name="Error of the tip, log10 [m]",
        contents=["/error/tip_log10/**"],
        plot_legend=rrb.PlotLegend(rrb.Corner2D.LeftTop, visible=True),
    )
    text = rrb.TextDocumentView(origin="/description", name="Description")
    return rrb.Blueprint(
        rrb.Horizontal(
            rrb.Vertical(precision, errors, row_shares=[3, 2]), rrb.Vertical(text, scene, row_shares=[2, 3]), column_shares=[3, 2]
        ),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
        rrb.TimePanel(state="collapsed", timeline="time"),
        auto_layout=False,
        auto_views=False,
    )
