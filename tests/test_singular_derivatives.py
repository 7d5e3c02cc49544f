"""Derivatives where ``Gamma`` is singular to rounding: none of what it does not tell, in jacobian and vjp alike."""

import numpy as np
import pytest
import random_networks

import multirod as mr
from multirod.results.eliminating import LOST, eliminated, pulled_back

SOLVER = mr.Shooting(integrator=mr.RK4(40))
NAN = "derivatives by .* are NaN where Gamma is singular to rounding"


def straight():
    return mr.Rod(length=0.2, bending_stiffness=(0.006, 0.009), torsional_stiffness=0.0046)


def single():
    return mr.SingleRod(straight())


def legs():
    poses = np.tile(np.eye(4), (2, 1, 1))
    poses[1, 0, 3] = 0.03
    return mr.ParallelRods(legs=[straight()] * 2, base=poses, platform=poses)


def network():
    plate = mr.Body("plate")
    joints = [mr.Joint("leg", "base", to=mr.ground), mr.Joint("leg", "tip", to=plate)]
    return mr.Network(rods={"leg": straight()}, bodies=[plate], joints=joints)


def pressed(robot, loads):
    """Straight, whatever presses it."""
    force = np.zeros((len(loads), 3))
    force[:, 2] = -np.asarray(loads)
    inputs = robot.inputs(force={"plate": force}) if isinstance(robot, mr.Network) else robot.inputs(tip_force=force)
    return mr.solve(robot, inputs, guess=mr.solve(robot, robot.inputs(), solver=SOLVER), solver=SOLVER)


@pytest.mark.parametrize(
    ("make", "name", "most"), [(single, "tip_force", 0.4), (legs, "tip_force", 2.0), (network, "force", 0.4)]
)
def test_where_a_robot_buckles_itself_there_are_no_derivatives_of_what_gives_way(make, name, most):
    """The load at which ``det Gamma`` changes its sign, to rounding: jacobian was NaN of single rods, vjp 1e17."""
    robot, low, high = make(), 0.3, most
    for _ in range(12):
        loads = np.linspace(low, high, 33)
        signs = np.sign(pressed(robot, loads).determinant)
        turn = np.flatnonzero(signs[1:] != signs[:-1])
        if not len(turn):
            break
        low, high = loads[turn[0]], loads[turn[0] + 1]
    found = pressed(robot, (low, high))
    found = found[int(np.argmax(found.condition))]
    assert found.condition > 1 / LOST
    assert found.stability is mr.Stability.FOLD
    with pytest.warns(RuntimeWarning, match=NAN):
        J = found.jacobian(name)
    beside = pressed(robot, [low * (1 - 1e-6)])[0].jacobian(name)
    # across y, the weaker way, it gives way; about x it turns then
    gives, holds = np.abs(beside[:, 1]) > 1e3, np.ix_([0, 2, 4], [0, 2])
    assert gives[[1, 3]].all()
    assert np.isnan(J[gives]).all()
    assert np.isnan(J[:, 1]).all()
    np.testing.assert_allclose(J[holds], beside[holds], rtol=1e-4, atol=1e-12)
    with pytest.warns(RuntimeWarning, match=NAN):
        assert np.isnan(found.vjp((1, 2, 3, 4, 5, 6), wrt=name)[name]).all()
    c = np.array((0.3, 0, 0.5, 0, 0.2, 0))
    with pytest.warns(RuntimeWarning, match=NAN):
        g = found.vjp(c, wrt=name)[name]
    np.testing.assert_array_equal(np.isnan(g), (False, True, False))
    np.testing.assert_allclose(g[[0, 2]], c[[0, 2, 4]] @ J[holds], rtol=1e-12)


def test_what_spins_at_no_cost_leaves_the_derivatives_of_all_else():
    """A round straight rod between a ball and a universal joint turns about itself: ``Gamma`` of 109 rows is singular so."""
    drawn = random_networks.draw(9)
    found = mr.solve(drawn.robot, drawn.inputs).raise_if_failed()
    assert found.condition > 1 / LOST
    J, g = found.jacobian("moment"), found.vjp((1, 2, 3, 4, 5, 6), wrt="moment")["moment"]
    assert np.isfinite(J).all()
    np.testing.assert_allclose(g, np.arange(1, 7) @ J, rtol=1e-9, atol=1e-12)
    moment, h, pushed = np.array(drawn.inputs.moment), 1e-4, int(np.abs(J[:3]).max(axis=0).argmax())
    tips = []
    for sense in (1, -1):
        changed = moment.copy()
        changed.reshape(-1)[pushed] += sense * h
        inputs = drawn.inputs.with_arrays(drawn.inputs.arrays | {"moment": changed})
        tips.append(mr.solve(drawn.robot, inputs).raise_if_failed().tip_position)
    np.testing.assert_allclose((tips[0] - tips[1]) / (2 * h), J[:3, pushed], rtol=1e-4, atol=1e-4 * np.abs(J[:3, pushed]).max())


def test_what_gamma_tells_is_told_and_nothing_else():
    """(D1e) on matrices with one direction lost, which some rows and columns have a part in."""
    random = np.random.default_rng(3)
    n, k, m = 7, 4, 6
    out, along = (np.linalg.qr(random.normal(size=(n, n)))[0] for _ in range(2))
    sizes = np.array([3.0, 1, 1, 0.5, 0.1, 0.01, 1e-17])
    gamma = out * sizes @ along.T
    slopes, rows = random.normal(size=(n, k)), random.normal(size=(m, n + k))
    slopes[:, :3] -= out[:, -1:] @ (out[:, -1] @ slopes[:, :3])[None]  # all but the last do not push it
    rows[:4, :n] -= rows[:4, :n] @ along[:, -1:] * along[:, -1]  # the first four do not move with it
    result, silent = eliminated(slopes[None], rows[None], gamma[None])
    inverse = along[:, :-1] / sizes[:-1] @ out[:, :-1].T
    expected = rows[:, n:] - rows[:, :n] @ inverse @ slopes
    np.testing.assert_allclose(result[0, :4, :3], expected[:4, :3], rtol=1e-9)
    assert silent[0]
    assert np.isnan(result[0, 4:]).all()
    assert np.isnan(result[0, :, 3]).all()
    c = np.array([1.0, -2, 3, 4, 0, 0])
    back, silent = pulled_back(c[None], slopes[None], rows[None], gamma[None])
    assert silent[0]
    assert np.isnan(back[0, 3])
    np.testing.assert_allclose(back[0, :3], c[:4] @ expected[:4, :3], rtol=1e-9)
    # regular ones are as they were, also far from well conditioned
    sizes[-1] = 1e-9
    regular = out * sizes @ along.T
    result, silent = eliminated(np.stack([slopes] * 2), np.stack([rows] * 2), np.stack([regular, gamma]))
    np.testing.assert_array_equal(silent, (False, True))
    np.testing.assert_allclose(result[0], rows[:, n:] - rows[:, :n] @ np.linalg.solve(regular, slopes), rtol=1e-5)
