"""Estimates where lines turn slack or taut, whose rows have a kink there. Numbers in parentheses: ``docs/estimation.md``."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import product
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from multirod.status import Status
from multirod.tasks.estimating.bounded import Bounds
from multirod.tasks.estimating.inference import SETTLED, posterior, units
from multirod.tasks.formulation import Evaluation
from multirod.tasks.limits import LimitRows
from multirod.validation import FloatArray

if TYPE_CHECKING:
    from multirod.tasks.estimating.iteration import Part

AT_KINK = 1e-6  # of the scale of curvatures: lines that their kinks hold back
NEARBY = 3.0  # standard deviations of a line's unknown, from its kink, within which the other side is looked at at least
HAIR = 1e-6  # times one over the scale of curvatures: by which lines are let out that are to be at their kinks [m]
ASIDE = 1e-12  # of it, where columns are those of one side
MOST_BOTH = 6  # lines that are looked at so, in all their ways
SPENT = 5  # integrations for each step that is allowed
LONGEST = 2.0  # of the scale of curvatures, that unknowns may change by in a step
NEWTON = 8  # steps to an equilibrium
HALVINGS = 12
ENDLESS = int(Status.MAX_ITERATIONS), int(Status.STALLED)
SEEN = 0.5  # part of its variance by the prior, that a line's unknown keeps of which nothing much was told
DECREASE = 1e-4  # part of what a step is to take off (1), that it takes off


@dataclass(frozen=True)
class _Here:
    """An equilibrium, and (1) there."""

    x: FloatArray
    p: FloatArray
    told: "_Told"
    square: float


class _Told(NamedTuple):
    """What one integration says of an instance, without its axis: ``eps``, ``Gamma``, slopes, and the rows with derivatives."""

    residual: FloatArray
    gamma: FloatArray
    slopes: FloatArray
    errors: FloatArray
    by_unknowns: FloatArray
    by_free: FloatArray


@dataclass(frozen=True)
class _Step:
    """(20) The step of least squares with each line on one side."""

    x: FloatArray  # where the equilibrium is without one, to first order
    by: FloatArray
    d: FloatArray
    length: float
    left: float  # of (1)
    covariance: FloatArray
    spread: float  # the sum of its variances, in units
    sound: bool  # whether it leaves each line on its side


class Kinked:
    """(20) Goes on where a part of a batch has come to no end, at equilibria alone, each line kept on its side of its kink until
    it is there.

    Args:
        part: Whose problem has kinks.
    """

    def __init__(self, part: "Part") -> None:
        self._part, self._kinks = part, part.task.problem.kinks
        self._scale = part.task.problem.curvature_scale()

    def run(self, chosen: NDArray[np.bool_]) -> None:
        """Seek an end of what came to none of those chosen (b,), one after another; look across from ends beside a slack line."""
        part = self._part
        endless = chosen & np.isin(part.outcome.status, ENDLESS) & np.isfinite(part.square)
        ended = chosen & (part.outcome.status == Status.CONVERGED)
        for row in np.flatnonzero(endless).tolist():
            here = self._settled(row, part.x[row], part.p[row])
            if here is None and part.based[row]:
                here = self._settled(row, part.base["x"][row], part.base["p"][row])
            self._one(row, here)
        for row in np.flatnonzero(ended & self._beside()).tolist():
            here = self._settled(row, part.x[row], part.p[row])
            if here is None or not self._one(row, here):
                self._evaluated(row, part.x[row], part.p[row])  # what is left is told of there
        near = self._may_be_slack() & (part.outcome.status == Status.CONVERGED)[:, None]
        for row in np.flatnonzero(chosen & near.any(axis=1)).tolist():
            self._doubt(row, near[row])

    def _beside(self) -> NDArray[np.bool_]:
        """(20b) Whether a line is slack that may be taut, and of whose slack nothing much was told; shape (b,)."""
        part, K = self._part, self._kinks
        by, z = part.by[:, K], part.x[:, K]
        with np.errstate(invalid="ignore"):
            known, before = (np.einsum("bki,bij,bkj->bk", by, own, by) for own in (part.covariance, part.prior))
            may_pay = z**2 <= np.maximum(NEARBY**2, part.square)[:, None] * known
            unseen = (z <= AT_KINK * self._scale[:, None]) & (known >= SEEN * before) & may_pay
        return np.asarray(unseen.any(axis=1))

    def _may_be_slack(self) -> NDArray[np.bool_]:
        """(20d) Which lines are taut, and so near their kinks that they may be slack as well; shape (b, line)."""
        part, K = self._part, self._kinks
        by, z = part.by[:, K], part.x[:, K]
        with np.errstate(invalid="ignore"):
            known = np.einsum("bki,bij,bkj->bk", by, part.covariance, by)
            return np.asarray((z > 0) & (z**2 <= NEARBY**2 * known))

    def _doubt(self, row: int, lines: NDArray[np.bool_]) -> None:
        """Take the covariance of the side on which these lines (line,) are slack, where that is the less sure one."""
        part, x, p = self._part, self._part.x[row].copy(), self._part.p[row]
        x[self._kinks[lines]] = -ASIDE * self._scale[row]
        here = _Here(x, p, self._told(row, self._evaluated(row, x, p)), float(part.square[row]))
        there = self._step(row, here, x, here.told, x[self._kinks] > 0)
        if there is not None and (np.diagonal(there.covariance) / np.diagonal(part.covariance[row])).sum() > len(p):
            part.covariance[row] = there.covariance
        self._evaluated(row, part.x[row], p)

    def _one(self, row: int, here: _Here | None) -> bool:
        """From an equilibrium of an instance; whether it came to an end."""
        part, moved = self._part, False
        allowed = part.outcome.integrations[row] + SPENT * part.scene.max_iterations
        while here is not None and part.outcome.integrations[row] < allowed:
            here, own = self._own(row, here)
            if own is None:
                break
            if own.length > SETTLED:
                here = self._gone(row, here, own)
                moved |= here is not None
                part.outcome.iterations[row] += 1
                continue
            there, covariance = self._across(row, here, own)
            if there is None:
                if covariance is None:
                    break
                part.by[row] = own.by
                self._end(row, here, covariance)
                return True
            here, moved = there, True
        if moved and part.outcome.status[row] == Status.CONVERGED:
            part.outcome.status[row] = Status.MAX_ITERATIONS  # something is more probable than where it ended
        return False

    def _own(self, row: int, here: _Here) -> tuple[_Here, _Step | None]:
        """The step with each line on its side; where that is no way, as of lines that do not stretch if all are taut, with those
        slack that are at their kinks."""
        own, z = self._step(row, here, here.x, here.told, here.x[self._kinks] > 0), here.x[self._kinks]
        at = self._kinks[(z > 0) & (z <= AT_KINK * self._scale[row])]
        if own is None and len(at):
            x = here.x.copy()
            x[at] = -ASIDE * self._scale[row]
            here = replace(here, x=x, told=self._told(row, self._evaluated(row, x, here.p)))
            own = self._step(row, here, x, here.told, x[self._kinks] > 0)
        return here, own

    def _across(self, row: int, here: _Here, own: _Step) -> tuple[_Here | None, FloatArray | None]:
        """Where (1) is less on the other sides of kinks, from an end on this side; None if nowhere, then the covariance there,
        None too if it should be less."""
        K, away = self._kinks, np.abs((own.x + own.by @ own.d)[self._kinks])
        spread = np.sqrt(np.maximum(np.einsum("ki,ij,kj->k", own.by[K], own.covariance, own.by[K]), 0.0))
        at = away <= AT_KINK * self._scale[row]
        most = max(NEARBY, np.sqrt(here.square))
        held, near = np.flatnonzero(at), np.flatnonzero(~at & ~(away > most * spread))
        ends = [own]
        for lines in [held] * bool(len(held)) + [np.append(held, line) for line in near]:
            if len(lines) > MOST_BOTH:
                continue
            found = [step for step in self._both(row, here, lines) if step is not None and step.sound]
            less = [step for step in found if step.length > SETTLED and step.left <= here.square - SETTLED**2]
            for step in sorted(less, key=lambda step: step.left):
                there = self._gone(row, here, step)
                if there is not None:
                    return there, None
            if less and lines is held:
                return None, None
            if lines is held:
                ends += [step for step in found if step.length <= SETTLED]
        return None, max(ends, key=lambda step: step.spread).covariance

    def _gone(self, row: int, here: _Here, step: _Step) -> _Here | None:
        """As far along a step as (1) falls; None if it does not."""
        moved, K = step.by @ step.d, self._kinks
        moved[K] = np.maximum(step.x[K] + moved[K], 0.0) - np.maximum(here.x[K], 0.0)  # what is slack moves nothing
        part = 1.0 / max(1.0, np.abs(moved).max() / (LONGEST * self._scale[row]))
        hair = self._hair(row, np.abs((step.x + step.by @ step.d)[K]) <= AT_KINK * self._scale[row])
        for _ in range(HALVINGS):
            p = self._part.bounds.kept((here.p + part * step.d)[None], here.p[None])[0]
            there = self._settled(row, step.x + step.by @ (p - here.p), p)
            if there is None and hair.any():
                there = self._settled(row, step.x + step.by @ (p - hair - here.p), p - hair)
            if there is not None and there.square <= here.square - DECREASE * part * max(here.square - step.left, 0.0):
                return there
            part /= 2
        return None

    def _hair(self, row: int, lines: NDArray[np.bool_]) -> FloatArray:
        """By which freed inputs (k,) let out some lines, of which a step leads to their kinks: beyond its first order, those that
        do not stretch may have no equilibrium there."""
        task, drives = self._part.task, self._part.task.problem.kink_inputs
        own = drives[lines] if len(drives) == len(lines) else drives[:0]  # one drive may be of several lines
        return np.asarray(HAIR / self._scale[row] * np.isin(task.places, own))

    def _settled(self, row: int, x: FloatArray, p: FloatArray) -> _Here | None:
        """The equilibrium at ``p`` (k,), by Newton's method from ``x`` (n,)."""
        part, x = self._part, np.array(x)
        for _ in range(NEWTON):
            found = self._evaluated(row, x, p)
            if found.failed.any() or not np.abs(found.residual).max() <= part.sharpest[row]:
                return None
            if np.abs(found.residual).max() <= part.tolerance[row]:
                told, away = self._told(row, found), p - part.mean[row]
                square = (told.errors**2).sum() + ((part.root[row] @ away) ** 2).sum()
                return _Here(x, np.array(p), told, float(square))
            towards = found.eliminated[0][0]
            if not np.abs(towards).max() <= LONGEST * self._scale[row]:
                return None
            x = x + towards
        return None

    def _evaluated(self, row: int, x: FloatArray, p: FloatArray) -> Evaluation:
        part, chosen = self._part, np.zeros(self._part.count, dtype=bool)
        every_x, every_p = part.x.copy(), part.p.copy()
        every_x[row], every_p[row], chosen[row] = x, p, True
        part.outcome.integrations[row] += 1
        return part.task.evaluate(every_x, every_p, chosen)

    def _told(self, row: int, found: Evaluation) -> _Told:
        rows = self._part.measured.told(found, slice(row, row + 1))
        return _Told(*(np.array(own[0]) for own in (found.residual, found.gamma, found.slopes, *rows)))

    def _both(self, row: int, here: _Here, held: NDArray[np.intp]) -> Iterator[_Step | None]:
        """The steps with some lines at their kinks, and from there taut or slack in all ways."""
        K, x, told, pulls = self._kinks, here.x.copy(), [], here.x[self._kinks] > 0
        for sense in (-1.0, 1.0):
            x[K[held]] = sense * ASIDE * self._scale[row]
            told.append(self._told(row, self._evaluated(row, x, here.p)))
        x[K[held]] = 0.0
        slack, taut = told
        for sides in product((False, True), repeat=len(held)):
            pulls[held] = sides
            own = K[held[list(sides)]]
            gamma, by = slack.gamma.copy(), slack.by_unknowns.copy()
            gamma[:, own], by[:, own] = taut.gamma[:, own], taut.by_unknowns[:, own]
            yield self._step(row, here, x, slack._replace(gamma=gamma, by_unknowns=by), pulls)

    def _step(self, row: int, here: _Here, x: FloatArray, told: _Told, pulls: NDArray[np.bool_]) -> _Step | None:
        """(20) With the lines that ``pulls`` (line,) names taut, the others slack, from ``x`` (n,); None where that is no way."""
        part, K, p = self._part, self._kinks, here.p
        try:
            solved = -np.asarray(np.linalg.solve(told.gamma, np.column_stack([told.residual, told.slopes])), dtype=np.float64)
        except np.linalg.LinAlgError:
            return None
        a, B = solved[:, 0], solved[:, 1:]
        r, J = told.errors + told.by_unknowns @ a, told.by_free + told.by_unknowns @ B
        if not (np.isfinite(r).all() and np.isfinite(J).all()):
            return None
        root, away, prior = part.root[row], p - part.mean[row], part.prior[row : row + 1]
        unit = units(J[None], prior)
        rows = J[None], r[None], root[None], away[None], unit
        planned = posterior(*rows)
        d, length = self._bounds(p, x[K] + a[K], B[K], pulls).step(planned, p[None], rows)
        left = ((r + J @ d[0]) ** 2).sum() + ((root @ (away + d[0])) ** 2).sum()
        beyond = (x + a + B @ d[0])[K] * np.where(pulls, -1.0, 1.0)
        spread = float((np.diagonal(planned.covariance[0]) / unit[0] ** 2).sum())
        sound = bool((beyond <= AT_KINK * self._scale[row]).all())
        return _Step(x + a, B, d[0], float(length[0]), float(left), planned.covariance[0], spread, sound)

    def _bounds(self, p: FloatArray, z: FloatArray, by: FloatArray, pulls: NDArray[np.bool_]) -> Bounds:
        """The limits of the robot, and that each line stays on its side, where ``z + by d`` of them is 0."""
        limits, end = self._part.bounds.rows, by @ p - z
        low = np.concatenate([limits.low, np.where(pulls, end, -np.inf)])
        high = np.concatenate([limits.high, np.where(pulls, np.inf, end)])
        names: Sequence[str] = [f"line {j}" for j in range(len(z))]
        rows = LimitRows(np.concatenate([limits.matrix, by]), low, high, (*limits.names, *names))
        return Bounds(rows, self._part.bounds.unit)

    def _end(self, row: int, here: _Here, covariance: FloatArray) -> None:
        """Leave an instance there."""
        part = self._part
        self._evaluated(row, here.x, here.p)
        part.x[row], part.p[row], part.square[row], part.covariance[row] = here.x, here.p, here.square, covariance
        part.outcome.status[row] = Status.CONVERGED
