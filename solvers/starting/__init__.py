"""Where to begin when nothing is known: assemblies put together, many starts.

The search from many starts is offered here for studies; the rest is between solvers.
"""

from multirod.solvers.starting.multistart import ROUND, SAME, STARTS, Catalogue, converge, degrees, limits

__all__ = ["ROUND", "SAME", "STARTS", "Catalogue", "converge", "degrees", "limits"]
