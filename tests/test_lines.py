"""Tendons: equilibria against the rate form with its point loads, exact derivatives, lengths, what is refused."""

from itertools import pairwise

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import multirod as mr

EI, GJ, GA, EA, LENGTH = 0.01, 0.0077, 40.0, 90.0, 0.2
CURVED = np.array([1.0, -0.5, 0.3])
PRECISE = mr.Shooting(tolerance=1e-10, integrator=mr.RK45(rtol=1e-12, atol=1e-14))
TENSION, FORCE = np.array([1.5, 0.7, 1.0]), np.array([0.3, 0.2, 0.1])
RADIUS, TURN = 0.006, 30.0
STRAIGHT = mr.Rod(length=LENGTH, bending_stiffness=EI, torsional_stiffness=GJ, lines=[mr.Tendon(offset=(0.008, 0), name="right")])


def helix(s):
    return RADIUS * np.cos(TURN * s), RADIUS * np.sin(TURN * s)


def general() -> mr.SingleRod:
    """One line straight to the end, one round the rod and fastened before its end, one that begins and ends along it."""
    lines = [
        mr.Tendon(offset=(0.008, 0.002), name="right"),
        mr.Tendon(route=helix, end=0.14, name="helix"),
        mr.Tendon(route=lambda s: (0.003 - 0.02 * s, -0.004 + 0.1 * s**2), start=0.05, end=0.17),
    ]
    soft = {"shear_stiffness": GA, "axial_stiffness": EA, "precurvature": CURVED}
    rod = mr.Rod(length=LENGTH, bending_stiffness=(EI, 1.5 * EI), torsional_stiffness=GJ, lines=lines, **soft)
    return mr.SingleRod(rod)


ROBOT = general()


def solved(tension=TENSION, force=FORCE, **more) -> mr.Solution:
    return mr.solve(ROBOT, ROBOT.inputs(tension=tension, tip_force=force, **more), solver=PRECISE)


@pytest.fixture(scope="module")
def solution() -> mr.Solution:
    return solved()


# ---- the rate form (Rucker and Webster, 2011): u and v are states, and a line that ends pulls by a point load ----

ROUTES = (  # offset, its first and second derivative, start, end
    (lambda s: ((0.008, 0.002, 0), (0, 0, 0), (0, 0, 0)), 0.0, LENGTH),
    (
        lambda s: (
            (*helix(s), 0),
            (-RADIUS * TURN * np.sin(TURN * s), RADIUS * TURN * np.cos(TURN * s), 0),
            (-RADIUS * TURN**2 * np.cos(TURN * s), -RADIUS * TURN**2 * np.sin(TURN * s), 0),
        ),
        0.0,
        0.14,
    ),
    (lambda s: ((0.003 - 0.02 * s, -0.004 + 0.1 * s**2, 0), (-0.02, 0.2 * s, 0), (0, 0.2, 0)), 0.05, 0.17),
)
K, S = np.diag([EI, 1.5 * EI, GJ]), np.diag([GA, GA, EA])


def hat(a):
    return np.array([[0, -a[2], a[1]], [a[2], 0, -a[0]], [-a[1], a[0], 0]])


def pull(k, s, u, v):
    """Force and moment of line k on the section."""
    r, slope, _ = np.array(ROUTES[k][0](s), dtype=float)
    tangent = np.cross(u, r) + slope + v
    force = TENSION[k] * tangent / np.linalg.norm(tangent)
    return force, np.cross(r, force)


def rates(s, y, lines):
    R, u, v = y[3:12].reshape(3, 3), y[12:15], y[15:]
    left = np.zeros((6, 6))
    left[:3, :3], left[3:, 3:] = S, K
    N, M = S @ (v - [0, 0, 1]), K @ (u - CURVED)
    right = np.concatenate([-np.cross(u, N), -np.cross(u, M) - np.cross(v, N)])
    for k in lines:
        r, slope, bend = np.array(ROUTES[k][0](s), dtype=float)
        tangent = np.cross(u, r) + slope + v
        A = -TENSION[k] * hat(tangent) @ hat(tangent) / np.linalg.norm(tangent) ** 3
        a = A @ (np.cross(u, tangent) + np.cross(u, slope) + bend)
        left += np.block([[A, -A @ hat(r)], [hat(r) @ A, -hat(r) @ A @ hat(r)]])
        right -= np.concatenate([a, np.cross(r, a)])
    slopes = np.linalg.solve(left, right)
    return np.concatenate([R @ v, (R @ hat(u)).ravel(), slopes[3:], slopes[:3]])


def test_equilibrium_is_that_of_the_rate_form_with_point_loads(solution):
    shape = solution.rod(0, nodes=2)
    u, v = shape.curvature[0], np.array([0, 0, 1]) + np.linalg.solve(S, shape.force[0])
    y = np.concatenate([np.zeros(3), np.eye(3).ravel(), u, v])
    ends = sorted({e for _, *edges in ROUTES for e in edges})
    for start, end in pairwise(ends):
        here = [k for k, (_, a, b) in enumerate(ROUTES) if a <= start < b]
        y = solve_ivp(rates, (start, end), y, method="DOP853", rtol=1e-11, atol=1e-13, args=(here,)).y[:, -1]
        after = [k for k, (_, a, b) in enumerate(ROUTES) if a <= end < b]
        if end < LENGTH:
            # what lines that end have carried is the rod's from there on; the strains jump
            total = np.concatenate([S @ (y[15:] - [0, 0, 1]), K @ (y[12:15] - CURVED)])
            total = total + sum((np.concatenate(pull(k, end, y[12:15], y[15:])) for k in here), np.zeros(6))
            for _ in range(50):
                own = total - sum((np.concatenate(pull(k, end, y[12:15], y[15:])) for k in after), np.zeros(6))
                y[15:], y[12:15] = np.array([0, 0, 1]) + np.linalg.solve(S, own[:3]), CURVED + np.linalg.solve(K, own[3:])
    force, moment = pull(0, LENGTH, y[12:15], y[15:])
    R = y[3:12].reshape(3, 3)
    np.testing.assert_allclose(S @ (y[15:] - [0, 0, 1]), R.T @ FORCE - force, atol=1e-8)
    np.testing.assert_allclose(K @ (y[12:15] - CURVED), -moment, atol=1e-9)
    np.testing.assert_allclose(solution.tip_position, y[:3], atol=1e-10)
    np.testing.assert_allclose(solution.tip_rotation, R, atol=1e-9)


# ---- derivatives, lengths, energy ----


def test_derivatives_by_tensions_are_exact_and_lengths_are_conjugate_to_them(solution):
    pose, lengths = solution.jacobian("tension"), solution.jacobian("tension", of="line_length")
    h = 1e-3
    for k, e in enumerate(h * np.eye(3)):
        ends = solved(TENSION + e), solved(TENSION - e)
        np.testing.assert_allclose(pose[:3, k], (ends[0].tip_position - ends[1].tip_position) / (2 * h), atol=1e-9)
        np.testing.assert_allclose(lengths[:, k], (ends[0].line_length - ends[1].line_length) / (2 * h), atol=1e-9)
        # the total energy is stationary: a tension adds its line's length to it, and takes that from the rod
        np.testing.assert_allclose((ends[0].potential - ends[1].potential) / (2 * h), solution.line_length[k], atol=1e-9)
        stored = (ends[0].energy - ends[1].energy) / (2 * h)
        work = FORCE @ (ends[0].tip_position - ends[1].tip_position) / (2 * h) - TENSION @ lengths[:, k]
        np.testing.assert_allclose(stored, work, atol=1e-9)
    assert np.abs(lengths - lengths.T).max() < 1e-10 * np.abs(lengths).max()
    assert np.linalg.eigvalsh(lengths).max() < 0  # more tension, shorter lines
    assert str(solution.stability) == "STABLE"


def test_lengths_vary_with_a_follower_force_of_zero_as_with_a_dead_one(solution):
    lengths = solution.jacobian("follower_force", of="line_length")
    assert lengths.shape == (3, 3)
    np.testing.assert_allclose(lengths, solution.jacobian("tip_force", of="line_length") @ solution.tip_rotation, rtol=1e-14)


@pytest.mark.parametrize("pushed", [0.01, -0.012])
def test_translation_moves_routes_with_the_rod(pushed):
    h = 1e-4
    near = [solved(translation=pushed + t) for t in (h, -h)]
    here = solved(translation=pushed)
    slope = (near[0].tip_position - near[1].tip_position) / (2 * h)
    np.testing.assert_allclose(here.jacobian("translation")[:3, 0], slope, atol=3e-7)
    slope = (near[0].line_length - near[1].line_length) / (2 * h)
    np.testing.assert_allclose(here.jacobian("translation", of="line_length")[:, 0], slope, atol=3e-7)
    shape, line = here.rod(0, nodes=5), here.line("helix", nodes=5)
    inside = shape.arclength - pushed <= 0.14
    rho = np.array([helix(max(s, 0.0)) for s in shape.arclength - pushed])
    expected = shape.position + (shape.rotation[:, :, :2] @ rho[..., None])[..., 0]
    np.testing.assert_allclose(line.position[inside], expected[inside], atol=1e-12)


def test_lines_are_where_they_are_fastened_and_as_long_as_they_say(solution):
    count = 4001
    for k, name in enumerate(["right", "helix", 2]):
        line = solution.line(name, nodes=count)
        there = ~np.isnan(line.tension)
        start, end = ROUTES[k][1:]
        np.testing.assert_array_equal(there, (line.arclength >= start - 1e-12) & (line.arclength <= end + 1e-12))
        np.testing.assert_array_equal(line.tension[there], TENSION[k])
        chords = np.linalg.norm(np.diff(line.position[there], axis=0), axis=1).sum()
        np.testing.assert_allclose(chords, solution.line_length[k], rtol=1e-7)
    np.testing.assert_array_equal(solution.tension, TENSION)


def test_the_rod_and_its_lines_carry_force_and_moment_together(solution):
    shape = solution.rod(0, nodes=41)
    R = shape.rotation
    np.testing.assert_allclose((R @ shape.total_force[..., None])[..., 0], np.tile(FORCE, (41, 1)), atol=1e-9)
    for node in (0, 20, 40):
        s = shape.arclength[node]
        u, v = shape.curvature[node], np.array([0, 0, 1]) + np.linalg.solve(S, shape.force[node])
        here = [pull(k, s, u, v) for k, (_, a, b) in enumerate(ROUTES) if a <= s <= b]
        np.testing.assert_allclose(shape.force[node] + sum(f for f, _ in here), shape.total_force[node], atol=1e-9)
        np.testing.assert_allclose(shape.moment[node] + sum(m for _, m in here), shape.total_moment[node], atol=1e-10)
    np.testing.assert_allclose(shape.total_moment[-1], 0, atol=1e-10)


def test_a_batch_is_bitwise_what_each_is_alone():
    tensions = np.array([[1.5, 0.7, 1.0], [0, 0, 0], [0, 9.0, 0], [20.0, 0.1, 3.0], [0.01, 0.0, 0.0]])
    batch = solved(tensions)
    assert (batch.status == mr.Status.CONVERGED).all()
    for k in range(len(tensions)):
        np.testing.assert_array_equal(batch.tip_position[k], solved(tensions[k : k + 1]).tip_position[0])


# ---- an inextensible rod: closed forms, control ----

FIXED = mr.Shooting(integrator=mr.RK4(20))


def test_one_straight_tendon_bends_the_rod_to_a_circle_at_order_four():
    robot = mr.SingleRod(STRAIGHT)
    inputs = robot.inputs(tension=9.0)
    kappa = 9.0 * 0.008 / EI
    exact = np.array([(1 - np.cos(kappa * LENGTH)) / kappa, 0, np.sin(kappa * LENGTH) / kappa])
    errors = []
    for steps in (8, 16, 32):
        solution = mr.solve(robot, inputs, solver=mr.Shooting(integrator=mr.RK4(steps)))
        assert solution.residual == 0  # no unknown: the moment of rod and line is zero all along
        errors.append(np.linalg.norm(solution.tip_position - exact))
    assert 14 < errors[0] / errors[1] < 18
    assert 14 < errors[1] / errors[2] < 18
    np.testing.assert_allclose(solution.line_length, LENGTH * (1 - kappa * 0.008), rtol=1e-12)
    shape = solution.rod(0)
    np.testing.assert_allclose(shape.force, np.tile([0, 0, -9.0], (33, 1)), atol=1e-12)  # the tendon pulls it together
    np.testing.assert_allclose(shape.moment, np.tile([0, EI * kappa, 0], (33, 1)), atol=1e-12)
    np.testing.assert_allclose(solution.energy, EI * kappa**2 * LENGTH / 2, rtol=1e-12)


# ---- a published code ----


def published_robot(*, shear: bool = True, turns: float = 0.0, **drive: object) -> mr.SingleRod:
    """Four tendons on a steel wire, from the programs of J. Till's ContinuumRobotExamples, 05 and 06 of its statics."""
    E, G, radius, density, length, pitch = 200e9, 80e9, 1e-3, 8000.0, 0.5, 0.01506
    area, I = np.pi * radius**2, np.pi * radius**4 / 4
    angles = np.radians([0, 90, 180, 270])

    def route(angle):
        def around(s):
            return pitch * np.cos(turns * 2 * np.pi * s / length + angle), pitch * np.sin(turns * 2 * np.pi * s / length + angle)

        return around

    lines = [mr.Tendon(route=route(angle), **drive) if turns else mr.Tendon(route(angle)(0), **drive) for angle in angles]
    soft = {"shear_stiffness": G * area, "axial_stiffness": E * area} if shear else {}
    bending = {"bending_stiffness": E * I, "torsional_stiffness": 2 * G * I}
    return mr.SingleRod(mr.Rod(length=length, linear_density=density * area, lines=lines, **bending, **soft))


# tips that those programs find, run with their integrator at 1000 steps in place of 100 and tolerances of 1e-19 on the sum of
# squares; as published they are up to 2e-7 m from these
@pytest.mark.parametrize(
    ("options", "inputs", "tip"),
    [
        ({}, {"tension": (15, 0, 0, 0)}, (0.182211694557, 0, 0.453229270926)),
        ({"shear": False}, {"tension": (15, 0, 0, 0)}, (0.182216165518, 0, 0.453239992124)),
        ({"turns": 1}, {"tension": (15, 0, 0, 0)}, (0.0122099414715, 0.0581888210022, 0.493348325699)),
        (
            {"driven": "displacement", "axial_stiffness": 1e4},
            {"displacement": (0.005, 0, -0.005, 0)},
            (0.0814280192576, 0, 0.491303016429),
        ),
    ],
    ids=["Cosserat", "Kirchhoff", "helical", "displacement"],
)
def test_a_published_robot_of_four_tendons_ends_where_its_own_program_says(options, inputs, tip):
    robot = published_robot(**options)
    solution = mr.solve(robot, robot.inputs(gravity=(9.81, 0, 0), **inputs))
    np.testing.assert_allclose(solution.tip_position, tip, atol=1e-9)  # those digits; both integrations are better than that
    np.testing.assert_array_equal(solution.slack, [False] + 3 * ["driven" in options])


def test_rods_and_solutions_show_what_they_are():
    robot = mr.SingleRod(STRAIGHT)
    assert repr(robot) == f"SingleRod(Rod({LENGTH:g} m, EI {EI:g}, GJ {GJ:g} N m^2, 1 line))"
    pulled = mr.solve(robot, robot.inputs(tension=[[1.0], [141.0]]), solver=FIXED)
    x, _, z = pulled.tip_position[0]
    assert repr(pulled[0]) == f"Solution(CONVERGED, tip ({x:.5g}, 0, {z:.5g}) m, residual 0 1/m)"
    assert repr(pulled[1]) == "Solution(LINE_LIMIT, residual nan 1/m)"


def test_a_line_at_the_centre_of_curvature_fails():
    """Where a tenth of its length is left: ``1 - T r^2/EI = 0.1``."""
    robot = mr.SingleRod(STRAIGHT)
    solution = mr.solve(robot, robot.inputs(tension=[[140.0], [141.0]]), solver=FIXED)
    assert solution.status.tolist() == [mr.Status.CONVERGED, mr.Status.LINE_LIMIT]
    assert np.isnan(solution.line_length[1]).all()


def test_a_tracker_follows_tensions_by_one_integration():
    robot = mr.SingleRod(STRAIGHT)
    tracker = mr.Tracker(robot, inputs=robot.inputs(tension=1.0), solver=FIXED, dt=0.01)
    tracker.step()
    for tension in (1.02, 1.1, 1.2):
        sample = tracker.step(tension=tension)
        assert sample.integrations == 1
        np.testing.assert_array_equal(
            sample.tip_position, mr.solve(robot, robot.inputs(tension=tension), solver=FIXED).tip_position
        )
        assert sample.tension == tension
    with pytest.raises(ValueError, match=r"tension = .*-1.* is not allowed: must be >= 0"):
        tracker.step(tension=-1.0)


def test_a_recording_draws_lines(tmp_path):
    robot = mr.SingleRod(STRAIGHT)
    motion = mr.simulate(robot, robot.inputs(tension=np.linspace(0, 1, 5)[:, None]), time=np.arange(5) * 0.01, solver=FIXED)
    motion.save(tmp_path / "motion.rrd")
    assert b"/world/lines/" in (tmp_path / "motion.rrd").read_bytes()


# ---- what is refused ----


def test_which_of_a_batch_pushes_is_said():
    tension = np.ones((30, len(ROBOT.rod.lines)))
    tension[17, 0] = -1.0
    with pytest.raises(ValueError, match=r"tension = \[-1\.0.*\] at \[17\] is not allowed: must be >= 0"):
        mr.solve(ROBOT, ROBOT.inputs(tension=tension))


def test_what_cannot_be_is_refused_by_name():
    robot = mr.SingleRod(STRAIGHT)
    for value, message in (((1, 1, -0.1), "must be >= 0"), ((1.0, 2.0), r"must have shape \(\.\.\., 3\)"), (np.nan, "finite")):
        with pytest.raises(ValueError, match=rf"tension = .* is not allowed: .*{message}"):
            ROBOT.inputs(tension=value)
    bare = mr.Rod(length=0.2, bending_stiffness=EI, torsional_stiffness=GJ)
    for other in (mr.SingleRod(bare), mr.ConcentricTubes([bare])):
        with pytest.raises(ValueError, match=r"tension = 1.0 is not allowed: must not be given: no rod has a line"):
            other.inputs(tension=1.0)
    with pytest.raises(ValueError, match=r"tip_curvature = .* is not allowed: must not be given: the rod has lines"):
        robot.inputs(tip_curvature=(1, 0, 0))
    with pytest.raises(
        ValueError, match=r"line = 'left' is not allowed: must be an index below 1 or one of the names \['right'\]"
    ):
        mr.solve(robot, robot.inputs(), solver=FIXED).line("left")


@pytest.mark.parametrize(
    ("options", "error", "message"),
    [
        ({}, TypeError, "takes either offset or route"),
        ({"offset": (0, 0), "route": helix}, TypeError, "takes either offset or route"),
        ({"offset": (0, 0, 0)}, ValueError, r"Tendon.offset = .* must have shape \(\.\.\., 2\)"),
        ({"route": 3}, ValueError, "Tendon.route = 3 is not allowed: must be a function"),
        ({"route": lambda s: s}, ValueError, r"Tendon.route\(0\) = 0.0 is not allowed: must be 2 finite numbers"),
        ({"offset": (0, 0), "start": -0.1}, ValueError, "Tendon.start = -0.1 is not allowed"),
        ({"offset": (0, 0), "start": 0.1, "end": 0.05}, ValueError, "Tendon.end = 0.05 is not allowed: must be > start = 0.1"),
        (
            {"offset": (0, 0), "end": 0.3},
            ValueError,
            "Tendon.end = 0.3 is not allowed: must be at most the length of the rod, 0.2 m",
        ),
        ({"offset": (0, 0), "start": 0.2}, ValueError, "Tendon.start = 0.2 is not allowed: must be less than the length"),
        ({"offset": (0, 0), "driven": "pressure"}, ValueError, "Tendon.driven = 'pressure' is not allowed"),
        ({"offset": (0, 0), "name": 1}, ValueError, "Tendon.name = 1 is not allowed: must be a string"),
    ],
)
def test_a_tendon_that_cannot_be_is_refused(options, error, message):
    with pytest.raises(error, match=message):
        mr.Rod(length=0.2, bending_stiffness=EI, torsional_stiffness=GJ, lines=[mr.Tendon(**options)])


def test_a_rod_takes_lines_with_names_of_their_own():
    with pytest.raises(ValueError, match=r"Rod.lines = .* is not allowed: must be a list of lines"):
        mr.Rod(length=0.2, bending_stiffness=EI, torsional_stiffness=GJ, lines=["a tendon"])
    with pytest.raises(ValueError, match="must have names of their own, and 'a' is there twice"):
        mr.Rod(length=0.2, bending_stiffness=EI, torsional_stiffness=GJ, lines=[mr.Tendon((0, 0), name="a")] * 2)
