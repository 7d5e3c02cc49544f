"""What acts on the legs and on the platform together, in numbers."""

from typing import TYPE_CHECKING

import numpy as np

from multirod.models.backbone.segments.cutting import advice, may_be_cut, needed
from multirod.models.platform.inputs import PLATFORM_INPUTS
from multirod.rod import DENSITY
from multirod.validation import FloatArray

if TYPE_CHECKING:
    from multirod.models.platform.problem import ParallelProblem

FORCES = [spec.name for spec in PLATFORM_INPUTS if spec.unit == "N"]


def load_scale(problem: "ParallelProblem") -> FloatArray:
    """As ``BoundaryProblem.load_scale``."""
    inputs = problem.read("inputs")
    length = np.broadcast_to(problem.length[:, -1], problem.instance_count)
    stiffness = np.broadcast_to(problem.stiffness[:, -1], problem.instance_count)
    weight = problem.geometry.mass * np.linalg.norm(inputs[:, problem.input_slice("gravity")], axis=1)
    total = weight * length**2 / stiffness
    for spec in PLATFORM_INPUTS:
        if spec.load is not None:
            total += np.linalg.norm(inputs[:, problem.input_slice(spec.name)], axis=1) * length**spec.power / stiffness
    for group in problem.groups:
        own = group.backbones.load_scale().reshape(problem.instance_count, -1)
        total += own.max(axis=1)
    return np.asarray(total)


def too_long(problem: "ParallelProblem", instance: int) -> str:
    """(42) of ``docs/networks.md``, of each leg: as ``BoundaryProblem.too_long``. What cuts them is a network of these."""
    if problem.inverse:
        return ""
    geometry, inputs = problem.geometry, problem.read("inputs")[instance]

    def size(name: str) -> float:
        return float(np.linalg.norm(inputs[problem.input_slice(name)]))

    row = instance % len(problem.length)  # one where none varies
    first = geometry.first_rod[:-1]
    length = problem.length[row, :-1] + inputs[problem.input_slice("translation")][first]
    densities = [arrays.material[instance % len(arrays.material), 0, 0, DENSITY] for arrays in geometry.arrays]
    weight = size("gravity") * (geometry.mass + length @ densities)
    pull = sum(map(size, FORCES)) + size("distributed_force") * length.sum() + weight
    growth = length * np.sqrt(pull / problem.stiffness[row, :-1])
    counts = {f"level 1 {k}": needed(growth[k]) for k, leg in enumerate(geometry.legs) if may_be_cut(leg.rods)}
    return advice({name: count for name, count in counts.items() if count > 1}, "leg", "mr.stacked(robot, segments={})")
