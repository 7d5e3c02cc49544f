"""Concentric tubes end on their natural branch, or say that it ends: against small steps and the second variation."""

from itertools import pairwise

import numpy as np
import pytest
from benchmarks import natural_branch as study

import multirod as mr
from multirod.models.backbone.passes.lane_pass import LanePass
from multirod.solvers.continuation.natural import natural_branch
from multirod.solvers.continuation.pace import Pace
from multirod.solvers.continuation.paths import Paths
from multirod.status import Status

SCENES = {"two tubes": 120, "two tubes, tip force": 60, "two tubes, weight": 30, "three tubes": 60, "three tubes, tip force": 40}


@pytest.mark.parametrize("kind", SCENES)
def test_random_scenes_end_where_small_steps_lead(kind):
    found = study.judge(kind, SCENES[kind], seed=100)
    for flag in ("wrong", "unstable", "lost", "undecided", "reference unstable"):
        assert not found[flag].any(), (flag, np.flatnonzero(found[flag]))
    # most reach the end, and some do not: there is something to tell
    assert 0.5 < found["reached"].mean() < 1.0


# turned by two turns, nearly in line again: Newton's method contracts at once from straight tubes, and half of it is no surprise
TWO_TURNS = ("two tubes", 9, 176)
# another stable branch, which the ends of a step do not tell from this one
SNAPPED, OTHER = ("two tubes", 0, 196), ("three tubes", 2, 188)
# off the branch, if Gamma halfway is asked alone
OFF = ("three tubes", 7, 136)


@pytest.mark.parametrize(("kind", "seed", "place"), [TWO_TURNS, SNAPPED, OTHER, OFF])
def test_scenes_that_fewer_tests_lose(kind, seed, place):
    robot, inputs = study.draw(kind, 250, seed)
    problem = robot.problem(inputs, integrator=study.INTEGRATOR).parts.of(np.array([place]))
    newton = mr.Shooting(integrator=study.INTEGRATOR).newton(problem)
    outcome = natural_branch(problem, newton, 1000)
    unknowns = problem.read("unknowns")
    truth = study.reference(problem)
    assert truth.agreed.all()
    if (truth.level < 1).any():
        assert outcome.status[0] == Status.BRANCH_END
    else:
        assert outcome.status[0] == Status.CONVERGED
        assert study.alike(unknowns, truth.unknowns).all()


@pytest.mark.parametrize(("kind", "seed"), [("two tubes", 9), ("three tubes", 2)])
@pytest.mark.parametrize("tolerance", [1e-4, 1e-2])
def test_a_loose_tolerance_leads_along_the_same_branches(kind, seed, tolerance):
    """What is within it by chance tells nothing of the branch: a sixth to a third of these were STALLED, folds among them."""
    robot, inputs = study.draw(kind, 250, seed)
    close, loose = (
        mr.solve(robot, inputs, solver=mr.Shooting(integrator=study.INTEGRATOR, tolerance=given, at_fold="stop"))
        for given in (None, tolerance)
    )
    assert (close.status == Status.CONVERGED).mean() > 0.7
    assert (close.status == Status.BRANCH_END).any()
    assert (loose.status == close.status).all()
    # an equilibrium is off by the tolerance times Gamma's inverse, at most; here paths end as they do by default
    np.testing.assert_allclose(loose.tip_position, close.tip_position, atol=1e-6)
    assert loose.integrations.sum() <= 1.05 * close.integrations.sum()


def test_the_whole_load_at_once_where_newton_contracts_slowly():
    """Equilibria at the quarters of the way say that it is one branch; a step that is halved takes 12 integrations or more."""
    random, count = np.random.default_rng(0), 60
    data = [(0.00387, 0.00301, 0.431, 0.103, 9.0), (0.01717, 0.01402, 0.332, 0.113, 6.0), (0.03977, 0.05022, 0.174, 0.134, 3.5)]
    rods = [
        mr.Rod(length=L, bending_stiffness=EI, torsional_stiffness=GJ, precurvature=[(L - c, (0, 0, 0)), (c, (k, 0, 0))])
        for EI, GJ, L, c, k in data
    ]
    robot = mr.ConcentricTubes(rods)
    rotation = np.array([0.4, 0.8, -0.3]) + random.uniform(-0.5, 0.5, (count, 3))
    inputs = robot.inputs(rotation=rotation, translation=(-0.28, -0.22, -0.1), tip_force=(0, 0.2, 0.1))
    problem = robot.problem(inputs, integrator=study.INTEGRATOR)
    paths = Paths(problem, mr.Shooting(integrator=study.INTEGRATOR).newton(problem), 1000)
    outcome = paths.raise_loads(np.ones(count, dtype=bool), problem.mode_bounds())
    assert (outcome.status == Status.CONVERGED).all()
    levels = paths.state.levels.numpy()
    at_once = np.flatnonzero((levels[:, 0] == 1) & (levels[:, 1] == 0) & (paths.state.doubted.numpy() != 0))
    assert len(at_once) > count / 4
    assert outcome.integrations[at_once].max() < 12
    truth = study.reference(problem.parts.of(at_once))
    assert (truth.level == 1).all()
    assert study.alike(problem.read("unknowns")[at_once], truth.unknowns).all()


@pytest.mark.parametrize("integrator", [study.INTEGRATOR, mr.RK45()], ids=["fixed", "chosen"])
def test_few_steps_of_the_integrator_on_the_way_leave_results(monkeypatch, integrator):
    """All the way but its end is looked at by few steps; in a batch and alone."""
    random, count = np.random.default_rng(3), 40
    data = [(0.00387, 0.431, 0.103, 9.0), (0.01717, 0.332, 0.113, 6.0), (0.03977, 0.174, 0.134, 3.5)]
    rods = [
        mr.Rod(length=L, bending_stiffness=EI, torsional_stiffness=0.8 * EI, precurvature=[(L - c, (0, 0, 0)), (c, (k, 0, 0))])
        for EI, L, c, k in data
    ]
    robot = mr.ConcentricTubes(rods)
    rotation = random.uniform(-1, 1, (count, 3)) * np.linspace(0.5, 1.5, count)[:, None]
    force = np.linspace(0.1, 0.5, count)[:, None] * np.array([0, 1, 0.5])
    solver = mr.Shooting(integrator=integrator, at_fold="stop")

    def solved(some):
        inputs = robot.inputs(rotation=rotation[some], translation=(-0.28, -0.22, -0.1), tip_force=force[some])
        return mr.solve(robot, inputs, solver=solver, threads=1)

    launch, spent = LanePass.launch, {True: 0, False: 0}

    def counted(self):
        call = self._call
        if not call.node_count:
            few = call.rtol > integrator.rtol if integrator.adaptive else call.steps < integrator.steps
            spent[few] += int(call.problem.active.numpy().sum())
        launch(self)

    monkeypatch.setattr(LanePass, "launch", counted)
    brief = solved(slice(None))
    assert spent[True] > 1.5 * spent[False], spent
    alone = solved(slice(0, 1))
    monkeypatch.setattr(Pace, "may_be_brief", lambda self: False)
    spent[True] = 0
    whole = solved(slice(None))
    assert not spent[True]
    assert (whole.status == Status.CONVERGED).all()
    once = whole.integrations < 12
    assert 3 < once.sum() < count - 3, whole.integrations
    np.testing.assert_array_equal(alone.unknowns[0], brief.unknowns[0])
    np.testing.assert_array_equal(brief.status, whole.status)
    assert np.abs(brief.integrations - whole.integrations)[once].max() <= 1
    assert brief.integrations.sum() < 1.05 * whole.integrations.sum()
    # the tolerance of both, by the inverse of Gamma
    np.testing.assert_allclose(brief.unknowns, whole.unknowns, rtol=0, atol=1e-7)


EVERY_LOAD = {"integrator": study.INTEGRATOR, "enabled": ("tip_force", "distributed_force", "gravity")}  # one kernel for all


def equal_tubes(curvature):
    tube = mr.Rod(length=1, bending_stiffness=1, torsional_stiffness=1, precurvature=(curvature, 0, 0))
    return mr.ConcentricTubes([tube, tube])


@pytest.mark.parametrize("root", [5.0, 5.5, 6.0, 7.0, 8.0, 10.0])
def test_two_equal_tubes_turned_from_aligned_to_opposite(root):
    """c = x^2 for two equal tubes of unit stiffness and curvature x."""
    robot = equal_tubes(root)
    inputs = robot.inputs(rotation=np.stack([np.zeros(721), np.linspace(0, np.pi, 721)], axis=1))
    problem = robot.problem(inputs, integrator=study.INTEGRATOR)
    newton = mr.Shooting(integrator=study.INTEGRATOR).newton(problem)
    outcome = natural_branch(problem, newton, 1000)
    unknowns = problem.read("unknowns")
    ended = outcome.status == Status.BRANCH_END
    assert (ended | (outcome.status == Status.CONVERGED)).all()
    assert not (study.unstable(problem, unknowns) & ~ended).any()
    truth = study.reference(problem)
    assert truth.agreed.all()
    np.testing.assert_array_equal(ended, truth.level < 1)
    assert study.alike(unknowns, truth.unknowns)[~ended].all()


@pytest.mark.parametrize("root", [5.0, 7.0])
def test_what_a_default_solve_returns_of_two_equal_tubes_is_stable(root):
    robot = equal_tubes(root)
    inputs = robot.inputs(rotation=np.stack([np.zeros(61), np.linspace(0, np.pi, 61)], axis=1))
    solution = mr.solve(robot, inputs)
    assert np.isin(solution.status, (Status.CONVERGED, Status.LOWEST_ENERGY)).all()
    assert (solution.stability == mr.Stability.STABLE).all()


def test_what_steps_bring_to_an_unstable_equilibrium_is_followed_again(monkeypatch):
    robot = equal_tubes(7.0)
    inputs = robot.inputs(rotation=(0, 2.0))
    meant = mr.solve(robot, inputs)
    others = mr.equilibria(robot, inputs)
    unstable = others.unknowns[others.stability == mr.Stability.UNSTABLE][0]
    problem = robot.problem(inputs, integrator=mr.RK45())
    newton = mr.Shooting().newton(problem)
    follow, taken = Paths.raise_loads, []

    def astray(path, chosen, bounds, finer=1):
        outcome = follow(path, chosen, bounds, finer)
        taken.append(finer)
        if finer == 1 or len(taken) > 2:
            path.problem.evaluate(unstable[None])
        return outcome

    monkeypatch.setattr(Paths, "raise_loads", astray)
    assert natural_branch(problem, newton, 1000).status[0] == Status.CONVERGED
    assert len(taken) == 2
    assert study.alike(problem.read("unknowns"), meant.unknowns[None]).all()
    # and where that does not help either, the branch counts as ended
    assert natural_branch(problem, newton, 1000).status[0] == Status.BRANCH_END


@pytest.mark.parametrize("place", [67, 175])
def test_a_motion_in_coarse_samples_is_the_one_in_fine_ones(place):
    """Tubes turned from in line to where a random scene has them; 67 by 30 degrees a sample, 175 by 2 rad."""
    robot, inputs = study.draw("two tubes", 200, 500)
    problem = robot.problem(inputs, integrator=study.INTEGRATOR).parts.of(np.array([place]))
    row = problem.read("inputs")
    ends = []
    for samples in (3, 120):
        track = mr.Shooting(integrator=study.INTEGRATOR).track(problem, 0.01)
        for k in range(samples + 1):
            turned = row.copy()
            turned[:, problem.input_slice("rotation")] *= k / samples
            problem.write("inputs", turned)
            assert track.step().status[0] == Status.CONVERGED
        ends.append(problem.read("unknowns"))
    assert study.alike(*ends).all()


# ---- how many unstable modes there can be: docs/stability.md, (13) to (15) ----


@pytest.mark.parametrize("root", [0.5, 3.0])
def test_bounds_of_two_equal_tubes(root):
    robot = equal_tubes(root)
    problem = robot.problem(robot.inputs(rotation=(0, 1)), integrator=study.INTEGRATOR)
    np.testing.assert_allclose(problem.mode_bounds()[0], (root**2 / 2, root**2 / 10), rtol=1e-12)


class OfOne:
    """Tubes of a problem of one instance: where they start, where their sections end, and their stiffnesses."""

    def __init__(self, problem):
        arrays = problem.arrays
        self.start = problem.read("inputs")[0, problem.input_slice("translation")]
        self.end, self.EI, self.GJ = (a[0] for a in (arrays.end, arrays.material[..., 0], arrays.material[..., 2]))
        self.bend = self.EI * np.hypot(*(arrays.precurvature[0, ..., k] for k in (0, 1)))

    def sections(self, s):
        """Of each tube that is at a place, None of the others."""
        result = []
        for start, end in zip(self.start, self.end, strict=True):
            m = int(np.searchsorted(end, s - start))
            result.append(m if s > start and m < len(end) else None)
        return result

    def form(self, s):
        """``P`` of (13) at a place before the plate."""
        here = self.sections(s)
        pull, stiff = ([0.0 if m is None else values[i, m] for i, m in enumerate(here)] for values in (self.bend, self.EI))
        return (np.diag(np.multiply(pull, sum(pull))) - np.outer(pull, pull)) / (sum(stiff) or 1.0)

    def twist(self, s):
        """By a unit torque on each tube at a place, there."""
        return (np.diff(np.minimum(self.end, (s - self.start)[:, None]), prepend=0.0) / self.GJ).sum(axis=1)


def by_elements(problem, elements=200):
    """Torsional energy and ``P`` of (13) by linear elements on the angles of tubes behind and before the plate, and the place and
    tube of each angle."""
    own = OfOne(problem)
    start, end, n = own.start, own.end, len(own.start)
    edges = np.concatenate([np.linspace(start.min(), 1, elements), (end + start[:, None]).ravel(), start, [0.0]])
    edges = np.unique(edges.round(6))  # ends that rounding parts are one
    K, P = np.zeros((2, n * len(edges), n * len(edges)))
    for k, (a, b) in enumerate(pairwise(edges)):
        s = (a + b) / 2
        form = own.form(s) if s > 0 else np.zeros((n, n))
        at = n * k + np.arange(n)
        for i, m in enumerate(own.sections(s)):
            stiffness = 1.0 if m is None else own.GJ[i, m]
            K[np.ix_((at[i], at[i] + n), (at[i], at[i] + n))] += stiffness / (b - a) * np.array([[1, -1], [-1, 1]])
        for first, second, weight in ((at, at, 1 / 3), (at + n, at + n, 1 / 3), (at, at + n, 1 / 6), (at + n, at, 1 / 6)):
            P[np.ix_(first, second)] += weight * (b - a) * form
    # a tube is held at its base, and where it is not yet
    free = [n * k + i for k, s in enumerate(edges) for i in range(n) if s > start[i] + 1e-6]
    place = [(edges[k // n], k % n) for k in free]
    return K[np.ix_(free, free)], P[np.ix_(free, free)], place


def eigenvalues(problem):
    """Of ``P`` over the torsional energy (13), descending."""
    K, P, _ = by_elements(problem)
    root = np.linalg.inv(np.linalg.cholesky(K))
    return np.linalg.eigvalsh(root @ P @ root.T)[::-1]


@pytest.mark.parametrize("kind", ["two tubes", "three tubes", "four tubes"])
def test_bounds_hold_for_the_worst_configuration(kind):
    robot, inputs = study.draw(kind, 4, 5)
    problem = robot.problem(inputs, integrator=study.INTEGRATOR)
    bounds = problem.mode_bounds()
    for k in range(4):
        first, second = eigenvalues(problem.parts.of(np.array([k])))[:2]
        # elements give less than all, by a part of the square of their size
        assert first < bounds[k, 0]
        assert second < bounds[k, 1]
        assert bounds[k, 0] < 2.5 * first  # a bound of use


@pytest.mark.parametrize("kind", ["two tubes", "three tubes", "four tubes"])
def test_the_second_bound_is_what_the_first_mode_leaves_of_the_trace(kind):
    """(15) by elements, which turn as torques at the place where the last two tubes part turn them."""
    robot, inputs = study.draw(kind, 3, 11)
    problem = robot.problem(inputs, integrator=study.INTEGRATOR)
    bounds = problem.mode_bounds()
    for k in range(3):
        one = problem.parts.of(np.array([k]))
        (K, P, place), own = by_elements(one), OfOne(one)
        ends = own.end + own.start[:, None]
        whole = np.zeros((len(ends), len(ends)))
        for a, b in pairwise(np.unique(np.concatenate([[0.0], ends.ravel()]).clip(0).round(9))):
            root = np.sqrt(own.twist((a + b) / 2))
            whole += (b - a) * root[:, None] * own.form((a + b) / 2) * root
        parting = np.sort(ends[:, -1])[-2]
        d = np.linalg.eigh(whole)[1][:, -1] / np.sqrt(own.twist(parting))
        torque = np.array([d[i] * (abs(s - parting) < 1e-5) for s, i in place])  # an angle goes on beyond the tip, unchanged
        r = np.linalg.solve(K, torque)
        pulled = P @ r
        expected = np.trace(whole) - pulled @ np.linalg.solve(K, pulled) / (r @ pulled)
        # elements are off by the square of their size: 1/200 of the length
        np.testing.assert_allclose(bounds[k, 1], expected, rtol=0, atol=5e-4 * np.trace(whole))


def test_bounds_count_what_a_force_does():
    """On two equal tubes of length 1: it turns the frame, its moment bends that and what pulls; each at the middle."""
    curvature, force = 3.0, 0.2
    robot = equal_tubes(curvature)
    given = (robot.inputs(rotation=(0, 1), tip_force=(0, force, 0)), robot.inputs(rotation=(0, 1)))
    loaded, free = (robot.problem(own, **EVERY_LOAD).mode_bounds()[0] for own in given)
    np.testing.assert_allclose(loaded - free, force / 4 * (1 + 1 / np.sqrt(2)) + force * curvature / 8, rtol=1e-12)


@pytest.mark.parametrize(
    ("along", "at_the_tip"),
    [({"distributed_force": (0, 0, 0.3)}, 0.3 * 2.0), ({"gravity": (0, 0, -9.0)}, 9.0 * (0.01 + 0.02) * 2.0)],
)
def test_bounds_take_dead_loads_along_tubes_for_no_less_than_they_are(along, at_the_tip):
    # their sum is what tubes of 2 m carry at the base: a tip force of that size is bounded alike
    rods = [
        mr.Rod(length=2.0, bending_stiffness=0.05, torsional_stiffness=0.04, precurvature=(1.5, 0, 0), linear_density=density)
        for density in (0.01, 0.02)
    ]
    robot = mr.ConcentricTubes(rods)
    given = (along, {"tip_force": (0, 0, at_the_tip)}, {})
    bounds = [robot.problem(robot.inputs(**own), **EVERY_LOAD).mode_bounds()[0] for own in given]
    np.testing.assert_allclose(bounds[0], bounds[1], rtol=1e-12)
    assert (bounds[0] > bounds[2]).all()


@pytest.mark.parametrize("kind", ["two tubes", "three tubes, tip force"])
def test_bounds_are_bitwise_those_of_each_alone(kind):
    robot, inputs = study.draw(kind, 60, 3)
    problem = robot.problem(inputs, integrator=study.INTEGRATOR)
    for name in ("mode_bounds", "turning", "load_scale"):
        alone = [getattr(problem.parts.of(np.array([k])), name)()[0] for k in range(60)]
        np.testing.assert_array_equal(getattr(problem, name)(), alone)
