"""What solvers that take exactly one integration a sample have in common."""

from abc import abstractmethod
from collections.abc import Callable
from typing import Any

import numpy as np
import warp as wp

from multirod.kernels.warp_types import Struct
from multirod.problem import BoundaryProblem
from multirod.solver import Outcome, Track, knows
from multirod.solvers.continuation.acceptance import same_branch
from multirod.status import BoolArray, Fault, IntArray, Status
from multirod.validation import FloatArray, frozen

HALVES = 20  # in which the rest of a ramp is left out: what ends of rods give way by is then below what rods do


def _level(iteration: int, ramp: int, halves: int) -> float:
    """The part of the loads that acts in a sample."""
    after = iteration + 1 - ramp  # samples after the last but one of the ramp
    if after < 0:
        return (iteration + 1) / ramp
    return 1.0 - 0.5 ** (after + 1) / ramp if after < halves else 1.0


class SampledTrack(Track):
    """One sample: integrate at the unknowns that the last sample led to, then update them for the next.

    ``state`` is the argument of the solver's kernel; of its arrays, ``following`` (instance_count, n), ``status`` and ``size``
    (instance_count,) are read here. A subclass makes it, calls ``_bind``, and implements ``_update``.
    """

    problem: BoundaryProblem
    state: Struct
    feed_forward: bool

    def _bind(self, problem: BoundaryProblem, state: Struct, feed_forward: bool, first: FloatArray) -> None:
        self.problem, self.state, self.feed_forward = problem, state, feed_forward
        self._previous: FloatArray | None = None
        self._change: FloatArray | None = None
        self._spans = (1.0, 1.0, 1.0)  # from the sample before the last to the last, to the next, to the one after it
        self._foreseen = np.ones(problem.input_count)
        for name in problem.measured:
            self._foreseen[problem.input_slice(name)] = 0.0
        self._ones: Any = frozen(np.ones(problem.instance_count, dtype=np.int32))  # all samples' outcomes share it
        self._host: tuple[Any, ...] | None = None
        self._directions: FloatArray | None = None
        if wp.get_device(problem.device).is_cpu:
            self._host = (state.following.numpy(), state.status.numpy(), state.size.numpy())
            self._directions = problem.directions.numpy()
        self.start(first)

    @abstractmethod
    def _update(self) -> None:
        """From an integration to ``following``, ``status`` and ``size``."""

    def _rates(self) -> FloatArray | None:
        """Closed-loop rates of the last sample [1/s], where the solver has such."""
        return None

    def _settled(self, tolerance: FloatArray) -> BoolArray:
        """Which instances are where they are to come to rest; bool, shape (instance_count,)."""
        return np.asarray(self.state.size.numpy() <= tolerance)

    def _rest(self, instances: BoolArray) -> IntArray | Status:
        """By which status some instances (bool, (instance_count,)) have come to rest."""
        return Status.CONVERGED

    def start(self, unknowns: FloatArray) -> None:
        """Take ``unknowns`` as those of the first sample, of instances whose row is not NaN."""
        known = knows(self.problem, unknowns)[:, None]
        self.state.following.assign(np.where(known, unknowns, self.state.following.numpy()))

    def pace(self, before: float, after: float) -> None:
        """How far the next sample is from the last, and from the one after it."""
        self._spans = (self._spans[1], before, after)

    def step(self) -> Outcome:
        """The next sample."""
        problem, state = self.problem, self.state
        if self._host is not None:
            problem.write("unknowns", self._host[0])
        else:
            wp.copy(problem.unknowns, state.following)
        if self.feed_forward:
            self._aim()
        problem.integrate()
        self._update()
        status, size = self._host[1:] if self._host else (state.status.numpy(), state.size.numpy())
        return Outcome(status.copy(), self._ones, self._ones, size.copy(), self._rates())

    def settle(
        self,
        *,
        tolerance: float | None,
        max_iterations: int,
        ramp: int,
        guess: FloatArray | None,
        level: FloatArray | float = 1.0,
        chosen: BoolArray | None = None,
        most_steps: IntArray | None = None,
        ends: Callable[[int], IntArray] | None = None,
    ) -> Outcome:
        """Take samples at fixed inputs until the residual is within ``tolerance``.

        Args:
            tolerance: Largest residual, max norm [1/m]; None is that of the problem.
            max_iterations: Samples allowed.
            ramp: Samples over which the loads are raised from zero, without a ``guess``, and what is left of them by halves where
                ends of rods give way until then; what comes near a fold then, or whose
                ``Gamma`` changes from one sample to the next as it does between two branches, may have left the natural branch:
                ``BRANCH_END``.
            guess: Unknowns to start from (instance_count, n).
            level: Part of the loads that acts in the end, of each instance (instance_count,) or of all.
            chosen: Which instances do, shape (instance_count,); all by default. The status of the others stays ``NOT_RUN``.
            most_steps: Of the integrator, that each may take in all, shape (instance_count,): ``INTEGRATION_LIMIT`` ends what has
                taken them. ``integrator_steps`` says how many it took.
            ends: Asked after each sample, by its number, for statuses with which instances end there, ``NOT_RUN`` of the others,
                shape (instance_count,).
        """
        problem, count = self.problem, self.problem.instance_count
        if guess is not None:
            self.start(guess)
            ramp = 1
        halves = HALVES if guess is None and problem.gives_way else 0
        limit = problem.tolerance(tolerance)
        outcome = Outcome.zeros(count)
        chosen = np.ones(count, dtype=bool) if chosen is None else chosen
        active = chosen.copy()
        strayed = np.zeros(count, dtype=bool)
        before: FloatArray | None = None
        self.integrator_steps = np.zeros(count, dtype=np.int64)
        for iteration in range(max_iterations):
            load = _level(iteration, ramp, halves)
            with problem.only(active), problem.at_load(load * level):
                self.step()
            outcome.integrations[active] += 1
            status = self.state.status.numpy()
            done = active & self._settled(limit) & (load == 1.0)
            outcome.status[done] = self._rest(done)
            ended = active & np.isin(status, [fault.status for fault in Fault])
            outcome.status[ended] = status[ended]
            outcome.status[active & (status == Status.EULER_LIMIT)] = Status.EULER_DIVERGED
            if most_steps is not None:
                self.integrator_steps[active] += problem.buffer("step_count")[active]
                over = active & (outcome.status == Status.NOT_RUN) & (self.integrator_steps > most_steps)
                outcome.status[over] = Status.INTEGRATION_LIMIT
            if ends is not None:
                outcome.status[:] = np.where(active & (outcome.status == Status.NOT_RUN), ends(iteration), outcome.status)
            if guess is None:
                gamma = problem.read("gamma").reshape(count, problem.unknown_count, -1)
                if before is not None:
                    strayed[active] |= ~same_branch(gamma[active], before[active])
                before = gamma
                outcome.status[active & (status == Status.NEAR_FOLD)] = Status.BRANCH_END
                outcome.status[done & strayed] = Status.BRANCH_END
            active = chosen & (outcome.status == Status.NOT_RUN)
            if not active.any():
                break
            if not active.all():
                self._hold(~active)  # what has ended stays where its residual was taken
        outcome.status[active] = Status.MAX_ITERATIONS
        outcome.iterations[:] = outcome.integrations
        return outcome

    def _hold(self, instances: BoolArray) -> None:
        """Keep the unknowns of some instances (bool, (instance_count,)) as they are in the next sample."""
        following = np.array(self.state.following.numpy())
        following[instances] = self.problem.read("unknowns")[instances]
        self.state.following.assign(following)

    def _aim(self) -> None:
        """Point the problem's direction along the change of the inputs expected by the next sample: (12) and (12b) of
        ``docs/observer.md``, from the last two.

        What is measured is expected to stay: the difference of two samples is mostly noise, and extrapolated it is noise doubled.
        """
        inputs = self.problem.read("inputs")
        if self._previous is not None:
            change = (inputs - self._previous) * self._foreseen
            behind, last, ahead = self._spans
            expected = ahead / last * change
            if self._change is not None:
                turn = (last + ahead) / (behind + last)
                expected = (1 + turn) * expected - turn * ahead / behind * self._change
            self._change = change
            if self._directions is not None:
                self._directions[:, 0] = expected
            else:
                self.problem.directions.assign(expected[:, None])
        self._previous = inputs
