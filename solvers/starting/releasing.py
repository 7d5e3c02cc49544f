"""What inputs hold somewhere, let go: from where it rests, to where its inputs hold it, by changing these.

Numbers are those of ``docs/parallel.md``.
"""

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from multirod.capabilities import Released
from multirod.problem import BoundaryProblem
from multirod.solver import Outcome
from multirod.solvers.continuation.paths import Paths
from multirod.solvers.newton.iteration import Newton
from multirod.solvers.newton.refinement import refine
from multirod.status import BoolArray, IntArray, Status, failures
from multirod.validation import FloatArray

if TYPE_CHECKING:
    from multirod.solvers.shooting import Shooting

AT_REST = 2000  # integrations in which an assembly that was let go is to come to rest; 25 to 500 are usual, six with clamps
SCATTERED = 16  # places more at which it is let go, where the first leads nowhere
AT_REST_SCATTERED = 300  # the same of each of these: many, of which most come to rest so
TOGETHER = 32  # instances whose places are looked at at once


class Releasing:
    """How instances of a problem begin from where they rest while nothing holds them.

    Args:
        options: Whose.
        problem: At the inputs in question.
        newton: Its iteration.
        outcome: How they ended so far: it is added to.
    """

    def __init__(self, options: "Shooting", problem: BoundaryProblem, newton: Newton, outcome: Outcome) -> None:
        self._options, self._problem, self._newton, self._outcome = options, problem, newton, outcome

    @property
    def _allowed(self) -> IntArray:
        return self._outcome.left_of(self._options.max_integrations)

    def begin(self, lost: BoolArray) -> None:
        """(10c) From where each of those ``lost`` rests."""
        places = np.flatnonzero(lost & (self._allowed > 0))
        released = self._problem.released(places) if len(places) else None
        if released is None:
            return
        rests, spent = self._rest(self._options, released, min(int(self._allowed[places].min()), AT_REST))
        self._count(places, spent)
        if rests.any():
            self._led(places[rests], *(values[rests] for values in released.held()[:2]))

    def begin_scattered(self, lost: BoolArray) -> None:
        """(10d) The same from several places, the nearest to the inputs first, until what that leads to passes the test of
        results; of what may still take as many integrations as that."""
        places = np.flatnonzero(lost & (self._allowed > SCATTERED * AT_REST_SCATTERED))
        for some in np.split(places, range(TOGETHER, len(places), TOGETHER)):
            rows, numbers = np.repeat(some, SCATTERED), np.tile(np.arange(1, SCATTERED + 1), len(some))
            released = self._problem.released(rows, numbers) if len(some) else None
            if released is not None:
                self._led_from_any(some, rows, released)

    def _led_from_any(self, places: IntArray, rows: IntArray, released: Released) -> None:
        """The same of the instances ``places`` (k,), that were ``released`` as ``rows`` (k * SCATTERED,)."""
        problem, outcome = self._problem, self._outcome
        rests, spent = self._rest(replace(self._options, at_fold="stop", fallback=False), released, AT_REST_SCATTERED)
        self._count(rows, spent)
        before, begun, far = (values.reshape(len(places), SCATTERED, -1) for values in released.held())
        away = np.where(rests.reshape(len(places), SCATTERED), far[..., 0], np.inf)
        order = np.argsort(away, axis=1, kind="stable")
        open_, unknowns, statuses = np.ones(len(places), dtype=bool), problem.read("unknowns"), outcome.status[places].copy()
        for taken in order.T:
            own = np.flatnonzero(open_ & np.isfinite(away[np.arange(len(places)), taken]) & (self._allowed[places] > 0))
            if len(own):
                outcome.status[places[own]] = statuses[own]
                self._led(places[own], before[own, taken[own]], begun[own, taken[own]])
                open_[own] = ~self._fit(places[own])
        outcome.status[places[open_]] = statuses[open_]
        found = problem.read("unknowns")
        found[places[open_]] = unknowns[places[open_]]
        problem.write("unknowns", found)

    def _fit(self, places: IntArray) -> BoolArray:
        """Which of these were found, and pass the test of results."""
        problem, outcome = self._problem, self._outcome
        found = np.zeros(problem.instance_count, dtype=bool)
        found[places] = ~failures(outcome.status[places])
        if problem.result_test is not None and found.any():
            with problem.only(found):
                problem.integrate()
            outcome.integrations += found * (1 + problem.result_test.integrations)
            found &= problem.result_test.refusals(found) == int(Status.NOT_RUN)
        return np.asarray(found[places])

    def _rest(self, options: "Shooting", released: Released, most: int) -> tuple[BoolArray, Outcome]:
        """Which of what was let go come to rest, and what that took."""
        free = replace(options, max_integrations=most)._solve(released.problem, None)
        rests = ~failures(free.status)
        rests[list(free.breakpoints)] = False  # unknowns alone do not lead to these
        return rests, free

    def _count(self, places: IntArray, spent: Outcome) -> None:
        np.add.at(self._outcome.iterations, places, spent.iterations)
        np.add.at(self._outcome.integrations, places, spent.integrations)

    def _led(self, places: IntArray, before: FloatArray, begun: FloatArray) -> None:
        """From equilibria at inputs ``before`` (k, input_count), whose unknowns are ``begun`` (k, n), to those asked for."""
        problem, newton, outcome = self._problem, self._newton, self._outcome
        some = np.zeros(problem.instance_count, dtype=bool)
        some[places] = True
        asked, unknowns = problem.read("inputs"), problem.read("unknowns")
        at, from_ = asked.copy(), unknowns.copy()
        at[places], from_[places] = before, begun
        problem.write("inputs", at)
        with problem.only(some):
            gamma = problem.evaluate(from_)[1]
        problem.write("inputs", asked)
        newton.allow(np.maximum(self._allowed - 1, 0))
        led = Paths(problem, newton, self._options.max_continuation_steps).change_inputs(some, at, from_, gamma)
        outcome.iterations += led.iterations
        outcome.integrations += led.integrations + some
        there = some & ~failures(led.status)
        problem.write("unknowns", np.where(there[:, None], problem.read("unknowns"), unknowns))
        outcome.status[there] = Status.CONVERGED
        newton.allow(self._allowed)
        refine(problem, newton, outcome, there)
