"""How many integrations a study may take over all of its stages."""

SEARCHED = 50_000  # by default: more than one solve, as a study goes along whole branches, or many


class Spent(RuntimeError):
    """Raised where an integration would be one more than a study may take."""


class Budget:
    """What a study may still take: the problems of its stages share one.

    Args:
        integrations: Of rods, all instances together.
    """

    def __init__(self, integrations: int) -> None:
        self.left = integrations

    def spend(self, integrations: int) -> None:
        """Take so many.

        Raises:
            Spent: If that is more than is left.
        """
        self.left -= integrations
        if self.left < 0:
            raise Spent
