"""Tendons with friction: the capstan's closed form, and in space the tension that the line's own shape calls for."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.interpolate import make_interp_spline
from scipy.optimize import brentq

import multirod as mr

LENGTH, EI, GJ, OFFSET = 0.2, 0.01, 0.0077, 0.008
TIGHT = mr.Shooting(integrator=mr.RK45(rtol=1e-12, atol=1e-13))
SHEAR = np.array([60.0, 60.0, 150.0])
FRICTION = (0.3, 0.2, -0.25)


def one_tendon(friction, **options):
    line = mr.Tendon(offset=(OFFSET, 0), friction=friction, **options)
    return mr.SingleRod(mr.Rod(length=LENGTH, bending_stiffness=EI, torsional_stiffness=GJ, lines=[line]))


@pytest.mark.parametrize("friction", [0.3, -0.3])
def test_tension_in_the_plane_is_that_of_a_capstan(friction):
    robot = one_tendon(friction)
    solution = mr.solve(robot, robot.inputs(tension=[3.0]), solver=TIGHT)
    shape, line = solution.rod(0, nodes=9), solution.line(0, nodes=9)
    k0 = 3.0 * OFFSET / EI
    expected = k0 / (1 + friction * k0 * shape.arclength)
    # the integrator's tolerance
    np.testing.assert_allclose(np.abs(shape.curvature[:, 1]), expected, rtol=1e-10)
    np.testing.assert_allclose(line.tension, 3.0 * expected / k0, rtol=1e-10)
    np.testing.assert_allclose(solution.tension, 3.0)
    assert solution.stability == mr.Stability.UNKNOWN
    assert np.isnan(solution.potential)


def bent(s):
    """At rest: (L13) has how that varies along the rod."""
    return 2 + 15 * s, 1 - 40 * s**2, 3 + np.sin(20 * s)


@pytest.fixture(scope="module")
def space():
    """A rod that shears and whose curvature at rest varies, three tendons, one of them a helix, weight and a tip force."""
    lines = [
        mr.Tendon(offset=(0.008, 0), friction=FRICTION[0]),
        mr.Tendon(route=lambda s: (0.006 * np.cos(30 * s + 1), 0.006 * np.sin(30 * s + 1)), friction=FRICTION[1]),
        mr.Tendon(offset=(-0.004, -0.006), friction=FRICTION[2]),
    ]
    rod = mr.Rod(
        length=LENGTH,
        bending_stiffness=(0.01, 0.013),
        torsional_stiffness=GJ,
        shear_stiffness=SHEAR[0],
        axial_stiffness=SHEAR[2],
        precurvature=bent,
        linear_density=0.05,
        lines=lines,
    )
    return mr.SingleRod(rod)


LOADS = {"tip_force": (0.2, -0.3, 0.1), "gravity": (0, 3, -9.81)}
TENSION = np.array([2.0, 1.5, 1.0])


def test_tension_in_space_is_what_the_line_calls_for(space):
    """(L12) from the shape alone: the line's direction by splines, its turning, the tension, and what rod and lines carry."""
    solution = mr.solve(space, space.inputs(tension=TENSION, **LOADS), solver=TIGHT).raise_if_failed()
    n = 601
    shape = solution.rod(0, nodes=n)
    s, R = shape.arclength, shape.rotation
    moment = (shape.curvature - np.array([bent(place) for place in s])) * (0.01, 0.013, GJ)
    force = np.array(shape.force)
    for i, friction in enumerate(FRICTION):
        line = solution.line(i, nodes=n)
        along = make_interp_spline(s, line.position, k=7)(s, 1)
        direction = along / np.linalg.norm(along, axis=1)[:, None]
        turning = np.linalg.norm(make_interp_spline(s, direction, k=7)(s, 1), axis=1)
        tension = TENSION[i] * np.exp(-friction * make_interp_spline(s, turning, k=5).antiderivative()(s))
        np.testing.assert_allclose(line.tension, tension, rtol=1e-9)
        t = np.einsum("nij,ni->nj", R, direction)
        rho = np.einsum("nij,ni->nj", R, line.position - shape.position)
        force += tension[:, None] * t
        moment += tension[:, None] * np.cross(rho, t)
    # what splines leave of a derivative over 601 nodes
    np.testing.assert_allclose(moment, shape.total_moment, atol=1e-9 * np.abs(moment).max())
    np.testing.assert_allclose(force, shape.total_force, atol=1e-9 * np.abs(force).max())


def test_a_tendon_does_not_rub_before_it_begins():
    start, moment, pull = 0.08, 0.02, 3.0
    robot = one_tendon(0.3, start=start)
    solution = mr.solve(robot, robot.inputs(tension=[pull], follower_moment=(0, moment, 0)), solver=TIGHT).raise_if_failed()
    # EI kappa = T r + moment, T' = -mu kappa T, from the start on; before, the moment bends the rod alone
    fading = np.exp(-0.3 * moment / EI * (LENGTH - start))
    left = pull * fading / (1 + pull * OFFSET / moment * (1 - fading))
    np.testing.assert_allclose(solution.line(0, nodes=3).tension[-1], left, rtol=1e-9)


@pytest.mark.parametrize("translation", [0.03, -0.04])
def test_what_is_pushed_out_of_the_base_rubs_too(difference, translation):
    robot, longer = (
        mr.SingleRod(mr.Rod(length=length, bending_stiffness=EI, torsional_stiffness=GJ, lines=[line]))
        for line in [mr.Tendon(offset=(OFFSET, 0), friction=0.3)]
        for length in (LENGTH, LENGTH + translation)
    )
    given = {"tension": [3.0], "tip_force": (0.1, 0.3, -0.2)}

    def pushed(by):
        return mr.solve(robot, robot.inputs(**given, translation=[by]), solver=TIGHT).raise_if_failed()

    solution, other = pushed(translation), mr.solve(longer, longer.inputs(**given), solver=TIGHT)
    np.testing.assert_allclose(solution.tip_position, other.tip_position, atol=1e-11)
    np.testing.assert_allclose(solution.line(0, nodes=9).tension[-1], other.line(0, nodes=9).tension[-1], rtol=1e-9)
    by_translation = difference(lambda h: pushed(translation + h).tip_position, 1e-4)
    # differences of solutions that are right to some 1e-12 m
    np.testing.assert_allclose(solution.jacobian("translation")[:3, 0], by_translation, atol=1e-7)


def test_columns_are_derivatives(space, difference):
    solution = mr.solve(space, space.inputs(tension=TENSION, **LOADS), solver=TIGHT)
    with pytest.raises(NotImplementedError, match=r"by translation .* friction"):
        solution.jacobian("translation")
    for name, step in (("tension", 2e-2), ("tip_force", 2e-3)):
        here, J = np.array({"tension": TENSION, **LOADS}[name]), solution.jacobian(name)
        for k in range(3):

            def tip(h, name=name, here=here, k=k):
                values = {"tension": TENSION, **LOADS, name: here + h * np.eye(3)[k]}
                return mr.solve(space, space.inputs(**values), solver=TIGHT).tip_position

            # differences of solutions that are right to some 1e-12 m
            np.testing.assert_allclose(J[:3, k], difference(tip, step), atol=1e-8 * np.abs(J[:3]).max())


def test_a_displacement_finds_the_tension_that_makes_it():
    robot = one_tendon(0.3, driven="displacement")
    pulled = mr.solve(robot, robot.inputs(displacement=[0.003]), solver=TIGHT).raise_if_failed()
    np.testing.assert_allclose(pulled.line_length, LENGTH - 0.003, atol=1e-12)
    other = one_tendon(0.3)
    same = mr.solve(other, other.inputs(tension=pulled.tension), solver=TIGHT)
    np.testing.assert_allclose(pulled.tip_position, same.tip_position, atol=1e-11)
    k0 = pulled.tension[0] * OFFSET / EI
    np.testing.assert_allclose(OFFSET * np.log(1 + 0.3 * k0 * LENGTH) / 0.3, 0.003, rtol=1e-9)  # offset times angle
    loose = mr.solve(robot, robot.inputs(displacement=[-0.003]), solver=TIGHT)
    assert loose.slack.all()


def test_tendons_of_legs_may_rub():
    """Legs whose tendons are in one plane with a hold on the platform: derivatives, and less of a pull at the platform."""
    base, platform = np.tile(np.eye(4), (2, 2, 1, 1))
    base[:, 0, 3], platform[:, 0, 3] = (-0.05, 0.05), (-0.03, 0.03)

    def robot(friction):
        lines = [mr.Tendon(offset=(sign * OFFSET, 0), friction=friction) for sign in (1, -1)]
        legs = [mr.Rod(length=LENGTH, bending_stiffness=EI, torsional_stiffness=GJ, lines=[line]) for line in lines]
        return mr.ParallelRods(legs=legs, base=base, platform=platform)

    rubs = robot(0.4)

    def at(tension):
        return mr.solve(rubs, rubs.inputs(tension=tension, tip_force=(0.1, 0.2, -0.1)), solver=TIGHT).raise_if_failed()

    tension = np.array([3.0, 1.0])
    solution = at(tension)
    left = solution.line(0, nodes=9).tension
    assert (np.diff(left) < 0).all()
    assert left[0] == 3.0
    J = solution.jacobian("tension")
    for k, e in enumerate(1e-2 * np.eye(2)):
        slope = (at(tension + e).tip_position - at(tension - e).tip_position) / 2e-2
        np.testing.assert_allclose(J[:3, k], slope, atol=1e-5 * np.abs(J[:3]).max())  # a step of 1e-2 of the tension


SPACING = 0.02


def between_discs(friction, tension):
    line = mr.Tendon(offset=(OFFSET, 0), friction=friction)
    rod = mr.Rod(length=LENGTH, bending_stiffness=EI, torsional_stiffness=GJ, lines=[line], discs=SPACING)
    robot = mr.SingleRod(rod)
    return mr.solve(robot, robot.inputs(tension=tension), solver=TIGHT).raise_if_failed()


def chords(friction, tension, count):
    """Bending of arcs between discs, each alone: ``EI k^2 h/2 + T c(k)`` is least, ``c`` the chord of its tendon, and at each
    disc the tendon loses what a capstan takes, at the base half of it. The angle of the tip."""
    h = LENGTH / count

    def arc(T):
        return brentq(
            lambda k: EI * k * h + T * (h * (1 / k - OFFSET) * np.cos(k * h / 2) - 2 / k**2 * np.sin(k * h / 2)), 1e-3, 50
        )

    k = turned = 0.0
    for _ in range(count):
        for _ in range(30):  # how far it turns at the disc depends on what is left behind it
            k = arc(tension * np.exp(-friction * (turned + k * h / 2)))
        turned += k * h
    return turned


@pytest.mark.parametrize("friction", [0.3, -0.3])
def test_between_discs_tension_is_that_of_a_capstan(friction):
    """(L12b) against ``EI k = T (r (1 - h^2 k^2/24) + h^2 k lam/12)``, ``T' = -mu k T`` by SciPy, and by chords and discs one by
    one."""
    solution = between_discs(friction, [3.0])
    line, shape = solution.line(0, nodes=9), solution.rod(0, nodes=9)
    c = SPACING**2 / 24

    def curvature(T):
        return brentq(lambda k: EI * k - T * (OFFSET * (1 - c * k**2) + 2 * c * k * (1 - OFFSET * k)), 0, 50, xtol=1e-14)

    given = {"t_eval": shape.arclength, "rtol": 1e-12, "atol": 1e-13}
    found = solve_ivp(lambda s, T: [-friction * curvature(T[0]) * T[0]], (0, LENGTH), [3.0], **given)
    # the integrators' tolerances
    np.testing.assert_allclose(line.tension, found.y[0], rtol=1e-9)
    np.testing.assert_allclose(np.abs(shape.curvature[:, 1]), [curvature(T) for T in found.y[0]], rtol=1e-9)
    # what is left out is (mu k h)^2/24 of it and less; discs alone make 1 % of it, friction 10 %
    np.testing.assert_allclose(np.arccos(shape.rotation[-1, 2, 2]), chords(friction, 3.0, 10), rtol=2e-5)


def test_columns_of_friction_between_discs_are_derivatives(difference):
    """A helix and a straight tendon under a force: what (L12b) varies by."""
    lines = [
        mr.Tendon(offset=(0.008, 0), friction=0.3),
        mr.Tendon(route=lambda s: (0.006 * np.cos(30 * s + 1), 0.006 * np.sin(30 * s + 1)), friction=-0.2),
    ]
    rod = mr.Rod(length=LENGTH, bending_stiffness=EI, torsional_stiffness=GJ, lines=lines, discs=SPACING)
    robot, given = mr.SingleRod(rod), {"tension": np.array([3.0, 2.0]), "tip_force": np.array([0.1, 0.3, -0.2])}
    solution = mr.solve(robot, robot.inputs(**given), solver=TIGHT).raise_if_failed()
    for name, step in (("tension", 2e-2), ("tip_force", 2e-3)):
        J = solution.jacobian(name)
        for k in range(len(given[name])):

            def tip(h, name=name, k=k):
                values = given | {name: given[name] + h * np.eye(len(given[name]))[k]}
                return mr.solve(robot, robot.inputs(**values), solver=TIGHT).tip_position

            # differences of solutions that are right to some 1e-12 m
            np.testing.assert_allclose(J[:3, k], difference(tip, step), atol=1e-8 * np.abs(J[:3]).max())


def test_a_tendon_rubs_beside_a_push_rod_that_bends(difference):
    """A helix that rubs and a push rod in a rod that shears: its tension against its own shape, and what (L14b) varies by."""
    lines = [
        mr.Tendon(route=lambda s: (0.006 * np.cos(30 * s + 1), 0.006 * np.sin(30 * s + 1)), friction=0.3),
        mr.PushRod(offset=(-0.004, 0.007), bending_stiffness=0.012, axial_stiffness=300.0),
    ]
    stiffness = {"bending_stiffness": (0.01, 0.013), "torsional_stiffness": GJ, "shear_stiffness": 60.0, "axial_stiffness": 150.0}
    robot = mr.SingleRod(mr.Rod(length=LENGTH, lines=lines, **stiffness))
    given = {"tension": np.array([2.0]), "displacement": np.array([0.002]), "tip_force": np.array([0.2, -0.3, 0.1])}

    def at(**changes):
        return mr.solve(robot, robot.inputs(**(given | changes)), solver=TIGHT).raise_if_failed()

    solution = at()
    shape, line = solution.rod(0, nodes=601), solution.line(0, nodes=601)
    along = make_interp_spline(shape.arclength, line.position, k=7)(shape.arclength, 1)
    direction = along / np.linalg.norm(along, axis=1)[:, None]
    turning = np.linalg.norm(make_interp_spline(shape.arclength, direction, k=7)(shape.arclength, 1), axis=1)
    turned = make_interp_spline(shape.arclength, turning, k=5).antiderivative()(shape.arclength)
    np.testing.assert_allclose(line.tension, 2 * np.exp(-0.3 * turned), rtol=1e-9)  # what splines leave over 601 nodes
    for name, step in (("tension", 2e-2), ("displacement", 2e-5), ("tip_force", 2e-3)):
        J = solution.jacobian(name)
        for k, e in enumerate(np.eye(len(given[name]))):
            slope = difference(lambda h, name=name, e=e: at(**{name: given[name] + h * e}).tip_position, step)
            # differences leave 1e-11 of it; terms of (L14c) are small where little rubs
            np.testing.assert_allclose(J[:3, k], slope, atol=1e-10 * np.abs(J[:3]).max())


def test_what_friction_does_not_go_with_is_refused():
    rod = {"length": LENGTH, "bending_stiffness": EI, "torsional_stiffness": GJ}
    tendon = mr.Tendon(offset=(OFFSET, 0), friction=0.3)
    with pytest.raises(ValueError, match=r"Tendon.friction = 0.3 .* must be zero in a rod with members"):
        mr.Rod(**rod, lines=[tendon], members=[mr.PushRod(offset=(0, OFFSET))])
    with pytest.raises(ValueError, match=r"Tendon.axial_stiffness = 200.0 .* must not be given with friction"):
        mr.Tendon(offset=(OFFSET, 0), driven="displacement", axial_stiffness=200.0, friction=0.3)
    with pytest.raises(ValueError, match=r"Tendon.friction"):
        mr.Tendon(offset=(OFFSET, 0), friction=np.nan)
    assert mr.Tendon(offset=(OFFSET, 0), friction=0.0).friction == 0
