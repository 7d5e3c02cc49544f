"""How a held rod varies along itself. Numbers in parentheses are those of ``docs/derivatives.md``."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, TypeAlias

import numpy as np
from numpy.typing import NDArray

from multirod.launch import Launch
from multirod.models.backbone.derivatives.along import Told
from multirod.models.backbone.derivatives.designs import COMPONENTS
from multirod.models.backbone.passes.lane_pass import LanePass
from multirod.models.backbone.stability.clamps import ClampedBackbones
from multirod.problem import PosesSensed
from multirod.rotations import matrices
from multirod.validation import FloatArray

if TYPE_CHECKING:
    from multirod.models.held.problem import HeldProblem

Some: TypeAlias = slice | NDArray[np.intp]
# of one evaluation: what stands before the rod's, the rod's, what stands after it
Launches: TypeAlias = tuple[Launch, LanePass | ClampedBackbones, Launch]


def aim_at_numbers(problem: "HeldProblem", names: Sequence[str]) -> None:
    """Point directions of the rod along its own numbers, where some are named: it alone knows of these."""
    rod = problem.rod
    if rod.directions.shape[2] == rod.input_count:
        return
    rows, column = np.zeros(rod.directions.shape), 0
    for name in names:
        own = rod.derivatives.designs(name).rows() if name in COMPONENTS else problem.directions_by(name)
        if name in COMPONENTS:
            rows[:, column : column + own.shape[1], rod.input_count :] = own[..., rod.input_count :]
        column += own.shape[1]
    rod.directions.assign(rows)


def unknown_rates(problem: "HeldProblem", names: Sequence[str]) -> FloatArray | None:
    """(D19) What leaves moment and force at the base as they are, (instance, n, k); None where nothing need be."""
    if problem.eliminates or "bending_stiffness" not in names:
        return None
    parts, x, n = [], problem.read("unknowns"), problem.rod.unknown_count
    scaled = np.r_[0:3, n - 3 : n]
    for name in names:
        rates = np.zeros((problem.instance_count, problem.unknown_count, problem.directions_by(name).shape[1]))
        if name == "bending_stiffness":
            relative = problem.rod.derivatives.designs(name).largest() / problem.stiffness[:, None]
            rates[:, scaled] = -x[:, scaled, None] * relative[:, None]
        parts.append(rates)
    return np.concatenate(parts, axis=2)


def by_own_unknowns(problem: "HeldProblem", found: FloatArray) -> FloatArray:
    """Columns of the rod (instance_count, ..., m + k + turns), k along the directions that are named, as (..., n + k): by the
    unknowns of what is held, equation (6) of ``docs/held.md``, then by those directions."""
    tail, d, m = found.shape[1:-1], problem.direction_count, problem.rod.unknown_count
    found = found.reshape(len(found), -1, found.shape[-1])
    unit = problem.table.moment_unit.numpy()
    x, angle = problem.read("unknowns"), problem.read("inputs")[:, :1] * [0.0, 0.0, 1.0]
    turned = matrices(angle)
    by_moment, by_force = found[..., :3] * unit[:, None], found[..., m - 3 : m]
    along = found[..., m : m + d]
    for by, value in ((by_moment, x[:, :3] * problem.stiffness[:, None]), (by_force, x[:, m - 3 : m])):
        local = np.einsum("bji,bj->bi", turned, value)
        change = by[..., 0] * local[:, None, 1] - by[..., 1] * local[:, None, 0]
        along = along + change[..., None] * problem.directions.numpy()[:, None, :d, 0]
    by_moment = np.einsum("bij,blj->bli", turned, by_moment) * problem.stiffness[:, None, None]
    by_force = np.einsum("bij,blj->bli", turned, by_force)
    parts = [by_moment, found[..., 3 : m - 3], by_force, found[..., m + d :], along]
    return np.concatenate(parts, axis=-1).reshape(len(found), *tail, -1)


def columns_along(problem: "HeldProblem", names: Sequence[str], places: FloatArray) -> dict[str, FloatArray]:
    """(D20) What ``HeldProblem.along`` returns."""
    problem.to_rod()
    return of_held(problem, names, problem.rod.derivatives.along_itself(0, places)).columns


def of_held(problem: "HeldProblem", names: Sequence[str], found: Told) -> Told:
    """(D20) What is told along the rod, with columns by what is held."""
    first, axes = problem.rod.unknown_count + problem.direction_count, problem.turn_axes()
    found.turn(np.swapaxes(axes, 1, 2), slice(first, first + axes.shape[2]))
    result = replace(found, columns={name: by_own_unknowns(problem, values) for name, values in found.columns.items()})
    for values in result.columns.values():
        at_rates(problem, names, values)
    return result


def at_rates(problem: "HeldProblem", names: Sequence[str], values: FloatArray) -> None:
    """(D9) In place: columns (..., rows, n + k) by numbers at fixed unknowns, not at what the unknowns stand for."""
    rates, n = unknown_rates(problem, names), problem.unknown_count
    if rates is not None:
        values[..., n:] -= values[..., :n] @ rates[:, None]


class HeldSensing:
    """A ``HeldProblem``'s integration that tells more, at some places along its rod: a ``Sensing``.

    Args:
        problem: The problem.
        places: Rising arclengths (count,).
        launches: Of its own integration: what stands before the rod's, the rod's, what stands after it.
    """

    def __init__(self, problem: "HeldProblem", places: FloatArray, launches: Launches) -> None:
        self.problem = problem
        self._rod = problem.rod.derivatives.sensing(places)
        self._launches = (launches[0], self._rod, launches[2])

    def launch(self) -> None:
        """Integrate."""
        self.problem.rod.stop = self.problem.stop
        for launch in self._launches:
            launch.launch()

    def curvature(self, names: Sequence[str], rod: int) -> tuple[FloatArray, FloatArray]:
        """Of the last launch, as ``Sensing`` says; a turn of the base leaves it as it is."""
        problem = self.problem
        curvature, found = self._rod.curvature(0)
        columns = by_own_unknowns(problem, found)
        at_rates(problem, names, columns)
        return curvature, columns

    def poses(self, names: Sequence[str], rod: int) -> PosesSensed:
        """Of the last launch, as ``Sensing`` says."""
        problem = self.problem
        return of_held(problem, names, self._rod.poses(0)).at(problem.rod.derivatives.base_position())

    def wrench(self, names: Sequence[str], rod: int) -> tuple[FloatArray, FloatArray]:
        """Of the last launch, as ``Sensing`` says."""
        told = of_held(self.problem, names, self._rod.wrenches())
        return told.arms["wrench"], told.columns["wrench"]


@dataclass(frozen=True)
class Beginning:
    """(18) of ``docs/held.md``: where rods begin, and by what that varies.

    Attributes:
        states: At the base, shape (count, state_size).
        force: There, in units of its variation, in the frame of the base's holder, shape (count, 3).
        by_unknowns: Variation of the state, shape (count, d, n).
        by_directions: The same, shape (count, d, direction_count).
    """

    states: FloatArray
    force: FloatArray
    by_unknowns: FloatArray
    by_directions: FloatArray

    def follow(self, columns: FloatArray, places: Some) -> FloatArray:
        """Columns (count, row, d + direction_count) by a state at the base, then along directions, as by what it follows from:
        those of the unknowns stand at ``places``."""
        d = self.by_unknowns.shape[1]
        result = columns.copy()
        result[:, :, places] = columns[:, :, :d] @ self.by_unknowns
        result[:, :, d:] += columns[:, :, :d] @ self.by_directions
        return result

    def chosen(self, some: Some) -> "Beginning":
        """Of some of the rods."""
        return Beginning(self.states[some], self.force[some], self.by_unknowns[some], self.by_directions[some])
