"""Where directions by inputs and parameters point, of the robot and of its legs, and what they say of the residual."""

from collections.abc import Sequence
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from multirod.models.backbone.derivatives.designs import COMPONENTS, turned_loads
from multirod.models.platform import platform_kernels as kernels
from multirod.models.platform.derivatives.columns import InputColumns, input_columns
from multirod.models.platform.derivatives.designs import PARAMETERS, PLACES, Places, design_rows, unknown_rates
from multirod.models.platform.legs import LegGroup
from multirod.validation import FloatArray

if TYPE_CHECKING:
    from multirod.models.platform.problem import ParallelProblem

POSE = kernels.POSE


class Gathering:
    """Where columns by inputs are found among those of the directions, which legs share.

    Args:
        every: The inputs' columns.
        own: Unknowns of each leg.
        count: Unknowns of all.
        width: Directions.

    Attributes:
        every: The inputs' columns.
        places: Of each input among all columns.
        alone: Columns of what acts on one leg alone, as an index.
        law: Leg and direction of each of these.
    """

    def __init__(self, every: Sequence[InputColumns], own: Sequence[slice], count: int, width: int) -> None:
        self.every = every
        ends = np.cumsum([0, *(columns.numbers for columns in every)])
        self.places = [slice(a, b) for a, b in pairwise(ends.tolist())]
        self._count, self._total = count, int(ends[-1])
        legs, directions = np.full((2, self._total), -1)  # of each column, -1 of what legs share, and of what has none
        for columns, there in zip(every, self.places, strict=True):
            if columns.shared:
                directions[there] = np.arange(columns.own.start, columns.own.stop)
            elif columns.name != "platform":
                for leg, (first, size) in enumerate(columns.shares):
                    to = slice(there.start + first, there.start + first + size)
                    legs[to], directions[to] = leg, columns.start + np.arange(size)
        owner = np.full(count, -1)
        for leg, unknowns in enumerate(own):
            owner[unknowns] = leg
        told = (directions >= 0) & ((legs < 0) | (legs == owner[:, None]))
        self._into, self._source = np.flatnonzero(told), (np.arange(count)[:, None] * width + directions)[told]
        self.alone, self._shared = np.flatnonzero(legs >= 0), np.flatnonzero((legs < 0) & (directions >= 0))
        self.law, self._given = (legs[self.alone], directions[self.alone]), directions[self._shared]

    def slopes(self, found: FloatArray) -> FloatArray:
        """By inputs, shape (b, n, k), of those by directions, shape (b, n, width); without the platform's rows of single legs."""
        result = np.zeros((len(found), self._count * self._total))
        result[:, self._into] = found.reshape(len(found), -1)[:, self._source]
        return result.reshape(len(found), self._count, self._total)

    def moved(self, given: FloatArray) -> FloatArray:
        """The pose's columns by inputs, shape (b, 6, k), of those by directions; none of what acts on one leg alone."""
        result = np.zeros((len(given), POSE, self._total))
        result[:, :, self._shared] = given[:, :, self._given]
        return result


class Aim:
    """Of a ``ParallelProblem``.

    Attributes:
        followed: The names aimed at, where directions depend on inputs and unknowns: they are written at each integration.
    """

    def __init__(self, problem: "ParallelProblem") -> None:
        self.problem = problem
        self.followed: tuple[str, ...] = ()
        self._gatherings: dict[tuple[str, ...], Gathering] = {}

    def point(self, names: tuple[str, ...]) -> None:
        """What ``BoundaryProblem.aim`` says; what acts on one leg alone shares its column with the same of all other legs, and
        columns that touch legs come first. What depends on inputs and unknowns is found at each integration."""
        self.followed = names if "base" in names or any(name in COMPONENTS for name in names) else ()
        if not self.followed:
            self.write(names)

    def write(self, names: Sequence[str]) -> None:
        """The directions along these at the present inputs and unknowns."""
        directions = np.zeros(self.problem.directions.shape)
        every = input_columns(self.problem.geometry, names)
        for columns in every:
            if columns.name == "base":
                directions[:, columns.own] = turned_loads(self.problem, kernels.LEG_VECTORS)
            elif columns.name not in PARAMETERS:
                start = self.problem.input_slice(columns.name).start
                for first, count in columns.shares:
                    for k in range(count):
                        directions[:, columns.start + k, start + first + k] = 1.0
        for group in self.problem.groups:
            self._write_legs(group, [columns for columns in every if columns.name in COMPONENTS], directions)
        self.problem.directions.assign(directions)

    def _write_legs(self, group: LegGroup, every: Sequence[InputColumns], directions: FloatArray) -> None:
        """Along the legs' own numbers: in ``directions`` how they turn behind their plates, the rest to the legs themselves."""
        own = group.backbones
        width = own.directions.shape[2] - own.input_count
        if not width:
            return
        rows = np.zeros((self.problem.instance_count, len(group.members), *own.directions.shape[1:]))
        turned = own.input_slice("rotation")
        for columns in every:
            found = design_rows(self.problem, group, columns.name)
            there = slice(columns.start, columns.start + found.shape[2])
            rows[:, :, there, own.input_count :] = found[..., own.input_count :]
            for place, leg in enumerate(group.members):
                first = int(self.problem.geometry.first_rod[leg])
                directions[:, there, first : first + len(own.rods)] = found[:, place, :, turned]
        own.directions.assign(rows.reshape(own.directions.shape))

    def found(self, names: Sequence[str], found: FloatArray, given: FloatArray) -> tuple[FloatArray, FloatArray]:
        """What ``BoundaryProblem.aimed`` says, of what stands in its place; by parameters too, the unknowns fixed."""
        gathering = self._gathering(tuple(names))
        slopes, moved = gathering.slopes(found), gathering.moved(given)
        self._add_platform(gathering, slopes)
        for columns, there in zip(gathering.every, gathering.places, strict=True):
            if columns.name in PLACES:
                slopes[:, :, there] += Places(self.problem).slopes(columns.name)
        if not self.problem.eliminates and any(name in PARAMETERS for name in names):
            rates, n = unknown_rates(self.problem, gathering.every), self.problem.unknown_count
            slopes -= self.problem.read("gamma").reshape(-1, n, n) @ rates
            moved -= self.problem.pose_columns.numpy()[:, :, :n] @ rates
        return slopes, moved

    def _gathering(self, names: tuple[str, ...]) -> "Gathering":
        """Found once for these names."""
        if names not in self._gatherings:
            problem = self.problem
            every, width = input_columns(problem.geometry, names), problem.directions.shape[1]
            self._gatherings[names] = Gathering(every, problem.own, problem.unknown_count, width)
        return self._gatherings[names]

    def _add_platform(self, gathering: "Gathering", slopes: FloatArray) -> None:
        """(8) What the pull and twist of one leg alone do to the platform."""
        legs, directions = gathering.law
        if not len(legs):
            return
        problem, count = self.problem, self.problem.instance_count
        law = problem.robots.law.numpy().reshape(count, len(problem.geometry.legs), -1)[:, :, kernels.DIRECTIONS_AT :]
        pulls = law.reshape(count, law.shape[1], -1, POSE)[:, legs, directions]
        scale = np.ones((len(problem.length), 1, POSE))
        scale[:, 0, :3] = problem.length[:, -1:]
        slopes[:, problem.platform, gathering.alone] = np.swapaxes(pulls * (scale / problem.stiffness[:, -1:, None]), 1, 2)
