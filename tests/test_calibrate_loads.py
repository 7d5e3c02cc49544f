"""Robots fitted to shapes under loads that nobody knows, against a Gauss-Newton method of this file on ``measured_rods``."""

import numpy as np
import pytest
from measured_rods import MeasuredRod, turned_by
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

import multirod as mr

POSITION, ANGLE = 1e-4, 1e-3
REAL = {"bending_stiffness": 0.24, "torsional_stiffness": 0.063814, "precurvature": (14, 5, 0)}
MODEL = REAL | {"bending_stiffness": 0.2233}


@pytest.fixture(scope="module")
def shapes():
    """Five poses under forces, by a noisy sensor."""
    random = np.random.default_rng(4)
    force = 0.5 * random.normal(size=(5, 3))
    position, rotation, _, _ = MeasuredRod(0.4, **REAL).seen(force)
    position = position + POSITION * random.normal(size=(5, 3))
    return force, position, turned_by(ANGLE * random.normal(size=(5, 3))) @ rotation


def seen(shapes, rows=slice(None)):
    return mr.Pose(position=shapes[1][rows], rotation=shapes[2][rows], sigma=(POSITION, ANGLE))


def off(numbers, shapes):
    """(13b) All that is off, in standard deviations, at the logarithm of the factor and the forces of all shapes."""
    force = numbers[1:].reshape(-1, 3)
    made = MODEL | {"bending_stiffness": MODEL["bending_stiffness"] * np.exp(numbers[0])}
    position, rotation, _, _ = MeasuredRod(0.4, **made).seen(force)
    turn = Rotation.from_matrix(rotation @ np.swapaxes(shapes[2], 1, 2)).as_rotvec()
    return np.concatenate([((position - shapes[1]) / POSITION).ravel(), (turn / ANGLE).ravel()])


def test_a_model_that_cannot_explain_shapes_far_away_is_fitted(shapes):
    """Under some 3 N that nobody knows, of a wire that is curved otherwise: steps that lead astray are taken back to where the
    rod is at rest, and it ends where a fit does that begins at the true forces."""
    random = np.random.default_rng(3)
    force = 3 * random.normal(size=(6, 3))
    position, rotation, _, _ = MeasuredRod(0.4, **REAL | {"precurvature": (13, 6, 0.5)}).seen(force)
    random = np.random.default_rng(1001)
    far = (
        force,
        position + POSITION * random.normal(size=(6, 3)),
        turned_by(ANGLE * random.normal(size=(6, 3))) @ rotation,
    )
    robot = mr.SingleRod(mr.Rod(length=0.4, **MODEL))
    fit = mr.calibrate(robot, parameters="bending_stiffness", unknown="tip_force", measured=seen(far)).raise_if_failed()
    begun, known = robot.inputs(tip_force=force), {"unknown": "tip_force", "measured": seen(far)}
    near = mr.calibrate(robot, begun, parameters="bending_stiffness", **known).raise_if_failed()
    np.testing.assert_allclose(fit.misfit, near.misfit, rtol=1e-6)
    np.testing.assert_allclose(fit.value("tip_force"), near.value("tip_force"), atol=0.05 * near.sigma("tip_force").max())
    assert not fit.consistent


def test_a_stiffness_and_the_forces_of_all_shapes_are_those_of_another_method(shapes):
    robot = mr.SingleRod(mr.Rod(length=0.4, **MODEL))
    fit = mr.calibrate(robot, parameters="bending_stiffness", unknown="tip_force", measured=seen(shapes)).raise_if_failed()
    other = least_squares(
        off, np.concatenate([[0.0], shapes[0].ravel()]), jac="3-point", args=(shapes,), xtol=1e-12, ftol=1e-12, gtol=1e-12
    )
    covariance = np.linalg.inv(other.jac.T @ other.jac)
    factor = np.exp(other.x[0])
    # a hundredth of a deviation is where steps end; the model integrates otherwise, to 1e-6 m of the 1e-4 m that sensors are off
    assert abs(fit.value("bending_stiffness")[0] - factor) < 0.03 * fit.sigma("bending_stiffness")[0]
    assert (np.abs(fit.value("tip_force").ravel() - other.x[1:]) < 0.03 * fit.sigma("tip_force").ravel()).all()
    np.testing.assert_allclose(fit.misfit, 2 * other.cost, rtol=1e-2)
    np.testing.assert_allclose(fit.covariance(), covariance[:1, :1] * factor**2, rtol=1e-2)
    for k in range(5):
        own = slice(1 + 3 * k, 4 + 3 * k)
        expected = covariance[own, own]
        size = np.sqrt(np.outer(expected.diagonal(), expected.diagonal()))
        np.testing.assert_allclose(fit.covariance("tip_force")[k] / size, expected / size, atol=1e-2)
    assert fit.degrees == 5 * 6 - 1 - 15
    assert fit.unknown == ("tip_force",)
    np.testing.assert_array_equal(fit.solution.inputs.tip_force, fit.value("tip_force"))
    # the truth is as far as it says, of sixteen normal numbers: 99.9 % of their squares' sums are below 39
    error = np.concatenate([[np.log(REAL["bending_stiffness"] / MODEL["bending_stiffness"])], shapes[0].ravel()]) - other.x
    assert error @ np.linalg.solve(covariance, error) < 39
    assert "and tip_force of each shape" in repr(fit)


def test_what_poses_tell_over_the_stiffness_alone_is_not_determined(shapes, tmp_path):
    """Of a straight rod, whose force over its stiffnesses poses tell: without a prior of either none is known, with one both."""
    straight = {"bending_stiffness": 0.24, "torsional_stiffness": 0.06}
    robot = mr.SingleRod(mr.Rod(length=0.4, **straight))
    shape = mr.solve(robot, robot.inputs(tip_force=(0.3, 0.2, 0.1)))
    pose = mr.Pose(position=shape.tip_position, rotation=shape.tip_rotation, sigma=(POSITION, ANGLE))
    both = ("bending_stiffness", "torsional_stiffness")
    begin = robot.inputs(tip_force=(0.3, 0.2, 0.1))
    fit = mr.calibrate(robot, begin, parameters=[both], unknown="tip_force", measured=pose)
    assert np.isinf(fit.sigma(both)).all()
    assert np.isinf(fit.sigma("tip_force")).all()
    assert not fit.observable["tip_force"].any()
    assert not fit.observable[both].any()
    assert "tip_force[2]" in repr(fit)
    priors = {both: mr.Prior(sigma=0.05)}
    told = mr.calibrate(robot, begin, parameters=priors, unknown="tip_force", measured=pose).raise_if_failed()
    np.testing.assert_allclose(told.sigma(both), 0.05, rtol=1e-6)
    # five per cent of the force along itself: that is of the stiffness alone
    along = np.array([0.3, 0.2, 0.1]) / np.linalg.norm([0.3, 0.2, 0.1])
    spread = np.sqrt(along @ told.covariance("tip_force") @ along)
    assert 0.05 * np.linalg.norm([0.3, 0.2, 0.1]) <= spread * (1 + 1e-6)
    told.save(tmp_path / "told.npz")
    again = mr.load(tmp_path / "told.npz")
    np.testing.assert_array_equal(again.covariance("tip_force"), told.covariance("tip_force"))
    assert repr(again) == repr(told)


@pytest.mark.parametrize(
    ("options", "error", "message"),
    [
        ({"unknown": "tension"}, TypeError, "tension"),
        ({"unknown": "translation"}, ValueError, "inputs that the robot does not limit"),
        ({"unknown": {"tip_force": mr.Prior()}}, ValueError, "must be names"),
        ({"unknown": ("tip_force", "tip_moment")}, ValueError, "7 numbers without a prior"),
    ],
)
def test_bad_unknowns(shapes, options, error, message):
    robot = mr.SingleRod(mr.Rod(length=0.4, **MODEL))
    with pytest.raises(error, match=message):
        mr.calibrate(robot, **({"parameters": "bending_stiffness", "measured": seen(shapes, 0)} | options))
