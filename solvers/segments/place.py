"""States of several instances where their segments begin, and where these lead."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from multirod.segments import Cuts, Propagation
from multirod.status import BoolArray
from multirod.validation import FloatArray


@dataclass
class Place:
    """States of several instances and where their segments lead.

    Attributes:
        cuts: The segments.
        found: Where they lead.
    """

    cuts: Cuts
    found: Propagation

    def chosen(self, some: BoolArray) -> "Place":
        """Of some of the instances, (count,)."""
        return Place(self.cuts.chosen(some), self.found.chosen(self.cuts, some))

    def put(self, some: BoolArray, other: "Place") -> "Place":
        """This, with ``other`` in place of some of the instances, (count,)."""
        return Place(self.cuts.put(some, other.cuts), self.found.put(self.cuts, some, other.cuts, other.found))

    def gamma(self, places: NDArray[np.intp]) -> FloatArray:
        """The product of all transitions of each, by the unknowns that have these ``places`` (n,) among variations at the base,
        shape (count, n, n); not finite where it is too large."""
        cuts, d = self.cuts, self.found.transition.shape[1]
        count, n = cuts.unknowns.shape
        led = np.zeros((count, d, n))
        led[:, places, np.arange(n)] = 1.0
        with np.errstate(over="ignore", invalid="ignore"):
            for k in range(int(cuts.counts.max()) - 1):
                on = cuts.counts > k + 1
                led[on] = self.found.transition[cuts.first[:-1][on] + k, :, :d] @ led[on]
            return np.asarray(self.found.residual_columns[:, :, :d] @ led)
