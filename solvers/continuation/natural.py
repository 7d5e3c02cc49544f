"""The natural branch: all loads raised in proportion, from the unloaded equilibrium to the full load."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from multirod.capabilities import Loading
from multirod.problem import FEW, BoundaryProblem
from multirod.solver import Outcome
from multirod.solvers.continuation.acceptance import signs
from multirod.solvers.continuation.paths import Paths
from multirod.solvers.newton.iteration import Newton
from multirod.status import CONVERGED, BoolArray, Status, failures
from multirod.validation import FloatArray

TOGETHER = 4096  # instances whose columns at all nodes are held at once
FINER = 16  # times shorter steps, where a branch led to an unstable equilibrium
UNLOADED = 1e-9  # of ``EI/L^2``: loads that are none, and gaps that are closed
AT_END = 1e-5  # of the way, that is left where ends of rods hardly give way
NEARLY = 1e-4  # of the way, of which the rest may be in one
BEGINNINGS = 2  # elsewhere, of what came nowhere
AT_ONCE, HARDLY = 6, 1e-2  # integrations for that rest, and of the unknowns by which it may move


def natural_branch(
    problem: BoundaryProblem, newton: Newton, max_steps: int, chosen: BoolArray | None = None, handed: BoolArray | None = None
) -> Outcome:
    """Raise all loads in proportion, from the unloaded equilibrium to the full load; see ``Paths``.

    What has several equilibria unloaded is followed again in shorter steps where it came to an unstable one, which cannot be the
    end of a branch that starts stable; what does so again is lost: its status is ``BRANCH_END``. ``chosen`` (bool,
    (instance_count,)) leaves the other instances as they are; their status is ``CONVERGED``. With ``handed`` (bool,
    likewise), what creeps is given up: it is set there, and its status is ``STALLED``.
    """
    chosen = np.ones(problem.instance_count, dtype=bool) if chosen is None else chosen
    bounds, stability = problem.mode_bounds(), problem.stability
    if problem.may_jump and stability is not None and (chosen & (bounds[:, 1] >= 1)).any():
        stability.expect()  # as those are looked at
    allowed = newton.allowed()
    outcome = _from_together(problem, newton, max_steps, chosen, bounds)
    left = chosen if outcome is None else chosen & ~_has_branch(outcome)
    if outcome is None or left.any():
        paths = Paths.of(problem, newton, max_steps)
        paths.handed = handed
        with problem.led_on():
            raised = paths.raise_loads(left, bounds)
        if outcome is None:
            outcome = raised
        else:
            outcome.end_with(raised, left)
    newton.allow(allowed)  # from which what follows takes all that the outcome counts
    if problem.may_jump:
        _leave_unstable(problem, newton, max_steps, chosen, bounds, outcome)
    lost = outcome.status != CONVERGED
    if lost.any():
        _say_what_is_lost(problem, outcome, lost)
        _end_at_once(problem, newton, outcome)
        for tried in range(BEGINNINGS):
            _begin_again(problem, newton, max_steps, bounds, outcome, tried)
        _stand(problem, newton, outcome)
    return outcome


def _say_what_is_lost(problem: BoundaryProblem, outcome: Outcome, lost: BoolArray) -> None:
    """Which of those that are ``lost`` are undetermined or loose: told at the full load, by what is left of it there."""
    assert outcome.reached is not None  # of paths
    with problem.only(lost):
        problem.integrate()
    outcome.integrations += lost
    # what gives way on the way no longer does at its end; what does not give way gets nowhere
    there = np.isin(outcome.status, (Status.BRANCH_END, Status.STALLED, Status.SINGULAR_JACOBIAN)) & lost
    there &= (outcome.reached > 1 - AT_END) | (outcome.reached == 0)
    if there.any():
        outcome.status[there & problem.undetermined()] = Status.UNDETERMINED
        # what loads hold though it is loose is found by other ways
        at_rest = there & (problem.load_scale() < UNLOADED)
        if at_rest.any():
            outcome.status[at_rest & problem.is_loose()] = Status.LOOSE


def _end_at_once(problem: BoundaryProblem, newton: Newton, outcome: Outcome) -> None:
    """What is put together but for next to nothing, which is too little for the tests of steps: the rest of its way in one, by
    which it moves by next to nothing."""
    assert outcome.reached is not None  # of paths
    if problem.joints is None:
        return
    some = np.isin(outcome.status, (Status.STALLED, Status.BRANCH_END)) & (outcome.reached > 1 - NEARLY)
    if not some.any():
        return
    before, sign = problem.read("unknowns"), signs(_gamma(problem)[some])
    with newton.within(np.clip(newton.allowed() - outcome.integrations, 0, AT_ONCE)):
        newton.run(some)
    found, x = newton.outcome(), problem.read("unknowns")
    size = np.linalg.norm(x - before, axis=1)
    there = some & (found.status == CONVERGED) & (size <= HARDLY * np.linalg.norm(x, axis=1))
    there[some] &= signs(_gamma(problem)[some]) == sign
    problem.write("unknowns", np.where(there[:, None], x, before))
    outcome.iterations += some * found.iterations
    outcome.integrations += some * found.integrations
    outcome.status[there], outcome.reached[there] = CONVERGED, 1.0


def _begin_again(
    problem: BoundaryProblem, newton: Newton, max_steps: int, bounds: FloatArray, outcome: Outcome, tried: int
) -> None:
    """From elsewhere, of what came nowhere, though that was ``tried`` so often."""
    assert outcome.reached is not None  # of paths
    with problem.led_on():
        found = problem.begin_again(outcome.status, outcome.reached, tried)
        if found is None:
            return
        some, unknowns, taken = found
        outcome.integrations += some * taken
        with newton.within(np.maximum(newton.allowed() - outcome.integrations, 0)):
            again = Paths.of(problem, newton, max_steps).raise_loads(some, bounds, unloaded=unknowns)
    if (lost := some & (again.status != CONVERGED)).any():
        _say_what_is_lost(problem, again, lost)
        _end_at_once(problem, newton, again)
    outcome.end_with(again, some)


def _stand(problem: BoundaryProblem, newton: Newton, outcome: Outcome) -> None:
    """What no way leads to, as it gives no answer to what acts, but is an equilibrium where it stands."""
    found = problem.standing(outcome.status)
    if found is None or problem.stability is None or outcome.reached is None:
        return
    before, some = problem.read("unknowns"), found[0] & (outcome.integrations + 2 <= newton.allowed())
    if not some.any():
        return
    problem.write("unknowns", np.where(some[:, None], found[1], before))
    with newton.within(1):
        newton.run(some)
    there = some & (newton.outcome().status == CONVERGED)
    outcome.integrations += some.astype(int) + there
    there[there] = ~_unstable(problem, np.flatnonzero(there))
    problem.write("unknowns", np.where(there[:, None], found[1], before))
    outcome.status[there], outcome.reached[there] = CONVERGED, 1.0


def _gamma(problem: BoundaryProblem) -> FloatArray:
    """Of the last integration, (instance_count, n, n)."""
    return problem.read("gamma").reshape(problem.instance_count, problem.unknown_count, -1)


def let_go(problem: BoundaryProblem, newton: Newton, outcome: Outcome, chosen: BoolArray) -> BoolArray:
    """Let go of what the natural branch was ``led`` along; which instances are not at rest then, shape (instance_count,), and in
    a valley: their status is ``BRANCH_END``."""
    led = chosen & problem.led & ~failures(outcome.status)
    if not led.any():
        return led
    with problem.only(led):
        problem.integrate()
    outcome.integrations += led
    off = led & ~(np.abs(problem.read("residual")).max(axis=1) <= newton.tolerance())
    outcome.status[off] = Status.BRANCH_END
    return np.asarray(off)


def _has_branch(outcome: Outcome) -> BoolArray:
    """Which came to the end of a natural branch, at the full load or before: that is followed, and no other begun."""
    assert outcome.reached is not None
    return np.asarray(~failures(outcome.status) | ((outcome.status == int(Status.BRANCH_END)) & (outcome.reached > 0)))


def _from_together(
    problem: BoundaryProblem, newton: Newton, max_steps: int, chosen: BoolArray, bounds: FloatArray
) -> Outcome | None:
    """The natural branch of what is put together at once; the other instances have failed.

    None where there is nothing to be put together. What it took is no longer allowed to ``newton``.
    """
    joints = problem.joints
    found = None if joints is None else joints.together()
    if joints is None or found is None:
        return None
    tried, far = chosen & found.sound, chosen & found.sound & ~found.near
    outcome = Outcome.zeros(problem.instance_count)
    outcome.status[~chosen] = Status.CONVERGED
    outcome.reached = np.zeros(problem.instance_count)

    def took(integrations: NDArray[np.integer[Any]], iterations: NDArray[np.integer[Any]] | int = 0) -> None:
        outcome.iterations += iterations
        outcome.integrations += integrations
        newton.allow(np.maximum(newton.allowed() - integrations, 0))

    took(chosen * found.integrations)
    if far.any():
        # what is left of the residual would bend the way that loads lead
        joints.close(Loading.NONE)
        closed = Paths.of(problem, newton, max_steps).raise_from(far, found.unknowns, np.ones(problem.instance_count))
        joints.close(Loading.RISING)
        took(closed.integrations, closed.iterations)
        there = far & ~failures(closed.status)
        joints.shut(there)
        found.unknowns[there] = problem.read("unknowns")[there]
        tried &= ~far | there
    if tried.any():
        raised = Paths.of(problem, newton, max_steps).raise_loads(tried, bounds, unloaded=found.unknowns)
        took(raised.integrations, raised.iterations)
        assert raised.reached is not None  # of paths
        outcome.status[tried], outcome.reached[tried] = raised.status[tried], raised.reached[tried]
    return outcome


def _leave_unstable(
    problem: BoundaryProblem, newton: Newton, max_steps: int, chosen: BoolArray, bounds: FloatArray, outcome: Outcome
) -> None:
    """Follow those branches again that led to an unstable equilibrium."""
    stability = problem.stability
    assert stability is not None  # which says that a path may jump
    sure = bounds[:, 1] < 1
    if sure.any():
        # with one unstable mode at most, the sign of det Gamma says whether there is one
        sure &= np.linalg.det(_gamma(problem)) > 0
    places = np.flatnonzero(chosen & (outcome.status == CONVERGED) & ~sure & stability.has_potential)
    outcome.integrations[places] += 1
    places = places[_unstable(problem, places)]
    if not len(places):
        return
    if problem.parts is None:
        outcome.status[places] = Status.BRANCH_END
        return
    part = problem.parts.of(places)
    method = newton.of(part, places)
    method.allow(np.maximum(method.allowed() - outcome.integrations[places], 0))
    again = Paths(part, method, max_steps * FINER).raise_loads(np.ones(len(places), dtype=bool), bounds[places], FINER)
    unstable = np.flatnonzero(again.status == CONVERGED)
    again.status[unstable[_unstable(part, unstable)]] = Status.BRANCH_END
    outcome.status[places] = again.status
    if outcome.reached is not None and again.reached is not None:
        outcome.reached[places] = again.reached
    outcome.iterations[places] += again.iterations
    outcome.integrations[places] += again.integrations + 1
    problem.keep(part, places)


def _unstable(problem: BoundaryProblem, places: NDArray[np.intp]) -> BoolArray:
    """Whether the equilibria of some instances, (k,), are unstable, shape (k,)."""
    assert problem.stability is not None
    if len(places) == problem.instance_count <= FEW:
        with problem.everyone():
            return np.asarray(problem.stability.unstable())
    if problem.parts is None:
        return np.asarray(problem.stability.unstable()[places])
    result = np.zeros(len(places), dtype=bool)
    for part in np.split(np.arange(len(places)), range(TOGETHER, len(places), TOGETHER)):
        if len(part):
            stability = problem.parts.of(places[part]).stability
            result[part] = stability is not None and stability.unstable()
    return result
