"""Gauss-Newton steps to the most probable inputs, many instances at once. Numbers in parentheses: ``docs/estimation.md``."""

from dataclasses import dataclass
from math import prod
from typing import Any

import numpy as np
from numpy.typing import NDArray

from multirod.batch import IntArray
from multirod.inputs import Inputs
from multirod.running.simulation import solve, unknowns_of_guess
from multirod.solver import Outcome, Solver, refuse_unfit
from multirod.stability import modes_of
from multirod.status import Status, failures
from multirod.tasks.estimating.bounded import Bounds
from multirod.tasks.estimating.elsewhere import Elsewhere
from multirod.tasks.estimating.inference import SETTLED, damping, deviations, posterior, roots, units
from multirod.tasks.estimating.kinked import Kinked
from multirod.tasks.estimating.let_out import LetOut
from multirod.tasks.estimating.priors import Prior
from multirod.tasks.estimating.settling import Settling
from multirod.tasks.estimating.unknown import Unknown
from multirod.tasks.formulation import Evaluation
from multirod.tasks.freed import values_of, with_values
from multirod.tasks.limits import known_rows
from multirod.tasks.measuring.along import Places
from multirod.tasks.measuring.sensors import Measured, Sensor
from multirod.validation import FloatArray

TOLERANCE = 1e-8  # of the curvatures that arise: moves a tip by 1e-8 of its length
HALVINGS = 8
LIKELY = 3.0  # standard deviations of the priors, beyond which no step goes once one has not come off
EPSILON = float(np.finfo(np.float64).eps)
SHARPEST = 20.0  # residuals of a step that is taken, over the curvatures that arise
RESTORED = 0.5  # of the residual: a step that leaves no more of it is taken too
SLACK = 1e-9  # of the squares' sum, that rounding may add
PLACE = ("x", "p", "square", "gap", "towards", "by", "step", "covariance", "J", "r")


@dataclass(frozen=True)
class Known:
    """What is estimated from what."""

    robot: Any
    inputs: Inputs
    unknown: Unknown[Prior]
    sensors: tuple[Sensor, ...]
    places: Places
    batch_shape: tuple[int, ...]
    solver: Solver
    device: str
    max_iterations: int
    guess: Any


class Part:
    """Some instances: Gauss-Newton steps in the freed inputs, the unknowns eliminated, one integration each.

    ``towards`` and ``by`` say where the equilibrium goes with a step, (2); ``step`` is the one that is tried next, of whose
    length ``part`` is gone, (16), less than all where one did not come off; ``J`` and ``r`` are what it was planned by.
    """

    def __init__(
        self, scene: Known, piece: slice | IntArray, instances: IntArray | None, measured: Measured | None = None
    ) -> None:
        self.scene, self.piece, self.instances = scene, piece, instances
        robot, inputs, names = scene.robot, scene.inputs, scene.unknown.names
        options: dict[str, Any] = {"integrator": scene.solver.integrator, "device": scene.device, "instances": instances}
        limits, unit, task_options = known_rows(robot, None, names)
        self.bounds = Bounds(limits, unit)
        problem = robot.problem(inputs, **options, **task_options)
        self.measured = measured or Measured(scene.sensors, scene.places, scene.batch_shape, instances)
        self.task = self.measured.task(problem, names)
        self.prior = scene.unknown.variances(scene.batch_shape, instances)
        self.root = roots(self.prior)
        self.mean = self.task.values()
        self.count, n, k = problem.instance_count, problem.unknown_count, self.task.count
        self.x, self.p = np.zeros((self.count, n)), np.array(self.mean)
        self.towards, self.by = np.zeros((self.count, n)), np.zeros((self.count, n, k))
        self.step, self.covariance = np.zeros((self.count, k)), np.full((self.count, k, k), np.nan)
        self.square, self.gap = np.full((2, self.count), np.inf)
        rows = self.measured.known.shape[1]
        self.J, self.r = np.zeros((self.count, rows, k)), np.zeros((self.count, rows))
        self.part = np.ones(self.count)
        self.shortened, self.returned = np.zeros((2, self.count), dtype=np.intp)  # how often it was, since it came off
        self.restoring, self.based = np.zeros((2, self.count), dtype=bool)
        self.base = {name: np.array(getattr(self, name)) for name in PLACE}
        self.base_part = np.ones(self.count)
        given = getattr(scene.solver, "tolerance", None)
        scale = problem.curvature_scale()
        self.tolerance = np.maximum(problem.tolerance(given), TOLERANCE * scale if given is None else 0.0)
        self.sharpest = SHARPEST * scale
        self.outcome = Outcome.zeros(self.count)

    def run(self) -> None:
        """Go on until each instance has come to an end."""
        active = self._start()
        self.first = self.x.copy()
        self._go_on(np.ones(self.count, dtype=bool), active)
        if len(self.task.problem.kinks):
            begun = LetOut(self)
            while (chosen := begun.next()).any():
                self.begin_again(chosen)
        self.judge(np.ones(self.count, dtype=bool))
        Elsewhere(self).run()

    @property
    def degrees(self) -> NDArray[np.intp]:
        """How much more was measured than is unknown without a prior, shape (b,)."""
        return np.asarray(self.measured.known.sum(axis=1) - np.isinf(np.diagonal(self.prior, axis1=1, axis2=2)).sum(axis=1))

    def put_at_rest(self, rows: NDArray[np.intp], p: FloatArray, apart: float = 0.0) -> NDArray[np.bool_]:
        """Put some instances where the robot comes to rest at inputs ``p`` (len(rows), k), if that is found, and ``apart`` from
        where they are, over the curvatures that arise; which of all are put, (b,)."""
        put, scene = np.zeros(self.count, dtype=bool), self.scene
        if not len(rows):
            return put
        numbers, names = rows if self.instances is None else self.instances[rows], scene.unknown.names
        every = values_of(scene.inputs, names).reshape(prod(scene.batch_shape), -1)
        every[numbers] = p
        inputs = with_values(scene.inputs, names, every.reshape(*scene.batch_shape, -1))
        options: dict[str, Any] = {"solver": scene.solver, "device": scene.device, "threads": 1, "progress": False}
        found = solve(scene.robot, inputs, instances=numbers, **options)
        self.outcome.integrations[rows] += found.integrations
        x, scale = self.task.problem.adopt(np.nan_to_num(found.unknowns)), self.task.problem.curvature_scale()[rows]
        with np.errstate(invalid="ignore"):
            there = ~found.failed & ~(np.abs(x - self.x[rows]).max(axis=1, initial=0.0) < apart * scale)
        put[rows[there]] = True
        self.x[put], self.p[put] = x[there], p[there]
        return put

    def begin_again(self, chosen: NDArray[np.bool_]) -> None:
        """Seek an end of those ``chosen`` (b,) from the equilibria that they were put to."""
        self._go_on(chosen, self._begin(chosen))

    def _go_on(self, chosen: NDArray[np.bool_], active: NDArray[np.bool_]) -> None:
        """Until each that is ``active`` of those ``chosen`` has come to an end."""
        for _ in range(self.scene.max_iterations):
            if not active.any():
                break
            active = self._advance(active)
        self.outcome.status[active] = Status.MAX_ITERATIONS
        if len(self.task.problem.kinks):
            Kinked(self).run(chosen)
        else:
            Settling(self).run(chosen)

    def _begin(self, chosen: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """Anew at equilibria ``x`` of ``p``; which of all instances are not what is sought already."""
        self.square[chosen] = self.gap[chosen] = np.inf
        self.part[chosen] = self.base_part[chosen] = 1.0
        self.shortened[chosen] = self.returned[chosen] = 0
        self.restoring[chosen] = self.based[chosen] = False
        self.outcome.status[chosen] = Status.NOT_RUN
        self.outcome.integrations[chosen] += 1
        rows, found = np.flatnonzero(chosen), self.task.evaluate(self.x, self.p, chosen)
        active = self._take(rows, self.x[chosen], self.p[chosen], found)
        self.outcome.status[chosen & ~active & (self.outcome.status == Status.NOT_RUN)] = Status.STALLED
        return active

    def judge(self, chosen: NDArray[np.bool_]) -> None:
        """Refuse what the robot would leave of those ``chosen`` (b,), or the problem's own test does: it was at rest when it was
        measured."""
        problem, found = self.task.problem, chosen & (self.outcome.status == Status.CONVERGED)
        doubtful = found & ~(problem.mode_bounds()[:, 0] < 1) if found.any() else found
        if doubtful.any():
            rows = np.flatnonzero(doubtful)
            self.outcome.status[rows[modes_of(problem, rows).left]] = Status.UNSTABLE
        refuse_unfit(problem, self.outcome, chosen)

    def _start(self) -> NDArray[np.bool_]:
        """The equilibria at the priors' means; which of them were found, and are not what is sought already. Those of which less
        was measured than is unknown without a prior are left out."""
        problem, every = self.task.problem, np.arange(self.count)
        enough = self.degrees >= 0
        at_rest = not (np.any(problem.guess_integrations) or problem.load_scale().any() or problem.turning().any())
        if self.scene.guess is None and not at_rest:
            self.outcome = self.scene.solver.solve(problem)
            self.x = problem.read("unknowns")
            good = ~failures(self.outcome.status)
            self.outcome.status[good] = Status.NOT_RUN
            good &= enough
            if self.scene.places.at.size:  # which it did not tell of
                found = self.task.evaluate(np.where(good[:, None], self.x, 0.0), self.p, good)
                self.outcome.integrations[good] += 1
            else:
                found = self.task.last(every[good])
        else:
            self.x, good = self._guessed(), enough
            found = self.task.evaluate(self.x, self.p, good)
            self.outcome.integrations[good] += 1
        self.outcome.status[~enough & (self.outcome.status == Status.NOT_RUN)] = Status.UNOBSERVABLE
        return self._take(every[good], self.x[good], self.p[good], found)

    def _guessed(self) -> FloatArray:
        """What was given as a guess, of these instances; else the robot at rest."""
        problem, guess = self.task.problem, self.scene.guess
        if guess is None:
            return problem.guess()
        return np.array(unknowns_of_guess(guess, problem, prod(self.scene.batch_shape), self.piece))

    def _advance(self, active: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """One integration where the next step leads; which instances go on."""
        part = np.where(active, self.part, 0.0)[:, None]
        still = self.restoring[:, None]
        along, step = np.where(still, part, part > 0), np.where(still | ~active[:, None], 0.0, self.step)
        short = np.flatnonzero(active & ~self.restoring & (self.part < 1))
        if len(short):
            step[short] = self._damped(short)
        x = self.x + np.where(along > 0, along * self.towards, 0.0) + (self.by @ step[..., None])[..., 0]
        p = self.bounds.kept(self.p + step, self.p)
        chosen = np.flatnonzero(active)
        found = self.task.evaluate(x, p, active)
        self.outcome.iterations[chosen] += 1
        self.outcome.integrations[chosen] += 1
        go_on = self._take(chosen, x[chosen], p[chosen], found)
        self.outcome.status[active & ~go_on & (self.outcome.status == Status.NOT_RUN)] = Status.STALLED
        return go_on

    def _damped(self, own: NDArray[np.intp]) -> FloatArray:
        """(16) Their steps, as long as ``part`` of those planned; shape (b, k)."""
        J, r, root, away = self.J[own], self.r[own], self.root[own], self.p[own] - self.mean[own]
        unit = units(J, self.prior[own])
        damped = np.sqrt(damping(J, r, root, away, unit, self.part[own]))[:, None, None] * np.eye(J.shape[2]) / unit[:, None]
        rows, sides = np.concatenate([J, damped], axis=1), np.concatenate([r, np.zeros(away.shape)], axis=1)
        told = rows, sides, root, away, unit
        return self.bounds.step(posterior(*told), self.p[own], told)[0]

    def _take(self, chosen: NDArray[np.intp], x: FloatArray, p: FloatArray, found: Evaluation) -> NDArray[np.bool_]:
        """Take a step that came off, and plan the next; which of all instances go on."""
        r, J = self.measured.at(found, chosen)
        root, away = self.root[chosen], p - self.mean[chosen]
        square = (r**2).sum(axis=1) + ((root @ away[..., None])[..., 0] ** 2).sum(axis=1)
        gap = np.abs(found.residual).max(axis=1)
        with np.errstate(invalid="ignore"):
            closer = square <= self.square[chosen] * (1 + SLACK) + SETTLED**2
            closer |= gap <= RESTORED * self.gap[chosen]  # what was less there was that of no equilibrium
            closer = np.where(self.restoring[chosen], gap < self.gap[chosen], closer)
            came_off = closer & (gap <= np.maximum(self.sharpest[chosen], self.gap[chosen]))
        came_off &= np.isfinite(J).all(axis=(1, 2))
        own = chosen[came_off]
        told = J[came_off], r[came_off], root[came_off], away[came_off], units(J[came_off], self.prior[own])
        planned = posterior(*told)
        step, length = self.bounds.step(planned, p[came_off], told)
        towards, by = found.take(came_off).eliminated
        unit, was = told[4], self.step[own]
        longer = np.linalg.norm(step / unit, axis=1) / np.maximum(np.linalg.norm(was / unit, axis=1), EPSILON)
        self.x[own], self.p[own], self.square[own], self.gap[own] = x[came_off], p[came_off], square[came_off], gap[came_off]
        self.J[own], self.r[own] = J[came_off], r[came_off]
        self.towards[own], self.by[own], self.step[own], self.covariance[own] = towards, by, step, planned.covariance
        settled = (length <= SETTLED) & (gap[came_off] <= self.tolerance[own])
        self.outcome.status[own[settled]] = Status.CONVERGED
        free = (self.part[own] == 1) | self.restoring[own]
        self.part[own] = np.where(free, 1.0, np.minimum(1.0, 2 * self.part[own] / np.maximum(longer, EPSILON)))
        self._shorten(chosen[~came_off])
        self.shortened[own] = 0
        go_on = np.zeros(self.count, dtype=bool)
        go_on[chosen] = True
        go_on[own[settled]] = False
        self._rest(own[~settled], go_on)
        self._restore(chosen[~came_off], go_on)
        return go_on

    def _shorten(self, own: NDArray[np.intp]) -> None:
        """Half as far, and no farther than what the priors make likely: where rods buckle, the first step may lead far beyond."""
        gone = self.part[own] * np.linalg.norm(
            self.step[own] / deviations(self.prior[own]), axis=1
        )  # none where nothing is known
        likely = np.where(self.restoring[own], 1.0, LIKELY / np.maximum(gone, LIKELY))
        self.part[own] *= np.minimum(0.5, likely)
        self.shortened[own] += 1

    def _rest(self, own: NDArray[np.intp], go_on: NDArray[np.bool_]) -> None:
        """Those that are at an equilibrium now go on from there, or from the last one, where (1) was less."""
        own = own[self.gap[own] <= self.tolerance[own]]
        worse = self.restoring[own] & self.based[own] & ~(self.square[own] < self.base["square"][own])
        self._go_back(own[worse], go_on)
        own = own[~worse]
        self.part[own] = np.where(self.restoring[own], 1.0, self.part[own])
        self.restoring[own], self.based[own], self.base_part[own] = False, True, self.part[own]
        self.returned[own] = 0
        for name, values in self.base.items():
            values[own] = getattr(self, name)[own]

    def _restore(self, own: NDArray[np.intp], go_on: NDArray[np.bool_]) -> None:
        """Those whose step did not come off, however short: where it began at no equilibrium, that is sought, ``p`` as it is."""
        short = own[self.shortened[own] > HALVINGS]
        sought = ~self.restoring[short] & (self.gap[short] > self.tolerance[short]) & np.isfinite(self.gap[short])
        self.restoring[short[sought]], self.part[short[sought]], self.shortened[short[sought]] = True, 1.0, 0
        short = short[~sought]
        back = self.restoring[short] & self.based[short]
        go_on[short[~back]] = False
        self._go_back(short[back], go_on)

    def _go_back(self, own: NDArray[np.intp], go_on: NDArray[np.bool_]) -> None:
        """To the last equilibrium, from which the next step is a quarter as long as the last was."""
        for name, values in self.base.items():
            getattr(self, name)[own] = values[own]
        self.base_part[own] /= 4
        self.returned[own] += 2
        self.part[own], self.restoring[own], self.shortened[own] = self.base_part[own], False, 0
        go_on[own] = self.returned[own] <= HALVINGS
