"""What the boundary problem of a network offers beside its equations."""

from collections.abc import Sequence
from copy import copy
from itertools import product
from typing import TYPE_CHECKING

import numpy as np

from multirod.batch import IntArray
from multirod.capabilities import Shapes
from multirod.integrators import Integrator
from multirod.models.backbone.equal_steps import PartsAtEqualSteps
from multirod.models.backbone.members.driven import LinesOfGroups
from multirod.models.network.closing import ARRAYS
from multirod.models.network.derivatives.along import at_rates, by_network
from multirod.models.network.derivatives.designs import by_numbers
from multirod.models.network.elements import records
from multirod.problem import Shape, nodes_of_pieces
from multirod.rod import RodArrays
from multirod.validation import FloatArray

if TYPE_CHECKING:
    from multirod.models.network.problem import NetworkProblem


class NetworkParts(PartsAtEqualSteps["NetworkProblem"]):
    """Of a ``NetworkProblem``."""

    def __init__(self, problem: "NetworkProblem") -> None:
        super().__init__(problem, problem.integrator, [group.backbones for group in problem.groups])

    @property
    def may_be_clamped(self) -> bool:
        """Those that do not slide, if there are: how long pieces are would move the clamps of others."""
        still = [group.backbones for group in self.problem.groups if not group.slides]
        return bool(still) and all(own.may_be_clamped for own in still)

    @property
    def all_clamped(self) -> bool:  # noqa: D102
        return self.may_be_clamped and not self.problem.layout.holes

    @property
    def _arrays(self) -> Sequence[RodArrays]:
        return self.problem.graph.arrays

    def _part(
        self, instances: IntArray, integrator: Integrator, *, poses: bool, pieces: int = 1, eased: float = np.inf
    ) -> "NetworkProblem":
        whole = self.problem
        graph = whole.graph.take(whole.batch_shape, instances)
        if eased < np.inf:
            graph = copy(graph)
            graph.arrays = tuple(arrays.eased(eased) for arrays in graph.arrays)
        result = type(whole)(
            graph,
            whole.end_effector,
            whole.inputs_given.take(whole.batch_shape, instances),
            integrator=integrator,
            pieces=pieces,
            effector_frame=whole.effector_frame,
            **{**whole.options, **({"pose_sensitivities": True} if poses else {})},
        )
        result.stop = whole.stop
        for name in ("inputs", "unknowns"):
            result.write(name, whole.read(name)[instances])
        for name in ARRAYS:
            getattr(result.closing, name)[:] = getattr(whole.closing, name)[instances]
        return result


class NetworkShapes(Shapes):
    """Of a ``NetworkProblem``: its rods in the world."""

    def __init__(self, problem: "NetworkProblem") -> None:
        self.problem = problem

    def at_nodes(self, node_count: int) -> tuple[tuple[Shape, ...], FloatArray]:
        """As said; the energy is that of the rods and of the springs in joints."""
        problem, count, slides = self.problem, self.problem.instance_count, self.problem.graph.slides
        with problem.everyone():
            problem.hand_over()
            state = problem.state()
            found: dict[tuple[int, int], dict[int, dict[str, FloatArray]]] = {}
            energy = self.of_springs(state.angles)
            base = state.ends[0]
            for group in problem.groups:
                # rods through holes and rods in segments may be launched together
                for nodes in sorted({n for piece in group.members.tolist() for n in self._nodes(piece, node_count)}):
                    shapes, own = group.backbones.shapes.at_nodes(nodes)
                    for (place, rod), (tube, shape) in product(enumerate(group.members.tolist()), enumerate(shapes)):
                        values = {name: v.reshape(count, -1, *v.shape[1:])[:, place] for name, v in vars(shape).items()}
                        R = base.rotation[:, rod, None]
                        values["position"] = base.position[:, rod, None] + (R @ values["position"][..., None])[..., 0]
                        values["rotation"] = R @ values["rotation"]
                        found.setdefault((rod, tube), {})[nodes] = values
                energy += own.reshape(count, -1).sum(axis=1)
        tubes = [(rod, tube) for rod, whole in enumerate(problem.graph.whole) for tube in range(whole.rod_count)]
        joined = []
        for rod, tube in tubes:
            pieces = slides.of(rod)
            parts = [dict(found[k, tube][nodes]) for k, nodes in zip(pieces, self._nodes(pieces[0], node_count), strict=True)]
            joined.append(_joined(parts, node_count, twice=bool(slides.sliding[pieces[0]])))
        return tuple(joined), energy

    def _nodes(self, piece: int, node_count: int) -> list[int]:
        """Of each piece of the rod of a piece: two stand at each hole, and between segments, of which one is left out."""
        slides = self.problem.graph.slides
        pieces = int(slides.pieces[piece])
        return nodes_of_pieces(node_count + (0 if slides.sliding[piece] else pieces - 1), pieces)

    def jumps(self) -> tuple[FloatArray, ...]:
        """As said; of a rod that slides none between nodes: two stand at each hole."""
        problem, graph = self.problem, self.problem.graph
        found = [np.zeros((problem.instance_count, 0))] * int(graph.first_tube[-1])
        with problem.everyone():
            problem.hand_over()
            for group in problem.groups:
                for tube, own in enumerate(group.backbones.shapes.jumps()):
                    for place, rod in enumerate(group.members.tolist()):
                        whole = int(graph.slides.owner[rod])
                        if len(graph.slides.of(whole)) == 1:
                            values = own.reshape(problem.instance_count, -1, own.shape[1])
                            found[graph.first_tube[whole] + tube] = values[:, place]
        return tuple(found)

    def of_springs(self, angles: list[FloatArray]) -> FloatArray:
        """Energy of the springs in the joints [J], shape (instance_count,)."""
        tables = [end.table for end in self.problem.graph.ends]
        parts = [0.5 * (t.stiffness * (a - t.rest) ** 2).sum(axis=(1, 2)) for t, a in zip(tables, angles, strict=True)]
        return np.asarray(parts[0] + parts[1] + self.of_holes())

    def of_holes(self) -> FloatArray:
        """(37) Energy of the springs at holes [J], shape (instance_count,)."""
        problem, slides = self.problem, self.problem.graph.slides
        stiffness, rest = slides.springs
        total, unknowns = np.zeros(problem.instance_count), problem.read("unknowns")
        given = problem.read("inputs")[:, problem.input_slice("translation")]
        for piece in np.flatnonzero(stiffness).tolist():
            L, pushed = problem.length[:, piece], given[:, problem.graph.first_tube[slides.owner[piece]]]
            place = slides.below[piece] * (slides.pieces[piece] * L + pushed)
            place += L**2 * unknowns[:, problem.first_hole + slides.upper[piece]]
            total += 0.5 * stiffness[piece] * (place - pushed - rest[piece]) ** 2
        return total


def _joined(parts: list[dict[str, FloatArray]], node_count: int, *, twice: bool) -> Shape:
    """The shape of a rod by those of its pieces; whether what is between two of them has ``twice`` a node."""
    if len(parts) == 1:
        return Shape(**parts[0])
    whole = np.cumsum([np.zeros_like(parts[0]["arclength"][:, 0]), *(part["arclength"][:, -1] for part in parts)], axis=0)
    for part, below in zip(parts, whole, strict=False):
        part["arclength"] = part["arclength"] + below[:, None]
    if not twice:
        parts[1:] = [{name: values[:, 1:] for name, values in part.items()} for part in parts[1:]]
    nodes = {name: np.concatenate([part[name] for part in parts], axis=1) for name in parts[0]}
    count = nodes["arclength"].shape[1]
    kept = slice(None) if count == node_count else np.linspace(0, count - 1, node_count).round().astype(int)
    return Shape(**{name: values[:, kept] for name, values in nodes.items()})


class NetworkLines(LinesOfGroups["NetworkProblem"]):
    """Of a ``NetworkProblem``: those of its rods."""

    def __init__(self, problem: "NetworkProblem") -> None:
        super().__init__(problem, problem.graph.drives)

    def hand_over(self) -> None:  # noqa: D102
        self.problem.hand_over()

    def length_columns(self, *names: str) -> FloatArray:
        """As said; a rod whose base turns is bent by what acts along it, and so its lines are longer."""
        problem, n, size = self.problem, self.problem.unknown_count, self.problem.layout.size
        element, counts = problem.networks.element.numpy(), [len(own) for own in self.drives]
        every = problem.columns_of(names)
        result = np.zeros((problem.instance_count, int(self.first[-1]), n + sum(columns.numbers for columns in every)))
        for group in problem.groups:
            weights = group.backbones.lines.weights().reshape(problem.instance_count, len(group.members), -1)
            for place, rod in enumerate(group.members.tolist()):
                lines = slice(self.first[rod], self.first[rod + 1])
                own = element[:, rod, size + records.MORE :][:, : counts[rod]] / weights[:, place, :, None]
                there = np.flatnonzero(problem.places[rod] >= 0)
                result[:, lines, problem.places[rod, there]] = own[..., there]
                result[:, lines, n:] = by_numbers(every, rod, own[..., size : size + problem.direction_count])
        return self._at_unknowns(names, result)

    def tension_columns(self, *names: str) -> FloatArray:
        """As said; neither bodies nor how a base turns touch what pulls a line."""
        problem = self.problem
        aim, n = problem.aim_of(names), problem.unknown_count
        numbers = sum(columns.numbers for columns in aim.every)
        result = np.zeros((problem.instance_count, int(self.first[-1]), n + numbers))
        still = np.zeros((problem.instance_count, 3, n + numbers))
        for group in problem.groups:
            if not group.backbones.drive_count:
                continue
            found = group.backbones.lines.tension_columns()
            found = found.reshape(problem.instance_count, len(group.members), *found.shape[1:])
            for place, rod in enumerate(group.members.tolist()):
                lines = slice(self.first[rod], self.first[rod + 1])
                result[:, lines] = by_network(problem, aim, group, place, found[:, place], still)
        return self._at_unknowns(names, result)

    def _at_unknowns(self, names: Sequence[str], columns: FloatArray) -> FloatArray:
        """(D9) of ``docs/derivatives.md``: columns, those by parameters at fixed unknowns."""
        at_rates(self.problem, self.problem.aim_of(names), columns[:, None])
        return columns
