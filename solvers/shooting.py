"""Shooting: Newton's method with the exact Gamma, and continuation along the natural branch."""

from dataclasses import dataclass, field
from typing import Any

import numpy as np
import warp as wp

from multirod.models.integrators import RK45, Integrator
from multirod.problem import BoundaryProblem
from multirod.solver import Outcome, Solver, Track
from multirod.solvers.shooting_kernels import NewtonState, make_newton, restart
from multirod.status import Status
from multirod.validation import FloatArray, boolean, choice, positive_float, positive_int

PREDICTORS = ("none", "linear", "quadratic")
_MIN_LOAD_STEP = 1e-7
_SAFE_LOAD = 5.0  # in F L^2/EI: no equilibrium loses and regains stability within such a step (Euler: 2.5 and 22)
_CONTRACTION = 0.3
_GAMMA_CHANGE = 0.25


@dataclass(frozen=True, kw_only=True)
class Shooting(Solver):
    """Newton's method, one integration an iteration, with a backtracking line search.

    Without a guess it finds the equilibrium on the natural branch, the one reached from the unloaded assembly by raising
    all loads in proportion: in one step where Newton's method contracts as it must on one branch and ``Gamma`` changes
    little, else by load continuation whose steps pass the same two tests (``docs/solvers.md``).

    Attributes:
        tolerance: Largest residual, max norm [1/m].
        integrator: Of the spatial equations.
        max_iterations: Newton iterations allowed, in each continuation step and in all of a warm start.
        predictor: How a motion's next sample is guessed: from the last one (``"none"``), or by ``"linear"`` (default) or
            ``"quadratic"`` extrapolation in time.
        line_search: Whether steps that do not reduce the residual are halved.
        max_continuation_steps: Load steps allowed.

    Raises:
        ValueError: If a field is out of range.
    """

    tolerance: float = 1e-9
    integrator: Integrator = field(default_factory=RK45)
    max_iterations: int = 30
    predictor: str = "linear"
    line_search: bool = True
    max_continuation_steps: int = 1000

    def __post_init__(self) -> None:
        self._check_integrator()
        positive_float("Shooting.tolerance", self.tolerance)
        positive_int("Shooting.max_iterations", self.max_iterations)
        choice("Shooting.predictor", self.predictor, PREDICTORS)
        boolean("Shooting.line_search", self.line_search)
        positive_int("Shooting.max_continuation_steps", self.max_continuation_steps)

    def _solve(self, problem: BoundaryProblem, guess: FloatArray | None) -> Outcome:
        newton = Newton(problem, self)
        if guess is not None:
            problem.write("unknowns", guess)
            newton.run()
            return newton.outcome()
        return natural_branch(problem, newton, self)

    def track(self, problem: BoundaryProblem, dt: float) -> Track:
        """Follow a motion, each sample from the last or from its extrapolation."""
        return NewtonTrack(self, problem)


class Newton:
    """Newton's iteration on the buffers of one problem; launches are recorded once."""

    def __init__(self, problem: BoundaryProblem, options: Shooting) -> None:
        self.problem = problem
        n, count, device = problem.unknown_count, problem.instance_count, problem.device
        state: Any = NewtonState()
        self.state = state
        for name in ("active", "fault", "unknowns", "residual", "gamma"):
            setattr(state, name, getattr(problem, name))
        for name in ("status", "iterations", "integrations"):
            setattr(state, name, wp.zeros(count, dtype=wp.int32, device=device))
        for name in ("merit", "damping", "contraction"):
            setattr(state, name, wp.zeros(count, dtype=wp.float64, device=device))
        state.accepted = wp.zeros((count, n), dtype=wp.float64, device=device)
        state.step = wp.zeros((count, n), dtype=wp.float64, device=device)
        state.remaining = wp.zeros(1, dtype=wp.int32, device=device)
        state.tolerance = options.tolerance
        state.max_iterations = options.max_iterations
        state.line_search = int(options.line_search)
        state.max_contraction = np.inf
        self._record()
        on_cpu = wp.get_device(device).is_cpu
        self._remaining = state.remaining.numpy() if on_cpu else None
        self._counts = [state.status.numpy(), state.iterations.numpy(), state.integrations.numpy()] if on_cpu else None

    def _record(self) -> None:
        count, device = self.problem.instance_count, self.problem.device
        kernel = make_newton(self.problem.unknown_count)
        self._launch = wp.launch(kernel, dim=count, inputs=[self.state], device=device, record_cmd=True)
        self._reset = wp.launch(restart, dim=count, inputs=[self.state], device=device, record_cmd=True)

    def configure(self, *, tolerance: float, line_search: bool, max_contraction: float = np.inf) -> None:
        """Change options for the runs that follow."""
        self.state.tolerance = tolerance
        self.state.line_search = int(line_search)
        self.state.max_contraction = max_contraction
        self._record()

    def run(self, chosen: Any = None) -> None:
        """Iterate the chosen instances (bool, (instance_count,); all by default) from ``problem.unknowns`` to their ends."""
        self._reset.launch()
        if chosen is not None:
            self.state.active.assign(np.asarray(chosen, dtype=np.int32))
        while self.iterate():
            pass

    def iterate(self) -> int:
        """One integration of all active instances, and what follows from it; the number still active."""
        if self._remaining is not None:
            self._remaining[0] = 0
        else:
            self.state.remaining.zero_()
        self.problem.integrate()
        self._launch.launch()
        return int(self._remaining[0] if self._remaining is not None else self.state.remaining.numpy()[0])

    def outcome(self) -> Outcome:
        """Copies of the counts and statuses."""
        state = self.state
        counts = self._counts or [state.status.numpy(), state.iterations.numpy(), state.integrations.numpy()]
        return Outcome(*(count.copy() for count in counts))


def natural_branch(problem: BoundaryProblem, newton: Newton, options: Shooting) -> Outcome:
    """Raise all loads in proportion, from the unloaded equilibrium to the full load.

    Each step starts from the extrapolation of the last three equilibria. It is kept if Newton's steps contract by
    ``_CONTRACTION`` or better, as they do inside the ball around a solution in which it is the only one
    (Newton-Kantorovich), and if ``Gamma`` at its end, times the inverse of that at its start, is near the identity: no
    mode has vanished or changed sign on the way, not even two at once. The step is otherwise halved; the branch ends
    where that takes it below ``_MIN_LOAD_STEP``.
    """
    count, n = problem.instance_count, problem.unknown_count
    total = Outcome.zeros(count)
    scale = np.maximum(problem.load_scale(), 1e-300)
    step = np.minimum(1.0, _SAFE_LOAD / scale)
    path = _Path(problem.guess())
    status = total.status

    # Gamma of the unloaded assembly
    problem.load_factor.zero_()
    problem.active.fill_(1)
    problem.write("unknowns", path.unknowns)
    problem.integrate()
    total.integrations += 1
    gamma = problem.read("gamma").reshape(count, n, n)
    status[problem.fault.numpy() != 0] = Status.NONFINITE

    newton.configure(tolerance=options.tolerance, line_search=False, max_contraction=_CONTRACTION)
    for _ in range(options.max_continuation_steps):
        running = status == Status.NOT_RUN
        if not running.any():
            break
        goal = np.minimum(1.0, path.load + step)
        problem.load_factor.assign(np.where(running, goal, 1.0))
        problem.write("unknowns", path.extrapolate(goal))
        newton.run(running)
        found, iterations, integrations = (
            newton.state.status.numpy(),
            newton.state.iterations.numpy(),
            newton.state.integrations.numpy(),
        )
        total.iterations += np.where(running, iterations, 0)
        total.integrations += np.where(running, integrations, 0)
        trial = problem.read("gamma").reshape(count, n, n)
        kept = running & (found == Status.CONVERGED)
        kept[kept] = _same_branch(gamma[kept], trial[kept])
        reached = goal - path.load
        gamma[kept] = trial[kept]
        path.keep(kept, goal, problem.read("unknowns"))

        contraction = np.maximum(newton.state.contraction.numpy(), 1e-6)
        growth = np.clip((0.5 * _CONTRACTION / contraction) ** (1 / path.order), 0.5, 3.0)
        limit = np.maximum(_SAFE_LOAD, 0.5 * path.load * scale) / scale
        step = np.where(kept, np.minimum(reached * growth, limit), 0.5 * reached)
        status[kept & (path.load >= 1.0)] = Status.CONVERGED
        lost = running & ~kept & (step < _MIN_LOAD_STEP)
        if lost.any():
            overflow = np.isin(found, (Status.NONFINITE, Status.STEP_LIMIT))
            floor = 2e-15 * np.linalg.norm(gamma, axis=(1, 2)) * np.abs(path.unknowns).max(axis=1)
            rounding = floor > options.tolerance
            why = np.where(overflow, found, np.where(rounding, int(Status.STALLED), int(Status.BRANCH_END)))
            status[lost] = why[lost]
    status[status == Status.NOT_RUN] = Status.MAX_ITERATIONS
    problem.load_factor.fill_(1.0)
    problem.write("unknowns", path.unknowns)
    newton.configure(tolerance=options.tolerance, line_search=options.line_search)
    return total


class _Path:
    """The last three equilibria of every instance on its way from load 0 to 1."""

    def __init__(self, unknowns: FloatArray) -> None:
        count = len(unknowns)
        self.points = [np.array(unknowns) for _ in range(3)]
        self.loads = [np.zeros(count) for _ in range(3)]
        self.length = np.ones(count, dtype=int)

    @property
    def load(self) -> FloatArray:
        return self.loads[0]

    @property
    def unknowns(self) -> FloatArray:
        return self.points[0]

    @property
    def order(self) -> Any:
        """Order of the extrapolation's error in the load step, shape (instance_count,)."""
        return np.minimum(self.length, 3)

    def extrapolate(self, goal: FloatArray) -> FloatArray:
        """Unknowns at load ``goal`` from the polynomial through the known points (Newton's divided differences)."""
        a, b, c = self.loads
        with np.errstate(all="ignore"):
            first = (self.points[0] - self.points[1]) / (a - b)[:, None]
            second = (first - (self.points[1] - self.points[2]) / (b - c)[:, None]) / (a - c)[:, None]
        first = np.where((self.length > 1)[:, None], first, 0.0)
        second = np.where((self.length > 2)[:, None], second, 0.0)
        return np.asarray(self.points[0] + (goal - a)[:, None] * (first + (goal - b)[:, None] * second))

    def keep(self, kept: Any, load: FloatArray, unknowns: FloatArray) -> None:
        for k in (2, 1):
            self.points[k][kept] = self.points[k - 1][kept]
            self.loads[k][kept] = self.loads[k - 1][kept]
        self.points[0][kept] = unknowns[kept]
        self.loads[0][kept] = load[kept]
        self.length[kept] = np.minimum(self.length[kept] + 1, 3)


def _same_branch(before: FloatArray, after: FloatArray) -> Any:
    """Whether no mode of Gamma came near zero or changed sign between two equilibria; bool, one an instance."""
    if not len(before):
        return np.zeros(0, dtype=bool)
    with np.errstate(all="ignore"):
        ratio = np.linalg.solve(np.swapaxes(before, 1, 2), np.swapaxes(after, 1, 2))
        values = np.linalg.eigvals(np.where(np.isfinite(ratio), ratio, 0.0))
    return (values.real > _GAMMA_CHANGE).all(axis=1) & (np.abs(values) < 1 / _GAMMA_CHANGE).all(axis=1)


class NewtonTrack(Track):
    """Newton along a motion: the last samples' unknowns, extrapolated, start the next."""

    def __init__(self, options: Shooting, problem: BoundaryProblem) -> None:
        self.options = options
        self.problem = problem
        self.newton = Newton(problem, options)
        self.order = PREDICTORS.index(options.predictor)
        self.history: list[FloatArray] = []

    def start(self, unknowns: FloatArray) -> None:
        """Take ``unknowns`` as the sample before the first."""
        self.history = [np.array(unknowns)]

    def step(self) -> Outcome:
        """Extrapolate, and iterate to the tolerance."""
        if not self.history:
            return self._keep(self.options._solve(self.problem, None))
        past = self.history
        if len(past) > 2:
            guess = 3 * (past[0] - past[1]) + past[2]
        elif len(past) == 2:
            guess = 2 * past[0] - past[1]
        else:
            guess = past[0]
        self.problem.write("unknowns", guess)
        self.newton.run()
        return self._keep(self.newton.outcome())

    def _keep(self, outcome: Outcome) -> Outcome:
        found = self.problem.read("unknowns")
        good = outcome.status == Status.CONVERGED
        if good.all():
            self.history = [found, *self.history][: self.order + 1]
        elif self.history:
            # what failed starts again from its last equilibrium, without a slope
            self.history = [np.where(good[:, None], found, past) for past in [self.history[0], *self.history][: self.order + 1]]
        return outcome
