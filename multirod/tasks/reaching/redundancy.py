"""What is done with freedom that a target leaves. Numbers in parentheses: ``docs/tasks.md``."""

import numpy as np

from multirod.batch import IntArray
from multirod.status import Status
from multirod.tasks.reaching.goals import Place
from multirod.tasks.reaching.search import REACHED, Search
from multirod.validation import FloatArray

DIFFERENCE = 0.02  # by which margins are differentiated, in units (9)
FIRST = 0.3  # step, likewise
LEAST = 0.02
ROUNDS = 12


def steadied(search: Search) -> None:
    """(14) Move reached instances along what their targets leave free, to where their stability margin is largest."""
    rows = np.flatnonzero(search.status == REACHED)
    count, m, k = search.J.shape
    if m >= k or not len(rows):
        return
    length = np.full(count, FIRST)
    margin = np.full(count, np.nan)
    margin[rows] = search.margin(rows)
    rows = rows[np.isfinite(margin[rows])]
    for _ in range(ROUNDS):
        rows = rows[length[rows] >= LEAST]
        if not len(rows):
            return
        best = search.last.copy()
        kept = search.errors.copy(), search.J.copy(), search.by.copy()
        direction = _ascent(search, rows)
        start = _inside(search, rows, length[rows, None] * direction)
        chosen = np.zeros(count, dtype=bool)
        chosen[rows] = True
        search.begin(rows, start)
        search.drive(chosen)
        found = rows[search.status[rows] == REACHED]
        better = np.zeros(count, dtype=bool)
        now = np.full(count, -np.inf)
        if len(found):
            now[found] = np.nan_to_num(search.margin(found), nan=-np.inf)
            better[found] = now[found] > margin[found]
        worse = rows[~better[rows]]
        search.last.put(worse, best)
        search.errors[worse], search.J[worse], search.by[worse] = (value[worse] for value in kept)
        search.status[rows] = Status.REACHED
        margin[better] = now[better]
        length[worse] *= 0.4


def _ascent(search: Search, rows: IntArray) -> FloatArray:
    """Unit directions in which margins grow, across the rows of ``J``, shape (len(rows), k)."""
    J = search.J[rows]
    m = J.shape[1]
    across = np.swapaxes(np.linalg.svd(J)[2], 1, 2)[:, :, m:]
    here = search.last.copy()
    slopes = np.zeros((len(rows), across.shape[2]))
    for j in range(across.shape[2]):
        for sign in (1, -1):
            d = sign * DIFFERENCE * across[:, :, j]
            search.last.x[rows] = here.x[rows] + (search.by[rows] @ d[..., None])[..., 0]
            search.last.p[rows] = here.p[rows] + search.goals.unit * d
            slopes[:, j] += sign * np.nan_to_num(search.margin(rows), posinf=0.0, neginf=0.0)
        search.integrations[rows] += 2
    search.last.put(rows, here)
    size = np.maximum(np.linalg.norm(slopes, axis=1, keepdims=True), 1e-300)
    return np.asarray((across @ (slopes / size)[..., None])[..., 0])


def _inside(search: Search, rows: IntArray, d: FloatArray) -> Place:
    """Steps ``d`` from ``last``, as far as limits let them go."""
    goals, p = search.goals, search.last.p[rows]
    at, rate = p @ goals.limits.matrix.T, (goals.unit * d) @ goals.limits.matrix.T
    with np.errstate(divide="ignore", invalid="ignore"):
        room = np.where(rate > 0, (goals.limits.high - at) / rate, np.where(rate < 0, (goals.limits.low - at) / rate, np.inf))
    part = np.clip(room.min(axis=1, initial=1.0), 0.0, 1.0)[:, None] * (1 - 1e-9)
    x = search.last.x[rows] + (search.by[rows] @ (part * d)[..., None])[..., 0]
    return Place(x, p + part * goals.unit * d)
