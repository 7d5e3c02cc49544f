"""Equal steps along rods where branches end: step control takes a straight rod in a few long ones."""

from abc import abstractmethod
from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Generic, TypeVar

import numpy as np

from multirod.batch import IntArray
from multirod.capabilities import Parts
from multirod.integrators import AdaptiveIntegrator, FixedStepIntegrator, Integrator
from multirod.rod import RodArrays

if TYPE_CHECKING:
    from multirod.models.backbone.problem import BackboneProblem
    from multirod.problem import BoundaryProblem

P = TypeVar("P", bound="BoundaryProblem")

STEPS = 48  # of a rod
EASED = 1e3  # times as stiff in torsion as in bending, what is stiffer is taken for at first
PER_RADIAN = 20  # by which it is bent at rest, or of its waves
MOST_STEPS = 1024


def step_counts(backbones: "Iterable[BackboneProblem]", count: int) -> IntArray:
    """How many equal steps each of ``count`` instances needs, by its rod that is bent the most at rest, or has the shortest waves
    in a medium, shape (count,)."""
    every = [np.maximum(own.curvature_scale() * own.each(own.arrays.end[:, 0, -1]), own.sizes.waves()) for own in backbones]
    bent = np.max([own.reshape(count, -1).max(axis=1) for own in every], axis=0)
    return np.asarray(np.clip(np.ceil(PER_RADIAN * bent), STEPS, MOST_STEPS).astype(np.intp))


def at_equal_steps(integrator: Integrator, steps: int) -> Integrator | None:
    """The same method at so many equal steps; None where they are equal already.

    The error of long steps in ``Gamma`` moves where its modes vanish, by some thousandths between whole rods and their pieces.
    """
    own = integrator.in_double()
    if not (isinstance(own, AdaptiveIntegrator) and own.adaptive):
        return None
    return replace(own, steps=steps)


def split(instances: IntArray, kinds: IntArray) -> list[IntArray]:
    """Instances, (k,), by their kinds, (k,)."""
    return [instances[kinds == kind] for kind in np.unique(kinds)]


class PartsAtEqualSteps(Parts, Generic[P]):
    """Of a problem whose rods are held: its branches are followed at equal steps, in pieces between clamps too.

    Args:
        problem: Whose parts they are.
        integrator: Its own.
        backbones: Its rods.
    """

    def __init__(self, problem: P, integrator: Integrator, backbones: "Sequence[BackboneProblem]") -> None:
        self.problem, self._integrator, self._backbones = problem, integrator, backbones

    def _at_equal_steps(self, instances: IntArray, times: int = 1) -> Integrator | None:
        steps = int(step_counts(self._backbones, self.problem.instance_count)[instances].max())
        return at_equal_steps(self._integrator, times * steps)

    def _exact(self, instances: IntArray, times: int) -> Integrator:
        """By which branches are followed: that at equal steps, or their own in double precision."""
        own = self._integrator.in_double()
        if isinstance(own, AdaptiveIntegrator | FixedStepIntegrator) and own.steps is not None:
            return replace(own, steps=times * own.steps)
        return self._at_equal_steps(instances, times) or own

    def kinds(self, instances: IntArray) -> list[IntArray]:  # noqa: D102
        return split(instances, step_counts(self._backbones, self.problem.instance_count)[instances])

    def steps_followed(self, instances: IntArray) -> int:  # noqa: D102
        return (self._at_equal_steps(instances) or self._integrator).steps or 0

    @property
    @abstractmethod
    def _arrays(self) -> Sequence[RodArrays]:
        """The rods as kernels read them, batches that broadcast to that of the problem."""

    @abstractmethod
    def _part(self, instances: IntArray, integrator: Integrator, *, poses: bool, pieces: int = 1, eased: float = np.inf) -> P:
        """Of some instances, by another integrator, with rods in so many pieces, and at most so many times as stiff in torsion as
        in bending."""

    def eased(self, instance: int) -> P | None:  # noqa: D102
        one = np.array([instance])
        taken = [own.take(self.problem.batch_shape, one) for own in self._arrays]
        if not any(own.hardly_twists(EASED).any() for own in taken):
            return None
        return self._part(one, self._integrator, poses=False, eased=EASED)

    def of(self, instances: IntArray, *, double: bool = False, poses: bool = False) -> P:  # noqa: D102
        return self._part(instances, self._integrator.in_double() if double else self._integrator, poses=poses)

    @property
    def may_be_finer(self) -> bool:
        """Not to find again what is near a fold: that asks for ``Gamma`` whole, and for the equations that were asked for."""
        return False

    def finer(self, instances: IntArray, *, poses: bool = False) -> P | None:  # noqa: D102
        integrator = self._at_equal_steps(instances)
        return None if integrator is None else self._part(instances, integrator, poses=poses)

    def followed(self, instances: IntArray, times: int = 1) -> P:  # noqa: D102
        return self._part(instances, self._exact(instances, times), poses=True)

    def clamped(self, instances: IntArray, pieces: int, times: int = 1, clamping: int = 0) -> P:  # noqa: D102
        return self._part(instances, self._exact(instances, times), poses=True, pieces=pieces)
