"""The step of all tasks in NumPy, what the compiled one is compared with. Numbers in parentheses: ``docs/tasks.md``."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from multirod.batch import solved_each
from multirod.validation import FloatArray

ROUNDED = 1e-12  # of the largest number of a row: what of a limit is rounding


@dataclass(frozen=True)
class Step:
    """A step of the freed inputs, and what holds it.

    Attributes:
        change: ``dp`` in the units of ``J``'s columns, shape (b, k).
        held: Which limits hold it: 1 at the upper, -1 at the lower, 0 not, shape (b, c).
        multipliers: Of the limits, each of the sign of ``held`` or zero, times the root of the softness, shape (b, c).
    """

    change: FloatArray
    held: NDArray[np.int8]
    multipliers: FloatArray


def step(
    J: FloatArray,
    r: FloatArray,
    *,
    softness: FloatArray | float,
    weight: FloatArray | float = 1.0,
    pull: FloatArray | float = 0.0,
    limits: FloatArray | None = None,
    low: FloatArray | None = None,
    high: FloatArray | None = None,
) -> Step:
    """(7) Minimise ``|J d + r|^2 / softness + |weight (d - pull)|^2`` over ``low <= limits d <= high``.

    Softness 1 is least squares with a prior; as it goes to 0 the rows are met where they can be, with the least of the second
    term; in between it damps. ``d = 0`` must be within the limits: an active set begins there, every pass stays within, and what
    is left after the last is within too.

    Args:
        J: Shape (b, m, k).
        r: Shape (b, m).
        softness: > 0, shape (b,) or a number.
        weight: > 0, shape (b, k) or (k,).
        pull: Shape (b, k) or (k,).
        limits: ``G``, shape (c, k) or (b, c, k); none by default.
        low: <= 0, shape (b, c).
        high: >= 0, shape (b, c).
    """
    count, m, k = J.shape
    square = np.broadcast_to(np.asarray(weight, dtype=np.float64), (count, k)) ** 2
    wanted = np.broadcast_to(np.asarray(pull, dtype=np.float64), (count, k))
    soft = np.broadcast_to(np.asarray(softness, dtype=np.float64), (count,))
    c = 0 if limits is None else limits.shape[-2]
    size = k + m + c
    system, sides = np.zeros((count, size, size)), np.zeros((count, size))
    across, up = np.arange(k), np.arange(k, k + m)
    # scaled by its root, softness is as far from 1 in the equations of steps as in those of rows: neither cancels
    root = np.sqrt(soft)[:, None]
    system[:, across, across] = root * square
    system[:, :k, k : k + m] = np.swapaxes(J, 1, 2)
    system[:, k : k + m, :k] = J
    system[:, up, up] = -root
    sides[:, :k] = root * square * wanted
    sides[:, k : k + m] = -r
    free = slice(0, k + m)
    first = solved_each(system[:, free, free], sides[:, free, None])[:, :k, 0]
    held, multipliers = np.zeros((count, c), dtype=np.int8), np.zeros((count, c))
    if limits is None or low is None or high is None:
        return Step(first, held, multipliers)
    G = np.broadcast_to(limits, (count, c, k))
    slack = ROUNDED * (1 + np.maximum(np.abs(np.nan_to_num(low, posinf=0, neginf=0)), np.abs(np.nan_to_num(high, posinf=0))))
    moved = (G @ first[..., None])[..., 0]
    outside = ((moved < low - slack) | (moved > high + slack)).any(axis=1)
    change = first
    if outside.any():
        k_m = slice(k + m, size)
        system[:, k_m, k_m] = np.eye(c)
        chosen = np.flatnonzero(outside)
        found = _active_set(system[chosen], sides[chosen], G[chosen], low[chosen], high[chosen], slack[chosen], k, m)
        change = np.array(first)
        change[chosen], held[chosen], multipliers[chosen] = found
    return Step(change, held, multipliers)


def _active_set(
    system: FloatArray, sides: FloatArray, G: FloatArray, low: FloatArray, high: FloatArray, slack: FloatArray, k: int, m: int
) -> tuple[FloatArray, NDArray[np.int8], FloatArray]:
    """(8) The programme from ``d = 0`` on, limits added as they block and left as their multipliers turn.

    A limit that depends on those that hold does not block: steps that keep these do not change it.
    """
    count, c, _ = G.shape
    d, held = np.zeros((count, k)), np.zeros((count, c), dtype=np.int8)
    multipliers = np.zeros((count, c))
    open_ = np.ones(count, dtype=bool)
    every, rows = np.arange(count), np.arange(k + m, k + m + c)
    for _ in range(3 * c + 2):
        on = (held != 0).astype(np.float64)
        system[:, k + m :, :k] = on[..., None] * G
        system[:, :k, k + m :] = np.swapaxes(system[:, k + m :, :k], 1, 2)
        system[:, rows, rows] = np.where(held != 0, 0.0, 1.0)
        bound = np.where(held > 0, high, low)
        sides[:, k + m :] = np.where(held != 0, bound, 0.0)
        solved = solved_each(system, sides[..., None])[..., 0]
        towards = solved[:, :k] - d
        rate, at = (G @ towards[..., None])[..., 0], (G @ d[..., None])[..., 0]
        with np.errstate(divide="ignore", invalid="ignore"):
            room = np.where(rate > 0, (high - at) / rate, np.where(rate < 0, (low - at) / rate, np.inf))
        small = np.abs(rate) <= slack * 1e-3
        room = np.where((held != 0) | small, np.inf, np.maximum(room, 0.0))
        blocking = np.argmin(room, axis=1)
        part = np.minimum(1.0, room[every, blocking])
        part = np.where(open_ & np.isfinite(solved).all(axis=1), part, 0.0)
        d = d + part[:, None] * np.where(np.isfinite(towards), towards, 0.0)
        blocked = open_ & (part < 1.0)
        held[blocked, blocking[blocked]] = np.where(rate[every, blocking][blocked] > 0, 1, -1)
        # a full step: leave the limit whose multiplier has turned most
        arrived = open_ & ~blocked
        multipliers = np.where((held != 0) & open_[:, None], np.nan_to_num(solved[:, k + m :]), multipliers)
        turned = np.where(held != 0, -held * multipliers, -np.inf)
        worst = np.argmax(turned, axis=1)
        leave = arrived & (turned[every, worst] > ROUNDED * (1 + np.abs(multipliers).max(axis=1)))
        open_ &= ~arrived | leave
        held[leave, worst[leave]] = 0
        if not open_.any():
            break
    multipliers = np.where(held * multipliers > 0, multipliers, 0.0)
    return d, held, multipliers
