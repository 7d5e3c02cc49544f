"""A thread that writes the samples of a recorder, so that its loop does not."""

import time
from collections import deque
from collections.abc import Callable, Sequence
from threading import Condition, RLock, Thread
from typing import NamedTuple

from multirod.results.solution import Solution
from multirod.warning import warn

WAITING = 256_000_000  # bytes of samples that wait to be written at most
_OVERHEAD = 4_000  # bytes of a sample besides its records, about
_TOGETHER = 100  # samples that are written at once at most, where more wait: the interpreter is not held for long
_PATIENCE = 0.2  # seconds that a sample waits at most for others to be written with
_BREATH = 1e-4  # seconds in which another thread surely gets the interpreter


class Sample(NamedTuple):
    """What is recorded of one sample: a solution's arrays are its own, so that it may be read later.

    Attributes:
        step: Its number.
        time: [s].
        solution: Its equilibrium or estimate.
        step_time: How long it took [s]; NaN if that is not known.
        reference: The same from a method that is trusted.
        total: Instances of its batch.
    """

    step: int
    time: float
    solution: Solution
    step_time: float
    reference: Solution | None
    total: int

    @property
    def size(self) -> int:
        """Bytes that it holds, about."""
        own = self.solution._records.nbytes
        return _OVERHEAD + (own if self.reference is None else own + self.reference._records.nbytes)


class WritingThread:
    """Samples on their way to a recording. Whoever puts them never writes, and waits only where asked to.

    Errors and warnings of the thread come out where samples are put, flushed or closed. After an error nothing more is written.

    Args:
        write: Writes samples, on the thread.
        together: Samples that are written at once, unless one has waited for some tenths of a second.
    """

    def __init__(self, write: Callable[[Sequence[Sample]], None], together: int) -> None:
        self._write, self._together = write, together
        self._waiting: deque[Sample] = deque()
        self._size = 0
        self._taken = self._written = self._put = 0
        self._hurry = 0
        self._closed = False
        self._error: BaseException | None = None
        self._raised = False
        self._said: list[str] = []
        self._changed = Condition(RLock())
        self._thread = Thread(target=self._run, name="multirod recorder", daemon=True)
        self._thread.start()

    def put(self, sample: Sample, *, wait: bool) -> bool:
        """Hand over a sample; False if too many wait already and it is left out.

        Raises:
            Exception: What went wrong on the thread.
        """
        self.speak()
        with self._changed:
            while self._size >= WAITING and self._error is None:
                if not wait:
                    return False
                self._changed.wait()
            self._waiting.append(sample)
            self._size += sample.size
            self._put += 1
            if self._put == 1 or len(self._waiting) >= self._together:
                self._changed.notify_all()
        return True

    def flush(self) -> None:
        """Wait until all that was put is written.

        Raises:
            Exception: What went wrong on the thread.
        """
        with self._changed:
            goal = self._put
            self._hurry += 1
            self._changed.notify_all()
            try:
                self._changed.wait_for(lambda: self._written >= goal or self._error is not None)
            finally:
                self._hurry -= 1
        self.speak()

    def close(self) -> None:
        """Write what waits and end the thread; errors wait for ``speak``."""
        with self._changed:
            self._closed = True
            self._hurry += 1
            self._changed.notify_all()
        self._thread.join()

    def say(self, message: str) -> None:
        """Leave a ``RuntimeWarning`` for whoever puts the next sample."""
        self._said.append(message)

    def speak(self) -> None:
        """Warn of what was said on the thread, and raise what went wrong there, once.

        Raises:
            Exception: What went wrong on the thread; later a ``RuntimeError``.
        """
        while self._said:
            warn(self._said.pop(0), RuntimeWarning)
        if self._error is None or (self._raised and self._closed):
            return
        if self._raised:
            raise RuntimeError("the recorder has stopped after an error") from self._error
        self._raised = True
        raise self._error

    def breathe(self) -> None:
        """Let the loop have the interpreter, unless it waits for this thread."""
        if not self._hurry:
            time.sleep(_BREATH)

    def _run(self) -> None:
        while samples := self._next():
            try:
                self._write(samples)
            except BaseException as error:  # noqa: BLE001
                error.add_note(f"where samples {samples[0].step} to {samples[-1].step} were written")
                with self._changed:
                    self._error = error
                    self._waiting.clear()
                    self._size = 0
                    self._changed.notify_all()
                return
            with self._changed:
                self._written += len(samples)
                self._changed.notify_all()

    def _next(self) -> list[Sample]:
        """What to write next, the first sample alone; nothing at the end."""
        with self._changed:
            least = 1 if self._taken == 0 else self._together
            while len(self._waiting) < least and not self._closed and not (self._hurry and self._waiting):
                if not self._changed.wait(_PATIENCE if self._waiting else None) and self._waiting:
                    break
            most = 1 if self._taken == 0 else max(self._together, _TOGETHER)
            samples = [self._waiting.popleft() for _ in range(min(most, len(self._waiting)))]
            self._taken += len(samples)
            self._size -= sum(sample.size for sample in samples)
            if self._size < WAITING:
                self._changed.notify_all()
            return samples
