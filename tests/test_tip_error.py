"""How far a solution says that it is off: against what is known in closed form, and against itself."""

import numpy as np
import pytest

import multirod as mr
from multirod.studies.scenes import six_legs

LENGTH, EI = 0.4, 0.02
MOMENT = 0.3


def _arc():
    """A rod bent by a moment at its tip, and where that is: a circle."""
    robot = mr.SingleRod(mr.Rod(length=LENGTH, bending_stiffness=EI, torsional_stiffness=0.7 * EI))
    k = MOMENT / EI
    return robot, robot.inputs(tip_moment=(MOMENT, 0, 0)), np.array([0, -(1 - np.cos(k * LENGTH)) / k, np.sin(k * LENGTH) / k])


@pytest.mark.parametrize("steps", [20, 50])
def test_of_equal_steps_it_is_the_error(steps):
    """To what the finer one leaves of it."""
    robot, inputs, tip = _arc()
    solution = mr.solve(robot, inputs, solver=mr.Shooting(integrator=mr.RK4(steps)))
    off = np.linalg.norm(solution.tip_position - tip)
    assert off > 1e-8
    assert solution.tip_error == pytest.approx(off, rel=1e-3)


def test_a_residual_that_is_left_counts():
    """That of an observer in a motion."""
    robot = mr.SingleRod(mr.Rod(length=LENGTH, bending_stiffness=EI, torsional_stiffness=0.7 * EI, precurvature=(5, 0, 0)))
    time = np.linspace(0, 0.1, 11)
    force = np.stack([0 * time, 2 * time, 0 * time], axis=1)
    history = mr.simulate(robot, robot.inputs(tip_force=force), time=time, solver=mr.Observer(R=120, Q=30))
    exact = mr.solve(robot, robot.inputs(tip_force=force))
    off = np.linalg.norm(history.tip_position - exact.tip_position, axis=1)
    assert off[1:].min() > 1e-5
    np.testing.assert_allclose(history.tip_error, off, rtol=0, atol=2e-9)  # that of the exact ones


def test_of_a_batch_each_its_own_and_none_of_what_failed():
    """Designs of which one is not solved."""
    stiffness = np.array([EI, 2 * EI, 3 * EI])
    robot = mr.SingleRod(mr.Rod(length=LENGTH, bending_stiffness=stiffness[:, None], torsional_stiffness=EI))
    force = np.array([(0.5, 0.0, 0.0), (0.0, 0.0, -10.0), (0.0, 0.5, 0.5)])
    solution = mr.solve(robot, robot.inputs(tip_force=force), solver=mr.Shooting(integrator=mr.RK4(30), at_fold="stop"))
    assert solution.failed.tolist() == [False, True, False]
    alone = [mr.solve(robot[k], robot[k].inputs(tip_force=force[k]), solver=mr.Shooting(integrator=mr.RK4(30))) for k in (0, 2)]
    np.testing.assert_array_equal(solution.tip_error[[0, 2]], [one.tip_error for one in alone])
    assert np.isnan(solution.tip_error[1])
    # Euler's load, where the branch ends
    euler = np.pi**2 / 4 * 2 * EI / LENGTH**2
    np.testing.assert_allclose(solution.load_factor, (1.0, euler / 10, 1.0), rtol=1e-3)


def test_a_platform_whose_pose_is_an_unknown_is_off_by_what_its_residual_leaves():
    """Within the usual tolerance nothing was to be solved again, and it was said to be exact."""
    motion = six_legs().first(3)
    solution = mr.solve(motion.robot, motion.inputs, solver=mr.Shooting(integrator=mr.RK4(120)))
    exact = mr.Shooting(tolerance=1e-12, integrator=mr.RK45(1e-12, 1e-14))
    off = np.linalg.norm(
        mr.solve(motion.robot, motion.inputs, solver=exact, guess=solution).tip_position - solution.tip_position, axis=1
    )
    assert off.min() > 1e-12
    np.testing.assert_allclose(solution.tip_error, off, rtol=0.05)
    solution = mr.solve(motion.robot, motion.inputs, solver=mr.Shooting(integrator=mr.RK4(200)))
    assert (solution.tip_error > 0).all()
