"""Inputs of rods and lines that have names, by these."""

import numpy as np
import pytest
from observer_scenes import three_tubes

import multirod as mr
from multirod.by_name import completed
from multirod.read_only import changed

SOLVER = mr.Shooting(integrator=mr.RK4(30))


def pulled(*names, rod=""):
    lines = [mr.Tendon(offset=(0.008 * np.cos(k), 0.008 * np.sin(k)), name=name) for k, name in enumerate(names)]
    return mr.Rod(length=0.2, bending_stiffness=0.01, torsional_stiffness=0.0077, lines=lines, name=rod)


FINGER = mr.SingleRod(pulled("right", "left", rod="finger"))
TUBES = mr.ConcentricTubes(
    [
        mr.Rod(length=length, bending_stiffness=own, torsional_stiffness=own, name=name)
        for name, length, own in (("inner", 0.4, 0.01), ("outer", 0.2, 0.04))
    ]
)


def test_each_number_goes_where_its_name_is():
    np.testing.assert_array_equal(FINGER.inputs(tension={"left": 2.0}).tension, [0.0, 2.0])
    np.testing.assert_array_equal(FINGER.inputs(rotation={"finger": 0.5}).rotation, [0.5])
    turned = TUBES.inputs(rotation={"outer": [0.1, 0.2], "inner": 0.3}, translation={"inner": -0.1})
    np.testing.assert_array_equal(turned.rotation, [[0.3, 0.1], [0.3, 0.2]])
    np.testing.assert_array_equal(turned.translation, [[-0.1, 0.0]] * 2)
    held = mr.HeldRod(pulled("right", "left"))
    np.testing.assert_array_equal(held.inputs(tension={"right": 1.0}).tension, [1.0, 0.0])


def legs(*rods):
    poses = [mr.Pose(position=(0.05 * np.cos(angle), 0.05 * np.sin(angle), 0), rotation=np.eye(3)) for angle in (0, 2, 4)]
    return mr.ParallelRods(legs=rods, base=poses, platform=poses)


def test_lines_without_names_of_their_own_go_by_their_rods():
    robot = legs(pulled("a", "b", rod="first"), pulled("a", rod="second"), pulled(rod="third"))
    np.testing.assert_array_equal(robot.inputs(tension={"first": (1, 2), "second": 3}).tension, [1, 2, 3])
    with pytest.raises(ValueError, match="one of 'first', 'second'$"):
        robot.inputs(tension={"third": 1})
    alike = legs(*[pulled("a", rod="leg")] * 3)
    with pytest.raises(ValueError, match=r"tension = .* shape \(..., 3\): .* each of these lines has a name of its own"):
        alike.inputs(tension={"a": 1})
    with pytest.raises(ValueError, match="each rod has a name of its own"):
        alike.inputs(rotation={"leg": 1})


def test_networks_take_lines_by_their_names_and_by_those_of_rods():
    rods = {name: pulled(f"{name} flexor", f"{name} extensor") for name in ("left", "right")}
    joints = [
        mr.Joint(name, "base", to=mr.ground, pose=mr.Pose(position=(x, 0, 0), rotation=np.eye(3)))
        for name, x in zip(rods, (0, 0.1), strict=True)
    ]
    robot = mr.Network(rods=rods, joints=joints)
    given = robot.inputs(tension={"left extensor": [2.0, 3.0], "right": (4.0, 5.0)})
    np.testing.assert_array_equal(given.tension, [[0, 2, 4, 5], [0, 3, 4, 5]])
    kept = completed(robot, given, {"tension": {"right flexor": 7.0}})
    np.testing.assert_array_equal(robot.inputs(**kept).tension, [[0, 2, 7, 5], [0, 3, 7, 5]])
    with pytest.raises(ValueError, match="tension = 'left' .* beside a line of it, 'left flexor'"):
        robot.inputs(tension={"left flexor": 1, "left": (1, 2)})
    with pytest.raises(ValueError, match="'left', 'right', 'left flexor', .*; did you mean 'left flexor'"):
        robot.inputs(tension={"left flexo": 1})


@pytest.mark.parametrize(
    ("values", "said"),
    [
        ({"tension": {"lift": 1}}, r"tension = 'lift' .* one of 'right', 'left'; did you mean 'left'\?"),
        ({"tension": {0: 1}}, "tension = 0 .* one of 'right', 'left'"),
        ({"tension": {"left": np.nan}}, r"tension\['left'\] = nan"),
        ({"tension": {"left": -1.0}}, "tension = .*-1.0"),
        ({"tension": {"left": [1, 2], "right": [1, 2, 3]}}, "'right' .3,., 'left' .2,. .* broadcast"),
        ({"tip_force": {"x": 1}}, r"tip_force = {'x': 1} .* in their order, shape \(..., 3\)$"),
    ],
)
def test_what_is_not_there_is_refused(values, said):
    with pytest.raises(ValueError, match=said):
        FINGER.inputs(**values)


@pytest.fixture(scope="module")
def start():
    """Three tubes with names, under 0.1 N."""
    robot, motion = three_tubes()
    named = robot.with_rods([changed(rod, name=name) for rod, name in zip(robot.rods, ("inner", "middle", "outer"), strict=True)])
    return mr.solve(named, motion[10], solver=SOLVER).raise_if_failed()


def motion_of(start, **changes):
    """The inputs of the start with others of some."""
    values = {name: getattr(start.inputs, name) for name in start.inputs.given}
    return start.assembly.inputs(**values | completed(start.assembly, start.inputs, changes))


def test_in_a_loop_what_is_not_named_keeps_its_value(start):
    loop = mr.Tracker(start.assembly, solver=SOLVER, inputs=start.inputs, guess=start)
    expected = start.inputs.rotation.copy()
    for name, value in (("outer", expected[2] + 0.01), ("inner", np.float32(0.25))):
        expected[2 if name == "outer" else 0] = value
        np.testing.assert_array_equal(loop.step(rotation={name: value}).inputs.rotation, expected)
    with pytest.raises(ValueError, match="one of 'inner', 'middle', 'outer'"):
        loop.step(rotation={"up": 1})


def test_tasks_choose_and_limit_by_name(start):
    robot, free = start.assembly, {"rotation": ["inner", "outer"]}
    high = start.inputs.rotation[0] + 0.01
    there = mr.solve(robot, motion_of(start, rotation={"inner": 1.0}), guess=start, solver=SOLVER).raise_if_failed()
    aimed = mr.Pose(position=there.tip_position)
    limits = mr.Limits(rotation={"inner": (-1, high)})
    found = mr.reach(robot, aimed, free=free, limits=limits, guess=start, solver=SOLVER)
    np.testing.assert_allclose(found.inputs.rotation[:2], [high, start.inputs.rotation[1]], rtol=1e-8)
    assert found.held_by == ("rotation['inner']",)
    with pytest.raises(ValueError, match="must be one of 'inner', 'outer'"):
        mr.reach(robot, aimed, free=free, limits=mr.Limits(rotation={"middle": (-1, 0)}), guess=start, solver=SOLVER)


def test_tubes_in_each_other_are_pushed_together(start):
    """The place of the one that is not chosen would bound the others: a row (11) without its number says another thing."""
    aimed = mr.Pose(position=start.tip_position)
    said = r"free\['translation'\] = \('inner',\) .* of all tubes .*translation\['middle'\] - translation\['inner'\] >= 0 m"
    with pytest.raises(ValueError, match=said):
        mr.reach(start.assembly, aimed, free={"translation": ["inner"]}, guess=start, solver=SOLVER)
