# mypy: ignore-errors
"""The strain law of rods that run side by side at offsets from one line, (7o), (8o), and its variation, (17o).

``z`` is where the record of a stretch stands in memory, ``b`` the state, ``a`` where the record of a place stands, ``v`` a column
of the state and ``g`` where stands what its direction varies. Numbers in parentheses are those of ``docs/model.md``.
"""

from types import SimpleNamespace

import warp as wp

from multirod.models.backbone.kernels.layout.layout import Layout
from multirod.models.backbone.kernels.numbers.lanes import add, div, lanes, mul, neg, sub  # noqa: F401  (by name)
from multirod.models.backbone.kernels.numbers.vectors import vectors

MOST_ITERATIONS = 30
CLOSE = {wp.float64: 1e-8, wp.float32: 1e-4}  # a step of Newton's method after which the next would be lost in rounding
LEFT = 0.2  # of a rod's length against that of the line, the least that one step leaves


def make_eccentric_rods(layout: Layout, W: int, d, law: SimpleNamespace) -> SimpleNamespace:
    """(7o), (8o): rods at offsets ``rho_i`` from a line whose frame does not twist, each with its own angle and torque.

    Columns that ask how the line would give way let it twist a little, (8s).
    """
    L, V = lanes(W, d), vectors(W, d)
    Real, row, put, fill, any_less = L.Real, L.row, L.put, L.fill, L.any_less
    absolute, largest, least, where_less = L.absolute, L.largest, L.least, L.where_less
    Vec3, row3, put3, zero3, cosine_and_sine = V.Vec3, V.row3, V.put3, V.zero3, V.cosine_and_sine
    memory_type = wp.array(dtype=d)
    state, column = L.few(layout.state.size), L.few(layout.column.size)
    State, Column = state.type, column.type
    part, keep, part_of, keep_in = state.part, state.keep, column.part, column.keep
    n = layout.n
    VARIED = (layout.VARIED or layout.DESIGN) and layout.DIRECTIONS
    s, p = layout.stretch, layout.place
    PRESENT, BENDING, TORSION, OFFSET, SHEATH = s["present"], s["bending"], s["torsion"], s["offset"], s["sheath"]
    UNIT_LENGTH = s["unit_length"]
    X, CURVATURE, TUBE_X, TUBE_Y, TORQUE = p["x"], p["curvature"], p["tube_x"], p["tube_y"], p["torque"]
    FLEXIBILITY, COSINE, SINE = p["flexibility"], p["cosine"], p["sine"]
    STRETCHING, TWISTING = p["stretching"], p["twisting"]
    OWN_CURVATURE, TOTAL_MOMENT = p["own_curvature"], p["total_moment"]
    THETA, TAU = layout.state["angles"], layout.state["torques"]
    precurvature, precurvature_variation = law.precurvature, law.precurvature_variation

    @wp.func
    def lever(memory: memory_type, z: int, i: int):
        """(7o) c_i"""
        return row(memory, z + wp.static(OFFSET) + 2 * i + 1), -row(memory, z + wp.static(OFFSET) + 2 * i)

    @wp.func
    def strain(memory: memory_type, z: int, a: int, x: Real, b: State, M: Vec3, N: Vec3) -> Vec3:
        """(7o) u, by Newton's method on a convex energy; what each rod brings in is put to the place."""
        gx = M.x
        gy = M.y
        rest = M.z
        one = fill(d(1.0))
        zero = fill(d(0.0))
        for i in range(wp.static(n)):
            u = precurvature(memory, z, i, x)
            c, s = cosine_and_sine(part(b, wp.static(THETA + i)))
            put(memory, a + wp.static(COSINE + i), c)
            put(memory, a + wp.static(SINE + i), s)
            bx = c * u.x - s * u.y
            by = s * u.x + c * u.y
            EI = row(memory, z + wp.static(BENDING + i))
            put(memory, a + wp.static(TUBE_X + i), EI * bx)
            put(memory, a + wp.static(TUBE_Y + i), EI * by)
            tau = part(b, wp.static(TAU + i))
            softness = row(memory, z + wp.static(TORSION + i))
            present = row(memory, z + wp.static(PRESENT + i))
            own_twist = present * u.z
            rest = rest - present * tau
            put(memory, a + wp.static(TORQUE + i), tau)
            put(memory, a + wp.static(TWISTING + i), softness * tau + own_twist)
            cx, cy = lever(memory, z, i)
            along = tau * (d(0.5) * softness * tau + own_twist) - d(0.5) * EI * (bx * bx + by * by)
            gx = gx + EI * bx + along * cx
            gy = gy + EI * by + along * cy
        ux = zero
        uy = zero
        length = row(memory, z + wp.static(UNIT_LENGTH))
        close = fill(d(wp.static(CLOSE[d])))
        open_ = one
        count = int(0)
        while any_less(zero, open_) and count < wp.static(MOST_ITERATIONS):
            step_x, step_y, share = newton_step(memory, z, a, gx, gy, ux, uy)
            # a lane that is done stays as it is, whatever the others do
            ux = ux + open_ * share * step_x
            uy = uy + open_ * share * step_y
            size = length * largest(absolute(step_x), absolute(step_y))
            # also what is no number goes on, and is refused below
            open_ = open_ * where_less(size + d(0.0) * (step_x + step_y), close, zero, one)
            count += int(1)
        newton_step(memory, z, a, gx, gy, ux, uy)  # for what stands at the place
        shortest = one
        for i in range(wp.static(n)):
            cx, cy = lever(memory, z, i)
            lam = one + cx * ux + cy * uy
            put(memory, a + wp.static(STRETCHING + i), lam)
            shortest = least(shortest, where_less(zero, row(memory, z + wp.static(PRESENT + i)), lam, one))
        bad = d(0.0) / ((one - open_) * where_less(zero, shortest, one, zero))  # no number where it did not settle
        return Vec3(ux + bad, uy + bad, row(memory, z + wp.static(SHEATH)) * rest)

    @wp.func
    def newton_step(memory: memory_type, z: int, a: int, gx: Real, gy: Real, ux: Real, uy: Real):
        """(7o) A step from (ux, uy), and the share of it that leaves each rod some length; the inverse of the stiffness to the
        place."""
        rx = gx
        ry = gy
        xx = fill(d(0.0))
        xy = fill(d(0.0))
        yy = fill(d(0.0))
        one = fill(d(1.0))
        for i in range(wp.static(n)):
            cx, cy = lever(memory, z, i)
            EI = row(memory, z + wp.static(BENDING + i))
            softer = d(1.0) / (one + cx * ux + cy * uy)
            wx = softer * ux
            wy = softer * uy
            square = wx * wx + wy * wy
            rx = rx - EI * (wx - d(0.5) * square * cx)
            ry = ry - EI * (wy - d(0.5) * square * cy)
            k = EI * softer
            xx = xx + k * (one - d(2.0) * cx * wx + square * cx * cx)
            xy = xy + k * (square * cx * cy - cx * wy - cy * wx)
            yy = yy + k * (one - d(2.0) * cy * wy + square * cy * cy)
        scale = d(1.0) / (xx * yy - xy * xy)
        put3(memory, a + wp.static(FLEXIBILITY), Vec3(scale * yy, -scale * xy, scale * xx))
        step_x = scale * (yy * rx - xy * ry)
        step_y = scale * (xx * ry - xy * rx)
        share = one
        for i in range(wp.static(n)):
            cx, cy = lever(memory, z, wp.static(i))
            lam = one + cx * ux + cy * uy
            shorter = -(cx * step_x + cy * step_y)
            most = d(wp.static(1.0 - LEFT)) * lam
            share = least(share, where_less(most, shorter, most / shorter, one))
        return step_x, step_y, share

    @wp.func
    def rates(memory: memory_type, z: int, a: int, x: Real, b: State, u: Vec3, f: wp.ref[State]):
        """(8o) theta_i' and tau_i'; zero where the rod has ended."""
        for i in range(wp.static(n)):
            own = row(memory, a + wp.static(STRETCHING + i)) * row(memory, a + wp.static(TWISTING + i))
            keep(f, wp.static(THETA + i), own - row(memory, z + wp.static(PRESENT + i)) * u.z)
            torque = u.x * row(memory, a + wp.static(TUBE_Y + i)) - u.y * row(memory, a + wp.static(TUBE_X + i))
            keep(f, wp.static(TAU + i), torque)

    @wp.func
    def energy_rate(memory: memory_type, z: int, a: int, x: Real, b: State, M: Vec3, N: Vec3, u: Vec3) -> Real:
        """(7o) Twice the energy per length of the line."""
        energy = fill(d(0.0))
        rest = M.z
        for i in range(wp.static(n)):
            u_star = precurvature(memory, z, i, x)
            c = row(memory, a + wp.static(COSINE + i))
            s = row(memory, a + wp.static(SINE + i))
            lam = row(memory, a + wp.static(STRETCHING + i))
            ex = u.x / lam - (c * u_star.x - s * u_star.y)
            ey = u.y / lam - (s * u_star.x + c * u_star.y)
            tau = part(b, wp.static(TAU + i))
            bent = row(memory, z + wp.static(BENDING + i)) * (ex * ex + ey * ey)
            energy = energy + lam * (bent + row(memory, z + wp.static(TORSION + i)) * tau * tau)
            rest = rest - row(memory, z + wp.static(PRESENT + i)) * tau
        return energy + row(memory, z + wp.static(SHEATH)) * rest * rest

    @wp.func
    def turned_variation(memory: memory_type, z: int, a: int, i: int, g: int) -> Vec3:
        """du* of rod i, along the axes of the frame."""
        v = precurvature_variation(memory, z, i, row(memory, a + wp.static(X)), g)
        c = row(memory, a + wp.static(COSINE) + i)
        s = row(memory, a + wp.static(SINE) + i)
        present = row(memory, z + wp.static(PRESENT) + i)
        return Vec3(c * v.x - s * v.y, s * v.x + c * v.y, present * v.z)

    @wp.func
    def strain_variation(memory: memory_type, z: int, a: int, g: int, v: Column, dM: Vec3, dN: Vec3):
        """(17o) du, and no shear; dM in the frame"""
        gx = dM.x
        gy = dM.y
        rest = dM.z
        for i in range(wp.static(n)):
            turn = part_of(v, wp.static(THETA + i))
            bx = row(memory, a + wp.static(TUBE_X + i))
            by = row(memory, a + wp.static(TUBE_Y + i))
            cx, cy = lever(memory, z, i)
            along = row(memory, a + wp.static(TWISTING + i)) * part_of(v, wp.static(TAU + i))
            rest = rest - row(memory, z + wp.static(PRESENT + i)) * part_of(v, wp.static(TAU + i))
            gx = gx - by * turn
            gy = gy + bx * turn
            if wp.static(VARIED):
                e = turned_variation(memory, z, a, i, g)
                EI = row(memory, z + wp.static(BENDING + i))
                gx = gx + EI * e.x
                gy = gy + EI * e.y
                along = along + row(memory, a + wp.static(TORQUE + i)) * e.z - bx * e.x - by * e.y
            gx = gx + along * cx
            gy = gy + along * cy
        f = row3(memory, a + wp.static(FLEXIBILITY))
        return Vec3(f.x * gx + f.y * gy, f.y * gx + f.z * gy, row(memory, z + wp.static(SHEATH)) * rest), zero3()

    @wp.func
    def rate_variations(memory: memory_type, z: int, a: int, g: int, v: Column, du: Vec3, f: wp.ref[Column]):
        """Variation of (8o)."""
        u = row3(memory, a + wp.static(CURVATURE))
        for i in range(wp.static(n)):
            turn = part_of(v, wp.static(THETA + i))
            bx = row(memory, a + wp.static(TUBE_X + i))
            by = row(memory, a + wp.static(TUBE_Y + i))
            cx, cy = lever(memory, z, i)
            twist = row(memory, z + wp.static(TORSION + i)) * part_of(v, wp.static(TAU + i))
            dbx = -by * turn
            dby = bx * turn
            if wp.static(VARIED):
                e = turned_variation(memory, z, a, i, g)
                EI = row(memory, z + wp.static(BENDING + i))
                twist = twist + e.z
                dbx = dbx + EI * e.x
                dby = dby + EI * e.y
            longer = cx * du.x + cy * du.y
            own = row(memory, a + wp.static(STRETCHING + i)) * twist - row(memory, z + wp.static(PRESENT + i)) * du.z
            keep_in(f, wp.static(THETA + i), own + longer * row(memory, a + wp.static(TWISTING + i)))
            keep_in(f, wp.static(TAU + i), du.x * by - du.y * bx + u.x * dby - u.y * dbx)

    @wp.func
    def put_own(memory: memory_type, z: int, a: int, b: State):
        """(7o) To the place: curvature of each rod by its own arclength, and its moment, along the axes of the frame."""
        x = row(memory, a + wp.static(X))
        u = row3(memory, a + wp.static(CURVATURE))
        for i in range(wp.static(n)):
            lam = row(memory, a + wp.static(STRETCHING + i))
            tau = part(b, wp.static(TAU + i))
            twist = precurvature(memory, z, i, x).z + row(memory, z + wp.static(TORSION + i)) * tau
            EI = row(memory, z + wp.static(BENDING + i))
            mx = EI * (u.x / lam) - row(memory, a + wp.static(TUBE_X + i))
            my = EI * (u.y / lam) - row(memory, a + wp.static(TUBE_Y + i))
            put3(memory, a + wp.static(OWN_CURVATURE + 3 * i), Vec3(u.x / lam, u.y / lam, twist))
            put3(memory, a + wp.static(TOTAL_MOMENT + 3 * i), Vec3(mx, my, tau))

    return SimpleNamespace(
        put_own=put_own,
        strain=strain,
        rates=rates,
        energy_rate=energy_rate,
        strain_variation=strain_variation,
        rate_variations=rate_variations,
    )
