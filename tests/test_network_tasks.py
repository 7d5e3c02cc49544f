"""Tasks and stored cases on networks: ``reach``, ``Controller`` and ``Estimator`` checked by solves, and the short forms."""

import numpy as np
import pytest
from observer_scenes import three_tubes
from scipy.spatial.transform import Rotation
from test_cases import BUCKLED, TIGHT, robot_and_inputs
from test_network_rods import at
from test_parallel_rods import stored_robot

import multirod as mr
from multirod.tasks.limits import limit_rows

STEPS = mr.RK4(50)
SOLVER = mr.Shooting(tolerance=1e-11, integrator=STEPS)
WIRE = mr.Rod.wire(length=0.3, diameter=2e-3, young_modulus=60e9, shear_modulus=23e9)


def mast_on_legs(**options):
    """Three legs on a plate, and a mast on that."""
    plate, top = mr.Body("plate"), mr.Body("top")
    joints = [mr.Joint("mast", "base", to=plate), mr.Joint("mast", "tip", to=top)]
    for k, angle in enumerate(np.radians([0, 120, 240])):
        joints.append(mr.Joint(f"leg {k}", "base", to=mr.ground, pose=at(0.08 * np.cos(angle), 0.08 * np.sin(angle))))
        joints.append(
            mr.Joint(f"leg {k}", "tip", to=plate, pose=at(0.06 * np.cos(angle), 0.06 * np.sin(angle)), kind="spherical")
        )
    return mr.Network(rods={f"leg {k}": WIRE for k in range(3)} | {"mast": WIRE}, bodies=[plate, top], joints=joints, **options)


@pytest.fixture(scope="module")
def robot():
    return mast_on_legs()


@pytest.fixture(scope="module")
def start(robot):
    given = robot.inputs(translation=(0.01, 0, 0.005, 0), force={"top": (0.1, 0.05, 0)})
    return mr.solve(robot, given, solver=SOLVER).raise_if_failed()


def solved(robot, inputs, guess):
    values = {name: getattr(inputs, name) for name in ("translation", "force")}
    return mr.solve(robot, robot.inputs(**values), solver=SOLVER, guess=guess).raise_if_failed()


def test_a_position_is_reached(robot, start):
    target = start.tip_position + (0.004, -0.003, 0.002)
    found = mr.reach(robot, mr.Pose(position=target), free=("translation",), guess=start, solver=SOLVER)
    assert found.status is mr.Status.REACHED
    # 1e-6 of the tip's position are asked for by default, of rods of 0.3 m
    np.testing.assert_allclose(solved(robot, found.inputs, found).tip_position, target, atol=1e-6)


def test_tubes_stay_behind_their_plate_and_in_order_as_they_do_alone():
    """What a robot cannot do is a limit without being named: tubes of a network as those that are a robot by themselves."""
    tubes, _ = three_tubes()
    body = mr.Body("carriage")
    joints = [mr.Joint("mast", "base", to=mr.ground), mr.Joint("mast", "tip", to=body), mr.Joint("arm", "base", to=body)]
    carried = mr.Network(rods={"mast": WIRE, "arm": tubes}, bodies=[body], joints=joints)
    limits = mr.Limits(translation=(-0.19, 0.1), gap=2e-3)
    expected = limit_rows(tubes, limits, ("translation",))
    found = limit_rows(carried, limits, ("translation",))
    kept = ~found.matrix[:, 0].astype(bool)  # the mast is pushed as it likes
    np.testing.assert_array_equal(found.matrix[kept, 1:], expected.matrix)
    np.testing.assert_array_equal((found.low[kept], found.high[kept]), (expected.low, expected.high))
    np.testing.assert_array_equal((found.low[~kept], found.high[~kept]), [[-0.19], [0.1]])


def test_tubes_that_are_a_network_are_held_back_as_they_are_alone():
    """In the same places, by the same limits."""
    tubes, motion = three_tubes()
    stands = mr.Joint("arm", "base", to=mr.ground)
    alone = mr.Network(rods={"arm": tubes}, joints=[stands], base=tubes.base)
    given, force = motion[10], motion[10].tip_force
    start = mr.solve(tubes, given, solver=SOLVER).raise_if_failed()
    far = start.tip_position + np.array([(0, 0, 0.05), (0, 0, 0.02), (0, 0.02, 0)])
    options = {"free": "translation", "solver": SOLVER}
    one = mr.reach(tubes, mr.Pose(position=far), given, **options)
    drives = {"rotation": given.rotation, "translation": given.translation}
    other = mr.reach(alone, mr.Pose(position=far), alone.inputs(force=force, **drives), **options)
    assert (one.status == mr.Status.AT_LIMIT).all()
    for name in ("status", "at_limit", "unknowns"):
        np.testing.assert_array_equal(getattr(other, name), getattr(one, name))
    assert (other.inputs.translation <= 0).all()
    assert (np.diff(other.inputs.translation, axis=1) >= 0).all()


def test_a_moving_target_is_followed(robot, start):
    loop = mr.Controller(robot, dt=0.005, free="translation", guess=start, integrator=STEPS)
    for k in range(20):
        target = start.tip_position + 2e-5 * k * np.array([1, -1, 0.5])
        command = loop.step(position=target)
        assert command.status is mr.Status.TRACKING
        assert command.integrations == 1
    # second order in what a sample moves, 3e-5 m, over bending radii of decimetres
    np.testing.assert_allclose(solved(robot, command.inputs, command).tip_position, target, atol=1e-6)


def test_what_is_not_free_of_an_input_changes_by_name(robot, start):
    free = {"translation": ["leg 0", "leg 1", "leg 2"]}
    loop = mr.Controller(robot, dt=0.005, free=free, guess=start, integrator=STEPS)
    for k in range(8):
        command = loop.step(position=start.tip_position, translation={"mast": -2e-4 * k})
    assert command.inputs.translation[3] == -2e-4 * 7
    for _ in range(3):
        command = loop.step(position=start.tip_position)
    np.testing.assert_allclose(solved(robot, command.inputs, command).tip_position, start.tip_position, atol=1e-9)
    with pytest.raises(TypeError, match=r"takes of 'translation' what is not free, by name, and not translation\['leg 0'\]"):
        loop.step(position=start.tip_position, translation={"leg 1": 0.0})


def test_a_force_is_estimated_from_the_pose(robot, start):
    sensor = mr.Pose(position=start.tip_position, rotation=start.tip_rotation, sigma=(1e-5, 1e-3))
    walks = {"force": mr.Walk(0.3, start=mr.Prior(0, sigma=0.5))}
    inputs = robot.inputs(translation=(0.01, 0, 0.005, 0))
    meter = mr.Estimator(robot, integrator=STEPS, dt=0.005, unknown=walks, sensors=sensor)
    for _ in range(40):
        sample = meter.step([(start.tip_position, start.tip_rotation)], translation=inputs.translation)
    off = (sample.value("force") - start.inputs.force) / sample.sigma("force")
    # measurements are exact: what is left is the pull of the prior, far within what the estimate says of itself
    assert np.abs(off).max() < 0.05


def test_the_load_of_one_body_is_estimated_by_its_name(robot, start):
    """From exact poses, what acts on the others as it was given: as of a prior that knows these others."""
    inputs = robot.inputs(translation=(0.01, 0, 0.005, 0), force={"plate": (0, 0, -0.2)})
    both = robot.inputs(translation=inputs.translation, force={"plate": (0, 0, -0.2), "top": (0.1, 0.05, 0)})
    truth = mr.solve(robot, both, solver=SOLVER)
    options = {
        "measured": mr.Pose(position=truth.tip_position, rotation=truth.tip_rotation, sigma=(1e-5, 1e-4)),
        "solver": SOLVER,
    }
    prior = mr.Prior(0, sigma=0.5)
    found = mr.estimate(robot, inputs, unknown={"force": {"top": prior}}, **options)
    assert found.raise_if_failed().value("force").shape == (3,)
    # the prior pulls by sigma^2 / 0.5^2 of what it is off, which is 0.1
    np.testing.assert_allclose(found.value("force"), (0.1, 0.05, 0), atol=0.2 * (found.sigma("force").max() / 0.5) ** 2 + 1e-6)
    np.testing.assert_array_equal(found.solution.inputs.force[3:], found.value("force"))
    np.testing.assert_array_equal(found.solution.inputs.force[:3], (0, 0, -0.2))
    sure = np.array([1e-9] * 3 + [0.5] * 3)
    every = mr.estimate(robot, inputs, unknown={"force": mr.Prior((0, 0, -0.2, 0, 0, 0), sigma=sure)}, **options)
    np.testing.assert_allclose(found.value("force"), every.value("force")[3:], atol=1e-7)
    np.testing.assert_allclose(found.covariance("force"), every.covariance("force")[3:, 3:], rtol=1e-6)
    # in any order
    turned = {"force": {"top": prior, "plate": mr.Prior((0, 0, -0.2), sigma=1e-9)}}
    again = mr.estimate(robot, inputs, unknown=turned, **options)
    np.testing.assert_array_equal(again.value("force"), every.value("force"))
    walks = {"force": {"top": mr.Walk(0.3, start=prior)}}
    meter = mr.Estimator(robot, dt=0.01, inputs=inputs, unknown=walks, sensors=options["measured"], integrator=STEPS)
    sample = meter.step([(truth.tip_position, truth.tip_rotation)])
    np.testing.assert_allclose(sample.value("force"), found.value("force"), atol=1e-5 * found.sigma("force").max())
    # what is known of the same input changes by name, and leaves the others and what is estimated
    sample = meter.step([(truth.tip_position, truth.tip_rotation)], force={"plate": (0, 0, -0.25)})
    np.testing.assert_array_equal(sample.solution.inputs.force[:3], (0, 0, -0.25))
    np.testing.assert_allclose(sample.solution.inputs.force[3:], sample.value("force"), atol=0)
    for refused in ({"top": (0, 0, 0)}, {"plate": (0, 0, 0), "top": (0, 0, 0)}, {("top", "tip"): (0, 0, 0)}, np.zeros(6)):
        with pytest.raises(TypeError, match=r"takes of 'force' what is not estimated, by name, and not force\['top'\]"):
            meter.step([(truth.tip_position, truth.tip_rotation)], force=refused)


def test_of_drives_those_of_motors_are_estimated(start):
    """A network that says which rods are driven, as ``reach`` has it; others by their names."""
    robot = mast_on_legs(driven=["leg 0", "leg 2"])
    load = {"force": {"top": (0.1, 0.05, 0)}}
    options = {
        "measured": mr.Pose(position=start.tip_position, rotation=start.tip_rotation, sigma=(1e-5, 1e-4)),
        "solver": SOLVER,
    }
    given = robot.inputs(translation=(0.0095, 0, 0.0055, 0), **load)
    found = mr.estimate(robot, given, unknown={"translation": mr.Prior(sigma=1e-3)}, **options).raise_if_failed()
    np.testing.assert_allclose(found.value("translation"), (0.01, 0.005), atol=1e-7)
    np.testing.assert_array_equal(found.solution.inputs.translation[[1, 3]], 0.0)
    other = robot.inputs(translation=(0.01, 1e-3, 0.005, 0), **load)
    found = mr.estimate(robot, other, unknown={"translation": {"leg 1": mr.Prior(sigma=1e-3)}}, **options).raise_if_failed()
    np.testing.assert_allclose(found.value("translation"), (0.0,), atol=1e-7)


def test_what_is_estimated_by_name_must_be_there(robot, start):
    sensor = mr.Pose(position=start.tip_position, sigma=1e-4)
    prior = mr.Prior(0, sigma=0.1)
    with pytest.raises(ValueError, match=r"unknown\['force'\] = 'tpo' is not allowed: must be one of .*mean.* 'top'"):
        mr.estimate(robot, unknown={"force": {"tpo": prior}}, measured=sensor)
    with pytest.raises(TypeError, match=r"unknown\['force'\]\['top'\] = 0.1 is not allowed: must be a Prior, not float"):
        mr.estimate(robot, unknown={"force": {"top": 0.1}}, measured=sensor)
    with pytest.raises(ValueError, match=r"unknown\['force'\] = \(\) is not allowed: must be names"):
        mr.estimate(robot, unknown={"force": {}}, measured=sensor)
    with pytest.raises(ValueError, match="3 of force"):
        mr.estimate(robot, unknown={"force": {"top": mr.Prior()}, "moment": {"top": mr.Prior()}}, measured=sensor)
    with pytest.raises(ValueError, match=r"Prior.sigma of force\['top'\].*must be one number, or shape \(..., 3\)"):
        mr.estimate(robot, unknown={"force": {"top": mr.Prior(0, sigma=np.ones(6))}}, measured=sensor)
    alone = mr.SingleRod(WIRE)
    with pytest.raises(ValueError, match=r"unknown\['tip_force'\] = 'rod' is not allowed: must not be by name"):
        mr.estimate(alone, unknown={"tip_force": {"rod": prior}}, measured=sensor)
    with pytest.raises(TypeError, match=r"unknown\['force'\]\['top'\] .* must be a Walk"):
        mr.Estimator(robot, dt=0.01, unknown={"force": {"top": prior}}, sensors=sensor)


def test_a_stored_rod_in_a_network_is_a_single_rod(single_rod_case, make_pose):
    """By itself the same code on the same numbers; beside another rod the same equations in other unknowns."""
    if single_rod_case["difficulty"] != "standard" or single_rod_case["id"].startswith(BUCKLED):
        pytest.skip("its columns grow, and rounding with them, or it has a twin")
    robot, inputs = robot_and_inputs(single_rod_case, make_pose)
    names = {"tip_force": "force", "tip_moment": "moment"}
    given = {names.get(name, name): getattr(inputs, name) for name in inputs.given}
    rod, joints = robot.rods[0], [mr.Joint("rod", "base", to=mr.ground)]
    alone = mr.Network(rods={"rod": rod}, joints=joints, base=robot.base)
    expected, found = (mr.solve(own, values, solver=SOLVER) for own, values in ((robot, inputs), (alone, alone.inputs(**given))))
    np.testing.assert_array_equal(found.tip_position, expected.tip_position)
    np.testing.assert_array_equal(found.tip_rotation, expected.tip_rotation)
    joints += [mr.Joint("other", "base", to=mr.ground)]
    beside = mr.Network(rods={"rod": rod, "other": rod}, joints=joints, base=robot.base, end_effector="rod")
    here = {name: value if name.startswith("distributed") else {"rod": value} for name, value in given.items()}
    expected = mr.solve(robot, inputs, solver=TIGHT).raise_if_failed()
    found = mr.solve(beside, beside.inputs(**here), solver=TIGHT).raise_if_failed()
    length = float(rod.length)
    # both at steps whose errors are 1e-12; SingleRod knows force and moment along the rod in closed form, where a graph
    # integrates them, so that fixed steps of RK4 would differ by their own errors, up to 2e-5 of the length at 50
    np.testing.assert_allclose(found.tip_position, expected.tip_position, rtol=0, atol=1e-11 * length)
    np.testing.assert_allclose(found.tip_rotation, expected.tip_rotation, rtol=0, atol=3e-11)


def stored_network(parallel_case, make_pose):
    """A stored robot, its inputs, the same as a network with the inputs of that, and the point on which forces act."""
    parallel, inputs = stored_robot(parallel_case, make_pose)
    names = {"tip_force": "force", "tip_moment": "moment"}
    given = {names.get(name, name): getattr(inputs, name) for name in inputs.given}
    point = given.pop("force_point")  # forces act on the origin of a body: it stands there
    platform = parallel.geometry.platform.copy()
    platform[:, :3, 3] -= point
    turning = [rod["twist_free"] for rod in parallel_case["inputs"]["rods"]]
    joints = ["revolute" if free else "clamped" for free in turning]
    network = mr.stacked(mr.ParallelRods(legs=parallel.legs, base=parallel.geometry.base, platform=platform, joints=joints))
    return parallel, inputs, network, given, point


def test_stored_parallel_robots_as_networks(parallel_case, make_pose):
    """Legs are integrated alike there: at the same steps of RK4, rounding is left, and 1e-11 of the residual [1/m] over L^2."""
    if parallel_case["difficulty"] != "standard":
        pytest.skip("its columns grow, and rounding with them")
    parallel, inputs, network, given, point = stored_network(parallel_case, make_pose)
    expected = mr.solve(parallel, inputs, solver=SOLVER).raise_if_failed()
    found = mr.solve(network, network.inputs(**given), solver=SOLVER).raise_if_failed()
    place = found.tip_position - found.tip_rotation @ point
    np.testing.assert_allclose(place, expected.tip_position, rtol=0, atol=1e-12)
    np.testing.assert_allclose(found.tip_rotation, expected.tip_rotation, rtol=0, atol=1e-11)


def test_stored_parallel_robots_turned_around_as_networks(parallel_case, make_pose):
    """What leads six legs to the pose of a stored case, by the inverse problem, leads the network there."""
    if len(parallel_case["inputs"]["rods"]) != 6 or parallel_case["difficulty"] != "standard":
        pytest.skip("the pose does not tell the lengths of other than six legs, and the columns of hard cases grow")
    parallel, inputs, network, given, point = stored_network(parallel_case, make_pose)
    there = mr.solve(parallel, inputs, solver=SOLVER).raise_if_failed()
    inverse = parallel.inverse()
    loads = {name: getattr(inputs, name) for name in inputs.given if name != "translation"}
    turn = Rotation.from_matrix(there.tip_rotation).as_rotvec()
    asked = inverse.inputs(platform_position=there.tip_position, platform_rotation=turn, **loads)
    pushed = inverse.translations(mr.solve(inverse, asked, solver=SOLVER).raise_if_failed())
    # of residuals of 1e-11 by L^2, as below
    np.testing.assert_allclose(pushed, inputs.translation, rtol=0, atol=1e-12)
    found = mr.solve(network, network.inputs(**given | {"translation": pushed}), solver=SOLVER).raise_if_failed()
    np.testing.assert_allclose(found.tip_position - found.tip_rotation @ point, there.tip_position, rtol=0, atol=1e-12)
    np.testing.assert_allclose(found.tip_rotation, there.tip_rotation, rtol=0, atol=1e-11)
