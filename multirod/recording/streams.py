"""Streams of the SDK, opened and given up: of each, and of each blueprint, it keeps threads and megabytes until it is told."""

import threading
import uuid
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, TypeAlias

from multirod.files.whole import written

if TYPE_CHECKING:
    from rerun import RecordingStream
    from rerun.blueprint import Blueprint

    from multirod.recording.viewer import ViewerStream

    Stream: TypeAlias = RecordingStream | ViewerStream

VIEWER_THREAD = "multirod viewer"  # by which one is fed


def new_stream(identity: uuid.UUID | None = None) -> "RecordingStream":
    """A ``rerun.RecordingStream`` of a recording of this package, not connected yet."""
    import rerun as rr

    _clean_up()
    stream = rr.RecordingStream("multirod", recording_id=uuid.uuid4() if identity is None else identity)
    stream.set_log_time_enabled(False)
    return stream


@contextmanager
def whole_file(stream: "RecordingStream", file: Path, blueprint: "Blueprint") -> "Iterator[RecordingStream]":
    """A stream whose recording, which begins with a blueprint, is written to a file at the end: as a whole or not at all.

    It is gathered in memory. The SDK's own writer of files waits for ever where a disk is full, and has
    replaced the file by then.
    """
    gathered = stream.memory_recording()
    made: list[RecordingStream] = []
    log = blueprint._log_to_stream

    def log_to(own: "RecordingStream") -> None:
        made.append(own)
        log(own)

    try:
        vars(blueprint)["_log_to_stream"] = log_to
        stream.send_blueprint(blueprint, make_active=False)
        del vars(blueprint)["_log_to_stream"]
        for own in made:  # the stream that the SDK makes of a blueprint holds itself for ever unless it is disconnected
            own.disconnect()
        with stream:
            yield stream
        with written(file) as part:
            part.write_bytes(gathered.drain_as_bytes())
    finally:
        stream.disconnect()


def _clean_up() -> None:
    """Forget streams that nobody holds any more; not while others are there, whose viewer this would wait for."""
    import rerun as rr

    feeding = any(thread.name == VIEWER_THREAD for thread in threading.enumerate())
    if not feeding and rr.get_global_data_recording() is None:
        rr.bindings.flush_and_cleanup_orphaned_recordings()  # type: ignore[attr-defined]
