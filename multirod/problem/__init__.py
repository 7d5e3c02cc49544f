"""The boundary problem: all that a solver sees of an assembly."""

from multirod.problem.boundary import (
    DOUBLE_ROUNDING,
    FEW,
    NEUTRAL_VALUE,
    SINGLE_TOLERANCE,
    STILL,
    TOLERANCE,
    Block,
    BoundaryProblem,
)
from multirod.problem.buffers import SMALL, Buffers
from multirod.problem.shapes import LineShape, Shape

__all__ = [
    "DOUBLE_ROUNDING",
    "FEW",
    "NEUTRAL_VALUE",
    "SINGLE_TOLERANCE",
    "SMALL",
    "STILL",
    "TOLERANCE",
    "Block",
    "BoundaryProblem",
    "Buffers",
    "LineShape",
    "Shape",
]
