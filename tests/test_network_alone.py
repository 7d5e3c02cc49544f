"""A network that is one rod, clamped to the ground and free at its tip: it is solved as that rod by itself."""

import numpy as np
import pytest
from test_network import pose

import multirod as mr

WIRE = mr.Rod(length=0.4, bending_stiffness=0.223349, torsional_stiffness=0.063814, precurvature=(14, 5, 0))
SOLVER = mr.Shooting(tolerance=1e-11, integrator=mr.RK4(50))
FINE = mr.Shooting(tolerance=1e-11, integrator=mr.RK4(400))
GIVEN = {"rotation": 0.3, "translation": 0.01, "distributed_force": (0.2, 0.1, -0.3)}
FORCE, MOMENT = (0.5, -0.3, 0.2), (0.02, 0.01, 0.03)
BASE, FOOT = pose((0.3, -0.2, 0.5), (0.1, 0, 0)), pose((0.1, 0.4, 0), (0.02, 0.03, 0.05))


def network(foot=FOOT, base=BASE, beside=False):
    """One rod that stands at ``foot``; or ``beside`` another that nothing acts on, which makes it a graph."""
    names = ("rod", "other") if beside else ("rod",)
    joints = [mr.Joint(name, "base", to=mr.ground, pose=foot) for name in names]
    return mr.Network(rods=dict.fromkeys(names, WIRE), joints=joints, base=base, end_effector="rod")


@pytest.fixture(scope="module")
def pair():
    """The network and the robot that it is."""
    return network(), mr.SingleRod(WIRE, base=BASE @ FOOT)


def solved(robot, solver=SOLVER, /, **given):
    return mr.solve(robot, robot.inputs(**given), solver=solver).raise_if_failed()


def test_results_and_derivatives_are_those_of_the_rod(pair):
    robot, single = pair
    found = solved(robot, force=FORCE, moment=MOMENT, **GIVEN)
    expected = solved(single, tip_force=FORCE, tip_moment=MOMENT, **GIVEN)
    # the same code on the same numbers
    for name in ("unknowns", "tip_position", "tip_rotation", "energy", "index"):
        np.testing.assert_array_equal(getattr(found, name), getattr(expected, name))
    for name in ("position", "moment", "force"):
        np.testing.assert_array_equal(getattr(found.rod("rod"), name), getattr(expected.rod(0), name))
    names = {"force": "tip_force", "follower_moment": "follower_moment", "rotation": "rotation", "length": "length"}
    for own, other in names.items():
        np.testing.assert_array_equal(found.jacobian(own), expected.jacobian(other))
    np.testing.assert_array_equal(found.stiffness, expected.stiffness)


def test_where_it_stands_is_varied_as_of_any_network(pair, difference):
    """The force at its base is unknown there: by poses of the joint and of the ground against those of a graph, and differences;
    at so many steps that those of both agree."""
    given = {"force": {"rod": FORCE}, "moment": {"rod": MOMENT}, **GIVEN}
    found, other = (solved(robot, FINE, **given) for robot in (pair[0], network(beside=True)))
    assert len(other.unknowns) > len(found.unknowns)
    for name in ("joint_pose", "base"):
        by = other.jacobian(name)[..., :6]
        np.testing.assert_allclose(found.jacobian(name), by, rtol=0, atol=1e-9 * np.abs(by).max())

    def moved(t):
        shift = np.eye(4)
        shift[:3, 3] = 0, t, 0
        return solved(network(foot=FOOT @ pose((t, 0, 0)), base=BASE @ shift), FINE, **given).tip_position

    by_turn = found.jacobian("joint_pose")[:3, 3:] @ FOOT[:3, 0]  # told in the frame of the ground
    by_shift = found.jacobian("base")[:3, :3] @ BASE[:3, 1]  # in the world
    off = difference(moved, 1e-3)
    np.testing.assert_allclose(by_turn + by_shift, off, rtol=0, atol=1e-8 * np.abs(off).max())


def test_what_acts_on_single_rods_acts_beside_what_acts_on_all(pair):
    """In a solve, and in a loop that it comes to later."""
    robot, single = pair
    own = np.array([0.3, -0.1, 0.2])
    both = solved(single, distributed_force=own + GIVEN["distributed_force"])
    found = solved(robot, rod_force={"rod": own}, distributed_force=GIVEN["distributed_force"])
    tracker = mr.Tracker(robot, solver=SOLVER)
    before = tracker.step(distributed_force=GIVEN["distributed_force"])
    alone = solved(single, distributed_force=GIVEN["distributed_force"])
    after = tracker.step(rod_force=own)
    np.testing.assert_array_equal(tracker.inputs.distributed_force, GIVEN["distributed_force"])
    np.testing.assert_array_equal(tracker.inputs.rod_force, own)
    for one, other in ((found, both), (before, alone), (after, both)):
        # 1e-11 that is left of residuals [1/m], over lengths of 0.4 m; forces along both are told in closed form
        np.testing.assert_allclose(one.tip_position, other.tip_position, rtol=0, atol=1e-10)
    by = both.jacobian("distributed_force")
    np.testing.assert_allclose(found.jacobian("rod_force"), by, rtol=0, atol=1e-9 * np.abs(by).max())
    np.testing.assert_allclose(alone.jacobian("distributed_force"), before.jacobian("rod_force"), rtol=0, atol=1e-9)


def test_loops_and_segments_take_it(pair):
    """By the names that it has in the network."""
    robot, single = pair
    trackers = mr.Tracker(robot, solver=SOLVER), mr.Tracker(single, solver=SOLVER)
    for k in range(3):
        one, other = trackers[0].step(force=(0.1 * k, 0.2, 0)), trackers[1].step(tip_force=(0.1 * k, 0.2, 0))
        np.testing.assert_array_equal(one.tip_position, other.tip_position)
    sensor = mr.Pose(position=one.tip_position, sigma=1e-5)
    prior = mr.Prior(0, sigma=0.5)
    said = (robot, "force"), (single, "tip_force")
    forces = [mr.estimate(own, unknown={name: prior}, measured=sensor).value(name) for own, name in said]
    np.testing.assert_array_equal(*forces)
    many = mr.MultipleShooting()
    hard = np.array([3e3, 0, 300]) * 0.2233 / 0.4**2  # which one piece does not take
    cut = [mr.solve(own, own.inputs(**{name: hard}), solver=many).raise_if_failed().unknowns for own, name in said]
    np.testing.assert_array_equal(*cut)


def test_what_a_graph_does_not_know_of_segments_is_not_told():
    """Derivatives by what acts on single rods are told by the graph, which has none."""
    robot = network()
    hard = np.array([300, 0, 30]) * 0.2233 / 0.4**2
    found = solved(robot, mr.MultipleShooting(), force=hard)
    assert found.status is mr.Status.MULTIPLE_SHOOTING
    assert np.isfinite(found.jacobian("force")).all()
    for name in ("rod_force", "joint_pose", "base"):
        assert np.isnan(found.jacobian(name)).all()


def test_what_one_solution_was_asked_is_not_taken_for_another():
    """Derivatives by what acts on single rods are told by a graph, whose problem is kept: its force at the base is of now."""
    robot = network()
    for given in ({"force": FORCE, **GIVEN}, {"force": (0.9, 0.4, -0.7), **GIVEN}):
        kept, anew = (solved(own, **given).jacobian("rod_force") for own in (robot, network()))
        np.testing.assert_array_equal(kept, anew)  # the same code on the same numbers


def test_a_tube_is_read_from_a_file_as_one(tmp_path):
    """A tube that is pushed back twists behind the plate, a rod does not."""
    tube = mr.ConcentricTubes([WIRE])
    robot = mr.Network(rods={"tube": tube}, joints=[mr.Joint("tube", "base", to=mr.ground)], end_effector="tube")
    given = {"translation": -0.1, "force": FORCE, "moment": MOMENT}
    found = solved(robot, **given)
    other = solved(mr.SingleRod(WIRE), translation=-0.1, tip_force=FORCE, tip_moment=MOMENT)
    assert np.linalg.norm(found.tip_position - other.tip_position) > 1e-3  # what a rod would be off by
    found.save(tmp_path / "found.npz")
    robot.save(tmp_path / "robot.toml")
    for again in (mr.load(tmp_path / "found.npz"), solved(mr.load(tmp_path / "robot.toml"), **given)):
        for one, by in ((again.tip_position, found.tip_position), (again.jacobian("force"), found.jacobian("force"))):
            np.testing.assert_array_equal(one, by)
