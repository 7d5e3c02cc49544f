# mypy: ignore-errors
"""Laws of lines, for kernels; numbers in parentheses are those of ``docs/lines.md``.

A line's first parameter is a weight, which makes what drives it a tension and is zero where the line is not; its functions are
the two components of its offset ``rho``.
"""

from types import SimpleNamespace

import warp as wp

from multirod.models.backbone.kernels.members.winding import make_winding
from multirod.models.backbone.kernels.numbers.lanes import add, div, mul, neg, sub  # noqa: F401  (by name)

STEEPEST = 1.16  # 2/sqrt(3), rounded up: how fast what is across a unit vector turns with it
SHORTEST = 0.1  # length of a line per length of rod, below which it is bent to its centre of curvature


def tendon_law(
    numbers: SimpleNamespace, drive_at: int, bending_at: int = 0, discs_at: int = 0, friction_at: int = 0
) -> SimpleNamespace:
    """(L2) to (L6): ``W = T |a|``, ``a = v + u x rho + rho'``; what drives it stands ``drive_at`` after its first parameter.

    With its bending stiffness ``bending_at`` after that, (L10) too, of an offset that is constant; where there are discs, with
    what they take away ``discs_at`` after it, (L11); with its coefficient of friction ``friction_at`` after it, (L12): then what
    is left of its tension is its third function.
    """
    RUBS = friction_at > 0
    DISCS = numbers.DISCS and discs_at > 0
    d, Real, Vec3, Response, memory_type = numbers.d, numbers.Real, numbers.Vec3, numbers.Response, numbers.memory_type
    row, fill, root, where_less = numbers.row, numbers.fill, numbers.root, numbers.where_less
    dot, scaled, absolute, add_change = numbers.dot, numbers.scaled, numbers.absolute, numbers.add_change
    value, slope, bend = numbers.value, numbers.slope, numbers.bend
    add_moment, add_force, add_stiffness = numbers.add_moment, numbers.add_force, numbers.add_stiffness
    FORCES, VARIED = numbers.FORCES, numbers.VARIED
    BOUNDED = not (numbers.SHEAR or DISCS or bending_at)

    @wp.func
    def tangent(memory: memory_type, on: int, u: Vec3, e: Vec3) -> Vec3:
        """(L1) a, whose length is that of the line per length of rod."""
        x = value(memory, on)
        y = value(memory, on + 1)
        a = Vec3(-u.z * y, u.z * x, u.x * y - u.y * x + d(1.0))
        if wp.static(FORCES):
            a = Vec3(a.x + e.x, a.y + e.y, a.z + e.z)
        if wp.static(VARIED):
            a = Vec3(a.x + slope(memory, on), a.y + slope(memory, on + 1), a.z)
        return a

    @wp.func
    def length_of(a: Vec3) -> Real:
        """lam; no number where the line is too short."""
        size = root(dot(a, a))
        return where_less(size, fill(d(SHORTEST)), fill(d(0.0) / d(0.0)), size)

    @wp.func
    def tension(memory: memory_type, at: int, on: int) -> Real:
        """What is left of it there, (L12)."""
        T = row(memory, at) * row(memory, at + wp.static(drive_at))
        if wp.static(RUBS):
            T = T * value(memory, on + 2)
        return T

    @wp.func
    def lever(memory: memory_type, on: int, t: Vec3) -> Vec3:
        """rho x t"""
        x = value(memory, on)
        y = value(memory, on + 1)
        return Vec3(y * t.z, -x * t.z, x * t.y - y * t.x)

    @wp.func
    def straightened(memory: memory_type, at: int, u: Vec3) -> Real:
        """(L11) Length of the chords per length of the line."""
        if wp.static(DISCS):
            return d(1.0) - row(memory, at + wp.static(discs_at)) * (u.x * u.x + u.y * u.y)
        return fill(d(1.0))

    @wp.func
    def normal_length(memory: memory_type, on: int, u: Vec3, e: Vec3) -> Real:
        """(L10) m, which takes the place of lam."""
        m = u.x * value(memory, on + 1) - u.y * value(memory, on) + d(1.0)
        if wp.static(FORCES):
            m = m + e.z
        return m

    @wp.func
    def bend_along(memory: memory_type, at: int, on: int, u: Vec3, e: Vec3, r: wp.ref[Response]):
        """(L10) Derivatives of EI |u_xy|^2 / (2 m)."""
        x = value(memory, on)
        y = value(memory, on + 1)
        per = d(1.0) / normal_length(memory, on, u, e)
        k = row(memory, at + wp.static(bending_at)) * per
        ux = per * u.x
        uy = per * u.y
        q = ux * ux + uy * uy
        half = d(0.5) * q
        add_moment(r, Vec3(k * (u.x - half * y / per), k * (u.y + half * x / per), fill(d(0.0))))
        add_stiffness(r, 0, 0, k * (d(1.0) - d(2.0) * ux * y + q * y * y))
        add_stiffness(r, 0, 1, k * (ux * x - uy * y - q * x * y))
        add_stiffness(r, 1, 1, k * (d(1.0) + d(2.0) * uy * x + q * x * x))
        if wp.static(FORCES):
            add_force(r, Vec3(fill(d(0.0)), fill(d(0.0)), -k * half / per))
            add_stiffness(r, 0, 5, k * (q * y - ux))
            add_stiffness(r, 1, 5, k * (-q * x - uy))
            add_stiffness(r, 5, 5, k * q)

    @wp.func
    def straighten(memory: memory_type, at: int, on: int, u: Vec3, size: Real, T: Real, t: Vec3, r: wp.ref[Response]):
        """(L11) Derivatives of its second factor."""
        k = d(-2.0) * row(memory, at + wp.static(discs_at)) * T
        m = lever(memory, on, t)
        add_moment(r, Vec3(k * size * u.x, k * size * u.y, fill(d(0.0))))
        add_stiffness(r, 0, 0, k * (size + d(2.0) * m.x * u.x))
        add_stiffness(r, 0, 1, k * (m.x * u.y + m.y * u.x))
        add_stiffness(r, 1, 1, k * (size + d(2.0) * m.y * u.y))
        add_stiffness(r, 0, 2, k * u.x * m.z)
        add_stiffness(r, 1, 2, k * u.y * m.z)
        add_stiffness(r, 0, 3, k * u.x * t.x)
        add_stiffness(r, 0, 4, k * u.x * t.y)
        add_stiffness(r, 0, 5, k * u.x * t.z)
        add_stiffness(r, 1, 3, k * u.y * t.x)
        add_stiffness(r, 1, 4, k * u.y * t.y)
        add_stiffness(r, 1, 5, k * u.y * t.z)

    @wp.func
    def respond(memory: memory_type, at: int, on: int, u: Vec3, e: Vec3, r: wp.ref[Response]):
        """(L2) T (rho x t, t), and (L4), (L19)."""
        if wp.static(bending_at > 0):
            bend_along(memory, at, on, u, e, r)
        T = tension(memory, at, on)
        x = value(memory, on)
        y = value(memory, on + 1)
        a = tangent(memory, on, u, e)
        size = length_of(a)
        per = d(1.0) / size
        t = scaled(per, a)
        m = lever(memory, on, t)
        if wp.static(DISCS):
            straighten(memory, at, on, u, size, T, t, r)
            T = T * straightened(memory, at, u)
        add_moment(r, scaled(T, m))
        h = T * per
        n = scaled(h, m)
        xx = x * x
        yy = y * y
        add_stiffness(r, 0, 0, h * yy - n.x * m.x)
        add_stiffness(r, 0, 1, -h * x * y - n.x * m.y)
        add_stiffness(r, 0, 2, -n.x * m.z)
        add_stiffness(r, 1, 1, h * xx - n.y * m.y)
        add_stiffness(r, 1, 2, -n.y * m.z)
        add_stiffness(r, 2, 2, h * (xx + yy) - n.z * m.z)
        if wp.static(BOUNDED):
            add_change(r, d(STEEPEST) * absolute(h) * per * (xx + yy) * (absolute(x) + absolute(y)))
        if wp.static(FORCES):
            add_force(r, scaled(T, t))
            k = scaled(h, t)
            add_stiffness(r, 0, 3, -n.x * t.x)
            add_stiffness(r, 0, 4, -n.x * t.y)
            add_stiffness(r, 0, 5, h * y - n.x * t.z)
            add_stiffness(r, 1, 3, -n.y * t.x)
            add_stiffness(r, 1, 4, -n.y * t.y)
            add_stiffness(r, 1, 5, -h * x - n.y * t.z)
            add_stiffness(r, 2, 3, -h * y - n.z * t.x)
            add_stiffness(r, 2, 4, h * x - n.z * t.y)
            add_stiffness(r, 2, 5, -n.z * t.z)
            add_stiffness(r, 3, 3, h - k.x * t.x)
            add_stiffness(r, 3, 4, -k.x * t.y)
            add_stiffness(r, 3, 5, -k.x * t.z)
            add_stiffness(r, 4, 4, h - k.y * t.y)
            add_stiffness(r, 4, 5, -k.y * t.z)
            add_stiffness(r, 5, 5, h - k.z * t.z)

    @wp.func
    def energy(memory: memory_type, at: int, on: int, u: Vec3, e: Vec3) -> Real:
        """None: what pulls is outside the rod. (L10)"""
        if wp.static(bending_at > 0):
            q = u.x * u.x + u.y * u.y
            return d(0.5) * row(memory, at + wp.static(bending_at)) * q / normal_length(memory, on, u, e)
        return fill(d(0.0))

    @wp.func
    def pull(memory: memory_type, at: int, on: int, u: Vec3, e: Vec3, r: wp.ref[Response]) -> Real:
        """(L5) lam, and its derivatives (t, rho x t)."""
        here = row(memory, at)
        a = tangent(memory, on, u, e)
        size = length_of(a)
        t = scaled(here / size, a)
        if wp.static(DISCS):
            k = d(-2.0) * here * row(memory, at + wp.static(discs_at)) * size
            add_moment(r, Vec3(k * u.x, k * u.y, fill(d(0.0))))
            part = straightened(memory, at, u)
            t = scaled(part, t)
            size = part * size
        add_force(r, t)
        add_moment(r, lever(memory, on, t))
        return here * size

    @wp.func
    def slide(memory: memory_type, at: int, on: int, u: Vec3, e: Vec3, r: wp.ref[Response]) -> Real:
        """(L6) What varies along the rod where the strains do not: T (t', rho' x t + rho x t'), and lam'."""
        here = row(memory, at)
        T = tension(memory, at, on)
        a = tangent(memory, on, u, e)
        per = d(1.0) / length_of(a)
        t = scaled(per, a)
        x_s = slope(memory, on)
        y_s = slope(memory, on + 1)
        b = Vec3(bend(memory, on) - u.z * y_s, bend(memory, on + 1) + u.z * x_s, u.x * y_s - u.y * x_s)
        along = dot(t, b)
        if wp.static(DISCS):
            k = d(-2.0) * T * row(memory, at + wp.static(discs_at)) * along
            add_moment(r, Vec3(k * u.x, k * u.y, fill(d(0.0))))
            part = straightened(memory, at, u)
            T = part * T
            here = part * here
        turn = Vec3(per * (b.x - along * t.x), per * (b.y - along * t.y), per * (b.z - along * t.z))
        add_force(r, scaled(T, turn))
        add_moment(r, scaled(T, lever(memory, on, turn)))
        add_moment(r, scaled(T, Vec3(y_s * t.z, -x_s * t.z, x_s * t.y - y_s * t.x)))
        return here * along

    own = SimpleNamespace(respond=respond, energy=energy, pull=pull, slide=slide, friction_at=friction_at, bounded=BOUNDED)
    if numbers.FRICTION:
        vars(own).update(vars(make_winding(numbers, drive_at, friction_at, discs_at, bending_at)))
    return own


def section_chamber_law(numbers: SimpleNamespace, drive_at: int) -> SimpleNamespace:
    """(L9): ``W = T a . e3``; what drives it stands ``drive_at`` after its first parameter."""
    d, Real, Vec3, Response, memory_type = numbers.d, numbers.Real, numbers.Vec3, numbers.Response, numbers.memory_type
    row, fill, add_moment, add_force = numbers.row, numbers.fill, numbers.add_moment, numbers.add_force
    value, slope = numbers.value, numbers.slope

    @wp.func
    def push(memory: memory_type, on: int, T: Real, r: wp.ref[Response]):
        """T (e3, rho x e3)"""
        none = fill(d(0.0))
        add_force(r, Vec3(none, none, T))
        add_moment(r, Vec3(T * value(memory, on + 1), -T * value(memory, on), none))

    @wp.func
    def respond(memory: memory_type, at: int, on: int, u: Vec3, e: Vec3, r: wp.ref[Response]):
        """(L9) The same whatever the strains are."""
        push(memory, on, row(memory, at) * row(memory, at + wp.static(drive_at)), r)

    @wp.func
    def energy(memory: memory_type, at: int, on: int, u: Vec3, e: Vec3) -> Real:
        """None: what pushes is outside the rod."""
        return fill(d(0.0))

    @wp.func
    def pull(memory: memory_type, at: int, on: int, u: Vec3, e: Vec3, r: wp.ref[Response]) -> Real:
        """(L9) a . e3, and its derivatives."""
        here = row(memory, at)
        push(memory, on, here, r)
        return here * (e.z + u.x * value(memory, on + 1) - u.y * value(memory, on) + d(1.0))

    @wp.func
    def slide(memory: memory_type, at: int, on: int, u: Vec3, e: Vec3, r: wp.ref[Response]) -> Real:
        """(L6) What varies along the rod where the strains do not."""
        here = row(memory, at)
        T = here * row(memory, at + wp.static(drive_at))
        x_s = slope(memory, on)
        y_s = slope(memory, on + 1)
        add_moment(r, Vec3(T * y_s, -T * x_s, fill(d(0.0))))
        return here * (u.x * y_s - u.y * x_s)

    own = SimpleNamespace(respond=respond, energy=energy, pull=pull, slide=slide, friction_at=0, bounded=True)
    if numbers.FRICTION:
        vars(own).update(vars(make_winding(numbers, drive_at, 0, straight=True)))
    return own
