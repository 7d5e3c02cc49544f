"""One instance on its way from where its branch of equilibria ended.

Numbers in parentheses are those of ``docs/branches.md``.
"""

from dataclasses import dataclass, replace

import numpy as np

from multirod.budget import Spent
from multirod.results.events import BranchEvent
from multirod.solvers.following.departure import LEAST_LEFT, Departure
from multirod.solvers.following.descent import SOFT, Point, Unfit
from multirod.solvers.following.serving.requests import Run, Settle
from multirod.status import Status
from multirod.validation import FloatArray

FAR_BEYOND = 1e-2  # as OVERSHOOT, of damped dynamics, which leave what is hardly unstable slowly
SETTLING = 400  # integrations in which they are to rest
SAME_SIZE = 0.5  # of how far it left, by which other equations may put it elsewhere
MOST_EVENTS = 16
LAST = 1e-3  # of the way, on which a neutral mode may be one that rounded kinks held until there


@dataclass
class Journey(Departure):
    """One instance on its way from where its branch ended to the end of the way."""

    def run(self) -> Run:
        """To the end of the way: ``status``, ``events`` and ``end`` say what came of it."""
        try:
            yield from self._run()
        except Spent:
            self.status = Status.INTEGRATION_LIMIT
        except Unfit:
            self.status = Status.BRANCH_END

    def _run(self) -> Run:
        point = yield from self.at(self.way.start, self.way.level)
        if self.way.level == 1:
            yield from (self._let_go(point) if self.way.slack else self._fall(point))
            return
        point, neutral = yield from self._to_its_end(point)
        if not self.way.potential:
            yield from self._run_damped(point)
            return
        if self.way.doubtful and not (yield from self._was_stable(point, neutral)):
            return
        for _ in range(MOST_EVENTS):
            if point.level == 1:
                break
            reached = yield from self._past(point, neutral)
            if reached is None:
                return
            point, neutral = reached
        if point.level == 1:
            yield from self._arrive(point, neutral)

    def _to_its_end(self, point: Point) -> Run:
        """Where the branch ends that a point is on, by equations that are a little finer than those by which it ended there, and
        how many modes are neutral all along it."""
        soft = point.nearly_neutral
        found = yield from self._balanced(point, soft)
        neutral = 0 if found is None else (yield from self._by_symmetry(found, soft=soft > 0))
        if neutral != soft:
            found = yield from self._balanced(point, neutral)
        if found is None:
            return point, neutral
        end = found if self._passed(found) else (yield from self._along(found, neutral))
        falls = self.way.potential and end.level == 1 and (yield from self._judge(end)).falls
        # else two modes had just vanished together, by less than can be told, or one is neutral only here
        return (found if falls or (neutral > 0 and self._passed(end)) else end), neutral

    def _past(self, critical: Point, neutral: int) -> Run:
        """The end of the branch that a robot comes to from where one ends, and how many modes are neutral along it; None where
        none is found that can be followed."""
        landed = yield from self._leave(critical)
        if landed is None and neutral:  # what was not quite symmetric stiffens where it becomes straight
            end = yield from self._along(critical, 0)
            if end.level > critical.level:
                return end, 0
            critical = end
        if landed is None:
            yield from self._end_undecided(critical)
            return None
        landed, event, neutral = landed
        self.begun = landed if len(landed.unknowns) == len(self.way.start) else None
        if event is not None:
            self.events.append(event)
            self.places.append(critical.position)
        leaves = event is not None and event.status is Status.BIFURCATED and not event.fold
        end = yield from self._along(landed, neutral, critical if leaves else None)
        loud = end.level < 1 and np.linalg.norm(end.gamma) > self.way.loud
        if self.hardly > neutral and not loud and (end := (yield from self._let_down(end))) is None:
            return None
        if 1 - LAST < end.level < 1:
            end, neutral = yield from self._released(end, neutral)
        if loud or end.level < 1 and end.singular[-1] > self.way.singular:
            self._lose(end)
            return None
        return end, neutral

    def _arrive(self, point: Point, neutral: int) -> Run:
        """Say of a point at the end of the way what it is."""
        judgement = yield from self._judge(point)
        if judgement.stands:  # a load across an axis of symmetry may be too small to tell what it holds
            self.status, self.end, self.neutral = self.said, point, max(neutral, judgement.soft)
        else:
            self.status = Status.UNSTABLE
            self._lose(point, self.begun)

    def _fall(self, point: Point) -> Run:
        """Down from what is unstable at the end of its way."""
        self.status = Status.UNSTABLE
        landed = yield from self._leave(point)
        if landed is not None:
            self.status, (self.end, _, self.neutral) = Status.CONVERGED, landed

    def _run_damped(self, point: Point) -> Run:
        """The same by damped dynamics, (11), wherever the branch ends: in longer steps where none can be followed on."""
        farthest = 0.0
        for _ in range(MOST_EVENTS):
            if point.level == 1:
                self.status, self.end = self.said, point
                return
            step = max(farthest, FAR_BEYOND if self.way.by_inputs else FAR_BEYOND * max(point.level, FAR_BEYOND))
            landed = None
            for longer in (step, 4 * step, 1.0):
                level = min(1.0, point.level + longer)
                most = min(SETTLING, self.remaining)
                if most <= 0:
                    raise Spent
                found, taken, edge = yield Settle(point.unknowns, level, most)
                self.edge = edge if self.edge is Status.NOT_RUN else self.edge  # as soon as the branch has ended
                self._count(taken)
                self.iterations += taken
                if found is not None:
                    landed, _ = yield from self._correct(found, level, 0)
                if landed is not None or level == 1.0:
                    break
            if landed is None:
                return
            self.quiet, self.begun, self.edge = Status.DAMPED, landed, Status.NOT_RUN
            point = yield from self._along(landed, 0)
            farthest = 4 * longer if point.level == landed.level else 0.0

    def _end_undecided(self, point: Point) -> Run:
        """The end of the way, if it is just there that the branch is critical, and no mode of an equilibrium surely falls."""
        if 1 - point.level > LEAST_LEFT:
            self._lose(point)
            return
        there = yield from self.at(point.unknowns, 1.0)
        neutral = there.nearly_neutral
        if not there.size <= self.way.tolerance:  # as inputs move it on what is left of the way, but along what vanishes
            there, _ = yield from self._correct(point.unknowns, 1.0, neutral)
        if there is not None and (yield from self._stands(there)):
            self.status, self.end, self.neutral = self.said, there, neutral

    def _lose(self, point: Point, since: Point | None = None) -> None:
        """Rounding may have ended the way at a point, or led it astray ``since`` another: segments may go on from there."""
        if np.linalg.norm(point.gamma) > self.way.noisy:
            self.lost = point if since is None else since

    @property
    def said(self) -> Status:
        """What the events make of a result, or that damped dynamics led to it."""
        return max((event.status for event in self.events), key=(Status.BIFURCATED, Status.SNAPPED).index, default=self.quiet)

    def told(self, end: FloatArray) -> tuple[BranchEvent, ...]:
        """Its events, and how far each moved the end effector, which is at ``end`` (3,) now."""
        ways = np.linalg.norm(np.diff([*self.places, end], axis=0), axis=1).tolist()
        return tuple(replace(event, tip_travel=way) for event, way in zip(self.events, ways, strict=True))

    def polish(self) -> Run:
        """The end again, by the equations and the tolerance of the problem that this is done for.

        Near a fold their error may be what makes it unstable: it is not given then.
        """
        assert self.end is not None  # or there is nothing to be polished
        end, self.end = self.end, None
        try:
            if self.slight:
                yield from self._polish_slight(end)
                return
            found = yield from (self._levelled(end.unknowns, 1.0) if self.hardly else self._next_to(end.unknowns, self.neutral))
            if found is None:
                self.status = Status.BRANCH_END
                self._lose(end)
            elif (yield from self._judge(found)).falls:
                self.status = Status.UNSTABLE
                self._lose(end, self.begun)
            else:
                self.end = found
        except Spent:
            self.status = Status.INTEGRATION_LIMIT

    def _polish_slight(self, end: Point) -> Run:
        """The same of what has just left a branch: where the equations that were asked for put its bifurcation elsewhere, by more
        than it is beyond it, it is on that branch by them."""
        critical = self.departed
        assert critical is not None  # or it has not
        if (yield from self.at(end.unknowns, 1.0)).size <= self.way.tolerance:
            self.end = end
            return
        found, _ = yield from self._correct(end.unknowns, 1.0, 0, any_contraction=True)
        unbent = critical.unknowns[: len(end.unknowns)]
        size = np.linalg.norm(end.unknowns - unbent)
        if found is None or np.linalg.norm(found.unknowns - end.unknowns) > SAME_SIZE * size:
            self.events.pop(), self.places.pop()
            self.status = self.said
            found, _ = yield from self._correct(unbent, 1.0, 0, any_contraction=True)
        if found is None or (yield from self._judge(found)).falls:
            self.status = Status.BRANCH_END
        else:
            self.end = found

    def _was_stable(self, critical: Point, neutral: int) -> Run:
        """Whether no mode is unstable where one vanishes; or a little before, where of several that vanish together one may have
        done so already."""
        if (yield from self._stands(critical)):
            return True
        found, _ = yield from self._correct(critical.unknowns, critical.level - self._overshoot(critical), neutral)
        return found is not None and (yield from self._stands(found))

    def _passed(self, point: Point) -> bool:
        """Whether a branch is unstable where it ended, by equations that are a little finer than those by which it did."""
        slope = self.slope_or_none(point) if self.way.by_tip and self.way.potential else None
        return slope is not None and slope.values[0] < -SOFT
