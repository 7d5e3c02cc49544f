"""Recordings for the Rerun viewer: a finished ``History``, or a control loop while it runs.

Entities (``[instance_k]`` only where there is a batch axis; ``ROD`` is a rod's name, or ``rod_k``):

=========================================  ==============================================================================
``/description``                           what was run, units and scales, as Markdown
``/world/base[_k]``                        base frames
``/world/[instance_k/]rods/ROD``           shape: one capsule between two nodes
``/world/[instance_k/]tip``                frame of the end effector
``/world/[instance_k/]tip_path``           a stroke a sample, from the tip before
``/world/[instance_k/]platform``           outline of the platform, for assemblies that have one
``/world/[instance_k/]loads/NAME``         ``tip_force`` and ``follower_force`` as arrows
``/world/[instance_k/]reference/...``      shape and tip path of the reference
``/error/boundary[_log10][/instance_k]``   ``residual`` [1/m]
``/error/tip_mm[_log10][/instance_k]``     distance of the tip from the reference's [mm]
``/conditioning/...[/instance_k]``         ``condition``, ``condition_log10``, ``smallest_singular_value``
``/solver/...[/instance_k]``               ``step_time_ms``, ``iterations``, ``integrations``
``/inputs/NAME[/instance_k]``              every input that was given as numbers, a series a component or rod
``/curvature/...``                         curvature along the arclength, as drawn
``/status[/instance_k]``                   name of ``Status``, one row a change
=========================================  ==============================================================================

Every row carries two timelines, ``step`` (sample number) and ``time`` [s]. Scalars are float64 and equal the history's
values; geometry is float32. A failed sample has NaN scalars and no geometry.
"""

import math
import os
import uuid
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from multirod.assembly import Assembly
from multirod.inputs import Inputs
from multirod.rod import Rod
from multirod.solution import History, Solution
from multirod.solver import Outcome
from multirod.status import Status
from multirod.validation import FloatArray, finite_float, positive_float, positive_int, refuse

_ROWS = 1000
_LOADS = {"tip_force": 0xFFD43B, "follower_force": 0xFF922B}

# Picked to be told apart on the viewer's dark theme.
_PALETTE = (0x4FC3F7, 0xFFB74D, 0x81C784, 0xF06292, 0xBA9CFF, 0xFFF176, 0x4DB6AC, 0xFF8A65)
_AXIS_COLORS = (0xFF6B6B, 0x69DB7C, 0x74A9FF)
_REFERENCE_COLOR = 0xB0B8C4
_AXIS_LINE_COLOR = 0x8A929C
_STATUS_COLORS = {
    Status.NOT_RUN: 0x868E96,
    Status.CONVERGED: 0x2F9E44,
    Status.LOWEST_ENERGY: 0x66A80F,
    Status.TRACKING: 0x1C7ED6,
    Status.NEAR_FOLD: 0xF08C00,
    Status.EULER_LIMIT: 0xE8590C,
}
_FAILURE_COLOR = 0xE03131

# The curvature plot in its own units: 2D views keep the aspect ratio, so arclength and curvature are both scaled to fit.
_PLOT_WIDTH, _PLOT_HEIGHT = 6.0, 1.0


def save(
    path: str | os.PathLike[str],
    history: History,
    *,
    reference: History | None = None,
    name: str | None = None,
    nodes: int = 51,
    instances: int = 4,
    force_scale: float | None = None,
) -> None:
    """Write a recording of ``history``, with a layout that opens ready to read.

    Args:
        path: File to write (``.rrd``); an existing one is replaced.
        history: What to record. Of a batch, the first ``instances`` are recorded, each as entities of its own.
        reference: The same samples from a method that is trusted: its shape is drawn in grey, and the distance between
            the tips is recorded.
        name: What the viewer calls the recording; by default the file's name.
        nodes: Nodes that a rod is drawn with.
        instances: How many instances of a batch are recorded.
        force_scale: Length of force arrows [m/N]; by default the largest arrow is about a quarter of the robot's size.

    Raises:
        TypeError: If ``history`` or ``reference`` is not a ``History``.
        ValueError: If ``reference`` has other samples, or another argument is out of range.
    """
    import rerun as rr

    file = _file("save.path", path)
    if not isinstance(history, History):
        raise TypeError(f"save takes a History, not {type(history).__name__}")
    if reference is not None:
        if not isinstance(reference, History):
            raise TypeError(f"save.reference takes a History, not {type(reference).__name__}")
        if reference.batch_shape != history.batch_shape or not np.allclose(reference.time, history.time, rtol=0, atol=1e-9):
            refuse("save.reference", reference, f"must have the samples of the history, {history!r}")
    node_count = positive_int("save.nodes", nodes, 2)
    count = positive_int("save.instances", instances)
    scale = None if force_scale is None else positive_float("save.force_scale", force_scale)
    title = _name("save.name", name, file.stem)

    block = _first_instances(history, count)
    other = None if reference is None else _first_instances(reference, count)
    total = math.prod(history.batch_shape[1:])
    stream = rr.RecordingStream("multirod", recording_id=uuid.uuid4())
    stream.set_log_time_enabled(False)
    writer = _Writer([stream], node_count=node_count, instances=count, force_scale=scale, live=False)
    blueprint = writer.prepare(block, other, title, history.description, total)
    stream.save(file, default_blueprint=blueprint)
    with stream:
        stream.send_recording_name(title)
        writer.write_static()
        writer.write(block, other, np.arange(len(history.time)))


class Recorder:
    """Records a control loop sample by sample, to a file, to a viewer, or to both.

    Samples are kept until there are ``flush_every`` of them, then written together: shapes are integrated as one batch
    and rows are sent as columns, so that a sample costs little. The first sample is written at once; where the kernel
    for shapes is not in Warp's cache yet, that is when it is compiled.

    A run that is killed leaves a readable file. ``with`` writes what is pending whatever exception ends the block.
    SIGKILL loses at most the last ``flush_every`` samples, and so does SIGTERM, unless the program turns it into an
    exception: ``signal.signal(signal.SIGTERM, lambda *_: sys.exit(143))``.

    The layout is made for the first sample: give it a ``reference`` if later ones have it.

    Example::

        with Recorder("run.rrd") as recorder:
            for k in range(1000):
                solution = tracker.step(rotation=angle(k * dt))
                recorder.log(k * dt, solution)

    Args:
        path: File to write (``.rrd``); an existing one is replaced.
        address: Viewer to stream to, such as ``"rerun+http://127.0.0.1:9876/proxy"``. If none listens, the loop goes on,
            and leaving ``with`` can take some seconds.
        name: What the viewer calls the recording; by default the file's name.
        description: What is run, such as ``repr(solver)``, for the description panel.
        flush_every: Samples that are written together.
        nodes: Nodes that a rod is drawn with.
        instances: How many instances of a batch are recorded.
        force_scale: Length of force arrows [m/N]; by default ``EI/L^2`` of the stiffest rod is half of its length.

    Raises:
        TypeError: If neither ``path`` nor ``address`` is given.
        ValueError: If an argument is out of range.
    """

    def __init__(
        self,
        path: str | os.PathLike[str] | None = None,
        *,
        address: str | None = None,
        name: str | None = None,
        description: str = "",
        flush_every: int = 20,
        nodes: int = 51,
        instances: int = 4,
        force_scale: float | None = None,
    ) -> None:
        import rerun as rr

        if path is None and address is None:
            raise TypeError("Recorder needs a path, an address, or both")
        file = None if path is None else _file("Recorder.path", path)
        if address is not None and not (isinstance(address, str) and address.startswith(("rerun://", "rerun+http"))):
            refuse("Recorder.address", address, "must be a viewer's address such as 'rerun+http://127.0.0.1:9876/proxy'")
        if not isinstance(description, str):
            refuse("Recorder.description", description, "must be a string")
        self._name = _name("Recorder.name", name, "multirod" if file is None else file.stem)
        self._description = description
        self._flush_every = positive_int("Recorder.flush_every", flush_every)
        self._instances = positive_int("Recorder.instances", instances)
        node_count = positive_int("Recorder.nodes", nodes, 2)
        scale = None if force_scale is None else positive_float("Recorder.force_scale", force_scale)
        self._pending: list[tuple[float, Solution, float, Solution | None]] = []
        self._count = 0
        self._last_time = -math.inf
        self._assembly: Assembly | None = None
        self._batch_shape: tuple[int, ...] = ()
        self._closed = False
        # Not one stream with two sinks: flushing the file would then wait for a viewer that may not be there.
        identity = uuid.uuid4()
        self._file_stream: Any = None
        self._streams: list[Any] = []
        if file is not None:
            self._file_stream = rr.RecordingStream("multirod", recording_id=identity)
            self._file_stream.save(file)
            self._streams.append(self._file_stream)
        if address is not None:
            viewer_stream = rr.RecordingStream("multirod", recording_id=identity)
            viewer_stream.connect_grpc(address)
            self._streams.append(viewer_stream)
        for stream in self._streams:
            stream.set_log_time_enabled(False)
        self._writer = _Writer(self._streams, node_count=node_count, instances=self._instances, force_scale=scale, live=True)

    def log(self, time: float, solution: Solution, *, step_time: float | None = None, reference: Solution | None = None) -> None:
        """Record one sample.

        Args:
            time: Of the sample [s], later than that of the sample before.
            solution: Its equilibrium or estimate, from ``Tracker.step`` or ``solve``.
            step_time: How long it took [s].
            reference: The same sample from a method that is trusted.

        Raises:
            TypeError: If ``solution`` or ``reference`` is not a ``Solution``.
            ValueError: If ``time`` does not increase, or the robot or its batch axes are not those of the first sample.
            RuntimeError: If the recorder is closed.
        """
        if self._closed:
            raise RuntimeError("Recorder.log: the recorder is closed")
        now = finite_float("Recorder.log.time", time)
        if now <= self._last_time:
            refuse("Recorder.log.time", time, f"must be later than the sample before, {self._last_time:g} s")
        duration = math.nan if step_time is None else positive_float("Recorder.log.step_time", step_time)
        for field, value in (("solution", solution), ("reference", reference)):
            if value is None and field == "reference":
                continue
            if not isinstance(value, Solution) or isinstance(value, History):
                raise TypeError(f"Recorder.log.{field} takes the Solution of one sample, not {type(value).__name__}")
            if self._assembly is None:
                self._assembly, self._batch_shape = value.assembly, value.batch_shape
            if field == "solution" and value.assembly is not self._assembly:
                refuse("Recorder.log.solution", value, "must be of the robot of the first sample")
            if value.batch_shape != self._batch_shape:
                refuse(f"Recorder.log.{field}", value, f"must have the leading axes of the first sample, {self._batch_shape}")
        self._last_time = now
        if self._pending and not _stackable(self._pending[-1], solution, reference):
            self.flush()
        self._pending.append((now, solution, duration, reference))
        if self._count == 0 or len(self._pending) >= self._flush_every:
            self.flush()

    def flush(self) -> None:
        """Write the samples that are pending."""
        if self._pending:
            times = np.array([sample[0] for sample in self._pending])
            durations = np.array([sample[2] for sample in self._pending])
            block = _stack([sample[1] for sample in self._pending], times, durations)
            references = [sample[3] for sample in self._pending if sample[3] is not None]
            other = _stack(references, times, durations) if references else None
            self._pending = []
            block = _first_instances(block, self._instances)
            other = None if other is None else _first_instances(other, self._instances)
            if self._count == 0:
                total = math.prod(self._batch_shape)
                blueprint = self._writer.prepare(block, other, self._name, self._description, total)
                for stream in self._streams:
                    stream.send_recording_name(self._name)
                    stream.send_blueprint(blueprint)
                self._writer.write_static()
            self._writer.write(block, other, np.arange(self._count, self._count + len(times)))
            self._count += len(times)
        if self._file_stream is not None:
            self._file_stream.flush()

    def close(self) -> None:
        """Write what is pending and finish the file."""
        if self._closed:
            return
        self._closed = True
        try:
            self.flush()
        finally:
            for stream in self._streams:
                stream.disconnect()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self.close()


def _file(field: str, path: object) -> Path:
    if not isinstance(path, (str, os.PathLike)) or not os.fspath(path):
        refuse(field, path, "must be a path")
    file = Path(os.fspath(path))
    if file.is_dir() or not file.parent.is_dir():
        refuse(field, str(path), "must be a file in a folder that exists")
    return file


def _name(field: str, name: object, default: str) -> str:
    if name is None:
        return default
    if not isinstance(name, str) or not name:
        refuse(field, name, "must be a non-empty string")
    return name


def _stack(solutions: Sequence[Solution], times: FloatArray, durations: FloatArray) -> History:
    """Samples of one robot as a history, so that all their shapes are integrated in one batch."""
    first = solutions[0]
    arrays: dict[str, FloatArray] = {}
    for name in first.inputs.given:
        if name not in first.inputs.profiles:
            rows = [getattr(solution.inputs, name) for solution in solutions]
            arrays[name] = np.stack([np.broadcast_to(row, (*first.batch_shape, row.shape[-1])) for row in rows])
    outcome = Outcome.joined([solution._outcome for solution in solutions])
    records = np.concatenate([solution._records for solution in solutions])
    batch_shape = (len(solutions), *first.batch_shape)
    inputs = first.inputs.with_arrays(arrays)
    if not arrays:
        inputs = inputs[np.newaxis][np.zeros(batch_shape, dtype=int)]
    scene = replace(first._scene, batch_shape=batch_shape)
    return History(scene, records, outcome, inputs, time=times, step_time=durations)


def _stackable(pending: tuple[float, Solution, float, Solution | None], solution: Solution, reference: Solution | None) -> bool:
    """Whether a sample can be part of the same batch as the one before: same records, same inputs by name."""

    def same(one: Solution | None, other: Solution | None) -> bool:
        if one is None or other is None:
            return one is other
        return one._scene is other._scene or (
            one._scene.fields == other._scene.fields
            and one.inputs.given == other.inputs.given
            and all(other.inputs.profile(name) is profile for name, profile in one.inputs.profiles.items())
        )

    return same(pending[1], solution) and same(pending[3], reference)


def _first_instances(history: History, count: int) -> History:
    """The history of the first ``count`` instances, its batch axes flattened to one; itself if it has none."""
    samples, *axes = history.batch_shape
    total = math.prod(axes)
    if not axes or (total <= count and len(axes) == 1) or history.assembly.batch_shape:
        return history
    kept = min(count, total)

    def cut(values: Any) -> Any:
        return np.reshape(values, (samples, total, *np.shape(values)[1:]))[:, :kept].reshape(-1, *np.shape(values)[1:])

    arrays = {}
    for name in history.inputs.given:
        if name not in history.inputs.profiles:
            value = getattr(history.inputs, name)
            arrays[name] = np.broadcast_to(value, (*history.batch_shape, value.shape[-1])).reshape(samples, total, -1)[:, :kept]
    was = history._outcome
    outcome = Outcome(cut(was.status), cut(was.iterations), cut(was.integrations), cut(np.reshape(history.residual, -1)))
    return History(
        replace(history._scene, batch_shape=(samples, kept)),
        cut(history._records),
        outcome,
        history.inputs.with_arrays(arrays),
        time=history.time,
        step_time=history.step_time,
        description=history.description,
    )


class _Writer:
    """Turns blocks of samples into columns. ``prepare`` comes first: it fixes the scales and makes the layout."""

    def __init__(self, streams: Sequence[Any], *, node_count: int, instances: int, force_scale: float | None, live: bool) -> None:
        self._streams = streams
        self._instances = instances
        self._node_count = node_count
        self._force_scale = force_scale
        self._live = live
        self._last_tip: dict[str, FloatArray] = {}
        self._last_status: dict[str, str] = {}
        self._curvature_limit = 0.0
        self._arclength_limit = 0.0

    def prepare(self, block: History, reference: History | None, title: str, solver: str, total: int) -> Any:
        """Fix names and scales by the first block, and return the layout."""
        self._assembly = assembly = block.assembly
        self._batched = len(block.batch_shape) > 1
        self._count = min(self._instances, math.prod(block.batch_shape[1:]))
        self._rod_names = _rod_names(assembly.rods)
        self._lengths = [float(np.max(rod.length)) for rod in assembly.rods]
        self._radii = [
            0.004 * length if rod.outer_diameter is None else 0.5 * rod.outer_diameter
            for rod, length in zip(assembly.rods, self._lengths, strict=True)
        ]
        self._bases = np.reshape(getattr(assembly, "base", np.eye(4)), (-1, 4, 4))[:16]
        points = [self._bases[:, :3, 3]]
        if self._live:
            reach = 0.35 * max(self._lengths)
            points += [points[0] - reach, points[0] + reach]
        for index in range(len(assembly.rods)):
            points.append(block.rod(index, nodes=self._node_count).position.reshape(-1, 3))
        everything = np.concatenate(points)
        everything = everything[np.isfinite(everything).all(axis=1)]
        self._low, self._high = everything.min(axis=0), everything.max(axis=0)
        self._size = max(float(np.linalg.norm(self._high - self._low)), 0.2 * max(self._lengths))
        if self._force_scale is None:
            self._force_scale = self._default_force_scale(block)
        self._grid = _round_down(0.2 * self._size)
        self._description = self._describe(title, solver, total, reference is not None)
        return self._blueprint(block, reference is not None)

    def _default_force_scale(self, block: History) -> float:
        if self._live:
            stiffness = [max(float(np.max(s.bending_stiffness)) for s in rod.sections) for rod in self._assembly.rods]
            pairs = zip(stiffness, self._lengths, strict=True)
            return _round_down(max(0.5 * length**3 / stiffness for stiffness, length in pairs))
        forces = [np.linalg.norm(_load(block.inputs, name), axis=-1).max() for name in _LOADS]
        return _round_down(0.25 * self._size / max(forces)) if max(forces) > 0 else 1.0

    def write_static(self) -> None:
        """Write what does not change with time: description, frames, colours and names of series."""
        import rerun as rr

        def put(path: str, *archetypes: Any) -> None:
            for stream in self._streams:
                stream.log(path, *archetypes, static=True)

        put("/description", rr.TextDocument(self._description, media_type=rr.MediaType.MARKDOWN))
        put("/world", rr.ViewCoordinates.RIGHT_HAND_Z_UP)
        for index, pose in enumerate(self._bases):
            path = "/world/base" if len(self._bases) == 1 else f"/world/base_{index}"
            put(path, rr.Transform3D(translation=pose[:3, 3], mat3x3=pose[:3, :3]), rr.TransformAxes3D(0.12 * self._size))
        states = [status for status in Status if status is not Status.NOT_RUN]
        colors = np.array([_rgba(_STATUS_COLORS.get(status, _FAILURE_COLOR)) for status in states], dtype=np.uint32)
        for k in range(self._count):
            names = [status.name for status in states]
            put(self._scalar("/status", k), rr.StateConfiguration(values=names, labels=names, colors=colors))
            self._style_series(put, k)
            for index, radius in enumerate(self._radii):
                color = _rgba(_PALETTE[(k if len(self._radii) == 1 else index) % len(_PALETTE)])
                path = self._rod("rods", k, index)
                put(path, rr.Capsules3D.from_fields(colors=color, fill_mode=rr.components.FillMode.Solid))
                path = self._rod("reference/rods", k, index)
                put(path, rr.LineStrips3D.from_fields(radii=0.4 * radius, colors=_rgba(_REFERENCE_COLOR, 0xC0)))
            stroke = 0.0015 * self._size
            put(self._world("tip_path", k), rr.LineStrips3D.from_fields(radii=stroke, colors=_rgba(0xFFFFFF, 0x90)))
            put(
                self._world("reference/tip_path", k),
                rr.LineStrips3D.from_fields(radii=0.6 * stroke, colors=_rgba(_REFERENCE_COLOR)),
            )
            put(self._world("platform", k), rr.LineStrips3D.from_fields(radii=2 * stroke, colors=_rgba(0xDEE2E6)))
            for name, shade in _LOADS.items():
                put(self._world(f"loads/{name}", k), rr.Arrows3D.from_fields(radii=2 * stroke, colors=_rgba(shade)))
            self._style_curvature(put, k)
        frame = [[(0.0, -h), (0.0, h), (_PLOT_WIDTH, h), (_PLOT_WIDTH, -h), (0.0, -h)] for h in (0.5 * _PLOT_HEIGHT,)]
        zero = [(0.0, 0.0), (_PLOT_WIDTH, 0.0)]
        put("/curvature/axes", rr.LineStrips2D([*frame, zero], radii=rr.Radius.ui_points(0.5), colors=_rgba(_AXIS_LINE_COLOR)))

    def _style_series(self, put: Any, k: int) -> None:
        import rerun as rr

        who = f"instance {k}: " if self._batched else ""
        single = {
            "/error/boundary": ("boundary error [1/m]", 0xF06292),
            "/error/boundary_log10": ("log10 boundary error [1/m]", 0xF06292),
            "/error/tip_mm": ("tip error [mm]", 0xFFB74D),
            "/error/tip_mm_log10": ("log10 tip error [mm]", 0xFFB74D),
            "/conditioning/condition": ("condition number", 0xBA9CFF),
            "/conditioning/condition_log10": ("log10 condition number", 0xBA9CFF),
            "/conditioning/smallest_singular_value": ("smallest singular value", 0x4DB6AC),
            "/solver/step_time_ms": ("time per sample [ms]", 0x81C784),
            "/solver/iterations": ("iterations", 0x4FC3F7),
            "/solver/integrations": ("integrations", 0xFFF176),
        }
        for path, (name, color) in single.items():
            shade = _PALETTE[k % len(_PALETTE)] if self._batched else color
            put(self._scalar(path, k), rr.SeriesLines(names=who + name, colors=_rgba(shade), widths=1.5))
        for spec in self._assembly.input_specs:
            if spec.per_rod:
                labels, shades = self._rod_names, [_PALETTE[i % len(_PALETTE)] for i in range(len(self._rod_names))]
            else:
                labels, shades = ["x", "y", "z"], list(_AXIS_COLORS)
            names = [f"{who}{spec.name} {label} [{spec.unit}]" for label in labels]
            colors = np.array([_rgba(shade) for shade in shades], dtype=np.uint32)
            put(self._scalar(f"/inputs/{spec.name}", k), rr.SeriesLines(names=names, colors=colors, widths=[1.5] * len(names)))

    def _style_curvature(self, put: Any, k: int) -> None:
        import rerun as rr

        for index in range(len(self._radii)):
            shades = _AXIS_COLORS if self._by_component else (_PALETTE[(k if len(self._radii) == 1 else index) % len(_PALETTE)],)
            colors = np.array([_rgba(shade) for shade in shades], dtype=np.uint32)
            put(self._curvature(k, index), rr.LineStrips2D.from_fields(radii=rr.Radius.ui_points(1.0), colors=colors))

    def write(self, block: History, reference: History | None, steps: NDArray[np.int64]) -> None:
        """Send the samples of ``block``; columns of at most 1000 rows, so that the viewer loads what it shows."""
        samples = len(block.time)
        sources = [("", block)] if reference is None else [("", block), ("reference/", reference)]
        shapes = {
            kind: [self._instanced(vars(source.rod(index, nodes=self._node_count)), samples) for index in range(len(self._radii))]
            for kind, source in sources
        }
        tips = {kind: np.reshape(source.tip_position, (samples, -1, 3)) for kind, source in sources}
        scalars = self._scalars(block, tips, samples)
        inputs = {
            name: np.reshape(np.broadcast_to(value, (*block.batch_shape, value.shape[-1])), (samples, -1, value.shape[-1]))
            for name in block.inputs.given
            if block.inputs.profile(name) is None
            for value in (getattr(block.inputs, name),)
        }
        rotations = np.reshape(block.tip_rotation, (samples, -1, 3, 3))
        loads = {name: np.reshape(_load(block.inputs, name, block.batch_shape), (samples, -1, 3)) for name in _LOADS}
        loads["follower_force"] = np.einsum("tkij,tkj->tki", rotations, loads["follower_force"])
        statuses = np.reshape(np.asarray(block.status), (samples, -1))
        self._write_curvature_axes(shapes[""], block.time, steps)
        for start in range(0, samples, _ROWS):
            rows = slice(start, start + _ROWS)
            index = _index(steps[rows], block.time[rows])
            for k in range(self._count):
                for i, shape in enumerate(shapes[""]):
                    self._send(self._rod("rods", k, i), index, _capsules(shape["position"][rows, k], self._radii[i]))
                    self._write_curvature(k, i, index, shape["arclength"][rows, k], shape["curvature"][rows, k])
                for i, shape in enumerate(shapes.get("reference/", [])):
                    self._send(self._rod("reference/rods", k, i), index, _strips(shape["position"][rows, k]))
                self._write_tip(k, index, tips[""][rows, k], rotations[rows, k])
                for kind, positions in tips.items():
                    self._write_path(self._world(f"{kind}tip_path", k), index, positions[rows, k])
                for name, force in loads.items():
                    if name in block.inputs.given:
                        self._write_arrows(self._world(f"loads/{name}", k), index, tips[""][rows, k], force[rows, k])
                for path, values in scalars.items():
                    self._send_scalars(self._scalar(path, k), index, values[rows, k])
                for name, values in inputs.items():
                    self._send_scalars(self._scalar(f"/inputs/{name}", k), index, values[rows, k])
                self._write_status(self._scalar("/status", k), steps[rows], block.time[rows], statuses[rows, k])

    def _instanced(self, values: dict[str, FloatArray], samples: int) -> dict[str, FloatArray]:
        tails = {"arclength": 1, "position": 2, "curvature": 2}
        return {name: values[name].reshape(samples, -1, *values[name].shape[-tail:]) for name, tail in tails.items()}

    def _scalars(self, block: History, tips: dict[str, FloatArray], samples: int) -> dict[str, FloatArray]:
        def split(values: Any) -> FloatArray:
            return np.reshape(np.asarray(values, dtype=np.float64), (samples, -1))

        residual, condition = split(block.residual), split(block.condition)
        values = {
            "/error/boundary": residual,
            "/error/boundary_log10": _log10(residual),
            "/conditioning/condition": condition,
            "/conditioning/condition_log10": _log10(condition),
            "/conditioning/smallest_singular_value": split(block.smallest_singular_value),
            "/solver/iterations": split(block.iterations),
            "/solver/integrations": split(block.integrations),
        }
        if np.isfinite(block.step_time).any():
            values["/solver/step_time_ms"] = np.broadcast_to(1e3 * block.step_time[:, None], residual.shape)
        if "reference/" in tips:
            error = 1e3 * np.linalg.norm(tips[""] - tips["reference/"], axis=-1)
            values["/error/tip_mm"] = error
            values["/error/tip_mm_log10"] = _log10(error)
        return values

    def _write_tip(self, k: int, index: Any, position: FloatArray, rotation: FloatArray) -> None:
        import rerun as rr

        sound = np.isfinite(position).all(axis=1) & np.isfinite(rotation).all(axis=(1, 2))
        counts = sound.astype(int)
        # Without a pose the frame would jump to the origin: a failed sample also gets axes of no length.
        columns = [
            *rr.Transform3D.columns(translation=position[sound], quaternion=_quaternions(rotation[sound])).partition(counts),
            *rr.TransformAxes3D.columns(axis_length=np.where(sound, 0.1 * self._size, 0.0)),
        ]
        self._send(self._world("tip", k), index, columns)
        platform = getattr(self._assembly, "platform", None)
        if platform is not None:
            corners = np.reshape(platform, (-1, 4, 4))[:, :3, 3]
            outline = position[:, None] + np.einsum("tij,cj->tci", rotation, np.concatenate([corners, corners[:1]]))
            self._send(self._world("platform", k), index, _strips(outline))

    def _write_path(self, path: str, index: Any, positions: FloatArray) -> None:
        before = np.concatenate([self._last_tip.get(path, positions[:1]).reshape(1, 3), positions[:-1]])
        self._last_tip[path] = positions[-1]
        self._send(path, index, _strips(np.stack([before, positions], axis=1)))

    def _write_arrows(self, path: str, index: Any, origins: FloatArray, force: FloatArray) -> None:
        import rerun as rr

        sound = np.isfinite(origins).all(axis=1) & np.isfinite(force).all(axis=1) & (np.abs(force).max(axis=1) > 0)
        vectors = float(self._force_scale or 1.0) * force[sound]
        self._send(path, index, rr.Arrows3D.columns(vectors=vectors, origins=origins[sound]).partition(sound.astype(int)))

    def _write_status(self, path: str, steps: NDArray[np.int64], times: FloatArray, codes: NDArray[Any]) -> None:
        import rerun as rr

        names = np.array([Status(int(code)).name for code in codes])
        changed = np.concatenate([[names[0] != self._last_status.get(path)], names[1:] != names[:-1]])
        self._last_status[path] = str(names[-1])
        if changed.any():
            self._send(path, _index(steps[changed], times[changed]), rr.StateChange.columns(state=names[changed].tolist()))

    @property
    def _by_component(self) -> bool:
        """One rod: its curvature by component. Several: the magnitude of each one's bending, or the plot is a tangle."""
        return len(self._radii) == 1 and not self._batched

    def _write_curvature_axes(self, shapes: Sequence[dict[str, FloatArray]], times: FloatArray, steps: NDArray[np.int64]) -> None:
        """Choose the plot's scales, anew where values outgrow them; the tick labels are data, so each row has its own."""
        import rerun as rr

        curvature = [shape["curvature"] if self._by_component else _bending(shape["curvature"]) for shape in shapes]
        largest = max((float(np.nanmax(np.abs(c), initial=0.0)) for c in curvature if np.isfinite(c).any()), default=0.0)
        reach = max(
            (float(np.nanmax(s["arclength"], initial=0.0)) for s in shapes if np.isfinite(s["arclength"]).any()), default=0.0
        )
        if self._curvature_limit and largest <= self._curvature_limit and reach <= self._arclength_limit:
            return
        margin = 1.5 if self._live else 1.05
        self._curvature_limit = max(self._curvature_limit, _round_up(margin * largest) if largest > 0 else 1.0)
        self._arclength_limit = max(self._arclength_limit, _round_up((1.1 if self._live else 1.0) * reach) if reach > 0 else 1.0)
        w, h = _PLOT_WIDTH, 0.5 * _PLOT_HEIGHT
        left = -0.05 * w
        positions = [(left, -1.3 * h), (left, -0.3 * h), (left, 0.7 * h), (1.06 * w, -0.3 * h)]
        labels = [f"{self._curvature_limit:g}", "0", f"-{self._curvature_limit:g}", f"s = {self._arclength_limit:g} m"]
        colors = np.full(len(labels), _rgba(0xDEE2E6), dtype=np.uint32)
        columns = rr.Points2D.columns(positions=positions, labels=labels, colors=colors, radii=[0.0] * len(labels))
        columns = columns.partition([len(labels)])
        self._send("/curvature/axes/labels", _index(steps[:1], times[:1]), columns)

    def _write_curvature(self, k: int, rod: int, index: Any, arclength: FloatArray, curvature: FloatArray) -> None:
        values = curvature if self._by_component else _bending(curvature)
        x = _PLOT_WIDTH / self._arclength_limit * arclength
        y = -0.5 * _PLOT_HEIGHT / self._curvature_limit * values
        strips = np.stack([np.broadcast_to(x[..., None], y.shape), y], axis=-1)
        self._send(self._curvature(k, rod), index, _strips(np.moveaxis(strips, 2, 1)))

    def _send(self, path: str, index: Any, columns: Any) -> None:
        for stream in self._streams:
            stream.send_columns(path, index, columns)

    def _send_scalars(self, path: str, index: Any, values: FloatArray) -> None:
        import rerun as rr

        self._send(path, index, rr.Scalars.columns(scalars=np.ascontiguousarray(values)))

    def _world(self, path: str, k: int) -> str:
        return f"/world/instance_{k}/{path}" if self._batched else f"/world/{path}"

    def _scalar(self, path: str, k: int) -> str:
        return f"{path}/instance_{k}" if self._batched else path

    def _rod(self, group: str, k: int, rod: int) -> str:
        import rerun as rr

        return f"{self._world(group, k)}{rr.new_entity_path([self._rod_names[rod]])}"

    def _curvature(self, k: int, rod: int) -> str:
        import rerun as rr

        return f"{self._scalar('/curvature', k)}{rr.new_entity_path([self._rod_names[rod]])}"

    def _describe(self, title: str, solver: str, total: int, has_reference: bool) -> str:
        scale = float(self._force_scale or 1.0)
        lines = [f"### {title}", "", f"**Robot** `{self._assembly!r}`  "]
        lines += [f"**Solver** `{solver}`  "] if solver else []
        lines += [f"**Batch** the first {self._count} of {total} instances  "] if total > self._count else []
        lines += [
            f"**Shape** grid {1e3 * self._grid:g} mm; frames x red, y green, z blue at base and tip; white: path of the tip up to "
            "the cursor" + ("; grey: the reference" if has_reference else "") + "  ",
            f"**Arrows** 1 N is {1e3 * scale:g} mm; yellow `tip_force`, orange `follower_force`",
            "",
            "| rod | length [m] | bending stiffness [N m^2] | torsional stiffness [N m^2] | drawn diameter [mm] |",
            "|---|---|---|---|---|",
        ]
        for index, rod in enumerate(self._assembly.rods[:24]):
            bending = _span([section.bending_stiffness for section in rod.sections])
            torsion = _span([section.torsional_stiffness for section in rod.sections])
            drawn = f"{2e3 * self._radii[index]:.3g}" + ("" if rod.outer_diameter is not None else " (not given)")
            lines.append(f"| {self._rod_names[index]} | {_span([rod.length])} | {bending} | {torsion} | {drawn} |")
        lines += [
            "",
            "**Plots** "
            + ("Instances are coloured as their rods. " if self._batched else "")
            + "Vectors: x red, y green, z blue. Boundary error: what the solver drives to zero [1/m]. "
            + ("Tip error: distance from the reference's tip [mm]. " if has_reference else "")
            + "Gamma: the scaled Jacobian; its smallest singular value vanishes at a fold. Curvature: at the cursor, "
            + ("in the body frame." if self._by_component else "magnitude of bending, coloured as the rods."),
            "",
            "**Status** of each sample; a failed one has no shape and gaps in the plots.",
        ]
        return "\n".join(lines)

    def _blueprint(self, block: History, has_reference: bool) -> Any:
        import rerun.blueprint as rrb

        up_to_now = rrb.VisibleTimeRanges(
            [
                rrb.VisibleTimeRange(
                    name, start=rrb.TimeRangeBoundary.infinite(), end=rrb.TimeRangeBoundary.cursor_relative(**zero)
                )
                for name, zero in (("time", {"seconds": 0.0}), ("step", {"seq": 0}))
            ]
        )
        paths = [self._world(f"{kind}tip_path", k) for kind in ("", "reference/") for k in range(self._count)]
        center = 0.5 * (self._low + self._high)
        direction = np.array([0.75, -1.0, 0.6])
        eye = center + 0.7 * self._size * direction / np.linalg.norm(direction)
        scene = rrb.Spatial3DView(
            origin="/world",
            name="Shape",
            background=rrb.Background(color=_rgba(0x15191F), kind=rrb.BackgroundKind.SolidColor),
            line_grid=rrb.LineGrid3D(visible=True, spacing=self._grid, stroke_width=0.5, color=_rgba(0x3A414A, 0x90)),
            eye_controls=rrb.EyeControls3D(kind=rrb.Eye3DKind.Orbital, position=eye, look_target=center, eye_up=(0, 0, 1)),
            overrides={path: [up_to_now] for path in paths},
        )

        def plot(name: str, *contents: str, legend: bool = False) -> Any:
            return rrb.TimeSeriesView(
                origin="/",
                name=name,
                contents=[f"/{path}/**" for path in contents],
                plot_legend=rrb.PlotLegend(rrb.Corner2D.LeftTop, visible=legend),
            )

        def tabs(*views: Any) -> Any:
            return rrb.Tabs(*views, active_tab=0) if len(views) > 1 else views[0]

        w, h = _PLOT_WIDTH, 0.5 * _PLOT_HEIGHT
        bounds = rrb.VisualBounds2D(x_range=(-0.1 * w, 1.12 * w), y_range=(-1.35 * h, 1.35 * h))
        components = "u_x red, u_y green, u_z blue" if self._by_component else "bending, magnitude"
        curvature = rrb.Spatial2DView(
            origin="/curvature", name=f"Curvature along the arclength [1/m]: {components}", visual_bounds=bounds
        )
        boundary = tabs(plot("Boundary error, log10 [1/m]", "error/boundary_log10"), plot("linear", "error/boundary"))
        conditioning = plot(
            "Gamma: log10 cond, \u03c3_min" if self._batched else "Gamma: log10 cond violet, \u03c3_min teal",
            "conditioning/condition_log10",
            "conditioning/smallest_singular_value",
        )
        count = plot("Iterations, integrations", "solver/iterations", "solver/integrations", legend=True)
        measured = bool(np.isfinite(block.step_time).any())
        effort = tabs(plot("Time per sample [ms]", "solver/step_time_ms"), count) if measured else count
        given = [spec for spec in self._assembly.input_specs if spec.name in block.inputs.given]
        given = [spec for spec in given if block.inputs.profile(spec.name) is None]
        given.sort(key=lambda spec: spec.name not in _LOADS)
        actuation = [
            plot(f"{spec.name} [{spec.unit}]", f"inputs/{spec.name}", legend=spec.per_rod and len(self._radii) > 1)
            for spec in given
        ]
        text = rrb.TextDocumentView(origin="/description", name="Description")
        if has_reference:
            tip = tabs(plot("Tip error, log10 [mm]", "error/tip_mm_log10"), plot("linear", "error/tip_mm"))
            rows = [tabs(text, *actuation), rrb.Horizontal(boundary, tip), rrb.Horizontal(conditioning, effort), curvature]
        else:
            fourth = [tabs(*actuation)] if actuation else []
            rows = [text, rrb.Horizontal(boundary, conditioning), rrb.Horizontal(effort, *fourth), curvature]
        right = rrb.Vertical(*rows, row_shares=[4.6, 3, 3, 2.7])
        lane = rrb.StateTimelineView(origin="/status", name="Status of each sample")
        return rrb.Blueprint(
            rrb.Vertical(rrb.Horizontal(scene, right, column_shares=[1, 1]), lane, row_shares=[6, 0.75 + 0.25 * self._count]),
            rrb.BlueprintPanel(state="collapsed"),
            rrb.SelectionPanel(state="collapsed"),
            rrb.TimePanel(state="collapsed", timeline="time"),
            auto_layout=False,
            auto_views=False,
        )


def _load(inputs: Inputs, name: str, batch_shape: tuple[int, ...] | None = None) -> FloatArray:
    """A load of the inputs, zero where it was not given or the assembly takes none."""
    value = getattr(inputs, name) if name in inputs.given else np.zeros(3)
    return value if batch_shape is None else np.broadcast_to(value, (*batch_shape, 3))


def _index(steps: NDArray[np.int64], times: FloatArray) -> list[Any]:
    import rerun as rr

    return [rr.TimeColumn("step", sequence=steps), rr.TimeColumn("time", duration=times)]


def _capsules(nodes: FloatArray, radius: float) -> list[Any]:
    """A capsule between two nodes, shape of ``nodes`` (row, node, 3); none where a node is not finite."""
    import rerun as rr

    start, along = nodes[:, :-1], np.diff(nodes, axis=1)
    length = np.linalg.norm(along, axis=-1)
    sound = np.isfinite(length)
    direction = np.divide(along, length[..., None], out=np.zeros_like(along) + [0.0, 0.0, 1.0], where=length[..., None] > 0)[
        sound
    ]
    x, y, z = direction.T
    # the shortest turn from e3; straight down, where it is not unique, half a turn about x
    quaternion = np.stack([-y, x, np.zeros_like(x), 1 + z], axis=-1)
    quaternion[z < -1 + 1e-12] = (1.0, 0.0, 0.0, 0.0)
    quaternion /= np.linalg.norm(quaternion, axis=1, keepdims=True)
    counts = sound.sum(axis=1)
    some = (counts > 0).astype(int)
    # A radius alone is drawn, as a capsule of length 1: a row without capsules must have none.
    return [
        *rr.Capsules3D.columns(lengths=length[sound], translations=start[sound], quaternions=quaternion).partition(counts),
        *rr.Capsules3D.columns(radii=np.full(some.sum(), radius)).partition(some),
    ]


def _strips(strips: FloatArray) -> Any:
    """Line strips (row, [strip,] node, 2 or 3); a strip with a node that is not finite is left out."""
    import rerun as rr

    values = strips if strips.ndim == 4 else strips[:, None]
    sound = np.isfinite(values).all(axis=(2, 3))
    kind = rr.LineStrips2D if values.shape[-1] == 2 else rr.LineStrips3D
    return kind.columns(strips=values[sound].astype(np.float32)).partition(sound.sum(axis=1))


def _quaternions(rotation: FloatArray) -> FloatArray:
    from scipy.spatial.transform import Rotation

    return np.asarray(Rotation.from_matrix(rotation).as_quat()) if len(rotation) else np.zeros((0, 4))


def _bending(curvature: FloatArray) -> FloatArray:
    return np.asarray(np.linalg.norm(curvature[..., :2], axis=-1)[..., None])


def _log10(values: FloatArray) -> FloatArray:
    """NaN at zero: the viewer leaves a gap, where -inf would spoil the axis."""
    return np.asarray(np.log10(values, out=np.full(values.shape, np.nan), where=values > 0))


def _rgba(rgb: int, alpha: int = 0xFF) -> int:
    return rgb << 8 | alpha


def _round_down(value: float) -> float:
    """The largest 1, 2 or 5 times a power of ten that is not above ``value``."""
    power = 10.0 ** math.floor(math.log10(value))
    return max(factor * power for factor in (1, 2, 5) if factor * power <= value * (1 + 1e-12))


def _round_up(value: float) -> float:
    """The value rounded up to two digits."""
    power = 10.0 ** (math.floor(math.log10(value)) - 1)
    return math.ceil(value / power - 1e-9) * power


def _span(values: Sequence[Any]) -> str:
    flat = np.concatenate([np.ravel(value) for value in values])
    low, high = float(flat.min()), float(flat.max())
    return f"{low:.4g}" if low == high else f"{low:.4g} to {high:.4g}"


def _rod_names(rods: Sequence[Rod]) -> list[str]:
    """A name for each rod that no other has."""
    given = [rod.name for rod in rods]
    return [name if name and given.count(name) == 1 else f"rod_{index}" for index, name in enumerate(given)]
