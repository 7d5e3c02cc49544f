"""Equilibria at other inputs than those at which their states are known, reached in steps of the inputs."""

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from multirod.problem import BoundaryProblem
from multirod.segments import Breakpoints, placed, taken
from multirod.solver import Outcome
from multirod.solvers.continuation.paths import GROWTH, SAFE_LOAD
from multirod.status import NOT_RUN, BoolArray, IntArray, failures
from multirod.validation import FloatArray

if TYPE_CHECKING:
    from multirod.solvers.multiple_shooting import MultipleShooting

ATTEMPT = 40  # integrations that a step may take: it takes 10 to 20, or fails
HALVINGS = 8  # of a step of the inputs
IN_ALL = 600  # integrations that all may take: from the unloaded rod it takes half as many


def unsafe(problem: BoundaryProblem, change: FloatArray) -> BoolArray:
    """Whether loads have changed by so much, (instance_count,), to what they are that modes may have vanished in pairs."""
    nothing = np.zeros_like(problem.read("inputs"))
    return np.asarray(change > np.maximum(SAFE_LOAD, GROWTH * problem.load_change(nothing)))


def good(status: IntArray) -> BoolArray:
    """Which instances were found, and on their branches."""
    return np.asarray(~failures(status) & (status != NOT_RUN))


def states_of(
    method: "MultipleShooting",
    problem: BoundaryProblem,
    places: NDArray[np.intp],
    unknowns: FloatArray,
    inputs: FloatArray,
    steps: IntArray | None = None,
) -> dict[int, Breakpoints]:
    """Breakpoints of the instances at ``places``, (k,), that ``unknowns`` (k, n) lead to at other ``inputs`` than the problem's,
    (instance_count, k), by so many ``steps`` as ``MultipleShooting.states`` has them; the problem is left as it is."""
    assert problem.parts is not None  # or there is no method
    now = problem.read("inputs")
    problem.write("inputs", inputs)
    try:
        part = problem.parts.of(places, double=True)
        part.write("unknowns", unknowns)
        return placed(method.states(part, np.arange(len(places)), steps), places)
    finally:
        problem.write("inputs", now)


def change_inputs(
    method: "MultipleShooting",
    problem: BoundaryProblem,
    last: Mapping[int, Breakpoints],
    before: FloatArray,
    allowed: IntArray,
) -> tuple[Outcome, dict[int, Breakpoints]]:
    """Some instances on their branches from where they were to the problem's inputs, in steps in which no two modes vanish, and
    which are halved where they lead nowhere.

    Args:
        method: Which does a step.
        problem: At the inputs where the way ends; its buffers hold there what was found.
        last: Breakpoints where the way begins, by instance.
        before: Inputs there, (instance_count, k).
        allowed: Integrations that each may take, (instance_count,).

    Returns:
        How each ended, ``NOT_RUN`` where it was led off its branch; and by what breakpoints those are known that were found,
        though unknowns may lead to their tips as well.
    """
    outcome, points = Outcome.zeros(problem.instance_count), dict[int, Breakpoints]()
    here, now, known = before.copy(), problem.read("inputs"), dict(last)
    halved, allowed = np.zeros(len(here)), np.minimum(allowed, IN_ALL)
    steady = np.ones(len(here), dtype=bool)  # if the last step led on
    places = np.array(list(known), dtype=int)
    assert problem.parts is not None  # or there is no method
    try:
        while len(places):
            share = _share(problem, here, now) * 0.5**halved
            ahead = np.where(share[:, None] < 1, here + share[:, None] * (now - here), now)
            problem.write("inputs", ahead)
            part = problem.parts.of(places, double=True)
            left = np.minimum(allowed[places] - outcome.integrations[places], ATTEMPT)
            mine, own = method.resume_branch(part, taken(known, places), here[places], left)
            led, there = good(mine.status), share[places] == 1
            outcome.status[places] = np.where(led & ~there, NOT_RUN, mine.status)
            outcome.iterations[places] += mine.iterations
            outcome.integrations[places] += mine.integrations
            found, new = np.flatnonzero(led & there), placed(taken(own, np.flatnonzero(led)), places[led])
            problem.keep(part, places[found], found)
            outcome.breakpoints |= placed(taken(mine.breakpoints, found), places[found])
            known |= new
            points |= {k: new[k] for k in places[found].tolist()}
            here[places[led]] = ahead[places[led]]
            longer = np.maximum(halved[places] - steady[places], 0)  # what was halved just now is too long once more
            halved[places] = np.where(led, longer, halved[places] + 1)
            steady[places] = led
            on = (halved[places] <= HALVINGS) & (outcome.integrations[places] < allowed[places])
            places = places[np.where(led, ~there, on)]
    finally:
        problem.write("inputs", now)
    return outcome, points


def _share(problem: BoundaryProblem, here: FloatArray, now: FloatArray) -> FloatArray:
    """How much of the way between two inputs (instance_count, k) is one step, shape (instance_count,)."""
    share = np.ones(len(now))
    problem.write("inputs", now)
    change = problem.load_change(here)
    for _ in range(HALVINGS):
        far = unsafe(problem, share * change)
        if not far.any():
            break
        share[far] *= 0.5
        problem.write("inputs", here + share[:, None] * (now - here))
    return share
