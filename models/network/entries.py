"""Where the numbers of the elements stand in residual and ``Gamma`` of a network.

Numbers in parentheses are those of ``docs/networks.md``.
"""

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from multirod.elimination import Elimination
from multirod.models.network.elements import ANGLES_AT, GAP_AT, OWN, OWN_AT, POSE, POSES_AT, SIZE
from multirod.validation import FloatArray

if TYPE_CHECKING:
    from multirod.models.network.graph import Graph

ELIMINATED = 36  # unknowns from which Gamma is eliminated along the graph, instead of whole


class Sums:
    """Sums of numbers that belong to the same place.

    Args:
        places: Of each number; negative of those that belong nowhere, shape (k,).
        size: Places.
    """

    def __init__(self, places: NDArray[np.intp], size: int) -> None:
        kept = np.flatnonzero(places >= 0)
        self._order = kept[np.argsort(places[kept], kind="stable")]
        ordered = places[self._order]
        self._starts = np.flatnonzero(np.concatenate([[True], ordered[1:] != ordered[:-1]]))
        self._places = ordered[self._starts]
        self._size = size

    def __call__(self, values: FloatArray) -> FloatArray:
        """Of numbers (..., k), shape (..., size)."""
        result = np.zeros((*values.shape[:-1], self._size))
        result[..., self._places] = np.add.reduceat(values[..., self._order], self._starts, axis=-1)
        return result


class Entries:
    """Of a network: rows and columns of its elements.

    Args:
        graph: The network.

    Attributes:
        variables: Where the variables of each element stand among the unknowns, and its rows among the residuals, -1 of what
            there is not, and of angles that are inputs, shape (rod_count, SIZE).
        first_hole: Where the unknowns of holes begin, through which rods slide, and their rows.
        first_pose: Where the poses of bodies begin.
        size: Unknowns.
        elimination: How ``Gamma`` is eliminated; None where it is small, and eliminated whole.
        count: Numbers that are kept of ``Gamma``: those that ``elimination`` names, or all.
        residual: Sums of the rows of the elements, (rod_count * SIZE,) of them.
        gamma: Sums of their matrices, (rod_count * SIZE * SIZE,) numbers.
        turns: Where the balance of each body stands by how it turns, among the numbers, shape (body_count, 6, 3).
        sliding: Sums of what pieces that end at holes and then those that begin there say of these, twice piece_count of them.
        slid: Sums of numbers: rows of the elements by the lengths of pieces, as holes at their tips and their bases change these,
            then what slides at tips and at bases, by the variables of the elements, and by the holes at tip and base.
        yielding: Where the gap of each rod whose tip is held stands by the force, along its base both, shape (k,).
    """

    def __init__(self, graph: "Graph") -> None:
        self.variables, self.first_hole = _variables(graph)
        self.first_pose = self.first_hole + graph.slides.count
        bodies = len(graph.bodies)
        self.size = n = self.first_pose + POSE * bodies
        rows, columns = self.variables[:, :, None], self.variables[:, None]
        entries = np.where((rows < 0) | (columns < 0), -1, rows * n + columns).reshape(-1)
        poses = self.first_pose + np.arange(POSE * bodies).reshape(-1, POSE)
        turns = poses[:, :, None] * n + poses[:, None, 3:]
        held = graph.ends[1].held
        yielding = self.variables[held, GAP_AT.stop - 1] * n + self.variables[held, OWN - 1]
        ends = [np.where(end < 0, -1, self.first_hole + end) for end in (graph.slides.upper, graph.slides.lower)]
        slid = _slid(self.variables, ends, n)
        self.elimination: Elimination | None = None
        self.count = n * n
        if n >= ELIMINATED:
            self.elimination = own = Elimination(np.concatenate([entries[entries >= 0], turns.reshape(-1), slid[slid >= 0]]), n)
            self.count = own.count
            entries, slid = (np.where(e < 0, -1, own.index(np.maximum(e, own.places[0]))) for e in (entries, slid))
            turns, yielding = own.index(turns), own.index(yielding)
        self.turns, self.yielding = turns, yielding
        self.residual = Sums(self.variables.reshape(-1), n)
        self.gamma = Sums(entries, self.count)
        if graph.slides.count:
            self.sliding, self.slid = Sums(np.concatenate(ends), n), Sums(slid, self.count)

    def dense(self, numbers: FloatArray) -> FloatArray:
        """``Gamma`` (..., n, n) of its numbers (..., count)."""
        if self.elimination is not None:
            return self.elimination.dense(numbers)
        return numbers.reshape(*numbers.shape[:-1], self.size, self.size)


def _variables(graph: "Graph") -> tuple[NDArray[np.intp], int]:
    places = np.full((len(graph.rods), SIZE), -1, dtype=np.intp)
    first = 0
    for rod in range(len(graph.rods)):
        places[rod, OWN_AT] = range(first, first + OWN)
        first += OWN
        for at, end in zip(ANGLES_AT, graph.ends, strict=True):
            if at is ANGLES_AT[0] and graph.slides.shared[rod]:
                places[rod, at] = places[rod - 1, ANGLES_AT[1]]
                continue
            count = int(end.table.free[rod])
            places[rod, at.start : at.start + count] = range(first, first + count)
            first += count
    for at, end in zip(POSES_AT, graph.ends, strict=True):
        for rod, frame in enumerate(end.frame):
            if frame > 0:  # a body
                places[rod, at] = first + graph.slides.count + POSE * (frame - 1) + np.arange(POSE)
    return places, first


def _slid(variables: NDArray[np.intp], ends: list[NDArray[np.intp]], n: int) -> NDArray[np.intp]:
    """Entries of ``Entries.slid``, -1 of those in no row or column, by the places of the holes at tips and at bases."""
    holes = np.stack(ends, axis=1)
    both = np.concatenate(ends)[:, None]
    pairs = [(variables, end[:, None]) for end in ends]
    pairs += [(both, np.concatenate([variables] * 2)), (both, np.concatenate([holes] * 2))]
    found = [np.where((rows < 0) | (columns < 0), -1, rows * n + columns) for rows, columns in pairs]
    return np.concatenate([entries.reshape(-1) for entries in found])
