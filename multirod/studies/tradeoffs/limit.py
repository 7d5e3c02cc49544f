"""Solvers that are stopped after some time."""

from threading import Event
from time import monotonic

from multirod.problem import BoundaryProblem
from multirod.solver import Outcome, Solver, Track
from multirod.validation import FloatArray


def now() -> float:
    """The time by which budgets are counted [s]."""
    return monotonic()


class Deadline(Event):
    """Set when a time has come, or another event is set."""

    def __init__(self, other: Event | None, at: float) -> None:
        super().__init__()
        self._other, self._at = other, at

    def is_set(self) -> bool:  # noqa: D102
        return now() >= self._at or (self._other is not None and self._other.is_set())


class Limited(Solver):
    """A solver that is stopped, by ``Interrupted``, at its next integration or sample when its time is over.

    Args:
        solver: The solver.
        seconds: From now on.
    """

    def __init__(self, solver: Solver, seconds: float) -> None:
        self._solver, self._at = solver, now() + seconds
        self.integrator = solver.integrator
        self.pose_sensitivities = solver.pose_sensitivities
        self.direction_count = solver.direction_count

    def unsupported(self, problem: BoundaryProblem) -> tuple[str, ...]:  # noqa: D102
        return self._solver.unsupported(problem)

    def track(self, problem: BoundaryProblem, dt: float) -> Track:  # noqa: D102
        return _LimitedTrack(self._solver.track(problem, dt), self._at)

    def _solve(self, problem: BoundaryProblem, guess: FloatArray | None) -> Outcome:
        problem.stop = Deadline(problem.stop, self._at)
        return self._solver.solve(problem, guess)


class _LimitedTrack(Track):
    def __init__(self, track: Track, at: float) -> None:
        self.problem, self._track, self._at = track.problem, track, at

    def start(self, unknowns: FloatArray) -> None:
        self._track.start(unknowns)

    def pace(self, before: float, after: float) -> None:
        self._track.pace(before, after)

    def step(self) -> Outcome:
        if not isinstance(self.problem.stop, Deadline):  # whoever runs the motion sets its own before the first sample
            self.problem.stop = Deadline(self.problem.stop, self._at)
        self.problem.heed_stop()
        return self._track.step()
