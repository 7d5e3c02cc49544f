"""Where the numbers of the elements stand in residual and ``Gamma`` of a network.

Numbers in parentheses are those of ``docs/networks.md``.
"""

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from multirod.elimination import Elimination
from multirod.models.network.elements.elements import POSE
from multirod.validation import FloatArray

if TYPE_CHECKING:
    from multirod.models.network.graph import Graph

WHOLE = 36  # unknowns below which Gamma is eliminated whole
BORDER = 24  # unknowns of bodies and holes up to which it is as an arrow, rod by rod; of more along the graph


class Sums:
    """Which numbers belong to the same place, and are summed there.

    Args:
        places: Of each number; negative of those that belong nowhere, shape (k,).

    Attributes:
        order: The numbers, place by place, shape (m,).
        starts: Where those of each place begin among these, and their end, shape (p + 1,).
        places: Where, rising, shape (p,).
    """

    def __init__(self, places: NDArray[np.intp]) -> None:
        kept = np.flatnonzero(places >= 0)
        self.order: NDArray[np.intp] = kept[np.argsort(places[kept], kind="stable")]
        ordered = places[self.order]
        first = np.concatenate([[True], ordered[1:] != ordered[:-1]]) if len(ordered) else np.zeros(0, dtype=bool)
        self.starts: NDArray[np.intp] = np.append(np.flatnonzero(first), len(ordered))
        self.places: NDArray[np.intp] = ordered[self.starts[:-1]]


class Entries:
    """Of a network: rows and columns of its elements.

    Args:
        graph: The network.

    Attributes:
        variables: Where the variables of each element stand among the unknowns, and its rows among the residuals, -1 of what
            there is not, and of angles that are inputs, shape (rod_count, size) of ``Layout``.
        first_hole: Where the unknowns of holes begin, through which rods slide, and their rows.
        first_pose: Where the poses of bodies begin.
        size: Unknowns.
        arrow: Where the unknowns of each rod begin, those of bodies and holes, and ``size``, if ``Gamma`` is eliminated rod by
            rod, as ``BoundaryProblem.arrow``; else empty.
        elimination: How ``Gamma`` is eliminated along the graph; None where it is small, or an arrow.
        count: Numbers that are kept of ``Gamma``: those that ``elimination`` names, or all.
        rows: Sums of the rows of the elements, (rod_count * size,) of them.
        numbers: Sums of their matrices, (rod_count * size * size,) numbers.
        turns: Where the balance of each body stands by how it turns, among the numbers, shape (body_count, 6, 3).
    """

    def __init__(self, graph: "Graph") -> None:
        layout = graph.layout
        self.variables, self.first_hole = _variables(graph)
        self.first_pose = self.first_hole + graph.slides.count
        bodies = len(graph.moving)
        self.size = n = self.first_pose + POSE * bodies
        rows, columns = self.variables[:, :, None], self.variables[:, None]
        entries = np.where((rows < 0) | (columns < 0), -1, rows * n + columns).reshape(-1)
        poses = self.first_pose + np.arange(POSE * bodies).reshape(-1, POSE)
        turns = poses[:, :, None] * n + poses[:, None, 3:]
        self.arrow: tuple[int, ...] = ()
        self.elimination: Elimination | None = None
        self.count = n * n
        if n >= WHOLE and n - self.first_hole <= BORDER:
            firsts = self.variables[np.flatnonzero(graph.slides.first), 0].tolist()
            self.arrow = (*firsts, self.first_hole, n) if n > self.first_hole else ()
        elif n >= WHOLE:
            self.elimination = own = Elimination(np.concatenate([entries[entries >= 0], turns.reshape(-1)]), n)
            self.count = own.count
            entries = np.where(entries < 0, -1, own.index(np.maximum(entries, own.places[0])))
            turns = own.index(turns)
        self.turns = turns
        self.rows, self.numbers = Sums(self.variables.reshape(-1)), Sums(entries)
        assert self.variables.shape[1] == layout.size

    def dense(self, numbers: FloatArray) -> FloatArray:
        """``Gamma`` (..., n, n) of its numbers (..., count)."""
        if self.elimination is not None:
            return self.elimination.dense(numbers)
        return numbers.reshape(*numbers.shape[:-1], self.size, self.size)


def _variables(graph: "Graph") -> tuple[NDArray[np.intp], int]:
    layout, slides = graph.layout, graph.slides
    places = np.full((len(graph.rods), layout.size), -1, dtype=np.intp)
    first = 0
    for rod, own in enumerate(graph.own.tolist()):
        places[rod, :own] = range(first, first + own)
        first += own
        for at, end in zip(layout.angles_at, graph.ends, strict=True):
            if at == layout.angles_at[0] and slides.shared[rod]:
                places[rod, at] = places[rod - 1, layout.angles_at[1]]
                continue
            count = int(end.table.free[rod])
            places[rod, at.start : at.start + count] = range(first, first + count)
            first += count
    for at, end in zip(layout.poses_at, graph.ends, strict=True):
        for rod, frame in enumerate(end.frame):
            if frame > 0:  # a body
                places[rod, at] = first + slides.count + POSE * (frame - 1) + np.arange(POSE)
    if layout.holes:
        for k, holes in enumerate((slides.upper, slides.lower)):
            places[:, layout.holes_at.start + k] = np.where(holes < 0, -1, first + holes)
    return places, first
