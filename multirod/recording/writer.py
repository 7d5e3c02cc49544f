"""Rows of a recording: samples turned into columns of its entities."""

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from textwrap import wrap
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from multirod.recording import columns, layout
from multirod.recording.along import AlongPlots
from multirod.recording.bodies import around, poses_of
from multirod.recording.coloring import Coloring
from multirod.recording.figure import discs
from multirod.recording.framing import Extent, Frame
from multirod.recording.loads import DrawnLoad, acting, arrow_ends, largest
from multirod.recording.stage import TIP_AXES, Stage, final_scale, frame_ends, given, live_scale, targets
from multirod.recording.style import scales, styles
from multirod.results.history import History
from multirod.results.remarks import Remarks
from multirod.results.strains import strains
from multirod.status import Status, failures, left_branch
from multirod.validation import FloatArray

if TYPE_CHECKING:
    from rerun.blueprint import Blueprint

    from multirod.recording.columns import Columns, Index, Send
    from multirod.recording.streams import Stream

_ROWS = 1000
_BEYOND = 1.15  # length of a body's axes over how far it reaches


class Writer:
    """Turns blocks of samples into columns. ``prepare`` comes first: it sets the stage and makes the layout.

    Args:
        streams: That take the columns.
        node_count: Nodes of a rod.
        instances: That are recorded.
        force_scale: Of arrows [m/N]; None to choose it.
        live: Whether samples come that nothing is known of yet.
        breathe: Called often, between short pieces of work.
    """

    stage: Stage

    def __init__(
        self,
        streams: "Sequence[Stream]",
        *,
        node_count: int,
        instances: int,
        force_scale: float | None,
        live: bool,
        breathe: Callable[[], None] = lambda: None,
    ) -> None:
        self._streams = streams
        self._node_count = node_count
        self._instances = instances
        self._force_scale = force_scale
        self._live = live
        self._breathe = breathe
        self._send = _sender(streams, breathe)
        self._last_tip: dict[str, FloatArray] = {}
        self._last_value: dict[str, Any] = {}
        self._last_sound: dict[int, list[FloatArray]] = {}
        self._extent = Extent(np.zeros((0, 3)))
        self._largest = {"force": 0.0, "moment": 0.0}
        self._ranges: dict[str, tuple[float, float]] = {}  # of what is plotted by its logarithm

    def prepare(
        self,
        block: History,
        reference: History | None,
        title: str,
        solver: str,
        total: int,
        *,
        reference_name: str = "",
        coloring: Coloring | None = None,
        remarks: Sequence[Remarks] = (),
    ) -> "Blueprint":
        """Set the stage by the first block, and return the layout."""
        self.stage = Stage.of(
            block,
            reference,
            node_count=self._node_count,
            instances=self._instances,
            force_scale=self._force_scale,
            live=self._live,
            reference_name=reference_name,
            coloring=coloring,
            remarks=remarks,
        )
        self._text = title, solver, total, _compared(block, reference)
        self._along = AlongPlots(self.stage, self._send)
        self._note_ranges(_scalars(self.stage, block, _tips(block, reference)) | _told(remarks))
        return layout.blueprint(self.stage, {} if self._live else self._ranges)

    def _note_ranges(self, scalars: dict[str, FloatArray]) -> None:
        for path, values in scalars.items():
            known = values[np.isfinite(values)] if path.endswith("_log10") else np.zeros(0)
            if known.size:
                low, high = self._ranges.get(path, (math.inf, -math.inf))
                self._ranges[path] = min(low, float(known.min())), max(high, float(known.max()))

    def write_static(self) -> None:
        """Write what does not change with time."""
        self._log(styles(self.stage))
        self._describe()

    def _log(self, entities: Iterable[tuple[str, list[Any]]]) -> None:
        for path, archetypes in entities:
            for stream in self._streams:
                stream.log(path, *archetypes, static=True)
            self._breathe()

    def _describe(self) -> None:
        import rerun as rr

        text = layout.description(self.stage, *self._text)
        self._log([("/description", [rr.TextDocument(text, media_type=rr.MediaType.MARKDOWN)])])

    def write(self, block: History, reference: History | None, steps: NDArray[np.int64], remarks: Sequence[Remarks] = ()) -> None:
        """Send the samples of ``block``; columns of at most 1000 rows, so that the viewer loads what it shows."""
        samples = len(block.time)
        sources = [("", block)] if reference is None else [("", block), ("reference/", reference)]
        shapes = {kind: self._shapes(source, samples) for kind, source in sources}
        tips = _tips(block, reference)
        if self._live:
            self._widen(block, shapes[""], remarks)
        self._breathe()
        stage = self.stage
        if any(profile.name == "difference" for profile in stage.profiles):
            _compare(shapes)
        lines = [self._line(block, line, samples) for line in range(len(stage.lines))]
        rims = [self._rims(block, rod, shape) for rod, shape in enumerate(shapes[""])]
        tension = np.reshape(block.tension, (samples, -1, len(stage.lines))) if stage.lines else np.zeros((samples, 0, 0))
        rotations = np.reshape(block.tip_rotation, (samples, -1, 3, 3))
        self._breathe()
        scalars = _scalars(stage, block, tips) | _told(remarks)
        self._breathe()
        loads = acting(block)
        bodies = [
            (position.reshape(samples, -1, 3), rotation.reshape(samples, -1, 3, 3))
            for position, rotation in (poses_of(body, block) for body in stage.bodies)
        ]
        statuses = np.reshape(np.asarray(block.status), (samples, -1))
        self._breathe()
        along = self._along.curves(shapes[""])
        self._note_ranges(scalars)
        self._breathe()
        for start in range(0, samples, _ROWS):
            rows = slice(start, start + _ROWS)
            index = columns.index(steps[rows], block.time[rows])
            self._along.write_limits(along, steps[rows], block.time[rows])
            for k in range(stage.count):
                shades = None if stage.coloring is None else stage.coloring.colors[steps[rows], k]
                for i, shape in enumerate(shapes[""]):
                    capsules = columns.capsules(shape["position"][rows, k], stage.rods[i].radius, shades)
                    self._send(stage.rod("rods", k, i), index, capsules)
                    self._write_name(k, i, index, shapes[""], rows)
                    self._along.write(along, k, i, index, rows)
                for i, shape in enumerate(shapes.get("reference/", [])):
                    self._send(stage.rod("reference/rods", k, i), index, columns.strips(shape["position"][rows, k]))
                for i, nodes in enumerate(lines):
                    self._write_line(k, i, index, nodes[rows, k], tension[rows, k, i])
                for i, circles in enumerate(rims):
                    if circles.size:
                        self._send(stage.rod("discs", k, i), index, columns.strips(circles[rows, k]))
                self._write_tip(k, index, tips[""][rows, k], rotations[rows, k])
                for i, (position, rotation) in enumerate(bodies):
                    self._write_body(k, i, steps[rows], block.time[rows], position[rows, k], rotation[rows, k])
                for kind, positions in tips.items():
                    self._write_path(stage.world(f"{kind}tip_path", k), index, positions[rows, k])
                for load, (origins, force) in loads.items():
                    self._write_arrows(k, load, index, origins[rows, k], force[rows, k])
                    if remarks and load.name in remarks[0].covariances:
                        spread = np.array([said.covariances[load.name] for said in remarks[rows]])
                        if load.name == "follower_force":
                            spread = rotations[rows, k] @ spread @ rotations[rows, k].swapaxes(1, 2)
                        self._write_spread(f"{stage.load(k, load)}/spread", index, force[rows, k], spread)
                if remarks and remarks[0].target is not None:
                    self._write_points(stage.world("target", k), index, targets(remarks[rows]))
                    self._write_path(stage.world("target_path", k), index, targets(remarks[rows]))
                if remarks and remarks[0].measured is not None:
                    self._write_points(stage.world("measured", k), index, np.array([said.measured for said in remarks[rows]]))
                for path, values in scalars.items():
                    self._send_scalars(stage.scalar(path, k), index, values[rows, k])
                self._write_status(stage.scalar("/status", k), steps[rows], block.time[rows], statuses[rows, k])
                nodes_of_rods = [shape["position"][rows, k] for shape in shapes[""]]
                self._write_failed(k, steps[rows], block.time[rows], statuses[rows, k], nodes_of_rods)

    def _widen(self, block: History, shapes: Sequence[dict[str, FloatArray]], remarks: Sequence[Remarks]) -> None:
        """Fit scale, frame and plots to what was not known when the stage was set."""
        before = self.stage
        self._largest = {kind: max(known, largest(block, kind)) for kind, known in self._largest.items()}
        wanted = {kind: live_scale(scale, self._largest[kind], before) for kind, scale in before.scales.items()}
        if self._force_scale is not None:
            wanted["force"] = before.force_scale
        for shape in shapes:
            self._extent.add(shape["position"])
        self._extent.add(targets(remarks))
        self._extent.add(around(before.bodies, block))
        self._extent.add(frame_ends(block, TIP_AXES * before.size))
        self._extent.add(arrow_ends(block, wanted))
        more = tuple(spec for spec in given(block) if spec not in before.given)
        self.stage = replace(before, **_scales(wanted), given=(*before.given, *more))
        frame = Frame.between(before.centre, before.eye)
        if not frame.shows(self._extent.points):
            self.stage = self.stage.seen_from(frame.widened(self._extent.points))
        if more or wanted != before.scales:
            self._log(scales(self.stage))
            self._describe()
        if more or self.stage.eye is not before.eye:
            blueprint = layout.blueprint(self.stage)
            for stream in self._streams:
                stream.send_blueprint(blueprint)

    def finish(self) -> "Blueprint":
        """Fit the scale of arrows to all that came, and return the layout that shows it."""
        size = max(self._extent.size, 0.5 * self.stage.size)
        fitted = {kind: final_scale(known, size) for kind, known in self._largest.items() if known > 0}
        if self._force_scale is not None:
            fitted.pop("force", None)
        if fitted:
            self.stage = replace(self.stage, **_scales(self.stage.scales | fitted))
            self._log(scales(self.stage))
            self._describe()
        bases = np.array([pose[:3, 3] for pose in self.stage.bases.values()])
        self._extent.add(bases)
        self.stage = self.stage.seen_from(Frame(self._extent.points))
        return layout.blueprint(self.stage, self._ranges)

    def _shapes(self, source: History, samples: int) -> list[dict[str, FloatArray]]:
        """Shapes of all rods with axes (sample, instance, node, ...)."""
        tails = {"arclength": 1, "position": 2, "rotation": 3, "curvature": 2, "moment": 2, "force": 2}
        shapes = []
        for rod in range(source.assembly.rod_count):
            shape = source.rod(rod, nodes=self._node_count)
            self._breathe()
            values = vars(shape)
            found = {name: values[name].reshape(samples, -1, *values[name].shape[-tail:]) for name, tail in tails.items()}
            if any(profile.name == "strain" for profile in self.stage.profiles) and source.assembly is self.stage.assembly:
                bending = 100 * strains(source, rod, shape)["bending"]
                found["strain"] = bending.reshape(samples, -1, bending.shape[-1], 1)
            shapes.append(found)
        return shapes

    def _line(self, source: History, line: int, samples: int) -> FloatArray:
        """Nodes of a line, axes (sample, instance, node, 3): not finite where it is not."""
        position = source.line(line, nodes=self._node_count).position
        return position.reshape(samples, -1, *position.shape[-2:])

    def _rims(self, source: History, rod: int, shape: dict[str, FloatArray]) -> FloatArray:
        """Rims of a rod's discs, axes (sample, instance, disc, node, 3), between nodes as if straight."""
        places, radius = discs(source.assembly.rods[rod])
        if not places.size:
            return np.zeros((len(source.time), 0))
        samples = len(source.time)
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

    def _write_line(self, k: int, line: int, index: "Index", nodes: FloatArray, tension: FloatArray) -> None:
        path, shades, radius = (
            self.stage.line(k, line),
            columns.shades(tension, self.stage.strongest),
            self.stage.lines[line].radius,
        )
        if radius:
            self._send(path, index, columns.capsules(nodes, radius, shades))
        else:
            pieces = np.stack([nodes[:, :-1], nodes[:, 1:]], axis=2)
            self._send(path, index, columns.strips(pieces, shades))

    def _write_tip(self, k: int, index: "Index", position: FloatArray, rotation: FloatArray) -> None:
        import rerun as rr

        frames, sound = columns.poses(position, rotation)
        axes = rr.TransformAxes3D.columns(
            axis_length=np.where(sound, (TIP_AXES if self.stage.labelled else 0.3 * TIP_AXES) * self.stage.size, 0.0)
        )
        self._send(self.stage.world("tip", k), index, [*frames, *axes])

    def _write_body(
        self, k: int, body: int, steps: NDArray[np.int64], times: FloatArray, position: FloatArray, rotation: FloatArray
    ) -> None:
        """A platform or a body, with its frame where it is not the end effector, whose frame is the tip's."""
        import rerun as rr

        drawn, index = self.stage.bodies[body], columns.index(steps, times)
        path = self.stage.body(k, drawn)
        frames, sound = columns.poses(position, rotation)
        axes: list[Any] = []
        if drawn.name and drawn.name != getattr(self.stage.assembly, "end_effector", ""):
            length = max(0.6 * TIP_AXES * self.stage.size, _BEYOND * drawn.reach)  # so that they end outside of it
            axes = [*rr.TransformAxes3D.columns(axis_length=np.where(sound, length, 0.0))]
        self._send(path, index, [*frames, *axes])
        if drawn.name:
            place = np.tile(drawn.corner(k), (int(sound.sum()), 1))
            self._send(f"{path}/name", index, rr.Points3D.columns(positions=place).partition(sound.astype(int)))
        changed = self._changed(path, sound)
        if changed.any():
            mesh = columns.plates(drawn.solids[k], sound[changed])
            self._send(path, columns.index(steps[changed], times[changed]), mesh)

    def _write_path(self, path: str, index: "Index", positions: FloatArray) -> None:
        before = np.concatenate([self._last_tip.get(path, positions[:1]).reshape(1, 3), positions[:-1]])
        self._last_tip[path] = positions[-1]
        self._send(path, index, columns.strips(np.stack([before, positions], axis=1)))

    def _write_arrows(self, k: int, load: DrawnLoad, index: "Index", origins: FloatArray, force: FloatArray) -> None:
        """Arrows in newtons, each from the origin of a frame whose scale may yet change."""
        import rerun as rr

        path = self.stage.load(k, load)
        sound = np.isfinite(origins).all(axis=1) & np.isfinite(force).all(axis=1) & (np.abs(force).max(axis=1) > 0)
        labels = [f"{value:.3g} {load.unit}" for value in np.linalg.norm(force[sound], axis=1)]
        arrows = rr.Arrows3D.columns(vectors=force[sound], labels=labels if self.stage.labelled else None)
        places = rr.Transform3D.columns(translation=origins[sound])
        self._send(path, index, [*arrows.partition(sound.astype(int)), *places.partition(sound.astype(int))])

    def _write_points(self, path: str, index: "Index", positions: FloatArray) -> None:
        """A point a sample; none where it is not known."""
        import rerun as rr

        sound = np.isfinite(positions).all(axis=1)
        self._send(path, index, rr.Points3D.columns(positions=positions[sound]).partition(sound.astype(int)))

    def _write_spread(self, path: str, index: "Index", force: FloatArray, covariances: FloatArray) -> None:
        """The ellipsoid about an arrow's end that has 95 % of the force, in newtons as the arrow."""
        import rerun as rr

        half, turns = columns.ellipsoids(covariances)
        sound = (np.isfinite(force).all(axis=1) & np.isfinite(half).all(axis=1)).astype(int)
        kept = sound == 1
        shapes = rr.Ellipsoids3D.columns(centers=force[kept], half_sizes=half[kept], quaternions=turns[kept])
        self._send(path, index, shapes.partition(sound))

    def _write_name(self, k: int, rod: int, index: "Index", shapes: Sequence[dict[str, FloatArray]], rows: slice) -> None:
        """A name where the rod can be seen: in the middle of what no tube of its leg covers."""
        import rerun as rr

        if not self.stage.label(k, rod):
            return
        own = shapes[rod]["arclength"][rows, k, -1]
        others = [shapes[i]["arclength"][rows, k, -1] for i, r in enumerate(self.stage.rods) if r.leg == self.stage.rods[rod].leg]
        covered = np.max([np.where(other < own, other, 0.0) for other in others], axis=0)
        part = 1.0 if self.stage.batched else 0.5 + 0.5 * covered / own
        node = np.nan_to_num(part * (self._node_count - 1)).astype(int)
        nodes = np.broadcast_to(node, own.shape)[:, None, None]
        places = np.take_along_axis(shapes[rod]["position"][rows, k], nodes, axis=1)[:, 0]
        sound = np.isfinite(places).all(axis=1)
        self._send(
            self.stage.rod("names", k, rod), index, rr.Points3D.columns(positions=places[sound]).partition(sound.astype(int))
        )

    def _write_failed(
        self, k: int, steps: NDArray[np.int64], times: FloatArray, codes: NDArray[Any], positions: Sequence[FloatArray]
    ) -> None:
        """Where samples begin to fail, or what is an event begins, the last shape before and what happened, in words; where they
        end, nothing."""
        import rerun as rr

        failed = failures(codes)
        told = failed | left_branch(codes)
        last = self._last_sound.setdefault(k, [np.zeros((0, 3)) for _ in positions])
        states = np.where(told, codes, -1)
        path = self.stage.world("failed/status", k)
        self._last_value.setdefault(path, -1)
        if told.any() or self._last_value[path] != -1:
            for row in np.flatnonzero(self._changed(path, states)):
                index = columns.index(steps[row : row + 1], times[row : row + 1])
                shown = [p[row - 1] for p in positions] if row and not failed[row - 1] else last
                for i, nodes in enumerate(shown):
                    strip = [nodes] if told[row] and len(nodes) else []
                    strips = rr.LineStrips3D.columns(strips=strip).partition([len(strip)])
                    self._send(self.stage.rod("failed/rods", k, i), index, strips)
                    last[i] = nodes
                text = [_words(int(codes[row]))] if told[row] else []
                place = [self._place_of_words(nodes)] if told[row] else []
                points = [*rr.Points3D.columns(positions=place).partition([len(text)])]
                self._send(path, index, [*points, *rr.Points3D.columns(labels=text).partition([len(text)])])
        sound = np.flatnonzero(~failed)
        if sound.size:
            self._last_sound[k] = [p[sound[-1]] for p in positions]

    def _place_of_words(self, nodes: FloatArray) -> FloatArray:
        """Where what happened can be read: high in the view; of several instances, at the tip of each."""
        if not self.stage.batched:
            return Frame.between(self.stage.centre, self.stage.eye).above
        return np.asarray(nodes[-1] if len(nodes) else next(iter(self.stage.bases.values()))[:3, 3])

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

    def _send_scalars(self, path: str, index: "Index", values: FloatArray) -> None:
        import rerun as rr

        self._send(path, index, rr.Scalars.columns(scalars=np.ascontiguousarray(values)))


def _scales(found: dict[str, float]) -> dict[str, Any]:
    """As fields of a stage."""
    return {f"{kind}_scale": scale for kind, scale in found.items()}


def _sender(streams: "Sequence[Stream]", breathe: Callable[[], None]) -> "Send":
    """Sends columns to an entity; it does not hold the writer, which would keep streams open until garbage is collected."""

    def send(path: str, index: "Index", values: "Columns") -> None:
        for stream in streams:
            stream.send_columns(path, index, values)
        breathe()

    return send


def _told(remarks: Sequence[Remarks]) -> dict[str, FloatArray]:
    """Series of what tasks said, axes (sample, instance[, component])."""
    values: dict[str, FloatArray] = {}
    if remarks and remarks[0].target_error is not None:
        error = 1e3 * np.array([[said.target_error] for said in remarks], dtype=np.float64)
        values["/task/target_error_mm"], values["/task/target_error_mm_log10"] = error, columns.log10(error)
    if remarks and remarks[0].limits is not None:
        values["/task/limits"] = np.array([said.limits for said in remarks])[:, None]
    return values


def _tips(block: History, reference: History | None) -> dict[str, FloatArray]:
    """Of all sources, axes (sample, instance, 3)."""
    sources = {"": block} if reference is None else {"": block, "reference/": reference}
    return {kind: np.reshape(source.tip_position, (len(block.time), -1, 3)) for kind, source in sources.items()}


def _compared(block: History, reference: History | None) -> str:
    """What the reference is, as far as it is another."""
    if reference is None:
        return ""
    robot = "" if reference.assembly is block.assembly else repr(reference.assembly)
    return ", ".join(part for part in (robot, reference.description) if part)


def _words(code: int) -> str:
    status = Status(code)
    return f"{status.name}\n" + "\n".join(wrap(status.message, 44))


def _compare(shapes: dict[str, list[dict[str, FloatArray]]]) -> None:
    """Add to each rod's shape how far its nodes are from the reference's [mm]."""
    for shape, other in zip(shapes[""], shapes["reference/"], strict=True):
        shape["difference"] = 1e3 * np.linalg.norm(shape["position"] - other["position"], axis=-1, keepdims=True)


def _scalars(stage: Stage, block: History, tips: dict[str, FloatArray]) -> dict[str, FloatArray]:
    """Series by entity, axes (sample, instance[, component])."""

    def split(values: object, *tail: int) -> FloatArray:
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
