"""Assemblies put together from legs that nothing holds: another way to the natural branch, and to stable equilibria."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from multirod.batch import IntArray
from multirod.capabilities import Joints, Loading
from multirod.problem import BoundaryProblem
from multirod.results.events import BranchEvent, placed_events
from multirod.solver import Outcome
from multirod.solvers.continuation.acceptance import signs
from multirod.solvers.continuation.paths import SAFE_LOAD, Paths
from multirod.solvers.following.serving.requests import EDGES
from multirod.solvers.newton.iteration import Newton
from multirod.status import Status, failures
from multirod.validation import FloatArray

TOGETHER = 32  # instances put together in one batch
PATIENCE = 4  # times as many steps as the natural branch may take: many legs that are nearly joined are stiff, their steps short
CLOSING_STEP = 0.25  # of the way from apart to together, at first: four equilibria tell how the branch turns
SETTLING_STEPS = 200  # of the path of one start, in loads
EVALUATIONS = 800  # in which a branch is followed through its folds
FIRST_STEP, LONGEST_STEP, SMALLEST_STEP = 0.05, 1.0, 1e-6  # of its arclength, unknowns by the curvature scale
ITERATIONS = 7  # of Newton's method in a step
CONTRACTION = 0.4  # largest ratio of these
TURN = 0.9  # smallest cosine between the tangents at both ends of a step
CLOSE = 1e-6  # residual of a point on the branch, of the curvature scale
FURTHEST = 3.0  # that it may lead back beyond the start, in the whole way

BoolArray = NDArray[np.bool_]
Closed = dict[int, tuple[Status, float, FloatArray]]  # how joints closed: status, part of the way, unknowns there
GoOn = Callable[[BoundaryProblem, Newton, Outcome], None]


def assemble(
    problem: BoundaryProblem,
    newton: Newton,
    outcome: Outcome,
    lost: BoolArray,
    max_steps: int,
    go_on: GoOn | None = None,
    *,
    closed: Closed | None = None,
    closing: bool = False,
) -> BoolArray:
    """Put the instances ``lost`` together without loads, then raise these: ``CONVERGED`` unless what that leads to is unstable.

    Steps pass the tests of every branch (``Paths``), ``PATIENCE`` times ``max_steps`` at most for the joints and as many for the
    loads. What is not found is left as it is, but for why, where it goes down in energy to where no state is. ``go_on`` leads
    on from where a branch ends as loads are raised, or if so asked as joints are closed, and says so in the outcome that it is
    given; the load factor of what happens while joints are closed is 0. How joints close is put into ``closed``; from where that
    ended, what is ``closing`` goes on.

    Returns:
        Whose branch ended as loads were raised, (instance_count,).
    """
    lost, ended = lost & (newton.allowed() > 0), np.zeros(problem.instance_count, dtype=bool)
    if problem.joints is None or problem.parts is None or not lost.any():
        return ended
    for places in np.split(np.flatnonzero(lost), range(TOGETHER, int(lost.sum()), TOGETHER)):
        part = problem.parts.of(places)
        known = {k: closed[place] for k, place in enumerate(places.tolist())} if closing and closed is not None else {}
        found = _natural(part, newton.of(part, places), max_steps, go_on, known)
        if closed is not None:
            closed.update((place, known[k]) for k, place in enumerate(places.tolist()))
        ended[places] = (found.status == Status.BRANCH_END) & (found.reached == 1.0)
        outcome.iterations[places] += found.iterations
        outcome.integrations[places] += found.integrations
        edges = np.isin(found.status, EDGES)
        outcome.status[places[edges]] = found.status[edges]
        reached = np.flatnonzero(~failures(found.status))
        outcome.status[places[reached]] = found.status[reached]
        outcome.events |= placed_events(found.events, places)
        if outcome.reached is not None:
            outcome.reached[places[reached]] = 1.0
        problem.keep(part, places[reached], reached)
    return ended


def _natural(problem: BoundaryProblem, newton: Newton, max_steps: int, go_on: GoOn | None, known: Closed) -> Outcome:
    """First the joints, then the loads; statuses as ``Paths`` gives them, ``UNSTABLE`` where that is what is reached.

    ``reached`` is the part of the way by which joints were closed. Where it is ``known`` how that ended, ``go_on`` leads on from
    there; else it is put in.
    """
    paths = Paths(problem, newton, PATIENCE * max_steps)
    count, joints = problem.instance_count, _joints(problem)
    joints.close(Loading.NONE)
    apart = joints.apart()
    if known:
        ended = [known[k] for k in range(count)]
        closed = Outcome.zeros(count)
        closed.status, closed.reached = (np.array([own[i] for own in ended]) for i in (0, 1))
        problem.write("unknowns", np.array([own[2] for own in ended]))
        if go_on is not None:
            go_on(problem, newton, closed)
    else:
        closed = paths.raise_from(np.ones(count, dtype=bool), apart, np.full(count, CLOSING_STEP))
        assert closed.reached is not None  # of paths
        for k, unknowns in enumerate(problem.read("unknowns")):
            known[k] = Status(int(closed.status[k])), float(closed.reached[k]), unknowns
    joints.close(Loading.RISING)
    joints.shut()
    whole = ~failures(closed.status)
    newton.allow(np.maximum(newton.allowed() - closed.integrations - 3, 0))
    loaded = paths.raise_from(whole, problem.read("unknowns"), _safe_step(problem))
    if go_on is not None:
        loaded.status[~whole] = Status.NOT_RUN
        go_on(problem, newton, loaded)
    status = np.where(whole, loaded.status, closed.status)
    whole = ~failures(status)
    events = {k: tuple(map(_on_closing, own)) for k, own in closed.events.items() if whole[k]}
    for k, own in loaded.events.items():
        events[k] = (*events.get(k, ()), *own)
    for k, own in events.items():
        status[k] = max((event.status for event in own), default=status[k])
    if whole.any() and problem.stability is not None:
        with problem.everyone():
            status[whole & problem.stability.unstable()] = Status.UNSTABLE
    # legs that nothing holds take one, and the mismatch of their joints another
    integrations = 2 + closed.integrations + loaded.integrations + whole
    result = Outcome(status, closed.iterations + loaded.iterations, integrations, reached=closed.reached)
    result.events |= {k: own for k, own in events.items() if not Status(int(status[k])).failed}
    return result


def _on_closing(event: BranchEvent) -> BranchEvent:
    """As it happened while joints were closed, which give way until they are: what they store is in no potential."""
    return replace(event, load_factor=0.0, energy_lost=0.0 if event.status is Status.BIFURCATED else np.nan)


def settle(problem: BoundaryProblem, newton: Newton, numbers: IntArray, go_on: GoOn | None) -> Outcome:
    """Put every instance together at the places ``numbers`` (see ``Joints.apart``), joints and loads in proportion.

    ``go_on`` leads on from where that ends, and down from what is unstable; without it nothing does. What leads nowhere so is
    followed by its arclength, back and forth through the folds, to where it meets the full load with as many unstable modes as at
    the start, or two more, or four. Whether what that comes to is stable is for the caller to ask.
    """
    joints, everyone = _joints(problem), np.ones(problem.instance_count, dtype=bool)
    unknowns = joints.apart(numbers)
    with problem.everyone(), problem.at_load(0.0):
        sign = signs(problem.evaluate(unknowns)[1])
    outcome = Paths(problem, newton, SETTLING_STEPS).raise_from(everyone, unknowns, np.minimum(CLOSING_STEP, _safe_step(problem)))
    outcome.integrations += 3
    ends, left = problem.read("unknowns"), 1.0 - (np.zeros(len(sign)) if outcome.reached is None else outcome.reached)
    whole = outcome.status == Status.CONVERGED
    if whole.any() and problem.stability is not None:
        with problem.everyone():
            outcome.status[whole & problem.stability.unstable()] = Status.UNSTABLE
        outcome.integrations += whole
    if go_on is None:
        joints.shut()
        return outcome
    go_on(problem, newton, outcome)
    lost = failures(outcome.status) & ~whole & (sign != 0)
    if lost.any():
        joints.close(Loading.FULL)
        joints.open(np.where(lost[:, None], ends, problem.read("unknowns")))
        outcome.integrations += lost
        through = _through_folds(problem, lost, sign, left, outcome, newton.allowed())
        joints.close(Loading.RISING)
        newton.run(through)
        counts = newton.outcome()
        outcome.iterations += through * counts.iterations
        outcome.integrations += through * counts.integrations
        outcome.status[through] = counts.status[through]
    joints.shut()
    return outcome


def _joints(problem: BoundaryProblem) -> Joints:
    assert problem.joints is not None  # or nobody asked for it to be put together
    return problem.joints


def _safe_step(problem: BoundaryProblem) -> FloatArray:
    return np.asarray(SAFE_LOAD / np.maximum(problem.load_scale(), 1e-300))


def _through_folds(
    problem: BoundaryProblem,
    chosen: BoolArray,
    sign: FloatArray,
    left: FloatArray,
    outcome: Outcome,
    allowed: NDArray[np.integer[Any]],
) -> BoolArray:
    """Follow branches by their arclength from a load factor of 0 to 1, to where ``det Gamma`` has its ``sign`` there.

    The joints were opened at ``problem.unknowns``: the residual closes in proportion, so what it was is its derivative by the
    load factor. ``left`` (instance_count,) is the part of the whole way that this one is.

    Returns:
        Which of the ``chosen`` are there, shape (instance_count,); ``problem.unknowns`` are then near the equilibrium.
    """
    unit = problem.curvature_scale()[:, None]
    result = problem.read("unknowns")
    slope = problem.read("residual")
    places = np.flatnonzero(chosen).tolist()
    furthest = 1.0 - (1.0 + FURTHEST) / np.maximum(left, 1e-300)
    arcs = {i: _Arc(result[i] / unit[i], slope[i], sign[i], CLOSE * unit[i, 0], furthest[i]) for i in places}
    trial, level = result.copy(), np.zeros(len(result))
    on = chosen.copy()
    for _ in range(EVALUATIONS):
        on &= outcome.integrations < allowed
        if not on.any():
            break
        with problem.only(on), problem.at_load(level):
            residual, gamma = problem.evaluate(trial)
        outcome.integrations += on
        outcome.iterations += on
        for i in np.flatnonzero(on).tolist():
            arc = arcs[i]
            on[i] = arc.advance(residual[i], gamma[i] * unit[i])
            trial[i], level[i] = arc.trial[:-1] * unit[i], arc.trial[-1]
    there = chosen.copy()
    for i, arc in arcs.items():
        there[i] = arc.found is not None
        if arc.found is not None:
            result[i] = arc.found * unit[i]
    problem.write("unknowns", result)
    return there


class _Arc:
    """One branch by its arclength, told after each evaluation where the next is to be.

    Args:
        unknowns: Of the first point, in units of the curvature scale, shape (n,).
        slope: Derivative of the residual by the load factor, everywhere the same, shape (n,).
        sign: Of ``det Gamma`` where the branch is to end.
        close: Residual of a point.
        furthest: Load factor that it may lead back to.

    Attributes:
        trial: Unknowns and load factor to be evaluated next, shape (n + 1,).
        found: Unknowns near the end, shape (n,); None before.
    """

    def __init__(self, unknowns: FloatArray, slope: FloatArray, sign: float, close: float, furthest: float) -> None:
        self.slope, self.sign, self.close, self.furthest = slope, sign, close, furthest
        self.trial = np.append(unknowns, 0.0)
        self.found: FloatArray | None = None
        self._point = self.trial
        self._tangent = np.append(np.zeros(len(unknowns)), 1.0)
        self._step = FIRST_STEP
        self._first = True
        self._aim(0.0)

    def advance(self, residual: FloatArray, gamma: FloatArray) -> bool:
        """Take in residual (n,) and ``Gamma`` (n, n) at ``trial``; whether there is a next."""
        if np.isfinite(residual).all() and np.isfinite(gamma).all():
            square = np.vstack([np.column_stack([gamma, self.slope]), self._tangent])
            right = np.zeros((len(self.trial), 2))
            right[:-1, 0], right[-1, 0] = -residual, -self._tangent @ (self.trial - self._start)
            right[-1, 1] = 1.0
            try:
                move, along = np.linalg.solve(square, right).T
            except np.linalg.LinAlgError:
                return self._halve()
            if np.abs(residual).max() <= self.close:
                return self._keep(along / np.linalg.norm(along), float(signs(gamma)))
            if self._contracts(float(np.linalg.norm(move))):
                self.trial = self.trial + move
                return True
        return self._halve()

    def _aim(self, step: float) -> None:
        self._start = self.trial = self._point + step * self._tangent
        self._iteration, self._size, self._worst = 0, np.inf, 0.0

    def _contracts(self, size: float) -> bool:
        if self._iteration and size > 1e-7:
            self._worst = max(self._worst, size / self._size)
        self._size = size
        self._iteration += 1
        return self._worst <= CONTRACTION and self._iteration <= ITERATIONS

    def _keep(self, tangent: FloatArray, sign: float) -> bool:
        """Take in the point at ``trial``, unless the branch has turned too far since the last."""
        if not self._first:
            if tangent @ self._tangent < TURN:
                return self._halve()
            before, after = self._point[-1] - 1.0, self.trial[-1] - 1.0
            if before * after <= 0 and before != after and sign == self.sign:
                self.found = (self._point + before / (before - after) * (self.trial - self._point))[:-1]
                return False
            faster = float(np.clip(0.5 * CONTRACTION / max(self._worst, 1e-6), 0.5, 2.0))
            self._step = min(LONGEST_STEP, faster * self._step)
        self._point, self._tangent, self._first = self.trial, tangent, False
        self._aim(self._step)
        return bool(self._point[-1] > self.furthest)

    def _halve(self) -> bool:
        self._step /= 2
        self._aim(self._step)
        return not self._first and self._step >= SMALLEST_STEP
