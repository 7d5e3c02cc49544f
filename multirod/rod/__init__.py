"""Rods: lengths, stiffnesses and shape at rest, checked when they are made, and the arrays that kernels read of them."""

from multirod.rod.arrays import DENSITY, RodArrays, lower, stack
from multirod.rod.rod import Rod
from multirod.rod.section import Section

__all__ = ["DENSITY", "Rod", "RodArrays", "Section", "lower", "stack"]
