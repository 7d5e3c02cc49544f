"""One round of an iteration: an integration, what the kernel asks of ``Gamma``, and the kernel."""

from collections.abc import Callable

import numpy as np
import warp as wp
from numpy.typing import NDArray

from multirod.kernels.warp_types import Array
from multirod.launch import Launch
from multirod.problem import BoundaryProblem


class Rounds:
    """Of one kernel on the buffers of a problem, over the instances that launches pass over.

    Args:
        problem: The problem.
        remaining: Where the kernel counts what is still on its way, shape (1,).
    """

    def __init__(self, problem: BoundaryProblem, remaining: Array) -> None:
        self._problem, self._remaining = problem, remaining
        # on a processor it is read and written in place
        self.remaining = remaining.numpy() if wp.get_device(problem.device).is_cpu else None
        self._dim = problem.instance_count

    def aim(self, launch: Launch) -> None:
        """Have a launch pass over what is listed."""
        if self._dim != self._problem.listed:
            self._dim = self._problem.listed
            launch.set_dim(self._dim)

    def take(
        self,
        launch: Launch,
        eliminate: Callable[[], None],
        *,
        integrated: bool = False,
        coarsely: NDArray[np.int32] | None = None,
    ) -> int:
        """One round, without the integration where that has been done, by few steps of the integrator where ``coarsely`` is 1;
        how many are still on their way."""
        if self.remaining is not None:
            self.remaining[0] = 0
        else:
            self._remaining.zero_()
        if not integrated and coarsely is not None:
            self._problem.integrate_some_coarsely(coarsely)
        elif not integrated:
            self._problem.integrate()
        eliminate()
        self.aim(launch)
        launch.launch()
        return int(self.remaining[0] if self.remaining is not None else self._remaining.numpy()[0])
