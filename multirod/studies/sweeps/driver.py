"""The driver of a sweep: the only one who writes."""

import math
import os
from collections.abc import Callable, Iterable
from concurrent.futures import Executor
from contextlib import closing
from typing import Any

import numpy as np

from multirod.assembly import Assembly
from multirod.batch import thread_count
from multirod.inputs import Inputs
from multirod.naming import names_checked
from multirod.running.progress import Watch
from multirod.running.simulation import as_solver
from multirod.solver import Solver
from multirod.studies.sweeps.chunk import FURTHER, RESULTS, Chunk
from multirod.studies.sweeps.digest import digest
from multirod.studies.sweeps.dispatch import Executors, executors, results
from multirod.studies.sweeps.folder import FORMAT, Folder
from multirod.studies.sweeps.study import Study
from multirod.studies.sweeps.table import Arrays, to_table
from multirod.validation import Described, choice, device_name, path_of, positive_int, refuse
from multirod.warning import warn


@names_checked
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
    progress: bool | Callable[[int], object] = True,
    device: str = "cpu",
    threads: int | None = None,
) -> Study:
    """Solve every instance of a large batch, chunk by chunk, into a folder; go on where an earlier call stopped.

    Each chunk that is done is one file, there as a whole or not at all, whatever ends the process; it is never solved again
    unless its checksum says that it is no longer what was written: then a ``RuntimeWarning`` names it. The arrays equal those
    of ``solve``, bitwise, whatever the chunk and the executor (``docs/sweep.md``).

    Args:
        robot: The assembly.
        inputs: Made by ``robot.inputs(...)``; their leading axes and those of the rods are the batch.
        out: The folder: new, empty, or begun by the same call.
        solver: ``Shooting()`` by default.
        chunk: Instances of a chunk.
        quantities: Kept besides status, residual, iterations, integrations, tip_position, tip_rotation, unknowns and the inputs:
            any of boundary_residual, condition, determinant, energy, event_count, event_load_factor, gamma, index, load_factor,
            potential, smallest_singular_value, stability, stability_margin, stiffness, tip_error.
        executor: Where chunks are solved: in this process by default, on a ``concurrent.futures.Executor``, or on one made by
            this function, which is asked for another when the first breaks, and which are shut down in the end.
        in_flight: Chunks that the executor has at a time: at least twice its workers.
        progress: Whether a bar is shown after two seconds, if on a terminal; or called with the number of instances done.
        device: Warp device.
        threads: That share a chunk; by default one for each core in this process, and one on an executor.

    Returns:
        The finished study.

    Raises:
        TypeError, ValueError: If an argument is not what it must be, or ``out`` holds another study or something else.
        RuntimeError: If ``out`` is being written by another process; if solving a chunk raised; or if the executor lost a chunk
            four times. What was done until then is kept.
    """
    method = as_solver(robot, solver)
    inputs = robot.accept(inputs)
    chunk, in_flight = positive_int("chunk", chunk), positive_int("in_flight", in_flight)
    if isinstance(quantities, str) or not isinstance(quantities, (list, tuple, set, frozenset)):
        refuse("quantities", quantities, "must be a list of names")
    device = device_name("device", device)
    further = tuple(sorted({choice("quantities", name, FURTHER) for name in quantities}))
    if executor is not None and not isinstance(executor, Executor) and not callable(executor):
        refuse("executor", executor, "must be a concurrent.futures.Executor, or a function that makes one")
    named = (*RESULTS, *further)
    for name in inputs.given:
        if name in named:
            refuse("inputs", name, "an array of the results has that name")
    if threads is not None or executor is None:
        threads = thread_count(threads)
    options = {"device": device, "threads": threads or 1}
    batch_shape = np.broadcast_shapes(inputs.batch_shape, robot.batch_shape)
    if math.prod(batch_shape) == 0:
        refuse("inputs", Described(f"leading axes {batch_shape}"), "there must be an instance")
    manifest = {
        **_identity(robot, inputs, method),
        "batch_shape": list(batch_shape),
        "chunk": chunk,
        "quantities": list(named),
        "device": device.split(":")[0],
    }
    folder = Folder(path_of("out", out))
    with folder.locked():
        folder.begin(manifest)
        study = Study(out)
        for k, path in folder.remove_broken().items():
            warn(f"{path} was broken, its checksum not that in its name: chunk {k} is solved again", RuntimeWarning)
        finished = set(study.finished_chunks)
        missing = [k for k in range(study.chunk_count) if k not in finished]

        def make(k: int) -> Chunk:
            return Chunk.of(robot, inputs, batch_shape, study.instances(k), solver=method, options=options, quantities=named)

        with executors(executor) as source, Watch("sweep", study.instance_count, progress) as watch:
            watch.begin(int(study.done.sum()))
            with closing(results(source, make, missing, in_flight)) as solved:
                for k, arrays in solved:
                    _keep(folder, study, inputs, k, arrays)
                    watch.advance(len(study.instances(k)))
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


def _keep(folder: Folder, study: Study, inputs: Inputs, k: int, arrays: Arrays) -> None:
    """Write a chunk: where in the batch each instance stands, its inputs, its results."""
    import pyarrow as pa  # type: ignore[import-untyped]
    import pyarrow.parquet as pq  # type: ignore[import-untyped]

    instances = study.instances(k)
    axes: Arrays = {"instance": instances}
    if study.batch_shape:
        axes |= {f"axis_{axis}": places for axis, places in enumerate(np.unravel_index(instances, study.batch_shape))}
    own = inputs.take(study.batch_shape, instances)
    given = {name: np.asarray(getattr(own, name)) for name in own.arrays}
    table = to_table(axes, {**given, **arrays})
    content = pa.BufferOutputStream()
    pq.write_table(table, content)
    folder.keep(k, content.getvalue().to_pybytes())
