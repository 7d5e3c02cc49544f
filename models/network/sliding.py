"""Rods that slide through holes: where they are cut, how long their pieces are, and what lets them slide.

Numbers in parentheses are those of ``docs/networks.md``.
"""

from collections.abc import Mapping, Sequence
from copy import copy
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from multirod.models.network.elements import SIZE, Equations
from multirod.models.network.joints import Joint
from multirod.rod import Rod
from multirod.rotations import cross
from multirod.validation import FloatArray

if TYPE_CHECKING:
    from multirod.models.network.graph import Graph
    from multirod.models.network.problem import State

DENSITY = 9  # where the mass per length stands among what kernels read of a section
NONE = -1  # in the place of a hole
AXIS = np.array([0.0, 0.0, 1.0])


class Slides:
    """The pieces of all rods, which are cut at the holes through which they slide; one that does not is one piece.

    Args:
        names: Of the rods.
        lengths: Theirs [m].
        holes: Of some rods, from the base to the tip.

    Attributes:
        owner: The rod of each piece, shape (piece_count,).
        holes: All of them, in the order of the pieces below them.
        lower, upper: The hole at the base and at the tip of each piece, ``NONE`` where there is none, shape (piece_count,).
        share: (20) Part of its rod that each piece has where unknowns are zero, shape (piece_count,).
        pieces: How many its rod has, shape (piece_count,).
    """

    def __init__(self, names: Sequence[str], lengths: Sequence[float], holes: Mapping[str, Sequence[Joint]]) -> None:
        owner: list[int] = []
        lower: list[int] = []
        upper: list[int] = []
        share: list[float] = []
        pieces: list[int] = []
        self.holes: list[Joint] = []
        for rod, (name, length) in enumerate(zip(names, lengths, strict=True)):
            own = list(holes.get(name, ()))
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

    @property
    def count(self) -> int:
        """Holes."""
        return len(self.holes)

    @property
    def first(self) -> NDArray[np.bool_]:
        """Whether a piece begins at the base of its rod, shape (piece_count,)."""
        return np.asarray(self.lower == NONE)

    @property
    def cut(self) -> NDArray[np.bool_]:
        """Whether a piece is not the whole rod, shape (piece_count,)."""
        return np.asarray(self.pieces > 1)

    def of(self, rod: int) -> list[int]:
        """Pieces of a rod, from its base."""
        return np.flatnonzero(self.owner == rod).tolist()

    def names(self, names: Sequence[str]) -> tuple[str, ...]:
        """Of the pieces, by those of the rods."""
        count = np.bincount(self.owner, minlength=len(names))
        order = [k - self.of(rod)[0] for k, rod in enumerate(self.owner.tolist())]
        return tuple(
            names[rod] if count[rod] == 1 else f"{names[rod]}, piece {k}"
            for k, rod in zip(order, self.owner.tolist(), strict=True)
        )

    def joint(self, piece: int, end: str, given: Joint | None) -> Joint | None:
        """What holds an end of a piece: a hole, or what is ``given`` for that end of its rod."""
        hole = (self.lower if end == "base" else self.upper)[piece]
        return given if hole == NONE else self.holes[hole].around(end)

    @property
    def shared(self) -> NDArray[np.bool_]:
        """Whether the joint at the base of a piece is that at the tip of the piece below it, shape (piece_count,)."""
        return ~self.first


def uniform(rod: Rod) -> bool:
    """Whether a rod is the same all along: of one section, whose precurvature is no function of arclength."""
    return len(rod.sections) == 1 and isinstance(rod.sections[0].precurvature, np.ndarray)


def piece(rod: Rod, count: int) -> Rod:
    """One of ``count`` equal pieces of a uniform rod."""
    if count == 1:
        return rod
    result = copy(rod)
    (section,) = rod.sections
    object.__setattr__(result, "sections", (replace(section, length=section.length / count),))
    return result


class Sliding:
    """(19) to (23) The equations of the holes of a network; axes (instance, piece, ...).

    Args:
        graph: The network.
        length: Scale of each piece [m], (instance_count, piece_count).
        stiffness: Likewise [N m^2].
        batch_shape: Of the instances.
    """

    def __init__(
        self,
        graph: "Graph",
        length: FloatArray,
        stiffness: FloatArray,
        batch_shape: tuple[int, ...],
    ) -> None:
        self.slides, self.entries = graph.slides, graph.entries
        self.first, self.unknown_count = self.entries.first_hole, self.entries.size
        self.length, self.stiffness = length, stiffness
        arrays = [own.repeated(batch_shape) for own in graph.arrays]
        self.softness = np.stack([own.material[:, 0, 0, 3:9] for own in arrays], axis=1)
        self.density = np.stack([own.material[:, 0, 0, DENSITY] for own in arrays], axis=1)
        self.at_rest = np.stack([own.precurvature[:, 0, 0, :3] for own in arrays], axis=1)

    def translations(self, x: FloatArray, given: FloatArray, rows: NDArray[np.intp]) -> FloatArray:
        """(20) How much longer pieces are than they are taken to be, by the unknowns of the holes ``x`` (k, hole) and the
        translation of each rod ``given`` (k, rod), shape (k, piece)."""
        own, L = self.slides, self.length[rows]
        padded = np.concatenate([x, np.zeros((len(x), 1))], axis=1)
        moved = L**2 * (padded[:, own.upper] - padded[:, own.lower])
        return np.asarray((own.share * own.pieces - 1) * L + own.share * given[:, own.owner] + moved)

    def slid(self, equations: Equations, state: "State", gap: FloatArray, loads: tuple[FloatArray, FloatArray]) -> FloatArray:
        """(23) Of each element, how what it says of the hole at its tip and of that at its base varies, by its variables, then by
        its length, by rows of its gap ``gap`` (instance, piece, 3, SIZE + 1); shape (instance, piece, 2, SIZE + 1).

        ``loads`` are force per length and gravity, (instance, 3).
        """
        L, EI, kept = self.length[state.rows], self.stiffness[state.rows], [*range(SIZE), -1]
        tip, base = (columns[..., kept] for _, columns in self.tension(equations, state.rows))
        force, gravity = loads
        load = force[:, None] + self.density[state.rows, :, None] * gravity[:, None]
        local = _times(np.swapaxes(state.ends[0].rotation, -1, -2), load)
        there = (self.slides.upper != NONE)[:, None]
        tip = tip + np.where(there, L[..., None] ** 2 * _along(local, np.where(there[..., None], gap, 0.0)), 0.0)
        return (L / EI)[..., None, None] * np.stack([tip, -base], axis=-2)

    def by_unknowns(self, columns: FloatArray, piece: int, rows: NDArray[np.intp]) -> FloatArray:
        """(20) Columns (k, 6, ...) of a tip, the last by the length of its piece, as columns by the unknowns (k, 6, n)."""
        result = np.zeros((*columns.shape[:-1], self.unknown_count))
        hole = self.slides.lower[piece]
        if hole != NONE:
            result[..., self.first + hole] = -(self.length[rows, piece, None] ** 2) * columns[..., -1]
        return result

    def add(
        self,
        equations: Equations,
        *,
        rows: NDArray[np.intp],
        residual: FloatArray,
        gamma: FloatArray,
        directions: FloatArray,
    ) -> None:
        """(20), (22) What elements say by the lengths of pieces, and the rows of the holes."""
        count, d = len(rows), directions.shape[-1]
        L, EI = self.length[rows], self.stiffness[rows]
        square, unit = L[..., None] ** 2, (L / EI)[..., None]
        by_length = square * equations.columns[..., -1]
        tip, base = self.tension(equations, rows)
        residual += self.entries.sliding(np.concatenate([unit[..., 0] * tip[0], -unit[..., 0] * base[0]], axis=1))
        columns = np.concatenate([unit * tip[1], -unit * base[1]], axis=1)
        moved = np.concatenate([square, square], axis=1) * columns[..., -1:]
        parts = (by_length, -by_length, columns[..., :SIZE], np.concatenate([moved, -moved], axis=-1))
        values = np.concatenate([part.reshape(count, -1) for part in parts], axis=1)
        gamma += self.entries.slid(values)
        directions += np.moveaxis(self.entries.sliding(np.moveaxis(columns[..., SIZE : SIZE + d], 1, 2)), 1, 2)

    def tension(
        self, equations: Equations, instances: NDArray[np.intp]
    ) -> tuple[tuple[FloatArray, FloatArray], tuple[FloatArray, FloatArray]]:
        """(22) What slides at the tips, then at the bases of pieces [N], (instance, piece), and by the variables of the
        elements, then along directions, (instance, piece, SIZE + k)."""
        rods = equations.rods
        back = np.swapaxes(rods.rotation, -1, -2)
        n, m, turn = rods.force, rods.moment, rods.pose_columns[..., 3:, :]
        tip = self._of(_times(back, n), _times(back, m), instances)
        v, u = (_times(rods.rotation, strain) for strain in tip[1:])
        by_tip = _along(v, rods.wrench_columns[..., :3, :]) + _along(u, rods.wrench_columns[..., 3:, :])
        by_tip += _along(cross(v, n) + cross(u, m), turn)
        base = self._of(rods.base_force, rods.base_moment, instances)
        by_base = _along(base[1], rods.base_columns[..., :3, :]) + _along(base[2], rods.base_columns[..., 3:, :])
        by_all = [equations.driven(equations.spread(columns[..., None, :]))[..., 0, :] for columns in (by_tip, by_base)]
        return (tip[0], by_all[0]), (base[0], by_all[1])

    def _of(
        self, force: FloatArray, moment: FloatArray, instances: NDArray[np.intp]
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """(22) By force and moment in the frame of the section; and the strains there."""
        softness, at_rest = self.softness[instances], self.at_rest[instances]
        bent, stretched = softness[..., :3] * moment, softness[..., 3:] * force
        u, v = at_rest + bent, AXIS + stretched
        value = (force * (AXIS + 0.5 * stretched)).sum(axis=-1) + (moment * (at_rest + 0.5 * bent)).sum(axis=-1)
        return value, v, u


def _along(vector: FloatArray, columns: FloatArray) -> FloatArray:
    """Products of a vector (..., 3) with columns (..., 3, k), shape (..., k)."""
    return np.asarray(np.einsum("...i,...ik->...k", vector, columns))


def _times(matrices: FloatArray, vectors: FloatArray) -> FloatArray:
    return np.asarray((matrices @ vectors[..., None])[..., 0])
