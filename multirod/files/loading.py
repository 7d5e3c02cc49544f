"""What reads robots, inputs and results back."""

import os
from typing import Any, overload

from multirod.assembly import Assembly
from multirod.inputs import Inputs
from multirod.validation import choice, instance, path_of, refuse

ENDINGS = (".npz", ".toml")
WRITTEN = (".csv", ".nc", ".glb", ".obj", ".ply", ".stl", ".rrd")  # and not read
RESULTS = ("Solution", "History", "Estimate", "Calibration")


@overload
def load(path: str | os.PathLike[str], *, robot: Assembly) -> Inputs: ...
@overload
def load(path: str | os.PathLike[str], *, robot: None = None) -> Any: ...  # noqa: ANN401  (only the file says what)
def load(path: str | os.PathLike[str], *, robot: Assembly | None = None) -> Any:
    """Read what ``save`` wrote to ``.npz`` or ``.toml``, or a robot or inputs that someone wrote as TOML (``docs/files.md``).

    Args:
        path: The file.
        robot: Of inputs, which are checked against it; not given for all else.

    Returns:
        A ``Solution`` (of ``reach`` or a ``Controller``, as that is), a ``History``, an ``Estimate``, a ``Calibration``, a robot
        or ``Inputs``, whatever the file holds. Results answer all that they did before (``rod``, ``jacobian``, ``stability``), on
        the device that they were computed on, or the CPU where there is none such.

    Raises:
        FileNotFoundError: If there is no such file.
        ValueError: If it is of another ending or a later version, is broken, or holds what is unknown, out of range or of a wrong
            type; the message names the file, the place in it, the value and what is allowed.
    """
    from multirod.files import archive, text
    from multirod.files.estimates import calibration_from, estimate_from
    from multirod.files.kinds import ROBOTS, Part
    from multirod.files.making import made
    from multirod.files.older import without_idle_axes
    from multirod.files.results import inputs_from, result_from

    file = path_of("path", path)
    ending = file.suffix.lower()
    if ending not in ENDINGS:
        only = f"; {ending} is written for other programs and not read back: save as .npz too" if ending in WRITTEN else ""
        refuse("path", str(file), f"must end in {' or '.join(ENDINGS)}{only}")
    if robot is not None:
        instance("load.robot", robot, Assembly, "the robot of the inputs")
    if not file.exists():
        raise FileNotFoundError(f"there is no file {file}")
    table = text.parsed(file) if ending == ".toml" else archive.read(file)
    where = f"{file.name}: "
    _check_version(table.pop("version", 1), where)
    table.pop("written_by", None)
    if ending == ".npz":  # which nobody writes by hand
        table = without_idle_axes(table)
    options = (*ROBOTS, "Inputs", *(RESULTS if ending == ".npz" else ()))
    kind = choice(f"{where}kind", table.get("kind"), options)
    if kind == "Inputs":
        if robot is None:
            refuse("load.robot", None, f"must be the robot that these inputs are for: mr.load({file.name!r}, robot=robot)")
        return inputs_from({name: value for name, value in table.items() if name != "kind"}, robot, where)
    if robot is not None:
        refuse("load.robot", robot, f"must not be given: {file.name} holds no inputs, but {kind}")
    if kind in ROBOTS:
        return made(table, Part(ROBOTS, many=False, named=True), where)
    try:
        made_from = {"Estimate": estimate_from, "Calibration": calibration_from}.get(kind, result_from)
        return made_from(table, where)
    except (KeyError, IndexError, TypeError, AttributeError) as error:
        refuse("path", str(file), f"it does not hold together ({type(error).__name__}: {error})")


def _check_version(version: object, where: str) -> None:
    from multirod.files.saving import VERSION

    if type(version) is not int or not 1 <= version <= VERSION:
        refuse(f"{where}version", version, f"must be 1 to {VERSION}: what is newer needs a newer multirod")
