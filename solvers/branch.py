"""One branch of equilibria by its arclength, through folds, and where its stability changes."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scipy.optimize import brentq

from multirod.problem import BoundaryProblem
from multirod.stability import NEUTRAL, Modes
from multirod.validation import FloatArray

ITERATIONS = 8
CONTRACTION = 0.3  # largest ratio of successive Newton steps
TURN = 0.9  # smallest cosine between the tangents at both ends of a step
FIRST_STEP = 0.25
GROWTH = 0.1  # longest step beyond 1, over the way from where the loads are zero
SMALLEST_STEP = 1e-7
SINGULAR = 1e-7  # of the largest singular value: what is smaller is a bifurcation's, and left alone
BRANCHES = 32  # followed from one start
BRANCH_STEPS = 80
ASIDE = 0.05  # how far from a bifurcation the crossing branch is met
SAME = 1e-5  # of a step: changes no further apart are one, of several modes
NUDGE = 1e-7  # of a step
LEVEL = 1e-3  # slope of the load along the branch under which it has a fold


@dataclass(frozen=True)
class Point:
    """An equilibrium on a branch.

    Attributes:
        place: Unknowns times a length, then the load factor in its unit, shape (n + 1,).
        tangent: Of the branch, unit length, shape (n + 1,).
        gamma: Shape (n, n).
        modes: Of the one instance.
    """

    place: FloatArray
    tangent: FloatArray
    gamma: FloatArray
    modes: Modes

    @property
    def index(self) -> int:
        """Unstable modes, one that is nearly neutral by its sign."""
        return int(self.modes.hidden[0] + (self.modes.values[0] < 0).sum())


@dataclass(frozen=True)
class Change:
    """Where a branch loses or regains stability.

    Attributes:
        point: There.
        fold: Whether the load turns there, else another branch crosses.
        before: Unstable modes before.
        after: And after.
    """

    point: Point
    fold: bool
    before: int
    after: int


class BranchLost(RuntimeError):
    """The branch could not be followed further; the message says where and why."""


class Branch:
    """The equilibria of a problem of one instance whose inputs are ``start + factor * rate``, from an equilibrium on.

    Args:
        problem: With one instance and one direction.
        start: Inputs where the load factor is 0, shape (input_count,).
        rate: Their change by the load factor, shape (input_count,).
        length: By which unknowns are made numbers [m].
        unit: Load factor that matters, by which it is counted.
        tolerance: Largest residual [1/m].
    """

    def __init__(
        self, problem: BoundaryProblem, start: FloatArray, rate: FloatArray, *, length: float, unit: float, tolerance: float
    ) -> None:
        self.problem = problem
        self.start, self.rate = start, rate
        self.scale = np.append(np.full(problem.unknown_count, 1 / length), unit)
        self.tolerance = tolerance
        problem.directions.assign(rate[None, None, :])
        problem.active.fill_(1)
        self._why = ""

    def first(self, unknowns: FloatArray) -> Point:
        """The equilibrium without load."""
        n = self.problem.unknown_count
        ahead = np.append(np.zeros(n), 1.0)
        return self._point(np.append(unknowns, 0.0) / self.scale, ahead)

    def factor(self, point: Point) -> float:
        """Load factor of a point."""
        return float(point.place[-1] * self.scale[-1])

    def unknowns(self, point: Point) -> FloatArray:
        """Unknowns of a point [1/m], shape (n,)."""
        return np.asarray(point.place[:-1] * self.scale[:-1])

    def changes(self, first: Point, count: int, up_to: float, max_steps: int) -> list[Change]:
        """Where the number of unstable modes changes, along the branch, as far as ``count`` and the load factor ``up_to``.

        Raises:
            BranchLost: If the branch cannot be followed so far.
        """
        found: list[Change] = []
        for before, after, step in self.steps(first, max_steps):
            found += self._between(before, after, step)
            if len(found) >= count or self.factor(after) > up_to:
                return found[:count]
        return found  # not reached: steps() ends by an error

    def connected(self, first: Point, factor: float) -> list[FloatArray]:
        """Unknowns near equilibria at a load factor, on the branch through ``first`` and on those that cross it on the way.

        Branches that cross are followed either way from each bifurcation with one or two neutral modes, and so are those that cross them.
        """
        found: list[FloatArray] = []
        open_ = [first]
        for _ in range(BRANCHES):
            if not open_:
                break
            try:
                for before, after, step in self.steps(open_.pop(0), BRANCH_STEPS):
                    a, b = (point.place[-1] - factor / self.scale[-1] for point in (before, after))
                    if a * b <= 0 and a != b:
                        found.append(self.unknowns(before) + a / (a - b) * (self.unknowns(after) - self.unknowns(before)))
                    for change in self._between(before, after, step):
                        open_ += self._crossing(change)
                    if not -0.1 * factor < self.factor(after) < 1.5 * factor:
                        break
            except BranchLost:
                continue
        return found

    def _crossing(self, change: Change) -> list[Point]:
        """First points, all ways, on the branches that cross at a bifurcation with one or two neutral modes."""
        count = abs(change.after - change.before)
        if change.fold or count > 2:
            return []
        modes = np.linalg.svd(change.point.gamma / self.scale[:-1])[2][-count:]
        angles = np.arange(0, 2 * np.pi, np.pi if count == 1 else np.pi / 6)
        result = []
        for way in np.column_stack([np.cos(angles), np.sin(angles)])[:, :count] @ modes:
            ahead = np.append(way, 0.0)
            found, _ = self._correct(change.point.place + ASIDE * ahead, ahead, np.inf)
            if found is not None and np.linalg.norm(found - change.point.place) < 2 * ASIDE:
                result.append(self._point(found, ahead))
        return result

    def steps(self, first: Point, max_steps: int) -> Iterator[tuple[Point, Point, float]]:
        """Follow the branch: each step's ends and its length along the tangent.

        Raises:
            BranchLost: If the branch cannot be followed further.
        """
        point, step = first, FIRST_STEP
        taken = 0
        while taken < max_steps:
            goal, contraction = self._try(point, step)
            if goal is None:
                step /= 2
                if step < SMALLEST_STEP:
                    raise BranchLost(f"beyond a load factor of {self.factor(point):.6g} {self._why}")
                continue
            yield point, goal, step
            point, taken = goal, taken + 1
            longest = 1 + GROWTH * float(np.abs(point.place[-1]))
            step = min(longest, step * float(np.clip(0.5 * CONTRACTION / max(contraction, 1e-6), 0.5, 2.0)))
        raise BranchLost(f"{max_steps} steps led to a load factor of {self.factor(point):.6g} only")

    def _between(self, before: Point, after: Point, step: float) -> list[Change]:
        """The changes of the index within a step, in their order; not of modes that are neutral at both ends."""
        low, high = min(before.index, after.index), max(before.index, after.index)
        ends = [(before.modes.eigenvalue(k)[0], after.modes.eigenvalue(k)[0]) for k in range(low, high)]
        places = [self._root(before, step, k) for k, e in zip(range(low, high), ends, strict=True) if np.abs(e).max() > NEUTRAL]
        result: list[Change] = []
        merged: list[tuple[float, int]] = []
        for place in sorted(places):
            if merged and place - merged[-1][0] < SAME * step:
                merged[-1] = (merged[-1][0], merged[-1][1] + 1)
            else:
                merged.append((place, 1))
        index, sign = before.index, 1 if after.index > before.index else -1
        for place, multiplicity in merged:
            point = self._at(before, place)
            fold = multiplicity == 1 and abs(point.tangent[-1]) < LEVEL
            result.append(Change(point, fold, index, index + sign * multiplicity))
            index += sign * multiplicity
        return result

    def _root(self, before: Point, step: float, k: int) -> float:
        """How far along a step eigenvalue ``k`` vanishes."""

        def value(place: float) -> float:
            e = float(self._at(before, place).modes.eigenvalue(k)[0])
            if np.isnan(e):  # a conjugate point stands right at the tip: not a little further
                e = float(self._at(before, place + NUDGE * step).modes.eigenvalue(k)[0])
            if np.isnan(e):
                raise BranchLost(f"stability is not known near a load factor of {self.factor(before):.6g}")
            return e / (1 + abs(e)) if np.isfinite(e) else float(np.sign(e))

        return float(brentq(value, 0.0, step, xtol=1e-12 * step, rtol=1e-14))

    def _at(self, before: Point, place: float) -> Point:
        """The point at a distance along the tangent."""
        if place == 0:
            return before
        found, _ = self._correct(before.place + place * before.tangent, before.tangent, np.inf)
        if found is None:
            raise BranchLost(f"Newton's method fails near a load factor of {self.factor(before):.6g}")
        return self._point(found, before.tangent)

    def _try(self, point: Point, step: float) -> tuple[Point | None, float]:
        """The equilibrium one step further, if it surely is on the same branch, and Newton's contraction."""
        found, contraction = self._correct(point.place + step * point.tangent, point.tangent, CONTRACTION)
        self._why = "Newton's method fails: the branch ends, or rounding hides it"
        if found is None:
            return None, contraction
        goal = self._point(found, point.tangent)
        if not goal.modes.known[0]:
            self._why = "stability is not known: the loads have no potential, tubes are rigid in torsion, or rounding hides it"
            return None, contraction
        if goal.tangent @ point.tangent < TURN:
            return None, contraction
        return goal, contraction

    def _correct(self, place: FloatArray, tangent: FloatArray, largest: float) -> tuple[FloatArray | None, float]:
        """Newton's method in the plane across the tangent, and its worst contraction."""
        size, contraction, begin = np.inf, 0.0, place
        for k in range(ITERATIONS):
            residual, matrix = self._evaluate(place)
            if residual is None:
                return None, np.inf
            if np.abs(residual).max() <= self.tolerance:
                return place, contraction
            right = np.append(-residual, -tangent @ (place - begin))
            move = np.linalg.lstsq(np.vstack([matrix, tangent]), right, rcond=SINGULAR)[0]
            before, size = size, float(np.linalg.norm(move))
            if k and size > 1e-7:
                contraction = max(contraction, size / before)
            if contraction > largest:
                return None, contraction
            place = place + move
        return None, np.inf

    def _evaluate(self, place: FloatArray) -> tuple[FloatArray | None, FloatArray]:
        """Residual [1/m] and its derivative by the place, (n, n + 1)."""
        problem, values = self.problem, place * self.scale
        problem.write("inputs", self.start + values[-1] * self.rate)
        residual, gamma = problem.evaluate(values[None, :-1])
        if not np.isfinite(residual).all():
            return None, gamma
        slope = np.array(problem.residual_directions.numpy())[0]
        return residual[0], np.concatenate([gamma[0], slope], axis=1) * self.scale

    def _point(self, place: FloatArray, ahead: FloatArray) -> Point:
        """The point at an equilibrium, its tangent pointing the way that ``ahead`` does."""
        _, matrix = self._evaluate(place)
        # where a branch crosses, several directions are tangent: the one ahead is this branch's
        _, values, vectors = np.linalg.svd(matrix)
        kept = np.append(values, 0.0) <= SINGULAR * values[0]
        tangent = vectors[kept].T @ (vectors[kept] @ ahead)
        tangent /= np.linalg.norm(tangent)
        return Point(place, tangent, matrix[:, :-1] / self.scale[:-1], self.problem.modes())
