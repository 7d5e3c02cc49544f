"""Inputs behind measurements, one sample at a time, by one integration each. Numbers in parentheses: ``docs/estimation.md``."""

from collections.abc import Mapping, Sequence
from math import prod
from threading import Lock
from typing import Any, Generic

import numpy as np

from multirod.assembly import Robot_co
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
from multirod.tasks.estimate import Estimate, Known, Part, at_means, block_diagonal, places_of
from multirod.tasks.formulation import freed, options
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
        integrator: Integrator | None = None,
        guess: Solution | Numbers | None = None,
        device: str = "cpu",
    ) -> None:
        step = positive_float("Estimator.dt", dt)
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
        self._filter = _Filter(known, Live(parts, places, whole), walked, block_diagonal(begin))
        self._filter.present = self._present
        self._robot, self._places = robot, places_of(given, names)
        self._whole = whole
        self._lock = Lock()
        self._tracker = _Tracker(robot, self._filter, step, given, device)

    @property
    def robot(self) -> Robot_co:
        """The robot."""
        return self._robot

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
            mean, covariance, free = known.mean, known.covariance, known.free
            failed = solution.failed.reshape(-1)
            if failed.any():
                mean, covariance = np.where(failed[:, None], np.nan, mean), np.where(failed[:, None, None], np.nan, covariance)
            return Estimate(
                solution,
                self._places,
                mean.reshape((*shape, -1)),
                covariance.reshape((*shape, *covariance.shape[1:])),
                free.reshape((*shape, *free.shape[1:])),
                known.live.missing.reshape((*shape, -1)),
                known.square.reshape(shape),
                known.live.known.sum(axis=1).reshape(shape),
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
        unknowns: Of the boundary problem, shape (b, n); None before the first sample.
    """

    def __init__(self, known: Known, live: Live, walked: FloatArray, start: FloatArray) -> None:
        self.known, self.live, self.walked = known, live, walked
        self.names = tuple(known.priors)
        self.integrator = known.solver.integrator
        self.pose_sensitivities = True
        self.present: Any = None
        self.free = start
        self.unknowns: FloatArray | None = None
        count = prod(known.batch_shape)
        self.mean, self.covariance, self.square = np.zeros(start.shape[:2]), start, np.zeros(count)

    def _solve(self, problem: BoundaryProblem, guess: FloatArray | None) -> Outcome:
        return Shooting(integrator=self.integrator).solve(problem, guess)

    def track(self, problem: BoundaryProblem, dt: float) -> "_FilterTrack":
        return _FilterTrack(self, problem)


class _FilterTrack(Track):
    """The filter on the buffers of one problem."""

    def __init__(self, known: _Filter, problem: BoundaryProblem) -> None:
        self.known, self.problem = known, problem
        self.task = known.live.task(problem, known.names)

    def step(self) -> Outcome:
        """(10) to (12): one integration at what is expected, and the step that the measurements ask for."""
        known = self.known
        if known.unknowns is None:
            return self._begin(known)
        found = self.task.evaluate(known.unknowns, known.mean)
        r, J = known.live.now(found)
        towards, by = found.eliminated
        outcome = Outcome.zeros(len(r))
        outcome.status[:] = Status.TRACKING
        outcome.iterations[:] = outcome.integrations[:] = 1
        if not (np.isfinite(towards).all() and np.isfinite(J).all()):
            lost = ~(np.isfinite(towards).all(axis=1) & np.isfinite(J).all(axis=(1, 2)))
            outcome.status[lost] = np.where(found.failed[lost], Status.NONFINITE, Status.SINGULAR_JACOBIAN)
            for values in (r, J, towards, by):
                values[lost] = 0.0
        before = known.covariance + known.walked
        told = before @ np.swapaxes(J, 1, 2)
        sides = np.concatenate([np.swapaxes(told, 1, 2), r[..., None]], axis=2)
        solved = np.linalg.solve(np.eye(r.shape[1]) + J @ told, sides)
        moved = told @ solved
        after, step = before - moved[..., :-1], -moved[..., -1]
        known.free = known.free + known.walked
        known.covariance = 0.5 * (after + np.swapaxes(after, 1, 2))
        known.square = (r * solved[..., -1]).sum(axis=1)
        known.mean = known.mean + step
        known.unknowns = known.unknowns + towards + (by @ step[..., None])[..., 0]
        self.task.write(known.unknowns, known.mean)
        return outcome

    def _begin(self, known: _Filter) -> Outcome:
        """The first sample, estimated by itself; the next is the first again where it fails."""
        scene = known.known
        given = at_means(scene.robot, known.present(), scene.priors, scene.batch_shape)
        now = Known(scene.robot, given, *(getattr(scene, name) for name in list(scene.__dataclass_fields__)[2:]))
        part = Part(now, slice(0, len(known.mean)), None, known.live)
        part.run()
        outcome = part.outcome
        known.mean, known.covariance, known.square = part.p, part.covariance, part.square
        if not failures(outcome.status).any():
            known.unknowns = part.x
        self.task.evaluate(np.nan_to_num(part.x), part.p)
        return Outcome(outcome.status, outcome.iterations, outcome.integrations + 1)


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
