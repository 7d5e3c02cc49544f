"""Derivatives where lines are neither taut nor slack, which have sides there: (D1b) of ``docs/derivatives.md``."""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from multirod.batch import solved_each
from multirod.problem import BoundaryProblem
from multirod.validation import FloatArray

AT_KINK = 1e-7  # of the scale of curvatures: a tension, or what a line is too long by, that what changes next takes away
ASIDE = 1e-12  # of it: where columns are those of one side
SAME = 1e-6  # of the larger one, by which derivatives to both sides of a number may differ
MOST_FLIPS = 256


def at_kinks(problem: BoundaryProblem) -> NDArray[np.bool_]:
    """Which unknowns are at their kinks, shape (instance_count, kink)."""
    near = AT_KINK * problem.curvature_scale()[:, None]
    return np.asarray(np.abs(problem.read("unknowns")[:, problem.kinks]) <= near)


def sided(
    problem: BoundaryProblem,
    here: NDArray[np.bool_],
    columns: Callable[[], tuple[FloatArray, FloatArray, FloatArray]],
    loosened: NDArray[np.bool_],
) -> FloatArray:
    """(D1b) Derivatives (b, m, k) of instances with an unknown at its kink; NaN of others, and of columns whose sides differ.

    Args:
        problem: At unknowns that it is left with.
        here: ``at_kinks`` there.
        columns: What an integration says at the unknowns that the problem holds: slopes of the residual (b, n, k), rows
            (b, m, n + k) and ``Gamma`` (b, n, n).
        loosened: Columns of which it is the side on which the number is less, shape (k,).
    """
    K, unknowns = problem.kinks, np.array(problem.read("unknowns"))
    aside, found = ASIDE * problem.curvature_scale()[:, None], []
    for sense in (-1.0, 1.0):
        moved = unknowns.copy()
        moved[:, K] = np.where(here, sense * aside, unknowns[:, K])
        problem.write("unknowns", moved)
        found.append(tuple(np.array(values) for values in columns()))
    problem.write("unknowns", unknowns)
    rows = np.flatnonzero(here.any(axis=1))
    slack, taut = ([values[rows] for values in side] for side in found)
    less, more = (_towards(slack, taut, K, here[rows], sense) for sense in (-1.0, 1.0))
    size = np.maximum(np.abs(less), np.abs(more)).max(axis=1, keepdims=True)
    same = (np.abs(more - less) <= SAME * size).all(axis=1)
    result = np.full((len(here), *more.shape[1:]), np.nan)
    both = np.where(same[:, None], (less + more) / 2, np.nan)
    result[rows] = np.where(loosened, less, both)
    return result


def _towards(
    slack: list[FloatArray], taut: list[FloatArray], K: NDArray[np.intp], here: NDArray[np.bool_], sense: float
) -> FloatArray:
    """Derivatives (b, m, k) on the side where each number is more (1) or less (-1): lines that it tightens are taut there."""
    slopes, rows, gamma = slack
    b, n, k = slopes.shape
    side = -sense * np.swapaxes(slopes, 1, 2).reshape(b * k, n, 1)
    own = np.repeat(np.arange(b), k)
    pulls = np.zeros((b * k, len(K)), dtype=bool)
    may, step = here[own], np.zeros((b * k, n))
    open_ = np.ones(b * k, dtype=bool)
    for _ in range(MOST_FLIPS):
        of = own[open_]
        matrix = gamma[of].copy()
        matrix[:, :, K] = np.where(pulls[open_][:, None], taut[2][of][:, :, K], matrix[:, :, K])
        step[open_] = solved_each(matrix, side[open_])[..., 0]
        change = step[:, K]
        wrong = (
            open_[:, None] & may & (pulls != (change > 0)) & (np.abs(change) > ASIDE * np.abs(step).max(axis=1, keepdims=True))
        )
        open_ = wrong.any(axis=1)
        if not open_.any():
            break
        # the first alone (Murty): so it ends, where Gamma has one sign whichever lines pull
        pulls[np.flatnonzero(open_), wrong[open_].argmax(axis=1)] ^= True
    step[open_] = np.nan
    by = rows[own][:, :, :n]
    by[:, :, K] = np.where(pulls[:, None], taut[1][own][:, :, K], by[:, :, K])
    moved = (by @ step[:, :, None])[..., 0].reshape(b, k, -1)
    return np.asarray(sense * np.swapaxes(moved, 1, 2) + rows[:, :, n:])
