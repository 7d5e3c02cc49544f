"""The processor a second time, as a GPU: what the package does only where NumPy does not see the kernels' memory, without one."""

import copy
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
import warp as wp

from multirod.kernels.compiling import start_warp

NAME = "cuda:0"
COMPILES = "multirod.kernels.compiling"  # for the processor that there is


@contextmanager
def elsewhere() -> Iterator[str]:
    """Within it there is a device, the name of which is returned, that the package takes for a GPU.

    It has a lane a thread, Warp's own launches, one part for a whole batch; the ``numpy()`` of its arrays is a copy.
    """
    start_warp()
    runtime, seen = wp._src.context.runtime, wp.array.numpy
    device = copy.copy(wp.get_device("cpu"))
    device.alias = NAME
    kind = type(device)

    def asked_by_package() -> bool:
        name = str(sys._getframe(2).f_globals.get("__name__", ""))
        return name.startswith("multirod.") and name != COMPILES

    def copied(array: Any) -> np.ndarray:
        values: np.ndarray = seen(array)
        return values.copy() if array.device is device else values

    is_cpu = kind.is_cpu
    kind.is_cpu = property(lambda own: own is not device or not asked_by_package())
    wp.array.numpy, runtime.device_map[NAME] = copied, device
    runtime.cuda_devices.append(device)
    try:
        yield NAME
    finally:
        runtime.cuda_devices.remove(device)
        del runtime.device_map[NAME]
        kind.is_cpu, wp.array.numpy = is_cpu, seen
