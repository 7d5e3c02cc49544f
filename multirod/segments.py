"""A boundary problem cut into segments: what multiple shooting sees of an assembly."""

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from multirod.batch import IntArray
from multirod.stability import Modes
from multirod.status import BoolArray
from multirod.validation import FloatArray

if TYPE_CHECKING:
    from multirod.problem import Shape


@dataclass(frozen=True)
class Breakpoints:
    """One equilibrium of one instance, known by its states where segments begin.

    Attributes:
        arclength: Where the segments begin, the base first, then the tip [m], shape (segment_count + 1,).
        states: Where each segment begins, shape (segment_count, state_size); the first follows from ``unknowns``.
        unknowns: Of the boundary problem [1/m], shape (n,).
        steps: Integration steps of each segment, shape (segment_count,).
        gap: What Newton's method left of the equations between segments and at the tip, max norm [1/m]; NaN on the way.
        neutral: Modes that symmetry leaves neutral.
    """

    arclength: FloatArray
    states: FloatArray
    unknowns: FloatArray
    steps: NDArray[np.int32]
    gap: float = np.nan
    neutral: int = 0


def taken(points: Mapping[int, Breakpoints], instances: IntArray) -> dict[int, Breakpoints]:
    """Of the instances with these numbers, (k,), those that have breakpoints, by their places 0 to k - 1 among them."""
    return {place: points[k] for place, k in enumerate(instances.tolist()) if k in points} if points else {}


def placed(points: Mapping[int, Breakpoints], instances: IntArray) -> dict[int, Breakpoints]:
    """The reverse: by the numbers of instances, (k,), whose places among them were the keys."""
    return {int(instances[place]): own for place, own in points.items()}


@dataclass(frozen=True)
class Cuts:
    """Segments of several instances, one instance after another: between its breakpoints, or parts of these.

    Attributes:
        instances: Of the problem, each once, shape (count,).
        first: Where the segments of each begin among all, then how many there are, shape (count + 1,).
        start: Arclengths [m], shape (segment_count,).
        end: Likewise.
        states: At ``start``, shape (segment_count, state_size).
        unknowns: Of the boundary problem [1/m], shape (count, n): what a segment from the base starts with, and what all share.
        steps: Equal steps of each segment, shape (segment_count,).
    """

    instances: IntArray
    first: IntArray
    start: FloatArray
    end: FloatArray
    states: FloatArray
    unknowns: FloatArray
    steps: NDArray[np.int32]

    @classmethod
    def of_points(cls, points: Mapping[int, Breakpoints]) -> "Cuts":
        """All segments between the breakpoints of some instances; at least one of them."""
        own = list(points.values())
        return cls(
            np.array(list(points)),
            np.cumsum([0, *(len(p.steps) for p in own)]),
            np.concatenate([p.arclength[:-1] for p in own]),
            np.concatenate([p.arclength[1:] for p in own]),
            np.concatenate([p.states for p in own]),
            np.array([p.unknowns for p in own]),
            np.concatenate([p.steps for p in own]).astype(np.int32),
        )

    def points(self, place: int, gap: float = np.nan, neutral: int = 0) -> Breakpoints:
        """Breakpoints of one of the instances."""
        mine = slice(self.first[place], self.first[place + 1])
        arclength = np.append(self.start[mine], self.end[mine][-1:])
        return Breakpoints(arclength, self.states[mine], self.unknowns[place], self.steps[mine], gap, neutral)

    @cached_property
    def counts(self) -> IntArray:
        """Segments of each instance, shape (count,)."""
        return np.diff(self.first)

    @cached_property
    def owner(self) -> IntArray:
        """To which of the instances, 0 to count - 1, each segment belongs, shape (segment_count,)."""
        return np.repeat(np.arange(len(self.instances)), self.counts)

    @cached_property
    def inner(self) -> BoolArray:
        """Which segments end where another one begins, shape (segment_count,)."""
        result = np.ones(len(self.start), dtype=bool)
        result[self.first[1:] - 1] = False
        return result

    def chosen(self, some: BoolArray) -> "Cuts":
        """Those of some of the instances, (count,)."""
        if some.all():
            return self
        rows = some[self.owner]
        return Cuts(
            self.instances[some],
            np.append(0, np.cumsum(self.counts[some])),
            self.start[rows],
            self.end[rows],
            self.states[rows],
            self.unknowns[some],
            self.steps[rows],
        )

    def over(self, length: FloatArray) -> "Cuts":
        """These, stretched alike, of rods that are now so long [m], shape (count,)."""
        tips = self.first[1:] - 1
        if (self.end[tips] == length).all():
            return self
        ratio = (length / self.end[tips])[self.owner]
        start, end = ratio * self.start, ratio * self.end
        end[tips] = length
        return replace(self, start=start, end=end)

    def put(self, some: BoolArray, other: "Cuts") -> "Cuts":
        """These, with those of some of the instances, (count,), all that ``other`` has, replaced."""
        if some.all():
            return other
        counts = self.counts.copy()
        counts[some] = other.counts
        rows = replaced_rows(self, some, other)
        unknowns = self.unknowns.copy()
        unknowns[some] = other.unknowns
        start, end, states, steps = (
            np.concatenate([getattr(self, name), getattr(other, name)])[rows] for name in ("start", "end", "states", "steps")
        )
        return Cuts(self.instances, np.append(0, np.cumsum(counts)), start, end, states, unknowns, steps)

    def halves(self, long: BoolArray) -> "Cuts":
        """The first halves of the segments that are ``long``, (segment_count,), of the instances that have such; they end where
        a step does, so that both halves have the steps that the segment had."""
        counts = np.bincount(self.owner[long], minlength=len(self.instances))
        some = counts > 0
        start, steps = self.start[long], self.steps[long]
        first = (steps + 1) // 2
        share = np.where(steps > 1, first / np.maximum(steps, 1), 0.5)
        return Cuts(
            self.instances[some],
            np.append(0, np.cumsum(counts[some])),
            start,
            start + share * (self.end[long] - start),
            self.states[long],
            self.unknowns[some],
            first,
        )

    def halved(self, long: BoolArray, half: "Cuts", middle: FloatArray) -> "Cuts":
        """These, with one breakpoint more at the end of each of the halves, in the states ``middle`` to which they lead."""
        at = np.flatnonzero(long)
        counts = self.counts + np.bincount(self.owner[long], minlength=len(self.instances))
        end, steps = self.end.copy(), self.steps.copy()
        end[at], steps[at] = half.end, half.steps
        rest = self.steps[at] - half.steps
        return Cuts(
            self.instances,
            np.append(0, np.cumsum(counts)),
            np.insert(self.start, at + 1, half.end),
            np.insert(end, at + 1, self.end[at]),
            np.insert(self.states, at + 1, middle, axis=0),
            self.unknowns,
            np.insert(steps, at + 1, np.where(rest > 0, rest, half.steps)),
        )


def replaced_rows(mine: Cuts, some: BoolArray, other: Cuts) -> IntArray:
    """Where the segments stand in those of ``mine`` and then those of ``other``, if these are the ``some`` of the instances."""
    owners = np.concatenate([mine.owner, np.flatnonzero(some)[other.owner]])
    kept = np.append(~some[mine.owner], np.ones(len(other.start), dtype=bool))
    rows = np.flatnonzero(kept)
    return rows[np.argsort(owners[rows], kind="stable")]


@dataclass(frozen=True)
class Propagation:
    """Where segments of several instances lead; variations in 1/m.

    Attributes:
        end: States at the ends of the segments, shape (segment_count, state_size).
        transition: Variation there by that at the start, shape (segment_count, d, d); then by the directions in input space,
            shape (segment_count, d, d + direction_count).
        residual: Of the boundary condition, by the segment that ends at the tip [1/m], shape (count, n).
        residual_columns: Its derivative by the variation where that segment begins and by the directions, shape (count, n, d +
            direction_count).
        displacement: Of the centreline over each segment [m], in the frame of the base, shape (segment_count, 3).
        displacement_columns: Its derivative likewise, shape (segment_count, 3, d + direction_count).
        fault: 0, or why a segment of the instance failed, as for ``BoundaryProblem.fault``, shape (count,).
    """

    end: FloatArray
    transition: FloatArray
    residual: FloatArray
    residual_columns: FloatArray
    displacement: FloatArray
    displacement_columns: FloatArray
    fault: IntArray

    def chosen(self, cuts: Cuts, some: BoolArray) -> "Propagation":
        """Of some of the instances of ``cuts``, (count,)."""
        if some.all():
            return self
        rows = some[cuts.owner]
        return Propagation(
            self.end[rows],
            self.transition[rows],
            self.residual[some],
            self.residual_columns[some],
            self.displacement[rows],
            self.displacement_columns[rows],
            self.fault[some],
        )

    def put(self, cuts: Cuts, some: BoolArray, others: Cuts, other: "Propagation") -> "Propagation":
        """This, of the segments ``cuts``, with what ``others`` lead to in place of some of the instances, (count,)."""
        if some.all():
            return other
        rows = replaced_rows(cuts, some, others)

        def by_segment(name: str) -> FloatArray:
            return np.asarray(np.concatenate([getattr(self, name), getattr(other, name)])[rows])

        def by_instance(name: str) -> NDArray[Any]:
            result: NDArray[Any] = getattr(self, name).copy()
            result[some] = getattr(other, name)
            return result

        return Propagation(
            by_segment("end"),
            by_segment("transition"),
            by_instance("residual"),
            by_instance("residual_columns"),
            by_segment("displacement"),
            by_segment("displacement_columns"),
            by_instance("fault"),
        )


class Segments(ABC):
    """The segments of a boundary problem. States lie on a manifold; their variations are vectors in 1/m.

    Attributes:
        variation_size: Components ``d`` of a variation.
        unknown_places: Which of them the unknowns vary at the base, shape (n,).
        device: Warp device.
        end_held: Whether the pose of the tip is given, so that where it is tells nothing of what holds it.
    """

    end_held = False
    variation_size: int
    unknown_places: NDArray[np.intp]
    device: str

    @property
    @abstractmethod
    def direction_count(self) -> int:
        """Directions in input space by which is differentiated."""

    @abstractmethod
    def length(self, instances: IntArray) -> FloatArray:
        """Arclength of the tips of instances (count,) [m], shape (count,)."""

    @abstractmethod
    def base_state(self, instances: IntArray, unknowns: FloatArray) -> FloatArray:
        """States at the base, by unknowns (count, n), shape (count, state_size)."""

    @abstractmethod
    def propagate(self, cuts: Cuts, level: FloatArray) -> Propagation:
        """Integrate segments in one launch, those of each instance at a level of the load, (count,)."""

    def lead(self, cuts: Cuts, level: FloatArray) -> Propagation:
        """The same where only states, residuals and faults are asked for: what varies may be left out, no columns of it."""
        return self.propagate(cuts, level)

    @abstractmethod
    def difference(self, instances: IntArray, states: FloatArray, others: FloatArray) -> FloatArray:
        """Variations that lead from ``others`` to ``states``, each of an instance of ``instances`` (count,), shape (count, d)."""

    @abstractmethod
    def moved(self, instances: IntArray, states: FloatArray, variations: FloatArray) -> FloatArray:
        """States, each of an instance, led on by variations, shape (count, state_size)."""

    @abstractmethod
    def growth(self, cuts: Cuts, found: Propagation) -> FloatArray:
        """How much each segment amplifies a variation, in units in which that is least, shape (segment_count,)."""

    @abstractmethod
    def tip_pose(self, cuts: Cuts, found: Propagation) -> tuple[FloatArray, FloatArray]:
        """Positions [m], (count, 3), and rotations, (count, 3, 3), of the tips in the world: segments' displacements added up."""

    @abstractmethod
    def tip_pose_columns(self, cuts: Cuts, found: Propagation, variations: FloatArray) -> FloatArray:
        """Derivative of that pose of one instance by directions in input space, position rows then rotation-vector rows, both in
        the world.

        Args:
            cuts: Of that instance.
            found: Where its segments lead.
            variations: Where they begin, by the directions [1/m], shape (segment_count, d, direction_count).

        Returns:
            Shape (6, direction_count).
        """

    @abstractmethod
    def shapes(self, points: dict[int, Breakpoints], node_count: int) -> "tuple[tuple[Shape, ...], FloatArray, FloatArray]":
        """As ``BoundaryProblem.shapes``, rows of other instances NaN; the elastic energy and the work of dead forces [J]."""

    def modes(self, points: dict[int, Breakpoints]) -> Modes:
        """As ``BoundaryProblem.modes``, of these instances alone, in their order; unknown by default."""
        return Modes.unknown(len(points))
