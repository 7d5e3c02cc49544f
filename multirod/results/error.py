"""How far a result is off: against the same equilibrium, integrated and solved as finely as rounding allows."""

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from multirod.integrators import RK45, AdaptiveIntegrator
from multirod.validation import FloatArray

if TYPE_CHECKING:
    from multirod.integrators import Integrator
    from multirod.results.found import Found
    from multirod.results.solution import Solution
    from multirod.solver import Solver

FINE = RK45(rtol=1e-11, atol=1e-13)  # of the kernels of any RK45
ROUNDED = 1e-7  # over the longest rod [1/m]: a residual that moves no tip by more of its length, and more than rounding leaves
# where poses are unknowns, as of platforms and bodies, what a residual within the usual tolerance leaves is all that they are off
CLOSE, STEPS = 1e-12, 3  # [1/m], which rounding may not allow, and Newton's steps to it


def may_be_finer(integrator: "Integrator") -> bool:
    """Whether ``finely`` has the steps of one that chooses them finer."""
    return isinstance(integrator, AdaptiveIntegrator) and integrator.adaptive and integrator.rtol > FINE.rtol


def finely(solution: "Solution[Any] | Found[Any]", chosen: NDArray[np.bool_], *, rounded: bool = False) -> Any:  # noqa: ANN401  (as it is)
    """The same equilibria of some instances, (...,), all with results, integrated as finely as rounding allows; ``rounded`` are
    taken with a residual that rounding may leave."""
    from multirod.solvers.shooting import Shooting

    tolerance = ROUNDED / solution.assembly.longest if rounded else None
    # from nothing it might lead elsewhere
    return _solved(_of(solution, chosen), Shooting(integrator=FINE, fallback=False, tolerance=tolerance))


def tip_error(solution: "Solution[Any] | Found[Any]") -> FloatArray:
    """What ``Solution.tip_error`` says."""
    from multirod.solvers.shooting import Shooting

    error, found = np.full(solution.batch_shape, np.nan), ~solution.failed
    if not found.any():
        return error
    part, again = _of(solution, found), finely(solution, found)
    off, ended = _apart(again, part), np.asarray(~again.failed)
    if ended.any():
        closer = _solved(_of(again, ended), Shooting(integrator=FINE, fallback=False, tolerance=CLOSE, max_iterations=STEPS))
        nearer = _apart(closer, _of(part, ended))
        off[ended] = np.where(closer.failed, off[ended].reshape(nearer.shape), nearer).reshape(-1)
    error[found] = off.reshape(-1)
    return error


def _of(solution: Any, chosen: NDArray[np.bool_]) -> Any:  # noqa: ANN401  (a ``Solution`` or a ``Found``)
    return solution if np.all(chosen) else solution[chosen]


def _solved(guess: Any, solver: "Solver") -> Any:  # noqa: ANN401
    from multirod.running.simulation import solve

    scene = guess._scene
    own = {"device": scene.device, "threads": scene.threads, "progress": False}
    return solve(guess.robot, guess.inputs, solver=solver, guess=guess, **own)


def _apart(one: Any, other: Any) -> FloatArray:  # noqa: ANN401
    return np.asarray(np.linalg.norm(one.tip_position - other.tip_position, axis=-1))
