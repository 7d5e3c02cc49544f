"""Derivatives of networks by the numbers of their rods, where their joints are and where the ground is, against differences of
sixth order (``docs/derivatives.md``)."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from test_network_rods import at

import multirod as mr
from multirod.read_only import changed

NODES, WEIGHTS = np.array([-3, -2, -1, 1, 2, 3]), np.array([-1, 9, -45, 45, -9, 1]) / 60  # a derivative, error O(h^6)
STEPS = mr.RK4(30)
SOLVER = mr.Shooting(tolerance=1e-12, integrator=STEPS)
STEP = {"precurvature": 3e-2, "bending_stiffness": 1e-2, "torsional_stiffness": 5e-3, "length": 3e-5}  # stiffnesses: relative
SHAPE = {"precurvature": (3,), "bending_stiffness": (2,), "torsional_stiffness": (), "length": ()}
ROD = mr.Rod(
    length=0.2, bending_stiffness=(0.02, 0.03), torsional_stiffness=0.015, precurvature=(1, 0.5, 0.3), linear_density=0.02
)
LONG = mr.Rod(
    sections=[
        mr.Section(length=0.12, bending_stiffness=0.05, torsional_stiffness=0.04, precurvature=(0.5, -1, 0.2)),
        mr.Section(length=0.1, bending_stiffness=0.03, torsional_stiffness=0.02, precurvature=(2, 0, 0)),
    ]
)
INNER = mr.Rod(
    sections=[
        mr.Section(length=0.14, bending_stiffness=0.01, torsional_stiffness=0.008),
        mr.Section(length=0.1, bending_stiffness=0.01, torsional_stiffness=0.008, precurvature=(3, 1, 0.4)),
    ]
)
OUTER = mr.Rod(length=0.2, bending_stiffness=0.03, torsional_stiffness=0.024, precurvature=(0, 2, 0.5))


def turned(axis, angle, x=0.0, y=0.0, z=0.0):
    pose = at(x, y, z)
    pose[:3, :3] = Rotation.from_rotvec(angle * np.array(axis)).as_matrix()
    return pose


def plate(effector="plate"):
    """Two rods and tubes on a plate, of every kind of joint, with a mast on it; all of it on a ground that is askew."""
    body = mr.Body("plate", mass=0.05, mass_centre=(0.01, 0, 0.02))
    joints = [
        mr.Joint("short", "base", to=mr.ground, pose=turned((0.2, 0.1, 0), 1.0, 0.05)),
        mr.Joint("short", "tip", to=body, pose=turned((0, 0.1, 0.3), 1.0, 0.04), kind="universal", axis=[(1, 0, 0), (0, 1, 0)]),
        mr.Joint("long", "base", to=mr.ground, pose=at(-0.05, 0.01), kind="revolute", axis=(0, 1, 0), stiffness=0.3, rest=0.1),
        mr.Joint("long", "tip", to=body, pose=turned((0.1, 0, 0), 1.0, -0.04, 0, 0.01), kind="spherical"),
        mr.Joint("tubes", "base", to=mr.ground, pose=at(0, -0.05)),
        mr.Joint("tubes", "tip", to=body, pose=at(0, -0.04)),
        mr.Joint("mast", "base", to=body, pose=turned((0, 0.2, 0.1), 1.0, 0, 0.01, 0.01)),
    ]
    rods = {"short": ROD, "long": LONG, "tubes": mr.ConcentricTubes([INNER, OUTER]), "mast": ROD}
    base = turned((0.3, -0.2, 0.4), 1.0, 0.1, 0.2, -0.1)
    return mr.Network(rods=rods, bodies=[body], joints=joints, end_effector=effector, base=base)


def discs():
    """A rod between two discs, and another that slides through the lower one in a hole that it does not turn in."""
    inner = mr.Rod(length=0.1, bending_stiffness=0.01, torsional_stiffness=0.008, precurvature=(3, 0, 0))
    beside = mr.Rod(
        length=0.1, bending_stiffness=0.004, torsional_stiffness=0.003, axial_stiffness=2000.0, precurvature=(1, 2, 0.5)
    )
    return mr.multibackbone(inner, [beside, beside], offsets=[(0.004, 0), (-0.003, 0.003)], discs=2, hole="prismatic")


SCENES = {
    "a plate": (
        plate,
        {
            "force": {"plate": (0.4, -0.3, 0.5), "mast": (0.2, 0.1, -0.1)},
            "follower_moment": {"mast": (0.02, 0, 0.01)},
            "rotation": {"short": 0.2, "tubes": (0.3, -0.4)},
            "translation": {"long": 0.01, "tubes": (-0.04, -0.03)},
            "gravity": (1, 2, -9.81),
            "rod_force": {"long": (0.5, 0, 0.2)},
        },
    ),
    "a tip on a plate": (
        lambda: plate("mast"),
        {"force": {"plate": (0.4, -0.3, 0.5), "mast": (0.2, 0.1, -0.1)}, "gravity": (1, 2, -9.81)},
    ),
    "discs": (discs, {"translation": {"rod 0": 0.002, "rod 1": -0.001}, "force": {"disc 2": (0.2, 0.3, -0.1)}}),
}
CASES = [(scene, name) for scene in SCENES for name in STEP]


@pytest.fixture(scope="module", params=SCENES)
def solved(request):
    make, given = SCENES[request.param]
    robot = make()
    return robot, given, mr.solve(robot, robot.inputs(**given), solver=SOLVER).raise_if_failed()


def sections_of(robot):
    return max(len(rod.sections) for rod in robot.rods)


def varied(robot, name, direction):
    """The robot with numbers that change along a direction, (rod, section, ...), for each node an instance."""
    rods = []
    for rod, own in zip(robot.rods, direction, strict=True):
        changed = []
        for section, by in zip(rod.sections, own, strict=False):
            value = getattr(section, name)
            change = STEP[name] * np.multiply.outer(NODES, by)
            value = value * (1 + change) if "stiffness" in name else value + change
            arguments = {key: getattr(section, key) for key in ("length", *SHAPE, "axial_stiffness", "linear_density")}
            changed.append(mr.Section(**(arguments | {name: value})))
        rods.append(mr.Rod(sections=changed, name=rod.name))
    return robot.with_rods(rods)


def pose_rate(solution, other, step):
    turns = Rotation.from_matrix(other.tip_rotation @ solution.tip_rotation.T).as_rotvec()
    return WEIGHTS @ np.concatenate([other.tip_position, turns], axis=1) / step


def along_of(robot, name):
    """A direction, and what it is in the units of the columns."""
    direction = np.random.default_rng(3).standard_normal((len(robot.rods), sections_of(robot), *SHAPE[name]))
    scale = np.zeros(direction.shape)
    for k, rod in enumerate(robot.rods):
        for m, section in enumerate(rod.sections):
            scale[k, m] = getattr(section, name) if "stiffness" in name else 1.0
    return direction, (scale * direction).ravel()


@pytest.mark.parametrize("name", STEP)
def test_columns_by_numbers_of_rods(solved, name):
    """(D4) to (D9), (D22)"""
    robot, given, solution = solved
    direction, units = along_of(robot, name)
    other = varied(robot, name, direction)
    moved = mr.solve(other, other.inputs(**given), solver=SOLVER, guess=solution).raise_if_failed()
    expected = pose_rate(solution, moved, STEP[name])
    found = solution.jacobian(name) @ units
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-9 * np.abs(expected).max())


def joints_moved(robot, direction, step):
    """The robot with joints moved and turned along a direction, (joint, 6), for each node an instance."""
    joints = []
    for joint, own in zip(robot.joints, direction, strict=True):
        poses = np.tile(joint.pose, (len(NODES), 1, 1))
        poses[:, :3, :3] = Rotation.from_rotvec(step * NODES[:, None] * own[3:]).as_matrix() @ poses[:, :3, :3]
        poses[:, :3, 3] += step * NODES[:, None] * own[:3]
        joints.append(changed(joint, pose=poses))
    wholes = zip(robot.graph.whole_names, robot.graph.whole, strict=True)
    rods = {name: whole.rods[0] if whole.rod_count == 1 else whole for name, whole in wholes}
    return mr.Network(rods=rods, bodies=robot.bodies, joints=joints, end_effector=robot.end_effector, base=robot.base)


def test_columns_by_poses_of_joints(solved):
    """(D23) Of bases, tips and holes, one direction of all at once."""
    robot, given, solution = solved
    direction = np.random.default_rng(5).standard_normal((len(robot.joints), 6)) * ([0.05] * 3 + [1.0] * 3)
    step = 1e-4
    other = joints_moved(robot, direction, step)
    moved = mr.solve(other, other.inputs(**given), solver=SOLVER, guess=solution).raise_if_failed()
    expected = pose_rate(solution, moved, step)
    found = solution.jacobian("joint_pose") @ direction.ravel()
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-9 * np.abs(expected).max())


def bases_moved(robot, direction, step):
    bases = np.tile(robot.base, (len(NODES), 1, 1))
    bases[:, :3, :3] = Rotation.from_rotvec(step * NODES[:, None] * direction[3:]).as_matrix() @ bases[:, :3, :3]
    bases[:, :3, 3] += step * NODES[:, None] * direction[:3]
    return bases


def test_columns_by_the_ground(solved):
    """(D10) Loads that are fixed in the world stay."""
    robot, given, solution = solved
    direction, step = np.random.default_rng(6).standard_normal(6), 1e-2
    other = robot.with_base(bases_moved(robot, direction, step))
    moved = mr.solve(other, other.inputs(**given), solver=SOLVER, guess=solution).raise_if_failed()
    expected = pose_rate(solution, moved, step)
    np.testing.assert_allclose(solution.jacobian("base") @ direction, expected, rtol=0, atol=1e-9 * np.abs(expected).max())


def columns_at(robot, inputs, x, *names):
    options = {"integrator": STEPS, "pose_sensitivities": True, **robot.input_directions(*names)}
    problem = robot.problem(inputs, **options)
    problem.evaluate(x[None])
    return problem.input_columns(*names)


@pytest.mark.parametrize("name", ["precurvature", "torsional_stiffness", "bending_stiffness"])
def test_columns_at_fixed_unknowns(solved, name):
    """(D9) At equilibrium; which bending stiffness scales residuals with does not matter there."""
    robot, given, solution = solved
    direction, units = along_of(robot, name)
    if name == "bending_stiffness":  # that both axes share: what scales the unknowns is the larger one, which would change
        direction = np.repeat(direction[..., :1], 2, axis=-1)
        stiffness = [[np.broadcast_to(s.bending_stiffness, 2) for s in padded(rod, robot)] for rod in robot.rods]
        units = (direction * stiffness).ravel()
    slopes, moved = columns_at(robot, robot.inputs(**given), solution.unknowns, name)
    other = varied(robot, name, direction)
    problem = other.problem(other.inputs(**given), integrator=STEPS, pose_sensitivities=True)
    residual, _ = problem.evaluate(np.tile(solution.unknowns, (len(NODES), 1)))
    expected = WEIGHTS @ residual / STEP[name]
    np.testing.assert_allclose(slopes[0] @ units, expected, rtol=0, atol=1e-8 * np.abs(expected).max())
    turns = Rotation.from_matrix(problem.read("rotation").reshape(-1, 3, 3) @ solution.tip_rotation.T).as_rotvec()
    expected = WEIGHTS @ np.concatenate([problem.read("position"), turns], axis=1) / STEP[name]
    np.testing.assert_allclose(moved[0] @ units, expected, rtol=0, atol=1e-8 * max(1.0, np.abs(expected).max()))


def padded(rod, robot):
    return [*rod.sections, *[rod.sections[-1]] * (sections_of(robot) - len(rod.sections))]


def test_what_is_not_known_at_fixed_unknowns_is_refused():
    robot = discs()
    x = np.zeros(robot.graph.entries.size)
    for name in ("length", "joint_pose"):
        with pytest.raises(NotImplementedError, match=f"by {name}, the unknowns fixed, are not known"):
            columns_at(robot, robot.inputs(), x, name)


def test_several_names_at_once_and_a_transposed_product(solved):
    solution = solved[2]
    names = ("force", "precurvature", "joint_pose", "base", "translation", "length")
    found = solution.jacobian(*names)
    alone = np.concatenate([solution.jacobian(name) for name in names], axis=1)
    np.testing.assert_allclose(found, alone, rtol=0, atol=1e-12 * np.abs(found).max())
    product = solution.vjp(np.arange(6.0), wrt=names)
    together = np.concatenate([product[name] for name in names])
    np.testing.assert_allclose(together, np.arange(6.0) @ found, rtol=0, atol=1e-11 * np.abs(together).max())


@pytest.mark.parametrize("name", ["precurvature", "bending_stiffness", "joint_pose", "base"])
def test_columns_along_rods(name):
    """(D20), (D21) Of a place on a rod that stands on a body that moves, and of one on the ground."""
    robot, given = plate(), SCENES["a plate"][1]
    fine = mr.Shooting(tolerance=1e-12, integrator=mr.RK4(120))  # as fine as to integrate to the place by other steps
    solution = mr.solve(robot, robot.inputs(**given), solver=fine)
    step = STEP.get(name, 1e-3)
    if name == "joint_pose":
        direction = np.random.default_rng(5).standard_normal((len(robot.joints), 6)) * ([0.05] * 3 + [1.0] * 3)
        other, units = joints_moved(robot, direction, step), direction.ravel()
    elif name == "base":
        units = np.random.default_rng(6).standard_normal(6)
        other = robot.with_base(bases_moved(robot, units, step))
    else:
        direction, units = along_of(robot, name)
        other = varied(robot, name, direction)
    moved = mr.solve(other, other.inputs(**given), solver=fine, guess=solution).raise_if_failed()
    for rod in ("mast", "short"):
        shape = moved.rod(rod, nodes=3)
        middle = float(shape.arclength.reshape(-1, 3)[0, 1])
        told = {"position": shape.position[:, 1], "curvature": shape.curvature[:, 1]}
        for of, values in (told | {"wrench": moved.along(middle, of="wrench", rod=rod)}).items():
            expected = WEIGHTS @ values / step
            found = solution.jacobian(name, of=of, at=middle, rod=rod) @ units
            np.testing.assert_allclose(found, expected, rtol=0, atol=1e-8 * np.abs(expected).max())


def test_numbers_of_many_rods_in_a_chain():
    """Where ``Gamma`` is eliminated along the graph: a chain is bent as its rod, whose precurvature all pieces have."""
    count = 8
    piece = mr.Rod(length=0.4 / count, bending_stiffness=0.2, torsional_stiffness=0.06, precurvature=(3, 1, 0))
    nodes = [mr.Body(f"node {k}") for k in range(count)]
    joints = [mr.Joint(f"piece {k}", "base", to=nodes[k - 1] if k else mr.ground) for k in range(count)]
    joints += [mr.Joint(f"piece {k}", "tip", to=nodes[k]) for k in range(count)]
    robot = mr.Network(rods={f"piece {k}": piece for k in range(count)}, bodies=nodes, joints=joints)
    assert robot.elimination is not None
    solution = mr.solve(robot, robot.inputs(force={f"node {count - 1}": (0.5, 0.2, 0.1)}), solver=SOLVER).raise_if_failed()
    single = mr.SingleRod(mr.Rod(length=0.4, bending_stiffness=0.2, torsional_stiffness=0.06, precurvature=(3, 1, 0)))
    fine = mr.Shooting(tolerance=1e-12, integrator=mr.RK4(30 * count))
    expected = mr.solve(single, single.inputs(tip_force=(0.5, 0.2, 0.1)), solver=fine)
    for name in ("precurvature", "bending_stiffness", "length"):
        found = solution.jacobian(name).reshape(6, count, -1)
        found = found.mean(axis=1) if name == "length" else found.sum(axis=1)
        np.testing.assert_allclose(found, expected.jacobian(name), rtol=0, atol=1e-8 * np.abs(found).max())


def test_lengths_of_lines_by_stiffness():
    """A finger with a pulled and a displaced tendon on a body that a mast carries."""

    def made(factors=1.0):
        finger = mr.Rod(
            length=0.15,
            bending_stiffness=0.02 * np.multiply.outer(factors, np.ones(2)),
            torsional_stiffness=0.015,
            lines=[mr.Tendon(offset=(0.006, 0)), mr.Tendon(offset=(0, 0.006), driven="displacement", axial_stiffness=500.0)],
        )
        carriage = mr.Body("carriage")
        joints = [
            mr.Joint("mast", "base", to=mr.ground),
            mr.Joint("mast", "tip", to=carriage),
            mr.Joint("finger", "base", to=carriage, pose=at(0.02, 0)),
        ]
        return mr.Network(rods={"mast": ROD, "finger": finger}, bodies=[carriage], joints=joints, end_effector="finger")

    robot, given = made(), {"tension": {"finger": 3.0}, "displacement": {"finger": 0.002}, "force": {"finger": (0.2, 0, 0.1)}}
    solution = mr.solve(robot, robot.inputs(**given), solver=SOLVER).raise_if_failed()
    step = 1e-2
    other = made(1 + step * NODES)
    moved = mr.solve(other, other.inputs(**given), solver=SOLVER, guess=solution).raise_if_failed()
    units = np.array([0, 0, 0.02, 0.02])
    expected = WEIGHTS @ moved.line_length / step
    found = solution.jacobian("bending_stiffness", of="line_length") @ units
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-8 * np.abs(expected).max())
    for name, match in (("length", "by length of a rod with lines"), ("precurvature", "driven by displacement")):
        with pytest.raises(NotImplementedError, match=match):
            solution.jacobian(name)


def test_a_tracker_carries_columns_by_numbers():
    robot = plate()
    inputs = robot.inputs(**SCENES["a plate"][1])
    tracker = mr.Tracker(robot, inputs=inputs, solver=SOLVER, jacobian=("precurvature", "joint_pose"))
    sample = tracker.step()
    expected = mr.solve(robot, inputs, solver=SOLVER).jacobian("precurvature")
    np.testing.assert_allclose(sample.jacobian("precurvature"), expected, rtol=0, atol=1e-9 * np.abs(expected).max())


def test_numbers_of_a_network_are_fitted_to_poses():
    """Stiffnesses of legs, and where the ground is, come back from poses that they led to."""
    robot = plate()
    rng = np.random.default_rng(0)
    given = {"force": {"plate": rng.uniform(-0.5, 0.5, (8, 3)), "mast": rng.uniform(-0.1, 0.1, (8, 3))}}
    factors = np.array([1.1, 0.9, 1.2, 1.05, 0.95])
    rods = []
    for rod, factor in zip(robot.rods, factors, strict=True):
        sections = [
            mr.Section(
                length=s.length,
                bending_stiffness=factor * s.bending_stiffness,
                torsional_stiffness=s.torsional_stiffness,
                precurvature=s.precurvature,
                linear_density=s.linear_density,
            )
            for s in rod.sections
        ]
        rods.append(mr.Rod(sections=sections, name=rod.name))
    moved = (0.004, -0.003, 0.002, 0.01, 0.02, -0.01)
    base = np.array(robot.base)
    base[:3, :3], base[:3, 3] = Rotation.from_rotvec(moved[3:]).as_matrix() @ base[:3, :3], base[:3, 3] + moved[:3]
    true = robot.with_rods(rods).with_base(base)
    poses = mr.solve(true, true.inputs(**given), solver=SOLVER).raise_if_failed()
    values = {rod: poses.rod(rod, nodes=401).curvature[:, 200, :2] for rod in ("short", "mast")}
    bent = [mr.Curvature(at=0.1, value=value, sigma=1e-3, rod=rod) for rod, value in values.items()]
    sensors = [mr.Pose(position=poses.tip_position, rotation=poses.tip_rotation, sigma=(1e-5, 1e-4)), *bent]
    fit = mr.calibrate(robot, robot.inputs(**given), parameters=("bending_stiffness", "base"), measured=sensors, solver=SOLVER)
    fit.raise_if_failed()
    np.testing.assert_allclose(fit.value("bending_stiffness"), factors, rtol=1e-5)
    np.testing.assert_allclose(fit.value("base"), moved, atol=1e-6)
    assert fit.iterations <= 8


def test_a_network_is_a_function_with_gradients():
    jax = pytest.importorskip("jax")
    robot = discs()
    given = SCENES["discs"][1]
    tip = mr.jax.function(robot, inputs=robot.inputs(**given), solver=SOLVER)
    with jax.enable_x64(True):
        found = jax.jacobian(lambda u: tip(precurvature=u))(tip.value_of("precurvature"))
    expected = mr.solve(robot, robot.inputs(**given), solver=SOLVER).jacobian("precurvature")[:3]
    np.testing.assert_allclose(np.asarray(found).reshape(3, -1), expected, rtol=0, atol=1e-8 * np.abs(expected).max())
