"""On from where branches ended, by what ``Shooting`` allows: down in energy, and in segments where rounding hides the way."""

from typing import TYPE_CHECKING

import numpy as np

from multirod.problem import BoundaryProblem
from multirod.solver import Outcome
from multirod.solvers.following.follow import follow
from multirod.solvers.multiple_shooting import MultipleShooting
from multirod.solvers.newton.iteration import Newton
from multirod.status import BoolArray, IntArray, Status, failures
from multirod.validation import FloatArray

if TYPE_CHECKING:
    from multirod.solvers.shooting import Shooting


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
    noisy = follow(
        problem,
        outcome,
        lost,
        unknowns=unknowns,
        reached=reached,
        tolerance=newton.tolerance(),
        allowed=outcome.left_of(options.max_integrations) if left is None else left,
        max_steps=options.max_continuation_steps,
        side=options.sign,
        before=before,
        slack=slack,
        thorough=thorough,
        times=times,
    )
    if options.fallback and before is None:
        ends = {k: (own.lost.unknowns, own.lost.level, own.steps) for k, own in noisy.items() if own.lost is not None}
        tried = in_segments(options).go_on(problem, outcome, ends, outcome.left_of(options.max_integrations))
        position = problem.read("position")
        for k in np.flatnonzero(~failures(tried)).tolist():
            outcome.status[k], outcome.events[k] = noisy[k].said, noisy[k].told(position[k])
    outcome.status[creeping & (outcome.status == Status.BRANCH_END)] = Status.MAX_ITERATIONS  # it did not end there
