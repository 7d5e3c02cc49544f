"""A process that writes what a recorder is handed, so that its loop has the interpreter for itself."""

import os
import pickle
import subprocess
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from pathlib import Path
from threading import Lock
from typing import IO, Any

from multirod.kernels.compiling import start_warp
from multirod.recording.background import Sample
from multirod.recording.passing import Packer, Unpacker
from multirod.recording.target import Goal, Target

# Not ``multiprocessing``, which would run the program's main file once more. A program that is interrupted says when to end.
_START = """
import pickle, signal, sys
signal.signal(signal.SIGINT, signal.SIG_IGN)
sys.path[:] = pickle.load(sys.stdin.buffer)
from multirod.recording.process import main
main()
"""
_ALONE = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
_BREATH = 10  # samples that are packed without a breath: some tens of microseconds
_SIZE = 8  # bytes that say how many follow


class Unfit(Exception):
    """Raised where the process cannot write, and has written nothing."""


class WritingProcess:
    """Has samples written elsewhere. One thread calls ``write``, and later one ``close``.

    The process ends when this one does, however that ends: it finishes its file first.

    Args:
        goal: What is written.
        say: Takes what is to be said of the viewer.
        breathe: Called often, between short pieces of work.

    Attributes:
        begun: Whether it writes, and nobody else may.

    Raises:
        OSError: If no process can be started.
    """

    def __init__(self, goal: Goal, say: Callable[[str], None], breathe: Callable[[], None]) -> None:
        if not Path(sys.executable or "").stem.lower().startswith(("python", "pypy")):
            raise OSError("this interpreter is embedded: there is no Python to start")
        self._say, self._breathe = say, breathe
        self._packer = Packer(goal.instances)
        self._lock = Lock()
        self.begun = self._given_up = self._ended = False
        environment = {**os.environ, **dict.fromkeys(_ALONE, "1")}
        command = [sys.executable, "-P", "-c", _START]
        self._process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, env=environment)
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._to, self._from = self._process.stdin, self._process.stdout
        with suppress(OSError):  # it has ended: what is written first says so
            for message in (sys.path, (_warp_settings(), goal)):
                pickle.dump(message, self._to)
            self._to.flush()

    def write(self, samples: Sequence[Sample]) -> None:
        """Have samples written, and wait until they are.

        Raises:
            Unfit: If it cannot be done there.
            Exception: What went wrong there.
        """
        try:
            message = b"".join(self._packed(samples))
        except Exception:
            if self.begun:
                raise
            raise Unfit from None  # of a robot that cannot be pickled
        if not self.begun:
            if _received(self._from) is None:
                raise Unfit
            with self._lock:
                if self._given_up:
                    raise Unfit
                self.begun = True
        self._ask(message)

    def _packed(self, samples: Sequence[Sample]) -> Iterator[bytes]:
        for k, sample in enumerate(samples, 1):
            yield self._packer.pack(sample)
            if k % _BREATH == 0:
                self._breathe()

    def _ask(self, message: bytes) -> None:
        """Send something, and hear what came of it."""
        answer = None
        with suppress(OSError):
            _send(self._to, message)
            answer = _received(self._from)
        if answer is None:
            self._ended = True
            raise RuntimeError(f"the process that writes the recording has ended, with status {self._process.wait()}")
        said, error = pickle.loads(answer)
        for words in said:
            self._say(words)
        if error is not None:
            raise error

    def give_up_unless_begun(self) -> None:
        """End it if it has not begun: what waits is written sooner without it. Another thread may be in ``write``."""
        with self._lock:
            if not self.begun:
                self._given_up = True
                self._process.kill()

    def close(self) -> None:
        """Have the recording finished, and end the process.

        Raises:
            Exception: What went wrong there.
        """
        try:
            if self.begun and not self._ended:
                self._ask(b"")
        finally:
            self._process.kill()
            self._process.wait()
            with suppress(OSError):  # of what it did not take
                self._to.close()
            self._from.close()


def main() -> None:
    """The process: answers each message, and finishes the recording when there are no more."""
    source, answers = sys.stdin.buffer, os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)
    settings, goal = pickle.load(source)
    _prepare(settings)
    said: list[str] = []
    unpacker, target = Unpacker(), None
    with suppress(BrokenPipeError):
        _send(answers, b"ready")
        while message := _received(source):
            error: BaseException | None = None
            try:
                samples = list(unpacker.samples(message))
                target = target or Target(goal, said.append)
                target.write(samples)
            except BaseException as problem:  # noqa: BLE001
                error = problem if target is not None else Unfit()
            _send(answers, _answer(said, error))
    error = None
    if target is not None:
        try:
            target.close()
        except Exception as problem:  # noqa: BLE001
            error = problem
    with suppress(BrokenPipeError):
        _send(answers, _answer(said, error))


def _prepare(settings: dict[str, Any]) -> None:
    """Import what takes long, before samples come, and find kernels where the other process keeps them."""
    import rerun  # noqa: F401
    import warp
    from scipy.spatial import transform  # noqa: F401

    cache = settings.pop("kernel_cache_dir")
    vars(warp.config).update(settings)
    start_warp()  # which makes a folder of its own below the one it is given
    warp.config.kernel_cache_dir = cache


def _warp_settings() -> dict[str, Any]:
    """What is chosen for Warp, as far as it is plain."""
    import warp

    start_warp()
    plain = (bool, int, float, str, type(None))
    return {name: value for name, value in vars(warp.config).items() if name[0] != "_" and isinstance(value, plain)}


def _answer(said: list[str], error: BaseException | None) -> bytes:
    words = [said.pop(0) for _ in range(len(said))]
    try:
        answer = pickle.dumps((words, error))
        pickle.loads(answer)
    except Exception:  # noqa: BLE001  (whatever an exception of another package is made of)
        answer = pickle.dumps((words, RuntimeError(f"{type(error).__name__}: {error}")))
    return answer


def _send(stream: IO[bytes], message: bytes) -> None:
    stream.write(len(message).to_bytes(_SIZE, "little"))
    stream.write(message)
    stream.flush()


def _received(stream: IO[bytes]) -> bytes | None:
    """The next message; None where there is none, as the other side has ended."""
    size = stream.read(_SIZE)
    if len(size) < _SIZE:
        return None
    return stream.read(int.from_bytes(size, "little"))
