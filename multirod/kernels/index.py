"""Where compiled kernels lie, by what they are made of: a process that finds one here calls it without making it.

Warp finds a kernel in its cache by a hash of all that it calls, so that each process makes all of it again to find the hash: that
takes about as long as all else before a first solve. What a kernel of this package is made of is known without: the texts of the
package, Warp, its settings, and the arguments of the function that makes it. Where any of it differs, or cannot be told, the
kernel is made as ever. Only the processor's kernels stand here.
"""

import ctypes
import json
import os
import sys
import tempfile
from collections.abc import Callable, Hashable
from contextlib import suppress
from dataclasses import fields, is_dataclass
from functools import cache, partial
from hashlib import sha256
from importlib.util import find_spec
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import warp as wp

PACKAGE = __name__.partition(".")[0]

Maker = wp.Kernel | Callable[[], wp.Kernel]  # a kernel, or what makes it


class Function(NamedTuple):
    """A compiled kernel, as it is called: with the addresses of its bounds and of its arguments.

    Attributes:
        module: Of Warp's that it is compiled in.
        call: The function.
        kinds: Of its arguments, as ``kinds_of`` tells them.
        owner: What it is unloaded with; None is never.
    """

    module: str
    call: Any
    kinds: tuple[str, ...]
    owner: object


class Untold(Exception):
    """Raised where it cannot be told what a kernel is made of."""


def made_of(maker: Maker) -> str:
    """What makes a kernel, in words that are the same in each process.

    Raises:
        Untold: Where code is in it that is not of this package, or that stands within a function.
    """
    if isinstance(maker, wp.Kernel):
        return _place(maker.func)
    if isinstance(maker, partial):
        return f"{_place(maker.func)}{_told(maker.args)}{_told(tuple(sorted(maker.keywords.items())))}"
    return f"{_place(maker)}()"


def _told(value: object) -> str:
    if value is None or type(value) in (bool, int, float, str):
        return repr(value)
    if type(value) is tuple:
        return f"({', '.join(map(_told, value))})"
    if isinstance(value, type):
        return _place(value)
    if is_dataclass(value):
        return f"{_place(type(value))}{_told(tuple((field.name, getattr(value, field.name)) for field in fields(value)))}"
    raise Untold(value)


def _place(named: Any) -> str:  # noqa: ANN401  (a function or a class)
    module, name = getattr(named, "__module__", None) or "", getattr(named, "__qualname__", "<locals>")
    if not module.startswith(f"{PACKAGE}.") or "<" in name:
        raise Untold(named)
    return f"{module}:{name}"


def _files() -> list[tuple[str, str, int, int]]:
    """The texts of this package: of each the folder it is imported from, its place there, its time and size."""
    places, found = set[str](), []
    for name in (PACKAGE, f"{PACKAGE}.models", f"{PACKAGE}.solvers"):
        spec = find_spec(name)
        places.update(spec.submodule_search_locations or () if spec else ())
    for place in sorted(places):
        for file in sorted(Path(place).rglob("*.py")):
            state = file.stat()
            found.append((place, str(file.relative_to(place)), state.st_mtime_ns, state.st_size))
    return found


_FILES = _files()  # as this process began to import them


@cache
def _texts() -> str:
    """Hash of the texts of this package.

    Raises:
        Untold: If one has changed since the process began to import them, or they are not there.
    """
    if not any(Path(place) / file == Path(__file__) for place, file, *_ in _FILES):
        raise Untold("this is not imported from texts")
    found = sha256()
    for place, file, _, size in _FILES:
        found.update(f"{file} {size} ".encode() + (Path(place) / file).read_bytes())
    if _files() != _FILES:
        raise Untold("the package has changed")
    return found.hexdigest()


def _settings() -> str:
    """What makes and compiles kernels, its settings, and the processor."""
    plain = {name: value for name, value in sorted(vars(wp.config).items()) if type(value) in (bool, int, float, str)}
    return f"{sys.version} {np.__version__} {wp.__version__} {wp.get_cpu_kernel_cache_key()} {plain}"


def kinds_of(kernel: wp.Kernel) -> tuple[str, ...]:
    """What the arguments of a kernel are, as far as their room in memory goes: arrays, structs or numbers.

    Raises:
        AttributeError: If one is anything else.
        TypeError: If the kernel is launched over several axes.
    """
    if kernel.adj.kernel_dim != 1:
        raise TypeError("the bounds of a launch have one axis")
    types: list[Any] = [argument.type for argument in kernel.adj.args]
    return tuple(_kind_of(own) or own._type_.__name__ for own in types)


def _kind_of(own: Any) -> str | None:  # noqa: ANN401  (an argument, or the type of one)
    if hasattr(own, "ndim") and not isinstance(own, np.ndarray | np.generic):  # an array, or the type of arrays
        return f"array of {own.ndim}, {wp.types.type_size_in_bytes(own.dtype)}"
    struct = getattr(own, "_cls", own)
    return f"{struct.key} of {ctypes.sizeof(struct.ctype)}" if hasattr(struct, "ctype") else None


def packed(kind: str, value: Any) -> Any:  # noqa: ANN401  (what Warp makes of it)
    """An argument as the kernel reads it.

    Raises:
        TypeError: If it is not of this kind.
    """
    own = _kind_of(value)
    if own is None and kind.startswith("c_") and isinstance(value, int | float | np.integer | np.floating):
        return getattr(ctypes, kind)(value)
    if own != kind:
        raise TypeError(f"an argument of a kernel is {own or repr(value)}, and must be {kind}")
    return value.__ctype__()


def bounds(dim: int) -> Any:  # noqa: ANN401  (Warp's own)
    """Of a launch of so many threads, as a kernel reads them."""
    return wp._src.types.launch_bounds_t(dim)


class Index:
    """The kernels that are known by what they are made of: in this process, and in files beside what Warp compiled."""

    def __init__(self) -> None:
        self._known: dict[str, Function] = {}
        self._tried: set[str] = set()  # to be kept, once: where it cannot be, whoever expects a kernel would try again
        self._keys: dict[Hashable, str | None] = {}
        self._settings: list[object] = []  # with which these were found

    def find(self, maker: Maker) -> tuple[str | None, Function | None]:
        """The key of a kernel, and it; None where there is none."""
        key = self._key(maker) if wp.config.cache_kernels else None
        if key is None:
            return None, None
        if key not in self._known:
            with suppress(OSError, ValueError, KeyError, TypeError, AttributeError, ctypes.ArgumentError):
                self._known[key] = self._load(json.loads(_file(key).read_text()))
        return key, self._known.get(key)

    def _key(self, maker: Maker) -> str | None:
        if (now := list(vars(wp.config).values())) != self._settings:
            self._keys, self._settings = {}, now
        own = (maker.func, maker.args, tuple(maker.keywords.items())) if isinstance(maker, partial) else maker
        try:
            if own not in self._keys:
                self._keys[own] = sha256(f"{_texts()} {_settings()} {made_of(maker)}".encode()).hexdigest()
        except (OSError, Untold):
            self._keys[own] = None
        except TypeError:  # what it is made with cannot be told apart from others
            return None
        return self._keys[own]

    def _load(self, entry: dict[str, Any]) -> Function:
        binary = Path(str(wp.config.kernel_cache_dir)) / entry["binary"]
        if binary.stat().st_size != entry["size"]:
            raise ValueError("another was compiled there")
        llvm, handle = _llvm(), f"{PACKAGE}_{entry['symbol']}"
        if llvm.wp_load_obj(str(binary).encode(), handle.encode(), wp.config.legacy_cpu_linker):
            raise OSError("it cannot be loaded")
        call = ctypes.CFUNCTYPE(None)(llvm.wp_lookup(handle.encode(), entry["symbol"].encode()))
        if not call:
            raise ValueError("it is not there")
        return Function(entry["module"], call, tuple(entry["kinds"]), None)

    def remember(self, key: str, function: Function) -> None:
        """What was made and loaded is found from now on in this process."""
        self._known[key] = function

    def keep(self, key: str, kernel: wp.Kernel, binary: Path) -> None:
        """What was made and compiled is found by other processes; where that is not possible, they make it again."""
        if key in self._tried:
            return
        self._tried.add(key)
        with suppress(OSError, ValueError, AttributeError, TypeError):
            if _files() != _FILES:  # what was imported may be neither what was there nor what is
                return
            entry = {
                "module": kernel.module.name,
                "binary": str(binary.relative_to(str(wp.config.kernel_cache_dir))),
                "size": binary.stat().st_size,
                "symbol": f"{kernel.get_mangled_name()}_cpu_forward",
                "kinds": kinds_of(kernel),
            }
            file = _file(key)
            file.parent.mkdir(exist_ok=True)
            with tempfile.NamedTemporaryFile("w", dir=file.parent, delete=False) as half:
                json.dump(entry, half)
            os.replace(half.name, file)


def _file(key: str) -> Path:
    return Path(str(wp.config.kernel_cache_dir)) / f"{PACKAGE}_index" / f"{key}.json"


def _llvm() -> Any:  # noqa: ANN401  (Warp's compiler, which has no public way to load what it compiled)
    runtime: Any = wp._src.context.runtime
    return runtime.llvm


INDEX = Index()
