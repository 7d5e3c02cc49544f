"""All equilibria of one robot at one set of inputs."""

from collections.abc import Iterator
from contextlib import suppress
from dataclasses import replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from multirod.assembly import Assembly, Robot, Robot_co
from multirod.batch import broadcast_shapes
from multirod.budget import SEARCHED, Budget, Spent
from multirod.inputs import Inputs
from multirod.naming import names_checked
from multirod.problem import BoundaryProblem
from multirod.results.solution import IncompleteWarning, Solution, SolveError
from multirod.running.simulation import solve
from multirod.solvers.continuation import Branch, FromBase
from multirod.solvers.shooting import SIDES, Shooting
from multirod.solvers.starting import MOST_STARTS, SAME_WITHIN, STARTS_IN_A_ROUND, Catalogue, converge, degrees, limits
from multirod.stability import Stability
from multirod.status import Status, failures
from multirod.studies.critical_loads import natural_start, unloaded, within
from multirod.studies.each import Instance, of_each
from multirod.validation import FloatArray, device_name, frozen, positive_int
from multirod.warning import warn

FOLLOWED = 32  # branches through equilibria that were found, where the signs tell of others
FOLLOWED_STEPS = 400  # of each
ROTATION_REACH = 2 * np.pi  # how far a rotation is turned along a branch; loads: to twice, and to none


class Equilibria(Solution[Robot_co]):
    """The equilibria of one robot at one set of inputs, the one of lowest potential energy first, shape (k,).

    Attributes:
        missing: How many are missing at least, by their ``index``: there is a stable one, and others come in pairs of
            neighbouring index (``docs/stability.md``, (8b)); without a potential by the signs of ``determinant`` alone, (8). 0 is
            no proof that none is. None where these rules say nothing: parallel robots, and where one of the equilibria has a
            neutral mode, which may be several in one place.
        continuum: Whether each stands for a closed curve of equilibria, such as a buckled column for all its turns about its
            axis, shape (k,). It is neutral along that (``Stability.FOLD``), and ``index`` counts its unstable modes across.
    """

    written = frozenset({"missing", "continuum"})
    missing: int | None
    continuum: NDArray[np.bool_]

    if TYPE_CHECKING:  # there is always an axis

        @cached_property
        def status(self) -> NDArray[np.int32]:
            """Values of ``Status``, shape (k,)."""

        @cached_property
        def index(self) -> NDArray[np.int32]:
            """Unstable modes of each equilibrium, shape (k,); -1 where it cannot be said."""

        @cached_property
        def stability(self) -> NDArray[np.int32]:
            """Values of ``Stability``, shape (k,)."""

    @classmethod
    def of(
        cls, found: Solution[Robot_co], degree: float | None, continuum: NDArray[np.bool_], unsolved: int = 0
    ) -> "Equilibria[Robot_co]":
        """Those of a solution, of which the signs must add up to ``degree``; so many closed curves are ``unsolved``."""
        result = cls.__new__(cls)
        result.__dict__.update(found.__dict__)
        result.continuum = frozen(continuum)
        alone = _signs(found) * ~continuum
        neutral = ~continuum & (found.stability == Stability.FOLD)
        # each that has a neutral mode counts for 1, 0 or -1
        gap = 0 if degree is None else int(abs(degree - alone[~neutral].sum()) - neutral.sum())
        missing = None if degree is None or (gap <= 0 and neutral.any()) else gap
        if degree == 1 and not unsolved and not neutral.any() and (found.index >= 0).all() and np.isfinite(found.potential).all():
            circles = found.index[continuum]
            missing = _absent(np.bincount(np.concatenate([found.index, circles + 1])))
        result.missing = missing
        return result

    def _repr_html_(self) -> str:
        from multirod.results import html

        return html.equilibria(self)

    @property
    def _without(self) -> str:
        circles = int(self.continuum.sum())
        whole = f"; {circles} stand{'s' * (circles == 1)} for a whole circle of them" if circles else ""
        return whole + (f"; {self.missing} missing at least" if self.missing else super()._without)


@names_checked
def equilibria(
    robot: Robot, inputs: Inputs | None = None, *, starts: int = MOST_STARTS, solver: Shooting | None = None, device: str = "cpu"
) -> Equilibria[Robot] | Any:  # noqa: ANN401  (``types`` says why)
    """All equilibria that Newton's method finds from many starts, the one of lowest potential energy first.

    Starts cover all base moments and torques that an equilibrium can have (for parallel robots, poses of the platform), in
    rounds, until a round brings nothing new and the signs of ``determinant`` add up as they must (``docs/stability.md``). Then
    branches that cross the natural one as loads are raised are followed, and where the signs still do not add up, branches from
    the equilibria that were found. That is no proof that none is missing; where some are known to be, ``missing`` and a warning
    say so. What is one of a closed curve of equilibria, such as a column that may buckle in any direction, is listed once;
    ``continuum`` says so. Mirror images, and turns by a part of a circle, are equilibria of their own.

    Each instance of a batch is searched by itself, and takes as long as alone.

    Args:
        robot: The assembly.
        inputs: Made by ``robot.inputs(...)``; none are all zero.
        starts: Starts at most, of each instance.
        solver: ``Shooting(max_integrations=50_000)`` by default, of which the tolerance, the iteration limit and the integrator,
            in double precision, are used, and its ``max_integrations`` for all of the search of an instance: one from each start
            is counted by itself.
        device: Warp device.

    Returns:
        The equilibria, shape (k,): each with ``stability``, ``index``, ``potential``, ``condition`` and all that a solution
        has, and all together ``missing``. Where loads have no potential (moments, follower loads), they are in the order of their
        elastic energy. Of a batch, an array of such, dtype ``object``, with the leading axes of robot and inputs: each has as
        many as there are, and None stands where none is found.

    Warns:
        IncompleteWarning: If some are known to be missing, by their index or because the integrator is too coarse to solve them,
            or the integrations that are allowed were used up; or if none is found of some instances of a batch.

    Raises:
        SolveError: If none is found, of one instance.
        TypeError, ValueError: If an argument is not what it must be.
    """
    if not isinstance(robot, Assembly):
        raise TypeError(f"robot must be an assembly such as SingleRod(rod), not {type(robot).__name__}")
    method = Shooting(max_integrations=SEARCHED) if solver is None else solver
    if not isinstance(method, Shooting):
        raise TypeError(f"solver: equilibria() needs Shooting(), not {type(method).__name__}")
    method = method.in_double()
    device = device_name("device", device)
    inputs = robot.accept(inputs)
    positive_int("starts", starts)
    if not (inputs.batch_shape or robot.batch_shape):
        return _searched(robot, inputs, starts, method, device, "")

    def search(own: Instance) -> Equilibria:
        return _searched(own.of(robot), own.of(inputs), starts, method, device, own.said)

    return of_each("equilibria", broadcast_shapes(robot.batch_shape, inputs.batch_shape), search)


def _searched(robot: Robot, inputs: Inputs, starts: int, method: Shooting, device: str, said: str) -> Equilibria[Robot]:
    """Those of one instance, of which warnings say which it is."""
    inputs = robot.accept(inputs)
    count = min(STARTS_IN_A_ROUND, starts)
    problem = robot.problem(_repeated(inputs, count), integrator=method.integrator, device=device)
    guesses = problem.starts
    if guesses is None:
        raise TypeError(f"{type(robot).__name__} offers no starts: its problem's starts are None")
    limit = limits(guesses.guesses(STARTS_IN_A_ROUND)[:, :1])
    newton = method.newton(problem)
    tolerance = float(problem.tolerance(method.tolerance)[0])
    alone = robot.problem(inputs, integrator=method.integrator, device=device)
    catalogue = Catalogue(float(degrees(problem)[0]) if guesses.signs_add_up else None, tolerance, alone)
    everyone = np.ones(count, dtype=bool)
    budget = Budget(method.max_integrations)
    problem.budget = alone.budget = budget
    with suppress(Spent):
        for first in range(0, starts, count):
            reached = converge(problem, newton, guesses.guesses(count, first)[:, 0], everyone, limit)
            _take(catalogue, problem, reached)
            catalogue.end_round()
            if catalogue.settled:
                break
        if alone.may_be_taut or catalogue.degree is None:
            _take_meant(catalogue, alone, method, budget)
        for chunk in _chunks(_connected(robot, inputs, method, device, budget), count):
            reached = converge(problem, newton, chunk, everyone, np.inf)
            _take(catalogue, problem, reached)
        if catalogue.missing:
            _search_on(catalogue, robot, inputs, method, device, budget)
    problem.budget = alone.budget = None
    if budget.left < 0:  # what had converged in the round that was cut off
        _take(catalogue, problem, newton.outcome().status == Status.CONVERGED, beside=False)
    if not catalogue.unknowns:
        more = "give the solver more max_integrations" if budget.left < 0 else "raise starts, or loosen the solver's tolerance"
        raise SolveError(f"no equilibrium was found from {starts} starts: {more}")
    result = _listed(catalogue, robot, inputs, method, device)
    if result.missing and not catalogue.missing and budget.left > 0:  # of which the signs do not tell
        with suppress(Spent):
            _search_on(catalogue, robot, inputs, method, device, budget, result.missing)
        result = _listed(catalogue, robot, inputs, method, device)
    if budget.left < 0:
        warn(
            f"{said}the {method.max_integrations} integrations allowed were used up before the search came to its end: give a "
            "solver with more max_integrations",
            IncompleteWarning,
        )
    if result.missing:
        warn(
            f"{said}{result.missing} equilibria are missing at least, by what is unstable of those found; raise starts, or give "
            "a solver with a tighter tolerance and integrator",
            IncompleteWarning,
        )
    if catalogue.unsolved:
        count = len(catalogue.unsolved)
        warn(
            f"{said}{count} closed curve{'s' * (count > 1)} of equilibria, such as all turns of a buckled rod about its axis, "
            "cannot be listed: the integrator's error is more than the tolerance there; give a tighter one, such as "
            "solver=Shooting(integrator=RK45(rtol=1e-11, atol=1e-13))",
            IncompleteWarning,
        )
    return result


def _listed(catalogue: Catalogue, robot: Robot, inputs: Inputs, method: Shooting, device: str) -> Equilibria[Robot]:
    """Those of a catalogue, told apart by their index too, the one of lowest energy first."""
    guess = np.array(catalogue.unknowns)
    found = solve(robot, _repeated(inputs, len(guess)), solver=method, guess=guess, device=device)
    chosen = np.array(_different(found))
    chosen = chosen[~failures(found.status[chosen])]  # rounding may keep what a branch came by from the tolerance
    if not len(chosen):
        raise SolveError("no equilibrium was found within the tolerance: loosen the solver's tolerance")
    found = found[chosen]
    energy = found.potential if np.isfinite(found.potential).all() else found.energy
    order = np.argsort(energy, kind="stable")
    circles = np.isin(chosen[order], list(catalogue.curves))
    return Equilibria.of(found[order], catalogue.degree, circles, len(catalogue.unsolved))


def _take(catalogue: Catalogue, problem: BoundaryProblem, reached: NDArray[np.bool_], *, beside: bool = True) -> None:
    """Add where Newton's method got to, and curves ``beside`` which it gave up."""
    unknowns, residual = problem.read("unknowns"), problem.read("residual")
    gamma = problem.read("gamma").reshape(len(unknowns), problem.unknown_count, -1)
    catalogue.add_all(unknowns[reached], gamma[reached])
    for k in np.flatnonzero(~reached & beside):
        catalogue.add_beside(unknowns[k], residual[k], gamma[k])


def _take_meant(catalogue: Catalogue, problem: BoundaryProblem, method: Shooting, budget: Budget) -> None:
    """Add what ``solve`` means, to both sides: starts hardly ever come to a rod that is pushed together by little, and seldom to
    closed loops far from where they are at rest, of which no signs tell that some are missing."""
    problem.budget = None
    for side in SIDES:
        outcome = within(replace(method, side=side), budget).solve(problem)
        budget.spend(int(outcome.integrations[0]))
        if not failures(outcome.status)[0] and not outcome.breakpoints:
            found, gamma = problem.read("unknowns")[0], problem.read("gamma").reshape(problem.unknown_count, -1)
            problem.budget = budget
            catalogue.add(found, gamma)
            problem.budget = None
    problem.budget = budget


def _absent(counts: NDArray[np.intp]) -> int:
    """(8b) How many equilibria are missing at least where so many are found of each index."""
    absent, alone = 0, 1  # the one that is in no pair
    for count in counts.tolist():
        alone = count - alone  # which pair with some of the next index
        absent += max(-alone, 0)
        alone = max(alone, 0)
    return absent + alone


def _signs(found: Solution) -> FloatArray:
    """Signs of ``det Gamma`` (k,): by the index where it is known, which is told by an integration over more nodes."""
    return np.asarray(np.where(found.index >= 0, (-1.0) ** found.index, np.sign(found.determinant)))


def _different(found: Solution) -> list[int]:
    """Numbers of those that are not found before, but for a wrong sign of ``determinant``."""
    result: list[int] = []
    for k, (x, index) in enumerate(zip(found.unknowns, found.index, strict=True)):
        near = SAME_WITHIN * max(1.0, float(np.abs(x).max()))
        if not any(index == found.index[j] and np.abs(x - found.unknowns[j]).max() <= near for j in result):
            result.append(k)
    return result


def _search_on(
    catalogue: Catalogue, robot: Assembly, inputs: Inputs, method: Shooting, device: str, budget: Budget, more: int = 0
) -> None:
    """Add the equilibrium that ``solve`` means, and what branches through those found come by as rotations and loads change: at
    least so many ``more``, and until the signs add up."""
    enough = len(catalogue.unknowns) + more
    problem = robot.problem(inputs, integrator=method.integrator, device=device, direction_count=1, enabled=("rotation",))
    unloaded_ = problem.pack(unloaded(robot, inputs))[0]
    here = problem.pack(inputs)[0]
    if inputs.profiles:
        unloaded_[-1] = 0.0  # what multiplies functions of arclength
    rates = [(here - unloaded_, 1.0)] if (here != unloaded_).any() else []
    place = problem.input_slice("rotation")
    # turned all together, tubes without loads stay as they are
    rates += [(np.eye(len(here))[k], ROTATION_REACH) for k in range(place.start + (not rates), place.stop)]
    outcome = within(method, budget).solve(problem)
    budget.spend(int(outcome.integrations[0]))
    problem.budget = budget
    if not failures(outcome.status)[0] and not outcome.breakpoints:
        catalogue.add(problem.read("unknowns")[0], problem.read("gamma").reshape(problem.unknown_count, -1))
    length = max(float(np.max(rod.length)) for rod in robot.rods)
    ways: list[tuple[Any, float, float]] = [(*rate, way) for rate in rates for way in (1.0, -1.0)]
    followed = 0
    for unknowns in catalogue.unknowns:  # which grow
        for rate, reach, way in ways:
            if followed == FOLLOWED:
                return
            followed += 1
            equations = FromBase(problem, here, rate)
            branch = Branch(equations, length=length, unit=1.0, tolerance=catalogue.tolerance, growth=0.0, inspected=False)
            for point in branch.returns(branch.first(unknowns, way), reach, FOLLOWED_STEPS):
                catalogue.add(branch.unknowns(point), point.gamma)
                if not catalogue.missing and len(catalogue.unknowns) >= enough:
                    return


def _connected(robot: Assembly, inputs: Inputs, method: Shooting, device: str, budget: Budget) -> list[FloatArray]:
    """Guesses on the natural branch and on those that cross it as loads are raised; none where no load acts."""
    begin = unloaded(robot, inputs)
    if not any(inputs.is_active(name) for name in set(inputs.given) - {n for n in begin.given if begin.is_active(n)}):
        return []
    try:
        branch, first = natural_start(robot, begin, inputs, method, device, budget)
    except SolveError:
        return []
    return branch.connected(first, 1.0) if first.modes.known[0] else []


def _chunks(guesses: list[FloatArray], count: int) -> Iterator[FloatArray]:
    """Guesses as arrays (count, n), the last ones repeated."""
    for first in range(0, len(guesses), count):
        some = guesses[first : first + count]
        yield np.array(some + [some[-1]] * (count - len(some)))


def _repeated(inputs: Inputs, count: int) -> Inputs:
    """The same inputs for ``count`` instances."""
    names = {"rotation", *inputs.arrays}
    values = {name: np.asarray(getattr(inputs, name)) for name in names}
    return inputs.with_arrays({name: np.broadcast_to(value, (count, value.shape[-1])) for name, value in values.items()})
