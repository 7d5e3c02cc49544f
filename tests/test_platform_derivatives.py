"""Derivatives of parallel robots by where their legs stand and hold the platform, and by the legs' own numbers, against
differences of sixth order (``docs/derivatives.md``)."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from test_parallel_rods import EXACT, FEW, HEAVY, INNER, LOADS, OUTER, ROD, SOFT, ring

import multirod as mr
from multirod.models.backbone.derivatives.designs import turned_loads
from multirod.models.platform.derivatives.along import refuse_inverse

NODES, WEIGHTS = np.array([-3, -2, -1, 1, 2, 3]), np.array([-1, 9, -45, 45, -9, 1]) / 60  # a derivative, error O(h^6)
TUBES = mr.ConcentricTubes([INNER, OUTER])
KEPT = ("shear_stiffness", "axial_stiffness", "linear_density")
JOINTS = ["clamped", "spherical", "revolute"]
SCENES = {
    "every joint": ([ROD, SOFT, ROD], JOINTS),
    "rod and tubes": (
        [ROD, mr.ConcentricTubes([INNER, OUTER]), mr.ConcentricTubes([INNER, OUTER])],
        ["clamped", "clamped", "revolute"],
    ),
}
VALUES = {
    "every joint": {"rotation": (0.2, -0.4, 0.1), "translation": (0.02, -0.01, 0.03)},
    "rod and tubes": {"rotation": (0.2, -0.4, 0.1, 0.3, -0.2), "translation": (0.01, -0.03, -0.02, -0.02, -0.01)},
}


def askew(poses, seed):
    """Turned by some tenths, each its own way: else bases and attachments differ by one rotation alike."""
    turns = Rotation.from_rotvec(np.random.default_rng(seed).uniform(-0.2, 0.2, (3, 3))).as_matrix()
    poses[:, :3, :3] = turns @ poses[:, :3, :3]
    return poses


PLACES = {"base": askew(ring(3, 0.06, tilt=0.1), 5), "platform": askew(ring(3, 0.03, 0.15, 0.05), 6)}


def made(scene, legs=None, **places):
    legs, joints = SCENES[scene][0] if legs is None else legs, SCENES[scene][1]
    return mr.ParallelRods(legs=legs, joints=joints, joint_axes=[(0, 0, 1), (0, 0, 1), (1, 2, 2)], **PLACES | places, **HEAVY)


def moved_places(name, step):
    """Poses of which one is moved along one axis, or turned about it, (18, node, 3, 4, 4)."""
    poses = np.tile(PLACES[name], (18, 6, 1, 1, 1))
    for k in range(18):
        leg, axis = divmod(k, 6)
        for place, node in enumerate(NODES):
            if axis < 3:
                poses[k, place, leg, axis, 3] += step * node
            else:
                turn = Rotation.from_rotvec(step * node * np.eye(3)[axis - 3]).as_matrix()
                poses[k, place, leg, :3, :3] = turn @ poses[k, place, leg, :3, :3]
    return poses


def varied(scene, name, step):
    return made(scene, **{name: moved_places(name, step)})


@pytest.mark.parametrize("name", ["base", "platform"])
@pytest.mark.parametrize("scene", SCENES)
def test_columns_at_fixed_unknowns(scene, name):
    """(D16) to (D18) Also away from equilibrium, of the residual and the pose."""
    robot = made(scene)
    given = LOADS | VALUES[scene]
    problem = robot.problem(robot.inputs(**given), integrator=FEW, pose_sensitivities=True, **robot.input_directions(name))
    x = problem.guess() + 0.3 * np.random.default_rng(1).standard_normal((1, problem.unknown_count))
    problem.write("unknowns", x)
    slopes, moved = problem.input_columns(name)
    R = problem.read("rotation").reshape(3, 3)
    step = 2e-3
    other = varied(scene, name, step)
    problem = other.problem(other.inputs(**given), integrator=FEW, pose_sensitivities=True)
    residual, _ = problem.evaluate(np.broadcast_to(x, (108, problem.unknown_count)))
    turned = Rotation.from_matrix(problem.read("rotation").reshape(108, 3, 3) @ R.T).as_rotvec()
    pose = np.concatenate([problem.read("position"), turned], axis=1)
    for found, values in ((slopes, residual), (moved, pose)):
        expected = np.einsum("n,knc->ck", WEIGHTS, values.reshape(18, 6, -1)) / step
        np.testing.assert_allclose(found[0], expected, rtol=0, atol=1e-9 * max(1.0, np.abs(expected).max()))


@pytest.mark.parametrize("name", ["base", "platform"])
def test_columns_of_equilibria(name):
    """(D1) Along one direction, of legs in every joint under every load; several names at once, and a transposed product."""
    scene, names = "every joint", ("rotation", "platform", "tip_force", "base")
    robot = made(scene)
    solution = mr.solve(robot, robot.inputs(**LOADS, **VALUES[scene]), solver=EXACT).raise_if_failed()
    direction, step = np.random.default_rng(4).standard_normal((3, 6)), 5e-4
    poses = np.tile(PLACES[name], (6, 1, 1, 1))
    for leg in range(3):
        turns = Rotation.from_rotvec(step * NODES[:, None] * direction[leg, 3:]).as_matrix()
        poses[:, leg, :3, :3] = turns @ poses[:, leg, :3, :3]
        poses[:, leg, :3, 3] += step * NODES[:, None] * direction[leg, :3]
    other = made(scene, **{name: poses})
    solved = mr.solve(other, other.inputs(**LOADS, **VALUES[scene]), solver=EXACT, guess=solution).raise_if_failed()
    turned = Rotation.from_matrix(solved.tip_rotation @ solution.tip_rotation.T).as_rotvec()
    expected = WEIGHTS @ np.concatenate([solved.tip_position, turned], axis=1) / step
    found = solution.jacobian(*names)
    own = {"base": slice(-18, None), "platform": slice(3, 21)}[name]
    np.testing.assert_allclose(found[:, own] @ direction.ravel(), expected, rtol=0, atol=1e-9 * np.abs(expected).max())
    np.testing.assert_allclose(solution.jacobian(name), found[:, own], rtol=0, atol=1e-12 * np.abs(found).max())
    product = solution.vjp(np.arange(6.0), wrt=names)
    together = np.concatenate([product[key] for key in names])
    np.testing.assert_allclose(together, np.arange(6.0) @ found, rtol=0, atol=1e-12 * np.abs(together).max())


def test_a_robot_whose_bases_move_together_moves_with_them_and_leaves_its_loads():
    """The attachments moved together move the platform's frame alone: its end effector is another point of the same body."""
    robot = made("every joint")
    solution = mr.solve(robot, robot.inputs(**VALUES["every joint"]), solver=EXACT)
    bases = solution.jacobian("base").reshape(6, 3, 6)
    # without loads, a turn of all bases about the world's origin turns the robot
    centres = PLACES["base"][:, :3, 3]
    for axis in np.eye(3):
        found = sum(bases[:, leg, :3] @ np.cross(axis, centres[leg]) + bases[:, leg, 3:] @ axis for leg in range(3))
        np.testing.assert_allclose(found, [*np.cross(axis, solution.tip_position), *axis], rtol=0, atol=1e-9)
    attachments = solution.jacobian("platform").reshape(6, 3, 6)[..., :3].sum(axis=1)
    expected = np.concatenate([-solution.tip_rotation, np.zeros((3, 3))])
    np.testing.assert_allclose(attachments, expected, rtol=0, atol=1e-9)


STEPS = {"precurvature": 3e-2, "bending_stiffness": 1e-2, "torsional_stiffness": 1e-2, "length": 3e-4}  # stiffnesses: relative
SHAPES = {"precurvature": (3,), "bending_stiffness": (2,), "torsional_stiffness": (), "length": ()}


def legs_varied(legs, name, direction, nodes):
    """Legs whose numbers change along a direction, (rod, section, ...), for each node an instance."""
    found, k = [], 0
    for leg in legs:
        rods = []
        for rod in [leg] if isinstance(leg, mr.Rod) else leg.tubes:
            sections = []
            for m, section in enumerate(rod.sections):
                change = STEPS[name] * np.multiply.outer(nodes, direction[k, m])
                own = {
                    key: getattr(section, key)
                    for key in ("length", *SHAPES, "shear_stiffness", "axial_stiffness", "linear_density")
                }
                own[name] = own[name] * (1 + change) if "stiffness" in name else own[name] + change
                sections.append(mr.Section(**own))
            rods.append(mr.Rod(sections=sections))
            k += 1
        found.append(rods[0] if isinstance(leg, mr.Rod) else mr.ConcentricTubes(rods))
    return found


@pytest.mark.parametrize("name", SHAPES)
def test_columns_by_numbers_of_legs(name):
    """(D4) to (D9) of a rod and tubes that hold a platform, along one direction."""
    scene = "rod and tubes"
    robot = made(scene)
    solution = mr.solve(robot, robot.inputs(**LOADS, **VALUES[scene]), solver=EXACT).raise_if_failed()
    direction = np.random.default_rng(3).standard_normal((5, 2, *SHAPES[name]))
    direction[[0, 2, 4], 1] = 0.0  # of sections that are not there
    other = made(scene, legs_varied(SCENES[scene][0], name, direction, NODES))
    solved = mr.solve(other, other.inputs(**LOADS, **VALUES[scene]), solver=EXACT, guess=solution).raise_if_failed()
    turned = Rotation.from_matrix(solved.tip_rotation @ solution.tip_rotation.T).as_rotvec()
    expected = WEIGHTS @ np.concatenate([solved.tip_position, turned], axis=1) / STEPS[name]
    scale = np.zeros((5, 2, *SHAPES[name]))
    for k, rod in enumerate(robot.rods):
        for m, section in enumerate(rod.sections):
            scale[k, m] = getattr(section, name) if "stiffness" in name else 1.0
    found = solution.jacobian(name) @ (scale * direction).ravel()
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-9 * np.abs(expected).max())
    if name in ("precurvature", "torsional_stiffness"):  # what the others change scales residuals and unknowns too
        at = {"integrator": EXACT.integrator, "pose_sensitivities": True}
        problem = robot.problem(solution.inputs, **at, **robot.input_directions(name))
        problem.evaluate(solution.unknowns[None])
        slopes, _ = problem.input_columns(name)
        residual, _ = other.problem(solved.inputs, **at).evaluate(np.tile(solution.unknowns, (6, 1)))
        expected = WEIGHTS @ residual / STEPS[name]
        np.testing.assert_allclose(slopes[0] @ (scale * direction).ravel(), expected, rtol=0, atol=1e-8 * np.abs(expected).max())


ALONG = {"rotation": 3e-2, "tip_force": 3e-2, "gravity": 3e-1}


@pytest.mark.parametrize("scene", SCENES)
def test_columns_along_legs(scene):
    """(D20) Of the middle of each rod, by inputs; at their tips those of the platform where it holds them, by numbers too."""
    robot = made(scene)
    given = LOADS | VALUES[scene]
    solution = mr.solve(robot, robot.inputs(**given), solver=EXACT).raise_if_failed()
    for name, step in ALONG.items():
        at = np.atleast_1d(given[name]).astype(float)
        values = at + step * NODES[:, None] * np.eye(len(at))[:, None]
        moved = mr.solve(robot, robot.inputs(**(given | {name: values})), solver=EXACT, guess=solution).raise_if_failed()
        for rod in range(len(robot.rods)):
            shape = moved.rod(rod, nodes=3)
            middle = float(shape.arclength.reshape(-1, 3)[0, 1])
            for of in ("position", "curvature"):
                expected = np.einsum("n,knc->ck", WEIGHTS, getattr(shape, of)[:, :, 1]) / step
                found = solution.jacobian(name, of=of, at=middle, rod=rod)
                np.testing.assert_allclose(found, expected, rtol=0, atol=1e-8 * np.abs(expected).max())
    names = ("tip_force", "rotation", "base", "precurvature")
    pose = solution.jacobian(*names)
    outermost = {"every joint": (0, 1, 2), "rod and tubes": (0, 1, 3)}[scene]  # inner ones, which reach the platform
    for rod in outermost:
        shape = solution.rod(rod)
        found = solution.jacobian(*names, of="position", at=float(shape.arclength[-1]), rod=rod)
        lever = shape.position[-1] - solution.tip_position
        expected = pose[:3] + np.cross(pose[3:].T, lever).T
        np.testing.assert_allclose(found, expected, rtol=0, atol=1e-9 * np.abs(expected).max())


def test_a_force_on_a_platform_is_read_from_curvatures_of_its_legs():
    """Alone and in a loop, from bending that was solved for another force."""
    robot = made("every joint")
    given = {"translation": VALUES["every joint"]["translation"]}
    force = np.array([0.6, -0.4, 0.5])
    at = np.array([0.05, 0.12])
    real = mr.solve(robot, robot.inputs(tip_force=force, **given), solver=EXACT)
    bent = []
    for rod in range(3):
        shape = real.rod(rod, nodes=401)
        bent.append(np.array([np.interp(at, shape.arclength, shape.curvature[:, k]) for k in range(2)]).T)
    sensors = [mr.Curvature(at=at, value=value, sigma=1e-3, rod=rod) for rod, value in enumerate(bent)]
    unknown = {"tip_force": mr.Prior(0, sigma=3.0)}
    found = mr.estimate(robot, robot.inputs(**given), unknown=unknown, measured=sensors).raise_if_failed()
    spread = np.sqrt(np.diag(found.covariance("tip_force")))
    assert (spread < 0.3).all()
    # curvatures between nodes are off by far less than their sigma
    assert (np.abs(found.value("tip_force") - force) < spread).all()


def test_what_is_not_known_is_refused():
    robot = made("every joint")
    loaded = SimpleNamespace(inputs_given=robot.inputs(distributed_force=lambda s: (0, 0, -s)))
    with pytest.raises(NotImplementedError, match="by base are not known where loads are functions of arclength"):
        turned_loads(loaded, ())
    with pytest.raises(NotImplementedError, match="the inverse problem does not take sensors along its rods"):
        refuse_inverse(SimpleNamespace(inverse=True))
    with pytest.raises(NotImplementedError, match="calibrate.. by base is for robots that have one: ParallelRods has not"):
        mr.calibrate(robot, robot.inputs(), parameters="base", measured=mr.Pose(position=(0, 0, 0.3), sigma=1e-3))


def test_stiffness_of_legs_is_fitted_to_poses():
    """What a calibration of other robots takes, legs give too: their own numbers come back from poses that they led to."""
    scene = "every joint"
    rng = np.random.default_rng(0)
    given = {"tip_force": rng.uniform(-0.5, 0.5, (6, 3)), "translation": rng.uniform(-0.03, 0.03, (6, 3))}
    stiffer = np.array([1.1, 0.9, 1.2])
    legs = [
        mr.Rod(
            sections=[
                mr.Section(
                    **{key: getattr(rod.sections[0], key) for key in ("length", "precurvature", "torsional_stiffness", *KEPT)},
                    bending_stiffness=factor * rod.sections[0].bending_stiffness,
                )
            ]
        )
        for rod, factor in zip(SCENES[scene][0], stiffer, strict=True)
    ]
    true = made(scene, legs)
    poses = mr.solve(true, true.inputs(**given), solver=EXACT)
    robot = made(scene)
    sensor = mr.Pose(position=poses.tip_position, rotation=poses.tip_rotation, sigma=(1e-5, 1e-4))
    found = mr.calibrate(robot, robot.inputs(**given), parameters="bending_stiffness", measured=sensor, solver=EXACT)
    fitted = [rod.sections[0].bending_stiffness for rod in found.robot.rods]
    expected = [rod.sections[0].bending_stiffness for rod in true.rods]
    np.testing.assert_allclose(fitted, expected, rtol=1e-6)
