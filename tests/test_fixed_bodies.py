"""Bodies of networks that are fixed, and moved by inputs: against ``HeldRod``, bodies put elsewhere, and differences."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from test_check_assembly import check_assembly
from test_network_derivatives import bases_moved, pose_rate
from test_network_rods import at

import multirod as mr

STEPS = mr.RK4(50)
SOLVER = mr.Shooting(tolerance=1e-11, integrator=STEPS)
ROD = mr.Rod(length=0.3, bending_stiffness=0.02, torsional_stiffness=0.015, precurvature=(1, 0.5, 0), linear_density=0.02)
END = at(0.05, 0, 0.25)
MOVED = {"fixed_position": {"hand": (0.01, 0.02, -0.01)}, "fixed_rotation": {"hand": (0.2, 0.1, 0.3)}}


def held(base=None):
    hand = mr.Body("hand", pose=END, fixed=True)
    joints = [mr.Joint("rod", "base", to=mr.ground), mr.Joint("rod", "tip", to=hand)]
    return mr.Network(rods={"rod": ROD}, bodies=[hand], joints=joints, base=base)


def tripod(hand_pose=END):
    """Three legs on a plate with a mass; the third stands on a hand, in a hinge."""
    plate, hand = mr.Body("plate", mass=0.05), mr.Body("hand", pose=hand_pose, fixed=True)
    joints = [mr.Joint("leg 0", "tip", to=plate), mr.Joint("leg 1", "tip", to=plate, pose=at(-0.06, 0.04))]
    joints.append(mr.Joint("leg 2", "tip", to=plate, pose=at(-0.06, -0.03)))
    joints += [
        mr.Joint(f"leg {k}", "base", to=mr.ground, pose=at(0.05 * np.cos(2.1 * k), 0.05 * np.sin(2.1 * k))) for k in range(2)
    ]
    joints.append(mr.Joint("leg 2", "base", to=hand, pose=at(0, 0.01, 0.02), kind="revolute", axis=(0, 1, 0)))
    return mr.Network(rods={f"leg {k}": ROD for k in range(3)}, bodies=[hand, plate], joints=joints)


GIVEN = {"force": {"plate": (0.3, -0.2, 0.1)}, "gravity": (0, 0, -9.81)}
LOW = at(-0.05, 0.01, -0.01)


def test_a_rod_in_a_hand_is_a_held_rod():
    """To what the steps of the rod leave: both are integrated alike."""
    turned = at(0.1, 0.2, 0.3)
    turned[:3, :3] = Rotation.from_rotvec((0.2, 0.3, -0.4)).as_matrix()
    single = mr.HeldRod(ROD, base=turned, end=turned @ END)
    robot = held(turned)
    assert robot.fixed_bodies == ("hand",)
    assert robot.end_effector == "rod"
    assert robot.load_places == ()
    gravity = {"gravity": (0, 0, -9.81)}
    given = {"end_position": MOVED["fixed_position"]["hand"], "end_rotation": MOVED["fixed_rotation"]["hand"]}
    expected = mr.solve(single, single.inputs(**given, **gravity), solver=SOLVER).raise_if_failed()
    found = mr.solve(robot, robot.inputs(**MOVED, **gravity), solver=SOLVER).raise_if_failed()
    np.testing.assert_allclose(found.rod(0).position, expected.rod(0).position, atol=1e-11)
    np.testing.assert_allclose(found.rod(0).moment, expected.rod(0).moment, atol=1e-10)
    np.testing.assert_allclose(found.energy, expected.energy, rtol=1e-10)
    assert found.stability is expected.stability
    np.testing.assert_allclose(found.body_position("hand"), found.tip_position, atol=1e-12)
    np.testing.assert_allclose(found.body_rotation("hand"), found.tip_rotation, atol=1e-10)
    by_hand = found.jacobian("fixed_position", "fixed_rotation", of="position", at=0.15)
    np.testing.assert_allclose(by_hand, expected.jacobian("end_position", "end_rotation", of="position", at=0.15), atol=1e-8)
    with pytest.raises(AttributeError, match="has no stiffness of its end: something holds it"):
        _ = found.stiffness


def test_a_hand_that_is_moved_is_a_hand_that_stands_there():
    robot = tripod(LOW)
    moved = mr.solve(robot, robot.inputs(**MOVED, **GIVEN), solver=SOLVER).raise_if_failed()
    pose = LOW.copy()
    pose[:3, 3] += MOVED["fixed_position"]["hand"]
    pose[:3, :3] = Rotation.from_rotvec(MOVED["fixed_rotation"]["hand"]).as_matrix() @ pose[:3, :3]
    other = tripod(pose)
    there = mr.solve(other, other.inputs(**GIVEN), solver=SOLVER).raise_if_failed()
    np.testing.assert_allclose(moved.tip_position, there.tip_position, atol=1e-11)
    np.testing.assert_allclose(moved.energy, there.energy, rtol=1e-9)
    np.testing.assert_allclose(moved.body_position("hand"), pose[:3, 3], atol=1e-15)
    assert (robot.load_places, robot.end_effector) == (("plate",), "plate")
    # a body that stands on the ground where the hand does is told by the pose of its joint alone
    joints = [joint for joint in robot.joints if joint.to.name != "hand"]
    on_ground = mr.Joint("leg 2", "base", to=mr.ground, pose=pose @ at(0, 0.01, 0.02), kind="revolute", axis=(0, 1, 0))
    plate = [body for body in robot.bodies if not body.fixed]
    alone = mr.Network(rods={f"leg {k}": ROD for k in range(3)}, bodies=plate, joints=[*joints, on_ground])
    expected = mr.solve(alone, alone.inputs(**GIVEN), solver=SOLVER).raise_if_failed()
    np.testing.assert_allclose(there.tip_position, expected.tip_position, atol=1e-11)
    np.testing.assert_allclose(there.stability_margin, expected.stability_margin, rtol=1e-7)


def test_columns_by_where_a_hand_is():
    """The whole of what an assembly promises, where a hand is moved and turned."""
    robot = tripod(LOW)
    check_assembly(robot, robot.inputs(**MOVED, **GIVEN), tip_rod=0, vary=tuple(MOVED), solvers=("shooting",))


def test_columns_by_the_ground_where_a_hand_has_been_moved():
    """(D10) By the ground, which leaves in the world what moved and turned the hand, and the loads."""
    robot, direction, step = tripod(LOW), np.array([0.3, -0.5, 0.4, 0.6, 0.8, -0.5]), 1e-2
    solution = mr.solve(robot, robot.inputs(**MOVED, **GIVEN), solver=SOLVER).raise_if_failed()
    other = robot.with_base(bases_moved(robot, direction, step))
    moved = mr.solve(other, other.inputs(**MOVED, **GIVEN), solver=SOLVER, guess=solution).raise_if_failed()
    expected = pose_rate(solution, moved, step)
    # rounding of 1e-12 over the step, and its seventh power
    np.testing.assert_allclose(solution.jacobian("base") @ direction, expected, rtol=0, atol=1e-9 * np.abs(expected).max())


def test_a_rod_with_push_rods_that_bends_between_two_bodies_that_stay():
    """Nothing is free at its ends: what its modes are is told by clamps alone. The work of who pushes is what is gained."""
    lines = [mr.PushRod((x, 0), axial_stiffness=400.0) for x in (0.004, -0.004)]
    rod = mr.Rod(length=0.2, bending_stiffness=0.01, torsional_stiffness=0.0077, precurvature=(0, 0.5, 0), lines=lines)
    hand = mr.Body("hand", pose=at(0, 0, 0.18), fixed=True)
    joints = [mr.Joint("rod", "base", to=mr.ground), mr.Joint("rod", "tip", to=hand)]
    robot = mr.Network(rods={"rod": rod}, bodies=[hand], joints=joints)
    found = mr.solve(robot, robot.inputs(displacement=0.0)).raise_if_failed()
    assert found.stability == mr.Stability.STABLE
    step = 1e-6
    for k, e in enumerate(step * np.eye(2)):
        ahead, behind = (mr.solve(robot, robot.inputs(displacement=x), guess=found).raise_if_failed() for x in (e, -e))
        np.testing.assert_allclose((ahead.potential - behind.potential) / (2 * step), found.tension[k], rtol=1e-4)


def test_arrays_and_names_say_the_same():
    robot = tripod(LOW)
    by_name = robot.inputs(fixed_position={"hand": (0.01, 0.02, 0)})
    np.testing.assert_array_equal(robot.inputs(fixed_position=(0.01, 0.02, 0)).fixed_position, by_name.fixed_position)
    batch = robot.inputs(fixed_rotation={"hand": np.zeros((4, 3))})
    assert batch.batch_shape == (4,)


def test_a_network_with_a_hand_is_saved_and_drawn(tmp_path):
    robot = tripod(LOW)
    solution = mr.solve(robot, robot.inputs(**MOVED, **GIVEN), solver=SOLVER)
    solution.save(tmp_path / "hand.npz")
    again = mr.load(tmp_path / "hand.npz")
    np.testing.assert_allclose(again.body_position("hand"), solution.body_position("hand"), atol=1e-15)
    assert again.assembly.fixed_bodies == ("hand",)
    solution.plot()


def test_what_a_fixed_body_cannot_be():
    for match, arguments in (
        ("Body.pose = None is not allowed: must be given of a fixed body", {}),
        ("Body.mass = 1.0 is not allowed: must be 0 of a fixed body", {"pose": END, "mass": 1.0}),
    ):
        with pytest.raises(ValueError, match=match):
            mr.Body("hand", fixed=True, **arguments)
    with pytest.raises(TypeError, match="Body.fixed = 1 is not allowed: must be True or False"):
        mr.Body("hand", fixed=1, pose=END)
    plate = mr.Body("plate")
    joints = [mr.Joint("rod", "base", to=mr.ground), mr.Joint("rod", "tip", to=plate)]
    robot = mr.Network(rods={"rod": ROD}, bodies=[plate], joints=joints)
    with pytest.raises(ValueError, match="fixed_position = .0, 0, 0. is not allowed: must not be given: no body is fixed"):
        robot.inputs(fixed_position=(0, 0, 0))
    unused = mr.Body("hand", pose=END, fixed=True)
    with pytest.raises(ValueError, match="nothing holds on to body 'hand': no rod is joined to it"):
        mr.Network(rods={"rod": ROD}, bodies=[plate, unused], joints=joints)
    with pytest.raises(ValueError, match="end_effector = 'hand' is not allowed: must be a body that moves, or a rod"):
        mr.Network(rods={"rod": ROD}, bodies=[unused], joints=[joints[0], mr.Joint("rod", "tip", to=unused)], end_effector="hand")


def test_a_robot_stands_on_a_base_that_moves(difference):
    """What stands on a fixed body in the place of the ground is carried by inputs as by ``base``; by nearly a turn too."""
    hand = mr.Body("hand", pose=np.eye(4), fixed=True)
    leg = mr.Rod(length=0.2, bending_stiffness=0.02, torsional_stiffness=0.015)
    places = np.array([at(0.04 * np.cos(a), 0.04 * np.sin(a)) for a in (0, 2, 4)])
    tripod = mr.ParallelRods(legs=[leg] * 3, base=places, platform=places, platform_mass=0.01)
    moving, still = mr.stacked(tripod, tripod, to=hand), mr.stacked(tripod, tripod)
    assert moving.fixed_bodies == ("hand",)
    assert moving.load_places == still.load_places
    given = {"force": {"upper": (0.02, 0.01, -0.05)}, "gravity": (0, 0, -9.81)}
    for move, turn in (((0.1, -0.2, 0.05), (0.3, -0.2, 0.4)), ((0, 0, 0), (0, 5.5, 1.0))):
        inputs = moving.inputs(fixed_position=move, fixed_rotation=turn, **given)
        found = mr.solve(moving, inputs, solver=SOLVER).raise_if_failed()
        pose = at(*move)
        pose[:3, :3] = Rotation.from_rotvec(turn).as_matrix()
        there = still.with_base(pose)
        expected = mr.solve(there, there.inputs(**given), solver=SOLVER).raise_if_failed()
        np.testing.assert_allclose(found.tip_position, expected.tip_position, atol=1e-10)
        np.testing.assert_allclose(found.tip_rotation, expected.tip_rotation, atol=1e-9)

    def turned(t):
        inputs = moving.inputs(fixed_rotation=np.multiply.outer(1.0, turn) + t * np.eye(3)[1], **given)
        return mr.solve(moving, inputs, solver=SOLVER, guess=found).tip_position

    columns = found.jacobian("fixed_rotation")[:3]
    np.testing.assert_allclose(columns[:, 1], difference(turned, 1e-2), atol=1e-7)
    beside = mr.Rod(length=0.1, bending_stiffness=0.01, torsional_stiffness=0.008)
    discs = mr.multibackbone(beside, [beside], offsets=[(0.004, 0)], discs=2, to=hand)
    assert [joint.to.name for joint in discs.joints if joint.end == "base"] == ["hand", "disc 1", "hand"]
    with pytest.raises(ValueError, match="stacked.to = .* must be mr.ground, or a fixed body"):
        mr.stacked(tripod, to=mr.Body("hand"))


@pytest.mark.parametrize("name", MOVED)
def test_what_moves_a_body_does_the_work_that_the_potential_gains(difference, name):
    """Of weights and of forces on bodies and free tips, for the hand lifts what stands on it."""
    plate, hand = mr.Body("plate", mass=0.05), mr.Body("hand", pose=END, fixed=True)
    joints = [mr.Joint("leg", "base", to=hand, pose=at(0, 0.01, 0.02)), mr.Joint("leg", "tip", to=plate)]
    joints.append(mr.Joint("feeler", "base", to=hand, pose=at(0.03, 0, 0)))
    robot = mr.Network(rods={"leg": ROD, "feeler": ROD}, bodies=[hand, plate], joints=joints)
    along = np.array([0.3, -0.4, 0.9])
    loads = {"gravity": (1, 2, -9), "force": {"plate": (0.3, -0.2, 0.1), "feeler": (0.1, 0.05, -0.2)}}

    def moved(t):
        start = np.array(MOVED[name]["hand"])
        inputs = robot.inputs(**MOVED | {name: {"hand": start + t * along}}, **loads)
        return mr.solve(robot, inputs, solver=SOLVER).raise_if_failed()

    found = moved(0.0)
    place = found.body_position("hand")
    wrenches = [found.wrench(rod, "base").about(place) for rod in ("leg", "feeler")]
    force, moment = (sum(getattr(own, part) for own in wrenches) for part in ("force", "moment"))
    turn = Rotation.from_rotvec
    now = np.array(MOVED["fixed_rotation"]["hand"])
    rate = difference(lambda t: (turn(now + t * along) * turn(now).inv()).as_rotvec(), 1e-2)
    gained = difference(lambda t: moved(t).potential, 1e-2)
    np.testing.assert_allclose(gained, -force @ along if name == "fixed_position" else -moment @ rate, rtol=1e-7)
