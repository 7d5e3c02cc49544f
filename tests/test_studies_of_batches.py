"""Equilibria and critical loads of batches: of each instance what it is alone."""

import warnings

import numpy as np
import pytest

import multirod as mr

COLUMN = mr.Rod(length=0.5, bending_stiffness=(0.08, 0.02), torsional_stiffness=0.015)
EULER = np.pi**2 * 0.02 / (2 * 0.5) ** 2


def assert_same(found: mr.Solution, alone: mr.Solution) -> None:
    for name in ("unknowns", "status", "index", "potential", "tip_position"):
        np.testing.assert_array_equal(getattr(found, name), getattr(alone, name))


def test_equilibria_of_each_are_those_of_it_alone() -> None:
    robot = mr.SingleRod(COLUMN)
    force = np.zeros((2, 1, 3))
    force[:, 0, 2] = 0.5 * EULER, -1.5 * EULER
    rotation = (0.0, 0.6)
    found = mr.equilibria(robot, robot.inputs(tip_force=force, rotation=rotation))
    assert found.shape == (2, 2)
    assert [own.batch_shape for own in found[:, 0]] == [(1,), (3,)]  # pulled, and pushed beyond where it buckles: to either side
    for (i, j), own in np.ndenumerate(found):
        alone = mr.equilibria(robot, robot.inputs(tip_force=force[i, 0], rotation=rotation[j]))
        assert_same(own, alone)
        assert own.missing == alone.missing == 0


def test_critical_loads_of_each_are_those_of_it_alone() -> None:
    """Of designs too, whose lengths set the tolerance of each."""
    lengths = np.array([0.5, 1.0])
    robot = mr.SingleRod(mr.Rod(length=lengths, bending_stiffness=(0.08, 0.02), torsional_stiffness=0.015))
    pushed = np.array([[0, 0, -1.0], [0, 0, -2.0], [0, 0, -4.0]])[:, None]
    found = mr.critical_loads(robot, robot.inputs(tip_force=pushed))
    assert found.shape == (3, 2)
    for (i, j), own in np.ndenumerate(found):
        one = robot[j]
        (critical,) = mr.critical_loads(one, one.inputs(tip_force=pushed[i, 0]))
        assert own[0].load_factor == critical.load_factor
        assert_same(own[0].solution, critical.solution)
        np.testing.assert_allclose(own[0].load_factor * -pushed[i, 0, 2], np.pi**2 * 0.02 / (2 * lengths[j]) ** 2, rtol=1e-6)


def test_starts_and_guesses_may_be_of_each() -> None:
    robot = mr.SingleRod(COLUMN)
    begin = robot.inputs(tip_force=[(0, 0, 0), (0, 0, -0.1)])
    guess = mr.solve(robot, begin)
    inputs = robot.inputs(tip_force=(0, 0, -1.1))
    for given in (guess, guess.unknowns, None):
        first, second = mr.critical_loads(robot, inputs, start=begin, guess=given)
        np.testing.assert_allclose([1.1 * first[0].load_factor, 0.1 + second[0].load_factor], EULER, rtol=1e-6)


def test_what_fails_is_none_and_named() -> None:
    robot = mr.SingleRod(COLUMN)
    begin = robot.inputs(tip_force=[(0, 0, 0), (0, 0, -1.5 * EULER)])  # the second has buckled: straight it is not stable
    with pytest.warns(mr.IncompleteWarning, match="critical loads of 1 of 2 instances.*None; instance 1: at the start.*UNSTABLE"):
        first, second = mr.critical_loads(robot, robot.inputs(tip_force=(0, 0, -4)), start=begin, guess=(0, 0, 0))
    assert len(first) == 1
    assert second is None


def test_warnings_say_of_which_instance_they_are() -> None:
    robot = mr.SingleRod(COLUMN)
    inputs = robot.inputs(tip_force=[(0, 0, 0.1), (0, 0, -3 * EULER)])
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        found = mr.equilibria(robot, inputs, solver=mr.Shooting(max_integrations=300))
    said = [str(own.message) for own in told]
    assert [text.partition(": the 300")[0] for text in said if "integrations allowed" in text] == ["instance 0", "instance 1"]
    assert all(text.startswith("instance ") for text in said)
    assert None not in list(found)


def test_a_batch_of_none_is_empty_and_one_without_axes_is_as_it_was() -> None:
    robot = mr.SingleRod(COLUMN)
    assert mr.equilibria(robot, robot.inputs(rotation=np.zeros(0))).shape == (0,)
    assert mr.critical_loads(robot, robot.inputs(tip_force=np.zeros((0, 3)))).shape == (0,)
    assert isinstance(mr.equilibria(robot), mr.Solution)


def test_where_nothing_is_raised_the_others_are_found() -> None:
    robot = mr.SingleRod(COLUMN)
    with pytest.warns(mr.IncompleteWarning, match="1 of 3 .* instance 1: nothing is raised"):
        found = mr.critical_loads(robot, robot.inputs(tip_force=[(0, 0, -1), (0, 0, 0), (0, 0, -2)]))
    assert found[1] is None
    np.testing.assert_allclose([found[0][0].load_factor, 2 * found[2][0].load_factor], EULER, rtol=1e-6)


def test_what_does_not_fit_the_batch_is_refused_at_once() -> None:
    robot = mr.SingleRod(COLUMN)
    inputs = robot.inputs(tip_force=[(0, 0, -1), (0, 0, -2), (0, 0, -3)])
    for count in (2, 5):
        many = mr.solve(robot, robot.inputs(tip_force=np.zeros((count, 3))))
        for guess in (many, many.unknowns):
            with pytest.raises(ValueError, match=rf"guess = leading axes \({count},\) .* those of robot and inputs, \(3,\)"):
                mr.critical_loads(robot, inputs, guess=guess)
    with pytest.raises(ValueError, match=r"start = leading axes \(2,\) .* those of robot and inputs, \(3,\)"):
        mr.critical_loads(robot, inputs, start=robot.inputs(tip_force=np.zeros((2, 3))))
