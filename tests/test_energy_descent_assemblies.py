"""Energy descent of tubes, legs and lines: what it goes down in, motions at one integration a sample, snaps, and loads without a
potential."""

import numpy as np
import pytest
from observer_scenes import INTEGRATOR, MOTIONS, MOVING, STILL

import multirod as mr

FINE = mr.RK4(200)
DESCENT = mr.EnergyDescent(integrator=INTEGRATOR)
NEWTON = mr.Shooting(integrator=INTEGRATOR)


def tube(length, curvature, stiffness=0.02):
    return mr.Rod(length=length, bending_stiffness=stiffness, torsional_stiffness=0.75 * stiffness, precurvature=curvature)


def pair(inner=0.3, outer=0.25):
    """Tubes that snap at some 3.9 rad when they are turned against each other, and at 2.4 when they are turned back."""
    return mr.ConcentricTubes([tube(inner, (9, 0, 0)), tube(outer, (8, 0, 0))])


def ring(degrees, radius):
    poses = np.tile(np.eye(4), (len(degrees), 1, 1))
    poses[:, 0, 3], poses[:, 1, 3] = radius * np.cos(np.radians(degrees)), radius * np.sin(np.radians(degrees))
    return poses


def legs(rods, joints):
    turn = 360 * np.arange(len(rods)) / len(rods)
    turning = np.tile((0.6, 0.0, 0.8), (len(rods), 1)) if "revolute" in joints else None
    return mr.ParallelRods(legs=rods, base=ring(turn, 0.08), platform=ring(turn + 10, 0.05), joints=joints, joint_axes=turning)


def line(offset):
    return mr.Tendon(offset, driven="displacement", axial_stiffness=2000.0)


def lined():
    lines = [line((0.008, 0)), line((-0.004, 0.007))]
    return mr.SingleRod(mr.Rod(length=0.3, bending_stiffness=0.03, torsional_stiffness=0.02, lines=lines))


def mixed_legs():
    two = mr.ConcentricTubes([tube(0.34, (2, 0, 0)), tube(0.26, (0, 2, 0))])
    return legs([tube(0.3, (1, 0, 0)), two, tube(0.3, (0, 1, 0))], ["spherical", "clamped", "revolute"])


FORCE = {"tip_force": (0.1, 0.05, 0.2)}
SCENES = {
    "two unloaded tubes": lambda: (pair(), {"rotation": (0.2, 0.9)}),
    "two tubes": lambda: (pair(), {"rotation": (0.2, 0.9), "translation": (-0.03, -0.01), **FORCE}),
    "the outer tube reaches further": lambda: (pair(0.25, 0.3), {"rotation": (0.2, 0.9), **FORCE}),
    "tubes side by side": lambda: (
        mr.EccentricTubes([tube(0.3, (9, 0, 0)), tube(0.25, (8, 1, 0))], offsets=[(0.002, 0), (-0.002, 0)]),
        {"rotation": (0.2, 0.9), **FORCE},
    ),
    "lines driven by their lengths": lambda: (lined(), {"displacement": (0.002, 0.003), **FORCE}),
    "a rod in a medium": lambda: (
        mr.SingleRod(mr.Rod(length=0.3, bending_stiffness=0.03, torsional_stiffness=0.02, foundation=8.0)),
        FORCE,
    ),
    "legs in joints of all kinds": lambda: (
        mixed_legs(),
        {"rotation": (0, 0.1, 0.4, 0), "translation": (0.01, -0.03, -0.02, 0), "tip_force": (0.3, 0.2, -0.5)},
    ),
}


def columned(robot, inputs, integrator=FINE):
    problem = robot.problem(inputs, integrator=integrator, pose_sensitivities=True, direction_count=1)
    return problem, problem.conjugates


@pytest.mark.parametrize("scene", [name for name in SCENES if "medium" not in name])
def test_forces_and_displacements_are_those_of_the_energy(scene):
    """(2), (7) to (12): where constraints are kept, by differences of the potential, far from any equilibrium."""
    robot, given = SCENES[scene]()
    problem, pairs = columned(robot, robot.inputs(**given))
    n, size = problem.unknown_count, problem.curvature_scale()[0]
    x = problem.guess() + 0.05 * size * np.random.default_rng(0).normal(size=n)
    eps, gamma = problem.evaluate(x)
    pairs.update()
    kept = np.eye(n)
    if len(pairs.forces) < n:  # along the constraints
        kept = np.linalg.svd(np.delete(gamma[0], pairs.forces, axis=0))[2][n - len(pairs.forces) :]
    expected = (pairs.unit.numpy()[0] * eps[0, pairs.forces]) @ pairs.columns.numpy()[0, :, :n] @ kept.T
    step, slope = 1e-4 * size, []
    for way in kept:
        energy = []
        for part in (-2, -1, 1, 2):
            problem.evaluate(x + part * step * way)
            energy.append(problem.stability.potential()[0])
        slope.append(np.dot((1, -8, 8, -1), energy) / (12 * step))
    # Runge and Kutta's own error, in energy and moments, at 200 steps
    np.testing.assert_allclose(slope, expected, rtol=0, atol=2e-7 * np.abs(expected).max())


@pytest.mark.parametrize("scene", SCENES)
def test_the_form_is_symmetric_and_definite_where_the_equilibrium_is_stable(scene):
    robot, given = SCENES[scene]()
    inputs = robot.inputs(**given)
    found = mr.solve(robot, inputs, solver=mr.Shooting(integrator=FINE)).raise_if_failed()
    problem, pairs = columned(robot, inputs)
    problem.evaluate(problem.adopt(found.unknowns[None]))
    reduced = pairs.reduced(problem)
    form = reduced.form[0]
    # what is rigid gives by 1e-6, which is not quite a spring's; integrations of the tubes of a leg in their own errors
    np.testing.assert_allclose(form, form.T, rtol=0, atol=3e-6 * np.abs(form).max())
    assert np.linalg.eigvalsh(form + form.T).min() > 0
    assert found.stability in (mr.Stability.STABLE, mr.Stability.UNKNOWN)  # a medium is not judged


def test_the_kernel_has_the_same_form():
    robot, inputs = MOTIONS["three tubes"]()
    problem, pairs = columned(robot, inputs[20], INTEGRATOR)
    track = mr.EnergyDescent(integrator=INTEGRATOR, feed_forward=False).track(problem, 0.005)
    x = mr.solve(robot, inputs[20], solver=NEWTON).unknowns[None] + 0.01
    track.start(x)
    track.step()
    problem.evaluate(x)
    reduced = pairs.reduced(problem)
    np.testing.assert_allclose(track.state.form.numpy(), reduced.form, rtol=1e-9, atol=1e-12)
    newton = -np.linalg.solve(problem.read("gamma").reshape(5, 5), problem.read("residual")[0])
    step = -reduced.by[0] @ np.linalg.solve(reduced.form[0], reduced.gradient[0]) + reduced.towards[0]
    np.testing.assert_allclose(step, newton, rtol=1e-8, atol=1e-12)  # (4)


@pytest.mark.parametrize("name", ["three tubes", "six legs"])
def test_a_motion_takes_one_integration_a_sample_and_is_as_accurate_as_newtons(name):
    robot, inputs = MOTIONS[name]()
    time = 0.005 * np.arange(MOVING + STILL)
    exact = mr.simulate(robot, inputs, time=time, solver=mr.Shooting(integrator=FINE))
    newton = mr.simulate(robot, inputs, time=time, solver=NEWTON)
    found = mr.simulate(robot, inputs, time=time, solver=DESCENT, guess=newton.unknowns[0])
    assert (found.integrations == 1).all()
    assert newton.integrations[5:MOVING].mean() > 1.9
    # two samples are lost where the motion begins and where it ends, which nothing foretells
    calm = np.setdiff1d(np.arange(MOVING + STILL), (1, 2, MOVING + 1, MOVING + 2))
    assert (found.status[calm] == mr.Status.TRACKING).all()
    error, of_newton = (np.linalg.norm(run.tip_position - exact.tip_position, axis=1)[calm] for run in (found, newton))
    # the integrator's own, and what a thirtieth of the whole motion in a sample surprises by, corrected
    assert error.max() < of_newton.max() + 3e-7


def test_a_pair_of_tubes_snaps_across_and_back():
    robot = pair()
    angle = np.concatenate([np.linspace(3, 4.4, 160), np.linspace(4.4, 1.8, 300)])
    inputs = robot.inputs(rotation=np.stack([0 * angle, angle], axis=1))
    first = mr.solve(robot, inputs[0], solver=NEWTON).raise_if_failed()
    found = mr.simulate(robot, inputs, time=0.005 * np.arange(len(angle)), solver=DESCENT, guess=first)
    assert (found.integrations == 1).all()
    jump = np.linalg.norm(np.diff(found.tip_position, axis=0), axis=1) > 5e-3
    places = np.flatnonzero(jump)
    up, back = places[places < 160], places[places >= 160]
    assert 3.8 < angle[up[0]] < 4.0
    assert 2.2 < angle[back[0]] < 2.5
    assert (found.status[1:][jump] == mr.Status.NEAR_FOLD).mean() > 0.9
    here = int(np.argmin(np.abs(angle[160:] - 3.5))) + 160  # on the way back: both states are there
    assert found.status[here] == mr.Status.TRACKING
    listed = mr.equilibria(robot, inputs[here], solver=NEWTON)
    stable = listed.tip_position[listed.stability == mr.Stability.STABLE]
    assert len(stable) == 2
    off = np.linalg.norm(stable - found.tip_position[here], axis=1)
    before = int(np.argmin(np.abs(angle[:160] - 3.5)))
    np.testing.assert_allclose(np.sort(off)[0], 0, atol=1e-6)
    assert np.linalg.norm(found.tip_position[before] - found.tip_position[here]) > 0.02  # it is across
    # one step over the fold: the state across, tested, from the one that was there before
    over = mr.solve(robot, robot.inputs(rotation=(0, 4.1)), solver=DESCENT, guess=found.unknowns[before]).raise_if_failed()
    lowest = mr.equilibria(robot, robot.inputs(rotation=(0, 4.1)), solver=NEWTON)
    assert over.stability == mr.Stability.STABLE
    np.testing.assert_allclose(
        over.tip_position, lowest.tip_position[lowest.stability == mr.Stability.STABLE][0], rtol=0, atol=1e-7
    )


def test_it_leaves_an_unstable_state_of_legs():
    """A platform pressed down on three upright legs gives way to the side before they buckle."""
    rods = [mr.Rod(length=0.3, bending_stiffness=0.02, torsional_stiffness=0.015, axial_stiffness=2e3)] * 3
    places = ring([0, 120, 240], 0.05)
    robot = mr.ParallelRods(legs=rods, base=places, platform=places)
    load = 1.5 * 3 * np.pi**2 * 0.02 / 0.3**2
    pressed = robot.inputs(tip_force=(0, 0, -load))
    upright = mr.solve(robot, pressed, solver=NEWTON, guess=mr.solve(robot, robot.inputs(), solver=NEWTON))
    assert upright.stability == mr.Stability.UNSTABLE
    found = mr.solve(robot, pressed, solver=DESCENT, guess=upright).raise_if_failed()
    assert found.status == mr.Status.CONVERGED
    assert found.stability == mr.Stability.STABLE
    assert found.potential < upright.potential
    assert np.linalg.norm(found.tip_position[:2]) > 0.05


def test_lines_driven_by_their_lengths_are_kept_to_them():
    robot = lined()
    inputs = robot.inputs(displacement=(0.004, 0.002), tip_force=(0.2, 0.1, 0))
    start = mr.solve(robot, robot.inputs(displacement=(0, 0.001), tip_force=(0.01, 0, 0)), solver=NEWTON).raise_if_failed()
    exact = mr.solve(robot, inputs, solver=NEWTON).raise_if_failed()
    found = mr.solve(robot, inputs, solver=DESCENT, guess=start).raise_if_failed()
    assert found.stability == mr.Stability.STABLE
    np.testing.assert_allclose(found.tip_position, exact.tip_position, rtol=0, atol=1e-9)
    np.testing.assert_allclose(found.tension, exact.tension, rtol=1e-6)


@pytest.mark.parametrize("load", ["follower_force", "tip_moment"])
def test_without_a_potential_damped_dynamics_take_its_place_and_say_so(wire, load):
    robot = mr.SingleRod(wire)
    inputs = robot.inputs(**{load: np.array((1.0, 0.5, -2)) * (1 if load == "follower_force" else 0.2)})
    exact = mr.solve(robot, inputs, solver=NEWTON).raise_if_failed()
    near = mr.solve(robot, inputs, solver=DESCENT, guess=exact)
    assert near.status == mr.Status.CONVERGED
    found = mr.solve(robot, inputs, solver=DESCENT, guess=mr.solve(robot, robot.inputs(), solver=NEWTON))
    assert found.status == mr.Status.DAMPED
    assert not found.failed
    np.testing.assert_allclose(found.tip_position, exact.tip_position, rtol=0, atol=1e-8)


STRAIGHT = mr.Rod(length=0.2, bending_stiffness=0.02, torsional_stiffness=0.015)
UNKNOWN_BASE_FORCE = {
    "a rod": (mr.SingleRod(STRAIGHT), {"follower_force": (0.06, 0, 0)}),
    "a rod that is only pulled": (mr.SingleRod(STRAIGHT), {"follower_force": (0, 0, 0.06)}),
    "tubes": (mr.ConcentricTubes([STRAIGHT, tube(0.15, (0, 0, 0))]), {"follower_force": (0.3, 0.1, -0.5)}),
    "in a medium": (
        mr.SingleRod(mr.Rod(length=0.2, bending_stiffness=0.02, torsional_stiffness=0.015, foundation=8.0)),
        {"tip_force": (0.06, 0, 0)},
    ),
}


@pytest.mark.parametrize("name", UNKNOWN_BASE_FORCE)
def test_straight_rods_that_do_not_stretch_are_no_exception_where_the_base_force_is_unknown(name):
    """(15) An axial force moves nothing of them: without it ``Y`` has no inverse."""
    robot, given = UNKNOWN_BASE_FORCE[name]
    inputs = robot.inputs(**given)
    exact = mr.solve(robot, inputs, solver=NEWTON).raise_if_failed()
    found = mr.solve(robot, inputs, solver=DESCENT).raise_if_failed()
    assert found.status == mr.Status.CONVERGED
    assert found.integrations <= DESCENT.ramp + 3  # the ramp's, and two or three of Newton's method: (15) does not slow it
    # both stop at a residual of 1e-9/L or so, by Newton's steps that leave far less
    np.testing.assert_allclose(found.tip_position, exact.tip_position, rtol=0, atol=1e-10)


def test_a_straight_rod_is_driven_far_by_a_follower_force_and_says_so():
    robot = mr.SingleRod(STRAIGHT)
    inputs = robot.inputs(follower_force=(3, 1, -0.5))
    exact = mr.solve(robot, inputs, solver=NEWTON).raise_if_failed()
    found = mr.solve(robot, inputs, solver=DESCENT, guess=mr.solve(robot, robot.inputs(), solver=NEWTON)).raise_if_failed()
    assert found.status == mr.Status.DAMPED
    np.testing.assert_allclose(found.tip_position, exact.tip_position, rtol=0, atol=1e-8)  # as of the bent wire


@pytest.mark.parametrize("given", [{"tip_moment": (0, 0, 1e-3)}, {"tip_moment": (1e-3, 0, 0)}, {"follower_force": (0, 0, -0.01)}])
def test_what_is_unstable_is_left_without_a_potential_though_nothing_pushes(given):
    """(16) A strip that symmetry holds straight beyond Euler's load bends to where one lands that was pushed to the side."""
    robot = mr.SingleRod(mr.Rod(length=0.2, bending_stiffness=(1.8, 0.0125), torsional_stiffness=0.019))
    rest = mr.solve(robot, robot.inputs(), solver=NEWTON)
    force = np.array((0, 0, -1.5 * np.pi**2 / 4 * 0.0125 / 0.2**2))
    straight = mr.solve(robot, robot.inputs(tip_force=force, **given), solver=NEWTON, guess=rest)
    found = mr.solve(robot, robot.inputs(tip_force=force, **given), solver=DESCENT, guess=rest).raise_if_failed()
    assert found.status == mr.Status.DAMPED
    side = np.sign(found.tip_position[0])
    pushed = robot.inputs(tip_force=force + (side * 0.05, 0, 0), **given)
    bent = mr.solve(robot, pushed, solver=DESCENT, guess=rest).raise_if_failed()
    expected = mr.solve(robot, robot.inputs(tip_force=force, **given), solver=NEWTON, guess=bent).raise_if_failed()
    assert np.linalg.norm(found.tip_position - straight.tip_position) > 0.5 * 0.2
    np.testing.assert_allclose(found.tip_position, expected.tip_position, rtol=0, atol=1e-8)  # both to the same residual


def test_a_column_that_a_follower_force_presses_comes_to_no_rest_where_it_flutters():
    """Straight is an equilibrium under any: its damped dynamics leave it where ``A`` has an eigenvalue with a negative real
    part."""
    robot = mr.SingleRod(STRAIGHT)
    rest = mr.solve(robot, robot.inputs(), solver=NEWTON)
    for size, settles in ((10, True), (12, False)):  # EI/L^2; it flutters at 11.7
        inputs = robot.inputs(follower_force=(0.1, 0, -size * 0.02 / 0.2**2))
        exact = mr.solve(robot, inputs, solver=NEWTON).raise_if_failed()
        problem, pairs = columned(robot, inputs)
        problem.evaluate(problem.adopt(exact.unknowns[None]))
        assert (np.linalg.eigvals(pairs.reduced(problem).form[0]).real.min() > 0) == settles
        found = mr.solve(robot, inputs, solver=DESCENT, guess=rest)
        assert found.status == (mr.Status.DAMPED if settles else mr.Status.MAX_ITERATIONS)


def test_what_is_rigid_gives_by_its_own_length_in_a_batch():
    lengths = np.array((0.2, 0.8))
    robot = mr.SingleRod(mr.Rod(length=lengths, bending_stiffness=0.02, torsional_stiffness=np.inf))
    inputs = robot.inputs(follower_force=[(0.06, 0.02, -0.05), (0.006, 0.002, -0.005)])
    both = mr.solve(robot, inputs, solver=DESCENT).raise_if_failed()
    for k in range(2):
        alone = mr.solve(robot, inputs, solver=DESCENT, instances=[k])
        np.testing.assert_array_equal(both.unknowns[k], alone.unknowns[0])


def test_what_is_unstable_though_the_tip_be_held_is_no_result():
    """A straight column under 12 EI/L^2 would buckle with its tip held upright, at pi^2: its tip's turn does not show it."""
    robot = mr.SingleRod(mr.Rod(length=1, bending_stiffness=(1, 1.5), torsional_stiffness=0.8))
    pressed = robot.inputs(tip_force=(0, 0, -12))
    assert mr.solve(robot, pressed, guess=(0, 0, 0), solver=NEWTON).stability == mr.Stability.UNSTABLE
    found = mr.solve(robot, pressed, guess=(0, 0, 0), solver=DESCENT)
    assert found.status == mr.Status.UNSTABLE
    assert np.isnan(found.tip_position).all()


def test_a_platform_that_is_held_is_refused():
    robot, _ = MOTIONS["six legs"]()
    inverse = robot.inverse()
    with pytest.raises(ValueError, match="EnergyDescent cannot take this problem: it does not say which residuals are forces"):
        mr.solve(inverse, inverse.inputs(platform_position=(0, 0, 0.4)), solver=DESCENT)
