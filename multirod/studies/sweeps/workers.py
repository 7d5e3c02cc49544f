"""The processes of a pool, ended whatever they are doing."""

import sys
from concurrent.futures import Executor
from contextlib import suppress
from multiprocessing.connection import wait
from time import monotonic
from typing import Any

CLOSES_CALLS = (3, 11, 5)  # from which on a broken pool's own thread closes where its calls are read: not twice, at the same time


class Workers:
    """The processes that an executor has at present: those of a ``ProcessPoolExecutor`` not yet shut down, of any other none.

    Such a pool has no way to end that is sure to end (Python 3.14 has ``kill_workers``, which waits like the rest): its own
    thread waits for a process that is stopped, and where one dies while it hands over a result, for the rest of that result; so
    does the interpreter at its exit, for that thread.
    """

    def __init__(self, executor: Executor) -> None:
        self._processes: list[Any] = list((getattr(executor, "_processes", None) or {}).values())
        self._results: Any = getattr(executor, "_result_queue", None)
        self._calls: Any = getattr(executor, "_call_queue", None)

    def __len__(self) -> int:
        return len(self._processes)

    def dead(self) -> bool:
        """Whether one of them has ended."""
        return any(process.exitcode is not None for process in self._processes)

    def wait(self, seconds: float) -> None:
        """Give them some time to end by themselves."""
        end = monotonic() + seconds
        waiting = [process.sentinel for process in self._processes]
        while waiting and (left := end - monotonic()) > 0:
            ended = wait(waiting, left)
            waiting = [sentinel for sentinel in waiting if sentinel not in ended]

    def kill(self) -> None:
        """End them at once, and the pool's thread with them; a pool that is not shut down yet is broken then."""
        for process in self._processes:
            with suppress(ValueError):  # closed: it has ended
                process.kill()  # a process that is stopped does not heed SIGTERM
        if self._processes and self._results is not None:
            # the end to write to that this process holds: without it, what reads comes to the end of what the dead have written
            self._results._writer.close()
        if self._processes and self._calls is not None and sys.version_info < CLOSES_CALLS:
            # the end to read from: without it, who writes to the dead does not wait for ever
            self._calls._reader.close()
