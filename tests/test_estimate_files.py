"""Estimates and calibrations that are saved and read back answer all that they did."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from measured_rods import MeasuredRod

import multirod as mr

OF_ESTIMATE = ("misfit", "degrees", "missing", "rejected", "at_limit", "consistent", "status", "integrations", "failed")
OF_CALIBRATION = ("labels", "status", "iterations", "integrations", "misfit", "degrees", "consistent", "failed")


def estimated(robot: mr.SingleRod, kind: str) -> mr.Estimate:
    force = np.array([(0.1, -0.2, 0.05), (0.3, 0.1, 0.0), (-0.2, 0.2, 0.1)])
    position, _, _, _ = MeasuredRod(0.4, 0.223349, 0.063814, (14, 5, 0)).seen(force)
    position += 1e-4
    if kind == "one failed":
        position[1] = 10.0  # farther than the rod is long
    if kind == "of one, some of it missing":
        position = np.array((position[0, 0], np.nan, position[0, 2]))
    prior = mr.Prior() if kind == "without a prior" else mr.Prior(0, sigma=0.25)
    return mr.estimate(robot, unknown={"tip_force": prior}, measured=mr.Pose(position=position, sigma=1e-4), max_iterations=8)


def same(one: Any, other: Any) -> None:
    """Bits, and of what kind."""
    assert type(one) is type(other)
    np.testing.assert_array_equal(one, other)


def read_back(result: Any, folder: Path) -> Any:
    result.save(folder / "it.npz")
    return mr.load(folder / "it.npz")


@pytest.mark.parametrize("kind", ["a batch", "one failed", "of one, some of it missing", "without a prior"])
def test_an_estimate_is_read_back(robot: mr.SingleRod, kind: str, tmp_path: Path) -> None:
    made = estimated(robot, kind)
    assert made.failed.any() == (kind == "one failed")
    found = read_back(made, tmp_path)
    assert type(found) is mr.Estimate
    assert repr(found) == repr(made)
    assert found.unknown == made.unknown
    assert found.dropped == made.dropped
    for name in OF_ESTIMATE:
        same(getattr(found, name), getattr(made, name))
    for name in ("value", "covariance", "sigma", "kept"):
        same(getattr(found, name)("tip_force"), getattr(made, name)("tip_force"))
    for one, other in zip(found.directions("tip_force"), made.directions("tip_force"), strict=True):
        same(one, other)
    same(found.observable["tip_force"], made.observable["tip_force"])
    same(found.solution.tip_position, made.solution.tip_position)
    same(found.solution.inputs.tip_force, made.solution.inputs.tip_force)
    for name in ("bending_stiffness", "torsional_stiffness", "precurvature"):
        same(getattr(found.robot.rod.sections[0], name), getattr(made.robot.rod.sections[0], name))
    # it is as good a prior as it was
    if not made.failed.any() and np.isfinite(made.covariance()).all():
        priors = [mr.Prior(own.value("tip_force"), covariance=own.covariance("tip_force")) for own in (found, made)]
        position = made.solution.tip_position + 1e-4
        again = [
            mr.estimate(robot, unknown={"tip_force": prior}, measured=mr.Pose(position=position, sigma=1e-4)) for prior in priors
        ]
        same(again[0].value("tip_force"), again[1].value("tip_force"))


def test_an_estimate_at_a_limit_is_read_back(tmp_path: Path) -> None:
    """Limits of the robot are kept with it: a tendon does not push, which would bring the tip to one of both sides."""
    rod = mr.Rod(length=0.2, bending_stiffness=0.01, torsional_stiffness=0.008, lines=[mr.Tendon(offset=(0.005, 0.0))])
    side = mr.Pose(position=[(0.01, 0, 0.2), (-0.01, 0, 0.2)], sigma=1e-3)
    made = mr.estimate(mr.SingleRod(rod), unknown={"tension": mr.Prior(0, sigma=1.0)}, measured=side)
    assert sorted(made.at_limit.ravel().tolist()) == [False, True]
    found = read_back(made, tmp_path)
    same(found.at_limit, made.at_limit)
    assert repr(found) == repr(made)


@pytest.mark.parametrize("most", [30, 0])
def test_a_calibration_is_read_back(robot: mr.SingleRod, most: int, tmp_path: Path) -> None:
    force = np.random.default_rng(5).normal(size=(4, 3))
    position, rotation, _, _ = MeasuredRod(0.4, 0.24, 0.06, (14.4, 4.7, 0.15)).seen(force)
    parameters = {("bending_stiffness", "torsional_stiffness"): mr.Prior(sigma=0.3), "precurvature": mr.Prior()}
    measured = mr.Pose(position=position, rotation=rotation, sigma=(1e-3, 1e-2))
    made = mr.calibrate(robot, robot.inputs(tip_force=force), parameters=parameters, measured=measured, max_iterations=most or 1)
    found = read_back(made, tmp_path)
    assert type(found) is mr.Calibration
    assert repr(found) == repr(made)
    assert found.parameters == made.parameters == tuple(parameters)
    for name in OF_CALIBRATION:
        same(getattr(found, name), getattr(made, name))
    same(found.missing, made.missing)
    for key in parameters:
        for name in ("value", "covariance", "sigma"):
            same(getattr(found, name)(key), getattr(made, name)(key))
        same(found.observable[key], made.observable[key])
    same(found.covariance(), made.covariance())
    for name in ("bending_stiffness", "torsional_stiffness", "precurvature"):
        np.testing.assert_array_equal(getattr(found.robot.rod.sections[0], name), getattr(made.robot.rod.sections[0], name))
    same(found.solution.tip_position, made.solution.tip_position)


def test_what_cannot_be_saved_is_refused(robot: mr.SingleRod, tmp_path: Path) -> None:
    made = estimated(robot, "a batch")
    with pytest.raises(ValueError, match=r"save\.path = .*it\.toml.* is not allowed: must end in \.npz"):
        made.save(tmp_path / "it.toml")


def test_what_does_not_hold_together_is_refused(robot: mr.SingleRod, tmp_path: Path) -> None:
    made = estimated(robot, "a batch")
    made.save(tmp_path / "it.npz")
    with np.load(tmp_path / "it.npz") as file:
        arrays = dict(file)
    arrays["mean"] = arrays["mean"][:2]
    np.savez(tmp_path / "other.npz", **arrays)
    with pytest.raises(ValueError, match=r"other\.npz: mean of shape \(2, 3\) is not of 3 numbers of a batch \(3,\)"):
        mr.load(tmp_path / "other.npz")
