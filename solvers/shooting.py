"""Shooting: Newton's method with the exact Gamma, along the natural branch or along a motion."""

from contextlib import nullcontext
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import warp as wp

from multirod.integrators import RK45, Integrator
from multirod.problem import BoundaryProblem
from multirod.solver import Outcome, Solver, Track, knows
from multirod.solvers.continuation.natural import TURN, Paths, natural_branch
from multirod.solvers.following.follow import follow
from multirod.solvers.multiple_shooting import MultipleShooting
from multirod.solvers.newton.iteration import UNLIMITED, Newton
from multirod.solvers.newton.newton_kernels import Sample
from multirod.solvers.newton.refinement import refine
from multirod.solvers.starting.assembling import assemble
from multirod.solvers.starting.letting_out import let_out, loosened, near_the_end
from multirod.solvers.starting.multistart import lowest_stable, refuse_unstable
from multirod.solvers.tracking.kinks import passed_kinks
from multirod.status import BoolArray, IntArray, Status, failures
from multirod.validation import FloatArray, boolean, choice, positive_int

PREDICTORS = ("none", "linear", "quadratic")
AT_FOLD = ("follow", "stop")
SIDES = ("positive", "negative")
SAME = 1e-6  # unknowns that are, beside 1/m and themselves
FRESH = 1e-3  # of the way between two samples, that the first step from where a motion has just come to is
DIP = 0.1  # of the load, that is taken off on the way past a kink
# by which a loose network may end that no other way led to a result
WITHOUT_REASON = (Status.STALLED, Status.BRANCH_END, Status.SINGULAR_JACOBIAN, Status.INTEGRATION_LIMIT, Status.MAX_ITERATIONS)
_CONVERGED = int(Status.CONVERGED)


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
            ``"negative"``, to its twin.

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
        newton = self._newton(problem)
        if guess is None:
            return self._first(problem, newton, poses_apart=True)
        problem.write("unknowns", guess)
        newton.allow(self.max_integrations)
        beyond = problem.out_of_reach()
        with problem.without_poses():
            newton.run(~beyond if beyond.any() else None)
        return newton.outcome()

    def _first(self, problem: BoundaryProblem, newton: Newton, chosen: Any = None, *, poses_apart: bool = False) -> Outcome:
        """Without a guess: the end of the natural branch, by one of two ways where there are two, or where it ends early and
        others are meant, the lowest stable one.
        """
        chosen = np.ones(problem.instance_count, dtype=bool) if chosen is None else chosen
        beyond = chosen & problem.out_of_reach()
        if beyond.any():
            return self._within_reach(problem, newton, chosen, beyond)
        multistable = problem.stability is not None and problem.stability.multistable
        with problem.without_poses() if poses_apart else nullcontext():
            newton.allow(self.max_integrations)
            handed, tried = np.zeros(problem.instance_count, dtype=bool), np.full(problem.instance_count, int(Status.NOT_RUN))
            outcome = natural_branch(problem, newton, self.max_continuation_steps, chosen, handed if self.fallback else None)
            reached, ends = outcome.reached, problem.read("unknowns")
            if self.fallback and reached is not None:
                handed |= chosen & (outcome.status == Status.MAX_ITERATIONS) & (reached > 0)
            for status in (Status.UNDETERMINED, Status.LOOSE):  # from wherever
                known = outcome.status == status
                chosen = chosen & ~known
                tried[known] = status
            newton.allow(self._left(outcome))
            refine(problem, newton, outcome, chosen)
            unbounded = self._let_out(problem, newton, outcome, chosen)
            refuse_unstable(problem, outcome, chosen)
            lost = chosen & failures(outcome.status)
            if not lost.any():
                return outcome
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
        lost = chosen & (outcome.status == Status.BRANCH_END)
        if lost.any() and reached is not None and not multistable:
            self._follow(problem, newton, outcome, lost, reached, ends)
        if unbounded is not None:
            outcome.status[unbounded & failures(outcome.status)] = Status.LINES_TOO_SHORT
        lost = np.isin(outcome.status, WITHOUT_REASON)
        if lost.any():
            outcome.status[lost & np.array([name != "" for name in problem.loose()])] = Status.LOOSE
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
        starts = {k: (ends[k], float(reached[k])) for k in np.flatnonzero(handed).tolist()}
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
        lost: Any,
        reached: FloatArray,
        unknowns: FloatArray,
        before: FloatArray | None = None,
        left: IntArray | None = None,
    ) -> None:
        """Go on from where branches ended; what is not followed stays as it is."""
        if self.at_fold == "stop" or not lost.any():
            return
        noisy = follow(
            problem,
            outcome,
            lost,
            unknowns=unknowns,
            reached=reached,
            tolerance=newton.tolerance(),
            allowed=self._left(outcome) if left is None else left,
            max_steps=self.max_continuation_steps,
            side=1 if self.side == SIDES[0] else -1,
            before=before,
        )
        if self.fallback and before is None:
            ends = {k: (own.lost.unknowns, own.lost.level) for k, own in noisy.items() if own.lost is not None}
            tried = self._segmented().go_on(problem, outcome, ends, self._left(outcome))
            for k in np.flatnonzero(~failures(tried)).tolist():
                outcome.status[k], outcome.events[k] = noisy[k].said, tuple(noisy[k].events)

    def _segmented(self) -> MultipleShooting:
        return MultipleShooting(
            tolerance=self.tolerance, integrator=self.integrator, max_continuation_steps=self.max_continuation_steps
        )

    def _left(self, outcome: Outcome) -> IntArray:
        """Integrations that each instance may still take, shape (instance_count,)."""
        return np.maximum(self.max_integrations - outcome.integrations, 0)

    def track(self, problem: BoundaryProblem, dt: float) -> Track:
        """Follow a motion, each sample from the last or from its extrapolation."""
        return NewtonTrack(self, problem)


class NewtonTrack(Track):
    """Newton along a motion: the last samples' unknowns, extrapolated, start the next.

    A sample that might have left its branch (slow contraction, a Gamma unlike the last, or no convergence) is solved again by
    continuation in the inputs from the last good sample, in steps that are sure to stay on the branch; where that ends, the
    sample fails, and the next starts from the last good one again.
    """

    def __init__(self, options: Shooting, problem: BoundaryProblem) -> None:
        self.options = options
        self.problem = problem
        self.newton = options.newton(problem)
        self.newton.expect()
        self.order = PREDICTORS.index(options.predictor)
        count, n = problem.instance_count, problem.unknown_count
        # on a processor, NumPy and the kernel of a sample share what is kept
        state: Any = Sample()
        state.past = wp.zeros((count, 3, n), dtype=wp.float64, device="cpu")
        state.last_inputs = wp.zeros((count, problem.input_count), dtype=wp.float64, device="cpu")
        state.points, state.good = (wp.zeros(1, dtype=wp.int32, device="cpu") for _ in range(2))
        if wp.get_device(problem.device).is_cpu:
            state.inputs = problem.inputs
        turned = problem.turned if problem.may_jump else slice(0, 0)
        state.turned, state.most_turn = wp.vec2i(turned.start, turned.stop), TURN
        state.order, state.slow, state.most_integrations = self.order, self.newton.slow, min(options.max_integrations, UNLIMITED)
        self._state = state
        self._past, self._last_inputs = state.past.numpy(), state.last_inputs.numpy()
        self._points, self._good = state.points.numpy(), state.good.numpy()
        self._sample: tuple[Any, Any] | None = None  # the launch of a sample, and what it calls
        self.inputs: FloatArray | None = None  # those of the last good sample
        self.known = np.zeros(problem.instance_count, dtype=bool)  # instances that have had a good sample, or a guess
        self.all_known = False
        # where branches are near: what came there by an event
        self.fresh, self._any_fresh = np.zeros(problem.instance_count, dtype=bool), False

    @property
    def last(self) -> FloatArray:
        """Unknowns of the last good samples, shape (instance_count, n)."""
        return np.asarray(self._past[:, 0])

    def start(self, unknowns: FloatArray) -> None:
        """Take ``unknowns`` as the sample before the first, of instances whose row is not NaN."""
        self.known = knows(unknowns)
        self.all_known = bool(self.known.all())
        self._past[:, 0], self._points[0] = np.where(self.known[:, None], unknowns, self.problem.guess()), 1

    def step(self) -> Outcome:
        """Extrapolate, iterate to the tolerance, and make sure of the branch."""
        problem, newton = self.problem, self.newton
        if self.all_known and self.inputs is not None and not self._any_fresh and (calls := newton.calls()) is not None:
            if self._sample is None or self._sample[0] is not calls:
                self._sample = calls, newton.repeating(calls, self._state)
            problem.heed_stop()
            self._sample[1].launch()
            if self._good[0]:
                return newton.outcome()
            newton.go_on()  # where it was not at its end
            return self._made_sure(newton.outcome(), None)
        first = None
        if not self.all_known:
            if not self._points[0]:
                self._past[:, 0], self._points[0] = problem.guess(), 1
            first = self.options._first(problem, newton, ~self.known)
            if not self.known.any():
                return self._keep(first)
        past, points = self._past, int(self._points[0])
        if points > 2:
            guess = 3 * (past[:, 0] - past[:, 1]) + past[:, 2]
        elif points == 2:
            guess = 2 * past[:, 0] - past[:, 1]
        else:
            guess = past[:, 0]
        if first is not None:
            guess = np.where(self.known[:, None], guess, problem.read("unknowns"))
        problem.write("unknowns", guess)
        newton.allow(self.options.max_integrations)
        newton.run(None if first is None else self.known)
        outcome = newton.outcome()
        if first is not None:
            for mine, theirs in (
                (outcome.status, first.status),
                (outcome.iterations, first.iterations),
                (outcome.integrations, first.integrations),
            ):
                mine[~self.known] = theirs[~self.known]
            outcome.breakpoints, outcome.events = first.breakpoints, first.events
        return self._made_sure(outcome, first)

    def _made_sure(self, outcome: Outcome, first: Outcome | None) -> Outcome:
        """What may have left its branch is solved again, and the sample is kept."""
        problem, newton = self.problem, self.newton
        turned = self._turned()
        fresh = bool(self.fresh.any())
        if self.inputs is not None and (newton.doubtful() or first is not None or turned is not None or fresh):
            doubtful = ((outcome.status != _CONVERGED) | newton.strayed()) & self.known
            doubtful &= ~passed_kinks(problem, newton, doubtful & (outcome.status == _CONVERGED), self.last)
            if turned is not None:
                doubtful |= turned & self.known
            calm, own = ~doubtful, problem.read("unknowns") if fresh else None
            doubtful |= self.fresh
            beyond = doubtful & problem.out_of_reach()  # where no way leads
            outcome.status[beyond] = Status.OUT_OF_REACH
            doubtful &= ~beyond
            if doubtful.any():
                self._continue(doubtful, outcome, self.inputs)
            if own is not None:
                # where both lead to the same, branches are no longer near
                self.fresh &= ~(calm & np.isclose(own, problem.read("unknowns"), rtol=SAME, atol=SAME).all(axis=1))
        return self._keep(outcome)

    def _turned(self) -> Any:
        """Which instances were turned too far since the last good sample; None if none was."""
        if self.inputs is None or not self.problem.may_jump:
            return None
        turned = self.problem.turning(self.inputs) > TURN
        return turned if turned.any() else None

    def _continue(self, doubtful: Any, outcome: Outcome, before: FloatArray) -> None:
        """Solve the doubtful instances again, from the last good sample, in steps of the inputs."""
        self.newton.allow(self.options._left(outcome))
        paths = Paths(self.problem, self.newton, self.options.max_continuation_steps)
        safe = np.where(self.fresh, FRESH, 1.0)
        last = self.last.copy(), self.newton.reference()
        again = paths.change_inputs(doubtful, before, *last, safe_step=safe)
        self._take_in(doubtful, again, outcome)
        reached, ends = again.reached, self.problem.read("unknowns")
        stuck = doubtful & failures(again.status)
        if len(self.problem.kinks) and stuck.any() and (stuck := stuck & paths.at_kink()).any():
            # Gamma jumps there however short the steps are
            self.newton.allow(self.options._left(outcome))
            self._take_in(stuck, paths.change_inputs(stuck, before, *last, dip=DIP), outcome)
            if len(self.problem.kink_inputs) and (stuck := stuck & failures(outcome.status)).any():
                self._let_out(stuck, outcome, paths, before, last[0])
        # where many modes are soft, steps may become small just before one vanishes
        stalled = doubtful & (outcome.status == Status.STALLED)
        ended = stalled | (doubtful & (outcome.status == Status.BRANCH_END))
        if ended.any():
            assert reached is not None  # by every path
            self.options._follow(self.problem, self.newton, outcome, ended, reached, ends, before)
            outcome.status[stalled & (outcome.status == Status.BRANCH_END)] = Status.STALLED

    def _let_out(self, stuck: BoolArray, outcome: Outcome, paths: Paths, before: FloatArray, last: FloatArray) -> None:
        """What is stuck beside a line at its kink, from the last good sample with all lines longer, on a way where they are."""
        problem, newton, asked = self.problem, self.newton, self.problem.read("inputs")
        newton.allow(self.options._left(outcome))

        def find(some: BoolArray) -> Outcome:
            longer = problem.read("inputs")
            start = before + longer - asked
            problem.write("inputs", start)
            problem.write("unknowns", np.where(some[:, None], loosened(problem, last), problem.read("unknowns")))
            newton.run(some)
            first, ready = newton.outcome(), some & (newton.outcome().status == _CONVERGED)
            problem.write("inputs", longer)
            found = paths.change_inputs(ready, start, problem.read("unknowns"), newton.gamma())
            found.status[some & ~ready] = int(Status.STALLED)
            found.iterations += first.iterations
            found.integrations += first.integrations
            return found

        outcome.status[let_out(problem, newton, outcome, stuck, find)] = Status.LINES_TOO_SHORT

    @staticmethod
    def _take_in(chosen: Any, again: Outcome, outcome: Outcome) -> None:
        outcome.status[chosen] = again.status[chosen]
        outcome.iterations += again.iterations
        outcome.integrations += again.integrations
        outcome.reached = again.reached

    def _keep(self, outcome: Outcome) -> Outcome:
        found, inputs = self.problem.read("unknowns"), self.problem.read("inputs")
        past, self._points[0] = self._past, min(self._points[0] + 1, self.order + 1)
        if self.all_known and (outcome.status == _CONVERGED).all():
            past[:, 1:] = past[:, :2]
            past[:, 0] = found
            self._last_inputs[:] = inputs
            self.newton.set_reference()
        else:
            # of what is known by its breakpoints only, the unknowns alone cannot start the next sample
            good = ~failures(outcome.status)
            good[list(outcome.breakpoints)] = False
            # what failed starts again from its last equilibrium, what is new from its first, both without a slope
            elsewhere = np.isin(outcome.status, (Status.BIFURCATED, Status.SNAPPED, Status.DAMPED))
            self.fresh |= elsewhere
            kept, new = good[:, None], (good & (elsewhere | ~self.known))[:, None]
            last = past[:, 0].copy()
            for k, point in ((2, past[:, 1]), (1, past[:, 0]), (0, found)):
                past[:, k] = np.where(new, found, np.where(kept, point, last))
            self._last_inputs[:] = inputs if self.inputs is None else np.where(kept, inputs, self.inputs)
            self.newton.set_reference(good)
            self.known |= good
            self.all_known = bool(self.known.all())
        self.inputs = self._last_inputs
        self._any_fresh = bool(self.fresh.any())
        return outcome
