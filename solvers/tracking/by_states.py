"""Samples of a motion that begin at the last one's states at breakpoints, where unknowns alone lead nowhere: along, soft rods."""

from typing import TYPE_CHECKING

import numpy as np

from multirod.batch import IntArray
from multirod.problem import BoundaryProblem
from multirod.segments import Breakpoints, placed, taken
from multirod.solver import Outcome
from multirod.solvers.following.onward import go_on, in_segments
from multirod.solvers.multiple_shooting import NOISY, MultipleShooting
from multirod.solvers.newton.iteration import Newton
from multirod.solvers.segments.by_inputs import ATTEMPT, change_inputs, good, states_of
from multirod.status import BoolArray, Status, failures
from multirod.validation import FloatArray

if TYPE_CHECKING:
    from multirod.solvers.shooting import Shooting


SAME = 1e-3  # of the unknowns: what steps err by otherwise is less, another branch more
LITTLE = 1.0  # change of loads [EI/L^2], from which on Newton's method is often lost where Gamma is large


class LastStates:
    """Of the instances of a motion whose last sample was found by states, by their numbers.

    Args:
        options: Whose motion it is.
        problem: At the inputs of each sample.
    """

    def __init__(self, options: "Shooting", problem: BoundaryProblem) -> None:
        self._options, self._problem = options, problem
        self._points: dict[int, Breakpoints] = {}
        self._alone: set[int] = set()  # of these, which unknowns do not lead to
        self._now: dict[int, Breakpoints] = {}  # of this sample, so far
        self._inputs: FloatArray = np.zeros((0, 0))
        self._guess: dict[int, Breakpoints] = {}  # what is known of the first sample
        # of which symmetry left a mode neutral at an event, and those of them whose unknowns hardly lead to their tips
        self._turns, self.turning = np.zeros((2, problem.instance_count), dtype=bool)

    def __bool__(self) -> bool:
        """Whether any is to begin so, or was found so in this sample so far."""
        return bool(self._now or self._guess or self._due())

    def _due(self) -> dict[int, Breakpoints]:
        """Those of the last sample that this one is to begin at: where unknowns lead there too, Newton's method takes a third of
        the integrations from these, each a fiftieth of the time, unless loads have changed by more than a little."""
        if not self._points or self._alone.issuperset(self._points):
            return self._points
        jumped = self._problem.load_change(self._inputs) > LITTLE
        return {k: own for k, own in self._points.items() if jumped[k] or k in self._alone}

    def start(self, known: BoolArray) -> None:
        """Take what the problem's guess is known by, of instances that are ``known``, (instance_count,)."""
        points, self._problem.breakpoints = self._problem.breakpoints, {}
        self._guess = {k: own for k, own in points.items() if known[k]}

    def keep(self, outcome: Outcome, inputs: FloatArray) -> None:
        """Those of a sample at ``inputs`` (instance_count, k) that its unknowns cannot be followed from."""
        self._turns[list(outcome.turning)] = True
        known = outcome.breakpoints | self._now
        if known or self._turns.any():
            size = np.linalg.norm(self._problem.read("gamma"), axis=1)
            sensitive, self.turning = size > NOISY, self._turns & ~(size <= NOISY)
            lost = failures(outcome.status)
            known = {k: own for k, own in known.items() if not lost[k] and (sensitive[k] or k in outcome.breakpoints)}
        self._points, self._now, self._inputs, self._alone = known, {}, inputs, set(outcome.breakpoints)

    def resume(self, unknowns: FloatArray) -> tuple[Outcome, BoolArray]:
        """The next sample of all that are known so, in the problem's buffers, and which were found, (instance_count,): what is
        led off its branch is not. A first sample is that of the guess, whose ``unknowns`` (instance_count, n) these are."""
        if not self._guess:
            return self._on(self._due(), self._inputs)
        guess, self._guess = self._guess, {}
        outcome, found = self._none()
        if (method := self._method()) is not None:
            places = np.array(sorted(guess))
            part, left = self._part(places), np.full(len(places), min(self._options.max_integrations, ATTEMPT))
            mine, points = method.resume(part, unknowns[places], taken(guess, places), left)
            some = np.flatnonzero(good(mine.status))
            self._problem.keep(part, places[some], some)
            outcome.status[places], outcome.iterations[places] = mine.status, mine.iterations
            outcome.integrations[places] = mine.integrations
            outcome.breakpoints |= placed(taken(mine.breakpoints, some), places[some])
            self._now |= placed(taken(points, some), places[some])
            found[places[some]] = True
        return outcome, found

    def go_on(self, lost: BoolArray, newton: Newton, outcome: Outcome, unknowns: FloatArray) -> BoolArray:
        """Let those that are ``lost`` go on over the end of their branch from the last sample, where its states alone tell of
        them; which did, (instance_count,).

        Args:
            lost: Shape (instance_count,).
            newton: The motion's iteration.
            outcome: Of this sample so far.
            unknowns: Of the last one where these are known, (instance_count, n).
        """
        mine, ends = np.zeros_like(lost), unknowns.copy()
        for k, own in self._points.items():
            mine[k], ends[k] = lost[k], own.unknowns
        if not mine.any():
            return mine
        outcome.status[mine] = Status.BRANCH_END
        go_on(self._options, self._problem, newton, outcome, mine, np.zeros(len(mine)), ends, before=self._inputs)
        return mine & ~failures(outcome.status)

    def elsewhere(self, new: BoolArray, outcome: Outcome) -> BoolArray:
        """Which of those that are ``new``, (instance_count,), as their last sample's states led nowhere, lead back to elsewhere
        than these: without a guess another branch was found than that they were on."""
        result = np.zeros_like(new)
        places = np.array([k for k in self._points if new[k] and not failures(outcome.status)[k]], dtype=int)
        if not len(places) or (method := self._method()) is None:
            return result
        problem, now, kept = self._problem, self._problem.read("inputs"), self._problem.snapshot()
        found = states_of(method, problem, places, problem.read("unknowns")[places], now) | outcome.breakpoints
        problem.write("inputs", self._inputs)
        try:
            allowed = outcome.left_of(self._options.max_integrations)
            back, points = change_inputs(method, problem, {k: found[k] for k in places.tolist() if k in found}, now, allowed)
        finally:
            problem.write("inputs", now)
            problem.restore(kept)
        outcome.iterations += back.iterations
        outcome.integrations += back.integrations
        for k, own in points.items():
            last = self._points[k].unknowns
            result[k] = np.linalg.norm(own.unknowns - last) > SAME * (1 + np.linalg.norm(last))
        return result

    def rescue(self, lost: BoolArray, unknowns: FloatArray, before: FloatArray) -> tuple[Outcome, BoolArray]:
        """The same of some that are ``lost``, from the last sample's ``unknowns`` (instance_count, n), found at the inputs
        ``before`` (instance_count, k)."""
        places = np.flatnonzero(lost)
        if not len(places) or (method := self._method()) is None:
            return self._none()
        return self._on(states_of(method, self._problem, places, unknowns[places], before), before)

    def _on(self, last: dict[int, Breakpoints], before: FloatArray) -> tuple[Outcome, BoolArray]:
        """Some from breakpoints where they were ``last``, at the inputs ``before``, (instance_count, k)."""
        outcome, found = self._none()
        if last and (method := self._method()) is not None:
            allowed = np.full(len(found), self._options.max_integrations)
            outcome, points = change_inputs(method, self._problem, last, before, allowed)
            self._now |= points
            found[list(points)] = True
        return outcome, found

    def _method(self) -> MultipleShooting | None:
        """By segments; None where the problem has none, or they are not asked for."""
        method = in_segments(self._options)
        without = not self._options.fallback or self._problem.parts is None
        return None if without or method.unsupported(self._problem) else method

    def _part(self, places: IntArray) -> BoundaryProblem:
        """Some instances, as they are now, in double precision."""
        assert self._problem.parts is not None  # or there is no method
        return self._problem.parts.of(places, double=True)

    def _none(self) -> tuple[Outcome, BoolArray]:
        """Nothing done, and nothing found."""
        return Outcome.zeros(self._problem.instance_count), np.zeros(self._problem.instance_count, dtype=bool)
