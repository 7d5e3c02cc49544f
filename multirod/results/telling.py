"""What samples of a loop tell by an integration of their own: problems that are made and aimed once."""

from collections.abc import Iterable, Sequence
from threading import Lock
from types import NoneType
from typing import TYPE_CHECKING, Any

import numpy as np

from multirod.assembly import Assembly
from multirod.inputs import Inputs
from multirod.integrators import Integrator
from multirod.problem import BoundaryProblem
from multirod.results.eliminating import Eliminated
from multirod.validation import FloatArray

if TYPE_CHECKING:
    from multirod.results.solution import Solution

MOST = 8  # lists of names, each of which has a problem


class Told:
    """Derivatives by some names, which a problem is aimed at.

    Args:
        problem: It ``eliminates``, and ``leaves_columns`` by these names.
        names: Inputs and parameters.
    """

    def __init__(self, problem: BoundaryProblem, names: tuple[str, ...]) -> None:
        self._problem, self._names, self._left = problem, names, Eliminated(problem)
        self._shape = problem.instance_count, problem.input_count
        problem.aim(*names)

    def at(self, unknowns: FloatArray, inputs: FloatArray) -> FloatArray | None:
        """At rows of unknowns and inputs; None where there are not as many as its own."""
        problem = self._problem
        if inputs.shape != self._shape:
            return None
        problem.write("inputs", inputs)
        problem.write("unknowns", problem.adopt(unknowns))
        problem.part_ends(self._names)
        problem.integrate()
        return self._left.find()[0]


class Telling:
    """Derivatives of the pose of a loop's samples that carry no columns by what is asked for; (D1) of ``docs/derivatives.md``.

    Args:
        robot: The robot.
        inputs: At the start of the loop.
        enabled: Inputs whose terms its samples may have.
        integrator, device: Of the loop.
    """

    def __init__(self, robot: Assembly, inputs: Inputs, enabled: Iterable[str], integrator: Integrator, device: str) -> None:
        self._robot, self._inputs, self._enabled = robot, inputs, frozenset(enabled)
        self._options: dict[str, Any] = {"integrator": integrator, "device": device, "pose_sensitivities": True}
        self._made: dict[tuple[str, ...], Told | None] = {}
        self._lock = Lock()

    def __reduce__(self) -> tuple[type[None], tuple[()]]:
        """A copy of a sample does without."""
        return NoneType, ()

    def derivative(self, names: tuple[str, ...], unknowns: FloatArray, inputs: FloatArray) -> FloatArray | None:
        """By these names, shape (instance_count, 6, k), of samples that have these rows; None where another way is needed, such
        as while another thread asks."""
        if not self._lock.acquire(False):
            return None
        try:
            if names not in self._made and len(self._made) < MOST:
                self._made[names] = self._make(names)
            told = self._made.get(names)
            return None if told is None else told.at(unknowns, inputs)
        finally:
            self._lock.release()

    def _make(self, names: tuple[str, ...]) -> "Told | None":
        robot = self._robot
        specs = {spec.name: spec for spec in robot.input_specs}
        if any(specs[name].dead_twin if name in specs else name not in robot.parameters for name in names):
            return None
        enabled = tuple(sorted({*self._enabled, *specs.keys() & set(names)}))
        problem = robot.problem(self._inputs, enabled=enabled, **self._options, **robot.input_directions(*names))
        problem.eliminates = True
        return Told(problem, names) if problem.may_be_kept and problem.leaves_columns(*names) else None


def told_by_loop(solution: "Solution[Any]", names: Sequence[object]) -> FloatArray | None:
    """Of a loop's sample, by the problem that the loop keeps for such questions, as ``Telling`` says; None where that does not
    do."""
    telling, fields = solution._scene.telling, solution._scene.fields
    known = tuple(name for name in names if isinstance(name, str))
    if telling is None or not known or len(known) < len(names) or solution._outcome.breakpoints:
        return None
    if solution._instances is not None:  # some of the loop's, or in another order: the problem is of all, in theirs
        return None
    unknowns, inputs = solution._records[:, fields["unknowns"]], solution._records[:, fields["inputs"]]
    if solution._failed.any():
        unknowns = np.where(solution._failed[:, None], 0.0, unknowns)
    return telling.derivative(known, unknowns, inputs)
