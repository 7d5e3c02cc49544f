"""Gauss-Newton steps in parameters that shapes share, and in loads of each. Numbers in parentheses: ``docs/estimation.md``."""

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
from multirod.tasks.estimating.inference import SETTLED, Posterior, posterior, roots, units
from multirod.tasks.estimating.iteration import HALVINGS, RESTORED, SLACK, TOLERANCE
from multirod.tasks.estimating.loads import Loads
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
    """(13), (13b) Gauss-Newton steps in the parameters and loads, the unknowns of every shape eliminated.

    ``p`` are all numbers, those that shapes share first.
    """

    def __init__(
        self,
        robot: Assembly,
        inputs: Inputs,
        numbers: Parameters,
        loads: Loads,
        measured: Measured,
        solver: Solver,
        begin: Solution[Any],
        device: str,
    ) -> None:
        self.robot, self.inputs, self.numbers, self.measured, self.solver = robot, inputs, numbers, measured, solver
        self.loads, self.begin = loads, loads.begin()
        self.solution, self.device = begin, device
        self.x = np.array(begin.unknowns.reshape(prod(begin.batch_shape), -1))
        self.p = loads.of(begin.inputs)
        self.missing = measured.missing.reshape((*begin.batch_shape, -1))
        self.integrations, self.iterations = int(begin.integrations.max(initial=0)), 0
        self.status, self.degrees = Status.NOT_RUN, 0
        self.square, self.gap = np.inf, np.inf  # squares, and the largest residual over its tolerance, where the last step led
        self.covariance = np.full((len(self.p), len(self.p)), np.nan)
        self.prior = loads.prior(numbers.prior)[None]
        self.root = roots(self.prior)

    def run(self, most: int) -> None:
        """Go on until a step tells nothing."""
        x, p, part = self.x, self.p, 1.0
        if self.loads.names:  # whose terms the start may have gone without
            x = self._problem(self.robot, p).adopt(x)
        towards, step = np.zeros(x.shape), np.zeros(len(p))
        for _ in range(most + 1):
            tried = self._at(x + part * towards, p + part * step)
            if tried is None:
                part /= 2
                if part < 0.5**HALVINGS:
                    self.status = Status.STALLED
                    return
                continue
            x, p, part = x + part * towards, p + part * step, min(1.0, 2 * part)
            planned, towards, settled = tried
            step = planned.step[0]
            self.p, self.x, self.covariance = p, x, planned.covariance[0]
            if settled:
                self._finish()
                return
            self.iterations += 1
        self.status = Status.MAX_ITERATIONS

    @property
    def _names(self) -> tuple[str, ...]:
        return self.numbers.names + self.loads.names

    def _problem(self, robot: Assembly, p: FloatArray) -> BoundaryProblem:
        options = {"pose_sensitivities": True, "enabled": self.loads.names, **robot.input_directions(*self._names)}
        inputs = self.loads.inputs(self.inputs, p)
        return robot.problem(inputs, integrator=self.solver.integrator, device=self.device, **options)

    def _at(self, x: FloatArray, p: FloatArray) -> tuple[Posterior, FloatArray, bool] | None:
        """The step planned at some unknowns and numbers, and where it leads the unknowns; None where they are no better than the
        last."""
        shared, away = p[: self.loads.shared], p - self.begin
        try:
            robot = self.numbers.robot(shared)
            problem = self._problem(robot, p)
        except ValueError:  # such as a stiffness beyond all numbers
            return None
        found = Shapes(problem, self._names, self.measured.places).evaluate(x)
        self.integrations += 1
        found = found.by(self.loads.columns(self.numbers.columns(robot, shared)))
        r, J = self.measured.at(found, slice(None))
        given = getattr(self.solver, "tolerance", None)
        tolerance = np.maximum(problem.tolerance(given), TOLERANCE * problem.curvature_scale() if given is None else 0.0)
        gap = float((np.abs(found.residual).max(axis=1) / tolerance).max())
        with np.errstate(invalid="ignore"):
            square = float((r**2).sum() + ((self.root[0] @ away) ** 2).sum())
        closer = square <= self.square * (1 + SLACK) + SETTLED**2
        closer |= gap <= RESTORED * self.gap and self.gap > 1  # what was less there was that of no equilibrium
        if not (closer and np.isfinite(J).all()):
            return None
        self.square, self.gap = square, gap
        stacked, whole = self.loads.wide(J), r.reshape(1, -1)
        planned = posterior(stacked, whole, self.root, away[None], units(stacked, self.prior))
        towards, by = found.eliminated
        towards = towards + (by @ self.loads.each(planned.step[0])[..., None])[..., 0]
        return planned, towards, gap <= 1 and bool(planned.length[0] <= SETTLED)

    def _finish(self) -> None:
        """The fitted robot and its equilibria, if these are what it would stay in."""
        robot, inputs = self.numbers.robot(self.p[: self.loads.shared]), self.loads.inputs(self.inputs, self.p)
        guess = self.x.reshape((*self.solution.batch_shape, -1))
        solution = solve(robot, inputs, solver=self.solver, guess=guess, device=self.device, progress=False)
        failed = solution.failed.reshape(-1)
        if failed.any():
            self.status = Status(int(np.reshape(solution.status, -1)[failed][0]))
        elif np.isin(solution.stability, (Stability.UNSTABLE, Stability.FOLD)).any():
            self.status = Status.UNSTABLE
        else:
            self.robot, self.solution, self.status = robot, solution, Status.CONVERGED
