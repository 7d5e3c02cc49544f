"""One instance along a branch of equilibria.

Numbers in parentheses are those of ``docs/branches.md``.
"""

from dataclasses import dataclass, replace

import numpy as np

from multirod.budget import Spent
from multirod.results.events import BranchEvent
from multirod.solvers.continuation.acceptance import CONTRACTION, MIN_STEP, SURPRISE, goes_on
from multirod.solvers.following.descent import SOFT, Point, Slope, Unfit, slope_at
from multirod.solvers.following.requests import At, Judge, Run
from multirod.status import Status
from multirod.validation import FloatArray

OVERSHOOT = 1e-3  # of the load, or of the way between two samples: first step beyond a critical point
NEWTON_STEPS = 8
POLISHED = 1e-3  # of the tolerance: what needs no step
GROWTH = 0.5  # of the way, that the next step may be
FASTER = 3.0
NOISY = 100.0  # norm of Gamma, beyond which it may be rounding that ends a branch
# turns along a neutral mode, where it is still neutral if symmetry makes it so: the less, the less it is bent [rad]
ASIDE = (0.05, 0.005)


@dataclass
class Walk:
    """One instance on a branch of equilibria; what integrates is a generator, so that many share every launch (``follow``).

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
        by_tip: Whether it tells what the rods are like: clamps are then tried where that fails.
        doubtful: Whether the branch may have begun unstable.
        noisy: Norm of ``Gamma``, beyond which it may be rounding that ends a branch.
        potential: Whether its loads have one: without, it is damped dynamics that go on, and nothing is known of stability.
        singular: Its least singular value, beyond which no mode vanishes where one ends.
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
    integrations: int = 0
    iterations: int = 0
    status: Status = Status.BRANCH_END
    end: Point | None = None
    neutral: int = 0
    lost: Point | None = None  # where rounding hides how it goes on

    def __post_init__(self) -> None:
        self.events: list[BranchEvent] = []

    # ---- evaluation ----

    def _at(self, unknowns: FloatArray, level: float) -> Run:
        self._count()
        point = yield At(unknowns, level)
        return point

    def _slope(self, point: Point) -> Slope:
        return slope_at(point)

    def _judge(self, point: Point) -> Run:
        self._count(2)
        judgement = yield Judge(point)
        return judgement

    def _count(self, integrations: int = 1) -> None:
        if self.integrations + integrations > self.allowed:
            raise Spent
        self.integrations += integrations

    def _stands(self, point: Point) -> Run:
        """Whether no mode is unstable."""
        modes = (yield from self._judge(point)).modes
        return bool(modes.known[0] and modes.index[0] <= 0 and not modes.diverging[0])

    def _slope_or_none(self, point: Point) -> Slope | None:
        try:
            return self._slope(point)
        except Unfit:
            return None

    # ---- along a branch ----

    def _by_symmetry(self, point: Point) -> Run:
        """Modes that are neutral at a point and near it: those that symmetry leaves so."""
        slope = self._slope_or_none(point) if self.has_tip else None
        if slope is None:
            return 0
        count = slope.neutral
        for k in np.argsort(np.abs(slope.values))[:count].tolist():
            for turn in ASIDE:
                step = slope.change(turn * slope.modes[:, k])
                if (yield from self._neutral_along(point, slope.modes[:, k], step, turn, count)):
                    break
            else:
                return 0
        return count

    def _neutral_along(self, point: Point, mode: FloatArray, step: FloatArray, turn: float, count: int) -> Run:
        """Whether an equilibrium with as many neutral modes is a step along one of them, that turns what it turns by so much."""
        found, _ = yield from self._correct(point.unknowns + step, point.level, count)
        there = None if found is None else self._slope_or_none(found)
        if found is None or there is None or there.neutral < count:
            return False
        # what moves need not be the tip
        turned = point.turned[: len(point.forces)] @ (found.unknowns - point.unknowns)
        return bool(abs(mode @ turned) >= 0.5 * turn)

    def _along(self, start: Point, neutral: int) -> Run:
        """The last point on the branch through one, of level 1 if it leads there."""
        points, halved, taken = [start], False, 0
        step = min(self._longest(start.level), self._overshoot(start))
        surprise: FloatArray | None = None
        while points[0].level < 1 and taken < self.max_steps:
            taken += 1
            last = points[0]
            goal = min(1.0, last.level + step)
            expected = _extrapolated(points, goal)
            found, contraction = yield from self._correct(expected, goal, neutral)
            same = found is not None and contraction <= CONTRACTION and alike(found.gamma, last.gamma, neutral)
            if same and (len(points) < 2 or _foreseen(found.unknowns, expected, last.unknowns, surprise)):
                growth = (0.5 * CONTRACTION / max(contraction, 1e-6)) ** (1 / len(points))
                step = min((goal - last.level) * float(np.clip(growth, 0.5, 1.0 if halved else FASTER)), self._longest(goal))
                points, halved, surprise = [found, *points[:2]], False, None
                continue
            surprise = found.unknowns if same and found is not None else None
            step, halved = 0.5 * (goal - last.level), True
            if step < MIN_STEP:
                break
        return points[0]

    def _released(self, point: Point, neutral: int) -> Run:
        """The end of the way from a point next to it, where symmetry leaves modes neutral there that rounded kinks held until
        then, and how many; the point itself where that is not so."""
        slope = self._slope_or_none(point) if self.has_tip and not self.by_inputs else None
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
        return OVERSHOOT if self.by_inputs else OVERSHOOT * max(point.level, OVERSHOOT)

    def _longest(self, level: float) -> float:
        return min(max(self.safe_step, GROWTH * level), self.most_step)

    def _correct(self, unknowns: FloatArray, level: float, neutral: int) -> Run:
        """(7) Newton's method, without steps along ``neutral`` modes: the point, None where it fails, and its contraction."""
        contraction, size = 0.0, np.inf
        for k in range(NEWTON_STEPS):
            point = yield from self._at(unknowns, level)
            self.iterations += 1
            if not np.isfinite(point.size) or not np.isfinite(point.gamma).all():
                break
            # one step at least, as what is within the tolerance by chance tells the next step along the branch nothing
            if point.size <= (self.tolerance if k else POLISHED * self.tolerance):
                return point, contraction
            move = _least_step(point, neutral)
            if move is None:
                break
            before, size = size, float(np.linalg.norm(move))
            if k and size > 1e-10 * float(np.linalg.norm(unknowns)):
                contraction = max(contraction, size / before)
            if contraction > CONTRACTION and neutral == 0:
                break
            unknowns = unknowns + move
        return None, np.inf


def _least_step(point: Point, neutral: int) -> FloatArray | None:
    """(7) Newton's step without its part along ``neutral`` modes; None where another is singular."""
    if not neutral:
        try:
            return np.asarray(-np.linalg.solve(point.gamma, point.residual))
        except np.linalg.LinAlgError:
            return None
    u, s, v = np.linalg.svd(point.gamma)
    kept = slice(0, len(s) - neutral)
    return None if s[kept][-1] == 0 else np.asarray(-v[kept].T @ ((u[:, kept].T @ point.residual) / s[kept]))


def _extrapolated(points: list[Point], level: float) -> FloatArray:
    """Unknowns by the polynomial through the last points."""
    result = np.zeros_like(points[0].unknowns)
    for i, point in enumerate(points):
        weights = [(level - other.level) / (point.level - other.level) for k, other in enumerate(points) if k != i]
        result = result + float(np.prod(weights)) * point.unknowns
    return result


def _foreseen(found: FloatArray, expected: FloatArray, last: FloatArray, surprise: FloatArray | None) -> bool:
    """Whether a point lies where the extrapolation led, or half as far as that of twice the step, which did not."""
    moved, size = float(np.linalg.norm(found - last)), float(np.linalg.norm(found))
    if np.linalg.norm(found - expected) <= SURPRISE * moved + 1e-6 * (1 + size):
        return True
    return surprise is not None and bool(np.linalg.norm(found - 0.5 * (last + surprise)) <= 0.5 * SURPRISE * moved)


def alike(gamma: FloatArray, before: FloatArray, neutral: int) -> bool:
    """``goes_on`` without the modes that are neutral all along."""
    if neutral:
        if np.linalg.svd(gamma, compute_uv=False)[-neutral] > SOFT:
            return False  # another branch, which has not that symmetry
        u, _, v = np.linalg.svd(before)
        u, v = u[:, :-neutral], v[:-neutral].T
        gamma, before = u.T @ gamma @ v, u.T @ before @ v
    return goes_on(gamma, before)
