"""Newton's iteration on the buffers of one problem, many instances in each launch."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cached_property, partial
from typing import Any

import numpy as np
import warp as wp

from multirod.kernels.repeated_kernels import Calls, callable_from_kernels
from multirod.kernels.warp_types import Array, Struct
from multirod.launch import Launch, expect, record
from multirod.problem import DOUBLE_ROUNDING, FEW, BoundaryProblem
from multirod.solver import Outcome
from multirod.solvers.newton.bordered_kernels import front_width
from multirod.solvers.newton.eliminated import Eliminated
from multirod.solvers.newton.newton_kernels import CHANGE_POWERS, LARGE_CHANGE, PROBES, NewtonState, Sample, make_newton
from multirod.solvers.newton.rounds import Rounds
from multirod.status import CONVERGED, BoolArray, IntArray
from multirod.validation import FloatArray

COUNTERS = ("status", "iterations", "integrations")
MEASURES = ("merit", "contraction", "change")
_UNBEGUN = np.array([[-1.0], [0.0], [0.0]])  # measures where an iteration has not begun

LARGEST_NOISE = 1e-4  # in steps of Newton's method, relative: a longer one says how the iteration contracts
UNLIMITED = 2**31 - 1
ROUNDS = 64  # integrations in one launch, of few instances: who stops a batch waits no longer than that
UNSLOWED = 1e300  # contraction that is never
SLOW = 0.1  # contraction of a sample's Newton steps, from which what has several equilibria unloaded may have left its branch
FEWER = 0.7  # of the instances that launches pass over, below which those that have ended leave


@contextmanager
def narrowing(problem: BoundaryProblem) -> Iterator[Callable[[int], None]]:
    """Within it, launches pass over all instances at first, and over the active ones alone, where that saves time, once what it
    yields is told how many of them are left."""
    with problem.focused() as focus:

        def narrow(remaining: int) -> None:
            if 0 < remaining < FEWER * problem.listed:
                focus(np.flatnonzero(problem.active.numpy()))

        yield narrow


class Newton:
    """Newton's iteration on the buffers of one problem; launches are recorded once.

    Args:
        problem: The problem.
        tolerance: Largest residual [1/m]; None is the problem's own.
        max_iterations: Iterations allowed.
        line_search: Whether steps that do not reduce the residual are halved.
    """

    def __init__(self, problem: BoundaryProblem, *, tolerance: float | None, max_iterations: int, line_search: bool) -> None:
        self.problem = problem
        n, count, device = problem.unknown_count, problem.instance_count, problem.device
        self._on_cpu = on_cpu = wp.get_device(device).is_cpu
        state: Struct = NewtonState()
        self.state = state
        self._rooms: list[Any] = []
        problem.share(state, ("order", "active", "fault", "step_count", "unknowns", "residual"))
        self._counters = wp.zeros((len(COUNTERS), count), dtype=wp.int32, device=device)
        self._measures = wp.zeros((len(MEASURES), count), dtype=wp.float64, device=device)
        for k, name in enumerate(COUNTERS):
            setattr(state, name, self._counters[k])
        for k, name in enumerate(MEASURES):
            setattr(state, name, self._measures[k])
        state.has_reference = wp.zeros(count, dtype=wp.int32, device=device)
        state.damping = wp.zeros(count, dtype=wp.float64, device=device)
        state.first_steps = wp.zeros(count, dtype=wp.int32, device=device)
        state.hopeless = wp.full(1, UNSLOWED, dtype=wp.float64, device=device)
        state.accepted = wp.zeros((count, n), dtype=wp.float64, device=device)
        state.step = wp.zeros((count, n), dtype=wp.float64, device=device)
        self.eliminated: Eliminated | None = None
        if problem.elimination is not None:
            self.eliminated = Eliminated(problem, problem.elimination, problem.tolerance(tolerance))
            for name in ("gamma", "direction", "told"):
                setattr(state, name, getattr(self.eliminated, name))
        else:
            state.gamma, state.direction = problem.gamma, self._room(n, 1)
        state.reference = wp.zeros(state.gamma.shape, dtype=wp.float64, device=device)
        self.shape = self._shape()
        self._repeats = on_cpu and count <= FEW and self.eliminated is None
        self._bound: tuple[Any, ...] | None = None  # launches that ``_calls`` calls
        self._calls: Any = None
        self._loop: Any = None
        self._first_values: Any = None
        state.remaining = wp.zeros(1, dtype=wp.int32, device=device)
        self._given_tolerance = tolerance
        state.tolerance = wp.array(problem.tolerance(tolerance), dtype=wp.float64, device=device)
        state.allowed = wp.full(count, UNLIMITED, dtype=wp.int32, device=device)
        state.rounding = problem.rounding / DOUBLE_ROUNDING
        state.noise = min(1e-10 * state.rounding, LARGEST_NOISE)
        state.max_iterations = max_iterations
        state.line_search = int(line_search)
        self.slow = SLOW if problem.may_jump else LARGE_CHANGE
        self._rounds = Rounds(problem, state.remaining)
        self._remaining = self._rounds.remaining
        self._starting = (self._counters.numpy(), self._measures.numpy(), problem.active.numpy()) if on_cpu else None
        self._counts = list(self._counters.numpy()) if on_cpu else None
        self._doubts = (state.change.numpy(), state.contraction.numpy()) if on_cpu else None
        self._reference = state.reference.numpy().reshape(count, -1) if on_cpu else None
        self._has_reference = state.has_reference.numpy() if on_cpu else None
        self._allowed = state.allowed.numpy() if on_cpu else None
        self._tolerance = state.tolerance.numpy() if on_cpu else None
        self._hopeless = state.hopeless.numpy() if on_cpu else None
        self.paths: Any = None  # of ``continuation.natural``, kept for the next

    def renew(self) -> None:
        """As new, on the CPU: what an earlier solve left decides nothing."""
        if self._first_values is None:
            state = self.state
            arrays = [state.status, state.iterations, state.integrations, state.has_reference, state.merit, state.damping]
            arrays += [state.contraction, state.change, state.accepted, state.step, state.direction, state.reference]
            self._first_values = [array.numpy() for array in arrays]
        for values in self._first_values:
            values.fill(0)
        self.allow(UNLIMITED)

    def _shape(self) -> tuple[int, ...]:
        """Largest block and border of ``Gamma`` where it is an arrow, with its room to work; nothing where it is dense; and
        whether it is eliminated elsewhere."""
        problem, arrow, n = self.problem, self.state.arrow, self.problem.unknown_count
        if self.eliminated is not None:
            return 0, 0, True
        if not problem.arrow:
            self.state.factor, self.state.quotient = self._room(n, n), self._room(n, n)
            return ()
        sizes = np.diff(problem.arrow)
        block, border = int(sizes[:-1].max()), int(sizes[-1])
        arrow.count = len(sizes) - 1
        arrow.start = wp.array(np.array(problem.arrow, dtype=np.int32), dtype=wp.int32, device=problem.device)
        room = (problem.instance_count, arrow.count, block, front_width(block, border, PROBES))
        arrow.pivots = wp.zeros(room, dtype=wp.float64, device=problem.device)
        arrow.front = self._room(border, front_width(block, border, PROBES))
        self.state.arrow = arrow
        self.state.probes, self.state.probed = self._room(n, PROBES), self._room(n, PROBES)
        return block, border

    def _room(self, *shape: int) -> Array:
        """Room to work in of every instance, shape (instance_count, ...): on a processor, which takes one after another, the
        same."""
        problem = self.problem
        own = wp.zeros((1 if self._on_cpu else problem.instance_count, *shape), dtype=wp.float64, device=problem.device)
        if not self._on_cpu:
            return own
        self._rooms.append(own)  # a view does not keep it
        return wp.array(
            ptr=own.ptr,
            dtype=wp.float64,
            shape=(problem.instance_count, *shape),
            strides=(0, *own.strides[1:]),
            device=problem.device,
        )

    def expect(self) -> None:
        """Have what ``run`` launches compiled in the background, while something else is done first."""
        expect(self._make, self.problem.device)

    @property
    def _make(self) -> Callable[[], wp.Kernel]:
        return partial(make_newton, *self.shape, repeats=self._on_cpu)

    @cached_property
    def _launch(self) -> Launch:
        problem = self.problem
        return record(self._make, problem.instance_count, [self.state, Calls(), 0, Sample()], problem.device)

    def calls(self) -> Struct | None:
        """What a kernel calls for an integration, of few instances on the CPU: ``repeated_kernels.Calls``; None where it cannot.

        The same object as long as the launches are the same.
        """
        if not self._repeats or self.problem.budget is not None:  # of which each integration takes its part
            return None
        launches = self.problem.launches
        if launches is not self._bound:
            self._bound, self._calls = launches, callable_from_kernels(launches)
        return self._calls

    def repeating(self, calls: Struct, sample: Struct | None = None) -> Launch:
        """A launch that repeats integration and iteration, ``ROUNDS`` times at most; of a motion's next ``sample`` where there is
        one."""
        arguments = [self.state, calls, ROUNDS, Sample() if sample is None else sample]
        return record(self._make, 1, arguments, self.problem.device)

    def of(self, problem: BoundaryProblem, instances: IntArray) -> "Newton":
        """The same on another problem, whose instances are these, (k,), of this one."""
        state = self.state
        other = Newton(
            problem, tolerance=self._given_tolerance, max_iterations=state.max_iterations, line_search=bool(state.line_search)
        )
        other.allow(self.allowed()[instances])
        return other

    def allow(self, integrations: IntArray | int) -> None:
        """End what has taken so many integrations, (instance_count,) or for all, in the runs and paths from now on."""
        if self._allowed is not None:
            self._allowed[:] = integrations
        else:
            self.state.allowed.assign(np.broadcast_to(np.asarray(integrations, dtype=np.int32), self.problem.instance_count))

    def allowed(self) -> IntArray:
        """Integrations that a run or path may take, shape (instance_count,)."""
        return np.array(self.state.allowed.numpy() if self._allowed is None else self._allowed)

    @contextmanager
    def within(self, integrations: IntArray | int) -> Iterator[None]:
        """Within it so many are allowed, (instance_count,) or for all; then as many as were."""
        before = self.allowed()
        self.allow(integrations)
        try:
            yield
        finally:
            self.allow(before)

    def tolerance(self) -> FloatArray:
        """Largest residual of each instance [1/m], shape (instance_count,)."""
        return np.array(self.state.tolerance.numpy() if self._tolerance is None else self._tolerance)

    @contextmanager
    def no_looser(self) -> Iterator[BoolArray]:
        """Within it no tolerance is looser than the problem's own; of which it is elsewhere, bool, shape (instance_count,)."""
        given, own = self.tolerance(), self.problem.tolerance(None)
        loose = given > own
        if not loose.any():
            yield loose
            return
        self._set_tolerance(np.minimum(given, own))
        try:
            yield loose
        finally:
            self._set_tolerance(given)

    @contextmanager
    def no_finer(self, least: FloatArray) -> Iterator[None]:
        """Within it no tolerance is less than ``least`` (instance_count,), which rounding leaves, unless one was given."""
        own = self.tolerance()
        if self._given_tolerance is None:
            self._set_tolerance(np.maximum(own, least))
        try:
            yield
        finally:
            self._set_tolerance(own)

    def _set_tolerance(self, tolerance: FloatArray) -> None:
        self.state.tolerance.assign(tolerance)
        if self.eliminated is not None:
            self.eliminated.tolerance = tolerance

    def give_up_wild(self, those: bool) -> None:
        """Whether ``run`` gives those up that contract so slowly that they are doubted anyway, once they come to shapes that take
        ``WILD`` times as many steps of the integrator as what they began with."""
        slow = self.slow if those else UNSLOWED
        if self._hopeless is not None:
            self._hopeless[0] = slow
        else:
            self.state.hopeless.fill_(slow)

    def doubtful(self) -> bool:
        """Whether any instance of the last run failed or may have strayed."""
        if self._counts is None or self._doubts is None:
            return True
        change, contraction = self._doubts
        return bool((self._counts[0] != CONVERGED).any() or change.max() > LARGE_CHANGE or contraction.max() > self.slow)

    def slowed(self) -> BoolArray:
        """Whether an instance of the last run contracted too slowly to be sure of its branch; bool, shape (instance_count,)."""
        return np.asarray((self._doubts[1] if self._doubts else self.state.contraction.numpy()) > self.slow)

    def strayed(self) -> BoolArray:
        """Whether a converged instance may be on another branch than its reference; bool, shape (instance_count,)."""
        change, contraction = self._doubts or (self.state.change.numpy(), self.state.contraction.numpy())
        return np.asarray((change > LARGE_CHANGE) | (contraction > self.slow))

    def wandered(self) -> BoolArray:
        """Whether an instance of the last run contracted too slowly to be near where it started; bool, shape
        (instance_count,)."""
        return np.asarray(self.state.contraction.numpy() > LARGE_CHANGE)

    def gamma(self) -> FloatArray:
        """``Gamma`` of all instances as it is kept here: dense, or its numbers where the problem offers ``elimination``; shape
        (instance_count, k)."""
        problem = self.problem
        if self.eliminated is None:
            return problem.read("gamma")
        return problem.numbers_of_gamma(np.arange(problem.instance_count))

    def least_singular_values(self, matrices: FloatArray) -> FloatArray:
        """Of some matrices like those of ``gamma()``, (k, ..., ...), shape (k,)."""
        elimination = self.problem.elimination
        if self.eliminated is None or elimination is None:
            return np.asarray(np.linalg.svd(matrices, compute_uv=False)[:, -1])
        return np.array([elimination.least_singular_value(own.reshape(-1)) for own in matrices])

    def reference(self) -> FloatArray:
        """``Gamma`` of the last sample that was kept, as ``gamma()``, shape (instance_count, k)."""
        return np.array(self.state.reference.numpy()).reshape(self.problem.instance_count, -1)

    def set_reference(self, kept: BoolArray | None = None) -> None:
        """Keep the present ``Gamma`` of the instances ``kept``, all by default, to compare the next with."""
        gamma = self.gamma()
        if self._reference is not None and self._has_reference is not None:
            which = slice(None) if kept is None else kept
            self._reference[which] = gamma[which]
            self._has_reference[which] = 1
            return
        before = self.reference().reshape(gamma.shape)
        chosen = gamma if kept is None else np.where(np.asarray(kept)[:, None], gamma, before)
        self.state.reference.assign(chosen.reshape(self.state.reference.shape))
        known = np.array(self.state.has_reference.numpy())
        known[slice(None) if kept is None else kept] = 1
        self.state.has_reference.assign(known)

    def run(self, chosen: BoolArray | None = None) -> None:
        """Iterate the chosen instances (bool, (instance_count,); all by default) from ``problem.unknowns`` to their ends."""
        self.start(chosen)
        self.go_on()

    def go_on(self) -> None:
        """Iterate until no instance is active."""
        calls = self.calls()
        if calls is None or self._remaining is None:
            with self.iterating() as iterate:
                while iterate():
                    pass
            return
        if self._loop is None or self._loop[0] is not calls:
            self._loop = calls, self.repeating(calls)
        with self.problem.focused():
            while self._remaining[0]:
                self.problem.heed_stop()
                self._loop[1].launch()

    def start(self, chosen: BoolArray | None = None) -> None:
        """Begin with the chosen instances (bool, (instance_count,); all by default) at ``problem.unknowns``."""
        if self._starting is not None:
            counters, measures, active = self._starting
            if self._remaining is not None:
                self._remaining[0] = 1
            counters[:] = 0
            measures[:] = _UNBEGUN
            active[:] = 1 if chosen is None else chosen
            return
        self._counters.zero_()
        self._measures.zero_()
        self.state.merit.fill_(-1.0)
        self.state.active.assign(np.ones(self.problem.instance_count, dtype=np.int32) if chosen is None else np.int32(chosen))

    @contextmanager
    def iterating(self) -> Iterator[Callable[[], int]]:
        """Within it, what it yields is one integration of all active instances and what follows from it, and returns how many are
        still active; launches pass over fewer and fewer."""
        with narrowing(self.problem) as narrow:

            def iterate() -> int:
                remaining = self._iterate()
                narrow(remaining)
                return remaining

            yield iterate

    def give_up(self, chosen: BoolArray) -> None:
        """End the iteration of some instances, (instance_count,), where they are."""
        active = self.problem.active.numpy()
        self.state.active.assign(np.where(chosen, 0, active).astype(np.int32))

    def _iterate(self) -> int:
        return self._rounds.take(self._launch, self._eliminate)

    def _eliminate(self) -> None:
        """Have what the kernel asks of ``Gamma`` found, where the problem offers ``elimination``."""
        if self.eliminated is not None:
            others = [(self.state.reference.numpy(), self.state.has_reference.numpy() != 0)]
            self.eliminated.find(None, others, [(1.0, LARGE_CHANGE, CHANGE_POWERS)])

    def outcome(self) -> Outcome:
        """Copies of the counts and statuses."""
        return Outcome(*(np.array(self._counters.numpy()) if self._starting is None else self._starting[0].copy()))
