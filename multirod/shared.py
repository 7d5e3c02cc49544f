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
        self._see(wp.zeros(shape, dtype=dtype, device=device))

    @classmethod
    def of(cls, array: Any) -> "Shared":
        """An array that there is."""
        result = cls.__new__(cls)
        result._see(array)
        return result

    def _see(self, array: Any) -> None:
        self.array: Any = array
        self._same = array.device.is_cpu
        self.values: Any = array.numpy()

    def write(self, values: Any) -> None:
        """Set all of it, on the device too."""
        self.values[...] = values
        self.send()

    def fetched(self) -> Any:
        """``values``, after ``fetch``."""
        self.fetch()
        return self.values

    def send(self) -> None:
        """What NumPy wrote to the device, where that is another."""
        if not self._same:
            self.array.assign(self.values)

    def fetch(self) -> None:
        """What kernels wrote from the device."""
        if not self._same:
            self.values[:] = self.array.numpy()
