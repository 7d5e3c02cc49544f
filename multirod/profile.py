"""Functions of arclength, resolved once into piecewise polynomials that kernels can evaluate."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from itertools import pairwise
from typing import Any, NoReturn

import numpy as np
from numpy.polynomial.chebyshev import poly2cheb

from multirod.validation import DOUBLE, LARGEST, PLAIN, FloatArray, array, frozen, refuse

DEGREE = 7
_RELATIVE_ERROR = 1e-12
_LEVELS = 14
_PLACES = 988  # beside a Fibonacci number the gaps are the most alike
_MOST_PLACES = 28_658  # of a function that a rod much shorter than others has too
_JUMP = 1e-6  # of the largest value, that two neighbouring numbers differ by
_APART = 1e-9  # of the length, that jumps are from each other
_MOST_JUMPS = 1024


@dataclass(frozen=True)
class Profile:
    """A function of arclength as polynomials on pieces.

    A smooth function is resolved to rounding, and between jumps, whose places are found. At a kink the pieces are halved 14
    times, so that it is placed to ``length / 16384``. What a function does on less than a thousandth of the length alone, between
    the places at which it is looked at, may not be seen: that is a section, if one can say it so.

    Attributes:
        ends: Arclength at which each piece ends [m], shape (piece_count,).
        coefficients: Monomial coefficients of each piece, lowest first, in its own coordinate from -1 to 1,
            shape (piece_count, degree + 1, width).
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
        start, end, coefficients = self.piece(s)
        t = (2 * s - start - end) / (end - start)
        return np.asarray(np.polynomial.polynomial.polyval(t, coefficients), dtype=np.float64)

    def piece(self, s: float) -> tuple[float, float, FloatArray]:
        """Start, end and coefficients of the polynomial that holds at ``s``; past either end, of the nearest."""
        k = min(int(np.searchsorted(self.ends, s)), len(self.ends) - 1)
        return float(self.ends[k - 1]) if k else 0.0, float(self.ends[k]), self.coefficients[k]

    @property
    def bound(self) -> float:
        """What the vector of values is nowhere longer than; its largest length where pieces are constant or linear."""
        return float(bounds(self.coefficients).max())

    @classmethod
    def resolved(cls, ends: FloatArray, coefficients: FloatArray) -> "Profile":
        """From polynomials alone, whose function is not at hand: it holds where it was resolved, and cannot be resolved anew."""
        return cls(ends, coefficients, _left_behind)

    def holds(self, length: float, degree: int, width: int) -> bool:
        """Whether there is nothing to resolve anew, and it is what that would come to."""
        same = bool(self.ends[-1] == length) and self.coefficients.shape[1:] == (degree + 1, width)
        return same and self.function is _left_behind

    def __getstate__(self) -> dict[str, Any]:
        return {"ends": self.ends, "coefficients": self.coefficients}

    def __setstate__(self, state: dict[str, Any]) -> None:
        for name, value in {**state, "function": _left_behind}.items():
            object.__setattr__(self, name, value)
        self.__post_init__()


def _left_behind(s: float) -> NoReturn:
    raise ValueError("a function of arclength cannot be resolved anew after pickling, or from a file: give the function itself")


@cache
def _nodes(degree: int) -> FloatArray:
    """Chebyshev nodes, from -1 to 1, through which a polynomial is laid."""
    return np.asarray(frozen(np.cos(np.pi * (np.arange(degree + 1) + 0.5) / (degree + 1))))


@cache
def _to_chebyshev(degree: int) -> FloatArray:
    """Coefficients by Chebyshev polynomials of each power, its columns."""
    powers = np.eye(degree + 1)
    return np.asarray(frozen(np.stack([np.append(c, np.zeros(degree + 1 - len(c))) for c in map(poly2cheb, powers)], axis=1)))


@cache
def _places(count: int) -> FloatArray:
    """Where a function is looked at, of a length of 1, ``_PLACES`` of them no farther apart than 1/843: multiples of the golden
    ratio, so that no wave has all of them where it is zero."""
    golden = 0.5 * (np.sqrt(5) - 1)
    return np.asarray(frozen(np.append(np.sort(np.arange(count - 1) * golden % 1.0), 1.0)))


def interpolate(function: Callable[[float], Any], start: float, end: float, degree: int = DEGREE) -> FloatArray:
    """Coefficients of the polynomial through ``function`` at the Chebyshev nodes of a piece, shape (degree + 1, width)."""
    centre, half, nodes = 0.5 * (start + end), 0.5 * (end - start), _nodes(degree)
    return np.asarray(np.linalg.solve(nodes[:, None] ** np.arange(degree + 1), [function(centre + half * t) for t in nodes]))


def bounds(coefficients: FloatArray) -> FloatArray:
    """What the length of each vector of polynomials is nowhere more than from -1 to 1, of coefficients (..., degree + 1, width):
    as no Chebyshev polynomial is more than 1."""
    return np.asarray(np.linalg.norm(_to_chebyshev(coefficients.shape[-2] - 1) @ coefficients, axis=-1).sum(axis=-1))


def recentred(
    coefficients: FloatArray, start: FloatArray | float, end: FloatArray | float, new_start: FloatArray, new_end: FloatArray
) -> FloatArray:
    """Coefficients of the same polynomials on another piece, shape (..., degree + 1, width); arclengths may have axes ``...``."""
    size = np.asarray(end - start)[..., None]
    size = np.where(size == 0, 1.0, size)  # of no length
    middle, half = (new_start + new_end)[..., None] / 2, (new_end - new_start)[..., None] / 2
    degree = coefficients.shape[-2] - 1
    if degree == 0 or bool(np.all(new_start == start) and np.all(new_end == end)):
        return coefficients
    t = (2 * (middle + half * _nodes(degree)) - np.asarray(start + end)[..., None]) / size
    powers = np.arange(degree + 1)
    return np.asarray(np.linalg.solve(_nodes(degree)[:, None] ** powers, t[..., None] ** powers @ coefficients))


def fit(
    field: str,
    function: Callable[[float], Any],
    length: float,
    width: int = 3,
    *,
    start: float = 0.0,
    degree: int = DEGREE,
    shortest: float = np.inf,
) -> Profile:
    """Resolve ``function(s)``, returning ``width`` numbers, on ``start <= s <= start + length``; the arclength of the pieces
    counts from ``start``. Where a rod has the function on its first ``shortest`` metres alone, it is looked at as often there.
    What was resolved before, as far, and has no function at hand, is returned as it is.

    Raises:
        ValueError: If a value is not finite or not of that width; the message names ``field`` and the arclength.
    """
    if isinstance(function, Profile) and function.holds(length, degree, width):
        return function
    source = function.function if isinstance(function, Profile) else function
    count = int(min(_MOST_PLACES, _PLACES * np.ceil(max(1.0, length / shortest))))
    return _Stretch(field, source, start, length, width, degree, count).resolve()


class _Stretch:
    """A function on a stretch of a rod, as far as it has been looked at; arclengths ``x`` count from its start.

    Args:
        field: The function's name, in messages.
        function: Of arclength.
        start, length: Of the stretch [m].
        width: Numbers that the function returns.
        degree: Of the polynomials.
        count: Places at which the function is looked at, whatever the pieces: a bump between the nodes and probes of one would be
            none.
    """

    PROBES = np.array([-0.97, -0.53, 0.11, 0.46, 0.91])

    def __init__(
        self, field: str, function: Callable[[float], Any], start: float, length: float, width: int, degree: int, count: int
    ) -> None:
        self.field, self.function, self.start, self.length = field, function, start, length
        self.width, self.degree, self.powers = width, degree, np.arange(degree + 1)
        self.places = length * _places(count)
        self.seen = np.array([self.sample(x) for x in self.places])
        self.scale = max(float(np.abs(self.seen).max()), 1e-300)

    def sample(self, x: float) -> FloatArray:
        """The function's value, (width,)."""
        s = float(self.start + x)
        try:
            value = self.function(s)
        except Exception as error:
            raise ValueError(f"{self.field}({s:g}) raised {type(error).__name__}: {error}") from error
        numbers = value.tolist() if type(value) is np.ndarray and value.dtype is DOUBLE else value
        if (
            type(numbers) in (tuple, list)
            and len(numbers) == self.width
            and all(type(v) in PLAIN and abs(v) <= LARGEST for v in numbers)
        ):
            return np.array(numbers, dtype=np.float64)  # what is below takes ten times as long, of hundreds of values
        try:
            result = array(f"{self.field}({s:g})", value)
        except ValueError:
            result = np.empty(0)
        if result.shape != (self.width,):
            shown = value.tolist() if isinstance(value, np.ndarray) else value
            refuse(f"{self.field}({s:g})", shown, f"must be {self.width} finite numbers")
        return result

    def piece(self, first: float, end: float, halved: tuple[bool, bool]) -> tuple[FloatArray, bool]:
        """The polynomial of a piece, and whether it is what the function is there.

        Where pieces were halved, ``halved`` at either end, it has to be the function at that end too, but for what is no jump:
        one that is nearer to the end than all places would not be seen.
        """
        centre, half = 0.5 * (first + end), 0.5 * (end - first)
        found = interpolate(self.sample, first, end, self.degree)
        near = slice(self.places.searchsorted(first), self.places.searchsorted(end, "right" if end == self.length else "left"))
        t = np.concatenate([self.PROBES, (self.places[near] - centre) / half])
        given = np.concatenate([[self.sample(centre + half * t) for t in self.PROBES], self.seen[near]])
        good = bool(np.abs(t[:, None] ** self.powers @ found - given).max() <= _RELATIVE_ERROR * self.scale)
        for x, side, inner in ((first, -1.0, halved[0]), (end, 1.0, halved[1])):
            good = good and not (inner and np.abs(side**self.powers @ found - self.sample(x)).max() > _JUMP * self.scale)
        return found, good

    def jump(self, a: float, b: float) -> float | None:
        """Where the function jumps between two places, to rounding; None where it does not."""
        at_a, at_b = self.sample(a), self.sample(b)
        while a < (middle := 0.5 * (a + b)) < b:
            value = self.sample(middle)
            if np.abs(value - at_a).max() <= np.abs(value - at_b).max():
                a, at_a = middle, value
            else:
                b, at_b = middle, value
        return b if np.abs(at_b - at_a).max() > _JUMP * self.scale else None

    def divided(self, breaks: list[float], most: float) -> tuple[Profile, list[tuple[float, float]]] | None:
        """Polynomials between places, and the smallest pieces on which they are still not the function; None where there are more
        than ``most``."""
        given = set(breaks)
        ends: list[float] = []
        coefficients: list[FloatArray] = []
        rough: list[tuple[float, float]] = []
        pieces = [(*between, 0) for between in reversed([*pairwise(breaks)])]
        while pieces:
            first, end, level = pieces.pop()
            found, good = self.piece(first, end, (first not in given, end not in given))
            if not good and level < _LEVELS:
                centre = 0.5 * (first + end)
                pieces += [(centre, end, level + 1), (first, centre, level + 1)]
                continue
            ends.append(end)
            coefficients.append(found)
            if not good:
                rough.append((first, end))
            if len(ends) > most:
                return None
        return Profile(np.array(ends), np.array(coefficients), self.function), rough

    def resolve(self) -> Profile:
        """The function between its jumps."""
        breaks = [0.0, self.length]
        found, profile = self.divided(breaks, np.inf), None
        while found is not None:  # what takes more pieces between its jumps has none: it is noise
            profile, rough = found
            most, known = len(profile.ends) + len(rough), len(breaks)
            for between in rough if len(rough) <= _MOST_JUMPS else ():
                place = self.jump(*between)
                if place is not None and min(abs(place - other) for other in breaks) > _APART * self.length:
                    breaks.append(place)
            if len(breaks) == known:
                break
            breaks.sort()
            found = self.divided(breaks, most)
        assert profile is not None  # of the first time
        return profile
