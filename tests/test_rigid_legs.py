"""Legs, and rods of networks, that are rigid in torsion: where they carry a torque together, by what twists a little more."""

import numpy as np
import pytest
from test_network import circle, pose

import multirod as mr

pytestmark = pytest.mark.filterwarnings("ignore::multirod.PlausibilityWarning")  # of what hardly twists

EI, LENGTH = 0.02, 0.5
ANGLES = np.arange(3) * 120.0


def wire(ratio, **options):
    return mr.Rod(**{"length": LENGTH, "bending_stiffness": EI, "torsional_stiffness": ratio * EI} | options)


def legs(ratio, joints="clamped", platform=0.1, **options):
    places = circle(ANGLES, 0.1), circle(ANGLES, platform)
    return mr.ParallelRods(legs=[wire(ratio, **options)] * 3, base=places[0], platform=places[1], joints=joints)


def stacked(ratio):
    """A plate on three legs that lean, a hat on it that two masts carry side by side."""
    plate, hat, base, tips = mr.Body("plate"), mr.Body("hat"), circle(ANGLES, 0.1), circle(ANGLES, 0.06)
    rods, joints = {}, []
    for k in range(3):
        rods[f"leg {k}"] = wire(ratio)
        joints.append(mr.Joint(f"leg {k}", "base", to=mr.ground, pose=base[k]))
        joints.append(mr.Joint(f"leg {k}", "tip", to=plate, pose=tips[k]))
    for k, x in enumerate((-0.02, 0.02)):
        rods[f"mast {k}"] = wire(ratio, length=0.4 * LENGTH)
        joints.append(mr.Joint(f"mast {k}", "base", to=plate, pose=pose(position=(x, 0, 0))))
        joints.append(mr.Joint(f"mast {k}", "tip", to=hat, pose=pose(position=(x, 0, 0))))
    return mr.Network(rods=rods, bodies=[plate, hat], joints=joints)


@pytest.mark.parametrize("ratio", [1e7, np.inf], ids=["nearly", "rigid"])
@pytest.mark.parametrize("joints", ["clamped", ("clamped", "spherical", "clamped")], ids=["clamped", "mixed"])
def test_straight_legs_side_by_side_that_do_not_twist_are_solved_under_a_load_across(joints, ratio):
    """(36) of docs/held.md: at rest each torque that they hold among each other is as good as any; 1900 to 4400 integrations
    led to `LOWEST_ENERGY`, or none to a result."""
    force = EI / LENGTH**2 * np.array([2.0, 1.0, -3.0])
    robots = [legs(own, joints) for own in (ratio, 1e5)]
    found, expected = (mr.solve(robot, robot.inputs(tip_force=force)).raise_if_failed() for robot in robots)
    assert (found.status, found.stability) == (mr.Status.CONVERGED, mr.Stability.STABLE)
    assert found.integrations < 250  # 40 to 120 were measured
    np.testing.assert_allclose(found.tip_position, expected.tip_position, rtol=0, atol=1e-5 * LENGTH)
    np.testing.assert_allclose(found.energy, expected.energy, rtol=1e-4)


@pytest.mark.parametrize("force", [(0, 0, 0), (0, 0, -0.1)], ids=["unloaded", "pressed"])
def test_a_torque_that_nothing_determines_is_no_result(force):
    """Straight legs that do not twist hold any torque among each other: it was `STALLED` after 4200 integrations."""
    robot = legs(np.inf)
    found = mr.solve(robot, robot.inputs(tip_force=force))
    assert found.status is mr.Status.UNDETERMINED
    assert np.isnan(found.tip_position).all()
    assert found.integrations < 150  # 95
    twisting = legs(1e3)
    assert mr.solve(twisting, twisting.inputs(tip_force=force)).status is mr.Status.CONVERGED
    # each is as it is alone
    both = mr.solve(robot, robot.inputs(tip_force=[force, (0.3, 0, 0)]))
    assert [mr.Status(k) for k in both.status] == [mr.Status.UNDETERMINED, mr.Status.CONVERGED]
    alone = mr.solve(robot, robot.inputs(tip_force=(0.3, 0, 0)))
    assert np.array_equal(both.tip_position[1], alone.tip_position)


def test_masts_that_do_not_twist_are_solved_on_a_plate_that_moves():
    """The network was `STALLED` or found nothing after 2500 to 7600 integrations."""
    force = {"plate": EI / LENGTH**2 * np.array([2.0, 1.0, -3.0]), "hat": EI / LENGTH**2 * np.array([0.5, 1.0, 0.0])}
    robots = [stacked(ratio) for ratio in (np.inf, 1e5)]
    found, expected = (mr.solve(robot, robot.inputs(force=force)).raise_if_failed() for robot in robots)
    assert (found.status, found.stability) == (mr.Status.CONVERGED, mr.Stability.STABLE)
    assert found.integrations < 300
    np.testing.assert_allclose(found.tip_position, expected.tip_position, rtol=0, atol=1e-5 * LENGTH)
    for straight in ({"plate": force["plate"]}, {"hat": (0, 0, -0.1)}):  # masts that nothing bends
        found = mr.solve(robots[0], robots[0].inputs(force=straight))
        assert found.status is mr.Status.UNDETERMINED
        assert np.isnan(found.tip_position).all()
        assert found.integrations < 150
