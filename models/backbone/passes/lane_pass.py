"""Recorded launches of the kernels in lanes: how instances and their columns are dealt out to lanes, and threads to portions."""

from collections.abc import Callable
from functools import cache, partial
from typing import Any

import warp as wp

from multirod.integrators import Integrator, Tableau
from multirod.kernels.warp_types import Array, Struct
from multirod.launch import record
from multirod.models.backbone.kernels.integration.integrate import make_kernel
from multirod.models.backbone.kernels.integration.walk import SCALARS
from multirod.models.backbone.kernels.layout.arguments import LANE_SIZE, Call, Instance
from multirod.models.backbone.kernels.layout.features import Features
from multirod.models.backbone.kernels.layout.layout import Layout


def processor_has(feature: str) -> bool:
    """Whether the processor has instructions of such a name; False where NumPy does not tell."""
    try:
        from numpy._core._multiarray_umath import __cpu_features__  # type: ignore[import-not-found]
    except ImportError:
        return False
    return bool(__cpu_features__.get(feature, False))


WIDE = processor_has("AVX512F")
WIDTH = {"float64": 8 if WIDE else 4, "float32": 16 if WIDE else 8}  # lanes on a processor: what its vectors hold, or two of them
CHUNK = 256  # instances of a thread: its lanes, refilled, stay busy
BASE_COST = 2.0  # of the state, in columns

layout_of = cache(Layout)  # it takes as long as an integration of one rod


def width(precision: str, device: str) -> int:
    """Lanes of a thread: as many as a vector of the processor holds, one on a GPU."""
    return WIDTH[precision] if wp.get_device(device).is_cpu else 1


def kernel_of(features: Features, tableau: Tableau, precision: str, device: str) -> Callable[[], wp.Kernel]:
    """What makes the kernel of such terms."""
    return partial(make_kernel, features, tableau, precision, width(precision, device))


def parts_of(count: int, columns: int, lanes: int) -> int:
    """Lanes that share the columns of an instance, so that ``count`` instances take least time.

    A lane carries the state whatever columns it has, so that sharing pays where lanes would stand idle.
    """
    if lanes == 1:
        return 1
    return min(range(1, max(columns, 1) + 1), key=lambda parts: (_cost(count, columns, lanes, parts), parts))


def cost_of(count: int, columns: int, lanes: int) -> float:
    """What a launch over ``count`` instances takes, in columns of one that all lanes carry."""
    return _cost(count, columns, lanes, parts_of(count, columns, lanes))


def _cost(count: int, columns: int, lanes: int, parts: int) -> float:
    return -(-count * parts // lanes) * (BASE_COST + -(-columns // parts))


def own(call: Struct) -> Struct:
    """A copy of a launch's arguments, its arrays shared."""
    result: Struct = Call()
    for name in call._cls.vars:
        setattr(result, name, getattr(call, name))
    return result


class LanePass:
    """A launch over the instances that the ``order`` in ``call`` lists, in portions: a batch can be brought to an end in between.

    Args:
        features: Of the kernel.
        integrator: Of the spatial equations; ``precision`` is that of its numbers.
        table, call: Arguments of the kernel.
        columns: By unknowns, and by directions.
        device: Warp device.
        longest: Instances of a portion.
        heed: Called before each portion; may raise.

    Attributes:
        features, columns: As given.
        listed: How many instances it passes over.
    """

    def __init__(
        self,
        features: Features,
        integrator: Integrator,
        precision: str,
        table: Struct,
        call: Struct,
        columns: tuple[int, int],
        device: str,
        *,
        longest: int,
        heed: Callable[[], None],
    ) -> None:
        self._call = call = own(call)
        self._heed = heed
        self.features, self.columns = features, columns
        count = len(call.problem.order)
        portion = max(1, min(longest, count))
        lanes = width(precision, device)
        call.unknown_columns, call.direction_columns = columns
        layout = layout_of(features)
        refuse_narrow(call, features, layout)
        self._arrays = deal(call, layout, integrator, precision, device, portion, lanes)
        launch_arguments = [table, call, self._arrays]

        self._threads = threads(call, portion)
        self._launch = record(kernel_of(features, integrator.tableau, precision, device), self._threads, launch_arguments, device)
        self._order, self._portion = call.problem.order, portion
        self.listed = count
        self._orders = self._portions(count)
        self._recorded = (self._launch,) if len(self._orders) == 1 else None

    @property
    def recorded(self) -> tuple[Any, ...] | None:
        """What ``launch`` launches, where all instances are one portion."""
        return self._recorded

    def _portions(self, count: int) -> list[Any]:
        step = self._portion
        return [self._order[first : min(first + step, count)] for first in range(0, count, step)]

    def set_dim(self, count: int) -> None:
        """Pass over so many instances from now on: the first that are listed."""
        self.listed = count
        self._orders = self._portions(count)
        if len(self._orders) == 1:
            self._aim(self._orders[0])

    def _aim(self, order: Array) -> None:
        self._call.problem.order = order
        self._launch.set_param_at_index(1, self._call)
        count = threads(self._call, len(order))
        if count != self._threads:
            self._launch.set_dim(count)
            self._threads = count

    def launch(self) -> None:
        """Launch one portion after another."""
        if len(self._orders) == 1:
            self._launch.launch()
            return
        for order in self._orders:
            self._heed()
            self._aim(order)
            self._launch.launch()


def refuse_narrow(call: Struct, features: Features, layout: Layout) -> None:
    """See that what a launch writes by rows and columns fits into its arrays: a kernel does not look."""
    m, unknowns, directions = features.unknown_count, call.unknown_columns, call.direction_columns
    columns, lengths = unknowns + directions, layout.LENGTHS
    of_problem = {"residual": (m,), "gamma": (m, unknowns), "residual_directions": (m, directions)}
    if features.pose_sensitivities:
        of_problem["pose_columns"] = (6, columns)
    at_tip = {"values": (6,), "columns": (6, columns)} if features.held else {}
    own: dict[str, tuple[int, ...]] = {"line_length": (lengths,), "line_length_columns": (lengths, columns)}
    if features.node_columns and call.node_count:
        own |= {"node_columns": (1, m, unknowns), "tip_columns": (m, unknowns)}
    parts = ((call.problem, of_problem), (call.wrench, at_tip), (call, own))
    for part, name, least in ((part, *item) for part, needed in parts for item in needed.items()):
        if 0 in least:
            continue
        room = getattr(part, name).shape[1:]
        if any(has < needs for has, needs in zip(room, least, strict=True)):
            raise AssertionError(f"{name} of a launch has room for {room} numbers of an instance, and {least} are written")


def threads(call: Struct, count: int) -> int:
    """Threads for so many instances."""
    return max(1, -(-count * int(call.parts) // int(call.chunk)))


def deal(call: Struct, layout: Layout, integrator: Integrator, precision: str, device: str, count: int, lanes: int) -> Array:
    """Set what ``call`` says of lanes, for ``count`` instances at most in a launch; returns the memory of the threads."""
    columns = call.unknown_columns + call.direction_columns
    call.parts = parts_of(count, columns, lanes)
    call.part_columns = -(-columns // call.parts)
    call.chunk = call.parts * (CHUNK if lanes > 1 else 1)
    number, kind = threads(call, count), SCALARS[precision]
    call.lane = wp.zeros((number * lanes, LANE_SIZE), dtype=wp.float64, device=device)
    call.carried = wp.zeros(number * lanes, dtype=Instance, device=device)
    rows = layout.memory(len(integrator.tableau.b)).rows(call.part_columns)
    if lanes > 1 or wp.get_device(device).is_cpu:
        return wp.zeros((number, lanes * rows), dtype=kind, device=device)
    # threads side by side on a GPU read numbers that stand side by side
    memory: Array = wp.zeros((rows, number), dtype=kind, device=device).transpose()
    return memory
