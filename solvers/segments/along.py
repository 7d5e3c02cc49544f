"""A branch of equilibria by segments, where an integration from the base amplifies rounding.

Numbers in parentheses are those of ``docs/stability.md``.
"""

from dataclasses import replace

import numpy as np

from multirod.integrators import Integrator
from multirod.problem import BoundaryProblem
from multirod.segments import Breakpoints, Cuts
from multirod.solvers.continuation.branch_equations import BranchEquations, FromBase
from multirod.solvers.segments.path import SegmentedPaths
from multirod.stability import Modes
from multirod.status import Status
from multirod.validation import FloatArray

DIFFERENCE = 1e-4  # turn by which differences are taken [rad], which leaves 1e-9 of them
ITERATIONS = 30  # of Newton's method from the first equilibrium to its segments
UNLIMITED = 2**31 - 1
AMPLIFIED = 3e6  # norm of Gamma where a branch begins, beyond which it is followed in segments where there are such


def equations_of(
    problem: BoundaryProblem,
    start: FloatArray,
    rate: FloatArray,
    unknowns: FloatArray,
    *,
    tolerance: float,
    integrator: Integrator,
) -> BranchEquations:
    """Those by which the branch is followed on which there are ``unknowns`` (n,) at the inputs ``start``, where ``Gamma`` is what
    the problem's buffers hold: in segments where that amplifies much, if the problem has any that may begin at a free rod's base.

    Where segments find no equilibrium there, it is from the base.
    """
    segments, turned = problem.segments, rate[problem.input_slice("rotation")].any()
    size = float(np.linalg.norm(np.nan_to_num(problem.read("gamma"), nan=np.inf)))
    if segments is not None and not segments.end_held and size > AMPLIFIED and not turned:
        problem.write("inputs", start)
        problem.directions.assign(rate[None, None, :])
        most = np.array([UNLIMITED if problem.budget is None else max(problem.budget.left, 0)])
        paths = SegmentedPaths(
            segments,
            np.zeros(1, dtype=np.intp),
            tolerance=np.array([tolerance]),
            max_iterations=ITERATIONS,
            max_steps=1,
            allowed=most,
            integrator=integrator,
        )
        found = paths.solve_from(unknowns[None])
        if problem.budget is not None:
            problem.budget.spend(int(paths.integrations[0]))
        if found.status[0] == Status.MULTIPLE_SHOOTING:
            return InSegments(problem, start, rate, found.place.cuts)
    return FromBase(problem, start, rate)


class InSegments(BranchEquations):
    """(24) Numbers are the unknowns, then how states where segments begin vary from those of the equilibrium where the branch
    begins; the residual is what is missing between segments, then at the tip. Both are weighted so that segments amplify one
    component of a variation as much as another, the first unknown by 1.

    Args:
        problem: Which offers segments.
        start: As ``BranchEquations`` has it.
        rate: Likewise.
        cuts: Segments, and states of the equilibrium where the branch begins.
    """

    in_segments = True

    def __init__(self, problem: BoundaryProblem, start: FloatArray, rate: FloatArray, cuts: Cuts) -> None:
        from scipy.linalg import matrix_balance

        super().__init__(problem, start, rate)
        segments = problem.segments
        assert segments is not None  # or there would be no cuts
        self._segments, self._cuts, self._now = segments, cuts, cuts
        self._n, self._d = problem.unknown_count, segments.variation_size
        self._instances = np.zeros(len(cuts.start), dtype=np.intp)
        self._length = float(cuts.end[-1])
        amplified = np.abs(segments.propagate(cuts, np.ones(1)).transition[:, :, : self._d]).sum(axis=0)
        unit = matrix_balance(amplified, permute=False, separate=True)[1][0]
        self._weight = unit[segments.unknown_places[0]] / unit
        self._own = self._weight[segments.unknown_places]
        self.size = self._n + self._d * (len(cuts.start) - 1)

    def numbers(self, unknowns: FloatArray) -> FloatArray:  # noqa: D102
        return np.append(self._own * self._cuts.unknowns[0], np.zeros(self.size - self._n))  # which rounding may have moved

    def unknowns(self, numbers: FloatArray) -> FloatArray:  # noqa: D102
        return np.asarray(numbers[: self._n] / self._own)

    def evaluate(self, numbers: FloatArray, factor: float) -> tuple[FloatArray | None, FloatArray]:  # noqa: D102
        self.put(factor)
        self.spend()
        n, d, count, places = self._n, self._d, len(self._instances), self._segments.unknown_places
        varied, unknowns = np.zeros((count, d)), self.unknowns(numbers)[None]
        varied[1:] = numbers[n:].reshape(-1, d) / self._weight
        states = self._segments.moved(self._instances, self._cuts.states, varied)
        states[0] = self._segments.base_state(self._instances[:1], unknowns)[0]
        self._now = replace(self._cuts, states=states, unknowns=unknowns)
        found = self._segments.propagate(self._now, np.ones(1))
        matrix = np.zeros((self.size, self.size + 1))
        if found.fault[0] != 0 or not np.isfinite(found.residual).all() or not np.isfinite(found.transition).all():
            return None, matrix
        turns = self._turns(varied) / self._weight
        gaps = self._weight * self._segments.difference(self._instances[1:], found.end[:-1], states[1:])
        for k in range(count):
            last = k + 1 == count
            rows = slice(k * d, None if last else (k + 1) * d)
            columns = slice(n + (k - 1) * d, n + k * d) if k else slice(0, n)
            led = self._own[:, None] * found.residual_columns[0] if last else self._weight[:, None] * found.transition[k]
            matrix[rows, columns] = led[:, :d] @ turns[k] if k else led[:, places] / self._own
            matrix[rows, -1] = led[:, d]
            if not last:
                matrix[rows, n + k * d : n + (k + 1) * d] = -self._weight[:, None] * turns[k + 1]
        return np.append(gaps, self._own * found.residual[0]), matrix

    def _turns(self, varied: FloatArray) -> FloatArray:
        """How states that vary by (count, d) from those where the branch begins change, as variations there, (count, d, d).

        By differences: rotations do not add up.
        """
        d, segments = self._d, self._segments
        instances, first = np.repeat(self._instances, d), np.repeat(self._cuts.states, d, axis=0)
        by = DIFFERENCE / self._length * np.tile(np.eye(d), (len(varied), 1))
        ahead, behind = (segments.moved(instances, first, np.repeat(varied, d, axis=0) + way * by) for way in (0.5, -0.5))
        change = segments.difference(instances, ahead, behind) * (self._length / DIFFERENCE)
        return np.asarray(change.reshape(len(varied), d, d).swapaxes(1, 2))

    def modes(self) -> Modes:  # noqa: D102
        self.spend()
        now = self._now
        arclength = np.append(now.start, now.end[-1:])
        return self._segments.modes({0: Breakpoints(arclength, now.states, now.unknowns[0], now.steps)})
