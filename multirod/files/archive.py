"""Tables as ``.npz``: each array under its path, and all else as text beside them; nothing is pickled."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any
from zipfile import BadZipFile, is_zipfile

import numpy as np
from numpy.typing import NDArray

from multirod.files.whole import written
from multirod.validation import refuse

ABOUT = "multirod"  # the entry that holds all that is no array


def write(path: Path, table: Mapping[str, Any]) -> None:
    """Write a table of numbers, arrays, strings, tables and lists of these."""
    arrays: dict[str, NDArray[Any]] = {}
    about = json.dumps(_without_arrays(table, "", arrays), indent=1)
    with written(path) as part, part.open("wb") as file:
        np.savez(file, allow_pickle=False, **{ABOUT: np.array(about)}, **arrays)


def _without_arrays(value: object, path: str, arrays: dict[str, NDArray[Any]]) -> object:
    if isinstance(value, np.ndarray):
        arrays[path] = value
        return {"array": path}
    if isinstance(value, Mapping):
        return {name: _without_arrays(item, f"{path}/{name}".lstrip("/"), arrays) for name, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [_without_arrays(item, f"{path}/{k}", arrays) for k, item in enumerate(value)]
    return value


def read(path: Path) -> dict[str, Any]:
    """What ``write`` was given.

    Raises:
        ValueError: If the file is none that it wrote, or broken.
    """
    if not is_zipfile(path):
        refuse("path", str(path), "it is none that multirod wrote")
    try:
        with np.load(path, allow_pickle=False) as arrays:
            found = _with_arrays(json.loads(str(arrays[ABOUT][()])), arrays)
    except (BadZipFile, KeyError, ValueError, EOFError) as error:
        refuse("path", str(path), f"it is not whole, or none that multirod wrote ({type(error).__name__}: {error})")
    if not isinstance(found, dict):
        refuse("path", str(path), "it is none that multirod wrote")
    return found


def _with_arrays(value: object, arrays: Mapping[str, NDArray[Any]]) -> object:
    if isinstance(value, dict):
        if value.keys() == {"array"}:
            return arrays[value["array"]]
        return {name: _with_arrays(item, arrays) for name, item in value.items()}
    if isinstance(value, list):
        return [_with_arrays(item, arrays) for item in value]
    return value
