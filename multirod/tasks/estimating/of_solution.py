"""What results of estimates say where they are asked for what their equilibria have."""

from multirod.naming import Asked
from multirod.results.solution import Solution


class OfSolution(Asked):
    """Has a ``solution``, and says so of what that has."""

    @classmethod
    def _hint(cls, name: str) -> str:
        return f"; its equilibrium has: solution.{name}" if hasattr(Solution, name) else super()._hint(name)
