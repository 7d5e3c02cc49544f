# mypy: ignore-errors
"""The strain law: how the rods of a backbone bend and twist under its moment, and their torques; (5) to (8), (14), (17).

What follows from section force and moment is said here, and nowhere else: strains, the rates of angles and torques, the energy
per length, the variations of these, and what each rod has of curvature and moment (``put_own``). ``members`` asks it what rods
do alone, and adds what they carry along themselves; ``eccentric`` has the same functions for rods side by side.
``z`` is where the record of a stretch stands in memory, ``b`` the state, ``a`` where the record of a place stands, ``v`` a column
of the state and ``g`` where stands what its direction varies. Numbers in parentheses are those of ``docs/model.md``.
"""

from functools import partial
from types import SimpleNamespace

import warp as wp

from multirod.models.backbone.kernels.design import make_design_precurvature, make_design_strains
from multirod.models.backbone.kernels.equations.eccentric import make_eccentric_rods
from multirod.models.backbone.kernels.equations.precurvature import make_precurvature
from multirod.models.backbone.kernels.layout.layout import Layout
from multirod.models.backbone.kernels.members.rod import make_rod_with_members
from multirod.models.backbone.kernels.members.tubes import make_tubes_with_members
from multirod.models.backbone.kernels.numbers.lanes import add, div, lanes, mul, neg, sub  # noqa: F401  (by name)
from multirod.models.backbone.kernels.numbers.vectors import vectors


def make_strains(layout: Layout, W: int, d) -> SimpleNamespace:
    """The law of one rod, (5), of one with members, (5m), of several that share a centreline, (7) and (8), with members or
    without, or side by side."""
    precurvature = make_precurvature(layout, W, d)
    if layout.DESIGN:
        precurvature = make_design_precurvature(layout, W, d, precurvature)
    if layout.ECCENTRIC:
        make = make_eccentric_rods
    elif layout.CARRIERS:
        make = partial(make_tubes_with_members, several=make_several_rods(layout, W, d, precurvature))
    elif layout.features.members:
        make = partial(make_rod_with_members, alone=make_one_rod(layout, W, d, precurvature))
    else:
        make = make_one_rod if layout.n == 1 else make_several_rods
    law = SimpleNamespace(**(vars(precurvature) | vars(make(layout, W, d, precurvature))))
    return make_design_strains(layout, W, d, law) if layout.DESIGN and not layout.CARRIERS else law


def make_one_rod(layout: Layout, W: int, d, law: SimpleNamespace) -> SimpleNamespace:
    """(5): ``u = u* + K^-1 M``."""
    L, V = lanes(W, d), vectors(W, d)
    Real, row = L.Real, L.row
    Vec3, row3, put3, zero3, plus, times, dot = V.Vec3, V.row3, V.put3, V.zero3, V.plus, V.times, V.dot
    memory_type = wp.array(dtype=d)
    state, column = L.few(layout.state.size), L.few(layout.column.size)
    State, Column = state.type, column.type
    p = layout.place
    COMPLIANCE, X, CURVATURE, MOMENT_AT = layout.stretch["compliance"], p["x"], p["curvature"], p["moment"]
    SHEAR_AT, EXTENSION_AT, SHEAR = layout.stretch["shear"], p["extension"], layout.features.shear
    OWN_CURVATURE, TOTAL_MOMENT = p["own_curvature"], p["total_moment"]
    VARIED = (layout.VARIED or layout.DESIGN) and layout.DIRECTIONS
    precurvature, precurvature_variation = law.precurvature, law.precurvature_variation

    @wp.func
    def slid(memory: memory_type, z: int, N: Vec3) -> Vec3:
        """(5) v - e3 = S^-1 N"""
        return times(row3(memory, z + wp.static(SHEAR_AT)), N)

    @wp.func
    def free_strain(memory: memory_type, z: int, x: Real, M: Vec3) -> Vec3:
        """(5) u"""
        return plus(precurvature(memory, z, 0, x), times(row3(memory, z + wp.static(COMPLIANCE)), M))

    @wp.func
    def strain(memory: memory_type, z: int, a: int, x: Real, b: State, M: Vec3, N: Vec3) -> Vec3:
        """(5) u, and v - e3 to the place"""
        if wp.static(SHEAR):
            put3(memory, a + wp.static(EXTENSION_AT), slid(memory, z, N))
        return free_strain(memory, z, x, M)

    @wp.func
    def rates(memory: memory_type, z: int, a: int, x: Real, b: State, u: Vec3, f: wp.ref[State]):
        """No angles, no torques."""

    @wp.func
    def energy_rate(memory: memory_type, z: int, a: int, x: Real, b: State, M: Vec3, N: Vec3, u: Vec3) -> Real:
        """(14) Twice the energy per length, of what the rod itself carries."""
        energy = dot(M, times(row3(memory, z + wp.static(COMPLIANCE)), M))
        if wp.static(SHEAR):
            energy = energy + dot(N, slid(memory, z, N))
        return energy

    @wp.func
    def strain_variation(memory: memory_type, z: int, a: int, g: int, v: Column, dM: Vec3, dN: Vec3):
        """(17) du and d(v - e3); dM and dN in the frame"""
        du = times(row3(memory, z + wp.static(COMPLIANCE)), dM)
        if wp.static(VARIED):
            du = plus(du, precurvature_variation(memory, z, 0, row(memory, a + wp.static(X)), g))
        de = zero3()
        if wp.static(SHEAR):
            de = slid(memory, z, dN)
        return du, de

    @wp.func
    def put_own(memory: memory_type, z: int, a: int, b: State):
        """To the place: all there is, is the rod's."""
        put3(memory, a + wp.static(OWN_CURVATURE), row3(memory, a + wp.static(CURVATURE)))
        put3(memory, a + wp.static(TOTAL_MOMENT), row3(memory, a + wp.static(MOMENT_AT)))

    @wp.func
    def rate_variations(memory: memory_type, z: int, a: int, g: int, v: Column, du: Vec3, f: wp.ref[Column]):
        """No angles, no torques."""

    return SimpleNamespace(
        slid=slid,
        free_strain=free_strain,
        strain=strain,
        rates=rates,
        energy_rate=energy_rate,
        strain_variation=strain_variation,
        rate_variations=rate_variations,
        put_own=put_own,
    )


def make_several_rods(layout: Layout, W: int, d, law: SimpleNamespace) -> SimpleNamespace:
    """(7), (8): rods that share bending, each with its own angle and torque."""
    L, V = lanes(W, d), vectors(W, d)
    Real, row, put, fill = L.Real, L.row, L.put, L.fill
    Vec3, row3, put3, zero3, cosine_and_sine = V.Vec3, V.row3, V.put3, V.zero3, V.cosine_and_sine
    memory_type = wp.array(dtype=d)
    state, column = L.few(layout.state.size), L.few(layout.column.size)
    State, Column = state.type, column.type
    part, keep, part_of, keep_in = state.part, state.keep, column.part, column.keep
    n, TORQUES = layout.n, layout.TORQUES
    ANISOTROPIC = layout.features.anisotropic
    VARIED = (layout.VARIED or layout.DESIGN) and layout.DIRECTIONS
    s, p = layout.stretch, layout.place
    PRESENT, BENDING, BENDING_Y = s["present"], s["bending"], s["bending_y"]
    SOFTNESS, TORSION = s["softness"], s["torsion"]
    X, CURVATURE, TUBE_X, TUBE_Y, SLOPE_X, SLOPE_Y = p["x"], p["curvature"], p["tube_x"], p["tube_y"], p["slope_x"], p["slope_y"]
    STIFFNESS, FLEXIBILITY, COSINE, SINE = p["stiffness"], p["flexibility"], p["cosine"], p["sine"]
    MOMENT_AT, OWN_CURVATURE, TOTAL_MOMENT = p["moment"], p["own_curvature"], p["total_moment"]
    THETA, TAU = layout.state["angles"], layout.state["torques"]  # of rod 2; a column's stand alike
    precurvature, precurvature_variation = law.precurvature, law.precurvature_variation
    PerRod = L.few(n)
    Reals, keep_one, one_of = PerRod.type, PerRod.keep, PerRod.part

    @wp.func
    def inner_torque(memory: memory_type, z: int, b: State, M_z: Real) -> Real:
        """(7) tau_1: what the other rods leave of M_z."""
        tau = M_z
        for i in range(1, wp.static(TORQUES + 1)):
            tau = tau - row(memory, z + wp.static(PRESENT + i)) * part(b, wp.static(TAU + i - 1))
        return tau

    @wp.func
    def bent(memory: memory_type, z: int, a: int, x: Real, y: Real):
        """(7) (sum K_i)^-1 (x, y)"""
        if wp.static(ANISOTROPIC):
            f = row3(memory, a + wp.static(FLEXIBILITY))
            return f.x * x + f.y * y, f.y * x + f.z * y
        softness = row(memory, z + wp.static(SOFTNESS))
        return softness * x, softness * y

    @wp.func
    def strain(memory: memory_type, z: int, a: int, x: Real, b: State, M: Vec3, N: Vec3) -> Vec3:
        """(7) u; what each rod brings in is put to the place.

        Equal bending stiffness needs no ``K_i u`` in (8): it is parallel to u, which drops out, and does not turn.
        """
        gx = M.x
        gy = M.y
        bxs = Reals()
        bys = Reals()
        xx = fill(d(0.0))
        xy = fill(d(0.0))
        yy = fill(d(0.0))
        for i in range(wp.static(n)):
            u = precurvature(memory, z, i, x)
            bx = u.x
            by = u.y
            if wp.static(i > 0):
                c, s = cosine_and_sine(part(b, wp.static(THETA + i - 1)))
                bx = c * u.x - s * u.y
                by = s * u.x + c * u.y
                put(memory, a + wp.static(COSINE + i), c)
                put(memory, a + wp.static(SINE + i), s)
            EI = row(memory, z + wp.static(BENDING + i))
            if wp.static(ANISOTROPIC):
                kxx = EI
                kxy = fill(d(0.0))
                kyy = row(memory, z + wp.static(BENDING_Y + i))
                if wp.static(i > 0):
                    EI_y = row(memory, z + wp.static(BENDING_Y + i))
                    kxx = EI * c * c + EI_y * s * s
                    kxy = (EI - EI_y) * s * c
                    kyy = EI * s * s + EI_y * c * c
                put3(memory, a + wp.static(STIFFNESS + 3 * i), Vec3(kxx, kxy, kyy))
                xx = xx + kxx
                xy = xy + kxy
                yy = yy + kyy
                rx = kxx * bx + kxy * by
                by = kxy * bx + kyy * by
                bx = rx
            else:
                bx = EI * bx
                by = EI * by
            keep_one(bxs, i, bx)
            keep_one(bys, i, by)
            gx = gx + bx
            gy = gy + by
        if wp.static(ANISOTROPIC):
            scale = d(1.0) / (xx * yy - xy * xy)
            put3(memory, a + wp.static(FLEXIBILITY), Vec3(scale * yy, -scale * xy, scale * xx))
        ux, uy = bent(memory, z, a, gx, gy)
        u_1 = precurvature(memory, z, 0, x)
        uz = row(memory, z + wp.static(PRESENT)) * u_1.z
        if wp.static(TORQUES > 0):
            uz = uz + row(memory, z + wp.static(TORSION)) * inner_torque(memory, z, b, M.z)
        for i in range(wp.static(n)):
            bx = one_of(bxs, i)
            by = one_of(bys, i)
            if wp.static(ANISOTROPIC):
                k = row3(memory, a + wp.static(STIFFNESS + 3 * i))
                bx = bx - k.x * ux - k.y * uy
                by = by - k.y * ux - k.z * uy
            put_bent(memory, a, wp.static(i), bx, by, ux, uy)
        return Vec3(ux, uy, uz)

    @wp.func
    def slope(memory: memory_type, a: int, i: int, x: Real, y: Real, ux: Real, uy: Real):
        """(8) J c + K_i J u: how ``c = b_i - K_i u`` changes as rod i turns, J a quarter turn; of one equally stiff J b_i."""
        if wp.static(ANISOTROPIC):
            k = row3(memory, a + wp.static(STIFFNESS) + 3 * i)
            return k.y * ux - k.x * uy - y, x - k.y * uy + k.z * ux
        return -y, x

    @wp.func
    def put_bent(memory: memory_type, a: int, i: int, x: Real, y: Real, ux: Real, uy: Real):
        """(8) To the place: ``b_i - K_i u`` of rod i, or b_i of one equally stiff, and its slope by the angle."""
        put(memory, a + wp.static(TUBE_X) + i, x)
        put(memory, a + wp.static(TUBE_Y) + i, y)
        sx, sy = slope(memory, a, i, x, y, ux, uy)
        put(memory, a + wp.static(SLOPE_X) + i, sx)
        put(memory, a + wp.static(SLOPE_Y) + i, sy)

    @wp.func
    def rates(memory: memory_type, z: int, a: int, x: Real, b: State, u: Vec3, f: wp.ref[State]):
        """(8) theta_i' and tau_i'; zero where the rod has ended."""
        for i in range(1, wp.static(n)):
            u_star = precurvature(memory, z, i, x)
            rate = row(memory, z + wp.static(PRESENT + i)) * (u_star.z - u.z)
            if wp.static(TORQUES > 0):
                rate = rate + row(memory, z + wp.static(TORSION + i)) * part(b, wp.static(TAU + i - 1))
                torque = u.x * row(memory, a + wp.static(TUBE_Y + i)) - u.y * row(memory, a + wp.static(TUBE_X + i))
                keep(f, wp.static(TAU + i - 1), torque)
            keep(f, wp.static(THETA + i - 1), rate)

    @wp.func
    def stiffened(memory: memory_type, z: int, a: int, i: int, v: Vec3) -> Vec3:
        """K_i (v_x, v_y)"""
        if wp.static(ANISOTROPIC):
            k = row3(memory, a + wp.static(STIFFNESS) + 3 * i)
            return Vec3(k.x * v.x + k.y * v.y, k.y * v.x + k.z * v.y, fill(d(0.0)))
        EI = row(memory, z + wp.static(BENDING) + i)
        return Vec3(EI * v.x, EI * v.y, fill(d(0.0)))

    @wp.func
    def put_own(memory: memory_type, z: int, a: int, b: State):
        """(7), (8) To the place: curvature and moment of each rod, along the axes of rod 1.

        Of rods that are rigid in torsion only the sum of the torques is determined: each is no number.
        """
        x = row(memory, a + wp.static(X))
        u = row3(memory, a + wp.static(CURVATURE))
        for i in range(wp.static(n)):
            twist = precurvature(memory, z, i, x).z
            torque = fill(d(0.0) / d(0.0))
            if wp.static(TORQUES > 0):
                if wp.static(i == 0):
                    torque = inner_torque(memory, z, b, row(memory, a + wp.static(MOMENT_AT + 2)))
                else:
                    torque = part(b, wp.static(TAU + i - 1))
                twist = twist + row(memory, z + wp.static(TORSION + i)) * torque
            m = Vec3(-row(memory, a + wp.static(TUBE_X + i)), -row(memory, a + wp.static(TUBE_Y + i)), torque)
            if wp.static(not ANISOTROPIC):
                EI = row(memory, z + wp.static(BENDING + i))
                m = Vec3(m.x + EI * u.x, m.y + EI * u.y, torque)
            put3(memory, a + wp.static(OWN_CURVATURE + 3 * i), Vec3(u.x, u.y, twist))
            put3(memory, a + wp.static(TOTAL_MOMENT + 3 * i), m)

    @wp.func
    def energy_rate(memory: memory_type, z: int, a: int, x: Real, b: State, M: Vec3, N: Vec3, u: Vec3) -> Real:
        """(14) Twice the energy per length."""
        tau = inner_torque(memory, z, b, M.z)
        energy = row(memory, z + wp.static(TORSION)) * tau * tau
        for i in range(wp.static(n)):
            u_star = precurvature(memory, z, i, x)
            ex = u.x - u_star.x
            ey = u.y - u_star.y
            if wp.static(i > 0):
                c = row(memory, a + wp.static(COSINE + i))
                s = row(memory, a + wp.static(SINE + i))
                ex = u.x - (c * u_star.x - s * u_star.y)
                ey = u.y - (s * u_star.x + c * u_star.y)
            m = stiffened(memory, z, a, i, Vec3(ex, ey, tau))
            energy = energy + ex * m.x + ey * m.y
        for i in range(1, wp.static(TORQUES + 1)):
            tau_i = part(b, wp.static(TAU + i - 1))
            energy = energy + row(memory, z + wp.static(TORSION + i)) * tau_i * tau_i
        return energy

    @wp.func
    def turned_variation(memory: memory_type, z: int, a: int, i: int, g: int) -> Vec3:
        """du* of rod i, turned into the frame of rod 1."""
        v = precurvature_variation(memory, z, i, row(memory, a + wp.static(X)), g)
        if i == 0:
            return v
        c = row(memory, a + wp.static(COSINE) + i)
        s = row(memory, a + wp.static(SINE) + i)
        return Vec3(c * v.x - s * v.y, s * v.x + c * v.y, v.z)

    @wp.func
    def strain_variation(memory: memory_type, z: int, a: int, g: int, v: Column, dM: Vec3, dN: Vec3):
        """(17) du, and no shear; dM in the frame"""
        gx = dM.x
        gy = dM.y
        tau_1 = dM.z
        uz = fill(d(0.0))
        for i in range(1, wp.static(n)):
            turn = part_of(v, wp.static(THETA + i - 1))
            gx = gx + row(memory, a + wp.static(SLOPE_X + i)) * turn
            gy = gy + row(memory, a + wp.static(SLOPE_Y + i)) * turn
        for i in range(1, wp.static(TORQUES + 1)):
            tau_1 = tau_1 - row(memory, z + wp.static(PRESENT + i)) * part_of(v, wp.static(TAU + i - 1))
        if wp.static(VARIED):
            for i in range(wp.static(n)):
                e = turned_variation(memory, z, a, i, g)
                k = stiffened(memory, z, a, i, e)
                gx = gx + k.x
                gy = gy + k.y
                if wp.static(i == 0):
                    uz = row(memory, z + wp.static(PRESENT)) * e.z
        if wp.static(TORQUES > 0):
            uz = uz + row(memory, z + wp.static(TORSION)) * tau_1
        ux, uy = bent(memory, z, a, gx, gy)
        return Vec3(ux, uy, uz), zero3()

    @wp.func
    def rate_variations(memory: memory_type, z: int, a: int, g: int, v: Column, du: Vec3, f: wp.ref[Column]):
        """Variation of (8)."""
        u = row3(memory, a + wp.static(CURVATURE))
        for i in range(1, wp.static(n)):
            turn = part_of(v, wp.static(THETA + i - 1))
            rate = -row(memory, z + wp.static(PRESENT + i)) * du.z
            gx = row(memory, a + wp.static(SLOPE_X + i)) * turn
            gy = row(memory, a + wp.static(SLOPE_Y + i)) * turn
            if wp.static(VARIED):
                e = turned_variation(memory, z, a, i, g)
                k = stiffened(memory, z, a, i, e)
                gx = gx + k.x
                gy = gy + k.y
                rate = rate + row(memory, z + wp.static(PRESENT + i)) * e.z
            if wp.static(TORQUES > 0):
                rate = rate + row(memory, z + wp.static(TORSION + i)) * part_of(v, wp.static(TAU + i - 1))
                if wp.static(ANISOTROPIC):
                    k = stiffened(memory, z, a, i, du)
                    gx = gx - k.x
                    gy = gy - k.y
                torque = du.x * row(memory, a + wp.static(TUBE_Y + i)) - du.y * row(memory, a + wp.static(TUBE_X + i))
                keep_in(f, wp.static(TAU + i - 1), torque + u.x * gy - u.y * gx)
            keep_in(f, wp.static(THETA + i - 1), rate)

    return SimpleNamespace(
        bent=bent,
        slope=slope,
        put_bent=put_bent,
        stiffened=stiffened,
        inner_torque=inner_torque,
        put_own=put_own,
        turned_variation=turned_variation,
        strain=strain,
        rates=rates,
        energy_rate=energy_rate,
        strain_variation=strain_variation,
        rate_variations=rate_variations,
    )
