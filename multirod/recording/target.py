"""A file, a viewer, or both, that samples are written to as they come."""

import os
import uuid
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from multirod.recording.background import Sample
from multirod.recording.samples import first_instances, remarks, stackable
from multirod.recording.streams import new_stream
from multirod.recording.viewer import ViewerStream
from multirod.recording.writer import Writer
from multirod.results.history import stack


@dataclass(frozen=True, kw_only=True)
class Goal:
    """What a recorder was asked for; it can be pickled.

    Attributes:
        file: To write; None for none.
        address: Of a viewer; None for none.
        patience: With a viewer that listens, at the end [s].
        title: What the viewer calls the recording.
        description: What is run.
        instances: Of a batch that are recorded.
        node_count: Nodes of a rod.
        force_scale: Of arrows [m/N]; None to choose it.
    """

    file: os.PathLike[str] | None
    address: str | None
    patience: float
    title: str
    description: str
    instances: int
    node_count: int
    force_scale: float | None


class Target:
    """Opens what samples are written to, and writes them; it knows nothing of the recorder, which may be forgotten meanwhile.

    Args:
        goal: What it is.
        say: Takes what is to be said of the viewer, from whatever thread.
        breathe: Called often, between short pieces of work.
    """

    def __init__(self, goal: Goal, say: Callable[[str], None], breathe: Callable[[], None] = lambda: None) -> None:
        self._goal = goal
        self._count = 0
        # Not one stream with two sinks: flushing the file would then wait for a viewer that may not be there.
        identity = uuid.uuid4()
        self._file_stream: Any = None
        self._streams: list[Any] = []
        if goal.file is not None:
            self._file_stream = new_stream(identity)
            self._file_stream.save(goal.file)
            self._streams.append(self._file_stream)
        if goal.address is not None:
            self._streams.append(ViewerStream(new_stream(identity), goal.address, goal.patience, say))
        self._writer = Writer(
            self._streams,
            node_count=goal.node_count,
            instances=goal.instances,
            force_scale=goal.force_scale,
            live=True,
            breathe=breathe,
        )

    def write(self, samples: Sequence[Sample]) -> None:
        """Write samples in runs of those that can be one batch."""
        run = [samples[0]]
        for sample in samples[1:]:
            if not stackable(run[-1], sample):
                self._write_run(run)
                run = []
            run.append(sample)
        self._write_run(run)
        if self._file_stream is not None:
            try:
                self._file_stream.flush()
            except RuntimeError as error:  # the thread of the SDK has ended
                raise OSError(f"{self._goal.file} cannot be written, as where a disk is full: {error}") from error

    def _write_run(self, samples: Sequence[Sample]) -> None:
        times = np.array([sample.time for sample in samples])
        durations = np.array([sample.step_time for sample in samples])
        block = stack([sample.solution for sample in samples], times, durations)
        references = [sample.reference for sample in samples if sample.reference is not None]
        other = stack(references, times, durations) if references else None
        block = first_instances(block, self._goal.instances)
        other = None if other is None else first_instances(other, self._goal.instances)
        said = remarks(samples)
        if self._count == 0:
            total = samples[0].total
            blueprint = self._writer.prepare(block, other, self._goal.title, self._goal.description, total, remarks=said)
            for stream in self._streams:
                stream.send_recording_name(self._goal.title)
                stream.send_blueprint(blueprint)
            self._writer.write_static()
        self._writer.write(block, other, np.array([sample.step for sample in samples]), said)
        self._count += len(samples)

    def close(self) -> None:
        """Finish the file; wait for a viewer no longer than there is patience for."""
        try:
            if self._count:
                blueprint = self._writer.finish()
                if self._file_stream is not None:
                    self._file_stream.send_blueprint(blueprint)
        finally:
            for stream in self._streams:
                stream.disconnect()
