"""Where branches of rods and tubes end: what buckles, what snaps, and what is said of it (``docs/branches.md``)."""

from dataclasses import replace

import numpy as np
import pytest
from relaxation import CreepingRods, rotation
from scipy.integrate import solve_ivp
from scipy.optimize import brentq, minimize_scalar
from scipy.special import ellipk

import multirod as mr

EI, LENGTH = 0.02, 0.5
CRITICAL = np.pi**2 / 4 * EI / LENGTH**2
PRECISE = mr.Shooting(integrator=mr.RK4(50))
SOFT = {"bending_stiffness": 1.47e-7, "torsional_stiffness": 9.9e-8, "linear_density": 8.64e-4}
MAGNET = (0, 0, 0.0628)


def column(wide: float = 1.0, **more: object) -> mr.SingleRod:
    return mr.SingleRod(mr.Rod(length=LENGTH, bending_stiffness=(wide * EI, EI), torsional_stiffness=0.015, **more))


def elastica(load: float) -> float:
    """Deflection of the tip of a column under ``load`` times its critical load, over its length: 2k/sqrt(P), K(k) = sqrt(P)."""
    root = np.sqrt(np.pi**2 / 4 * load)
    return float(2 * brentq(lambda k: ellipk(k * k) - root, 1e-6, 1 - 1e-14) / root)


@pytest.mark.parametrize("wide", [1.0, 2.0], ids=["round", "flat"])
def test_a_column_buckles_to_the_side_of_the_rule(wide):
    """Also a round one, which may buckle to any side."""
    robot = column(wide)
    loads = np.array([1.001, 1.05, 2.5, 12.0])
    force = np.zeros((4, 3))
    force[:, 2] = -loads * CRITICAL
    found = mr.solve(robot, robot.inputs(tip_force=force), solver=PRECISE).raise_if_failed()
    twin = mr.solve(robot, robot.inputs(tip_force=force), solver=mr.Shooting(integrator=mr.RK4(50), side="negative"))
    assert (found.status == mr.Status.BIFURCATED).all()
    # RK4(50) errs by 1e-6 of the length at moderate loads, and by the square root of its error near the critical one
    deflection = LENGTH * np.array([elastica(load) for load in loads])
    np.testing.assert_allclose(found.tip_position[:, 0], deflection, rtol=0, atol=1e-4 * LENGTH)
    np.testing.assert_allclose(found.tip_position[:, 1], 0, rtol=0, atol=1e-7 * LENGTH)
    np.testing.assert_allclose(twin.tip_position, found.tip_position * (-1, -1, 1), rtol=0, atol=1e-7 * LENGTH)
    stable = mr.Stability.FOLD if wide == 1 else mr.Stability.STABLE
    assert (found.stability == stable).all()
    assert (found.index == 0).all()
    for k, load in enumerate(loads):
        (event,) = found.events[k]
        assert event.status is mr.Status.BIFURCATED
        assert not event.fold
        assert event.neutral == (wide == 1)
        assert event.load_factor == pytest.approx(1 / load, rel=1e-5)  # of RK4(50): 1e-6
        assert event.energy_lost == 0
        np.testing.assert_allclose(event.tip_displacement, (1, 0, 0), rtol=0, atol=1e-5)
        swing = np.linalg.norm(found.tip_position[k] - (0, 0, LENGTH))  # it stood straight until then
        assert event.tip_travel == pytest.approx(swing, rel=1e-9, abs=1e-9 * LENGTH)
        assert event.said.endswith(f"tip moved {swing:.3g} m since")


@pytest.mark.parametrize("wide", [1.0, 2.0], ids=["round", "flat"])
def test_by_the_default_settings_a_column_stands_up_to_near_its_load_and_buckles_from_near_it(wide):
    """Whose columns step control does not see: Euler's load was 1.2e-4 too low, and ``BRANCH_END`` between."""
    robot = column(wide)
    loads = np.array([0.9999, 0.99999, 0.999999, 1.0, 1.00001, 1.0001, 1.001])
    found = mr.solve(robot, robot.inputs(tip_force=-CRITICAL * loads[:, None] * (0, 0, 1))).raise_if_failed()
    assert [mr.Status(k).name for k in found.status] == ["CONVERGED"] * 4 + ["BIFURCATED"] * 3
    bent = mr.Stability.FOLD if wide == 1 else mr.Stability.STABLE
    assert list(found.stability) == [mr.Stability.STABLE] * 3 + [mr.Stability.FOLD] + [bent] * 3
    assert (found.integrations < 150).all()
    np.testing.assert_allclose(found.tip_position[:4], [[0, 0, LENGTH]] * 4, rtol=0, atol=1e-9)
    # RK45(1e-8) errs by 1e-8 in the curvature, over what is left of its stiffness: 2e-5 at least
    expected = LENGTH * np.array([elastica(load) for load in loads[4:]])
    np.testing.assert_allclose(found.tip_position[4:, 0], expected, rtol=2e-3)
    for events, load in zip(found.events[4:], loads[4:], strict=True):
        assert events[0].load_factor == pytest.approx(1 / load, rel=5e-7)  # steps end at 1e-7


def test_just_beyond_its_load_a_blade_is_bent_as_the_elastica_says():
    """What is bent so little leaves residuals within the tolerance whatever its amplitude: ``BRANCH_END`` up to 1e-5 beyond."""
    robot = column(2.0)
    beyond = 10.0 ** -np.arange(3, 9)
    force = -CRITICAL * (1 + beyond[:, None]) * (0, 0, 1)
    found = mr.solve(robot, robot.inputs(tip_force=force), solver=mr.Shooting(integrator=mr.RK4(200))).raise_if_failed()
    assert [mr.Status(k).name for k in found.status] == ["BIFURCATED"] * 5 + ["CONVERGED"]
    deflection = LENGTH * np.array([elastica(1 + part) for part in beyond[:5]])
    # RK4(200) puts the load 6e-11 off, and that is half as much of the amplitude as of what the load is beyond
    np.testing.assert_allclose(found.tip_position[:5, 0], deflection, rtol=5e-4)
    np.testing.assert_allclose(found.tip_position[5], (0, 0, LENGTH), rtol=0, atol=1e-12)  # nearer than 2e-7 it is not told
    twin = mr.solve(robot, robot.inputs(tip_force=force), solver=mr.Shooting(integrator=mr.RK4(200), side="negative"))
    np.testing.assert_allclose(twin.tip_position, found.tip_position * (-1, -1, 1), rtol=0, atol=1e-8 * LENGTH)
    # steps that are long move the load by up to 1e-4 where it is straight, by 1e-6 where it is bent: by them it is bent or not
    mr.solve(robot, robot.inputs(tip_force=force)).raise_if_failed()


def test_many_that_buckle_are_followed_in_hardly_more_launches_than_one(monkeypatch):
    """And each as it is alone."""
    from multirod.solvers.following.serving.together import Together

    evaluate, launches = Together.evaluate, []

    def counted(self, places, *others):
        launches.append(len(places))
        return evaluate(self, places, *others)

    monkeypatch.setattr(Together, "evaluate", counted)
    robot = column(2.0)
    force = -CRITICAL * np.linspace(1.05, 1.5, 30)[:, None] * (0, 0, 1)
    alone, most = [], 0
    for own in force:
        launches.clear()
        alone.append(mr.solve(robot, robot.inputs(tip_force=own), solver=PRECISE))
        most = max(most, len(launches))
    launches.clear()
    together = mr.solve(robot, robot.inputs(tip_force=force), solver=PRECISE)
    assert len(launches) < 2 * most
    # 171 by halving to where it buckles, and by extrapolating by the load beyond; 107 by descent at a quarter of the overshoot
    assert together.integrations.mean() < 102
    np.testing.assert_array_equal(together.unknowns, [own.unknowns for own in alone])
    np.testing.assert_array_equal(together.integrations, [own.integrations for own in alone])
    assert [events[0].said for events in together.events] == [own.events[0].said for own in alone]


def test_rods_that_are_straight_and_rods_that_are_not_are_followed_as_they_are_alone():
    """Straight ones at equal steps; of one batch."""
    bent = np.zeros((3, 3))
    bent[1] = 0.2, 0.1, 0.0
    rod = mr.Rod(length=LENGTH, bending_stiffness=(2 * EI, EI), torsional_stiffness=0.015, precurvature=bent)
    force = -1.3 * CRITICAL * np.array([[0, 0, 1], [0, 0, 9], [0, 0, 1]])
    robot = mr.SingleRod(rod)
    both = mr.solve(robot, robot.inputs(tip_force=force))
    for k in range(3):
        one = mr.SingleRod(mr.Rod(length=LENGTH, bending_stiffness=(2 * EI, EI), torsional_stiffness=0.015, precurvature=bent[k]))
        alone = mr.solve(one, one.inputs(tip_force=force[k]))
        assert both.status[k] == alone.status
        np.testing.assert_array_equal(both.unknowns[k], alone.unknowns)


def test_a_batch_is_its_instances_and_the_others_do_not_notice():
    robot = column(2.0)
    force = np.zeros((5, 3))
    force[:, 2] = CRITICAL * np.array([-0.5, -1.3, 0.4, -0.95, -4.0])
    both = mr.solve(robot, robot.inputs(tip_force=force), solver=PRECISE)
    for k in range(5):
        alone = mr.solve(robot, robot.inputs(tip_force=force[k]), solver=PRECISE)
        assert np.array_equal(alone.unknowns, both.unknowns[k])
        assert alone.integrations == both.integrations[k]
        assert [event.said for event in alone.events] == [event.said for event in both.events[k]]
    stops = mr.solve(robot, robot.inputs(tip_force=force), solver=mr.Shooting(integrator=mr.RK4(50), at_fold="stop"))
    np.testing.assert_array_equal(stops.failed, [False, True, False, False, True])
    assert (stops.status[stops.failed] == mr.Status.BRANCH_END).all()
    np.testing.assert_array_equal(stops.unknowns[~stops.failed], both.unknowns[~stops.failed])
    np.testing.assert_array_equal(stops.integrations[~stops.failed], both.integrations[~stops.failed])


def test_an_end_that_is_unstable_by_the_equations_of_the_solver_is_no_result(monkeypatch):
    """It is found by finer ones, which near a fold may not agree."""
    from multirod.solvers.following.serving.together import Together

    judge = Together._judge

    def otherwise(self, asked):
        found = judge(self, asked)
        if self.tip is None:  # the solver's own equations, at the end
            return {k: replace(judgement, falls=True, stands=False) for k, judgement in found.items()}
        return found

    monkeypatch.setattr(Together, "_judge", otherwise)
    found = mr.solve(robot := column(2.0), robot.inputs(tip_force=(0, 0, -2 * CRITICAL)), solver=PRECISE)
    assert found.status is mr.Status.UNSTABLE
    assert np.isnan(found.tip_position).all()
    assert found.events == ()


def test_a_load_across_that_is_too_small_to_hold_a_round_column_says_where_it_is():
    """What holds it on the circle of its bent states cannot be told from nothing: neutral, and not unstable."""
    robot = column()
    across = 1e-9 * np.array([np.cos(0.3), np.sin(0.3)])
    found = mr.solve(robot, robot.inputs(tip_force=1.1 * CRITICAL * np.append(across, -1)))
    assert (found.status, found.stability) == (mr.Status.CONVERGED, mr.Stability.FOLD)
    x, y, _ = found.tip_position
    assert np.arctan2(y, x) == pytest.approx(0.3, abs=0.01)
    assert np.hypot(x, y) == pytest.approx(elastica(1.1) * LENGTH, rel=1e-5)


def test_what_cannot_be_decided_is_no_result():
    robot = column(2.0)
    press = (0, 0, -1.5 * CRITICAL)
    limited = mr.solve(robot, robot.inputs(tip_force=press), solver=mr.Shooting(integrator=mr.RK4(50), max_integrations=80))
    assert limited.status is mr.Status.INTEGRATION_LIMIT
    assert limited.integrations <= 80 + 10  # those that judge come on top, as everywhere
    assert limited.events == ()
    with pytest.raises(ValueError, match="Shooting.at_fold = 'go' is not allowed"):
        mr.Shooting(at_fold="go")
    with pytest.raises(ValueError, match="Shooting.side = 'left' is not allowed"):
        mr.Shooting(side="left")


@pytest.mark.parametrize("degrees", [138.6, 138.7, 140.0, 141.0])
def test_what_changes_does_not_hide_by_stiff_modes_that_a_soft_one_is_unstable(degrees):
    """A magnet on a rod under its weight, in a field that turns in the vertical plane, which it has just left: the field makes it
    stiffer across as long as it is held where it was."""
    sections = [mr.Section(length=0.04, magnetisation=(0, 0, 0), **SOFT), mr.Section(length=0.01, magnetisation=MAGNET, **SOFT)]
    across = np.array([[0, 0, 1, 0], [0, 1, 0, 0], [-1, 0, 0, 0], [0, 0, 0, 1]])
    robot = mr.SingleRod(mr.Rod(sections=sections), base=across)
    angle = np.radians(degrees)
    inputs = robot.inputs(gravity=(0, 0, -9.81), magnetic_field=0.03 * np.array([np.cos(angle), 0, np.sin(angle)]))
    found, twin = (mr.solve(robot, inputs, solver=mr.Shooting(side=side)) for side in ("positive", "negative"))
    assert found.status is mr.Status.BIFURCATED
    assert found.stability is mr.Stability.STABLE
    assert found.tip_position[1] > 0.005
    np.testing.assert_allclose(twin.tip_position, found.tip_position * (1, -1, 1), rtol=0, atol=1e-9)
    states = mr.equilibria(robot, inputs)
    stable = states.tip_position[states.stability == mr.Stability.STABLE]
    np.testing.assert_allclose(np.sort(stable[:, 1]), [twin.tip_position[1], found.tip_position[1]], rtol=0, atol=1e-7)


def test_without_a_potential_damped_dynamics_go_on():
    """Pushed to and fro with a moment on its tip; energy descent, which passes folds, is the witness."""
    robot, time = column(25.0), np.linspace(0, 6, 121)
    press, push = -1.5 * np.clip(time / 2, 0, 1), 0.5 * np.sin(np.pi * np.clip(time - 2, 0, 4) / 2)
    force = CRITICAL * np.stack([push, 0 * time, press], axis=-1)
    inputs = robot.inputs(tip_force=force, tip_moment=(0, 0.05 * EI / LENGTH, 0))
    history = mr.simulate(robot, inputs, time=time, solver=PRECISE).raise_if_failed()
    assert set(history.status) == {mr.Status.CONVERGED, mr.Status.DAMPED}
    witness = mr.simulate(robot, inputs, time=time, solver=mr.EnergyDescent(integrator=mr.RK4(50)))
    tracking = witness.status == mr.Status.TRACKING
    (snapped, *_) = np.flatnonzero(history.status == mr.Status.DAMPED)
    assert tracking[snapped + 1 :].sum() > 10
    # energy descent is off by what a sample moves, squared
    np.testing.assert_allclose(history.tip_position[tracking], witness.tip_position[tracking], rtol=0, atol=0.01 * LENGTH)
    assert history.tip_position[snapped - 1, 0] * history.tip_position[snapped + 1, 0] < 0


def test_without_a_potential_a_solve_goes_on_as_well():
    """A column with so small a moment about its axis that it is an elastica all the same."""
    robot = column(2.0)
    inputs = robot.inputs(tip_force=(0, 0, -1.5 * CRITICAL), tip_moment=(0, 0, 1e-6 * EI / LENGTH))
    found = mr.solve(robot, inputs, solver=PRECISE)
    assert (found.status, found.stability, found.events) == (mr.Status.DAMPED, mr.Stability.UNKNOWN, ())
    assert found.integrations < 500
    assert abs(found.tip_position[0]) == pytest.approx(LENGTH * elastica(1.5), rel=1e-4)  # of RK4(50), and of the moment
    assert mr.solve(robot, inputs, solver=mr.Shooting(at_fold="stop")).status is mr.Status.BRANCH_END


def test_a_branch_that_rounding_ends_beyond_its_critical_point_is_left_there():
    """By equal steps without poses it ends 1e-5 later: it went on, unstable, and ended as ``UNSTABLE``."""
    robot = mr.SingleRod(mr.Rod(length=0.4, bending_stiffness=0.2233, torsional_stiffness=0.0638, precurvature=(14, 5, 0)))
    found, fine = (
        mr.solve(robot, robot.inputs(tip_force=(0, 0, -30)), solver=mr.Shooting(integrator=integrator))
        for integrator in (mr.RK4(50), mr.RK45())
    )
    assert (found.status, found.stability) == (mr.Status.SNAPPED, mr.Stability.STABLE)
    np.testing.assert_allclose(found.tip_position, fine.tip_position, rtol=0, atol=1e-4)  # of RK4(50)


@pytest.fixture(scope="module")
def loop():
    """A flat column, pressed until it has buckled, then pushed to and fro."""
    robot = column(4.0)
    time = np.linspace(0, 6, 121)
    press, push = -1.5 * np.clip(time / 2, 0, 1), 0.5 * np.sin(np.pi * np.clip(time - 2, 0, 4) / 2)
    force = CRITICAL * np.stack([push, 0 * time, press], axis=-1)
    return mr.simulate(robot, robot.inputs(tip_force=force), time=time, solver=PRECISE)


def test_a_motion_goes_on_after_it_buckled_and_snapped(loop):
    loop.raise_if_failed()
    statuses = np.flatnonzero(loop.status != mr.Status.CONVERGED)
    assert [mr.Status(k).name for k in loop.status[statuses]] == ["BIFURCATED", "SNAPPED"]
    assert (loop.stability[statuses] == mr.Stability.STABLE).all()
    buckled, snapped = (event for sample in loop.events for event in sample)
    assert buckled.time == pytest.approx(2 / 1.5, abs=1e-4)
    assert np.isnan(buckled.load_factor)
    assert snapped.fold
    assert loop.time[statuses[1] - 1] < snapped.time < loop.time[statuses[1]]
    assert snapped.energy_lost > 0
    assert loop.tip_position[statuses[1] - 1, 0] > 0.5 * LENGTH
    assert loop.tip_position[statuses[1], 0] < -0.5 * LENGTH
    np.testing.assert_allclose(loop.tip_position[:, 1], 0, atol=1e-6 * LENGTH)
    # energy lost is the difference of potentials just before and after, but for what the load did in between
    potential = loop.potential[statuses[1] - 1 : statuses[1] + 1]
    assert snapped.energy_lost == pytest.approx(potential[0] - potential[1], rel=0.1)


def test_a_history_tells_what_acted_at_any_time(loop):
    """At an event too: Euler's load, where the rod buckled."""
    buckled = next(event for sample in loop.events for event in sample)
    force = loop.inputs_at(buckled.time).tip_force
    assert force.shape == (3,)
    assert force[2] == pytest.approx(-CRITICAL, rel=1e-4)
    for k in (0, 7, len(loop.time) - 1):
        np.testing.assert_allclose(loop.inputs_at(loop.time[k]).tip_force, loop.inputs.tip_force[k], rtol=1e-12)
    mean = (loop.inputs.tip_force[7] + loop.inputs.tip_force[8]) / 2
    np.testing.assert_allclose(loop.inputs_at((loop.time[7] + loop.time[8]) / 2).tip_force, mean, rtol=1e-12)
    for beyond in (loop.time[0] - 1e-3, loop.time[-1] + 1e-3, np.nan):
        with pytest.raises(ValueError, match=r"History\.inputs_at\.time"):
            loop.inputs_at(beyond)


def test_a_fold_is_where_the_state_before_loses_stability(loop):
    robot, sample = loop.assembly, int(np.flatnonzero(loop.status == mr.Status.SNAPPED)[0])
    (event,) = loop.events[sample]
    before, after = loop.inputs.tip_force[sample - 1], loop.inputs.tip_force[sample]
    part = (event.time - loop.time[sample - 1]) / (loop.time[sample] - loop.time[sample - 1])
    assert part == pytest.approx(event.progress)
    # just before, it is nearly neutral
    near = before + (event.progress - 1e-3) * (after - before)
    there = mr.solve(robot, robot.inputs(tip_force=near), solver=PRECISE, guess=loop.unknowns[sample - 1]).raise_if_failed()
    assert 0 < there.stability_margin < 0.05
    assert there.tip_position[0] > 0.5 * LENGTH


def test_a_tracker_does_the_same(loop):
    tracker = mr.Tracker(loop.assembly, solver=PRECISE, inputs=loop.inputs[0])
    force = loop.inputs.tip_force
    for k in range(0, len(force), 1):
        sample = tracker.step(tip_force=force[k])
        assert sample.status == loop.status[k]
    assert sample.events == ()
    np.testing.assert_array_equal(sample.unknowns, loop.unknowns[-1])


def test_a_round_column_straightens_again():
    robot = column()
    time = np.linspace(0, 1, 26)
    force = np.zeros((26, 3))
    force[:, 2] = -1.3 * CRITICAL * np.sin(np.pi * time)
    history = mr.simulate(robot, robot.inputs(tip_force=force), time=time, solver=PRECISE).raise_if_failed()
    names = [mr.Status(k).name for k in history.status]
    assert names.count("BIFURCATED") == 1
    assert set(names) == {"CONVERGED", "BIFURCATED"}
    bent = -force[:, 2] > 1.001 * CRITICAL
    np.testing.assert_allclose(history.tip_position[~bent, 0], 0, atol=1e-6)
    expected = [elastica(load) * LENGTH for load in -force[bent, 2] / CRITICAL]
    np.testing.assert_allclose(history.tip_position[bent, 0], expected, rtol=0, atol=1e-5)
    np.testing.assert_allclose(history.tip_position[:, 1], 0, atol=1e-6)


def test_events_are_saved_and_said(loop, tmp_path):
    loop.save(tmp_path / "loop.npz")
    again = mr.load(tmp_path / "loop.npz")
    said = [[event.said for event in sample] for sample in loop.events]
    assert [[event.said for event in sample] for sample in again.events] == said
    (place,) = np.flatnonzero(loop.status == mr.Status.SNAPPED)
    single = loop[int(place)]
    assert [event.said for event in single.events] == said[place]
    assert said[place][0].startswith("SNAPPED at a fold, ")
    assert said[place][0] in repr(single)
    assert said[place][0] in single._repr_html_()
    assert said[place][0] in loop._repr_html_()
    assert mr.Status.SNAPPED.event
    assert not mr.Status.SNAPPED.failed
    assert mr.Status.DAMPED.event
    assert not mr.Status.CONVERGED.event
    assert not mr.Status.BRANCH_END.event


def test_the_witness_goes_down_in_energy():
    """Its gradient is that of its energy, by central differences."""
    random = np.random.default_rng(0)
    rods = CreepingRods(np.array([0.5]), np.array([[0.2, 0.3, 0.07]]), np.array([[8.0, 3.0, 2.0]]), 6)
    rods.R[:, 1:] = rotation(0.3 * random.normal(size=(1, 6, 3))) @ rods.R[:, 1:]
    force = np.array([[0.3, -0.5, 0.4]])
    gradient = rods._forces(force)[0]
    for node in range(6):
        for axis in range(3):
            turn = np.zeros((1, 6, 3))
            turn[0, node, axis] = 1e-6
            values = []
            for sign in (1, -1):
                R = np.array(rods.R)
                R[:, 1:] = rotation(sign * turn) @ R[:, 1:]
                values.append(rods.energy(R, force)[0])
            assert (values[0] - values[1]) / 2e-6 == pytest.approx(gradient[0, node, axis], abs=1e-8)


def test_a_snap_leads_where_a_rod_creeps_to():
    """Random wires, their loads raised slowly: those that snap, and rods on segments that creep through a viscous medium."""
    length, torsion = np.array([0.533, 0.671]), np.array([0.0211, 0.055])
    precurvature = np.array([(7.73, -5.66, -5.27), (17.35, 2.23, -4.94)])
    force = np.array([(2.729, -2.227, 1.274), (4.401, -1.47, -0.307)])
    robot = mr.SingleRod(mr.Rod(length=length, bending_stiffness=0.2233, torsional_stiffness=torsion, precurvature=precurvature))
    found = mr.solve(robot, robot.inputs(tip_force=force))
    assert (found.status == mr.Status.SNAPPED).all()
    assert (found.stability == mr.Stability.STABLE).all()
    for (event,) in found.events:
        assert event.fold
        assert event.energy_lost > 0
        assert np.linalg.norm(event.tip_displacement) > 0.2
    stiffness = np.stack([np.full(2, 0.2233), np.full(2, 0.2233), torsion], -1)
    rods = CreepingRods(length, stiffness, precurvature, 24)
    for level in np.linspace(0, 1, 21)[1:]:
        assert rods.settle(level * force).all()
    off = np.linalg.norm(rods.tip - found.tip_position, axis=1) / length
    # 24 segments are off by less than 0.01 of the length, other equilibria by more than 0.1
    assert off.max() < 0.01


@pytest.mark.filterwarnings("ignore::multirod.PlausibilityWarning")  # of unit stiffness and length
def test_two_tubes_snap_across_where_their_torsion_says_and_back():
    """a'' = c sin a of the angle between equal tubes, a' = 0 at the tip: the base's is largest where they snap."""
    curvature = 4.0
    tube = mr.Rod(length=1, bending_stiffness=1, torsional_stiffness=1, precurvature=(curvature, 0, 0))
    robot = mr.ConcentricTubes([tube, tube])
    time = np.linspace(0, 2, 101)
    angle = np.interp(time, (0, 1, 2), (0, 2 * np.pi, 0))
    history = mr.simulate(robot, robot.inputs(rotation=np.stack([angle, 0 * angle], axis=-1)), time=time)

    def base(tip: float) -> float:
        torsion = solve_ivp(lambda _, y: (y[1], curvature**2 * np.sin(y[0])), (1, 0), (tip, 0), rtol=1e-11, atol=1e-12)
        return float(torsion.y[0, -1])

    snaps = base(minimize_scalar(lambda tip: -base(tip), bounds=(0.01, 3), method="bounded", options={"xatol": 1e-9}).x)
    there, back = (event for sample in history.events for event in sample)
    assert there.status is back.status is mr.Status.SNAPPED
    # the first sample after a snap is located within a thousandth of a sample; the equations, to RK45's tolerance
    np.testing.assert_allclose(np.interp([there.time, back.time], time, angle), (snaps, 2 * np.pi - snaps), rtol=0, atol=2e-4)
    assert there.energy_lost == pytest.approx(back.energy_lost, rel=1e-3)
    assert (np.sort(history.status)[-2:] == mr.Status.SNAPPED).all()
    assert (np.sort(history.status)[:-2] == mr.Status.CONVERGED).all()
    assert (history.stability == mr.Stability.STABLE).all()
    after = int(np.flatnonzero(history.status == mr.Status.SNAPPED)[0])
    others = mr.equilibria(robot, history.inputs[after])
    stable = others.tip_position[others.index == 0]
    assert np.linalg.norm(stable - history.tip_position[after], axis=1).min() < 1e-6


@pytest.mark.filterwarnings("ignore::multirod.PlausibilityWarning")  # of unit stiffness and length
@pytest.mark.parametrize(("curvature", "straight"), [(4.0, 0.5), (5.0, 1.0)])
def test_tubes_that_would_snap_though_their_tips_were_held_go_to_the_next_turn(curvature, straight):
    """Angles that creep, a_t = a'' - c sin a, rise together until all meet the next equilibrium: its tip is a turn further."""
    shape = [(straight, (0, 0, 0)), (1.0, (curvature, 0, 0))]
    tube = mr.Rod(length=1 + straight, bending_stiffness=1, torsional_stiffness=1, precurvature=shape)
    robot = mr.ConcentricTubes([tube, tube])
    time = np.linspace(0, 1, 121)
    angle = 18.0 * time
    history = mr.simulate(robot, robot.inputs(rotation=np.stack([angle, 0 * angle], axis=-1)), time=time)
    assert not history.failed.any()
    events = [event for sample in history.events for event in sample]
    assert events
    assert all(event.status is mr.Status.SNAPPED and event.fold and event.energy_lost > 0 for event in events)
    first = int(np.flatnonzero(history.status == mr.Status.SNAPPED)[0])

    def base(tip: float) -> tuple[float, float]:
        """Angle and torsion at the base, of a tip that is at an angle."""
        curved = solve_ivp(lambda _, y: (y[1], curvature**2 * np.sin(y[0])), (1, 0), (tip, 0), rtol=1e-11, atol=1e-12)
        there, torsion = curved.y[:, -1]
        return there - straight * torsion, torsion

    turn = 2 * np.pi
    farthest = minimize_scalar(lambda tip: -base(tip)[0], bounds=(turn, turn + 2), method="bounded").x  # where that snaps
    tip = brentq(lambda tip: base(tip)[0] - angle[first], turn, farthest)
    # equal tubes share the torsion between them, with GJ = 1; RK45's tolerance beside that of a residual
    assert history.rod(0).moment[first, 0, 2] == pytest.approx(0.5 * base(tip)[1], rel=1e-6)


# ---- loads whose sideways parts nearly cancel: a rod bends in their plane and turns about its axis at almost no cost ----

NEARLY_AXIAL = mr.SingleRod(mr.Rod(length=0.12, bending_stiffness=6e-4, torsional_stiffness=6e-4 / 1.3))
THRUST, AGAINST = np.array([0.00369, 0.0, -0.345]), np.array([-0.069, 0.0, 0.0])


@pytest.mark.parametrize("part", [1.0, 1.02, 1.05, 1.1])
def test_what_newtons_method_has_not_finished_does_not_lead_past_a_bifurcation(part):
    """Gamma at its last step but one had another sign of the soft mode: these were ``CONVERGED`` and unstable, without event."""
    found = mr.solve(NEARLY_AXIAL, NEARLY_AXIAL.inputs(tip_force=THRUST, distributed_force=part * AGAINST))
    assert found.status is mr.Status.SNAPPED
    assert found.stability is mr.Stability.STABLE
    (event,) = found.events
    (critical,) = mr.critical_loads(NEARLY_AXIAL, found.inputs)
    assert event.load_factor == pytest.approx(critical.load_factor, rel=1e-2)
    assert found.tip_position[0] < 0  # the other way than the thrust, where the distributed force pushes


@pytest.mark.parametrize("aside", [1e-6, 1e-5, 1e-4])
def test_a_branch_that_turns_about_at_almost_no_cost_is_followed_where_it_creeps(aside):
    """``MAX_ITERATIONS`` before: steps along it may be no longer than the soft mode is stiff."""
    inputs = NEARLY_AXIAL.inputs(tip_force=THRUST + np.array([0, aside, 0]), distributed_force=AGAINST)
    found = mr.solve(NEARLY_AXIAL, inputs).raise_if_failed()
    assert found.stability is mr.Stability.STABLE
    assert found.tip_position[0] < 0 < found.tip_position[1]


@pytest.mark.parametrize(
    ("thrust", "against"),
    [
        (THRUST, AGAINST),
        ((0.00036761, 0, -0.19044868), (-0.00782057, 0, 0)),
        ((0.00195724, 0, -0.21602298), (-0.03923781, 0, 0)),
    ],
)
def test_motions_in_small_steps_past_such_a_bifurcation_are_stable_or_say_so(thrust, against):
    """In samples so close that one cannot tell yet whether its mode has vanished: the next ones stayed on what is unstable."""
    time = np.linspace(0, 1, 1001)
    inputs = NEARLY_AXIAL.inputs(tip_force=time[:, None] * thrust, distributed_force=time[:, None] * against)
    motion = mr.simulate(NEARLY_AXIAL, inputs, time=time)
    assert any(motion.events)
    assert not (~motion.failed & (motion.stability == mr.Stability.UNSTABLE)).any()
    assert motion.failed.sum() <= 2


@pytest.mark.parametrize("wide", [1.0, 1.5], ids=["round", "flat"])
def test_straight_tubes_buckle_as_the_rod_that_they_are_together(wide):
    """Solved at once, with its events and to its side; up to its load they stand, beyond they were ``LOWEST_ENERGY`` or lost."""
    soft = [0.02, 0.03, 0.05]
    tubes = [mr.Rod(length=LENGTH, bending_stiffness=(wide * EI, EI), torsional_stiffness=0.7 * EI) for EI in soft]
    together = mr.Rod(length=LENGTH, bending_stiffness=(wide * sum(soft), sum(soft)), torsional_stiffness=0.7 * sum(soft))
    loads = np.array([0.999, 0.9999, 1.001, 1.1, 3.0])
    force = -loads[:, None] * np.pi**2 / 4 * sum(soft) / LENGTH**2 * (0, 0, 1)
    for side in ("positive", "negative"):
        several, one = (
            mr.solve(robot, robot.inputs(tip_force=force), solver=mr.Shooting(side=side)).raise_if_failed()
            for robot in (mr.ConcentricTubes(tubes), mr.SingleRod(together))
        )
        assert several.status.tolist() == one.status.tolist() == [mr.Status.CONVERGED] * 2 + [mr.Status.BIFURCATED] * 3
        np.testing.assert_allclose(several.tip_position, one.tip_position, rtol=0, atol=1e-6 * LENGTH)  # of RK45(): 1e-7
        assert (several.stability == one.stability).all()
        assert (several.integrations < 300).all()
        for own, other in zip(several.events[2:], one.events[2:], strict=True):
            assert own[0].load_factor == pytest.approx(other[0].load_factor, rel=1e-5)
            np.testing.assert_allclose(own[0].tip_displacement, other[0].tip_displacement, rtol=0, atol=1e-6)


@pytest.mark.parametrize("more", [0.0, 1e-3, 0.1])
def test_of_mirror_images_a_solve_of_tubes_gives_the_side_of_the_rule(more):
    """Equal states beyond two snaps, to either side: which of them it is does not depend on which was found first."""
    tubes = [
        mr.Rod(length=0.3, bending_stiffness=0.02, torsional_stiffness=0.015, precurvature=(9 + more, 0, 0)),
        mr.Rod(length=0.25, bending_stiffness=0.02, torsional_stiffness=0.015, precurvature=(8, 0, 0)),
    ]
    robot = mr.ConcentricTubes(tubes)
    tip = {}
    for side in ("positive", "negative"):
        found = mr.solve(robot, robot.inputs(rotation=(0, 5 * np.pi)), solver=mr.Shooting(side=side)).raise_if_failed()
        assert found.status == mr.Status.LOWEST_ENERGY
        tip[side] = found.tip_position
    assert tip["positive"][0] > 0.01
    np.testing.assert_allclose(tip["negative"], tip["positive"] * (-1, 1, 1), rtol=0, atol=1e-6)


@pytest.mark.parametrize("load", [184.0, 200.0, 230.0])
def test_a_strip_pressed_far_beyond_is_on_its_elastica(load):
    """Integrations from the base alone lead astray there: it was ``UNSTABLE``. A long elastica turns over near its base and
    hangs from there: its top is ``2/a^1/2`` aside under ``a EI/L^2``, and as much higher than it would be, as ``e^-a^1/2`` is
    nothing."""
    robot = mr.SingleRod(mr.Rod(length=1, bending_stiffness=(1, 2), torsional_stiffness=0.7))
    solution = mr.solve(robot, robot.inputs(tip_force=(0, 0, -load))).raise_if_failed()
    assert solution.status == mr.Status.BIFURCATED
    assert solution.stability == mr.Stability.STABLE
    aside = 2 / np.sqrt(load)
    np.testing.assert_allclose(solution.tip_position, (0, aside, aside - 1), rtol=0, atol=1e-4)


@pytest.mark.parametrize(("samples", "most"), [(2, 4.9564), (3, 6.7404), (5, 6.7404)])
def test_a_sample_does_not_pass_two_bifurcations_unseen(samples, most):
    """A strip on edge, pushed along its width: two modes vanish on the way to the second sample, and ``Gamma`` is as at first; of
    two samples Newton's method contracts as if nothing were on the way."""
    robot = mr.SingleRod(mr.Rod(length=0.3, bending_stiffness=(0.642, 0.02), torsional_stiffness=6.1378e-3))
    time = np.linspace(0, 1, samples)
    push = np.stack([0 * time, most * time, 0 * time], axis=-1)
    history = mr.simulate(robot, robot.inputs(tip_force=push), time=time)
    assert history.status[1] is mr.Status.BIFURCATED
    assert (history.stability == mr.Stability.STABLE).all()
    # Prandtl's load, 4.0126 (EI GJ)^1/2/L^2, of a strip that is stiff in its plane: this one bends a little before
    critical = 4.0126 * np.sqrt(0.02 * 6.1378e-3) / 0.3**2
    ((event,), *_) = (sample for sample in history.events if sample)
    assert event.time == pytest.approx(critical / most, rel=0.05)


@pytest.mark.filterwarnings("ignore::multirod.PlausibilityWarning")  # which says that it is hardly meant
@pytest.mark.parametrize("twist", [0.01, 1.0, 3.0])
def test_a_column_that_is_twisted_at_rest_is_not_left_standing(twist):
    """Errors of the integration turn ``Gamma`` where both its modes would vanish: it stood, ``CONVERGED`` and unstable."""
    robot = mr.SingleRod(mr.Rod(length=1, bending_stiffness=1, torsional_stiffness=0.7, precurvature=(0, 0, twist)))
    force = np.array([0, 3.75])[:, None] * np.array([0, 0, -1.0])
    finer = mr.Shooting(integrator=mr.RK4(400))
    for solver in (mr.Shooting(), finer):
        solution = mr.solve(robot, robot.inputs(tip_force=force[1]), solver=solver)
        sample = mr.simulate(robot, robot.inputs(tip_force=force), time=[0.0, 1.0], solver=solver)[1]
        for found in (solution, sample):
            assert found.failed or found.status == mr.Status.BIFURCATED
            if solver is finer:
                # as one that is not twisted: elliptic integrals
                np.testing.assert_allclose(np.hypot(*found.tip_position[:2]), 0.791754894, rtol=0, atol=1e-7)
