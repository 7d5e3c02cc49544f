"""What a boundary problem offers that knows whether what it holds together can be as far apart as it is to be."""

from abc import ABC, abstractmethod

import numpy as np
from numpy.typing import NDArray

TAUT = 1e-9  # of a length, by which rounding may have ends farther apart


class Reach(ABC):
    """Whether ends are farther apart than what is between them can be long: then there is no equilibrium."""

    @abstractmethod
    def exceeded(self) -> NDArray[np.bool_]:
        """Where they are, at the present inputs, shape (instance_count,); False where that is not known."""

    def used_up(self) -> NDArray[np.bool_]:
        """Where they are just as far apart, too: rods between are straight then, and hold nothing across by any finite force."""
        return self.exceeded()

    @abstractmethod
    def said(self, instance: int) -> str:
        """What is too short, of an instance of which ``used_up`` says so, as the end of a message."""
