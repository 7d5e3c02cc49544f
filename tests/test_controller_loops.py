"""Controllers in loops that do not go as planned: pictures that come late or no more, targets that jump."""

import numpy as np
import pytest
from observer_scenes import three_tubes

import multirod as mr
from multirod.rotations import matrices
from multirod.studies.scenes import six_legs
from multirod.tasks.freed import with_values

STEPS = mr.RK4(30)
TUBES, MOTION = three_tubes()


@pytest.fixture(scope="module")
def start():
    return mr.solve(TUBES, MOTION[10], solver=mr.Shooting(integrator=STEPS)).raise_if_failed()


def offsets(start, off, times):
    """What the loop takes for its robot's offset at each of 120 samples, its tip seen to be ``off`` the model's at ``times``."""
    loop = mr.Controller(TUBES, dt=0.005, free=("rotation", "translation"), guess=start, correction_time=0.02, integrator=STEPS)
    found, command = [], start
    for k in range(120):
        seen = {"measured_position": command.tip_position + off[k]} if k in times else {}
        command = loop.step(position=start.tip_position, **seen)
        assert command.status is mr.Status.TRACKING
        found.append(command.offset)
    return np.array(found)


@pytest.mark.parametrize("every", [1, 4])
def test_an_offset_that_drifts_is_held_once_pictures_come_no_more(start, every):
    """It drifted on for ever: the robot went off at what the last noise had for its speed, ``TRACKING``."""
    rate = 1e-5 * np.array([1.0, -2.0, 0.5])  # m a sample
    off = rate * np.arange(120)[:, None]
    times = range(0, 90, every)
    found, last = offsets(start, off, times), times[-1]
    # a ramp is followed without a lag, between pictures too: what is left of the start fades by a fifth a sample
    np.testing.assert_allclose(found[last - 8 : last + 1], off[last - 8 : last + 1], atol=1e-3 * np.abs(off[last]).max())
    overdue = last + 2 * every
    np.testing.assert_allclose(found[last : overdue + 1], off[last : overdue + 1], atol=1e-3 * np.abs(off[last]).max())
    np.testing.assert_array_equal(found[overdue:], np.broadcast_to(found[overdue], found[overdue:].shape))


def test_one_picture_after_a_long_time_is_not_gone_on_from_for_as_long(start):
    off = np.full((120, 3), 1e-3)
    found = offsets(start, off, [*range(20), 80])
    # of the one at 80: two samples, as the time without any is no measure of how often they come
    np.testing.assert_array_equal(found[84:], np.broadcast_to(found[84], found[84:].shape))


def laps(start, prefer, count=4, radius=0.01):
    """Drives, in units, at each sample of ``count`` laps of the tip round a circle, and the commands of the last lap."""
    limits = mr.Limits(rotation=(-4.0, 4.0), translation=(-0.4, 0.0), gap=1e-3)
    options = {} if prefer is None else {"prefer": prefer}
    free = ("rotation", "translation")
    loop = mr.Controller(TUBES, dt=0.01, free=free, limits=limits, guess=start, integrator=STEPS, **options)
    unit, found = 0.1 * max(tube.length for tube in TUBES.tubes), []
    for k in range(100 * count + 1):
        angle = 2 * np.pi * k / 100
        found.append(loop.step(position=start.tip_position + radius * np.array([np.cos(angle) - 1, np.sin(angle), 0.0])))
        assert found[-1].status is mr.Status.TRACKING
    drives = np.array([[*command.inputs.rotation, *(command.inputs.translation / unit)] for command in found])
    return drives.reshape(-1, 6), found[-100:]


@pytest.mark.parametrize("prefer", [None, "start"])
def test_a_closed_path_of_the_target_is_one_of_the_drives(start, prefer):
    """(16c): what the target leaves free drifted from lap to lap, and lines were wound up against each other."""
    drives, last = laps(start, prefer)
    assert np.abs(drives[400] - drives[300]).max() < 1e-3 * np.abs(drives[100] - drives[0]).max() + 1e-9
    # the pull moves the tip by nothing: it is in the place where the next sample is integrated
    for command in last[::20]:
        there = mr.solve(TUBES, command.inputs, solver=mr.Shooting(integrator=STEPS), guess=command)
        goal = command.tip_position  # to first order, target_error off the target
        np.testing.assert_allclose(there.tip_position, goal, atol=2e-7)
        assert command.target_error < 1e-8


def test_no_pull_leads_to_a_fold(start):
    """The tubes snap on the way to the middle of these limits: samples were UNSTABLE, the target within reach."""
    _, last = laps(start, "middle", 2, 0.02)
    assert min(command.stability_margin for command in last[::10]) > 0.1


def test_steps_of_least_motion_drift(start):
    drives, _ = laps(start, "smallest motion")
    lap = [np.abs(drives[100 * k + 100] - drives[100 * k]).max() for k in range(4)]
    assert lap[3] > 0.5 * lap[1] > 1e-3


def test_what_the_target_does_not_leave_free_is_pulled_nowhere(start):
    """Six drives for a pose: the same numbers, whatever is preferred."""
    found = []
    for prefer in ("start", "smallest motion", "middle"):
        limits = mr.Limits(rotation=(-4.0, 4.0), translation=(-0.4, 0.0))
        free = ("rotation", "translation")
        loop = mr.Controller(TUBES, dt=0.01, free=free, prefer=prefer, limits=limits, guess=start, integrator=STEPS)
        goals = [start.tip_position + np.array([0, 1e-4 * k, 0]) for k in range(10)]
        command = [loop.step(position=goal, rotation=start.tip_rotation) for goal in goals][-1]
        found.append([*command.inputs.rotation, *command.inputs.translation])
    np.testing.assert_array_equal(found[0], found[1])
    np.testing.assert_array_equal(found[0], found[2])


@pytest.mark.parametrize("seed", [3, 8])
def test_drives_come_to_rest_where_a_target_that_is_out_of_reach_does(start, seed):
    """(16b): they swung to and fro by 0.3 units at each sample, for ever, and what was told of the error was off by 0.9 mm."""
    random = np.random.default_rng(seed)
    way = random.normal(size=3)
    goal = start.tip_position + 0.08 * way / np.linalg.norm(way)
    first, axis = start.tip_rotation[:, 2], start.tip_rotation[:, 2] + 0.3 * random.normal(size=3)
    inputs = start.inputs
    limits = mr.Limits(
        rotation=(inputs.rotation - 0.4, inputs.rotation + 0.4),
        translation=(inputs.translation - 0.01, inputs.translation + 0.01),
    )
    loop = mr.Controller(TUBES, dt=0.005, free=("rotation", "translation"), limits=limits, guess=start, integrator=STEPS)
    commands = []
    for part in np.minimum(np.arange(200) / 50, 1):
        commands.append(
            loop.step(position=start.tip_position + part * (goal - start.tip_position), axis=first + part * (axis - first))
        )
    assert {command.status for command in commands[60:]} == {mr.Status.AT_LIMIT}
    turns = np.array([command.inputs.rotation for command in commands[-20:]])
    assert np.abs(np.diff(turns, axis=0)).max() < 1e-3
    there = mr.solve(TUBES, commands[-1].inputs, solver=mr.Shooting(integrator=STEPS), guess=commands[-1])
    assert np.linalg.norm(there.tip_position - goal) == pytest.approx(commands[-1].target_error, abs=1e-6)


def test_commands_say_what_holds_them_and_that_they_are_off_the_target(start):
    """Limits were named that hold the full step, of which a part was taken; what no limit held was TRACKING, however far off."""
    inputs, off = start.inputs, np.array([0.06, -0.05, 0.04])
    limits = mr.Limits(rotation=(inputs.rotation - 0.4, inputs.rotation + 0.4), translation=(inputs.translation - 0.01, 0.0))
    loop = mr.Controller(TUBES, dt=0.01, free=("rotation", "translation"), limits=limits, guess=start, integrator=STEPS)
    seen = set()
    for part in [0.0, *np.linspace(0.5, 1.0, 40)]:
        command = loop.step(position=start.tip_position + part * off)
        seen.add((command.status, bool(command.held_by)))
        at = {f"rotation[{k}]": value for k, value in enumerate(np.abs(command.inputs.rotation - inputs.rotation) - 0.4)}
        at |= {
            f"translation[{k}]": max(least - value, value)
            for k, (value, least) in enumerate(zip(command.inputs.translation, inputs.translation - 0.01, strict=True))
        }
        for name in command.held_by:
            if name in at:
                assert at[name] == pytest.approx(0, abs=1e-8)
        assert (command.status is mr.Status.TRACKING) == (command.target_error < 1e-6)
        assert command.singular == (command.status is mr.Status.OFF_TARGET)
    assert {status for status, _ in seen} == {mr.Status.TRACKING, mr.Status.OFF_TARGET, mr.Status.AT_LIMIT}


def test_drives_do_not_swing_where_a_moving_target_is_out_of_reach():
    """(16d): pulls of tendons went to and fro by some newtons in every other sample, 91 N in all."""
    places = [(0.003 * np.cos(angle), 0.003 * np.sin(angle)) for angle in 2 * np.pi / 3 * np.arange(3)]
    near = [mr.Tendon(place, end=0.06) for place in places]
    far = [mr.Tendon((-x, -y)) for x, y in places]
    robot = mr.SingleRod(mr.Rod.wire(length=0.12, diameter=1e-3, young_modulus=60e9, poisson_ratio=0.3, lines=near + far))
    first = mr.solve(robot, robot.inputs(tension=(6, 0.2, 0.2, 2, 0.2, 0.2), tip_force=(0, 0.1, 0)))
    loop = mr.Controller(robot, dt=0.01, free="tension", limits=mr.Limits(tension=(0, 15)), guess=first, integrator=STEPS)
    pulls, off = [], []
    for angle in 2 * np.pi / 100 * np.arange(100):
        goal = first.tip_position + 0.005 * np.array([np.cos(angle) - 1, np.sin(angle), 0])
        command = loop.step(position=goal)
        there = mr.solve(robot, command.inputs, solver=mr.Shooting(integrator=STEPS), guess=command)
        pulls.append(command.inputs.tension)
        off.append(np.linalg.norm(there.tip_position - goal))
    assert np.abs(np.diff(pulls, axis=0)).max(axis=1).sum() < 60  # N, all along
    assert np.mean(off) < 1e-4


def soft_legs():
    """Six legs under a light platform, which bend far before they come anywhere, and where they stand."""
    angles = np.radians([[-15, 15, 105, 135, 225, 255], [-45, 45, 75, 165, 195, 285]])
    poses = [np.tile(np.eye(4), (6, 1, 1)) for _ in angles]
    for own, radius, angle in zip(poses, (0.07, 0.05), angles, strict=True):
        own[:, :2, 3] = radius * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    leg = mr.Rod.wire(length=0.30, diameter=1.5e-3, young_modulus=60e9, poisson_ratio=0.3)
    robot = mr.ParallelRods(legs=[leg] * 6, base=poses[0], platform=poses[1], platform_mass=0.03)
    still = mr.solve(robot, robot.inputs(gravity=(0, 0, -9.81)), solver=mr.Shooting(integrator=STEPS))
    return robot, still


def test_six_legs_reach_a_target_that_jumps_aside():
    """One step as long as those of a loop left them unstable, and so did each sample that followed, from the same place."""
    robot, still = soft_legs()
    target = still.tip_position + (0.04, 0, 0)
    limits = mr.Limits(translation=(-0.1, 0.15))
    loop = mr.Controller(robot, dt=0.01, free="translation", limits=limits, guess=still, integrator=STEPS)
    commands = [loop.step(position=target) for _ in range(40)]
    given_up = ["stability" in command.held_by for command in commands]
    assert given_up[0]  # else it says nothing of what comes after
    np.testing.assert_array_equal(commands[0].inputs.translation, still.inputs.translation)
    assert sum(given_up) < 6
    assert {command.status for command in commands} == {mr.Status.OFF_TARGET, mr.Status.TRACKING}
    assert commands[-1].status is mr.Status.TRACKING
    there = mr.solve(robot, commands[-1].inputs, solver=mr.Shooting(integrator=STEPS), guess=commands[-1])
    np.testing.assert_allclose(there.tip_position, target, atol=1e-6)


def test_six_legs_whose_target_is_far_beyond_their_limits_are_led_to_these_without_a_sample_that_fails():
    """Each third step was too long to be vouched for: 57 of 150 samples were UNSTABLE, at the limits too, though stable
    equilibria lead to most of these commands."""
    robot, still = soft_legs()
    solver, limits = mr.Shooting(integrator=STEPS), mr.Limits(translation=(-0.03, 0.03))
    for aside in ((0.7, 0, -0.7), (1, 0, 0)):
        target = still.tip_position + 0.12 * np.array(aside) / np.linalg.norm(aside)
        loop = mr.Controller(robot, dt=0.01, free="translation", limits=limits, guess=still, integrator=STEPS)
        commands = [loop.step(position=target) for _ in range(120)]
        given_up = [k for k, command in enumerate(commands) if "stability" in command.held_by]
        assert given_up[0] == 0  # else it says nothing of what comes after
        assert len(given_up) <= 8  # of the others each takes 0.6 of what may be
        for k in given_up:
            before = commands[k - 1] if k else still
            np.testing.assert_array_equal(commands[k].inputs.translation, before.inputs.translation)
            np.testing.assert_allclose(commands[k].tip_position, before.tip_position, atol=1e-9)  # of two solves, to tolerances
            error = np.linalg.norm(before.tip_position - target)
            assert commands[k].target_error == pytest.approx(error, abs=1e-9)
            assert np.isfinite(commands[k].jacobian("translation")).all()
        assert {command.status for command in commands} == {mr.Status.OFF_TARGET, mr.Status.AT_LIMIT}
        assert {command.status for command in commands[-20:]} == {mr.Status.AT_LIMIT}
        assert all("stability" not in command.held_by for command in commands[-20:])
        last = still
        for first in range(0, 120, 8):  # slowly, through all that was commanded, it gets where the last command has it, stable
            way = np.stack([last.inputs.translation, *(own.inputs.translation for own in commands[first : first + 8])])
            inputs = robot.inputs(translation=way, gravity=(0, 0, -9.81))
            last = mr.simulate(robot, inputs, time=np.arange(len(way)), solver=solver, guess=last, progress=False)[-1]
            assert last.stability is mr.Stability.STABLE
            # second order of steps of a millimetre or two over bends of centimetres
            assert np.linalg.norm(last.tip_position - commands[first + 7].tip_position) < 2e-4
        found = mr.reach(
            robot, mr.Pose(position=target), still.inputs, free="translation", limits=limits, guess=still, solver=solver
        )
        assert found.status is mr.Status.AT_LIMIT
        assert commands[-1].target_error == pytest.approx(float(found.target_error), abs=1e-6)
        assert commands[50].target_error - commands[-1].target_error < 1e-3  # steps are as long as they may be: else 3 mm


def test_a_load_that_changes_beside_a_step_that_is_given_up_is_unstable_and_not_the_last_command_again():
    """Under another load nobody knows whether that one is stable."""
    robot, still = soft_legs()
    far, loop = still.tip_position + (0.12, 0, 0), None
    for force in ((0, 0, 0), (0.02, 0, 0)):
        given = robot.inputs(gravity=(0, 0, -9.81), tip_force=(0, 0, 0))
        loop = mr.Controller(robot, dt=0.01, free="translation", inputs=given, integrator=STEPS)
        loop.step(position=still.tip_position)
        command = loop.step(position=far, tip_force=force)
        if any(force):
            assert command.status is mr.Status.UNSTABLE
            assert np.isnan(command.inputs.translation).all()
            assert command.held_by == ()
        else:
            assert command.status is mr.Status.OFF_TARGET
            assert command.held_by == ("stability",)


def curved_tube(length, stiffness, torsional, curved, curvature):
    at_rest = [(length - curved, (0, 0, 0)), (curved, (curvature, 0, 0))]
    return mr.Rod(length=length, bending_stiffness=stiffness, torsional_stiffness=torsional, precurvature=at_rest)


def test_commands_beside_a_fold_are_of_the_branch_that_leads_there_and_drives_find_back():
    """A command was judged where it was to first order: from there the tubes snapped, it was STABLE, and all that followed it
    were UNSTABLE for ever, at targets that had been reached before too."""
    robot = mr.ConcentricTubes(
        [
            curved_tube(0.431, 0.00387, 0.00301, 0.103, 9),
            curved_tube(0.332, 0.01717, 0.01402, 0.113, 6),
            curved_tube(0.174, 0.03977, 0.05022, 0.134, 3.5),
        ]
    )
    given = robot.inputs(rotation=(0.4, 0.8, -0.3), translation=(-0.28, -0.22, -0.1), tip_force=(0, 0.2, 0.1))
    solver = mr.Shooting(integrator=STEPS)
    first = mr.solve(robot, given, solver=solver)
    free, limits = ("rotation", "translation"), mr.Limits(translation=(-0.4, 0), gap=1e-3)
    loop = mr.Controller(robot, dt=0.01, free=free, limits=limits, guess=first, integrator=STEPS)
    part, last, given_up = np.linspace(0, 1, 13)[:, None], first, 0
    for _ in range(40):
        command = loop.step(position=(0.5, 0.5, 0.5))  # out of reach, and past a fold on the way there
        given_up += "stability" in command.held_by
        assert not command.failed
        if command.smallest_singular_value < 1e-4:  # on the fold itself, rounding decides
            continue
        values = {name: getattr(last.inputs, name) * (1 - part) + getattr(command.inputs, name) * part for name in free}
        slowly = mr.simulate(robot, robot.inputs(**values, tip_force=(0, 0.2, 0.1)), time=part[:, 0], solver=solver, guess=last)
        last = slowly[-1].raise_if_failed()
        assert command.stability is last.stability is mr.Stability.STABLE
        np.testing.assert_allclose(command.tip_position, last.tip_position, atol=5e-4)  # to first order, where none is near
    assert given_up > 5  # else it says nothing of what comes after
    for _ in range(60):
        command = loop.step(position=first.tip_position)
    assert command.status is mr.Status.TRACKING
    there = mr.solve(robot, command.inputs, solver=solver, guess=command)
    np.testing.assert_allclose(there.tip_position, first.tip_position, atol=1e-8)


def column():
    """A loop whose column is pressed straight, well before it buckles, and the length at which it does."""
    force = 2.204  # N
    robot = mr.SingleRod(mr.Rod(length=0.6, bending_stiffness=0.2233, torsional_stiffness=0.0638))
    still = robot.inputs(translation=-0.2, tip_force=(0, 0, -force))
    loop = mr.Controller(robot, dt=0.01, free="translation", inputs=still, integrator=STEPS)
    return loop, np.pi / 2 * np.sqrt(0.2233 / force)


@pytest.mark.parametrize("near", [1e-3, 5e-5])
@pytest.mark.parametrize("jump", [1.2e-3, 5e-3])
def test_a_column_at_rest_beside_where_it_buckles_is_not_led_beyond_by_a_jump(near, jump):
    """Steps of less than a tenth were not looked at where the loop had been at rest, and a small one was not compared after
    it either: straight and unstable, ``TRACKING`` ever after. Of both modes, which the sign of ``det Gamma`` does not tell."""
    loop, buckles = column()
    for z in np.append(np.linspace(0.4, buckles - near, 60), np.full(5, buckles - near)):
        assert loop.step(position=(0, 0, z)).stability is mr.Stability.STABLE
    for _ in range(30):
        command = loop.step(position=(0, 0, buckles - near + jump))
        assert command.failed or 0.6 + command.inputs.translation[0] < buckles
    assert not loop.step(position=(0, 0, 0.495)).failed


@pytest.mark.parametrize("amplitude", [1e-6, 2e-5])
def test_a_column_that_trembled_for_long_is_not_led_beyond_where_it_buckles(amplitude):
    """To and fro was taken for a way along which ``Gamma`` hardly changes: a step of a twentieth was not looked at then."""
    loop, buckles = column()
    near = buckles - 1e-2
    for z in np.linspace(0.4, near - amplitude, 60):
        assert loop.step(position=(0, 0, z)).status is mr.Status.TRACKING
    for k in range(100):
        assert loop.step(position=(0, 0, near - amplitude * (-1) ** k)).status is mr.Status.TRACKING
    for _ in range(30):
        command = loop.step(position=(0, 0, buckles + 2e-3))
        assert command.failed or 0.6 + command.inputs.translation[0] < buckles


@pytest.mark.parametrize("near", [1e-2, 1e-3, 2e-4])
@pytest.mark.parametrize("turn", [1e-3, 5e-2])
@pytest.mark.parametrize("beyond", [1e-4, 5e-3])
def test_a_column_that_was_turned_for_long_is_not_pushed_beyond_where_it_buckles(near, turn, beyond):
    """(17b): turned about its axis it stays as it is, and ``Gamma`` too, which says nothing of its being pushed."""
    force = 2.204  # N
    buckles = np.pi / 2 * np.sqrt(0.2233 / force)
    robot = mr.SingleRod(mr.Rod(length=0.6, bending_stiffness=0.2233, torsional_stiffness=0.0638))
    still = robot.inputs(rotation=0.0, translation=buckles - near - 0.6, tip_force=(0, 0, -force))
    loop = mr.Controller(robot, dt=0.01, free=("rotation", "translation"), inputs=still, integrator=STEPS)
    looked = 0
    for angle in turn * np.arange(1, 41):
        turned = matrices(np.array([[0, 0, angle]]))[0]
        command = loop.step(position=(0, 0, buckles - near), rotation=turned)
        assert command.status is mr.Status.TRACKING
        looked += int(command.integrations) - 1
    assert looked <= 3  # of the first, whose motion nobody foresaw: as it turns no mode is lost
    for _ in range(10):
        command = loop.step(position=(0, 0, buckles + beyond), rotation=turned)
        if not command.failed:
            assert 0.6 + command.inputs.translation[0] < buckles
            there = mr.solve(robot, command.inputs, solver=mr.Shooting(integrator=STEPS), guess=command)
            assert there.stability is mr.Stability.STABLE
    assert not loop.step(position=(0, 0, buckles - near), rotation=turned).failed


def test_what_to_apply_where_a_sample_failed_is_the_last_good_command():
    loop, _ = column()
    good = [loop.step(position=(0, 0, z)) for z in (0.401, 0.402)]
    for command in good:
        np.testing.assert_array_equal(command.last_good.translation, command.inputs.translation)
    for _ in range(2):
        failed = loop.step(position=(0, 0, 0.41), tip_force=(0, 0, -20.0))
        assert failed.status is mr.Status.UNSTABLE
        np.testing.assert_array_equal(failed.last_good.translation, good[-1].inputs.translation)
        np.testing.assert_array_equal(failed.last_good.tip_force, (0, 0, -20.0))


def test_a_load_that_jumps_fails_one_sample_and_the_next_goes_on_from_where_it_moved_the_robot(start):
    """Every sample that followed was ``UNSTABLE``: the last good place is none under the new load."""
    free, random = ("rotation", "translation"), np.random.default_rng(3)
    fixed = TUBES.inputs(rotation=start.inputs.rotation, translation=start.inputs.translation)
    for size in (1.0, 3.0):
        force = random.normal(size=3)
        force *= size / np.linalg.norm(force)
        loop = mr.Controller(TUBES, dt=0.005, free=free, guess=start, integrator=STEPS)
        loop.step(position=start.tip_position)
        loaded = with_values(TUBES.inputs(tip_force=force), free, np.concatenate([fixed.rotation, fixed.translation]))
        target = mr.solve(TUBES, loaded, solver=mr.Shooting(integrator=STEPS)).raise_if_failed().tip_position
        assert loop.step(position=target, tip_force=force).status is mr.Status.UNSTABLE
        command = loop.step(position=target)
        assert command.status is mr.Status.TRACKING
        assert command.integrations > 5  # those of the way to the new load too
        for _ in range(3):
            command = loop.step(position=target)
        assert command.integrations == 1
        again = mr.solve(TUBES, command.inputs, guess=command, solver=mr.Shooting(integrator=STEPS))
        # it holds there: what is pulled beside the target is of second order
        np.testing.assert_allclose(again.tip_position, target, atol=1e-5)


def test_a_load_under_which_nothing_is_stable_is_looked_for_once():
    loop, _ = column()
    loop.step(position=(0, 0, 0.401))
    commands = [loop.step(position=(0, 0, 0.401), tip_force=(0, 0, -1e6)) for _ in range(4)]
    assert all(command.status.failed for command in commands)
    assert [bool(command.integrations > 1) for command in commands] == [False, True, False, False]
    assert loop.step(position=(0, 0, 0.401), tip_force=(0, 0, 0)).status is mr.Status.TRACKING


def test_how_gamma_varies_is_learned_along_the_way():
    """(17d): a column of 0.1 m hardly knows of buckling, where it began; along it ``Gamma`` of both modes goes as a cosine."""
    force, unit = 2.204, 0.06  # N, (9) in m
    k = np.sqrt(force / 0.2233)
    robot = mr.SingleRod(mr.Rod(length=0.6, bending_stiffness=0.2233, torsional_stiffness=0.0638))
    still = robot.inputs(translation=-0.5, tip_force=(0, 0, -force))
    loop = mr.Controller(robot, dt=0.01, free="translation", inputs=still, integrator=STEPS)
    for z in np.linspace(0.1, 0.49, 100):
        assert loop.step(position=(0, 0, z)).status is mr.Status.TRACKING
    watch = loop._watch
    assert not watch._due
    there = 0.6 + unit * watch._anchored[0, 0]
    growth = np.sqrt(watch._shared["growth"].values[0, 0, 0])
    # between two places that are compared it is that of the middle; at the start it was a third of what it is here
    assert 0.75 < growth / (np.sqrt(2) * unit * k * np.tan(k * there)) < 1.05


def test_what_is_renewed_piece_by_piece_is_what_is_kept_at_once():
    """Nothing else is compared with before it is whole; then (17c), (17d) say the same as where one sample bears all."""
    robot = six_legs().robot
    start = mr.solve(robot, robot.inputs(tip_force=(0, 0, -5.0)), solver=mr.Shooting(integrator=STEPS))
    names, found, one = ("anchor", "inverse", "growth", "least"), [], np.arange(1)
    for at_once in (False, True):
        loop = mr.Controller(robot, dt=1e-3, free="translation", guess=start, integrator=STEPS)
        watch, task, place = loop._watch, loop._task, start
        for part in (0.2, 0.35):  # from the second on (17d) has a way to go by
            gone = part * watch._unit * np.linspace(-1, 1, 6)
            before = {name: np.array(watch._shared[name].values) for name in names}
            place = mr.solve(robot, start.inputs.with_arrays(start.inputs.arrays | {"translation": gone}), guess=place)
            task.evaluate(place.unknowns[None], gone[None])
            watch._stand(one, 0.5)
            if at_once:
                watch.keep(one, watch.gamma())
                watch.catch_up()
                continue
            watch.renew()
            pieces = 0
            while watch._renewal is not None:
                for name in names:
                    np.testing.assert_array_equal(watch._shared[name].values, before[name])
                watch.renew()  # one at a time
                watch.go_on()
                pieces += 1
            assert pieces >= 6
            assert not np.array_equal(watch._shared["growth"].values, before["growth"])
        found.append([np.array(watch._shared[name].values) for name in names])
    for own, other in zip(*found, strict=True):
        np.testing.assert_allclose(own, other, rtol=1e-9, atol=1e-12 * np.abs(other).max())  # sums in another order


def soft_ends():
    """A wire whose free half is soft, bent most where that begins, which moves with it; and one bent most at its base."""
    stiff, soft = (mr.Section(length=0.2, bending_stiffness=EI, torsional_stiffness=EI) for EI in (0.2, 0.03))
    for name, sections in {"border": (stiff, soft), "base": (soft, stiff)}.items():
        robot = mr.SingleRod(mr.Rod(sections=list(sections)))
        yield name, robot, robot.inputs(tip_force=(0.2, 0.1, 0), rotation=0.2, translation=-0.01), ("rotation", "translation")


def most_bent_robots():
    """Robots, inputs and what is free."""
    yield from soft_ends()
    # sections of two tubes begin at one place else, where derivatives have a side
    drives = {"rotation": MOTION.rotation[10], "translation": MOTION.translation[10] - (0, 0.013, 0.005)}
    for name, force in {"tubes": MOTION.tip_force[10], "tip": (0, 0.2, 0.1)}.items():
        yield name, TUBES, TUBES.inputs(**drives, tip_force=force), ("rotation", "translation")
    legs = six_legs().robot
    yield "legs", legs, legs.inputs(tip_force=(2, 1, -3)), ("translation",)


@pytest.mark.parametrize("name", ["border", "base", "tubes", "tip", "legs"])
def test_how_far_a_limit_of_the_curvature_is_varies_as_differences_of_equilibria_say(name):
    """(18b) At a node, where a section or a rod ends that moves, at the base, and at a tip whose bending stays."""
    _, robot, inputs, free = next(own for own in most_bent_robots() if own[0] == name)
    solver = mr.Shooting(tolerance=1e-11, integrator=STEPS)
    middle, limit = mr.solve(robot, inputs, solver=solver).raise_if_failed(), 100.0
    loop = mr.Controller(robot, dt=0.01, free=free, limits=mr.Limits(curvature=limit), guess=middle, integrator=STEPS)
    shape, values = loop._shape, np.concatenate([np.ravel(getattr(inputs, own)) for own in free])
    problem, task = shape._one.problem, shape._one

    def look(p):
        at = with_values(middle.inputs, free, p)
        found = mr.solve(robot, at, solver=solver, guess=middle).raise_if_failed()
        x, row = problem.adopt(found.unknowns[None]), problem.pack(at)
        return shape.look(x, row, task.evaluate(x, p[None]).eliminated[1][0])

    step = 1e-3 * shape._unit
    ends = [[look(values + sign * d).room[0] for sign in (1, -1)] for d in np.diag(step)]
    slopes = -np.diff(ends)[:, 0] / (2 * step)
    here = look(values)
    bent = max(
        np.linalg.norm(middle.rod(k, nodes=4001).curvature[:, :2], axis=1).max() for k in range(len(robot.rods))
    )  # nodes of the look are 1 % of a rod apart
    assert here.room[0] == pytest.approx(1 - bent / limit, abs=2e-4 * bent / limit)
    # a slope is told over a twentieth of 1 % of a rod, along which that changes by less than 1 %; of radians in the rods 1e-4
    np.testing.assert_allclose(here.slopes[0] * shape._unit, slopes * shape._unit, rtol=0.01, atol=5e-3 * bent / limit)


def test_a_start_beyond_a_limit_of_the_curvature_is_refused(start):
    options = {"dt": 0.01, "free": ("rotation", "translation"), "guess": start, "integrator": STEPS}
    with pytest.raises(ValueError, match="(?s)Controller.limits .* at the start too, where the largest curvature is 9.053 1/m"):
        mr.Controller(TUBES, limits=mr.Limits(curvature=5), **options)
