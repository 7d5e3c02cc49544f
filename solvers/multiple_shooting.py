"""Multiple shooting: the rod in segments short enough that none amplifies an error by much, along the natural branch."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from multirod.integrators import RK45, Integrator
from multirod.naming import OPTIONS_NAMED, fields_hinted
from multirod.problem import BoundaryProblem
from multirod.segments import Breakpoints, Cuts, Segments, placed
from multirod.solver import Outcome, Solver, Track, knows
from multirod.solvers.continuation.pace import ROUNDED_OFF, RUNAWAY
from multirod.solvers.newton.iteration import Newton
from multirod.solvers.segments.equilibria import FAR
from multirod.solvers.segments.loosened import Loosened
from multirod.solvers.segments.path import Results, SegmentedPaths
from multirod.solvers.segments.place import Place
from multirod.stability import Stability, modes_of
from multirod.status import BoolArray, IntArray, Status, failures
from multirod.validation import FloatArray, positive_int

UNATTAINABLE = 1e-2  # of the rounding of the unknowns, that no gap comes below but where it is zero
NOISY = 1e2  # norm of Gamma from which the integrator's noise may look like the end of a branch
POLISH = 5  # iterations on the unknowns alone
MAX_INTEGRATIONS = 2000  # two seconds; the hardest loads of docs/solvers.md take 300
SAME_POSE = 1e-7  # of the length, and of a rotation: how near these lead to the tip that the segments lead to
# the same, and part of the tolerance, of those whose rounding leaves so little that it leads nowhere else: near a fold their tips
# differ by what the steps of the integrator are off by, over the stiffness that is left
NEAR_POSE, TOLD = 1e-4, 1e-3
ROUNDED = 0.05  # of the tolerance, that rounding may leave where the tip is held, whose pose tells nothing of what holds it


@fields_hinted(OPTIONS_NAMED)
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
        return () if problem.segments is not None else (f"it offers no segments: {problem.segments_refused}",)

    def _solve(self, problem: BoundaryProblem, guess: FloatArray | None) -> Outcome:
        allowed = np.full(problem.instance_count, self.max_integrations)
        if guess is None:
            return self._anew(problem, allowed)
        paths = self._paths(problem, np.arange(problem.instance_count), allowed)
        return self._report(problem, paths, paths.solve_from(guess), natural=False)

    def _resume(self, problem: BoundaryProblem, guess: FloatArray, points: Mapping[int, Breakpoints]) -> Outcome:
        return self.resume(problem, guess, points, np.full(problem.instance_count, self.max_integrations))[0]

    def resume(
        self, problem: BoundaryProblem, guess: FloatArray, points: Mapping[int, Breakpoints], allowed: IntArray
    ) -> tuple[Outcome, dict[int, Breakpoints]]:
        """All instances from a guess of their unknowns, (instance_count, n), and of the states at ``points``, each by as many
        integrations as it is ``allowed``; and by what breakpoints each is known now, as ``resume_branch`` has them."""
        paths = self._paths(problem, np.arange(problem.instance_count), allowed)
        results = paths.solve_from(guess, points)
        return self._report(problem, paths, results, natural=False), results.points()

    def states(self, problem: BoundaryProblem, instances: IntArray, steps: IntArray | None = None) -> dict[int, Breakpoints]:
        """Breakpoints of some instances, (k,), that their unknowns lead to, and between which nothing is amplified by much; by so
        many equal ``steps`` from base to tip, (k,), as ``go_on`` has them, those of the integrator by default."""
        count = len(instances)
        paths = self._paths(problem, instances, np.full(count, self.max_integrations))
        given = np.full(count, self.integrator.steps or 0) if steps is None else steps.astype(np.intp)
        place = paths.closed(paths.begin(problem.read("unknowns")[instances], np.ones(count), given))
        points = {k: place.cuts.points(at) for at, k in enumerate(instances.tolist()) if place.found.fault[at] == 0}
        if not points or paths.segments.end_held:  # whose conditions hold what symmetry leaves neutral
            return points
        soft = paths.segments.modes(points).soft.tolist()
        return {k: replace(own, neutral=modes) for (k, own), modes in zip(points.items(), soft, strict=True)}

    def resume_branch(
        self, problem: BoundaryProblem, last: Mapping[int, Breakpoints], before: FloatArray, allowed: IntArray
    ) -> tuple[Outcome, dict[int, Breakpoints]]:
        """All instances from breakpoints of their ``last`` equilibria, found at the inputs ``before``, (instance_count, k), each
        by as many integrations as it is ``allowed``, (instance_count,); ``NOT_RUN`` where that leads off their branches. And by
        what breakpoints each is known now, though its unknowns may lead to its tip as well."""
        everyone, now = np.arange(problem.instance_count), problem.read("inputs")
        paths, full = self._paths(problem, everyone, allowed), np.ones(len(everyone))
        problem.write("inputs", before)
        place, neutral = paths.evaluate(Cuts.of_points(last), full), np.array([own.neutral for own in last.values()])
        place, _ = paths.refine(place, full, full > 0, steps_kept=True, most=FAR)
        problem.write("inputs", now)
        results = paths.each(place, neutral, SegmentedPaths.resume)
        return self._report(problem, paths, results, natural=True), results.points()

    def _anew(self, problem: BoundaryProblem, allowed: IntArray) -> Outcome:
        """All instances along their natural branches, each by as many integrations as it is allowed."""
        paths = self._paths(problem, np.arange(problem.instance_count), allowed)
        return self._report(problem, paths, self._natural(problem, paths), natural=True)

    def track(self, problem: BoundaryProblem, dt: float) -> Track:
        """Follow a motion, each sample from the states of the last, or anew along its natural branch where that might leave
        it."""
        return _Resumed(self, problem)

    def rescue(self, problem: BoundaryProblem, outcome: Outcome, left: IntArray, tried: IntArray) -> None:
        """Solve, apart from the others, the instances that rounding kept ``Shooting`` from following to the end of their branch.

        What is found goes into the problem's buffers and the outcome, and that a branch ends; all else stays as it was. An
        instance takes no more integrations than are ``left``, (instance_count,), nor than this solver may. What ``go_on`` has
        ``tried``, statuses (instance_count,), is not tried again, nor what has a tolerance that rounding does not allow.
        """
        if self.unsupported(problem) or problem.parts is None:
            return
        lost, vain = _ill_conditioned(problem, outcome), self._unattainable(problem)
        tried = np.where(vain, int(Status.STALLED), tried)
        new = tried == Status.NOT_RUN
        _say(outcome, np.flatnonzero(lost & ~new), tried[lost & ~new])
        places = np.flatnonzero(lost & new)
        if not len(places):
            return
        part = problem.parts.of(places, double=True)
        mine = self._anew(part, np.minimum(left[places], self.max_integrations))
        self._take_over(problem, part, places, mine)
        said = _say(outcome, places, mine.status)
        if outcome.reached is not None and mine.reached is not None:
            outcome.reached[places[said]] = mine.reached[said]
        outcome.iterations[places] += mine.iterations
        outcome.integrations[places] += mine.integrations
        outcome.breakpoints |= placed(mine.breakpoints, places)

    def go_on(
        self,
        problem: BoundaryProblem,
        outcome: Outcome,
        ends: Mapping[int, tuple[FloatArray, float, int]],
        left: IntArray,
        neutral: int = 0,
    ) -> IntArray:
        """The same from equilibria at a level of the load, by instance: unknowns (n,), level, and the equal steps from base to
        tip by which it was found, 0 where step control did; of as many modes that are ``neutral`` all along.

        Returns:
            How each ended, (instance_count,), ``NOT_RUN`` where that was not tried; only results are put into the outcome.
        """
        result = np.full(problem.instance_count, int(Status.NOT_RUN))
        if self.unsupported(problem) or problem.parts is None or not ends:
            return result
        vain = self._unattainable(problem)
        ends = {k: end for k, end in ends.items() if not vain[k]}
        if not ends:
            return result
        places = np.array(list(ends))
        part = problem.parts.of(places, double=True)
        unknowns, level, steps = (np.array(values) for values in zip(*ends.values(), strict=True))
        paths = self._paths(part, np.arange(len(places)), np.minimum(left[places], self.max_integrations))
        results = paths.follow(unknowns, _load_scale(part), level, steps, neutral)
        mine = self._report(part, paths, results, natural=True)
        found = self._take_over(problem, part, places, mine)
        result[places] = mine.status
        outcome.status[places[found]] = mine.status[found]
        outcome.iterations[places] += mine.iterations
        outcome.integrations[places] += mine.integrations
        outcome.breakpoints |= placed(mine.breakpoints, places)
        if outcome.reached is not None:
            outcome.reached[places[found]] = 1.0
        return result

    def _unattainable(self, problem: BoundaryProblem) -> BoolArray:
        """Whose tolerance lies below what the rounding of the unknowns leaves, however short segments are, (instance_count,)."""
        size = np.minimum(np.abs(problem.read("unknowns")).max(axis=1, initial=0.0), problem.curvature_scale())
        return np.asarray(problem.tolerance(self.tolerance) < UNATTAINABLE * np.finfo(float).eps * size)

    @staticmethod
    def _take_over(problem: BoundaryProblem, part: BoundaryProblem, places: NDArray[np.intp], mine: Outcome) -> BoolArray:
        """Put what was found into the problem's buffers; which was, shape (k,)."""
        found = ~failures(mine.status)
        part.restore(np.where(found[:, None], part.snapshot(), problem.snapshot()[places]))
        problem.keep(part, places)
        return found

    def _natural(self, problem: BoundaryProblem, paths: SegmentedPaths) -> Results:
        """Instances along their natural branches; what ends beside a line at its kink, from where lines are longer, (L8c)."""
        chosen = paths.instances
        results = paths.follow(problem.guess()[chosen], _load_scale(problem)[chosen])
        paths.integrations += problem.guess_integrations
        if len(problem.kinks) and (failed := failures(results.status)).any():
            last = np.abs(results.place.cuts.unknowns[:, problem.kinks]).max(axis=1)
            results.status[failed & (last > RUNAWAY * problem.curvature_scale()[chosen])] = Status.LINES_TOO_SHORT
            Loosened(problem, paths, results).let_out()
        return results

    @staticmethod
    def _segments(problem: BoundaryProblem) -> Segments:
        segments = problem.segments
        assert segments is not None  # or the problem was refused
        return segments

    def _paths(self, problem: BoundaryProblem, instances: IntArray, allowed: IntArray) -> SegmentedPaths:
        """Ways of some instances, each by as many integrations as it is allowed."""
        return SegmentedPaths(
            self._segments(problem),
            instances,
            tolerance=problem.tolerance(self.tolerance)[instances],
            max_iterations=self.max_iterations,
            max_steps=self.max_continuation_steps,
            allowed=allowed,
            integrator=self.integrator,
        )

    def _report(self, problem: BoundaryProblem, paths: SegmentedPaths, results: Results, natural: bool) -> Outcome:
        """Put results of all instances into the problem's buffers; ``CONVERGED`` where an integration from the base alone leads
        to them."""
        segments, place = self._segments(problem), results.place
        outcome = Outcome.zeros(problem.instance_count)
        outcome.status[:] = results.status
        outcome.iterations[:], outcome.integrations[:] = paths.iterations, paths.integrations
        unknowns = place.cuts.unknowns
        tried = results.status == Status.MULTIPLE_SHOOTING
        position, rotation = np.full((len(tried), 3), np.nan), np.full((len(tried), 3, 3), np.nan)
        if tried.any():
            found = place.chosen(tried)
            position[tried], rotation[tried] = segments.tip_pose(found.cuts, found.found)
        self._polish(problem, unknowns, (position, rotation), segments, outcome, paths.rounding(place))
        points = {k: own for k, own in results.points().items() if outcome.status[k] == Status.MULTIPLE_SHOOTING}
        if natural:  # stable at its start, such a branch stays stable
            alone, whole = np.array(list(points), dtype=int), np.flatnonzero(outcome.status == Status.CONVERGED)
            if len(whole):
                unstable = modes_of(problem, whole).stability == Stability.UNSTABLE
                outcome.status[whole[unstable]] = Status.BRANCH_END
            if len(alone):
                unstable = segments.modes(points).stability == Stability.UNSTABLE
                outcome.status[alone[unstable]] = Status.BRANCH_END
                points = {k: own for k, own in points.items() if outcome.status[k] == Status.MULTIPLE_SHOOTING}
        records = problem.snapshot()
        fields = {name: records[:, place] for name, place in problem.record_fields.items()}
        some = outcome.status == Status.MULTIPLE_SHOOTING
        fields["unknowns"][some], fields["residual"][some] = unknowns[some], place.found.residual[some]
        fields["gamma"][some] = np.nan
        fields["position"][some], fields["rotation"][some] = position[some], rotation[some].reshape(-1, 9)
        problem.restore(records)
        outcome.breakpoints = points
        outcome.reached = np.array(results.level)
        return outcome

    def _polish(
        self,
        problem: BoundaryProblem,
        unknowns: FloatArray,
        poses: tuple[FloatArray, FloatArray],
        segments: Segments,
        outcome: Outcome,
        rounding: FloatArray,
    ) -> None:
        """Newton on the unknowns alone, which converges to the same pose where the problem is well conditioned; not tried where
        their ``rounding`` alone, (instance_count,), leaves far more than the tolerance."""
        problem.write("unknowns", unknowns)
        far, tolerance = ROUNDED if segments.end_held else ROUNDED_OFF, problem.tolerance(self.tolerance)
        tried = (outcome.status == Status.MULTIPLE_SHOOTING) & (rounding < far * tolerance)
        if tried.any():
            newton = Newton(problem, tolerance=self.tolerance, max_iterations=POLISH, line_search=False)
            newton.run(tried)
            single = newton.outcome()
            outcome.integrations += np.where(tried, single.integrations, 0)
            position, rotation = problem.read("position"), problem.read("rotation")
            off = np.linalg.norm(position - poses[0], axis=1) / segments.length(np.arange(len(tried)))
            off += np.linalg.norm(rotation - poses[1].reshape(-1, 9), axis=1)
            near = np.where(rounding < TOLD * tolerance, NEAR_POSE, SAME_POSE)
            outcome.status[tried & (single.status == Status.CONVERGED) & (off < near)] = Status.CONVERGED
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
        self.first: FloatArray | None = None
        self.points: Mapping[int, Breakpoints] = {}  # that the first is known by
        self.natural = True  # or from a guess, which may be unstable
        self.known = np.zeros(problem.instance_count, dtype=bool)
        self.last: Place | None = None  # of all instances; what is not known is of no meaning

    def start(self, unknowns: FloatArray) -> None:
        self.first = np.array(unknowns)
        self.points, self.problem.breakpoints = self.problem.breakpoints, {}
        self.natural = False

    def step(self) -> Outcome:
        with self.problem.everyone():
            return self._step()

    def _step(self) -> Outcome:
        solver, problem = self.solver, self.problem
        everyone = np.arange(problem.instance_count)
        first, self.first = self.first, None
        paths = solver._paths(problem, everyone, np.full(len(everyone), solver.max_integrations))
        if first is not None:
            results = paths.solve_from(first, self.points)
            self._anew(paths, results, ~knows(self.problem, first))
        elif not self.known.any():
            results = solver._natural(problem, paths)
        else:
            results = self._resume(paths)
        found = results.status == Status.MULTIPLE_SHOOTING
        if found.any():
            part = results.place.chosen(found)
            self.last = results.place if self.last is None else self.last.put(found, part)
            self.known |= found
        return solver._report(problem, paths, results, natural=self.natural)

    def _resume(self, paths: SegmentedPaths) -> Results:
        """From the last states; anew what has none, or is led off its branch."""
        solver, problem, known = self.solver, self.problem, self.known
        assert self.last is not None
        count = len(known)
        last = self.last.chosen(known)
        resumed = solver._paths(problem, np.flatnonzero(known), paths.allowed[known])
        some = resumed.resume(last)
        results = Results(np.full(count, int(Status.NOT_RUN)), self.last, np.full(count, np.nan), np.ones(count))
        results.put(known, some)
        paths.integrations[known], paths.iterations[known] = resumed.integrations, resumed.iterations
        self._anew(paths, results, results.status == Status.NOT_RUN)
        return results

    def _anew(self, paths: SegmentedPaths, results: Results, again: BoolArray) -> None:
        """Solve some instances without a guess."""
        if not again.any():
            return
        left = paths.allowed[again] - paths.integrations[again]
        anew = self.solver._paths(self.problem, np.flatnonzero(again), left)
        results.put(again, self.solver._natural(self.problem, anew))
        paths.integrations[again] += anew.integrations
        paths.iterations[again] = anew.iterations


def _load_scale(problem: BoundaryProblem) -> FloatArray:
    """Size of the full load against the stiffness, (instance_count,)."""
    return np.asarray(np.maximum(problem.load_scale(), 1e-300))


def _say(outcome: Outcome, places: IntArray, status: IntArray) -> BoolArray:
    """Put statuses of instances at these places, (k,), into the outcome, where they tell more than is known; where they do,
    (k,)."""
    said = ~failures(status) | np.isin(status, (Status.BRANCH_END, Status.INTEGRATION_LIMIT))
    outcome.status[places[said]] = status[said]
    doubtful = places[~said & (outcome.status[places] == Status.BRANCH_END)]
    outcome.status[doubtful] = Status.STALLED  # rounding hides whether it ends
    return said


def _ill_conditioned(problem: BoundaryProblem, outcome: Outcome) -> BoolArray:
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
