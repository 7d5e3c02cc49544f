"""Arrays of the step of all tasks."""

from typing import Any

import warp as wp

from multirod.tasks.programme_kernels import Programme


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
