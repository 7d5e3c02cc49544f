"""What a held rod offers of its rod: parts, shapes and lines."""

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from multirod.batch import IntArray
from multirod.capabilities import Lines, Shapes
from multirod.integrators import Integrator
from multirod.models.backbone.equal_steps import PartsAtEqualSteps
from multirod.models.held.along import by_own_unknowns
from multirod.problem import Shape
from multirod.segments import taken
from multirod.validation import FloatArray

if TYPE_CHECKING:
    from multirod.models.held.problem import HeldProblem


class HeldParts(PartsAtEqualSteps["HeldProblem"]):
    """Of a ``HeldProblem``."""

    def __init__(self, problem: "HeldProblem") -> None:
        super().__init__(problem, problem.integrator, [problem.rod])

    @property
    def may_be_clamped(self) -> bool:  # noqa: D102
        return self.problem.may_be_clamped

    def _part(self, instances: IntArray, integrator: Integrator, *, poses: bool, pieces: int = 1) -> "HeldProblem":
        whole = self.problem
        holders = whole.holders.take(whole.batch_shape, instances)
        options = {**whole.options, **({"pose_sensitivities": True} if poses else {})}
        inputs = whole.inputs_given.take(whole.batch_shape, instances)
        result = type(whole)(holders, inputs, integrator=integrator, pieces=pieces, **options)
        result.stop = whole.stop
        for name in ("inputs", "unknowns"):
            result.write(name, whole.read(name)[instances])
        for name in ("rest_position", "rest_turn", "opening", "direct"):
            getattr(result.table, name).assign(getattr(whole.table, name).numpy()[instances])
        result.breakpoints = taken(whole.breakpoints, instances)
        return result


class HeldShapes(Shapes):
    """Of a ``HeldProblem``."""

    def __init__(self, problem: "HeldProblem") -> None:
        self.problem = problem

    def at_nodes(self, node_count: int) -> tuple[tuple[Shape, ...], FloatArray]:  # noqa: D102
        self.problem.to_rod()
        return self.problem.rod.shapes.at_nodes(node_count)


class HeldLines(Lines):
    """Of a ``HeldProblem``."""

    def __init__(self, problem: "HeldProblem") -> None:
        self.problem = problem

    def _of_rod(self) -> Lines:
        self.problem.to_rod()
        return self.problem.rod.lines

    def length(self) -> FloatArray:  # noqa: D102
        return self._of_rod().length()

    def tension(self) -> FloatArray:  # noqa: D102
        return self._of_rod().tension()

    def slack(self) -> NDArray[np.bool_]:  # noqa: D102
        return self._of_rod().slack()

    def beyond(self) -> NDArray[np.bool_]:  # noqa: D102
        return self._of_rod().beyond()

    def left(self, node_count: int) -> FloatArray:  # noqa: D102
        return self._of_rod().left(node_count)

    def length_columns(self, *names: str) -> FloatArray:
        """As said."""
        return by_own_unknowns(self.problem, self._of_rod().length_columns(*names))
