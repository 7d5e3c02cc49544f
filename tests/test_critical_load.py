"""Critical loads: closed forms and stored values, folds, several in a row, and what is refused."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import minimize_scalar
from scipy.spatial.transform import Rotation
from scipy.special import ellipj
from test_parallel_rods import ring
from test_stability import two_tubes

import multirod as mr
from multirod.models.backbone.problem import BackboneProblem
from multirod.solvers.continuation.branch_step import Apart, Inspection, Point, heights
from multirod.stability import Modes

CLOSE = 1e-8  # relative: the stored values are good to 2e-9
TIGHT = 1e-11  # relative: RK45(steps=150) leaves 1e-12 of the first four modes of a column, 1e-15 of the first


def column(**values):
    return mr.SingleRod(mr.Rod(**({"length": 1.0, "bending_stiffness": 1.0, "torsional_stiffness": 0.8} | values)))


def factors(found):
    return [critical.load_factor for critical in found]


def stored(reference_cases, name):
    return next(case for case in reference_cases("critical_load") if case["id"] == name)


def rod_of(case):
    given = case["inputs"]["rods"][0]
    K = given["K"]
    return mr.Rod(length=given["length"], bending_stiffness=K[:2], torsional_stiffness=K[2], precurvature=given["u_star"])


def test_euler_column_loses_one_mode_after_another():
    robot = column(bending_stiffness=(1.0, 1.3))
    found = mr.critical_loads(robot, robot.inputs(tip_force=(0, 0, -1)), count=4)
    np.testing.assert_allclose(factors(found), np.pi**2 / 4 * np.array([1, 1.3, 9, 11.7]), rtol=TIGHT)
    assert [(c.fold, c.index_before, c.index_after) for c in found] == [(False, k, k + 1) for k in range(4)]
    assert found[0].solution.stability is mr.Stability.FOLD
    np.testing.assert_allclose(found[0].solution.inputs.tip_force[2], -found[0].load_factor)
    # the softer axis bends first: about x, whose moment is the first unknown
    assert abs(found[0].mode[0]) > 0.999
    assert "bifurcation" in repr(found[0])


def test_a_branch_that_ends_after_some_gives_these():
    robot = column(bending_stiffness=(1.0, 1.3))
    with pytest.warns(
        mr.IncompleteWarning, match="10 steps led to .*; before that, 2 of the 4 critical loads asked for were found"
    ):
        found = mr.critical_loads(robot, robot.inputs(tip_force=(0, 0, -1)), count=4, max_steps=10)
    np.testing.assert_allclose(factors(found), np.pi**2 / 4 * np.array([1, 1.3]), rtol=TIGHT)
    assert factors(found)[-1] < found.reached < np.pi**2 / 4 * 9
    with pytest.raises(mr.SolveError, match="2 steps led to"):
        mr.critical_loads(robot, robot.inputs(tip_force=(0, 0, -1)), count=4, max_steps=2)


def test_modes_that_cross_together_are_one_critical_load():
    robot = column()
    found = mr.critical_loads(robot, robot.inputs(tip_force=(0, 0, -2)), count=2)
    np.testing.assert_allclose(factors(found), np.pi**2 / 8 * np.array([1, 9]), rtol=CLOSE)
    assert [c.multiplicity for c in found] == [2, 2]


def test_heavy_column(reference_cases):
    """Greenhill's height, by weight and by a load along the rod given as a function."""
    case = stored(reference_cases, "04b_greenhill_height")
    critical = float(case["expected"]["gamma_crit"]["value"]) * case["inputs"]["weak_axis_EI"]
    robot = mr.SingleRod(mr.Rod(length=1.0, bending_stiffness=(1.0, 0.5), torsional_stiffness=0.4, linear_density=1.0))
    for loads in ({"gravity": (0, 0, -1)}, {"distributed_force": lambda s: (0, 0, -1)}):
        (found,) = mr.critical_loads(robot, robot.inputs(**loads))
        np.testing.assert_allclose(found.load_factor, critical, rtol=CLOSE)
        assert found.solution.status is mr.Status.CONVERGED
        assert found.solution.stability is mr.Stability.FOLD
    pulled, pushed = robot.inputs(distributed_force=(0, 0, 2.0)), robot.inputs(distributed_force=lambda s: (0, 0, -1))
    (found,) = mr.critical_loads(robot, pushed, start=pulled)  # from 2 to -1 and on
    np.testing.assert_allclose(3 * found.load_factor - 2, critical, rtol=CLOSE)
    np.testing.assert_allclose(found.solution.inputs.profiles["distributed_force"](0.3), (0, 0, -critical), rtol=CLOSE)
    assert found.solution.stability is mr.Stability.FOLD
    sides = critical * np.array([0.9999, 1.0001])
    there = mr.solve(robot, robot.inputs(gravity=np.multiply.outer(sides, (0, 0, -1))), guess=(0.0, 0.0, 0.0))
    assert there.stability.tolist() == [mr.Stability.STABLE, mr.Stability.UNSTABLE]


@pytest.mark.parametrize("name", ["r10_u0p0", "r1000_u0p0", "r100_u0p5"])
def test_lateral_buckling(name, reference_cases):
    """Of a narrow cantilever, bent in its plane before, with and without precurvature."""
    case = stored(reference_cases, f"07a_lateral_torsional_{name}")
    expected = case["expected"]["P_crit"]
    robot = mr.SingleRod(rod_of(case))
    inputs = robot.inputs(tip_force=(0, 1, 0))
    (found,) = mr.critical_loads(robot, inputs)
    assert abs(found.load_factor - expected["value"]) < expected["abs_unc"] + 1e-9 * expected["value"]
    assert not found.fold
    # with the integrator of a solve, whose error control does not see the mode
    (default,) = mr.critical_loads(robot, inputs, solver=mr.Shooting())
    np.testing.assert_allclose(default.load_factor, expected["value"], rtol=1e-6)


def test_opposite_tubes_snap_at_a_fold():
    """theta'' = c sin(theta) from the base angle: the angle has its maximum over the tip angle where the branch folds."""
    turns = 2.0
    robot = two_tubes(turns)
    (found,) = mr.critical_loads(robot, robot.inputs(rotation=(0, 1)), start=robot.inputs())

    def base(tip):
        _, cn, dn, _ = ellipj(turns, np.sin((tip - np.pi) / 2) ** 2)
        return np.pi + 2 * np.arcsin(np.sin((tip - np.pi) / 2) * cn / dn)

    tips = np.linspace(0.1, np.pi, 4001)
    k = int(np.argmax(base(tips)))
    fine = np.linspace(tips[k - 1], tips[k + 1], 4001)
    np.testing.assert_allclose(found.load_factor, base(fine).max(), rtol=CLOSE)
    assert found.fold
    assert (found.index_before, found.index_after) == (0, 1)


def test_platform_on_columns_sways():
    """n columns clamped at both ends: pi^2 EI/L^2 each where the platform can shift but not tilt, in both directions at once."""
    leg = mr.Rod(length=1.0, bending_stiffness=1.0, torsional_stiffness=0.8)
    robot = mr.ParallelRods(legs=[leg] * 3, base=ring(3, 0.3), platform=ring(3, 0.3))
    (found,) = mr.critical_loads(robot, robot.inputs(tip_force=(0, 0, -1)))
    # each leg alone would sway at the same load, where its condensed form is infinite: that costs digits
    np.testing.assert_allclose(found.load_factor, 3 * np.pi**2, rtol=1e-6)
    assert (found.fold, found.multiplicity) == (False, 2)


def test_equal_legs_buckle_together():
    """Six, each clamped in line with itself: 4 pi^2 EI/l^2 of each at once, in both planes, which no eigenvalue shows."""
    EI, height, radius = 0.157, 0.39, 0.087
    feet, heads = (np.radians(own) for own in ([-10, 10, 110, 130, 230, 250], [-50, 50, 70, 170, 190, 290]))
    base, platform = np.tile(np.eye(4), (2, 6, 1, 1))
    for poses, angles in ((base, feet), (platform, heads)):
        poses[:, :2, 3] = radius * np.stack([np.cos(angles), np.sin(angles)], axis=1)
    along = platform[:, :3, 3] + (0, 0, height) - base[:, :3, 3]
    length = np.linalg.norm(along, axis=1)
    turned = Rotation.concatenate([Rotation.align_vectors(own, (0, 0, 1))[0] for own in along]).as_matrix()
    base[:, :3, :3] = platform[:, :3, :3] = turned
    legs = [mr.Rod(length=own, bending_stiffness=EI, torsional_stiffness=0.8 * EI) for own in length]
    robot = mr.ParallelRods(legs=legs, base=base, platform=platform)
    with pytest.warns(mr.IncompleteWarning, match="may be lost and regained unseen"):
        (found,) = mr.critical_loads(robot, robot.inputs(tip_force=(0, 0, -1)))
    expected = np.sum(4 * np.pi**2 * EI / length**2 * height / length)
    np.testing.assert_allclose(found.load_factor, expected, rtol=1e-6)
    assert (found.fold, found.index_before, found.index_after) == (False, 0, 12)


def test_one_load_is_raised_while_another_stays():
    """A column under tension T at its tip and its own weight: the weight must first take up the tension."""
    robot = mr.SingleRod(mr.Rod(length=1.0, bending_stiffness=1.0, torsional_stiffness=0.8, linear_density=1.0))
    start = robot.inputs(tip_force=(0, 0, 2.0))
    (found,) = mr.critical_loads(robot, robot.inputs(tip_force=(0, 0, 2.0), gravity=(0, 0, -1)), start=start)
    assert found.load_factor > 7.8373 + 2
    there = [
        mr.solve(robot, robot.inputs(tip_force=(0, 0, 2.0), gravity=(0, 0, -f * found.load_factor)), guess=(0, 0, 0))
        for f in (0.9999, 1.0001)
    ]
    assert [s.index for s in there] == [0, 2]


def test_the_branch_goes_on_past_a_fold():
    """Tubes that snapped: the branch turns back, and turns again where they would snap the other way."""
    robot = two_tubes(2.0)
    found = mr.critical_loads(robot, robot.inputs(rotation=(0, 1)), start=robot.inputs(), count=2)
    assert [(c.index_before, c.index_after) for c in found] == [(0, 1), (1, 0)]
    np.testing.assert_allclose(sum(factors(found)), 2 * np.pi, rtol=CLOSE)


# ---- what happens within a step ----


class Line:
    """A straight branch, along which eigenvalues are given functions of the distance; beyond ``gap`` it is another one, aside."""

    def __init__(self, *eigenvalues, gap=np.inf, aside=0.0):
        self.eigenvalues, self.gap, self.aside = eigenvalues, gap, aside
        self.asked = 0

    def point(self, s):
        self.asked += 1
        values = np.sort([[f(s) for f in self.eigenvalues]], axis=1)
        modes = Modes(values, np.zeros(1, dtype=np.int32), 0 * values, np.ones(1, dtype=bool), np.zeros(1, dtype=bool))
        return Point(np.array([self.aside * (s > self.gap), s]), np.array([0.0, 1.0]), np.ones((1, 1)), modes)

    def on_branch(self, place, ahead):
        return self.point(float(place[1]))

    def slopes(self, point, numbers):
        s = point.place[1]
        return (heights(self.point(s + 1e-5).modes, numbers) - heights(self.point(s).modes, numbers)) / 1e-5

    def step(self, length=1.0):
        return Inspection(self, self.point(0.0), self.point(length), length).step()


def places(step):
    return [change.point.place[1] for change in step.changes]


@pytest.mark.parametrize("depth", [1e-1, 1e-3, 1e-5, 1e-6])
@pytest.mark.parametrize("middle", [0.5, 0.3217, 0.999])
def test_two_changes_within_a_step_are_told_apart_from_none(depth, middle):
    """An eigenvalue that dips below zero, and one that does not quite: the ends of the step are alike."""
    step = Line(lambda s: (s - middle) ** 2 - depth, lambda s: 3.0).step(2.0)
    expected = [s for s in (middle - np.sqrt(depth), middle + np.sqrt(depth)) if 0 < s < 2]
    # the width of a parabola where it is 1e-12 of the step
    np.testing.assert_allclose(places(step), expected, rtol=0, atol=1e-9)
    assert step.undecided == ()
    above = Line(lambda s: (s - middle) ** 2 + depth, lambda s: 3.0).step(2.0)
    assert (above.changes, above.undecided) == ((), ())


def test_what_touches_zero_is_undecided():
    step = Line(lambda s: (s - 0.4) ** 2, lambda s: 3.0).step()
    assert step.changes == ()
    ((first, *_, last),) = step.undecided
    assert first.place[1] < 0.4 < last.place[1]
    assert last.place[1] - first.place[1] < 1e-3


def test_a_dip_that_is_sharp_and_eigenvalues_that_cross_each_other():
    for narrow in (0.1, 0.08):
        step = Line(lambda s, w=narrow: 1 - 1.01 * np.exp(-(((s - 0.41) / w) ** 2)), lambda s: 3.0).step()
        half = narrow * np.sqrt(np.log(1.01))
        np.testing.assert_allclose(places(step), [0.41 - half, 0.41 + half], rtol=0, atol=1e-9)
    step = Line(lambda s: s - 0.3, lambda s: 0.61 - s).step()
    assert [(c.before, c.after) for c in step.changes] == [(1, 0), (0, 1)]
    np.testing.assert_allclose(places(step), [0.3, 0.61], rtol=0, atol=1e-10)
    step = Line(lambda s: 0.3 - s, lambda s: 2 * (0.3 - s)).step()
    assert [(c.before, c.after) for c in step.changes] == [(0, 2)]
    assert step.undecided == ()


def test_a_smooth_step_is_cut_but_a_few_times():
    line = Line(lambda s: 1 - 1.5 * s + 0.3 * s**2, lambda s: 3.0)
    assert len(line.step().changes) == 1
    assert line.asked < 80  # some 50 of them to find the root


def test_a_step_that_leads_to_another_branch_is_refused():
    """As beside a bifurcation that is imperfect by a little: both have the same tangents."""
    with pytest.raises(Apart, match="another branch is too near"):
        Line(lambda s: 0.4 - s, gap=0.4, aside=0.01).step()


@pytest.mark.parametrize("width", [1e-12, 1e-6])
def test_a_mode_that_no_eigenvalue_shows_is_found_where_it_is_hidden(width):
    """As of a rod whose ends do not turn: what is hidden grows, and next to that place nothing is known."""
    line, place = Line(lambda s: 2.0 + s, lambda s: 3.0), 0.3217

    def point(s):
        own = Line.point(line, s)
        return replace(
            own, modes=replace(own.modes, hidden=own.modes.hidden + 2 * (s > place), known=np.abs([s - place]) > width)
        )

    line.point = point
    if width > 1e-8:
        with pytest.raises(Apart, match="stability is not known: rounding hides it"):
            line.step()
        return
    step = line.step()
    assert [(change.before, change.after) for change in step.changes] == [(0, 2)]
    np.testing.assert_allclose(places(step), place, rtol=0, atol=1e-11)
    ((first, *_, last),) = step.undecided
    assert last.place[1] - first.place[1] < 1e-4


def test_what_comes_and_goes_where_many_modes_vanish_is_one_change():
    """As of equal legs: next to where all vanish their signs are noise."""
    line = Line(*(lambda s, k=k: 0.3217 - s + 3e-5 * np.sin(1e12 * s + k) for k in range(3)))
    step = line.step()
    assert [(change.before, change.after) for change in step.changes] == [(0, 3)]
    np.testing.assert_allclose(places(step), 0.3217, rtol=0, atol=6e-5)


def test_a_mode_that_stays_neutral_is_no_change():
    """As of a ring that can be turned: its eigenvalue is zero but for rounding, of either sign."""
    line = Line(lambda s: 1e-9 * np.cos(40 * s), lambda s: 3.0)
    assert (line.point(0.0).index, line.point(1.0).index) == (0, 1)
    step = line.step()
    assert step.changes == ()
    assert step.undecided == ((step.before, step.after),)


# ---- two tubes by the pendulum ----


def alike(turns, EI=(1.0, 1.0), GJ=(1.0, 1.0), length=1.0):
    """Two tubes curved alike, with ``turns`` = L sqrt(c)."""
    kappa = turns / length * np.sqrt(sum(EI) / (EI[0] * EI[1]) / (1 / GJ[0] + 1 / GJ[1]))
    tubes = [
        mr.Rod(length=length, bending_stiffness=EI[k], torsional_stiffness=GJ[k], precurvature=(kappa, 0, 0)) for k in range(2)
    ]
    return mr.ConcentricTubes(tubes)


def hysteresis(turns):
    """How far past pi two tubes are turned where they snap: theta'' = c sin(theta), by elliptic functions."""

    def past(y):
        _, cn, dn, _ = ellipj(turns, np.sin(y / 2) ** 2)
        return 2 * np.arcsin(np.sin(y / 2) * cn / dn)

    tips = -np.geomspace(1e-6, 3.1, 4001)
    k = int(np.argmax(past(tips)))
    found = minimize_scalar(lambda y: -past(y), bounds=(tips[k + 1], tips[k - 1]), method="bounded", options={"xatol": 1e-13})
    return float(past(found.x))


UNLIKE = {"EI": (1.0, 20.0), "GJ": (0.1, 3.0)}


@pytest.mark.parametrize(
    ("beyond", "shape"),
    [(1e-5, {}), (1e-5, UNLIKE), (1e-4, {}), (1e-3, UNLIKE), (0.00268, {}), (0.00586, {}), (0.02, UNLIKE), (0.2732, {})],
)
def test_two_folds_however_near_each_other(beyond, shape):
    """Tubes turned against each other just beyond L sqrt(c) = pi/2, where they begin to snap, up to 2."""
    turns = np.pi / 2 * (1 + beyond)
    robot = alike(turns, **shape)
    found = mr.critical_loads(robot, robot.inputs(rotation=(0, 1)), start=robot.inputs(), count=2)
    assert [(c.fold, c.index_before, c.index_after) for c in found] == [(True, 0, 1), (True, 1, 0)]
    past = hysteresis(turns)
    # the unknowns are found to 1e-10 of what they are
    np.testing.assert_allclose(factors(found), [np.pi + past, np.pi - past], rtol=0, atol=2e-9)
    assert found.undecided == ()
    np.testing.assert_allclose(found.reached, np.pi + past, rtol=1e-9)


@pytest.mark.parametrize("short", [1e-6, 1e-3])
def test_none_where_tubes_just_do_not_snap(short):
    robot = alike(np.pi / 2 * (1 - short))
    found = mr.critical_loads(robot, robot.inputs(rotation=(0, 1)), start=robot.inputs(), up_to=4.0)
    assert (found, found.undecided, found.reached) == ((), (), 4.0)


def test_what_cannot_be_excluded_is_said():
    """Tubes that have a neutral mode at pi, as exactly as numbers tell."""
    robot = alike(np.pi / 2)
    said = pytest.warns(mr.IncompleteWarning, match=r"at load factors 3\.14159265\d* to 3\.14159265\d* a mode is so near")
    with said as warnings:
        found = mr.critical_loads(robot, robot.inputs(rotation=(0, 1)), start=robot.inputs(), up_to=4.0)
    assert [warning.filename for warning in warnings] == [__file__]
    ((low, high),) = found.undecided
    np.testing.assert_allclose([low, high], np.pi, rtol=1e-8)
    assert "undecided ((3.14159265" in repr(found)


@pytest.mark.filterwarnings("ignore::multirod.PlausibilityWarning")
def test_a_column_that_is_imperfect_by_a_little_only_bends():
    """The straight state passes by: it is another branch."""
    for bent in (1e-2, 1e-4, 1e-6):
        robot = column(bending_stiffness=(1.0, 1.3), precurvature=(bent, 0, 0))
        found = mr.critical_loads(robot, robot.inputs(tip_force=(0, 0, -1)), up_to=10.0)
        assert (found, found.undecided) == ((), ())
    robot = column(bending_stiffness=(1.0, 1.0001))
    found = mr.critical_loads(robot, robot.inputs(tip_force=(0, 0, -1)), count=2)
    np.testing.assert_allclose(factors(found), np.pi**2 / 4 * np.array([1, 1.0001]), rtol=CLOSE)


def test_what_stays_stable_has_no_critical_load():
    robot = column()
    assert mr.critical_loads(robot, robot.inputs(tip_force=(0, 0, 1)), up_to=50.0) == ()
    assert mr.critical_loads(robot, robot.inputs(tip_force=(0, 0, -1)), up_to=2.0) == ()


@pytest.fixture
def integrations(monkeypatch):
    """Counts all, one an active instance, in all problems of a backbone."""
    spent, own = [0], BackboneProblem._integrate

    def counted(problem):
        spent[0] += int(problem.active.numpy()[problem.order.numpy()[: problem.listed]].sum())
        own(problem)

    monkeypatch.setattr(BackboneProblem, "_integrate", counted)
    return spent


def test_no_more_integrations_than_are_allowed(integrations):
    """Of the second pair of modes of a column; each load that is found takes some more, for its solution."""
    robot = column()
    inputs = robot.inputs(tip_force=(0, 0, -1))
    for allowed in (100, 600):
        integrations[0] = 0
        with pytest.warns(mr.IncompleteWarning, match=f"the {allowed} integrations allowed were used up at a load factor of"):
            found = mr.critical_loads(robot, inputs, count=20, solver=mr.Shooting(max_integrations=allowed))
        assert 0 < integrations[0] <= allowed + 10 * len(found)
        assert all(load.load_factor <= found.reached for load in found)
    np.testing.assert_allclose(found[0].load_factor, np.pi**2 / 4, rtol=1e-6)


def test_equilibria_within_as_many(integrations):
    robot = column()
    inputs = robot.inputs(tip_force=(0, 0, -3))
    with pytest.warns(mr.IncompleteWarning, match="the 900 integrations allowed were used up before the search"):
        found = mr.equilibria(robot, inputs, solver=mr.Shooting(max_integrations=900))
    # on top: the unloaded sign, of every start, and what follows a circle of equilibria, by 63 steps of 0.1 rad
    assert integrations[0] <= 900 + 128 + 200 * found.status.size
    assert (found.status == mr.Status.CONVERGED).all()


def test_what_is_refused(wire):
    robot = mr.SingleRod(wire)
    with pytest.raises(mr.SolveError, match="the loads have no potential"):
        mr.critical_loads(robot, robot.inputs(tip_force=(0, 0, 1), tip_moment=(0, 0, 1)))
    with pytest.raises(ValueError, match="nothing is raised.* give start="):
        mr.critical_loads(robot, robot.inputs(rotation=1.0))
    with pytest.raises(ValueError, match="start = functions of arclength"):
        mr.critical_loads(robot, robot.inputs(), start=robot.inputs(distributed_force=lambda s: (0, 0, s)))
    with pytest.raises(ValueError, match="count"):
        mr.critical_loads(robot, robot.inputs(), count=0)
    with pytest.raises(ValueError, match="up_to"):
        mr.critical_loads(robot, robot.inputs(), up_to=-1.0)
    with pytest.raises(TypeError, match="needs Shooting"):
        mr.critical_loads(robot, robot.inputs(), solver=mr.Observer())
    with pytest.raises(TypeError, match="must be an assembly"):
        mr.critical_loads(wire, robot.inputs())
    buckled = column()
    with pytest.raises(mr.SolveError, match="at the start"):
        mr.critical_loads(buckled, buckled.inputs(tip_force=(0, 0, -4)), start=buckled.inputs(tip_force=(0, 0, -3)))


def test_a_line_that_becomes_slack_is_said_where_the_branch_has_a_kink():
    """It goes on beyond, stable, as a solve there finds: a search may begin there."""
    lines = [mr.Tendon(offset, driven="displacement", axial_stiffness=3e3) for offset in ((0.006, 0), (-0.003, 0.005))]
    rod = mr.Rod(length=0.3, bending_stiffness=0.02, torsional_stiffness=0.015, precurvature=(0.3, 0.1, 0), lines=lines)
    robot, pull = mr.SingleRod(rod), np.array([0.02, 0.01, -1.0])

    def pushed(factor):
        return robot.inputs(displacement=(0.001, 0.0005), tip_force=factor * pull)

    with pytest.raises(mr.SolveError, match=r"beyond a load factor of 0\.526.* a line becomes slack or taut, .* begin beyond it"):
        mr.critical_loads(robot, pushed(1.0), start=pushed(0.0))
    beyond = mr.solve(robot, pushed(0.55))
    assert beyond.slack.tolist() == [True, False]
    assert beyond.stability is mr.Stability.STABLE
    assert len(mr.critical_loads(robot, pushed(1.0), start=pushed(0.55), up_to=0.5)) == 0


def test_a_rod_that_is_pulled_is_followed_in_few_steps():
    """(15b): along tangents alone, 500 steps led to a load factor of 90."""
    robot = mr.SingleRod(mr.Rod(length=1.0, bending_stiffness=(1.0, 1.5), torsional_stiffness=0.8, precurvature=(0, 3, 0)))
    found = mr.critical_loads(robot, robot.inputs(tip_force=(0, 1, 1)), up_to=95.0, max_steps=300)
    assert len(found) == 0
    assert found.reached == 95.0
