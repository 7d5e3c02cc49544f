"""Following branches of equilibria. What studies may follow one by is offered here; the rest is between solvers."""

from multirod.solvers.continuation.branch import Branch, BranchLost
from multirod.solvers.continuation.branch_equations import FromBase
from multirod.solvers.continuation.branch_step import Change, Point

__all__ = ["Branch", "BranchLost", "Change", "FromBase", "Point"]
