"""Following a branch of equilibria in steps that are sure to stay on it."""

from collections.abc import Callable
from typing import Any

import numpy as np

from multirod.problem import BoundaryProblem
from multirod.solver import Outcome
from multirod.solvers.newton import Newton
from multirod.status import Status
from multirod.validation import FloatArray

CONTRACTION = 0.3  # largest ratio of successive Newton steps
GAMMA_CHANGE = 0.25  # smallest real part of an eigenvalue of Gamma_new Gamma_old^-1
SURPRISE = 0.5  # largest distance of an equilibrium from its extrapolation, relative to its distance from the last
SAFE_LOAD = 5.0  # in F L^2/EI: no equilibrium loses and regains stability within such a step (Euler: 2.5 and 22)
MIN_STEP = 1e-7


def natural_branch(problem: BoundaryProblem, newton: Newton, max_steps: int, chosen: Any = None) -> Outcome:
    """Raise all loads in proportion, from the unloaded equilibrium to the full load; see ``follow``.

    ``chosen`` (bool, (instance_count,)) leaves the other instances as they are; their status is ``CONVERGED``.
    """
    count, n = problem.instance_count, problem.unknown_count
    chosen = np.ones(count, dtype=bool) if chosen is None else chosen
    problem.load_factor.assign(np.where(chosen, 0.0, 1.0))
    problem.active.assign(chosen.astype(np.int32))
    problem.write("unknowns", np.where(chosen[:, None], problem.guess(), problem.read("unknowns")))
    problem.integrate()
    outcome = Outcome.zeros(count)
    outcome.integrations += chosen * (1 + problem.guess_integrations)
    outcome.status[~chosen] = Status.CONVERGED
    outcome.status[chosen & (problem.fault.numpy() != 0)] = Status.NONFINITE
    path = Path(problem.read("unknowns"), problem.read("gamma").reshape(count, n, n))
    scale = np.maximum(problem.load_scale(), 1e-300)

    follow(
        problem,
        newton,
        path,
        outcome,
        set_level=problem.load_factor.assign,
        largest_step=lambda level: np.maximum(SAFE_LOAD, 0.5 * level * scale) / scale,
        max_steps=max_steps,
    )
    problem.load_factor.fill_(1.0)
    lost = outcome.status != Status.CONVERGED
    if lost.any():
        # what is left of the residual at the full load
        problem.active.assign(lost.astype(np.int32))
        problem.integrate()
        outcome.integrations += lost
    return outcome


def follow(
    problem: BoundaryProblem,
    newton: Newton,
    path: "Path",
    outcome: Outcome,
    *,
    set_level: Callable[[FloatArray], object],
    largest_step: Callable[[FloatArray], FloatArray],
    max_steps: int,
) -> None:
    """Take the instances that were not run from level 0, where ``path`` starts, to level 1.

    Each step starts from the extrapolation of the last three equilibria. It is kept if Newton's undamped steps contract by
    ``CONTRACTION`` or better, as they do inside the ball around a solution in which it is the only one
    (Newton-Kantorovich), if ``Gamma`` at its end, times the inverse of that at its start, is near the identity: no mode has
    vanished or changed sign on the way, not even two at once, and if the equilibrium lies where the extrapolation led: near a
    bifurcation that is imperfect by a little, the other branch passes the first two tests. The step is otherwise halved; the
    branch ends where that takes it below ``MIN_STEP``.

    Args:
        problem: Its buffers hold the last equilibrium of each instance afterwards.
        newton: On the same problem.
        path: The equilibria at level 0.
        outcome: Updated; only instances with status ``NOT_RUN`` are followed.
        set_level: Puts the problem at the levels of all instances, shape (instance_count,).
        largest_step: Step allowed from a level, shape (instance_count,).
        max_steps: Steps allowed.
    """
    count, n = problem.instance_count, problem.unknown_count
    status = outcome.status
    step = np.minimum(1.0, largest_step(path.level))
    with newton.strict(CONTRACTION):
        for _ in range(max_steps):
            running = status == Status.NOT_RUN
            if not running.any():
                break
            goal = np.where(running, np.minimum(1.0, path.level + step), 1.0)
            set_level(goal)
            expected = path.extrapolate(goal)
            problem.write("unknowns", np.where(running[:, None], expected, problem.read("unknowns")))
            newton.run(running)
            found = newton.outcome()
            outcome.iterations += np.where(running, found.iterations, 0)
            outcome.integrations += np.where(running, found.integrations, 0)
            gamma = problem.read("gamma").reshape(count, n, n)
            kept = running & (found.status == Status.CONVERGED)
            kept[kept] = same_branch(path.gamma[kept], gamma[kept])
            unknowns = problem.read("unknowns")
            missed = np.linalg.norm(unknowns - expected, axis=1)
            moved = np.linalg.norm(unknowns - path.unknowns, axis=1)
            kept &= (path.order == 1) | (missed <= SURPRISE * moved + 1e-6 * (1 + np.linalg.norm(unknowns, axis=1)))
            reached = goal - path.level
            path.keep(kept, goal, unknowns, gamma)

            contraction = np.maximum(newton.state.contraction.numpy(), 1e-6)
            growth = np.clip((0.5 * CONTRACTION / contraction) ** (1 / path.order), 0.5, 3.0)
            step = np.where(kept, np.minimum(reached * growth, largest_step(path.level)), 0.5 * reached)
            status[kept & (path.level >= 1.0)] = Status.CONVERGED
            lost = running & ~kept & (step < MIN_STEP)
            if lost.any():
                status[lost] = _why(found.status, path, newton.tolerance)[lost]
    status[status == Status.NOT_RUN] = Status.MAX_ITERATIONS
    outcome.reached = path.level
    ended = status != Status.CONVERGED
    problem.write("unknowns", np.where(ended[:, None], path.unknowns, problem.read("unknowns")))


def _why(found: Any, path: "Path", tolerance: float) -> Any:
    """Status of instances whose step became too small."""
    floor = 2e-15 * np.linalg.norm(path.gamma, axis=(1, 2)) * np.abs(path.unknowns).max(axis=1)
    ended = np.where(floor > tolerance, int(Status.STALLED), int(Status.BRANCH_END))
    return np.where(np.isin(found, (Status.NONFINITE, Status.STEP_LIMIT)), found, ended)


class Path:
    """The last three equilibria of every instance on its way from level 0 to 1, and Gamma at the last."""

    def __init__(self, unknowns: FloatArray, gamma: FloatArray) -> None:
        count = len(unknowns)
        self.gamma = np.array(gamma)
        self.points = [np.array(unknowns) for _ in range(3)]
        self.levels = [np.zeros(count) for _ in range(3)]
        self.length = np.ones(count, dtype=int)

    @property
    def level(self) -> FloatArray:
        """Level reached, shape (instance_count,)."""
        return self.levels[0]

    @property
    def unknowns(self) -> FloatArray:
        """Unknowns there, shape (instance_count, n)."""
        return self.points[0]

    @property
    def order(self) -> Any:
        """Order of the extrapolation's error in the step, shape (instance_count,)."""
        return np.minimum(self.length, 3)

    def extrapolate(self, goal: FloatArray) -> FloatArray:
        """Unknowns at level ``goal`` from the polynomial through the known points (Newton's divided differences)."""
        a, b, c = self.levels
        with np.errstate(all="ignore"):
            first = (self.points[0] - self.points[1]) / (a - b)[:, None]
            second = (first - (self.points[1] - self.points[2]) / (b - c)[:, None]) / (a - c)[:, None]
        first = np.where((self.length > 1)[:, None], first, 0.0)
        second = np.where((self.length > 2)[:, None], second, 0.0)
        return np.asarray(self.points[0] + (goal - a)[:, None] * (first + (goal - b)[:, None] * second))

    def keep(self, kept: Any, level: FloatArray, unknowns: FloatArray, gamma: FloatArray) -> None:
        """Add an equilibrium to the instances ``kept``."""
        self.gamma[kept] = gamma[kept]
        for k in (2, 1):
            self.points[k][kept] = self.points[k - 1][kept]
            self.levels[k][kept] = self.levels[k - 1][kept]
        self.points[0][kept] = unknowns[kept]
        self.levels[0][kept] = level[kept]
        self.length[kept] = np.minimum(self.length[kept] + 1, 3)


def same_branch(before: FloatArray, after: FloatArray) -> Any:
    """Whether no mode of Gamma came near zero or changed sign between two equilibria; bool, one an instance."""
    if not len(before):
        return np.zeros(0, dtype=bool)
    identity = np.eye(before.shape[1])
    with np.errstate(all="ignore"):
        regular = (np.linalg.det(before) != 0) & np.isfinite(after).all(axis=(1, 2))
        base = np.where(regular[:, None, None], before, identity)
        ratio = np.linalg.solve(np.swapaxes(base, 1, 2), np.swapaxes(after, 1, 2))
        regular &= np.isfinite(ratio).all(axis=(1, 2))
        # no eigenvalue lies further from 1 than this norm, so most instances need no eigenvalues
        near = regular & (np.linalg.norm(ratio - identity, axis=(1, 2)) < 1 - GAMMA_CHANGE)
    unclear = regular & ~near
    values = np.linalg.eigvals(ratio[unclear])
    near[unclear] = (values.real > GAMMA_CHANGE).all(axis=1) & (np.abs(values) < 1 / GAMMA_CHANGE).all(axis=1)
    return near
