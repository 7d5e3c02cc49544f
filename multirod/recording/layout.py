"""What a recording opens with: a description of the run, and the layout of the views."""

import math
from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np

from multirod.models.assemblies.network import Network
from multirod.recording.columns import rgba
from multirod.recording.figure import bodies_in_words, joined_to
from multirod.recording.stage import Stage

if TYPE_CHECKING:
    import rerun.blueprint as rrb

    View: TypeAlias = rrb.View | rrb.Container

# Plots along the arclength in their own units: 2D views keep the aspect ratio, so both axes are scaled to fit.
PLOT_WIDTH, PLOT_HEIGHT = 4.0, 1.0
_LOWEST = -20.0  # decade from which on residuals are nothing
_DECADES = 4  # that the viewer numbers in a small plot
_LANES = 4  # instances whose status has room below the shape


def description(stage: Stage, title: str, solver: str, total: int, compared: str = "") -> str:
    """What was run, units and scales, as Markdown; of ``total`` instances, ``compared`` with what the reference is."""
    lines = [f"### {title}", "", f"**Robot** `{stage.assembly!r}`  "]
    lines += [f"**Solver** `{solver}`  "] if solver else []
    lines += [f"**Compared with** {stage.reference}, in grey{f': `{compared}`' if compared else ''}  "] if stage.reference else []
    lines += [f"**Batch** the first {stage.count} of {total} instances  "] if total > stage.count else []
    lines += [
        "",
        f"| {stage.kind} | colour | length [m] | EI [N m^2] | GJ [N m^2] | drawn diameter [mm] |",
        "|---|---|---|---|---|---|",
        *_table(stage),
        "",
        *_graph(stage),
        f"**Shape** {legend(stage)}  ",
        "",
        "**Plots** "
        + ("Instances are coloured as their rods. " if stage.batched and len(stage.rods) == 1 and not stage.coloring else "")
        + "Vectors: x red, y green, z blue. Boundary error: what the solver drives to zero [1/m]. "
        + (f"{stage.split.capitalize()}: in their colours{_balance(stage)}. " if stage.blocks else "")
        + ("Target error: distance from the target as the model has it [mm]. " if _told(stage, "target_error") else "")
        + ("Limits: where each limited number stands, 0 at its lower end and 1 at its upper. " if _told(stage, "limits") else "")
        + ("Tip error: distance from the reference's tip [mm]. " if stage.reference else "")
        + "Condition and \u03c3 min, the least singular value, are of Gamma, the scaled Jacobian; the second vanishes at a fold.",
        "",
        "**Along the arclength**, at the cursor: curvature, moment and force "
        + ("in the frame of the section" if stage.by_component else "by their magnitudes, curvature without twist")
        + "; force is of all concentric rods together"
        + ("; strain is the largest of bending at the surface" if any(p.name == "strain" for p in stage.profiles) else "")
        + ("; difference is the distance from the reference" if any(p.name == "difference" for p in stage.profiles) else "")
        + ". Where a section ends they may jump.",
        "",
        "**Status** of each sample; one that failed has no shape, no numbers in the plots, and the last shape before in grey. "
        + "One in which the robot buckled, snapped, or left its branch otherwise has the shape before in grey too.",
    ]
    return "\n".join(lines)


def legend(stage: Stage) -> str:
    """What is drawn, and to what scale, in a line."""
    parts = [f"grid {1e3 * stage.grid:g} mm", "frames x red, y green, z blue", "white: path of the tip"]
    for kind, unit in (("force", "N"), ("moment", "N m")):
        arrows = dict.fromkeys(f"{load.shade} `{load.name}`" for load in stage.loads if load.kind == kind)
        if arrows:
            parts.append(f"arrows: {', '.join(arrows)}, 1 {unit} is {1e3 * stage.scales[kind]:.4g} mm")
    if any(load.rods for load in stage.loads):
        parts.append("`along`: all that acts along a rod, as one force")
    if stage.lines:
        parts.append(f"lines: red pulls, blue pushes, in full at {stage.strongest:g} N; grey hangs loose")
    if stage.thinner:
        parts.append("rods thinner than they are, so that lines show")
    if _told(stage, "target"):
        parts.append("amber: target and its path")
    if _told(stage, "measured"):
        parts.append("magenta: where the tip was seen")
    if stage.remarks is not None and stage.remarks.covariances:
        parts.append("ellipsoid: 95 % of what the force may be")
    if stage.coloring:
        parts.append(f"{stage.coloring}, grey without result")
    if stage.reference:
        parts.append(f"grey: {stage.reference}")
    return " · ".join(parts)


def _told(stage: Stage, name: str) -> bool:
    """Whether a task said this of the samples."""
    return stage.remarks is not None and getattr(stage.remarks, name) is not None


def _balance(stage: Stage) -> str:
    if isinstance(stage.assembly, Network):
        return ", light grey the balance of the bodies"
    return ", light grey the platform's balance" if stage.kind == "leg" else ""


def _graph(stage: Stage) -> list[str]:
    """Of a network what each rod stands on and what its tip is joined to, a row for those that are alike; and its bodies."""
    robot = stage.assembly
    if not isinstance(robot, Network):
        return []
    rows: dict[tuple[str, str], list[str]] = {}
    for rod, held in zip(robot.rods, joined_to(robot), strict=True):
        rows.setdefault(held, []).append(rod.name)
    lines = ["| rods | base on | tip on |", "|---|---|---|"]
    lines += [f"| {', '.join(names)} | {base} | {tip} |" for (base, tip), names in rows.items()]
    said = f"**Bodies** {bodies_in_words(robot)}. " if robot.bodies else ""
    return [*lines, "", f"{said}**End effector** {robot.effector_name}  ", ""]


def _table(stage: Stage) -> list[str]:
    """A row for rods that are alike."""
    rows: dict[tuple[str, ...], list[int]] = {}
    for index, rod in enumerate(stage.assembly.rods):
        bending = _span([section.bending_stiffness for section in rod.sections])
        torsion = _span([section.torsional_stiffness for section in rod.sections])
        drawn = f"{2e3 * stage.rods[index].radius:.3g}"
        if rod.outer_diameter is None:
            drawn += " (not given)"
        elif np.ndim(rod.outer_diameter) or stage.rods[index].radius > 0.51 * rod.outer_diameter:
            drawn += f" (is {_span([1e3 * np.asarray(rod.outer_diameter)])})"
        rows.setdefault((_span([rod.length]), bending, torsion, drawn), []).append(index)
    lines = []
    for values, indices in rows.items():
        names = ", ".join(stage.rods[index].name for index in indices)
        shades = "by instance" if _by_instance(stage) else ", ".join(stage.rods[index].shade for index in indices)
        lines.append(f"| {names} | {shades} | " + " | ".join(values) + " |")
    return lines


def _by_instance(stage: Stage) -> bool:
    return stage.coloring is not None or (stage.batched and len(stage.rods) == 1)


def scene_view(stage: Stage, name: str, overrides: Mapping[Any, Any] | None = None) -> "rrb.Spatial3DView":
    """The robot in space, seen from where the stage stands."""
    import rerun.blueprint as rrb

    return rrb.Spatial3DView(
        origin="/world",
        name=name,
        background=rrb.Background(color=rgba(0x15191F), kind=rrb.BackgroundKind.SolidColor),
        line_grid=rrb.LineGrid3D(visible=True, spacing=stage.grid, stroke_width=0.5, color=rgba(0x3A414A, 0x90)),
        eye_controls=rrb.EyeControls3D(
            kind=rrb.Eye3DKind.Orbital, position=stage.eye, look_target=stage.centre, eye_up=(0, 0, 1)
        ),
        overrides=overrides,
    )


def blueprint(stage: Stage, ranges: Mapping[str, tuple[float, float]] = MappingProxyType({})) -> "rrb.Blueprint":
    """The views that a recording opens with; ``ranges`` of what is plotted by its logarithm, by entity, where they are known."""
    import rerun.blueprint as rrb

    up_to_now = rrb.VisibleTimeRanges(
        [
            rrb.VisibleTimeRange(name, start=rrb.TimeRangeBoundary.infinite(), end=rrb.TimeRangeBoundary.cursor_relative(**zero))
            for name, zero in (("time", {"seconds": 0.0}), ("step", {"seq": 0}))
        ]
    )
    kinds = ("tip_path", "reference/tip_path", "target_path")
    paths = [stage.world(kind, k) for kind in kinds for k in range(stage.count)]
    scene = scene_view(stage, "Shape", overrides={path: [up_to_now] for path in paths})
    left = rrb.Vertical(scene, rrb.TextDocumentView(origin="/legend", name="Legend"), row_shares=[6, 1.2])
    plots = _plots(stage, ranges)
    text = rrb.TextDocumentView(origin="/description", name="Description")
    right = rrb.Tabs(plots, text, active_tab=0)
    lane = rrb.StateTimelineView(origin="/status", name="Status of each sample")
    return rrb.Blueprint(
        rrb.Vertical(
            rrb.Horizontal(left, right, column_shares=[1, 1]),
            lane,
            row_shares=[6, 0.75 + 0.25 * min(stage.count, _LANES)],
        ),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
        rrb.TimePanel(state="collapsed", timeline="time"),
        auto_layout=False,
        auto_views=False,
    )


def _plots(stage: Stage, ranges: Mapping[str, tuple[float, float]]) -> "rrb.Vertical":
    """What changes with time, and what is along the arclength at the cursor."""
    import rerun.blueprint as rrb

    def plot(name: str, *contents: str, legend: bool = False, span: tuple[float, float] | None = None) -> "View":
        known = ranges.get(f"/{contents[0]}")
        span = span if known is None else decades(*known)
        return rrb.TimeSeriesView(
            origin="/",
            name=name,
            axis_y=None if span is None else rrb.ScalarAxis(range=span),
            contents=[f"/{path}/**" for path in contents],
            plot_legend=rrb.PlotLegend(rrb.Corner2D.LeftTop, visible=legend),
        )

    def tabs(*views: "View") -> "View":
        return rrb.Tabs(*views, active_tab=0) if len(views) > 1 else views[0]

    few = stage.count == 1
    errors = [plot("Boundary error, log10 [1/m]", "error/boundary_log10"), plot("linear", "error/boundary")]
    if ranges and "/error/boundary_log10" not in ranges:
        errors = [plot("Boundary error [1/m]", "error/boundary"), errors[0]]  # zero all along, which has no logarithm
    elif stage.blocks:
        errors.insert(0, plot(f"Error {stage.split}, log10 [1/m]", "error/blocks_log10", legend=few))
    conditioning = tabs(
        plot("Condition, log10", "conditioning/condition_log10"),
        plot("\u03c3 min, log10", "conditioning/smallest_singular_value_log10"),
    )
    effort = plot("Iterations, integrations", "solver/iterations", "solver/integrations", legend=few)
    if stage.measured:
        linear = plot("Time per sample [ms]", "solver/step_time_ms")
        effort = tabs(plot("Time per sample, log10 [ms]", "solver/step_time_ms_log10"), linear, effort)
    actuation = [plot(f"{spec.name} [{spec.unit}]", f"inputs/{spec.name}", legend=few) for spec in stage.given]
    if stage.lines:
        actuation += [
            plot("Line tension [N]", "lines/tension", legend=few),
            plot("Line length [mm]", "lines/length_mm", legend=few),
        ]
    cells = [tabs(*errors), conditioning, effort]
    if stage.reference:
        cells.insert(1, tabs(plot("Tip error, log10 [mm]", "error/tip_mm_log10"), plot("linear", "error/tip_mm")))
    if actuation:
        cells.append(tabs(*actuation))
    if _told(stage, "limits"):
        cells.insert(0, plot("Limits, 0 low to 1 high", "task/limits", legend=few, span=(0.0, 1.0)))
    if _told(stage, "target_error"):
        error = "task/target_error_mm"
        cells.insert(0, tabs(plot("Target error, log10 [mm]", f"{error}_log10"), plot("linear", error)))
    rows = [rrb.Horizontal(*cells[k : k + 2]) if cells[k + 1 :] else cells[k] for k in range(0, len(cells), 2)]
    return rrb.Vertical(*rows, _along(stage), row_shares=[3] * len(rows) + [3], name="Plots")


def decades(low: float, high: float) -> tuple[float, float]:
    """Limits of an axis of logarithms: the viewer numbers each decade where it shows few, else each tenth one."""
    low, high = math.floor(max(low, _LOWEST) + 1e-6), math.ceil(max(high, _LOWEST) - 1e-6)
    if high - low > _DECADES:
        return 10.0 * math.floor(low / 10), 10.0 * math.ceil(high / 10)
    middle = 0.5 * (low + high)
    return min(low, math.floor(middle - 1)), max(high, math.ceil(middle + 1))


def _along(stage: Stage) -> "rrb.Tabs":
    """Tabs of what is drawn along the arclength."""
    import rerun.blueprint as rrb

    w, h = PLOT_WIDTH, 0.5 * PLOT_HEIGHT
    bounds = rrb.VisualBounds2D(x_range=(-0.12 * w, 1.3 * w), y_range=(-1.3 * h, 1.6 * h))
    views = [
        rrb.Spatial2DView(
            origin=f"/{profile.name}",
            name=f"{profile.name.capitalize()} [{profile.unit}]",
            visual_bounds=bounds,
        )
        for profile in stage.profiles
    ]
    return rrb.Tabs(*views, active_tab=0)


def _span(values: Sequence[Any]) -> str:
    flat = np.concatenate([np.ravel(value) for value in values])
    low, high = float(flat.min()), float(flat.max())
    return f"{low:.4g}" if low == high else f"{low:.4g} to {high:.4g}"
