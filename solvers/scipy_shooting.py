"""Shooting with SciPy's minimisers: the three root finders that the paper compares its observer with."""

import math
import warnings
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from multirod.integrators import RK45, Integrator
from multirod.naming import OPTIONS_NAMED, fields_hinted
from multirod.problem import BoundaryProblem
from multirod.solver import Outcome, Solver
from multirod.status import Fault, Status
from multirod.validation import FloatArray, boolean, choice, positive_float, positive_int, refuse

_SIMPLEX = 0.01
METHODS = ("interior-point", "quasi-newton", "nelder-mead")


@fields_hinted(OPTIONS_NAMED)
@dataclass(frozen=True, kw_only=True)
class ScipyShooting(Solver):
    """Minimises the squared residual, one instance after the other.

    Along a motion each sample starts from the last, as in the paper. Without a guess the loads are raised in equal steps,
    each small against the stiffness, which follows the natural branch where that is easy; nothing tests that it did.

    Attributes:
        method: ``"interior-point"`` (SciPy's ``trust-constr``), ``"quasi-newton"`` (``BFGS``) or ``"nelder-mead"``.
        tolerance: The minimiser's tolerance on the gradient or on the simplex; the paper's is 1e-3.
        integrator: Of the spatial equations; in ``"float32"`` only where nothing is differentiated by differences.
        exact_gradient: Whether the gradient comes from ``Gamma``, at no integration, rather than from differences, at one
            integration for each unknown, as in the paper.
        max_residual: Residual above which a result is called STALLED, max norm [1/m].
        max_iterations: Iterations of the minimiser allowed in a sample.

    Raises:
        ValueError: If a field is out of range.
    """

    method: str = "quasi-newton"
    tolerance: float = 1e-3
    integrator: Integrator = field(default_factory=RK45)
    exact_gradient: bool = False
    max_residual: float = 0.1
    max_iterations: int = 1000

    def __post_init__(self) -> None:
        self._check_integrator()
        choice("ScipyShooting.method", self.method, METHODS)
        positive_float("ScipyShooting.tolerance", self.tolerance)
        positive_float("ScipyShooting.max_residual", self.max_residual)
        boolean("ScipyShooting.exact_gradient", self.exact_gradient)
        if self.integrator.precision != "float64" and not self.exact_gradient and self.method != "nelder-mead":
            refuse(
                "ScipyShooting.integrator",
                self.integrator,
                "must be in float64, whose differences are gradients: "
                "give exact_gradient=True or method='nelder-mead' for float32",
            )
        positive_int("ScipyShooting.max_iterations", self.max_iterations)

    def _solve(self, problem: BoundaryProblem, guess: FloatArray | None) -> Outcome:
        outcome = Outcome.zeros(problem.instance_count)
        start = problem.guess() if guess is None else np.array(guess)
        loads = np.ones(problem.instance_count, dtype=int)
        if guess is None:
            loads = np.maximum(1, np.ceil(2 * problem.load_scale())).astype(int)
        for k in range(problem.instance_count):
            x = start[k]
            with problem.only(np.arange(problem.instance_count) == k):
                for step in range(min(loads[k], 200)):
                    sample = _Sample(problem, k)
                    with problem.at_load((step + 1) / min(loads[k], 200)):
                        iterations = self._minimise(sample, x)
                    x = sample.best
                    outcome.iterations[k] += iterations
                    outcome.integrations[k] += sample.integrations
                sample(x)  # the buffers hold the result
            outcome.integrations[k] += 1
            residual = np.abs(sample.residual).max()
            outcome.status[k] = Status.CONVERGED if residual <= self.max_residual else Status.STALLED
            if not math.isfinite(residual):
                outcome.status[k] = Fault(problem.fault.numpy()[k]).status
        return outcome

    def _minimise(self, sample: "_Sample", start: FloatArray) -> int:
        from scipy import optimize

        minimize: Any = optimize.minimize
        gradient: dict[str, Any] = {"jac": sample.gradient} if self.exact_gradient else {}
        limit: dict[str, Any] = {"maxiter": self.max_iterations}
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            if self.method == "interior-point":
                options = {**limit, "gtol": self.tolerance, "xtol": self.tolerance**2}
                result = minimize(sample, start, method="trust-constr", options=options, **(gradient or {"jac": "2-point"}))
            elif self.method == "quasi-newton":
                options = {**limit, "gtol": self.tolerance}
                result = minimize(sample, start, method="BFGS", options=options, **gradient)
            else:
                # SciPy's own first simplex is 0.00025 wide where an unknown is zero, and collapses there
                edge = _SIMPLEX * max(1.0, float(np.abs(start).max()))
                simplex = start + edge * np.vstack([np.zeros(len(start)), np.eye(len(start))])
                options = {**limit, "xatol": self.tolerance, "fatol": self.tolerance, "initial_simplex": simplex}
                result = minimize(sample, start, method="Nelder-Mead", options=options)
        return int(result.nit)


class _Sample:
    """The squared residual of one instance, and what it cost."""

    def __init__(self, problem: BoundaryProblem, instance: int) -> None:
        self.problem = problem
        self.instance = instance
        self.integrations = 0
        self.residual: FloatArray = np.full(problem.unknown_count, np.nan)
        self.best: FloatArray = self.residual
        self._least = math.inf
        self._unknowns = problem.read("unknowns")

    def __call__(self, x: FloatArray) -> float:
        self._unknowns[self.instance] = x
        self.problem.write("unknowns", self._unknowns)
        self.problem.integrate()
        self.integrations += 1
        residual = self.problem.read("residual")[self.instance]
        failed = self.problem.fault.numpy()[self.instance] != 0
        self.residual = np.full_like(residual, np.nan) if failed else residual
        value = 1e30 if failed else float(residual @ residual)
        if value < self._least or not math.isfinite(self._least):
            self._least, self.best = value, np.array(x)
        return value

    def gradient(self, x: FloatArray) -> FloatArray:
        if not np.array_equal(self._unknowns[self.instance], x):
            self(x)
        n = self.problem.unknown_count
        gamma = self.problem.read("gamma")[self.instance].reshape(n, n)
        return np.asarray(2 * gamma.T @ self.residual)
