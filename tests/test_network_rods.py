"""Rods of a network that have lines, and tubes in each other: against the robots that are such a rod, and statics."""

import numpy as np
import pytest
from scipy.optimize import brentq
from test_network_branches import hold_forces_against_the_potential

import multirod as mr

EXACT = mr.Shooting(tolerance=1e-11, integrator=mr.RK4(50))
FINE = mr.Shooting(tolerance=1e-11, integrator=mr.RK4(200))  # of whose steps statics of tubes notice less than 1e-12 N m
X = np.array([1.0, 0, 0])
FORCE, GRAVITY = (0.02, 0.03, 0.1), (0, 0, -9.81)
LINED = mr.Rod(
    length=0.2,
    bending_stiffness=0.01,
    torsional_stiffness=0.0077,
    axial_stiffness=100.0,
    linear_density=0.02,
    lines=[
        mr.Tendon(offset=(0.008, 0)),
        mr.Tendon(offset=(-0.004, 0.007), driven="displacement", axial_stiffness=200.0),
        mr.Chamber(offset=(0, -0.0055), area=2e-5),
    ],
)
DRIVEN = {"tension": 0.8, "displacement": 0.001, "pressure": 1e4}


def tube(length, curvature, stiffness):
    return mr.Rod(
        length=length,
        bending_stiffness=stiffness,
        torsional_stiffness=0.75 * stiffness,
        linear_density=0.02,
        precurvature=(curvature, 0, 0.5),
    )


TUBES = mr.ConcentricTubes([tube(0.3, 8, 0.02), tube(0.2, 5, 0.04)])
MOVED = {"rotation": (0.4, -0.2), "translation": (-0.0513, -0.0217)}  # lengths at which no number of steps is about to change


def at(x=0.0, y=0.0, z=0.0, turn=0.0):
    pose = np.eye(4)
    pose[:3, 3] = x, y, z
    c, s = np.cos(turn), np.sin(turn)
    pose[:3, :3] = np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]])
    return pose


@pytest.mark.parametrize(
    ("rod", "single", "given"), [(LINED, mr.SingleRod(LINED), DRIVEN), (TUBES, TUBES, MOVED)], ids=["lines", "tubes"]
)
def test_one_rod_with_a_free_tip_is_the_robot_that_is_it(rod, single, given):
    """Both integrate the same rod by the same steps."""
    expected = mr.solve(single, single.inputs(tip_force=FORCE, gravity=GRAVITY, **given), solver=EXACT).raise_if_failed()
    robot = mr.Network(rods={"arm": rod}, joints=[mr.Joint("arm", "base", to=mr.ground)])
    by_name = {name: {"arm": value} for name, value in given.items()}
    found = mr.solve(robot, robot.inputs(force={"arm": FORCE}, gravity=GRAVITY, **by_name), solver=EXACT).raise_if_failed()
    # the base force is unknown here: other rounding, and 1e-11 that is left of the residual [1/m] by a length of 0.2 m
    np.testing.assert_allclose(found.tip_position, expected.tip_position, rtol=0, atol=1e-11)
    assert found.stability == expected.stability == mr.Stability.STABLE
    np.testing.assert_allclose(found.potential, expected.potential, rtol=1e-10, atol=1e-12)
    for name in (*given, "gravity"):
        np.testing.assert_allclose(found.jacobian(name), expected.jacobian(name), rtol=1e-9, atol=1e-11)
    if rod is LINED:
        np.testing.assert_allclose(found.tension, expected.tension, rtol=1e-10)
        np.testing.assert_array_equal(found.slack, expected.slack)
        for name in given:
            own, other = (solution.jacobian(name, of="line_length") for solution in (found, expected))
            np.testing.assert_allclose(own, other, rtol=1e-9, atol=1e-11 * np.abs(other).max())


@pytest.mark.parametrize("joints", ["clamped", "spherical"])
def test_legs_with_lines_and_of_tubes_are_those_of_parallel_rods(joints):
    feet = np.array([at(0.05), at(-0.03, 0.04), at(-0.03, -0.04)])
    plate = np.array([at(0.04), at(-0.024, 0.032), at(-0.024, -0.032)])
    parallel = mr.ParallelRods(legs=[TUBES, LINED, TUBES], base=feet, platform=plate, platform_mass=0.01, joints=joints)
    given = {"rotation": (0.1, 0.2, 0, 0.3, 0.1), "translation": (-0.02, -0.01, 0, -0.02, 0), "gravity": GRAVITY, **DRIVEN}
    robot = mr.stacked(parallel, names=["plate"])
    assert [rod.name for rod in robot.rods] == ["plate 0 0", "plate 0 1", "plate 1", "plate 2 0", "plate 2 1"]
    found = mr.solve(robot, robot.inputs(force={"plate": FORCE}, **given), solver=EXACT).raise_if_failed()
    inputs = parallel.inputs(tip_force=FORCE, **given)
    # both have the same unknowns but for angles: the plate begins where it is not turned
    places = robot.graph.entries.variables[:, : robot.graph.layout.own]
    start = np.concatenate([found.unknowns[places[places >= 0]], found.unknowns[-6:]])
    expected = mr.solve(parallel, inputs, solver=EXACT, guess=start).raise_if_failed()
    np.testing.assert_allclose(found.tip_position, expected.tip_position, rtol=0, atol=1e-12)
    np.testing.assert_allclose(found.tension, expected.tension, rtol=1e-9)
    assert found.stability == expected.stability
    assert found.index == expected.index
    for name in given:
        own, other = found.jacobian(name), expected.jacobian(name)
        np.testing.assert_allclose(own, other, rtol=0, atol=1e-9 * np.abs(other).max())


@pytest.mark.parametrize(("curvature", "index"), [(5.0, 0), (10.0, 1), (20.0, 1), (25.0, 2)])
def test_tubes_that_are_about_to_snap_are_told(curvature, index):
    """Two equal tubes against each other need no torque, and how they turn is a column: ``k L sqrt(EI/GJ)`` passes odd multiples
    of ``pi/2``. At 20/m the mode is one of the tips that turn against each other alone."""
    tube = mr.Rod(length=0.2, bending_stiffness=0.02, torsional_stiffness=0.015, precurvature=curvature * X)
    robot = mr.Network(rods={"arm": mr.ConcentricTubes([tube] * 2)}, joints=[mr.Joint("arm", "base", to=mr.ground)])
    problem = robot.problem(robot.inputs(rotation={"arm": (0, np.pi)}), integrator=mr.RK4(50))
    residual, _ = problem.evaluate(np.zeros((1, problem.unknown_count)))
    assert np.abs(residual).max() < 1e-13
    modes = problem.stability.modes()
    assert index == np.floor(curvature * 0.2 * np.sqrt(0.02 / 0.015) / np.pi + 0.5)
    assert modes.known.all()
    assert modes.hidden[0] + (modes.values[0] < 0).sum() == index


def tower(rod, kind="clamped", foot=None):
    """Such a rod on a body that a wire carries."""
    wire = mr.Rod.wire(length=0.2, diameter=3e-3, young_modulus=60e9, shear_modulus=23e9)
    body = mr.Body("body")
    more = {"kind": kind, "axis": X, "stiffness": 0.3} if kind == "revolute" else {"kind": kind}
    joints = [
        mr.Joint("wire", "base", to=mr.ground),
        mr.Joint("wire", "tip", to=body),
        mr.Joint("arm", "base", to=body, pose=at(0.02, 0.01, 0.005, 0.7) if foot is None else foot, **more),
    ]
    return mr.Network(rods={"wire": wire, "arm": rod}, bodies=[body], joints=joints, end_effector="arm")


@pytest.mark.parametrize(("rod", "given"), [(LINED, DRIVEN), (TUBES, MOVED)], ids=["lines", "tubes"])
def test_what_carries_such_a_rod_bears_what_acts_at_its_tip(rod, given):
    """The force and its moment about the body, whatever lines and tubes do between: what drives them stands on the body."""
    robot = tower(rod)
    inputs = robot.inputs(force={"arm": FORCE}, **{name: {"arm": value} for name, value in given.items()})
    solution = mr.solve(robot, inputs, solver=FINE).raise_if_failed()
    below = solution.rod("wire")
    R = below.rotation[-1]
    lever = solution.tip_position - solution.body_position("body")
    # the tolerance [1/m] times EI of the wire, 0.24 N m^2
    np.testing.assert_allclose(R @ below.force[-1], FORCE, rtol=0, atol=1e-10)
    np.testing.assert_allclose(R @ below.moment[-1], np.cross(lever, FORCE), rtol=0, atol=1e-11)


@pytest.mark.parametrize(("rod", "given"), [(LINED, DRIVEN), (TUBES, MOVED)], ids=["lines", "tubes"])
def test_columns_of_what_stands_on_a_body(rod, given, difference):
    """``Gamma`` and columns by what drives it, its base on a body and on a hinge, off the equilibrium and under gravity."""
    robot = tower(rod, kind="revolute")
    by_name = {name: {"arm": value} for name, value in given.items()}
    inputs = robot.inputs(force={"arm": FORCE}, gravity=GRAVITY, **by_name)
    names = (*given, "gravity")
    options = robot.input_directions(*names)
    problem = robot.problem(inputs, integrator=mr.RK4(50), pose_sensitivities=True, **options)
    rng = np.random.default_rng(3)
    x = 0.5 * rng.standard_normal((1, problem.unknown_count))
    problem.write("unknowns", x)
    slopes, _ = problem.input_columns(*names)
    _, gamma = problem.evaluate(x)
    for _ in range(3):
        way = rng.standard_normal(problem.unknown_count)
        by_difference = difference(lambda t, way=way: problem.evaluate(x + t * way)[0][0], 1e-2)
        # what rounding leaves of differences of 1e-2, and their sixth order
        np.testing.assert_allclose(gamma[0] @ way, by_difference, rtol=0, atol=1e-8)
    kept, first = problem.read("inputs"), 0
    for name in names:
        place = problem.input_slice(name)
        size = 1e-4 * max(np.abs(kept[:, place]).max(), 1e-3)
        for k in range(place.start, place.stop):

            def residual(t, k=k):
                moved = kept.copy()
                moved[0, k] += t
                problem.write("inputs", moved)
                return problem.evaluate(x)[0][0]

            by_difference = difference(residual, size)
            scale = max(1.0, np.abs(by_difference).max())
            np.testing.assert_allclose(slopes[0, :, first], by_difference, rtol=0, atol=1e-7 * scale)
            problem.write("inputs", kept)
            first += 1


@pytest.mark.parametrize("translation", [(0.0, 0.0), (-0.2, -0.1)])
def test_tubes_on_a_body_whose_base_or_section_ends_at_the_plate_vary_as_if_pulled_back(translation):
    """By ``translation`` and ``length``, also what they turn the body by: differences of fourth order, of poses alone."""

    def solved(back, shorter=0.0, guess=None):
        inner, outer = (0.2 - shorter, (0, 1, 0.5), 0.0077, 0.12), (0.1, (1, 0, 0.8), 0.023, 0.07)
        tubes = []
        for (length, twisted, torsion, rest), curve in ((inner, (9, 0, -0.7)), (outer, (5, 2, 0.3))):
            common = {"bending_stiffness": 1.3 * torsion}
            sections = [
                mr.Section(length=length, torsional_stiffness=torsion, precurvature=twisted, **common),
                mr.Section(length=rest, torsional_stiffness=1.2 * torsion, precurvature=curve, **common),
            ]
            tubes.append(mr.Rod(sections=sections))
        robot, where = tower(mr.ConcentricTubes(tubes)), np.array(translation) - back
        inputs = robot.inputs(rotation={"arm": (0.4, -0.9)}, translation={"arm": where}, force={"arm": (0.3, 0.2, 0.1)})
        return mr.solve(robot, inputs, solver=EXACT, guess=guess).raise_if_failed()

    found, h = solved(np.zeros(2)), 1e-4
    given = found.jacobian("translation", "length")[:3]
    pulled, of_first_section = given[:, 1:3], given[:, 5]  # after those of the wire, which has a section less
    cases = ((pulled[:, 0], (1.0, 0.0), 0.0), (pulled.sum(axis=1), (1.0, 1.0), 0.0), (of_first_section, (0.0, 0.0), 1.0))
    for column, back, shorter in cases:
        tips = [solved(k * h * np.array(back), k * h * shorter, guess=found).tip_position for k in range(5)]
        expected = np.array([25 / 12, -4, 3, -4 / 3, 1 / 4]) @ tips / h
        # of 1e-12 of a tip over 1e-4, and of the fourth power of that
        np.testing.assert_allclose(column, expected, rtol=0, atol=1e-6)


def test_tensions_and_lengths_of_lines_of_what_stands_on_a_body_vary_as_differences_do(difference):
    """Of a rod whose base turns with its body under gravity."""
    robot, solver = tower(LINED, kind="revolute"), mr.Shooting(tolerance=1e-12, integrator=mr.RK4(50))
    given = {name: {"arm": value} for name, value in (DRIVEN | {"displacement": 0.004}).items()} | {"force": {"arm": FORCE}}
    solution = mr.solve(robot, robot.inputs(gravity=GRAVITY, **given), solver=solver)
    for of, size in (("tension", 0.1), ("line_length", 1e-3)):

        def moved(t, of=of):
            turned = mr.solve(robot, robot.inputs(gravity=np.add(GRAVITY, (t, 0, 0)), **given), solver=solver, guess=solution)
            return np.array(getattr(turned, of))

        by_difference = difference(moved, 0.1)
        assert np.abs(by_difference).max() > 1e-3 * size
        # the tolerance over the step
        np.testing.assert_allclose(solution.jacobian("gravity", of=of)[:, 0], by_difference, rtol=0, atol=1e-8 * size)


THREE = mr.ConcentricTubes([tube(0.25, 8, 0.02), tube(0.3, 5, 0.04), tube(0.24, 3, 0.05)])  # the second ends at the tip


@pytest.mark.parametrize(
    ("rod", "given"),
    [(LINED, DRIVEN), (TUBES, MOVED), (THREE, {"rotation": (0.4, -0.2, 0.3), "translation": (-0.0313, -0.0217, -0.0101)})],
    ids=["lines", "tubes", "three tubes"],
)
def test_forces_of_such_rods_are_the_slope_of_the_potential(rod, given):
    """(25) Torques of tubes beside those of bodies and joints, lengths of lines kept; the base on a hinge of a body."""
    by_name = {name: {"arm": value} for name, value in given.items()}
    loads = {"force": {"arm": FORCE}, "gravity": GRAVITY}
    hold_forces_against_the_potential(tower(rod, kind="revolute"), {**loads, **by_name}, push=0.003)


PAIR = mr.ConcentricTubes(
    [mr.Rod(length=L, bending_stiffness=0.02, torsional_stiffness=0.015, precurvature=12 * X) for L in (0.25, 0.2)]
)
SNAPPING = mr.Shooting(integrator=mr.RK4(100))


def hold_the_same_events(found, expected):
    """Of two motions: when, where to and how much energy is lost."""
    np.testing.assert_array_equal(found.status, expected.status)
    (mine,), (other,) = ([event for events in history.events for event in events] for history in (found, expected))
    assert mine.status == other.status == mr.Status.SNAPPED
    assert mine.time == pytest.approx(other.time, abs=1e-6)
    assert mine.energy_lost == pytest.approx(other.energy_lost, rel=1e-6)
    np.testing.assert_allclose(found.tip_position, expected.tip_position, rtol=0, atol=1e-7)


def test_tubes_snap_in_a_network_as_they_do_alone_and_as_legs():
    """A pair turned past its fold, then two pairs that hold a plate; and where a solve leads that begins beyond."""
    turn = np.linspace(0, 2 * np.pi, 41)
    rotation, force, options = (
        np.stack([0 * turn, turn], axis=-1),
        (0.02, 0.01, 0),
        {"time": turn, "solver": SNAPPING, "progress": False},
    )
    robot = mr.Network(rods={"arm": PAIR}, joints=[mr.Joint("arm", "base", to=mr.ground)])
    found = mr.simulate(robot, robot.inputs(rotation={"arm": rotation}, force={"arm": force}), **options)
    expected = mr.simulate(PAIR, PAIR.inputs(rotation=rotation, tip_force=force), **options)
    hold_the_same_events(found, expected)
    beyond = mr.solve(robot, robot.inputs(rotation={"arm": rotation[30]}, force={"arm": force}), solver=SNAPPING)
    same = mr.solve(PAIR, PAIR.inputs(rotation=rotation[30], tip_force=force), solver=SNAPPING)
    for solution in (beyond, same):
        assert (solution.status, solution.stability) == (mr.Status.LOWEST_ENERGY, mr.Stability.STABLE)
    np.testing.assert_allclose(beyond.tip_position, same.tip_position, rtol=0, atol=1e-7)
    feet, plate = np.array([at(0.05), at(-0.05)]), np.array([at(0.03), at(-0.03)])
    parallel = mr.ParallelRods(legs=[PAIR] * 2, base=feet, platform=plate, platform_mass=0.02)
    legs = np.concatenate([rotation, rotation / 6], axis=-1)
    stacked = mr.stacked(parallel, names=["plate"])
    motions = [mr.simulate(own, own.inputs(rotation=legs, gravity=GRAVITY), **options) for own in (stacked, parallel)]
    hold_the_same_events(*motions)
    beyond, same = (mr.solve(own, own.inputs(rotation=legs[26]), solver=SNAPPING) for own in (stacked, parallel))
    assert beyond.status == same.status == mr.Status.LOWEST_ENERGY
    np.testing.assert_allclose(beyond.tip_position, same.tip_position, rtol=0, atol=1e-7)


def test_what_drives_lines_is_checked():
    robot = tower(LINED)
    np.testing.assert_array_equal(robot.inputs(tension={"arm": 2.0}).tension, robot.inputs(tension=2.0).tension)
    with pytest.raises(ValueError, match=r"tension = 'wire' is not allowed: must be by name, one of 'arm'"):
        robot.inputs(tension={"wire": 1.0})
    with pytest.raises(ValueError, match="a tendon cannot push"):
        mr.solve(robot, robot.inputs(tension={"arm": -1.0}))
    ring = mr.Joint("arm", "along", at=0.1, to=mr.ground, pose=at(z=0.1), kind="spherical")
    with pytest.raises(ValueError, match=r"Network.rods\['arm'\].* must have no members and no lines: it slides"):
        mr.Network(rods={"arm": LINED}, joints=[mr.Joint("arm", "base", to=mr.ground), ring])
    with pytest.raises(ValueError, match=r"Network.rods\['arm'\].* must be a Rod: it slides"):
        mr.Network(rods={"arm": TUBES}, joints=[mr.Joint("arm", "base", to=mr.ground), ring])


def test_what_drives_lines_is_read_from_files_by_name(tmp_path):
    robot = mr.Network(rods={"arm": LINED}, joints=[mr.Joint("arm", "base", to=mr.ground)])
    text = 'version = 1\nkind = "Inputs"\ntension = {arm = 0.8}\npressure = {arm = 1e4}\n'
    (tmp_path / "inputs.toml").write_text(text, encoding="utf-8")
    read = mr.load(tmp_path / "inputs.toml", robot=robot)
    np.testing.assert_array_equal(read.tension, [0.8])
    np.testing.assert_array_equal(read.pressure, [1e4])


LENGTH, EI, LEVER = 0.2, 0.01, 0.008


def column(**line):
    """A rod between two lines of given length."""
    tendons = [mr.Tendon((sign * LEVER, 0), driven="displacement", **line) for sign in (1, -1)]
    return mr.Rod(length=LENGTH, bending_stiffness=EI, torsional_stiffness=0.0077, lines=tendons)


def compressed(robot, inputs, force, level=1.0):
    """Unstable modes of the straight column, its lines taut, and its residual [1/m]."""
    graph = isinstance(robot, mr.Network)
    # one rod is solved by itself but where the poses of its joints are varied
    problem = robot.problem(inputs, integrator=mr.RK4(50), **({"placed": True} if graph else {}))
    problem.load_factor.fill_(level)
    x = np.zeros((1, problem.unknown_count))
    x[:, 3:5] = 1e-3
    if graph:
        x[:, -1] = -level * force * LENGTH / EI
    residual, _ = problem.evaluate(x)
    modes = problem.stability.modes()
    assert modes.known.all()
    assert np.nanmax(modes.uncertainty) < 1e-5  # symmetric to what 50 steps leave
    return int(modes.hidden[0] + (modes.values[0] < 0).sum()), np.abs(residual).max()


@pytest.mark.parametrize("sparse", [False, True])
def test_a_column_between_lines_of_given_length_buckles_where_the_closed_form_says(sparse, monkeypatch):
    """In their plane two elastic ones are a spring ``k`` against turns of its tip, ``x cot x = -k L/EI``; on the way to the load,
    where kinks are rounded, the network still is the single rod."""
    if sparse:
        monkeypatch.setattr("multirod.models.network.stability.stability.SPARSE", 1)
        monkeypatch.setattr("multirod.models.network.stability.stability.NEAREST", 2)
    axial = 200.0
    rod = column(axial_stiffness=axial)
    network, single = mr.Network(rods={"arm": rod}, joints=[mr.Joint("arm", "base", to=mr.ground)]), mr.SingleRod(rod)
    spring = 2 * axial * LEVER**2 / LENGTH * LENGTH / EI
    x = brentq(lambda x: x / np.tan(x) + spring, np.pi / 2 + 1e-9, np.pi - 1e-9)
    for load, index in ((0.999 * np.pi**2 / 4, 0), (1.001 * np.pi**2 / 4, 1), (0.999 * x**2, 1), (1.001 * x**2, 2)):
        force = load * EI / LENGTH**2
        found, gap = compressed(network, network.inputs(force={"arm": (0, 0, -force)}), force)
        assert found == index
        assert gap < 1e-3  # the stretch that goes with lines just taut
        for level in (0.9, 0.5):
            inputs = network.inputs(force={"arm": (0, 0, -force / level)}), single.inputs(tip_force=(0, 0, -force / level))
            indices = [
                compressed(robot, own, force / level, level)[0] for robot, own in zip((network, single), inputs, strict=True)
            ]
            assert indices[0] == indices[1]


def test_lines_that_hold_a_column_halfway_count_as_in_a_single_rod():
    """Loads at which it buckles with its tip held, too, so that its rods have modes of their own, fewer with lengths held."""
    rod = column(end=LENGTH / 2, axial_stiffness=2e4)
    network, single = mr.Network(rods={"arm": rod}, joints=[mr.Joint("arm", "base", to=mr.ground)]), mr.SingleRod(rod)
    found = []
    for load in np.pi**2 * np.array([0.3, 0.9, 1.05, 1.6, 2.3, 3.1, 4.2, 6.0]):
        force = load * EI / LENGTH**2
        inputs = network.inputs(force={"arm": (0, 0, -force)}), single.inputs(tip_force=(0, 0, -force))
        found.append([compressed(robot, own, force)[0] for robot, own in zip((network, single), inputs, strict=True)])
    np.testing.assert_array_equal(*np.transpose(found))
    assert len({index for index, _ in found}) > 3


def test_arms_whose_lines_hold_the_turns_of_their_tips_are_judged():
    """In a plane the length of a tendon that does not stretch says how its arm's tip is turned: no tension is eliminated by it.
    What is very stiff comes close."""
    margins = []
    for axial in ({}, {"axial_stiffness": 1e6}):
        arm, top = column(**axial), mr.Body("top")
        feet = {"left": at(-0.05, turn=0.25), "right": at(0.05, turn=-0.25)}
        joints = [mr.Joint(name, "base", to=mr.ground, pose=pose, kind="revolute", axis=(0, 1, 0)) for name, pose in feet.items()]
        joints += [mr.Joint(name, "tip", to=top, pose=at(0, 0, 0, turn)) for name, turn in (("left", 0.25), ("right", -0.25))]
        robot = mr.Network(rods=dict.fromkeys(feet, arm), bodies=[top], joints=joints)
        pulled = {"left": (0.001, -0.01), "right": (-0.01, 0.001)}
        solution = mr.solve(robot, robot.inputs(displacement=pulled, force={"top": (0.05, 0.0, 0.02)})).raise_if_failed()
        assert solution.slack.tolist() == [False, True, True, False]
        assert solution.stability == mr.Stability.STABLE
        margins.append(solution.stability_margin)
    np.testing.assert_allclose(*margins, rtol=1e-3)  # EI/(r^2 EA) = 2e-4
