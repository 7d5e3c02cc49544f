"""The second variation of several rods on which forces act that depend on where they are, from pieces end to end.

Numbers in parentheses are those of ``docs/stability.md``.
"""

from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from multirod.batch import IntArray
from multirod.models.backbone.kernels.tips import as_far, longest
from multirod.models.backbone.segments.chain import Chain
from multirod.models.backbone.stability.condensing.by_places import Elimination, Order, form_of, to_tips
from multirod.models.backbone.stability.condensing.second_variation import MOST_NODES, STIFF, CondensedForm
from multirod.models.backbone.units import unit_stiffness
from multirod.rotations import from_quaternions
from multirod.status import BoolArray
from multirod.validation import FloatArray

if TYPE_CHECKING:
    from multirod.models.backbone.problem import BackboneProblem

NAMES = ("moment", "torques", "place", "rotation", "angles", "force")  # of variations, as ``by_places`` has them


def form_in_pieces(problem: "BackboneProblem", needed: FloatArray) -> CondensedForm:
    """(22), (23) of rods with a free tip, each instance in as many pieces as are ``needed``, or up to twice as many, shape
    (instance_count,)."""
    form = CondensedForm.unknown(problem.instance_count, 3 + problem.features.turning_count)
    few = needed < MOST_NODES - 1
    pieces = 2 ** np.ceil(np.log2(np.maximum(np.where(few, needed, 1.0), 1.0))).astype(int)
    chain: Chain = problem.tool("chain", lambda: Chain(problem))
    for number in np.unique(pieces[few]).tolist():
        chosen = few & (pieces == number)
        own = _Rods(problem, chain).in_pieces(number)
        form.put(chosen, CondensedForm(*(values[chosen] for values in vars(own).values())))
    return form


class _Rods:
    """How the rods of a problem are turned, by the one that ends at the tip and the angles of the others from that.

    Args:
        problem: The rods.
        chain: By which they are integrated.

    Attributes:
        order: Of the variations.
        others: Rods whose angles stand beside the tip, shape (instance_count, angle).
        ended: Which of them end before it, likewise.
        work: Energy of a unit, by one of its conjugate [N m], shape (instance_count,).
    """

    def __init__(self, problem: "BackboneProblem", chain: Chain) -> None:
        self.problem, self.chain, features = problem, chain, chain.features
        turning = features.turning_count
        self.order = order = Order(turning)
        self._ends = problem.sizes.ends()
        count, own = len(self._ends), longest(self._ends)
        self.others: IntArray = np.broadcast_to(np.arange(turning), (count, turning))
        if not features.eccentric:  # else the line is what ends at the tip
            self.others = self.others + (self.others >= own[:, None])
        self._own_ends = np.take_along_axis(self._ends, self.others, axis=1)
        self.ended: BoolArray = np.logical_not(as_far(self._own_ends, self._ends.max(axis=1, keepdims=True)))
        self.work = problem.each(problem.arrays.material[:, 0, 0, :2].max(axis=1)) / chain.scale
        every = np.arange(chain.variations.size)
        self._places = np.concatenate([every[chain.variations.places[name]] for name in NAMES])
        self._unit = np.ones((count, 2 * order.half))
        self._unit[:, : order.turned] = chain.units / (self.work * chain.scale)[:, None]
        self._unit[:, order.turned : order.half] = -1.0
        stiffness = problem.each(unit_stiffness(problem.arrays.material[:, :, -1])[..., 2])
        self._softness = np.where(self.ended, self.work[:, None] / np.take_along_axis(stiffness, self.others, axis=1), 0.0)
        self._ahead = self._by_tip(own) if not features.eccentric and own.any() else None

    def _by_tip(self, own: IntArray) -> FloatArray:
        """(25) Variations by the rod that ends at the tip, from which the angles of the others count, by those by the first,
        shape (instance_count, 2 half, 2 half): what works on them changes by the inverse, transposed."""
        m, h, count = self.order.turned, self.order.half, len(own)
        rods = np.arange(1, m - 2)
        angles = np.zeros((count, m - 2, m))  # of all from the first
        angles[:, rods, 2 + rods] = 1.0
        at_tip = angles[np.arange(count), own]
        S = np.zeros((count, m, m))
        S[:, range(3), range(3)] = 1.0
        S[:, 2] += at_tip
        S[:, 3:] = np.take_along_axis(angles, self.others[:, :, None], axis=1) - at_tip[:, None]
        result = np.zeros((count, 2 * h, 2 * h))
        result[:, range(2 * h), range(2 * h)] = 1.0
        result[:, :m, :m], result[:, h : h + m, h : h + m] = np.linalg.inv(S).swapaxes(1, 2), S
        return result

    def _transition(self, columns: FloatArray, start: FloatArray, end: FloatArray) -> FloatArray:
        """(26) What a piece between two arclengths makes of a variation. A rod that ends before the tip goes on to there by
        itself, straight: it bears no torque there, and that changes nothing."""
        m, h = self.order.turned, self.order.half
        T = self._unit[:, :, None] * columns[:, self._places[:, None], self._places] / self._unit[:, None, :]
        if self._ahead is not None:
            T = self._ahead @ T @ np.linalg.inv(self._ahead)
        alone = np.clip(end[:, None] - np.maximum(start[:, None], self._own_ends), 0.0, None) * self._softness
        T[:, h + 3 : h + m] += alone[..., None] * T[:, 3:m]
        return np.asarray(T)

    @np.errstate(all="ignore")  # what is not sound need not be finite
    def in_pieces(self, number: int) -> CondensedForm:
        """(22), (23), in so many pieces of equal length."""
        problem, chain, order = self.problem, self.chain, self.order
        count, m = len(self._ends), order.turned
        transition, sound = np.empty((count, number, 2 * order.half, 2 * order.half)), np.ones(count, dtype=bool)
        edges = np.linspace(0.0, 1.0, number + 1)[:, None] * self._ends.max(axis=1)
        states = np.zeros((count, chain.state.size))
        chain.begin()
        for k, (start, end) in enumerate(pairwise(edges)):
            states, columns, fault, _ = chain.over(states, start, end, last=k == number - 1)
            sound &= fault == 0
            transition[:, k] = self._transition(columns, start, end)
        found = to_tips(transition.reshape(-1, *transition.shape[2:]), number * np.arange(count + 1), order)
        found.known &= sound
        axes = np.zeros((count, m, m))
        axes[:, range(m), range(m)] = 1.0
        axes[:, :3, :3] = problem.table.base_rotation.numpy() @ from_quaternions(states[:, chain.state.places["frame"]])
        matrix = axes @ (self.work[:, None, None] * self._freed(found)) @ axes.swapaxes(1, 2)
        stiff = STIFF * problem.sizes.stiffness_over_length()
        for k, gone in enumerate(self.ended.T):
            matrix[gone, 3 + k, 3 + k] = stiff[gone]
        return form_of(found, matrix)

    def _freed(self, found: Elimination) -> FloatArray:
        """(6) How moments at the tip follow from turns, (instance_count, m, m), the ends of rods that end before it let go."""
        matrix, every = np.array(found.W[:, : self.order.turned, : self.order.turned]), np.arange(len(found.W))
        for k, gone in enumerate(self.ended.T):
            row = 3 + k
            pivot = np.where(gone, matrix[every, row, row], 1.0)
            found.conjugate += ((pivot < 0) & gone).astype(np.int32)
            less = matrix[:, :, row, None] * matrix[:, None, row] / pivot[:, None, None]
            matrix = np.where(gone[:, None, None], matrix - less, matrix)
            matrix[gone, row], matrix[gone, :, row] = 0.0, 0.0
        return matrix
