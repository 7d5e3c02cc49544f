"""How bent legs that hold a platform are all along, and how that varies. Numbers in parentheses: ``docs/derivatives.md``."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from multirod.capabilities import Bending
from multirod.models.backbone.derivatives.bending import BackboneBending, may_tell_bending
from multirod.models.platform.derivatives.along import by_robot
from multirod.models.platform.derivatives.columns import input_columns
from multirod.validation import FloatArray

if TYPE_CHECKING:
    from multirod.models.platform.problem import ParallelProblem


class LegBending(Bending):
    """Of a ``ParallelProblem``, whose legs are the backbones."""

    def __init__(self, problem: "ParallelProblem", node_count: int) -> None:
        self._problem, self._nodes = problem, node_count
        self._groups = [(list(group.members), BackboneBending(group.backbones, node_count)) for group in problem.groups]

    def jumps(self) -> FloatArray:  # noqa: D102
        self._problem.to_legs()
        each = [(members, own.jumps()) for members, own in self._groups]
        result = np.full((len(self._problem.geometry.legs), max(own.shape[1] for _, own in each)), np.nan)
        for members, own in each:
            result[members, : own.shape[1]] = own
        return result

    def survey(self) -> tuple[FloatArray, FloatArray]:  # noqa: D102
        self._problem.to_legs()
        count = len(self._problem.geometry.legs)
        arclength, bent = np.empty((count, self._nodes)), np.empty((count, self._nodes, 2))
        for members, own in self._groups:
            arclength[members], bent[members] = own.survey()
        return arclength, bent

    def integrate(self, places: FloatArray) -> None:  # noqa: D102
        for members, own in self._groups:
            own.place(places[members])
        self._problem.heed_stop()
        self._problem.integrate_by([own for _, own in self._groups])

    def at_places(self, names: Sequence[str], backbone: int) -> tuple[FloatArray, FloatArray]:
        """As said, (D20)."""
        problem = self._problem
        members, bending = next(own for own in self._groups if backbone in own[0])
        bent, columns = bending.at_places(names, members.index(backbone))
        return bent, by_robot(problem, input_columns(problem.geometry, names), backbone, columns)


def may_tell_legs_bending(problem: "ParallelProblem") -> bool:
    """Whether columns along all legs are known, of one robot."""
    return (
        problem.instance_count == 1 and not problem.inverse and all(may_tell_bending(group.backbones) for group in problem.groups)
    )
