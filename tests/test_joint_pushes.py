"""Torques and forces along coordinates of joints: against springs at other rests, joints that are driven, and columns."""

import numpy as np
import pytest
from conftest import rodrigues
from exact_columns import along_inputs
from scipy.optimize import brentq
from test_joint_slides import EXACT, slid
from test_joint_slides import GIVEN as SLID
from test_network import GIVEN, mixed
from test_network_branches import STEEP, hold_forces_against_the_potential
from test_network_rods import at
from test_recording import Recording, arrows_of

import multirod as mr

# numbers of each joint, angles first: torques [N m], then forces [N]
SLIDING = {
    "slide_force": {"left base": 0.9, "left tip": -0.3, "upper base": 0.5},
    "joint_torque": {"left tip": 0.03, "upper base": -0.02},
}
TURNING = {"joint_torque": {"left tip": 0.04, "right base": (0.03, 0.0), "upper tip": (-0.01, 0.02), "feeler base": 0.02}}


def of_joint(pushes, joint):
    """Of its coordinates in order, zero where nothing is given."""
    name = f"{joint.rod} {joint.end}"
    found = [np.atleast_1d(pushes[kind][name]) for kind in ("joint_torque", "slide_force") if name in pushes.get(kind, {})]
    count = joint.stiffness.size
    own = np.concatenate([*found, np.zeros(0)])
    return own if own.size == count else np.zeros(count)


def with_rests(robot, pushes):
    """The same whose springs are at rest elsewhere, by as much as makes up for what acts along the coordinates."""
    joints = []
    for joint in robot.joints:
        if joint.kind in ("clamped", "spherical") or joint.driven:
            joints.append(joint)
            continue
        stiff = joint.stiffness.reshape(-1)
        rest = joint.rest.reshape(-1) + np.divide(of_joint(pushes, joint), stiff, out=np.zeros(stiff.size), where=stiff > 0)
        axis = joint.axes if joint.kind == "universal" else joint.axes[0]
        spring = {"stiffness": stiff if stiff.size > 1 else stiff[0], "rest": rest if rest.size > 1 else rest[0]}
        options = spring if stiff.any() else {}
        joints.append(mr.Joint(joint.rod, joint.end, to=joint.to, pose=joint.pose, kind=joint.kind, axis=axis, **options))
    rods = dict(zip(robot.graph.whole_names, (whole.rods[0] for whole in robot.graph.whole), strict=True))
    return mr.Network(rods=rods, bodies=robot.bodies, joints=joints, end_effector=robot.end_effector)


@pytest.mark.parametrize(
    ("robot", "given", "pushes"), [(slid(), SLID, SLIDING), (mixed(), GIVEN, TURNING)], ids=["slid", "turned"]
)
def test_a_push_is_a_spring_that_is_at_rest_elsewhere(robot, given, pushes):
    """(40) ``k (theta - rest) - Q = k (theta - rest - Q/k)``: the same equations, whatever is at the base, the tip or a body."""
    found = mr.solve(robot, robot.inputs(**given, **pushes), solver=EXACT).raise_if_failed()
    other = with_rests(robot, pushes)
    expected = mr.solve(other, other.inputs(**given), solver=EXACT).raise_if_failed()
    plain = mr.solve(robot, robot.inputs(**given), solver=EXACT).raise_if_failed()
    assert np.linalg.norm(expected.tip_position - plain.tip_position) > 1e-3
    np.testing.assert_allclose(found.tip_position, expected.tip_position, atol=1e-10)
    np.testing.assert_allclose(found.tip_rotation, expected.tip_rotation, atol=1e-9)
    assert found.stability is expected.stability
    if found.stability is mr.Stability.STABLE:
        np.testing.assert_allclose(found.stability_margin, expected.stability_margin, rtol=1e-7)


@pytest.mark.parametrize(
    ("robot", "given", "pushes"), [(slid(), SLID, SLIDING), (mixed(), STEEP, TURNING)], ids=["slid", "turned"]
)
def test_pushes_have_a_potential_and_columns(robot, given, pushes, difference):
    hold_forces_against_the_potential(robot, given | pushes, push=0.02)
    problem, _, rate, moved = along_inputs(robot, robot.inputs(**given, **pushes), tuple(pushes))
    # the residual is linear in them: rounding of differences of 1e-2
    np.testing.assert_allclose(rate, difference(moved, 1e-2), atol=1e-8)
    # they rise with the load factor, as all loads do
    parts = []
    for level in (0.4, 1.0):
        with problem.at_load(level):
            parts.append(moved(1.0) - moved(0.0))
    np.testing.assert_allclose(parts[0], 0.4 * parts[1], rtol=0, atol=1e-12 * np.abs(parts[1]).max())


STRUT = mr.Rod(length=0.3, bending_stiffness=0.02, torsional_stiffness=0.015, axial_stiffness=1e4)


@pytest.mark.parametrize(("end", "sense"), [("base", 1), ("tip", -1)])
def test_a_strut_that_is_pushed_along_its_slide_gives_way_and_buckles(end, sense):
    """It is shorter by ``F L/EA``; in a ball at the other end, it buckles where ``tan x = x``."""
    other = "tip" if end == "base" else "base"
    joints = [
        mr.Joint("strut", end, to=mr.ground, pose=at(z=0.3 * (end == "tip")), kind="prismatic", axis=(0, 0, 1)),
        mr.Joint("strut", other, to=mr.ground, pose=at(z=0.3 * (end == "base")), kind="spherical"),
    ]
    robot = mr.Network(rods={"strut": STRUT}, joints=joints)
    pushed = mr.solve(robot, robot.inputs(slide_force={f"strut {end}": sense * 2.0}), solver=EXACT).raise_if_failed()
    shape = pushed.rod("strut")
    slid_by = shape.position[0 if end == "base" else -1, 2] - 0.3 * (end == "tip")
    np.testing.assert_allclose(slid_by, sense * 2.0 * 0.3 / 1e4, rtol=1e-9)
    np.testing.assert_allclose(shape.force[:, 2], -2.0, rtol=1e-9)
    (load,) = mr.critical_loads(robot, robot.inputs(slide_force=sense))
    euler = brentq(lambda x: np.tan(x) - x, 4.4, 4.6) ** 2 * 0.02 / 0.3**2
    exact = 1e4 * (1 - np.sqrt(1 - 4 * euler / 1e4)) / 2  # F (1 - F/EA) of a column that is shorter then
    np.testing.assert_allclose(load.load_factor, exact, rtol=1e-6)


def test_a_strut_whose_ends_do_not_turn_buckles():
    """``4 pi^2 EI/L^2``, pushed along a slide, or by a hand that comes nearer; (16) does not see that mode, its index does."""
    euler = 4 * np.pi**2 * 0.02 / 0.3**2
    exact = 1e4 * (1 - np.sqrt(1 - 4 * euler / 1e4)) / 2
    hand, clamp = mr.Body("hand", pose=at(z=0.3), fixed=True), mr.Joint("strut", "base", to=mr.ground)
    slide = mr.Joint("strut", "base", to=mr.ground, kind="prismatic", axis=(0, 0, 1))
    pushed, held = (
        mr.Network(rods={"strut": STRUT}, bodies=[hand], joints=[base, mr.Joint("strut", "tip", to=hand)])
        for base in (slide, clamp)
    )
    nearer = held.inputs(fixed_position=(0, 0, -0.3 / 1e4))  # 1 N
    for robot, inputs, start in ((pushed, pushed.inputs(slide_force=1.0), None), (held, nearer, held.inputs())):
        with pytest.warns(mr.IncompleteWarning, match="so near to neutral"):
            (load,) = mr.critical_loads(robot, inputs, start=start)
        np.testing.assert_allclose(load.load_factor, exact, rtol=1e-9)
        assert (load.index_before, load.index_after) == (0, 2)


def test_a_pinned_column_under_a_carriage_buckles():
    """``pi^2 EI/L^2`` between a ball and a universal joint of a carriage, which a stub that slides presses down."""
    carriage, stub = mr.Body("carriage"), mr.Rod(length=0.1, bending_stiffness=5.0, torsional_stiffness=5.0, axial_stiffness=1e6)
    joints = [
        mr.Joint("strut", "base", to=mr.ground, kind="spherical"),
        mr.Joint("strut", "tip", to=carriage, kind="universal", axis=np.eye(3)[:2]),
        mr.Joint("stub", "base", to=carriage),
        mr.Joint("stub", "tip", to=mr.ground, pose=at(z=0.4), kind="prismatic", axis=(0, 0, 1)),
    ]
    robot = mr.Network(rods={"strut": STRUT, "stub": stub}, bodies=[carriage], joints=joints)
    (load,) = mr.critical_loads(robot, robot.inputs(slide_force={"stub tip": -1.0}))
    exact = 1e4 * (1 - np.sqrt(1 - 4 * np.pi**2 * 0.02 / 0.3**2 / 1e4)) / 2
    np.testing.assert_allclose(load.load_factor, exact, rtol=1e-6)
    assert (load.index_before, load.index_after) == (0, 2)


def test_a_torque_holds_a_hinge_where_it_was_driven_to():
    """What drives a motor to an angle, taken for a torque of a hinge without a drive, leaves the arm where it was."""
    arm = mr.Rod(length=0.3, bending_stiffness=0.2, torsional_stiffness=0.15, linear_density=0.05)
    pose, given = {"to": mr.ground, "kind": "revolute", "axis": (0, 1, 0)}, {"gravity": (0, 0, -9.81)}
    robots = [
        mr.Network(rods={"arm": arm}, joints=[mr.Joint("arm", "base", **pose, **how)])
        for how in ({"driven": True}, {"stiffness": 0.4})
    ]
    driven = mr.solve(robots[0], robots[0].inputs(angle=0.7, **given), solver=EXACT).raise_if_failed()
    moment = driven.rod("arm").rotation[0] @ driven.rod("arm").moment[0]
    torque = 0.4 * 0.7 - moment[1]  # its spring and the arm's weight
    pushed = mr.solve(robots[1], robots[1].inputs(joint_torque=torque, **given), solver=EXACT).raise_if_failed()
    np.testing.assert_allclose(pushed.tip_position, driven.tip_position, atol=1e-10)
    assert pushed.stability is mr.Stability.STABLE


def test_pushes_are_given_by_name_and_what_has_none_is_named(tmp_path):
    robot = slid()
    given = robot.inputs(**SLIDING)
    assert robot.coordinate_names["slide_force"] == ("left base", "left tip", "right tip", "upper base", "feeler base")
    assert robot.coordinate_names["joint_torque"] == ("left tip", "upper base")
    np.testing.assert_array_equal(given.slide_force, (0.9, -0.3, 0, 0.5, 0))
    with pytest.raises(ValueError, match="slide_force = 'right base' .*must be by name, one of 'left base', 'left tip'"):
        robot.inputs(slide_force={"right base": 1.0})
    plain = mr.Network(rods={"strut": STRUT}, joints=[mr.Joint("strut", "base", to=mr.ground)])
    with pytest.raises(ValueError, match="slide_force = .* no joint that is not driven slides"):
        plain.inputs(slide_force=1.0)
    with pytest.raises(ValueError, match="joint_torque = .* no joint that is not driven turns about axes"):
        plain.inputs(joint_torque=1.0)
    solution = mr.solve(robot, robot.inputs(**SLID, **SLIDING), solver=EXACT).raise_if_failed()
    solution.save(tmp_path / "pushed.npz")
    again = mr.load(tmp_path / "pushed.npz")
    np.testing.assert_array_equal(again.inputs.slide_force, given.slide_force)
    dataset = solution.to_xarray()
    assert dataset["input_slide_force"].coords["slide_force"].values.tolist() == list(robot.coordinate_names["slide_force"])
    assert dataset["input_joint_torque"].values.tolist() == [0.03, -0.02]


ROUND = {"length": 0.3, "bending_stiffness": 0.02, "torsional_stiffness": 0.015}
SHAFT = {"kind": "universal", "axis": ((1, 0, 0), (0, 0, 1))}  # its second axis is that of the rod
BALL = {"kind": "spherical"}


def beside_a_mast(made, base, tip):
    """A rod beside another, which holds the plate."""
    plate = mr.Body("plate")
    joints = [mr.Joint("mast", "base", to=mr.ground), mr.Joint("mast", "tip", to=plate)]
    joints += [mr.Joint("rod", "base", to=mr.ground, pose=at(0.1), **base), mr.Joint("rod", "tip", to=plate, pose=at(0.1), **tip)]
    rods = {"mast": mr.Rod(**ROUND), "rod": mr.Rod(**made)}
    return mr.Network(rods=rods, bodies=[plate], joints=joints, segments={"rod": 2} if made.get("linear_density") else None)


@pytest.mark.parametrize(
    ("made", "base", "tip", "torques", "resisted"),
    [
        (ROUND, SHAFT, BALL, {"rod base": (0.01, 0.02)}, False),
        (ROUND, SHAFT, BALL, {"rod base": (0.01, 0.0)}, True),
        (ROUND, BALL, SHAFT, {"rod tip": (0.01, 0.02)}, False),
        (ROUND, {"kind": "revolute", "axis": (0, 0, -1)}, BALL, {"rod base": 0.02}, False),
        (ROUND, {"kind": "revolute", "axis": (0, 0.01, 1)}, BALL, {"rod base": 0.02}, True),
        (ROUND, {"kind": "revolute", "axis": (0, 0, 1), "stiffness": 0.1}, BALL, {"rod base": 0.02}, True),
        (ROUND, {"kind": "universal", "axis": ((0, 0, 1), (1, 0, 0))}, BALL, {"rod base": (0.02, 0)}, True),
        (ROUND, SHAFT, {"kind": "cylindrical", "axis": (0, 0, -1)}, {"rod base": (0, 0.02), "rod tip": 0.02}, True),
        (ROUND, SHAFT, {"kind": "cylindrical", "axis": (0, 0, -1)}, {"rod base": (0, 0.02), "rod tip": 0.01}, False),
        (ROUND, SHAFT, {}, {"rod base": (0, 0.02)}, True),
        (ROUND | {"linear_density": 0.02}, SHAFT, BALL, {"rod base": (0, 0.02)}, False),  # in segments
        (ROUND | {"bending_stiffness": (0.02, 0.03)}, SHAFT, BALL, {"rod base": (0, 0.02)}, True),
        (ROUND | {"precurvature": (1, 0, 0)}, SHAFT, BALL, {"rod base": (0, 0.02)}, True),
        (ROUND | {"lines": [mr.Tendon(offset=(0.005, 0))]}, SHAFT, BALL, {"rod base": (0, 0.02)}, True),
    ],
)
def test_a_torque_that_turns_a_round_rod_about_itself_is_refused(made, base, tip, torques, resisted):
    """The search for where it rests took 20,000 integrations, and found none."""
    robot = beside_a_mast(made, base, tip)
    if resisted:
        robot.inputs(joint_torque=torques)
        return
    with pytest.raises(ValueError, match="must not turn rod 'rod' about itself") as refused:
        robot.inputs(joint_torque=torques)
    assert str(refused.value).startswith(f"joint_torque = {{'{next(iter(torques))}'")


HINGE = {"kind": "revolute", "axis": (1, 0, 0)}
OWN = {"kind": "revolute", "axis": (0, 0, 1)}  # a hinge about the rod's own axis


@pytest.mark.parametrize(
    ("loose", "held"), [((SHAFT, BALL), (HINGE, BALL)), ((OWN, BALL), ({}, BALL)), ((BALL, SHAFT), (BALL, HINGE))]
)
def test_a_round_rod_that_turns_about_itself_is_as_one_that_is_held_so(loose, held):
    """Nothing turns it so: it may as well be held. It was a ``FOLD`` everywhere, after hundreds of integrations."""
    given = {"force": {"plate": (0.3, 0.1, -0.2)}, "translation": {"rod": 0.02}}
    found = []
    for ends in (loose, held):
        robot = beside_a_mast(ROUND, *ends)
        found.append(mr.solve(robot, robot.inputs(**given), solver=EXACT).raise_if_failed())
    turning, clamped = found
    np.testing.assert_allclose(turning.tip_position, clamped.tip_position, rtol=0, atol=1e-10)
    np.testing.assert_allclose(turning.tip_rotation, clamped.tip_rotation, rtol=0, atol=1e-9)
    assert turning.stability is clamped.stability is mr.Stability.STABLE
    assert turning.integrations <= clamped.integrations + 2


def test_what_turns_a_round_rod_about_itself_along_it_is_loose():
    """A moment across a plane in which all is bent does not; the spring that holds the rod would hold any."""
    robot = beside_a_mast(ROUND, OWN, BALL)
    push = {"force": {"plate": (0.3, 0, -0.2)}}
    across = mr.solve(robot, robot.inputs(rod_moment={"rod": (0, 0.05, 0)}, **push), solver=EXACT)
    assert across.status is mr.Status.CONVERGED
    along = mr.solve(robot, robot.inputs(rod_moment={"rod": (0, 0, 1e-4)}, **push), solver=EXACT)
    assert along.status is mr.Status.LOOSE
    with pytest.raises(mr.SolveError, match=r"\(nothing holds rod 'rod' against turning about itself\)$"):
        along.raise_if_failed()
    assert np.isnan(along.tip_position).all()


@pytest.mark.parametrize(
    ("robot", "given", "pushes"), [(slid(), SLID, SLIDING), (mixed(), GIVEN, TURNING)], ids=["slid", "turned"]
)
def test_they_are_drawn_where_they_act(robot, given, pushes, tmp_path):
    """From the end of the rod, about or along axes: those that stay with the body, and the second of a universal joint, that goes
    with the rod. In recordings, and in plots by name."""
    loads = {kind: np.concatenate(list(mapping_of(robot, kind, own).values())) for kind, own in pushes.items()}
    both = robot.inputs(**given, **{kind: np.stack([0.5 * own, own]) for kind, own in loads.items()})
    history = mr.simulate(robot, both, time=[0.0, 0.1], solver=EXACT)
    history.raise_if_failed()
    history.save(tmp_path / "pushed.rrd")
    recording, joints = Recording(tmp_path / "pushed.rrd"), {f"{j.rod} {j.end}": j for j in robot.joints}
    solution = mr.solve(robot, robot.inputs(**given, **loads), solver=EXACT)
    legend = [text.get_text() for text in solution.plot().get_legend().get_texts()]
    drawn = 0
    for kind, own in loads.items():
        scales = set()
        for name, value in zip(robot.coordinate_names[kind], own.tolist(), strict=True):
            if not value:
                continue
            joint, which = joints[name.removesuffix(" 0").removesuffix(" 1")], int(name.endswith(" 1"))
            rod, node = history.rod(joint.rod), -1 if joint.end == "tip" else 0
            turned = np.eye(3) if joint.to is mr.ground else history.body_rotation(joint.to.name)
            axis = np.broadcast_to(turned @ joint.pose[:3, :3] @ joint.axes[0], (2, 3))
            if which:  # as seen from the rod, in whose frame it is where the joint is not turned; at its base the rod is turned
                spin = float(history.inputs.rotation[0, robot.tubes_of(joint.rod)[0]]) if joint.end == "base" else 0.0
                axis = rod.rotation[:, node] @ rodrigues((0, 0, -spin)) @ joint.axes[1]
            arrows, origins = arrows_of(recording, f"{kind}/{name}".replace(" ", r"\ "))
            np.testing.assert_allclose(origins, rod.position[:, node], atol=1e-7)  # single precision, of a metre
            scale = arrows[-1] @ axis[-1] / value
            scales.add(round(scale, 6))
            for sample, part in enumerate((0.5, 1.0)):
                np.testing.assert_allclose(arrows[sample], scale * part * value * axis[sample], atol=2e-7 * scale)
            unit = "N" if kind == "slide_force" else "N m"
            assert f"{kind.replace('_', ' ')} on {name} {abs(value):.3g} {unit}" in legend
            drawn += 1
        assert len(scales) == 1
        assert scales.pop() > 0
    assert drawn == 5 if "slide_force" in pushes else 6


def mapping_of(robot, kind, own):
    """Numbers of all joints of a kind, by their names, zero where none is given."""
    names = [name.removesuffix(" 0").removesuffix(" 1") for name in robot.coordinate_names[kind]]
    return {name: np.atleast_1d(np.zeros(names.count(name)) + own.get(name, 0.0)) for name in names}


def test_what_is_pushed_is_a_load_to_those_who_search_without():
    """What moves a base and turns it about itself stays."""
    robot = mixed()
    problem = robot.problem(robot.inputs(**TURNING, **GIVEN), integrator=mr.RK4(4))
    rows = problem.joints.unloaded_inputs()
    found = {name for name, place in problem._slices.items() if rows[:, place].any()}
    assert found == {"rotation", "translation"}
