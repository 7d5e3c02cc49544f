"""Where the search of a network begins: what is put together at once, and the path from the network taken apart."""

import numpy as np
import pytest
from random_networks import draw, violation
from test_network import BASE_ANGLES, EXACT, FORCE, GRAVITY, LEG, PLATE_ANGLES, RK4, circle, hexapod, parallel, pose

import multirod as mr
from multirod.models.network.elements import groups
from multirod.models.network.elements.elements import Elements
from multirod.models.network.starting import NetworkJoints
from multirod.models.platform.starting.guess import COMPLIANCES
from multirod.solvers.continuation.natural import natural_branch

MOST = 15  # integrations of a cold start: one apart, one together, one without loads, those of one step


@pytest.mark.parametrize("scale", [1.0, 6.0])
def test_equal_legs_are_put_together_at_once(scale, monkeypatch):
    """(30) In a few integrations, and to where the path from the network taken apart leads, under large loads too."""
    robot = hexapod()
    inputs = robot.inputs(force={"plate": scale * FORCE * (1, 1, 0.2)}, translation=0.01, gravity=GRAVITY)
    found = mr.solve(robot, inputs, solver=EXACT)
    monkeypatch.setattr(NetworkJoints, "together", lambda joints: None)
    expected = mr.solve(robot, inputs, solver=EXACT)
    assert found.status == expected.status == mr.Status.CONVERGED
    assert found.stability == mr.Stability.STABLE
    assert found.integrations < expected.integrations
    assert found.integrations <= MOST or scale > 1
    # residuals of 1e-11, and legs that give way along themselves by 1e-3 of what they do across
    np.testing.assert_allclose(found.tip_position, expected.tip_position, atol=1e-9)
    np.testing.assert_allclose(found.energy, expected.energy, rtol=1e-7)


def test_a_body_on_a_rod_that_is_rigid_in_torsion_is_put_together():
    """No tip of it twists, whatever the moment: of a batch the other rods are as they are alone."""
    EI = 0.02
    rod = mr.Rod(length=0.3, bending_stiffness=EI, torsional_stiffness=[np.inf, 0.015])
    top = mr.Body("top")
    joints = [mr.Joint("mast", "base", to=mr.ground), mr.Joint("mast", "tip", to=top)]
    robot = mr.Network(rods={"mast": rod}, bodies=[top], joints=joints)
    found = mr.solve(robot, robot.inputs(force=(0.1, 0.05, 0)), solver=EXACT).raise_if_failed()
    single = mr.SingleRod(mr.Rod(length=0.3, bending_stiffness=EI, torsional_stiffness=0.015))
    expected = mr.solve(single, single.inputs(tip_force=(0.1, 0.05, 0)), solver=EXACT)
    # a force alone bends a straight rod in a plane: it does not twist
    np.testing.assert_allclose(found.tip_position, np.stack([expected.tip_position] * 2), rtol=0, atol=1e-10)


@pytest.mark.parametrize("count", [2, 3, 6])
def test_clamped_legs_that_are_rigid_in_torsion_are_put_together(count):
    """As beams, as of `ParallelRods`: taken apart they answer no torque that they hold among each other, and were `STALLED`."""
    leg = mr.Rod(length=0.5, bending_stiffness=0.02, torsional_stiffness=np.inf, axial_stiffness=1e4)
    angles, plate = 360 * np.arange(count) / count, mr.Body("plate")
    base, tips = circle(angles, 0.1), circle(angles, 0.08)
    joints = [mr.Joint(f"leg {k}", "base", to=mr.ground, pose=base[k]) for k in range(count)]
    joints += [mr.Joint(f"leg {k}", "tip", to=plate, pose=tips[k]) for k in range(count)]
    robot = mr.Network(rods={f"leg {k}": leg for k in range(count)}, bodies=[plate], joints=joints)
    found = mr.solve(robot, robot.inputs(force={"plate": (0.1, 0, 0.05)}), solver=EXACT).raise_if_failed()
    alike = mr.ParallelRods(legs=[leg] * count, base=base, platform=tips)
    expected = mr.solve(alike, alike.inputs(tip_force=(0.1, 0, 0.05)), solver=EXACT).raise_if_failed()
    assert (found.status, found.stability) == (mr.Status.CONVERGED, mr.Stability.STABLE)
    assert found.integrations <= 20
    np.testing.assert_allclose(found.tip_position, expected.tip_position, rtol=0, atol=1e-9)


def test_rods_on_bodies_are_integrated_apart_from_those_on_the_ground_or_with_them(monkeypatch):
    """Whichever takes fewer columns: to the same residual and ``Gamma``."""
    found = []
    tower = mr.stacked(parallel(6, 0.08), parallel(6, 0.06))
    inputs = tower.inputs(translation=0.001 * np.arange(12), gravity=GRAVITY)
    for cost, count in ((lambda count, columns, lanes: columns**3, 1), (lambda count, columns, lanes: count * columns, 2)):
        monkeypatch.setattr(groups, "cost_of", cost)
        problem = tower.problem(inputs, integrator=RK4)
        assert len(problem.groups) == count
        found.append(problem.evaluate(problem.guess() + 0.1))
    for one, other in zip(*found, strict=True):
        np.testing.assert_allclose(one, other, rtol=0, atol=1e-12 * np.abs(other).max())


@pytest.mark.parametrize("kind", ["clamped", "spherical", "universal"])
def test_legs_that_differ_a_little_are_put_together_at_once(kind, monkeypatch):
    """As beams, or (30), where the first steps are no shorter than what ends that give way took: to where the long way leads."""
    robot = hexapod(kind)
    inputs = robot.inputs(
        translation=np.array([0.002, 0.001, -0.002, 0.0015, 0, -0.001]), force={"plate": FORCE}, gravity=GRAVITY
    )
    problem = robot.problem(inputs, integrator=RK4)
    together = problem.joints.together()
    assert together.sound.all()
    if kind == "universal":
        assert problem.closing.apart().beams is None
        assert together.integrations[0] > 2  # of which one is of the rods at rest
    with problem.at_load(0.0):
        assert np.abs(problem.evaluate(together.unknowns)[0]).max() < 1e-12  # what is left of the residual closes as loads rise
    found = mr.solve(robot, inputs, solver=EXACT)
    monkeypatch.setattr(NetworkJoints, "together", lambda joints: None)
    expected = mr.solve(robot, inputs, solver=EXACT)
    assert found.status == expected.status == mr.Status.CONVERGED
    assert found.integrations <= MOST + 2 < expected.integrations
    # residuals of 1e-11, and legs that give way along themselves by 1e-3 of what they do across
    np.testing.assert_allclose(found.tip_position, expected.tip_position, atol=1e-9)


def test_what_has_to_bend_is_put_together_step_by_step():
    """(30) Legs of different lengths: Newton's second step is longer than the first; what was tried is forgotten."""
    robot = hexapod("universal")
    inputs = robot.inputs(translation=np.array([[0.04, 0, 0, -0.04, 0, 0.02], [0.01] * 6]), gravity=GRAVITY)
    problem = robot.problem(inputs, integrator=RK4)
    together = problem.joints.together()
    assert together.sound.tolist() == [False, True]
    assert not problem.closing.soft.any()
    assert not problem.closing.opening[0].any()
    both = mr.solve(robot, inputs, solver=EXACT)
    assert (both.status == mr.Status.CONVERGED).all()
    for k in range(2):  # each is what it is alone
        alone = mr.solve(robot, inputs[k], solver=EXACT)
        assert alone.integrations == both.integrations[k]
        np.testing.assert_array_equal(alone.tip_position, both.tip_position[k])


def test_what_is_not_chosen_takes_no_integration():
    """As when only some samples of a motion have none before: those are left as they are."""
    robot = hexapod()
    problem = robot.problem(robot.inputs(translation=[[0.01] * 6, [0.02] * 6]), integrator=RK4)
    outcome = natural_branch(problem, mr.Shooting(integrator=RK4).newton(problem), 1000, np.array([True, False]))
    assert outcome.status.tolist() == [mr.Status.CONVERGED] * 2
    assert outcome.integrations[1] == 0 < outcome.integrations[0]


@pytest.mark.parametrize("aside", [None, 3])
def test_the_path_from_the_network_taken_apart_has_a_potential(aside):
    """(12), (29): the second variation is symmetric on the way, where bases turn and balls have springs, and where bodies begin
    aside: else what comes to the end of a branch there has nothing to go down in."""
    drawn = draw(76)
    problem = drawn.robot.problem(drawn.inputs, integrator=RK4)
    x = problem.guess() if aside is None else problem.joints.apart(np.array([aside]))
    assert problem.closing.soft.all()
    for level in (0.1, 0.2):
        with problem.everyone(), problem.at_load(level):
            for _ in range(6):
                residual, gamma = problem.evaluate(x)
                x = x - np.linalg.solve(gamma[0], residual[0])
            assert np.abs(problem.evaluate(x)[0]).max() < 1e-9
            problem.integrate_rods()
            elements, own = Elements(problem), problem.stability
            form = own._form(problem.state(), elements, own._elimination(elements))[0]
    # numbers of up to 80; fifty steps leave 4e-6, a softness along the bases or torques about fixed axes 0.1
    np.testing.assert_allclose(form, form.T, atol=1e-4)


def test_what_buckles_on_the_way_is_followed():
    """Where the branch ends at 0.6 of its loads and gaps: the network snaps, and comes to rest at all of them."""
    drawn = draw(76)
    solution = mr.solve(drawn.robot, drawn.inputs)
    assert solution.status == mr.Status.SNAPPED
    assert solution.stability == mr.Stability.STABLE
    assert violation(drawn, solution) < 1e-6  # the default integrator promises as much


# what is put together unstable; what has to go far down by clamps; the first again; what is put together aside; under moments;
# a strut between a ball and a universal joint that buckles, and then turns about its chord
@pytest.mark.parametrize(
    ("seed", "stability"),
    [(5927, "STABLE"), (7340, "STABLE"), (9037, "STABLE"), (12144, "STABLE"), (12172, "UNKNOWN"), (20041, "FOLD")],
)
def test_what_is_hard_to_put_together_comes_to_rest(seed, stability):
    """In a part of what it may take: its energy has minima, or damped dynamics rest."""
    drawn = draw(seed)
    solution = mr.solve(drawn.robot, drawn.inputs, solver=mr.Shooting(max_integrations=10_000))
    assert not solution.failed
    assert solution.stability.name == stability
    assert violation(drawn, solution) < 1e-6  # the default integrator promises as much


@pytest.mark.parametrize(("base", "tip"), [("spherical", "clamped"), ("clamped", "spherical")])
def test_a_round_rod_between_places_that_do_not_move_begins_bent(base, tip):
    """Pushed along its axis to no side of its own: no body aside would bend it. The energy is that of the rod alone."""
    rod = mr.Rod(length=0.5, bending_stiffness=0.02, torsional_stiffness=0.015)
    end = pose((0, 0, 0), (0, 0, 0.45))
    joints = [mr.Joint("rod", "base", to=mr.ground, kind=base), mr.Joint("rod", "tip", to=mr.ground, pose=end, kind=tip)]
    found = mr.solve(mr.Network(rods={"rod": rod}, bodies=[], joints=joints)).raise_if_failed()
    alone = mr.solve(mr.HeldRod(rod, end=end, base_joint=base, joint=tip)).raise_if_failed()
    assert found.status == mr.Status.LOWEST_ENERGY
    assert found.stability == mr.Stability.FOLD  # nothing holds it against turns about the axis
    assert found.energy == pytest.approx(alone.energy, rel=1e-6)


def bent_legs(kinds, most=0.022, tilt=0.0):
    """Legs that differ by ``most`` [m], on feet that are turned and tilted, the ground turned too."""
    lengths = 0.4 + most * np.array([-0.13, -0.13, 0, 1, 1, 0])
    rods = [mr.Rod.tube(length=length, outer_diameter=2e-3, young_modulus=2e11, shear_modulus=8e10) for length in lengths]
    feet = np.array([pose((tilt, -tilt, 2 * tilt * k), own[:3, 3]) for k, own in enumerate(circle(BASE_ANGLES, 0.087))])
    axes = (1, 0, 0) if "revolute" in kinds else None
    whole = pose((0.5, -0.3, 0.2), (0.1, 0, 0))
    return mr.ParallelRods(legs=rods, base=whole @ feet, platform=circle(PLATE_ANGLES, 0.087), joints=kinds, joint_axes=axes)


@pytest.mark.parametrize("kinds", [["clamped"] * 6, ["clamped", "revolute", "spherical"] * 2])
def test_rods_that_have_to_bend_begin_as_beams(kinds):
    """(11) of ``docs/parallel.md``: the unknowns of legs are those at which ``ParallelRods`` begins."""
    short = bent_legs(kinds, tilt=0.1)
    robot = mr.stacked(short)
    problem, own = (one.problem(one.inputs(), integrator=RK4) for one in (robot, short))
    apart = problem.closing.apart()
    with problem.closing.unloaded(), own.closing.unloaded():
        candidates = own.closing._bent(*own.closing.unloaded_legs())
        for compliance, expected in zip(COMPLIANCES, candidates, strict=True):
            x = apart.beams.bent(problem, apart.unknowns, compliance)
            found = x[0, problem.places[:, :6]].reshape(-1)
            np.testing.assert_allclose(found, expected[0, :36], rtol=0, atol=1e-9 * np.abs(expected).max())
            problem.write("unknowns", x)
            own.write("unknowns", expected)
            np.testing.assert_allclose(problem.body_poses()[0][:, 0], own.pose()[0], atol=1e-12)


@pytest.mark.parametrize("count", [1, 2])
def test_bodies_on_beams_are_put_together_at_once(count, monkeypatch):
    """Body by body; to where the path from the network taken apart leads, in half of its integrations at most."""
    robot = mr.stacked(*[bent_legs(["clamped"] * 6)] * count)
    assert [body for body, _ in robot.graph.standing] == list(range(count))
    problem = robot.problem(robot.inputs(), integrator=RK4)
    together = problem.joints.together()
    assert together.sound.all()
    with problem.at_load(0.0):
        assert np.abs(problem.evaluate(together.unknowns)[0]).max() < 1e-12  # what is left of the residual closes as loads rise
    inputs = robot.inputs(force={robot.load_places[-1]: (0.3, 0.1, -1.0)})
    found = mr.solve(robot, inputs, solver=EXACT)
    monkeypatch.setattr(NetworkJoints, "together", lambda joints: None)
    expected = mr.solve(robot, inputs, solver=EXACT)
    assert found.status == expected.status == mr.Status.CONVERGED
    assert 2 * found.integrations < expected.integrations
    np.testing.assert_allclose(found.tip_position, expected.tip_position, atol=1e-9)  # of residuals of 1e-11


def curved_legs(seed):
    """Three legs that are bent by a radian at rest and differ in length, and a force on their platform of some EI/L^2."""
    rng, rods = np.random.default_rng(seed), []
    for _ in range(3):
        length, precurvature = 0.2 * rng.uniform(0.95, 1.1), tuple(rng.normal(0, 5, 3))
        rods.append(mr.Rod(length=length, bending_stiffness=0.02, torsional_stiffness=0.015, precurvature=precurvature))
    joints = [str(kind) for kind in rng.choice(["clamped", "spherical"], 3)]
    angles = (0, 120, 240)
    robot = mr.ParallelRods(legs=rods, base=circle(angles, 0.06), platform=circle(angles, 0.04), joints=joints)
    return robot, rng.normal(0, 1.5, 3)


@pytest.mark.parametrize("seed", [48, 56, 69])
def test_a_parallel_robot_and_the_network_that_it_is_come_to_rest_alike(seed):
    """From the same beams, by the same steps: networks began by (30), and took another way where loads took over twelve steps."""
    robot, force = curved_legs(seed)
    network = mr.stacked(robot)
    found = mr.solve(robot, robot.inputs(tip_force=force)).raise_if_failed()
    same = mr.solve(network, network.inputs(force={network.load_places[-1]: force})).raise_if_failed()
    assert found.status == same.status == mr.Status.CONVERGED
    np.testing.assert_allclose(same.tip_position, found.tip_position, atol=2e-8)  # of both, RK45()'s 1e-8 of 0.2 m; others 0.03
    np.testing.assert_allclose(same.energy, found.energy, rtol=1e-6)


@pytest.mark.parametrize("as_network", [False, True])
@pytest.mark.parametrize("seed", [56, 67])
def test_loads_are_raised_from_the_unloaded_robot(seed, as_network):
    """To where forty small steps from there lead, Newton's method alone, though its legs are far from being beams."""
    robot, force = curved_legs(seed)
    network = mr.stacked(robot)
    scale = np.linspace(0, 1, 41)[1:, None]

    def inputs(force):
        return network.inputs(force={network.load_places[-1]: force}) if as_network else robot.inputs(tip_force=force)

    robot = network if as_network else robot
    found = mr.solve(robot, inputs(force)).raise_if_failed()
    led = mr.solve(robot, inputs(0 * force)).raise_if_failed()
    for part in scale:
        led = mr.solve(robot, inputs(part * force), guess=led).raise_if_failed()
    np.testing.assert_allclose(found.tip_position, led.tip_position, atol=2e-8)


def test_what_beams_do_not_know_begins_otherwise():
    """A rod between two bodies, a spring at a tip, a tip on the ground."""
    plate, top = mr.Body("plate"), mr.Body("top")
    stands = [mr.Joint(name, "base", to=mr.ground, pose=pose(position=(x, 0, 0))) for name, x in (("a", 0), ("b", 0.1))]
    tips = [mr.Joint("a", "tip", to=plate), mr.Joint("b", "tip", to=top)]
    brace = [mr.Joint("c", "base", to=plate), mr.Joint("c", "tip", to=top)]
    on_ground = [mr.Joint("c", "base", to=plate), mr.Joint("c", "tip", to=mr.ground)]
    spring = [tips[0], mr.Joint("b", "tip", to=top, kind="spherical", stiffness=1.0)]
    rods = {name: LEG for name in "abc"}
    order = mr.Network(rods=rods, bodies=[top, plate], joints=stands + tips + brace).graph.standing
    assert [(body, rods.tolist()) for body, rods in order] == [(1, [0]), (0, [1, 2])]
    for joints in (tips + on_ground, spring + brace):
        assert not mr.Network(rods=rods, bodies=[plate, top], joints=stands + joints).graph.standing
