"""Where the search of a network begins: what is put together at once, and the path from the network taken apart."""

import numpy as np
import pytest
from test_network import EXACT, FORCE, GRAVITY, RK4, hexapod

import multirod as mr
from multirod.models.network.capabilities import NetworkJoints

MOST = 15  # integrations of a cold start: one apart, one together, one at no load, five or so of a step, and what the line search adds


@pytest.mark.parametrize("scale", [1.0, 6.0])
def test_equal_legs_are_put_together_at_once(scale, monkeypatch):
    """(30) In a few integrations, and to where the path from the network taken apart leads, under large loads too."""
    robot = hexapod()
    inputs = robot.inputs(force={"plate": scale * FORCE * (1, 1, 0.2)}, translation=0.01, gravity=GRAVITY)
    found = mr.solve(robot, inputs, solver=EXACT)
    monkeypatch.setattr(NetworkJoints, "together", lambda joints: None)
    expected = mr.solve(robot, inputs, solver=EXACT)
    assert found.status == expected.status == mr.Status.CONVERGED
    assert found.stability == mr.Stability.STABLE
    assert found.integrations < expected.integrations
    assert found.integrations <= MOST or scale > 1
    # residuals of 1e-11, and legs that give way along themselves by 1e-3 of what they do across
    np.testing.assert_allclose(found.tip_position, expected.tip_position, atol=1e-9)
    np.testing.assert_allclose(found.energy, expected.energy, rtol=1e-7)


def test_what_has_to_bend_is_put_together_step_by_step():
    """Legs of different lengths: Newton's second step is longer than the first; what was tried is forgotten."""
    robot = hexapod()
    inputs = robot.inputs(translation=np.array([[0.01, 0, 0, -0.01, 0, 0.005], [0.01] * 6]), gravity=GRAVITY)
    problem = robot.problem(inputs, integrator=RK4)
    together = problem.joints.together()
    assert together.sound.tolist() == [False, True]
    assert not problem.soft.any()
    assert not problem.opening[0].any()
    both = mr.solve(robot, inputs, solver=EXACT)
    assert (both.status == mr.Status.CONVERGED).all()
    for k in range(2):  # each is what it is alone
        alone = mr.solve(robot, inputs[k], solver=EXACT)
        assert alone.integrations == both.integrations[k]
        np.testing.assert_array_equal(alone.tip_position, both.tip_position[k])
