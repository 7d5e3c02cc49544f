"""The formulation that all tasks share: freed inputs, rows, and the constrained step."""

from itertools import product
from typing import Any

import numpy as np
import pytest
from conftest import rodrigues
from constrained_step import step

import multirod as mr
from multirod.batch import solved_each
from multirod.rotations import matrices
from multirod.tasks.formulation import Evaluation, Task
from multirod.tasks.freed import freed
from multirod.tasks.rows import Pose

RANDOM = np.random.default_rng(16)


def evaluation(position: Any, rotation: Any) -> Evaluation:
    """Of a pose that is freed itself: six numbers, no unknowns."""
    count = len(position)
    empty = np.zeros((count, 0))
    columns = np.tile(np.eye(6), (count, 1, 1))
    return Evaluation(
        empty,
        np.zeros((count, 0, 0)),
        np.zeros((count, 0, 6)),
        position,
        rotation,
        np.zeros((count, 6, 0)),
        columns,
        np.zeros(count, dtype=bool),
    )


@pytest.mark.parametrize("turned", [1e-6, 0.3, 2.0, 3.0])
@pytest.mark.parametrize("kind", ["rotation", "axis"])
def test_rows_of_a_pose_by_differences(kind, turned):
    """Their derivative by moves and turns of the end effector, at any angle from the target."""
    about = np.cross((0.3, -0.5, 0.8), (1.0, 0.2, -0.4))
    there = rodrigues((0.2, 1.1, -0.4))
    about = about - (about @ there[:, 2]) * there[:, 2]  # across the axis, so that the tilt is the angle
    here = matrices(turned * about[None] / np.linalg.norm(about))[0] @ there
    target = {"rotation": there} if kind == "rotation" else {"axis": 3.0 * there[:, 2]}
    rows = Pose(position=(0.1, 0.2, 0.3), **target).rows(0.5)
    position = np.array([0.12, 0.18, 0.33])
    errors, _, columns = rows.at(evaluation(position[None], here[None]))
    assert errors.shape == (1, 6 if kind == "rotation" else 5)
    np.testing.assert_allclose(errors[0, :3], (position - (0.1, 0.2, 0.3)) / 0.25, rtol=1e-14)
    np.testing.assert_allclose(np.linalg.norm(errors[0, 3:]), turned / 0.5, rtol=1e-9)
    h = 1e-4
    for k in range(6):
        ends = []
        for sign in (1, -1, 2, -2):
            move = np.zeros(6)
            move[k] = sign * h
            moved = evaluation(position[None] + move[:3], matrices(move[None, 3:]) @ here)
            ends.append(rows.at(moved)[0][0])
        slope = (8 * (ends[0] - ends[1]) - (ends[2] - ends[3])) / (12 * h)
        # rounding 1e-16 over h, fourth order of h
        np.testing.assert_allclose(columns[0, :, k], slope, atol=1e-10)


@pytest.mark.parametrize("sight", ["across", "along"])
def test_rows_of_a_part_of_a_position_by_differences(sight):
    """(4b), (4c) beside an axis, of two instances with directions of their own."""
    direction = np.array([[1.0, 0.3, -0.2], [0.0, 0.0, 2.0]])
    unit = direction / np.linalg.norm(direction, axis=1, keepdims=True)
    target: Any = {sight: direction}
    pose = Pose(position=(0.1, 0.2, 0.3), axis=(0, 0.6, 0.8), **target)
    rows, first = pose.rows(0.5, (2,)), {"across": 2, "along": 1}[sight]
    assert pose.count == rows.count == first + 2
    position, frames = RANDOM.normal(size=(2, 3)), matrices(RANDOM.normal(size=(2, 3)))
    errors, _, columns = rows.at(evaluation(position, frames))
    off = position - (0.1, 0.2, 0.3)
    left = (off * unit).sum(axis=1) if sight == "along" else np.linalg.norm(np.cross(off, unit), axis=1)
    if sight == "along":
        np.testing.assert_allclose(errors[:, 0], left / 0.25, rtol=1e-13)
    np.testing.assert_allclose(np.linalg.norm(errors[:, :first], axis=1), np.abs(left) / 0.25, rtol=1e-13)
    h = 1e-5
    for k in range(6):
        move = h * np.eye(6)[[k, k]]
        ends = [rows.at(evaluation(position + s * move[:, :3], matrices(s * move[:, 3:]) @ frames))[0] for s in (1, -1)]
        np.testing.assert_allclose(columns[..., k], (ends[0] - ends[1]) / (2 * h), atol=1e-8)  # second order, rounding over h


def test_the_step_is_that_of_an_enumeration_of_all_working_sets():
    """Each subset of limits as equations: the best one that keeps all limits is the minimum, as the programme is convex."""
    for _ in range(40):
        m, k, c = RANDOM.integers(1, 7), RANDOM.integers(1, 5), RANDOM.integers(1, 5)
        J, r = RANDOM.normal(size=(m, k)), RANDOM.normal(size=m)
        G = RANDOM.normal(size=(c, k))
        low, high = -RANDOM.uniform(0, 0.3, c), RANDOM.uniform(0, 0.3, c)
        softness, weight, pull = 0.3, RANDOM.uniform(0.5, 2, k), RANDOM.normal(size=k)

        def cost(d, J=J, r=r, weight=weight, pull=pull):
            return ((J @ d + r) ** 2).sum() / 0.3 + ((weight * (d - pull)) ** 2).sum()

        best = np.inf
        for sides in product((0, 1, -1), repeat=c):
            on = np.flatnonzero(sides)
            H = J.T @ J / softness + np.diag(weight**2)
            bound = np.where(np.array(sides) > 0, high, low)[on]
            system = np.block([[H, G[on].T], [G[on], np.zeros((len(on), len(on)))]])
            right = np.concatenate([weight**2 * pull - J.T @ r / softness, bound])
            d = np.linalg.lstsq(system, right, rcond=None)[0][:k]
            at = G @ d
            if (at >= low - 1e-10).all() and (at <= high + 1e-10).all():
                best = min(best, cost(d))
        found = step(J[None], r[None], softness=softness, weight=weight, pull=pull, limits=G, low=low[None], high=high[None])
        d = found.change[0]
        assert (G @ d >= low - 1e-9).all()
        assert (G @ d <= high + 1e-9).all()
        np.testing.assert_allclose(cost(d), best, rtol=1e-8)
        assert (found.held[0] * found.multipliers[0] >= 0).all()


def test_limits_are_kept_where_targets_are_far_beyond_them():
    """At the softness of reach, with ranges and differences that depend on each other, as those of tubes do."""
    G = np.concatenate([np.eye(3), [[-1, 1, 0], [0, -1, 1]]])
    for _ in range(50):
        J, r = RANDOM.normal(size=(1, 4, 3)), 10 * RANDOM.normal(size=(1, 4))
        low, high = -RANDOM.uniform(0, 1, (1, 5)), RANDOM.uniform(0, 1, (1, 5))
        found = step(J, r, softness=1e-12, limits=G, low=low, high=high)
        at = G @ found.change[0]
        assert (at >= low[0] - 1e-11).all()
        assert (at <= high[0] + 1e-11).all()
        # no way that is left comes nearer
        slope = J[0].T @ (J[0] @ found.change[0] + r[0])
        for d in RANDOM.normal(size=(100, 3)):
            there = at + 1e-6 * G @ d
            if (there >= low[0]).all() and (there <= high[0]).all():
                assert slope @ d >= -1e-3 * np.abs(slope).max()


def test_a_step_alone_is_that_in_a_batch():
    J, r = RANDOM.normal(size=(20, 3, 4)), RANDOM.normal(size=(20, 3))
    low, high = np.full((20, 4), -0.2), np.full((20, 4), 0.2)
    batch = step(J, r, softness=1e-12, limits=np.eye(4), low=low, high=high)
    for k in range(20):
        alone = step(J[k : k + 1], r[k : k + 1], softness=1e-12, limits=np.eye(4), low=low[:1], high=high[:1])
        np.testing.assert_allclose(batch.change[k], alone.change[0], atol=1e-12)


def test_systems_beside_a_singular_one_are_solved_however_small_they_are():
    matrices = np.stack([1e-150 * np.eye(3), np.zeros((3, 3)), np.diag([1.0, 2.0, np.nan]), np.eye(3)])  # 1e-450 is no number
    solved = solved_each(matrices, np.ones((4, 3, 1)))
    np.testing.assert_array_equal(solved[[0, 3], :, 0], [[1e150] * 3, [1.0] * 3])
    assert np.isnan(solved[1:3]).any(axis=1).all()


def test_what_was_given_as_numbers_is_offered_as_it_was_given(wire):
    inputs = mr.SingleRod(wire).inputs(tip_force=np.ones((2, 3)), rotation=0.1, distributed_force=lambda s: (s, 0, 0))
    arrays = inputs.arrays
    assert {name: array.shape for name, array in arrays.items()} == {"rotation": (1,), "tip_force": (2, 3)}
    arrays.clear()
    assert len(inputs.arrays) == 2


def test_without_limits_a_wide_step_is_the_least_and_a_tall_one_that_of_least_squares():
    J, r = RANDOM.normal(size=(1, 3, 5)), RANDOM.normal(size=(1, 3))
    # rounding over the root of the softness, and softness times the square of the pseudo-inverse
    np.testing.assert_allclose(step(J, r, softness=1e-12).change[0], np.linalg.pinv(J[0]) @ -r[0], atol=1e-9)
    J, r = RANDOM.normal(size=(1, 6, 3)), RANDOM.normal(size=(1, 6))
    np.testing.assert_allclose(step(J, r, softness=1e-12).change[0], np.linalg.pinv(J[0]) @ -r[0], atol=1e-9)


@pytest.mark.parametrize("loads", [{"tip_force": (0.1, 0.2, 0.0)}])
def test_a_task_evaluates_both_with_one_integration_and_eliminates_the_unknowns(wire, loads):
    """``x + a + B dp`` is the equilibrium at other inputs to first order, so what is left there is of second."""
    robot = mr.SingleRod(wire)
    inputs = robot.inputs(rotation=[0.1, 0.3], **loads)
    task = Task.of(robot, inputs, ("tip_force", "rotation"), integrator=mr.RK4(50))
    solution = mr.solve(robot, inputs, solver=mr.Shooting(integrator=mr.RK4(50)))
    x, p = task.problem.adopt(solution.unknowns), task.values()
    np.testing.assert_array_equal(p[:, :3], np.broadcast_to(loads["tip_force"], (2, 3)))
    found = task.evaluate(x, p)
    # the kernel with all columns rounds its steps to nodes: 3e-9 m of RK4(50)'s own error
    np.testing.assert_allclose(found.position, solution.tip_position, atol=1e-8)
    rows = Pose(position=(0.1, 0.0, 0.2)).rows(0.4)
    _, J = found.condensed(*rows.at(found))
    J_solution = solution.jacobian("tip_force", "rotation")[:, :3] / 0.4**2
    np.testing.assert_allclose(J, J_solution, atol=1e-9 * np.abs(J).max())
    left = []
    for size in (1e-2, 5e-3):
        dp = size * np.array([1.0, -0.5, 0.3, 0.7])
        towards, by = found.eliminated
        left.append(np.abs(task.evaluate(x + towards + by @ dp, p + dp).residual).max())
    assert 3.5 < left[0] / left[1] < 4.5
    # one alone, the other as it was
    part = task.evaluate(x, p + 0.01, np.array([False, True]))
    assert part.residual.shape == (1, 3)


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({}, "Pose needs a position, a rotation or an axis"),
        ({"rotation": np.eye(3), "axis": (0, 0, 1)}, "Pose.axis .* must not be given beside rotation"),
        ({"rotation": np.diag([1.0, 1.0, -1.0])}, "(?s)Pose.rotation .* must be a rotation: its determinant is -1"),
        ({"axis": (0, 0, 0)}, "Pose.axis .* must not be zero"),
        ({"position": (0, 0)}, "Pose.position .* shape"),
        ({"position": (0, 0, np.inf)}, "Pose.position .* must be finite"),
        ({"position": (0, 0, 1), "sigma": 0.0}, "Pose.sigma .* must be finite and > 0"),
        ({"position": (0, 0, 1), "rotation": np.eye(3), "sigma": 0.1}, "Pose.sigma .* must be a pair"),
        ({"position": (0, 0, 1), "sigma": (1e-3, 1e-2)}, "Pose.sigma .* must be one number: of the position"),
        ({"rotation": np.eye(3), "sigma": (1e-3, 1e-2)}, "Pose.sigma .* must be one number: of the angles"),
        ({"position": np.zeros((2, 3)), "axis": np.ones((3, 3))}, "leading axes .* must broadcast"),
    ],
)
def test_poses_that_are_refused(given, message):
    with pytest.raises(ValueError, match=message):
        Pose(**given)


def test_a_measurement_may_lack_numbers():
    rows = Pose(position=[(0, 0, 0.1), (np.nan, 0, 0)], rotation=np.eye(3))
    assert rows.complete.tolist() == [True, False]


@pytest.mark.parametrize(
    ("free", "error", "message"),
    [
        ("tip_fource", TypeError, "takes no 'tip_fource'"),
        ((), ValueError, "must name one input or several"),
        (("rotation", "rotation"), ValueError, "each once"),
        (("tip_curvature",), ValueError, "tip_curvature is a measurement"),
        (3, TypeError, "must be names of inputs"),
    ],
)
def test_freed_inputs_that_are_refused(wire, free, error, message):
    with pytest.raises(error, match=message):
        freed("reach(free)", mr.SingleRod(wire), free)
