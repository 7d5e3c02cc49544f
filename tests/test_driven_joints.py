"""Joints whose angles are inputs: against clamped poses turned by them, differences, and the work of what drives them."""

import numpy as np
import pytest
from conftest import rodrigues
from test_check_assembly import check_assembly
from test_network import BENT, EXACT, circle, pose

import multirod as mr

AXES = {"revolute": (0, 0.6, 0.8), "universal": ((1, 0, 0), (0, 1, 0)), "spherical": None}
ANGLES = {"revolute": np.array([0.7]), "universal": np.array([0.5, -0.4]), "spherical": np.array([0.3, -0.5, 0.6])}
GIVEN = {
    "rotation": {"left": 0.3},
    "force": {"top": (0.3, 0.2, -0.2), "feeler": (0.1, 0.05, -0.1)},
    "gravity": (0, 1, -9.81),
    "distributed_force": (0.1, 0.05, 0.2),
}


def turned(kind, angles):
    """By a joint, written anew."""
    if kind == "spherical":
        return rodrigues(angles)
    if kind == "revolute":
        return rodrigues(angles[0] * np.array(AXES[kind]))
    return rodrigues(angles[0] * np.array(AXES[kind][0])) @ rodrigues(angles[1] * np.array(AXES[kind][1]))


def driven(kinds=("revolute", "spherical", "universal"), angles=None, end_effector="top"):
    """A loop of two rods and a plate with one that stands on it: joints at a base, at a tip and on a body are driven, or
    clamped where they were turned by ``angles``."""
    plate, top = mr.Body("plate", mass=0.05, mass_centre=(0.01, 0, 0.02)), mr.Body("top", mass=0.02)
    on_ground, on_plate = circle((0, 180), 0.08), circle((20, 200), 0.06)
    ends = [("left", "base", mr.ground, on_ground[0]), ("right", "tip", plate, on_plate[1]), ("feeler", "base", top, np.eye(4))]
    joints = [
        mr.Joint("left", "tip", to=plate, pose=on_plate[0]),
        mr.Joint("right", "base", to=mr.ground, pose=on_ground[1]),
        mr.Joint("upper", "base", to=plate, pose=pose((0.2, 0, 0), (0.01, 0, 0.02)), kind="spherical", stiffness=0.4),
        mr.Joint("upper", "tip", to=top),
    ]
    for k, ((rod, end, to, where), kind) in enumerate(zip(ends, kinds, strict=True)):
        if angles is None:
            joints.append(mr.Joint(rod, end, to=to, pose=where, kind=kind, axis=AXES[kind], driven=True))
        else:
            turn = np.eye(4)
            turn[:3, :3] = turned(kind, angles[k])
            joints.append(mr.Joint(rod, end, to=to, pose=where @ turn))
    rods = dict.fromkeys(("left", "right", "upper", "feeler"), BENT)
    return mr.Network(rods=rods, bodies=[plate, top], joints=joints, end_effector=end_effector)


def by_name(robot, angles):
    return {name: own if len(own) > 1 else own[0] for name, own in zip(robot.driven_joints, angles, strict=True)}


@pytest.mark.parametrize("kinds", [("revolute", "spherical", "universal"), ("spherical", "universal", "revolute")])
def test_a_driven_joint_is_one_that_is_clamped_where_it_was_turned(kinds):
    robot, angles = driven(kinds), [0.4 * ANGLES[kind] for kind in kinds]
    assert robot.driven_joints == ("left base", "right tip", "feeler base")
    found = mr.solve(robot, robot.inputs(angle=by_name(robot, angles), **GIVEN), solver=EXACT)
    clamped = driven(kinds, angles)
    expected = mr.solve(clamped, clamped.inputs(**GIVEN), solver=EXACT)
    assert found.stability is expected.stability is mr.Stability.STABLE
    np.testing.assert_allclose(found.tip_position, expected.tip_position, atol=1e-12)
    np.testing.assert_allclose(found.tip_rotation, expected.tip_rotation, atol=1e-11)
    for name in ("left", "right", "upper", "feeler"):
        np.testing.assert_allclose(found.rod(name).moment, expected.rod(name).moment, atol=1e-11)
    np.testing.assert_allclose(found.energy, expected.energy, rtol=1e-11)


@pytest.mark.parametrize("end_effector", ["top", "feeler"])
def test_columns_by_angles(end_effector, difference):
    """Of the residual and the pose, off the equilibrium too, against differences of the sixth order."""
    robot = driven(end_effector=end_effector)
    angles = np.concatenate([0.4 * ANGLES[kind] for kind in ("revolute", "spherical", "universal")])
    inputs = robot.inputs(angle=angles, **GIVEN)
    problem = robot.problem(
        inputs, integrator=mr.RK4(20), pose_sensitivities=True, enabled=("angle",), **robot.input_directions("angle")
    )
    rng = np.random.default_rng(3)
    x = problem.guess() + rng.standard_normal(problem.unknown_count)
    problem.write("unknowns", x)
    slopes, rows = problem.input_columns("angle")
    row, place = problem.read("inputs"), problem.input_slice("angle")
    for way in np.eye(len(angles)):

        def moved(t, way=way):
            changed = row.copy()
            changed[:, place] += t * way
            problem.write("inputs", changed)
            return np.concatenate([problem.evaluate(x)[0][0], problem.read("position")[0]])

        by_difference = difference(moved, 1e-2)
        own = np.concatenate([slopes[0] @ way, rows[0, :3] @ way])
        np.testing.assert_allclose(own, by_difference, atol=1e-8)


def test_an_assembly_with_driven_joints_conforms():
    robot = driven(end_effector="feeler")
    angles = [0.4 * ANGLES[kind] for kind in ("revolute", "spherical", "universal")]
    inputs = robot.inputs(angle=by_name(robot, angles), **GIVEN)
    check_assembly(robot, inputs, tip_rod=3, vary=("angle",), solvers=("shooting",))


def test_the_torque_that_drives_is_the_slope_of_the_potential(difference):
    robot = driven()
    force = np.array([0.3, 0.2, -0.2])
    angles = [0.4 * ANGLES[kind] for kind in ("revolute", "spherical", "universal")]

    def solved(t):
        given = by_name(robot, [angles[0] + t, *angles[1:]])
        return mr.solve(robot, robot.inputs(angle=given, force={"top": force}), solver=EXACT).raise_if_failed()

    def potential(t):
        solution = solved(t)
        return np.array(solution.energy - force @ solution.tip_position)

    shape = solved(0.0).rod("left")
    moment = (shape.rotation @ shape.moment[..., None])[0, :, 0]  # in the world, and the frame of the pose there
    np.testing.assert_allclose(-np.array(AXES["revolute"]) @ moment, difference(potential, 1e-2), atol=1e-8)


def test_a_revolute_joint_goes_from_one_radian_to_the_other():
    """By a history and by a loop; the arm goes with the joint, and gravity bends it across."""
    arm = mr.Rod.wire(length=0.2, diameter=2e-3, young_modulus=60e9, shear_modulus=23e9, density=6450)
    joint = mr.Joint("arm", "base", to=mr.ground, kind="revolute", axis=(0, 1, 0), driven=True)
    robot = mr.Network(rods={"arm": arm}, joints=[joint])
    angles = np.linspace(-1, 1, 9)
    inputs = robot.inputs(angle={"arm base": angles}, gravity=(0, 0, -9.81))
    history = mr.simulate(robot, inputs, time=np.linspace(0, 1, 9), solver=EXACT)
    single = mr.SingleRod(arm)
    for angle, place in zip(angles, history.tip_position, strict=True):
        R = rodrigues((0, angle, 0))
        expected = mr.solve(single, single.inputs(gravity=R.T @ (0, 0, -9.81)), solver=EXACT).tip_position
        np.testing.assert_allclose(place, R @ expected, atol=1e-10)
    tracker = mr.Tracker(robot, solver=EXACT, inputs=inputs[0])
    for angle in angles:
        step = tracker.step(angle={"arm base": angle})
    np.testing.assert_allclose(step.tip_position, history.tip_position[-1], atol=1e-9)


def test_driven_joints_are_saved_and_what_they_cannot_be_is_named(tmp_path):
    robot = driven()
    robot.save(tmp_path / "robot.toml")
    loaded = mr.load(tmp_path / "robot.toml")
    assert loaded.driven_joints == robot.driven_joints
    assert repr(loaded.joints[4]) == "Joint('left', 'base', to='ground', revolute, driven)"
    inputs = robot.inputs(angle={"right tip": (0.1, 0.2, 0.3), "left base": np.ones(4)})
    np.testing.assert_array_equal(inputs.angle[2], [1, 0.1, 0.2, 0.3, 0, 0])
    for match, given in (
        ("angle = 'left tip' is not allowed: must be by name, one of 'left base', 'right tip', 'feeler base'", {"left tip": 1}),
        (r"angle\['right tip'\] = 1 is not allowed: must have shape \(..., 3\)", {"right tip": 1}),
        (r"angle = \(1, 2\) is not allowed: must have shape \(..., 6\)", (1, 2)),
    ):
        with pytest.raises(ValueError, match=match):
            robot.inputs(angle=given)
    plain = mr.Network(rods={"arm": BENT}, joints=[mr.Joint("arm", "base", to=mr.ground)])
    with pytest.raises(ValueError, match="angle = .* no joint is driven"):
        plain.inputs(angle={"arm base": 0.1})
    for match, more in (
        ("Joint.driven = True .* a clamped joint has no angle", {}),
        ("Joint.stiffness = 0.1 .* the joint is driven", {"kind": "revolute", "axis": (1, 0, 0), "stiffness": 0.1}),
        ("Joint.rest = 0.1 .* its angle is an input", {"kind": "revolute", "axis": (1, 0, 0), "rest": 0.1}),
    ):
        with pytest.raises(ValueError, match=match):
            mr.Joint("arm", "base", to=mr.ground, driven=True, **more)
    with pytest.raises(ValueError, match="Joint.driven = True .* in a hole"):
        mr.Joint("arm", "along", at=0.1, to=mr.ground, kind="spherical", driven=True)
    with pytest.raises(ValueError, match="rod 'arm' is free to move"):  # as the same joint that is not driven is
        mr.Network(rods={"arm": BENT}, joints=[mr.Joint("arm", "base", to=mr.ground, kind="revolute", axis=(1, 0, 0))])


def test_angles_are_read_by_name_and_kept_with_a_solution(tmp_path):
    robot = driven()
    text = 'kind = "Inputs"\n[angle]\n"left base" = 0.25\n"feeler base" = [0.3, -0.4]\n'
    (tmp_path / "inputs.toml").write_text(text)
    inputs = mr.load(tmp_path / "inputs.toml", robot=robot)
    np.testing.assert_array_equal(inputs.angle, [0.25, 0, 0, 0, 0.3, -0.4])
    mr.solve(robot, inputs, solver=EXACT).save(tmp_path / "solution.npz")
    np.testing.assert_array_equal(mr.load(tmp_path / "solution.npz").inputs.angle, inputs.angle)
