"""The three folders install as one package, completely, and from one copy."""

import subprocess
import sys
import tomllib
from pathlib import Path

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
    run = subprocess.run([sys.executable, "-c", f"import {folder}"], cwd=ROOT, capture_output=True, text=True)
    assert run.returncode != 0
    assert f"import 'multirod.{folder}', not '{folder}'" in run.stderr


def test_importing_does_not_load_the_viewer_or_plotting():
    code = "import sys, multirod; print([m for m in ('rerun', 'rich', 'matplotlib') if m in sys.modules])"
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert run.stdout.strip() == "[]"


def test_every_public_name_exists_and_is_documented():
    for name in multirod.__all__:
        assert getattr(multirod, name).__doc__, name


def test_version_is_the_packages():
    assert multirod.__version__ == tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["version"]
