"""Results as ``xarray.Dataset``, and as netCDF."""

from enum import IntEnum
from pathlib import Path
from typing import Any

import numpy as np

import multirod
from multirod.assembly import Assembly
from multirod.files.optional import optional
from multirod.files.whole import written
from multirod.models.assemblies.network import Network
from multirod.models.network.joining.checks import joints_by_name
from multirod.recording.figure import drawn_lines, drawn_rods
from multirod.results.history import History
from multirod.results.solution import Solution
from multirod.stability import Stability
from multirod.status import Status
from multirod.validation import FloatArray, positive_int

COMPONENTS = ["x", "y", "z"]
DIRECTORS = ["d1", "d2", "d3"]

# of each instance: name, axes after the batch's, unit, what it is
RESULTS = (
    ("residual", (), "1/m", "what the solver drove to zero, max norm"),
    ("iterations", (), "1", "iterations"),
    ("integrations", (), "1", "initial value problems integrated, per rod"),
    ("unknowns", ("unknown",), "1/m", "unknowns"),
    ("boundary_residual", ("equation",), "1/m", "residual of the boundary conditions"),
    ("gamma", ("equation", "unknown"), "1", "derivative of the residual by the unknowns"),
    ("condition", (), "1", "condition number of gamma"),
    ("smallest_singular_value", (), "1", "smallest singular value of gamma"),
    ("tip_position", ("component",), "m", "position of the end effector, world frame"),
    ("tip_rotation", ("component", "director"), "1", "rotation of the end effector, body to world: its directors in the world"),
)
OF_LINES = (
    ("tension", "N", "tension of each line, negative where it pushes"),
    ("line_length", "m", "length of each line between its start and its end on the rod"),
    ("slack", "1", "1 where a line hangs loose, 0 where it does not"),
)
TURNED, SLID = "turned_joint", "slid_joint"  # axes of numbers of joints
OF_JOINTS = (
    ("joint_angle", TURNED, "rad", "how far each joint of a network is turned from where its pose says"),
    ("joint_slide", SLID, "m", "how far the end of the rod has slid in it"),
)
ALONG = (
    ("arclength", (), "m", "arclength from the base"),
    ("position", ("component",), "m", "position of the centreline, world frame"),
    ("rotation", ("component", "director"), "1", "rotation of the material frame, body to world"),
    ("curvature", ("component",), "1/m", "curvature and twist, body frame"),
    ("moment", ("component",), "N m", "internal moment, body frame"),
    ("force", ("component",), "N", "internal force, body frame"),
)


def write(path: Path, solution: Solution, nodes: int | None = None) -> None:
    """The dataset as netCDF 3, which SciPy writes: whatever else is installed, the file is the same."""
    found = dataset(solution, nodes)
    with written(path) as part:
        found.to_netcdf(part, engine="scipy")


def dataset(solution: Solution, nodes: int | None) -> Any:  # noqa: ANN401  (xarray need not be there)
    """See ``Solution.to_xarray``."""
    if nodes is not None:
        positive_int("to_xarray.nodes", nodes, 2)
    xarray = optional("xarray", "xarray", "datasets")
    axes = _axes(solution)
    ends = _flags(Status, "why each instance ended") | {"failed": " ".join(status.name for status in Status if status.failed)}
    variables: dict[str, Any] = {
        "status": (axes, np.asarray(solution.status, dtype=np.int32), ends),
        "stability": (axes, np.asarray(solution.stability, dtype=np.int32), _flags(Stability, "whether it is stable")),
    }
    for name, own, unit, meaning in RESULTS:
        variables[name] = ((*axes, *own), getattr(solution, name), {"units": unit, "long_name": meaning})
    if isinstance(solution, History):
        measured = {"units": "s", "long_name": "measured time that the sample took"}
        variables["step_time"] = (("time",), solution.step_time, measured)
        if solution._outcome.rates is not None:
            rates = {"units": "1/s", "long_name": "closed-loop rates of the observer"}
            variables["rates"] = (("time", *axes[1:], "mode"), solution.rates, rates)
    variables |= _lines(solution, axes) | _bodies(solution, axes) | _joints(solution, axes) | _inputs(solution, axes)
    if nodes is not None:
        variables["energy"] = (axes, solution.energy, {"units": "J", "long_name": "elastic energy of all rods"})
        if any(rod.outer_diameter is not None for rod in solution.assembly.rods):
            attributes = {"units": "1", "long_name": "largest strain of the outermost fibre of each rod"}
            variables["strain"] = ((*axes, "rod"), solution.strain, attributes)
        variables |= _along(solution, axes, nodes)
    used = {axis for value in variables.values() for axis in value[0]}
    coordinates = {name: value for name, value in _coordinates(solution).items() if name in used}
    return xarray.Dataset(variables, coords=coordinates, attrs=_about(solution))


def _axes(solution: Solution) -> tuple[str, ...]:
    """Names of the leading axes."""
    timed = isinstance(solution, History)
    count = len(solution.batch_shape) - timed
    return (*(["time"] if timed else []), *(["instance"] if count == 1 else [f"instance_{k}" for k in range(count)]))


def _flags(kind: type[IntEnum], meaning: str) -> dict[str, Any]:
    """What values of an enumeration are, as the conventions for climate and forecast data have it."""
    every = list(kind)
    names = " ".join(value.name for value in every)
    return {"long_name": meaning, "flag_values": np.array(every, dtype=np.int32), "flag_meanings": names}


def _lines(solution: Solution, axes: tuple[str, ...]) -> dict[str, Any]:
    if not solution.assembly.lines:
        return {}
    found = {}
    for name, unit, meaning in OF_LINES:
        try:
            value = np.ma.filled(np.ma.asarray(getattr(solution, name), np.float64), np.nan)
            found[name] = ((*axes, "line"), value, {"units": unit, "long_name": meaning})
        except NotImplementedError:  # an assembly that says nothing of its lines
            return {}
    return found


def _inputs(solution: Solution, axes: tuple[str, ...]) -> dict[str, Any]:
    """What was given as numbers, broadcast to all instances."""
    inputs, found = solution.inputs, {}
    for name in inputs.given:
        if name in inputs.profiles:
            continue
        spec, value = inputs.specs[name], getattr(inputs, name)
        counted = f"line_by_{name}" if spec.acts == "lines" else f"number_of_{name}"
        own: tuple[str, ...] = ("rod" if spec.per_rod else "component" if spec.count is None else counted,)
        every = np.broadcast_to(value, (*solution.batch_shape, value.shape[-1]))
        if isinstance(solution.assembly, Network) and spec.name in solution.assembly.coordinate_names:
            own = ("coordinate" if spec.name == "angle" else spec.name,)
        elif isinstance(solution.assembly, Network) and solution.assembly.vectors_on(spec):
            own = ("load_place" if spec.acts == "tip" else "whole_rod", "component")
            every = every.reshape(*solution.batch_shape, every.shape[-1] // 3, 3)
        found[f"input_{name}"] = ((*axes, *own), every, {"units": spec.unit, "long_name": spec.description})
    return found


def _bodies(solution: Solution, axes: tuple[str, ...]) -> dict[str, Any]:
    """Where the bodies of a network are."""
    robot = solution.assembly
    if not isinstance(robot, Network) or not robot.bodies:
        return {}
    names, place = [body.name for body in robot.bodies], len(axes)
    position = np.stack([solution.body_position(name) for name in names], axis=place)
    rotation = np.stack([solution.body_rotation(name) for name in names], axis=place)
    turned = {"units": "1", "long_name": "rotation of the bodies, body to world: their directors in the world"}
    return {
        "body_position": (
            (*axes, "body", "component"),
            position,
            {"units": "m", "long_name": "position of the bodies, world frame"},
        ),
        "body_rotation": ((*axes, "body", "component", "director"), rotation, turned),
    }


def _joints(solution: Solution, axes: tuple[str, ...]) -> dict[str, Any]:
    """Where the joints of a network are that turn or slide."""
    found: dict[str, Any] = {}
    for name, axis, unit, meaning in OF_JOINTS:
        joints = _numbers_of_joints(solution.assembly, axis)
        values = [getattr(solution, name)(joint).reshape(*solution.batch_shape, count) for joint, count in joints.items()]
        if values:
            found[name] = ((*axes, axis), np.concatenate(values, axis=-1), {"units": unit, "long_name": meaning})
    return found


def _numbers_of_joints(robot: Assembly, axis: str) -> dict[str, int]:
    """Joints by name, and how many angles or slides each has."""
    if not isinstance(robot, Network):
        return {}
    joints = joints_by_name(robot.joints).items()
    return {name: count for name, own in joints if (count := own.count - own.angles if axis == SLID else own.angles)}


def _along(solution: Solution, axes: tuple[str, ...], nodes: int) -> dict[str, Any]:
    shapes = [solution.rod(k, nodes=nodes) for k in range(solution.assembly.rod_count)]
    place = len(axes)

    def joined(name: str) -> FloatArray:
        return np.stack([getattr(shape, name) for shape in shapes], axis=place)

    return {
        name: ((*axes, "rod", "node", *own), joined(name), {"units": unit, "long_name": f"{meaning}, along the rods"})
        for name, own, unit, meaning in ALONG
    }


def _coordinates(solution: Solution) -> dict[str, Any]:
    assembly = solution.assembly
    rods = drawn_rods(assembly)
    lines = [line.name for line in drawn_lines(assembly, rods)]
    names = {"component": COMPONENTS, "director": DIRECTORS, "rod": [rod.name for rod in rods], "line": lines}
    if isinstance(assembly, Network):
        names |= {"body": [body.name for body in assembly.bodies], "load_place": list(assembly.load_places)}
        names |= {"whole_rod": list(assembly.graph.whole_names)}
        for axis in (TURNED, SLID):
            counts = _numbers_of_joints(assembly, axis).items()
            names[axis] = [f"{joint} {k}" if n > 1 else joint for joint, n in counts for k in range(n)]
        names |= {"coordinate" if name == "angle" else name: list(own) for name, own in assembly.coordinate_names.items()}
    for spec in solution.inputs.specs.values():
        if spec.count is not None and spec.acts == "lines":
            driven = [line.drive is not None and line.drive[0] == spec.name for _, line in assembly.lines]
            names[f"line_by_{spec.name}"] = [name for name, own in zip(lines, driven, strict=True) if own]
    # as objects: what Zarr makes of strings of one length is not settled
    found: dict[str, Any] = {axis: (axis, np.array(own, dtype=object)) for axis, own in names.items()}
    if isinstance(solution, History):
        found["time"] = ("time", solution.time, {"units": "s", "long_name": "time of the sample"})
    return found


def _about(solution: Solution) -> dict[str, Any]:
    from multirod.files.saving import robot_text

    try:
        robot = robot_text(solution.assembly)
    except ValueError:  # of another package
        robot = repr(solution.assembly)
    found = {"multirod_version": multirod.__version__, "robot": robot, "integrator": str(solution._scene.integrator)}
    if isinstance(solution, History):
        found["description"] = solution.description
    if solution.dropped:
        found["dropped"] = "; ".join(map(str, solution.dropped))
    if solution.inputs.profiles:
        found["inputs_as_functions_of_arclength"] = " ".join(solution.inputs.profiles)
    return found
