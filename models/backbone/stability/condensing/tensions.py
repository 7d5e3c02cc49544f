"""The condensed form of rods with lines of given length: their tensions are eliminated, (18) of ``docs/stability.md``."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from multirod.models.backbone.kernels.tips import as_far, longest
from multirod.models.backbone.stability.condensing.inverses import row_condition
from multirod.models.backbone.stability.condensing.second_variation import STIFF, WORST_CONDITION, CondensedForm, NodeColumns
from multirod.validation import FloatArray

RIGID = 1e-9  # of what a line's tension does to its length with the tip free; less with the tip held, and it holds the tip
REDUNDANT = 1e-6  # of how turns of the tip change lengths; less, and lines that hold the tip do not determine their tensions


def with_conditions(
    form: CondensedForm,
    columns: NodeColumns,
    tensions: NodeColumns,
    gaps: FloatArray,
    own_gaps: FloatArray,
    taut: NDArray[np.bool_],
) -> CondensedForm:
    """(18) Of one rod with lines that are driven by their lengths: their tensions are eliminated, each of which is a condition.

    Args:
        form: With all tensions fixed.
        columns: By which that is made, c of them.
        tensions: The same by tensions.
        gaps: How what each line is too long by changes with ``columns``, shape (batch, line, c).
        own_gaps: The same with tensions, shape (batch, line, line).
        taut: Which lines are, shape (batch, line).
    """
    last = -1 - (~np.isnan(columns.arclength))[:, ::-1].argmax(axis=1)
    every, c = np.arange(len(last)), columns.configuration.shape[-1]
    ended = _ended(columns.ends)

    def at_tip(of: NodeColumns) -> tuple[FloatArray, FloatArray]:
        """What is given there, and what follows from it: of rods that ended before, that no torque is at their ends, (6)."""
        given = np.where(ended[:, :, None], of.tip_momenta, of.configuration[every, last])
        follows = np.where(ended[:, :, None], 0.0, of.tip_momenta)
        if of.tip_force is None or of.tip_position is None:
            return given, follows
        return np.concatenate([given, of.tip_force], axis=1), np.concatenate([follows, -of.tip_position], axis=1)

    (given, follows), (by_given, by_follows) = at_tip(columns), at_tip(tensions)
    known = form.known & np.isfinite(own_gaps).all(axis=(1, 2))
    known &= np.isfinite(given).all(axis=(1, 2))
    given = np.where(known[:, None, None], given, np.eye(c))
    known &= row_condition(given) < WORST_CONDITION
    given = np.where(known[:, None, None], given, np.eye(c))
    at_given = np.linalg.solve(given, np.concatenate([np.broadcast_to(np.eye(c), given.shape), -by_given], axis=2))
    couple, lengths = follows @ at_given[:, :, c:] + by_follows, gaps @ at_given
    lengths[:, :, : ended.shape[1]] *= ~ended[:, None]
    size = np.abs(own_gaps).max(axis=(1, 2), initial=1.0)
    form = replace(form, known=known)
    return without_tensions(form, couple, lengths[:, :, :c], lengths[:, :, c:] + own_gaps, size, taut)


def _ended(ends: FloatArray) -> NDArray[np.bool_]:
    """Which angles are of rods that end before the tip, of all that the configuration has there, from ``ends`` (batch, n)."""
    others = np.arange(ends.shape[1]) != longest(ends)[:, None]
    short = ~as_far(ends, ends.max(axis=1, keepdims=True))
    return np.pad(short[others].reshape(len(ends), -1), ((0, 0), (3, 0)))


def without_tensions(
    form: CondensedForm, couple: FloatArray, turns: FloatArray, own: FloatArray, size: FloatArray, taut: NDArray[np.bool_]
) -> CondensedForm:
    """(18) ``form`` with the tensions eliminated that are not fixed.

    Args:
        form: With all tensions fixed, of c variations of the tip.
        couple: What these tensions do there where it is held, shape (batch, c, line).
        turns: How what each line is too long by changes with the tip, shape (batch, line, c).
        own: The same with tensions where the tip is held, shape (batch, line, line).
        size: Of such changes where it is free, shape (batch,).
        taut: Which lines are, shape (batch, line).
    """
    count, known = taut.shape[1], form.known
    given = np.where(taut[:, :, None] & taut[:, None], own, -np.eye(count))
    own = np.where(known[:, None, None], given, -np.eye(count))
    couple, turns = np.where(taut[:, None], couple, 0.0), np.where(taut[:, :, None], turns, 0.0)
    rigid = (np.abs(np.linalg.eigvals(own)) < RIGID * size[:, None]).any(axis=1) & known
    known = known & ((np.linalg.cond(own) < WORST_CONDITION) | rigid)
    own = np.where((known & ~rigid)[:, None, None], own, -np.eye(count))
    negative = (np.linalg.eigvals(own).real < 0).sum(axis=1)
    matrix = form.matrix - couple @ np.linalg.solve(own, turns)
    for k in np.flatnonzero(rigid):
        matrix[k], negative[k], known[k] = _held(form.matrix[k], couple[k], turns[k], given[k])
    return CondensedForm(matrix, form.conjugate + (negative - count).astype(np.int32), known)


def _held(matrix: FloatArray, couple: FloatArray, turns: FloatArray, own: FloatArray) -> tuple[FloatArray, int, bool]:
    """(18) Where lines by themselves hold some turns of the tip: those are left out, as what is infinitely stiff.

    Of one instance: the form, its number of negative eigenvalues of ``S_TT`` and whether both are known.
    """
    values, vectors = np.linalg.eigh((own + own.T) / 2)
    rigid = np.abs(values) < RIGID * max(1.0, np.abs(values).max())
    give = (vectors[:, ~rigid].T @ turns) / values[~rigid, None]
    result = matrix - couple @ vectors[:, ~rigid] @ give
    _, sizes, axes = np.linalg.svd(vectors[:, rigid].T @ turns)
    known = rigid.sum() <= len(matrix) and bool(sizes[-1] > REDUNDANT * np.abs(turns).max())
    held = axes[: rigid.sum()]
    free = np.eye(len(matrix)) - held.T @ held
    stiff = STIFF * np.abs(matrix).max()
    return free @ result @ free + stiff * held.T @ held, int((values[~rigid] < 0).sum() + rigid.sum()), known
