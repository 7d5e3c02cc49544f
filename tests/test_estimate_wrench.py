"""Loads from what force/torque sensors say where rods are held: ``docs/estimation.md``, (22)."""

import numpy as np
import pytest
from test_platform_derivatives import VALUES, made

import multirod as mr

SIGMA = 0.25  # [N]
PRIOR = {"tip_force": mr.Prior(0, sigma=SIGMA)}
CELL = (0.02, 5e-4)  # [N], [N m]
FORCES = SIGMA * np.random.default_rng(4).normal(size=(40, 3))


def sensed(solution, sigma=CELL, rod=0, noise=0.0):
    own, random = solution.wrench(rod), np.random.default_rng(7)
    force, moment = (
        value + noise * s * random.normal(size=value.shape) for value, s in zip((own.force, own.moment), sigma, strict=True)
    )
    return mr.ForceTorque(force=force, moment=moment, sigma=sigma, rod=rod)


def test_a_force_alone_is_read_as_it_is(wire):
    """The force at the base is that on the tip: mean and covariance are those of three numbers and their priors."""
    robot = mr.SingleRod(wire)
    truth = mr.solve(robot, robot.inputs(tip_force=FORCES))
    cell = mr.ForceTorque(force=truth.wrench().force, sigma=CELL[0])
    found = mr.estimate(robot, unknown=PRIOR, measured=cell).raise_if_failed()
    variance = 1 / (1 / SIGMA**2 + 1 / CELL[0] ** 2)
    # both to the tolerance of the solve
    np.testing.assert_allclose(found.value("tip_force"), FORCES * variance / CELL[0] ** 2, rtol=0, atol=1e-8)
    np.testing.assert_allclose(found.covariance("tip_force"), np.tile(variance * np.eye(3), (40, 1, 1)), rtol=0, atol=1e-10)


def test_force_and_moment_are_as_good_as_they_say(wire):
    """Of noisy sensors: the errors, by their covariances, have the squares of normal numbers."""
    robot = mr.SingleRod(wire)
    truth = mr.solve(robot, robot.inputs(tip_force=FORCES))
    found = mr.estimate(robot, unknown=PRIOR, measured=sensed(truth, noise=1.0))
    error, covariance = found.raise_if_failed().value("tip_force") - FORCES, found.covariance("tip_force")
    # of 120 squares: four standard deviations are 0.52
    assert 0.5 < np.einsum("bi,bij,bj->", error, np.linalg.inv(covariance), error) / error.size < 1.5
    assert (found.degrees == 6).all()
    # the moment adds to what the force says
    assert (found.sigma("tip_force") < 1 / np.hypot(1 / SIGMA, 1 / CELL[0])).any()


def test_a_force_on_a_platform_is_read_at_the_bases_of_its_legs():
    """Of all legs the forces add up to it; (5) of all rows against sums of squares by solves."""
    robot = made("every joint")
    given, force = {"translation": VALUES["every joint"]["translation"]}, np.array([0.6, -0.4, 0.5])
    truth = mr.solve(robot, robot.inputs(tip_force=force, **given)).raise_if_failed()
    cells = [sensed(truth, rod=k) for k in range(3)]
    prior = {"tip_force": mr.Prior(0, sigma=10.0)}
    found = mr.estimate(robot, robot.inputs(**given), unknown=prior, measured=cells).raise_if_failed()
    spread = found.sigma("tip_force")
    assert (np.abs(found.value("tip_force") - force) < 0.05 * spread).all()  # drawn to the prior's mean
    # the forces add up to the force less the weight: three sensors say it to no worse than that
    assert (spread <= np.sqrt(3) * CELL[0]).all()
    rows = []
    for change in 1e-3 * np.eye(3):
        ends = [mr.solve(robot, robot.inputs(tip_force=force + sign * change, **given), guess=truth) for sign in (1, -1)]
        told = [
            np.concatenate([[*own.wrench(k).force / CELL[0], *own.wrench(k).moment / CELL[1]] for k in range(3)]) for own in ends
        ]
        rows.append((told[0] - told[1]) / 2e-3)
    J = np.array(rows).T
    expected = np.linalg.inv(J.T @ J + np.eye(3) / 100)
    np.testing.assert_allclose(found.covariance("tip_force"), expected, rtol=0, atol=1e-4 * expected.max())


def test_a_stiffness_is_read_at_the_base_of_a_rod_that_is_held_at_both_ends():
    """The wrench is as large as the stiffness: twice the one is twice the other."""
    rod = mr.Rod(length=0.4, bending_stiffness=0.02, torsional_stiffness=0.015)
    end = np.array(
        [[1.0, 0, 0, 0.05], [0, 1, 0, 0], [0, 0, 1, 0.396], [0, 0, 0, 1]]
    )  # so near its length that it bends in a plane
    robot = mr.HeldRod(rod, end=end)
    truth = mr.solve(robot).raise_if_failed()
    own = truth.wrench()
    twice = mr.ForceTorque(force=2 * own.force, moment=2 * own.moment, sigma=(1e-3, 1e-4))
    fit = mr.calibrate(robot, parameters="bending_stiffness", measured=twice)
    np.testing.assert_allclose(fit.value("bending_stiffness"), 2.0, rtol=1e-5)
    assert "over what" in repr(fit)


def test_in_a_loop_a_sample_is_one_integration(wire):
    """What drops out is gone without; the sample is what ``estimate`` says of it."""
    robot = mr.SingleRod(wire)
    truth = mr.solve(robot, robot.inputs(tip_force=FORCES[0]))
    own = truth.wrench()
    meter = mr.Estimator(robot, dt=1e-3, unknown={"tip_force": mr.Walk(0.1, start=PRIOR["tip_force"])}, sensors=sensed(truth))
    first = meter.step([(own.force, own.moment)])
    alone = mr.estimate(robot, unknown=PRIOR, measured=sensed(truth))
    np.testing.assert_allclose(first.value("tip_force"), alone.value("tip_force"), rtol=0, atol=1e-9)
    for _ in range(5):
        sample = meter.step([(own.force, own.moment)])
        assert sample.integrations == 1
    assert (np.abs(sample.value("tip_force") - FORCES[0]) < sample.sigma("tip_force")).all()
    part = meter.step([(own.force, np.full(3, np.nan))])
    assert part.missing.all()
    assert part.dropped == ("3 of 6 numbers of sensor 0",)
    assert meter.step([None]).dropped == ("sensor 0",)
    for wrong in (own, own.force, (own.force,)):
        with pytest.raises(ValueError, match=r"^measured\[0\] = .* must be \(force, moment\)$"):
            meter.step([wrong])


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"sigma": 1.0}, "^ForceTorque needs a force, a moment, or both$"),
        ({"force": (1, 0, 0), "moment": (0, 0, 0), "sigma": 1.0}, r"sigma = 1.0 .* a pair: of the force \[N\] and of the moment"),
        ({"force": (1, 0, 0), "sigma": 0.0}, r"sigma = 0.0 .* must be finite and > 0"),
        ({"moment": (1, 0), "sigma": 1.0}, r"^ForceTorque.moment = \(1, 0\) .* shape \(\.\.\., 3\)"),
        ({"force": (np.inf, 0, 0), "sigma": 1.0}, "^ForceTorque.force = .* finite, or NaN"),
        ({"force": np.ones((2, 3)), "moment": np.ones((4, 3)), "sigma": (1, 1)}, "leading axes .* must broadcast"),
        ({"force": (1, 0, 0), "sigma": 1.0, "at": -0.1}, "^ForceTorque.at = -0.1"),
    ],
)
def test_bad_sensors(options, message):
    with pytest.raises(ValueError, match=message):
        mr.ForceTorque(**options)


def test_a_rod_that_is_none_and_a_wrench_that_is_no_sensor(wire):
    robot = mr.SingleRod(wire)
    with pytest.raises(ValueError, match="^ForceTorque.rod = 3"):
        mr.estimate(robot, unknown=PRIOR, measured=mr.ForceTorque(force=(0, 0, 0), sigma=1.0, rod=3))
    with pytest.raises(TypeError, match=r"ForceTorque\(force=w.force, moment=w.moment, sigma="):
        mr.ForceTorque(mr.solve(robot).wrench(), sigma=1.0)
