"""The most probable inputs behind measurements, and how sure they are. Numbers in parentheses: ``docs/estimation.md``."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from math import prod
from threading import Event, Lock
from typing import Any, Generic, Self

import numpy as np
from numpy.typing import NDArray

from multirod.assembly import Assembly, Robot, Robot_co
from multirod.batch import IntArray, parts, run, thread_count
from multirod.inputs import Inputs
from multirod.results.remarks import Remarks
from multirod.results.scene import Scene
from multirod.results.solution import Solution
from multirod.running.simulation import as_solver, unknowns_of_guess
from multirod.solver import Outcome, Solver, refuse_unfit
from multirod.stability import Stability, modes_of
from multirod.status import Status, failures
from multirod.tasks.estimating.bounded import Bounds
from multirod.tasks.estimating.inference import damping, deviations, kept, posterior, principal, roots, units
from multirod.tasks.estimating.priors import Prior
from multirod.tasks.formulation import Evaluation, freed, places_of, with_values
from multirod.tasks.limits import freed_labels, known_rows
from multirod.tasks.measuring.curvature import Places
from multirod.tasks.measuring.sensors import Measured, Sensor, batch_of, checked, refuse_nothing
from multirod.types import Numbers, StatusOrArray
from multirod.validation import Described, FloatArray, choice, device_name, frozen, instance, positive_int, refuse

SETTLED = 1e-2  # standard deviations: a step that is less adds 1e-4 to the error's variance
TOLERANCE = 1e-8  # of the curvatures that arise: moves a tip by 1e-8 of its length
SEEN = 0.5  # of the prior's variance: where more is kept, the prior says more than the measurements
HALVINGS = 8
LIKELY = 3.0  # standard deviations of the priors, beyond which no step goes once one has not come off
EPSILON = float(np.finfo(np.float64).eps)
SHARPEST = 20.0  # residuals of a step that is taken, over the curvatures that arise
ROUNDED = 1e-9  # of the largest of some numbers, what is not shown
FORCES = ("tip_force", "follower_force")  # whose covariance can be drawn
RESTORED = 0.5  # of the residual: a step that leaves no more of it is taken too
SLACK = 1e-9  # of the squares' sum, that rounding may add
PLACE = ("x", "p", "square", "gap", "towards", "by", "step", "covariance", "J", "r")


class Estimate(Generic[Robot_co]):
    """Inputs behind measurements: normal distributions to first order, one an instance; arrays have leading axes ``...``.

    What failed is NaN; ``status`` says why.

    Attributes:
        unknown: Names of what was estimated.
        solution: The equilibria at the most probable inputs.
        missing: Whether numbers of each sensor were missing, and it went on without them, shape (..., sensor_count).
        misfit: (1) Sum of squares of what measurements and priors are off, in standard deviations, shape (...): where these are
            right it is ``degrees`` on average.
        degrees: Numbers measured and not rejected, less those that are unknown without a prior, shape (...).
        dropped: What was missing or rejected, in words, such as ``"y of sensor 0"``; of an estimate without leading axes.
        rejected: Whether what each sensor says was left out as an outlier, by the ``gate`` of an ``Estimator``, shape
            (..., sensor_count).
    """

    def __init__(
        self,
        solution: Solution[Robot_co],
        places: Mapping[str, slice],
        mean: FloatArray,
        covariance: FloatArray,
        prior: FloatArray,
        missing: NDArray[np.bool_],
        misfit: FloatArray,
        degrees: NDArray[np.intp],
        dropped: tuple[str, ...] = (),
        rejected: NDArray[np.bool_] | None = None,
        *,
        bounds: Bounds,
    ) -> None:
        self.solution = solution
        self._bounds = bounds
        self.dropped = dropped
        self.rejected: NDArray[np.bool_] = frozen(np.zeros_like(missing) if rejected is None else rejected)
        self.unknown = tuple(places)
        self._places, self._mean, self._covariance, self._prior = dict(places), mean, covariance, prior
        self.missing: NDArray[np.bool_] = frozen(missing)
        self.misfit: FloatArray = frozen(misfit)
        self.degrees: NDArray[np.intp] = frozen(degrees)

    @property
    def assembly(self) -> Robot_co:
        """The robot."""
        return self.solution.assembly

    @property
    def robot(self) -> Robot_co:
        """The robot, as ``assembly``."""
        return self.solution.assembly

    @property
    def batch_shape(self) -> tuple[int, ...]:
        """The leading axes."""
        return self.solution.batch_shape

    @property
    def status(self) -> StatusOrArray:
        """``Status`` of each instance, as of a solution."""
        return self.solution.status

    @property
    def failed(self) -> NDArray[np.bool_]:
        """Whether there is no result, shape (...)."""
        return self.solution.failed

    @property
    def integrations(self) -> NDArray[np.int32]:
        """Initial value problems integrated, per rod, shape (...)."""
        return self.solution.integrations

    def raise_if_failed(self) -> Self:
        """Return ``self`` if every instance has a result.

        Raises:
            SolveError: Otherwise.
        """
        self.solution.raise_if_failed()
        return self

    def value(self, name: str) -> FloatArray:
        """The most probable value of an unknown, shape (..., k).

        Raises:
            ValueError: If it was not estimated.
        """
        return np.asarray(frozen(self._mean[..., self._place(name)]))

    def covariance(self, name: str | None = None) -> FloatArray:
        """(6) Its covariance, shape (..., k, k); without a name, of all unknowns one after another.

        Infinite on the diagonal, and NaN beside it, where there is no prior and the measurements do not determine it.
        """
        place = slice(None) if name is None else self._place(name)
        return np.asarray(frozen(self._covariance[..., place, place]))

    def sigma(self, name: str) -> FloatArray:
        """Standard deviation of each component, shape (..., k)."""
        return np.asarray(frozen(np.sqrt(np.diagonal(self.covariance(name), axis1=-2, axis2=-1))))

    def kept(self, name: str) -> FloatArray:
        """(8) What part of its prior's variance each component has kept, shape (..., k): 1 where nothing was told of it."""
        place = self._place(name)
        return np.asarray(frozen(kept(self._covariance[..., place, place], self._prior[..., place, place])))

    def directions(self, name: str) -> tuple[FloatArray, FloatArray]:
        """(9) Directions of an unknown, and what part of the prior's variance is kept along each, the least seen first.

        Returns:
            Unit columns, shape (..., k, k), and parts, shape (..., k). NaN without a prior.
        """
        place = self._place(name)
        axes, part = principal(self._covariance[..., place, place], self._prior[..., place, place])
        return np.asarray(frozen(axes)), np.asarray(frozen(part))

    @cached_property
    def observable(self) -> dict[str, NDArray[np.bool_]]:
        """Whether measurements say more of each component than its prior does, (..., k) by name: half of its variance went."""
        return {name: np.asarray(frozen(self.kept(name) <= SEEN)) for name in self.unknown}

    @cached_property
    def at_limit(self) -> NDArray[np.bool_]:
        """Which of the unknown numbers, in the order of ``unknown``, stand at a limit of the robot, such as a tension of 0, shape
        (..., k)."""
        return np.asarray(frozen(self._bounds.at_limit(self._mean)))

    def _place(self, name: str) -> slice:
        return self._places[choice("name", name, self._places)]

    def __repr__(self) -> str:
        if self.batch_shape:
            return f"Estimate({', '.join(self.unknown)}; batch {self.batch_shape}: {self.solution._counts(slice(None))})"
        if self.failed:
            return f"Estimate({self.status.name}: {self.status.message})"
        parts = [f"{name} {_numbers(self.value(name))} +- {_numbers(self.sigma(name))}" for name in self.unknown]
        parts += [f"unobservable: {said}" for name in self.unknown for said in [self._unseen(name)] if said]
        labels = freed_labels(self.unknown, [self.value(name).shape[-1] for name in self.unknown])
        held = [label for label, own in zip(labels, self.at_limit.tolist(), strict=True) if own]
        parts += [f"at a limit: {', '.join(held)}"] if held else []
        parts += [f"without {', '.join(self.dropped)}"] if self.dropped else []
        return f"Estimate({self.status.name}; {'; '.join(parts)})"

    def _unseen(self, name: str) -> str:
        """Directions of an unknown that were not seen, in words; empty if there are none."""
        axes, part = self.directions(name)
        if np.isfinite(part).all():
            found = [f"along {_numbers(axes[:, k])}, {part[k]:.0%} of the prior's variance is kept" for k in range(len(part))]
            return "; ".join(f"{name} {text}" for text, own in zip(found, part, strict=True) if own > SEEN)
        lost = np.flatnonzero(~self.observable[name])
        return f"{name}[{', '.join(map(str, lost))}]" if len(lost) else ""


def estimate(
    robot: Robot,
    inputs: Inputs | None = None,
    *,
    unknown: Mapping[str, Prior],
    measured: Sensor | Sequence[Sensor],
    solver: Solver | None = None,
    guess: Solution | Numbers | None = None,
    max_iterations: int = 30,
    device: str = "cpu",
    threads: int | None = None,
) -> Estimate[Robot]:
    """The most probable inputs behind measurements, and their covariance (``docs/estimation.md``).

    An iteration is one integration. Inputs, priors, measurements and the robot may have leading axes, which broadcast: each entry
    is an instance of its own.

    Args:
        robot: The assembly.
        inputs: What is known of the others, made by ``robot.inputs(...)``; none are all zero.
        unknown: What is to be estimated: inputs by name, each with its ``Prior``.
        measured: ``Pose``, ``Curvature``, or several, each with ``sigma``. What is NaN is gone without, and
            ``missing`` says so.
        solver: That finds the equilibrium at the priors' means, where it begins; its integrator and tolerance are used.
        guess: Where to begin instead: a solution, or unknowns (..., n), at the priors' means.
        max_iterations: Steps allowed.
        device: Warp device.
        threads: That share the parts of a batch on the CPU; one for each core by default.

    Returns:
        One estimate an instance, each with its status.

    Raises:
        TypeError: If an unknown is no input of the robot, or a measurement none.
        ValueError: If an argument is not what it must be, or more is unknown without a prior than measured.
    """
    method = as_solver(robot, solver)
    device = device_name("device", device)
    given = robot.accept(inputs)
    priors = checked_priors(robot, given, unknown)
    sensors = checked("measured", measured)
    most = positive_int("max_iterations", max_iterations)
    whole = _axes(robot, given, priors, sensors)
    places = Places(robot, given, sensors)
    if _flat(priors, given):
        refuse_nothing("measured", Measured(sensors, places, whole, None).known)
    _refuse_more(priors, given, sum(sensor.count for sensor in sensors))
    scene = Known(robot, at_means(robot, given, priors, whole), priors, sensors, places, whole, method, device, most, guess)
    count = prod(whole)
    workers = thread_count(threads)
    pieces = parts(count, workers, robot.rod_count) if count else []
    found: dict[int, Part] = {}
    lock = Lock()

    def work(piece: slice, stop: Event) -> None:
        with lock:
            part = Part(scene, piece, np.arange(piece.start, piece.stop) if len(pieces) > 1 else None)
        part.task.problem.stop = stop
        part.run()
        found[piece.start] = part

    run(work, pieces, workers)
    return _joined(scene, [found[piece.start] for piece in pieces])


@dataclass(frozen=True)
class Known:
    """What is estimated from what."""

    robot: Any
    inputs: Inputs
    priors: dict[str, Prior]
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
        self.scene, self.piece = scene, piece
        robot, inputs, names = scene.robot, scene.inputs, tuple(scene.priors)
        options: dict[str, Any] = {"integrator": scene.solver.integrator, "device": scene.device, "instances": instances}
        limits, unit, task_options = known_rows(robot, None, names)
        self.bounds = Bounds(limits, unit)
        problem = robot.problem(inputs, **options, **task_options)
        self.measured = measured or Measured(scene.sensors, scene.places, scene.batch_shape, instances)
        whole = (scene.batch_shape, instances)
        self.task = self.measured.task(problem, names)
        self.prior = block_diagonal(
            [scene.priors[name].variances(name, getattr(inputs, name).shape[-1], *whole) for name in names]
        )
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
        for _ in range(self.scene.max_iterations):
            if not active.any():
                break
            active = self._advance(active)
        self.outcome.status[active] = Status.MAX_ITERATIONS
        self._judge()

    def _judge(self) -> None:
        """Refuse what the robot would leave, or the problem's own test does: it was at rest when it was measured."""
        found = self.outcome.status == Status.CONVERGED
        if not found.any():
            return
        problem = self.task.problem
        doubtful = found & ~(problem.mode_bounds()[:, 0] < 1)
        if doubtful.any():
            unstable = np.isin(modes_of(problem).stability, (Stability.UNSTABLE, Stability.FOLD))
            self.outcome.status[doubtful & unstable] = Status.UNSTABLE
        refuse_unfit(problem, self.outcome)

    def _start(self) -> NDArray[np.bool_]:
        """The equilibria at the priors' means; which of them were found, and are not what is sought already."""
        problem, every = self.task.problem, np.arange(self.count)
        at_rest = not (np.any(problem.guess_integrations) or problem.load_scale().any() or problem.turning().any())
        if self.scene.guess is None and not at_rest:
            self.outcome = self.scene.solver.solve(problem)
            self.x = problem.read("unknowns")
            good = ~failures(self.outcome.status)
            self.outcome.status[good] = Status.NOT_RUN
            if self.scene.places.rods:  # which it did not tell of
                found = self.task.evaluate(np.where(good[:, None], self.x, 0.0), self.p, good)
                self.outcome.integrations[good] += 1
            else:
                found = self.task.last(every[good])
        else:
            self.x = self._guessed()
            good = np.ones(self.count, dtype=bool)
            found = self.task.evaluate(self.x, self.p)
            self.outcome.integrations += 1
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


def _joined(scene: Known, pieces: Sequence[Part]) -> Estimate[Any]:
    """The estimate of all instances from its parts."""
    first, shape = pieces[0], scene.batch_shape

    def join(name: str) -> FloatArray:
        values = np.concatenate([getattr(part, name) for part in pieces])
        return np.asarray(values.reshape((*shape, *values.shape[1:])))

    outcome = Outcome.joined([Outcome(p.outcome.status, p.outcome.iterations, p.outcome.integrations) for p in pieces])
    records = np.concatenate([part.task.problem.snapshot() for part in pieces])
    places = places_of(scene.inputs, tuple(scene.priors))
    failed = failures(outcome.status).reshape(shape)
    mean, covariance, misfit = (np.array(join(name)) for name in ("p", "covariance", "square"))
    for values in (mean, covariance, misfit):
        values[failed] = np.nan
    known = np.where(failed[..., None], join("mean"), mean)  # an input cannot be NaN
    inputs = with_values(scene.inputs, tuple(scene.priors), known)
    results = Scene(scene.robot, shape, scene.solver.integrator, scene.device, first.task.problem.record_fields)
    solution: Solution[Any] = Solution(results, records, outcome, inputs)
    if not shape:
        solution._remarks = remarked(places, covariance, first.measured)
    prior = join("prior")
    rows = np.concatenate([part.measured.known.sum(axis=1) for part in pieces]).reshape(shape)
    flat = np.isinf(np.diagonal(prior, axis1=-2, axis2=-1)).sum(axis=-1)
    missing = np.concatenate([part.measured.missing for part in pieces])
    missing = missing.reshape((*shape, missing.shape[-1]))
    dropped = () if shape else first.measured.dropped()
    return Estimate(solution, places, mean, covariance, prior, missing, misfit, rows - flat, dropped, bounds=first.bounds)


def remarked(places: Mapping[str, slice], covariance: FloatArray, measured: Measured) -> Remarks:
    """What a recording shows of an estimate without leading axes, ``covariance`` (k, k)."""
    forces = {name: covariance[place, place] for name, place in places.items() if name in FORCES}
    return Remarks(measured=measured.position(), covariances=forces)


def checked_priors(robot: Assembly, inputs: Inputs, unknown: object) -> dict[str, Prior]:
    """Checked priors by the names of inputs."""
    if not isinstance(unknown, Mapping):
        raise TypeError(
            f"unknown = {unknown!r} is not allowed: must be priors by name, such as {{'tip_force': Prior(sigma=0.25)}}"
        )
    names = freed("unknown", robot, tuple(unknown))
    for name in names:
        instance(f"unknown[{name!r}]", unknown[name], Prior, "a Prior")
        if name in inputs.profiles:
            refuse(name, Described("a function of arclength"), "must be numbers, where it is to be estimated")
    return {name: unknown[name] for name in names}


def _axes(robot: Assembly, inputs: Inputs, priors: Mapping[str, Prior], sensors: Sequence[Sensor]) -> tuple[int, ...]:
    """Leading axes of all together."""
    shapes = {"inputs": inputs.batch_shape, "the robot": robot.batch_shape, "measured": batch_of(sensors)}
    shapes |= {f"the prior of {name}": prior.batch_shape for name, prior in priors.items()}
    try:
        return np.broadcast_shapes(*shapes.values())
    except ValueError:
        said = ", ".join(f"{name} {shape}" for name, shape in shapes.items())
        raise ValueError(f"the leading axes do not broadcast: {said}") from None


def at_means(robot: Assembly, inputs: Inputs, priors: Mapping[str, Prior], whole: tuple[int, ...]) -> Inputs:
    """The inputs at the priors' means, of all leading axes."""
    held = inputs.arrays
    for name, prior in priors.items():
        values = prior.means(name, getattr(inputs, name), whole, None)
        held[name] = values.reshape((*whole, values.shape[-1]))
    return robot.accept(inputs.with_arrays(held), "the priors' means")


def _flat(priors: Mapping[str, Prior], inputs: Inputs) -> dict[str, int]:
    """How many numbers of each input have no prior, of those where any has none."""
    counts = {name: prior.flat_count(name, getattr(inputs, name).shape[-1]) for name, prior in priors.items()}
    return {name: count for name, count in counts.items() if count}


def _refuse_more(priors: Mapping[str, Prior], inputs: Inputs, rows: int) -> None:
    """Refuse more numbers without a prior than are measured."""
    flat = _flat(priors, inputs)
    if sum(flat.values()) > rows:
        names = ", ".join(f"{count} of {name}" for name, count in flat.items())
        refuse(
            "unknown",
            Described(f"{sum(flat.values())} numbers without a prior ({names})"),
            f"must be at most as many as are measured, {rows}: the others are unobservable; give them priors, or measure more",
        )


def block_diagonal(blocks: Sequence[FloatArray]) -> FloatArray:
    """(b, k, k) of blocks of each."""
    size = sum(block.shape[-1] for block in blocks)
    result = np.zeros((len(blocks[0]), size, size))
    first = 0
    for block in blocks:
        last = first + block.shape[-1]
        result[:, first:last, first:last] = block
        first = last
    return result


def _numbers(values: FloatArray) -> str:
    """Numbers, four digits each, and zero for what is rounding."""
    least = ROUNDED * np.abs(values[np.isfinite(values)]).max(initial=0.0)
    return "(" + ", ".join(f"{0.0 if abs(value) <= least else value:.4g}" for value in values) + ")"
