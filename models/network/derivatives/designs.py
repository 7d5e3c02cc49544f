"""How a network varies with the numbers of its rods, where its joints are, and where its ground is.

Numbers in parentheses are those of ``docs/derivatives.md``.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from multirod.models.backbone.derivatives.designs import AROUND, COMPONENTS, carried, turned_loads
from multirod.models.network.elements.elements import TURNING, Elements
from multirod.models.network.elements.groups import ALONG, ON_RODS, RodGroup
from multirod.models.network.graph import ENDS, Graph
from multirod.models.network.joining.sliding import push_units
from multirod.models.network.places import FIXED, LOADED
from multirod.models.network.poses import ground_of
from multirod.validation import FloatArray

if TYPE_CHECKING:
    from multirod.models.network.problem import NetworkProblem

POSE = 6
PARAMETERS = (*COMPONENTS, "base", "joint_pose")
DEAD = (*LOADED, *ALONG, *ON_RODS)  # loads that are fixed in the world; so is what moves bodies that are fixed, (34)


@dataclass(frozen=True)
class Columns:
    """Where the columns by an input or parameter stand among the directions of a problem.

    Attributes:
        name: Of it.
        start: Its first direction.
        size: How many it takes.
        numbers: How many numbers it has.
        owned: Of what rods share the directions, because each number touches one rod: which of its numbers each direction is to
            each rod, -1 of none, shape (rod_count, size). None where each direction is a number.
    """

    name: str
    start: int
    size: int
    numbers: int
    owned: NDArray[np.intp] | None = None

    @property
    def own(self) -> slice:
        """Its directions."""
        return slice(self.start, self.start + self.size)


def parameter_size(name: str, graph: Graph) -> int:
    """How many columns derivatives by a parameter have."""
    if name in COMPONENTS:
        return int(graph.first_tube[-1]) * _most_sections(graph) * COMPONENTS[name]
    return POSE * (len(graph.all_joints) if name == "joint_pose" else 1)


def _most_sections(graph: Graph) -> int:
    return max(len(rod.sections) for robot in graph.whole for rod in robot.rods)


def columns_of(graph: Graph, sizes: dict[str, int], names: Sequence[str]) -> list[Columns]:
    """Where the columns by each name stand; ``sizes`` are those of the inputs."""
    found: list[Columns] = []
    start = 0
    for name in names:
        owned = _owned(graph, name)
        numbers = sizes[name] if name in sizes else parameter_size(name, graph)
        size = numbers if owned is None else owned.shape[1]
        found.append(Columns(name, start, size, numbers, owned))
        start += size
    return found


def _owned(graph: Graph, name: str) -> NDArray[np.intp] | None:
    """``Columns.owned`` of a parameter."""
    if name in COMPONENTS:
        each = _most_sections(graph) * COMPONENTS[name]
        counts = each * np.diff(graph.first_tube)[graph.slides.owner]
        own = each * graph.first_tube[graph.slides.owner][:, None] + np.arange(int(counts.max()))
        return np.where(np.arange(own.shape[1]) < counts[:, None], own, -1)
    if name == "joint_pose":
        joint = np.stack([end.joint for end in graph.ends], axis=1)  # of each rod, at its base and its tip
        own = np.where(joint[..., None] < 0, -1, POSE * joint[..., None] + np.arange(POSE))
        return own.reshape(len(own), -1)
    return None


def by_numbers(every: Sequence[Columns], rod: int | None, values: FloatArray) -> FloatArray:
    """Columns of a rod, or of what is none, along directions (..., d), as columns by all numbers (..., k): zero of those that do
    not touch it."""
    result = np.zeros((*values.shape[:-1], sum(columns.numbers for columns in every)))
    first = 0
    for columns in every:
        own = values[..., columns.own]
        if columns.owned is None:
            result[..., first : first + columns.numbers] = own
        elif rod is not None:
            there = np.flatnonzero(columns.owned[rod] >= 0)
            result[..., first + columns.owned[rod, there]] = own[..., there]
        first += columns.numbers
    return result


class Aim:
    """What the directions of a ``NetworkProblem`` are pointed along.

    Attributes:
        every: Where the columns by each name stand.
        follows: Whether directions depend on inputs or unknowns, and are found at each integration.
    """

    def __init__(self, problem: "NetworkProblem", names: Sequence[str]) -> None:
        self.problem, self.names = problem, tuple(names)
        self.every = problem.columns_of(names)
        designed = any(name in COMPONENTS for name in names)
        behind = any(group.backbones.transmission for group in problem.groups)
        self.follows = "base" in names or (designed and behind)
        self.is_parameter = any(name in PARAMETERS for name in names)

    def write(self) -> None:
        """Point them there, by inputs and unknowns that the rods have been handed."""
        problem, graph = self.problem, self.problem.graph
        directions = np.zeros(problem.directions.shape)
        moved = np.full(max(problem.direction_count, 1), -1, dtype=np.int32)
        for columns in self.every:
            if columns.name == "base":
                directions[:, columns.own] = turned_loads(problem, (*DEAD, *FIXED) if graph.fixed else DEAD)
            elif columns.name == "joint_pose":
                moved[columns.own] = np.arange(columns.size)
            elif columns.owned is None:
                at = problem.input_slice(columns.name)
                directions[:, range(columns.start, columns.start + columns.size), range(at.start, at.stop)] = 1.0
        for group in problem.groups:
            self._write_rods(group, directions)
        start = problem.input_slice("translation").start
        for columns in self.every:
            if columns.name == "length":  # a rod that slides through holes is pushed out of its base by as much
                for rod in np.flatnonzero(graph.slides.sliding).tolist():
                    directions[:, columns.start, start + graph.first_tube[graph.slides.owner[rod]]] = 1.0
        problem.directions.assign(directions)
        problem.networks.moved.assign(moved)

    def _write_rods(self, group: RodGroup, directions: FloatArray) -> None:
        """Along the rods' own numbers: in ``directions`` how they turn behind their plates, the rest to the rods themselves."""
        problem, own = self.problem, group.backbones
        width = own.directions.shape[2] - own.input_count
        if not width:
            return
        graph, first = problem.graph, TURNING * group.turns
        rows = np.zeros((problem.instance_count, len(group.members), *own.directions.shape[1:]))
        turned = own.input_slice("rotation")
        for columns in self.every:
            if columns.name not in COMPONENTS or (columns.name == "length" and group.slides):
                continue
            found = self.rows(group, columns.name)
            there = slice(columns.start, columns.start + found.shape[2])
            rows[:, :, first + there.start : first + there.stop, own.input_count :] = found[..., own.input_count :]
            for place, rod in enumerate(group.members.tolist()):
                if not graph.slides.cut[rod]:
                    tube = int(graph.first_tube[graph.slides.owner[rod]])
                    directions[:, there, tube : tube + len(own.rods)] = found[:, place, :, turned]
        kept = own.directions.numpy()[:, :, : own.input_count].reshape(*rows.shape[:3], -1)
        rows[..., : own.input_count] = kept
        own.directions.assign(rows.reshape(own.directions.shape))

    def rows(self, group: RodGroup, name: str) -> FloatArray:
        """Directions of rods of one build along each of their own numbers, as many as if every tube had the most sections, shape
        (instance_count, rod, k, width); none by what a rod cannot have around it."""
        rows = group.backbones.derivatives.designs(name).rows()
        rows = rows.reshape(self.problem.instance_count, len(group.members), *rows.shape[1:])
        if name in AROUND:
            rows = rows * self.problem.graph.embeddable[group.members, None, None]
        if name == "length":  # (43)
            rows = rows * self.problem.graph.slides.share[group.members, None, None]
        return self.padded(group, rows, name)

    def padded(self, group: RodGroup, rows: FloatArray, name: str) -> FloatArray:
        """The same (instance_count, rod, k, ...) of what is there for the sections that the tubes have."""
        tubes, count = len(group.backbones.rods), COMPONENTS[name]
        own = rows.reshape(*rows.shape[:2], tubes, -1, count, rows.shape[-1])
        more = _most_sections(self.problem.graph) - own.shape[3]
        return np.pad(own, [(0, 0)] * 3 + [(0, more)] + [(0, 0)] * 2).reshape(*rows.shape[:2], -1, rows.shape[-1])

    def found(self, slopes: FloatArray, moved: FloatArray, position: FloatArray) -> tuple[FloatArray, FloatArray]:
        """What ``BoundaryProblem.aimed`` returns, by columns along directions and the ``position`` of the end effector."""
        problem = self.problem
        slopes, moved = self._slopes(slopes), by_numbers(self.every, problem.effector_rod, moved)
        if self.is_parameter and not problem.eliminates:
            rates, n = self.unknown_rates(), problem.unknown_count
            slopes -= problem.read("gamma").reshape(-1, n, n) @ rates
            moved -= problem.pose_columns.numpy()[:, :, :n] @ rates
        for own in self.numbers_of("base"):  # (D10)
            moved[:, :, own] += carried(position - ground_of(problem)[0])
        return slopes, moved

    def numbers_of(self, name: str) -> Iterator[slice]:
        """Where the numbers of a name stand."""
        first = 0
        for columns in self.every:
            if columns.name == name:
                yield slice(first, first + columns.numbers)
            first += columns.numbers

    def _slopes(self, found: FloatArray) -> FloatArray:
        """Of the residual by each number, shape (instance_count, n, k), by its columns ``found`` along directions: what unknowns
        stand for is fixed, moments and forces at bases, angles, and the places of bodies."""
        if all(columns.owned is None for columns in self.every):
            return found
        problem = self.problem
        size = problem.layout.size
        along = Elements(problem).columns[..., size : size + problem.direction_count].copy()
        self._add_slides(along)
        result = np.zeros((problem.instance_count, problem.unknown_count, sum(columns.numbers for columns in self.every)))
        for rod, places in enumerate(problem.places):
            there = np.flatnonzero(places >= 0)
            result[:, places[there]] += by_numbers(self.every, rod, along[:, rod, there])
        first = 0
        for columns in self.every:
            if columns.owned is None:  # what acts on bodies stands in no element
                result[:, :, first : first + columns.numbers] = found[..., columns.own]
            first += columns.numbers
        return result

    def _add_slides(self, along: FloatArray) -> None:
        """(D22) In place: what slides at holes, by the numbers of the rod there, its wrench as it is."""
        problem = self.problem
        if not problem.layout.holes:
            return
        size, scales = problem.layout.size, problem.length[:, None, : problem.rod_count] / push_units(problem)
        for group in problem.groups:
            if not group.slides:
                continue
            for columns in self.every:
                if columns.name not in COMPONENTS or columns.name == "length":
                    continue
                for end, sense in ((1, 1.0), (0, -1.0)):
                    rates = self._sliding_rates(group, columns.name, end)
                    for place, rod in enumerate(group.members.tolist()):
                        scale = sense * scales[:, 1 - end, rod, None]
                        there = slice(columns.start, columns.start + rates.shape[2])
                        along[:, rod, size - 1 - end, there] += scale * rates[:, place]

    def _sliding_rates(self, group: RodGroup, name: str, end: int) -> FloatArray:
        """(D22) Of what slides at an end [N], shape (instance_count, rod, k)."""
        problem, own = self.problem, group.backbones
        moment = group.end_moments(end)
        designs = own.derivatives.designs(name)
        bent = own.each(designs.precurvature[:, :, 0, 0, :3])
        soft = own.each(designs.softness[:, :, 0, 0] * own.arrays.material[:, None, 0, 0, 3:6])
        rates = np.einsum("ti,tki->tk", moment, bent) + 0.5 * np.einsum("ti,tki->tk", moment**2, soft)
        return self.padded(group, rates.reshape(problem.instance_count, len(group.members), -1, 1), name)[..., 0]

    def unknown_rates(self) -> FloatArray:
        """(D9) How the unknowns must change with each number for what they stand for to stay, shape (instance_count, n, k).

        Raises:
            NotImplementedError: By lengths and by poses of joints, with which the places change from which bodies are told.
        """
        problem = self.problem
        result = np.zeros((problem.instance_count, problem.unknown_count, sum(columns.numbers for columns in self.every)))
        first = 0
        for columns in self.every:
            if columns.name in ("length", "joint_pose"):
                raise NotImplementedError(f"the derivatives of networks by {columns.name}, the unknowns fixed, are not known")
            if columns.name in COMPONENTS:
                for group in problem.groups:
                    own = np.swapaxes(group.backbones.derivatives.designs(columns.name).unknown_rates(), 1, 2)
                    own = own.reshape(problem.instance_count, len(group.members), *own.shape[1:])
                    own = self.padded(group, own, columns.name)
                    for place, rod in enumerate(group.members.tolist()):
                        numbers = first + columns.owned[rod, : own.shape[2]]  # type: ignore[index]  # of numbers of rods
                        result[:, problem.places[rod, : own.shape[3], None], numbers] = np.swapaxes(own[:, place], 1, 2)
            first += columns.numbers
        return result


assert ENDS == ("base", "tip")  # in whose order the poses of joints are moved
