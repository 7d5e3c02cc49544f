"""Joints of networks whose angles are inputs: against joints that are clamped there, differences, and the work that they do."""

import numpy as np
import pytest
from conftest import rodrigues
from test_network import EXACT, LEG, pose

import multirod as mr

UNIVERSAL = np.array([0.3, -0.4])
SPHERICAL = np.array([0.2, 0.5, -0.3])
LOADS = {"force": {"plate": (0.4, -0.2, -1.0)}, "gravity": (0, 0, -9.81)}
FEET = [(0.08, 0, 0), (-0.05, 0.06, 0), (-0.05, -0.07, 0)]


def turned(kind: str, angle: np.ndarray) -> np.ndarray:
    """(2) What a joint turns by."""
    if kind == "universal":
        return rodrigues((angle[0], 0, 0)) @ rodrigues((0, angle[1], 0))
    return rodrigues((0, angle[0], 0)) if kind == "revolute" else rodrigues(angle)


def platform(driven: dict[str, np.ndarray] | None = None, **more: object) -> mr.Network:
    """Three legs and a plate: a leg on a motor, another in a driven universal joint, and a third whose tip a driven ball holds.

    Args:
        driven: Angles at which these joints are clamped; None makes them joints that are driven.
        more: Of the network.
    """
    plate, joints = mr.Body("plate", mass=0.1), []
    kinds = {"leg 0 base": "revolute", "leg 1 base": "universal", "leg 2 tip": "spherical"}
    for k, foot in enumerate(FEET):
        for end, to in (("base", mr.ground), ("tip", plate)):
            name, there = f"leg {k} {end}", pose(position=foot)
            kind = kinds.get(name, "clamped" if end == "base" else "spherical")
            axis = {"axis": (0, 1, 0)} if kind == "revolute" else {}
            options = {"kind": kind, "driven": name in kinds} | axis
            if driven is not None and name in kinds:
                there[:3, :3], options = turned(kind, driven[name]), {}
            joints.append(mr.Joint(f"leg {k}", end, to=to, pose=there, **options))
    return mr.Network(rods={f"leg {k}": LEG for k in range(3)}, bodies=[plate], joints=joints, **more)


ANGLES = {"leg 0 base": np.array([0.25]), "leg 1 base": UNIVERSAL, "leg 2 tip": SPHERICAL}
ROBOT = platform()


def given(angles: dict[str, np.ndarray] = ANGLES) -> dict[str, object]:
    return {name: own[0] if len(own) == 1 else own for name, own in angles.items()}


@pytest.fixture(scope="module")
def solution() -> mr.Solution:
    return mr.solve(ROBOT, ROBOT.inputs(angle=given(), **LOADS), solver=EXACT)


def test_a_joint_that_is_driven_is_clamped_where_it_is_driven_to(solution):
    clamped = platform(ANGLES)
    expected = mr.solve(clamped, clamped.inputs(**LOADS), solver=EXACT)
    assert ROBOT.driven_joints == ("leg 0 base", "leg 1 base", "leg 2 tip")
    np.testing.assert_allclose(solution.tip_position, expected.tip_position, atol=1e-12)
    np.testing.assert_allclose(solution.tip_rotation, expected.tip_rotation, atol=1e-11)
    np.testing.assert_allclose(solution.energy, expected.energy, rtol=1e-10)
    # the same variables vary: angles that are driven do not
    assert solution.stability is expected.stability is mr.Stability.STABLE
    np.testing.assert_allclose(solution.stability_margin, expected.stability_margin, rtol=1e-8)


def test_derivatives_and_torques_by_angles(solution, difference):
    """The torque that drives a joint is what the potential gains by its angle, and what the rod passes on about its axis."""
    found = solution.jacobian("angle")
    assert found.shape == (6, 6)
    values = solution.inputs.angle

    def at(column: int, step: float) -> mr.Solution:
        moved = np.array(values)
        moved[column] += step
        inputs = ROBOT.inputs(angle=moved, **LOADS)
        return mr.solve(ROBOT, inputs, solver=EXACT, guess=solution)

    for column in range(6):
        by_difference = difference(lambda t, column=column: at(column, t).tip_position, 1e-3)
        # columns and differences of tips that are known to 1e-12
        np.testing.assert_allclose(found[:3, column], by_difference, atol=1e-8)
    gained = float(difference(lambda t: at(0, t).potential, 1e-3))
    motor = solution.rod("leg 0").moment[0] @ (0, 1, 0)  # of the rod on what is below it
    assert abs(gained) > 0.1
    np.testing.assert_allclose(gained, -motor, rtol=1e-6)


def test_a_motor_turns_its_leg_through_a_motion():
    time = np.linspace(0, 1, 21)
    angles = {"leg 0 base": np.sin(2 * np.pi * time)}
    history = mr.simulate(ROBOT, ROBOT.inputs(angle=angles, **LOADS), time=time).raise_if_failed()
    assert np.ptp(history.tip_position[:, 0]) > 0.1
    for k in (5, 15):  # at one radian either way
        alone = mr.solve(ROBOT, ROBOT.inputs(angle={"leg 0 base": angles["leg 0 base"][k]}, **LOADS))
        np.testing.assert_allclose(history.tip_position[k], alone.tip_position, atol=1e-6)


def test_driven_joints_are_kept_in_files(tmp_path, solution):
    ROBOT.save(tmp_path / "robot.toml")
    again = mr.load(tmp_path / "robot.toml")
    assert again.driven_joints == ROBOT.driven_joints
    (tmp_path / "inputs.toml").write_text('kind = "Inputs"\n[angle]\n"leg 0 base" = 0.25\n"leg 1 base" = [0.3, -0.4]\n')
    np.testing.assert_array_equal(mr.load(tmp_path / "inputs.toml", robot=again).angle, [0.25, 0.3, -0.4, 0, 0, 0])
    solution.save(tmp_path / "solution.npz")
    np.testing.assert_array_equal(mr.load(tmp_path / "solution.npz").inputs.angle, solution.inputs.angle)
    assert "driven" in repr(ROBOT.joints[0])


def test_what_cannot_be_driven_is_named():
    for match, made in (
        ("Joint.driven = True is not allowed: .* a clamped joint has no angle", {"kind": "clamped"}),
        ("Joint.stiffness = 0.1 is not allowed: must be 0: the joint is driven", {"kind": "spherical", "stiffness": 0.1}),
        ("Joint.rest = 0.2 is not allowed: must be 0: the joint is driven", {"kind": "revolute", "rest": 0.2}),
        ("Joint.driven = True is not allowed: .* in a hole", {"end": "along", "at": 0.1, "kind": "prismatic"}),
    ):
        with pytest.raises(ValueError, match=match):
            mr.Joint("rod", **{"end": "tip", "to": mr.ground, "driven": True} | made)
    with pytest.raises(TypeError, match="Joint.driven = 1 is not allowed: must be True or False"):
        mr.Joint("rod", "tip", to=mr.ground, kind="spherical", driven=1)
    for match, angle in (
        ("angle = 'leg 0 tip' is not allowed: must be by name, one of 'leg 0 base'.*did you mean", {"leg 0 tip": 0.1}),
        (r"angle\['leg 1 base'\] = 0.1 is not allowed: must have shape", {"leg 1 base": 0.1}),
    ):
        with pytest.raises(ValueError, match=match):
            ROBOT.inputs(angle=angle)
    still = platform(ANGLES)
    with pytest.raises((TypeError, ValueError), match="angle.*no joint is driven"):
        still.inputs(angle={"leg 0 base": 0.1})
