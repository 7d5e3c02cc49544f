"""Multiple shooting of several instances: their breakpoints, and Newton's method on their states.

Each launch integrates for all that are meant, and nothing of one instance depends on the others. Numbers in parentheses are those
of ``docs/solvers.md``.
"""

from dataclasses import replace
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from multirod.batch import IntArray
from multirod.integrators import Integrator
from multirod.segments import Cuts, Propagation, Segments
from multirod.solvers.continuation.acceptance import CONTRACTION
from multirod.solvers.segments.band import Room, Step, Systems
from multirod.solvers.segments.neutral import Neutral
from multirod.solvers.segments.place import Place
from multirod.status import BoolArray, Fault
from multirod.validation import FloatArray

ROUNDING = 1e-11  # Newton steps no longer than this, relative to the unknowns, are rounding
GROWTH = 100.0  # most by which a segment may amplify a variation
FAR = 5.0  # the same where loads change at once: beyond some 25 what they change by is no start any more
FEWEST_STEPS = 4  # of a segment
MOST_STEPS = 128
MOST_EQUAL = 8192  # of a segment too, if they are equal
MOST_SEGMENTS = 20_000
MOST_ROUNDS = 10
COLUMN_ERROR = 1e-6  # of a segment's transition, relative
COUNTED_AS_ONE = 192  # segments integrated, or Jacobians of so many compared
LEAST_PART = 1e-6  # of a Newton step
PROBE = 1e-4  # step in the load, relative to the present, by which the tangent is found
SPENT = -1  # in place of a fault: an instance has taken the integrations that it may


class SegmentedEquilibria:
    """Equilibria of some instances at levels of their loads, found by launches that they share.

    Args:
        segments: Of the problem.
        instances: Of the problem, those meant, shape (count,).
        tolerance: Largest gap [1/m], shape (count,).
        max_iterations: Newton iterations allowed at one load.
        max_steps: Load steps allowed.
        allowed: Integrations of the whole rod allowed, in all, shape (count,).
        integrator: Of the spatial equations.

    Attributes:
        iterations: Newton's, shape (count,).
        integrations: Shape (count,).
    """

    def __init__(
        self,
        segments: Segments,
        instances: NDArray[np.integer[Any]],
        *,
        tolerance: FloatArray,
        max_iterations: int,
        max_steps: int,
        allowed: NDArray[np.integer[Any]],
        integrator: Integrator,
    ) -> None:
        self.segments, self.integrator = segments, integrator
        self.instances = np.asarray(instances, dtype=np.intp)
        self.tolerance, self.allowed = tolerance, allowed
        self.max_iterations, self.max_steps = max_iterations, max_steps
        count = len(self.instances)
        self.iterations, self.integrations = np.zeros((2, count), dtype=int)
        self._contraction = np.zeros(count)
        self._fault = np.zeros(count, dtype=int)
        self._stalled, self._spent = np.zeros((2, count), dtype=bool)
        self._numbers = np.full(int(self.instances.max(initial=-1)) + 1, -1)
        self._numbers[self.instances] = np.arange(count)
        self._rooms: dict[tuple[int, ...], Room] = {}
        self._last: Systems | None = None
        self.neutral: Neutral | None = None  # along what no step of any instance goes

    def of(self, instances: IntArray, tolerance: FloatArray, allowed: IntArray) -> Self:
        """The same of some instances."""
        return type(self)(
            self.segments,
            instances,
            tolerance=tolerance,
            max_iterations=self.max_iterations,
            max_steps=self.max_steps,
            allowed=allowed,
            integrator=self.integrator,
        )

    # ---- evaluation ----

    def _of(self, cuts: Cuts) -> IntArray:
        """Which of all instances those of ``cuts`` are."""
        return np.asarray(self._numbers[cuts.instances])

    def evaluate(self, cuts: Cuts, level: FloatArray, *, columns: bool = True) -> Place:
        """All segments, once; each instance's at a level of the load, (count,); whether what varies is asked for too."""
        found = self._ask(cuts, level, columns=columns)
        self._fault[self._of(cuts)] = found.fault
        return Place(cuts, found)

    def _ask(self, cuts: Cuts, level: FloatArray, *, columns: bool = True) -> Propagation:
        """Where segments lead; the fault is ``SPENT`` where that would be one integration too many."""
        mine = self._of(cuts)
        able = self.integrations[mine] < self.allowed[mine]
        self._spent[mine[~able]] = True
        # more segments than that are more steps than an integration from base to tip takes
        self.integrations[mine[able]] += np.maximum(1, cuts.counts[able] // COUNTED_AS_ONE)
        if able.all():
            return self.segments.propagate(cuts, level) if columns else self.segments.lead(cuts, level)
        nothing = self._nothing(cuts)
        if not able.any():
            return nothing
        part = cuts.chosen(able)
        return nothing.put(cuts, able, part, self.segments.propagate(part, level[able]))

    def _nothing(self, cuts: Cuts) -> Propagation:
        """What is said of instances that may not be integrated any more."""
        columns, n = self.segments.variation_size + self.segments.direction_count, cuts.unknowns.shape[1]
        shapes = {
            "end": cuts.states.shape,
            "transition": (len(cuts.start), self.segments.variation_size, columns),
            "residual": cuts.unknowns.shape,
            "residual_columns": (len(cuts.instances), n, columns),
            "displacement": (len(cuts.start), 3),
            "displacement_columns": (len(cuts.start), 3, columns),
        }
        values = {name: np.full(shape, np.nan) for name, shape in shapes.items()}
        values["end"] = cuts.states
        return Propagation(**values, fault=np.full(len(cuts.instances), SPENT))

    def gaps(self, place: Place) -> Step:
        """(1) What segments and boundary conditions lack; NaN where an integration failed."""
        cuts, found = place.cuts, place.found
        inner = np.flatnonzero(cuts.inner)
        rows = np.zeros((len(cuts.start), self.segments.variation_size))
        rows[inner] = self.segments.difference(cuts.instances[cuts.owner[inner]], found.end[inner], cuts.states[inner + 1])
        own, failed = found.residual.copy(), found.fault != 0
        own[failed] = np.nan
        return Step(own, rows)

    @staticmethod
    def largest(cuts: Cuts, gaps: Step) -> FloatArray:
        """Max norm of each instance's, shape (count,)."""
        inner = np.maximum.reduceat(np.abs(gaps.rows).max(axis=1), cuts.first[:-1])
        return np.asarray(np.maximum(inner, np.abs(gaps.own).max(axis=1)))

    def moved(self, cuts: Cuts, step: Step) -> Cuts:
        """Breakpoints led on by a step of all unknowns."""
        unknowns, first = cuts.unknowns + step.own, cuts.first[:-1]
        states = self.segments.moved(cuts.instances[cuts.owner], cuts.states, step.rows)
        states[first] = self.segments.base_state(cuts.instances, unknowns)
        return replace(cuts, states=states, unknowns=unknowns)

    def distance(self, cuts: Cuts, other: Cuts) -> FloatArray:
        """Root mean square distance of the states of each instance [1/m], shape (count,)."""
        apart = self.segments.difference(cuts.instances[cuts.owner], cuts.states, other.states) ** 2
        return np.asarray(np.sqrt(np.add.reduceat(apart.mean(axis=1), cuts.first[:-1]) / cuts.counts))

    def systems(self, place: Place) -> Systems:
        """The Jacobians there."""
        last, own = self._last, self.neutral
        if last is not None and last.found is place.found and last.cuts is place.cuts and own is None:
            return last  # which may be factored already
        if own is not None:
            own = Neutral(own.right[self._of(place.cuts)], own.left[self._of(place.cuts)])
        segments = self.segments
        self._last = Systems(place.cuts, place.found, segments.unknown_places, segments.device, self._rooms, own)
        return self._last

    def rounding(self, place: Place) -> FloatArray:
        """What rounding of the unknowns leaves of the residual of an integration from base to tip [1/m], (3), shape (count,)."""
        amplified = np.abs(place.gamma(self.segments.unknown_places))
        with np.errstate(over="ignore", invalid="ignore"):
            left = (amplified * np.finfo(float).eps * np.abs(place.cuts.unknowns[:, None])).sum(axis=2).max(axis=1)
        return np.asarray(np.where(np.isnan(left), np.inf, left))

    # ---- what symmetry leaves neutral ----

    def leave_neutral(self, place: Place, modes: int) -> None:
        """Take no step along so many modes of all instances, which are neutral at these equilibria."""
        if modes:
            self.neutral = Neutral.of_gamma(place.gamma(self.segments.unknown_places), modes)
            self.turn(place)

    def turn(self, place: Place) -> None:
        """(25) Tell anew, of some instances, what is neutral."""
        if self.neutral is not None:
            some = np.zeros(len(self.instances), dtype=bool)
            some[self._of(place.cuts)] = True
            self.neutral = self.neutral.put(some, self.systems(place).turned())

    # ---- Newton's method ----

    def _linearised(self, place: Place) -> tuple[Systems, Step, BoolArray, BoolArray]:
        """The systems, Newton's steps, which instances are within the tolerance and which have a step to take."""
        gaps = self.gaps(place)
        largest = self.largest(place.cuts, gaps)
        there = largest <= self.tolerance[self._of(place.cuts)]
        systems = self.systems(place)
        sound = np.isfinite(largest) & ~there
        if not sound.any():
            return systems, gaps, there, sound
        step = systems.solve(Step(-gaps.own, -gaps.rows))
        return systems, step, there, sound & ~systems.singular

    def correct(self, cuts: Cuts, level: FloatArray, near: FloatArray | None = None) -> tuple[Place, BoolArray]:
        """Undamped Newton steps that contract as they must: the equilibria, and which are.

        Args:
            cuts: Where they start.
            level: Of the load, shape (count,).
            near: Norm of a Newton step that may be left [1/m], shape (count,); else it is the tolerance that counts.
        """
        mine = self._of(cuts)
        self._contraction[mine], self._stalled[mine] = 0.0, False
        near = np.zeros(len(mine)) if near is None else near
        result: Place | None = None
        reached = np.zeros(len(mine), dtype=bool)
        on, last = np.ones(len(mine), dtype=bool), np.full(len(mine), np.inf)
        for _ in range(self.max_iterations):
            place = self.evaluate(cuts, level[on])
            result = place if result is None else result.put(on, place)
            _, step, there, able = self._linearised(place)
            size = step.norm(cuts)
            slow = able & (size > CONTRACTION * last[on])
            if slow.any():
                rounding = ROUNDING * (1 + np.abs(cuts.unknowns).max(axis=1)) * np.sqrt(self._sizes(cuts))
                self._stalled[mine[on][slow]] = (size <= rounding)[slow]
                able &= ~slow
            numbers = mine[on][able]
            self._contraction[numbers] = np.maximum(self._contraction[numbers], size[able] / last[on][able])
            there |= able & (size <= near[on])
            able &= ~there
            reached[np.flatnonzero(on)[there]] = True
            on[np.flatnonzero(on)[~able]] = False
            if not on.any():
                break
            last[on] = size[able]
            cuts = self.moved(cuts.chosen(able), step.chosen(cuts, able))
            self.iterations[mine[on]] += 1
        assert result is not None
        return result, reached

    def _sizes(self, cuts: Cuts) -> IntArray:
        """Unknowns of each instance, states included, shape (count,)."""
        return np.asarray(cuts.unknowns.shape[1] + self.segments.variation_size * (cuts.counts - 1))

    def descend(self, place: Place) -> tuple[Place, BoolArray]:
        """Newton steps at the full load, halved until the next one would be shorter: the equilibria, and which are."""
        mine = self._of(place.cuts)
        reached = np.zeros(len(mine), dtype=bool)
        on = np.ones(len(mine), dtype=bool)
        for _ in range(self.max_iterations):
            here = place.chosen(on)
            systems, step, there, able = self._linearised(here)
            reached[np.flatnonzero(on)[there]] = True
            on[np.flatnonzero(on)[~able]] = False
            if not on.any():
                break
            here, systems, step = here.chosen(able), systems.chosen(able), step.chosen(here.cuts, able)
            self.iterations[mine[on]] += 1
            ahead, taken = self._shorter(here, systems, step)
            place = place.put(on, ahead)
            on[np.flatnonzero(on)[~taken]] = False
            if not on.any():
                break
        return place, reached

    def _shorter(self, here: Place, systems: Systems, step: Step) -> tuple[Place, BoolArray]:
        """As much of each step as makes the next one shorter: where that leads, and for which instances there is any."""
        count = len(here.cuts.instances)
        size, part = step.norm(here.cuts), np.ones(count)
        result, taken, on = here, np.zeros(count, dtype=bool), np.ones(count, dtype=bool)
        while on.any():
            own = here.cuts.chosen(on)
            trial = self.evaluate(self.moved(own, step.chosen(here.cuts, on).times(own, part[on])), np.ones(int(on.sum())))
            gaps = self.gaps(trial)
            after = systems.chosen(on).solve(Step(-gaps.own, -gaps.rows)).norm(own)
            good = (after <= (1 - part[on] / 4) * size[on]) & (trial.found.fault == 0)
            some = np.zeros(count, dtype=bool)
            some[np.flatnonzero(on)[good]] = True
            if some.any():
                result = result.put(some, trial.chosen(good))
                taken |= some
            on &= ~some
            part[on] /= 2
            on &= part >= LEAST_PART
        return result, taken

    def tangent(self, place: Place, level: FloatArray, safe: FloatArray) -> tuple[Systems, Step]:
        """The systems here, and the rate of all unknowns with the load; ``safe`` are levels that change little."""
        h = PROBE * np.maximum(level, np.minimum(1.0, safe))
        ahead, here = self.gaps(self.evaluate(place.cuts, level + h, columns=False)), self.gaps(place)
        systems = self.systems(place)
        rate = systems.solve(Step(-(ahead.own - here.own), -(ahead.rows - here.rows))).times(place.cuts, 1 / h)
        lost = (self._fault[self._of(place.cuts)] != 0) | systems.singular
        rate.own[lost], rate.rows[lost[place.cuts.owner]] = 0.0, 0.0
        return systems, rate

    # ---- breakpoints ----

    def refine(
        self,
        place: Place,
        level: FloatArray,
        checked: BoolArray | None = None,
        *,
        steps_kept: bool = False,
        most: float | None = None,
    ) -> tuple[Place, BoolArray]:
        """Shorten the steps until they are short enough, then halve segments that amplify by more than ``most``, ``GROWTH`` by
        default, until none does.

        The steps of instances that are ``checked``, (count,), are left while their segments are, and with ``steps_kept`` after
        that too. Returns the new place, and which instances have changed.
        """
        count, most = len(place.cuts.instances), GROWTH if most is None else most
        checked = np.zeros(count, dtype=bool) if checked is None else checked
        on, changed = np.ones(count, dtype=bool), np.zeros(count, dtype=bool)
        while True:
            here = place.chosen(on)
            cuts = here.cuts
            mine, owner = self._of(cuts), cuts.owner
            coarse = np.zeros(len(cuts.steps), dtype=bool)
            if (open_ := ~checked[on]).any():
                coarse[open_[owner]] = self._coarse(here.chosen(open_), level[on][open_])
            finer = np.logical_or.reduceat(coarse, cuts.first[:-1])
            long = (self.segments.growth(cuts, here.found) > most) | (cuts.steps > MOST_STEPS)
            long &= ~finer[owner] & (self._fault[mine] == 0)[owner]
            crowded = np.logical_or.reduceat(long, cuts.first[:-1]) & (cuts.counts > MOST_SEGMENTS)
            self._fault[mine[crowded]] = int(Fault.STEP_LIMIT)
            long &= ~crowded[owner]
            goes_on = finer | np.logical_or.reduceat(long, cuts.first[:-1])
            if not goes_on.any():
                return place, changed
            more = np.where(cuts.steps < MOST_EQUAL, 2 * cuts.steps, 0)  # 0: by error control
            cuts = replace(cuts, steps=np.where(coarse, more, cuts.steps))
            if long.any():
                half = cuts.halves(long)
                halving = np.isin(cuts.instances, half.instances)
                led = self._ask(half, level[on][halving])
                cuts = cuts.halved(long, half, led.end)
            on[np.flatnonzero(on)[~goes_on]] = False
            changed |= on
            checked = checked & (steps_kept | ~on)
            place = place.put(on, self.evaluate(cuts.chosen(goes_on), level[on]))

    def settle(self, cuts: Cuts, level: FloatArray) -> tuple[Place, BoolArray]:
        """Refine and correct by turns until nothing changes: the equilibria, and which are."""
        count = len(cuts.instances)
        result: Place | None = None
        settled, on = np.zeros(count, dtype=bool), np.ones(count, dtype=bool)
        for _ in range(MOST_ROUNDS):
            place, reached = self.correct(cuts, level[on])
            if reached.any():
                refined, changed = self.refine(place.chosen(reached), level[on][reached])
                place = place.put(reached, refined)
                goes_on = reached.copy()
                goes_on[reached] = changed
            else:
                goes_on = reached
            sound = self._fault[self._of(place.cuts)] == 0
            result = place if result is None else result.put(on, place)
            settled[np.flatnonzero(on)[reached & ~goes_on & sound]] = True
            goes_on = goes_on & sound
            on[np.flatnonzero(on)[~goes_on]] = False
            if not on.any():
                break
            cuts = place.cuts.chosen(goes_on)
        assert result is not None
        return result, settled

    def _coarse(self, place: Place, level: FloatArray) -> BoolArray:
        """Which segments are integrated in steps too long: twice as many lead elsewhere, or vary otherwise."""
        integrator, cuts, found = self.integrator, place.cuts, place.found
        if not integrator.adaptive:
            return np.zeros(len(cuts.steps), dtype=bool)
        fine = self.evaluate(replace(cuts, steps=2 * cuts.steps), level).found
        first, instances = cuts.first[:-1], cuts.instances[cuts.owner]
        scale = self.segments.length(cuts.instances)
        gap = np.abs(self.segments.difference(instances, fine.end, found.end)).max(axis=1)
        apart = np.abs(self.segments.difference(instances, found.end, cuts.states)).max(axis=1)
        size = 1 / scale + np.maximum.reduceat(apart, first)
        with np.errstate(over="ignore", invalid="ignore"):  # what overflows amplifies too much, and is halved
            norm = np.linalg.norm(fine.transition, axis=(1, 2))
            missed = np.linalg.norm(fine.transition - found.transition, axis=(1, 2))
        most = integrator.atol / scale + integrator.rtol * size
        return np.asarray((gap > most[cuts.owner]) | (missed > COLUMN_ERROR * norm))


def among(some: BoolArray, good: BoolArray) -> BoolArray:
    """Which of all are ``good``, (k,), among the k that ``some``, (count,), are."""
    result = some.copy()
    result[some] = good
    return result
