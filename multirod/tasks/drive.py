"""The compiled part of a search: its arrays, which NumPy reads too, and its launch."""

from typing import Any

import warp as wp

from multirod.launch import record
from multirod.shared import Shared
from multirod.tasks.condensed import condensed
from multirod.tasks.drive_kernels import SETTINGS, Drive
from multirod.tasks.formulation import Task
from multirod.tasks.limits import LimitRows
from multirod.tasks.programme import programme
from multirod.tasks.search_kernels import make_search
from multirod.validation import FloatArray

Kind = tuple[int, int, int]  # whether a target has a position, a rotation, an axis


class DriveArrays:
    """What a search works in, of all instances of a task.

    Args:
        task: Aimed at what is free.
        kind: Of the target.
        limit_count: Rows of limits.

    Attributes:
        values: NumPy's arrays by the names of ``Drive``, those of the limits of steps by ``step_limits``.
        limits: Rows of limits whose numbers are in ``values``; None are none.
    """

    def __init__(self, task: Task, kind: Kind, limit_count: int) -> None:
        problem = task.problem
        self._task, device = task, problem.device
        count, n, k, c = problem.instance_count, problem.unknown_count, task.count, limit_count
        m = 3 * kind[0] + 3 * kind[1] + 2 * kind[2]
        self._state: Any = Drive()
        self._shared: dict[str, Shared] = {}
        constants = {
            "settings": SETTINGS,
            "unit": k,
            "low": c,
            "high": c,
            "inset_low": c,
            "inset_high": c,
            "near": c,
            "centre": k,
        }
        for name, size in constants.items():
            self._share(self._state, name, (size,))
        self._share(self._state, "limits", (c, k))
        self._share(self._state, "count", (2,), wp.int32)
        for place in ("start", "last", "base", "here", "fold"):
            self._share(self._state, f"{place}_x", (count, n))
            self._share(self._state, f"{place}_p", (count, k))
        for name, dtype in {"position": wp.vec3d, "rotation": wp.mat33d, "axis": wp.vec3d}.items():
            self._share(self._state, name, (count,), dtype)
        for name in ("phase", "asked", "verdict", "status", "integrations", "allowed", "iterations", "begun", "fresh", "steps"):
            self._share(self._state, name, (count,), wp.int32)
        for name in ("settling", "blocked", "folded"):
            self._share(self._state, name, (count,), wp.int32)
        for name in ("done", "part", "goal", "damping", "residual", "sign", "first_sign", "merit", "first_merit"):
            self._share(self._state, name, (count,))
        for name in ("curvature", "residual_tolerance"):
            self._share(self._state, name, (count,))
        for name in ("errors", "first_errors", "base_errors", "r", "found"):
            self._share(self._state, name, (count, m))
        sizes = {"J": (m, k), "towards": (n,), "by": (n, k), "change": (k,)}
        for name, shape in sizes.items():
            self._share(self._state, name, (count, *shape))
        self._state.kind = wp.vec3i(*kind)
        self._state.task, self._columns = condensed(task)
        self._state.step = programme(count, m, k, c, device)
        self._share(self._state.step, "limits", (c, k), key="step_limits")
        self.values = {name: each.values for name, each in self._shared.items()}
        self._launch = record(make_search, count, [self._state], device)
        self._same = wp.get_device(device).is_cpu
        self._count = self.values["count"]
        self.limits: LimitRows | None = None
        self._cleared = list(self.values.values())

    def _share(self, target: Any, name: str, shape: tuple[int, ...], dtype: Any = wp.float64, key: str = "") -> None:
        self._shared[key or name] = shared = Shared(shape, dtype, self._task.problem.device)
        setattr(target, name, shared.array)

    def limit(self, limits: LimitRows, numbers: dict[str, FloatArray]) -> None:
        """Take over ``numbers``, by the names of ``values``, which follow from limits: ``clear`` leaves them."""
        for name, own in numbers.items():
            self.values[name][:] = own
        self.limits = limits
        self._cleared = [values for name, values in self.values.items() if name not in numbers]

    def clear(self) -> None:
        """All as at first, but for limits."""
        for values in self._cleared:
            values.fill(0)

    def send(self) -> None:
        """What NumPy wrote to the device."""
        if not self._same:
            for each in self._shared.values():
                each.send()

    def fetch(self) -> None:
        """What the kernel wrote from the device."""
        if not self._same:
            for each in self._shared.values():
                each.fetch()

    def integrate(self) -> None:
        """An integration at what the problem holds."""
        self._task.integrate()
        self._columns.update()

    def launch(self) -> tuple[int, int]:
        """Go on; how many instances are under way then, and how many asked."""
        self._count.fill(0)
        self._shared["count"].send()
        self._launch.launch()
        self._shared["count"].fetch()
        under_way, asked = self._count.tolist()
        return under_way, asked
