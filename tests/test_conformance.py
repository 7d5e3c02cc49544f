"""Every registered solver, on every assembly, finds what Newton finds or says that it failed; a solver needs only ``_solve``."""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pytest

import multirod as mr
from multirod.integrators import Integrator
from multirod.problem import TOLERANCE

SOLVERS = mr.registered_solvers()


@dataclass(frozen=True)
class Scene:
    """An assembly and several sets of inputs, each with a batch axis; to cover another assembly, append to ``SCENES``."""

    robot: Callable[[], mr.Assembly]
    inputs: dict[str, dict[str, Any]]


def single_rod() -> mr.SingleRod:
    wire = mr.Rod(
        length=0.4, bending_stiffness=(0.22, 0.25), torsional_stiffness=0.064, precurvature=(14, 5, 0), linear_density=0.03
    )
    pose = np.array([[0, 0, 1, 0.1], [0, 1, 0, 0], [-1, 0, 0, 0.2], [0, 0, 0, 1.0]])
    return mr.SingleRod(wire, base=pose)


def concentric_tubes() -> mr.ConcentricTubes:
    inner = mr.Rod(
        length=0.3, bending_stiffness=0.01, torsional_stiffness=0.008, precurvature=[(0.2, (0, 0, 0)), (0.1, (9, 0, 1))]
    )
    middle = mr.Rod(length=0.24, bending_stiffness=0.02, torsional_stiffness=0.015, precurvature=(4, 2, 0), linear_density=0.02)
    outer = mr.Rod(length=0.12, bending_stiffness=0.05, torsional_stiffness=0.04, precurvature=(2, 0, 0))
    return mr.ConcentricTubes([inner, middle, outer])


def parallel_rods(bend: Any = 1.0) -> mr.ParallelRods:
    bent = np.asarray(bend)[..., None] * np.array([1, 0.4, 0])
    rod = mr.Rod(length=0.3, bending_stiffness=0.02, torsional_stiffness=0.015, precurvature=bent, linear_density=0.05)
    soft = mr.Rod(length=0.31, bending_stiffness=0.02, torsional_stiffness=0.015, shear_stiffness=8.0, axial_stiffness=20.0)
    inner = mr.Rod(length=0.31, bending_stiffness=0.01, torsional_stiffness=0.008, precurvature=(0.5, 0, 0))
    outer = mr.Rod(length=0.2, bending_stiffness=0.02, torsional_stiffness=0.015, precurvature=(1, 1, 0))
    base, platform = np.tile(np.eye(4), (3, 1, 1)), np.tile(np.eye(4), (3, 1, 1))
    angle = 2 * np.pi * np.arange(3) / 3
    base[:, :2, 3] = 0.06 * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    platform[:, :2, 3] = 0.03 * np.stack([np.cos(angle + 0.3), np.sin(angle + 0.3)], axis=1)
    return mr.ParallelRods(
        legs=[rod, soft, mr.ConcentricTubes([inner, outer])],
        base=base,
        platform=platform,
        joints=["clamped", "spherical", "clamped"],
        platform_mass=0.02,
    )


SCENES = {
    "SingleRod": Scene(
        single_rod,
        {
            "unloaded": {"rotation": (0.0, 0.7)},
            "tip force": {"tip_force": [(0, 0.5, 0), (0.5, 0, 0.3)], "rotation": 0.4, "translation": (0.0, -0.15)},
            "all dead loads": {
                "tip_force": (0.3, 0, -0.2),
                "tip_moment": [(0.02, 0, 0.01), (0, 0.02, 0)],
                "distributed_force": (0, 0.3, 0),
                "distributed_moment": (0.02, 0, 0),
                "gravity": (0, 0, -9.81),
            },
            "follower loads": {"follower_force": [(0.3, 0, 0), (0, 0.3, -0.1)], "follower_moment": (0.01, 0.02, 0)},
        },
    ),
    "ConcentricTubes": Scene(
        concentric_tubes,
        {
            "unloaded": {"rotation": [(0, 0.7, 0.2), (0, 1.5, -1.0)], "translation": (-0.06, -0.04, -0.02)},
            "dead loads": {
                "rotation": (0, 0.7, 0.2),
                "translation": [(-0.06, -0.04, -0.02), (-0.02, -0.02, 0)],
                "tip_force": (0.1, 0.05, 0),
                "tip_moment": (0.004, 0, 0.002),
                "gravity": (0, 0, -9.81),
            },
            "follower loads": {"follower_force": [(0.1, 0, 0), (0, 0.1, -0.05)], "follower_moment": (0.002, 0.003, 0)},
        },
    ),
    "ParallelRods": Scene(
        parallel_rods,
        {
            "unloaded": {"rotation": [(0, 0, 0, 0), (0.2, 0, 0.1, -0.3)]},
            "loads": {
                "tip_force": [(0.1, 0, 0), (0, 0.1, -0.2)],
                "follower_moment": (0.003, 0, 0),
                "gravity": (0, 0, -9.81),
                "distributed_moment": (0.002, 0, 0.001),
                "translation": (0.005, -0.005, -0.02, -0.01),
            },
        },
    ),
}
CASES = [pytest.param(scene, inputs, id=f"{scene}-{inputs}") for scene, given in SCENES.items() for inputs in given.inputs]


def reach(solver: mr.Solver) -> float:
    """Largest residual that a result of this solver may have, as its options say [1/m]."""
    given = getattr(solver, "max_residual", solver.tolerance)
    return TOLERANCE if given is None else given


def problem_for(solver: mr.Solver, robot: mr.Assembly, inputs: mr.Inputs) -> mr.BoundaryProblem:
    """With the columns that the solver needs, which have a part in the control of steps."""
    return robot.problem(
        inputs,
        integrator=solver.integrator,
        pose_sensitivities=solver.pose_sensitivities,
        direction_count=solver.direction_count,
    )


def residual(robot: mr.Assembly, inputs: mr.Inputs, solution: mr.Solution, solver: mr.Solver) -> np.ndarray:
    """Residual at the solution's unknowns, evaluated anew."""
    return problem_for(solver, robot, inputs).evaluate(solution.unknowns.reshape(-1, solution.unknown_count))[0]


def test_own_solvers_are_registered() -> None:
    own = {
        "shooting": mr.Shooting,
        "multiple_shooting": mr.MultipleShooting,
        "scipy_shooting": mr.ScipyShooting,
        "observer": mr.Observer,
        "energy_descent": mr.EnergyDescent,
    }
    assert own.items() <= SOLVERS.items()
    assert all(issubclass(solver, mr.Solver) for solver in SOLVERS.values())


@pytest.mark.parametrize(("scene", "given"), CASES)
@pytest.mark.parametrize("name", SOLVERS)
def test_solver_finds_the_equilibrium_or_says_that_it_failed(name: str, scene: str, given: str) -> None:
    robot = SCENES[scene].robot()
    inputs = robot.inputs(**SCENES[scene].inputs[given])
    truth = mr.solve(robot, inputs, solver=mr.Shooting()).raise_if_failed()
    solver = SOLVERS[name]()
    if solver.unsupported(problem_for(solver, robot, inputs)):
        with pytest.raises(ValueError, match="cannot take this problem"):
            mr.solve(robot, inputs, solver=solver)
        return
    solution = mr.solve(robot, inputs, solver=solver)
    there = residual(robot, inputs, truth, solver)
    assert solution.status.shape == inputs.batch_shape
    assert (solution.integrations >= 1).all()
    for k, status in enumerate(solution.status):
        if mr.Status(status).failed:
            assert np.isnan(solution.unknowns[k]).all()
            assert np.isnan(solution.tip_position[k]).all()
            continue
        assert status == mr.Status.CONVERGED
        eps = residual(robot, inputs, solution, solver)[k]
        assert np.abs(eps).max() <= reach(solver) * (1 + 1e-6)
        np.testing.assert_allclose(np.abs(eps).max(), solution.residual[k], rtol=1e-6, atol=1e-11)
        # to first order x - x_truth = Gamma^-1 (eps - eps_truth); twice that allows for the second order
        distance = np.linalg.norm(solution.unknowns[k] - truth.unknowns[k])
        norm = np.linalg.norm(eps) + np.linalg.norm(there[k])
        assert distance <= 2 * norm / truth.smallest_singular_value[k] + 1e-12


@pytest.mark.parametrize("name", SOLVERS)
def test_no_own_solver_fails_on_an_easy_load(name: str) -> None:
    robot = single_rod()
    mr.solve(robot, robot.inputs(**SCENES["SingleRod"].inputs["tip force"]), solver=SOLVERS[name]()).raise_if_failed()


@pytest.mark.parametrize("name", SOLVERS)
def test_buffers_hold_what_the_outcome_reports(name: str) -> None:
    robot = single_rod()
    inputs = robot.inputs(**SCENES["SingleRod"].inputs["tip force"])
    solver = SOLVERS[name]()
    problem = problem_for(solver, robot, inputs)
    outcome = solver.solve(problem)
    # pose, residual and Gamma are those of the unknowns of the same record, not of a trial before or after
    held = {field: problem.read(field) for field in ("unknowns", "residual", "gamma", "position", "rotation")}
    assert (problem.active.numpy() == 1).all()
    np.testing.assert_array_equal(problem.load_factor.numpy(), 1.0)
    for buffer in (problem.residual, problem.gamma, problem.position, problem.rotation):
        buffer.fill_(np.nan)
    problem.write("unknowns", held["unknowns"])
    problem.integrate()
    for name_, values in held.items():
        np.testing.assert_array_equal(problem.read(name_), values)
    assert len(outcome.status) == problem.instance_count


@pytest.mark.parametrize("name", SOLVERS)
def test_a_track_leaves_loads_and_instances_as_they_were(name: str) -> None:
    """So that whoever integrates the problem between two samples integrates all of it."""
    robot = single_rod()
    inputs = robot.inputs(**SCENES["SingleRod"].inputs["tip force"])
    solver = SOLVERS[name]()
    problem = problem_for(solver, robot, inputs)
    track = solver.track(problem, 0.01)
    for _ in range(2):
        track.step()
        for buffer in (problem.active, problem.load_factor):
            np.testing.assert_array_equal(buffer.numpy(), 1)
        assert problem.listed == problem.instance_count


def test_branches_of_legs_of_several_builds_are_followed_at_the_steps_of_the_leg_that_is_bent_most() -> None:
    robot = parallel_rods(bend=np.array([1.0, 30.0]))
    problem = problem_for(mr.Shooting(), robot, robot.inputs())
    assert problem.parts is not None
    assert [kind.tolist() for kind in problem.parts.kinds(np.arange(2))] == [[0], [1]]


@dataclass(frozen=True, kw_only=True)
class Broyden(mr.Solver):
    """A third party's solver: nothing but ``_solve``, in NumPy, through ``evaluate``."""

    integrator: Integrator = field(default_factory=mr.RK45)
    tolerance: float = 1e-9

    def _solve(self, problem: mr.BoundaryProblem, guess: np.ndarray | None) -> mr.Outcome:
        outcome = mr.Outcome.zeros(problem.instance_count)
        x = problem.guess() if guess is None else np.array(guess)
        for _ in range(50):
            eps, gamma = problem.evaluate(x)
            outcome.integrations += 1
            done = np.abs(eps).max(axis=1) <= self.tolerance
            outcome.status[done] = mr.Status.CONVERGED
            if done.all():
                break
            outcome.iterations += ~done
            x = np.where(done[:, None], x, x - np.linalg.solve(gamma, eps[..., None])[..., 0])
        outcome.status[outcome.status == mr.Status.NOT_RUN] = mr.Status.MAX_ITERATIONS
        return outcome


def test_a_solver_needs_only_solve() -> None:
    robot = single_rod()
    solver = Broyden()
    angle = np.linspace(0, 0.2, 6)
    force = np.stack([0.3 * np.ones(6), np.sin(angle), 0 * angle], axis=-1)
    inputs = robot.inputs(rotation=angle, tip_force=force)
    truth = mr.solve(robot, inputs, solver=mr.Shooting()).raise_if_failed()

    solution = mr.solve(robot, inputs, solver=solver).raise_if_failed()
    np.testing.assert_allclose(solution.unknowns, truth.unknowns, rtol=0, atol=1e-8)
    assert (mr.solve(robot, inputs, solver=solver, guess=solution).integrations == 1).all()

    history = mr.simulate(robot, inputs, time=0.01 * np.arange(6), solver=solver).raise_if_failed()
    np.testing.assert_allclose(history.unknowns, truth.unknowns, rtol=0, atol=1e-8)
    still = mr.simulate(robot, inputs[0], time=0.01 * np.arange(3), solver=solver)
    assert still.integrations.tolist()[1:] == [1, 1]  # each sample starts from the last
    guessed = mr.simulate(robot, inputs, time=0.01 * np.arange(6), solver=solver, guess=truth.unknowns[0])
    assert guessed.integrations[0] == 1

    tracker = mr.Tracker(robot, solver=solver, dt=0.01)
    for k in range(6):
        step = tracker.step(rotation=angle[k], tip_force=force[k])
        np.testing.assert_allclose(step.unknowns, truth.unknowns[k], rtol=0, atol=1e-8)


@pytest.mark.filterwarnings("ignore::multirod.PlausibilityWarning")
def test_a_solver_that_fails_in_one_instance_keeps_its_last_good_start() -> None:
    robot = single_rod()
    force = np.tile((0.3, 0.2, 0.0), (4, 2, 1))
    force[2, 1] = (0, 3e9, 0)

    class Careful(Broyden):
        def _solve(self, problem: mr.BoundaryProblem, guess: np.ndarray | None) -> mr.Outcome:
            starts.append(None if guess is None else guess.copy())
            return super()._solve(problem, guess)

    starts: list[Any] = []
    with np.errstate(all="ignore"):
        history = mr.simulate(robot, robot.inputs(tip_force=force), time=0.01 * np.arange(4), solver=Careful())
    assert history.status.tolist() == [[1, 1], [1, 1], [1, 2], [1, 1]]
    assert np.isnan(history.tip_position[2, 1]).all()
    assert np.isfinite(history.tip_position[2, 0]).all()
    assert starts[0] is None
    assert np.array_equal(starts[3][1], history.unknowns[1, 1])
    assert np.array_equal(starts[3][0], history.unknowns[2, 0])


def test_unsupported_problems_are_refused_with_every_reason() -> None:
    class Choosy(Broyden):
        def unsupported(self, problem: mr.BoundaryProblem) -> tuple[str, ...]:
            return ("it is too long", f"it has {problem.unknown_count} unknowns")

    robot = single_rod()
    for call in (
        lambda: mr.solve(robot, solver=Choosy()),
        lambda: mr.simulate(robot, robot.inputs(), time=[0.0, 0.1], solver=Choosy()),
        lambda: mr.Tracker(robot, solver=Choosy(), dt=0.1),
    ):
        with pytest.raises(ValueError, match="Choosy cannot take this problem: it is too long; it has 3 unknowns"):
            call()
