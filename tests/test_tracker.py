"""One sample at a time: the same numbers as ``simulate``, inputs kept, bad input refused without harm, next to no allocation."""

import copy
import gc
import pickle
import tracemalloc
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np
import pytest

import multirod as mr
from multirod.solvers.newton.iteration import Newton
from multirod.solvers.tracking.newton_track import NewtonTrack
from multirod.studies import experiment
from multirod.studies.scenes import load

INTEGRATOR = mr.RK4(50)
NEWTON = mr.Shooting(integrator=INTEGRATOR)
OBSERVER = mr.Observer(integrator=INTEGRATOR)
SOLVERS = {
    "Newton": NEWTON,
    "observer": OBSERVER,
    "feed-forward": mr.Observer(integrator=INTEGRATOR, feed_forward=True),
    "SciPy": mr.ScipyShooting(integrator=INTEGRATOR, exact_gradient=True),
}
FORCE = (0.5, 1.0, 0.3)


@pytest.fixture
def tracker(robot: mr.SingleRod) -> mr.Tracker:
    """Newton at a tip force of ``FORCE``, a rotation of 0.2 and a translation of 0.01."""
    return mr.Tracker(robot, solver=NEWTON, dt=0.005, inputs=robot.inputs(rotation=0.2, translation=0.01, tip_force=FORCE))


def same(one: mr.Solution, other: mr.Solution) -> bool:
    return all(
        np.array_equal(getattr(one, name), getattr(other, name)) for name in ("unknowns", "gamma", "tip_position", "tip_rotation")
    )


@pytest.mark.parametrize("named", [True, False], ids=["by name", "inputs"])
@pytest.mark.parametrize("name", SOLVERS)
def test_step_equals_simulate_bitwise(name: str, named: bool) -> None:
    study = experiment.motion(duration=0.2)
    history = mr.simulate(study.robot, study.inputs, time=study.time, solver=SOLVERS[name])
    tracker = mr.Tracker(study.robot, solver=SOLVERS[name], dt=0.005, inputs=study.inputs[0])
    for k in range(len(study.time)):
        given = study.inputs[k]
        if named:
            solution = tracker.step(rotation=given.rotation[0], translation=given.translation[0], tip_force=given.tip_force)
        else:
            solution = tracker.step(given)
        assert solution.status == history.status[k]
        assert solution.integrations == history.integrations[k]
        assert np.array_equal(solution.residual, history.residual[k])
        for field in ("unknowns", "gamma", "tip_position", "tip_rotation", "boundary_residual"):
            assert np.array_equal(getattr(solution, field), getattr(history, field)[k]), (k, field)


def test_samples_make_the_history_that_simulate_gives(wire: mr.Rod, tmp_path: Any) -> None:
    study = experiment.motion(duration=0.2)
    simulated = mr.simulate(study.robot, study.inputs, time=study.time, solver=NEWTON)
    tracker = mr.Tracker(study.robot, solver=NEWTON, dt=0.005, inputs=study.inputs[0])
    samples = [tracker.step(study.inputs[k]) for k in range(len(study.time))]
    history = mr.History.of(samples, time=study.time, description="by hand")
    assert same(history, simulated)
    for name in ("status", "residual", "integrations", "time", "tip_position"):
        np.testing.assert_array_equal(getattr(history, name), getattr(simulated, name))
    for name in study.inputs.arrays:
        np.testing.assert_array_equal(getattr(history.inputs, name), getattr(simulated.inputs, name))
    assert np.isnan(history.step_time).all()
    assert history.description == "by hand"
    history.save(tmp_path / "run.npz")
    assert same(mr.load(tmp_path / "run.npz"), simulated)
    # of a robot without inputs, and one sample
    still = mr.solve(mr.SingleRod(wire), solver=NEWTON)
    assert mr.History.of([still], time=[0.0], step_time=[1e-3]).tip_position.shape == (1, 3)


@pytest.mark.parametrize(
    ("changes", "error", "message"),
    [
        ({"samples": ()}, ValueError, "History.of.samples .* must be one or more"),
        ({"samples": [3]}, TypeError, "History.of.samples .* must be a list of Solutions"),
        ({"time": [0, 1, 1]}, ValueError, "History.of.time .* must increase"),
        ({"time": [0, 1]}, ValueError, "History.of.time .* must have shape"),
        ({"step_time": [1e-3]}, ValueError, "History.of.step_time .* must have shape"),
    ],
)
def test_what_is_no_history_is_refused(tracker: mr.Tracker, changes: dict[str, Any], error: type, message: str) -> None:
    samples = [tracker.step() for _ in range(3)]
    with pytest.raises(error, match="(?s)" + message):
        mr.History.of(**{"samples": samples, "time": [0, 1, 2], **changes})


def test_samples_of_another_kind_are_refused(wire: mr.Rod, robot: mr.SingleRod, tracker: mr.Tracker) -> None:
    first = tracker.step()
    others = [
        mr.solve(mr.SingleRod(wire), tracker.inputs, solver=NEWTON),
        mr.solve(robot, robot.inputs(tip_force=(FORCE, FORCE)), solver=NEWTON),
        tracker.step(tip_moment=(0, 0, 0.01)),
    ]
    for other in others:
        with pytest.raises(ValueError, match=r"(?s)History.of.samples\[1\] .* must be of the same robot, .* named at the start"):
            mr.History.of([first, other], time=[0, 1])


def test_guess_is_where_the_first_step_starts(robot: mr.SingleRod) -> None:
    inputs = robot.inputs(tip_force=FORCE)
    truth = mr.solve(robot, inputs, solver=NEWTON)
    assert mr.Tracker(robot, solver=NEWTON, dt=0.005, inputs=inputs, guess=truth).step().integrations == 1
    step = mr.Tracker(robot, solver=OBSERVER, dt=0.005, inputs=inputs, guess=(13, 6, 1)).step()
    assert np.array_equal(step.unknowns, (13, 6, 1))


def test_inputs_not_named_keep_their_value(robot: mr.SingleRod, tracker: mr.Tracker) -> None:
    for changes in ({"rotation": 0.5}, {}, {"tip_force": (1, 0, 0)}, {"translation": -0.1}, {}):
        solution = tracker.step(**changes)
    np.testing.assert_array_equal(solution.inputs.rotation, [0.5])
    np.testing.assert_array_equal(solution.inputs.translation, [-0.1])
    np.testing.assert_array_equal(solution.inputs.tip_force, (1, 0, 0))
    np.testing.assert_array_equal(tracker.inputs.tip_force, (1, 0, 0))
    truth = mr.solve(robot, robot.inputs(rotation=0.5, translation=-0.1, tip_force=(1, 0, 0)), solver=NEWTON)
    np.testing.assert_allclose(solution.unknowns, truth.unknowns, rtol=0, atol=1e-8)
    # all inputs anew: what is not given is zero
    solution = tracker.step(robot.inputs(tip_force=FORCE))
    np.testing.assert_array_equal(solution.inputs.rotation, [0])
    np.testing.assert_array_equal(tracker.inputs.translation, [0])


@pytest.mark.parametrize(
    "changes",
    [
        {"rotation": 1, "translation": 0, "tip_force": (1, 0, 0)},
        {"rotation": 1.0, "translation": 0.0, "tip_force": [1.0, 0.0, 0.0]},
        {"rotation": np.float64(1), "translation": np.int64(0), "tip_force": np.array([1, 0, 0])},
        {"rotation": np.array(1.0), "translation": np.float32(0), "tip_force": np.array([1.0, 0, 0], dtype=np.float32)},
        {"rotation": [1.0], "translation": np.zeros(1), "tip_force": (np.float64(1), 0, np.float32(0))},
    ],
    ids=["ints", "floats", "arrays", "array scalars", "per rod"],
)
def test_kinds_of_numbers(tracker: mr.Tracker, robot: mr.SingleRod, changes: dict[str, Any]) -> None:
    expected = mr.Tracker(robot, solver=NEWTON, dt=0.005, inputs=robot.inputs(rotation=1.0, tip_force=(1.0, 0, 0))).step()
    solution = tracker.step(**changes)
    assert solution.batch_shape == ()
    assert isinstance(solution.status, mr.Status)
    assert same(solution, expected)


@pytest.mark.parametrize("solver", [NEWTON, OBSERVER], ids=["Newton", "observer"])
def test_a_load_named_later_is_compiled_in_and_the_state_carried_over(robot: mr.SingleRod, solver: mr.Solver) -> None:
    tracker = mr.Tracker(robot, solver=solver, dt=0.005, inputs=robot.inputs(tip_force=FORCE))
    for _ in range(50):
        before = tracker.step()
    after = tracker.step(tip_moment=(0, 1e-6, 0))
    # an observer that started again would stand at u*, 0.9 1/m away; the new term moves RK4(50)'s error by 1e-6
    np.testing.assert_allclose(after.unknowns, before.unknowns, rtol=0, atol=1e-4)
    for _ in range(200):
        after = tracker.step(tip_moment=(0, 0.05, 0))
    truth = mr.solve(robot, robot.inputs(tip_force=FORCE, tip_moment=(0, 0.05, 0)), solver=NEWTON)
    np.testing.assert_allclose(after.unknowns, truth.unknowns, rtol=0, atol=1e-6)
    np.testing.assert_array_equal(after.inputs.tip_moment, (0, 0.05, 0))
    np.testing.assert_array_equal(after.inputs.tip_force, FORCE)


def test_a_load_present_at_the_start_may_be_zero_for_a_while(robot: mr.SingleRod, monkeypatch: pytest.MonkeyPatch) -> None:
    tracker = mr.Tracker(robot, solver=NEWTON, dt=0.005, inputs=robot.inputs(tip_force=FORCE))
    first = tracker.step()
    monkeypatch.setattr(robot, "problem", None)  # nothing is compiled again
    tracker.step(tip_force=(0, 0, 0))
    tracker.step()
    again = tracker.step(tip_force=FORCE)
    np.testing.assert_allclose(again.unknowns, first.unknowns, rtol=0, atol=1e-8)


def test_a_load_given_as_zero_at_the_start_may_come_later(robot: mr.SingleRod, monkeypatch: pytest.MonkeyPatch) -> None:
    tracker = mr.Tracker(robot, solver=NEWTON, dt=0.005, inputs=robot.inputs(tip_force=(0, 0, 0)))
    tracker.step()
    truth = mr.solve(robot, robot.inputs(tip_force=FORCE), solver=NEWTON)
    monkeypatch.setattr(robot, "problem", None)  # nothing is compiled again
    loaded = tracker.step(tip_force=FORCE)
    np.testing.assert_allclose(loaded.unknowns, truth.unknowns, rtol=0, atol=1e-8)


BAD = [
    ("rotation", "0.1", "number"),
    ("rotation", None, "finite|number"),
    ("rotation", True, "number"),
    ("rotation", np.nan, "finite"),
    ("rotation", np.inf, "finite"),
    ("translation", -np.inf, "finite"),
    ("translation", -0.4, "> -length"),
    ("translation", -7, "> -length"),
    ("tip_force", 1.0, "shape"),
    ("tip_force", 0, "shape"),
    ("tip_force", np.float64(2), "shape"),
    ("tip_force", (1, 0), "shape"),
    ("tip_force", (1, 0, 0, 0), "shape"),
    ("tip_force", (np.nan, 0, 0), "finite"),
    ("tip_force", (np.inf, -np.inf, 0), "finite"),
    ("tip_force", (1e60, 0, 0), r"at most 1e\+50"),
    ("tip_force", np.array([0, 1e60, 0]), r"at most 1e\+50"),
    ("tip_force", np.array([0, np.inf, 0]), "finite"),
    ("tip_force", ("1", "0", "0"), "shape|numeric"),
    ("tip_force", "100", "shape|numeric"),
    ("tip_force", None, "shape"),
    ("tip_moment", (0, 0), "shape"),
    ("tip_moment", (0, np.nan, 0), "finite"),
]


@pytest.mark.parametrize(("name", "value", "allowed"), BAD, ids=lambda value: repr(value))
@pytest.mark.parametrize("beside", [{}, {"rotation": 0.9}], ids=["alone", "beside a good one"])
def test_bad_values_are_refused_and_nothing_is_changed(
    tracker: mr.Tracker, name: str, value: Any, allowed: str, beside: dict
) -> None:
    before = tracker.step()
    with pytest.raises(ValueError, match=rf"^{name} = .* is not allowed: .*(?:{allowed})"):
        tracker.step(**{**beside, name: value})
    np.testing.assert_array_equal(tracker.inputs.rotation, [0.2])
    np.testing.assert_array_equal(tracker.inputs.translation, [0.01])
    np.testing.assert_array_equal(tracker.inputs.tip_force, FORCE)
    after = tracker.step()
    assert after.status is mr.Status.CONVERGED
    assert same(after, before)


def test_unknown_names_and_both_forms_are_refused(robot: mr.SingleRod, tracker: mr.Tracker) -> None:
    before = tracker.step()
    with pytest.raises(TypeError, match=r"Tracker\.step\(\) takes no 'tip_fource': it takes .*tip_force"):
        tracker.step(rotation=1.0, tip_fource=(1, 0, 0))
    with pytest.raises(TypeError, match="inputs or named changes, not both"):
        tracker.step(robot.inputs(), rotation=1.0)
    assert same(tracker.step(), before)


def test_batch_axes_are_those_at_the_start(robot: mr.SingleRod, tracker: mr.Tracker) -> None:
    before = tracker.step()
    with pytest.raises(
        ValueError, match=r"^inputs \(tip_force\) = .*\(2,\).* is not allowed: must broadcast to those at the start, \(\)"
    ):
        tracker.step(tip_force=[FORCE, FORCE])
    assert same(tracker.step(), before)
    batch = mr.Tracker(robot, solver=NEWTON, dt=0.005, inputs=robot.inputs(tip_force=[FORCE, FORCE]))
    with pytest.raises(ValueError, match=r"must broadcast to those at the start, \(2,\)"):
        batch.step(tip_force=[FORCE] * 3)


@pytest.mark.parametrize("name", ["Newton", "observer", "feed-forward"])
def test_batch_equals_its_instances_alone(robot: mr.SingleRod, name: str) -> None:
    force = np.array([FORCE, (0, 0.2, 0), (1, 0, 0)])
    batch = mr.Tracker(robot, solver=SOLVERS[name], dt=0.005, inputs=robot.inputs(tip_force=force))
    alone = [mr.Tracker(robot, solver=SOLVERS[name], dt=0.005, inputs=robot.inputs(tip_force=f)) for f in force]
    for k in range(5):
        solution = batch.step(rotation=[0.01 * k, 0.02 * k, 0.0], tip_force=(1 - 0.1 * k) * force)
        assert solution.batch_shape == (3,)
        for i, tracker in enumerate(alone):
            one = tracker.step(rotation=0.01 * k * (1, 2, 0)[i], tip_force=(1 - 0.1 * k) * force[i])
            assert np.array_equal(solution.unknowns[i], one.unknowns)
            assert np.array_equal(solution.tip_position[i], one.tip_position)
            assert solution.status[i] == one.status


def test_one_value_for_the_whole_batch(robot: mr.SingleRod) -> None:
    batch = mr.Tracker(robot, solver=NEWTON, dt=0.005, inputs=robot.inputs(tip_force=[FORCE, (0, 0.2, 0)]))
    solution = batch.step(rotation=0.3, tip_force=FORCE)
    assert solution.batch_shape == (2,)
    assert np.array_equal(solution.inputs.rotation, [[0.3], [0.3]])
    assert np.array_equal(solution.tip_position[0], solution.tip_position[1])


@pytest.mark.parametrize("solver", [NEWTON, OBSERVER], ids=["Newton", "observer"])
def test_earlier_solutions_do_not_change(robot: mr.SingleRod, solver: mr.Solver) -> None:
    tracker = mr.Tracker(robot, solver=solver, dt=0.005, inputs=robot.inputs(tip_force=FORCE))
    first = tracker.step(rotation=0.1)
    eager = {name: np.array(getattr(first, name)) for name in ("unknowns", "tip_position", "tip_rotation", "gamma", "residual")}
    second = tracker.step(rotation=0.2)  # nothing of it is read until the tracker has gone on
    for k in range(5):
        tracker.step(rotation=1.0 + k, translation=0.02 * k, tip_force=(0, k, 0))
    for name, value in eager.items():
        np.testing.assert_array_equal(getattr(first, name), value)
    assert second.inputs.rotation == 0.2
    np.testing.assert_array_equal(second.inputs.tip_force, FORCE)
    np.testing.assert_allclose(second.rod().position[-1], second.tip_position, rtol=0, atol=1e-6)
    assert second.status in (mr.Status.CONVERGED, mr.Status.TRACKING)
    assert second.integrations <= 5


def test_a_failed_step_is_a_status_and_the_next_one_works(tracker: mr.Tracker) -> None:
    before = tracker.step()
    failed = tracker.step(tip_force=(0, 1e9, 0))
    assert failed.status.failed
    assert np.isnan(failed.tip_position).all()
    after = tracker.step(tip_force=FORCE)
    assert after.status is mr.Status.CONVERGED
    np.testing.assert_allclose(after.unknowns, before.unknowns, rtol=0, atol=1e-8)


@pytest.mark.parametrize("solver", [NEWTON, OBSERVER], ids=["Newton", "observer"])
def test_a_step_keeps_next_to_nothing(robot: mr.SingleRod, solver: mr.Solver) -> None:
    tracker = mr.Tracker(robot, solver=solver, dt=0.005, inputs=robot.inputs(rotation=0.1, tip_force=FORCE))
    for _ in range(50):
        tracker.step(rotation=0.1, tip_force=FORCE)
    gc.collect()
    tracemalloc.start()
    try:
        start, _ = tracemalloc.get_traced_memory()
        tracemalloc.reset_peak()
        for k in range(2000):
            tracker.step(rotation=1e-4 * k, tip_force=FORCE)
        _, peak = tracemalloc.get_traced_memory()
        gc.collect()  # empties Python's free lists: 2000 tuples of 56 bytes and their like
        end, _ = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    # a Solution that nobody keeps is freed at once: 2000 of them would be 2 MB
    assert end - start < 10_000
    assert peak - start < 500_000


CARRIED = ("rotation", "tip_force", "precurvature", "follower_force")


def test_a_sample_has_its_columns_without_another_integration(wire: mr.Rod, monkeypatch: pytest.MonkeyPatch) -> None:
    """What the integrations carried is what an integration for it would say, to what 1e-9 1/m of residual leaves."""
    solver = mr.Shooting(integrator=mr.RK45(), tolerance=1e-11)
    robot = mr.SingleRod(wire)
    tracker = mr.Tracker(robot, solver=solver, inputs=robot.inputs(tip_force=FORCE), jacobian=CARRIED)
    for angle in (0.2, 0.21):
        sample = tracker.step(rotation=angle)
    expected = mr.solve(robot, sample.inputs, solver=solver, guess=sample)
    columns = expected.jacobian(*CARRIED)
    by_follower = expected.jacobian("follower_force")
    cotangent = np.arange(6.0)
    product = expected.vjp(cotangent, wrt="tip_force")["tip_force"]
    with monkeypatch.context() as patch:
        patch.setattr(mr.SingleRod, "problem", None)
        np.testing.assert_allclose(sample.jacobian("rotation", "tip_force", "precurvature"), columns[:, :7], rtol=0, atol=1e-9)
        np.testing.assert_allclose(sample.jacobian("tip_force"), columns[:, 1:4], rtol=0, atol=1e-9)
        np.testing.assert_allclose(sample.vjp(cotangent, wrt="tip_force")["tip_force"], product, rtol=0, atol=1e-9)
    np.testing.assert_allclose(sample.jacobian("follower_force"), by_follower, rtol=0, atol=1e-9)
    with pytest.raises(TypeError, match="takes no 'force'"):
        sample.jacobian("force")


def test_columns_of_the_tracker_belong_to_their_own_sample(wire: mr.Rod) -> None:
    robot = mr.SingleRod(wire)
    tracker = mr.Tracker(robot, solver=NEWTON, inputs=robot.inputs(tip_force=FORCE), jacobian="rotation")
    first = tracker.step(rotation=0.2)
    known = np.array(first.jacobian("rotation"))
    first = tracker.step(rotation=0.2)
    tracker.step(rotation=1.2)
    np.testing.assert_allclose(first.jacobian("rotation"), known, rtol=0, atol=1e-9)


def test_samples_of_designs_in_another_order_tell_of_their_own() -> None:
    """As many as the loop has, they were told by its designs in its order."""
    robot = mr.SingleRod(
        mr.Rod(length=np.array([0.3, 0.5]), bending_stiffness=0.2, torsional_stiffness=0.1, precurvature=(4, 5, 0))
    )
    sample = mr.Tracker(robot, inputs=robot.inputs(tip_force=(1.0, 0, 0))).step()
    columns = sample.jacobian("tip_force")
    for order in ([1, 0], [1, 1], slice(None, None, -1)):
        np.testing.assert_allclose(sample[order].jacobian("tip_force"), columns[order], rtol=0, atol=1e-9)


ASKED = ("rotation", "translation", "tip_force", "precurvature")


@pytest.mark.parametrize("batch", [(), (3,)])
def test_a_sample_tells_by_what_was_not_asked_for_before(wire: mr.Rod, monkeypatch: pytest.MonkeyPatch, batch: Any) -> None:
    """By a problem that is made once, whatever inputs come, and that leaves no trace in samples."""
    solver = mr.Shooting(integrator=mr.RK45(), tolerance=1e-11)
    robot = mr.SingleRod(wire)
    still = np.zeros((*batch, 3))
    tracker = mr.Tracker(robot, solver=solver, inputs=robot.inputs(tip_force=still))
    tracker.step().jacobian(*ASKED)
    samples = [tracker.step(rotation=0.1 * k, tip_force=still + (0.3, 0.1 * k, 0)) for k in range(3)]
    expected = [mr.solve(robot, sample.inputs, solver=solver, guess=sample).jacobian(*ASKED) for sample in samples]
    with monkeypatch.context() as patch:
        patch.setattr(mr.SingleRod, "problem", None)
        for sample, columns in zip(samples[::-1], expected[::-1], strict=True):
            np.testing.assert_allclose(sample.jacobian(*ASKED), columns, rtol=0, atol=1e-9)
    for sample, columns in zip(samples, expected, strict=True):
        for copied in (copy.deepcopy(sample), pickle.loads(pickle.dumps(sample))):
            np.testing.assert_allclose(copied.jacobian(*ASKED), columns, rtol=0, atol=1e-9)
        if batch:
            np.testing.assert_allclose(sample[1].jacobian(*ASKED), columns[1], rtol=0, atol=1e-9)
    if not batch:
        lost = tracker.step(tip_force=(1e9, 0, 0))
        assert lost.failed
        assert np.isnan(lost.jacobian(*ASKED)).all()
    with pytest.raises(TypeError, match="takes no 'force'"):
        samples[0].jacobian("force")


def test_two_threads_may_ask_two_samples_of_one_tracker(wire: mr.Rod) -> None:
    robot = mr.SingleRod(wire)
    tracker = mr.Tracker(robot, solver=NEWTON, inputs=robot.inputs(tip_force=FORCE))
    samples = [tracker.step(rotation=0.1 * k) for k in range(2)]
    alone = [sample.jacobian("rotation", "tip_force") for sample in samples]
    with ThreadPoolExecutor(2) as pool:
        for sample, columns in zip(samples, alone, strict=True):
            for found in [pool.submit(sample.jacobian, "rotation", "tip_force") for _ in range(50)]:
                np.testing.assert_allclose(found.result(), columns, rtol=0, atol=1e-5)  # 50 steps leave 1e-6 of the force


def test_columns_of_what_was_found_in_another_way_are_not_those_of_the_last_integration() -> None:
    """A column that has buckled is found by a problem of its own: what the tracker integrated last was the straight one."""
    robot = mr.SingleRod(mr.Rod(length=0.5, bending_stiffness=(0.08, 0.02), torsional_stiffness=0.015))
    tracker = mr.Tracker(robot, solver=NEWTON, inputs=robot.inputs(tip_force=(0, 0, 0)), jacobian="tip_force")
    tracker.step()
    sample = tracker.step(tip_force=(0, 0, -0.3))
    assert sample.status is mr.Status.BIFURCATED
    again = mr.solve(robot, sample.inputs, solver=NEWTON, guess=sample)
    # with columns the force is carried in another frame: 50 steps leave 1e-6 of that
    np.testing.assert_allclose(sample.jacobian("tip_force"), again.jacobian("tip_force"), rtol=0, atol=1e-5)


def test_columns_are_refused_where_they_cannot_be(wire: mr.Rod) -> None:
    robot = mr.SingleRod(wire)
    with pytest.raises(TypeError, match="Tracker.*takes no 'rotations'.*did you mean 'rotation'"):
        mr.Tracker(robot, jacobian="rotations")
    with pytest.raises(ValueError, match="whose columns are its own"):
        mr.Tracker(robot, solver=SOLVERS["feed-forward"], dt=0.005, jacobian="rotation")


# ---- a sample of Newton's method is one launch ----


def hops(robot: mr.SingleRod) -> list[mr.Inputs]:
    """Smooth samples, and two that go too far for their extrapolation: those are solved again in steps of the inputs."""
    size = [*np.linspace(0.0, 1.0, 8), -4.0, -3.9, -3.8, 3.0, 3.05]
    return [robot.inputs(rotation=0.1 * k, tip_force=(s, 0.3, 0.1 * k)) for k, s in enumerate(size)]


@pytest.mark.parametrize("predictor", ["none", "linear", "quadratic", "adaptive"])
def test_a_sample_in_one_launch_is_what_python_makes_of_it(
    robot: mr.SingleRod, predictor: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    solver = mr.Shooting(integrator=INTEGRATOR, predictor=predictor)

    def followed() -> list[mr.Solution]:
        first, *others = hops(robot)
        tracker = mr.Tracker(robot, solver=solver, inputs=first)
        return [tracker.step(inputs) for inputs in (first, *others)]

    launched = followed()
    # a kernel foresees, repeats, and keeps: without its calls Python does all of that, by other code
    monkeypatch.setattr(Newton, "calls", lambda self: None)
    stepped = followed()
    assert max(int(solution.integrations) for solution in launched) > 10, "no sample was solved again"
    for k, (one, other) in enumerate(zip(launched, stepped, strict=True)):
        assert same(one, other), k
        assert (one.status, one.integrations, one.iterations) == (other.status, other.integrations, other.iterations), k


def test_tubes_turned_too_far_in_a_sample_are_looked_at_again(monkeypatch: pytest.MonkeyPatch) -> None:
    motion = load("three-tubes")

    def solved_again(by: float) -> int:
        """Times that a sample was solved again that is turned by so much."""
        again = []
        monkeypatch.setattr(NewtonTrack, "_continue", lambda self, *rest: again.append(self))
        first = motion.inputs[0]
        tracker = mr.Tracker(motion.robot, solver=NEWTON, inputs=first)
        tracker.step(first)
        rotation = first.rotation.copy()
        rotation[0] += by
        tracker.step(rotation=rotation.tolist())
        return len(again)

    assert solved_again(1e-3) == 0
    assert solved_again(2 * np.pi + 1e-3) == 1  # a whole turn further: unknowns hardly change, and Newton's method sees nothing
