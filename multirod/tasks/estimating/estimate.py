"""The most probable inputs behind measurements, and how sure they are. Numbers in parentheses: ``docs/estimation.md``."""

import os
from collections.abc import Mapping, Sequence
from functools import cached_property
from math import prod
from threading import Event, Lock
from typing import Any, Generic, Self

import numpy as np
from numpy.typing import NDArray

from multirod.assembly import Assembly, Robot, Robot_co
from multirod.batch import Undecided, parts, run, thread_count
from multirod.inputs import Inputs
from multirod.naming import names_checked
from multirod.results.remarks import Remarks
from multirod.results.scene import Scene
from multirod.results.solution import Solution
from multirod.running.simulation import as_solver, solve
from multirod.solver import Outcome, Solver
from multirod.status import failures
from multirod.tasks.estimating.bounded import Bounds
from multirod.tasks.estimating.inference import consistent, kept, principal
from multirod.tasks.estimating.iteration import Known, Part
from multirod.tasks.estimating.of_solution import OfSolution
from multirod.tasks.estimating.priors import Prior
from multirod.tasks.estimating.unknown import Unknown, unknown_of
from multirod.tasks.freed import every_label, places_of, with_values
from multirod.tasks.limits import known_rows
from multirod.tasks.measuring.along import Places
from multirod.tasks.measuring.sensors import Measured, Sensor, batch_of, checked, refuse_nothing
from multirod.types import Numbers, StatusOrArray
from multirod.validation import Described, FloatArray, choice, device_name, frozen, positive_int, refuse

SEEN = 0.5  # of the prior's variance: where more is kept, the prior says more than the measurements
NOT_SHOWN = 1e-9  # of the largest of some numbers, what is not shown
FORCES = ("tip_force", "follower_force")  # whose covariance can be drawn


class Estimate(OfSolution, Undecided, Generic[Robot_co]):
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
    def consistent(self) -> NDArray[np.bool_]:
        """(18) Whether ``misfit`` is no more than 99.9 % of sound measurements leave where the model is right, shape (...)."""
        return np.asarray(frozen(consistent(self.misfit, self.degrees)))

    @cached_property
    def at_limit(self) -> NDArray[np.bool_]:
        """Which of the unknown numbers, in the order of ``unknown``, stand at a limit of the robot, such as a tension of 0, shape
        (..., k)."""
        return np.asarray(frozen(self._bounds.at_limit(self._mean)))

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write all of it to a file that ends in ``.npz``, which ``mr.load`` reads (``docs/files.md``).

        Raises:
            ValueError: If the ending is another, or the robot or the integrator is of a class of another package.
        """
        from multirod.files.saving import save_estimate

        save_estimate(path, self)

    def _place(self, name: str) -> slice:
        return self._places[choice("name", name, self._places)]

    def __repr__(self) -> str:
        if self.batch_shape:
            return f"Estimate({', '.join(self.unknown)}; batch {self.batch_shape}: {self.solution._counts(slice(None))})"
        if self.failed:
            return f"Estimate({self.status.name}: {self.status.message})"
        parts = [f"{name} {_numbers(self.value(name))} +- {_numbers(self.sigma(name))}" for name in self.unknown]
        parts += [f"unobservable: {said}" for name in self.unknown for said in [self._unseen(name)] if said]
        labels = every_label(self.unknown, [self.value(name).shape[-1] for name in self.unknown])
        held = [label for label, own in zip(labels, self.at_limit.tolist(), strict=True) if own]
        parts += [f"at a limit: {', '.join(held)}"] if held else []
        parts += [] if self.consistent else [inconsistent(float(self.misfit), int(self.degrees))]
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


@names_checked
def estimate(
    robot: Robot,
    inputs: Inputs | None = None,
    *,
    unknown: str | Sequence[str] | Mapping[str, Prior | Mapping[str, Prior]],
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
        unknown: What is to be estimated: inputs by name, each with its ``Prior``; also by the names of rods, lines,
            bodies or joints where inputs are taken so, ``{"force": {"plate": Prior(0, sigma=1)}}``; names alone are of
            what nothing is known of, as with ``Prior()``: it begins where ``inputs`` have it. ``rotation`` and
            ``translation`` of a network that says which rods are ``driven`` are theirs, unless others are named.
        measured: ``Pose``, ``Curvature``, ``ForceTorque``, ``Tension``, or several, each with ``sigma``. What is NaN is gone
            without, and ``missing`` says so.
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
    asked = unknown_of(robot, given, unknown, Prior)
    sensors = checked("measured", measured)
    most = positive_int("max_iterations", max_iterations)
    whole = _axes(robot, given, asked, sensors)
    places = Places(robot, given, sensors)
    rows = sum(sensor.count for sensor in sensors)
    if asked.flat():
        known = Measured(sensors, places, whole, None).known
        refuse_nothing("measured", known)
        rows = int(known.sum(axis=1).max())
    _refuse_more(asked.flat(), rows)
    scene = Known(robot, asked.at_means(robot, given, whole), asked, sensors, places, whole, method, device, most, guess)
    count = prod(whole)
    workers = thread_count(threads)
    if not count:
        return _empty(scene)
    pieces = parts(count, workers, robot.rod_count, device)
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


def inconsistent(misfit: float, degrees: int) -> str:
    """What to say of a misfit that is too large."""
    return f"inconsistent: the misfit is {misfit:.4g}, of {degrees} on average, so the model or a sigma is wrong"


def _empty(scene: Known) -> Estimate[Any]:
    """Of no instance."""
    places, shape = places_of(scene.inputs, scene.unknown.names), scene.batch_shape
    k, none = sum(place.stop - place.start for place in places.values()), np.zeros(shape)
    solution = solve(scene.robot, scene.inputs, solver=scene.solver, device=scene.device)
    square, missing = np.zeros((*shape, k, k)), np.zeros((*shape, len(scene.sensors)), dtype=bool)
    bounds = Bounds(*known_rows(scene.robot, None, scene.unknown.names)[:2])
    degrees = none.astype(np.int64)
    return Estimate(solution, places, np.zeros((*shape, k)), square, square, missing, none, degrees, (), bounds=bounds)


def _joined(scene: Known, pieces: Sequence[Part]) -> Estimate[Any]:
    """The estimate of all instances from its parts."""
    first, shape = pieces[0], scene.batch_shape

    def join(name: str) -> FloatArray:
        values = np.concatenate([getattr(part, name) for part in pieces])
        return np.asarray(values.reshape((*shape, *values.shape[1:])))

    outcome = Outcome.joined([Outcome(p.outcome.status, p.outcome.iterations, p.outcome.integrations) for p in pieces])
    records = np.concatenate([part.task.problem.snapshot() for part in pieces])
    places = places_of(scene.inputs, scene.unknown.names)
    failed = failures(outcome.status).reshape(shape)
    mean, covariance, misfit = (np.array(join(name)) for name in ("p", "covariance", "square"))
    for values in (mean, covariance, misfit):
        values[failed] = np.nan
    known = np.where(failed[..., None], join("mean"), mean)  # an input cannot be NaN
    inputs = with_values(scene.inputs, scene.unknown.names, known)
    results = Scene(scene.robot, shape, scene.solver.integrator, scene.device, first.task.problem.record_fields)
    solution: Solution[Any] = Solution(results, records, outcome, inputs)
    if not shape:
        solution._remarks = remarked(places, covariance, first.measured)
    prior = join("prior")
    degrees = np.concatenate([part.degrees for part in pieces]).reshape(shape)
    missing = np.concatenate([part.measured.missing for part in pieces])
    missing = missing.reshape((*shape, missing.shape[-1]))
    dropped = () if shape else first.measured.dropped()
    return Estimate(solution, places, mean, covariance, prior, missing, misfit, degrees, dropped, bounds=first.bounds)


def remarked(places: Mapping[str, slice], covariance: FloatArray, measured: Measured) -> Remarks:
    """What a recording shows of an estimate without leading axes, ``covariance`` (k, k)."""
    forces = {name: covariance[place, place] for name, place in places.items() if name in FORCES}
    return Remarks(measured=measured.position(), covariances=forces)


def _axes(robot: Assembly, inputs: Inputs, unknown: Unknown[Prior], sensors: Sequence[Sensor]) -> tuple[int, ...]:
    """Leading axes of all together."""
    shapes = {"inputs": inputs.batch_shape, "the robot": robot.batch_shape, "measured": batch_of(sensors)}
    shapes |= {f"the prior of {own.said}": own.known.batch_shape for own in unknown.entries}
    try:
        return np.broadcast_shapes(*shapes.values())
    except ValueError:
        said = ", ".join(f"{name} {shape}" for name, shape in shapes.items())
        raise ValueError(f"the leading axes do not broadcast: {said}") from None


def _refuse_more(flat: Mapping[str, int], rows: int) -> None:
    """Refuse more numbers without a prior than are measured."""
    if sum(flat.values()) > rows:
        names = ", ".join(f"{count} of {name}" for name, count in flat.items())
        refuse(
            "unknown",
            Described(f"{sum(flat.values())} numbers without a prior ({names})"),
            f"must be at most as many as are measured, {rows}: the others are unobservable; give them priors, or measure more",
        )


def _numbers(values: FloatArray) -> str:
    """Numbers, four digits each, and zero for what is rounding."""
    least = NOT_SHOWN * np.abs(values[np.isfinite(values)]).max(initial=0.0)
    return "(" + ", ".join(f"{0.0 if abs(value) <= least else value:.4g}" for value in values) + ")"
