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


def least_growth(problem: "ParallelProblem") -> FloatArray:
    """(44) of ``docs/networks.md``: as ``BoundaryProblem.least_growth``. Of legs that may be cut, as lines and media pull too."""
    geometry, count = problem.geometry, problem.instance_count
    if problem.inverse or not all(may_be_cut(leg.rods) for leg in geometry.legs) or any(own.loads for own in geometry.arrays):
        return np.zeros(count)
    inputs, first = problem.read("inputs"), geometry.first_rod[:-1]

    def force(name: str) -> FloatArray:
        return inputs[:, problem.input_slice(name)]

    def every(values: FloatArray) -> FloatArray:
        return np.broadcast_to(values, (count, *values.shape[1:]))

    length = every(problem.length[:, :-1]) + force("translation")[:, first]
    density = np.stack([every(own.material[:, 0, 0, DENSITY]) for own in geometry.arrays], axis=1)
    sizes = {name: np.linalg.norm(force(name), axis=1) for name in ("follower_force", "distributed_force", "gravity")}
    borne = np.linalg.norm(force("tip_force") + geometry.mass * force("gravity"), axis=1) - sizes["follower_force"]
    along = length * (sizes["distributed_force"][:, None] + density * sizes["gravity"][:, None])
    pull = np.maximum(borne[:, None] / len(geometry.legs) - along, 0.0)
    return np.asarray((length * np.sqrt(pull / every(problem.stiffness[:, :-1]))).min(axis=1))


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
