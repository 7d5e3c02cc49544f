"""A chunk's arrays as columns of a table, and back: column ``tip_position_0`` is component 0 of ``tip_position``."""

import json
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from multirod.codes import Code
from multirod.stability import Stability
from multirod.status import Status

# Kept by name, so that a reader without this package knows what they say; what they are where nothing is done yet.
ENUMERATIONS: dict[str, tuple[type[Code], Code]] = {
    "status": (Status, Status.NOT_RUN),
    "stability": (Stability, Stability.UNKNOWN),
}
_ARRAYS = b"multirod.arrays"

Arrays = dict[str, np.ndarray[Any, Any]]
Tails = dict[str, tuple[int, ...]]


def column_names(name: str, tail: Sequence[int]) -> list[str]:
    """Names of the columns of an array whose rows have the shape ``tail``, in C order."""
    return ["_".join([name, *map(str, index)]) for index in np.ndindex(*tail)]


def to_table(axes: Arrays, arrays: Arrays) -> Any:  # noqa: ANN401  (pyarrow has no types)
    """A row an instance: first the columns of ``axes``, as they are, then each array's components."""
    import pyarrow as pa  # type: ignore[import-untyped]  # here, as it takes a tenth of a second

    columns: dict[str, Any] = dict(axes)
    tails = {}
    for name, values in arrays.items():
        tails[name] = list(values.shape[1:])
        if name in ENUMERATIONS:
            kind = ENUMERATIONS[name][0]
            codes, places = np.unique(values, return_inverse=True)
            columns[name] = pa.DictionaryArray.from_arrays(places.astype(np.int32), [kind(int(code)).name for code in codes])
            continue
        for column, component in zip(column_names(name, values.shape[1:]), values.reshape(len(values), -1).T, strict=True):
            columns[column] = np.ascontiguousarray(component)
    return pa.table(columns).replace_schema_metadata({_ARRAYS: json.dumps(tails).encode()})


def tails_in(metadata: Mapping[bytes, bytes]) -> Tails:
    """Shapes of a row of each array, from the metadata of a table's schema."""
    return {name: tuple(tail) for name, tail in json.loads(metadata[_ARRAYS]).items()}


def from_table(table: Any, names: Sequence[str], tails: Tails) -> Arrays:  # noqa: ANN401  (pyarrow has no types)
    """Arrays (row, ...) of a table that has all their columns."""
    arrays: Arrays = {}
    for name in names:
        tail = tails[name]
        columns = [table.column(column) for column in column_names(name, tail)]
        if name in ENUMERATIONS:
            arrays[name] = np.concatenate([_codes(part, ENUMERATIONS[name][0]) for part in columns[0].chunks])
        else:
            arrays[name] = np.stack([column.to_numpy() for column in columns], axis=-1).reshape(len(table), *tail)
    return arrays


def _codes(part: Any, kind: type[Code]) -> np.ndarray[Any, Any]:  # noqa: ANN401  (pyarrow has no types)
    codes = np.array([int(kind[word]) for word in part.dictionary.to_pylist()], dtype=np.int32)
    return np.asarray(codes[part.indices.to_numpy()])


def blank(name: str, dtype: np.dtype[Any], shape: tuple[int, ...]) -> np.ndarray[Any, Any]:
    """What an array is where nothing is done yet: NaN, ``NOT_RUN``, ``UNKNOWN``, and -1 for other integers."""
    if name in ENUMERATIONS:
        return np.full(shape, int(ENUMERATIONS[name][1]), dtype=dtype)
    return np.full(shape, np.nan if np.issubdtype(dtype, np.floating) else -1, dtype=dtype)
