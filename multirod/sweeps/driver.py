"""The driver of a sweep: hands out chunks, keeps what comes back, hands out again what is lost."""

import math
import os
from collections import Counter, deque
from collections.abc import Callable, Generator, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, CancelledError, Executor, Future, wait
from contextlib import AbstractContextManager, closing, contextmanager, nullcontext
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from multirod.assembly import Assembly
from multirod.inputs import Inputs
from multirod.solver import Solver
from multirod.solvers.shooting import Shooting
from multirod.sweeps.bar import Bar
from multirod.sweeps.chunk import FURTHER, RESULTS, Chunk, Raised, run
from multirod.sweeps.digest import digest
from multirod.sweeps.folder import FORMAT, Folder
from multirod.sweeps.study import Study
from multirod.sweeps.table import Arrays, to_table
from multirod.validation import Described, boolean, choice, positive_int, refuse

ATTEMPTS = 4  # of a chunk, that its executor loses
_POLL = 0.2  # [s]; where waiting cannot be interrupted, it is at least short

Executors = Executor | Callable[[], Executor]


def sweep(
    robot: Assembly,
    inputs: Inputs,
    *,
    out: str | os.PathLike[str],
    solver: Solver | None = None,
    chunk: int = 1000,
    quantities: Iterable[str] = (),
    executor: Executors | None = None,
    in_flight: int = 32,
    progress: bool | Callable[[int], None] = True,
    device: str = "cpu",
) -> Study:
    """Solve every instance of a large batch, chunk by chunk, into a folder; go on where an earlier call stopped.

    Each chunk that is done is one file, there as a whole or not at all, whatever ends the process; it is never solved again. The
    arrays equal those of ``solve``, bitwise, whatever the chunk and the executor (``docs/sweep.md``).

    Args:
        robot: The assembly.
        inputs: Made by ``robot.inputs(...)``; their leading axes and those of the rods are the batch.
        out: The folder: new, empty, or begun by the same call.
        solver: ``Shooting()`` by default.
        chunk: Instances of a chunk.
        quantities: Kept besides status, residual, iterations, integrations, tip_position, tip_rotation, unknowns and the inputs:
            any of boundary_residual, condition, determinant, energy, gamma, index, potential, smallest_singular_value, stability.
        executor: Where chunks are solved: in this process by default, on a ``concurrent.futures.Executor``, or on one made by this
            function, which is asked for another when the first breaks, and which are shut down in the end.
        in_flight: Chunks that the executor has at a time: at least twice its workers.
        progress: Whether a bar is shown after two seconds, if on a terminal; or called with the number of instances done.
        device: Warp device.

    Returns:
        The finished study.

    Raises:
        TypeError, ValueError: If an argument is not what it must be, or ``out`` holds another study or something else.
        RuntimeError: If ``out`` is being written by another process; if solving a chunk raised; or if the executor lost a chunk
            four times. What was done until then is kept.
    """
    if not isinstance(robot, Assembly):
        raise TypeError(f"robot must be an assembly such as SingleRod(rod), not {type(robot).__name__}")
    method = Shooting() if solver is None else solver
    if not isinstance(method, Solver):
        raise TypeError(f"solver must be a Solver such as Shooting(), not {type(method).__name__}")
    inputs = robot.accept(inputs)
    chunk, in_flight = positive_int("chunk", chunk), positive_int("in_flight", in_flight)
    if isinstance(quantities, str):
        refuse("quantities", quantities, "must be a list of names")
    further = tuple(sorted({choice("quantities", name, FURTHER) for name in quantities}))
    if executor is not None and not isinstance(executor, Executor) and not callable(executor):
        refuse("executor", executor, "must be a concurrent.futures.Executor, or a function that makes one")
    if not callable(progress):
        boolean("progress", progress)
    options = {"device": device}
    batch_shape = np.broadcast_shapes(inputs.batch_shape, robot.batch_shape)
    if math.prod(batch_shape) == 0:
        refuse("inputs", Described(f"leading axes {batch_shape}"), "there must be an instance")
    manifest = {
        **_identity(robot, inputs, method),
        "batch_shape": list(batch_shape),
        "chunk": chunk,
        "quantities": [*RESULTS, *further],
        "device": device.split(":")[0],
    }
    folder = Folder(Path(out))
    with folder.locked():
        folder.begin(manifest)
        study = Study(out)
        make = partial(
            _chunk, study, robot, inputs, solver=method, options=options, quantities=RESULTS + further, batch_shape=batch_shape
        )
        keep = partial(_keep, folder, study, inputs)
        finished = set(study.finished_chunks)
        missing = [k for k in range(study.chunk_count) if k not in finished]
        with _executors(executor) as source, _reporter(progress, study.instance_count) as report:
            done = int(study.done.sum())
            report(done)
            with closing(_results(source, make, missing, in_flight)) as results:
                for k, arrays in results:
                    keep(k, arrays)
                    done += len(study.instances(k))
                    report(done)
    return study


def _identity(robot: Assembly, inputs: Inputs, solver: Solver) -> dict[str, Any]:
    """What makes a study another one: versions, and digests of all numbers."""
    from multirod import __version__

    return {
        "format": FORMAT,
        "multirod": __version__,
        "robot": {"is": repr(robot), "digest": digest("robot", robot)},
        "inputs": {
            name: digest(f"inputs.{name}", inputs.profile(name) or np.asarray(getattr(inputs, name))) for name in inputs.given
        },
        "solver": {"is": repr(solver), "digest": digest("solver", solver)},
        "integrator": {"is": str(solver.integrator), "digest": digest("integrator", solver.integrator)},
    }


def _chunk(study: Study, robot: Assembly, inputs: Inputs, k: int, **settings: Any) -> Chunk:
    return Chunk.of(robot, inputs, study.instances(k), **settings)


def _keep(folder: Folder, study: Study, inputs: Inputs, k: int, arrays: Arrays) -> None:
    """Write a chunk: where in the batch each instance stands, its inputs, its results."""
    import pyarrow.parquet as pq

    instances = study.instances(k)
    axes: Arrays = {"instance": instances}
    if study.batch_shape:
        axes |= {f"axis_{axis}": places for axis, places in enumerate(np.unravel_index(instances, study.batch_shape))}
    own = inputs.take(instances, study.batch_shape)
    given = {name: np.asarray(getattr(own, name)) for name in own.given if name not in own.profiles}
    table = to_table(axes, {**given, **arrays})
    with folder.written(folder.chunk_path(k)) as part:
        pq.write_table(table, part)


# ---- handing out ----


class _Here(Executor):
    """Runs what is submitted at once, in this thread."""

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> "Future[Any]":
        future: Future[Any] = Future()
        future.set_result(fn(*args, **kwargs))
        return future


class _Source:
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
        self.executor.shutdown(wait=False)
        self.executor = self._made()
        return True

    def close(self, wait: bool) -> None:
        if self._make is not None:
            self.executor.shutdown(wait=wait, cancel_futures=True)


@contextmanager
def _executors(given: Executors | None) -> Iterator[_Source]:
    source = _Source(given)
    try:
        yield source
    except BaseException:
        source.close(wait=False)
        raise
    source.close(wait=True)


def _results(
    source: _Source, make: Callable[[int], Chunk], missing: Iterable[int], in_flight: int
) -> Generator[tuple[int, Arrays], None, None]:
    """Arrays of each missing chunk as it is done, in any order.

    Raises:
        RuntimeError: If solving a chunk raised, or a chunk was lost too often.
    """
    waiting = deque(missing)
    lost: Counter[int] = Counter()
    flying: dict[Future[Any], int] = {}
    limit = 1 if isinstance(source.executor, _Here) else in_flight
    try:
        while waiting or flying:
            broken: Exception | None = None
            while waiting and len(flying) < limit and broken is None:
                k = waiting.popleft()
                try:
                    flying[source.executor.submit(run, make(k))] = k
                except BrokenExecutor as error:
                    broken, flying[_failed(error)] = error, k
            done = wait(flying, timeout=_POLL, return_when=FIRST_COMPLETED).done
            if any(isinstance(_error(future), BrokenExecutor) for future in done):
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
                    "the executor is broken; what is done is kept: sweep again with another, or give executor= a function that makes one"
                ) from broken
    finally:
        for future in flying:
            future.cancel()


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


def _reporter(progress: bool | Callable[[int], None], total: int) -> AbstractContextManager[Callable[[int], None]]:
    if callable(progress):
        return nullcontext(progress)
    return Bar(total) if progress else nullcontext(lambda done: None)
