"""One instance along a branch of equilibria.

Numbers in parentheses are those of ``docs/branches.md``.
"""

from dataclasses import dataclass, field, replace

import numpy as np

from multirod.budget import Spent
from multirod.results.events import BranchEvent
from multirod.solvers.continuation.acceptance import CONTRACTION
from multirod.solvers.following.descent import RADIUS, SOFT, VANISHING, Point, Slope, Unfit, turn_between
from multirod.solvers.following.downhill import in_steps, next_rest
from multirod.solvers.following.serving.many import BALANCED, alike, led_to
from multirod.solvers.following.serving.requests import At, Clamp, Correct, Descend, Judge, Run, Trace, Weigh
from multirod.solvers.following.valley import FIRST, LONGEST, along_floor, by_residuals, by_turns, down_valley
from multirod.status import Status
from multirod.validation import FloatArray

OVERSHOOT = 1e-3  # of the load, or of the way between two samples: first step beyond a critical point
NOISY = 100.0  # norm of Gamma, beyond which it may be rounding that ends a branch
POLISHED = 1e-2  # of the unknowns at the end of the way, by which other equations may move it slowly
PIECES = 6  # into which clamps cut a rod, each of which is integrated
STIFFER = 2.0  # of how far a branch was found from where it left another: its mode stiffens with that, in a step by 4 at most
NEAR, WIDE = 1e-3, 0.1  # of the unknowns: the first step along a valley, and the longest
ALONGSIDE = 2  # steps of Newton's method across modes that vanish
DECIDED = 1e-4  # of K/L: a mode as unstable, or a moment as large, decides
AS_A_ROOT = 0.1  # of half the distance, that an equilibrium may be from half-way to count as one on a branch that bifurcates
BESIDE = 0.02  # turn that leads what does not vanish back to rest, of what is beside a critical point [rad]
MERGED = 0.05  # turn of the tip [rad] within which branches merge
# turns along a neutral mode, where it is still neutral if symmetry makes it so: the less, the less it is bent [rad]
ASIDE = (0.05, 0.005)


@dataclass(frozen=True, kw_only=True)
class Way:
    """From where an instance goes on, and by what.

    Attributes:
        start: Unknowns where its branch ended, shape (n,).
        level: Part of the way there.
        tolerance: Largest residual [1/m].
        allowed: Integrations that it may take.
        safe_step: A step that is short enough wherever it starts.
        most_step: No step is longer.
        max_steps: Steps allowed.
        side: 1, or -1 for the other one at each bifurcation.
        by_inputs: Whether inputs change on the way, not loads alone.
        has_tip: Whether the end effector is free to tell of modes.
        by_tip: Whether it tells what the rods are like, not where fixed bodies hold all ends: clamps are tried where that fails.
        doubtful: Whether the branch may have begun unstable.
        noisy: Norm of ``Gamma``, beyond which it may be rounding that ends a branch.
        loud: The same, beyond which segments are to go on.
        potential: Whether its loads have one: without, it is damped dynamics that go on, and of stability an odd number of
            unstable modes is all that can be told.
        singular: Its least singular value, beyond which no mode vanishes where one ends.
        steps: Equal steps of its integrations from base to tip; 0 by step control.
        clampings: In how many ways its rods can be clamped.
        slack: Whether it is at the end of the way, but in a valley and not at rest.
        thorough: Whether shorter steps beyond a critical point are tried, and floors that bend.
    """

    start: FloatArray
    level: float
    tolerance: float
    allowed: int
    safe_step: float
    most_step: float
    max_steps: int
    side: int
    by_inputs: bool
    has_tip: bool = True
    by_tip: bool = True
    doubtful: bool = False
    noisy: float = NOISY
    singular: float = np.inf
    potential: bool = True
    steps: int = 0
    clampings: int = 0
    slack: bool = False
    thorough: bool = False
    loud: float = np.inf


@dataclass
class Walk:
    """One instance on a branch of equilibria; what integrates is a generator, so that many share every launch (``follow``).

    Attributes:
        way: From where, and by what.
        integrations: That it took.
        iterations: That it took.
        status: What is said of it.
        end: Where it has come to at the end of the way.
        neutral: Modes that symmetry leaves neutral there.
        departed: Where it has just left a branch, at the end of the way.
        within: Largest residual where a descent ends [1/m].
        lost: Where rounding hides how it goes on.
        begun: Where it came to from the last branch that ended.
        quiet: What is said without events.
        hardly: Modes in which hardly anything holds what it has come down a valley to: 1, or none.
        valley: Whether it has come to one.
        beside: Whether the last step beyond a critical point led to what is beside it.
        hushed: Whether it was kept from going on along a branch as ``Way.loud`` says.
        edge: Why there is nothing where the last descent led.
        events: What happened.
        places: Of the end effector, at each [m].
    """

    way: Way
    integrations: int = 0
    iterations: int = 0
    status: Status = Status.BRANCH_END
    end: Point | None = None
    neutral: int = 0
    departed: Point | None = None
    within: float = 0.0
    lost: Point | None = None
    begun: Point | None = None
    quiet: Status = Status.CONVERGED
    hardly: int = 0
    valley: bool = False
    beside: bool = False
    hushed: bool = False
    edge: Status = Status.NOT_RUN
    events: list[BranchEvent] = field(default_factory=list)
    places: list[FloatArray] = field(default_factory=list)

    # ---- evaluation ----

    def at(self, unknowns: FloatArray, level: float) -> Run:
        """The point that an integration tells of."""
        self._count(PIECES if len(unknowns) > len(self.way.start) else 1)
        point = yield At(unknowns, level)
        return point

    def _clamped(self, point: Point, clamping: int = 0) -> Run:
        """The same point with clamps that carry no moment yet; None where there can be none."""
        if not self.way.clampings:
            return None
        self._count(PIECES)
        clamped = yield Clamp(point.unknowns, point.level, clamping)
        return clamped

    def _judge(self, point: Point) -> Run:
        self._count()
        judgement = yield Judge(point.unknowns, point.level)
        return judgement

    def _weigh(self, unknowns: FloatArray, level: float) -> Run:
        self._count()
        potential = yield Weigh(unknowns, level)
        return potential

    def _count(self, integrations: int = 1) -> None:
        if self.integrations + integrations > self.way.allowed:
            raise Spent
        self.integrations += integrations

    def _ask(self, request: Correct | Trace | Descend) -> Run:
        """What comes of what is done for many at once."""
        answer = yield request
        self.integrations += answer.integrations
        self.iterations += answer.iterations
        if answer.spent:
            raise Spent
        return answer

    @property
    def remaining(self) -> int:
        """Integrations that it may take yet."""
        return self.way.allowed - self.integrations

    @property
    def slight(self) -> bool:
        """Whether it has just left a branch at the end of the way, and is bent so little that residuals hardly tell."""
        return self.departed is not None

    def _stands(self, point: Point) -> Run:
        """Whether no mode is unstable."""
        return (yield from self._judge(point)).stands

    def slope_or_none(self, point: Point) -> Slope | None:
        """Of a point; None where it is not fit to tell."""
        try:
            return point.slope
        except Unfit:
            return None

    def _rests(self, point: Point, neutral: int) -> Run:
        """Whether a point is stable but for modes that symmetry leaves neutral; what loads across hold too little to be told from
        these is one of a held rod too, whose ``Gamma`` says what they hold."""
        judgement = yield from self._judge(point)
        told = self.slight or not self.way.has_tip or neutral <= judgement.soft <= max(neutral, self.hardly)
        return judgement.stands and told

    # ---- along a branch ----

    def _by_symmetry(self, point: Point, clamped: Point | None = None, *, soft: bool = False) -> Run:
        """Modes that are neutral at a point and near it: those that symmetry leaves so; of a ``soft`` one whose ends are all held
        clamps are asked.

        A strut between a ball and a universal joint that has buckled turns about its chord, and neither end tells how far it is
        bent: then the same point does, ``clamped``.
        """
        slope = self.slope_or_none(point) if self.way.has_tip else None
        told = point
        untold = slope is None or not len(slope.values)
        if soft and self.way.has_tip and not len(point.among.forces):
            clamped = yield from self._clamped(point)
        if untold and clamped is not None and len(clamped.unknowns) > len(point.unknowns):
            told, slope = clamped, self.slope_or_none(clamped)
        if slope is None:
            return 0
        count = slope.neutral
        for k in np.argsort(np.abs(slope.values))[:count].tolist():
            for turn in ASIDE:
                step = slope.change(turn * slope.modes[:, k])[: len(point.unknowns)]
                if (yield from self._neutral_along(point, told, slope.modes[:, k], step, turn, count)):
                    break
            else:
                return 0
        return count

    def _neutral_along(self, point: Point, told: Point, mode: FloatArray, step: FloatArray, turn: float, count: int) -> Run:
        """Whether an equilibrium with as many neutral modes is a step along one of them, that turns what it turns by so much, as
        the same point tells it, with clamps or without."""
        found, _ = yield from self._correct(point.unknowns + step, point.level, count)
        if found is None:
            return False
        clamps = np.zeros(len(told.unknowns) - len(point.unknowns))
        there = (yield from self.at(np.append(found.unknowns, clamps), point.level)) if len(clamps) else found
        slope = self.slope_or_none(there)
        if slope is None or slope.neutral < count:
            return False
        # what moves need not be the tip
        turned = told.turned[: len(mode), : len(point.unknowns)] @ (found.unknowns - point.unknowns)
        return bool(abs(mode @ turned) >= 0.5 * turn)

    def _along(self, start: Point, neutral: int, origin: Point | None = None) -> Run:
        """The last point on the branch through one, of level 1 if it leads there; ``origin`` is where it left another."""
        first = self._overshoot(start)
        if origin is not None:
            first = max(first, STIFFER * (start.level - origin.level))
        ways = first, self.way.safe_step, self.way.most_step, self.way.max_steps
        aside = self.hardly > neutral
        count = max(neutral, self.hardly)
        trace = Trace(start, count, self.way.tolerance, self.remaining, *ways, origin, aside, self.way.loud)
        end = (yield from self._ask(trace)).point
        self.hushed |= bool(end.level < 1 and np.linalg.norm(end.gamma) > self.way.loud)
        return end

    def _let_down(self, point: Point) -> Run:
        """(13) The equilibrium to which the valley leads in which a point is; None where none was found."""
        clamped = yield from self._clamped(point)
        slope = None if clamped is None else self.slope_or_none(clamped)
        if slope is None:
            return None
        floor = by_turns(self.at, point.level, slope.facing)
        landed = yield from down_valley(floor, clamped.unknowns, FIRST, LONGEST, self.way.tolerance)
        return None if landed is None else (yield from self._levelled(landed.unknowns[: len(self.way.start)], point.level))

    def _levelled(self, unknowns: FloatArray, level: float) -> Run:
        """(13) The equilibrium without clamps beside unknowns in a valley, near its lowest place."""

        def correct(unknowns: FloatArray) -> Run:
            answer = yield from self._ask(Correct(unknowns, level, 1, self.way.tolerance, self.remaining, aside=True))
            return answer.point

        size = float(np.linalg.norm(unknowns))
        return (yield from down_valley(by_residuals(correct), unknowns, NEAR * size, WIDE * size, self.way.tolerance))

    def _let_go(self, point: Point) -> Run:
        """To where the valley leads in which a point is at the end of the way, held back no longer."""
        self.hardly, self.valley = 1, True
        found = yield from self._levelled(point.unknowns, 1.0)
        if found is not None and not (yield from self._judge(found)).falls:
            self.status, self.end = Status.CONVERGED, found

    def _released(self, point: Point, neutral: int) -> Run:
        """The end of the way from a point next to it, where symmetry leaves modes neutral there that rounded kinks held until
        then, and how many; the point itself where that is not so."""
        slope = self.slope_or_none(point) if self.way.has_tip and not self.way.by_inputs else None
        soft = 0 if slope is None else slope.neutral
        if soft <= neutral:
            return point, neutral
        found, _ = yield from self._correct(point.unknowns, 1.0, soft)
        if found is None or not alike(found.gamma, point.gamma, soft) or (yield from self._by_symmetry(found)) != soft:
            return point, neutral
        if self.events:
            self.events[-1] = replace(self.events[-1], neutral=soft)
        return found, soft

    def _overshoot(self, point: Point) -> float:
        return OVERSHOOT if self.way.by_inputs else OVERSHOOT * max(point.level, OVERSHOOT)

    def _correct(self, unknowns: FloatArray, level: float, neutral: int, *, any_contraction: bool = False) -> Run:
        """(7) Newton's method, without steps along ``neutral`` modes: the point, None where it fails, and its contraction."""
        answer = yield from self._ask(Correct(unknowns, level, neutral, self.way.tolerance, self.remaining, any_contraction))
        return answer.point, answer.contraction

    def _balanced(self, point: Point, neutral: int) -> Run:
        """The equilibrium beside a point; itself where it needs no step."""
        if point.size <= BALANCED * self.way.tolerance:
            return point
        return (yield from self._correct(point.unknowns, point.level, neutral))[0]

    def _next_to(self, unknowns: FloatArray, neutral: int) -> Run:
        """The equilibrium at the end of the way by other equations than those of ``unknowns``; None where there is none near.

        They may move what is soft by much of what is left: by little of the whole it is the same branch.
        """
        found, contraction = yield from self._correct(unknowns, 1.0, neutral, any_contraction=True)
        if found is None and self.way.thorough and not neutral:
            found = yield from led_to(self.at, unknowns, self.way.tolerance)
        slow = found is not None and contraction > CONTRACTION
        return None if slow and np.linalg.norm(found.unknowns - unknowns) > POLISHED * np.linalg.norm(unknowns) else found

    def _beyond(self, critical: Point, level: float) -> Run:
        """The critical unknowns at a level beyond; where there are constraints, what else changes on the branch with it."""
        point = yield from self.at(critical.unknowns, level)
        for _ in range(ALONGSIDE if len(point.unknowns) > len(point.among.forces) else 0):
            slope = point.slope
            stiff = np.where(slope.values > VANISHING, slope.values, np.inf)
            turn = np.clip(-slope.along / stiff, -RADIUS, RADIUS)
            point = yield from self.at(point.unknowns + slope.back + slope.change(slope.modes @ turn), level)
        return point

    def _rest_beside(self, critical: Point, level: float, slope: Slope) -> Run:
        """The equilibrium on the same branch beside the critical unknowns at a level beyond, by Newton's method; None where there
        is none.

        What is driven in its stiff modes is off in the soft one too: its slope alone tells neither that it is stable nor that it
        is not. With clamps ``_beyond`` has brought these to rest.
        """
        near = not slope.clamps and slope.values[0] > DECIDED and np.abs(slope.along / slope.values).max() < MERGED
        if not near:
            return None
        rest, _ = yield from self._correct(critical.unknowns, level, 0, any_contraction=True)
        if rest is None or turn_between(critical.frames, rest.frames) > MERGED:
            return None
        return None if self.slope_or_none(rest) is None else rest

    def _halfway(self, critical: Point, level: float, landed: Point, neutral: int) -> Run:
        """The stable equilibrium at a quarter of the way if it is where a branch that leaves as the root of the load has it; None
        where it is not, and by the turns of clamps, which do not tell that it is stable."""
        reached = landed.slope
        if reached.clamps or self.slight:
            return None
        expected = 0.5 * (critical.unknowns + landed.unknowns)
        found, _ = yield from self._correct(expected, level, neutral)
        slope = None if found is None else self.slope_or_none(found)
        if slope is None or slope.facing != reached.facing or slope.values[0] < -SOFT:
            return None
        near = np.linalg.norm(found.unknowns - expected) <= AS_A_ROOT * np.linalg.norm(expected - critical.unknowns)
        return found if near else None

    # ---- down in energy ----

    def _descend(self, point: Point, slope: Slope, first: FloatArray) -> Run:
        """(4) Where going down in energy leads from a point, after turning the tip by ``first``; None where it leads nowhere."""
        if slope.clamps:
            landed = yield from self._descend_clamped(point, slope, first)
            return landed
        answer = yield from self._ask(Descend(point, slope, first, self.within, self.remaining))
        landed, self.edge = answer.point, answer.edge
        if landed is None and len(point.unknowns) == 1:  # it would snap though its tip be held
            way = slope.change(first) if first.any() else slope.step(RADIUS)
            landed = yield from next_rest(self.at, point, float(np.sign(way[0])), self.within)
        return landed

    def _descend_clamped(self, point: Point, slope: Slope, first: FloatArray) -> Run:
        """The same by the turns of clamps; of legs that come nowhere so, on the floor of their valley."""
        landed = yield from in_steps(self, point, slope, first)
        if landed is None and self.way.thorough and point.among.arrow is not None and slope.unsettled <= BESIDE:
            landed = yield from along_floor(self.at, point, slope, first, self.within)
        return landed


def held(slope: Slope) -> bool:
    """Whether a stable equilibrium is beside a point: one on which branches merge."""
    return bool(slope.values[0] > DECIDED and np.abs(slope.along).max() < MERGED * slope.values[0])
