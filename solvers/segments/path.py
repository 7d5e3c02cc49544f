"""Multiple shooting of several instances: their ways along branches.

Numbers in parentheses are those of ``docs/solvers.md``.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Self

import numpy as np

from multirod.batch import IntArray
from multirod.segments import Breakpoints, Cuts
from multirod.solvers.continuation.acceptance import CONTRACTION, MIN_STEP, SURPRISE
from multirod.solvers.segments.band import Step, Systems
from multirod.solvers.segments.equilibria import COUNTED_AS_ONE, FEWEST_STEPS, SegmentedEquilibria, among
from multirod.solvers.segments.place import Place
from multirod.status import BoolArray, Fault, Status
from multirod.validation import FloatArray

PACE = 100  # steps over which it is told
HOPELESS = 5.0  # times the steps that are left: more than that is given up
FORESEEN = 3  # steps, of which the cheapest tells what the others will take at least
SAFE_LOAD = 5.0  # first step, in F L^2/EI
LOAD_RATIO = 1.0  # later steps, relative to the load reached
PATIENCE = 2  # halvings of a step, after which the equilibrium that it starts from is found to the tolerance
POLISH = 10  # Newton's steps by which that is found
NEAR = 1e-3  # Newton steps no longer than this, relative to the last step of the load, are left on the way
APART = 1e-3  # gap, over the length: what is lacking so little is the equilibrium that an integration from the base told
CHECKED = 1.25  # growth of the load after which the steps of segments are looked at again on the way
COMPARED_CLOSELY = 12  # times that, where a few vectors do not say that no mode vanished


@dataclass
class Results:
    """How instances ended, all of the first axis count.

    Attributes:
        status: Values of ``Status``; ``NOT_RUN`` of what is to be tried otherwise.
        place: The last equilibria.
        residual: Largest gap [1/m]; NaN where there is no result.
        level: Part of the load that was reached.
        neutral: Modes of each that are neutral all along, or of all.
    """

    status: IntArray
    place: Place
    residual: FloatArray
    level: FloatArray
    neutral: IntArray | int = 0

    def put(self, some: BoolArray, other: "Results") -> None:
        """Take over some of the instances, (count,), all that ``other`` has."""
        self.place = self.place.put(some, other.place)
        for name in ("status", "residual", "level"):
            getattr(self, name)[some] = getattr(other, name)

    def points(self) -> dict[int, Breakpoints]:
        """Breakpoints of what was found, by its place among the instances."""
        found = np.flatnonzero(self.status == Status.MULTIPLE_SHOOTING).tolist()
        modes = np.broadcast_to(self.neutral, len(self.status)).tolist()
        return {k: self.place.cuts.points(k, float(self.residual[k]), modes[k]) for k in found}


class SegmentedPaths(SegmentedEquilibria):
    """Instances on their way, which share every launch."""

    # ---- from the unloaded rod, from a guess, or from an equilibrium ----

    def follow(
        self,
        unknowns: FloatArray,
        scale: FloatArray,
        level: FloatArray | None = None,
        steps: IntArray | None = None,
        neutral: int = 0,
    ) -> Results:
        """From equilibria without loads, or at levels of them, to the full loads, whose sizes against the stiffness ``scale`` is.

        All of the first axis count; ``steps`` are those by which they were found, as ``begin`` has them, and as many modes of
        each are ``neutral`` on all the way.
        """
        count = len(self.instances)
        level = np.zeros(count) if level is None else np.array(level)
        safe = SAFE_LOAD / scale
        place = self.begin(unknowns, level, steps)
        results = Results(np.full(count, int(Status.NOT_RUN)), place, np.full(count, np.nan), level, neutral)
        on = self._end(results, self._fault == 0, Status.STALLED)
        if on.any():
            self.leave_neutral(place, neutral)
            settled, good = self.settle(results.place.cuts.chosen(on), level[on])
            results.place = results.place.put(on, settled)
            on = self._end(results, among(on, good), Status.STALLED)
        self._advance(results, on, safe)
        left = results.status == Status.NOT_RUN
        results.status[left & (level < 1.0)] = Status.MAX_ITERATIONS
        self._finish(results, left & (level >= 1.0))
        return results

    def begin(self, unknowns: FloatArray, level: FloatArray, steps: IntArray | None = None) -> Place:
        """Segments on which the rod is as an integration from the base has it, of all instances at levels of the load, (count,).

        By so many equal ``steps``, (count,), where these are given and not 0: what they err by grows along the rod as all else
        does, so that other steps would lead elsewhere from the same unknowns (count, n).
        """
        cuts = self.start(unknowns)
        given = np.zeros(len(cuts.steps), dtype=bool) if steps is None else steps > 0
        if steps is not None:
            cuts = replace(cuts, steps=np.where(given, steps, cuts.steps).astype(np.int32))
        place = self.evaluate(cuts, level)
        if given.any():
            kept, _ = self.refine(place.chosen(given), level[given], np.ones(int(given.sum()), dtype=bool), steps_kept=True)
            place = place.put(given, kept)
        return self.refine(place, level)[0]

    def closed(self, place: Place) -> Place:
        """Places at the full load, led to where segments lack little.

        Their equal steps err otherwise than those of a whole rod, and where that is amplified, modes are not those of what was
        found by these.
        """
        apart = self.largest(place.cuts, self.gaps(place)) > APART / self.segments.length(place.cuts.instances)
        if not apart.any():
            return place
        led, reached = self.descend(place.chosen(apart))
        return place.put(among(apart, reached), led.chosen(reached)) if reached.any() else place

    def start(self, unknowns: FloatArray) -> Cuts:
        """One segment from the base to the tip, of all instances."""
        count = len(self.instances)
        return Cuts(
            self.instances,
            np.arange(count + 1),
            np.zeros(count),
            self.segments.length(self.instances),
            self.segments.base_state(self.instances, unknowns),
            np.array(unknowns),
            np.full(count, self.integrator.steps or FEWEST_STEPS, dtype=np.int32),
        )

    def _end(self, results: Results, good: BoolArray, otherwise: Status) -> BoolArray:
        """End those that are not ``good``, (count,); which are on their way."""
        ended = (results.status == Status.NOT_RUN) & ~good
        if ended.any():
            results.status[ended] = self._why(ended, otherwise)
        return np.asarray(results.status == Status.NOT_RUN)

    def _advance(self, results: Results, on: BoolArray, safe: FloatArray) -> None:
        """Step by step to the full load."""
        if not on.any():
            return
        level = results.level  # of all, as they are reached
        step, passed = np.ones(len(level)), np.zeros((0, len(level)))
        taken_before = np.zeros((0, len(level)), dtype=int)
        place = results.place
        before = self.systems(place)
        count, d = len(place.cuts.start), self.segments.variation_size
        rate = bend = Step(np.zeros_like(place.cuts.unknowns), np.zeros((count, d)))
        since = np.full(len(level), np.nan)  # logarithms where the last tangents were
        checked = level.copy()  # and at which steps were
        taken_at = np.full((FORESEEN + 1, len(level)), np.nan)  # integrations taken by the last equilibria
        new = on.copy()  # whose tangents are not known yet
        halved = np.zeros(len(level), dtype=int)  # how often the present step was
        for done in range(self.max_steps):
            on = on & (level < 1.0)
            if done >= PACE:
                slow = _hopeless(passed[-PACE], level, self.max_steps - done)
                # at what a step took since then, the integrations that are left are so many steps
                each = (self.integrations - taken_before[-PACE]) / PACE
                poor = on & _hopeless(passed[-PACE], level, (self.allowed - self.integrations) / np.maximum(each, 1.0))
                self._spent |= poor & ~slow
                on &= ~slow
            costs = np.where(np.isnan(taken_at[0]), 0.0, np.diff(taken_at, axis=0).min(axis=0))
            self._spent |= on & (costs * _fewest_steps(level, safe) > self.allowed - self.integrations)
            on = self._end(results, ~(on & self._spent), Status.INTEGRATION_LIMIT) & on
            if not on.any():
                break
            if (new := new & on).any():
                here = place.chosen(new)
                self.turn(here)
                systems, own = self.tangent(here, level[new], safe[new])
                own = own.times(here.cuts, (level + safe)[new])
                change = _change(before.cuts.chosen(new), rate.chosen(before.cuts, new), here.cuts, own)
                logarithm = np.log((level + safe)[new])
                change = change.times(here.cuts, _inverse(logarithm - since[new]))
                bend, since[new] = bend.put(before.cuts, new, here.cuts, change), logarithm
                rate = rate.put(before.cuts, new, here.cuts, own)
                before = before.put(new, systems) if not new.all() else systems
            passed, taken_before = np.vstack([passed[-PACE:], level]), np.vstack([taken_before[-PACE:], self.integrations])
            goal = np.minimum(1.0, level + np.minimum(step, np.maximum(safe, LOAD_RATIO * level)))
            taken = goal - level
            here, cuts = place.chosen(on), before.cuts.chosen(on)
            along = np.log1p(taken / (level + safe))[on]
            way = rate.chosen(before.cuts, on).times(cuts, along)
            way = way.plus(bend.chosen(before.cuts, on).times(cuts, 0.5 * along**2))
            expected = self.moved(cuts, way)
            reached, good = self.correct(expected, goal[on], np.where(goal[on] < 1.0, NEAR * way.norm(cuts), 0.0))
            if good.any():
                cut = {name: value.chosen(good) for name, value in (("now", reached), ("last", here))}
                alike = before.chosen(among(on, good)).same_branch(self.systems(cut["now"]))
                compared = here.chosen(good).cuts.counts * np.where(alike, 1, COMPARED_CLOSELY)
                self.integrations[among(on, good)] += compared * d**2 // (36 * COUNTED_AS_ONE)
                good[good] = alike & self._expected(cut["now"].cuts, cut["last"].cuts, expected.chosen(good))
            new = among(on, good)
            if new.any():
                level[new] = goal[new]
                taken_at[:, new] = np.vstack([taken_at[1:, new], self.integrations[new]])
                known = level[new] < CHECKED * checked[new]
                refined, _ = self.refine(reached.chosen(good), level[new], known)
                checked[among(new, ~known)] = level[among(new, ~known)]
                place = results.place = place.put(new, refined)
                contraction = np.maximum(self._contraction[new], 1e-6)
                step[new] = taken[new] * np.minimum(3.0, np.maximum(0.5, (0.5 * CONTRACTION / contraction) ** (1 / 3)))
                on = on & self._end(results, ~new | (self._fault == 0), Status.STALLED)
            failed = on & ~new
            step[failed] = 0.5 * taken[failed]
            halved = np.where(failed, halved + 1, 0)
            if self.segments.end_held and (rough := on & (halved == PATIENCE)).any():
                polished, good = self._polished(place.chosen(rough), level[rough], before.chosen(rough))
                place = results.place = place.put(among(rough, good), polished.chosen(good))
                new |= among(rough, good)
            small = step < MIN_STEP * np.minimum(1.0, np.maximum(level, safe))
            on = on & self._end(results, ~(failed & (small | self._spent)), Status.BRANCH_END)

    def _polished(self, place: Place, level: FloatArray, before: Systems) -> tuple[Place, BoolArray]:
        """Equilibria that were known to a part of a step, found to the tolerance, and which are, (count,).

        Newton's steps need not contract: what is left of positions pulls at a rod whose end is held by its axial stiffness, so
        that the second may be longer than the first.
        """
        mine = self._of(place.cuts)
        reached, on = np.zeros(len(mine), dtype=bool), np.ones(len(mine), dtype=bool)
        for _ in range(POLISH):
            here = place.chosen(on)
            _, step, there, able = self._linearised(here)
            reached[np.flatnonzero(on)[there]] = True
            on[np.flatnonzero(on)[~able]] = False
            if not on.any():
                break
            cuts = self.moved(here.cuts.chosen(able), step.chosen(here.cuts, able))
            self.iterations[mine[on]] += 1
            place = place.put(on, self.evaluate(cuts, level[on]))
        reached &= self._fault[mine] == 0
        if reached.any():
            reached[reached] = before.chosen(reached).same_branch(self.systems(place.chosen(reached)))
        return place, reached

    def _expected(self, found: Cuts, last: Cuts, expected: Cuts) -> BoolArray:
        """Whether equilibria lie where the tangents led."""
        missed, moved = self.distance(found, expected), self.distance(found, last)
        return np.asarray(missed <= SURPRISE * moved + 1e-6 * (1 + np.abs(found.unknowns).max(axis=1)))

    def solve_from(self, unknowns: FloatArray, points: Mapping[int, Breakpoints] = MappingProxyType({})) -> Results:
        """Damped Newton at the full load, from the states that integration from the base leads to, ``unknowns`` (count, n); of
        what is known by its states at ``points``, by its place among the instances, from these."""
        full, known = np.ones(len(self.instances)), np.isin(np.arange(len(self.instances)), list(points))
        cuts = self.start(unknowns)
        if known.any():
            own = Cuts.of_points({k: replace(points[k], unknowns=unknowns[k]) for k in np.flatnonzero(known).tolist()})
            own = replace(own, instances=self.instances[known])
            cuts = cuts.put(known, own.over(self.segments.length(own.instances)))
        place = self.evaluate(cuts, full)
        if not known.all():
            fine, _ = self.refine(place.chosen(~known), full[~known])
            place = place.put(~known, fine)
        neutral = np.array([points[k].neutral if on else 0 for k, on in enumerate(known.tolist())])
        return self.each(place, neutral, SegmentedPaths.descended) if neutral.any() else self.descended(place)

    def settled(self, cuts: Cuts) -> Results:
        """Damped Newton at the full load from breakpoints near equilibria."""
        return self.descended(self.evaluate(cuts, np.ones(len(self.instances))))

    def descended(self, place: Place) -> Results:
        """Damped Newton at the full load, from all instances' states."""
        place, reached = self.descend(place)
        count = len(reached)
        results = Results(np.full(count, int(Status.NOT_RUN)), place, np.full(count, np.nan), np.ones(count))
        self._finish(results, self._end(results, reached, Status.STALLED))
        return results

    def each(self, place: Place, neutral: IntArray, led: Callable[[Self, Place], Results]) -> Results:
        """What instances are ``led`` to from places near equilibria, of each of which so many modes are neutral, (count,)."""
        count = len(neutral)
        results = Results(np.full(count, int(Status.NOT_RUN)), place, np.full(count, np.nan), np.ones(count), neutral)
        for modes in np.unique(neutral).tolist():
            some = neutral == modes
            here = place.chosen(some)
            own = self.of(self.instances[some], self.tolerance[some], (self.allowed - self.integrations)[some])
            own.leave_neutral(here, modes)
            results.put(some, led(own, here))
            self.integrations[some] += own.integrations
            self.iterations[some] += own.iterations
        return results

    def resume(self, last: Place) -> Results:
        """Damped Newton at the full load from the last equilibria under other loads; ``NOT_RUN`` where that leads off their
        branches."""
        cuts, before = last.cuts.over(self.segments.length(self.instances)), self.systems(last)
        full = np.ones(len(self.instances))
        place, reached = self.descend(self.evaluate(cuts, full))
        if reached.any():
            reached[reached] = before.chosen(reached).same_branch(self.systems(place.chosen(reached)))
        results = Results(np.full(len(full), int(Status.NOT_RUN)), place, np.full(len(full), np.nan), full)
        results.status[~reached & self._spent] = Status.INTEGRATION_LIMIT
        self._finish(results, reached)
        lost = ~np.isin(results.status, (Status.MULTIPLE_SHOOTING, Status.INTEGRATION_LIMIT))
        results.status[lost] = Status.NOT_RUN
        return results

    def _finish(self, results: Results, some: BoolArray) -> None:
        """Settle some of the instances, (count,), which are at the full load."""
        if not some.any():
            return
        place, good = self.settle(results.place.cuts.chosen(some), results.level[some])
        place = self._nearer(place, good, results.level[some])
        results.place = results.place.put(some, place)
        results.residual[some] = np.where(good, self.largest(place.cuts, self.gaps(place)), np.nan)
        results.status[among(some, good)] = Status.MULTIPLE_SHOOTING
        lost = among(some, ~good)
        results.status[lost] = self._why(lost, Status.STALLED)

    def _nearer(self, place: Place, good: BoolArray, level: FloatArray) -> Place:
        """One Newton step more where it leads nearer, as the tip may be far more sensitive than its gaps."""
        if not good.any():
            return place
        here = place.chosen(good)
        gaps = self.gaps(here)
        step = self.systems(here).solve(Step(-gaps.own, -gaps.rows))
        ahead = self.evaluate(self.moved(here.cuts, step), level[good])
        better = self.largest(here.cuts, self.gaps(ahead)) < self.largest(here.cuts, gaps)
        return place.put(among(good, better), ahead.chosen(better)) if better.any() else place

    def _why(self, some: BoolArray, otherwise: Status) -> IntArray:
        """Status of those that ended, (count,)."""
        said = np.where(self._stalled, int(Status.STALLED), int(otherwise))
        for fault in Fault:
            if fault is not Fault.NONE:
                said[self._fault == fault] = int(fault.status)
        said[self._spent] = int(Status.INTEGRATION_LIMIT)
        return np.asarray(said[some])


def _change(past: Cuts, before: Step, cuts: Cuts, now: Step) -> Step:
    """From ``before`` to ``now``, of the same instances; zero where their segments are not the same."""
    same = past.counts == cuts.counts
    change = Step(np.zeros_like(now.own), np.zeros_like(now.rows))
    mine = same[cuts.owner]
    change.own[same] = now.own[same] - before.own[same]
    change.rows[mine] = now.rows[mine] - before.rows[same[past.owner]]
    return change


def _inverse(steps: FloatArray) -> FloatArray:
    """One over steps of the load; zero where there was none."""
    return np.asarray(np.divide(1.0, steps, out=np.zeros_like(steps), where=steps > 0))


def _fewest_steps(level: FloatArray, safe: FloatArray) -> FloatArray:
    """Steps to the full load that there are at least, the longest that may be."""
    return np.asarray(np.floor(-np.log(np.minimum(1.0, np.maximum(level, safe / LOAD_RATIO))) / np.log(1 + LOAD_RATIO)))


def _hopeless(before: FloatArray, level: FloatArray, left: FloatArray | int) -> BoolArray:
    """Whether the steps that are left lead nowhere near the full load, at the pace since the level ``PACE`` steps before."""
    with np.errstate(divide="ignore", invalid="ignore"):
        steps = (1.0 - level) / (level - before)
        steps = np.fmin(steps, np.where(before > 0, np.log(1.0 / level) / np.log(level / before), np.inf))
    return np.asarray((level <= before) | (PACE * steps > HOPELESS * left))
