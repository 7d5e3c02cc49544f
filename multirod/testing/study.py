"""What the checks of an assembly are done on, and how their numbers are compared."""

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from multirod.assembly import Assembly
from multirod.inputs import Inputs
from multirod.integrators import RK45, Integrator
from multirod.problem import BoundaryProblem
from multirod.results.solution import Solution
from multirod.running.simulation import solve
from multirod.solver import Solver
from multirod.solvers.shooting import Shooting
from multirod.validation import FloatArray

STEP = 1e-5  # of differences, in the sizes of what is varied
CLOSE = 1e-5  # of derivatives and their differences, of the largest in a matrix
ALIKE = 1e-12  # of an instance alone and in a batch, of the largest
INTEGRATED = 1e-7  # error of an integration with step control, of the curvature scale
TIGHT = 1e-10  # tolerance of solutions that are differentiated [1/m]


class Nonconformance(AssertionError):
    """An assembly breaks the contract; the message lists every check that failed, and by how much."""


@dataclass(frozen=True)
class Study:
    """What the checks work on.

    Attributes:
        robot: The assembly.
        inputs: Of one instance.
        names: The inputs that are varied.
        tip_rod: The rod that ends at the end effector; None where none does.
        solvers: By name.
    """

    robot: Assembly
    inputs: Inputs
    names: tuple[str, ...]
    tip_rod: int | None
    solvers: dict[str, Solver]

    @cached_property
    def integrator(self) -> Integrator:
        """At fixed steps, so that differences are of one discretisation; by the kernels of step control."""
        return RK45(steps=32)

    @cached_property
    def solution(self) -> Solution:
        """The equilibrium."""
        return self.solve(self.inputs).raise_if_failed()

    def solve(self, inputs: Inputs, guess: FloatArray | None = None) -> Solution:
        """With the integrator of the differences."""
        return solve(self.robot, inputs, solver=Shooting(tolerance=TIGHT, integrator=self.integrator), guess=guess)

    def problem(self, inputs: Inputs | None = None, **options: Any) -> BoundaryProblem:  # noqa: ANN401  (of the robot's own ``problem``)
        """A problem at these inputs, those of the study by default."""
        return self.robot.problem(self.inputs if inputs is None else inputs, integrator=self.integrator, **options)

    def repeated(self, count: int) -> Inputs:
        """The same inputs for several instances."""
        plain = list(self.inputs.arrays) or [self.robot.input_specs[0].name]
        values = {name: np.asarray(getattr(self.inputs, name)) for name in plain}
        return self.inputs.with_arrays({name: np.broadcast_to(v, (count, v.shape[-1])) for name, v in values.items()})

    def changed(self, name: str, changes: FloatArray) -> Inputs:
        """One input by changes of its components, (k, size): a batch."""
        plain = {given: getattr(self.inputs, given) for given in self.inputs.arrays}
        plain[name] = np.asarray(getattr(self.inputs, name)) + changes
        return self.robot.make_inputs(plain | dict(self.inputs.profiles))

    @cached_property
    def near(self) -> FloatArray:
        """Unknowns at and near the equilibrium, shape (3, n)."""
        scale = float(self.problem().curvature_scale()[0])
        aside = np.random.default_rng(0).standard_normal((3, self.solution.unknown_count))
        aside[0] = 0.0
        return np.asarray(self.solution.unknowns + 0.05 * scale * aside)


def same(what: str, given: object, expected: object, tolerance: float, floor: float = 0.0) -> None:
    """Refuse arrays that differ by more than a part of the largest, or than a floor."""
    given, expected = np.asarray(given, dtype=float), np.asarray(expected, dtype=float)
    if given.shape != expected.shape:
        raise Nonconformance(f"{what} has the shape {given.shape}, not {expected.shape}")
    if not given.size:
        return
    if not np.isfinite(given).all():
        raise Nonconformance(f"{what} is not finite")
    gap, allowed = np.abs(given - expected), max(tolerance * float(np.abs(expected).max()), floor)
    if not gap.max() <= allowed:
        place = np.unravel_index(int(gap.argmax()), gap.shape)
        index = ", ".join(str(int(k)) for k in place)
        raise Nonconformance(f"{what}[{index}] is {given[place]:.9g}, not {expected[place]:.9g} (allowed: {allowed:.1g})")


def shape(what: str, given: ArrayLike, expected: tuple[int, ...]) -> None:
    """Refuse an array of another shape."""
    if np.shape(given) != expected:
        raise Nonconformance(f"{what} has the shape {np.shape(given)}, not {expected}")
