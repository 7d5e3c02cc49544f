"""The three folders install as one package, completely, and from one copy."""

import tomllib
from pathlib import Path

import programs
import pytest

import multirod

ROOT = Path(__file__).parent.parent


def test_every_folder_of_modules_is_packaged():
    configuration = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["setuptools"]
    folders = set()
    for top in ("multirod", "models", "solvers"):
        for file in (ROOT / top).rglob("*.py"):
            folders.add(file.parent.relative_to(ROOT).as_posix())
    assert folders == set(configuration["package-dir"].values())
    assert set(configuration["packages"]) == set(configuration["package-dir"])


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
