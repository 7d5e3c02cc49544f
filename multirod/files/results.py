"""Solutions and histories as tables, complete: what is read back answers all that was answered before, by the same bits."""

from collections.abc import Mapping
from dataclasses import asdict, fields
from itertools import pairwise
from math import prod
from typing import Any

import numpy as np
from numpy.typing import NDArray

from multirod.assembly import Assembly
from multirod.batch import thread_count
from multirod.files.describing import described
from multirod.files.kinds import INTEGRATORS, ROBOTS, Part
from multirod.files.making import made, profile
from multirod.inputs import Inputs
from multirod.models.assemblies.network import Network
from multirod.results.events import joined_events, separate_events
from multirod.results.history import History
from multirod.results.scene import Scene
from multirod.results.solution import Solution
from multirod.segments import Breakpoints
from multirod.solver import Outcome
from multirod.studies.terms.simplify import Dropped
from multirod.tasks.controlling.command import Command
from multirod.tasks.limits import LimitRows
from multirod.tasks.reaching.reached import Aim, Ends, Reached, ShapeHolds
from multirod.tasks.rows import Pose
from multirod.validation import refuse

ROBOT = Part(ROBOTS, many=False, named=True)
INTEGRATOR = Part(INTEGRATORS, many=False, named=True)


def table_of_inputs(inputs: Inputs, where: str, *, functions: bool) -> dict[str, Any]:
    """Values by the names of inputs, axes along which nothing varies as one.

    Raises:
        ValueError: If one is a function of arclength and ``functions`` are not allowed.
    """
    result: dict[str, Any] = {}
    for name in inputs.given:
        resolved = inputs.profile(name)
        if resolved is None:
            value = getattr(inputs, name)
            result[name] = value[tuple(slice(1) if step == 0 else slice(None) for step in value.strides[:-1])]
        elif functions:
            result[name] = {"kind": "Profile", "ends": resolved.ends, "coefficients": resolved.coefficients}
        else:
            refuse(
                f"{where}.{name}",
                "a function of arclength",
                "text holds only numbers: save it as .npz, which keeps the polynomials that it was resolved into",
            )
    return result


def inputs_from(table: Mapping[str, Any], robot: Assembly, where: str) -> Inputs:
    """Inputs of a robot from their values.

    Raises:
        ValueError: If there is an input that the robot does not take, or a value that it does not take.
    """
    by_name = isinstance(robot, Network)  # which takes mappings, and no function of arclength
    values = {
        name: profile(value, f"{where}{name}") if isinstance(value, dict) and not by_name else value
        for name, value in table.items()
    }
    try:
        return robot.inputs(**values)
    except (TypeError, ValueError) as error:
        raise ValueError(f"{where}{error}") from error


def table_of_result(solution: Solution) -> dict[str, Any]:
    """All that a solution is made of.

    Raises:
        ValueError: If the robot or the integrator is of a class of another package.
    """
    scene, inputs = solution._scene, solution._whole
    names = [name for name in scene.fields if name != "inputs"]
    result: dict[str, Any] = {
        "robot": described(scene.assembly, "robot", functions=True),
        "inputs": table_of_inputs(inputs, "inputs", functions=True),
        "inputs_batch_shape": list(inputs.batch_shape),
        "batch_shape": list(solution.batch_shape),
        "instances": solution._instances,
        "integrator": described(scene.integrator, "integrator", functions=True),
        "device": scene.device,
        "dropped": [asdict(term) for term in scene.dropped],
        "records": {name: solution._records[:, scene.fields[name]] for name in names},
        "outcome": {**solution._outcome.arrays, "breakpoints": _joined(solution._outcome.breakpoints)},
    }
    if solution._outcome.events:
        result["outcome"]["events"] = joined_events(solution._outcome.events)
    if isinstance(solution, History):
        result |= {"time": solution.time, "step_time": solution.step_time, "description": solution.description}
    if isinstance(solution, Reached):
        result["reached"] = _table_of_reached(solution)
    if isinstance(solution, Command):
        result["command"] = _table_of_command(solution)
    return result


def result_from(table: Mapping[str, Any], where: str) -> Solution:
    """The solution of a table: a ``History`` if it has times, ``Reached`` if it has a target, a ``Command`` of a controller.

    Raises:
        ValueError: If it is of another version, or does not hold together.
    """
    robot: Assembly = made(table["robot"], ROBOT, f"{where}robot")
    inputs = inputs_from(table["inputs"], robot, where).broadcast_to(tuple(table["inputs_batch_shape"]))
    fields, start = {}, 0
    for name, values in table["records"].items():
        fields[name] = slice(start, start + values.shape[1])
        start += values.shape[1]
    records = np.concatenate(list(table["records"].values()), axis=1)
    found = dict(table["outcome"])
    events = separate_events(found.pop("events")) if "events" in found else {}
    outcome = Outcome(**{**found, "breakpoints": _separate(found["breakpoints"])}, events=events)
    scene = Scene(
        robot,
        tuple(table["batch_shape"]),
        made(table["integrator"], INTEGRATOR, f"{where}integrator"),
        _device(table["device"]),
        fields,
        threads=thread_count(None),
        dropped=tuple(Dropped(**term) for term in table["dropped"]),
    )
    if not len(records) == prod(scene.batch_shape) == len(outcome.status):
        raise ValueError(
            f"{where}{len(records)} records and {len(outcome.status)} statuses do not make a batch {scene.batch_shape}"
        )
    if "reached" in table:
        return Reached(scene, records, outcome, *_reached_from(table["reached"]), inputs, table["instances"])
    if "command" in table:
        return _with_told(Command(scene, records, outcome, inputs, table["instances"]), table["command"])
    if "time" not in table:
        return Solution(scene, records, outcome, inputs, table["instances"])
    times = {name: table[name] for name in ("time", "step_time", "description")}
    return History(scene, records, outcome, inputs, **times)


def _table_of_reached(result: Reached[Any]) -> dict[str, Any]:
    """What a reach says beside its solution is made of."""
    aim, ends = vars(result._aim), vars(result._ends)
    target, held = result.target, ends["by_shape"]
    return {
        **aim,
        "target": {name: getattr(target, name) for name in target.given},
        "limits": table_of_limits(aim["limits"]),
        "errors": ends["errors"],
        "by_shape": None if held is None else vars(held),
    }


def _reached_from(table: Mapping[str, Any]) -> tuple[Aim, Ends]:
    """The reverse."""
    own: dict[str, Any] = {name: tuple(value) if isinstance(value, list) else value for name, value in table.items()}
    target = Pose(**own["target"])
    for name, value in own["target"].items():
        setattr(target, name, value)  # to the bit, where directions were made as long as one again
    held = own["by_shape"]
    own |= {"target": target, "limits": limits_from(own["limits"])}
    ends = Ends(own.pop("errors"), None if held is None else ShapeHolds(**held))
    del own["by_shape"]
    return Aim(**own), ends


def _table_of_command(command: Command[Any]) -> dict[str, Any]:
    """What a controller says beside a sample's solution."""
    own = {name: getattr(command, name) for name in ("missing", "_free", "_told", "_limits", "_aims")}
    return {name.lstrip("_"): value for name, value in own.items()} | {"rows": table_of_limits(command._rows)}


def _with_told(command: Command[Any], table: Mapping[str, Any]) -> Command[Any]:
    """The command with what its controller said."""
    vars(command).update(
        missing=table["missing"],
        _free=tuple(table["free"]),
        _told=table["told"],
        _limits=tuple(table["limits"]),
        _aims=table["aims"],
        _rows=limits_from(table["rows"]),
    )
    return command


def table_of_limits(rows: LimitRows) -> dict[str, Any]:
    """Limits of what is freed."""
    return {field.name: getattr(rows, field.name) for field in fields(LimitRows)}


def limits_from(table: Mapping[str, Any]) -> LimitRows:
    """The reverse."""
    return LimitRows(**{**table, "names": tuple(table["names"])})


def _device(name: str) -> str:
    """The device that it was computed on, or the CPU where there is none such."""
    import warp as wp

    from multirod.kernels.compiling import start_warp

    start_warp()
    return name if name in [device.alias for device in wp.get_devices()] else "cpu"


def _joined(points: Mapping[int, Breakpoints]) -> dict[str, NDArray[Any]] | None:
    """Breakpoints of all instances, one after another."""
    if not points:
        return None
    own = list(points.values())
    return {
        "instances": np.array(list(points)),
        "segments": np.array([len(p.steps) for p in own]),
        "arclength": np.concatenate([p.arclength for p in own]),
        "states": np.concatenate([p.states for p in own]),
        "steps": np.concatenate([p.steps for p in own]),
        "unknowns": np.stack([p.unknowns for p in own]),
        "gap": np.array([p.gap for p in own]),
        "neutral": np.array([p.neutral for p in own]),
    }


def _separate(joined: Mapping[str, NDArray[Any]] | None) -> dict[int, Breakpoints]:
    if joined is None:
        return {}
    ends, neutral = np.cumsum([0, *joined["segments"]]).tolist(), joined.get("neutral", 0 * joined["segments"])
    return {
        instance: Breakpoints(
            joined["arclength"][first + k : last + k + 1],
            joined["states"][first:last],
            joined["unknowns"][k],
            joined["steps"][first:last],
            float(joined["gap"][k]),
            int(neutral[k]),
        )
        for k, (instance, (first, last)) in enumerate(zip(joined["instances"].tolist(), pairwise(ends), strict=True))
    }
