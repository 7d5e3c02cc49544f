"""The boundary problem: all that a solver sees of an assembly."""

from multirod.problem.boundary import (
    DOUBLE_ROUNDING,
    SINGLE_TOLERANCE,
    TOLERANCE,
    Block,
    BoundaryProblem,
)
from multirod.problem.buffers import FEW, SMALL, Buffers
from multirod.problem.inputs import PosesSensed, Sensing
from multirod.problem.offers import STILL, BegunAgain, neutral_ways
from multirod.problem.shapes import LineShape, Shape, nodes_of_pieces

__all__ = [
    "DOUBLE_ROUNDING",
    "FEW",
    "SINGLE_TOLERANCE",
    "SMALL",
    "STILL",
    "TOLERANCE",
    "BegunAgain",
    "Block",
    "BoundaryProblem",
    "Buffers",
    "LineShape",
    "PosesSensed",
    "Sensing",
    "Shape",
    "neutral_ways",
    "nodes_of_pieces",
]
