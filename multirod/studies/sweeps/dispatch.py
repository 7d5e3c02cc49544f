"""Chunks to an executor and back: a bounded number at a time, and again what it loses."""

from collections import Counter, deque
from collections.abc import Callable, Generator, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, CancelledError, Executor, Future, wait
from contextlib import contextmanager
from math import inf
from time import monotonic
from typing import Any, ParamSpec, TypeVar

from multirod.studies.sweeps.chunk import Chunk, Raised, run
from multirod.studies.sweeps.table import Arrays
from multirod.studies.sweeps.workers import Workers

ATTEMPTS = 4  # of a chunk, that its executor loses
PATIENCE = 5.0  # [s] with a pool: to notice that a worker has died, and for idle workers to end
_POLL = 0.2  # [s]; where waiting cannot be interrupted, it is at least short

Executors = Executor | Callable[[], Executor]
P = ParamSpec("P")
T = TypeVar("T")


class _Here(Executor):
    """Runs what is submitted at once, in this thread."""

    def submit(self, fn: Callable[P, T], /, *args: P.args, **kwargs: P.kwargs) -> "Future[T]":
        future: Future[T] = Future()
        future.set_result(fn(*args, **kwargs))
        return future


class Source:
    """An executor, or as many as it takes.

    Attributes:
        executor: The present one.
    """

    def __init__(self, given: Executors | None) -> None:
        self._make = given if given is not None and not isinstance(given, Executor) else None
        self.executor: Executor = _Here() if given is None else given if isinstance(given, Executor) else self._made()

    def _made(self) -> Executor:
        assert self._make is not None
        executor = self._make()
        if not isinstance(executor, Executor):
            raise TypeError(f"executor must make a concurrent.futures.Executor, not {type(executor).__name__}")
        return executor

    def renew(self) -> bool:
        """Put another in the place of a broken one; False if that cannot be."""
        if self._make is None:
            return False
        self.abandon()
        self.executor = self._made()
        return True

    def drop(self, futures: "Iterable[Future[Any]]") -> None:
        """Take back what has not begun, unless it goes with its executor: a pool hangs if it breaks over cancelled futures."""
        if self._make is None:
            for future in futures:
                future.cancel()

    def close(self) -> None:
        """Shut down what was made here, once all is done: workers that do not end are killed."""
        if self._make is not None:
            workers = Workers(self.executor)
            try:
                self.executor.shutdown(wait=not workers)
                workers.wait(PATIENCE)
            finally:
                workers.kill()

    def abandon(self) -> None:
        """The same, without waiting for what still runs where that can be stopped: in the processes of a pool."""
        if self._make is not None:
            # first the workers: a broken pool's thread holds the lock of shutdown while it waits for them
            Workers(self.executor).kill()
            self.executor.shutdown(wait=False, cancel_futures=True)


@contextmanager
def executors(given: Executors | None) -> Iterator[Source]:
    """A source of executors, shut down in the end where they were made here."""
    source = Source(given)
    try:
        yield source
    except BaseException:
        source.abandon()
        raise
    source.close()


def results(
    source: Source, make: Callable[[int], Chunk], missing: Iterable[int], in_flight: int
) -> Generator[tuple[int, Arrays], None, None]:
    """Arrays of each missing chunk as it is done, in any order.

    Raises:
        RuntimeError: If solving a chunk raised, or a chunk was lost too often.
    """
    waiting = deque(missing)
    lost: Counter[int] = Counter()
    flying: dict[Future[Any], int] = {}
    unnoticed_since = inf  # when a worker was first seen dead
    limit = 1 if isinstance(source.executor, _Here) else in_flight
    try:
        while waiting or flying:
            broken: Exception | None = None
            while waiting and len(flying) < limit and broken is None:
                k = waiting.popleft()
                try:
                    flying[source.executor.submit(run, make(k))] = k
                except BrokenExecutor as refusal:
                    broken, flying[_failed(refusal)] = refusal, k
            done = wait(flying, timeout=_POLL, return_when=FIRST_COMPLETED).done
            unnoticed_since = inf if done or not Workers(source.executor).dead() else min(unnoticed_since, monotonic())
            if monotonic() - unnoticed_since > PATIENCE:
                # the pool's thread waits for the rest of what that one was handing over
                unnoticed = BrokenExecutor("a worker died while it handed over a result")
                flying = {_failed(unnoticed): k for k in flying.values()}
                done = set(flying)
            elif any(isinstance(_error(future), BrokenExecutor) for future in done):
                done = wait(flying).done  # all that it had is lost with it
            problem: RuntimeError | None = None
            for future in done:
                k, error = flying.pop(future), _error(future)
                if error is not None and not isinstance(error, Exception):
                    raise error  # a worker was told to stop
                if error is not None:
                    lost[k] += 1
                    waiting.append(k)
                    broken = error if isinstance(error, BrokenExecutor) else broken
                    if lost[k] == ATTEMPTS:
                        problem = RuntimeError(f"chunk {k} was lost by the executor {ATTEMPTS} times, the last time by {error!r}")
                        problem.__cause__ = error
                elif isinstance(future.result(), Raised):
                    cause = future.result().error
                    problem = RuntimeError(f"chunk {k}: {type(cause).__name__}: {cause}")
                    problem.__cause__ = cause
                else:
                    yield k, future.result()
            if problem is not None:
                raise problem
            if broken is not None and not source.renew():
                raise RuntimeError(
                    "the executor is broken; what is done is kept: sweep again with another, "
                    "or give executor= a function that makes one"
                ) from broken
    finally:
        source.drop(flying)


def _failed(error: Exception) -> "Future[Any]":
    future: Future[Any] = Future()
    future.set_exception(error)
    return future


def _error(future: "Future[Any]") -> BaseException | None:
    """What an executor has raised in the place of a result."""
    try:
        return future.exception()
    except CancelledError as error:
        return error
