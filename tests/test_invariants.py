"""What must stay constant along a rod, whatever the numbers are."""

import numpy as np
import pytest

import multirod as mr

TIGHT = mr.Shooting(tolerance=1e-11, integrator=mr.RK45(rtol=1e-12, atol=1e-14))
FORCE = (0.6, -0.4, 0.5)


def world(solution):
    """Shape of the rod, with the force and moment in world components."""
    shape = solution.rod(0)
    n = np.einsum("sij,sj->si", shape.rotation, shape.force)
    m = np.einsum("sij,sj->si", shape.rotation, shape.moment)
    return shape, n, m


@pytest.fixture
def turned(make_pose):
    return make_pose((0.4, -0.7, 1.1), (0.1, -0.2, 0.3))


@pytest.mark.parametrize("shear", [{}, {"shear_stiffness": (8.0, 12.0), "axial_stiffness": 20.0}])
def test_dead_tip_force(shear, turned):
    """n constant; m + p x n constant; and, as nothing depends on s, H = M.u* + M.K^-1 M/2 + N.e3 + N.S^-1 N/2 constant.

    H' = M'.u + N'.v = (M x u + N x v).u + (N x u).v = 0. The integration keeps all to its tolerance of 1e-12 a step;
    1e-10 relative leaves room for a hundred steps.
    """
    K, u_star = np.array([0.05, 0.08, 0.03]), np.array([5.0, -3.0, 2.0])
    rod = mr.Rod(length=0.4, bending_stiffness=(K[0], K[1]), torsional_stiffness=K[2], precurvature=u_star, **shear)
    robot = mr.SingleRod(rod, base=turned)
    shape, n, m = world(mr.solve(robot, robot.inputs(tip_force=FORCE, rotation=0.3), solver=TIGHT).raise_if_failed())
    size = np.linalg.norm(FORCE)
    np.testing.assert_allclose(n, np.broadcast_to(FORCE, n.shape), rtol=0, atol=1e-10 * size)
    momentum = m + np.cross(shape.position, n)
    np.testing.assert_allclose(momentum, np.broadcast_to(momentum[-1], m.shape), rtol=0, atol=1e-10 * size * 0.4)
    np.testing.assert_allclose(m[-1], 0, rtol=0, atol=1e-10 * size * 0.4)
    S = np.array([*shear["shear_stiffness"], shear["axial_stiffness"]]) if shear else np.full(3, np.inf)
    M, N = shape.moment, shape.force
    H = M @ u_star + (M**2 / K).sum(1) / 2 + N[:, 2] + (N**2 / S).sum(1) / 2
    assert np.ptp(N[:, 2]) > 0.1 * size  # the parts of H do vary
    np.testing.assert_allclose(H, H[-1], rtol=0, atol=1e-10 * np.abs(H).max())
    np.testing.assert_allclose(shape.curvature, u_star + M / K, rtol=0, atol=1e-12 * np.abs(shape.curvature).max())
    eye = np.einsum("sji,sjk->sik", shape.rotation, shape.rotation)
    np.testing.assert_allclose(eye, np.broadcast_to(np.eye(3), eye.shape), rtol=0, atol=1e-14)
    np.testing.assert_allclose(np.linalg.det(shape.rotation), 1, rtol=0, atol=1e-14)


def test_energy_is_the_integral_of_its_density():
    """Trapezoids on 2001 nodes: error h^2 relative, below 1e-6."""
    rod = mr.Rod(
        length=0.4,
        bending_stiffness=(0.05, 0.08),
        torsional_stiffness=0.03,
        precurvature=(5, -3, 2),
        shear_stiffness=(8.0, 12.0),
        axial_stiffness=20.0,
    )
    robot = mr.SingleRod(rod)
    solution = mr.solve(robot, robot.inputs(tip_force=FORCE), solver=TIGHT).raise_if_failed()
    shape = solution.rod(0, nodes=2001)
    M, N = shape.moment, shape.force
    density = 0.5 * ((M**2 / [0.05, 0.08, 0.03]).sum(1) + (N**2 / [8.0, 12.0, 20.0]).sum(1))
    assert solution.energy == pytest.approx(np.trapezoid(density, shape.arclength), rel=1e-6)


def test_balance_under_dead_loads(turned):
    """Base force and moment of a rod under all dead loads, by quadrature over its sections.

    The moment of weight is a sum over 4001 nodes by Simpson's rule on each section: 1e-9 relative is left.
    """
    density, g, L = (0.1, 0.4), np.array([1.0, -2.0, 3.0]), 0.4
    common = {"bending_stiffness": (0.05, 0.08), "torsional_stiffness": 0.03, "precurvature": (5, -3, 2)}
    sections = [
        mr.Section(length=0.2, linear_density=rho, shear_stiffness=9.0, axial_stiffness=20.0, **common) for rho in density
    ]
    robot = mr.SingleRod(mr.Rod(sections=sections), base=turned)
    f, l, tip = np.array([0.6, -0.4, 0.9]), np.array([0.06, 0.05, -0.08]), np.array([0.01, 0.03, -0.02])
    inputs = robot.inputs(
        tip_force=FORCE,
        tip_moment=tip,
        gravity=g,
        distributed_force=f,
        distributed_moment=l,
    )
    solution = mr.solve(robot, inputs, solver=TIGHT).raise_if_failed()
    shape = solution.rod(0, nodes=4001)
    p, pull = shape.position, np.array(FORCE)
    np.testing.assert_allclose(turned[:3, :3] @ shape.force[0], pull + L * f + 0.2 * sum(density) * g, rtol=0, atol=1e-9)
    weight_force = np.zeros((4001, 3))
    for half, rho in enumerate(density):
        simpson = np.full(2001, 2.0)
        simpson[1::2] = 4.0
        simpson[[0, -1]] = 1.0
        part = slice(2000 * half, 2000 * half + 2001)
        weight_force[part] += simpson[:, None] * (f + rho * g)
    weight_force *= L / 4000 / 3
    arm = p - turned[:3, 3]
    moment = tip + L * l + np.cross(arm[-1], pull) + np.cross(arm, weight_force).sum(0)
    np.testing.assert_allclose(turned[:3, :3] @ shape.moment[0], moment, rtol=0, atol=1e-9)


# ---- what results say of each rod by itself ----

STIFFNESS, LENGTH = np.array([0.01, 0.01, 0.008]), 0.2
UNEVEN = np.array([0.03, 0.025, 0.02])
INNER, OUTER = np.array([6.0, 2.0, 0.5]), np.array([0.0, 9.0, 0.3])
TURNED = {"rotation": (0.3, 1.2), "tip_force": (0.1, 0.05, 0.0)}


def body(stiffness=STIFFNESS, precurvature=INNER, **properties) -> mr.Rod:
    own = {"bending_stiffness": stiffness[:2], "torsional_stiffness": stiffness[2], "precurvature": precurvature}
    return mr.Rod(**{"length": LENGTH} | own | properties)


def bodies(outer=STIFFNESS, **properties) -> list[mr.Rod]:
    return [body(**properties), body(outer, OUTER, length=0.14)]


SCENES = {
    "rod with tendons": (
        lambda: mr.SingleRod(body(UNEVEN, lines=[mr.Tendon((0.005, 0)), mr.Tendon((0, 0.005))])),
        {"tension": (1.0, 0.5), "tip_force": (0.1, 0.05, 0.0)},
        [UNEVEN],
    ),
    "tubes": (lambda: mr.ConcentricTubes(bodies()), TURNED, [STIFFNESS, STIFFNESS]),
    "tubes with two stiffnesses": (lambda: mr.ConcentricTubes(bodies(UNEVEN)), TURNED, [STIFFNESS, UNEVEN]),
    "tubes with a tendon": (
        lambda: mr.ConcentricTubes(bodies(UNEVEN, lines=[mr.Tendon((0.001, 0))])),
        TURNED | {"tension": 1.0},
        [STIFFNESS, UNEVEN],
    ),
    "side by side": (
        lambda: mr.EccentricTubes(bodies(), offsets=[(0.002, 0), (-0.002, 0.001)]),
        TURNED,
        [STIFFNESS, STIFFNESS],
    ),
}


@pytest.mark.parametrize("name", SCENES)
def test_the_moment_of_each_rod_is_that_of_its_own_strain(name):
    """Whatever it shares its bending with, and carries."""
    make, inputs, stiffnesses = SCENES[name]
    robot = make()
    solution = mr.solve(robot, robot.inputs(**inputs))
    assert solution.status == mr.Status.CONVERGED
    for k, stiffness in enumerate(stiffnesses):
        shape = solution.rod(k)
        strain = shape.curvature - robot.rods[k].sections[0].precurvature
        if name == "side by side":  # by the rod's own arclength, that of the twist by the line's
            strain = strain[:, :2]
        size = strain.shape[1]
        assert np.abs(strain).max(axis=0).min() > 0.01  # all of it does something
        np.testing.assert_allclose(shape.moment[:, :size], stiffness[:size] * strain, atol=1e-12)
