"""Gauss-Newton steps in parameters that many shapes share. Numbers in parentheses: ``docs/estimation.md``."""

from collections.abc import Sequence
from math import prod
from typing import Any

import numpy as np

from multirod.assembly import Assembly
from multirod.inputs import Inputs
from multirod.problem import BoundaryProblem
from multirod.results.solution import Solution
from multirod.running.simulation import solve
from multirod.solver import Solver
from multirod.stability import Stability
from multirod.status import Status
from multirod.tasks.estimating.inference import Posterior, posterior, roots, units
from multirod.tasks.estimating.iteration import HALVINGS, SETTLED, SLACK, TOLERANCE
from multirod.tasks.estimating.parameters import Parameters
from multirod.tasks.formulation import Evaluation
from multirod.tasks.measuring.along import AlongTask, Places
from multirod.tasks.measuring.sensors import Measured
from multirod.validation import FloatArray


class Shapes(AlongTask):
    """All shapes of one robot; what is freed are columns by its parameters."""

    def __init__(self, problem: BoundaryProblem, names: Sequence[str], places: Places) -> None:
        self.problem, self.free = problem, tuple(names)
        self._sense(places)

    def evaluate(self, unknowns: FloatArray, *_: object) -> Evaluation:
        """One integration at ``x`` (b, n)."""
        with self.problem.alone:
            self.problem.write("unknowns", unknowns)
            self.problem.aim(*self.free)
            self.integrate()
            return self.last()


class Fit:
    """Gauss-Newton steps in the parameters, the unknowns of every shape eliminated."""

    def __init__(
        self,
        robot: Assembly,
        inputs: Inputs,
        numbers: Parameters,
        measured: Measured,
        solver: Solver,
        begin: Solution[Any],
        device: str,
    ) -> None:
        self.robot, self.inputs, self.numbers, self.measured, self.solver = robot, inputs, numbers, measured, solver
        self.solution, self.device = begin, device
        self.x = np.array(begin.unknowns.reshape(prod(begin.batch_shape), -1))
        self.p = np.zeros(numbers.count)
        self.missing = measured.missing.reshape((*begin.batch_shape, -1))
        self.integrations, self.iterations = int(begin.integrations.max(initial=0)), 0
        self.status, self.square, self.degrees = Status.NOT_RUN, np.inf, 0
        self.covariance = np.full((numbers.count, numbers.count), np.nan)
        self.root = roots(numbers.prior[None])

    def run(self, most: int) -> None:
        """Go on until a step tells nothing."""
        x, p, part = self.x, self.p, 1.0
        towards, by, step = np.zeros(x.shape), np.zeros((*x.shape, len(p))), np.zeros(len(p))
        for _ in range(most + 1):
            tried = self._at(x + part * (towards + by @ step), p + part * step)
            if tried is None:
                part /= 2
                if part < 0.5**HALVINGS:
                    self.status = Status.STALLED
                    return
                continue
            x, p, part = x + part * (towards + by @ step), p + part * step, min(1.0, 2 * part)
            planned, towards, by, settled = tried
            step = planned.step[0]
            self.p, self.x, self.covariance = p, x, planned.covariance[0]
            if settled:
                self._finish()
                return
            self.iterations += 1
        self.status = Status.MAX_ITERATIONS

    def _at(self, x: FloatArray, p: FloatArray) -> tuple[Posterior, FloatArray, FloatArray, bool] | None:
        """The step planned at some unknowns and numbers; None where they are no better than the last."""
        try:
            robot = self.numbers.robot(p)
            names = self.numbers.names
            options = {"pose_sensitivities": True, **robot.input_directions(*names)}
            problem = robot.problem(self.inputs, integrator=self.solver.integrator, device=self.device, **options)
        except ValueError:  # such as a stiffness beyond all numbers
            return None
        found = Shapes(problem, names, self.measured.places).evaluate(x)
        self.integrations += 1
        found = found.by(self.numbers.columns(robot, p))
        r, J = self.measured.at(found, slice(None))
        with np.errstate(invalid="ignore"):
            square = (r**2).sum() + ((self.root[0] @ p) ** 2).sum()
        if not (np.isfinite(J).all() and square <= self.square * (1 + SLACK) + SETTLED**2):
            return None
        self.square = float(square)
        stacked, whole = J.reshape(1, -1, J.shape[-1]), r.reshape(1, -1)
        planned = posterior(stacked, whole, self.root, p[None], units(stacked, self.numbers.prior[None]))
        towards, by = found.eliminated
        given = getattr(self.solver, "tolerance", None)
        tolerance = np.maximum(problem.tolerance(given), TOLERANCE * problem.curvature_scale() if given is None else 0.0)
        near = bool((np.abs(found.residual).max(axis=1) <= tolerance).all())
        return planned, towards, by, near and bool(planned.length[0] <= SETTLED)

    def _finish(self) -> None:
        """The fitted robot and its equilibria, if these are what it would stay in."""
        robot = self.numbers.robot(self.p)
        guess = self.x.reshape((*self.solution.batch_shape, -1))
        solution = solve(robot, self.inputs, solver=self.solver, guess=guess, device=self.device, progress=False)
        failed = solution.failed.reshape(-1)
        if failed.any():
            self.status = Status(int(np.reshape(solution.status, -1)[failed][0]))
        elif np.isin(solution.stability, (Stability.UNSTABLE, Stability.FOLD)).any():
            self.status = Status.UNSTABLE
        else:
            self.robot, self.solution, self.status = robot, solution, Status.CONVERGED
