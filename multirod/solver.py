"""What every solver has in common, and where third parties add theirs."""

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from copy import copy
from dataclasses import dataclass, field, replace
from typing import Any, ClassVar, Self

import numpy as np
from numpy.typing import NDArray

from multirod.exclusive import Uncopied
from multirod.integrators import RK45, Integrator
from multirod.problem import BoundaryProblem
from multirod.results.events import Events, placed_events, taken_events
from multirod.segments import Breakpoints, placed, taken
from multirod.status import CONVERGED, BoolArray, Status, failures, settled
from multirod.validation import FloatArray, positive_float, refuse
from multirod.warning import warn

IntArray = NDArray[np.int32]


@dataclass(frozen=True)
class Left:
    """Instances of parts of a batch that a solver left where they were, to go on with all of them at once (``Solver.finish``).

    Attributes:
        numbers: Which they are, of the part, then of the batch, shape (k,).
        records: Of their problem, shape (k, record size).
        known: What else the solver knows of them, by name, of each the first axis k.
    """

    numbers: NDArray[np.intp]
    records: FloatArray
    known: dict[str, NDArray[Any]]

    @classmethod
    def joined(cls, lefts: Sequence["Left"]) -> "Left":
        """Those of several parts, by their numbers in the batch."""
        numbers = np.concatenate([left.numbers for left in lefts])
        order = np.argsort(numbers)
        records = np.concatenate([left.records for left in lefts])
        known = {name: np.concatenate([left.known[name] for left in lefts])[order] for name in lefts[0].known}
        return cls(numbers[order], records[order], known)

    def take(self, rows: slice) -> "Left":
        """Some of them."""
        return Left(self.numbers[rows], self.records[rows], {name: values[rows] for name, values in self.known.items()})

    def behind(self, count: int) -> "Left":
        """These, behind so many instances in the batch."""
        return replace(self, numbers=self.numbers + count)


@dataclass
class Outcome:
    """How a solver left a problem, whose buffers hold the unknowns, residual and ``Gamma``; one entry an instance.

    Attributes:
        status: Values of ``Status``, shape (instance_count,).
        iterations: Iterations, shape (instance_count,).
        integrations: Initial value problems integrated, per rod, shape (instance_count,).
        residual: What the solver drove to zero, max norm [1/m], shape (instance_count,); that of the problem if None.
        reached: Part of the load, or of the way from the last sample, that continuation reached, shape (instance_count,).
        rates: Closed-loop rates of an observer [1/s], shape (instance_count, n).
        breakpoints: Of the instances that are known by their states there, as the unknowns alone do not lead to the tip.
        events: What happened on the way, of the instances whose branch ended.
        turning: Instances that rest where symmetry leaves modes neutral.
        left: Instances that ``finish`` is to go on with.
    """

    status: IntArray
    iterations: IntArray
    integrations: IntArray
    residual: FloatArray | None = None
    rates: FloatArray | None = None
    reached: FloatArray | None = None
    breakpoints: dict[int, Breakpoints] = field(default_factory=dict)
    events: Events = field(default_factory=dict)
    turning: set[int] = field(default_factory=set)
    left: Left | None = None

    @property
    def arrays(self) -> dict[str, NDArray[Any]]:
        """The fields that have one entry an instance, by name; without those that are None."""
        return {name: value for name, value in vars(self).items() if isinstance(value, np.ndarray)}

    @property
    def all_converged(self) -> bool:
        """Whether all instances did, as they mostly do."""
        return bool((self.status == CONVERGED).all())

    def left_of(self, integrations: int | IntArray) -> IntArray:
        """What each instance may still take of so many integrations, of all or of each, shape (instance_count,)."""
        return np.maximum(integrations - self.integrations, 0)

    def take(self, instances: NDArray[np.intp]) -> "Outcome":
        """The outcome of the instances with these numbers, shape (k,)."""
        arrays: dict[str, Any] = {name: value[instances] for name, value in self.arrays.items()}
        events = taken_events(self.events, instances)
        return Outcome(**arrays, breakpoints=taken(self.breakpoints, instances), events=events)

    def end_with(self, again: "Outcome", some: BoolArray) -> None:
        """Let some instances, bool (instance_count,), end as they did when they were run again; their counts add up."""
        for name, values in self.arrays.items():
            others = again.arrays[name]
            values[some] = values[some] + others[some] if name in ("iterations", "integrations") else others[some]

    @classmethod
    def zeros(cls, count: int) -> "Outcome":
        """An outcome of ``count`` instances that were not run."""
        status, iterations, integrations = np.zeros((3, count), dtype=np.int32)
        return cls(status, iterations, integrations)

    @classmethod
    def joined(cls, outcomes: Sequence["Outcome"]) -> "Outcome":
        """Outcomes of successive samples as one, samples first; what not all have is left out."""
        residuals = [outcome.residual for outcome in outcomes if outcome.residual is not None]
        rates = [outcome.rates for outcome in outcomes if outcome.rates is not None]
        starts = np.cumsum([0, *(len(outcome.status) for outcome in outcomes)])
        breakpoints: dict[int, Breakpoints] = {}
        events: Events = {}
        for start, outcome in zip(starts[:-1], outcomes, strict=True):
            instances = start + np.arange(len(outcome.status))
            breakpoints |= placed(outcome.breakpoints, instances)
            events |= placed_events(outcome.events, instances)
        return cls(
            np.concatenate([outcome.status for outcome in outcomes]),
            np.concatenate([outcome.iterations for outcome in outcomes]),
            np.concatenate([outcome.integrations for outcome in outcomes]),
            np.concatenate(residuals) if len(residuals) == len(outcomes) else None,
            np.concatenate(rates) if len(rates) == len(outcomes) else None,
            breakpoints=breakpoints,
            events=events,
        )


def knows(problem: BoundaryProblem, guess: FloatArray) -> NDArray[np.bool_]:
    """Of which instances there is a guess, (instance_count,): what failed is NaN, and what is straight and taut tells nothing."""
    return np.asarray(np.isfinite(guess).all(axis=1) & ~problem.tells_nothing(guess))


def refuse_unfit(problem: BoundaryProblem, outcome: Outcome, chosen: BoolArray | None = None) -> None:
    """Say so where what a solver found is no result, for a problem that tests this, or where there can be none; of those
    ``chosen``, shape (instance_count,), all by default."""
    if failures(outcome.status).any():
        outcome.status[:] = problem.reasons(outcome.status)
    if problem.result_test is None:
        return
    found, tested = ~failures(outcome.status), settled(outcome.status)
    if chosen is not None:
        found, tested = found & chosen, tested & chosen
    refusals = problem.result_test.refusals(tested)
    refused = found & (refusals != Status.NOT_RUN)
    outcome.status[refused] = refusals[refused]
    outcome.integrations = outcome.integrations + problem.result_test.integrations * tested  # it may be another's


class Track(Uncopied, ABC):
    """A solver that follows one problem from sample to sample, its inputs changed in between."""

    instead = "make another problem and track that"
    problem: BoundaryProblem

    @abstractmethod
    def step(self) -> Outcome:
        """Bring the unknowns up to the problem's present inputs."""

    def pace(self, before: float, after: float) -> None:
        """The next sample comes ``before`` seconds after the last one, and the one after it ``after`` seconds later. Called where
        samples are not evenly spaced; what does not go by time needs not heed it."""

    def start(self, unknowns: FloatArray) -> None:
        """Take ``unknowns`` (instance_count, n) as the first guess, of instances whose row is not NaN."""
        self.problem.write("unknowns", unknowns)


class Solver(ABC):
    """Finds the unknowns of a boundary problem. Holds options only, no state; sees no robot.

    A subclass implements ``_solve``; with that alone it also follows motions, each sample warm-started from the last.
    Third parties register theirs by the entry-point group ``multirod.solvers`` (``docs/extending.md``).

    Attributes:
        integrator: Of the spatial equations.
        needs_dt: Whether ``track`` goes by the time between samples; if not, a ``Tracker`` may give it NaN.
        takes_uneven: Whether a track of one that ``needs_dt`` heeds ``Track.pace``: only then may samples be spaced unevenly.
    """

    integrator: Integrator = RK45()
    needs_dt: ClassVar[bool] = False
    takes_uneven: ClassVar[bool] = False
    pose_sensitivities: bool = False
    direction_count: int = 0

    def unsupported(self, problem: BoundaryProblem) -> tuple[str, ...]:
        """Every reason why this solver cannot take ``problem``; empty if it can."""
        return ()

    def solve(self, problem: BoundaryProblem, guess: FloatArray | None = None, *, leave: bool = False) -> Outcome:
        """Solve every instance.

        Args:
            problem: The problem; its buffers hold the result.
            guess: Unknowns to start from (instance_count, n); without it, the natural branch is meant. So it is of instances
                whose row is NaN, as of what failed, where the problem offers parts. Of what the problem's ``breakpoints`` know,
                they alone lead nowhere: a solver may start from the states there.
            leave: Whether a few that take long may be left to ``finish``, with those of other parts of a batch; their status is
                that of a failure.

        Raises:
            ValueError: If the problem is not supported; the message gives every reason.
            RuntimeError: If another thread works on the problem.
        """
        reasons = self.unsupported(problem)
        if reasons:
            raise ValueError(f"{type(self).__name__} cannot take this problem: " + "; ".join(reasons))
        points, problem.breakpoints = problem.breakpoints, {}
        with problem.alone, problem.everyone(), problem.at_load(1.0):
            known = None if guess is None else knows(problem, guess)
            if guess is None and leave:
                outcome = self._solve_most(problem)
            elif guess is not None and points and problem.parts is not None:
                outcome = self._some_guessed(problem, guess, np.asarray(np.isfinite(guess).all(axis=1)), points)
            elif guess is None or known is None or known.all():
                outcome = self._solve(problem, guess)
            elif known.any() and problem.parts is not None:
                outcome = self._some_guessed(problem, guess, known, {})
            else:
                outcome = self._solve(problem, None if not known.any() else guess)
            refuse_unfit(problem, outcome)
        return outcome

    def _some_guessed(
        self,
        problem: BoundaryProblem,
        guess: FloatArray,
        known: NDArray[np.bool_],
        points: Mapping[int, Breakpoints],
    ) -> Outcome:
        """From a guess where there is one, from ``points`` where these are of it, without where there is none: each as it is
        alone."""
        assert problem.parts is not None
        cut = known & np.isin(np.arange(len(known)), list(points))
        groups = [np.flatnonzero(some) for some in (known & ~cut, ~known, cut)]
        outcomes = []
        for own, start in zip(groups, (guess[groups[0]], None, guess[groups[2]]), strict=True):
            if not len(own):
                continue
            part = problem.parts.of(own)
            mine = taken(points, own)
            outcomes.append(self._resume(part, start, mine) if mine and start is not None else self._solve(part, start))
            problem.keep(part, own)
        return Outcome.joined(outcomes).take(np.argsort(np.concatenate(groups)))

    def _resume(self, problem: BoundaryProblem, guess: FloatArray, points: Mapping[int, Breakpoints]) -> Outcome:
        """Solve every instance from a guess that is known by its states at ``points``: by its unknowns, where nothing else is
        known of them."""
        return self._solve(problem, guess)

    @abstractmethod
    def _solve(self, problem: BoundaryProblem, guess: FloatArray | None) -> Outcome:
        """Solve every instance of a supported problem."""

    def _solve_most(self, problem: BoundaryProblem) -> Outcome:
        """Solve every instance, but for a few that may be left, without a guess."""
        return self._solve(problem, None)

    def finish(self, problem: BoundaryProblem, left: Left) -> Outcome:
        """Solve what was left of other problems, as it would have been there; ``problem`` is of these instances."""
        with problem.alone, problem.everyone(), problem.at_load(1.0):
            outcome = self._finish(problem, left)
            refuse_unfit(problem, outcome)
        return outcome

    def _finish(self, problem: BoundaryProblem, left: Left) -> Outcome:
        """The same, of a solver that leaves some."""
        raise NotImplementedError(f"{type(self).__name__} leaves none")

    def track(self, problem: BoundaryProblem, dt: float) -> Track:
        """Follow ``problem`` at samples ``dt`` apart [s]."""
        return _WarmStarted(self, problem)

    def in_double(self) -> Self:
        """The same with an integrator in double precision."""
        if self.integrator.precision == "float64":
            return self
        result = copy(self)
        object.__setattr__(result, "integrator", self.integrator.in_double())
        return result

    def _check_tolerance(self) -> None:
        """Refuse a tolerance that is neither None nor a number > 0."""
        tolerance = getattr(self, "tolerance", None)
        if tolerance is not None:
            positive_float(f"{type(self).__name__}.tolerance", tolerance)

    def _check_integrator(self) -> None:
        if not isinstance(self.integrator, Integrator):
            refuse(f"{type(self).__name__}.integrator", self.integrator, "must be an Integrator such as RK4(50) or RK45()")


class Tested(Track):
    """Another track, whose results are tested as those of ``Solver.solve`` are."""

    def __init__(self, track: Track) -> None:
        self.problem = track.problem
        self._track = track

    def start(self, unknowns: FloatArray) -> None:  # noqa: D102
        self._track.start(unknowns)

    def pace(self, before: float, after: float) -> None:  # noqa: D102
        self._track.pace(before, after)

    def step(self) -> Outcome:  # noqa: D102
        outcome = self._track.step()
        refuse_unfit(self.problem, outcome)
        return outcome


class _WarmStarted(Track):
    """Solves every sample anew from the unknowns of the last good one."""

    def __init__(self, solver: Solver, problem: BoundaryProblem) -> None:
        self.solver = solver
        self.problem = problem
        self.last: FloatArray | None = None

    def start(self, unknowns: FloatArray) -> None:
        self.last = np.array(unknowns)

    def step(self) -> Outcome:
        outcome = self.solver.solve(self.problem, self.last)
        found = self.problem.read("unknowns")
        kept = found if self.last is None else self.last
        good = ~failures(outcome.status)
        if good.all() or self.last is not None:
            self.last = np.where(good[:, None], found, kept)
        return outcome


def registered_solvers() -> dict[str, type[Solver]]:
    """Solver classes by name, of this package and of others that register in the group ``multirod.solvers``.

    What cannot be loaded, or is no ``Solver``, is left out and named in a ``RuntimeWarning``: the others are there.
    """
    from importlib.metadata import entry_points

    solvers: dict[str, type[Solver]] = {}
    for point in entry_points(group="multirod.solvers"):
        where = f"solver {point.name!r} of {'an unknown package' if point.dist is None else point.dist.name} ({point.value})"
        try:
            found = point.load()
        except Exception as error:  # noqa: BLE001  (of another package: whatever it is, the others go on)
            warn(f"{where} is left out: {type(error).__name__}: {error}", RuntimeWarning)
            continue
        if isinstance(found, type) and issubclass(found, Solver):
            solvers[point.name] = found
        else:
            warn(f"{where} is left out: it is {found!r}, not a subclass of Solver", RuntimeWarning)
    return solvers
