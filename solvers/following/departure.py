"""One instance that leaves a branch of equilibria, where that ends.

Numbers in parentheses are those of ``docs/branches.md``.
"""

from contextlib import suppress
from dataclasses import dataclass

import numpy as np

from multirod.results.events import BranchEvent
from multirod.solvers.following.descent import DRIVEN, KICK, SOFT, Point, Unfit, turn_between, way_out
from multirod.solvers.following.serving.many import alike
from multirod.solvers.following.serving.requests import Run
from multirod.solvers.following.walk import BESIDE, DECIDED, MERGED, Walk, held
from multirod.status import Status
from multirod.validation import FloatArray

LEFT = 0.05  # of the rest of the way, where that leads nowhere: what is put together stiffens as its inverse
SHORTER, SHORTENED = 3, 0.1  # so often, and by so much, where that leads far off: a critical point is known to 1e-7
AT_END = 6e-8  # of K/L: at the end of the way a mode as unstable decides
SLIGHT = 1e-4  # of K/L: what leaves a mode no more unstable bends so little that residuals hardly tell by how much
TELLING = 1e-3  # of the moments that bend it, in K/L the 3/2 power of how unstable it was: those that do
CLEAR = 3e-3  # of K/L: as unstable it is wanted where no moment drives it, before the end of the way
NEAR = 5.0  # turn to a branch that leaves, over the root of how unstable the other is: 2.6 of a column [rad]
DEEPER = 10.0  # than a branch goes down that leaves as a root, by as large a turn: what is elsewhere
AS_SOFT = 0.1  # of how unstable the other is, what a branch that leaves has not: it is twice that
STILL = 1e-3  # of the longest way of any place: where the tip is held
FAR = 0.5  # turn of the tip to another branch [rad], however near the critical point
APART = 0.7  # ratio of distances at a quarter of the overshoot: above it another branch, half on one that bifurcates here
LEAST_LEFT = 1e-5  # of the way: the end may be as near to the branch as its own critical point
SAME_BRANCH = 0.35  # below it the same branch, a quarter
EXTENDED = 1000.0  # ways between two samples: how far one is drawn on that is too short for what a fold brings about
LEADS = 1e-3  # of how unstable it is: a moment as large along the mode is one that drives it there
BACK = 16  # halvings of what is left on the way back to a level
RETURNED = 1e-4  # turn of the tip by which what was pushed off came back [rad]


@dataclass
class Departure(Walk):
    """One instance, from a critical point to where the robot goes from there."""

    def _leave(self, critical: Point) -> Run:
        """Where the robot goes from a critical point: the point it comes to, what happened, and the modes that are neutral there;
        None where that cannot be told."""
        self.hardly, self.edge = 0, Status.NOT_RUN
        landed = (yield from self._leave_or_stay(critical, self._overshoot(critical))) if self.way.by_tip else None
        for clamping in range(self.way.clampings):
            if landed is not None or self.edge is not Status.NOT_RUN:  # what falls to where nothing is does so with clamps too
                break
            if (clamped := (yield from self._clamped(critical, clamping))) is not None:
                landed = yield from self._leave_clamped(clamped)
        return landed

    def _leave_clamped(self, critical: Point) -> Run:
        """The same by clamps; where a step beyond leads far off, as what closes is stiff, from nearer and nearer."""
        step, left = self._overshoot(critical), LEFT * (1 - critical.level)
        landed = yield from self._leave_or_stay(critical, step)
        if landed is None and left < step:
            step = left
            landed = yield from self._leave_or_stay(critical, step)
        for _ in range(SHORTER):
            if landed is not None or self.beside or not self.way.thorough:
                break
            step *= SHORTENED
            landed = yield from self._leave_or_stay(critical, step, beside=True)
        return landed

    def _leave_or_stay(self, critical: Point, step: float, *, beside: bool = False) -> Run:
        """``_leave_by``; None where displacements do not tell."""
        self.beside = False
        with suppress(Unfit):
            return (yield from self._leave_by(critical, step, beside))
        return None

    def _leave_by(self, critical: Point, step: float, beside: bool) -> Run:
        """The same by the displacements that a point tells of, first a ``step`` beyond it; not from where what does not vanish
        is far from rest, if it is to be ``beside`` it."""
        beyond = yield from self._pass(critical, step)
        if beyond is None:
            self.beside = True
            return None
        slope = beyond.slope
        self.beside = slope.unsettled <= BESIDE
        if beside and not self.beside:
            return None
        longer = (beyond.level - critical.level) / self._overshoot(critical)
        if self.way.by_inputs:  # however many times as long, it may be short: a way is as short as samples are near
            longer = min(longer, LEADS * -slope.lowest / DRIVEN)
        first, fold = way_out(slope, beyond.moved, longer, self.way.side)
        slight = first.any() and beyond.level == 1 and slope.lowest > -SLIGHT
        self.departed, self.within = (critical if slight else None), self.way.tolerance
        if slight:
            telling = TELLING * abs(slope.values[0]) ** 1.5 * slope.stiffness / beyond.unit.max()
            self.within = min(self.way.tolerance, float(telling))
        landed = yield from self._descend(beyond, slope, first)
        if landed is None:
            return None
        rest, neutral = landed, 0 if self.slight else landed.slope.neutral
        if len(landed.unknowns) > len(self.way.start):
            neutral = neutral if self.way.has_tip else 0  # of a held rod Gamma is made to hold what symmetry leaves neutral
            own = landed.unknowns[: len(self.way.start)] if landed.settled is None else landed.settled
            rest = yield from self._at_rest(own, landed.level, neutral)
            if rest is None:
                return None
        if neutral and (yield from self._by_symmetry(rest, landed)) != neutral:
            if neutral > 1:
                return None
            self.hardly, neutral = 1, 0  # what is not quite symmetric holds it by as little
        if not (yield from self._rests(rest, neutral)):
            return None
        here = rest if rest.level <= 1 else (yield from self._led_back(rest, 1.0, neutral))
        if here is None:
            return None
        status = yield from self._kind(critical, beyond, landed, rest, first)
        if status is None:
            return here, None, neutral
        lost, displacement, aside = 0.0, landed.position - critical.position, np.zeros(3)
        if status is Status.SNAPPED:
            lost, displacement = yield from self._lost(critical, beyond, rest, neutral)
        elif first.any():
            moves = beyond.moved @ slope.change(first)
            sizes = np.linalg.norm(moves, axis=1)
            displacement = moves[-1]
            if sizes[-1] < STILL * sizes.max():
                displacement, aside = 0.0 * moves[-1], moves[int(sizes.argmax())] / sizes.max()
        if status is Status.BIFURCATED:
            displacement = displacement / max(float(np.linalg.norm(displacement)), 1e-300)
        event = BranchEvent(
            status=status,
            fold=fold,
            load_factor=np.nan if self.way.by_inputs else critical.level,
            progress=critical.level if self.way.by_inputs else np.nan,
            energy_lost=lost,
            tip_displacement=displacement,
            rod_displacement=aside,
            neutral=neutral,
        )
        return here, event, neutral

    def _at_rest(self, unknowns: FloatArray, level: float, neutral: int) -> Run:
        """The equilibrium without clamps that they lead to."""
        if self.hardly > neutral:
            return (yield from self._levelled(unknowns, level))
        return (yield from self._correct(unknowns, level, neutral))[0]

    def _lost(self, critical: Point, beyond: Point, rest: Point, neutral: int) -> Run:
        """The energy lost [J] and how the tip moved [m]: from the critical point to where the branch that was come to is at the
        same load; where it does not lead back there, from beyond it."""
        found = yield from self._led_back(rest, critical.level, neutral)
        found, left = (rest, beyond) if found is None else (found, critical)
        return (yield from self._down(left, found)), found.position - critical.position

    def _led_back(self, point: Point, level: float, neutral: int) -> Run:
        """The equilibrium at a level before, on the branch that a point is on; None where that does not lead there."""

        def at(here: Point, level: float) -> Run:
            found, _ = yield from self._correct(here.unknowns, level, neutral)
            # what is neutral at this load alone, as one that turns a magnet over, tells nothing of it
            same = found is not None and alike(found.gamma, here.gamma, max(neutral, min(found.nearly_neutral, 1)))
            return found if same else None

        found = yield from at(point, level)
        for _ in range(BACK):  # near its own end a branch bends as the root of what is left
            if found is not None or point is None:
                break
            point = yield from at(point, 0.5 * (point.level + level))
            found = None if point is None else (yield from at(point, level))
        return found

    def _down(self, left: Point, found: Point) -> Run:
        """The energy lost between two points [J]."""
        before = yield from self._weigh(left.unknowns[: len(self.way.start)], left.level)
        return before - (yield from self._weigh(found.unknowns, found.level))

    def _kind(self, critical: Point, beyond: Point, landed: Point, rest: Point, first: FloatArray) -> Run:
        """(6), (23), (27) Whether a point that was come to, ``rest`` without clamps, is on a branch that leaves the critical
        point, or elsewhere; None where it is on the same branch."""
        turn = turn_between(critical.frames, landed.frames)
        if held(beyond.slope) and turn < 2 * MERGED:
            return None
        neutral = landed.slope.neutral
        left = int((beyond.slope.values < -SOFT).sum())
        along = landed.slope.neutral > 0 and landed.slope.neutral == critical.slope.neutral
        along |= left > 0 and landed.slope.values[left - 1] < AS_SOFT * -beyond.slope.values[0]
        if along and turn < 2 * KICK and not self.slight:
            return None  # pushed along what is neutral, or nearly so, on all of the branch
        if turn > FAR and not first.any():
            return Status.SNAPPED
        value = beyond.slope.lowest
        if first.any() and value > -CLEAR and RETURNED < turn < NEAR * np.sqrt(max(-value, 0.0)):
            return Status.BIFURCATED  # too near for a quarter of that to be told
        deep = 0.25 * max(-value, 0.0) * turn**2 * beyond.stiffness
        if turn > FAR and (yield from self._down(beyond, rest)) > DEEPER * deep > 0:
            return Status.SNAPPED
        ratio = yield from self._shrinks(critical, beyond.level, landed, first, neutral)
        if ratio < SAME_BRANCH and (turn < RETURNED or not first.any()):
            return None
        elsewhere = ratio > APART or (turn > FAR and ratio < SAME_BRANCH)
        return Status.SNAPPED if elsewhere else Status.BIFURCATED

    def _pass(self, critical: Point, step: float) -> Run:
        """The critical unknowns at a level beyond, where it is decided that they are left; None where it is not at the end.

        Past the end of a way between two samples, which may be short, inputs go on as they did, but where a mode is unstable at
        the end that nothing drives.
        """
        end = 1.0
        while True:
            level = min(end, critical.level + step)
            beyond = yield from self._beyond(critical, level)
            slope = beyond.slope
            if slope.lowest < -CLEAR or abs(slope.along[0]) > DECIDED or held(slope):
                return beyond
            rest = yield from self._rest_beside(critical, level, slope)
            if rest is not None and (held(rest.slope) or rest.slope.lowest < -CLEAR):
                return rest
            if level == end:
                last = beyond if rest is None else rest
                unstable, driven = last.slope.lowest < -AT_END, abs(last.slope.along[0]) > LEADS * -last.slope.lowest
                if end > 1 or not self.way.by_inputs or 1 - critical.level <= LEAST_LEFT or (unstable and not driven):
                    return last if unstable else None
                end = EXTENDED
            step *= 4

    def _shrinks(self, critical: Point, level: float, landed: Point, first: FloatArray, neutral: int) -> Run:
        """Distance of where a quarter of the overshoot leads, over that of where all of it did."""
        quarter = critical.level + 0.25 * (level - critical.level)
        other = (yield from self._halfway(critical, quarter, landed, neutral)) if first.any() else None
        if other is None:
            near = yield from self._beyond(critical, quarter)
            other = yield from self._descend(near, near.slope, first)
        if other is None:
            return 1.0
        size = [float(np.linalg.norm(point.unknowns - critical.unknowns)) for point in (other, landed)]
        return size[0] / max(size[1], 1e-300)
