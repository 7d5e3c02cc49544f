"""What is promised of a sweep that is killed or interrupted, by doing it."""

import os
import signal
import subprocess
import sys
import time
from contextlib import AbstractContextManager
from pathlib import Path

import numpy as np
import programs
import pytest
import sweep_scene

import multirod as mr

KILLS = 10
CHUNKS = 150

pytestmark = pytest.mark.skipif(os.name != "posix", reason="needs POSIX signals")


def start(out: Path, log: Path, count: int, chunk: int, *options: str) -> AbstractContextManager[subprocess.Popen]:
    return programs.started(sweep_scene.__file__, str(out), str(log), str(count), str(chunk), *options)


def reports(process: subprocess.Popen):
    """Numbers of instances done, as they are reported."""
    for line in process.stdout:
        if line.strip().isdecimal():
            yield int(line)


def identities(out: Path) -> dict[str, tuple[int, int]]:
    """Which files the chunks are: one that is written again is another."""
    return {path.name: (path.stat().st_ino, path.stat().st_mtime_ns) for path in (out / "chunks").glob("*")}


def test_killed_at_ten_moments_and_resumed_it_is_as_if_it_had_not_been(tmp_path):
    robot, inputs = sweep_scene.scene(CHUNKS * sweep_scene.CHUNK)
    log, out = tmp_path / "log", tmp_path / "study"
    moments = np.random.default_rng(2021).uniform(0, 0.15, KILLS)
    last = 0
    kept = {}
    for k, moment in enumerate(moments):
        with start(out, log, inputs.tip_force[..., 0].size, sweep_scene.CHUNK) as process:
            done = reports(process)
            begun = next(done)
            assert begun == last  # resumes with all that was there, and nothing else
            if k % 3:  # else in the first chunk, while kernels are loaded
                next(done)
            time.sleep(moment)
            process.kill()
        assert process.returncode == -signal.SIGKILL
        study = mr.Study(out)
        assert not study.finished
        files = identities(out)
        assert kept.items() <= files.items()  # no finished chunk was lost or written again
        kept = files
        for instances, arrays in study.chunks():  # each is whole
            assert all(len(values) == len(instances) for values in arrays.values())
        last = int(study.done.sum())
    assert last > KILLS * sweep_scene.CHUNK / 2
    with start(out, log, inputs.tip_force[..., 0].size, sweep_scene.CHUNK) as process:
        assert next(reports(process)) == last
        error = process.communicate(timeout=programs.GUARD)[1]
    assert process.returncode == 0, error
    assert kept.items() <= identities(out).items()
    # an interrupted chunk is solved once more, and no other
    assert CHUNKS <= len(log.read_text().splitlines()) <= CHUNKS + KILLS

    alone = mr.sweep(
        robot,
        inputs,
        out=tmp_path / "alone",
        chunk=sweep_scene.CHUNK,
        solver=sweep_scene.Logged(log=str(log)),
        quantities=sweep_scene.QUANTITIES,
    )
    study = mr.Study(out)
    assert study.finished
    assert study.done.all()
    assert study.counts() == {mr.Status.CONVERGED: study.instance_count}
    for name in alone.names:
        np.testing.assert_array_equal(study[name], alone[name], err_msg=name)
    # their names differ, as the program's solver is of another module: so their checksums have another key
    for one, other in zip(*(sorted((folder / "chunks").iterdir()) for folder in (out, tmp_path / "alone")), strict=True):
        assert one.read_bytes() == other.read_bytes()
    assert sorted(p.name for p in out.iterdir()) == [".lock", "chunks", "study.json"]


@pytest.mark.parametrize("executor", ["here", "pool"])
def test_interrupt_stops_before_much_more_is_solved_and_leaves_nothing_half_written(tmp_path, executor):
    out = tmp_path / "study"
    with start(out, tmp_path / "log", 40_000, 1000, "--executor", executor) as process:
        done = reports(process)
        assert [next(done), next(done)] == [0, 1000]
        process.send_signal(signal.SIGINT)
        printed, error = process.communicate(timeout=programs.GUARD)
    assert process.returncode == 3, error
    assert "stopped ['.lock', 'chunks', 'study.json']" in printed
    study = mr.Study(out)
    for instances, arrays in study.chunks():
        assert np.isfinite(arrays["tip_position"]).all()
        assert len(instances) == 1000
    assert 1 <= len(study.finished_chunks) < 40


@pytest.mark.skipif(sys.platform != "linux", reason="reads the state of processes from /proc")
@pytest.mark.parametrize("midway", [False, True], ids=["solving", "handing over"])
@pytest.mark.parametrize("how", [signal.SIGSTOP, signal.SIGKILL], ids=["stopped", "killed"])
def test_interrupt_ends_the_sweep_whatever_its_workers_do(tmp_path, how, midway):
    """The process ends, though a worker does not answer, or has died with half of a result in the pipe; so does the worker."""
    died = tmp_path / "died"
    options = ["--executor", "pool", "--died", str(died), "--how", str(int(how)), *(["--midway"] if midway else [])]
    with start(tmp_path / "study", tmp_path / "log", 4000, 100, *options) as process:
        assert next(reports(process)) == 0
        while not (died.exists() and (pid := died.read_text()) and not programs.answers(int(pid))):
            assert process.poll() is None
            time.sleep(0.01)
        process.send_signal(signal.SIGINT)
        _, error = process.communicate(timeout=programs.GUARD)
    assert process.returncode == 3, error
    with pytest.raises(ProcessLookupError):
        os.kill(int(pid), 0)
