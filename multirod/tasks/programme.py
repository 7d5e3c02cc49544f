"""Arrays of the step of all tasks, and steps that limits keep. Numbers in parentheses: ``docs/tasks.md``."""

from typing import Any

import numpy as np
import warp as wp

from multirod.launch import record
from multirod.tasks.programme_kernels import Programme, make_keeping
from multirod.validation import FloatArray

HOST = "cpu"  # where steps of few instances are planned, whatever device integrates


def programme(count: int, rows: int, free: int, limits: int, device: str, *, sides: int = 1) -> Programme:
    """A ``Programme`` of ``count`` instances, all zero, but for ``limits``, which are its caller's.

    Args:
        count: Instances.
        rows: Of the task, ``m``.
        free: Inputs, ``k``.
        limits: Rows of limits, ``c``.
        device: Warp device.
        sides: Right-hand sides that are solved at once.
    """
    result = Programme()
    m, k, c = rows, free, limits
    sizes: dict[str, tuple[int, ...]] = {"J": (m, k), "r": (m,), "softness": (), "pull": (k,), "low": (c,), "high": (c,)}
    sizes |= {"change": (k,), "system": (k + m, k + m), "sides": (k + m, sides)}
    sizes |= {"bound_system": (k + m + c, k + m + c), "bound_sides": (k + m + c, 1)}
    for name, shape in sizes.items():
        setattr(result, name, wp.zeros((count, *shape), dtype=wp.float64, device=device))
    held: Any = wp.zeros((count, c), dtype=wp.int32, device=device)
    result.held = held
    return result


def within_limits(
    limits: FloatArray,
    *,
    J: FloatArray,
    r: FloatArray,
    softness: FloatArray | float,
    low: FloatArray,
    high: FloatArray,
    change: FloatArray,
    pull: FloatArray | float = 0.0,
) -> FloatArray:
    """(7) Steps that limits keep, from those without, in units (9), shape (count, k).

    Args:
        limits: Shape (c, k), of all.
        J: Shape (count, m, k).
        r: Shape (count, m).
        softness: Shape (count,).
        low: How far each limit may be gone down to, shape (count, c); none has been passed.
        high: Up to, likewise.
        change: The steps without limits, shape (count, k).
        pull: Where steps are to go beside what ``J`` asks for, likewise.
    """
    count, k = change.shape
    q: Any = programme(count, J.shape[1], k, len(limits), HOST)
    q.limits = wp.array(limits, dtype=wp.float64, device=HOST, ndim=2, shape=(len(limits), k))
    values = {"J": J, "r": r, "softness": softness, "pull": pull, "change": change}
    values |= {"low": np.minimum(low, 0.0), "high": np.maximum(high, 0.0)}
    for name, own in values.items():
        getattr(q, name).numpy()[...] = own
    record(make_keeping, count, [q], HOST).launch()
    return np.array(q.change.numpy())
