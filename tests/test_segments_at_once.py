"""Segments of rods, each a thread of a launch: what they find depends on neither order nor what else is asked for, and ends."""

from dataclasses import replace

import numpy as np
import pytest

import multirod as mr
from multirod.models.backbone.segments import room
from multirod.segments import Cuts
from multirod.solvers.following.walk import PIECES
from multirod.solvers.segments import equilibria
from multirod.solvers.segments.path import SegmentedPaths
from multirod.status import Fault


@pytest.fixture(scope="module")
def soft() -> mr.SingleRod:
    return mr.SingleRod(
        mr.Rod(length=0.4, bending_stiffness=(0.02, 0.03), torsional_stiffness=0.012, precurvature=(4, -2, 6)),
    )


def cut(problem, steps):
    """A rod in as many segments as there are numbers of steps, of states by lot, and the level of its load."""
    count, n = len(steps), problem.unknown_count
    edges, rng = np.linspace(0, 0.4, count + 1), np.random.default_rng(0)
    states = problem.segments.base_state(np.zeros(count, dtype=int), rng.normal(size=(count, n)))
    states = problem.segments.moved(np.zeros(count, dtype=int), states, rng.normal(size=(count, 6)))
    whole = np.array([0]), np.array([0, count])
    return Cuts(*whole, edges[:-1], edges[1:], states, np.zeros((1, n)), np.array(steps, dtype=np.int32)), np.ones(1)


STEPS = (4, 64, 4, 8, 2, 4, 128, 2, 4, 32, 4, 2, 16, 2)  # more segments than lanes, the longest last but some


def test_no_order_changes_a_bit(soft, monkeypatch):
    problem = soft.problem(soft.inputs(tip_force=(1, 2, -1)), integrator=mr.RK45())
    given = cut(problem, STEPS)
    found = problem.segments.propagate(*given)
    assert problem.segments._rooms[16, 6]._longest_first(given[0].steps)[0] == STEPS.index(128)
    monkeypatch.setattr(room.Room, "_longest_first", lambda self, steps: None)
    as_given = problem.segments.propagate(*given)
    for name in ("end", "transition", "residual", "residual_columns", "displacement", "displacement_columns", "fault"):
        np.testing.assert_array_equal(getattr(found, name), getattr(as_given, name), err_msg=name)


def test_states_are_the_same_without_columns(soft):
    problem = soft.problem(soft.inputs(tip_force=(1, 2, -1)), integrator=mr.RK45())
    given = cut(problem, STEPS)
    alone, found = problem.segments.lead(*given), problem.segments.propagate(*given)
    assert alone.transition.shape == (len(STEPS), 6, 0)
    assert alone.residual_columns.shape == (1, 3, 0)
    assert np.ptp(found.end, axis=0)[:3].all()
    for name in ("end", "residual", "displacement", "fault"):
        np.testing.assert_array_equal(getattr(alone, name), getattr(found, name), err_msg=name)


def test_what_takes_too_many_steps_is_given_no_more(soft, monkeypatch):
    """Equal ones were doubled until their number overflowed."""
    monkeypatch.setattr(room, "STEPS_ALLOWED", 32)
    monkeypatch.setattr(equilibria, "MOST_EQUAL", 16)
    problem = soft.problem(soft.inputs(tip_force=(1, 2, -1)), integrator=replace(mr.RK45(), rtol=1e-13, atol=1e-15))
    own = {"tolerance": np.array([1e-9]), "max_iterations": 30, "max_steps": 100, "allowed": np.array([1000])}
    paths = SegmentedPaths(problem.segments, np.zeros(1, dtype=int), integrator=problem.integrator, **own)
    results = paths.follow(problem.guess(), problem.load_scale())
    assert results.status.tolist() == [mr.Status.STEP_LIMIT]
    assert results.place.cuts.steps.tolist() == [0]  # by error control, which takes too many as well
    assert paths._fault.tolist() == [Fault.STEP_LIMIT]
    assert paths.integrations[0] < 12


def test_clamped_rods_say_how_many_steps_they_took(soft):
    """Ways from where a branch ends may take so many, and were told of none."""
    problem = soft.problem(soft.inputs(tip_force=(0.1, 0.2, -0.1)), integrator=mr.RK4(96), pose_sensitivities=True)
    part = problem.parts.clamped(np.arange(1), PIECES)
    part.clamps.put(np.zeros((1, part.clamps.size)))
    part.integrate()
    assert part.fault.numpy().tolist() == [0]
    steps = int(part.step_count.numpy()[0])
    assert steps >= 96
    assert steps <= 96 + 2 * PIECES  # each piece begins a step, and ends one
