"""What rods of networks are eliminated by: how their tips are turned, or what leaves the joints there without torque."""

import numpy as np
import pytest
from scipy.optimize import brentq
from scipy.special import ellipe, ellipk
from test_network import EXACT, GIVEN, RK4, mixed, pose

import multirod as mr
from multirod.models.network.elements.elements import Elements, torque_units
from multirod.models.network.stability import stability as network_stability
from multirod.models.platform.problem import ParallelProblem
from multirod.solvers.continuation.natural import natural_branch
from multirod.solvers.continuation.paths import Paths

STEEP = {name: value for name, value in GIVEN.items() if name != "moment"}  # loads with a potential
ROUND = mr.Rod(length=0.4, bending_stiffness=0.2233, torsional_stiffness=0.0638)


def eliminated(problem, monkeypatch, *, with_joints):
    """The form at the unknowns, what was eliminated before it counts, and unknowns that are angles of joints at tips among it."""
    monkeypatch.setattr(network_stability, "DOUBTFUL", 0.0 if with_joints else np.inf)
    monkeypatch.setattr(network_stability, "BETTER", np.inf)
    own = problem.stability
    with problem.everyone():
        problem.integrate_rods()
        elements, state = Elements(problem), problem.state()
        elimination = own._elimination(elements)
        joints = own._freed(state, elimination)
        form = own._form(state, elements, elimination)[0]
        hidden, known = own._of_rods(joints)
    assert known[0]
    assert elimination.sound[0]
    assert elimination.freed.any() == with_joints
    angles = problem.places[:, problem.layout.angles_at[1]]
    at = own.rows.of(angles[angles >= 0])
    return form, hidden[0].sum(), at


def both_ways_agree(problem, monkeypatch, atol):
    """Haynsworth's rule: angles eliminated before or after."""
    form, hidden, at = eliminated(problem, monkeypatch, with_joints=False)
    other, with_joints, _ = eliminated(problem, monkeypatch, with_joints=True)
    rest = np.setdiff1d(np.arange(len(form)), at)
    own = form[np.ix_(at, at)]
    expected = form[np.ix_(rest, rest)] - form[np.ix_(rest, at)] @ np.linalg.solve(own, form[np.ix_(at, rest)])
    np.testing.assert_allclose(other[np.ix_(rest, rest)], expected, rtol=0, atol=atol)
    assert np.abs(other[np.ix_(rest, at)]).max() == np.abs(other[np.ix_(at, rest)]).max() == 0
    assert (np.linalg.eigvalsh(other[np.ix_(at, at)]) > 0).all()
    assert with_joints == hidden + (np.linalg.eigvalsh(0.5 * (own + own.T)) < 0).sum()
    return with_joints


def test_joints_are_eliminated_before_or_after(monkeypatch):
    """(31) Hinge, universal joint and ball with springs, turned, on bodies that are, by angles of which axes turn with others."""
    robot = mixed()
    solution = mr.solve(robot, robot.inputs(**STEEP), solver=EXACT)
    problem = robot.problem(robot.inputs(**STEEP), integrator=RK4)
    problem.evaluate(solution.unknowns[None])
    # of numbers of up to 30: what the solution leaves of torques, and rounding of an inverse
    both_ways_agree(problem, monkeypatch, 1e-7)


def test_what_a_joint_says_of_its_rod_is_what_the_network_says(monkeypatch):
    """(31) By the moment and the turn of the tip, against (9) by the unknowns of the rod and the angles that follow from them."""
    robot = mixed()
    solution = mr.solve(robot, robot.inputs(**STEEP), solver=EXACT)
    problem = robot.problem(robot.inputs(**STEEP), integrator=RK4)
    problem.evaluate(solution.unknowns[None])
    monkeypatch.setattr(network_stability, "DOUBTFUL", 0.0)
    monkeypatch.setattr(network_stability, "BETTER", np.inf)
    problem.integrate_rods()
    elements, state = Elements(problem), problem.state()
    joints = problem.stability._freed(state, problem.stability._elimination(elements))
    (group,), angles = problem.groups, problem.layout.angles_at[1]
    moment, turn = group.backbones.wrench_columns.numpy()[:, 3:, :6], group.backbones.pose_columns.numpy()[:, 3:, :6]
    for rod, count in ((0, 1), (1, 3), (2, 2)):
        columns, free = elements.columns[0, rod], slice(angles.start, angles.start + count)
        by_angle, by_own = columns[3:6, free], columns[3:6, :6]
        # changes of the rod that the joint can follow
        across = np.linalg.svd(by_angle)[0][:, count:]
        own = np.linalg.svd(across.T @ by_own)[2][3 - count :].T
        follow = -np.linalg.pinv(by_angle) @ by_own @ own
        torque = torque_units(problem, 1)[0, rod, :count, None] * (columns[free, :6] @ own + columns[free, free] @ follow)
        frame = state.ends[0].rotation[0, rod].T @ state.ends[1].frame[0, rod]
        expected = frame @ np.linalg.pinv(state.ends[1].joints.axes[0, rod][:, :count]).T @ torque
        found = joints.free[0, rod] @ moment[rod] @ own + joints.spring[0, rod] @ turn[rod] @ own
        # the same numbers by two ways, at an equilibrium to 1e-11
        np.testing.assert_allclose(found, expected, rtol=0, atol=1e-9 * np.abs(expected).max())


@pytest.mark.parametrize("load", [0.2, 0.9, 1.5, 3.5, 9.5, 12.0])  # of Euler's with the tip free
def test_columns_with_springs_at_their_tips(load, monkeypatch):
    """The index of a straight column whose tip springs let turn about one axis more than about the other: in closed form."""
    L, EI = 0.4, 0.2233
    springs = np.array([0.5, 3.0]) * EI / L
    plate = mr.Body("plate")
    joints = [
        mr.Joint("column", "base", to=mr.ground, pose=pose((0.3, 0, 0.2))),
        mr.Joint("column", "tip", to=plate, kind="universal", axis=np.eye(3)[:2], stiffness=springs),
    ]
    robot = mr.Network(rods={"column": ROUND}, bodies=[plate], joints=joints)
    size = load * np.pi**2 / 4 * EI / L**2
    along = pose((0.3, 0, 0.2))[:3, 2]
    problem = robot.problem(robot.inputs(force={"plate": -size * along}), integrator=mr.RK4(100))
    x = np.array(problem.guess())
    x[0, problem.graph.along[0]] = -size * L**2 / EI / L  # told as a curvature
    residual, _ = problem.evaluate(x)
    assert np.abs(residual).max() < 1e-9
    found = both_ways_agree(problem, monkeypatch, 1e-6)
    # with the load as it is, EI phi'' = -F phi, phi(0) = 0, EI phi'(L) = -k phi(L)
    omega = np.sqrt(size / EI) * L
    expected = 0
    for k in springs * L / EI:
        for branch in range(4):
            first = brentq(lambda w, k=k: w * np.cos(w) + k * np.sin(w), (branch + 0.5) * np.pi, (branch + 1) * np.pi)
            expected += omega > first
    assert found == expected


def test_a_strut_without_end_moments_buckles():
    """A round strut between a ball and a universal joint under a beam: how its tip is turned hardly says how it is bent, as it is
    the same to both sides. Its force beyond Euler's load is that of the elastica whose chord it has."""
    plate = mr.Body("plate")
    beam = mr.Rod(length=0.4, bending_stiffness=2.0, torsional_stiffness=1.0)
    joints = [
        mr.Joint("strut", "base", to=mr.ground, kind="spherical"),
        mr.Joint("strut", "tip", to=plate, kind="universal", axis=np.eye(3)[:2]),
        mr.Joint("beam", "base", to=mr.ground, pose=pose((0, np.pi / 2, 0), (-0.4, 0, 0.4))),
        mr.Joint("beam", "tip", to=plate, pose=pose((0, np.pi / 2, 0))),
    ]
    robot = mr.Network(rods={"strut": ROUND, "beam": beam}, bodies=[plate], joints=joints)
    euler = np.pi**2 * 0.2233 / 0.4**2
    solution = mr.solve(robot, robot.inputs(force={"plate": (0, 0, -1.5 * euler)}), solver=mr.Shooting(integrator=RK4))
    assert solution.status is mr.Status.BIFURCATED
    assert (solution.stability, solution.index) == (mr.Stability.FOLD, 0)  # it may bow to any side
    assert [event.neutral for event in solution.events] == [1]
    np.testing.assert_allclose(solution.events[0].load_factor, 1 / 1.5, rtol=1e-6)
    # P = (2 K / pi)^2 of Euler's, chord = (2 E / K - 1) L
    chord = np.linalg.norm(solution.body_position("plate")) / 0.4
    m = brentq(lambda m: 2 * ellipe(m) / ellipk(m) - 1 - chord, 1e-6, 0.9)
    shape = solution.rod("strut")
    # fifty steps, and a plate that turned by as much as the beam
    np.testing.assert_allclose(np.linalg.norm(shape.force[0]) / euler, (2 * ellipk(m) / np.pi) ** 2, rtol=1e-6)
    np.testing.assert_allclose(shape.moment[[0, -1]], 0, atol=1e-8)


@pytest.mark.parametrize("tip", ["clamped", "spherical"])
def test_straight_legs_side_by_side_share_a_load_as_nothing_determines(tip):
    """(32) Said within 90 integrations, of which 25 on a path that begins as beams.

    What stretches, what statics determines and what has buckled has a result.
    """
    EI, L = 0.2233, 0.4
    euler = np.pi**2 * EI / L**2
    solver = mr.Shooting(integrator=RK4)

    def legs(count, rod=ROUND):
        plate, joints = mr.Body("plate"), []
        for k, angle in enumerate(10 + np.arange(count) * 360 / count):
            where = pose(position=(0.08 * np.cos(np.radians(angle)), 0.08 * np.sin(np.radians(angle)), 0))
            joints.append(mr.Joint(f"leg {k}", "base", to=mr.ground, pose=where))
            joints.append(mr.Joint(f"leg {k}", "tip", to=plate, pose=where, kind=tip))
        return mr.Network(rods={f"leg {k}": rod for k in range(count)}, bodies=[plate], joints=joints)

    def pressed(robot, part):
        return mr.solve(robot, robot.inputs(force={"plate": (0, 0, -part * len(robot.rods) * euler)}), solver=solver)

    six = legs(6)
    found = pressed(six, 0.1)
    assert found.status is mr.Status.UNDETERMINED
    assert found.integrations < 90
    assert pressed(legs(3), 0.1).status is mr.Status.CONVERGED
    stretching = mr.Rod(length=L, bending_stiffness=EI, torsional_stiffness=0.0638, axial_stiffness=1e5, shear_stiffness=1e5)
    assert pressed(legs(6, stretching), 0.1).status is mr.Status.CONVERGED
    if tip == "spherical":  # pi^2/4 EI/L^2 each, and they sway to any side
        found = pressed(six, 0.35)
        assert (found.status, found.index) == (mr.Status.BIFURCATED, 0)
        np.testing.assert_allclose(found.events[0].load_factor, 0.25 / 0.35, rtol=1e-5)
        parallel = mr.ParallelRods(
            legs=[ROUND] * 6,
            base=[joint.pose for joint in six.joints[::2]],
            platform=[joint.pose for joint in six.joints[1::2]],
            joints=tip,
        )
        found = mr.solve(parallel, parallel.inputs(tip_force=(0, 0, -1)), solver=solver)
        assert found.status is mr.Status.UNDETERMINED
        assert found.integrations < 150
        # a load across bends them, which determines what each carries: it was `UNDETERMINED` too
        force = 0.3, 0, -0.2 * 6 * euler
        found = mr.solve(parallel, parallel.inputs(tip_force=force), solver=solver)
        expected = mr.solve(six, six.inputs(force={"plate": force}), solver=solver)
        assert (found.status, found.stability) == (mr.Status.CONVERGED, mr.Stability.STABLE)
        assert found.integrations < 200
        np.testing.assert_allclose(found.tip_position, expected.tip_position, atol=1e-8)
        # each as it is alone, in a batch with what is not begun again
        both = mr.solve(parallel, parallel.inputs(tip_force=np.array([force, (0, 0, -1), (2, 1, 0)])), solver=solver)
        assert [mr.Status(k) for k in both.status][:2] == [mr.Status.CONVERGED, mr.Status.UNDETERMINED]
        assert np.array_equal(both.tip_position[0], found.tip_position)


def test_what_begins_again_counts_what_it_takes(monkeypatch):
    """Of legs side by side that a load across bends: as tips begin to give way one integration; the beams that their path begins
    as are known, and were counted twice."""
    places = [pose(position=(0.08 * np.cos(a), 0.08 * np.sin(a), 0)) for a in np.radians(10 + 60 * np.arange(6))]
    robot = mr.ParallelRods(legs=[ROUND] * 6, base=places, platform=places, joints="spherical")
    inputs = robot.inputs(tip_force=(0.3, 0, -0.2 * 6 * np.pi**2 * 0.2233 / 0.4**2))
    problem, ways, raise_loads, evaluate = robot.problem(inputs, integrator=RK4), [], Paths.raise_loads, ParallelProblem.evaluate
    evaluated = []

    def counted(self, *arguments, **options):
        allowed = int(self._newton.allowed()[0])
        ways.append((allowed, raise_loads(self, *arguments, **options), len(evaluated)))
        return ways[-1][1]

    def told(self, *arguments, **options):
        evaluated.append(ways)
        return evaluate(self, *arguments, **options)

    monkeypatch.setattr(Paths, "raise_loads", counted)
    monkeypatch.setattr(ParallelProblem, "evaluate", told)
    newton = mr.Shooting(integrator=RK4).newton(problem)
    newton.allow(1000)
    outcome = natural_branch(problem, newton, 1000)
    (allowed, first, before), (left, again, after) = ways
    assert (outcome.status[0], after - before) == (mr.Status.CONVERGED, 1)
    taken = 1000 - allowed + int(first.integrations[0]) + 2  # of which one says that it is undetermined
    assert left == 1000 - taken
    assert outcome.integrations[0] == taken + again.integrations[0]


@pytest.mark.parametrize("part", [0.1, 0.2])
def test_legs_that_hardly_bend_are_put_together_to_the_end(part):
    """Of the last 2e-5 of the way steps were too small: 190 to 230 integrations of a network, 650 to 700 of parallel robots."""
    EI, L = 0.2233, 0.4
    poses = np.tile(np.eye(4), (6, 1, 1))
    angles = np.radians(10 + 60 * np.arange(6))
    poses[:, :2, 3] = 0.08 * np.stack([np.cos(angles), np.sin(angles)], axis=1)
    robot = mr.ParallelRods(legs=[ROUND] * 6, base=poses, platform=poses)
    force = 0.3, 0, -part * 6 * np.pi**2 * EI / L**2
    found = mr.solve(robot, robot.inputs(tip_force=force))
    tower = mr.stacked(robot)
    expected = mr.solve(tower, tower.inputs(force={"level 1": force}))
    for solution in (found, expected):
        assert (solution.status, solution.stability) == (mr.Status.CONVERGED, mr.Stability.STABLE)
        assert solution.integrations < 170
    np.testing.assert_allclose(found.tip_position, expected.tip_position, atol=1e-9)
    # each leg between clamps that stay parallel sways by tan(kL/2)/(kL/2) - 1 of its share over its thrust
    k = np.sqrt(part) * np.pi / 2
    np.testing.assert_allclose(found.tip_position[0], 0.3 / -force[2] * L * (np.tan(k) / k - 1), rtol=1e-4)


def ring(curvature, bending, torsion, radius):
    """Two halves, clamped to the ground and to a body across, which a straight wire guides along the diameter."""
    half = mr.Rod(length=np.pi * radius, bending_stiffness=bending, torsional_stiffness=torsion, precurvature=(0, curvature, 0))
    across, guide = mr.Body("across"), mr.Rod(length=radius, bending_stiffness=bending, torsional_stiffness=torsion)
    turned = pose((0, -np.pi / 2, 0), (3 * radius, 0, 0))  # z along -x
    joints = [mr.Joint("out", "base", to=mr.ground), mr.Joint("out", "tip", to=across)]
    joints += [mr.Joint("back", "base", to=across), mr.Joint("back", "tip", to=mr.ground)]
    joints += [mr.Joint("guide", "base", to=mr.ground, pose=turned)]
    at_guide = pose((0, np.pi, 0)) @ pose((0, -np.pi / 2, 0))
    joints += [mr.Joint("guide", "tip", to=across, pose=at_guide, kind="cylindrical", axis=(0, 0, 1))]
    return mr.Network(rods={"out": half, "back": half, "guide": guide}, bodies=[across], joints=joints)


@pytest.mark.parametrize(("bending", "torsion", "radius"), [(0.02, 0.012, 1.0), (0.5, 0.55, 0.1)])
def test_a_twisted_ring_buckles_where_michell_says(bending, torsion, radius):
    """(38) 2 pi sqrt(3) EI/GJ of a ring of straight wires; that of curved ones is the guess, which they would not find alone."""
    closed = ring(1 / radius, bending, torsion, radius)
    bent = mr.solve(closed, closed.inputs(), solver=EXACT).raise_if_failed()
    robot = ring(0.0, bending, torsion, radius)
    start, twisted = robot.inputs(), robot.inputs(rotation={"out": 0.5, "back": 0.5})
    (load,) = mr.critical_loads(robot, twisted, start=start, guess=bent)
    # steps of the integration leave 1e-11, and the neutral eigenvalue is linear in the twist: 1e-8 was found
    np.testing.assert_allclose(load.load_factor, 2 * np.pi * np.sqrt(3) * bending / torsion, rtol=1e-6)
    assert (load.index_before, load.index_after, load.fold) == (0, 1, False)
    circle = load.solution
    np.testing.assert_allclose(circle.tip_position, (2 * radius, 0, 0), atol=1e-8 * radius)
    np.testing.assert_allclose(circle.rod("guide").moment, 0, atol=1e-6 * bending / radius)
