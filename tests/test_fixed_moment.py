"""Moments fixed in the world: with no force their equilibrium is an integration from the base, whatever the columns grow to.

A rod turned about the middle of its three stiffnesses is an Euler top about its middle axis: neighbouring solutions leave it
exponentially, by 14 decades where it is turned 10 times, while the moment at the base stays what acts at the tip.
"""

import numpy as np
import pytest
from rod_equations import RodEquations
from scipy.spatial.transform import Rotation

import multirod as mr
from multirod.models.backbone.stability.condensing.second_variation import certain_determinant
from multirod.solvers.energy_descent import EnergyDescentTrack

L = 0.4
STIFFNESS = (0.03, 0.05, 0.09)
TURNS = (1, 7, 8.25, 10, 20)
# EI_x, EI_y, GJ, whose middle is about x, y and z
ORDERS = ((0.05, 0.09, 0.03), (0.03, 0.05, 0.09), (0.09, 0.03, 0.05))
EXACT = mr.RK45(rtol=1e-11, atol=1e-13)


def rod_of(stiffness, **values):
    return mr.Rod(length=L, bending_stiffness=stiffness[:2], torsional_stiffness=stiffness[2], **values)


def about_the_middle(stiffness, turns):
    """A moment that turns a straight rod about its middle axis, and that axis."""
    axis = np.eye(3)[int(np.argsort(stiffness)[1])]
    return 2 * np.pi * turns / L * sorted(stiffness)[1] * axis, axis


def condition_and_determinant(solution):
    """Of the scaled ``Gamma``, shape (2,)."""
    return np.array([solution.condition, solution.determinant])


@pytest.mark.filterwarnings("ignore::multirod.PlausibilityWarning")
@pytest.mark.parametrize("turns", TURNS)
@pytest.mark.parametrize("stiffness", ORDERS, ids="xyz")
def test_a_rod_turned_about_its_middle_axis(stiffness, turns):
    """``m`` is constant, so ``Gamma`` is the identity; the tip is that of an arc, or of a twisted rod."""
    moment, axis = about_the_middle(stiffness, turns)
    robot = mr.SingleRod(rod_of(stiffness))
    solution = mr.solve(robot, robot.inputs(tip_moment=moment)).raise_if_failed()
    assert solution.status == mr.Status.CONVERGED
    assert solution.stability != mr.Stability.UNSTABLE
    np.testing.assert_allclose(condition_and_determinant(solution), 1, rtol=1e-12)
    k = 2 * np.pi * turns / L
    arc = np.sin(k * L) / k * np.eye(3)[2] + (1 - np.cos(k * L)) / k * np.cross(axis, np.eye(3)[2])
    tip = (0, 0, L) if axis[2] else arc
    # 1e-8 of each of up to 200 steps that go round an arc
    np.testing.assert_allclose(solution.tip_position, tip, rtol=0, atol=1e-8 * L * max(1, turns))
    turned = Rotation.from_rotvec(2 * np.pi * turns * axis).as_matrix()
    np.testing.assert_allclose(solution.tip_rotation, turned, rtol=0, atol=1e-7 * turns)


@pytest.mark.parametrize("turns", [2.3, 7.3])
def test_a_rod_that_tumbles_against_another_integration(turns, make_pose):
    """Next to the middle axis, from a base that is turned: nothing is exact but ``m``."""
    stiffness = ORDERS[0]
    base = make_pose((0.1, -0.2, 0.3), (0.3, 0.5, -0.7))
    moment, _ = about_the_middle(stiffness, turns)
    frame = base[:3, :3] @ Rotation.from_rotvec((0, 0, 0.4)).as_matrix()
    m = frame @ Rotation.from_rotvec((0.02, 0.04, 0.05)).apply(moment)
    robot = mr.SingleRod(rod_of(stiffness, precurvature=(3, -1, 2)), base=base)
    solution = mr.solve(robot, robot.inputs(tip_moment=m, rotation=0.4), solver=mr.Shooting(integrator=EXACT)).raise_if_failed()
    np.testing.assert_allclose(condition_and_determinant(solution), 1, rtol=1e-12)
    section = {
        "length": L,
        "bending_stiffness": stiffness[:2],
        "torsional_stiffness": stiffness[2],
        "precurvature": np.array((3.0, -1, 2)),
    }
    equations = RodEquations([section], {})
    start = np.concatenate([base[:3, 3], frame.ravel(), np.zeros(3), m])[None]
    end = equations.carry([0.0], [L], start, rtol=1e-12)[0]
    # 1e-11 a step, and what a tumbling top makes of it
    np.testing.assert_allclose(solution.tip_position, end[:3], rtol=0, atol=1e-7 * L)
    np.testing.assert_allclose(solution.tip_rotation.ravel(), end[3:12], rtol=0, atol=1e-6)


def test_a_moment_spread_along_the_rod():
    """``m(s) = l (L - s)``, of 10 turns a length at the base."""
    stiffness = ORDERS[0]
    moment, _ = about_the_middle(stiffness, 10)
    robot = mr.SingleRod(rod_of(stiffness))
    solution = mr.solve(robot, robot.inputs(distributed_moment=moment / L)).raise_if_failed()
    assert solution.stability != mr.Stability.UNSTABLE
    np.testing.assert_allclose(condition_and_determinant(solution), 1, rtol=1e-12)
    np.testing.assert_allclose(solution.unknowns, (moment[0] / stiffness[0], 0, 0), rtol=1e-12, atol=1e-9)
    # the angle at the tip is the integral of m / EI
    np.testing.assert_allclose(solution.tip_rotation, Rotation.from_rotvec((10 * np.pi, 0, 0)).as_matrix(), rtol=0, atol=1e-6)


@pytest.mark.filterwarnings("ignore::multirod.PlausibilityWarning")
@pytest.mark.parametrize("turns", [7, 10])
def test_tubes_turned_about_their_middle_axis(turns):
    """Two tubes that bend together and twist apart: the outer one, equally stiff about all axes across, carries no torque."""
    robot = mr.ConcentricTubes([rod_of((0.04, 0.08, 0.03)), rod_of((0.01, 0.01, 0.02))])
    moment, _ = about_the_middle((0.05, 0.09, 0.03), turns)
    solution = mr.solve(robot, robot.inputs(tip_moment=moment)).raise_if_failed()
    assert solution.status == mr.Status.CONVERGED
    assert solution.stability != mr.Stability.UNSTABLE
    assert solution.determinant > 0
    np.testing.assert_allclose(solution.tip_rotation, np.eye(3), rtol=0, atol=1e-6)
    # over the sum of what is stiffer of each
    np.testing.assert_allclose(solution.unknowns, (moment[0] / 0.09, 0, 0, 0), rtol=1e-12, atol=1e-9)


def test_the_residual_is_that_of_the_frame_seen_along_the_base(make_pose):
    """A moment that is next to nothing turns the rows of ``Gamma``, and the modes of energy descent not at all."""
    rod = rod_of((0.2, 0.3, 0.1), precurvature=(4, 1, 2))
    robot = mr.SingleRod(rod, base=make_pose((0, 0, 0), (0.5, -0.8, 0.3)))
    values = {"tip_force": (0.4, 0.6, -0.2), "rotation": 0.7}
    none, tiny = robot.inputs(**values), robot.inputs(**values, tip_moment=(0, 0, 1e-13))
    options = {"integrator": EXACT, "pose_sensitivities": True, "direction_count": 1}
    x = mr.solve(robot, none, solver=mr.Shooting(integrator=EXACT, tolerance=1e-11)).raise_if_failed().unknowns[None]
    found = []
    for inputs in (none, tiny):
        problem = robot.problem(inputs, **options)
        problem.write("unknowns", x)
        track = EnergyDescentTrack(mr.EnergyDescent(feed_forward=False, integrator=EXACT), problem, corrected=False)
        eps, gamma = problem.evaluate(x)
        track._update()
        found.append((gamma[0], problem.read("rotation").reshape(3, 3), track.state.margin.numpy()[0], eps))
    (frame, tip, margin, _), (axes, _, same_margin, eps) = found
    assert np.abs(eps).max() < 1e-9
    turned = Rotation.from_rotvec((0, 0, 0.7)).as_matrix().T @ robot.base[:3, :3].T @ tip
    unit = np.array((0.2, 0.3, 0.1))
    np.testing.assert_allclose(axes, (turned @ (unit[:, None] * frame)) / unit[:, None], rtol=0, atol=1e-8)
    np.testing.assert_allclose(same_margin, margin, rtol=1e-8)


@pytest.mark.parametrize("turns", [7, 8, 9, 10, 12, 14])
def test_a_moment_that_turns_with_the_tip_is_unstable_only_where_its_determinant_has_a_sign(turns):
    """``Gamma`` is the top's own flow, whose determinant is 1: rounding leaves -1e20 to 1e20, negative for some of these
    turns."""
    moment, _ = about_the_middle(ORDERS[0], turns)
    robot = mr.SingleRod(rod_of(ORDERS[0]))
    problem = robot.problem(robot.inputs(follower_moment=moment), integrator=mr.RK45())
    x = moment[None] / ORDERS[0]
    _, gamma = problem.evaluate(x)
    assert np.linalg.cond(gamma[0]) > 1e12
    assert problem.stability.modes().stability[0] == mr.Stability.UNKNOWN


def test_a_determinant_whose_sign_rounding_hides_is_none():
    """The sign of ``det Gamma`` tells of divergence only where it has one."""
    matrices = np.stack([np.diag([1.0, -1e-9, 1.0]), np.diag([1e8, -1e-8, 1.0]), np.zeros((3, 3)), np.full((3, 3), np.nan)])
    np.testing.assert_allclose(certain_determinant(matrices), [-1e-9, np.nan, np.nan, np.nan], rtol=1e-12)
