"""Checks of user input. Every error names the field, the value and what is allowed."""

import math
import os
from collections.abc import Iterable, Sequence
from numbers import Real
from pathlib import Path
from typing import Any, NoReturn, TypeVar

import numpy as np
from numpy.typing import NDArray

from multirod.naming import meant

FloatArray = NDArray[np.float64]
Kind = TypeVar("Kind", bound=np.generic)

DOUBLE = np.dtype(np.float64)
LARGEST_INT = 2**31 - 1  # counts are kept in 32 bits
LARGEST = 1e50  # in SI units: products of several such numbers are still floats, and no robot is larger
SMALLEST = 1 / LARGEST
LONGEST = 200  # characters of a value that an error shows
FEW = 20  # numbers of an array from which an error shows its shape, and one of them
SMALLEST_AXIS = 1e-100  # whose square still is a number
ROUNDED = 1e-15  # what the length of an axis of length 1 may be off


_POSE_HINTS: dict[tuple[int, ...], str] = {
    (3, 3): "of a rotation alone, give mr.Pose(position=(0, 0, 0), rotation=...)",
    (3, 4): "the last row 0, 0, 0, 1 is missing",
    (3,): "of a position alone, give mr.Pose(position=..., rotation=np.eye(3))",
    (6,): "of position and angles, give mr.Pose(position=..., rotation=...), the rotation a matrix",
    (7,): "of position and quaternion, give mr.Pose(position=..., rotation=...), the rotation a matrix",
    (16,): "reshape it to (..., 4, 4)",
}  # by last axes
_ROTATION_HINTS: dict[tuple[int, ...], str] = {
    (3,): "three angles, or a rotation vector, are made one by SciPy's Rotation, and its as_matrix()",
    (4,): "a quaternion is made one by SciPy's Rotation.from_quat(...).as_matrix()",
    (4, 4): "of a pose, [:3, :3] is the rotation and [:3, 3] the position",
}
_VECTOR_HINTS: dict[tuple[int, ...], str] = {
    (): "one number has no direction: give x, y and z, such as (0, 0, -1)",
    (1,): "one number has no direction: give x, y and z, such as (0, 0, -1)",
    (2,): "in a plane the third is 0",
    (4,): "without a fourth for homogeneous coordinates",
    (6,): "a wrench is two inputs, tip_force and tip_moment",
}


class Described(str):
    """A description in place of a value too large to print; shown without quotes."""

    def __repr__(self) -> str:
        return str(self)


def refuse(field: str, value: object, allowed: str) -> NoReturn:
    """Raise the ``ValueError`` that every refused input ends in."""
    raise ValueError(f"{field} = {shown(value)} is not allowed: {allowed}")


def shown(value: object) -> str:
    """``repr`` of a value, cut short where it is long; of a large array its shape, of what has no ``repr`` its type."""
    if isinstance(value, np.ndarray) and value.size >= FEW:
        return f"array of shape {value.shape}"
    try:
        with np.printoptions(legacy="1.25"):  # numbers of NumPy as numbers, and not as np.float64(0.1)
            text = repr(value)
    except Exception:  # noqa: BLE001  (whatever someone's object raises, or an integer of more digits than Python prints)
        return f"<{type(value).__name__}>"
    return text if len(text) <= LONGEST else f"{text[:LONGEST]}... ({len(text)} characters)"


def first_of(wrong: NDArray[np.bool_], values: NDArray[Any], value: object) -> object:
    """What an error shows of ``values``, read from ``value``: all of few; of more the first that is ``wrong`` and its place, by
    the first axes, those of ``wrong``."""
    if values.size < FEW:
        return value
    at = np.argwhere(wrong)[0].tolist()
    return Described(f"{values[tuple(at)].tolist()} at {at} of shape {values.shape}")


def at_first(there: object, *values: object) -> list[float]:
    """What values are, broadcast, at the first place that is meant."""
    meant, *others = np.broadcast_arrays(there, *values)  # type: ignore[arg-type]
    return [float(value.flat[int(np.argmax(meant))]) for value in others]


def number(field: str, value: object) -> float:
    """``value`` as a float."""
    if type(value) is float:
        return value
    if isinstance(value, np.ndarray) and not isinstance(value, np.ma.MaskedArray) and value.ndim == 0:
        value = value[()]
    if isinstance(value, (bool, np.bool_, np.timedelta64)) or not isinstance(value, Real):
        refuse(field, value, "must be a number")
    try:
        with np.errstate(over="ignore"):
            return float(value)
    except OverflowError:
        refuse(field, value, "must be a number that is finite in double precision")


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
    return _no_larger(field, value, result)


def nonnegative_float(field: str, value: object) -> float:
    """A finite number >= 0."""
    result = number(field, value)
    if not (math.isfinite(result) and result >= 0):
        refuse(field, value, "must be finite and >= 0")
    return _no_larger(field, value, result)


def _no_larger(field: str, value: object, result: float) -> float:
    if result > LARGEST:
        refuse(field, value, f"must be at most {LARGEST:g} in SI units")
    return result


def positive_int(field: str, value: object, minimum: int = 1) -> int:
    """An integer, at least ``minimum``."""
    whole = isinstance(value, (int, np.integer)) and not isinstance(value, (bool, np.timedelta64))
    if not whole or value < minimum:  # type: ignore[operator]
        refuse(field, value, f"must be an integer >= {minimum}")
    if value > LARGEST_INT:  # type: ignore[operator]
        refuse(field, value, f"must be an integer >= {minimum} and <= {LARGEST_INT}")
    return int(value)  # type: ignore[call-overload, no-any-return]


def boolean(field: str, value: object) -> bool:
    """True or False, not something that counts as such."""
    if not isinstance(value, (bool, np.bool_)):
        refuse(field, value, "must be True or False")
    return bool(value)


def instance(field: str, value: object, kind: type | tuple[type, ...], allowed: str) -> None:
    """Refuse, by a ``TypeError``, what is not of a kind."""
    if not isinstance(value, kind):
        raise TypeError(f"{field} = {shown(value)} is not allowed: must be {allowed}, not {type(value).__name__}")


def sequence(field: str, value: object, kind: type | tuple[type, ...], allowed: str) -> tuple[Any, ...]:
    """A list or tuple of one kind of object, as a tuple; refused by a ``TypeError``."""
    if not isinstance(value, (list, tuple)) or not all(isinstance(item, kind) for item in value):
        raise TypeError(f"{field} = {shown(value)} is not allowed: must be a list of {allowed}")
    return tuple(value)


def integers(field: str, value: object) -> NDArray[np.intp]:
    """Integers of shape (k,)."""
    try:
        given = np.asarray(value) if not _hides(value) else None
    except Exception:  # noqa: BLE001  (ragged, or whatever someone's object raises)
        given = None
    if given is not None and given.shape == (0,):
        return np.zeros(0, dtype=np.intp)
    if given is None or given.ndim != 1 or given.dtype.kind not in "iu":
        size = value if given is None else Described(f"{given.dtype} array of shape {given.shape}")
        refuse(field, size, "must be integers of shape (k,)")
    if given.dtype.kind == "u" and given.max() > np.iinfo(np.intp).max:
        refuse(field, value, f"must be at most {np.iinfo(np.intp).max}")
    return given.astype(np.intp)


def device_name(field: str, value: object) -> str:
    """The name of a device that there is."""
    from multirod.kernels.compiling import start_warp

    start_warp()
    if isinstance(value, str) and value == "cpu":  # which there always is
        return value
    import warp as wp

    names = [device.alias for device in wp.get_devices()]
    # "cuda" is the present one of several
    if isinstance(value, str) and (value in names or (value == "cuda" and wp.is_cuda_available())):
        return value
    refuse(field, value, "must be one of Warp's devices here, " + ", ".join(map(repr, names)))


def index_of(field: str, value: object, names: Sequence[str | None]) -> int | None:
    """The index of what has this name, and no other, or the index ``value`` itself, from the end if negative; None if there is no
    such."""
    if isinstance(value, str):
        own = [k for k, name in enumerate(names) if name == value]
        if len(own) > 1:
            refuse(field, value, f"must be one of the indices {own}: all of these have that name")
        return own[0] if own else None
    if isinstance(value, bool) or not isinstance(value, (int, np.integer)) or not -len(names) <= value < len(names):
        return None
    return int(value)


def known_as(names: Sequence[str | None]) -> str:
    """How a rod or line of these names may be called."""
    own = [name for name in names if name]
    return f"must be an index below {len(names)}{f' or one of the names {own}' if own else '; none has a name'}"


def some_names(field: str, value: object) -> tuple[str, ...]:
    """A name, or several, as a tuple; refused by a ``TypeError``."""
    return sequence(field, listed(value), str, "names, such as ('rotation', 'tip_force')")


def listed(value: object) -> list[Any]:
    """What there may be one of, or several, as a list; NumPy's numbers as Python's."""
    several = isinstance(value, Iterable) and not isinstance(value, str) and getattr(value, "shape", None) != ()
    given: list[Any] = list(value) if several else [value]  # type: ignore[call-overload]
    return [own.item() if isinstance(own, np.integer) else own for own in given]


def choice(field: str, value: object, allowed: Iterable[str]) -> str:
    """One of the names in ``allowed``."""
    options = tuple(allowed)
    if not isinstance(value, str) or value not in options:
        hint = meant(value, options) if isinstance(value, str) else ""
        refuse(field, value, "must be one of " + ", ".join(repr(option) for option in options) + hint)
    return value


def frozen(values: NDArray[Kind]) -> NDArray[Kind]:
    """A read-only view of an array: what a result or a robot hands out, so that writing to it changes neither."""
    view = np.asarray(values).view()
    view.flags.writeable = False
    return view


def array(field: str, value: object, tail: tuple[int, ...] = (), *, finite: bool = True, wanted: str = "") -> FloatArray:
    """``value`` as a float array whose last axes have the shape ``tail``; leading axes are batch axes.

    It is a copy that cannot be written to: neither changes what ``value`` is made of, nor is changed by it. ``wanted`` is what
    errors call it.
    """
    if type(value) is np.ndarray and value.dtype is DOUBLE and (not tail or value.shape[-len(tail) :] == tail):
        copied: FloatArray = value.copy()  # most are so
        if not finite or (np.abs(copied) <= LARGEST).all():
            copied.flags.writeable = False
            return copied
    wanted = wanted or ("a number" if not tail else f"shape (..., {', '.join(str(size) for size in tail)})")
    if _hides(value):
        refuse(field, value, f"must be numeric, {wanted}, without booleans and masks")
    try:
        given = np.asarray(value)
    except Exception:  # noqa: BLE001  (ragged, or whatever someone's object raises)
        refuse(field, value, f"must be numeric, {wanted}{_together_meant(value, tail)}")
    if given.dtype.kind not in "fiu" or isinstance(value, (bytearray, memoryview)):
        of_table = "; a row of a table with text in it is of dtype object: give its .astype(float)"
        refuse(field, value, f"must be numeric, {wanted}{of_table * (getattr(value, 'dtype', None) == object)}")
    if given.dtype == np.float64:
        result = np.array(given, dtype=np.float64)
    else:
        with np.errstate(over="ignore"):  # from longer floats
            result = given.astype(np.float64)
    if tail and result.shape[-len(tail) :] != tail:
        named = value if result.size < FEW else Described(f"array of shape {result.shape}")
        refuse(field, named, f"must have {wanted}{_shape_meant(field, result.shape, tail)}")
    if finite and not (within := np.abs(result) <= LARGEST).all():  # one comparison tells both, of most
        if not (known := np.isfinite(result)).all():
            missing = "; NaN of a result stands where there is none, ask its status" * bool(np.isnan(result).any())
            refuse(field, first_of(~known, result, value), f"must be finite{missing}")
        refuse(field, first_of(~within, result, value), f"must be finite, and at most {LARGEST:g} in SI units")
    result.flags.writeable = False
    return result


def measurement(field: str, value: object, tail: tuple[int, ...] = ()) -> FloatArray:
    """Like ``array``, of what a sensor says: NaN where it dropped out."""
    result = array(field, value, tail, finite=False)
    if not (np.abs(result) <= LARGEST).all():
        if (wrong := np.isinf(result)).any():
            refuse(field, first_of(wrong, result, value), "must be finite, or NaN where there is no measurement")
        if (wrong := np.abs(result) > LARGEST).any():
            refuse(field, first_of(wrong, result, value), f"must be at most {LARGEST:g} in SI units")
    return result


def unsure(given: FloatArray, *, infinite: bool = False) -> NDArray[np.bool_]:
    """Where there is no standard deviation, or none whose square counts for anything beside others."""
    return ~((given >= SMALLEST) & (given <= LARGEST) | infinite & np.isposinf(given))


def directions(field: str, value: object, axes: FloatArray) -> FloatArray:
    """``axes`` (..., 3), read from ``value``, as long as 1; those that are stay as they are: the same again from what was kept.

    Raises:
        ValueError: If one is zero, or its square is no number.
    """
    with np.errstate(over="ignore"):
        size = np.linalg.norm(axes, axis=-1)
    if not (fit := (size > SMALLEST_AXIS) & (size < 1 / SMALLEST_AXIS)).all():
        length = "a length" if axes.ndim == 1 else "lengths"
        refuse(field, first_of(~fit, axes, value), f"must have {length} from {SMALLEST_AXIS:g} to {1 / SMALLEST_AXIS:g}")
    return np.asarray(frozen(axes / np.where(np.abs(size - 1) <= ROUNDED, 1.0, size)[..., None]))


def _together_meant(value: object, tail: tuple[int, ...]) -> str:
    """What was probably meant by numbers beside arrays, as the end of a message."""
    if not isinstance(value, (list, tuple)):
        return ""
    try:
        shapes = [np.shape(item) for item in value if not isinstance(item, (list, tuple))]
        pairs = [[np.ndim(part) for part in item] for item in value if isinstance(item, (list, tuple)) and len(item) == 2]
        alike = np.broadcast_shapes(*shapes) if len(shapes) == len(value) else ()
    except Exception:  # noqa: BLE001  (lengths that do not fit, or whatever someone's object raises)
        return ""
    if len(pairs) == len(value) and all(first < second for first, second in pairs):
        return "; what varies along a rod, beside its precurvature, is given by sections, Rod(sections=[Section(...), ...])"
    if not alike or (tail and len(value) != tail[-1]):
        return ""
    return f"; of a batch {alike}, components are put together by np.stack(np.broadcast_arrays(...), axis=-1)"


def _shape_meant(field: str, shape: tuple[int, ...], tail: tuple[int, ...]) -> str:
    """What was probably meant by an array of the wrong shape, as the end of a message."""
    hint = ""
    if len(tail) == 1 and len(shape) > 1 and shape[-2] == tail[0]:
        hint = f"it is transposed: give its .T, shape {(*shape[:-2], shape[-1], shape[-2])}"
    elif tail == (4, 4):
        hint = _POSE_HINTS.get(shape[-2:], _POSE_HINTS.get(shape[-1:], ""))
    elif tail == (3, 3):
        hint = _ROTATION_HINTS.get(shape[-2:], _ROTATION_HINTS.get(shape[-1:], ""))
    elif tail == (3,):
        each = "one number of each has no direction: of a batch, np.stack([x, y, z], axis=-1)" if len(shape) == 1 else ""
        hint = _VECTOR_HINTS.get(shape[-1:], each)
    elif tail == (2,) and shape[-1:] == (3,) and field.endswith("offset"):
        hint = "in the plane of the section, two numbers"
    elif len(tail) == 1 and len(shape) == 1:
        hint = f"one column for each of {tail[0]}, also where all are the same"
    return f"; {hint}" if hint else ""


PLAIN = {int, float, np.float64}


def _hides(value: object) -> bool:
    """Whether there are booleans or masks in a value, which numpy would turn into numbers."""
    if isinstance(value, (list, tuple)):
        return not PLAIN.issuperset(map(type, value)) and any(map(_hides, value))
    return isinstance(value, (bool, np.bool_, np.ma.MaskedArray))


def positive_array(
    field: str, value: object, tail: tuple[int, ...] = (), *, infinite: bool = False, smallest: float = SMALLEST
) -> FloatArray:
    """A positive array, of at least ``smallest``; with ``infinite``, ``inf`` (rigid) is allowed."""
    result = array(field, value, tail, finite=False)
    if not result.size:
        refuse(field, Described(f"array of shape {result.shape}"), "must have a value")
    if (wrong := ~(result > 0) | ((not infinite) & np.isinf(result))).any():
        allowed = "must be > 0 (inf is rigid)" if infinite else "must be finite and > 0"
        refuse(field, first_of(wrong, result, value), allowed)
    if (wrong := (result < smallest) | ((result > LARGEST) & np.isfinite(result))).any():
        allowed = f"must be from {smallest:g} to {LARGEST:g} in SI units" + (", or inf" if infinite else "")
        refuse(field, first_of(wrong, result, value), allowed)
    return result


def path_of(field: str, value: object) -> Path:
    """A path."""
    try:
        text = os.fsdecode(value) if isinstance(value, (str, os.PathLike)) else ""
    except Exception:  # noqa: BLE001  (whatever someone's path raises)
        text = ""
    if not text or "\0" in text:
        refuse(field, value, "must be a path")
    path = Path(text)
    try:
        path.exists()
    except OSError:
        refuse(field, value, "must be a path of a length that the system allows")
    return path


def file_path(field: str, value: object, *endings: str) -> Path:
    """A file to be written, in a folder that exists, with one of these endings (any, if none is named)."""
    path = path_of(field, value)
    try:
        usable = not path.is_dir() and path.parent.is_dir()
    except OSError:  # longer than the system allows
        usable = False
    if endings and path.suffix.lower() not in endings:
        refuse(field, str(path), f"must end in {' or '.join(endings)}")
    if not usable:
        refuse(field, str(path), "must be a file in a folder that exists")
    return path
