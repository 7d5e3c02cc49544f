"""Multiple shooting in parts. What studies follow branches by is offered here; the rest is between solvers."""

from multirod.solvers.segments.along import equations_of

__all__ = ["equations_of"]
