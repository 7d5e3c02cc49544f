"""Kernels that are compiled each by itself, for exactly what they are made of."""

from collections.abc import Callable
from typing import Any

import warp as wp


def own_module(**options: int) -> Callable[[Callable[..., None]], wp.Kernel]:
    """Decorator of a kernel that is a module of its own, without a backward pass.

    Warp names such a module by a hash of all that it calls, for the block size that its options say, and looks in its cache for
    the hash for the block size that it is launched with. That is one thread on a CPU: said here too, the two are one, which is
    found once. It takes as long as making all the functions does. What a GPU launches is not changed by it.

    Args:
        **options: Warp's options of the module.
    """
    decorator: Any = wp.kernel(module="unique", enable_backward=False, module_options={"block_dim": 1} | options)
    made: Callable[[Callable[..., None]], wp.Kernel] = decorator
    return made
