"""Shooting: along the paper's motion, on the natural branch and off it, where it fails, and against SciPy's minimisers."""

import math
import re

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.optimize import brentq
from scipy.special import ellipk

import multirod as mr
from multirod.studies import experiment

INTEGRATOR = mr.RK4(50)
NEWTON = mr.Shooting(integrator=INTEGRATOR)
STOPS = mr.Shooting(integrator=INTEGRATOR, at_fold="stop")
MINIMISERS = ("interior-point", "quasi-newton", "nelder-mead")

EI, LENGTH = 0.02, 0.5
EULER_LOAD = math.pi**2 * EI / (4 * LENGTH**2)


@pytest.fixture(scope="module")
def study() -> experiment.Motion:
    """The paper's motion: 10 s at 200 Hz, 0.4 to 0.5 m of the wire in use."""
    return experiment.motion()


@pytest.fixture(scope="module")
def runs(study: experiment.Motion) -> dict[str, mr.History]:
    """The motion with each predictor."""
    return {
        predictor: mr.simulate(
            study.robot, study.inputs, time=study.time, solver=mr.Shooting(integrator=INTEGRATOR, predictor=predictor)
        )
        for predictor in ("none", "linear", "quadratic", "adaptive")
    }


@pytest.fixture(params=[1.0, 2.0], ids=["isotropic", "anisotropic"])
def column(request: pytest.FixtureRequest) -> mr.SingleRod:
    """A straight upright column that buckles first about x, at ``EULER_LOAD``."""
    return mr.SingleRod(mr.Rod(length=LENGTH, bending_stiffness=(EI, request.param * EI), torsional_stiffness=0.015))


def compression(column: mr.SingleRod, load: object, side: float = 0.0) -> mr.Inputs:
    """A dead load of ``load`` times Euler's, and ``side`` times Euler's across."""
    load = np.asarray(load)
    zero = np.zeros_like(load)
    return column.inputs(tip_force=EULER_LOAD * np.stack([zero, zero + side, -load], axis=-1))


# ---- along a motion ----


def test_paper_motion_converges_in_two_or_three_integrations(runs: dict[str, mr.History]) -> None:
    for history in runs.values():
        assert len(history.status) == 2001
        assert (history.status == mr.Status.CONVERGED).all()
        assert (history.residual <= 1e-9).all()
        assert history.integrations[1:].max() <= 3
    # extrapolation errs by O(dt^3): Newton's one step squares that to below 1e-9
    for predictor in ("quadratic", "adaptive"):
        assert runs[predictor].integrations[3:].max() <= 2
        np.testing.assert_array_equal(runs[predictor].integrations[:3], runs["linear"].integrations[:3])  # two samples are a line


def test_better_predictors_need_fewer_integrations(runs: dict[str, mr.History]) -> None:
    none, linear, quadratic = (runs[name].integrations[1:].mean() for name in ("none", "linear", "quadratic"))
    assert quadratic < linear < none
    assert linear < 2.2  # measured: 2.07; without prediction 3


def test_the_adaptive_predictor_is_as_good_as_the_better_of_two(robot: mr.SingleRod) -> None:
    """Of instances in one batch each takes its own: quadratic extrapolation where forces are smooth, linear where they are held
    for five samples."""
    t = np.arange(100) * 0.01
    smooth, slow = (np.stack([np.sin(rate * t), np.cos(rate * t), 0 * t], axis=-1) for rate in (3.0, 0.3))
    inputs = robot.inputs(tip_force=np.stack([smooth, slow[np.arange(100) // 5 * 5]], axis=1))

    def mean(predictor: str) -> NDArray[np.float64]:
        solver = mr.Shooting(integrator=INTEGRATOR, predictor=predictor)
        history = mr.simulate(robot, inputs, time=t, solver=solver)
        assert (history.status == mr.Status.CONVERGED).all()
        return np.asarray(history.integrations[10:].mean(axis=0))

    linear, quadratic, adaptive = (mean(predictor) for predictor in ("linear", "quadratic", "adaptive"))
    assert quadratic[0] < linear[0]
    assert linear[1] < quadratic[1]
    np.testing.assert_allclose(adaptive, np.minimum(linear, quadratic), atol=0.05)  # four samples of ninety


def test_predictors_lead_to_the_same_equilibria(runs: dict[str, mr.History]) -> None:
    # |dx| <= sqrt(3) |eps| / sigma_min: residuals below 1e-9, sigma_min above 0.29 along this run
    bound = 2 * math.sqrt(3) * 1e-9 / 0.29
    for name in ("linear", "quadratic", "adaptive"):
        assert np.abs(runs[name].unknowns - runs["none"].unknowns).max() < bound


def test_reported_residual_is_that_of_the_unknowns(study: experiment.Motion, runs: dict[str, mr.History]) -> None:
    problem = study.robot.problem(study.inputs, integrator=INTEGRATOR)
    residual, gamma = problem.evaluate(runs["linear"].unknowns)
    np.testing.assert_allclose(np.abs(residual).max(axis=1), runs["linear"].residual, rtol=0, atol=1e-12)
    np.testing.assert_allclose(gamma, runs["linear"].gamma, rtol=0, atol=1e-12)


@pytest.mark.filterwarnings("ignore::multirod.PlausibilityWarning")
def test_a_sample_that_fails_does_not_stop_the_motion(robot: mr.SingleRod) -> None:
    force = np.tile((0, 1.0, 0), (6, 2, 1))
    force[:, :, 0] = np.linspace(0, 0.1, 6)[:, None]
    ordinary = mr.simulate(robot, robot.inputs(tip_force=force), time=np.arange(6) * 0.005, solver=NEWTON)
    force[3, 0] = (0, 1e9, 0)
    disturbed = mr.simulate(robot, robot.inputs(tip_force=force), time=np.arange(6) * 0.005, solver=NEWTON)
    assert mr.Status(int(disturbed.status[3, 0])).failed
    assert np.isnan(disturbed.unknowns[3, 0]).all()
    assert np.isnan(disturbed.tip_position[3, 0]).all()
    ok = np.ones((6, 2), dtype=bool)
    ok[3, 0] = False
    assert (disturbed.status[ok] == mr.Status.CONVERGED).all()
    assert np.array_equal(disturbed.unknowns[:, 1], ordinary.unknowns[:, 1])  # the other instance does not notice
    np.testing.assert_allclose(disturbed.unknowns[4:, 0], ordinary.unknowns[4:, 0], rtol=0, atol=1e-8)


def test_an_instance_that_fails_at_first_does_not_change_the_others(column: mr.SingleRod) -> None:
    loads = np.stack([np.linspace(0.5, 0.6, 5), np.linspace(1.05, 1.25, 5)], axis=1)
    time = np.arange(5) * 0.005
    both = mr.simulate(column, compression(column, loads, 0.01 * (loads < 1)), time=time, solver=STOPS)
    alone = mr.simulate(column, compression(column, loads[:, 0], 0.01), time=time, solver=STOPS)
    assert both.status[0, 1] == mr.Status.BRANCH_END
    assert np.array_equal(both.unknowns[:, 0], alone.unknowns)
    assert np.array_equal(both.integrations[:, 0], alone.integrations)


# ---- which equilibrium ----


@pytest.mark.parametrize("load", [1.05, 2.5, 4.0, 16.0])
def test_natural_branch_of_a_column_ends_at_the_euler_load(column: mr.SingleRod, load: float) -> None:
    solution = mr.solve(column, compression(column, load), solver=STOPS)
    assert solution.status is mr.Status.BRANCH_END
    assert np.isnan(solution.unknowns).all()
    assert solution.integrations < 150  # measured: 60 to 80


@pytest.mark.parametrize("load", [0.5, 0.95, 0.99])
def test_column_stays_straight_below_the_euler_load(column: mr.SingleRod, load: float) -> None:
    solution = mr.solve(column, compression(column, load), solver=NEWTON)
    assert solution.status is mr.Status.CONVERGED
    np.testing.assert_allclose(solution.unknowns, 0, atol=1e-9)  # the tolerance
    np.testing.assert_allclose(solution.tip_position, (0, 0, LENGTH), rtol=0, atol=1e-9)
    # Gamma's bending entry is cos(sqrt(load) pi/2): it vanishes at the Euler load; RK4(50) errs by 1e-7
    assert solution.gamma[0, 0] == pytest.approx(math.cos(math.sqrt(load) * math.pi / 2), abs=1e-6)


def test_guess_selects_the_buckled_branch(column: mr.SingleRod) -> None:
    solution = mr.solve(column, compression(column, 1.2), solver=NEWTON, guess=(3, 0, 0))
    assert solution.status is mr.Status.CONVERGED
    # elastica: P / P_crit = (2 K(m) / pi)^2, base curvature 2 sqrt(m P / EI); RK4(50) errs by 1e-7 of it
    m = brentq(lambda m: (2 * ellipk(m) / math.pi) ** 2 - 1.2, 1e-9, 0.9, xtol=1e-14)
    assert solution.unknowns[0] == pytest.approx(2 * math.sqrt(m * 1.2 * EULER_LOAD / EI), rel=1e-6)
    mirrored = mr.solve(column, compression(column, 1.2), solver=NEWTON, guess=(-3, 0, 0))
    np.testing.assert_allclose(mirrored.unknowns, -solution.unknowns, rtol=0, atol=1e-8)
    straight = mr.solve(column, compression(column, 1.2), solver=NEWTON, guess=(0, 0, 0))
    assert straight.status is mr.Status.CONVERGED
    assert np.array_equal(straight.unknowns, np.zeros(3))


@pytest.mark.parametrize("load", [0.5, 1.5, 4.0])
@pytest.mark.parametrize("side", [1e-3, -1e-3])
def test_a_small_side_force_decides_to_which_side_the_column_bends(column: mr.SingleRod, load: float, side: float) -> None:
    solution = mr.solve(column, compression(column, load, side), solver=NEWTON)
    assert solution.status is mr.Status.CONVERGED
    assert np.sign(solution.tip_position[1]) == np.sign(side)
    assert solution.determinant > 0  # stable: no mode has gone through zero on the way from the unloaded column
    # measured: up to 149, and 272 where Newton's method had to finish each step; without extrapolation along the branch 329
    assert solution.integrations < 300


# Loads on the wire. On the way to the last three a continuation is easily led astray, to another equilibrium that converges
# as well: the smallest singular value falls to 0.07, 0.14 and 0.38, but the path is smooth.
@pytest.mark.parametrize(
    "force",
    [
        (0, 10, 0),
        (-10, 0, 0),
        (0, 0, -5),
        (-3.0711045, 9.3717181, 18.4575968),
        (-1.6293, 5.7839, 11.5297),
        (8.3772, -15.4837, 21.1596),
    ],
    ids=str,
)
def test_natural_branch_is_the_one_that_small_load_steps_follow(robot: mr.SingleRod, force: tuple) -> None:
    solution = mr.solve(robot, robot.inputs(tip_force=force), solver=NEWTON).raise_if_failed()
    load = np.linspace(0, 1, 2001)
    path = mr.simulate(robot, robot.inputs(tip_force=load[:, None] * force), time=load, solver=NEWTON).raise_if_failed()
    # the path is one branch: it moves by a small part of its own length (some 10 1/m) in each step, and no mode vanishes
    assert np.abs(np.diff(path.unknowns, axis=0)).max() < 0.1
    assert path.determinant.min() > 0
    assert path.smallest_singular_value.min() > 0.05
    np.testing.assert_allclose(solution.unknowns, path.unknowns[-1], rtol=0, atol=1e-7)


# ---- where it fails ----


def test_failures_stay_in_their_instance(column: mr.SingleRod) -> None:
    loads = np.array([0.5, 1.05, 0.95, 16.0, 2.5, 0.0])
    solution = mr.solve(column, compression(column, loads), solver=STOPS)
    failed = loads > 1
    assert (solution.status[failed] == mr.Status.BRANCH_END).all()
    assert (solution.status[~failed] == mr.Status.CONVERGED).all()
    shape = solution.rod()
    for values in (solution.unknowns, solution.gamma, solution.tip_position, solution.tip_rotation, shape.position, shape.moment):
        assert np.isnan(values[failed]).all()
        assert np.isfinite(values[~failed]).all()
    for values in (solution.energy, solution.condition, solution.determinant):
        assert np.array_equal(np.isnan(values), failed)
    for k in range(len(loads)):
        alone = mr.solve(column, compression(column, loads[k]), solver=STOPS)
        assert alone.integrations == solution.integrations[k]
        assert np.array_equal(alone.unknowns, solution.unknowns[k], equal_nan=True)


@pytest.mark.parametrize(
    ("options", "guess", "status"),
    [
        ({"max_iterations": 1}, (0, 0, 0), "MAX_ITERATIONS"),
        ({"max_continuation_steps": 1}, None, "MAX_ITERATIONS"),
        ({"tolerance": 1e-300}, None, "STALLED"),
        ({"tolerance": 1e-300}, (14, 5, 0), "STALLED"),
        ({"line_search": False}, (0, 20, 0), "NONFINITE"),
        ({}, (0, 20, 0), "MAX_ITERATIONS|STALLED"),
        ({}, (1e200, 0, 0), "NONFINITE"),
        ({"integrator": mr.RK45(1e-12, 1e-14)}, (1e6, 0, 0), "STEP_LIMIT"),
    ],
    ids=str,
)
def test_failing_solve_ends_with_a_reason(robot: mr.SingleRod, options: dict, guess: object, status: str) -> None:
    solver = mr.Shooting(**{"integrator": INTEGRATOR, **options})
    solution = mr.solve(robot, robot.inputs(tip_force=(0, 10.0, 0)), solver=solver, guess=guess)
    assert re.fullmatch(status, solution.status.name)
    assert solution.status.failed
    assert np.isnan(solution.unknowns).all()
    assert np.isnan(solution.tip_position).all()
    # 14 halvings take the line search to its least damping of 1e-4; without a guess the path
    assert solution.integrations <= (15 * solver.max_iterations if guess is not None else 200)
    with pytest.raises(mr.SolveError, match=f"^({status}) after {solution.iterations} iterations, residual .* 1/m.*: .*"):
        solution.raise_if_failed()


def test_raise_if_failed_counts_and_explains(column: mr.SingleRod) -> None:
    good = mr.solve(column, compression(column, [0.1, 0.5]), solver=STOPS)
    assert good.raise_if_failed() is good
    bad = mr.solve(column, compression(column, [[0.1, 0.5], [2.0, 3.0]]), solver=STOPS)
    with pytest.raises(
        mr.SolveError,
        match=r"^2 of 4 instances failed \(2 BRANCH_END\); the first is 2: BRANCH_END after \d+ iterations, .*give a guess",
    ):
        bad.raise_if_failed()


def test_what_stopped_the_continuation_is_said(robot: mr.SingleRod) -> None:
    solver = mr.Shooting(integrator=INTEGRATOR, max_continuation_steps=1)
    with pytest.raises(mr.SolveError, match="max_continuation_steps"):
        mr.solve(robot, robot.inputs(tip_force=(0, 10.0, 0)), solver=solver).raise_if_failed()


@pytest.mark.parametrize("guess", [(30, 0, 0), (0, 0, 10), (20, 10, 0)], ids=str)
def test_line_search_helps_where_full_steps_diverge(robot: mr.SingleRod, guess: tuple) -> None:
    inputs = robot.inputs(tip_force=(0, 1, 0))
    undamped = mr.solve(robot, inputs, solver=mr.Shooting(integrator=INTEGRATOR, line_search=False), guess=guess)
    damped = mr.solve(robot, inputs, solver=NEWTON, guess=guess)
    assert undamped.status.failed
    assert damped.status is mr.Status.CONVERGED
    np.testing.assert_allclose(damped.unknowns, mr.solve(robot, inputs, solver=NEWTON).unknowns, rtol=0, atol=1e-7)


def test_guess_may_be_a_solution_an_array_or_one_for_all(robot: mr.SingleRod) -> None:
    inputs = robot.inputs(tip_force=[(0, 1, 0), (1, 0, 1)])
    first = mr.solve(robot, inputs, solver=NEWTON)
    for guess in (first, first.unknowns, first.unknowns.tolist()):
        again = mr.solve(robot, inputs, solver=NEWTON, guess=guess)
        assert (again.integrations == 1).all()
        assert (again.iterations == 0).all()
        assert np.array_equal(again.unknowns, first.unknowns)
        assert np.array_equal(again.tip_position, first.tip_position)
    for guess in ((14, 5, 0), [(14, 5, 0)]):
        again = mr.solve(robot, inputs, solver=NEWTON, guess=guess)
        np.testing.assert_allclose(again.unknowns, first.unknowns, rtol=0, atol=1e-8)


def test_a_failed_solution_as_guess_fails_alone(column: mr.SingleRod) -> None:
    inputs = compression(column, [0.5, 2.0])
    again = mr.solve(column, inputs, solver=STOPS, guess=mr.solve(column, inputs, solver=STOPS))
    assert again.status[0] == mr.Status.CONVERGED
    assert mr.Status(again.status[1]).failed


# ---- SciPy's minimisers ----


@pytest.fixture(scope="module")
def short() -> experiment.Motion:
    return experiment.motion(duration=0.1)


@pytest.fixture(scope="module")
def short_newton(short: experiment.Motion) -> mr.History:
    return mr.simulate(short.robot, short.inputs, time=short.time, solver=NEWTON)


@pytest.mark.parametrize("tolerance", [1e-3, 1e-6])
@pytest.mark.parametrize("method", MINIMISERS)
def test_minimisers_agree_with_newton(short: experiment.Motion, short_newton: mr.History, method: str, tolerance: float) -> None:
    solver = mr.ScipyShooting(method=method, tolerance=tolerance, integrator=INTEGRATOR)
    history = mr.simulate(short.robot, short.inputs, time=short.time, solver=solver)
    assert (history.status == mr.Status.CONVERGED).all()
    sigma = short_newton.smallest_singular_value.min()
    # largest entry of the gradient 2 Gamma^T eps below the tolerance: |eps| < sqrt(3)/2 tolerance / sigma; Nelder-Mead's
    # simplex is as small, so its best vertex is as near. Differences of |eps|^2 cost the gradient another 1e-6.
    eps = (0.87 * tolerance + 1e-6) / sigma
    assert np.linalg.norm(history.boundary_residual, axis=-1).max() < eps
    assert np.linalg.norm(history.unknowns - short_newton.unknowns, axis=-1).max() < eps / sigma
    # and no nearer than asked for: the paper's comparison is at the paper's tolerance
    assert np.linalg.norm(history.boundary_residual, axis=-1).max() > 1e-2 * tolerance


@pytest.mark.parametrize(("method", "ratio"), [("interior-point", 0.6), ("quasi-newton", 0.4)])
def test_exact_gradient_saves_integrations(short: experiment.Motion, method: str, ratio: float) -> None:
    mean = {}
    for exact in (False, True):
        solver = mr.ScipyShooting(method=method, exact_gradient=exact, integrator=INTEGRATOR)
        history = mr.simulate(short.robot, short.inputs, time=short.time, solver=solver)
        assert (history.status == mr.Status.CONVERGED).all()
        mean[exact] = history.integrations[1:].mean()
    # a gradient by differences costs one integration for each of the three unknowns; measured: 10 / 21 and 6.1 / 21.4
    assert mean[True] < ratio * mean[False]


def test_integrations_of_a_minimiser_are_counted(robot: mr.SingleRod, monkeypatch: pytest.MonkeyPatch) -> None:
    inputs = robot.inputs(tip_force=(0, 1, 0))
    problem = robot.problem(inputs, integrator=INTEGRATOR)
    calls = []
    integrate = problem.integrate
    monkeypatch.setattr(problem, "integrate", lambda: (calls.append(1), integrate()))
    outcome = mr.ScipyShooting(integrator=INTEGRATOR).solve(problem)
    assert outcome.integrations[0] == len(calls)


@pytest.mark.filterwarnings("ignore::multirod.PlausibilityWarning")
def test_minimiser_takes_each_instance_alone(robot: mr.SingleRod) -> None:
    solver = mr.ScipyShooting(integrator=INTEGRATOR, exact_gradient=True)
    force = np.array([(0, 1.0, 0), (0, 1e9, 0), (1.0, 0, 1.0)])
    batch = mr.solve(robot, robot.inputs(tip_force=force), solver=solver, guess=(14, 5, 0))
    assert batch.status[1] in (mr.Status.NONFINITE, mr.Status.STALLED)
    assert np.isnan(batch.tip_position[1]).all()
    for k in (0, 2):
        alone = mr.solve(robot, robot.inputs(tip_force=force[k]), solver=solver, guess=(14, 5, 0))
        assert alone.status is mr.Status.CONVERGED
        assert np.array_equal(alone.unknowns, batch.unknowns[k])
        assert np.array_equal(alone.tip_position, batch.tip_position[k])
        assert alone.integrations == batch.integrations[k]


def test_minimiser_says_when_the_residual_stays_large(robot: mr.SingleRod) -> None:
    inputs = robot.inputs(tip_force=(0, 3, 0))
    solution = mr.solve(robot, inputs, solver=mr.ScipyShooting(integrator=INTEGRATOR, max_iterations=1))
    assert solution.status is mr.Status.STALLED
    assert solution.residual > 0.1
    assert np.isnan(solution.tip_position).all()
    strict = mr.solve(robot, inputs, solver=mr.ScipyShooting(integrator=INTEGRATOR, max_residual=1e-12))
    assert strict.status is mr.Status.STALLED
