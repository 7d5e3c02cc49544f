"""Fixtures that several test files share."""

import json
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import multirod as mr
from multirod.kernels.compiling import COMPILER

DATA = Path(__file__).parent / "data"
CASE_FIXTURES = {"single_rod_case": "single_rod", "tube_case": "concentric_tubes", "parallel_case": "parallel_continuum_robot"}

# files that take a minute and more: first, lest one process is left with one of them at the end
LONG = {"line_drives", "tube_lines", "tube_friction", "platform_derivatives", "pages", "examples", "concentric_tubes"}
LONG |= {"parallel_rods", "derivatives", "multiple_shooting"}


# functions of tests that `make test` leaves to `make test-all`; tests/machine/costs.py chooses them
LEFT = Path(__file__).parent / "left_to_test_all.txt"


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--quick", action="store_true", help=f"without the tests that {LEFT.name} lists")


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    items.sort(key=lambda item: item.path.stem.removeprefix("test_") not in LONG)
    if config.getoption("quick"):
        left = set(LEFT.read_text(encoding="utf-8").split("\n"))
        kept = {item for item in items if item.nodeid.split("[")[0] not in left}
        config.hook.pytest_deselected(items=[item for item in items if item not in kept])
        items[:] = [item for item in items if item in kept]


def load_cases(model: str) -> list[dict]:
    """Stored reference cases of one model, in order of their names."""
    cases = [json.loads(path.read_text(encoding="utf-8")) for path in sorted(DATA.glob("*.json"))]
    return [case for case in cases if case["model"] == model]


# distinct kernels that `make test` asks for, less those of programs that it starts: to be lowered, never raised without a reason
KERNELS = 76  # three of them run what a GPU runs, three leave out poses of many rods, which none of the others would see
asked_for: set[str] = set()


@pytest.hookimpl(optionalhook=True)
def pytest_testnodedown(node: Any) -> None:
    """Of one of several processes."""
    asked_for.update(getattr(node, "workeroutput", {}).get("kernels", ()))


@pytest.hookimpl(trylast=True)
def pytest_sessionfinish(session: pytest.Session, exitstatus: int) -> None:
    """A run of all that `make test` runs fails where it asks for more kernels than it did: a minute more for each fifty."""
    config = session.config
    if hasattr(config, "workeroutput"):
        config.workeroutput["kernels"] = sorted(COMPILER.kernels)
        return
    asked_for.update(COMPILER.kernels)
    if exitstatus == pytest.ExitCode.OK and config.getoption("quick") and config.args_source is config.ArgsSource.TESTPATHS:
        print(f"\n{len(asked_for)} kernels (at most {KERNELS})")
        if len(asked_for) > KERNELS:
            session.exitstatus = pytest.ExitCode.TESTS_FAILED


def pytest_generate_tests(metafunc: pytest.Metafunc) -> None:
    """A test that takes one of ``CASE_FIXTURES`` runs once for each reference case of that model."""
    for fixture, model in CASE_FIXTURES.items():
        if fixture in metafunc.fixturenames:
            cases = load_cases(model)
            metafunc.parametrize(fixture, cases, ids=[case["id"] for case in cases])


@pytest.fixture
def reference_cases() -> Callable[[str], list[dict]]:
    return load_cases


@pytest.fixture
def written_here(monkeypatch: pytest.MonkeyPatch) -> None:
    """Recorders write on a thread, as where no process can be started, which takes its time."""

    def refused(*_: object) -> None:
        raise OSError("no process is to be started")

    monkeypatch.setattr("multirod.recording.recorder.WritingProcess", refused)


@pytest.fixture
def no_display(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Plots are drawn without a window, and closed."""
    monkeypatch.setenv("MPLBACKEND", "Agg")
    pyplot = pytest.importorskip("matplotlib.pyplot")
    yield
    pyplot.close("all")


@pytest.fixture
def wire() -> mr.Rod:
    """The wire of the paper's single-rod example."""
    return mr.Rod(length=0.4, bending_stiffness=0.223349, torsional_stiffness=0.063814, precurvature=(14, 5, 0))


@pytest.fixture
def robot(wire: mr.Rod) -> mr.SingleRod:
    """It alone."""
    return mr.SingleRod(wire)


def rodrigues(vector: np.ndarray) -> np.ndarray:
    """Rotation matrix of a rotation vector."""
    angle = np.linalg.norm(vector)
    if angle == 0:
        return np.eye(3)
    x, y, z = np.asarray(vector) / angle
    K = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + np.sin(angle) * K + (1 - np.cos(angle)) * K @ K


@pytest.fixture
def make_pose() -> Callable[..., np.ndarray]:
    """Pose (4, 4) from a rotation vector (or a rotation matrix) and a position."""

    def make(rotation: object = (0, 0, 0), position: object = (0, 0, 0)) -> np.ndarray:
        result = np.eye(4)
        rotation = np.asarray(rotation, dtype=float)
        result[:3, :3] = rotation if rotation.shape == (3, 3) else rodrigues(rotation)
        result[:3, 3] = position
        return result

    return make


@pytest.fixture
def difference() -> Callable[..., np.ndarray]:
    """Derivative of ``f(t)`` at 0 by central differences at h, h/2, h/4, extrapolated twice: error O(h^6)."""

    def derivative(f: Callable[[float], np.ndarray], h: float) -> np.ndarray:
        a, b, c = ((np.asarray(f(t)) - np.asarray(f(-t))) / (2 * t) for t in (h, h / 2, h / 4))
        ab, bc = (4 * b - a) / 3, (4 * c - b) / 3
        return (16 * bc - ab) / 15

    return derivative
