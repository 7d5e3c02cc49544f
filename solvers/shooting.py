"""Shooting: Newton's method with the exact Gamma, along the natural branch or along a motion."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from multirod.integrators import RK45, Integrator
from multirod.naming import OPTIONS_NAMED, fields_hinted
from multirod.problem import BoundaryProblem
from multirod.segments import Breakpoints
from multirod.solver import Left, Outcome, Solver, Track
from multirod.solvers.following.onward import in_segments
from multirod.solvers.newton.iteration import Newton
from multirod.solvers.starting.cold_start import ColdStart
from multirod.solvers.tracking.newton_track import NewtonTrack
from multirod.status import Status, failures
from multirod.validation import FloatArray, boolean, choice, positive_int

PREDICTORS = ("none", "linear", "quadratic", "adaptive")
AT_FOLD = ("follow", "stop")
SIDES = ("positive", "negative")
MOST_LEFT = 0.5  # of the instances: more are not left to be done with those of other parts of a batch


@fields_hinted(OPTIONS_NAMED)
@dataclass(frozen=True, kw_only=True)
class Shooting(Solver):
    """Newton's method, one integration an iteration, with a backtracking line search.

    Without a guess it finds the equilibrium on the natural branch, the one reached from the unloaded assembly by raising
    all loads in proportion: in one step where Newton's method contracts as it must on one branch and ``Gamma`` changes
    little, else by load continuation in steps that pass these tests and one more (``docs/solvers.md``).

    Attributes:
        tolerance: Largest residual, max norm [1/m]; None is 1e-9 for rods of usual size, and otherwise a part of the largest
            precurvature, or of one over the length: 1e-9 of it where that is less than 1/m, 1e-12 of it where it is more than
            1000/m, and for an integrator in ``"float32"`` 1e-5 (``docs/solvers.md``, Single precision). Of legs that are solved
            in pieces it is what the last digits of the unknowns move the residual by, if that is more.
        integrator: Of the spatial equations.
        max_iterations: Newton iterations allowed, in each continuation step and in all of a warm start. ``iterations`` of a
            solution counts those of all steps, and may be more.
        predictor: How a motion's next sample is guessed: from the last one (``"none"``), by ``"linear"`` or ``"quadratic"``
            extrapolation in time, or by whichever of these two foretold the last samples better (``"adaptive"``, the default),
            linear where lines that are driven by their lengths may turn slack.
        line_search: Whether steps that do not reduce the residual are halved.
        max_continuation_steps: Load steps allowed; where legs or networks are put together first, four times as many for joints
            and for loads.
        max_integrations: Integrations of a rod allowed in all that one solve does for an instance, or one sample of a motion:
            continuation, the search for a stable equilibrium and ``MultipleShooting`` (no more there than its own default). A rod
            that clamps cut into six pieces counts as six. What has taken them without a result, or would, ends as
            ``INTEGRATION_LIMIT``. The few that judge a result, or tell what is left of the residual, come on top.
        fallback: Whether ``MultipleShooting`` goes on where rounding or these steps end the natural branch, or lose a sample of
            a motion, after single precision double, and for legs that are pulled hard pieces of them (``docs/parallel.md``).
        at_fold: What is done where a branch ends: ``"follow"`` goes where a robot would whose loads are raised slowly, to the
            status ``BIFURCATED`` or ``SNAPPED``, or in a ``solve`` of curved tubes to ``LOWEST_ENERGY`` (``docs/branches.md``);
            ``"stop"`` ends there, with the status ``BRANCH_END``, and no other equilibrium is looked for.
        side: To which side it goes at a bifurcation: ``"positive"``, where the tip moves along a positive axis of the world, or
            ``"negative"``, to its twin; of tubes beyond a snap, which of two mirror images. Of a held rod that does not stretch,
            whose ends are pushed together, it is its middle that moves so (``docs/held.md``).

    Raises:
        ValueError: If a field is out of range.
    """

    tolerance: float | None = None
    integrator: Integrator = field(default_factory=RK45)
    max_iterations: int = 30
    predictor: str = "adaptive"
    line_search: bool = True
    max_continuation_steps: int = 1000
    max_integrations: int = 20_000
    fallback: bool = True
    at_fold: str = "follow"
    side: str = "positive"

    def __post_init__(self) -> None:
        self._check_integrator()
        self._check_tolerance()
        positive_int("Shooting.max_iterations", self.max_iterations)
        choice("Shooting.predictor", self.predictor, PREDICTORS)
        boolean("Shooting.line_search", self.line_search)
        positive_int("Shooting.max_continuation_steps", self.max_continuation_steps)
        positive_int("Shooting.max_integrations", self.max_integrations)
        boolean("Shooting.fallback", self.fallback)
        choice("Shooting.at_fold", self.at_fold, AT_FOLD)
        choice("Shooting.side", self.side, SIDES)

    @property
    def sign(self) -> int:
        """1, or -1 where it goes to the ``"negative"`` side."""
        return 1 if self.side == SIDES[0] else -1

    def newton(self, problem: BoundaryProblem) -> Newton:
        """Newton's iteration on a problem, with these options."""
        return Newton(problem, tolerance=self.tolerance, max_iterations=self.max_iterations, line_search=self.line_search)

    def _newton(self, problem: BoundaryProblem) -> Newton:
        """The same for one solve; it is kept with a problem that may be kept, for the next."""
        if not problem.may_be_kept:
            return self.newton(problem)
        key = ("Newton", self.tolerance, self.max_iterations, self.line_search)
        newton: Newton = problem.tool(key, lambda: self.newton(problem))
        newton.renew()
        return newton

    def _solve(self, problem: BoundaryProblem, guess: FloatArray | None) -> Outcome:
        newton, problem.side = self._newton(problem), self.sign
        if guess is None:
            return self._told(problem, ColdStart(self, problem, newton, poses_apart=True).run())
        problem.write("unknowns", guess)
        newton.allow(self.max_integrations)
        beyond = problem.out_of_reach()
        with problem.without_poses():
            newton.run(~beyond if beyond.any() else None)
        return newton.outcome()

    def _resume(self, problem: BoundaryProblem, guess: FloatArray, points: Mapping[int, Breakpoints]) -> Outcome:
        method = in_segments(self)
        if method.unsupported(problem) or problem.parts is None:
            return self._solve(problem, guess)
        problem.side = self.sign
        everyone = np.arange(problem.instance_count)
        part = problem.parts.of(everyone, double=True)
        allowed = np.full(len(everyone), min(self.max_integrations, method.max_integrations))
        outcome, _ = method.resume(part, guess, points, allowed)
        problem.keep(part, everyone)
        lost = np.flatnonzero(failures(outcome.status))
        if len(lost):  # by unknowns, though these hardly lead to tips
            part = problem.parts.of(lost)
            again = self._solve(part, guess[lost])
            problem.keep(part, lost)
            outcome.status[lost] = again.status
            outcome.iterations[lost] += again.iterations
            outcome.integrations[lost] += again.integrations
        return outcome

    def _solve_most(self, problem: BoundaryProblem) -> Outcome:
        problem.side = self.sign
        # what is put together from its joints, or was led to where its path begins, is known by more than is left
        if problem.parts is None or problem.joints is not None or problem.out_of_reach().any():
            return self._solve(problem, None)
        start = ColdStart(self, problem, self._newton(problem), poses_apart=True)
        start.raise_loads()
        if not problem.passed and 0 < start.lost.sum() <= MOST_LEFT * problem.instance_count:
            start.outcome.left = start.left()
            return start.outcome
        return self._told(problem, start.go_on())

    def _finish(self, problem: BoundaryProblem, left: Left) -> Outcome:
        problem.side = self.sign
        return ColdStart(self, problem, self._newton(problem), poses_apart=True).resume(left)

    def _told(self, problem: BoundaryProblem, outcome: Outcome) -> Outcome:
        if self.at_fold != "stop":
            _tell_passed(problem, outcome)
        return outcome

    def track(self, problem: BoundaryProblem, dt: float) -> Track:
        """Follow a motion, each sample from the last or from its extrapolation."""
        problem.side = self.sign
        return NewtonTrack(self, problem, None if self.predictor == "adaptive" else PREDICTORS.index(self.predictor))


def _tell_passed(problem: BoundaryProblem, outcome: Outcome) -> None:
    """Name what happened on the way to where paths began."""
    for k, event in problem.passed.items():
        if outcome.status[k] in (Status.CONVERGED, Status.BIFURCATED, Status.SNAPPED):
            outcome.events[k] = (event, *outcome.events.get(k, ()))
            outcome.status[k] = Status.BIFURCATED if outcome.status[k] == Status.CONVERGED else outcome.status[k]
