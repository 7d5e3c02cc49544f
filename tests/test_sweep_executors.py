"""Sweeps by processes that are killed midway: a pool's, and those of a Dask cluster."""

import os
import runpy
import signal
import time
from pathlib import Path
from threading import Thread

import numpy as np
import programs
import pytest
import sweep_scene

import multirod as mr
from multirod.studies.sweeps import dispatch
from multirod.studies.sweeps.workers import Workers

EXAMPLE = Path(__file__).parent.parent / "examples" / "sweep_on_a_cluster.py"
posix = pytest.mark.skipif(os.name != "posix", reason="kills by a signal")


def assert_same(study, other):
    for name in other.names:
        np.testing.assert_array_equal(study[name], other[name], err_msg=name)


@posix
def test_a_pool_whose_worker_is_killed_is_made_again(tmp_path):
    robot = sweep_scene.wire()
    angle = np.linspace(0, 1, 60)
    # a function of arclength, defined here, travels too
    inputs = robot.inputs(rotation=angle, tip_force=(0.5, 0, 0), distributed_force=lambda s: (0.5 * s, 0, -s * s))
    pools = []

    def make():
        pools.append(sweep_scene.pool())
        return pools[-1]

    options = {"chunk": 5, "solver": sweep_scene.Dying(angle=angle[32], died=str(tmp_path / "died"))}
    study = mr.sweep(robot, inputs, out=tmp_path / "pool", executor=make, **options)
    assert len(pools) == 2
    assert study.finished
    assert_same(study, mr.sweep(robot, inputs, out=tmp_path / "here", **options))
    with pytest.raises(RuntimeError, match="cannot schedule new futures"):
        pools[1].submit(int)  # what the sweep made, it has shut down


@posix
@pytest.mark.parametrize("made", [True, False], ids=["made", "given"])
def test_a_pool_whose_worker_dies_while_it_hands_over_a_result_is_found_out(tmp_path, monkeypatch, made):
    """The pool itself waits for the rest of the result for ever."""
    monkeypatch.setattr(dispatch, "PATIENCE", 1.0)
    robot = sweep_scene.wire()
    angle = np.linspace(0, 1, 60)
    inputs = robot.inputs(rotation=angle, tip_force=(0.5, 0, 0))
    options = {"chunk": 5, "solver": sweep_scene.Dying(angle=angle[32], died=str(tmp_path / "died"), midway=True)}
    pools = []

    def make():
        pools.append(sweep_scene.pool())
        return pools[-1]

    if made:
        study = mr.sweep(robot, inputs, out=tmp_path / "pool", executor=make, **options)
        assert len(pools) == 2
        assert_same(study, mr.sweep(robot, inputs, out=tmp_path / "here", **options))
        return
    try:
        with pytest.raises(RuntimeError, match="the executor is broken; what is done is kept"):
            mr.sweep(robot, inputs, out=tmp_path / "pool", executor=make(), **options)
    finally:
        workers = Workers(pools[0])
        workers.kill()  # whose pool it is, ends it
        pools[0].shutdown()


@posix
def test_a_sweep_ends_though_an_idle_worker_does_not(tmp_path, monkeypatch):
    monkeypatch.setattr(dispatch, "PATIENCE", 1.0)
    robot = sweep_scene.wire()
    pools = []

    def make():
        pools.append(sweep_scene.pool())
        return pools[-1]

    def stop_one(done):
        if done == 20:  # the last chunk is there
            (pid, *_) = pools[0]._processes
            os.kill(pid, signal.SIGSTOP)

    study = mr.sweep(
        robot, robot.inputs(rotation=np.linspace(0, 1, 20)), out=tmp_path / "pool", chunk=5, executor=make, progress=stop_one
    )
    assert study.finished


@posix
def test_a_cluster_whose_worker_is_killed_completes(tmp_path, capsys):
    distributed = pytest.importorskip("distributed", reason="needs the extra dask")
    example = runpy.run_path(str(EXAMPLE))
    options = ["--directions", "20", "--chunk", "10"]
    killed = []

    def kill(pid):
        while len(list((tmp_path / "cluster").glob("chunks/*"))) < 5:
            time.sleep(0.01)
        os.kill(pid, signal.SIGKILL)
        killed.append(len(list((tmp_path / "cluster").glob("chunks/*"))))

    with distributed.LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None) as cluster:
        with distributed.Client(cluster) as client:
            pid = next(iter(client.run(os.getpid).values()))
        killer = Thread(target=kill, args=[pid], daemon=True)
        killer.start()
        study = example["main"](["--out", str(tmp_path / "cluster"), "--scheduler", cluster.scheduler_address, *options])
        killer.join(programs.GUARD)
    assert killed[0] < study.chunk_count == 40  # midway
    assert study.finished
    assert "400 CONVERGED" in capsys.readouterr().out
    robot, inputs = example["scene"](20)
    assert_same(study, mr.sweep(robot, inputs, out=tmp_path / "here", chunk=10))
