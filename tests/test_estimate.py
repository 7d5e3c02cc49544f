"""Forces from poses: against measurements and bounds of a rod that is integrated by ``measured_rods``, nothing of the package."""

import re

import numpy as np
import pytest
from benchmarks import network_estimates
from measured_rods import MeasuredRod, turned_by

import multirod as mr
from multirod.tasks.estimating.inference import damping

POSITION, ANGLE = 1e-4, np.radians(0.1)  # of the sensor: 0.1 mm, 0.1 degree
SIGMA = 0.25  # of the prior [N]
PRIOR = {"tip_force": mr.Prior(0, sigma=SIGMA)}


RANDOM_DEPTHS = np.random.default_rng(3).uniform(-1, 1, 500)  # where along a picture's direction something is said to be [m]


@pytest.fixture(scope="module")
def trials():
    """Forces drawn from the prior, and what a noisy sensor says of the pose that each leads to."""
    random = np.random.default_rng(16)
    force = SIGMA * random.normal(size=(500, 3))
    position, rotation, _, _ = MeasuredRod(0.4, 0.223349, 0.063814, (14, 5, 0)).seen(force)
    position = position + POSITION * random.normal(size=(500, 3))
    rotation = turned_by(ANGLE * random.normal(size=(500, 3))) @ rotation
    return force, position, rotation


def pose(trials, chosen=slice(None)):
    _, position, rotation = trials
    return mr.Pose(position=position[chosen], rotation=rotation[chosen], sigma=(POSITION, ANGLE))


def test_force_from_a_pose_is_as_good_as_can_be(robot, trials):
    """Five integrations; errors that are as large as the covariance says, which is the Cramer-Rao bound."""
    force = trials[0]
    found = mr.estimate(robot, unknown=PRIOR, measured=pose(trials)).raise_if_failed()
    assert found.integrations.max() <= 5
    error, covariance = found.value("tip_force") - force, found.covariance("tip_force")
    # of 1500 squares of normal numbers, 0.85 to 1.15 is four standard deviations
    assert 0.85 < np.einsum("bi,bij,bj->", error, np.linalg.inv(covariance), error) / 1500 < 1.15
    assert 5.4 < found.misfit.mean() < 6.6
    assert (found.degrees == 6).all()
    few = slice(0, 10)
    rod = MeasuredRod(0.4, 0.223349, 0.063814, (14, 5, 0))
    bound = np.linalg.inv(rod.information(force[few], position=POSITION, angle=ANGLE) + np.eye(3) / SIGMA**2)
    # at the estimate, not at the force: they differ as the force does, by some per cent of itself
    np.testing.assert_allclose(np.trace(covariance[few], axis1=1, axis2=2), np.trace(bound, axis1=1, axis2=2), rtol=0.1)
    spread = np.sqrt(np.trace(covariance, axis1=1, axis2=2).mean())
    assert np.sqrt((error**2).sum(axis=1).mean()) < 1.1 * spread
    # what is known exactly: at the force itself, without noise
    p, R, _, _ = rod.seen(force[few])
    exact = mr.estimate(robot, unknown=PRIOR, measured=mr.Pose(position=p, rotation=R, sigma=(1e-7, 1e-6)))
    np.testing.assert_allclose(exact.value("tip_force"), force[few], atol=1e-4)
    alike = exact.covariance("tip_force") * (POSITION / 1e-7) ** 2
    sharp = np.linalg.inv(rod.information(force[few], position=POSITION, angle=POSITION * 10))
    np.testing.assert_allclose(alike, sharp, rtol=2e-3, atol=2e-3 * np.abs(sharp).max())


def test_one_instance_is_bitwise_as_in_the_batch(robot, trials):
    batch = mr.estimate(robot, unknown=PRIOR, measured=pose(trials), threads=2)
    alone = mr.estimate(robot, unknown=PRIOR, measured=pose(trials, 3))
    np.testing.assert_array_equal(alone.value("tip_force"), batch.value("tip_force")[3])
    np.testing.assert_array_equal(alone.covariance(), batch.covariance()[3])
    assert alone.status is mr.Status.CONVERGED
    # the solution is the equilibrium at the estimate
    solved = mr.solve(robot, robot.inputs(tip_force=alone.value("tip_force")))
    np.testing.assert_allclose(alone.solution.tip_position, solved.tip_position, atol=1e-8)
    assert "tip_force (" in repr(alone)


def test_an_earlier_estimate_is_a_prior(robot, trials):
    """Two sensors at once, or one after the other: the same to first order."""
    _, position, rotation = (values[7] for values in trials)
    both = mr.estimate(
        robot,
        unknown=PRIOR,
        measured=[mr.Pose(position=position, sigma=POSITION), mr.Pose(rotation=rotation, sigma=ANGLE)],
    )
    first = mr.estimate(robot, unknown=PRIOR, measured=[mr.Pose(position=position, sigma=POSITION)])
    known = mr.Prior(first.value("tip_force"), covariance=first.covariance("tip_force"))
    then = mr.estimate(
        robot, unknown={"tip_force": known}, measured=[mr.Pose(rotation=rotation, sigma=ANGLE)], guess=first.solution
    )
    np.testing.assert_allclose(then.value("tip_force"), both.value("tip_force"), atol=0.1 * both.sigma("tip_force").min())
    np.testing.assert_allclose(then.sigma("tip_force"), both.sigma("tip_force"), rtol=0.05)
    # at what was found already, one integration says so
    again = mr.estimate(
        robot, unknown={"tip_force": known}, measured=[mr.Pose(position=position, sigma=1e3)], guess=first.solution
    )
    assert again.integrations == 1


def test_what_is_missing_is_gone_without(robot, trials):
    """NaN of a sensor, of some of the instances: they are as if it were not there, and say so."""
    _, position, rotation = (values[:4].copy() for values in trials)
    turned, placed = mr.Pose(rotation=rotation, sigma=ANGLE), mr.Pose(position=position, sigma=POSITION)
    whole = mr.estimate(robot, unknown=PRIOR, measured=[placed, turned])
    without = mr.estimate(robot, unknown=PRIOR, measured=[placed])
    rotation[1], rotation[2, 0, 1] = np.nan, np.nan
    position[3] = np.nan
    rotation[3] = np.nan
    lost = [mr.Pose(position=position, sigma=POSITION), mr.Pose(rotation=rotation, sigma=ANGLE)]
    found = mr.estimate(robot, unknown=PRIOR, measured=lost)
    np.testing.assert_array_equal(found.missing, [[False, False], [False, True], [False, True], [True, True]])
    np.testing.assert_array_equal(found.value("tip_force")[0], whole.value("tip_force")[0])
    np.testing.assert_allclose(found.value("tip_force")[1:3], without.value("tip_force")[1:3], atol=1e-12)
    # nothing is measured of the last: its prior is all there is
    np.testing.assert_array_equal(found.value("tip_force")[3], 0)
    np.testing.assert_allclose(found.covariance("tip_force")[3], SIGMA**2 * np.eye(3), rtol=1e-12)
    assert not found.observable["tip_force"][3].any()
    assert found.observable["tip_force"][:3].all()


def test_alone_as_in_a_batch_all_may_be_missing_where_there_is_a_prior(robot):
    nothing = mr.Pose(position=(np.nan,) * 3, rotation=np.full((3, 3), np.nan), sigma=(POSITION, ANGLE))
    found = mr.estimate(robot, unknown=PRIOR, measured=nothing)
    assert found.status is mr.Status.CONVERGED
    np.testing.assert_array_equal(found.value("tip_force"), 0)
    np.testing.assert_allclose(found.covariance("tip_force"), SIGMA**2 * np.eye(3), rtol=1e-12)
    assert found.dropped == ("sensor 0",)


def test_what_is_missing_is_named(robot, trials):
    _, position, rotation = (values[5].copy() for values in trials)
    whole = mr.estimate(robot, unknown=PRIOR, measured=mr.Pose(position=position, rotation=rotation, sigma=(POSITION, ANGLE)))
    assert whole.dropped == ()
    assert "without" not in repr(whole)
    position[1] = np.nan
    some = mr.estimate(robot, unknown=PRIOR, measured=mr.Pose(position=position, rotation=rotation, sigma=(POSITION, ANGLE)))
    assert some.dropped == ("y of sensor 0",)
    assert repr(some).endswith("; without y of sensor 0)")
    rotation[0] = np.nan
    more = mr.estimate(robot, unknown=PRIOR, measured=mr.Pose(position=position, rotation=rotation, sigma=(POSITION, ANGLE)))
    assert more.dropped == ("y and rotation of sensor 0",)


def test_base_and_measurement_may_be_moved_together(robot, wire, trials, make_pose):
    moved = make_pose((0.4, -1.1, 0.3), (0.2, -0.1, 0.5))
    R = moved[:3, :3]
    _, position, rotation = (values[5] for values in trials)
    here = mr.estimate(robot, unknown=PRIOR, measured=mr.Pose(position=position, rotation=rotation, sigma=(POSITION, ANGLE)))
    away = mr.Pose(position=R @ position + moved[:3, 3], rotation=R @ rotation, sigma=(POSITION, ANGLE))
    there = mr.estimate(mr.SingleRod(wire, base=moved), unknown=PRIOR, measured=away)
    np.testing.assert_allclose(there.value("tip_force"), R @ here.value("tip_force"), atol=1e-9)
    np.testing.assert_allclose(there.covariance(), R @ here.covariance() @ R.T, atol=1e-9 * SIGMA**2)


def test_one_coordinate_tells_what_a_position_without_the_others_does(robot, trials):
    position, z = trials[1][:20], np.array([0.0, 0.0, 1.0])
    x = np.array([1.0, 0.0, 0.0])
    alone = mr.Pose(position=np.where(x == 1, position, np.nan), sigma=POSITION)
    expected = mr.estimate(robot, unknown=PRIOR, measured=alone).raise_if_failed()
    gauge = mr.Pose(position=position + RANDOM_DEPTHS[:20, None] * z, along=-2 * x, sigma=POSITION)
    assert gauge.count == 1
    found = mr.estimate(robot, unknown=PRIOR, measured=gauge)
    np.testing.assert_allclose(found.value("tip_force"), expected.value("tip_force"), atol=1e-8)
    np.testing.assert_allclose(found.covariance(), expected.covariance(), atol=1e-8 * SIGMA**2)
    assert (found.degrees == 1).all()
    one = mr.Pose(position=position[0], sigma=POSITION)
    lost = mr.estimate(robot, unknown=PRIOR, measured=[one, mr.Pose(position=(np.nan, 0, 0), along=x, sigma=POSITION)])
    assert "without sensor 1" in str(lost)


def test_pictures_tell_of_a_position_what_lies_across_their_directions(robot, wire, trials, make_pose):
    """In one along z x and y are seen; whatever is told along it counts for nothing; and so it is however all is turned."""
    moved = make_pose((0.4, -1.1, 0.3), (0.2, -0.1, 0.5))
    R, z = moved[:3, :3], np.array([0.0, 0.0, 1.0])
    position = trials[1][:20]
    x_y = mr.Pose(position=np.where(z == 0, position, np.nan), sigma=POSITION)
    expected = mr.estimate(robot, unknown=PRIOR, measured=x_y).raise_if_failed()
    picture = mr.Pose(position=position + RANDOM_DEPTHS[:20, None] * z, across=-2 * z, sigma=POSITION)
    assert picture.count == 2
    found = mr.estimate(robot, unknown=PRIOR, measured=picture)
    turned = mr.Pose(position=position @ R.T + moved[:3, 3] + RANDOM_DEPTHS[:20, None] * R[:, 2], across=R[:, 2], sigma=POSITION)
    away = mr.estimate(mr.SingleRod(wire, base=moved), unknown=PRIOR, measured=turned)
    for own, back in ((found, np.eye(3)), (away, R.T)):
        np.testing.assert_allclose(own.value("tip_force") @ back.T, expected.value("tip_force"), atol=1e-8)
        np.testing.assert_allclose(back @ own.covariance() @ back.T, expected.covariance(), atol=1e-8 * SIGMA**2)
        np.testing.assert_allclose(own.misfit, expected.misfit, atol=1e-5)
        assert (own.degrees == 2).all()
    # two pictures along x and z see y twice
    x = np.array([1.0, 0.0, 0.0])
    both = [mr.Pose(position=position, across=direction, sigma=POSITION) for direction in (x, z)]
    known = [np.where(own == 0, position, np.nan) for own in (x, z)]
    apart = [mr.Pose(position=values, sigma=POSITION) for values in known]
    seen, expected = (mr.estimate(robot, unknown=PRIOR, measured=measured) for measured in (both, apart))
    np.testing.assert_allclose(seen.covariance(), expected.covariance(), atol=1e-9 * SIGMA**2)
    one = mr.Pose(position=position[0], across=x, sigma=POSITION)
    lost = mr.estimate(robot, unknown=PRIOR, measured=[one, mr.Pose(position=(np.nan, 0, 0), across=z, sigma=POSITION)])
    assert "without sensor 1" in str(lost)


def test_what_is_not_seen_keeps_its_prior_and_says_so(trials):
    """A straight stiff rod does not move along itself: the force there is as unknown as before, however it is turned."""
    rod = mr.Rod(length=0.4, bending_stiffness=0.223349, torsional_stiffness=0.063814)
    robot = mr.SingleRod(rod)
    pose = mr.Pose(position=(0, 0, 0.4), rotation=np.eye(3), sigma=(POSITION, ANGLE))
    found = mr.estimate(robot, unknown=PRIOR, measured=pose)
    np.testing.assert_array_equal(found.observable["tip_force"], [True, True, False])
    np.testing.assert_allclose(found.sigma("tip_force")[2], SIGMA, rtol=1e-6)
    axes, part = found.directions("tip_force")
    np.testing.assert_allclose(np.abs(axes[:, 0]), [0, 0, 1], atol=1e-6)
    np.testing.assert_allclose(part[0], 1.0, rtol=1e-9)
    assert "unobservable: tip_force along (" in repr(found)
    assert "100% of the prior's variance is kept" in repr(found)
    # without a prior its variance has no end, and that of the others is what the rows say
    flat = mr.estimate(robot, unknown={"tip_force": mr.Prior()}, measured=pose)
    assert np.isinf(flat.sigma("tip_force")[2])
    np.testing.assert_allclose(flat.sigma("tip_force")[:2], found.sigma("tip_force")[:2], rtol=1e-3)
    np.testing.assert_array_equal(flat.observable["tip_force"], [True, True, False])
    assert "unobservable: tip_force[2]" in repr(flat)


def test_several_unknowns_at_once(robot):
    """A force and a moment from one pose, without priors: six numbers from six."""
    truth = robot.inputs(tip_force=(0.2, -0.3, 0.1), tip_moment=(0.01, 0.02, -0.01))
    solved = mr.solve(robot, truth)
    pose = mr.Pose(position=solved.tip_position, rotation=solved.tip_rotation, sigma=(1e-5, 1e-4))
    found = mr.estimate(robot, unknown={"tip_force": mr.Prior(), "tip_moment": mr.Prior()}, measured=pose)
    np.testing.assert_allclose(found.value("tip_force"), (0.2, -0.3, 0.1), atol=1e-5)
    np.testing.assert_allclose(found.value("tip_moment"), (0.01, 0.02, -0.01), atol=1e-6)
    assert found.degrees == 0
    assert found.covariance().shape == (6, 6)


def test_what_cannot_be_reached_fails_by_name(robot):
    far = mr.Pose(position=(5.0, 0, 0), sigma=1e-4)
    found = mr.estimate(robot, unknown={"tip_force": mr.Prior()}, measured=far, max_iterations=3)
    assert found.failed
    assert found.status in (mr.Status.MAX_ITERATIONS, mr.Status.STALLED)
    assert np.isnan(found.value("tip_force")).all()
    with pytest.raises(mr.SolveError):
        found.raise_if_failed()


def test_large_forces_are_found_from_none(robot):
    """They bend the wire by a radian or two: Gauss-Newton's step is too long, and the way back to equilibrium counts."""
    force = np.random.default_rng(0).normal(size=(100, 3))
    seen = mr.Pose(position=MeasuredRod(0.4, 0.223349, 0.063814, (14, 5, 0)).seen(force)[0], sigma=1e-4)
    found = mr.estimate(robot, unknown={"tip_force": mr.Prior(0, sigma=5.0)}, measured=seen)
    assert found.failed.sum() <= 1
    assert found.integrations.max() <= 20
    np.testing.assert_allclose(found.value("tip_force")[~found.failed], force[~found.failed], atol=1e-3)


def test_what_the_robot_would_leave_is_no_estimate():
    """Under more than Euler's 3.4 N a column stays straight only in an unstable equilibrium: it says so, and fails alone."""
    column = mr.SingleRod(mr.Rod(length=0.4, bending_stiffness=0.223349, torsional_stiffness=0.063814))
    upright = mr.Pose(position=(0, 0, 0.4), rotation=np.eye(3), sigma=(POSITION, ANGLE))
    pressed = {"tip_force": mr.Prior([(0, 0, -8), (0, 0, -1)], sigma=SIGMA)}
    found = mr.estimate(column, unknown=pressed, measured=upright, guess=np.zeros(3))
    assert [mr.Status(value) for value in found.status] == [mr.Status.UNSTABLE, mr.Status.CONVERGED]
    for values in (found.value("tip_force")[0], found.covariance()[0], found.misfit[0], found.solution.tip_position[0]):
        assert np.isnan(values).all()
    assert not found.observable["tip_force"][0].any()
    alone = mr.estimate(column, unknown={"tip_force": mr.Prior((0, 0, -1), sigma=SIGMA)}, measured=upright, guess=np.zeros(3))
    np.testing.assert_array_equal(found.value("tip_force")[1], alone.value("tip_force"))
    np.testing.assert_array_equal(found.covariance()[1], alone.covariance())


GOOD = mr.Pose(position=(0, 0, 0.1), sigma=1e-3)


@pytest.mark.parametrize(
    ("options", "error", "message"),
    [
        ({"unknown": {"tip_forse": mr.Prior()}}, TypeError, "unknown takes no 'tip_forse'.*did you mean 'tip_force'"),
        ({"unknown": {"tip_curvature": mr.Prior()}}, ValueError, "tip_curvature is a measurement"),
        ({"unknown": {}}, ValueError, "must name one input or several"),
        ({"unknown": 0.25}, TypeError, "must be priors by name, .*or names alone"),
        ({"unknown": ("tip_force", "tip_force")}, ValueError, "each once"),
        ({"unknown": {"tip_force": 0.25}}, TypeError, "must be a Prior"),
        ({"unknown": {"tip_force": mr.Prior(sigma=(1, 2))}}, ValueError, "Prior.sigma of tip_force"),
        (
            {"unknown": {"tip_force": mr.Prior(), "tip_moment": mr.Prior()}},
            ValueError,
            "3 of tip_force, 3 of tip_moment.*unobservable",
        ),
        ({"measured": mr.Pose(position=(0, 0, 0.1))}, ValueError, r"measured\[0\].sigma = None"),
        (
            {"measured": mr.Pose(position=(np.nan,) * 3, sigma=1e-3), "unknown": {"tip_force": mr.Prior()}},
            ValueError,
            "NaN in all rows",
        ),
        ({"measured": []}, TypeError, "must be measurements"),
        ({"measured": (0, 0, 0.1)}, TypeError, "must be measurements"),
        (
            {"measured": mr.Pose(position=np.zeros((2, 3)), sigma=1e-3), "unknown": {"tip_force": mr.Prior(np.zeros((3, 3)))}},
            ValueError,
            "leading axes",
        ),
        ({"max_iterations": 0}, ValueError, "max_iterations"),
    ],
)
def test_bad_input(robot, options, error, message):
    with pytest.raises(error, match=message):
        mr.estimate(robot, **({"unknown": PRIOR, "measured": GOOD} | options))


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"sigma": 0}, "Prior.sigma = 0 .*> 0"),
        ({"sigma": (0.1, -1, 1)}, "Prior.sigma"),
        ({"sigma": np.nan}, "Prior.sigma"),
        ({"covariance": np.diag([1.0, -1, 1])}, "positive definite"),
        ({"covariance": [[1, 0.5], [0, 1]]}, "symmetric"),
        ({"covariance": np.eye(3), "sigma": 1.0}, "must not be given beside"),
    ],
)
def test_bad_priors(options, message):
    with pytest.raises(ValueError, match=message):
        mr.Prior(0, **options)
    assert re.match(r"Prior\(0.0, sigma=0.25\)", repr(PRIOR["tip_force"]))


def test_a_sharp_pose_alone_tells_forces_on_a_chain():
    """The valley of the squares is narrow and bent: steps are damped there. By halving alone 18 of these 20 are found."""
    robot, known = network_estimates.chain()
    force, seen = network_estimates.draw(robot, known, 0.1, 20)
    found = network_estimates.estimated(robot, known, seen, (5e-4, 5e-3), 0.25, 30).raise_if_failed()
    # of a pose without noise the misfit is the prior's: at most that of the forces themselves, and a hundredth more
    assert (found.misfit <= (force**2).sum(axis=(1, 2)) / 0.25**2 + 0.01).all()
    assert found.integrations.max() <= 35  # of which 21 or 22 find the start


def test_a_damped_step_is_as_long_as_it_is_to_be():
    """(16), against the least-squares problem itself."""
    random = np.random.default_rng(2)
    J, r, root = random.normal(size=(3, 7, 4)), random.normal(size=(3, 7)), 0.1 * random.normal(size=(3, 4, 4))
    away, unit, part = random.normal(size=(3, 4)), random.uniform(0.5, 2, (3, 4)), np.array([0.5, 0.1, 1e-3])
    mu = damping(J, r, root, away, unit, part)
    for k in range(3):
        rows = np.concatenate([J[k], root[k]]) * unit[k]
        sides = np.concatenate([r[k], root[k] @ away[k]])
        whole, damped = (np.linalg.solve(rows.T @ rows + m * np.eye(4), rows.T @ sides) for m in (0.0, mu[k]))
        np.testing.assert_allclose(np.linalg.norm(damped), part[k] * np.linalg.norm(whole), rtol=1e-6)


@pytest.mark.parametrize("names", ["tip_force", ("tip_force",), ["tip_force"]])
def test_of_names_alone_nothing_is_known(robot, trials, names):
    """As with a prior that says nothing: the pose alone tells."""
    seen = pose(trials, slice(0, 4))
    found = mr.estimate(robot, unknown=names, measured=seen).raise_if_failed()
    said = mr.estimate(robot, unknown={"tip_force": mr.Prior()}, measured=seen)
    np.testing.assert_array_equal(found.value("tip_force"), said.value("tip_force"))
    assert (found.degrees == 3).all()
    assert (np.abs(found.value("tip_force") - trials[0][:4]) < 5 * found.sigma("tip_force")).all()


def test_numbers_that_were_not_measured_do_not_count(robot):
    """Of three coordinates two are NaN: a force without a prior was ``CONVERGED``, its variance infinite."""
    seen = mr.Pose(position=(0.05, np.nan, np.nan), sigma=1e-4)
    with pytest.raises(ValueError, match="3 numbers without a prior .* must be at most as many as are measured, 1"):
        mr.estimate(robot, unknown={"tip_force": mr.Prior()}, measured=seen)


def test_of_a_batch_what_is_measured_too_little_says_so(robot, trials):
    """And leaves the others bitwise as they are without it."""
    position = np.array(trials[1][:3])
    seen = mr.Pose(position=position, sigma=1e-4)
    whole = mr.estimate(robot, unknown={"tip_force": mr.Prior()}, measured=seen)
    position[1, 0] = np.nan
    lost = mr.estimate(robot, unknown={"tip_force": mr.Prior()}, measured=mr.Pose(position=position, sigma=1e-4))
    assert lost.status.tolist() == [mr.Status.CONVERGED, mr.Status.UNOBSERVABLE, mr.Status.CONVERGED]
    for values in (lost.value("tip_force"), lost.covariance("tip_force"), lost.solution.tip_position):
        assert np.isnan(values[1]).all()
    np.testing.assert_array_equal(lost.value("tip_force")[[0, 2]], whole.value("tip_force")[[0, 2]])
    known = mr.estimate(robot, unknown={"tip_force": mr.Prior(0, sigma=1)}, measured=mr.Pose(position=position, sigma=1e-4))
    assert (known.status == mr.Status.CONVERGED).all()


def test_legs_between_plates_that_are_like_each_other_are_estimated_at_equilibria_alone():
    """Of legs that are almost straight steps off equilibria go round in circles. What is found is the most probable nearby: the
    squares of equilibria that are solved for anew, along each axis of the covariance, are more on both sides."""
    wire = mr.Rod.wire(length=0.2, diameter=1.4e-3, young_modulus=60e9, shear_modulus=23e9)
    places = np.tile(np.eye(4), (2, 6, 1, 1))
    angles = np.radians([-10, 10, 110, 130, 230, 250])
    places[:, :, 0, 3], places[:, :, 1, 3] = (np.outer((0.087, 0.06), of(angles)) for of in (np.cos, np.sin))
    robot = mr.ParallelRods(legs=[wire] * 6, base=places[0], platform=places[1])
    random, sigma = np.random.default_rng(0), np.array([1.0] * 3 + [3e-3] * 6)
    drawn = sigma * random.normal(size=(8, 9))
    truth = mr.solve(robot, robot.inputs(tip_force=drawn[:, :3], translation=drawn[:, 3:])).raise_if_failed()
    seen = truth.tip_position + 5e-4 * random.normal(size=(8, 3))
    frames = turned_by(5e-3 * random.normal(size=(8, 3))) @ truth.tip_rotation
    priors = {"tip_force": mr.Prior(0, sigma=1.0), "translation": mr.Prior(0, sigma=3e-3)}
    found = mr.estimate(robot, unknown=priors, measured=mr.Pose(position=seen, rotation=frames, sigma=(5e-4, 5e-3)))
    good = np.flatnonzero(~found.failed)
    assert len(good) >= 7  # 1 of the 8 by steps off equilibria alone
    at = np.concatenate([found.value(name)[good] for name in priors], axis=1)
    axes = 0.05 * np.linalg.cholesky(found.covariance()[good]).swapaxes(1, 2)
    beside = at[:, None] + np.concatenate([axes, -axes, 0 * axes[:, :1]], axis=1)
    guess = np.repeat(found.solution.unknowns[good, None], 19, axis=1)
    there = mr.solve(robot, robot.inputs(tip_force=beside[..., :3], translation=beside[..., 3:]), guess=guess).raise_if_failed()
    moved, turned = there.tip_position - seen[good, None], there.tip_rotation @ frames[good, None].swapaxes(-1, -2)
    turns = (turned - turned.swapaxes(-1, -2))[..., [2, 0, 1], [1, 2, 0]] / 2  # of some mrad, so that sines are angles
    squares = sum((part**2).sum(axis=-1) for part in (moved / 5e-4, turns / 5e-3, beside / sigma))
    np.testing.assert_allclose(squares[:, -1], found.misfit[good], rtol=1e-4)
    # the last step is less than a hundredth of a deviation: they are 0.05^2 - 2 * 0.05 * 0.01 more where nothing bends
    assert (squares[:, :-1] - squares[:, -1:] > 0.0005).all()


@pytest.mark.parametrize("push", [-0.02, -0.05, -0.1])
@pytest.mark.parametrize("times", [1.15, 1.3])
def test_a_column_is_found_on_the_side_that_priors_did_not_expect(push, times):
    """(24) Loaded beyond where it buckles, ``push`` [N] aside: steps lead along the other branch to where that ends."""
    robot = mr.SingleRod(mr.Rod(length=0.4, bending_stiffness=0.05, torsional_stiffness=0.04))
    load = -times * np.pi**2 * 0.05 / (4 * 0.4**2)
    truth = mr.solve(robot, robot.inputs(tip_force=(push, 0, load)))
    given = {"measured": mr.Pose(position=truth.tip_position, rotation=truth.tip_rotation, sigma=(1e-3, 1e-2))}
    given["unknown"] = {"tip_force": mr.Prior((0.03, 0, load), sigma=(0.1, 0.1, 0.05))}
    found = mr.estimate(robot, **given)
    assert found.status is mr.Status.CONVERGED
    assert found.consistent
    known = mr.estimate(robot, guess=truth, **given)
    # either ends by a step of a hundredth of a deviation, along a valley
    np.testing.assert_allclose(found.value("tip_force"), known.value("tip_force"), atol=0.1 * found.sigma("tip_force").min())
    assert np.sign(found.solution.tip_position[0]) == np.sign(truth.tip_position[0])
