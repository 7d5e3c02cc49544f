"""Rows of a recording: samples turned into columns of its entities."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from multirod.recording import columns, layout
from multirod.recording.columns import rgba
from multirod.recording.figure import discs
from multirod.recording.layout import PLOT_HEIGHT, PLOT_WIDTH
from multirod.recording.stage import LOADS, Stage, load, round_up
from multirod.recording.style import styles
from multirod.solution import History
from multirod.status import Status
from multirod.validation import FloatArray

_ROWS = 1000


class Writer:
    """Turns blocks of samples into columns. ``prepare`` comes first: it sets the stage and makes the layout."""

    _stage: Stage

    def __init__(self, streams: Sequence[Any], *, node_count: int, instances: int, force_scale: float | None, live: bool) -> None:
        self._streams = streams
        self._node_count = node_count
        self._instances = instances
        self._force_scale = force_scale
        self._live = live
        self._last_tip: dict[str, FloatArray] = {}
        self._last_value: dict[str, Any] = {}
        self._curvature_limit = 0.0
        self._arclength_limit = 0.0

    def prepare(self, block: History, reference: History | None, title: str, solver: str, total: int) -> Any:
        """Set the stage by the first block, and return the layout."""
        self._stage = Stage.of(
            block,
            reference,
            node_count=self._node_count,
            instances=self._instances,
            force_scale=self._force_scale,
            live=self._live,
        )
        self._description = layout.description(self._stage, title, solver, total)
        return layout.blueprint(self._stage)

    def write_static(self) -> None:
        """Write what does not change with time."""
        import rerun as rr

        text = rr.TextDocument(self._description, media_type=rr.MediaType.MARKDOWN)
        for path, archetypes in (("/description", [text]), *styles(self._stage)):
            for stream in self._streams:
                stream.log(path, *archetypes, static=True)

    def write(self, block: History, reference: History | None, steps: NDArray[np.int64]) -> None:
        """Send the samples of ``block``; columns of at most 1000 rows, so that the viewer loads what it shows."""
        stage, samples = self._stage, len(block.time)
        sources = [("", block)] if reference is None else [("", block), ("reference/", reference)]
        shapes = {kind: [self._shape(source, rod, samples) for rod in range(len(stage.rods))] for kind, source in sources}
        lines = [self._line(block, line, samples) for line in range(len(stage.lines))]
        rims = [self._rims(block, rod, samples) for rod in range(len(stage.rods))]
        tension = np.reshape(block.tension, (samples, -1, len(stage.lines))) if stage.lines else np.zeros((samples, 0, 0))
        tips = {kind: np.reshape(source.tip_position, (samples, -1, 3)) for kind, source in sources}
        rotations = np.reshape(block.tip_rotation, (samples, -1, 3, 3))
        scalars = _scalars(stage, block, tips)
        loads = _loads(block, tips[""], rotations)
        statuses = np.reshape(np.asarray(block.status), (samples, -1))
        self._write_curvature_axes(shapes[""], block.time, steps)
        for start in range(0, samples, _ROWS):
            rows = slice(start, start + _ROWS)
            index = columns.index(steps[rows], block.time[rows])
            for k in range(stage.count):
                for i, shape in enumerate(shapes[""]):
                    self._send(stage.rod("rods", k, i), index, columns.capsules(shape["position"][rows, k], stage.rods[i].radius))
                    self._write_curvature(k, i, index, shape["arclength"][rows, k], shape["curvature"][rows, k])
                for i, shape in enumerate(shapes.get("reference/", [])):
                    self._send(stage.rod("reference/rods", k, i), index, columns.strips(shape["position"][rows, k]))
                for i, nodes in enumerate(lines):
                    self._write_line(k, i, index, nodes[rows, k], tension[rows, k, i])
                for i, circles in enumerate(rims):
                    if circles.size:
                        self._send(stage.rod("discs", k, i), index, columns.strips(circles[rows, k]))
                self._write_tip(k, steps[rows], block.time[rows], tips[""][rows, k], rotations[rows, k])
                for kind, positions in tips.items():
                    self._write_path(stage.world(f"{kind}tip_path", k), index, positions[rows, k])
                for name, (origins, force) in loads.items():
                    self._write_arrows(stage.world(f"loads/{name}", k), index, origins[rows, k], force[rows, k])
                for path, values in scalars.items():
                    self._send_scalars(stage.scalar(path, k), index, values[rows, k])
                self._write_status(stage.scalar("/status", k), steps[rows], block.time[rows], statuses[rows, k])

    def _shape(self, source: History, rod: int, samples: int) -> dict[str, FloatArray]:
        """Shape of a rod with axes (sample, instance, node, ...)."""
        values = vars(source.rod(rod, nodes=self._node_count))
        tails = {"arclength": 1, "position": 2, "rotation": 3, "curvature": 2}
        return {name: values[name].reshape(samples, -1, *values[name].shape[-tail:]) for name, tail in tails.items()}

    def _line(self, source: History, line: int, samples: int) -> FloatArray:
        """Nodes of a line, axes (sample, instance, node, 3): not finite where it is not."""
        position = source.line(line, nodes=self._node_count).position
        return position.reshape(samples, -1, *position.shape[-2:])

    def _rims(self, source: History, rod: int, samples: int) -> FloatArray:
        """Rims of a rod's discs, axes (sample, instance, disc, node, 3), between nodes as if straight."""
        places, radius = discs(source.assembly.rods[rod])
        if not places.size:
            return np.zeros((samples, 0))
        shape = self._shape(source, rod, samples)
        shift = np.broadcast_to(source.inputs.translation[..., rod], source.batch_shape).reshape(samples, -1)
        s = places + shift[..., None]
        whole = (self._node_count - 1) * s / shape["arclength"][..., -1:]
        inside = (whole >= 0) & (whole <= self._node_count - 1 + 1e-9)
        below = np.clip(np.nan_to_num(whole).astype(int), 0, self._node_count - 2)[..., None]
        part = (whole[..., None] - below) / np.where(inside, 1.0, np.nan)[..., None]

        def between(values: FloatArray) -> FloatArray:
            flat = values.reshape(*values.shape[:3], -1)
            one, next_one = (np.take_along_axis(flat, below + k, axis=2) for k in (0, 1))
            return np.asarray((1 - part) * one + part * next_one).reshape(*s.shape, *values.shape[3:])

        return columns.circles(between(shape["position"]), between(shape["rotation"]), radius)

    def _write_line(self, k: int, line: int, index: Any, nodes: FloatArray, tension: FloatArray) -> None:
        path, shades, radius = (
            self._stage.line(k, line),
            columns.shades(tension, self._stage.strongest),
            self._stage.lines[line].radius,
        )
        if radius:
            self._send(path, index, columns.capsules(nodes, radius, shades))
        else:
            pieces = np.stack([nodes[:, :-1], nodes[:, 1:]], axis=2)
            self._send(path, index, columns.strips(pieces, shades))

    def _write_tip(self, k: int, steps: NDArray[np.int64], times: FloatArray, position: FloatArray, rotation: FloatArray) -> None:
        import rerun as rr

        index = columns.index(steps, times)
        frames, sound = columns.poses(position, rotation)
        axes = rr.TransformAxes3D.columns(axis_length=np.where(sound, 0.1 * self._stage.size, 0.0))
        self._send(self._stage.world("tip", k), index, [*frames, *axes])
        if self._stage.platforms:
            path = self._stage.world("platform", k)
            self._send(path, index, frames)
            changed = self._changed(path, sound)
            if changed.any():
                mesh = columns.plates(self._stage.platforms[k], sound[changed])
                self._send(path, columns.index(steps[changed], times[changed]), mesh)

    def _write_path(self, path: str, index: Any, positions: FloatArray) -> None:
        before = np.concatenate([self._last_tip.get(path, positions[:1]).reshape(1, 3), positions[:-1]])
        self._last_tip[path] = positions[-1]
        self._send(path, index, columns.strips(np.stack([before, positions], axis=1)))

    def _write_arrows(self, path: str, index: Any, origins: FloatArray, force: FloatArray) -> None:
        import rerun as rr

        sound = np.isfinite(origins).all(axis=1) & np.isfinite(force).all(axis=1) & (np.abs(force).max(axis=1) > 0)
        vectors = self._stage.force_scale * force[sound]
        self._send(path, index, rr.Arrows3D.columns(vectors=vectors, origins=origins[sound]).partition(sound.astype(int)))

    def _write_status(self, path: str, steps: NDArray[np.int64], times: FloatArray, codes: NDArray[Any]) -> None:
        import rerun as rr

        names = np.array([Status(int(code)).name for code in codes])
        changed = self._changed(path, names)
        if changed.any():
            states = rr.StateChange.columns(state=names[changed].tolist())
            self._send(path, columns.index(steps[changed], times[changed]), states)

    def _changed(self, path: str, values: NDArray[Any]) -> NDArray[np.bool_]:
        """Rows that differ from the one before, which may be of an earlier call."""
        changed = np.concatenate([[values[0] != self._last_value.get(path)], values[1:] != values[:-1]])
        self._last_value[path] = values[-1]
        return changed

    def _write_curvature_axes(self, shapes: Sequence[dict[str, FloatArray]], times: FloatArray, steps: NDArray[np.int64]) -> None:
        """Choose the plot's scales, anew where values outgrow them; the tick labels are data, so each row has its own."""
        import rerun as rr

        curvature = [self._drawn_curvature(shape["curvature"]) for shape in shapes]
        largest = max((float(np.nanmax(np.abs(c), initial=0.0)) for c in curvature if np.isfinite(c).any()), default=0.0)
        reach = max(
            (float(np.nanmax(s["arclength"], initial=0.0)) for s in shapes if np.isfinite(s["arclength"]).any()), default=0.0
        )
        if self._curvature_limit and largest <= self._curvature_limit and reach <= self._arclength_limit:
            return
        margin = 1.5 if self._live else 1.05
        self._curvature_limit = max(self._curvature_limit, round_up(margin * largest) if largest > 0 else 1.0)
        self._arclength_limit = max(self._arclength_limit, round_up((1.1 if self._live else 1.0) * reach) if reach > 0 else 1.0)
        w, h = PLOT_WIDTH, 0.5 * PLOT_HEIGHT
        left = -0.05 * w
        positions = [(left, -1.3 * h), (left, -0.3 * h), (left, 0.7 * h), (1.06 * w, -0.3 * h)]
        top = self._curvature_limit
        ticks = (top, 0.0, -top) if self._stage.by_component else (top, 0.5 * top, 0.0)
        labels = [*(f"{tick:g}" for tick in ticks), f"s = {self._arclength_limit:g} m"]
        colors = np.full(len(labels), rgba(0xDEE2E6), dtype=np.uint32)
        points = rr.Points2D.columns(positions=positions, labels=labels, colors=colors, radii=[0.0] * len(labels))
        self._send("/curvature/axes/labels", columns.index(steps[:1], times[:1]), points.partition([len(labels)]))

    def _write_curvature(self, k: int, rod: int, index: Any, arclength: FloatArray, curvature: FloatArray) -> None:
        values = self._drawn_curvature(curvature) / self._curvature_limit
        x = PLOT_WIDTH / self._arclength_limit * arclength
        y = PLOT_HEIGHT * (-0.5 * values if self._stage.by_component else 0.5 - values)  # 2D views point down
        strips = np.stack([np.broadcast_to(x[..., None], y.shape), y], axis=-1)
        self._send(self._stage.curvature(k, rod), index, columns.strips(np.moveaxis(strips, 2, 1)))

    def _drawn_curvature(self, curvature: FloatArray) -> FloatArray:
        return curvature if self._stage.by_component else np.linalg.norm(curvature[..., :2], axis=-1, keepdims=True)

    def _send(self, path: str, index: Any, values: Any) -> None:
        for stream in self._streams:
            stream.send_columns(path, index, values)

    def _send_scalars(self, path: str, index: Any, values: FloatArray) -> None:
        import rerun as rr

        self._send(path, index, rr.Scalars.columns(scalars=np.ascontiguousarray(values)))


def _scalars(stage: Stage, block: History, tips: dict[str, FloatArray]) -> dict[str, FloatArray]:
    """Series by entity, axes (sample, instance[, component])."""

    def split(values: Any, *tail: int) -> FloatArray:
        return np.reshape(np.asarray(values, dtype=np.float64), (len(block.time), -1, *tail))

    residual, condition, least = split(block.residual), split(block.condition), split(block.smallest_singular_value)
    values = {
        "/error/boundary": residual,
        "/error/boundary_log10": columns.log10(residual),
        "/conditioning/condition": condition,
        "/conditioning/condition_log10": columns.log10(condition),
        "/conditioning/smallest_singular_value": least,
        "/conditioning/smallest_singular_value_log10": columns.log10(least),
        "/solver/iterations": split(block.iterations),
        "/solver/integrations": split(block.integrations),
    }
    if stage.lines:
        values["/lines/tension"] = split(block.tension, len(stage.lines))
        values["/lines/length_mm"] = 1e3 * split(block.line_length, len(stage.lines))
    if stage.blocks:
        every = split(block.boundary_residual, block.unknown_count)
        parts = [np.abs(every[..., part.residuals]).max(axis=-1) for part in stage.blocks]
        values["/error/blocks"] = np.stack(parts, axis=-1)
        values["/error/blocks_log10"] = columns.log10(values["/error/blocks"])
    if np.isfinite(block.step_time).any():
        values["/solver/step_time_ms"] = np.broadcast_to(1e3 * block.step_time[:, None], residual.shape)
        values["/solver/step_time_ms_log10"] = columns.log10(values["/solver/step_time_ms"])
    if "reference/" in tips:
        error = 1e3 * np.linalg.norm(tips[""] - tips["reference/"], axis=-1)
        values["/error/tip_mm"] = error
        values["/error/tip_mm_log10"] = columns.log10(error)
    for name in block.inputs.given:
        if block.inputs.profile(name) is None:
            value = getattr(block.inputs, name)
            width = value.shape[-1]
            values[f"/inputs/{name}"] = split(np.broadcast_to(value, (*block.batch_shape, width)), width)
    return values


def _loads(block: History, tips: FloatArray, rotations: FloatArray) -> dict[str, tuple[FloatArray, FloatArray]]:
    """Where each force that was given acts, and the force, both in the world, axes (sample, instance, 3)."""

    def vectors(name: str) -> FloatArray:
        return np.broadcast_to(load(block.inputs, name), (*block.batch_shape, 3)).reshape(tips.shape)

    origins = tips + np.einsum("tkij,tkj->tki", rotations, vectors("force_point"))
    loads = {name: (origins, vectors(name)) for name in LOADS if name in block.inputs.given}
    if "follower_force" in loads:
        loads["follower_force"] = origins, np.einsum("tkij,tkj->tki", rotations, loads["follower_force"][1])
    return loads
