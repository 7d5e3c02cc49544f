"""Parallel rods: derivatives, joints, equilibrium of the whole robot, reference cases, forward and inverse problem."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import multirod as mr

ROD = mr.Rod(length=0.3, bending_stiffness=(0.02, 0.03), torsional_stiffness=0.015, precurvature=(1.0, 0.4, 0), linear_density=0.05)
SOFT = mr.Rod(
    length=0.32, bending_stiffness=0.02, torsional_stiffness=0.015, shear_stiffness=8.0, axial_stiffness=20.0, linear_density=0.05
)
INNER = mr.Rod(length=0.35, bending_stiffness=0.01, torsional_stiffness=0.008, precurvature=[(0.2, (0, 0, 0)), (0.15, (6, 0, 1))])
OUTER = mr.Rod(length=0.25, bending_stiffness=0.03, torsional_stiffness=0.023, precurvature=(2, 1, 0))


def tubes() -> mr.ConcentricTubes:
    return mr.ConcentricTubes([INNER, OUTER])


def ring(count: int, radius: float, twist: float = 0.0, tilt: float = 0.0) -> np.ndarray:
    """Poses (count, 4, 4) on a circle, turned with it and tilted outwards."""
    poses = np.tile(np.eye(4), (count, 1, 1))
    for k in range(count):
        angle = twist + 2 * np.pi * k / count
        poses[k, :3, :3] = Rotation.from_euler("zy", [angle, tilt]).as_matrix()
        poses[k, :3, 3] = radius * np.array([np.cos(angle), np.sin(angle), 0])
    return poses


def robot(legs, joints="clamped", **options) -> mr.ParallelRods:
    count = len(legs)
    return mr.ParallelRods(
        legs=legs, base=ring(count, 0.06, tilt=0.1), platform=ring(count, 0.03, 0.15, 0.05), joints=joints, **options
    )


LOADS = {
    "tip_force": (0.3, -0.2, -0.4),
    "tip_moment": (0.01, 0.02, -0.01),
    "follower_force": (0.1, 0.05, 0.1),
    "follower_moment": (0.004, -0.003, 0.01),
    "force_point": (0.01, -0.02, 0.03),
    "distributed_force": (0.2, 0.1, -0.3),
    "distributed_moment": (0.01, 0, 0.02),
    "gravity": (0, 1.0, -9.81),
}
HEAVY = {"platform_mass": 0.02, "platform_centre": (0.005, -0.01, 0.02)}
SCENES = {
    "two rods": lambda: robot([ROD, SOFT]),
    "three, every joint": lambda: robot(
        [ROD, SOFT, ROD], ["clamped", "spherical", "revolute"], joint_axes=[(0, 0, 1), (0, 0, 1), (1, 2, 2)], **HEAVY
    ),
    "six rods": lambda: robot([ROD] * 3 + [SOFT] * 3),
    "rod and tubes": lambda: robot([ROD, tubes(), tubes()], ["clamped", "clamped", "revolute"], **HEAVY),
}


def actuation(parallel: mr.ParallelRods, rng: np.random.Generator) -> dict[str, np.ndarray]:
    """Rotations and translations that every leg can take."""
    low, high = parallel.bounds("translation")
    translation = rng.uniform(-0.03, 0.0 if high == 0 else 0.03, len(parallel.rods))
    first = 0
    for leg in parallel.legs:
        count = len(leg.rods) if isinstance(leg, mr.ConcentricTubes) else 1
        translation[first : first + count].sort()  # inner tubes start further back
        first += count
    assert (translation > low).all()
    return {"rotation": rng.uniform(-0.5, 0.5, len(parallel.rods)), "translation": translation}


@pytest.mark.parametrize("scene", SCENES)
def test_gamma_and_directions_are_derivatives(scene, difference):
    rng = np.random.default_rng(1)
    parallel = SCENES[scene]()
    values = LOADS | actuation(parallel, rng)
    names = list(values)
    inputs = parallel.inputs(**values)
    count = len(names)
    problem = parallel.problem(inputs, integrator=mr.RK4(12), pose_sensitivities=True, direction_count=count)
    x = problem.guess() + 0.3 * rng.standard_normal((1, problem.unknown_count))
    steps = {name: rng.standard_normal(np.shape(values[name])) for name in names}
    steps["force_point"] *= 0.1
    steps["translation"] *= 0.01  # so little that no stretch gets another number of steps
    directions = np.zeros(problem.directions.shape)
    for k, name in enumerate(names):
        directions[0, k, problem.input_slice(name)] = steps[name]
    problem.directions.assign(directions)
    gamma = problem.evaluate(x)[1][0]
    by_input = problem.residual_directions.numpy()[0].copy()
    columns = problem.pose_columns.numpy()[0].copy()
    assert np.isfinite(gamma).all()

    def at(y, **changes):
        problem.write("inputs", problem.pack(parallel.inputs(**values | changes)))
        residual = problem.evaluate(y)[0][0]
        return residual, problem.position.numpy()[0].copy(), problem.rotation.numpy()[0].copy()

    R = at(x)[2]

    def all_of(state):
        residual, position, rotation = state
        # rotation matrices differ from R by little: their logarithm to sixth order and beyond
        return np.concatenate([residual, position, Rotation.from_matrix(rotation @ R.T).as_rotvec()])

    n = problem.unknown_count
    expected = np.concatenate([gamma, columns[:, :n]])
    found = np.stack([difference(lambda h, k=k: all_of(at(x + h * np.eye(n)[k])), 1e-2) for k in range(n)], axis=1)
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-8 * max(1, np.abs(expected).max()))
    expected = np.concatenate([by_input, columns[:, n:]])
    found = np.stack([difference(lambda h, s=s: all_of(at(x, **{s: values[s] + h * steps[s]})), 1e-2) for s in names], axis=1)
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-8 * max(1, np.abs(expected).max()))
