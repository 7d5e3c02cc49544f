"""Arrays that NumPy shares with kernels."""

from typing import Any

import warp as wp


class Shared:
    """An array of kernels that NumPy reads and writes too; on the CPU it is the same memory.

    Attributes:
        array: The kernels'.
        values: NumPy's.
    """

    def __init__(self, shape: tuple[int, ...], dtype: Any, device: str) -> None:
        self.array: Any = wp.zeros(shape, dtype=dtype, device=device)
        self._same = wp.get_device(device).is_cpu
        self.values: Any = self.array.numpy()

    def send(self) -> None:
        """What NumPy wrote to the device, where that is another."""
        if not self._same:
            self.array.assign(self.values)

    def fetch(self) -> None:
        """What kernels wrote from the device."""
        if not self._same:
            self.values[:] = self.array.numpy()
