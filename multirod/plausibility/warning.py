"""The warning, and where it is given."""

from multirod.warning import warn


class PlausibilityWarning(UserWarning):
    """Of a number that is allowed and hardly meant, such as a length in mm.

    It names the field, its value, what that means and what was probably meant. It is given once, where the thing is made.
    ``warnings.simplefilter("ignore", mr.PlausibilityWarning)`` is for who means it, ``"error"`` for who never does.
    """


def say(message: str) -> None:
    """Warn of something, where the package was called."""
    warn(message, PlausibilityWarning)


def with_unit(value: float, unit: str) -> str:
    """A number as messages say it."""
    return f"{value:.6g} {unit}".strip()
