"""What drives the lines of one backbone, and what comes of it."""

from abc import abstractmethod
from collections.abc import Callable, Sequence
from functools import cached_property
from typing import TYPE_CHECKING, Any, Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

from multirod.capabilities import Lines
from multirod.models.backbone.kernels.layout.members import CONDITION, columns_in_material, drive_places
from multirod.models.backbone.members.giving_way import least_stiffness
from multirod.models.backbone.members.line_kinds import Chamber
from multirod.models.backbone.members.lines import Line
from multirod.models.backbone.members.member import Member
from multirod.validation import FloatArray, frozen

if TYPE_CHECKING:
    from multirod.models.backbone.problem import BackboneProblem
    from multirod.models.network.problem import NetworkProblem
    from multirod.models.platform.problem import ParallelProblem

LEAST_LEFT = 1e-4  # of the stiffness of rods, below which no more nodes are asked for
SURE = 1e-3  # over the bending stiffness: more than what is not infinite makes of it, ``giving_way.RIGID``


class DrivenLines(Lines):
    """Of a ``BackboneProblem``: of all its members that are driven, in their order."""

    def __init__(self, problem: "BackboneProblem") -> None:
        self.problem = problem
        members = problem.features.members
        self.first = columns_in_material(members)
        # the rod that carries each
        self.rods = problem.features.member_rods or (0,) * len(members)
        first, material = self.first, problem.arrays.material
        # of each that is driven: its law, and its numbers by section (batch, section, number)
        self._driven: list[tuple[type[Member], FloatArray]] = [
            (kind, material[:, self.rods[k], :, first[k] : first[k + 1]])
            for k, kind in enumerate(members)
            if kind.drive is not None
        ]
        self._driven_rods = [rod for rod, kind in zip(self.rods, members, strict=True) if kind.drive is not None]

    def length(self) -> FloatArray:  # noqa: D102
        problem = self.problem
        result = np.array(problem.nodes.over(2).read("line_length"))
        if problem.breakpoints:
            found, _ = problem.cut.along_lines(problem.breakpoints, 2)
            for k in problem.breakpoints:
                result[k] = found[k]
        return result / self.weights()

    def length_columns(self, *names: str) -> FloatArray:
        """As said; by the directions that there are, whatever they are of."""
        return self._at_unknowns(names, self.problem.line_length_columns.numpy() / self.weights()[..., None])

    def tension_columns(self, *names: str) -> FloatArray:  # noqa: D102
        problem, n = self.problem, self.problem.unknown_count
        result = np.zeros((problem.instance_count, len(self._driven), n + problem.direction_count))
        drives = slice(problem.first_drive, problem.first_drive + problem.drive_count)
        along = problem.directions.numpy()[:, : problem.direction_count, drives][:, :, drive_places(problem.features.members)]
        result[:, :, n:] = np.swapaxes(along, 1, 2) * self.weights()[..., None]
        first = problem.slots.places["drives"].start
        for j, (k, unknown) in enumerate(self._conditions().items()):
            result[:, k, n:] = 0.0
            result[:, k, first + j] = np.where(self._driven[k][0].slackens & (unknown < 0), 0.0, self._units[k])
        return self._at_unknowns(names, result)

    def _at_unknowns(self, names: Sequence[str], columns: FloatArray) -> FloatArray:
        """(D9) Columns, those by parameters at fixed unknowns."""
        rates, n = self.problem.derivatives.unknown_rates(names), self.problem.unknown_count
        if rates is not None:
            columns = np.array(columns)
            columns[..., n:] -= columns[..., :n] @ rates
        return np.asarray(columns)

    def levers(self) -> list[FloatArray]:
        """Offsets at the start of each line that is driven by its length [m], (batch,)."""
        return [own[:, 0, -len(CONDITION)] for kind, own in self._driven if kind.conditioned]

    def tension(self) -> FloatArray:  # noqa: D102
        result = self._inputs() * self.weights() + 0.0  # what is not filled pulls with 0, not with -0
        rounding = self._rounding()
        for k, unknown in self._conditions().items():
            slackens = self._driven[k][0].slackens
            result[:, k] = self._units[k] * (positive_part(unknown, rounding) if slackens else unknown)
        return result

    def slack(self) -> NDArray[np.bool_]:  # noqa: D102
        result = np.zeros((self.problem.instance_count, len(self._driven)), dtype=bool)
        for k, unknown in self._conditions().items():
            result[:, k] = self._driven[k][0].slackens & (unknown < 0)
        return result

    def left(self, node_count: int) -> FloatArray:  # noqa: D102
        if not self.problem.features.friction:
            return super().left(node_count)
        several = len(self.problem.rods) > 1
        members = zip(self.problem.features.members, self.rods, strict=True)
        result = np.ones((self.problem.instance_count, len(self._driven), node_count))
        owner = np.array([rod for kind, rod in members if kind.drive is not None])
        for rod in sorted(set(self.rods)):  # each has its own nodes
            found = np.array(self.problem.nodes.over(node_count, rod=rod if several else None).read("node_left"))
            if self.problem.breakpoints:
                _, left = self.problem.cut.along_lines(self.problem.breakpoints, node_count)
                for k in self.problem.breakpoints:
                    found[k] = left[k]
            result[:, owner == rod] = np.moveaxis(found, 1, 2)[:, owner == rod]
        return result

    def beyond(self) -> NDArray[np.bool_]:
        """Where lines between discs together buckle the rod, (L11)."""
        pull = np.zeros((self.problem.instance_count, len(self.problem.rods)))
        tension, straight = self.tension(), np.zeros((1, len(self._driven)), dtype=bool)
        for k, (kind, own) in enumerate(self._driven):
            if issubclass(kind, Line) and not issubclass(kind, Chamber):
                spacing = own[..., list(kind.parameters).index("discs")].max(axis=1) * 24  # its square
                straight[:, k] = spacing.any()
                pull[:, self._driven_rods[k]] += tension[:, k] * self.problem.each(spacing)
        softest = self.problem.each(self.problem.arrays.material[..., :2].min(axis=(2, 3)))
        return np.asarray(straight & (pull >= np.pi**2 * softest)[:, self._driven_rods])

    def taut(self) -> NDArray[np.bool_]:
        """Which of the lines that are driven by their length are held by it, shape (instance_count, condition_count).

        All are, a little, on the way to the load, (L8b).
        """
        rounded = self._rounding() > 0
        held = [(unknown > 0) | rounded | (not self._driven[k][0].slackens) for k, unknown in self._conditions().items()]
        return np.stack(held, axis=1)

    def tension_rates(self) -> tuple[FloatArray, FloatArray]:
        """(L7), (L8b) Of each line that is driven by its length: bending stiffness of its rod [N m^2], which over its lever is
        the unit of its tension, and how its tension in that unit changes with its unknown, shapes (instance_count,
        condition_count)."""
        shape = (self.problem.instance_count, len(self._conditions()))
        stiffness, rate, mu = np.empty(shape), np.ones(shape), self._rounding()
        for row, (k, unknown) in enumerate(self._conditions().items()):
            stiffness[:, row] = self.problem.each(self.problem.arrays.material[:, self._driven_rods[k], 0, :2].max(axis=-1))
            if self._driven[k][0].slackens:
                size = np.sqrt(unknown**2 + mu**2)
                rate[:, row] = np.where(size > 0, (1 + unknown / np.where(size > 0, size, 1.0)) / 2, 0.0)
        return stiffness, rate

    def give(self) -> NDArray[np.bool_]:
        """Whether one that is driven by its length stretches, shape (instance_count,)."""
        return np.asarray(np.stack([self._compliance(k)[0] > 0 for k in self._conditions()]).any(axis=0))

    def _compliance(self, k: int) -> tuple[FloatArray, FloatArray]:
        """Of one that is driven by its length, and its natural length, shapes (instance_count,)."""
        compliance, natural = np.moveaxis(self.problem.each(self._driven[k][1][:, 0, 1 - len(CONDITION) :][:, :2]), -1, 0)
        return compliance, natural

    def stretch_energy(self, length: FloatArray) -> FloatArray:
        """What lines that are driven by their length store, less what their tensions would do if they were given [J], shape
        (instance_count,); ``length`` is that of each (instance_count, count)."""
        tension, total, mu = self.tension(), np.zeros(self.problem.instance_count), self._rounding()
        for k, unknown in self._conditions().items():
            compliance, natural = self._compliance(k)
            total += tension[:, k] * (compliance * tension[:, k] / 2 - length[:, k])
            if self._driven[k][0].slackens and mu.any():
                unit, lever = self._units[k], self.problem.each(self._lever(k))
                total += unit * (natural * lever + compliance * unit) * rounded_energy(unknown, mu)
        return total

    def _rounding(self) -> FloatArray:
        """(L8b) How far kinks are rounded on the way to the load [1/m], shape (instance_count,)."""
        left = np.maximum(1 - self.problem.load_factor.numpy(), 0.0)
        return np.asarray(left / self.problem.each(self.problem.arrays.end[:, 0, -1]))

    def load(self) -> FloatArray:
        """How large a moment what drives them makes [N m], or would, shape (instance_count,)."""
        return np.asarray(self.load_by_rod().sum(axis=1))

    def load_by_rod(self) -> FloatArray:
        """The same of each rod, shape (instance_count, n)."""
        problem, members, inputs = self.problem, self.problem.features.members, self._inputs()
        weights = np.abs(self.weights())
        by_rod, first, k = np.zeros((problem.instance_count, len(problem.rods))), 0, 0
        for rod, kind in zip(self.rods, members, strict=True):
            material, total = problem.arrays.material[:, rod], by_rod[:, rod]
            offsets = np.abs(self.terms(material)).sum(axis=2).max(axis=1)
            stiffness = material[:, :, :3].min(axis=(1, 2)) / problem.arrays.end[:, rod, -1]
            if kind.drive is not None:
                if kind.conditioned:
                    lever, _, _, excess, *_ = np.moveaxis(self._driven[k][1][:, 0, -len(CONDITION) :], -1, 0)
                    total += (np.abs(inputs[:, k]) + problem.each(np.abs(excess))) * problem.each(stiffness / lever)
                else:
                    lever = np.linalg.norm(offsets[:, first : first + len(kind.functions)], axis=1)
                    total += np.abs(inputs[:, k]) * weights[:, k] * problem.each(lever)
                k += 1
            first += len(kind.functions)
        return by_rod

    def stays_stiff(self) -> NDArray[np.bool_]:
        """Whether the sections of each rod resist every change of strain with their lines, (L4), shape (instance_count,); False
        where a member with another law need not."""
        problem, members = self.problem, self.problem.features.members
        count = problem.instance_count
        if all(kind.convex for kind in members):
            return np.ones(count, dtype=bool)
        if not all(kind.convex or issubclass(kind, Line) for kind in members):
            return np.zeros(count, dtype=bool)
        return np.asarray(np.all([least_stiffness(self, rod)[1] > 0 for rod in sorted(set(self.rods))], axis=0))

    def least_stiffness(self) -> FloatArray:
        """The least that a rod resists bending or twisting with where lines push, (7b) of docs/stability.md [N m^2], shape
        (instance_count,); that of the rods alone where sections give way, or members follow another law."""
        problem, members = self.problem, self.problem.features.members
        alone = np.asarray(problem.sizes.least_stiffness)
        if all(kind.convex for kind in members) or not all(kind.convex or issubclass(kind, Line) for kind in members):
            return alone
        left = np.min([least_stiffness(self, rod)[0] for rod in sorted(set(self.rods))], axis=0)
        return np.where(left > 0, np.clip(left, LEAST_LEFT * alone, alone), alone)

    def gives_way(self) -> NDArray[np.bool_]:
        """(L9b) Whether some section of the rod surely gives way to a change of strain with its lines, shape (instance_count,):
        then the equilibrium is no minimum of energy, whatever holds its ends. False of several rods, which hold each other."""
        problem, members = self.problem, self.problem.features.members
        count = problem.instance_count
        lines_alone = len(problem.rods) == 1 and all(issubclass(kind, Line) for kind in members)
        if all(kind.convex for kind in members) or not lines_alone:
            return np.zeros(count, dtype=bool)
        if any(
            "bending" in kind.parameters and own[..., list(kind.parameters).index("bending")].any() for kind, own in self._driven
        ):
            return np.zeros(count, dtype=bool)  # what a push rod resists by its bending is not counted
        return np.asarray(least_stiffness(self, 0)[1] < -SURE)

    def terms(self, material: FloatArray) -> FloatArray:
        """Coefficients of the functions of all members in rows (..., column) of the material, (..., degree + 1, function)."""
        count = sum(len(kind.functions) for kind in self.problem.features.members)
        return material[..., self.first[-1] :].reshape(*material.shape[:-1], -1, count)

    def _inputs(self) -> FloatArray:
        """What drives each, shape (instance_count, count)."""
        places = [self.problem.first_drive + place for place in drive_places(self.problem.features.members)]
        return np.asarray(self.problem.read("inputs")[:, places])

    def weights(self) -> FloatArray:
        """What the length of each is multiplied by in what its drive works on, shape (instance_count, count)."""
        return self._weights

    @cached_property
    def _weights(self) -> FloatArray:
        found = np.ones((self.problem.instance_count, len(self._driven)))
        for k, (kind, own) in enumerate(self._driven):
            if "weight" in kind.parameters:
                values = own[..., list(kind.parameters).index("weight")]
                largest = np.argmax(np.abs(values), axis=1)
                found[:, k] = self.problem.each(np.take_along_axis(values, largest[:, None], axis=1)[:, 0])
        return frozen(found)

    @cached_property
    def _conditioned(self) -> list[int]:
        """Those whose drive is unknown."""
        return [k for k, (kind, _) in enumerate(self._driven) if kind.conditioned]

    def _conditions(self) -> dict[int, FloatArray]:
        """Of these the unknowns [1/m], (instance_count,)."""
        unknowns = self.problem.read("unknowns")[:, self.problem.slots.places["drives"]]
        return {k: unknowns[:, row] for row, k in enumerate(self._conditioned)}

    def _lever(self, k: int) -> FloatArray:
        """Of one of these [m], (batch,)."""
        return np.asarray(self._driven[k][1][:, 0, -len(CONDITION)])

    @cached_property
    def _units(self) -> dict[int, FloatArray]:
        """(L7) Tension of each of these by its unknown [N m], (instance_count,)."""
        stiffness = self.problem.arrays.material[:, :, 0, :2].max(axis=-1)
        return {k: self.problem.each(stiffness[:, self._driven_rods[k]] / self._lever(k)) for k in self._conditioned}


def positive_part(z: FloatArray, mu: FloatArray) -> FloatArray:
    """(L8b) max(z, 0)"""
    if not mu.any():
        return np.maximum(z, 0.0)
    return np.asarray(np.where(mu > 0, (z + np.sqrt(z * z + mu * mu) - mu) / 2, np.maximum(z, 0.0)))


def rounded_energy(z: FloatArray, mu: FloatArray) -> FloatArray:
    """(L8b) The integral of the positive part over what is left of z, which is how far a line hangs loose: zero without
    rounding."""
    size, part = np.sqrt(z * z + mu * mu), positive_part(z, mu)
    turned = mu * mu * np.arcsinh(z / np.where(mu > 0, mu, 1.0))
    return np.where(mu > 0, (z * z + z * size + turned) / 4 - mu * z / 2 - part * part / 2, 0.0)


Grouped = TypeVar("Grouped", bound="ParallelProblem | NetworkProblem")


class LinesOfGroups(Lines, Generic[Grouped]):
    """Of a problem whose rods are backbones in groups of one build, each with ``members``, its rods, and ``backbones``."""

    def __init__(self, problem: Grouped, drives: Sequence[Sequence[str]]) -> None:
        self.problem, self.drives = problem, drives
        # the first line of each rod, and their number
        self.first: NDArray[np.intp] = np.cumsum([0, *map(len, drives)])

    @abstractmethod
    def hand_over(self) -> None:
        """Unknowns and inputs to the backbones, without an integration."""

    def _of_all(self, ask: Callable[[Lines], NDArray[Any]], *tail: int) -> FloatArray:
        self.hand_over()
        count = self.problem.instance_count
        result = np.zeros((count, int(self.first[-1]), *tail))
        for group in self.problem.groups:
            if group.backbones.drive_count:
                found = ask(group.backbones.lines)
                found = found.reshape(count, len(group.members), *found.shape[1:])
                for place, rod in enumerate(group.members):
                    result[:, self.first[rod] : self.first[rod + 1]] = found[:, place]
        return result

    def length(self) -> FloatArray:  # noqa: D102
        return self._of_all(lambda lines: lines.length())

    def tension(self) -> FloatArray:  # noqa: D102
        return self._of_all(lambda lines: lines.tension())

    def slack(self) -> NDArray[np.bool_]:  # noqa: D102
        return np.asarray(self._of_all(lambda lines: lines.slack()) != 0)

    def beyond(self) -> NDArray[np.bool_]:  # noqa: D102
        return np.asarray(self._of_all(lambda lines: lines.beyond()) != 0)

    def left(self, node_count: int) -> FloatArray:  # noqa: D102
        return self._of_all(lambda lines: lines.left(node_count), node_count)
