"""Batches: which rows of an array belong to which instances, systems of each, and how instances are shared out to threads."""

import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from contextlib import suppress
from itertools import pairwise
from math import prod
from threading import Event
from typing import Any, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from multirod.validation import FloatArray, Kind, positive_int, shown

IntArray = NDArray[np.intp]
Instances = IntArray | NDArray[np.bool_] | slice  # some of those along the first axis of an array


def take(values: NDArray[Kind], batch_shape: tuple[int, ...], instances: IntArray | None, *, tail: int) -> NDArray[Kind]:
    """Rows of some instances of a batch.

    Args:
        values: Array whose leading axes broadcast to ``batch_shape``; the last ``tail`` axes are those of a row.
        batch_shape: Leading axes of the batch.
        instances: Numbers of instances in the flattened batch; all by default.
        tail: Axes of a row.

    Returns:
        Array of shape (len(instances), ...).
    """
    shape = (*batch_shape, *values.shape[values.ndim - tail :])
    rows = values if values.shape == shape else np.broadcast_to(values, shape)
    if instances is None or not batch_shape:
        return rows.reshape(prod(batch_shape), *rows.shape[len(batch_shape) :])
    return rows[np.unravel_index(instances, batch_shape)]


One_co = TypeVar("One_co", covariant=True)


class Batch(Protocol[One_co]):
    """What has leading axes, and is indexed by them."""

    @property
    def batch_shape(self) -> tuple[int, ...]:
        """Its leading axes."""

    def __getitem__(self, index: int, /) -> One_co:
        """One of the first of them."""


def along(batch: Batch[One_co]) -> Iterator[One_co]:
    """What has leading axes, along the first of them.

    Raises:
        TypeError: If it has none: by indices alone, it would be as empty as one of no instance.
    """
    if not batch.batch_shape:
        raise TypeError(f"{type(batch).__name__} has no leading axes to go along: it is of one instance")
    return (batch[k] for k in range(batch.batch_shape[0]))


def chosen(batch: Batch[object], values: NDArray[Kind], index: object) -> NDArray[Kind]:
    """``values``, whose leading axes are those of a batch, at an index of the batch.

    Raises:
        IndexError: If there are no such instances; it names the leading axes, and the attribute that a name stands for.
    """
    own: Any = values
    try:
        return np.asarray(own[index])
    except IndexError as error:
        kind, axes = type(batch).__name__, batch.batch_shape
        if isinstance(index, str):
            said = f"an index chooses instances; what it has is asked by name, .{index}"
        elif not axes:
            said = f"this {kind} is of one instance, without leading axes to choose from"
        else:
            said = f"its leading axes are {axes}; {error}"
        raise IndexError(f"{kind}[{shown(index)}] is not allowed: {said}") from None


class Undecided:
    """What is neither true nor false: Python takes every object for true, so one that failed too."""

    def __bool__(self) -> bool:
        raise TypeError(
            f"{type(self).__name__} is neither true nor false: ask its .failed, of each instance, or its .status; "
            ".raise_if_failed() raises where there is no result"
        )


def broadcast_shapes(*shapes: tuple[int, ...]) -> tuple[int, ...]:
    """``np.broadcast_shapes``, which takes as long as a small integration; at once where all that have axes have the same.

    Raises:
        ValueError: If they do not broadcast.
    """
    own: tuple[int, ...] = ()
    for shape in shapes:
        if shape and shape != own:
            if own:
                try:
                    return np.broadcast_shapes(*shapes)
                except ValueError:
                    given = ", ".join(str(axes) for axes in dict.fromkeys(shapes) if axes)
                    raise ValueError(f"leading axes {given} do not broadcast") from None
            own = shape
    return own


def solved_each(matrices: FloatArray, sides: FloatArray) -> FloatArray:
    """``matrices^-1 sides`` (b, n, k); NaN of an instance whose matrix is singular or not finite."""
    try:
        return np.asarray(np.linalg.solve(matrices, sides))
    except np.linalg.LinAlgError:
        result = np.full(sides.shape, np.nan)
        for k in range(len(matrices)):
            with suppress(np.linalg.LinAlgError):
                result[k] = np.linalg.solve(matrices[k], sides[k])
        return result


LONGEST_PART = 8192  # instances: enough for each launch to take long against what Python adds, few enough to share out
SHORTEST_PART = 256


_NEVER = Event()  # set by no one: of what is one part


class Interrupted(RuntimeError):
    """Raised within a part of a batch whose run was stopped."""


def thread_count(threads: object) -> int:
    """The number of threads asked for; by default, one for each core that this process may use.

    Raises:
        ValueError: If it is not an integer >= 1.
    """
    if threads is not None:
        return positive_int("threads", threads)
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def parts(count: int, threads: int, rods: int, device: str) -> list[slice]:
    """How ``count`` instances are shared out: as many parts for each thread, two at least, if that leaves parts worth a launch;
    on a GPU, which runs everything at once, all of it.

    The more ``rods`` an instance has, the shorter they are.
    """
    if device != "cpu":  # as Warp names the one that there is
        return [slice(0, count)]
    longest, shortest = max(1, LONGEST_PART // rods), max(1, SHORTEST_PART // rods)
    if count < 2 * shortest:
        return [slice(0, count)]
    number = max(2, -(-count // (threads * longest)))
    number = threads * max(1, min(number, count // (threads * shortest)))
    if number * shortest > count:
        number = max(1, count // shortest)
    ends = [count * k // number for k in range(number + 1)]
    return [slice(start, end) for start, end in pairwise(ends)]


def run(work: Callable[[slice, Event], None], pieces: Sequence[slice], threads: int) -> None:
    """Call ``work`` with each part, on a pool of threads: kernels release the interpreter lock.

    ``work`` looks at the event, or hands it to ``BoundaryProblem.stop``: it is set when another part has raised, or on Ctrl-C.
    What a part raises is raised here once no thread works any more.
    """
    if threads == 1 or len(pieces) <= 1:
        for piece in pieces:
            work(piece, _NEVER)
        return
    stop = Event()
    with ThreadPoolExecutor(min(threads, len(pieces))) as pool:
        futures = [pool.submit(work, piece, stop) for piece in pieces]
        try:
            for future in as_completed(futures):
                future.result()
        except BaseException:
            stop.set()
            pool.shutdown(cancel_futures=True)
            raise
