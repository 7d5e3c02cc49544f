"""What does not change with time: frames, colours, thicknesses, and the names of series."""

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from multirod.models.assemblies.network import Network
from multirod.recording.columns import rgba
from multirod.recording.figure import PALETTE, PLATFORM_COLOR
from multirod.recording.layout import PLOT_HEIGHT, PLOT_WIDTH, legend
from multirod.recording.profiles import Profile
from multirod.recording.stage import Stage
from multirod.status import Status

if TYPE_CHECKING:
    from rerun import SeriesLines

_AXIS_COLORS = (0xFF6B6B, 0x69DB7C, 0x74A9FF)
_REFERENCE_COLOR = 0xB0B8C4
_AXIS_LINE_COLOR = 0x8A929C
_STATUS_COLORS = {
    Status.NOT_RUN: 0x868E96,
    Status.CONVERGED: 0x2F9E44,
    Status.TRACKING: 0x1C7ED6,
    Status.NEAR_FOLD: 0xF08C00,
    Status.EULER_LIMIT: 0xE8590C,
    Status.LOWEST_ENERGY: 0x66A80F,
    Status.MULTIPLE_SHOOTING: 0x0CA678,
    Status.BIFURCATED: 0xBE4BDB,
    Status.SNAPPED: 0x7048E8,
    Status.DAMPED: 0x9775FA,
    Status.REACHED: 0x2F9E44,
    Status.AT_LIMIT: 0xF08C00,
    Status.OFF_TARGET: 0xF08C00,
    Status.SINGULAR_PIVOT: 0xE8590C,
    Status.UNSTABLE_COUPLING: 0xE8590C,
}
TARGET_COLOR = 0xFFB74D
_MEASURED_COLOR = 0xE040FB
_FAILURE_COLOR = 0xE03131
_FAILURE_TEXT_COLOR = 0xFF8787
_FADED_COLOR = 0x5C636B
_NAMED = 8  # rods whose names have room beside a plot
_SERIES = {
    "/error/boundary": ("boundary error [1/m]", 0xF06292),
    "/error/boundary_log10": ("log10 boundary error [1/m]", 0xF06292),
    "/error/tip_mm": ("tip error [mm]", 0xFFB74D),
    "/error/tip_mm_log10": ("log10 tip error [mm]", 0xFFB74D),
    "/task/target_error_mm": ("distance from the target [mm]", TARGET_COLOR),
    "/task/target_error_mm_log10": ("log10 distance from the target [mm]", TARGET_COLOR),
    "/conditioning/condition": ("condition number", 0xBA9CFF),
    "/conditioning/condition_log10": ("log10 condition number", 0xBA9CFF),
    "/conditioning/smallest_singular_value": ("smallest singular value", 0x4DB6AC),
    "/conditioning/smallest_singular_value_log10": ("log10 smallest singular value", 0x4DB6AC),
    "/solver/step_time_ms": ("time per sample [ms]", 0x81C784),
    "/solver/step_time_ms_log10": ("log10 time per sample [ms]", 0x81C784),
    "/solver/iterations": ("iterations", 0x4FC3F7),
    "/solver/integrations": ("integrations", 0xFFF176),
}

Styled = Iterator[tuple[str, list[Any]]]


def styles(stage: Stage) -> Styled:
    """Entities with their static components."""
    import rerun as rr

    yield "/world", [rr.ViewCoordinates.RIGHT_HAND_Z_UP]
    length = (0.12 if len(stage.bases) == 1 else 0.06) * stage.size
    for path, pose in stage.bases.items():
        yield path, [rr.Transform3D(translation=pose[:3, 3], mat3x3=pose[:3, :3]), rr.TransformAxes3D(length)]
    names = [status.name for status in Status if status is not Status.NOT_RUN]
    colors = _colors([_STATUS_COLORS.get(Status[name], _FAILURE_COLOR) for name in names])
    for k in range(stage.count):
        yield stage.scalar("/status", k), [rr.StateConfiguration(values=names, labels=names, colors=colors)]
        yield from _scene(stage, k)
        yield from _series(stage, k)
        for profile in stage.profiles:
            yield from _along(stage, profile, k)
    for profile in stage.profiles:
        yield from _axes(stage, profile)
    yield from scales(stage)


def scales(stage: Stage) -> Styled:
    """What changes where larger loads come than were known."""
    import rerun as rr

    yield "/legend", [rr.TextDocument(legend(stage), media_type=rr.MediaType.MARKDOWN)]
    for k in range(stage.count):
        for load in stage.loads:
            arrow = rr.Arrows3D.from_fields(radii=rr.Radius.ui_points(3.0), colors=rgba(load.color))
            scale = rr.InstancePoses3D(scales=[[stage.scales[load.kind]] * 3])
            yield stage.load(k, load), [arrow, scale]
            if stage.remarks is not None and load.name in stage.remarks.covariances:
                shown = rr.Ellipsoids3D.from_fields(
                    fill_mode=rr.components.FillMode.TransparentFillMajorWireframe, colors=rgba(load.color, 0x50)
                )
                yield f"{stage.load(k, load)}/spread", [shown, scale]


def _scene(stage: Stage, k: int) -> Styled:
    import rerun as rr

    stroke = 0.0015 * stage.size
    for index, rod in enumerate(stage.rods):
        color = rgba(stage.rod_color(k, index))
        own = None if stage.coloring else color
        yield stage.rod("rods", k, index), [rr.Capsules3D.from_fields(fill_mode=rr.components.FillMode.Solid, colors=own)]
        yield stage.rod("names", k, index), [rr.Points3D.from_fields(radii=0.0, colors=color, labels=stage.label(k, index))]
        faded = rr.LineStrips3D.from_fields(radii=0.8 * rod.radius, colors=rgba(_FADED_COLOR))
        yield stage.rod("failed/rods", k, index), [faded]
    for index, rod in enumerate(stage.reference_rods):
        grey = rr.LineStrips3D.from_fields(radii=0.4 * rod.radius, colors=rgba(_REFERENCE_COLOR, 0xC0))
        yield stage.rod("reference/rods", k, index), [grey]
    yield stage.world("failed/status", k), [rr.Points3D.from_fields(radii=0.0, colors=rgba(_FAILURE_TEXT_COLOR))]
    yield stage.world("tip_path", k), [rr.LineStrips3D.from_fields(radii=stroke, colors=rgba(0xFFFFFF, 0x90))]
    if stage.remarks is not None and stage.remarks.target is not None:
        point = rr.Points3D.from_fields(radii=rr.Radius.ui_points(6.0), colors=rgba(TARGET_COLOR))
        yield stage.world("target", k), [point]
        path = rr.LineStrips3D.from_fields(radii=0.6 * stroke, colors=rgba(TARGET_COLOR, 0xA0))
        yield stage.world("target_path", k), [path]
    if stage.remarks is not None and stage.remarks.measured is not None:
        point = rr.Points3D.from_fields(radii=rr.Radius.ui_points(9.0), colors=rgba(_MEASURED_COLOR))
        yield stage.world("measured", k), [point]
    grey = rr.LineStrips3D.from_fields(radii=0.6 * stroke, colors=rgba(_REFERENCE_COLOR))
    yield stage.world("reference/tip_path", k), [grey]
    for index, line in enumerate(stage.lines):
        strip, solid = rr.LineStrips3D.from_fields(radii=stroke), rr.components.FillMode.Solid
        yield stage.line(k, index), [rr.Capsules3D.from_fields(fill_mode=solid) if line.radius else strip]
    for index, carrier in enumerate(stage.assembly.rods):
        if carrier.discs:
            rim = rr.LineStrips3D.from_fields(radii=0.5 * stroke, colors=rgba(PLATFORM_COLOR))
            yield stage.rod("discs", k, index), [rim]
    for body in stage.bodies:
        yield stage.body(k, body), [rr.Mesh3D.from_fields(albedo_factor=rgba(PLATFORM_COLOR, 0xB0))]
        if body.name:
            said = body.name if stage.labelled and len(stage.bodies) <= _NAMED else ""
            words = rr.Points3D.from_fields(radii=0.0, colors=rgba(PLATFORM_COLOR), labels=said)
            yield f"{stage.body(k, body)}/name", [words]


def _series(stage: Stage, k: int) -> Styled:
    import rerun as rr

    who = f"instance {k}: " if stage.batched else ""
    for path, (name, color) in _SERIES.items():
        shade = PALETTE[k % len(PALETTE)] if stage.batched else color
        yield stage.scalar(path, k), [rr.SeriesLines(names=who + name, colors=rgba(shade), widths=1.5)]
    for path in ("/error/blocks", "/error/blocks_log10") if stage.blocks else ():
        names = [f"{who}{part.name}" for part in stage.blocks]
        yield stage.scalar(path, k), [_lines(names, [part.color for part in stage.blocks])]
    for path in ("/lines/tension", "/lines/length_mm") if stage.lines else ():
        names = [f"{who}{line.name}" for line in stage.lines]  # the plot's title says what, and in which unit
        yield stage.scalar(path, k), [_lines(names, [PALETTE[i % len(PALETTE)] for i in range(len(names))])]
    if stage.remarks is not None and stage.remarks.limits is not None:
        names = [f"{who}{name}" for name in stage.remarks.limit_names]
        yield stage.scalar("/task/limits", k), [_lines(names, [PALETTE[i % len(PALETTE)] for i in range(len(names))])]
    for spec in stage.assembly.input_specs:
        labels, shades = ["x", "y", "z"], list(_AXIS_COLORS)
        if spec.per_rod:
            labels = [rod.name for rod in stage.rods]
            shades = [rod.color for rod in stage.rods]
        places = stage.assembly.vectors_on(spec) if isinstance(stage.assembly, Network) else ()
        if places:
            labels = [f"{place} {axis}" for place in places for axis in "xyz"] if len(places) > 1 else labels
            shades = [PALETTE[i % len(PALETTE)] for i in range(len(labels))] if len(places) > 1 else shades
        elif isinstance(stage.assembly, Network) and spec.name in stage.assembly.coordinate_names:
            labels = list(stage.assembly.coordinate_names[spec.name])
            shades = [PALETTE[i % len(PALETTE)] for i in range(len(labels))]
        elif spec.count is not None:
            labels = [line.name for line in stage.driven_by(spec.name)]
            shades = [PALETTE[stage.lines.index(line) % len(PALETTE)] for line in stage.driven_by(spec.name)]
        names = [f"{who}{label}" for label in labels]
        yield stage.scalar(f"/inputs/{spec.name}", k), [_lines(names, shades)]


def _lines(names: list[str], colors: list[int]) -> "SeriesLines":
    import rerun as rr

    return rr.SeriesLines(names=names, colors=_colors(colors), widths=[1.5] * len(names))


def _along(stage: Stage, profile: Profile, k: int) -> Styled:
    import rerun as rr

    for index in range(len(stage.rods)):
        parts = stage.by_component and not profile.positive
        shades = _AXIS_COLORS if parts else (stage.rod_color(k, index),)
        lines = rr.LineStrips2D.from_fields(radii=rr.Radius.ui_points(1.0), colors=_colors(shades))
        yield stage.profile(profile.name, k, index), [lines]


def _axes(stage: Stage, profile: Profile) -> Styled:
    """The frame of a plot, and what its colours are, beside it."""
    import rerun as rr

    w, h = PLOT_WIDTH, 0.5 * PLOT_HEIGHT
    parts = stage.by_component and not profile.positive
    frame = [(0.0, -h), (0.0, h), (w, h), (w, -h), (0.0, -h)]
    lines = [frame, [(0.0, 0.0), (w, 0.0)]] if parts else [frame]
    yield f"/{profile.name}/axes", [rr.LineStrips2D(lines, radii=rr.Radius.ui_points(0.5), colors=rgba(_AXIS_LINE_COLOR))]
    labels, shades = [rod.name for rod in stage.rods], [rod.color for rod in stage.rods]
    if parts:
        labels, shades = [f"{profile.letter}_{axis}" for axis in "xyz"], list(_AXIS_COLORS)
    elif stage.batched and len(stage.rods) == 1:
        labels = [f"instance {k}" for k in range(stage.count)]
        shades = [stage.rod_color(k, 0) for k in range(stage.count)]
    if 1 < len(labels) <= _NAMED:
        places = [(1.05 * w + 0.14 * w * (i // 4), h * (0.55 * (i % 4) - 0.85)) for i in range(len(labels))]
        names = rr.Points2D(places, labels=labels, colors=_colors(shades), radii=[0.0] * len(labels), show_labels=True)
        yield f"/{profile.name}/names", [names]


def _colors(values: Sequence[int]) -> NDArray[np.uint32]:
    """Not a list: the viewer's library takes three numbers for one colour."""
    return np.array([rgba(value) for value in values], dtype=np.uint32)
