"""Inputs behind measurements, one sample at a time, by one integration each. Numbers in parentheses: ``docs/estimation.md``."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from math import copysign, isfinite
from threading import Lock
from typing import Any, Generic

import numpy as np
from numpy.typing import NDArray

from multirod import plausibility
from multirod.assembly import Robot_co
from multirod.batch import solved_each
from multirod.exclusive import Uncopied
from multirod.inputs import Inputs
from multirod.integrators import RK45, Integrator
from multirod.problem import BoundaryProblem
from multirod.running.tracker import Tracker
from multirod.solution import Solution
from multirod.solver import Outcome, Solver, Track
from multirod.solvers.shooting import Shooting
from multirod.status import Status, failures
from multirod.tasks.curvature import Places
from multirod.tasks.estimate import Estimate, Known, Part, at_means, block_diagonal, remarked
from multirod.tasks.formulation import freed, options, places_of
from multirod.tasks.priors import Prior, Walk
from multirod.tasks.sensors import Live, Sensor, batch_of, checked
from multirod.types import Numbers
from multirod.validation import Described, FloatArray, instance, positive_float, refuse


class Estimator(Uncopied, Generic[Robot_co]):
    """Inputs behind measurements in a control loop: one sample a call, by one integration.

    What is unknown walks at random between samples (``docs/estimation.md``). One thread steps it at a time.

    Args:
        robot: The assembly.
        dt: Time between samples [s].
        unknown: What is to be estimated: inputs by name, each with its ``Walk``.
        sensors: What is measured at each sample: ``Pose``, ``Curvature``, or several, each with ``sigma``; what was
            measured in them is not used.
        inputs: What is known of the others at the start; their batch axes are kept.
        gate: What part of sound measurements is let through, from 0.5 to below 1, such as 0.999: what a sensor says that is
            farther from what was expected than that is an outlier, and left out (``rejected``). None lets everything through.
        integrator: Of the spatial equations; ``RK4(50)`` takes the same time at each sample.
        guess: Where the first sample begins, as for ``estimate``.
        device: Warp device.

    Raises:
        TypeError: If an unknown is no input of the robot, or has no ``Walk``, or a sensor is none.
        ValueError: If an argument is not what it must be.
    """

    instead = "make another Estimator"

    def __init__(
        self,
        robot: Robot_co,
        *,
        dt: float,
        unknown: Mapping[str, Walk],
        sensors: Sensor | Sequence[Sensor],
        inputs: Inputs | None = None,
        gate: float | None = None,
        integrator: Integrator | None = None,
        guess: Solution | Numbers | None = None,
        device: str = "cpu",
    ) -> None:
        step = positive_float("Estimator.dt", dt)
        plausibility.of_dt("Estimator.dt", step, "an estimator")
        passed = None if gate is None else positive_float("Estimator.gate", gate)
        if passed is not None and not 0.5 <= passed < 1:
            refuse("Estimator.gate", gate, "must be the part of sound measurements that passes, from 0.5 to below 1, or None")
        walks = _walks(robot, unknown)
        names, starts = tuple(walks), {name: walk.start for name, walk in walks.items()}
        given, parts = robot.accept(inputs), checked("sensors", sensors)
        whole = np.broadcast_shapes(given.batch_shape, robot.batch_shape, batch_of(parts))
        given = at_means(robot, given, starts, whole)
        sizes = [getattr(given, name).shape[-1] for name in names]
        rates = [walks[name].rates(name, size, whole) for name, size in zip(names, sizes, strict=True)]
        walked = np.concatenate(rates, axis=1)[:, None, :] * np.eye(sum(sizes)) * step
        begin = [starts[name].variances(name, size, whole, None) for name, size in zip(names, sizes, strict=True)]
        method = RK45() if integrator is None else integrator
        places = Places(robot, given, parts)
        known = Known(robot, given, starts, parts, places, whole, Shooting(integrator=method), device, FIRST, guess)
        self._filter = _Filter(known, Live(parts, places, whole), walked, block_diagonal(begin), passed)
        self._filter.present = self._present
        self._robot, self._places = robot, places_of(given, names)
        self._whole, self._dt = whole, step
        self._lock = Lock()
        self._tracker = _Tracker(robot, self._filter, step, given, device)

    @property
    def robot(self) -> Robot_co:
        """The robot."""
        return self._robot

    def __repr__(self) -> str:
        known = self._filter.known
        walks = ", ".join(f"{name} walks" for name in known.priors)
        batch = [f"batch {self._whole}"] * bool(self._whole)
        return f"Estimator({', '.join([repr(self._robot), walks, *map(repr, known.sensors), f'dt {self._dt:g} s', *batch])})"

    def _present(self) -> Inputs:
        return self._tracker.present()

    def step(self, measured: Sequence[Any], **changes: Any) -> Estimate[Robot_co]:
        """Take in what the sensors say now.

        Args:
            measured: What each sensor says, in their order: of a pose ``(position, rotation)``, or what it has of these. None or
                NaN where it dropped out: the sample goes on without it, and ``missing`` says so.
            **changes: Inputs by name that have changed, as for ``Tracker.step``; what is not named keeps its value.

        Returns:
            The estimate, ``TRACKING``; ``solution`` has the unknowns that go with it, and the tip's pose that was expected before
            these measurements. The first sample is estimated by itself, as ``estimate`` does.

        Raises:
            TypeError: If a name is not an input of the robot, or is estimated.
            ValueError: If a value is out of range, or a measurement not what its sensor says.
            RuntimeError: If another thread is in ``step``.
        """
        for name in changes:
            if name in self._places:
                raise TypeError(f"Estimator.step() takes no {name!r}: it is estimated")
        if not self._lock.acquire(False):
            raise RuntimeError("this Estimator is in use on another thread: make an Estimator for each thread")
        try:
            known = self._filter
            known.live.put(measured)
            solution = self._tracker.step(**changes)
            shape = self._whole
            mean, covariance, square = known.mean, known.covariance, known.square
            if not known.sound:
                kept = known.begun
                mean, covariance = np.where(kept[:, None], mean, np.nan), np.where(kept[:, None, None], covariance, np.nan)
                square = np.where(kept, square, np.nan)
            if not shape:
                solution._remarks = remarked(self._places, covariance[0], known.live)
            return Estimate(
                solution,
                self._places,
                mean.reshape((*shape, -1)),
                covariance.reshape((*shape, *covariance.shape[1:])),
                known.free.reshape((*shape, *covariance.shape[1:])),
                known.live.missing.reshape((*shape, -1)),
                square.reshape(shape),
                known.counted.reshape(shape),
                () if shape else known.live.dropped() + known.outliers(),
                known.rejected.reshape((*shape, -1)),
            )
        finally:
            self._lock.release()


FIRST = 30  # iterations of the first sample


class _Tracker(Tracker[Robot_co]):
    """A tracker whose solver frees inputs."""

    def __init__(self, robot: Robot_co, solver: "_Filter", dt: float, inputs: Inputs, device: str) -> None:
        self._options = options(robot, solver.names)
        super().__init__(robot, solver=solver, dt=dt, inputs=inputs, device=device)

    def present(self) -> Inputs:
        """The inputs, from within a step."""
        return self._present()


class _Filter(Solver):
    """The solver that a tracker steps; what it knows outlives the problem, which is made anew where another load comes in.

    Attributes:
        mean: Of the unknowns, shape (b, k).
        covariance: Theirs, shape (b, k, k).
        free: What it would be had nothing been measured, shape (b, k, k).
        walked: What a sample adds, shape (b, k, k).
        square: Of what was measured and not expected, in its standard deviations, shape (b,).
        unknowns: Of the boundary problem, shape (b, n).
        begun: Which instances go on from their last sample; the others are estimated by themselves, shape (b,).
        sound: Whether all do.
        sign: Of ``det Gamma`` where each began, shape (b,).
        rejected: Whether what each sensor says now was left out as an outlier, shape (b, sensor_count).
        counted: Rows that were not, and are not missing, shape (b,).
    """

    def __init__(self, known: Known, live: Live, walked: FloatArray, start: FloatArray, gate: float | None) -> None:
        self.known, self.live, self.walked, self.start = known, live, walked, start
        self.names = tuple(known.priors)
        self.integrator = known.solver.integrator
        self.pose_sensitivities = True
        self.present: Any = None
        count, size = start.shape[:2]
        self.free, self.covariance = np.array(start), np.array(start)
        self.mean, self.square, self.sign = np.zeros((count, size)), np.zeros(count), np.zeros(count)
        self.unknowns = np.zeros((count, 0))
        self.begun, self.sound = np.zeros(count, dtype=bool), False
        self.identity, self.once = np.eye(size), np.ones(count, dtype=np.int32)
        self.tracking = self.once * np.int32(Status.TRACKING)
        from scipy.linalg.lapack import dgesv

        self._solve_one = dgesv
        self._none_rejected = np.zeros(live.missing.shape, dtype=bool)
        self._most = None if gate is None else _largest_squares(live.known.shape[1], gate)
        self.let_through()

    def let_through(self) -> None:
        """All that is measured, until it is looked at."""
        self.rejected, self.counted = self._none_rejected, self.live.counted

    def solved(self, matrices: FloatArray, sides: FloatArray) -> FloatArray:
        """``matrices^-1 sides``, shape (b, n, k), NaN where singular: of one instance by LAPACK itself, sooner."""
        if len(matrices) > 1:
            return solved_each(matrices, sides)
        _, _, result, failed = self._solve_one(matrices[0], sides[0])
        return np.full(sides.shape, np.nan) if failed else np.asarray(result)[None]

    def passed(self, told: FloatArray, before: FloatArray) -> FloatArray:
        """(15) The rows (b, m, 1 + k) that are let through, zeros in the place of outliers; ``before`` is (10)."""
        if self._most is None:
            return told
        live = self.live
        kept, rejected = live.known.copy(), np.zeros_like(self._none_rejected)
        for j, rows in enumerate(live.slices):
            r, J = told[:, rows, :1], told[:, rows, 1:]
            spread = np.eye(J.shape[1]) + J @ before @ np.swapaxes(J, 1, 2)
            square = (np.swapaxes(r, 1, 2) @ self.solved(spread, r))[:, 0, 0]
            rejected[:, j] = square > self._most[live.known[:, rows].sum(axis=1)]
            kept[:, rows] &= ~rejected[:, j, None]
        if not rejected.any():
            return told
        self.rejected, self.counted = rejected, kept.sum(axis=1)
        return np.where(kept[..., None], told, 0.0)

    def outliers(self) -> tuple[str, ...]:
        """What of the first instance was left out, in words."""
        if self.rejected is self._none_rejected:
            return ()
        return tuple(f"sensor {k}, an outlier" for k in np.flatnonzero(self.rejected[0]))

    def _solve(self, problem: BoundaryProblem, guess: FloatArray | None) -> Outcome:
        return Shooting(integrator=self.integrator).solve(problem, guess)

    def track(self, problem: BoundaryProblem, dt: float) -> "_FilterTrack":
        return _FilterTrack(self, problem)


class _FilterTrack(Track):
    """The filter on the buffers of one problem."""

    def __init__(self, known: _Filter, problem: BoundaryProblem) -> None:
        self.known, self.problem = known, problem
        self.task = known.live.task(problem, known.names)
        if not known.unknowns.shape[1]:
            known.unknowns = np.zeros((len(known.begun), problem.unknown_count))

    def step(self) -> Outcome:
        """What has begun goes on; what has not, or was lost, is estimated by itself."""
        known = self.known
        fresh = ~known.begun
        known.let_through()
        outcome = self._go_on() if known.sound or known.begun.any() else Outcome.zeros(len(fresh))
        if not known.sound:
            self._begin(np.flatnonzero(fresh), outcome)
            known.sound = bool(known.begun.all())
        return outcome

    def _go_on(self) -> Outcome:
        """(10) to (12), (15): one integration at what is expected, and the step that the measurements ask for."""
        known = self.known
        found = self.task.evaluate(known.unknowns, known.mean)
        outcome = Outcome(known.tracking.copy(), known.once.copy(), known.once.copy())
        known.free = known.free + known.walked
        before = known.covariance + known.walked
        shift = known.solved(found.gamma, np.concatenate([-found.residual[..., None], -found.slopes], axis=2))
        told = known.passed(known.live.now(found, shift), before)
        square = before @ (np.swapaxes(told[..., 1:], 1, 2) @ told)
        solved = known.solved(known.identity + square[..., 1:], np.concatenate([square[..., :1], before], axis=2))
        step, after = -solved[..., 0], solved[..., 1:]
        unknowns = known.unknowns + shift[..., 0] + (shift[..., 1:] @ step[..., None])[..., 0]
        r, J = told[..., 0], told[..., 1:]
        known.square = (r[:, None] @ (r[..., None] + J @ step[..., None]))[:, 0, 0]
        sign = _signs(found.gamma)
        if not (isfinite(unknowns.sum()) and (sign == known.sign).all()):
            kept = np.isfinite(unknowns).all(axis=1) & (sign == known.sign)
            self._lose(~kept, found.failed, sign, outcome)
            step, after = np.where(kept[:, None], step, 0.0), np.where(kept[:, None, None], after, before)
            unknowns = np.where(kept[:, None], unknowns, known.unknowns)
        known.mean, known.unknowns = known.mean + step, unknowns
        known.covariance = 0.5 * (after + np.swapaxes(after, 1, 2))
        self.task.write(known.unknowns, known.mean)
        return outcome

    def _lose(self, lost: NDArray[np.bool_], failed: NDArray[np.bool_], sign: FloatArray, outcome: Outcome) -> None:
        """Say why some instances have no estimate: past a fold the sign of ``det Gamma`` is no more that of the start."""
        known = self.known
        reasons = np.where(sign == 0, Status.SINGULAR_JACOBIAN, Status.UNSTABLE)
        reasons = np.where(failed | ~np.isfinite(sign) | (sign == known.sign), Status.NONFINITE, reasons)
        outcome.status[lost] = reasons[lost]
        known.begun, known.sound = known.begun & ~lost, False

    def _begin(self, chosen: NDArray[np.intp], outcome: Outcome) -> None:
        """The first sample of some instances, estimated by itself; the next is the first again where it fails."""
        if not len(chosen):
            return
        known, scene = self.known, self.known.known
        every = len(chosen) == len(known.begun)
        now = replace(scene, inputs=at_means(scene.robot, known.present(), scene.priors, scene.batch_shape))
        measured = known.live if every else known.live.take(chosen)
        part = Part(now, slice(None) if every else chosen, None if every else chosen, measured)
        part.run()
        ended = part.outcome
        known.mean[chosen], known.covariance[chosen], known.square[chosen] = part.p, part.covariance, part.square
        known.unknowns[chosen], known.free[chosen] = part.x, known.start[chosen]
        if known.rejected.any():
            known.rejected[chosen], known.counted[chosen] = False, known.live.counted[chosen]
        known.begun[chosen] = ~failures(ended.status)
        self.task.evaluate(known.unknowns, known.mean, np.isin(np.arange(len(known.begun)), chosen))
        gamma = self.problem.read("gamma")[chosen].reshape(len(chosen), *2 * (part.x.shape[1],))
        known.sign[chosen] = _signs(gamma)
        outcome.status[chosen], outcome.iterations[chosen] = ended.status, ended.iterations
        outcome.integrations[chosen] = ended.integrations + 1


def _largest_squares(count: int, gate: float) -> FloatArray:
    """(15) What the squares of 0 to ``count`` rows are at most, by the chi-square distribution; of none, anything."""
    from scipy.special import gammaincinv

    return np.concatenate([[np.inf], 2 * gammaincinv(0.5 * np.arange(1, count + 1), gate)])


def _signs(gamma: FloatArray) -> FloatArray:
    """Of the determinant of each matrix, shape (b,)."""
    if gamma.shape != (1, 3, 3):
        with np.errstate(invalid="ignore"):
            return np.asarray(np.linalg.slogdet(gamma)[0])
    (a, b, c), (d, e, f), (g, h, i) = gamma[0].tolist()  # of one rod's: by LAPACK as long as an integration's half
    determinant = a * (e * i - f * h) - b * (d * i - f * g) + c * (d * h - e * g)
    return np.array([copysign(1.0, determinant) if determinant else 0.0])


def _walks(robot: Any, unknown: object) -> dict[str, Walk]:
    """Checked walks by the names of inputs."""
    if not isinstance(unknown, Mapping):
        raise TypeError(f"unknown = {unknown!r} is not allowed: must be walks by name, such as {{'tip_force': Walk(0.3)}}")
    for name in freed("unknown", robot, tuple(unknown)):
        instance(f"unknown[{name!r}]", unknown[name], Walk, "a Walk")
        start: Prior = unknown[name].start
        if start.covariance is None and np.isinf(start.sigma).any():
            refuse(f"unknown[{name!r}].start", Described("a prior without sigma"), "must say how sure the first sample is")
    return dict(unknown)
