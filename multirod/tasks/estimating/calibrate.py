"""The parameters of a robot that measured shapes share. Numbers in parentheses: ``docs/estimation.md``."""

from collections.abc import Callable, Mapping, Sequence
from copy import copy
from dataclasses import dataclass, replace
from math import prod
from typing import Any, Generic, Self, cast

import numpy as np
from numpy.typing import NDArray

from multirod.assembly import Assembly, Robot, Robot_co
from multirod.inputs import Inputs
from multirod.problem import BoundaryProblem
from multirod.profile import Profile
from multirod.results.solution import Solution, SolveError
from multirod.rod import Rod, Section
from multirod.rotations import left_jacobian, matrices
from multirod.running.simulation import as_solver, solve
from multirod.solver import Solver
from multirod.stability import Stability
from multirod.status import Status
from multirod.tasks.estimating.estimate import HALVINGS, SEEN, SETTLED, SLACK, TOLERANCE, block_diagonal
from multirod.tasks.estimating.inference import Posterior, kept, posterior, roots, units
from multirod.tasks.estimating.priors import Prior
from multirod.tasks.formulation import Evaluation
from multirod.tasks.measuring.curvature import AlongEvaluation, AlongTask, Places
from multirod.tasks.measuring.sensors import Measured, Sensor, batch_of, checked, refuse_nothing
from multirod.types import Numbers
from multirod.validation import Described, FloatArray, choice, device_name, frozen, instance, meant, positive_int, refuse, shown

STIFFNESSES = ("bending_stiffness", "torsional_stiffness")
PARAMETERS = (*STIFFNESSES, "precurvature", "base")


class Calibration(Generic[Robot_co]):
    """A robot fitted to measured shapes, and how sure its numbers are.

    ==============================================  ==============================================================================
    parameter                                       its numbers
    ==============================================  ==============================================================================
    ``bending_stiffness``, ``torsional_stiffness``  of each rod, over what it was: all its sections and axes alike
    ``precurvature``                                of each rod, each section that is curved at rest: three components [1/m]
    ``base``                                        how far it is moved [m], then turned about itself [rad], in the world
    ==============================================  ==============================================================================

    Attributes:
        robot: The fitted one, as it was where the fit failed.
        solution: Its equilibria at the inputs.
        parameters: Names, in their order.
        labels: What each number is, of all parameters one after another.
        status: Why it ended: ``CONVERGED``, or why it failed.
        iterations: Steps taken.
        integrations: Of each shape.
        missing: Whether numbers of each sensor were missing of each shape, shape (..., sensor_count).
        misfit: (1) Sum of squares of what all is off, in standard deviations; where these are right, ``degrees`` on average.
        degrees: Numbers measured, less those that are unknown without a prior.
    """

    def __init__(self, numbers: "_Numbers", fit: "_Fit") -> None:
        self.robot = cast(Robot_co, fit.robot)
        self.solution: Solution[Robot_co] = fit.solution
        self.parameters = tuple(numbers.places)
        self.labels = numbers.labels
        self.status = fit.status
        self.iterations, self.integrations = fit.iterations, fit.integrations
        self.missing: NDArray[np.bool_] = frozen(fit.missing)
        self.misfit, self.degrees = float(fit.square), fit.degrees
        self._places, self._prior = numbers.places, numbers.prior
        lost = np.nan if self.failed else 1.0
        self._values, self._covariance = lost * numbers.values(fit.p), lost * numbers.covariance(fit.p, fit.covariance)

    @property
    def failed(self) -> bool:
        """Whether there is no result."""
        return self.status.failed

    def value(self, name: str) -> FloatArray:
        """The numbers of a parameter, shape (k,): of stiffnesses over what they were."""
        return np.asarray(frozen(self._values[self._place(name)]))

    def covariance(self, name: str | None = None) -> FloatArray:
        """(6) Theirs, shape (k, k); without a name, of all; infinite, and NaN beside, where nothing determines a number."""
        place = slice(None) if name is None else self._place(name)
        return np.asarray(frozen(self._covariance[place, place]))

    def sigma(self, name: str) -> FloatArray:
        """Standard deviations, shape (k,)."""
        return np.asarray(frozen(np.sqrt(np.diagonal(self.covariance(name)))))

    @property
    def observable(self) -> dict[str, NDArray[np.bool_]]:
        """Whether the measurements say more of each number than its prior does, (k,) by name."""
        part = kept(self._covariance, self._prior)
        return {name: np.asarray(frozen(part[place] <= SEEN)) for name, place in self._places.items()}

    def raise_if_failed(self) -> Self:
        """Return ``self`` if there is a result.

        Raises:
            SolveError: Otherwise.
        """
        if self.failed:
            raise SolveError(f"calibrate(): {self.status.name} after {self.iterations} iterations: {self.status.message}")
        return self

    def _place(self, name: str) -> slice:
        return self._places[choice("name", name, self._places)]

    def __repr__(self) -> str:
        if self.failed:
            return f"Calibration({self.status.name}: {self.status.message})"
        seen = np.concatenate([self.observable[name] for name in self.parameters])
        sigma = np.sqrt(np.diagonal(self._covariance))
        width = max(map(len, self.labels))
        lines = [
            f"  {label:<{width}}{value:>12.6g} +- {spread:.2g}{'' if own else '  (unobservable)'}"
            for label, value, spread, own in zip(self.labels, self._values, sigma, seen, strict=True)
        ]
        head = f"Calibration({self.status.name}, misfit {self.misfit:.4g} of {self.degrees})"
        return "\n".join([head, *lines])


def calibrate(
    robot: Robot,
    inputs: Inputs | None = None,
    *,
    parameters: str | Sequence[str] | Mapping[str, Prior],
    measured: Sensor | Sequence[Sensor],
    solver: Solver | None = None,
    guess: Solution | Numbers | None = None,
    max_iterations: int = 30,
    device: str = "cpu",
) -> Calibration[Robot]:
    """Fit parameters of a robot to measured shapes, which share them (``docs/estimation.md``).

    An iteration is one integration of each shape.

    Args:
        robot: The assembly, as it is known before: where the fit begins, and the mean of what is known.
        inputs: Of each shape, made by ``robot.inputs(...)``: their leading axes count the shapes.
        parameters: One of ``bending_stiffness``, ``torsional_stiffness``, ``precurvature``, ``base`` or several (``Calibration``
            says what their numbers are), or with a ``Prior`` for each: its mean is what the robot has, and of stiffnesses its
            ``sigma`` is relative.
        measured: ``Pose``, ``Curvature``, or several, each with ``sigma``; leading axes as those of ``inputs``.
        solver: That finds the equilibria of the robot as it is; its integrator and tolerance are used.
        guess: Where these begin.
        max_iterations: Steps allowed.
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
    most = positive_int("max_iterations", max_iterations)
    numbers = _Numbers(robot, _checked(robot, parameters))
    shape = np.broadcast_shapes(given.batch_shape, batch_of(sensors))
    places = Places(robot, given, sensors)
    rows = Measured(sensors, places, shape, None)
    refuse_nothing("measured", rows.known)
    flat = int(np.isinf(np.diagonal(numbers.prior)).sum())
    if flat > rows.known.sum():
        refuse(
            "parameters",
            Described(f"{flat} numbers without a prior"),
            f"must be at most as many as are measured, {rows.known.sum()}: the others are unobservable; give them priors, or "
            "measure more shapes",
        )
    whole = given.broadcast_to(shape)
    begin = solve(robot, whole, solver=method, guess=guess, device=device, progress=False)
    begin.raise_if_failed()
    fit = _Fit(robot, whole, numbers, rows, method, begin, device)
    fit.degrees = int(rows.known.sum()) - flat
    fit.run(most)
    return Calibration(numbers, fit)


def _checked(robot: Assembly, parameters: object) -> dict[str, Prior]:
    """Priors by the names of parameters."""
    names = (parameters,) if isinstance(parameters, str) else parameters
    if not isinstance(names, (list, tuple, Mapping)) or not names:
        raise TypeError(f"parameters = {shown(parameters)} is not allowed: must be one of {', '.join(PARAMETERS)}, or several")
    for name in names:
        if not isinstance(name, str) or name not in PARAMETERS:
            hint = meant(name, PARAMETERS) if isinstance(name, str) else ""
            raise TypeError(f"calibrate(parameters=...) takes no {shown(name)}: it takes {', '.join(PARAMETERS)}{hint}")
        if name == "base" and getattr(robot, "base", np.zeros(0)).shape != (4, 4):
            raise NotImplementedError(f"calibrate() by base is for robots that have one: {type(robot).__name__} has not")
        if name not in robot.parameters:
            raise NotImplementedError(f"{type(robot).__name__} does not give derivatives by {name}")
    if not isinstance(names, Mapping):
        return {name: Prior() for name in names}
    for name, prior in names.items():
        instance(f"parameters[{name!r}]", prior, Prior, "a Prior")
        if prior.mean is not None:
            refuse(f"parameters[{name!r}].mean", prior.mean.tolist(), "must not be given: it is what the robot has")
        if prior.batch_shape:
            refuse(f"parameters[{name!r}]", Described(f"leading axes {prior.batch_shape}"), "must have none: all shapes share it")
    return dict(names)


@dataclass(frozen=True)
class _Group:
    """Numbers of one parameter: the rod, section and component of each, or none."""

    name: str
    places: tuple[tuple[int, int, int], ...]
    labels: tuple[str, ...]


class _Numbers:
    """The numbers that are fitted, ``p = 0`` at first, and the robots that go with them."""

    def __init__(self, robot: Assembly, priors: Mapping[str, Prior]) -> None:
        self.begin = robot
        groups = {name: _group(robot, name) for name in priors}
        self.labels = tuple(label for group in groups.values() for label in group.labels)
        self.groups = groups
        self.places: dict[str, slice] = {}
        first = 0
        for name, group in groups.items():
            self.places[name] = slice(first, first + len(group.labels))
            first += len(group.labels)
        self.count = first
        own = [priors[name].variances(name, len(group.labels), (), None) for name, group in groups.items()]
        self.prior = block_diagonal(own)[0]

    def values(self, p: FloatArray) -> FloatArray:
        """What is told of the numbers, shape (k,)."""
        result = np.array(p)
        for name, group in self.groups.items():
            own = self.places[name]
            if name in STIFFNESSES:
                result[own] = np.exp(p[own])
            elif name == "precurvature":
                result[own] += [_precurvature(self.begin.rods[i].sections[j])[k] for i, j, k in group.places]
        return result

    def covariance(self, p: FloatArray, covariance: FloatArray) -> FloatArray:
        """Of what is told."""
        unit = np.ones(len(p))
        for name, own in self.places.items():
            if name in STIFFNESSES:
                unit[own] = np.exp(p[own])
        return np.asarray(covariance * unit[:, None] * unit)

    def robot(self, p: FloatArray) -> Assembly:
        """The robot with these numbers, shape (k,)."""
        rods = [copy(rod) for rod in self.begin.rods]
        for name, group in self.groups.items():
            if name == "base":
                continue
            for (i, j, k), number in zip(group.places, p[self.places[name]], strict=True):
                rods[i].sections = tuple(
                    section if j not in (-1, at) else CHANGES[name](section, k, float(number))
                    for at, section in enumerate(rods[i].sections)
                )
        result = self.begin.with_rods(rods) if set(self.groups) - {"base"} else self.begin
        if "base" in self.groups:
            moved = p[self.places["base"]]
            base = np.array(self.begin.base)  # type: ignore[attr-defined]
            base[:3, 3] += moved[:3]
            base[:3, :3] = matrices(moved[None, 3:])[0] @ base[:3, :3]
            result = result.with_base(base)
        return result

    def columns(self, robot: Assembly, p: FloatArray) -> FloatArray:
        """(13) How the columns that a robot gives, all parameters one after another, vary with the numbers, shape (column, k)."""
        result = []
        for name, group in self.groups.items():
            own = np.zeros((robot.column_count(name), len(group.labels)))
            if name == "base":
                # turned already, it turns on as the rotation vector's change has it
                own[:3, :3], own[3:, 3:] = np.eye(3), left_jacobian(p[self.places[name]][None, 3:])[0]
            else:
                size = COMPONENTS[name]
                sections = own.shape[0] // (size * robot.rod_count)
                table = own.reshape(robot.rod_count, sections, size, -1)
                for at, (i, j, k) in enumerate(group.places):
                    if name == "precurvature":
                        table[i, j, k, at] = 1.0
                        continue
                    for section, values in enumerate(robot.rods[i].sections):  # by its logarithm
                        stiffness = np.asarray(getattr(values, name)).reshape(-1)
                        table[i, section, :, at] = np.where(np.isfinite(stiffness), stiffness, 0.0)
            result.append(own)
        full = np.zeros((sum(len(own) for own in result), self.count))
        row = column = 0
        for own in result:
            full[row : row + own.shape[0], column : column + own.shape[1]] = own
            row, column = row + own.shape[0], column + own.shape[1]
        return full


BASE = (*(f"moved along {axis} [m]" for axis in "xyz"), *(f"turned about {axis} [rad]" for axis in "xyz"))
COMPONENTS = {"bending_stiffness": 2, "torsional_stiffness": 1, "precurvature": 3}


def _scaled(name: str) -> Callable[[Section, int, float], Section]:
    return lambda section, _, number: replace(section, **{name: getattr(section, name) * np.exp(number)})


def _bent(section: Section, component: int, number: float) -> Section:
    changed = np.array(_precurvature(section))
    changed[component] += number
    return replace(section, precurvature=changed)


CHANGES = {
    "bending_stiffness": _scaled("bending_stiffness"),
    "torsional_stiffness": _scaled("torsional_stiffness"),
    "precurvature": _bent,
}


def _precurvature(section: Section) -> FloatArray:
    if isinstance(section.precurvature, Profile):
        raise NotImplementedError("calibrate() by precurvature that is a function of arclength: cut the rod into sections")
    return section.precurvature


def _group(robot: Assembly, name: str) -> _Group:
    """Which numbers a parameter of a robot has."""
    if name == "base":
        return _Group(name, ((-1, -1, -1),) * 6, tuple(f"base: {said}" for said in BASE))
    called = [rod.name or f"rod {i + 1}" for i, rod in enumerate(robot.rods)]
    if name in STIFFNESSES:
        rods = [i for i, rod in enumerate(robot.rods) if _finite(rod, name)]
        if not rods:
            refuse("parameters", name, "must not be fitted: no rod has one that is finite")
        return _Group(name, tuple((i, -1, 0) for i in rods), tuple(f"{called[i]}: {name}, over what it was" for i in rods))
    curved = [(i, j) for i, rod in enumerate(robot.rods) for j, s in enumerate(rod.sections) if np.any(_precurvature(s))]
    curved = curved or [(i, j) for i, rod in enumerate(robot.rods) for j in range(len(rod.sections))]
    places = tuple((i, j, k) for i, j in curved for k in range(3))
    return _Group(name, places, tuple(f"{called[i]}: precurvature {'xyz'[k]}, section {j + 1} [1/m]" for i, j, k in places))


def _finite(rod: Rod, name: str) -> bool:
    return any(np.isfinite(getattr(section, name)).all() for section in rod.sections)


class _Shapes(AlongTask):
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


class _Fit:
    """Gauss-Newton steps in the parameters, the unknowns of every shape eliminated."""

    def __init__(
        self,
        robot: Assembly,
        inputs: Inputs,
        numbers: _Numbers,
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
            names = tuple(self.numbers.places)
            options = {"pose_sensitivities": True, **robot.input_directions(*names)}
            problem = robot.problem(self.inputs, integrator=self.solver.integrator, device=self.device, **options)
        except ValueError:  # such as a stiffness beyond all numbers
            return None
        found = _Shapes(problem, names, self.measured.places).evaluate(x)
        self.integrations += 1
        columns = self.numbers.columns(robot, p)
        changed: dict[str, Any] = {"slopes": found.slopes @ columns, "pose_by_free": found.pose_by_free @ columns}
        if isinstance(found, AlongEvaluation):
            own, n = found.curvature_columns, x.shape[1]
            changed["curvature_columns"] = np.concatenate([own[..., :n], own[..., n:] @ columns], axis=-1)
        found = replace(found, **changed)
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
