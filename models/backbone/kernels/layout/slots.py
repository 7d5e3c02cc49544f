"""Records: numbers that stand together, as a list of slots from which offsets, sizes and units follow."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class Slot:
    """One entry of a record: its name, how many numbers, what they are counted in ("moment", "force", "length" or "1"), and
    whether their errors choose steps."""

    name: str
    size: int
    unit: str = "1"
    controlled: bool = False


class Record:
    """Numbers that stand together: where each begins (``at``; -1 if it is not there) and how many there are (``size``).

    ``places`` are those of all entries, also of what is not there: empty, where it would be.
    """

    def __init__(self, slots: Iterable[Slot]) -> None:
        self.slots: list[Slot] = []
        self.at: dict[str, int] = {}
        self.places: dict[str, slice] = {}
        self.size = 0
        for slot in slots:
            self.places[slot.name] = slice(self.size, self.size + slot.size)
            if slot.size:
                self.slots.append(slot)
                self.at[slot.name] = self.size
                self.size += slot.size

    def __getitem__(self, name: str) -> int:
        return self.at.get(name, -1)

    def split(self, values: NDArray[np.float64]) -> dict[str, NDArray[np.float64]]:
        """The entries of rows (..., size), by name."""
        return {name: values[..., place] for name, place in self.places.items()}

    def joined(self, parts: Mapping[str, NDArray[np.float64]]) -> NDArray[np.float64]:
        """The reverse: rows (..., size) of the entries that there are; what else is given is left out."""
        return np.concatenate([parts[slot.name] for slot in self.slots], axis=-1)

    def units(self) -> list[str]:
        """Of each number."""
        return [slot.unit for slot in self.slots for _ in range(slot.size)]
