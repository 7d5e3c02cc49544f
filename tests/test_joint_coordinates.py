"""What solutions say of joints: how far they have turned and slid, against springs, frames of rods and what drives them."""

import numpy as np
import pytest
import test_driven_joints as driven_joints
from scipy.spatial.transform import Rotation
from test_network import circle, pose

import multirod as mr

NITINOL = {"young_modulus": 60e9, "shear_modulus": 23e9}
ROD = mr.Rod(length=0.3, precurvature=(1, 0.5, 0), bending_stiffness=0.02, torsional_stiffness=0.015)
EXACT = mr.Shooting(tolerance=1e-11, integrator=mr.RK4(30))
AXES = {"revolute": (0, 0.6, 0.8), "universal": ((1, 0, 0), (0, 1, 0)), "cylindrical": (0.8, 0, 0.6)}
AT = pose((0.3, -0.2, 0.4), (0.05, 0.02, -0.1))


def arm(**joint):
    """A rod on a joint with a spring, its tip free."""
    return mr.Network(rods={"arm": ROD}, joints=[mr.Joint("arm", "base", to=mr.ground, **joint)])


def test_a_hinge_on_a_spring_is_turned_by_the_moment_over_its_stiffness():
    """The moment about the hinge is the same all along the rod, however it is bent; about the axis as the ground has it, counted
    by the right hand, from where the pose says; far beyond half a turn too."""
    axis, moment = AT[:3, :3] @ AXES["revolute"], np.array([[0.02, -0.05, 0.0], [0.01, 0.1, 0.4]])
    robot = arm(pose=AT, kind="revolute", axis=AXES["revolute"], stiffness=0.1, rest=0.3)
    solution = mr.solve(robot, robot.inputs(moment={"arm": moment[..., None] * axis}), solver=EXACT)
    assert solution.joint_angle("arm base").shape == (2, 3)
    # 30 steps carry the largest moment along a rod that is bent by six radians: to 5e-9
    np.testing.assert_allclose(solution.joint_angle("arm base"), 0.3 + moment / 0.1, rtol=0, atol=1e-8)
    np.testing.assert_array_equal(solution[1].joint_angle(robot.joints[0]), solution.joint_angle("arm base")[1])


def test_a_slide_on_a_spring_is_moved_by_the_force_over_its_stiffness():
    axis = AT[:3, :3] @ AXES["cylindrical"]
    robot = arm(pose=AT, kind="cylindrical", axis=AXES["cylindrical"], stiffness=(0.2, 5.0), rest=(0.1, -0.02))
    given = robot.inputs(force={"arm": 0.1 * axis}, moment={"arm": 0.03 * axis})
    solution = mr.solve(robot, given, solver=EXACT)
    np.testing.assert_allclose(solution.joint_slide("arm base"), -0.02 + 0.1 / 5.0, rtol=0, atol=1e-12)
    base = solution.rod("arm").position[0] - AT[:3, 3]
    np.testing.assert_allclose(base, solution.joint_slide("arm base") * axis, rtol=0, atol=1e-12)
    # the force acts beside the axis by as much as the rod is bent
    tip = solution.tip_position - AT[:3, 3]
    np.testing.assert_allclose(solution.joint_angle("arm base"), 0.1 + 0.03 / 0.2, rtol=0, atol=1e-9)  # by 30 steps
    assert np.linalg.norm(np.cross(tip, axis)) > 0.1


def several(driven):
    """A plate on three rods, in joints of all kinds, and a rod through a hole of it."""
    plate = mr.Body("plate", mass=0.05)
    feet, places = circle((0, 120, 240), 0.08), circle((10, 130, 250), 0.06)
    ends = [("universal", "left", "tip"), ("spherical", "right", "tip"), ("cylindrical", "back", "base")]
    joints = []
    for k, (kind, name, end) in enumerate(ends):
        own = {"kind": kind, "axis": AXES.get(kind), "driven": driven}
        for other in ("base", "tip"):
            to, where = (mr.ground, feet[k]) if other == "base" else (plate, places[k])
            joints.append(mr.Joint(name, other, to=to, pose=where, **(own if other == end else {})))
    spring = {"driven": True} if driven else {"stiffness": 0.1}
    joints.append(mr.Joint("through", "base", to=mr.ground, kind="revolute", axis=(1, 0, 0), **spring))
    joints.append(mr.Joint("through", "along", at=0.3, to=plate, kind="spherical"))
    rods = dict.fromkeys(("left", "right", "back"), ROD) | {"through": mr.Rod.wire(length=0.4, diameter=1e-3, **NITINOL)}
    return mr.Network(rods=rods, bodies=[plate], joints=joints)


def turned(solution, name):
    """By a joint, from its angles."""
    rod, end = name.split()
    joint = next(own for own in solution.assembly.joints if (own.rod, own.end) == (rod, end))
    angles = np.array(solution.joint_angle(name))
    if joint.kind == "universal":
        one, two = (Rotation.from_rotvec(angles[..., k, None] * joint.axes[k]) for k in range(2))
        return joint, (one * two).as_matrix()
    vectors = angles if joint.kind == "spherical" else angles[..., None] * joint.axes[0]
    return joint, Rotation.from_rotvec(vectors).as_matrix()


def test_rods_begin_and_end_as_their_joints_are_turned():
    robot = several(driven=False)
    force = np.array([(0.1, 0, 0), (0, 0.2, -0.1), (0.1, 0.1, 0.05)])
    given = robot.inputs(force={"plate": force}, gravity=(0, 0, -9.81))
    solution = mr.solve(robot, given, solver=EXACT).raise_if_failed()
    plate, at = solution.body_rotation("plate"), solution.body_position("plate")
    for name in ("left tip", "right tip", "back base", "through base"):
        joint, turn = turned(solution, name)
        node = 0 if joint.end == "base" else -1
        body, place = (np.eye(3), np.zeros(3)) if joint.end == "base" else (plate, at)
        assert np.abs(turn - np.eye(3)).max(axis=(1, 2)).min() > 1e-3
        expected = body @ joint.pose[:3, :3] @ turn
        # as far as the residual has frames of tips meet
        np.testing.assert_allclose(solution.rod(joint.rod).rotation[:, node], expected, rtol=0, atol=1e-10)
        if joint.kind == "cylindrical":
            slid = joint.pose[:3, 3] + solution.joint_slide(name)[..., None] * (joint.pose[:3, :3] @ joint.axes[0])
            expected = place + (body @ slid[..., None])[..., 0]
            np.testing.assert_allclose(solution.rod(joint.rod).position[:, node], expected, rtol=0, atol=1e-11)


def test_what_is_driven_is_where_it_is_driven_to():
    robot, t = several(driven=True), np.linspace(0, 0.2, 4)
    angle = {"left tip": t[:, None] * (1, -1), "right tip": t[:, None] * (0.5, 1, 1), "back base": -t, "through base": t}
    history = mr.simulate(robot, robot.inputs(angle=angle, slide={"back base": 0.02 * t}), time=t, solver=EXACT)
    history.raise_if_failed()
    for name, own in angle.items():
        np.testing.assert_array_equal(history.joint_angle(name), own)
    np.testing.assert_array_equal(history.joint_slide("back base"), 0.02 * t)
    data = history.to_xarray()
    np.testing.assert_array_equal(data["joint_angle"].sel(turned_joint="left tip 1"), -t)
    np.testing.assert_array_equal(data["joint_angle"].sel(turned_joint="through base"), t)
    np.testing.assert_array_equal(data["joint_slide"].sel(slid_joint="back base"), 0.02 * t)
    again = robot.inputs(angle={name: history[2].joint_angle(name) for name in angle}, slide={"back base": 0.02 * t[2]})
    np.testing.assert_array_equal(again.angle, history.inputs.angle[2])


def test_angles_of_driven_joints_are_those_that_were_given():
    robot, given = driven_joints.driven(), driven_joints.ANGLES
    angles = [0.4 * given[kind] for kind in ("revolute", "spherical", "universal")]
    inputs = robot.inputs(angle=driven_joints.by_name(robot, angles), **driven_joints.GIVEN)
    found = mr.solve(robot, inputs, solver=driven_joints.EXACT)
    for name, own in zip(robot.driven_joints, angles, strict=True):
        np.testing.assert_array_equal(found.joint_angle(name).reshape(-1), own)


def test_what_has_no_result_has_no_angle():
    robot = arm(kind="revolute", axis=(0, 1, 0), stiffness=0.1)
    given = robot.inputs(moment={"arm": [(0, 0, 0), (0, 0.3, 0)]})
    solution = mr.solve(robot, given, solver=mr.Shooting(max_integrations=2, fallback=False))
    assert solution.failed[1]
    assert np.isnan(solution.joint_angle("arm base")[solution.failed]).all()


def test_joints_without_such_a_coordinate_are_refused():
    robot = several(driven=True)
    solution = mr.solve(robot, robot.inputs())
    with pytest.raises(ValueError, match="must be one that turns: 'left tip', 'right tip'.*'left base' is clamped"):
        solution.joint_angle("left base")
    with pytest.raises(ValueError, match="must be one that slides: 'back base'; 'left tip' is universal"):
        solution.joint_slide("left tip")
    with pytest.raises(ValueError, match="did you mean 'left tip'"):
        solution.joint_angle("left tipp")
    with pytest.raises(ValueError, match="two nodes of rod"):
        solution.joint_slide(robot.joints[-1])
    wire = mr.SingleRod(ROD)
    with pytest.raises(AttributeError, match="SingleRod has no joints"):
        mr.solve(wire, wire.inputs()).joint_angle("rod base")
