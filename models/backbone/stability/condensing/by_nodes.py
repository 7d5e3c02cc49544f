"""The condensed form from columns at nodes: conjugate points on the way to the tip, and what is left there.

Numbers in parentheses are those of ``docs/stability.md``.
"""

import numpy as np
from numpy.typing import NDArray

from multirod.models.backbone.kernels.tips import as_far, longest
from multirod.models.backbone.stability.condensing.inverses import inverses, negative_count, row_condition
from multirod.models.backbone.stability.condensing.second_variation import STIFF, WORST_CONDITION, CondensedForm, NodeColumns
from multirod.rotations import cross
from multirod.validation import FloatArray


def condensed_form(columns: NodeColumns, unit: FloatArray) -> CondensedForm:
    """(4) to (6): eliminate all but the tip of a backbone clamped at its base; ``unit`` is ``K/L`` [N m], shape (batch,)."""
    count = len(columns.ends)
    held = columns.tip_force is not None
    size = columns.tip_momenta.shape[1] + (3 if held else 0)
    matrix = np.zeros((count, size, size))
    matrix[:, range(size), range(size)] = STIFF * unit[:, None]
    result = CondensedForm(matrix, np.zeros(count, dtype=np.int32), np.zeros(count, dtype=bool))
    order = np.argsort(columns.ends, axis=1, kind="stable")
    short = ~as_far(np.take_along_axis(columns.ends, order, 1), columns.ends.max(axis=1, keepdims=True))
    patterns = np.column_stack([longest(columns.ends), np.where(short, order, -1)])
    alike = (patterns == patterns[:1]).all()
    for pattern in patterns[:1] if alike else np.unique(patterns, axis=0):
        chosen = np.flatnonzero((patterns == pattern).all(axis=1))
        ended = [int(rod) for rod in pattern[1:] if rod >= 0]
        form, rows, conjugate, known = _of_pattern(columns, chosen, int(pattern[0]), ended)
        rows += range(size - 3, size) if held else ()
        matrix[np.ix_(chosen, np.array(rows), np.array(rows))] = form
        result.conjugate[chosen], result.known[chosen] = conjugate, known
    return result


def compliance_form(columns: NodeColumns, moment: FloatArray) -> CondensedForm:
    """The second variation of a single rod whose tip is held, by the wrench on it ((12) of ``docs/held.md``).

    Args:
        columns: With those of the tip's force and position.
        moment: At the tip, in the world [N m], shape (batch, 3).

    Returns:
        How the negative rotation and position of the tip vary with the moment and the force on it, and the index of the rod with
        a free tip under these.
    """
    assert columns.tip_force is not None
    assert columns.tip_position is not None
    count, s = len(moment), columns.arclength
    every, last = np.arange(count), s.shape[1] - 1 - (~np.isnan(s))[:, ::-1].argmax(axis=1)
    rotation = columns.configuration[every, last]
    # a moment varies by rotations along geodesics: so its second derivatives are symmetric
    momenta = columns.tip_momenta - 0.5 * cross(rotation.swapaxes(1, 2), moment[:, None]).swapaxes(1, 2)
    dead = _by_force(columns.tip_force)[..., :3]
    Y = columns.configuration @ dead[:, None]
    Y[np.isnan(s)] = np.eye(3)
    inverse, sound = inverses(Y)
    before = np.arange(s.shape[1] - 1) < last[:, None]
    with np.errstate(all="ignore"):  # what is not sound need not be finite
        ratio = Y[:, 1:] @ inverse[:, :-1]
        # the tip is free: its own rotation is eliminated before that of the last node
        ratio[every, last - 1] = (momenta @ dead) @ inverse[every, last - 1]
        conjugate = np.where(before, negative_count(ratio), 0).sum(axis=1)
    wrench = np.concatenate([momenta, columns.tip_force], axis=1)
    known = (sound[:, :-1] | ~before).all(axis=1) & np.isfinite(wrench).all(axis=(1, 2))
    known[known] = row_condition(wrench[known]) < WORST_CONDITION
    by_wrench = np.linalg.inv(np.where(known[:, None, None], wrench, np.eye(6)))
    matrix = -np.concatenate([rotation, columns.tip_position], axis=1) @ by_wrench
    return CondensedForm(matrix, conjugate.astype(np.int32), known)


def _of_pattern(
    columns: NodeColumns, chosen: NDArray[np.intp], longest: int, ended: list[int]
) -> tuple[FloatArray, list[int], NDArray[np.int_], NDArray[np.bool_]]:
    """Form, its rows, conjugate points and whether they are known, where rods end in the same order, ``ended`` before the tip."""
    s, P = columns.arclength[chosen], columns.tip_momenta[chosen]
    Y = np.array(columns.configuration[chosen])
    m = Y.shape[-2]
    Y[np.isnan(s)] = np.eye(m, Y.shape[-1])
    position = np.zeros((len(chosen), 0, m))
    if columns.tip_force is not None and columns.tip_position is not None:
        # columns without a force on the tip, then one for each component of it
        basis = _by_force(columns.tip_force[chosen])
        Y, P, position = Y @ basis[:, None], P @ basis, columns.tip_position[chosen] @ basis
    rods = [rod for rod in range(columns.ends.shape[1]) if rod != longest]
    rows = list(range(m))  # of the rods that have not ended
    conjugate = np.zeros(len(chosen), dtype=int)
    known = np.ones(len(chosen), dtype=bool)
    first = np.zeros(len(chosen), dtype=int)
    passed = 0  # nodes before all that are left, of which Y has none
    every = np.arange(len(chosen))
    for rod in [*ended, -1]:
        end = columns.ends[chosen].max(axis=1) if rod < 0 else columns.ends[chosen, rod]
        last = np.argmax(s >= end[:, None], axis=1)
        reached = int(last.max()) + 1 - passed
        Y_here = Y[:, :reached, :, : len(rows)]
        inverse, sound = inverses(Y_here)
        k = passed + np.arange(reached - 1)
        inside = (k >= first[:, None]) & (k < last[:, None])
        known &= (sound[:, :-1] | ~inside).all(axis=1)
        with np.errstate(all="ignore"):  # what is not sound need not be finite
            ratio = Y_here[:, 1:] @ inverse[:, :-1]
        conjugate += np.where(inside, negative_count(ratio), 0).sum(axis=1)
        here = inverse[every, last - passed]
        known &= sound[every, last - passed]
        if rod < 0:
            break
        # (6) the angle of this rod is free from here on: eliminate it, and keep to the columns that leave its end without torque
        row = 3 + rods.index(rod)
        place = rows.index(row)
        conjugate += (P[:, :, : len(rows)] @ here)[:, place, place] < 0
        free = _without_torque(P[:, place], len(rows))
        rows.remove(row)
        done, passed = int(last.min()) - passed, int(last.min())
        Y = np.delete(Y[:, done:], place, axis=2) @ free[:, None]
        P, position = np.delete(P, place, axis=1) @ free, position @ free
        first = last
    # (5), (21)
    r = len(rows)
    by_tip = np.zeros((len(chosen), P.shape[-1], P.shape[-1]))
    by_tip[:, :r, :r] = here
    by_tip[:, :r, r:] = -here @ Y[every, last - passed][:, :, r:]
    by_tip[:, range(r, P.shape[-1]), range(r, P.shape[-1])] = 1.0
    with np.errstate(all="ignore"):  # what is not sound need not be finite
        form = np.concatenate([P, -position], axis=1) @ by_tip
    known &= np.isfinite(form).all(axis=(1, 2))
    return form, rows, conjugate, known


def _by_force(tip_force: FloatArray) -> FloatArray:
    """(20) Combinations of columns (batch, c, c): those by which the force (batch, 3, c) stays, then one a component of it."""
    count, c = len(tip_force), tip_force.shape[-1]
    basis = np.broadcast_to(np.eye(c), (count, c, c)).copy()
    sound = np.isfinite(tip_force).all(axis=(1, 2)) & (np.linalg.det(np.nan_to_num(tip_force[:, :, -3:])) != 0)
    inverse = np.linalg.inv(np.where(sound[:, None, None], tip_force[:, :, -3:], np.eye(3)))
    basis[:, -3:, :-3] = -inverse @ np.where(sound[:, None, None], tip_force[:, :, :-3], np.nan)
    basis[:, -3:, -3:] = inverse
    return basis


def _without_torque(torque: FloatArray, r: int) -> FloatArray:
    """(6), (20) Combinations (batch, c, c - 1) of columns that leave a torque (batch, c) as it is: of the first r alone, then of
    each other."""
    count, c = torque.shape
    free = np.zeros((count, c, c - 1))
    own = torque[:, :r]
    # the reflection that takes it into the first direction: its other columns are across it
    axis = np.array(own)
    axis[:, 0] += np.copysign(np.sqrt((own**2).sum(axis=1)), own[:, 0])
    share = 2 / np.maximum((axis**2).sum(axis=1), 1e-300)
    free[:, :r, : r - 1] = np.eye(r)[:, 1:] - (share[:, None] * axis)[:, :, None] * axis[:, None, 1:]
    free[:, :r, r - 1 :] = -own[:, :, None] * (torque[:, r:] / (own**2).sum(axis=1, keepdims=True))[:, None, :]
    free[:, range(r, c), range(r - 1, c - 1)] = 1.0
    return free
