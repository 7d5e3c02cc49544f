"""One robot of a batch of designs: by its index, of a solution, in a file."""

import re

import numpy as np
import pytest

import multirod as mr

FORCES = np.array([(0.1, 0.2, 0.1), (0.0, -0.1, 0.05)])


def _at(x, y):
    """Poses whose origins lie there in their plane."""
    x, y = np.broadcast_arrays(x, y)
    result = np.zeros((*x.shape, 4, 4))
    result[...] = np.eye(4)
    result[..., 0, 3], result[..., 1, 3] = x, y
    return result


def _single():
    lines = [
        mr.Tendon(offset=np.array([[2e-3, 0], [3e-3, 0], [4e-3, 0]])),
        mr.PushRod(offset=(0, 3e-3), axial_stiffness=[1e4, 2e4, 3e4]),
    ]
    bent = [(0.1, (1, 0, 0)), (0.1, [(1, 2, 0), (3, 4, 0), (5, 6, 1)])]
    wire = mr.Rod.wire(
        length=0.2, diameter=[1e-3, 1.2e-3, 1.4e-3], young_modulus=60e9, poisson_ratio=0.3, lines=lines, precurvature=bent
    )
    return mr.SingleRod(wire, base=_at(0.1 * np.arange(3), 0))


def _tubes():
    inner = mr.Rod(
        length=[0.3, 0.31],
        bending_stiffness=[[0.01, 0.02], [0.02, 0.03]],
        torsional_stiffness=[0.01, 0.02],
        precurvature=(5, 0, 0),
    )
    return mr.ConcentricTubes(
        [inner, mr.Rod(length=0.2, bending_stiffness=0.03, torsional_stiffness=0.02, precurvature=(7, 0, 0))]
    )


def _legs():
    angles, radius = np.arange(6) * np.pi / 3, np.array([0.1, 0.12])[:, None]
    leg = mr.Rod.wire(length=0.4, diameter=[1.5e-3, 2e-3], young_modulus=200e9, poisson_ratio=0.3)
    ends = [_at(r * np.cos(angles), r * np.sin(angles)) for r in (radius, 0.6 * radius)]
    return mr.ParallelRods(legs=[leg] * 6, base=ends[0], platform=ends[1])


def _held():
    end = _at(0.05, 0.0)
    end[2, 3] = 0.25
    rod = mr.Rod(length=[0.3, 0.31], bending_stiffness=0.01, torsional_stiffness=0.01)
    return mr.HeldRod(rod, base=_at(np.array([0.0, 0.02]), 0), end=end)


def _network():
    plate = mr.Body("plate", mass=0.1)
    wire = mr.Rod.wire(length=0.3, diameter=[1e-3, 1.5e-3], young_modulus=200e9, poisson_ratio=0.3)
    joints = [mr.Joint(f"leg {k}", "base", to=mr.ground, pose=_at(0.05 * k, 0)) for k in range(3)]
    joints += [mr.Joint(f"leg {k}", "tip", to=plate, pose=_at(np.array([0.045, 0.05]) * k, 0)) for k in range(3)]
    return mr.Network(rods={f"leg {k}": wire for k in range(3)}, bodies=[plate], joints=joints, end_effector=plate)


ROBOTS = {
    "single rod": (_single, {"tip_force": 0.1 * FORCES[0], "tension": (0.5,)}),
    "tubes": (_tubes, {"rotation": (0.3, 1.0)}),
    "legs": (_legs, {"tip_force": FORCES[0]}),
    "held rod": (_held, {}),
    "network": (_network, {"force": {"plate": FORCES[0]}}),
}


@pytest.mark.parametrize("name", ROBOTS)
def test_a_design_is_the_robot_that_it_was_in_the_batch(name, tmp_path):
    """Solved alone it has the same bits, also of what a file keeps of it."""
    make, given = ROBOTS[name]
    robot = make()
    (count,) = robot.batch_shape
    solution = mr.solve(robot, robot.inputs(**given)).raise_if_failed()
    for k, design in enumerate(robot):
        assert design.batch_shape == ()
        alone = mr.solve(design, design.inputs(**given))
        np.testing.assert_array_equal(alone.unknowns, solution[k].unknowns)
        np.testing.assert_array_equal(alone.tip_position, solution[k].tip_position)
    robot[count - 1].save(tmp_path / "last.toml")
    again = mr.load(tmp_path / "last.toml")
    np.testing.assert_array_equal(mr.solve(again, again.inputs(**given)).unknowns, solution[-1].unknowns)


def test_designs_of_some_instances():
    """Axes of designs and of loads, and any index."""
    legs = _legs()
    leg = mr.Rod.wire(length=0.4, diameter=np.array([1.5e-3, 2e-3])[:, None], young_modulus=200e9, poisson_ratio=0.3)
    robot = mr.ParallelRods(legs=[leg] * 6, base=legs.geometry.base[:, None], platform=legs.geometry.platform[:, None])
    solution = mr.solve(robot, robot.inputs(tip_force=FORCES)).raise_if_failed()  # (2, 2)
    for index, shape in (((1, 0), ()), (slice(1, 2), (1, 2)), (([1, 0, 1], [0, 0, 1]), (3,)), ((slice(None), 1), (2,))):
        some = solution[index]
        assert some.robot.batch_shape == shape
        assert some.assembly is robot
        again = mr.solve(some.robot, some.inputs)
        np.testing.assert_array_equal(again.unknowns, some.unknowns)
    assert solution.robot is robot
    assert mr.critical_loads(solution[1, 0].robot, legs[1].inputs(tip_force=(0, 0, -5)))[0].load_factor > 0


def test_errors():
    legs = _legs()
    with pytest.raises(IndexError, match=re.escape("ParallelRods[2] is not allowed: its leading axes are (2,)")):
        legs[2]
    with pytest.raises(IndexError, match="without leading axes to choose from"):
        legs[0][0]
    with pytest.raises(TypeError, match="no leading axes to go along"):
        list(legs[0])
