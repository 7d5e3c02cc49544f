"""Gamma eliminated by its pattern, against dense arrays, and the networks that are solved by it."""

import copy
import pickle

import numpy as np
import pytest

import multirod as mr
from multirod.elimination import LANCZOS, Elimination
from multirod.models.network.elements import entries
from multirod.models.network.stability import stability
from multirod.solvers.newton.eliminated import Eliminated

WIRE = mr.Rod.wire(length=0.1, diameter=2e-3, young_modulus=60e9, shear_modulus=23e9, density=6450)


def banded(size, seed=0):
    """A pattern of a band with a full last row and column, and a matrix of it whose diagonal is partly zero."""
    rng = np.random.default_rng(seed)
    row, column = np.indices((size, size))
    there = (np.abs(row - column) < 3) | (row == size - 1) | (column == size - 1)
    dense = np.where(there, rng.standard_normal((size, size)), 0.0)
    dense[: size // 2, : size // 2] *= 1 - np.eye(size // 2)
    return Elimination(np.flatnonzero(there), size), dense


@pytest.mark.parametrize("size", [12, LANCZOS + 10])
def test_a_pattern_holds_a_matrix_and_solves_with_it(size):
    elimination, dense = banded(size)
    numbers = dense.reshape(-1)[elimination.places]
    np.testing.assert_array_equal(elimination.dense(numbers), dense)
    np.testing.assert_array_equal(elimination.places[elimination.index(np.sort(elimination.places))], np.sort(elimination.places))
    sides = np.random.default_rng(1).standard_normal((size, 2))
    # rounding, by the condition of the matrix
    close = 1e-14 * np.linalg.cond(dense)
    np.testing.assert_allclose(elimination.solved(numbers, sides), np.linalg.solve(dense, sides), rtol=close, atol=close)
    least = np.linalg.svd(dense, compute_uv=False)[-1]
    np.testing.assert_allclose(elimination.least_singular_value(numbers), least, rtol=1e-3)  # 1e-4 is asked for


def test_a_singular_matrix_has_no_solution():
    elimination, dense = banded(12)
    dense[3] = 0.0
    numbers = dense.reshape(-1)[elimination.places]
    assert np.isnan(elimination.solved(numbers, np.ones(12))).all()
    assert elimination.least_singular_value(numbers) < 1e-14
    numbers[0] = np.nan
    assert elimination.factors(numbers) is None


def chain(pieces):
    bodies = [mr.Body(f"b{k}", mass=1e-3) for k in range(pieces)]
    joints = [mr.Joint(f"r{k}", "tip", to=bodies[k]) for k in range(pieces)]
    joints += [mr.Joint(f"r{k}", "base", to=bodies[k - 1] if k else mr.ground) for k in range(pieces)]
    robot = mr.Network(rods={f"r{k}": WIRE for k in range(pieces)}, bodies=bodies, joints=joints)
    return robot, robot.inputs(force={f"b{pieces - 1}": (0.4, 0.1, 0)})


def test_eigenvalues_are_bounded_as_those_of_dense_matrices():
    robot, inputs = chain(5)
    problem = robot.problem(inputs, integrator=mr.RK4(10))
    eliminated = Eliminated(problem, problem.elimination, problem.tolerance(None))
    numbers = []
    for level in (0.0, 1.0):
        with problem.at_load(level):
            problem.evaluate(np.full((1, problem.unknown_count), 0.3))
        numbers.append(problem.numbers_of_gamma(np.arange(1))[0])
    first, second = (problem.elimination.dense(own) for own in numbers)
    for centre, change in ((1.0, 0.3), (2.125, -0.4)):
        other = first + change * (second - first) + 0.1 * first
        ratio = first @ np.linalg.inv(other)
        largest = np.abs(np.linalg.eigvals(ratio) - centre).max()
        found = eliminated.radius(numbers[0], other.reshape(-1)[problem.elimination.places], centre, 0.0, 64)
        # powers of the norm come down to the radius, within what four probes of 60 numbers tell of the norm
        assert 0.9 * largest <= found <= 1.2 * largest


@pytest.mark.parametrize("pieces", [4, 5])
def test_a_chain_is_the_same_eliminated_or_whole(monkeypatch, pieces):
    """Rod by rod, as an arrow, and along the graph."""
    robot, inputs = chain(pieces)
    along = pieces == 5
    assert (robot.elimination is not None) is along
    assert bool(robot.problem(inputs, integrator=mr.RK4(10)).arrow) is not along
    solution = mr.solve(robot, inputs).raise_if_failed()
    monkeypatch.setattr(entries, "WHOLE", 1000)
    whole, inputs = chain(pieces)
    assert whole.elimination is None
    assert not whole.problem(inputs, integrator=mr.RK4(10)).arrow
    expected = mr.solve(whole, inputs).raise_if_failed()
    assert solution.integrations == expected.integrations
    np.testing.assert_allclose(
        solution.unknowns, expected.unknowns, rtol=0, atol=1e-9
    )  # the tolerance of both, by Gamma's inverse
    np.testing.assert_allclose(solution.gamma, expected.gamma, rtol=0, atol=1e-8)
    np.testing.assert_allclose(solution.jacobian("force"), expected.jacobian("force"), rtol=1e-7, atol=1e-10)
    assert solution.stability == expected.stability == mr.Stability.STABLE


def test_who_asks_for_gamma_whole_has_it():
    robot, inputs = chain(5)
    problem = robot.problem(inputs, integrator=mr.RK4(10))
    gamma = problem.gamma
    x = np.full((1, problem.unknown_count), 0.1)
    np.testing.assert_array_equal(problem.evaluate(x)[1], gamma.numpy())
    assert problem.records.shape[1] < problem.unknown_count**2


def test_batches_and_trackers_are_eliminated_instance_by_instance():
    robot, inputs = chain(5)
    forces = np.linspace(0.1, 0.4, 3)[:, None] * np.array([1.0, 0.25, 0])
    many = mr.solve(robot, robot.inputs(force={"b4": forces})).raise_if_failed()
    one = mr.solve(robot, inputs).raise_if_failed()
    np.testing.assert_allclose(many.tip_position[2], one.tip_position, rtol=0, atol=1e-10)
    tracker = mr.Tracker(robot)
    for force in forces[::-1]:
        sample = tracker.step(force={"b4": force})
    np.testing.assert_allclose(sample.tip_position, many.tip_position[0], rtol=0, atol=1e-10)


@pytest.mark.parametrize(("push", "expected"), [(0.5, mr.Stability.STABLE), (1.5, mr.Stability.UNSTABLE)])
def test_a_column_of_pieces_is_told_by_the_eigenvalues_next_to_zero(monkeypatch, push, expected):
    """Straight, below and above Euler's load of a column that is clamped at its base."""
    robot, _ = chain(4)
    length = 4 * WIRE.length
    load = np.pi**2 * 60e9 * np.pi * 2e-3**4 / 64 / (4 * length**2)
    problem = robot.problem(robot.inputs(force={"b3": (0, 0, -push * load)}), integrator=mr.RK45())
    x = problem.guess()
    problem.joints.shut()
    for _ in range(4):
        residual, gamma = problem.evaluate(x)
        x = x - np.linalg.solve(gamma[0], residual[0])
    assert np.abs(problem.evaluate(x)[0]).max() < 1e-9
    whole = problem.stability.modes()
    monkeypatch.setattr(stability, "SPARSE", 1)
    sparse = problem.stability.modes()
    assert whole.values.shape[1] > sparse.values.shape[1]
    assert whole.stability == sparse.stability == expected
    for k in range(3):
        np.testing.assert_allclose(sparse.eigenvalue(k), whole.eigenvalue(k), rtol=1e-8, atol=1e-12)


def test_a_long_chain_is_as_stable_as_the_rod_in_one_piece():
    """Its margin does not vanish as pieces become short, in the length of the whole."""
    rod = mr.Rod.wire(length=0.4, diameter=2e-3, young_modulus=60e9, shear_modulus=23e9, density=6450)
    alone = mr.Network(
        rods={"r": rod},
        bodies=[(body := mr.Body("b"))],
        joints=[mr.Joint("r", "base", to=mr.ground), mr.Joint("r", "tip", to=body)],
    )
    whole = mr.solve(alone, alone.inputs(force={"b": (0.4, 0, 0)})).raise_if_failed()
    robot, _ = chain(4)
    pieces = mr.solve(robot, robot.inputs(force={"b3": (0.4, 0, 0)})).raise_if_failed()
    # more bodies make each a smaller part of a mode
    assert 0.2 * whole.stability_margin < pieces.stability_margin < whole.stability_margin


def test_what_is_kept_of_gamma_grows_linearly_with_a_chain():
    counts = [chain(pieces)[0].elimination.count for pieces in (8, 16, 24)]
    assert counts[2] - counts[1] == counts[1] - counts[0] < 8 * 24**2  # an element of each rod at most


def test_a_network_that_was_solved_can_be_copied_and_pickled():
    """SciPy's factors can be neither: they are found again."""
    robot, inputs = chain(8)
    solution = mr.solve(robot, inputs)
    for again in (copy.deepcopy(robot), pickle.loads(pickle.dumps(robot))):
        np.testing.assert_array_equal(mr.solve(again, inputs).unknowns, solution.unknowns)
