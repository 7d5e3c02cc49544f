"""Of the inverse problem: the robot whose platform nothing holds, and what its equilibria are to the inverse problem.

Numbers are those of ``docs/parallel.md``.
"""

from typing import TYPE_CHECKING

import numpy as np

from multirod.batch import IntArray
from multirod.capabilities import Released
from multirod.models.platform.platform_kernels import POSE_VECTORS
from multirod.models.platform.starting.guess import straight_legs
from multirod.rotations import vectors
from multirod.validation import FloatArray

if TYPE_CHECKING:
    from multirod.models.platform.problem import ParallelProblem

TURN = 2 * np.pi


class ReleasedPlatforms(Released):
    """(10c) Of an inverse problem, with legs as long as straight to where platforms are to be.

    Args:
        problem: The inverse problem.
        instances: Of it, shape (k,).
    """

    problem: "ParallelProblem"

    def __init__(self, problem: "ParallelProblem", instances: IntArray) -> None:
        self._held, self._instances = problem, instances
        at, options = (problem.batch_shape, instances), dict(problem.options)
        columns = options.pop("direction_count")
        given = problem.inputs_given
        inputs = given.with_arrays({name: a for name, a in given.arrays.items() if name not in POSE_VECTORS}, given.batch_shape)
        options |= {"inverse": False, "direction_count": columns, "leg_direction_count": columns + 1}  # legs have kernels alike
        self.problem = type(problem)(problem.geometry.take(*at), inputs.take(*at), integrator=problem.integrator, **options)
        self.problem.stop = problem.stop
        self._longer = straight_legs(problem)[instances]
        rows, held = self.problem.read("inputs"), problem.read("inputs")[instances]
        for name, own in self.problem._places.items():
            rows[:, own] = held[:, problem.input_slice(name)]
        rows[:, self.problem.input_slice("translation")] += self.problem.length[:, :-1] ** 2 * self._longer
        self.problem.write("inputs", rows)

    def held(self) -> tuple[FloatArray, FloatArray]:  # noqa: D102
        position, rotation = self.problem.pose()
        inputs, unknowns = self._held.read("inputs")[self._instances], self.problem.read("unknowns")
        asked = inputs[:, self._held.input_slice("platform_rotation")]
        turned = np.asarray(vectors(rotation))
        # the same rotation by another vector, if that is nearer to the one asked for
        angle = np.maximum(np.linalg.norm(turned, axis=1, keepdims=True), 1e-300)
        turned = turned + TURN * np.round(((asked - turned) * turned).sum(axis=1, keepdims=True) / angle / TURN) * turned / angle
        inputs[:, self._held.input_slice("platform_position")] = position
        inputs[:, self._held.input_slice("platform_rotation")] = turned
        unknowns[:, self._held.platform] = self._longer
        return inputs, unknowns
