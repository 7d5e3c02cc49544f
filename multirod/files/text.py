"""Tables as TOML: written with units beside the numbers, read by the standard library."""

import json
import tomllib
from collections.abc import Mapping
from pathlib import Path
from re import ASCII, fullmatch
from typing import Any, cast

import numpy as np

from multirod.validation import Described, refuse


def toml(table: Mapping[str, Any], units: Mapping[str, str], heading: str) -> str:
    """A table as a TOML document: numbers to the last digit, each with its unit as a comment.

    Args:
        table: Of numbers, arrays, strings, tables and lists of these.
        units: By the names of keys.
        heading: Comment at the top.
    """
    lines = [f"# {line}" for line in heading.splitlines()]
    _write(table, units, (), lines)
    return "\n".join(lines) + "\n"


def _write(table: Mapping[str, Any], units: Mapping[str, str], path: tuple[str, ...], lines: list[str]) -> None:
    """Values first: what comes after the name of another table is part of that."""
    tables = {name: value for name, value in table.items() if _holds_tables(value)}
    for name, value in table.items():
        if name not in tables:
            lines += _lines(name, value, units.get(name, ""))
    for name, value in tables.items():
        inner = (*path, name)
        for item in value if isinstance(value, list) else [value]:
            key = ".".join(inner)
            lines += ["", f"[[{key}]]" if isinstance(value, list) else f"[{key}]"]
            _write(item, units, inner, lines)


def _holds_tables(value: object) -> bool:
    return isinstance(value, dict) or (isinstance(value, list) and bool(value) and isinstance(value[0], dict))


def _lines(name: str, value: object, unit: str) -> list[str]:
    first, *others = _value(value).split("\n")
    key = name if fullmatch(r"[\w-]+", name, ASCII) else _value(name)
    return [f"{key} = {first}" + (f"  # {unit}" if unit else ""), *others]


def _value(value: object, indent: str = "") -> str:
    if isinstance(value, np.ndarray):
        value = value.tolist()
    if isinstance(value, str):
        return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
    if isinstance(value, bool):
        return str(value).lower()
    if not isinstance(value, list):
        return repr(value if isinstance(value, int) else float(cast(float, value)))
    inner = indent + "    "
    if not any(isinstance(item, list) for item in value):
        return f"[{', '.join(_value(item) for item in value)}]"
    rows = "".join(f"{inner}{_value(item, inner)},\n" for item in value)
    return f"[\n{rows}{indent}]"


def parsed(path: Path) -> dict[str, Any]:
    """What a TOML file says.

    Raises:
        ValueError: If it is none; the message says where it is not.
    """
    try:
        with path.open("rb") as file:
            return tomllib.load(file)
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        refuse("path", str(path), f"it is no TOML: {Described(error)}")
