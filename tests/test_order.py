"""Order of convergence: a fixed number of equal steps, halved three times, at fixed unknowns."""

from itertools import pairwise

import numpy as np
import pytest

import multirod as mr

FORCE = {"tip_force": (0.8, -0.5, 0.6)}


def bent(s):
    return (14 + 60 * s, 5 * np.cos(9 * s), 20 * s)


def smooth():
    return mr.Rod(length=0.4, bending_stiffness=(0.1, 0.2), torsional_stiffness=0.06, precurvature=(14, 5, 3))


def jumps():
    """Section ends at 0.3 and 0.7 of the length, where stiffness and precurvature jump."""
    first = mr.Section(length=0.12, bending_stiffness=(0.1, 0.2), torsional_stiffness=0.06, precurvature=(14, 5, 3))
    second = mr.Section(length=0.16, bending_stiffness=0.05, torsional_stiffness=0.03, precurvature=(-9, 2, -6))
    third = mr.Section(length=0.12, bending_stiffness=0.15, torsional_stiffness=0.04, precurvature=(6, -12, 0))
    return mr.Rod(sections=[first, second, third])


def varied():
    """A function of arclength in the second of two sections."""
    first = mr.Section(length=0.12, bending_stiffness=(0.1, 0.2), torsional_stiffness=0.06, precurvature=(14, 5, 3))
    second = mr.Section(length=0.28, bending_stiffness=0.05, torsional_stiffness=0.03, precurvature=bent)
    return mr.Rod(sections=[first, second])


def outputs(rod, integrator):
    robot = mr.SingleRod(rod)
    problem = robot.problem(robot.inputs(**FORCE, rotation=0.4), integrator=integrator)
    residual, gamma = problem.evaluate(problem.guess() + [[2.0, -3.0, 1.5]])
    return np.concatenate([residual.ravel(), problem.read("position")[0], problem.read("rotation")[0], gamma.ravel() / 10])


def observed_orders(rod, method, steps):
    """log2 of the ratios of successive differences, so that no exact value enters."""
    values = [outputs(rod, method(steps=steps * 2**k)) for k in range(5)]
    errors = [np.linalg.norm(a - b) for a, b in pairwise(values)]
    assert errors[-1] > 1e-12, "rounding, not truncation: take fewer steps"
    return np.log2(np.divide(errors[:-1], errors[1:]))


# Halved three times. The order is approached like 1 + O(h): the grids are fine enough for 0.1, and for the embedded pairs,
# whose leading coefficients are smaller against the next ones, for 0.2. A wrong weight or a section end inside a step
# leaves order 2 or less.
SCENES = [
    (smooth, mr.RK4, 4, 40, 0.1),
    (jumps, mr.RK4, 4, 40, 0.1),
    (varied, mr.RK4, 4, 40, 0.1),
    (smooth, mr.RK23, 3, 80, 0.2),
    (jumps, mr.RK23, 3, 80, 0.2),
    (smooth, mr.RK45, 5, 30, 0.2),
    (jumps, mr.RK45, 5, 30, 0.2),
]


@pytest.mark.parametrize(("rod", "method", "order", "steps", "bound"), SCENES)
def test_order(rod, method, order, steps, bound):
    orders = observed_orders(rod(), method, steps)
    assert len(orders) == 3
    assert np.abs(orders - order).max() < bound, orders


@pytest.mark.parametrize("fraction", [0.137, 0.61, 0.83])
def test_a_section_end_anywhere_costs_no_order(fraction):
    """Shares of the steps are rounded, but doubling the steps doubles them: halving the step halves every step."""
    stiff = mr.Section(length=0.4 * fraction, bending_stiffness=0.22, torsional_stiffness=0.06, precurvature=(3, 0, 1))
    soft = mr.Section(length=0.4 * (1 - fraction), bending_stiffness=0.1, torsional_stiffness=0.05, precurvature=(14, 5, 0))
    robot = mr.SingleRod(mr.Rod(sections=[stiff, soft]))
    inputs = robot.inputs(tip_force=(0.5, 0.2, 0.3))

    def tip(integrator):
        return mr.solve(robot, inputs, solver=mr.Shooting(tolerance=1e-11, integrator=integrator)).tip_position

    exact = tip(mr.RK45(1e-13, 1e-15))
    errors = [np.linalg.norm(tip(mr.RK4(steps)) - exact) for steps in (25, 50, 100, 200)]
    orders = np.log2(np.array(errors[:-1]) / errors[1:])
    assert ((orders > 3.9) & (orders < 4.1)).all(), orders
