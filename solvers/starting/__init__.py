"""Where to begin when nothing is known: assemblies put together, many starts.

The search from many starts is offered here for studies; the rest is between solvers.
"""

from multirod.solvers.starting.multistart import MOST_STARTS, SAME_WITHIN, STARTS_IN_A_ROUND, Catalogue, converge, degrees, limits

__all__ = ["MOST_STARTS", "SAME_WITHIN", "STARTS_IN_A_ROUND", "Catalogue", "converge", "degrees", "limits"]
