"""Rods and bodies in a graph: against the robots that it makes anew, differences, and the balance of every body."""

import numpy as np
import pytest
from conftest import rodrigues
from random_networks import draw, state_of, violation
from test_check_assembly import check_assembly

import multirod as mr

RK4 = mr.RK4(50)
EXACT = mr.Shooting(tolerance=1e-11, integrator=RK4)
FINE = mr.Shooting(tolerance=1e-11, integrator=mr.RK4(400))  # whose steps of a free rod and of a held one agree to 1e-11
LEG = mr.Rod.tube(length=0.4, outer_diameter=2e-3, young_modulus=200e9, shear_modulus=80e9, density=7850.0)
BASE_ANGLES, PLATE_ANGLES = (-10, 10, 110, 130, 230, 250), (-50, 50, 70, 170, 190, 290)
X = (1, 0, 0)
FORCE, GRAVITY = np.array([0.5, -0.3, -2.0]), np.array([0, 0, -9.81])


def pose(turn=(0, 0, 0), position=(0, 0, 0)):
    result = np.eye(4)
    result[:3, :3], result[:3, 3] = rodrigues(turn), position
    return result


def circle(degrees, radius):
    return np.array([pose(position=radius * np.array([np.cos(a), np.sin(a), 0])) for a in np.radians(degrees)])


def legs(count=6):
    return {f"leg {k}": LEG for k in range(count)}


def hexapod(kind="clamped", heavy=True):
    plate = mr.Body("plate", mass=0.1, mass_centre=(0.01, 0.02, 0.03)) if heavy else mr.Body("plate")
    on_ground, on_plate = circle(BASE_ANGLES, 0.087), circle(PLATE_ANGLES, 0.087)
    axis = {"revolute": X, "universal": np.eye(3)[:2]}.get(kind)
    joints = [mr.Joint(f"leg {k}", "base", to=mr.ground, pose=on_ground[k]) for k in range(6)]
    joints += [mr.Joint(f"leg {k}", "tip", to=plate, pose=on_plate[k], kind=kind, axis=axis) for k in range(6)]
    return mr.Network(rods=legs(), bodies=[plate], joints=joints)


def chain(rod, count):
    """A rod cut into pieces that are clamped to bodies without mass."""
    discs = [mr.Body(f"disc {k}") for k in range(count)]
    joints = []
    for k, disc in enumerate(discs):
        joints.append(mr.Joint(f"piece {k}", "base", to=discs[k - 1] if k else mr.ground))
        joints.append(mr.Joint(f"piece {k}", "tip", to=disc))
    return mr.Network(rods={f"piece {k}": rod for k in range(count)}, bodies=discs, joints=joints)


def test_one_rod_is_a_single_rod(wire):
    """Its tip free, or held by a body without mass."""
    single = mr.SingleRod(wire)
    expected = mr.solve(single, single.inputs(rotation=0.3, tip_force=(1, 0.2, 0.1), tip_moment=(0, 0.05, 0)), solver=FINE)
    tip = mr.Body("tip")
    joints = [mr.Joint("wire", "base", to=mr.ground), mr.Joint("wire", "tip", to=tip)]
    for robot in (
        mr.Network(rods={"wire": wire}, joints=joints[:1]),
        mr.Network(rods={"wire": wire}, bodies=[tip], joints=joints),
    ):
        found = mr.solve(robot, robot.inputs(rotation=0.3, force=(1, 0.2, 0.1), moment=(0, 0.05, 0)), solver=FINE)
        # the same steps of the same equations; residuals of 1e-11, and a tip that answers the base by less than one
        np.testing.assert_allclose(found.tip_position, expected.tip_position, atol=1e-11)
        np.testing.assert_allclose(found.tip_rotation, expected.tip_rotation, atol=1e-10)
        np.testing.assert_allclose(found.energy, expected.energy, rtol=1e-9)
        np.testing.assert_allclose(found.rod("wire").moment, expected.rod(0).moment, atol=1e-9)


@pytest.mark.parametrize("kind", ["clamped", "revolute", "spherical"])
def test_six_legs_are_parallel_rods(kind):
    parallel = mr.ParallelRods(
        legs=[LEG] * 6,
        base=circle(BASE_ANGLES, 0.087),
        platform=circle(PLATE_ANGLES, 0.087),
        joints=kind,
        joint_axes=(1, 0, 0) if kind == "revolute" else None,
        platform_mass=0.1,
        platform_centre=(0.01, 0.02, 0.03),
    )
    given = {"rotation": 0.2, "translation": np.array([0.01, 0, 0, -0.01, 0, 0.005]), "gravity": GRAVITY}
    expected = mr.solve(parallel, parallel.inputs(tip_force=FORCE, tip_moment=(0.01, 0, 0.02), **given), solver=EXACT)
    robot = hexapod(kind)
    found = mr.solve(robot, robot.inputs(force={"plate": FORCE}, moment=(0.01, 0, 0.02), **given), solver=EXACT)
    np.testing.assert_allclose(found.tip_position, expected.tip_position, atol=1e-10)
    np.testing.assert_allclose(found.tip_rotation, expected.tip_rotation, atol=1e-10)
    np.testing.assert_allclose(found.energy, expected.energy, rtol=1e-9)
    for k in range(6):
        for name in ("position", "rotation", "moment", "force"):
            values = getattr(expected.rod(k), name)
            np.testing.assert_allclose(getattr(found.rod(f"leg {k}"), name), values, rtol=1e-9, atol=1e-9)
    columns = found.jacobian("force", "rotation"), expected.jacobian("tip_force", "rotation")
    np.testing.assert_allclose(columns[0], columns[1], rtol=1e-7, atol=1e-9)


@pytest.mark.filterwarnings("ignore:.*bends .* degrees")  # so short pieces
@pytest.mark.parametrize("count", [2, 4, 8, 64])
def test_a_chain_is_one_rod(count):
    whole = mr.Rod(
        length=0.4, bending_stiffness=(0.2233, 0.3), torsional_stiffness=0.0638, precurvature=(4, 2, 1), linear_density=0.05
    )
    piece = mr.Rod(
        length=0.4 / count,
        bending_stiffness=(0.2233, 0.3),
        torsional_stiffness=0.0638,
        precurvature=(4, 2, 1),
        linear_density=0.05,
    )
    single, robot = mr.SingleRod(whole), chain(piece, count)
    given = {"gravity": (0, 3.0, -9.81), "distributed_force": (0.5, 0.2, 0.1)}
    expected = mr.solve(single, single.inputs(tip_force=(0.8, 0.2, -0.5), **given), solver=FINE)
    steps = mr.Shooting(tolerance=1e-11, integrator=mr.RK4(400 // count + 1))
    found = mr.solve(robot, robot.inputs(force={f"disc {count - 1}": (0.8, 0.2, -0.5)}, **given), solver=steps)
    np.testing.assert_allclose(found.tip_position, expected.tip_position, atol=1e-9)
    np.testing.assert_allclose(found.tip_rotation, expected.tip_rotation, atol=1e-9)
    np.testing.assert_allclose(found.energy, expected.energy, rtol=1e-9)
    np.testing.assert_allclose(found.rod(0).moment[0], expected.rod(0).moment[0], atol=1e-9)


@pytest.mark.filterwarnings("ignore:rotation = .* does nothing")  # which is tested of all
def test_a_rod_between_grounds_is_a_held_rod():
    rod = mr.Rod(
        length=0.4, bending_stiffness=(0.2233, 0.3), torsional_stiffness=0.0638, precurvature=(1.0, 0.3, 0.5), linear_density=0.02
    )
    end = pose((0.3, -0.2, 0.5), (0.07, 0.03, 0.32))
    for kind, base in (("clamped", "clamped"), ("spherical", "revolute"), ("revolute", "spherical")):
        axis = (0.6, 0, 0.8)
        axes = {f"{name}_axis": axis for name, how in (("joint", kind), ("base_joint", base)) if how == "revolute"}
        held = mr.HeldRod(rod, end=end, joint=kind, base_joint=base, **axes)
        given = {"rotation": 0.3, "gravity": (0, 1, 2.0), "distributed_force": (0.2, 0.5, -0.1)}
        expected = mr.solve(held, held.inputs(**given), solver=EXACT)
        joints = [
            mr.Joint("rod", at, to=mr.ground, pose=where, kind=how, axis=axis if how == "revolute" else None)
            for at, where, how in (("base", np.eye(4), base), ("tip", end, kind))
        ]
        whisker = mr.Joint("whisker", "base", to=mr.ground)  # for there is to be an end effector
        robot = mr.Network(rods={"rod": rod, "whisker": rod}, joints=[*joints, whisker])
        found = mr.solve(robot, robot.inputs(**{**given, "rotation": {"rod": 0.3}}), solver=EXACT)
        assert found.status is expected.status is mr.Status.CONVERGED
        assert found.stability is expected.stability is mr.Stability.STABLE
        for name in ("position", "moment", "force"):
            np.testing.assert_allclose(getattr(found.rod("rod"), name), getattr(expected.rod(0), name), atol=1e-8)


# ---- joints of all kinds, springs, rods that stand on bodies, loads everywhere ----

BENT = mr.Rod(length=0.4, bending_stiffness=0.2233, torsional_stiffness=0.0638, precurvature=(1.0, 0.3, 0.5), linear_density=0.02)
GIVEN = {
    "rotation": {"left": 0.3, "upper": -0.2},
    "translation": {"right": 0.02},
    "force": {"plate": (0.3, 0.2, -0.2), "feeler": (0.1, 0.05, -0.1)},
    "moment": {"top": (0.01, 0.02, 0.03), "feeler": (0.002, 0.01, 0.003)},
    "gravity": (0, 1, -9.81),
    "distributed_force": (0.1, 0.05, 0.2),
    "rod_force": {"upper": (0.2, -0.1, 0.05), "feeler": (-0.1, 0.2, 0.1)},
}


def mixed(end_effector="top", base=None):
    plate, top = mr.Body("plate", mass=0.05, mass_centre=(0.01, 0, 0.02)), mr.Body("top", mass=0.02)
    on_ground, on_plate = circle((0, 180), 0.08), circle((20, 200), 0.06)
    joints = [
        mr.Joint("left", "base", to=mr.ground, pose=on_ground[0]),
        mr.Joint("left", "tip", to=plate, pose=on_plate[0], kind="revolute", axis=(0, 0.6, 0.8), stiffness=0.2),
        mr.Joint("right", "base", to=mr.ground, pose=on_ground[1], kind="universal", axis=np.eye(3)[:2], stiffness=(0.3, 0)),
        mr.Joint("right", "tip", to=plate, pose=on_plate[1], kind="spherical", stiffness=0.1),
        mr.Joint("upper", "base", to=plate, pose=pose((0.2, 0, 0), (0.01, 0, 0.02)), kind="spherical", stiffness=0.4),
        mr.Joint("upper", "tip", to=top, kind="universal", axis=np.eye(3)[:2], stiffness=(0.1, 0.2), rest=(0.1, -0.2)),
        mr.Joint("feeler", "base", to=top, pose=pose((0.3, 0.5, 0), (0, 0, 0.01)), kind="revolute", axis=X, stiffness=0.3),
    ]
    rods = dict.fromkeys(("left", "right", "upper", "feeler"), BENT)
    return mr.Network(rods=rods, bodies=[plate, top], joints=joints, end_effector=end_effector, base=base)


@pytest.mark.parametrize("end_effector", ["top", "feeler"])
def test_derivatives(end_effector):
    """``check_assembly`` holds Gamma, columns and poses against differences, and instances alone against a batch."""
    robot = mixed(end_effector)
    vary = ("rotation", "translation", "force", "gravity", "distributed_force") if end_effector == "feeler" else ("moment",)
    tip_rod = 3 if end_effector == "feeler" else None
    # without moments loads have a potential: then the index goes with the sign of det Gamma
    given = {name: value for name, value in GIVEN.items() if name != "moment" or end_effector == "top"}
    check_assembly(robot, robot.inputs(**given), tip_rod=tip_rod, vary=vary, solvers=("shooting",))


def hold_gamma_against_differences(robot, given, level, difference):
    """By six ways from a place off the equilibrium; it begins at an equilibrium, (12), (29)."""
    problem = robot.problem(robot.inputs(**given), integrator=mr.RK4(20))
    rng = np.random.default_rng(3)
    x = problem.guess()
    with problem.at_load(0.0):
        # rounding of places, some 1e-17 m, over the squares of lengths of 0.03 m and more
        np.testing.assert_allclose(problem.evaluate(x)[0], 0.0, atol=1e-12)
    x = x + rng.standard_normal(problem.unknown_count)
    with problem.at_load(level):
        _, gamma = problem.evaluate(x)
        for _ in range(6):
            way = rng.standard_normal(problem.unknown_count)
            by_difference = difference(lambda t, way=way: problem.evaluate(x + t * way)[0][0], 1e-2)
            # what rounding leaves of differences of 1e-2, and their sixth order
            np.testing.assert_allclose(gamma[0] @ way, by_difference, atol=1e-8)


@pytest.mark.parametrize("level", [1.0, 0.4])
def test_gamma_by_differences_of_the_sixth_order(difference, level):
    """Off the equilibrium, and on the way there, while the network is put together."""
    hold_gamma_against_differences(mixed(), GIVEN, level, difference)


def test_every_body_is_in_equilibrium():
    """By the forces in the rods alone: nothing of the balance that was solved is used."""
    robot = mixed()
    solution = mr.solve(robot, robot.inputs(**GIVEN), solver=EXACT)
    rods = {rod.name: solution.rod(rod.name) for rod in robot.rods}
    for body in robot.bodies:
        p, R = solution.body_position(body.name), solution.body_rotation(body.name)
        weight = body.mass * np.array(GIVEN["gravity"])
        force = weight + np.array(GIVEN["force"].get(body.name, (0, 0, 0)))
        moment = np.cross(R @ body.mass_centre, weight) + np.array(GIVEN["moment"].get(body.name, (0, 0, 0)))
        for joint in robot.joints:
            if joint.to is not body:
                continue
            shape, k = rods[joint.rod], 0 if joint.end == "base" else -1
            sense = 1.0 if joint.end == "base" else -1.0  # what a rod does to what holds its base, and its tip
            n, m = (sense * shape.rotation[k] @ values[k] for values in (shape.force, shape.moment))
            force, moment = force + n, moment + m + np.cross(shape.position[k] - p, n)
            np.testing.assert_allclose(shape.position[k], p + R @ joint.pose[:3, 3], atol=1e-9)
        np.testing.assert_allclose(force, 0, atol=1e-9)
        np.testing.assert_allclose(moment, 0, atol=1e-9)
    feeler = rods["feeler"]
    np.testing.assert_allclose(feeler.rotation[-1] @ feeler.force[-1], GIVEN["force"]["feeler"], atol=1e-9)


def test_springs_of_joints_balance_the_moment_about_their_axes():
    robot = mixed()
    solution = mr.solve(robot, robot.inputs(**GIVEN), solver=EXACT)
    for joint in robot.joints:
        if joint.kind not in ("revolute", "spherical"):
            continue
        shape, k = solution.rod(joint.rod), 0 if joint.end == "base" else -1
        holder = np.eye(3) if joint.to is mr.ground else solution.body_rotation(joint.to.name)
        angle = GIVEN["rotation"].get(joint.rod, 0.0) if k == 0 else 0.0
        frame = holder @ joint.pose[:3, :3]
        end = shape.rotation[k] @ rodrigues((0, 0, -angle))
        turn = frame.T @ end
        skew = np.array([turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]])
        angles = skew / np.linalg.norm(skew) * np.arccos((np.trace(turn) - 1) / 2)
        moment = (1.0 if k == 0 else -1.0) * frame.T @ shape.rotation[k] @ shape.moment[k]
        axes = joint.axes
        np.testing.assert_allclose(axes @ moment, joint.stiffness * (axes @ angles), atol=1e-8)
        if joint.kind == "revolute":
            np.testing.assert_allclose(angles - axes[0] * (axes[0] @ angles), 0, atol=1e-8)


def test_the_ground_may_be_anywhere():
    """Turned and moved as a whole, with its loads, a network has the same unknowns."""
    where = pose((0.4, -0.9, 1.7), (3.0, -2.0, 1.0))
    here, there = mixed(), mixed(base=where)
    turned = {
        name: {key: where[:3, :3] @ value for key, value in given.items()} if isinstance(given, dict) else where[:3, :3] @ given
        for name, given in GIVEN.items()
        if name not in ("rotation", "translation")
    }
    problems = [
        robot.problem(robot.inputs(**{**GIVEN, **given}), integrator=RK4) for robot, given in ((here, {}), (there, turned))
    ]
    x = problems[0].guess() + 0.5
    (residual, gamma), (same, also) = (problem.evaluate(x) for problem in problems)
    np.testing.assert_allclose(problems[1].guess(), problems[0].guess(), atol=1e-12)
    np.testing.assert_allclose(same, residual, atol=1e-12 * np.abs(residual).max())
    np.testing.assert_allclose(also, gamma, atol=1e-12 * np.abs(gamma).max())
    poses = [problem.body_poses() for problem in problems]
    np.testing.assert_allclose(poses[1][0], poses[0][0] @ where[:3, :3].T + where[:3, 3], atol=1e-12)
    np.testing.assert_allclose(poses[1][1], where[:3, :3] @ poses[0][1], atol=1e-12)


def test_stability_is_that_of_parallel_rods():
    """The same form by the same variables, where joints are clamped or turn about an axis: to the last digits of its columns."""
    for kind in ("clamped", "revolute"):
        parallel = mr.ParallelRods(
            legs=[LEG] * 6,
            base=circle(BASE_ANGLES, 0.087),
            platform=circle(PLATE_ANGLES, 0.087),
            joints=kind,
            joint_axes=(1, 0, 0) if kind == "revolute" else None,
        )
        robot = hexapod(kind, heavy=False)
        loads = np.array([(0.5, 0, -2.0), (0.5, 0.2, -25.0)])
        expected = mr.solve(parallel, parallel.inputs(tip_force=loads), solver=EXACT)
        found = mr.solve(robot, robot.inputs(force=loads), solver=EXACT)
        assert found.stability.tolist() == expected.stability.tolist() == [mr.Stability.STABLE] * 2
        np.testing.assert_allclose(found.stability_margin, expected.stability_margin, rtol=1e-6)
        # its plate is where the potential is zero at the height of straight legs, not at that of the ground
        potential = found.potential - loads @ [0, 0, 0.4]
        np.testing.assert_allclose(np.diff(potential), np.diff(expected.potential), rtol=1e-6)


def test_columns_buckle_where_they_must():
    """A cantilever of two pieces: Euler's load, to either side."""
    piece = mr.Rod(length=0.5, bending_stiffness=1.0, torsional_stiffness=0.8)
    robot = chain(piece, 2)
    (load,) = mr.critical_loads(robot, robot.inputs(force={"disc 1": (0, 0, -1)}))
    assert load.multiplicity == 2
    np.testing.assert_allclose(load.load_factor, np.pi**2 / 4, rtol=1e-6)


def test_the_form_is_symmetric_and_the_potential_gives_way_with_forces():
    """Which each column by itself is not; and dV/dF + p is the same at two forces, of bodies and of a free tip."""
    robot = mixed()
    given = {name: value for name, value in GIVEN.items() if name != "moment"}
    first = mr.solve(robot, robot.inputs(**given), solver=EXACT)
    assert first.stability is mr.Stability.STABLE
    assert first._modes.uncertainty.max() < 1e-7  # what RK4(50) leaves of sensitivities and their own derivatives
    way, step = np.array([1.0, 0.3, -0.2]), 1e-3
    for name in ("plate", "top", "feeler"):
        found = []
        for shift in (0.0, 0.05):
            forces = [np.array(given["force"].get(name, (0, 0, 0))) + (shift + t) * way for t in (-step, 0, step)]
            batch = robot.inputs(**{**given, "force": {**given["force"], name: np.array(forces)}})
            around = mr.solve(robot, batch, solver=EXACT, guess=first)
            place = around.rod("feeler").position[1, -1] if name == "feeler" else around.body_position(name)[1]
            found.append((around.potential[2] - around.potential[0]) / (2 * step) + place @ way)
        np.testing.assert_allclose(found[1], found[0], atol=1e-6)


def test_rods_may_be_put_either_way_round():
    """A rod from the plate to the ground is the one from the ground to the plate, its loads and its other end the other way."""
    straight = mr.Rod(length=0.3, bending_stiffness=0.2, torsional_stiffness=0.15, linear_density=0.05)
    over = pose((np.pi, 0, 0))
    found = []
    for turned in (False, True):
        plate = mr.Body("plate", mass=0.05)
        joints = []
        for k, place in enumerate(circle((0, 120, 240), 0.05)):
            first, last = ("tip", "base") if turned and k == 1 else ("base", "tip")
            how = place @ over if turned and k == 1 else place
            joints.append(mr.Joint(f"rod {k}", first, to=mr.ground, pose=how))
            joints.append(mr.Joint(f"rod {k}", last, to=plate, pose=how))
        robot = mr.Network(rods={f"rod {k}": straight for k in range(3)}, bodies=[plate], joints=joints)
        inputs = robot.inputs(force={"plate": (0.4, 0.1, -0.3)}, gravity=(1, 2, -9.81))
        found.append(mr.solve(robot, inputs, solver=EXACT).raise_if_failed())
    np.testing.assert_allclose(found[1].tip_position, found[0].tip_position, atol=1e-9)
    np.testing.assert_allclose(found[1].tip_rotation, found[0].tip_rotation, atol=1e-9)
    np.testing.assert_allclose(found[1].energy, found[0].energy, rtol=1e-7)


def test_batches_motions_and_loops():
    robot = hexapod()
    forces = np.linspace(0, 1, 4)[:, None] * FORCE
    batch = mr.solve(robot, robot.inputs(force={"plate": forces}), solver=EXACT)
    alone = mr.solve(robot, robot.inputs(force=forces[2]), solver=EXACT)
    np.testing.assert_allclose(batch.body_position("plate")[2], alone.body_position("plate"), atol=1e-12)
    np.testing.assert_array_equal(batch.body_position("plate"), batch.tip_position)
    time = np.linspace(0, 1, 4)
    history = mr.simulate(robot, robot.inputs(force=forces), time=time, solver=EXACT)
    tracker = mr.Tracker(robot, solver=EXACT, inputs=robot.inputs(force=forces[0] + [1e-9, 0, 0]))
    for force in forces:
        step = tracker.step(force={"plate": force})
    np.testing.assert_allclose(step.tip_position, history.tip_position[-1], atol=1e-9)
    np.testing.assert_allclose(step.tip_position, batch.tip_position[-1], atol=1e-9)


@pytest.mark.parametrize("batch", [(), (2,)])
def test_a_change_by_name_leaves_what_it_does_not_name(batch):
    """In a loop of one robot numbers are written as they come, and checked where they are not plain; in a batch they all are."""
    robot = hexapod()
    pushed = np.linspace(0, 1e-3, 6) * np.ones((*batch, 1))
    tracker = mr.Tracker(robot, solver=EXACT, inputs=robot.inputs(translation=pushed, force={"plate": FORCE}))
    tracker.step()
    expected = np.array(pushed)
    for rod, value in (("leg 2", 2e-3), ("leg 4", np.float32(1e-3)), ("leg 0", 0), ("leg 3", np.full(batch, 1e-4))):
        sample = tracker.step(translation={rod: value})
        expected[..., int(rod[-1])] = value
        np.testing.assert_array_equal(sample.inputs.translation, expected)
        np.testing.assert_array_equal(sample.inputs.force, np.broadcast_to(FORCE, sample.inputs.force.shape))
    if not batch:
        whole = mr.solve(robot, robot.inputs(translation=expected, force={"plate": FORCE}), solver=EXACT)
        np.testing.assert_allclose(sample.tip_position, whole.tip_position, atol=1e-9)
    for wrong in ({"leg 2": (1e-3, 1e-3, 1e-3)}, {"leg 2": "far"}, {"leg": 1e-3}, {"leg 2": np.nan}, {2: 1e-3}):
        with pytest.raises(ValueError, match="translation"):
            tracker.step(translation=wrong)
    np.testing.assert_array_equal(tracker.inputs.translation, expected)


def test_the_stiffness_is_that_of_the_force_on_the_end_effector():
    robot = mixed()
    inputs = robot.inputs(**GIVEN)
    solution = mr.solve(robot, inputs, solver=EXACT)
    compliance = solution.jacobian("force", "moment")[:, [3, 4, 5, 12, 13, 14]]  # plate, top, feeler
    np.testing.assert_allclose(solution.stiffness @ compliance, np.eye(6), atol=1e-8)


def test_what_fails_says_so_and_is_no_number():
    robot = hexapod()
    solver = mr.Shooting(integrator=RK4, max_integrations=4)
    solution = mr.solve(robot, robot.inputs(force={"plate": FORCE}), solver=solver)
    assert solution.status is mr.Status.INTEGRATION_LIMIT
    assert solution.stability is mr.Stability.UNKNOWN
    assert np.isnan(solution.tip_position).all()
    assert np.isnan(solution.body_position("plate")).all()
    assert np.isnan(solution.rod(0).position).all()


def test_what_is_unstable_is_not_given():
    """A straight column pressed beyond its critical load is an equilibrium, and no result."""
    robot = chain(mr.Rod(length=0.5, bending_stiffness=1.0, torsional_stiffness=0.8), 2)
    problem = robot.problem(robot.inputs(force={"disc 1": (0, 0, -3.0)}), integrator=RK4)
    x = np.zeros((1, problem.unknown_count))
    x[0, [5, 11]] = -3.0 * 0.5  # the force along both pieces
    assert np.abs(problem.evaluate(x)[0]).max() < 1e-12
    assert problem.stability.modes().index == 2
    stopped = mr.Shooting(integrator=RK4, max_integrations=60)
    assert mr.solve(robot, robot.inputs(force={"disc 1": (0, 0, -3.0)}), solver=stopped).status.failed


@pytest.mark.usefixtures("no_display")
def test_plots_have_bodies_and_what_acts_on_them():
    collections = pytest.importorskip("mpl_toolkits.mplot3d.art3d")
    robot = mixed()

    def bodies(axes):
        return [one for one in axes.collections if isinstance(one, collections.Poly3DCollection)]

    axes = mr.solve(robot, robot.inputs(**GIVEN), solver=EXACT).plot()
    assert len(bodies(axes)) == 2
    marked = {line.get_label(): len(line.get_data_3d()[0]) for line in axes.lines}
    expected = {"clamped": 0, "revolute joint": 2, "universal joint": 2, "spherical joint": 2}
    assert {name: marked.get(name, 0) for name in expected} == expected
    said = [text.get_text() for text in axes.get_legend().get_texts()]
    for expected in ("force on plate 0.412 N", "force on feeler 0.15 N", "moment on top 0.0374 N m"):
        assert expected in said
    batch = mr.solve(robot, robot.inputs(gravity=np.outer([1, 2, 3], GRAVITY / 9.81)), solver=EXACT)
    assert len(bodies(batch.plot())) == 2 * 3
    force = np.zeros((3, 3, 3))
    force[:, 1, 0] = 0.1, 0.2, 0.3
    history = mr.simulate(robot, robot.inputs(force=force), time=0.1 * np.arange(3), solver=mr.Shooting(integrator=RK4))
    panel = history.plot("inputs")
    assert panel.get_ylabel() == "force on top\n[N]"
    assert [line.get_ydata().tolist() for line in panel.lines if line.get_label() == "x"] == [[0.1, 0.2, 0.3]]


# ---- parallel robots on top of each other ----


def parallel(count, radius, length=0.4, **more):
    leg = mr.Rod.tube(length=length, outer_diameter=2e-3, young_modulus=200e9, shear_modulus=80e9, density=7850.0)
    degrees = 360 / count * np.arange(count)
    return mr.ParallelRods(legs=[leg] * count, base=circle(degrees, radius), platform=circle(degrees + 20, 0.8 * radius), **more)


def test_stacked_robots_stand_on_each_others_platforms():
    """As the joints said one by one; and a single robot is itself."""
    below = parallel(3, 0.08, joints="revolute", joint_axes=(1, 0, 0), platform_mass=0.1, platform_centre=(0.01, 0, 0.02))
    above = parallel(4, 0.05, length=0.2, joints=["clamped", "spherical", "clamped", "clamped"])
    alone = mr.stacked(below, names=["plate"])
    force = np.array([0.1, 0.2, -0.3])
    expected = mr.solve(below, below.inputs(tip_force=force, translation=(0.01, 0, 0), gravity=GRAVITY), solver=EXACT)
    found = mr.solve(alone, alone.inputs(force=force, translation={"plate 0": 0.01}, gravity=GRAVITY), solver=EXACT)
    np.testing.assert_allclose(found.tip_position, expected.tip_position, atol=1e-10)
    np.testing.assert_allclose(found.rod("plate 2").moment, expected.rod(2).moment, rtol=1e-8, atol=1e-9)
    plate, top = mr.Body("lower", mass=0.1, mass_centre=(0.01, 0, 0.02)), mr.Body("upper")
    joints, rods = [], {}
    for name, robot, base, body in (("lower", below, mr.ground, plate), ("upper", above, plate, top)):
        for k, leg in enumerate(robot.legs):
            kind = "revolute" if name == "lower" else "spherical" if k == 1 else "clamped"
            axis = (1, 0, 0) if kind == "revolute" else None
            joints.append(mr.Joint(f"{name} {k}", "base", to=base, pose=robot.geometry.base[k]))
            joints.append(mr.Joint(f"{name} {k}", "tip", to=body, pose=robot.geometry.platform[k], kind=kind, axis=axis))
            rods[f"{name} {k}"] = leg
    by_hand, short = mr.Network(rods=rods, bodies=[plate, top], joints=joints), mr.stacked(below, above)
    assert repr(short) == repr(by_hand)
    given = {"force": {"upper": force}, "rotation": {"upper 3": 0.1}, "gravity": GRAVITY}
    one, two = (mr.solve(robot, robot.inputs(**given), solver=mr.Shooting(integrator=RK4)) for robot in (by_hand, short))
    assert one.status is mr.Status.CONVERGED
    np.testing.assert_array_equal(one.unknowns, two.unknowns)
    three = mr.stacked(below, above, parallel(3, 0.04, length=0.1), end_effector="level 1", base=pose(position=(1, 0, 0)))
    assert [body.name for body in three.bodies] == ["level 1", "level 2", "level 3"]
    assert three.end_effector == "level 1"
    assert three.rod_count == 10


def test_what_cannot_be_stacked_is_named():
    robot = parallel(3, 0.08)
    for match, robots, more in (
        ("stacked.robots = none", (), {}),
        (r"stacked\.names = \['a'\] is not allowed: must be 2", (robot, robot), {"names": ["a"]}),
        (r"stacked\.names .* 'a' is there twice", (robot, robot), {"names": ["a", "a"]}),
        (r"Network\.end_effector = 'top'", (robot, robot), {"end_effector": "top"}),
    ):
        with pytest.raises(ValueError, match=match):
            mr.stacked(*robots, **more)
    with pytest.raises(TypeError, match=r"stacked\.robots\[0\] = .* must be ParallelRods, not SingleRod"):
        mr.stacked(mr.SingleRod(LEG))


# ---- what is refused ----


def test_what_nothing_holds_or_moves_freely_is_named():
    plate, other = mr.Body("plate"), mr.Body("other")
    base, tip = mr.Joint("leg", "base", to=mr.ground), mr.Joint("leg", "tip", to=plate)
    rods = {"leg": LEG}

    def refused(match, **made):
        with pytest.raises(ValueError, match=match):
            mr.Network(**{"rods": rods, "bodies": [plate], "joints": [base, tip]} | made)

    refused("nothing holds the base of rod 'leg'", joints=[tip])
    refused("nothing holds body 'other': no rod is joined to it", bodies=[plate, other])
    adrift = [mr.Joint("far", "base", to=other), mr.Joint("far", "tip", to=other, pose=pose(position=(0.3, 0, 0)))]
    refused(
        "no chain of rods joins it to the ground; of what floats, hold one body, fixed=True",
        rods=legs(1) | {"leg": LEG, "far": LEG} | {},
        bodies=[plate, other],
        joints=[base, tip, mr.Joint("leg 0", "base", to=mr.ground), *adrift],
    )
    refused("the tip of rod 'leg' is held already", joints=[base, tip, tip])
    refused("there is no rod 'log'; did you mean 'leg'?", joints=[base, mr.Joint("log", "tip", to=plate)])
    refused("there is no rod 'plate': that is a body", joints=[base, mr.Joint("plate", "base", to=mr.ground, kind="spherical")])
    refused("body 'other' is not among bodies", joints=[base, mr.Joint("leg", "tip", to=other)])
    refused("must have a name of its own", rods={"plate": LEG}, joints=[])
    refused("end_effector = 'log' is not allowed: must be a body that moves, or a rod: 'plate', 'leg'", end_effector="log")
    ball = mr.Joint("leg", "tip", to=plate, kind="spherical")
    refused("body 'plate' is free to move in 3 ways", joints=[base, ball])
    refused(
        "rod 'leg' is free to move: its joints let it turn about itself",
        joints=[mr.Joint("leg", "base", to=mr.ground, kind="spherical"), ball],
    )
    refused(
        "rod 'leg' is free to move: its base turns",
        bodies=[],
        joints=[mr.Joint("leg", "base", to=mr.ground, kind="revolute", axis=X)],
    )
    with pytest.raises(ValueError, match="must be the name of a rod: bodies are joined by rods alone"):
        mr.Joint(plate, "base", to=mr.ground)
    # what has a spring is held
    mr.Network(rods=rods, bodies=[plate], joints=[base, mr.Joint("leg", "tip", to=plate, kind="spherical", stiffness=0.1)])
    with pytest.raises(TypeError, match="Network.rods must be a mapping of names to Rod"):
        mr.Network(rods=[LEG], joints=[base])
    with pytest.raises(TypeError, match=r"Network.rods\['leg'\] = .* must be a Rod or ConcentricTubes, not SingleRod"):
        mr.Network(rods={"leg": mr.SingleRod(LEG)}, joints=[base])


def test_joints_and_bodies_are_checked():
    for match, made in (
        ("Joint.end = 'top' is not allowed", {"end": "top"}),
        ("Joint.kind = 'pinned' is not allowed", {"kind": "pinned"}),
        ("Joint.axis .* a clamped joint has none", {"axis": (1, 0, 0)}),
        ("two axes that are perpendicular", {"kind": "universal", "axis": ((1, 0, 0), (1, 1, 0))}),
        (r"must have shape \(3,\) for a revolute joint", {"kind": "revolute", "axis": ((1, 0, 0), (0, 1, 0))}),
        ("Joint.stiffness = -1 is not allowed: must be >= 0", {"kind": "revolute", "axis": (1, 0, 0), "stiffness": -1}),
        (r"Joint.axis = None .* must be given for a revolute joint: one of shape \(3,\)", {"kind": "revolute"}),
        (r"Joint.axis = None .* a universal joint: two .* shape \(2, 3\)", {"kind": "universal", "stiffness": 0.1}),
        ("Joint.rest = 0.3 .* without a stiffness", {"kind": "revolute", "axis": (1, 0, 0), "rest": 0.3}),
        ("a clamped joint has no axis", {"stiffness": 1.0}),
        ("turn its pose instead", {"kind": "spherical", "rest": 0.1}),
        ("as stiff about all axes", {"kind": "spherical", "stiffness": (1, 1, 2)}),
        ("must be a rotation", {"pose": 2 * np.eye(4)}),
    ):
        with pytest.raises(ValueError, match=match):
            mr.Joint("rod", **{"end": "tip", "to": mr.ground} | made)
    with pytest.raises(TypeError, match="must be a Body or mr.ground"):
        mr.Joint("rod", "tip", to="plate")
    with pytest.raises(ValueError, match="must be a name, and not 'ground'"):
        mr.Body("ground")
    with pytest.raises(ValueError, match="Body.mass = -1"):
        mr.Body("plate", mass=-1)
    with pytest.raises(ValueError, match="Body.mass_centre = .* must not be given without a mass"):
        mr.Body("plate", mass_centre=(0, 0, 0.1))
    with pytest.warns(mr.PlausibilityWarning, match="Body.mass = 120 kg of 'plate'"):
        mr.Body("plate", mass=120)


def test_inputs_are_given_by_name():
    robot = chain(mr.Rod(length=0.2, bending_stiffness=0.2, torsional_stiffness=0.15), 2)
    assert robot.load_places == ("disc 0", "disc 1")
    by_name = robot.inputs(force={"disc 1": np.ones((4, 3))}, rotation={"piece 1": 0.1})
    assert by_name.batch_shape == (4,)
    np.testing.assert_array_equal(by_name.force[2], [0, 0, 0, 1, 1, 1])
    np.testing.assert_array_equal(by_name.rotation[0], [0, 0.1])
    np.testing.assert_array_equal(robot.inputs(force=np.arange(6).reshape(2, 3)).force, np.arange(6))
    for match, given in (
        ("force = 'disc 7' is not allowed: must be by name, one of 'disc 0', 'disc 1'", {"force": {"disc 7": (1, 0, 0)}}),
        (r"force = \(1, 2, 3\) is not allowed: must say whose it is, such as {'disc 0': ...}, one of", {"force": (1, 2, 3)}),
        (r"force = \[\[1, 2\], \[3\]\] is not allowed: must be numeric", {"force": [[1, 2], [3]]}),
        (r"force\['disc 1'\] = \(1, 0\) is not allowed: must have shape \(..., 3\)", {"force": {"disc 1": (1, 0)}}),
        ("rod 'piece 0': translation = -0.5", {"translation": {"piece 0": -0.5}}),
        ("no rod has a linear_density, and no body a mass", {"gravity": (0, 0, -9.81)}),
    ):
        with pytest.raises(ValueError, match=match):
            robot.inputs(**given)
    with pytest.raises(TypeError, match="takes no 'tip_force'.*did you mean 'force'"):
        robot.inputs(tip_force=(0, 0, 1))
    solution = mr.solve(robot, robot.inputs(), solver=EXACT)
    with pytest.raises(ValueError, match="must be one of 'disc 0', 'disc 1'; did you mean 'disc 1'"):
        solution.body_position("disk 1")
    single = mr.SingleRod(LEG)
    with pytest.raises(AttributeError, match="SingleRod has no bodies"):
        mr.solve(single, single.inputs(), solver=EXACT).body_rotation("plate")
    assert repr(robot) == "Network(2 rods, 2 bodies, 4 joints, end effector 'disc 1')"


@pytest.mark.parametrize("seed", [0, 4])
def test_drawn_networks_are_where_their_energy_has_them(seed):
    """Chains of rigid segments, written anew, brought to rest from beside it; ``benchmarks/random_networks.py`` has more."""
    drawn = draw(seed, most_rods=4, most_bodies=2)
    solution = mr.solve(drawn.robot, drawn.inputs).raise_if_failed()
    assert violation(drawn, solution) < 1e-6  # of lengths and forces: what the default integrator promises
    own = np.array([solution.body_position(body.name) for body in drawn.robot.bodies])
    rods, state = state_of(drawn, solution, 6, aside=0.01)
    errors = []
    for _ in range(2):
        state, index, _ = rods.settled(state)
        assert index == 0
        errors.append(np.array(state[2]) - own)
        rods, state = rods.refined(state)
    # of the second order: half the segments' length leaves a quarter of the error, and extrapolation little of that
    assert np.abs(errors[1]).max() < 0.01 * rods.rods[0]["length"]
    assert np.abs(4 * errors[1] - errors[0]).max() / 3 < 0.2 * np.abs(errors[1]).max()
    assert solution.stability in (mr.Stability.STABLE, mr.Stability.UNKNOWN)


def test_a_ring_gives_way_as_curved_beams_do():
    """Two halves between the ground and a body across: under a force there, in the plane and out of it, by Castigliano."""
    radius, EI, GJ = 0.1, 0.02, 0.015
    half = mr.Rod(length=np.pi * radius, bending_stiffness=EI, torsional_stiffness=GJ, precurvature=(0, 1 / radius, 0))
    across = mr.Body("across")
    joints = [mr.Joint("out", "base", to=mr.ground), mr.Joint("out", "tip", to=across)]
    joints += [mr.Joint("back", "base", to=across), mr.Joint("back", "tip", to=mr.ground)]
    ring = mr.Network(rods={"out": half, "back": half}, bodies=[across], joints=joints)
    solution = mr.solve(ring, ring.inputs(), solver=FINE).raise_if_failed()
    np.testing.assert_allclose(solution.tip_position, (2 * radius, 0, 0), atol=1e-10)
    gives = np.diagonal(solution.jacobian("force"))[:3]
    # x is across the ring, y out of its plane: there a half carries M = m cos a - R/2 sin a, T = m sin a - R/2 (1 - cos a)
    m = radius / GJ / (np.pi / 2 * (1 / EI + 1 / GJ))
    aside = 2 * radius * (np.pi * radius**2 / 8 / EI + (3 * np.pi * radius**2 / 8 - m * radius) / GJ)
    np.testing.assert_allclose(gives[:2], [(np.pi / 4 - 2 / np.pi) * radius**3 / EI, aside], rtol=1e-8)


def test_what_a_chain_takes_grows_with_its_rods():
    """Numbers of the factors of ``Gamma``, which the time of an elimination goes by: as many for each rod."""
    filled = []
    for count in (8, 64):
        robot = chain(mr.Rod(length=0.4, bending_stiffness=0.2, torsional_stiffness=0.06, precurvature=(3, 1, 0)), count)
        problem = robot.problem(robot.inputs(), integrator=RK4)
        problem.write("unknowns", problem.guess())
        problem.integrate()
        factors = problem.elimination.factors(problem.closing.numbers()[0])
        filled.append((factors.L.nnz + factors.U.nnz) / count)
    assert filled[1] == pytest.approx(filled[0], rel=0.2)
