"""Which numbers of inputs tasks choose, by name: of rods that motors drive; checked by solves of what is chosen."""

import pickle

import numpy as np
import pytest
from test_network_rods import at

import multirod as mr
from multirod.tasks.freed import Freed

NITINOL = {"young_modulus": 60e9, "shear_modulus": 23e9}
STEPS = mr.RK4(30)
SOLVER = mr.Shooting(tolerance=1e-11, integrator=STEPS)
HELD = (0.0, 0.0)  # of the backbone, between its discs
PULLED = (-0.0015, 0.001, 0.0005)
WIRE = mr.Rod.wire(length=0.3, diameter=2e-3, **NITINOL)


@pytest.fixture(scope="module")
def robot():
    angles = np.radians([0, 120, 240])
    beside = [mr.Rod.wire(length=0.05, diameter=0.7e-3, extensible=True, **NITINOL)] * 3
    offsets = 0.003 * np.stack([np.cos(angles), np.sin(angles)], axis=1)
    return mr.multibackbone(mr.Rod.wire(length=0.05, diameter=0.9e-3, **NITINOL), beside, offsets=offsets, discs=2)


@pytest.fixture(scope="module")
def start(robot):
    given = robot.inputs(translation={f"rod {k}": q for k, q in enumerate(PULLED)}, force={"disc 2": (0.1, 0.05, 0)})
    return mr.solve(robot, given, solver=SOLVER).raise_if_failed()


@pytest.fixture(scope="module")
def aimed(robot, start):
    """The direction of the tip where the rods are elsewhere."""
    other = robot.inputs(translation=(*HELD, -0.0021, 0.0012, 0.0009), force=start.inputs.force)
    return mr.Pose(axis=mr.solve(robot, other, solver=SOLVER).raise_if_failed().tip_rotation[:, 2])


@pytest.mark.parametrize(
    ("free", "kept"),
    [
        ("translation", [0, 1]),
        ({"translation": None}, [0, 1]),
        ({"translation": ["rod 2", "rod 0"]}, [0, 1, 3]),
        ({"translation": ["backbone 2", "rod 1", "rod 2"]}, [0, 2]),
    ],
)
def test_what_is_not_chosen_stays_to_the_bit(robot, start, aimed, free, kept):
    found = mr.reach(robot, aimed, guess=start, free=free, solver=SOLVER)
    assert found.status.name == "REACHED"
    chosen = np.setdiff1d(range(5), kept)
    np.testing.assert_array_equal(found.inputs.translation[kept], start.inputs.translation[kept])
    assert (found.inputs.translation[chosen] != start.inputs.translation[chosen]).all()
    assert tuple(found.free) == ("translation",)
    assert found.at_limit.shape == chosen.shape
    again = robot.inputs(translation=found.inputs.translation, force=found.inputs.force)
    axis = mr.solve(robot, again, solver=SOLVER).raise_if_failed().tip_rotation[:, 2]
    np.testing.assert_allclose(axis, aimed.axis, rtol=0, atol=2e-7)  # the tolerance of a target, and that of the solve


def test_a_batch_and_scattered_starts_leave_the_rest_alone(robot, start, aimed):
    other = mr.Pose(axis=[start.tip_rotation[:, 2], aimed.axis])
    found = mr.reach(robot, other, guess=start, free="translation", starts=3, solver=SOLVER)
    assert (found.status == mr.Status.REACHED).all()
    np.testing.assert_array_equal(found.inputs.translation[:, :2], np.zeros((2, 2)))
    lost = mr.reach(robot, mr.Pose(position=(0.0, 0.0, 0.2)), guess=start, free="translation", solver=SOLVER)
    assert lost.failed
    np.testing.assert_array_equal(np.isnan(lost.inputs.translation), [False, False, True, True, True])


def test_a_loop_drives_the_rods_that_have_motors(robot, start, aimed):
    loop = mr.Controller(robot, dt=0.01, free="translation", guess=start, integrator=STEPS)
    for _ in range(20):
        command = loop.step(axis=aimed.axis)
    assert command.target_angle < 1e-9
    np.testing.assert_array_equal(command.inputs.translation[:2], HELD)
    np.testing.assert_array_equal(command.last_good.translation, command.inputs.translation)
    reached = mr.reach(robot, aimed, guess=start, free="translation", solver=SOLVER)
    # steps of least size lead there in one way and the other: by how far they go at once
    np.testing.assert_allclose(command.inputs.translation, reached.inputs.translation, rtol=0, atol=2e-5)


def test_limits_by_name(robot, start, aimed):
    limits = mr.Limits(translation={"rod 0": (-0.0016, 0.0)})
    assert repr(limits) == "Limits(translation={'rod 0': (-0.0016, 0.0)})"
    two = {"translation": ["rod 0", "rod 1"]}  # as many as the direction has rows: no others make up for one that is held
    found = mr.reach(robot, aimed, guess=start, free=two, limits=limits, solver=SOLVER)
    assert found.status.name == "AT_LIMIT"
    np.testing.assert_allclose(found.inputs.translation[2], -0.0016, rtol=1e-8)
    assert found.held_by == ("translation['rod 0']",)
    np.testing.assert_array_equal(found.at_limit, [True, False])
    free = mr.reach(robot, aimed, guess=start, free=two, solver=SOLVER)
    assert free.inputs.translation[2] < -0.0016
    more = mr.reach(robot, aimed, guess=start, free="translation", limits=limits, solver=SOLVER)
    assert more.status.name == "REACHED"
    assert more.inputs.translation[2] >= -0.0016


@pytest.mark.parametrize(
    ("free", "limits", "kind", "said"),
    [
        ({"translation": ["rod 9"]}, {}, ValueError, r"free\['translation'\] = 'rod 9' .* must be one of .*'rod 2'"),
        ({"translation": []}, {}, ValueError, "must be names, each once"),
        ({"distributed_force": ["rod 0"]}, {}, ValueError, "the robot takes this input by no names"),
        ({"pull": None}, {}, TypeError, "takes no 'pull'"),
        ("translation", {"rod 9": (0, 1)}, ValueError, r"Limits.translation = 'rod 9' .* one of 'rod 0', 'rod 1', 'rod 2'"),
        ("translation", {"backbone 1": (0, 1e-3)}, ValueError, "must be one of 'rod 0', 'rod 1', 'rod 2'"),
        ("translation", {"rod 0": (1, 2, 3)}, ValueError, r"Limits.translation\['rod 0'\] .* a pair"),
    ],
)
def test_names_that_are_not_there(robot, start, aimed, free, limits, kind, said):
    with pytest.raises(kind, match=said):
        mr.reach(robot, aimed, guess=start, free=free, limits=mr.Limits(translation=limits) if limits else None)


def test_robots_without_names_take_none():
    single = mr.SingleRod(WIRE)
    with pytest.raises(ValueError, match="the robot takes this input by no names"):
        mr.reach(single, mr.Pose(position=(0, 0, 0.3)), free={"tip_force": ["tip"]})
    with pytest.raises(ValueError, match="the robot takes this input by no names"):
        mr.reach(single, mr.Pose(position=(0, 0, 0.3)), free="tip_force", limits=mr.Limits(tip_force={"tip": (0, 1)}))


def test_networks_say_what_is_driven(robot, tmp_path):
    assert robot.driven == ("rod 0", "rod 1", "rod 2")
    robot.save(tmp_path / "robot.toml")
    assert mr.load(tmp_path / "robot.toml").driven == robot.driven
    plate = mr.Body("plate")
    joints = [mr.Joint("leg", "base", to=mr.ground, pose=at(0, 0)), mr.Joint("leg", "tip", to=plate)]
    assert mr.Network(rods={"leg": WIRE}, bodies=[plate], joints=joints).driven is None
    with pytest.raises(ValueError, match="Network.driven = 'lag' .* must be names of rods, of 'leg'; did you mean 'leg'"):
        mr.Network(rods={"leg": WIRE}, bodies=[plate], joints=joints, driven=["lag"])


def test_what_is_chosen_is_told_apart():
    some, others = (Freed(["translation"], {"translation": ("a",)}, {"translation": (k,)}) for k in (0, 1))
    assert some != others
    assert some != ("translation",)
    assert pickle.loads(pickle.dumps(some)) == some
    assert len({some, others, Freed(["translation"], {}, {"translation": (0,)})}) == 2
