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
from multirod.recording.entities import Entities
from multirod.recording.figure import discs
from multirod.recording.framing import Extent, Frame
from multirod.recording.loads import Acting, acting, arrow_ends, largest
from multirod.recording.series import compare, compared, scalars_of, tips_of, told
from multirod.recording.stage import TIP_AXES, Stage, final_scale, frame_ends, given, live_scale, targets
from multirod.recording.style import scales, styles
from multirod.results.history import History
from multirod.results.remarks import Remarks
from multirod.results.strains import strains
from multirod.status import Status
from multirod.validation import FloatArray

if TYPE_CHECKING:
    from rerun.blueprint import Blueprint

    from multirod.recording.columns import Columns, Index, Send
    from multirod.recording.streams import Stream

_ROWS = 1000


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
        self._entities = Entities(self._send, node_count)
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
        self._text = title, solver, total, compared(block, reference)
        self._along = AlongPlots(self.stage, self._send)
        self._note_ranges(scalars_of(self.stage, block, tips_of(block, reference)) | told(remarks))
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
        tips = tips_of(block, reference)
        loads = acting(block, shapes[""])
        if self._live:
            self._widen(block, shapes[""], loads, remarks)
        self._breathe()
        stage = self.stage
        if any(profile.name == "difference" for profile in stage.profiles):
            compare(shapes)
        lines = [self._line(block, line, samples) for line in range(len(stage.lines))]
        rims = [self._rims(block, rod, shape) for rod, shape in enumerate(shapes[""])]
        tension = np.reshape(block.tension, (samples, -1, len(stage.lines))) if stage.lines else np.zeros((samples, 0, 0))
        rotations = np.reshape(block.tip_rotation, (samples, -1, 3, 3))
        self._breathe()
        scalars = scalars_of(stage, block, tips) | told(remarks)
        self._breathe()
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
                    self._entities.name(stage, k, i, index, shapes[""], rows)
                    self._along.write(along, k, i, index, rows)
                for i, shape in enumerate(shapes.get("reference/", [])):
                    self._send(stage.rod("reference/rods", k, i), index, columns.strips(shape["position"][rows, k]))
                for i, nodes in enumerate(lines):
                    self._entities.line(stage, k, i, index, nodes[rows, k], tension[rows, k, i])
                for i, circles in enumerate(rims):
                    if circles.size:
                        self._send(stage.rod("discs", k, i), index, columns.strips(circles[rows, k]))
                self._entities.tip(stage, k, index, tips[""][rows, k], rotations[rows, k])
                for i, (position, rotation) in enumerate(bodies):
                    self._entities.body(stage, k, i, steps[rows], block.time[rows], position[rows, k], rotation[rows, k])
                for kind, positions in tips.items():
                    self._entities.path(stage.world(f"{kind}tip_path", k), index, positions[rows, k])
                for load, (origins, force) in loads.items():
                    self._entities.arrows(stage, k, load, index, origins[rows, k], force[rows, k])
                    if remarks and load.name in remarks[0].covariances:
                        spread = np.array([said.covariances[load.name] for said in remarks[rows]])
                        if load.follows:
                            spread = rotations[rows, k] @ spread @ rotations[rows, k].swapaxes(1, 2)
                        self._entities.ellipsoid(f"{stage.load(k, load)}/spread", index, force[rows, k], spread)
                if remarks and remarks[0].target is not None:
                    self._entities.points(stage.world("target", k), index, targets(remarks[rows]))
                    self._entities.path(stage.world("target_path", k), index, targets(remarks[rows]))
                if remarks and remarks[0].measured is not None:
                    self._entities.points(stage.world("measured", k), index, np.array([said.measured for said in remarks[rows]]))
                for path, values in scalars.items():
                    self._entities.scalars(stage.scalar(path, k), index, values[rows, k])
                self._entities.status(stage.scalar("/status", k), steps[rows], block.time[rows], statuses[rows, k])
                nodes_of_rods = [shape["position"][rows, k] for shape in shapes[""]]
                self._entities.failed(stage, k, steps[rows], block.time[rows], statuses[rows, k], nodes_of_rods)

    def _widen(self, block: History, shapes: Sequence[dict[str, FloatArray]], loads: Acting, remarks: Sequence[Remarks]) -> None:
        """Fit scale, frame and plots to what was not known when the stage was set."""
        before = self.stage
        self._largest = {kind: max(known, largest(loads, kind)) for kind, known in self._largest.items()}
        wanted = {kind: live_scale(scale, self._largest[kind], before) for kind, scale in before.scales.items()}
        if self._force_scale is not None:
            wanted["force"] = before.force_scale
        for shape in shapes:
            self._extent.add(shape["position"])
        self._extent.add(targets(remarks))
        self._extent.add(around(before.bodies, block))
        self._extent.add(frame_ends(block, TIP_AXES * before.size))
        self._extent.add(arrow_ends(loads, wanted))
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
        tails = {"arclength": 1, "position": 2, "rotation": 3, "curvature": 2, "moment": 2, "force": 2, "total_force": 2}
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


def _words(code: int) -> str:
    status = Status(code)
    return f"{status.name}\n" + "\n".join(wrap(status.message, 44))
