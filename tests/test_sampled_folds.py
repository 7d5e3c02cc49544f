"""What is said of where a branch ends does not depend on how finely a motion is sampled."""

import numpy as np
import pytest

import multirod as mr

LENGTH, WIDTH, THICKNESS = 0.2, 6e-3, 0.5e-3
THIN, WIDE = 200e9 * WIDTH * THICKNESS**3 / 12, 200e9 * THICKNESS * WIDTH**3 / 12
BLADE = mr.SingleRod(mr.Rod(length=LENGTH, bending_stiffness=(WIDE, THIN), torsional_stiffness=77e9 * WIDTH * THICKNESS**3 / 3))
EULER = np.pi**2 / 4 * THIN / LENGTH**2


def moved(press, push):
    """Forces of Euler's load, against the blade and across it."""
    force = EULER * np.stack([push, 0 * push, -press], axis=-1)
    return mr.simulate(BLADE, BLADE.inputs(tip_force=force), time=np.arange(len(press)))


def pressed(press, aside, push):
    """Pressed at first, and pushed ``aside``, then pushed as is given."""
    begin = np.linspace(0, 1, 20)
    return np.append(press * begin, np.full(len(push), press)), np.append(aside * begin, push)


@pytest.mark.parametrize("step", [0.05, 0.004, 1e-3, 3e-5])
@pytest.mark.parametrize("by_states", [False, True])
def test_a_blade_that_is_pushed_over_snaps_however_near_samples_are(step, by_states, monkeypatch):
    """Where segments have found the sample before its fold, known by its states alone, too: the next was solved anew there, on
    the other side, ``CONVERGED``, without an event. Where the fold is, and what is lost, is by samples 0.0015 apart."""
    if by_states:
        monkeypatch.setattr("multirod.solvers.multiple_shooting.NEAR_POSE", 0.0)
        monkeypatch.setattr("multirod.solvers.multiple_shooting.SAME_POSE", 0.0)
    fold = -0.416339
    push = np.append(np.linspace(0.1, fold + 4.5 * step, 12), fold + step * np.arange(3.5, -6, -1))
    press, push = pressed(1.5, 0.1, push)
    history = moved(press, push)
    assert not history.failed.any()
    (jump,) = np.flatnonzero(np.abs(np.diff(history.tip_position[:, 0])) > LENGTH)
    assert history.status[jump + 1] == mr.Status.SNAPPED
    (event,) = history.events[jump + 1]
    assert event.fold
    assert np.interp(event.time, history.time, push) == pytest.approx(fold, rel=0, abs=2e-6)
    assert event.energy_lost == pytest.approx(0.1004474, rel=1e-5)


@pytest.mark.parametrize("step", [5e-5, 3e-6])
def test_a_blade_hardly_beyond_buckling_that_is_pushed_slowly_is_lost_in_no_sample(step):
    """Just behind its fold next to nothing drives it within a sample: it was ``BRANCH_END`` there, ten times in a row."""
    fold = -0.000859
    press, push = pressed(1.01, 0.002, np.append(np.linspace(0.002, fold + 8 * step, 8), fold + step * np.arange(7, -13, -1)))
    history = moved(press, push)
    assert not history.failed.any()
    ((at, event),) = [(k, event) for k, events in enumerate(history.events) for event in events]
    assert history.status[at] == mr.Status.SNAPPED
    assert event.fold
    assert np.interp(event.time, history.time, push) == pytest.approx(fold, rel=0, abs=1e-6)


def test_a_sample_just_where_a_column_buckles_does_not_make_it_snap():
    """The next one was ``SNAPPED`` from what it would be straight there, by what it had gone beyond."""
    press = np.append(np.linspace(0, 1.0, 9), [1.02, 1.05])
    history = moved(press, 0 * press)
    ((at, event),) = [(k, event) for k, events in enumerate(history.events) for event in events]
    assert history.status[at] == mr.Status.BIFURCATED
    assert np.interp(event.time, history.time, press) == pytest.approx(1.0, rel=0, abs=1e-5)
    assert event.energy_lost == 0


def test_what_is_lost_between_two_folds_that_are_near_is_known_where_both_states_are():
    """A thousandth of the load beyond the one, the other is passed: what is lost was a hundred times as much."""
    offsets = ((8e-3, 0), (0, 8e-3), (-8e-3, 0), (0, -8e-3))
    lines = [mr.Tendon(offset=offset) for offset in offsets]
    robot = mr.SingleRod(mr.Rod.wire(length=0.2, diameter=1e-3, young_modulus=60e9, shear_modulus=23e9, lines=lines))
    tension, force = (6.91028993, 5.61254853, 2.35139405, 6.14121816), np.array([-0.26480908, 0.01331449, -0.05188594])

    def at(factor):
        return robot.inputs(tension=factor * np.array(tension), tip_force=factor * force)

    (event,) = mr.solve(robot, at(1.0)).events
    found = mr.equilibria(robot, at(event.load_factor * (1 - 3e-7)))
    stable = found.potential[found.stability == mr.Stability.STABLE]
    assert len(stable) == 2
    # so near before the fold it is 1.4 % less
    assert event.energy_lost == pytest.approx(np.ptp(stable), rel=0.03)
