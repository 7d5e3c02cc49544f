"""Rods held at both ends: critical loads against closed forms, derivatives, reactions, and where the natural branch leads."""

import numpy as np
import pytest
from held_ways import BENT, GIVEN, HELD, PLACE
from scipy.spatial.transform import Rotation
from test_check_assembly import check_assembly

import multirod as mr

CLOSE = 1e-6  # relative, what is promised
TIGHT = 1e-10  # relative: what RK45(steps=150) leaves of closed forms is a tenth of that
ROD = mr.Rod(length=1.0, bending_stiffness=1.0, torsional_stiffness=0.8)
ALONG, ACROSS = (0, 0, 1), (1, 0, 0)
CLAMPED_PINNED = 4.493409457909064**2  # tan x = x
# what holds a column, and the first loads at which it buckles, with the modes that become unstable there
COLUMNS = {
    "clamped": ({}, [(4 * np.pi**2, 2), (80.76291, 2)]),
    "clamped and pinned": ({"joint": "spherical"}, [(CLAMPED_PINNED, 2)]),
    "hinged": ({"joint": "revolute", "base_joint": "revolute"}, [(np.pi**2, 1)]),
    "hinged, and a ball": ({"joint": "spherical", "base_joint": "revolute"}, [(np.pi**2, 1), (CLAMPED_PINNED, 1)]),
}


def found_by(found):
    return [(critical.load_factor, critical.multiplicity) for critical in found]


@pytest.mark.parametrize("name", COLUMNS)
def test_columns(name):
    held, expected = COLUMNS[name]
    robot = mr.HeldRod(ROD, slide=ALONG, **held)
    found = mr.critical_loads(robot, robot.inputs(tip_force=(0, 0, -1)), count=len(expected))
    np.testing.assert_allclose(found_by(found), expected, rtol=CLOSE)
    assert not any(critical.fold for critical in found)
    if name != "hinged, and a ball":  # 80.76291 and the modes that come together there are known to fewer digits
        np.testing.assert_allclose(found[0].load_factor, expected[0][0], rtol=TIGHT)


def test_twist_of_a_rod_under_tension_and_thrust(reference_cases):
    """Greenhill: both ends clamped, the end turned or, as well, the base; and by a torque on an end that may turn."""
    case = next(case for case in reference_cases("critical_load") if case["id"] == "06a_greenhill_twist_clamped")
    given = case["inputs"]["rods"][0]
    K, L = given["K"], given["length"]
    rod = mr.Rod(length=L, bending_stiffness=K[0], torsional_stiffness=K[2])
    clamped = mr.HeldRod(rod, slide=ALONG)
    turning = mr.HeldRod(rod, slide=ALONG, joint="revolute", joint_axis=ALONG)
    for pull, expected in zip(case["inputs"]["T_L2_over_EI"], case["expected"]["M_crit_L_over_EI"]["value"], strict=True):
        force, moment = (0, 0, pull * K[0] / L**2), float(expected) * K[0] / L
        for robot, unit, scale in (
            (clamped, {"end_rotation": ALONG}, K[2] / L),
            (clamped, {"rotation": -1.0}, K[2] / L),
            (turning, {"tip_moment": ALONG}, 1.0),
        ):
            start = robot.inputs(tip_force=force)
            (found,) = mr.critical_loads(robot, robot.inputs(tip_force=force, **unit), start=start)
            np.testing.assert_allclose(scale * found.load_factor, moment, rtol=CLOSE)
            assert found.multiplicity == 2


def closed_ring(length, bending, torsion):
    robot = mr.HeldRod(mr.Rod(length=length, bending_stiffness=bending, torsional_stiffness=torsion))
    return robot, {"end_position": (0, 0, -length), "end_rotation": (0, 2 * np.pi, 0)}


def test_twisted_ring():
    """Michell and Zajac: 2 pi sqrt(3) EI/GJ. The integration tells the two modes apart by a billionth, so some is undecided."""
    robot, ring = closed_ring(2 * np.pi, 0.02, 0.012)
    start = robot.inputs(**ring)
    solver = mr.Shooting(tolerance=1e-8, integrator=mr.RK4(400))
    with pytest.warns(mr.IncompleteWarning, match="so near to neutral"):
        loads = mr.critical_loads(robot, robot.inputs(**ring, rotation=1.0), start=start, solver=solver)
    (found,), ranges = loads, np.ravel(loads.undecided)
    assert (np.diff(ranges) > 0).all()  # those that touch are one
    critical = 2 * np.pi * np.sqrt(3) * 0.02 / 0.012
    np.testing.assert_allclose(found.load_factor, critical, rtol=CLOSE)
    # the margin vanishes there, in proportion
    sides = mr.solve(robot, robot.inputs(**ring, rotation=critical * np.array([0.9998, 0.9999])), solver=solver)
    assert sides.stability.tolist() == [mr.Stability.STABLE] * 2
    (a, b), (first, second) = sides.stability_margin, (0.9998, 0.9999)
    np.testing.assert_allclose(second + (second - first) * b / (a - b), 1, atol=CLOSE)


@pytest.mark.parametrize("scale", [(1.0, 1.0), (0.02, 0.5), (200.0, 3.0)])
def test_forces_across_a_straight_rod_that_are_noise(scale):
    """Two modes cross together at 4 pi^2 EI/L^2, another two at 80.8: whatever tolerances and rounding leave across the rod is no
    bend, and leaves none of them out. A rod that is bent has one that costs nothing, and is stable across it."""
    EI, L = scale
    robot = mr.HeldRod(mr.Rod(length=L, bending_stiffness=EI, torsional_stiffness=0.8 * EI), slide=ALONG)
    thrust = np.array([10.0, 38.0, 41.0, 60.0, 79.0, 85.0])
    unknowns = np.zeros((6, 6))
    unknowns[:, 5] = -thrust / L
    problem = robot.problem(robot.inputs(tip_force=np.multiply.outer(-thrust * EI / L**2, ALONG)), integrator=mr.RK4(100))
    random = np.random.default_rng(1)
    for noise in 10.0 ** np.arange(-16, -5, 2):
        problem.evaluate(unknowns + noise * random.normal(size=(6, 6)) / L)
        assert problem.stability.modes().index.tolist() == [0, 0, 2, 2, 2, 4]
    bent = mr.HeldRod(robot.rods[0])
    short = -L * np.array([1e-3, 0.1, 0.5])
    found = mr.solve(bent, bent.inputs(end_position=np.multiply.outer(short, ALONG)), solver=mr.Shooting(integrator=mr.RK4(100)))
    assert (found.status == mr.Status.CONVERGED).all()
    assert (found.stability == mr.Stability.STABLE).all()


def test_the_ring_is_a_circle():
    robot, ring = closed_ring(1.0, 1.0, 0.6)
    solution = mr.solve(robot, robot.inputs(**ring))
    assert solution.status is mr.Status.CONVERGED
    assert (solution.stability, solution.index) == (mr.Stability.STABLE, 0)
    np.testing.assert_allclose(solution.rod(0).curvature, np.broadcast_to([0, 2 * np.pi, 0], (51, 3)), atol=1e-7)
    np.testing.assert_allclose(solution.energy, 2 * np.pi**2, rtol=1e-8)


# ---- a rod held in every way, loaded in every way ----


@pytest.mark.filterwarnings("ignore:rotation = .* does nothing")  # which is tested of all
@pytest.mark.parametrize("name", HELD)
def test_derivatives_and_forms(name):
    """``check_assembly`` holds Gamma, columns and poses against differences; the second variation is symmetric by itself."""
    robot = mr.HeldRod(BENT, end=PLACE, **HELD[name])
    inputs = robot.inputs(**GIVEN)
    check_assembly(robot, inputs, tip_rod=0, vary=("rotation", "end_position", "end_rotation", "tip_force", "gravity"))
    solution = mr.solve(robot, inputs)
    assert solution.stability is mr.Stability.STABLE
    # each column by itself is not; what is left is the error of the integration
    assert solution._modes.uncertainty.max() < 1e-6


@pytest.mark.filterwarnings("ignore:rotation = .* does nothing")  # which is tested of all
@pytest.mark.parametrize("name", HELD)
def test_what_joints_and_slides_leave_free_carries_nothing(name):
    held = HELD[name]
    robot = mr.HeldRod(BENT, end=PLACE, **held)
    solution = mr.solve(robot, robot.inputs(**GIVEN))
    E = Rotation.from_rotvec(GIVEN["end_rotation"]).as_matrix() @ PLACE[:3, :3]
    gap = E.T @ (solution.tip_position - PLACE[:3, 3] - GIVEN["end_position"])
    force, moment = E.T @ solution.end_force, E.T @ solution.end_moment
    slide = np.array(held.get("slide", (0, 0, 0)), float)
    np.testing.assert_allclose(gap - slide * (slide @ gap), 0, atol=1e-8)
    np.testing.assert_allclose(slide @ force, 0, atol=1e-8)
    turned = E.T @ solution.tip_rotation
    joint, axis = held.get("joint", "clamped"), np.array(held.get("joint_axis", (0, 0, 0)), float)
    if joint == "clamped":
        np.testing.assert_allclose(turned, np.eye(3), atol=1e-8)
    elif joint == "revolute":
        np.testing.assert_allclose(turned @ axis, axis, atol=1e-8)
        np.testing.assert_allclose(axis @ moment, 0, atol=1e-8)
    else:
        np.testing.assert_allclose(moment, 0, atol=1e-8)
    base = solution.rod(0)
    at_base = base.rotation[0] @ base.moment[0]
    free = {"revolute": np.array([held.get("base_joint_axis", ACROSS)]), "spherical": np.eye(3)}
    if "base_joint" in held:
        np.testing.assert_allclose(free[held["base_joint"]] @ at_base, 0, atol=1e-8)
    # the whole rod is in equilibrium
    weight = BENT.length * (np.array(GIVEN["distributed_force"]) + 0.02 * np.array(GIVEN["gravity"]))
    pulled = solution.end_force + np.array(GIVEN["tip_force"]) + weight - base.rotation[0] @ base.force[0]
    np.testing.assert_allclose(pulled, 0, atol=1e-8)


def test_reactions_are_the_slope_of_the_energy():
    """By moving and turning what holds the end: of all that is computed, nothing enters both sides."""
    robot = mr.HeldRod(BENT, end=PLACE)
    place, turn, step = np.array([0.02, 0.01, -0.05]), np.array([0.3, -0.2, 0.5]), 1e-5
    sides = step * np.concatenate([np.eye(3), -np.eye(3)])
    turned = (Rotation.from_rotvec(sides) * Rotation.from_rotvec(turn)).as_rotvec()
    solver = mr.Shooting(tolerance=1e-11, integrator=mr.RK4(100))
    middle = mr.solve(robot, robot.inputs(end_position=place, end_rotation=turn, gravity=(0, 0, -9.81)), solver=solver)
    positions = np.concatenate([place + sides, np.tile(place, (6, 1))])
    rotations = np.concatenate([np.tile(turn, (6, 1)), turned])
    around = robot.inputs(end_position=positions, end_rotation=rotations, gravity=(0, 0, -9.81))
    potential = mr.solve(robot, around, guess=middle, solver=solver).potential.reshape(2, 2, 3)
    slope = (potential[:, 0] - potential[:, 1]) / (2 * step)
    # what RK4(100) leaves of the energy, and differences of it
    np.testing.assert_allclose(slope[0], middle.end_force, rtol=1e-5, atol=1e-5)
    np.testing.assert_allclose(slope[1], middle.end_moment, rtol=1e-5, atol=1e-5)


def test_a_pushed_column_buckles_to_the_side_that_the_rule_says():
    """A tenth shorter: the elastica, by its first integral; the moment at the base is about the positive y axis."""
    from scipy.optimize import brentq
    from scipy.special import ellipe, ellipk

    robot = mr.HeldRod(ROD)
    solution = mr.solve(robot, robot.inputs(end_position=(0, 0, -0.1)))
    assert solution.status is mr.Status.CONVERGED
    assert solution.stability is mr.Stability.STABLE
    m = brentq(lambda m: 2 * ellipe(m) / ellipk(m) - 1 - 0.9, 0.01, 0.5, xtol=1e-14)
    np.testing.assert_allclose(solution.end_force, [0, 0, -16 * ellipk(m) ** 2], atol=1e-5)
    moment = solution.rod(0).moment[0]
    np.testing.assert_allclose(moment, [0, 8 * ellipk(m) * np.sqrt(m), 0], atol=1e-5)


def test_random_places_are_reached():
    """Straight rods, isotropic and not, clamped and pinned: nearly all by the natural branch, and stable."""
    rng = np.random.default_rng(5)
    position = rng.normal(size=(12, 3)) * 0.35 + [0, 0, 1]
    position *= (rng.uniform(0.3, 0.95, 12) / np.linalg.norm(position, axis=1))[:, None]
    inputs = {"end_position": position - [0, 0, 1], "end_rotation": rng.normal(size=(12, 3)) * 0.5}
    robot = mr.HeldRod(ROD)
    solution = mr.solve(robot, robot.inputs(**inputs))
    assert (solution.status == mr.Status.CONVERGED).sum() >= 11
    assert (solution.stability[~solution.failed] == mr.Stability.STABLE).all()
    np.testing.assert_allclose(solution.tip_position[~solution.failed], position[~solution.failed], atol=1e-8)


def test_a_motion_and_a_loop(tmp_path):
    robot = mr.HeldRod(BENT, end=PLACE)
    time = np.linspace(0, 1, 21)
    turn, move = np.outer(time, (0, 1.0, 0.5)), np.outer(time, (0.05, 0.02, -0.08))
    history = mr.simulate(robot, robot.inputs(end_position=move, end_rotation=turn), time=time)
    assert not history.failed.any()
    history.save(tmp_path / "run.rrd")
    tracker = mr.Tracker(robot, dt=0.05, inputs=robot.inputs(end_position=move[1], end_rotation=turn[1]))
    for k in range(21):
        solution = tracker.step(end_position=move[k], end_rotation=turn[k])
    np.testing.assert_allclose(solution.unknowns, history.unknowns[-1], atol=1e-7)
    np.testing.assert_allclose(solution.end_force, history.end_force[-1], atol=1e-7)


def test_other_equilibria():
    """A column that is softer about x and pushed: its two sides, by mirror images of one energy."""
    robot = mr.HeldRod(mr.Rod(length=1.0, bending_stiffness=(1.0, 1.5), torsional_stiffness=0.8))
    found = mr.equilibria(robot, robot.inputs(end_position=(0, 0, -0.1)))
    stable = found.potential[found.stability == mr.Stability.STABLE]
    assert len(stable) >= 2
    np.testing.assert_allclose(np.sort(stable)[0], np.sort(stable)[1], rtol=1e-6)


def test_files_keep_what_holds_the_rod(tmp_path):
    for held in ({}, {"end": np.eye(4)}, {"end": PLACE, **HELD["revolute, sliding"]}, HELD["sliding, spherical base"]):
        robot = mr.HeldRod(BENT, **held)
        for ending in ("toml", "npz"):
            robot.save(tmp_path / f"robot.{ending}")
            again = mr.load(tmp_path / f"robot.{ending}")
            assert repr(again) == repr(robot)
            np.testing.assert_array_equal(again.holders.end, robot.holders.end)
            np.testing.assert_array_equal(again.joint_axis, robot.joint_axis)


def test_what_is_refused(wire):
    with pytest.raises(TypeError, match="HeldRod takes a Rod, not list"):
        mr.HeldRod([wire])
    with pytest.raises(ValueError, match="HeldRod.joint = 'pinned' is not allowed"):
        mr.HeldRod(wire, joint="pinned")
    with pytest.raises(ValueError, match=r"HeldRod.joint_axis = \(0, 1, 0\) is not allowed: .* and joint is 'clamped'"):
        mr.HeldRod(wire, joint_axis=(0, 1, 0), base_joint="revolute")
    with pytest.raises(ValueError, match=r"HeldRod.base_joint_axis = \(0, 1, 0\) is not allowed: .* base_joint is 'spherical'"):
        mr.HeldRod(wire, base_joint_axis=(0, 1, 0), joint="revolute", base_joint="spherical")
    with pytest.raises(ValueError, match="HeldRod.slide"):
        mr.HeldRod(wire, slide=(0, 0, 0))
    with pytest.raises(ValueError, match="the upper left 3 x 3 block must be a rotation"):
        mr.HeldRod(wire, end=2 * np.eye(4))
    with pytest.raises(TypeError, match="follower_force"):
        mr.HeldRod(wire).inputs(follower_force=(1, 0, 0))
    with pytest.raises(ValueError, match="distributed_force.* must be numbers where the base turns in a joint"):
        mr.HeldRod(wire, base_joint="spherical").inputs(distributed_force=lambda s: (s, 0, 0))
    robot = mr.SingleRod(wire)
    with pytest.raises(AttributeError, match="nothing holds the end of SingleRod"):
        _ = mr.solve(robot, robot.inputs()).end_force


def test_a_pose_is_a_frame(wire):
    """Wherever a matrix is taken: one function reads all."""
    turned = Rotation.from_rotvec((0.3, -0.2, 0.5)).as_matrix()
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = turned, (0.1, 0.02, 0.3)
    pose = mr.Pose(position=matrix[:3, 3], rotation=turned)
    for made in (lambda own: mr.HeldRod(wire, end=own).end, lambda own: mr.SingleRod(wire, base=own).base):
        np.testing.assert_array_equal(made(pose), matrix)
    body = mr.Body("plate", pose=pose, frames={"left": pose})
    np.testing.assert_array_equal([body.pose, body.frame("left")], [matrix, matrix])
    np.testing.assert_array_equal(mr.Joint("wire", "tip", to=body, pose=pose).pose, matrix)
    legs = mr.ParallelRods(legs=[wire] * 2, base=[pose, np.eye(4)], platform=mr.Pose(position=np.zeros((2, 3)), rotation=turned))
    np.testing.assert_array_equal(legs.base, [matrix, np.eye(4)])
    np.testing.assert_array_equal(legs.platform[:, :3, :3], [turned, turned])
    with pytest.raises(ValueError, match=r"HeldRod\.end = Pose\(position.* must have a position and a rotation: "):
        mr.HeldRod(wire, end=mr.Pose(position=(0, 0, 0.3)))
    with pytest.raises(ValueError, match=r"SingleRod\.base = .* without sigma, covariance, at and across"):
        mr.SingleRod(wire, base=mr.Pose(position=(0, 0, 0.3), rotation=turned, sigma=(1e-3, 1e-2)))
    with pytest.raises(ValueError, match=r"ParallelRods\.base = poses of shapes \[\(4, 4\), \(2, 4, 4\)\] .* must be alike"):
        mr.ParallelRods(legs=[wire] * 2, base=[pose, legs.platform], platform=legs.platform)


BY_STEPS = {"rotation": 3e-3, "end_position": 1e-3, "end_rotation": 3e-3, "tip_force": 3e-2, "gravity": 3e-2}


@pytest.mark.filterwarnings("ignore:rotation = .* does nothing")  # which is tested of all
@pytest.mark.parametrize("name", HELD)
def test_columns_along_the_rod(name):
    """(D20) Against differences of sixth order of the shape's middle; at the end those of the tip's pose."""
    nodes, weights = np.array([-3, -2, -1, 1, 2, 3]), np.array([-1, 9, -45, 45, -9, 1]) / 60
    robot = mr.HeldRod(BENT, end=PLACE, **HELD[name])
    precise = mr.Shooting(integrator=mr.RK45(rtol=1e-11, atol=1e-13), tolerance=1e-12)
    solution = mr.solve(robot, robot.inputs(**GIVEN), solver=precise).raise_if_failed()
    found = {of: solution.jacobian(*BY_STEPS, of=of, at=0.2) for of in ("position", "curvature")}
    expected = {of: [] for of in found}
    for given, step in BY_STEPS.items():
        at = np.atleast_1d(GIVEN[given])
        varied = GIVEN | {given: at + step * nodes[:, None] * np.eye(len(at))[:, None]}
        rod = mr.solve(robot, robot.inputs(**varied), solver=precise, guess=solution).raise_if_failed().rod(nodes=3)
        for of, columns in expected.items():
            columns.append(np.einsum("n,knc->ck", weights, getattr(rod, of)[:, :, 1]) / step)
    for of, columns in expected.items():
        each = np.concatenate(columns, axis=1)
        np.testing.assert_allclose(found[of], each, rtol=0, atol=1e-8 * np.abs(each).max())
    end = [solution.jacobian(*BY_STEPS, of=of, at=0.4) for of in ("position", "rotation")]
    pose = solution.jacobian(*BY_STEPS)
    np.testing.assert_allclose(np.concatenate(end), pose, rtol=0, atol=1e-9 * np.abs(pose).max())


def test_columns_along_a_batch_are_those_of_each():
    robot = mr.HeldRod(BENT, end=PLACE, **HELD["spherical, revolute base"])
    moved = np.array([GIVEN["end_position"], (0.01, -0.02, -0.01)])
    at = {"of": "curvature", "at": [0.1, 0.3]}
    precise = mr.Shooting(tolerance=1e-12)
    both = mr.solve(robot, robot.inputs(**(GIVEN | {"end_position": moved})), solver=precise)
    found = both.jacobian("gravity", "rotation", **at)
    for k in range(2):
        inputs = robot.inputs(**(GIVEN | {"end_position": moved[k]}))
        alone = mr.solve(robot, inputs, solver=precise, guess=both[k]).jacobian("gravity", "rotation", **at)
        # from the same place: what a step within the tolerance moves
        np.testing.assert_allclose(found[k], alone, rtol=0, atol=1e-9 * np.abs(alone).max())


NUMBERS = {
    "length": np.array([0.3, 0.2]),
    "bending_stiffness": np.array([(0.02, 0.03), (0.03, 0.03)]),
    "torsional_stiffness": np.array([0.015, 0.02]),
    "precurvature": np.array([(1, 0.5, 0.2), (2, -1, 0.5)]),
}
STEPS = {"length": 3e-4, "bending_stiffness": 1e-4, "torsional_stiffness": 1e-4, "precurvature": 3e-2}


@pytest.mark.parametrize("held", [{"slide": (0, 0.3, 1)}, {"base_joint": "revolute"}], ids=["sliding", "turning base"])
@pytest.mark.parametrize("name", NUMBERS)
def test_derivatives_by_numbers_of_the_rod(name, held):
    """Of the tip's pose, and of the residual at fixed unknowns, against differences of sixth order along one direction."""
    nodes, weights = np.array([-3, -2, -1, 1, 2, 3]), np.array([-1, 9, -45, 45, -9, 1]) / 60
    direction = np.random.default_rng(2).standard_normal(NUMBERS[name].shape)
    end = np.array([[1.0, 0, 0, 0.05], [0, 1, 0, 0.02], [0, 0, 1, 0.44], [0, 0, 0, 1]])

    def robot(change):
        own = NUMBERS | {name: NUMBERS[name] + np.multiply.outer(change, direction)}
        tails = {key: np.ndim(value) - np.ndim(change) * (key == name) - 1 for key, value in own.items()}
        sections = [{key: np.take(value, k, axis=-1 - tails[key]) for key, value in own.items()} for k in range(2)]
        rod = mr.Rod(sections=[mr.Section(**section) for section in sections])
        return mr.HeldRod(rod, end=end, joint="spherical", **held)

    precise = mr.Shooting(integrator=mr.RK45(rtol=1e-11, atol=1e-13), tolerance=1e-12)
    given, step = {"rotation": 0.2, "tip_force": (0.1, 0.05, 0.1)}, STEPS[name]
    alone, other = robot(0.0), robot(step * nodes)
    solution = mr.solve(alone, alone.inputs(**given), solver=precise).raise_if_failed()
    varied = mr.solve(other, other.inputs(**given), solver=precise, guess=solution).raise_if_failed()
    turned = Rotation.from_matrix(varied.tip_rotation @ solution.tip_rotation.T).as_rotvec()
    expected = weights @ np.concatenate([varied.tip_position, turned], axis=1) / step
    found = solution.jacobian(name) @ direction.ravel()
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-9 * np.abs(expected).max())
    if name == "length":  # which scales the unknowns too, and moves the nodes of a shape
        return
    expected = weights @ varied.rod(nodes=3).curvature[:, 1] / step
    found = solution.jacobian(name, of="curvature", at=0.25) @ direction.ravel()
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-8 * np.abs(expected).max())
    at = {"integrator": precise.integrator, "pose_sensitivities": True}
    problem = alone.problem(solution.inputs, **at, **alone.input_directions(name))
    problem.write("unknowns", solution.unknowns[None])
    slopes, _ = problem.input_columns(name)
    residual, _ = other.problem(varied.inputs, **at).evaluate(np.tile(solution.unknowns, (6, 1)))
    expected = weights @ residual / step
    np.testing.assert_allclose(slopes[0] @ direction.ravel(), expected, rtol=0, atol=1e-9 * np.abs(expected).max())


def test_derivatives_of_a_rod_whose_end_follows_it_are_refused():
    robot = mr.HeldRod(BENT)
    with pytest.raises(NotImplementedError, match="by length of a rod that is held where its end is at rest are not known"):
        robot.input_directions("length")


# ---- ends that are too far apart ----


def test_out_of_reach():
    """An end held farther away than the rod is long: nothing is integrated for it, and the others are what they are alone."""
    robot = mr.HeldRod(ROD)
    moves = np.array([(0.1, 0, -0.1), (0.5, 0, 0), (0, 0, 1e-3), (0, 0.4, -0.05)])
    inputs = robot.inputs(end_position=moves)
    solution = mr.solve(robot, inputs)
    beyond = np.linalg.norm(moves + ALONG, axis=1) > 1
    assert beyond.tolist() == [False, True, True, True]
    assert (solution.status[beyond] == mr.Status.OUT_OF_REACH).all()
    assert (solution.integrations[beyond] < 10).all()
    assert np.isnan(solution.tip_position[beyond]).all()
    alone = mr.solve(robot, robot.inputs(end_position=moves[0]))
    assert solution.status[0] == alone.status
    np.testing.assert_array_equal(solution.unknowns[0], alone.unknowns)
    guessed = mr.solve(robot, inputs, guess=np.broadcast_to(alone.unknowns, (4, 6)))
    assert guessed.status.tolist() == solution.status.tolist()
    assert guessed.integrations[beyond].max() < 10
    history = mr.simulate(robot, robot.inputs(end_position=moves[:2]), time=[0.0, 0.1])
    assert history.status.tolist() == [mr.Status.CONVERGED, mr.Status.OUT_OF_REACH]


@pytest.mark.parametrize("along", [0.0, 1.0])
def test_at_its_full_length_it_bears_nothing_across(along):
    """It can but be straight, whatever pulls: that is why there is no result, and is said."""
    robot = mr.HeldRod(ROD)
    few = mr.Shooting(max_integrations=300)
    loaded = mr.solve(robot, robot.inputs(distributed_force=(0.1, 0, along)), solver=few)
    assert loaded.status is mr.Status.OUT_OF_REACH
    with pytest.raises(mr.SolveError, match=r"or just as far, where they hold nothing across.*reaches 1 m of 1 m"):
        loaded.raise_if_failed()
    assert mr.solve(robot, robot.inputs(), solver=few).status is mr.Status.CONVERGED
    nearer = mr.solve(robot, robot.inputs(distributed_force=(0.1, 0, along), end_position=(0, 0, -1e-3)))
    assert nearer.status is mr.Status.CONVERGED
    with pytest.raises(mr.SolveError, match="FOLD: a mode is neutral there, or forces are not determined"):
        mr.critical_loads(robot, robot.inputs(distributed_force=(0.1, 0, along)))


def test_reach_along_a_slide_and_of_rods_that_stretch():
    sliding = mr.HeldRod(ROD, slide=ALONG)
    aside = np.array([(0, 0, 0.5), (0.999, 0, 0), (1.001, 0, 0)])
    found = mr.solve(sliding, sliding.inputs(end_position=aside)).status == mr.Status.OUT_OF_REACH
    assert found.tolist() == [False, False, True]
    soft = mr.HeldRod(mr.Rod(length=1, bending_stiffness=1, torsional_stiffness=0.8, shear_stiffness=1e3, axial_stiffness=1e3))
    longer = mr.solve(soft, soft.inputs(end_position=(0, 0, 0.01)))
    assert longer.status is mr.Status.CONVERGED
    np.testing.assert_allclose(longer.end_force, (0, 0, 10.0), atol=1e-6)  # EA times the strain
