"""What instances ask for on their way, so that many share every launch."""

from collections.abc import Generator
from dataclasses import dataclass
from typing import Any

from multirod.solvers.following.descent import Point
from multirod.stability import Modes
from multirod.validation import FloatArray


@dataclass(frozen=True)
class Judge:
    """A request to tell the stability and the potential energy at a point."""

    point: Point


@dataclass(frozen=True)
class Judgement:
    """Its answer, of one instance."""

    modes: Modes
    potential: float


@dataclass(frozen=True)
class At:
    """A request to integrate at unknowns, shape (n,), or with the moments of clamps behind them, and a level."""

    unknowns: FloatArray
    level: float


@dataclass(frozen=True)
class Clamp:
    """A request to integrate with clamps that carry no moment yet; None is the answer where there can be none."""

    unknowns: FloatArray
    level: float


@dataclass(frozen=True)
class Settle:
    """A request to let damped dynamics go from unknowns, shape (n,), at a level until they rest, by so many integrations at most.

    The answer is the unknowns, None where they do not rest, and how many it took.
    """

    unknowns: FloatArray
    level: float
    most: int


Run = Generator[At | Judge | Clamp | Settle, Any, Any]
