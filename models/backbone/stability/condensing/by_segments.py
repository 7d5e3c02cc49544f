"""The condensed form from what segments make of variations, so that columns cannot grow apart.

Numbers in parentheses are those of ``docs/stability.md``.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from multirod.models.backbone.stability.condensing.inverses import are_sound, by_cofactors, negative_count
from multirod.models.backbone.stability.condensing.second_variation import WORST_CONDITION, CondensedForm
from multirod.rotations import cross
from multirod.validation import FloatArray


def form_by_segments(
    transition: FloatArray, frames: FloatArray, ends: FloatArray, first: NDArray[np.integer[Any]], unit: FloatArray
) -> tuple[CondensedForm, FloatArray]:
    """(4), (5) from what each segment makes of a variation, so that columns cannot grow apart, (12).

    Args:
        transition: Of moment and lengths of lines, then of rotation and tensions, in the frames where segments begin and end,
            shape (segment, 6 + 2 line, 6 + 2 line); the segments of one instance after those of another.
        frames: Where they begin, body to world, shape (segment, 3, 3).
        ends: Where they end, likewise.
        first: Where the segments of each instance begin, then how many there are, shape (batch + 1,).
        unit: Moment per rotation of the units in ``transition`` [N m], shape (batch, 3).

    Returns:
        With all tensions fixed; and how the tip's moment [N m] and the lengths vary with its rotation, in the world, and with the
        tensions, shape (batch, 3 + line, 3 + line).
    """
    count, lengths, h = len(first) - 1, np.diff(first), transition.shape[1] // 2
    conjugate, known = np.zeros(count, dtype=np.int32), np.zeros(count, dtype=bool)
    W = np.zeros((count, h, h))
    turns, inverses = np.empty((2, len(transition), 3, 3))
    with np.errstate(all="ignore"):  # what is not sound need not be finite
        for k in range(int(lengths.max())):
            # the k-th segment of all that have one
            on = np.flatnonzero(lengths > k)
            rows = first[on] + k
            T = transition[rows]
            if k == 0:
                begin = np.delete(T, np.s_[3 : h + 3], axis=2)  # by the moment there, and by tensions
                Y, P = begin[:, h:], begin[:, :h]
            else:
                Y, P = T[:, h:, h:] + T[:, h:, :h] @ W[on], T[:, :h, h:] + T[:, :h, :h] @ W[on]
            turns[rows], inverses[rows] = Y[:, :3, :3], by_cofactors(Y[:, :3, :3])
            # tensions stay as they are
            W[on] = np.concatenate([P[:, :, :3] @ inverses[rows], P[:, :, 3:]], axis=2)
            W[on, :, 3:] -= W[on, :, :3] @ Y[:, :3, 3:]
        sound, later = are_sound(turns, inverses), np.ones(len(turns), dtype=bool)
        later[first[:-1]] = False
        known[:] = np.logical_and.reduceat(sound, first[:-1])
        negative = negative_count(ends @ turns @ frames.swapaxes(1, 2))
    conjugate[:] = np.add.reduceat(np.where(later, negative, 0), first[:-1])
    # the rotation of the tip in the world
    tip = ends[first[1:] - 1]
    W[:, :3] = tip @ (unit[:, :, None] * W[:, :3])
    W[:, :, :3] = W[:, :, :3] @ tip.swapaxes(1, 2)
    W[~known], conjugate[~known] = np.nan, 0
    return CondensedForm(W[:, :3, :3].copy(), conjugate, known), W


@dataclass(frozen=True)
class HeldUnits:
    """What variations of segments of held rods are counted in.

    Attributes:
        stiffness: Moment [N m^2] by axis, shape (batch, 3).
        length: Rotation, and position by its square [m], shape (batch,).
        bending: Force, over the length [N m^2], shape (batch,).
        base: Frame in which positions and forces are told, body to world, shape (batch, 3, 3).
    """

    stiffness: FloatArray
    length: FloatArray
    bending: FloatArray
    base: FloatArray


def compliance_by_segments(
    transition: FloatArray,
    frames: FloatArray,
    ends: FloatArray,
    first: NDArray[np.integer[Any]],
    units: HeldUnits,
    moment: FloatArray,
) -> CondensedForm:
    """``compliance_form`` from what each segment makes of a variation, ((22) of ``docs/held.md``).

    Args:
        transition: Of moment, position and moments about free axes of the base [N m], then of rotation, force and angles about
            these, shape (segment, 12 + 2 turns, 12 + 2 turns); the segments of one instance after those of another, two or more.
        frames: Where they begin, body to world, shape (segment, 3, 3).
        ends: Where they end, likewise.
        first: Where the segments of each instance begin, then how many there are, shape (batch + 1,).
        units: Of these.
        moment: At the tip, in the world [N m], shape (batch, 3).

    Returns:
        How the negative moments about the base's axes, rotation and position of the tip vary with angles of the base, moment and
        force on the tip, shape (batch, turns + 6, turns + 6), and the index of the rod with a free tip under these.
    """
    count, lengths, h = len(first) - 1, np.diff(first), transition.shape[1] // 2
    turns = h - 6
    result = CondensedForm.unknown(count, turns + 6)
    conjugate = np.zeros(count, dtype=np.int32)
    known = np.ones(count, dtype=bool)
    W, at_tip = np.zeros((count, h, h)), np.zeros((count, 2 * h, h))
    with np.errstate(all="ignore"):  # what is not sound need not be finite
        for k in range(int(lengths.max())):
            on = np.flatnonzero(lengths > k)
            rows, last = first[on] + k, lengths[on] == k + 1
            T = transition[rows]
            led = np.delete(T, np.s_[3 : h + 3], axis=2) if k == 0 else T[:, :, h:] + T[:, :, :h] @ W[on]
            Y, P = led[:, h : h + 3], led[:, :h]
            turned = ends[rows] @ Y[:, :, :3] @ frames[rows].swapaxes(1, 2)
            if last.any():
                some, own = on[last], rows[last]
                at_tip[some] = led[last]
                # the tip is free: its own rotation is eliminated before that of the last breakpoint
                turned[last] = _tip_moment(led[last], ends[own], some, units, moment)[:, :, :3] @ frames[own].swapaxes(1, 2)
            if k > 0:
                conjugate[on] += negative_count(turned).astype(np.int32)
            inverse = by_cofactors(Y[:, :, :3])
            known[on] &= last | are_sound(Y[:, :, :3], inverse)
            W[on] = np.concatenate([P[:, :, :3] @ inverse, P[:, :, 3:]], axis=2)
            W[on, :, 3:] -= W[on, :, :3] @ Y[:, :, 3:]
        tip = ends[first[1:] - 1]
        every, L = np.arange(count), units.length[:, None, None]
        rotation = L * (tip @ at_tip[:, h : h + 3])
        position = L**2 * (units.base @ at_tip[:, 3:6])
        force = np.zeros((count, 3, h))
        force[:, :, 3:6] = units.base * (units.bending / units.length)[:, None, None]
        # per length, as the unknowns are: so that one condition number has a meaning
        K = (units.bending / units.length)[:, None, None]
        given = [at_tip[:, h + 6 :], _tip_moment(at_tip, tip, every, units, moment) / K, force / (K / L)]
        follows = [at_tip[:, 6:h] / K, rotation, position / L]
        by, wrench = np.concatenate(follows, axis=1), np.concatenate(given, axis=1)
    known &= np.isfinite(wrench).all(axis=(1, 2)) & np.isfinite(by).all(axis=(1, 2))
    wrench = np.where(known[:, None, None], wrench, np.eye(h))
    size = np.abs(wrench).max(axis=1, keepdims=True)  # of each column, whose units are any
    known &= np.linalg.cond(wrench / size) < WORST_CONDITION
    wrench = np.where(known[:, None, None], wrench, np.eye(h))
    matrix = -by @ np.linalg.inv(wrench)
    back = np.ones((count, h, 1))
    back[:, :turns], back[:, turns + 3 :] = K, L
    ahead = np.ones((count, 1, h))
    ahead[:, :, turns : turns + 3], ahead[:, :, turns + 3 :] = 1 / K, L / K
    result.matrix[:], result.conjugate[:], result.known[:] = back * matrix * ahead, np.where(known, conjugate, 0), known
    return result


def _tip_moment(led: FloatArray, tip: FloatArray, chosen: NDArray[np.intp], units: HeldUnits, moment: FloatArray) -> FloatArray:
    """How the moment on tips with these frames varies by rotations along geodesics, in the world [N m], (k, 3, h); ``led`` has
    variations at the tip (k, 2 h, h)."""
    h = led.shape[2]
    rotation = units.length[chosen, None, None] * (tip @ led[:, h : h + 3])
    own = tip @ (units.stiffness[chosen, :, None] * led[:, :3])
    return np.asarray(own + 0.5 * cross(rotation.swapaxes(1, 2), moment[chosen, None]).swapaxes(1, 2))
