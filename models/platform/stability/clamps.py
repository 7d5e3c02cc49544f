"""Legs on a platform, clamped at places along them."""

from typing import TYPE_CHECKING

import numpy as np

from multirod.capabilities import Clamps, Conjugates
from multirod.models.backbone.stability.clamps import clamped
from multirod.validation import FloatArray

if TYPE_CHECKING:
    from multirod.models.platform.problem import ParallelProblem


class PlatformClamps(Clamps):
    """Of a ``ParallelProblem`` made of several pieces a leg: the clamps of the first leg, then those of the next."""

    def __init__(self, problem: "ParallelProblem") -> None:
        self.problem, self.each = problem, problem.pieces - 1
        count, legs = problem.instance_count, len(problem.geometry.legs)
        self.size = 3 * self.each * legs
        unit = np.zeros((count, legs, self.each, 3))
        for group in problem.groups:
            unit[:, list(group.members)] = clamped(group.backbones).unit.reshape(count, -1, 1, 3)
        self.unit = unit.reshape(count, self.size)

    @property
    def pairs(self) -> Conjugates:  # noqa: D102
        pairs = self.problem.conjugates
        assert pairs is not None  # of a platform that is free, the only one that is clamped
        return pairs

    def put(self, moments: FloatArray) -> None:  # noqa: D102
        own = moments.reshape(len(moments), -1, self.each, 3)
        for group in self.problem.groups:
            clamped(group.backbones).moments[:] = own[:, list(group.members)].reshape(-1, self.each, 3)

    def turned(self) -> FloatArray:  # noqa: D102
        return self._by_all("turned").reshape(self.problem.instance_count, self.size, -1)

    def moved(self) -> FloatArray:  # noqa: D102
        found = self._by_all("moved")
        return found.reshape(len(found), -1, 3, found.shape[-1])

    def give(self) -> FloatArray:  # noqa: D102
        n = self.problem.unknown_count
        result = np.zeros((self.problem.instance_count, n, n))
        for own in self.problem.own:
            result[:, range(own.start, own.start + 3), range(own.stop - 3, own.stop)] = 1.0
        return result

    def frames(self) -> FloatArray:  # noqa: D102
        return self._of_legs("frames", 3, 3).reshape(self.problem.instance_count, -1, 3, 3)

    def _of_legs(self, name: str, *tail: int) -> FloatArray:
        problem = self.problem
        result = np.zeros((problem.instance_count, len(problem.geometry.legs), self.each, *tail))
        for group in problem.groups:
            result[:, list(group.members)] = getattr(clamped(group.backbones), name).reshape(len(result), -1, self.each, *tail)
        return result

    def _by_all(self, name: str) -> FloatArray:
        """Columns of the clamps, shape (instance_count, leg, clamp, 3, n + size)."""
        problem, n, k = self.problem, self.problem.unknown_count, 3 * self.each
        legs = len(problem.geometry.legs)
        result = np.zeros((problem.instance_count, legs, self.each, 3, n + self.size))
        for group in problem.groups:
            values = getattr(clamped(group.backbones), name)
            values = values.reshape(len(result), -1, *values.shape[1:])
            m = values.shape[-1] - k
            for place, leg in enumerate(group.members):
                result[:, leg, ..., problem.own[leg]] = values[:, place, ..., :m]
                result[:, leg, ..., n + k * leg : n + k * (leg + 1)] = values[:, place, ..., m:]
        return result
