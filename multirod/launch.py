"""Recorded launches of kernels, from any thread, that wait for what is being compiled."""

import ctypes
from collections.abc import Callable, Sequence
from concurrent.futures import Future
from contextlib import suppress
from functools import partial
from threading import RLock
from typing import Any, Protocol, cast

import warp as wp

from multirod.collecting import without_collections
from multirod.kernels.compiling import COMPILER, block_dim, kept, start_warp
from multirod.kernels.index import INDEX, Function, Maker, bounds, kinds_of, packed

LONGEST = 1024  # integrations of a rod in one launch: some hundredths of a second at most at a hundred steps each
ON_GPU = 65_536  # the same there, where it is what the largest run at once

# Warp makes and loads kernels for one thread at a time
_MAKING = RLock()


class Launch(Protocol):
    """A kernel with its arguments, to be launched again and again."""

    def launch(self) -> None:
        """Launch it."""

    def set_dim(self, dim: int) -> None:
        """Another number of threads from now on."""

    def set_param_at_index(self, index: int, value: object) -> None:
        """Another argument from now on."""


def record(maker: Maker, dim: int, arguments: Sequence[object], device: str) -> Launch:
    """A launch to be repeated by ``.launch()``, which releases the interpreter lock.

    A kernel that Warp's cache lacks is compiled in the background: the launch waits for it when it is first used, so that what is
    recorded before is compiled at the same time. One that an earlier process compiled is not made again, where that can be told.

    Args:
        maker: The kernel, or what makes it, called by one thread at a time: best a function of the package, or a ``partial`` of
            one, by which what it made is found again.
        dim: Number of threads of the kernel.
        arguments: Of the kernel; arrays must live as long as the launch.
        device: Warp device.
    """
    key, function = _found(maker, device)
    if function is not None:
        with suppress(AttributeError, TypeError):  # Warp may say what is wrong
            return Direct(function, dim, arguments)
    kernel, future = _requested(maker, key, device)
    if future is None:
        return _record(kernel, key, dim, arguments, device)
    return cast(Launch, Pending(future, kernel, key, dim, arguments, device))  # which has what the launch has


def longest(device: str) -> int:
    """Integrations of a rod in one launch."""
    return LONGEST if wp.get_device(device).is_cpu else ON_GPU


def expect(maker: Maker, device: str) -> None:
    """Have a kernel compiled in the background that is sure to be recorded later, as ``record`` does.

    Args:
        maker: The kernel, or what makes it, called by one thread at a time.
        device: Warp device.
    """
    key, function = _found(maker, device)
    if function is None:
        _requested(maker, key, device)


def _found(maker: Maker, device: str) -> tuple[str | None, Function | None]:
    """By what key a kernel is kept, and the kernel, if it is."""
    start_warp()
    if not wp.get_device(device).is_cpu:
        return None, None
    with _MAKING:
        key, function = INDEX.find(maker)
    if function is not None:
        COMPILER.kernels.add(function.module)
    return key, function


def _requested(maker: Maker, key: str | None, device: str) -> "tuple[wp.Kernel, Future[None] | None]":
    start_warp()
    with without_collections():
        with _MAKING:
            kernel = maker if isinstance(maker, wp.Kernel) else maker()
        future = COMPILER.request(kernel.module, wp.get_device(device))
    if key is not None:
        if future is None:
            _keep(key, kernel, device)
        else:
            future.add_done_callback(lambda _: _keep(key, kernel, device))
    return kernel, future


def _keep(key: str, kernel: wp.Kernel, device: str) -> None:
    if (binary := kept(kernel.module, wp.get_device(device))) is not None:
        INDEX.keep(key, kernel, binary)


def _record(kernel: wp.Kernel, key: str | None, dim: int, arguments: Sequence[object], device: str) -> Launch:
    with _MAKING:
        threads = block_dim(wp.get_device(device))
        recorded: Any = wp.launch(kernel, dim=dim, inputs=list(arguments), device=device, block_dim=threads, record_cmd=True)
        try:
            if not recorded.device.is_cpu:
                return cast(Launch, recorded)
            function = Function(kernel.module.name, recorded.hooks.forward, kinds_of(kernel), recorded.module_exec)
            direct = Direct(function, dim, arguments)
            if key is not None:
                INDEX.remember(key, function)
            return direct
        except (AttributeError, TypeError):  # another version of Warp, or of arguments: its own launches do as well
            return cast(Launch, recorded)


class Direct:
    """A launch on the CPU whose arguments stand ready as the kernel reads them.

    Warp's own puts them together anew at each launch, which takes as long as a rod's integration of ten steps.

    Args:
        function: Of the kernel.
        dim: Number of threads of the kernel.
        arguments: Of the kernel.

    Attributes:
        launch: Launches; the same function whatever is set.

    Raises:
        TypeError: If an argument is of another kind than the function's.
    """

    def __init__(self, function: Function, dim: int, arguments: Sequence[object]) -> None:
        self._function, self._given = function, list(arguments)  # what they point to must live
        values = [packed(kind, value) for kind, value in zip(function.kinds, arguments, strict=True)]
        self._names = [f"argument_{i}" for i in range(len(values))]
        kind = type("Arguments", (ctypes.Structure,), {"_fields_": list(zip(self._names, map(type, values), strict=True))})
        self._arguments, self._bounds = kind(*values), bounds(dim)
        self.launch: Callable[[], None] = partial(function.call, ctypes.byref(self._bounds), ctypes.byref(self._arguments))

    @property
    def address(self) -> tuple[int, int, int]:
        """Of its function, and of what stands ready for it: bounds and arguments, which stay where they are."""
        function = ctypes.cast(self._function.call, ctypes.c_void_p).value or 0
        return function, ctypes.addressof(self._bounds), ctypes.addressof(self._arguments)

    def set_param_at_index(self, index: int, value: object) -> None:
        """Another argument from now on."""
        setattr(self._arguments, self._names[index], packed(self._function.kinds[index], value))
        self._given[index] = value

    def set_dim(self, dim: int) -> None:
        """Another number of threads from now on."""
        ctypes.memmove(ctypes.byref(self._bounds), ctypes.byref(bounds(dim)), ctypes.sizeof(self._bounds))


def ready(launch: Launch) -> tuple[int, int, int] | None:
    """``Direct.address`` of a launch, which is waited for while its kernel is being compiled; None if it has none."""
    if isinstance(launch, Pending):
        launch = launch.recorded()
    return launch.address if isinstance(launch, Direct) else None


class Pending:
    """Stands for a recorded launch while its kernel is being compiled: what is asked of the launch waits for that.

    Args:
        future: Of the kernel.
        kernel: To be launched.
        key: By which it is kept.
        dim: Number of threads of the kernel.
        arguments: Of the kernel, as they will be when the launch is first used.
        device: Warp device.
    """

    def __init__(
        self, future: "Future[None]", kernel: wp.Kernel, key: str | None, dim: int, arguments: Sequence[object], device: str
    ) -> None:
        self.device = wp.get_device(device)
        self._future, self._of = future, (kernel, key, dim, arguments, device)
        self._recorded: Launch | None = None

    def __getattr__(self, name: str) -> Any:  # noqa: ANN401  (the launch's own)
        if name.startswith("_"):
            raise AttributeError(name)
        found = getattr(self.recorded(), name)
        if callable(found):
            # from the second call on it is the launch's own: a control loop notices a microsecond
            setattr(self, name, found)
        return found

    def recorded(self) -> Launch:
        """The launch itself, once its kernel is compiled."""
        if self._recorded is None:
            COMPILER.wait(self._future)
            self._recorded = _record(*self._of)
        return self._recorded
