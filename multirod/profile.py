"""Functions of arclength, resolved once into piecewise polynomials that kernels can evaluate."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from multirod.validation import FloatArray, array, frozen, refuse

DEGREE = 7
_POWERS = np.arange(DEGREE + 1)
_NODES = np.cos(np.pi * (_POWERS + 0.5) / (DEGREE + 1))
_RELATIVE_ERROR = 1e-12
_LEVELS = 14


@dataclass(frozen=True)
class Profile:
    """A function of arclength as polynomials on pieces.

    A smooth function is resolved to rounding. At a jump or a kink the pieces are halved 14 times, so that it is
    placed to ``length / 16384``: where its place is known, sections say it exactly.

    Attributes:
        ends: Arclength at which each piece ends [m], shape (piece_count,).
        coefficients: Monomial coefficients of each piece, lowest first, in its own coordinate from -1 to 1,
            shape (piece_count, DEGREE + 1, width).
        function: The function itself; it is not pickled with the polynomials, which are all that a solve needs.
    """

    ends: FloatArray
    coefficients: FloatArray
    function: Callable[[float], Any]

    def __post_init__(self) -> None:
        for name in ("ends", "coefficients"):
            object.__setattr__(self, name, frozen(getattr(self, name)))

    def __call__(self, s: float) -> FloatArray:
        """Value at arclength ``s``; past either end, the nearest polynomial."""
        piece = min(int(np.searchsorted(self.ends, s)), len(self.ends) - 1)
        start = self.ends[piece - 1] if piece else 0.0
        t = (2 * s - start - self.ends[piece]) / (self.ends[piece] - start)
        return np.asarray(np.polynomial.polynomial.polyval(t, self.coefficients[piece]), dtype=np.float64)

    def __getstate__(self) -> dict[str, Any]:
        return {"ends": self.ends, "coefficients": self.coefficients}

    def __setstate__(self, state: dict[str, Any]) -> None:
        for name, value in {**state, "function": _left_behind}.items():
            object.__setattr__(self, name, value)
        self.__post_init__()


def _left_behind(s: float) -> Any:
    raise ValueError("a function of arclength cannot be resolved anew after pickling: give the function itself")


def interpolate(function: Callable[[float], Any], start: float, end: float) -> FloatArray:
    """Coefficients of the polynomial through ``function`` at the Chebyshev nodes of a piece, shape (DEGREE + 1, width)."""
    centre, half = 0.5 * (start + end), 0.5 * (end - start)
    return np.asarray(np.linalg.solve(_NODES[:, None] ** _POWERS, [function(centre + half * t) for t in _NODES]))


def fit(field: str, function: Callable[[float], Any], length: float, width: int = 3) -> Profile:
    """Resolve ``function(s)``, returning ``width`` numbers, on ``0 <= s <= length``.

    Raises:
        ValueError: If a value is not finite or not of that width; the message names ``field`` and the arclength.
    """

    source = function.function if isinstance(function, Profile) else function

    def sample(s: float) -> FloatArray:
        try:
            value = source(float(s))
        except Exception as error:
            raise ValueError(f"{field}({s:g}) raised {type(error).__name__}: {error}") from error
        try:
            result = array(f"{field}({s:g})", value)
        except ValueError:
            result = np.empty(0)
        if result.shape != (width,):
            shown = value.tolist() if isinstance(value, np.ndarray) else value
            refuse(f"{field}({s:g})", shown, f"must be {width} finite numbers")
        return result

    probes = np.array([-0.97, -0.53, 0.11, 0.46, 0.91])
    ends: list[float] = []
    coefficients: list[FloatArray] = []
    scale = max(float(np.abs([sample(s) for s in np.linspace(0, length, 17)]).max()), 1e-300)
    pieces = [(0.0, length, 0)]
    while pieces:
        start, end, level = pieces.pop()
        centre, half = 0.5 * (start + end), 0.5 * (end - start)
        found = interpolate(sample, start, end)
        error = np.abs(probes[:, None] ** _POWERS @ found - [sample(centre + half * t) for t in probes]).max()
        if error > _RELATIVE_ERROR * scale and level < _LEVELS:
            pieces += [(centre, end, level + 1), (start, centre, level + 1)]
        else:
            ends.append(end)
            coefficients.append(found)
    return Profile(np.array(ends), np.array(coefficients), source)
