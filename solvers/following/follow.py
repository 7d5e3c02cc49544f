"""Instances whose branch ended, all on their way at once: every launch integrates for all of them."""

from collections.abc import Sequence
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from multirod.batch import IntArray
from multirod.problem import BoundaryProblem
from multirod.solver import Outcome
from multirod.solvers.continuation.pace import SINGLE_SETTLING, SINGLE_STEPS
from multirod.solvers.continuation.paths import SAFE_LOAD, SINGULAR, TURN
from multirod.solvers.following.journey import Journey
from multirod.solvers.following.serving.together import Together, split
from multirod.solvers.following.walk import NOISY, PIECES, Way
from multirod.status import Status, failures
from multirod.validation import FloatArray

ENDED = (Status.BRANCH_END, Status.MAX_ITERATIONS)  # of a way: where a branch ends, or creeps
TOGETHER = 4096  # instances on their way at once
FINER = 16  # times as many equal steps: their error is a 65,536th


def follow(
    problem: BoundaryProblem,
    outcome: Outcome,
    chosen: NDArray[np.bool_],
    *,
    unknowns: FloatArray,
    reached: FloatArray,
    tolerance: FloatArray,
    allowed: NDArray[np.integer[Any]],
    max_steps: int,
    side: int,
    before: FloatArray | None = None,
    slack: NDArray[np.bool_] | None = None,
    thorough: bool = False,
    times: int = 1,
    loud: float = np.inf,
) -> dict[int, Journey]:
    """Let the ``chosen`` instances go on from where their branches ended, or down from what is unstable at the end of its way;
    what comes to that end is put into the problem's buffers and the outcome.

    Args:
        problem: At the inputs where the way ends.
        outcome: Of the search that ended there.
        chosen: Shape (instance_count,).
        unknowns: Where it ended [1/m], shape (instance_count, n).
        reached: Part of the way there, shape (instance_count,).
        tolerance: Largest residual [1/m], shape (instance_count,).
        allowed: Integrations that each may take, shape (instance_count,).
        max_steps: Steps along a branch.
        side: 1, or -1 for the other one at each bifurcation.
        before: Inputs where the way begins, shape (instance_count, input_count); without them it is the loads that are raised.
        slack: Which are at the end of the way, but in a valley and not at rest, shape (instance_count,).
        thorough: As ``Way`` has it.
        times: By so many times as many steps of the integrator as usual, where these are equal.
        loud: As ``Way`` has it.

    Returns:
        By instance, those that rounding keeps from going on.
    """
    lost, stability, parts = dict[int, Journey](), problem.stability, problem.parts
    if parts is None or stability is None:
        return lost
    if stability.multistable and before is None and problem.joints is None and not parts.may_be_clamped:
        chosen = chosen & parts.loads_alone
    potential = stability.has_potential
    slack = np.zeros(problem.instance_count, dtype=bool) if slack is None else slack & potential & (reached == 1)
    chosen = chosen & ((reached < 1) | slack | (potential & (outcome.status == Status.UNSTABLE)))
    segmented = bool(chosen.any()) and problem.segments is not None
    singular = SINGULAR * problem.natural_singular_value if segmented else np.full(problem.instance_count, np.inf)

    def walked(own: IntArray, left: NDArray[np.integer[Any]], times: int) -> list[Journey]:
        # where branches end, the error of the integration moves what it finds the most
        part, steps = parts.followed(own, times), times * parts.steps_followed(own)
        start = None if before is None else before[own]
        safe = SAFE_LOAD / np.maximum(part.load_scale(), 1e-300) if start is None else np.ones(len(own))
        most = np.ones(len(own)) if start is None else TURN / np.maximum(part.turning(start), 1e-300)
        clampings = int(parts.may_be_clamped) if before is None else parts.clampings
        clamped = [partial(lambda way, some: parts.clamped(own[some], PIECES, times, way), k) for k in range(clampings)]
        together = Together(part, start, clamped, (unknowns[own], reached[own]))
        if segmented and before is None:
            together.most_steps = min(together.most_steps, SINGLE_STEPS)
            together.settling_steps = SINGLE_SETTLING
        tip = together.tip
        by_tip = tip is not None and len(tip.forces) > 0 and (problem.joints is None or not parts.all_clamped)
        journeys = [
            Journey(
                Way(
                    start=np.array(unknowns[place]),
                    level=float(reached[place]),
                    tolerance=float(tolerance[place]),
                    allowed=int(left[k]),
                    safe_step=float(safe[k]),
                    most_step=float(most[k]),
                    max_steps=max_steps,
                    side=side,
                    by_inputs=before is not None,
                    has_tip=tip is not None,
                    by_tip=by_tip,
                    doubtful=stability.multistable and before is None,
                    noisy=NOISY if segmented else np.inf,
                    singular=float(singular[place]),
                    potential=bool(potential[place]),
                    steps=steps,
                    clampings=len(clamped),
                    slack=bool(slack[place]),
                    thorough=thorough,
                    loud=loud,
                )
            )
            for k, place in enumerate(own)
        ]
        together.run([journey.run() for journey in journeys])
        return journeys

    for places in (some for kind in parts.kinds(np.flatnonzero(chosen)) for some in split(kind, TOGETHER)):
        journeys = walked(places, allowed[places], times)
        # the error of the integration may be steeper than the floor of a valley
        again = [k for k, own in enumerate(journeys) if own.valley and own.end is None and own.way.steps]
        if again:
            left = np.array([journeys[k].remaining for k in again])
            for k, own in zip(again, walked(places[again], left, FINER), strict=True):
                own.integrations += journeys[k].integrations
                own.iterations += journeys[k].iterations
                journeys[k] = own
        _polish(problem, places, journeys)
        _report(places, journeys, outcome)
        lost |= {int(place): journey for place, journey in zip(places, journeys, strict=True) if journey.lost is not None}
    return lost


def _polish(problem: BoundaryProblem, places: IntArray, journeys: Sequence[Journey]) -> None:
    """Take what came to an end to the problem's own equations, and into its buffers."""
    there = np.flatnonzero([journey.end is not None for journey in journeys])
    if not len(there):
        return
    assert problem.parts is not None  # as before
    own = problem.parts.of(places[there])
    Together(own, judged=False).run([journeys[k].polish() for k in there.tolist()])
    kept = np.flatnonzero([journeys[k].end is not None for k in there.tolist()])
    problem.keep(own, places[there[kept]], kept)


def _report(places: IntArray, journeys: Sequence[Journey], outcome: Outcome) -> None:
    outcome.iterations[places] += [journey.iterations for journey in journeys]
    outcome.integrations[places] += [journey.integrations for journey in journeys]
    for place, journey in zip(places.tolist(), journeys, strict=True):
        ended = journey.status is Status.BRANCH_END
        outcome.status[place] = journey.edge if ended and journey.edge is not Status.NOT_RUN else journey.status
        if journey.events and journey.end is not None and not journey.status.failed:
            outcome.events[place] = journey.told(journey.end.position)
        if journey.neutral and not journey.status.failed:
            outcome.turning.add(place)
    if outcome.reached is not None:
        outcome.reached[places[~failures(outcome.status[places])]] = 1.0
