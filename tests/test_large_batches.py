"""Batches in parts: on any number of threads, with instances that fail, stopped, and of 100,000."""

import signal
import sys
import time
from dataclasses import replace

import numpy as np
import programs
import pytest

import multirod as mr
from multirod import batch
from multirod.running import progress

RK4 = mr.RK4(40)
NEWTON = mr.Shooting(integrator=RK4)
PRECISE = mr.Shooting(integrator=mr.RK4(50))
ARRAYS = ("status", "unknowns", "tip_position", "tip_rotation", "residual", "iterations", "integrations", "gamma")


def single_rod(count: int) -> tuple[mr.Assembly, mr.Inputs]:
    """Rods and forces, each its own."""
    random = np.random.default_rng(count)
    curvature = random.uniform(-5, 5, (count, 3))
    rod = mr.Rod(length=0.4, bending_stiffness=random.uniform(0.1, 0.3, count), torsional_stiffness=0.06, precurvature=curvature)
    robot = mr.SingleRod(rod)
    return robot, robot.inputs(tip_force=random.uniform(-1, 1, (count, 3)), rotation=random.uniform(-1, 1, count))


def tubes(count: int) -> tuple[mr.Assembly, mr.Inputs]:
    random = np.random.default_rng(count)
    inner = mr.Rod(
        length=0.2, bending_stiffness=0.01, torsional_stiffness=0.008, precurvature=[(0.1, (0, 0, 0)), (0.1, (9, 0, 0))]
    )
    outer = mr.Rod(length=0.12, bending_stiffness=0.03, torsional_stiffness=0.025, precurvature=(5, 0, 0))
    robot = mr.ConcentricTubes([inner, outer])
    return robot, robot.inputs(rotation=random.uniform(-1, 1, (count, 2)), translation=(-0.05, -0.02), tip_force=(0.1, 0.05, 0))


def legs(count: int) -> tuple[mr.Assembly, mr.Inputs]:
    """Three legs whose bases are each instance's own."""
    random = np.random.default_rng(count)
    leg = mr.Rod(length=0.3, bending_stiffness=0.05, torsional_stiffness=0.04, precurvature=(1, 0, 0))
    base, platform = np.tile(np.eye(4), (count, 3, 1, 1)), np.tile(np.eye(4), (3, 1, 1))
    angle = 2 * np.pi * np.arange(3) / 3
    platform[:, :2, 3] = 0.04 * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    base[:, :, :2, 3] = 0.08 * np.stack([np.cos(angle), np.sin(angle)], axis=1) + random.uniform(-0.005, 0.005, (count, 3, 2))
    robot = mr.ParallelRods(legs=[leg] * 3, base=base, platform=platform)
    return robot, robot.inputs(tip_force=random.uniform(-0.2, 0.2, (count, 3)))


@pytest.fixture
def short_parts(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(batch, "SHORTEST_PART", 3)


@pytest.mark.parametrize("make", [single_rod, tubes, legs])
@pytest.mark.parametrize("solver", [NEWTON, mr.Observer(integrator=RK4, scaling="newton")], ids=["newton", "observer"])
@pytest.mark.usefixtures("short_parts")
def test_parts_and_threads_change_no_bit(make, solver):
    robot, inputs = make(40)
    whole = mr.solve(robot, inputs, solver=solver, threads=1)
    for threads in (2, 3):
        assert len(batch.parts(40, threads, robot.rod_count, "cpu")) > threads
        shared = mr.solve(robot, inputs, solver=solver, threads=threads)
        for name in ARRAYS:
            np.testing.assert_array_equal(getattr(shared, name), getattr(whole, name), err_msg=name)
        np.testing.assert_array_equal(shared.jacobian("tip_force"), whole.jacobian("tip_force"))
        np.testing.assert_array_equal(shared.rod(0).position, whole.rod(0).position)


@pytest.mark.parametrize("threads", [1, 2])
def test_the_few_that_buckle_in_several_parts_are_followed_at_once(threads, monkeypatch):
    """And each as it is alone, by its number in the batch or among the instances asked for."""
    finish, together = mr.Shooting._finish, []

    def counted(self, problem, left):
        together.append(left.numbers.tolist())
        return finish(self, problem, left)

    monkeypatch.setattr(mr.Shooting, "_finish", counted)
    robot = mr.SingleRod(mr.Rod(length=0.5, bending_stiffness=(0.04, 0.02), torsional_stiffness=0.015))
    critical = np.pi**2 / 4 * 0.02 / 0.5**2
    part = np.array([0.5, 1.3, -0.2, 0.8, 0.1, -0.4, 1.1, 0.3, 0.6, 0.2, 1.2, 0.7])
    inputs = robot.inputs(tip_force=-critical * part[:, None] * (0, 0, 1))
    whole = mr.solve(robot, inputs, solver=PRECISE, threads=1)
    assert not together
    np.testing.assert_array_equal(whole.status == mr.Status.BIFURCATED, part > 1)
    monkeypatch.setattr(batch, "SHORTEST_PART", 3)
    shared = mr.solve(robot, inputs, solver=PRECISE, threads=threads)
    some = np.array([6, 0, 2, 4, 3, 7, 8, 10])
    chosen = mr.solve(robot, inputs, solver=PRECISE, threads=threads, instances=some)
    assert together == [[1, 6, 10], [0, 7]]
    for solution, which in ((shared, slice(None)), (chosen, some)):
        for name in ARRAYS:
            np.testing.assert_array_equal(getattr(solution, name), getattr(whole, name)[which], err_msg=name)
        said = [[event.said for event in own] for own in whole.events]
        assert [[event.said for event in own] for own in solution.events] == np.array(said, dtype=object)[which].tolist()


@pytest.mark.usefixtures("short_parts")
def test_what_is_left_of_the_residual_is_kept_where_those_few_find_nothing():
    """A strip under a force across it along its wide side, which buckles sideways at 1 in these units."""
    robot = mr.SingleRod(mr.Rod(length=0.5, bending_stiffness=(4.0, 0.02), torsional_stiffness=0.015))
    lateral = 4.0126 * np.sqrt(0.02 * 0.015) / 0.5**2
    part = np.array([0.5, 1.3, -0.2, 0.8, 0.1, -0.4])
    inputs = robot.inputs(tip_force=lateral * part[:, None] * (0, 1, 0))
    stops = replace(PRECISE, at_fold="stop")
    shared, alone = (mr.solve(robot, own, solver=stops, threads=1) for own in (inputs, inputs[:2]))
    assert shared.status.tolist() == [mr.Status.BRANCH_END if own > 1 else mr.Status.CONVERGED for own in part]
    assert shared.residual[1] > 1e-3
    np.testing.assert_array_equal(shared.residual[:2], alone.residual)


@pytest.mark.parametrize("make", [single_rod, tubes, legs])
@pytest.mark.usefixtures("short_parts")
def test_some_instances_are_those_of_the_whole(make):
    robot, inputs = make(20)
    whole = mr.solve(robot, inputs, solver=NEWTON).raise_if_failed()
    chosen = np.array([7, 3, 19, 3])
    for some in (mr.solve(robot, inputs, solver=NEWTON, instances=chosen), whole[chosen]):
        assert some.batch_shape == (4,)
        for name in (*ARRAYS, "energy", "condition"):
            np.testing.assert_array_equal(getattr(some, name), getattr(whole, name)[chosen], err_msg=name)
        np.testing.assert_array_equal(some.inputs.tip_force, np.broadcast_to(inputs.tip_force, (20, 3))[chosen])
        np.testing.assert_array_equal(some.rod(0).moment, whole.rod(0).moment[chosen])
        np.testing.assert_array_equal(some.jacobian("tip_force"), whole.jacobian("tip_force")[chosen])
    assert whole[5].status is mr.Status.CONVERGED
    assert whole[5].tip_position.shape == (3,)
    np.testing.assert_array_equal(whole[chosen][1:3].unknowns, whole.unknowns[[3, 19]])


def test_instances_of_several_axes_are_counted_flat():
    rod = mr.Rod(length=np.array([0.3, 0.4, 0.5]), bending_stiffness=0.2, torsional_stiffness=0.06)
    robot = mr.SingleRod(rod)
    inputs = robot.inputs(tip_force=np.random.default_rng(0).uniform(-1, 1, (2, 1, 3)))
    whole = mr.solve(robot, inputs, solver=NEWTON)
    some = mr.solve(robot, inputs, solver=NEWTON, instances=[4, 0])
    np.testing.assert_array_equal(some.tip_position, whole.tip_position.reshape(6, 3)[[4, 0]])
    np.testing.assert_array_equal(whole[1, ::2].tip_position, whole.tip_position[1, ::2])


@pytest.mark.parametrize("instances", [[0.5], [[0]], [-1], [4]])
def test_instances_are_checked(instances):
    robot, inputs = single_rod(4)
    with pytest.raises(ValueError, match="instances = .* is not allowed: must be"):
        mr.solve(robot, inputs, instances=instances)


@pytest.mark.parametrize("threads", [0, 1.5, True])
def test_threads_are_checked(threads):
    robot, inputs = single_rod(4)
    with pytest.raises(ValueError, match="threads = .* is not allowed: must be an integer >= 1"):
        mr.solve(robot, inputs, threads=threads)


@pytest.mark.parametrize("solver", [NEWTON, mr.Observer(integrator=RK4, feed_forward=True)], ids=["newton", "observer"])
@pytest.mark.usefixtures("short_parts")
def test_a_batch_of_motions_is_its_motions(solver):
    """Rods and motions of their own; the time axis comes first, and what does not vary is given once."""
    robot, _ = single_rod(9)
    t = 0.005 * np.arange(6)
    phase = np.linspace(0, 1, 9)
    force = np.stack([np.sin(t[:, None] + phase), np.cos(t[:, None] + phase), 0 * t[:, None] + 0 * phase], axis=-1)
    inputs = robot.inputs(tip_force=force, rotation=t[:, None, None])
    together = mr.simulate(robot, inputs, time=t, solver=solver, threads=2)
    assert together.batch_shape == (6, 9)
    assert together.step_time.shape == (6,)
    for k in (0, 4, 8):
        rod = robot.rods[0]
        section = rod.sections[0]
        alone = mr.SingleRod(
            mr.Rod(
                length=0.4,
                bending_stiffness=section.bending_stiffness[k],
                torsional_stiffness=0.06,
                precurvature=section.precurvature[k],
            )
        )
        one = mr.simulate(alone, alone.inputs(tip_force=force[:, k], rotation=t), time=t, solver=solver)
        for name in ("status", "unknowns", "tip_position", "residual", "integrations"):
            np.testing.assert_array_equal(getattr(together, name)[:, k], getattr(one, name), err_msg=name)
        np.testing.assert_array_equal(together.inputs.tip_force[:, k], force[:, k])
    np.testing.assert_array_equal(together[3].tip_position, together.tip_position[3])


def test_impossible_instances_cost_little_and_leave_the_others_as_they_are(wire):
    """A push of three times what the wire's branch holds: how it ends, and what the search for its end costs."""
    robot = mr.SingleRod(wire)
    force = np.random.default_rng(0).uniform(-1, 1, (1000, 3))
    sound = mr.solve(robot, robot.inputs(tip_force=force), solver=NEWTON).raise_if_failed()
    hard = np.arange(0, 1000, 100)
    force[hard] = (0, 0, -30)
    mixed = mr.solve(robot, robot.inputs(tip_force=force), solver=mr.Shooting(integrator=RK4, at_fold="stop"))
    assert (mixed.status[hard] == mr.Status.BRANCH_END).all()
    others = np.setdiff1d(np.arange(1000), hard)
    np.testing.assert_array_equal(mixed.unknowns[others], sound.unknowns[others])
    # each instance leaves the launches when it has ended, so integrations are what it costs
    assert mixed.integrations.sum() < 1.3 * sound.integrations.sum()


class Failing(mr.Solver):
    """Raises in the part that holds a certain instance, and waits in the others until it is stopped."""

    def _solve(self, problem, guess):
        if problem.read("inputs")[:, problem.input_slice("rotation")].min() == 0:
            raise RuntimeError("this part is broken")
        while True:
            problem.integrate()
            time.sleep(0.001)


@pytest.mark.usefixtures("short_parts")
def test_an_error_in_a_part_stops_the_others_and_is_raised(wire):
    """Each of the others would go on for ever."""
    robot = mr.SingleRod(wire)
    with pytest.raises(RuntimeError, match="this part is broken"):
        mr.solve(robot, robot.inputs(rotation=np.linspace(0, 2, 12)), solver=Failing(), threads=2)


class After:
    """An event that is set once it has been looked at so many times."""

    def __init__(self, looks: int) -> None:
        self.looks = looks

    def is_set(self) -> bool:
        self.looks -= 1
        return self.looks < 0


@pytest.mark.parametrize("make", [single_rod, tubes, legs])
def test_a_stopped_problem_integrates_no_more(make):
    """Not even the rest of its instances: of some 1000 rods at a time, those of a launch are integrated."""
    count = 2500
    robot, inputs = make(count)
    problem = robot.problem(inputs, integrator=mr.RK4(4))
    problem.stop = After(3)
    problem.write("position", np.nan)
    with pytest.raises(batch.Interrupted):
        problem.integrate()
    if make is not legs:  # the platform's pose comes last
        done = np.isfinite(problem.read("position")).all(axis=1)
        assert done.sum() * robot.rod_count == 2048
        assert done[: done.sum()].all()
    problem.stop = After(10**6)
    problem.integrate()
    whole = problem.snapshot()
    for start in range(0, count, 500):
        some = robot.problem(inputs, integrator=mr.RK4(4), instances=np.arange(start, start + 500))
        some.integrate()
        np.testing.assert_array_equal(some.snapshot(), whole[start : start + 500])


ENDLESS = """
import signal, sys, time, numpy as np, multirod as mr
signal.signal(signal.SIGINT, signal.default_int_handler)  # who starts this may ignore it
robot = mr.SingleRod(mr.Rod(length=0.4, bending_stiffness=0.2, torsional_stiffness=0.06))
solver, threads = mr.Shooting(integrator=mr.RK4(40)), int(sys.argv[1])
inputs = robot.inputs(tip_force=np.random.default_rng(0).uniform(-1, 1, (1_000_000, 3)))

def solve(count, told):
    mr.solve(robot, inputs, solver=solver, threads=threads, instances=np.arange(count), progress=told)

solve(20_000, False)  # kernels
begin = time.process_time()
solve(20_000, False)
print("takes", time.process_time() - begin, flush=True)
try:
    solve(1_000_000, lambda done: print("done", done, flush=True))
except KeyboardInterrupt:
    print("stopped at", time.process_time(), flush=True)
"""


@pytest.mark.skipif(sys.platform != "linux", reason="reads processor time from /proc")
@pytest.mark.parametrize("threads", [1, 2])
def test_ctrl_c_stops_before_much_more_is_solved(threads):
    """Less than what 20,000 rods take, counted in processor time, which a busy machine does not stretch; a million were asked
    for."""
    with programs.started("-c", ENDLESS, str(threads)) as process:
        lines = iter(process.stdout.readline, "")
        takes = float(next(line for line in lines if line.startswith("takes")).split()[-1])
        next(line for line in lines if line.startswith("done"))
        sent = programs.processor_time(process.pid)
        process.send_signal(signal.SIGINT)
        out, error = process.communicate(timeout=programs.GUARD)
    assert "stopped at" in out, error
    assert float(out.split()[-1]) - sent < takes


MEMORY = """
import sys, numpy as np, multirod as mr

def peak():
    with open("/proc/self/status") as told:
        return next(1024 * int(line.split()[1]) for line in told if line.startswith("VmHWM"))

rod = mr.Rod(length=0.4, bending_stiffness=0.2, torsional_stiffness=0.06, precurvature=(14, 5, 0))
robot = mr.SingleRod(rod)
force = np.random.default_rng(0).uniform(-1, 1, (100_000, 3))

def solve(count):
    options = {"solver": mr.Shooting(integrator=mr.RK4(40)), "threads": int(sys.argv[1])}
    assert (mr.solve(robot, robot.inputs(tip_force=force[:count]), **options).residual <= 1e-9).all()
    return peak()

solve(20_000)
print(solve(20_000), solve(100_000))
"""


@pytest.mark.skipif(sys.platform != "linux", reason="reads its own peak from /proc")
@pytest.mark.parametrize(("threads", "most"), [(1, 100e6), (2, 200e6)])
def test_memory_of_100000_instances_is_what_the_docs_say(threads, most):
    """Over what 20,000 took, whose parts being solved are as large; docs/batches.md says 70 and 120 MB.

    The C library keeps more or less of what threads give back, from run to run: 50 to 70 and 70 to 120 MB were seen. It is the
    peak of the process's own memory: what `resource` tells of a child begins with what its parent, the tests, held.
    """
    run = programs.run("-c", MEMORY, str(threads), check=True)
    before, after = (int(word) for word in run.stdout.split()[-2:])
    assert after - before < most
    assert after < 1e9


def test_progress_is_told_to_a_function(wire):
    robot = mr.SingleRod(wire)
    told = []
    mr.solve(robot, robot.inputs(rotation=np.zeros(1200)), solver=NEWTON, threads=2, progress=told.append)
    assert told == sorted(told)
    assert told[-1] == 1200
    assert len(told) > 1
    told.clear()
    t = 0.01 * np.arange(4)
    mr.simulate(robot, robot.inputs(rotation=np.zeros((4, 1200))), time=t, solver=NEWTON, threads=2, progress=told.append)
    assert told == [1, 2, 3, 4]
    with pytest.raises(ValueError, match="progress = 3 is not allowed"):
        mr.solve(robot, solver=NEWTON, progress=3)


def test_a_bar_comes_after_two_seconds_and_only_on_a_terminal(monkeypatch):
    class Clock:
        now = 100.0

    monkeypatch.setattr(progress, "monotonic", lambda: Clock.now)
    monkeypatch.setenv("TERM", "xterm")
    for forced, shown in (("1", True), ("", False)):
        monkeypatch.setenv("FORCE_COLOR", forced)  # rich takes what forces colour for a terminal
        monkeypatch.setattr(sys.stderr, "isatty", lambda shown=shown: shown)
        with progress.Watch("solving", 10, True) as watch:
            watch.advance(3)
            assert watch._bar is None
            Clock.now += 2.5
            watch.advance(3)
            assert (watch._bar is not None) == shown
            if shown:
                assert watch._bar.tasks[0].completed == 6
    with progress.Watch("solving", 10, False) as watch:
        Clock.now += 2.5
        watch.advance(3)
        assert watch._bar is None
