"""One instance of multiple shooting: its breakpoints, Newton's method on its states, and its way along the natural branch.

Numbers in parentheses are those of ``docs/solvers.md``.
"""

from collections.abc import Generator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from multirod.integrators import Integrator
from multirod.segment_system import System
from multirod.segments import Breakpoints, Propagation, Request, Segments
from multirod.solvers.continuation.acceptance import CONTRACTION, MIN_STEP, SURPRISE, same_branch_in_segments
from multirod.status import Fault, Status
from multirod.validation import FloatArray

PACE = 100  # steps over which it is told
HOPELESS = 5.0  # times the steps that are left: more than that is given up
SAFE_LOAD = 5.0  # first step, in F L^2/EI
LOAD_RATIO = 0.5  # later steps, relative to the load reached
ROUNDING = 1e-11  # Newton steps no longer than this, relative to the unknowns, are rounding
GROWTH = 100.0  # most by which a segment may amplify a variation
FEWEST_STEPS = 4  # of a segment
MOST_STEPS = 128
MOST_SEGMENTS = 20_000
MOST_ROUNDS = 10
COLUMN_ERROR = 1e-6  # of a segment's transition, relative
COUNTED_AS_ONE = 128  # segments integrated
LEAST_PART = 1e-6  # of a Newton step
PROBE = 1e-4  # step in the load, relative to the present, by which the tangent is found

Run = Generator[Request, Propagation, Any]


@dataclass
class Result:
    """How one instance ended.

    Attributes:
        status: A value of ``Status``.
        points: The last equilibrium.
        found: Where its segments lead; None where there is no result.
        residual: Largest gap [1/m].
        level: Part of the load that was reached.
    """

    status: Status
    points: Breakpoints
    found: Propagation | None = None
    residual: float = np.nan
    level: float = 0.0


class Spent(Exception):
    """An instance has taken the integrations that it may."""


class SegmentedPath:
    """One instance on its way. What integrates is a generator: it yields segments, and is sent where they lead.

    So many instances, each with breakpoints and steps of its own, share every launch (``run_together``).

    Args:
        segments: Of the problem.
        instance: Of the problem.
        tolerance: Largest gap [1/m].
        max_iterations: Newton iterations allowed at one load.
        max_steps: Load steps allowed.
        max_integrations: Integrations of the whole rod allowed, in all.
        integrator: Of the spatial equations.
    """

    def __init__(
        self,
        segments: Segments,
        instance: int,
        *,
        tolerance: float,
        max_iterations: int,
        max_steps: int,
        max_integrations: int,
        integrator: Integrator,
    ) -> None:
        self.segments = segments
        self.instance = instance
        self.tolerance = tolerance
        self.max_iterations = max_iterations
        self.max_steps = max_steps
        self.max_integrations = max_integrations
        self.integrator = integrator
        self.iterations = 0
        self.integrations = 0
        self.level = 0.0  # part of the load that was reached
        self.contraction = 0.0
        self.fault = 0
        self.stalled = False

    # ---- evaluation ----

    def evaluate(self, points: Breakpoints, level: float) -> Run:
        """All segments, once."""
        found = yield from self._ask(Request.all_of(self.instance, points, level))
        self.fault = found.fault
        return found

    def _ask(self, request: Request) -> Run:
        """Where segments lead; ``Spent`` where that would be one integration too many."""
        if self.integrations >= self.max_integrations:
            raise Spent
        # more segments than that are more steps than an integration from base to tip takes
        self.integrations += max(1, len(request.start) // COUNTED_AS_ONE)
        found = yield request
        return found

    def _bounded(self, run: Run, unknowns: FloatArray) -> Run:
        """What a run returns, or that it had to be given up."""
        try:
            result = yield from run
        except Spent:
            return Result(Status.INTEGRATION_LIMIT, self.start(unknowns), level=self.level)
        return result

    def gaps(self, points: Breakpoints, found: Propagation) -> FloatArray:
        """(1) What segments and boundary conditions lack; NaN where an integration failed."""
        if found.fault:
            return np.full(self.segments.variation_size * (len(points.states) - 1) + len(found.residual), np.nan)
        inner = self.segments.difference(self.instance, found.end[:-1], points.states[1:])
        return np.concatenate([inner.ravel(), found.residual])

    def moved(self, points: Breakpoints, step: FloatArray) -> Breakpoints:
        """Breakpoints led on by a step of all unknowns."""
        n, d = len(points.unknowns), self.segments.variation_size
        unknowns = points.unknowns + step[:n]
        states = points.states.copy()
        states[0] = self.segments.base_state(self.instance, unknowns)
        if len(states) > 1:
            states[1:] = self.segments.moved(self.instance, states[1:], step[n:].reshape(-1, d))
        return replace(points, states=states, unknowns=unknowns)

    def distance(self, points: Breakpoints, other: Breakpoints) -> float:
        """Root mean square distance of the states [1/m]."""
        return float(np.sqrt(np.mean(self.segments.difference(self.instance, points.states, other.states) ** 2)))

    # ---- Newton's method ----

    def linearised(self, points: Breakpoints, found: Propagation) -> tuple[System, FloatArray | None] | None:
        """The system at these points and Newton's step from them, None within the tolerance; None where there is no step."""
        gaps = self.gaps(points, found)
        if self.fault or not np.isfinite(gaps).all():
            return None
        system = System(found, self.segments.unknown_places)
        if np.abs(gaps).max() <= self.tolerance:
            return system, None
        return None if system.singular else (system, system.solve(-gaps))

    def correct(self, points: Breakpoints, level: float) -> Run:
        """Undamped Newton steps that contract as they must: ``(points, found, system)``, None where they do not."""
        last = np.inf
        self.contraction = 0.0
        self.stalled = False
        for _ in range(self.max_iterations):
            found = yield from self.evaluate(points, level)
            linear = self.linearised(points, found)
            if linear is None:
                return None
            system, step = linear
            if step is None:
                return points, found, system
            size = float(np.linalg.norm(step))
            if size > CONTRACTION * last:
                self.stalled = size <= ROUNDING * (1 + float(np.abs(points.unknowns).max())) * np.sqrt(len(step))
                return None
            self.contraction = max(self.contraction, size / last)
            last = size
            points = self.moved(points, step)
            self.iterations += 1
        return None

    def descend(self, points: Breakpoints, found: Propagation) -> Run:
        """Newton steps, halved until the next one would be shorter: ``(points, found, system)``, or None."""
        for _ in range(self.max_iterations):
            linear = self.linearised(points, found)
            if linear is None:
                return None
            system, step = linear
            if step is None:
                return points, found, system
            part = 1.0
            self.iterations += 1
            while True:
                trial = self.moved(points, part * step)
                ahead = yield from self.evaluate(trial, 1.0)
                shorter = np.linalg.norm(system.solve(-self.gaps(trial, ahead))) <= (1 - part / 4) * np.linalg.norm(step)
                if shorter and not self.fault:
                    break
                part /= 2
                if part < LEAST_PART:
                    return None
            points, found = trial, ahead
        return None

    def tangent(self, points: Breakpoints, found: Propagation, level: float, safe: float) -> Run:
        """The system here, and the rate of all unknowns with the load; ``safe`` is a level that changes little."""
        h = PROBE * max(level, min(1.0, safe))
        ahead = yield from self.evaluate(points, level + h)
        system = System(found, self.segments.unknown_places)
        if self.fault or system.singular:
            return system, np.zeros(system.size)
        return system, system.solve(-(self.gaps(points, ahead) - self.gaps(points, found)) / h)

    # ---- breakpoints ----

    def refine(self, points: Breakpoints, found: Propagation, level: float) -> Run:
        """Shorten the steps until they are short enough, then halve segments that amplify too much, until none does.

        Returns ``(points, found)``.
        """
        while True:
            coarse = yield from self._coarse(points, found, level)
            if coarse.any():
                points = replace(points, steps=np.where(coarse, 2 * points.steps, points.steps))
            else:
                long = (self.segments.growth(found) > GROWTH) | (points.steps > MOST_STEPS)
                if self.fault or not long.any():
                    return points, found
                if len(long) > MOST_SEGMENTS:
                    self.fault = Fault.STEP_LIMIT
                    return points, found
                half = points.halves(self.instance, long, level)
                led = yield from self._ask(half)
                points = points.halved(long, half, led.end)
            found = yield from self.evaluate(points, level)

    def settle(self, points: Breakpoints, level: float) -> Run:
        """Refine and correct by turns until nothing changes: ``(points, found)``, None where that fails."""
        for _ in range(MOST_ROUNDS):
            reached = yield from self.correct(points, level)
            if reached is None:
                return None
            points, found = yield from self.refine(reached[0], reached[1], level)
            if self.fault:
                return None
            if points is reached[0]:
                return points, found
        return None

    def _coarse(self, points: Breakpoints, found: Propagation, level: float) -> Run:
        """Which segments are integrated in steps too long: twice as many lead elsewhere, or vary otherwise."""
        integrator = self.integrator
        if not integrator.adaptive:
            return np.zeros(len(points.steps), dtype=bool)
        fine = yield from self.evaluate(replace(points, steps=2 * points.steps), level)
        scale = points.arclength[-1]
        gap = np.abs(self.segments.difference(self.instance, fine.end, found.end)).max(axis=1)
        size = 1 / scale + np.abs(self.segments.difference(self.instance, found.end, points.states)).max()
        norm = np.linalg.norm(fine.transition, axis=(1, 2))
        missed = np.linalg.norm(fine.transition - found.transition, axis=(1, 2))
        return (gap > integrator.atol / scale + integrator.rtol * size) | (missed > COLUMN_ERROR * norm)

    def start(self, unknowns: FloatArray) -> Breakpoints:
        """One segment from the base to the tip."""
        arclength = np.array([0.0, self.segments.length(self.instance)])
        steps = np.array([self.integrator.steps or FEWEST_STEPS])
        return Breakpoints(arclength, self.segments.base_state(self.instance, unknowns)[None], unknowns, steps)

    # ---- from the unloaded rod, or from a guess ----

    def follow(self, unknowns: FloatArray, scale: float, level: float = 0.0) -> Run:
        """From the equilibrium without loads, or at a level of them, to the full load, whose size against the stiffness is
        ``scale``: a ``Result``."""
        result = yield from self._bounded(self._follow(unknowns, scale, level), unknowns)
        return result

    def _follow(self, unknowns: FloatArray, scale: float, level: float) -> Run:
        points = self.start(unknowns)
        found = yield from self.evaluate(points, level)
        points, found = yield from self.refine(points, found, level)
        settled = None if self.fault else (yield from self.settle(points, level))
        if settled is None:
            return Result(self._why(Status.STALLED), points, level=level)
        points, found = settled
        step = 1.0
        system, tangent = yield from self.tangent(points, found, level, SAFE_LOAD / scale)
        passed: list[float] = []
        for done in range(self.max_steps):
            if level >= 1.0 or (done >= PACE and self._hopeless(passed[-PACE], level, self.max_steps - done)):
                break
            passed.append(level)
            goal = min(1.0, level + min(step, max(SAFE_LOAD / scale, LOAD_RATIO * level)))
            taken = goal - level
            expected = self.moved(points, taken * tangent)
            reached = yield from self.correct(expected, goal)
            if reached is not None and self._on_branch(system, reached, points, expected):
                level = self.level = goal
                points, found = yield from self.refine(reached[0], reached[1], level)
                if self.fault:
                    return Result(self._why(Status.STALLED), points, level=level)
                if level < 1.0:
                    system, tangent = yield from self.tangent(points, found, level, SAFE_LOAD / scale)
                step = taken * min(3.0, max(0.5, (0.5 * CONTRACTION / max(self.contraction, 1e-6)) ** 0.5))
            else:
                step = 0.5 * taken
                if step < MIN_STEP * min(1.0, max(level, SAFE_LOAD / scale)):
                    return Result(self._why(Status.BRANCH_END), points, level=level)
        if level < 1.0:
            return Result(Status.MAX_ITERATIONS, points, level=level)
        result = yield from self._settled(points, level)
        return result

    @staticmethod
    def _hopeless(before: float, level: float, left: int) -> bool:
        """Whether the steps that are left lead nowhere near the full load, at the pace since the level ``PACE`` steps before."""
        if level <= before:
            return True
        steps = (1.0 - level) / (level - before)
        if before > 0.0:
            steps = min(steps, np.log(1.0 / level) / np.log(level / before))
        return PACE * steps > HOPELESS * left

    def _on_branch(self, system: System, reached: Any, points: Breakpoints, expected: Breakpoints) -> bool:
        """Whether an equilibrium is on the branch of the last: ``J`` stays itself, and no surprise."""
        found_at, _, after = reached
        if not same_branch_in_segments(system, after):
            return False
        missed, moved = self.distance(found_at, expected), self.distance(found_at, points)
        return missed <= SURPRISE * moved + 1e-6 * (1 + float(np.abs(found_at.unknowns).max()))

    def solve_from(self, unknowns: FloatArray) -> Run:
        """Damped Newton at the full load, from the states that integration from the base leads to: a ``Result``."""
        result = yield from self._bounded(self._solve_from(unknowns), unknowns)
        return result

    def _solve_from(self, unknowns: FloatArray) -> Run:
        points = self.start(unknowns)
        found = yield from self.evaluate(points, 1.0)
        points, found = yield from self.refine(points, found, 1.0)
        reached = yield from self.descend(points, found)
        if reached is None:
            return Result(self._why(Status.STALLED), self.start(unknowns), level=1.0)
        result = yield from self._settled(reached[0], 1.0)
        return result

    def resume(self, points: Breakpoints, before: System) -> Run:
        """Damped Newton at the full load from the last equilibrium under other loads: a ``Result``, or None off its branch."""
        result = yield from self._bounded(self._resume(points, before), points.unknowns)
        return result

    def _resume(self, points: Breakpoints, before: System) -> Run:
        found = yield from self.evaluate(points, 1.0)
        reached = yield from self.descend(points, found)
        if reached is None or not same_branch_in_segments(before, reached[2]):
            return None
        result = yield from self._settled(reached[0], 1.0)
        return result if not result.status.failed else None

    def _settled(self, points: Breakpoints, level: float) -> Run:
        settled = yield from self.settle(points, level)
        if settled is None:
            return Result(self._why(Status.STALLED), points, level=level)
        points, found = settled
        return Result(Status.MULTIPLE_SHOOTING, points, found, float(np.abs(self.gaps(points, found)).max()), level)

    def _why(self, otherwise: Status) -> Status:
        if self.stalled and not self.fault:
            return Status.STALLED
        return Fault(self.fault).status if self.fault else otherwise


def run_together(segments: Segments, runs: dict[int, Run]) -> dict[int, Any]:
    """What the generators of several instances return; each launch integrates what all of them ask for."""
    results: dict[int, Any] = {}
    asked: dict[int, Request] = {}

    def advance(instance: int, found: Propagation | None) -> None:
        try:
            asked[instance] = next(runs[instance]) if found is None else runs[instance].send(found)
        except StopIteration as ended:
            asked.pop(instance, None)
            results[instance] = ended.value

    for instance in runs:
        advance(instance, None)
    while asked:
        instances = list(asked)
        for instance, found in zip(instances, segments.propagate(list(asked.values())), strict=True):
            advance(instance, found)
    return results
