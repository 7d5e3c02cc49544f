"""Rods in an elastic medium: where they lose stability, against beams and an independent energy; what comes then; many decay
lengths by multiple shooting."""

from itertools import pairwise

import numpy as np
import pytest
from medium_energy import MediumEnergy, TubesInMedium
from own_loads import Push
from scipy.optimize import brentq

import multirod as mr
from multirod.budget import Budget
from multirod.solvers.segments import along, equilibria
from multirod.solvers.segments.along import InSegments
from multirod.studies.critical_loads import natural_start

EI, GJ, LENGTH = 0.01, 0.008, 0.2
STIFFNESS = np.array([2 * EI, EI, GJ])  # a strip: it bends about y


def strip(foundation, **properties) -> mr.SingleRod:
    basic = {"length": LENGTH, "bending_stiffness": STIFFNESS[:2], "torsional_stiffness": GJ, "foundation": foundation}
    return mr.SingleRod(mr.Rod(**basic | properties))


def beam_load(k: float, bending: float) -> float:
    """The least thrust of a cantilever on springs ``k``: ``EI w'''' + P w'' + k w = 0``, its end free under a dead force."""

    def lacking(P):
        roots = np.roots([bending, 0, P, 0, k])
        bent = roots**2 * np.exp(roots * LENGTH)
        sheared = (bending * roots**3 + P * roots) * np.exp(roots * LENGTH)
        columns = np.array([np.ones(4), roots, bent, sheared]) / np.abs(roots * np.exp(np.abs(roots.real) * LENGTH))
        # a determinant of powers of the roots: over that of the roots alone it is smooth and real
        return (np.linalg.det(columns) / np.linalg.det(np.vander(roots / roots[0].__abs__(), increasing=True).T)).real

    loads = np.linspace(0.3, 3, 400) * (np.sqrt(k * bending) + 0.25 * np.pi**2 * bending / LENGTH**2)
    values = [lacking(P) for P in loads]
    low, high = next((a, b) for (a, f), (b, g) in pairwise(zip(loads, values, strict=True)) if f * g < 0)
    return brentq(lacking, low, high, xtol=1e-12)


@pytest.mark.parametrize("k", [0.5, 60.0, 3000.0])
def test_a_column_buckles_in_a_medium_where_a_beam_on_springs_does(k):
    robot = strip(k)
    first, second = mr.critical_loads(robot, robot.inputs(tip_force=(0, 0, -1)), count=2)
    assert first.load_factor == pytest.approx(beam_load(k, EI), rel=1e-8)
    assert second.load_factor == pytest.approx(beam_load(k, 2 * EI), rel=1e-8)
    assert (first.index_after, second.index_after) == (1, 2)


@pytest.mark.parametrize(("push", "index"), [(12.3, 0), (12.4, 2), (485.0, 2), (486.0, 4), (3800.0, 4), (3820.0, 6)])
def test_what_pushes_a_cantilever_off_its_line_has_the_modes_of_a_beam_that_vibrates(push, index):
    """The fourth powers of 1.8751, 4.6941 and 7.8548 are the first of ``k L^4/EI``; a round rod bends to two sides."""
    rod = mr.Rod(length=LENGTH, bending_stiffness=EI, torsional_stiffness=GJ, loads=[Push(push * EI / LENGTH**4)])
    robot = mr.SingleRod(rod)
    straight = mr.solve(robot, robot.inputs(), guess=np.zeros(6))
    assert straight.index == index
    assert straight.stability is (mr.Stability.UNSTABLE if index else mr.Stability.STABLE)


def test_a_long_column_buckles_at_its_free_end():
    """A beam without end on springs, free where it is pressed: ``sqrt(k EI)``, half of what it bears in its middle."""
    k = 4 * EI * (10 / LENGTH) ** 4  # ten decay lengths: exp(-10) is left
    robot = strip(k)
    (first,) = mr.critical_loads(robot, robot.inputs(tip_force=(0, 0, -1)))
    assert first.load_factor == pytest.approx(np.sqrt(k * EI), rel=2e-4)


def test_many_decay_lengths_are_followed_in_segments():
    """Where rounding grows by ``exp(18)``: an integration from the base ended there at a load factor of 0."""
    k = EI * (25 / LENGTH) ** 4
    robot = strip((k, k, 0.0))
    begin, end = (robot.inputs(tip_force=(0, 0, -part * np.sqrt(k * EI))) for part in (0.9, 1.0))
    (first,) = mr.critical_loads(robot, end, start=begin)
    assert first.load_factor == pytest.approx(1, rel=1e-7)  # exp(-35) is left
    assert (first.index_before, first.index_after, first.fold) == (0, 1, False)
    assert not first.solution.failed
    np.testing.assert_allclose(np.hypot(*first.mode[[1, 3]]), 1)  # it bends about y


@pytest.mark.parametrize("lengths", [20, 24, 25])
def test_columns_of_any_length_are_followed_from_no_load(lengths):
    """A strip that hardly bends one way amplifies less than one that bends both: ``Gamma`` is 1e6 to 3e7 where it begins."""
    k, wide = EI * (lengths / LENGTH) ** 4, 25 * EI
    robot = strip((k, k, 0.0), bending_stiffness=(wide, EI))
    (first,) = mr.critical_loads(robot, robot.inputs(tip_force=(0, 0, -np.sqrt(k * EI))))
    assert first.load_factor == pytest.approx(1, rel=1e-8)  # exp(-28) is left


def test_segments_tell_what_an_integration_from_the_base_does(monkeypatch):
    """Of a strip that is bent at rest, where it buckles out of its plane."""
    robot = strip((60.0, 40.0, 20.0), precurvature=(3.0, 0.0, 0.0))
    inputs = robot.inputs(tip_force=(0, 0.1, -1))
    options = {"up_to": 6.0}
    from_base = mr.critical_loads(robot, inputs, **options)
    monkeypatch.setattr(along, "AMPLIFIED", 0.0)
    monkeypatch.setattr(equilibria, "GROWTH", 3.0)  # more segments than one
    evaluate, sizes = InSegments.evaluate, set()
    monkeypatch.setattr(InSegments, "evaluate", lambda self, *given: sizes.add(self.size) or evaluate(self, *given))
    in_segments = mr.critical_loads(robot, inputs, **options)
    assert min(sizes) > 6
    assert len(from_base) == len(in_segments) > 0
    for one, other in zip(from_base, in_segments, strict=True):
        assert one.load_factor == pytest.approx(other.load_factor, rel=1e-8)
        assert (one.fold, one.index_before, one.index_after) == (other.fold, other.index_before, other.index_after)
        np.testing.assert_allclose(one.mode * np.sign(one.mode @ other.mode), other.mode, atol=1e-5)
        np.testing.assert_allclose(one.solution.tip_position, other.solution.tip_position, atol=1e-8 * LENGTH)


def test_derivatives_of_a_branch_in_segments(monkeypatch):
    """Where no gap is left, against differences; states are turned by some tenths from those where the branch begins."""
    monkeypatch.setattr(along, "AMPLIFIED", 0.0)
    monkeypatch.setattr(equilibria, "GROWTH", 1.5)
    robot = strip((300.0, 200.0, 100.0), precurvature=(2.0, 4.0, 1.0))
    solver = mr.Shooting(integrator=mr.RK4(60))
    inputs = robot.inputs(tip_force=(1.0, 0.5, -2.0))
    branch, point = natural_start(robot, robot.inputs(), inputs, solver, "cpu", Budget(10_000))
    for step in branch.steps(point, 50):
        point = step.after
        if branch.factor(point) > 1:
            break
    place, n = point.place, branch.equations.size
    assert np.abs(place[6:-1]).max() > 0.1
    _, matrix = branch._evaluate(place)
    h = 1e-6 * np.eye(n + 1)
    differences = [(branch._evaluate(place + e)[0] - branch._evaluate(place - e)[0]) / 2e-6 for e in h]
    np.testing.assert_allclose(matrix, np.transpose(differences), atol=1e-6 * np.abs(matrix).max())


# a bent strip under two loads, and near its equilibria, as mr.equilibria finds them, with their unstable modes
EQUILIBRIA = {
    "soft": (
        (60.0, 30.0, 10.0),
        (0.3, 0.1, -3.0),
        {
            (3.81, -32.2, 1.52, 10.24, 1.46, -27.8): 0,
            (1.49, 31.83, 3.21, -5.08, 0.97, -27.94): 0,
            (20.2, 12.66, 5.31, -0.63, 4.84, -28.49): 1,
            (-20.57, 5.11, -2.8, 1.42, -3.25, -28.64): 1,
            (-1.71, 1.53, 0.98, 3.06, 0.57, -29.99): 2,
        },
    ),
    "stiff": (
        (600.0, 1200.0, 130.0),
        (0.3, 0.1, -6.5),
        {
            (2.89, -34.1, 0.01, 52.54, 5.26, -31.66): 0,
            (-10.64, 25.0, -20.25, -53.54, -55.08, -38.52): 1,
            (3.15, 1.05, -0.52, -2.38, -16.54, -64.54): 2,
        },
    ),
}


@pytest.mark.parametrize("name", EQUILIBRIA)
def test_unstable_modes_are_those_of_an_independent_energy(name):
    k, force, equilibria = EQUILIBRIA[name]
    u_star, guesses = (1.3, -1.6, 1.7), np.array(list(equilibria))
    robot = strip(k, precurvature=u_star)
    found = mr.solve(robot, robot.inputs(tip_force=np.tile(force, (len(guesses), 1))), guess=guesses).raise_if_failed()
    np.testing.assert_allclose(found.unknowns, guesses, atol=0.1)
    energy = MediumEnergy(LENGTH, STIFFNESS, u_star, k, force, 20)
    for index, own in zip(found.index, found.rod(0, nodes=41).curvature[:, 1::2], strict=True):
        there, values = energy.stationary(own)
        assert np.abs(there.reshape(20, 3) - own).max() < 0.1 * np.abs(own).max()  # the same one, on segments
        assert index == (values < 0).sum()
    assert found.index.tolist() == list(equilibria.values())


@pytest.mark.parametrize("k", [1.0, 400.0, 2e4])
def test_a_column_goes_on_where_it_buckles(k):
    robot = strip(k)
    load = 1.2 * beam_load(k, EI)
    below, beyond = (mr.solve(robot, robot.inputs(tip_force=(0, 0, -part * load))) for part in (0.8, 1.0))
    assert below.status is mr.Status.CONVERGED
    assert below.stability is mr.Stability.STABLE
    assert beyond.status is mr.Status.BIFURCATED
    assert beyond.stability is mr.Stability.STABLE
    (event,) = beyond.events
    # the medium around a straight rod is there before the load
    assert event.load_factor * load == pytest.approx(beam_load(k, EI), rel=1e-6)
    own = beyond.rod(0, nodes=41).curvature[1::2]
    there, values = MediumEnergy(LENGTH, STIFFNESS, (0, 0, 0), [k] * 3, (0, 0, -load), 20).stationary(own)
    assert values[0] > 0
    assert np.abs(there.reshape(20, 3) - own).max() < 0.1 * np.abs(own).max()
    twin = mr.solve(robot, robot.inputs(tip_force=(0, 0, -load)), solver=mr.Shooting(side="negative"))
    np.testing.assert_allclose(twin.tip_position, beyond.tip_position * (-1, 1, 1), atol=1e-8)


@pytest.mark.parametrize(("k", "part"), [(400.0, 1.01), (400.0, 1.5), (1250.0, 3.0)])
def test_a_round_column_goes_on_where_it_buckles(k, part):
    """Whichever way it turns, at once: `BRANCH_END` where the medium was raised with the load; `UNSTABLE` by the last, where both
    modes had just vanished when its branch was seen to end."""
    robot, load = strip(k, bending_stiffness=EI), part * beam_load(k, EI)
    beyond = mr.solve(robot, robot.inputs(tip_force=(0, 0, -load)))
    assert beyond.status is mr.Status.BIFURCATED
    (event,) = beyond.events
    assert event.load_factor == pytest.approx(1 / part, rel=1e-6)
    own = beyond.rod(0, nodes=41).curvature[1::2]
    there, values = MediumEnergy(LENGTH, (EI, EI, STIFFNESS[2]), (0, 0, 0), [k] * 3, (0, 0, -load), 20).stationary(own)
    assert (values > -1e-6 * values[-1]).all()  # it may turn about its axis
    assert np.abs(there.reshape(20, 3) - own).max() < 0.1 * np.abs(own).max()


@pytest.mark.parametrize("bending", [EI, STIFFNESS[:2]], ids=["round", "strip"])
def test_what_buckles_by_its_weight_in_a_medium_does_so_in_a_solve_as_in_a_motion(bending):
    """Loads along the rod are those of the load that is reached, and so is the force at the base: states on the way were judged
    under the whole load, and the buckled one was `CONVERGED` without an event."""
    robot = strip(1250.0, bending_stiffness=bending, linear_density=10.0)
    (load,) = mr.critical_loads(robot, robot.inputs(gravity=(0, 0, -1)))
    weight = np.array((0, 0, -1.5 * load.load_factor))
    at_once = mr.solve(robot, robot.inputs(gravity=weight))
    moved = mr.simulate(robot, robot.inputs(gravity=np.outer(np.linspace(0, 1, 7), weight)), time=np.linspace(0, 1, 7))
    (event,), (there,) = at_once.events, (event for sample in moved.events for event in sample)
    assert (event.status, there.status) == (mr.Status.BIFURCATED, mr.Status.BIFURCATED)
    assert event.load_factor == pytest.approx(1 / 1.5, rel=1e-5)
    assert there.progress is not None
    np.testing.assert_allclose(moved[-1].tip_position, at_once.tip_position, atol=1e-8 * LENGTH)


@pytest.mark.parametrize("lengths", [20, 40])
def test_many_decay_lengths_are_solved_in_segments(lengths):
    """Where rounding grows by ``exp(20)`` and more; tip by the beam and its derivatives by differences."""
    k = 4 * EI * (lengths / LENGTH) ** 4
    robot = strip((k, k, 0.0), bending_stiffness=EI)
    b, force = lengths / LENGTH, 1e-4 * np.sqrt(k * EI)

    def at(**inputs):
        solution = mr.solve(robot, robot.inputs(**{"tip_force": (force, 0, 0)} | inputs))
        # a straight one of 20 lengths rounding leaves to shooting
        assert solution.status is mr.Status.MULTIPLE_SHOOTING or lengths < 30
        return solution.raise_if_failed()

    solution = at()
    assert solution.tip_position[0] == pytest.approx(2 * force * b / k, rel=1e-6)  # the end of a beam without end, to exp(-40)
    assert solution.stability is mr.Stability.STABLE
    alone = mr.solve(robot, robot.inputs(tip_force=(force, 0, 0)), solver=mr.MultipleShooting())
    np.testing.assert_allclose(alone.tip_position, solution.tip_position, atol=1e-12)
    h = 1e-3 * force
    for axis, e in enumerate(np.eye(3)):
        moved = (at(tip_force=(force, 0, 0) + h * e).tip_position - at(tip_force=(force, 0, 0) - h * e).tip_position) / (2 * h)
        np.testing.assert_allclose(solution.jacobian("tip_force")[:3, axis], moved, atol=1e-6 * b / k)
    turned = (at(rotation=0.3 + 1e-4).tip_position - at(rotation=0.3 - 1e-4).tip_position) / 2e-4
    np.testing.assert_allclose(at(rotation=0.3).jacobian("rotation")[:3, 0], turned, atol=1e-7 * LENGTH)


def test_next_to_no_load_is_told_stable_however_many_decay_lengths():
    """It calls for no more than one stretch by itself, which amplifies variations by 1e13."""
    k = EI * (40 / LENGTH) ** 4
    robot = strip(k)
    solution = mr.solve(robot, robot.inputs(tip_force=(1e-6 * np.sqrt(k * EI), 0, 0)))
    assert solution.status is mr.Status.CONVERGED
    assert solution.stability is mr.Stability.STABLE
    assert solution.stability_margin == pytest.approx(1, abs=1e-6)


def test_what_only_segments_solve_is_judged_as_what_shooting_does():
    """Of the same equilibria, the form and the energy."""
    k = (3000.0, 2000.0, 700.0)
    robot = strip(k, precurvature=(9.0, 2.0, 1.0), linear_density=0.2)
    inputs = robot.inputs(tip_force=(0.5, -0.3, -4.0), rotation=0.4, gravity=(0, 0, 9.81))
    by_shooting, by_segments = (mr.solve(robot, inputs, solver=own) for own in (mr.Shooting(), mr.MultipleShooting()))
    assert by_shooting.status is mr.Status.CONVERGED
    np.testing.assert_allclose(by_segments.tip_position, by_shooting.tip_position, atol=1e-9)
    assert by_segments.potential == pytest.approx(by_shooting.potential, rel=1e-8)
    assert by_segments.stability_margin == pytest.approx(by_shooting.stability_margin, rel=1e-5)


COUNT = 16  # segments


def tube(reach, EI, GJ, curvature, straight=0, k=0.0):
    """Of so many segments, the first ones straight; and the same for the energy."""
    h, bent = 1 / COUNT, np.array(curvature, float)
    sections = [(straight * h, (0, 0, 0))] * (straight > 0) + [((reach - straight) * h, tuple(bent))]
    rod = mr.Rod(length=reach * h, bending_stiffness=EI, torsional_stiffness=GJ, precurvature=sections, foundation=k)
    return rod, (EI, GJ, np.where(np.arange(reach)[:, None] < straight, 0.0, bent))


SCENES = {
    "two": ([(16, 1.0, 0.8, (3, 0, 0)), (12, 1.5, 1.1, (4, 0, 0.3))], (0.2, 3.4), (20, 10, 5), (0.5, 0.2, -3)),
    "the outer one first": ([(10, 1.5, 1.1, (5, 0, 0)), (16, 1.0, 0.8, (4, 1, 0))], (3.3, 0.2), (20, 20, 0), (0.3, 0, -2)),
    "three": (
        [(16, 1.0, 0.7, (4, 0, 0), 4), (13, 1.2, 0.9, (5, 0, 0), 4), (9, 1.6, 1.3, (3, 2, 0), 2)],
        (0, 2.9, -1.0),
        (40, 40, 40),
        (0.2, 0.4, -1),
    ),
    "three, the middle one the longest": (
        [(12, 1.2, 0.9, (5, 0, 0), 3), (16, 1.0, 0.7, (4, 0, 0), 3), (8, 1.6, 1.3, (3, 2, 0), 2)],
        (3.0, 0.1, -1.0),
        (15, 25, 5),
        (0.2, 0.4, -1),
    ),
}


@pytest.mark.parametrize("name", SCENES)
def test_modes_of_tubes_in_a_medium_are_those_of_an_independent_energy(name):
    sizes, turned, k, force = SCENES[name]
    k = np.array(k, float)
    made = [tube(*own, k=tuple(k if j == 0 else 0 * k)) for j, own in enumerate(sizes)]
    order = sorted(range(len(made)), key=lambda j: -sizes[j][0])
    robot = mr.ConcentricTubes([rod for rod, _ in made])
    found = mr.equilibria(robot, robot.inputs(rotation=turned, tip_force=force))
    assert (found.stability != mr.Stability.UNKNOWN).all()
    energy = TubesInMedium(1.0, [made[j][1] for j in order], [turned[j] for j in order], k, force, COUNT)
    if order[0] != 0:  # the medium ends with the tube that it is around
        energy.ends = sizes[0][0]
    told = 0
    for solution in found:
        start = energy.of(solution, order)
        there, values = energy.stationary(start)
        if np.abs(there - start).max() > 0.1 * np.abs(start).max() or np.abs(values[:4]).min() < 0.02 * np.abs(values[:4]).max():
            continue  # another one on segments, or next to a fold
        told += 1
        assert solution.index == (values < 0).sum()
    assert told >= 3
    assert len(set(found.index.tolist())) >= 2
