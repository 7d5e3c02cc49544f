"""Energy descent: its gradient and form, its accuracy along a motion, folds and snaps, and what it refuses."""

import numpy as np
import pytest

import multirod as mr
from multirod.studies.experiment import motion

INTEGRATOR = mr.RK4(100)
DESCENT = mr.EnergyDescent(integrator=INTEGRATOR)


def snapping():
    """The paper's motion with twice its rod's length: at 2.23 s the equilibrium ends in a fold."""
    rod = mr.Rod(length=0.8, bending_stiffness=0.223349, torsional_stiffness=0.063814, precurvature=(14, 5, 0))
    robot = mr.SingleRod(rod)
    time = 1.8 + np.arange(161) / 200
    angle = 2 * np.pi * time / 10
    force = np.stack([np.sin(angle), np.cos(angle), np.sin(angle)], axis=-1)
    return robot, robot.inputs(rotation=angle, tip_force=force), time


def settled(robot, inputs, first):
    """The equilibria that descent in short steps leads to from one sample to the next."""
    slow = mr.EnergyDescent(integrator=INTEGRATOR, radius=0.05, feed_forward=False)
    found = [first]
    for k in range(1, len(inputs.tip_force)):
        found.append(mr.solve(robot, inputs[k], solver=slow, guess=found[-1]).raise_if_failed())
    return found


def test_the_gradient_is_that_of_the_energy(robot):
    """(2): the energy of a rod in equilibrium but for its tip, by differences."""
    inputs = robot.inputs(tip_force=(0.5, 0.3, -0.4), distributed_force=(0.2, 0, 0.3))
    problem = robot.problem(inputs, integrator=mr.RK45(1e-10, 1e-12), pose_sensitivities=True, direction_count=1)
    x = np.array([[11.0, 8.0, 1.5]])
    eps, _ = problem.evaluate(x)
    turns = np.swapaxes(problem.read("rotation").reshape(3, 3), 0, 1) @ problem.pose_columns.numpy()[0, 3:, :3]
    expected = turns.T @ (problem.conjugates.unit.numpy()[0] * eps[0])
    step = 1e-4
    slope = []
    for k in range(3):
        energy = []
        for sign in (1, -1):
            problem.evaluate(x + sign * step * np.eye(3)[k])
            energy.append(problem.stability.potential()[0])
        slope.append((energy[0] - energy[1]) / (2 * step))
    # the differences' own error is step^2 times a third derivative of order one
    np.testing.assert_allclose(slope, expected, rtol=0, atol=1e-6 * np.abs(expected).max())


def test_the_margin_is_that_of_the_stability_test(robot):
    """(3), against the second variation condensed by other means."""
    force = np.random.default_rng(3).normal(size=(6, 3))
    inputs = robot.inputs(tip_force=force)
    found = mr.solve(robot, inputs, solver=mr.Shooting(integrator=INTEGRATOR))
    problem = robot.problem(inputs, integrator=INTEGRATOR, pose_sensitivities=True, direction_count=1)
    track = DESCENT.track(problem, 0.005)
    track.start(found.unknowns)
    track.step()
    np.testing.assert_allclose(track.state.margin.numpy(), found.stability_margin, rtol=1e-5)


def test_along_the_papers_motion_it_has_no_lag():
    study = motion(duration=2)
    inputs = {"time": study.time, "progress": False}
    exact = mr.simulate(study.robot, study.inputs, solver=mr.Shooting(integrator=INTEGRATOR), **inputs)
    found = mr.simulate(study.robot, study.inputs, solver=DESCENT, **inputs)
    assert (found.integrations == 1).all()
    error = np.linalg.norm(found.tip_position - exact.tip_position, axis=1)[60:]
    nodes = [run.rod(0, nodes=11).position for run in (found, exact)]
    assert np.linalg.norm(nodes[0] - nodes[1], axis=-1)[60:].max() < 1e-7  # the whole shape, not the tip alone
    lagging = mr.simulate(study.robot, study.inputs, solver=mr.Observer(integrator=INTEGRATOR), **inputs)
    lag = np.linalg.norm(lagging.tip_position - exact.tip_position, axis=1)[60:]
    assert error.max() < 1e-7  # of the second order in what the inputs do by surprise in 5 ms, corrected
    assert lag.max() > 3e-4
    assert (found.status[1:] == mr.Status.TRACKING).all()  # the first starts far off


def test_it_follows_a_snap_and_says_so():
    robot, inputs, time = snapping()
    newton = mr.Shooting(integrator=INTEGRATOR, fallback=False, at_fold="stop")
    first = mr.solve(robot, inputs[0], solver=newton)
    lost = mr.simulate(robot, inputs, time=time, solver=newton, guess=first)
    fold = int(np.argmax(lost.status == mr.Status.BRANCH_END))
    assert 80 < fold < 90, "no fold: the test tests nothing"
    reference = settled(robot, inputs, first)
    assert all(each.stability == mr.Stability.STABLE for each in reference)
    found = mr.simulate(robot, inputs, time=time, solver=DESCENT, guess=first)
    tip = np.array([each.tip_position for each in reference])
    assert np.linalg.norm(np.diff(tip, axis=0), axis=1).max() > 0.05
    error = np.linalg.norm(found.tip_position - tip, axis=1)
    # near a fold what the inputs do in a sample is no small step
    assert error[: fold - 8].max() < 1e-5
    assert error[fold + 20 :].max() < 1e-6
    wrong = error > 5e-3  # 2.8 mm one sample before, where nothing tells yet
    assert 0 < wrong.sum() < 8, "none: the test tests nothing"
    assert (found.status[wrong] == mr.Status.NEAR_FOLD).all()
    assert (found.status[fold + 20 :] == mr.Status.TRACKING).all()


def test_the_first_sample_past_a_fold_is_said_whenever_it_is_taken():
    """(17): the margin may still be above the threshold where the equilibrium is gone."""
    rod = mr.Rod(length=np.full(16, 0.8), bending_stiffness=0.223349, torsional_stiffness=0.063814, precurvature=(14, 5, 0))
    robot, time = mr.SingleRod(rod), 2.15 + np.arange(24) / 200
    angle = 2 * np.pi / 10 * (time[:, None] + np.arange(16) / 16 / 200)
    inputs = robot.inputs(rotation=angle, tip_force=np.stack([np.sin(angle), np.cos(angle), np.sin(angle)], axis=-1))
    newton = mr.Shooting(integrator=INTEGRATOR, fallback=False, at_fold="stop")
    first = mr.solve(robot, inputs[0], solver=newton)
    lost = mr.simulate(robot, inputs, time=time, solver=newton, guess=first)
    past = (lost.status == mr.Status.BRANCH_END).argmax(axis=0), np.arange(16)
    found = mr.simulate(robot, inputs, time=time, solver=DESCENT, guess=first)
    assert (found.stability_margin[past] > 0.025).any(), "the threshold tells of all: the test tests nothing"
    assert (found.status[past] == mr.Status.NEAR_FOLD).all()
    assert (found.status[:8] == mr.Status.TRACKING).all()


def test_a_step_in_the_inputs_is_said(robot):
    time = np.arange(12) / 200
    force = np.where(time[:, None] < time[6], 0.0, (0.6, 0, 0.4))
    rising = robot.inputs(tip_force=force)
    found = mr.simulate(robot, rising, time=time, solver=DESCENT)
    exact = mr.simulate(robot, rising, time=time, solver=mr.Shooting(integrator=INTEGRATOR))
    wrong = np.linalg.norm(found.tip_position - exact.tip_position, axis=1) > 1e-4
    assert wrong.any(), "followed at once: the test tests nothing"
    assert (found.status[wrong] == mr.Status.NEAR_FOLD).all()
    assert (found.status[-3:] == mr.Status.TRACKING).all()


def test_it_leaves_what_is_unstable():
    """A straight column beyond Euler's load is an equilibrium, and Newton's method stays on it."""
    rod = mr.Rod(length=1, bending_stiffness=(1, 1.5), torsional_stiffness=0.8)
    robot = mr.SingleRod(rod)
    pressed = robot.inputs(tip_force=(0, 0, -4))
    newton = mr.solve(robot, pressed, guess=(0, 0, 0), solver=mr.Shooting(integrator=INTEGRATOR))
    assert newton.stability == mr.Stability.UNSTABLE
    descent = mr.solve(robot, pressed, guess=newton, solver=DESCENT).raise_if_failed()
    assert descent.stability == mr.Stability.STABLE
    assert descent.potential < newton.potential - 0.1
    # as Euler has it: alpha = 4 EI/L^2 about the softer axis; the angle of the tip, from K(sin(angle/2)) = 2
    assert abs(np.arccos(descent.tip_rotation[2, 2]) - 2 * np.arcsin(modulus(2.0))) < 1e-5


def modulus(period):
    from scipy.optimize import brentq
    from scipy.special import ellipk

    return brentq(lambda k: ellipk(k * k) - period, 0.01, 0.999)


def test_without_a_guess_it_says_where_the_natural_branch_ends(robot):
    inputs = robot.inputs(tip_force=(0.5, 0.2, -0.3))
    found = mr.solve(robot, inputs, solver=DESCENT).raise_if_failed()
    exact = mr.solve(robot, inputs, solver=mr.Shooting(integrator=INTEGRATOR))
    # both residuals are within 1e-9 1/m, which is L^2/2 times as much at the tip, and what Gamma makes of it
    np.testing.assert_allclose(found.tip_position, exact.tip_position, rtol=0, atol=5e-9)
    rod = mr.Rod(length=1, bending_stiffness=1, torsional_stiffness=0.8)
    column = mr.SingleRod(rod)
    lost = mr.solve(column, column.inputs(tip_force=(0, 0, -4)), solver=DESCENT)
    assert lost.status == mr.Status.BRANCH_END
    assert np.isnan(lost.tip_position).all()


def test_an_instance_does_not_depend_on_its_batch(robot):
    time = np.arange(40) / 200
    force = np.random.default_rng(0).normal(size=(3, 3))[None] * np.sin(6 * time)[:, None, None]
    batch = mr.simulate(robot, robot.inputs(tip_force=force), time=time, solver=DESCENT)
    for k in range(3):
        alone = mr.simulate(robot, robot.inputs(tip_force=force[:, k]), time=time, solver=DESCENT)
        np.testing.assert_array_equal(batch.tip_position[:, k], alone.tip_position)


@pytest.mark.parametrize("field", ["radius", "fold_threshold", "tolerance", "max_iterations", "ramp", "feed_forward"])
def test_options_out_of_range_are_refused(field):
    with pytest.raises(ValueError, match=f"EnergyDescent.{field} = -1 is not allowed"):
        mr.EnergyDescent(**{field: -1})
