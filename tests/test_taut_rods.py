"""Rods under a strong pull: along them differences grow by ``exp(L sqrt(F/EI))``, so that a shape or a judgement by other steps
than those of the solve would be of another rod."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import multirod as mr

PULLS = np.array([60.0, 120.0, 200.0])  # in EI/L^2; a difference grows by 2e3, 6e4 and 1e6 of itself
ASIDE = np.array([0.6, 0.0, 0.8])
NODES = 33  # at which no step of the integrators below ends but a few
CLOSE = 2e-3  # of the length and rad: 20 steps over a boundary layer of L/14 leave 4e-4
CURVED = mr.Rod(length=1.0, bending_stiffness=1.0, torsional_stiffness=0.8, precurvature=(3, 1, 0))
STRAIGHT = mr.Rod(length=1.0, bending_stiffness=1.0, torsional_stiffness=0.8)
SECTIONS = mr.Rod(
    sections=[
        mr.Section(length=0.37, bending_stiffness=1.0, torsional_stiffness=0.8, precurvature=(3, 1, 0)),
        mr.Section(length=0.63, bending_stiffness=1.2, torsional_stiffness=0.8, precurvature=(1, 1, 0)),
    ]
)


def pulled(rod, integrator, pulls=PULLS):
    robot = mr.SingleRod(rod)
    return mr.solve(robot, robot.inputs(tip_force=np.multiply.outer(pulls, ASIDE)), solver=mr.Shooting(integrator=integrator))


def ends_where_the_solve_does(solution, shape, chosen=slice(None)):
    assert np.linalg.norm(shape.position[..., -1, :] - solution.tip_position, axis=-1)[chosen].max() < CLOSE
    turn = shape.rotation[..., -1, :, :] @ np.swapaxes(solution.tip_rotation, -1, -2)
    assert np.atleast_1d(Rotation.from_matrix(turn[chosen]).magnitude()).max() < CLOSE


@pytest.fixture(scope="module")
def fine():
    """By sixteen and forty times as many steps."""
    return {name: pulled(rod, mr.RK4(800)) for name, rod in (("curved", CURVED), ("sections", SECTIONS))}


@pytest.mark.parametrize("steps", [20, 50])
def test_equal_steps(steps, fine):
    solution = pulled(CURVED, mr.RK4(steps))
    assert (solution.status == mr.Status.CONVERGED).all()
    assert (solution.stability == mr.Stability.STABLE).all()
    np.testing.assert_allclose(solution.stability_margin, fine["curved"].stability_margin, rtol=1e-3)
    shape, other = solution.rod(nodes=NODES), fine["curved"].rod(nodes=NODES)
    np.testing.assert_allclose(shape.arclength, np.broadcast_to(np.linspace(0, 1, NODES), (3, NODES)), atol=1e-12)
    ends_where_the_solve_does(solution, shape)
    ends_where_the_solve_does(solution, solution.rod())
    np.testing.assert_allclose(shape.position, other.position, rtol=0, atol=CLOSE)
    # the solve's own steps end at as many nodes: 1e-12 is rounding, grown
    np.testing.assert_allclose(solution.rod().position[..., -1, :], solution.tip_position, rtol=0, atol=1e-9)


def test_curvature_is_that_of_the_elastica():
    """Straight at rest: ``EI u^2/2 + F . t`` is the same all along, and at the tip ``u`` is zero."""
    solution = pulled(STRAIGHT, mr.RK4(60))
    assert (solution.stability == mr.Stability.STABLE).all()
    shape = solution.rod(nodes=NODES)
    level = 0.5 * (shape.curvature**2).sum(axis=-1) + PULLS[:, None] * (shape.rotation[..., 2] @ ASIDE)
    # the boundary layer at the base, u^2 = F, takes four steps or more: 60 leave 1e-4 of it
    np.testing.assert_allclose(level / PULLS[:, None], (shape.rotation[:, -1:, :, 2] @ ASIDE) * np.ones(NODES), atol=3e-4)


def test_sections_do_not_end_where_steps_do(fine):
    """What cannot be brought to end where the solve does is not told, rather than told wrongly."""
    solution = pulled(SECTIONS, mr.RK4(50))
    assert (solution.status == mr.Status.CONVERGED).all()
    assert (solution.stability[:2] == mr.Stability.STABLE).all()
    np.testing.assert_allclose(solution.stability_margin[:2], fine["sections"].stability_margin[:2], rtol=1e-3)
    ends_where_the_solve_does(solution, solution.rod(nodes=NODES), slice(0, 2))
    assert solution.stability[2] in (mr.Stability.STABLE, mr.Stability.UNKNOWN)
    shape = solution.rod(nodes=NODES)
    if not np.isnan(shape.position[2]).all():
        ends_where_the_solve_does(solution, shape, slice(2, 3))


def test_steps_that_errors_choose():
    """By the paper's method at its default: nodes are where steps end too, which the solve has not."""
    solution = pulled(CURVED, mr.RK23(), np.array([10.0, 40.0]))
    ends_where_the_solve_does(solution, solution.rod())
    assert (solution.stability == mr.Stability.STABLE).all()
    fine = pulled(CURVED, mr.RK4(800), np.array([10.0, 40.0]))
    np.testing.assert_allclose(solution.stability_margin, fine.stability_margin, rtol=3e-3)


def test_tubes():
    tubes = [
        mr.Rod(length=length, bending_stiffness=0.5, torsional_stiffness=0.4, precurvature=(1, 1, 0)) for length in (1.0, 0.6)
    ]
    robot = mr.ConcentricTubes(tubes)
    inputs = robot.inputs(rotation=(0, 1.0), tip_force=np.multiply.outer(PULLS[:2], ASIDE))
    solution = mr.solve(robot, inputs, solver=mr.Shooting(integrator=mr.RK4(50)))
    assert (solution.status == mr.Status.CONVERGED).all()
    assert (solution.stability == mr.Stability.STABLE).all()
    ends_where_the_solve_does(solution, solution.rod(0, nodes=NODES))
    coarse = mr.solve(robot, inputs, solver=mr.Shooting(integrator=mr.RK4(20)))
    assert set(coarse.stability) <= {mr.Stability.STABLE, mr.Stability.UNKNOWN}


def test_a_column_of_a_held_rod_pulled():
    """Its end slides and turns freely: no mode of a column is nearer to neutral where it is pulled."""
    robot = mr.HeldRod(STRAIGHT, slide=(0, 0, 1), joint="spherical")
    solver = mr.Shooting(integrator=mr.RK4(30))
    solution = mr.solve(robot, robot.inputs(tip_force=np.multiply.outer(PULLS[:2], (0, 0, 1))), solver=solver)
    assert (solution.status == mr.Status.CONVERGED).all()
    assert (solution.stability == mr.Stability.STABLE).all()
    ends_where_the_solve_does(solution, solution.rod(nodes=NODES))
