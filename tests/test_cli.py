"""The command line: each command end to end, what it refuses, and ``python -m multirod``."""

import csv
import re
import sys
from pathlib import Path

import numpy as np
import programs
import pytest
from rerun.chunk import RrdReader

import multirod as mr
from multirod import RK4, Observer, Shooting
from multirod.cli import main
from multirod.cli.terminal import duration
from multirod.studies import experiment
from multirod.studies.scenes import SCENES, load
from multirod.studies.tradeoffs import Measurement

NAMES = tuple(experiment.solvers(RK4(50)))
SHORT = ["demo", "--time", "0.2", "--rate", "100", "--slow-samples", "5"]


def rows(text: str) -> dict[str, list[str]]:
    """The table's rows by solver."""
    return {line.split()[0]: line.split() for line in text.splitlines() if line.split() and line.split()[0] in NAMES}


def test_demo_compares_every_solver_and_writes_a_recording(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "run.rrd"
    assert main([*SHORT, "--out", str(out)]) == 0
    printed = capsys.readouterr().out
    table = rows(printed)
    assert tuple(table) == NAMES
    for name, row in table.items():
        assert row[1] == ("5" if name in experiment.SLOW else "21")
    assert {"observer": "1.0", "observer-exact": "1.0", "observer-ff": "1.0"}.items() <= {
        name: row[-2] for name, row in table.items()
    }.items()
    assert table["observer"][-1] == "1"  # times are relative to it
    assert re.search(r"ratio to *\n.*\bobserver *\n", printed)
    assert "failed" not in printed
    assert str(out) in printed.replace("\n", "")

    entities = {str(chunk.entity_path) for chunk in RrdReader(str(out)).stream().collect().stream()}
    assert len(entities) > 5
    assert any("error" in entity or "tip" in entity for entity in entities)


def test_solver_selects(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "run.rrd"
    assert main([*SHORT, "--out", str(out), "--solver", "newton", "--solver", "observer-ff", "--steps", "20"]) == 0
    printed = capsys.readouterr().out
    assert tuple(rows(printed)) == ("newton", "observer-ff")
    # the column says what its ratios are to: the first row where the observer was not asked for
    assert re.search(r"ratio to *\n.*\bnewton *\n", printed)
    assert rows(printed)["newton"][-1] == "1"
    assert "RK4 with 20 steps" in printed.replace("\n", " ")
    assert "Recording of observer-ff" in printed.replace("\n", " ")
    assert out.stat().st_size > 1000


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--time", "0"], "argument --time: 0 is not allowed: must be finite and > 0"),
        (["--time", "-1"], "--time"),
        (["--time", "nan"], "argument --time: nan is not allowed: must be finite and > 0"),
        (["--time", "inf"], "argument --time: inf is not allowed: must be finite and > 0"),
        (["--time", "long"], "argument --time: .*'long'"),
        (["--rate", "0"], "argument --rate: 0 is not allowed: must be finite and > 0"),
        (["--length", "-0.4"], "--length"),
        (["--steps", "0"], "argument --steps: 0 is not allowed: must be an integer >= 1"),
        (["--steps", "2.5"], "argument --steps: .*'2.5'"),
        (["--slow-samples", "0"], "argument --slow-samples: 0 is not allowed: must be an integer >= 1"),
        (["--out", "x.txt"], "argument --out: x.txt is not allowed: must end in .rrd"),
        (["--solver", "neuton"], "argument --solver: invalid choice: 'neuton'.*newton"),
        (["--sovler", "newton"], "unrecognized arguments: --sovler"),
    ],
    ids=lambda value: " ".join(value) if isinstance(value, list) else "",
)
def test_bad_options_exit_with_2_and_a_message(options: list[str], message: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as exit_info:
        main(["demo", *options])
    assert exit_info.value.code == 2
    error = capsys.readouterr().err
    assert re.search(message, error.replace("\n", " "))


def test_it_says_its_version(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        main(["--version"])
    assert ended.value.code == 0
    assert capsys.readouterr().out == f"multirod {mr.__version__}\n"


def test_missing_folder_is_refused_before_anything_runs(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "no" / "run.rrd"
    with pytest.raises(SystemExit) as exit_info:
        main([*SHORT, "--out", str(out)])
    assert exit_info.value.code == 2
    assert re.search("argument --out: .* must be a file in a folder that exists", capsys.readouterr().err.replace("\n", " "))
    assert not out.parent.exists()


@pytest.mark.parametrize("arguments", [[], ["dance"]], ids=["none", "unknown"])
def test_a_command_is_required(arguments: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as exit_info:
        main(arguments)
    assert exit_info.value.code == 2
    assert "demo" in capsys.readouterr().err or not arguments


def test_module_is_the_command(tmp_path: Path) -> None:
    done = programs.run("-m", "multirod", "--help", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith("usage: multirod")
    assert "demo" in done.stdout
    assert done.stderr == ""


FEW = {"Newton, RK4(10)": Shooting(integrator=RK4(10)), "observer, RK4(10)": Observer(integrator=RK4(10))}
OWN = """
import numpy as np
import multirod as mr

def scene(count=81):
    wire = mr.Rod(length=0.4, bending_stiffness=0.2233, torsional_stiffness=0.0638, precurvature=(14, 5, 0))
    robot = mr.SingleRod(wire)
    time = np.arange(count) / 200
    force = np.stack([np.sin(time), np.cos(time), np.sin(time)], axis=-1)
    return robot, robot.inputs(rotation=time, translation=0.01 * time, tip_force=force), time

def batch():
    robot, inputs, time = scene()
    return robot, robot.inputs(tip_force=np.ones((81, 2, 3))), time

def two():
    return scene()[:2]

def nothing():
    return None

def wrong():
    robot, inputs, time = scene()
    return robot, {"tip_force": 1}, time

number = 3
"""


@pytest.fixture
def own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder to work in that has a module with scenes; few settings, or a test would take a minute."""
    (tmp_path / "own_scene.py").write_text(OWN)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("sys.path", list(sys.path))
    monkeypatch.delitem(sys.modules, "own_scene", raising=False)
    monkeypatch.setattr("multirod.studies.tradeoffs.measurement.grid", lambda robot, inputs: dict(FEW))
    monkeypatch.setattr("multirod.studies.tradeoffs.measurement.registered", list)
    return tmp_path


def test_tradeoff_of_a_scene_of_ones_own(own: Path, capsys: pytest.CaptureFixture[str]) -> None:
    arguments = [
        "tradeoff",
        "own_scene:scene",
        "--budget",
        "10min",
        "--all",
        "--csv",
        "rows.csv",
        "--out",
        "run.rrd",
        "--error",
        "1e-3",
    ]
    assert main(arguments) == 0
    printed = capsys.readouterr().out
    assert "own_scene:scene: 81 samples at 200 Hz" in printed
    assert all(name in printed for name in FEW)
    assert "agree within" in printed.replace("\n", " ")
    with (own / "rows.csv").open(encoding="utf-8") as file:
        rows = {row["name"]: row for row in csv.DictReader(file)}
    assert rows.keys() == FEW.keys()
    chosen = re.search(r"(.*) stays within 0.001 m\. Run again on all 81 samples:", printed)[1]
    assert float(rows[chosen]["position"]) <= 1e-3
    solver = eval(re.search(r"solver = (.*)", printed)[1], {"mr": mr})
    assert solver == FEW[chosen]
    assert (own / "run.rrd").stat().st_size > 10_000
    assert "rerun run.rrd" in printed


def test_without_a_goal_what_will_do_for_most_is_named(own: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["tradeoff", "own_scene:scene", "--budget", "10min", "--csv", "rows.csv"]) == 0
    printed = capsys.readouterr().out
    longest = load("own_scene:scene").robot.longest
    with (own / "rows.csv").open(encoding="utf-8") as file:
        near = [row for row in csv.DictReader(file) if float(row["position"]) <= 1e-3 * longest]
    fastest = min(near, key=lambda row: float(row["median"]))["name"]
    assert f"{fastest} is the fastest within 0.1 % of the length, {1e-3 * longest:.2g} m; --error or --rate" in printed
    assert eval(re.search(r"solver = (.*)", printed)[1], {"mr": mr}) == FEW[fastest]


def test_a_promise_that_cannot_be_kept_exits_with_1_and_writes_what_there_is(
    own: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["tradeoff", "own_scene:scene", "--budget", "10min", "--rate", "1e7", "--csv", "rows.csv"]) == 1
    printed = " ".join(capsys.readouterr().out.split())
    assert re.search(r"rate = 1e\+07 is not allowed: the fastest setting, .*, takes \d+ µs in 95 of 100 samples", printed)
    assert len((own / "rows.csv").read_text().splitlines()) == 3


def test_ctrl_c_leaves_what_has_been_measured(
    own: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    whole = Measurement._run

    def interrupted(self: Measurement, name: str, *rest: object) -> object:
        if name.startswith("observer"):
            raise KeyboardInterrupt
        return whole(self, name, *rest)

    monkeypatch.setattr(Measurement, "_run", interrupted)
    assert (
        main(["tradeoff", "own_scene:scene", "--budget", "10min", "--csv", "rows.csv", "--out", "run.rrd", "--error", "1"]) == 130
    )
    printed = capsys.readouterr().out
    assert "stopped after 1 of 2 settings" in printed
    assert "Newton, RK4(10)" in printed
    assert len((own / "rows.csv").read_text().splitlines()) == 2
    assert (own / "run.rrd").exists()


@pytest.mark.parametrize(
    ("scene", "message"),
    [
        ("four-tubes", r"scene = 'four-tubes' is not allowed: must be one of paper, three-tubes, six-legs, or module:function"),
        ("no_such:scene", r"there is no module 'no_such' in .* or installed"),
        ("own_scene:absent", r"module 'own_scene' has no function 'absent'"),
        ("own_scene:number", r"module 'own_scene' has no function 'number'"),
        ("own_scene:two", r"two\(\) must return robot, inputs and time, not 2 values"),
        ("own_scene:nothing", r"nothing\(\) must return a robot such as SingleRod\(rod\) first, not NoneType"),
        ("own_scene:wrong", r"wrong\(\) must return inputs made by robot.inputs\(...\) second, not dict"),
        ("own_scene:batch", r"inputs = leading axes \(81, 2\) is not allowed: there must be one, time"),
    ],
)
def test_scenes_that_are_none_exit_with_2_and_say_why(
    own: Path, scene: str, message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["tradeoff", scene]) == 2
    assert re.search(message, " ".join(capsys.readouterr().out.split()))


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--budget", "soon"], "argument --budget: soon is not allowed: must be a duration > 0 such as 90, 60s or 2min"),
        (["--budget", "-3"], "argument --budget: .*-3"),
        (["--budget", "3 years"], "argument --budget: 3 years is not allowed"),
        (["--plot", "front.docx"], r"argument --plot: front.docx is not allowed: must end in .png or .svg"),
        (["--out", "no/run.rrd"], "argument --out: no/run.rrd is not allowed: must be a file in a folder that exists"),
        (["--csv", "rows.txt"], "argument --csv: rows.txt is not allowed: must end in .csv"),
        (["--error", "1e-5", "--rate", "1000"], "argument --rate: not allowed with argument --error"),
        (["--error", "0"], "argument --error: 0 is not allowed"),
    ],
    ids=lambda value: " ".join(value) if isinstance(value, list) else "",
)
def test_bad_options_of_tradeoff(own: Path, options: list[str], message: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as exit_info:
        main(["tradeoff", "paper", *options])
    assert exit_info.value.code == 2
    assert re.search(message, capsys.readouterr().err.replace("\n", " "))


def test_plots_without_matplotlib_are_refused_before_anything_runs(
    own: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("multirod.cli.tradeoff.find_spec", lambda name: None)
    assert main(["tradeoff", "own_scene:scene", "--plot", "front.png"]) == 2
    assert 'pip install "multirod[plot]"' in capsys.readouterr().out


@pytest.mark.parametrize(("text", "seconds"), [("90", 90), ("60s", 60), ("2min", 120), ("1.5 h", 5400), ("500ms", 0.5)])
def test_durations(text: str, seconds: float) -> None:
    assert duration(text) == pytest.approx(seconds)


@pytest.mark.parametrize("name", SCENES)
def test_built_in_scenes_converge(name: str) -> None:
    study = SCENES[name]()
    some = study.inputs.take(study.inputs.batch_shape, np.linspace(0, len(study.time) - 1, 5).astype(int))
    assert (mr.solve(study.robot, some, solver=Shooting(integrator=RK4(50))).status == mr.Status.CONVERGED).all()
