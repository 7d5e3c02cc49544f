"""Shooting: Newton's method with the exact Gamma, along the natural branch or along a motion."""

from contextlib import nullcontext
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from multirod.integrators import RK45, Integrator
from multirod.problem import BoundaryProblem
from multirod.solver import Left, Outcome, Solver, Track
from multirod.solvers.continuation.natural import natural_branch
from multirod.solvers.following.follow import ENDED, follow
from multirod.solvers.following.walk import NOISY
from multirod.solvers.multiple_shooting import MultipleShooting
from multirod.solvers.newton.iteration import Newton
from multirod.solvers.newton.refinement import refine
from multirod.solvers.starting.assembling import assemble
from multirod.solvers.starting.letting_out import let_out, near_the_end
from multirod.solvers.starting.multistart import lowest_stable, refuse_unstable
from multirod.solvers.tracking.newton_track import NewtonTrack
from multirod.status import BoolArray, IntArray, Status, failures
from multirod.validation import FloatArray, boolean, choice, positive_int

PREDICTORS = ("none", "linear", "quadratic")
AT_FOLD = ("follow", "stop")
SIDES = ("positive", "negative")
MOST_LEFT = 0.5  # of the instances: more are not left to be done with those of other parts of a batch
# by which a loose network may end that no other way led to a result
WITHOUT_REASON = (Status.STALLED, Status.BRANCH_END, Status.SINGULAR_JACOBIAN, Status.INTEGRATION_LIMIT, Status.MAX_ITERATIONS)


@dataclass
class _Raised:
    """Where natural branches lead by raising loads; the first axis of all is the instance.

    Attributes:
        outcome: How they ended.
        chosen: Which are meant.
        handed: Which crept, and are handed over to segments.
        tried: How segments ended, of those that are not to be tried by these; ``NOT_RUN`` of the others.
        ends: Unknowns there [1/m].
        unbounded: Which are beside a line at its kink whose tension rises without bound.
    """

    outcome: Outcome
    chosen: BoolArray
    handed: BoolArray
    tried: IntArray
    ends: FloatArray
    unbounded: BoolArray

    @property
    def lost(self) -> BoolArray:
        """Which have no result yet."""
        return np.asarray(self.chosen & failures(self.outcome.status))

    def left(self, problem: BoundaryProblem) -> Left:
        """Those that have none."""
        numbers = np.flatnonzero(self.lost)
        own = {name: getattr(self, name) for name in ("handed", "tried", "ends", "unbounded")}
        known = {name: values[numbers] for name, values in (self.outcome.arrays | own).items()}
        return Left(numbers, problem.snapshot()[numbers], known)

    @classmethod
    def of(cls, left: Left) -> "_Raised":
        """The reverse."""
        mine, counts = dict[str, Any](), dict[str, Any]()
        for name, values in left.known.items():
            (mine if name in cls.__annotations__ else counts)[name] = np.array(values)
        return cls(Outcome(**counts), np.ones(len(left.numbers), dtype=bool), **mine)


@dataclass(frozen=True, kw_only=True)
class Shooting(Solver):
    """Newton's method, one integration an iteration, with a backtracking line search.

    Without a guess it finds the equilibrium on the natural branch, the one reached from the unloaded assembly by raising
    all loads in proportion: in one step where Newton's method contracts as it must on one branch and ``Gamma`` changes
    little, else by load continuation in steps that pass these tests and one more (``docs/solvers.md``).

    Attributes:
        tolerance: Largest residual, max norm [1/m]; None is 1e-9 for rods of usual size, and otherwise a part of the largest
            precurvature, or of one over the length: 1e-9 of it where that is less than 1/m, 1e-12 of it where it is more than
            1000/m, and for an integrator in ``"float32"`` 1e-5 (``docs/solvers.md``, Single precision).
        integrator: Of the spatial equations.
        max_iterations: Newton iterations allowed, in each continuation step and in all of a warm start. ``iterations`` of a
            solution counts those of all steps, and may be more.
        predictor: How a motion's next sample is guessed: from the last one (``"none"``), or by ``"linear"`` (default) or
            ``"quadratic"`` extrapolation in time.
        line_search: Whether steps that do not reduce the residual are halved.
        max_continuation_steps: Load steps allowed.
        max_integrations: Integrations of a rod allowed in all that one solve does for an instance, or one sample of a motion:
            continuation, the search for a stable equilibrium and ``MultipleShooting`` (no more there than its own default). What
            has taken them without a result ends as ``INTEGRATION_LIMIT``. The few that judge a result, or tell what is left of
            the residual, come on top.
        fallback: Whether ``MultipleShooting`` goes on where rounding or these steps end the natural branch.
        at_fold: What is done where a branch ends: ``"follow"`` goes where a robot would whose loads are raised slowly, to the
            status ``BIFURCATED`` or ``SNAPPED``, or in a ``solve`` of tubes to ``LOWEST_ENERGY`` (``docs/branches.md``);
            ``"stop"`` ends there, with the status ``BRANCH_END``, and no other equilibrium is looked for.
        side: To which side it goes at a bifurcation: ``"positive"``, where the tip moves along a positive axis of the world, or
            ``"negative"``, to its twin. Of a held rod that does not stretch, whose ends are pushed together, it is its middle
            that moves so (``docs/held.md``).

    Raises:
        ValueError: If a field is out of range.
    """

    tolerance: float | None = None
    integrator: Integrator = field(default_factory=RK45)
    max_iterations: int = 30
    predictor: str = "linear"
    line_search: bool = True
    max_continuation_steps: int = 1000
    max_integrations: int = 50_000
    fallback: bool = True
    at_fold: str = "follow"
    side: str = "positive"

    def __post_init__(self) -> None:
        self._check_integrator()
        self._check_tolerance()
        positive_int("Shooting.max_iterations", self.max_iterations)
        choice("Shooting.predictor", self.predictor, PREDICTORS)
        boolean("Shooting.line_search", self.line_search)
        positive_int("Shooting.max_continuation_steps", self.max_continuation_steps)
        positive_int("Shooting.max_integrations", self.max_integrations)
        boolean("Shooting.fallback", self.fallback)
        choice("Shooting.at_fold", self.at_fold, AT_FOLD)
        choice("Shooting.side", self.side, SIDES)

    @property
    def _sign(self) -> int:
        return 1 if self.side == SIDES[0] else -1

    def newton(self, problem: BoundaryProblem) -> Newton:
        """Newton's iteration on a problem, with these options."""
        return Newton(problem, tolerance=self.tolerance, max_iterations=self.max_iterations, line_search=self.line_search)

    def _newton(self, problem: BoundaryProblem) -> Newton:
        """The same for one solve; it is kept with a problem that may be kept, for the next."""
        if not problem.may_be_kept:
            return self.newton(problem)
        key = ("Newton", self.tolerance, self.max_iterations, self.line_search)
        newton: Newton = problem.tool(key, lambda: self.newton(problem))
        newton.renew()
        return newton

    def _solve(self, problem: BoundaryProblem, guess: FloatArray | None) -> Outcome:
        newton, problem.side = self._newton(problem), self._sign
        if guess is None:
            return self._told(problem, self._first(problem, newton, poses_apart=True))
        problem.write("unknowns", guess)
        newton.allow(self.max_integrations)
        beyond = problem.out_of_reach()
        with problem.without_poses():
            newton.run(~beyond if beyond.any() else None)
        return newton.outcome()

    def _solve_most(self, problem: BoundaryProblem) -> Outcome:
        problem.side = self._sign
        # what is put together from its joints, or was led to where its path begins, is known by more than is left
        if problem.parts is None or problem.joints is not None or problem.out_of_reach().any():
            return self._solve(problem, None)
        newton = self._newton(problem)
        raised = self._raise(problem, newton, np.ones(problem.instance_count, dtype=bool), poses_apart=True)
        few = 0 < raised.lost.sum() <= MOST_LEFT * problem.instance_count
        if few and not problem.passed:
            raised.outcome.left = raised.left(problem)
            return raised.outcome
        return self._told(problem, self._end(problem, newton, raised, poses_apart=True))

    def _finish(self, problem: BoundaryProblem, left: Left) -> Outcome:
        newton, problem.side = self._newton(problem), self._sign
        problem.restore(left.records)
        return self._end(problem, newton, _Raised.of(left), poses_apart=True)

    def _told(self, problem: BoundaryProblem, outcome: Outcome) -> Outcome:
        if self.at_fold != "stop":
            _tell_passed(problem, outcome)
        return outcome

    def _first(
        self, problem: BoundaryProblem, newton: Newton, chosen: BoolArray | None = None, *, poses_apart: bool = False
    ) -> Outcome:
        """Without a guess: the end of the natural branch, by one of two ways where there are two, or where it ends early and
        others are meant, the lowest stable one.
        """
        chosen = np.ones(problem.instance_count, dtype=bool) if chosen is None else chosen
        beyond = chosen & problem.out_of_reach()
        if beyond.any():
            return self._within_reach(problem, newton, chosen, beyond)
        raised = self._raise(problem, newton, chosen, poses_apart=poses_apart)
        return self._end(problem, newton, raised, poses_apart=poses_apart)

    def _raise(self, problem: BoundaryProblem, newton: Newton, chosen: BoolArray, *, poses_apart: bool) -> "_Raised":
        """To where the natural branch leads by raising loads."""
        with problem.without_poses() if poses_apart else nullcontext():
            newton.allow(self.max_integrations)
            handed, tried = np.zeros(problem.instance_count, dtype=bool), np.full(problem.instance_count, int(Status.NOT_RUN))
            outcome = natural_branch(problem, newton, self.max_continuation_steps, chosen, handed if self.fallback else None)
            reached, ends = outcome.reached, problem.read("unknowns")
            if self.fallback and reached is not None:
                handed |= chosen & (outcome.status == int(Status.MAX_ITERATIONS)) & (reached > 0)
            for status in (Status.UNDETERMINED, Status.LOOSE):  # from wherever
                known = outcome.status == int(status)
                chosen = chosen & ~known
                tried[known] = status
            newton.allow(self._left(outcome))
            refine(problem, newton, outcome, chosen)
            unbounded = self._let_out(problem, newton, outcome, chosen)
            refuse_unstable(problem, outcome, chosen)
        return _Raised(outcome, chosen, handed, tried, ends, np.zeros_like(chosen) if unbounded is None else unbounded)

    def _end(self, problem: BoundaryProblem, newton: Newton, raised: "_Raised", *, poses_apart: bool) -> Outcome:
        """From where the natural branch ends before the full load."""
        outcome, chosen, handed, tried, ends = raised.outcome, raised.chosen, raised.handed, raised.tried, raised.ends
        multistable = problem.stability is not None and problem.stability.multistable
        lost, reached = raised.lost, outcome.reached
        if not lost.any():
            return outcome
        with problem.without_poses() if poses_apart else nullcontext():
            newton.allow(self._left(outcome))
            go_on = None if self.at_fold == "stop" else self._go_on
            ended = assemble(problem, newton, outcome, lost, self.max_continuation_steps, go_on)
            if go_on is None:
                outcome.status[ended] = Status.BRANCH_END
                chosen = chosen & ~ended
            if reached is not None and multistable:
                self._follow(problem, newton, outcome, chosen & (outcome.status == Status.BRANCH_END), reached, ends)
            newton.allow(self._left(outcome))
            if go_on is not None:
                lowest_stable(problem, newton, outcome, chosen & failures(outcome.status), self.max_continuation_steps)
                newton.allow(self._left(outcome))
                lost = chosen & failures(outcome.status)
                assemble(problem, newton, outcome, lost, self.max_continuation_steps, go_on, closing=True)
        # the poses that it finds are not those of the unknowns: nothing may integrate these again
        if handed.any() and reached is not None:
            tried = self._hand_over(problem, newton, outcome, handed, reached, ends)
        if self.fallback and failures(outcome.status).any():
            self._segmented().rescue(problem, outcome, self._left(outcome), tried)
        lost = chosen & np.isin(outcome.status, ENDED)
        # what creeps in segments too is given up, unless a soft mode makes it creep
        creeping = lost & (tried == int(Status.MAX_ITERATIONS))
        if creeping.any() and reached is not None:
            outcome.integrations += creeping
            lost &= ~_amplifies(problem, creeping, ends, reached)
        if lost.any() and reached is not None and not multistable:
            self._follow(problem, newton, outcome, lost, reached, ends)
        outcome.status[raised.unbounded & failures(outcome.status)] = Status.LINES_TOO_SHORT
        lost = np.isin(outcome.status, WITHOUT_REASON)
        if lost.any():
            outcome.status[lost & problem.is_loose()] = Status.LOOSE
        return outcome

    def _within_reach(self, problem: BoundaryProblem, newton: Newton, chosen: BoolArray, beyond: BoolArray) -> Outcome:
        """``_first`` of a part, where the others, ``beyond``, cannot have a result: nothing is integrated for these."""
        outcome = Outcome.zeros(problem.instance_count)
        outcome.status[beyond] = Status.OUT_OF_REACH
        places = np.flatnonzero(chosen & ~beyond)
        if len(places):
            assert problem.parts is not None  # what knows its reach offers parts
            part = problem.parts.of(places)
            found = self._first(part, newton.of(part, places))
            for name in ("status", "iterations", "integrations"):
                getattr(outcome, name)[places] = getattr(found, name)
            outcome.events = {int(places[k]): events for k, events in found.events.items()}
            outcome.breakpoints = {int(places[k]): points for k, points in found.breakpoints.items()}
            problem.keep(part, places)
        return outcome

    def _let_out(self, problem: BoundaryProblem, newton: Newton, outcome: Outcome, chosen: BoolArray) -> BoolArray | None:
        """What ended beside a line at its kink, from where lines are longer; as ``let_out``, None where nothing did."""
        at_end = near_the_end(problem, outcome, chosen)
        if not at_end.any():
            return None
        newton.allow(self._left(outcome))
        unbounded = let_out(
            problem, newton, outcome, at_end, lambda some: natural_branch(problem, newton, self.max_continuation_steps, some)
        )
        outcome.status[unbounded] = Status.LINES_TOO_SHORT  # no fold or bifurcation to be followed
        return unbounded

    def _go_on(self, problem: BoundaryProblem, newton: Newton, outcome: Outcome) -> None:
        """From where a branch ended in a part of all that one solve does."""
        lost, reached = np.isin(outcome.status, (Status.BRANCH_END, Status.STALLED)), outcome.reached
        if lost.any() and reached is not None:
            left = np.maximum(newton.allowed() - outcome.integrations, 0)
            self._follow(problem, newton, outcome, lost, reached, problem.read("unknowns"), left=left)

    def _hand_over(
        self,
        problem: BoundaryProblem,
        newton: Newton,
        outcome: Outcome,
        handed: BoolArray,
        reached: FloatArray,
        ends: FloatArray,
    ) -> IntArray:
        """Let multiple shooting go on where shooting crept; where it comes to an end, shooting follows the branch to there too.

        Returns:
            How multiple shooting ended, (instance_count,); ``NOT_RUN`` of the others.
        """
        starts = {k: (ends[k], float(reached[k]), 0) for k in np.flatnonzero(handed).tolist()}
        tried = self._segmented().go_on(problem, outcome, starts, self._left(outcome))
        decided = np.isin(tried, (Status.BRANCH_END, Status.MAX_ITERATIONS, Status.INTEGRATION_LIMIT))
        outcome.status[decided] = tried[decided]
        tried[failures(tried) & ~decided] = Status.NOT_RUN  # from there: it may still be found from the unloaded rod
        places = np.flatnonzero(tried == Status.BRANCH_END)
        if not len(places):
            return tried
        assert problem.parts is not None  # or nothing is handed over
        part = problem.parts.of(places)
        method, everyone = newton.of(part, places), np.ones(len(places), dtype=bool)
        method.allow(self._left(outcome)[places])
        again = natural_branch(part, method, self.max_continuation_steps)
        assert again.reached is not None
        reached[places], ends[places] = again.reached, part.read("unknowns")
        method.allow(np.maximum(self._left(outcome)[places] - again.integrations, 0))
        refine(part, method, again, everyone)
        outcome.status[places] = again.status
        outcome.iterations[places] += again.iterations
        outcome.integrations[places] += again.integrations
        problem.keep(part, places)
        return tried

    def _follow(
        self,
        problem: BoundaryProblem,
        newton: Newton,
        outcome: Outcome,
        lost: BoolArray,
        reached: FloatArray,
        unknowns: FloatArray,
        before: FloatArray | None = None,
        left: IntArray | None = None,
    ) -> None:
        """Go on from where branches ended; what is not followed stays as it is."""
        if self.at_fold == "stop" or not lost.any():
            return
        creeping = lost & (outcome.status == Status.MAX_ITERATIONS)
        noisy = follow(
            problem,
            outcome,
            lost,
            unknowns=unknowns,
            reached=reached,
            tolerance=newton.tolerance(),
            allowed=self._left(outcome) if left is None else left,
            max_steps=self.max_continuation_steps,
            side=self._sign,
            before=before,
        )
        if self.fallback and before is None:
            ends = {k: (own.lost.unknowns, own.lost.level, own.steps) for k, own in noisy.items() if own.lost is not None}
            tried = self._segmented().go_on(problem, outcome, ends, self._left(outcome))
            for k in np.flatnonzero(~failures(tried)).tolist():
                outcome.status[k], outcome.events[k] = noisy[k].said, tuple(noisy[k].events)
        outcome.status[creeping & (outcome.status == Status.BRANCH_END)] = Status.MAX_ITERATIONS  # it did not end there

    def _segmented(self) -> MultipleShooting:
        return MultipleShooting(
            tolerance=self.tolerance, integrator=self.integrator, max_continuation_steps=self.max_continuation_steps
        )

    def _left(self, outcome: Outcome) -> IntArray:
        """Integrations that each instance may still take, shape (instance_count,)."""
        return np.maximum(self.max_integrations - outcome.integrations, 0)

    def track(self, problem: BoundaryProblem, dt: float) -> Track:
        """Follow a motion, each sample from the last or from its extrapolation."""
        problem.side = self._sign
        return NewtonTrack(self, problem, PREDICTORS.index(self.predictor))


def _amplifies(problem: BoundaryProblem, some: BoolArray, unknowns: FloatArray, level: FloatArray) -> BoolArray:
    """Of which of some instances an integration from the base may hide by rounding how they go on from ``unknowns`` at levels of
    the load, all of the first axis instance_count."""
    records = problem.snapshot()
    problem.write("unknowns", np.where(some[:, None], unknowns, problem.read("unknowns")))
    with problem.only(some), problem.at_load(np.where(some, level, 1.0)):
        problem.integrate()
    size = np.linalg.norm(np.nan_to_num(problem.read("gamma"), nan=np.inf), axis=1)
    problem.restore(records)
    return np.asarray(some & (size > NOISY))


def _tell_passed(problem: BoundaryProblem, outcome: Outcome) -> None:
    """Name what happened on the way to where paths began."""
    for k, event in problem.passed.items():
        if outcome.status[k] in (Status.CONVERGED, Status.BIFURCATED, Status.SNAPPED):
            outcome.events[k] = (event, *outcome.events.get(k, ()))
            outcome.status[k] = Status.BIFURCATED if outcome.status[k] == Status.CONVERGED else outcome.status[k]
