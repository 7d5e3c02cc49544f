"""Where an equilibrium loses stability as loads are raised."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any, Self

import numpy as np

from multirod.assembly import Assembly
from multirod.budget import SEARCHED, Budget, Spent
from multirod.inputs import Inputs
from multirod.integrators import RK45
from multirod.naming import names_checked
from multirod.profile import Profile
from multirod.results.solution import IncompleteWarning, Solution, SolveError
from multirod.running.simulation import solve, unknowns_of_guess
from multirod.solvers.continuation import Branch, BranchLost, Change, Point
from multirod.solvers.multiple_shooting import MultipleShooting
from multirod.solvers.segments import equations_of
from multirod.solvers.shooting import Shooting
from multirod.stability import Stability
from multirod.status import Status, failures
from multirod.studies.each import Instance, leading_axes, of_each
from multirod.types import Numbers
from multirod.validation import LARGEST, Described, FloatArray, device_name, frozen, number, positive_float, positive_int, refuse
from multirod.warning import warn

GROWTH = 0.1  # of steps as loads are raised, whose waves grow with their root; angles have a period

TRIED = 10  # points, the same to the last bit, after which nothing is raised
ROUNDED = 1e-6  # of an eigenvalue, what does not tell whether it falls
PRECISE, STEPS = 4e-11, 150  # residual over the length of the longest rod: 1e-10 1/m of 0.4 m; steps

NOT_STABLE = {  # why nothing can be said from a start that is not stable
    Stability.UNSTABLE: "there is no stability to lose",
    Stability.FOLD: "a mode is neutral there, or forces are not determined, as in a straight rod that does not stretch between "
    "two holders; give it an axial_stiffness or a slide, or begin where it is bent, start=",
    Stability.UNKNOWN: "whether it is stable is not known here, so nor is where that ends",
}


@dataclass(frozen=True)
class CriticalLoad:
    """A load factor at which the number of unstable modes changes.

    Attributes:
        load_factor: Of the inputs, beyond where they began.
        fold: Whether the load factor has a maximum or minimum there (a limit point: the robot snaps); else another branch of
            equilibria crosses (a bifurcation: it buckles).
        index_before: Unstable modes before it, along the branch.
        index_after: Unstable modes after it.
        mode: Null vector of ``Gamma``, unit length: how the unknowns begin to change, shape (n,). Of several neutral modes, one.
        solution: The equilibrium there.
    """

    load_factor: float
    fold: bool
    index_before: int
    index_after: int
    mode: FloatArray
    solution: Solution

    def __post_init__(self) -> None:
        object.__setattr__(self, "mode", frozen(self.mode))

    @property
    def multiplicity(self) -> int:
        """How many modes are neutral there."""
        return abs(self.index_after - self.index_before)

    def _repr_html_(self) -> str:
        from multirod.results import html

        return html.critical_loads([self])

    def __repr__(self) -> str:
        kind = "fold" if self.fold else "bifurcation"
        return f"CriticalLoad({self.load_factor:.9g}, {kind}, unstable modes {self.index_before} to {self.index_after})"


class CriticalLoads(tuple[CriticalLoad, ...]):
    """The critical loads that were found, in the order of the branch, and what was not.

    Attributes:
        reached: Largest load factor on the part of the branch that was searched.
        undecided: Ranges of load factors, from and to, at which a mode comes so near to neutral that two changes of stability
            in a row, that cancel, may be missing; empty where none is.
    """

    reached: float
    undecided: tuple[tuple[float, float], ...]

    def __new__(cls, found: Iterable[CriticalLoad], *, reached: float, undecided: tuple[tuple[float, float], ...]) -> Self:
        """As a tuple is made, with its attributes."""
        result = super().__new__(cls, found)
        result.reached, result.undecided = reached, undecided
        return result

    def _repr_html_(self) -> str:
        from multirod.results import html

        unsure = [f"from {low:.6g} to {high:.6g} changes may be missing" for low, high in self.undecided]
        return html.critical_loads(self, [f"searched up to load factor {self.reached:.6g}", *unsure])

    def __repr__(self) -> str:
        """The list, and how far it goes."""
        unsure = f", undecided {self.undecided}" if self.undecided else ""
        return f"CriticalLoads({list(self)}, reached {self.reached:.6g}{unsure})"


@names_checked
def critical_loads(
    robot: Assembly,
    inputs: Inputs,
    *,
    start: Inputs | None = None,
    guess: Solution | Numbers | None = None,
    count: int = 1,
    up_to: float = np.inf,
    max_steps: int = 500,
    solver: Shooting | None = None,
    device: str = "cpu",
) -> CriticalLoads | Any:  # noqa: ANN401  (``types`` says why)
    """The load factors at which the equilibrium on the natural branch, or on that of a ``guess``, loses stability.

    The inputs are raised from ``start`` in proportion, ``start + load_factor * (inputs - start)``, and the branch is followed
    from the stable equilibrium at ``start``, through folds and past bifurcations. Every step is cut in two until the eigenvalues
    at the ends of its parts tell what happens in between; where that cannot be told, the result and a warning say so. That is a
    strong check, but no proof. Equation numbers and the method: ``docs/stability.md``. The branch of each instance of a batch is
    followed by itself, and takes as long as alone.

    Args:
        robot: The assembly.
        inputs: Made by ``robot.inputs(...)``: what a load factor of 1 means.
        start: Inputs at load factor 0; by default ``inputs`` without loads (forces, gravity). Give it to raise something else,
            such as the rotation of a tube, or one load while another stays.
        guess: Of the equilibrium at ``start``, as for ``solve``: where there are several, such as of a rod that is bent closed;
            one for all instances of a batch, or one for each.
        count: How many changes of stability to look for, along the branch.
        up_to: Load factor where the search ends, with an empty list where nothing changes before.
        max_steps: Steps along the branch.
        solver: ``Shooting(tolerance=4e-11 / L, integrator=RK45(steps=150), max_integrations=50_000)`` by default, ``L`` the
            length of the longest rod: of it the tolerance and the integrator are used, the latter in double precision; to find
            the equilibrium at ``start``, all of it; and its ``max_integrations`` for all that is done of an instance until the
            last of them is found.
        device: Warp device.

    Returns:
        Those found, in the order of the branch: fewer than ``count`` if ``up_to`` comes first. It is a tuple that also says how
        far the branch was searched (``reached``) and where something may be missing (``undecided``). Of a batch, an array of
        such, dtype ``object``, with the leading axes of robot and inputs together: None stands where a ``SolveError`` would be,
        or nothing is raised.

    Warns:
        IncompleteWarning: If two changes of stability in a row, which cancel, may be missing, or all integrations allowed
            were used up, or the branch cannot be followed to as many as ``count``; the message says where. If nothing is found
            of some instances of a batch.

    Raises:
        SolveError: If there is no stable equilibrium at ``start``, or the branch cannot be followed to the first of them, of one
            instance.
        TypeError, ValueError: If an argument is not what it must be, or nothing is raised.
    """
    if not isinstance(robot, Assembly):
        raise TypeError(f"robot must be an assembly such as SingleRod(rod), not {type(robot).__name__}")
    if not (solver is None or isinstance(solver, Shooting)):
        raise TypeError(f"solver: critical_loads() needs Shooting(), not {type(solver).__name__}")
    positive_int("count", count), positive_int("max_steps", max_steps)
    if number("up_to", up_to) != np.inf:
        positive_float("up_to", up_to)
    device = device_name("device", device)
    inputs = robot.accept(inputs)
    begin = unloaded(robot, inputs) if start is None else robot.accept(start, "start")
    if begin.profiles:
        refuse("start", Described(f"functions of arclength for {', '.join(begin.profiles)}"), "give numbers")
    search = _Search(count, up_to, max_steps, solver, device)
    if not (robot.batch_shape or inputs.batch_shape or begin.batch_shape):
        try:
            return search.along(robot, inputs, begin, guess, "")
        except NothingRaised as error:
            why = str(error)
        refuse("inputs", inputs, why)

    def along_one(own: Instance) -> CriticalLoads:
        try:
            return search.along(own.of(robot), own.of(inputs), own.of(begin), own.guess(guess), own.said)
        except NothingRaised as error:
            raise SolveError(str(error)) from None

    return of_each("critical loads", leading_axes(robot, inputs, begin, guess), along_one)


@dataclass(frozen=True)
class _Search:
    """What is looked for along the branch of each instance, as ``critical_loads`` says."""

    count: int
    up_to: float
    max_steps: int
    solver: Shooting | None
    device: str

    def along(self, robot: Assembly, inputs: Inputs, begin: Inputs, guess: Solution | Numbers | None, said: str) -> CriticalLoads:
        """The critical loads of one instance, of which warnings say which it is."""
        usual = Shooting(tolerance=PRECISE / robot.longest, integrator=RK45(steps=STEPS), max_integrations=SEARCHED)
        method = (usual if self.solver is None else self.solver).in_double()
        budget = Budget(method.max_integrations)
        branch, first = natural_start(robot, begin, inputs, method, self.device, budget, guess)
        if first.modes.stability[0] != Stability.STABLE:
            stability = Stability(int(first.modes.stability[0]))
            raise SolveError(f"at the start the equilibrium is {stability.name}: {NOT_STABLE[stability]}")
        changes, undecided, reached = _changes(branch, first, self, said)
        if undecided:
            ranges = ", ".join(f"{low:.12g} to {high:.12g}" for low, high in undecided)
            warn(
                f"{said}at load factors {ranges} a mode is so near to neutral that stability may be lost and regained unseen",
                IncompleteWarning,
            )
        if budget.left < 0:
            warn(
                f"{said}the {method.max_integrations} integrations allowed were used up at a load factor of {reached:.6g}: give "
                "a solver with more max_integrations, or up_to",
                IncompleteWarning,
            )
        found = [_critical(robot, method, begin, inputs, branch, change, self.device) for change in changes]
        return CriticalLoads(found, reached=reached, undecided=undecided)


def _changes(
    branch: Branch, first: Point, search: _Search, said: str
) -> tuple[list[Change], tuple[tuple[float, float], ...], float]:
    """Changes along the branch, where some may be missing, and the largest load factor up to which that is all.

    Warns:
        IncompleteWarning: If the branch ends before all that were asked for.

    Raises:
        SolveError: If it ends before the first.
    """
    count, up_to = search.count, search.up_to
    found: list[Change] = []
    undecided: list[tuple[float, float]] = []
    reached = 0.0
    passed = [first]
    try:
        for step in branch.steps(first, search.max_steps):
            changes = step.changes[: count - len(found)]
            end = changes[-1].point if len(found) + len(changes) == count else step.after
            for part in step.undecided:
                loads = [branch.factor(point) for point in part]
                if step.along(part[0]) <= step.along(end) and min(loads) <= up_to:
                    undecided.append((min(loads), max(loads)))
            found += [change for change in changes if branch.factor(change.point) <= up_to]
            reached = max(reached, *(branch.factor(change.point) for change in changes), branch.factor(end))
            passed.append(step.after)
            if len(passed) == TRIED and _stays(branch, passed):
                raise SolveError(
                    f"nothing changes up to a load factor of {reached:.6g}: what is raised does not act on the robot, as a load "
                    "that what holds an end takes"
                )
            if end is not step.after or reached > up_to:
                return found, _joined(undecided), min(reached, up_to)
    except Spent:
        return found, _joined(undecided), min(reached, up_to)
    except BranchLost as lost:
        if found:
            warn(f"{said}{lost}; before that, {len(found)} of the {count} critical loads asked for were found", IncompleteWarning)
            return found, _joined(undecided), min(reached, up_to)
        hint = f"; no change of stability before that: give up_to={0.99 * reached:.3g} for a result" if reached else ""
        if _stiffens(branch, passed):
            hint += "; the loads only stiffen the robot there, as a pull does, so there may be no critical load at all"
        raise SolveError(f"{lost}{hint}") from None
    raise AssertionError("steps() ends by an error")


def _joined(ranges: Iterable[tuple[float, float]]) -> tuple[tuple[float, float], ...]:
    """Ranges that touch, as one."""
    result: list[tuple[float, float]] = []
    for low, high in sorted(ranges):
        if result and low <= result[-1][1]:
            before = result.pop()
            low, high = before[0], max(before[1], high)
        result.append((low, high))
    return tuple(result)


def _stays(branch: Branch, passed: Sequence[Point]) -> bool:
    """Whether neither the equilibrium nor its modes are others than at the first of the points that were passed."""
    first, *others = passed
    return all(
        np.array_equal(branch.unknowns(point), branch.unknowns(first))
        and np.array_equal(point.modes.values, first.modes.values, equal_nan=True)
        for point in others
    )


def _stiffens(branch: Branch, passed: Sequence[Point]) -> bool:
    """Whether no mode became softer on the last half of the way to the last of the points that were passed."""
    last = branch.factor(passed[-1])
    upper = [point for point in passed if branch.factor(point) >= 0.5 * last and point.modes.known[0]]
    values = [np.minimum(point.modes.values[0], LARGEST) for point in upper]  # infinite where there are fewer
    return len(values) > 2 and bool((np.diff(values, axis=0) >= -ROUNDED * np.abs(values[:-1])).all())


def _critical(
    robot: Assembly, method: Shooting, begin: Inputs, inputs: Inputs, branch: Branch, change: Change, device: str
) -> CriticalLoad:
    factor = branch.factor(change.point)
    solver = MultipleShooting(tolerance=method.tolerance, integrator=method.integrator) if branch.in_segments else method
    there = solve(
        robot, _between(robot, begin, inputs, factor), solver=solver, guess=branch.unknowns(change.point), device=device
    )
    return CriticalLoad(factor, change.fold, change.before, change.after, branch.mode(change.point), there)


class NothingRaised(ValueError):
    """Inputs are those at the start; what is missing."""


def natural_start(
    robot: Assembly,
    begin: Inputs,
    inputs: Inputs,
    method: Shooting,
    device: str,
    budget: Budget,
    guess: Solution | Numbers | None = None,
) -> tuple[Branch, Point]:
    """The branch of equilibria from ``begin`` towards ``inputs``, and its first point; both within the ``budget``.

    It is the natural branch, or that of a ``guess`` of the unknowns at ``begin``.

    Raises:
        SolveError: If there is no equilibrium at ``begin``.
        NothingRaised: If nothing changes on the way.
    """
    enabled = [name for name in begin.given if begin.is_active(name)]
    problem = robot.problem(inputs, integrator=method.integrator, device=device, direction_count=1, enabled=enabled)
    first, last = problem.pack(begin)[0], problem.pack(inputs)[0]
    if inputs.profiles:
        first[-1] = 0.0  # what multiplies functions of arclength
    if (first == last).all():
        raise NothingRaised(_nothing_raised(inputs))
    problem.write("inputs", first)
    outcome = within(method, budget).solve(problem, unknowns_of_guess(guess, problem, 1, slice(None)))
    if failures(outcome.status)[0]:
        raise SolveError(f"at the start: {Status(int(outcome.status[0])).message}")
    unknowns = problem.read("unknowns")[0]
    problem.write("inputs", last - first)
    scale = float(problem.load_scale()[0])
    unit = 1 / (scale or float(np.abs(last - first).max()))
    length = max(float(np.max(rod.length)) for rod in robot.rods)
    budget.left -= int(outcome.integrations[0])
    problem.budget = budget
    tolerance = float(problem.tolerance(method.tolerance)[0])
    try:
        equations = equations_of(problem, first, last - first, unknowns, tolerance=tolerance, integrator=method.integrator)
        branch = Branch(equations, length=length, unit=unit, tolerance=tolerance, growth=GROWTH if scale else 0.0)
        return branch, branch.first(unknowns)
    except Spent:
        raise SolveError(f"at the start: {Status.INTEGRATION_LIMIT.message}") from None


def within(method: Shooting, budget: Budget) -> Shooting:
    """The same method for one solve that takes no more than is left."""
    return replace(method, max_integrations=max(1, min(method.max_integrations, budget.left)))


def _nothing_raised(inputs: Inputs) -> str:
    """What is missing where inputs are those at the start."""
    moved = [name for name in inputs.given if inputs.is_active(name) and inputs.spec(name).load is None]
    what = "rotation" if "rotation" in moved or not moved else moved[0]
    rest = ", ".join(f"{name}=inputs.{name}" for name in inputs.given if name != what and inputs.is_active(name))
    return (
        "nothing is raised: they are those at the start, and without start= that is the same inputs without loads; to raise the "
        f"{what} from zero, give start=robot.inputs({rest})"
    )


def unloaded(robot: Assembly, inputs: Inputs) -> Inputs:
    """The same inputs without loads: forces, moments, gravity."""
    loads = {spec.name for spec in robot.input_specs if spec.load is not None}
    return robot.make_inputs({name: getattr(inputs, name) for name in inputs.given if name not in loads})


def _between(robot: Assembly, begin: Inputs, inputs: Inputs, factor: float) -> Inputs:
    """The inputs at a load factor."""
    names = {*begin.given, *inputs.given} - set(inputs.profiles)
    values = {name: getattr(begin, name) + factor * (getattr(inputs, name) - getattr(begin, name)) for name in names}
    profiles = {name: _raised(getattr(begin, name), profile, factor) for name, profile in inputs.profiles.items()}
    return robot.make_inputs(values | profiles)


def _raised(begin: FloatArray, profile: Profile, factor: float) -> Profile:
    """``begin + factor (profile - begin)``, of a load that is the same everywhere, (3,), to one along the arclength."""
    rest, coefficients = (1 - factor) * begin, factor * profile.coefficients
    coefficients[:, 0] += rest
    return Profile(profile.ends, coefficients, lambda s: rest + factor * np.asarray(profile.function(s)))
