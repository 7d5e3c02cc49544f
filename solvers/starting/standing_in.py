"""The same way by problems that stand for instances that were lost: with rods in pieces, or what is rigid nearly so."""

from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from multirod.problem import BoundaryProblem
from multirod.results.events import placed_events
from multirod.solver import Outcome
from multirod.solvers.newton.iteration import Newton
from multirod.stand_in import StandIn
from multirod.status import BoolArray, Status
from multirod.validation import FloatArray

if TYPE_CHECKING:
    from multirod.solvers.shooting import Shooting

MOST = 2000  # integrations of what stands for one; 60 to 400 are usual
NOISIEST = 1e3  # times the default tolerance: what rounding may leave of a residual


class Eased(StandIn):
    """What twists a little more, its unknowns those of what does not."""

    def __init__(self, problem: BoundaryProblem) -> None:
        self.problem = problem

    @classmethod
    def of(cls, problem: BoundaryProblem, instance: int) -> "Eased | None":
        """One instance of a problem so; None where it twists as it is."""
        other = None if problem.parts is None else problem.parts.eased(instance)
        return None if other is None else cls(other)

    def unknowns(self) -> FloatArray:  # noqa: D102
        return np.array(self.problem.read("unknowns")[0])


def solve_stand_ins(
    options: "Shooting",
    problem: BoundaryProblem,
    newton: Newton,
    outcome: Outcome,
    lost: BoolArray,
    made: Callable[[int], StandIn | None],
    at_fold: str,
) -> None:
    """Solve what stands for those ``lost``, ``made`` for an instance by its number, if anything is.

    What that comes to is a result where Newton's method leads from there to an equilibrium that is not known to be unstable; else
    all is left as it is. ``at_fold`` is an option of ``Shooting``.
    """
    for place in np.flatnonzero(lost & options.fallback).tolist():
        left = int(outcome.left_of(options.max_integrations)[place])
        other = made(place) if left > 0 else None
        if other is None:
            continue
        found = replace(options, at_fold=at_fold, fallback=False, max_integrations=min(left, MOST))._solve(other.problem, None)
        _count(outcome, place, found)
        status = Status(int(found.status[0]))
        if not status.failed:
            led = _led(options, problem, newton, outcome, place, other.unknowns())
            status = status if led is Status.CONVERGED else led
        if not status.failed:
            outcome.status[place] = status
            outcome.events |= placed_events(found.events, np.array([place]))
        elif Status.UNDETERMINED in (status, outcome.status[place]):
            outcome.status[place] = status


def _led(
    options: "Shooting", problem: BoundaryProblem, newton: Newton, outcome: Outcome, place: int, unknowns: FloatArray
) -> Status:
    """Lead an instance to the equilibrium beside unknowns (n,): whether it is there, ``CONVERGED``."""
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
    status = Status(int(found.status[place]))
    if problem.undetermined()[place]:  # of what fails the torques rise without bound where the others are
        status = Status.UNDETERMINED
    if not status.failed and problem.stability is not None:
        outcome.integrations[place] += 1
        with problem.everyone():
            status = Status.UNSTABLE if problem.stability.unstable()[place] else status
    if status.failed:
        problem.write("unknowns", before)
    elif outcome.reached is not None:
        outcome.reached[place] = 1.0
    return status


def _count(outcome: Outcome, place: int, found: Outcome, row: int = 0) -> None:
    outcome.iterations[place] += found.iterations[row]
    outcome.integrations[place] += found.integrations[row]
