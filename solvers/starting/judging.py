"""What is asked of instances on the way of a cold start: whether they are unstable, and whether rounding hides their way on."""

import numpy as np

from multirod.problem import BoundaryProblem
from multirod.solver import Outcome
from multirod.solvers.following.descent import SOFT
from multirod.solvers.following.walk import NOISY
from multirod.stability import modes_of
from multirod.status import BoolArray
from multirod.validation import FloatArray


def falling(problem: BoundaryProblem, outcome: Outcome, some: BoolArray) -> BoolArray:
    """Which of some, (instance_count,), are unstable at the unknowns and inputs in the problem's buffers; an integration each."""
    places, parts, stability = np.flatnonzero(some), problem.parts, problem.stability
    result = np.zeros_like(some)
    if not len(places) or parts is None or stability is None:
        return result
    outcome.integrations[places] += 1
    result[places] = (modes_of(parts.of(places)).eigenvalue(0) < -SOFT) & stability.has_potential[places]
    return result


def amplifies(problem: BoundaryProblem, some: BoolArray, unknowns: FloatArray, level: FloatArray) -> BoolArray:
    """Of which of some instances an integration from the base may hide by rounding how they go on from ``unknowns`` at levels of
    the load, all of the first axis instance_count."""
    records = problem.snapshot()
    problem.write("unknowns", np.where(some[:, None], unknowns, problem.read("unknowns")))
    with problem.only(some), problem.at_load(np.where(some, level, 1.0)):
        problem.integrate()
    size = np.linalg.norm(np.nan_to_num(problem.read("gamma"), nan=np.inf), axis=1)
    problem.restore(records)
    return np.asarray(some & (size > NOISY))
