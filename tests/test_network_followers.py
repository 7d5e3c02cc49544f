"""Loads that follow the bodies and free tips of networks: against a single rod, parallel rods and differences."""

import numpy as np
import pytest
from test_check_assembly import check_assembly
from test_network import BASE_ANGLES, FORCE, GIVEN, LEG, PLATE_ANGLES, circle, hold_gamma_against_differences, mixed

import multirod as mr

SOLVER = mr.Shooting(tolerance=1e-12, integrator=mr.RK4(50))
FOLLOWING = {
    "follower_force": {"plate": (0.2, -0.1, 0.3), "top": (0.1, 0.2, -0.1), "feeler": (0.1, -0.2, 0.05)},
    "follower_moment": {"plate": (0.02, 0.01, -0.02), "top": (0.01, -0.02, 0.01), "feeler": (0.002, 0.01, -0.01)},
}
NAMES = {"force": "tip_force", "follower_force": "follower_force", "follower_moment": "follower_moment"}


def test_one_rod_is_a_single_rod(wire):
    """Its tip free, or held by a body: the same equilibrium and derivatives. Without dead moments its steps are those of the
    others."""
    single = mr.SingleRod(wire)
    given = {"force": (0.5, 0.2, 0.1), "follower_force": (1, -0.5, 0.3), "follower_moment": (0.03, 0, 0.02)}
    expected = mr.solve(single, single.inputs(rotation=0.3, **{NAMES[k]: v for k, v in given.items()}), solver=SOLVER)
    tip = mr.Body("tip")
    joints = [mr.Joint("wire", "base", to=mr.ground), mr.Joint("wire", "tip", to=tip)]
    for name, robot in (
        ("wire", mr.Network(rods={"wire": wire}, joints=joints[:1])),
        ("tip", mr.Network(rods={"wire": wire}, bodies=[tip], joints=joints)),
    ):
        found = mr.solve(robot, robot.inputs(rotation=0.3, **{k: {name: v} for k, v in given.items()}), solver=SOLVER)
        assert found.raise_if_failed().stability is mr.Stability.UNKNOWN
        np.testing.assert_allclose(found.tip_position, expected.tip_position, rtol=0, atol=1e-12)
        np.testing.assert_allclose(found.tip_rotation, expected.tip_rotation, rtol=0, atol=1e-12)
        for own, other in NAMES.items():
            by = expected.jacobian(other)
            np.testing.assert_allclose(found.jacobian(own), by, rtol=0, atol=1e-12 * np.abs(by).max())


def test_a_plate_is_a_platform():
    robot = mr.ParallelRods(legs=[LEG] * 6, base=circle(BASE_ANGLES, 0.087), platform=circle(PLATE_ANGLES, 0.087))
    network = mr.stacked(robot)
    force, moment = (0.5, -0.8, 0.3), (0.02, 0.05, -0.1)
    expected = mr.solve(robot, robot.inputs(tip_force=FORCE, follower_force=force, follower_moment=moment), solver=SOLVER)
    found = mr.solve(network, network.inputs(force=FORCE, follower_force=force, follower_moment=moment), solver=SOLVER)
    np.testing.assert_allclose(found.raise_if_failed().tip_position, expected.tip_position, rtol=0, atol=1e-11)
    for name in ("follower_force", "follower_moment"):
        by = expected.jacobian(name)
        np.testing.assert_allclose(found.jacobian(name), by, rtol=0, atol=1e-9 * np.abs(by).max())


@pytest.mark.parametrize("level", [1.0, 0.4])
def test_gamma_by_differences_of_the_sixth_order(difference, level):
    """(28) Off the equilibrium and on the way there, on bodies and on a tip whose base turns."""
    hold_gamma_against_differences(mixed("feeler"), GIVEN | FOLLOWING, level, difference)


def test_derivatives():
    """``check_assembly`` holds columns by the loads that follow against differences."""
    robot = mixed("feeler")
    check_assembly(robot, robot.inputs(**GIVEN, **FOLLOWING), tip_rod=3, vary=tuple(FOLLOWING), solvers=("shooting",))


def test_arrows_stand_in_the_frames_that_loads_follow():
    robot = mixed("feeler")
    solution = mr.solve(robot, robot.inputs(**FOLLOWING)).raise_if_failed()
    from multirod.plotting.scene import _on_places

    arrows = {arrow.name.split(" on ")[1].split()[0]: arrow for arrow in _on_places(solution, robot) if "force" in arrow.name}
    for name in ("plate", "top"):
        turned = solution.body_rotation(name) @ FOLLOWING["follower_force"][name]
        np.testing.assert_allclose(arrows[name].vectors[0], turned, rtol=1e-12)
    # of a rod on nodes, whose steps are others
    turned = solution.tip_rotation @ FOLLOWING["follower_force"]["feeler"]
    np.testing.assert_allclose(arrows["feeler"].vectors[0], turned, rtol=1e-7)
