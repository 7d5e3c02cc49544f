"""Whatever a solve does, it ends within ``max_integrations`` of a rod, and says so where that is why it ended."""

from types import SimpleNamespace

import numpy as np
import pytest
import random_scenes
from random_motions import DURATION, draw

import multirod as mr
from multirod.budget import Budget, Spent
from multirod.solver import Outcome
from multirod.solvers.energy_descent import EnergyDescentTrack
from multirod.solvers.following import onward
from multirod.solvers.following.follow import follow
from multirod.solvers.newton.iteration import Newton
from multirod.status import Fault, Status

CHECKS = 10  # integrations on top, that judge a result or tell what is left of the residual
LIMIT = mr.Status.INTEGRATION_LIMIT


@pytest.fixture(scope="module")
def wire() -> mr.SingleRod:
    return mr.SingleRod(mr.Rod(length=0.4, bending_stiffness=0.02, torsional_stiffness=0.015, precurvature=(14, 5, 0)))


@pytest.fixture(scope="module")
def tubes() -> mr.ConcentricTubes:
    """Two tubes far beyond where they snap."""
    tube = mr.Rod(length=1.0, bending_stiffness=1.0, torsional_stiffness=1.0, precurvature=(3.0, 0, 0))
    return mr.ConcentricTubes([tube, tube])


def refused(solution: mr.Solution, limit: int) -> None:
    assert solution.status == LIMIT
    assert solution.status.failed
    assert limit <= solution.integrations <= limit + CHECKS
    for name in ("unknowns", "tip_position", "tip_rotation", "energy"):
        assert np.isnan(getattr(solution, name)).all()
    with pytest.raises(mr.SolveError, match="raise max_integrations"):
        solution.raise_if_failed()


@pytest.mark.parametrize("limit", [1, 2, 7, 30])
def test_the_natural_branch(wire: mr.SingleRod, limit: int) -> None:
    """Its 40 integrations and more end anywhere: at its start, within a step, between two."""
    inputs = wire.inputs(tip_force=(0, 5.0, 0))
    free = mr.solve(wire, inputs).raise_if_failed()
    assert free.integrations > 30
    refused(mr.solve(wire, inputs, solver=mr.Shooting(max_integrations=limit)), limit)


def test_just_enough_changes_nothing(wire: mr.SingleRod) -> None:
    inputs = wire.inputs(tip_force=(0, 5.0, 0))
    free = mr.solve(wire, inputs)
    enough = mr.solve(wire, inputs, solver=mr.Shooting(max_integrations=int(free.integrations)))
    assert enough.status == mr.Status.CONVERGED
    np.testing.assert_array_equal(enough.unknowns, free.unknowns)
    assert enough.integrations == free.integrations


def test_from_a_guess(wire: mr.SingleRod) -> None:
    inputs, guess = wire.inputs(tip_force=(0, 10.0, 0)), (0, 20, 0)
    assert mr.solve(wire, inputs, guess=guess).integrations > 3
    refused(mr.solve(wire, inputs, guess=guess, solver=mr.Shooting(max_integrations=3)), 3)


def test_the_search_for_the_lowest_energy(tubes: mr.ConcentricTubes) -> None:
    """It ends before a round of starts that it might not finish: what fewer starts find need not be the lowest."""
    inputs = tubes.inputs(rotation=(0, 6.0))
    free = mr.solve(tubes, inputs)
    assert free.status == mr.Status.LOWEST_ENERGY
    limited = mr.solve(tubes, inputs, solver=mr.Shooting(max_integrations=1000))
    assert limited.status == LIMIT
    assert limited.integrations <= 1000 + CHECKS
    assert np.isnan(limited.unknowns).all()


def test_multiple_shooting_as_a_fallback_and_alone() -> None:
    rod = mr.SingleRod(mr.Rod(length=0.4, bending_stiffness=0.02, torsional_stiffness=0.015))
    inputs = rod.inputs(tip_force=(60.0, 0.0, 0.0))
    free = mr.solve(rod, inputs)
    assert free.status == mr.Status.MULTIPLE_SHOOTING
    # before the natural branch creeps, and just after it is handed over
    for limit in (30, 70):
        refused(mr.solve(rod, inputs, solver=mr.Shooting(max_integrations=limit)), limit)
    # within the last steps: as soon as these are more than are left
    limited = mr.solve(rod, inputs, solver=mr.Shooting(max_integrations=int(free.integrations) - 40))
    refused(limited, int(limited.integrations) - 1)
    assert limited.integrations <= free.integrations - 40 + CHECKS
    for guess in (None, (0.0, 40.0, 0.0)):
        refused(mr.solve(rod, inputs, guess=guess, solver=mr.MultipleShooting(max_integrations=5)), 5)


def test_a_sample_of_a_motion(wire: mr.SingleRod) -> None:
    """A jump that only many steps of the inputs can follow; the sample after it, back where the first was, starts from there."""
    force = np.array([(0, 1.0, 0), (0, 5.0, 0), (0, 1.0, 0)])
    inputs, time = wire.inputs(tip_force=force), np.arange(3)
    free = mr.simulate(wire, inputs, time=time)
    assert free.status.tolist() == [1, 1, 1]
    limit = int(free.integrations[0])
    assert free.integrations[1] > limit
    limited = mr.simulate(wire, inputs, time=time, solver=mr.Shooting(max_integrations=limit))
    assert limited.status.tolist() == [1, LIMIT, 1]
    assert limit <= limited.integrations[1] <= limit + CHECKS


@pytest.mark.parametrize("solver", [mr.Shooting, mr.MultipleShooting])
def test_a_motion_that_multiple_shooting_cannot_resume_counts_both_ways(solver: type) -> None:
    """A sample that loses its branch is solved anew: together they take no more than one sample may."""
    rod = mr.SingleRod(mr.Rod(length=0.4, bending_stiffness=0.02, torsional_stiffness=0.015))
    force = np.array([(60.0, 0, 0), (0, 60.0, 0), (0, 0, 60.0)])
    solver = solver(max_integrations=300)
    history = mr.simulate(rod, rod.inputs(tip_force=force), time=np.arange(3), solver=solver)
    assert (history.integrations <= 300 + CHECKS).all()


@pytest.mark.parametrize("limit", [5, 20])
def test_energy_descent_takes_an_integration_a_sample(wire: mr.SingleRod, limit: int) -> None:
    for guess in (None, (0, 20, 0)):
        solution = mr.solve(wire, wire.inputs(tip_force=(0, 5.0, 0)), solver=mr.EnergyDescent(max_iterations=limit), guess=guess)
        assert solution.status.failed
        assert solution.integrations <= limit + 1
        assert np.isnan(solution.unknowns).all()


def test_the_others_of_a_batch_are_unaffected(wire: mr.SingleRod) -> None:
    force = np.array([(0, 5.0, 0), (0, 0.1, 0), (0.2, 0.1, 0)])
    free = mr.solve(wire, wire.inputs(tip_force=force))
    limited = mr.solve(wire, wire.inputs(tip_force=force), solver=mr.Shooting(max_integrations=12))
    assert limited.status.tolist() == [LIMIT, 1, 1]
    np.testing.assert_array_equal(limited.unknowns[1:], free.unknowns[1:])


def test_legs() -> None:
    leg = mr.Rod(length=0.4, bending_stiffness=0.02, torsional_stiffness=0.015)
    pose = np.tile(np.eye(4), (3, 1, 1))
    pose[:, :2, 3] = 0.1 * np.array([(np.cos(a), np.sin(a)) for a in 2 * np.pi * np.arange(3) / 3])
    robot = mr.ParallelRods(legs=[leg] * 3, base=pose, platform=0.5 * pose + 0.5 * np.eye(4))
    inputs = robot.inputs(tip_force=(0.2, 0.1, 0))
    assert mr.solve(robot, inputs).raise_if_failed().integrations > 4
    limited = mr.solve(robot, inputs, solver=mr.Shooting(max_integrations=4))
    assert limited.status == LIMIT
    assert limited.integrations <= 4 + CHECKS


def test_what_a_study_may_take_is_spent_by_all_that_integrates(wire: mr.SingleRod, tubes: mr.ConcentricTubes) -> None:
    """Of few instances a kernel repeats integrations by itself: not where they are counted."""
    for robot, inputs in ((wire, wire.inputs(tip_force=(0, 5.0, 0))), (tubes, tubes.inputs(tip_force=(0, 0.1, 0)))):
        problem = robot.problem(inputs, integrator=mr.RK45())
        problem.budget = Budget(5)
        with pytest.raises(Spent):
            mr.Shooting().solve(problem)


@pytest.mark.parametrize(("place", "name"), [("serving.together", "MOST_STEPS"), ("follow", "SINGLE_STEPS")])
def test_damped_dynamics_take_their_part_of_the_steps_of_a_way(place: str, name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """They were counted as one integration, however many they took."""
    robot = mr.SingleRod(mr.Rod(length=0.5, bending_stiffness=(0.04, 0.02), torsional_stiffness=0.015))
    inputs = robot.inputs(tip_force=(0, 0, -1.5 * np.pi**2 / 4 * 0.02 / 0.5**2), tip_moment=(0, 0, 4e-8))
    solver = mr.Shooting(integrator=mr.RK4(50))
    whole = mr.solve(robot, inputs, solver=solver)
    assert whole.status is mr.Status.DAMPED
    assert whole.integrations > 140
    monkeypatch.setattr(
        f"multirod.solvers.following.{place}.{name}", 50 * 90
    )  # ninety integrations, of the 98 that the way takes
    part = mr.solve(robot, inputs, solver=solver)
    assert part.status is mr.Status.INTEGRATION_LIMIT
    assert part.integrations < 120  # some 60 to where the branch ends


class Halved:
    """A slope down which steps are short enough from a part on, and that nothing comes to rest on."""

    facing, drive, back, values, modes, along = 1.0, 0.0, np.zeros(1), np.ones(1), np.eye(1), np.ones(1)

    def __init__(self, part: float) -> None:
        self.part = part

    def turn(self, radius: float) -> np.ndarray:
        self.radius = radius
        return np.array([radius])

    def change(self, turn: np.ndarray) -> np.ndarray:
        return turn

    def missed(self, turn: np.ndarray, found: "Halved") -> float:
        return 0.0 if abs(turn[0]) <= self.part * self.radius else np.inf


@pytest.mark.parametrize(("part", "most"), [(1.0, 400), (0.25, 400), (0.125, 50), (1e-3, 50)])
def test_a_descent_is_given_up_whose_steps_lead_nowhere(part: float, most: int) -> None:
    """(17) of docs/branches.md: 4 of 50 integrations at a quarter of a step each, 1.5 at an eighth."""
    from multirod.solvers.following.downhill import in_steps
    from multirod.solvers.following.walk import Walk

    taken = []

    class Down(Walk):
        def __init__(self) -> None:
            self.within, self.valley, self.iterations = 0.0, False, 0

        def at(self, unknowns, level):
            taken.append(unknowns)
            yield
            return SimpleNamespace(unknowns=unknowns, level=level, size=1.0, periods=np.zeros(0))

        def slope_or_none(self, point):
            return Halved(part)

    start = SimpleNamespace(unknowns=np.zeros(1), level=1.0, size=1.0, periods=np.zeros(0))
    assert list(in_steps(Down(), start, Halved(part), np.zeros(1)))[-1] is None
    assert len(taken) == most


@pytest.mark.parametrize(("start", "there"), [(1.0, True), (20.0, True), (np.nan, False)])
def test_other_equations_lead_to_their_own_by_parts_of_steps(start: float, there: bool) -> None:
    """(22) of docs/branches.md: Newton's whole steps on an arc tangent lead ever farther off from 1.4 on, from 20 by 600."""
    from multirod.solvers.following.serving.many import LED, led_to

    looks = []

    def at(x, level):
        looks.append(x)
        residual, gamma = np.arctan(2 * x), np.diag(2 / (1 + 4 * x**2))
        return SimpleNamespace(unknowns=x, residual=residual, gamma=gamma, size=float(np.abs(residual).max()))
        yield  # as what asks for integrations does

    with pytest.raises(StopIteration) as end:
        next(led_to(at, np.array([start]), 1e-9))
    assert (end.value.value is not None) == there
    assert len(looks) <= LED + 1
    if there:
        assert abs(end.value.value.unknowns[0]) < 1e-9


def test_a_branch_is_given_up_whose_pace_would_not_do() -> None:
    """(18) of docs/branches.md, after 500 of 1000 steps: the rest is half, and may take 1000 of them."""
    from multirod.solvers.following.serving.many import _Traces

    walk = _Traces.__new__(_Traces)
    walk.levels, walk.most, walk.taken = np.full((3, 1), 0.5), np.full(3, 1000), np.full(3, 500)
    walk.passed, walk.on = 0.5 - np.array([0.049, 0.051, 0.0]), np.ones(3, dtype=bool)
    walk._give_up(np.arange(2))
    assert walk.on.tolist() == [False, True, True]
    np.testing.assert_array_equal(walk.passed, [0.5, 0.5, 0.5])


def test_an_integration_whose_steps_no_longer_lead_on_ends() -> None:
    """Where a line's law gives out, steps became shorter than rounding and were taken, 65,536 of them."""
    lines = [mr.Tendon((x, 0), driven="displacement", axial_stiffness=200.0) for x in (0.006, -0.006)]
    rod = mr.Rod(length=0.1943, bending_stiffness=0.01, torsional_stiffness=0.0077, axial_stiffness=2000.0, lines=lines)
    end = np.eye(4)
    end[:3, 3] = 0.02, 0, 0.19
    robot = mr.HeldRod(rod, end=end)
    problem = robot.problem(robot.inputs(displacement=3e-4), integrator=mr.RK45())
    force = (-26.974505721677236, 46.74682786290613, 514.8505825439034)
    problem.evaluate(np.array([[0, 33.19200644341869, 0, *force, 0, 2695.1995236024986]]))
    assert problem.fault.numpy() == Fault.STRAIN_LAW
    assert problem.step_count.numpy() < 1000


def test_damped_dynamics_end_after_so_many_steps_along_the_rod():
    robot = mr.SingleRod(mr.Rod(length=0.3, bending_stiffness=0.02, torsional_stiffness=0.015, precurvature=(4, 0, 0)))
    method = mr.EnergyDescent(integrator=mr.RK4(50), feed_forward=False)
    inputs = robot.inputs(tip_force=np.array([[0.4, 0, 0.2], [0.8, 0, 0]]))

    def settled(most: tuple[int, int] | None) -> tuple[Outcome, np.ndarray, np.ndarray]:
        problem = robot.problem(inputs, integrator=method.integrator, pose_sensitivities=True)
        track = EnergyDescentTrack(method, problem, corrected=False)
        steps = None if most is None else np.array(most)
        outcome = track.settle(tolerance=None, max_iterations=200, ramp=1, guess=problem.guess(), most_steps=steps)
        return outcome, problem.read("unknowns"), track.integrator_steps

    free, found, _ = settled(None)
    assert (free.status == Status.CONVERGED).all()
    needed = int(50 * free.integrations[1])
    outcome, unknowns, steps = settled((100, needed))
    assert outcome.status.tolist() == [Status.INTEGRATION_LIMIT, Status.CONVERGED]
    assert outcome.integrations.tolist() == [3, free.integrations[1]]  # the first over 100
    assert steps.tolist() == [150, needed]
    np.testing.assert_array_equal(unknowns[1], found[1])


def test_what_nothing_kept_from_going_on_is_not_followed_again(monkeypatch: pytest.MonkeyPatch) -> None:
    """Beyond the end of a branch, by segments too, which lose it: the same way was gone twice."""
    scene = random_scenes.draw("force", 20093)
    ways = []
    monkeypatch.setattr(onward, "follow", lambda *given, **named: ways.append(named["loud"]) or follow(*given, **named))
    assert mr.solve(scene.robot, scene.inputs).status is mr.Status.BRANCH_END
    assert ways == [onward.LOUD]


@pytest.mark.parametrize("count", [1, 20])
def test_a_sample_that_is_solved_again_anyway_is_not_sought_among_wild_shapes(monkeypatch, count):
    """The end of a held rod jumps by a tenth of its motion: for 134 integrations Newton's method wound it, by 18,953
    to 65,536 steps of the integrator each, where it began with 210, and none of that was used."""
    motion = draw("held", 2, seed=77)
    time = np.linspace(0, DURATION, 12)[:6]
    inputs = {name: np.repeat(values[:, None], count, axis=1) for name, values in motion.at(time).items()}
    again = mr.simulate(motion.robot, motion.robot.inputs(**inputs), time=time, progress=False).raise_if_failed()
    monkeypatch.setattr(Newton, "give_up_wild", lambda newton, those: None)
    inputs = {name: values[:, 0] for name, values in inputs.items()}
    before = mr.simulate(motion.robot, motion.robot.inputs(**inputs), time=time, progress=False).raise_if_failed()
    np.testing.assert_array_equal(again.unknowns, np.broadcast_to(before.unknowns[:, None], again.unknowns.shape))
    assert (again.integrations <= before.integrations[:, None]).all()
    assert before.integrations[4] > 5 * again.integrations[4].max()
