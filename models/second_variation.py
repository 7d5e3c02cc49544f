"""How many modes of a backbone are unstable: the Morse index of its second variation, from columns of sensitivities.

Numbers in parentheses are those of ``docs/stability.md``.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from multirod.validation import FloatArray

FEWEST_NODES = 33
MOST_NODES = 16385
NEUTRAL = 1e-6  # of stiffness over length: a mode no stiffer than this is neutral
WORST_CONDITION = 1e12  # of the columns at a node; beyond it rounding may change a sign


@dataclass(frozen=True)
class NodeColumns:
    """Variations of the configurations of a batch by its unknowns, from the base, where it is clamped, to the tip.

    ``m = n + 2`` for ``n`` rods. The configuration is the rotation vector of the rod that ends at the tip, in the world, then
    the angle from it to each other rod; its momenta are the moment of all rods and the torque of each other rod.

    Attributes:
        arclength: Of the nodes, the base left out [m], NaN past the last, shape (batch, node).
        configuration: By the unknowns, shape (batch, node, m, m).
        tip_momenta: By the unknowns, the torque of a rod at its own end, shape (batch, m, m).
        ends: Arclength at which each rod ends, a number that is in ``arclength`` [m], shape (batch, n).
    """

    arclength: FloatArray
    configuration: FloatArray
    tip_momenta: FloatArray
    ends: FloatArray


@dataclass(frozen=True)
class Modes:
    """What the second variation says of each instance.

    Attributes:
        index: Number of unstable modes, -1 where rounding hides it, shape (batch,).
        tip_stiffness: Eigenvalue nearest zero of the form at the free tip (5) [N m], shape (batch,): it vanishes at a fold.
        uncertainty: How far that form is from being symmetric, as it is for exact columns [N m], shape (batch,).
    """

    index: NDArray[np.int32]
    tip_stiffness: FloatArray
    uncertainty: FloatArray


def segments_needed(
    length: FloatArray, stiffness: FloatArray, velocity_coupling: FloatArray, potential: FloatArray
) -> FloatArray:
    """(7) How many equal segments are sure to hold no conjugate point each, with a factor of 4 to spare.

    Args:
        length: Of the backbone [m].
        stiffness: The least of all rods' [N m^2].
        velocity_coupling: Bound of the terms in a variation and its rate, such as the moment [N m].
        potential: Bound of the terms in a variation alone, such as the force [N].
    """
    first, second = velocity_coupling / (np.pi * stiffness), potential / (np.pi**2 * stiffness)
    return np.asarray(2 * length * (first + np.sqrt(first**2 + second)))


def modes_with_free_tip(columns: NodeColumns) -> Modes:
    """(4) to (6): the unstable modes of a backbone clamped at its base and free at its tip."""
    count = len(columns.ends)
    result = Modes(np.full(count, -1, dtype=np.int32), np.full(count, np.nan), np.full(count, np.nan))
    longest = np.argmax(columns.ends, axis=1)
    order = np.argsort(columns.ends, axis=1, kind="stable")
    short = np.take_along_axis(columns.ends, order, 1) < columns.ends.max(axis=1)[:, None]
    patterns = np.column_stack([longest, np.where(short, order, -1)])
    for pattern in np.unique(patterns, axis=0):
        chosen = np.flatnonzero((patterns == pattern).all(axis=1))
        found = _of_pattern(columns, chosen, int(pattern[0]), [int(rod) for rod in pattern[1:] if rod >= 0])
        result.index[chosen], result.tip_stiffness[chosen], result.uncertainty[chosen] = found
    return result


def modes_by_segments(transition: FloatArray, frames: FloatArray, unit: FloatArray) -> tuple[int, float, float]:
    """(4), (5) from what each segment makes of a variation, so that columns cannot grow apart: ``W_k = P_k Y_k^-1`` is carried on.

    ``Y_(k+1) Y_k^-1 = A + B W_k`` and ``W_(k+1) = (C + D W_k) (A + B W_k)^-1``, (9).

    Args:
        transition: Of moment, then rotation, in the frames where segments begin and end, shape (segment, 6, 6).
        frames: There, body to world, shape (segment + 1, 3, 3).
        unit: Moment per rotation of the units in ``transition`` [N m], shape (3,).

    Returns:
        Index, tip stiffness and uncertainty, as in ``Modes``.
    """
    index = 0
    W = None
    for k, T in enumerate(transition):
        if W is None:
            Y, P = T[3:, :3], T[:3, :3]
        else:
            Y, P = T[3:, 3:] + T[3:, :3] @ W, T[:3, 3:] + T[:3, :3] @ W
            index += int(_negative(frames[k + 1] @ Y @ frames[k].T))
        inverse, sound = _inverse(Y)
        if not sound:
            return -1, np.nan, np.nan
        W = P @ inverse
    assert W is not None
    form = unit[:, None] * W
    values = np.linalg.eigvalsh((form + form.T) / 2)
    nearest = float(values[np.argmin(np.abs(values))])
    return index + int((values < 0).sum()), nearest, float(np.linalg.norm(form - form.T) / 2)


def _of_pattern(columns: NodeColumns, chosen: NDArray[np.intp], longest: int, ended: list[int]) -> tuple[FloatArray, ...]:
    """Index, tip stiffness and uncertainty of instances whose rods end in the same order, ``ended`` before the tip."""
    s, P = columns.arclength[chosen], columns.tip_momenta[chosen]
    Y = np.array(columns.configuration[chosen])
    Y[np.isnan(s)] = np.eye(Y.shape[-1])
    rods = [rod for rod in range(columns.ends.shape[1]) if rod != longest]
    rows = list(range(3 + len(rods)))  # of the rods that have not ended
    index = np.zeros(len(chosen))
    known = np.ones(len(chosen), dtype=bool)
    first = np.zeros(len(chosen), dtype=int)
    for rod in [*ended, -1]:
        end = columns.ends[chosen].max(axis=1) if rod < 0 else columns.ends[chosen, rod]
        last = np.argmax(s >= end[:, None], axis=1)
        inverse, sound = _inverse(Y)
        k = np.arange(s.shape[1] - 1)
        inside = (k >= first[:, None]) & (k < last[:, None])
        known &= (sound[:, :-1] | ~inside).all(axis=1)
        index += np.where(inside, _negative(Y[:, 1:] @ inverse[:, :-1]), 0).sum(axis=1)
        here = np.take_along_axis(inverse, last[:, None, None, None], 1)[:, 0]
        known &= np.take_along_axis(sound, last[:, None], 1)[:, 0]
        form = P @ here
        if rod < 0:
            break
        # (6) the angle of this rod is free from here on: eliminate it, and keep to the columns that leave its end without torque
        row = 3 + rods.index(rod)
        place = rows.index(row)
        index += form[:, place, place] < 0
        free = np.linalg.svd(P[:, place][:, None, :])[2][:, 1:].swapaxes(1, 2)
        rows.remove(row)
        Y = np.delete(Y, place, axis=2) @ free[:, None]
        P = np.delete(P, place, axis=1) @ free
        first = last
    # (5)
    known &= np.isfinite(form).all(axis=(1, 2))
    form[~known] = np.nan
    skew = np.linalg.norm(form - form.swapaxes(1, 2), axis=(1, 2)) / 2
    values = np.full((len(chosen), len(rows)), np.nan)
    values[known] = np.linalg.eigvalsh((form + form.swapaxes(1, 2))[known] / 2)
    index += (values < 0).sum(axis=1)
    nearest = np.take_along_axis(values, np.argmin(np.abs(np.nan_to_num(values)), axis=1)[:, None], 1)[:, 0]
    return np.where(known, index, -1), nearest, skew


def _inverse(Y: FloatArray) -> tuple[FloatArray, NDArray[np.bool_]]:
    """Inverses, and whether rounding leaves them their signs."""
    with np.errstate(all="ignore"):
        sound: NDArray[np.bool_] = np.asarray(np.isfinite(Y).all(axis=(-2, -1)))
        sound &= np.linalg.det(np.where(sound[..., None, None], Y, 0.0)) != 0
        inverse = np.linalg.inv(np.where(sound[..., None, None], Y, np.eye(Y.shape[-1])))
        sound &= np.linalg.norm(Y, axis=(-2, -1)) * np.linalg.norm(inverse, axis=(-2, -1)) < WORST_CONDITION
    return inverse, sound


def _negative(ratio: FloatArray) -> NDArray[np.int_]:
    """How many eigenvalues of each matrix have a negative real part; none does within a distance 1 of the identity."""
    far = ~(np.linalg.norm(ratio - np.eye(ratio.shape[-1]), axis=(-2, -1)) < 1)
    far &= np.isfinite(ratio).all(axis=(-2, -1))
    result = np.zeros(ratio.shape[:-2], dtype=int)
    result[far] = (np.linalg.eigvals(ratio[far]).real < 0).sum(axis=-1)
    return result
