"""Multiple shooting of rods with lines: unknown tensions, lengths and what friction leaves add up from segment to segment."""

import numpy as np
import pytest

import multirod as mr
from multirod.results.segment_system import System
from multirod.solvers import multiple_shooting
from multirod.solvers.segments import equilibria as segmented_equilibria
from multirod.solvers.segments.band import Step
from multirod.solvers.segments.path import SegmentedPaths

EI, LENGTH, R = 0.01, 0.2, 0.008
OWN = {"length": LENGTH, "bending_stiffness": EI, "torsional_stiffness": 0.0077}
FORCE = np.array((0.1, 0.3, -0.2))
PRECISE = {"tolerance": 1e-10, "integrator": mr.RK45(rtol=1e-12, atol=1e-14)}


def helix(s):
    return 0.006 * np.cos(30 * s), 0.006 * np.sin(30 * s)


def three_tendons() -> mr.SingleRod:
    """An elastic tendon, an inextensible one over a part, an elastic one on a helix, on a rod that shears and is bent at rest."""
    lines = [
        mr.Tendon(offset=(R, 0), driven="displacement", axial_stiffness=40.0),
        mr.Tendon(offset=(-0.004, 0.007), driven="displacement", end=0.14),
        mr.Tendon(route=helix, driven="displacement", axial_stiffness=60.0),
    ]
    more = {"shear_stiffness": 4000.0, "axial_stiffness": 9000.0, "precurvature": (1.0, -0.5, 0.3)}
    return mr.SingleRod(mr.Rod(**OWN, **more, lines=lines))


def push_rods() -> mr.SingleRod:
    """One that bends, and one that ends with the first of two sections."""
    sections = [
        mr.Section(length=0.12, bending_stiffness=EI, torsional_stiffness=0.0077),
        mr.Section(length=0.08, bending_stiffness=0.6 * EI, torsional_stiffness=0.005),
    ]
    lines = [mr.PushRod((R, 0), bending_stiffness=0.004), mr.PushRod((-0.004, 0.006), end=0.12)]
    return mr.SingleRod(mr.Rod(sections=sections, lines=lines))


def rubbing() -> mr.SingleRod:
    """With weight: a helix that rubs and is driven by its displacement, a tendon that rubs, and a chamber."""
    lines = [
        mr.Tendon(route=helix, friction=0.3, driven="displacement"),
        mr.Tendon((-0.006, 0.002), friction=0.1),
        mr.Chamber((0, -0.005), area=2e-5),
    ]
    return mr.SingleRod(mr.Rod(**OWN, linear_density=0.05, lines=lines))


def antagonists(**more: float) -> mr.SingleRod:
    lines = [mr.Tendon(offset=(sign * R, 0), driven="displacement", **more) for sign in (1, -1)]
    return mr.SingleRod(mr.Rod(**OWN, lines=lines))


SCENES = {
    # the third is slack in one line, the fourth hard for one integration
    "three tendons": (
        three_tendons,
        {
            "displacement": [(0.003, 0.004, 0.002), (0.003, 0.004, 0.002), (0.003, -0.004, 0.002), (0.003, 0.004, 0.002)],
            "tip_force": FORCE * np.array([[1], [10], [1], [40]]),
        },
    ),
    "push rods": (push_rods, {"displacement": (0.003, -0.001), "tip_force": FORCE}),
    "friction": (
        rubbing,
        {
            "tension": (3.0,),
            "displacement": (0.003,),
            "pressure": 4e4,
            "gravity": (0, 0, -9.81),
            "tip_moment": (0.01, 0, 0.003),
        },
    ),
}


@pytest.fixture
def cut_short(monkeypatch) -> None:
    """Cut where segments would not need it, and no iteration from the base alone."""
    monkeypatch.setattr(segmented_equilibria, "GROWTH", 1.2)
    monkeypatch.setattr(segmented_equilibria, "MOST_STEPS", 16)
    monkeypatch.setattr(multiple_shooting, "ROUNDED_OFF", 0.0)


@pytest.mark.parametrize("name", SCENES)
def test_segments_lead_where_shooting_leads(name, cut_short):
    """Both are integrated to 1e-12 of a step and solved to 1e-10/m; tensions are ``EI/r`` = 1.25 N m times unknowns."""
    make, given = SCENES[name]
    robot = make()
    inputs = robot.inputs(**given)
    expected = mr.solve(robot, inputs, solver=mr.Shooting(**PRECISE)).raise_if_failed()
    found = mr.solve(robot, inputs, solver=mr.MultipleShooting(**PRECISE))
    assert np.all(found.status == mr.Status.MULTIPLE_SHOOTING)
    for field in (
        "unknowns",
        "tip_position",
        "tip_rotation",
        "tension",
        "line_length",
        "energy",
        "potential",
        "stability_margin",
    ):
        np.testing.assert_allclose(getattr(found, field), getattr(expected, field), rtol=1e-9, atol=1e-9)
    np.testing.assert_array_equal(found.slack, expected.slack)
    np.testing.assert_array_equal(found.stability, expected.stability)
    np.testing.assert_array_equal(found.index, expected.index)
    # some are taut, and one is slack where that was meant
    assert bool(np.any(found.slack)) == (name == "three tendons")
    for k in range(len(robot.rods[0].lines)):
        np.testing.assert_allclose(found.line(k).tension, expected.line(k).tension, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(found.rod(0).moment, expected.rod(0).moment, rtol=0, atol=1e-9)


@pytest.mark.parametrize("name", ["three tendons", "friction"])
def test_matrices_of_segments_are_derivatives_of_their_gaps(name, cut_short):
    """(2), (5): on the way to the load, where kinks are rounded, away from the equilibrium; differences are known to 1e-8."""
    make, given = SCENES[name]
    robot, integrator = make(), PRECISE["integrator"]
    problem = robot.problem(robot.inputs(**{k: v[1] if np.ndim(v) > 1 else v for k, v in given.items()}), integrator=integrator)
    segments, level = problem.segments, np.array([0.7])
    options = {"tolerance": np.array([1e-9]), "max_iterations": 30, "max_steps": 100, "allowed": np.array([1000])}
    paths = SegmentedPaths(segments, np.zeros(1, dtype=int), integrator=integrator, **options)
    rng = np.random.default_rng(4)
    unknowns = problem.guess() + 0.5 * rng.normal(size=(1, problem.unknown_count))
    place, _ = paths.refine(paths.evaluate(paths.start(unknowns), level), level)
    count, d = len(place.cuts.steps), segments.variation_size
    assert count >= 3
    cuts, places = place.cuts, segments.unknown_places
    system = System(place.found, places)
    for way in rng.normal(size=(4, system.size)):
        rows = np.concatenate([np.zeros((1, d)), way[system.n :].reshape(-1, d)])
        rows[1:, places[3:]] = way[3 : system.n]  # tensions are the same in all segments
        if name == "friction":
            rows[1:, 9] = 0.0  # what friction leaves of the chamber's pressure, which does not rub: nothing varies it
        way[system.n :] = rows[1:].ravel()

        def gaps(h: float, way=way, rows=rows) -> np.ndarray:
            there = paths.evaluate(paths.moved(cuts, Step(h * way[None, : system.n], h * rows)), level)
            found = paths.gaps(there)
            return np.append(found.rows[:-1], found.own[0])

        h = 1e-4
        expected = (8 * (gaps(h) - gaps(-h)) - (gaps(2 * h) - gaps(-2 * h))) / (12 * h)
        np.testing.assert_allclose(system.dense() @ way, expected, rtol=0, atol=1e-7 * np.abs(expected).max())


@pytest.mark.filterwarnings("ignore::multirod.PlausibilityWarning")
def test_what_one_integration_cannot_solve():
    """A force of 1000 EI/L^2 along the rod; the tensions that are found, given, lead to the same place without an unknown one."""
    robot = three_tendons()
    given = {"displacement": (0.003, 0.004, 0.002), "tip_force": (3.0, 6.0, 250.0)}
    assert mr.solve(robot, robot.inputs(**given), solver=mr.Shooting(fallback=False)).failed
    found = mr.solve(robot, robot.inputs(**given), solver=mr.MultipleShooting())
    assert found.status == mr.Status.MULTIPLE_SHOOTING
    assert mr.solve(robot, robot.inputs(**given)).status == mr.Status.MULTIPLE_SHOOTING
    assert found.stability == mr.Stability.STABLE


def test_antagonists(cut_short):
    """At their kink by the law that lets one out as the other is pulled; what cannot be; a column between elastic ones."""
    robot = antagonists()
    inputs = robot.inputs(displacement=[(0.004, -0.004), (0.003, 0.002), (0.002, -0.003)])
    expected, found = (mr.solve(robot, inputs, solver=solver) for solver in (mr.Shooting(), mr.MultipleShooting()))
    assert [status.name for status in map(mr.Status, expected.status)] == ["CONVERGED", "LINES_TOO_SHORT", "CONVERGED"]
    assert [status.name for status in map(mr.Status, found.status)] == [
        "MULTIPLE_SHOOTING",
        "LINES_TOO_SHORT",
        "MULTIPLE_SHOOTING",
    ]
    np.testing.assert_allclose(found.tip_position, expected.tip_position, atol=1e-8)
    np.testing.assert_allclose(found.tension, expected.tension, atol=1e-6)
    elastic = antagonists(axial_stiffness=30.0)
    for load, index in ((0.9, 0), (1.1, 1), (1.5, 2)):
        inputs = elastic.inputs(displacement=(0.001, 0.001), tip_force=(0, 0, -load * np.pi**2 / 4 * EI / LENGTH**2))
        straight = mr.solve(elastic, inputs, guess=np.array([0, 0, 0, 0.3, 0.3]), solver=mr.MultipleShooting())
        assert (straight.status, straight.index) == (mr.Status.MULTIPLE_SHOOTING, index)


def test_a_motion_past_slack_and_a_limit_of_integrations(cut_short):
    robot = three_tendons()
    pulls = np.array([(0.003, a, 0.002) for a in (0.004, 0.001, -0.002, 0.003)])
    inputs = robot.inputs(displacement=pulls, tip_force=FORCE)
    motion = mr.simulate(robot, inputs, time=0.1 * np.arange(4), solver=mr.MultipleShooting())
    alone = mr.solve(robot, inputs)
    np.testing.assert_allclose(motion.tip_position, alone.tip_position, atol=1e-8)
    np.testing.assert_array_equal(motion.slack, alone.slack)
    assert motion.slack.any()
    assert not motion.slack.all()
    few = mr.solve(robot, inputs[0], solver=mr.MultipleShooting(max_integrations=8))
    assert few.status == mr.Status.INTEGRATION_LIMIT
    assert few.integrations <= 9
    assert np.isnan(few.tension).all()


def test_tendons_pulled_and_let_out_by_the_law(cut_short):
    """(L8c) The path ends just before its load, beside the kink of two: from a hair of slack, to an arc."""
    angles = 2 * np.pi * np.arange(3) / 3
    lines = [mr.Tendon((R * np.cos(a), R * np.sin(a)), driven="displacement") for a in angles]
    robot = mr.SingleRod(mr.Rod(**OWN, lines=lines))
    found = mr.solve(robot, robot.inputs(displacement=0.004 * np.cos(angles)), solver=mr.MultipleShooting(**PRECISE))
    assert found.status == mr.Status.MULTIPLE_SHOOTING
    np.testing.assert_allclose(found.tension, [EI * 0.004 / (LENGTH * R**2), 0, 0], atol=1e-9)
    np.testing.assert_allclose(found.line_length, LENGTH - 0.004 * np.cos(angles), atol=1e-12)
