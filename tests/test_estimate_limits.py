"""Estimates stay within what the robot can do: against bounded least squares by differences, nothing of the package's steps."""

import numpy as np
import pytest
from scipy.optimize import least_squares

import multirod as mr

POSITION, ANGLE = 1e-4, 1e-3  # of the sensor
SIGMA, MEAN = 1.0, 0.5  # of the prior [N]


@pytest.fixture(scope="module")
def robot():
    around = [mr.Tendon(offset=(0.008 * np.cos(angle), 0.008 * np.sin(angle))) for angle in (0, 2.1, 4.2)]
    return mr.SingleRod(mr.Rod(length=0.2, bending_stiffness=0.01, torsional_stiffness=0.0077, lines=around))


def seen(robot, tension, off=(0, 0, 0)):
    """What a sensor says of the robot under these tensions, off by so much [m]."""
    tip = mr.solve(robot, robot.inputs(tension=tension))
    return mr.Pose(position=tip.tip_position + off, rotation=tip.tip_rotation, sigma=(POSITION, ANGLE))


@pytest.fixture(scope="module")
def slack(robot):
    """Two lines are slack, and the tip is seen a millimetre farther in the direction of the third."""
    return seen(robot, (1.5, 0, 0), (1e-3, 0, 0))


def bounded(robot, sensor, mean, covariance):
    """The most probable tensions that pull, by differences of equilibria."""
    root = np.linalg.inv(np.linalg.cholesky(covariance))

    def off(tension):
        tip = mr.solve(robot, robot.inputs(tension=np.maximum(tension, 0)))
        turned = tip.tip_rotation @ sensor.rotation.T
        angle = np.array([turned[2, 1] - turned[1, 2], turned[0, 2] - turned[2, 0], turned[1, 0] - turned[0, 1]]) / 2
        return np.concatenate([(tip.tip_position - sensor.position) / POSITION, angle / ANGLE, root @ (tension - mean)])

    return least_squares(off, np.full(3, 0.5), bounds=(0, np.inf), xtol=1e-12, ftol=1e-12)


def test_tensions_are_the_most_probable_ones_that_pull(robot, slack):
    found = mr.estimate(robot, unknown={"tension": mr.Prior(MEAN, sigma=SIGMA)}, measured=slack)
    expected = bounded(robot, slack, MEAN, SIGMA**2 * np.eye(3))
    # least_squares ends within its bounds: 1e-3 of the prior's deviation, far below what is known of a tension, 0.5
    np.testing.assert_allclose(found.value("tension"), expected.x, atol=1e-3 * SIGMA)
    np.testing.assert_allclose(found.misfit, 2 * expected.cost, rtol=1e-4)
    np.testing.assert_array_equal(found.value("tension")[1:], 0)
    np.testing.assert_array_equal(found.at_limit, [False, True, True])
    assert "at a limit: tension[1], tension[2]" in repr(found)
    again = mr.solve(robot, robot.inputs(tension=found.value("tension")))
    # the last step is a hundredth of a standard deviation at most
    np.testing.assert_allclose(found.solution.tip_position, again.tip_position, atol=0.01 * POSITION)


def test_the_covariance_is_as_if_there_were_no_limit(robot, slack):
    found = mr.estimate(robot, unknown={"tension": mr.Prior(MEAN, sigma=SIGMA)}, measured=slack)
    J = found.solution.jacobian("tension") / np.repeat([POSITION, ANGLE], 3)[:, None]
    expected = np.linalg.inv(J.T @ J + np.eye(3) / SIGMA**2)
    np.testing.assert_allclose(found.covariance("tension"), expected, rtol=1e-5, atol=1e-5)  # as near as the equilibrium is


def test_what_begins_at_a_limit_leaves_it(robot):
    """By the sign of its multiplier: all tensions are 0 at first."""
    sensor = seen(robot, (1.5, 0.3, 0.2))
    found = mr.estimate(robot, unknown={"tension": mr.Prior(0, sigma=SIGMA)}, measured=sensor)
    expected = bounded(robot, sensor, 0, SIGMA**2 * np.eye(3))
    np.testing.assert_allclose(found.value("tension"), expected.x, atol=1e-3 * SIGMA)  # as above
    np.testing.assert_array_equal(found.at_limit, [False, False, True])  # what all have in common is not seen, and small
    flat = mr.estimate(robot, unknown={"tension": mr.Prior(0, sigma=np.inf)}, measured=sensor)
    assert flat.value("tension").min() >= 0
    # the last step is a hundredth of a standard deviation at most
    np.testing.assert_allclose(flat.solution.tip_position, sensor.position, atol=0.01 * POSITION)


def test_each_of_a_batch_is_as_alone(robot, slack):
    """Bitwise, whether others are at a limit or not."""
    tight = seen(robot, (1.5, 0.8, 0.9))
    both = mr.Pose(
        position=np.array([slack.position, tight.position, slack.position]),
        rotation=np.array([slack.rotation, tight.rotation, slack.rotation]),
        sigma=(POSITION, ANGLE),
    )
    prior = {"tension": mr.Prior([[MEAN] * 3, [MEAN] * 3, [MEAN / 2] * 3], sigma=[[SIGMA] * 3, [SIGMA] * 3, [3 * SIGMA] * 3])}
    batch = mr.estimate(robot, unknown=prior, measured=both)
    np.testing.assert_array_equal(batch.at_limit.any(axis=1), [True, False, True])
    for k, (sensor, mean, sigma) in enumerate(((slack, MEAN, SIGMA), (tight, MEAN, SIGMA), (slack, MEAN / 2, 3 * SIGMA))):
        alone = mr.estimate(robot, unknown={"tension": mr.Prior(mean, sigma=sigma)}, measured=sensor)
        np.testing.assert_array_equal(alone.value("tension"), batch.value("tension")[k])


def test_tubes_stay_in_their_order():
    """Seen where the tip would be if the inner one began in front of the other, to first order."""
    tubes = [
        mr.Rod(length=length, bending_stiffness=EI, torsional_stiffness=EI / 1.3, precurvature=(curved, 0, 0))
        for length, EI, curved in ((0.3, 0.004, 9), (0.2, 0.02, 5))
    ]
    robot = mr.ConcentricTubes(tubes)
    tip = mr.solve(robot, robot.inputs(translation=(-0.1, -0.1)))
    between = mr.Pose(position=tip.tip_position + tip.jacobian("translation")[:3] @ (0.01, -0.01), sigma=POSITION)
    known = robot.inputs(translation=(-0.1, -0.1))
    found = mr.estimate(robot, known, unknown={"translation": mr.Prior(sigma=0.02)}, measured=between).raise_if_failed()
    assert found.at_limit.all()
    inner, outer = found.value("translation")
    assert outer - 1e-9 < inner <= outer  # kept by 1e-10 of what counts as one, a tenth of the length
    robot.inputs(translation=found.value("translation"))


def test_the_first_sample_of_a_loop_is_within_limits(robot, slack):
    walk = mr.Walk(1.0, start=mr.Prior(MEAN, sigma=SIGMA))
    meter = mr.Estimator(robot, dt=1e-2, unknown={"tension": walk}, sensors=slack)
    first = meter.step([(slack.position, slack.rotation)])
    np.testing.assert_array_equal(first.at_limit, [False, True, True])
    robot.inputs(tension=first.value("tension"))


def test_every_sample_of_a_loop_is_within_limits(robot, slack):
    """The second is the most probable one that pulls, from what the first knew; two robots, of which one has all lines tight."""
    tight, rate, dt = seen(robot, (1.5, 0.8, 0.9)), 1.0, 1e-2
    walk = mr.Walk(rate, start=mr.Prior(MEAN, sigma=SIGMA))
    places, turned = np.array([slack.position, tight.position]), np.array([slack.rotation, tight.rotation])
    sensor = mr.Pose(position=places, rotation=turned, sigma=(POSITION, ANGLE))
    meter = mr.Estimator(robot, dt=dt, unknown={"tension": walk}, sensors=sensor)
    first = meter.step([(places, turned)])
    further = seen(robot, (1.5, 0, 0), (1.05e-3, 0, 0))  # half a deviation
    second = meter.step([(np.array([further.position, tight.position]), np.array([further.rotation, tight.rotation]))])
    expected = bounded(robot, further, first.value("tension")[0], first.covariance("tension")[0] + rate**2 * dt * np.eye(3))
    # one step of a linear model, from half a deviation away
    np.testing.assert_allclose(second.value("tension")[0], expected.x, atol=1e-3 * SIGMA)
    np.testing.assert_array_equal(second.value("tension")[0, 1:], 0)
    np.testing.assert_array_equal(second.at_limit, [[False, True, True], [False, False, False]])
    assert (second.status == mr.Status.TRACKING).all()
    robot.inputs(tension=second.value("tension"))
    # what the next sample expects are the unknowns of these tensions, to the second order of the step
    tip = mr.solve(robot, robot.inputs(tension=second.value("tension")[0]), guess=second.solution.unknowns[0])
    np.testing.assert_allclose(second.solution.unknowns[0], tip.unknowns, atol=1e-4 * np.abs(tip.unknowns).max())


@pytest.mark.parametrize(("unknown", "stretch"), [("tip_force", {}), ("displacement", {"axial_stiffness": 2000.0})])
def test_what_is_estimated_beside_lines_that_turn_slack_is_the_most_probable(unknown, stretch):
    """Some of it at a kink: of 200, 4 forces and 97 displacements came to no end. Nothing near is more probable, by equilibria
    found from nothing."""
    angles = np.pi * np.arange(2) if stretch else 2 * np.pi * np.arange(3) / 3
    places = 0.008 * np.column_stack([np.cos(angles), np.sin(angles)])
    lines = [mr.Tendon(place, driven="displacement", **stretch) for place in places]
    robot = mr.SingleRod(mr.Rod(length=0.2, bending_stiffness=0.01, torsional_stiffness=0.0077, lines=lines))
    random, count, size = np.random.default_rng(5), 200, {"tip_force": 0.1, "displacement": 2e-3}[unknown]
    turns = random.uniform(0, 2 * np.pi, (count, 1))
    pulled = 0.003 * random.random((count, 1)) * np.cos(angles - turns) - 1e-4 * random.random((count, 1))
    given = {"displacement": pulled, "tip_force": 0.1 * random.normal(size=(count, 3))}
    there = mr.solve(robot, robot.inputs(**given)).raise_if_failed()
    position = there.tip_position + 5e-4 * random.normal(size=(count, 3))
    known = {name: value for name, value in given.items() if name != unknown}
    sensor, prior = mr.Pose(position=position, sigma=5e-4), {unknown: mr.Prior(0, sigma=size)}
    found = mr.estimate(robot, robot.inputs(**known), unknown=prior, measured=sensor)
    assert not found.failed.any(), found

    def squares(values):
        others = {name: np.broadcast_to(value, (*values.shape[:-1], value.shape[-1])) for name, value in known.items()}
        tips = mr.solve(robot, robot.inputs(**{unknown: values}, **others))
        off = ((tips.tip_position - position) / 5e-4) ** 2
        return np.nan_to_num(off.sum(axis=-1) + ((values / size) ** 2).sum(axis=-1), nan=np.inf)

    best = found.value(unknown)
    # 1e-4 at the last step, a hundredth of a deviation
    np.testing.assert_allclose(squares(best), found.misfit, rtol=0, atol=1e-3)
    aside = np.linalg.cholesky(found.covariance(unknown))
    for far in (0.03, 0.3):
        steps = (aside @ random.normal(size=(12, count, best.shape[1], 1)))[..., 0]
        assert (squares(best + far * steps) > found.misfit - 1e-3).all()


def test_a_slack_line_is_looked_across_its_kink_for_what_is_more_probable():
    """Slack lines tell nothing, so an estimate that begins where all are slack ended there, off by sixty deviations. Over a grid
    of displacements nothing is more probable than what is found."""
    lines = [mr.Tendon((place, 0), driven="displacement", axial_stiffness=2000.0) for place in (0.008, -0.008)]
    robot = mr.SingleRod(mr.Rod(length=0.2, bending_stiffness=0.01, torsional_stiffness=0.0077, lines=lines))
    force, size, count = (0.02, 0.01, 0), 2e-3, 12
    there = mr.solve(robot, robot.inputs(displacement=(0.002, -0.0025), tip_force=force)).raise_if_failed()
    means = -np.random.default_rng(0).uniform(2e-4, 2e-3, (count, 2))
    sensor, prior = mr.Pose(position=there.tip_position, sigma=5e-4), {"displacement": mr.Prior(means, sigma=size)}
    found = mr.estimate(robot, robot.inputs(tip_force=force), unknown=prior, measured=sensor)
    assert not found.failed.any(), found
    steps = np.linspace(-3e-3, 3.5e-3, 53)
    grid = np.stack(np.meshgrid(steps, steps), axis=-1).reshape(-1, 2)
    tips = mr.solve(robot, robot.inputs(displacement=grid, tip_force=force))
    off = (((tips.tip_position - there.tip_position) / 5e-4) ** 2).sum(axis=-1)
    squares = np.nan_to_num(off, nan=np.inf) + (((grid - means[:, None]) / size) ** 2).sum(axis=-1)
    assert (found.misfit < squares.min(axis=1)).all()
    assert (found.value("displacement")[:, 0] > 1e-3).all()
    assert found.integrations.max() < 200
    alone = {"displacement": mr.Prior(means[3], sigma=size)}
    again = mr.estimate(robot, robot.inputs(tip_force=force), unknown=alone, measured=sensor)
    np.testing.assert_array_equal(again.value("displacement"), found.value("displacement")[3])


@pytest.mark.parametrize("force", [(0.02, 0.01, 0), (0, 0, 0)])
def test_slack_lines_far_from_taut_and_at_their_kinks_are_looked_across(force):
    """(20b) Without a load lines whose displacement is 0 are at their kinks: an estimate that began there ended there, as did
    those of lines farther off than three deviations, by a misfit of 1500 and more. Over a grid nothing is more probable than
    what is found."""
    lines = [mr.Tendon((place, 0), driven="displacement", axial_stiffness=2000.0) for place in (0.008, -0.008)]
    robot = mr.SingleRod(mr.Rod(length=0.2, bending_stiffness=0.01, torsional_stiffness=0.0077, lines=lines))
    there = mr.solve(robot, robot.inputs(displacement=(0.002, -0.0025), tip_force=force)).raise_if_failed()
    random, size = np.random.default_rng(1), 2e-3
    means = -random.uniform(0, 0.03, (30, 2)) * (random.random((30, 2)) < 0.7)
    means = np.concatenate([means, [(0, 0), (0, -0.02), (-0.005, 0)]])
    sensor, prior = mr.Pose(position=there.tip_position, sigma=5e-4), {"displacement": mr.Prior(means, sigma=size)}
    found = mr.estimate(robot, robot.inputs(tip_force=force), unknown=prior, measured=sensor)
    assert not found.failed.any(), found
    steps = np.linspace(-0.032, 0.004, 73)
    grid = np.stack(np.meshgrid(steps, steps), axis=-1).reshape(-1, 2)
    tips = mr.solve(robot, robot.inputs(displacement=grid, tip_force=force))
    off = (((tips.tip_position - there.tip_position) / 5e-4) ** 2).sum(axis=-1)
    squares = np.nan_to_num(off, nan=np.inf) + (((grid - means[:, None]) / size) ** 2).sum(axis=-1)
    assert (found.misfit < squares.min(axis=1)).all()
    assert found.integrations[found.consistent].max() < 100  # 54 were seen; what is far from its prior is looked for elsewhere


@pytest.mark.parametrize("force", [(0.02, 0.01, 0), (0, 0, 0)])
def test_lines_that_do_not_stretch_are_estimated_from_priors_that_no_robot_can_have(force):
    """(20c) One of two opposite tendons lets out what the other draws in: of the most probable displacements the one that is less
    told is at its kink. Here the rod is bent as in truth, and what is left follows from the priors alone."""
    lines = [mr.Tendon((place, 0), driven="displacement") for place in (0.008, -0.008)]
    robot = mr.SingleRod(mr.Rod(length=0.2, bending_stiffness=0.01, torsional_stiffness=0.0077, lines=lines))
    pulled, size, sigma = 0.002, 2e-3, 5e-4
    there = mr.solve(robot, robot.inputs(displacement=(pulled, -0.0025), tip_force=force)).raise_if_failed()
    means = np.array([(0.002, 0.002), (0, 0), (0.001, -0.0005), (0.004, 0.001), (0.002, -0.0019), (-0.001, -0.001)])
    begun = mr.solve(robot, robot.inputs(displacement=means, tip_force=force))
    assert begun.failed.any()
    sensor, prior = mr.Pose(position=there.tip_position, sigma=sigma), {"displacement": mr.Prior(means, sigma=size)}
    found = mr.estimate(robot, robot.inputs(tip_force=force), unknown=prior, measured=sensor)
    assert not found.failed.any(), found
    value = found.value("displacement")
    # a deviation of the position is 1.5 to 2.5 % of the prior's by the displacement that bends: so much of the way is undone
    np.testing.assert_allclose(value[:, 0], pulled, rtol=0, atol=0.025 * np.abs(means - (pulled, -pulled)).max())
    np.testing.assert_allclose(value[:, 1], np.minimum(means[:, 1], -value[:, 0]), rtol=0, atol=2e-6)  # 1e-6 by twist and hairs
    away = (((value - means) / size) ** 2).sum(axis=1)
    assert (found.misfit >= away).all()
    assert (found.misfit <= (((means - (pulled, -pulled)) / size) ** 2).sum(axis=1) + 1e-3).all()
    assert found.integrations.max() < 1000  # 562 were seen
    alone = {"displacement": mr.Prior(means[3], sigma=size)}
    again = mr.estimate(robot, robot.inputs(tip_force=force), unknown=alone, measured=sensor)
    np.testing.assert_array_equal(again.value("displacement"), value[3])


def test_either_side_of_a_kink_that_the_measurement_allows_is_within_the_covariance():
    """(20d) One of two lines is at its kink by the priors' means; a load cell that shows a little does not tell that it pulls."""
    lines = [mr.Tendon((x, 0), driven="displacement", axial_stiffness=200.0) for x in (0.006, -0.006)]
    rod = mr.Rod(length=0.2, bending_stiffness=0.01, torsional_stiffness=0.0077, lines=lines)
    robot, rng, count = mr.SingleRod(rod), np.random.default_rng(0), 100
    mean, sigma = np.array([2e-3, -8.4e-4]), 3e-4
    pulled = mean + sigma * rng.standard_normal((count, 2))
    truth = mr.solve(robot, robot.inputs(displacement=pulled)).raise_if_failed()
    assert 20 < truth.slack[:, 1].sum() < 80
    cells = mr.Tension(value=truth.tension + 0.02 * rng.standard_normal((count, 2)), sigma=0.02)
    found = mr.estimate(robot, unknown={"displacement": mr.Prior(mean, sigma=sigma)}, measured=cells).raise_if_failed()
    off = found.value("displacement") - pulled
    squares = np.einsum("bi,bij,bj->b", off, np.linalg.inv(found.covariance("displacement")), off) / 2
    assert squares.mean() < 1.3  # by 100 draws of two numbers, the mean of which spreads by 0.1
    assert squares.max() < 9
