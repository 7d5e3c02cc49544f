"""Parts of a backbone problem: some of its instances, in double precision, finer, or between clamps."""

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from multirod.batch import IntArray, take
from multirod.capabilities import Parts
from multirod.integrators import AdaptiveIntegrator, Integrator
from multirod.models.backbone.equal_steps import PER_RADIAN, STEPS, at_equal_steps, split
from multirod.models.backbone.stability.clamps import moments_of_a_clamp
from multirod.segments import taken

if TYPE_CHECKING:
    from multirod.models.backbone.problem import BackboneProblem, ProblemOptions

FINEST = 1e-12  # relative tolerance of an integration to which rounding leaves its order


class BackboneParts(Parts):
    """Of a ``BackboneProblem``: finer by step control alone, which fixed steps and the finest tolerances have no use for."""

    def __init__(self, problem: "BackboneProblem") -> None:
        self.problem = problem

    def of(self, instances: IntArray, *, double: bool = False, poses: bool = False) -> "BackboneProblem":  # noqa: D102
        integrator = self.problem.integrator.in_double() if double else self.problem.integrator
        return self._part(instances, integrator, poses)

    @property
    def may_be_clamped(self) -> bool:  # noqa: D102
        return self.problem.may_be_clamped

    @property
    def clampings(self) -> int:  # noqa: D102
        return int(self.may_be_clamped or self._several_may_be)

    @property
    def loads_alone(self) -> NDArray[np.bool_]:
        """As said: of straight tubes."""
        return self._straight()

    @property
    def _several_may_be(self) -> bool:
        """Whether rods that turn against a frame can be clamped: not by lines of given length, nor where nothing is told of
        stability."""
        terms = self.problem.features
        unknown = terms.condition_count or terms.friction or self.problem.stability.place_unknown
        return terms.torque_count > 0 and not unknown

    def clamped(  # noqa: D102
        self, instances: IntArray, pieces: int, times: int = 1, clamping: int = 0
    ) -> "BackboneProblem":
        return self._part(instances, self._followed(instances, times) or self.problem.integrator.in_double(), True, pieces)

    def kinds(self, instances: IntArray) -> list[IntArray]:  # noqa: D102
        return split(instances, self._steps()[instances])

    def followed(self, instances: IntArray, times: int = 1) -> "BackboneProblem":  # noqa: D102
        return self._part(instances, self._followed(instances, times) or self.problem.integrator.in_double(), True)

    def steps_followed(self, instances: IntArray) -> int:  # noqa: D102
        return (self._followed(instances) or self.problem.integrator).steps or 0

    def _followed(self, instances: IntArray, times: int = 1) -> Integrator | None:
        """What is straight is not seen by step control, however fine it is, until it has buckled."""
        steps = int(self._steps()[instances].max())
        return at_equal_steps(self.problem.integrator, times * steps) if steps else self._finest()

    def _steps(self) -> NDArray[np.intp]:
        """Equal steps that instances are followed at, so many for each wave of a medium; 0 where step control will do, shape
        (instance_count,)."""
        waves = np.ceil(PER_RADIAN * self.problem.sizes.waves()).astype(np.intp)
        return np.where(self._straight(), np.maximum(STEPS, waves), 0)

    def _straight(self) -> NDArray[np.bool_]:
        """Which instances are rods that are all straight at rest, shape (instance_count,)."""
        problem, precurvature = self.problem, self.problem.arrays.precurvature
        straight = ~precurvature.any(axis=tuple(range(1, precurvature.ndim)))
        return np.broadcast_to(straight, problem.instance_count)

    def finer(self, instances: IntArray, *, poses: bool = False) -> "BackboneProblem | None":  # noqa: D102
        integrator = self._finest()
        return None if integrator is None else self._part(instances, integrator, poses)

    def _finest(self) -> Integrator | None:
        coarse = self.problem.integrator.in_double()
        if not isinstance(coarse, AdaptiveIntegrator) or not coarse.adaptive or coarse.rtol <= FINEST:
            return None
        return replace(coarse, rtol=FINEST, atol=min(coarse.atol, 0.01 * FINEST))

    def _part(self, instances: IntArray, integrator: Integrator, poses: bool, pieces: int = 1) -> "BackboneProblem":
        whole = self.problem
        shape = whole.batch_shape
        base = take(whole.base, shape, instances, tail=2) if whole.base.ndim > 2 else whole.base
        arrays, inputs = whole.arrays.take(shape, instances), whole.inputs_given.take(shape, instances)
        options: ProblemOptions = {}
        if poses:  # by the kernel that tells stability
            moments = moments_of_a_clamp(whole.features) * (pieces - 1)
            options = {"pose_sensitivities": True, "direction_count": moments, "pieces": pieces, "telling": True}
        result = whole.another(base, inputs, arrays, integrator, **options)
        result.stop = whole.stop
        result.judged_often = whole.judged_often
        # the tip as the solve found it is what a pass over nodes is held to
        for name in ("inputs", "unknowns", "position", "rotation"):
            result.write(name, whole.read(name)[instances])
        result.breakpoints = taken(whole.breakpoints, instances)
        return result
