"""A solver in a package of its own: Broyden's method, started from the exact Gamma. It never asks which robot it solves."""

from dataclasses import dataclass, field

import numpy as np

import multirod as mr


@dataclass(frozen=True, kw_only=True)
class Broyden(mr.Solver):
    """Broyden's good method from one exact Gamma; the loads are raised in steps when there is no guess.

    Attributes:
        tolerance: Largest residual, max norm [1/m].
        integrator: Of the spatial equations.
        max_iterations: In each load step.
    """

    tolerance: float = 1e-9
    integrator: mr.Integrator = field(default_factory=mr.RK45)
    max_iterations: int = 50

    def _solve(self, problem: mr.BoundaryProblem, guess: np.ndarray | None) -> mr.Outcome:
        outcome = mr.Outcome.zeros(problem.instance_count)
        x = problem.guess() if guess is None else np.array(guess)
        loads = 1 if guess is not None else int(np.ceil(1 + problem.load_scale().max()))
        for load in np.arange(1, loads + 1) / loads:
            with problem.at_load(load):
                residual, gamma = problem.evaluate(x)
                outcome.integrations += 1
                for _ in range(self.max_iterations):
                    going = np.abs(residual).max(axis=1) > self.tolerance
                    if not going.any():
                        break
                    step = np.zeros_like(x)
                    step[going] = -np.linalg.solve(gamma[going], residual[going, :, None])[..., 0]
                    x = x + step
                    change = -residual
                    residual, _ = problem.evaluate(x)
                    change += residual
                    slope = change - np.einsum("bij,bj->bi", gamma, step)
                    length = np.maximum(np.einsum("bi,bi->b", step, step), 1e-300)
                    gamma += np.einsum("bi,bj->bij", slope, step) / length[:, None, None]
                    outcome.iterations += going
                    outcome.integrations += going
        with np.errstate(invalid="ignore"):
            good = np.abs(residual).max(axis=1) <= self.tolerance
        outcome.status[:] = np.where(good, int(mr.Status.CONVERGED), int(mr.Status.MAX_ITERATIONS))
        return outcome
