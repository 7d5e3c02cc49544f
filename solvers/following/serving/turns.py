"""Which residuals of a problem are forces, and how what they do work on is turned, with clamps and without.

Numbers in parentheses are those of ``docs/branches.md``.
"""

from itertools import pairwise

import numpy as np

from multirod.batch import IntArray
from multirod.capabilities import Conjugates
from multirod.problem import BoundaryProblem
from multirod.solvers.following.arrow import Arrow
from multirod.validation import FloatArray

GIVE = 1e-6  # of L^3/EI: what holds the end of a rod with clamps gives way by, in steps alone


class ClampedTurns:
    """The same of a problem with clamps: beside its unknowns stand their moments, beside its residuals what no clamp would need.

    Args:
        problem: With ``clamps``.

    Attributes:
        held: As ``Points.clamps``.
        arrow: As ``Points`` has it.
    """

    def __init__(self, problem: BoundaryProblem) -> None:
        clamps, n = problem.clamps, problem.unknown_count
        assert clamps is not None  # or there would be nothing to turn
        self.problem, self.clamps, self.size = problem, clamps, n + clamps.size
        self.forces = np.append(clamps.pairs.forces, range(n, self.size))
        ends = np.append(clamps.first[1:], clamps.size)
        turns = clamps.first[:, None] + np.arange((ends - clamps.first).max())
        self.held = np.where(turns < ends[:, None], len(clamps.pairs.forces) + turns, -1)
        self.stiffness = clamps.pairs.stiffness
        self._order = np.append(self.forces, np.setdiff1d(np.arange(n), clamps.pairs.forces))
        self.arrow = None if clamps.blocks is None else self._arrow(clamps.blocks)

    def _arrow(self, of_moments: IntArray) -> Arrow:
        """By the block of each moment, (clamps.size,)."""
        problem, n = self.problem, self.problem.unknown_count
        own = [np.append(range(*place), n + np.flatnonzero(of_moments == k)) for k, place in enumerate(pairwise(problem.arrow))]
        return Arrow(own[:-1], own[-1], self._order, self.forces)

    def put(self, unknowns: FloatArray) -> None:
        """Unknowns and moments (instance_count, size) to where the next integration finds them."""
        self.problem.write("unknowns", unknowns[:, : self.problem.unknown_count])
        self.clamps.put(unknowns[:, self.problem.unknown_count :])

    def after(self, unknowns: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """After an integration: residual (instance_count, size), its derivative, and what ``Turns.after`` says."""
        problem, clamps, n, size = self.problem, self.clamps, self.problem.unknown_count, self.size
        pairs, count = clamps.pairs, problem.instance_count
        pairs.update()
        residual = np.concatenate([problem.read("residual"), -unknowns[:, n:]], axis=1)
        gamma = np.zeros((count, size, size))
        gamma[:, :n, :n] = problem.read("gamma").reshape(count, n, n)
        gamma[:, :n, n:] = problem.residual_directions.numpy()[..., : clamps.size]
        gamma[:, n:, n:] = -np.eye(clamps.size)
        scale, first = pairs.scale.numpy(), len(pairs.forces)
        result = np.empty((count, size, size))
        result[:, :first] = pairs.columns.numpy()[:, :, :size] / scale[..., None]
        result[:, first : first + clamps.size] = clamps.turned()
        result[:, first + clamps.size :] = gamma[:, self._order[first + clamps.size :]]
        give = clamps.give()
        if give is not None:
            below = self._order < n  # not the clamps, which nothing holds
            result[:, below, :n] += GIVE * give[:, self._order[below]]
        return residual, gamma, np.concatenate([pairs.unit.numpy() * scale, clamps.unit], axis=1), result


class Turns:
    """Which residuals of a problem are forces, and how what they do work on is turned by the unknowns.

    Args:
        pairs: Of the problem.
    """

    def __init__(self, pairs: Conjugates) -> None:
        self._pairs = pairs
        self.forces = pairs.forces
        self.stiffness = pairs.stiffness  # K/L [N m], shape (instance_count,)

    def after(self, gamma: FloatArray) -> tuple[FloatArray, FloatArray]:
        """After an integration that led to ``gamma``, (instance_count, n, n): the moment of one unit of each force [N m], shape
        (instance_count, m), and ``Point.turned``, shape (instance_count, n, n)."""
        pairs, n = self._pairs, gamma.shape[-1]
        pairs.update()
        scale = pairs.scale.numpy()
        result = np.array(gamma)
        result[:, pairs.forces] = pairs.columns.numpy()[:, :, :n] / scale[..., None]
        for row, unknown, by in pairs.give:
            result[:, row, unknown] += by
        order = np.append(pairs.forces, np.delete(np.arange(n), pairs.forces))
        return pairs.unit.numpy() * scale, result[:, order]
