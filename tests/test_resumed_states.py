"""What is known by its states at breakpoints alone is a guess for what is beside it, and where the next sample begins."""

import numpy as np
import pytest

import multirod as mr
from multirod.solvers.multiple_shooting import MultipleShooting

EI, LENGTH = 0.02, 0.4
UNIT = EI / LENGTH**2
ROBOT = mr.SingleRod(
    mr.Rod(length=LENGTH, bending_stiffness=(EI, 1.5 * EI), torsional_stiffness=0.6 * EI, precurvature=(4, -2, 6))
)
WAY = np.array([1, 0, 0.3]) / np.linalg.norm([1, 0, 0.3])
BY_SEGMENTS, SOON = mr.Status.MULTIPLE_SHOOTING, 30  # integrations; without a guess these take 160 to 570
NEAR = 1e-8 * LENGTH  # what steps of RK45() leave, other ones from the base than between breakpoints
SOLVERS = {
    "Shooting": mr.Shooting(),
    "MultipleShooting": mr.MultipleShooting(),
    "finer": mr.Shooting(integrator=mr.RK45(rtol=1e-10, atol=1e-12)),
}


def pulled(times, **others):
    """Inputs by the force on the tip, in EI/L^2."""
    return ROBOT.inputs(tip_force=np.asarray(times)[..., None] * UNIT * WAY, **others)


@pytest.fixture(scope="module")
def found():
    return mr.solve(ROBOT, pulled([500, 1000, 2000])).raise_if_failed()


@pytest.mark.parametrize("solver", SOLVERS.values(), ids=SOLVERS)
@pytest.mark.parametrize("times", [1.0, 1.01, 1.05])
def test_a_solution_by_segments_is_a_guess_beside_it(found, solver, times):
    """Even at its own inputs, it was ``STALLED`` or ``MAX_ITERATIONS``: the base alone does not lead to its tip."""
    inputs = pulled(np.array([500, 1000, 2000]) * times)
    again = mr.solve(ROBOT, inputs, solver=solver, guess=found).raise_if_failed()
    assert (again.status == BY_SEGMENTS).all()
    assert again.integrations.max() < SOON
    whole = mr.solve(ROBOT, inputs, solver=solver).raise_if_failed()
    np.testing.assert_allclose(again.tip_position, whole.tip_position, rtol=0, atol=NEAR)
    alone = mr.solve(ROBOT, inputs[1], solver=solver, guess=found[1])
    np.testing.assert_array_equal(alone.tip_position, again.tip_position[1])


def test_of_one_guess_for_many_of_a_file_and_of_another_length(found, tmp_path):
    found[1].save(tmp_path / "found.npz")
    guess = mr.load(tmp_path / "found.npz")
    inputs = pulled([990, 1010], translation=[0.02, -0.05])
    again = mr.solve(ROBOT, inputs, guess=guess).raise_if_failed()
    assert again.integrations.max() < SOON
    np.testing.assert_allclose(again.tip_position, mr.solve(ROBOT, inputs).tip_position, rtol=0, atol=NEAR)


@pytest.mark.parametrize("times", [50.0, 100.0, 200.0])
@pytest.mark.parametrize("change", [1.001, 1.05])
def test_unknowns_that_hardly_lead_to_a_tip_are_a_guess_by_the_states_they_lead_to(times, change):
    """It was ``STALLED``, or an equilibrium where the tip is farther off than it moves."""
    there = mr.solve(ROBOT, pulled(times)).raise_if_failed()
    again = mr.solve(ROBOT, pulled(times * change), guess=there).raise_if_failed()
    assert again.integrations < SOON
    whole = mr.solve(ROBOT, pulled(times * change)).raise_if_failed()
    np.testing.assert_allclose(again.tip_position, whole.tip_position, rtol=0, atol=NEAR)


def test_a_guess_of_which_some_are_known_by_states_some_by_unknowns_and_some_failed():
    stopped = mr.Shooting(max_integrations=200)
    mixed = mr.solve(ROBOT, pulled([1, 1000, 500]), solver=stopped)
    assert mixed.status.tolist() == [mr.Status.CONVERGED, BY_SEGMENTS, mr.Status.INTEGRATION_LIMIT]
    inputs = pulled([1.1, 1010, 2])
    again = mr.solve(ROBOT, inputs, guess=mixed)
    assert again.status.tolist() == [mr.Status.CONVERGED, BY_SEGMENTS, mr.Status.CONVERGED]
    assert again.integrations.max() < SOON
    np.testing.assert_allclose(again.tip_position, mr.solve(ROBOT, inputs).tip_position, rtol=0, atol=NEAR)


def test_states_of_a_robot_that_has_others_are_left_out(found):
    """Loads along the rod have states of their own: the guess is its unknowns, as of an array, and no error."""
    inputs = pulled(1000.0, distributed_force=(0.0, 0.0, 1e-3))
    by_states = mr.solve(ROBOT, inputs, guess=found[1])
    assert by_states.failed or np.linalg.norm(by_states.tip_position - mr.solve(ROBOT, inputs).tip_position) < NEAR


@pytest.mark.parametrize("solver", list(SOLVERS.values())[:2], ids=list(SOLVERS)[:2])
@pytest.mark.parametrize("ends", [(0.0, -0.12), (-0.12, 0.02)], ids=["in", "out"])
def test_each_sample_of_a_motion_begins_where_the_last_ended(solver, ends):
    """Pulled in by more than the last segment, it was ``BRANCH_END``; by ``Shooting`` each sample was solved from nothing."""
    translation = np.linspace(*ends, 25)
    inputs = pulled(np.linspace(900, 1000, 25), translation=translation)
    history = mr.simulate(ROBOT, inputs, time=0.01 * np.arange(25), solver=solver).raise_if_failed()
    assert history.integrations[1:].max() < SOON
    np.testing.assert_allclose(history.tip_position[::6], mr.solve(ROBOT, inputs[::6]).tip_position, rtol=0, atol=NEAR)


@pytest.mark.parametrize("solver", [mr.Shooting(), mr.MultipleShooting()], ids=["Shooting", "MultipleShooting"])
def test_a_motion_begins_at_the_states_of_its_guess(solver):
    """All samples were ``STALLED`` or ``BRANCH_END``; of what is known by its unknowns, and of what failed, nothing changes."""
    begin = np.array([1.0, 1000, 60, 500])
    mixed = mr.solve(ROBOT, pulled(begin), solver=mr.Shooting(max_integrations=200))
    assert mixed.status.tolist() == [mr.Status.CONVERGED, BY_SEGMENTS, mr.Status.CONVERGED, mr.Status.INTEGRATION_LIMIT]
    inputs = pulled(begin * np.linspace(1.01, 1.04, 4)[:, None])
    motion = mr.simulate(ROBOT, inputs, time=0.01 * np.arange(4), solver=solver, guess=mixed, progress=False).raise_if_failed()
    assert motion.integrations[:, :3].max() < SOON
    for k in (0, 3):
        np.testing.assert_allclose(motion.tip_position[k], mr.solve(ROBOT, inputs[k]).tip_position, rtol=0, atol=NEAR)
    tracker = mr.Tracker(ROBOT, inputs=inputs[0], dt=0.01, solver=solver, guess=mixed)
    np.testing.assert_array_equal(tracker.step().tip_position, motion.tip_position[0])


def test_samples_whose_loads_jump_are_reached_by_states_in_steps():
    """Half of these samples were ``STALLED``, and all took 30,000 integrations."""
    random = np.random.default_rng(3)
    way = random.normal(size=3)
    times = np.abs(np.cumsum(60 * random.normal(size=40)))
    inputs = ROBOT.inputs(tip_force=times[:, None] * UNIT * way / np.linalg.norm(way))
    motion = mr.simulate(ROBOT, inputs, time=0.01 * np.arange(40), progress=False).raise_if_failed()
    assert motion.integrations.mean() < 60
    each = mr.solve(ROBOT, inputs).raise_if_failed()
    np.testing.assert_allclose(motion.tip_position, each.tip_position, rtol=0, atol=NEAR)


def test_a_motion_is_by_unknowns_again_where_these_do():
    """Let go and pulled again, 77 of 120 samples were ``STALLED``, each after some thousand integrations."""
    times = np.concatenate([np.linspace(600, 2, 60), np.linspace(2, 600, 60)])
    history = mr.simulate(ROBOT, pulled(times), time=0.01 * np.arange(120)).raise_if_failed()
    assert {mr.Status.CONVERGED, BY_SEGMENTS} == set(map(mr.Status, history.status))
    assert history.integrations.mean() < 60
    np.testing.assert_allclose(history.tip_position[::30], mr.solve(ROBOT, pulled(times[::30])).tip_position, rtol=0, atol=NEAR)


def test_a_held_cable_that_is_known_by_states_is_a_guess_beside_it():
    end = np.eye(4)
    end[:3, 3] = 0.02, 0.0, 0.98
    robot = mr.HeldRod(mr.Rod(length=1, bending_stiffness=1e-5, torsional_stiffness=1e-5, linear_density=0.1), end=end)
    found = mr.solve(robot, robot.inputs(gravity=(0, 0, -9.81))).raise_if_failed()
    inputs = robot.inputs(gravity=(0, 0, -9.9), end_position=(0.001, 0, 0))
    again = mr.solve(robot, inputs, guess=found).raise_if_failed()
    assert again.integrations < SOON < found.integrations
    np.testing.assert_allclose(again.end_force, mr.solve(robot, inputs).end_force, rtol=0, atol=1e-6)


def test_steps_by_states_are_halved_where_they_lead_nowhere():
    """A strip that bears loads along it, and is pressed: 28 of 30 samples were ``STALLED``, each after 350 to 2800 integrations.

    From what loads change by at once Newton's method led nowhere, though they change by less than what is safe.
    """
    strip = mr.SingleRod(
        mr.Rod(length=LENGTH, bending_stiffness=(EI, 5 * EI), torsional_stiffness=0.7 * EI, precurvature=(-1.4, -2.8, -3.0))
    )
    press = np.array([0, 41, 83, 124, 166, 579, 538, 200, 41])[:, None] * UNIT * np.array([0, 0, -1])
    inputs = strip.inputs(tip_force=press, distributed_force=(-120, 4.5, 63))
    history = mr.simulate(strip, inputs, time=0.01 * np.arange(len(press)), progress=False).raise_if_failed()
    assert history.integrations[1:].mean() < 120
    each = mr.solve(strip, inputs).raise_if_failed()
    np.testing.assert_allclose(history.tip_position, each.tip_position, rtol=0, atol=NEAR)


def test_what_a_sample_takes_does_not_depend_on_others_that_go_again():
    """Steps of all were forgotten where one went its way again: whether another had come round a bend was not looked at."""
    robot = mr.SingleRod(mr.Rod(length=1, bending_stiffness=1, torsional_stiffness=0.7))
    size = np.abs(np.cumsum(90 * np.random.default_rng(3).normal(size=(8, 5)), axis=0))
    way = np.array([[0, 0, -1], [1e-3, 0, -1], [1, 0, 0], [0, 1e-6, -1], [0.3, 0.4, 0.2]])
    force = size[:2, :, None] * way
    both = mr.simulate(robot, robot.inputs(tip_force=force), time=[0.0, 1.0], progress=False)
    alone = mr.simulate(robot, robot.inputs(tip_force=force[:, 4]), time=[0.0, 1.0], progress=False)
    np.testing.assert_array_equal(alone.integrations, both.integrations[:, 4])
    np.testing.assert_array_equal(alone.tip_position, both.tip_position[:, 4])


@pytest.mark.parametrize("moment", [0.0, 0.1])
@pytest.mark.parametrize(("times", "status"), [(0.5, mr.Status.CONVERGED), (1.5, mr.Status.BRANCH_END)])
def test_segments_do_not_go_on_by_what_is_unstable_though_its_base_leads_to_its_tip(times, status, moment):
    """A column that stands upright, with and without a moment that twists it, which has no potential: above Euler's load it was
    ``CONVERGED``."""
    strip = mr.SingleRod(mr.Rod(length=LENGTH, bending_stiffness=(3 * EI, EI), torsional_stiffness=0.6 * EI))
    thrust = times * np.pi**2 / 4 * UNIT
    inputs = strip.inputs(tip_force=(0, 0, -thrust), tip_moment=(0, 0, moment * EI / LENGTH))
    upright = mr.solve(strip, inputs, guess=np.zeros(3))
    assert not upright.failed
    assert abs(upright.tip_position[:2]).max() < 1e-9
    problem = strip.problem(inputs, integrator=mr.RK45())
    problem.write("unknowns", upright.unknowns[None])
    by_segments = MultipleShooting()
    states = by_segments.states(problem, np.array([0]))
    outcome, _ = by_segments.resume_branch(problem, states, problem.read("inputs"), np.array([50]))
    assert outcome.status[0] == status


SOFT = {  # of rods 0.3 m long: stiffness in bending and torsion, precurvature, and the corners of a way of their loads
    "coiled": (
        4.649e-5,
        3.383e-5,
        (-2.96, 18.68, 26.23),
        {"tip_force": ((0.00411, 0.08183, -0.02505), (0.18095, -0.19332, -0.02273))},
    ),
    "turned": (
        1.226e-4,
        6.214e-5,
        (20.74, 3.583, -22.79),
        {
            "tip_force": ((-0.61579, -0.0264, -0.72046), (-0.2633, 0.17445, -0.28194), (-0.00323, 0.30013, 0.11415)),
            "distributed_force": ((-0.29255, -0.35484, -0.68408), (-0.17553, -0.2129, -0.41045), (-0.05851, -0.07097, -0.13682)),
            "tip_moment": ((0.00286, -0.00065, -0.00018), (0.00236, -0.00053, -0.00015), (0.00104, -0.00023, -7e-05)),
        },
    ),
    "lifted": (
        8.215e-4,
        4.953e-4,
        (2.498, 3.976, -0.1067),
        {
            "tip_force": ((3.794, 7.469, 2.613), (3.74, 5.786, 2.621), (3.689, 4.123, 2.633), (3.645, 2.498, 2.651)),
            "distributed_force": (
                (-18.41, -18.197, -31.706),
                (-16.472, -16.281, -28.369),
                (-14.534, -14.366, -25.031),
                (-12.596, -12.45, -21.694),
            ),
        },
    ),
}


def moved(name, times, solver):
    """The motion of one of them, so many samples from corner to corner; and its inputs."""
    EI, GJ, bent, ways = SOFT[name]
    robot = mr.SingleRod(mr.Rod(length=0.3, bending_stiffness=EI, torsional_stiffness=GJ, precurvature=bent))
    corners = len(ways["tip_force"])
    at = np.linspace(0, corners - 1, (corners - 1) * times + 1)
    inputs = robot.inputs(
        **{key: np.stack([np.interp(at, range(corners), one) for one in np.transpose(way)], axis=1) for key, way in ways.items()}
    )
    return mr.simulate(robot, inputs, time=at, solver=solver, progress=False), robot, inputs


@pytest.mark.parametrize("solver", [mr.Shooting(), mr.Shooting(integrator=mr.RK4(100))], ids=["RK45", "RK4"])
def test_states_are_led_to_their_own_equilibrium_before_it_is_asked_what_is_neutral(solver):
    """Steps between breakpoints err otherwise than those from the base: every sample was ``STALLED``, as a mode was taken for
    neutral."""
    motion, robot, inputs = moved("coiled", 5, solver)
    cold = mr.solve(robot, inputs, solver=solver).raise_if_failed()
    np.testing.assert_allclose(
        motion.raise_if_failed().tip_position, cold.tip_position, rtol=0, atol=1e-4 * 0.3
    )  # RK4 errs by 1e-5


def test_a_sample_far_from_the_last_is_come_to_as_by_many_between():
    """After 300 integrations by states it was left to damped dynamics, which led elsewhere."""
    solver = mr.Shooting(integrator=mr.RK4(100))
    far, near = (moved("turned", times, solver)[0] for times in (1, 8))
    assert not any(far.events)
    np.testing.assert_allclose(far.tip_position, near.raise_if_failed().tip_position[::8], rtol=0, atol=1e-6 * 0.3)


def test_what_is_solved_anew_and_leads_back_to_elsewhere_is_a_branch_that_ended():
    """On the way to the last sample its branch ends, and without a guess another was found: it was ``MULTIPLE_SHOOTING``, with no
    event."""
    solver = mr.Shooting(integrator=mr.RK4(100))
    motion, robot, inputs = moved("lifted", 1, solver)
    assert np.isfinite(motion.tip_position[:3]).all()
    there = mr.solve(robot, inputs[3], solver=solver).raise_if_failed()
    back = mr.simulate(robot, inputs[[3, 2]], time=[0.0, 1.0], solver=solver, progress=False).raise_if_failed()
    np.testing.assert_array_equal(back.tip_position[0], there.tip_position)
    assert np.linalg.norm(back.tip_position[1] - motion.tip_position[2]) > 0.1 * 0.3
    assert motion.status[3] == mr.Status.BRANCH_END or motion.events[3]
