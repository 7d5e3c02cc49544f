"""Joints whose ends slide along an axis, and springs at holes: against differences, robots made anew, and beams."""

import numpy as np
import pytest
from exact_columns import along_inputs
from test_check_assembly import check_assembly
from test_network import BENT, EXACT, circle, hold_gamma_against_differences, pose
from test_network_branches import hold_forces_against_the_potential
from test_network_derivatives import SOLVER, joints_moved, pose_rate
from test_network_rods import at
from test_sliding import GIVEN as THREADED
from test_sliding import threaded

import multirod as mr

AXIS = (0, 0.6, 0.8)
GIVEN = {
    "rotation": {"left": 0.3},
    "slide": {"right base": 0.012},
    "force": {"plate": (0.3, 0.2, -0.2), "feeler": (0.1, 0.05, -0.1)},
    "gravity": (0, 1, -9.81),
    "distributed_force": (0.1, 0.05, 0.2),
}
STRAIGHT = mr.Rod(length=0.3, bending_stiffness=0.2, torsional_stiffness=0.15, axial_stiffness=1e4)


def slid(end_effector="top", right="prismatic"):
    """A loop of two rods and a plate with two that stand on it: ends slide on the ground and on bodies, at bases and at tips,
    held by springs, driven, or by what else is there."""
    rail, both = {"kind": "prismatic", "axis": AXIS}, {"kind": "cylindrical", "axis": AXIS}
    plate = mr.Body("plate", mass=0.05, mass_centre=(0.01, 0, 0.02), frames={"tool": pose((0.3, 0.1, 0), (0.02, 0.01, 0.03))})
    top = mr.Body("top", mass=0.02)
    on_ground, on_plate = circle((0, 180), 0.08), circle((20, 200), 0.06)
    joints = [
        mr.Joint("left", "base", to=mr.ground, pose=on_ground[0], kind="prismatic", axis=(1, 0, 0), stiffness=60, rest=0.01),
        mr.Joint("left", "tip", to=plate, pose=on_plate[0], **both, stiffness=(0.2, 40), rest=(0.1, 0.005)),
        mr.Joint("right", "base", to=mr.ground, pose=on_ground[1], kind=right, axis=(0, 0, 1), driven=True),
        mr.Joint("right", "tip", to=plate, pose=on_plate[1], kind="prismatic", axis=(0, 0, 1)),
        mr.Joint("upper", "base", to=plate, pose=pose((0.2, 0, 0), (0.01, 0, 0.02)), **both, stiffness=(0.4, 90)),
        mr.Joint("upper", "tip", to=top, kind="spherical", stiffness=0.1),
        mr.Joint("feeler", "base", to=top, pose=pose((0.3, 0.5, 0), (0, 0, 0.01)), **rail, stiffness=50),
    ]
    rods = dict.fromkeys(("left", "right", "upper", "feeler"), BENT)
    return mr.Network(rods=rods, bodies=[plate, top], joints=joints, end_effector=end_effector)


@pytest.mark.parametrize("level", [1.0, 0.4])
def test_gamma_by_differences_of_the_sixth_order(difference, level):
    """Off the equilibrium, and on the way there."""
    hold_gamma_against_differences(slid(), GIVEN, level, difference)


@pytest.mark.parametrize("end_effector", ["feeler", "top", ("plate", "tool")])
def test_columns_by_inputs_off_the_equilibrium(end_effector, difference):
    """Of residual and pose, a frame of a body among them; a driven cylindrical joint has an angle and a displacement."""
    robot = slid(end_effector, right="cylindrical")
    assert robot.driven_joints == ("right base",)
    inputs = robot.inputs(**GIVEN, angle={"right base": 0.4})
    problem, x, rate, moved = along_inputs(robot, inputs, ("angle", "slide", "translation", "force"))
    np.testing.assert_allclose(rate, difference(moved, 1e-2), atol=1e-8)
    moved(0.0)
    way = np.random.default_rng(5).standard_normal(len(x[0]))

    def turned(t):
        problem.evaluate(x + t * way)
        return problem.read("position")[0]

    problem.evaluate(x)
    by_unknowns = problem.pose_columns.numpy()[0, :3, : problem.unknown_count] @ way
    np.testing.assert_allclose(by_unknowns, difference(turned, 1e-2), atol=1e-8)


def test_an_assembly_whose_joints_slide_conforms():
    check_assembly(slid("feeler"), slid("feeler").inputs(**GIVEN), tip_rod=3, vary=("slide", "force"), solvers=("shooting",))


def test_the_potential_and_its_second_variation():
    """(16), (25), (36), (37)"""
    robot = slid()
    solution = mr.solve(robot, robot.inputs(**GIVEN), solver=EXACT)
    assert solution.stability is mr.Stability.STABLE
    assert solution._modes.uncertainty.max() < 1e-8 * np.abs(solution._modes.values).max()
    hold_forces_against_the_potential(robot, GIVEN, push=0.02)


def test_columns_by_poses_of_joints_that_slid():
    """(D23): what slid goes with the pose."""
    robot = slid("feeler")
    solution = mr.solve(robot, robot.inputs(**GIVEN), solver=SOLVER).raise_if_failed()
    direction = np.random.default_rng(5).standard_normal((len(robot.joints), 6)) * ([0.05] * 3 + [1.0] * 3)
    other = joints_moved(robot, direction, 1e-4)
    moved = mr.solve(other, other.inputs(**GIVEN), solver=SOLVER, guess=solution).raise_if_failed()
    expected = pose_rate(solution, moved, 1e-4)
    found = solution.jacobian("joint_pose") @ direction.ravel()
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-9 * np.abs(expected).max())
    columns = solution.jacobian("slide", of="position", at=0.2, rod="feeler")
    given = [robot.inputs(**{**GIVEN, "slide": 0.012 + t}) for t in (-1e-4, 1e-4)]
    steps = [mr.solve(robot, own, solver=SOLVER, guess=solution).rod("feeler", nodes=3) for own in given]
    assert columns.shape == (3, 1)
    half = mr.solve(robot, robot.inputs(**GIVEN), solver=SOLVER).rod("feeler", nodes=3).arclength[1]
    columns = solution.jacobian("slide", of="position", at=half, rod="feeler")[:, 0]
    # differences of the second order of 1e-4
    np.testing.assert_allclose(columns, (steps[1].position[1] - steps[0].position[1]) / 2e-4, atol=1e-5)


def test_what_slides_freely_carries_nothing_along_its_axis_and_what_is_driven_is_there():
    """A cantilever whose tip is guided across: by beams, with a stub at the tip that turns by ``M l/EI``; a spring there takes
    what the rod does not; driven, it is where it is told."""
    guide = {"pose": at(z=0.3), "kind": "prismatic", "axis": (1, 0, 0)}
    base, carriage, force = mr.Joint("rod", "base", to=mr.ground), mr.Body("carriage"), 1e-4
    stub = mr.Rod(length=0.02, bending_stiffness=2.0, torsional_stiffness=2.0)
    for spring in (0.0, 50.0):
        on = mr.Joint("stub", "base", to=mr.ground, **guide, stiffness=spring)
        joints = [base, mr.Joint("rod", "tip", to=carriage), on, mr.Joint("stub", "tip", to=carriage, pose=at(z=0.02))]
        robot = mr.Network(rods={"rod": STRAIGHT, "stub": stub}, bodies=[carriage], joints=joints)
        found = mr.solve(robot, robot.inputs(force={"carriage": (force, 0, 0)}), solver=EXACT).raise_if_failed()
        slid = found.rod("stub").position[0, 0]
        np.testing.assert_allclose(found.rod("stub").force[0, 0], spring * slid, rtol=1e-6, atol=1e-6 * force)
        np.testing.assert_allclose(found.rod("rod").force[0, 0] + found.rod("stub").force[0, 0], force, rtol=1e-6)
        np.testing.assert_allclose(found.energy, 0.5 * force * found.tip_position[0], rtol=1e-6)  # of what is linear
        if not spring:
            turned = force * 0.3**2 / (2 * 0.2) / (1 + 2.0 / 0.02 * 0.3 / 0.2)
            expected = force * 0.3**3 / (3 * 0.2) - 2.0 / 0.02 * turned * 0.3**2 / (2 * 0.2)
            np.testing.assert_allclose(found.tip_position[0], expected, rtol=1e-6)
    hand = mr.Body("hand", pose=at(z=0.3), fixed=True, frames={"rail": at()})
    driven = mr.Joint("rod", "tip", to=hand, pose="rail", kind="prismatic", axis=(1, 0, 0), driven=True)
    robot = mr.Network(rods={"rod": STRAIGHT}, bodies=[hand], joints=[base, driven])
    assert [spec.name for spec in robot.input_specs][2] == "slide"
    moved = mr.solve(robot, robot.inputs(slide={"rod tip": 0.02}, fixed_position={"hand": (0, 0, -0.01)}), solver=EXACT)
    held = mr.Network(rods={"rod": STRAIGHT}, bodies=[hand], joints=[base, mr.Joint("rod", "tip", to=hand)])
    there = mr.solve(held, held.inputs(fixed_position={"hand": (0.02, 0, -0.01)}), solver=EXACT).raise_if_failed()
    np.testing.assert_allclose(moved.rod(0).position, there.rod(0).position, atol=1e-11)
    # what drives it pulls with what the energy gains
    given = [robot.inputs(slide=0.02 + t, fixed_position=(0, 0, -0.01)) for t in (-1e-4, 1e-4)]
    less, more = (mr.solve(robot, own, solver=EXACT).energy for own in given)
    end = moved.rod(0)
    np.testing.assert_allclose((end.rotation[-1] @ end.force[-1])[0], (more - less) / 2e-4, rtol=1e-4)


def sprung(stiffness=30.0, rest=None, names="ab"):
    """A rod through holes of a chain's bodies, some of which hold it by springs."""
    robot = threaded()
    joints = [
        mr.Joint("rod", "along", at=joint.at, to=joint.to, pose=joint.pose, kind=joint.kind, stiffness=stiffness, rest=rest)
        if joint.end == "along" and joint.to.name in names
        else joint
        for joint in robot.joints
    ]
    rods = dict(zip(robot.graph.whole_names, (whole.rods[0] for whole in robot.graph.whole), strict=True))
    return mr.Network(rods=rods, bodies=robot.bodies, joints=joints, end_effector="rod")


def test_springs_at_holes_by_differences(difference):
    hold_gamma_against_differences(sprung(), THREADED, 1.0, difference)
    vary = ("rotation", "translation", "force")
    check_assembly(sprung(), sprung().inputs(**THREADED), tip_rod=3, vary=vary, solvers=("shooting",))
    hold_forces_against_the_potential(sprung(), THREADED, push=0.005)


def test_a_spring_at_a_hole_holds_the_rod_by_its_force():
    """Below the ring the rod stretches, and its place there moves against the spring."""
    joints = [
        mr.Joint("rod", "base", to=mr.ground),
        mr.Joint("rod", "tip", to=mr.Body("weight")),
        mr.Joint("rod", "along", at=0.1, to=mr.Body("ring"), kind="prismatic", stiffness=200.0),
        mr.Joint("post", "base", to=mr.ground, pose=at(0.05)),
    ]
    ring, weight = joints[2].to, joints[1].to
    joints.append(mr.Joint("post", "tip", to=ring, pose=at(0.05)))
    post = mr.Rod(length=0.1, bending_stiffness=5.0, torsional_stiffness=5.0)
    soft = mr.Rod(length=0.3, bending_stiffness=0.2, torsional_stiffness=0.15, axial_stiffness=1000.0)
    robot = mr.Network(rods={"rod": soft, "post": post}, bodies=[ring, weight], joints=joints)
    found = mr.solve(robot, robot.inputs(force={"weight": (0, 0, 5.0)}), solver=EXACT).raise_if_failed()
    below, above = found.rod("rod").force[0, 2], found.rod("rod").force[-1, 2]
    np.testing.assert_allclose(above, 5.0, rtol=1e-8)
    # by N/EA of what is below
    place = found.rod("rod").position
    stretch = below / 1000.0 * 0.1
    np.testing.assert_allclose(above - below, 200.0 * stretch, rtol=5e-2)
    assert place[-1, 2] > 0.3
    energy = mr.solve(robot, robot.inputs(), solver=EXACT).energy
    assert abs(energy) < 1e-12


def test_what_slides_is_saved_and_what_it_cannot_be_is_named(tmp_path):
    robot = slid(("plate", "tool"))
    robot.save(tmp_path / "robot.toml")
    loaded = mr.load(tmp_path / "robot.toml")
    assert loaded.end_effector == ("plate", "tool")
    given = robot.inputs(**GIVEN)
    one, two = (mr.solve(own, own.inputs(**GIVEN), solver=EXACT) for own in (robot, loaded))
    np.testing.assert_array_equal(one.tip_position, two.tip_position)
    one.save(tmp_path / "solution.npz")
    np.testing.assert_array_equal(mr.load(tmp_path / "solution.npz").inputs.slide, given.slide)
    assert "slide" in mr.load(tmp_path / "solution.npz").inputs.given
    spring = sprung(rest=0.11)
    spring.save(tmp_path / "spring.toml")
    again = mr.load(tmp_path / "spring.toml")
    assert [float(joint.rest[0]) for joint in again.joints if joint.end == "along"] == [0.11, 0.11, again.joints[-1].at]
    body, rail = mr.Body("body", frames={"rail": at()}), {"kind": "prismatic", "axis": (1, 0, 0)}
    for match, more in (
        (r"Joint\.axis = None .* must be given for a prismatic joint: one of shape \(3,\)", {"kind": "prismatic"}),
        ("Joint.stiffness = 2.0 .* two numbers of a cylindrical", {"kind": "cylindrical", "axis": AXIS, "stiffness": 2.0}),
        ("Joint.rest = 0.1 .* without a stiffness", {**rail, "rest": 0.1}),
        ("frame = 'rial' .* one of those of body 'body': 'rail'; did you mean 'rail'", {"pose": "rial"}),
    ):
        with pytest.raises(ValueError, match=match):
            mr.Joint("arm", "tip", to=body, **more)
    with pytest.raises(ValueError, match="the ground has no frames"):
        mr.Joint("arm", "base", to=mr.ground, pose="rail")
    with pytest.raises(ValueError, match="Joint.rest = 0.1 .* without a stiffness"):
        mr.Joint("arm", "along", at=0.1, to=body, kind="spherical", rest=0.1)
    plain = mr.Network(rods={"arm": BENT}, joints=[mr.Joint("arm", "base", to=mr.ground)])
    with pytest.raises(ValueError, match="slide = .* no joint that slides is driven"):
        plain.inputs(slide={"arm base": 0.1})
    free = mr.Joint("arm", "base", to=mr.ground, **rail)
    with pytest.raises(ValueError, match="rod 'arm' is free to move"):
        mr.Network(rods={"arm": BENT}, joints=[free])


def test_a_tool_is_where_its_body_has_it():
    """Position, rotation, stiffness, and what reaches for a pose; forces stay those on the body."""
    robot, plain = slid(("plate", "tool")), slid("plate")
    tool = robot.bodies[0].frames["tool"]
    found, body = (mr.solve(own, own.inputs(**GIVEN), solver=EXACT) for own in (robot, plain))
    np.testing.assert_allclose(found.tip_position, body.tip_position + body.tip_rotation @ tool[:3, 3], atol=1e-13)
    np.testing.assert_allclose(found.tip_rotation, body.tip_rotation @ tool[:3, :3], atol=1e-13)
    np.testing.assert_array_equal(found.body_position(("plate", "tool")), found.tip_position)
    np.testing.assert_array_equal(found.body_rotation(("plate", "tool")), found.tip_rotation)
    np.testing.assert_allclose(found.body_position("plate"), body.tip_position, atol=1e-13)
    # stiffness: that of the body, told about the tool
    arm = body.tip_rotation @ tool[:3, 3]
    carried = np.eye(6)
    carried[:3, 3:] = np.cross(np.eye(3), arm)  # how the body moves as the tool turns
    expected = carried.T @ body.stiffness @ carried
    np.testing.assert_allclose(found.stiffness, expected, rtol=0, atol=1e-6 * np.abs(expected).max())
    goal = found.tip_position + (0.005, 0, 0.002)
    reached = mr.reach(robot, mr.Pose(position=goal), free=("translation",), inputs=robot.inputs(**GIVEN))
    np.testing.assert_allclose(reached.tip_position, goal, atol=1e-6)
    with pytest.raises(ValueError, match="must be one of those of body 'plate': 'tool'"):
        slid(("plate", "tip"))


def test_a_spring_at_a_hole_is_part_of_the_second_variation():
    """One without force there changes no equilibrium, and raises what the network resists with, by no more than itself."""
    plain = threaded()
    solution = mr.solve(plain, plain.inputs(**THREADED), solver=EXACT)
    arclength = solution.rod("rod").arclength
    place = arclength[1:][np.diff(arclength) == 0][0] - THREADED["translation"]["rod"]
    values = []
    for stiffness in (3.0, 300.0):
        robot = sprung(stiffness, float(place), "a")
        found = mr.solve(robot, robot.inputs(**THREADED), solver=EXACT)
        np.testing.assert_allclose(found.tip_position, solution.tip_position, atol=1e-10)
        assert found._modes.uncertainty.max() < 1e-8 * np.abs(found._modes.values).max()
        values.append(np.sort(found._modes.values.ravel()))
    free, soft, stiff = np.sort(solution._modes.values.ravel()), *values
    noise = 1e-8 * np.abs(free).max()
    assert (free <= soft + noise).all()
    assert (soft <= stiff + noise).all()
    assert (stiff - free).max() > 1e3 * noise
