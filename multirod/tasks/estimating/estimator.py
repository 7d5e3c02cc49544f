"""Inputs behind measurements, one sample at a time, by one integration each. Numbers in parentheses: ``docs/estimation.md``."""

from collections.abc import Mapping, Sequence
from threading import Lock
from typing import Generic, Unpack

import numpy as np

from multirod import plausibility
from multirod.assembly import Robot_co
from multirod.exclusive import Uncopied
from multirod.inputs import Inputs
from multirod.integrators import RK45, Integrator
from multirod.models.assemblies.inputs import KnownInputs
from multirod.naming import names_checked
from multirod.results.solution import Solution
from multirod.running.simulation import as_robot
from multirod.running.tracker import Tracker
from multirod.solvers.shooting import Shooting
from multirod.tasks.estimating.bounded import Bounds
from multirod.tasks.estimating.estimate import Estimate, remarked
from multirod.tasks.estimating.filtering import FIRST, FilterSolver
from multirod.tasks.estimating.iteration import Known
from multirod.tasks.estimating.priors import Walk
from multirod.tasks.estimating.unknown import unknown_of
from multirod.tasks.formulation import options
from multirod.tasks.freed import places_of, refuse_freed
from multirod.tasks.limits import known_rows
from multirod.tasks.measuring.along import Places
from multirod.tasks.measuring.sensors import Live, Sensor, batch_of, checked
from multirod.types import Numbers
from multirod.validation import array, device_name, instance, positive_float, refuse


class Estimator(Uncopied, Generic[Robot_co]):
    """Inputs behind measurements in a control loop: one sample a call, by one integration.

    What is unknown walks at random between samples (``docs/estimation.md``). A sample that leads far, or in which a line turns
    slack or taut, takes an integration more, or some. One thread steps it at a time.

    Args:
        robot: The assembly.
        dt: Time between samples [s].
        unknown: What is to be estimated: inputs by name, each with its ``Walk``, of a ``Network`` also by the
            names of rods, lines, bodies or joints, as for ``estimate``.
        sensors: What is measured at each sample: ``Pose``, ``Curvature``, ``ForceTorque``, ``Tension``, or several, each with
            ``sigma``; what was measured in them is not used.
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

    @names_checked
    def __init__(
        self,
        robot: Robot_co,
        *,
        dt: float,
        unknown: Mapping[str, Walk | Mapping[str, Walk]],
        sensors: Sensor | Sequence[Sensor],
        inputs: Inputs | None = None,
        gate: float | None = None,
        integrator: Integrator | None = None,
        guess: Solution | Numbers | None = None,
        device: str = "cpu",
    ) -> None:
        step, device = positive_float("Estimator.dt", dt), device_name("Estimator.device", device)
        plausibility.of_dt("Estimator.dt", step, "an estimator")
        passed = None if gate is None else positive_float("Estimator.gate", gate)
        if passed is not None and not 0.5 <= passed < 1:
            refuse("Estimator.gate", gate, "must be the part of sound measurements that passes, from 0.5 to below 1, or None")
        given, parts = as_robot(robot).accept(inputs), checked("sensors", sensors)
        walks = unknown_of(robot, given, unknown, Walk)
        names, starts = walks.names, walks.starts()
        whole = np.broadcast_shapes(given.batch_shape, robot.batch_shape, batch_of(parts))
        given, rates = starts.at_means(robot, given, whole), walks.rates(whole)
        walked = rates[:, None, :] * np.eye(rates.shape[1]) * step
        method = RK45() if integrator is None else integrator
        instance("Estimator.integrator", method, Integrator, "an Integrator, such as RK4(50)")
        if guess is not None and not isinstance(guess, Solution):
            array("Estimator.guess", guess)
        places = Places(robot, given, parts)
        known = Known(robot, given, starts, parts, places, whole, Shooting(integrator=method), device, FIRST, guess)
        self._bounds = Bounds(*known_rows(robot, None, names)[:2])
        live = Live(parts, places, whole, device)
        self._filter = FilterSolver(known, live, walked, starts.variances(whole, None), passed, self._bounds)
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
        walks = ", ".join(f"{own.said} walks" for own in known.unknown.entries)
        batch = [f"batch {self._whole}"] * bool(self._whole)
        return f"Estimator({', '.join([repr(self._robot), walks, *map(repr, known.sensors), f'dt {self._dt:g} s', *batch])})"

    def _present(self) -> Inputs:
        return self._tracker.present()

    def step(self, measured: Sequence[object], **changes: Unpack[KnownInputs]) -> Estimate[Robot_co]:
        """Take in what the sensors say now.

        Args:
            measured: What each sensor says, in their order: of a pose ``(position, rotation)``, or what it has of these. None or
                NaN where it dropped out: the sample goes on without it, and ``missing`` says so.
            **changes: Inputs by name that have changed, as for ``Tracker.step``; what is not named keeps its value.

        Returns:
            The estimate, ``TRACKING``, or ``UNSTABLE`` where it is known not to be stable; ``solution`` has the unknowns that go
            with it, and the tip's pose that was expected before these measurements. The first sample is estimated by itself, as
            ``estimate`` does.

        Raises:
            TypeError: If a name is not an input of the robot, or is estimated.
            ValueError: If a value is out of range, or a measurement not what its sensor says.
            RuntimeError: If another thread is in ``step``.
        """
        refuse_freed("Estimator.step()", self._filter.names, changes, "estimated")
        if not self._lock.acquire(False):
            raise RuntimeError("this Estimator is in use on another thread: make an Estimator for each thread")
        try:
            known = self._filter
            known.live.put(measured)
            solution = self._tracker.step(**changes)
            shape = self._whole
            mean, covariance, free, square = (own.copy() for own in (known.mean, known.covariance, known.free, known.square))
            if not known.sound:
                kept = known.begun != 0
                mean, covariance = np.where(kept[:, None], mean, np.nan), np.where(kept[:, None, None], covariance, np.nan)
                square = np.where(kept, square, np.nan)
            if not shape:
                solution._remarks = remarked(self._places, covariance[0], known.live)
            return Estimate(
                solution,
                self._places,
                mean.reshape((*shape, -1)),
                covariance.reshape((*shape, *covariance.shape[1:])),
                free.reshape((*shape, *covariance.shape[1:])),
                known.live.missing.reshape((*shape, -1)),
                square.reshape(shape),
                known.counted.reshape(shape),
                () if shape else known.live.dropped() + known.outliers(),
                known.rejected.reshape((*shape, -1)),
                bounds=self._bounds,
            )
        finally:
            self._lock.release()


class _Tracker(Tracker[Robot_co]):
    """A tracker whose solver frees inputs."""

    _called = "Estimator"

    def __init__(self, robot: Robot_co, solver: "FilterSolver", dt: float, inputs: Inputs, device: str) -> None:
        self._options = options(robot, solver.names)
        super().__init__(robot, solver=solver, dt=dt, inputs=inputs, device=device)

    def present(self) -> Inputs:
        """The inputs, from within a step."""
        return self._present()
