"""Kernels compiled in the background, several at a time, and what is said of it; Warp's own log is silent by default."""

import math
import multiprocessing
import os
import sys
import tempfile
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from concurrent.futures import wait as wait_for
from contextlib import contextmanager, suppress
from hashlib import sha256
from pathlib import Path
from threading import Lock, get_ident
from time import monotonic
from typing import Any

import warp as wp

from multirod.batch import thread_count
from multirod.kernels.own_module import own_module

BLOCK = 64
MOST_WORKERS = 8  # a compiler takes some 300 MB
PATIENCE = 2.0  # s of compiling, beyond which a later call says so too
APART = 5.0  # s without, after which it is a later call
LOG = "MULTIROD_WARP_LOG"
_LEVELS = {"debug": wp.LOG_DEBUG, "info": wp.LOG_INFO, "warning": wp.LOG_WARNING, "error": wp.LOG_ERROR}
# Warp's, of the compiler
_SETTINGS = ("mode", "optimization_level", "cpu_compiler_flags", "verify_fp", "enable_tiles_in_stack_memory")
_NO_DRIVER = b"Could not find or load the NVIDIA CUDA driver"


class CompileError(RuntimeError):
    """Raised where a kernel could not be compiled."""


class Compiler:
    """Has Warp compile modules on threads of its own, each once: Clang holds neither the interpreter's lock nor one of its own.

    Attributes:
        kernels: Names of the modules that were asked for, a kernel each.
        compiled: How many of them were not in Warp's cache.
    """

    def __init__(self) -> None:
        self.forget()
        self._listeners: list[Callable[[int], None]] = []
        self._announced = False
        self._began, self._ended = math.inf, -math.inf  # of what has not been told of, and the last of all [s]
        self.kernels: set[str] = set()
        self.compiled = 0

    def forget(self) -> None:
        """Begin anew, as a process must that was forked: its parent's threads are not there."""
        self._lock = Lock()
        self._known: dict[tuple[Any, str], Future[None] | None] = {}
        self._pool: ThreadPoolExecutor | None = None

    def request(self, module: wp.Module, device: wp.Device) -> "Future[None] | None":
        """What to wait for until a module can be loaded; None where it can be now.

        Raises:
            CompileError: Where Warp compiles at once, on a GPU, and cannot.
        """
        with self._lock:
            key = (module, device.alias)
            future = self._known.get(key)
            if key in self._known and (future is None or not future.done()):
                return future
            if future is not None and not future.cancelled() and future.exception() is None:
                self._known[key] = None
                return None
            self.kernels.add(module.name)
            if kept(module, device) is not None:
                self._known[key] = None
                return None
            self._announce()
            self.compiled += 1
            for listener in self._listeners:
                listener(0)
            if not device.is_cpu:
                # a CUDA context belongs to a thread
                self._known[key] = None
                _load(module, device)
                return None
            if self._pool is None:
                self._pool = ThreadPoolExecutor(min(thread_count(None), MOST_WORKERS), "multirod-compiler")
            future = self._known[key] = self._pool.submit(_load, module, device)
            future.add_done_callback(self._tell)
            return future

    def wait(self, future: "Future[None]") -> None:
        """Wait for what ``request`` returned.

        Raises:
            CompileError: If it could not be compiled.
        """
        try:
            if (began := self._began) < math.inf:
                wait_for([future], max(began + PATIENCE - monotonic(), 0.0))
                if not future.done():
                    self._announce_more()
            future.result()
        except KeyboardInterrupt:
            # what has not begun would keep the interpreter from ending
            with self._lock:
                waiting = [other for other in self._known.values() if other is not None]
            for other in waiting:
                other.cancel()
            raise

    @contextmanager
    def listening(self, listener: Callable[[int], None]) -> Iterator[None]:
        """Within it, ``listener(0)`` is called as a kernel begins to be compiled, ``listener(1)`` as it is; on any thread."""
        self._listeners.append(listener)
        try:
            yield
        finally:
            self._listeners.remove(listener)

    def _tell(self, future: "Future[None]") -> None:
        self._ended = monotonic()
        for listener in tuple(self._listeners):
            listener(1)

    def _announce(self) -> None:
        """Say why the first call takes long; a later one is waited for before anything is said."""
        if not self._announced:
            self._announced = True
            _say(f"compiling kernels for this scene (several, some seconds each, once; kept in {cache()})")
            return
        compiling = any(future is not None and not future.done() for future in self._known.values())
        if not compiling and monotonic() - self._ended > APART:
            self._began = monotonic()

    def _announce_more(self) -> None:
        """The same of a later one, once."""
        with self._lock:
            told, self._began = self._began == math.inf, math.inf
        if not told:
            _say("compiling more kernels (some seconds each, once)")


def _say(what: str) -> None:
    """On the error stream; a pool's processes leave it to the one that has them."""
    if sys.stderr is not None and multiprocessing.parent_process() is None:
        print(f"multirod: {what}", file=sys.stderr, flush=True)


def cache() -> str:
    """Where Warp keeps what it compiled, as a person writes it."""
    start_warp()
    path = Path(str(wp.config.kernel_cache_dir))
    with suppress(ValueError, RuntimeError):
        return str(Path("~") / path.relative_to(Path.home()))
    return str(path)


def _load(module: wp.Module, device: wp.Device) -> None:
    try:
        if _headers is not None and device.is_cpu:
            _headers.precompile(device)
        wp.force_load(device, [module], block_dim=block_dim(device), max_workers=0)
    except Exception as error:
        raise CompileError(f"the kernel {module.name} could not be compiled into {cache()}: {error}") from error


def block_dim(device: wp.Device) -> int:
    """Threads of a block, which a module is compiled for: few on a GPU, so that a small batch is spread out."""
    return 1 if device.is_cpu else BLOCK


def kept(module: wp.Module, device: wp.Device) -> Path | None:
    """Where Warp's cache has a module, of the name that ``Module.load`` looks for; Warp has no public way to ask."""
    if not wp.config.cache_kernels:
        return None
    threads = block_dim(device)
    folder = Path(str(wp.config.kernel_cache_dir)) / module.get_module_identifier(threads)
    names = (module._get_compile_output_name(device, block_dim=threads), module._get_meta_name(threads))
    return folder / names[0] if all((folder / name).exists() for name in names) else None


def _quieten() -> None:
    """Leave Warp's log at warnings, where nobody has chosen a level."""
    level = os.environ.get(LOG, "")
    if level:
        if level.lower() not in _LEVELS:
            raise ValueError(f"{LOG} = {level!r} is not allowed: must be one of {', '.join(_LEVELS)}")
        wp.config.log_level = _LEVELS[level.lower()]
    elif wp.config.log_level == wp.LOG_INFO and not hasattr(wp.config, "verbose") and not hasattr(wp.config, "quiet"):
        wp.config.log_level = wp.LOG_WARNING


class _Headers:
    """Warp's headers, which Clang takes longer to read than most kernels: precompiled once, and kept beside the kernels.

    Warp would have each thread of each process precompile them.

    Args:
        header: What is precompiled.
    """

    def __init__(self, header: Path) -> None:
        self._made_of = f"{header} {header.stat().st_mtime_ns}"
        self._lock = Lock()
        self._maker: int | None = None
        self._room = ""

    def precompile(self, device: wp.Device) -> None:
        """Have Warp precompile them with a kernel that does nothing, if nobody has: other threads wait for it.

        That is done elsewhere, and what is complete is moved here: other processes may be doing the same.
        """
        with self._lock:
            folder = self._folder()
            if _has_headers(folder):
                return
            folder.mkdir(parents=True, exist_ok=True)
            with tempfile.TemporaryDirectory(dir=folder.parent) as room:
                self._maker, self._room = get_ident(), room
                try:
                    wp.force_load(device, [_kernel_of(int(folder.name[-15:], 16)).module], max_workers=0)
                    for file in Path(room).glob("*.pch"):
                        file.replace(folder / file.name)
                finally:
                    self._maker = None

    def __call__(self) -> str | None:
        """The folder where Warp looks for them, and else puts them; None where it does without."""
        if self._maker == get_ident():
            return self._room
        folder = self._folder()
        return str(folder) if _has_headers(folder) else None

    def _folder(self) -> Path:
        """Where those are that Clang can use: it refuses those of another processor, place, time or setting."""
        settings = [getattr(wp.config, name, None) for name in _SETTINGS]
        made = sha256(f"{wp.get_cpu_kernel_cache_key()} {self._made_of} {settings}".encode()).hexdigest()[:15]
        return Path(str(wp.config.kernel_cache_dir)) / f"multirod_headers_{made}"


def _has_headers(folder: Path) -> bool:
    return any(folder.glob("*.pch"))


def _kernel_of(number: int) -> wp.Kernel:
    """A kernel that does nothing, another one for each number: Warp compiles it if its cache lacks it."""

    @own_module()
    def nothing() -> None:
        _ = wp.int64(wp.static(number))

    return nothing


_headers: _Headers | None = None


def _keep_headers() -> None:
    """Have Warp keep its precompiled headers, where it lets itself be told to: there is no public way."""
    global _headers
    runtime: Any = getattr(getattr(getattr(wp, "_src", None), "context", None), "runtime", None)
    header = Path(str(wp.__file__)).parent / "native" / "builtin.h"
    if hasattr(runtime, "get_clang_pch_dir") and header.exists() and wp.config.cache_kernels:
        _headers = runtime.get_clang_pch_dir = _Headers(header)


_started = False
_starting = Lock()


def start_warp() -> None:
    """Initialise Warp, without the line by which its C library says that there is no GPU driver."""
    global _started
    if _started:
        return
    with _starting:
        if _started:
            return
        try:
            if wp.config.log_level < wp.LOG_WARNING:
                wp.init()
            else:
                with _without_driver_note():
                    wp.init()
        except OSError as error:
            if error.filename is None:  # of no file
                raise
            raise CompileError(f"kernels cannot be kept: {error}; WARP_CACHE_PATH names another folder") from error
        _keep_headers()
        _started = True


@contextmanager
def _without_driver_note() -> Iterator[None]:
    """Within it, the process's error stream goes to a file, and from there, less that line, to where it went."""
    try:
        kept = os.dup(2)
    except OSError:  # there is none
        yield
        return
    with tempfile.TemporaryFile() as file:
        if sys.stderr is not None:
            sys.stderr.flush()
        os.dup2(file.fileno(), 2)
        try:
            yield
        finally:
            if sys.stderr is not None:
                sys.stderr.flush()
            os.dup2(kept, 2)
            os.close(kept)
            file.seek(0)
            others = [line for line in file if _NO_DRIVER not in line]
            if others:
                os.write(2, b"".join(others))


_quieten()
COMPILER = Compiler()
if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=COMPILER.forget)
