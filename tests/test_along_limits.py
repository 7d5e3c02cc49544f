"""Targets that limits of the shape hold back: as near as these let them, along where stability is lost too."""

import numpy as np
import pytest
from observer_scenes import three_tubes

import multirod as mr
from multirod.tasks.formulation import Task, input_units
from multirod.tasks.freed import values_of, with_values
from multirod.tasks.limits import limit_rows
from multirod.tasks.reaching import trying
from multirod.tasks.reaching.border import Border
from multirod.tasks.reaching.goals import Goals
from multirod.tasks.reaching.search import Search

STEPS = mr.RK4(30)
SOLVER = mr.Shooting(integrator=STEPS)
TUBES, MOTION = three_tubes()
FREE = ("rotation", "translation")
RANGES = {"translation": (-0.19, 0), "gap": 2e-3}


@pytest.fixture(scope="module")
def start():
    return mr.solve(TUBES, MOTION[10], solver=SOLVER).raise_if_failed()


def far_targets(start, count):
    """Positions out of reach, on all sides, many of them past where the tubes snap."""
    random = np.random.default_rng(11)
    aside = random.normal(size=(count, 3))
    return start.tip_position + 0.25 * aside / np.linalg.norm(aside, axis=1, keepdims=True)


def missed(found):
    """How far off, as the rows of the target count it, which are of positions alone [m]."""
    return np.atleast_1d(found.target_error)


@pytest.mark.parametrize("margin", [0.0, 0.5])
def test_what_a_stability_margin_holds_back_goes_on_along_it(start, monkeypatch, margin):
    """It stopped where a controller's samples did, up to some ten times as far off as tubes get that stay as stable."""
    targets = mr.Pose(position=far_targets(start, 10))
    limits = mr.Limits(**RANGES, stability_margin=margin)
    options = {"free": FREE, "guess": start, "limits": limits, "solver": SOLVER}
    found = mr.reach(TUBES, targets, **options)
    with monkeypatch.context() as without:
        without.setattr(trying, "bordered", lambda search, begun: {})
        before = mr.reach(TUBES, targets, **options)
    assert (missed(found) <= missed(before) * (1 + 1e-6)).all()
    assert np.median(missed(found) / missed(before)) < 0.8
    assert (found.status == mr.Status.AT_LIMIT).sum() >= (before.status == mr.Status.AT_LIMIT).sum()
    held = ~found.failed
    assert held.any()
    assert (found.stability_margin[held] >= margin).all()
    assert (found.stability[held] == mr.Stability.STABLE).all()
    rows = limit_rows(TUBES, limits, FREE)
    values = values_of(found.ended_at, FREE) @ rows.matrix.T
    assert (values >= rows.low - 1e-12).all()
    assert (values <= rows.high + 1e-12).all()
    assert (found.integrations <= before.integrations + 2 * 330).all()  # 300 are allowed, twice, and those of the last step


def test_steps_slide_along_a_margin_by_how_it_varies(start, monkeypatch):
    """(21): without its row they stop where they come to it."""
    targets = mr.Pose(position=far_targets(start, 10))
    options = {"free": FREE, "guess": start, "limits": mr.Limits(**RANGES, stability_margin=1.0), "solver": SOLVER}
    found = mr.reach(TUBES, targets, **options)
    slopes = Border._slopes
    monkeypatch.setattr(Border, "_slopes", lambda self, room, by: 0.0 * slopes(self, room, by))
    stopped = mr.reach(TUBES, targets, **options)
    assert missed(found).sum() < 0.9 * missed(stopped).sum()
    held = np.array(["stability_margin" in own for own in found.held_by])
    assert held.any()
    assert found.at_limit[held].any(axis=1).all()


def test_how_the_margin_varies_along_equilibria_is_that_of_solves(start):
    """(21): a wall's row is by differences at unknowns of first order; here each is solved for."""
    task = Task(TUBES.problem(start.inputs, integrator=STEPS, pose_sensitivities=True, **TUBES.input_directions(*FREE)), FREE)
    unit, length, problem = input_units(TUBES, FREE), TUBES.longest, task.problem
    goals = Goals(
        rows=mr.Pose(position=start.tip_position).rows(length, ()),
        limits=limit_rows(TUBES, mr.Limits(**RANGES), FREE),
        of_shape=mr.Limits(stability_margin=0.0),
        unit=unit,
        length=length,
        tolerance=1e-6,
        residual_tolerance=problem.tolerance(None),
        centre=None,
        max_integrations=300,
    )
    search = Search(task, goals, problem.adopt(start.unknowns[None]), task.values())
    own = Border(search, 0)
    by = task.evaluate(search.last.x, search.last.p).eliminated[1][0] * unit
    slopes = own._slopes(own._room(), by)[0]
    p, h = values_of(start.inputs, FREE), 1e-2
    for j in (0, 1, 2, 5):  # an end of an outer tube that moves past a place where the margin is told by makes that jump in slope
        ways = [with_values(start.inputs, FREE, p + sign * h * unit[j] * np.eye(len(p))[j]) for sign in (1, -1)]
        most, least = (float(mr.solve(TUBES, way, guess=start, solver=SOLVER).stability_margin) for way in ways)
        # one side at a thousandth of a unit against two at a hundredth: the second order of each
        assert slopes[j] == pytest.approx((most - least) / (2 * h), rel=2e-3)
