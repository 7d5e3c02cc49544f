"""Where warnings of the package point: at the line that called it, however deep in it they are given."""

import sys
import warnings

WITHIN = ("multirod", "functools", "contextlib")  # the package, and what calls functions of it for it


def warn(message: str, category: type[Warning]) -> None:
    """Warn of something, where the package was called."""
    frame, level = sys._getframe(1), 2
    while frame.f_back is not None and frame.f_globals.get("__name__", "").partition(".")[0] in WITHIN:
        frame, level = frame.f_back, level + 1
    warnings.warn(message, category, stacklevel=level)
