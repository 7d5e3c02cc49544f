"""The command line: the demonstration end to end, what it refuses, and ``python -m multirod``."""

import re
import subprocess
import sys
from pathlib import Path

import pytest
from rerun.chunk import RrdReader

from multirod import experiment
from multirod.cli import main
from multirod.models.integrators import RK4

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


def test_missing_folder_is_refused_before_anything_runs(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "no" / "run.rrd"
    assert main([*SHORT, "--out", str(out)]) == 2
    printed = capsys.readouterr()
    assert "--out" in printed.out + printed.err
    assert "does not exist" in (printed.out + printed.err).replace("\n", " ")
    assert not out.parent.exists()


@pytest.mark.parametrize("arguments", [[], ["dance"]], ids=["none", "unknown"])
def test_a_command_is_required(arguments: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as exit_info:
        main(arguments)
    assert exit_info.value.code == 2
    assert "demo" in capsys.readouterr().err or not arguments


def test_module_is_the_command(tmp_path: Path) -> None:
    done = subprocess.run([sys.executable, "-m", "multirod", "--help"], cwd=tmp_path, capture_output=True, text=True, timeout=60)
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith("usage: multirod")
    assert "demo" in done.stdout
    assert done.stderr == ""
