"""What takes instances many integrations, of many at once: Newton's method, and along a branch.

Every instance takes the steps that it would take alone. Numbers in parentheses are those of ``docs/branches.md``.
"""

from collections.abc import Callable, Sequence
from contextlib import suppress
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from multirod.batch import IntArray
from multirod.solvers.continuation.acceptance import CONTRACTION, MIN_STEP, SURPRISE, same_branch
from multirod.solvers.continuation.pace import PACED, creeps
from multirod.solvers.following.descent import SOFT, Point, Points, norms
from multirod.solvers.following.serving.requests import Answer, Correct, Run, Trace
from multirod.solvers.following.valley import FLOOR
from multirod.validation import FloatArray

BoolArray = NDArray[np.bool_]

NEWTON_STEPS = 8
SLOW_STEPS = 16  # of what may contract slowly
LED = 60  # the same, and parts of these, by which other equations lead to their own
BALANCED = 1e-3  # of the tolerance: what needs no step
GROWTH = 0.5  # of the way, that the next step may be
FASTER = 3.0
NEARER = 0.7  # of the way to where a mode vanishes, that a step goes at most: to the fourth part of Gamma and no further


class Server(Protocol):
    """What integrates."""

    def evaluate(self, places: IntArray, unknowns: FloatArray, level: FloatArray) -> tuple[FloatArray, FloatArray, BoolArray]:
        """Integrate instances (k,) at unknowns (k, n) and levels (k,): residual (k, n), NaN where it failed, ``Gamma`` (k, n, n),
        and which have taken all steps along their rods that they may, (k,)."""
        ...

    def points(self, places: IntArray) -> Points:
        """All that the last integration said of some of its instances."""
        ...

    def reasons(self, places: IntArray) -> IntArray:
        """Why the last integration of some of them failed, values of ``Status``, (k,)."""
        ...


class _Corrections:
    """What came of Newton's method of many.

    Attributes:
        found: Points of those that came to an equilibrium.
        contraction: Shape (k,); infinite of the others.
        unknowns, gamma: Of those that did.
        integrations: Shape (k,).
        spent: Shape (k,).
    """

    def __init__(self, unknowns: FloatArray) -> None:
        count, n = unknowns.shape
        self.found: list[Point | None] = [None] * count
        self.contraction = np.full(count, np.inf)
        self.unknowns, self.gamma = np.array(unknowns), np.zeros((count, n, n))
        self.integrations, self.spent = np.zeros(count, dtype=np.int64), np.zeros(count, dtype=bool)

    @property
    def there(self) -> BoolArray:
        return np.array([own is not None for own in self.found], dtype=bool)


def correct(server: Server, asked: dict[int, Correct]) -> dict[int, Answer]:
    """Newton's method from each."""
    places, all_ = np.array(list(asked)), list(asked.values())
    found = _correct(
        server,
        places,
        np.array([one.unknowns for one in all_]),
        np.array([one.level for one in all_]),
        np.array([one.neutral for one in all_]),
        np.array([one.tolerance for one in all_]),
        np.array([one.left for one in all_]),
        np.array([one.aside for one in all_]),
        np.array([one.any_contraction for one in all_]),
    )
    answers = {}
    for i, place in enumerate(places.tolist()):
        taken = int(found.integrations[i])
        answers[place] = Answer(found.found[i], taken, taken, bool(found.spent[i]), float(found.contraction[i]))
    return answers


def _correct(
    server: Server,
    places: IntArray,
    unknowns: FloatArray,
    level: FloatArray,
    neutral: IntArray,
    tolerance: FloatArray,
    left: IntArray,
    aside: BoolArray,
    any_contraction: BoolArray | bool = False,
) -> _Corrections:
    """(7) Newton's method, without steps along ``neutral`` modes, and ``aside`` from what is missing along these; the first axis
    of all is the instance."""
    result, count = _Corrections(unknowns), len(places)
    unknowns, on = np.array(unknowns), np.ones(count, dtype=bool)
    contraction, size = np.zeros(count), np.full(count, np.inf)
    slow = (neutral != 0) | any_contraction
    most = np.where(np.broadcast_to(any_contraction, count), SLOW_STEPS, NEWTON_STEPS)
    for k in range(int(most.max(initial=0))):
        result.spent |= on & (result.integrations >= left) & (k < most)
        on &= ~result.spent & (k < most)
        now = np.flatnonzero(on)
        if not len(now):
            break
        residual, gamma, over = server.evaluate(places[now], unknowns[now], level[now])
        result.integrations[now] += 1
        result.spent[now] = over
        largest = np.abs(_across(residual, gamma, neutral[now] * aside[now])).max(axis=1)
        sound = np.isfinite(largest) & np.isfinite(gamma).all(axis=(1, 2)) & ~over
        # one step at least, as what is within the tolerance by chance tells the next step along the branch nothing
        there = sound & (largest <= (tolerance[now] if k else BALANCED * tolerance[now]))
        if there.any():
            points = server.points(places[now[there]])
            for row, i in enumerate(now[there].tolist()):
                result.found[i] = points[row]
            result.contraction[now[there]] = contraction[now[there]]
            result.unknowns[now[there]], result.gamma[now[there]] = unknowns[now[there]], gamma[there]
        on[now[~sound | there]] = False
        moves = sound & ~there
        now, residual, gamma = now[moves], residual[moves], gamma[moves]
        move = _least_steps(residual, gamma, neutral[now])
        able = np.isfinite(move).all(axis=1)
        before, size[now] = size[now], norms(move)
        if k:
            longer = size[now] > 1e-10 * norms(unknowns[now])
            with np.errstate(divide="ignore", invalid="ignore"):
                contraction[now] = np.where(longer, np.fmax(contraction[now], size[now] / before), contraction[now])
        able &= (contraction[now] <= CONTRACTION) | slow[now]
        on[now[~able]] = False
        unknowns[now[able]] += move[able]
    return result


def led_to(at: Callable[[FloatArray, float], Run], unknowns: FloatArray, tolerance: float) -> Run:
    """(22) The equilibrium at the end of the way near unknowns (n,) of other equations, by parts of Newton's steps; None where
    these lead to none."""
    point, share = (yield from at(unknowns, 1.0)), 1.0
    for _ in range(LED):
        move, left = _least_steps(point.residual[None], point.gamma[None], np.zeros(1, dtype=int)), np.inf
        trial = yield from at(point.unknowns + share * move[0], 1.0)
        if np.isfinite(trial.residual).all():
            left = norms(_least_steps(trial.residual[None], point.gamma[None], np.zeros(1, dtype=int)))[0]
        if not left <= (1 - 0.5 * share) * norms(move)[0]:
            share *= 0.5
            continue
        point, share = trial, min(1.0, 2 * share)
        if point.size <= tolerance:
            return point
    return None


def _least_steps(residual: FloatArray, gamma: FloatArray, neutral: IntArray) -> FloatArray:
    """(7) Newton's steps without their parts along ``neutral`` modes, (k, n); NaN where another is singular."""
    result = np.full_like(residual, np.nan)
    for count in set(neutral.tolist()):
        own = neutral == count
        if count:
            u, s, v = np.linalg.svd(gamma[own])
            kept = s.shape[1] - count
            with np.errstate(divide="ignore", invalid="ignore"):
                along = (u[:, :, :kept].swapaxes(1, 2) @ residual[own, :, None])[..., 0] / s[:, :kept]
                result[own] = (-v[:, :kept].swapaxes(1, 2) @ along[..., None])[..., 0]
            continue
        try:
            result[own] = -np.linalg.solve(gamma[own], residual[own, :, None])[..., 0]
        except np.linalg.LinAlgError:
            for i in np.flatnonzero(own).tolist():
                with suppress(np.linalg.LinAlgError):
                    result[i] = -np.linalg.solve(gamma[i], residual[i])
    return result


def _across(residual: FloatArray, gamma: FloatArray, aside: IntArray) -> FloatArray:
    """Residuals (k, n) without what is missing along so many of the last singular vectors of each ``Gamma``."""
    result = np.array(residual)
    for i in np.flatnonzero((aside > 0) & np.isfinite(gamma).all(axis=(1, 2))).tolist():
        along = np.linalg.svd(gamma[i])[0][:, -aside[i] :]
        result[i] -= along @ (along.T @ residual[i])
    return result


def trace(server: Server, asked: dict[int, Trace]) -> dict[int, Answer]:
    """Along the branch through each start: the last point on it, of level 1 if it leads there."""
    places, all_ = np.array(list(asked)), list(asked.values())
    walk = _Traces(server, places, all_)
    while walk.goes_on():
        walk.step()
    answers = {}
    for i, place in enumerate(places.tolist()):
        taken = int(walk.integrations[i])
        answers[place] = Answer(walk.at[i], taken, taken, bool(walk.spent[i]))
    return answers


class _Traces:
    """Many on their way along branches, all of which take a step at a time.

    Attributes:
        at: The last point of each.
        integrations: Shape (k,).
        spent: Shape (k,).
    """

    def __init__(self, server: Server, places: IntArray, asked: Sequence[Trace]) -> None:
        self.server, self.places = server, places
        count, n = len(places), len(asked[0].start.unknowns)
        self.neutral, self.left = (np.array([getattr(one, name) for one in asked]) for name in ("neutral", "left"))
        self.most, self.tolerance = (np.array([getattr(one, name) for one in asked]) for name in ("most", "tolerance"))
        self.aside, self.loud = (np.array([getattr(one, name) for one in asked]) for name in ("aside", "loud"))
        self.safe, self.longest = (np.array([getattr(one, name) for one in asked]) for name in ("safe", "longest"))
        self.at: list[Point] = [one.start for one in asked]
        self.gamma = np.array([one.start.gamma for one in asked])
        # the last three points, the last one first
        self.unknowns, self.levels = np.zeros((count, 3, n)), np.zeros((count, 3))
        self.unknowns[:, 0] = [one.start.unknowns for one in asked]
        self.levels[:, 0] = [one.start.level for one in asked]
        self.known = np.ones(count, dtype=np.intp)
        self.origins = np.full(count, np.nan)
        for k, one in enumerate(asked):
            if one.origin is not None:
                self.unknowns[k, 1], self.levels[k, 1], self.known[k] = one.origin.unknowns, one.origin.level, 2
                self.origins[k] = one.origin.level
        self.steps = np.minimum(self._longest(np.arange(count), self.levels[:, 0]), [one.first for one in asked])
        self.surprise, self.halved = np.full((count, n), np.nan), np.zeros(count, dtype=bool)
        self.on, self.taken = np.ones(count, dtype=bool), np.zeros(count, dtype=np.intp)
        self.passed = self.levels[:, 0].copy()  # when its last ``PACED`` steps began
        self.integrations, self.spent = np.zeros(count, dtype=np.int64), np.zeros(count, dtype=bool)

    def goes_on(self) -> bool:
        """Whether some do."""
        self.on &= (self.levels[:, 0] < 1) & (self.taken < self.most) & ~self.spent
        self.on &= np.linalg.norm(self.gamma, axis=(1, 2)) <= self.loud
        return bool(self.on.any())

    def step(self) -> None:
        """A step of each."""
        now = np.flatnonzero(self.on)
        self.taken[now] += 1
        last, unknowns = self.levels[now, 0], self.unknowns[now, 0]
        goal = np.minimum(1.0, last + self.steps[now])
        expected = self._extrapolated(now, goal)
        left = self.left[now] - self.integrations[now]
        more = self.neutral[now], self.tolerance[now], left, self.aside[now]
        found = _correct(self.server, self.places[now], expected, goal, *more)
        self.integrations[now] += found.integrations
        self.spent[now] = found.spent
        same = found.there & (found.contraction <= CONTRACTION)
        soft = np.where(self.aside[now[same]], FLOOR, SOFT)
        same[same] = all_alike(found.gamma[same], self.gamma[now[same]], self.neutral[now[same]], soft)
        good = same & ((self.known[now] < 2) | self._foreseen(now, found.unknowns, expected, unknowns))
        for i in np.flatnonzero(good).tolist():
            k, own = int(now[i]), found.found[i]
            assert own is not None  # or it would not be good
            growth = (0.5 * CONTRACTION / max(float(found.contraction[i]), 1e-6)) ** (1 / int(self.known[k]))
            most = 1.0 if self.halved[k] else FASTER
            self.steps[k] = (goal[i] - last[i]) * min(max(growth, 0.5), most)
            self.at[k] = own
        some, none = now[good], now[~good]
        self.steps[some] = np.minimum(self.steps[some], self._longest(some, goal[good]))
        self.steps[none] = 0.5 * (goal - last)[~good]
        rest = self._rest(now, found, good, goal - last)
        self.steps[now] = np.minimum(self.steps[now], NEARER * rest)
        self.unknowns[some, 1:], self.levels[some, 1:] = self.unknowns[some, :2], self.levels[some, :2]
        self.unknowns[some, 0], self.levels[some, 0] = found.unknowns[good], goal[good]
        self.known[some] = np.minimum(self.known[some] + 1, 3)
        self.gamma[some] = found.gamma[good]
        self.halved[some], self.surprise[some] = False, np.nan
        self.surprise[none] = np.where(same[~good, None], found.unknowns[~good], np.nan)
        self.halved[none] = True
        self.on[now[(self.steps[now] < MIN_STEP) & (~good | np.isfinite(rest))]] = False
        self._give_up(now[self.taken[now] % PACED == 0])

    def _give_up(self, some: IntArray) -> None:
        """(18) What creeps."""
        level, left = self.levels[some, 0], self.most[some] - self.taken[some]
        self.on[some[creeps(level, level - self.passed[some], np.full(len(some), PACED), left)]] = False
        self.passed[some] = level

    def _rest(self, now: IntArray, found: _Corrections, good: BoolArray, step: FloatArray) -> FloatArray:
        """How far from where each stands now ``det Gamma`` would vanish, by its last change; infinite where it would not."""
        before, after = np.linalg.det(self.gamma[now]), np.linalg.det(found.gamma)
        told = found.there & (found.contraction <= CONTRACTION) & (self.neutral[now] == 0)
        with np.errstate(divide="ignore", invalid="ignore"):
            rest = step * before / (before - after) - np.where(good, step, 0.0)
        return np.where(told & (rest > 0), rest, np.inf)

    def _longest(self, some: IntArray, level: FloatArray) -> FloatArray:
        return np.asarray(np.minimum(np.maximum(self.safe[some], GROWTH * level), self.longest[some]))

    def _way(self, now: IntArray, level: FloatArray) -> FloatArray:
        """(12) By what unknowns change evenly: the level, or its root from where the branch left another; as ``level``."""
        origin = self.origins[now].reshape(-1, *([1] * (level.ndim - 1)))
        with np.errstate(invalid="ignore"):
            return np.where(np.isnan(origin), level, np.sqrt(np.maximum(level - origin, 0.0)))

    def _extrapolated(self, now: IntArray, level: FloatArray) -> FloatArray:
        """Unknowns by the polynomials through the last points."""
        result = np.zeros((len(now), self.unknowns.shape[2]))
        ways, goals = self._way(now, self.levels[now]), self._way(now, level)
        for known in set(self.known[now].tolist()):
            own = self.known[now] == known
            way, unknowns, goal = ways[own], self.unknowns[now[own]], goals[own]
            for i in range(known):
                weight = np.ones(len(goal))
                for k in range(known):
                    if k != i:
                        weight = weight * ((goal - way[:, k]) / (way[:, i] - way[:, k]))
                result[own] += weight[:, None] * unknowns[:, i]
        return result

    def _foreseen(self, now: IntArray, found: FloatArray, expected: FloatArray, last: FloatArray) -> BoolArray:
        """Whether points lie where the extrapolation led, or half as far as that of twice the step, which did not."""
        moved, size = norms(found - last), norms(found)
        near = norms(found - expected) <= SURPRISE * moved + 1e-6 * (1 + size)
        surprise = self.surprise[now]
        with np.errstate(invalid="ignore"):
            return near | (norms(found - 0.5 * (last + surprise)) <= 0.5 * SURPRISE * moved)


def all_alike(gamma: FloatArray, before: FloatArray, neutral: IntArray, most: FloatArray) -> BoolArray:
    """``same_branch`` without the modes that are neutral all along, so many of each, (k,), to ``most`` of a singular value."""
    result = np.zeros(len(gamma), dtype=bool)
    for count in set(neutral.tolist()):
        own = neutral == count
        after, earlier = gamma[own], before[own]
        if not count:
            result[own] = same_branch(after, earlier)
            continue
        soft = np.linalg.svd(after, compute_uv=False)[:, -count] <= most[own]  # else another branch, which has not that symmetry
        u, _, v = np.linalg.svd(earlier)
        u, v = u[:, :, :-count].swapaxes(1, 2), v[:, :-count].swapaxes(1, 2)
        result[own] = soft & same_branch(u @ after @ v, u @ earlier @ v)
    return result


def alike(gamma: FloatArray, before: FloatArray, neutral: int) -> bool:
    """The same of two, (n, n)."""
    return bool(all_alike(gamma[None], before[None], np.array([neutral]), np.array([SOFT]))[0])
