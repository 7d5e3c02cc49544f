"""The arrays of a boundary problem, which solvers and kernels read and write."""

import math
from collections.abc import Callable, Hashable, Iterable, Iterator
from contextlib import contextmanager
from functools import cached_property
from typing import Any, TypeVar, cast

import numpy as np
import warp as wp
from numpy.typing import ArrayLike, NDArray

from multirod.batch import IntArray
from multirod.elimination import Elimination
from multirod.exclusive import Exclusive, Uncopied
from multirod.kernels.compiling import start_warp
from multirod.types import WarpArray
from multirod.validation import FloatArray

FEW = 8  # instances of which one thread does all, what comes between integrations too
SMALL = 2**19  # numbers in the records of a problem that may be kept for later calls, and its tools with it
T = TypeVar("T")
BUFFERS = (
    "order",
    "active",
    "load_factor",
    "unknowns",
    "inputs",
    "directions",
    "fault",
    "step_count",
    "residual",
    "gamma",
    "residual_directions",
    "position",
    "rotation",
    "pose_columns",
)


class Buffers(Uncopied):
    """The arrays of a boundary problem: the first axis of each is the instance.

    Kernels take them as they are, NumPy by ``read`` and ``write``. What says which instances are evaluated, and at which load, is
    set within ``only``, ``focused`` and ``at_load``.

    Attributes:
        unknown_count: Unknowns ``n`` of an instance, and residuals.
        batch_shape: Leading axes of the instances.
        instance_count: Instances.
        device: Where the arrays live.
        unknowns: Where to evaluate [1/m], shape (instance_count, n).
        order: Instances that launches pass over: the first ``listed`` entries, shape (instance_count,); ``focused`` sets them.
        listed: How many.
        active: Instances that are evaluated (1) or left as they are (0), shape (instance_count,).
        load_factor: What multiplies all loads of an instance, and the part of the way from ``guess`` to the robot as it is,
            shape (instance_count,).
        fault: Why an evaluation failed, by the numbers of ``status.Fault``, shape (instance_count,).
        residual: ``eps`` [1/m], shape (instance_count, n).
        elimination: How ``Gamma`` is eliminated that is mostly zeros, on the CPU: records then hold its numbers that may differ
            from zero. None where it is dense or an arrow.
        residual_directions: d(eps)/d(direction), shape (instance_count, n, direction_count).
        position: Of the end effector in the world [m], (instance_count,) of vec3d.
        rotation: Of the end effector, body to world, (instance_count,) of mat33d.
        pose_columns: Its derivative by the unknowns and directions, position rows then rotation-vector rows, both in the
            world, shape (instance_count, 6, n + direction_count).
        directions: Directions in input space, shape (instance_count, direction_count, input_count).
        restored: How often records were set in the place of what integrations found: columns are then not theirs.
        alone: What the thread that works on the problem holds.
    """

    restored: int = 0

    def __init__(
        self,
        *,
        unknown_count: int,
        batch_shape: tuple[int, ...],
        input_count: int,
        direction_count: int = 0,
        pose_sensitivities: bool = False,
        device: str = "cpu",
        elimination: Elimination | None = None,
    ) -> None:
        start_warp()
        self.unknown_count = n = unknown_count
        self.batch_shape = batch_shape
        self.alone = Exclusive("this problem is in use on another thread: make a problem for each thread")
        self.instance_count = count = math.prod(batch_shape)
        self.input_count = input_count
        self.direction_count = direction_count
        self.pose_sensitivities = pose_sensitivities
        self.device = device
        self.elimination = elimination
        self._tools: dict[Hashable, Any] = {}
        # One record an instance holds all that a sample of a time series keeps, so that keeping it is one copy.
        numbers = n * n if elimination is None else elimination.count
        sizes = {"unknowns": n, "residual": n, "gamma": numbers, "position": 3, "rotation": 9, "inputs": input_count}
        self.record_fields: dict[str, slice] = {}
        offset = 0
        for name, size in sizes.items():
            self.record_fields[name] = slice(offset, offset + size)
            offset += size
        self.records: Any = wp.zeros((count, offset), dtype=wp.float64, device=device)
        self.unknowns = self._field("unknowns", (n,))
        self.residual = self._field("residual", (n,))
        self.position = self._field("position", (), wp.vec3d)
        self.rotation = self._field("rotation", (), wp.mat33d)
        self.order: Any = wp.array(np.arange(count, dtype=np.int32), dtype=wp.int32, device=device)
        self.listed = count
        self.active: Any = wp.ones(count, dtype=wp.int32, device=device)
        self.fault: Any = wp.zeros(count, dtype=wp.int32, device=device)
        self.step_count: Any = wp.zeros(count, dtype=wp.int32, device=device)
        self.load_factor: Any = wp.ones(count, dtype=wp.float64, device=device)
        self.inputs = self._field("inputs", (input_count,))
        # On the CPU, NumPy and the kernels share memory.
        self._host: FloatArray | None = self.records.numpy() if wp.get_device(device).is_cpu else None
        self.directions: Any = wp.zeros((count, max(direction_count, 1), input_count), dtype=wp.float64, device=device)
        self.residual_directions: Any = wp.zeros((count, n, max(direction_count, 1)), dtype=wp.float64, device=device)
        columns = n + direction_count if pose_sensitivities else 1
        self.pose_columns: Any = wp.zeros((count, 6, columns), dtype=wp.float64, device=device)

    @cached_property
    def gamma(self) -> WarpArray:
        """``Gamma``, shape (instance_count, n, n); where records hold its numbers alone, whoever asks has it filled by every
        integration from then on."""
        n = self.unknown_count
        if self.elimination is None:
            return self._field("gamma", (n, n))
        return wp.zeros((self.instance_count, n, n), dtype=wp.float64, device=self.device)

    def _field(self, name: str, tail: tuple[int, ...], dtype: type = wp.float64) -> WarpArray:
        width = self.records.shape[1] * 8
        inner = tuple(int(np.prod(tail[k + 1 :])) * 8 for k in range(len(tail)))
        return wp.array(
            ptr=self.records.ptr + 8 * self.record_fields[name].start,
            shape=(self.instance_count, *tail),
            strides=(width, *inner),
            dtype=dtype,
            device=self.device,
        )

    def _flat(self, name: str) -> WarpArray:
        """A field of the records, shape (instance_count, size)."""
        field = self.record_fields[name]
        return self._field(name, (field.stop - field.start,))

    def _rows(self, name: str) -> FloatArray:
        """A copy of a field, of a GPU's memory: of the records as a whole it would take many times as long."""
        return np.array(self._flat(name).numpy())

    def _clear(self) -> None:
        """All buffers as they are at first, on the CPU."""
        for values, first in self._first_values:
            values.fill(first)

    @cached_property
    def _first_values(self) -> list[tuple[NDArray[Any], int]]:
        ones = (self.active, self.load_factor)
        return [(array.numpy(), 0) for array in self._zeros()] + [(array.numpy(), 1) for array in ones]

    def _zeros(self) -> list[Any]:
        """Buffers that are zero at first."""
        return [self.records, self.fault, self.step_count, self.directions, self.residual_directions, self.pose_columns]

    @property
    def may_be_kept(self) -> bool:
        """Whether it may serve again after it was used, and its tools with it: on the CPU, where it is not large."""
        return self._host is not None and self._host.size <= SMALL

    def tool(self, key: Hashable, make: Callable[[], T]) -> T:
        """What a solver works with on this problem: made anew, or, for a problem that may be kept, kept with it under ``key``."""
        if not self.may_be_kept:
            return make()
        if key not in self._tools:
            self._tools[key] = make()
        return cast(T, self._tools[key])

    def share(self, target: object, names: Iterable[str] = BUFFERS) -> None:
        """Make arrays of this problem the fields of the same names of a kernel's argument."""
        for name in names:
            setattr(target, name, getattr(self, name))

    def _pass_over(self, instances: IntArray | None) -> None:
        """Let launches pass over these instances alone, (k,), or over all; a problem with problems within tells these."""
        chosen = np.arange(self.instance_count) if instances is None else instances
        listed = np.arange(self.instance_count, dtype=np.int32)
        listed[: len(chosen)] = chosen
        self.set_buffer("order", listed)
        self.listed = len(chosen)

    @contextmanager
    def focused(self, instances: IntArray | None = None) -> Iterator[Callable[[IntArray], None]]:
        """Within it, launches pass over these instances alone, (k,), to which all that are active belong, or over all; then over
        those as before.

        What it yields may be called within it, with those that are left (m,): of an iteration, of which more and more end.
        """
        before = None if self.listed == self.instance_count else np.array(self.buffer("order")[: self.listed])
        if instances is not None or before is not None:
            self._pass_over(instances)
        try:
            yield self._pass_over
        finally:
            if before is not None or self.listed < self.instance_count:
                self._pass_over(before)

    @contextmanager
    def at_load(self, factor: float | FloatArray) -> Iterator[None]:
        """Within it, ``load_factor`` is this, one number or one for each instance (instance_count,); then what it was."""
        before = np.array(self.buffer("load_factor"))
        self.set_buffer("load_factor", factor)
        try:
            yield
        finally:
            self.set_buffer("load_factor", before)

    @contextmanager
    def only(self, chosen: NDArray[np.bool_]) -> Iterator[None]:
        """Within it, these instances, (instance_count,), are active, and launches pass over them alone; then as it was."""
        active = np.array(self.buffer("active"))
        self.set_buffer("active", chosen)
        try:
            # few are passed over in one go whether all are active or not, and aiming launches takes as long as many of them
            with self.focused(None if self.instance_count <= FEW or chosen.all() else np.flatnonzero(chosen)):
                yield
        finally:
            self.set_buffer("active", active)

    @contextmanager
    def everyone(self) -> Iterator[None]:
        """Within it, all instances are active; then as it was."""
        active = np.array(self.buffer("active"))
        if not active.all():  # mostly they are, and a cold solve asks some twenty times
            self.set_buffer("active", 1)
        try:
            with self.focused():
                yield
        finally:
            self.set_buffer("active", active)

    def keep(self, part: "Buffers", instances: IntArray, rows: IntArray | None = None) -> None:
        """Take over the records of a part of the instances, of its ``rows`` (k,) or all."""
        records = self.snapshot()
        records[instances] = part.snapshot()[slice(None) if rows is None else rows]
        self.restore(records)

    def numbers_of_gamma(self, instances: IntArray) -> FloatArray:
        """Those of ``Gamma`` that may differ from zero, of some instances (k,), in the order of ``elimination``."""
        assert self.elimination is not None  # or nobody knows which these are
        values = self._rows("gamma") if self._host is None else self._host[:, self.record_fields["gamma"]]
        return np.asarray(values[instances])

    def read(self, name: str) -> FloatArray:
        """A copy of one field of the records, shape (instance_count, size): ``unknowns``, ``residual``, ``gamma``,
        ``position``, ``rotation`` or ``inputs``.
        """
        if name == "gamma" and self.elimination is not None:
            return self.elimination.dense(self.numbers_of_gamma(np.arange(self.instance_count))).reshape(self.instance_count, -1)
        return self._rows(name) if self._host is None else np.array(self._host[:, self.record_fields[name]])

    def buffer(self, name: str) -> NDArray[Any]:
        """What the last integration wrote beside the records, ``fault``, ``step_count``, ``residual_directions`` or
        ``pose_columns``, or what it was told, ``active``, ``order`` or ``load_factor``: on the CPU as NumPy sees it in place."""
        view = self._views.get(name)
        return np.asarray(getattr(self, name).numpy()) if view is None else view

    @cached_property
    def _views(self) -> dict[str, NDArray[Any]]:
        """Made once: each time anew they take a loop's sample as long as its linear algebra."""
        if self._host is None:
            return {}
        names = ("fault", "step_count", "residual_directions", "pose_columns", "active", "order", "load_factor")
        return {name: getattr(self, name).numpy() for name in names}

    def set_buffer(self, name: str, values: ArrayLike) -> None:
        """Set what ``buffer`` gives, of all instances, from what broadcasts to it."""
        view = self._views.get(name)
        if view is not None:
            view[:] = values
            return
        target = getattr(self, name)
        kind = np.float64 if target.dtype == wp.float64 else np.int32
        target.assign(np.ascontiguousarray(np.broadcast_to(np.asarray(values, dtype=kind), target.shape)))

    def write(self, name: str, values: FloatArray) -> None:
        """Set one field of the records from an array that broadcasts to (instance_count, size); of ``gamma`` that is what records
        hold of it."""
        if self._host is not None:
            self._host[:, self.record_fields[name]] = values
        else:
            target = self._flat(name)
            target.assign(np.ascontiguousarray(np.broadcast_to(values, target.shape), dtype=np.float64))

    def put(self, name: str, instances: IntArray, values: FloatArray) -> None:
        """The same of some instances, (k,), from an array (k, size)."""
        if self._host is not None:
            self._host[instances, self.record_fields[name]] = values
            return
        kept = self._rows(name)
        kept[instances] = values
        self.write(name, kept)

    @cached_property
    def fields_found(self) -> tuple[dict[str, slice], int]:
        """Fields of the records but for the inputs, which come last and are known; and where they end."""
        fields = {name: field for name, field in self.record_fields.items() if name != "inputs"}
        return fields, max(field.stop for field in fields.values())

    def snapshot(self) -> FloatArray:
        """A copy of the records, shape (instance_count, record size)."""
        return self._host.copy() if self._host is not None else np.array(self.records.numpy())

    def restore(self, records: FloatArray) -> None:
        """Set the records to a snapshot of them."""
        self.restored += 1
        if self._host is not None:
            self._host[:] = records
        else:
            self.records.assign(records)

    def input_view(self) -> FloatArray | None:
        """The inputs as NumPy sees them in place, where the device allows it: what is written there needs no upload."""
        return None if self._host is None else self._host[:, self.record_fields["inputs"]]
