"""Recorded launches of kernels, from any thread, that wait for what is being compiled."""

import ctypes
from collections.abc import Callable, Sequence
from concurrent.futures import Future
from functools import partial
from threading import RLock
from typing import Any, Protocol, cast

import warp as wp

from multirod.collecting import without_collections
from multirod.kernels.compiling import COMPILER, block_dim, start_warp

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


def record(make: Callable[[], wp.Kernel], dim: int, arguments: Sequence[object], device: str) -> Launch:
    """A launch to be repeated by ``.launch()``, which releases the interpreter lock.

    A kernel that Warp's cache lacks is compiled in the background: the launch waits for it when it is first used, so that what is
    recorded before is compiled at the same time.

    Args:
        make: Makes the kernel, or returns it: called by one thread at a time.
        dim: Number of threads of the kernel.
        arguments: Of the kernel; arrays must live as long as the launch.
        device: Warp device.
    """
    kernel, future = _requested(make, device)
    if future is None:
        return _record(kernel, dim, arguments, device)
    return cast(Launch, Pending(future, kernel, dim, arguments, device))  # which has what the launch has


def longest(device: str) -> int:
    """Integrations of a rod in one launch."""
    return LONGEST if wp.get_device(device).is_cpu else ON_GPU


def expect(make: Callable[[], wp.Kernel], device: str) -> None:
    """Have a kernel compiled in the background that is sure to be recorded later, as ``record`` does.

    Args:
        make: Makes the kernel, or returns it: called by one thread at a time.
        device: Warp device.
    """
    _requested(make, device)


def _requested(make: Callable[[], wp.Kernel], device: str) -> "tuple[wp.Kernel, Future[None] | None]":
    start_warp()
    with without_collections():
        with _MAKING:
            kernel = make()
        return kernel, COMPILER.request(kernel.module, wp.get_device(device))


def _record(kernel: wp.Kernel, dim: int, arguments: Sequence[object], device: str) -> Launch:
    with _MAKING:
        threads = block_dim(wp.get_device(device))
        recorded: Any = wp.launch(kernel, dim=dim, inputs=list(arguments), device=device, block_dim=threads, record_cmd=True)
    try:
        return Direct(recorded) if recorded.device.is_cpu else cast(Launch, recorded)
    except (AttributeError, TypeError):  # another version of Warp, whose own launches do as well
        return cast(Launch, recorded)


class Direct:
    """A recorded launch on the CPU whose arguments stand ready as the kernel reads them.

    Warp's own puts them together anew at each launch, which takes as long as a rod's integration of ten steps.

    Args:
        recorded: What Warp recorded.

    Attributes:
        launch: Launches; the same function whatever is set.
    """

    def __init__(self, recorded: Any) -> None:  # noqa: ANN401  (what Warp keeps in it has no types)
        self._recorded = recorded
        labels = [argument.label for argument in recorded.kernel.adj.args]
        values = recorded.params[1:]
        kind = type("Arguments", (ctypes.Structure,), {"_fields_": list(zip(labels, map(type, values), strict=True))})
        self._arguments, self._bounds = kind(), type(recorded.params[0]).from_buffer_copy(recorded.params[0])
        self._labels = labels
        self._take_over()
        self.launch: Callable[[], None] = partial(
            recorded.hooks.forward, ctypes.byref(self._bounds), ctypes.byref(self._arguments)
        )

    @property
    def address(self) -> tuple[int, int, int]:
        """Of its function, and of what stands ready for it: bounds and arguments, which stay where they are."""
        function = ctypes.cast(self._recorded.hooks.forward, ctypes.c_void_p).value or 0
        return function, ctypes.addressof(self._bounds), ctypes.addressof(self._arguments)

    def _take_over(self) -> None:
        bounds, *values = self._recorded.params
        ctypes.memmove(ctypes.byref(self._bounds), ctypes.byref(bounds), ctypes.sizeof(self._bounds))
        for label, value in zip(self._labels, values, strict=True):
            setattr(self._arguments, label, value)

    def set_param_at_index(self, index: int, value: object) -> None:
        """Another argument from now on."""
        self._recorded.set_param_at_index(index, value)
        self._take_over()

    def set_dim(self, dim: int) -> None:
        """Another number of threads from now on."""
        self._recorded.set_dim(dim)
        self._take_over()


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
        dim: Number of threads of the kernel.
        arguments: Of the kernel, as they will be when the launch is first used.
        device: Warp device.
    """

    def __init__(self, future: "Future[None]", kernel: wp.Kernel, dim: int, arguments: Sequence[object], device: str) -> None:
        self.device = wp.get_device(device)
        self._future, self._of = future, (kernel, dim, arguments, device)
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
