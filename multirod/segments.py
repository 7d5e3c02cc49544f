"""A boundary problem cut into segments: what multiple shooting sees of an assembly."""

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from multirod.batch import IntArray
from multirod.stability import Modes
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
    """

    arclength: FloatArray
    states: FloatArray
    unknowns: FloatArray
    steps: NDArray[np.int32]
    gap: float = np.nan

    def halves(self, instance: int, long: NDArray[np.bool_], level: float) -> "Request":
        """The first halves of the segments that are ``long``."""
        start, size = self.arclength[:-1][long], np.diff(self.arclength)[long]
        steps = (self.steps[long] + 1) // 2
        return Request(instance, start, start + 0.5 * size, self.states[long], self.unknowns, level, steps)

    def halved(self, long: NDArray[np.bool_], half: "Request", middle: FloatArray) -> "Breakpoints":
        """Breakpoints with one more at the end of each of these halves, in the states ``middle`` to which they lead."""
        at = np.flatnonzero(long) + 1
        steps = np.array(self.steps)
        steps[long] = half.steps
        return Breakpoints(
            np.insert(self.arclength, at, half.end),
            np.insert(self.states, at, middle, axis=0),
            self.unknowns,
            np.insert(steps, at, half.steps),
        )


def taken(points: Mapping[int, Breakpoints], instances: IntArray) -> dict[int, Breakpoints]:
    """Of the instances with these numbers, (k,), those that have breakpoints, by their places 0 to k - 1 among them."""
    return {place: points[k] for place, k in enumerate(instances.tolist()) if k in points} if points else {}


def placed(points: Mapping[int, Breakpoints], instances: IntArray) -> dict[int, Breakpoints]:
    """The reverse: by the numbers of instances, (k,), whose places among them were the keys."""
    return {int(instances[place]): own for place, own in points.items()}


@dataclass(frozen=True)
class Propagation:
    """Where the segments of one instance lead; axes (segment, ...), variations in 1/m.

    Attributes:
        end: States at the ends of the segments, shape (segment_count, state_size).
        transition: Variation there by that at the start, shape (segment_count, d, d); then by the directions in input space,
            shape (segment_count, d, d + direction_count).
        residual: Of the boundary condition, by the segment that ends at the tip [1/m], shape (n,).
        residual_columns: Its derivative by the variation where that segment begins and by the directions, shape (n, d +
            direction_count).
        displacement: Of the centreline over each segment [m], in the frame of the base, shape (segment_count, 3).
        displacement_columns: Its derivative likewise, shape (segment_count, 3, d + direction_count).
        fault: 0, or why a segment failed, as for ``BoundaryProblem.fault``.
    """

    end: FloatArray
    transition: FloatArray
    residual: FloatArray
    residual_columns: FloatArray
    displacement: FloatArray
    displacement_columns: FloatArray
    fault: int


@dataclass(frozen=True)
class Request:
    """Segments of one instance to be integrated: from ``start`` to ``end``, at a level of the load.

    Attributes:
        instance: Of the problem.
        start: Arclengths [m], shape (segment_count,).
        end: Likewise.
        states: At ``start``, shape (segment_count, state_size).
        unknowns: Of the boundary problem [1/m], shape (n,): what a segment from the base starts with, and what all share.
        level: What multiplies all loads.
        steps: Equal steps of each segment, shape (segment_count,).
    """

    instance: int
    start: FloatArray
    end: FloatArray
    states: FloatArray
    unknowns: FloatArray
    level: float
    steps: NDArray[np.int32]

    @classmethod
    def all_of(cls, instance: int, points: Breakpoints, level: float) -> "Request":
        """All segments between breakpoints."""
        return cls(instance, points.arclength[:-1], points.arclength[1:], points.states, points.unknowns, level, points.steps)


class Segments(ABC):
    """The segments of a boundary problem. States lie on a manifold; their variations are vectors in 1/m.

    Attributes:
        variation_size: Components ``d`` of a variation.
        unknown_places: Which of them the unknowns vary at the base, shape (n,).
    """

    variation_size: int
    unknown_places: NDArray[np.intp]

    @abstractmethod
    def length(self, instance: int) -> float:
        """Arclength of the tip [m]."""

    @abstractmethod
    def base_state(self, instance: int, unknowns: FloatArray) -> FloatArray:
        """State at the base, shape (state_size,)."""

    @abstractmethod
    def propagate(self, requests: Sequence[Request]) -> list[Propagation]:
        """Integrate segments of several instances in one launch; at most one request an instance."""

    @abstractmethod
    def difference(self, instance: int, states: FloatArray, others: FloatArray) -> FloatArray:
        """Variations that lead from ``others`` to ``states``, shape (count, d)."""

    @abstractmethod
    def moved(self, instance: int, states: FloatArray, variations: FloatArray) -> FloatArray:
        """States led on by variations, shape (count, state_size)."""

    @abstractmethod
    def growth(self, found: Propagation) -> FloatArray:
        """How much each segment amplifies a variation, in units in which that is least, shape (segment_count,)."""

    @abstractmethod
    def tip_pose(self, instance: int, found: Propagation) -> tuple[FloatArray, FloatArray]:
        """Position [m] and rotation of the tip in the world: the segments' displacements added up."""

    @abstractmethod
    def tip_pose_columns(self, instance: int, found: Propagation, variations: FloatArray) -> FloatArray:
        """Derivative of that pose by directions in input space, position rows then rotation-vector rows, both in the world.

        Args:
            instance: Of the problem.
            found: Where the segments lead.
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
