"""Where branches of networks end: against the robots that they make anew, and what their forces do work on."""

import numpy as np
import pytest
from scipy.optimize import brentq, minimize_scalar
from test_held_branches import COLUMN, EI, LEGS, LENGTH, PRECISE, STRIP, around, names, said
from test_network import GIVEN, chain, mixed, pose
from test_sliding import GIVEN as SLIDING
from test_sliding import threaded

import multirod as mr
from multirod.models.backbone.equal_steps import step_counts
from multirod.models.network.stability.conjugates import NetworkConjugates
from multirod.models.network.stability.in_clamps import in_clamps, short_enough
from multirod.rotations import vectors
from multirod.solvers.following.descent import Points
from multirod.solvers.following.serving.turns import Turns

PIECES = 6
STEEP = {name: value for name, value in GIVEN.items() if name != "moment"}  # loads with a potential
WEIGHTS = (1, -8, 8, -1)  # differences of the fourth order
PARTS = (-2, -1, 1, 2)


def clamped(robot, inputs):
    """A problem with clamps, and unknowns and moments by lot near where the search begins."""
    problem = robot.problem(inputs, integrator=mr.RK4(100), pose_sensitivities=True)
    x = problem.guess() + 0.3 * np.random.default_rng(1).normal(size=problem.unknown_count)
    part = problem.parts.clamped(np.arange(1), PIECES)
    part.joints.shut()
    return part, np.concatenate([x[0], 0.3 * np.random.default_rng(2).normal(size=part.clamps.size)])


def at(problem, x):
    """Integrate at unknowns and moments."""
    problem.write("unknowns", x[None, : problem.unknown_count])
    problem.clamps.put(x[None, problem.unknown_count :])
    problem.integrate()
    return problem.read("residual")[0]


def hold_columns_of_clamps(problem, x):
    """What unknowns and moments ``x`` do to the residual, and how they turn clamps, against differences."""
    n, clamps = problem.unknown_count, problem.clamps
    at(problem, x)
    clamps.pairs.update()
    frames = clamps.frames()[0]
    gamma = np.concatenate([problem.read("gamma").reshape(n, n), problem.residual_directions.numpy()[0]], axis=1)
    turned, rng = clamps.turned()[0], np.random.default_rng(0)
    for _ in range(6):
        way, step = rng.normal(size=len(x)), 1e-3
        eps, turns = np.zeros(n), np.zeros(len(turned))
        for weight, part in zip(WEIGHTS, PARTS, strict=True):
            eps += weight * at(problem, x + part * step * way) / (12 * step)
            relative = np.swapaxes(frames, 1, 2) @ clamps.frames()[0]
            turns += weight * vectors(relative).reshape(-1) / (12 * step)
        # differences of the fourth order of what changes by its own size
        np.testing.assert_allclose(gamma @ way, eps, rtol=0, atol=1e-8 * np.abs(eps).max())
        np.testing.assert_allclose(turned @ way, turns, rtol=0, atol=1e-8 * np.abs(turns).max())


def test_clamps_turn_and_move_with_the_bases_of_their_rods():
    """(26), (27), and what their moments do to the residual, by differences: bodies, joints, gravity and a load along rods."""
    robot = mixed("feeler")
    problem, x = clamped(robot, robot.inputs(**STEEP))
    n, clamps, rng, step = problem.unknown_count, problem.clamps, np.random.default_rng(0), 1e-3
    hold_columns_of_clamps(problem, x)
    # places are those of the nodes of rods on which no clamp bears
    x[n:] = 0
    at(problem, x)
    moved, way = clamps.moved()[0], np.append(rng.normal(size=n), np.zeros(clamps.size))
    places = 0.0
    plain = robot.problem(robot.inputs(**STEEP), integrator=mr.RK4(100))
    for weight, part in zip(WEIGHTS, PARTS, strict=True):
        plain.write("unknowns", (x + part * step * way)[None, :n])
        shapes, _ = plain.shapes.at_nodes(PIECES + 1)
        places = places + weight * np.concatenate([own.position[0, 1:-1] for own in shapes]) / (12 * step)
    np.testing.assert_allclose(moved @ way, places, rtol=0, atol=1e-8 * np.abs(places).max())


def hold_forces_against_the_potential(robot, given, push):
    """From a place off the equilibrium, where tips are joined, and those that are free have the force that they are to have."""
    inputs = robot.inputs(**given)
    found = mr.solve(robot, inputs, solver=mr.Shooting(integrator=mr.RK4(200))).raise_if_failed()
    problem = robot.problem(inputs, integrator=mr.RK4(200), pose_sensitivities=True)
    n, size, pairs = problem.unknown_count, problem.curvature_scale()[0], problem.conjugates
    x = found.unknowns[None]
    problem.evaluate(x)
    reduced, way = pairs.reduced(problem), np.random.default_rng(0).normal(size=len(pairs.forces))
    x = x + reduced.by[0] @ np.linalg.solve(reduced.form[0], push * pairs.stiffness * way)
    for _ in range(6):
        problem.evaluate(x)
        x = x + pairs.reduced(problem).towards
    eps, gamma = problem.evaluate(x)
    pairs.update()
    constraints = np.delete(np.arange(n), pairs.forces)
    np.testing.assert_allclose(eps[0, constraints], 0, atol=1e-9 * size)
    kept = np.linalg.svd(gamma[0, constraints])[2][len(constraints) :]
    expected = (pairs.unit.numpy()[0] * eps[0, pairs.forces]) @ pairs.columns.numpy()[0, :, :n] @ kept.T
    step, slope = 1e-3 * size, []
    for way in kept:
        energy = []
        for part in PARTS:
            problem.evaluate(x + part * step * way)
            energy.append(problem.stability.potential()[0])
        slope.append(np.dot(WEIGHTS, energy) / (12 * step))
    # the gap that constraints of the second order leave, times the force there, is even: differences do not see it
    np.testing.assert_allclose(slope, expected, rtol=0, atol=1e-6 * np.abs(expected).max())


def test_forces_are_the_slope_of_the_potential():
    """(25) Of bodies, springs in joints of all kinds, a tip that is free; of where holes are, and turns in them."""
    hold_forces_against_the_potential(mixed(), STEEP, push=0.05)
    hold_forces_against_the_potential(threaded(), SLIDING, push=0.005)


def slope_of(problem, x):
    """The energy at unknowns (1, n), to second order."""
    turns = Turns(problem.conjugates)
    residual, gamma = problem.evaluate(x)
    unit, turned = turns.after(gamma)
    moved = problem.pose_columns.numpy()[:, None, :3, : problem.unknown_count]
    pose = problem.read("position"), problem.read("rotation").reshape(-1, 1, 3, 3)
    points = Points(x, np.ones(1), residual, gamma, turns.forces, unit, turned, moved, *pose, turns.stiffness)
    return points[0].slope


def test_the_slope_after_a_step_is_foretold_to_first_order():
    """(9) Far from any equilibrium, where ``A`` is not symmetric: what is missed falls by four as the step is halved."""
    robot = mixed()
    problem = robot.problem(robot.inputs(**STEEP), integrator=mr.RK4(200), pose_sensitivities=True)
    found = mr.solve(robot, robot.inputs(**STEEP), solver=mr.Shooting(integrator=mr.RK4(200))).raise_if_failed()
    rng, x = np.random.default_rng(0), np.array(found.unknowns)[None]
    for push in (0.1, *[0.0] * 6):  # then back to the constraints
        slope = slope_of(problem, x)
        x = x + slope.back + slope.change(slope.modes @ (push * rng.normal(size=len(slope.values)) / np.maximum(1, slope.values)))
    slope = slope_of(problem, x)
    assert np.abs(slope.by_turns - slope.by_turns.T).max() > 0.1  # of K/L
    way, missed = rng.normal(size=len(slope.values)) / np.maximum(1, slope.values), []
    for size in (2e-3, 1e-3):
        there = slope_of(problem, x + slope.change(slope.modes @ (size * way)))
        missed.append(slope.missed(size * way, there))
    np.testing.assert_allclose(missed[0] / missed[1], 4.0, rtol=0.05)  # what is of the third order in steps of this size


def test_there_is_a_potential_while_the_network_is_put_together():
    """(29) The form is symmetric on the way too: bases turn in joints and on bodies, and gaps are not closed yet."""
    robot = mixed("feeler")
    problem = robot.problem(robot.inputs(**STEEP), integrator=mr.RK4(200), pose_sensitivities=True)
    x = problem.guess()
    for level in (0.1, 0.2, 0.3, 0.4):
        for _ in range(8):
            with problem.at_load(level):
                eps, gamma = problem.evaluate(x)
            x = x - np.linalg.solve(gamma[0], eps[0])
    with problem.at_load(level):
        assert np.abs(problem.evaluate(x)[0]).max() < 1e-9
    assert np.abs(problem.closing.shift).max() > 0.01 * 0.4
    form = NetworkConjugates(problem, turns_alone=True).reduced(problem).form[0]
    # what rods give way by along themselves on the way, a hundredth of L^3/EI, leaves 0.0024; with the gap in (7) it is 0.14
    np.testing.assert_allclose(form, form.T, rtol=0, atol=0.005 * np.abs(form).max())


def test_equal_steps_are_counted_by_the_rod_that_is_bent_the_most():
    """Of all builds of rods, however many each has: twenty a radian."""
    own = {"length": 0.3, "bending_stiffness": 0.1, "torsional_stiffness": 0.1}
    ring = mr.Rod(**own, precurvature=(50, 0, 0), lines=[mr.Tendon((0.004, 0))])
    body = mr.Body("body")
    joints = [mr.Joint(name, "base", to=mr.ground) for name in ("one", "two")]
    joints += [mr.Joint(name, "tip", to=body) for name in ("one", "two")] + [mr.Joint("ring", "base", to=body)]
    straight = mr.Rod(**own)
    robot = mr.Network(rods={"one": straight, "two": straight, "ring": ring}, bodies=[body], joints=joints)
    problem = robot.problem(robot.inputs(force=np.zeros((2, 6))), integrator=mr.RK45())
    assert len(problem.groups) == 2
    np.testing.assert_array_equal(step_counts([group.backbones for group in problem.groups], 2), 300)
    assert [own.tolist() for own in problem.parts.kinds(np.arange(2))] == [[0, 1]]


# ---- the robots that networks make anew ----

TIME = np.linspace(0, 5, 26)
PUSHED = np.stack(
    [0.5 * np.sin(np.pi * np.clip(TIME - 2, 0, 3) / 2), 0 * TIME, -1.5 * np.clip(TIME / 2, 0, 1)], axis=-1
)  # pressed until a column has buckled, then pushed to and fro


def hold_alike(found, expected, energy=1.0):
    """Statuses, events and places of two motions."""
    found.raise_if_failed()
    np.testing.assert_array_equal(found.status, expected.status)
    assert (found.stability == mr.Stability.STABLE).all()
    np.testing.assert_allclose(found.tip_position, expected.tip_position, rtol=0, atol=1e-6 * LENGTH)
    for event, other in zip(said(found), said(expected), strict=True):
        assert (event.status, event.fold) == (other.status, other.fold)
        # a branch is followed to within 1e-7 of its end
        assert event.time == pytest.approx(other.time, abs=1e-6)
        # stationary where it ends, so as exact as the integrator
        assert energy * event.energy_lost == pytest.approx(other.energy_lost, rel=1e-6, abs=1e-12)


@pytest.fixture(scope="module")
def column():
    robot = mr.SingleRod(STRIP)
    return mr.simulate(robot, robot.inputs(tip_force=COLUMN * PUSHED), time=TIME, solver=mr.Shooting(integrator=mr.RK4(100)))


@pytest.mark.parametrize("count", [1, 4])
def test_a_column_in_pieces_buckles_and_snaps_as_one(column, count):
    piece = mr.Rod(length=LENGTH / count, bending_stiffness=(4 * EI, EI), torsional_stiffness=0.015)
    robot = chain(piece, count)
    inputs = robot.inputs(force={f"disc {count - 1}": COLUMN * PUSHED})
    solver = mr.Shooting(integrator=mr.RK4(100 // count))
    hold_alike(mr.simulate(robot, inputs, time=TIME, solver=solver), column)
    assert names(column) == ["BIFURCATED", "SNAPPED"]
    raised = mr.solve(robot, inputs[10], solver=solver)
    assert raised.status is mr.Status.BIFURCATED
    assert raised.events[0].load_factor == pytest.approx(1 / 1.5, rel=1e-6)
    np.testing.assert_allclose(raised.tip_position, column.tip_position[10], rtol=0, atol=1e-6 * LENGTH)


def test_stacked_legs_are_parallel_rods_in_solve_motion_and_tracker():
    """With ``side="negative"``, too; a tracker takes the same samples one by one."""
    robot = mr.ParallelRods(legs=[STRIP] * LEGS, base=around(0.1), platform=around(0.1), joints=["spherical"] * LEGS)
    network = mr.stacked(robot)
    force = LEGS * COLUMN * PUSHED
    legs = mr.simulate(robot, robot.inputs(tip_force=force), time=TIME, solver=PRECISE)
    found = mr.simulate(network, network.inputs(force=force), time=TIME, solver=PRECISE)
    hold_alike(found, legs)
    tracker = mr.Tracker(network, solver=PRECISE, dt=TIME[1])
    samples = [tracker.step(force=own) for own in force[:12]]
    assert [sample.status for sample in samples] == [mr.Status(k) for k in found.status[:12]]
    np.testing.assert_allclose([sample.tip_position for sample in samples], found.tip_position[:12], rtol=0, atol=1e-12)
    twin = mr.solve(network, network.inputs(force=force[10]), solver=mr.Shooting(integrator=mr.RK4(50), side="negative"))
    np.testing.assert_allclose(twin.tip_position, found.tip_position[10] * (-1, -1, 1), rtol=0, atol=1e-6 * LENGTH)


def test_an_arch_between_grounds_is_that_of_a_held_rod():
    """Its base pushed in by a tenth, then pressed from above."""
    time = np.linspace(0, 2, 21)
    longer, load = 0.1 * LENGTH * np.clip(time, 0.05, 1), np.zeros((len(time), 3))
    load[:, 0] = -100 * EI / LENGTH**3 * np.clip(time - 1, 0, 1)
    held = mr.HeldRod(STRIP)
    expected = mr.simulate(
        held, held.inputs(translation=longer[:, None], distributed_force=load), time=time, solver=PRECISE
    ).raise_if_failed()
    whisker = mr.Rod(length=0.1, bending_stiffness=EI, torsional_stiffness=EI)  # for there is to be an end effector
    joints = [mr.Joint("rod", "base", to=mr.ground), mr.Joint("rod", "tip", to=mr.ground, pose=pose(position=(0, 0, LENGTH)))]
    robot = mr.Network(rods={"rod": STRIP, "whisker": whisker}, joints=[*joints, mr.Joint("whisker", "base", to=mr.ground)])
    inputs = robot.inputs(translation={"rod": longer}, distributed_force=load)
    found = mr.simulate(robot, inputs, time=time, solver=PRECISE).raise_if_failed()
    assert names(found)[-1:] == names(expected) == ["SNAPPED"]
    event, other = said(found)[-1], said(expected)[-1]
    assert event.time == pytest.approx(other.time, abs=1e-6)
    # the whisker loses nothing
    assert event.energy_lost == pytest.approx(other.energy_lost, rel=1e-6)
    places = found.rod("rod").position, expected.rod(0).position
    np.testing.assert_allclose(*places, rtol=0, atol=1e-6 * LENGTH)


def test_a_shallow_truss_snaps_through_as_springs_do():
    """Von Mises' truss: bars that stretch, on hinges. ``F = 2 EA (1 - l/l_0) z/l`` where they do not bend."""
    span, height, stretching = 0.2, 0.03, 2000.0
    length = float(np.hypot(span, height))
    bar = mr.Rod(length=length, bending_stiffness=0.4, torsional_stiffness=0.3, axial_stiffness=stretching)
    tilt = float(np.arctan2(span, height))
    apex, joints = mr.Body("apex"), []
    for name, side in (("left", -1), ("right", 1)):
        along = (0, -side * tilt, 0)
        hinge = {"kind": "revolute", "axis": (0, 1, 0)}
        joints.append(mr.Joint(name, "base", to=mr.ground, pose=pose(along, (side * span, 0, 0)), **hinge))
        joints.append(mr.Joint(name, "tip", to=apex, pose=pose(along), **(hinge if side > 0 else {})))
    robot = mr.Network(rods={"left": bar, "right": bar}, bodies=[apex], joints=joints)

    def force(z):
        own = np.hypot(span, z)
        return 2 * stretching * (1 - own / length) * z / own

    def energy(z):
        return stretching * (length - np.hypot(span, z)) ** 2 / length + limit * z

    top = minimize_scalar(lambda z: -force(z), bounds=(0, height), method="bounded", options={"xatol": 1e-12}).x
    limit = force(top)
    below = brentq(lambda z: force(z) - limit, -0.1, -height)
    found = mr.solve(robot, robot.inputs(force={"apex": (0, 0, -1.2 * limit)}), solver=PRECISE)
    assert found.status is mr.Status.SNAPPED
    assert found.stability is mr.Stability.STABLE
    (event,) = found.events
    assert event.fold
    # where a branch ends within 1e-7
    assert event.load_factor == pytest.approx(1 / 1.2, rel=1e-6)
    assert event.energy_lost == pytest.approx(energy(top) - energy(below), rel=1e-5)
    goal = brentq(lambda z: force(z) - 1.2 * limit, -0.1, -height)
    np.testing.assert_allclose(found.tip_position, (0, 0, goal), rtol=0, atol=1e-7 * span)


def swaying_frame():
    """Two strips side by side, clamped in the ground and in a beam, and the load at which it begins to sway."""
    strip = mr.Rod(length=0.2, bending_stiffness=(0.5, 0.02), torsional_stiffness=0.015)
    beam, joints = mr.Body("beam"), []
    for name, side in (("left", -1), ("right", 1)):
        there = pose(position=(0.1 * side, 0, 0))
        joints += [mr.Joint(name, "base", to=mr.ground, pose=there), mr.Joint(name, "tip", to=beam, pose=there)]
    robot = mr.Network(rods={"left": strip, "right": strip}, bodies=[beam], joints=joints)
    return robot, 2 * np.pi**2 * 0.02 / 0.2**2


def test_step_control_ends_branches_where_fixed_steps_do():
    """A frame of two strips that sways, by the default integrator: of straight rods its steps are long."""
    robot, euler = swaying_frame()
    found = mr.solve(robot, robot.inputs(force={"beam": (0, 0, -1.1 * euler)}))
    assert found.status is mr.Status.BIFURCATED
    assert found.stability is mr.Stability.STABLE
    assert found.events[0].load_factor == pytest.approx(1 / 1.1, rel=1e-6)


def test_what_is_to_stop_at_the_end_of_its_branch_gives_no_state_beyond():
    """Nor any other that is stable; below the load at which the frame sways it makes no difference."""
    robot, euler = swaying_frame()
    stop = mr.Shooting(at_fold="stop")
    beyond = mr.solve(robot, robot.inputs(force={"beam": (0, 0, -1.1 * euler)}), solver=stop)
    assert beyond.status is mr.Status.BRANCH_END
    assert np.isnan(beyond.tip_position).all()
    below = robot.inputs(force={"beam": (0, 0, -0.9 * euler)})
    stopped, followed = mr.solve(robot, below, solver=stop), mr.solve(robot, below)
    assert stopped.status is followed.status is mr.Status.CONVERGED
    np.testing.assert_array_equal(stopped.unknowns, followed.unknowns)


def test_energy_descent_goes_through_the_snap():
    """At one integration a sample, and from loads that come all at once: joints of all kinds, springs, a tip that is free."""
    robot = mr.stacked(mr.ParallelRods(legs=[STRIP] * LEGS, base=around(0.1), platform=around(0.1), joints="spherical"))
    time = np.linspace(0, 5, 251)
    press, push = -1.5 * np.clip(time / 2, 0, 1), 0.5 * np.sin(np.pi * np.clip(time - 2, 0, 3) / 2) + 0.001
    inputs = robot.inputs(force=LEGS * COLUMN * np.stack([push, 0 * time, press], axis=-1))
    history = mr.simulate(robot, inputs, time=time, solver=mr.EnergyDescent(integrator=mr.RK4(50)))
    assert (history.integrations[1:] == 1).all()
    expected = mr.simulate(robot, inputs[::10], time=time[::10], solver=PRECISE).raise_if_failed()
    assert names(expected) == ["SNAPPED"]
    calm = np.abs(history.tip_position[::10] - expected.tip_position).max(axis=1) < 1e-3 * LENGTH
    # as it buckles and as it snaps it is on the way for a part of a second, and says so
    assert (history.status[::10][~calm] == mr.Status.NEAR_FOLD).all()
    assert calm.sum() >= len(calm) - 3
    assert calm[-1]
    robot = mixed("feeler")
    solvers = mr.EnergyDescent(integrator=mr.RK4(100)), mr.Shooting(integrator=mr.RK4(100))
    descended, solved = (mr.solve(robot, robot.inputs(**GIVEN), solver=solver).raise_if_failed() for solver in solvers)
    np.testing.assert_allclose(descended.tip_position, solved.tip_position, rtol=0, atol=1e-8)


def test_two_struts_that_buckle_while_joints_close_carry_their_critical_load():
    """Legs that lean by as much bend by less if they are hinged across: those are pressed until both buckle at once, just before
    the joints are closed."""
    wire = mr.Rod.wire(length=0.3, diameter=2e-3, young_modulus=60e9, shear_modulus=23e9)
    plate, joints = mr.Body("plate"), []
    for k, turn in enumerate(np.radians([0, 90, 180, 270])):
        kind = {"kind": "revolute", "axis": (1, 0, 0)} if k % 2 else {}
        for end, to, radius in (("base", mr.ground, 0.06), ("tip", plate, 0.05)):
            pose = np.eye(4)
            pose[:2, 3] = radius * np.cos(turn), radius * np.sin(turn)
            joints.append(mr.Joint(f"leg {k}", end, to=to, pose=pose, **kind))
    robot = mr.Network(rods={f"leg {k}": wire for k in range(4)}, bodies=[plate], joints=joints)
    found = mr.solve(robot, robot.inputs())
    assert (found.status, found.stability) == (mr.Status.BIFURCATED, mr.Stability.STABLE)
    critical = np.pi**2 * 60e9 * np.pi / 64 * (2e-3) ** 4 / 0.3**2
    for leg in (1, 3):
        pressed = np.linalg.norm(found.rod(f"leg {leg}").force[0])
        np.testing.assert_allclose(pressed, critical, rtol=5e-3)  # bent by a hundredth or two, they carry a little more


@pytest.mark.parametrize("pieces", [1, 2])
def test_a_round_rod_that_is_pushed_on_its_axis_buckles_to_the_side_of_the_rule(pieces):
    """It may be turned about that, which no end shows, and alone each half may be."""
    push, given = 0.01, {"bending_stiffness": 0.02, "torsional_stiffness": 0.015}
    bodies = [mr.Body("end", fixed=True, pose=pose(position=(0, 0, 0.3)))]
    joints = [mr.Joint("lower", "base", to=mr.ground)]
    if pieces == 2:
        bodies.append(mr.Body("middle", pose=pose(position=(0, 0, 0.15))))
        joints += [mr.Joint("lower", "tip", to=bodies[1]), mr.Joint("upper", "base", to=bodies[1])]
    joints.append(mr.Joint("upper" if pieces == 2 else "lower", "tip", to=bodies[0]))
    rods = {name: mr.Rod(length=0.3 / pieces, **given) for name in ("lower", "upper")[:pieces]}
    robot = mr.Network(rods=rods, bodies=bodies, joints=joints)
    inputs = robot.inputs(fixed_position={"end": (0, 0, -push)})
    found, twin = (mr.solve(robot, inputs, solver=mr.Shooting(side=side)) for side in ("positive", "negative"))
    held = mr.HeldRod(mr.Rod(length=0.3, **given))
    expected = mr.solve(held, held.inputs(end_position=(0, 0, -push)))
    assert found.status is twin.status is mr.Status.BIFURCATED
    assert found.stability is mr.Stability.FOLD
    assert found.events[0].neutral == 1
    assert found.index == 0
    assert int(found.integrations) < 600  # looks with clamps are six each: 324 to 423 were measured
    for own in (found, twin):
        assert float(own.potential) == pytest.approx(float(expected.potential), rel=1e-8)
    pushes = np.linspace(push / 4, push, 4)
    ways = np.stack([0 * pushes, 0 * pushes, -pushes], axis=-1)
    motion = mr.simulate(robot, robot.inputs(fixed_position={"end": ways}), time=pushes).raise_if_failed()
    assert names(motion) == ["BIFURCATED"]
    assert float(motion.potential[-1]) == pytest.approx(float(expected.potential), rel=1e-8)
    nodes = 2 if pieces == 2 else 3
    top, below = (own.rod("lower", nodes=nodes).position[1] for own in (found, twin))
    middle = expected.rod(0, nodes=3).position[1]
    # turned about the axis by 0.01 rad at most, which costs nothing
    aside = np.hypot(*middle[:2])
    for own, side in ((top, 1), (below, -1)):
        np.testing.assert_allclose(own, [side * aside, 0, middle[2]], rtol=0, atol=0.02 * aside)


@pytest.mark.filterwarnings("ignore:the 50000 integrations")  # nine states will do
def test_clamps_count_as_many_modes_as_forces_and_turns_of_ends_do():
    """(45) against (16), at equilibria whose pieces are short enough."""
    top = pose(position=(0, 0, 0.9 * LENGTH))
    joints = [mr.Joint("rod", "base", to=mr.ground), mr.Joint("rod", "tip", to=mr.ground, pose=top)]
    whisker = mr.Rod(length=0.1, bending_stiffness=EI, torsional_stiffness=EI)
    robot = mr.Network(rods={"rod": STRIP, "whisker": whisker}, joints=[*joints, mr.Joint("whisker", "base", to=mr.ground)])
    states = mr.equilibria(robot, robot.inputs())
    known = np.flatnonzero(states.stability != mr.Stability.UNKNOWN)
    counted = []
    for k in known:
        problem = robot.problem(robot.inputs(), integrator=mr.RK4(100))
        problem.evaluate(states.unknowns[k][None])
        with problem.everyone():
            problem.integrate_rods()
        if not short_enough(problem)[0]:
            continue
        told = in_clamps(problem, np.arange(1))
        index = int((told.values[0] < -1e-6).sum())
        assert index == states.index[k]
        assert told.uncertainty[0].max() < 1e-3 * np.abs(told.values[0]).max()
        counted.append(index)
    assert set(counted) == {0, 1}


def arch_of_halves(mirrored):
    """On two hinges, pressed at its crown, where its halves meet: integrated as mirror images, or one after the other."""
    half = mr.Rod(length=0.15, bending_stiffness=(40 * EI, EI), torsional_stiffness=20 * EI, axial_stiffness=1e5 * EI)
    slope, about = 0.6, (0, 1, 0)

    def place(x, z, pitch):
        return pose((0, pitch, 0), (x, 0, z))

    feet = [place(sign * 0.15 * np.cos(slope), 0, np.pi / 2 + sign * slope) for sign in (-1, 1)]
    crown = mr.Body("crown", pose=place(0, 0.15 * np.sin(slope), np.pi / 2))
    joints = [
        mr.Joint("left", "base", to=mr.ground, pose=feet[0], kind="revolute", axis=about),
        mr.Joint("left", "tip", to=crown),
    ]
    if mirrored:
        back = place(0, 0, np.pi)
        joints += [
            mr.Joint("right", "base", to=mr.ground, pose=feet[1] @ back, kind="revolute", axis=about),
            mr.Joint("right", "tip", to=crown, pose=back),
        ]
    else:
        joints += [
            mr.Joint("right", "base", to=crown),
            mr.Joint("right", "tip", to=mr.ground, pose=feet[1], kind="revolute", axis=about),
        ]
    return mr.Network(rods={"left": half, "right": half}, bodies=[crown], joints=joints)


@pytest.mark.parametrize("steps", [None, 20], ids=["step control", "few steps"])
def test_an_arch_leaves_symmetry_to_the_side_of_the_rule_though_errors_tell_another(steps):
    """Of halves that are integrated one after the other, errors act as a load across: short steps went round the bend."""
    integrator = mr.RK45() if steps is None else mr.RK4(steps)
    longer, press = 0.15 * np.array([0.84, 0.86, 0.88, 0.9]), 12 * EI / 0.09

    def moved(mirrored=False, side="positive", across=0.0):
        robot = arch_of_halves(mirrored)
        inputs = robot.inputs(force={"crown": (across * press, 0, -press)}, translation={"left": longer, "right": longer})
        solver = mr.Shooting(integrator=integrator, side=side)
        return mr.simulate(robot, inputs, time=np.arange(4.0), solver=solver).raise_if_failed()

    expected = moved(mirrored=True)
    assert names(expected) == ["BIFURCATED"]
    for side, sign in (("positive", 1), ("negative", -1)):
        found = moved(side=side)
        assert names(found) == ["BIFURCATED"]
        (event,), (other,) = said(found), said(expected)
        assert (event.fold, event.energy_lost) == (False, 0)
        assert event.time == pytest.approx(other.time, abs=1e-5 if steps is None else 1e-3)  # told by finer ones
        assert found.stability[-1] is mr.Stability.STABLE
        # errors of the few steps move it by as much as a load of a millionth does
        np.testing.assert_allclose(found.tip_position[-1], expected.tip_position[-1] * (sign, 1, 1), rtol=0, atol=1e-5)
        assert sign * found.tip_position[-1, 0] > 0.01
    # a load that is more than errors decides, and nothing crosses
    for side in ("positive", "negative"):
        found = moved(side=side, across=-1e-5)
        assert names(found) == []
        assert found.tip_position[-1, 0] < -0.01


def test_a_sample_of_a_network_does_not_pass_two_bifurcations_unseen():
    """A strip on edge that holds a body, pushed along its width by seven times what tips it over: ``Gamma`` is as at first."""
    strip = mr.Rod(length=0.3, bending_stiffness=(0.642, 0.02), torsional_stiffness=6.1378e-3)
    body = mr.Body("body")
    joints = [mr.Joint("strip", "base", to=mr.ground), mr.Joint("strip", "tip", to=body)]
    robot = mr.Network(rods={"strip": strip}, bodies=[body], joints=joints)
    time = np.linspace(0, 1, 3)
    push = np.stack([0 * time, 3.53 * time, 0 * time], axis=-1)
    history = mr.simulate(robot, robot.inputs(force=push), time=time)
    assert history.status[1] is mr.Status.BIFURCATED
    assert (history.stability == mr.Stability.STABLE).all()


def test_clamps_beside_rods_in_holes_turn_and_move_with_the_bases_of_theirs():
    """(26), (27), and what their moments do to the residual, by differences; the rod in the holes has none."""
    robot = threaded()
    problem, x = clamped(robot, robot.inputs(**SLIDING))
    assert problem.clamps.size == 3 * 5 * 3  # of three rods, cut into six
    hold_columns_of_clamps(problem, x)


def test_struts_beside_a_straight_guide_sway_where_beams_do():
    """A carriage on a guide, pushed down on two struts beside it: guide and struts bend to one side together, as their stiffness
    by its way and turn, (2 P of the struts) of a beam under thrust, becomes singular. The straight guide answers no push."""
    L = 0.2
    guide = mr.Rod(length=2 * L, bending_stiffness=50 * EI, torsional_stiffness=50 * EI)
    strut = mr.Rod(length=L, bending_stiffness=EI, torsional_stiffness=EI)
    carriage = mr.Body("carriage")
    joints = [
        mr.Joint("guide", "base", to=mr.ground),
        mr.Joint("guide", "along", at=L, to=carriage, kind="prismatic"),
    ]
    for name, x in (("left", -0.05), ("right", 0.05)):
        foot = pose(position=(x, 0, 0))
        joints += [mr.Joint(name, "base", to=mr.ground, pose=foot), mr.Joint(name, "tip", to=carriage, pose=foot)]
    robot = mr.Network(rods={"guide": guide, "left": strut, "right": strut}, bodies=[carriage], joints=joints)

    def stiffness(thrust):  # of both, per EI of a strut, the thrust on one in EI/L^2
        f = np.sqrt(thrust)
        v, m, t = f**3 * np.sin(f), f**2 * (1 - np.cos(f)), f * (np.sin(f) - f * np.cos(f))
        struts = np.array([[v, -m], [-m, t]]) / (2 - 2 * np.cos(f) - f * np.sin(f))
        return 2 * struts + 50 * np.array([[12, -6], [-6, 4]])

    critical = brentq(lambda thrust: np.linalg.det(stiffness(thrust)), 20.0, 39.0)
    push = 1.1 * critical
    found = mr.solve(robot, robot.inputs(force={"carriage": (0, 0, -2 * push * EI / L**2)})).raise_if_failed()
    (event,) = found.events
    assert found.status is event.status is mr.Status.BIFURCATED
    assert event.load_factor == pytest.approx(1 / 1.1, rel=1e-5)
    np.testing.assert_allclose(np.abs(event.tip_displacement), (0, 1, 0), atol=1e-3)
    assert found.stability is mr.Stability.STABLE
