"""What kernels read of a task's integration, whose unknowns they eliminate. Numbers in parentheses: ``docs/tasks.md``."""

import numpy as np
import warp as wp

from multirod.kernels.shared import Shared
from multirod.tasks.condensed_kernels import Condensed
from multirod.tasks.formulation import Task

POSE = 6


class Columns:
    """Columns of a task as kernels read them: those of the integration, or what ``aimed`` makes of these.

    Args:
        task: Aimed at what is free.
        target: Argument of a kernel, which gets them.
    """

    def __init__(self, task: Task, target: Condensed) -> None:
        self._task = task
        self._own: list[Shared] = []
        problem = task.problem
        if task.in_place:
            target.slopes, target.moved, target.first = problem.residual_directions, problem.pose_columns, problem.unknown_count
            return
        count, n, k = problem.instance_count, problem.unknown_count, task.count
        self._own = [Shared((count, rows, k), wp.float64, problem.device) for rows in (n, POSE)]
        target.slopes, target.moved = (own.array for own in self._own)
        target.first = 0

    @property
    def in_place(self) -> bool:
        """Whether kernels read them where the integration leaves them."""
        return not self._own

    def update(self) -> None:
        """After an integration."""
        if self._own:
            for own, values in zip(self._own, self._task.aimed(), strict=True):
                own.values[:] = values
                own.send()


def condensed(task: Task) -> tuple[Condensed, Columns]:
    """The argument of kernels that begin at a task's integration, and what keeps its columns."""
    problem, state = task.problem, Condensed()
    problem.share(state, ("fault", "unknowns", "inputs", "residual", "gamma", "position", "rotation", "pose_columns"))
    count, n, k = problem.instance_count, problem.unknown_count, task.count
    state.places = wp.array(task.places.astype(np.int32), dtype=wp.int32, device=problem.device)
    for name, shape in {"system": (n, n), "shift": (n, 1 + k), "carried": (POSE, 1 + k), "sign": ()}.items():
        setattr(state, name, wp.zeros((count, *shape), dtype=wp.float64, device=problem.device))
    return state, Columns(task, state)
