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
import warnings
from collections.abc import Sequence
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from multirod.assembly import Assembly
from multirod.inputs import Inputs
from multirod.problem import Shape
from multirod.rod import Rod
from multirod.solution import History, Solution
from multirod.status import Status
from multirod.validation import FloatArray, finite_float, positive_float, positive_int, refuse

_ROWS = 1000
_CONNECT_TIMEOUT = 0.5

# Picked to be told apart on the viewer's dark theme.
_PALETTE = (0x4FC3F7, 0xFFB74D, 0x81C784, 0xF06292, 0xBA9CFF, 0xFFF176, 0x4DB6AC, 0xFF8A65)
_AXIS_COLORS = (0xFF6B6B, 0x69DB7C, 0x74A9FF)
_FORCE_COLOR = 0xFFD43B
_FOLLOWER_COLOR = 0xFF922B
_REFERENCE_COLOR = 0xB0B8C4
_AXIS_LINE_COLOR = 0x8A929C
_STATUS_COLORS = {
    Status.NOT_RUN: 0x868E96,
    Status.CONVERGED: 0x2F9E44,
    Status.TRACKING: 0x1C7ED6,
    Status.NEAR_FOLD: 0xF08C00,
    Status.EULER_LIMIT: 0xE8590C,
}
_FAILURE_COLOR = 0xE03131

# The curvature plot in its own units: 2D views keep the aspect ratio, so arclength and curvature are both scaled to fit.
_PLOT_WIDTH, _PLOT_HEIGHT = 4.0, 1.0


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
    writer = _Writer(stream, node_count=node_count, force_scale=scale, live=False)
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
        self._streams_to_viewer = address is not None
        self._stream: Any = rr.RecordingStream("multirod", recording_id=uuid.uuid4())
        self._stream.set_log_time_enabled(False)
        sinks: list[Any] = [] if file is None else [rr.FileSink(file)]
        if address is not None:
            sinks.append(rr.GrpcSink(address))
        self._stream.set_sinks(*sinks)
        self._writer = _Writer(self._stream, node_count=node_count, force_scale=scale, live=True)

    def log(
        self, time: float, solution: Solution, *, step_time: float | None = None, reference: Solution | None = None
    ) -> None:
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
                self._stream.send_recording_name(self._name)
                self._stream.send_blueprint(blueprint)
                self._writer.write_static()
            self._writer.write(block, other, np.arange(self._count, self._count + len(times)))
            self._count += len(times)
        if not self._streams_to_viewer:
            self._stream.flush()

    def close(self) -> None:
        """Write what is pending and finish the file."""
        if self._closed:
            return
        self._closed = True
        try:
            self.flush()
        finally:
            self._stream.disconnect()

    def __enter__(self) -> "Recorder":
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
    values: dict[str, Any] = dict(first.inputs.profiles)
    for name in first.inputs.given:
        if name not in values:
            rows = [getattr(solution.inputs, name) for solution in solutions]
            values[name] = np.stack([np.broadcast_to(row, (*first.batch_shape, row.shape[-1])) for row in rows])
    return _history(
        first,
        first.assembly.inputs(**values),
        (len(solutions), *first.batch_shape),
        records=np.concatenate([solution._records for solution in solutions]),
        status=np.concatenate([solution._status for solution in solutions]),
        iterations=np.concatenate([solution._iterations for solution in solutions]),
        integrations=np.concatenate([solution._integrations for solution in solutions]),
        residual=np.concatenate([np.reshape(solution.residual, -1) for solution in solutions]),
        times=times,
        durations=durations,
    )


def _stackable(pending: tuple[float, Solution, float, Solution | None], solution: Solution, reference: Solution | None) -> bool:
    """Whether a sample can be part of the same batch as the one before: same unknowns, same inputs by name."""

    def same(one: Solution | None, other: Solution | None) -> bool:
        if one is None or other is None:
            return one is other
        return (
            one._fields == other._fields
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

    def cut(values: Any) -> Any:
        kept = np.reshape(values, (samples, total, *np.shape(values)[1:]))[:, :count]
        return kept.reshape(-1, *kept.shape[2:])

    inputs: dict[str, Any] = dict(history.inputs.profiles)
    for name in history.inputs.given:
        if name not in inputs:
            value = getattr(history.inputs, name)
            full = np.broadcast_to(value, (*history.batch_shape, value.shape[-1]))
            inputs[name] = full.reshape(samples, total, -1)[:, :count]
    return _history(
        history,
        history.assembly.inputs(**inputs),
        (samples, min(count, total)),
        records=cut(history._records),
        status=cut(history._status),
        iterations=cut(history._iterations),
        integrations=cut(history._integrations),
        residual=cut(np.reshape(history.residual, -1)),
        times=history.time,
        durations=history.step_time,
    )


def _history(like: Solution, inputs: Inputs, batch_shape: tuple[int, ...], *, times: Any, durations: Any, **arrays: Any) -> History:
    return History(
        like.assembly,
        inputs,
        batch_shape,
        integrator=like._integrator,
        device=like._device,
        fields=like._fields,
        time=times,
        step_time=durations,
        **arrays,
    )


class _Writer:
    """Turns blocks of samples into columns. ``prepare`` comes first: it fixes the scales and makes the layout."""

    def __init__(self, stream: Any, *, node_count: int, force_scale: float | None, live: bool) -> None:
        self._stream = stream
        self._node_count = node_count
        self._force_scale = force_scale
        self._live = live
        self._last_tip: dict[str, FloatArray] = {}
        self._last_status: dict[str, str] = {}
        self._curvature_limit = 0.0

    def prepare(self, block: History, reference: History | None, title: str, solver: str, total: int) -> Any:
        """Fix names and scales by the first block, and return the layout."""
        self._assembly = assembly = block.assembly
        self._batched = len(block.batch_shape) > 1
        self._count = math.prod(block.batch_shape[1:]) if not assembly.batch_shape else min(4, math.prod(block.batch_shape[1:]))
        self._rod_names = _rod_names(assembly.rods)
        self._lengths = [float(np.max(rod.length)) for rod in assembly.rods]
        self._radii = [
            0.004 * length if rod.outer_diameter is None else 0.5 * rod.outer_diameter
            for rod, length in zip(assembly.rods, self._lengths, strict=True)
        ]
        self._bases = np.reshape(getattr(assembly, "base", np.eye(4)), (-1, 4, 4))[:16]
        points = [self._bases[:, :3, 3]]
        if self._live:
            reach = 0.5 * max(self._lengths)
            points += [points[0] - reach, points[0] + reach]
        for index in range(len(assembly.rods)):
            points.append(block.rod(index, nodes=self._node_count).position.reshape(-1, 3))
        everything = np.concatenate(points)
        everything = everything[np.isfinite(everything).all(axis=1)]
        self._low, self._high = everything.min(axis=0), everything.max(axis=0)
        self._size = max(float(np.linalg.norm(self._high - self._low)), 1e-6)
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
        forces = [np.linalg.norm(_load(block.inputs, name), axis=-1).max() for name in ("tip_force", "follower_force")]
        return _round_down(0.25 * self._size / max(forces)) if max(forces) > 0 else 1.0

    def write_static(self) -> None:
        """Write what does not change with time: description, frames, colours and names of series."""
        import rerun as rr

        def put(path: str, *archetypes: Any) -> None:
            self._stream.log(path, *archetypes, static=True)

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
                put(path, rr.Capsules3D.from_fields(radii=radius, colors=color, fill_mode=rr.components.FillMode.Solid))
                path = self._rod("reference/rods", k, index)
                put(path, rr.LineStrips3D.from_fields(radii=0.4 * radius, colors=_rgba(_REFERENCE_COLOR, 0xC0)))
            stroke = 0.0015 * self._size
            put(self._world("tip_path", k), rr.LineStrips3D.from_fields(radii=stroke, colors=_rgba(0xFFFFFF, 0x90)))
            put(self._world("reference/tip_path", k), rr.LineStrips3D.from_fields(radii=0.6 * stroke, colors=_rgba(_REFERENCE_COLOR)))
            put(self._world("platform", k), rr.LineStrips3D.from_fields(radii=2 * stroke, colors=_rgba(0xDEE2E6)))
            for name, shade in (("tip_force", _FORCE_COLOR), ("follower_force", _FOLLOWER_COLOR)):
                put(self._world(f"loads/{name}", k), rr.Arrows3D.from_fields(radii=2 * stroke, colors=_rgba(shade)))
