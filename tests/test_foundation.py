"""Rods in an elastic medium: the linear beam's solution, an independent integration, the energy, and exact derivatives."""

import numpy as np
import pytest
from exact_columns import check_exact_columns
from scipy.integrate import solve_ivp

import multirod as mr

EI, GJ, LENGTH = 0.01, 0.008, 0.2
STIFFNESS = np.array([EI, 1.5 * EI, GJ])
PRECISE = mr.Shooting(tolerance=1e-10, integrator=mr.RK45(rtol=1e-12, atol=1e-14))
FORCE = np.array([0.5, 0.3, -0.2])


def rod(**properties) -> mr.Rod:
    basic = {"length": LENGTH, "bending_stiffness": STIFFNESS[:2], "torsional_stiffness": GJ, "foundation": 60.0}
    return mr.Rod(**basic | properties)


def curved() -> mr.SingleRod:
    return mr.SingleRod(rod(precurvature=(4.0, -2.0, 1.0), foundation=(60.0, 30.0, 10.0), linear_density=0.2))


def tubes() -> mr.ConcentricTubes:
    outer = rod(length=0.14, bending_stiffness=0.03, torsional_stiffness=0.02, precurvature=(0, 9.0, 0), foundation=100.0)
    return mr.ConcentricTubes([rod(bending_stiffness=EI, precurvature=(6.0, 2.0, 0.5), foundation=20.0), outer])


def load(s):
    return (0.3, 4 * s, -0.2)


SCENES = {
    "rod": (curved, {"tip_force": FORCE, "rotation": 0.3, "translation": 0.01}),
    "rod that shears": (
        lambda: mr.SingleRod(rod(shear_stiffness=40.0, axial_stiffness=90.0)),
        {"tip_force": FORCE, "distributed_force": load, "translation": 0.01},
    ),
    "rod with moments": (curved, {"tip_force": FORCE, "tip_moment": (0.01, 0.02, 0.01), "follower_force": (0.1, 0.2, 0.3)}),
    "tubes": (tubes, {"tip_force": FORCE, "rotation": (0.3, 1.2), "translation": (-0.03, -0.01)}),
}


@pytest.mark.parametrize("stiffness", [1.0, 100.0, 3000.0])
def test_slightly_bent_beam_has_the_deflection_of_hetenyi(stiffness):
    """A cantilever on an elastic foundation under a small force at its tip, ``EI w'''' = -k w``."""
    beam = mr.SingleRod(rod(bending_stiffness=EI, foundation=(stiffness, stiffness, 0)))
    b = (stiffness / (4 * EI)) ** 0.25
    force = 1e-5
    solution = mr.solve(beam, beam.inputs(tip_force=(force, 0, 0)), solver=PRECISE)
    c, ch, s, sh = np.cos(b * LENGTH), np.cosh(b * LENGTH), np.sin(b * LENGTH), np.sinh(b * LENGTH)
    exact = 2 * force * b / stiffness * (ch * sh - c * s) / (ch**2 + c**2)
    np.testing.assert_allclose(solution.tip_position[0], exact, rtol=1e-6)  # the square of the slope is left out


def test_equilibrium_is_that_of_an_independent_integration():
    k = np.array([60.0, 30.0, 10.0])
    u_star = np.array([4.0, -2.0, 1.0])
    robot = curved()
    solution = mr.solve(robot, robot.inputs(tip_force=FORCE, gravity=(0, 3.0, 9.81)), solver=PRECISE)
    weight = 0.2 * np.array([0, 3.0, 9.81])

    def rates(s, y):
        R, m, n = y[3:12].reshape(3, 3), y[12:15], y[15:]
        u = u_star + R.T @ m / STIFFNESS
        spin = np.array([[0, -u[2], u[1]], [u[2], 0, -u[0]], [-u[1], u[0], 0]])
        return np.concatenate([R[:, 2], (R @ spin).ravel(), -np.cross(R[:, 2], n), k * (y[:3] - [0, 0, s]) - weight])

    moment = STIFFNESS * (solution.unknowns[:3] - u_star)
    start = np.concatenate([np.zeros(3), np.eye(3).ravel(), moment, 1.5 * EI / LENGTH * solution.unknowns[3:]])
    end = solve_ivp(rates, (0, LENGTH), start, method="DOP853", rtol=1e-12, atol=1e-14).y[:, -1]
    np.testing.assert_allclose(end[15:], FORCE, atol=1e-8)
    np.testing.assert_allclose(end[12:15], 0, atol=1e-9)
    np.testing.assert_allclose(solution.tip_position, end[:3], atol=1e-10)


@pytest.mark.parametrize("name", ["rod", "rod that shears", "tubes"])
def test_energy_changes_with_the_force_by_the_tip(name):
    make, inputs = SCENES[name]
    robot = make()
    h = 1e-4

    def at(force):
        solution = mr.solve(robot, robot.inputs(**inputs | {"tip_force": force}), solver=PRECISE)
        assert solution.status == mr.Status.CONVERGED
        return solution

    tip = at(FORCE).tip_position
    for k, e in enumerate(np.eye(3)):
        slope = (at(FORCE + h * e).potential - at(FORCE - h * e).potential) / (2 * h)
        np.testing.assert_allclose(slope, -tip[k], atol=1e-7)


@pytest.mark.parametrize("name", SCENES)
def test_gamma_and_input_columns_are_exact(name):
    make, inputs = SCENES[name]
    robot = make()
    check_exact_columns(robot, robot.inputs(**inputs))


def test_a_medium_holds_a_curved_rod_straighter_the_stiffer_it_is():
    tips = []
    for stiffness in (0.0, 10.0, 1e3, 1e5):
        robot = mr.SingleRod(rod(precurvature=(6.0, 0, 0), foundation=stiffness))
        solution = mr.solve(robot)
        assert solution.status == mr.Status.CONVERGED
        tips.append(np.linalg.norm(solution.tip_position - [0, 0, LENGTH]))
    assert tips == sorted(tips, reverse=True)
    assert tips[-1] < 0.05 * tips[0]


def test_a_batch_is_what_each_is_alone_and_single_precision_agrees():
    robot = curved()
    forces = FORCE * np.linspace(-1, 1, 5)[:, None]
    batch = mr.solve(robot, robot.inputs(tip_force=forces))
    alone = mr.solve(robot, robot.inputs(tip_force=forces[1:2]))
    np.testing.assert_array_equal(batch.tip_position[1], alone.tip_position[0])
    single = mr.solve(robot, robot.inputs(tip_force=forces), solver=mr.Shooting(integrator=mr.RK4(50, precision="float32")))
    np.testing.assert_allclose(single.tip_position, batch.tip_position, atol=1e-5 * LENGTH)


def test_tubes_in_a_medium_are_judged():
    """By all their modes, which ``test_medium_stability.py`` holds against an independent energy."""
    robot = tubes()
    solution = mr.solve(robot, robot.inputs(tip_force=FORCE))
    assert solution.stability is mr.Stability.STABLE


def test_bad_values_are_refused():
    with pytest.raises(ValueError, match=r"Rod.foundation = -1.* is not allowed: must be finite and >= 0"):
        rod(foundation=-1.0)


def test_wires_and_tubes_take_it_like_rods():
    made = mr.Rod.wire(length=0.2, diameter=1e-3, young_modulus=60e9, shear_modulus=23e9, foundation=(10, 20, 30))
    np.testing.assert_array_equal(made.sections[0].foundation, (10, 20, 30))
    tube = mr.Rod.tube(length=0.2, outer_diameter=1e-3, inner_diameter=5e-4, young_modulus=60e9, poisson_ratio=0.3, foundation=10)
    np.testing.assert_array_equal(tube.sections[0].foundation, (10, 10, 10))


def test_a_load_that_the_medium_carries_is_plausible():
    """It was warned of as if the rod alone stood against it; what is beyond the medium too still is."""
    soft = {"length": 0.09, "bending_stiffness": 4e-6, "torsional_stiffness": 3e-6}
    robot = mr.SingleRod(mr.Rod(**soft, foundation=2e4))
    robot.inputs(distributed_force=(200, 0, 0))  # warnings are errors here
    with pytest.warns(mr.PlausibilityWarning, match=r"distributed_force = 1e\+08 is"):
        robot.inputs(distributed_force=(1e8, 0, 0))
    with pytest.warns(mr.PlausibilityWarning, match="distributed_force = 200 is"):
        mr.SingleRod(mr.Rod(**soft)).inputs(distributed_force=(200, 0, 0))
