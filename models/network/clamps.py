"""A network whose rods are clamped at places along them.

Numbers in parentheses are those of ``docs/networks.md``.
"""

from typing import TYPE_CHECKING

import numpy as np

from multirod.capabilities import Clamps
from multirod.models.backbone.clamps import ClampedBackbones
from multirod.models.network.conjugates import NetworkConjugates
from multirod.models.network.elements import GAP_AT, OWN, POSES_AT, SIZE, TURNING
from multirod.models.network.entries import Sums
from multirod.models.network.groups import AXIS, RodGroup
from multirod.rotations import cross_matrix, matrices
from multirod.validation import FloatArray

if TYPE_CHECKING:
    from multirod.models.network.elements import Equations
    from multirod.models.network.problem import NetworkProblem, State


class NetworkClamps(Clamps):
    """Of a ``NetworkProblem`` made of several pieces a rod: the clamps of the first rod, then those of the next.

    They turn and move with the base of their rod, (26), (27).
    """

    def __init__(self, problem: "NetworkProblem") -> None:
        self.problem, self.each = problem, problem.pieces - 1
        self._pairs = NetworkConjugates(problem, turns_alone=True)
        self.size = 3 * self.each * problem.rod_count
        unit = np.zeros((problem.instance_count, problem.rod_count, self.each, 3))
        for group in problem.groups:
            unit[:, group.members] = self._chain(group).unit.reshape(problem.instance_count, -1, 1, 3)
        self.unit = unit.reshape(-1, self.size)

    @property
    def pairs(self) -> NetworkConjugates:  # noqa: D102
        return self._pairs

    @staticmethod
    def _chain(group: RodGroup) -> ClampedBackbones:
        chain = group.backbones.launch
        assert isinstance(chain, ClampedBackbones)  # as all rods are in pieces
        return chain

    def put(self, moments: FloatArray) -> None:  # noqa: D102
        own = moments.reshape(len(moments), -1, self.each, 3)
        for group in self.problem.groups:
            self._chain(group).moments[:] = own[:, group.members].reshape(-1, self.each, 3)

    def turned(self) -> FloatArray:  # noqa: D102
        columns = self._by_rods("turned")
        # (26) as the base turns, in the axes of the clamp
        columns[..., OWN : OWN + TURNING] += np.swapaxes(self._in_base("frames", 3, 3), -1, -2)
        return self._by_unknowns(self._spread(columns)).reshape(len(columns), self.size, -1)

    def moved(self) -> FloatArray:  # noqa: D102
        columns, base = self._by_rods("moved"), self._seen()[1].ends[0]
        columns[..., OWN : OWN + TURNING] -= cross_matrix(self._in_base("places", 3))  # (27)
        spread = base.rotation[:, :, None] @ self._spread(columns)
        spread[..., POSES_AT[0]] += base.moves[:, :, None]
        found = self._by_unknowns(spread)
        return found.reshape(len(found), -1, 3, found.shape[-1])

    def give(self) -> FloatArray:  # noqa: D102
        problem, (state, _) = self.problem, self._seen()
        n = problem.unknown_count
        result = np.zeros((problem.instance_count, n, n))
        for rod in np.flatnonzero(problem.graph.ends[1].held).tolist():
            gap, force = problem.places[rod, GAP_AT], problem.places[rod, OWN - 3 : OWN]
            result[:, gap[:, None], force] = matrices(state.rotation[:, rod, None] * AXIS)
        return result

    def frames(self) -> FloatArray:  # noqa: D102
        found = self._seen()[1].ends[0].rotation[:, :, None] @ self._in_base("frames", 3, 3)
        return found.reshape(len(found), -1, 3, 3)

    def _seen(self) -> "tuple[State, Equations]":
        assert self.problem.seen is not None  # or nothing was integrated
        return self.problem.seen

    def _in_base(self, name: str, *tail: int) -> FloatArray:
        """What chains say of their clamps, in the frames of the bases, shape (instance_count, rod, clamp, ...)."""
        problem = self.problem
        result = np.zeros((problem.instance_count, problem.rod_count, self.each, *tail))
        for group in problem.groups:
            result[:, group.members] = getattr(self._chain(group), name).reshape(len(result), -1, self.each, *tail)
        return result

    def _by_rods(self, name: str) -> FloatArray:
        """Columns of the clamps by the unknowns of their rods, by turns of the bases, then by the moments of all clamps, in the
        frames of the bases, shape (instance_count, rod, clamp, 3, k)."""
        problem, first = self.problem, OWN + TURNING
        result = np.zeros((problem.instance_count, problem.rod_count, self.each, 3, first + self.size))
        for group in problem.groups:
            chain = self._chain(group)
            values = getattr(chain, name).reshape(len(result), -1, *getattr(chain, name).shape[1:])
            last = OWN + chain.loads
            result[:, group.members, ..., :last] = values[..., :last]
            for place, rod in enumerate(group.members.tolist()):
                own = first + 3 * self.each * rod
                result[:, rod, ..., own : own + 3 * self.each] = values[:, place, ..., last:]
        return result

    def _spread(self, columns: FloatArray) -> FloatArray:
        """Columns (instance_count, rod, clamp, 3, k) by the variables of the elements, then by the moments of all clamps."""
        shape = columns.shape
        spread = self._seen()[1].spread(columns.reshape(*shape[:2], -1, shape[-1]))
        return spread.reshape(*shape[:-1], spread.shape[-1])

    def _by_unknowns(self, columns: FloatArray) -> FloatArray:
        """Columns (instance_count, rod, ..., SIZE + size) by the unknowns, then by the moments, (..., n + size)."""
        problem, n = self.problem, self.problem.unknown_count
        result = np.empty((*columns.shape[:-1], n + self.size))
        for rod in range(problem.rod_count):
            result[:, rod, ..., :n] = Sums(problem.places[rod], n)(columns[:, rod, ..., :SIZE])
        result[..., n:] = columns[..., SIZE:]
        return result
