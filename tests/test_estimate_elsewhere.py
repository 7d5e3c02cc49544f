"""Estimates that begin anew about the priors' means. Numbers in parentheses: ``docs/estimation.md``."""

import numpy as np
import pytest

import multirod as mr

MEAN, SIGMA = np.array((0.2, 0.1, -0.3)), 0.2  # N
SHARP = (3e-4, 3e-3)  # m, rad


@pytest.fixture(scope="module")
def soft():
    """A wire that such forces move by its length."""
    return mr.SingleRod(mr.Rod(length=0.4, bending_stiffness=0.015, torsional_stiffness=0.012, precurvature=(3, -2, 0)))


@pytest.fixture(scope="module")
def draws(soft):
    """Forces as the prior has them, those of 200 that were lost among them, and where the wire is."""
    force = (MEAN + SIGMA * np.random.default_rng(0).normal(size=(200, 3)))[[0, 15, 30, 62, 70, 81, 134, 141, 160, 187]]
    return force, mr.solve(soft, soft.inputs(tip_force=force))


def estimated(robot, position, rotation, **options):
    measured = mr.Pose(position=position, rotation=rotation, sigma=SHARP)
    return mr.estimate(robot, unknown={"tip_force": mr.Prior(MEAN, sigma=SIGMA)}, measured=measured, **options)


def test_forces_that_move_a_wire_by_its_length_are_found(soft, draws):
    """(25) Of what was measured without an error nothing is left at the truth but what that is off its prior's mean."""
    force, truth = draws
    expected = mr.solve(soft, soft.inputs(tip_force=MEAN))
    assert (np.linalg.norm(truth.tip_position - expected.tip_position, axis=1)[1:] > 0.4).all()
    found = estimated(soft, truth.tip_position, truth.tip_rotation).raise_if_failed()
    assert found.consistent.all()
    assert (found.misfit <= (((force - MEAN) / SIGMA) ** 2).sum(axis=1) + 1e-3).all()  # the last step: a hundredth of a deviation
    np.testing.assert_allclose(found.solution.tip_position, truth.tip_position, atol=1e-3)  # three deviations: 0.9 mm
    # the equilibrium is that of the force
    again = mr.solve(soft, soft.inputs(tip_force=found.value("tip_force")), guess=found.solution)
    np.testing.assert_allclose(again.tip_position, found.solution.tip_position, atol=1e-7)


def test_one_begins_anew_alone_as_in_a_batch(soft, draws):
    """(25) Bitwise, and what is likely takes nothing more beside others that are not."""
    _, truth = draws
    whole = estimated(soft, truth.tip_position, truth.tip_rotation, threads=1)
    for k in (0, 2):
        alone = estimated(soft, truth.tip_position[k], truth.tip_rotation[k])
        np.testing.assert_array_equal(alone.value("tip_force"), whole.value("tip_force")[k])
        np.testing.assert_array_equal(alone.covariance(), whole.covariance()[k])
        np.testing.assert_array_equal(alone.solution.tip_position, whole.solution.tip_position[k])
        assert alone.integrations == whole.integrations[k]
    assert whole.integrations[0] < 40


def test_a_model_that_is_wrong_is_told_soon(soft, draws):
    """(25) It is over where two beginnings lead to the end that there was."""
    _, truth = draws
    found = estimated(soft, truth.tip_position[0] + (5e-3, 0, 0), truth.tip_rotation[0])
    assert found.status is mr.Status.CONVERGED
    assert not found.consistent
    rest = mr.solve(soft, soft.inputs(tip_force=MEAN)).integrations
    assert found.integrations < 5 * rest + 60  # the first, (24), two or three of (25), and steps of each


def test_what_has_no_prior_or_is_at_a_limit_stays_where_it_may_be():
    """(25) Tensions that the prior spreads below 0 do not push, and of what nothing is known it begins at the mean."""
    around = [mr.Tendon(offset=(0.008 * np.cos(angle), 0.008 * np.sin(angle))) for angle in (0, 2.1, 4.2)]
    robot = mr.SingleRod(mr.Rod(length=0.2, bending_stiffness=0.01, torsional_stiffness=0.0077, lines=around))
    off = mr.Pose(position=(0.05, 0.05, 0.12), rotation=np.eye(3), sigma=SHARP)  # where no tension brings it
    found = mr.estimate(robot, unknown={"tension": mr.Prior(0.1, sigma=(5, np.inf, 5))}, measured=off)
    assert found.failed or (not found.consistent and (found.value("tension") >= 0).all())
    assert found.status in (mr.Status.CONVERGED, mr.Status.UNSTABLE, mr.Status.MAX_ITERATIONS, mr.Status.STALLED)
