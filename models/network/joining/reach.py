"""Whether rods can reach what they join: (41) of ``docs/networks.md``."""

from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from multirod.models.network.graph import FREE, GROUND
from multirod.models.network.places import LOADED
from multirod.models.network.poses import frames_of
from multirod.out_of_reach import TAUT, Reach
from multirod.validation import FloatArray

if TYPE_CHECKING:
    from multirod.models.network.problem import NetworkProblem

TOGETHER = 1024  # instances at once: distances of all points from all that are known take room


class NetworkReach(Reach):
    """Of a ``NetworkProblem`` at its inputs: the shortest ways between the points that hold rods.

    Points are the ends of all pieces, bases before tips, of which those at holes and between segments count for nothing: what
    does not reach a hole is pulled out of it. Rods that stretch, and ends that slide freely, bound nothing.
    """

    def __init__(self, problem: "NetworkProblem") -> None:
        self.problem, graph = problem, problem.graph
        ends = np.concatenate([graph.slides.first, graph.slides.last])
        self.stand = np.where(ends, np.concatenate([end.stand for end in graph.ends]), FREE)
        self.known = np.flatnonzero(ends & (np.concatenate([end.frame for end in graph.ends]) == GROUND))
        pieces = [graph.slides.of(rod) for rod in range(len(graph.whole))]
        pairs = np.array([(own[0], own[-1] + len(graph.rods)) for own in pieces])
        self.rods = np.flatnonzero((self.stand[pairs] != FREE).all(axis=1))  # that are held at both ends
        self.pairs = pairs[self.rods]  # and these, shape (k, 2)
        self.bodies = _of_one_size([np.flatnonzero(self.stand == 1 + k) for k in range(len(graph.moving))])

    def exceeded(self) -> NDArray[np.bool_]:
        """(41) As said."""
        inputs = self.problem.read("inputs")[:, : self.problem.input_slice(LOADED[0]).start]
        return self.problem.found_for("out of reach", inputs, self._exceeded).copy()

    def _exceeded(self) -> NDArray[np.bool_]:
        points, lengths = self._points(), self._lengths()
        parts = np.array_split(np.arange(len(lengths)), -(-len(lengths) // TOGETHER))
        return np.concatenate([self._short(points[own], lengths[own])[0].any(axis=(1, 2)) for own in parts])

    def said(self, instance: int) -> str:  # noqa: D102
        points, lengths = (values[instance : instance + 1] for values in (self._points(), self._lengths()))
        short, ways, straight = (values[0] for values in self._short(points, lengths))
        # of all that are too short the shortest: no other is a part of it
        shortest = np.where(short, ways[:, self.known], np.inf)
        start, end = np.unravel_index(shortest.argmin(), shortest.shape)
        names = self._on_the_way(ways[start], points[0], lengths[0], int(self.known[end]))
        bodies = ", with the bodies between," if len(names) > 1 else ""
        listed = f"rod{'s' if len(names) > 1 else ''} {', '.join(map(repr, names))}"
        reach = f"reach{'' if len(names) > 1 else 'es'} {shortest[start, end]:.4g} m"
        return f" ({listed}{bodies} {reach} of {straight[start, end]:.4g} m)"

    def _on_the_way(self, way: FloatArray, points: FloatArray, lengths: FloatArray, at: int) -> list[str]:
        """Names of the rods on the shortest way, of which ``way`` (point,) are the lengths, back from the point ``at``."""
        by_rod = np.full(len(way), np.inf)  # of ways that end along a rod
        by_rod[self.pairs] = way[self.pairs[:, ::-1]] + lengths[:, None]
        names: list[str] = []
        while not names or at not in self.known:
            if names:
                body = np.flatnonzero((self.stand == self.stand[at]) & (np.arange(len(way)) != at))
                at = int(body[(by_rod[body] + np.linalg.norm(points[body] - points[at], axis=1)).argmin()])
            rod, end = np.argwhere(self.pairs == at)[0]
            names.append(self.problem.graph.whole_names[self.rods[rod]])
            at = int(self.pairs[rod, 1 - end])
        return names[::-1]

    def _short(self, points: FloatArray, lengths: FloatArray) -> tuple[NDArray[np.bool_], FloatArray, FloatArray]:
        """Which points that are known are farther apart than the way between, (b, known, known); the shortest ways from these to
        all points, (b, known, point); and how far apart they are, (b, known, known)."""
        straight = np.linalg.norm(points[:, self.known, None] - points[:, None, self.known], axis=-1)
        ways = np.full((len(points), len(self.known), points.shape[1]), np.inf)
        ways[:, :, self.known] = straight
        across = [np.linalg.norm(points[:, own, None] - points[:, own[:, None]], axis=-1)[:, None] for own in self.bodies]
        while True:
            before = ways.copy()
            along = ways[:, :, self.pairs[:, ::-1]] + lengths[:, None, :, None]
            ways[:, :, self.pairs] = np.minimum(ways[:, :, self.pairs], along)
            for own, bridge in zip(self.bodies, across, strict=True):
                ways[:, :, own] = (ways[:, :, own][..., None, :] + bridge).min(axis=-1)
            if np.array_equal(before, ways, equal_nan=True):
                return ways[:, :, self.known] < (1 - TAUT) * straight, ways, straight

    def _points(self) -> FloatArray:
        """Where they are [m]: in the world if that is known, else in the frames of their bodies, shape (instance, point, 3)."""
        problem, graph = self.problem, self.problem.graph
        found = [arm for arm, _ in problem.attachments]
        if graph.driven_slides:  # (36)
            driven = graph.driven_angles(problem.read("inputs")[:, problem.driven_place])
            for k, (end, (arm, frame), angles) in enumerate(zip(graph.ends, problem.attachments, driven, strict=True)):
                found[k] = arm + (frame @ end.table.moved(angles)[..., None])[..., 0]
        points = np.concatenate(found, axis=1)
        if graph.fixed:
            frames, known = frames_of(problem), self.known
            holder = self.stand[known]
            points[:, known] = frames.position[:, holder] + (frames.rotation[:, holder] @ points[:, known, :, None])[..., 0]
        return points

    @cached_property
    def _ends(self) -> list[FloatArray]:
        """Arclengths at which what each of these rods is made of ends [m], shapes (instance, n)."""
        slides, found = self.problem.graph.slides, []
        for first in self.pairs[:, 0].tolist():
            arrays = self.problem.graph.arrays[first].repeated(self.problem.batch_shape)
            found.append(slides.pieces[first] * arrays.end[:, :, -1])
        return found

    def _lengths(self) -> FloatArray:
        """What is in use of each rod that is held at both ends [m], ``inf`` where that bounds nothing, shape (instance, k)."""
        problem, graph = self.problem, self.problem.graph
        given = problem.read("inputs")[:, problem.input_slice("translation")]
        pushed = [given[:, slice(*graph.first_tube[[rod, rod + 1]])] for rod in self.rods.tolist()]
        lengths = [(own + more).max(axis=1) for own, more in zip(self._ends, pushed, strict=True)]
        slides = np.concatenate([end.table.slides.any(axis=1) & ~end.table.driven for end in graph.ends])[self.pairs].any(axis=1)
        stretches = np.array([graph.arrays[first].shear for first in self.pairs[:, 0].tolist()], dtype=bool)
        return np.where(slides | stretches, np.inf, np.reshape(lengths, (len(self.rods), len(given))).T)


def _of_one_size(groups: list[NDArray[np.intp]]) -> list[NDArray[np.intp]]:
    """Those of two or more, put together by how many they are, each of shape (group, size)."""
    sizes = sorted({len(own) for own in groups if len(own) > 1})
    return [np.stack([own for own in groups if len(own) == size]) for size in sizes]
