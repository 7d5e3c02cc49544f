"""Python's collection of garbage, put off while many objects are made that are to stay."""

import gc
from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def without_collections() -> Iterator[None]:
    """Within it, Python looks for no garbage: modules and the syntax trees of kernels are many objects, and few are garbage.

    Looking took a tenth of the time of either.
    """
    was_on = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if was_on:
            gc.enable()
