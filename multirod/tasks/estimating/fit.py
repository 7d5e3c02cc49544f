"""Gauss-Newton steps in parameters that shapes share, and in loads of each. Numbers in parentheses: ``docs/estimation.md``."""

from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass
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
from multirod.tasks.estimating.inference import SETTLED, Posterior, consistent, posterior, roots, units
from multirod.tasks.estimating.iteration import HALVINGS, RESTORED, SLACK, TOLERANCE
from multirod.tasks.estimating.kinked import ENDLESS
from multirod.tasks.estimating.loads import Loads
from multirod.tasks.estimating.parameters import Parameters
from multirod.tasks.estimating.settling import SHORTEST, SPENT, falls, next_reach, promised
from multirod.tasks.formulation import Evaluation
from multirod.tasks.measuring.along import AlongTask, Places
from multirod.tasks.measuring.sensors import Measured
from multirod.validation import FloatArray

LEFT_OUT = 0.25  # of the shapes, of those that are far from the robot as it is
ASTRAY = 2  # halvings of a step from what is no equilibrium
FAR = 10.0  # times what a number may well be off, that it may be changed by


@dataclass(frozen=True)
class Place:
    """What one integration of each shape says at unknowns ``x`` (b, n) and numbers ``p`` (k,).

    Attributes:
        square: (1), what is left of ``eps`` taken out to first order.
        squares: Of that, those of the rows of each shape, shape (b,).
        gap: The largest ``eps`` over its tolerance: at most 1 at an equilibrium.
        planned: The next step.
        towards: ``a`` of (2), to the equilibrium of these numbers, shape (b, n).
        change: To that of the next ones.
    """

    x: FloatArray
    p: FloatArray
    square: float
    squares: FloatArray
    gap: float
    planned: Posterior
    towards: FloatArray
    change: FloatArray


class Shapes(AlongTask):
    """All shapes of one robot; what is freed are columns by its parameters."""

    def __init__(self, problem: BoundaryProblem, names: Sequence[str], places: Places) -> None:
        self.problem, self.free, self._columns = problem, tuple(names), None  # parameters have no places among inputs
        self._sense(places)

    def evaluate(self, unknowns: FloatArray, *_: object) -> Evaluation:
        """One integration at ``x`` (b, n)."""
        with self.problem.alone:
            self.problem.write("unknowns", unknowns)
            self.problem.aim(*self.free)
            self.integrate()
            return self.last()


@dataclass(frozen=True)
class Odd:
    """Shapes without which the others fit.

    Attributes:
        shapes: Their numbers.
        misfit: (1) Of the others.
        degrees: Theirs.
    """

    shapes: tuple[int, ...]
    misfit: float
    degrees: int


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
        self.status, self.square, self.degrees = Status.NOT_RUN, np.inf, 0
        self.squares = self.first = np.zeros(len(self.x))
        self.odd: Odd | None = None
        self.covariance = np.full((len(self.p), len(self.p)), np.nan)
        self.likely = np.concatenate([numbers.likely, np.full(loads.mean.size, np.inf)])
        self.prior = loads.prior(numbers.prior)[None]
        self.root = roots(self.prior)

    def run(self, most: int) -> None:
        """Go on until a step tells nothing; from elsewhere too if what is found is not likely, or nothing."""
        x, p, begin = self.x, self.p, self.solution
        self._run(most)
        if len(self.x) > 1 and not self.loads.names and not consistent(self.square, self.degrees):
            self._begin_again(x, p, begin, most)

    def _anew(self, measured: Measured, x: FloatArray, p: FloatArray, solution: Solution[Any]) -> "Fit":
        """A fit of the same robot to ``measured``, from ``x`` and ``p``."""
        result = copy(self)
        result.measured, result.x, result.p, result.solution = measured, x, p, solution
        result.status, result.iterations, result.integrations = Status.NOT_RUN, 0, 0
        return result

    def _begin_again(self, x: FloatArray, p: FloatArray, begin: Solution[Any], most: int) -> None:
        """(26) By others than the shape that fits worst, or than those that did at the start, from ``x`` and ``p`` as ever, then
        by all from where the robot that fits these comes to rest; what is less likely is left."""
        worst, far = self.squares.argsort()[-1:], self.first.argsort()[::-1][: int(LEFT_OUT * len(x))]
        others: Fit | None = None
        for left in filter(len, (worst, far)):  # few shapes have none that are far
            fewer = self._anew(self.measured.without(left), x, p, begin)
            fewer.degrees -= int(self.measured.known[left].sum())
            fewer._run(most)
            self.integrations += fewer.integrations
            if fewer.status is Status.CONVERGED:
                others = fewer
                if consistent(fewer.square, fewer.degrees):
                    self.odd = Odd(tuple(left.tolist()), float(fewer.square), fewer.degrees)
                    break
        if others is None:
            return
        shapes = solve(others.robot, self.inputs, solver=self.solver, device=self.device, progress=False)
        self.integrations += int(shapes.integrations.max(initial=0))
        if shapes.failed.any():
            return
        every = self._anew(self.measured, shapes.unknowns.reshape(self.x.shape), others.p, shapes)
        every._run(most)
        self.integrations += every.integrations
        if every.status is Status.CONVERGED and (self.status.failed or every.square < self.square):
            every.integrations = self.integrations
            every.iterations += self.iterations + others.iterations
            every.odd = None
            vars(self).update(vars(every))

    def _run(self, most: int) -> None:
        x, p = self.x, self.p
        if self.loads.names:  # whose terms the start may have gone without
            x = self._problem(self.robot, p).adopt(x)
        here = self._at(x, p)
        assert here is not None  # it is the robot as it is
        self.first = here.squares
        leads_far = self._most(here) < 1
        eased = self._eased(x, p, most) if leads_far else None
        here, base = self._go_on(eased or here, most)
        if self.status in ENDLESS and not leads_far and (eased := self._eased(x, p, most)) is not None:
            here, base = self._go_on(eased, most)
        if self.status in ENDLESS:
            self._settle(self._at_rest(here), base, most)

    def _eased(self, x: FloatArray, p: FloatArray, most: int) -> Place | None:
        """(13c) Where the fit from ``x`` and ``p`` ends if nothing is off by much more than it may well be; None if it does not,
        or there are priors for all."""
        priors = np.diagonal(self.prior, axis1=1, axis2=2)
        free = np.isinf(priors[0]) & np.isfinite(self.likely)
        if not free.any():
            return None
        eased = self._anew(self.measured, x, p, self.solution)
        eased.prior = self.prior.copy()
        eased.prior[0, free, free] = self.likely[free] ** 2
        eased.root = roots(eased.prior)
        start = eased._at(x, p)
        assert start is not None  # it is where this one began
        eased._go_on(start, most)
        self.integrations += eased.integrations
        self.iterations += eased.iterations
        return self._at(eased.x, eased.p) if eased.status is Status.CONVERGED else None

    def _go_on(self, here: Place, most: int) -> tuple[Place, Place]:
        """Steps that need not end at equilibria; returns where they ended, and the last equilibrium on the way."""
        base, part, base_part, returned, last = here, 1.0, 1.0, 0, self.iterations + most
        while self.iterations <= last:
            if here.gap <= 1:
                base, base_part, returned = here, part, 0
            if self._ends(here):
                return here, base
            there = self._closer(here, part)
            if there is not None:
                here, part = there, min(1.0, 2 * part)
                self.iterations += 1
                continue
            part /= 2
            if part >= (0.5**HALVINGS if here.gap <= 1 else 0.5**ASTRAY):
                continue
            # where it began at no equilibrium, that is sought, the numbers as they are
            at_rest = self._at_rest(here) if here.gap > 1 else None
            if at_rest is not None and (here is base or at_rest.square < base.square):
                here, part = at_rest, 1.0
                continue
            returned += 2
            if here is base or returned > HALVINGS:
                self.status = Status.STALLED
                return here, base
            base_part /= 4
            here, part = base, base_part
        self.status = Status.MAX_ITERATIONS
        return here, base

    def _settle(self, near: Place | None, base: Place, most: int) -> None:
        """(21) From one equilibrium to the next, each where (1) is less; the first is ``near``, or ``base`` if there is none."""
        here, reach = near or base, np.array(np.inf)
        allowed = self.integrations + SPENT * most
        while here.gap <= 1 and self.integrations < allowed and not self._ends(here):
            length = here.planned.length[0]
            along = np.minimum(self._most(here), reach / length)
            gone, saved = along * length, promised(along, length)
            if gone < SHORTEST:
                return
            change = along * (here.change - here.towards)
            ahead = self._at(here.x + change, here.p + along * here.planned.step[0])
            there = None if ahead is None else self._at_rest(ahead)
            was, square = np.array(here.square), np.array(np.inf if there is None else there.square)
            reach = next_reach(reach, gone, (was - square) / saved)
            if there is not None and falls(square, was, saved):
                here = there

    def _ends(self, here: Place) -> bool:
        """Stand there; whether that is the end, an equilibrium whose next step tells nothing."""
        self.x, self.p, self.square, self.squares = here.x, here.p, here.square, here.squares
        self.covariance = here.planned.covariance[0]
        if here.gap > 1 or here.planned.length[0] > SETTLED:
            return False
        self._finish()
        return True

    @property
    def _names(self) -> tuple[str, ...]:
        return self.numbers.names + self.loads.names

    def _problem(self, robot: Assembly, p: FloatArray) -> BoundaryProblem:
        options = {"pose_sensitivities": True, "enabled": self.loads.names, **robot.input_directions(*self._names)}
        inputs = self.loads.inputs(self.inputs, p)
        return robot.problem(inputs, integrator=self.solver.integrator, device=self.device, **options)

    def _at(self, x: FloatArray, p: FloatArray) -> Place | None:
        """What one integration of each shape says; None where there is no such robot, or it leads nowhere."""
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
        if not np.isfinite(J).all():
            return None
        squares = (r**2).sum(axis=1)
        square = float(squares.sum() + ((self.root[0] @ away) ** 2).sum())
        given = getattr(self.solver, "tolerance", None)
        tolerance = np.maximum(problem.tolerance(given), TOLERANCE * problem.curvature_scale() if given is None else 0.0)
        gap = float((np.abs(found.residual).max(axis=1) / tolerance).max())
        stacked, whole = self.loads.wide(J), r.reshape(1, -1)
        planned = posterior(stacked, whole, self.root, away[None], units(stacked, self.prior))
        towards, by = found.eliminated
        change = (by @ self.loads.each(planned.step[0])[..., None])[..., 0]
        return Place(x, p, square, squares, gap, planned, towards, towards + change)

    def _most(self, here: Place) -> float:
        """(13c) How much of a step is gone at most, so that no number is further from where it began than it may be."""
        step, gone = here.planned.step[0] / self.likely, (here.p - self.begin) / self.likely
        moves = np.abs(step) > 0
        return float(((FAR - np.sign(step) * gone)[moves] / np.abs(step[moves])).min(initial=1.0))

    def _closer(self, here: Place, part: float) -> Place | None:
        """A part of the step, where squares are no more, or it is much nearer to an equilibrium."""
        part = min(part, self._most(here))
        if part < 0.5**HALVINGS:
            return None
        there = self._at(here.x + part * here.change, here.p + part * here.planned.step[0])
        if there is None:
            return None
        closer = there.square <= here.square * (1 + SLACK) + SETTLED**2
        closer |= there.gap <= RESTORED * here.gap and here.gap > 1  # what was less there was that of no equilibrium
        return there if closer else None

    def _at_rest(self, here: Place) -> Place | None:
        """The equilibrium of the same numbers; None where Newton's method, its steps halved, does not lead to it."""
        along = 1.0
        while here.gap > 1 and along >= 0.5**HALVINGS:
            there = self._at(here.x + along * here.towards, here.p)
            if there is None or not there.gap < here.gap:
                along /= 2
            else:
                here, along = there, min(1.0, 2 * along)
        return here if here.gap <= 1 else None

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
