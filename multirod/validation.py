"""Checks of user input. Every error names the field, the value and what is allowed."""

import math
from collections.abc import Iterable
from typing import Any, NoReturn

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]


class Described(str):
    """A description in place of a value too large to print; shown without quotes."""

    def __repr__(self) -> str:
        return str(self)


def refuse(field: str, value: object, allowed: str) -> NoReturn:
    """Raise the ``ValueError`` that every refused input ends in."""
    raise ValueError(f"{field} = {value!r} is not allowed: {allowed}")


def number(field: str, value: object) -> float:
    """``value`` as a float."""
    if isinstance(value, (bool, str, bytes)) or value is None:
        refuse(field, value, "must be a number")
    try:
        return float(value)  # type: ignore[arg-type]
    except (TypeError, ValueError):
        refuse(field, value, "must be a number")


def finite_float(field: str, value: object) -> float:
    """A finite number."""
    result = number(field, value)
    if not math.isfinite(result):
        refuse(field, value, "must be finite")
    return result


def positive_float(field: str, value: object) -> float:
    """A finite number > 0."""
    result = number(field, value)
    if not (math.isfinite(result) and result > 0):
        refuse(field, value, "must be finite and > 0")
    return result


def nonnegative_float(field: str, value: object) -> float:
    """A finite number >= 0."""
    result = number(field, value)
    if not (math.isfinite(result) and result >= 0):
        refuse(field, value, "must be finite and >= 0")
    return result


def positive_int(field: str, value: object, minimum: int = 1) -> int:
    """An integer, at least ``minimum``."""
    if isinstance(value, bool) or not isinstance(value, (int, np.integer)) or value < minimum:
        refuse(field, value, f"must be an integer >= {minimum}")
    return int(value)


def boolean(field: str, value: object) -> bool:
    """True or False, not something that counts as such."""
    if not isinstance(value, (bool, np.bool_)):
        refuse(field, value, "must be True or False")
    return bool(value)


def choice(field: str, value: object, allowed: Iterable[str]) -> str:
    """One of the names in ``allowed``."""
    options = tuple(allowed)
    if not isinstance(value, str) or value not in options:
        refuse(field, value, "must be one of " + ", ".join(repr(option) for option in options))
    return value


def frozen(values: Any) -> Any:
    """A read-only view of an array: what a result or a robot hands out, so that writing to it changes neither."""
    view = np.asarray(values).view()
    view.flags.writeable = False
    return view


def array(field: str, value: Any, tail: tuple[int, ...] = (), *, finite: bool = True) -> FloatArray:
    """``value`` as a float array whose last axes have the shape ``tail``; leading axes are batch axes.

    It is a copy that cannot be written to: neither changes what ``value`` is made of, nor is changed by it.
    """
    wanted = "a number" if not tail else f"shape (..., {', '.join(str(size) for size in tail)})"
    try:
        given = np.asarray(value)
    except (TypeError, ValueError):  # ragged
        refuse(field, value, f"must be numeric, {wanted}")
    if given.dtype.kind not in "fiu":
        refuse(field, value, f"must be numeric, {wanted}")
    result = given.astype(np.float64)
    if tail and result.shape[-len(tail) :] != tail:
        refuse(field, value if result.size < 20 else Described(f"array of shape {result.shape}"), f"must have {wanted}")
    if finite and not np.isfinite(result).all():
        refuse(field, value if result.size < 20 else Described(f"array of shape {result.shape}"), "must be finite")
    result.flags.writeable = False
    return result


def positive_array(field: str, value: Any, tail: tuple[int, ...] = (), *, infinite: bool = False) -> FloatArray:
    """A positive array; with ``infinite``, ``inf`` (rigid) is allowed."""
    result = array(field, value, tail, finite=False)
    if np.isnan(result).any() or (result <= 0).any() or (not infinite and np.isinf(result).any()):
        allowed = "must be > 0 (inf is rigid)" if infinite else "must be finite and > 0"
        refuse(field, value if result.size < 20 else Described(f"array with minimum {result.min()}"), allowed)
    return result


def unknown_names(owner: str, given: Iterable[str], allowed: Iterable[str]) -> None:
    """Refuse, by a ``TypeError``, names that are not in ``allowed``."""
    options = tuple(allowed)
    for name in given:
        if name not in options:
            raise TypeError(f"{owner} takes no {name!r}: it takes " + ", ".join(options))
