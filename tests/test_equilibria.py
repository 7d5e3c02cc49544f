"""All equilibria from many starts, and the one that a solve without a guess means."""

from importlib import import_module
from warnings import catch_warnings, simplefilter

import numpy as np
import pytest
from scipy.optimize import brentq
from scipy.special import ellipk
from test_concentric_tubes import NAMES, assembly

import multirod as mr
from multirod.models.backbone.problem import BackboneProblem
from multirod.models.backbone.stability.stability import BackboneStability
from multirod.models.backbone.starts import quasirandom
from multirod.problem import BoundaryProblem
from multirod.solvers.starting.continua import Curve
from multirod.solvers.starting.multistart import Catalogue
from multirod.stability import Modes

SEVERAL = [name for name in NAMES if name.startswith(("09b", "14i"))]


def tubes_case(name, reference_cases, make_pose):
    case = next(c for c in reference_cases("concentric_tubes") if c["id"] == name)
    return (case, *assembly(case["inputs"], make_pose))


def degree(found):
    """Modes can appear or vanish but in pairs: the signs add up to that of the one straight equilibrium."""
    return int(((-1.0) ** found.index).sum())


@pytest.mark.parametrize("name", NAMES)
def test_every_stored_equilibrium_is_found(name, reference_cases, make_pose):
    case, robot, inputs = tubes_case(name, reference_cases, make_pose)
    found = mr.equilibria(robot, inputs).raise_if_failed()
    assert found.missing == 0
    length = max(tube["length"] for tube in case["inputs"]["tubes"])
    assert degree(found) == 1
    assert (np.diff(found.potential) > -1e-9).all()
    np.testing.assert_array_equal(np.sign(found.determinant), (-1.0) ** found.index)
    for stored in case["expected"].get("all_solutions", {"value": []})["value"]:
        distance = np.linalg.norm(found.tip_position - stored["tip_position"], axis=1)
        k = int(distance.argmin())
        assert distance[k] < 1e-6 * length
        assert found.index[k] == stored["negative_hessian_eigenvalues"]
        assert (found.stability[k] == mr.Stability.STABLE) == stored["stable"]
        # the integrator's 1e-8, and what the stored states leave of their residual
        np.testing.assert_allclose(found.potential[k], stored["potential_energy"], rtol=1e-7)


def pendulum(case):
    """Relative tip angles of two tubes, theta'' = c sin(theta) from the base angle to theta' = 0, by elliptic functions."""
    from scipy.special import ellipj

    (a, b), L = case["inputs"]["tubes"], case["inputs"]["tubes"][0]["length"]
    c = a["EI"] * b["EI"] / (a["EI"] + b["EI"]) * a["u_star"][0] * b["u_star"][0] * (1 / a["GJ"] + 1 / b["GJ"])
    start = case["inputs"]["base_angle_alpha"][1] - case["inputs"]["base_angle_alpha"][0]

    def base(tip):
        # theta = pi + 2 asin(k sn(K - x)), with k = sin((tip - pi)/2): the pendulum that hangs at pi
        k = np.sin((tip - np.pi) / 2)
        _, cn, dn, _ = ellipj(L * np.sqrt(c), k**2)
        return np.pi + 2 * np.arcsin(np.clip(k * cn / dn, -1, 1)) - start

    grid = np.linspace(5e-4, 2 * np.pi - 1e-3, 4000)  # pi, where opposite tubes are, is between two
    values = np.array([base(tip) for tip in grid])
    crossing = np.flatnonzero(values[:-1] * values[1:] < 0)
    return np.array([brentq(base, grid[k], grid[k + 1], xtol=1e-14) for k in crossing]), c


def relative_tip_angles(solution, case):
    """Angle of tube 2 from tube 1 at the tip, from the base torque by the pendulum's first integral and its direction."""
    _, c = pendulum(case)
    alpha = np.array(case["inputs"]["base_angle_alpha"])
    inner, outer = (solution.rod(k, nodes=2).curvature[..., 0, 2] for k in range(2))
    rate = outer - inner
    # from 0 to pi: a mirror image has the same
    return np.arccos(np.clip(np.cos(alpha[1] - alpha[0]) + rate**2 / (2 * c), -1, 1))


@pytest.mark.parametrize("name", SEVERAL)
def test_two_tubes_by_elliptic_functions(name, reference_cases, make_pose):
    """All equilibria of two overlapping tubes, from another theory: their number and tip angles."""
    case, robot, inputs = tubes_case(name, reference_cases, make_pose)
    angles, _ = pendulum(case)
    stored = case["expected"].get("all_relative_tip_angles", {"value": [case["expected"]["relative_tip_angle"]["value"]]})[
        "value"
    ]
    # near the fold the angle's error is the root of the base angle's
    assert all(np.abs(angles - angle).min() < 1e-9 for angle in stored)
    found = mr.equilibria(robot, inputs)
    folded = np.sort(np.arccos(np.cos(angles)))
    np.testing.assert_allclose(np.sort(relative_tip_angles(found, case)), folded, rtol=0, atol=1e-5)
    chosen = mr.solve(robot, inputs).raise_if_failed()
    assert chosen.stability is mr.Stability.STABLE
    assert np.linalg.norm(found.unknowns - chosen.unknowns, axis=1).min() < 1e-4


def strongly_curved(turns):
    """Two tubes with L sqrt(c) = ``turns``: what an equilibrium's base torque does to its tip grows as exp(turns)."""
    tube = mr.Rod(length=1.0, bending_stiffness=1.0, torsional_stiffness=1.0, precurvature=(turns, 0, 0))
    return mr.ConcentricTubes([tube, tube])


def test_branches_lead_to_what_starts_miss():
    """Starts reach the stable states from within 1e-5 only; theta'' = c sin(theta) counts them."""
    turns, angle = 12.0, 3.1
    tube = {"EI": 1.0, "GJ": 1.0, "u_star": (turns, 0, 0), "length": 1.0}
    tips, _ = pendulum({"inputs": {"tubes": [tube, tube], "base_angle_alpha": (0.0, angle)}})
    robot = strongly_curved(turns)
    found = mr.equilibria(robot, robot.inputs(rotation=(0, angle)))
    assert found.missing == 0
    assert (degree(found), (found.index == 0).sum()) == (1, 2)
    # two tips lie within 1e-4 of aligned: between the points of the grid
    assert len(found.index) >= len(tips)


def test_what_only_rounding_decides_is_found_or_said():
    """Here a branch comes so near to one of the two stable states that processors differ in whether it gets there."""
    robot = strongly_curved(12.0)
    with catch_warnings(record=True) as said:
        simplefilter("always")
        found = mr.equilibria(robot, robot.inputs(rotation=(0, 2.0)))
    assert found.missing == abs(degree(found) - 1)
    assert (found.index == 0).sum() == 2 - found.missing
    assert [warning.category for warning in said] == [mr.IncompleteWarning] * (found.missing > 0)


@pytest.mark.parametrize(
    ("counts", "absent"),
    [
        ([1], 0),
        ([], 1),
        ([2], 1),
        ([2, 1], 0),
        ([1, 1], 1),
        ([0, 1], 2),  # a stable one, and one that is in a pair with what was found
        ([0, 0, 2, 2, 1], 2),
        ([2, 0, 2, 2, 1], 2),
        ([2, 2, 2, 2, 1], 0),
        ([3, 1, 1], 2),  # the third needs another of index 1, and that of index 2 as well
    ],
)
def test_all_but_one_stable_state_come_in_pairs_of_neighbouring_index(counts, absent):
    """(8b), by hand: which pairs are left alone."""
    assert import_module("multirod.studies.equilibria")._absent(np.array(counts, dtype=int)) == absent


def test_stable_states_that_are_missing_are_known_of_though_the_signs_add_up(monkeypatch):
    """Of nine, starts reach five of higher index first, whose signs add up to 1."""
    robot = strongly_curved(14.0)
    inputs = robot.inputs(rotation=(0, 3.1))
    with monkeypatch.context() as patch:
        patch.setattr(import_module("multirod.studies.equilibria"), "_search_on", lambda *_: None)
        with pytest.warns(mr.IncompleteWarning, match="are missing at least, by what is unstable"):
            found = mr.equilibria(robot, inputs, starts=64)
    assert not (found.index == 0).any()
    assert degree(found) == 1
    assert 2 <= found.missing <= 9 - len(found.index)
    whole = mr.equilibria(robot, inputs, starts=64)
    np.testing.assert_array_equal(np.sort(whole.index), [0, 0, 1, 1, 2, 2, 3, 3, 4])
    assert whole.missing == 0


def test_a_list_that_breaks_the_rule_of_signs_says_so(monkeypatch):
    monkeypatch.setattr(
        import_module("multirod.studies.equilibria"), "FOLLOWED", 0
    )  # the package shows the function by this name
    robot = strongly_curved(12.0)
    with pytest.warns(mr.IncompleteWarning, match="[12] equilibria are missing at least, by what is unstable"):
        found = mr.equilibria(robot, robot.inputs(rotation=(0, 3.1)))
    assert found.missing == abs(degree(found) - 1)
    assert f"; {found.missing} missing at least)" in repr(found)
    assert isinstance(found[0], mr.Solution)


def test_what_the_rule_cannot_say(wire):
    """Of a state with a neutral mode, which may be several in one place, and of closed loops."""
    load = np.pi**2 / 4
    robot = mr.SingleRod(mr.Rod(length=1.0, bending_stiffness=(1.0, 1.5), torsional_stiffness=0.8))
    assert mr.equilibria(robot, robot.inputs(tip_force=(0, 0, -load)), starts=128).missing is None
    assert mr.equilibria(mr.SingleRod(wire)).missing == 0


def past_the_snap(reference_cases, make_pose):
    """Two tubes turned further against each other, from aligned, than they stay: the snap is stored, at 3.66 rad."""
    _, robot, inputs = tubes_case("14i_ctr_near_fold_0.0001", reference_cases, make_pose)
    return robot, robot.inputs(rotation=(0, 3.7), translation=inputs.translation)


def test_where_the_natural_branch_ends_the_lowest_stable_one_is_meant(reference_cases, make_pose):
    robot, inputs = past_the_snap(reference_cases, make_pose)
    solution = mr.solve(robot, inputs)
    assert solution.status is mr.Status.LOWEST_ENERGY
    assert not solution.status.failed
    assert "lowest potential energy" in solution.status.message
    assert solution.integrations < 2000  # from 32 starts in a round; 5700 from 128
    found = mr.equilibria(robot, inputs)
    np.testing.assert_allclose(solution.potential, found.potential[0], rtol=1e-9)
    assert solution.residual < 1e-9
    assert np.linalg.norm(found.unknowns - solution.unknowns, axis=1).min() < 1e-6
    # the same alone, in a batch, and as the first sample of a motion
    rotation = np.array([[0.2, 1.0], inputs.rotation, [0.2, 0.7]])
    batch = mr.solve(robot, robot.inputs(rotation=rotation, translation=inputs.translation))
    assert batch.status.tolist() == [mr.Status.CONVERGED, mr.Status.LOWEST_ENERGY, mr.Status.CONVERGED]
    np.testing.assert_array_equal(batch.unknowns[1], solution.unknowns)
    motion = robot.inputs(rotation=inputs.rotation + np.linspace(0, 0.02, 4)[:, None] * (0, 1), translation=inputs.translation)
    history = mr.simulate(robot, motion, time=0.01 * np.arange(4))
    assert history.status.tolist() == [mr.Status.LOWEST_ENERGY, *[mr.Status.CONVERGED] * 3]
    np.testing.assert_array_equal(history.unknowns[0], solution.unknowns)


def test_of_several_stable_ones_the_lowest_is_meant(reference_cases, make_pose):
    """Without steps to follow the natural branch in: three are stable."""
    _, robot, inputs = tubes_case("09c_ctr_three_tube_5", reference_cases, make_pose)
    solution = mr.solve(robot, inputs, solver=mr.Shooting(max_continuation_steps=1))
    assert solution.status is mr.Status.LOWEST_ENERGY
    np.testing.assert_allclose(solution.potential, mr.equilibria(robot, inputs).potential[0], rtol=1e-7)


def test_what_is_not_known_to_be_stable_is_never_returned(reference_cases, make_pose, monkeypatch):
    robot, inputs = past_the_snap(reference_cases, make_pose)
    for known, value in ((False, 1.0), (True, -1.0), (True, 0.0)):
        answer = Modes(
            np.array([[value]]), np.zeros(1, dtype=np.int32), np.zeros((1, 1)), np.array([known]), np.zeros(1, dtype=bool)
        )
        monkeypatch.setattr(BackboneStability, "modes", lambda self, answer=answer: answer)
        solution = mr.solve(robot, inputs)
        assert solution.status is mr.Status.BRANCH_END
        assert np.isnan(solution.unknowns).all()


def three_tubes(rng):
    """A random robot of three strongly curved tubes, its base angles, and a tip force half of the time."""
    EI = 0.005 * np.cumprod([1.0, *rng.uniform(2, 4, 2)])
    length = np.sort(0.12 + np.array([0.2, 0.12, 0.06]) * rng.uniform(0.6, 1.4, 3))[::-1]
    tubes = []
    for k in range(3):
        curved = rng.uniform(0.3, 1.0) * length[k]
        curvature = (rng.uniform(5, (30, 25, 12)[k]), rng.uniform(-5, 5), 0.0)
        pieces = [(length[k] - curved, (0, 0, 0)), (curved, curvature)]
        tubes.append(mr.Rod(length=length[k], bending_stiffness=EI[k], torsional_stiffness=EI[k] / 1.3, precurvature=pieces))
    robot = mr.ConcentricTubes(tubes)
    values = {"rotation": rng.uniform(-np.pi, np.pi, 3), "translation": -np.sort(rng.uniform(0, 0.08, 3))[::-1]}
    if rng.random() < 0.5:
        values["tip_force"] = rng.normal(size=3) * 0.5
    return robot, robot.inputs(**values)


def test_random_tubes_are_stable_or_said_to_have_failed():
    rng = np.random.default_rng(20)
    solved = 0
    for _ in range(25):
        solution = mr.solve(*three_tubes(rng))
        if not solution.status.failed:
            assert solution.stability is mr.Stability.STABLE
            solved += 1
    assert solved >= 24


def test_random_tubes_miss_none_that_is_known_of():
    """None that the signs would tell of, nor the one on the natural branch."""
    rng = np.random.default_rng(21)
    for _ in range(4):
        robot, inputs = three_tubes(rng)
        found = mr.equilibria(robot, inputs)
        assert degree(found) == 1
        chosen = mr.solve(robot, inputs).raise_if_failed()
        assert np.linalg.norm(found.unknowns - chosen.unknowns, axis=1).min() < 1e-4


def test_what_rounding_keeps_from_the_tolerance_is_no_equilibrium_of_a_list(monkeypatch):
    """Branches come by what the integrator's noise hides, which Newton's method may not lead on from."""
    study = import_module("multirod.studies.equilibria")
    robot = strongly_curved(6.0)
    inputs = robot.inputs(rotation=(0, 2.0))
    whole = mr.equilibria(robot, inputs)
    lost = 1

    def losing(*arguments, guess, **options):
        guess[:lost] = 1e12
        return mr.solve(*arguments, guess=guess, **options)

    monkeypatch.setattr(study, "solve", losing)
    with pytest.warns(mr.IncompleteWarning, match="missing at least"):
        found = mr.equilibria(robot, inputs)
    assert len(found.status) == len(whole.status) - 1
    assert not found.failed.any()
    assert found.missing == abs(degree(found) - 1) == 1
    lost = None
    with pytest.raises(mr.SolveError, match="no equilibrium was found within the tolerance: loosen"):
        mr.equilibria(robot, inputs)


def test_a_buckled_rod_has_three():
    """Between the critical loads of its two axes: straight, and bent to either side."""
    robot = mr.SingleRod(mr.Rod(length=1.0, bending_stiffness=(1.0, 1.5), torsional_stiffness=0.8))
    load = 1.2 * np.pi**2 / 4
    found = mr.equilibria(robot, robot.inputs(tip_force=(0, 0, -load)))
    assert found.index.tolist() == [0, 0, 1]
    np.testing.assert_allclose(found.tip_position[0] * (1, -1, 1), found.tip_position[1], rtol=0, atol=1e-8)
    np.testing.assert_allclose(found.potential[2], load, rtol=1e-9)
    # a single rod's buckling is said, not hidden
    buckled = mr.solve(robot, robot.inputs(tip_force=(0, 0, -load)))
    assert buckled.status is mr.Status.BIFURCATED
    assert np.abs(buckled.unknowns - found.unknowns[:2]).max(axis=1).min() < 1e-6


def round_column(**more):
    return mr.SingleRod(mr.Rod(length=1.0, bending_stiffness=1.0, torsional_stiffness=0.8, **more))


def test_a_round_column_buckles_in_any_direction_and_that_is_listed_once():
    """In each of two modes, by the elastica: sqrt(P) = m K(k), and m = 1, 3 quarters of a wave lean by 2 k / sqrt(P)."""
    robot, load = round_column(), 25.0
    found = mr.equilibria(robot, robot.inputs(tip_force=(0, 0, -load))).raise_if_failed()
    assert found.continuum.tolist() == [True, True, False]
    assert found.index.tolist() == [0, 2, 4]
    assert found.stability.tolist() == [mr.Stability.FOLD, mr.Stability.UNSTABLE, mr.Stability.UNSTABLE]
    assert found.missing == 0  # circles count for nothing
    for k, quarters in enumerate((1, 3)):
        m = brentq(lambda m, quarters=quarters: quarters * ellipk(m) - np.sqrt(load), 1e-9, 1 - 1e-12, xtol=1e-15)
        leans = np.linalg.norm(found.tip_position[k, :2])
        np.testing.assert_allclose(leans, 2 * np.sqrt(m / load), rtol=1e-7)  # the integrator's
        # turned about the axis it is an equilibrium too, and known as one
        turned = np.array(found.unknowns[k])
        turned[:2] = turned[1], -turned[0]
        again = mr.solve(robot, robot.inputs(tip_force=(0, 0, -load)), guess=turned).raise_if_failed()
        np.testing.assert_allclose(again.unknowns, turned, atol=1e-8)
    assert repr(found) == "Equilibria(batch (3,): 3 CONVERGED; 2 stand for a whole circle of them)"
    assert "FOLD, a whole circle" in found._repr_html_()


@pytest.mark.filterwarnings("ignore::multirod.PlausibilityWarning")
def test_a_circle_that_the_integrator_does_not_resolve_is_said(monkeypatch):
    """A rod that is twisted at rest is round all the same. By starts alone: branches take longer."""
    monkeypatch.setattr(import_module("multirod.studies.equilibria"), "_connected", lambda *_: [])
    robot = round_column(precurvature=(0, 0, 3.0))
    inputs = robot.inputs(tip_force=(0, 0, -4.5))
    with pytest.warns(mr.IncompleteWarning, match="1 closed curve of equilibria, .*give a tighter one"):
        found = mr.equilibria(robot, inputs, starts=128)
    assert found.index.tolist() == [2]
    found = mr.equilibria(robot, inputs, starts=128, solver=mr.Shooting(integrator=mr.RK45(rtol=1e-11, atol=1e-13)))
    assert found.continuum.tolist() == [True, False]
    assert found.index.tolist() == [0, 2]


def test_a_curve_holds_what_is_on_it_and_ends_where_there_is_none():
    robot = round_column()
    problem = robot.problem(robot.inputs(tip_force=(0, 0, -3.0)), integrator=mr.RK45(), device="cpu")
    bent = mr.solve(robot, robot.inputs(tip_force=(0, 0, -3.0)), guess=np.array([2.0, 0.0, 0.0])).raise_if_failed()
    curve = Curve.through(problem, bent.unknowns, bent.gamma)
    radius = np.linalg.norm(bent.unknowns)
    np.testing.assert_allclose(np.linalg.norm(curve.points, axis=1), radius, rtol=1e-6)
    assert 63 <= len(curve.points) < 130
    for angle in np.linspace(0, 2 * np.pi, 301):
        place = radius * np.array([np.cos(angle), np.sin(angle), 0.0])
        assert curve.holds(place)
        assert not curve.holds(place * 1.01)
        assert not curve.holds(place + (0, 0, 0.02))
    catalogue = Catalogue(1.0, 1e-9, problem)
    for unknowns in (bent.unknowns, -bent.unknowns):
        catalogue.add(unknowns, bent.gamma)
    assert (len(catalogue.unknowns), catalogue.signs, list(catalogue.curves)) == (1, [0.0], [0])
    straight = np.zeros(3)
    _, gamma = problem.evaluate(straight[None])
    assert Curve.through(problem, straight, gamma[0]) is None
    # a pitchfork: neutral, and nothing beside it is an equilibrium
    oval = mr.SingleRod(mr.Rod(length=1.0, bending_stiffness=(1.0, 1.5), torsional_stiffness=0.8))
    critical = oval.problem(oval.inputs(tip_force=(0, 0, -(np.pi**2) / 4)), integrator=mr.RK4(400), device="cpu")
    _, gamma = critical.evaluate(straight[None])
    assert np.linalg.svd(gamma[0], compute_uv=False)[-1] < 1e-8
    assert Curve.through(critical, straight, gamma[0]) is None


def test_potential_of_weight_and_profiles_is_their_work(difference):
    """Its slope by a load is the work that a unit of it has done, at equilibrium."""
    soft = {"shear_stiffness": 4.0, "axial_stiffness": 6.0}
    robot = mr.SingleRod(mr.Rod(length=0.5, bending_stiffness=0.02, torsional_stiffness=0.015, linear_density=0.1, **soft))

    def potential(size, name):
        loads = {"gravity": (1.0, 0.0, -3.0), "distributed_force": lambda s: (0.05 * s, -0.04, 0.02)}
        if name == "gravity":
            loads["gravity"] = (1.0 + size, 0.0, -3.0)
        else:
            loads["tip_force"] = (0.0, size, 0.05)
        return mr.solve(robot, robot.inputs(**loads))

    for name, density, axis in (("gravity", 0.1, 0), ("tip_force", None, 1)):
        slope = difference(lambda size, name=name: potential(size, name).potential, 0.05)
        shape = potential(0.0, name).rod(0, nodes=401)
        p = shape.position[:, axis]
        work = p[-1] if density is None else density * np.trapezoid(p, shape.arclength)
        # the integrator's 1e-8 of the energy over the step, and 400 trapezoids
        np.testing.assert_allclose(slope, -work, rtol=1e-5)


def test_one_equilibrium_is_found_once(wire):
    robot = mr.SingleRod(wire)
    found = mr.equilibria(robot)
    assert found.batch_shape == (1,)
    np.testing.assert_allclose(found.unknowns, [(14, 5, 0)], rtol=0, atol=4e-9)  # 1e-9 over the smallest singular value, 0.3


def test_refusals(wire, monkeypatch):
    robot = mr.SingleRod(wire)
    with pytest.raises(TypeError, match="needs Shooting"):
        mr.equilibria(robot, solver=mr.ScipyShooting())
    with pytest.raises(ValueError, match="starts = 0 is not allowed"):
        mr.equilibria(robot, starts=0)
    with pytest.raises(TypeError, match="robot must be an assembly"):
        mr.equilibria(wire)
    monkeypatch.setattr(BackboneProblem, "starts", BoundaryProblem.starts)
    with pytest.raises(TypeError, match="SingleRod offers no starts"):
        mr.equilibria(robot)


def test_a_search_goes_on_while_some_are_missing_or_new():
    catalogue = Catalogue(1.0)
    catalogue.end_round()
    catalogue.end_round()
    assert not catalogue.settled  # nothing found
    saddle, minimum = np.diag([1.0, -1.0]), np.eye(2)
    catalogue.add(np.array([3.0, 1.0]), saddle)
    for _ in range(3):
        catalogue.end_round()
        assert not catalogue.settled  # the signs do not add up
    for unknowns in ([0.0, 0.0], [9.0, 0.0], [9.0, 1e-9]):
        catalogue.add(np.array(unknowns), minimum)
    assert len(catalogue.unknowns) == 3
    for settled in (False, False, True):
        catalogue.end_round()
        assert catalogue.settled is settled
    assert catalogue.missing == 0
    catalogue.add(np.array([3.0, 1.0 + 1e-7]), minimum)  # beside the saddle, across a fold
    assert len(catalogue.unknowns) == 4
    assert not catalogue.settled


def test_what_a_tolerance_leaves_of_one_equilibrium_is_no_second_one():
    """In the direction of a mode that is nearly neutral, far more than elsewhere."""
    gamma = np.diag([1.0, 1e-5])
    catalogue = Catalogue(1.0, 1e-9)
    for unknowns in ([5.0, 0.0], [5.0, 1e-4], [5.0, 1e-3], [5.0 + 1e-4, 0.0]):
        catalogue.add(np.array(unknowns), gamma)
    np.testing.assert_array_equal(catalogue.unknowns, [[5.0, 0.0], [5.0, 1e-3], [5.0 + 1e-4, 0.0]])


def test_several_equilibria_are_taken_in_as_one_after_the_other():
    rng, one, all_ = np.random.default_rng(0), Catalogue(1.0, 1e-9), Catalogue(1.0, 1e-9)
    places = rng.choice([0.0, 1.0, 2.0], size=(40, 2)) + rng.choice([0.0, 1e-7, 1e-3], size=(40, 1))
    gammas = np.array([np.diag([1.0, sign]) for sign in rng.choice([-1.0, 1.0, 1e-7], size=40)])
    for unknowns, gamma in zip(places, gammas, strict=True):
        one.add(unknowns, gamma)
    for some in (slice(0, 25), slice(25, 40)):
        all_.add_all(places[some], gammas[some])
    assert 9 < len(one.unknowns) < 40
    np.testing.assert_array_equal(all_.unknowns, one.unknowns)
    assert all_.signs == one.signs


def test_starts_fill_their_cube():
    points = quasirandom(np.arange(4096), 3)
    assert (np.abs(points) <= 1).all()
    np.testing.assert_array_equal(points[0], 0)
    np.testing.assert_array_equal(points[100:110], quasirandom(np.arange(100, 110), 3))
    counts, _ = np.histogramdd(points, bins=4)
    # 64 on average; random points would spread by 8
    assert counts.min() > 52
    assert counts.max() < 76


# ---- columns and platforms ----


@pytest.mark.parametrize(
    ("force", "index"), [(2.0, [0]), (3.0, [0, 0, 1]), (9.0, [0, 0, 1, 1, 2]), (25.0, [0, 0, 1, 1, 2, 2, 3])]
)
def test_every_equilibrium_of_a_column_is_found(force, index):
    """Straight, and buckled either way about each axis and, beyond nine times the first load, in the second mode."""
    robot = mr.SingleRod(mr.Rod(length=1.0, bending_stiffness=(1.0, 1.3), torsional_stiffness=0.8))
    found = mr.equilibria(robot, robot.inputs(tip_force=(0, 0, -force))).raise_if_failed()
    assert found.index.tolist() == index
    assert degree(found) == 1
    np.testing.assert_allclose(found.potential[-1], force, rtol=1e-9)  # straight: all of its length the load has moved
    for k in range(0, len(index) - 1, 2):  # mirror images
        np.testing.assert_allclose(found.potential[k], found.potential[k + 1], rtol=1e-8)
        np.testing.assert_allclose(found.tip_position[k][:2], -found.tip_position[k + 1][:2], atol=1e-6)


def test_a_platform_on_buckled_columns():
    """Three legs softer about one axis, on a triangle that is its own image in the plane y = 0: so are the swayed states."""
    leg = mr.Rod(length=1.0, bending_stiffness=(1.0, 1.2), torsional_stiffness=0.8, axial_stiffness=1e3)
    base = np.tile(np.eye(4), (3, 1, 1))
    base[:, :2, 3] = [(0.3, 0), (-0.15, 0.25), (-0.15, -0.25)]
    robot = mr.ParallelRods(legs=[leg] * 3, base=base, platform=base)
    (critical,) = mr.critical_loads(robot, robot.inputs(tip_force=(0, 0, -1)), solver=mr.Shooting())
    found = mr.equilibria(robot, robot.inputs(tip_force=(0, 0, -1.1 * critical.load_factor)), starts=128).raise_if_failed()
    assert found.index.tolist()[:2] == [0, 0]
    np.testing.assert_allclose(found.potential[0], found.potential[1], rtol=1e-8)
    np.testing.assert_allclose(found.tip_position[0] * (1, -1, 1), found.tip_position[1], atol=1e-5)
    assert np.linalg.norm(found.tip_position[0][:2]) > 0.1
    assert found.missing is None  # closed loops
    straight = np.linalg.norm(found.tip_position[:, :2], axis=1) < 1e-6
    assert found.index[straight].tolist() == [1]


def test_what_a_solve_finds_of_closed_loops_is_listed():
    """Far beyond where they buckle starts come to the upright state alone, which is unstable."""
    leg = mr.Rod(length=1.0, bending_stiffness=(1.0, 1.2), torsional_stiffness=0.8, axial_stiffness=1e3)
    base = np.tile(np.eye(4), (3, 1, 1))
    base[:, :2, 3] = [(0.3, 0), (-0.15, 0.25), (-0.15, -0.25)]
    robot = mr.ParallelRods(legs=[leg] * 3, base=base, platform=base)
    inputs = robot.inputs(tip_force=(0.3, 0.2, -100))
    there = mr.solve(robot, inputs).raise_if_failed()
    assert there.stability == mr.Stability.STABLE
    found = mr.equilibria(robot, inputs, starts=16)
    assert found.index.tolist()[0] == 0
    assert found.index.max() > 0  # what starts come to
    np.testing.assert_allclose(found.potential[0], there.potential, rtol=1e-9)
    np.testing.assert_allclose(found.unknowns[0], there.unknowns, rtol=1e-5, atol=1e-5)  # of one equilibrium, as told there
