# mypy: ignore-errors
"""Friction along the lines of concentric tubes: how bending and twists change along them, (L21) to (L23) of ``docs/lines.md``.

``z`` is where the record of a stretch stands in memory, ``a`` where that of a place stands, ``x`` the arclength from the start of
the stretch, ``J`` a quarter turn about the tubes. Vectors are along the axes of tube 1 unless said otherwise.
"""

from types import SimpleNamespace

import warp as wp

from multirod.models.backbone.kernels.layout.layout import Layout
from multirod.models.backbone.kernels.members.newton import MOST_ITERATIONS
from multirod.models.backbone.kernels.numbers.lanes import add, div, lanes, mul, neg, sub  # noqa: F401  (by name)
from multirod.models.backbone.kernels.numbers.vectors import vectors


def make_tube_friction(layout: Layout, W: int, d, law: SimpleNamespace, tubes: SimpleNamespace) -> SimpleNamespace:
    """For the ``tubes`` that carry members, and what they say of themselves."""
    L, V = lanes(W, d), vectors(W, d)
    Real, row, put, fill, any_less = L.Real, L.row, L.put, L.fill, L.any_less
    Vec3, row3, put3, zero3, plus, minus, dot = V.Vec3, V.row3, V.put3, V.zero3, V.plus, V.minus, V.dot
    scaled, ahead3 = V.scaled, V.ahead3
    memory_type = wp.array(dtype=d)
    state, column = L.few(layout.state.size), L.few(layout.column.size)
    State, Column = state.type, column.type
    part, keep, part_of, keep_in = state.part, state.keep, column.part, column.keep
    n, m, CARRIERS, TORQUES = layout.n, layout.SOLVED, layout.CARRIERS, layout.TORQUES
    vector, tally = L.few(m), L.few(12)
    Few, keep_one, one_of = vector.type, vector.keep, vector.part
    # of the lines of a tube, in its own frame: how their moment changes along it, and by what of its own strains' change
    Tally, tally_one, tallied = tally.type, tally.keep, tally.part
    s, p = layout.stretch, layout.place
    TORSION, UNIT_LENGTH, PRESENT = s["torsion"], s["unit_length"], s["present"]
    X, CURVATURE, TUBE_X, TUBE_Y = p["x"], p["curvature"], p["tube_x"], p["tube_y"]
    OWN_STRAINS, MEMBER_MOMENT, MEMBER_STIFFNESS = p["own_strains"], p["member_moment"], p["member_stiffness"]
    RATE_MOMENT = p["rate_moment"]
    TWIST_CHANGES, HELD_AT, GRIPS_AT = p["twist_changes"], p["grips"], layout.state["grips"]
    STRAIN_RATES, RATE_SYSTEM, PULL_RATES, TURN_RATES = p["strain_rates"], p["rate_system"], p["pull_rates"], p["turn_rates"]
    THETA, TAU = layout.state["angles"], layout.state["torques"]  # of tube 2; a column's stand alike
    ANISOTROPIC, CURVED = layout.features.anisotropic, layout.VARIED
    precurvature_slope = law.precurvature_slope
    bent, turned, turned_back, give, pushed, turn_of = (
        tubes.bent,
        tubes.turned,
        tubes.turned_back,
        tubes.give,
        tubes.pushed,
        tubes.turn_of,
    )
    stiffened, slope = tubes.stiffened, tubes.slope
    over_carriers, unsettled, drive_variation = tubes.over_carriers, tubes.unsettled, tubes.drive_variation

    @wp.func
    def quarter(v: Vec3) -> Vec3:
        """J v"""
        return Vec3(-v.y, v.x, fill(d(0.0)))

    @wp.func
    def stiffness_turned(memory: memory_type, z: int, a: int, i: int, v: Vec3) -> Vec3:
        """(L23) (J K_i - K_i J) v"""
        return minus(quarter(stiffened(memory, z, a, i, v)), stiffened(memory, z, a, i, quarter(v)))

    @wp.func
    def curved_along(memory: memory_type, z: int, a: int, i: int, x: Real) -> Vec3:
        """R K_i u*_i'"""
        if wp.static(CURVED):
            return stiffened(memory, z, a, i, turned(memory, a, i, precurvature_slope(memory, z, i, x)))
        return zero3()

    def members_moment(j: int, i: int, own: SimpleNamespace, rest):
        @wp.func
        def moment(memory: memory_type, a: int, tube: int) -> Vec3:
            if tube == wp.static(i):
                return turned(memory, a, wp.static(i), row3(memory, a + wp.static(MEMBER_MOMENT + 3 * j)))
            return rest(memory, a, tube)

        return moment

    @wp.func
    def no_moment(memory: memory_type, a: int, tube: int) -> Vec3:
        return zero3()

    members_carry = over_carriers(members_moment, no_moment)

    @wp.func
    def by_angle(memory: memory_type, z: int, a: int, i: int, u: Vec3) -> Vec3:
        """(L21) F_theta = J F - K J u, F = K u - b what tube i carries itself: its slope by the angle."""
        G = members_carry(memory, a, i)
        cx = row(memory, a + wp.static(TUBE_X) + i) + G.x
        cy = row(memory, a + wp.static(TUBE_Y) + i) + G.y
        x, y = slope(memory, a, i, cx, cy, u.x, u.y)
        return Vec3(-x, -y, fill(d(0.0)))

    # ---- lines of one tube ----

    def winds(law, count: int, step: int, numbers_of, functions_of, rest):
        function, rubs = law.wind, law.friction_at > 0

        @wp.func
        def wind(memory: memory_type, z: int, a: int, u: Vec3, u_s: Vec3, total: wp.ref[Tally], f: wp.ref[State], drive: int):
            last = int(wp.static(count))
            for k in range(last):
                own = function(memory, numbers_of(z, k), functions_of(z, a, k), u, zero3(), u_s, zero3())
                tally_one(total, 0, tallied(total, 0) + own.moment.x)
                tally_one(total, 1, tallied(total, 1) + own.moment.y)
                tally_one(total, 2, tallied(total, 2) + own.moment.z)
                rate = fill(d(0.0))
                if wp.static(rubs):
                    slip = -own.slip * own.T
                    for i in range(3):
                        pull = own.pull_moment.x
                        if wp.static(i == 1):
                            pull = own.pull_moment.y
                        if wp.static(i == 2):
                            pull = own.pull_moment.z
                        more = slip * pull
                        tally_one(total, wp.static(3 + 3 * i), tallied(total, wp.static(3 + 3 * i)) + more * own.by_u.x)
                        tally_one(total, wp.static(4 + 3 * i), tallied(total, wp.static(4 + 3 * i)) + more * own.by_u.y)
                        tally_one(total, wp.static(5 + 3 * i), tallied(total, wp.static(5 + 3 * i)) + more * own.by_u.z)
                    rate = -own.slip * own.turn * row(memory, a + wp.static(HELD_AT) + drive + k)
                keep(f, wp.static(GRIPS_AT) + drive + k, rate)
            rest(memory, z, a, u, u_s, total, f, drive + wp.static(count))

        return wind

    def variations(law, count: int, step: int, numbers_of, functions_of, rest):
        function = law.vary_winding

        @wp.func
        def vary(memory: memory_type, z: int, a: int, g: int, v: Column, u: Vec3, u_s: Vec3, du: Vec3, drive: int) -> Vec3:
            total = rest(memory, z, a, g, v, u, u_s, du, drive + wp.static(count))
            last = int(wp.static(count))
            for k in range(last):
                at = numbers_of(z, k)
                dT = row(memory, at) * drive_variation(memory, a, g, v, drive + k)
                own = function(memory, at, functions_of(z, a, k), u, zero3(), u_s, zero3(), du, zero3(), dT)
                total = plus(total, own.moment)
            return total

        return vary

    def turns(law, count: int, step: int, numbers_of, functions_of, rest):
        wind, vary_winding, rubs = law.wind, law.vary_winding, law.friction_at > 0

        @wp.func
        def turn(
            memory: memory_type,
            z: int,
            a: int,
            v: Column,
            u: Vec3,
            u_s: Vec3,
            du: Vec3,
            du_s: Vec3,
            f: wp.ref[Column],
            drive: int,
        ):
            last = int(wp.static(count))
            for k in range(last):
                rate = fill(d(0.0))
                if wp.static(rubs):
                    at = numbers_of(z, k)
                    on = functions_of(z, a, k)
                    own = wind(memory, at, on, u, zero3(), u_s, zero3())
                    change = vary_winding(memory, at, on, u, zero3(), u_s, zero3(), du, zero3(), fill(d(0.0)))
                    turned_more = change.turn + dot(own.by_u, du_s)
                    left = row(memory, a + wp.static(HELD_AT) + drive + k)
                    rate = -own.slip * (turned_more * left + own.turn * part_of(v, wp.static(GRIPS_AT) + drive + k))
                keep_in(f, wp.static(GRIPS_AT) + drive + k, rate)
            rest(memory, z, a, v, u, u_s, du, du_s, f, drive + wp.static(count))

        return turn

    @wp.func
    def no_wind(memory: memory_type, z: int, a: int, u: Vec3, u_s: Vec3, total: wp.ref[Tally], f: wp.ref[State], drive: int):
        """After the last member."""

    @wp.func
    def no_variation(memory: memory_type, z: int, a: int, g: int, v: Column, u: Vec3, u_s: Vec3, du: Vec3, drive: int) -> Vec3:
        return zero3()

    @wp.func
    def no_turn(
        memory: memory_type, z: int, a: int, v: Column, u: Vec3, u_s: Vec3, du: Vec3, du_s: Vec3, f: wp.ref[Column], drive: int
    ):
        """After the last member."""

    # ---- (L21), (L22): how bending and twists change along the tubes ----

    @wp.func
    def own_rates(memory: memory_type, a: int, i: int, u: Vec3, y: Vec3) -> Vec3:
        """(L21) u_i' in the frame of tube i, where the bending changes by y_xy and its twist by y_z."""
        along = ahead3(y, -row(memory, a + wp.static(TURN_RATES) + i), quarter(u))
        return turned_back(memory, a, i, Vec3(along.x, along.y, y.z))

    @wp.func
    def put_rate_stiffness(memory: memory_type, z: int, a: int, at: int, D: int, i: int, softness: Real, E: Tally):
        """(L22) D + E of tube i: how torque resists, what bending it makes, what of a twist is left; xx, xy, yx, yy."""
        xx = tallied(E, 3)
        xy = tallied(E, 4)
        yx = tallied(E, 6)
        yy = tallied(E, 7)
        w = turned(memory, a, i, Vec3(tallied(E, 5), tallied(E, 8), fill(d(0.0))))
        v = turned(memory, a, i, Vec3(tallied(E, 9), tallied(E, 10), fill(d(0.0))))
        # R E R^T, by columns and then by rows
        first = turned(memory, a, i, Vec3(xx, yx, fill(d(0.0))))
        second = turned(memory, a, i, Vec3(xy, yy, fill(d(0.0))))
        upper = turned(memory, a, i, Vec3(first.x, second.x, fill(d(0.0))))
        lower = turned(memory, a, i, Vec3(first.y, second.y, fill(d(0.0))))
        put(memory, at, row(memory, D) + upper.x)
        put(memory, at + 1, row(memory, D + 1) + upper.y)
        put(memory, at + 2, row(memory, D + 1) + lower.x)
        put(memory, at + 3, row(memory, D + 2) + lower.y)
        put(memory, at + 4, row(memory, D + 3) + w.x)
        put(memory, at + 5, row(memory, D + 4) + w.y)
        put(memory, at + 6, row(memory, D + 3) + v.x)
        put(memory, at + 7, row(memory, D + 4) + v.y)
        put(memory, at + 8, d(1.0) / (d(1.0) / row(memory, D + 5) + softness * tallied(E, 11)))

    def wind_of(j: int, i: int, own: SimpleNamespace, rest):
        wind_all, first = own.chain(winds, no_wind, "wind", whole=True), own.first_drive

        @wp.func
        def wind(memory: memory_type, z: int, a: int, y: Few, u: Vec3, carried: wp.ref[Few], f: wp.ref[State]):
            bending = Vec3(one_of(y, 0), one_of(y, 1), one_of(y, wp.static(2 + j)))
            u_s = own_rates(memory, a, wp.static(i), u, bending)
            total = Tally()
            wind_all(memory, z, a, row3(memory, a + wp.static(OWN_STRAINS + 3 * j)), u_s, total, f, wp.static(first))
            softness = row(memory, z + wp.static(TORSION + i))
            at = a + wp.static(RATE_SYSTEM + 4 + 9 * j)
            put_rate_stiffness(memory, z, a, at, a + wp.static(MEMBER_STIFFNESS + 6 * j), wp.static(i), softness, total)
            G_s = turned(memory, a, wp.static(i), Vec3(tallied(total, 0), tallied(total, 1), tallied(total, 2)))
            put3(memory, a + wp.static(RATE_MOMENT + 3 * j), G_s)
            G = members_carry(memory, a, wp.static(i))
            G_s = ahead3(G_s, row(memory, a + wp.static(TURN_RATES + i)), quarter(G))
            keep_one(carried, 0, one_of(carried, 0) + G_s.x)
            keep_one(carried, 1, one_of(carried, 1) + G_s.y)
            keep_one(carried, wp.static(2 + j), G_s.z)
            rest(memory, z, a, y, u, carried, f)

        return wind

    @wp.func
    def no_wind_of(memory: memory_type, z: int, a: int, y: Few, u: Vec3, carried: wp.ref[Few], f: wp.ref[State]):
        """After the last."""

    wind_tubes = over_carriers(wind_of, no_wind_of)

    @wp.func
    def factor(memory: memory_type, z: int, a: int):
        """(L22) The inverse where twists are eliminated."""
        xx = fill(d(0.0))
        xy = fill(d(0.0))
        yx = fill(d(0.0))
        yy = fill(d(0.0))
        for j in range(wp.static(len(CARRIERS))):
            at = a + wp.static(RATE_SYSTEM + 4 + 9 * j)
            less = row(memory, at + 8) * row(memory, z + wp.static(TORSION + CARRIERS[j]))
            xx = xx + row(memory, at) - less * row(memory, at + 4) * row(memory, at + 6)
            xy = xy + row(memory, at + 1) - less * row(memory, at + 4) * row(memory, at + 7)
            yx = yx + row(memory, at + 2) - less * row(memory, at + 5) * row(memory, at + 6)
            yy = yy + row(memory, at + 3) - less * row(memory, at + 5) * row(memory, at + 7)
        a_xx, a_yx = bent(memory, z, a, xx, yx)
        a_xy, a_yy = bent(memory, z, a, xy, yy)
        a_xx = a_xx + d(1.0)
        a_yy = a_yy + d(1.0)
        scale = d(1.0) / (a_xx * a_yy - a_xy * a_yx)
        put(memory, a + wp.static(RATE_SYSTEM), scale * a_yy)
        put(memory, a + wp.static(RATE_SYSTEM + 1), -scale * a_xy)
        put(memory, a + wp.static(RATE_SYSTEM + 2), -scale * a_yx)
        put(memory, a + wp.static(RATE_SYSTEM + 3), scale * a_xx)

    @wp.func
    def solve(memory: memory_type, z: int, a: int, r: Few) -> Few:
        """(L22)"""
        x = fill(d(0.0))
        y = fill(d(0.0))
        for j in range(wp.static(len(CARRIERS))):
            at = a + wp.static(RATE_SYSTEM + 4 + 9 * j)
            twist = row(memory, at + 8) * one_of(r, wp.static(2 + j))
            x = x + twist * row(memory, at + 4)
            y = y + twist * row(memory, at + 5)
        back_x, back_y = bent(memory, z, a, x, y)
        rx = one_of(r, 0) - back_x
        ry = one_of(r, 1) - back_y
        ux = row(memory, a + wp.static(RATE_SYSTEM)) * rx + row(memory, a + wp.static(RATE_SYSTEM + 1)) * ry
        uy = row(memory, a + wp.static(RATE_SYSTEM + 2)) * rx + row(memory, a + wp.static(RATE_SYSTEM + 3)) * ry
        q = Few()
        keep_one(q, 0, ux)
        keep_one(q, 1, uy)
        for j in range(wp.static(len(CARRIERS))):
            at = a + wp.static(RATE_SYSTEM + 4 + 9 * j)
            couple = row(memory, z + wp.static(TORSION + CARRIERS[j])) * (row(memory, at + 6) * ux + row(memory, at + 7) * uy)
            keep_one(q, wp.static(2 + j), row(memory, at + 8) * (one_of(r, wp.static(2 + j)) - couple))
        return q

    @wp.func
    def rates(memory: memory_type, z: int, a: int, x: Real, u: Vec3, M_s: Vec3, N_s: Vec3, b: State, f: wp.ref[State]):
        """(L21), by Newton's method, and with it what is left of tensions."""
        left = Vec3(M_s.x, M_s.y, M_s.z)
        put3(memory, a + wp.static(PULL_RATES), M_s)
        put(memory, a + wp.static(TURN_RATES), fill(d(0.0)))
        left = plus(left, curved_along(memory, z, a, 0, x))
        for i in range(1, wp.static(n)):
            turn = part(f, wp.static(THETA + i - 1))
            put(memory, a + wp.static(TURN_RATES + i), turn)
            left = ahead3(plus(left, curved_along(memory, z, a, i, x)), -turn, by_angle(memory, z, a, i, u))
            if wp.static(TORQUES > 0):
                M_z = left.z - row(memory, z + wp.static(PRESENT + i)) * part(f, wp.static(TAU + i - 1))
                left = Vec3(left.x, left.y, M_z)
        start = Few()
        ux, uy = bent(memory, z, a, left.x, left.y)
        keep_one(start, 0, ux)
        keep_one(start, 1, uy)
        for j in range(wp.static(len(CARRIERS))):
            twist = fill(d(0.0))
            if wp.static(TORQUES > 0):
                torque = left.z
                if wp.static(CARRIERS[j] > 0):
                    torque = part(f, wp.static(TAU + CARRIERS[j] - 1))
                twist = row(memory, z + wp.static(TORSION + CARRIERS[j])) * torque
            if wp.static(CURVED):
                slope = precurvature_slope(memory, z, wp.static(CARRIERS[j]), x)
                twist = twist + row(memory, z + wp.static(PRESENT + CARRIERS[j])) * slope.z
            keep_one(start, wp.static(2 + j), twist)
        length = row(memory, z + wp.static(UNIT_LENGTH))
        one = fill(d(1.0))
        zero = fill(d(0.0))
        open_ = one
        q = Few()
        step = Few()
        count = int(0)
        while any_less(zero, open_) and count < wp.static(MOST_ITERATIONS):
            for i in range(wp.static(m)):
                keep_one(q, i, one_of(q, i) + open_ * one_of(step, wp.static(i)))
            carried = Few()
            wind_tubes(memory, z, a, q, u, carried, f)
            factor(memory, z, a)
            back = give(memory, z, a, carried)
            gap = Few()
            for i in range(wp.static(m)):
                keep_one(gap, i, one_of(start, i) - one_of(back, i) - one_of(q, wp.static(i)))
            step = solve(memory, z, a, gap)
            open_ = unsettled(step, q, start, length * length, length * length)
            count += int(1)
        bad = d(0.0) / (one - open_)
        for i in range(wp.static(m)):
            put(memory, a + wp.static(STRAIN_RATES + i), one_of(q, i) + one_of(step, i) + bad)
        grips_count = int(wp.static(layout.DRIVES))
        for k in range(grips_count):
            keep(f, wp.static(GRIPS_AT) + k, part(f, wp.static(GRIPS_AT) + k) + bad)

    # ---- (L23): columns ----

    @wp.func
    def changed(memory: memory_type, a: int, i: int, j: int, u: Vec3, turn: Real, du: Vec3) -> Vec3:
        """(L18) du_i along the axes of tube 1, its twist as z."""
        bend = ahead3(du, -turn, quarter(u))
        return Vec3(bend.x, bend.y, row(memory, a + wp.static(TWIST_CHANGES) + 2 * j))

    @wp.func
    def rates_at(memory: memory_type, a: int, j: int) -> Vec3:
        y = row3(memory, a + wp.static(STRAIN_RATES))
        return Vec3(y.x, y.y, row(memory, a + wp.static(STRAIN_RATES + 2) + j))

    @wp.func
    def shifted(memory: memory_type, a: int, i: int, u: Vec3, y: Vec3, turn: Real, turn_rate: Real, du: Vec3) -> Vec3:
        """(L23) p_i"""
        rate = row(memory, a + wp.static(TURN_RATES) + i)
        p = scaled(-turn, quarter(ahead3(y, -rate, quarter(u))))
        return ahead3(ahead3(p, -turn_rate, quarter(u)), -rate, quarter(du))

    def less_of(j: int, i: int, own: SimpleNamespace, rest):
        vary_all, first, drives = own.chain(variations, no_variation, "wind", whole=True), own.first_drive, own.drive_count

        @wp.func
        def less(memory: memory_type, z: int, a: int, g: int, v: Column, f: Column, u: Vec3, du: Vec3, total: wp.ref[Few]):
            turn = turn_of(v, wp.static(i))
            turn_rate = fill(d(0.0))
            if wp.static(i > 0):
                turn_rate = part_of(f, wp.static(THETA + i - 1))
            y = rates_at(memory, a, wp.static(j))
            own_du = changed(memory, a, wp.static(i), wp.static(j), u, turn, du)
            u_i = row3(memory, a + wp.static(OWN_STRAINS + 3 * j))
            u_s = own_rates(memory, a, wp.static(i), u, y)
            du_i = turned_back(memory, a, wp.static(i), own_du)
            varied = turned(memory, a, wp.static(i), vary_all(memory, z, a, g, v, u_i, u_s, du_i, wp.static(first)))
            p = shifted(memory, a, wp.static(i), u, y, turn, turn_rate, du)
            at = a + wp.static(RATE_SYSTEM + 4 + 9 * j)
            D = a + wp.static(MEMBER_STIFFNESS + 6 * j)
            # R dG, what lines carry more
            more = pushed(memory, a, g, v, wp.static(i), wp.static(j), wp.static(first), wp.static(drives))
            G = members_carry(memory, a, wp.static(i))
            dG = Vec3(
                more.x + row(memory, D) * own_du.x + row(memory, D + 1) * own_du.y + row(memory, D + 3) * own_du.z,
                more.y + row(memory, D + 1) * own_du.x + row(memory, D + 2) * own_du.y + row(memory, D + 4) * own_du.z,
                fill(d(0.0)),
            )
            # what they carry more along the tube, without the turn of all of it
            rate = row(memory, a + wp.static(TURN_RATES + i))
            G_s = row3(memory, a + wp.static(RATE_MOMENT + 3 * j))
            found = ahead3(varied, turn, quarter(G_s))
            found = ahead3(found, turn_rate, quarter(G))
            found = ahead3(found, rate, quarter(ahead3(dG, turn, quarter(G))))
            x = found.x + row(memory, at) * p.x + row(memory, at + 1) * p.y
            y_ = found.y + row(memory, at + 2) * p.x + row(memory, at + 3) * p.y
            keep_one(total, 0, one_of(total, 0) + x)
            keep_one(total, 1, one_of(total, 1) + y_)
            keep_one(total, wp.static(2 + j), varied.z + row(memory, at + 6) * p.x + row(memory, at + 7) * p.y)
            rest(memory, z, a, g, v, f, u, du, total)

        return less

    @wp.func
    def no_less(memory: memory_type, z: int, a: int, g: int, v: Column, f: Column, u: Vec3, du: Vec3, total: wp.ref[Few]):
        """After the last."""

    def turn_of_lines(j: int, i: int, own: SimpleNamespace, rest):
        turn_all, first = own.chain(turns, no_turn, "wind", whole=True), own.first_drive

        @wp.func
        def turn_lines(memory: memory_type, z: int, a: int, v: Column, u: Vec3, du: Vec3, q: Few, f: wp.ref[Column]):
            turn = turn_of(v, wp.static(i))
            turn_rate = fill(d(0.0))
            if wp.static(i > 0):
                turn_rate = part_of(f, wp.static(THETA + i - 1))
            y = rates_at(memory, a, wp.static(j))
            own_du = changed(memory, a, wp.static(i), wp.static(j), u, turn, du)
            p = shifted(memory, a, wp.static(i), u, y, turn, turn_rate, du)
            change = Vec3(one_of(q, 0) + p.x, one_of(q, 1) + p.y, one_of(q, wp.static(2 + j)))
            u_i = row3(memory, a + wp.static(OWN_STRAINS + 3 * j))
            u_s = own_rates(memory, a, wp.static(i), u, y)
            du_i = turned_back(memory, a, wp.static(i), own_du)
            du_s = turned_back(memory, a, wp.static(i), change)
            turn_all(memory, z, a, v, u_i, u_s, du_i, du_s, f, wp.static(first))
            rest(memory, z, a, v, u, du, q, f)

        return turn_lines

    @wp.func
    def no_turn_lines(memory: memory_type, z: int, a: int, v: Column, u: Vec3, du: Vec3, q: Few, f: wp.ref[Column]):
        """After the last."""

    less_all, turn_lines_all = over_carriers(less_of, no_less), over_carriers(turn_of_lines, no_turn_lines)

    @wp.func
    def variations_of(
        memory: memory_type, z: int, a: int, g: int, v: Column, du: Vec3, de: Vec3, dM_s: Vec3, dN_s: Vec3, f: wp.ref[Column]
    ):
        """(L23)"""
        u = row3(memory, a + wp.static(CURVATURE))
        y = row3(memory, a + wp.static(STRAIN_RATES))
        x = row(memory, a + wp.static(X))
        left = Vec3(dM_s.x, dM_s.y, dM_s.z)
        for i in range(1, wp.static(n)):
            turn = turn_of(v, i)
            rate = row(memory, a + wp.static(TURN_RATES + i))
            F = by_angle(memory, z, a, i, u)
            left = ahead3(left, -part_of(f, wp.static(THETA + i - 1)), F)
            left = ahead3(left, turn, quarter(curved_along(memory, z, a, i, x)))
            twice = minus(quarter(minus(F, stiffened(memory, z, a, i, quarter(u)))), stiffened(memory, z, a, i, u))
            left = ahead3(left, -rate * turn, twice)
            if wp.static(ANISOTROPIC):
                left = ahead3(left, -turn, stiffness_turned(memory, z, a, i, y))
                left = ahead3(left, -rate, stiffness_turned(memory, z, a, i, du))
            if wp.static(TORQUES > 0):
                M_z = left.z - row(memory, z + wp.static(PRESENT + i)) * part_of(f, wp.static(TAU + i - 1))
                left = Vec3(left.x, left.y, M_z)
        less = Few()
        less_all(memory, z, a, g, v, f, u, du, less)
        right = Few()
        keep_one(right, 0, left.x - one_of(less, 0))
        keep_one(right, 1, left.y - one_of(less, 1))
        for j in range(wp.static(len(CARRIERS))):
            torque = fill(d(0.0))
            if wp.static(TORQUES > 0):
                torque = left.z
                if wp.static(CARRIERS[j] > 0):
                    torque = part_of(f, wp.static(TAU + CARRIERS[j] - 1))
            keep_one(right, wp.static(2 + j), torque - one_of(less, wp.static(2 + j)))
        q = solve(memory, z, a, give(memory, z, a, right))
        turn_lines_all(memory, z, a, v, u, du, q, f)

    return SimpleNamespace(rates=rates, variations=variations_of)
