"""Motions whose samples are not evenly spaced, as recordings are."""

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
import pytest

import multirod as mr
from multirod.solvers.tracking.foretold import respaced
from multirod.solvers.tracking.newton_track import NewtonTrack
from multirod.solvers.tracking.sampled import SampledTrack
from multirod.validation import FloatArray

STEPS = mr.RK4(50)
NEWTON = mr.Shooting(integrator=STEPS)


def uneven(count: int, step: float = 5e-3, most: float = 3.0) -> FloatArray:
    """Times whose steps go from one ``step`` to ``most`` of them and back, with some in between."""
    ratio = np.random.default_rng(3).uniform(1.0, most, count - 1)
    return step * np.concatenate([[0.0], np.cumsum(ratio)])


@pytest.fixture(scope="module")
def robot() -> mr.SingleRod:
    return mr.SingleRod(mr.Rod(length=0.4, bending_stiffness=0.2233, torsional_stiffness=0.0638, precurvature=(14, 5, 0)))


def moved(robot: mr.SingleRod, time: FloatArray) -> mr.Inputs:
    force = np.stack([np.sin(2 * time), np.cos(2 * time) - 1, np.sin(time)], axis=-1)
    return robot.inputs(rotation=time, tip_force=force)


def test_newtons_method_finds_at_uneven_times_what_a_solve_does(robot: mr.SingleRod) -> None:
    time = uneven(60)
    history = mr.simulate(robot, moved(robot, time), time=time, solver=NEWTON)
    alone = mr.solve(robot, moved(robot, time), solver=NEWTON)
    assert (history.status == mr.Status.CONVERGED).all()
    # both to the tolerance of some 1e-9 1/m, on a rod of 0.4 m
    assert np.allclose(history.tip_position, alone.tip_position, rtol=0, atol=1e-8)
    assert np.array_equal(history.time, time)


def test_a_gap_is_not_foretold_across(robot: mr.SingleRod) -> None:
    time = np.concatenate([uneven(10), 3.0 + uneven(10)])
    history = mr.simulate(robot, moved(robot, time), time=time, solver=NEWTON)
    alone = mr.solve(robot, moved(robot, time), solver=NEWTON)
    assert np.allclose(history.tip_position, alone.tip_position, rtol=0, atol=1e-8)


def test_what_is_foretold_goes_by_time(robot: mr.SingleRod, monkeypatch: pytest.MonkeyPatch) -> None:
    time = uneven(100)
    by_time = mr.simulate(robot, moved(robot, time), time=time, solver=NEWTON).integrations.sum()
    monkeypatch.setattr(NewtonTrack, "pace", lambda self, before, after: None)
    by_number = mr.simulate(robot, moved(robot, time), time=time, solver=NEWTON).integrations.sum()
    assert by_time < 0.8 * by_number  # measured 0.66


@pytest.mark.parametrize(("points", "degree"), [(2, 1), (3, 2)])
def test_respaced_samples_are_those_of_the_polynomial(points: int, degree: int) -> None:
    """(6b) of ``docs/solvers.md``."""
    rng = np.random.default_rng(0)
    factors = rng.normal(size=(degree + 1, 1, 4))
    back = np.arange(3.0)[:, None, None]
    past = sum(factor * (-back) ** k for k, factor in enumerate(factors))
    asked = sum(factor * (-1.7 * back) ** k for k, factor in enumerate(factors))
    found = respaced(np.moveaxis(past, 0, 1), points, 1.7)
    assert np.allclose(found, np.moveaxis(asked, 0, 1), rtol=1e-13)


OBSERVERS: dict[str, tuple[dict[str, Any], int]] = {
    "exact": ({}, 1),
    "euler": ({"update": "euler"}, 1),
    "horizon": ({"riccati": "horizon"}, 1),
    "plain coupling, by LAPACK": ({"coupling": "per-rod-plain"}, 2),
}


@pytest.mark.parametrize("name", OBSERVERS)
def test_the_observer_steps_by_the_time_to_the_next_sample(name: str, robot: mr.SingleRod) -> None:
    """What a sample leads to is what it leads to at even times of that step."""
    options, rods = OBSERVERS[name]
    whole: Any = robot
    if rods > 1:
        outer = mr.Rod(length=0.3, bending_stiffness=0.3, torsional_stiffness=0.2, precurvature=(4, 0, 0))
        whole = mr.ConcentricTubes([robot.rods[0], outer])
    time = uneven(6)
    inputs = whole.inputs(tip_force=np.stack([time, 2 * time, 0 * time], axis=-1))
    solver = mr.Observer(R=120, Q=30, integrator=STEPS, **options)
    history = mr.simulate(whole, inputs, time=time, solver=solver)
    for k, step in enumerate(np.diff(time)):
        again = mr.simulate(whole, inputs[k : k + 2], time=[0.0, step], solver=solver, guess=history.unknowns[k])
        assert np.allclose(again.unknowns[1], history.unknowns[k + 1], rtol=1e-10, atol=1e-10)


def test_the_riccati_equation_is_integrated_by_the_time_to_the_next_sample(robot: mr.SingleRod) -> None:
    """Forward in time its steps add up: at fixed inputs and unknowns at rest, by any steps it tends to the same."""
    solver = mr.Observer(R=120, Q=30, riccati="forward", integrator=STEPS)
    rest = mr.solve(robot, solver=NEWTON).unknowns
    found = []
    for time in (np.array([0.0, 1e-3, 3e-3, 3.5e-3]), np.array([0.0, 5e-4, 3.5e-3])):
        history = mr.simulate(robot, robot.inputs(), time=time, solver=solver, guess=rest)
        assert history.rates is not None
        found.append(history.rates[-1])
    assert np.allclose(*found, rtol=1e-8)
    assert not np.allclose(found[0], history.rates[0], rtol=1e-3)


FED = [(mr.Observer(feed_forward=True, integrator=STEPS), 0.3), (mr.EnergyDescent(integrator=STEPS), 0.9)]  # 0.16, 0.72 measured


@pytest.mark.parametrize(("solver", "part"), FED, ids=["observer", "energy descent"])
def test_what_is_fed_forward_goes_by_time(
    robot: mr.SingleRod, solver: mr.Solver, part: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """(12b): a fraction of the error that it leaves by the number of samples; what is left is of second order in their step."""
    time = uneven(150, step=2e-3)
    inputs = moved(robot, time)
    right = mr.simulate(robot, inputs, time=time, solver=NEWTON).unknowns

    def off() -> float:
        found = mr.simulate(robot, inputs, time=time, solver=solver, guess=right[0]).unknowns
        return float(np.abs(found - right)[100:].max())

    by_time = off()
    apart = SampledTrack.pace
    monkeypatch.setattr(SampledTrack, "pace", lambda self, before, after: apart(self, 1.0, 1.0))
    assert by_time < part * off()


@dataclass(frozen=True)
class OneStep(mr.Solver):
    """One that goes by a time step, and does not say that it takes others."""

    integrator: mr.Integrator = STEPS
    needs_dt: ClassVar[bool] = True

    def _solve(self, problem: Any, guess: FloatArray | None) -> Any:
        return NEWTON._solve(problem, guess)


def test_a_solver_of_one_step_refuses_others(robot: mr.SingleRod) -> None:
    assert mr.simulate(robot, robot.inputs(), time=[0.0, 0.1, 0.2], solver=OneStep()).status.all() == mr.Status.CONVERGED
    with pytest.raises(ValueError, match=r"^time = .* is not allowed: must be evenly spaced, by OneStep, which goes by one step"):
        mr.simulate(robot, robot.inputs(), time=[0.0, 0.1, 0.3], solver=OneStep())
