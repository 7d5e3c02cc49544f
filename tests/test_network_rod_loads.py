"""Loads along single rods of networks: against a single rod, loads along all rods, and differences."""

import numpy as np
import pytest
from test_check_assembly import check_assembly
from test_network import EXACT, GIVEN, mixed, pose
from test_sliding import GIVEN as SLIDING
from test_sliding import threaded

import multirod as mr

NAMES = {"rod_force": "distributed_force", "rod_moment": "distributed_moment"}
LOADS = {"rod_force": (0.5, 0.2, -0.1), "rod_moment": (0.01, -0.02, 0.03)}


def test_one_of_two_rods_is_a_single_rod(wire):
    """What acts along it, told in the world, on a ground that is turned; the other one is as it was."""
    base = pose((0.3, -0.2, 0.5), (0.1, 0, 0))
    single = mr.SingleRod(wire, base=base)
    expected = mr.solve(single, single.inputs(**{NAMES[k]: v for k, v in LOADS.items()}), solver=EXACT)
    joints = [mr.Joint(name, "base", to=mr.ground) for name in ("other", "wire")]
    robot = mr.Network(rods={"other": wire, "wire": wire}, joints=joints, base=base, end_effector="wire")
    found = mr.solve(robot, robot.inputs(**{k: {"wire": v} for k, v in LOADS.items()}), solver=EXACT)
    # the same steps, by sums of other numbers
    np.testing.assert_allclose(found.raise_if_failed().tip_position, expected.tip_position, rtol=0, atol=1e-10)
    rest = mr.solve(single, single.inputs(), solver=EXACT)
    np.testing.assert_allclose(found.rod("other").position, rest.rod(0).position, rtol=0, atol=1e-10)
    for name, other in NAMES.items():
        by = expected.jacobian(other)
        np.testing.assert_allclose(found.jacobian(name)[..., 3:], by, rtol=0, atol=1e-9 * np.abs(by).max())
        assert np.abs(found.jacobian(name)[..., :3]).max() < 1e-12
    assert found.stability is mr.Stability.UNKNOWN  # moments have no potential


def test_along_all_rods_is_along_each():
    """By names, as an array, and for all: equilibrium, potential and stability, also where rods slide through holes."""
    f = np.array(GIVEN["distributed_force"])
    plain = {name: value for name, value in GIVEN.items() if name not in ("moment", "rod_force")}
    for robot, given in ((mixed("feeler"), plain), (threaded(), {k: v for k, v in SLIDING.items() if k != "moment"})):
        names = robot.graph.whole_names
        rest = {name: value for name, value in given.items() if name != "distributed_force"}
        expected = mr.solve(robot, robot.inputs(**rest, distributed_force=f), solver=EXACT).raise_if_failed()
        each = {name: f + 0.1 * k for k, name in enumerate(names)}
        for value in (dict.fromkeys(names, f), np.tile(f, (len(names), 1))):
            found = mr.solve(robot, robot.inputs(**rest, rod_force=value), solver=EXACT)
            np.testing.assert_allclose(found.tip_position, expected.tip_position, rtol=0, atol=1e-10)
            for name in ("potential", "stability_margin"):
                np.testing.assert_allclose(getattr(found, name), getattr(expected, name), rtol=1e-7, atol=1e-9)
        found = mr.solve(robot, robot.inputs(**rest, rod_force=each), solver=EXACT).raise_if_failed()
        assert found.stability is mr.Stability.STABLE
        assert found._modes.uncertainty.max() < 1e-6  # the form is symmetric, to the errors of the integration: (15), (23)


def test_derivatives():
    """``check_assembly`` holds ``Gamma`` and columns by these loads against differences, where bases turn."""
    robot = mixed("feeler")
    given = GIVEN | {"rod_moment": {"upper": (0.01, 0, 0.02), "feeler": (0.0, 0.01, -0.01)}}
    check_assembly(robot, robot.inputs(**given), tip_rod=3, vary=tuple(NAMES), solvers=("shooting",))


def test_they_are_given_by_the_names_of_rods():
    robot = mixed()
    with pytest.raises(ValueError, match="rod_force.*must be by name, one of 'left'.*did you mean 'upper'"):
        robot.inputs(rod_force={"uper": (0, 0, 1)})
    with pytest.raises(ValueError, match=r"rod_force\['left'\]"):
        robot.inputs(rod_force={"left": 1.0})


def test_they_are_drawn_and_in_datasets(wire):
    joints = [mr.Joint(name, "base", to=mr.ground, pose=pose(position=(x, 0, 0))) for name, x in (("one", 0.0), ("two", 0.1))]
    robot = mr.Network(rods={"one": wire, "two": wire}, joints=joints, end_effector="one")
    found = mr.solve(robot, robot.inputs(rod_force={"two": (0.5, 0, 0)}), solver=EXACT).raise_if_failed()
    data = found.to_xarray()
    np.testing.assert_array_equal(data["input_rod_force"].sel(whole_rod="two"), (0.5, 0, 0))
    np.testing.assert_array_equal(data["input_rod_force"].sel(whole_rod="one"), 0.0)
    ax = found.plot()
    said = [text.get_text() for text in ax.get_legend().get_texts()]
    assert said == ["one", "two", "rod force on two 0.5 N/m"]
    drawn = next(c for c in ax.collections if c.get_label() == said[-1])
    ends = np.swapaxes(drawn._segments3d, 0, 1)
    assert ends[..., 0].min() > 0.05  # along the second rod alone
