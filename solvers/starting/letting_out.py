"""Lines at the kink between taut and slack: found from where all are a hair longer, (L8c) of ``docs/lines.md``."""

from collections.abc import Callable
from typing import Protocol

import numpy as np

from multirod.problem import BoundaryProblem
from multirod.solver import Outcome
from multirod.status import BoolArray, IntArray, Status, failures
from multirod.validation import FloatArray

NEAR_END = 1e-3  # of the load, from its end, on which a line at its kink ends a path
HAIR = 1e-6  # by which lines are let out first, times one over the size of curvatures
FINER = 1e-3  # of that, next
AT_KINK = 1e-3  # unknown, beside the size of curvatures, of a line that is slack by a hair only
BALANCED = 1e-9  # of displacements, by which their sum may differ from zero where one line is to be at its kink
LAST = 0.3  # of the tolerance, by which lines are loose at the end


class Corrector(Protocol):
    """What leads from unknowns of a problem to an equilibrium near them, such as ``Newton``."""

    def tolerance(self) -> FloatArray:
        """Of the residual, shape (instance_count,)."""

    def allowed(self) -> IntArray:
        """Integrations that may be taken, shape (instance_count,)."""

    def allow(self, most: IntArray) -> None:
        """Set these."""

    def run(self, chosen: BoolArray) -> None:
        """Lead the ``chosen`` to equilibria; their unknowns stand in the problem's buffer."""

    def outcome(self) -> Outcome:
        """How the last run ended."""


def near_the_end(problem: BoundaryProblem, outcome: Outcome, chosen: BoolArray) -> BoolArray:
    """Those of the ``chosen`` whose path ended just before its load, where lines may be at their kinks; (instance_count,)."""
    if not len(problem.kink_inputs) or outcome.reached is None:
        return np.zeros(problem.instance_count, dtype=bool)
    ended = np.isin(outcome.status, (Status.STALLED, Status.BRANCH_END, Status.LINE_LIMIT, Status.LINES_TOO_SHORT))
    return np.asarray(chosen & ended & (outcome.reached > 1 - NEAR_END))


def at_kinks(problem: BoundaryProblem, unknowns: FloatArray) -> BoolArray:
    """Where a line that does not stretch is at its kink by ``unknowns`` (instance_count, n); (instance_count,)."""
    if not len(problem.kink_inputs):
        return np.zeros(problem.instance_count, dtype=bool)
    return np.asarray((np.abs(unknowns[:, problem.kinks]) < HAIR * problem.curvature_scale()[:, None]).any(axis=1))


def let_out(
    problem: BoundaryProblem,
    newton: Corrector,
    outcome: Outcome,
    chosen: BoolArray,
    find: Callable[[BoolArray], Outcome],
    *,
    tight: bool = False,
) -> BoolArray:
    """(L8c) Find those of the ``chosen`` where a line is at its kink: ``find`` leads to where lines are let out by a hair, and
    Newton's method, of all unknowns or of those at the base, from there to where they are not; where it leads to none that is
    slack by a hair only, it ends there as well if that is ``tight``.

    Returns:
        Which are at a kink but lead to no end: as the hair vanishes, their tensions rise without bound; (instance_count,).
    """
    scale, tolerance, before = problem.curvature_scale(), newton.tolerance(), problem.read("unknowns")
    asked, kinks = problem.read("inputs"), problem.kinks
    hair, allowed = HAIR / scale, newton.allowed()

    def let(by: FloatArray) -> None:
        longer = asked.copy()
        longer[:, problem.kink_inputs] -= np.where(chosen, by, 0.0)[:, None]
        problem.write("inputs", longer)

    def spend(spent: Outcome) -> None:
        outcome.iterations[:] += np.where(chosen, spent.iterations, 0)
        outcome.integrations[:] += np.where(chosen, spent.integrations, 0)
        allowed[:] = np.maximum(allowed - np.where(chosen, spent.integrations, 0), 0)
        newton.allow(allowed)

    def looseness() -> FloatArray:
        """Of lines that are slack by a hair, the most; zero where there are none."""
        z = -problem.read("unknowns")[:, kinks]
        return np.asarray(np.where((z > 0) & (z < AT_KINK * scale[:, None]), z, 0.0).max(axis=1))

    let(hair)
    found = find(chosen)
    spend(found)
    here = chosen & ~failures(found.status) & ((looseness() > 0) | tight)
    going = here.copy()
    for stage in range(3):
        if not going.any():
            break
        if stage == 0:
            hair = FINER * hair
        else:
            # in proportion, and then nothing is left to let out: what remains is within the tolerance
            hair = hair * np.minimum(LAST * tolerance / np.maximum(looseness(), 1e-300), 1.0) if stage == 1 else 0.0 * hair
        let(hair)
        newton.run(going)
        again = newton.outcome()
        again.integrations[~going] = again.iterations[~going] = 0
        spend(again)
        going &= ~failures(again.status)
    problem.write("inputs", asked)
    problem.write("unknowns", np.where(going[:, None], problem.read("unknowns"), before))
    outcome.status[going] = Status.CONVERGED
    return np.asarray(here & failures(outcome.status))


def let_out_first(
    problem: BoundaryProblem, newton: Corrector, chosen: BoolArray, find: Callable[[BoolArray], Outcome]
) -> Outcome:
    """The same before any other way of those whose displacements sum to zero and whose lines do not stretch, so that one is to be
    at its kink; the others have not run."""
    outcome = Outcome.zeros(len(chosen))
    if not len(problem.kink_inputs):
        return outcome
    pulls = problem.read("inputs")[:, problem.kink_inputs]
    size = np.abs(pulls).sum(axis=1)
    some = chosen & (size > 0) & (np.abs(pulls.sum(axis=1)) <= BALANCED * size)
    if not some.any() or not (some := some & ~problem.kinks_give()).any():
        return outcome
    outcome.status[some] = Status.STALLED
    let_out(problem, newton, outcome, some, find, tight=True)
    return outcome


def loosened(problem: BoundaryProblem, unknowns: FloatArray) -> FloatArray:
    """Unknowns (instance_count, n) with lines that are at their kinks slack by a hair, to start from."""
    result, kinks, scale = unknowns.copy(), problem.kinks, problem.curvature_scale()[:, None]
    z = unknowns[:, kinks]
    result[:, kinks] = np.where(np.abs(z) < HAIR * scale, -HAIR * scale, z)
    return result
