"""How fast paths get on: where few steps of the integrator tell enough, and what creeps."""

from typing import Any

import numpy as np

from multirod.kernels.repeated_kernels import callable_from_kernels
from multirod.kernels.warp_types import Struct
from multirod.problem import FEW, BoundaryProblem
from multirod.status import BoolArray
from multirod.validation import FloatArray

COARSEST = 0.7  # turn of a rod in a step of the integrator [rad]: one of RK4 is off by a thousandth
CREEPING = 100  # steps to the full load, at the pace of the last, of what does
ROUNDED_OFF = 1e4  # times the tolerance, that no iteration from the base comes below but by chance


class Pace:
    """Integrations of a problem by few steps, which look at what lies on the way."""

    def __init__(self, problem: BoundaryProblem) -> None:
        self._problem = problem
        self._bound: tuple[Any, Struct | None] = (None, None)  # launches, and what calls them

    def may_be_brief(self) -> BoolArray | bool:
        """Where they tell enough, shape (instance_count,): several rods, of paths without kinks, that hardly turn in a step."""
        problem = self._problem
        if problem.coarse is None or not problem.may_jump or len(problem.kinks):
            return False
        if problem.instance_count <= FEW and self.calls() is None:
            return False
        return problem.coarse_turning() <= COARSEST

    def calls(self) -> Struct | None:
        """What a kernel calls for one; the same object as long as the launches are the same."""
        coarse = self._problem.coarse
        launches = None if coarse is None else coarse.recorded
        if launches is not self._bound[0]:
            self._bound = launches, callable_from_kernels(launches)
        return self._bound[1]


def creeping(
    level: FloatArray, step: FloatArray, size: FloatArray, growth: FloatArray, unknowns: FloatArray, tolerance: FloatArray
) -> BoolArray:
    """Which paths, at levels and with steps (k,), are so slow that rounding will end them: where the norm of ``Gamma``, ``size``,
    which is ``growth`` times what it was without load, will amplify that of the ``unknowns`` (k, n) far beyond the tolerance,
    (3) and (4) of ``docs/solvers.md``; shape (k,)."""
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        steps = np.fmin((1 - level) / step, -np.log(level) / np.log1p(step / level))
        full = size * growth ** (1 / np.sqrt(level) - 1)
        rounding = np.finfo(float).eps * full * np.abs(unknowns).max(axis=1)
    return np.asarray((level > 0) & (steps > CREEPING) & (rounding > ROUNDED_OFF * tolerance))
