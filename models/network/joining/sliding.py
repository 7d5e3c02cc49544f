"""Rods in pieces: where they are cut at holes and into segments, how long pieces are, and what lets them slide.

Numbers in parentheses are those of ``docs/networks.md``.
"""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Literal

import numpy as np
from numpy.typing import NDArray

from multirod.models.network.joining.bodies import Body
from multirod.models.network.joining.joints import Joint
from multirod.rod import DENSITY
from multirod.validation import FloatArray

if TYPE_CHECKING:
    from multirod.models.network.elements.elements import Elements
    from multirod.models.network.problem import NetworkProblem
    from multirod.models.network.state import State

NONE = -1  # in the place of a hole


class Slides:
    """The pieces of all rods, which are cut at the holes through which they slide, or into segments; else one is one piece.

    Args:
        names: Of the rods.
        lengths: Theirs [m].
        holes: Of some rods, from the base to the tip.
        segments: (43) Of some others, how many.

    Attributes:
        owner: The rod of each piece, shape (piece_count,).
        order: Which of the pieces of its rod it is, from the base, shape (piece_count,).
        between: What segments are clamped to, bodies without mass.
        holes: All of them, in the order of the pieces below them.
        lower, upper: The hole at the base and at the tip of each piece, ``NONE`` where there is none, shape (piece_count,).
        share: (20) Part of its rod that each piece has where unknowns are zero, shape (piece_count,).
        pieces: How many its rod has, shape (piece_count,).
    """

    def __init__(
        self,
        names: Sequence[str],
        lengths: Sequence[float],
        holes: Mapping[str, Sequence[Joint]],
        segments: Mapping[str, int],
    ) -> None:
        owner: list[int] = []
        lower: list[int] = []
        upper: list[int] = []
        share: list[float] = []
        pieces: list[int] = []
        self.holes: list[Joint] = []
        self.between: list[Body] = []
        self._clamps: dict[tuple[int, str], Joint] = {}
        for rod, (name, length) in enumerate(zip(names, lengths, strict=True)):
            own = list(holes.get(name, ()))
            if (count := segments.get(name, 1)) > 1:
                self._clamp(name, len(owner), count)
                owner += [rod] * count
                lower += [NONE] * count
                upper += [NONE] * count
                share += [1 / count] * count
                pieces += [count] * count
                continue
            first = len(self.holes)
            numbers = list(range(first, first + len(own)))
            self.holes += own
            owner += [rod] * (len(own) + 1)
            lower += [NONE, *numbers]
            upper += [*numbers, NONE]
            share += np.diff([0.0, *(float(hole.at or 0.0) for hole in own), length]).tolist() if own else [length]
            share[-len(own) - 1 :] = [part / length for part in share[-len(own) - 1 :]]
            pieces += [len(own) + 1] * (len(own) + 1)
        self.owner, self.lower, self.upper = (np.array(values, dtype=np.intp) for values in (owner, lower, upper))
        self.pieces: NDArray[np.intp] = np.array(pieces, dtype=np.intp)
        self.share: FloatArray = np.array(share)
        self.order: NDArray[np.intp] = np.arange(len(owner)) - np.searchsorted(self.owner, self.owner)

    def _clamp(self, name: str, first: int, count: int) -> None:
        """(43) Bodies between the segments of a rod, of which ``first`` is the number of the first piece."""
        for k in range(1, count):
            body = Body(f"{name}, between segments {k - 1} and {k}")
            self.between.append(body)
            self._clamps[first + k - 1, "tip"] = Joint(name, "tip", to=body)
            self._clamps[first + k, "base"] = Joint(name, "base", to=body)

    @property
    def count(self) -> int:
        """Holes."""
        return len(self.holes)

    @property
    def below(self) -> FloatArray:
        """(20) Share of its rod that is below the tip of each piece where unknowns are zero, shape (piece_count,)."""
        return np.array([self.share[self.of(int(rod))[0] : k + 1].sum() for k, rod in enumerate(self.owner)])

    @property
    def springs(self) -> tuple[FloatArray, FloatArray]:
        """(37) Stiffness of what holds each piece to the hole at its tip along the rod [N/m], and the arclength of the rod where
        that is fixed to it [m], zero where there is none, shapes (piece_count,)."""
        holes = [None if k == NONE else self.holes[k] for k in self.upper.tolist()]
        stiffness, rest = ([0.0 if h is None else float(getattr(h, name)[0]) for h in holes] for name in ("stiffness", "rest"))
        return np.array(stiffness), np.array(rest)

    @property
    def first(self) -> NDArray[np.bool_]:
        """Whether a piece begins at the base of its rod, shape (piece_count,)."""
        return np.asarray(self.order == 0)

    @property
    def last(self) -> NDArray[np.bool_]:
        """Whether it ends at the tip, shape (piece_count,)."""
        return np.asarray(self.order == self.pieces - 1)

    @property
    def cut(self) -> NDArray[np.bool_]:
        """Whether a piece is not the whole rod, shape (piece_count,)."""
        return np.asarray(self.pieces > 1)

    @property
    def sliding(self) -> NDArray[np.bool_]:
        """Whether its rod slides through holes, shape (piece_count,)."""
        return np.isin(self.owner, self.owner[(self.lower != NONE) | (self.upper != NONE)])

    @property
    def still(self) -> NDArray[np.intp]:
        """The number of each piece among those of rods that do not, of no meaning where one does, shape (piece_count,)."""
        return np.asarray(np.cumsum(~self.sliding) - 1)

    def of(self, rod: int) -> list[int]:
        """Pieces of a rod, from its base."""
        return np.flatnonzero(self.owner == rod).tolist()

    def names(self, names: Sequence[str]) -> tuple[str, ...]:
        """Of the pieces, by those of the rods."""
        each = zip(self.order.tolist(), self.pieces.tolist(), self.owner.tolist(), strict=True)
        return tuple(names[rod] if count == 1 else f"{names[rod]}, piece {k}" for k, count, rod in each)

    def joint(self, piece: int, end: Literal["base", "tip"], given: Joint | None) -> Joint | None:
        """What holds an end of a piece: a hole, or what is ``given`` for that end of its rod."""
        source = self.source(piece, end, given)
        return source if source is None or self._hole(piece, end) == NONE else source.around(end)

    def source(self, piece: int, end: str, given: Joint | None) -> Joint | None:
        """The joint there as it was given; between segments a clamp."""
        hole = self._hole(piece, end)
        return self._clamps.get((piece, end), given) if hole == NONE else self.holes[hole]

    def _hole(self, piece: int, end: str) -> int:
        return int((self.lower if end == "base" else self.upper)[piece])

    @property
    def shared(self) -> NDArray[np.bool_]:
        """Whether the joint at the base of a piece is that at the tip of the piece below it, shape (piece_count,)."""
        return ~self.first


def densities(problem: "NetworkProblem") -> FloatArray:
    """Mass per length of each piece where it begins [kg/m], shape (instance, piece)."""
    return np.stack([own.repeated(problem.batch_shape).material[:, 0, 0, DENSITY] for own in problem.graph.arrays], axis=1)


def push_units(problem: "NetworkProblem") -> FloatArray:
    """(37) What pushes through holes at tips, then at bases, are told in [N m^2], shape (instance, 2, piece)."""
    L, EI = (scale[:, None, : problem.rod_count] for scale in (problem.length, problem.stiffness))
    slides, springs = problem.graph.slides, problem.graph.slides.springs[0]
    return np.asarray(EI + L**3 * np.stack([springs, np.where(slides.shared, np.roll(springs, 1), 0.0)]))


def slid(problem: "NetworkProblem", state: "State", elements: "Elements", gap: FloatArray) -> FloatArray:
    """(23) Of each element, how what it says of the hole at its tip and of that at its base varies, by the other variables, then
    by its length, by rows of its gap ``gap`` (instance, piece, 3, k + 1); shape (instance, piece, 2, k + 1)."""
    slides, layout = problem.graph.slides, problem.layout
    L, EI = (scale[:, : problem.rod_count] for scale in (problem.length, problem.stiffness))
    kept = [*range(layout.holes_at.start), -1]
    tip, base = (elements.tension[:, :, k][..., kept] for k in (0, 1))
    force, gravity = (state.level[:, None] * state.take(problem, name) for name in ("distributed_force", "gravity"))
    density = densities(problem)
    own = state.level[:, None, None] * state.take(problem, "rod_force").reshape(len(force), -1, 3)[:, slides.owner]
    load = force[:, None] + own + density[..., None] * gravity[:, None]
    local = (np.swapaxes(state.ends[0].rotation, -1, -2) @ load[..., None])[..., 0]
    there = (slides.upper != NONE)[:, None]
    moved = np.einsum("...i,...ik->...k", local, np.where(there[..., None], gap, 0.0))
    tip = tip + np.where(there, L[..., None] ** 2 * moved, 0.0)
    return np.asarray((L / EI)[..., None, None] * np.stack([tip, -base], axis=-2))
