"""Where a controller goes on from, once loads have changed by more than a sample can follow."""

from typing import Any

import numpy as np

from multirod.integrators import Integrator
from multirod.results.solution import Solution
from multirod.running.simulation import simulate
from multirod.solvers.shooting import Shooting
from multirod.tasks.controlling.control import ControlStep
from multirod.tasks.formulation import Task
from multirod.tasks.freed import with_values
from multirod.tasks.watch import Watch

ONE = np.arange(1)  # the only instance


class Recovery:
    """Solves for the equilibrium under what is not free now, at the drives of the last good sample and from its equilibrium.

    Args:
        start: The first good one.
        integrator: Of the controller.
        step: Its sample.
    """

    def __init__(self, start: Solution[Any], integrator: Integrator, step: ControlStep) -> None:
        self._good, self._integrator, self._step = start, integrator, step
        self._good_under = self._tried_under = step.under
        self._failed = False

    def mind(self, sample: Solution[Any]) -> None:
        """A sample is over: it is where to go on from, or it failed."""
        self._failed = sample.status.failed
        if not self._failed:
            self._good, self._good_under = sample, self._step.under

    @property
    def wanted(self) -> bool:
        """Whether the last sample failed, what is not free is other than in the last good one, and that was not tried before."""
        return self._failed and self._step.under not in (self._good_under, self._tried_under)

    def run(self, task: Task, watch: Watch, given: Any, free: tuple[str, ...]) -> int:  # noqa: ANN401  (``Inputs``, unpacked)
        """Under the inputs given, those that are free as in the last good sample; integrations. Where there is none that is
        stable, the problem is as it was."""
        problem, values, self._tried_under = task.problem, self._step.good_values, self._step.under
        before = np.array(problem.read("unknowns")), task.values()
        now, before_now = with_values(given, free, values[0]), self._good._applied
        arrays = {name: np.stack([getattr(before_now, name), own]) for name, own in now.arrays.items()}
        way, method = now.with_arrays(arrays, (2,)), Shooting(integrator=self._integrator)
        guess = self._good.unknowns
        motion = simulate(
            self._good.robot, way, time=(0.0, 1.0), solver=method, guess=guess, device=problem.device, progress=False
        )
        spent, found = int(motion.integrations.sum()), motion[1]
        if found.status.failed:
            return spent
        x = np.array(problem.adopt(found.unknowns[None]))
        task.evaluate(x, values)
        gamma, record = watch.gamma(), problem.snapshot()
        if watch.unstable(ONE).any():
            task.write(*before)
            return spent + 1
        self._step.start(x, values, afresh=True)
        self._step.stand(record)
        watch.begin(ONE, gamma)
        task.write(x, values)
        return spent + 1 + task.count
