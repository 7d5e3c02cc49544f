"""What writes recordings: ``save`` for a finished history, ``Recorder`` for a control loop."""

import math
import os
import uuid
from threading import RLock
from types import TracebackType
from typing import Any, Self

import numpy as np

from multirod.assembly import Assembly
from multirod.exclusive import Uncopied
from multirod.recording.samples import first_instances, stack, stackable
from multirod.recording.viewer import ViewerStream
from multirod.recording.writer import Writer
from multirod.solution import History, Solution
from multirod.validation import file_path, finite_float, positive_float, positive_int, refuse

ENDING = ".rrd"
LONGEST = 9e9  # seconds: nanoseconds are counted in 64 bits
LARGEST_SCALE = 1e30  # geometry is single precision


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

    file = file_path("save.path", path, ENDING)
    if not isinstance(history, History):
        raise TypeError(f"save takes a History, not {type(history).__name__}")
    if reference is not None:
        if not isinstance(reference, History):
            raise TypeError(f"save.reference takes a History, not {type(reference).__name__}")
        if reference.batch_shape != history.batch_shape or not np.allclose(reference.time, history.time, rtol=0, atol=1e-9):
            refuse("save.reference", reference, f"must have the samples of the history, {history!r}")
    node_count = positive_int("save.nodes", nodes, 2)
    count = positive_int("save.instances", instances)
    scale = _force_scale("save.force_scale", force_scale)
    if np.abs(history.time).max() > LONGEST:
        refuse("save.history", history, f"its times must be within {LONGEST:g} s of zero")
    title = _name("save.name", name, file.stem)

    block = first_instances(history, count)
    other = None if reference is None else first_instances(reference, count)
    total = math.prod(history.batch_shape[1:])
    stream = rr.RecordingStream("multirod", recording_id=uuid.uuid4())
    stream.set_log_time_enabled(False)
    writer = Writer([stream], node_count=node_count, instances=count, force_scale=scale, live=False)
    blueprint = writer.prepare(block, other, title, history.description, total)
    stream.save(file, default_blueprint=blueprint)
    with stream:
        stream.send_recording_name(title)
        writer.write_static()
        writer.write(block, other, np.arange(len(history.time)))


class Recorder(Uncopied):
    """Records a control loop sample by sample, to a file, to a viewer, or to both.

    Samples are kept until there are ``flush_every`` of them, then written together: shapes are integrated as one batch
    and rows are sent as columns, so that a sample costs little. The first sample is written at once; where the kernel
    for shapes is not in Warp's cache yet, that is when it is compiled.

    A run that is killed leaves a readable file. ``with`` writes what is pending whatever exception ends the block.
    SIGKILL loses at most the last ``flush_every`` samples, and so does SIGTERM, unless the program turns it into an
    exception: ``signal.signal(signal.SIGTERM, lambda *_: sys.exit(143))``.

    The layout is made for the first sample: give it a ``reference`` if later ones have it. Threads may share a recorder: they
    log one after another, and the times of their samples increase all the same.

    Example::

        with Recorder("run.rrd") as recorder:
            for k in range(1000):
                solution = tracker.step(rotation=angle(k * dt))
                recorder.log(k * dt, solution)

    Args:
        path: File to write (``.rrd``); an existing one is replaced.
        address: Viewer to stream to, such as ``"rerun+http://127.0.0.1:9876/proxy"``. If none listens there, or it does not
            answer, the loop goes on; what it does not take is lost, and a ``RuntimeWarning`` says so.
        name: What the viewer calls the recording; by default the file's name.
        description: What is run, such as ``repr(solver)``, for the description panel.
        flush_every: Samples that are written together.
        nodes: Nodes that a rod is drawn with.
        instances: How many instances of a batch are recorded.
        force_scale: Length of force arrows [m/N]; by default half of the length in use for ``EI/L^2``, ``EI`` of all rods.
        close_timeout: How long ``close`` waits for the viewer to take what is left [s].

    Raises:
        TypeError: If neither ``path`` nor ``address`` is given.
        ValueError: If an argument is out of range.
    """

    instead = "make a new Recorder with a path of its own"

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
        close_timeout: float = 10.0,
    ) -> None:
        import rerun as rr

        if path is None and address is None:
            raise TypeError("Recorder needs a path, an address, or both")
        file = None if path is None else file_path("Recorder.path", path, ENDING)
        if address is not None and not (isinstance(address, str) and address.startswith(("rerun://", "rerun+http"))):
            refuse("Recorder.address", address, "must be a viewer's address such as 'rerun+http://127.0.0.1:9876/proxy'")
        if not isinstance(description, str):
            refuse("Recorder.description", description, "must be a string")
        self._name = _name("Recorder.name", name, "multirod" if file is None else file.stem)
        self._description = description
        self._flush_every = positive_int("Recorder.flush_every", flush_every)
        self._instances = positive_int("Recorder.instances", instances)
        node_count = positive_int("Recorder.nodes", nodes, 2)
        scale = _force_scale("Recorder.force_scale", force_scale)
        patience = positive_float("Recorder.close_timeout", close_timeout)
        self._pending: list[tuple[float, Solution, float, Solution | None]] = []
        self._count = 0
        self._last_time = -math.inf
        self._assembly: Assembly | None = None
        self._batch_shape: tuple[int, ...] = ()
        self._closed = False
        self._lock = RLock()
        # Not one stream with two sinks: flushing the file would then wait for a viewer that may not be there.
        identity = uuid.uuid4()
        self._file_stream: Any = None
        self._streams: list[Any] = []
        if file is not None:
            self._file_stream = rr.RecordingStream("multirod", recording_id=identity)
            self._file_stream.set_log_time_enabled(False)
            self._file_stream.save(file)
            self._streams.append(self._file_stream)
        if address is not None:
            viewer_stream = rr.RecordingStream("multirod", recording_id=identity)
            viewer_stream.set_log_time_enabled(False)
            self._streams.append(ViewerStream(viewer_stream, address, patience))
        self._writer = Writer(self._streams, node_count=node_count, instances=self._instances, force_scale=scale, live=True)

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
        with self._lock:
            self._log(time, solution, step_time, reference)

    def _log(self, time: float, solution: Solution, step_time: float | None, reference: Solution | None) -> None:
        if self._closed:
            raise RuntimeError("Recorder.log: the recorder is closed")
        now = finite_float("Recorder.log.time", time)
        if now <= self._last_time:
            refuse("Recorder.log.time", time, f"must be later than the sample before, {self._last_time:g} s")
        duration = math.nan if step_time is None else positive_float("Recorder.log.step_time", step_time)
        for field, number in (("time", now), ("step_time", duration)):
            if abs(number) > LONGEST:
                refuse(f"Recorder.log.{field}", number, f"must be within {LONGEST:g} s of zero")
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
        if self._pending and not stackable(self._pending[-1], solution, reference):
            self.flush()
        self._pending.append((now, solution, duration, reference))
        if self._count == 0 or len(self._pending) >= self._flush_every:
            self.flush()

    def flush(self) -> None:
        """Write the samples that are pending."""
        with self._lock:
            self._flush()

    def _flush(self) -> None:
        if self._pending:
            times = np.array([sample[0] for sample in self._pending])
            durations = np.array([sample[2] for sample in self._pending])
            block = stack([sample[1] for sample in self._pending], times, durations)
            references = [sample[3] for sample in self._pending if sample[3] is not None]
            other = stack(references, times, durations) if references else None
            self._pending = []
            block = first_instances(block, self._instances)
            other = None if other is None else first_instances(other, self._instances)
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
        """Write what is pending and finish the file; wait for a viewer no longer than ``close_timeout``."""
        with self._lock:
            if self._closed:
                return
            self._closed = True
            try:
                self._flush()
            finally:
                for stream in self._streams:
                    stream.disconnect()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self.close()


def _force_scale(field: str, value: object) -> float | None:
    scale = None if value is None else positive_float(field, value)
    if scale is not None and scale > LARGEST_SCALE:
        refuse(field, value, f"must be > 0 and <= {LARGEST_SCALE:g}")
    return scale


def _name(field: str, name: object, default: str) -> str:
    if name is None:
        return default
    if not isinstance(name, str) or not name:
        refuse(field, name, "must be a non-empty string")
    return name
