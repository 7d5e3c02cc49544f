"""How legs that hold a platform vary along themselves. Numbers in parentheses are those of ``docs/derivatives.md``."""

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from multirod.models.backbone.derivatives.along import AlongPass, Told, along_member, of_member
from multirod.models.platform.derivatives.columns import input_columns
from multirod.models.platform.derivatives.designs import unknown_rates
from multirod.problem import PosesSensed
from multirod.validation import FloatArray

if TYPE_CHECKING:
    from multirod.models.platform.derivatives.columns import InputColumns
    from multirod.models.platform.legs import LegGroup
    from multirod.models.platform.problem import ParallelProblem


def refuse_inverse(problem: "ParallelProblem") -> None:
    """Where the translations of legs are unknown, sensors stay where they are on no leg."""
    if problem.inverse:
        raise NotImplementedError("the inverse problem does not take sensors along its rods")


def find_rod(problem: "ParallelProblem", rod: int) -> tuple["LegGroup", int, int]:
    """Of a rod, counted leg by leg: the legs built as its own is, where among them that is, and which of its rods it is."""
    first = problem.geometry.first_rod
    leg = int(np.searchsorted(first, rod, side="right")) - 1
    group = next(group for group in problem.groups if leg in group.members)
    return group, group.members.index(leg), rod - int(first[leg])


def columns_along(
    problem: "ParallelProblem", every: Sequence["InputColumns"], rod: int, places: FloatArray
) -> dict[str, FloatArray]:
    """(D20) What ``ParallelProblem.along`` returns; ``every`` is what the problem is aimed at."""
    group, place, own = find_rod(problem, rod)
    problem.to_legs()
    found = along_member(group.backbones, own, place, places)
    return of_robot(problem, every, group.members[place], found).columns


def of_robot(problem: "ParallelProblem", every: Sequence["InputColumns"], leg: int, found: Told) -> Told:
    """(D20) What is told along a leg, with columns by the robot's unknowns and numbers."""
    n = problem.unknown_count
    result = replace(found, columns={name: by_robot(problem, every, leg, values) for name, values in found.columns.items()})
    start = n
    for columns in every:
        if columns.name == "base":
            result.carry(slice(start + columns.shares[leg][0], start + sum(columns.shares[leg])))
        start += columns.numbers
    for values in result.columns.values():
        at_rates(problem, every, values)
    return result


def by_robot(problem: "ParallelProblem", every: Sequence["InputColumns"], leg: int, found: FloatArray) -> FloatArray:
    """(D20) Columns of a leg (instance_count, ..., m + k), as columns (..., n + numbers) by the robot's unknowns, then by each
    number that is named: neither the platform nor other legs touch it."""
    n, m = problem.unknown_count, problem.own[leg].stop - problem.own[leg].start
    result = np.zeros((*found.shape[:-1], n + sum(columns.numbers for columns in every)))
    result[..., problem.own[leg]] = found[..., :m]
    if problem.inverse:  # by the translation that is unknown
        result[..., problem.platform.start + leg] = found[..., m + problem.leg_direction_count]
    start = n
    for columns in every:
        if columns.on_legs:
            begin, size = columns.shares[0 if columns.shared else leg]
            result[..., start + begin : start + begin + size] = found[..., m + columns.start :][..., :size]
        start += columns.numbers
    return result


def at_rates(problem: "ParallelProblem", every: Sequence["InputColumns"], values: FloatArray) -> None:
    """(D9), (D18) In place: columns (..., 3, n + k) by numbers at fixed unknowns, not at what the unknowns stand for."""
    if not problem.eliminates and any(columns.is_parameter for columns in every):
        n = problem.unknown_count
        values[..., n:] -= values[..., :n] @ unknown_rates(problem, every)[:, None]


class LegSensing:
    """A ``ParallelProblem``'s integration that tells more, at some places along its legs: a ``Sensing``.

    Args:
        problem: The problem.
        places: Rising arclengths (count,); of a leg, those past its end are not.
    """

    def __init__(self, problem: "ParallelProblem", places: FloatArray) -> None:
        refuse_inverse(problem)
        self.problem = problem
        self._passes: list[AlongPass] = [group.backbones.derivatives.sensing(places) for group in problem.groups]

    def launch(self) -> None:
        """Integrate."""
        self.problem.integrate_by(self._passes)

    def curvature(self, names: Sequence[str], rod: int) -> tuple[FloatArray, FloatArray]:
        """Of the last launch, as ``Sensing`` says."""
        problem = self.problem
        group, place, own = find_rod(problem, rod)
        found = self._passes[problem.groups.index(group)].curvature(own)
        curvature, columns = (of_member(values, problem.instance_count, place) for values in found)
        every = input_columns(problem.geometry, names)
        columns = by_robot(problem, every, group.members[place], columns)
        at_rates(problem, every, columns)
        return curvature, columns

    def poses(self, names: Sequence[str], rod: int) -> PosesSensed:
        """Of the last launch, as ``Sensing`` says."""
        problem = self.problem
        group, place, own = find_rod(problem, rod)
        found = self._passes[problem.groups.index(group)].poses(own).of_member(problem.instance_count, place)
        base = np.broadcast_to(group.backbones.derivatives.base_position(), (group.backbones.instance_count, 3))
        told = of_robot(problem, input_columns(problem.geometry, names), group.members[place], found)
        return told.at(of_member(base, problem.instance_count, place))

    def wrench(self, names: Sequence[str], rod: int) -> tuple[FloatArray, FloatArray]:
        """Of the last launch, as ``Sensing`` says."""
        problem = self.problem
        group, place, _ = find_rod(problem, rod)
        found = self._passes[problem.groups.index(group)].wrenches().of_member(problem.instance_count, place)
        told = of_robot(problem, input_columns(problem.geometry, names), group.members[place], found)
        return told.arms["wrench"], told.columns["wrench"]
