# mypy: ignore-errors
"""Friction along lines: how strains change along a rod, and with them what is left of tensions.

``z`` is where the record of a stretch stands in memory, ``a`` where that of a place stands, ``x`` the arclength from the start of
the stretch. Numbers in parentheses are those of ``docs/lines.md``.
"""

from types import SimpleNamespace

import warp as wp

from multirod.models.backbone.kernels.layout.layout import Layout
from multirod.models.backbone.kernels.members.newton import MOST_ITERATIONS
from multirod.models.backbone.kernels.numbers.lanes import add, div, lanes, mul, neg, sub  # noqa: F401  (by name)
from multirod.models.backbone.kernels.numbers.vectors import vectors


def make_grips(layout: Layout, W: int, d, members: SimpleNamespace):
    """The function that puts to a place what is left there of the tensions of ``members``, the drives of which are numbered from
    ``drive`` on, and what drives them."""
    L = lanes(W, d)
    row, put = L.row, L.put
    memory_type = wp.array(dtype=d)
    state = L.few(layout.state.size)
    State, part = state.type, state.part
    GRIPS_AT, DRIVES_AT, HELD_AT = layout.state["grips"], layout.place["drives"], layout.place["grips"]

    def grips(law, count: int, step: int, numbers_of, functions_of, rest):
        rubs = law.friction_at > 0

        @wp.func
        def grip(memory: memory_type, z: int, a: int, b: State, drive: int):
            last = int(wp.static(count))
            for k in range(last):
                left = part(b, wp.static(GRIPS_AT) + drive + k)
                put(memory, a + wp.static(HELD_AT) + drive + k, left)
                put(memory, a + wp.static(DRIVES_AT) + drive + k, row(memory, numbers_of(z, k) + wp.static(step - 1)))
                if wp.static(rubs):
                    put(memory, functions_of(z, a, k) + 2, left)
            rest(memory, z, a, b, drive + wp.static(count))

        return grip

    @wp.func
    def no_grip(memory: memory_type, z: int, a: int, b: State, drive: int):
        """After the last member."""

    return members.chain(grips, no_grip, "pull", whole=True) if layout.FRICTION else no_grip


def make_friction(
    layout: Layout, W: int, d, law: SimpleNamespace, members: SimpleNamespace, newton: SimpleNamespace
) -> SimpleNamespace:
    """(L12) to (L14), for the members of ``make_members``."""
    L, V = lanes(W, d), vectors(W, d)
    Real, row, put, fill, any_less = L.Real, L.row, L.put, L.fill, L.any_less
    Vec3, row3, zero3, dot = V.Vec3, V.row3, V.zero3, V.dot
    memory_type = wp.array(dtype=d)
    state, column = L.few(layout.state.size), L.few(layout.column.size)
    State, Column = state.type, column.type
    keep, keep_in, part, part_of = state.keep, column.keep, state.part, column.part
    SHEAR, m, p = layout.features.shear, layout.STRAINS, layout.place
    vector = L.few(m)
    Few, keep_one, one_of = vector.type, vector.keep, vector.part
    Matrix, factor, solve, entry, keep_entry = newton.Matrix, newton.factor, newton.solve, newton.entry, newton.keep_entry
    read_matrix, write_matrix, tangent, unsettled = newton.read_matrix, newton.write_matrix, newton.tangent, newton.unsettled
    answer, stacked, extension_at, compliances = members.answer, members.stacked, members.extension_at, members.compliances
    chain, drive_variation = members.chain, members.drive_variation
    CURVED, precurvature_slope = layout.VARIED, law.precurvature_slope
    DRIVES, FRICTION, CURVATURE, UNIT_LENGTH = layout.DRIVES, layout.FRICTION, p["curvature"], layout.stretch["unit_length"]
    GRIPS_AT, HELD_AT = layout.state["grips"], p["grips"]
    STRAIN_RATES, RATE_SYSTEM, PULL_RATES = p["strain_rates"], p["rate_system"], p["pull_rates"]

    def winds(law, count: int, step: int, numbers_of, functions_of, rest):
        function, rubs = law.wind, law.friction_at > 0

        @wp.func
        def wind(
            memory: memory_type,
            z: int,
            a: int,
            u: Vec3,
            e: Vec3,
            u_s: Vec3,
            e_s: Vec3,
            c: Few,
            gap: wp.ref[Few],
            A: wp.ref[Matrix],
            f: wp.ref[State],
            drive: int,
        ):
            last = int(wp.static(count))
            for k in range(last):
                own = function(memory, numbers_of(z, k), functions_of(z, a, k), u, e, u_s, e_s)
                answers = stacked(own.moment, own.force)
                pull = stacked(own.pull_moment, own.pull_force)
                by = stacked(own.by_u, own.by_e)
                slip = -own.slip * own.T
                for i in range(wp.static(m)):
                    keep_one(gap, i, one_of(gap, i) + one_of(c, i) * one_of(answers, i))
                    if wp.static(rubs):
                        for j in range(wp.static(m)):
                            more = slip * one_of(c, i) * one_of(pull, i) * one_of(by, j)
                            keep_entry(A, wp.static(i * m + j), entry(A, wp.static(i * m + j)) + more)
                rate = fill(d(0.0))
                if wp.static(rubs):
                    rate = -own.slip * own.turn * row(memory, a + wp.static(HELD_AT) + drive + k)
                keep(f, wp.static(GRIPS_AT) + drive + k, rate)
            rest(memory, z, a, u, e, u_s, e_s, c, gap, A, f, drive + wp.static(count))

        return wind

    def variations(law, count: int, step: int, numbers_of, functions_of, rest):
        function = law.vary_winding

        @wp.func
        def vary(
            memory: memory_type,
            z: int,
            a: int,
            g: int,
            v: Column,
            u: Vec3,
            e: Vec3,
            u_s: Vec3,
            e_s: Vec3,
            du: Vec3,
            de: Vec3,
            total: wp.ref[Few],
            drive: int,
        ):
            last = int(wp.static(count))
            for k in range(last):
                at = numbers_of(z, k)
                dT = row(memory, at) * drive_variation(memory, a, g, v, drive + k)
                own = function(memory, at, functions_of(z, a, k), u, e, u_s, e_s, du, de, dT)
                change = stacked(own.moment, own.force)
                for i in range(wp.static(m)):
                    keep_one(total, i, one_of(total, i) + one_of(change, wp.static(i)))
            rest(memory, z, a, g, v, u, e, u_s, e_s, du, de, total, drive + wp.static(count))

        return vary

    def turns(law, count: int, step: int, numbers_of, functions_of, rest):
        wind, vary_winding, rubs = law.wind, law.vary_winding, law.friction_at > 0

        @wp.func
        def turn(
            memory: memory_type,
            z: int,
            a: int,
            g: int,
            v: Column,
            u: Vec3,
            e: Vec3,
            u_s: Vec3,
            e_s: Vec3,
            du: Vec3,
            de: Vec3,
            du_s: Vec3,
            de_s: Vec3,
            f: wp.ref[Column],
            drive: int,
        ):
            last = int(wp.static(count))
            for k in range(last):
                rate = fill(d(0.0))
                if wp.static(rubs):
                    at = numbers_of(z, k)
                    on = functions_of(z, a, k)
                    own = wind(memory, at, on, u, e, u_s, e_s)
                    change = vary_winding(memory, at, on, u, e, u_s, e_s, du, de, fill(d(0.0)))
                    turned = change.turn + dot(own.by_u, du_s) + dot(own.by_e, de_s)
                    left = row(memory, a + wp.static(HELD_AT) + drive + k)
                    rate = -own.slip * (turned * left + own.turn * part_of(v, wp.static(GRIPS_AT) + drive + k))
                keep_in(f, wp.static(GRIPS_AT) + drive + k, rate)
            rest(memory, z, a, g, v, u, e, u_s, e_s, du, de, du_s, de_s, f, drive + wp.static(count))

        return turn

    @wp.func
    def no_wind(
        memory: memory_type,
        z: int,
        a: int,
        u: Vec3,
        e: Vec3,
        u_s: Vec3,
        e_s: Vec3,
        c: Few,
        gap: wp.ref[Few],
        A: wp.ref[Matrix],
        f: wp.ref[State],
        drive: int,
    ):
        """After the last member."""

    @wp.func
    def no_variation(
        memory: memory_type,
        z: int,
        a: int,
        g: int,
        v: Column,
        u: Vec3,
        e: Vec3,
        u_s: Vec3,
        e_s: Vec3,
        du: Vec3,
        de: Vec3,
        total: wp.ref[Few],
        drive: int,
    ):
        """After the last member."""

    @wp.func
    def no_turn(
        memory: memory_type,
        z: int,
        a: int,
        g: int,
        v: Column,
        u: Vec3,
        e: Vec3,
        u_s: Vec3,
        e_s: Vec3,
        du: Vec3,
        de: Vec3,
        du_s: Vec3,
        de_s: Vec3,
        f: wp.ref[Column],
        drive: int,
    ):
        """After the last member."""

    wind_all, vary_all, turn_all = no_wind, no_variation, no_turn
    if FRICTION:
        wind_all = chain(winds, no_wind, "wind", whole=True)
        vary_all = chain(variations, no_variation, "wind", whole=True)
        turn_all = chain(turns, no_turn, "wind", whole=True)

    @wp.func
    def rates(memory: memory_type, z: int, a: int, x: Real, u: Vec3, M_s: Vec3, N_s: Vec3, b: State, f: wp.ref[State]):
        """(L12), (L13): how the strains change along the rod, by Newton's method, and with them what is left of tensions."""
        e = extension_at(memory, a)
        c = compliances(memory, z)
        D = answer(memory, z, a, stacked(u, e))
        carried = stacked(M_s, N_s)
        start = Few()
        if wp.static(CURVED):
            start = stacked(precurvature_slope(memory, z, 0, x), zero3())
        for i in range(wp.static(m)):
            put(memory, a + wp.static(PULL_RATES + i), one_of(carried, i))
            keep_one(start, i, one_of(start, i) + one_of(c, i) * one_of(carried, i))
        q = Few()
        length = row(memory, z + wp.static(UNIT_LENGTH))
        one = fill(d(1.0))
        zero = fill(d(0.0))
        open_ = one
        A = Matrix()
        step = Few()
        count = int(0)
        while any_less(zero, open_) and count < wp.static(MOST_ITERATIONS):
            for i in range(wp.static(m)):
                keep_one(q, i, one_of(q, i) - open_ * one_of(step, wp.static(i)))
            u_s = Vec3(one_of(q, 0), one_of(q, 1), one_of(q, 2))
            e_s = zero3()
            if wp.static(SHEAR):
                e_s = Vec3(one_of(q, 3), one_of(q, 4), one_of(q, 5))
            gap = Few()
            for i in range(wp.static(m)):
                keep_one(gap, i, one_of(q, i) - one_of(start, wp.static(i)))
            A = tangent(c, D)
            wind_all(memory, z, a, u, e, u_s, e_s, c, gap, A, f, 0)
            factor(A)
            step = solve(A, gap)
            open_ = unsettled(step, q, start, length * length, length)
            count += int(1)
        bad = d(0.0) / (one - open_)
        for i in range(wp.static(m)):
            put(memory, a + wp.static(STRAIN_RATES + i), one_of(q, i) - one_of(step, i) + bad)
        write_matrix(memory, a + wp.static(RATE_SYSTEM), A)
        grips_count = int(wp.static(DRIVES))
        for k in range(grips_count):
            keep(f, wp.static(GRIPS_AT) + k, part(f, wp.static(GRIPS_AT) + k) + bad)

    @wp.func
    def variations_of(
        memory: memory_type,
        z: int,
        a: int,
        g: int,
        v: Column,
        du: Vec3,
        de: Vec3,
        dM_s: Vec3,
        dN_s: Vec3,
        f: wp.ref[Column],
    ):
        """(L14)"""
        u = row3(memory, a + wp.static(CURVATURE))
        e = extension_at(memory, a)
        c = compliances(memory, z)
        u_s = row3(memory, a + wp.static(STRAIN_RATES))
        e_s = zero3()
        if wp.static(SHEAR):
            e_s = row3(memory, a + wp.static(STRAIN_RATES + 3))
        total = Few()
        vary_all(memory, z, a, g, v, u, e, u_s, e_s, du, de, total, 0)
        carried = stacked(dM_s, dN_s)
        right = Few()
        for i in range(wp.static(m)):
            keep_one(right, i, one_of(c, i) * (one_of(carried, i) - one_of(total, wp.static(i))))
        q = solve(read_matrix(memory, a + wp.static(RATE_SYSTEM)), right)
        du_s = Vec3(one_of(q, 0), one_of(q, 1), one_of(q, 2))
        de_s = zero3()
        if wp.static(SHEAR):
            de_s = Vec3(one_of(q, 3), one_of(q, 4), one_of(q, 5))
        turn_all(memory, z, a, g, v, u, e, u_s, e_s, du, de, du_s, de_s, f, 0)

    return SimpleNamespace(put_grips=make_grips(layout, W, d, members), rates=rates, variations=variations_of)
