"""A stream to a viewer that may take what it is sent slowly, or not at all."""

import atexit
import socket
from collections.abc import Callable
from queue import Full, Queue
from threading import Thread
from typing import TYPE_CHECKING, Any
from urllib.parse import urlsplit

from multirod.recording.streams import VIEWER_THREAD
from multirod.warning import warn

if TYPE_CHECKING:
    from rerun import RecordingStream
    from rerun.blueprint import Blueprint

_KNOCK = 0.4  # seconds that a viewer has to let itself be reached
_START = "start one with `rerun`, which listens at rerun+http://127.0.0.1:9876/proxy"
WAITING = 20_000  # calls that wait to be sent at most; a sample of a few rods makes some tens when it is flushed


class ViewerStream:
    """A Rerun stream to a viewer, fed by a thread of its own.

    The SDK's calls wait without end for a viewer that does not read: once 50 MB are under way, when it disconnects, and as
    the process ends. Here nobody waits: what does not fit in is left out, ``disconnect`` gives up after a while, and both say so.

    Args:
        stream: The ``rerun.RecordingStream``, not connected yet.
        address: Of the viewer.
        patience: That ``disconnect`` has with a viewer that listens [s].
        say: Takes what is to be said of it from whatever thread; by default it is a warning there.
    """

    def __init__(
        self, stream: "RecordingStream", address: str, patience: float, say: Callable[[str], None] | None = None
    ) -> None:
        self._stream, self._address, self._patience = stream, address, patience
        self._say = _warn if say is None else say
        self._calls: Queue[tuple[str, tuple[Any, ...], dict[str, Any]]] = Queue(WAITING)
        self._left_out = False
        stream.connect_grpc(address)
        self._thread = Thread(target=self._feed, name=VIEWER_THREAD, daemon=True)
        self._thread.start()

    def _feed(self) -> None:
        name = ""
        while name != "disconnect":
            name, arguments, options = self._calls.get()
            getattr(self._stream, name)(*arguments, **options)

    def _call(self, name: str, *arguments: object, **options: object) -> None:
        try:
            self._calls.put_nowait((name, arguments, options))
        except Full:
            if not self._left_out:
                self._left_out = True
                self._say(f"the viewer at {self._address} does not keep up: samples are left out")

    def log(self, *arguments: object, **options: object) -> None:
        """As the stream's own."""
        self._call("log", *arguments, **options)

    def send_columns(self, *arguments: object) -> None:
        """As the stream's own."""
        self._call("send_columns", *arguments)

    def send_recording_name(self, name: str) -> None:
        """As the stream's own."""
        self._call("send_recording_name", name)

    def send_blueprint(self, blueprint: "Blueprint") -> None:
        """As the stream's own."""
        self._call("send_blueprint", blueprint)

    def disconnect(self) -> None:
        """Wait until the viewer has everything, as long as there is patience; not at all for one that is not there."""
        absent = not listens(self._address)
        patience = _KNOCK if absent else self._patience
        try:
            self._calls.put(("disconnect", (), {}), timeout=patience)
        except Full:
            pass
        else:
            self._thread.join(patience)
        if not self._thread.is_alive():
            return
        _exit_without_waiting(patience)
        if absent:
            self._say(f"no viewer listens at {self._address}: it has nothing of the recording, or not its end; {_START}")
        else:
            self._say(
                f"the viewer at {self._address} has not taken the whole recording within {self._patience:g} s: "
                "its last samples, or all of them, are lost there"
            )


def listens(address: str) -> bool:
    """Whether something can be reached at the address; where it names no port, that is not tried."""
    parts = urlsplit(address)
    try:
        host, port = parts.hostname, parts.port
    except ValueError:  # such a port there is not
        return True
    if host is None or port is None:
        return True
    try:
        socket.create_connection((host, port), timeout=_KNOCK).close()
    except OSError:
        return False
    return True


def _warn(message: str) -> None:
    warn(message, RuntimeWarning)


def _exit_without_waiting(patience: float) -> None:
    """Let the process end though a viewer does not answer: the SDK's own end waits for it."""
    import rerun as rr

    rr.unregister_shutdown()
    atexit.unregister(_flush_other)
    atexit.register(_flush_other, patience)


def _flush_other(patience: float) -> None:
    """What the SDK's end would do for the program's own recording; those of recorders are written when they are closed."""
    import rerun as rr

    other = rr.get_global_data_recording()
    if other is not None:
        other.flush(timeout_sec=patience)
