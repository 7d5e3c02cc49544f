"""Samples of a motion that begin at the last one's states at breakpoints, where unknowns alone lead nowhere: along, soft rods."""

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np

from multirod.batch import IntArray
from multirod.problem import BoundaryProblem
from multirod.segments import Breakpoints, placed, taken
from multirod.solver import Outcome
from multirod.solvers.following.onward import in_segments
from multirod.solvers.multiple_shooting import NOISY, MultipleShooting
from multirod.status import NOT_RUN, BoolArray, failures
from multirod.validation import FloatArray

if TYPE_CHECKING:
    from multirod.solvers.shooting import Shooting

_FoundBy = Callable[[MultipleShooting, BoundaryProblem, IntArray, IntArray], tuple[Outcome, dict[int, Breakpoints]]]

ATTEMPT = 40  # integrations that this may take: it takes 10 to 20, or fails


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
        lost = failures(outcome.status)
        if known or self._turns.any():
            size = np.linalg.norm(self._problem.read("gamma"), axis=1)
            sensitive, self.turning = size > NOISY, self._turns & ~(size <= NOISY)
            known = {k: own for k, own in known.items() if not lost[k] and (sensitive[k] or k in outcome.breakpoints)}
        self._points, self._now, self._inputs = known, {}, inputs

    def resume(self, changed: Callable[[FloatArray], BoolArray | None], unknowns: FloatArray) -> tuple[Outcome, BoolArray]:
        """The next sample of all that are known so, but those whose loads have ``changed`` too much since some inputs, in the
        problem's buffers; and which were found, (instance_count,): what is led off its branch is not. A first sample is that of
        the guess, whose ``unknowns`` (instance_count, n) these are."""
        if self._guess:
            points, self._guess = self._guess, {}
            return self._from(
                np.array(sorted(points)),
                lambda method, part, places, allowed: method.resume(part, unknowns[places], taken(points, places), allowed),
            )
        far = changed(self._inputs) if self._points else None
        places = np.array([k for k in self._points if far is None or not far[k]], dtype=int)
        return self._on(places, taken(self._points, places), self._inputs)

    def rescue(self, lost: BoolArray, unknowns: FloatArray, before: FloatArray) -> tuple[Outcome, BoolArray]:
        """The same of some that are ``lost``, from the last sample's ``unknowns`` (instance_count, n), found at the inputs
        ``before`` (instance_count, k)."""
        places = np.flatnonzero(lost)
        return self._on(places, unknowns[places], before)

    def _on(self, places: IntArray, last: FloatArray | dict[int, Breakpoints], before: FloatArray) -> tuple[Outcome, BoolArray]:
        """Some, on their branches from where they were ``last``, at the inputs ``before``."""
        return self._from(places, lambda method, part, places, allowed: method.resume_branch(part, last, before[places], allowed))

    def _from(self, places: IntArray, found_by: _FoundBy) -> tuple[Outcome, BoolArray]:
        problem = self._problem
        outcome, found = Outcome.zeros(problem.instance_count), np.zeros(problem.instance_count, dtype=bool)
        method = in_segments(self._options)
        if not len(places) or problem.parts is None or method.unsupported(problem):
            return outcome, found
        part = problem.parts.of(places, double=True)
        allowed = np.full(len(places), min(self._options.max_integrations, ATTEMPT))
        mine, points = found_by(method, part, places, allowed)
        good = np.flatnonzero(~failures(mine.status) & (mine.status != NOT_RUN))
        problem.keep(part, places[good], good)
        outcome.status[places], outcome.iterations[places] = mine.status, mine.iterations
        outcome.integrations[places] = mine.integrations
        outcome.breakpoints = placed(taken(mine.breakpoints, good), places[good])
        self._now |= placed(taken(points, good), places[good])
        found[places[good]] = True
        return outcome, found
