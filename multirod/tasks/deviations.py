"""Standard deviations of what is measured, as users give them."""

from collections.abc import Sequence

import numpy as np

from multirod.validation import LARGEST, SMALLEST, FloatArray, array, refuse, unsure

ONE_OR_THREE = ("one number", "one number, or three along the axes of the world")


def deviations(field: str, value: object, parts: Sequence[tuple[str, int, bool]]) -> FloatArray:
    """Standard deviations of each row, (m,), of one or two parts: each what it is of, its rows, and whether it has three."""
    if len(parts) == 1:
        said, _, each = parts[0]
        message = f"must be one number: of {said}{', or three along the axes of the world' if each else ''}"
        given: list[object] = [value]
    else:
        message = f"must be a pair: of {' and of '.join(said for said, _, _ in parts)}"
        given = list(value) if isinstance(value, (tuple, list, np.ndarray)) and np.ndim(value[:1]) else []
        if len(given) != 2:
            refuse(field, value, message)
    result = []
    for (said, rows, each), own in zip(parts, given, strict=True):
        found = array(field, own, finite=False)
        if found.shape not in ((), (1,), *([(3,)] if each else [])):
            refuse(field, value, message if len(parts) == 1 else f"{message}; of {said} " + ONE_OR_THREE[each])
        refuse_unsure(field, value, found)
        result.append(np.broadcast_to(found, (rows,)))
    return np.concatenate(result)


def deviation(field: str, value: object, count: int) -> FloatArray:
    """One for all, or one of each, as (count,)."""
    result = array(field, value, finite=False)
    refuse_unsure(field, value, result)
    try:
        return np.broadcast_to(result, (count,))
    except ValueError:
        refuse(field, value, f"must be one number, or {count}")


def refuse_unsure(field: str, value: object, given: FloatArray) -> None:
    """Refuse what is no standard deviation; ``value`` is what the user gave."""
    if not ((given > 0) & np.isfinite(given)).all():
        refuse(field, value, "must be finite and > 0")
    if unsure(given).any():
        refuse(field, value, f"must be from {SMALLEST:g} to {LARGEST:g} in SI units")
