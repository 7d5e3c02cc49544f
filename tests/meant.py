"""For tests of extremes, which mean what a ``PlausibilityWarning`` is given for."""

import warnings
from collections.abc import Iterator
from contextlib import contextmanager

import multirod as mr


@contextmanager
def meant() -> Iterator[None]:
    """Nothing is said of how plausible numbers are; also a decorator."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", mr.PlausibilityWarning)
        yield
