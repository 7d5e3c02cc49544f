"""What works in buffers of its own refuses a second thread and copies; what is read may be read by several threads."""

import copy
import pickle
import sys
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from threading import Event
from typing import Any

import numpy as np
import pytest

import multirod as mr

INTEGRATOR = mr.RK4(50)
NEWTON = mr.Shooting(integrator=INTEGRATOR)
FORCE = (0.5, 1.0, 0.3)
PATIENCE = 60.0  # [s]: a guard against a test that hangs, not a measure


class Held(mr.Shooting):
    """Newton that stops in the middle of a solve until it is let go."""

    entered, let_go = Event(), Event()

    def _solve(self, problem: Any, guess: Any) -> Any:
        self.entered.set()
        assert self.let_go.wait(PATIENCE)
        return super()._solve(problem, guess)

    def track(self, problem: Any, dt: float) -> Any:
        return mr.Solver.track(self, problem, dt)


@contextmanager
def in_the_middle(work: Any) -> Iterator[Any]:
    """While another thread is in the middle of ``work``; gives its future."""
    Held.entered.clear()
    Held.let_go.clear()
    with ThreadPoolExecutor(1) as pool:
        future = pool.submit(work)
        try:
            assert Held.entered.wait(PATIENCE)
            yield future
        finally:
            Held.let_go.set()


def test_a_tracker_refuses_a_second_thread_and_its_step_is_not_disturbed(robot: mr.SingleRod) -> None:
    tracker, alone = (mr.Tracker(robot, solver=Held(integrator=INTEGRATOR), dt=0.005) for _ in range(2))
    with in_the_middle(lambda: tracker.step(tip_force=FORCE)) as future:
        with pytest.raises(RuntimeError, match="in use on another thread: make a Tracker for each thread"):
            tracker.step(tip_force=(0, 0, 9))
        with pytest.raises(RuntimeError, match="make a Tracker for each thread"):
            _ = tracker.inputs
    expected = alone.step(tip_force=FORCE)
    assert np.array_equal(future.result().unknowns, expected.unknowns)
    np.testing.assert_array_equal(tracker.inputs.tip_force, FORCE)


def test_a_tracker_goes_from_thread_to_thread_and_works_on_after_a_refusal(robot: mr.SingleRod) -> None:
    tracker = mr.Tracker(robot, solver=NEWTON, dt=0.005)
    with pytest.raises(ValueError, match="tip_force"):
        tracker.step(tip_force=(1, 0))
    with ThreadPoolExecutor(1) as pool:
        there = pool.submit(tracker.step, tip_force=FORCE).result(PATIENCE)
    here = tracker.step()
    np.testing.assert_allclose(here.unknowns, there.unknowns, rtol=0, atol=1e-9)


def test_threads_with_a_tracker_each_get_what_they_get_alone(robot: mr.SingleRod) -> None:
    def follow(sign: float) -> np.ndarray:
        tracker = mr.Tracker(robot, solver=NEWTON, dt=0.005)
        return np.array([tracker.step(tip_force=(sign * 0.01 * k, 0, 0.5)).unknowns for k in range(200)])

    with ThreadPoolExecutor(2) as pool:
        together = list(pool.map(follow, (1.0, -1.0)))
    for sign, found in zip((1.0, -1.0), together, strict=True):
        assert np.array_equal(found, follow(sign))


def test_a_problem_refuses_a_second_thread(robot: mr.SingleRod) -> None:
    problem = robot.problem(robot.inputs(tip_force=FORCE), integrator=INTEGRATOR)
    x = problem.guess()
    solver = Held(integrator=INTEGRATOR)
    with in_the_middle(lambda: solver.solve(problem)):
        for work in (lambda: NEWTON.solve(problem), lambda: problem.evaluate(x)):
            with pytest.raises(RuntimeError, match="in use on another thread: make a problem for each thread"):
                work()
    assert NEWTON.solve(problem).status[0] == mr.Status.CONVERGED


def uncopied(tmp_path: Any, robot: mr.SingleRod) -> dict[str, Any]:
    problem = robot.problem(robot.inputs(), integrator=INTEGRATOR)
    return {
        "Tracker": mr.Tracker(robot, solver=NEWTON, dt=0.005),
        "BackboneProblem": problem,
        "NewtonTrack": NEWTON.track(problem, 0.005),
        "Recorder": mr.recording.Recorder(tmp_path / "run.rrd"),
    }


@pytest.mark.usefixtures("written_here")
@pytest.mark.parametrize("name", ["Tracker", "BackboneProblem", "NewtonTrack", "Recorder"])
@pytest.mark.parametrize("duplicate", [copy.copy, copy.deepcopy, pickle.dumps])
def test_what_has_buffers_cannot_be_copied(robot: mr.SingleRod, tmp_path: Any, name: str, duplicate: Any) -> None:
    thing = uncopied(tmp_path, robot)[name]
    with pytest.raises(TypeError, match=rf"^a {name} cannot be copied or pickled, .*: (make|ask)"):
        duplicate(thing)
    if name == "Recorder":
        thing.close()


def test_shapes_of_one_solution_may_be_asked_for_by_several_threads(robot: mr.SingleRod, monkeypatch: pytest.MonkeyPatch) -> None:
    solution = mr.solve(robot, robot.inputs(tip_force=FORCE), solver=NEWTON)
    passes = {nodes: solution._all_shapes(nodes) for nodes in (11, 21)}
    monkeypatch.setattr(type(solution), "_all_shapes", lambda self, nodes: passes[nodes])
    interval = sys.getswitchinterval()
    sys.setswitchinterval(1e-6)  # threads take turns at every other line

    def ask(nodes: int) -> set[int]:
        return {len(solution.rod(0, nodes=nodes).position) for _ in range(3000)}

    try:
        with ThreadPoolExecutor(2) as pool:
            assert list(pool.map(ask, (11, 21))) == [{11}, {21}]
    finally:
        sys.setswitchinterval(interval)


@pytest.mark.usefixtures("written_here")
def test_samples_logged_by_several_threads_are_all_recorded(robot: mr.SingleRod, tmp_path: Any) -> None:
    solution = mr.solve(robot, robot.inputs(tip_force=FORCE), solver=NEWTON)
    recorder = mr.recording.Recorder(tmp_path / "run.rrd", flush_every=3, nodes=5)
    taken = []

    def log(k: int) -> None:
        try:
            recorder.log(0.01 * k, solution)
        except ValueError:  # another thread was first with a later time
            return
        taken.append(k)

    with ThreadPoolExecutor(4) as pool:
        list(pool.map(log, range(200)))
    recorder.close()
    assert recorder._recording._target._count == len(taken)
