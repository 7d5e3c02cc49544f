"""Closed forms. Solves are at a residual of 1e-11 1/m and 1e-12 a step, so bounds of 1e-9 are a hundred times their errors."""

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.special import ellipk, ellipkinc

import multirod as mr
from multirod import profile

L, EI, GJ = 0.4, 0.05, 0.03
TIGHT = mr.Shooting(tolerance=1e-11, integrator=mr.RK45(rtol=1e-12, atol=1e-14))


def straight(**more):
    return mr.Rod(**({"length": L, "bending_stiffness": EI, "torsional_stiffness": GJ} | more))


def nothing(s):
    """A zero load function: with it, all function tests share one kernel."""
    return (0, 0, 0)


def solve(rod, base=None, **inputs):
    robot = mr.SingleRod(rod, base=base)
    return mr.solve(robot, robot.inputs(**inputs), solver=TIGHT).raise_if_failed()


def assert_pose(solution, position, rotation=None, atol=1e-9):
    np.testing.assert_allclose(solution.tip_position, position, rtol=0, atol=atol)
    if rotation is not None:
        np.testing.assert_allclose(solution.tip_rotation, rotation, rtol=0, atol=atol)


def helix(u, length, rotation):
    """Frame and centreline of constant curvature u: the exponential of its twist."""
    k = np.linalg.norm(u)
    axis = np.asarray(u) / k
    e3 = np.array([0, 0, 1.0])
    along = axis * (axis @ e3)
    angle = k * length
    position = along * length + (e3 - along) * np.sin(angle) / k + np.cross(axis, e3) * (1 - np.cos(angle)) / k
    return position, rotation(axis * angle)


# ---- precurvature alone ----


def test_arc():
    k = 7.0
    assert_pose(solve(straight(precurvature=(k, 0, 0))), (0, (np.cos(k * L) - 1) / k, np.sin(k * L) / k))


def test_helix(wire, make_pose):
    position, rotation = helix((14, 5, 0), 0.4, lambda a: make_pose(a)[:3, :3])
    assert_pose(solve(wire), position, rotation)
    position, rotation = helix((14, -6, 9), L, lambda a: make_pose(a)[:3, :3])
    assert_pose(solve(straight(precurvature=(14, -6, 9))), position, rotation)


def test_euler_spiral_by_function_and_by_sections():
    """u* = 60 s about x: the angle is 30 s^2. Sections of constant curvature meet it with error 1/count^2."""

    def angle(s):
        return 30 * s**2

    position = (
        0,
        -quad(lambda s: np.sin(angle(s)), 0, L, epsabs=1e-13)[0],
        quad(lambda s: np.cos(angle(s)), 0, L, epsabs=1e-13)[0],
    )
    assert_pose(solve(straight(precurvature=lambda s: (60 * s, 0, 0))), position)

    def by_sections(count):
        return solve(straight(precurvature=[(L / count, (60 * L * (k + 0.5) / count, 0, 0)) for k in range(count)])).tip_position

    errors = [np.linalg.norm(by_sections(count) - position) for count in (20, 40)]
    assert errors[1] < 1e-4
    assert errors[0] / errors[1] == pytest.approx(4, rel=0.02)


@pytest.mark.parametrize("width", [0.01, 0.004, 0.001, 4e-4])
@pytest.mark.parametrize("centre", [0.2, 0.213, 0.08])
def test_a_narrow_bump_of_curvature_turns_the_tip_by_its_area(width, centre):
    """Two bumps of one kind, one at the places where a polynomial is laid and checked, others not. Their ends are 1e-13 rad off
    in the tails; a bump that is not seen is off by a degree."""
    bump = solve(straight(precurvature=lambda s: (20 * np.exp(-(((s - centre) / width) ** 2)), 0, 0)))
    angle = np.arctan2(-bump.tip_rotation[1, 2], bump.tip_rotation[2, 2])
    assert angle == pytest.approx(20 * width * np.sqrt(np.pi), abs=1e-9)


@pytest.mark.parametrize("width", [0.004, 0.0012, 0.0006])
@pytest.mark.parametrize("start", [0.1, 0.1501, 0.2173, 0.3993])
def test_a_belt_presses_with_what_it_is_given(start, width):
    """A load that jumps up and down again: what the base bears is its integral, to rounding and the integrator's tolerance, and a
    longer rod in the batch, which is looked at all along, changes nothing."""
    force = 0.05 * min(width, L - start) / width

    def belt(s):
        return (0.05 / width if start <= s < start + width else 0.0, 0, 0)

    alone = solve(straight(), distributed_force=belt, distributed_moment=nothing)
    beside = solve(straight(length=np.array([L, 4 * L])), distributed_force=belt, distributed_moment=nothing)
    assert alone.wrench(0, "base").force[0] == pytest.approx(force, rel=1e-9)
    assert beside.wrench(0, "base").force[0, 0] == pytest.approx(force, rel=1e-9)
    np.testing.assert_allclose(beside.tip_position[0], alone.tip_position, rtol=0, atol=1e-9)


def test_notches_turn_the_tip_by_their_sum():
    """Forty of a fortieth part of a turn: places of all jumps are found, not only to a part of the length."""
    notched = solve(straight(precurvature=lambda s: (20.0 * ((100 * s) % 1 < 0.05), 0, 0)))
    assert np.arctan2(-notched.tip_rotation[1, 2], notched.tip_rotation[2, 2]) == pytest.approx(40 * 20 * 0.0005, abs=1e-9)


@pytest.mark.parametrize("width", [0.004, 0.0012, 0.0006])
@pytest.mark.parametrize("start", [0.1, 0.1501, 0.2173, 0.3993])
def test_the_places_of_jumps_are_found(start, width):
    """To rounding: pieces between them have the height of the belt, or none, and its integral."""
    found = profile.fit("f", lambda s: (float(start <= s < start + width), 0.0, 0.0), L)
    heights = found.coefficients[:, 0, 0]
    np.testing.assert_allclose(found.coefficients[:, 1:], 0.0, atol=1e-12)
    assert np.diff(found.ends, prepend=0.0) @ heights == pytest.approx(min(width, L - start), rel=1e-9)


@pytest.mark.parametrize("off", [3e-6, 1e-5, 4e-4, 8e-4])
@pytest.mark.parametrize("at", [0.25, 0.5, 0.875])
def test_a_jump_beside_where_pieces_are_halved_is_found(at, off):
    """Between that place and the nearest at which the function is looked at there are none of a polynomial: the jump was moved
    there, by up to a thousandth of the length, and the tip of a cantilever off by half a percent."""
    end = (at - off) * L
    found = profile.fit("f", lambda s: (float(s < end), 0.0, 0.0), L)
    assert np.diff(found.ends, prepend=0.0) @ found.coefficients[:, 0, 0] == pytest.approx(end, rel=1e-12)
    load = solve(straight(), distributed_force=lambda s: (1e-3 * float(s < end), 0, 0), distributed_moment=nothing)
    assert load.tip_position[0] == pytest.approx(1e-3 * end**3 * (4 * L - end) / (24 * EI), rel=1e-6)  # of a small slope


def test_a_function_without_smooth_pieces_comes_to_an_end():
    """Noise has no jumps to be found: it is resolved as far as pieces are halved."""
    noise = profile.fit("f", lambda s: (np.sin(1e9 * s * s), 0.0, 0.0), 1.0)
    assert len(noise.ends) <= 2**14


@pytest.mark.parametrize("waves", [1, 8, 40, 160, 234, 377])
def test_a_wave_of_a_function_is_resolved(waves):
    """Of any number of waves, also where all of some evenly spaced places would be at zeros: to a part in 1e9 of its height."""
    wave = profile.fit("f", lambda s: (np.sin(2 * np.pi * waves * s), s, 1.0), 1.0)
    for s in np.linspace(0, 1, 1009):
        np.testing.assert_allclose(wave(s), (np.sin(2 * np.pi * waves * s), s, 1.0), rtol=0, atol=1e-9)


def test_translation_is_a_longer_first_section(make_pose):
    """Sections shift outward and the first grows; pulled in by more than the first, the rest starts at the base."""
    laws = [(0.15, (3, 5, 1)), (0.25, (-6, 2, 4))]
    out = solve(straight(precurvature=laws), translation=0.07)
    assert_pose(out, solve(straight(length=0.47, precurvature=[(0.22, (3, 5, 1)), (0.25, (-6, 2, 4))])).tip_position)
    back = solve(straight(precurvature=laws), translation=-0.2)
    position, rotation = helix((-6, 2, 4), 0.2, lambda a: make_pose(a)[:3, :3])
    assert_pose(back, position, rotation)
    bent = solve(straight(precurvature=lambda s: (60 * s, 0, 0)), translation=0.1)
    spiral = solve(straight(precurvature=lambda s: (60 * s, 0, 0)))
    assert_pose(bent, spiral.tip_position + [0, 0, 0.1], spiral.tip_rotation)  # what is added has the curvature at 0, none


# ---- moments ----


def test_torsion():
    """A moment T along the axis twists by T L/GJ and nothing else."""
    T = 0.1
    twist = T * L / GJ
    c, s = np.cos(twist), np.sin(twist)
    assert_pose(solve(straight(), tip_moment=(0, 0, T)), (0, 0, L), [[c, -s, 0], [s, c, 0], [0, 0, 1]])
    assert_pose(solve(straight(torsional_stiffness=np.inf), tip_moment=(0, 0, T)), (0, 0, L), np.eye(3))


@pytest.mark.parametrize("name", ["tip_moment", "follower_moment"])
def test_circle(name):
    """A moment 2 pi EI/L about x, in the plane the same dead or following, closes the circle."""
    assert_pose(solve(straight(), **{name: (2 * np.pi * EI / L, 0, 0)}), (0, 0, 0), np.eye(3))
    half = solve(straight(), **{name: (np.pi * EI / L, 0, 0)})
    assert_pose(half, (0, -2 * L / np.pi, 0), np.diag([1, -1, -1]))


def test_follower_moment_in_space(make_pose):
    """A moment fixed in the tip frame of an isotropic straight rod with GJ = EI gives constant curvature m/EI."""
    m = np.array([0.3, -0.2, 0.4])
    position, rotation = helix(m / EI, L, lambda a: make_pose(a)[:3, :3])
    assert_pose(solve(straight(torsional_stiffness=EI), follower_moment=m), position, rotation)


# ---- forces ----


def test_elastica():
    """Dead force P across the tip: sqrt(P L^2/EI) = K(k) - F(k, phi0), 2 k^2 sin^2(phi0) = 1, tip slope by 2 k^2 - 1."""
    P = 3 * EI / L**2
    low, high = 0.5, 1 - 1e-12  # bisect on k^2
    for _ in range(200):
        m = 0.5 * (low + high)
        gap = ellipk(m) - ellipkinc(np.arcsin(np.sqrt(0.5 / m)), m) - np.sqrt(P * L**2 / EI)
        low, high = (m, high) if gap < 0 else (low, m)
    slope = np.arcsin(2 * m - 1)
    solution = solve(straight(), tip_force=(0, P, 0))
    c, s = np.cos(slope), np.sin(slope)
    np.testing.assert_allclose(solution.tip_rotation, [[1, 0, 0], [0, c, s], [0, -s, c]], rtol=0, atol=1e-9)
    along = np.sqrt(2 * EI / P * np.sin(slope))  # from the first integral EI/2 theta'^2 = P (sin(slope) - sin(theta))
    assert solution.tip_position[2] == pytest.approx(along, abs=1e-9)


def test_timoshenko():
    """F L^3/3EI + F L/GA and F L/EA; loads of 1e-4 EI/L^2 keep quadratic terms below 1e-7 of them."""
    GA, EA = 0.9 * EI / L**2, 1.7 * EI / L**2  # so soft that shear matters as much as bending
    F = 1e-4 * EI / L**2
    rod = straight(bending_stiffness=(EI, 2 * EI), shear_stiffness=(GA, 2 * GA), axial_stiffness=EA)
    across = F * L**3 / 3
    solution = solve(rod, tip_force=(F, F, 0))
    expected = (across / (2 * EI) + F * L / GA, across / EI + F * L / (2 * GA))
    np.testing.assert_allclose(solution.tip_position[:2], expected, rtol=1e-3)
    opposite = solve(rod, tip_force=(-F, -F, 0))
    half = (solution.tip_position - opposite.tip_position) / 2  # odd part: quadratic terms cancel
    np.testing.assert_allclose(half[:2], expected, rtol=1e-7)


def test_extension():
    """Along the axis the rod stays straight: L (1 + F/EA), exactly."""
    F, EA = 0.7, 5.0
    assert_pose(solve(straight(axial_stiffness=EA), tip_force=(0, 0, F)), (0, 0, L * (1 + F / EA)), np.eye(3))


def shear_coefficient(nu, hollow):
    """Cowper's ratio of Saint-Venant's flexure of a ring, its outer radius 1, by its stress function and quadrature.

    ``chi`` is harmonic, and on both circles ``d(chi)/dn = -n_x (nu x^2 + (2 - nu) y^2) / 2 - (2 + nu) n_y x y``.
    """
    angle = np.linspace(0, 2 * np.pi, 64, endpoint=False)
    powers = [(1, 1), (-1, 1), (3, 3), (-3, 3)] if hollow else [(1, 1), (3, 3)]  # r^p cos(m angle)
    rows, given = [], []
    for r in (hollow, 1.0) if hollow else (1.0,):
        x, y = r * np.cos(angle), r * np.sin(angle)
        rows.append(np.stack([p * r ** (p - 1) * np.cos(m * angle) for p, m in powers], axis=1))
        given.append(-(nu * x**2 + (2 - nu) * y**2) / 2 * np.cos(angle) - (2 + nu) * x * y * np.sin(angle))
    matrix, right = np.concatenate(rows), np.concatenate(given)
    factors = np.linalg.lstsq(matrix, right, rcond=None)[0]
    np.testing.assert_allclose(matrix @ factors, right, atol=1e-13)
    nodes, weights = np.polynomial.legendre.leggauss(12)
    r = (hollow + 1 + (1 - hollow) * nodes[:, None]) / 2
    x, y = r * np.cos(angle), r * np.sin(angle)
    chi = sum(factor * r**p * np.cos(m * angle) for factor, (p, m) in zip(factors, powers, strict=True))
    area_of = (1 - hollow) / 2 * weights[:, None] * r * 2 * np.pi / len(angle)
    A, I = np.broadcast_to(area_of, x.shape).sum(), (area_of * x**2).sum()
    return -2 * (1 + nu) * I**2 / (A * (area_of * x * (chi + x * y**2)).sum())


@pytest.mark.parametrize("nu", [0.0, 0.3, 0.5])
@pytest.mark.parametrize("hollow", [0.0, 0.6, 0.95])
def test_a_tube_shears_as_its_stress_does_and_stretches(nu, hollow):
    """Model (5a)."""
    made = {"outer_diameter": 3e-3, "inner_diameter": hollow * 3e-3, "young_modulus": 60e9, "poisson_ratio": nu}
    (section,) = mr.Rod.tube(length=L, **made, extensible=True).sections
    area = np.pi / 4 * (1 - hollow**2) * 9e-6
    np.testing.assert_allclose(section.axial_stiffness, 60e9 * area, rtol=1e-12)
    k = shear_coefficient(nu, hollow)
    np.testing.assert_allclose(section.shear_stiffness, np.full(2, k * 60e9 / (2 * (1 + nu)) * area), rtol=1e-10)
    (rigid,) = mr.Rod.tube(length=L, **made).sections
    assert np.isinf(rigid.axial_stiffness)
    assert np.isinf(rigid.shear_stiffness).all()
    np.testing.assert_array_equal(rigid.bending_stiffness, section.bending_stiffness)
    if not hollow:
        (wire,) = mr.Rod.wire(length=L, diameter=3e-3, young_modulus=60e9, poisson_ratio=nu, extensible=True).sections
        np.testing.assert_array_equal(wire.shear_stiffness, section.shear_stiffness)


def test_moduli_of_a_batch_make_a_batch_that_stretches():
    (section,) = mr.Rod.wire(length=L, diameter=3e-3, young_modulus=(60e9, 70e9), poisson_ratio=0.3, extensible=True).sections
    assert section.shear_stiffness.shape == (2, 2)
    assert section.batch_shape == section.axial_stiffness.shape == (2,)
    np.testing.assert_allclose(section.shear_stiffness[:, 0] / section.axial_stiffness, 7.8 / 8.8 / 2.6, rtol=1e-12)


@pytest.mark.parametrize("way", ["gravity", "constant", "function"])
def test_weight_of_a_beam(way):
    """w L^4/8EI and slope w L^3/6EI, in three ways to give the load w; odd part, so the error is of third order: 1e-8."""
    w = 1e-4 * EI / L**3
    rho = 0.02

    def deflection(sign):
        if way == "gravity":
            return solve(straight(linear_density=rho), gravity=(0, sign * w / rho, 0)).tip_position[1]
        load = (0, sign * w, 0)
        if way == "constant":
            return solve(straight(), distributed_force=load).tip_position[1]
        return solve(straight(), distributed_force=lambda s: load, distributed_moment=nothing).tip_position[1]

    assert (deflection(1) - deflection(-1)) / 2 == pytest.approx(w * L**4 / (8 * EI), rel=1e-7)


def test_load_functions_equal_constants_and_beam_formulas():
    """A triangular load w s/L bends by 11 w L^4/120EI; a large constant load by function is that by constant."""
    w = 1e-4 * EI / L**3

    def deflection(sign):
        return solve(straight(), distributed_force=lambda s: (sign * w * s / L, 0, 0), distributed_moment=nothing).tip_position[0]

    assert (deflection(1) - deflection(-1)) / 2 == pytest.approx(11 * w * L**4 / (120 * EI), rel=1e-7)
    f, l = (0.6, -0.4, 0.9), (0.16, 0.15, -0.18)
    constant = solve(straight(), distributed_force=f)
    function = solve(straight(), distributed_force=lambda s: f, distributed_moment=nothing)
    assert_pose(function, constant.tip_position, constant.tip_rotation)
    constant = solve(straight(), distributed_moment=l)
    function = solve(straight(), distributed_force=nothing, distributed_moment=lambda s: l)
    assert_pose(function, constant.tip_position, constant.tip_rotation)


def test_distributed_moment_twists_and_bends():
    """About the axis: l L^2/2GJ. About x, in the plane, M(s) = l (L - s), so the angle is l (L s - s^2/2)/EI."""
    l = 0.4
    twist = l * L**2 / (2 * GJ)
    c, s = np.cos(twist), np.sin(twist)
    assert_pose(solve(straight(), distributed_moment=(0, 0, l)), (0, 0, L), [[c, -s, 0], [s, c, 0], [0, 0, 1]])

    def angle(s):
        return l * (L * s - s**2 / 2) / EI

    y, z = (quad(lambda s, g=g: g(angle(s)), 0, L, epsabs=1e-13)[0] for g in (np.sin, np.cos))
    assert_pose(solve(straight(), distributed_moment=(l, 0, 0)), (0, -y, z))


# ---- limits and symmetries ----


@pytest.mark.filterwarnings("ignore::multirod.PlausibilityWarning")
def test_rigid_torsion_is_the_limit(wire):
    """The distance to ``inf`` falls like 1/GJ: by 100 from 1e2 to 1e4 EI."""
    force = (0.8, -0.5, 0.6)

    def tip(stiffness):
        rod = mr.Rod(length=0.4, bending_stiffness=EI, torsional_stiffness=stiffness, precurvature=(5, 3, 0))
        return solve(rod, tip_force=force).tip_position

    rigid = tip(np.inf)
    near, nearer = (np.linalg.norm(tip(factor * EI) - rigid) for factor in (1e2, 1e4))
    assert nearer < 1e-5
    assert near / nearer == pytest.approx(100, rel=0.02)


def test_base_pose_moves_everything(wire, make_pose):
    base = make_pose((0.4, -0.7, 1.1), (0.1, -0.2, 0.3))
    R, p = base[:3, :3], base[:3, 3]
    force = np.array([0.8, -0.5, 0.6])
    here, there = solve(wire, tip_force=force), solve(wire, base=base, tip_force=R @ force)
    assert_pose(there, p + R @ here.tip_position, R @ here.tip_rotation)
    np.testing.assert_allclose(there.rod(0).position, p + here.rod(0).position @ R.T, rtol=0, atol=1e-9)
    np.testing.assert_allclose(there.rod(0).moment, here.rod(0).moment, rtol=0, atol=1e-9)


def test_rotation_turns_the_base(wire, make_pose):
    force = (0.8, -0.5, 0.6)
    turned = solve(wire, base=make_pose((0, 0, 0.7)), tip_force=force)
    assert_pose(solve(wire, rotation=0.7, tip_force=force), turned.tip_position, turned.tip_rotation)
    half = solve(wire, base=make_pose((0, 0, 0.4)), rotation=0.3, tip_force=force)
    assert_pose(half, turned.tip_position, turned.tip_rotation)
