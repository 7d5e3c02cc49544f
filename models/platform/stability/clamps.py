"""Legs on a platform, clamped at places along them."""

from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np

from multirod.batch import IntArray
from multirod.capabilities import Clamps, Conjugates
from multirod.models.backbone.stability.clamps import ClampedBackbones, clamped
from multirod.validation import FloatArray

if TYPE_CHECKING:
    from multirod.models.platform.problem import ParallelProblem


class PlatformClamps(Clamps):
    """Of a ``ParallelProblem`` with legs in several pieces: the clamps of the first of these, then those of the next."""

    def __init__(self, problem: "ParallelProblem") -> None:
        self.problem, self.size = problem, int(problem.first_moment[-1])
        self._legs = list(self._find_legs())
        self.blocks = np.repeat(np.arange(len(problem.own)), np.diff(problem.first_moment))
        n = problem.unknown_count
        self._give = np.zeros((problem.instance_count, n, n))
        for leg in problem.own:
            self._give[:, range(leg.start, leg.start + 3), range(leg.stop - 3, leg.stop)] = 1.0
        self.unit = np.zeros((problem.instance_count, self.size))
        for _, own, chain, of_leg in self._legs:
            self.unit[:, own] = np.tile(chain.unit[of_leg], chain.pieces - 1)

    @property
    def pairs(self) -> Conjugates:  # noqa: D102
        pairs = self.problem.conjugates
        assert pairs is not None  # of a platform that is free, the only one that is clamped
        return pairs

    def put(self, moments: FloatArray) -> None:  # noqa: D102
        for _, own, chain, of_leg in self._legs:
            chain.moments[of_leg] = moments[:, own].reshape(len(moments), -1, chain.each)

    @property
    def first(self) -> IntArray:  # noqa: D102
        return np.concatenate([np.arange(own.start, own.stop, chain.each) for _, own, chain, _ in self._legs])

    def turned(self) -> FloatArray:  # noqa: D102
        result = np.zeros((self.problem.instance_count, self.size, self.problem.unknown_count + self.size))
        for leg, own, chain, of_leg in self._legs:
            found = chain.turned[of_leg]
            self._spread(result[:, own], leg, own, found.reshape(len(found), -1, found.shape[-1]))
        return result

    def moved(self) -> FloatArray:  # noqa: D102
        problem, first = self.problem, 0
        count = sum(chain.pieces - 1 for _, _, chain, _ in self._legs)
        result = np.zeros((problem.instance_count, count, 3, problem.unknown_count + self.size))
        for leg, own, chain, of_leg in self._legs:
            clamps = chain.pieces - 1
            self._spread(result[:, first : first + clamps], leg, own, chain.moved[of_leg])
            first += clamps
        return result

    def give(self) -> FloatArray:  # noqa: D102
        return self._give

    def frames(self) -> FloatArray:  # noqa: D102
        return np.concatenate([chain.frames[of_leg] for _, _, chain, of_leg in self._legs], axis=1)

    def _find_legs(self) -> Iterator[tuple[int, slice, ClampedBackbones, slice]]:
        """Of each leg in pieces its number, where its moments stand, and where it stands among backbones in pieces."""
        problem = self.problem
        places = {leg: (group, place) for group in problem.groups for place, leg in enumerate(group.members)}
        for leg in np.flatnonzero(problem.pieces > 1).tolist():
            group, place = places[leg]
            own = slice(*problem.first_moment[leg : leg + 2].tolist())
            yield leg, own, clamped(group.backbones), slice(place, None, len(group.members))

    def _spread(self, result: FloatArray, leg: int, own: slice, values: FloatArray) -> None:
        """Columns (..., k) of the clamps of a leg by its unknowns and moments, to where those of all stand, (..., n + size)."""
        n, last = self.problem.unknown_count, values.shape[-1] - (own.stop - own.start)
        result[..., self.problem.own[leg]] = values[..., :last]
        result[..., n + own.start : n + own.stop] = values[..., last:]
