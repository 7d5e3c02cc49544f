"""Frames of bodies: what acts on them, what is controlled there, and how they are recorded."""

import numpy as np
import pytest
from exact_columns import along_inputs
from scipy.spatial.transform import Rotation
from test_joint_slides import EXACT, slid
from test_joint_slides import GIVEN as SLID
from test_network import BASE_ANGLES, LEG, PLATE_ANGLES, circle, hold_gamma_against_differences, pose
from test_network_branches import hold_forces_against_the_potential
from test_recording import Recording, arrows_of

import multirod as mr

TOOL = ("plate", "tool")
DEAD = {"force": {TOOL: (0.2, -0.15, 0.3), "plate": (0.3, 0.2, -0.2), "feeler": (0.1, 0.05, -0.1)}}
LOADS = DEAD | {
    "moment": {TOOL: (0.02, -0.01, 0.015)},
    "follower_force": {TOOL: (-0.1, 0.2, 0.15)},
    "follower_moment": {TOOL: (0.01, 0.02, -0.02)},
}
GIVEN = {**SLID, **LOADS}
AT_TOOL = pose((0.3, -0.2, 0.1), (0.02, -0.03, 0.05))


def hexapod():
    """Six legs on a plate, whose tool is the end effector."""
    plate = mr.Body("plate", frames={"tool": AT_TOOL})
    ends = (("base", mr.ground, circle(BASE_ANGLES, 0.087)), ("tip", plate, circle(PLATE_ANGLES, 0.087)))
    joints = [mr.Joint(f"leg {k}", end, to=to, pose=at[k]) for end, to, at in ends for k in range(6)]
    return mr.Network(rods={f"leg {k}": LEG for k in range(6)}, bodies=[plate], joints=joints, end_effector=TOOL)


def of_plate(solution):
    """Where the tool is, by the plate alone."""
    position, rotation = solution.body_position("plate"), solution.body_rotation("plate")
    return position + rotation @ AT_TOOL[:3, 3], rotation @ AT_TOOL[:3, :3]


def test_what_acts_on_a_frame_acts_on_its_body_with_a_lever():
    """(39) At the equilibrium, the wrench about the body's origin in the place of the four loads leaves the same residual."""
    robot = slid()
    assert robot.load_places == ("plate", "top", "feeler", "tool of plate")
    found = mr.solve(robot, robot.inputs(**GIVEN), solver=EXACT).raise_if_failed()
    frame, R = robot.bodies[0].frames["tool"], found.body_rotation("plate")
    held = R @ frame[:3, :3]
    force = np.add(LOADS["force"][TOOL], held @ LOADS["follower_force"][TOOL])
    moment = np.add(LOADS["moment"][TOOL], held @ LOADS["follower_moment"][TOOL]) + np.cross(R @ frame[:3, 3], force)
    plain = {**SLID, "force": {**DEAD["force"], "plate": np.add(DEAD["force"]["plate"], force), TOOL: 0 * force}}
    again = mr.solve(robot, robot.inputs(**plain, moment={"plate": moment}), solver=EXACT, guess=found)
    assert again.iterations == 0  # the residual is below the tolerance, 1e-11 [1/m], where it was
    np.testing.assert_array_equal(again.unknowns, found.unknowns)


def test_a_force_on_a_frame_is_one_at_the_point_of_a_platform():
    parallel = mr.ParallelRods(legs=[LEG] * 6, base=circle(BASE_ANGLES, 0.087), platform=circle(PLATE_ANGLES, 0.087))
    robot, tool = hexapod(), AT_TOOL
    load, follower = np.array([0.5, -0.3, -2.0]), np.array([0.3, 0.2, -0.5])
    by_legs = parallel.inputs(tip_force=load, follower_force=tool[:3, :3] @ follower, force_point=tool[:3, 3])
    expected = mr.solve(parallel, by_legs, solver=EXACT).raise_if_failed()
    given = robot.inputs(force={TOOL: load}, follower_force={TOOL: follower})
    found = mr.solve(robot, given, solver=EXACT).raise_if_failed()
    point = expected.tip_position + expected.tip_rotation @ tool[:3, 3]
    np.testing.assert_allclose(found.tip_position, point, atol=1e-10)
    np.testing.assert_allclose(found.tip_rotation, expected.tip_rotation @ tool[:3, :3], atol=1e-10)
    np.testing.assert_allclose(found.body_position("plate"), expected.tip_position, atol=1e-10)
    # how the point gives way to a force there, and with a force there the stiffness of the end effector
    assert robot.load_places == ("plate", "tool of plate")
    by_tool, carried = found.jacobian("force")[:, 3:], expected.jacobian("tip_force").copy()
    carried[:3] += np.cross(carried[3:].T, expected.tip_rotation @ tool[:3, 3]).T
    np.testing.assert_allclose(by_tool, carried, rtol=0, atol=1e-9 * np.abs(carried).max())
    compliance = np.concatenate([by_tool, found.jacobian("moment")[:, 3:]], axis=1)
    np.testing.assert_allclose(found.stiffness @ compliance, np.eye(6), atol=1e-8)


@pytest.mark.parametrize("level", [1.0, 0.4])
def test_gamma_by_differences_of_the_sixth_order(difference, level):
    hold_gamma_against_differences(slid(), GIVEN, level, difference)


def test_columns_by_loads_on_frames_off_the_equilibrium(difference):
    _, _, rate, moved = along_inputs(slid(), slid().inputs(**GIVEN), tuple(LOADS))
    # the residual is linear in loads: rounding of differences of 1e-2
    np.testing.assert_allclose(rate, difference(moved, 1e-2), atol=1e-8)


def test_a_dead_force_on_a_frame_has_a_potential():
    hold_forces_against_the_potential(slid(), {**SLID, **DEAD}, push=0.02)


def test_what_frames_are_called():
    robot = slid()
    one, other = robot.inputs(force={TOOL: (1, 2, 3)}), robot.inputs(force={"tool of plate": (1, 2, 3)})
    np.testing.assert_array_equal(one.force, other.force)
    with pytest.raises(ValueError, match="must be by name, one of .*'tool of plate'"):
        robot.inputs(force={("plate", "tol"): (1, 2, 3)})
    plate, named = mr.Body("plate", frames={"tool": np.eye(4)}), mr.Body("tool of plate")
    joints = [mr.Joint("leg", "base", to=mr.ground), mr.Joint("leg", "tip", to=plate)]
    joints += [mr.Joint("more", "base", to=plate), mr.Joint("more", "tip", to=named)]
    with pytest.raises(ValueError, match=r"Body.frames = \('plate', 'tool'\) .*: must not be called as a rod, a body"):
        mr.Network(rods={"leg": LEG, "more": LEG}, bodies=[plate, named], joints=joints)


def test_a_controller_takes_a_frame_along_a_moving_target():
    """Position and rotation of the tool, by the plate's pose where a solve has it at the commands."""
    robot, solver = hexapod(), mr.Shooting(tolerance=1e-11, integrator=mr.RK4(50))
    given = {"force": {TOOL: (0.5, -0.3, -2.0)}}
    start = mr.solve(robot, robot.inputs(**given), solver=solver).raise_if_failed()
    loop = mr.Controller(robot, dt=0.005, free="translation", inputs=robot.inputs(**given), guess=start, integrator=mr.RK4(50))
    turn = Rotation.from_rotvec((0.02, -0.03, 0.01))
    for k in range(20):
        share = k / 19
        goal = start.tip_position + share * np.array([0.002, -0.001, 0.003])
        turned = Rotation.from_rotvec(share * turn.as_rotvec()).as_matrix() @ start.tip_rotation
        command = loop.step(position=goal, rotation=turned)
        assert command.status is mr.Status.TRACKING
    there = mr.solve(robot, robot.inputs(**given, translation=command.inputs.translation), solver=solver, guess=command)
    position, rotation = of_plate(there.raise_if_failed())
    # second order in what a sample moves, and its lag in how much that changes: 4e-10 was found; columns without the lever of the
    # tool would leave 1e-8, as each next sample makes up for what the last one missed by
    np.testing.assert_allclose(position, goal, rtol=0, atol=2e-9)
    np.testing.assert_allclose(rotation, turned, rtol=0, atol=2e-9)


@pytest.mark.usefixtures("written_here")
def test_frames_are_recorded_where_they_are(tmp_path):
    """The end effector, and arrows of what acts there: dead in the world, and what follows in the axes of the frame."""
    robot, time = hexapod(), 0.1 * np.arange(3)
    dead, follower = np.zeros((3, 6)), np.zeros((3, 6))
    dead[:, 3:], follower[:, 3] = (0.5, -0.3, -2.0), 0.4 + time
    inputs = robot.inputs(force=dead, follower_force=follower)
    history = mr.simulate(robot, inputs, time=time, solver=mr.Shooting(integrator=mr.RK4(50))).raise_if_failed()
    history.save(tmp_path / "run.rrd", nodes=5, force_scale=0.1)
    recording = Recording(tmp_path / "run.rrd")
    places, turns = zip(*(of_plate(sample) for sample in history), strict=True)
    np.testing.assert_allclose(np.array(recording.column("/world/tip", "Transform3D:translation"))[:, 0], places, atol=1e-7)
    found = Rotation.from_quat(np.array(recording.column("/world/tip", "Transform3D:quaternion"))[:, 0])
    np.testing.assert_allclose(found.as_matrix(), turns, atol=1e-6)
    arrows, origins = arrows_of(recording, r"force/tool\ of\ plate")
    np.testing.assert_allclose(arrows, 0.1 * dead[:, 3:], atol=1e-7)
    np.testing.assert_allclose(origins, places, atol=1e-7)
    arrows, origins = arrows_of(recording, r"follower_force/tool\ of\ plate")
    np.testing.assert_allclose(arrows, 0.1 * np.einsum("kij,kj->ki", turns, follower[:, 3:]), atol=1e-7)
    np.testing.assert_allclose(origins, places, atol=1e-7)
    (text,) = recording.column("/description", "TextDocument:text", static=True)
    assert "**End effector** tool of plate" in text[0]


def test_a_load_on_a_free_tip_is_drawn_beside_a_fixed_body():
    hand = mr.Body("hand", pose=np.eye(4), fixed=True, frames={"grip": pose((0.3, 0, 0))})
    joints = [mr.Joint("arm", "base", to=hand, pose="grip"), mr.Joint("other", "base", to=hand)]
    robot = mr.Network(rods={"arm": LEG, "other": LEG}, bodies=[hand], joints=joints, end_effector="other")
    assert robot.load_places == ("arm", "other")  # nothing acts on what is fixed
    solution = mr.solve(robot, robot.inputs(force={"arm": (0.1, 0.2, 0)}), solver=EXACT).raise_if_failed()
    from multirod.plotting.scene import _on_places

    (arrow,) = _on_places(solution, robot)
    # on nodes, whose steps are others
    np.testing.assert_allclose(arrow.origins[0], solution.rod("arm").position[-1], atol=1e-8)
