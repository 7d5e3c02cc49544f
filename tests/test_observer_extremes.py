"""The observer's exact update at gains and sample times over decades: it never diverges on a motion that stays clear of folds."""

import numpy as np
import pytest
from observer_scenes import GAINS, MOTIONS, MOVING, TIMES, follow, measure

import multirod as mr

FLOOR = 1e-9  # of where the residual would be without any correction: rounding
ESTIMATES = [mr.Status.TRACKING, mr.Status.NEAR_FOLD]


def size(history):
    return np.linalg.norm(history.boundary_residual, axis=-1)


@pytest.mark.parametrize("dt", TIMES)
@pytest.mark.parametrize("name", MOTIONS)
def test_error_is_bounded_and_shrinks_once_the_motion_stops(name, dt):
    """By (22) of docs/observer.md the residual of a robot at rest decays at the slowest of the rates, at any gain."""
    held = size(follow(name, (1e-9, 1e-9), dt)).max()
    assert held > 0.3
    for gain in GAINS:
        history = follow(name, gain, dt)
        error = size(history)
        assert np.isin(history.status, ESTIMATES).all()
        assert error.max() <= 1.01 * held
        still = error[MOVING:]
        assert (still[1:] <= still[:-1] + FLOOR * held).all()
        slowest = dt * history.rates[MOVING:].min(axis=1)
        if slowest.max() < 1:
            decay = np.exp(-np.cumsum(slowest[:-1]))
            assert (still[1:] <= 1.05 * decay * still[0] + FLOOR * held).all()
        else:  # Gamma turns within a sample: then what is left is a Newton step's
            assert (still[1:] <= 0.5 * still[:-1] + FLOOR * held).all()
            assert still[-1] < FLOOR * held


@pytest.mark.parametrize("name", MOTIONS)
def test_only_gain_times_sample_time_counts(name):
    """What a sample is moved by depends on sqrt(R Q) dt alone where R and Q are numbers: (4) and (11)."""
    one = follow(name, (10.0, 10.0), 0.01)
    for gain, dt in (((0.1, 0.1), 1.0), ((1e3, 1e-3), 0.1), ((1e-3, 1e3), 0.1)):
        np.testing.assert_allclose(follow(name, gain, dt).unknowns, one.unknowns, rtol=0, atol=1e-9 * np.abs(one.unknowns).max())


@pytest.mark.parametrize("product", [1e-2, 1.0, 1e2])
def test_error_is_proportional_to_the_noise_of_a_measured_curvature(product):
    """``x' = -R Gamma^T P (eps - noise)`` filters noise: what it adds to ``x`` is at most the noise over the smallest singular
    value."""
    clean = measure(0.0, product)
    tips = []
    for amplitude in (1e-6, 1e-4, 1e-2, 0.1):
        history = measure(amplitude, product)
        assert (history.status == mr.Status.TRACKING).all()
        moved = np.linalg.norm(history.unknowns - clean.unknowns, axis=1).max()
        most = np.sqrt(3) * amplitude / clean.smallest_singular_value.min()
        assert 0 < moved <= 1.05 * most
        tips.append(np.linalg.norm(history.tip_position - clean.tip_position, axis=1).max() / amplitude)
    np.testing.assert_allclose(tips, tips[0], rtol=0.05)  # 0.1 1/m is 4 % of a turn over the length: its square shows
