# mypy: ignore-errors
"""Launches that a kernel repeats: between two of them, Python would take as long as a rod's integration."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import warp as wp

from multirod.launch import ready


@wp.struct
class Calls:
    """Recorded launches on a processor: function, bounds and arguments of each, addresses that are good as long as these are."""

    addresses: wp.array2d[wp.uint64]


@wp.func_native(
    "typedef void (*Kernel)(void*, void*);"
    " ((Kernel)(unsigned long long)function)((void*)(unsigned long long)bounds, (void*)(unsigned long long)arguments);"
)
def call(function: wp.uint64, bounds: wp.uint64, arguments: wp.uint64): ...


@wp.func
def launch_all(calls: Calls):
    """One launch after another."""
    for i in range(calls.addresses.shape[0]):
        call(calls.addresses[i, 0], calls.addresses[i, 1], calls.addresses[i, 2])


def callable_from_kernels(launches: Sequence[Any] | None) -> Any:
    """These launches for ``launch_all``, or None where they cannot be launched so; it waits for what is being compiled."""
    if launches is None:
        return None
    addresses = [ready(launch) for launch in launches]
    if any(address is None for address in addresses):
        return None
    calls = Calls()
    calls.addresses = wp.array(np.array(addresses, dtype=np.uint64), dtype=wp.uint64, device="cpu")
    return calls
