"""What keeps a continuation on its branch, and that each instance goes its own way."""

import numpy as np
import pytest
import warp as wp

import multirod as mr
from multirod.solvers.continuation.acceptance import LARGEST_RATIO, RATIO_POWERS, SMALLEST_RATIO, same_branch
from multirod.solvers.continuation.paths import Paths
from multirod.solvers.newton.iteration import Newton
from multirod.solvers.newton.newton_kernels import NewtonState, make_iteration

N = 4


def spectral_radius(before, after, centre, enough, most):
    """The kernels' bound on the distance of the eigenvalues of ``after before^-1`` from ``centre``."""
    iteration = make_iteration()
    divide, radius = iteration.divide, iteration.radius

    @wp.kernel(module="unique", enable_backward=False)
    def probe(state: NewtonState, bound: wp.array[wp.float64], centre: wp.float64, enough: wp.float64, most: wp.float64):
        t = wp.tid()
        divide(state, t, state.reference)
        bound[t] = radius(state, t, state.reference, 0, centre, enough, most)

    state = NewtonState()
    state.gamma = wp.array(after, dtype=wp.float64)
    state.reference = wp.array(before, dtype=wp.float64)
    state.residual = wp.zeros((len(before), N), dtype=wp.float64)
    state.factor, state.quotient = (wp.zeros((len(before), N, N), dtype=wp.float64) for _ in range(2))
    bound = wp.zeros(len(before), dtype=wp.float64)
    wp.launch(probe, dim=len(before), inputs=[state, bound, centre, enough, most])
    return bound.numpy()


def test_the_bound_holds_all_eigenvalues_and_is_nearly_tight():
    random = np.random.default_rng(0)
    before = random.standard_normal((3000, N, N))
    after = (np.eye(N) + random.uniform(0, 0.8, (3000, 1, 1)) * random.standard_normal((3000, N, N))) @ before
    centre, radius = 0.5 * (SMALLEST_RATIO + LARGEST_RATIO), 0.5 * (LARGEST_RATIO - SMALLEST_RATIO)
    bound = spectral_radius(before, after, centre, 0.0, RATIO_POWERS)
    values = np.linalg.eigvals(after @ np.linalg.inv(before))
    true = np.abs(values - centre).max(axis=1)
    assert (bound >= true * (1 - 1e-9)).all()
    # |A^64|_F^(1/64) exceeds the spectral radius by at most the 64th root of sqrt(n) and of the eigenvectors' condition
    assert (bound <= 1.12 * true).mean() > 0.99
    assert 0.2 < (bound < radius).mean() < 0.95, "all alike: no test of the decision"
    # stopping once it is enough changes no decision
    np.testing.assert_array_equal(spectral_radius(before, after, centre, radius, RATIO_POWERS) < radius, bound < radius)


def test_what_changed_sign_grew_or_is_no_number_is_another_branch():
    before = np.tile(np.random.default_rng(1).standard_normal((N, N)), (9, 1, 1))
    after = before * np.array([4.1, 3.9, 0.24, 0.3, -1, 1, 2, 1, 1])[:, None, None]
    before[7], after[8] = 0, np.nan
    centre, radius = 0.5 * (SMALLEST_RATIO + LARGEST_RATIO), 0.5 * (LARGEST_RATIO - SMALLEST_RATIO)
    found = spectral_radius(before, after, centre, radius, RATIO_POWERS) < radius
    np.testing.assert_array_equal(found, [0, 1, 0, 1, 0, 1, 1, 0, 0])


@pytest.mark.parametrize(
    ("stiffness", "torsion", "precurvature", "force"),
    [((5.8, 12.0), 0.071, (1.5, -0.15, 1.3), (46, -230, 140)), ((20.0, 6.5), 0.1, (2.7, 4.9, -0.83), (140, 45, 18))],
)
def test_a_branch_that_turns_faster_than_its_last_equilibria_tell_does_not_end(stiffness, torsion, precurvature, force):
    rod = mr.Rod(length=1, bending_stiffness=stiffness, torsional_stiffness=torsion, precurvature=precurvature)
    robot = mr.SingleRod(rod)
    found = mr.solve(robot, robot.inputs(tip_force=force), solver=mr.Shooting(fallback=False))
    assert found.status == mr.Status.CONVERGED
    time = np.linspace(0, 1, 2001)
    level = time**3  # in steps so small that the nearest equilibrium is the same branch's
    rising = robot.inputs(tip_force=level[:, None] * np.array(force))
    slow = mr.simulate(robot, rising, time=time, solver=mr.Shooting(predictor="linear", fallback=False))
    slow.raise_if_failed()
    steps = np.linalg.norm(np.diff(slow.tip_position, axis=0), axis=-1)
    assert steps.max() < 0.02, "a jump"
    # both within 1e-9 of the residual, times what cond(Gamma) makes of it
    np.testing.assert_allclose(found.tip_position, slow.tip_position[-1], atol=1e-7)


@pytest.mark.filterwarnings("ignore::multirod.PlausibilityWarning")
def test_steps_that_become_small_where_no_mode_vanishes_are_no_end_of_the_branch():
    rod = mr.Rod(length=0.5, bending_stiffness=0.02, torsional_stiffness=0.013)
    robot = mr.SingleRod(rod)
    pulled = robot.inputs(tip_force=(0, 0, 1e5 * 0.02 / 0.5**2))
    found = mr.solve(robot, pulled, solver=mr.Shooting(fallback=False))
    assert found.status == mr.Status.STALLED  # straight and stable at any tension; Gamma overflows the digits
    pressed = robot.inputs(tip_force=(0, 0, -4 * 0.02 / 0.5**2))
    assert mr.solve(robot, pressed, solver=mr.Shooting(fallback=False, at_fold="stop")).status == mr.Status.BRANCH_END


@pytest.mark.filterwarnings("ignore::multirod.PlausibilityWarning")
@pytest.mark.parametrize("length", [1e-6, 1e-3, 1e3])
def test_the_size_of_a_rod_does_not_matter(length):
    def tip(scale):
        rod = mr.Rod(length=scale, bending_stiffness=0.3, torsional_stiffness=0.2, precurvature=(3 / scale, 0, 0))
        robot = mr.SingleRod(rod)
        found = mr.solve(robot, robot.inputs(tip_force=np.array([3.0, 9.0, 1.0]) / scale**2)).raise_if_failed()
        return found.tip_position / scale

    np.testing.assert_allclose(tip(length), tip(1.0), rtol=0, atol=1e-8)


def test_no_step_jumps_past_an_imperfect_bifurcation():
    """A column with a small side load buckles to that side; the mirror image is stable too, and as near the smaller the load."""
    random = np.random.default_rng(4)
    count = 400
    aside = 10 ** random.uniform(-5, -1, count) * random.choice([-1, 1], count)
    along = random.uniform(2.6, 8, count)
    robot = mr.SingleRod(mr.Rod(length=1, bending_stiffness=(1, 1.5), torsional_stiffness=0.8))
    loads = robot.inputs(tip_force=np.stack([0.3 * np.abs(aside), aside, -along], axis=-1))
    found = mr.solve(robot, loads, solver=mr.Shooting(fallback=False))
    done = found.status == mr.Status.CONVERGED
    assert done.mean() > 0.9
    np.testing.assert_array_equal(np.sign(found.tip_position[done, 1]), np.sign(aside[done]))
    assert (found.stability[done] == mr.Stability.STABLE).all()


def test_on_the_way_equilibria_are_known_to_a_part_of_the_step():
    """Where paths went on from, against the equilibria there: near, but not to the tolerance, which only full loads are worth."""
    random = np.random.default_rng(2)
    count = 400
    force = random.standard_normal((count, 3))
    force *= 30 / np.linalg.norm(force, axis=1, keepdims=True)
    robot = mr.SingleRod(mr.Rod(length=1, bending_stiffness=1.0, torsional_stiffness=0.8, precurvature=(0.5, 0.3, 0)))
    problem = robot.problem(robot.inputs(tip_force=force), integrator=mr.RK4(50))
    newton = Newton(problem, tolerance=None, max_iterations=25, line_search=True)
    paths = Paths(problem, newton, 200)
    outcome = paths.raise_loads(np.ones(count, dtype=bool), problem.mode_bounds())
    assert (outcome.status == mr.Status.CONVERGED).all()
    points, levels, known = (getattr(paths.state, name).numpy().copy() for name in ("points", "levels", "known"))
    passed = (known == 3) & (levels[:, 2] > 0)
    assert passed.sum() > 100
    found = []
    for k in (1, 2):
        problem.write("unknowns", points[:, k])
        with problem.at_load(np.where(passed, levels[:, k], 1.0)):
            newton.run(passed)
        step = np.linalg.norm(points[:, k - 1] - points[:, k], axis=1)
        found.append((np.linalg.norm(points[:, k] - problem.read("unknowns"), axis=1) / step)[passed])
    off = np.array(found)
    # the bound is 1e-3 by the contraction of the last step but one; Newton's last contracts by more than that
    assert off.max() < 1e-4
    assert np.median(off) > 1e-9, "to the tolerance: integrations for nothing"


def test_one_matrix_is_of_a_branch_where_it_is_among_many():
    """The same test, of one Jacobian and of a batch; singular ones among them."""
    random = np.random.default_rng(3)
    before = random.normal(size=(200, 3, 3))
    before[::20, 2] = before[::20, 1]
    gamma = (np.eye(3) + random.uniform(0, 1.5, (200, 1, 1)) * random.normal(size=(200, 3, 3))) @ before
    many = same_branch(gamma, before)
    assert 0.1 < many.mean() < 0.9
    assert [bool(same_branch(gamma[[k]], before[[k]])[0]) for k in range(len(gamma))] == many.tolist()
