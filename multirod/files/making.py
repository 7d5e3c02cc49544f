"""Objects made of their tables, each by the constructor that its kind names."""

from inspect import Parameter
from typing import Any

import numpy as np

from multirod.files.kinds import BY_NAME, EQUAL, OF_A_KIND, PARTS, Part, constructors, parameters
from multirod.models.assemblies.network import Network
from multirod.models.network.joining.bodies import ground
from multirod.models.network.joining.joints import Joint
from multirod.profile import Profile
from multirod.validation import Described, choice, refuse


def made(table: object, part: Part, where: str) -> Any:  # noqa: ANN401  (of any of ``CLASSES``)
    """The object of a table.

    Args:
        table: As ``described`` makes it, or as someone wrote it.
        part: What it may be.
        where: The file, then the place in it.

    Raises:
        ValueError: If the table has what is unknown, out of range or of a wrong type, or lacks something; the message names file,
            place, value and what is allowed.
    """
    if not isinstance(table, dict):
        refuse(where, table, "must be a table")
    options = constructors(part.kinds)
    kind, given = part.kinds[0], dict(table)
    if kind not in OF_A_KIND:
        kind = choice(at(where, "kind"), given.pop("kind", None if part.named else kind), options)
    make, parts = options[kind], PARTS.get(kind.partition(".")[0], {})
    known = parameters(make)
    for name, value in given.items():
        if name not in known:
            refuse(at(where, name), value, f"there is no such key: {kind} takes {', '.join(known)}")
    for name, default in known.items():
        if default is Parameter.empty and name not in given:
            raise ValueError(f"{at(where, name)} is not there: {kind} needs {name}")
    arguments = {
        name: value if (kind, name) in BY_NAME else _argument(value, parts.get(name), at(where, name))
        for name, value in given.items()
    }
    arguments |= {name: _meant_as_pair(arguments[name]) for name in EQUAL if name in arguments}
    if make is Joint:
        return arguments  # until there are bodies
    try:
        return _network(arguments) if make is Network else make(**arguments)
    except (TypeError, ValueError) as error:
        raise ValueError(f"{where}{'' if where.endswith(': ') else ': '}{error}") from error


def _network(given: dict[str, Any]) -> Network:
    """A network from its rods by name, its bodies, and the arguments of its joints."""
    bodies = {body.name: body for body in given.get("bodies", ())}
    holders = {ground.name: ground, **bodies}
    joints = []
    for k, arguments in enumerate(given["joints"]):
        to = holders[choice(f"joints[{k}].to", arguments["to"], holders)]
        try:
            joints.append(Joint(**{**arguments, "to": to}))
        except (TypeError, ValueError) as error:
            raise ValueError(f"joints[{k}]: {error}") from error
    return Network(**{**given, "bodies": list(given.get("bodies", ())), "joints": joints})


def at(where: str, name: str) -> str:
    """The place of a key in a table that is ``where``: in a file by its name and ``": "``, or further inside."""
    return where + name if where.endswith(": ") else f"{where}.{name}"


def _argument(value: object, part: Part | None, where: str) -> object:
    if part is None:
        return profile(value, where) if isinstance(value, dict) else value
    if not part.many:
        return made(value, part, where)
    if not isinstance(value, list):
        refuse(where, value, f"must be a list of tables, [[{where.rpartition(': ')[2]}]]")
    names = _names(value, where) if part.mapping else []
    if names:
        value = [{name: own for name, own in item.items() if name != "name"} for item in value]
    found = [made(item, part, f"{where}[{k}]") for k, item in enumerate(value)]
    return dict(zip(names, found, strict=True)) if part.mapping else found


def _names(tables: list[Any], where: str) -> list[str]:
    """Of each table its own."""
    names: list[str] = []
    for k, table in enumerate(tables):
        if not isinstance(table, dict):
            refuse(f"{where}[{k}]", table, "must be a table")
        name = table.get("name", "")
        if not isinstance(name, str) or not name or name in names:
            refuse(f"{where}[{k}].name", name, "each needs a name of its own")
        names.append(name)
    return names


def _meant_as_pair(value: object) -> object:
    """Two numbers as a tuple: in a file they are no batch."""
    given = value.tolist() if isinstance(value, np.ndarray) else value
    plain = isinstance(given, list) and len(given) == 2 and not any(isinstance(item, list) for item in given)
    return tuple(given) if isinstance(given, list) and plain else value


def profile(value: object, where: str) -> Profile:
    """A function of arclength from its table."""
    if not (isinstance(value, dict) and value.get("kind") == "Profile" and set(value) == {"kind", "ends", "coefficients"}):
        refuse(where, value, "must be numbers")
    ends, coefficients = (np.array(value[name], dtype=np.float64) for name in ("ends", "coefficients"))
    sound = ends.ndim == 1 and coefficients.ndim == 3 and len(ends) == len(coefficients) > 0
    if not (sound and np.isfinite(ends).all() and np.isfinite(coefficients).all() and (np.diff(ends, prepend=0.0) > 0).all()):
        refuse(where, Described("a function of arclength"), "its polynomials must be finite, on pieces that follow each other")
    return Profile.resolved(ends, coefficients)
