"""Legs that are pulled, in pieces: where they are to be cut, and what the pieces say of the legs in one.

Numbers are those of ``docs/parallel.md``.
"""

from math import ceil
from typing import TYPE_CHECKING

import numpy as np

from multirod.models.backbone.segments.cutting import EACH, LONGEST, may_be_cut
from multirod.models.backbone.units import unit_stiffness
from multirod.problem import BoundaryProblem
from multirod.stand_in import StandIn
from multirod.validation import FloatArray

if TYPE_CHECKING:
    from multirod.models.platform.problem import ParallelProblem


def pieces_needed(problem: "ParallelProblem", instance: int, unknowns: FloatArray) -> list[int]:
    """(9c) Into how many pieces each leg of an instance is to be cut, by how hard it is pulled at unknowns (n,)."""
    length = problem.length[instance % len(problem.length), :-1]
    rows, first = problem.read("inputs"), problem.geometry.first_rod[:-1]
    used = length + rows[instance, problem.input_slice("translation")][first]
    pull = np.maximum(unknowns[[own.stop - 1 for own in problem.own]], 0.0)  # along the base, in curvature units
    growth = used * np.sqrt(pull / length)
    if growth.max() <= LONGEST:
        return [1] * len(growth)
    return [
        max(1, ceil(own / EACH)) if may_be_cut(leg.rods) else 1
        for own, leg in zip(growth.tolist(), problem.geometry.legs, strict=True)
    ]


class LegsInPieces(StandIn):
    """An instance of a robot as ``problem``, whose rods are its legs, in their order, and whose end effector its platform.

    Args:
        whole: The problem of the robot.
        instance: Of it.
        problem: Of one instance.
    """

    def __init__(self, whole: "ParallelProblem", instance: int, problem: BoundaryProblem) -> None:
        self._whole, self._instance, self.problem = whole, instance, problem
        problem.stop = whole.stop

    def unknowns(self) -> FloatArray:  # noqa: D102
        whole, row = self._whole, self._instance
        place = np.broadcast_to(self.problem.read("position"), (whole.instance_count, 3))
        turn = np.broadcast_to(self.problem.read("rotation").reshape(-1, 3, 3), (whole.instance_count, 3, 3))
        assert self.problem.shapes is not None  # of rods and bodies
        shapes, _ = self.problem.shapes.at_nodes(2)
        result = np.zeros(whole.unknown_count)
        result[whole.platform] = whole.pose_unknowns(place, turn)[row]
        scale = (whole.length / whole.stiffness)[row % max(len(whole.length), len(whole.stiffness)), :-1]
        for shape, own, arrays, by_force in zip(shapes, whole.own, whole.geometry.arrays, scale, strict=True):
            stiffness = unit_stiffness(arrays.material[row % len(arrays.material), 0, 0])
            bent = arrays.precurvature[row % len(arrays.precurvature), 0, 0, :3] + shape.moment[0, 0] / stiffness
            result[own] = np.concatenate([bent, shape.force[0, 0] * by_force])
        return result
