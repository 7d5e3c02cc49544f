"""What the residuals of legs on a platform do work on; ``docs/energy_descent.md``, equation (12)."""

from typing import TYPE_CHECKING, Any

import numpy as np
import warp as wp

from multirod.capabilities import Conjugates
from multirod.launch import record
from multirod.models.backbone.inputs import LOADS
from multirod.models.backbone.units import unit_stiffness
from multirod.models.joint_kernels import REVOLUTE, SPHERICAL
from multirod.models.platform.platform_kernels import POSE
from multirod.models.platform.stability.conjugate_kernels import LegPairs, find_leg_displacements, find_platform_displacements
from multirod.validation import FloatArray

if TYPE_CHECKING:
    from multirod.models.platform.problem import ParallelProblem

GIVE = 1e-8  # of ``L^3/EI``: what a leg's tip gives way by, so that straight ones that do not stretch are no exception
FREE = {REVOLUTE: 1, SPHERICAL: 3}  # how many ways of turning a joint leaves open


class PlatformConjugates(Conjugates):
    """Of a ``ParallelProblem`` whose platform is free: a tip's place, and what a joint does not let turn, are constraints."""

    def __init__(self, problem: "ParallelProblem") -> None:
        self.problem, device, count = problem, problem.device, problem.instance_count
        geometry = problem.geometry
        rows: list[int] = []
        units: list[FloatArray] = []
        give: list[tuple[int, int, float]] = []
        first = np.zeros(len(geometry.legs), dtype=np.int32)
        stiffness = np.broadcast_to(problem.stiffness, (count, len(geometry.legs) + 1))
        torques = {leg: group.backbones.features.torque_count for group in problem.groups for leg in group.members}
        conditions = {leg: group.backbones.features.condition_count for group in problem.groups for leg in group.members}
        for leg, own in enumerate(problem.own):
            free = FREE.get(int(geometry.joints[leg]), 0)
            first[leg] = len(rows)
            rows += range(own.start + POSE - free, own.start + POSE + torques[leg])
            units += [stiffness[:, leg]] * (free + torques[leg])
            give += [(own.start + k, own.stop - 3 + k, GIVE) for k in range(3)]
            assert own.stop - own.start == POSE + torques[leg] + conditions[leg]
        rows += range(problem.platform.start, problem.platform.stop)
        length = np.broadcast_to(problem.length[:, -1], count)
        units += [stiffness[:, -1] / length] * 3 + [stiffness[:, -1]] * 3
        self.forces, m = np.array(rows), len(rows)
        scale = np.ones((count, m))
        scale[:, m - POSE : m - 3] = length[:, None]
        self.unit: Any = wp.array(np.stack(units, axis=1), dtype=wp.float64, device=device)
        self.scale: Any = wp.array(scale, dtype=wp.float64, device=device)
        shape = (count, m, problem.unknown_count + problem.direction_count)
        self.columns: Any = wp.zeros(shape, dtype=wp.float64, device=device)
        self.stiffness = stiffness[:, -1] / len(geometry.legs) / length
        self.give = tuple(give)
        vectors = [spec.name for spec in LOADS if not spec.potential]
        self.without = tuple(k for name in vectors for k in range(problem.input_count)[problem.input_slice(name)])
        self.has_potential = all(group.backbones.has_potential for group in problem.groups)
        self._launches = []
        for group in problem.groups:
            own_rods = group.backbones
            pairs: Any = LegPairs()
            last = unit_stiffness(own_rods.arrays.material[:, :, -1, :3])[:, :, 2]
            pairs.first = wp.array(first[list(group.members)], dtype=wp.int32, device=device)
            pairs.angle_columns = own_rods.angle_columns
            pairs.end, pairs.stride = own_rods.table.end, own_rods.table.stride
            pairs.torques = own_rods.features.torque_count
            pairs.torsion = wp.array(np.ascontiguousarray(last), dtype=wp.float64, device=device)
            pairs.unit, pairs.columns = self.unit, self.columns
            arguments: list[Any] = [problem.robots, group.table, pairs]
            self._launches.append(record(find_leg_displacements, own_rods.instance_count, arguments, device))
        arguments = [problem.robots, self.columns]
        self._launches.append(record(find_platform_displacements, count, arguments, device))

    def update(self) -> None:  # noqa: D102
        for launch in self._launches:
            launch.launch()
