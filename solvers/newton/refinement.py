"""Equilibria near folds, found again with a finer integration: its error moves them by the inverse of ``Gamma``."""

import numpy as np
from numpy.typing import NDArray

from multirod.problem import BoundaryProblem
from multirod.solver import Outcome
from multirod.solvers.newton.iteration import Newton
from multirod.status import Status, failures
from multirod.validation import FloatArray

AMPLIFICATION = 10.0  # largest norm of the inverse of Gamma with which the integration is taken as it is


def refine(problem: BoundaryProblem, newton: Newton, outcome: Outcome, chosen: NDArray[np.bool_]) -> None:
    """Find those of the ``chosen`` again whose ``Gamma`` is near singular, where the problem can be integrated finer.

    What is not found again on its side of the fold, or only by steps that do not contract at once, is lost within the error of
    the integration: its status is ``BRANCH_END``.
    """
    if problem.parts is None or not problem.parts.may_be_finer:
        return
    gamma = problem.read("gamma").reshape(problem.instance_count, problem.unknown_count, -1)
    places = np.flatnonzero(chosen & ~failures(outcome.status))
    places = places[_amplify(gamma[places])]
    part = problem.parts.finer(places) if len(places) else None
    if part is None:
        return
    again = newton.of(part, places)
    again.run()
    counts = again.outcome()
    signs = (np.sign(np.linalg.det(g.reshape(gamma[places].shape))) for g in (gamma[places], part.read("gamma")))
    found = (counts.status == Status.CONVERGED) & np.equal(*signs) & ~again.wandered()
    outcome.status[places[~found]] = np.where(
        counts.status[~found] == Status.INTEGRATION_LIMIT, Status.INTEGRATION_LIMIT, Status.BRANCH_END
    )
    outcome.iterations[places] += counts.iterations
    outcome.integrations[places] += counts.integrations
    problem.keep(part, places)


def _amplify(gamma: FloatArray) -> NDArray[np.bool_]:
    """Whether the inverse of a matrix (k, n, n) is that large, in the 2-norm; shape (k,)."""
    try:
        inverse = np.linalg.inv(gamma)
    except np.linalg.LinAlgError:
        result = np.ones(len(gamma), dtype=bool)
    else:
        # its Frobenius norm is never less, and soon known
        result = ~((inverse * inverse).sum(axis=(1, 2)) < AMPLIFICATION**2)
    if result.any():
        result[result] = np.linalg.svd(gamma[result], compute_uv=False)[:, -1] * AMPLIFICATION <= 1.0
    return np.asarray(result)
