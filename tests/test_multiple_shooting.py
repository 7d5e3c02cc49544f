"""Multiple shooting: rods whose sensitivities grow by more from base to tip than numbers have digits."""

import re
from dataclasses import replace
from itertools import pairwise
from threading import Event

import numpy as np
import pytest
from scipy.integrate import solve_bvp
from scipy.optimize import brentq
from scipy.spatial.transform import Rotation
from scipy.special import ellipeinc, ellipkinc, ellipkm1

import multirod as mr
from multirod import batch
from multirod.models.backbone.passes.shortcuts import POSES_APART
from multirod.models.backbone.segments.growth import largest_singular_value
from multirod.models.backbone.segments.segments import BackboneSegments
from multirod.recording.samples import first_instances
from multirod.results.segment_system import System
from multirod.segments import Breakpoints, Cuts, Propagation
from multirod.solvers import multiple_shooting
from multirod.solvers.continuation import pace
from multirod.solvers.continuation import paths as continuation
from multirod.solvers.multiple_shooting import MultipleShooting
from multirod.solvers.segments import equilibria as segmented_equilibria
from multirod.solvers.segments import path as segmented_path
from multirod.solvers.segments.band import VECTORS, Step, Systems
from multirod.solvers.segments.path import SegmentedPaths
from multirod.stability import Modes

EXTREME = (
    "14a_big_force_a400_psi1p571",
    "14a_big_force_a10000_psi1p571",
    "14a_big_force_a1e+06_psi1p571",
    "14b_big_force_3d_a10000",
    "14c_torsion_ratio_0.0001",
    "14e_many_loops_2",
)


@pytest.fixture
def soft() -> mr.SingleRod:
    """A precurved rod of two axes, about which 150 N is 1200 EI/L^2."""
    return mr.SingleRod(
        mr.Rod(length=0.4, bending_stiffness=(0.02, 0.03), torsional_stiffness=0.012, precurvature=(4, -2, 6)),
    )


def paths_of(segments: BackboneSegments, max_steps: int = 100) -> SegmentedPaths:
    """The way of the first instance."""
    return SegmentedPaths(
        segments,
        np.zeros(1, dtype=int),
        tolerance=np.array([1e-9]),
        max_iterations=30,
        max_steps=max_steps,
        allowed=np.array([1000]),
        integrator=mr.RK45(),
    )


def one_segment(segments: BackboneSegments, instance: int, unknowns: np.ndarray, steps: int) -> Breakpoints:
    """The whole rod of 0.4 m."""
    state = segments.base_state(np.array([instance]), unknowns[None])
    return Breakpoints(np.array([0, 0.4]), state, unknowns, np.array([steps]))


def elastica(load: float, angle: float) -> tuple[float, float]:
    """Tip of a planar elastica of unit length, along and across a force of ``F L^2/EI = load`` that starts at ``angle`` to the
    base.

    With ``t`` the angle of the tangent to the force and ``k^2`` the load, ``t'' = k^2 sin t``, ``t(0) = angle``, ``t'(1) = 0``,
    so ``cos(t/2) = p sin f`` with ``p = cos(t(1)/2)`` leads to elliptic integrals of ``f``; where ``p`` nears 1, ``1 - p^2`` is
    sought by its logarithm, as it is of the order of ``exp(-2 k)``.
    """
    k = np.sqrt(load)

    def start(m1: float) -> float:
        return float(np.arcsin(np.cos(angle / 2) / np.sqrt(1 - m1)))

    def excess(log: float) -> float:
        m1 = np.exp(log)
        return float(ellipkm1(m1) - ellipkinc(start(m1), 1 - m1) - k)

    most = np.log(np.sin(angle / 2) ** 2)  # the tip turned no further than the base
    m1 = np.exp(brentq(excess, -700.0, most - 1e-12, xtol=1e-14, rtol=1e-14))
    f = start(m1)
    along = 1 - 2 / k * (ellipeinc(np.pi / 2, 1 - m1) - ellipeinc(f, 1 - m1))
    return float(along), float(2 * np.sqrt(1 - m1) / k * np.cos(f))


@pytest.mark.parametrize("load", [10.0, 100.0, 1e4])
@pytest.mark.parametrize("angle", [0.5, np.pi / 2, 2.5])
def test_elastica_by_elliptic_integrals(load, angle):
    """The error is the integrator's, 1e-8 of each segment."""
    rod = mr.Rod(length=0.5, bending_stiffness=(0.05, 0.02), torsional_stiffness=0.013)
    force = load * 0.02 / 0.25 * np.array([np.sin(angle), 0, np.cos(angle)])
    robot = mr.SingleRod(rod)
    solution = mr.solve(robot, robot.inputs(tip_force=force), solver=mr.MultipleShooting()).raise_if_failed()
    along, across = elastica(load, angle)
    direction = np.array([np.sin(angle), 0, np.cos(angle)])
    normal = np.array([-np.cos(angle), 0, np.sin(angle)])
    np.testing.assert_allclose(solution.tip_position, 0.5 * (along * direction + across * normal), rtol=0, atol=1e-8 * 0.5)


@pytest.mark.filterwarnings("ignore::multirod.PlausibilityWarning")
@pytest.mark.parametrize("name", EXTREME)
def test_what_single_shooting_cannot_solve(name, reference_cases, make_pose):
    """``Shooting`` turns to it by itself. 1e-8 of the length is a hundredth of what default settings promise."""
    case = next(case for case in reference_cases("single_rod") if case["id"] == name)
    stored, base = case["inputs"]["rods"][0], case["inputs"]["base"]
    K = stored["K"]
    rod = mr.Rod(length=stored["length"], bending_stiffness=K[:2], torsional_stiffness=K[2], precurvature=tuple(stored["u_star"]))
    robot = mr.SingleRod(rod, base=make_pose(base["R0"], base["p0"]))
    inputs = robot.inputs(tip_force=case["inputs"]["loads"]["tip_force_world"])
    assert mr.solve(robot, inputs, solver=mr.Shooting(fallback=False)).status.failed
    solution = mr.solve(robot, inputs)
    assert solution.status == mr.Status.MULTIPLE_SHOOTING
    assert solution.residual < 1e-9
    expected = case["expected"]
    for key in ("tip_position", "tip_rotation"):
        error = np.linalg.norm(getattr(solution, key) - np.array(expected[key]["value"]))
        assert error < 1e-8 * (stored["length"] if key == "tip_position" else 1.0) + expected[key]["abs_unc"], key
    shape = solution.rod(0, nodes=5)
    np.testing.assert_allclose(shape.position[-1], solution.tip_position, rtol=0, atol=1e-9 * stored["length"])
    np.testing.assert_allclose(shape.moment[0], np.array(base["R0"]).T @ expected["base_moment"]["value"], rtol=1e-7, atol=1e-9)
    assert np.isnan(solution.gamma).all()
    assert np.isnan(solution.condition)
    assert solution.stability == mr.Stability.STABLE


def test_a_helix_held_by_its_wrench_reaches_the_end_of_its_natural_branch(reference_cases, make_pose, monkeypatch):
    """That it is not the stored helix is known; steps a tenth as long reach the same state."""
    case = next(case for case in reference_cases("single_rod") if case["id"] == "05b_helix_terminal_wrench_c")
    stored, base, loads = case["inputs"]["rods"][0], case["inputs"]["base"], case["inputs"]["loads"]
    rod = mr.Rod(length=stored["length"], bending_stiffness=stored["K"][0], torsional_stiffness=stored["K"][2])
    robot = mr.SingleRod(rod, base=make_pose(base["R0"], base["p0"]))
    inputs = robot.inputs(tip_force=loads["tip_force_world"], tip_moment=loads["tip_moment_world"])
    solution = mr.solve(robot, inputs, solver=mr.MultipleShooting()).raise_if_failed()
    for module in (segmented_path, segmented_equilibria):
        monkeypatch.setattr(module, "CONTRACTION", 0.03)
    monkeypatch.setattr(segmented_path, "SAFE_LOAD", 0.5)
    monkeypatch.setattr(segmented_path, "LOAD_RATIO", 0.05)
    slow = mr.solve(robot, inputs, solver=mr.MultipleShooting()).raise_if_failed()
    assert slow.integrations > 2 * solution.integrations
    np.testing.assert_allclose(slow.tip_position, solution.tip_position, rtol=0, atol=1e-9 * stored["length"])
    assert solution.stability == mr.Stability.UNKNOWN


def test_an_independent_collocation_agrees(soft):
    """``solve_bvp`` from this shape, and in equations of its own: world components, rotation matrix."""
    force = np.array([60.0, -50.0, 30.0])
    solution = mr.solve(soft, soft.inputs(tip_force=force), solver=mr.MultipleShooting())
    assert solution.status == mr.Status.MULTIPLE_SHOOTING
    shape = solution.rod(0, nodes=401)
    K, u_star = np.array([0.02, 0.03, 0.012]), np.array([4.0, -2.0, 6.0])

    def rates(s, y):
        R, m = np.moveaxis(y[3:12].reshape(3, 3, -1), 2, 0), y[12:].T
        u = u_star + np.einsum("sji,sj->si", R, m) / K
        columns = np.stack([np.cross(u, e) for e in np.eye(3)], axis=2)
        turned = (R @ columns).reshape(-1, 9).T
        return np.concatenate([R[:, :, 2].T, turned, -np.cross(R[:, :, 2], force).T])

    def ends(base, tip):
        return np.concatenate([base[:3], base[3:12] - np.eye(3).ravel(), tip[12:]])

    world_moment = np.einsum("sij,sj->si", shape.rotation, shape.moment)
    start = np.concatenate([shape.position.T, shape.rotation.reshape(-1, 9).T, world_moment.T])
    found = solve_bvp(rates, ends, shape.arclength, start, tol=1e-7, max_nodes=5000)
    assert found.success
    # 1e-7 of relative residual on each interval of the collocation
    np.testing.assert_allclose(found.y[:3, -1], solution.tip_position, rtol=0, atol=1e-7 * 0.4)
    np.testing.assert_allclose(found.y[12:, 0], world_moment[0], rtol=1e-6, atol=1e-7)


LOADS = {
    "tip force": {"tip_force": (0.3, 0.1, -0.2), "rotation": 0.4, "translation": -0.15},
    "all dead loads": {
        "tip_force": (0.3, 0, -0.2),
        "tip_moment": (0.02, 0, 0.01),
        "distributed_force": (0, 0.3, 0),
        "distributed_moment": (0.02, 0, 0),
        "gravity": (0, 0, -9.81),
    },
    "follower loads": {"follower_force": (0.3, 0, -0.1), "follower_moment": (0.01, 0.02, 0), "rotation": 0.3},
    "a profile": {"distributed_force": lambda s: (0.5 * np.sin(20 * s), 0.3 * s, 0.0)},
}


@pytest.mark.parametrize("given", LOADS)
def test_segments_lead_where_one_integration_leads(given, monkeypatch):
    """Cut in more than ten, sections and profiles cut across: the same unknowns and the same tip, under every load."""
    monkeypatch.setattr(
        BackboneSegments, "growth", lambda _, cuts, found: (cuts.end - cuts.start) / 0.02 * segmented_equilibria.GROWTH
    )
    sections = [
        mr.Section(
            length=0.15, bending_stiffness=(0.22, 0.25), torsional_stiffness=0.06, precurvature=(8, 3, 0), linear_density=0.03
        ),
        mr.Section(
            length=0.25, bending_stiffness=(0.15, 0.1), torsional_stiffness=0.05, precurvature=(2, 5, 1), linear_density=0.02
        ),
    ]
    pose = np.array([[0, 0, 1, 0.1], [0, 1, 0, 0], [-1, 0, 0, 0.2], [0, 0, 0, 1.0]])
    robot = mr.SingleRod(mr.Rod(sections=sections), base=pose)
    inputs = robot.inputs(**LOADS[given])
    truth = mr.solve(robot, inputs).raise_if_failed()
    problem = robot.problem(inputs, integrator=mr.RK45())
    segments = problem.segments
    paths = paths_of(segments)
    result = paths.follow(problem.guess(), problem.load_scale())
    assert result.status.tolist() == [mr.Status.MULTIPLE_SHOOTING]
    cuts = result.place.cuts
    assert len(cuts.steps) > 10
    rounding = np.finfo(float).eps * np.abs(truth.gamma) @ np.abs(truth.unknowns)
    np.testing.assert_allclose(paths.rounding(result.place), rounding.max(), rtol=1e-5)
    position, rotation = segments.tip_pose(cuts, result.place.found)
    # both are integrated to 1e-8 a step
    np.testing.assert_allclose(cuts.unknowns[0], truth.unknowns, rtol=0, atol=1e-7)
    np.testing.assert_allclose(position[0], truth.tip_position, rtol=0, atol=1e-8)
    np.testing.assert_allclose(rotation[0], truth.tip_rotation, rtol=0, atol=1e-7)


@pytest.mark.parametrize("name", ["tip_force", "translation", "rotation"])
def test_jacobian(name, soft, difference):
    """Exact to the integrator: against differences of solutions."""
    base = {"tip_force": np.array((60.0, -50.0, 30.0)), "translation": np.array([-0.1]), "rotation": np.array([0.4])}

    def tip(t, direction):
        values = {**base, name: base[name] + t * direction}
        solution = mr.solve(soft, soft.inputs(**values), solver=mr.MultipleShooting()).raise_if_failed()
        turn = Rotation.from_matrix(solution.tip_rotation @ solution_0.tip_rotation.T).as_rotvec()
        return np.concatenate([solution.tip_position, turn])

    solution_0 = mr.solve(soft, soft.inputs(**base), solver=mr.MultipleShooting())
    assert solution_0.status == mr.Status.MULTIPLE_SHOOTING
    jacobian = solution_0.jacobian(name)
    for k, direction in enumerate(np.eye(jacobian.shape[1])):
        expected = difference(lambda t, e=direction: tip(t, e), 0.01 * np.linalg.norm(base[name]))
        np.testing.assert_allclose(jacobian[:, k], expected, rtol=0, atol=2e-6 * np.abs(jacobian).max())


def test_gradients_of_what_is_known_by_states(soft):
    """Against differences of fresh solves, of a batch in which one instance is known by its unknowns alone; by a parameter they
    are NaN there, as the Jacobian is."""
    forces, turn = np.array([(60.0, -50.0, 30.0), (0.5, 0.2, 0.0)]), np.array([[0.4], [0.1]])
    solution = mr.solve(soft, soft.inputs(tip_force=forces, rotation=turn))
    assert solution.status.tolist() == [mr.Status.MULTIPLE_SHOOTING, mr.Status.CONVERGED]
    c = np.array([0.3, -1.0, 0.7, 0.2, 0.5, -0.4])
    names = "tip_force", "rotation"
    whole = solution.vjp(c, of="tip_pose", wrt=names)
    for name in names:
        np.testing.assert_allclose(whole[name], c @ solution.jacobian(name), rtol=1e-9, atol=1e-12)
    found = solution.vjp(c[:3], of="tip_position", wrt=names)
    h = {"tip_force": 0.02, "rotation": 2e-3}
    for name in names:
        values = {"tip_force": forces[0], "rotation": turn[0]}
        for k, one in enumerate(np.eye(len(values[name]))):
            ends = []
            for sign in (1, -1, 2, -2):
                inputs = soft.inputs(**{**values, name: values[name] + sign * h[name] * one})
                tip = mr.solve(soft, inputs, solver=mr.MultipleShooting()).raise_if_failed().tip_position
                ends.append(c[:3] @ tip)
            slope = (8 * (ends[0] - ends[1]) - (ends[2] - ends[3])) / (12 * h[name])
            # solved to some 1e-9 m over the step
            np.testing.assert_allclose(found[name][0, k], slope, rtol=1e-4, atol=1e-6 * np.abs(found[name][0]).max() + 1e-9)
    alone = mr.solve(soft, soft.inputs(tip_force=forces[1], rotation=turn[1])).vjp(c, of="tip_pose", wrt=names)
    for name in names:
        np.testing.assert_array_equal(whole[name][1], alone[name])
    by_length = solution.vjp(c, of="tip_pose", wrt=("length", "rotation"))
    assert np.isnan(by_length["length"][0]).all()
    assert np.isfinite(by_length["length"][1]).all()
    assert np.isnan(solution.jacobian("length")[0]).all()


@pytest.mark.parametrize("first", [0.2, 0.1])
def test_a_rod_is_pushed_out_where_its_sections_end_at_breakpoints(first):
    """In the middle or a quarter, where segments begin: of one node for both, nothing was pushed through it."""
    made = {"bending_stiffness": 0.1, "torsional_stiffness": 0.08}
    sections = [
        mr.Section(length=size, precurvature=bend, **made) for size, bend in ((first, (0, 2, 0)), (0.4 - first, (0, -3, 1)))
    ]
    robot = mr.SingleRod(mr.Rod(sections=sections))
    pushed = [mr.solve(robot, robot.inputs(tip_force=(100, 50, 2000), translation=way)) for way in (0, 1e-5, -1e-5)]
    assert pushed[0].status == mr.Status.MULTIPLE_SHOOTING
    expected = (pushed[1].tip_position - pushed[2].tip_position) / 2e-5
    np.testing.assert_allclose(pushed[0].jacobian("translation")[:3, 0], expected, rtol=0, atol=1e-5)  # 1 where it is pulled taut


def test_what_is_conserved_along_the_rod(soft):
    """With constant ``K`` and ``u*``, ``M . (u* + K^-1 M / 2) + N_z`` is; and the force keeps its size. The work done adds up."""
    force = np.array([60.0, -50.0, 30.0])
    solution = mr.solve(soft, soft.inputs(tip_force=force), solver=mr.MultipleShooting())
    assert solution.status == mr.Status.MULTIPLE_SHOOTING
    shape = solution.rod(0)
    assert shape.position.shape == (51, 3)
    K, u_star = np.array([0.02, 0.03, 0.012]), np.array([4.0, -2.0, 6.0])
    kept = (shape.moment * (u_star + shape.moment / K / 2)).sum(axis=1) + shape.force[:, 2]
    # 1e-8 of the moment, times its curvature
    np.testing.assert_allclose(kept, kept[-1], rtol=0, atol=1e-7 * np.linalg.norm(force))
    np.testing.assert_allclose(
        np.einsum("sij,sj->si", shape.rotation, shape.force), np.tile(force, (51, 1)), rtol=0, atol=1e-9 * 84
    )
    work = force @ (solution.tip_position - [0, 0, 0])
    np.testing.assert_allclose(solution.potential, solution.energy - work, rtol=1e-8)


def test_a_batch_is_solved_as_each_alone(soft):
    force = np.array([(60.0, -50.0, 30.0), (0.2, 0.1, 0.0), (400.0, 0.0, 100.0), (60.0, 50.0, 30.0)])
    together = mr.solve(soft, soft.inputs(tip_force=force), solver=mr.MultipleShooting())
    assert together.status.tolist() == [16, 1, 16, 16]
    shapes = together.rod(0, nodes=5)
    for k in range(4):
        alone = mr.solve(soft, soft.inputs(tip_force=force[k]), solver=mr.MultipleShooting())
        assert alone.status == together.status[k]
        for name in ("unknowns", "tip_position", "tip_rotation", "residual", "integrations", "iterations"):
            np.testing.assert_array_equal(getattr(alone, name), getattr(together, name)[k])
        np.testing.assert_array_equal(alone.rod(0, nodes=5).position, shapes.position[k])
        assert alone.index == together.index[k] == 0


def test_where_shooting_creeps_segments_go_on(soft, monkeypatch):
    """By a third of the integrations, to the same tip; what they do not find has failed, and is not looked for again."""
    force = np.array([(60.0, -50.0, 30.0), (0.2, 0.1, 0.0), (60.0, 50.0, 30.0)])

    def solved(some=slice(None)):
        return mr.solve(soft, soft.inputs(tip_force=force[some]))

    handed, alone = solved(), solved(2)
    for name in ("unknowns", "tip_position", "integrations", "status"):
        np.testing.assert_array_equal(getattr(alone, name), getattr(handed, name)[2])
    with monkeypatch.context() as patch:
        given_up = np.array([mr.Status.MAX_ITERATIONS, mr.Status.NOT_RUN, mr.Status.MAX_ITERATIONS], dtype=int)
        patch.setattr(MultipleShooting, "go_on", lambda *_: given_up)
        failed = solved()
    assert failed.status.tolist() == [2, 1, 2]
    assert (failed.integrations < handed.integrations).tolist() == [True, False, True]
    monkeypatch.setattr(pace, "CREEPING", np.inf)
    monkeypatch.setattr(pace, "LONG", np.inf)  # of whose pace nobody asks
    crept = solved()
    assert handed.status.tolist() == crept.status.tolist() == [16, 1, 16]
    assert (handed.integrations[[0, 2]] < 0.35 * crept.integrations[[0, 2]]).all()
    np.testing.assert_allclose(handed.tip_position, crept.tip_position, rtol=0, atol=1e-8)
    for solution in (handed, failed):
        np.testing.assert_array_equal(solution.unknowns[1], crept.unknowns[1])
        assert solution.integrations[1] == crept.integrations[1]


def test_what_creeps_to_an_end_is_followed_to_there(soft, monkeypatch):
    """Pushed beyond where it snaps: it ends at the same load as if it had not been handed over."""
    inputs = soft.inputs(tip_force=(32.6, 66.0, -130.7))
    solver, counted = mr.Shooting(at_fold="stop"), []
    go_on = MultipleShooting.go_on

    def watched(self, *arguments):
        tried = go_on(self, *arguments)
        counted.append(tried.tolist())
        return tried

    monkeypatch.setattr(MultipleShooting, "go_on", watched)
    handed = mr.solve(soft, inputs, solver=solver)
    assert counted == [[mr.Status.BRANCH_END]]
    monkeypatch.setattr(pace, "CREEPING", np.inf)
    monkeypatch.setattr(pace, "LONG", np.inf)  # of whose pace nobody asks
    crept = mr.solve(soft, inputs, solver=solver)
    assert len(counted) == 1
    assert handed.status == crept.status == mr.Status.BRANCH_END
    said = []
    for solution in (handed, crept):
        with pytest.raises(mr.SolveError, match=r"% of the load reached") as error:
            solution.raise_if_failed()
        said += re.findall(r"[0-9.]+% of the load reached", str(error.value))
    assert said[0] == said[1]


def test_creeping_is_left_alone_where_rounding_does_not_forbid_the_end(monkeypatch):
    """However many steps are left: bitwise the same, by as many integrations."""
    rod = mr.SingleRod(mr.Rod(length=0.4, bending_stiffness=0.02, torsional_stiffness=0.015, precurvature=(14, 5, 0)))
    inputs = rod.inputs(tip_force=(0, 5.0, 0))
    free = mr.solve(rod, inputs)
    monkeypatch.setattr(pace, "CREEPING", 0)
    monkeypatch.setattr(continuation, "ROUNDS", 1)
    asked = mr.solve(rod, inputs)
    assert asked.status == mr.Status.CONVERGED
    assert asked.integrations == free.integrations > 30
    np.testing.assert_array_equal(asked.unknowns, free.unknowns)


def test_no_iteration_from_the_base_where_rounding_alone_leaves_more(soft, monkeypatch):
    """It would not converge: the same result with it, by more integrations."""
    inputs = soft.inputs(tip_force=(60.0, -50.0, 30.0))
    without = mr.solve(soft, inputs, solver=mr.MultipleShooting())
    monkeypatch.setattr(multiple_shooting, "ROUNDED_OFF", np.inf)
    tried = mr.solve(soft, inputs, solver=mr.MultipleShooting())
    assert tried.integrations > without.integrations
    for name in ("status", "unknowns", "tip_position", "residual"):
        np.testing.assert_array_equal(getattr(tried, name), getattr(without, name))


def test_modes_by_segments_are_those_by_columns(soft):
    """Of equilibria with none, one and more unstable modes, under loads that both can take."""
    robot = mr.SingleRod(mr.Rod(length=0.4, bending_stiffness=(0.02, 0.03), torsional_stiffness=0.012))
    found = mr.equilibria(robot, robot.inputs(tip_force=(0.15, 0.0, -3.0)))
    inputs = robot.inputs(tip_force=np.tile((0.15, 0.0, -3.0), (len(found.index), 1)))
    assert {0, 1, 2} <= set(found.index.tolist())
    problem = robot.problem(inputs, integrator=mr.RK45())
    segments = BackboneSegments(problem)
    points = {k: one_segment(segments, k, x, 64) for k, x in enumerate(found.unknowns)}
    modes = segments.modes(points)
    assert modes.index.tolist() == found.index.tolist()
    # both are integrated to 1e-8, columns of segments to 1e-6
    np.testing.assert_allclose(modes.eigenvalue(0), found.stability_margin, rtol=1e-5, atol=1e-5)


def test_true_ends_stay_ends():
    """A straight column buckles at Euler's load: this does not change with the method."""
    robot = mr.SingleRod(mr.Rod(length=0.5, bending_stiffness=(0.05, 0.02), torsional_stiffness=0.013))
    load = np.pi**2 * 0.02 / 0.5**2 / 4
    inputs = robot.inputs(tip_force=(0, 0, -3 * load))
    solution = mr.solve(robot, inputs, solver=mr.MultipleShooting())
    assert solution.status == mr.Status.BRANCH_END
    assert np.isnan(solution.tip_position).all()
    with pytest.raises(mr.SolveError, match=r"33\.3% of the load reached"):
        solution.raise_if_failed()
    assert mr.solve(robot, inputs).status == mr.Status.BIFURCATED  # which ends there and goes on


def test_a_column_bends_to_the_side_to_which_it_is_pushed():
    """By 1 or 3 % of the load across: near the buckling load the branch of the other side passes the first two tests."""
    robot = mr.SingleRod(mr.Rod(length=0.5, bending_stiffness=(0.05, 0.02), torsional_stiffness=0.013))
    unit = 0.02 / 0.5**2
    force = np.array([(0.01, 0.0002, -1.0)]) * 4 * unit, np.array([(0.03, 0.0006, -1.0)]) * 300 * unit
    solution = mr.solve(robot, robot.inputs(tip_force=np.concatenate(force)), solver=mr.MultipleShooting()).raise_if_failed()
    assert (solution.tip_position[:, 0] > 0.05).all()
    assert (solution.index == 0).all()


def test_an_unstable_end_is_refused(soft, monkeypatch):
    """A branch that starts stable stays so: whatever the tests on the way missed, an unstable result is none."""

    def modes(self: BackboneSegments, points: dict[int, Breakpoints]) -> Modes:
        one = Modes.unknown(len(points))
        return replace(one, values=np.full_like(one.values, -1.0), uncertainty=np.zeros_like(one.values), known=~one.known)

    monkeypatch.setattr(BackboneSegments, "modes", modes)
    solution = mr.solve(soft, soft.inputs(tip_force=(60.0, -50.0, 30.0)), solver=mr.MultipleShooting())
    assert solution.status == mr.Status.BRANCH_END
    assert np.isnan(solution.tip_position).all()


def test_slow_contraction_is_refused(soft):
    """The unloaded shape is no start for 64 EI/L^2: it is left after the second step, where Newton would wander on."""
    problem = soft.problem(soft.inputs(tip_force=(8.0, 0.0, 0.0)), integrator=mr.RK45())
    paths = paths_of(problem.segments, max_steps=1)
    assert not paths.correct(paths.start(problem.guess()), np.ones(1))[1].any()
    assert paths.iterations[0] <= 2


def test_from_a_guess_it_reaches_what_shooting_reaches(soft):
    inputs = soft.inputs(tip_force=(0.5, 0.2, -0.3))
    truth = mr.solve(soft, inputs).raise_if_failed()
    solution = mr.solve(soft, inputs, solver=mr.MultipleShooting(), guess=truth.unknowns + 0.3)
    assert solution.status == mr.Status.CONVERGED
    np.testing.assert_allclose(solution.unknowns, truth.unknowns, rtol=0, atol=1e-9)
    assert np.isfinite(solution.gamma).all()


@pytest.mark.parametrize(("solver", "first"), [(mr.MultipleShooting(), 0), (mr.Shooting(), 2)])
def test_a_motion_through_strong_loads(solver, first, soft):
    """Samples on either side are found, each with its shape. ``Shooting`` begins where it has to fall back, and recovers."""
    force = (np.array([1.0, 30.0, 60.0, 61.0, 1.0])[:, None] * [1.0, -0.8, 0.5])[first:]
    history = mr.simulate(soft, soft.inputs(tip_force=force), time=0.1 * np.arange(len(force)), solver=solver)
    alone = mr.solve(soft, soft.inputs(tip_force=force), solver=mr.MultipleShooting())
    assert history.status.tolist() == alone.status.tolist() == [1, 16, 16, 16, 1][first:]
    np.testing.assert_allclose(history.tip_position, alone.tip_position, rtol=0, atol=1e-8)
    np.testing.assert_allclose(history.rod(0, nodes=5).position, alone.rod(0, nodes=5).position, rtol=0, atol=1e-8)
    tracker = mr.Tracker(soft, solver=solver, dt=0.1)
    sample = tracker.step(tip_force=force[1])
    np.testing.assert_allclose(sample.rod(0, nodes=5).position[-1], history.tip_position[1], rtol=0, atol=1e-8)


FORCES = np.array([1.0, 0.5, 60.0, 0.2, 0.9, 0.7, 0.1, 64.0, 0.3, 0.4, 0.8, 1.0])[:, None] * [1.0, -0.8, 0.5]
STRONG = (2, 7)
RESULTS = (
    "status",
    "residual",
    "unknowns",
    "tip_position",
    "tip_rotation",
    "integrations",
    "index",
    "stability_margin",
    "potential",
)


@pytest.fixture(scope="module")
def mixed() -> tuple[mr.SingleRod, mr.Inputs, mr.Solution]:
    """A batch, solved as one part, of which ``Shooting`` can solve all but those with a number in ``STRONG``."""
    robot = mr.SingleRod(mr.Rod(length=0.4, bending_stiffness=(0.02, 0.03), torsional_stiffness=0.012, precurvature=(4, -2, 6)))
    inputs = robot.inputs(tip_force=FORCES)
    solution = mr.solve(robot, inputs, threads=1)
    expected = np.full(len(FORCES), mr.Status.CONVERGED)
    expected[list(STRONG)] = mr.Status.MULTIPLE_SHOOTING
    assert solution.status.tolist() == expected.tolist()
    return robot, inputs, solution


def agree(some: mr.Solution, whole: mr.Solution, index: object) -> None:
    """All that a solution holds and all that it computes when asked, bit by bit."""
    for name in RESULTS:
        np.testing.assert_array_equal(getattr(some, name), getattr(whole, name)[index], err_msg=name)
    np.testing.assert_array_equal(some.rod(0, nodes=5).position, whole.rod(0, nodes=5).position[index])
    np.testing.assert_array_equal(some.jacobian("tip_force"), whole.jacobian("tip_force")[index])


@pytest.mark.parametrize("threads", [1, 2])
def test_parts_and_threads_change_no_bit(threads, mixed, monkeypatch):
    """Strong loads in two of the parts."""
    robot, inputs, whole = mixed
    monkeypatch.setattr(batch, "SHORTEST_PART", 3)
    pieces = batch.parts(len(FORCES), threads, 1, "cpu")
    assert len(pieces) > 1
    assert sum(any(k in range(p.start, p.stop) for k in STRONG) for p in pieces) == 2
    agree(mr.solve(robot, inputs, threads=threads), whole, slice(None))


def test_some_instances_keep_their_breakpoints(mixed):
    robot, inputs, whole = mixed
    chosen = np.array([7, 0, 2, 7])
    agree(mr.solve(robot, inputs, instances=chosen), whole, chosen)
    agree(whole[chosen], whole, chosen)
    agree(whole[chosen][2:], whole, chosen[2:])


def test_a_single_instance_keeps_its_breakpoints(mixed):
    _, _, whole = mixed
    one = whole[7]
    assert one.status is mr.Status.MULTIPLE_SHOOTING
    assert one.stability is mr.Stability.STABLE
    agree(one, whole, 7)
    np.testing.assert_allclose(one.rod(0, nodes=5).position[-1], one.tip_position, rtol=0, atol=1e-9 * 0.4)


@pytest.mark.parametrize(
    ("solver", "shortest", "order"),
    [(mr.MultipleShooting(), 1, [[0, 2], [7, 1], [2, 3]]), (mr.Shooting(), 256, [[2, 0], [7, 1], [0, 3]])],
    ids=["two parts", "one part, new and followed together"],
)
def test_a_batch_of_motions_keeps_breakpoints_by_sample_and_instance(solver, shortest, order, mixed, monkeypatch):
    robot, _, whole = mixed
    monkeypatch.setattr(batch, "SHORTEST_PART", shortest)
    order = np.array(order)
    history = mr.simulate(robot, robot.inputs(tip_force=FORCES[order]), time=[0, 1, 2], solver=solver, threads=2)
    strong = np.isin(order, STRONG)
    assert (history.status[strong] == mr.Status.MULTIPLE_SHOOTING).all()
    tips = whole.tip_position[order]
    np.testing.assert_allclose(history.tip_position, tips, rtol=0, atol=1e-8)
    np.testing.assert_allclose(history.rod(0, nodes=3).position[:, :, -1], tips, rtol=0, atol=1e-8)
    np.testing.assert_allclose(history[2].rod(0, nodes=3).position[:, -1], tips[2], rtol=0, atol=1e-8)
    recorded = first_instances(history, 1)
    np.testing.assert_array_equal(recorded.rod(0, nodes=3).position[:, 0], history.rod(0, nodes=3).position[:, 0])
    np.testing.assert_array_equal(recorded.residual[:, 0], history.residual[:, 0])
    assert (history.residual[strong] > np.abs(history.boundary_residual[strong]).max(axis=-1)).any()


def test_poses_left_out_on_the_way_are_not_put_in_place_of_those_of_segments(soft):
    """Of many rods at fixed steps."""
    solver = mr.Shooting(integrator=mr.RK4(40))
    force = np.tile(FORCES[0], (POSES_APART, 1))
    force[5] = FORCES[2]
    together = mr.solve(soft, soft.inputs(tip_force=force), solver=solver, threads=1)
    alone = mr.solve(soft, soft.inputs(tip_force=force[5]), solver=solver)
    assert together.status[5] == alone.status == mr.Status.MULTIPLE_SHOOTING
    np.testing.assert_array_equal(together[5].tip_position, alone.tip_position)
    np.testing.assert_array_equal(together[5].boundary_residual, alone.boundary_residual)


def test_an_end_at_moderate_loads_is_not_looked_for_again(wire):
    """Far below the full load, at which ``Gamma`` is large: one integration tells."""
    robot = mr.SingleRod(wire)
    inputs = robot.inputs(tip_force=(0, 0, 150.0))
    ended, alone = (mr.solve(robot, inputs, solver=mr.Shooting(fallback=fallback, at_fold="stop")) for fallback in (True, False))
    assert ended.status == alone.status == mr.Status.BRANCH_END
    assert ended.integrations == alone.integrations + 1
    np.testing.assert_array_equal(ended.residual, alone.residual)


@pytest.mark.filterwarnings("ignore::multirod.PlausibilityWarning")
def test_loads_are_raised_in_steps_of_their_logarithm(soft):
    """Three doublings take three steps or four, at any load: in layers, moments go as its root."""
    force = np.array((60.0, -50.0, 30.0)) * np.array([1.0, 8.0, 64.0])[:, None]
    counts = [int(mr.solve(soft, soft.inputs(tip_force=f), solver=mr.MultipleShooting()).integrations) for f in force]
    first, second = np.diff(counts)
    assert max(first, second) < 68, counts  # more by an extrapolation in the load itself
    assert abs(first - second) < 0.35 * first  # a step more or less


def test_what_is_not_found_either_stays_as_it_was(soft):
    inputs = soft.inputs(tip_force=(60.0, -50.0, 30.0))
    solver = {fallback: mr.Shooting(max_continuation_steps=3, fallback=fallback) for fallback in (True, False)}
    tried, alone = (mr.solve(soft, inputs, solver=solver[fallback]) for fallback in (True, False))
    assert tried.status == alone.status == mr.Status.MAX_ITERATIONS
    assert tried.integrations > alone.integrations
    np.testing.assert_array_equal(tried.residual, alone.residual)


def test_a_stopped_problem_integrates_no_segment(soft):
    problem = soft.problem(soft.inputs(), integrator=mr.RK45())
    segments = problem.segments
    problem.stop = Event()
    problem.stop.set()
    with pytest.raises(batch.Interrupted):
        segments.propagate(Cuts.of_points({0: one_segment(segments, 0, np.zeros(3), 4)}), np.ones(1))


def test_modes_of_a_rod_rigid_in_torsion():
    """Straight, so that nothing but torsion could turn the tip about its axis: those that columns from the base give."""
    robot = mr.SingleRod(mr.Rod(length=0.4, bending_stiffness=(0.02, 0.03), torsional_stiffness=np.inf))
    inputs = robot.inputs(tip_force=(0, 0, -0.2))
    solution = mr.solve(robot, inputs).raise_if_failed()
    segments = robot.problem(inputs, integrator=mr.RK45()).segments
    modes = segments.modes({0: one_segment(segments, 0, np.zeros(3), 64)})
    assert modes.stability.tolist() == [solution.stability] == [mr.Stability.STABLE]
    # 1e-6 of the columns
    np.testing.assert_allclose(modes.eigenvalue(0), solution.stability_margin, rtol=1e-5)


def test_bases_that_vary_along_some_axes_only(soft, make_pose):
    poses = np.stack([make_pose(Rotation.from_rotvec([0.3 * k, 0, 0]).as_matrix(), (0, 0, 0.1 * k)) for k in range(3)])
    robot = mr.SingleRod(soft.rods[0], base=poses)
    inputs = robot.inputs(tip_force=np.array([(0.2, 0, 0.1), (0, 0.3, 0)])[:, None])
    solution = mr.solve(robot, inputs, solver=mr.MultipleShooting())
    assert solution.batch_shape == (2, 3)
    # it says so where the segments lead to the pose that the unknowns lead to
    assert (solution.status == mr.Status.CONVERGED).all()


def test_steps_are_short_enough_for_columns_along_a_straight_rod():
    """Under pure tension the state is constant, so its error asks for no steps: the columns' does. They are cosh and sinh."""
    robot = mr.SingleRod(mr.Rod(length=0.5, bending_stiffness=0.02, torsional_stiffness=0.013))
    load = 400.0
    problem = robot.problem(robot.inputs(tip_force=(0, 0, load * 0.02 / 0.25)), integrator=mr.RK45())
    segments = problem.segments
    found = paths_of(segments).follow(np.zeros((1, 3)), np.array([load])).place.found
    product = np.eye(6)
    for transition in found.transition:
        product = transition @ product
    k = np.sqrt(load)
    # moment over stiffness by rotation over length, and by moment: 1e-6 is what each segment's columns are right to
    np.testing.assert_allclose(product[0, 0], np.cosh(k), rtol=1e-5)
    np.testing.assert_allclose(np.abs(product[3, 0]), np.sinh(k) / k, rtol=1e-5)


@pytest.mark.filterwarnings("ignore::multirod.PlausibilityWarning")
def test_what_cannot_be_afforded_is_given_up_before_all_is_spent(soft):
    """Three equilibria say what a step takes; what is as many as the longest steps need is never given up."""
    inputs = soft.inputs(tip_force=(9e4, -9e4, 9e4))  # 1e6 EI/L^2, 1.5 times more at each step: 30 steps from where it begins
    free = mr.solve(soft, inputs, solver=mr.MultipleShooting()).raise_if_failed()
    enough = mr.solve(soft, inputs, solver=mr.MultipleShooting(max_integrations=int(free.integrations)))
    assert enough.status is mr.Status.MULTIPLE_SHOOTING
    assert enough.integrations == free.integrations
    few = mr.solve(soft, inputs, solver=mr.MultipleShooting(max_integrations=int(free.integrations) // 3))
    assert few.status is mr.Status.INTEGRATION_LIMIT
    assert few.integrations < free.integrations // 6


def random_systems(rng: np.random.Generator, counts: list[int], d: int, n: int) -> Systems:
    """Segments that amplify three variations and damp three, of one instance after another."""
    total = sum(counts)
    transition = rng.normal(size=(total, d, d)) / 3 + np.diag(([4.0, 0.25] * d)[:d])
    tip = rng.normal(size=(len(counts), n, d))
    nothing, first = np.zeros((total, 3)), np.cumsum([0, *counts])
    found = Propagation(
        end=nothing,
        transition=transition,
        residual=tip[:, :, 0],
        residual_columns=tip,
        displacement=nothing,
        displacement_columns=nothing,
        fault=np.zeros(len(counts), dtype=int),
    )
    steps = np.full(total, 4, dtype=np.int32)
    cuts = Cuts(np.arange(len(counts)), first, nothing[:, 0], nothing[:, 0], nothing, tip[:, :, 0], steps)
    return Systems(cuts, found, np.arange(n), "cpu")


def alone(systems: Systems, k: int) -> System:
    """One of the systems, for LAPACK."""
    one = systems.chosen(np.arange(systems.count) == k)
    return System(one.found, one.places)


@pytest.mark.parametrize(("d", "n"), [(6, 3), (9, 6)])
def test_systems(d, n):
    """Of several instances at once against the whole matrix of each, and LAPACK's band."""
    counts = [1, 2, 3, 40, 1]
    systems = random_systems(np.random.default_rng(1), counts, d, n)
    right = Step(np.arange(n * len(counts)).reshape(-1, n) + 1.0, np.arange(d * sum(counts)).reshape(-1, d) - 7.0)
    found = systems.solve(right)
    assert not systems.singular.any()
    for k, (first, last) in enumerate(pairwise(systems.cuts.first)):
        one = alone(systems, k)
        A, b = one.dense(), np.append(right.rows[first : last - 1], right.own[k])
        x = np.append(found.own[k], found.rows[first + 1 : last])
        expected = np.linalg.solve(A, b)
        size = np.linalg.cond(A) * 1e-14 * np.abs(expected).max()
        np.testing.assert_allclose(x, expected, rtol=0, atol=size)
        np.testing.assert_allclose(one.solve(b), expected, rtol=0, atol=size)
        itself = systems.chosen(np.arange(len(counts)) == k).solve(Step(right.own[[k]], right.rows[first:last]))
        np.testing.assert_array_equal(itself.own[0], found.own[k])
        np.testing.assert_array_equal(itself.rows[1:], found.rows[first + 1 : last])


def test_a_singular_system_is_none_of_the_others_concern():
    systems = random_systems(np.random.default_rng(2), [3, 4, 1], 6, 3)
    systems.found.transition[4] = 0.0
    assert systems.singular.tolist() == [False, True, False]
    found = systems.solve(Step(np.ones((3, 3)), np.ones((8, 6))))
    assert np.isnan(found.own[1]).all()
    assert np.isfinite(found.own[[0, 2]]).all()
    assert systems.same_branch(systems).tolist() == [True, False, True]


@pytest.mark.parametrize("modes", [0, 1, 2])
def test_a_mode_that_changes_sign_is_seen(modes):
    """Also two that cross together, which leave the determinant its sign; in the space of all vectors, and in part of it."""
    counts = [1, 5, 10, 60]
    before, after = (random_systems(np.random.default_rng(3), counts, 6, 3) for _ in range(2))
    assert alone(before, 1).size < VECTORS < alone(before, 2).size
    after.found.residual_columns[:, :modes] *= -1
    assert before.same_branch(after).tolist() == [modes == 0] * len(counts)


@pytest.mark.parametrize("size", [0.02, 0.1, 0.3, 1.0])
def test_what_is_on_the_same_branch_is_told_as_by_all_eigenvalues(size):
    """Changes of all segments; nothing is taken for the same branch that is not."""
    counts = [1, 2, 5, 10] * 5 + [20, 40]
    before, after = (random_systems(np.random.default_rng(5), counts, 6, 3) for _ in range(2))
    rng = np.random.default_rng(6)
    after.found.transition[:] *= 1 + size * rng.normal(size=after.found.transition.shape)
    after.found.residual_columns[:] *= 1 + size * rng.normal(size=after.found.residual_columns.shape)
    same = before.same_branch(after)
    for k in range(len(counts)):
        values = np.linalg.eigvals(np.linalg.solve(alone(before, k).dense().T, alone(after, k).dense().T))
        expected = bool((values.real > 0.25).all() and (np.abs(values) < 4).all())
        assert same[k] <= expected
        if counts[k] <= 5:
            assert same[k] == expected


def test_errors(soft, monkeypatch):
    tubes = mr.ConcentricTubes([mr.Rod(length=0.3, bending_stiffness=0.02, torsional_stiffness=0.015)] * 2)
    with pytest.raises(ValueError, match="MultipleShooting cannot take this problem: it offers no segments"):
        mr.solve(tubes, solver=mr.MultipleShooting())
    for field, value in {"tolerance": 0.0, "max_iterations": 0, "max_continuation_steps": 0, "max_integrations": 0}.items():
        with pytest.raises(ValueError, match=rf"MultipleShooting\.{field} = 0"):
            mr.MultipleShooting(**{field: value})
    with pytest.raises(ValueError, match=r"Shooting\.fallback"):
        mr.Shooting(fallback=1)
    inputs = soft.inputs(tip_force=(60.0, -50.0, 30.0))
    assert mr.solve(soft, inputs, solver=mr.MultipleShooting(max_continuation_steps=3)).status == mr.Status.MAX_ITERATIONS
    monkeypatch.setattr(segmented_equilibria, "MOST_SEGMENTS", 3)
    assert mr.solve(soft, inputs, solver=mr.MultipleShooting()).status == mr.Status.STEP_LIMIT


def test_cuts():
    """Two instances, of which one is cut in three."""
    points = {
        3: Breakpoints(np.array([0.0, 0.1, 0.4]), np.zeros((2, 10)), np.zeros(3), np.array([4, 8])),
        5: Breakpoints(np.array([0.0, 0.2]), np.full((1, 10), 5.0), np.ones(3), np.array([6])),
    }
    cuts = Cuts.of_points(points)
    assert cuts.first.tolist() == [0, 2, 3]
    assert cuts.start.tolist() == [0.0, 0.1, 0.0]
    assert cuts.end.tolist() == [0.1, 0.4, 0.2]
    assert cuts.inner.tolist() == [True, False, False]
    long = np.array([False, True, False])
    half = cuts.halves(long)
    assert (half.instances, half.start, half.end, half.steps) == (3, 0.1, 0.25, 4)
    cut = cuts.halved(long, half, np.ones((1, 10)))
    own = cut.points(0)
    assert own.arclength.tolist() == [0.0, 0.1, 0.25, 0.4]
    assert own.steps.tolist() == [4, 4, 4]
    assert own.states[:, 0].tolist() == [0.0, 0.0, 1.0]
    assert cut.points(1).states.tolist() == points[5].states.tolist()
    first = np.array([True, False])
    again = cut.put(first, cuts.chosen(first))
    assert again.first.tolist() == cuts.first.tolist()
    np.testing.assert_array_equal(again.states, cuts.states)
    second = cuts.chosen(~first)
    assert second.instances.tolist() == [5]
    assert cuts.put(~first, second).start.tolist() == cuts.start.tolist()


@pytest.mark.parametrize("force", [4e-5, 4e-3])
def test_segments_are_no_shorter_where_a_rod_is_far_stiffer_one_way(force):
    """Turned with its precurvature, a moment about the stiff axis is a large curvature about the soft one: that is a matter of
    units, and no segment is too short for it. ``STEP_LIMIT`` before."""
    rod = mr.Rod(length=0.16, bending_stiffness=(8e-6, 0.8), torsional_stiffness=1e-6, precurvature=(400, -50, 270))
    robot = mr.SingleRod(rod)
    inputs = robot.inputs(tip_force=force * np.array([0.6, -0.6, 0.5]))
    segments = mr.solve(robot, inputs, solver=MultipleShooting()).raise_if_failed()
    shooting = mr.solve(robot, inputs, solver=mr.Shooting(tolerance=1e-6)).raise_if_failed()
    # where single shooting leaves 1e-6 1/m, a rod of 0.16 m
    np.testing.assert_allclose(segments.tip_position, shooting.tip_position, rtol=0, atol=0.16**2 * 1e-6)


def test_growth_is_the_largest_singular_value_and_none_where_numbers_are_lost():
    """A segment whose columns have overflowed is one that says nothing, without a warning."""
    blocks = np.random.default_rng(0).normal(size=(6, 3, 3)) * np.logspace(-200, 200, 6)[:, None, None]
    blocks[4, 0, 0], blocks[5, 1, 2] = np.inf, np.nan
    expected = np.linalg.norm(blocks[:4], ord=2, axis=(1, 2))
    found = largest_singular_value(blocks)
    np.testing.assert_allclose(found[:4], expected, rtol=1e-7)  # the root of a cubic: half of the digits where two are alike
    assert np.isnan(found[4:]).all()


def test_a_step_that_overflows_is_infinitely_long():
    points = Breakpoints(np.array([0.0, 0.5, 1.0]), np.zeros((2, 18)), np.zeros(3), np.full(2, 4))
    cuts = Cuts.of_points({0: points})
    assert Step(np.full((1, 3), 1e200), np.zeros((2, 6))).norm(cuts) == np.inf
    assert Step(np.zeros((1, 3)), np.full((2, 6), 1e200)).norm(cuts) == np.inf
