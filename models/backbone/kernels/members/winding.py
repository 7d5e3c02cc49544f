# mypy: ignore-errors
"""How what lines answer changes along the rod, (L12) to (L14) of ``docs/lines.md``, where one of them rubs.

``u``, ``e`` are the strains at a place, ``u_s``, ``e_s`` their derivatives by arclength.
"""

from functools import cache
from types import SimpleNamespace

import warp as wp

from multirod.models.backbone.kernels.numbers.lanes import add, div, lanes, mul, neg, sub  # noqa: F401  (by name)
from multirod.models.backbone.kernels.numbers.vectors import vectors


@cache
def winding_types(W: int, d) -> SimpleNamespace:
    """What a line says of itself at a place."""
    Real, Vec3 = lanes(W, d).Real, vectors(W, d).Vec3

    @wp.struct
    class Winding:
        """Of T (rho x t, t), along the rod, and how it turns."""

        moment: Vec3  # its derivative, (L13)
        force: Vec3
        pull_moment: Vec3  # of what T works on by u, v
        pull_force: Vec3
        turn: Real  # |t' + u x t|
        by_u: Vec3  # its derivative by u', (L14)
        by_e: Vec3
        T: Real
        slip: Real  # coefficient of friction

    @wp.struct
    class WindingVariation:
        """Of the same, at constant ``u_s`` and ``e_s``."""

        moment: Vec3
        force: Vec3
        turn: Real

    return SimpleNamespace(Winding=Winding, WindingVariation=WindingVariation)


def make_winding(
    numbers: SimpleNamespace, drive_at: int, friction_at: int, discs_at: int = 0, bending_at: int = 0, straight: bool = False
) -> SimpleNamespace:
    """``wind`` and ``vary_winding`` of a line whose weight is its first parameter and whose drive stands ``drive_at`` after it.

    Its coefficient of friction stands ``friction_at`` after it, if that is not 0; then the part of its tension that is left is
    its third function. What discs take away stands ``discs_at`` after it, (L11), its bending stiffness ``bending_at``, (L10). A
    ``straight`` one has the potential ``T a . e3``, (L9).
    """
    d, Real, Vec3, memory_type = numbers.d, numbers.Real, numbers.Vec3, numbers.memory_type
    Winding, WindingVariation = numbers.Winding, numbers.WindingVariation
    row, fill, root, where_less = numbers.row, numbers.fill, numbers.root, numbers.where_less
    dot, cross, plus = numbers.dot, numbers.cross, numbers.plus
    scaled, ahead3, zero3 = numbers.scaled, numbers.ahead3, numbers.zero3
    value, slope, bend = numbers.value, numbers.slope, numbers.bend
    RUBS, DISCS = friction_at > 0, numbers.DISCS and discs_at > 0

    @wp.func
    def bending(k: Real, a: Vec3, b: Vec3) -> Real:
        """k a_xy . b_xy"""
        return k * (a.x * b.x + a.y * b.y)

    @wp.func
    def bent(m: Vec3, k: Real, u: Vec3) -> Vec3:
        """m + k u_xy"""
        return Vec3(m.x + k * u.x, m.y + k * u.y, m.z)

    @wp.func
    def offset(memory: memory_type, on: int) -> Vec3:
        return Vec3(value(memory, on), value(memory, on + 1), fill(d(0.0)))

    @wp.func
    def offset_slope(memory: memory_type, on: int) -> Vec3:
        return Vec3(slope(memory, on), slope(memory, on + 1), fill(d(0.0)))

    @wp.func
    def tension(memory: memory_type, at: int, on: int) -> Real:
        T = row(memory, at) * row(memory, at + wp.static(drive_at))
        if wp.static(RUBS):
            T = T * value(memory, on + 2)
        return T

    @wp.func
    def tangent_of(u: Vec3, e: Vec3, rho: Vec3, rho_s: Vec3) -> Vec3:
        """(L1) a"""
        a = plus(plus(e, rho_s), cross(u, rho))
        return Vec3(a.x, a.y, a.z + d(1.0))

    @wp.func
    def along(memory: memory_type, on: int, u: Vec3, u_s: Vec3, e_s: Vec3, rho: Vec3, rho_s: Vec3) -> Vec3:
        """(L13) a'"""
        curve = Vec3(bend(memory, on), bend(memory, on + 1), fill(d(0.0)))
        return plus(plus(e_s, curve), plus(cross(u_s, rho), cross(u, rho_s)))

    @wp.func
    def per_turn(turn: Real) -> Real:
        """1/turn; 0 of what does not turn, whose direction no change has"""
        still = where_less(turn, fill(d(1e-30)), fill(d(1.0)), fill(d(0.0)))
        return (d(1.0) - still) / (turn + still)

    @wp.func
    def bend_along(memory: memory_type, at: int, on: int, u: Vec3, e: Vec3, u_s: Vec3, e_s: Vec3, found: wp.ref[Winding]):
        """(L14b) Of a push rod that bends."""
        EI = row(memory, at + wp.static(bending_at))
        c = Vec3(value(memory, on + 1), -value(memory, on), fill(d(0.0)))
        per = d(1.0) / (d(1.0) + e.z + dot(c, u))
        arc = d(0.5) * per * per * bending(fill(d(1.0)), u, u)
        m_s = per * (e_s.z + dot(c, u_s))
        arc_s = per * per * bending(fill(d(1.0)), u, u_s) - d(2.0) * arc * m_s
        found.moment = ahead3(bent(bent(found.moment, EI * per, u_s), -EI * per * m_s, u), -EI * arc_s, c)
        found.force = Vec3(found.force.x, found.force.y, found.force.z - EI * arc_s)

    @wp.func
    def vary_bend_along(
        memory: memory_type,
        at: int,
        on: int,
        u: Vec3,
        e: Vec3,
        u_s: Vec3,
        e_s: Vec3,
        du: Vec3,
        de: Vec3,
        found: wp.ref[WindingVariation],
    ):
        """(L14c)"""
        EI = row(memory, at + wp.static(bending_at))
        c = Vec3(value(memory, on + 1), -value(memory, on), fill(d(0.0)))
        per = d(1.0) / (d(1.0) + e.z + dot(c, u))
        arc = d(0.5) * per * per * bending(fill(d(1.0)), u, u)
        m_s = per * (e_s.z + dot(c, u_s))
        dm = per * (de.z + dot(c, du))
        darc = per * per * bending(fill(d(1.0)), u, du) - d(2.0) * arc * dm
        turned = bending(fill(d(1.0)), du, u_s) - d(2.0) * dm * bending(fill(d(1.0)), u, u_s)
        darc_s = per * per * turned - d(2.0) * m_s * (darc - arc * dm)
        moment = bent(bent(found.moment, -EI * per * dm, u_s), -EI * per * m_s, du)
        found.moment = ahead3(bent(moment, d(2.0) * EI * per * m_s * dm, u), -EI * darc_s, c)
        found.force = Vec3(found.force.x, found.force.y, found.force.z - EI * darc_s)

    @wp.func
    def wind(memory: memory_type, at: int, on: int, u: Vec3, e: Vec3, u_s: Vec3, e_s: Vec3) -> Winding:
        """(L13), (L14)"""
        found = Winding()
        rho = offset(memory, on)
        rho_s = offset_slope(memory, on)
        T = tension(memory, at, on)
        found.T = T
        t = Vec3(fill(d(0.0)), fill(d(0.0)), fill(d(1.0)))
        t_s = zero3()
        if wp.static(not straight):
            a = tangent_of(u, e, rho, rho_s)
            lam = root(dot(a, a))
            per = d(1.0) / lam
            t = scaled(per, a)
            a_s = along(memory, on, u, u_s, e_s, rho, rho_s)
            lam_s = dot(t, a_s)
            t_s = scaled(per, ahead3(a_s, -lam_s, t))
        T_s = fill(d(0.0))
        if wp.static(RUBS):
            w = plus(t_s, cross(u, t))
            found.turn = root(dot(w, w))
            found.slip = row(memory, at + wp.static(friction_at))
            T_s = -found.slip * found.turn * T
            across = scaled(per * per_turn(found.turn), w)
            found.by_e = across
            found.by_u = cross(rho, across)
        found.pull_force = t
        if wp.static(DISCS):  # (L12b)
            k = d(-2.0) * row(memory, at + wp.static(discs_at))
            part = d(1.0) + bending(d(0.5) * k, u, u)
            part_s = bending(k, u, u_s)
            found.pull_force = scaled(part, t)
            found.force = plus(scaled(T_s * part + T * part_s, t), scaled(T * part, t_s))
            moment = plus(scaled(T * part, cross(rho_s, t)), cross(rho, found.force))
            found.moment = bent(bent(moment, k * (T_s * lam + T * lam_s), u), k * T * lam, u_s)
            found.pull_moment = bent(cross(rho, found.pull_force), k * lam, u)
        else:
            found.force = plus(scaled(T_s, t), scaled(T, t_s))
            found.moment = plus(scaled(T, cross(rho_s, t)), cross(rho, found.force))
            found.pull_moment = cross(rho, t)
        if wp.static(bending_at > 0):
            bend_along(memory, at, on, u, e, u_s, e_s, found)
        return found

    @wp.func
    def vary_winding(
        memory: memory_type, at: int, on: int, u: Vec3, e: Vec3, u_s: Vec3, e_s: Vec3, du: Vec3, de: Vec3, dT: Real
    ) -> WindingVariation:
        """(L14) What varies with the strains and the tension."""
        found = WindingVariation()
        rho = offset(memory, on)
        rho_s = offset_slope(memory, on)
        T = tension(memory, at, on)
        t = Vec3(fill(d(0.0)), fill(d(0.0)), fill(d(1.0)))
        t_s = zero3()
        dt = zero3()
        dt_s = zero3()
        if wp.static(not straight):
            a = tangent_of(u, e, rho, rho_s)
            lam = root(dot(a, a))
            per = d(1.0) / lam
            t = scaled(per, a)
            a_s = along(memory, on, u, u_s, e_s, rho, rho_s)
            lam_s = dot(t, a_s)
            t_s = scaled(per, ahead3(a_s, -lam_s, t))
            da = plus(de, cross(du, rho))
            da_s = cross(du, rho_s)
            dlam = dot(t, da)
            dt = scaled(per, ahead3(da, -dlam, t))
            dlam_s = dot(dt, a_s) + dot(t, da_s)
            change = ahead3(da_s, -dlam_s, t)
            change = ahead3(ahead3(change, -lam_s, dt), -dlam, t_s)
            dt_s = scaled(per, change)
        T_s = fill(d(0.0))
        dT_s = fill(d(0.0))
        if wp.static(RUBS):
            w = plus(t_s, cross(u, t))
            turn = root(dot(w, w))
            dw = plus(dt_s, plus(cross(du, t), cross(u, dt)))
            found.turn = per_turn(turn) * dot(w, dw)
            slip = row(memory, at + wp.static(friction_at))
            T_s = -slip * turn * T
            dT_s = -slip * (found.turn * T + turn * dT)
        if wp.static(DISCS):  # (L12b)
            k = d(-2.0) * row(memory, at + wp.static(discs_at))
            part = d(1.0) + bending(d(0.5) * k, u, u)
            part_s = bending(k, u, u_s)
            dpart = bending(k, u, du)
            dpart_s = bending(k, du, u_s)
            A = T_s * part + T * part_s
            dA = dT_s * part + T_s * dpart + dT * part_s + T * dpart_s
            B = T * part
            dB = dT * part + T * dpart
            found.force = plus(plus(scaled(dA, t), scaled(A, dt)), plus(scaled(dB, t_s), scaled(B, dt_s)))
            moment = plus(cross(rho_s, plus(scaled(dB, t), scaled(B, dt))), cross(rho, found.force))
            moment = bent(moment, k * (dT_s * lam + T_s * dlam + dT * lam_s + T * dlam_s), u)
            found.moment = bent(bent(moment, k * (T_s * lam + T * lam_s), du), k * (dT * lam + T * dlam), u_s)
        else:
            found.force = plus(plus(scaled(dT_s, t), scaled(T_s, dt)), plus(scaled(dT, t_s), scaled(T, dt_s)))
            pulled = plus(scaled(dT, t), scaled(T, dt))
            found.moment = plus(cross(rho_s, pulled), cross(rho, found.force))
        if wp.static(bending_at > 0):
            vary_bend_along(memory, at, on, u, e, u_s, e_s, du, de, found)
        return found

    return SimpleNamespace(wind=wind, vary_winding=vary_winding)
