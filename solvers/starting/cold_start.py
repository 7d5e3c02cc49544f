"""A solve without a guess: along the natural branch, and from where that ends early by the other ways, one after the other."""

from contextlib import AbstractContextManager, nullcontext
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from multirod.capabilities import Parts
from multirod.problem import DOUBLE_ROUNDING, BoundaryProblem
from multirod.solver import Left, Outcome
from multirod.solvers.continuation.natural import let_go, natural_branch
from multirod.solvers.continuation.pace import ROUNDED_OFF, UNASKED
from multirod.solvers.following.follow import ENDED
from multirod.solvers.following.onward import go_on, in_segments
from multirod.solvers.following.serving.requests import EDGES
from multirod.solvers.newton.iteration import Newton
from multirod.solvers.newton.refinement import refine
from multirod.solvers.starting.assembling import Closed, assemble
from multirod.solvers.starting.judging import amplifies, falling
from multirod.solvers.starting.letting_out import let_out, let_out_first, near_the_end
from multirod.solvers.starting.multistart import lowest_stable, refuse_unstable
from multirod.solvers.starting.releasing import Releasing
from multirod.solvers.starting.standing_in import Eased, solve_stand_ins
from multirod.stand_in import StandIn
from multirod.status import BoolArray, IntArray, Status, failures
from multirod.validation import FloatArray

if TYPE_CHECKING:
    from multirod.solvers.shooting import Shooting

# by which a loose network may end that no other way led to a result
WITHOUT_REASON = (Status.STALLED, Status.BRANCH_END, Status.SINGULAR_JACOBIAN, Status.INTEGRATION_LIMIT, Status.MAX_ITERATIONS)
MANY = 32  # integrations on a natural branch: what goes round where two modes vanish takes 44 to 95
LARGEST = 700.0  # exponent of a number
TURNING = 1500  # integrations in which rest is looked for elsewhere, once going down in energy turned or slid on and on
# of each instance, beside its outcome, where loads could not be raised further
KNOWN = ("handed", "tried", "ends", "unbounded", "slack", "eased", "most")


class ColdStart:
    """Instances of a problem on the way from no guess to an equilibrium: ``raise_loads`` first, then ``go_on``.

    Args:
        options: Whose.
        problem: At the inputs in question.
        newton: Its iteration.
        chosen: Which instances are meant, shape (instance_count,); all by default.
        poses_apart: Whether what looks for equilibria leaves out the poses of tips.

    Attributes:
        outcome: How they ended, so far.
        handed: Which crept, and are handed over to segments.
        tried: How segments ended, of those that are not to be tried by these; ``NOT_RUN`` of the others.
        ends: Unknowns where the natural branch ended [1/m].
        unbounded: Which are beside a line at its kink whose tension rises without bound.
        slack: Which are at the full load in a valley, and not at rest.
        eased: Which were tried as what twists a little more.
        edges: Where going down in energy leads to no state of those whose branch ended: why, values of ``Status``; ``NOT_RUN`` of
            the others.
        most: Integrations allowed of each.
    """

    def __init__(
        self,
        options: "Shooting",
        problem: BoundaryProblem,
        newton: Newton,
        chosen: BoolArray | None = None,
        *,
        poses_apart: bool = False,
    ) -> None:
        self.options, self.problem, self.newton, self.poses_apart = options, problem, newton, poses_apart
        count = problem.instance_count
        self.chosen = np.ones(count, dtype=bool) if chosen is None else chosen
        self.outcome = Outcome.zeros(count)
        self.handed, self.unbounded, self.slack, self.eased = np.zeros((4, count), dtype=bool)
        self.tried: IntArray = np.full(count, int(Status.NOT_RUN))
        self.edges, self.most = self.tried.copy(), np.full(count, options.max_integrations)
        self.ends: FloatArray = np.zeros((count, problem.unknown_count))

    def run(self) -> Outcome:
        """The end of the natural branch, by one of two ways where there are two, or where it ends early and others are meant, the
        lowest stable one."""
        beyond = self.chosen & self.problem.out_of_reach()
        if beyond.any():
            return self._within_reach(beyond)
        self.raise_loads()
        return self.go_on()

    @property
    def lost(self) -> BoolArray:
        """Which have no result yet."""
        return np.asarray(self.chosen & failures(self.outcome.status))

    def left(self) -> Left:
        """Those that have none, for ``resume``."""
        numbers = np.flatnonzero(self.lost)
        known = self.outcome.arrays | {name: getattr(self, name) for name in KNOWN}
        return Left(numbers, self.problem.snapshot()[numbers], {name: values[numbers] for name, values in known.items()})

    def resume(self, left: Left) -> Outcome:
        """All ways but the first, of instances that were ``left`` where loads could not be raised further."""
        self.problem.restore(left.records)
        known: dict[str, Any] = {name: np.array(values) for name, values in left.known.items()}
        for name in KNOWN:
            setattr(self, name, known.pop(name))
        self.outcome = Outcome(**known)
        return self.go_on()

    def raise_loads(self) -> None:
        """To where the natural branch leads."""
        problem, newton = self.problem, self.newton
        if problem.stability is not None and not problem.stability.guess_is_stable:
            problem.stability.expect()  # as what is found is judged
        with self._searching():
            newton.allow(self.options.max_integrations)
            handed, steps = self.handed if self.options.fallback else None, self.options.max_continuation_steps
            first = let_out_first(problem, newton, self.chosen, self._natural)
            others = self.chosen & (first.status != Status.CONVERGED)
            self.outcome = outcome = natural_branch(problem, newton, steps, others, handed)
            outcome.integrations += first.integrations
            outcome.iterations += first.iterations
            self.ends = problem.read("unknowns")
            self._leave_unstable(outcome)
            if not outcome.all_converged:
                self._note_ends(outcome)
            newton.allow(self._allowed)
            refine(problem, newton, outcome, self.chosen)
            self.slack = let_go(problem, newton, outcome, self.chosen)
            if not outcome.all_converged:
                self._let_out()
            refuse_unstable(problem, outcome, self.chosen)

    def _leave_unstable(self, outcome: Outcome) -> None:
        """Have those followed from where loads are raised that came in many steps to what is unstable, as past modes that vanish
        together where errors of the integration turn ``Gamma``: equal steps, which err less, end there."""
        some = self.chosen & ~failures(outcome.status) & (outcome.integrations > MANY)
        if self._multistable or self.problem.joints is not None or outcome.reached is None or not some.any():
            return
        if (lost := falling(self.problem, outcome, some)).any():
            outcome.status[lost], outcome.reached[lost] = Status.BRANCH_END, 0.0
            self.ends[lost] = self.problem.guess()[lost]

    def _note_ends(self, outcome: Outcome) -> None:
        """Which crept, and which are not to be tried by other ways, as the natural branch says."""
        if self.options.fallback and outcome.reached is not None:
            self.handed |= self.chosen & (outcome.status == int(Status.MAX_ITERATIONS)) & (outcome.reached > 0)
        self._ease(self.chosen & (outcome.status == int(Status.UNDETERMINED)))  # loads may bend it, which determines it
        for status in (Status.UNDETERMINED, Status.LOOSE):  # from wherever
            known = outcome.status == int(status)
            self.chosen = self.chosen & ~known
            self.tried[known] = status

    def go_on(self) -> Outcome:
        """From where the natural branch ended before the full load, by each way that is open to what has no result yet."""
        if not self.lost.any():
            return self.outcome
        if self.options.fallback and self.problem.rounding > DOUBLE_ROUNDING and self.problem.parts is not None:
            return self._in_double(self.problem.parts)
        self._leave_beyond_rounding()
        crept = self.lost & self.handed
        with self._searching():
            self._released().begin(self.lost & np.isin(self.outcome.status, WITHOUT_REASON))
            self._ease(self.lost & ((self._reached == 0) | (self.problem.joints is None)))
            self.handed &= self.lost
            self._put_together(self.lost & ~crept)
        # the poses that it finds are not those of the unknowns: nothing may integrate these again
        if self.handed.any() and self.outcome.reached is not None:
            self._hand_over()
            self._put_together(self.lost & crept)
        if self.options.fallback and failures(self.outcome.status).any():
            in_segments(self.options).rescue(self.problem, self.outcome, self._allowed, self.tried)
        self._follow()
        self._ease(self.lost)
        self._begin_anywhere()
        self._say_why()
        return self.outcome

    def _searching(self) -> AbstractContextManager[None]:
        return self.problem.without_poses() if self.poses_apart else nullcontext()

    @property
    def _reached(self) -> FloatArray:
        """Where the natural branch ended, nowhere if there was none, shape (instance_count,)."""
        reached = self.outcome.reached
        return np.zeros(len(self.chosen)) if reached is None else reached

    @property
    def _allowed(self) -> IntArray:
        return self.outcome.left_of(self.most)

    @property
    def _multistable(self) -> bool:
        stability = self.problem.stability
        return stability is not None and stability.multistable

    def _within_reach(self, beyond: BoolArray) -> Outcome:
        """``run`` of a part, where the others, ``beyond``, cannot have a result: nothing is integrated for these."""
        problem, outcome = self.problem, self.outcome
        outcome.status[beyond] = Status.OUT_OF_REACH
        places = np.flatnonzero(self.chosen & ~beyond)
        if len(places):
            assert problem.parts is not None  # what knows its reach offers parts
            part = problem.parts.of(places)
            self._take(places, part, ColdStart(self.options, part, self.newton.of(part, places)).run())
        return outcome

    def _in_double(self, parts: Parts) -> Outcome:
        """What has no result yet anew: rounding of single precision may have ended its branch, and hides others."""
        places = np.flatnonzero(self.lost)
        part = parts.of(places, double=True)
        newton = self.newton.of(part, places)
        newton.allow(self._allowed[places])
        self._take(places, part, ColdStart(self.options, part, newton).run())
        return self.outcome

    def _take(self, places: NDArray[np.intp], part: BoundaryProblem, found: Outcome) -> None:
        """What was found of some instances by a ``part`` of the problem."""
        outcome = self.outcome
        outcome.status[places] = found.status
        outcome.iterations[places] += found.iterations
        outcome.integrations[places] += found.integrations
        outcome.events |= {int(places[k]): events for k, events in found.events.items()}
        outcome.breakpoints |= {int(places[k]): points for k, points in found.breakpoints.items()}
        self.problem.keep(part, places)

    def _natural(self, some: BoolArray) -> Outcome:
        return natural_branch(self.problem, self.newton, self.options.max_continuation_steps, some)

    def _let_out(self) -> None:
        """What ended beside a line at its kink, from where lines are longer."""
        problem, newton, outcome = self.problem, self.newton, self.outcome
        at_end = near_the_end(problem, outcome, self.chosen)
        if not at_end.any():
            return
        newton.allow(self._allowed)
        self.unbounded = let_out(problem, newton, outcome, at_end, self._natural)
        outcome.status[self.unbounded] = Status.LINES_TOO_SHORT  # no fold or bifurcation to be followed

    def _leave_beyond_rounding(self) -> None:
        """What no way by integrations from the base leads to, as rounding there is far beyond the tolerance where rods end."""
        if self.problem.segments is not None or not self.lost.any():
            return
        growth = np.exp(np.minimum(self.problem.least_growth(), LARGEST))
        noise = np.finfo(float).eps * growth * np.abs(self.ends).max(axis=1)
        beyond = self.lost & (noise > ROUNDED_OFF * self.newton.tolerance())
        self.outcome.status[beyond] = self.tried[beyond] = Status.STALLED
        self.chosen = self.chosen & ~beyond

    def _released(self) -> Releasing:
        return Releasing(self.options, self.problem, self.newton, self.outcome)

    def _begin_anywhere(self) -> None:
        """What inputs hold, from several places where it would rest."""
        if self.options.at_fold != "stop":
            some = np.isin(self.outcome.status, (*WITHOUT_REASON, Status.NONFINITE, *EDGES))
            self._released().begin_scattered(self.lost & some)

    def _ease(self, some: BoolArray) -> None:
        """What hardly twists, or does not, of ``some``, by what twists a little more; once."""
        some = some & ~self.eased
        self.eased |= some

        def eased(place: int) -> StandIn | None:
            return Eased.of(self.problem, place)

        solve_stand_ins(self.options, self.problem, self.newton, self.outcome, some, eased, self.options.at_fold)
        self.chosen = self.chosen & ~(some & (self.outcome.status == int(Status.UNDETERMINED)))

    def _put_together(self, some: BoolArray) -> None:
        """By joints that close, and where several stable equilibria are meant, to the lowest one, of ``some`` that are lost."""
        if not some.any():
            return
        problem, newton, outcome, steps = self.problem, self.newton, self.outcome, self.options.max_continuation_steps
        further = None if self.options.at_fold == "stop" else self._follow_part
        newton.allow(self._allowed)
        closed: Closed = {}
        ended = assemble(problem, newton, outcome, some, steps, further, closed=closed)
        self._note_edges()
        pulled = {place: unknowns for place, (_, _, unknowns) in closed.items()}

        def cut(place: int) -> StandIn | None:
            return problem.stand_in(place, pulled[place]) if place in pulled else None

        def in_pieces(at_fold: str) -> None:
            stopped = ended & (self.options.at_fold == "stop")
            solve_stand_ins(self.options, problem, newton, outcome, some & self.lost & ~stopped, cut, at_fold)

        in_pieces("stop")
        if further is None:
            outcome.status[ended] = Status.BRANCH_END
            self.chosen = self.chosen & ~ended
        if outcome.reached is not None and self._multistable:
            self._go_on(some & self.chosen & (outcome.status == Status.BRANCH_END))
        if further is None:
            return

        def by_closing() -> None:
            open_ = np.zeros_like(ended)
            open_[[place for place, (status, *_) in closed.items() if status.failed]] = True
            assemble(problem, newton, outcome, some & self.lost & open_, steps, further, closed=closed, closing=True)
            in_pieces("follow")

        def from_several_places() -> None:
            lowest_stable(problem, newton, outcome, some & self.lost, steps, further, self.options.sign)

        # what has no clamps may snap within its legs as joints close, to wherever
        told = problem.parts is not None and problem.parts.all_clamped
        for way in (by_closing, from_several_places) if told else (from_several_places, by_closing):
            newton.allow(self._allowed)
            way()
            self._note_edges()

    def _follow_part(self, problem: BoundaryProblem, newton: Newton, outcome: Outcome) -> None:
        """From where a branch ended in a part of all that one solve does, or from an unstable state that it led to."""
        lost, reached = np.isin(outcome.status, (*ENDED, Status.STALLED, Status.UNSTABLE)), outcome.reached
        if lost.any() and reached is not None:
            left = np.maximum(newton.allowed() - outcome.integrations, 0)
            go_on(self.options, problem, newton, outcome, lost, reached, problem.read("unknowns"), left=left, thorough=True)

    def _go_on(self, lost: BoolArray) -> None:
        assert self.outcome.reached is not None  # or no branch ended
        own = self.options, self.problem, self.newton, self.outcome
        go_on(*own, lost, self.outcome.reached, self.ends, left=self._allowed, slack=self.slack)
        self._note_edges()

    def _note_edges(self) -> None:
        there = np.isin(self.outcome.status, EDGES)
        self.edges[there] = self.outcome.status[there]
        few = np.minimum(self.most, self.outcome.integrations + TURNING)
        self.most = np.where(self.outcome.status == int(Status.LOOSE), few, self.most)

    def _hand_over(self) -> None:
        """Let segments go on where shooting crept; where they come to an end, shooting follows the branch to there too."""
        problem, outcome, reached, ends = self.problem, self.outcome, self.outcome.reached, self.ends
        assert reached is not None  # of what crept
        starts = {k: (ends[k], float(reached[k]), 0) for k in np.flatnonzero(self.handed).tolist()}
        self.tried = tried = in_segments(self.options).go_on(problem, outcome, starts, self._allowed)
        decided = np.isin(tried, (Status.BRANCH_END, Status.MAX_ITERATIONS, Status.INTEGRATION_LIMIT))
        outcome.status[decided] = tried[decided]
        tried[failures(tried) & ~decided] = Status.NOT_RUN  # from there: it may still be found from the unloaded rod
        places = np.flatnonzero(tried == Status.BRANCH_END)
        if not len(places):
            return
        assert problem.parts is not None  # or nothing is handed over
        part = problem.parts.of(places)
        newton, everyone = self.newton.of(part, places), np.ones(len(places), dtype=bool)
        newton.allow(self._allowed[places])
        # that there is an end is known: a way to it is not given up for its pace
        again = natural_branch(part, newton, min(self.options.max_continuation_steps, UNASKED))
        assert again.reached is not None
        reached[places], ends[places] = again.reached, part.read("unknowns")
        newton.allow(np.maximum(self._allowed[places] - again.integrations, 0))
        refine(part, newton, again, everyone)
        self.slack[places] = let_go(part, newton, again, everyone)
        self._take(places, part, again)

    def _follow(self) -> None:
        """Where branches end, but for what creeps in segments too: that is given up, unless a soft mode makes it creep."""
        outcome, reached = self.outcome, self.outcome.reached
        if reached is None:
            return
        lost = self.chosen & np.isin(outcome.status, ENDED)
        creeping = lost & (self.tried == int(Status.MAX_ITERATIONS))
        if creeping.any():
            outcome.integrations += creeping
            lost &= ~amplifies(self.problem, creeping, self.ends, reached)
        if not self._multistable:
            self._go_on(lost)

    def _say_why(self) -> None:
        """Why there is no result, where that is known."""
        outcome = self.outcome
        outcome.status[self.unbounded & failures(outcome.status)] = Status.LINES_TOO_SHORT
        lost = np.isin(outcome.status, WITHOUT_REASON)
        said = lost & (self.edges != int(Status.NOT_RUN))
        outcome.status[said] = self.edges[said]
        lost &= ~said
        if lost.any():
            outcome.status[lost & self.problem.is_loose()] = Status.LOOSE
