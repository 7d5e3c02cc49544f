"""Recorded launches of kernels, from any thread."""

from collections.abc import Callable, Sequence
from threading import RLock
from typing import Any

import warp as wp

LONGEST = 1024  # integrations of a rod in one launch: some hundredths of a second at most at a hundred steps each

# Warp makes, compiles and loads kernels for one thread at a time
_MAKING = RLock()


def record(make: Callable[[], Any], dim: int, arguments: Sequence[Any], device: str) -> Any:
    """A launch to be repeated by ``.launch()``, which releases the interpreter lock.

    Args:
        make: Makes the kernel, or returns it: called by one thread at a time.
        dim: Number of threads of the kernel.
        arguments: Of the kernel; arrays must live as long as the launch.
        device: Warp device.
    """
    with _MAKING:
        return wp.launch(make(), dim=dim, inputs=list(arguments), device=device, record_cmd=True)
