"""Tendons with friction in concentric tubes: a closed form, the tension that a line's own shape calls for, the tubes' energy
under that tension, differences."""

from itertools import pairwise

import numpy as np
import pytest
from scipy.interpolate import make_interp_spline
from test_tube_lines import STRAIGHT, constant, helix
from tube_line_equations import Tube, TubeLine, TubeLineEquations

import multirod as mr

PRECISE = mr.Shooting(tolerance=1e-11, integrator=mr.RK45(rtol=1e-11, atol=1e-13))
FRICTION = (0.3, 0.2, -0.25)
GIVEN = {
    "rotation": np.array([0.7, -0.2]),
    "translation": np.array([-0.12, -0.08]),
    "tension": np.array([6.0, 4.0, 5.0]),
    "tip_force": np.array([0.1, -0.1, 0.05]),
}
SECTIONS = [(0.21, 0.012, 0.015, 0.01, np.array([0, 0, 0.3])), (0.09, 0.012, 0.015, 0.01, np.array([0, 3.0, 0]))]
# where strains jump, counted from the plate: the end of a section and of the outer tube
PIECES = (0.0, 0.13, 0.22, 0.28)


def tubes(helical, straight, held, magnetised: bool = False, **where: object) -> mr.ConcentricTubes:
    """A helix and a straight tendon in the inner tube, one in the outer, which is stiffer about one axis and has discs."""
    lines = [
        mr.Tendon(route=lambda s: helix(s)[0], friction=helical),
        mr.Tendon(offset=(-0.0008, 0.0012), friction=straight),
    ]
    inner = mr.Rod(
        name="inner",
        length=0.4,
        bending_stiffness=0.004,
        torsional_stiffness=0.003,
        magnetisation=(0.3, 1, 0.5) if magnetised else None,
        lines=lines,
    )
    outer = mr.Rod(
        magnetisation=(0.5, 1, 0.7) if magnetised else None,
        name="outer",
        length=0.3,
        bending_stiffness=(0.012, 0.015),
        torsional_stiffness=0.01,
        precurvature=[(0.21, (0, 0, 0.3)), (0.09, (0, 3, 0))],
        lines=[mr.Tendon(**(where or {"offset": (0, 0.0025)}), friction=held)],
        discs=0.02,
    )
    return mr.ConcentricTubes([inner, outer])


ROBOT = tubes(*FRICTION)


def solved(**changes: np.ndarray) -> mr.Solution:
    return mr.solve(ROBOT, ROBOT.inputs(**(GIVEN | changes)), solver=PRECISE).raise_if_failed()


@pytest.fixture(scope="module")
def solution() -> mr.Solution:
    return solved()


@pytest.fixture(scope="module")
def magnetised() -> mr.Solution:
    """In a field, that turns each tube by itself."""
    robot = tubes(*FRICTION, magnetised=True)
    inputs = robot.inputs(**GIVEN, magnetic_field=(0.3, -0.2, 0.4))
    return mr.solve(robot, inputs, solver=PRECISE).raise_if_failed()


@pytest.mark.parametrize("i", range(3))
def test_tension_is_what_the_line_calls_for(solution: mr.Solution, i: int) -> None:
    assert_what_the_line_calls_for(solution, i)


@pytest.mark.parametrize("i", range(3))
def test_tension_is_what_the_line_of_magnetised_tubes_calls_for(magnetised: mr.Solution, i: int) -> None:
    assert_what_the_line_calls_for(magnetised, i)


def assert_what_the_line_calls_for(solution: mr.Solution, i: int) -> None:
    """(L12) from the shape alone: the line's direction by splines, on each piece on which strains do not jump."""
    line = solution.line(i, nodes=561)
    s, before = line.arclength, None
    for begin, end in pairwise(PIECES):
        own = np.isfinite(line.tension) & (s > begin + 1e-6) & (s < end - 1e-6)
        if own.sum() < 20:
            continue
        along = make_interp_spline(s[own], line.position[own], k=7)(s[own], 1)
        direction = along / np.linalg.norm(along, axis=1)[:, None]
        turning = np.linalg.norm(make_interp_spline(s[own], direction, k=7)(s[own], 1), axis=1)
        turned = make_interp_spline(s[own], turning, k=5).antiderivative()(s[own])
        expected = line.tension[own][0] * np.exp(-FRICTION[i] * turned)
        np.testing.assert_allclose(line.tension[own], expected, rtol=1e-8)  # what splines leave of a derivative
        before = expected[-1]
    assert before is not None
    assert abs(before / GIVEN["tension"][i] - 1) > 0.02  # it is meant to rub
    np.testing.assert_allclose(line.tension[np.isfinite(line.tension)][0], GIVEN["tension"][i], rtol=1e-12)


def test_the_energy_of_tubes_under_these_tensions_finds_the_same(solution: mr.Solution) -> None:
    """The witness of ``tube_line_equations``, whose tensions are functions of arclength."""

    def tension(i: int, translation: float) -> object:
        line = solution.line(i, nodes=561)
        own = np.isfinite(line.tension)
        pieces = make_interp_spline(line.arclength[own], line.tension[own], k=1)
        return lambda material: float(pieces(material + translation))

    inner = [TubeLine(helix, tension(0, -0.12)), TubeLine(constant(-0.0008, 0.0012), tension(1, -0.12))]
    outer = [TubeLine(constant(0, 0.0025), tension(2, -0.08), discs=0.02)]
    sections = [(0.4, 0.004, 0.004, 0.003, STRAIGHT)]
    bodies = [Tube(sections, 0.7, -0.12, inner), Tube(SECTIONS, -0.2, -0.08, outer)]
    shapes = [solution.rod(k, nodes=3) for k in range(2)]
    moment = sum(shape.rotation[0] @ shape.total_moment[0] for shape in shapes)
    torque = np.array([shape.total_moment[0, 2] for shape in shapes])
    position, _, left, torques, _, _ = TubeLineEquations(bodies, GIVEN["tip_force"]).integrate(moment[:2], torque)
    # what is linear between 561 nodes of a tension
    np.testing.assert_allclose(position, solution.tip_position, atol=1e-7)
    np.testing.assert_allclose(left, 0, atol=1e-7)
    np.testing.assert_allclose(torques, 0, atol=1e-8)


@pytest.mark.parametrize("name", ["rotation", "tension", "tip_force"])
def test_derivatives_are_those_of_differences(difference, name: str) -> None:
    """(L23), with a steep helix in the tube that turns: how a straight tendon turns hardly depends on how bending changes."""
    robot = tubes(0.3, 0.2, 0.9, route=lambda s: (0.004 * np.cos(200 * s), 0.004 * np.sin(200 * s)))
    step, k = {"rotation": 4e-3, "tension": 4e-2, "tip_force": 2e-3}[name], len(GIVEN[name]) - 1

    def at(h: float) -> mr.Solution:
        given = GIVEN | {name: GIVEN[name] + h * np.eye(k + 1)[k]}
        return mr.solve(robot, robot.inputs(**given), solver=PRECISE).raise_if_failed()

    def tip(h: float) -> np.ndarray:
        return at(h).tip_position

    J = at(0.0).jacobian(name)

    # differences of solutions that are right to some 1e-11 m
    np.testing.assert_allclose(J[:3, k], difference(tip, step), atol=2e-9 * np.abs(J[:3]).max())


@pytest.mark.parametrize(("name", "k", "step"), [("rotation", 1, 4e-3), ("tension", 2, 4e-2)])
def test_derivatives_know_how_tubes_that_turn_bend(difference, name: str, k: int, step: float) -> None:
    """(L23), what a tube carries itself: seen where a tube that is much bent turns much, by a slanted tendon far out."""

    def coil(radius: float, rate: float) -> object:
        return lambda s: (radius * np.cos(rate * s), radius * np.sin(rate * s))

    lines = [mr.Tendon(route=coil(0.003, 60), friction=0.3), mr.Tendon(offset=(-0.0008, 0.0012), friction=0.2)]
    inner = mr.Rod(length=0.4, bending_stiffness=0.004, torsional_stiffness=0.003, lines=lines)
    outer = mr.Rod(
        length=0.3,
        bending_stiffness=(0.012, 0.015),
        torsional_stiffness=0.002,
        precurvature=[(0.21, (0, 0, 0.3)), (0.09, (0, 20, 0))],
        lines=[mr.Tendon(route=coil(0.01, 30), friction=0.9)],
        discs=0.02,
    )
    robot = mr.ConcentricTubes([inner, outer])

    def at(h: float) -> mr.Solution:
        given = GIVEN | {name: GIVEN[name] + h * np.eye(k + 1)[k]}
        return mr.solve(robot, robot.inputs(**given), solver=PRECISE).raise_if_failed()

    J = at(0.0).jacobian(name)[:3]
    slope = difference(lambda h: at(h).tip_position, step)
    # differences of solutions that are right to some 1e-11 m leave 1e-10 of it
    np.testing.assert_allclose(J[:, k], slope, atol=1e-8 * np.abs(J).max())


def test_without_friction_it_is_the_law_without(solution: mr.Solution) -> None:
    robot = tubes(np.array([0.0, 0.3]), np.array([0.0, 0.2]), np.array([0.0, -0.25]))
    found = mr.solve(robot, robot.inputs(**GIVEN), solver=PRECISE).raise_if_failed()
    without = tubes(0.0, 0.0, 0.0)
    other = mr.solve(without, without.inputs(**GIVEN), solver=PRECISE).raise_if_failed()
    np.testing.assert_allclose(found.tip_position[0], other.tip_position, atol=1e-10)  # the integrators' tolerance
    np.testing.assert_allclose(found.tip_position[1], solution.tip_position, atol=1e-10)
    assert np.linalg.norm(found.tip_position[1] - found.tip_position[0]) > 1e-4
    with pytest.raises(NotImplementedError, match=r"by translation .* friction"):
        solution.jacobian("translation")


def test_tension_in_the_plane_is_that_of_a_capstan(difference) -> None:
    """Straight tubes of one length that bend in a plane: ``kappa = k0/(1 + mu k0 s)``, ``k0 = T r/(EI_1 + EI_2)``."""
    mu, r, pull, length = 0.3, 0.004, 20.0, 0.2
    line = mr.Tendon(offset=(r, 0), friction=mu)
    inner = mr.Rod(length=length, bending_stiffness=0.01, torsional_stiffness=0.008, lines=[line])
    outer = mr.Rod(length=length, bending_stiffness=0.02, torsional_stiffness=0.016)
    robot = mr.ConcentricTubes([inner, outer])
    force = (0.0, 0.1, 0.0)

    def at(translation: object, tip_force: object = force) -> mr.Solution:
        given = {"tension": pull, "translation": translation, "tip_force": tip_force}
        return mr.solve(robot, robot.inputs(**given), solver=PRECISE).raise_if_failed()

    flat = at((0.0, 0.0), (0.0, 0.0, 0.0))
    shape, k0 = flat.rod(0, nodes=9), pull * r / 0.03
    expected = k0 / (1 + mu * k0 * shape.arclength)
    np.testing.assert_allclose(np.abs(shape.curvature[:, 1]), expected, rtol=1e-9)
    np.testing.assert_allclose(flat.line(0, nodes=9).tension, pull * expected / k0, rtol=1e-9)
    assert flat.stability == mr.Stability.UNKNOWN
    here = np.array([-0.05, -0.03])
    J = at(here).jacobian("translation")
    for k, e in enumerate(np.eye(2)):
        slope = difference(lambda h, e=e: at(here + h * e).tip_position, 1e-4)
        np.testing.assert_allclose(J[:3, k], slope, atol=1e-9)  # differences of solutions that are right to some 1e-11 m


def test_tubes_whose_tendons_rub_may_be_legs(difference):
    """Each leg alone, under the wrench that the platform puts on its tip, is where it is beside the others; derivatives."""
    base, platform = np.tile(np.eye(4), (2, 2, 1, 1))
    base[:, 0, 3], platform[:, 0, 3] = (-0.05, 0.05), (-0.03, 0.03)
    legs = [ROBOT, tubes(0.1, -0.2, 0.3)]
    robot = mr.ParallelRods(legs=legs, base=base, platform=platform)
    given = {
        "rotation": np.array([0.7, -0.2, 0.1, 0.3]),
        "translation": np.array([-0.12, -0.08] * 2),
        "tension": np.array([6.0, 4.0, 5.0, 3.0, 7.0, 2.0]),
        "tip_force": np.array([0.1, -0.1, 0.05]),
    }

    finer = mr.Shooting(tolerance=1e-11, integrator=mr.RK45(rtol=1e-12, atol=1e-14))

    def at(**changes: np.ndarray) -> mr.Solution:
        return mr.solve(robot, robot.inputs(**(given | changes)), solver=finer).raise_if_failed()

    solution = at()
    for k, leg in enumerate(legs):
        shape, tubes_of, lines = solution.rod(2 * k), slice(2 * k, 2 * k + 2), slice(3 * k, 3 * k + 3)
        R = shape.rotation[-1]
        wrench = {"tip_force": R @ shape.total_force[-1], "tip_moment": R @ shape.total_moment[-1]}
        own = {name: given[name][tubes_of] for name in ("rotation", "translation")}
        alone = mr.ConcentricTubes(list(leg.rods), base=base[k])
        inputs = alone.inputs(tension=given["tension"][lines], **own, **wrench)
        single = mr.solve(alone, inputs, solver=finer).raise_if_failed()
        # the integrators' tolerance
        np.testing.assert_allclose(single.tip_position, shape.position[-1], atol=1e-10)
        np.testing.assert_allclose(single.line_length, solution.line_length[lines], atol=1e-10)
        for i in range(3):
            there, here = (own.line(at, nodes=5).tension for own, at in ((single, i), (solution, 3 * k + i)))
            np.testing.assert_allclose(there, here, rtol=1e-8)
    for name, step in (("tension", 2e-2), ("tip_force", 2e-3), ("rotation", 1e-3)):
        J = solution.jacobian(name)
        e = np.eye(len(given[name]))[-1]
        slope = difference(lambda h, name=name, e=e: at(**{name: given[name] + h * e}).tip_position, step)
        # the columns' own integration: 3e-8 at ten times the integrator's tolerance, 1e-9 at this
        np.testing.assert_allclose(J[:3, -1], slope, atol=1e-8 * np.abs(J[:3]).max())
