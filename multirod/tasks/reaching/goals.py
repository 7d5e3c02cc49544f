"""What a search is for, and where its instances are."""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from multirod.batch import IntArray
from multirod.tasks.limits import LimitRows, Limits
from multirod.tasks.rows import PoseRows
from multirod.validation import FloatArray

Prefer = Literal["smallest motion", "smallest tension", "middle", "stability"]
BoolArray = NDArray[np.bool_]


@dataclass
class Place:
    """Unknowns and freed inputs; axes (instance, ...)."""

    x: FloatArray
    p: FloatArray

    def copy(self) -> "Place":
        """Another, that may change."""
        return Place(self.x.copy(), self.p.copy())

    def put(self, chosen: IntArray | BoolArray, other: "Place") -> None:
        """Take some instances of another."""
        self.x[chosen], self.p[chosen] = other.x[chosen], other.p[chosen]


@dataclass
class Goals:
    """What a search is for.

    Attributes:
        rows: Of the target.
        limits: Of the freed inputs.
        of_shape: Limits of shapes, if any.
        unit: (9), shape (k,).
        length: What makes rows numbers, the longest rod's [m].
        tolerance: Of the target, in its rows [1/m].
        residual_tolerance: Of ``eps`` [1/m], shape (b,).
        centre: Where what the target leaves free is pulled to, shape (k,); None are steps of least size.
        max_integrations: Allowed, of an instance and start.
    """

    rows: PoseRows
    limits: LimitRows
    of_shape: Limits | None
    unit: FloatArray
    length: float
    tolerance: float
    residual_tolerance: FloatArray
    centre: FloatArray | None
    max_integrations: int
