"""Records: numbers that stand together, as a list of slots from which offsets, sizes and units follow."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class Slot:
    """One entry of a record.

    Attributes:
        name: Of the entry.
        size: How many numbers.
        unit: What they are counted in: "moment", "force", "length" or "1".
        controlled: Whether their errors choose steps.
        seed: Of a state: the unknowns with which it begins. None where it follows from what is given.
        residual: Of a state: the residuals that its value at the tip answers to. Of unknowns: those that stand for them, as many.
            None where there are none: what varies where a segment begins is found by the state where the one before ends.
    """

    name: str
    size: int
    unit: str = "1"
    controlled: bool = False
    seed: str | None = None
    residual: str | None = None


class Record:
    """Numbers that stand together: where each begins (``at``; -1 if it is not there) and how many there are (``size``).

    ``named`` are all entries, also what is not there, and ``places`` where they stand: empty, where it would be.
    """

    def __init__(self, slots: Iterable[Slot]) -> None:
        self.slots: list[Slot] = []
        self.at: dict[str, int] = {}
        self.named: dict[str, Slot] = {}
        self.places: dict[str, slice] = {}
        self.size = 0
        for slot in slots:
            self.named[slot.name] = slot
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
