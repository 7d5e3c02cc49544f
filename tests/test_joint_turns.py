"""Joints that are turned far: by more than a right angle, up to half a turn and past it."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from test_network_rods import at

import multirod as mr

STEPS = mr.RK4(50)
SOLVER = mr.Shooting(tolerance=1e-11, integrator=STEPS)
ROD = mr.Rod(length=0.3, bending_stiffness=0.02, torsional_stiffness=0.015)
NODES, WEIGHTS = np.array([-3, -2, -1, 1, 2, 3]), np.array([-1, 9, -45, 45, -9, 1]) / 60  # a derivative, error O(h^6)
ANGLES = np.radians([0, 60, 89, 91, 120, 150, 179, 180, 181, 270, 360])


def hinged(turn):
    """A straight rod whose hinge about x is turned from where it rests."""
    end = at(0, 0, 0.3)
    end[:3, :3] = Rotation.from_rotvec(turn).as_matrix().round(15)
    return mr.HeldRod(ROD, end=end, joint="revolute", joint_axis=(1, 0, 0))


@pytest.mark.parametrize("degrees", [100, 119, 121, 150, 175, 180])
def test_an_axis_that_is_turned_back_is_told_by_its_angle(degrees):
    """(6) of ``docs/parallel.md`` at rest: at half a turn there was a second root, and no number for ``Gamma``."""
    robot = hinged((0, 0, np.radians(degrees)))
    problem = robot.problem(robot.inputs(), integrator=STEPS)
    problem.load_factor.fill_(1.0)
    residual, gamma = problem.evaluate(np.zeros((1, problem.unknown_count)))
    assert np.isfinite(gamma).all()
    np.testing.assert_allclose(np.linalg.norm(residual[0, 3:]), np.radians(degrees) / 0.3, rtol=1e-12)
    # along the way back; across it the derivative of an angle has no limit
    twist, step = np.array([0, 0, 1.0, 0, 0, 0]), 1e-2
    nodes = NODES if degrees < 180 else NODES - 3.5  # on one side
    values = np.array([problem.evaluate(step * node * twist[None])[0][0] for node in nodes])
    expected = WEIGHTS @ values / step if degrees < 180 else (values[-1] - values[0]) / (6 * step)
    np.testing.assert_allclose(gamma[0] @ twist, expected, rtol=0, atol=1e-8 * np.abs(expected).max())


def test_a_straight_rod_whose_hinge_is_turned_back_ends():
    """It does not stretch and is straight: there is no way on, and that is said (a ``ValueError`` before)."""
    robot = hinged((0, 0, np.pi))
    assert mr.solve(robot, robot.inputs(), solver=SOLVER).failed


def test_hinges_about_rods_turn_round_and_round():
    """Round legs that turn in hinges about themselves carry what they did before."""
    base, platform = (np.array([at(r * np.cos(a), r * np.sin(a)) for a in np.radians([0, 120, 240])]) for r in (0.06, 0.04))
    legs = mr.ParallelRods(legs=[ROD] * 3, base=base, platform=platform, joints="revolute")
    rotation = ANGLES[:, None] * [1, 0, 0]
    for robot, given in (
        (legs, {"rotation": rotation, "tip_force": (0.3, 0.1, -0.2)}),
        (mr.stacked(legs), {"rotation": {"level 1 0": ANGLES}, "force": {"level 1": (0.3, 0.1, -0.2)}}),
    ):
        found = mr.solve(robot, robot.inputs(**given), solver=SOLVER).raise_if_failed()
        np.testing.assert_allclose(found.tip_position, np.tile(found.tip_position[0], (len(ANGLES), 1)), rtol=0, atol=1e-9)


@pytest.mark.parametrize("kind", ["revolute", "universal"])
def test_springs_of_joints_are_wound_past_half_a_turn(kind):
    """A hand carries a rod in a sprung hinge, or universal joint, once around it: the rod stays straight but for the spring,
    whose torque is that of the angle."""
    hand = mr.Body("hand", pose=at(0, 0, 0.3), fixed=True)
    axis = (1, 0, 0) if kind == "revolute" else [(1, 0, 0), (0, 1, 0)]
    stretchy = mr.Rod(length=0.3, bending_stiffness=0.02, torsional_stiffness=0.015, axial_stiffness=1e3)
    joints = [
        mr.Joint("rod", "base", to=mr.ground, kind=kind, axis=axis, stiffness=1e-5),
        mr.Joint("rod", "tip", to=hand),
    ]
    robot = mr.Network(rods={"rod": stretchy}, bodies=[hand], joints=joints)
    angle = np.linspace(0, np.radians(350), 71)
    around = 0.3 * np.stack([0 * angle, -np.sin(angle), np.cos(angle) - 1], axis=1)
    history = mr.simulate(
        robot, robot.inputs(fixed_position=around, fixed_rotation=angle[:, None] * [1, 0, 0]), time=angle, solver=SOLVER
    )
    assert not history.failed.any()
    # the spring bends the rod by k theta L/EI at most, 1e-3 of the angle, which it is wound less by
    torque = history.rod(0).moment[:, 0, 0]
    np.testing.assert_allclose(torque, 1e-5 * angle, rtol=2e-3, atol=1e-12)
