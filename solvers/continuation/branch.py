"""One branch of equilibria by its arclength, through folds, and where its stability changes."""

from collections.abc import Iterator

import numpy as np

from multirod.solvers.continuation.acceptance import CONTRACTION
from multirod.solvers.continuation.branch_equations import BranchEquations
from multirod.solvers.continuation.branch_step import CUTS, LOST, Apart, Change, Inspection, Point, Step, heights
from multirod.solvers.continuation.crossings import at, crossings, cubic
from multirod.stability import Modes
from multirod.validation import FloatArray

ITERATIONS = 8
TURN = 0.9  # smallest cosine between the tangents at both ends of a step
FIRST_STEP = 0.25
SMALLEST_STEP = 1e-7
SINGULAR = 1e-7  # of the largest singular value: what is smaller is a bifurcation's, and left alone
BRANCHES = 32  # followed from one start
BRANCH_STEPS = 80
ASIDE = 0.05  # how far from a bifurcation the crossing branch is met
ROUNDED = 2e-16  # of unknowns and load factor: their last digit
AT_KINK = 1e-3  # of the inverse length, that an unknown may be from a kink where steps became that short
BENT = 1e-5  # of a step, by which it bends at least where that is not rounding, which a mode that vanishes amplifies
AHEAD = 1e-5  # along the branch, by which slopes of eigenvalues are told


class BranchLost(RuntimeError):
    """The branch could not be followed further; the message says where and why."""


class Branch:
    """The equilibria of one instance along the load factor, from one on.

    Args:
        equations: Theirs.
        length: By which unknowns are made numbers [m].
        unit: Load factor that matters, by which it is counted.
        tolerance: Largest residual [1/m].
        growth: Longest step beyond 1, over the way from where the load factor is 0.
        inspected: Whether steps tell where stability changes; else it is not asked for, and there need be no potential.
    """

    def __init__(
        self,
        equations: BranchEquations,
        *,
        length: float,
        unit: float,
        tolerance: float,
        growth: float,
        inspected: bool = True,
    ) -> None:
        self.equations = equations
        self.scale = np.append(np.full(equations.size, 1 / length), unit)
        self.length, self.tolerance, self.growth, self.inspected = length, tolerance, growth, inspected
        self._why = ""
        self._cuts = CUTS

    def first(self, unknowns: FloatArray, way: float = 1.0) -> Point:
        """The equilibrium at load factor 0, from where the branch goes to higher ones, or to lower ones for a ``way`` of -1."""
        ahead = np.append(np.zeros(self.equations.size), way)
        return self._point(np.append(self.equations.numbers(unknowns), 0.0) / self.scale, ahead)

    def factor(self, point: Point) -> float:
        """Load factor of a point."""
        return float(point.place[-1] * self.scale[-1])

    def unknowns(self, point: Point) -> FloatArray:
        """Unknowns of a point [1/m], shape (n,)."""
        return self._unknowns(point.place)

    def _unknowns(self, place: FloatArray) -> FloatArray:
        return np.asarray(self.equations.unknowns(place[:-1] * self.scale[:-1]))

    @property
    def in_segments(self) -> bool:
        """Whether unknowns alone need not lead to the tip."""
        return self.equations.in_segments

    def mode(self, point: Point) -> FloatArray:
        """How the unknowns change in the mode that vanishes at a point, unit length, shape (n,)."""
        mode = self.equations.unknowns(np.linalg.svd(point.gamma)[2][-1])
        return np.asarray(mode / np.linalg.norm(mode))

    def connected(self, first: Point, factor: float) -> list[FloatArray]:
        """Unknowns near equilibria at a load factor, on the branch through ``first`` and on those that cross it on the way.

        Branches that cross are followed either way from each bifurcation with one or two neutral modes, and so are those that
        cross them.
        """
        found: list[FloatArray] = []
        open_ = [first]
        self._cuts = 0  # a pair of changes that is missed costs a branch; cutting, five times as much everywhere
        for _ in range(BRANCHES):
            if not open_:
                break
            try:
                for step in self.steps(open_.pop(0), BRANCH_STEPS):
                    found += [self._unknowns(place) for place in self._passed(step, factor)]
                    for change in step.changes:
                        open_ += self._crossing(change)
                    if not -0.1 * factor < self.factor(step.after) < 1.5 * factor:
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
            found = self.on_branch(change.point.place + ASIDE * ahead, ahead)
            if found is not None and np.linalg.norm(found.place - change.point.place) < 2 * ASIDE:
                result.append(found)
        return result

    def returns(self, first: Point, reach: float, max_steps: int) -> Iterator[Point]:
        """Equilibria at load factor 0 that the branch through ``first`` comes by, until it is ``reach`` away from there, or
        ends."""
        at_load = np.append(np.zeros(self.equations.size), 1.0)
        try:
            for step in self.steps(first, max_steps):
                for place in self._passed(step, 0.0):
                    point = self.on_branch(place, at_load)
                    if point is not None:
                        yield point
                if abs(self.factor(step.after)) > reach:
                    return
        except BranchLost:
            return

    def _passed(self, step: Step, factor: float) -> list[FloatArray]:
        """Places near where a step passes a load factor, be it there and back."""
        places, slopes = step.ends
        path = cubic(places, slopes)
        return [at(path, t) for t in crossings(places[:, -1] - factor / self.scale[-1], slopes[:, -1])]

    def steps(self, first: Point, max_steps: int) -> Iterator[Step]:
        """Follow the branch.

        Raises:
            BranchLost: If the branch cannot be followed further.
        """
        point, length, bend = first, FIRST_STEP, np.zeros_like(first.place)
        taken, guarded = 0, self.inspected and self._cuts > 0
        while taken < max_steps:
            step, contraction = self._try(point, length, bend)
            if step is None:
                length /= 2
                if length < SMALLEST_STEP:
                    if self._why == LOST:
                        self._why = self._end(point)
                    raise BranchLost(f"beyond a load factor of {self.factor(point):.6g} {self._why}")
                continue
            yield step
            point, taken = step.after, taken + 1
            if guarded:
                bend = _bend(step)
            longest = 1 + self.growth * float(np.abs(point.place[-1]))
            longer = (0.5 * CONTRACTION / max(contraction, 1e-6)) ** (1 / 3 if guarded else 1.0)
            length = min(longest, length * float(np.clip(longer, 0.5, 2.0)))
        raise BranchLost(f"{max_steps} steps led to a load factor of {self.factor(point):.6g} only")

    def _end(self, point: Point) -> str:
        """Why Newton's method fails beyond a point."""
        _, matrix = self._evaluate(point.place)
        noise = ROUNDED * float(np.linalg.norm(matrix) * np.abs(point.place).max())
        if noise <= self.tolerance:
            equations = self.equations
            kinks = equations.unknowns((point.place * self.scale)[:-1])[equations.problem.kinks] * self.length
            if (np.abs(kinks) < AT_KINK).any():
                return "a line becomes slack or taut, and the branch goes on with a kink: begin beyond it, start="
            return "Newton's method fails: the branch ends"
        return f"rounding hides the branch: the last digit of unknowns and loads moves the residual by {noise:.0e} 1/m"

    def on_branch(self, place: FloatArray, ahead: FloatArray) -> Point | None:
        """The equilibrium near ``place`` in the plane across ``ahead``; None if Newton's method fails."""
        found, _ = self._correct(place, ahead, np.inf)
        return None if found is None else self._point(found, ahead)

    def slopes(self, point: Point, numbers: range) -> FloatArray:
        """How ``heights`` change along the branch, per length."""
        self._evaluate(point.place + AHEAD * point.tangent)
        return (heights(self._modes(), numbers) - heights(point.modes, numbers)) / AHEAD

    def _try(self, point: Point, length: float, bend: FloatArray) -> tuple[Step | None, float]:
        """One step further on a branch that bends so, if it surely is on the same branch, and Newton's contraction."""
        expected = point.place + length * point.tangent
        if 0.5 * length * np.linalg.norm(bend) > BENT:
            expected += 0.5 * length**2 * bend
        found, contraction = self._correct(expected, point.tangent, CONTRACTION)
        self._why = LOST
        if found is None:
            return None, contraction
        goal = self._point(found, point.tangent)
        if self.inspected and not goal.modes.known[0]:
            self._why = "stability is not known: the loads have no potential, tubes are rigid in torsion, or rounding hides it"
            return None, contraction
        if goal.tangent @ point.tangent < TURN:
            return None, contraction
        if not self.inspected:
            return Step(point, goal, (), ()), contraction
        try:
            return Inspection(self, point, goal, length, self._cuts).step(), contraction
        except Apart as error:
            self._why = str(error)
            return None, contraction

    def _correct(self, place: FloatArray, tangent: FloatArray, largest: float) -> tuple[FloatArray | None, float]:
        """Newton's method in the plane across the tangent, and its worst contraction."""
        size, contraction, begin = np.inf, 0.0, place
        for k in range(ITERATIONS):
            residual, matrix = self._evaluate(place)
            if residual is None:
                return None, np.inf
            if np.abs(residual).max() <= self.tolerance:
                return place, contraction
            right = np.append(-self.length * residual, -tangent @ (place - begin))  # rows without unit, as the tangent has none
            move = np.linalg.lstsq(np.vstack([self.length * matrix, tangent]), right, rcond=SINGULAR)[0]
            before, size = size, float(np.linalg.norm(move))
            if k and size > 1e-7:
                contraction = max(contraction, size / before)
            if contraction > largest:
                return None, contraction
            place = place + move
        return None, np.inf

    def _evaluate(self, place: FloatArray) -> tuple[FloatArray | None, FloatArray]:
        """Residual [1/m] and its derivative by the place, (n, n + 1)."""
        values = place * self.scale
        residual, matrix = self.equations.evaluate(values[:-1], float(values[-1]))
        return residual, matrix if residual is None else matrix * self.scale

    def _point(self, place: FloatArray, ahead: FloatArray) -> Point:
        """The point at an equilibrium, its tangent pointing the way that ``ahead`` does."""
        _, matrix = self._evaluate(place)
        # where a branch crosses, several directions are tangent: the one ahead is this branch's
        _, values, vectors = np.linalg.svd(matrix)
        kept = np.append(values, 0.0) <= SINGULAR * values[0]
        tangent = vectors[kept].T @ (vectors[kept] @ ahead)
        if not tangent.any():  # at a fold no way leads ahead
            tangent = vectors[-1]
        tangent /= np.linalg.norm(tangent)
        modes = self._modes() if self.inspected else Modes.unknown(1)
        return Point(place, tangent, matrix[:, :-1] / self.scale[:-1], modes)

    def _modes(self) -> Modes:
        """Those where it stands."""
        return self.equations.modes()


def _bend(step: Step) -> FloatArray:
    """(15b) of ``docs/stability.md``: how the tangent turned in a step, per length, across the one at its end."""
    after = step.after.tangent
    turned = (after - step.before.tangent) / np.linalg.norm(step.after.place - step.before.place)
    return np.asarray(turned - (turned @ after) * after)
