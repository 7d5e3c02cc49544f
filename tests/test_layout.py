"""The three folders install as one package, completely, and from one copy."""

import ast
import importlib
import re
import tomllib
from pathlib import Path

import programs
import pytest

import multirod

ROOT = Path(__file__).parent.parent
LEFT = ROOT / "tests" / "left_to_test_all.txt"


def test_every_folder_of_modules_is_packaged():
    configuration = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["setuptools"]
    folders = set()
    for top in ("multirod", "models", "solvers"):
        for file in (ROOT / top).rglob("*.py"):
            folders.add(file.parent.relative_to(ROOT).as_posix())
    assert folders == set(configuration["package-dir"].values())
    assert set(configuration["packages"]) == set(configuration["package-dir"])


LONGEST = 400  # lines of a file that a stranger reads at one sitting
# longer than that, and the one thing that each is; a file that holds several is to be split, so that this list may only shrink
LONG = {
    "models/backbone/kernels/members/tube_friction.py": "friction of lines in tubes, one law in lanes",
    "models/backbone/kernels/members/tubes.py": "the strain law of tubes with lines, in lanes",
    "models/backbone/problem.py": "the boundary problem of a backbone",
    "models/backbone/stability/condensing/form_kernels.py": "the kernel that condenses the second variation of a backbone",
    "models/network/elements/element_kernels.py": "rods of a network, their kernels",
    "solvers/continuation/continuation_kernels.py": "a step along a branch",
    "solvers/newton/newton_kernels.py": "Newton's iteration",
    "solvers/tracking/observer_kernels.py": "the observer's step",
}


def test_a_file_is_one_thing_of_some_pages_at_most():
    lengths = {
        file.relative_to(ROOT).as_posix(): len(file.read_text().splitlines())
        for top in ("multirod", "models", "solvers")
        for file in (ROOT / top).rglob("*.py")
    }
    too_long = {name: length for name, length in lengths.items() if length > LONGEST and name not in LONG}
    assert too_long == {}
    listed_for_nothing = [name for name in LONG if lengths.get(name, 0) <= LONGEST]
    assert listed_for_nothing == []


@pytest.mark.parametrize("top", ["models", "solvers"])
def test_a_folder_has_a_dozen_files_at_most(top):
    """So that a stranger finds the file of an equation by the names of few."""
    counts = {folder.relative_to(ROOT).as_posix(): len(modules_of(folder)) for folder in folders_of(top)}
    assert {folder: count for folder, count in counts.items() if count > 12} == {}


def test_folders_side_by_side_do_not_need_each_other():
    """Of two folders neither of which is inside the other, one may import the other, as modules are loaded."""
    needs = {}
    for folder in (folder for top in ("models", "solvers") for folder in folders_of(top)):
        found = {place for module in modules_of(folder) for place in imported(module)}
        needs[folder] = {place for place in found if folder not in place.parents and place not in folder.parents}
    assert [(a, b) for a, those in needs.items() for b in those if a != b and a in needs.get(b, ())] == []


def test_pages_are_as_wide_as_the_code():
    """But for rows of tables, equations, images, and what programs print."""
    wide = []
    for page in sorted([*ROOT.glob("*.md"), *(ROOT / "docs").rglob("*.md")]):
        block = None
        for number, line in enumerate(page.read_text(encoding="utf-8").splitlines(), 1):
            if fence := re.match(r"\s*```(\w*)", line):
                block = fence[1] if block is None else None
            elif block in (None, "python") and len(line) > 130 and not line.startswith(("|", "![", "    ")):
                wide.append(f"{page.name}:{number}")
    assert wide == []


def test_no_solvers_inside_is_used_by_the_contract():
    """Out of ``multirod.solvers`` it takes modules that stand on top, and what a folder's ``__init__`` offers."""
    inside = []
    for module in (ROOT / "multirod").rglob("*.py"):
        for statement in ast.walk(ast.parse(module.read_text())):
            if isinstance(statement, ast.ImportFrom) and statement.module.startswith("multirod.solvers."):
                offered = offers(statement.module)
                names = [f"{statement.module}.{alias.name}" for alias in statement.names if alias.name not in offered]
            elif isinstance(statement, ast.Import):
                names = [alias.name for alias in statement.names if alias.name.startswith("multirod.solvers.")]
            else:
                continue
            inside += [f"{module.relative_to(ROOT).as_posix()}: {name}" for name in names]
    assert inside == []


def offers(name):
    """What a module of ``multirod.solvers`` offers: of one on top all public names, of a folder what it lists."""
    module = importlib.import_module(name)
    on_top = Path(module.__file__).parent == ROOT / "solvers"
    return [own for own in vars(module) if not own.startswith("_")] if on_top else getattr(module, "__all__", ())


def folders_of(top):
    return sorted({file.parent for file in (ROOT / top).rglob("*.py")})


def modules_of(folder):
    return [file for file in folder.glob("*.py") if file.name != "__init__.py"]


def imported(module):
    """The folders below ``models`` and ``solvers`` out of which a module imports while it is loaded."""
    for statement in ast.parse(module.read_text()).body:
        if isinstance(statement, ast.ImportFrom):
            parts = statement.module.split(".")
            for path in (ROOT.joinpath(*parts[1:], alias.name) for alias in statement.names):
                if parts[:2] in (["multirod", "models"], ["multirod", "solvers"]):
                    yield path.parent if path.with_suffix(".py").exists() else path.parent.parent


@pytest.mark.parametrize("folder", ["models", "solvers"])
def test_a_folder_imported_by_itself_is_refused(folder):
    run = programs.run("-c", f"import {folder}", cwd=ROOT)
    assert run.returncode != 0
    assert f"import 'multirod.{folder}', not '{folder}'" in run.stderr


def test_importing_does_not_load_the_viewer_or_plotting():
    code = "import sys, multirod; print([m for m in ('rerun', 'rich', 'matplotlib') if m in sys.modules])"
    run = programs.run("-c", code, check=True)
    assert run.stdout.strip() == "[]"


def test_every_public_name_exists_and_is_documented():
    for name in multirod.__all__:
        assert getattr(multirod, name).__doc__, name


def test_version_is_the_packages():
    assert multirod.__version__ == tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["version"]


@pytest.mark.parametrize("cpu", ["x86-64-v2", "x86-64-v3"])
def test_another_machine_is_one_for_the_programs_of_tests_too(cpu, monkeypatch):
    """What ``make test CPU=... CORES=...`` sets, which nothing would miss if it were lost on the way."""
    monkeypatch.setenv("PYTHONPATH", str(ROOT / "tests" / "machine"))
    monkeypatch.setenv("MULTIROD_TEST_CPU", cpu)
    monkeypatch.setenv("MULTIROD_TEST_CORES", "3")
    code = "import warp, multirod.batch as batch; print(warp.config.cpu_compiler_flags); print(batch.thread_count(None))"
    flags, threads = programs.run("-c", code, check=True).stdout.splitlines()[-2:]
    assert f"-target-cpu {cpu} " in flags
    assert "native" not in flags
    assert threads == "3"


def test_importing_takes_next_to_no_time():
    """It took two seconds. Warp and NumPy alone take more than half a second: they are loaded when they are used."""
    code = """
import sys
before = set(sys.modules)
import multirod
print(sorted({"numpy", "scipy", "warp", "rerun", "rich", "matplotlib"} & (set(sys.modules) - before)))
"""
    assert programs.run("-c", code, check=True).stdout.strip() == "[]"


def test_a_solve_loads_no_more_than_it_needs():
    code = """
import sys
import multirod as mr
robot = mr.SingleRod(mr.Rod(length=0.4, bending_stiffness=0.2233, torsional_stiffness=0.0638))
mr.solve(robot, robot.inputs(tip_force=(1, 0, 0)), progress=False)
print([m for m in ("scipy", "rerun", "rich", "matplotlib", "multirod.recording", "multirod.studies.sweeps") if m in sys.modules])
"""
    assert programs.run("-c", code, check=True).stdout.strip() == "[]"


def test_public_names_are_found_however_they_are_asked_for():
    code = """
import multirod.studies.critical_loads, multirod.studies.equilibria  # modules of the same names as functions
import multirod as mr
assert set(mr._HOME) | {"__version__"} >= set(mr.__all__) == set(mr._HOME)
assert set(mr.__all__) <= set(dir(mr))
from multirod import *
from multirod import critical_loads as function
for name in mr.__all__:
    found = getattr(mr, name)
    assert found is globals()[name] and not isinstance(found, type(mr)), name
    assert mr._HOME[name] in (found.__module__, found.__module__.rpartition(".")[0]), name
assert function is mr.critical_loads and mr.recording.Recorder is mr.Recorder
for name in ("no_such_name", "_no_such_name"):
    try:
        getattr(mr, name)
    except AttributeError as error:
        assert str(error) == f"module 'multirod' has no attribute {name!r}"
    else:
        raise AssertionError(name)
"""
    done = programs.run("-c", code)
    assert done.returncode == 0, done.stderr


def test_editors_are_told_where_public_names_are():
    """The imports that are there for type checkers alone are those that are done when a name is used."""
    lines = (ROOT / "multirod" / "__init__.py").read_text().splitlines()
    told = {}
    for line in lines:
        if line.startswith("    from multirod."):
            module, _, names = line.strip().removeprefix("from ").partition(" import ")
            told |= dict.fromkeys(names.split(", "), module)
    assert told == multirod._HOME


# whose kernels no other file shares: each takes more than half a minute to be compiled and run
LEFT_WHOLE = {
    f"tests/test_{name}.py"
    for name in ("multiple_shooting_lines", "network_alone", "network_derivatives", "random_lines", "sizes", "tube_friction")
}


def test_what_is_left_to_the_longer_run_exists_and_leaves_some_of_nearly_each_file():
    left = LEFT.read_text(encoding="utf-8").split()
    assert left == sorted(set(left))
    functions = re.compile(r"^def (test_\w+)", re.MULTILINE)
    files = {f"tests/{file.name}": functions.findall(file.read_text(encoding="utf-8")) for file in LEFT.parent.glob("test_*.py")}
    assert not [name for name in left if name.split("::")[1] not in files.get(name.split("::")[0], [])]
    assert {file for file, names in files.items() if {f"{file}::{name}" for name in names} <= set(left)} == LEFT_WHOLE
