"""Newton's method along a motion, sample by sample, on the branch of the last."""

from typing import TYPE_CHECKING, Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from multirod.problem import BoundaryProblem
from multirod.solver import Outcome, Track, knows
from multirod.solvers.continuation.paths import GROWTH, SAFE_LOAD, TURN, Paths
from multirod.solvers.following.descent import SOFT
from multirod.solvers.following.follow import ENDED, FINER
from multirod.solvers.following.onward import go_on
from multirod.solvers.multiple_shooting import NOISY
from multirod.solvers.newton.iteration import UNLIMITED
from multirod.solvers.newton.newton_kernels import FORGOTTEN, Sample
from multirod.solvers.segments.by_inputs import unsafe
from multirod.solvers.starting.cold_start import ColdStart
from multirod.solvers.starting.letting_out import at_kinks
from multirod.solvers.tracking.bends import SAME, bent, ended, passed_unstable
from multirod.solvers.tracking.by_states import LastStates
from multirod.solvers.tracking.foretold import FAR, extrapolated, respaced, shifted
from multirod.solvers.tracking.kinks import Ways, found_let_out, passed_kinks
from multirod.stability import modes_of
from multirod.status import BoolArray, Status, failures
from multirod.validation import FloatArray

if TYPE_CHECKING:
    from multirod.solvers.shooting import Shooting

FRESH = 1e-3  # of the way between two samples, that the first step from where a motion has just come to is
JUST_THERE = 1 - 1e-9  # of the way between two samples: its end, taken for where a branch ended
DIP = 0.1  # of the load, that is taken off on the way past a kink
LINEAR, QUADRATIC = 1, 2  # orders of extrapolation
_CONVERGED = int(Status.CONVERGED)


class NewtonTrack(Track):
    """Newton along a motion: the last samples' unknowns, extrapolated, start the next.

    A sample that might have left its branch (slow contraction, a Gamma unlike the last, or no convergence) is solved again by
    continuation in the inputs from the last good sample, in steps that are sure to stay on the branch; where that ends, the
    sample fails, and the next starts from the last good one again.

    Args:
        options: Whose.
        problem: At the inputs of each sample.
        order: Of the extrapolation; None for linear or quadratic, whichever foretold the last samples of an instance better, and
            linear where lines may turn slack.
    """

    def __init__(self, options: "Shooting", problem: BoundaryProblem, order: int | None) -> None:
        self.options = options
        self.problem = problem
        self.newton = options.newton(problem)
        self.newton.expect()
        self.order, self.chooses = QUADRATIC if order is None else order, order is None
        if self.chooses and len(problem.kinks):  # which more of the past leads past
            self.order, self.chooses = LINEAR, False
        count, n = problem.instance_count, problem.unknown_count
        # on a processor, NumPy and the kernel of a sample share what is kept
        state: Any = Sample()
        state.past = wp.zeros((count, 3, n), dtype=wp.float64, device="cpu")
        state.last_inputs = wp.zeros((count, problem.input_count), dtype=wp.float64, device="cpu")
        state.misses, state.chooses = wp.zeros((count, 2), dtype=wp.float64, device="cpu"), int(self.chooses)
        state.points, state.good = (wp.zeros(1, dtype=wp.int32, device="cpu") for _ in range(2))
        if wp.get_device(problem.device).is_cpu:
            state.inputs = problem.inputs
        turned = problem.turned if problem.may_jump else slice(0, 0)
        state.turned, state.most_turn = wp.vec2i(turned.start, turned.stop), TURN
        state.weights = wp.zeros((0, 0), dtype=wp.float64, device="cpu")
        state.most_change, state.most_growth = SAFE_LOAD, GROWTH
        state.order, state.slow, state.most_integrations = self.order, self.newton.slow, min(options.max_integrations, UNLIMITED)
        self._state = state
        self._past, self._last_inputs = state.past.numpy(), state.last_inputs.numpy()
        self._points, self._good, self._misses = state.points.numpy(), state.good.numpy(), state.misses.numpy()
        self._sample: tuple[Any, Any] | None = None  # the launch of a sample, and what it calls
        self._active: NDArray[Any] | None = problem.buffer("active") if wp.get_device(problem.device).is_cpu else None
        self.inputs: FloatArray | None = None  # those of the last good sample
        self._states = LastStates(options, problem)  # of what was found by these
        self.known, self.all_known = np.zeros(problem.instance_count, dtype=bool), False  # by a good sample, or a guess
        # where branches are near: what came there by an event
        self.fresh, self._any_fresh = np.zeros(problem.instance_count, dtype=bool), False
        # where a branch ended at a sample that cannot tell yet whether it is stable
        self.edge = np.zeros(problem.instance_count, dtype=bool)
        self._taut = np.zeros(problem.instance_count, dtype=bool)  # at this sample, which neither follows nor is followed
        self._span: float | None = None  # of time, between the last samples

    @property
    def last(self) -> FloatArray:
        """Unknowns of the last good samples, shape (instance_count, n)."""
        return np.asarray(self._past[:, 0])

    def start(self, unknowns: FloatArray) -> None:
        """Take ``unknowns`` as the sample before the first, of instances whose row is not NaN."""
        self.known = knows(self.problem, unknowns)
        self.all_known = bool(self.known.all())
        self._states.start(self.known)
        self._past[:, 0], self._points[0] = np.where(self.known[:, None], unknowns, self.problem.guess()), 1

    def pace(self, before: float, after: float) -> None:
        """Have the last samples as far apart as the next is from them; one much farther is not foretold."""
        points, ratio = int(self._points[0]), 1.0 if self._span is None else before / self._span
        self._span = before
        if points > 1 and ratio > FAR:
            self._points[0] = 1
        elif points > 1 and ratio != 1.0:
            self._past[:] = respaced(self._past, points, ratio)

    def step(self) -> Outcome:
        """Extrapolate, iterate to the tolerance, and make sure of the branch."""
        if self._active is None:
            with self.problem.everyone():
                return self._step()
        before = self._active.copy()  # by hand: a context takes a tenth of a rod's sample
        try:
            return self._step()
        finally:
            self._active[:] = before

    def _step(self) -> Outcome:
        problem, newton = self.problem, self.newton
        self._forget_taut()
        calm = self.all_known and not self._states
        if calm and self.inputs is not None and not self._any_fresh and (calls := newton.calls()) is not None:
            if self._sample is None or self._sample[0] is not calls:
                self._state.weights = wp.array(self._weights(), dtype=wp.float64, device="cpu")
                self._sample = calls, newton.repeating(calls, self._state)
            problem.heed_stop()
            newton.give_up_wild(True)
            self._sample[1].launch()
            if not self._good[0]:
                newton.go_on()  # where it was not at its end
            newton.give_up_wild(False)
            if self._good[0]:
                return newton.outcome()
            return self._made_sure(newton.outcome(), None, self.known)
        first, going = None, self.known
        if not calm:
            if not self._points[0]:
                self._past[:, 0], self._points[0] = problem.guess(), 1
            first, begun = self._begun()
            going = self.known & ~begun
            if not going.any():
                return self._made_sure(first, first, going) if self.known.any() else self._keep(first)
        guess = self._foreseen()
        if first is not None:
            guess = np.where(going[:, None], guess, problem.read("unknowns"))
        problem.write("unknowns", guess)
        newton.allow(self.options.max_integrations)
        newton.give_up_wild(self.inputs is not None)
        newton.run(None if first is None else going)
        newton.give_up_wild(False)
        outcome = newton.outcome()
        if first is not None:
            outcome.status[~going] = first.status[~going]
            outcome.iterations = first.iterations + np.where(going, outcome.iterations, 0)
            outcome.integrations = first.integrations + np.where(going, outcome.integrations, 0)
            outcome.breakpoints, outcome.events = first.breakpoints, first.events
        return self._made_sure(outcome, first, going)

    def _begun(self) -> tuple[Outcome, BoolArray]:
        """The sample of what was found by its states, from these, and without a guess of what has no unknowns to begin with; and
        of which that is all that can be done, shape (instance_count,)."""
        outcome, found = self._states.resume(self.last)
        found |= self._states.go_on(~self.known & ~found, self.newton, outcome, self.last)
        new = ~self.known & ~found
        if new.any():
            again = ColdStart(self.options, self.problem, self.newton, new).run()
            outcome.end_with(again, new)
            outcome.reached = again.reached
            outcome.breakpoints |= again.breakpoints
            outcome.events |= again.events
            for k in np.flatnonzero(self._states.elsewhere(new, outcome)).tolist():
                outcome.status[k] = Status.BRANCH_END
                outcome.events.pop(k, None)
        return outcome, found | new

    def _foreseen(self) -> FloatArray:
        """Unknowns by extrapolation of the last samples, shape (instance_count, n)."""
        points = int(self._points[0])
        guess = extrapolated(self._past, points)
        if not self.chooses or points <= 2:
            return guess
        less = self._misses[:, 0] < self._misses[:, 1]
        return np.where(less[:, None], extrapolated(self._past, 2), guess)

    def _learn(self, found: FloatArray, good: BoolArray, new: BoolArray) -> None:
        """How far each order missed what was found, of instances that are ``good``; ``new`` ones have no past."""
        if self.chooses:
            for k in range(int(self._points[0]) - 1):
                miss = np.abs(found - extrapolated(self._past, k + 2)).max(axis=1)
                self._misses[good, k] = np.maximum(miss, FORGOTTEN * self._misses[:, k])[good]
            self._misses[new] = 0.0

    def _forget_taut(self) -> None:
        """What is taut is solved without a guess, as is what comes after it."""
        if not self.problem.may_be_taut:
            return
        self._taut = self.problem.taut()
        if self._taut.any():
            self.known &= ~self._taut
            self.fresh &= ~self._taut
            self.all_known = False

    def _made_sure(self, outcome: Outcome, first: Outcome | None, going: BoolArray) -> Outcome:
        """What may have left its branch, of those that Newton's method was ``going`` with, is solved again, and the sample is
        kept."""
        problem, newton = self.problem, self.newton
        far, turned = self._far()
        fresh, edge = bool(self.fresh.any()), self.edge.copy()
        if self.inputs is not None and (newton.doubtful() or first is not None or far is not None or fresh or edge.any()):
            doubtful = ((outcome.status != _CONVERGED) | newton.strayed()) & going
            doubtful &= ~passed_kinks(problem, newton, doubtful & (outcome.status == _CONVERGED), self.last)
            if far is not None:
                doubtful |= far & going
            calm, own = ~doubtful, problem.read("unknowns") if fresh else None
            doubtful |= self.fresh & going
            beyond = doubtful & problem.out_of_reach()  # where no way leads
            outcome.status[beyond] = Status.OUT_OF_REACH
            doubtful &= ~beyond
            doubtful &= ~self._by_states(doubtful if turned is None else doubtful & ~turned, outcome, self.inputs)
            if doubtful.any():
                self._continue(doubtful, outcome, self.inputs)
            if own is not None:
                # where both lead to the same, branches are no longer near
                self.fresh &= ~(calm & np.isclose(own, problem.read("unknowns"), rtol=SAME, atol=SAME).all(axis=1))
            if edge.any():
                self._leave_edge(edge & ~self._states.turning & (outcome.status == _CONVERGED), outcome, self.inputs)
            self._begin_anew(outcome, self.inputs)
        return self._keep(outcome)

    def _by_states(self, doubtful: BoolArray, outcome: Outcome, before: FloatArray) -> BoolArray:
        """Solve those again, from the states of the last good sample, whose base alone hardly leads to their tips. Which were
        found, shape (instance_count,)."""
        lost = doubtful & (~self.fresh | self._states.turning)
        if not lost.any() or self.problem.segments is None:
            return np.zeros_like(lost)
        lost &= np.linalg.norm(self.newton.reference(), axis=1) > NOISY
        again, found = self._states.rescue(lost, self.last, before)
        outcome.status[found] = again.status[found]
        outcome.iterations += again.iterations
        outcome.integrations += again.integrations
        outcome.breakpoints |= again.breakpoints
        return found

    def _far(self) -> tuple[BoolArray | None, BoolArray | None]:
        """Which instances were turned too far for one step since the last good sample, or loaded otherwise, and which turned;
        None if none was."""
        changed = self._changed(self.inputs)
        if self.inputs is None or not self.problem.may_jump or not (turned := self.problem.turning(self.inputs) > TURN).any():
            return changed, None
        return turned if changed is None else turned | changed, turned

    def _changed(self, before: FloatArray | None) -> BoolArray | None:
        """Of which instances loads differ from those of inputs ``before`` by so much that modes may have vanished in pairs; None
        if of none."""
        if before is None or not (change := self.problem.load_change(before)).max(initial=0.0) > SAFE_LOAD:
            return None
        changed = unsafe(self.problem, change)
        return changed if changed.any() else None

    def _weights(self) -> FloatArray:
        """How large a load is one of each input, by which ``load_change`` is no more than (instance_count, input_count)."""
        inputs = self.problem.read("inputs")
        every = np.eye(inputs.shape[1])
        weights = [self.problem.load_change(inputs - one) for one in every]
        return np.stack(weights, axis=1) if np.any(weights) else np.zeros((0, 0))

    def _continue(self, doubtful: BoolArray, outcome: Outcome, before: FloatArray) -> None:
        """Solve the doubtful instances again, from the last good sample, in steps of the inputs."""
        self.problem.reasons(np.zeros_like(outcome.status))  # what was so before is not why
        paths = Paths(self.problem, self.newton, self.options.max_continuation_steps)
        last = self.last.copy(), self.newton.reference()
        ways = Ways(paths, self.newton, before, last[0], self.options.max_integrations)
        kinked = doubtful & at_kinks(self.problem, last[0])
        if kinked.any():  # where a path would end in ever shorter steps
            doubtful = doubtful & ~found_let_out(self.problem, ways, outcome, kinked)
            if not doubtful.any():
                return
        calm, ahead = doubtful & (outcome.status == _CONVERGED), self.problem.read("unknowns")
        self.newton.allow(outcome.left_of(self.options.max_integrations))
        safe = np.where(self.fresh, FRESH, 1.0)
        again = paths.change_inputs(doubtful, before, *last, safe_step=safe)
        self._take_in(doubtful, again, outcome)
        reached, ends = again.reached, self.problem.read("unknowns")
        short = bent(paths, again, calm, ahead, ends) | (falls := passed_unstable(self.problem, paths, outcome, doubtful))
        stuck = doubtful & failures(again.status)
        if len(self.problem.kinks) and stuck.any() and (stuck := stuck & paths.at_kink()).any():
            # Gamma jumps there however short the steps are
            self.newton.allow(outcome.left_of(self.options.max_integrations))
            self._take_in(stuck, paths.change_inputs(stuck, before, *last, dip=DIP), outcome)
            if len(self.problem.kink_inputs) and (stuck := stuck & failures(outcome.status)).any():
                found_let_out(self.problem, ways, outcome, stuck)
        # where many modes are soft, steps may become small just before one vanishes
        stalled = doubtful & (outcome.status == Status.STALLED)
        over = stalled | (doubtful & np.isin(outcome.status, ENDED))
        if over.any():
            assert reached is not None  # by every path
            go_on(self.options, self.problem, self.newton, outcome, over, reached, ends, before=before)
            outcome.status[stalled & (outcome.status == Status.BRANCH_END)] = Status.STALLED
            self.edge |= over & (outcome.status == _CONVERGED)
        if short.any():
            self._straighten(short, outcome, before, last[0], safe)
            outcome.status[falls & (outcome.status == _CONVERGED)] = Status.BRANCH_END

    def _straighten(self, short: BoolArray, outcome: Outcome, before: FloatArray, last: FloatArray, safe: FloatArray) -> None:
        """Let those that went round a bend in ``short`` steps leave where a branch ends there by finer equations."""
        self.newton.allow(outcome.left_of(self.options.max_integrations))
        most = self.options.max_continuation_steps
        lost, reached, ends = ended(self.problem, self.newton, outcome, short, before, last, safe, most)
        if lost.any():
            outcome.status[lost] = Status.BRANCH_END
            go_on(self.options, self.problem, self.newton, outcome, lost, reached, ends, before=before, times=FINER)
            if self.options.at_fold != "stop":
                outcome.status[lost & failures(outcome.status)] = _CONVERGED  # what was found stays

    def _leave_edge(self, chosen: BoolArray, outcome: Outcome, before: FloatArray) -> None:
        """Go on from where modes vanished at a sample before, once that has told: what is unstable now is left, what is stable
        is so as ever."""
        places, parts = np.flatnonzero(chosen), self.problem.parts
        if not len(places) or parts is None:
            return
        lowest = modes_of(parts.of(places)).eigenvalue(0)
        outcome.integrations[places] += 1
        self.edge[places[lowest > SOFT]] = False
        lost = np.zeros_like(chosen)
        lost[places[lowest < -SOFT]] = True
        left, ends = lost.copy(), self.problem.read("unknowns")
        # from where modes vanished; or else from where it is now
        for begin, part in ((self.last.copy(), 0.0), (ends, JUST_THERE)):
            if not left.any():
                break
            self.problem.write("unknowns", ends)
            go_on(self.options, self.problem, self.newton, outcome, left, np.full(len(left), part), begin, before=before)
            left &= failures(outcome.status)
        self.edge &= ~lost | failures(outcome.status)

    def _begin_anew(self, outcome: Outcome, before: FloatArray) -> None:
        """Solve without a guess what failed and is turned at no cost otherwise than at the last good sample, as between balls
        where a load begins or ends to act: there it was, or may be, anywhere around."""
        problem, newton = self.problem, self.newton
        failed = self.known & failures(outcome.status)
        if self.options.at_fold == "stop" or not failed.any() or (now := problem.free_turns()) is None:
            return
        asked = problem.read("inputs")
        problem.write("inputs", before)
        then = problem.free_turns()
        problem.write("inputs", asked)
        failed &= now != then
        if failed.any():
            again = ColdStart(self.options, problem, newton, failed).run()
            self._take_in(failed, again, outcome)
            outcome.breakpoints |= again.breakpoints
            outcome.events |= again.events
            self.known &= ~failed
            self.all_known = False

    @staticmethod
    def _take_in(chosen: BoolArray, again: Outcome, outcome: Outcome) -> None:
        outcome.status[chosen] = again.status[chosen]
        outcome.iterations += again.iterations
        outcome.integrations += again.integrations
        outcome.reached = again.reached

    def _keep(self, outcome: Outcome) -> Outcome:
        found, inputs = self.problem.read("unknowns"), self.problem.read("inputs")
        past = self._past
        if self.all_known and (outcome.status == _CONVERGED).all():
            self._learn(found, np.ones_like(self.known), np.zeros_like(self.known))
            past[:] = shifted(past, found)
            self._last_inputs[:] = inputs
            self._states.keep(outcome, inputs)
            self.newton.set_reference()
        else:
            # of what is known by its breakpoints only, the unknowns alone cannot start the next sample
            good = ~failures(outcome.status)
            if not good.all():
                outcome.status[:] = self.problem.reasons(outcome.status)
            good[list(outcome.breakpoints)] = False
            # what failed starts again from its last equilibrium, what is new from its first, both without a slope
            elsewhere = np.isin(outcome.status, (Status.BIFURCATED, Status.SNAPPED, Status.DAMPED))
            self.fresh |= elsewhere
            kept, new = good[:, None], (good & (elsewhere | ~self.known))[:, None]
            self._learn(found, good, new[:, 0])
            last = past[:, 0].copy()
            for k, point in enumerate(np.moveaxis(shifted(past, found), 1, 0)):
                past[:, k] = np.where(new, found, np.where(kept, point, last))
            self._last_inputs[:] = inputs if self.inputs is None else np.where(kept, inputs, self.inputs)
            self.newton.set_reference(good)
            self.known |= good
            self.known[list(outcome.breakpoints)] = False
            self.known &= ~self._taut
            self.all_known = bool(self.known.all())
            self._states.keep(outcome, inputs)
        self._points[0] = min(self._points[0] + 1, self.order + 1)
        self.inputs = self._last_inputs
        self._any_fresh = bool(self.fresh.any() or self.edge.any())
        return outcome
