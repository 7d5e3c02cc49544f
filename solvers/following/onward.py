"""On from where branches ended, by what ``Shooting`` allows: down in energy, and in segments where rounding hides the way."""

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from multirod.problem import BoundaryProblem
from multirod.solver import Outcome
from multirod.solvers.following.follow import follow
from multirod.solvers.following.journey import Journey
from multirod.solvers.multiple_shooting import MultipleShooting
from multirod.solvers.newton.iteration import Newton
from multirod.solvers.segments.by_inputs import change_inputs, good, states_of
from multirod.status import NOT_RUN, BoolArray, IntArray, Status, failures
from multirod.validation import FloatArray

if TYPE_CHECKING:
    from multirod.solvers.shooting import Shooting


LOUD = 1e5  # norm of Gamma where a walk hands over to segments: what rounds off unknowns is a tenth of the tolerance there


def in_segments(options: "Shooting") -> MultipleShooting:
    """Multiple shooting by the same options."""
    return MultipleShooting(
        tolerance=options.tolerance, integrator=options.integrator, max_continuation_steps=options.max_continuation_steps
    )


def go_on(
    options: "Shooting",
    problem: BoundaryProblem,
    newton: Newton,
    outcome: Outcome,
    lost: BoolArray,
    reached: FloatArray,
    unknowns: FloatArray,
    *,
    before: FloatArray | None = None,
    left: IntArray | None = None,
    slack: BoolArray | None = None,
    thorough: bool = False,
    times: int = 1,
) -> None:
    """Let the instances ``lost`` go on from where their branches ended; what is not followed stays as it is.

    Args:
        options: Whose.
        problem: At the inputs where the way ends.
        newton: Its iteration.
        outcome: Of the search that ended there; what comes of it is put in.
        lost: Shape (instance_count,).
        reached: Part of the way there, shape (instance_count,).
        unknowns: Where it ended [1/m], shape (instance_count, n).
        before: Inputs where the way begins, shape (instance_count, input_count); without them it is the loads that are raised.
        left: Integrations that each may take, shape (instance_count,); by default what ``options`` leave.
        slack: Which are at the end of the way, but in a valley and not at rest, shape (instance_count,); none by default.
        thorough: Whether more is tried where nothing is come to, as nothing else is likely to lead on.
        times: By how many times as many steps of the integrator as usual.
    """
    if options.at_fold == "stop" or not lost.any():
        return
    creeping = lost & (outcome.status == Status.MAX_ITERATIONS)
    segmented = options.fallback and not in_segments(options).unsupported(problem)

    def followed(some: BoolArray, allowed: IntArray, loud: float) -> dict[int, Journey]:
        noisy = follow(
            problem,
            outcome,
            some,
            unknowns=unknowns,
            reached=reached,
            tolerance=newton.tolerance(),
            allowed=allowed,
            max_steps=options.max_continuation_steps,
            side=options.sign,
            before=before,
            slack=slack,
            thorough=thorough,
            times=times,
            loud=loud,
        )
        if segmented:
            _in_segments(options, problem, outcome, noisy, before)
        return noisy

    most = outcome.left_of(options.max_integrations) if left is None else left
    noisy = followed(lost, most, LOUD if segmented else np.inf)
    again = np.zeros_like(lost)
    # the others would go the same way
    hushed = {k: own.lost for k, own in noisy.items() if own.hushed and own.lost is not None}
    again[[k for k, point in hushed.items() if np.linalg.norm(point.gamma) > LOUD]] = segmented
    again &= failures(outcome.status)
    if again.any():  # what segments lose may go on as ever
        followed(again, outcome.left_of(options.max_integrations), np.inf)
    outcome.status[creeping & (outcome.status == Status.BRANCH_END)] = Status.MAX_ITERATIONS  # it did not end there


def _in_segments(
    options: "Shooting", problem: BoundaryProblem, outcome: Outcome, lost: Mapping[int, Journey], before: FloatArray | None
) -> None:
    """Let the instances of journeys that rounding has ended, or led astray, go on in segments from where that is not so."""
    neutral, asked = {k: own.events[-1].neutral if own.events else 0 for k, own in lost.items()}, options.integrator.steps or 0
    for modes in sorted(set(neutral.values())):
        some = {k: own for k, own in lost.items() if neutral[k] == modes}
        ends = {
            # what never moved was found by the equations that were asked for
            k: (own.lost.unknowns, own.lost.level, asked if np.array_equal(own.lost.unknowns, own.way.start) else own.way.steps)
            for k, own in some.items()
            if own.lost is not None
        }
        left = outcome.left_of(options.max_integrations)
        if before is None:
            tried = in_segments(options).go_on(problem, outcome, ends, left, modes)
        else:
            tried = _by_inputs(options, problem, outcome, ends, left, before)
        position = problem.read("position")
        for k in np.flatnonzero(good(tried)).tolist():
            if some[k].said is not Status.CONVERGED:  # else it is as segments say: known by its states alone, maybe
                outcome.status[k] = some[k].said
            outcome.events[k] = some[k].told(position[k])
            if modes:
                outcome.turning.add(k)


def _by_inputs(
    options: "Shooting",
    problem: BoundaryProblem,
    outcome: Outcome,
    ends: Mapping[int, tuple[FloatArray, float, int]],
    left: IntArray,
    before: FloatArray,
) -> IntArray:
    """The same of a motion, in steps of the inputs from the part of the way from those ``before`` where each was; how each ended,
    (instance_count,)."""
    if not ends or problem.parts is None:
        return np.full(problem.instance_count, NOT_RUN)
    method, places = in_segments(options), np.array(list(ends))
    unknowns, level, steps = (np.array(values) for values in zip(*ends.values(), strict=True))
    start = before.copy()
    start[places] += level[:, None] * (problem.read("inputs") - before)[places]
    last = states_of(method, problem, places, unknowns, start, steps)
    again, points = change_inputs(method, problem, last, start, left)
    found = list(points)
    outcome.status[found] = again.status[found]
    outcome.iterations += again.iterations
    outcome.integrations += again.integrations
    outcome.breakpoints |= again.breakpoints
    return again.status
