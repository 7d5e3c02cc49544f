"""A new assembly: a rod whose base turns about its axis on a torsional spring.

The rod's moment about that axis, ``M``, turns the base from ``alpha``, the input, to ``alpha + M / spring``. So the boundary
problem is that of a clamped rod at a base angle that depends on the unknowns, and all derivatives follow from those of the
clamped rod by the chain rule. ``WrappedProblem`` hands on what is the same; what differs is here.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, Self

import numpy as np

import multirod as mr
from multirod.batch import take
from multirod.capabilities import Conjugates
from multirod.segments import Cuts, Propagation, Segments
from multirod.stability import Modes, StabilityAnalysis
from multirod.wrapped import WrappedProblem, WrappedSegments

TWIST = 2  # the unknown that is the rod's curvature about its axis at the base


class SprungRod(mr.Assembly):
    """One rod on a torsional spring of stiffness ``spring`` [N m/rad]; inputs as for ``SingleRod``, ``rotation`` is ``alpha``."""

    def __init__(self, rod: mr.Rod, *, spring: float) -> None:
        self.clamped = mr.SingleRod(rod)
        self.rods = (rod,)
        self.spring = spring

    @property
    def input_specs(self) -> tuple[mr.InputSpec, ...]:
        return self.clamped.input_specs

    def check(self, inputs: mr.Inputs) -> None:
        self.clamped.check(inputs)

    def problem(
        self, inputs: mr.Inputs, *, direction_count: int = 0, instances: Any = None, enabled: Sequence[str] = (), **options: Any
    ) -> "SprungProblem":
        # one direction more, the last: along the base angle
        inner = self.clamped.problem(inputs, direction_count=direction_count + 1, instances=instances, enabled=enabled, **options)
        section = self.rods[0].sections[0]
        stiffness = np.minimum(section.torsional_stiffness, np.max(section.bending_stiffness, axis=-1))
        whole = np.broadcast_shapes(inputs.batch_shape, self.batch_shape)
        return SprungProblem(inner, take(stiffness, whole, instances, tail=0).reshape(-1), self.spring, direction_count)


class SprungProblem(WrappedProblem):
    """Unknowns and residual are the clamped rod's.

    Args:
        inner: The clamped rod.
        stiffness: Moment about the axis of one unit of that unknown [N m^2], shape (instance_count,): ``GJ``, or ``EI`` where
            that is less.
        spring: Stiffness [N m/rad].
        direction_count: Directions in input space, one less than those of ``inner``.
    """

    def __init__(self, inner: mr.BoundaryProblem, stiffness: np.ndarray, spring: float, direction_count: int) -> None:
        super().__init__(inner, direction_count=direction_count)
        self.stiffness, self.spring = stiffness, spring
        self.angle = inner.input_slice("rotation").start
        turn = np.zeros(inner.directions.shape)
        turn[:, -1, self.angle] = 1.0
        inner.directions.assign(turn)

    def around(self, inner: mr.BoundaryProblem, instances: np.ndarray) -> Self:
        return type(self)(inner, self.stiffness[instances], self.spring, self.direction_count)

    @property
    def give(self) -> np.ndarray:
        """How far the base turns by one unit of the unknown [rad m], shape (instance_count,)."""
        return self.stiffness / self.spring

    def torque(self, unknowns: np.ndarray) -> np.ndarray:
        """The rod's moment on the spring [N m], shape (instance_count,)."""
        return self.stiffness * (unknowns - self.inner.guess())[:, TWIST]

    def inner_inputs(self, unknowns: np.ndarray) -> np.ndarray:
        inputs = self.read("inputs")
        inputs[:, self.angle] += self.torque(unknowns) / self.spring
        return inputs

    def _corrected(self, gamma: np.ndarray, directions: np.ndarray, pose: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        gamma, columns = gamma.copy(), pose[:, :, : self.unknown_count].copy()
        gamma[:, :, TWIST] += self.give[:, None] * directions[:, :, -1]
        if self.pose_sensitivities:
            columns[:, :, TWIST] += self.give[:, None] * pose[:, :, -1]
        return gamma, columns

    def load_scale(self) -> np.ndarray:
        # the spring gives way as so much more rod would
        return super().load_scale() * (1 + self.give * self.curvature_scale())

    # ---- what a clamped rod offers too, but not the same ----

    @property
    def stability(self) -> "SprungStability":
        return SprungStability(self)

    @property
    def segments(self) -> "SprungSegments | None":
        return None if self.inner.segments is None else SprungSegments(self, self.inner.segments)

    @property
    def conjugates(self) -> Conjugates | None:
        """What the tip's moment works on is how the tip turns, the base's own turn included."""
        inner = self.inner.conjugates
        return None if inner is None else inner.seen_from(self)


class SprungStability(StabilityAnalysis):
    """The clamped rod's second variation, and one number more: how stiffly base and rod together resist being turned."""

    def __init__(self, problem: SprungProblem) -> None:
        self.problem = problem

    def _clamped(self) -> StabilityAnalysis:
        analysis = self.problem.inner.stability
        assert analysis is not None
        return analysis

    @property
    def has_potential(self) -> np.ndarray:
        with self.problem.presented():
            return self._clamped().has_potential

    def potential(self) -> np.ndarray:
        torque = self.problem.torque(self.problem.read("unknowns"))
        with self.problem.presented():
            return self._clamped().potential() + 0.5 * torque**2 / self.problem.spring

    def modes(self) -> Modes:
        problem = self.problem
        with problem.presented(), problem.inner.everyone():
            clamped = self._clamped().modes()
            problem.inner.integrate()
        # the Schur complement of the clamped rod's form: by Sylvester's law as many values are negative as of the whole form
        n = problem.unknown_count
        gamma = problem.inner.read("gamma").reshape(-1, n, n)
        by_angle = problem.inner.residual_directions.numpy()[:, :, -1]
        sound = np.isfinite(gamma).all(axis=(1, 2)) & (np.linalg.det(np.nan_to_num(gamma)) != 0)
        whole = np.full(len(gamma), np.nan)
        whole[sound] = 1 + problem.give[sound] * np.linalg.solve(gamma[sound], by_angle[sound, :, None])[:, TWIST, 0]
        known = clamped.known & sound
        known[list(problem.breakpoints)] = False
        unit = problem.stiffness * problem.curvature_scale()
        values = np.column_stack([clamped.values, np.where(known, whole * problem.spring / unit, np.nan)])
        uncertainty = np.column_stack([clamped.uncertainty, 0 * whole])
        order = np.argsort(values, axis=1)
        sort = [np.take_along_axis(array, order, axis=1) for array in (values, uncertainty)]
        # of loads without a potential nothing is said
        return Modes(sort[0], clamped.hidden, sort[1], known, np.zeros(len(whole), dtype=bool))


class SprungSegments(WrappedSegments):
    """The clamped rod's; the first begins at the base angle that belongs to the unknowns."""

    def __init__(self, problem: SprungProblem, inner: Segments) -> None:
        super().__init__(inner)
        self.problem = problem

    @property
    def direction_count(self) -> int:
        return self.problem.direction_count

    def _turn(self, instances: np.ndarray, unknowns: np.ndarray) -> None:
        everyone = self.problem.read("unknowns")
        everyone[instances] = unknowns
        self.problem.inner.write("inputs", self.problem.inner_inputs(everyone))

    def base_state(self, instances: np.ndarray, unknowns: np.ndarray) -> np.ndarray:
        self._turn(instances, unknowns)
        return self.inner.base_state(instances, unknowns)

    def propagate(self, cuts: Cuts, level: np.ndarray) -> Propagation:
        count = self.problem.direction_count
        directions = self.problem.inner.directions.numpy().copy()
        directions[:, :count] = self.problem.directions.numpy()[:, :count]
        self.problem.inner.directions.assign(directions)
        self._turn(cuts.instances, cuts.unknowns)
        return self._by_own_unknowns(cuts, self.inner.propagate(cuts, level))

    def _by_own_unknowns(self, cuts: Cuts, found: Propagation) -> Propagation:
        """What varies with the twist at the base varies with the base angle too; its direction, the last, is left out."""
        give = self.problem.give[cuts.instances]
        transition, residual, displacement = (
            np.array(columns) for columns in (found.transition, found.residual_columns, found.displacement_columns)
        )
        based = np.flatnonzero(cuts.start == 0.0)  # one of each instance, if any
        owner = cuts.owner[based]
        transition[based, :, TWIST] += give[owner, None] * transition[based, :, -1]
        displacement[based, :, TWIST] += give[owner, None] * displacement[based, :, -1]
        whole = owner[cuts.counts[owner] == 1]
        residual[whole, :, TWIST] += give[whole, None] * residual[whole, :, -1]
        return replace(
            found,
            transition=transition[..., :-1],
            residual_columns=residual[..., :-1],
            displacement_columns=displacement[..., :-1],
        )


def main() -> float:
    rod = mr.Rod(length=0.4, bending_stiffness=0.2233, torsional_stiffness=0.0638, precurvature=(14, 5, 0))
    robot = SprungRod(rod, spring=0.05)
    solution = mr.solve(robot, robot.inputs(tip_force=(0.3, 0.2, 0))).raise_if_failed()
    angle = solution.rod(0).moment[0, 2] / robot.spring
    clamped = mr.solve(robot.clamped, robot.clamped.inputs(rotation=angle, tip_force=(0.3, 0.2, 0)))
    error = float(np.linalg.norm(solution.tip_position - clamped.tip_position))
    print(f"the rod turns its spring by {angle:.4f} rad; the equilibrium is {solution.stability}")
    print(f"the clamped rod at that angle is {error:.1e} m away")
    return error


if __name__ == "__main__":
    main()
