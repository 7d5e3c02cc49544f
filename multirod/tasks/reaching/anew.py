"""Targets that were met where the robot is not stable: sought from where it comes to rest under the inputs that meet them."""

import numpy as np
from numpy.typing import NDArray

from multirod.assembly import Assembly
from multirod.inputs import Inputs
from multirod.running.simulation import solve
from multirod.solver import Solver
from multirod.stability import Stability
from multirod.tasks.freed import with_values
from multirod.tasks.reaching.goals import Place
from multirod.tasks.reaching.search import REACHED, Search
from multirod.validation import FloatArray


def met_past_folds(search: Search, chosen: NDArray[np.bool_]) -> NDArray[np.intp]:
    """Which of those chosen (b,) have not reached their targets, and met them where the robot is not stable."""
    return np.flatnonzero(chosen & (search.status != REACHED) & np.isfinite(search.past).all(axis=1))


def anew(search: Search, rows: NDArray[np.intp], robot: Assembly, inputs: Inputs, method: Solver) -> None:
    """Seek some instances from where the robot comes to rest, solved from nothing, under the inputs that meet their targets.

    Args:
        search: With these inputs in ``past``.
        rows: Their numbers in it, shape (k,).
        robot: Without leading axes.
        inputs: Theirs, leading axes (k,).
        method: That solves.
    """
    values: FloatArray = search.past[rows]
    device = search.task.problem.device
    found = solve(robot, with_values(inputs, search.task.free, values), solver=method, device=device, threads=1, progress=False)
    search.integrations[rows] += found.integrations
    usable = np.flatnonzero(~found.failed & np.isin(found.stability, (Stability.UNKNOWN, Stability.STABLE)))
    if not len(usable):
        return
    begun, chosen = rows[usable], np.zeros(len(search.status), dtype=bool)
    chosen[begun] = True
    x = np.zeros((len(chosen), search.last.x.shape[1]))
    x[begun] = found.unknowns[usable]
    search.begin(begun, Place(search.task.problem.adopt(x)[begun], values[usable]))
    search.tried(chosen)
