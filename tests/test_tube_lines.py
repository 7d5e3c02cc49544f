"""Concentric tubes with lines of all kinds: against an integration of their energy alone, against precurved tubes, and the work
of what drives them."""

import numpy as np
import pytest
from scipy.optimize import brentq
from tube_line_equations import Tube, TubeLine, TubeLineEquations

import multirod as mr
from multirod.testing import check_assembly

PRECISE = mr.Shooting(tolerance=1e-11)
STRAIGHT = np.zeros(3)
AREA = 4e-6


def helix(s: float) -> tuple[np.ndarray, np.ndarray]:
    return 0.001 * np.array([np.cos(30 * s), np.sin(30 * s)]), 0.03 * np.array([-np.sin(30 * s), np.cos(30 * s)])


def constant(*offset: float) -> object:
    return lambda s: (np.array(offset), np.zeros(2))


def inner_tube() -> mr.Rod:
    lines = [
        mr.Tendon(route=lambda s: helix(s)[0], end=0.35, name="helix"),
        mr.PushRod(offset=(-0.0008, 0.0012), bending_stiffness=0.0004, axial_stiffness=4000.0, name="rod"),
    ]
    return mr.Rod(name="inner", length=0.4, bending_stiffness=0.004, torsional_stiffness=0.003, lines=lines)


def outer_tube(**held: object) -> mr.Rod:
    lines = [
        mr.Tendon(**(held or {"offset": (0, 0.0025)}), start=0.12, end=0.27, driven="displacement", name="held"),
        mr.Chamber(offset=(0.002, 0.001), area=AREA, area_fixed="section", name="chamber"),
    ]
    curved = [(0.21, (0, 0, 0.3)), (0.09, (0, 3, 0))]
    stiffness = {"bending_stiffness": (0.012, 0.015), "torsional_stiffness": 0.01}
    return mr.Rod(name="outer", length=0.3, precurvature=curved, lines=lines, discs=0.02, **stiffness)


ROBOT = mr.ConcentricTubes([inner_tube(), outer_tube()])
GIVEN = {
    "rotation": np.array([0.7, -0.2]),
    "translation": np.array([-0.12, -0.08]),
    "tension": np.array([4.0]),
    "displacement": np.array([0.0002, 0.0003]),
    "pressure": np.array([2e5]),
    "tip_force": np.array([0.1, -0.1, 0.05]),
}
STEPS = {"rotation": 1e-3, "translation": 1e-5, "tension": 1e-2, "displacement": 1e-6, "pressure": 1e2, "tip_force": 1e-3}


def solved(**changes: np.ndarray) -> mr.Solution:
    return mr.solve(ROBOT, ROBOT.inputs(**(GIVEN | changes)), solver=PRECISE).raise_if_failed()


@pytest.fixture(scope="module")
def solution() -> mr.Solution:
    return solved()


def test_an_integration_of_the_energy_alone_finds_the_same(solution: mr.Solution) -> None:
    T = solution.tension
    inner = Tube(
        [(0.4, 0.004, 0.004, 0.003, STRAIGHT)],
        0.7,
        -0.12,
        [TubeLine(helix, T[0], end=0.35), TubeLine(constant(-0.0008, 0.0012), T[1], bending=0.0004)],
    )
    chamber = TubeLine(constant(0.002, 0.001), T[3], hole=True)
    held = TubeLine(constant(0, 0.0025), T[2], start=0.12, end=0.27, discs=0.02)
    sections = [(0.21, 0.012, 0.015, 0.01, np.array([0, 0, 0.3])), (0.09, 0.012, 0.015, 0.01, np.array([0, 3.0, 0]))]
    equations = TubeLineEquations([inner, Tube(sections, -0.2, -0.08, [held, chamber])], GIVEN["tip_force"])
    shapes = [solution.rod(k, nodes=3) for k in range(2)]
    moment = sum(shape.rotation[0] @ shape.total_moment[0] for shape in shapes)
    torque = np.array([shape.total_moment[0, 2] for shape in shapes])
    found = equations.integrate(moment[:2], torque)
    position, _, left, torques, lengths, energy = found
    # the witness's fixed steps, and the tolerance of adaptive steps
    np.testing.assert_allclose(position, solution.tip_position, atol=2e-9)
    np.testing.assert_allclose(left, 0, atol=1e-9)
    np.testing.assert_allclose(torques, 0, atol=1e-9)
    np.testing.assert_allclose(lengths, solution.line_length, atol=1e-9)
    np.testing.assert_allclose(energy, solution.energy, rtol=1e-8)
    assert T[3] == -AREA * GIVEN["pressure"][0]
    assert min(abs(T[1]), T[2]) > 1


def test_what_a_tube_carries_itself_is_its_stiffness_times_its_strain(solution: mr.Solution) -> None:
    shape = solution.rod("inner", nodes=9)
    K = np.array([0.004, 0.004, 0.003])
    np.testing.assert_allclose(shape.moment[1:-1], K * shape.curvature[1:-1], atol=1e-12)
    difference = shape.total_moment - shape.moment
    assert np.abs(difference).max() > 1e-3
    pull = shape.total_force - shape.force
    assert np.abs(np.linalg.norm(pull[0]) - np.linalg.norm(solution.tension[[0, 1, 3]].sum())) < 0.2


@pytest.mark.parametrize("name", GIVEN)
def test_derivatives_of_tip_and_lengths_are_those_of_differences(solution: mr.Solution, name: str) -> None:
    exact, lengths = solution.jacobian(name), solution.jacobian(name, of="line_length")  # type: ignore[call-overload]
    k, step = 0, STEPS[name]
    found = [solved(**{name: GIVEN[name] + sign * step * np.eye(len(GIVEN[name]))[k]}) for sign in (1, -1)]
    scale = np.abs(exact[:3]).max()
    position = (found[0].tip_position - found[1].tip_position) / (2 * step)
    np.testing.assert_allclose(position, exact[:3, k], atol=1e-5 * scale)
    by_length = (found[0].line_length - found[1].line_length) / (2 * step)
    np.testing.assert_allclose(by_length, lengths[:, k], atol=1e-5 * np.abs(lengths).max())


def steep() -> mr.ConcentricTubes:
    """The same with a helix so steep that bending twists its tube, and a line driven by displacement that converges."""
    winding = mr.Tendon(route=lambda s: (0.003 * np.cos(150 * s), 0.003 * np.sin(150 * s)), start=0.201, end=0.301)
    lines = [winding, inner_tube().lines[1]]
    soft = mr.Rod(name="inner", length=0.4, bending_stiffness=0.004, torsional_stiffness=0.001, lines=lines)
    return mr.ConcentricTubes([soft, outer_tube(route=lambda s: (0.02 * s, 0.0025))])


@pytest.mark.parametrize("name", ["rotation", "translation", "tension", "displacement"])
def test_derivatives_are_exact_where_bending_and_twist_are_coupled(name: str) -> None:
    robot, finer = steep(), mr.Shooting(tolerance=1e-11, integrator=mr.RK45(rtol=1e-11, atol=1e-13))
    given = GIVEN | {"tension": np.array([20.0])}

    def at(value: np.ndarray) -> mr.Solution:
        return mr.solve(robot, robot.inputs(**(given | {name: value})), solver=finer).raise_if_failed()

    step = STEPS[name] * np.eye(len(given[name]))[-1]
    here, ahead, behind = at(given[name]), at(given[name] + step), at(given[name] - step)
    exact, lengths = here.jacobian(name)[:3, -1], here.jacobian(name, of="line_length")[:, -1]  # type: ignore[call-overload]
    moved = (ahead.tip_position - behind.tip_position) / (2 * STEPS[name])
    longer = (ahead.line_length - behind.line_length) / (2 * STEPS[name])
    np.testing.assert_allclose(moved, exact, atol=4e-6 * np.abs(exact).max())
    np.testing.assert_allclose(longer, lengths, atol=4e-6 * np.abs(lengths).max())


def test_what_drives_lines_does_the_work_that_the_robot_gains(solution: mr.Solution) -> None:
    # d potential / d q is the tension, d/dT the length, d/dP less the volume
    rates = {"displacement": solution.tension[[1, 2]], "tension": solution.line_length[:1]}
    rates["pressure"] = -AREA * solution.line_length[3:]
    for name, expected in rates.items():
        for k in range(len(expected)):
            step = STEPS[name] * np.eye(len(expected))[k]
            ahead, behind = (solved(**{name: GIVEN[name] + sign * step}).potential for sign in (1, -1))
            np.testing.assert_allclose((ahead - behind) / (2 * STEPS[name]), expected[k], rtol=2e-6)


def test_it_is_stable_and_a_batch_is_bitwise_what_each_is_alone(solution: mr.Solution) -> None:
    assert solution.stability == mr.Stability.STABLE
    tensions = np.array([[4.0], [1.0], [6.0]])
    batch = mr.solve(ROBOT, ROBOT.inputs(**(GIVEN | {"tension": tensions})), solver=PRECISE).raise_if_failed()
    np.testing.assert_array_equal(batch.unknowns[0], solution.unknowns)
    np.testing.assert_array_equal(batch.line_length[2], solved(tension=tensions[2]).line_length)


def test_lines_are_drawn_along_the_tube_that_carries_them(solution: mr.Solution) -> None:
    line, tube = solution.line("held"), solution.rod("outer")
    there = np.isfinite(line.position).all(axis=1)
    beside = line.position[there] - tube.position[there]
    np.testing.assert_allclose(np.linalg.norm(beside, axis=1), 0.0025, rtol=1e-9)
    np.testing.assert_allclose(tube.arclength[there][[0, -1]], (0.12 - 0.08, 0.27 - 0.08), atol=0.01)


def test_it_conforms() -> None:
    inputs = ROBOT.inputs(**GIVEN)
    check_assembly(ROBOT, inputs, tip_rod=0, vary=("tension", "displacement", "translation"), solvers=("shooting",))


# ---- two tubes and a tendon in each ----


def pulled_pair(lever: float, EI: float = 0.005, GJ: float = 0.002) -> mr.ConcentricTubes:
    tube = {"length": 0.25, "bending_stiffness": EI, "torsional_stiffness": GJ}
    return mr.ConcentricTubes([mr.Rod(**tube, lines=[mr.Tendon(offset=(lever, 0))]) for _ in range(2)])


def curved_pair(curvature: float, EI: float = 0.005, GJ: float = 0.002) -> mr.ConcentricTubes:
    tube = {"length": 0.25, "bending_stiffness": EI, "torsional_stiffness": GJ}
    return mr.ConcentricTubes([mr.Rod(**tube, precurvature=(0, curvature, 0)) for _ in range(2)])


@pytest.mark.filterwarnings("ignore::multirod.PlausibilityWarning")
@pytest.mark.parametrize("angle", [0.6, 2.4])
def test_a_tendon_close_to_the_axis_bends_as_a_precurvature_does(angle: float) -> None:
    # a moment T r alone: what its pull adds to torsion, T r^2, is next to nothing
    lever, curvature = 1e-6, 6.0
    pulled, curved = pulled_pair(lever), curved_pair(curvature)
    given = {"rotation": (0, angle), "translation": (-0.05, -0.05), "tip_force": (0.05, 0.1, 0)}
    a = mr.solve(pulled, pulled.inputs(tension=[0.005 * curvature / lever] * 2, **given)).raise_if_failed()
    b = mr.solve(curved, curved.inputs(**given)).raise_if_failed()
    np.testing.assert_allclose(a.tip_position, b.tip_position, atol=2e-6)
    assert a.stability == b.stability == mr.Stability.STABLE


def test_opposite_tendons_turn_tubes_against_each_other_and_snap_as_precurvatures_do() -> None:
    # straight where they are opposite: stable while their tubes resist to be turned enough, not beyond
    lever = 0.001
    for curvature, stable in ((4.0, True), (8.0, False)):
        robot = pulled_pair(lever)
        tension = [0.005 * curvature / lever] * 2
        inputs = robot.inputs(tension=tension, rotation=(0, np.pi), translation=(-0.05, -0.05))
        straight = mr.solve(robot, inputs, guess=np.zeros(1)).raise_if_failed()
        np.testing.assert_allclose(straight.tip_position, (0, 0, 0.2), atol=1e-9)
        assert (straight.stability == mr.Stability.STABLE) == stable


def test_the_tension_at_which_opposite_tendons_turn_their_tubes_is_known() -> None:
    """``theta'' = (EI k^2/GJ) sin(theta)``, ``k = T r/EI``: straight up to ``cot x = x beta/l``, ``x = l k sqrt(EI/GJ)``."""
    robot, full = pulled_pair(0.001), 40.0

    def inputs(angle: float) -> mr.Inputs:
        return robot.inputs(tension=(full, full), rotation=(0, angle), translation=(-0.05, -0.05))

    (found,) = mr.critical_loads(robot, inputs(np.pi))
    x = brentq(lambda x: 1 / np.tan(x) - x * 0.05 / 0.2, 1.0, 1.5)
    k = x / 0.2 * np.sqrt(0.002 / 0.005)
    # what the pulls add to GJ, T r^2, is 1 % of it
    np.testing.assert_allclose(found.load_factor, k * 0.005 / 0.001 / full, rtol=0.01)
    with pytest.raises(mr.SolveError, match=r"rounding hides the branch: .*no change of stability before .* up_to=\d"):
        mr.critical_loads(robot, inputs(2.0))
    assert not mr.critical_loads(robot, inputs(2.0), up_to=2)


def test_one_tube_with_lines_is_a_single_rod_with_them() -> None:
    rod = mr.Rod(length=0.25, bending_stiffness=0.005, torsional_stiffness=0.002, lines=[mr.Tendon(offset=(0.001, 0))])
    tube, alone = mr.ConcentricTubes([rod]), mr.SingleRod(rod)
    given = {"tension": 20.0, "rotation": 0.3, "tip_force": (0.1, 0.05, 0)}
    a, b = (mr.solve(robot, robot.inputs(**given), solver=PRECISE).raise_if_failed() for robot in (tube, alone))
    np.testing.assert_allclose(a.tip_position, b.tip_position, atol=1e-12)
    np.testing.assert_allclose(a.line_length, b.line_length, atol=1e-12)
    # in a tube that resists nothing next to it, too
    soft = mr.Rod(length=0.25, bending_stiffness=5e-9, torsional_stiffness=2e-9, lines=[mr.Tendon(offset=(0.001, 0))])
    pair = mr.ConcentricTubes([rod, soft])
    c = mr.solve(pair, pair.inputs(tension=(20.0, 0.0), rotation=(0.3, 0), tip_force=(0.1, 0.05, 0))).raise_if_failed()
    np.testing.assert_allclose(c.tip_position, b.tip_position, atol=1e-6)


def test_what_is_not_modelled_is_refused_by_name() -> None:
    line = mr.Tendon(route=lambda s: (0.002 - 0.04 * s**2, 0), driven="displacement", name="converging")
    robot = mr.ConcentricTubes([mr.Rod(length=0.2, bending_stiffness=0.01, torsional_stiffness=0.01, lines=[line])])
    with pytest.raises(ValueError, match=r"tension = 1.0 is not allowed: must not be given"):
        robot.inputs(tension=1.0)
    with pytest.raises(ValueError, match="beyond, the length at rest of line 'converging' varies"):
        robot.inputs(translation=-0.05)


@pytest.mark.parametrize("count", [2, 3])
def test_tubes_that_nothing_loads_are_judged_with_lines_of_given_length(count):
    """As under a force of next to nothing, whose problem has a moment among its unknowns: what pulls a line is no torque."""
    lines = [mr.Tendon((0.003, 0), driven="displacement", axial_stiffness=300.0), mr.Tendon((-0.001, 0.002))]
    sizes = ((0.3, 0.004), (0.24, 0.01), (0.18, 0.03))[:count]
    tubes = [
        mr.Rod(
            length=length,
            bending_stiffness=EI,
            torsional_stiffness=0.77 * EI,
            precurvature=[(length - 0.1, (0, 0, 0)), (0.1, (0, 9, 0))],
            lines=lines if (length, EI) in sizes[-1:] else [],
        )
        for length, EI in sizes
    ]
    robot = mr.ConcentricTubes(tubes)
    given = {"rotation": (0.0, 1.0, 2.0)[:count], "translation": (-0.05, -0.03, -0.02)[:count], "tension": 1.0}
    inputs = robot.inputs(**given, displacement=[-1e-3, 1e-3, 4e-3])
    free = mr.solve(robot, inputs, solver=PRECISE).raise_if_failed()
    assert free.slack[:, 0].tolist() == [True, False, False]
    loaded = mr.solve(robot, robot.inputs(**given, displacement=[-1e-3, 1e-3, 4e-3], tip_force=(1e-9, 0, 0)), guess=free)
    assert (free.stability == mr.Stability.STABLE).all()
    # 1e-9 N bend the tubes by some 1e-9 of their length
    np.testing.assert_allclose(free.stability_margin, loaded.stability_margin, rtol=1e-7)
    np.testing.assert_allclose(free.rod(0).moment, loaded.rod(0).moment, rtol=0, atol=1e-8)
    assert (loaded.integrations <= 2).all()  # the unknowns of the one are those of the other


@pytest.mark.parametrize("short", [0, 1])
def test_tubes_with_lines_of_given_length_lose_stability_where_gamma_is_singular(short):
    """Where one of the tubes ends before the tip, too, and the line hardly stretches: by tests that have nothing in common."""
    line = mr.Tendon((0.002, 0), driven="displacement", axial_stiffness=3e4)
    tubes = [
        mr.Rod(
            length=0.25 if short == k else 0.3,
            bending_stiffness=EI,
            torsional_stiffness=0.77 * EI,
            precurvature=(0, bent, 0),
            lines=[line] * k,
        )
        for k, (EI, bent) in enumerate(((0.01, 8.0), (0.02, 7.0)))
    ]
    robot = mr.ConcentricTubes(tubes)
    still = {"translation": (-0.02, 0.0), "displacement": 1e-3}
    start = robot.inputs(rotation=(0.0, 0.0), **still)
    (load,) = mr.critical_loads(robot, robot.inputs(rotation=(6.0, 0.0), **still), start=start)
    begin = mr.solve(robot, start)
    assert load.fold
    assert not load.solution.slack.any()
    assert 0 < load.load_factor < 1
    # of the square root of what is left to the fold, which is found to some 1e-9
    assert abs(load.solution.determinant) < 1e-3 * begin.determinant
    assert abs(load.solution.stability_margin) < 1e-3 * begin.stability_margin
