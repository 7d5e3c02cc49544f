"""Whether two robots, inputs or solvers are the same in all their numbers, told by a few digits."""

from functools import cached_property
from hashlib import blake2b
from typing import Any

import numpy as np

_CALLABLE = (type, type(len), type(lambda: None))


def digest(field: str, value: object) -> str:
    """32 digits that differ where any number, name or type in ``value`` does.

    What counts is what pickles: an object's state is that of ``__reduce_ex__``, less what ``cached_property`` keeps.

    Raises:
        TypeError: If something in it cannot be told apart from others, such as an open file or a lambda.
    """
    result = blake2b(digest_size=16)
    try:
        _feed(result, value, [])
    except TypeError as error:
        raise TypeError(
            f"{field} cannot be told apart from others, so that a study of it could not be resumed: {error}"
        ) from error
    return result.hexdigest()


def _feed(result: blake2b, value: Any, path: list[int]) -> None:  # noqa: ANN401  (told by its type)
    """Feed one object; each kind is fed with its name and its size, so that no two kinds look alike."""

    def feed(*parts: object) -> None:
        for part in parts:
            _feed(result, part, [*path, id(value)])

    def name(*words: object) -> None:
        result.update(("\0".join(map(str, words)) + "\0").encode())

    if id(value) in path:
        name("cycle", len(path) - path.index(id(value)))
    elif value is None or type(value) in (bool, int, float, complex, str, bytes):
        name(type(value).__name__, len(repr(value)), repr(value))
    elif isinstance(value, (np.ndarray, np.generic)):
        array = np.ascontiguousarray(value)
        if array.dtype.hasobject:
            raise TypeError(f"an array of {array.dtype}")
        name("array", array.dtype.str, np.shape(value))
        result.update(array.tobytes())
    elif type(value) in (tuple, list):
        name("list", len(value))
        feed(*value)
    elif type(value) is dict:
        name("dict", len(value))
        feed(*(item for key in sorted(value, key=repr) for item in (key, value[key])))
    elif type(value) in (set, frozenset):
        name("set", *sorted(digest("", item) for item in value))
    elif isinstance(value, _CALLABLE):
        if "<" in value.__qualname__:
            raise TypeError(f"{value!r} has no name by which it is found")
        name("name", value.__module__, value.__qualname__)
    else:
        reduced = value.__reduce_ex__(4)
        name("object", type(value).__module__, type(value).__qualname__)
        if isinstance(reduced, str):
            name(reduced)
            return
        maker, arguments, state, *items = (*reduced, None, None, None)[:5]
        if isinstance(state, dict):
            owner = type(value)
            state = {key: kept for key, kept in state.items() if not isinstance(getattr(owner, key, None), cached_property)}
        feed(maker, arguments, state, *(None if more is None else list(more) for more in items))
