"""The Jacobians of multiple shooting of several instances: their factors, solutions, and how they change along a branch.

Numbers in parentheses are those of ``docs/solvers.md``.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any
from weakref import ref

import numpy as np
import warp as wp
from numpy.typing import NDArray

from multirod.kernels.warp_types import Array
from multirod.launch import record
from multirod.segments import Cuts, Propagation, replaced_rows
from multirod.solvers.continuation.acceptance import LARGEST_RATIO, RATIO_POWERS, SMALLEST_RATIO
from multirod.solvers.segments.band_kernels import Band, Krylov, Sides, change, factorise, solve
from multirod.solvers.segments.neutral import Neutral
from multirod.status import BoolArray
from multirod.validation import FloatArray

FEW_VECTORS = 10  # of Arnoldi's method
VECTORS = 32  # where these do not tell
SLOTS = 3  # systems that stay factored: the last equilibrium's, and two on the way to the next
SETTLED = 0.1  # how far an eigenvalue may be from where Arnoldi's method has it


@dataclass(frozen=True)
class Step:
    """A change of all unknowns of several instances, or a right-hand side of as many numbers.

    Attributes:
        own: Of the unknowns, or what is lacking at the tip, shape (count, n).
        rows: Of the states where segments begin, zero at the base, or the gaps at their ends, zero at the tip, shape
            (segment_count, d).
    """

    own: FloatArray
    rows: FloatArray

    def times(self, cuts: Cuts, factor: FloatArray) -> "Step":
        """Each instance's by a factor of its own, (count,)."""
        return Step(factor[:, None] * self.own, factor[cuts.owner, None] * self.rows)

    def plus(self, other: "Step") -> "Step":
        """The sum, on the same segments."""
        return Step(self.own + other.own, self.rows + other.rows)

    def chosen(self, cuts: Cuts, some: BoolArray) -> "Step":
        """Of some of the instances, (count,)."""
        return self if some.all() else Step(self.own[some], self.rows[some[cuts.owner]])

    def put(self, cuts: Cuts, some: BoolArray, others: Cuts, other: "Step") -> "Step":
        """This, of the segments ``cuts``, with that of ``others`` in place of some of the instances, (count,)."""
        if some.all():
            return other
        own = self.own.copy()
        own[some] = other.own
        return Step(own, np.concatenate([self.rows, other.rows])[replaced_rows(cuts, some, others)])

    def norm(self, cuts: Cuts) -> FloatArray:
        """Euclidean, of each instance, shape (count,); infinite where its square is."""
        with np.errstate(over="ignore"):
            return np.asarray(np.sqrt((self.own**2).sum(axis=1) + np.add.reduceat((self.rows**2).sum(axis=1), cuts.first[:-1])))


class Room:
    """Arrays and recorded launches for up to so many instances and segments, kept for all systems that fit.

    Args:
        instances: At most.
        segments: At most, of all of them.
        shapes: Unknowns n, variations d, columns of transitions and of what is lacking at the tip.
        places: Of the unknowns among the variations at the base, shape (n,).
        device: Warp device.
    """

    def __init__(
        self, instances: int, segments: int, shapes: tuple[int, int, int, int], places: NDArray[np.intp], device: str
    ) -> None:
        self.instances, self.segments, self.device = instances, segments, device
        self.n, self.d, *self._columns = shapes
        self._places = places
        self._slots: list[_Slot] = []  # what was used last comes first
        self._spaces: dict[int, _Space] = {}
        self.right, self.x = self._sides(), self._sides()

    def array(self, *shape: int, kind: type = wp.float64) -> "_Array":
        """Zeros."""
        return _Array(wp.zeros(shape, dtype=kind, device=self.device))

    def _sides(self) -> "_Sides":
        return _Sides(self.array(self.instances, self.n), self.array(self.segments, self.d))

    def slot(self, systems: "Systems") -> "_Slot":
        """Where systems are factored; what was used before the last two makes room for new ones."""
        slot = next((slot for slot in self._slots if slot.of() is systems), None)
        if slot is None:
            slot = self._slots.pop() if len(self._slots) == SLOTS else _Slot(self, self._places, *self._columns)
            slot.factorise(systems)
        else:
            self._slots.remove(slot)
        self._slots.insert(0, slot)
        return slot

    def space(self, most: int) -> "_Space":
        """That of Arnoldi's method, of so many vectors."""
        if most not in self._spaces:
            self._spaces[most] = _Space(self, most)
        return self._spaces[most]


class _Array:
    """An array of kernels, and on the CPU the same numbers for NumPy."""

    def __init__(self, array: Array) -> None:
        self.array: Any = array
        self._view = array.numpy() if wp.get_device(array.device).is_cpu else None

    def put(self, values: NDArray[Any]) -> None:
        """First numbers."""
        if self._view is not None:
            self._view[: len(values)] = values
        elif len(values):
            self.array[: len(values)].assign(np.ascontiguousarray(values, dtype=self.array.numpy().dtype))

    def get(self, count: int) -> NDArray[Any]:
        """A copy of the first."""
        return np.array((self.array.numpy() if self._view is None else self._view)[:count])

    def clear(self, count: int) -> None:
        """The first become zero."""
        if self._view is not None:
            self._view[:count] = 0
        else:
            self.array.zero_()


class _Sides:
    """``Sides`` and its arrays."""

    def __init__(self, own: _Array, rows: _Array) -> None:
        self.own, self.rows = own, rows
        self.struct: Any = Sides()
        self.struct.own, self.struct.rows = own.array, rows.array


class _Slot:
    """Systems that are factored in a room."""

    def __init__(self, room: Room, places: NDArray[np.intp], inner: int, tip: int) -> None:
        count, n, d = room.segments, room.n, room.d
        self._room = room
        self.of: Callable[[], Systems | None] = lambda: None
        self._given = {
            "first": room.array(room.instances + 1, kind=wp.int32),
            "places": room.array(n, kind=wp.int32),
            "transition": room.array(count, d, inner),
            "tip": room.array(room.instances, n, tip),
        }
        self._given["places"].put(places)
        self._singular = room.array(room.instances, kind=wp.int32)
        band: Any = Band()
        for name, array in self._given.items():
            setattr(band, name, array.array)
        band.singular = self._singular.array
        band.factors, band.pivots = room.array(count, 2 * d - n, 2 * d).array, room.array(count, d, kind=wp.int32).array
        band.front = room.array(count, 2 * d - n).array
        self.band = band
        self._factorise = _Launch(factorise, room, band)
        self._solve = _Launch(solve, room, band, room.right.struct, room.x.struct)

    def factorise(self, systems: "Systems") -> None:
        """Take these, and say where they are singular."""
        self._given["first"].put(systems.cuts.first)
        transition, tip = systems.blocks()
        self._given["transition"].put(transition)
        self._given["tip"].put(tip)
        self._factorise.of(systems.count)
        systems.singular_at = self._singular.get(systems.count) != 0
        self.of = ref(systems)

    def solve(self, right: Step) -> Step:
        """``J^-1`` times right-hand sides; NaN where it is singular."""
        room, instances, segments = self._room, len(right.own), len(right.rows)
        room.right.own.put(right.own)
        room.right.rows.put(right.rows)
        room.x.rows.clear(segments)
        self._solve.of(instances)
        return Step(room.x.own.get(instances), room.x.rows.get(segments))


class _Space:
    """That of Arnoldi's method."""

    def __init__(self, room: Room, most: int) -> None:
        self._room, self._launches = room, dict[tuple[int, int], tuple[_Slot, _Slot, _Launch]]()
        self._projected, self._left = room.array(room.instances, most, most), room.array(room.instances)
        self._space: Any = Krylov()
        self._space.own, self._space.rows = (
            room.array(room.instances, most + 1, room.n).array,
            room.array(room.segments, most + 1, room.d).array,
        )
        self._space.projected, self._space.left = self._projected.array, self._left.array
        self._space.along = room.array(room.instances, most).array

    def change(self, before: _Slot, after: _Slot, count: int) -> tuple[FloatArray, FloatArray]:
        """``J_new J_old^-1 - I`` in the space, (count, most, most), and how much leads out of it, (count,)."""
        room, key = self._room, (id(before), id(after))
        if key not in self._launches:
            launch = _Launch(change, room, before.band, after.band, self._space, room.right.struct, room.x.struct)
            self._launches[key] = before, after, launch
        self._projected.clear(count)
        self._launches[key][-1].of(count)
        return self._projected.get(count), self._left.get(count)


class _Launch:
    """A recorded launch, of some of the instances that there is room for."""

    def __init__(self, kernel: wp.Kernel, room: Room, *arguments: object) -> None:
        self._count = room.instances
        self._launch = record(kernel, room.instances, arguments, room.device)

    def of(self, count: int) -> None:
        """Launch for the first instances."""
        if count != self._count:
            self._count = count
            self._launch.set_dim(count)
        self._launch.launch()


class Systems:
    """The Jacobians (2) at some states, each of one instance; factored when first needed.

    Args:
        cuts: The segments.
        found: Where they lead.
        places: Of the unknowns among the variations at the base, shape (n,).
        device: Warp device.
        rooms: Those to be used, and added to where there is none that fits, by what fits.
        neutral: What no step goes along, if there is such.
    """

    def __init__(
        self,
        cuts: Cuts,
        found: Propagation,
        places: NDArray[np.intp],
        device: str,
        rooms: dict[tuple[int, ...], Room] | None = None,
        neutral: Neutral | None = None,
    ) -> None:
        self.cuts, self.found, self.places, self.device, self.neutral = cuts, found, places, device, neutral
        self.n, self.d, self.count = len(places), found.transition.shape[1], len(cuts.instances)
        self.rooms = {} if rooms is None else rooms
        self.singular_at: BoolArray | None = None  # once they are factored

    def _alike(self, cuts: Cuts, found: Propagation, neutral: Neutral | None) -> "Systems":
        return Systems(cuts, found, self.places, self.device, self.rooms, neutral)

    def chosen(self, some: BoolArray) -> "Systems":
        """Of some of the instances, (count,)."""
        if some.all():
            return self
        neutral = None if self.neutral is None else self.neutral.chosen(some)
        return self._alike(self.cuts.chosen(some), self.found.chosen(self.cuts, some), neutral)

    def put(self, some: BoolArray, other: "Systems") -> "Systems":
        """These, with others in place of some of the instances, (count,)."""
        found = self.found.put(self.cuts, some, other.cuts, other.found)
        neutral = self.neutral
        if neutral is not None and other.neutral is not None:
            neutral = neutral.put(some, other.neutral)
        return self._alike(self.cuts.put(some, other.cuts), found, neutral)

    def blocks(self) -> tuple[FloatArray, FloatArray]:
        """Transitions and what is lacking at the tip, as the kernels want them, of columns ``room`` knows."""
        transition, tip = self.found.transition, self.found.residual_columns
        return (transition, tip) if self.neutral is None else self.neutral.bordered(self.cuts, transition, tip, self.places)

    @property
    def room(self) -> Room:
        """One that these fit."""
        columns = self.found.transition.shape[2], self.found.residual_columns.shape[2]
        capacity = tuple(1 << max(size - 1, 0).bit_length() for size in (self.count, len(self.cuts.start)))
        places = self.places if self.neutral is None else np.arange(self.n - self.neutral.modes)
        key = (*capacity, self.d, *columns, *places.tolist())
        if key not in self.rooms:
            self.rooms[key] = Room(capacity[0], capacity[1], (len(places), self.d, *columns), places, self.device)
        return self.rooms[key]

    @property
    def singular(self) -> BoolArray:
        """Where elimination meets a pivot that is zero, or numbers that are not finite, shape (count,)."""
        if self.singular_at is None:
            self.room.slot(self)
        assert self.singular_at is not None  # by being factored
        return self.singular_at

    def solve(self, right: Step) -> Step:
        """``J^-1`` times right-hand sides; NaN where it is singular. Across what is neutral, if there is such."""
        if self.neutral is None:
            return self.room.slot(self).solve(right)
        own = self.neutral.left_across(right.own)
        found = self.room.slot(self).solve(Step(own, right.rows))
        return Step(self.neutral.from_across(found.own), found.rows)

    def turned(self) -> Neutral:
        """(25) What is neutral here, near what it is taken for."""
        assert self.neutral is not None  # or nothing is
        return Neutral(self._neutral(), self._transposed()._neutral())

    def _neutral(self) -> FloatArray:
        """What ``J`` makes nothing of, its part of the unknowns, orthonormal, shape (count, n, m)."""
        assert self.neutral is not None  # as before
        cuts, given = self.cuts, self.neutral.right
        first, alone = cuts.first[:-1], cuts.counts == 1
        result = np.empty_like(given)
        for k in range(self.neutral.modes):
            rows = np.zeros((len(cuts.start), self.d))
            rows[first] = -np.einsum("kij,kj->ki", self.found.transition[first][:, :, self.places], given[:, :, k])
            own = -np.einsum("kij,kj->ki", self.found.residual_columns[:, :, self.places], given[:, :, k])
            rows[first[alone]] = 0.0
            result[:, :, k] = given[:, :, k] + self.solve(Step(np.where(alone[:, None], own, 0.0), rows)).own
        sound = np.asarray(np.isfinite(result).all(axis=(1, 2)))
        return np.asarray(np.linalg.qr(np.where(sound[:, None, None], result, given))[0])

    def _transposed(self) -> "Systems":
        """Those of the transposes: the tip comes first."""
        assert self.neutral is not None  # as before
        cuts, found, n, d = self.cuts, self.found, self.n, self.d
        tip = cuts.first[1:] - 1
        transition, last = np.zeros_like(found.transition), np.zeros_like(found.residual_columns)
        backward = (cuts.first[:-1] + cuts.first[1:])[cuts.owner] - np.arange(len(cuts.start)) - 1
        transition[:, :, :d] = found.transition[backward][:, :, :d].swapaxes(1, 2)
        transition[cuts.first[:-1], :, :n] = found.residual_columns[:, :, :d].swapaxes(1, 2)
        last[:, :, :d] = transition[tip][:, self.places, :d]
        alone = cuts.counts == 1
        last[alone, :, :n] = found.residual_columns[alone][:, :, self.places].swapaxes(1, 2)
        other = replace(found, transition=transition, residual_columns=last)
        return Systems(cuts, other, np.arange(n), self.device, self.rooms, self.neutral.swapped)

    def same_branch(self, after: "Systems") -> BoolArray:
        """Whether no mode came near zero or changed sign between these equilibria and those ``after``, on the same breakpoints,
        shape (count,).

        The eigenvalues of ``J_new J_old^-1`` do not depend on the units of states and residuals, nor on the frames they are told
        in, and their product is the ratio of the determinants of ``Gamma``. Those of the breakpoints are one. Those furthest from
        one are found by Arnoldi's method, on a few vectors, and where these do not say yes, on more; where it has not settled,
        the answer is no.
        """
        open_ = ~(self.singular | after.singular)
        result = np.zeros_like(open_)
        for most in (FEW_VECTORS, VECTORS):
            if not open_.any():
                break
            before, now = self.chosen(open_), after.chosen(open_)
            slots = before.room.slot(before), before.room.slot(now)
            result[open_] = _near_one(*before.room.space(most).change(*slots, before.count))
            open_ = open_ & ~result
        return result


def _near_one(shift: FloatArray, left: FloatArray) -> BoolArray:
    """Whether one and all eigenvalues of each matrix (count, m, m) lie where those of one branch do, (count,).

    ``left`` is how much leads out of the space in which the matrices are known, (count,).
    """
    result = np.zeros(len(shift), dtype=bool)
    finite = np.isfinite(shift).all(axis=(1, 2)) & np.isfinite(left)
    power, bound, E = 1.0, np.full(len(shift), np.inf), np.where(finite[:, None, None], shift, 0.0)
    with np.errstate(over="ignore", invalid="ignore"):  # a power that is too large bounds nothing
        while power <= RATIO_POWERS:
            bound = np.fmin(bound, np.sqrt((E * E).sum(axis=(1, 2))) ** (1 / power))
            if (bound < 0.5 * (1 - SMALLEST_RATIO)).all():
                break
            E, power = E @ E, 2 * power
    # half of the radius, as Arnoldi's method need not have settled
    result[finite & (bound < 0.5 * (1 - SMALLEST_RATIO))] = True
    open_ = np.flatnonzero(finite & ~result)
    if len(open_):
        values, vectors = np.linalg.eig(shift[open_])
        apart = left[open_, None] * np.abs(vectors[:, -1])
        outside = np.abs(values) > 0.5 * (1 - SMALLEST_RATIO)
        values = 1 + values
        inside = (values.real > SMALLEST_RATIO) & (np.abs(values) < LARGEST_RATIO)
        result[open_] = (inside & ~(outside & (apart > SETTLED))).all(axis=1)
    return result
