"""Tables of objects: the arguments that make them, but for those that are the default."""

import warnings
from collections.abc import Callable
from dataclasses import fields
from inspect import Parameter
from typing import Any, cast

import numpy as np
from numpy.typing import ArrayLike

from multirod.files.kinds import CLASSES, EQUAL, KINDS, NO_IDENTITY, PARTS, READERS, Part, parameters
from multirod.profile import Profile
from multirod.rod import Rod, Section
from multirod.validation import Described, refuse


def described(thing: object, where: str, *, functions: bool) -> dict[str, Any]:
    """The table of an object, called ``where`` in errors; arguments that are the default are left out.

    Args:
        thing: The object.
        where: Its name.
        functions: Whether a function of arclength may be in it, as the polynomials that it was resolved into.

    Raises:
        ValueError: If it is, or has, something that no file holds; the message names it.
    """
    kind = KINDS.get(type(thing))
    if kind is None:
        refuse(
            where,
            thing,
            f"a file holds only what multirod itself makes ({', '.join(CLASSES)}), and no {type(thing).__name__}: that has to be "
            "made by its own code, and results can be saved as .csv, .nc and meshes",
        )
    parts = PARTS.get(kind, {})
    arguments = _arguments(kind, thing, where)
    if isinstance(thing, Rod) and (as_made := _as_made(thing)) is not None:
        kind, arguments = as_made
    result: dict[str, Any] = {"kind": kind}
    for name, (value, default) in arguments.items():
        field = f"{where}.{name}"
        if name in parts:
            part = parts[name]
            single = [value] if not part.many else value.values() if part.mapping else value
            tables = [
                _unnamed(described(item, f"{field}[{k}]" if part.many else field, functions=functions), part)
                for k, item in enumerate(single)
            ]
            if part.mapping:
                tables = [{"name": own} | table for own, table in zip(value, tables, strict=True)]
            if tables:
                result[name] = tables if part.many else tables[0]
        elif name in ("members", "loads") and value:
            refuse(field, list(value), f"a file holds only the lines of multirod itself, and no {name} of other classes")
        else:
            plain = _plain(field, name, value, functions)
            if not _is(plain, default) or NO_IDENTITY.get(kind) == name and value is not None:
                result[name] = plain
    return result


def _unnamed(table: dict[str, Any], part: Part) -> dict[str, Any]:
    """Without the kind, where it goes without saying."""
    if part.named or table["kind"] != part.kinds[0]:
        return table
    return {name: value for name, value in table.items() if name != "kind"}


def _arguments(kind: str, thing: object, where: str) -> dict[str, tuple[Any, Any]]:
    """Values and defaults of what makes an object; of a rod of one section, that section's among its own."""
    readers, own = READERS.get(kind, {}), parameters(CLASSES[kind])
    if isinstance(thing, Rod):
        single = len(thing.sections) == 1
        others = ("members", "lines", "loads", "discs", "outer_diameter", "inner_diameter")
        found: dict[str, tuple[Any, Any]] = {"name": (thing.name, "")}
        if single:
            (section,) = thing.sections
            if type(section) is not Section:
                refuse(f"{where}.sections", section, "a file holds only sections that are multirod's Section")
            defaults = parameters(Section)
            found |= {item.name: (getattr(section, item.name), defaults[item.name]) for item in fields(Section)}
        else:
            found["sections"] = (thing.sections, None)
        return found | {name: (getattr(thing, name), own[name]) for name in others}
    return {name: (readers[name](thing) if name in readers else getattr(thing, name), default) for name, default in own.items()}


def _as_made(rod: Rod) -> tuple[str, dict[str, tuple[Any, Any]]] | None:
    """What makes a rod by its cross-section and material, and its values and defaults, if just that makes the same bits."""
    material, sections = rod._material, rod.sections
    curves = [section.precurvature for section in sections if not isinstance(section.precurvature, Profile)]
    if material is None or len(curves) < len(sections) or rod.length.ndim:
        return None
    make: Callable[..., Rod] = Rod.strip if material.of_strip else Rod.tube
    sizes: dict[str, Any] = material.of_strip or {"outer_diameter": rod.outer_diameter, "inner_diameter": rod.inner_diameter}
    pieces = [[float(section.length), curve.tolist()] for section, curve in zip(sections, curves, strict=True)]
    values: dict[str, Any] = {
        "length": float(rod.length),
        **sizes,
        "young_modulus": material.young,
        "shear_modulus": material.shear,
        "extensible": any(np.isfinite(section.axial_stiffness).any() for section in sections),
        "density": material.density,
        "precurvature": curves[0] if len(sections) == 1 else pieces,
        "discs": rod.discs,
        "name": rod.name,
        "lines": rod.lines,
    }
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            twin = make(**values)
        except (TypeError, ValueError):
            return None
    same = len(twin.sections) == len(sections) and all(
        np.array_equal(getattr(own, item.name), getattr(other, item.name))
        for own, other in zip(sections, twin.sections, strict=True)
        for item in fields(Section)
    )
    if not same or rod.members or rod.loads:
        return None
    known = parameters(make)
    return f"Rod.{make.__name__}", {name: (value, known[name]) for name, value in values.items()}


def _plain(field: str, name: str, value: object, functions: bool) -> object:
    """A value as a file holds it: an array, a number, a string, a list of strings, the table of a function; None is none."""
    if isinstance(value, Profile):
        if not functions:
            refuse(
                field,
                Described("a function of arclength"),
                "text holds only numbers: save it as .npz, which keeps the polynomials that it was resolved into, or give it as "
                "numbers (precurvature by sections, a line by its offset)",
            )
        return {"kind": "Profile", "ends": value.ends, "coefficients": value.coefficients}
    if isinstance(value, np.ndarray):
        if name in EQUAL and value.ndim == 1 and (value == value[0]).all():
            return float(value[0])
        return float(value) if value.ndim == 0 else value
    return value


def _is(value: object, default: object) -> bool:
    """Whether a value is the default; a batch of it is not."""
    if default is Parameter.empty:
        return False
    if default is None:
        return value is None or (isinstance(value, np.ndarray) and np.array_equal(value, np.eye(4)))
    if isinstance(default, (int, float, tuple)) and not isinstance(value, (str, dict)):
        return bool(np.array_equal(cast(ArrayLike, value), default))
    return bool(value == default)
