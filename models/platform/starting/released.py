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
LONGER = 0.5  # part of the way to its attachment, that a leg is longer at most


class ReleasedPlatforms(Released):
    """(10c) Of an inverse problem, with legs as long as straight to where platforms are to be.

    Args:
        problem: The inverse problem.
        instances: Of it, shape (k,).
        numbers: Of the lengths that legs are drawn at instead, (10d), from 1, shape (k,); 0 is as said.
    """

    problem: "ParallelProblem"

    def __init__(self, problem: "ParallelProblem", instances: IntArray, numbers: IntArray | None = None) -> None:
        self._held, self._instances = problem, instances
        at, options = (problem.batch_shape, instances), dict(problem.options)
        columns = options.pop("direction_count")
        given = problem.inputs_given
        inputs = given.with_arrays({name: a for name, a in given.arrays.items() if name not in POSE_VECTORS}, given.batch_shape)
        options |= {"inverse": False, "direction_count": columns, "leg_direction_count": columns + 1}  # legs have kernels alike
        self.problem = type(problem)(problem.geometry.take(*at), inputs.take(*at), integrator=problem.integrator, **options)
        self.problem.stop = problem.stop
        self._longer = straight_legs(problem)[instances]
        if numbers is not None:
            self._longer += self._drawn(numbers)
        rows, held = self.problem.read("inputs"), problem.read("inputs")[instances]
        for name, own in self.problem._places.items():
            rows[:, own] = held[:, problem.input_slice(name)]
        rows[:, self.problem.input_slice("translation")] += self.problem.length[:, :-1] ** 2 * self._longer
        self.problem.write("inputs", rows)

    def _drawn(self, numbers: IntArray) -> FloatArray:
        """(10d) by how much legs are longer than straight, within their limits, shape (k, leg)."""
        problem, rows = self._held, self._instances
        legs = problem.length.shape[1] - 1
        size = np.broadcast_to(problem.length[:, :-1], (problem.instance_count, legs))[rows]
        given = problem.read("inputs")[rows][:, problem.input_slice("translation")]
        straight = given + size**2 * self._longer
        drawn = np.stack([np.random.default_rng(k).uniform(size=legs) for k in range(int(numbers.max(initial=0)) + 1)])
        part = np.where(numbers[:, None] > 0, LONGER * drawn[numbers] ** 3, 0.0)
        wanted = straight + part * (size + straight)
        return np.asarray((np.clip(wanted, *problem.limits) - straight) / size**2)

    def _away(self) -> FloatArray:
        """From where platforms are to be: distances over the length of legs, and angles, shape (k,)."""
        (position, rotation), (asked, turned) = self.problem.pose(), (values[self._instances] for values in self._held.pose())
        length = np.broadcast_to(self.problem.length[:, -1], len(position))
        turn = vectors(rotation @ np.swapaxes(turned, 1, 2))
        return np.asarray(np.linalg.norm((position - asked) / length[:, None], axis=1) + np.linalg.norm(turn, axis=1))

    def held(self) -> tuple[FloatArray, FloatArray, FloatArray]:  # noqa: D102
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
        return inputs, unknowns, self._away()
