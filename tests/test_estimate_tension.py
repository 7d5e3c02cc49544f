"""Loads from the tensions of lines that are driven by their length: ``docs/estimation.md``, (23)."""

import numpy as np
import pytest
from scipy.optimize import least_squares

import multirod as mr

AROUND = 0.006 * np.array([(np.cos(a), np.sin(a)) for a in (0.0, 2.1, 4.2)])
SIGMA, PRIOR = 0.02, {"tip_force": mr.Prior(0, sigma=1.0)}  # [N]
PULLED = (2e-3, 1.0e-3, 1.2e-3)
FORCE = np.array((0.1, 0.2, -0.05))


def finger():
    lines = [
        mr.Tendon(offset=at, driven="displacement", axial_stiffness=5e3, name=name)
        for name, at in zip("abc", AROUND, strict=True)
    ]
    return mr.Rod(length=0.2, bending_stiffness=0.02, torsional_stiffness=0.015, lines=lines)


@pytest.fixture(scope="module")
def pulled():
    robot = mr.SingleRod(finger())
    return mr.solve(robot, robot.inputs(tip_force=FORCE, displacement=PULLED)).raise_if_failed()


def test_a_force_is_read_from_tensions(pulled):
    """Mean and covariance are those of a least-squares search by solves alone, with noisy tensions of two of three lines."""
    robot, noise = pulled.assembly, SIGMA * np.array((0.8, -1.1))
    told, sigma = pulled.tension[[2, 0]] + noise, np.array((SIGMA, 2 * SIGMA))
    sensors = [
        mr.Tension(value=told, sigma=sigma, line=["c", "a"]),
        mr.Pose(position=pulled.tip_position, sigma=1e-3),
    ]
    known = robot.inputs(displacement=PULLED)
    found = mr.estimate(robot, known, unknown=PRIOR, measured=sensors).raise_if_failed()

    def rows(force):
        own = mr.solve(
            robot, robot.inputs(tip_force=force, displacement=PULLED), guess=pulled, solver=mr.Shooting(tolerance=1e-11)
        )
        return np.concatenate([(own.tension[[2, 0]] - told) / sigma, (own.tip_position - pulled.tip_position) / 1e-3, force])

    best = least_squares(rows, np.zeros(3), jac="3-point", xtol=1e-14, ftol=1e-14, gtol=1e-12)
    expected = np.linalg.inv(best.jac.T @ best.jac)
    # of its standard deviation; differences are good to 1e-5 of what they are of
    np.testing.assert_allclose(found.value("tip_force"), best.x, rtol=0, atol=1e-4 * np.sqrt(np.diag(expected)).max())
    np.testing.assert_allclose(found.covariance("tip_force"), expected, rtol=0, atol=1e-4 * expected.max())
    np.testing.assert_allclose(
        found.solution.jacobian("tip_force", of="tension")[[2, 0]] / sigma[:, None], best.jac[:2], rtol=1e-4
    )


def test_what_is_across_is_seen_and_what_is_along_is_not(pulled):
    robot = pulled.assembly
    found = mr.estimate(
        robot, robot.inputs(displacement=PULLED), unknown=PRIOR, measured=mr.Tension(value=pulled.tension, sigma=1e-3)
    )
    variances, ways = np.linalg.eigh(found.raise_if_failed().covariance("tip_force"))
    assert abs(ways[:, 2] @ found.solution.tip_rotation[:, 2]) > 0.9  # what compresses it bends it hardly
    assert variances[2] > 0.9
    assert variances[1] < 1e-3
    assert not found.observable["tip_force"].all()


def test_in_a_loop_a_sample_is_one_integration(pulled):
    robot = pulled.assembly
    walk = {"tip_force": mr.Walk(0.1, start=PRIOR["tip_force"])}
    cells = mr.Tension(value=(0, 0, 0), sigma=SIGMA)
    meter = mr.Estimator(robot, dt=1e-3, unknown=walk, sensors=cells, inputs=robot.inputs(displacement=PULLED))
    first = meter.step([pulled.tension])
    alone = mr.estimate(
        robot, robot.inputs(displacement=PULLED), unknown=PRIOR, measured=mr.Tension(value=pulled.tension, sigma=SIGMA)
    )
    np.testing.assert_allclose(first.value("tip_force"), alone.value("tip_force"), rtol=0, atol=1e-9)
    for _ in range(5):
        sample = meter.step([pulled.tension])
        assert sample.integrations == 1
    assert (np.abs(sample.value("tip_force") - FORCE) < sample.sigma("tip_force")).all()
    lost = np.array(pulled.tension)
    lost[1] = np.nan
    assert meter.step([lost]).dropped == ("1 of 3 numbers of sensor 0",)
    assert meter.step([None]).dropped == ("sensor 0",)
    for wrong in (1.0, (1.0, 2.0)):
        with pytest.raises(ValueError, match=r"^measured\[0\] = .* must have shape \(\.\.\., 3\), one number of each line$"):
            meter.step([wrong])


def test_of_a_network_lines_are_those_of_its_rods(pulled):
    """A force on the body that its one rod holds is that on the rod's tip."""
    top = mr.Body("top")
    joints = [mr.Joint("finger", "base", to=mr.ground), mr.Joint("finger", "tip", to=top)]
    robot = mr.Network(rods={"finger": finger()}, bodies=[top], joints=joints)
    known = robot.inputs(displacement=PULLED)
    sensors = [mr.Tension(value=pulled.tension, sigma=SIGMA), mr.Pose(position=pulled.tip_position, sigma=1e-3)]
    found = mr.estimate(robot, known, unknown={"force": mr.Prior(0, sigma=1.0)}, measured=sensors).raise_if_failed()
    single = pulled.assembly
    alone = mr.estimate(single, single.inputs(displacement=PULLED), unknown=PRIOR, measured=sensors).raise_if_failed()
    np.testing.assert_allclose(found.value("force").ravel(), alone.value("tip_force"), rtol=0, atol=1e-6)
    scale = alone.covariance("tip_force").max()
    np.testing.assert_allclose(found.covariance("force"), alone.covariance("tip_force"), rtol=0, atol=1e-6 * scale)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"value": 1.0, "sigma": 1.0}, r"^Tension.value = 1.0 .* shape \(\.\.\., count\)"),
        ({"value": (1.0, 2.0), "sigma": 1.0, "line": ("a", "a")}, "^Tension.line = .* must be 2, each once"),
        ({"value": (1.0, 2.0), "sigma": 0.0}, "^Tension.sigma = 0.0 .* > 0"),
        ({"value": (1.0, 2.0), "sigma": (1, 1, 1)}, "^Tension.sigma = .* must be one number, or 2"),
        ({"value": (1.0, np.inf), "sigma": 1.0}, "^Tension.value = .* finite, or NaN"),
    ],
)
def test_bad_sensors(options, message):
    with pytest.raises(ValueError, match=message):
        mr.Tension(**options)


def test_lines_that_are_none(wire):
    robot = mr.SingleRod(finger())
    for sensor, message in (
        (mr.Tension(value=(1, 2), sigma=1.0), r"^Tension.value = .* must be \(\.\.\., 3\), one number of each line"),
        (mr.Tension(value=1.0, sigma=1.0, line="d"), r"^Tension.line = 'd' .* names \['a', 'b', 'c'\]"),
    ):
        with pytest.raises(ValueError, match=message):
            mr.estimate(robot, unknown=PRIOR, measured=sensor)
    with pytest.raises(ValueError, match="no rod has lines$"):
        mr.estimate(mr.SingleRod(wire), unknown=PRIOR, measured=mr.Tension(value=(1,), sigma=1.0))
