"""Bends that the error of an integration makes of bifurcations.

``docs/branches.md``, The side.
"""

import numpy as np

from multirod.problem import BoundaryProblem
from multirod.solver import Outcome
from multirod.solvers.continuation.paths import Paths
from multirod.solvers.following.follow import FINER
from multirod.solvers.newton.iteration import Newton
from multirod.solvers.starting.judging import falling
from multirod.status import BoolArray, Status, failures
from multirod.validation import FloatArray

MANY = 24  # steps between two samples: what begins anew takes 18, what goes round such a bend 28 to 70
SAME = 1e-6  # unknowns that are, beside 1/m and themselves


def bent(paths: Paths, outcome: Outcome, calm: BoolArray, ahead: FloatArray, found: FloatArray) -> BoolArray:
    """Which of those that were ``calm``, as Newton's method led from where the motion went on to equilibria ``ahead``, have come
    to others, ``found``, in steps as short as such a bend asks for; unknowns [1/m], (instance_count, n)."""
    apart = ~np.isclose(ahead, found, rtol=SAME, atol=SAME).all(axis=1)
    return np.asarray(calm & apart & ~failures(outcome.status) & (paths.state.steps.numpy() > MANY))


def passed_unstable(problem: BoundaryProblem, paths: Paths, outcome: Outcome, some: BoolArray) -> BoolArray:
    """Which of some, (instance_count,), have gone round where modes vanish together, in as short steps, to what is unstable: of a
    round rod that is twisted at rest ``Gamma`` turns by the error of the integration where it would vanish."""
    lost = some & ~failures(outcome.status) & (paths.state.steps.numpy() > MANY)
    return falling(problem, outcome, lost)


def ended(
    problem: BoundaryProblem,
    newton: Newton,
    outcome: Outcome,
    chosen: BoolArray,
    before: FloatArray,
    last: FloatArray,
    safe_step: FloatArray,
    max_steps: int,
) -> tuple[BoolArray, FloatArray, FloatArray]:
    """Which of the ``chosen`` come to the end of a branch, by equations that are finer, on the way that they went in short steps.

    Args:
        problem: At the inputs where the way ends; its unknowns stay.
        newton: Its iteration, which says what is allowed.
        outcome: To which the integrations are added.
        chosen: Shape (instance_count,).
        before: Inputs where the way begins, shape (instance_count, input_count).
        last: Unknowns there [1/m], shape (instance_count, n).
        safe_step: As ``Paths.change_inputs`` has it, shape (instance_count,).
        max_steps: Steps along the way.

    Returns:
        Which, shape (instance_count,); the part of the way there (instance_count,), and their unknowns (instance_count, n).
    """
    lost, reached, ends = np.zeros_like(chosen), np.ones(len(chosen)), problem.read("unknowns")
    parts = problem.parts
    if parts is None:
        return lost, reached, ends
    for own in parts.kinds(np.flatnonzero(chosen)):
        part = parts.followed(own, FINER)
        fine, after = newton.of(part, own), part.read("inputs")
        part.write("inputs", before[own])
        part.write("unknowns", last[own])
        fine.run()
        begun = fine.outcome()
        paths, first, gamma = Paths(part, fine, max_steps), part.read("unknowns"), fine.gamma()
        part.write("inputs", after)
        fine.allow(np.maximum(fine.allowed() - begun.integrations, 0))
        again = paths.change_inputs(~failures(begun.status), before[own], first, gamma, safe_step=safe_step[own])
        outcome.integrations[own] += begun.integrations + again.integrations
        outcome.iterations[own] += begun.iterations + again.iterations
        assert again.reached is not None  # by every path
        lost[own] = ~failures(begun.status) & (again.status == Status.BRANCH_END)
        reached[own], ends[own] = again.reached, part.read("unknowns")
    return lost, reached, ends
