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


class Portions:
    """One launch over listed instances as several, a bounded number in each, so that a batch can be brought to an end in between.

    Args:
        launch: Recorded, over the instances that ``call.order`` lists; its arguments end with ``call``.
        call: The argument.
        longest: Instances of a portion.
        heed: Called before each portion; may raise.
    """

    def __init__(self, launch: Any, call: Any, longest: int, heed: Callable[[], None]) -> None:
        self._launch, self._call, self._heed = launch, call, heed
        self._at = len(launch.params) - 2  # the first parameter is Warp's own
        order = call.order
        self._orders = [order[start : min(start + longest, len(order))] for start in range(0, len(order), longest)]
        self._longest, self._present = longest, len(order)
        self.set_dim(len(order))

    def set_dim(self, count: int) -> None:
        """Pass over so many instances from now on: the first that are listed."""
        self._dims = [min(self._longest, count - start) for start in range(0, count, self._longest)]

    def launch(self) -> None:
        """Launch one portion after another."""
        for order, dim in zip(self._orders, self._dims, strict=False):
            self._heed()
            self._call.order = order
            self._launch.set_param_at_index(self._at, self._call)
            if dim != self._present:
                self._launch.set_dim(dim)
                self._present = dim
            self._launch.launch()
