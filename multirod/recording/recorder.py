"""What writes recordings: ``save`` for a finished history, ``Recorder`` for a control loop."""

import math
import os
import weakref
from collections.abc import Sequence
from contextlib import suppress
from threading import RLock
from types import TracebackType
from typing import Self

import numpy as np

from multirod.assembly import Assembly
from multirod.exclusive import Uncopied
from multirod.naming import names_checked
from multirod.recording.background import Sample, WritingThread
from multirod.recording.coloring import Coloring
from multirod.recording.process import Unfit, WritingProcess
from multirod.recording.samples import first_instances
from multirod.recording.streams import new_stream, whole_file
from multirod.recording.target import Goal, Target
from multirod.recording.writer import Writer
from multirod.results.history import History
from multirod.results.solution import Solution
from multirod.types import Numbers
from multirod.validation import choice, file_path, finite_float, positive_float, positive_int, refuse
from multirod.warning import warn

ENDING = ".rrd"
LONGEST = 9e9  # seconds: nanoseconds are counted in 64 bits
LARGEST_SCALE = 1e30  # geometry is single precision


@names_checked
def save(
    path: str | os.PathLike[str],
    history: History,
    *,
    reference: History | None = None,
    reference_name: str = "reference",
    name: str | None = None,
    nodes: int = 51,
    instances: int = 4,
    force_scale: float | None = None,
    colour_by: str | Numbers | None = None,
) -> None:
    """Write a recording of ``history``, with a layout that opens ready to read.

    Args:
        path: File to write (``.rrd``); an existing one is replaced.
        history: What to record. Of a batch, the first ``instances`` are recorded, each as entities of its own.
        reference: The same samples of another run, which is drawn in grey: by a method that is trusted, or of another robot. The
            distance between the tips is recorded, and where both have as many rods, that between them along their arclength.
        reference_name: What the reference is called.
        name: What the viewer calls the recording; by default the file's name.
        nodes: Nodes that a rod is drawn with.
        instances: How many instances of a batch are recorded.
        force_scale: Length of force arrows [m/N]; by default the largest arrow is about a quarter of the robot's size.
        colour_by: What colours the rods, which are otherwise told apart: a quantity of each solution, such as ``"residual"``,
            ``"condition"``, ``"energy"`` or ``"stability_margin"``, or an array that broadcasts to the history's leading axes.

    Raises:
        TypeError: If ``history`` or ``reference`` is not a ``History``.
        ValueError: If ``reference`` has other samples, or another argument is out of range.
    """
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
    if not math.prod(history.batch_shape):
        refuse("save.history", history, "must have a sample, of an instance")
    if np.abs(history.time).max() > LONGEST:
        refuse("save.history", history, f"its times must be within {LONGEST:g} s of zero")
    title = _name("save.name", name, file.stem)
    other_name = _name("save.reference_name", reference_name, "")

    block = first_instances(history, count)
    other = None if reference is None else first_instances(reference, count)
    coloring = None if colour_by is None else Coloring.of(colour_by, history, block)
    total = math.prod(history.batch_shape[1:])
    stream = new_stream()
    writer = Writer([stream], node_count=node_count, instances=count, force_scale=scale, live=False)
    blueprint = writer.prepare(block, other, title, history.description, total, reference_name=other_name, coloring=coloring)
    with whole_file(stream, file, blueprint):
        stream.send_recording_name(title)
        writer.write_static()
        writer.write(block, other, np.arange(len(history.time)))


class _Recording:
    """What a recorder's thread does; it knows nothing of the recorder, which may be forgotten meanwhile."""

    def __init__(self, goal: Goal, together: int) -> None:
        self._goal = goal
        self._target: Target | None = None
        self._process: WritingProcess | None = None
        self.thread = WritingThread(self.write, together)
        with suppress(OSError):
            self._process = WritingProcess(goal, self.thread.say, self.thread.breathe)

    def write(self, samples: Sequence[Sample]) -> None:
        """Have samples written by the process, or write them here where there is none; on the thread."""
        if self._process is not None:
            try:
                self._process.write(samples)
            except Unfit:
                self._process.close()
                self._process = None
            else:
                return
        if self._target is None:
            self._target = Target(self._goal, self.thread.say, self.thread.breathe)
        self._target.write(samples)

    def close(self) -> None:
        """Write what waits and finish the file; wait for a viewer no longer than there is patience for."""
        process = self._process
        if process is not None:
            process.give_up_unless_begun()
        self.thread.close()
        if process is not None:
            process.close()
            if process.begun:
                return
        if self._target is None:
            self._target = Target(self._goal, self.thread.say)
        self._target.close()

    def end(self) -> None:
        """The same for a recorder that nobody closed: what is to be said is said here."""
        self.close()
        self.thread.speak()


class Recorder(Uncopied):
    """Records a control loop sample by sample, to a file, to a viewer, or to both.

    ``log`` hands a sample over and returns within some tens of microseconds: a process of the recorder integrates shapes and
    writes, several samples at once. Where it does not keep up, samples wait for it in memory; beyond 256 MB they are left out, or
    ``log`` waits, as ``when_full`` says. What is left out is counted, and a ``RuntimeWarning`` says so. What goes wrong where
    samples are written is raised by the next ``log``, ``flush`` or ``close``; after that nothing more is recorded.

    That process begins within a second or two; samples wait for it. A recorder that is closed before then writes what waits
    itself, and a thread of the recorder writes where no process can: for robots of classes that another process does not know,
    such as those of the program's main file, and in programs that embed Python.

    ``flush`` waits until all that was logged is in the file. ``with`` writes what waits whatever exception ends the block, and so
    does the end of the program. Of a program that is killed, the file is finished all the same, with all samples up to the last
    few tenths of a second, and at least those that were flushed.

    The view is framed by what the robot can reach, and widened where it leaves that. Arrows of forces are drawn to a scale from
    the robot's stiffness, which is halved for all samples, also those before, where a larger force comes; the legend states it.
    When the recorder is closed, the file is given the frame and the scale that fit what was recorded.

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
        flush_every: Samples that are written together; they wait for each other some tenths of a second at most.
        nodes: Nodes that a rod is drawn with.
        instances: How many instances of a batch are recorded.
        force_scale: Length of force arrows [m/N]; by default three tenths of the length in use for a force that bends the robot
            by about a radian, ``2 EI/L^2``, ``EI`` of all rods.
        close_timeout: How long ``close`` waits for a viewer that listens to take what is left [s].
        when_full: Where too many samples wait: ``"leave_out"`` the newest, for a control loop, or ``"wait"``, for a program that
            must lose none.

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
        when_full: str = "leave_out",
    ) -> None:
        if path is None and address is None:
            raise TypeError("Recorder needs a path, an address, or both")
        file = None if path is None else file_path("Recorder.path", path, ENDING).absolute()
        if address is not None and not (isinstance(address, str) and address.startswith(("rerun://", "rerun+http"))):
            refuse("Recorder.address", address, "must be a viewer's address such as 'rerun+http://127.0.0.1:9876/proxy'")
        if not isinstance(description, str):
            refuse("Recorder.description", description, "must be a string")
        title = _name("Recorder.name", name, "multirod" if file is None else file.stem)
        together = positive_int("Recorder.flush_every", flush_every)
        goal = Goal(
            file=file,
            address=address,
            patience=positive_float("Recorder.close_timeout", close_timeout),
            title=title,
            description=description,
            instances=positive_int("Recorder.instances", instances),
            node_count=positive_int("Recorder.nodes", nodes, 2),
            force_scale=_force_scale("Recorder.force_scale", force_scale),
        )
        self._waits = choice("Recorder.when_full", when_full, ("leave_out", "wait")) == "wait"
        self._step = 0
        self._left_out = 0
        self._last_time = -math.inf
        self._assembly: Assembly | None = None
        self._batch_shape: tuple[int, ...] = ()
        self._closed = False
        self._lock = RLock()
        if file is not None:
            file.write_bytes(b"")  # what cannot be written is said here
        self._recording = _Recording(goal, together)
        self._thread = self._recording.thread
        self._forgotten = weakref.finalize(self, self._recording.end)

    @property
    def left_out(self) -> int:
        """Samples that were not recorded, as too many waited."""
        return self._left_out

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
            RuntimeError: If the recorder is closed, or has stopped after an error.
            Exception: What went wrong where samples before were written.
        """
        with self._lock:
            if self._closed:
                raise RuntimeError("Recorder.log: the recorder is closed")
            now, duration = self._checked(time, solution, step_time, reference)
            sample = Sample(self._step, now, solution, duration, reference, math.prod(solution.batch_shape))
            taken = self._thread.put(sample, wait=self._waits)
            self._last_time = now
            self._step += 1
            if taken:
                return
            self._left_out += 1
            if self._left_out == 1:
                warn(f"the recorder does not keep up: samples are left out, the first at {now:g} s", RuntimeWarning)

    def _checked(
        self, time: float, solution: Solution, step_time: float | None, reference: Solution | None
    ) -> tuple[float, float]:
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
                own = "; give its .solution" if isinstance(getattr(value, "solution", None), Solution) else ""
                raise TypeError(f"Recorder.log.{field} takes the Solution of one sample, not {type(value).__name__}{own}")
            if self._assembly is None:
                self._assembly, self._batch_shape = value.assembly, value.batch_shape
            if field == "solution" and value.assembly is not self._assembly:
                refuse("Recorder.log.solution", value, "must be of the robot of the first sample")
            if value.batch_shape != self._batch_shape:
                refuse(f"Recorder.log.{field}", value, f"must have the leading axes of the first sample, {self._batch_shape}")
        return now, duration

    def flush(self) -> None:
        """Wait until all samples that were logged are written.

        Raises:
            Exception: What went wrong where they were written.
        """
        with self._lock:
            if not self._closed:
                self._thread.flush()

    def close(self) -> None:
        """Write what waits and finish the file; wait for a viewer that listens no longer than ``close_timeout``.

        Raises:
            Exception: What went wrong where samples were written, if it was not raised before.
        """
        with self._lock:
            if self._closed:
                return
            self._closed = True
            self._forgotten.detach()
            self._recording.close()
            if self._left_out:
                warn(
                    f"the recorder did not keep up: {self._left_out} of {self._step} samples were left out",
                    RuntimeWarning,
                )
            self._thread.speak()

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
