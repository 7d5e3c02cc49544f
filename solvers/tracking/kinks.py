"""A motion past the kink between taut and slack, (L8e) of ``docs/lines.md``: is its sample on the branch of the last one?"""

from dataclasses import dataclass
from itertools import chain, combinations

import numpy as np

from multirod.problem import BoundaryProblem
from multirod.solver import Outcome
from multirod.solvers.continuation.paths import Paths
from multirod.solvers.newton.iteration import Newton
from multirod.solvers.newton.newton_kernels import LARGE_CHANGE
from multirod.solvers.starting.letting_out import let_out, loosened
from multirod.status import CONVERGED, BoolArray, IntArray, Status
from multirod.validation import FloatArray

MOST_TOGETHER = 8  # lines that turn at once, of which all minors are looked at


def passed_kinks(problem: BoundaryProblem, newton: Newton, chosen: BoolArray, before: FloatArray) -> BoolArray:
    """Those of the ``chosen``, which have converged, that follow from the last sample's unknowns ``before`` though lines have
    become taut or slack since; (instance_count,)."""
    result = np.zeros(problem.instance_count, dtype=bool)
    kinks = problem.kinks
    if not len(kinks) or newton.eliminated is not None:
        return result
    turned = (before[:, kinks] > 0) != (problem.read("unknowns")[:, kinks] > 0)
    n = problem.unknown_count
    for k in np.flatnonzero(chosen & ~newton.slowed() & turned.any(axis=1)).tolist():
        last, here = (matrices[k].reshape(n, n) for matrices in (newton.reference(), newton.gamma()))
        result[k] = follows(last, here, kinks[turned[k]])
    return result


def follows(last: FloatArray, here: FloatArray, turned: IntArray) -> bool:
    """(L8e) Whether no mode has vanished between ``last`` and ``here``, two ``Gamma`` (n, n), where the columns of the unknowns
    ``turned`` have jumped on the way."""
    if len(turned) > MOST_TOGETHER:
        return False
    try:
        jump = np.linalg.solve(last, here[:, turned])[turned]
        sides = chain.from_iterable(combinations(range(len(turned)), count) for count in range(1, len(turned) + 1))
        if not all(np.linalg.det(jump[np.ix_(side, side)]) > 0 for side in sides):
            return False
        other = last.copy()
        other[:, turned] = here[:, turned]
        change = np.linalg.eigvals(np.linalg.solve(other.T, here.T)) - 1
    except np.linalg.LinAlgError:
        return False
    return bool(np.abs(change).max() < LARGE_CHANGE)


@dataclass(frozen=True)
class Ways:
    """From the last good samples of a motion to what is asked for.

    Attributes:
        paths: On which inputs change.
        newton: On the same problem.
        before: Inputs of these samples, shape (instance_count, input_count).
        last: Their unknowns, shape (instance_count, n).
        most: Integrations that a sample may take.
    """

    paths: Paths
    newton: Newton
    before: FloatArray
    last: FloatArray
    most: int


def found_let_out(problem: BoundaryProblem, ways: Ways, outcome: Outcome, stuck: BoolArray) -> BoolArray:
    """(L8c) of ``docs/lines.md``: what is ``stuck`` beside a line at its kink, from the last good sample with all lines longer,
    on a way where they are. Which were found; the status of others is as it was, or says that tensions rise without bound."""
    newton, asked = ways.newton, problem.read("inputs")
    newton.allow(outcome.left_of(ways.most))

    def find(some: BoolArray) -> Outcome:
        longer = problem.read("inputs")
        start = ways.before + longer - asked
        problem.write("inputs", start)
        problem.write("unknowns", np.where(some[:, None], loosened(problem, ways.last), problem.read("unknowns")))
        newton.run(some)
        first, ready = newton.outcome(), some & (newton.outcome().status == CONVERGED)
        problem.write("inputs", longer)
        found = ways.paths.change_inputs(ready, start, problem.read("unknowns"), newton.gamma())
        found.status[some & ~ready] = int(Status.STALLED)
        found.iterations += first.iterations
        found.integrations += first.integrations
        return found

    known = outcome.status.copy()
    outcome.status[stuck] = Status.STALLED
    unbounded = let_out(problem, newton, outcome, stuck, find)
    found = stuck & (outcome.status == CONVERGED)
    outcome.status[stuck & ~found] = known[stuck & ~found]
    outcome.status[unbounded] = Status.LINES_TOO_SHORT
    return np.asarray(found)
