"""What a held rod offers of its rod: parts, shapes, lines, how far it reaches, and many starts."""

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from multirod.batch import IntArray
from multirod.capabilities import Lines, Shapes, Starts
from multirod.integrators import Integrator
from multirod.models.backbone.equal_steps import PartsAtEqualSteps
from multirod.models.backbone.starts import quasirandom
from multirod.models.held.along import at_rates, by_own_unknowns
from multirod.models.held.costless import straight_at_rest
from multirod.models.held.holders import HeldOptions
from multirod.models.held.start import BUCKLED
from multirod.models.joint_kernels import SPHERICAL
from multirod.out_of_reach import TAUT, Reach
from multirod.problem import Shape
from multirod.rod import RodArrays
from multirod.segments import taken
from multirod.validation import FloatArray

if TYPE_CHECKING:
    from multirod.models.held.problem import HeldProblem


STRAIGHT = 1e-6  # moments and forces across a rod, in EI/L and EI/L^2, by which nothing bends it
BEND, THRUST = 2 * np.pi, 8 * np.pi**2  # most of a start: in 1/L, as of a rod that turns once, and in EI/L^2
CROWDING = 1.5  # most equilibria are far inside the bounds


class HeldParts(PartsAtEqualSteps["HeldProblem"]):
    """Of a ``HeldProblem``."""

    def __init__(self, problem: "HeldProblem") -> None:
        super().__init__(problem, problem.integrator, [problem.rod])

    @property
    def may_be_clamped(self) -> bool:  # noqa: D102
        return self.problem.may_be_clamped

    @property
    def _arrays(self) -> Sequence[RodArrays]:
        return [self.problem.holders.arrays]

    def eased(self, instance: int) -> "HeldProblem | None":
        """None where an end is in a ball: there is no torque."""
        holders = self.problem.holders
        return None if SPHERICAL in (holders.joint, holders.base_joint) else super().eased(instance)

    def _part(
        self, instances: IntArray, integrator: Integrator, *, poses: bool, pieces: int = 1, eased: float = np.inf
    ) -> "HeldProblem":
        whole = self.problem
        holders = whole.holders.take(whole.batch_shape, instances)
        if eased < np.inf:
            holders = replace(holders, arrays=holders.arrays.eased(eased))
        options: HeldOptions = {**whole.options}
        if poses:
            options["pose_sensitivities"] = True
        inputs = whole.inputs_given.take(whole.batch_shape, instances)
        result = type(whole)(holders, inputs, integrator=integrator, pieces=pieces, **options)
        result.stop, result.side = whole.stop, whole.side
        for name in ("inputs", "unknowns"):
            result.write(name, whole.read(name)[instances])
        for name in ("rest_position", "rest_turn", "swing", "opening", "direct", "leading", "drawn", "ways", "held_at"):
            getattr(result.table, name).assign(getattr(whole.table, name).numpy()[instances])
        result._natural = None if whole._natural is None or eased < np.inf else whole._natural[instances]
        result.breakpoints = taken(whole.breakpoints, instances)
        return result


class HeldShapes(Shapes):
    """Of a ``HeldProblem``."""

    def __init__(self, problem: "HeldProblem") -> None:
        self.problem = problem

    def at_nodes(self, node_count: int) -> tuple[tuple[Shape, ...], FloatArray]:  # noqa: D102
        self.problem.to_rod()
        return self.problem.rod.shapes.at_nodes(node_count)

    def jumps(self) -> tuple[FloatArray, ...]:  # noqa: D102
        self.problem.to_rod()
        return self.problem.rod.shapes.jumps()


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
        return self._at_unknowns(names, self._of_rod().length_columns())

    def tension_columns(self, *names: str) -> FloatArray:  # noqa: D102
        return self._at_unknowns(names, self._of_rod().tension_columns())

    def _at_unknowns(self, names: Sequence[str], columns: FloatArray) -> FloatArray:
        columns = by_own_unknowns(self.problem, columns)
        at_rates(self.problem, names, columns[:, None])
        return columns


class HeldReach(Reach):
    """How far the ends of a ``HeldProblem`` may be apart."""

    def __init__(self, problem: "HeldProblem") -> None:
        self.problem = problem
        self.everyone = np.ones(problem.instance_count, dtype=bool)

    @property
    def is_known(self) -> bool:
        """Of a rod that neither stretches nor shears, whose length is all that its line can have."""
        return not self.problem.rod.features.shear

    @property
    def ends(self) -> bool:
        """Whether the rod is taut where it does, with any thrust: not where the end slides."""
        return self.is_known and self.problem.holders.slide is None

    def exceeded(self) -> NDArray[np.bool_]:
        """(17) As said."""
        return self._beyond(1 + TAUT)

    def used_up(self) -> NDArray[np.bool_]:  # noqa: D102
        return self._beyond(1 - TAUT)

    def _beyond(self, part: float) -> NDArray[np.bool_]:
        return np.asarray(self._apart() > part * self.problem.length_in_use()) if self.is_known else ~self.everyone

    def said(self, instance: int) -> str:  # noqa: D102
        length, apart = (values[instance] for values in (self.problem.length_in_use(), self._apart()))
        return f" (the rod reaches {length:.4g} m of {apart:.4g} m)"

    def attained(self) -> NDArray[np.bool_]:
        """``HeldProblem.taut``: where it is shorter by no more than what a rod begins buckled from, too."""
        return self._beyond(1 - BUCKLED) if self.ends else ~self.everyone

    def tells_nothing(self, unknowns: FloatArray) -> NDArray[np.bool_]:
        """``HeldProblem.tells_nothing``: straight at rest, and nothing bends it."""
        if not self.ends:
            return ~self.everyone
        across = np.delete(unknowns, [2, self.problem.rod.unknown_count - 1], axis=1)
        return np.asarray((np.abs(across).max(axis=1) * self.problem.length < STRAIGHT) & straight_at_rest(self.problem))

    def _apart(self) -> FloatArray:
        """(17) The ends' holders [m], but for what the end slides, shape (instance_count,)."""
        position, frame = self.problem.goal()
        away = position - np.broadcast_to(self.problem.rod.table.base_position.numpy(), position.shape)
        if (slide := self.problem.holders.slide) is not None:
            along = frame @ slide
            away = away - (away * along).sum(axis=1)[:, None] * along
        return np.asarray(np.linalg.norm(away, axis=1))


class HeldStarts(Starts):
    """Of a ``HeldProblem``; its ends close a loop, so equilibria need not come in pairs."""

    def __init__(self, problem: "HeldProblem") -> None:
        self.problem = problem

    @property
    def signs_add_up(self) -> bool:  # noqa: D102
        return False

    def guesses(self, count: int, first: int = 0) -> FloatArray:
        """Base moments and forces around those of the rod at rest."""
        problem, n = self.problem, self.problem.rod.unknown_count
        points = quasirandom(np.arange(first, first + count), 6)[:, None]
        points = np.sign(points) * np.abs(points) ** CROWDING
        bend = np.maximum(BEND, problem.turning_angle())[:, None]
        result = np.zeros((count, problem.instance_count, problem.unknown_count))
        result[..., :3] = points[..., :3] * bend / problem.length[:, None]
        result[..., n - 3 : n] = points[..., 3:] * THRUST / problem.length[:, None]
        return result
