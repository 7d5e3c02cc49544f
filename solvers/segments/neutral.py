"""What symmetry leaves neutral, in segments: Newton's steps without it.

Numbers in parentheses are those of ``docs/branches.md``.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from multirod.segments import Cuts
from multirod.status import BoolArray
from multirod.validation import FloatArray


@dataclass(frozen=True)
class Neutral:
    """As many directions of several instances as they have neutral modes, orthonormal.

    Attributes:
        right: Of the unknowns, along which no step goes, shape (count, n, m).
        left: Of what is lacking at the tip, along which nothing is asked for, shape (count, n, m).
    """

    right: FloatArray
    left: FloatArray

    @classmethod
    def of_gamma(cls, gamma: FloatArray, modes: int) -> "Neutral":
        """By the last so many singular vectors of each ``Gamma``, (count, n, n)."""
        with np.errstate(invalid="ignore"):
            left, _, right = np.linalg.svd(np.nan_to_num(gamma))
        return cls(right[:, -modes:].swapaxes(1, 2), left[:, :, -modes:])

    @property
    def modes(self) -> int:
        """How many there are of each instance."""
        return int(self.right.shape[2])

    def chosen(self, some: BoolArray) -> "Neutral":
        """Of some of the instances, (count,)."""
        return self if some.all() else Neutral(self.right[some], self.left[some])

    def put(self, some: BoolArray, other: "Neutral") -> "Neutral":
        """These, with others in place of some of the instances, (count,)."""
        right, left = self.right.copy(), self.left.copy()
        right[some], left[some] = other.right, other.left
        return Neutral(right, left)

    @property
    def swapped(self) -> "Neutral":
        """Those of the transposes."""
        return Neutral(self.left, self.right)

    @cached_property
    def across(self) -> tuple[FloatArray, FloatArray]:
        """``Q`` and ``P``: what is across either, shape (count, n, n - m) each."""
        right, left = (np.linalg.qr(own, mode="complete")[0][:, :, self.modes :] for own in (self.right, self.left))
        return right, left

    def left_across(self, lacking: FloatArray) -> FloatArray:
        """What is lacking at the tip (count, n), across what is neutral, (count, n - m)."""
        return np.asarray(np.einsum("kij,ki->kj", self.across[1], lacking))

    def from_across(self, step: FloatArray) -> FloatArray:
        """Of steps (count, n - m) of the unknowns across what is neutral, those of the unknowns, (count, n)."""
        return np.asarray(np.einsum("kij,kj->ki", self.across[0], step))

    def bordered(
        self, cuts: Cuts, transition: FloatArray, tip: FloatArray, places: NDArray[np.intp]
    ) -> tuple[FloatArray, FloatArray]:
        """(24) Transitions (segment_count, d, d or more) whose first n - m columns are, where an instance begins, those of its
        unknowns across what is neutral, and what is lacking at the tip across that (count, n - m, d or more)."""
        right, left = self.across
        kept, first, alone = right.shape[2], cuts.first[:-1], cuts.counts == 1
        transition, tip = transition.copy(), left.swapaxes(1, 2) @ tip
        transition[first, :, :kept] = transition[first][:, :, places] @ right
        tip[alone, :, :kept] = tip[alone][:, :, places] @ right[alone]
        return transition, tip
