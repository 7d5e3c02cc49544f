"""Legs that meet only at their platform: what their turns say is told leg by leg.

Numbers in parentheses are those of ``docs/branches.md``.
"""

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass

import numpy as np

from multirod.batch import IntArray
from multirod.validation import FloatArray


class Arrow:
    """(19) Where the legs stand in ``Y`` and in ``Gamma``, and the platform, whose own rows of ``Y`` are zero but in its columns.

    Blocks of fewer rows than the largest are filled up by ones on the diagonal, so that all are worked on at once.

    Args:
        blocks: Unknowns and moments of each leg, which are the numbers of its residuals too.
        border: Those of the platform.
        order: Of which residual each row of ``Points.turned`` is, shape (n,).
        forces: Of which residual each of the first rows is, that are forces, shape (m,).

    Attributes:
        rows: Of each leg in ``Points.turned``, those of forces first, n where it has fewer, shape (leg, s).
        columns: Likewise.
        border_rows: Of the platform, shape (b,).
        border: Its columns.
        turns: The first of ``rows``, those of forces, m where a leg has fewer, shape (leg, t).
        border_turns: The first of ``border_rows``, likewise.
        neutral: What is as regular as can be, and of this shape, (n, n).
    """

    def __init__(self, blocks: Sequence[IntArray], border: IntArray, order: IntArray, forces: IntArray) -> None:
        self.n, self.m = n, m = len(order), len(forces)
        place = np.argsort(order)
        rows = [np.sort(place[own]) for own in blocks]
        self.rows, self.columns = _filled(rows, n), _filled(blocks, n)
        self.border_rows, self.border = np.sort(place[border]), border
        self.turns = _filled([own[own < m] for own in rows], m)
        self.border_turns = self.border_rows[self.border_rows < m]
        self.neutral = np.eye(n)[order]
        self._others = np.setdiff1d(np.arange(n), border)
        self._told, self._border_told = _taken(self.turns, m, forces), forces[self.border_turns]
        self._sign = _sign([*np.concatenate(rows), *self.border_rows]) * _sign([*np.concatenate(blocks), *border])

    def fits(self, both: FloatArray) -> bool:
        """Whether the platform's rows are as said, of all of ``Points.turned``, (k, n, n)."""
        return not both[:, self.border_rows[:, None], self._others].any()

    def inverse(self, both: FloatArray) -> "ArrowInverse":
        """(19) Of each, (k, n, n); NaN of what is singular."""
        rows, columns = _taken(self.rows, self.n), _taken(self.columns, self.n)
        own = self.rows < self.n  # as many columns as rows
        square = own[:, :, None] & own[:, None]
        blocks = np.where(square, both[:, rows[:, :, None], columns[:, None]], np.eye(own.shape[1]))
        corner = both[:, self.border_rows[:, None], self.border]
        beside = np.where(own[:, :, None], both[:, rows[:, :, None], self.border], 0.0)
        signs = np.linalg.slogdet(blocks)[0].prod(axis=1) * np.linalg.slogdet(corner)[0]
        inverse, last = inverses(blocks.reshape(-1, *blocks.shape[2:])).reshape(blocks.shape), inverses(corner)
        with np.errstate(invalid="ignore", over="ignore"):  # of what is all but singular
            coupled = -inverse @ (beside @ last[:, None])
        return ArrowInverse(self, inverse, coupled, last, self._sign * signs)

    def told(self, gamma: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """The forces of each leg in ``Gamma``, (k, n, n), by its own columns and by the platform's, then those on the platform
        likewise."""
        columns, own = _taken(self.columns, self.n), self.columns < self.n
        there = (self.turns < self.m)[:, :, None]
        by_own = np.where(there & own[:, None], gamma[:, self._told[:, :, None], columns[:, None]], 0.0)
        by_platform = np.where(there, gamma[:, self._told[:, :, None], self.border], 0.0)
        on_platform = np.where(own[:, None], gamma[:, self._border_told[:, None], columns[:, None]], 0.0)
        return by_own, by_platform, on_platform, gamma[:, self._border_told[:, None], self.border]


@dataclass(frozen=True)
class ArrowInverse:
    """(19) Inverses of ``Y``.

    Attributes:
        arrow: Of which.
        blocks: Of the legs, shape (k, leg, s, s).
        beside: By the rows of the platform, shape (k, leg, s, b).
        corner: Of the platform, shape (k, b, b).
        sign: Of the determinants of what they are inverses of, shape (k,).
    """

    arrow: Arrow
    blocks: FloatArray
    beside: FloatArray
    corner: FloatArray
    sign: FloatArray

    def dense(self) -> FloatArray:
        """All numbers, shape (k, n, n)."""
        arrow, n = self.arrow, self.arrow.n
        result = np.zeros((len(self.blocks), n + 1, n + 1))  # what fills blocks up falls into the last
        result[:, arrow.columns[:, :, None], arrow.rows[:, None]] = self.blocks
        result[:, arrow.columns[:, :, None], arrow.border_rows] = self.beside
        result[:, arrow.border[:, None], arrow.border_rows] = self.corner
        return result[:, :n, :n]

    def changes(self, gamma: FloatArray) -> FloatArray:
        """(20) How forces change with the turns: the rows of ``gamma``, (k, n, n), that are forces, by the inverse, (k, m, m)."""
        arrow, m = self.arrow, self.arrow.m
        by_own, by_platform, on_platform, of_platform = arrow.told(gamma)
        t, b = arrow.turns.shape[1], len(arrow.border_turns)
        blocks, beside, corner = self.blocks[..., :t], self.beside[..., :b], self.corner[..., :b]
        result, turns, last = np.zeros((len(gamma), m + 1, m + 1)), arrow.turns, arrow.border_turns
        result[:, turns[:, :, None], turns[:, None]] = by_own @ blocks
        result[:, turns[:, :, None], last] = by_own @ beside + by_platform @ corner[:, None]
        result[:, last[None, :, None], turns[:, None]] = on_platform @ blocks
        result[:, last[:, None], last] = (on_platform @ beside).sum(axis=1) + of_platform @ corner
        return result[:, :m, :m]


def inverses(matrices: FloatArray) -> FloatArray:
    """Of each of many (k, n, n); NaN of what is singular."""
    try:
        return np.asarray(np.linalg.inv(matrices))
    except np.linalg.LinAlgError:
        result = np.full_like(matrices, np.nan)
        for k, matrix in enumerate(matrices):
            with suppress(np.linalg.LinAlgError):
                result[k] = np.linalg.inv(matrix)
        return result


def _filled(places: Sequence[IntArray], filling: int) -> IntArray:
    """Lists of places as rows of one array, the shorter ones filled up."""
    result = np.full((len(places), max(map(len, places))), filling)
    for row, own in zip(result, places, strict=True):
        row[: len(own)] = own
    return result


def _taken(places: IntArray, size: int, among: IntArray | None = None) -> IntArray:
    """Places that can be read: the first in the stead of what fills up; of those where these are, if they are told."""
    found = np.where(places < size, places, 0)
    return found if among is None else among[found]


def _sign(permutation: Sequence[int]) -> float:
    """1 of an even permutation, -1 of an odd one."""
    left, sign = [int(k) for k in permutation], 1.0
    for k in range(len(left)):
        while left[k] != k:
            other = left[k]
            left[k], left[other] = left[other], left[k]
            sign = -sign
    return sign
