"""The first call: kernels are compiled several at a time, it is said once, ``compile`` does it before, no more is printed."""

import os
import re
import threading
import uuid
from pathlib import Path

import numpy as np
import programs
import pytest
import warp as wp

import multirod as mr
from multirod.batch import thread_count
from multirod.cli import main
from multirod.kernels import compiling
from multirod.kernels.compiling import COMPILER, Compiler, cache
from multirod.kernels.index import INDEX
from multirod.kernels.own_module import own_module
from multirod.launch import LONGEST, Direct, Pending, expect, record
from multirod.models.assemblies import single_rod
from multirod.studies.scenes import SCENES, load

LINE = r"multirod: compiling kernels for this scene \(several, some seconds each, once; kept in .*\)\n"
# distinct kernels: to be lowered, never raised without a reason. One of tubes bounds how many modes can be unstable: it takes a
# fifteenth as long to compile as the rest, and a quarter off each solve. One that all robots but graphs and legs share eliminates
# unknowns from Jacobians: compiled at once with the integration, and a quarter to a third off each of them
BUDGET = {"paper": 4, "three-tubes": 8, "three-tubes, loaded": 6, "six-legs": 5}

# not optimised, kernels are compiled in half of the time
QUICKLY = "import warp; warp.config.optimization_level = 0\n"
SCENE = """
import multirod as mr
from multirod.kernels.compiling import COMPILER
robot = mr.SingleRod(mr.Rod(length=0.4, bending_stiffness=0.2233, torsional_stiffness=0.0638, precurvature=(14, 5, 0)))
inputs = robot.inputs(rotation=0.1, tip_force=(1, 0, 0))
"""


def program(text: str, folder: Path, **variables: str):
    """What a program came to whose kernels are kept in a folder."""
    return programs.run("-c", text, env={**os.environ, "WARP_CACHE_PATH": str(folder), **variables})


def make_kernel(value: float | None = None):
    """A kernel that no cache has: it adds a number of its own."""
    number = uuid.uuid4().int / 2**128 if value is None else value

    @own_module()
    def add(values: wp.array[wp.float64]):
        t = wp.tid()
        values[t] = values[t] + wp.static(wp.float64(number))

    return add, number


# ---- what is printed ----


def test_later_calls_say_so_where_they_take_long(monkeypatch, capsys) -> None:
    """One line for what is compiled together; nothing of what is soon done."""
    own, gate = Compiler(), threading.Event()
    monkeypatch.setattr(compiling, "_load", lambda module, device: gate.wait(60))
    monkeypatch.setattr(compiling, "APART", -1.0)

    def said(patience: float) -> str:
        monkeypatch.setattr(compiling, "PATIENCE", patience)
        asked = [own.request(make_kernel()[0].module, wp.get_device("cpu")) for _ in range(2)]
        if patience:
            gate.set()
        else:
            threading.Timer(0.3, gate.set).start()
        for future in asked:
            own.wait(future)
        gate.clear()
        return capsys.readouterr().err

    assert re.fullmatch(LINE, said(60.0))
    assert said(60.0) == ""
    assert said(0.0) == "multirod: compiling more kernels (some seconds each, once)\n"
    assert said(60.0) == ""


def test_a_cache_that_cannot_be_is_named(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    done = program(SCENE + "mr.solve(robot, inputs)", tmp_path / "file" / "cache")
    last = done.stderr.splitlines()[-1]
    assert re.fullmatch(r".*CompileError: kernels cannot be kept: .*cache.*; WARP_CACHE_PATH names another folder", last)


def test_the_first_call_says_so_in_one_line_and_later_ones_nothing(tmp_path: Path) -> None:
    text = QUICKLY + SCENE + "assert mr.solve(robot, inputs).status.name == 'CONVERGED'; mr.solve(robot).rod(0)"
    first = program(text, tmp_path)
    assert first.returncode == 0, first.stderr
    assert first.stdout == ""
    assert re.fullmatch(LINE, first.stderr)
    assert str(tmp_path / wp.config.version) in first.stderr
    later = program(text, tmp_path)
    assert (later.returncode, later.stdout, later.stderr) == (0, "", "")


LEVEL = "import multirod.kernels.compiling, warp; print(warp.config.log_level)"


@pytest.mark.parametrize(
    ("text", "variables", "level"),
    [
        (LEVEL, {}, wp.LOG_WARNING),
        ("import warp; warp.config.log_level = warp.LOG_DEBUG; " + LEVEL, {}, wp.LOG_DEBUG),
        ("import warp; warp.config.log_level = warp.LOG_ERROR; " + LEVEL, {}, wp.LOG_ERROR),
        ("import warp; warp.config.verbose = True; " + LEVEL, {}, wp.LOG_INFO),
        ("import multirod.kernels.compiling, warp; warp.config.log_level = warp.LOG_INFO; " + LEVEL, {}, wp.LOG_INFO),
        (LEVEL, {"MULTIROD_WARP_LOG": "info"}, wp.LOG_INFO),
    ],
)
def test_a_level_that_was_chosen_for_warps_log_is_left(text, variables, level, tmp_path: Path) -> None:
    assert program(text, tmp_path, **variables).stdout == f"{level}\n"


def test_warps_log_is_there_for_those_who_ask(tmp_path: Path) -> None:
    done = program("import multirod.kernels.compiling as c; c.start_warp()", tmp_path, MULTIROD_WARP_LOG="INFO")
    assert done.stdout.startswith(f"Warp {wp.config.version} initialized")
    wrong = program("import multirod.kernels.compiling", tmp_path, MULTIROD_WARP_LOG="loud")
    assert "MULTIROD_WARP_LOG = 'loud' is not allowed: must be one of debug, info, warning, error" in wrong.stderr


def test_only_the_note_on_the_driver_is_kept_from_the_error_stream(tmp_path: Path) -> None:
    text = """
import os, sys
import multirod.kernels.compiling as c
with c._without_driver_note():
    os.write(2, b"Warp CUDA warning: Could not find or load the NVIDIA CUDA driver. GPU execution will not be available.\\n")
    os.write(2, b"kept\\n")
    print("kept too", file=sys.stderr)
print("after", file=sys.stderr)
"""
    assert program(text, tmp_path).stderr == "kept\nkept too\nafter\n"


# ---- what a process takes before its first solve ----


def test_what_a_kernel_calls_is_hashed_once(monkeypatch: pytest.MonkeyPatch) -> None:
    hashed = []
    hasher = wp._src.context.ModuleHasher
    begin = hasher.__init__

    def counted(self, kernels, options):
        hashed.append(kernels)
        begin(self, kernels, options)

    monkeypatch.setattr(hasher, "__init__", counted)
    values = wp.zeros(3, dtype=wp.float64, device="cpu")
    kernel, number = make_kernel()
    record(lambda: kernel, 3, [values], "cpu").launch()
    assert values.numpy() == pytest.approx(number)
    assert hashed.count([kernel]) == 1


def test_every_kernel_of_its_own_module_is_made_so() -> None:
    folder = Path(__file__).parent.parent
    files = [file for top in ("multirod", "models", "solvers") for file in (folder / top).rglob("*.py")]
    assert [file.name for file in files if 'module="unique"' in file.read_text()] == ["own_module.py"]


def test_modules_are_loaded_without_looking_for_garbage(tmp_path: Path) -> None:
    text = """
import gc, multirod as mr
gc.collect()
looks = []
gc.callbacks.append(lambda phase, info: looks.append(info["generation"]) if phase == "start" else None)
mr.SingleRod, mr.solve
assert gc.isenabled()
before = list(looks)
gc.disable()
mr.Observer, mr.sweep
assert not gc.isenabled()
print(len(before), before.count(2))
"""
    done = program(text, tmp_path)
    assert done.returncode == 0, done.stderr
    often, all_of_it = map(int, done.stdout.split())
    assert often <= 10  # beside what follows each name
    assert all_of_it <= 1


# ---- in the background ----


def test_kernels_are_compiled_at_the_same_time(monkeypatch: pytest.MonkeyPatch) -> None:
    if thread_count(None) < 2:
        pytest.skip("one core compiles one kernel at a time")
    together = threading.Barrier(2)
    build = wp._src.build.build_cpu
    values = wp.zeros(3, dtype=wp.float64, device="cpu")
    record(lambda: make_kernel()[0], 3, [values], "cpu").launch()  # the headers are precompiled by one alone
    values.zero_()

    def meet(*arguments, **options):
        together.wait(timeout=programs.GUARD)
        return build(*arguments, **options)

    monkeypatch.setattr("warp._src.build.build_cpu", meet)
    made = [make_kernel() for _ in range(2)]
    launches = [record(lambda kernel=kernel: kernel, 3, [values], "cpu") for kernel, _ in made]
    assert all(isinstance(launch, Pending) for launch in launches)
    for launch in launches:
        launch.launch()
    np.testing.assert_array_equal(values.numpy(), made[0][1] + made[1][1])
    launches[0].set_dim(1)
    launches[0].launch()
    np.testing.assert_array_equal(values.numpy()[1:], made[0][1] + made[1][1])
    assert values.numpy()[0] > values.numpy()[1]
    # what is there is recorded at once, with its arguments ready
    assert isinstance(record(lambda: made[0][0], 3, [values], "cpu"), Direct)


def test_a_kernel_is_compiled_once_however_many_threads_ask() -> None:
    kernel, number = make_kernel()
    before = COMPILER.compiled
    expect(lambda: kernel, "cpu")
    values = wp.zeros(8, dtype=wp.float64, device="cpu")
    launches = [record(lambda: kernel, 8, [values], "cpu") for _ in range(4)]
    threads = [threading.Thread(target=launch.set_dim, args=(8,)) for launch in launches]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    for launch in launches:
        launch.launch()
    np.testing.assert_allclose(values.numpy(), 4 * number)
    assert COMPILER.compiled == before + 1


def test_what_is_waited_for_in_portions(monkeypatch: pytest.MonkeyPatch) -> None:
    """A large batch of a scene that is new: its launch is cut into portions before it is compiled."""
    monkeypatch.setattr(COMPILER, "_known", {})
    monkeypatch.setattr(INDEX, "find", lambda maker: (None, None))
    monkeypatch.setattr("multirod.kernels.compiling.kept", lambda module, device: None)
    wire = mr.Rod(length=0.4, bending_stiffness=0.2233, torsional_stiffness=0.0638, precurvature=(14, 5, 0))
    robot = mr.SingleRod(wire)
    force = np.zeros((LONGEST + 5, 3))
    force[:, 0] = np.linspace(0, 1, len(force))
    problem = robot.problem(robot.inputs(tip_force=force), integrator=mr.RK4(10))
    assert len(problem.launch._orders) == 2
    assert isinstance(problem.launch._launch, Pending)
    residual, _ = problem.evaluate(np.zeros((len(force), problem.unknown_count)))
    alone = robot.problem(robot.inputs(tip_force=force[-1]), integrator=mr.RK4(10))
    np.testing.assert_array_equal(residual[-1], alone.evaluate(np.zeros((1, alone.unknown_count)))[0][0])


def test_a_compile_that_fails_says_so(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    def fail(*arguments, **options):
        raise OSError("no space left on device")

    monkeypatch.setattr("warp._src.build.build_cpu", fail)
    kernel, _ = make_kernel()
    values = wp.zeros(3, dtype=wp.float64, device="cpu")
    for _ in range(2):
        launch = record(lambda: kernel, 3, [values], "cpu")
        with pytest.raises(
            mr.CompileError, match=rf"the kernel .*add.* could not be compiled into {re.escape(cache())}: no space"
        ):
            launch.launch()

    monkeypatch.setattr(single_rod.SingleRod, "problem", lambda *a, **o: record(lambda: kernel, 3, [values], "cpu").launch())
    assert main(["prepare", "paper"]) == 1
    assert "could not be compiled into" in " ".join(capsys.readouterr().out.split())


# ---- before it is needed ----


def test_after_compile_nothing_is_compiled(tmp_path: Path) -> None:
    text = (
        QUICKLY
        + SCENE
        + """
done = []
count = robot.compile(inputs, jacobian="tip_force", stability=True, motion=True, progress=done.append)
assert count == COMPILER.compiled == max(done) > 2, (count, COMPILER.compiled, done)
solution = mr.solve(robot, inputs)
solution.rod(0), solution.energy, solution.jacobian("tip_force"), solution.stability
tracker = mr.Tracker(robot, dt=0.005, inputs=inputs)
for k in range(4):
    assert not tracker.step(tip_force=(1, 0.01 * k, 0)).status.failed
assert COMPILER.compiled == count, COMPILER.kernels
assert robot.compile(inputs, jacobian=["tip_force"], stability=True, motion=True) == 0
"""
    )
    done = program(text, tmp_path)
    assert done.returncode == 0, done.stderr
    assert done.stdout == ""
    assert re.fullmatch(LINE, done.stderr)


def test_two_processes_may_compile_the_same_scene_at_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("WARP_CACHE_PATH", str(tmp_path))
    text = QUICKLY + SCENE + "robot.compile(inputs); print(mr.solve(robot, inputs).tip_position.tolist())"
    with programs.started("-c", text) as one, programs.started("-c", text) as other:
        (first, said), (second, _) = (process.communicate(timeout=programs.GUARD) for process in (one, other))
    assert (one.returncode, other.returncode) == (0, 0), said
    assert first == second != ""
    # nothing half made is left
    folders = [path.name for path in (tmp_path / wp.config.version).iterdir()]
    assert not [name for name in folders if re.search(r"_p\d+_t\d+$", name)]


def test_headers_are_precompiled_for_each_setting_of_the_compiler_once(tmp_path: Path) -> None:
    text = """
import warp
from pathlib import Path
import multirod as mr
robot = mr.SingleRod(mr.Rod(length=0.4, bending_stiffness=0.2233, torsional_stiffness=0.0638))
for level, load in enumerate(("tip_force", "follower_force")):
    warp.config.optimization_level = level
    assert not mr.solve(robot, robot.inputs(**{load: (1, 0, 0)})).status.failed
for folder in Path(warp.config.kernel_cache_dir).glob("multirod_headers_*"):
    print(len(list(folder.glob("*.pch"))))
"""
    done = program(text, tmp_path)
    assert done.returncode == 0, done.stderr
    assert done.stdout == "1\n1\n"  # what is in a folder is complete


def test_compile_of_a_batch_takes_its_first_instances(wire: mr.Rod) -> None:
    robot = mr.SingleRod(wire)
    force = np.linspace(0, 1, 30000)[:, None] * [1, 0, 0]
    robot.compile(robot.inputs(tip_force=force))
    before = COMPILER.compiled
    assert not mr.solve(robot, robot.inputs(tip_force=force[::10])).status.any() - 1
    assert COMPILER.compiled == before
    assert robot.compile(robot.inputs(tip_force=force[:0])) == 0


def test_compile_takes_other_solvers_and_robots() -> None:
    motion = load("six-legs").first(5)
    solver = mr.Observer(integrator=mr.RK4(10))
    motion.robot.compile(motion.inputs, solver=solver, motion=True, jacobian=("tip_force", "force_point"))
    before = COMPILER.compiled
    history = mr.simulate(motion.robot, motion.inputs, time=motion.time, solver=solver)
    history.rod(0), history.jacobian("tip_force"), history.jacobian("force_point")
    assert COMPILER.compiled == before


@pytest.mark.parametrize(
    ("options", "error", "message"),
    [
        ({"solver": "newton"}, TypeError, "solver must be a Solver such as Shooting\\(\\), not str"),
        ({"inputs": 3}, TypeError, "inputs must be made by robot.inputs"),
        ({"jacobian": "tip_mass"}, TypeError, "compile\\(jacobian\\) takes no 'tip_mass': it takes rotation"),
        ({"stability": 1}, ValueError, "compile\\(stability\\) = 1 is not allowed"),
        ({"device": "gpu"}, ValueError, "compile\\(device\\) = 'gpu' is not allowed"),
        ({"progress": 3}, ValueError, "progress = 3 is not allowed"),
    ],
)
def test_compile_refuses(options, error, message, wire: mr.Rod) -> None:
    with pytest.raises(error, match=message):
        mr.SingleRod(wire).compile(**options)


def test_prepare_says_what_it_did(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "own_prepared.py").write_text(
        "import multirod as mr\n"
        "def scene():\n"
        "    robot = mr.SingleRod(mr.Rod(length=0.4, bending_stiffness=0.2233, torsional_stiffness=0.0638))\n"
        "    return robot, robot.inputs(tip_force=[(1, 0, 0), (1, 0.1, 0)]), [0, 0.01]\n"
    )
    monkeypatch.chdir(tmp_path)
    assert main(["prepare", "own_prepared:scene", "paper"]) == 0
    assert main(["prepare", "own_prepared:scene", "paper"]) == 0
    printed = capsys.readouterr().out
    assert printed.splitlines()[-3:-1] == ["own_prepared:scene: nothing to compile", "paper: nothing to compile"]
    assert main(["prepare", "paper", "nothing"]) == 2
    assert "scene = 'nothing' is not allowed" in capsys.readouterr().out


# ---- how many ----


@pytest.mark.parametrize("scene", BUDGET)
def test_scenes_take_no_more_kernels_than_they_did(scene: str, tmp_path: Path) -> None:
    name, _, loaded = scene.partition(", ")
    assert name in SCENES
    text = f"""
import multirod as mr
from multirod.kernels.compiling import COMPILER
from multirod.studies.scenes import load
motion = load({name!r})
inputs = motion.inputs[0]
if {bool(loaded)}:
    inputs = motion.robot.inputs(rotation=inputs.rotation, translation=inputs.translation, tip_force=(0.1, 0, 0))
solution = mr.solve(motion.robot, inputs).raise_if_failed()
solution.rod(0), solution.jacobian("tip_force"), solution.stability
print(*sorted(COMPILER.kernels), sep="\\n")
"""
    done = programs.run("-c", text)
    assert done.returncode == 0, done.stderr
    kernels = done.stdout.split()
    assert 0 < len(kernels) <= BUDGET[scene], kernels


def test_one_kernel_tells_all_of_a_solution() -> None:
    """Whatever is asked of it, in whatever order: one integrates for the solver, one for those who ask."""
    tendon = mr.Tendon(offset=(0, 0.008), driven="displacement")
    rod = mr.Rod(length=0.2, bending_stiffness=0.01, torsional_stiffness=0.0077, lines=[tendon])
    wire, end = mr.Rod(length=0.4, bending_stiffness=0.2233, torsional_stiffness=0.0638), np.eye(4)
    end[:3, 3] = 0.05, 0, 0.37
    robots = (mr.SingleRod(rod), {"displacement": 0.001}, "displacement"), (mr.HeldRod(wire, end=end), {}, "end_position")
    for robot, inputs, name in robots:
        before = set(COMPILER.kernels)
        solution = mr.solve(robot, robot.inputs(**inputs)).raise_if_failed()
        solution.rod(0), solution.stability, solution.jacobian(name)
        taken = [kernel for kernel in COMPILER.kernels - before if "integrate" in kernel]
        assert len(taken) <= 2, taken
