"""Parallel robots that the first search loses: put together from legs at rest, followed as their joints close."""

import numpy as np
import pytest
from random_legs import draw, violation
from test_network_branches import PIECES, clamped, hold_columns_of_clamps

import multirod as mr
from multirod.capabilities import Loading
from multirod.models.joint_kernels import CLAMPED
from multirod.models.platform.problem import ParallelProblem
from multirod.rotations import matrices, vectors
from multirod.solver import Outcome
from multirod.solvers.continuation.natural import natural_branch
from multirod.solvers.continuation.paths import Paths
from multirod.solvers.starting import cold_start, multistart
from multirod.solvers.starting.releasing import AT_REST_SCATTERED, SCATTERED
from multirod.status import failures

AGAIN = 46  # numbers of robots that are solved by putting them together anew,
SNAPS = 13  # as their legs snap while they are joined,
AT_ONCE = 40  # and that the first search solves


def ring(count, radius):
    """Poses around a circle, turned by their angle, shape (count, 4, 4)."""
    poses = np.tile(np.eye(4), (count, 1, 1))
    for k, angle in enumerate(2 * np.pi * np.arange(count) / count):
        poses[k, :3, :3] = matrices(np.array([[0.1, 0.0, angle]]))[0]
        poses[k, :2, 3] = radius * np.cos(angle), radius * np.sin(angle)
    return poses


def lost_at_first(drawn):
    """Whether the first search ends before the load, or at an unstable state."""
    problem = drawn.robot.problem(drawn.inputs, integrator=mr.RK45())
    outcome = natural_branch(problem, mr.Shooting().newton(problem), 1000)
    return failures(outcome.status)[0] or problem.stability.modes().stability[0] == mr.Stability.UNSTABLE


@pytest.mark.parametrize(("number", "status"), [(AGAIN, mr.Status.CONVERGED), (SNAPS, mr.Status.SNAPPED)])
def test_robots_that_the_first_search_loses(number, status):
    drawn = draw(number)
    assert lost_at_first(drawn)
    solution = mr.solve(drawn.robot, drawn.inputs)
    assert solution.status is status
    assert solution.stability == mr.Stability.STABLE
    assert violation(drawn, solution) <= 1e-6  # of the length: what the default integrator promises


# clamped legs at their folds: one follows a moment, which rounding hid; one takes 1,600 steps in loads; one snaps while its legs
# are joined, beside which other equations move what is soft slowly; one has a leg that is pulled by 160 EI/L^2: differences from
# its base tell a judge nothing
@pytest.mark.parametrize(
    ("seed", "number", "judged", "snaps"), [(91, 56, False, 0), (91, 164, True, 0), (91, 266, True, 1), (0, 98, True, 0)]
)
def test_many_stiff_legs(seed, number, judged, snaps):
    drawn = draw(number, seed, 12, 5.0)
    solution = mr.solve(drawn.robot, drawn.inputs)
    assert not solution.failed
    assert (solution.stability == mr.Stability.STABLE) == judged  # nobody knows it of a moment that has no potential
    assert violation(drawn, solution) <= 1e-6  # as above
    snapped = [event for event in solution.events if event.status is mr.Status.SNAPPED and event.load_factor == 0]
    assert len(snapped) == snaps
    for event in snapped:
        assert np.isnan(event.energy_lost)  # what joints that give way store is in no potential
        assert "SNAPPED at a fold, load factor 0, as joints were closed, tip moved" in str(event)


def test_damped_dynamics_do_not_end_where_loads_drive_a_mode_away():
    """Twelve legs under a moment: what was come to there is unstable, as its determinant says."""
    drawn = draw(43, 0, 12, 5.0)
    solution = mr.solve(drawn.robot, drawn.inputs, solver=mr.Shooting(max_integrations=2500))
    assert solution.status in (mr.Status.UNSTABLE, mr.Status.INTEGRATION_LIMIT)
    assert np.isnan(solution.tip_position).all()


def test_a_moment_does_not_hide_what_happens_while_joints_close_without_it():
    """It was ``INTEGRATION_LIMIT``: damped dynamics, which loads without a potential ask for, came to no rest beyond the fold."""
    drawn = draw(70, 77, 12, 5.0)
    problem = drawn.robot.problem(drawn.inputs, integrator=mr.RK45())
    assert not problem.stability.has_potential[0]
    problem.joints.close(Loading.NONE)
    assert problem.stability.has_potential[0]
    solution = mr.solve(drawn.robot, drawn.inputs, solver=mr.Shooting(fallback=False))  # not in pieces
    assert solution.status is mr.Status.SNAPPED
    assert violation(drawn, solution) <= 1e-6  # as above
    assert [event.load_factor for event in solution.events] == [0.0]


@pytest.mark.parametrize("joint", ["clamped", "revolute"])
def test_legs_in_pieces_say_where_those_in_one_piece_are(joint):
    """(9c): of a batch of designs, one of a part of it; as stiff in torsion as in bending, bent, turned and pushed."""
    rods = [
        mr.Rod(
            length=0.3, bending_stiffness=(0.02, 0.03), torsional_stiffness=0.031, precurvature=(2, -1, 0.5), axial_stiffness=400
        ),
        mr.Rod(length=0.32, bending_stiffness=0.02, torsional_stiffness=0.015, axial_stiffness=300),
        mr.Rod(length=np.array([0.3, 0.31]), bending_stiffness=0.025, torsional_stiffness=0.02, axial_stiffness=300),
    ]
    robot = mr.ParallelRods(legs=rods, base=ring(3, 0.08), platform=ring(3, 0.04), joints=["clamped", "clamped", joint])
    loads = {"tip_force": (0.1, 0.05, -0.1), "tip_moment": (0.002, 0, 0.004), "follower_force": (0, 0.1, 0)}
    along = {"distributed_force": (0, 0.1, 0), "rotation": (0.3, -0.2, 0.1), "translation": (0.01, -0.01, 0.02)}
    inputs = robot.inputs(**loads, **along)
    found = mr.solve(robot, inputs)
    assert (found.status == mr.Status.CONVERGED).all()
    problem = robot.problem(inputs, integrator=mr.RK45())
    part = problem.parts.of(np.array([1]))
    pulled = np.zeros(part.unknown_count)
    pulled[part.own[1].stop - 1] = 150 / 0.32
    assert part.stand_in(0, 0.4 * pulled) is None  # hardly pulled
    cut = part.stand_in(0, pulled)
    outcome = natural_branch(cut.problem, mr.Shooting().newton(cut.problem), 1000)
    assert outcome.status[0] == mr.Status.CONVERGED
    unknowns, asked = cut.unknowns(), np.asarray(found.unknowns[1])
    np.testing.assert_allclose(unknowns, asked, rtol=0, atol=1e-6 * np.abs(asked).max())  # of the default integrator
    moved = robot.problem(robot.inputs(**loads, **along, force_point=(0.01, 0, 0)), integrator=mr.RK45())
    assert moved.stand_in(0, pulled) is None  # a network has none


def test_rounding_loosens_no_tolerance_that_is_given():
    drawn = draw(AT_ONCE)
    problem = drawn.robot.problem(drawn.inputs, integrator=mr.RK45())
    for given, least in ((None, 1e-7), (1e-10, 1e-10)):
        newton = mr.Shooting(tolerance=given).newton(problem)
        before = newton.tolerance()
        with newton.no_finer(np.full(1, 1e-7)):
            assert newton.tolerance() == least
        assert newton.tolerance() == before


def test_what_the_first_search_solves_pays_nothing(monkeypatch):
    drawn = draw(AT_ONCE)
    assert not lost_at_first(drawn)
    found = mr.solve(drawn.robot, drawn.inputs)
    monkeypatch.setattr(cold_start, "assemble", lambda *_, **__: None)
    monkeypatch.setattr(cold_start, "lowest_stable", lambda *_: None)
    without = mr.solve(drawn.robot, drawn.inputs)
    assert found.integrations == without.integrations
    np.testing.assert_array_equal(found.unknowns, without.unknowns)


@pytest.mark.parametrize("number", [AGAIN, SNAPS])
def test_in_a_batch_only_what_is_lost_goes_on(number):
    """Under three forces, the middle one its own: each is what it is alone."""
    drawn = draw(number)
    first = drawn.sections[0][0][0]
    unit = len(drawn.joints) * first["bending_stiffness"][0] / first["length"] ** 2
    forces = drawn.loads.get("tip_force", 0.0) + unit * np.array([[0.5, 0.2, -0.3], [0, 0, 0], [-0.4, 0.1, 0.6]])
    batch = mr.solve(drawn.robot, with_force(drawn, forces))
    assert len(set(batch.integrations.tolist())) > 1
    for k, force in enumerate(forces):
        alone = mr.solve(drawn.robot, with_force(drawn, force))
        assert batch.status[k] == alone.status
        assert batch.integrations[k] == alone.integrations
        np.testing.assert_array_equal(batch.unknowns[k], alone.unknowns)
        np.testing.assert_array_equal(batch.tip_position[k], alone.tip_position)


@pytest.mark.parametrize(("allowed", "again"), [(20_000, 3), (8_000, 0)])
def test_other_places_are_looked_at_before_they_are_followed(monkeypatch, allowed, again):
    """Of a robot that no place leads to: four are followed, twelve looked at, then followed as long as integrations last."""
    drawn, asked = draw(AGAIN), []

    def nowhere(problem, newton, numbers, go_on):
        asked.append((numbers[0], go_on is not None))
        outcome = Outcome.zeros(problem.instance_count)
        outcome.status[:], outcome.integrations[:] = mr.Status.BRANCH_END, 1000 if go_on else 1
        return outcome

    monkeypatch.setattr(cold_start, "assemble", lambda *_, **__: np.zeros(1, dtype=bool))
    monkeypatch.setattr(multistart, "settle", nowhere)
    solution = mr.solve(drawn.robot, drawn.inputs, solver=mr.Shooting(max_integrations=allowed))
    assert asked == [(0, True), (4, False), (8, False), (12, False), (4, True), (8, True), (12, True)][: 4 + again]
    assert (solution.status == mr.Status.INTEGRATION_LIMIT) == (not again)
    assert np.isnan(solution.tip_position).all()


def with_force(drawn, force):
    """The inputs with another force."""
    return drawn.robot.inputs(**drawn.loads | {"tip_force": force})


def test_motions_begin_there():
    drawn = draw(AGAIN)
    alone = mr.solve(drawn.robot, drawn.inputs)
    force = np.zeros((3, 3))
    history = mr.simulate(drawn.robot, with_force(drawn, force), time=np.arange(3.0))
    assert (history.status == mr.Status.CONVERGED).all()
    np.testing.assert_allclose(history.tip_position, np.tile(alone.tip_position, (3, 1)), atol=1e-9)
    tracker = mr.Tracker(drawn.robot, solver=mr.Shooting(), dt=0.01)
    step = tracker.step(drawn.inputs)
    np.testing.assert_array_equal(step.tip_position, alone.tip_position)


@pytest.mark.parametrize("number", [AT_ONCE, 25, 41])  # joints of all kinds, tubes
def test_apart_is_an_equilibrium_and_together_the_robot(number):
    drawn = draw(number)
    problem = drawn.robot.problem(drawn.inputs, integrator=mr.RK45())
    for place in (0, 3):
        x = problem.joints.apart(np.array([place]))
        with problem.at_load(0.0):
            residual, gamma = problem.evaluate(x)
        np.testing.assert_allclose(residual, 0.0, atol=1e-14 * np.abs(gamma).max())
        assert np.isfinite(gamma).all()
    together = problem.evaluate(x)[0]
    problem.joints.shut()
    np.testing.assert_array_equal(problem.evaluate(x)[0], together)
    for loading, factor in ((Loading.NONE, 0.0), (Loading.FULL, 1.0)):
        problem.joints.close(Loading.RISING)
        with problem.at_load(factor):
            same = problem.evaluate(x)[0]
        problem.joints.close(loading)
        with problem.at_load(0.3):
            np.testing.assert_array_equal(problem.evaluate(x)[0], same)


@pytest.mark.parametrize("number", [25, 41])  # joints of all kinds, tubes, bases that are turned
def test_gamma_on_the_way_together(number, difference):
    """(9), (9b) against differences, off the equilibrium: tips give way to the forces that legs bear meanwhile."""
    drawn = draw(number)
    problem = drawn.robot.problem(drawn.inputs, integrator=mr.RK4(50))
    x = problem.joints.apart()
    assert (problem.robots.soft.numpy() == 1).all()
    rng = np.random.default_rng(0)
    size = 0.3 * problem.curvature_scale()[0]
    x = x + size * rng.standard_normal(x.shape)
    with problem.at_load(0.4):
        _, gamma = problem.evaluate(x)
        for _ in range(3):
            way = rng.standard_normal(problem.unknown_count)
            found = difference(lambda t, way=way: problem.evaluate(x + t * way)[0][0], 1e-3 * size)
            # what rounding leaves of differences of a thousandth, and their sixth order
            np.testing.assert_allclose(gamma[0] @ way, found, rtol=0, atol=1e-9 * np.abs(found).max())


@pytest.mark.parametrize("number", [25, 41])  # joints of all kinds, tubes, bases that are turned
def test_clamps_of_legs_beside_tubes(number):
    """Legs of single rods are clamped at places along them, tubes beside them are not."""
    drawn = draw(number)
    problem, x = clamped(drawn.robot, drawn.inputs)
    rods = sum(len(leg) == 1 for leg in drawn.sections)
    assert 0 < rods < len(drawn.sections)
    assert problem.clamps.size == 3 * (PIECES - 1) * rods
    hold_columns_of_clamps(problem, x)


@pytest.mark.parametrize(("seed", "number"), [(91, 247), (92, 165)])
def test_legs_buckle_beside_tubes(seed, number):
    """Twelve legs, some of them two tubes: clamps along the others tell where these buckle."""
    drawn = draw(number, seed, 12, 5.0)
    solution = mr.solve(drawn.robot, drawn.inputs)
    assert solution.status in (mr.Status.SNAPPED, mr.Status.LOWEST_ENERGY)
    assert solution.stability is mr.Stability.STABLE


@pytest.mark.parametrize(("joints", "spreads"), [("clamped", (0.01, 0.03, 0.1)), ("spherical", (0.05, 0.1))])
def test_legs_whose_lengths_differ_are_put_together_as_a_network_is(joints, spreads):
    """Straight inextensible legs that are up to a tenth too long have buckled, and bear what the others do not."""
    rng = np.random.default_rng(0)
    angles = np.pi / 3 * np.arange(6) + 0.2 * np.array([1, -1] * 3)
    poses = np.tile(np.eye(4), (6, 1, 1))
    poses[:, :2, 3] = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    base, platform = poses.copy(), poses.copy()
    base[:, :2, 3] *= 0.08
    platform[:, :2, 3] *= 0.06
    force, gravity = (0.2, 0.1, 0), (0, 0, -9.81)
    for spread in spreads:
        wire = {"diameter": 2e-3, "young_modulus": 60e9, "shear_modulus": 23e9, "density": 6450}
        legs = [mr.Rod.wire(length=0.3 * (1 + spread * part), **wire) for part in rng.uniform(-1, 1, 6)]
        robot = mr.ParallelRods(legs=legs, base=base, platform=platform, platform_mass=0.05, joints=joints)
        found = mr.solve(robot, robot.inputs(tip_force=force, gravity=gravity)).raise_if_failed()
        network = mr.stacked(robot, names=["top"])
        expected = mr.solve(network, network.inputs(force={"top": force}, gravity=gravity)).raise_if_failed()
        assert found.stability == expected.stability == mr.Stability.STABLE
        # the residual's tolerance by what post-buckled legs make of it: 1e-9 of the platform's place was found
        np.testing.assert_allclose(found.tip_position, expected.tip_position, rtol=0, atol=1e-7)


def test_problems_that_do_not_come_apart_say_so():
    rod = mr.Rod(length=0.3, bending_stiffness=0.02, torsional_stiffness=0.015)
    robot = mr.SingleRod(rod)
    assert robot.problem(robot.inputs(), integrator=mr.RK45()).joints is None


@pytest.mark.parametrize("held", [False, True])
def test_modes_are_those_of_the_unknowns(held):
    """Of instances that nothing is integrated for too, as what is found at several places: their rods are not where they were."""
    strip = mr.Rod(length=0.2, bending_stiffness=0.02, torsional_stiffness=0.015, axial_stiffness=500.0)
    poses = np.tile(np.eye(4), (3, 1, 1))
    poses[:, :2, 3] = 0.05 * np.array([(1, 0), (-0.5, 0.8), (-0.5, -0.8)])
    if held:
        robot = mr.HeldRod(strip)
        inputs = robot.inputs(end_position=[(0, 0, -0.01), (0.03, 0, -0.05)])
    else:
        robot = mr.ParallelRods(legs=[strip] * 3, base=poses, platform=poses)
        inputs = robot.inputs(tip_force=[(0, 0, 0), (3, 2, -1)])
    problem = robot.problem(inputs, integrator=mr.RK45())
    mr.Shooting().solve(problem)
    with problem.everyone():
        modes, potential = problem.stability.modes(), problem.stability.potential()
    for name in ("unknowns", "inputs"):
        problem.write(name, problem.read(name)[::-1].copy())
    problem.active.fill_(0)
    again = problem.stability.modes()
    # the same numbers, by the same integrations
    np.testing.assert_allclose(again.values[::-1], modes.values, rtol=1e-9)
    np.testing.assert_allclose(problem.stability.potential()[::-1], potential, rtol=1e-9)


@pytest.mark.filterwarnings("ignore::multirod.PlausibilityWarning")
def test_straight_legs_that_are_rigid_in_torsion_stand_as_stiff_ones_do():
    """Taken for beams they answer no torque: this raised `LinAlgError`."""
    base, found = np.tile(np.eye(4), (2, 1, 1)), []
    base[:, 0, 3] = 0.05, -0.05
    for torsion in (np.inf, 1e3):
        strip = mr.Rod(length=0.2, bending_stiffness=(1.0, 0.0125), torsional_stiffness=torsion)
        robot = mr.ParallelRods(legs=[strip] * 2, base=base, platform=base)
        found.append(mr.solve(robot, robot.inputs(tip_force=(0.1, 0.05, -0.3))).raise_if_failed())
    assert all(own.stability is mr.Stability.STABLE for own in found)
    np.testing.assert_allclose(found[0].tip_position, found[1].tip_position, rtol=0, atol=1e-6)


def test_a_pose_is_reached_from_where_the_robot_rests_when_its_platform_is_let_go(monkeypatch):
    """(10c) Legs whose bases and attachments are tilted: no branch of the inverse problem leads to these from straight ones."""
    drawn = draw(177)
    robot, turned = drawn.robot, drawn.loads["rotation"]
    assert set(robot.geometry.joints.tolist()) == {CLAMPED}
    length = np.array([rod.length for rod in robot.rods])
    translation = length * np.random.default_rng(0).uniform(-0.1, 0.1, (4, 6))
    there = mr.solve(robot, robot.inputs(translation=translation, rotation=turned)).raise_if_failed()
    inverse = robot.inverse()
    pose = {"platform_position": there.tip_position, "platform_rotation": vectors(there.tip_rotation)}
    inputs = inverse.inputs(**pose, rotation=turned)
    found = mr.solve(inverse, inputs).raise_if_failed()
    np.testing.assert_allclose(inverse.translations(found), translation, rtol=0, atol=1e-7 * length.max())  # 1e-10 was seen
    assert (found.stability == mr.Stability.STABLE).all()
    assert found.integrations.max() < 1000
    monkeypatch.setattr(ParallelProblem, "released", lambda self, *numbers: None)
    assert mr.solve(inverse, inputs).failed.all()


def test_a_pose_that_no_other_way_leads_to_is_reached_from_legs_of_several_lengths():
    """(10d) As above, of poses farther off: the translations that the robot stands by, alone as in a batch."""
    drawn = draw(96)
    robot, turned = drawn.robot, drawn.loads["rotation"]
    length = np.array([rod.length for rod in robot.rods])
    translation = length * np.random.default_rng(0).uniform(-0.25, 0.25, (8, 6))[[0, 2, 7]]
    there = mr.solve(robot, robot.inputs(translation=translation, rotation=turned)).raise_if_failed()
    inverse, place, turn = robot.inverse(), there.tip_position, vectors(there.tip_rotation)
    inputs = inverse.inputs(platform_position=place, platform_rotation=turn, rotation=turned)
    found = mr.solve(inverse, inputs).raise_if_failed()
    np.testing.assert_allclose(inverse.translations(found), translation, rtol=0, atol=1e-7 * length.max())  # 1e-11 was seen
    assert (found.stability == mr.Stability.STABLE).all()
    alone = mr.solve(inverse, inverse.inputs(platform_position=place[1], platform_rotation=turn[1], rotation=turned))
    np.testing.assert_array_equal(alone.unknowns, found.unknowns[1])
    without = mr.solve(inverse, inputs, solver=mr.Shooting(max_integrations=SCATTERED * AT_REST_SCATTERED))
    assert without.failed.all()
    assert (without.integrations < 1000).all()  # so much they did not take: there was nothing more to do


def test_legs_of_a_platform_that_is_let_go_are_no_shorter_than_the_way_to_their_attachments():
    """(10d) Up to half as long again, most of them little, by the same parts for every pose, within limits."""
    robot = draw(177).robot
    length, high = np.array([rod.length for rod in robot.rods]), 0.2
    poses = {"platform_position": [(0, 0, 0.7 * length.mean()), (0.1 * length.mean(), 0, length.mean())]}
    ways = np.linalg.norm(np.array(poses["platform_position"])[:, None] + robot.platform[:, :3, 3] - robot.base[:, :3, 3], axis=2)
    parts = []
    for limits in (None, (-np.inf, high * length)):
        inverse = robot.inverse(limits=limits)
        problem = inverse.problem(inverse.inputs(translation=0.01 * length, **poses), integrator=mr.RK4(20))
        released = problem.released(np.repeat([0, 1], 17), np.tile(np.arange(17), 2)).problem
        pushed = released.read("inputs")[:, released.input_slice("translation")].reshape(2, 17, 6)
        parts.append((pushed + length) / ways[:, None] - 1)
    np.testing.assert_allclose(parts[0][0], parts[0][1], rtol=0, atol=1e-12)
    np.testing.assert_allclose(parts[0][:, 0], 0, atol=1e-12)
    drawn = parts[0][:, 1:]
    assert drawn.min() >= 0
    assert 0.4 < drawn.max() <= 0.5
    assert 0.03 < np.median(drawn) < 0.1  # 1/16 of what is drawn evenly
    most = (1 + high) * length / ways[:, None] - 1
    assert (drawn > most).any()
    np.testing.assert_allclose(parts[1][:, 1:], np.minimum(drawn, most), rtol=0, atol=1e-12)


def test_joints_that_did_not_close_are_not_closed_again(monkeypatch):
    """What snaps as its joints close: that is followed from where they were held up."""
    starts, raise_from = [], Paths.raise_from

    def noted(self, chosen, unknowns, *args, **options):
        if chosen.any():
            loading = self.problem.robots.loading.numpy().tobytes()  # beams that do not close without loads may with them
            starts.append((self.problem.instance_count, loading, unknowns.tobytes()))
        return raise_from(self, chosen, unknowns, *args, **options)

    monkeypatch.setattr(Paths, "raise_from", noted)
    drawn = draw(266, 91, 12, 5.0)
    solution = mr.solve(drawn.robot, drawn.inputs, solver=mr.Shooting(fallback=False))  # not in pieces
    assert [event.load_factor for event in solution.events] == [0.0]
    assert len(set(starts)) == len(starts) > 1
