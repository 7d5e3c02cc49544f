"""Lines at the kink between taut and slack, by segments: (L8c) of ``docs/lines.md``."""

from copy import copy

import numpy as np

from multirod.problem import BoundaryProblem
from multirod.solver import Outcome
from multirod.solvers.segments.path import Results, SegmentedPaths
from multirod.solvers.starting.letting_out import let_out, near_the_end
from multirod.status import BoolArray, IntArray, Status
from multirod.validation import FloatArray


class Loosened:
    """Instances whose natural branches may have ended beside a line at its kink; what leads on from where lines are longer.

    Args:
        problem: Of the instances.
        paths: Of some of them, which have followed their branches.
        results: Of these, in which what is found is put.
    """

    def __init__(self, problem: BoundaryProblem, paths: SegmentedPaths, results: Results) -> None:
        self.problem, self.paths, self.results = problem, paths, results
        self._tolerance, self._allowed = (np.zeros(problem.instance_count, dtype=kind) for kind in (float, int))
        self._tolerance[paths.instances], self._allowed[paths.instances] = paths.tolerance, paths.allowed
        self._allowed[paths.instances] -= paths.integrations
        self._outcome = Outcome.zeros(problem.instance_count)

    def let_out(self) -> None:
        """Find what is at a kink, and say ``LINES_TOO_SHORT`` of what has no end there."""
        problem, paths, results = self.problem, self.paths, self.results
        outcome = Outcome.zeros(problem.instance_count)
        outcome.status[:] = Status.CONVERGED
        outcome.status[paths.instances] = results.status
        outcome.reached = np.ones(problem.instance_count)
        outcome.reached[paths.instances] = results.level
        at_end = near_the_end(problem, outcome, np.ones(problem.instance_count, dtype=bool))
        if not at_end.any():
            return
        self._last = copy(results)
        for name in ("status", "residual", "level"):
            setattr(self._last, name, getattr(results, name).copy())
        unbounded = let_out(problem, self, outcome, at_end, self._from_the_unloaded)
        mine = paths.instances
        paths.iterations += outcome.iterations[mine]
        paths.integrations += outcome.integrations[mine]
        found = (at_end & (outcome.status == Status.CONVERGED))[mine]
        if found.any():
            last = self._last
            part = Results(last.status[found], last.place.chosen(found), last.residual[found], last.level[found])
            results.put(found, part)
        results.status[unbounded[mine]] = Status.LINES_TOO_SHORT

    # ---- what ``Corrector`` asks for ----

    def tolerance(self) -> FloatArray:  # noqa: D102
        return self._tolerance

    def allowed(self) -> IntArray:  # noqa: D102
        return self._allowed.copy()

    def allow(self, most: IntArray) -> None:  # noqa: D102
        self._allowed = most.copy()

    def run(self, chosen: BoolArray) -> None:  # noqa: D102
        some = chosen[self.paths.instances]
        paths = self._paths(some)
        self._take(some, paths, paths.settled(self._last.place.cuts.chosen(some)))

    def outcome(self) -> Outcome:  # noqa: D102
        return self._outcome

    def _from_the_unloaded(self, chosen: BoolArray) -> Outcome:
        """Along natural branches."""
        some, problem = chosen[self.paths.instances], self.problem
        paths = self._paths(some)
        scale = np.maximum(problem.load_scale(), 1e-300)
        self._take(some, paths, paths.follow(problem.guess()[paths.instances], scale[paths.instances]))
        return self._outcome

    def _paths(self, some: BoolArray) -> SegmentedPaths:
        """Ways of some of the instances, anew."""
        instances = self.paths.instances[some]
        return self.paths.of(instances, self._tolerance[instances], self._allowed[instances])

    def _take(self, some: BoolArray, paths: SegmentedPaths, found: Results) -> None:
        """What was found of some of the instances, and by how much."""
        self._last.put(some, found)
        outcome = self._outcome = Outcome.zeros(self.problem.instance_count)
        outcome.status[paths.instances] = found.status
        outcome.iterations[paths.instances], outcome.integrations[paths.instances] = paths.iterations, paths.integrations
        unknowns = self.problem.read("unknowns")
        unknowns[paths.instances] = found.place.cuts.unknowns
        self.problem.write("unknowns", unknowns)
