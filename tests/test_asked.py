"""What is asked of results and inputs that they have not is refused by a message that says what to ask instead."""

import re

import numpy as np
import pytest

import multirod as mr


@pytest.fixture(scope="module")
def robot():
    return mr.SingleRod(mr.Rod(length=0.4, bending_stiffness=0.2233, torsional_stiffness=0.0638))


@pytest.fixture(scope="module")
def one(robot):
    return mr.solve(robot, robot.inputs(tip_force=(0.1, 0, 0)))


@pytest.fixture(scope="module")
def batch(robot):
    return mr.solve(robot, robot.inputs(tip_force=[(0.1, 0, 0), (0.2, 0, 0)]))


def refused(kind, *said):
    return pytest.raises(kind, match=".*".join(map(re.escape, said)))


def test_no_result_is_true_or_false(robot, one, batch):
    motion = mr.simulate(robot, robot.inputs(tip_force=[(0.1, 0, 0), (0.2, 0, 0)]), time=[0.0, 0.1])
    others = (kind.__new__(kind) for kind in (mr.Estimate, mr.Calibration))  # whatever they hold
    for result in (one, batch, motion, *others):
        name = type(result).__name__
        for asked in (bool, lambda own: not own, lambda own: own or None):
            with refused(TypeError, f"{name} is neither true nor false: ask its .failed", ".status", ".raise_if_failed()"):
                asked(result)


def test_what_has_no_instances_to_choose_from_says_so(robot, one):
    for own in (one, one.inputs, robot.inputs()):
        name = type(own).__name__
        with refused(IndexError, f"{name}[0] is not allowed: this {name} is of one instance, without leading axes"):
            own[0]


def test_an_index_beyond_a_batch_names_its_axes(batch):
    for own in (batch, batch.inputs):
        name = type(own).__name__
        with refused(IndexError, f"{name}[5] is not allowed: its leading axes are (2,); index 5 is out of bounds"):
            own[5]
        with refused(IndexError, f"{name}[(0, 0)] is not allowed: its leading axes are (2,); too many indices"):
            own[0, 0]


def test_a_name_is_no_index(one, batch):
    for own, name in ((batch, "tip_position"), (one, "tip_position"), (one.inputs, "tip_force"), (batch.inputs, "tip_force")):
        with refused(IndexError, f"{type(own).__name__}[{name!r}] is not allowed: ", f"asked by name, .{name}"):
            own[name]


def test_indices_of_batches_choose_what_they_did(batch):
    np.testing.assert_array_equal(batch[1].tip_position, batch.tip_position[1])
    np.testing.assert_array_equal(batch[[True, False]].tip_position, batch.tip_position[:1])
    np.testing.assert_array_equal(batch.inputs[::-1].tip_force, batch.inputs.tip_force[::-1])
    assert batch[...].batch_shape == (2,)


def test_shapes_are_not_indexed_their_arrays_are(batch):
    shape = batch.rod(0)
    with refused(TypeError, "Shape[1] is not allowed: index one of its arrays, such as .position, or the solution"):
        shape[1]
    with refused(TypeError, "Shape['position'] is not allowed: what it has is asked by name, .position"):
        shape["position"]
    with pytest.raises(TypeError, match="not iterable"):
        iter(shape)
