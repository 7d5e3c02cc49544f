"""What writes robots, inputs and results, by the ending of the file."""

import os
from collections.abc import Callable, Mapping
from inspect import signature
from pathlib import Path
from typing import Any, Unpack

import multirod
from multirod.assembly import Assembly
from multirod.files import archive, centrelines, datasets, meshes
from multirod.files.describing import described
from multirod.files.estimates import table_of_calibration, table_of_estimate
from multirod.files.kinds import UNITS
from multirod.files.results import table_of_inputs, table_of_result
from multirod.files.text import toml
from multirod.files.whole import written
from multirod.inputs import Inputs
from multirod.naming import unknown_names
from multirod.results.history import History
from multirod.results.solution import Solution
from multirod.tasks.estimating.calibrate import Calibration
from multirod.tasks.estimating.estimate import Estimate
from multirod.types import RecordingOptions
from multirod.validation import Described, file_path, refuse

VERSION = 1  # of the tables: what is read may be of this one or of those before
PICTURES = (".png", ".pdf", ".svg", ".jpg", ".jpeg")
TABLES = (".mat", ".xlsx", ".xls", ".json", ".txt", ".pkl", ".h5", ".hdf5")
HEADING = """{what}, written by multirod {version}; read it by mr.load({how}).
SI units, angles in rad; rotation matrices are body to world; a pose is 4 x 4."""


def save_result(path: str | os.PathLike[str], solution: Solution, options: Mapping[str, Any]) -> None:
    """See ``Solution.save`` and ``History.save``."""
    kinds: dict[str, Callable[..., None]] = {
        ".npz": _npz,
        ".csv": centrelines.write,
        ".nc": datasets.write,
        **dict.fromkeys(meshes.ENDINGS, meshes.write),
    }
    if isinstance(solution, History):
        kinds[".rrd"] = _recording
    elif str(path).lower().endswith(".rrd"):
        refuse(
            "save.path", str(path), "a recording is of a History, as simulate() gives: or take a Recorder, and log(0.0, solution)"
        )
    if str(path).lower().endswith(PICTURES):
        refuse("save.path", str(path), f"must end in {' or '.join(kinds)}; a picture is solution.plot().figure.savefig(path)")
    if str(path).lower().endswith(TABLES):
        refuse("save.path", str(path), f"must end in {' or '.join(kinds)}: MATLAB reads .nc, spreadsheets .csv")
    file = file_path("save.path", path, *kinds)
    write = kinds[file.suffix.lower()]
    if write is not _recording:
        unknown_names(f"save(path), ending in {file.suffix},", options, list(signature(write).parameters)[2:] or ["no options"])
    write(file, solution, **options)


def save_estimate(path: str | os.PathLike[str], result: Estimate[Any]) -> None:
    """See ``Estimate.save``."""
    _archive(file_path("save.path", path, ".npz"), "Estimate", table_of_estimate(result))


def save_calibration(path: str | os.PathLike[str], result: Calibration[Any]) -> None:
    """See ``Calibration.save``."""
    _archive(file_path("save.path", path, ".npz"), "Calibration", table_of_calibration(result))


def save_robot(path: str | os.PathLike[str], robot: Assembly) -> None:
    """See ``Assembly.save``."""
    file = file_path("save.path", path, ".toml", ".npz")
    _save(file, lambda functions: described(robot, "robot", functions=functions), UNITS, type(robot).__name__, f'"{file.name}"')


def save_inputs(path: str | os.PathLike[str], inputs: Inputs) -> None:
    """See ``Inputs.save``."""
    file = file_path("save.path", path, ".toml", ".npz")
    if file.suffix.lower() == ".toml" and 0 in inputs.batch_shape:
        refuse("inputs", Described(f"leading axes {inputs.batch_shape}"), "text has no arrays without numbers: save them as .npz")
    units = {name: spec.unit for name, spec in inputs.specs.items()}

    def table(functions: bool) -> dict[str, Any]:
        return {"kind": "Inputs", **table_of_inputs(inputs, "inputs", functions=functions)}

    _save(file, table, units, "Inputs of a robot", f'"{file.name}", robot=robot')


def robot_text(robot: Assembly) -> str:
    """A robot as TOML, functions of arclength as the polynomials that they were resolved into.

    Raises:
        ValueError: If it is, or has, something of another package.
    """
    table = {"version": VERSION, **described(robot, "robot", functions=True)}
    return toml(table, UNITS, HEADING.format(what=type(robot).__name__, version=multirod.__version__, how='"robot.toml"'))


def _save(file: Path, table: Callable[[bool], dict[str, Any]], units: Mapping[str, str], what: str, how: str) -> None:
    if file.suffix.lower() == ".npz":
        archive.write(file, {**_version(), **table(True)})
        return
    text = toml({"version": VERSION, **table(False)}, units, HEADING.format(what=what, version=multirod.__version__, how=how))
    with written(file) as part:
        part.write_text(text, encoding="utf-8")


def _version() -> dict[str, Any]:
    return {"written_by": f"multirod {multirod.__version__}", "version": VERSION}


def _npz(path: Path, solution: Solution) -> None:
    _archive(path, "History" if isinstance(solution, History) else "Solution", table_of_result(solution))


def _archive(path: Path, kind: str, table: dict[str, Any]) -> None:
    archive.write(path, {**_version(), "kind": kind, **table})


def _recording(path: Path, history: History, **options: Unpack[RecordingOptions]) -> None:
    from multirod.recording import save

    save(path, history, **options)
