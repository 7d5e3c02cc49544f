"""The compiled part of a search: its arrays, which NumPy reads too, and its launches."""

from collections.abc import Callable
from functools import cache, partial
from math import prod
from typing import Any

import numpy as np
import warp as wp

from multirod.kernels.repeated_kernels import Calls, callable_from_kernels
from multirod.kernels.shared import Shared
from multirod.launch import Launch, expect, record
from multirod.problem import FEW
from multirod.status import Status
from multirod.tasks.condensed import condensed
from multirod.tasks.formulation import Task
from multirod.tasks.limits import LimitRows
from multirod.tasks.programme import programme
from multirod.tasks.reaching.drive_kernels import ROUGH, SETTINGS, Drive
from multirod.tasks.reaching.goals import Place
from multirod.tasks.reaching.search_kernels import make_search
from multirod.tasks.rows import SIGHTS
from multirod.tasks.whitening import Kind, row_count
from multirod.types import WarpArray
from multirod.validation import FloatArray

PLACES = ("start", "last", "here", "base", "fold")
ALIKE = 3  # of these, which are the same at first
ROUNDS = 64  # integrations in one launch, of few instances: who stops a batch waits no longer than that


@cache
def expect_search(device: str) -> None:
    """Have the kernel compiled in the background."""
    expect(_maker(device), device)


@cache
def _maker(device: str) -> Callable[[], wp.Kernel]:
    return partial(make_search, wp.get_device(device).is_cpu)


class DriveArrays:
    """What a search works in, of all instances of a task.

    Args:
        task: Aimed at what is free.
        kind: Of the target.
        limit_count: Rows of limits.

    Attributes:
        values: NumPy's arrays by the names of ``Drive``, those of the limits of steps by ``step_limits``.
        places: Of these where instances start, were last and are, and where they found a fold.
        all_x, all_p: Of the first three of these at once, shapes (3, b, n), (3, b, k).
        all_reached: What ``status`` is as bytes where all instances are at their targets.
        limits: Rows of limits whose numbers are in ``values``; None are none.
        scale: The scale of curvatures that is there, (b,); likewise.
    """

    def __init__(self, task: Task, kind: Kind, limit_count: int) -> None:
        problem = task.problem
        self._task, device = task, problem.device
        count, n, k, c = problem.instance_count, problem.unknown_count, task.count, limit_count
        m = row_count(kind)
        self._state: Any = Drive()
        self._shared: dict[str, Shared] = {}
        # what follows from limits, which ``clear`` leaves
        for name in ("low", "high", "inset_low", "inset_high", "near"):
            self._share(self._state, name, wp.zeros(c, dtype=wp.float64, device=device))
        for name, shape in {"unit": (k,), "limits": (c, k), "curvature": (count,)}.items():
            self._share(self._state, name, wp.zeros(shape, dtype=wp.float64, device=device))
        rooms: dict[str, tuple[tuple[int, ...], Any]] = {f"{place}_x": ((count, n), wp.float64) for place in PLACES}
        rooms |= {f"{place}_p": ((count, k), wp.float64) for place in PLACES}
        rooms |= {"settings": ((SETTINGS,), wp.float64), "centre": ((k,), wp.float64), "count": ((2,), wp.int32)}
        kinds = {"position": wp.vec3d, "rotation": wp.mat33d, "axis": wp.vec3d, "direction": wp.vec3d}
        rooms |= {name: ((count,), dtype) for name, dtype in kinds.items()}
        whole = (
            "rough",
            "roughly",
            "phase",
            "asked",
            "verdict",
            "status",
            "integrations",
            "allowed",
            "iterations",
            "begun",
            "fresh",
            "steps",
        )
        rooms |= dict.fromkeys((*whole, "settling", "limited", "blocked", "folded"), ((count,), wp.int32))
        real = ("done", "part", "goal", "damping", "residual", "sign", "first_sign", "merit", "first_merit", "residual_tolerance")
        rooms |= dict.fromkeys(real, ((count,), wp.float64))
        rooms |= dict.fromkeys(("errors", "first_errors", "base_errors", "r", "found"), ((count, m), wp.float64))
        sizes = {"J": (m, k), "towards": (n,), "by": (n, k), "change": (k,)}
        rooms |= {name: ((count, *shape), wp.float64) for name, shape in sizes.items()}
        self._cleared, self._rooms = self._side_by_side(rooms, device), tuple(rooms)
        self._state.kind, self._state.active = wp.vec3i(*kind), problem.active
        self._state.task, self._columns = condensed(task)
        self._state.step = programme(count, m, k, c, device)
        self._share(self._state.step, "limits", wp.zeros((c, k), dtype=wp.float64, device=device), key="step_limits")
        self.values = {name: each.values for name, each in self._shared.items()}
        self.values |= dict.fromkeys(SIGHTS, self.values["direction"])
        self.places = [Place(self.values[f"{name}_x"], self.values[f"{name}_p"]) for name in ("start", "last", "here", "fold")]
        begin, own = len(PLACES) * count * n, self._cleared[0].values
        self.all_x = own[: ALIKE * count * n].reshape(ALIKE, count, n)
        self.all_p = own[begin : begin + ALIKE * count * k].reshape(ALIKE, count, k)
        self._same = wp.get_device(device).is_cpu
        self._make = _maker(device)
        self._launch = record(self._make, count, [self._state, Calls(), Calls(), 0], device)
        self._repeats = self._same and count <= FEW and self._columns.in_place
        self._bound: tuple[Any, ...] = (None, None)  # launches that ``_loop`` repeats
        self._loop: Launch | None = None
        self._count = self.values["count"]
        self.all_reached = np.full(count, Status.REACHED, dtype=np.int32).tobytes()
        self.limits: LimitRows | None = None
        self.scale: FloatArray | None = None

    def _share(self, target: object, name: str, array: WarpArray, key: str = "") -> None:
        self._shared[key or name] = Shared.of(array)
        setattr(target, name, array)

    def _side_by_side(self, rooms: dict[str, tuple[tuple[int, ...], Any]], device: str) -> list[Shared]:
        """Make these arrays, by shape and kind, parts of one of each kind, which are returned: they are cleared at once."""
        blocks = []
        for whole in (wp.float64, wp.int32):
            own = {name: room for name, room in rooms.items() if (room[1] is wp.int32) == (whole is wp.int32)}
            size = wp.types.type_size_in_bytes(whole)
            bytes_of = {name: prod(shape) * wp.types.type_size_in_bytes(dtype) for name, (shape, dtype) in own.items()}
            block = Shared((sum(bytes_of.values()) // size,), whole, device)
            blocks.append(block)
            place = block.array.ptr
            for name, (shape, dtype) in own.items():
                array: Any = wp.array(ptr=place if bytes_of[name] else None, shape=shape, dtype=dtype, device=device)
                self._share(self._state, name, array)
                place += bytes_of[name]
        return blocks

    def limit(self, limits: LimitRows, numbers: dict[str, FloatArray]) -> None:
        """Take over ``numbers``, by the names of ``values``, which follow from limits: ``clear`` leaves them."""
        for name, own in numbers.items():
            self.values[name][:] = own
        self.limits = limits

    def clear(self) -> None:
        """All as at first, but for limits."""
        if self._same:
            for each in self._cleared:
                each.values.fill(0)
            return
        for name in self._rooms:
            self.values[name].fill(0)

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

    @property
    def begins(self) -> bool:
        """Whether ``go_on`` begins what is to begin, so that nothing is launched before."""
        return self._repeating() is not None

    def go_on(self, under_way: int) -> tuple[int, int]:
        """Integrations at what the problem holds until one of those under way ends or asks; how many are under way then, and how
        many asked."""
        loop, left, asked = self._repeating(), under_way, 0
        while left == under_way and not asked:
            if loop is None:
                rough = self.values["rough"]
                if self.values["settings"][ROUGH] and rough.any():
                    self._task.integrate_some_coarsely(rough)
                else:
                    self._task.integrate()
                self._columns.update()
                left, asked = self.launch()
            else:
                self._task.problem.heed_stop()
                loop.launch()
                left, asked = self._count.tolist()
        return left, asked

    def _repeating(self) -> Launch | None:
        """A launch that repeats integrations, ``ROUNDS`` times at most; None where none can."""
        problem = self._task.problem
        if not self._repeats or problem.budget is not None:
            return None
        coarse = problem.coarse if self.values["settings"][ROUGH] else None
        launches = problem.launches, None if coarse is None else coarse.recorded
        if launches[0] is not self._bound[0] or launches[1] is not self._bound[1]:
            self._bound, calls = launches, [callable_from_kernels(own) for own in launches]
            arguments = [self._state, calls[0], calls[1] or Calls(), ROUNDS]
            whole = calls[0] is not None and (coarse is None or calls[1] is not None)
            self._loop = record(self._make, 1, arguments, problem.device) if whole else None
        return self._loop

    def launch(self) -> tuple[int, int]:
        """Go on; how many instances are under way then, and how many asked."""
        self._count.fill(0)
        self._shared["count"].send()
        self._launch.launch()
        self._shared["count"].fetch()
        under_way, asked = self._count.tolist()
        return under_way, asked
