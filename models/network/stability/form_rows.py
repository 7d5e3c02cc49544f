"""Where what is free of a network stands in its second variation: the same whatever its unknowns are.

Numbers in parentheses are those of ``docs/networks.md``.
"""

from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from multirod.models.network.elements.elements import POSE
from multirod.validation import FloatArray

if TYPE_CHECKING:
    from multirod.models.network.problem import NetworkProblem


class FormRows:
    """Rows of (16): three of each rod, then tensions, (16b), then what is no rod's own.

    Args:
        problem: Of which.

    Attributes:
        scales: What makes them derivatives of the energy where only lengths and stiffnesses say it, once that was asked for.
    """

    scales: tuple[FloatArray, FloatArray, FloatArray, FloatArray] | None = None

    def __init__(self, problem: "NetworkProblem") -> None:
        self._entries, self._layout, self._graph = problem.entries, problem.layout, problem.graph
        self._rods, self._bodies, self._unknowns = problem.rod_count, problem.body_count, problem.unknown_count
        self._own = {rod: group.backbones.slots.places["drives"] for group in problem.groups for rod in group.members.tolist()}

    @cached_property
    def tensions(self) -> NDArray[np.intp]:
        """Where the tensions of lines of given length stand among the unknowns of each rod, -1 of what there is not, shape
        (rod_count, most)."""
        at = np.array([self._own[rod].start for rod in range(self._rods)])[:, None]
        count = np.array([self._own[rod].stop - self._own[rod].start for rod in range(self._rods)])
        k = np.arange(count.max())
        return np.where(k < count[:, None], at + k, -1)

    @cached_property
    def of_tensions(self) -> NDArray[np.intp]:
        """Rows of these, shape (rod_count, most)."""
        there = self.tensions >= 0
        return np.where(there, 3 * self._rods + np.cumsum(there).reshape(there.shape) - 1, -1)

    @cached_property
    def of_rods(self) -> int:
        """How many rows are of the rods themselves."""
        return 3 * self._rods + int((self.tensions >= 0).sum())

    @cached_property
    def constraints(self) -> dict[int, NDArray[np.intp]]:
        """Rows that are multipliers of constraints, by the rods that have such: what holds the tip where it is, and what holds
        lines as long as they are."""
        held, places = self._graph.ends[1].held, self.of_tensions
        own = [[*(3 * k + np.arange(3) if held[k] else ()), *places[k][places[k] >= 0]] for k in range(len(held))]
        return {rod: np.array(rows) for rod, rows in enumerate(own) if rows}

    @cached_property
    def others(self) -> NDArray[np.intp]:
        """Unknowns that are no rod's own, in the order of their rows."""
        places = self._entries.variables[:, self._layout.own_at]
        return np.setdiff1d(np.arange(self._unknowns), places[places >= 0])

    def of(self, unknowns: NDArray[np.intp]) -> NDArray[np.intp]:
        """Rows of unknowns that are no rod's own."""
        return np.asarray(self.of_rods + np.searchsorted(self.others, unknowns))

    @cached_property
    def size(self) -> int:
        """How many are free."""
        return self.of_rods + len(self.others)

    @cached_property
    def of_elements(self) -> tuple[NDArray[np.bool_], NDArray[np.intp], NDArray[np.intp]]:
        """Of the numbers of the elements which belong anywhere, and of these row and column."""
        rest = self._entries.variables[:, self._layout.own : self._layout.holes_at.start]
        first = 3 * np.arange(self._rods)[:, None] + np.arange(3)
        own = np.concatenate([first, self.of_tensions, np.where(rest < 0, -1, self.of(rest))], axis=1)
        if self._layout.holes:
            holes = self.of(np.array(self._entries.first_hole))
            ends = [self._graph.slides.upper, self._graph.slides.lower]
            own = np.concatenate([own, *(np.where(end < 0, -1, holes + end)[:, None] for end in ends)], axis=1)
        row, column = (values.reshape(-1) for values in np.broadcast_arrays(own[:, :, None], own[:, None]))
        there = np.minimum(row, column) >= 0
        return there, row[there], column[there]

    @cached_property
    def of_poses(self) -> NDArray[np.intp]:
        """Rows of the poses of bodies, shape (body_count, 6)."""
        count = POSE * self._bodies
        return np.asarray(self.size - count + np.arange(count).reshape(-1, POSE))

    @cached_property
    def of_numbers(self) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
        """Row and column of each of these, then of each of ``of_loads``."""
        row, column = (np.concatenate(own) for own in zip(self.of_elements[1:], self.of_loads, strict=True))
        return row, column

    @cached_property
    def of_loads(self) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
        """Rows and columns of how loads on bodies change with their turns."""
        row, column = np.broadcast_arrays(self.of_poses[:, :, None], self.of_poses[:, None, 3:])
        return row.reshape(-1), column.reshape(-1)
