"""The process that writes for a recorder: what it writes, what outlives the program, and what is said when it ends."""

import os
import pickle
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import programs
import pytest
from rerun.chunk import RrdReader

import multirod as mr
from multirod.recording.background import Sample
from multirod.recording.passing import Packer, Unpacker

SOLVER = mr.Shooting(integrator=mr.RK4(20))
ROD = mr.Rod(length=0.4, bending_stiffness=0.2233, torsional_stiffness=0.0638, precurvature=(3, 1, 0))


def rows_of(path: Path, *entities: str) -> dict[tuple[str, str, int], Any]:
    """Values by entity, component and step."""
    found = {}
    for chunk in RrdReader(str(path)).stream().collect().stream():
        if str(chunk.entity_path) in entities and not chunk.is_static:
            batch = chunk.to_record_batch()
            for name in batch.schema.names:
                if ":" in name:
                    for step, value in zip(batch.column("step").to_pylist(), batch.column(name).to_pylist(), strict=True):
                        found[str(chunk.entity_path), name, step] = value
    return found


def samples(kind: str) -> list[tuple[mr.Solution, mr.Solution | None]]:
    """Solutions and references, as a loop may come by them."""
    robot = mr.SingleRod(ROD)
    if kind == "tracked":
        tracker = mr.Tracker(robot, solver=SOLVER, inputs=robot.inputs(rotation=0.0))
        return [(tracker.step(rotation=0.1 * k), None) for k in range(5)]
    if kind == "a new load":  # the scene is another from there on
        tracker = mr.Tracker(robot, solver=SOLVER, inputs=robot.inputs(rotation=0.0))
        return [(tracker.step(**({"tip_force": (0.1 * k, 0, 0)} if k > 2 else {"rotation": 0.1 * k})), None) for k in range(5)]
    if kind == "a batch":
        tracker = mr.Tracker(robot, solver=SOLVER, inputs=robot.inputs(rotation=np.linspace(0, 1, 6).reshape(2, 3)))
        return [(tracker.step(rotation=0.1 * k + np.linspace(0, 1, 6).reshape(2, 3)), None) for k in range(5)]
    if kind == "solved, with references of another robot":
        other = mr.SingleRod(mr.Rod(length=0.4, bending_stiffness=0.2233, torsional_stiffness=0.0638))
        both = [[mr.solve(r, r.inputs(rotation=0.1 * k), solver=SOLVER) for r in (robot, other)] for k in range(5)]
        return [(one, two) for one, two in both]
    history = mr.simulate(robot, robot.inputs(rotation=0.1 * np.arange(5)), time=np.arange(5.0), solver=SOLVER, progress=False)
    assert kind == "instances of a batch"
    batch = mr.solve(robot, history.inputs, solver=SOLVER)
    return [(batch[k], None) for k in range(5)]


KINDS = ["tracked", "a new load", "a batch", "solved, with references of another robot", "instances of a batch"]


@pytest.mark.parametrize("kind", KINDS)
def test_samples_arrive_as_they_were(kind: str) -> None:
    packer, unpacker = Packer(instances=4), Unpacker()
    logged = samples(kind)
    total = int(np.prod(logged[0][0].batch_shape))
    count = min(4, total)
    packed = []
    for k, pair in enumerate(logged):
        packed.append(packer.pack(Sample(k, 0.1 * k, pair[0], 0.01, pair[1], total)))
    assert len(packed[-1]) < len(packed[0])  # what is common is said once
    found: list[Sample] = [*unpacker.samples(packed[0]), *unpacker.samples(b"".join(packed[1:]))]
    assert [(one.step, one.time, one.step_time, one.total) for one in found] == [(k, 0.1 * k, 0.01, total) for k in range(5)]
    for one, pair in zip(found, logged, strict=True):
        assert one.solution.assembly is found[0].solution.assembly
        for got, given in zip((one.solution, one.reference), pair, strict=True):
            assert (got is None) == (given is None)
            if given is None:
                continue
            for name in ("tip_position", "unknowns", "residual", "status", "iterations"):
                value = np.asarray(getattr(given, name))
                flat = value.reshape(-1, *value.shape[len(given.batch_shape) :])[:count]
                np.testing.assert_array_equal(np.reshape(getattr(got, name), flat.shape), flat)
            assert got.inputs.given == given.inputs.given
            if "tip_force" in given.inputs.given:
                np.testing.assert_array_equal(got.inputs.tip_force, given.inputs.tip_force)
            rotation = np.broadcast_to(given.inputs.rotation, (*given.batch_shape, 1)).reshape(-1, 1)[:count]
            np.testing.assert_array_equal(np.reshape(got.inputs.rotation, rotation.shape), rotation)


class Loop:
    """A recorder whose process writes already."""

    def __init__(self, path: Path, solution: mr.Solution) -> None:
        self.recorder = mr.Recorder(path, flush_every=3, nodes=5)
        self.solution, self.count = solution, 0
        self.log()
        self.recorder.flush()  # waits for the process
        process = self.recorder._recording._process
        assert process is not None
        assert process.begun
        self.process = process._process

    def log(self) -> None:
        self.recorder.log(0.1 * self.count, self.solution, step_time=1e-3)
        self.count += 1


@pytest.fixture(scope="module")
def solution() -> mr.Solution:
    return mr.solve(mr.SingleRod(ROD), solver=SOLVER)


def test_a_process_writes_what_a_thread_writes(
    solution: mr.Solution, tmp_path: Path, request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch
) -> None:
    loop = Loop(tmp_path / "process.rrd", solution)
    for _ in range(10):
        loop.log()
    loop.recorder.close()
    assert loop.process.returncode is not None  # it is gone
    request.getfixturevalue("written_here")
    with mr.Recorder(tmp_path / "thread.rrd", flush_every=3, nodes=5) as other:
        for k in range(11):
            other.log(0.1 * k, solution, step_time=1e-3)
    entities = ("/error/boundary", "/solver/step_time_ms", "/world/rods/rod_0", "/world/tip", "/status")
    found, expected = (rows_of(tmp_path / f"{name}.rrd", *entities) for name in ("process", "thread"))
    assert {step for _, _, step in expected} == set(range(11))
    assert found == expected


def test_what_goes_wrong_in_the_process_or_ends_it_is_raised_here(solution: mr.Solution, tmp_path: Path) -> None:
    loop = Loop(tmp_path / "run.rrd", solution)
    process = loop.recorder._recording._process
    assert process is not None
    with pytest.raises(pickle.UnpicklingError):
        process._ask(b"no samples")
    loop.log()
    loop.recorder.flush()  # it goes on
    loop.process.kill()
    loop.process.wait()
    loop.log()
    with pytest.raises(RuntimeError, match="the process that writes the recording has ended, with status"):
        loop.recorder.flush()
    with pytest.raises(RuntimeError, match="stopped after an error"):
        loop.log()
    loop.recorder.close()  # nobody waits for it


def test_a_robot_that_no_other_process_knows_is_recorded_all_the_same(tmp_path: Path) -> None:
    class Own(mr.SingleRod):
        """Of this function: it cannot be pickled."""

    robot = Own(ROD)
    tracker = mr.Tracker(robot, solver=SOLVER)
    with mr.Recorder(tmp_path / "run.rrd", nodes=5) as one:
        for k in range(3):
            one.log(0.1 * k, tracker.step(rotation=0.1 * k))
        one.flush()
        assert one._recording._process is None
    assert {step for _, _, step in rows_of(tmp_path / "run.rrd", "/error/boundary")} == {0, 1, 2}


# no ``if __name__ == "__main__"``; a class of the main file; the program ends by a signal that nothing can catch
SCRIPT = """
import os, signal, sys
import multirod as mr
print("begins", flush=True)
robot = mr.SingleRod(mr.Rod(length=0.4, bending_stiffness=0.2233, torsional_stiffness=0.0638, precurvature=(3, 1, 0)))
class Own(mr.SingleRod): pass
if sys.argv[2] == "own":
    robot = Own(robot.rods[0])
tracker = mr.Tracker(robot, solver=mr.Shooting(integrator=mr.RK4(20)))
recorder = mr.Recorder(sys.argv[1], nodes=5, flush_every=4)
for k in range(30):
    recorder.log(0.1 * k, tracker.step(rotation=0.01 * k))
    if k == 20:
        recorder.flush()
print("rerun" in sys.modules, flush=True)
os.kill(os.getpid(), signal.SIGKILL)
"""


@pytest.mark.skipif(not hasattr(signal, "SIGKILL"), reason="no SIGKILL on this system")
@pytest.mark.parametrize("robot", ["known", "own"])
@pytest.mark.filterwarnings("ignore::rerun.error_utils.RerunWarning")  # the reader says that the file has no footer
def test_a_script_that_is_killed_leaves_all_that_was_flushed(robot: str, tmp_path: Path) -> None:
    script = tmp_path / "loop.py"
    script.write_text(SCRIPT)
    ended = programs.run(str(script), str(tmp_path / "run.rrd"), robot, env={**os.environ, "RUST_LOG": "error"})
    assert ended.returncode == -signal.SIGKILL
    assert ended.stdout.split() == ["begins", str(robot == "own")]  # run once; it writes itself only what nobody else can
    steps = {step for _, _, step in rows_of(tmp_path / "run.rrd", "/error/boundary")}
    assert steps >= set(range(21))
    if robot == "known":  # the process has finished the file, which ``programs.run`` waits for: it has its error stream
        footer = subprocess.run([sys.executable, "-m", "rerun_cli", "rrd", "verify", str(tmp_path / "run.rrd")], check=False)
        assert footer.returncode == 0
