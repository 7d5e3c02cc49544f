"""Arrays that NumPy shares with kernels."""

from typing import Any, cast

import warp as wp
from numpy.typing import NDArray

from multirod.types import WarpArray


class Shared:
    """An array of kernels that NumPy reads and writes too; on the CPU it is the same memory.

    Attributes:
        array: The kernels'.
        values: NumPy's.
    """

    def __init__(self, shape: tuple[int, ...], dtype: type, device: str) -> None:
        self._see(wp.zeros(shape, dtype=dtype, device=device))

    @classmethod
    def of(cls, array: WarpArray) -> "Shared":
        """An array that there is."""
        result = cls.__new__(cls)
        result._see(array)
        return result

    def _see(self, array: WarpArray) -> None:
        self.array: Any = array
        self._same = wp.get_device(self.array.device).is_cpu
        self.values: Any = array.numpy()

    def write(self, values: object) -> None:
        """Set all of it, on the device too."""
        self.values[...] = values
        self.send()

    def fetched(self) -> NDArray[Any]:
        """``values``, after ``fetch``."""
        self.fetch()
        return cast("NDArray[Any]", self.values)

    def send(self) -> None:
        """What NumPy wrote to the device, where that is another."""
        if not self._same:
            self.array.assign(self.values)

    def fetch(self) -> None:
        """What kernels wrote from the device."""
        if not self._same:
            self.values[:] = self.array.numpy()
