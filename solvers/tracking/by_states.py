"""Samples of a motion that begin at the last one's states at breakpoints, where unknowns alone lead nowhere: along, soft rods."""

from typing import TYPE_CHECKING

import numpy as np

from multirod.batch import IntArray
from multirod.problem import BoundaryProblem
from multirod.segments import Breakpoints, placed, taken
from multirod.solver import Outcome
from multirod.solvers.continuation.paths import GROWTH, SAFE_LOAD
from multirod.solvers.following.onward import in_segments
from multirod.solvers.multiple_shooting import NOISY, MultipleShooting
from multirod.status import NOT_RUN, BoolArray, failures
from multirod.validation import FloatArray

if TYPE_CHECKING:
    from multirod.solvers.shooting import Shooting

ATTEMPT = 40  # integrations that a step may take: it takes 10 to 20, or fails
HALVINGS = 8  # of a step of the inputs
IN_ALL = 300  # integrations that a sample may take so: from the unloaded rod it takes as many


def unsafe(problem: BoundaryProblem, change: FloatArray) -> BoolArray:
    """Whether loads have changed by so much, (instance_count,), to what they are that modes may have vanished in pairs."""
    nothing = np.zeros_like(problem.read("inputs"))
    return np.asarray(change > np.maximum(SAFE_LOAD, GROWTH * problem.load_change(nothing)))


class LastStates:
    """Of the instances of a motion whose last sample was found by states, by their numbers.

    Args:
        options: Whose motion it is.
        problem: At the inputs of each sample.
    """

    def __init__(self, options: "Shooting", problem: BoundaryProblem) -> None:
        self._options, self._problem = options, problem
        self._points: dict[int, Breakpoints] = {}
        self._now: dict[int, Breakpoints] = {}  # of this sample, so far
        self._inputs: FloatArray = np.zeros((0, 0))
        self._guess: dict[int, Breakpoints] = {}  # what is known of the first sample
        # of which symmetry left a mode neutral at an event, and those of them whose unknowns hardly lead to their tips
        self._turns, self.turning = np.zeros((2, problem.instance_count), dtype=bool)

    def __bool__(self) -> bool:
        """Whether any is, of the last sample or of this one so far."""
        return bool(self._points or self._now or self._guess)

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
        self._points, self._now, self._inputs = known, {}, inputs

    def resume(self, unknowns: FloatArray) -> tuple[Outcome, BoolArray]:
        """The next sample of all that are known so, in the problem's buffers, and which were found, (instance_count,): what is
        led off its branch is not. A first sample is that of the guess, whose ``unknowns`` (instance_count, n) these are."""
        if not self._guess:
            return self._on(self._points, self._inputs)
        guess, self._guess = self._guess, {}
        outcome, found = self._none()
        if (method := self._method()) is not None:
            places = np.array(sorted(guess))
            part, left = self._part(places), np.full(len(places), min(self._options.max_integrations, ATTEMPT))
            mine, points = method.resume(part, unknowns[places], taken(guess, places), left)
            self._take(places, part, mine, points, outcome, found)
        return outcome, found

    def rescue(self, lost: BoolArray, unknowns: FloatArray, before: FloatArray) -> tuple[Outcome, BoolArray]:
        """The same of some that are ``lost``, from the last sample's ``unknowns`` (instance_count, n), found at the inputs
        ``before`` (instance_count, k)."""
        places, now = np.flatnonzero(lost), self._problem.read("inputs")
        if not len(places) or (method := self._method()) is None:
            return self._none()
        self._problem.write("inputs", before)
        part = self._part(places)
        part.write("unknowns", unknowns[places])
        last = placed(method.states(part, np.arange(len(places))), places)
        self._problem.write("inputs", now)
        return self._on(last, before)

    def _on(self, last: dict[int, Breakpoints], before: FloatArray) -> tuple[Outcome, BoolArray]:
        """Some, on their branches from where they were ``last``, at the inputs ``before``, by steps of the inputs in which no two
        modes vanish, and which are halved where they lead nowhere."""
        problem = self._problem
        outcome, found = self._none()
        if not last or (method := self._method()) is None:
            return outcome, found
        places, now, here = np.array(list(last)), problem.read("inputs"), before.copy()
        most, halved = min(self._options.max_integrations, IN_ALL), np.zeros(problem.instance_count)
        try:
            while len(places):
                share = self._share(here, now) * 0.5**halved
                ahead = np.where(share[:, None] < 1, here + share[:, None] * (now - here), now)
                problem.write("inputs", ahead)
                part = self._part(places)
                left = np.minimum(most - outcome.integrations[places], ATTEMPT)
                mine, points = method.resume_branch(part, taken(last, places), here[places], left)
                good, there = _good(mine), share[places] == 1
                self._take(places, part, mine, points, outcome, found, there)
                last |= placed(taken(points, np.flatnonzero(good)), places[good])
                here[places[good]] = ahead[places[good]]
                halved[places] = np.where(good, np.maximum(halved[places] - 1, 0), halved[places] + 1)
                goes_on = (halved[places] <= HALVINGS) & (outcome.integrations[places] < most)
                places = places[np.where(good, ~there, goes_on)]
        finally:
            problem.write("inputs", now)
        return outcome, found

    def _share(self, here: FloatArray, now: FloatArray) -> FloatArray:
        """How much of the way between two inputs (instance_count, k) is one step, shape (instance_count,)."""
        problem, share = self._problem, np.ones(len(now))
        problem.write("inputs", now)
        change = problem.load_change(here)
        for _ in range(HALVINGS):
            far = unsafe(problem, share * change)
            if not far.any():
                break
            share[far] *= 0.5
            problem.write("inputs", here + share[:, None] * (now - here))
        return share

    def _method(self) -> MultipleShooting | None:
        """By segments; None where the problem has none."""
        method = in_segments(self._options)
        return None if self._problem.parts is None or method.unsupported(self._problem) else method

    def _part(self, places: IntArray) -> BoundaryProblem:
        """Some instances, as they are now, in double precision."""
        assert self._problem.parts is not None  # or there is no method
        return self._problem.parts.of(places, double=True)

    def _none(self) -> tuple[Outcome, BoolArray]:
        """Nothing done, and nothing found."""
        return Outcome.zeros(self._problem.instance_count), np.zeros(self._problem.instance_count, dtype=bool)

    def _take(
        self,
        places: IntArray,
        part: BoundaryProblem,
        mine: Outcome,
        points: dict[int, Breakpoints],
        outcome: Outcome,
        found: BoolArray,
        there: BoolArray | None = None,
    ) -> None:
        """Take over what a part of the problem found of the instances at ``places``, where it is ``there``."""
        good = np.flatnonzero(_good(mine) if there is None else _good(mine) & there)
        self._problem.keep(part, places[good], good)
        outcome.status[places] = mine.status
        outcome.iterations[places] += mine.iterations
        outcome.integrations[places] += mine.integrations
        outcome.breakpoints |= placed(taken(mine.breakpoints, good), places[good])
        self._now |= placed(taken(points, good), places[good])
        found[places[good]] = True


def _good(outcome: Outcome) -> BoolArray:
    """Which instances were found, and on their branches."""
    return np.asarray(~failures(outcome.status) & (outcome.status != NOT_RUN))
