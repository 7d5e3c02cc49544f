"""Instances of a batch in the colours of a quantity."""

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Self

import numpy as np
from numpy.typing import NDArray

from multirod.results.quantities import SCALARS
from multirod.validation import Described, FloatArray, array, refuse

if TYPE_CHECKING:
    from multirod.results.history import History

SCALE = (0x4F83F1, 0x3FC1B0, 0xF4E04D, 0xE8503A)
WORDS = "blue, teal, yellow, red"
_UNKNOWN = 0x868E96
_WIDE = 100.0  # the largest over the smallest value from which colours are of the logarithm


@dataclass(frozen=True)
class Coloring:
    """Colours of instances.

    Attributes:
        name: Of the quantity.
        low: Its smallest value.
        high: Its largest.
        logarithmic: Whether colours are of its logarithm.
        colors: As the viewer takes them, axes (sample, instance).
    """

    name: str
    low: float
    high: float
    logarithmic: bool
    colors: NDArray[np.uint32]

    @classmethod
    def of(cls, by: object, history: "History", block: "History") -> Self:
        """Colours of the instances of ``block``, the first of ``history``.

        Raises:
            ValueError: If ``by`` is no quantity of a solution, and no array with the history's leading axes.
        """
        samples = len(history.time)
        if isinstance(by, str):
            if by not in SCALARS:
                refuse("save.colour_by", by, f"must be one of {', '.join(SCALARS)}, or an array of values")
            name, values = by.replace("_", " "), np.asarray(getattr(block, by), dtype=np.float64)
        else:
            name, values = "values given", array("save.colour_by", by, finite=False)
        shape = block.batch_shape if isinstance(by, str) else history.batch_shape
        try:
            every = np.broadcast_to(values, shape).reshape(samples, -1)[:, : math.prod(block.batch_shape[1:])]
        except ValueError:
            given = Described(f"array of shape {values.shape}")
            refuse("save.colour_by", given, f"must broadcast to the leading axes {history.batch_shape}")
        known = every[np.isfinite(every)]
        low, high = (float(known.min()), float(known.max())) if known.size else (0.0, 0.0)
        logarithmic = low > 0 and high > _WIDE * low
        return cls(name, low, high, logarithmic, _colors(every, low, high, logarithmic))

    def __str__(self) -> str:
        ends = f"{self.low:.3g} to {self.high:.3g}"
        return f"{self.name}: {WORDS} from {ends}{' by its logarithm' if self.logarithmic else ''}"


def _colors(values: FloatArray, low: float, high: float, logarithmic: bool) -> NDArray[np.uint32]:
    known = np.isfinite(values)
    whole = np.where(known, values, low)
    if logarithmic:
        whole, low, high = np.log(whole), float(np.log(low)), float(np.log(high))
    share = (whole - low) / (high - low) if high > low else np.zeros(values.shape)
    channels = np.array([[color >> shift & 0xFF for shift in (16, 8, 0)] for color in SCALE], dtype=np.float64)
    at = np.linspace(0.0, 1.0, len(SCALE))
    red, green, blue = (np.rint(np.interp(share, at, channels[:, k])).astype(np.uint32) for k in range(3))
    mixed: Any = np.where(known, red << 16 | green << 8 | blue, np.uint32(_UNKNOWN))
    return np.asarray(mixed << np.uint32(8) | np.uint32(0xFF), dtype=np.uint32)
