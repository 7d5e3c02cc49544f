"""Sweeps in this process: equal to a batch, resumed, refused; what is kept, and how it reads."""

import json
import pickle
import re
from concurrent.futures import Executor, Future
from concurrent.futures.process import BrokenProcessPool
from pathlib import Path
from threading import Lock, Timer

import numpy as np
import programs
import pyarrow.parquet as pq
import pytest
import sweep_scene

import multirod as mr
from multirod.studies.sweeps.chunk import FURTHER, OF_EVENTS, RESULTS
from multirod.studies.sweeps.digest import digest
from multirod.studies.sweeps.dispatch import ATTEMPTS
from multirod.studies.sweeps.folder import FORMAT, Folder


def assert_as_solved(study, solution):
    """Every array of a study is that of one batch, bitwise."""
    assert study.done.all()
    for name in study.names:
        if name in OF_EVENTS:
            continue  # below
        expected = getattr(solution if name in RESULTS + FURTHER else solution.inputs, name)
        # what does not vary along an axis of the rods is repeated on disk
        np.testing.assert_array_equal(study[name], np.broadcast_to(expected, study[name].shape), err_msg=name)


@pytest.fixture
def scene():
    return sweep_scene.scene(12)  # axes (3, 4)


# ---- what is kept ----


@pytest.mark.parametrize("chunk", [1, 5, 12, 1000])
def test_a_study_is_its_batch(scene, tmp_path, chunk):
    study = mr.sweep(*scene, out=tmp_path, chunk=chunk, quantities=FURTHER)
    assert study.names == ("rotation", "tip_force", *RESULTS, *FURTHER)
    assert study.batch_shape == (3, 4)
    assert study.chunk_count == len(list((tmp_path / "chunks").iterdir()))
    assert_as_solved(study, mr.solve(*scene))


def test_one_instance_without_axes(tmp_path):
    robot = sweep_scene.wire()
    inputs = robot.inputs(tip_force=(1, 0, 0))
    study = mr.sweep(robot, inputs, out=tmp_path)
    assert study["tip_position"].shape == (3,)
    assert study["status"].shape == ()
    assert_as_solved(study, mr.solve(robot, inputs))


def test_a_chunk_without_loads_is_solved_as_part_of_its_batch(tmp_path):
    robot = sweep_scene.wire()
    force = np.zeros((4, 3))
    force[2:] = (0.1, 0.05, 0)
    inputs = robot.inputs(rotation=np.linspace(0, 1, 4), follower_force=force)
    batch = mr.solve(robot, inputs)
    # alone, the first two would not have the base force among their unknowns
    assert mr.solve(robot, inputs[:2]).unknown_count < batch.unknown_count
    assert_as_solved(mr.sweep(robot, inputs, out=tmp_path, chunk=2), batch)


def test_legs_without_distributed_loads_in_a_chunk_are_solved_as_part_of_their_batch(make_pose):
    rod = mr.Rod(length=0.3, bending_stiffness=0.1, torsional_stiffness=0.08, linear_density=0.02)
    base = np.stack([make_pose(position=(0.05 * np.cos(a), 0.05 * np.sin(a), 0)) for a in (0, 2, 4)])
    robot = mr.ParallelRods(legs=[rod] * 3, base=base, platform=base)
    inputs = robot.inputs(gravity=[(0, 0, 0), (0, 0, -9.81)])
    whole = robot.problem(inputs, integrator=mr.RK45())
    part = robot.problem(inputs.take((2,), np.array([0])), integrator=mr.RK45())
    assert part.groups[0].backbones.features == whole.groups[0].backbones.features


def test_what_buckles_on_its_way_is_counted(tmp_path):
    """A column beyond, at and below its critical load, pi^2/4 EI/L^2, which is so much of the load that acts."""
    robot = mr.SingleRod(mr.Rod(length=0.5, bending_stiffness=(0.04, 0.02), torsional_stiffness=0.015))
    loads = np.array([[0.5, 1.3], [4.0, -2.0]])
    force = np.stack([0 * loads, 0 * loads, -loads * np.pi**2 / 4 * 0.02 / 0.5**2], axis=-1)
    solver = mr.Shooting(integrator=mr.RK4(50))
    quantities = ["event_count", "event_load_factor"]
    study = mr.sweep(robot, robot.inputs(tip_force=force), out=tmp_path, solver=solver, chunk=3, quantities=quantities)
    np.testing.assert_array_equal(study["event_count"], loads > 1)
    factors = np.where(loads > 1, 1 / loads, np.nan)
    np.testing.assert_allclose(study["event_load_factor"], factors, rtol=1e-5)  # of RK4(50): 1e-6
    np.testing.assert_array_equal(study["status"] == mr.Status.BIFURCATED, loads > 1)


def test_failed_instances_are_kept_as_such(tmp_path):
    column = mr.SingleRod(mr.Rod(length=0.4, bending_stiffness=0.2, torsional_stiffness=0.06))
    inputs = column.inputs(tip_force=[(0.3, 0, 0.5), (0, 0, -1e3), (0, 0.4, -0.2)])
    solver = mr.Shooting(integrator=mr.RK4(40), at_fold="stop")
    study = mr.sweep(column, inputs, out=tmp_path, chunk=2, solver=solver)
    assert study.counts() == {mr.Status.CONVERGED: 2, mr.Status.BRANCH_END: 1}
    assert np.isnan(study["tip_position"][1]).all()
    assert_as_solved(study, mr.solve(column, inputs, solver=solver))


def test_rods_that_vary_too(tmp_path):
    rod = mr.Rod(length=np.array([0.3, 0.4, 0.5]), bending_stiffness=0.2, torsional_stiffness=0.06, precurvature=(3, 1, 0))
    robot = mr.SingleRod(rod)
    inputs = robot.inputs(tip_force=np.array([(0.5, 0, 0), (0, 0.5, 0)])[:, None])
    assert_as_solved(mr.sweep(robot, inputs, out=tmp_path, chunk=4), mr.solve(robot, inputs))


def test_the_files_are_one_table_that_says_what_it_holds(scene, tmp_path):
    study = mr.sweep(*scene, out=tmp_path, chunk=5, quantities=["stability", "gamma"])
    table = pq.read_table(tmp_path / "chunks")
    assert table.column("instance").to_pylist() == list(range(12))
    places = [table.column(f"axis_{k}").to_numpy() for k in range(2)]
    for k, component in enumerate("012"):
        np.testing.assert_array_equal(table.column(f"tip_position_{component}").to_numpy(), study["tip_position"][*places, k])
        np.testing.assert_array_equal(table.column(f"tip_force_{component}").to_numpy(), scene[1].tip_force[*places, k])
    np.testing.assert_array_equal(table.column("gamma_2_1").to_numpy(), study["gamma"][*places, 2, 1])
    assert set(table.column("status").to_pylist()) == {"CONVERGED"}
    assert set(table.column("stability").to_pylist()) == {"STABLE"}
    assert (study["stability"] == mr.Stability.STABLE).all()


def test_documented_study_runs(wire, tmp_path, monkeypatch):
    page = (Path(__file__).parent.parent / "docs" / "sweep.md").read_text()
    code = page.split("```python\n")[1].split("```")[0]
    monkeypatch.chdir(tmp_path)
    scope = {"np": np, "mr": mr, "wire": wire}
    exec(code, scope)
    assert scope["study"]["tip_position"].shape == (50, 40, 3)
    assert scope["study"].counts() == {mr.Status.CONVERGED: 2000}
    for name in (*RESULTS, *FURTHER):
        assert f"`{name}`" in page


# ---- stopped and resumed ----


class Stop(Exception):
    pass


def stop_at(count):
    def report(done):
        if done >= count:
            raise Stop

    return report


def test_a_stopped_study_says_what_is_done_and_goes_on(scene, tmp_path):
    log = tmp_path / "log"
    options = {"out": tmp_path / "study", "chunk": 5, "solver": sweep_scene.Logged(log=str(log)), "quantities": ["index"]}
    with pytest.raises(Stop):
        mr.sweep(*scene, **options, progress=stop_at(0))
    study = mr.Study(tmp_path / "study")
    assert study.counts() == {mr.Status.NOT_RUN: 12}
    assert list(study.chunks()) == []
    with pytest.raises(RuntimeError, match="no chunk of .* is done yet"):
        study["status"]
    with pytest.raises(Stop):
        mr.sweep(*scene, **options, progress=stop_at(10))
    assert study.finished_chunks == (0, 1)
    assert not study.finished
    assert study.counts() == {mr.Status.CONVERGED: 10, mr.Status.NOT_RUN: 2}
    assert study.done.sum() == 10
    assert (np.isnan(study["tip_position"]).all(axis=-1) == ~study.done).all()
    assert (study["index"][~study.done] == -1).all()
    assert (study["status"][~study.done] == mr.Status.NOT_RUN).all()
    assert repr(study).endswith("batch (3, 4): 2 NOT_RUN, 10 CONVERGED)")
    reported = []
    mr.sweep(*scene, **options, progress=reported.append)
    assert reported == [10, 12]
    assert study.finished
    mr.sweep(*scene, **options)
    assert [line.split()[0] for line in log.read_text().splitlines()] == ["5", "5", "2"]


def test_an_exception_is_raised_with_the_chunks_number_and_keeps_the_others(scene, tmp_path):
    robot, inputs = scene[0], scene[1][:, 1]  # at 1 rad
    inputs = robot.inputs(tip_force=inputs.tip_force, rotation=[0.0, 0.5, 1.0])
    with pytest.raises(RuntimeError, match="^chunk 1: ArithmeticError: 0.5 rad is too much$") as info:
        mr.sweep(robot, inputs, out=tmp_path, chunk=1, solver=sweep_scene.Refusing(angle=0.5))
    assert isinstance(info.value.__cause__, ArithmeticError)
    assert "_solve" in info.value.__cause__.__notes__[0]  # where it was, also from another process
    assert mr.Study(tmp_path).finished_chunks == (0,)


def test_what_is_being_written_is_not_among_the_chunks(tmp_path):
    folder = Folder(tmp_path)
    folder.begin({"format": FORMAT})
    target = tmp_path / "chunks" / "target"

    def interrupted():
        with folder.written(target) as part:
            part.write_bytes(b"half")
            assert list((tmp_path / "chunks").iterdir()) == []  # what a kill here leaves
            raise Stop

    with pytest.raises(Stop):
        interrupted()
    assert sorted(p.name for p in tmp_path.iterdir()) == ["chunks", "study.json"]
    with folder.written(target) as part:
        part.write_bytes(b"whole")
        assert not target.exists()
    assert target.read_bytes() == b"whole"
    folder.keep(3, b"a chunk")
    assert folder.finished() == [3]


def test_what_a_kill_left_half_written_is_in_nobodys_way(scene, tmp_path):
    (tmp_path / ".part").write_bytes(b"half a manifest")
    with pytest.raises(Stop):
        mr.sweep(*scene, out=tmp_path, chunk=5, progress=stop_at(5))
    (tmp_path / ".part").write_bytes(b"half a chunk, longer than a whole one" * 10_000)
    assert_as_solved(mr.sweep(*scene, out=tmp_path, chunk=5), mr.solve(*scene))
    assert sorted(p.name for p in tmp_path.iterdir()) == [".lock", "chunks", "study.json"]


# ---- refused ----


def changed_robot(scene):
    rod = mr.Rod(length=0.4, bending_stiffness=0.223349, torsional_stiffness=np.nextafter(0.063814, 1), precurvature=(14, 5, 0))
    return {"robot": mr.SingleRod(rod)}


def changed_inputs(scene):
    force = np.array(scene[1].tip_force)
    force[2, 3, 1] += 1e-15
    return {"inputs": scene[0].inputs(tip_force=force, rotation=np.arange(4.0)[:, None])}


@pytest.mark.parametrize(
    ("change", "named"),
    [
        (changed_robot, r"robot \(its numbers\)"),
        (changed_inputs, r"there differ inputs\.tip_force$"),
        (lambda scene: {"inputs": scene[0].inputs(tip_force=scene[1].tip_force)}, r"inputs\.rotation \(only there\)"),
        (lambda scene: {"inputs": scene[1][:2]}, r"batch_shape \(\[3, 4\] there, \[2, 4\] here\)"),
        (lambda scene: {"solver": mr.Shooting(tolerance=1e-8)}, r"solver \(Shooting\(tolerance=None.* there, .*1e-08.* here\)"),
        (lambda scene: {"solver": mr.Shooting(integrator=mr.RK4(20))}, r"integrator \(RK45.* there, RK4\(20\) here\)"),
        (lambda scene: {"chunk": 6}, r"there differ chunk \(5 there, 6 here\)$"),
        (lambda scene: {"quantities": ["energy"]}, r"quantities \(.*'unknowns'\] there, .*'energy'\] here\)"),
        (lambda scene: {"device": "cuda:0"}, r"device \(cpu there, cuda here\)"),
    ],
)
def test_another_study_is_refused_and_named(scene, tmp_path, change, named, monkeypatch):
    monkeypatch.setattr("multirod.studies.sweeps.driver.device_name", lambda field, value: value)  # as where there is a GPU
    begun = {"robot": scene[0], "inputs": scene[1], "out": tmp_path, "chunk": 5}
    with pytest.raises(Stop):
        mr.sweep(**begun, progress=stop_at(5))
    with pytest.raises(ValueError, match="out = .* is not allowed: it holds another study; .*" + named):
        mr.sweep(**{**begun, **change(scene)})
    assert mr.Study(tmp_path).finished_chunks == (0,)
    mr.sweep(**begun)


class Nameless(mr.Shooting):
    """Shown by its address, as what defines no repr is."""

    __repr__ = object.__repr__


def test_equal_solvers_are_equal_however_they_are_shown(scene, tmp_path):
    first, second = Nameless(), Nameless()
    assert repr(first) != repr(second)
    mr.sweep(*scene, out=tmp_path, solver=first)
    mr.sweep(*scene, out=tmp_path, solver=second)


def test_another_version_is_refused(scene, tmp_path, monkeypatch):
    mr.sweep(*scene, out=tmp_path)
    monkeypatch.setattr(mr, "__version__", "99")
    with pytest.raises(ValueError, match=r"there differ multirod \(0.* there, 99 here\)$"):
        mr.sweep(*scene, out=tmp_path)


def test_a_folder_of_something_else_is_refused_and_left_alone(scene, tmp_path):
    (tmp_path / "thesis.tex").write_text("x")
    with pytest.raises(ValueError, match=r"holds no study\.json, but 'thesis\.tex': give a new or empty folder"):
        mr.sweep(*scene, out=tmp_path)
    with pytest.raises(ValueError, match=r"it holds no study\.json"):
        mr.Study(tmp_path)
    (tmp_path / "study.json").write_text('{"format": "of my own"}')
    for use in (lambda: mr.sweep(*scene, out=tmp_path), lambda: mr.Study(tmp_path)):
        with pytest.raises(ValueError, match=r"its study\.json is not of a 'multirod study 2'"):
            use()
    with pytest.raises(ValueError, match="must be a folder"):
        mr.sweep(*scene, out=tmp_path / "thesis.tex")
    chunks = tmp_path / "b" / "chunks"
    chunks.mkdir(parents=True)
    (chunks / "00000000.parquet").write_text("")
    with pytest.raises(ValueError, match=r"holds no study\.json, but 'chunks.00000000\.parquet'"):
        mr.sweep(*scene, out=tmp_path / "b")


def test_two_do_not_write_at_once(scene, tmp_path):
    with Folder(tmp_path).locked(), pytest.raises(RuntimeError, match=r"is being written by another sweep, process \d+"):
        mr.sweep(*scene, out=tmp_path)
    mr.sweep(*scene, out=tmp_path)


@pytest.mark.parametrize(
    ("options", "error", "message"),
    [
        ({"chunk": 0}, ValueError, "chunk = 0 is not allowed: must be an integer >= 1"),
        ({"in_flight": 0}, ValueError, "in_flight = 0"),
        ({"quantities": "energy"}, ValueError, "quantities = 'energy' is not allowed: must be a list of names"),
        ({"quantities": ["enrgy"]}, ValueError, "quantities = 'enrgy' is not allowed: must be one of .*'energy'"),
        ({"solver": "newton"}, TypeError, "solver must be a Solver"),
        ({"executor": 4}, ValueError, "executor = 4 is not allowed: must be a concurrent.futures.Executor, or a function"),
        ({"executor": lambda: 4}, TypeError, "executor must make a concurrent.futures.Executor, not int"),
        ({"progress": 1}, ValueError, "progress = 1 is not allowed"),
        ({"robot": "wire"}, TypeError, "robot must be an assembly"),
        ({"inputs": 3}, TypeError, "inputs must be made by"),
    ],
)
def test_bad_arguments_are_refused(scene, tmp_path, options, error, message):
    with pytest.raises(error, match=message):
        mr.sweep(**{"robot": scene[0], "inputs": scene[1], "out": tmp_path / "study", **options})


def test_no_instances_are_refused(tmp_path):
    robot = sweep_scene.wire()
    with pytest.raises(ValueError, match="there must be an instance"):
        mr.sweep(robot, robot.inputs(tip_force=np.zeros((0, 3))), out=tmp_path / "study")
    assert not (tmp_path / "study").exists()


def test_unknown_arrays_are_refused(scene, tmp_path):
    study = mr.sweep(*scene, out=tmp_path)
    with pytest.raises(TypeError, match="a study takes no 'tip': it takes rotation, tip_force, status"):
        study["tip"]
    with pytest.raises(TypeError, match="'tip'"):
        next(study.chunks("tip"))
    with pytest.raises(TypeError, match=r"not kept 'energy'.*quantities=\['energy'\]"):
        study["energy"]
    with pytest.raises(TypeError, match=r"name of an array.*, not 0"):
        study[0]


# ---- broken files ----


def truncated(path):
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])


def emptied(path):
    path.write_bytes(b"")


def flipped(place):
    """Flip one bit, that far into the file."""

    def change(path):
        content = bytearray(path.read_bytes())
        content[int(place * (len(content) - 1))] ^= 1
        path.write_bytes(content)

    return change


def file_of(folder, chunk):
    (path,) = (folder / "chunks").glob(f"{chunk:08d}-*.parquet")
    return path


DAMAGES = {"truncated": truncated, "emptied": emptied} | {f"bit at {k / 20:g}": flipped(k / 20) for k in range(21)}


@pytest.mark.parametrize("damage", DAMAGES.values(), ids=DAMAGES)
def test_a_broken_chunk_is_named_and_solved_again_and_no_other(scene, tmp_path, damage):
    out, log = tmp_path / "study", tmp_path / "log"
    options = {"out": out, "chunk": 5, "solver": sweep_scene.Logged(log=str(log))}
    study = mr.sweep(*scene, **options)
    before = {path: (path.read_bytes(), path.stat().st_ino) for path in (out / "chunks").iterdir()}
    broken = file_of(out, 1)
    damage(broken)
    for looking in (study, mr.Study(out)):  # one that has read it before, one that has not
        assert looking.finished_chunks == (0, 2)
        assert looking.done.sum() == 7
        assert not looking.finished
        for read in (lambda: looking["tip_position"], looking.counts, lambda: list(looking.chunks())):  # noqa: B023
            with pytest.raises(RuntimeError, match=re.escape(f"{broken} is broken")):
                read()
        assert str(broken) in repr(looking)
    log.unlink()
    with pytest.warns(RuntimeWarning, match=re.escape(str(broken)) + ".*chunk 1 is solved again"):
        mr.sweep(*scene, **options)
    assert [line.split()[0] for line in log.read_text().splitlines()] == ["5"]
    after = {path: (path.read_bytes(), path.stat().st_ino) for path in (out / "chunks").iterdir()}
    assert after.keys() == before.keys()
    assert all(after[path] == before[path] for path in before if path != broken)
    assert after[broken][0] == before[broken][0]
    assert_as_solved(study, mr.solve(*scene))


def test_a_sweep_stopped_while_it_redoes_a_broken_chunk_goes_on(scene, tmp_path):
    mr.sweep(*scene, out=tmp_path, chunk=5)
    for chunk in (0, 1):
        truncated(file_of(tmp_path, chunk))
    with pytest.warns(RuntimeWarning, match="is solved again"), pytest.raises(Stop):
        mr.sweep(*scene, out=tmp_path, chunk=5, progress=stop_at(7))
    assert mr.Study(tmp_path).finished_chunks == (0, 2)
    assert_as_solved(mr.sweep(*scene, out=tmp_path, chunk=5), mr.solve(*scene))


@pytest.mark.parametrize("source", ["another place", "another study"])
def test_a_chunk_from_elsewhere_is_not_taken(scene, tmp_path, source):
    study = mr.sweep(*scene, out=tmp_path / "here", chunk=6)
    one = file_of(tmp_path / "here", 1)
    if source == "another place":
        other = file_of(tmp_path / "here", 0)
        other.replace(taken := one.with_name(other.name.replace("00000000", "00000001")))
    else:
        robot, inputs = scene
        mr.sweep(robot, robot.inputs(tip_force=-inputs.tip_force, rotation=inputs.rotation), out=tmp_path / "there", chunk=6)
        other = file_of(tmp_path / "there", 1)
        taken = one.with_name(other.name)
        taken.write_bytes(other.read_bytes())
    one.unlink()
    assert 1 not in study.finished_chunks
    with pytest.raises(RuntimeError, match=f"{taken.name} is broken"):
        study["status"]


@pytest.mark.parametrize("change", [lambda text: text.replace("3", "4", 1), lambda text: '{"format": "multirod study 2"}'])
def test_a_manifest_that_is_not_what_was_written_is_refused(scene, tmp_path, change):
    mr.sweep(*scene, out=tmp_path)
    path = tmp_path / "study.json"
    path.write_text(change(path.read_text()))
    for use in (lambda: mr.Study(tmp_path), lambda: mr.sweep(*scene, out=tmp_path)):
        with pytest.raises(ValueError, match=r"its study\.json is broken"):
            use()


def test_every_key_of_a_manifest_is_needed(scene, tmp_path):
    manifest = mr.sweep(*scene, out=tmp_path).manifest
    for key in manifest:
        rest = {name: value for name, value in manifest.items() if name != key}
        (tmp_path / "study.json").write_text(json.dumps(rest))
        with pytest.raises(ValueError, match=r"its study\.json is (broken|not of)"):
            mr.Study(tmp_path)


def test_another_layout_of_the_manifest_is_the_same(scene, tmp_path):
    manifest = mr.sweep(*scene, out=tmp_path).manifest
    (tmp_path / "study.json").write_text(json.dumps(dict(reversed(manifest.items()))))
    assert mr.sweep(*scene, out=tmp_path).finished


# ---- executors ----


class Slow(Executor):
    """Solves what is submitted a little later, in a thread; counts; breaks when it is told to."""

    def __init__(self, breaks=lambda task: False):
        self.breaks = breaks
        self.one = Lock()
        self.held = []
        self.most = 0
        self.sizes = []

    def submit(self, fn, /, task):
        future = Future()
        self.sizes.append(len(pickle.dumps((fn, task))))
        self.held.append(future)
        self.most = max(self.most, sum(not f.done() for f in self.held))
        future.task = task
        if self.breaks(task):
            future.set_exception(BrokenProcessPool("a worker died"))
        else:
            Timer(0.02, self.work, [fn, future]).start()
        return future

    def work(self, fn, future):
        with self.one:
            future.set_result(fn(pickle.loads(pickle.dumps(future.task))))


def test_few_tasks_at_a_time_and_each_with_its_own_rows(tmp_path):
    robot, inputs = sweep_scene.scene(400)
    executor = Slow()
    study = mr.sweep(robot, inputs, out=tmp_path, chunk=20, executor=executor, in_flight=3)
    assert len(executor.sizes) == study.chunk_count == 20
    assert executor.most == 3
    rows = len(pickle.dumps(np.array(inputs.tip_force)))
    # 20 of 400 rows, and the robot and solver
    assert max(executor.sizes) < rows / 20 + 4000 < rows
    assert_as_solved(study, mr.solve(robot, inputs))


COLD = """
import sys, numpy as np, multirod as mr
from concurrent.futures import ThreadPoolExecutor
robot = mr.SingleRod(mr.Rod(length=0.4, bending_stiffness=0.2, torsional_stiffness=0.06))
inputs = robot.inputs(tip_force=np.random.default_rng(0).uniform(-1, 1, (40, 3)))
with ThreadPoolExecutor(4) as executor:
    print(mr.sweep(robot, inputs, out=sys.argv[1], chunk=3, executor=executor, quantities=["energy"]).counts())
"""


def test_threads_of_one_process_that_has_loaded_no_kernel(tmp_path):
    """Warp loads kernels for one thread at a time: others that come along with it crash the process."""
    run = programs.run("-c", COLD, str(tmp_path / "study"))
    assert run.returncode == 0, run.stderr
    assert "CONVERGED: 1>: 40" in run.stdout


def test_a_chunk_is_lost_four_times_at_most_and_after_all_others(scene, tmp_path):
    made = []
    fatal = scene[1].tip_force[1, 3]

    def make():
        made.append(Slow(breaks=lambda task: (task.inputs.tip_force == fatal).all() and 3.0 in task.inputs.rotation))
        return made[-1]

    with pytest.raises(RuntimeError, match=rf"^chunk 7 was lost by the executor {ATTEMPTS} times, .*BrokenProcessPool"):
        mr.sweep(*scene, out=tmp_path, chunk=1, executor=make, in_flight=1)
    assert len(made) == ATTEMPTS
    assert mr.Study(tmp_path).finished_chunks == (0, 1, 2, 3, 4, 5, 6, 8, 9, 10, 11)


def test_a_broken_executor_that_cannot_be_made_again_keeps_what_is_done(scene, tmp_path):
    executor = Slow(breaks=lambda task: 2.0 in task.inputs.rotation)
    with pytest.raises(RuntimeError, match="the executor is broken; what is done is kept"):
        mr.sweep(*scene, out=tmp_path, chunk=1, executor=executor, in_flight=1)
    assert mr.Study(tmp_path).finished_chunks == (0, 1)


# ---- what a study is of ----


def test_a_digest_is_of_all_numbers_and_of_nothing_else(wire, make_pose):
    tubes = [wire, mr.Rod(length=0.3, bending_stiffness=1, torsional_stiffness=1, precurvature=lambda s: (s, 0, 0), name="outer")]
    base = np.stack([make_pose(position=(0.1, 0, 0)), make_pose()])
    robot = mr.ParallelRods(legs=[mr.ConcentricTubes(tubes)] * 2, base=base, platform=base)
    known = digest("robot", robot)
    assert digest("robot", pickle.loads(pickle.dumps(robot))) == known
    mr.solve(wire_robot := mr.SingleRod(wire), wire_robot.inputs(tip_force=(0.1, 0, 0)))
    assert digest("robot", wire_robot) == digest("robot", mr.SingleRod(wire))  # solving leaves no trace
    moved = base.copy()
    moved[1, 0, 3] = 1e-300
    others = [
        mr.ParallelRods(legs=[mr.ConcentricTubes(tubes)] * 2, base=moved, platform=base),
        mr.ParallelRods(legs=[mr.ConcentricTubes(tubes)] * 2, base=base, platform=base, joints="spherical"),
        mr.ParallelRods(legs=[mr.ConcentricTubes(tubes), mr.ConcentricTubes(tubes[:1])], base=base, platform=base),
        mr.ParallelRods(legs=[mr.ConcentricTubes(tubes)] * 2, base=base, platform=base, platform_mass=0.1),
        mr.ConcentricTubes(tubes),
        mr.ConcentricTubes(tubes[:1]),
        mr.SingleRod(wire),
    ]
    assert len({known, *(digest("robot", other) for other in others)}) == len(others) + 1


@pytest.mark.parametrize(
    ("one", "other"),
    [
        (1, 1.0),
        (1, True),
        ("1", 1),
        (0.1, np.float64(0.1)),
        ([1, 2], [[1], 2]),
        ({"a": 1}, {"b": 1}),
        ({1, 2}, {1, 3}),
        (np.zeros(2), np.zeros((2, 1))),
        (np.zeros(2), np.zeros(2, dtype=np.float32)),
        (len, repr),
        (mr.Shooting(), mr.Shooting(line_search=False)),
        (mr.RK4(50), mr.RK4(51)),
        (mr.Status.CONVERGED, mr.Status.NOT_RUN),
    ],
)
def test_digests_of_unlike_things_differ(one, other):
    assert digest("it", one) == digest("it", one)
    assert digest("it", one) != digest("it", other)


def test_a_digest_of_what_has_no_name_is_refused():
    with pytest.raises(TypeError, match="solver cannot be told apart from others, .*<lambda>"):
        digest("solver", {"gain": lambda s: s})
    with pytest.raises(TypeError, match="log cannot be told apart"), open(__file__) as file:
        digest("log", file)


def test_functions_of_arclength_are_pickled_as_resolved(wire):
    robot = mr.SingleRod(wire)
    inputs = robot.inputs(distributed_force=lambda s: (s, s * s, 0), rotation=[0.0, 1.0])
    there = pickle.loads(pickle.dumps(inputs))
    here = inputs.profile("distributed_force")
    np.testing.assert_array_equal(there.profile("distributed_force")(0.3), here(0.3))
    np.testing.assert_array_equal(there.rotation, inputs.rotation)
    with pytest.raises(ValueError, match="cannot be resolved anew after pickling"):
        mr.SingleRod(mr.Rod(length=1, bending_stiffness=1, torsional_stiffness=1)).inputs(
            distributed_force=there.profile("distributed_force")
        )


def test_the_manifest_comes_first_and_reads_well(scene, tmp_path):
    with pytest.raises(Stop):
        mr.sweep(*scene, out=tmp_path, progress=stop_at(0))
    manifest = json.loads((tmp_path / "study.json").read_text())
    assert manifest["multirod"] == mr.__version__
    assert manifest["robot"]["is"] == repr(scene[0])
    assert manifest["solver"]["is"] == repr(mr.Shooting())
    assert set(manifest["inputs"]) == {"rotation", "tip_force"}
