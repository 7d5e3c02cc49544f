"""Variational columns against differences of the discretised equations themselves."""

import numpy as np
import pytest

import multirod as mr

GRID = mr.RK45(steps=40)  # equal steps, by kernels that other tests need too

# Columns and differences see the same grid, so what is left is the differences' own error: step 1e-2 (in units of each
# input's size), extrapolated to O(h^6), plus rounding 1e-16/h times the growth of columns along the rod (1e2 at most).
TOLERANCE = 1e-9

STIFF = {"bending_stiffness": (0.05, 0.08), "torsional_stiffness": 0.03, "linear_density": 0.4}
SOFT = {"bending_stiffness": (0.03, 0.02), "torsional_stiffness": 0.015, "linear_density": 0.1}
SHEAR = {"shear_stiffness": (8.0, 12.0), "axial_stiffness": 20.0}
SIZES = {"rotation": 0.3, "translation": 0.002}  # of a variation; 0.3 for loads


def bent(s):
    return (3 + 20 * s**2, -4 * np.cos(5 * s), 2 + 6 * s)


def push(s):
    return (0.5 * np.cos(4 * s), -0.8 * s, 0.3 + s**2)


def twist(s):
    return (0.1 * s, 0.05 * np.sin(6 * s), 0.04)


def uniform(**more):
    return mr.Rod(length=0.4, **(STIFF | {"precurvature": (5, -3, 2)} | more))


def jumps(first=(2, 5, 1), second=(-6, 1, 4), **more):
    base = mr.Section(length=0.17, precurvature=first, **STIFF, **more)
    return mr.Rod(sections=[base, mr.Section(length=0.23, precurvature=second, **SOFT, **more)])


TIP = {"tip_force": (0.4, -0.3, 0.5)}
TURNED = {"rotation": 0.4}
FUNCTIONS = {"distributed_force": push, "distributed_moment": twist}
PULLED = TURNED | TIP
MOMENTS = {"tip_moment": (0.2, -0.1, 0.3), "follower_moment": (0.1, 0.2, -0.15), "distributed_moment": (0.3, -0.2, 0.4)}
WEIGHT = TURNED | {"gravity": (2, -4, 1), "distributed_force": (0.6, -0.4, 0.9)}
FOLLOWED = TURNED | TIP | {"follower_force": (0.5, 0.3, -0.4), "gravity": (2, -4, 1)}
EVERY = FOLLOWED | FUNCTIONS | {"tip_moment": (0.05, 0.08, -0.04), "follower_moment": (-0.03, 0.04, 0.05)}
STEEP = jumps(first=bent, **SHEAR)

# name: rod, inputs. Translations put no section end on the base: there the fixed grid, not the model, has a kink.
SCENES = {
    "tip force": (jumps(), PULLED | {"translation": 0.03}),
    "tip force, first section withdrawn": (jumps(), PULLED | {"translation": -0.21}),
    "moments": (jumps(), TURNED | MOMENTS),
    "weight and shear": (jumps(**SHEAR), WEIGHT | {"translation": 0.02}),
    "weight and shear, first section withdrawn": (jumps(**SHEAR), WEIGHT | {"translation": -0.21}),
    "follower force": (jumps(), FOLLOWED | {"translation": 0.02}),
    "precurvature function": (uniform(precurvature=bent), PULLED | {"translation": 0.03}),
    "precurvature function, shortened": (uniform(precurvature=bent), PULLED | {"translation": -0.06}),
    "precurvature function, second section": (jumps(second=bent), PULLED | {"translation": -0.21}),
    "measured curvature": (jumps(first=bent), PULLED | {"tip_curvature": (3, -2, 1), "translation": 0.01}),
    "every load": (STEEP, EVERY | {"translation": 0.03}),
    "every load, shortened": (STEEP, EVERY | {"translation": -0.06}),
    "every load, first section withdrawn": (STEEP, EVERY | {"translation": -0.21}),
}


@pytest.fixture(params=SCENES, scope="module")
def scene(request):
    """A problem of one scene with one direction, unknowns near but not at equilibrium, and where its inputs stand."""
    rod, values = SCENES[request.param]
    turn = np.array([[0.36, 0.48, -0.8], [-0.8, 0.6, 0.0], [0.48, 0.64, 0.6]])
    base = np.eye(4)
    base[:3, :3] = turn
    base[:3, 3] = 0.1, -0.2, 0.3
    robot = mr.SingleRod(rod, base=base)
    inputs = robot.inputs(**values)
    problem = robot.problem(inputs, integrator=GRID, pose_sensitivities=True, direction_count=1)
    rng = np.random.default_rng(5)
    x = problem.guess() + rng.uniform(-2, 2, (1, problem.unknown_count))
    places = {name: problem.input_slice(name) for name in {"rotation", "translation", *values}}
    if inputs.profiles:
        places["scale of the functions"] = slice(-1, None)
    return problem, x, places


def outputs(problem, x, row=None):
    """Residual, tip position and rotation at unknowns ``x`` and a packed row of inputs."""
    if row is not None:
        problem.inputs.assign(row)
    residual, _ = problem.evaluate(x)
    assert np.isfinite(residual).all()
    return residual[0], problem.read("position")[0], problem.read("rotation")[0].reshape(3, 3)


def rates(difference, f, h):
    """Derivatives of residual, position and world rotation vector by differences of ``f(t)``."""
    R = f(0.0)[2]
    d = difference(lambda t: np.concatenate([part.ravel() for part in f(t)]), h)
    n = len(d) - 12
    spin = d[n + 3 :].reshape(3, 3) @ R.T
    return d[:n], d[n : n + 3], np.array([spin[2, 1] - spin[1, 2], spin[0, 2] - spin[2, 0], spin[1, 0] - spin[0, 1]]) / 2


def check(found, expected, what):
    scale = max(np.abs(expected).max(), 1e-3)
    assert np.abs(found - expected).max() <= TOLERANCE * scale, f"{what}: {found} is not {expected}"


@pytest.mark.parametrize("factor", [1.0, 0.6])
def test_gamma_and_pose_columns_are_derivatives(scene, difference, factor):
    problem, x, _ = scene
    with problem.at_load(factor):
        _, gamma = problem.evaluate(x)
        columns = problem.pose_columns.numpy()[0].copy()
        for k in range(problem.unknown_count):
            step = np.zeros_like(x)
            step[0, k] = 1.0
            residual, position, turn = rates(difference, lambda t, step=step: outputs(problem, x + t * step), 0.05)
            check(gamma[0, :, k], residual, f"Gamma[:, {k}]")
            check(columns[:3, k], position, f"position by x{k}")
            check(columns[3:, k], turn, f"rotation by x{k}")


def test_input_directions_are_derivatives(scene, difference):
    problem, x, places = scene
    row = problem.inputs.numpy().copy()
    rng = np.random.default_rng(7)
    for name, place in sorted(places.items()):
        direction = np.zeros_like(row)
        direction[0, place] = rng.uniform(0.4, 1.0, direction[0, place].shape) * SIZES.get(name, 0.3)
        problem.directions.assign(direction[:, None])
        problem.evaluate(x)
        found = problem.residual_directions.numpy()[0, :, 0].copy()
        columns = problem.pose_columns.numpy()[0, :, -1].copy()
        residual, position, turn = rates(difference, lambda t, d=direction: outputs(problem, x, row + t * d), 0.02)
        outputs(problem, x, row)
        check(found, residual, f"residual by {name}")
        check(columns[:3], position, f"position by {name}")
        check(columns[3:], turn, f"rotation by {name}")


def test_directions_without_a_frame(difference):
    """A dead tip force alone is integrated in the body frame: its columns are other code than with a pose asked for."""
    robot = mr.SingleRod(jumps())
    problem = robot.problem(robot.inputs(**TURNED, **TIP, translation=0.03), integrator=GRID, direction_count=1)
    assert problem.features.force_is_state
    x = problem.guess() + [[1.0, -1.5, 0.7]]
    _, gamma = problem.evaluate(x)
    for k in range(3):
        step = np.eye(3)[k]
        check(gamma[0, :, k], difference(lambda t, step=step: problem.evaluate(x + t * step)[0][0], 0.05), f"Gamma[:, {k}]")
    row = problem.inputs.numpy().copy()
    for name in ("rotation", "translation", "tip_force"):
        direction = np.zeros_like(row)
        direction[0, problem.input_slice(name)] = SIZES.get(name, 0.3)
        problem.directions.assign(direction[:, None])
        problem.evaluate(x)
        found = problem.residual_directions.numpy()[0, :, 0].copy()
        expected = difference(lambda t, d=direction: outputs(problem, x, row + t * d)[0], 0.02)
        outputs(problem, x, row)
        check(found, expected, f"residual by {name}")


@pytest.mark.parametrize("name", ["rotation", "tip_force", "tip_moment"])
def test_jacobian_is_the_derivative_of_solutions(name, difference):
    """Whole solves at a residual of 1e-11 1/m, differenced at 1e-3 of an input: 1e-8 is left, and 1e-7 is asked.

    With a tip moment, as both the solve and its derivative then carry the frame: under a tip force alone the solve is
    discretised in the body frame, and the two differ by the grid's own error.
    """
    robot = mr.SingleRod(jumps())
    values = PULLED | {"tip_moment": (0.05, 0.08, -0.04), "translation": 0.03}
    solver = mr.Shooting(tolerance=1e-11, integrator=GRID)
    solution = mr.solve(robot, robot.inputs(**values), solver=solver).raise_if_failed()
    jacobian = solution.jacobian(name)
    size, unit = np.size(values[name]), SIZES.get(name, 0.3)
    assert jacobian.shape == (6, size)
    for k, step in enumerate(unit * np.eye(size)):

        def tip(t, step=step):
            moved = mr.solve(robot, robot.inputs(**values | {name: values[name] + t * step}), solver=solver, guess=solution)
            moved.raise_if_failed()
            return np.zeros(0), moved.tip_position, moved.tip_rotation

        _, position, turn = rates(difference, tip, 0.02)
        expected = np.concatenate([position, turn]) / unit
        np.testing.assert_allclose(jacobian[:, k], expected, rtol=0, atol=1e-7 * np.abs(expected).max())


def test_jacobian_of_a_follower_force_where_none_acts(wire: mr.Rod) -> None:
    robot = mr.SingleRod(wire)
    at_zero = mr.solve(robot, robot.inputs(tip_force=(0.3, 0.2, 0.1)))
    tiny = mr.solve(robot, robot.inputs(tip_force=(0.3, 0.2, 0.1), follower_force=(0, 0, 1e-9)))
    # the tiny force moves the pose by its own size, and both integrations are good to 1e-8
    np.testing.assert_allclose(at_zero.jacobian("follower_force"), tiny.jacobian("follower_force"), rtol=0, atol=1e-6)
