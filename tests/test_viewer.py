"""A recorder whose viewer does not answer: nobody waits for it without end, and what is lost is said."""

import socket
import subprocess
import sys
from collections.abc import Iterator
from threading import Event, Thread
from typing import Any

import pytest

import multirod as mr
from multirod.recording.viewer import WAITING, ViewerStream

PATIENCE = 400.0  # [s]: a guard against a test that hangs, not a measure


class Peer:
    """Accepts connections on the loopback and never answers."""

    def __init__(self) -> None:
        self.socket = socket.socket()
        self.socket.bind(("127.0.0.1", 0))
        self.socket.listen()
        self.address = f"rerun+http://127.0.0.1:{self.socket.getsockname()[1]}/proxy"
        self._accepted: list[socket.socket] = []
        Thread(target=self._accept, daemon=True).start()

    def _accept(self) -> None:
        while True:
            try:
                self._accepted.append(self.socket.accept()[0])
            except OSError:  # closed
                return

    def close(self) -> None:
        """Let go of whoever still waits for an answer."""
        self.socket.close()
        for connection in self._accepted:
            connection.close()


@pytest.fixture
def peer() -> Iterator[Peer]:
    result = Peer()
    yield result
    result.close()


LOOP = """
import sys, warnings
import multirod as mr
robot = mr.SingleRod(mr.Rod(length=0.4, bending_stiffness=0.2233, torsional_stiffness=0.0638))
tracker = mr.Tracker(robot, solver=mr.Shooting(integrator=mr.RK4(50)), dt=0.005)
with warnings.catch_warnings(record=True) as said:
    warnings.simplefilter("always")
    with mr.Recorder(sys.argv[2], address=sys.argv[1], nodes=5, close_timeout=2.0) as recorder:
        for k in range(50):
            recorder.log(0.005 * k, tracker.step(tip_force=(0.01 * k, 0, 0)))
print("closed", *(warning.message for warning in said if "viewer" in str(warning.message)), flush=True)
"""


def test_close_and_the_end_of_the_process_do_not_wait_for_a_viewer_without_end(peer: Peer, tmp_path: Any) -> None:
    file = tmp_path / "run.rrd"
    run = subprocess.run(
        [sys.executable, "-c", LOOP, peer.address, file], capture_output=True, text=True, timeout=PATIENCE, check=True
    )
    assert "closed" in run.stdout
    assert f"the viewer at {peer.address} has not taken the whole recording within 2 s" in run.stdout
    assert "lost" in run.stdout
    assert file.stat().st_size > 10_000  # the file has everything


class Stuck:
    """A stream whose viewer takes nothing until it is let go."""

    def __init__(self) -> None:
        self.taking, self.let_go, self.calls = Event(), Event(), []

    def connect_grpc(self, address: str) -> None:
        self.address = address

    def send_columns(self, *arguments: Any) -> None:
        self.taking.set()
        assert self.let_go.wait(PATIENCE)
        self.calls.append(arguments)

    def disconnect(self) -> None:
        self.calls.append("disconnect")


def test_what_a_viewer_does_not_take_is_left_out_and_the_loop_goes_on(peer: Peer) -> None:
    stream = Stuck()
    viewer = ViewerStream(stream, peer.address, PATIENCE)  # one that listens is waited for
    viewer.send_columns(0)
    assert stream.taking.wait(PATIENCE)
    for k in range(1, WAITING):
        viewer.send_columns(k)
    viewer.send_columns(WAITING)  # the first waits no longer: it is being sent
    with pytest.warns(RuntimeWarning, match="does not keep up: samples are left out"):
        viewer.send_columns(WAITING + 1)
    viewer.send_columns(WAITING + 2)  # said once, or this would raise
    stream.let_go.set()
    viewer.disconnect()
    assert [arguments[0] for arguments in stream.calls[:-1]] == list(range(WAITING + 1))
    assert stream.calls[-1] == "disconnect"


@pytest.mark.parametrize("value", [0, -1, float("inf"), "1"])
def test_a_bad_patience_is_refused(value: Any) -> None:
    with pytest.raises(ValueError, match="Recorder.close_timeout = .* is not allowed"):
        mr.Recorder(address="rerun+http://127.0.0.1:1/proxy", close_timeout=value)
