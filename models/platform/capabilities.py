"""What the boundary problem of a parallel robot offers beside its equations."""

from collections.abc import Callable, Sequence
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from multirod.batch import IntArray
from multirod.capabilities import Lines, Shapes
from multirod.integrators import Integrator
from multirod.models.backbone.equal_steps import PartsAtEqualSteps
from multirod.models.backbone.members.driven import LinesOfGroups
from multirod.models.platform.derivatives.along import at_rates, by_robot
from multirod.models.platform.derivatives.bending import LegBending, may_tell_legs_bending
from multirod.models.platform.derivatives.columns import input_columns
from multirod.problem import Shape
from multirod.rod import RodArrays
from multirod.validation import FloatArray

if TYPE_CHECKING:
    from multirod.models.platform.problem import ParallelProblem


class PlatformParts(PartsAtEqualSteps["ParallelProblem"]):
    """Of a ``ParallelProblem``."""

    def __init__(self, problem: "ParallelProblem") -> None:
        super().__init__(problem, problem.integrator, [group.backbones for group in problem.groups])

    @property
    def may_be_clamped(self) -> bool:  # noqa: D102
        return not self.problem.inverse and any(group.backbones.may_be_clamped for group in self.problem.groups)

    @property
    def clampings(self) -> int:  # noqa: D102
        return len(self._clampings)

    @cached_property
    def _clampings(self) -> list[set[int]]:
        """Legs that are clamped: single rods; then those of several rods too."""
        if self.problem.inverse:
            return []
        some = {leg for group in self.problem.groups if group.backbones.may_be_clamped for leg in group.members}
        every = {leg for group in self.problem.groups if group.backbones.parts.clampings for leg in group.members}
        return [legs for legs in ((some,) if every == some else (some, every)) if legs]

    @property
    def all_clamped(self) -> bool:  # noqa: D102
        return not self.problem.inverse and all(group.backbones.may_be_clamped for group in self.problem.groups)

    def clamped(  # noqa: D102
        self, instances: IntArray, pieces: int, times: int = 1, clamping: int = 0
    ) -> "ParallelProblem":
        return self._part(instances, self._exact(instances, times), poses=True, pieces=pieces, clamping=clamping)

    @property
    def _arrays(self) -> Sequence[RodArrays]:
        return self.problem.geometry.arrays

    def _part(
        self,
        instances: IntArray,
        integrator: Integrator,
        *,
        poses: bool,
        pieces: int = 1,
        eased: float = np.inf,
        clamping: int = 0,
    ) -> "ParallelProblem":
        geometry, inputs = (
            self.problem.geometry.take(self.problem.batch_shape, instances),
            self.problem.inputs_given.take(self.problem.batch_shape, instances),
        )
        if eased < np.inf:
            geometry = geometry.eased(eased)
        options = {**self.problem.options, **({"pose_sensitivities": True} if poses else {})}
        clamped = self._clampings[clamping] if pieces > 1 else set()
        cut = [pieces if leg in clamped else 1 for leg in range(len(geometry.legs))]
        result = type(self.problem)(geometry, inputs, integrator=integrator, pieces=cut, **options)
        result.stop = self.problem.stop
        result.stand_ins = None if self.problem.stand_ins is None else self.problem.stand_ins.of(instances)
        for name in ("inputs", "unknowns"):
            result.write(name, self.problem.read(name)[instances])
        for name in ("opening", "soft", "loading"):
            getattr(result.robots, name).assign(getattr(self.problem.robots, name).numpy()[instances])
        return result


class PlatformShapes(Shapes):
    """Of a ``ParallelProblem``: those of its legs."""

    def __init__(self, problem: "ParallelProblem") -> None:
        self.problem = problem

    def at_nodes(self, node_count: int) -> tuple[tuple[Shape, ...], FloatArray]:  # noqa: D102
        self.problem.to_legs()
        count = self.problem.instance_count
        found: list[Shape | None] = [None] * len(self.problem.geometry.rods)
        energy = np.zeros(count)
        for group in self.problem.groups:
            shapes, own = group.backbones.shapes.at_nodes(node_count)
            energy += own.reshape(count, -1).sum(axis=1)
            for i, shape in enumerate(shapes):
                for place, leg in enumerate(group.members):
                    values = {name: v.reshape(count, -1, *v.shape[1:])[:, place] for name, v in vars(shape).items()}
                    found[self.problem.geometry.first_rod[leg] + i] = Shape(**values)
        return tuple(shape for shape in found if shape is not None), energy

    def jumps(self) -> tuple[FloatArray, ...]:  # noqa: D102
        self.problem.to_legs()
        found = [np.zeros((0, 0))] * len(self.problem.geometry.rods)
        for group in self.problem.groups:
            for i, own in enumerate(group.backbones.shapes.jumps()):
                for place, leg in enumerate(group.members):
                    first = self.problem.geometry.first_rod[leg]
                    found[first + i] = own.reshape(self.problem.instance_count, -1, own.shape[1])[:, place]
        return tuple(found)

    def bending(self, node_count: int) -> LegBending | None:  # noqa: D102
        return LegBending(self.problem, node_count) if may_tell_legs_bending(self.problem) else None


class PlatformLines(LinesOfGroups["ParallelProblem"]):
    """Of a ``ParallelProblem``: those of its legs."""

    def __init__(self, problem: "ParallelProblem") -> None:
        super().__init__(problem, problem.geometry.drives)

    def hand_over(self) -> None:  # noqa: D102
        self.problem.to_legs()

    def length_columns(self, *names: str) -> FloatArray:
        """As said; of lines of legs, which touch neither the platform nor other legs."""
        return self._columns(names, lambda lines: lines.length_columns())

    def tension_columns(self, *names: str) -> FloatArray:  # noqa: D102
        return self._columns(names, lambda lines: lines.tension_columns())

    def _columns(self, names: Sequence[str], ask: Callable[[Lines], FloatArray]) -> FloatArray:
        """(D20) of ``docs/derivatives.md``: what ``ask`` gives of lines of legs of one build, by the robot's unknowns, then by
        each number that is named."""
        problem = self.problem
        every = input_columns(problem.geometry, names)
        numbers = sum(columns.numbers for columns in every)
        result = np.zeros((problem.instance_count, int(self.first[-1]), problem.unknown_count + numbers))
        for group in problem.groups:
            if not group.backbones.drive_count:
                continue
            found = ask(group.backbones.lines)
            found = found.reshape(problem.instance_count, len(group.members), *found.shape[1:])
            for place, leg in enumerate(group.members):
                result[:, self.first[leg] : self.first[leg + 1]] = by_robot(problem, every, leg, found[:, place])
        at_rates(problem, every, result[:, None])
        return result
