"""Derivatives by the medium around rods and by their magnetisation, (D24) of ``docs/derivatives.md``, against differences."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import multirod as mr
from multirod.read_only import changed
from multirod.results.derivatives import known_names

SOLVER = mr.Shooting(integrator=mr.RK45(rtol=1e-11, atol=1e-13), tolerance=1e-12)
NODES, WEIGHTS = np.array([-3, -2, -1, 1, 2, 3]), np.array([-1, 9, -45, 45, -9, 1]) / 60  # a derivative, error O(h^6)
AHEAD, WEIGHTS_AHEAD = np.arange(7), np.array([-147, 360, -450, 400, -225, 72, -10]) / 60  # the same of one side
STEPS = {"foundation": 0.3, "magnetisation": 1e-2}
FIELD = np.array([0.05, -0.03, 0.02])


def section(length, EI, GJ, curved, foundation=(0, 0, 0), magnetisation=(0, 0, 0), **more):
    numbers = {"length": length, "bending_stiffness": EI, "torsional_stiffness": GJ, "precurvature": curved}
    return mr.Section(**numbers, foundation=foundation, magnetisation=magnetisation, **more)


WIRE = mr.Rod(
    sections=[
        section(0.12, (0.01, 0.015), 0.008, (4, -2, 1), (60, 30, 10), (0.4, -0.2, 2.0)),
        section(0.08, (0.01, 0.01), 0.008, (1, 3, -1), (20, 40, 5), (-0.3, 0.2, 1.0)),
    ]
)
SOFT = mr.Rod(
    sections=[section(0.2, 0.01, 0.008, (2, 0, 0.5), (40, 20, 10), (0.2, 0, 1), shear_stiffness=40.0, axial_stiffness=90.0)]
)
TUBES = [
    mr.Rod(
        sections=[
            section(0.14, 0.01, 0.008, (0, 0, 0), (20, 30, 10), (0.6, -0.9, 2.0)),
            section(0.06, 0.01, 0.008, (6, 2, 0.5), (40, 20, 5), (0.1, 0.4, 1.0)),
        ]
    ),
    mr.Rod(sections=[section(0.14, 0.03, 0.02, (0, 9, 0), (100, 50, 20), (-0.8, 0.5, 0.7))]),
]
PLAIN = mr.Rod(sections=[section(0.2, 0.02, 0.016, (1, 0.5, 0.2))])


def placed(x=0.0, y=0.0, z=0.0):
    pose = np.eye(4)
    pose[:3, 3] = x, y, z
    return pose


def platform():
    """A leg in a medium and one without, and tubes of both kinds."""
    base = [placed(0.05), placed(-0.04, 0.03), placed(0, -0.05)]
    ends = [placed(0.03), placed(-0.03, 0.01), placed(0, -0.03)]
    legs = [WIRE, PLAIN, mr.ConcentricTubes(TUBES)]
    return mr.ParallelRods(legs=legs, base=base, platform=ends, joints=["clamped", "spherical", "clamped"])


def held():
    return mr.HeldRod(WIRE, end=placed(0.03, 0.02, 0.19), joint="spherical", slide=(0, 0.3, 1))


def network():
    """A plate on two rods, one of them in a medium, with a mast on it, which can be in none."""
    plate = mr.Body("plate")
    joints = [
        mr.Joint("wire", "base", to=mr.ground, pose=placed(0.04)),
        mr.Joint("wire", "tip", to=plate, pose=placed(0.03)),
        mr.Joint("plain", "base", to=mr.ground, pose=placed(-0.04)),
        mr.Joint("plain", "tip", to=plate, pose=placed(-0.03), kind="spherical"),
        mr.Joint("mast", "base", to=plate, pose=placed(0, 0.01)),
    ]
    rods = {"wire": WIRE, "plain": PLAIN, "mast": PLAIN}
    return mr.Network(rods=rods, bodies=[plate], joints=joints, end_effector="mast")


LOADS = {"tip_force": (0.2, 0.1, -0.1), "magnetic_field": FIELD}
SCENES = {
    "rod": (lambda: mr.SingleRod(WIRE), {**LOADS, "rotation": 0.3, "translation": 0.01}),
    "rod that shears": (lambda: mr.SingleRod(SOFT), LOADS),
    "tubes": (lambda: mr.ConcentricTubes(TUBES), {**LOADS, "rotation": (0.3, 1.2), "translation": (-0.05, -0.02)}),
    "platform": (platform, LOADS),
    "held": (held, LOADS),
    "network": (network, {"force": {"mast": (0.1, 0.05, -0.1)}, "magnetic_field": FIELD}),
}


def direction_of(robot, name):
    """A way to change all numbers of a name, (rod, section, 3); of what is zero there is none."""
    most = max(len(rod.sections) for rod in robot.rods)
    random = np.random.default_rng(4)
    result = np.zeros((robot.rod_count, most, 3))
    for k, rod in enumerate(robot.rods):
        for m, own in enumerate(rod.sections):
            result[k, m] = random.standard_normal(3) * np.any(getattr(own, name))
    return result


def varied(robot, name, direction, steps):
    """The robot whose numbers are changed along a direction by each of some steps, an instance for each."""
    rods = []
    for rod, way in zip(robot.rods, direction, strict=True):
        pairs = zip(rod.sections, way, strict=False)
        own = [replace(s, **{name: getattr(s, name) + np.multiply.outer(steps, by)}) for s, by in pairs]
        rods.append(changed(rod, sections=tuple(own), batch_shape=own[0].batch_shape))
    return robot.with_rods(rods)


def pose_rate(solution, other, weights, step):
    turned = Rotation.from_matrix(other.tip_rotation @ solution.tip_rotation.T).as_rotvec()
    return weights @ np.concatenate([other.tip_position, turned], axis=1) / step


@pytest.fixture(scope="module", params=SCENES)
def solved(request):
    make, given = SCENES[request.param]
    robot = make()
    return robot, given, mr.solve(robot, robot.inputs(**given), solver=SOLVER).raise_if_failed()


@pytest.mark.parametrize("name", STEPS)
def test_columns_are_derivatives(solved, name):
    """To 1e-9 of the largest: the differences' rounding is 1e-12, their own error less."""
    robot, given, solution = solved
    direction = direction_of(robot, name)
    other = varied(robot, name, direction, STEPS[name] * NODES)
    moved = mr.solve(other, other.inputs(**given), solver=SOLVER, guess=solution).raise_if_failed()
    expected = pose_rate(solution, moved, WEIGHTS, STEPS[name])
    found = solution.jacobian(name)
    np.testing.assert_allclose(found @ direction.ravel(), expected, rtol=0, atol=1e-9 * np.abs(expected).max())
    own = found.reshape(6, *direction.shape)
    for k, rod in enumerate(robot.rods):
        assert not own[:, k, len(rod.sections) :].any()
    # several at once are each alone, and a transposed product is that of the columns
    both = solution.jacobian(name, "precurvature")[:, : found.shape[1]]
    np.testing.assert_allclose(both, found, rtol=0, atol=1e-10 * np.abs(found).max())
    c = np.arange(1.0, 7)
    np.testing.assert_allclose(solution.vjp(c, wrt=name)[name], c @ found, rtol=1e-8, atol=1e-10 * np.abs(found).max())


@pytest.mark.parametrize("name", STEPS)
def test_columns_at_fixed_unknowns(solved, name):
    robot, given, solution = solved
    direction = direction_of(robot, name)
    at = {"integrator": SOLVER.integrator, "pose_sensitivities": True}
    problem = robot.problem(robot.inputs(**given), **at, **robot.input_directions(name))
    problem.evaluate(problem.adopt(solution.unknowns[None]))
    slopes, _ = problem.input_columns(name)
    other = varied(robot, name, direction, STEPS[name] * NODES)
    problem = other.problem(other.inputs(**given), **at)
    residual, _ = problem.evaluate(np.tile(solution.unknowns, (len(NODES), 1)))
    expected = WEIGHTS @ residual / STEPS[name]
    np.testing.assert_allclose(slopes[0] @ direction.ravel(), expected, rtol=0, atol=1e-9 * np.abs(expected).max())


def test_columns_along_a_rod():
    robot, given = mr.SingleRod(WIRE), SCENES["rod"][1]
    solution = mr.solve(robot, robot.inputs(**given), solver=SOLVER)
    for name, step in STEPS.items():
        direction = direction_of(robot, name)
        other = varied(robot, name, direction, step * NODES)
        moved = mr.solve(other, other.inputs(**given), solver=SOLVER, guess=solution)
        for of in ("position", "curvature"):
            found = solution.jacobian(name, of=of, at=(0.07, 0.16)) @ direction.ravel()
            expected = np.einsum("n,nsc->sc", WEIGHTS, moved.along((0.07, 0.16), of=of)) / step
            np.testing.assert_allclose(found, expected, rtol=0, atol=1e-9 * np.abs(expected).max())


@pytest.mark.parametrize("scene", ["rod", "tubes", "platform"])
def test_a_medium_that_is_not_there_yet(scene):
    """By one side: what the first of it does, though the solve knew of none."""
    robot = SCENES[scene][0]()
    robot = robot.with_rods([_without(rod) for rod in robot.rods])
    given = {**SCENES[scene][1], "magnetic_field": (0, 0, 0)}
    solution = mr.solve(robot, robot.inputs(**given), solver=SOLVER).raise_if_failed()
    direction = np.abs(np.random.default_rng(5).standard_normal((robot.rod_count, 2, 3)))
    for k, rod in enumerate(robot.rods):
        direction[k, len(rod.sections) :] = 0
    step = 0.2
    other = varied(robot, "foundation", direction, step * AHEAD)
    moved = mr.solve(other, other.inputs(**given), solver=SOLVER, guess=solution).raise_if_failed()
    expected = pose_rate(solution, moved, WEIGHTS_AHEAD, step)
    found = solution.jacobian("foundation")
    np.testing.assert_allclose(found @ direction.ravel(), expected, rtol=0, atol=1e-8 * np.abs(expected).max())
    assert not solution.jacobian("magnetisation").any()  # no field
    carried = mr.Tracker(robot, solver=mr.Shooting(), jacobian=("foundation",), guess=solution).step(robot.inputs(**given))
    np.testing.assert_allclose(carried.jacobian("foundation"), found, rtol=0, atol=1e-4 * np.abs(found).max())  # fixed steps


def _without(rod):
    return changed(rod, sections=tuple(replace(s, foundation=0.0) for s in rod.sections))


def test_a_batch_has_those_of_each():
    robot = mr.SingleRod(WIRE)
    forces = np.array([(0.2, 0.1, 0), (0, -0.3, 0.1), (0.1, 0.1, 0.1)])
    given = {"magnetic_field": FIELD}
    batch = mr.solve(robot, robot.inputs(tip_force=forces, **given))
    alone = mr.solve(robot, robot.inputs(tip_force=forces[1:2], **given))
    names = ("foundation", "magnetisation")
    np.testing.assert_array_equal(batch.jacobian(*names)[1], alone.jacobian(*names)[0])


def test_what_no_rod_of_a_robot_can_have_is_no_name_that_it_takes():
    turning = mr.HeldRod(PLAIN, end=placed(0, 0.02, 0.19), base_joint="spherical")
    assert "foundation" not in turning.parameters
    assert {"foundation", "magnetisation"} <= {*held().parameters}
    tubes = mr.Rod(length=0.2, bending_stiffness=0.01, torsional_stiffness=0.008)
    side_by_side = mr.EccentricTubes([tubes, tubes], ((0.002, 0), (-0.002, 0)))
    for name in STEPS:
        with pytest.raises(TypeError, match=f"takes no '{name}'"):
            known_names(side_by_side, [name], "jacobian(name)")
    plain, seen = mr.SingleRod(PLAIN), mr.Pose(position=(0, 0, 0.2), sigma=1e-3)
    with pytest.raises(ValueError, match="'foundation' is not allowed: must not be fitted: no rod has one that is finite"):
        mr.calibrate(plain, plain.inputs(), parameters="foundation", measured=seen)
    robot = network()
    with pytest.raises(ValueError, match=r"Network.rods\['mast'\].*must be clamped at its base to the ground"):
        robot.with_rods([*robot.rods[:2], changed(WIRE, name="mast")])


def test_a_rod_whose_base_moves_has_no_columns_by_a_medium():
    mast = mr.solve(network()).jacobian("foundation").reshape(6, 3, -1, 3)[:, 2]
    assert not mast.any()


def test_medium_and_magnetisation_are_fitted_to_poses():
    """Factors of a rod's own come back from poses that they led to."""
    random = np.random.default_rng(0)
    robot = mr.SingleRod(WIRE)
    given = {"tip_force": random.uniform(-0.5, 0.5, (6, 3)), "magnetic_field": random.uniform(-0.1, 0.1, (6, 3))}
    factors = {"foundation": 1.3, "magnetisation": 0.8}
    own = [replace(s, **{name: getattr(s, name) * factor for name, factor in factors.items()}) for s in WIRE.sections]
    true = mr.SingleRod(changed(WIRE, sections=tuple(own)))
    poses = mr.solve(true, true.inputs(**given))
    seen = mr.Pose(position=poses.tip_position, rotation=poses.tip_rotation, sigma=(1e-4, 1e-3))
    fit = mr.calibrate(robot, robot.inputs(**given), parameters=tuple(factors), measured=seen).raise_if_failed()
    for name, factor in factors.items():
        np.testing.assert_allclose(fit.value(name), factor, rtol=1e-5)
    assert "rod 1: foundation, over what it was" in fit.labels


def test_a_robot_is_a_function_of_its_medium():
    """By what JAX and PyTorch are given: values, and columns by them, of a robot that has no medium of its own too."""
    from multirod.results.differentiable import Equilibrium

    for rod in (WIRE, PLAIN):
        robot = mr.SingleRod(rod)
        own = Equilibrium(robot, "tip_position", robot.inputs(tip_force=(0.2, 0.1, 0)), None, None)
        medium = own.value_of("foundation") + np.array([5.0, 10.0])[:, None, None, None]
        solution, absent = own.solve({"foundation": medium})
        (columns,) = own.columns(solution, absent, ["foundation"])
        assert columns.shape == (2, 3, 1, len(rod.sections), 3)
        for k, numbers in enumerate(medium):
            sections = [replace(s, foundation=n) for s, n in zip(rod.sections, numbers[0], strict=True)]
            alone = mr.SingleRod(changed(rod, sections=tuple(sections)))
            expected = mr.solve(alone, own.inputs)
            np.testing.assert_array_equal(own.value(solution, absent)[k], expected.tip_position)
            np.testing.assert_array_equal(columns[k].reshape(3, -1), expected.jacobian("foundation")[:3])
