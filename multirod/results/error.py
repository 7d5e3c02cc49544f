"""How far a result is off: against the same equilibrium, integrated as finely as rounding allows."""

from typing import TYPE_CHECKING, Any

import numpy as np

from multirod.integrators import RK45
from multirod.validation import FloatArray

if TYPE_CHECKING:
    from multirod.results.found import Found
    from multirod.results.solution import Solution

FINE = RK45(rtol=1e-11, atol=1e-13)  # of the kernels of any RK45


def tip_error(solution: "Solution[Any] | Found[Any]") -> FloatArray:
    """What ``Solution.tip_error`` says."""
    from multirod.running.simulation import solve
    from multirod.solvers.shooting import Shooting

    error, found = np.full(solution.batch_shape, np.nan), ~solution.failed
    if not found.any():
        return error
    part: Any = solution if found.all() else solution[found]  # type: ignore[index]
    scene = solution._scene
    # from nothing it might lead elsewhere
    solver = Shooting(integrator=FINE, fallback=False)
    again = solve(part.robot, part.inputs, solver=solver, guess=part, device=scene.device, threads=scene.threads, progress=False)
    error[found] = np.linalg.norm(again.tip_position - part.tip_position, axis=-1).reshape(-1)
    return error
