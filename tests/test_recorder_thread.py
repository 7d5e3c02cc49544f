"""The thread of a recorder, where it writes itself: what it does not do to the loop, what is said when it fails or is late."""

import gc
import re
import socket
import subprocess
import sys
import threading
import weakref
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rerun.chunk import RrdReader

import multirod as mr
from multirod.recording import background, recorder, target, viewer

PATIENCE = 400.0  # [s]: a guard against a test that hangs, not a measure
SOLVER = mr.Shooting(integrator=mr.RK4(20))
pytestmark = pytest.mark.usefixtures("written_here")


@pytest.fixture(scope="module")
def solution() -> mr.Solution:
    rod = mr.Rod(length=0.4, bending_stiffness=0.2233, torsional_stiffness=0.0638, precurvature=(3, 1, 0))
    return mr.solve(mr.SingleRod(rod), solver=SOLVER)


def steps_of(path: Path) -> list[int]:
    chunks = [c for c in RrdReader(str(path)).stream().collect().stream() if str(c.entity_path) == "/error/boundary"]
    return sorted(int(k) for c in chunks if not c.is_static for k in c.to_record_batch().column("step").to_numpy())


class Gate:
    """Lets writing go on when it is opened, and knows the thread that wrote."""

    def __init__(self, monkeypatch: Any) -> None:
        self.open, self.reached, self.threads = threading.Event(), threading.Event(), set[int]()
        write = recorder._Recording.write

        def guarded(recording: Any, samples: Any) -> None:
            self.threads.add(threading.get_ident())
            self.reached.set()
            assert self.open.wait(PATIENCE)
            write(recording, samples)

        monkeypatch.setattr(recorder._Recording, "write", guarded)


@pytest.mark.filterwarnings("ignore::rerun.error_utils.RerunWarning")  # the reader says that the file has no footer yet
def test_log_returns_while_another_thread_writes(solution: mr.Solution, tmp_path: Path, monkeypatch: Any) -> None:
    gate = Gate(monkeypatch)
    with mr.Recorder(tmp_path / "run.rrd", flush_every=2) as recorder:
        for k in range(7):
            recorder.log(0.1 * k, solution)  # this ends although nothing can be written
        assert gate.reached.wait(PATIENCE)
        gate.open.set()
        recorder.flush()
        assert max(steps_of(tmp_path / "run.rrd")) == 6
    assert threading.get_ident() not in gate.threads
    assert steps_of(tmp_path / "run.rrd") == list(range(7))


def test_what_is_left_out_is_counted_and_said(solution: mr.Solution, tmp_path: Path, monkeypatch: Any) -> None:
    gate = Gate(monkeypatch)
    monkeypatch.setattr(background, "WAITING", 1)  # one sample waits at most, beside what is being written
    one = mr.Recorder(tmp_path / "run.rrd")
    one.log(0.0, solution)
    assert gate.reached.wait(PATIENCE)
    one.log(0.1, solution)
    with pytest.warns(RuntimeWarning, match=r"does not keep up: samples are left out, the first at 0\.2 s"):
        one.log(0.2, solution)
    one.log(0.3, solution)  # said once, or this would raise
    assert one.left_out == 2
    gate.open.set()
    with pytest.warns(RuntimeWarning, match="2 of 4 samples were left out"):
        one.close()
    assert steps_of(tmp_path / "run.rrd") == [0, 1]


def test_a_program_that_must_lose_nothing_waits(solution: mr.Solution, tmp_path: Path, monkeypatch: Any) -> None:
    monkeypatch.setattr(background, "WAITING", 1)
    with mr.Recorder(tmp_path / "run.rrd", when_full="wait", nodes=5) as one:
        for k in range(12):
            one.log(0.1 * k, solution)
    assert one.left_out == 0
    assert steps_of(tmp_path / "run.rrd") == list(range(12))
    with pytest.raises(ValueError, match=r"Recorder\.when_full = 'drop' is not allowed"):
        mr.Recorder(tmp_path / "run.rrd", when_full="drop")


@pytest.mark.parametrize("call", ["log", "flush", "close"])
def test_an_error_of_the_thread_comes_out_at_the_next_call(
    call: str, solution: mr.Solution, tmp_path: Path, monkeypatch: Any
) -> None:
    def fails(*_: Any, **__: Any) -> None:
        raise OSError("the disk is full")

    monkeypatch.setattr(target.Writer, "write", fails)
    one = mr.Recorder(tmp_path / "run.rrd")
    one.log(0.0, solution)
    one._thread._thread.join(PATIENCE)
    calls = {"log": lambda: one.log(0.1, solution), "flush": one.flush, "close": one.close}
    with pytest.raises(OSError, match="the disk is full") as caught:
        calls[call]()
    assert caught.value.__notes__ == ["where samples 0 to 0 were written"]
    if call != "close":
        with pytest.raises(RuntimeError, match="stopped after an error"):
            one.log(0.2, solution)
    one.close()  # what was raised is not raised again


def test_a_recorder_that_is_forgotten_finishes_its_file(solution: mr.Solution, tmp_path: Path) -> None:
    one = mr.Recorder(tmp_path / "run.rrd")
    one.log(0.0, solution)
    one.log(0.1, solution)
    gone = weakref.ref(one)
    del one
    gc.collect()
    assert gone() is None
    assert steps_of(tmp_path / "run.rrd") == [0, 1]


FORGETFUL = """
import sys
import multirod as mr
robot = mr.SingleRod(mr.Rod(length=0.4, bending_stiffness=0.2233, torsional_stiffness=0.0638, precurvature=(3, 1, 0)))
recorder = mr.Recorder(sys.argv[1], **({"address": sys.argv[2]} if sys.argv[2:] else {}))
solution = mr.solve(robot, solver=mr.Shooting(integrator=mr.RK4(20)))
for k in range(30):
    recorder.log(0.1 * k, solution)
"""


@pytest.fixture
def nobody() -> str:
    """An address where nothing listens."""
    with socket.socket() as found:
        found.bind(("127.0.0.1", 0))
        return f"rerun+http://127.0.0.1:{found.getsockname()[1]}/proxy"


def test_the_end_of_a_process_writes_what_waits_and_says_that_no_viewer_was_there(nobody: str, tmp_path: Path) -> None:
    command = [sys.executable, "-c", FORGETFUL, str(tmp_path / "run.rrd"), nobody]
    ended = subprocess.run(command, capture_output=True, text=True, timeout=PATIENCE, check=True)
    assert steps_of(tmp_path / "run.rrd") == list(range(30))
    assert f"no viewer listens at {nobody}" in ended.stderr


def test_closing_does_not_wait_for_a_viewer_that_is_not_there(solution: mr.Solution, nobody: str) -> None:
    one = mr.Recorder(address=nobody, close_timeout=PATIENCE)  # would be waited for, were there someone
    one.log(0.0, solution)
    with pytest.warns(RuntimeWarning, match=f"no viewer listens at {re.escape(nobody)}.*start one with `rerun`"):
        one.close()


def test_whether_a_viewer_listens(nobody: str) -> None:
    with socket.socket() as found:
        found.bind(("127.0.0.1", 0))
        found.listen()
        assert viewer.listens(f"rerun+http://127.0.0.1:{found.getsockname()[1]}/proxy")
    assert not viewer.listens(nobody)
    assert viewer.listens("rerun://somewhere/proxy")  # no port: it is not tried


def test_samples_of_all_times_are_kept_in_order(solution: mr.Solution, tmp_path: Path) -> None:
    """More than are written at once, and a flush in between."""
    with mr.Recorder(tmp_path / "run.rrd", flush_every=3, nodes=3) as one:
        for k in range(250):
            one.log(0.01 * k, solution, step_time=1e-3)
            if k == 120:
                one.flush()
    assert steps_of(tmp_path / "run.rrd") == list(range(250))
    assert np.isfinite(solution.tip_position).all()  # as before
