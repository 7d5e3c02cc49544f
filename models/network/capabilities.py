"""What the boundary problem of a network offers beside its equations."""

from itertools import product
from typing import TYPE_CHECKING

import numpy as np

from multirod.batch import IntArray
from multirod.capabilities import Joints, Loading, Shapes, Starts, Together
from multirod.integrators import Integrator
from multirod.models.backbone.equal_steps import PartsAtEqualSteps
from multirod.models.backbone.inputs import LOADS
from multirod.models.backbone.members.driven import LinesOfGroups
from multirod.models.backbone.starts import APART
from multirod.models.network.elements import records
from multirod.models.network.elements.elements import GAP_AT
from multirod.models.network.elements.groups import ON_RODS
from multirod.models.platform.starting import crowded
from multirod.problem import Shape
from multirod.validation import FloatArray

if TYPE_CHECKING:
    from multirod.models.network.problem import NetworkProblem

CLOSING = 6  # steps of Newton's method by which a network is put together at once
WIDEST = 3.0  # times the first of them, that any may be
CONTRACTION = 0.3  # largest ratio of Newton's steps that put a network together at once, as of those on a branch
BENDING = 0.1  # L^3/EI by which rods give way along themselves where they are bent to first order


class NetworkParts(PartsAtEqualSteps["NetworkProblem"]):
    """Of a ``NetworkProblem``."""

    def __init__(self, problem: "NetworkProblem") -> None:
        super().__init__(problem, problem.integrator, [group.backbones for group in problem.groups])

    @property
    def may_be_clamped(self) -> bool:
        """Not where rods slide: how long pieces are would move their clamps."""
        return not self.problem.layout.holes and all(group.backbones.may_be_clamped for group in self.problem.groups)

    def _part(self, instances: IntArray, integrator: Integrator, *, poses: bool, pieces: int = 1) -> "NetworkProblem":
        whole = self.problem
        result = type(whole)(
            whole.graph.take(whole.batch_shape, instances),
            whole.end_effector,
            whole.inputs_given.take(whole.batch_shape, instances),
            integrator=integrator,
            pieces=pieces,
            **{**whole.options, **({"pose_sensitivities": True} if poses else {})},
        )
        result.stop = whole.stop
        for name in ("inputs", "unknowns"):
            result.write(name, whole.read(name)[instances])
        for name in ("opening", "soft", "loading", "shift"):
            getattr(result, name)[:] = getattr(whole, name)[instances]
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
                pieces = int(slides.pieces[group.members[0]])
                for nodes in {max(2, node_count // pieces), max(2, -(-node_count // pieces))}:
                    shapes, own = group.backbones.shapes.at_nodes(nodes)
                    for (place, rod), (tube, shape) in product(enumerate(group.members.tolist()), enumerate(shapes)):
                        values = {name: v.reshape(count, -1, *v.shape[1:])[:, place] for name, v in vars(shape).items()}
                        R = base.rotation[:, rod, None]
                        values["position"] = base.position[:, rod, None] + (R @ values["position"][..., None])[..., 0]
                        values["rotation"] = R @ values["rotation"]
                        found.setdefault((rod, tube), {})[nodes] = values
                energy += own.reshape(count, -1).sum(axis=1)
        tubes = [(rod, tube) for rod, whole in enumerate(problem.graph.whole) for tube in range(whole.rod_count)]
        return tuple(_joined([found[k, tube] for k in slides.of(rod)], node_count) for rod, tube in tubes), energy

    def of_springs(self, angles: list[FloatArray]) -> FloatArray:
        """Energy of the springs in the joints [J], shape (instance_count,)."""
        tables = [end.table for end in self.problem.graph.ends]
        parts = [0.5 * (t.stiffness * (a - t.rest) ** 2).sum(axis=(1, 2)) for t, a in zip(tables, angles, strict=True)]
        return np.asarray(parts[0] + parts[1])


def _joined(pieces: list[dict[int, dict[str, FloatArray]]], node_count: int) -> Shape:
    """The shape of a rod by those of its pieces, each at one or two counts of nodes: two nodes stand at each hole."""
    if len(pieces) == 1:
        return Shape(**pieces[0][node_count])
    fewest, most = min(pieces[0]), max(pieces[0])
    more = node_count - fewest * len(pieces)
    parts = [dict(own[most if k < more else fewest]) for k, own in enumerate(pieces)]
    whole = np.cumsum([np.zeros_like(parts[0]["arclength"][:, 0]), *(part["arclength"][:, -1] for part in parts)], axis=0)
    for part, below in zip(parts, whole, strict=False):
        part["arclength"] = part["arclength"] + below[:, None]
    kept = slice(None) if more >= 0 else np.linspace(0, fewest * len(pieces) - 1, node_count).round().astype(int)
    return Shape(**{name: np.concatenate([part[name] for part in parts], axis=1)[:, kept] for name in parts[0]})


class NetworkStarts(Starts):
    """Of a ``NetworkProblem``; closed loops, so equilibria need not come in pairs."""

    def __init__(self, problem: "NetworkProblem") -> None:
        self.problem = problem

    @property
    def signs_add_up(self) -> bool:  # noqa: D102
        return False

    def guesses(self, count: int, first: int = 0) -> FloatArray:
        """Poses of the bodies around those of the network taken apart, and rods bent there to first order."""
        problem = self.problem
        x = problem.apart().unknowns
        result = np.empty((count, *x.shape))
        for k, number in enumerate(range(first, first + count)):
            with problem.unloaded():
                numbers = np.full(len(x), number)
                result[k] = problem.twisted(self._bent(moved(problem, x, numbers)), numbers)
        return result

    def _bent(self, x: FloatArray) -> FloatArray:
        """Rods by the linear answer of their tips, which give way a little along themselves."""
        problem = self.problem
        residual, gamma = problem.evaluate(x)
        for rod in range(problem.rod_count):
            own = problem.places[rod, : problem.graph.own[rod]]
            answer = gamma[:, own[:, None], own]
            answer[:, GAP_AT.stop - 1, problem.graph.along[rod]] += BENDING
            sound = np.isfinite(answer).all(axis=(1, 2)) & (np.linalg.det(np.nan_to_num(answer)) != 0)
            x[np.ix_(sound, own)] -= np.linalg.solve(answer[sound], residual[np.ix_(sound, own)][..., None])[..., 0]
        return x


def moved(problem: "NetworkProblem", x: FloatArray, numbers: IntArray) -> FloatArray:
    """Unknowns with the bodies aside by the entries ``numbers``, (instance_count,), of an endless sequence, each its own way."""
    result = np.array(x)
    L = problem.length[:, problem.rod_count :, None]
    for body in range(problem.body_count):
        at = slice(problem.first_pose + 6 * body, problem.first_pose + 6 * body + 6)
        result[:, at] += np.where(numbers[:, None] == 0, 0.0, crowded(numbers + APART * body)) / L[:, body]
    return result


class NetworkJoints(Joints):
    """Of a ``NetworkProblem``: each tip is joined to its body, or leaves a gap there."""

    def __init__(self, problem: "NetworkProblem") -> None:
        self.problem = problem

    def apart(self, numbers: IntArray | None = None) -> FloatArray:
        """Rods at rest and bodies as near to their ends as they can be, or around there."""
        problem = self.problem
        x = np.array(problem.apart().unknowns)
        if numbers is None:
            return problem.guess()
        x = problem.twisted(moved(problem, x, np.asarray(numbers)), np.asarray(numbers))
        self.open(x)
        return x

    def open(self, unknowns: FloatArray) -> None:  # noqa: D102
        problem = self.problem
        self.shut()
        with problem.everyone(), problem.at_load(0.0):
            residual = problem.evaluate(unknowns)[0]
        problem.open_at(unknowns, residual)

    def together(self) -> Together:
        """(30) By Newton's method from the network taken apart, where its steps soon become much shorter."""
        problem = self.problem
        apart = problem.apart()
        step = problem.newton_step(apart.gamma, apart.residual)
        unknowns, residual = np.array(apart.unknowns), np.zeros_like(apart.residual)
        first = before = np.linalg.norm(step, axis=1)
        sound, on = np.zeros(problem.instance_count, dtype=bool), np.isfinite(before)
        integrations = np.full(problem.instance_count, problem.guess_integrations)
        with problem.unloaded(), np.errstate(all="ignore"):
            for _ in range(CLOSING):
                unknowns[on] += step[on]
                problem.write("unknowns", unknowns)
                with problem.only(on):
                    problem.integrate()
                found, faults = problem.read("residual"), problem.fault.numpy() != 0
                residual[on] = found[on]
                integrations += on
                step = problem.newton_step(problem.numbers(), found)
                size = np.linalg.norm(step, axis=1)
                sound |= on & ~faults & (size <= CONTRACTION * before)
                on &= ~faults & ~sound & (size <= WIDEST * first)
                before = size
                if not on.any():
                    break
        self.shut()
        problem.opening[:] = np.where(sound[:, None], residual, 0.0)
        return Together(unknowns, sound, integrations)

    def close(self, loading: Loading) -> None:  # noqa: D102
        self.problem.loading[:] = int(loading)

    def shut(self) -> None:  # noqa: D102
        problem = self.problem
        problem.opening[:], problem.soft[:], problem.shift[:] = 0.0, 0.0, 0.0

    def unloaded_inputs(self) -> FloatArray | None:  # noqa: D102
        rows = self.problem.read("inputs")
        for name in (*(spec.name for spec in LOADS), "force", "moment", *ON_RODS):
            if name in self.problem._slices:
                rows[:, self.problem.input_slice(name)] = 0.0
        return rows


class NetworkLines(LinesOfGroups):
    """Of a ``NetworkProblem``: those of its rods."""

    def __init__(self, problem: "NetworkProblem") -> None:
        super().__init__(problem, problem.graph.drives)

    def hand_over(self) -> None:  # noqa: D102
        self.problem.hand_over()

    def length_columns(self, *names: str) -> FloatArray:
        """As said; a rod whose base turns is bent by what acts along it, and so its lines are longer."""
        problem, n, size = self.problem, self.problem.unknown_count, self.problem.layout.size
        element, counts = problem.networks.element.numpy(), [len(own) for own in self.drives]
        columns = sum(problem.input_slice(name).stop - problem.input_slice(name).start for name in names)
        result = np.zeros((problem.instance_count, int(self.first[-1]), n + columns))
        for group in problem.groups:
            weights = group.backbones.lines.weights().reshape(problem.instance_count, len(group.members), -1)
            for place, rod in enumerate(group.members.tolist()):
                lines = slice(self.first[rod], self.first[rod + 1])
                own = element[:, rod, size + records.MORE :][:, : counts[rod]] / weights[:, place, :, None]
                there = np.flatnonzero(problem.places[rod] >= 0)
                result[:, lines, problem.places[rod, there]] = own[..., there]
                result[:, lines, n:] = own[..., size : size + columns]
        return result
