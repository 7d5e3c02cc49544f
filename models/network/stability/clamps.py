"""A network whose rods are clamped at places along them.

Numbers in parentheses are those of ``docs/networks.md``.
"""

from typing import TYPE_CHECKING

import numpy as np

from multirod.capabilities import Clamps
from multirod.models.backbone.stability.clamps import clamped
from multirod.models.network.elements.elements import GAP_AT, OWN, TURNING
from multirod.models.network.joining.joints import MOST
from multirod.models.network.stability.conjugates import NetworkConjugates
from multirod.rotations import cross_matrix, matrices
from multirod.validation import FloatArray

if TYPE_CHECKING:
    from multirod.models.network.problem import NetworkProblem
    from multirod.models.network.state import State

AXIS = np.array([0.0, 0.0, 1.0])  # of a rod


class NetworkClamps(Clamps):
    """Of a ``NetworkProblem`` made of several pieces a rod: the clamps of the first rod that does not slide through holes, then
    those of the next.

    They turn and move with the base of their rod, (26), (27).
    """

    def __init__(self, problem: "NetworkProblem") -> None:
        self.problem, self.each = problem, problem.pieces - 1
        self._pairs = NetworkConjugates(problem, turns_alone=True)
        self.still = np.flatnonzero(~problem.graph.slides.sliding)  # the rods that are clamped
        self.size = 3 * self.each * len(self.still)
        self._groups = [(group, problem.graph.slides.still[group.members]) for group in problem.groups if not group.slides]
        unit = np.zeros((problem.instance_count, len(self.still), self.each, 3))
        for group, places in self._groups:
            unit[:, places] = clamped(group.backbones).unit.reshape(problem.instance_count, -1, 1, 3)
        self.unit = unit.reshape(-1, self.size)

    @property
    def pairs(self) -> NetworkConjugates:  # noqa: D102
        return self._pairs

    def put(self, moments: FloatArray) -> None:  # noqa: D102
        own = moments.reshape(len(moments), -1, self.each, 3)
        for group, places in self._groups:
            clamped(group.backbones).moments[:] = own[:, places].reshape(-1, self.each, 3)

    def turned(self) -> FloatArray:  # noqa: D102
        columns = self._by_rods("turned")
        # (26) as the base turns, in the axes of the clamp
        columns[..., OWN : OWN + TURNING] += np.swapaxes(self._in_base("frames", 3, 3), -1, -2)
        by_base = self._bases(self.problem.state())[0]
        return self._by_unknowns(columns, by_base).reshape(len(columns), self.size, -1)

    def moved(self) -> FloatArray:  # noqa: D102
        columns, state = self._by_rods("moved"), self.problem.state()
        columns[..., OWN : OWN + TURNING] -= cross_matrix(self._in_base("places", 3))  # (27)
        by_base, moves = self._bases(state)
        found = self._by_unknowns(state.ends[0].rotation[:, self.still, None] @ columns, by_base, moves)
        return found.reshape(len(found), -1, 3, found.shape[-1])

    def give(self) -> FloatArray:  # noqa: D102
        problem, n = self.problem, self.problem.unknown_count
        slides = problem.graph.slides
        rotation = problem.read("inputs")[:, problem.input_slice("rotation")][:, slides.owner] * slides.first
        result = np.zeros((problem.instance_count, n, n))
        for rod in np.flatnonzero(problem.graph.ends[1].held).tolist():
            gap, force = problem.places[rod, GAP_AT], problem.places[rod, OWN - 3 : OWN]
            result[:, gap[:, None], force] = matrices(rotation[:, rod, None] * AXIS)
        return result

    def frames(self) -> FloatArray:  # noqa: D102
        found = self.problem.state().ends[0].rotation[:, self.still, None] @ self._in_base("frames", 3, 3)
        return found.reshape(len(found), -1, 3, 3)

    def _bases(self, state: "State") -> tuple[FloatArray, FloatArray]:
        """(5) By the angles of the joints at the bases, then by the poses of the bodies there: how bases of rods that are clamped
        turn, in their axes, and move, in the world, both of shape (instance_count, rod, 3, MOST + POSE)."""
        problem, base, frames = self.problem, state.ends[0], state.frames
        holder, L = problem.graph.ends[0].frame, problem.length
        turns = frames.turns[:, holder]  # zero of the ground
        by_angles = L[:, : problem.rod_count, None, None] * (base.frame @ base.joints.turns)
        by_pose = np.concatenate([np.zeros_like(turns), turns], axis=-1)
        by_base = np.swapaxes(base.rotation, -1, -2) @ np.concatenate([by_angles, by_pose], axis=-1)
        moves = np.zeros_like(by_base)
        moves[..., :MOST] = L[:, : problem.rod_count, None, None] * (base.frame @ base.joints.slides)  # (36)
        at = np.flatnonzero(holder > 0)
        body = holder[at] - 1
        scale = L[:, problem.rod_count + body, None, None] ** 2
        moves[:, at, :, MOST : MOST + 3] = scale * frames.axes[:, body]
        moves[..., MOST + 3 :] = -cross_matrix(base.position - frames.position[:, holder]) @ turns
        return by_base[:, self.still], moves[:, self.still]

    def _in_base(self, name: str, *tail: int) -> FloatArray:
        """What chains say of their clamps, in the frames of the bases, shape (instance_count, rod, clamp, ...)."""
        result = np.zeros((self.problem.instance_count, len(self.still), self.each, *tail))
        for group, places in self._groups:
            result[:, places] = getattr(clamped(group.backbones), name).reshape(len(result), -1, self.each, *tail)
        return result

    def _by_rods(self, name: str) -> FloatArray:
        """Columns of the clamps by the unknowns of their rods, by turns of the bases, then by the moments of all clamps, in the
        frames of the bases, shape (instance_count, rod, clamp, 3, k)."""
        first = OWN + TURNING
        result = np.zeros((self.problem.instance_count, len(self.still), self.each, 3, first + self.size))
        for group, places in self._groups:
            chain = clamped(group.backbones)
            values = getattr(chain, name).reshape(len(result), -1, *getattr(chain, name).shape[1:])
            last = OWN + chain.loads
            result[:, places, ..., :last] = values[..., :last]
            for place, rod in enumerate(places.tolist()):
                own = first + 3 * self.each * rod
                result[:, rod, ..., own : own + 3 * self.each] = values[:, place, ..., last:]
        return result

    def _by_unknowns(self, columns: FloatArray, by_base: FloatArray, moves: FloatArray | None = None) -> FloatArray:
        """(5) Columns of ``_by_rods`` by the unknowns, then by the moments, (..., n + size).

        Args:
            columns: Shape (instance_count, rod, clamp, 3, k).
            by_base: How bases turn, of ``_bases``.
            moves: How they move, likewise, if that moves what the columns are of.
        """
        problem, layout, n = self.problem, self.problem.layout, self.problem.unknown_count
        by_all = columns[..., OWN : OWN + TURNING] @ by_base[:, :, None]
        if moves is not None:
            by_all = by_all + moves[:, :, None]
        values = np.concatenate([columns[..., :OWN], by_all], axis=-1)
        variables = [*range(OWN), *(k for at in (layout.angles_at[0], layout.poses_at[0]) for k in range(at.start, at.stop))]
        result = np.zeros((*columns.shape[:-1], n + self.size))
        for rod, places in enumerate(problem.places[self.still[:, None], variables]):
            result[:, rod][..., places[places >= 0]] = values[:, rod][..., places >= 0]
        result[..., n:] = columns[..., OWN + TURNING :]
        return result
