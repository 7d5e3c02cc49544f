"""What estimators, trackers, poses and robots are given by mistake: refused by name, with the value and what is allowed."""

import numpy as np
import pytest

import multirod as mr

WIRE = mr.Rod(length=0.4, bending_stiffness=0.2233, torsional_stiffness=0.0638)
ROBOT = mr.SingleRod(WIRE)
TIP = mr.Pose(position=(0.01, 0, 0.39), sigma=1e-3)


def estimator(**changes):
    return mr.Estimator(**{"robot": ROBOT, "dt": 0.01, "unknown": {"tip_force": mr.Walk(0.3)}, "sensors": TIP, **changes})


@pytest.mark.parametrize(
    ("changes", "error", "message"),
    [
        ({"robot": WIRE}, TypeError, r"robot must be an assembly such as SingleRod\(rod\), not Rod"),
        ({"guess": "straight"}, ValueError, "Estimator.guess = 'straight'"),
        ({"integrator": 50}, TypeError, r"Estimator.integrator = 50 .* such as RK4\(50\), not int"),
    ],
)
def test_what_an_estimator_refuses(changes, error, message):
    with pytest.raises(error, match=message):
        estimator(**changes)


@pytest.mark.parametrize(
    ("said", "message"),
    [
        (0.0, r"measured\[0\], position = 0.0 is not allowed: must have shape"),
        (np.array([0.39]), r"measured\[0\], position = .* must have shape"),
        ((0.01, 0), r"measured\[0\], position = \(0.01, 0\) .* must have shape"),
    ],
)
def test_a_place_is_three_numbers(said, message):
    """One number was taken for all three: a camera's zero was a tip at the origin."""
    with pytest.raises(ValueError, match=message):
        estimator().step([said])


def test_one_nan_is_a_sensor_that_dropped_out():
    live = estimator()._filter.live
    live.put([np.nan])
    assert live.missing.all()
    assert live.counted[0] == 0


@pytest.mark.parametrize("jacobian", [None, 1.0, ("rotation", 2)])
def test_a_tracker_s_jacobian_is_by_names(jacobian):
    with pytest.raises(TypeError, match="Tracker.jacobian = .* must be a list of names"):
        mr.Tracker(ROBOT, jacobian=jacobian)


def test_a_pose_of_another_rod_says_where_along_it():
    """It was taken for one of the end effector."""
    with pytest.raises(ValueError, match="Pose.rod = 'outer' is not allowed: must not be given without at"):
        mr.Pose(position=(0, 0, 0.1), rod="outer", sigma=1e-3)
    assert mr.Pose(position=(0, 0, 0.1), rod=0).rod == 0


def test_a_name_that_several_rods_have_is_none_of_one():
    """The first was taken."""
    twin = mr.Rod(
        length=0.3, bending_stiffness=0.02, torsional_stiffness=0.015, name="twin", lines=[mr.Tendon((0.01, 0), name="t")]
    )
    still = mr.solve(mr.ConcentricTubes([twin, twin]))
    with pytest.raises(ValueError, match=r"rod = 'twin' is not allowed: must be one of the indices \[0, 1\]"):
        still.rod("twin")
    with pytest.raises(ValueError, match=r"line = 't' is not allowed: must be one of the indices \[0, 1\]"):
        still.line("t")
    with pytest.raises(ValueError, match=r"rod = 'twin' is not allowed: must be one of the indices \[0, 1\]"):
        mr.estimate(
            still.robot,
            unknown={"tip_force": mr.Prior(0, sigma=1)},
            measured=mr.Pose(position=(0, 0, 0.1), at=0.1, rod="twin", sigma=1e-3),
        )


def test_one_instance_is_no_batch_to_go_along():
    """It was as empty as a batch of none."""
    several = ROBOT.inputs(tip_force=np.zeros((2, 3)))
    for batch in (several, mr.solve(ROBOT, several)):
        assert [one.batch_shape for one in batch] == [(), ()]
        with pytest.raises(TypeError, match="has no leading axes to go along: it is of one instance"):
            list(batch[0])


def test_an_empty_batch_has_an_empty_estimate():
    none = mr.Pose(position=np.zeros((0, 3)), sigma=1e-3)
    found = mr.estimate(ROBOT, unknown={"tip_force": mr.Prior(0, sigma=1)}, measured=none)
    assert found.value("tip_force").shape == (0, 3)
    assert found.covariance("tip_force").shape == (0, 3, 3)


@pytest.mark.parametrize(
    ("what", "message"),
    [
        (
            lambda: mr.Rod(length=0.4, bending_stiffness=0.2, torsional_stiffness=0.1, inner_diameter=1e-3),
            "without outer_diameter",
        ),
        (lambda: mr.multibackbone(WIRE, [], offsets=[], discs=3), "give one at least"),
        (lambda: mr.multibackbone(WIRE, np.zeros((0, 3)), offsets=[], discs=3), "give one at least"),
    ],
)
def test_arrays_and_numbers_in_the_place_of_others(what, message):
    with pytest.raises((ValueError, TypeError), match=message):
        what()
