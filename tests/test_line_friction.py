"""Tendons with friction: the capstan's closed form, and in space the tension that the line's own shape calls for."""

import numpy as np
import pytest
from scipy.interpolate import make_interp_spline

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
    with pytest.raises(NotImplementedError, match="friction"):
        solution.jacobian("translation")
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


def test_columns_are_derivatives(space, difference):
    solution = mr.solve(space, space.inputs(tension=TENSION, **LOADS), solver=TIGHT)
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


def test_what_friction_does_not_go_with_is_refused():
    rod = {"length": LENGTH, "bending_stiffness": EI, "torsional_stiffness": GJ}
    tendon = mr.Tendon(offset=(OFFSET, 0), friction=0.3)
    with pytest.raises(ValueError, match=r"Tendon.friction = 0.3 .* must be zero in a rod with discs"):
        mr.Rod(**rod, lines=[tendon], discs=0.02)
    with pytest.raises(ValueError, match=r"Tendon.friction = 0.3 .* must be zero beside a push rod that bends"):
        mr.Rod(**rod, lines=[tendon, mr.PushRod(offset=(0, OFFSET), bending_stiffness=0.01)])
    with pytest.raises(ValueError, match=r"Tendon.axial_stiffness = 200.0 .* must not be given with friction"):
        mr.Tendon(offset=(OFFSET, 0), driven="displacement", axial_stiffness=200.0, friction=0.3)
    with pytest.raises(ValueError, match=r"Tendon.friction"):
        mr.Tendon(offset=(OFFSET, 0), friction=np.nan)
    robot = mr.SingleRod(mr.Rod(**rod, lines=[tendon]))
    with pytest.raises(ValueError, match=r"translation .* must be zero: a line has friction"):
        robot.inputs(translation=[0.01])
    assert mr.Tendon(offset=(OFFSET, 0), friction=0.0).friction == 0
