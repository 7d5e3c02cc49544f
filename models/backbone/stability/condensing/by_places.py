"""The condensed form of rods on which forces act that depend on where they are, from what segments make of a variation.

Variations are those of moment, torques and negative position, then of rotation, angles and force, each half the conjugate of the
other up to a ``unit``; moment and rotation in the frames where segments begin and end. Numbers in parentheses are those of
``docs/stability.md``.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from multirod.models.backbone.stability.condensing.inverses import inverses
from multirod.models.backbone.stability.condensing.second_variation import WORST_CONDITION, CondensedForm
from multirod.rotations import cross_matrix
from multirod.validation import FloatArray


class Order:
    """Where what stands among the variations of rods of which so many turn against the frame.

    Attributes:
        turned: How many numbers tell how they are turned.
        half: What follows, and what is given, is as many.
        wrench: Places of moments and force, shape (half,).
        pose: Of rotation, angles and negative position, shape (half,).
        held: Of what is given where a segment ends whose tip is held as in (22).
    """

    def __init__(self, turning: int = 0) -> None:
        m = self.turned = 3 + turning
        h = self.half = m + 3
        every = np.arange(2 * h)
        self.held = every[h:]
        self.wrench = np.concatenate([every[:m], every[h + m :]])  # and what is given where a tip is free
        self.pose = np.concatenate([every[h : h + m], every[m:h]])


class Elimination:
    """(22), (23) Nodes of a batch eliminated one after another, from the base on.

    Attributes:
        order: Of the variations.
        W: How moments and negative position follow from turns and force where the segments end, shape (batch, half, half).
        conjugate: Negative eigenvalues of what was eliminated, shape (batch,).
        known: Whether rounding leaves the signs, shape (batch,).
    """

    def __init__(self, count: int, order: Order) -> None:
        self.order, self.W = order, np.zeros((count, order.half, order.half))
        self.conjugate, self.known = np.zeros(count, dtype=np.int32), np.ones(count, dtype=bool)

    def node(self, on: NDArray[np.intp], T: FloatArray, given: NDArray[np.intp]) -> None:
        """Eliminate the node between what there is and the next segments, of which some is ``given`` where they end."""
        W, m, h = self.W[on], self.order.turned, self.order.half
        # how moments and force where the segment begins answer turns and position there
        held, sound = inverses(T[:, given[:, None], self.order.wrench])
        right = held @ T[:, given[:, None], self.order.pose]
        right[:, m:] *= -1.0
        pivot = np.zeros((len(on), h + 3, h + 3))
        pivot[:, :h, :h] = right
        pivot[:, :m, :m] += W[:, :m, :m]
        pivot[:, :m, h:], pivot[:, h:, :m], pivot[:, h:, h:] = W[:, :m, m:], W[:, m:, :m], W[:, m:, m:]
        pivot[:, m:h, h:] = pivot[:, h:, m:h] = -np.eye(3)
        self.known[on] &= sound & np.isfinite(pivot).all(axis=(1, 2))
        pivot[~self.known[on]] = 0.0
        self.conjugate[on] += (np.linalg.eigvalsh(pivot + pivot.swapaxes(1, 2)) < 0).sum(axis=1).astype(np.int32) - np.int32(3)

    def led(self, on: NDArray[np.intp], T: FloatArray) -> FloatArray:
        """Variations where these segments end, by turns and force where they begin, shape (k, 2 half, half)."""
        h = self.order.half
        return np.asarray(T[:, :, h:] + T[:, :, :h] @ self.W[on])

    def go_on(self, on: NDArray[np.intp], led: FloatArray) -> None:
        """To where these segments end."""
        h = self.order.half
        inverse, sound = inverses(led[:, h:])
        self.known[on] &= sound
        self.W[on] = led[:, :h] @ inverse


ALONE = Order()  # of single rods


def to_tips(transition: FloatArray, first: NDArray[np.integer[Any]], order: Order = ALONE) -> Elimination:
    """All nodes eliminated, and led on to the tips, what is given there as where other segments end; ``transition`` and ``first``
    as ``form_by_places`` has them, of any rods."""
    found, lengths = Elimination(len(first) - 1, order), np.diff(first)
    with np.errstate(all="ignore"):  # what is not sound need not be finite
        for k in range(int(lengths.max())):
            on = np.flatnonzero(lengths > k)
            T = transition[first[on] + k]
            if k > 0:
                found.node(on, T, order.held)
            found.go_on(on, T[:, :, order.wrench] if k == 0 else found.led(on, T))
    return found


def form_of(found: Elimination, matrix: FloatArray) -> CondensedForm:
    """A form of what was eliminated."""
    known = found.known & np.isfinite(matrix).all(axis=(1, 2))
    matrix[~known] = np.nan
    return CondensedForm(matrix, np.where(known, found.conjugate, 0).astype(np.int32), known)


def form_by_places(transition: FloatArray, ends: FloatArray, first: NDArray[np.integer[Any]], unit: FloatArray) -> CondensedForm:
    """``form_by_segments`` of rods whose tips are free.

    Args:
        transition: Shape (segment, 12, 12), the segments of one instance after those of another.
        ends: Frames where they end, body to world, shape (segment, 3, 3).
        first: Where the segments of each instance begin, then how many there are, shape (batch + 1,).
        unit: Energy per square of what varies [N m], shape (batch,).
    """
    found, tip = to_tips(transition, first), ends[first[1:] - 1]
    return form_of(found, tip @ (unit[:, None, None] * found.W[:, :3, :3]) @ tip.swapaxes(1, 2))


def held_form_by_places(
    transition: FloatArray,
    ends: FloatArray,
    first: NDArray[np.integer[Any]],
    unit: FloatArray,
    length: FloatArray,
    base: FloatArray,
    moment: FloatArray,
) -> CondensedForm:
    """(22b) ``condensed_form`` of rods whose tips are held: moment and negative position by rotation of the tip and force on it.

    Args:
        transition: As ``form_by_places`` has it, likewise the next three.
        ends: Frames where segments end.
        first: Where those of each instance begin.
        unit: Energy per square of what varies.
        length: In which positions are told [m], shape (batch,).
        base: Frame in which positions and forces are told, body to world, shape (batch, 3, 3).
        moment: At the tip, in its own frame [N m], shape (batch, 3).
    """
    found, tip = to_tips(transition, first), ends[first[1:] - 1]
    # the moment in the world varies with the frame that it is told in, too
    found.W[:, :3, :3] -= cross_matrix(moment / unit[:, None])
    ahead, back = np.zeros((2, len(unit), 6, 6))
    ahead[:, :3, :3], ahead[:, 3:, 3:] = unit[:, None, None] * tip, length[:, None, None] * base
    back[:, :3, :3], back[:, 3:, 3:] = tip, (length / unit)[:, None, None] * base
    return form_of(found, ahead @ found.W @ back.swapaxes(1, 2))


def compliance_by_places(
    transition: FloatArray,
    ends: FloatArray,
    first: NDArray[np.integer[Any]],
    unit: FloatArray,
    length: FloatArray,
    base: FloatArray,
    moment: FloatArray,
) -> CondensedForm:
    """``compliance_by_segments`` of rods whose bases are clamped, two segments or more of each.

    Args:
        transition: As ``form_by_places`` has it, likewise the next three.
        ends: Frames where segments end.
        first: Where those of each instance begin.
        unit: Energy per square of what varies.
        length: In which positions are told [m], shape (batch,).
        base: Frame in which positions and forces are told, body to world, shape (batch, 3, 3).
        moment: At the tip, in its own frame [N m], shape (batch, 3).
    """
    count, lengths = len(first) - 1, np.diff(first)
    found, at_tip = Elimination(count, ALONE), np.zeros((count, 12, 6))
    with np.errstate(all="ignore"):  # what is not sound need not be finite
        for k in range(int(lengths.max())):
            on = np.flatnonzero(lengths > k)
            T, last = transition[first[on] + k], lengths[on] == k + 1
            some = on[last]
            # moments vary by rotations along geodesics, so that the form is symmetric
            T[last, :3] -= 0.5 * cross_matrix(moment[some] / unit[some, None]) @ T[last, 6:9]
            if k > 0:
                # the tip is free: its own rotation is eliminated before that of the last breakpoint
                for ended, given in ((last, ALONE.wrench), (~last, ALONE.held)):
                    if ended.any():
                        found.node(on[ended], T[ended], given)
            led = T[:, :, ALONE.wrench] if k == 0 else found.led(on, T)
            at_tip[some] = led[last]
            if not last.all():
                found.go_on(on[~last], led[~last])
        found.known &= np.isfinite(at_tip).all(axis=(1, 2))
        wrench = np.where(found.known[:, None, None], at_tip[:, ALONE.wrench], np.eye(6))
        found.known &= np.linalg.cond(wrench) < WORST_CONDITION
        pose = at_tip[:, ALONE.pose]
        pose[:, 3:] *= -1.0
        matrix = -pose @ np.linalg.inv(np.where(found.known[:, None, None], wrench, np.eye(6)))
    axes = np.zeros((count, 6, 6))
    axes[:, :3, :3], axes[:, 3:, 3:] = ends[first[1:] - 1], length[:, None, None] * base
    return form_of(found, axes @ matrix @ axes.swapaxes(1, 2) / unit[:, None, None])
