"""Where directions by inputs and parameters point, of the robot and of its legs, and what they say of the residual."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from multirod.models.backbone.derivatives.designs import COMPONENTS, turned_loads
from multirod.models.platform import platform_kernels as kernels
from multirod.models.platform.derivatives.columns import InputColumns, input_columns
from multirod.models.platform.derivatives.designs import PARAMETERS, Places, design_rows, unknown_rates
from multirod.models.platform.legs import LegGroup
from multirod.validation import FloatArray

if TYPE_CHECKING:
    from multirod.models.platform.problem import ParallelProblem

POSE = kernels.POSE


class Aim:
    """Of a ``ParallelProblem``.

    Attributes:
        followed: The names aimed at, where directions depend on inputs and unknowns: they are written at each integration.
    """

    def __init__(self, problem: "ParallelProblem") -> None:
        self.problem = problem
        self.followed: tuple[str, ...] = ()

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
        every = input_columns(self.problem.geometry, names)
        slopes = np.concatenate([self._slopes(columns, found) for columns in every], axis=2)
        moved = np.concatenate(
            [given[:, :, columns.own] if columns.shared else np.zeros((len(given), POSE, columns.numbers)) for columns in every],
            axis=2,
        )
        if not self.problem.eliminates and any(name in PARAMETERS for name in names):
            rates, n = unknown_rates(self.problem, every), self.problem.unknown_count
            slopes -= self.problem.read("gamma").reshape(-1, n, n) @ rates
            moved -= self.problem.pose_columns.numpy()[:, :, :n] @ rates
        return slopes, moved

    def _slopes(self, columns: "InputColumns", found: FloatArray) -> FloatArray:
        """Derivatives of the residual by each number of an input, shape (instance_count, n, numbers)."""
        if columns.shared:
            return found[:, :, columns.own]
        if columns.name == "platform":
            return Places(self.problem).slopes("platform")
        count, legs = self.problem.instance_count, len(self.problem.geometry.legs)
        law = (
            self.problem.robots.law.numpy().reshape(count, legs, -1)[:, :, kernels.DIRECTIONS_AT :].reshape(count, legs, -1, 2, 3)
        )
        # (8) of one leg's pull and twist on the platform
        scale = np.stack([self.problem.length[:, -1], np.ones(len(self.problem.length))], axis=1) / self.problem.stiffness[:, -1:]
        slopes = np.zeros((count, self.problem.unknown_count, columns.numbers))
        for leg, ((first, size), own) in enumerate(zip(columns.shares, self.problem.own, strict=True)):
            for k in range(size):
                slopes[:, own, first + k] = found[:, own, columns.start + k]
                slopes[:, self.problem.platform, first + k] = (scale[:, :, None] * law[:, leg, columns.start + k]).reshape(
                    count, POSE
                )
        return slopes + Places(self.problem).slopes("base") if columns.name == "base" else slopes
