"""Where the columns by inputs and parameters of parallel robots stand among directions, which legs share."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from multirod.models.backbone.derivatives.designs import COMPONENTS, POSE
from multirod.models.backbone.inputs import DRIVES
from multirod.models.platform import platform_kernels as kernels
from multirod.models.platform.derivatives.designs import PARAMETERS, PLACES, most_sections
from multirod.models.platform.geometry import Geometry
from multirod.models.platform.inputs import PER_ROD


@dataclass(frozen=True)
class InputColumns:
    """Where the columns by an input stand among the directions of a problem.

    Attributes:
        name: Of the input.
        start: Its first direction.
        size: How many it takes.
        shares: First of its numbers, and how many, of each leg; of all together where these share it.
        shared: Whether legs share it: if not, legs share its directions.
        on_legs: Whether it acts on legs.
    """

    name: str
    start: int
    size: int
    shares: tuple[tuple[int, int], ...]
    shared: bool
    on_legs: bool

    @property
    def numbers(self) -> int:
        """Of an instance."""
        return sum(self.shares[-1])

    @property
    def own(self) -> slice:
        """Its directions."""
        return slice(self.start, self.start + self.size)

    @property
    def is_parameter(self) -> bool:
        """Whether it is no input."""
        return self.name in PARAMETERS


def input_columns(geometry: Geometry, names: Sequence[str]) -> list[InputColumns]:
    """Where the columns of each input stand, in the order named: those that touch legs before the others."""
    found: dict[int, InputColumns] = {}
    start = 0
    for touching in (True, False):
        for k, name in enumerate(names):
            on_legs = name in (*PER_ROD, *DRIVES, *kernels.LEG_VECTORS, *COMPONENTS, "base")
            if on_legs is not touching:
                continue
            ends = _ends(geometry, name)
            shares = ((0, 3),) if ends is None else tuple((a, b - a) for a, b in pairwise(ends.tolist()))
            size = 0 if name == "platform" else max(count for _, count in shares)
            found[k] = InputColumns(name, start, size, shares, ends is None, on_legs)
            start += size
    return [found[k] for k in range(len(names))]


def _ends(geometry: Geometry, name: str) -> NDArray[np.intp] | None:
    """First of the numbers of each leg, and their end, (leg + 1,); None of what legs share."""
    if name in PER_ROD:
        return geometry.first_rod
    if name in DRIVES:
        return geometry.first_drive(name)
    if name in COMPONENTS:
        return np.asarray(geometry.first_rod * most_sections(geometry) * COMPONENTS[name])
    return np.arange(len(geometry.legs) + 1) * POSE if name in PLACES else None
