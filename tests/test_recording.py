"""Recordings read back: what is in them, that numbers are exact, and that a killed run leaves a readable one."""

import os
import signal
import time
from collections import defaultdict
from dataclasses import replace
from pathlib import Path

import numpy as np
import programs
import pytest
import rerun as rr
from observer_scenes import three_tubes
from rerun.chunk import RrdReader
from scipy.spatial.transform import Rotation

import multirod as mr
from multirod.recording import Recorder, columns, layout, save
from multirod.recording.background import Sample
from multirod.recording.framing import Extent, Frame
from multirod.recording.loads import DrawnLoad, along_rods
from multirod.recording.passing import Packer, Unpacker
from multirod.recording.profiles import stepped

pytestmark = pytest.mark.usefixtures("written_here")
SOLVER = mr.Shooting(integrator=mr.RK4(20))
SCALARS = (
    "/error/boundary",
    "/error/boundary_log10",
    "/conditioning/condition",
    "/conditioning/condition_log10",
    "/conditioning/smallest_singular_value",
    "/conditioning/smallest_singular_value_log10",
    "/solver/step_time_ms",
    "/solver/step_time_ms_log10",
    "/solver/iterations",
    "/solver/integrations",
)


@pytest.fixture(autouse=True)
def strict():
    rr.set_strict_mode(True)
    yield
    rr.set_strict_mode(False)


def make_robot(**options):
    return mr.SingleRod(
        mr.Rod(length=0.4, bending_stiffness=0.2233, torsional_stiffness=0.0638, precurvature=(3, 1, 0), **options)
    )


def make_history(count=40, solver=SOLVER, robot=None, force=0.2):
    robot = make_robot() if robot is None else robot
    time = 0.02 * np.arange(count)
    tip_force = force * np.stack([np.sin(time), np.cos(time), 0 * time], axis=-1)
    inputs = robot.inputs(rotation=0.3 * time[:, None], translation=0.01 * time[:, None], tip_force=tip_force)
    return mr.simulate(robot, inputs, time=time, solver=solver)


@pytest.fixture(scope="module")
def history():
    return make_history()


@pytest.fixture(scope="module")
def broken():
    """Samples 10 to 14 fail: the force jumps, and one iteration does not follow it."""
    robot = make_robot()
    tip_force = np.zeros((20, 3))
    tip_force[10:15, 1] = 60.0
    solver = mr.Shooting(integrator=mr.RK4(20), max_iterations=3, max_continuation_steps=2)
    result = mr.simulate(robot, robot.inputs(tip_force=tip_force), time=0.02 * np.arange(20), solver=solver)
    failed = np.array([mr.Status(int(value)).failed for value in result.status])
    assert failed[10:15].all()
    assert not failed[:10].any()
    return result


class Recording:
    """Rows of a recording by entity and component."""

    def __init__(self, path):
        self.chunks = defaultdict(list)
        self.paths = set()
        for chunk in RrdReader(str(path)).stream().collect().stream():
            self.paths.add(str(chunk.entity_path))
            self.chunks[str(chunk.entity_path), chunk.is_static].append(chunk)

    def column(self, path, name, static=False):
        rows = []
        for chunk in self.chunks[path, static]:
            batch = chunk.to_record_batch()
            if name in batch.schema.names:
                values = batch.column(name).to_pylist()
                steps = [-1] * len(values) if static else batch.column("step").to_numpy().tolist()
                rows += list(zip(steps, values, strict=True))
        return [value for _, value in sorted(rows, key=lambda row: row[0])]

    def index(self, path, timeline):
        parts = [chunk.to_record_batch().column(timeline) for chunk in self.chunks[path, False]]
        return np.sort(np.concatenate([part.cast("int64").to_numpy() for part in parts]))

    def scalars(self, path):
        return np.array(self.column(path, "Scalars:scalars"))


def arrows_of(recording, name):
    """What arrows are drawn as in the scene, and from where."""
    path = f"/world/loads/{name}"
    scale = recording.column(path, "InstancePoses3D:scales", static=True)[-1][0]
    vectors = [row for row in recording.column(path, "Arrows3D:vectors") if row]
    origins = [row for row in recording.column(path, "Transform3D:translation") if row]
    return np.array(vectors)[:, 0] * scale, np.array(origins)[:, 0]


def assert_logarithms(found, values):
    """Within their rounding: how NumPy rounds them depends on how many it is given at once."""
    np.testing.assert_array_max_ulp(found, np.log10(values), maxulp=4)


def views_of(path):
    """Kinds of the views in the layout that a recording opens with, the last that it holds."""
    reader = RrdReader(str(path))
    layout = list(reader.blueprints())[-1]
    found = set()
    for chunk in reader.stream(store=layout).collect().stream():
        batch = chunk.to_record_batch()
        for name in batch.schema.names:
            if name.endswith("class_identifier"):
                found |= {value for row in batch.column(name).to_pylist() for value in row}
    return found


def test_scalars_equal_the_history(history, tmp_path):
    history.save(tmp_path / "run.rrd")
    recording = Recording(tmp_path / "run.rrd")
    expected = {
        "/error/boundary": history.residual,
        "/conditioning/condition": history.condition,
        "/conditioning/smallest_singular_value": history.smallest_singular_value,
        "/solver/step_time_ms": 1e3 * history.step_time,
        "/solver/iterations": history.iterations,
        "/solver/integrations": history.integrations,
        "/inputs/rotation": history.inputs.rotation[:, 0],
        "/inputs/translation": history.inputs.translation[:, 0],
    }
    for path, values in expected.items():
        np.testing.assert_array_equal(recording.scalars(path)[:, 0], values, err_msg=path)
    np.testing.assert_array_equal(recording.scalars("/inputs/tip_force"), history.inputs.tip_force)
    for path in ("/error/boundary", "/conditioning/condition", "/conditioning/smallest_singular_value", "/solver/step_time_ms"):
        positive = expected[path] > 0
        assert_logarithms(recording.scalars(f"{path}_log10")[positive, 0], expected[path][positive])


def test_entities_timelines_and_rows(history, tmp_path):
    save(tmp_path / "run.rrd", history)
    recording = Recording(tmp_path / "run.rrd")
    temporal = {"/world/rods/rod_0", "/world/tip", "/world/tip_path", "/world/loads/tip_force", "/curvature/rod_0", *SCALARS}
    assert temporal <= recording.paths
    assert {"/description", "/world/base", "/status", "/curvature/axes"} <= recording.paths
    for path in temporal:
        np.testing.assert_array_equal(recording.index(path, "step"), np.arange(40), err_msg=path)
        np.testing.assert_allclose(recording.index(path, "time"), 1e9 * history.time, atol=1, err_msg=path)
    timelines = {
        name for (_, static), chunks in recording.chunks.items() if not static for c in chunks for name in c.timeline_names
    }
    assert timelines == {"step", "time"}


def test_geometry_follows_the_rod(history, tmp_path):
    save(tmp_path / "run.rrd", history, nodes=21)
    recording = Recording(tmp_path / "run.rrd")
    shape = history.rod(0, nodes=21)
    starts = np.array(recording.column("/world/rods/rod_0", "Capsules3D:translations"))
    lengths = np.array(recording.column("/world/rods/rod_0", "Capsules3D:lengths"))
    turns = np.array(recording.column("/world/rods/rod_0", "Capsules3D:quaternions"))
    np.testing.assert_allclose(starts, shape.position[:, :-1], atol=1e-7)
    x, y, z, w = np.moveaxis(turns, -1, 0)
    e3 = np.stack([2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)], axis=-1)
    np.testing.assert_allclose(starts + lengths[..., None] * e3, shape.position[:, 1:], atol=1e-6)
    # 0.4 % of the length where no diameter is given
    np.testing.assert_allclose(recording.column("/world/rods/rod_0", "Capsules3D:radii"), 0.004 * 0.4)
    tips = np.array(recording.column("/world/tip", "Transform3D:translation"))[:, 0]
    np.testing.assert_allclose(tips, history.tip_position, atol=1e-7)
    x, y, z, w = np.array(recording.column("/world/tip", "Transform3D:quaternion"))[:, 0].T
    axis = np.stack([1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y)], axis=-1)
    np.testing.assert_allclose(axis, history.tip_rotation[:, :, 0], atol=1e-6)
    strokes = np.array(recording.column("/world/tip_path", "LineStrips3D:strips"))[:, 0]
    np.testing.assert_allclose(strokes[1:, 0], history.tip_position[:-1], atol=1e-7)
    np.testing.assert_allclose(strokes[:, 1], history.tip_position, atol=1e-7)


def test_radius_and_name_come_from_the_rod(tmp_path):
    save(tmp_path / "run.rrd", make_history(3, robot=make_robot(outer_diameter=3e-3, name="inner wire")))
    recording = Recording(tmp_path / "run.rrd")
    (path,) = [path for path in recording.paths if path.startswith("/world/rods/")]
    assert "inner" in path
    np.testing.assert_allclose(recording.column(path, "Capsules3D:radii"), 1.5e-3)


def test_force_arrows_have_the_stated_scale(history, tmp_path):
    save(tmp_path / "run.rrd", history, force_scale=0.125)
    recording = Recording(tmp_path / "run.rrd")
    arrows, _ = arrows_of(recording, "tip_force")
    np.testing.assert_allclose(arrows, 0.125 * history.inputs.tip_force, atol=1e-8)
    ((legend,),) = recording.column("/legend", "TextDocument:text", static=True)
    assert "yellow `tip_force`, 1 N is 125 mm" in legend
    assert "follower_force" not in legend  # there is none
    (text,) = recording.column("/description", "TextDocument:text", static=True)
    assert "1 N is 125 mm" in text[0]
    assert "SingleRod" in text[0]
    assert "Shooting(" in text[0]


def test_tip_error_against_a_reference(history, tmp_path):
    coarse = make_history(solver=mr.Shooting(integrator=mr.RK4(4)))
    save(tmp_path / "run.rrd", coarse, reference=history)
    recording = Recording(tmp_path / "run.rrd")
    error = 1e3 * np.linalg.norm(coarse.tip_position - history.tip_position, axis=-1)
    assert error.max() > 0
    found = recording.scalars("/error/tip_mm")[:, 0]
    np.testing.assert_array_max_ulp(found, error, maxulp=4)  # a sum of three, whose rounding is NumPy's choice
    assert_logarithms(recording.scalars("/error/tip_mm_log10")[found > 0, 0], found[found > 0])
    assert {"/world/reference/rods/rod_0", "/world/reference/tip_path"} <= recording.paths


def test_failed_samples_have_no_geometry(broken, tmp_path):
    broken.save(tmp_path / "run.rrd")
    recording = Recording(tmp_path / "run.rrd")
    failed = np.isnan(broken.tip_position).any(axis=1)
    for path, name in (
        ("/world/rods/rod_0", "Capsules3D:lengths"),
        ("/world/rods/rod_0", "Capsules3D:radii"),  # a radius alone would be drawn
        ("/world/tip", "Transform3D:translation"),
        ("/curvature/rod_0", "LineStrips2D:strips"),
    ):
        np.testing.assert_array_equal([not row for row in recording.column(path, name)], failed, err_msg=name)
    lengths = np.array(recording.column("/world/tip", "TransformAxes3D:axis_length"))[:, 0]
    np.testing.assert_array_equal(lengths == 0, failed)
    np.testing.assert_array_equal(np.isnan(recording.scalars("/conditioning/condition")[:, 0]), failed)
    np.testing.assert_array_equal(recording.scalars("/error/boundary")[:, 0], broken.residual)


def test_history_that_failed_throughout_is_recorded(tmp_path):
    robot = make_robot()
    solver = mr.Shooting(integrator=mr.RK4(20), max_iterations=1, max_continuation_steps=1)
    history = mr.simulate(robot, robot.inputs(tip_force=(0, 60.0, 0)), time=[0.0, 0.1], solver=solver)
    assert np.isnan(history.tip_position).all()
    save(tmp_path / "run.rrd", history)
    assert Recording(tmp_path / "run.rrd").column("/world/rods/rod_0", "Capsules3D:lengths") == [[], []]


def test_status_lane_holds_the_changes(broken, tmp_path):
    broken.save(tmp_path / "run.rrd")
    recording = Recording(tmp_path / "run.rrd")
    names = [mr.Status(int(value)).name for value in broken.status]
    steps = [k for k in range(20) if k == 0 or names[k] != names[k - 1]]
    assert len(steps) == 3
    np.testing.assert_array_equal(recording.index("/status", "step"), steps)
    assert [row[0] for row in recording.column("/status", "StateChange:state")] == [names[k] for k in steps]


def test_batch_records_the_first_instances(tmp_path):
    robot = make_robot()
    inputs = robot.inputs(rotation=np.linspace(0, 0.3, 30).reshape(5, 3, 2)[..., None], tip_force=(0, 0.1, 0))
    history = mr.simulate(robot, inputs, time=0.02 * np.arange(5), solver=SOLVER)
    save(tmp_path / "run.rrd", history, instances=2)
    recording = Recording(tmp_path / "run.rrd")
    assert {f"/world/instance_{k}/rods/rod_0" for k in range(2)} <= recording.paths
    assert not [path for path in recording.paths if "instance_2" in path]
    for k in range(2):
        values = recording.scalars(f"/conditioning/condition/instance_{k}")[:, 0]
        np.testing.assert_array_equal(values, history.condition.reshape(5, 6)[:, k])
        tips = np.array(recording.column(f"/world/instance_{k}/tip", "Transform3D:translation"))[:, 0]
        np.testing.assert_allclose(tips, history.tip_position.reshape(5, 6, 3)[:, k], atol=1e-7)
    (text,) = recording.column("/description", "TextDocument:text", static=True)
    assert "first 2 of 6" in text[0]


def test_layout_is_embedded(history, tmp_path):
    save(tmp_path / "saved.rrd", history)
    with Recorder(tmp_path / "live.rrd") as recorder:
        recorder.log(0.0, mr.solve(make_robot(), solver=SOLVER))
    for name in ("saved.rrd", "live.rrd"):
        assert {"3D", "2D", "StateTimeline", "TextDocument", "TimeSeries"} <= views_of(tmp_path / name), name


def test_recorder_equals_the_tracked_solutions(tmp_path):
    robot = make_robot()
    tracker = mr.Tracker(robot, solver=SOLVER, dt=0.02, inputs=robot.inputs(rotation=0.0, tip_force=(0, 0.1, 0)))
    solutions = []
    with Recorder(tmp_path / "run.rrd", flush_every=7, nodes=21, name="bench") as recorder:
        for k in range(25):
            solutions.append(tracker.step(rotation=0.02 * k, tip_force=(0.001 * k, 0.1, 0.0)))
            recorder.log(0.02 * k, solutions[-1], step_time=1e-4 * (k + 1), reference=solutions[-1])
    recording = Recording(tmp_path / "run.rrd")
    for path in SCALARS:
        np.testing.assert_array_equal(recording.index(path, "step"), np.arange(25), err_msg=path)
    np.testing.assert_array_equal(recording.scalars("/conditioning/condition")[:, 0], [s.condition for s in solutions])
    np.testing.assert_array_equal(recording.scalars("/error/boundary")[:, 0], [s.residual for s in solutions])
    np.testing.assert_array_equal(recording.scalars("/solver/step_time_ms")[:, 0], [1e3 * (1e-4 * (k + 1)) for k in range(25)])
    np.testing.assert_array_equal(recording.scalars("/error/tip_mm"), np.zeros((25, 1)))
    np.testing.assert_array_equal(recording.scalars("/inputs/rotation")[:, 0], 0.02 * np.arange(25))
    starts = np.array(recording.column("/world/rods/rod_0", "Capsules3D:translations"))
    np.testing.assert_allclose(starts, [s.rod(0, nodes=21).position[:-1] for s in solutions], atol=1e-7)
    strokes = np.array(recording.column("/world/tip_path", "LineStrips3D:strips"))[:, 0]
    np.testing.assert_array_equal(strokes[1:, 0], strokes[:-1, 1])


def test_recorder_takes_inputs_that_come_later(tmp_path):
    robot = make_robot()
    tracker = mr.Tracker(robot, solver=SOLVER, dt=0.02)
    with Recorder(tmp_path / "run.rrd", flush_every=100) as recorder:
        for k in range(6):
            recorder.log(0.02 * k, tracker.step(rotation=0.1) if k < 3 else tracker.step(tip_force=(0, 0.1, 0)))
    recording = Recording(tmp_path / "run.rrd")
    np.testing.assert_array_equal(recording.index("/inputs/rotation", "step"), np.arange(6))
    np.testing.assert_array_equal(recording.index("/inputs/tip_force", "step"), np.arange(3, 6))


def test_exception_in_the_loop_keeps_what_was_logged(tmp_path):
    solution = mr.solve(make_robot(), solver=SOLVER)

    def loop():
        with Recorder(tmp_path / "run.rrd", flush_every=50) as recorder:
            for k in range(9):
                recorder.log(0.1 * k, solution)
            raise KeyError

    with pytest.raises(KeyError):
        loop()
    np.testing.assert_array_equal(Recording(tmp_path / "run.rrd").index("/error/boundary", "step"), np.arange(9))


LOOP = """
import os, signal, sys
import multirod as mr
from multirod.recording import Recorder
if sys.argv[2] == "SIGTERM":
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(143))
robot = mr.SingleRod(mr.Rod(length=0.4, bending_stiffness=0.2233, torsional_stiffness=0.0638, precurvature=(3, 1, 0)))
tracker = mr.Tracker(robot, solver=mr.Shooting(integrator=mr.RK4(20)), dt=0.02, inputs=robot.inputs(rotation=0.0))
with Recorder(sys.argv[1], flush_every=10) as recorder:
    for k in range(1000):
        recorder.log(0.02 * k, tracker.step(rotation=0.001 * k))
        if k == 100:
            recorder.flush()
        if k == 105:
            os.kill(os.getpid(), getattr(signal, sys.argv[2]))
"""


@pytest.mark.skipif(not hasattr(signal, "SIGKILL"), reason="no SIGKILL on this system")
@pytest.mark.parametrize(("name", "kept", "code"), [("SIGKILL", 101, -9), ("SIGTERM", 106, 143)])
@pytest.mark.filterwarnings("ignore::rerun.error_utils.RerunWarning")  # the reader says that the file has no footer
def test_killed_run_leaves_a_readable_recording(name, kept, code, tmp_path):
    path = tmp_path / "run.rrd"
    environment = {**os.environ, "RUST_LOG": "error"}
    ended = programs.run("-c", LOOP, str(path), name, env=environment)
    assert ended.returncode == code, ended.stderr[-2000:]
    rr.set_strict_mode(False)
    recording = Recording(path)
    assert len(recording.index("/error/boundary", "step")) >= kept
    np.testing.assert_array_equal(recording.index("/world/rods/rod_0", "step")[:kept], np.arange(kept))
    np.testing.assert_array_equal(recording.scalars("/inputs/rotation")[:kept, 0], 0.001 * np.arange(kept))
    assert "StateTimeline" in views_of(path)


FULL = """
import resource, sys
from pathlib import Path
import multirod as mr

history = mr.load(sys.argv[1])
history.save("first.rrd")  # all that it compiles
target = Path(sys.argv[2])
resource.setrlimit(resource.RLIMIT_FSIZE, (20_000, 20_000))  # of a file, as of a disk that is full
try:
    history.save(target)
except OSError as error:
    print(type(error).__name__, target.read_bytes() == b"of before", len(list(target.parent.iterdir())))
"""


@pytest.mark.skipif(os.name != "posix", reason="no such limit on this system")
def test_a_recording_that_the_disk_has_no_room_for_is_refused_and_what_was_there_stays(history, tmp_path):
    """The writer of the SDK waited for ever for its thread, which had ended, and had begun to write over what was there."""
    target = tmp_path / "full" / "run.rrd"
    target.parent.mkdir()
    target.write_bytes(b"of before")
    history.save(tmp_path / "run.npz")
    ended = programs.run("-c", FULL, str(tmp_path / "run.npz"), str(target), cwd=tmp_path)
    assert ended.stdout == "OSError True 1\n", ended.stderr[-2000:]


def test_save_refuses_bad_arguments(history, tmp_path):
    file = tmp_path / "run.rrd"
    with pytest.raises(TypeError, match="save takes a History, not Solution"):
        save(file, mr.solve(make_robot(), solver=SOLVER))
    with pytest.raises(TypeError, match=r"save\.reference takes a History, not str"):
        save(file, history, reference="truth")
    with pytest.raises(ValueError, match=r"save\.reference = .* samples of the history"):
        save(file, history, reference=make_history(7))
    robot = make_robot()
    for shape, times in (((2, 0, 1), [0.0, 0.1]), ((0, 1), [])):
        none = mr.simulate(robot, robot.inputs(rotation=np.zeros(shape)), time=times, solver=SOLVER)
        with pytest.raises(ValueError, match=r"save\.history = .* must have a sample"):
            none.save(file)
    for options in ({"nodes": 1}, {"instances": 0}, {"force_scale": -1.0}, {"force_scale": np.nan}, {"name": ""}, {"name": 3}):
        (field,) = options
        with pytest.raises(ValueError, match=rf"save\.{field} = .* is not allowed: must be"):
            save(file, history, **options)
    for path in (tmp_path / "absent" / "run.rrd", tmp_path, 3, ""):
        with pytest.raises(ValueError, match=r"save\.path = .* is not allowed"):
            save(path, history)
    for name in ("x.npz", "x.txt", "x", "x.rrd.gz"):
        with pytest.raises(ValueError, match=r"save\.path = .* is not allowed: must end in \.rrd"):
            save(tmp_path / name, history)
        with pytest.raises(ValueError, match=r"Recorder\.path = .* is not allowed: must end in \.rrd"):
            Recorder(tmp_path / name)
    assert not list(tmp_path.iterdir())


def test_recorder_refuses_bad_arguments(history, tmp_path):
    file = tmp_path / "run.rrd"
    with pytest.raises(TypeError, match="a path, an address, or both"):
        Recorder()
    for options in (
        {"address": "127.0.0.1:9876"},
        {"address": 9876},
        {"flush_every": 0},
        {"flush_every": 2.0},
        {"nodes": 1},
        {"instances": 0},
        {"force_scale": 0.0},
        {"description": 1},
        {"name": ""},
    ):
        (field,) = options
        with pytest.raises(ValueError, match=rf"Recorder\.{field} = .* is not allowed"):
            Recorder(file, **options)
    with pytest.raises(ValueError, match=r"Recorder\.path"):
        Recorder(tmp_path / "absent" / "run.rrd")
    solution = mr.solve(make_robot(), solver=SOLVER)
    with Recorder(file) as recorder:
        with pytest.raises(TypeError, match="Solution of one sample, not History"):
            recorder.log(0.0, history)
        with pytest.raises(TypeError, match="not NoneType"):
            recorder.log(0.0, None)
        with pytest.raises(ValueError, match="must be finite"):
            recorder.log(np.nan, solution)
        recorder.log(1.0, solution)
        with pytest.raises(ValueError, match=r"Recorder\.log\.time = 1\.0 is not allowed: must be later"):
            recorder.log(1.0, solution)
        with pytest.raises(ValueError, match="step_time = -1"):
            recorder.log(2.0, solution, step_time=-1)
        with pytest.raises(ValueError, match="robot of the first sample"):
            recorder.log(2.0, mr.solve(make_robot(), solver=SOLVER))
    with pytest.raises(RuntimeError, match="closed"):
        recorder.log(3.0, solution)
    recorder.close()
    assert len(Recording(file).index("/error/boundary", "step")) == 1


def test_importing_the_library_does_not_import_rerun():
    code = "import sys, multirod, multirod.recording; sys.exit('rerun' in sys.modules)"
    assert programs.run("-c", code).returncode == 0


TUBES = [
    mr.Rod(length=0.30, bending_stiffness=0.004, torsional_stiffness=0.003, precurvature=(9, 0, 0), name="inner"),
    mr.Rod(length=0.22, bending_stiffness=0.017, torsional_stiffness=0.014, precurvature=(5, 0, 0)),
    mr.Rod(length=0.12, bending_stiffness=0.040, torsional_stiffness=0.030, name="outer"),
]
ROD = mr.Rod(length=0.2, bending_stiffness=0.02, torsional_stiffness=0.015, outer_diameter=2e-3)


def triangle(radius):
    angle = 2 * np.pi * np.arange(3) / 3
    poses = np.tile(np.eye(4), (3, 1, 1))
    poses[:, :2, 3] = radius * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    return poses


def make_tripod():
    """A leg of three tubes and two rods, one of which has a name that no other has."""
    named = mr.Rod(length=0.2, bending_stiffness=0.02, torsional_stiffness=0.015, outer_diameter=2e-3, name="strut")
    return mr.ParallelRods(legs=[mr.ConcentricTubes(TUBES), ROD, named], base=triangle(0.05), platform=triangle(0.03))


TRIPOD_RODS = ["leg_1/inner", "leg_1/rod_1", "leg_1/outer", "leg_2", "strut"]
TRIPOD_TRANSLATION = (-0.1, -0.1, -0.05, 0, 0)


@pytest.fixture(scope="module")
def tripod_history():
    robot = make_tripod()
    time = 0.02 * np.arange(12)
    values = {
        "rotation": 0.3 * time[:, None] * [1, 0, 0, 1, 0],
        "translation": TRIPOD_TRANSLATION,
        "tip_force": (0.2, 0, -0.3),
        "follower_force": (0, 0.1, 0.2),
        "force_point": np.stack([time, 0 * time, 0.01 + 0 * time], axis=-1),
    }
    return mr.simulate(robot, robot.inputs(**values), time=time).raise_if_failed()


def starts_of(recording, path):
    return np.array(recording.column(path, "Capsules3D:translations"))


def test_tubes_are_entities_that_nest(tmp_path):
    robot = mr.ConcentricTubes(TUBES)
    time = 0.02 * np.arange(5)
    inputs = robot.inputs(rotation=time[:, None] * [1, 0, -1], translation=(-0.12, -0.1, -0.05))
    history = mr.simulate(robot, inputs, time=time)
    save(tmp_path / "run.rrd", history, nodes=11)
    recording = Recording(tmp_path / "run.rrd")
    names = ["inner", "rod_1", "outer"]
    radii, colors = [], []
    for k, name in enumerate(names):
        np.testing.assert_allclose(
            starts_of(recording, f"/world/rods/{name}"), history.rod(k, nodes=11).position[:, :-1], atol=1e-7
        )
        radii.append(recording.column(f"/world/rods/{name}", "Capsules3D:radii")[0][0])
        colors.append(recording.column(f"/world/rods/{name}", "Capsules3D:colors", static=True)[0][0])
        assert f"/curvature/{name}" in recording.paths
    # the outermost of tubes without diameter is drawn as any rod: 0.4 % of the longest one's length
    np.testing.assert_allclose(radii, [0.75**2 * 0.0012, 0.75 * 0.0012, 0.0012], rtol=1e-6)
    assert len(set(colors)) == 3
    assert "/world/platform" not in recording.paths
    (parts,) = recording.column("/error/blocks", "SeriesLines:names", static=True)
    assert parts == names[:0:-1]  # without loads the torque of the innermost follows from theirs
    (labels,) = recording.column("/inputs/rotation", "SeriesLines:names", static=True)
    assert labels == names


def test_parallel_rods_have_an_entity_for_every_leg_and_tube(tripod_history, tmp_path):
    tripod_history.save(tmp_path / "run.rrd", nodes=11)
    recording = Recording(tmp_path / "run.rrd")
    colors = []
    for k, name in enumerate(TRIPOD_RODS):
        found = starts_of(recording, f"/world/rods/{name}")
        np.testing.assert_allclose(found, tripod_history.rod(k, nodes=11).position[:, :-1], atol=1e-7)
        colors.append(recording.column(f"/world/rods/{name}", "Capsules3D:colors", static=True)[0][0])
    assert len(set(colors)) == 5
    for leg, place in zip(("leg_1", "leg_2", "strut"), triangle(0.05)[:, :3, 3], strict=True):
        (origin,) = recording.column(f"/world/base/{leg}", "Transform3D:translation", static=True)
        np.testing.assert_allclose(origin[0], place, atol=1e-8)


@pytest.mark.filterwarnings("ignore::multirod.PlausibilityWarning")
def test_thin_robot_is_drawn_thick_enough(tripod_history, tmp_path):
    tripod_history.save(tmp_path / "run.rrd")
    recording = Recording(tmp_path / "run.rrd")
    tubes = [recording.column(f"/world/rods/{name}", "Capsules3D:radii")[0][0] for name in TRIPOD_RODS]
    np.testing.assert_allclose(tubes[3], 1e-3, rtol=1e-6)  # as it is
    assert tubes[0] < tubes[1] < tubes[2]
    hair = mr.SingleRod(mr.Rod(length=0.4, bending_stiffness=0.2, torsional_stiffness=0.1, outer_diameter=1e-5))
    save(tmp_path / "hair.rrd", make_history(2, robot=hair))
    radius = Recording(tmp_path / "hair.rrd").column("/world/rods/rod_0", "Capsules3D:radii")[0][0]
    assert 0.7e-3 < radius < 1e-3  # 0.2 % of what is in view, about 0.4 m
    (text,) = Recording(tmp_path / "hair.rrd").column("/description", "TextDocument:text", static=True)
    assert "(is 0.01)" in text[0]


def test_platform_is_a_plate_through_its_attachments(tripod_history, tmp_path):
    tripod_history.save(tmp_path / "run.rrd")
    recording = Recording(tmp_path / "run.rrd")
    places = np.array(recording.column("/world/platform", "Transform3D:translation"))[:, 0]
    np.testing.assert_allclose(places, tripod_history.tip_position, atol=1e-7)
    (mesh,) = [row for row in recording.column("/world/platform", "Mesh3D:vertex_positions") if row]
    (triangles,) = [row for row in recording.column("/world/platform", "Mesh3D:triangle_indices") if row]
    (normals,) = [row for row in recording.column("/world/platform", "Mesh3D:vertex_normals") if row]
    vertices, corners = np.array(mesh), np.array(mesh)[np.array(triangles)]
    # a closed body: the divergence theorem gives its volume and no net area
    area = 0.5 * np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    np.testing.assert_allclose(area.sum(axis=0), 0, atol=1e-9)
    volume = np.einsum("ij,ij->", area, corners.mean(axis=1)) / 3
    assert volume > 0  # faces and normals point outwards
    assert (np.einsum("ij,icj->ic", area, np.array(normals)[np.array(triangles)]) > 0).all()
    thickness = np.ptp(vertices[:, 2])
    assert volume > thickness * 3 * np.sqrt(3) / 4 * 0.03**2  # more than the triangle of the attachments
    reach = np.linalg.norm(vertices[:, :2], axis=1).max()
    assert 0.03 < reach < 0.05


def test_loads_on_a_platform_start_where_they_act(tripod_history, tmp_path):
    tripod_history.save(tmp_path / "run.rrd", force_scale=0.1)
    recording = Recording(tmp_path / "run.rrd")
    R, inputs = tripod_history.tip_rotation, tripod_history.inputs
    point = tripod_history.tip_position + np.einsum("tij,tj->ti", R, inputs.force_point)
    turned = np.einsum("tij,tj->ti", R, inputs.follower_force)
    for name, force in (("tip_force", inputs.tip_force), ("follower_force", turned)):
        arrows, origins = arrows_of(recording, name)
        np.testing.assert_allclose(arrows, 0.1 * force, atol=1e-7, err_msg=name)
        np.testing.assert_allclose(origins, point, atol=1e-7, err_msg=name)


def test_what_acts_along_rods_is_one_force_at_its_middle():
    """Of a force that grows along a rod from nothing the middle is at two thirds; of tubes the longest tells, and once."""
    s = np.linspace(0, 0.3, 301)
    force = np.stack([0.045 - s**2 / 2, 0 * s, 0 * s + 7.0], axis=-1)  # 1 N/m^2 times the arclength, and 7 N at the tip
    frames = np.tile([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]], (len(s), 1, 1))
    straight = {
        "arclength": s,
        "position": np.stack([0 * s, 0 * s, s], axis=-1),
        "rotation": frames,
        "total_force": np.einsum("nji,nj->ni", frames, force),
    }
    short = {name: value[:101] for name, value in straight.items()} | {"arclength": np.linspace(0, 0.1, 301)}
    short |= {name: np.full_like(straight[name], np.nan) for name in ("position", "rotation", "total_force")}
    shapes = [{name: value[None, None] for name, value in own.items()} for own in (short, straight)]
    load = DrawnLoad("along", ("along",), 0, "brown", rods=(0, 1))
    origin, vector = along_rods(load, shapes, (1, 1, 3))
    np.testing.assert_allclose(vector[0, 0], (0.045, 0, 0), atol=1e-15)
    np.testing.assert_allclose(origin[0, 0], (0, 0, 0.2), atol=1e-6)  # nodes are a millimetre apart
    shapes[1]["total_force"] = np.einsum("nji,nj->ni", frames, 0 * force + [0, 0, 7.0])[None, None] * (1 + 1e-15)
    assert not along_rods(load, shapes, (1, 1, 3))[1].any()


def test_weights_are_drawn_where_they_act(tmp_path):
    rod = mr.Rod(length=0.2, bending_stiffness=0.02, torsional_stiffness=0.015, linear_density=0.05)
    robot = mr.ParallelRods(
        legs=[rod] * 3, base=triangle(0.05), platform=triangle(0.03), platform_mass=0.04, platform_centre=(0, 0, 0.01)
    )
    inputs = robot.inputs(gravity=(0, 0, -9.81), tip_moment=(0, 0.01, 0), tip_force=(0.1, 0, 0), force_point=(0, 0, 0.02))
    history = mr.simulate(robot, inputs, time=[0.0, 0.1]).raise_if_failed()
    history.save(tmp_path / "run.rrd", force_scale=0.1)
    recording = Recording(tmp_path / "run.rrd")
    for k in range(3):
        arrows, origins = arrows_of(recording, f"along/leg_{k + 1}")
        np.testing.assert_allclose(arrows, np.tile([0, 0, -0.1 * 0.05 * 0.2 * 9.81], (2, 1)), atol=1e-8)
        np.testing.assert_allclose(origins, history.rod(k, nodes=401).position.mean(axis=1), atol=1e-4)
    arrows, origins = arrows_of(recording, "weight/platform")
    np.testing.assert_allclose(arrows, np.tile([0, 0, -0.1 * 0.04 * 9.81], (2, 1)), atol=1e-8)
    np.testing.assert_allclose(origins, history.tip_position + history.tip_rotation @ [0, 0, 0.01], atol=1e-7)
    arrows, origins = arrows_of(recording, "tip_moment")
    np.testing.assert_allclose(origins, history.tip_position, atol=1e-7)
    ((legend,),) = recording.column("/legend", "TextDocument:text", static=True)
    assert "brown `along`, brown `weight`, 1 N is 100 mm" in legend
    assert "violet `tip_moment`" in legend


class Scattered(mr.Solver):
    """Leaves residuals of all sizes, each another."""

    def _solve(self, problem, guess):
        outcome = mr.Outcome.zeros(problem.instance_count)
        outcome.status[:] = mr.Status.CONVERGED
        problem.integrate()
        random = np.random.default_rng(int(1e6 * np.abs(problem.read("inputs")).sum()))
        size = problem.read("residual").shape
        problem.write("residual", 10.0 ** random.uniform(-9, 0, size) * random.choice([-1, 1], size))
        return outcome


def test_errors_are_split_by_leg(tripod_history, tmp_path):
    given = tripod_history.inputs, tripod_history.time
    observed = mr.simulate(tripod_history.assembly, given[0], time=given[1], solver=Scattered())
    observed.save(tmp_path / "run.rrd")
    recording = Recording(tmp_path / "run.rrd")
    (names,) = recording.column("/error/blocks", "SeriesLines:names", static=True)
    assert names == ["leg 1", "leg 2", "leg 3", "platform"]
    (shades,) = recording.column("/error/blocks", "SeriesLines:colors", static=True)
    drawn = [recording.column(f"/world/rods/{rod}", "Capsules3D:colors", static=True)[0][0] for rod in TRIPOD_RODS[2:]]
    assert shades[:3] == drawn  # as the outermost tube of the leg
    assert shades[3] not in drawn
    (plate,) = recording.column("/world/platform", "Mesh3D:albedo_factor", static=True)
    assert shades[3] >> 8 == plate[0] >> 8  # of the platform's colour, which is also somewhat transparent
    parts = recording.scalars("/error/blocks")
    # three tubes have 8 residuals, a rod 6; of each leg the third, its gap along the base, is the platform's, which has 6 of its
    # own
    legs = [[0, 1, 3, 4, 5, 6, 7], [8, 9, 11, 12, 13], [14, 15, 17, 18, 19]]
    residual = np.abs(observed.boundary_residual)
    for k, own in enumerate([*legs, [2, 10, 16, *range(20, 26)]]):
        np.testing.assert_array_equal(parts[:, k], residual[:, own].max(axis=1))
    np.testing.assert_array_equal(recording.scalars("/error/boundary")[:, 0], parts.max(axis=1))
    assert_logarithms(recording.scalars("/error/blocks_log10"), parts)


def test_platform_vanishes_where_a_sample_failed(tmp_path):
    robot = mr.ParallelRods(legs=[ROD] * 3, base=triangle(0.05), platform=triangle(0.03))
    tip_force = np.zeros((9, 3))
    tip_force[3:6, 0] = 4000.0
    solver = mr.Shooting(integrator=mr.RK4(12), max_iterations=12, max_continuation_steps=3)
    time = 0.02 * np.arange(9)
    history = mr.simulate(robot, robot.inputs(tip_force=tip_force), time=time, solver=solver)
    failed = np.isnan(history.tip_position).any(axis=1)
    np.testing.assert_array_equal(failed, [k in (3, 4, 5) for k in range(9)])
    history.save(tmp_path / "run.rrd")
    recording = Recording(tmp_path / "run.rrd")
    poses = [row for row in recording.column("/world/platform", "Transform3D:translation") if row is not None]
    np.testing.assert_array_equal([not row for row in poses], failed)
    rows = recording.column("/world/platform", "Mesh3D:vertex_positions")
    assert [bool(row) for row in rows if row is not None] == [True, False, True]  # when the samples fail, and are sound again


def test_platforms_of_a_batch_and_of_a_recorder(tmp_path):
    robot = make_tripod()
    forces = 0.2 * np.array([[1, 0, 0], [0, 1, 0], [0, 0, 1]])
    tracker = mr.Tracker(
        robot,
        dt=0.02,
        inputs=robot.inputs(tip_force=forces, translation=TRIPOD_TRANSLATION),
    )
    solutions = []
    with Recorder(tmp_path / "run.rrd", instances=2, flush_every=3) as recorder:
        for k in range(5):
            solutions.append(tracker.step(rotation=0.02 * k))
            recorder.log(0.02 * k, solutions[-1])
    recording = Recording(tmp_path / "run.rrd")
    for k in range(2):
        assert {f"/world/instance_{k}/rods/{name}" for name in TRIPOD_RODS} <= recording.paths
        places = np.array(recording.column(f"/world/instance_{k}/platform", "Transform3D:translation"))[:, 0]
        np.testing.assert_allclose(places, [solution.tip_position[k] for solution in solutions], atol=1e-7)
        assert recording.scalars(f"/error/blocks/instance_{k}").shape == (5, 4)
        # one mesh, although samples came in three blocks
        assert len([row for row in recording.column(f"/world/instance_{k}/platform", "Mesh3D:vertex_positions") if row]) == 1
    assert not [path for path in recording.paths if "instance_2" in path]


def test_names_never_coincide(tmp_path):
    """A name that two rods have, or that an unnamed one would get, names none of them."""

    def rod(name):
        return mr.Rod(length=0.2, bending_stiffness=0.02, torsional_stiffness=0.015, name=name)

    names = ["twin", "leg_1", "twin", "a/b"]
    angle = 0.5 * np.pi * np.arange(4)
    poses = np.tile(np.eye(4), (4, 1, 1))
    poses[:, :2, 3] = 0.05 * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    robot = mr.ParallelRods(legs=[rod(name) for name in names], base=poses, platform=poses)
    with Recorder(tmp_path / "run.rrd") as recorder:
        recorder.log(0.0, mr.solve(robot, solver=mr.Shooting(integrator=mr.RK4(12))))
    paths = {path for path in Recording(tmp_path / "run.rrd").paths if path.startswith("/world/rods/")}
    assert paths == {"/world/rods/leg_1", "/world/rods/leg_2", "/world/rods/leg_3", r"/world/rods/a\/b"}


def test_each_robot_of_a_batch_has_its_own_platform(tmp_path):
    radius = np.array([0.03, 0.04])
    platforms = np.stack([triangle(r) for r in radius])
    robot = mr.ParallelRods(legs=[ROD] * 3, base=triangle(0.05), platform=platforms)
    time = 0.02 * np.arange(3)
    inputs = robot.inputs(tip_force=0.1 * time[:, None, None] * [1, 0, 0])
    history = mr.simulate(robot, inputs, time=time, solver=mr.Shooting(integrator=mr.RK4(12))).raise_if_failed()
    save(tmp_path / "run.rrd", history)
    recording = Recording(tmp_path / "run.rrd")
    for k in range(2):
        (mesh,) = [row for row in recording.column(f"/world/instance_{k}/platform", "Mesh3D:vertex_positions") if row]
        reach = np.linalg.norm(np.array(mesh)[:, :2], axis=1).max()
        np.testing.assert_allclose(reach, 1.25 * radius[k], rtol=1e-6)  # a quarter more than the attachments


def test_platform_of_two_legs_is_a_plate(tmp_path):
    """Two points fix no plane: the plate faces the legs."""
    poses = triangle(0.05)[:2]
    poses[1, :3, 3] = -poses[0, :3, 3]
    robot = mr.ParallelRods(legs=[ROD] * 2, base=poses, platform=poses)
    with Recorder(tmp_path / "run.rrd") as recorder:
        recorder.log(0.0, mr.solve(robot, solver=mr.Shooting(integrator=mr.RK4(12))))
    ((mesh,),) = [[row for row in Recording(tmp_path / "run.rrd").column("/world/platform", "Mesh3D:vertex_positions") if row]]
    extent = np.ptp(np.array(mesh), axis=0)
    assert extent[0] > 2 * 0.05
    assert extent[1] > 2e-3  # wider than a rod
    assert extent[2] < 0.2 * extent[1]


def test_inverse_problem_is_recorded_as_its_robot(tmp_path):
    def circle(degrees):
        angle = np.radians(degrees)
        poses = np.tile(np.eye(4), (6, 1, 1))
        poses[:, :2, 3] = 0.05 * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
        return poses

    base, platform = circle([-10, 10, 110, 130, 230, 250]), circle([-50, 50, 70, 170, 190, 290])
    robot = mr.ParallelRods(legs=[ROD] * 6, base=base, platform=platform).inverse()
    solution = mr.solve(robot, robot.inputs(platform_position=(0.005, 0, 0.19)), solver=mr.Shooting(integrator=mr.RK4(12)))
    with Recorder(tmp_path / "run.rrd") as recorder:
        recorder.log(0.0, solution.raise_if_failed())
    recording = Recording(tmp_path / "run.rrd")
    assert {"/world/platform", *(f"/world/rods/leg_{k + 1}" for k in range(6))} <= recording.paths
    np.testing.assert_array_equal(recording.scalars("/inputs/platform_position")[0], (0.005, 0, 0.19))


def make_network(base=None):
    """Two struts hold a plate; a feeler that stands on it has a free tip; an object is held from both sides."""
    plate, held = mr.Body("plate", mass=0.02), mr.Body("held/up")
    places = triangle(0.03)
    side = np.eye(4)
    side[:3, :3] = Rotation.from_euler("y", 90, degrees=True).as_matrix()
    left, right = side.copy(), side.copy()
    left[0, 3], right[0, 3] = -0.01, 0.01
    right[:3, :3] = side[:3, :3].T
    joints = [mr.Joint(f"strut {k}", "base", to=mr.ground, pose=triangle(0.05)[k]) for k in range(3)]
    joints += [mr.Joint(f"strut {k}", "tip", to=plate, pose=places[k], kind="spherical") for k in range(3)]
    joints += [mr.Joint(name, "base", to=plate, pose=pose) for name, pose in (("west", left), ("east", right))]
    joints += [mr.Joint(name, "tip", to=held, pose=pose) for name, pose in (("west", left), ("east", right))]
    joints += [mr.Joint("feeler", "base", to=held)]
    bowed = {
        name: mr.Rod(length=0.1, bending_stiffness=0.02, torsional_stiffness=0.015, precurvature=(0, sign * 10 * np.pi, 0))
        for name, sign in (("west", 1), ("east", -1))
    }
    rods = {f"strut {k}": ROD for k in range(3)} | bowed | {"feeler": ROD}
    return mr.Network(rods=rods, bodies=[plate, held], joints=joints, end_effector="feeler", base=base)


def network_inputs(robot, time):
    force, moment = np.zeros((len(time), 3, 3)), np.zeros((len(time), 3, 3))
    force[:, 0, 0], force[:, 2, 1], moment[:, 1, 2] = 0.3 + time, 0.1, 0.02
    return robot.inputs(force=force, moment=moment, gravity=(0, 0, -9.81))


@pytest.fixture(scope="module")
def network_history():
    robot, time = make_network(), 0.1 * np.arange(3)
    solver = mr.Shooting(integrator=mr.RK4(12))
    return mr.simulate(robot, network_inputs(robot, time), time=time, solver=solver).raise_if_failed()


def test_a_network_has_its_bodies_and_what_acts_on_them(network_history, tmp_path):
    history = network_history
    history.save(tmp_path / "run.rrd", nodes=11, force_scale=0.1)
    recording = Recording(tmp_path / "run.rrd")
    names = [rod.name for rod in history.assembly.rods]
    escaped = [name.replace(" ", "\\ ") for name in names]
    for name, path in zip(names, escaped, strict=True):
        found = starts_of(recording, f"/world/rods/{path}")
        np.testing.assert_allclose(found, history.rod(name, nodes=11).position[:, :-1], atol=1e-7)
    for k in range(3):
        (origin,) = recording.column(f"/world/base/{escaped[k]}", "Transform3D:translation", static=True)
        np.testing.assert_allclose(origin[0], triangle(0.05)[k, :3, 3], atol=1e-8)
    for body, path in (("plate", "plate"), ("held/up", r"held\/up")):
        entity = f"/world/bodies/{path}"
        places = np.array(recording.column(entity, "Transform3D:translation"))[:, 0]
        np.testing.assert_allclose(places, history.body_position(body), atol=1e-7)
        turns = Rotation.from_quat(np.array(recording.column(entity, "Transform3D:quaternion"))[:, 0])
        np.testing.assert_allclose(turns.as_matrix(), history.body_rotation(body), atol=1e-6)
        (mesh,) = [row for row in recording.column(entity, "Mesh3D:vertex_positions") if row]
        (triangles,) = [row for row in recording.column(entity, "Mesh3D:triangle_indices") if row]
        (normals,) = [row for row in recording.column(entity, "Mesh3D:vertex_normals") if row]
        corners = np.array(mesh)[np.array(triangles)]
        area = 0.5 * np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        np.testing.assert_allclose(area.sum(axis=0), 0, atol=1e-9)  # closed, and faces outwards
        assert np.einsum("ij,ij->", area, corners.mean(axis=1)) > 0
        assert (np.einsum("ij,icj->ic", area, np.array(normals)[np.array(triangles)]) > -1e-12).all()
        assert np.abs(np.array(mesh)[:, 0]).max() >= (0.03 if body == "plate" else 0.01)  # it reaches what it holds
        assert len([row for row in recording.column(entity, "TransformAxes3D:axis_length") if row]) == 3
        (label,) = recording.column(f"{entity}/name", "Points3D:labels", static=True)
        assert label == [body]
    inputs = history.inputs
    arrows, origins = arrows_of(recording, "force/plate")
    np.testing.assert_allclose(arrows, 0.1 * inputs.force[:, :3], atol=1e-7)
    np.testing.assert_allclose(origins, history.body_position("plate"), atol=1e-7)
    arrows, origins = arrows_of(recording, "force/feeler")
    np.testing.assert_allclose(origins, history.tip_position, atol=1e-7)
    arrows, origins = arrows_of(recording, r"moment/held\/up")
    np.testing.assert_allclose(origins, history.body_position("held/up"), atol=1e-7)
    assert not [row for row in recording.column(r"/world/loads/force/held\/up", "Arrows3D:vectors") if row]
    weight, origins = arrows_of(recording, "weight/plate")  # which alone has a mass: nothing acts along the rods
    np.testing.assert_allclose(weight, np.tile([0, 0, -0.1 * 0.02 * 9.81], (3, 1)), atol=1e-8)
    np.testing.assert_allclose(origins, history.body_position("plate"), atol=1e-7)
    assert not any(path.startswith("/world/loads/along") for path in recording.paths)
    (text,) = recording.column("/description", "TextDocument:text", static=True)
    for row in ("| strut 0, strut 1, strut 2 | ground, clamped | plate, spherical |", "| feeler | held/up, clamped | free |"):
        assert row in text[0]
    assert "**Bodies** plate (0.02 kg), held/up. **End effector** feeler" in text[0]
    (legend,) = recording.column("/legend", "TextDocument:text", static=True)
    scale = arrows[0, 2] / 0.02  # a moment of 0.02 N m
    assert "arrows: yellow `force`, brown `weight`, 1 N is 100 mm" in legend[0]
    assert f"arrows: violet `moment`, 1 N m is {1e3 * scale:.4g} mm" in legend[0]
    (labels,) = recording.column("/inputs/force", "SeriesLines:names", static=True)
    assert labels[:4] == ["plate x", "plate y", "plate z", "held/up x"]
    (parts,) = recording.column("/error/blocks", "SeriesLines:names", static=True)
    assert parts == [*names, "bodies"]


def test_a_network_is_recorded_as_it_comes_and_in_a_batch(network_history, tmp_path):
    """Arrows of both kinds fit what comes; a batch of bases has bodies where they are."""
    moved = np.tile(np.eye(4), (2, 1, 1))
    moved[1, 0, 3] = 0.3
    robot = make_network(base=moved)
    time = 0.1 * np.arange(3)
    inputs = network_inputs(make_network(), time)
    solver = mr.Shooting(integrator=mr.RK4(12))
    solutions = [
        mr.solve(robot, robot.inputs(force=f, moment=m), solver=solver) for f, m in zip(inputs.force, inputs.moment, strict=True)
    ]
    with Recorder(tmp_path / "run.rrd", flush_every=1) as recorder:
        for t, solution in zip(time, solutions, strict=True):
            recorder.log(t, solution)
    recording = Recording(tmp_path / "run.rrd")
    for k in range(2):
        places = np.array(recording.column(f"/world/instance_{k}/bodies/plate", "Transform3D:translation"))[:, 0]
        np.testing.assert_allclose(places, [solution.body_position("plate")[k] for solution in solutions], atol=1e-7)
        for kind in ("force/plate", r"moment/held\/up"):
            assert [row for row in recording.column(f"/world/instance_{k}/loads/{kind}", "Arrows3D:vectors") if row]
    np.testing.assert_allclose(
        solutions[0].body_position("plate")[1], solutions[0].body_position("plate")[0] + [0.3, 0, 0], atol=1e-8
    )


@pytest.fixture(scope="module")
def lined_history():
    """Two tendons that pull in turn, a chamber, and discs."""
    lines = [
        mr.Tendon(offset=(0.008, 0), driven="displacement", axial_stiffness=2000.0, name="right"),
        mr.Tendon(offset=(-0.008, 0), driven="displacement", axial_stiffness=2000.0, end=0.1),
        mr.Chamber(offset=(0, 0.005), area=2e-5, name="chamber"),
    ]
    robot = mr.SingleRod(mr.Rod(length=0.2, bending_stiffness=0.02, torsional_stiffness=0.015, lines=lines, discs=0.05))
    time = 0.1 * np.arange(5)
    pulled = 0.002 * np.array([1.0, 0.5, 0.0, -0.5, -1.0])
    inputs = robot.inputs(displacement=np.stack([pulled, -pulled], axis=-1), pressure=1e4)
    return mr.simulate(robot, inputs, time=time, solver=SOLVER)


def test_lines_are_drawn_where_they_are_in_the_colour_of_their_tension(lined_history, tmp_path):
    save(tmp_path / "run.rrd", lined_history, nodes=21)
    recording, history = Recording(tmp_path / "run.rrd"), lined_history
    np.testing.assert_array_equal(recording.scalars("/lines/tension"), history.tension)
    np.testing.assert_array_equal(recording.scalars("/lines/length_mm"), 1e3 * history.line_length)
    (right,) = [path for path in recording.paths if path.startswith("/world/lines/") and path.endswith("right")]
    (chamber,) = [path for path in recording.paths if path.startswith("/world/lines/") and path.endswith("chamber")]
    strips = np.array(recording.column(right, "LineStrips3D:strips"))
    np.testing.assert_allclose(strips[:, :, 0], history.line("right", nodes=21).position[:, :-1], atol=1e-7)
    (partial,) = [path for path in recording.paths if path.startswith("/world/lines/") and path not in (right, chamber)]
    assert len(recording.column(partial, "LineStrips3D:strips")[0]) == 10  # as far as it reaches
    starts = np.array(recording.column(chamber, "Capsules3D:translations"))
    np.testing.assert_allclose(starts, history.line("chamber", nodes=21).position[:, :-1], atol=1e-7)
    np.testing.assert_allclose(recording.column(chamber, "Capsules3D:radii"), np.sqrt(2e-5 / np.pi))
    # the rod is drawn so thin that it hides no line
    offsets = [np.linalg.norm(line.offset_at(np.zeros((1, 1)), (), None)) for line in history.assembly.rods[0].lines]
    drawn = np.concatenate(recording.column("/world/rods/rod_0", "Capsules3D:radii"))
    assert (drawn < min(offsets)).all()
    colors = np.array(recording.column(right, "LineStrips3D:colors"))[:, 0]
    red, blue = colors >> 24 & 0xFF, colors >> 8 & 0xFF
    pulls = history.tension[:, 0] > 0
    assert pulls.any()
    assert not pulls.all()
    np.testing.assert_array_equal(history.slack[:, 0], ~pulls)
    assert (red[pulls] > blue[pulls]).all()
    assert np.unique(colors[~pulls]).size == 1


def test_discs_are_drawn_around_the_rod(lined_history, tmp_path):
    save(tmp_path / "run.rrd", lined_history, nodes=21)
    recording, shape = Recording(tmp_path / "run.rrd"), lined_history.rod(0, nodes=5)
    (path,) = [path for path in recording.paths if path.startswith("/world/discs/")]
    rims = np.array(recording.column(path, "LineStrips3D:strips"))
    assert rims.shape[:2] == (5, 5)  # at every 50 mm of 200
    np.testing.assert_allclose(rims[:, :, :-1].mean(axis=2), shape.position, atol=1e-6)
    np.testing.assert_allclose(np.linalg.norm(rims - shape.position[:, :, None], axis=-1), 1.25 * 0.008, rtol=1e-3)
    across = np.einsum("tdki,tdi->tdk", rims - shape.position[:, :, None], shape.rotation[..., 2])
    np.testing.assert_allclose(across, 0, atol=2e-6)


def test_failed_samples_have_no_lines(tmp_path):
    robot = mr.SingleRod(
        mr.Rod(length=0.2, bending_stiffness=0.02, torsional_stiffness=0.015, lines=[mr.Tendon(offset=(0.01, 0))])
    )
    # the second bends the rod until the line would have no length: T r^2 > EI
    history = mr.simulate(robot, robot.inputs(tension=[[1.0], [250.0], [1.0]]), time=0.1 * np.arange(3))
    assert [mr.Status(int(status)).failed for status in history.status] == [False, True, False]
    save(tmp_path / "run.rrd", history, nodes=11)
    recording = Recording(tmp_path / "run.rrd")
    (path,) = [path for path in recording.paths if path.startswith("/world/lines/")]
    assert [len(strips) for strips in recording.column(path, "LineStrips3D:strips")] == [10, 0, 10]
    assert np.isnan(recording.scalars("/lines/tension")[1]).all()


def test_view_and_arrows_fit_what_comes_after_the_first_sample(tmp_path):
    """The first sample is hardly loaded; what follows is longer and loaded ever more."""
    robot = make_robot()
    tracker = mr.Tracker(robot, solver=SOLVER, dt=0.02, inputs=robot.inputs(tip_force=(0, 0, 0.01), translation=0.0))
    forces = 0.4 * np.arange(30)[:, None] * [0.5, 0.3, 1]
    with Recorder(tmp_path / "run.rrd", flush_every=5) as recorder:
        solutions = []
        for k, force in enumerate(forces):
            solutions.append(tracker.step(tip_force=force, translation=0.02 * k).raise_if_failed())
            recorder.log(0.02 * k, solutions[-1])
        recorder.flush()
        stage = recorder._recording._target._writer.stage
        frame = Frame.between(stage.centre, stage.eye)
        for solution, force in zip(solutions, forces, strict=True):
            tip = solution.tip_position
            assert frame.shows(solution.rod(0).position)
            assert frame.shows(np.array([tip + stage.force_scale * force, *(tip + 0.1 * stage.size * solution.tip_rotation.T)]))
        longest = np.linalg.norm(forces, axis=1).max() * stage.force_scale
        assert 0.15 * 0.4 < longest < 0.31 * 0.4  # three tenths of the length at the start at most, and no less than half of that
    recording = Recording(tmp_path / "run.rrd")
    vectors, _ = arrows_of(recording, "tip_force")
    scale = recording.column("/world/loads/tip_force", "InstancePoses3D:scales", static=True)[-1][0][0]
    np.testing.assert_allclose(vectors, scale * forces[np.abs(forces).max(axis=1) > 0], rtol=1e-6, atol=1e-8)
    legend = recording.column("/legend", "TextDocument:text", static=True)[-1][0]
    assert f"1 N is {1e3 * scale:.4g} mm" in legend


def test_a_frame_shows_its_points_and_no_more_than_it_must():
    points = np.random.default_rng(5).normal(size=(50, 3)) * [1, 2, 0.5] + [3, 0, 1]
    frame = Frame(points)
    assert frame.shows(points)
    assert not frame.shows(frame.centre + 1.3 * (points - frame.centre))
    few = Extent(points).points
    assert len(few) < len(points) or len(few) == 50
    np.testing.assert_allclose(Frame(few).eye, frame.eye, atol=0.1)  # of 96 directions, not all
    assert frame.widened(3 * points).shows(3 * points)


def test_precurvature_is_drawn_as_steps(tmp_path):
    s = np.linspace(0, 1, 11)[None]
    values = np.where(s <= 0.31, 1.0, 3.0)[..., None] + s[..., None]
    x, y = stepped(s, values, np.array([[0.31, 1.5, -0.5]]))
    at = np.flatnonzero(x[0] == 0.31)
    np.testing.assert_allclose(y[0, at, 0], [1.31, 3.31])
    assert (np.diff(x) >= 0).all()
    x, y = stepped(s, np.where(s < 0.35, 1.0, 3.0)[..., None], np.array([[0.3]]))  # on a node, which has what was before
    np.testing.assert_array_equal(y[0, np.flatnonzero(np.isclose(x[0], 0.3)), 0], [1, 1, 3])

    sections = [(0.25, (0, 0, 0)), (0.15, (14, 5, 0))]
    robot = mr.SingleRod(mr.Rod(length=0.4, bending_stiffness=0.2233, torsional_stiffness=0.0638, precurvature=sections))
    save(tmp_path / "run.rrd", make_history(3, robot=robot))
    recording = Recording(tmp_path / "run.rrd")
    for row, shift in zip(recording.column("/curvature/rod_0", "LineStrips2D:strips"), 0.01 * 0.02 * np.arange(3), strict=True):
        x, y = np.array(row)[0].T
        jump = np.argmax(np.abs(np.diff(y)))
        assert x[jump] == x[jump + 1]
        np.testing.assert_allclose(x[jump] / x[-1], (0.25 + shift) / (0.4 + shift), rtol=1e-5)  # single precision


def test_moment_force_and_strain_along_the_arclength(tmp_path):
    robot = make_robot(outer_diameter=3e-3)
    history = make_history(3, robot=robot)
    save(tmp_path / "run.rrd", history, nodes=11)
    recording, shape = Recording(tmp_path / "run.rrd"), history.rod(0, nodes=11)
    strain = 100 * 1.5e-3 * np.linalg.norm(shape.moment[..., :2], axis=-1, keepdims=True) / 0.2233
    for name, values in (("moment", shape.moment), ("force", shape.force), ("strain", strain)):
        drawn = np.array(recording.column(f"/{name}/rod_0", "LineStrips2D:strips"))[..., 1]
        ((top, *_),) = [row for row in recording.column(f"/{name}/axes/labels", "Points2D:labels") if row]
        height = 0.5 - drawn if name == "strain" else -2 * drawn
        np.testing.assert_allclose(np.moveaxis(height, 1, 2) * float(top), values, atol=1e-6 * float(top), err_msg=name)


def test_last_shape_and_the_status_in_words_where_samples_failed(broken, tmp_path):
    broken.save(tmp_path / "run.rrd", nodes=11)
    recording = Recording(tmp_path / "run.rrd")
    np.testing.assert_array_equal(recording.index("/world/failed/rods/rod_0", "step"), [10, 15])
    (during, after) = recording.column("/world/failed/rods/rod_0", "LineStrips3D:strips")
    np.testing.assert_allclose(during[0], broken.rod(0, nodes=11).position[9], atol=1e-7)
    assert not after
    labels = recording.column("/world/failed/status", "Points3D:labels")
    status = mr.Status(int(broken.status[10]))
    assert [label.replace("\n", " ") for label in labels[0]] == [f"{status.name} {status.message}"]
    assert not labels[1]


def test_where_a_robot_buckled_the_shape_before_and_the_status_in_words(tmp_path):
    column = mr.SingleRod(mr.Rod(length=0.5, bending_stiffness=(0.04, 0.02), torsional_stiffness=0.015))
    force = np.zeros((4, 3))
    force[:, 2] = -(np.pi**2) / 4 * 0.02 / 0.5**2 * np.array([0.5, 0.9, 1.3, 1.4])
    pushed = mr.simulate(column, column.inputs(tip_force=force), time=np.arange(4), solver=mr.Shooting(integrator=mr.RK4(50)))
    assert pushed.status.tolist() == [1, 1, mr.Status.BIFURCATED, 1]
    pushed.save(tmp_path / "run.rrd", nodes=11)
    recording = Recording(tmp_path / "run.rrd")
    np.testing.assert_array_equal(recording.index("/world/failed/rods/rod_0", "step"), [2, 3])
    (during, after) = recording.column("/world/failed/rods/rod_0", "LineStrips3D:strips")
    np.testing.assert_allclose(during[0], pushed.rod(0, nodes=11).position[1], atol=1e-7)
    assert not after
    labels = recording.column("/world/failed/status", "Points3D:labels")
    assert labels[0][0].startswith("BIFURCATED\n")
    assert not labels[1]


@pytest.mark.parametrize("name", ["LOWEST_ENERGY", "DAMPED"])
def test_where_a_robot_came_to_a_state_in_other_ways_that_are_no_plain_convergence_it_says_so_too(name, tmp_path):
    if name == "DAMPED":
        solver = mr.EnergyDescent(integrator=mr.RK4(50))
        robot = mr.SingleRod(mr.Rod(length=0.4, bending_stiffness=0.2233, torsional_stiffness=0.0638, precurvature=(14, 5, 0)))
        rest = mr.solve(robot, robot.inputs())
        found = mr.solve(robot, robot.inputs(follower_force=(1.0, 0.5, -2)), solver=solver, guess=rest)
    else:
        tubes = [
            mr.Rod(length=length, bending_stiffness=0.02, torsional_stiffness=0.015, precurvature=(curvature, 0, 0))
            for length, curvature in ((0.3, 9), (0.25, 8))
        ]
        robot = mr.ConcentricTubes(tubes)
        rest, found = (mr.solve(robot, robot.inputs(rotation=(0, angle))) for angle in (0.5, 5))
    assert rest.status == mr.Status.CONVERGED
    assert found.status == mr.Status[name]
    with mr.Recorder(tmp_path / "run.rrd", nodes=11) as recorder:
        for k, solution in enumerate((rest, found, rest)):
            recorder.log(0.1 * k, solution)
    recording = Recording(tmp_path / "run.rrd")
    labels = recording.column("/world/failed/status", "Points3D:labels")
    assert labels[0][0].startswith(f"{name}\n")
    assert not labels[1]
    (during, after) = recording.column("/world/failed/rods/rod_0", "LineStrips3D:strips")
    np.testing.assert_allclose(during[0], rest.rod(0, nodes=11).position, atol=1e-7)  # the viewer's single precision
    assert not after


def test_two_robots_are_overlaid(history, tmp_path):
    stiffer = mr.SingleRod(mr.Rod(length=0.4, bending_stiffness=0.4, torsional_stiffness=0.0638, name="stiff"))
    other = make_history(robot=stiffer)
    save(tmp_path / "run.rrd", history, reference=other, reference_name="a stiffer rod", nodes=11)
    recording = Recording(tmp_path / "run.rrd")
    assert "/world/reference/rods/stiff" in recording.paths
    ((legend,),) = recording.column("/legend", "TextDocument:text", static=True)
    assert "grey: a stiffer rod" in legend
    apart = 1e3 * np.linalg.norm(history.rod(0, nodes=11).position - other.rod(0, nodes=11).position, axis=-1)
    drawn = np.array(recording.column("/difference/rod_0", "LineStrips2D:strips"))[:, 0, :, 1]
    ((top, *_),) = [row for row in recording.column("/difference/axes/labels", "Points2D:labels") if row]
    np.testing.assert_allclose((0.5 - drawn) * float(top), apart, atol=1e-5 * float(top))


def test_instances_are_coloured_by_a_quantity(tmp_path):
    robot = make_robot()
    inputs = robot.inputs(tip_force=np.linspace(0, 0.2, 3)[:, None] * [0, 1, 0])
    time = 0.02 * np.arange(4)
    moving = robot.inputs(rotation=0.1 * time[:, None, None] + np.zeros((4, 3, 1)), tip_force=inputs.tip_force)
    history = mr.simulate(robot, moving, time=time, solver=SOLVER)
    values = np.array([[0.0, 1.0, np.nan]])
    save(tmp_path / "run.rrd", history, colour_by=values)
    recording = Recording(tmp_path / "run.rrd")
    colors = [recording.column(f"/world/instance_{k}/rods/rod_0", "Capsules3D:colors") for k in range(3)]
    assert [set(map(tuple, color)) for color in colors] == [{(0x4F83F1FF,)}, {(0xE8503AFF,)}, {(0x868E96FF,)}]
    save(tmp_path / "run.rrd", history, colour_by="energy")
    ((legend,),) = Recording(tmp_path / "run.rrd").column("/legend", "TextDocument:text", static=True)
    assert f"energy: blue, teal, yellow, red from {history.energy.min():.3g} to {history.energy.max():.3g}" in legend
    for by, message in (("mass", "must be one of residual"), (np.zeros(5), r"must broadcast to the leading axes \(4, 3\)")):
        with pytest.raises(ValueError, match=rf"save\.colour_by = .* is not allowed: {message}"):
            save(tmp_path / "run.rrd", history, colour_by=by)


def test_names_and_colours_are_in_the_scene_and_the_table(tripod_history, tmp_path):
    tripod_history.save(tmp_path / "run.rrd")
    recording = Recording(tmp_path / "run.rrd")
    for path, name in zip(TRIPOD_RODS, ["leg_1 inner", "leg_1 rod_1", "leg_1 outer", "leg_2", "strut"], strict=True):
        assert recording.column(f"/world/names/{path}", "Points3D:labels", static=True) == [[name]]
        color = recording.column(f"/world/names/{path}", "Points3D:colors", static=True)
        assert color == recording.column(f"/world/rods/{path}", "Capsules3D:colors", static=True)
    ((text,),) = recording.column("/description", "TextDocument:text", static=True)
    assert "| leg | colour |" in text
    assert "| leg_2, strut | orange, green | 0.2 |" in text


def test_decades_are_numbered():
    assert layout.decades(-11.2, -9.7) == (-12, -9)
    assert layout.decades(-16.0, -3.5) == (-20, 0)
    assert layout.decades(-300.0, 2.5) == (-20, 10)
    low, high = layout.decades(0.1, 0.2)
    assert high - low >= 2


@pytest.mark.skipif(not Path("/proc/self/task").exists(), reason="this system does not list a process's threads")
def test_recordings_that_are_written_leave_no_threads(wire: mr.Rod, tmp_path: Path) -> None:
    """Rerun keeps four of a recording and its blueprint until it is told not to."""
    robot = mr.SingleRod(wire)
    history = mr.simulate(robot, robot.inputs(rotation=[0.0, 0.1]), time=[0.0, 0.1], solver=SOLVER, progress=False)
    for k in range(12):
        history.save(tmp_path / f"{k}.rrd")
        if k == 1:
            few = count_threads()
    patience = time.monotonic() + 60
    while count_threads() > few + 4 and time.monotonic() < patience:  # they take their time to end
        time.sleep(0.1)
    assert count_threads() <= few + 4  # four of each would be 40 more


def count_threads() -> int:
    return len(list(Path("/proc/self/task").iterdir()))


@pytest.fixture(scope="module")
def controlled():
    """Tubes that follow a target, with a force whose covariance is told, as a task that estimates it does."""
    tubes, motion = three_tubes()
    start = mr.solve(tubes, motion[10], solver=mr.Shooting(integrator=mr.RK4(30)))
    limits = mr.Limits(translation=(-0.19, 0), gap=2e-3)
    options = {"free": ("rotation", "translation"), "limits": limits, "guess": start, "integrator": mr.RK4(30)}
    loop = mr.Controller(tubes, dt=0.01, **options)
    path = start.tip_position + 1e-4 * np.arange(6)[:, None] * [1, 0, 0]
    commands = [loop.step(position=y) for y in path]
    for k, command in enumerate(commands):
        covariance = np.diag([1e-6, 4e-6, 9e-6]) * (k + 1)
        command._remarks = replace(command._remarks, covariances={"tip_force": covariance})
    return tubes, path, commands


def test_a_controlled_run_shows_target_error_limits_and_how_sure_its_force_is(controlled, tmp_path):
    _, path, commands = controlled
    with Recorder(tmp_path / "run.rrd", flush_every=4) as recorder:
        for k, command in enumerate(commands):
            recorder.log(0.01 * k, command)
    recording = Recording(tmp_path / "run.rrd")
    targets = recording.column("/world/target", "Points3D:positions")
    np.testing.assert_allclose(np.array(targets)[:, 0], path, atol=1e-7)  # geometry is single precision
    errors = [1e3 * command.target_error for command in commands]
    np.testing.assert_array_equal(recording.scalars("/task/target_error_mm")[:, 0], errors)
    bases = np.array([command.inputs.translation for command in commands])
    shares = recording.scalars("/task/limits")
    np.testing.assert_allclose(shares[:, :3], bases / 0.19 + 1, atol=1e-12)
    # each tube is 0.1 m shorter than the one inside
    np.testing.assert_allclose(shares[:, 3:], (np.diff(bases, axis=1) - 2e-3) / (0.1 - 4e-3), atol=1e-12)
    (names,) = recording.column("/task/limits", "SeriesLines:names", static=True)
    assert names[0] == "translation[0]"
    assert names[3] == "translation[1] - translation[0]"
    half = np.array(recording.column("/world/loads/tip_force/spread", "Ellipsoids3D:half_sizes"))[:, 0]
    np.testing.assert_allclose(half, 2.795e-3 * np.sqrt(np.arange(1, 7))[:, None] * [1, 2, 3], rtol=1e-6)
    centres = np.array(recording.column("/world/loads/tip_force/spread", "Ellipsoids3D:centers"))[:, 0]
    np.testing.assert_allclose(centres, np.tile(commands[0].inputs.tip_force, (6, 1)), rtol=1e-6)


def test_what_a_task_says_goes_to_the_process_that_writes(controlled):
    tubes, _, commands = controlled
    packer, unpacker = Packer(4), Unpacker()
    for k, command in enumerate([*commands, mr.solve(tubes, commands[0].inputs, guess=commands[0])]):
        (sample,) = unpacker.samples(packer.pack(Sample(k, 0.01 * k, command, np.nan, None, 1)))
        if k < 6:
            np.testing.assert_array_equal(sample.solution._remarks.target, command._remarks.target)
            np.testing.assert_array_equal(sample.solution._remarks.limits, command._remarks.limits)
            assert sample.solution._remarks.target_error == command.target_error
    assert sample.solution._remarks is None


def test_ellipsoids_hold_as_much_of_a_force_as_they_say():
    random = np.random.default_rng(2)
    root = random.normal(size=(3, 3))
    (half,), (turn,) = columns.ellipsoids((root @ root.T)[None])
    drawn = random.normal(size=(20000, 3)) @ root.T
    axes = Rotation.from_quat(turn).as_matrix()
    inside = (((drawn @ axes) / half) ** 2).sum(axis=1) <= 1
    assert abs(inside.mean() - 0.95) < 0.006  # four deviations of the share


@pytest.mark.parametrize("side", [-1, 1])
def test_a_node_where_values_jump_is_drawn_on_one_side_whichever_it_was_of(side: int) -> None:
    s = np.linspace(0, 1, 11)[None]
    values = np.where(s < 0.5 - 1e-9 * side, 1 + s, 3 - s)[..., None]
    every, heights = stepped(s, values, np.array([[0.5, 1.0]]))
    inside = every[0] < 1
    expected = [*(1 + s[0, :6]), 1.5, 2.5, *(3 - s[0, 6:10])]
    np.testing.assert_allclose(heights[0, inside, 0], expected, atol=1e-12)
