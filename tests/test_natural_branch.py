"""Concentric tubes end on their natural branch, or say that it ends: against small steps, elliptic functions and the second variation."""

import numpy as np
import pytest
from benchmarks import natural_branch as study

import multirod as mr
from multirod.solvers.continuation import natural_branch
from multirod.status import Status

SCENES = {"two tubes": 120, "two tubes, tip force": 60, "two tubes, weight": 30, "three tubes": 60, "three tubes, tip force": 40}


@pytest.mark.parametrize("kind", SCENES)
def test_random_scenes_end_where_small_steps_lead(kind):
    found = study.judge(kind, SCENES[kind], seed=100)
    for flag in ("wrong", "unstable", "lost", "undecided", "reference unstable"):
        assert not found[flag].any(), (flag, np.flatnonzero(found[flag]))
    # most reach the end, and some do not: there is something to tell
    assert 0.5 < found["reached"].mean() < 1.0


def equal_tubes(curvature):
    tube = mr.Rod(length=1, bending_stiffness=1, torsional_stiffness=1, precurvature=(curvature, 0, 0))
    return mr.ConcentricTubes([tube, tube])


def pendulum_tip(root, start):
    """Tip angle of theta'' = c sin(theta), theta(0) = start, theta'(L) = 0, on the branch turned from aligned; NaN past its end.

    ``root`` is L sqrt(c). About the tip, where it hangs, theta = pi + 2 asin(k cd(x)): the base angle grows with that of the tip
    until the tubes snap.
    """
    from scipy.optimize import brentq
    from scipy.special import ellipj

    def base(tip):
        k = np.sin((np.pi - tip) / 2)
        _, cn, dn, _ = ellipj(root, k**2)
        return np.pi - 2 * np.arcsin(np.clip(k * cn / dn, -1, 1))

    # the first tip angle that has this base angle
    tips = np.concatenate([np.geomspace(1e-14, 1e-2, 400), np.linspace(1e-2, np.pi, 2000)[1:]])
    bases = np.array([base(tip) for tip in tips])
    above = np.flatnonzero(bases >= start)
    if not len(above):
        return np.nan
    k = int(above[0])
    return brentq(lambda tip: base(tip) - start, tips[k - 1] if k else 0.0, tips[k], xtol=1e-15)


@pytest.mark.parametrize("root", [5.0, 5.5, 6.0, 7.0, 8.0, 10.0])
def test_two_equal_tubes_turned_from_aligned_to_opposite(root):
    """c = x^2 for two equal tubes of unit stiffness and curvature x."""
    robot = equal_tubes(root)
    inputs = robot.inputs(rotation=np.stack([np.zeros(721), np.linspace(0, np.pi, 721)], axis=1))
    problem = robot.problem(inputs, integrator=study.INTEGRATOR)
    newton = mr.Shooting(integrator=study.INTEGRATOR).newton(problem)
    outcome = natural_branch(problem, newton, 1000)
    unknowns = problem.read("unknowns")
    ended = outcome.status == Status.BRANCH_END
    assert (ended | (outcome.status == Status.CONVERGED)).all()
    assert not (study.unstable(problem, unknowns) & ~ended).any()
    truth = study.reference(problem)
    assert truth.agreed.all()
    np.testing.assert_array_equal(ended, truth.level < 1)
    assert study.distant(unknowns, truth.unknowns)[~ended].all()


@pytest.mark.parametrize("root", [5.0, 7.0])
def test_what_a_default_solve_returns_of_two_equal_tubes_is_stable(root):
    robot = equal_tubes(root)
    inputs = robot.inputs(rotation=np.stack([np.zeros(61), np.linspace(0, np.pi, 61)], axis=1))
    solution = mr.solve(robot, inputs)
    assert np.isin(solution.status, (Status.CONVERGED, Status.LOWEST_ENERGY)).all()
    assert (solution.stability == mr.Stability.STABLE).all()
