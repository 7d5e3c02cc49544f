"""How fast paths get on: where few steps of the integrator tell enough, and what creeps."""

from typing import Any

import numpy as np

from multirod.kernels.repeated_kernels import callable_from_kernels
from multirod.kernels.warp_types import Struct
from multirod.problem import FEW, BoundaryProblem
from multirod.status import BoolArray, IntArray, Status
from multirod.validation import FloatArray

COARSEST = 0.7  # turn of a rod in a step of the integrator [rad]: one of RK4 is off by a thousandth
CREEPING = 100  # steps to the full load, at the pace of the last, of what does
ROUNDS = 64  # integrations after each of which it is asked whether a rod creeps
MOST_STEPS = 32 * 65_536  # of the integrator for each rod, in all integrations of a way: one second
SINGLE_STEPS = 24 * 65_536  # of single rods under loads, beyond the end of a branch
SINGLE_SETTLING = 16 * 65_536  # of these, in which damped dynamics are to rest: those that come to it take 10^6 at most
PACED, TIMES = 100, 2.0  # steps, by the pace of the last of which a way is given up that would take so many times what is left
LONG = 1000  # steps of a way, of which that is asked: shorter ones are soon over
UNASKED = LONG - 1  # steps of the longest way of which it is not
RUNAWAY = 1e3  # times the curvature scale: where tensions grow without bound
ROUNDED_OFF = 1e4  # times the tolerance, that no iteration from the base comes below but by chance


class Pace:
    """Integrations of a problem by few steps, which look at what lies on the way, and what ends a way that takes too many."""

    def __init__(self, problem: BoundaryProblem) -> None:
        self._problem = problem
        self.begin()
        self._bound: tuple[Any, Struct | None] = (None, None)  # launches, and what calls them

    def begin(self) -> None:
        """Count anew."""
        count = self._problem.instance_count
        self._integrator_steps, self._steps = np.zeros((2, count), dtype=np.int64)
        self._levels = np.zeros(count)

    def ended(self, active: BoolArray, level: FloatArray, steps: IntArray, most: int) -> IntArray:
        """After each ``ROUNDS`` integrations, how those of the ``active`` end that have had their part of the integrator's steps,
        or after so many ``steps`` are at levels at which their pace would not do: statuses, (k,), ``NOT_RUN`` of the others."""
        self._integrator_steps += ROUNDS * np.where(active, self._problem.step_count.numpy(), 0)
        looked = active & (steps - self._steps >= PACED) & (most >= LONG)
        slow = looked & creeps(level, level - self._levels, steps - self._steps, most - steps)
        self._levels[looked], self._steps[looked] = level[looked], steps[looked]
        long = active & (self._integrator_steps > MOST_STEPS * len(self._problem.blocks))
        return np.where(long, int(Status.INTEGRATION_LIMIT), np.where(slow, int(Status.MAX_ITERATIONS), int(Status.NOT_RUN)))

    def may_be_brief(self) -> BoolArray | bool:
        """Where they tell enough, shape (instance_count,): several rods, of paths without kinks, that hardly turn in a step.

        Of one rod, Newton's method takes so few steps that those by few of the integrator's save none of the others.
        """
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


def creeps(level: FloatArray, gone: FloatArray, steps: IntArray, left: IntArray) -> BoolArray:
    """(18) of ``docs/branches.md``: whether a way that has ``gone`` so far in its last ``steps`` would take too many more."""
    return np.asarray(steps * (1 - level) > TIMES * left * gone)


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


def runaway(problem: BoundaryProblem, unknowns: FloatArray) -> BoolArray:
    """Where ``unknowns`` (k, n) with kinks say that lines cannot all be as short as they are to be, shape (k,)."""
    return np.asarray(np.abs(unknowns[:, problem.kinks]).max(axis=1) > RUNAWAY * problem.curvature_scale())
