"""Following a branch of equilibria in steps that are sure to stay on it."""

from collections.abc import Callable
from contextlib import nullcontext
from functools import partial
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import ArrayLike, NDArray

from multirod.kernels.repeated_kernels import Calls
from multirod.kernels.warp_types import Struct
from multirod.launch import Launch, expect, record
from multirod.problem import BoundaryProblem
from multirod.solver import Outcome
from multirod.solvers.continuation.acceptance import MIN_STEP, RATIO_TESTS
from multirod.solvers.continuation.continuation_kernels import FALL, LOOKING, PathState, make_path
from multirod.solvers.continuation.pace import ROUNDS, Pace, creeping, runaway
from multirod.solvers.newton.iteration import Newton, narrowing
from multirod.solvers.newton.rounds import Rounds
from multirod.status import CONVERGED, NOT_RUN, BoolArray, IntArray, Status, failures
from multirod.validation import FloatArray

SAFE_LOAD = 5.0  # in F L^2/EI: no equilibrium loses and regains stability within such a step (Euler: 2.5 and 22)
SINGULAR = 0.05  # largest singular value, in units of what is natural, that vanishes where a branch ends; within 1e-7 of there
TURN = 2.5  # by which rods may be turned against each other in a step [rad]: half a turn later they pull the other way
GROWTH = 0.5  # of the load reached, that the next step may be if that is more
AT_KINK = 1e-3  # of the curvature scale, that an unknown may be from a kink where a path ended: steps are 1e-7 there

COUNTS = (
    *("status", "iterations", "integrations", "steps", "known", "halved"),
    *("surprised", "rough", "misled", "probed", "doubted", "brief", "coarsely"),
)
PLACES = (*("step", "goal", "apart", "points", "levels", "reference"), *("expected", "surprise", "trial", "middle", "halfway"))


class Paths:
    """Paths of all instances of a problem from level 0 to level 1, each in steps of its own.

    A step starts from the extrapolation of the last three equilibria. It is kept if Newton's undamped steps contract fast, as
    they do inside the ball around a solution in which it is the only one (Newton-Kantorovich), if ``Gamma`` at its end, times
    the inverse of that at its start, is near the identity: no mode has vanished or changed sign on the way, not even two at
    once, and if the equilibrium lies where the extrapolation led, or goes on in proportion as the step is halved: near a
    bifurcation that is imperfect by a little, the other branch passes the first two tests. What has several equilibria unloaded
    is looked at halfway too: the step is kept if there is an equilibrium on the curve through its ends, and ``Gamma`` there is
    like both. The whole load at once may contract more slowly at first, and is then looked at at its quarters too. The step is
    otherwise halved; the branch ends where that makes it too small.

    Args:
        problem: Its buffers hold the last equilibrium of each instance afterwards.
        newton: On the same problem.
        max_steps: Steps allowed.
    """

    def __init__(self, problem: BoundaryProblem, newton: Newton, max_steps: int) -> None:
        self.problem = problem
        n, count, device = problem.unknown_count, problem.instance_count, problem.device
        state: Struct = PathState()
        self.state = state
        state.newton = newton.state
        state.load_factor, state.inputs = problem.load_factor, problem.inputs
        for name in COUNTS:
            setattr(state, name, wp.zeros(count, dtype=wp.int32, device=device))
        for name in ("step", "goal", "safe_step", "most_step", "sure_level", "apart"):
            setattr(state, name, wp.zeros(count, dtype=wp.float64, device=device))
        state.points = wp.zeros((count, 3, n), dtype=wp.float64, device=device)
        state.levels = wp.zeros((count, 3), dtype=wp.float64, device=device)
        state.reference = wp.zeros(newton.state.gamma.shape, dtype=wp.float64, device=device)
        for name in ("expected", "surprise", "trial", "middle"):
            setattr(state, name, wp.zeros((count, n), dtype=wp.float64, device=device))
        state.halfway = wp.zeros(newton.state.gamma.shape, dtype=wp.float64, device=device)
        state.max_steps = max_steps
        state.remaining = wp.zeros(1, dtype=wp.int32, device=device)
        self._rounds = Rounds(problem, state.remaining)
        self._remaining = self._rounds.remaining
        self._in_place: dict[str, Any] = {}
        if wp.get_device(device).is_cpu:
            names = (*COUNTS, "safe_step", "most_step", "sure_level", "load_factor", "levels", "step")
            self._in_place = {name: getattr(state, name).numpy() for name in names} | {"active": problem.active.numpy()}
        self._newton = newton
        self.handed: BoolArray | None = None  # which crept and were given up; None where that is not asked for
        self._pace, self._brief = Pace(problem), np.zeros(count, dtype=bool)  # which may look by few steps of the integrator
        self._launch: Launch | None = None
        self._loop: tuple[Struct, Struct | None, tuple[Launch, ...]] | None = None  # what is called, and launches that repeat it
        self._passed: tuple[Any, ...] | None = None  # options of these launches
        self._first_values: Any = None
        # compiled while the problem's own kernels are
        self._on_cpu = wp.get_device(device).is_cpu
        self._make = partial(make_path, *newton.shape, repeats=self._on_cpu)
        expect(self._make, device)

    @classmethod
    def of(cls, problem: BoundaryProblem, newton: Newton, max_steps: int) -> "Paths":
        """New ones, or, of a problem that may be kept, those that were kept with ``newton``, as new."""
        if not problem.may_be_kept:
            return cls(problem, newton, max_steps)
        if newton.paths is None:
            newton.paths = cls(problem, newton, max_steps)
        kept: Paths = newton.paths
        kept.renew(max_steps)
        return kept

    def renew(self, max_steps: int) -> None:
        """As new, on the CPU."""
        state = self.state
        state.max_steps = max_steps
        self.handed = None
        if self._first_values is None:
            self._first_values = [getattr(state, name).numpy() for name in (*COUNTS, *PLACES)]
        for values in self._first_values:
            values.fill(0)

    def raise_loads(self, chosen: BoolArray, bounds: FloatArray, finer: int = 1, unloaded: FloatArray | None = None) -> Outcome:
        """From the unloaded equilibrium to the full load, all loads in proportion.

        ``bounds`` are the problem's ``mode_bounds``, and steps are ``finer`` times shorter than they call for. Where the
        equilibrium is, ``unloaded`` (instance_count, n) says, or the problem's ``guess``.
        """
        problem, first = self.problem, bounds[:, 0]
        safe_step = SAFE_LOAD / np.maximum(np.maximum(problem.load_scale(), 2 * first), 1e-300)
        most_step = np.where(first < 1, 1.0, TURN / np.maximum(problem.turning(), 1e-300) / finer)
        sure = (first < 1) | (not problem.may_jump)
        start = problem.guess() if unloaded is None else unloaded
        self._brief[:] = finer == 1 and self._pace.may_be_brief()
        outcome = self.raise_from(chosen, start, safe_step / finer, most_step=most_step, growth=GROWTH / finer, sure=sure)
        self._brief[:] = False
        if unloaded is None:
            outcome.integrations += chosen * problem.guess_integrations
        return outcome

    def raise_from(
        self,
        chosen: BoolArray,
        unknowns: FloatArray,
        safe_step: FloatArray,
        *,
        most_step: FloatArray | float = 1.0,
        growth: float = GROWTH,
        sure: BoolArray | bool = True,
    ) -> Outcome:
        """From the equilibrium ``unknowns`` (instance_count, n) where the load factor is 0, to where it is 1.

        ``safe_step`` (instance_count,) is a step that is short enough wherever it starts, and ``growth`` the part of the load
        reached that one may be if that is more, up to ``most_step``. Where it is ``sure`` that no mode can vanish and come back,
        steps are not looked at halfway. What is not ``chosen`` is left as it is.
        """
        self.state.by_inputs = 0
        self._set("safe_step", safe_step)
        self._set("most_step", most_step)
        self._set("sure_level", sure)
        self.state.growth = growth

        def go(some: BoolArray) -> Outcome:
            problem = self.problem
            problem.write("unknowns", np.where(some[:, None], unknowns, problem.read("unknowns")))
            with problem.at_load(np.where(some, 0.0, 1.0)):
                self._set_out(some, known=0)
                return self._follow(integrated=problem.integrate_alike())

        return self._led(go, chosen)

    def _led(self, go: Callable[[BoolArray], Outcome], chosen: BoolArray) -> Outcome:
        """``go`` of the chosen; again, by equilibria alone, of those that what Newton's method had not finished misled.

        What is within a loose tolerance by chance says nothing of where the branch goes on: paths are followed to the default,
        and what rounding keeps from that to what was given.
        """
        self._set("misled", 0)
        with self._newton.no_looser() as loose:
            outcome = go(chosen)
            self._go_again(go, outcome, self._get("misled") != 0)
        if outcome.all_converged:
            return outcome
        stalled = chosen & loose & (outcome.status == int(Status.STALLED))
        if self.handed is not None:
            self.handed &= ~stalled
        self._go_again(go, outcome, stalled)
        return outcome

    def _go_again(self, go: Callable[[BoolArray], Outcome], outcome: Outcome, some: BoolArray) -> None:
        """``go`` of some, by what the ``outcome`` leaves of their integrations; what they end with takes its place."""
        if some.any():
            with self._newton.within(np.maximum(self._newton.allowed() - outcome.integrations, 0)):
                outcome.end_with(go(some), some)

    def _get(self, name: str) -> NDArray[Any]:
        """A copy of a number of every instance."""
        holder = self.problem if name == "active" else self.state
        return np.array(self._in_place[name] if self._in_place else getattr(holder, name).numpy())

    def _set(self, name: str, values: ArrayLike) -> None:
        """Set a number of every instance."""
        if self._in_place:
            self._in_place[name][:] = values
        else:
            target = getattr(self.problem if name == "active" else self.state, name)
            kind = np.float64 if target.dtype == wp.float64 else np.int32
            target.assign(np.ascontiguousarray(np.broadcast_to(np.asarray(values, dtype=kind), target.shape)))

    def change_inputs(
        self,
        chosen: BoolArray,
        before: FloatArray,
        unknowns: FloatArray,
        gamma: FloatArray,
        *,
        dip: float = 0.0,
        safe_step: FloatArray | float = 1.0,
    ) -> Outcome:
        """From the equilibrium ``unknowns``, where ``Gamma`` is ``gamma``, at the inputs ``before``, to the problem's inputs.

        All of the first axis instance_count; what is not ``chosen`` is left as it is. With a ``dip``, that part of the load is
        off halfway: what has a kink at the full load is smooth on the way. A ``safe_step`` (instance_count,) is one that is short
        enough though there is no equilibrium before the first, where loads differ by no more than what is safe.
        """
        problem, state = self.problem, self.state
        after = problem.read("inputs")
        state.by_inputs = 1
        state.dip = dip
        state.growth = GROWTH
        for name, values in (("from_inputs", before), ("to_inputs", after)):
            setattr(state, name, wp.array(np.ascontiguousarray(values), dtype=wp.float64, device=problem.device))
        self._set("safe_step", np.minimum(safe_step, SAFE_LOAD / np.maximum(problem.load_change(before), 1e-300)))
        state.most_step.assign(TURN / np.maximum(problem.turning(before), 1e-300))
        state.sure_level.fill_(0.0 if problem.may_jump else 1.0)

        def go(some: BoolArray) -> Outcome:
            state.points.assign(np.repeat(unknowns[:, None], 3, axis=1))
            state.reference.assign(np.ascontiguousarray(gamma).reshape(state.reference.shape))
            self._set_out(some, known=1)
            with problem.at_load(1.0) if dip else nullcontext():  # paths that end on the way leave theirs
                return self._follow()

        outcome = self._led(go, chosen)
        problem.write("inputs", after)
        return outcome

    def at_kink(self) -> BoolArray:
        """Whether the last equilibria on the paths are where the residual has a kink, shape (instance_count,)."""
        kinks, last = self.problem.kinks, self.state.points.numpy()[:, 0]
        return np.asarray((np.abs(last[:, kinks]) < AT_KINK * self.problem.curvature_scale()[:, None]).any(axis=1))

    def _set_out(self, chosen: BoolArray, known: int) -> None:
        """Put the chosen instances at the start of their paths, of which ``known`` equilibria are known, and leave the others."""
        state = self.state
        self._set("active", chosen)
        self._set("status", np.where(chosen, NOT_RUN, CONVERGED))
        for name in ("iterations", "integrations", "halved", "surprised", "rough", "probed", "levels"):
            self._set(name, 0)
        self._set("steps", np.where(chosen, 0, self._get("steps")))  # of the others they are asked for afterwards
        self._set("known", known)
        self._set("brief", brief := chosen & self._brief)
        self._set("coarsely", brief & (known == 0))  # what starts straight is integrated as well by any steps
        state.departing = int(known > 0)

    def _follow(self, *, integrated: bool = False) -> Outcome:
        """To the ends of all paths; ``integrated`` where that has been done at their beginnings."""
        problem, state = self.problem, self.state
        self._pace.begin()
        calls = self._newton.calls()
        if calls is not None:
            self._repeat(calls)
        else:
            with narrowing(problem) as narrow:
                self._launch_all(integrated, narrow)
        counts: dict[str, Any] = {name: self._get(name) for name in ("status", "iterations", "integrations")}
        outcome = Outcome(**counts, reached=self._get("levels")[:, 0].copy())
        if outcome.all_converged:
            return outcome
        self._doubt_ends(outcome.status, outcome.integrations)
        if len(problem.kinks):
            outcome.status[failures(outcome.status) & runaway(problem, state.points.numpy()[:, 0])] = Status.LINES_TOO_SHORT
        return outcome

    def _launch_all(self, integrated: bool, narrow: Callable[[int], None]) -> None:
        """Integrations and launches until no instance is on its way; ``narrow`` is told how many are."""
        problem, state = self.problem, self.state
        if self._launch is None:
            self._launch = record(self._make, problem.instance_count, [state, Calls(), Calls(), 0], problem.device)
        else:
            self._launch.set_param_at_index(0, state)
        launch = self._launch
        self._rounds.aim(launch)
        if state.departing:
            launch.launch()
            state.departing = 0
            launch.set_param_at_index(0, state)
        remaining, rounds, unloaded = 1, 0, None
        coarsely = self._in_place.get("coarsely") if self._get("brief").any() else None
        while remaining:
            remaining = self._rounds.take(launch, self._eliminate, integrated=integrated, coarsely=coarsely)
            integrated = False
            if self.handed is not None and unloaded is None:
                unloaded = self._newton.gamma()
            if unloaded is not None and remaining and (rounds + 1) % ROUNDS == 0:
                remaining -= self._give_up(unloaded)
            rounds += 1
            if remaining and rounds % ROUNDS == 0:
                remaining -= self._end_long()
            narrow(remaining)

    def _repeat(self, calls: Struct) -> None:
        """The same for few instances: a kernel repeats both, ``ROUNDS`` times in two launches."""
        state = self.state
        coarse = self._pace.calls() if self._get("brief").any() else None
        if self._loop is None or self._loop[0] is not calls or self._loop[1] is not coarse:
            arguments = state, calls, coarse or Calls()
            launches = tuple(record(self._make, 1, [*arguments, n], self.problem.device) for n in (1, ROUNDS - 1))
            self._loop, self._passed = (calls, coarse, launches), None
        first, others = self._loop[2]
        options = (state.by_inputs, state.dip, state.growth, state.max_steps)
        if state.by_inputs or options != self._passed:
            first.set_param_at_index(0, state)
            departing, state.departing = state.departing, 0
            others.set_param_at_index(0, state)
            state.departing = departing
            self._passed = options
        unloaded, remaining = None, 1
        while remaining:
            for launch in (first, others):
                if remaining:
                    self.problem.heed_stop()
                    launch.launch()
                    assert self._remaining is not None  # as calls are there on the CPU alone
                    remaining = int(self._remaining[0])
                if state.departing:
                    state.departing = 0
                    first.set_param_at_index(0, state)
                if self.handed is not None and unloaded is None:
                    unloaded = self._newton.gamma()
            if remaining and unloaded is not None:
                remaining -= self._give_up(unloaded)
            if remaining:
                remaining -= self._end_long()

    def _eliminate(self) -> None:
        """Have what the kernel asks of ``Gamma`` found, where the problem offers ``elimination``."""
        if self._newton.eliminated is None:
            return
        state = self.state
        others = [
            (state.reference.numpy(), state.known.numpy() > 0),
            (state.halfway.numpy(), state.goal.numpy() > state.sure_level.numpy()),
        ]
        looked = state.probed.numpy() == LOOKING
        with np.errstate(invalid="ignore"):
            size = np.linalg.norm(self.problem.read("residual"), axis=1)
            looked |= (state.goal.numpy() < 1) & (size <= FALL * state.newton.merit.numpy())  # which may go on from there
        self._newton.eliminated.find(looked, others, RATIO_TESTS)

    def _give_up(self, unloaded: FloatArray) -> int:
        """End those that creep towards where rounding ends them: whose steps are short, and whose ``Gamma``,
        ``unloaded`` first, (instance_count, n^2), will amplify the rounding of the unknowns far beyond the tolerance, (3) and (4)
        of ``docs/solvers.md``; how many there are.

        Every instance on its way has taken as many integrations as rounds, so that none depends on the others.
        """
        assert self.handed is not None
        problem = self.problem
        level, step, active = self._get("levels")[:, 0], self._get("step"), self._get("active") != 0
        if problem.segments is None or problem.parts is None:
            return 0
        unknowns = self.state.points.numpy()[:, 0]
        size = np.linalg.norm(self.state.reference.numpy(), axis=(1, 2))  # Frobenius: what multiplies a change, at most
        growth = np.divide(size, np.linalg.norm(unloaded, axis=1), out=np.zeros(len(size)), where=active)
        given_up = active & creeping(level, step, size, growth, unknowns, self._newton.tolerance())
        self.handed |= given_up
        self._set("status", np.where(given_up, Status.STALLED, self._get("status")))
        self._set("active", active & ~given_up)
        problem.write("unknowns", np.where(given_up[:, None], unknowns, problem.read("unknowns")))
        return int(given_up.sum())

    def _end_long(self) -> int:
        """End those that ``Pace.ended`` tells, at their last equilibria; how many there are.

        Every instance on its way has taken as many integrations as rounds.
        """
        problem, state, active = self.problem, self.state, self._get("active") != 0
        ended = self._pace.ended(active, self._get("levels")[:, 0], self._get("steps"), state.max_steps)
        if (some := ended != int(Status.NOT_RUN)).any():
            self._set("status", np.where(some, ended, self._get("status")))
            self._set("active", active & ~some)
            problem.write("unknowns", np.where(some[:, None], state.points.numpy()[:, 0], problem.read("unknowns")))
        return int(some.sum())

    def _doubt_ends(self, status: IntArray, integrations: IntArray) -> None:
        """Where no mode of ``Gamma`` is near zero, it is no fold and no bifurcation that steps became small at; where one is,
        rounding that would explain it too is not the reason, but where segments will tell."""
        ends = status == int(Status.BRANCH_END)
        small = (status == int(Status.STALLED)) & (self._get("step") < MIN_STEP)
        if small.any() and self.problem.segments is None:  # which are made when they are asked for
            ends |= small
        ended = np.flatnonzero(ends)
        if len(ended):
            least = self._newton.least_singular_values(self.state.reference.numpy()[ended])
            clear = least > SINGULAR * self.problem.natural_singular_value[ended]
            status[ended] = np.where(clear, Status.STALLED, Status.BRANCH_END)
            if self.state.by_inputs:  # what is natural here takes integrations
                integrations[ended] += np.broadcast_to(self.problem.guess_integrations, status.shape)[ended]
