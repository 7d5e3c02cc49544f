"""The same way by problems that stand for instances that were lost: with rods in pieces, or what is rigid nearly so."""

from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from multirod.problem import BoundaryProblem
from multirod.results.events import placed_events
from multirod.solver import Outcome
from multirod.solvers.newton.iteration import Newton
from multirod.status import BoolArray, failures
from multirod.validation import FloatArray

if TYPE_CHECKING:
    from multirod.solvers.shooting import Shooting

MOST = 2000  # integrations of what stands for one; 60 to 400 are usual
NOISIEST = 1e3  # times the default tolerance: what rounding may leave of a residual


def solve_stand_ins(
    options: "Shooting",
    problem: BoundaryProblem,
    newton: Newton,
    outcome: Outcome,
    lost: BoolArray,
    ends: Mapping[int, FloatArray],
    at_fold: str,
) -> None:
    """Solve what stands for those ``lost``, by what the unknowns (n,) that they came to say, by instance.

    What that comes to is a result where Newton's method leads from there to an equilibrium that is not known to be unstable; else
    all is left as it is. ``at_fold`` is an option of ``Shooting``.
    """
    for place in np.flatnonzero(lost & options.fallback).tolist():
        left = int(outcome.left_of(options.max_integrations)[place])
        other = problem.stand_in(place, ends[place]) if place in ends and left > 0 else None
        if other is None:
            continue
        found = replace(options, at_fold=at_fold, fallback=False, max_integrations=min(left, MOST))._solve(other.problem, None)
        _count(outcome, place, found)
        if not failures(found.status)[0] and _taken(options, problem, newton, outcome, place, other.unknowns()):
            outcome.status[place] = found.status[0]
            outcome.events |= placed_events(found.events, np.array([place]))


def _taken(
    options: "Shooting", problem: BoundaryProblem, newton: Newton, outcome: Outcome, place: int, unknowns: FloatArray
) -> bool:
    """Whether there is an equilibrium of an instance beside unknowns (n,), to which it is led."""
    before, one = problem.read("unknowns"), np.zeros(problem.instance_count, dtype=bool)
    trial, one[place] = before.copy(), True
    trial[place] = unknowns
    with problem.only(one):
        gamma = problem.evaluate(trial)[1]
    # by how much the last digits of the unknowns move the residual
    noise = 0.5 * np.finfo(float).eps * (np.abs(gamma) @ np.abs(trial)[..., None]).max(axis=(1, 2))
    outcome.integrations[place] += 1
    newton.allow(outcome.left_of(options.max_integrations))
    with newton.no_finer(np.where(one, np.minimum(noise, NOISIEST * newton.tolerance()), 0.0)):
        newton.run(one)
    found = newton.outcome()
    _count(outcome, place, found, place)
    settled = not failures(found.status)[place]
    if settled and problem.stability is not None:
        outcome.integrations[place] += 1
        with problem.everyone():
            settled = not problem.stability.unstable()[place]
    if not settled:
        problem.write("unknowns", before)
    elif outcome.reached is not None:
        outcome.reached[place] = 1.0
    return bool(settled)


def _count(outcome: Outcome, place: int, found: Outcome, row: int = 0) -> None:
    outcome.iterations[place] += found.iterations[row]
    outcome.integrations[place] += found.integrations[row]
