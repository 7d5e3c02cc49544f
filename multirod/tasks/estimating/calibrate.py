"""The parameters of a robot that measured shapes share. Numbers in parentheses: ``docs/estimation.md``."""

import os
from collections.abc import Mapping, Sequence
from typing import Any, Generic, Self

import numpy as np
from numpy.typing import NDArray

from multirod.assembly import Assembly, Robot, Robot_co
from multirod.batch import Undecided
from multirod.by_name import parts_of
from multirod.inputs import Inputs
from multirod.naming import meant, names_checked
from multirod.results.solution import Solution, SolveError
from multirod.running.simulation import as_solver, solve
from multirod.solver import Solver
from multirod.status import Status
from multirod.tasks.estimating.estimate import SEEN, estimate, inconsistent
from multirod.tasks.estimating.fit import Fit
from multirod.tasks.estimating.fitted import ALONE, Fitted, fitted, mixed
from multirod.tasks.estimating.inference import consistent, kept, principal
from multirod.tasks.estimating.loads import Loads
from multirod.tasks.estimating.of_solution import OfSolution
from multirod.tasks.estimating.parameters import PARAMETERS, SCALED, Key, Parameters
from multirod.tasks.estimating.priors import Prior
from multirod.tasks.estimating.unknown import unknown_of
from multirod.tasks.freed import every_label, places_of
from multirod.tasks.measuring.along import Places
from multirod.tasks.measuring.sensors import Measured, Sensor, batch_of, checked, refuse_nothing
from multirod.types import Numbers
from multirod.validation import Described, FloatArray, device_name, frozen, instance, positive_int, refuse, shown, some_names


class Calibration(OfSolution, Undecided, Generic[Robot_co]):
    """A robot fitted to measured shapes, and how sure its numbers are.

    ==============================================  ==============================================================================
    parameter                                       its numbers
    ==============================================  ==============================================================================
    ``bending_stiffness``, ``torsional_stiffness``  of each rod, over what it was: all its sections and axes alike
    ``foundation``, ``magnetisation``               likewise, of each rod that has one
    ``precurvature``                                of each rod, each section that is curved at rest: three components [1/m]
    ``base``                                        how far it is moved [m], then turned about itself [rad], in the world
    a tuple of all but ``base``                     one factor that all of these share, of all rods, over what they were
    ==============================================  ==============================================================================

    Attributes:
        unknown: Names of these.
        parameters: Names, or tuples of those that share a factor, in their order.
        labels: What each number is, of all parameters one after another.
        status: Why it ended: ``CONVERGED``, or why it failed.
        iterations: Steps taken.
        integrations: Of each shape.
        missing: Whether numbers of each sensor were missing of each shape, shape (..., sensor_count).
        misfit: (1) Sum of squares of what all is off, in standard deviations; where these are right, ``degrees`` on average.
        degrees: Numbers measured, less those that are unknown without a prior.
    """

    def __init__(self, solution: Solution[Robot_co], found: Fitted) -> None:
        self._solution = solution  # as it was where the fit failed
        self._found = found
        self.parameters, self.unknown = tuple(found.places), found.unknown
        self.labels, self.status = found.labels, found.status
        self.iterations, self.integrations = found.iterations, found.integrations
        self.missing: NDArray[np.bool_] = frozen(found.missing)
        self.misfit, self.degrees = found.misfit, found.degrees

    @property
    def robot(self) -> Robot_co:
        """The fitted one.

        Raises:
            SolveError: If there is none.
        """
        return self.solution.assembly

    @property
    def solution(self) -> Solution[Robot_co]:
        """Its equilibria at the inputs, those that were found among them.

        Raises:
            SolveError: If there is none.
        """
        return self.raise_if_failed()._solution

    @property
    def failed(self) -> bool:
        """Whether there is no result."""
        return self.status.failed

    @property
    def consistent(self) -> bool:
        """(18) Whether ``misfit`` is no more than 99.9 % of sound measurements leave where the model is right."""
        return bool(consistent(self.misfit, self.degrees))

    def value(self, name: Key) -> FloatArray:
        """The numbers of a parameter, shape (k,): of stiffnesses over what they were; of an input that was found, of each shape,
        (..., k)."""
        if name in self.unknown:
            return np.asarray(frozen((np.nan if self.failed else 1.0) * getattr(self._solution.inputs, str(name))))
        return np.asarray(frozen(self._found.values[self._place(name)]))

    def covariance(self, name: Key | None = None) -> FloatArray:
        """(6) Theirs, shape (k, k), or (..., k, k); without a name, of all parameters; infinite, and NaN beside, where nothing
        determines a number."""
        if name in self.unknown:
            own = self._found.load_covariance[(slice(None), *[places_of(self._solution.inputs, self.unknown)[str(name)]] * 2)]
            return np.asarray(frozen(own.reshape(*self._solution.batch_shape, *own.shape[1:])))
        place = slice(None) if name is None else self._place(name)
        return np.asarray(frozen(self._found.covariance[place, place]))

    def sigma(self, name: Key) -> FloatArray:
        """Standard deviations, shape (k,) or (..., k)."""
        return np.asarray(frozen(np.sqrt(np.diagonal(self.covariance(name), axis1=-2, axis2=-1))))

    def directions(self, name: Key | None = None) -> tuple[FloatArray, FloatArray]:
        """(9) Directions of a parameter's numbers, what part of the prior's variance is kept along each, the least seen first.

        Without a name, of all numbers that have a prior, counted in its deviations: which mixtures it alone tells of.

        Returns:
            Unit columns, shape (k, k), and parts, shape (k,). NaN without a prior; without a name the rows of ``labels``, 0 where
            there is none, and as many columns as there are priors.
        """
        found, place = self._found, slice(None) if name is None else self._place(name)
        covariance, prior = found.covariance[place, place], found.prior[place, place]
        if name is not None:
            axes, part = principal(covariance, prior)
            return np.asarray(frozen(axes)), np.asarray(frozen(part))
        known = np.flatnonzero(np.isfinite(np.diagonal(prior)))
        sigma, own = np.sqrt(np.diagonal(prior)[known]), np.ix_(known, known)
        inner, part = principal(covariance[own] / sigma / sigma[:, None], prior[own] / sigma / sigma[:, None])
        axes = np.zeros((len(prior), len(known)))
        axes[known] = inner
        return np.asarray(frozen(axes)), np.asarray(frozen(part))

    @property
    def observable(self) -> dict[Key, NDArray[np.bool_]]:
        """Whether the measurements say more of each number than its prior does, (k,) by name; of inputs whether they, with all
        that is known, determine it, (..., k)."""
        part = kept(self._found.covariance, self._found.prior)
        result = {
            name: np.asarray(frozen((part[place] <= SEEN) & (not self.failed))) for name, place in self._found.places.items()
        }
        for name in self.unknown:
            result[name] = np.asarray(frozen(np.isfinite(self.sigma(name))))
        return result

    def raise_if_failed(self) -> Self:
        """Return ``self`` if there is a result.

        Raises:
            SolveError: Otherwise.
        """
        if self.failed:
            raise SolveError(f"calibrate(): {self.status.name} after {self.iterations} iterations: {self._why}")
        return self

    @property
    def _why(self) -> str:
        """Why it failed, for people."""
        found = self._found
        if found.odd is not None:
            return self._without
        if self.status is Status.STALLED and found.hardly_seen:
            return found.unseen
        if self.status is Status.MAX_ITERATIONS:
            return "it has not come to an end: give max_iterations=, or a Prior for what may hardly be seen"
        return self.status.message

    @property
    def _without(self) -> str:
        """Without which shapes the others fit, where that is known."""
        odd = self._found.odd
        if odd is None:
            return ""
        some = f"shape{'s' * (len(odd.shapes) > 1)} {', '.join(map(str, odd.shapes))}"
        return (
            f"without {some} the others fit, misfit {odd.misfit:.4g} of {odd.degrees}: what is left out may rest on another "
            "branch than the robot as it was; make its numbers NaN, then fit all from what that finds"
        )

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write all of it to a file that ends in ``.npz``, which ``mr.load`` reads (``docs/files.md``).

        Raises:
            ValueError: If the ending is another, or the robot is of a class of another package.
        """
        from multirod.files.saving import save_calibration

        save_calibration(path, self)

    def _unseen(self, count: int) -> list[str]:
        """What is said of each number that the measurements say no more of than its prior: first those of parameters."""
        known = np.isfinite(np.diagonal(self._found.prior))
        return ["known by its prior alone" if own else "unobservable" for own in known] + ["unobservable"] * (count - len(known))

    def _mixtures(self) -> list[str]:
        """Mixtures of numbers of which the prior alone tells, where it does not of any one of these."""
        axes, part = self.directions()
        return [
            f"of a mixture the prior alone tells, {part[k]:.0%} of its variance is kept: {mixed(self.labels, axes[:, k])}"
            for k in np.flatnonzero(part > SEEN).tolist()
            if np.abs(axes[:, k]).max() < ALONE
        ]

    def _place(self, name: Key) -> slice:
        if name not in self._found.places:
            refuse("name", name, f"must be one of {', '.join(map(repr, self._found.places))}")
        return self._found.places[name]

    def __repr__(self) -> str:
        if self.failed:
            return f"Calibration({self.status.name}: {self._why})"
        labels, names, rest = list(self.labels), list(self.parameters), []
        if self._solution.batch_shape:
            rest = [f"  and {', '.join(self.unknown)} of each shape"] if self.unknown else []
        else:
            names += self.unknown
            labels += every_label(self.unknown, [len(self.value(name)) for name in self.unknown])
        told = [np.concatenate([own(name) for name in names]) for own in (self.value, self.sigma, self.observable.__getitem__)]
        width = max(map(len, labels))
        lines = [
            f"  {label:<{width}}{value:>12.6g} +- {spread:.2g}{'' if own else f'  ({why})'}"
            for label, value, spread, own, why in zip(labels, *told, self._unseen(len(labels)), strict=True)
        ] + rest
        lines += [f"  {told}" for told in (*self._mixtures(), *([self._found.unseen] if self._found.hardly_seen else []))]
        head = f"Calibration({self.status.name}, misfit {self.misfit:.4g} of {self.degrees})"
        doubt = (
            []
            if self.consistent
            else [f"  {inconsistent(self.misfit, self.degrees)}", *([f"  {self._without}"] * bool(self._without))]
        )
        return "\n".join([head, *lines, *doubt])


@names_checked
def calibrate(
    robot: Robot,
    inputs: Inputs | None = None,
    *,
    parameters: str | Sequence[Key] | Mapping[Key, Prior],
    measured: Sensor | Sequence[Sensor],
    unknown: str | Sequence[str] = (),
    solver: Solver | None = None,
    guess: Solution | Numbers | None = None,
    max_iterations: int = 30,
    device: str = "cpu",
) -> Calibration[Robot]:
    """Fit parameters of a robot to measured shapes, which share them, and loads of each shape (``docs/estimation.md``).

    An iteration is one integration of each shape. A fit that is not consistent is made again, (26).

    Args:
        robot: The assembly, as it is known before: where the fit begins, and the mean of what is known.
        inputs: Of each shape, made by ``robot.inputs(...)``: their leading axes count the shapes.
        parameters: One of ``bending_stiffness``, ``torsional_stiffness``, ``foundation``, ``magnetisation``, ``precurvature``,
            ``base`` or several (``Calibration`` says what their numbers are), or with a ``Prior`` for each: its mean is what the
            robot has, and of the first four its ``sigma`` is relative. Those in a tuple share one factor, of all rods:
            ``[("bending_stiffness", "torsional_stiffness"), "precurvature"]`` fits a common modulus.
        measured: ``Pose``, ``Curvature``, ``ForceTorque``, ``Tension``, or several, each with ``sigma``; leading axes as those
            of ``inputs``.
        unknown: Names of inputs that nobody knows, such as ``tip_force``: of each shape they are found beside the parameters,
            from where ``inputs`` have them. None that the robot limits, as it does tensions; 2000 numbers in all.
        solver: That finds the equilibria of the robot as it is; its integrator and tolerance are used.
        guess: Where these begin.
        max_iterations: Steps allowed, of each fit.
        device: Warp device.

    Raises:
        TypeError: If a parameter is none of these, or a measurement none.
        ValueError: If an argument is not what it must be, nothing is measured, or more is unknown without a prior than measured.
        SolveError: If a shape of the robot as it is cannot be found.
        NotImplementedError: If derivatives by a parameter of such a robot are not known (``docs/derivatives.md``).
    """
    method = as_solver(robot, solver)
    device = device_name("device", device)
    if robot.batch_shape:
        refuse("robot", Described(f"leading axes {robot.batch_shape}"), "must be one robot, which all shapes share")
    given, sensors = robot.accept(inputs), checked("measured", measured)
    names = _unknown(robot, given, unknown)
    most = positive_int("max_iterations", max_iterations)
    numbers = Parameters(robot, _checked(robot, parameters))
    shape = np.broadcast_shapes(given.batch_shape, batch_of(sensors))
    whole = given.with_arrays(given.arrays | {name: getattr(given, name) for name in names}).broadcast_to(shape)
    loads = Loads(robot, whole, names, numbers.count)
    places = Places(robot, given, sensors)
    rows = Measured(sensors, places, shape, None)
    refuse_nothing("measured", rows.known)
    flat = int(np.isinf(np.diagonal(numbers.prior)).sum()) + loads.mean.size
    if flat > rows.known.sum():
        refuse(
            "parameters",
            Described(f"{flat} numbers without a prior"),
            f"must be at most as many as are measured, {rows.known.sum()}: the others are unobservable; give them priors, or "
            "measure more shapes",
        )
    start = whole
    if names and loads.count <= rows.known.sum(axis=1).min():
        # as they are of the robot as it is: from anywhere both at once would take long
        options: dict[str, Any] = {"solver": method, "guess": guess, "max_iterations": most, "device": device}
        alone = estimate(robot, whole, unknown={name: _of_all(robot, name) for name in names}, measured=sensors, **options)
        start, guess = loads.at(whole, alone), alone.solution
    begin = solve(robot, start, solver=method, guess=guess, device=device, progress=False)
    begin.raise_if_failed()
    fit = Fit(robot, whole, numbers, loads, rows, method, begin, device)
    fit.degrees = int(rows.known.sum()) - flat
    fit.run(most)
    return Calibration(fit.solution, fitted(numbers, fit))


def _unknown(robot: Assembly, inputs: Inputs, unknown: object) -> tuple[str, ...]:
    """Inputs that nobody knows, without priors: these would say how stiff rods are, the less stiff the smaller loads are."""
    if isinstance(unknown, Mapping):
        refuse("unknown", Described("priors by name"), f"must be names, {tuple(unknown)}: of these loads nothing is known")
    names = some_names("unknown", unknown)
    return tuple(unknown_of(robot, inputs, {name: _of_all(robot, name) for name in names}, Prior).names) if names else ()


def _of_all(robot: Assembly, name: str) -> Any:  # noqa: ANN401  (as ``unknown_of`` takes it)
    """That nothing is known of an input, whatever motors drive of it."""
    return {part: Prior() for part in parts_of(robot, name)} or Prior()


def _checked(robot: Assembly, parameters: object) -> dict[Key, Prior]:
    """Priors by parameters, or by tuples of those that share a factor."""
    keys = (parameters,) if isinstance(parameters, str) else parameters
    if not isinstance(keys, (list, tuple, Mapping)) or not keys:
        raise TypeError(f"parameters = {shown(parameters)} is not allowed: must be one of {', '.join(PARAMETERS)}, or several")
    names = [name for key in keys for name in (key if isinstance(key, tuple) else (key,))]
    for name in names:
        if not isinstance(name, str) or name not in PARAMETERS:
            hint = meant(name, PARAMETERS) if isinstance(name, str) else ""
            raise TypeError(f"calibrate(parameters=...) takes no {shown(name)}: it takes {', '.join(PARAMETERS)}{hint}")
        if name == "base" and getattr(robot, "base", np.zeros(0)).shape != (4, 4):
            raise NotImplementedError(f"calibrate() by base is for robots that have one: {type(robot).__name__} has not")
        if name not in robot.parameters:
            raise NotImplementedError(f"{type(robot).__name__} does not give derivatives by {name}")
    if len(set(names)) < len(names):
        refuse("parameters", names, "must name each once")
    for key in keys:
        if isinstance(key, tuple) and not set(key) <= set(SCALED):
            refuse("parameters", key, f"must be of {', '.join(SCALED)}, which may share a factor")
        if key == ():
            refuse("parameters", key, "must name parameters that share a factor")
    if not isinstance(keys, Mapping):
        return {key: Prior() for key in keys}
    for key, prior in keys.items():
        field = f"parameters[{key!r}]"
        instance(field, prior, Prior, "a Prior")
        if prior.mean is not None:
            refuse(f"{field}.mean", prior.mean.tolist(), "must not be given: it is what the robot has")
        if prior.batch_shape:
            refuse(field, Described(f"leading axes {prior.batch_shape}"), "must have none: all shapes share it")
    return dict(keys)
