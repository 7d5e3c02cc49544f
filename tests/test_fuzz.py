"""Bad values for every parameter of every public callable: what comes is a result, or a ValueError or TypeError that names the
parameter."""

import datetime
import inspect
import math
import re
import sys
from collections.abc import Callable, Iterator
from contextlib import suppress
from decimal import Decimal
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from meant import meant

import multirod as mr

pytestmark = pytest.mark.usefixtures("written_here")

HUGE = 10**400
NAN, INF = math.nan, math.inf


class Thing:
    """An object of no use."""


class Contrary:
    """One whose conversions raise what they like."""

    def __float__(self) -> float:
        raise RuntimeError("no number")

    def __array__(self, *arguments: Any, **options: Any) -> Any:
        raise RuntimeError("no array")

    def __len__(self) -> int:
        raise RuntimeError("no length")

    def __repr__(self) -> str:
        return "Contrary()"


def masked(*shape: int) -> Any:
    values = np.ma.masked_array(np.full(shape, 0.1), mask=np.zeros(shape, dtype=bool))
    values.mask.flat[0] = True
    return values


NUMBERS = [
    0,
    -0.0,
    1,
    -1,
    0.5,
    -2.5,
    NAN,
    INF,
    -INF,
    1e300,
    -1e300,
    1e154,
    5e-324,
    1e-300,
    HUGE,
    -HUGE,
    2**63,
    2**1023,
    True,
    False,
]
NUMBERS += [
    1j,
    complex(NAN, 0),
    Fraction(1, 3),
    Decimal("0.1"),
    Decimal("NaN"),
    Decimal("sNaN"),
    np.float32(0.1),
    np.longdouble(0.1),
]
NUMBERS += [np.int8(3), np.uint64(2**64 - 1), np.bool_(True), np.float64(NAN), np.array(0.1), np.array(NAN)]
TEXTS = ["", "a", "0.1", "nan", "RK4", "inner", b"0.1", bytearray(b"1"), "\0", "é", "x" * 5000]
LISTS = [
    [],
    (),
    [[]],
    [[], []],
    [[[]]],
    [0.1],
    (0.1, 0.2),
    (0.1, 0.2, 0.3),
    [0.1] * 4,
    [0.1] * 7,
    (0, 0, 0),
    (1e300, 0, 0),
    (5e-324, 0, 0),
]
LISTS += [
    [True],
    [True, False, True],
    [True, 0.5, 0.5],
    ["a", "b", "c"],
    ["0.1", "0.2", "0.3"],
    [None],
    [None, None, None],
    [[1, 2], [3]],
]
LISTS += [
    [HUGE],
    [HUGE, 0, 0],
    [0.1, HUGE, 0.1],
    [NAN, 0, 0],
    [INF, 0, 0],
    [1j, 0, 0],
    [Thing()],
    [0, Thing(), 0],
    [(0.1, (0, 0, 0))],
]
LISTS += [
    [(0.2, (1, 0, 0)), (0.2, None)],
    [(NAN, (0, 0, 0))],
    [(HUGE, (0, 0, 0))],
    [(True, (0, 0, 0))],
    [(0.4, Thing())],
    [(0.4, [True] * 3)],
]
LISTS += [[[0.1, 0.2, 0.3]] * 2, [[[0.1, 0.2, 0.3]]], {}, {"a": 1}, {1, 2}, range(3), iter([1, 2, 3]), [[0.1, 0.2], [0.3, [0.4]]]]
ARRAYS = [
    np.zeros(0),
    np.zeros((0, 3)),
    np.zeros((3, 0)),
    np.zeros((2, 3)),
    np.full(3, NAN),
    np.full(3, 1e300),
    np.full(3, 5e-324),
]
ARRAYS += [
    np.zeros(3, dtype=bool),
    np.zeros(3, dtype=complex),
    np.array([1, None, 2], dtype=object),
    np.array([0.1, 0.2, 0.3], dtype=object),
]
ARRAYS += [np.array(["a", "b", "c"]), np.array([b"a"]), np.zeros(3, dtype="datetime64[s]"), np.zeros(3, dtype="timedelta64[s]")]
ARRAYS += [np.zeros(3, dtype=[("x", float), ("y", int)]), np.zeros(3, dtype=np.float16), np.zeros(3, dtype=np.longdouble)]
ARRAYS += [
    masked(),
    masked(3),
    masked(2, 3),
    masked(4, 4),
    masked(6, 4, 4),
    np.eye(3),
    np.eye(4),
    2 * np.eye(4),
    np.full((4, 4), NAN),
]
ARRAYS += [
    np.tile(np.eye(4), (6, 1, 1)),
    np.tile(np.eye(4), (7, 1, 1)),
    np.tile(np.eye(4), (0, 6, 1, 1)),
    np.zeros((6, 4, 4)),
    np.full((4, 4), 1e300),
]
ARRAYS += [np.array([HUGE, 1, 1]), np.array([2**64, 0, 0], dtype=object), np.broadcast_to(0.1, (2, 3)), np.arange(3)]
FUNCTIONS: list[Any] = [
    lambda s: None,
    lambda s: s,
    lambda s: (s, s),
    lambda s: (s, s, NAN),
    lambda s: (HUGE, 0, 0),
    lambda s: "abc",
]
FUNCTIONS += [
    lambda s: masked(3),
    lambda s: (True, False, True),
    lambda s: Thing(),
    lambda: 1,
    lambda s: (1e300, 0, 0),
    lambda s: (1j, 0, 0),
]
FUNCTIONS += [lambda s: (Contrary(), 0, 0), math.sin, print, Thing, type, mr.Rod, mr.RK4, lambda *a, **k: None]
OTHERS: list[Any] = [
    None,
    ...,
    NotImplemented,
    Thing(),
    Contrary(),
    [Contrary()],
    object(),
    datetime.datetime(2026, 1, 1),
    datetime.timedelta(1),
]
OTHERS += [
    np.datetime64("2026-01-01"),
    np.timedelta64(1),
    slice(None),
    memoryview(b"abc"),
    ValueError("x"),
    np.random.default_rng(0),
    math,
]
OTHERS += [
    mr.RK4(4),
    mr.Shooting(),
    mr.Status.CONVERGED,
    mr.Shooting,
    [mr.Shooting()],
    {"a": mr.Shooting()},
    {"a": 1},
    {1: mr.Shooting()},
]
VALUES: list[Any] = [*NUMBERS, *TEXTS, *LISTS, *ARRAYS, *FUNCTIONS, *OTHERS]


def wire(**changes: Any) -> mr.Rod:
    return mr.Rod(**{"length": 0.4, "bending_stiffness": 0.2, "torsional_stiffness": 0.06, **changes})


def circle(count: int, radius: float, aside: float = 0.0) -> np.ndarray:
    poses = np.tile(np.eye(4), (count, 1, 1))
    angle = 2 * np.pi * np.arange(count) / count + aside * (-1) ** np.arange(count)
    poses[:, :2, 3] = radius * np.stack([np.cos(angle), np.sin(angle)], 1)
    return poses


ROBOT = mr.SingleRod(wire())
TUBES = mr.ConcentricTubes([wire(length=0.5), wire(length=0.3)])
LEGS = mr.ParallelRods(legs=[wire()] * 6, base=circle(6, 0.1), platform=circle(6, 0.05, aside=0.4))
HELD = mr.HeldRod(wire(), base_joint="spherical")
INPUTS = ROBOT.inputs(tip_force=(0.1, 0, 0))
MOTION = ROBOT.inputs(tip_force=[(0.1, 0, 0), (0.2, 0, 0)])
PROPERTIES: dict[str, Any] = {"length": 0.4, "bending_stiffness": 0.2, "torsional_stiffness": 0.06}
SHAPE: dict[str, Any] = dict.fromkeys(("precurvature", "shear_stiffness", "axial_stiffness", "linear_density"))


CALLED = ("progress", "executor")  # functions that are the caller's


class Target:
    """A callable, good arguments, and which of them are fuzzed."""

    def __init__(self, label: str, call: Callable[..., Any], good: dict[str, Any], *fuzzed: str) -> None:
        self.label, self.call, self.good = label, call, good
        self.fuzzed = fuzzed or tuple(good)


def options_of(owner: Any) -> dict[str, Any]:
    """Names of the options of a solver or integrator; their defaults are good."""
    return {name: value.default for name, value in inspect.signature(owner).parameters.items()}


def constructors() -> Iterator[Target]:
    yield Target("Rod", mr.Rod, PROPERTIES, *PROPERTIES, *SHAPE, "sections", "outer_diameter", "inner_diameter", "name")
    yield Target("Section", mr.Section, PROPERTIES, *PROPERTIES, *SHAPE)
    tube = {"length": 0.4, "outer_diameter": 3e-3, "inner_diameter": 1e-3, "young_modulus": 7e10, "shear_modulus": 2.7e10}
    yield Target("Rod.tube", mr.Rod.tube, tube, *tube, "precurvature", "density", "name")
    strip = {"length": 0.4, "width": 5e-3, "thickness": 1e-3, "young_modulus": 7e10, "shear_modulus": 2.7e10}
    yield Target("Rod.strip", mr.Rod.strip, strip, *strip, "precurvature", "density", "name")
    yield Target("SingleRod", mr.SingleRod, {"rod": wire()}, "rod", "base")
    yield Target("ConcentricTubes", mr.ConcentricTubes, {"tubes": [wire()]}, "tubes", "base")
    parallel = {"legs": [wire()] * 6, "base": circle(6, 0.1), "platform": circle(6, 0.05)}
    further = ("joints", "joint_axes", "platform_mass", "platform_centre")
    yield Target("ParallelRods", mr.ParallelRods, {**parallel, "joints": "revolute"}, *parallel, *further)
    yield Target("ParallelRods.inverse", LEGS.inverse, {}, "limits")
    yield Target("InverseParallelRods", mr.InverseParallelRods, {"robot": LEGS}, "robot", "limits")
    held = ("base", "end", "joint", "joint_axis", "slide", "base_joint", "base_joint_axis")
    yield Target("HeldRod", mr.HeldRod, {"rod": wire(), "joint": "revolute"}, "rod", *held)
    for owner in (mr.Shooting, mr.Observer, mr.ScipyShooting, mr.EnergyDescent, mr.MultipleShooting, mr.RK4, mr.RK23, mr.RK45):
        names = list(options_of(owner))
        yield Target(owner.__name__, owner, {}, *names)
    table = mr.RK4.tableau
    yield Target("Tableau", mr.Tableau, {"order": 4, "a": table.a, "b": table.b, "c": table.c}, "order", "a", "b", "c", "error")
    for label, robot in (
        ("SingleRod", ROBOT),
        ("ConcentricTubes", TUBES),
        ("ParallelRods", LEGS),
        ("inverse", LEGS.inverse()),
        ("HeldRod", HELD),
    ):
        needed = {spec.name: (0, 0, 0.3) for spec in robot.input_specs if spec.required}
        yield Target(f"{label}.inputs", robot.inputs, needed, *(spec.name for spec in robot.input_specs))


def fuzzed(target: Target, name: str) -> list[str]:
    """What was wrong with the outcomes for one parameter."""
    wrong = []
    for value in VALUES:
        if name in CALLED and callable(value):
            continue  # what it raises is its own
        try:
            with meant():
                target.call(**{**target.good, name: value})
        except (ValueError, TypeError) as error:
            # the whole name, not a part of another word
            if not re.search(rf"(?<![a-z_]){re.escape(name)}(?![a-z])", str(error), re.IGNORECASE):
                wrong.append(f"{name} = {value!r:.80}: {type(error).__name__} that does not name it: {error!s:.150}")
        except Exception as error:  # noqa: BLE001
            wrong.append(f"{name} = {value!r:.80}: {type(error).__name__}: {error!s:.150}")
    return wrong


def cases(targets: Iterator[Target]) -> list[Any]:
    return [pytest.param(target, name, id=f"{target.label}-{name}") for target in targets for name in target.fuzzed]


@pytest.mark.parametrize("target", list(constructors()), ids=lambda target: target.label)
def test_what_bad_values_are_put_into_is_plausible(target: Target) -> None:
    """So that nothing is silenced but bad values: a warning is an error here."""
    target.call(**target.good)


@pytest.mark.parametrize(("target", "name"), cases(constructors()))
def test_constructors_and_inputs(target: Target, name: str) -> None:
    wrong = fuzzed(target, name)
    assert not wrong, "\n".join(wrong)


# ---- functions ----


class Reached(Exception):
    """All arguments were taken: what comes now takes long."""


def reached(*arguments: Any, **options: Any) -> Any:
    raise Reached


SOLVER = mr.Shooting(integrator=mr.RK4(10))
SOLUTION = mr.solve(ROBOT, INPUTS, solver=SOLVER)
BATCH = mr.solve(ROBOT, ROBOT.inputs(tip_force=[(0.1, 0, 0), (0.2, 0, 0)]), solver=SOLVER)
HISTORY = mr.simulate(ROBOT, MOTION, time=[0.0, 0.1], solver=SOLVER)


def quietly(call: Callable[..., Any]) -> Callable[..., Any]:
    """A call that may stop where what takes long would begin."""

    def quiet(**arguments: Any) -> None:
        with suppress(Reached):
            call(**arguments)

    return quiet


def recorder(**arguments: Any) -> None:
    mr.Recorder(**arguments).close()


def logged(path: Path) -> Callable[..., Any]:
    def log(**arguments: Any) -> None:
        with mr.Recorder(path / "log.rrd") as one:
            one.log(**arguments)

    return log


def functions(path: Path) -> Iterator[Target]:
    scene = {"robot": ROBOT, "inputs": INPUTS}
    moving = {"robot": ROBOT, "inputs": MOTION, "time": [0.0, 0.1]}
    common = ("solver", "guess", "device", "threads", "simplify", "progress")
    yield Target("solve", mr.solve, {**scene, "solver": SOLVER}, "robot", "inputs", "instances", *common)
    yield Target("simulate", mr.simulate, {**moving, "solver": SOLVER}, *moving, *common)
    tracker = {"robot": ROBOT, "dt": 0.01, "inputs": INPUTS, "solver": SOLVER}
    yield Target("Tracker", mr.Tracker, tracker, *tracker, "guess", "device")
    step = mr.Tracker(**tracker).step
    yield Target("Tracker.step", step, {}, "inputs", "tip_force", "translation", "distributed_force")
    sweep = {**scene, "out": path / "study", "solver": SOLVER}
    more = ("chunk", "quantities", "executor", "in_flight", "progress", "device", "threads")
    yield Target("sweep", quietly(mr.sweep), sweep, *sweep, *more)
    yield Target(
        "tradeoff",
        quietly(mr.tradeoff),
        {**moving, "settle": 0.0},
        *moving,
        "solvers",
        "models",
        "settle",
        "budget",
        "csv",
        "progress",
    )
    yield Target("tune", quietly(mr.tune), {**moving, "settle": 0.0, "error": 1e-3}, "error", "time", "settle", "budget", "csv")
    yield Target("tune", quietly(mr.tune), {**moving, "settle": 0.0, "rate": 100.0}, "rate")
    critical = ("robot", "inputs", "start", "count", "up_to", "max_steps", "solver", "device")
    yield Target("critical_loads", quietly(mr.critical_loads), scene, *critical)
    yield Target("equilibria", quietly(mr.equilibria), scene, "robot", "inputs", "starts", "solver", "device")
    yield Target("explain", quietly(mr.explain), scene, "robot", "inputs", "measure")
    yield Target("Solution.rod", BATCH.rod, {}, "rod", "nodes")
    yield Target("Solution.jacobian", lambda name: BATCH.jacobian("tip_force", name), {}, "name")
    yield Target(
        "History.save", HISTORY.save, {"path": path / "run.rrd"}, "path", "reference", "name", "nodes", "instances", "force_scale"
    )
    options = ("path", "address", "name", "description", "flush_every", "nodes", "instances", "force_scale")
    yield Target("Recorder", recorder, {"path": path / "live.rrd"}, *options)
    sample = {"time": 0.1, "solution": SOLUTION}
    yield Target("Recorder.log", logged(path), sample, *sample, "step_time", "reference")
    yield Target("Study", mr.Study, {"folder": path}, "folder")


PLACES = [(target.label, name) for target in functions(Path("/")) for name in target.fuzzed]


@pytest.fixture
def stubbed(monkeypatch: pytest.MonkeyPatch) -> None:
    """What takes long raises ``Reached`` in its place."""
    monkeypatch.setattr("multirod.studies.sweeps.driver.Folder", reached)
    monkeypatch.setattr("multirod.studies.tradeoffs.measurement.load_kernels", reached)
    monkeypatch.setattr("multirod.studies.tradeoffs.measurement.grid", lambda robot, inputs: {"Newton": SOLVER})
    monkeypatch.setattr("multirod.studies.tradeoffs.measurement.registered", list)
    monkeypatch.setattr("multirod.studies.terms.explanation.Explanation.measure", reached)
    # functions of the same names hide these modules
    monkeypatch.setattr(sys.modules["multirod.studies.critical_loads"], "natural_start", reached)
    monkeypatch.setattr(sys.modules["multirod.studies.equilibria"], "converge", reached)


@pytest.mark.parametrize(("label", "name"), PLACES)
def test_functions(label: str, name: str, tmp_path: Path, stubbed: None, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)  # where legal names of files end
    target = next(target for target in functions(tmp_path) if target.label == label and name in target.fuzzed)
    wrong = fuzzed(target, name)
    assert not wrong, "\n".join(wrong)


EXTREMES = [{name: value} for name in PROPERTIES for value in (1e-50, 1e-25, 1e25, 1e50)]
EXTREMES += [{"precurvature": (value, 0, 0)} for value in (5e-324, 1e25, 1e50)]


@pytest.mark.parametrize("changes", EXTREMES, ids=str)
@pytest.mark.parametrize("force", [0.0, 0.1, 1e50])
@pytest.mark.filterwarnings("ignore::multirod.PlausibilityWarning")
def test_what_is_legal_does_not_crash_later(changes: dict[str, Any], force: float) -> None:
    """There is a result, or a status that says why there is none."""
    robot = mr.SingleRod(wire(**changes))
    solution = mr.solve(
        robot, robot.inputs(tip_force=(force, 0, 0)), solver=mr.Shooting(integrator=mr.RK4(10), max_continuation_steps=20)
    )
    assert bool(np.isfinite(solution.tip_position).all()) is not solution.status.failed
