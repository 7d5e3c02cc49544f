"""Equilibria that are not alone: closed curves of them, such as all turns of a buckled column about its axis."""

from typing import Self

import numpy as np

from multirod.problem import BoundaryProblem
from multirod.validation import FloatArray

NEUTRAL = 1e-6  # smallest over largest singular value of Gamma along a curve; 1e-10 is usual, 1e-4 beside a fold
ON = 1e-6  # residual along a curve over the size of its unknowns: more than the integrator's error, less than beside a fold
FIRST_STEP, LEAST_STEP = 1e-2, 1e-5  # over that size
TURN = 0.1  # rad that the tangent turns by a step at most
STEPS = 400  # 63 to 126 are a circle
CORRECTIONS = 6
NEARLY = 1e-4  # the same as ``NEUTRAL`` and ``ON`` where Newton's method gave up beside a curve, which it does
BESIDE = 0.02  # of a step, that a point may be off the tangents and on the curve: an eighth of ``TURN`` is, halfway


class Curve:
    """A closed curve of equilibria.

    Args:
        points: On it, in order, shape (k, n).
        tangents: Unit vectors there, shape (k, n).
    """

    def __init__(self, points: FloatArray, tangents: FloatArray) -> None:
        self.points = points
        self.tangents = tangents
        self._steps = np.linalg.norm(np.roll(points, -1, axis=0) - points, axis=1)

    @classmethod
    def through(cls, problem: BoundaryProblem, unknowns: FloatArray, gamma: FloatArray) -> Self | None:
        """The closed curve that goes on from an equilibrium of a problem of one instance; None where there is none.

        Where ``Gamma`` is singular, steps along what it leaves free are followed by Newton's method across, until they are back.
        """
        tangent = _free(gamma)
        if tangent is None:
            return None
        size = max(1.0, float(np.abs(unknowns).max()))
        points, tangents, step = [np.array(unknowns)], [tangent], FIRST_STEP * size
        while len(points) < STEPS and step >= LEAST_STEP * size:
            there = _onto(problem, points[-1] + step * tangents[-1], tangents[-1], ON * size)
            found = None if there is None else _free(there[1])
            if there is None or found is None or abs(float(found @ tangents[-1])) < np.cos(TURN):
                step /= 2
                continue
            first, last = points[0] - points[-1], there[0] - points[-1]
            if len(points) > 2 and 0 < first @ last <= last @ last and np.linalg.norm(first) < 2 * step:
                return cls(np.array(points), np.array(tangents))
            points.append(there[0])
            tangents.append(found * np.sign(found @ tangents[-1]))
            if float(tangents[-1] @ tangents[-2]) > np.cos(TURN / 2):
                step *= 2
        return None

    def holds(self, unknowns: FloatArray) -> bool:
        """Whether an equilibrium is one of them."""
        apart = unknowns - self.points
        k = int(np.linalg.norm(apart, axis=1).argmin())
        along = float(apart[k] @ self.tangents[k])
        step = max(self._steps[k], self._steps[k - 1])
        return bool(abs(along) <= step and np.linalg.norm(apart[k] - along * self.tangents[k]) <= BESIDE * step)


def _free(gamma: FloatArray, limit: float = NEUTRAL) -> FloatArray | None:
    """The only direction in which nothing changes; None where there is none, or another."""
    if len(gamma) < 2 or not np.isfinite(gamma).all():
        return None
    _, sizes, ways = np.linalg.svd(gamma)
    alone = sizes[-1] <= limit * sizes[0] < sizes[-2]
    return np.asarray(ways[-1]) if alone else None


def beside(
    problem: BoundaryProblem, unknowns: FloatArray, residual: FloatArray, gamma: FloatArray, tolerance: float
) -> tuple[FloatArray, FloatArray, bool] | None:
    """The neutral equilibrium beside which Newton's method gave up: in the free direction it goes anywhere.

    Returns:
        Its unknowns and Gamma, and whether its residual is within the tolerance: the integrator's error may not let it.
    """
    size = max(1.0, float(np.abs(unknowns).max()))
    free = _free(gamma, NEARLY)
    if free is None or not np.abs(residual).max() <= NEARLY * size:
        return None
    for limit in (tolerance, ON * size):
        there = _onto(problem, unknowns, free, limit)
        if there is not None:
            return *there, limit == tolerance
    return None


def _onto(
    problem: BoundaryProblem, unknowns: FloatArray, tangent: FloatArray, tolerance: float
) -> tuple[FloatArray, FloatArray] | None:
    """The neutral equilibrium in the plane across the tangent, and its Gamma."""
    for _ in range(CORRECTIONS):
        residual, gamma = (values[0] for values in problem.evaluate(unknowns[None]))
        if not np.isfinite(residual).all() or not np.isfinite(gamma).all():
            return None
        if np.abs(residual).max() <= tolerance and _free(gamma) is not None:
            return unknowns, gamma
        across = np.vstack([gamma, np.abs(gamma).max() * tangent])
        unknowns = unknowns + np.linalg.lstsq(across, np.append(-residual, 0.0), rcond=None)[0]
    return None
