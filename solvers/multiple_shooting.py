"""Multiple shooting: the rod in segments short enough that none amplifies an error by much, along the natural branch."""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

import numpy as np

from multirod.integrators import RK45, Integrator
from multirod.problem import BoundaryProblem
from multirod.segment_system import System
from multirod.segments import Breakpoints, Segments, placed
from multirod.solver import Outcome, Solver, Track
from multirod.solvers.newton.iteration import Newton
from multirod.solvers.segments.path import Result, Run, SegmentedPath, run_together
from multirod.stability import Stability
from multirod.status import BoolArray, IntArray, Status, failures
from multirod.validation import FloatArray, positive_int

NOISY = 1e2  # norm of Gamma from which the integrator's noise may look like the end of a branch
POLISH = 5  # iterations on the unknowns alone
MAX_INTEGRATIONS = 4000  # some seconds; the hardest loads of docs/solvers.md take 700
SAME_POSE = 1e-7  # of the length, and of a rotation: how near these lead to the tip that the segments lead to

_Ended = tuple[Result, SegmentedPath]


@dataclass(frozen=True, kw_only=True)
class MultipleShooting(Solver):
    """Newton's method on the states at breakpoints that are set so that no segment between two amplifies an error by much.

    For what single shooting cannot solve: long, soft, strongly loaded rods, whose sensitivities grow by more from base to tip
    than numbers have digits. ``Shooting`` turns to it by itself where it stalls. Without a guess it finds the equilibrium on the
    natural branch, by the tests that ``Shooting`` makes (``docs/solvers.md``).

    Attributes:
        tolerance: Largest residual of the boundary conditions, and gap between two segments, max norm [1/m]; None is that of
            ``Shooting``.
        integrator: Of the spatial equations, in double precision: what is asked for in ``"float32"`` is made so.
        max_iterations: Newton iterations allowed in each continuation step, or from a guess.
        max_continuation_steps: Load steps allowed.
        max_integrations: Integrations of a rod allowed in all; what has taken them without a result ends as
            ``INTEGRATION_LIMIT``. The few that tell what is left of the residual come on top.

    Raises:
        ValueError: If a field is out of range.
    """

    tolerance: float | None = None
    integrator: Integrator = field(default_factory=RK45)
    max_iterations: int = 30
    max_continuation_steps: int = 1000
    max_integrations: int = MAX_INTEGRATIONS

    def __post_init__(self) -> None:
        self._check_integrator()
        object.__setattr__(self, "integrator", self.integrator.in_double())
        self._check_tolerance()
        positive_int("MultipleShooting.max_iterations", self.max_iterations)
        positive_int("MultipleShooting.max_continuation_steps", self.max_continuation_steps)
        positive_int("MultipleShooting.max_integrations", self.max_integrations)

    def unsupported(self, problem: BoundaryProblem) -> tuple[str, ...]:
        """Every reason why this solver cannot take ``problem``; empty if it can."""
        return () if problem.segments is not None else ("it offers no segments: it is not a single rod",)

    def _solve(self, problem: BoundaryProblem, guess: FloatArray | None) -> Outcome:
        allowed = np.full(problem.instance_count, self.max_integrations)
        if guess is None:
            return self._anew(problem, allowed)
        return self._report(problem, self._run(problem, _from(guess), allowed), natural=False)

    def _anew(self, problem: BoundaryProblem, allowed: IntArray) -> Outcome:
        """All instances along their natural branches, each by as many integrations as it is allowed."""
        return self._report(problem, self._natural(problem, range(problem.instance_count), allowed), natural=True)

    def track(self, problem: BoundaryProblem, dt: float) -> Track:
        """Follow a motion, each sample from the states of the last, or anew along its natural branch where that might leave
        it."""
        return _Resumed(self, problem)

    def rescue(self, problem: BoundaryProblem, outcome: Outcome, left: IntArray) -> None:
        """Solve, apart from the others, the instances that rounding kept ``Shooting`` from following to the end of their branch.

        What is found goes into the problem's buffers and the outcome, and that a branch ends; all else stays as it was. An
        instance takes no more integrations than are ``left``, (instance_count,), nor than this solver may.
        """
        if self.unsupported(problem) or problem.parts is None:
            return
        places = np.flatnonzero(_ill_conditioned(problem, outcome))
        if not len(places):
            return
        part = problem.parts.of(places, double=True)
        mine = self._anew(part, np.minimum(left[places], self.max_integrations))
        found = self._take_over(problem, part, places, mine)
        said = found | np.isin(mine.status, (Status.BRANCH_END, Status.INTEGRATION_LIMIT))
        outcome.status[places] = np.where(said, mine.status, outcome.status[places])
        doubtful = places[~said & (outcome.status[places] == Status.BRANCH_END)]
        outcome.status[doubtful] = Status.STALLED  # rounding hides whether it ends
        if outcome.reached is not None and mine.reached is not None:
            outcome.reached[places[said]] = mine.reached[said]
        outcome.iterations[places] += mine.iterations
        outcome.integrations[places] += mine.integrations
        outcome.breakpoints |= placed(mine.breakpoints, places)

    def go_on(
        self, problem: BoundaryProblem, outcome: Outcome, ends: Mapping[int, tuple[FloatArray, float]], left: IntArray
    ) -> BoolArray:
        """The same from equilibria at a level of the load, unknowns (n,) and level by instance; which were brought to the full
        load, (instance_count,)."""
        result = np.zeros(problem.instance_count, dtype=bool)
        if self.unsupported(problem) or problem.parts is None or not ends:
            return result
        places = np.array(list(ends))
        part = problem.parts.of(places, double=True)
        scale = np.maximum(part.load_scale(), 1e-300)
        starts = {
            k: partial(SegmentedPath.follow, unknowns=unknowns, scale=float(scale[k]), level=level)
            for k, (unknowns, level) in enumerate(ends.values())
        }
        mine = self._report(part, self._run(part, starts, np.minimum(left[places], self.max_integrations)), natural=True)
        result[places] = found = self._take_over(problem, part, places, mine)
        outcome.status[places[found]] = mine.status[found]
        outcome.iterations[places] += mine.iterations
        outcome.integrations[places] += mine.integrations
        outcome.breakpoints |= placed(mine.breakpoints, places)
        if outcome.reached is not None:
            outcome.reached[places[found]] = 1.0
        return result

    @staticmethod
    def _take_over(problem: BoundaryProblem, part: BoundaryProblem, places: Any, mine: Outcome) -> BoolArray:
        """Put what was found into the problem's buffers; which was, shape (k,)."""
        found = ~failures(mine.status)
        part.restore(np.where(found[:, None], part.snapshot(), problem.snapshot()[places]))
        problem.keep(part, places)
        return found

    def _natural(self, problem: BoundaryProblem, chosen: Iterable[int], allowed: IntArray) -> dict[int, _Ended]:
        guess, scale = problem.guess(), np.maximum(problem.load_scale(), 1e-300)
        starts = {k: partial(SegmentedPath.follow, unknowns=guess[k], scale=float(scale[k])) for k in chosen}
        ended = self._run(problem, starts, allowed)
        for _, branch in ended.values():
            branch.integrations += problem.guess_integrations
        return ended

    def _run(
        self, problem: BoundaryProblem, starts: Mapping[int, Callable[[SegmentedPath], Run]], allowed: IntArray
    ) -> dict[int, _Ended]:
        """Run instances together, each by what it is started with, and by as many integrations as it is allowed."""
        segments = self._segments(problem)
        limit = problem.tolerance(self.tolerance)
        branches = {k: self._branch(segments, k, float(limit[k]), int(allowed[k])) for k in starts}
        results = run_together(segments, {instance: start(branches[instance]) for instance, start in starts.items()})
        return {instance: (result, branches[instance]) for instance, result in results.items()}

    @staticmethod
    def _segments(problem: BoundaryProblem) -> Segments:
        segments = problem.segments
        assert segments is not None  # or the problem was refused
        return segments

    def _branch(self, segments: Segments, instance: int, tolerance: float, allowed: int) -> SegmentedPath:
        return SegmentedPath(
            segments,
            instance,
            tolerance=tolerance,
            max_iterations=self.max_iterations,
            max_steps=self.max_continuation_steps,
            max_integrations=allowed,
            integrator=self.integrator,
        )

    def _report(self, problem: BoundaryProblem, ended: dict[int, _Ended], natural: bool) -> Outcome:
        """Put results into the problem's buffers; ``CONVERGED`` where an integration from the base alone leads to them."""
        segments = self._segments(problem)
        outcome = Outcome.zeros(problem.instance_count)
        reached = np.ones(problem.instance_count)
        unknowns = problem.read("unknowns")
        poses = {}
        for instance, (result, branch) in ended.items():
            outcome.status[instance] = result.status
            outcome.iterations[instance] = branch.iterations
            outcome.integrations[instance] = branch.integrations
            reached[instance] = result.level
            unknowns[instance] = result.points.unknowns
            if result.found is not None:
                poses[instance] = segments.tip_pose(instance, result.found)
        self._polish(problem, unknowns, poses, segments, outcome)
        if natural:
            # stable at its start, a natural branch stays stable
            alone = outcome.status == Status.MULTIPLE_SHOOTING
            found = {instance: ended[instance][0].points for instance in map(int, np.flatnonzero(alone))}
            unstable = segments.modes(found).stability == Stability.UNSTABLE
            outcome.status[np.flatnonzero(alone)[unstable]] = Status.BRANCH_END
        records = problem.snapshot()
        fields = {name: records[:, place] for name, place in problem.record_fields.items()}
        for instance, (result, _) in ended.items():
            if outcome.status[instance] == Status.MULTIPLE_SHOOTING:
                assert result.found is not None
                position, rotation = poses[instance]
                fields["unknowns"][instance] = unknowns[instance]
                fields["residual"][instance] = result.found.residual
                fields["gamma"][instance] = np.nan
                fields["position"][instance], fields["rotation"][instance] = position, rotation.ravel()
                outcome.breakpoints[instance] = replace(result.points, gap=result.residual)
        problem.restore(records)
        outcome.reached = reached
        return outcome

    def _polish(
        self, problem: BoundaryProblem, unknowns: FloatArray, poses: dict[int, Any], segments: Segments, outcome: Outcome
    ) -> None:
        """Newton on the unknowns alone, which converges to the same pose where the problem is well conditioned."""
        problem.write("unknowns", unknowns)
        newton = Newton(problem, tolerance=self.tolerance, max_iterations=POLISH, line_search=False)
        tried = np.zeros(problem.instance_count, dtype=bool)
        tried[list(poses)] = True
        newton.run(tried)
        single = newton.outcome()
        outcome.integrations += np.where(tried, single.integrations, 0)
        position, rotation = problem.read("position"), problem.read("rotation")
        for instance, (p, R) in poses.items():
            off = np.linalg.norm(position[instance] - p) / segments.length(instance)
            off += np.linalg.norm(rotation[instance] - R.ravel())
            if single.status[instance] == Status.CONVERGED and off < SAME_POSE:
                outcome.status[instance] = Status.CONVERGED
        lost = failures(outcome.status) & (outcome.status != Status.NOT_RUN)
        if lost.any():
            # what is left of the residual at the full load
            with problem.only(lost):
                problem.integrate()
            outcome.integrations += lost


class _Resumed(Track):
    """Starts every sample from the states of the last."""

    def __init__(self, solver: MultipleShooting, problem: BoundaryProblem) -> None:
        self.solver = solver
        self.problem = problem
        self.places = solver._segments(problem).unknown_places
        self.first: FloatArray | None = None
        self.natural = True  # or from a guess, which may be unstable
        self.last: dict[int, tuple[Breakpoints, System]] = {}

    def start(self, unknowns: FloatArray) -> None:
        self.first = np.array(unknowns)
        self.natural = False

    def step(self) -> Outcome:
        solver, problem = self.solver, self.problem
        first, self.first = self.first, None
        allowed = np.full(problem.instance_count, solver.max_integrations)
        if first is not None:
            ended = solver._run(problem, _from(first), allowed)
        else:
            resumed = {
                k: partial(SegmentedPath.resume, points=points, before=system) for k, (points, system) in self.last.items()
            }
            ended = solver._run(problem, resumed, allowed)
            spent = {k: branch.integrations for k, (result, branch) in ended.items() if result is None}
            for k, integrations in spent.items():
                allowed[k] -= integrations
            again = [k for k in range(problem.instance_count) if k not in ended or k in spent]
            ended |= solver._natural(problem, again, allowed)
            for k, integrations in spent.items():
                ended[k][1].integrations += integrations
        for k, (result, _) in ended.items():
            if result.found is not None:
                self.last[k] = (result.points, System(result.found, self.places))
        return solver._report(problem, ended, natural=self.natural)


def _from(guess: FloatArray) -> dict[int, Callable[[SegmentedPath], Run]]:
    """How instances start from a guess (instance_count, n)."""
    return {k: partial(SegmentedPath.solve_from, unknowns=unknowns) for k, unknowns in enumerate(guess)}


def _ill_conditioned(problem: BoundaryProblem, outcome: Outcome) -> Any:
    """Instances that single shooting could not solve, by rounding or noise rather than because their branch ends."""
    lost = np.isin(outcome.status, (Status.STALLED, Status.MAX_ITERATIONS))
    ended = outcome.status == Status.BRANCH_END
    if ended.any() and outcome.reached is not None:
        # Gamma where the branch seems to end, not at the full load, which may be far beyond
        records = problem.snapshot()
        with problem.only(ended), problem.at_load(np.where(ended, outcome.reached, 1.0)):
            problem.integrate()
        growth = np.linalg.norm(np.nan_to_num(problem.read("gamma"), nan=np.inf), axis=1)
        lost |= ended & (growth > NOISY)
        problem.restore(records)
        outcome.integrations += ended
    return lost
