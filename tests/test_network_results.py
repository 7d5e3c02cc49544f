"""What becomes of results of networks: datasets, plots, and rods by name, where rods have lines, are tubes or are driven."""

import numpy as np
import pytest
from test_network import GIVEN, mixed
from test_network_rods import at

import multirod as mr


def finger(count):
    lines = [mr.Tendon(offset=(0.006 * np.cos(a), 0.006 * np.sin(a))) for a in 2 * np.pi / count * np.arange(count)]
    return mr.Rod(length=0.15, bending_stiffness=0.02, torsional_stiffness=0.015, lines=lines)


def standing(**rods):
    joints = [mr.Joint(name, "base", to=mr.ground, pose=at(x=0.1 * k)) for k, name in enumerate(rods)]
    return mr.Network(rods=rods, joints=joints)


@pytest.mark.parametrize("count", [2, 3, 6])
def test_tensions_in_datasets_belong_to_lines(tmp_path, count):
    """Of three lines, or six on one of two rods, their number could be taken for that of vectors."""
    pytest.importorskip("xarray")
    robot = standing(one=finger(count), two=mr.Rod(length=0.15, bending_stiffness=0.02, torsional_stiffness=0.015))
    tension = 0.1 * np.arange(count)
    solution = mr.solve(robot, robot.inputs(tension={"one": tension}, force={"two": (0.01, 0, 0)})).raise_if_failed()
    data = solution.to_xarray()
    assert data["input_tension"].dims == ("line_by_tension",)
    np.testing.assert_array_equal(data["input_tension"], tension)
    assert data["line_by_tension"].values.tolist() == data["line"].values.tolist()
    np.testing.assert_array_equal(data["input_force"].sel(load_place="two"), (0.01, 0, 0))
    solution.save(tmp_path / "found.nc")


def driven():
    wire = mr.Rod.wire(length=0.2, diameter=1e-3, young_modulus=60e9, shear_modulus=23e9)
    joints = [mr.Joint("arm", "base", to=mr.ground, kind="universal", axis=np.eye(3)[:2], driven=True)]
    return mr.Network(rods={"arm": wire}, joints=joints)


def test_angles_in_datasets_belong_to_coordinates(tmp_path):
    pytest.importorskip("xarray")
    robot = driven()
    solution = mr.solve(robot, robot.inputs(angle={"arm base": (0.1, 0.2)})).raise_if_failed()
    data = solution.to_xarray()
    assert data["coordinate"].values.tolist() == ["arm base 0", "arm base 1"]
    np.testing.assert_array_equal(data["input_angle"].sel(coordinate="arm base 1"), 0.2)
    solution.save(tmp_path / "found.nc")
    none = mr.solve(robot, robot.inputs(angle={"arm base": np.zeros((0, 2))}, force={"arm": (0.1, 0, 0)})).to_xarray()
    assert none.sizes["instance"] == 0
    assert none.sizes["load_place"] == 1
    assert none["joint_angle"].shape == (0, 2)


@pytest.mark.usefixtures("no_display")
def test_inputs_of_a_motion_are_drawn_by_what_they_belong_to():
    robot, time = standing(one=finger(2)), 0.1 * np.arange(3)
    tension = np.outer(time, (1, 0))
    history = mr.simulate(robot, robot.inputs(tension=tension), time=time)
    panel = history.plot("inputs")
    assert panel.get_ylabel() == "tension\n[N]"
    drawn = {line.get_label(): line.get_ydata().tolist() for line in panel.lines}
    assert list(drawn.values())[:2] == tension.T.tolist(), drawn
    history = mr.simulate(driven(), driven().inputs(angle=tension), time=time)
    assert {"arm base 0", "arm base 1"} <= {line.get_label() for line in history.plot("inputs").lines}


def tube(length, outer, inner):
    return mr.Rod.tube(length=length, outer_diameter=outer, inner_diameter=inner, young_modulus=60e9, shear_modulus=23e9)


TUBES = mr.ConcentricTubes([tube(0.2, 1.2e-3, 0.8e-3), tube(0.12, 2e-3, 1.5e-3)])


@pytest.mark.usefixtures("no_display")
@pytest.mark.parametrize("effector", ["arm", "wire"])
@pytest.mark.parametrize("back", [0.0, -0.1])  # pulled back by that, the outer tube reaches furthest
def test_loads_on_tips_of_tubes_are_drawn_where_they_act(effector, back):
    wire = mr.Rod.wire(length=0.15, diameter=1e-3, young_modulus=60e9, shear_modulus=23e9)
    joints = [mr.Joint(name, "base", to=mr.ground, pose=at(x=x)) for name, x in (("arm", 0.0), ("wire", 0.1))]
    robots = {end: mr.Network(rods={"arm": TUBES, "wire": wire}, joints=joints, end_effector=end) for end in ("arm", effector)}
    given = {"translation": {"arm": (back, 0)}, "force": {"arm": (0.05, 0.02, 0)}, "follower_force": {"arm": (0, 0.03, 0)}}
    found = {end: mr.solve(robot, robot.inputs(**given)).raise_if_failed() for end, robot in robots.items()}
    tip, frame = found["arm"].tip_position, found["arm"].tip_rotation
    ax = found[effector].plot()
    drawn = {collection.get_label().split(" on arm")[0]: collection for collection in ax.collections}
    for name, vector in (("force", np.array([0.05, 0.02, 0])), ("follower force", frame @ (0, 0.03, 0))):
        start, end = sorted(drawn[name]._segments3d[0], key=lambda end: np.linalg.norm(end - tip))
        # of a tip that is no end effector, on nodes, whose steps are others: RK45's rtol of the length
        np.testing.assert_allclose(start, tip, atol=1e-6)
        np.testing.assert_allclose((end - start) / np.linalg.norm(end - start), vector / np.linalg.norm(vector), atol=1e-5)


def test_rods_made_of_tubes_are_named():
    robot = mr.Network(rods={"arm": TUBES}, joints=[mr.Joint("arm", "base", to=mr.ground)])
    solution = mr.solve(robot, robot.inputs(force=(0.05, 0, 0))).raise_if_failed()
    with pytest.raises(ValueError, match="did you mean 'arm 0', the first of its 2 tubes"):
        solution.rod("arm")
    with pytest.raises(ValueError, match="did you mean 'arm 0'"):
        solution.rod("arm0")


def test_energies_of_springs_are_those_of_a_robot_alone():
    """To the last bit, in a batch too: springs are summed in one order."""
    robot = mixed()

    def energies(unknowns):
        loads = GIVEN | {"gravity": np.tile(GIVEN["gravity"], (len(unknowns), 1))}
        problem = robot.problem(robot.inputs(**loads), integrator=mr.RK4(4))
        problem.write("unknowns", unknowns)
        return problem.shapes.of_springs(problem.state().angles)

    size = robot.problem(robot.inputs(**GIVEN), integrator=mr.RK4(4)).unknown_count
    unknowns = np.random.default_rng(0).standard_normal((20, size))
    np.testing.assert_array_equal(energies(unknowns), [energies(own[None])[0] for own in unknowns])
