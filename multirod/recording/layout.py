"""What a recording opens with: a description of the run, and the layout of the views."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from multirod.recording.columns import rgba
from multirod.recording.stage import LOADS, Stage

# The curvature plot in its own units: 2D views keep the aspect ratio, so arclength and curvature are both scaled to fit.
PLOT_WIDTH, PLOT_HEIGHT = 6.0, 1.0


def description(stage: Stage, title: str, solver: str, total: int) -> str:
    """What was run, units and scales, as Markdown; of ``total`` instances."""
    lines = [f"### {title}", "", f"**Robot** `{stage.assembly!r}`  "]
    lines += [f"**Solver** `{solver}`  "] if solver else []
    lines += [f"**Batch** the first {stage.count} of {total} instances  "] if total > stage.count else []
    lines += [
        f"**Shape** grid {1e3 * stage.grid:g} mm; frames x red, y green, z blue at base and tip; white: path of the tip up to "
        "the cursor" + ("; grey: the reference" if stage.reference else "") + "  ",
    ]
    if stage.live or any(spec.name in LOADS for spec in stage.given):
        scale = f"1 N is {1e3 * stage.force_scale:g} mm"
        lines += [f"**Arrows** {scale}; yellow `tip_force`, orange `follower_force`; each begins where it acts  "]
    if stage.lines:
        lines += [f"**Lines** red pulls, blue pushes, in full at {stage.strongest:g} N; grey hangs loose  "]
    lines += [
        "",
        "| rod | length [m] | bending stiffness [N m^2] | torsional stiffness [N m^2] | drawn diameter [mm] |",
        "|---|---|---|---|---|",
    ]
    for index, rod in enumerate(stage.assembly.rods[:24]):
        bending = _span([section.bending_stiffness for section in rod.sections])
        torsion = _span([section.torsional_stiffness for section in rod.sections])
        drawn = f"{2e3 * stage.rods[index].radius:.3g}"
        if rod.outer_diameter is None:
            drawn += " (not given)"
        elif stage.rods[index].radius > 0.51 * rod.outer_diameter:
            drawn += f" (is {1e3 * rod.outer_diameter:.3g})"
        lines.append(f"| {stage.rods[index].name} | {_span([rod.length])} | {bending} | {torsion} | {drawn} |")
    lines += [
        "",
        "**Plots** "
        + ("Instances are coloured as their rods. " if stage.batched and len(stage.rods) == 1 else "")
        + "Vectors: x red, y green, z blue. Boundary error: what the solver drives to zero [1/m]. "
        + ("By leg: coloured as the legs, light grey the platform's balance. " if stage.blocks else "")
        + ("Tip error: distance from the reference's tip [mm]. " if stage.reference else "")
        + "Gamma: the scaled Jacobian; its smallest singular value vanishes at a fold. Curvature: at the cursor, "
        + ("in the body frame." if stage.by_component else "magnitude of bending, coloured as the rods."),
        "",
        "**Status** of each sample; a failed one has no shape and gaps in the plots.",
    ]
    return "\n".join(lines)


def scene_view(stage: Stage, name: str, **options: Any) -> Any:
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
        **options,
    )


def blueprint(stage: Stage) -> Any:
    """The views that a recording opens with."""
    import rerun.blueprint as rrb

    up_to_now = rrb.VisibleTimeRanges(
        [
            rrb.VisibleTimeRange(name, start=rrb.TimeRangeBoundary.infinite(), end=rrb.TimeRangeBoundary.cursor_relative(**zero))
            for name, zero in (("time", {"seconds": 0.0}), ("step", {"seq": 0}))
        ]
    )
    paths = [stage.world(f"{kind}tip_path", k) for kind in ("", "reference/") for k in range(stage.count)]
    scene = scene_view(stage, "Shape", overrides={path: [up_to_now] for path in paths})

    def plot(name: str, *contents: str, legend: bool = False) -> Any:
        return rrb.TimeSeriesView(
            origin="/",
            name=name,
            contents=[f"/{path}/**" for path in contents],
            plot_legend=rrb.PlotLegend(rrb.Corner2D.LeftTop, visible=legend),
        )

    def tabs(*views: Any) -> Any:
        return rrb.Tabs(*views, active_tab=0) if len(views) > 1 else views[0]

    w, h = PLOT_WIDTH, 0.5 * PLOT_HEIGHT
    bounds = rrb.VisualBounds2D(x_range=(-0.1 * w, 1.12 * w), y_range=(-1.35 * h, 1.35 * h))
    components = "u_x red, u_y green, u_z blue" if stage.by_component else "bending, magnitude"
    curvature = rrb.Spatial2DView(
        origin="/curvature", name=f"Curvature along the arclength [1/m]: {components}", visual_bounds=bounds
    )
    errors = [plot("Boundary error, log10 [1/m]", "error/boundary_log10"), plot("linear", "error/boundary")]
    if stage.blocks:
        errors.insert(0, plot("Boundary error by leg, log10 [1/m]", "error/blocks_log10"))
    boundary = tabs(*errors)
    conditioning = plot(
        "Gamma, log10: cond, \u03c3_min" if stage.batched else "Gamma, log10: cond violet, \u03c3_min teal",
        "conditioning/condition_log10",
        "conditioning/smallest_singular_value_log10",
    )
    count = plot("Iterations, integrations", "solver/iterations", "solver/integrations", legend=True)
    effort = count
    if stage.measured:
        linear = plot("Time per sample [ms]", "solver/step_time_ms")
        effort = tabs(plot("Time per sample, log10 [ms]", "solver/step_time_ms_log10"), linear, count)
    actuation = [
        plot(
            f"{spec.name} [{spec.unit}]",
            f"inputs/{spec.name}",
            legend=(spec.per_rod and len(stage.rods) > 1) or (spec.count or 0) > 1,
        )
        for spec in stage.given
    ]
    if stage.lines:
        several = len(stage.lines) > 1
        actuation += [
            plot("Tension [N]", "lines/tension", legend=several),
            plot("Line length [mm]", "lines/length_mm", legend=several),
        ]
    text = rrb.TextDocumentView(origin="/description", name="Description")
    if stage.reference:
        tip = tabs(plot("Tip error, log10 [mm]", "error/tip_mm_log10"), plot("linear", "error/tip_mm"))
        rows = [tabs(text, *actuation), rrb.Horizontal(boundary, tip), rrb.Horizontal(conditioning, effort), curvature]
    else:
        fourth = [tabs(*actuation)] if actuation else []
        rows = [text, rrb.Horizontal(boundary, conditioning), rrb.Horizontal(effort, *fourth), curvature]
    right = rrb.Vertical(*rows, row_shares=[4.6, 3, 3, 2.7])
    lane = rrb.StateTimelineView(origin="/status", name="Status of each sample")
    return rrb.Blueprint(
        rrb.Vertical(rrb.Horizontal(scene, right, column_shares=[1, 1]), lane, row_shares=[6, 0.75 + 0.25 * stage.count]),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
        rrb.TimePanel(state="collapsed", timeline="time"),
        auto_layout=False,
        auto_views=False,
    )


def _span(values: Sequence[Any]) -> str:
    flat = np.concatenate([np.ravel(value) for value in values])
    low, high = float(flat.min()), float(flat.max())
    return f"{low:.4g}" if low == high else f"{low:.4g} to {high:.4g}"
